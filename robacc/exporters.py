"""Exporters: plug-ins that write a model as text, fitted again to what their format holds.

An exporter is a function of an arm without effects, and an entry point of the group ``robacc.exporters`` by the name of
its format. Effects that the format lacks are not just cut off: the parameters that it has are fitted again to poses of
the complete model, so that they take up what they can.
"""

import dataclasses
import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from robacc.accuracy.estimation import pose_metrics
from robacc.effects.base import Effect
from robacc.effects.frames import JointOffset, LinkGeometry
from robacc.errors import RobaccError, UsageError
from robacc.fitting.fit_result import Options
from robacc.fitting.parameters import absorb_constants, apply_fit
from robacc.fitting.solver import fit
from robacc.geometry import log_between
from robacc.modelling.model import Model, predict
from robacc.plug_ins import plug_in, plug_in_names
from robacc.robots.description import Frame, Robot
from robacc.simulation.simulate import Plan, simulate

GROUP = "robacc.exporters"
_SEEDS = (11, 12)
"""Seeds of the poses for the fit and of those for the remaining error."""


class Written(NamedTuple):
    """What an exporter returns; a plain pair of its first two fields will do."""

    text: str
    losses: Sequence[str] = ()
    """A line for each part of the model that the text leaves out."""
    controller: Robot | None = None
    """Arm that the text describes, with the model's base and tool; None: the one that the exporter was given."""
    tool: Frame | None = None
    """Measured target in the last frame of the format, to be set as the tool; None: the tool of the arm."""
    arm: str | None = None
    """Name of the maker's arm that the numbers refer to."""


def check_parameters(form: str, given: Mapping[str, Any]) -> None:
    """Raise UsageError for an argument that the exporter of a format has no parameter for."""

    def takes(name: str, parameter: str) -> bool:
        exporter: Callable[..., Any] = plug_in(GROUP, name)
        return parameter in inspect.signature(exporter).parameters

    for parameter in given:
        if not takes(form, parameter):
            formats = [name for name in sorted(plug_in_names(GROUP)) if takes(name, parameter)]
            raise UsageError(f"`{parameter}` belongs to `format` {' and '.join(formats)}")


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


def restricted(robot: Robot, nominal: Robot | None = None) -> tuple[Robot, Robot, tuple[str, ...], tuple[str, ...]]:
    """Return the arm with all geometry free, fitted to the robot's effects; exact where there are only constants.

    With ``nominal``, return this arm with joint offsets fitted to the robot, base and tool as in the robot. Beside it
    are the complete arm that it was fitted to, with constants in its numbers, the names of its effects, which the
    parameters take up as far as they can, and those of effects that depend on circumstances, which are left out.

    """
    whole = absorb_constants(robot)
    start = dataclasses.replace(whole if nominal is None else absorb_constants(nominal), effects=())
    if nominal is not None:
        start = dataclasses.replace(start, base=whole.base, tool=whole.tool, targets=whole.targets)
    kept, excluded = [], []
    for entry in whole.effects:
        try:
            simulate(_single_target(dataclasses.replace(whole, effects=(entry,))), Plan(2, seed=_SEEDS[0]))
            kept.append(entry)
        except RobaccError:
            excluded.append(entry)
    complete = dataclasses.replace(whole, effects=tuple(kept))
    if nominal is not None or kept:
        data = simulate(_single_target(complete), Plan(400, seed=_SEEDS[0])).data
        model = Model.of(_single_target(start))
        free: list[Effect] = [JointOffset(model.arm.names)]
        free += [LinkGeometry(model.arm.names)] if nominal is None else []
        fitted = apply_fit(fit(model.with_free(*free), data, Options(robust=False)))
        start = dataclasses.replace(fitted, tool=start.tool, targets=start.targets)
    names, left_out = (tuple(str(entry.get("effect", "?")) for entry in entries) for entries in (kept, excluded))
    return start, complete, names, left_out


def remaining_error(complete: Robot, controller: Robot) -> RemainingError:
    """Return the difference of the poses of two arms within the joint limits of the first."""
    data = simulate(_single_target(complete), Plan(1000, seed=_SEEDS[1])).data
    attained = predict(_single_target(controller), dataclasses.replace(data, target=None))
    assert data.rotation is not None
    turned = log_between(attained.rotation, data.rotation)
    errors = pose_metrics(np.vstack((attained.translation - data.position, turned)))
    assert errors.orientation is not None
    return RemainingError(
        data.n, errors.position.rms, errors.position.max, errors.orientation.rms, errors.orientation.max
    )


def _single_target(robot: Robot) -> Robot:
    """Return the robot with its flange as the only target, where it has several."""
    return dataclasses.replace(robot, targets={}, tool=Frame()) if robot.targets else robot
