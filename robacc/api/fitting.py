"""Inputs and the robot file of ``robacc calibrate`` and ``robacc trace``, which both calls share."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import PurePath
from typing import TYPE_CHECKING, Any, TextIO

import numpy as np

from robacc.api.inputs import (
    STDIN,
    check_targets,
    fitted_pose_warnings,
    load_poses,
    load_robot,
    path_of,
    with_fitted_poses,
    with_measured_targets,
)
from robacc.api.parameters import CampaignUse, StrPath
from robacc.api.result import ModelUse, Result, fields_of, use_model
from robacc.documents.envelope import InputFile
from robacc.effects.request import Baseline, default_baseline, parse_requests
from robacc.errors import InputError, Problem, UsageError
from robacc.fitting.visits import places
from robacc.fitting.warnings import suspected_mistakes
from robacc.measurements import Measurements
from robacc.modelling.campaign import with_campaign
from robacc.modelling.validity import outside_validity
from robacc.prediction.fit_record import fit_record
from robacc.robots.arm import Arm
from robacc.robots.description import Robot
from robacc.version import __version__

if TYPE_CHECKING:
    from robacc.api.parameters import PosesSource
    from robacc.fitting.fit_result import Fit
    from robacc.tracing.judging import Judged


@dataclass(frozen=True, slots=True)
class FitInputs:
    """Robot and poses of a fit, with the record of their files."""

    robot: Robot
    data: Measurements
    holdout: Measurements | None
    """Separate validation poses."""
    names: dict[str, str | None]
    """Paths of poses, robot and holdout in the result's options; None without a file."""
    files: tuple[InputFile, ...]
    use: ModelUse
    """How the robot's model applies to the poses."""
    own_targets: bool = True
    """False if the robot file has no targets and the poses name several: each starts at the tool."""

    def require_targets(self, effects: Sequence[str]) -> None:
        """Check that the effects fit the places of targets that the robot file does not have.

        Raises:
            InputError: They do not.
        """
        if not self.own_targets and "tool_frame" not in effects:
            check_targets(self.data, replace(self.robot, targets={}))


class FitResult(Result):
    """A result with a corrected robot."""

    __slots__ = ()
    robot: Robot
    fit: Fit
    fit_inputs: FitInputs
    baseline: Baseline
    """Effects that were declared, or that were to be fitted, and whether the call named them."""

    def draw(self, stream: TextIO, full: bool = False, model: str | None = None) -> None:
        """Write how good, why, and what now; with ``full`` all that was computed. ``model`` is the written file."""
        from robacc.render.views.elements import draw
        from robacc.render.views.fit import calibration_view, trace_view

        view = trace_view if self.command == "trace" else calibration_view
        poses, robot = (self.fit_inputs.names[kind] or self.named(kind) for kind in ("poses", "robot"))
        draw(view(self.payload(), poses, robot, "full" if full else "short", model), stream)

    @property
    def converged(self) -> bool:
        """Return whether the reported fit converged."""
        return self.fit.converged

    @property
    def suspicions(self) -> tuple[str, ...]:
        """Return the data mistakes that the reported fit makes likely, in words; they are among the warnings too."""
        return suspected_mistakes(self.fit)

    def model_yaml(self) -> str:
        """Return the robot file of the fitted robot; its first line names the command and the poses.

        It has the units, comments and order of the robot file that was fitted; m and rad for a URDF. Suspected data
        mistakes stand in comments at its head, and in its part ``fit:``.
        """
        from robacc.modelling.robot_file import model_text

        source = self.fit_inputs.names["poses"]
        origin = "arrays" if source is None else PurePath(source).name
        caution = ("do not use this model until the following is resolved:",) if self.suspicions else ()
        origin = f"written by robacc {__version__} {self.command} from {origin}"
        return model_text(self.robot, (origin, *caution, *self.suspicions))

    def write_model(self, path: StrPath) -> None:
        """Write :meth:`model_yaml` to a file, which every call and command reads as a robot.

        A failure leaves no partial file.

        Raises:
            InputError: The file cannot be written, or the fit did not converge.
        """
        from robacc.io.files import write_text

        if not self.converged:
            fix = "check units, frames and joint signs, fit fewer effects, or measure more poses"
            raise InputError(Problem("the fit did not converge, so no model is written", os.fspath(path), fix=fix))
        write_text(path, self.model_yaml())


def with_inputs(result: Judged, inputs: FitInputs) -> dict[str, Any]:
    """Return the fields of a result with its inputs: its robot has the records of its fit, its poses and its campaign.

    Its warnings have those about the use of a model.
    """
    robot = _with_fit(result, inputs)
    outside = None if inputs.holdout is None else outside_validity(robot, inputs.holdout)
    digests = [record.sha256 for record in inputs.files if record.kind == "poses"]
    robot = with_campaign(with_fitted_poses(robot, inputs.files), inputs.robot, digests)
    warnings = [
        *result.warnings,
        *fitted_pose_warnings(inputs.robot, inputs.files),
        *inputs.use.warnings,
        *(() if outside is None else (f"validation poses: {warning}" for warning in outside.warnings())),
    ]
    return {**fields_of(result), "robot": robot, "warnings": tuple(warnings), "fit_inputs": inputs}


