"""Photos of a printed board as a table: a row for each of its points. They come from a folder, a video or messages."""

from __future__ import annotations

import hashlib
import math
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from rich.console import Console
from rich.progress import track

from robacc.errors import InputError, Problem, UsageError, by_key, install_advice, listing, refuse
from robacc.geometry import Array
from robacc.io.column_table import ColumnTable
from robacc.io.files import write_file
from robacc.io.table import TableOptions
from robacc.poses.cameras import PHOTO

if TYPE_CHECKING:
    from robacc.fitting.fit_result import Fit
    from robacc_plugins.boards import Board, Verdict

_FOREIGN = re.compile(r"\.(?:avif|cr[23]|dng|hei[cf]|nef|raw|arw)$")
"""Ends of names of photos that OpenCV does not read, in small letters."""
_NAMED = 20
"""Photos that a message names of each kind."""


class Shot(NamedTuple):
    """Photo, frame of a video, or image of a message."""

    name: str
    image: Any
    """``(H, W)`` grey levels; None for what is no image."""
    columns: Mapping[str, float | str] = {}
    """What else was measured with it, by the name of its column, such as the joints."""
    tags: Mapping[int, Array] | None = None
    """Corners ``(4, 2)`` of markers that another program found, px, by their numbers; None: they are to be found."""


class _Seen(NamedTuple):
    name: str
    verdict: Verdict
    detail: str
    pixels: Array
    points: Array
    columns: Mapping[str, float | str]
    thumbnail: Any
    size: tuple[int, ...] = ()
    """Height and width, px; of detected tags they are unknown."""

    @property
    def label(self) -> str:
        """Name, with that of the camera before it where there are several."""
        return "/".join(str(part) for part in (self.columns.get("camera"), self.name) if part)


def takes(path: str, first: bytes) -> bool:
    """Return whether a folder has photos, or a folder of photos for each camera."""
    return Path(path).is_dir() and bool(_photos(path) or _photos(path, _FOREIGN) or _of_cameras(path))


def read(path: str, options: TableOptions) -> ColumnTable:
    """Return the points of the board in the photos of a folder; each photo's name without its end is its pose.

    A folder without photos may have one for each camera, with the camera's name. Without a board, the records of poses
    beside the photos are read.

    Raises:
        InputError: A photo or the file of the board cannot be read, or no photo shows the board.
        UsageError: No board is stated, or the extra ``camera`` is not installed.
    """
    from robacc_plugins import records

    if options.board is None and records.holds_poses(path):  # found in the photos by another program
        return records.read(path, options)
    cv2, files, digest = opencv(path), {"": _photos(path)}, hashlib.sha256()
    foreign = [file.name for file in _photos(path, _FOREIGN)]
    if not (files[""] or foreign):
        files = _of_cameras(path)
        foreign = [f"{camera}/{file.name}" for camera in files for file in _photos(Path(path, camera), _FOREIGN)]
    fix = "save them as JPEG in full size"
    refuse((not any(files.values()), Problem(f"OpenCV reads no photos like {', '.join(foreign[:1])}", path, fix=fix)))
    names = Counter((camera, file.stem) for camera in files for file in files[camera])
    twice = next((file.name for camera in files for file in files[camera] if names[camera, file.stem] > 1), "")
    one = Problem(
        f"{twice} and another photo have one name", path, fix="a name is a pose: rename or remove one of them"
    )
    refuse((twice, one))

    def shots() -> Iterator[Shot]:
        for camera, photos in files.items():
            for file in photos:
                content = file.read_bytes()
                digest.update(content)
                yield Shot(file.stem, decoded(cv2, content), {"camera": camera} if camera else {})

    table = table_of(shots(), sum(map(len, files.values())), path, options, digest.hexdigest)
    if foreign:
        listed = f"{', '.join(foreign[:_NAMED])}{' …' * (len(foreign) > _NAMED)}"
        table.log.warn(f"OpenCV does not read {listed}: {fix}", of_file=True)
    return table


def _of_cameras(path: str) -> dict[str, list[Path]]:
    """Return the photos in each folder in a folder, by its name."""
    folders = sorted(folder for folder in Path(path).iterdir() if folder.is_dir() and folder.name[0] != ".")
    return {folder.name: photos for folder in folders if (photos := _photos(folder))}


def _photos(path: str | Path, ends: re.Pattern[str] = PHOTO) -> list[Path]:
    files = (file for file in Path(path).iterdir() if ends.search(file.name.lower()) and file.name[0] != ".")
    return sorted(file for file in files if file.is_file())


def opencv(path: str) -> Any:
    """Return the module of OpenCV, which images of a path need.

    Raises:
        UsageError: The extra ``camera`` is not installed.
    """
    try:
        import cv2
    except ImportError:
        raise UsageError(f"{path} has photos, which need OpenCV; run {install_advice('camera')}") from None
    return cv2


