"""Photos of boards: what the reader of poses and the model know of them; the rest is a plug-in of ``robacc.boards``."""

import re
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from robacc.errors import Note
from robacc.geometry import Array, Poses, compose, log_so3, nearest_rotation, transpose
from robacc.measurements import Measurements, even_rows
from robacc.plug_ins import plug_in
from robacc.poses.reshaped_tables import unit_and_error

PHOTO = re.compile(r"\.(?:bmp|jpe?g|png|tiff?|webp)$")
"""End of the name of a photo, in small letters."""
BOARDS = "robacc.boards"
"""Group of entry points of what finds boards in photos, reads the cameras, and gives the poses that images show."""


def projection(position: Array) -> Array:
    """Return the derivative ``(2, 3, N)`` of the rays x/z, y/z of positions ``(3, N)`` in the camera."""
    x, y, z = position
    zero = np.zeros_like(z)
    return np.stack((np.stack((1 / z, zero, -x / z**2)), np.stack((zero, 1 / z, -y / z**2))))


# Poses of a board in a camera on the hand, as hand-eye calibrations write them.


def seen_from_board(
    data: Measurements, camera: str | None, poses_of: Callable[[Measurements], tuple[Array | None, Array | None]]
) -> Measurements:
    """Return measured poses of a board in a camera on the hand as those of the camera in the board; others as they are.

    The file ``camera`` may state the mount. If not, the motion of the arm from each commanded pose to the next shows
    it: its turns are the commanded ones in axes that stand still in what turns (Shiu and Ahmad 1989). ``poses_of``
    returns the commanded positions and orientations of rows. Positions that follow them are those of the hand.

    Raises:
        InputError: The file cannot be read or is wrong.
    """
    if data.rotation is None:
        return data
    is_on_hand = camera is not None and all(each.is_on_hand for each in plug_in(BOARDS, "cameras")(camera).values())
    # Three turns determine the axes and test them; a thousand decide well enough.
    rows = even_rows(data.n, 1000)
    place, turn = poses_of(data.subset(rows))
    if (
        turn is not None
        and camera is None
        and data.n > 3
        and unit_and_error(data.position[:, rows], place, turn)[0] is None
    ):
        arm, measured = _turns(turn), data.rotation[..., rows]
        seen = [_turns(rotation) for rotation in (measured, transpose(measured))]
        as_given, inverted = (np.linalg.norm(arm - nearest_rotation(arm @ turns.T) @ turns) for turns in seen)
        # One reading must follow the arm much better than the other, as for any mistake in data.
        is_on_hand = bool(8.0 * inverted < as_given)
    if not is_on_hand:
        return data
    inverse = Poses(data.rotation, data.position).inverse()
    note = Note(
        f"{data.source}: the measured poses are taken as those of a board in a camera on the hand, and turned into "
        "those of the camera in the board"
    )
    return replace(data, position=inverse.translation, rotation=inverse.rotation, warnings=(*data.warnings, note))


def _turns(rotation: Array) -> Array:
    """Return the rotation vectors ``(3, N - 1)`` of the turns to each next pose, in the axes of what turns."""
    return log_so3(compose(transpose(rotation[..., :-1]), rotation[..., 1:]))
