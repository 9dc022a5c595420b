"""Folders of photos as tables: the points of a printed board that each photo shows, a row for each.

The board (YAML) is ``type: charuco``, ``apriltag`` or ``chessboard`` with ``squares: [7, 5]``, ``square_mm``, and for
the first two ``marker_mm`` and ``dictionary``, one of OpenCV's (``DICT_4X4_50``, ``DICT_APRILTAG_36h11``).
A chessboard has an even number of squares along one side and an odd one along the other; its origin is a black corner.
"""

from __future__ import annotations

import hashlib
import io
import math
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.progress import track

from robacc.errors import InputError, Problem, UsageError, install_advice
from robacc.geometry import Array
from robacc.io.column_table import ColumnTable
from robacc.io.files import read_text
from robacc.io.table import TableOptions
from robacc.io.yaml_nodes import top_section

_SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp"})
_TYPES = ("charuco", "apriltag", "chessboard")
_NAMED = 5
"""Photos that a message names."""
_MOST = 100
"""Squares along a side at most: no camera resolves more."""


def takes(path: str, first: bytes) -> bool:
    """Return whether a folder has photos."""
    return Path(path).is_dir() and bool(_photos(path))


def read(path: str, options: TableOptions) -> ColumnTable:
    """Return the points of the board in the photos of a folder; each photo's name without its end is its pose.

    Raises:
        InputError: A photo or the file of the board cannot be read, or no photo shows the board.
        UsageError: No board is stated, or the extra ``camera`` is not installed.
    """
    try:
        import cv2
    except ImportError:
        raise UsageError(f"{path} has photos, which need OpenCV; run {install_advice('camera')}") from None
    if options.board is None:
        raise UsageError(f"{path} has photos; state the board that they show with `board`")
    board, digest = Board(options.board, cv2), hashlib.sha256()
    poses: list[str] = []
    found: list[tuple[Array, Array]] = []
    without: list[str] = []
    files, console = _photos(path), Console(stderr=True)
    for file in track(files, "reading photos", console=console, transient=True, disable=not console.is_terminal):
        content = file.read_bytes()
        digest.update(content)
        image = cv2.imdecode(np.frombuffer(content, np.uint8), cv2.IMREAD_GRAYSCALE) if content else None
        if image is None:
            raise InputError(Problem("is no photo that OpenCV can read", str(file), fix="take it out of the folder"))
        pixels, points = board.seen_in(image)
        if len(pixels):
            poses += [file.stem] * len(pixels)
            found.append((pixels, points))
        else:
            without.append(file.name)
    if not found:
        fix = "check type, squares and dictionary of the board, and that its points are sharp"
        raise InputError(Problem(f"none of {len(files)} photos shows the board of {options.board}", path, fix=fix))
    pixels, points = (np.concatenate(each) for each in zip(*found, strict=True))
    names = f": {', '.join(without[:_NAMED])}{' …' * (len(without) > _NAMED)}" if without else ""
    remark = f"{len(found)} of {len(files)} photos show the board{' (not' * bool(names)}{names}{')' * bool(names)}"
    columns = [("pose", np.array(poses)), ("u_px", pixels[:, 0]), ("v_px", pixels[:, 1])]
    columns += [(f"board_{axis}_m", points[:, i]) for i, axis in enumerate("xyz")]
    return ColumnTable(columns, path, options.skip_gaps, digest.hexdigest(), remark)


def _photos(path: str) -> list[Path]:
    files = (file for file in Path(path).iterdir() if file.suffix.lower() in _SUFFIXES and file.name[0] != ".")
    return sorted(file for file in files if file.is_file())