def decoded(cv2: Any, content: bytes) -> Any:
    """Return the grey image in the bytes of a file; None if there is none.

    A camera that points down turns photos for viewing at random; its chip and its lens do not turn.
    """
    how = cv2.IMREAD_GRAYSCALE | cv2.IMREAD_ANYDEPTH | cv2.IMREAD_IGNORE_ORIENTATION
    image = cv2.imdecode(np.frombuffer(content, np.uint8), how) if content else None
    if image is None or image.dtype == np.uint8:
        return image
    # Cameras of 10 or 12 bits fill the first of 16 only.
    return cv2.normalize(np.nan_to_num(image), None, 0, 255, cv2.NORM_MINMAX, cv2.CV_8U)


def table_of(
    shots: Iterable[Shot], count: int, path: str, options: TableOptions, digest: Callable[[], str], remark: str = ""
) -> ColumnTable:
    """Return the points of the board in photos, and write the contact sheet if one is wanted.

    Args:
        shots: The photos; they are seen one at a time.
        count: How many there are.
        path: Where they come from.
        options: The board and the contact sheet.
        digest: Returns the digest of the bytes that they come from, when the last one was seen.
        remark: How they were chosen.

    Raises:
        InputError: An image or the file of the board cannot be read, or no photo shows the board.
        UsageError: No board is stated, or the contact sheet's name is of no picture or in the folder of the photos.
    """
    from robacc_plugins.boards import Board

    cv2 = opencv(path)
    if options.board is None:
        raise UsageError(f"{path} has photos; state the board that they show with `board`")
    sheet = options.contact_sheet
    if sheet is not None and Path(sheet).resolve().parent == Path(path).resolve():
        raise UsageError(f"`contact_sheet`: {sheet} would be one of the photos; write it to another folder")
    form = PHOTO.search((sheet or ".png").lower())
    if form is None:
        raise UsageError(f"`contact_sheet`: expected a name that ends in .jpg or .png, found {sheet!r}")
    board, console = Board(options.board, cv2), Console(stderr=True)
    shown = track(shots, "reading photos", count, console=console, transient=True, disable=not console.is_terminal)
    photos = _of_one_size([_seen(shot, board, cv2) for shot in shown])
    if sheet is not None:
        write_file(sheet, bytes(cv2.imencode(form[0], _contact_sheet(photos, cv2))[1]))
        _SHEETS[sheet] = photos
    good = [photo for photo in photos if photo.verdict == "board"]
    bad = _listed([photo for photo in photos if photo.verdict != "board"])
    if not good:
        fix = "check type, squares and dictionary of the board, and that its points are sharp"
        raise InputError(Problem(f"none of {count} photos shows the board of {options.board} ({bad})", path, fix=fix))
    sizes = [len(photo.pixels) for photo in good]
    pixels, points = (np.concatenate(each) for each in zip(*((each.pixels, each.points) for each in good), strict=True))
    columns = [("pose", np.repeat([photo.name for photo in good], sizes))]
    columns += [(name, np.repeat([photo.columns[name] for photo in good], sizes)) for name in good[0].columns]
    columns += [("u_px", pixels[:, 0]), ("v_px", pixels[:, 1])]
    columns += [(f"board_{axis}_m", points[:, i]) for i, axis in enumerate("xyz")]
    remarks = [remark, f"{len(good)} of {len(photos)} photos show the board"]
    table = ColumnTable(columns, path, options.skip_gaps, digest(), "; ".join(filter(None, remarks)))
    table.image_sizes = {str(photo.columns.get("camera", "")): photo.size[1::-1] for photo in good if photo.size}
    if bad:
        table.log.warn(f"photos left out: {bad}", of_file=True)
    return table


