"""Direction of gravity where the measuring frame is not level.

A robot file states gravity in the measuring frame. Cameras and trackers are often not level, or have another axis up;
registration then finds the base tilted. Either the robot leans or the measuring frame does, and the deflections of the
arm under its own weight tell which, if the poses show them.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator
from typing import cast

import numpy as np

from robacc.effects.joint_compliance import JointCompliance
from robacc.errors import RobaccError
from robacc.fitting.closed_form import register_frames
from robacc.fitting.fit_result import Fit, Options
from robacc.fitting.solver import fit
from robacc.geometry import Array, rotation_from_rpy
from robacc.gravity.torques import LEVEL
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.robots.arm import Arm
from robacc.robots.description import Robot, Vector

_DECISIVE = 10.0
"""Log likelihood ratio that decides against the robot file (odds of 20,000 to 1) …"""
_PER_COMPONENT = 0.07
"""… if it is also so much for each measured component: errors lower by 7 %. In frames turned by 20 and 90 degrees, arms
of a physics engine reach 0.05 by errors that are not white noise, and 0.1 or more by springs."""


def with_gravity_direction(model: Model, data: Measurements) -> Model:
    """Return the model with gravity along the base where the deflections show that the measuring frame is not level.

    Springs at all joints are fitted with the free effects, with gravity as the robot file states it in the measuring
    frame, with gravity turned as registration turned the base, and along the base's own axis. The robot file holds
    unless another direction fits better by odds of 20,000 to 1 and leaves errors at least 7 % smaller.

    Raises:
        InputError: There are too few poses for the free effects.
    """
    robot = model.arm.robot
    names = {effect.name for effect in model.free}
    turned = register_frames(robot, data, "base_frame" in names, "tool_frame" in names)
    others = list(_other_directions(robot, turned))
    first = _with_springs(robot.gravity, model, data, None) if others else None
    if first is None:
        return model
    # Rows that one direction leaves out as outliers and another does not would decide otherwise.
    kept = data.subset(np.flatnonzero(first.inliers))
    stated = _with_springs(robot.gravity, model, kept, first)
    fits = [(_with_springs(other, model, kept, first), other) for other in others]
    worth = [(_worth(stated, one), other) for one, other in fits if one is not None and stated is not None]
    best = max(worth, default=(0.0, robot.gravity), key=lambda entry: entry[0])
    if best[0] < _decisive(kept):
        return model
    arm = Arm.of(dataclasses.replace(robot, gravity=best[1]))
    return dataclasses.replace(model, arm=arm)


def _decisive(data: Measurements) -> float:
    """Return the log likelihood ratio that decides on these poses."""
    return max(_DECISIVE, _PER_COMPONENT * data.n * (3 if data.rotation is None else 6))


def fit_frames(model: Model, data: Measurements) -> Fit:
    """Return the fit of base, tool or both of a model with known effects, with gravity as the poses show it.

    Raises:
        InputError: There are too few poses.
    """
    robot = model.arm.robot
    stated = fit(model, data, Options())
    if not model.known:
        return stated
    best, most = stated, _decisive(data)
    for other in _other_directions(robot, stated.model.arm.robot):
        turned = dataclasses.replace(model, arm=Arm.of(dataclasses.replace(robot, gravity=other)))
        one = fit(turned, data, Options())
        if (worth := _worth(stated, one)) >= most:
            best, most = one, worth
    return best


def _other_directions(robot: Robot, turned: Robot) -> Iterator[Vector]:
    """Yield gravity turned as registration turned the base, and downwards along the base, where they differ."""
    stated = np.array(robot.gravity)
    size = float(np.linalg.norm(stated))
    before, after = (rotation_from_rpy(np.array(r.base.rpy)) for r in (robot, turned))
    known = [stated]
    for direction in (after @ before.T @ stated, -size * after[:, 2]):
        if size and all(_angle(direction, other) > LEVEL for other in known):
            known.append(direction)
            yield cast(Vector, tuple(direction.tolist()))


def _angle(one: Array, other: Array) -> float:
    """Return the angle between two vectors, rad."""
    return math.atan2(float(np.linalg.norm(np.cross(one, other))), float(one @ other))


def _with_springs(gravity: Vector, model: Model, data: Measurements, like: Fit | None) -> Fit | None:
    """Return the fit with springs at all joints under a gravity; None if the poses do not allow one.

    With the misfit of the fit ``like`` and of all rows if it is given, else with its own and without outliers.
    """
    arm = Arm.of(dataclasses.replace(model.arm.robot, gravity=gravity))
    springs = dataclasses.replace(JointCompliance.default(arm, data), deflection="rigid")  # type: ignore[call-arg]
    free = (*(effect for effect in model.free if effect.name != springs.name), springs)
    options = Options(tolerance=1e-4) if like is None else Options(tolerance=1e-4, misfit=like.misfit, robust=False)
    try:
        return fit(dataclasses.replace(model, arm=arm, free=free), data, options)
    except RobaccError:
        return None


def _worth(stated: Fit, other: Fit) -> float:
    """Return the log likelihood ratio of ``other`` over ``stated`` on the rows that both keep.

    Upside down, the same deflections need springs of negative compliance, which none is.
    """
    rows = stated.inliers & other.inliers
    before, after = (float(np.sum(np.square(one.residual * stated.weight)[:, rows])) for one in (stated, other))
    components = float(np.count_nonzero(rows) * stated.residual.shape[0])
    ratio = 0.5 * components * math.log(max(before, 1e-300) / max(after, 1e-300))
    return ratio + _cost_of_signs(stated) - _cost_of_signs(other)


def _cost_of_signs(one: Fit) -> float:
    """Return what it costs in log likelihood to set each negative compliance of known masses to zero."""
    values = (
        {f"{JointCompliance.name}.{joint}" for joint in one.model.arm.names} if one.model.arm.chain.bodies else set()
    )
    cost = 0.0
    for name, value, var in zip(one.names, one.theta.tolist(), np.diag(one.covariance).tolist(), strict=True):
        if name in values and value < 0.0 and var > 0.0:
            cost += 0.5 * value**2 / var
    return cost


def gravity_warning(stated: Vector, shown: Vector) -> tuple[str, ...]:
    """Return that gravity is not as the robot file states it, and what to do; empty if it is."""
    if stated == shown:
        return ()
    angle = math.degrees(_angle(np.array(stated), np.array(shown)))
    numbers = ", ".join(f"{value:.3g}" for value in shown)
    return (
        f"the measuring frame is not level: the deflections of the arm show gravity {angle:.3g} degrees from the "
        f"direction in the robot file; gravity: [{numbers}] is used instead, so state it in the robot file, or level "
        "the measuring frame",
    )