class Board:
    """Printed board, and the detector of its points."""

    def __init__(self, path: str, cv2: Any) -> None:
        """Read the file of a board.

        Raises:
            InputError: The file cannot be read or is wrong.
        """
        top = top_section(read_text(path), path, ("type", "squares", "square_mm", "marker_mm", "dictionary"))
        self._cv2, self._type = cv2, top.text("type", _TYPES, needed=True)
        node = top.require("squares")
        squares = None if node is None else top.source.numbers(node, "squares", 2)
        square = top.number("square_mm", lambda size: size > 0, "a size above 0 mm") / 1e3
        if self._type != "chessboard":
            marker = top.number("marker_mm", lambda size: 0 < size < 1e3 * square, "a size below square_mm") / 1e3
            names = [name for name in dir(cv2.aruco) if name.startswith("DICT_")]
            dictionary = top.text("dictionary", names, needed=True)
        least = {"charuco": 2, "apriltag": 1}.get(str(self._type), 4)
        if squares is not None and not all(least <= number <= _MOST and number % 1 == 0 for number in squares):
            top.report(
                "squares", f"expected whole numbers from {least} to {_MOST}, found {squares[0]:g}, {squares[1]:g}"
            )
        elif squares is not None and self._type == "chessboard" and sum(squares) % 2 == 0:
            top.report("squares", "such a chessboard looks the same when it is turned by half", "for example [8, 5]")
        top.source.raise_if_any()
        assert squares is not None
        self._size = (int(squares[0]), int(squares[1]))
        self._square = square
        if self._type != "chessboard":
            needed = self._size[0] * self._size[1] // (2 if self._type == "charuco" else 1)
            known = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, str(dictionary)))
            if needed > len(known.bytesList):
                message = f"the board needs {needed} markers, and the dictionary has {len(known.bytesList)}"
                raise InputError(Problem(message, path, column="dictionary", fix="name a larger one of its kind"))
            if self._type == "charuco":
                self._board = cv2.aruco.CharucoBoard(self._size, square, marker, known)
                self._detector = cv2.aruco.CharucoDetector(self._board)
            else:
                self._board = cv2.aruco.GridBoard(self._size, marker, square - marker, known)
                fine = cv2.aruco.DetectorParameters()
                fine.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_APRILTAG
                self._detector = cv2.aruco.ArucoDetector(known, fine)

    def seen_in(self, image: Any) -> tuple[Array, Array]:
        """Return pixels ``(K, 2)`` and points ``(K, 3)``, m, of the board in a grey image; none if it is not there."""
        pixels: Any = None
        points: Any = None
        if self._type == "chessboard":
            inner = (self._size[0] - 1, self._size[1] - 1)
            is_seen, pixels = self._cv2.findChessboardCornersSB(image, inner)
            if is_seen:
                corners = pixels.reshape(inner[1], inner[0], 2)
                inside = np.array([corners[:2, :2].mean(axis=(0, 1)), corners[-2:, -2:].mean(axis=(0, 1))])
                first, last = (float(image[round(v), round(u)]) for u, v in inside.tolist())
                pixels = pixels if first < last else pixels[::-1]  # The square across from a black corner is black.
            grid = [(x, y, 0.0) for y in range(1, inner[1] + 1) for x in range(1, inner[0] + 1)]
            points = self._square * np.array(grid) if is_seen else None
        elif self._type == "charuco":
            pixels, ids, _, _ = self._detector.detectBoard(image)
            points = None if ids is None else self._board.getChessboardCorners()[ids.ravel()]
        else:
            corners, ids, _ = self._detector.detectMarkers(image)
            points, pixels = (None, None) if ids is None else self._board.matchImagePoints(corners, ids)
        if points is None or pixels is None:
            return np.empty((0, 2)), np.empty((0, 3))
        return np.asarray(pixels, dtype=float).reshape(-1, 2), np.asarray(points, dtype=float).reshape(-1, 3)


_PAGE = (297.0, 210.0)
"""mm, of A4."""
_INCH = 25.4
"""mm"""
_EDGE, _RULER = 12.0, 100.0
"""mm: what printers leave white, and the length of the ruler."""
_LEAST = 10
"""mm: a marker of three quarters of it has modules of 1 mm, which a camera half a metre away resolves."""
_DOTS = 10
"""Dots of the picture to the mm."""
_BOARD = """# Board of board.pdf. If its ruler is not {ruler:g} mm long, correct both sizes in proportion.
type: charuco
squares: [{columns}, {rows}]
square_mm: {square:g}
marker_mm: {marker:g}
dictionary: DICT_5X5_250
"""
_CAMERA = """# mount: hand if the arm moves the camera; world if it stands beside the arm, which moves the board.
mount: hand
# The photos show the lens. If it was calibrated, state it instead (px; distortion k1, k2, p1, p2, k3):
# fx: 1400
# fy: 1400
# cx: 960
# cy: 540
# distortion: [0, 0, 0, 0, 0]
"""


