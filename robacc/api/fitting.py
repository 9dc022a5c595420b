"""Calls of ``robacc calibrate`` and ``robacc trace``: their inputs, their results, and the robot file of a fit."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import PurePath
from typing import Annotated, Any, Literal, NamedTuple, TypeVar

import numpy as np

from robacc.api.inputs import (
    STDIN,
    Inputs,
    check_targets,
    fitted_pose_warnings,
    path_of,
    pose_path,
    with_measured_targets,
)
from robacc.api.parameters import (
    BaseLink,
    Campaign,
    Cluster,
    Folds,
    Help,
    Holdout,
    IgnoreLimits,
    Jobs,
    NeededRobot,
    Ordered,
    Poses,
    PosesSource,
    Progress,
    Seed,
    StrictRange,
    StrPath,
    TipLink,
    call,
)
from robacc.api.result import Result, fields_of
from robacc.effects.base import load_plug_ins
from robacc.effects.specification import Baseline, build, default_baseline, parse_requests
from robacc.errors import InputError, Note, Problem, refuse
from robacc.fitting.fit_result import Fit, Options
from robacc.fitting.in_parts import fitted_in_parts
from robacc.fitting.solver import tolerance_priors
from robacc.fitting.visits import places
from robacc.fitting.warnings import image_scales, suspected_mistakes
from robacc.geometry import NDArray
from robacc.io.files import write_file
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.modelling.robot_file import model_text
from robacc.modelling.validity import outside_validity, with_campaign
from robacc.plug_ins import plug_in
from robacc.poses.reading import reading_of
from robacc.prediction.model_uncertainty import fit_record
from robacc.render.text import Section
from robacc.render.views.fit import fit_view
from robacc.robots.arm import Arm
from robacc.robots.description import Robot
from robacc.tracing.calibrating import Calibration, Judged, calibrate as fit_effects
from robacc.tracing.trace import Trace, trace as trace_effects
from robacc.version import __version__
from robacc.workers import Workers

Made = TypeVar("Made", bound="FitResult")


class FitInputs(NamedTuple):
    """Robot and poses of a fit."""

    robot: Robot
    data: Measurements
    holdout: Measurements | None
    """Separate validation poses."""
    baseline: Baseline
    """Effects that were declared, or that are to be fitted, and whether the call named them."""
    parts: tuple[Callable[[], Measurements], ...]
    """Functions that read the parts of a large file, of which ``data`` are some poses; none for any other file."""


@dataclass(frozen=True, kw_only=True, repr=False)
class FitResult(Result, Judged):
    """A result with a corrected robot, and its inputs."""

    fit_inputs: FitInputs

    @cached_property
    def places(self) -> dict[str, NDArray[np.int64]]:
        """Number ``(N,)`` of each row's place, of the poses ``fitted`` and ``held_out``."""
        return {
            "fitted": places(self.fit_inputs.data),
            "held_out": places(self.fit_inputs.holdout or self.fit_inputs.data),
        }

    def view(self, full: bool = False, model: str | None = None) -> Iterable[Section]:
        """Return how good, why, and what now; with ``full`` all that was computed. ``model`` is the written file."""
        poses, robot = (self.made.options[kind] or self.named(kind) for kind in ("poses", "robot"))
        return fit_view(self.payload(), poses, robot, "full" if full else "short", model)

    def summary(self) -> dict[str, Any]:
        """Return the main figures, for a table of several files: rms position errors in m, and the findings."""
        stages = [(stage.held_out or stage.fitted).position.rms for stage in (self.nominal, self.after)]
        names = ", ".join(f"{each.effect}({','.join(each.joints)})" for each in getattr(self, "findings", ()))
        return {"n_poses": self.fit.data.n, "before_m": stages[0], "after_m": stages[1], "findings": names or "–"}

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
        origin = PurePath(self.made.options["poses"] or "arrays").name
        caution = ("do not use this model until the following is resolved:",) if self.suspicions else ()
        origin = f"written by robacc {__version__} {self.command} from {origin}"
        return model_text(self.robot, (origin, *caution, *self.suspicions))

    def write_model(self, path: StrPath) -> None:
        """Write :meth:`model_yaml` to a file, which every call and command reads as a robot.

        A failure leaves no partial file.

        Raises:
            InputError: The file cannot be written, or the fit did not converge.
        """
        fix = "check units, frames and joint signs, fit fewer effects, or measure more poses"
        problem = Problem("the fit did not converge, so no model is written", os.fspath(path), fix=fix)
        refuse((not self.converged, problem))
        write_file(path, self.model_yaml())


