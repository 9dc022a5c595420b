"""Tolerances of a robot file as priors of its constants."""

from __future__ import annotations

from robacc.robots.description import Robot


def tolerance_priors(robot: Robot) -> dict[str, float]:
    """Return the robot file's tolerances as prior standard deviations, by coefficient name."""
    priors = {}
    for joint in robot.joints:
        for label, deviation in joint.tolerance.items():
            is_offset = label == joint.offset_parameter
            name = f"joint_offset.{joint.name}" if is_offset else f"link_geometry.{joint.name}.{label}"
            priors[name] = deviation
    return priors
