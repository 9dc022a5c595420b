"""Photos of printed boards on a table, drawn by OpenCV's warp of the flat board: what a camera on the hand sees."""

from functools import cache

import numpy as np
import pytest
from homogeneous import shift, turn
from independent_arm import link_frames

cv2 = pytest.importorskip("cv2")

MIDDLE = np.array([0.2, 0.3, -0.2, 0.3, 0.9, 0.1])
REACH = np.array([0.4, 0.4, 0.4, 0.8, 0.6, 0.8])
"""Half the ranges of the joints around the middle, rad."""
TOOL = shift(0.05, -0.03, 0.12) @ turn(2, 0.4)
AHEAD = shift(-0.09, -0.06, 0.55) @ turn(0, 0.3)
"""The board in the camera, in the middle."""
CAMERA = "fx: 1000\nfy: 1000\ncx: 639.5\ncy: 479.5\nmount: hand\n"
LENS = np.array([[1000.0, 0.0, 639.5], [0.0, 1000.0, 479.5], [0.0, 0.0, 1.0]])
SIZE = (1280, 960)
SCALE = 10
"""Pixels of the print to the mm."""
BOARDS = {
    "charuco": "type: charuco\nsquares: [6, 4]\nsquare_mm: 30\nmarker_mm: 22\ndictionary: DICT_4X4_50\n",
    "apriltag": "type: apriltag\nsquares: [4, 3]\nsquare_mm: 45\nmarker_mm: 35\ndictionary: DICT_APRILTAG_36h11\n",
    "chessboard": "type: chessboard\nsquares: [8, 5]\nsquare_mm: 22\n",
}


def printed(kind: str) -> np.ndarray:
    """Picture of the board with a margin of 10 mm; its origin is the board's."""
    if kind == "chessboard":
        squares = np.add.outer(np.arange(5), np.arange(8)) % 2 * 255
        picture = np.kron(squares, np.ones((22 * SCALE, 22 * SCALE))).astype(np.uint8)
    elif kind == "charuco":
        known = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
        picture = cv2.aruco.CharucoBoard((6, 4), 0.03, 0.022, known).generateImage((180 * SCALE, 120 * SCALE))
    else:
        known = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
        picture = cv2.aruco.GridBoard((4, 3), 0.035, 0.01, known).generateImage((170 * SCALE, 125 * SCALE))
    return np.pad(picture, 10 * SCALE, constant_values=255)


@cache
def photos(kind: str, count: int, zeros: tuple[float, ...]) -> tuple[np.ndarray, list[np.ndarray]]:
    """Joints ``(count, 6)`` at which the board is in the picture, and photos of an arm whose zeros are off."""
    generator, picture = np.random.default_rng(4), printed(kind)
    base = np.linalg.inv(AHEAD) @ np.linalg.inv(link_frames(MIDDLE + zeros)[-1] @ TOOL)
    joints, taken = [], []
    # From a pixel of the print, whose corners lie half a pixel outside of its middle, to m on the board.
    on_board = np.array([[1.0, 0.0, 0.5 - 10 * SCALE], [0.0, 1.0, 0.5 - 10 * SCALE], [0.0, 0.0, 1e3 * SCALE]])
    while len(taken) < count:
        q = MIDDLE + REACH * generator.uniform(-1.0, 1.0, 6)
        board = np.linalg.inv(base @ link_frames(q + zeros)[-1] @ TOOL)
        corners = board[:3, :3] @ np.array([(x, y, 0.0) for x in (0.0, 0.2) for y in (0.0, 0.13)]).T + board[:3, 3:]
        pixels = LENS @ corners / corners[2]
        if (
            corners[2].min() > 0.3
            and board[2, 2] > 0.6
            and np.all((pixels[:2].T > 30) & (np.array(SIZE) - 30 > pixels[:2].T))
        ):
            warp = LENS @ board[:3][:, [0, 1, 3]] @ on_board
            photo = cv2.warpPerspective(picture, warp, SIZE, flags=cv2.INTER_AREA, borderValue=255)
            taken.append(cv2.GaussianBlur(photo, (0, 0), 0.8))
            joints.append(q)
    return np.array(joints), taken