@dataclass(frozen=True, kw_only=True, repr=False)
class Calibrated(FitResult, Calibration, command="calibrate"):
    """Calibrated robot and its errors, with the inputs."""


@dataclass(frozen=True, kw_only=True, repr=False)
class Traced(FitResult, Trace, command="trace"):
    """Result of a trace, with its inputs."""


@call
def calibrate(
    poses: Poses,
    *,
    robot: NeededRobot,
    fit: Annotated[
        str | Sequence[str] | None,
        Help(
            "Effects to fit, such as base_frame,joint_offset[j2,j3]; robacc show effects lists them. Default: "
            "base_frame, tool_frame, joint_offset and link_geometry, as far as the poses support them.",
            "EFFECT,…",
        ),
    ] = None,
    prior: Annotated[
        bool,
        Help("Use the tolerances of the robot file as priors of its geometry.", names=("prior/no-prior",)),
    ] = False,
    shrink: Annotated[
        bool,
        Help(
            "Shrink joint_offset and link_geometry, if named without brackets, to nominal values where the data show "
            "no difference.",
            names=("shrink/no-shrink",),
        ),
    ] = True,
    robust: Annotated[
        bool, Help("Leave out outliers and list them, or fit all rows.", names=("robust/all-rows",))
    ] = True,
    folds: Folds = None,
    holdout: Holdout = None,
    ordered: Ordered = False,
    ignore_limits: IgnoreLimits = False,
    campaign: Campaign = "auto",
    strict_range: StrictRange = False,
    base_link: BaseLink = None,
    tip_link: TipLink = None,
    seed: Seed = 0,
    jobs: Jobs = None,
    cluster: Cluster = None,
    progress: Progress = None,
) -> Calibrated:
    """Fit named effects to measured poses and compute the error before and after, on fitted and on held-out poses.

    An effect with joints in brackets is fitted to these joints. Without brackets it is fitted to the joints where the
    data show it.

    Returns:
        The calibrated robot, the coefficients with their uncertainty, and the error before and after.

    Raises:
        InputError: A file or array cannot be used, the data hold a mistake, or the poses are too few.
        UsageError: An effect cannot be fitted to this robot and these data, or the arguments contradict each other.

    Example:
        >>> import robacc
        >>> result = robacc.calibrate("sample_data/poses.csv", robot="sample_data/robot.yaml", folds=2)
        >>> before, after = result.nominal_unregistered.fitted.position, result.after.fitted.position
        >>> print(f"{before.rms * 1e3:.2f} to {after.rms * 1e3:.2f} mm")
        1.80 to 0.05 mm
        >>> print(result.model_yaml().splitlines()[0].partition(" robacc ")[0])
        # written by
    """
    inputs = Inputs(locals(), "poses")
    read = _read(inputs, fit)
    requests = parse_requests(",".join(read.baseline.names))
    priors, name = tolerance_priors(read.robot) if prior else {}, path_of(robot) or read.robot.name
    refuse(
        (not requests, "`fit` names no effect; try base_frame,tool_frame,joint_offset,link_geometry"),
        (prior and not priors, f"`prior` needs tolerances, but {name} has none on any joint"),
    )
    shown = progress or (lambda label, done, total: None)
    with _solvable(read.data):
        calibration = fit_effects(
            read.robot,
            read.data,
            requests,
            options=Options(robust=robust),
            priors=priors,
            shrink=shrink,
            n_folds=folds,
            seed=seed,
            holdout=read.holdout,
            progress=shown,
            fitted_to_all=_of_all(read, Workers(jobs, cluster), shown),
        )
        return _made(Calibrated, calibration, inputs, read)