def _seen(shot: Shot, board: Board, cv2: Any) -> _Seen:
    if shot.image is None:
        nothing = np.empty((0, 2)), np.empty((0, 3))
        return _Seen(shot.name, "no image", "", *nothing, shot.columns, np.zeros((_WIDTH // 2, _WIDTH, 3), np.uint8))
    pixels, points = board.seen_in(shot.image) if shot.tags is None else board.points_of(shot.tags)
    verdict, detail = board.verdict(shot.image, pixels, points)
    scale = min(_WIDTH / shot.image.shape[1], _HEIGHT / shot.image.shape[0])
    small = cv2.resize(shot.image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    thumbnail = _marked(small, scale * pixels, cv2)
    size = shot.image.shape if shot.tags is None else ()
    return _Seen(shot.name, verdict, detail, pixels, points, shot.columns, thumbnail, size)


def _of_one_size(photos: list[_Seen]) -> list[_Seen]:
    """Return the photos, of which those of another size than most are none of the same lens."""
    sizes: dict[Any, Counter[tuple[int, ...]]] = {}
    for photo in photos:
        if photo.verdict == "board":
            sizes.setdefault(photo.columns.get("camera"), Counter())[photo.size] += 1
    usual = {camera: max(own, key=own.__getitem__) for camera, own in sizes.items()}
    result = []
    for photo in photos:
        most = usual.get(photo.columns.get("camera"), photo.size)
        if photo.verdict == "board" and photo.size != most:
            detail = "{1} x {0} px, most have {3} x {2}".format(*photo.size, *most)
            photo = photo._replace(verdict="another size", detail=detail)
        result.append(photo)
    return result


def _listed(photos: Sequence[_Seen]) -> str:
    """Return the names of photos by what they show in place of the board."""
    reasons = by_key((f"{photo.verdict}{f' ({photo.detail})' * bool(photo.detail)}", photo.label) for photo in photos)
    return "; ".join(f"{listing(names, _NAMED)}: {reason}" for reason, names in reasons.items())


# Contact sheet: the photos small, with the points found in them and what was wrong.

_SHEETS: dict[str, list[_Seen]] = {}
"""Photos of each sheet that was written, to which a fit adds what remains of each."""
_WIDTH, _HEIGHT, _EDGE, _GAP, _TEXT = 240, 240, 6, 8, 60
"""Pixels of a photo at most, of its border, between two photos, and of the text below."""
_LETTERS = 40
"""Letters of a line of this text."""
_COLOURS: Mapping[Verdict, tuple[int, int, int]] = {
    "board": (80, 160, 60),
    "too little of the board": (0, 190, 230),
    "blurred": (0, 140, 255),
    "mirrored print": (200, 60, 200),
    "another board": (200, 110, 30),
    "another size": (140, 140, 140),
    "no board": (60, 60, 220),
    "no image": (0, 0, 0),
}
"""Blue, green, red of the border for what a photo shows."""


def _marked(image: Any, pixels: Array, cv2: Any) -> Any:
    """Return a small grey image in colours, with its points."""
    result = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    for point in np.round(pixels).astype(int).tolist():
        cv2.circle(result, point, 2, (60, 220, 60), -1, cv2.LINE_AA)
    return result


def _contact_sheet(photos: Sequence[_Seen], cv2: Any) -> Any:
    """Return a picture of all photos."""
    across = math.ceil(math.sqrt(1.6 * len(photos)))
    height = max((len(photo.thumbnail) for photo in photos), default=0) + 2 * _EDGE
    down, right = height + _TEXT, _WIDTH + 2 * _EDGE + _GAP
    sheet = np.full((down * math.ceil(len(photos) / across), right * across, 3), 255, np.uint8)
    for number, photo in enumerate(photos):
        top, left = down * (number // across), right * (number % across)
        sheet[top : top + height, left : left + right - _GAP] = _COLOURS[photo.verdict]
        place = sheet[top + _EDGE :, left + _EDGE :]
        place[: photo.thumbnail.shape[0], : photo.thumbnail.shape[1]] = photo.thumbnail
        count = f"{len(photo.pixels)} points" if photo.verdict == "board" else photo.verdict
        for line, text in enumerate((photo.label[-_LETTERS:], count, photo.detail[:_LETTERS]), 1):
            at = (left + _EDGE, top + height + 15 * line)
            cv2.putText(sheet, text, at, cv2.FONT_HERSHEY_SIMPLEX, 0.4, (0, 0, 0), 1, cv2.LINE_AA)
    return sheet


def add_residuals(sheet: str, fit: Fit) -> None:
    """Write a contact sheet again, with the rms residual of each photo after a fit, px.

    Raises:
        InputError: The sheet cannot be written.
    """
    import cv2

    data = fit.data
    if data.seen is None or data.pose is None or data.fixture is None:
        return
    with np.errstate(invalid="ignore", divide="ignore"):  # Rows of other kinds have no depth.
        squares = np.square(fit.residual[:2] / data.seen[3] * data.seen[4]).sum(axis=0)
    cameras = data.fixture if data.target is None else np.where(data.fixture == "board", data.target, data.fixture)
    photos = []
    for photo in _SHEETS.pop(sheet, ()):
        rows = (data.seen[3] > 0.0) & (data.pose == photo.name)
        if (camera := photo.columns.get("camera")) is not None:  # A camera alone has no name in the data.
            rows &= cameras == camera
        is_used = photo.verdict == "board" and rows.any()
        said = f"fit: {math.sqrt(squares[rows].mean()):.2f} px rms" if is_used else photo.detail
        photos.append(photo._replace(detail=said))
    if photos:
        ending = PHOTO.search(sheet.lower())
        write_file(sheet, bytes(cv2.imencode(ending[0] if ending else ".png", _contact_sheet(photos, cv2))[1]))
