"""Kinematics of any described robot by products of matrices, with errors of its parameters; no chain of the package."""

from collections.abc import Mapping

import numpy as np
from homogeneous import frame, shift, turn
from scipy.spatial.transform import Rotation

from robacc import Robot
from robacc.robots.description import Frame, Joint

Errors = Mapping[str, float | np.ndarray]
"""Of one frame or joint, by the parameter's name."""


def frame_with(value: Frame, errors: Errors) -> np.ndarray:
    xyz = [value.xyz[i] + errors.get(name, 0.0) for i, name in enumerate("xyz")]
    nominal = frame(xyz, value.rpy)
    for axis, name in enumerate(("roll", "pitch", "yaw")):
        nominal = nominal @ turn(axis, errors.get(name, 0.0))
    return nominal


def link(joint: Joint, convention: str, q: float | np.ndarray, errors: Errors) -> np.ndarray:
    """A joint's transform from the textbook's definition, each parameter with its errors ``(M,)``; no chain."""
    p = {name: value + errors.get(name, 0.0) for name, value in joint.parameters.items()}
    if convention == "urdf":
        xyz, rpy = ([joint.parameters[k] for k in names] for names in ("xyz", ("roll", "pitch", "yaw")))
        before = frame_with(Frame(tuple(xyz), tuple(rpy)), errors)
        if joint.type == "fixed":
            return before
        angle = np.atleast_1d(q + p["offset"])
        result = np.tile(np.eye(4), (angle.size, 1, 1))
        result[:, :3, :3] = Rotation.from_rotvec(angle[:, None] * np.array(joint.axis)).as_matrix()
        return before @ result
    p["theta" if joint.type == "revolute" else "d"] += joint.sign * q
    z = turn(2, p["theta"]) @ shift(z=p["d"])
    x, along, y = turn(0, p["alpha"]), shift(p["a"]), turn(1, p.get("beta", 0.0))
    return z @ along @ x @ y if convention == "standard" else x @ along @ y @ z


def forward(robot: Robot, q: np.ndarray, errors: Mapping[str, Errors]) -> np.ndarray:
    """Poses ``(M, 4, 4)`` of the tool at joints ``(J,)`` or ``(J, M)``, with errors by owner and parameter."""
    pose = np.eye(4)[None] @ frame_with(robot.base, errors.get("base", {}))
    values = iter(q)
    for joint in robot.joints:
        joint_errors = errors.get(joint.name, {})
        pose = pose @ link(joint, robot.convention, next(values) if joint.is_variable else 0.0, joint_errors)
    return pose @ frame_with(robot.tool, errors.get("tool", {}))