@call
def trace(
    poses: Poses,
    *,
    robot: NeededRobot,
    declared: Annotated[
        str | Sequence[str] | None,
        Help(
            "Effects that the baseline has; none for no effect. Default: base_frame, tool_frame, joint_offset and "
            "link_geometry, as far as the poses support them.",
            "EFFECT,…",
        ),
    ] = None,
    folds: Folds = None,
    holdout: Holdout = None,
    empirical: Annotated[
        bool,
        Help(
            "Allow empirical corrections after the named effects, or named effects only.",
            names=("empirical/named-only",),
        ),
    ] = True,
    ordered: Ordered = False,
    ignore_limits: IgnoreLimits = False,
    campaign: Campaign = "auto",
    strict_range: StrictRange = False,
    base_link: BaseLink = None,
    tip_link: TipLink = None,
    seed: Seed = 0,
    jobs: Jobs = None,
    cluster: Cluster = None,
    progress: Progress = None,
) -> Traced:
    """Find the effects that explain the residual, and compute the error before and after on held-out poses.

    Returns:
        The verdict, the findings with their alternatives and coefficients, the error before and after, and the robot
        with the identified effects.

    Raises:
        InputError: A file or array cannot be used, the data hold a mistake, or the poses are too few.
        UsageError: The data lack what a declared effect needs, or the arguments contradict each other.

    Example:
        >>> import robacc
        >>> result = robacc.trace(
        ...     "sample_data/trace/poses.csv",
        ...     robot="sample_data/trace/robot.yaml",
        ...     declared="base_frame,tool_frame,joint_offset,link_geometry",
        ... )
        >>> result.verdict, [(finding.effect, finding.joints) for finding in result.findings]
        ('explained', [('joint_compliance', ('j2',)), ('backlash', ('j3',))])
    """
    inputs = Inputs(locals(), "poses")
    load_plug_ins()
    read = _read(inputs, declared)
    refuse(
        (
            read.data.reference is not None,
            Problem(
                "distances from an earlier pose do not show what acts at each of the two poses",
                read.data.source,
                fix="use calibrate, or measure distances from an anchor",
            ),
        )
    )
    shown = progress or (lambda label, done, total: None)
    with _solvable(read.data):
        effects = build(parse_requests(",".join(read.baseline.names)), Arm.of(read.robot), read.data)
        body = trace_effects(
            Model.of(read.robot, effects),
            read.data,
            n_folds=folds,
            seed=seed,
            holdout=read.holdout,
            empirical=empirical,
            progress=shown,
            fitted_to_all=_of_all(read, Workers(jobs, cluster), shown),
        )
        return _made(Traced, body, inputs, read)


def _read(inputs: Inputs, effects: str | Sequence[str] | None) -> FitInputs:
    """Return the robot, the poses measured on it, the validation poses, and the requested effects.

    Raises:
        InputError: A file or array cannot be used, or no effect fits the targets that the robot file does not have.
        UsageError: The poses have no joint columns, or a link does not exist.
    """
    poses, holdout = inputs.arguments["poses"], inputs.arguments["holdout"]
    described = inputs.robot(inputs.arguments["robot"], poses)
    data, parts = inputs.measured(poses, described, any_target=True, any_kind=True)
    arm, data = with_measured_targets(described, data)
    arm = inputs.campaign(arm, data)
    validation = None if holdout is None else inputs.poses(holdout, described, kind="holdout", any_kind=True)
    for source, read in ((poses, data), (holdout, validation)):
        name = path_of(source) or (read and read.source) or "the poses"
        refuse(
            (
                read is not None and read.q is None,
                f"{name} has no joint columns q1 … q{len(described.variables)}, which a fit needs",
            )
        )
    if validation is not None:
        _check_validation(data, validation, _name(holdout))
    if effects is None:
        baseline = default_baseline(Arm.of(arm), data, int(np.unique(places(data)).size))
    else:
        text = ",".join([effects] if isinstance(effects, str) else effects).strip()
        baseline = Baseline(tuple(map(str, parse_requests("" if text == "none" else text))), by_default=False)
    if arm.fixtures and "base_frame" not in baseline.names:
        baseline = baseline._replace(names=("base_frame", *baseline.names))  # Where they are is unknown.
    if "tool_frame" not in baseline.names:
        check_targets(data, described)
    return FitInputs(arm, data, validation, baseline, parts)


def _of_all(read: FitInputs, workers: Workers, progress: Callable[[str, int, int], None]) -> Callable[[Fit], Fit]:
    """Return the function that fits the coefficients to all rows of a large file."""
    return partial(fitted_in_parts, read.parts, workers, progress) if read.parts else lambda fit: fit


def _check_validation(data: Measurements, validation: Measurements, name: str | None) -> None:
    """Raise InputError if validation poses are among the calibration poses, which would understate their error.

    The same if they were measured from what the calibration poses do not place.
    """
    row_of = {row: i for i, row in enumerate(_rows(data))}
    shared = [(i, row_of[row]) for i, row in enumerate(_rows(validation)) if row in row_of]
    count = f"{len(shared)} of {validation.n} validation poses {'is' if len(shared) == 1 else 'are'}"
    message = f"{count} also among the calibration poses; the first is"
    fix = "remove these poses from one of the two files: validation poses must not be used in the fit"
    places = [(validation.line(i), f"{data.place(at)} of {data.source or 'the poses'}") for i, at in shared]
    refuse(*((True, Problem(f"{message} {place}", name, line, fix=fix)) for line, place in places))
    unknown = min(_origins(validation) - _origins(data) - {"distance"}, default=None)
    message = f"the calibration poses have no {unknown}, so where it is remains unknown"
    fix = "measure such rows in both files, with a column kind if either has other kinds, or leave them out"
    refuse((unknown is not None, Problem(message, name, fix=fix)))


