"""Call of the command ``robacc plan``."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import PurePath
from typing import Annotated, Any, ClassVar, Literal, cast

from robacc.accuracy.error_statistics import Statistic
from robacc.accuracy.grade import default_scale
from robacc.api.inputs import load_grade_scale, load_poses, load_robot, optional
from robacc.api.parameters import (
    BaseLink,
    Help,
    Ordered,
    PosesSource,
    RobotArgument,
    RobotSource,
    Scale,
    Seed,
    StrPath,
    TipLink,
    call,
    check_range,
    count_or_path,
    numbers,
)
from robacc.api.result import CsvResult, Provenance, fields_of, options_of, use_model
from robacc.diagnostics.robot_poses import joints_of
from robacc.documents.envelope import InputFile
from robacc.documents.expected import PLAN
from robacc.documents.gate import read_gate
from robacc.errors import UsageError
from robacc.measurements import Measurements
from robacc.planning.campaign import (
    DEFAULT_CANDIDATES,
    CampaignPlan,
    CampaignSettings,
    Demand,
    plan_campaign,
)
from robacc.planning.candidates import (
    Constraints,
    Sight,
    at_rest_warning,
    check_at_rest,
    length,
    parse_box,
    parse_distance,
    parse_half_space,
    parse_vector,
)
from robacc.plug_ins import plug_in
from robacc.poses.csv_file import format_poses, pose_pieces
from robacc.programs.writing import SUFFIX, write_program
from robacc.quantities import optional_size, size
from robacc.render.views.expected import plan_comments
from robacc.robots.description import Robot

_MOST_PAYLOADS = 5
_STATISTICS = ("rms", "mean_error", "p95", "max")


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Planned(CsvResult, CampaignPlan):
    """Planned poses and the expected result, with the inputs."""

    command: ClassVar[str] = "plan"

    def csv_pieces(self) -> Iterator[str]:
        """Yield the file of the visits that the command writes: pose, cycle, joints, direction and speed."""
        yield from (f"# {line}\n" for line in plan_comments(self))
        yield from pose_pieces(self.visits(), attained=False)

    def validation_csv(self) -> str:
        """Return the file of the validation poses.

        Raises:
            UsageError: The plan has none.
        """
        head = (
            f"# Validation poses planned by robacc plan for {self.robot.name}; nothing was measured.\n"
            "# Use them only to check a fit (`holdout`), never in the fit.\n"
        )
        return head + format_poses(self.validation_poses(), attained=False)

    def programs(self, path: StrPath) -> dict[str, str]:
        """Return the visits as robot programs in the language of the suffix of ``path``: text by file name.

        ``.src`` is KRL, ``.mod`` RAPID, ``.ls`` FANUC TP, ``.script`` URScript. A program stops at each pose. With
        several payloads there is a program for each, ``plan_5kg.src`` for ``plan.src``, in the order to run.

        Raises:
            UsageError: The suffix is of no language, or the robot has too many joints for it.
        """
        file = PurePath(path)
        dialects = {suffix: dialect for dialect, suffix in SUFFIX.items()}
        if file.suffix.lower() not in dialects:
            raise UsageError(f"`program`: expected a file name that ends in {', '.join(dialects)}, found {path!r}")
        linear = [i for i, joint in enumerate(self.robot.variables) if joint.type == "prismatic"]
        targets = [(self.ids[i], q.tolist()) for i, q in zip(self.route.visits, self.q.T, strict=True)]
        groups = {os.fspath(path): targets}
        if self.payload_kg is not None and len(self.payload_blocks) > 1:
            groups = {
                str(file.with_name(f"{file.stem}_{block.payload:g}kg{file.suffix}")): [
                    target for target, mass in zip(targets, self.payload_kg, strict=True) if mass == block.payload
                ]
                for block in self.payload_blocks
            }
        return {
            name: write_program(dialects[file.suffix.lower()], group, name=PurePath(name).stem, linear=linear)
            for name, group in groups.items()
        }

    def payload(self) -> dict[str, Any]:
        """Return the result's own keys; arrays stay arrays."""
        return PLAN.write(self)


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
        Help("CSV of poses to choose from, or number of samples.", "FILE|N", read=count_or_path, holds="planned poses"),
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
        >>> result.accuracy.planned.rms < result.accuracy.planned.random_rms
        True
    """
    arguments = locals()
    arm, record = load_robot(robot, base_link, tip_link)
    calibrated, model_records = optional(load_robot, model, kind="model")
    if calibrated is not None and calibrated.variable_names != arm.variable_names:
        raise UsageError(
            f"`model` has the joints {', '.join(calibrated.variable_names)}, but the robot has "
            f"{', '.join(arm.variable_names)}; give the model of this robot"
        )
    # A drift and other facts of the model's own campaign do not come again.
    use = use_model(calibrated or arm, None, campaign="drop")
    described, arm = arm, use.robot or arm
    n_candidates, chosen_from = (candidates, None) if isinstance(candidates, int) else (DEFAULT_CANDIDATES, candidates)
    check_range("candidates", n_candidates, 10, 100_000)
    known = replace(joints_of(arm), limits=None)  # limits are a matter of the filters
    given: dict[str, Measurements | None] = {}
    records = [record, *model_records]
    for kind, source in (("candidates", chosen_from), ("task", task)):
        given[kind], read = optional(load_poses, source, arm, kind=kind, attained=False, visited_by=known)
        if (poses_to_visit := given[kind]) is not None:
            check_at_rest(arm, poses_to_visit)
        records += read
    given["already"], read = optional(load_poses, already, arm, ordered=ordered, kind="already", attained=False)
    links = None
    if collisions:
        if isinstance(robot, Robot) or described.convention != "urdf":
            raise UsageError(
                "`collisions` needs the shapes of the links: give the URDF of the robot, and a fit as `model`"
            )
        links = plug_in("robacc.collisions", "fcl")(os.fspath(robot), described)
    demands, demand_records = _demands(gate, grade, scale)
    if demands and purpose != "acceptance":
        raise UsageError("`gate` and `grade` set the number of acceptance poses; give purpose acceptance")
    settings = CampaignSettings(
        purpose=purpose,
        poses=poses,
        criterion=criterion,
        fit=fit if isinstance(fit, str) else ",".join(fit),
        constraints=Constraints(
            margin=margin,
            inside=None if inside is None else parse_box(inside, "inside"),
            outside=tuple(parse_box(text, "outside") for text in outside),
            half_spaces=tuple(parse_half_space(text, "half_space") for text in half_space),
            min_height=None if min_height is None else length(min_height, "min_height"),
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
        expected=optional_size(expected, "length", "`expected`"),
        n_candidates=n_candidates,
        payloads=_payloads(payload),
        seed=seed,
    )
    body = plan_campaign(arm, settings, **given)
    doubts = [text for data in given.values() if data is not None for text in data.warnings]
    body = replace(body, warnings=(*body.warnings, *at_rest_warning(arm), *use.warnings, *doubts))
    # Files are recorded by their names, objects not at all.
    files = ("model", "candidates", "task", "already", "gate", "scale")
    options = {
        name: os.path.basename(os.fspath(value)) if name in files and isinstance(value, str | os.PathLike) else value
        for name, value in options_of(plan, arguments).items()
        if not isinstance(value, Measurements | Robot)
    }
    return Planned(**fields_of(body), made=Provenance(options, (*records, *read, *demand_records), seed))


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
    if instrument is None:
        if reflector is not None or distance is not None:
            raise UsageError("`reflector` and `distance` need `instrument`, the position of the instrument")
        return None
    near_far = (0.0, math.inf) if distance is None else parse_distance(distance, "distance")
    axis = None if reflector is None else parse_vector(reflector, "reflector")
    if axis is not None and not any(axis):
        raise UsageError("`reflector`: the direction has no length")
    return Sight(parse_vector(instrument, "instrument"), axis, size(cone, "angle", "`cone`"), near_far)


def _demands(
    gate: StrPath | None, grade: str | None, scale: StrPath | None
) -> tuple[tuple[Demand, ...], tuple[InputFile, ...]]:
    """Return the limits of a gate and of a grade on the position, which the measurement is to decide."""
    demands: list[Demand] = []
    records: tuple[InputFile, ...] = ()
    if gate is not None:
        loaded = read_gate(os.fspath(gate))
        records = loaded.records
        for criterion in loaded.gate.criteria:
            quantity, _, statistic = criterion.key.partition(".")
            if quantity == "position" and statistic in _STATISTICS and criterion.limit is not None:
                name = cast(Statistic, statistic)
                demands.append(Demand(criterion.name, name, criterion.limit, criterion.confidence, criterion.share))
        if not demands:
            raise UsageError(f"{os.fspath(gate)} has no limit of position.rms, mean_error, p95 or max to plan for")
    if grade is not None:
        custom, scale_records = load_grade_scale(scale)
        steps = custom or default_scale()
        limits = {step.grade: step.position for step in steps.steps}
        if grade not in limits:
            raise UsageError(f"`grade`: the scale {steps.name} has the grades {', '.join(limits)}, not {grade!r}")
        demands.append(Demand(f"grade {grade}", steps.statistic, limits[grade], steps.confidence))
        records = (*records, *scale_records)
    return tuple(demands), records


def _payloads(payloads: Sequence[float]) -> tuple[float, ...]:
    """Return payloads, kg, in ascending order.

    Raises:
        UsageError: There are too many, two are equal, or a mass is negative or not finite.
    """
    masses = sorted(map(float, payloads))
    for mass in masses:
        if not 0 <= mass < math.inf:
            raise UsageError(f"`payload`: expected masses of at least 0 kg, found {mass:g}")
    if len(set(masses)) < len(masses) or len(masses) > _MOST_PAYLOADS:
        listed = ", ".join(f"{mass:g}" for mass in masses)
        raise UsageError(f"`payload`: expected at most {_MOST_PAYLOADS} different masses, found {listed}")
    return tuple(masses)