def _with_fit(result: Judged, inputs: FitInputs) -> Robot:
    """Return the fitted robot with the record of its fit, which corrections and predictions read."""
    held_out = None
    if inputs.holdout is not None and result.holdout is not None:
        residual = result.holdout.held_out_after
        held_out = (inputs.holdout, result.holdout.after if residual is None else residual)
    elif result.residuals.held_out_after is not None:
        held_out = (inputs.data, result.residuals.held_out_after)
    fit, robot = result.fit, result.robot
    record = fit_record(fit, robot, inputs.robot, inputs.data, held_out, result.repeatability, result.n_folds)
    return replace(robot, fit=replace(record, suspicions=suspected_mistakes(fit)).entry())


def load_fit_inputs(
    poses: PosesSource,
    robot: StrPath | Robot,
    holdout: PosesSource | None,
    ordered: bool,
    ignore_limits: bool,
    base_link: str | None,
    tip_link: str | None,
    campaign: CampaignUse = "auto",
    strict_range: bool = False,
) -> FitInputs:
    """Return the robot, the poses measured on it, the validation poses, and the record of the files.

    Raises:
        InputError: A file or array cannot be used.
        UsageError: The poses have no joint columns, or a link does not exist.
    """
    arm, arm_record = load_robot(robot, base_link, tip_link, poses)

    def read(source: PosesSource, kind: str, *, any_target: bool = False) -> tuple[Measurements, InputFile]:
        data, record = load_poses(
            source, arm, ordered=ordered, ignore_limits=ignore_limits, kind=kind, any_target=any_target
        )
        if data.q is None:
            name = path_of(source) or data.source or "the poses"
            raise UsageError(f"{name} has no joint columns q1 … q{len(arm.variables)}, which a fit needs")
        return data, record

    data, record = read(poses, "poses", any_target=True)
    file_arm = arm
    arm, data = with_measured_targets(arm, data)
    own_targets = arm is file_arm
    use = use_model(arm, data, (record,), campaign=campaign, strict_range=strict_range)
    arm = use.robot or arm
    names = {"poses": _name(poses), "robot": _name(robot), "holdout": _name(holdout)}
    if holdout is None:
        return FitInputs(arm, data, None, names, (record, arm_record), use, own_targets)
    validation, validation_record = read(holdout, "holdout")
    _refuse_shared(data, validation, names["holdout"])
    return FitInputs(arm, data, validation, names, (record, arm_record, validation_record), use, own_targets)


def _refuse_shared(data: Measurements, validation: Measurements, name: str | None) -> None:
    """Raise InputError if validation poses are among the calibration poses, which would understate their error."""
    row_of = {row: i for i, row in enumerate(_rows(data))}
    shared = [(i, row_of[row]) for i, row in enumerate(_rows(validation)) if row in row_of]
    if not shared:
        return
    count = f"{len(shared)} of {validation.n} validation poses {'is' if len(shared) == 1 else 'are'}"
    i, i_fitted = shared[0]
    place = f"{data.place(i_fitted)} of {data.source or 'the poses'}"
    raise InputError(
        Problem(
            f"{count} also among the calibration poses; the first is {place}",
            name,
            validation.line(i),
            fix="remove these poses from one of the two files: validation poses must not be used in the fit",
        )
    )


def _rows(data: Measurements) -> Iterator[bytes]:
    """Return the numbers of each row as bytes; measurement noise makes them differ between visits to a pose."""
    rotation = None if data.rotation is None else data.rotation.reshape(9, data.n)
    columns = (data.q, data.position, rotation, data.time, data.temperature, data.payload)
    return (row.tobytes() for row in np.vstack([column for column in columns if column is not None]).T)


def _name(source: PosesSource | Robot | None) -> str | None:
    if isinstance(source, Measurements):
        return STDIN if source.source == "<stdin>" else source.source
    return path_of(source)


def joined(effects: str | Sequence[str]) -> str:
    """Return the effects as text separated by commas."""
    return effects if isinstance(effects, str) else ",".join(effects)


def requested(effects: str | Sequence[str] | None, arm: Arm, data: Measurements) -> Baseline:
    """Return the effects of a request, or those of every arm if it is None."""
    if effects is None:
        return default_baseline(arm, data, int(np.unique(places(data)).size))
    text = joined(effects).strip()
    return Baseline(tuple(map(str, parse_requests("" if text == "none" else text))), by_default=False)