def _origins(data: Measurements) -> set[str]:
    """Return the kinds and names of what the rows were measured from."""
    return (
        {"position without a kind"}
        if data.kind is None or data.fixture is None
        else {f"{kind} {fixture}".strip() for kind, fixture in zip(data.kind, data.fixture, strict=True)}
    )


@contextmanager
def _solvable(data: Measurements) -> Iterator[None]:
    """Raise InputError where no arm like the robot fits; of other kinds of measurement, one of no size may do."""
    of_other_kinds: Literal["warn", "raise"] = "warn" if data.kind is None else "raise"
    try:
        with np.errstate(divide=of_other_kinds, invalid=of_other_kinds):
            yield
    except (ArithmeticError, np.linalg.LinAlgError):
        fix = "check the units, the joints, the tool, and what the rows are measured from, or fit fewer effects"
        raise InputError(Problem("no arm like the robot explains what was measured", data.source, fix=fix)) from None


def _rows(data: Measurements) -> Iterator[bytes]:
    """Return the numbers of each row as bytes; measurement noise makes them differ between visits to a pose."""
    rotation = None if data.rotation is None else data.rotation.reshape(9, data.n)
    # Rays do not depend on the other photos, as the usual depth does.
    depth = None if data.seen is None else np.where(data.seen[3] > 0.0, data.seen[3], 1.0)
    position = data.position if depth is None else np.round(data.position / depth, 9)
    columns = (data.q, position, rotation, data.time, data.temperature, data.payload)
    return (row.tobytes() for row in np.vstack([column for column in columns if column is not None]).T)


def _name(source: PosesSource | Robot | None) -> str | None:
    read = source.source if isinstance(source, Measurements) else path_of(source)
    return STDIN if read == "<stdin>" else read


def _made(kind: Callable[..., Made], result: Judged, inputs: Inputs, read: FitInputs) -> Made:
    """Return a result with its inputs: its robot has the records of its fit, its poses and its campaign.

    Corrections and predictions read these records. The warnings have those about the use of a model.
    """
    residual, fit = result.after.held_out_residual, result.fit
    held_out = None if residual is None else (read.data if read.holdout is None else read.holdout, residual)
    poses = inputs.arguments["poses"]
    sheet = None if isinstance(poses, Measurements) else reading_of(pose_path(poses)).contact_sheet
    if sheet is not None and fit.data.seen is not None:
        plug_in("robacc.readers", "photos").add_residuals(sheet, fit)
    record = fit_record(fit, result.robot, read.robot, read.data, held_out, result.repeatability, result.n_folds)
    robot = replace(result.robot, fit=replace(record, suspicions=suspected_mistakes(fit)).entry())
    outside = None if read.holdout is None else outside_validity(robot, read.holdout)
    digests = [record.sha256 for record in inputs.records if record.kind == "poses"]
    robot = replace(robot, fitted_to=tuple(dict.fromkeys((*robot.fitted_to, *digests))))
    in_parts = Note(
        f"the file was read in {len(read.parts)} parts: the coefficients are fitted to all rows, and their standard "
        "errors allow for what the rows of a command have in common; errors, causes and checks are of "
        f"{fit.data.n} rows, evenly spread"
    )
    warnings = (
        *result.warnings,
        *([in_parts] if read.parts else []),
        *image_scales(fit),
        *fitted_pose_warnings(read.robot, inputs.records),
        *inputs.warnings,
        *(() if outside is None else (f"validation poses: {warning}" for warning in outside.warnings())),
    )
    fields = {**fields_of(result), "robot": with_campaign(robot, read.robot, digests), "warnings": warnings}
    options: dict[str, Any] = {name: _name(inputs.arguments[name]) for name in ("poses", "robot", "holdout")}
    for name in inputs.arguments.keys() & {"fit", "declared"}:
        effects = inputs.arguments[name]
        options[name] = effects if isinstance(effects, str) else ",".join(effects or read.baseline.names)
    return kind(**fields, fit_inputs=read, made=inputs.made(**options))
