"""Best model that a controller can take, and the error that remains because it cannot take everything.

The parameters that the format has are fitted again to poses of the complete model, so that they take up what they can
of the effects that the format lacks; those effects are not just cut off.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from robacc.accuracy.pose_errors import pose_metrics
from robacc.effects.base import Effect
from robacc.effects.joint_offset import JointOffset
from robacc.effects.link_geometry import LinkGeometry
from robacc.errors import RobaccError
from robacc.fitting.fit_result import Options
from robacc.fitting.parameters import absorb_constants, apply_fit
from robacc.fitting.solver import fit
from robacc.geometry import log_between
from robacc.modelling.model import Model, predict
from robacc.robots.description import Frame, Robot
from robacc.simulation.simulate import Plan, simulate

FIT_POSES = 400
CHECK_POSES = 1000
_SEEDS = (11, 12)
"""Seeds of the poses for the fit and of those for the remaining error."""


@dataclass(frozen=True, slots=True)
class RemainingError:
    """Difference between a complete model and what the controller takes, over poses within the joint limits."""

    poses: int
    position_rms: float
    """m"""
    position_max: float
    orientation_rms: float
    """rad"""
    orientation_max: float


@dataclass(frozen=True, slots=True)
class Restricted:
    """Model that a controller can take."""

    robot: Robot
    """Arm without effects."""
    complete: Robot
    """Arm with the effects that were fitted to; constants are in its numbers."""
    refitted: tuple[str, ...]
    """Effects that the parameters take up as far as they can."""
    excluded: tuple[str, ...]
    """Effects that are left out: they depend on circumstances that a pose alone does not have."""


def kinematic_part(robot: Robot) -> Restricted:
    """Return the arm with all geometry free, fitted to the robot's effects; exact where there are only constants."""
    return _restricted(robot, dataclasses.replace(absorb_constants(robot), effects=()), geometry=True)


def offsets_only(robot: Robot, nominal: Robot) -> Restricted:
    """Return the nominal arm with joint offsets fitted to the robot, base and tool as in the robot.

    Raises:
        UsageError: The two have different joints.
    """
    start = absorb_constants(nominal)
    start = dataclasses.replace(start, base=robot.base, tool=robot.tool, targets=robot.targets, effects=())
    return _restricted(robot, start, geometry=False)


def remaining_error(complete: Robot, controller: Robot) -> RemainingError:
    """Return the difference of the poses of two arms within the joint limits of the first."""
    data = simulate(_single_target(complete), Plan(CHECK_POSES, seed=_SEEDS[1])).data
    attained = predict(_single_target(controller), dataclasses.replace(data, target=None))
    rotation = data.rotation
    assert rotation is not None
    errors = pose_metrics(np.vstack((attained.translation - data.position, log_between(attained.rotation, rotation))))
    assert errors.orientation is not None
    return RemainingError(
        data.n, errors.position.rms, errors.position.max, errors.orientation.rms, errors.orientation.max
    )


def _restricted(robot: Robot, start: Robot, *, geometry: bool) -> Restricted:
    complete, excluded = _predictable(absorb_constants(robot))
    names = tuple(str(effect.get("effect", "?")) for effect in complete.effects)
    if geometry and not complete.effects:
        return Restricted(start, complete, (), excluded)
    data = simulate(_single_target(complete), Plan(FIT_POSES, seed=_SEEDS[0])).data
    model = Model.of(_single_target(start))
    joints = model.arm.names
    free: list[Effect] = [JointOffset(joints)]
    if geometry:
        free.append(LinkGeometry(joints))
    solution = fit(model.with_free(*free), data, Options(robust=False))
    fitted = dataclasses.replace(apply_fit(solution), tool=start.tool, targets=start.targets)
    return Restricted(fitted, complete, names, excluded)


def _predictable(robot: Robot) -> tuple[Robot, tuple[str, ...]]:
    """Return the robot with the effects that a joint pose decides, and the names of the others."""
    kept, excluded = [], []
    for entry in robot.effects:
        try:
            simulate(_single_target(dataclasses.replace(robot, effects=(entry,))), Plan(2, seed=_SEEDS[0]))
        except RobaccError:
            excluded.append(str(entry.get("effect", "?")))
        else:
            kept.append(entry)
    return dataclasses.replace(robot, effects=tuple(kept)), tuple(excluded)


def _single_target(robot: Robot) -> Robot:
    """Return the robot with its flange as the only target, where it has several."""
    return dataclasses.replace(robot, targets={}, tool=Frame()) if robot.targets else robot
