"""Registration of the commanded poses before errors are judged, and the sign that it is missing."""

from __future__ import annotations

from collections.abc import Sequence

from robacc.errors import RobaccError
from robacc.fitting.registration import Alignment
from robacc.geometry import Array, rms_length
from robacc.measurements import Measurements
from robacc.robots.description import Robot

_FAR = 0.05
"""Position error relative to the extent of the poses above which the cause is a frame or a unit, not the arm (whose
errors are some mm on a reach of a metre)."""


def register(data: Measurements, robot: Robot | None, frames: Sequence[str], *, held_out: bool = False) -> Alignment:
    """Fit ``frames`` of the robot, or without a robot of the commanded poses, to the measured poses.

    See :func:`robacc.fitting.registration.align`.
    """
    from robacc.fitting import registration

    if robot is None:
        return registration.align_commands(data, frames, held_out=held_out)
    return registration.align(robot, data, frames, held_out=held_out)


def too_far(error: float, position: Array) -> bool:
    """Return whether an error in m is too large for an arm that moved between the positions ``(3, N)``."""
    return error > _FAR * rms_length(position - position.mean(axis=1, keepdims=True))


def frames_to_register(data: Measurements, robot: Robot | None, error: float) -> tuple[str, ...]:
    """Return frames that take a position error in m that no arm has to one that an arm may have; none otherwise."""
    if not too_far(error, data.position):
        return ()
    for frames in (("base_frame", "tool_frame"), ("base_frame",)):
        try:
            commanded = register(data, robot, frames).commanded
        except RobaccError:
            continue
        registered = rms_length(data.position - commanded.translation)
        if registered < _FAR * error and not too_far(registered, data.position):
            return frames
    return ()


def unregistered_warning(registered: bool) -> str:
    """Return the warning of errors that are too large for an arm."""
    if registered:
        return (
            "the errors are too large for an arm: check the units, the joint signs, the order of the joints, that each "
            "row has its own command, and that the axes are right-handed"
        )
    advice = 'register the frames with `align="base_frame,tool_frame"`'
    return f"the errors are too large for an arm and suggest frames that are not registered; {advice}"