def printed(squares: str) -> dict[str, str | bytes]:
    """Return a ChArUco board as a page in true size with a ruler, its file and that of a camera, by their names.

    Args:
        squares: Their numbers along x and y, such as ``7x5``.

    Raises:
        UsageError: The numbers are none, or the extra ``camera`` or ``report`` is not installed.
    """
    numbers = re.fullmatch(r"(\d{1,2})x(\d{1,2})", squares.strip().lower())
    columns, rows = map(int, numbers.groups()) if numbers else (0, 0)
    width, height = _PAGE if columns >= rows else _PAGE[::-1]
    square = math.floor(min((width - 2 * _EDGE) / max(columns, 1), (height - 3 * _EDGE) / max(rows, 1)))
    if min(columns, rows) < 3 or square < _LEAST:
        raise UsageError(
            f"`board`: expected two numbers of squares from 3, each square {_LEAST} mm or more on A4, such as 7x5, "
            f"found {squares!r}"
        )
    text = _BOARD.format(ruler=_RULER, columns=columns, rows=rows, square=square, marker=math.floor(0.75 * square))
    out = io.BytesIO()
    page_of(columns, rows, square, (width, height)).savefig(out, format="pdf", metadata={"CreationDate": None})
    return {"board.pdf": out.getvalue(), "board.yaml": text, "camera.yaml": _CAMERA}


def page_of(columns: int, rows: int, square: int, page: tuple[float, float]) -> Any:
    """Return the figure of a page (mm) with a ChArUco board of squares (mm) in true size, and a ruler below it.

    Raises:
        UsageError: The extra ``camera`` or ``report`` is not installed.
    """
    try:
        import cv2
        from matplotlib.figure import Figure
    except ImportError:
        advice = f"{install_advice('camera')}, and likewise report"
        raise UsageError(f"a board to print needs OpenCV and matplotlib; run {advice}") from None
    marker, (width, height) = math.floor(0.75 * square), page
    known = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_250)
    board = cv2.aruco.CharucoBoard((columns, rows), float(square), float(marker), known)
    across, up = columns * square, rows * square
    picture = board.generateImage((_DOTS * across, _DOTS * up))
    figure = Figure(figsize=(width / _INCH, height / _INCH))
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    left, low = (width - across) / 2, 2 * _EDGE + (height - 3 * _EDGE - up) / 2
    axes.imshow(
        picture, cmap="gray", extent=(left, left + across, low, low + up), interpolation="nearest", aspect="auto"
    )
    axes.set(xlim=(0.0, width), ylim=(0.0, height))
    axes.set_axis_off()
    for mm in range(int(_RULER) + 1):
        axes.plot([left + mm] * 2, [_EDGE, _EDGE + (4.0 if mm % 10 == 0 else 2.0)], color="black", linewidth=0.4)
    text = (
        f"{_RULER:g} mm: measure it after printing.  {columns} x {rows} squares of {square} mm, markers of {marker} mm"
    )
    axes.text(left + _RULER + 5.0, _EDGE, text, fontsize=7)
    return figure


def lens(
    boards: Sequence[Array], images: Sequence[Array], size: Sequence[int]
) -> tuple[tuple[float, float], tuple[float, float], tuple[float, ...]]:
    """Return focal lengths, centre and distortion of the lens with which photos show a flat board best (Z. Zhang 2000).

    Args:
        boards: Points of the board ``(K, 3)`` of each photo.
        images: Their images ``(K, 2)``, px.
        size: Width and height, px.

    Raises:
        UsageError: The extra ``camera`` is not installed.
        ValueError: The photos do not show the lens.
    """
    try:
        import cv2
    except ImportError:
        message = f"the lens of a camera without fx needs opencv: {install_advice('camera')}"
        raise UsageError(message) from None
    flat, seen = ([np.ascontiguousarray(points, dtype=np.float32) for points in each] for each in (boards, images))
    shape: Any = tuple(map(int, size))
    try:
        _, matrix, distortion, *_ = cv2.calibrateCamera(flat, seen, shape, None, None)
    except cv2.error as error:
        raise ValueError("the photos do not show the lens of the camera") from error
    (fx, _, cx), (_, fy, cy), _ = matrix.tolist()
    return (fx, fy), (cx, cy), tuple(distortion.ravel()[:5].tolist())
