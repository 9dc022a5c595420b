"""Printed boards: their points in a photo, or why it shows none; their print in true size; and the lens they show.

The board (YAML) is ``type: charuco``, ``apriltag`` or ``chessboard`` with ``squares: [7, 5]``, ``square_mm``, and for
the first two ``marker_mm`` and ``dictionary``, one of OpenCV's (``DICT_4X4_50``, ``DICT_APRILTAG_36h11``).
A chessboard has an even number of squares along one side and an odd one along the other; its origin is a black corner.
"""

from __future__ import annotations

import io
import math
import re
from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from robacc.errors import InputError, Problem, UsageError, install_advice, refuse
from robacc.geometry import Array
from robacc.io.files import read_text
from robacc.io.yaml_nodes import top_section
from robacc_plugins.cameras import FEWEST_POINTS

Verdict = Literal[
    "board",
    "no board",
    "no image",
    "blurred",
    "another board",
    "another size",
    "mirrored print",
    "too little of the board",
]
"""What a photo shows."""
_TYPES = ("charuco", "apriltag", "chessboard")
_MOST = 100
"""Squares along a side at most: no camera resolves more."""
_OTHERS = ("4X4_250", "5X5_250", "6X6_250", "7X7_250", "APRILTAG_36h11", "APRILTAG_25h9", "ARUCO_ORIGINAL")
"""Dictionaries of boards that may be in a photo by mistake."""
_FEW = 2
"""Markers that are no accident of the background."""
_ACCIDENTS = 10
"""Squares without a known marker for each that looks like one, at least: small codes are found in any clutter."""
_CONTRAST = 40.0
"""Grey levels that a photo with a board has at least."""
_WIDEST_EDGE = 4.5
"""px, standard deviation of the widest edges at which markers are still read; those of sharp photos have 2 to 3."""
_OFF_PLANE = 0.02
"""Distance of points from a plane in a photo as a share of their extent, which no lens distorts as much."""


class Board:
    """Printed board, and the detector of its points."""

    def __init__(self, path: str, cv2: Any) -> None:
        """Read the file of a board.

        Raises:
            InputError: The file cannot be read or is wrong.
        """
        top = top_section(read_text(path), path, ("type", "squares", "square_mm", "marker_mm", "dictionary"))
        self._cv2, self._type, self._others = cv2, top.text("type", _TYPES, needed=True), [*_OTHERS]
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
            self._ids, self._known = needed, known
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

    def points_of(self, tags: Mapping[int, Array]) -> tuple[Array, Array]:
        """Return pixels ``(K, 2)`` and points ``(K, 3)``, m, of AprilTags with these corners ``(4, 2)``, as OpenCV's.

        Raises:
            UsageError: The board has other points than corners of tags.
        """
        found = "the messages have AprilTags that another program found; `board` must be of type apriltag"
        refuse((self._type != "apriltag", f"{found}, found {self._type}"))
        own = {number: corners for number, corners in tags.items() if 0 <= number < self._ids}
        if not own:
            return np.empty((0, 2)), np.empty((0, 3))
        corners = [np.asarray(each, dtype=np.float32)[None] for each in own.values()]
        points, pixels = self._board.matchImagePoints(corners, np.array([*own], dtype=np.int32)[:, None])
        return np.reshape(np.array(pixels, dtype=float), (-1, 2)), np.reshape(np.array(points, dtype=float), (-1, 3))

    def verdict(self, image: Any, pixels: Array, points: Array) -> tuple[Verdict, str]:
        """Return whether these points show the board in a grey image, else why they do not, and what is there."""
        if len(pixels) >= FEWEST_POINTS and np.linalg.matrix_rank(points - points[0], 1e-9) > 1:
            plane, _ = self._cv2.findHomography(points[:, :2], pixels)
            flat = np.full_like(pixels, np.inf)
            if plane is not None:
                flat = self._cv2.perspectiveTransform(points[:, None, :2], plane)[:, 0]
            if np.median(np.abs(flat - pixels)) <= _OFF_PLANE * np.ptp(pixels, axis=0).max():
                return "board", ""
            return "another board", "its points are at other places"
        seen, rejected = self._ids_in(image)
        few = max(_FEW, rejected // _ACCIDENTS)
        mirrored, _ = self._ids_in(self._cv2.flip(image, 1))
        if np.count_nonzero(mirrored < self._ids) > max(few, seen.size):
            return "mirrored print", ""
        if seen.size >= few and np.mean(seen >= self._ids) > 0.5:
            return "another board", f"markers {seen.min()} to {seen.max()}, expected 0 to {self._ids - 1}"
        if seen.size > max(few, FEWEST_POINTS):
            return "another board", "its markers are at other places"
        if len(pixels) or seen.size >= few:
            return "too little of the board", f"{max(len(pixels), seen.size)} of its points or markers"
        for name in self._others if rejected >= _FEW else ():
            if self._ids_in(image, name)[0].size > few:
                self._others.sort(key=name.__ne__)  # One wrong board is in several photos.
                return "another board", f"markers of DICT_{name.removesuffix('_250')}"
        return ("blurred" if self._is_blurred(image) else "no board"), ""

    def _ids_in(self, image: Any, dictionary: str = "") -> tuple[NDArray[np.int64], int]:
        """Return the markers ``(K,)`` of the board's own or another dictionary, and how many squares are none of it."""
        if self._type == "chessboard":
            return np.empty(0, dtype=np.int64), 0
        aruco = self._cv2.aruco
        known = aruco.getPredefinedDictionary(getattr(aruco, f"DICT_{dictionary}")) if dictionary else self._known
        _, ids, rejected = aruco.ArucoDetector(known).detectMarkers(image)
        return np.unique(np.array([] if ids is None else ids, dtype=np.int64)), len(rejected)

    def _is_blurred(self, image: Any) -> bool:
        """Return whether the steepest edges of an image are wide in some direction, as defocus and motion make them."""
        smooth = self._cv2.GaussianBlur(image.astype(np.float32), (0, 0), 1.5)
        across, down = (self._cv2.Sobel(smooth, self._cv2.CV_32F, *way, scale=1 / 8) for way in ((1, 0), (0, 1)))
        low, high = np.percentile(smooth[::4, ::4], (1, 99))
        slopes = (across, down, (across + down) / math.sqrt(2.0), (across - down) / math.sqrt(2.0))
        steepest = min(float(np.percentile(np.abs(slope), 99.9)) for slope in slopes)
        return bool(high - low > max(_CONTRAST, _WIDEST_EDGE * math.sqrt(2.0 * math.pi) * steepest))


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
