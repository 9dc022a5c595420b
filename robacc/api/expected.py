"""Calls of ``robacc predict`` and ``robacc plan``."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import PurePath
from typing import Annotated, Any, Literal, cast, get_args

import numpy as np

from robacc.accuracy.error_statistics import Statistic
from robacc.accuracy.grade import default_scale
from robacc.api.inputs import STDIN, Inputs, fitted_pose_warnings, path_of
from robacc.api.parameters import (
    DEFAULT_SAMPLES,
    BaseLink,
    Campaign,
    Confidence,
    Help,
    IgnoreLimits,
    Ordered,
    PosesSource,
    RobotArgument,
    RobotSource,
    Samples,
    Scale,
    Seed,
    StrictRange,
    StrPath,
    TipLink,
    call,
    check_range,
    count_or_path,
    length_and_angle,
    masses,
    numbers,
)
from robacc.api.result import CsvResult, Result, effect_names, fields_of
from robacc.diagnostics.robot_poses import joints_of
from robacc.documents.envelope import csv_text, read_gate
from robacc.documents.keys import texts
from robacc.errors import given, refuse
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.modelling.validity import resolve_campaign
from robacc.planning.campaign import (
    DEFAULT_CANDIDATES,
    CampaignPlan,
    needed,
    plan_campaign,
)
from robacc.planning.candidates import (
    Constraints,
    Sight,
    at_rest_warning,
    check_at_rest,
    lengths,
    parse_box,
    parse_half_space,
)
from robacc.plug_ins import plug_in, plug_ins
from robacc.poses.csv_file import format_poses, pose_pieces
from robacc.prediction.comparison import Noise, compare_with_measured
from robacc.prediction.model_uncertainty import calibrated_accuracy, coverage, model_fit
from robacc.prediction.predicting import (
    NORMAL,
    Prediction,
    allocate as allocate_tolerances,
    configurations_of,
    parse_tolerances,
    predict_accuracy,
    sampled_configurations,
    step_limits,
    uncertain_parameters,
    warranty_map,
)
from robacc.quantities import optional_size, size
from robacc.render.views.expected import plan_comments
from robacc.robots.arm import build_chain
from robacc.robots.description import Fixture, Robot


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Predicted(Result, Prediction, command="predict"):
    """Predicted accuracy, with the inputs."""

    robot: Robot
    """Robot as its file describes it."""
    allocation: Mapping[str, Any] | None
    """Tolerances that would reach the requested grade, with the keys of the result."""
    comparison: Mapping[str, Any] | None
    """Comparison of the prediction with measured poses, with the keys of the result."""
    coverage: Mapping[str, Any] | None
    """Measured poses within the bounds of a model file, with the keys of the result; None for tolerances."""
    planned: Measurements | None
    """Poses given for the prediction."""
    measured: Measurements | None
    """Measured poses that the prediction is compared with."""

    @property
    def reached(self) -> Array:
        """Positions ``(3, N)`` of the target, m."""
        return build_chain(self.robot).poses(self.configurations.scalars, self.configurations.n).translation

    def per_pose_csv(self) -> str:
        """Return a CSV with one row a configuration: joint variables and the prediction (m, rad, tool frame)."""
        configurations = self.configurations
        columns: dict[str, Iterable[Any] | None] = {"pose": configurations.labels}
        columns |= dict(zip(self.robot.variable_names, configurations.q, strict=True))
        for errors in (self.position, self.orientation):
            unit = errors.unit
            columns |= {f"rms_{unit}": errors.pose_rms, f"radius95_{unit}": errors.pose_radius95}
            for i, j in zip(*np.triu_indices(3), strict=True):
                columns[f"v_{'xyz'[i]}{'xyz'[j]}_{unit}2"] = errors.covariance[i, j]
        return csv_text(columns)

    def map_csv(self, voxel: str | float = "100mm") -> str:
        """Return a CSV with a row for each voxel of the workspace: its errors, and the grade that it holds.

        Args:
            voxel: Edge of a voxel, m or text such as ``"100mm"``.

        Raises:
            UsageError: The edge is no length above zero.
        """
        edge = size(voxel, "length", "`voxel`")
        refuse((edge <= 0, "`voxel`: expected a length above zero"))
        voxels, sizes = warranty_map(self, self.reached, edge)
        columns = dict(zip(("x_m", "y_m", "z_m"), voxels["centre_m"].T, strict=True))
        columns["configurations"] = voxels["configurations"]
        for unit, rms in zip(("m", "rad"), sizes, strict=True):
            columns |= {f"rms_{unit}": rms, f"bound95_{unit}": voxels[f"bound95_{unit}"]}
        return csv_text({**columns, "grade": voxels["grade"]})


@call
def predict(
    robot: RobotArgument,
    *,
    poses: Annotated[
        PosesSource | Array | None,
        Help(
            "CSV of poses; the prediction is for their joints.",
            "FILE",
            "Or poses read before, or joint variables ``(J, N)``, rad or m.",
            holds="measured poses",
        ),
    ] = None,
    samples: Samples = None,
    target: Annotated[
        str | None, Help("Target of the sampled configurations, for a robot with several.", "NAME")
    ] = None,
    tolerances: Annotated[
        StrPath | None, Help("Tolerance file (YAML); overrides the tolerances of the robot file.", "FILE")
    ] = None,
    scale: Scale = None,
    allocate: Annotated[str | None, Help("Grade to find tolerances for.", "GRADE")] = None,
    against: Annotated[
        PosesSource | None,
        Help("CSV of measured poses to compare the prediction with.", "FILE", holds="measured poses"),
    ] = None,
    align: Annotated[
        str | Sequence[str],
        Help("Frames to fit to the poses of `against` first: base_frame, tool_frame or both.", "FRAME,…"),
    ] = (),
    noise: Annotated[
        str | Noise | None,
        Help(
            "Standard deviation of the measurement noise along and about an axis, such as 0.02mm,0.01deg.",
            "P[,R]",
            "Or ``(m, rad)``.",
        ),
    ] = None,
    confidence: Confidence = 0.95,
    ordered: Ordered = False,
    ignore_limits: IgnoreLimits = False,
    campaign: Campaign = "auto",
    strict_range: StrictRange = False,
    base_link: BaseLink = None,
    tip_link: TipLink = None,
    seed: Seed = 0,
) -> Predicted:
    """Covariances, error budget and grade predicted from parameter tolerances, or from the fit of a model file.

    The prediction is for the joints of ``poses``, else of ``against``, else for configurations over the joint ranges.
    For a model file that ``write_model`` wrote, it is that of the calibrated arm: uncertainty of the coefficients,
    repeatability and unexplained error. With ``tolerances``, it is that of arms made with these tolerances.

    Returns:
        The predicted covariances (m, rad), the budget and the grade, with the allocation and the comparison.

    Raises:
        InputError: A file or array cannot be used; with every problem.
        UsageError: The arguments contradict each other or do not fit the robot.

    Example:
        >>> import robacc
        >>> result = robacc.predict("configs/robots/puma560.yaml", samples=200)
        >>> print(f"{result.position.rms * 1e3:.2f} mm rms; largest contribution: {result.budget[0]['parameter']}")
        0.37 mm rms; largest contribution: j1.d
    """
    inputs = Inputs(locals())
    has_poses, is_compared, is_sampled = poses is not None, against is not None, samples is not None
    refuse(
        (has_poses and is_sampled, "`poses` and `samples` both say where to predict; give only one of them"),
        (is_compared and is_sampled, "`against` predicts at the measured poses; leave out `samples`"),
        *(
            (value is not None and not is_compared, f"`{name}` applies to measured poses, so it needs `against`")
            for name, value in (("align", align or None), ("noise", noise))
        ),
        (
            target is not None and (has_poses or is_compared),
            "`target` applies to sampled configurations; poses name their targets in a column target",
        ),
        (
            path_of(poses) == path_of(against) == STDIN,
            "standard input can be read only once: give - to `poses` or to `against`",
        ),
    )
    noise_std = length_and_angle("noise", noise, "0.02mm,0.01deg")
    if isinstance(poses, np.ndarray):
        poses = Measurements(position=np.zeros((3, poses.shape[-1])), q=poses.copy())
    arm = inputs.robot(robot, poses if against is None else against)
    toleranced, meaning = (
        (arm, NORMAL)
        if tolerances is None
        else inputs.text(tolerances, "tolerances", partial(parse_tolerances, robot=arm))
    )
    grades = inputs.scale() or default_scale()
    if allocate is not None:
        step_limits(grades, allocate)  # raises for an unknown grade before poses are read
    # A tolerance file describes arms that are made, the record of a fit this calibrated arm.
    record = model_fit(arm)
    fit = record if tolerances is None and allocate is None else None
    parameters = uncertain_parameters(toleranced) if fit is None else ()
    # A prediction needs joints only; poses to compare with are measured.
    planned = None if poses is None else inputs.poses(poses, arm, attained=False)
    measured = None if against is None else inputs.poses(against, arm, kind="against")
    arm = inputs.campaign(arm, measured or planned, measured=measured is not None)
    predicted = planned or measured
    configurations = (
        sampled_configurations(arm, DEFAULT_SAMPLES if samples is None else samples, seed, target)
        if predicted is None
        else configurations_of(arm, predicted)
    )
    prediction = (
        predict_accuracy(arm, parameters, configurations, grades, meaning)
        if fit is None
        else calibrated_accuracy(arm, fit, configurations, predicted, grades, seed)
    )
    aligned = effect_names(align)
    covered = None if fit is None or measured is None else coverage(arm, fit, measured, seed, aligned, noise_std)
    comparison = (
        compare_with_measured(
            arm, measured, parameters, align=aligned, noise=noise_std, confidence=confidence, seed=seed
        )
        if fit is None and measured is not None
        else None
    )
    warnings = (
        *(warning for data in (planned, measured) if data is not None for warning in data.warnings),
        *fitted_pose_warnings(arm, [file for file in inputs.records if file.kind == "against"]),
        *inputs.warnings,
        *(() if record is None else record.warnings),
        *filter(None, [(comparison or {}).get("hint")]),
    )
    made = inputs.made(
        samples=configurations.n if predicted is None else None,
        align=list(aligned),
        noise=list(noise) if isinstance(noise, tuple) else noise,
    )
    return Predicted(
        **fields_of(prediction),
        robot=arm,
        allocation=None if allocate is None else allocate_tolerances(arm, prediction, allocate),
        comparison=comparison,
        coverage=covered,
        planned=planned,
        measured=measured,
        warnings=warnings,
        made=made,
    )


_MOST_PAYLOADS = 5


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Planned(CsvResult, CampaignPlan, command="plan"):
    """Planned poses and the expected result, with the inputs."""

    def csv_pieces(self) -> Iterator[str]:
        """Yield the file of the visits that the command writes: pose, cycle, joints, direction and speed."""
        yield from (f"# {line}\n" for line in plan_comments(self))
        yield from pose_pieces(self.visits, attained=self.candidates.in_sockets and self.candidates.socket is None)

    def validation_csv(self) -> str:
        """Return the file of the validation poses.

        Raises:
            UsageError: The plan has none.
        """
        head = (
            f"# Validation poses planned by robacc plan for {self.robot.name}; nothing was measured.\n"
            "# Use them only to check a fit (`holdout`), never in the fit.\n"
        )
        missing = "the plan has no validation poses; give their number as `validation`"
        return head + format_poses(given(self.validation, missing), attained=False)

    def programs(self, path: StrPath) -> dict[str, str]:
        """Return the visits as robot programs in the language of the suffix of ``path``: text by file name.

        ``.src`` is KRL, ``.mod`` RAPID, ``.ls`` FANUC TP, ``.script`` URScript. A program stops at each pose. With
        several payloads there is a program for each, ``plan_5kg.src`` for ``plan.src``, in the order to run.

        Raises:
            UsageError: The suffix is of no language, or the robot has too many joints for it.
        """
        file = PurePath(path)
        writers = {each.NEW_SUFFIX: each.write for each in plug_ins("robacc.programs") if hasattr(each, "write")}
        ends = f"`program`: expected a file name that ends in {', '.join(writers)}, found {path!r}"
        write = given(writers.get(file.suffix.lower()), ends)
        linear = [i for i, joint in enumerate(self.robot.variables) if joint.type == "prismatic"]
        q = self.candidates.q[:, self.chosen[self.route.visits]]
        targets = list(zip(texts(self.visits.pose) or (), q.T.tolist(), strict=True))
        groups = {os.fspath(path): targets}
        if (payloads := self.visits.payload) is not None and len(self.payload_blocks) > 1:
            groups = {
                str(file.with_name(f"{file.stem}_{payload:g}kg{file.suffix}")): [
                    target for target, mass in zip(targets, payloads, strict=True) if mass == payload
                ]
                for payload in (block["payload_kg"] for block in self.payload_blocks)
            }
        return {name: write(group, name=PurePath(name).stem, linear=linear) for name, group in groups.items()}


@call
def plan(
    robot: RobotArgument,
    *,
    purpose: Annotated[
        Literal["calibrate", "trace", "acceptance", "health"],
        Help("Purpose of the measurement.", names=("for",)),
    ] = "calibrate",
    poses: Annotated[
        int | None,
        Help(
            "Number of different poses; default: by purpose.",
            "N",
            "For ``acceptance`` with a gate or a grade, the number that decides it.",
            least=1,
            most=2000,
        ),
    ] = None,
    criterion: Annotated[
        Literal["I", "G", "D", "A"],
        Help("Mean (I) or worst (G) predicted error; D, A: of the coefficients."),
    ] = "I",
    fit: Annotated[
        str | Sequence[str],
        Help("Effects that the fit leaves free.", "EFFECT,…", "By default those usual for the purpose."),
    ] = "",
    candidates: Annotated[
        PosesSource | int | None,
        Help(
            "CSV of poses to choose from, or of places x, y, z of sockets in the base frame, or number of samples.",
            "FILE|N",
            "A file without joints has places: the poses then bring the target there.",
            read=count_or_path,
            holds="planned poses",
        ),
    ] = None,
    task: Annotated[
        PosesSource | None, Help("CSV of poses where the accuracy matters.", "FILE", holds="planned poses")
    ] = None,
    region: Annotated[str | None, Help("Box where the accuracy matters, such as x=0.4:0.9,z=0:0.6.", "BOX")] = None,
    inside: Annotated[str | None, Help("Box that the target stays in.", "BOX")] = None,
    outside: Annotated[Sequence[str], Help("Box that the arm stays out of; may be repeated.", "BOX")] = (),
    half_space: Annotated[
        Sequence[str], Help("Side that the arm stays on, such as y>=-0.4; may be repeated.", "SIDE")
    ] = (),
    min_height: Annotated[float | str | None, Help("Least height of the arm above its base.", "SIZE")] = None,
    margin: Annotated[
        float, Help("Share of each joint's range to keep from its limits.", "SHARE", least=0.0, most=0.45)
    ] = 0.02,
    max_condition: Annotated[
        float | None, Help("Largest condition number of the joints' Jacobian.", "C", least=1.0)
    ] = None,
    collisions: Annotated[
        bool,
        Help(
            "Check the links' shapes of the URDF for collisions.",
            python="The arm has its thickness in `outside`, `half_space` and `min_height` then. Needs the extra "
            "``collision``.",
        ),
    ] = False,
    instrument: Annotated[
        str | Sequence[float] | None, Help("Position of the instrument in the base frame.", "X,Y,Z")
    ] = None,
    reflector: Annotated[
        str | Sequence[float] | None,
        Help(
            "Direction in the target's frame that the reflector faces.",
            "X,Y,Z",
            "None if it is turned by hand.",
        ),
    ] = None,
    cone: Annotated[float | str, Help("Half angle that the reflector accepts.", "ANGLE")] = "30deg",
    distance: Annotated[
        str | Sequence[float] | None,
        Help("Nearest and farthest distance of the instrument, m.", "NEAR:FAR"),
    ] = None,
    noise: Annotated[
        float | str | None,
        Help("Measurement noise along each axis (standard deviation); default: typical.", "SIZE"),
    ] = None,
    noise_orientation: Annotated[
        float | str | None, Help("The same about each axis, if it is measured.", "SIZE")
    ] = None,
    repeatability: Annotated[
        float | str | None,
        Help("Arm's scatter along each axis (standard deviation); default: typical.", "SIZE"),
    ] = None,
    unexplained: Annotated[
        float | str,
        Help("Error of the model that repeats at a pose (standard deviation).", "SIZE"),
    ] = "0",
    model: Annotated[RobotSource | None, Help("Calibrated robot file to start from.", "FILE")] = None,
    already: Annotated[
        PosesSource | None, Help("CSV of poses measured already.", "FILE", holds="planned poses")
    ] = None,
    target_error: Annotated[float | str | None, Help("Predicted error that is good enough.", "SIZE")] = None,
    payload: Annotated[
        Sequence[float],
        Help("Payloads, each mounted once; the plan chooses the poses of each.", "KG,…", "In kg.", read=numbers),
    ] = (),
    check_every: Annotated[int, Help("Visits between drift checks; 0 for none.", "K", least=0, most=10_000)] = 10,
    repeats: Annotated[
        int | None, Help("Poses visited a second time; default: a tenth.", "N", least=0, most=2000)
    ] = None,
    validation: Annotated[int, Help("Number of validation poses.", "N", least=0, most=2000)] = 0,
    gate: Annotated[StrPath | None, Help("Gate that an acceptance measurement is to decide.", "FILE")] = None,
    grade: Annotated[str | None, Help("Grade that an acceptance measurement is to confirm.", "NAME")] = None,
    scale: Scale = None,
    expected: Annotated[float | str | None, Help("Expected true value for the gate or grade.", "SIZE")] = None,
    ordered: Ordered = False,
    seed: Seed = 0,
    base_link: BaseLink = None,
    tip_link: TipLink = None,
) -> Planned:
    """Plan a measurement: the poses worth measuring, their order, and the expected result.

    Boxes, half-spaces and places are in the robot's base frame; numbers without a unit are in m.

    Returns:
        The visits in order, with predicted standard errors, accuracy and detection limits.

    Raises:
        InputError: A file cannot be used, or a prismatic joint has no limits.
        UsageError: No pose meets the constraints, or the arguments contradict each other.

    Example:
        >>> import robacc
        >>> result = robacc.plan("sample_data/robot.yaml", poses=12, candidates=500)
        >>> sorted(result.route.roles).count("pose")
        11
        >>> result.accuracy["planned"]["rms_m"] < result.accuracy["planned"]["random_rms_m"]
        True
    """
    inputs = Inputs(locals())
    described = inputs.robot(robot)
    calibrated = described if model is None else inputs.robot(model, kind="model")
    refuse(
        (
            calibrated.variable_names != described.variable_names,
            f"`model` has the joints {', '.join(calibrated.variable_names)}, but the robot has "
            f"{', '.join(described.variable_names)}; give the model of this robot",
        )
    )
    # A drift and other facts of the model's own campaign do not come again.
    arm, _ = resolve_campaign(calibrated, None, (), "drop")
    n_candidates, chosen_from = (candidates, None) if isinstance(candidates, int) else (DEFAULT_CANDIDATES, candidates)
    check_range("candidates", n_candidates, 10, 100_000)
    known = joints_of(arm)._replace(limits=None)  # limits are a matter of the filters
    read: dict[str, Measurements] = {}
    for kind, source in (("candidates", chosen_from), ("task", task)):
        if source is not None:
            read[kind] = inputs.poses(
                source,
                arm,
                ordered=False,
                kind=kind,
                attained=False,
                any_kind=kind == "candidates",
                visited_by=known,
            )
            check_at_rest(arm, read[kind])
    if already is not None:
        read["already"] = inputs.poses(already, arm, kind="already", attained=False, any_kind=True)
    chosen = [read[name] for name in ("candidates", "already") if name in read]
    others = {str(kind) for data in chosen if data.kind is not None for kind in data.kind} - {"position", "point"}
    in_sockets = {data.fixture is not None for data in chosen} | ({False} if chosen_from is None else set())
    refuse(
        (others, f"a plan has positions and points in sockets, but rows are of kind {', '.join(sorted(others))}"),
        (len(in_sockets) > 1, "`candidates` and `already` are two files with a column socket each, or without"),
    )
    sockets = dict.fromkeys(str(name) for data in chosen if data.fixture is not None for name in data.fixture)
    arm = replace(arm, fixtures={name: Fixture("point" if name else "position") for name in sockets})
    links = None
    if collisions:
        urdf = given(
            path_of(robot) if described.convention == "urdf" else None,
            "`collisions` needs the shapes of the links: give the URDF of the robot, and a fit as `model`",
        )
        links = plug_in("robacc.collisions", "fcl")(urdf, described)
    demands, left_out = _demands(inputs, gate, grade, optional_size(expected, "length", "`expected`"))
    refuse(
        (
            (gate is not None or grade is not None) and purpose != "acceptance",
            "`gate` and `grade` set the number of acceptance poses; give purpose acceptance",
        )
    )
    sides = [(text, "half_space") for text in half_space]
    sides += [(f"z>={min_height}", "min_height")] if min_height is not None else []
    body = plan_campaign(
        arm,
        purpose,
        poses=poses,
        criterion=criterion,
        fit=fit if isinstance(fit, str) else ",".join(fit),
        constraints=Constraints(
            margin=margin,
            inside=None if inside is None else parse_box(inside, "inside"),
            outside=tuple(parse_box(text, "outside") for text in outside),
            half_spaces=tuple(parse_half_space(text, name) for text, name in sides),
            sight=_sight(instrument, reflector, cone, distance),
            max_condition=max_condition,
            collisions=links,
        ),
        region=None if region is None else parse_box(region, "region"),
        noise=optional_size(noise, "length", "`noise`"),
        noise_orientation=optional_size(noise_orientation, "angle", "`noise_orientation`") or None,
        repeatability=optional_size(repeatability, "length", "`repeatability`"),
        unexplained=size(unexplained, "length", "`unexplained`"),
        check_every=check_every,
        repeats=repeats,
        validation=validation,
        target=optional_size(target_error, "length", "`target_error`"),
        demands=demands,
        n_candidates=n_candidates,
        payloads=_payloads(payload),
        seed=seed,
        **read,
    )
    uncounted = (
        f"the number of poses does not count {', '.join(left_out)} of the gate: a plan counts grades and upper limits "
        "above zero of position.rms, mean_error, p95 and max",
    ) * bool(left_out)
    doubts = [text for data in read.values() for text in data.warnings]
    body = replace(body, warnings=(*body.warnings, *at_rest_warning(arm), *doubts, *uncounted))
    # Files are recorded by their names, objects not at all.
    files = {name: inputs.arguments[name] for name in ("model", "candidates", "task", "already", "gate")}
    names = {name: os.path.basename(path) for name, file in files.items() if (path := path_of(file)) is not None}
    objects = (name for name, file in files.items() if isinstance(file, Measurements | Robot))
    return Planned(**fields_of(body), made=inputs.made(*objects, **names))


def _sight(
    instrument: str | Sequence[float] | None,
    reflector: str | Sequence[float] | None,
    cone: float | str,
    distance: str | Sequence[float] | None,
) -> Sight | None:
    """Return the line of sight of the instrument; None without an instrument.

    Raises:
        UsageError: The texts are no places or angles, or `instrument` is missing.
    """
    refuse(
        (
            instrument is None and (reflector is not None or distance is not None),
            "`reflector` and `distance` need `instrument`, the position of the instrument",
        )
    )
    if instrument is None:
        return None
    vector = "three numbers such as 2.5,0,1.2"
    near, far = (
        (0.0, np.inf) if distance is None else lengths(distance, "distance", "nearest and farthest such as 0.5:15")
    )
    axis = None if reflector is None else lengths(reflector, "reflector", vector)
    refuse(
        (
            not 0 <= near < far,
            f"`distance`: the farthest distance must be beyond the nearest, found {distance!r}",
        ),
        (axis is not None and not any(axis), "`reflector`: the direction has no length"),
    )
    return Sight(lengths(instrument, "instrument", vector), axis, size(cone, "angle", "`cone`"), (near, far))


def _demands(
    inputs: Inputs, gate: StrPath | None, grade: str | None, expected: float | None
) -> tuple[list[Mapping[str, Any]], list[str]]:
    """Return the limits of a gate and of a grade on the position, with the numbers of poses that decide them.

    Beside them are the names of the gate's criteria without such a number.
    """
    demands: list[Mapping[str, Any]] = []
    grades, others = [] if grade is None else [grade], []
    if gate is not None:
        loaded, _, records = read_gate(os.fspath(gate))
        inputs.records += records
        for criterion in loaded.criteria:
            statistic = criterion.key.removeprefix("position.")
            is_planned = statistic in get_args(Statistic) and not criterion.at_least and criterion.baseline is None
            if criterion.kind == "grade":
                grades.append(criterion.accepted[0])
            elif is_planned and criterion.limit:
                limit = criterion.limit, criterion.confidence, criterion.share
                demands.append(needed(criterion.name, cast(Statistic, statistic), *limit, expected))
            else:
                others.append(criterion.name)
        refuse(
            (
                not demands and not grades,
                f"{os.fspath(gate)} has no grade and no limit of position.rms, mean_error, p95 or max to plan for",
            )
        )
    steps = inputs.scale() or default_scale()
    limits = {step.grade: step.position for step in steps.steps}
    for name in dict.fromkeys(grades):
        unknown = f"`grade`: the scale {steps.name} has the grades {', '.join(limits)}, not {name!r}"
        demands.append(
            needed(
                f"grade {name}", steps.statistic, given(limits.get(name), unknown), steps.confidence, expected=expected
            )
        )
    return demands, others


def _payloads(payloads: Sequence[float]) -> tuple[float, ...]:
    """Return payloads, kg, in ascending order.

    Raises:
        UsageError: There are too many, two are equal, or a mass is negative or not finite.
    """
    ordered = sorted(masses("payload", payloads))
    listed = ", ".join(f"{mass:g}" for mass in ordered)
    refuse(
        (
            len(set(ordered)) < len(ordered) or len(ordered) > _MOST_PAYLOADS,
            f"`payload`: expected at most {_MOST_PAYLOADS} different masses, found {listed}",
        )
    )
    return tuple(ordered)
