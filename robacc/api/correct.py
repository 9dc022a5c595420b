"""Call of the command ``robacc correct``, for targets in a table and in a robot program."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any, Literal

import numpy as np

from robacc.accuracy.grade import default_scale
from robacc.api.inputs import Inputs
from robacc.api.parameters import (
    BaseLink,
    CampaignUse,
    Help,
    PosesSource,
    Scale,
    StrPath,
    TipLink,
    call,
    length_and_angle,
)
from robacc.api.result import CsvResult, fields_of
from robacc.correction import (
    Correction,
    Limits,
    Refusal,
    check_same_joints,
    circumstances,
    correction,
)
from robacc.documents.envelope import csv_text
from robacc.errors import LISTED, InputError, MissingColumnError, Problem, by_key, listing, refuse
from robacc.geometry import Array, NDArray, Poses, quaternion_from_rotation
from robacc.measurements import Measurements
from robacc.modelling.validity import standing_campaign
from robacc.poses.csv_file import pose_pieces
from robacc.prediction.model_uncertainty import ModelFit, model_fit, nominal_robot
from robacc.programs.program import Program, read_program
from robacc.programs.targets import (
    allowed_by_window,
    flange_targets,
    is_read,
    joint_targets,
    joint_window,
    leaves_configuration,
    turned_into,
    values_at,
    with_targets,
)
from robacc.quantities import size
from robacc.robots.arm import Arm, inverse_kinematics, joint_ranges, part_of
from robacc.robots.description import Frame, Robot


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Corrected(CsvResult, Correction, command="correct"):
    """Corrected targets, with the inputs."""

    model: Robot
    nominal: Robot
    given: Measurements
    """Targets as given."""

    @property
    def framed_poses(self) -> tuple[Poses, Poses]:
        """Wanted and commanded poses in the frame of the Cartesian targets."""
        frame = self.setting
        return frame.from_measuring(self.wanted.poses), frame.from_measuring(self.commanded)

    def csv_pieces(self) -> Iterator[str]:
        """Yield the file that the command writes: corrected joints, and the wanted poses as ``cmd_`` columns."""
        names = " ".join(file.name for file in self.made.inputs)
        yield f"# Corrected by robacc correct from {names}: joints to command, and the wanted poses; not measured.\n"
        yield from (f"# {place} of the targets is not corrected: {reason}\n" for _, place, reason in self.unchanged)
        wanted, _ = self.framed_poses
        corrected = replace(
            self.given,
            position=np.zeros((3, self.given.n)),
            rotation=None,
            q=self.q,
            commanded_position=wanted.translation,
            commanded_rotation=wanted.rotation if self.wanted.oriented else None,
            sigma_position=None,
            sigma_rotation=None,
            payload=self.data.payload,
            temperature=self.data.temperature,
            time=self.data.time,
        )
        yield from pose_pieces(corrected, attained=False)

    def per_target_csv(self) -> str:
        """Return a CSV with a row for each target: command, correction and expected errors, in m and rad."""
        given, (_, command) = self.given, self.framed_poses
        stages = {"before": self.before, "after": self.after}
        names = (
            "command_x_m command_y_m command_z_m command_qw command_qx command_qy command_qz "
            "dx_m dy_m dz_m drx_rad dry_rad drz_rad"
        )
        vectors = (*command.translation, *quaternion_from_rotation(command.rotation), *self.correction)
        columns: dict[str, Iterable[Any] | None] = {
            "line": map(given.line, range(given.n)),
            "pose": given.pose,
            "target": given.target,
            "corrected": ["yes" if refusal is None else "no" for refusal in self.refusals],
            **dict(zip(names.split(), vectors, strict=True)),
        }
        for stage, errors in stages.items():
            columns |= {
                f"{stage}_m": errors.position,
                f"{stage}_rad": errors.orientation,
                f"{stage}_rms_m": errors.position_rms,
                f"{stage}_rms_rad": errors.orientation_rms,
                f"{stage}_bound95_m": errors.position_bound,
                f"{stage}_bound95_rad": errors.orientation_bound,
            }
        columns |= {f"{stage}_grade": errors.grades for stage, errors in stages.items()}
        columns["reason"] = ["" if refusal is None else refusal.reason for refusal in self.refusals]
        return csv_text(columns)

    @property
    def unchanged(self) -> list[tuple[int, str, str]]:
        """Line, place and reason of each refused target."""
        return [
            (self.given.line(i), self.given.place(i), refusal.reason)
            for i, refusal in enumerate(self.refusals)
            if refusal is not None
        ]


def _by_reason(unchanged: Iterable[tuple[int, str, str]]) -> dict[str, int]:
    """Return a text for each reason, with the number of its targets and the first of them, and the first line.

    Args:
        unchanged: Line, name and reason of each target; a target without a name has its line or row.
    """
    # Without the sizes in a reason, which differ from target to target.
    groups = by_key((re.sub(r"[\d.e+-]+(?= ?(?:mm|°))", "", each[2]), each) for each in unchanged)
    texts = {}
    for group in groups.values():
        places = [name if name.startswith(("line ", "row ")) else f"line {line} {name}" for line, name, _ in group]
        first = "at the first, " * (len({reason for *_, reason in group}) > 1)
        targets = f"{len(group)} target{'s' * (len(group) > 1)} ({listing(places, LISTED)})"
        texts[f"{targets}: {first}{group[0][2]}"] = group[0][0]
    return texts


def _problems(unchanged: Iterable[tuple[int, str, str]], file: str | None, fix: str | None) -> list[Problem]:
    """Return a problem for each reason, and the advice once."""
    problems = [Problem(f"not corrected: {text}", file, line) for text, line in _by_reason(unchanged).items()]
    return [replace(problems[0], fix=fix), *problems[1:]]


class NothingCorrectedError(InputError):
    """No target can be corrected; ``result`` has the reason of each."""

    def __init__(self, result: Corrected) -> None:
        """Store each reason as a problem, and the advice once."""
        advice = (
            "fit the model to poses that include these targets, or give `beyond_range` to extrapolate"
            if result.causes.get("out_of_range") == result.n_targets
            else "check that model, nominal robot and frame belong to these targets"
        )
        super().__init__(_problems(result.unchanged, result.given.source, f"no target can be corrected: {advice}"))
        self.result = result


@call
def correct(
    targets: Annotated[
        PosesSource,
        Help(
            "CSV of targets: joints, or wanted poses as cmd_ columns; or a robot program.",
            "TARGETS",
            "Or poses read or made before; a program is for ``correct_program``. Joints mean the pose that the "
            "nominal robot has there; ``cmd_`` columns (else ``x, y, z``) are wanted poses, and joints beside them "
            "choose the configuration.",
            holds="planned poses",
        ),
    ],
    *,
    model: Annotated[StrPath | Robot, Help("Robot file of the real arm, as `write_model` writes it.", "FILE")],
    nominal: Annotated[
        StrPath | Robot | None,
        Help(
            "Robot file that the controller computes with; default: the robot that the model was fitted from.", "FILE"
        ),
    ] = None,
    frame: Annotated[
        Literal["measuring", "base"],
        Help(
            "Frame of Cartesian targets: measuring frame, or the robot's base.",
            python="In the measuring frame they have the model's tool, in the base that of the nominal robot.",
        ),
    ] = "measuring",
    ordered: Annotated[
        bool,
        Help(
            "The arm drives from target to target in their order.",
            python="Directions and speeds are derived from it.",
            names=("ordered/unordered",),
        ),
    ] = True,
    payload: Annotated[
        float | None,
        Help("Payload of all targets.", "KG", "It is in kg, for targets without a column of it.", least=0.0),
    ] = None,
    temperature: Annotated[
        float | None,
        Help("Temperature of all targets.", "C", "It is in degrees Celsius, for targets without a column of it."),
    ] = None,
    time: Annotated[
        float | None, Help("Time of all targets.", "S", "It is in s, for targets without a column of it.")
    ] = None,
    most: Annotated[
        str | float | None,
        Help(
            "Largest correction, such as 3mm,0.5deg; default: twice the largest on the poses of the fit.",
            "SIZE[,ANGLE]",
            "A number is in m.",
        ),
    ] = None,
    weight: Annotated[
        str | float,
        Help("Length that counts as much as 1 rad for arms with fewer than six axes.", "SIZE", "A number is in m."),
    ] = "10mm",
    beyond_range: Annotated[
        bool, Help("Also correct targets outside the ranges that the model was fitted on.")
    ] = False,
    campaign: Annotated[
        CampaignUse,
        Help(
            "Effects of the campaign of the fit: auto applies its steps, keep its warm-up too, drop neither.",
            python="``drop`` leaves out the frames that were registered too.",
        ),
    ] = "auto",
    strict_range: Annotated[
        bool, Help("Refuse all targets if one is outside the range of the model (exit 3).")
    ] = False,
    scale: Scale = None,
    base_link: BaseLink = None,
    tip_link: TipLink = None,
) -> Corrected:
    """Compute the commands that make the real arm reach its targets, from a model of the arm.

    Returns:
        Corrected commands, expected errors before and after, and the targets that are not corrected, with reasons.

    Raises:
        InputError: A file or array cannot be used, or no target can be corrected.
        UsageError: The targets lack what an effect of the model depends on, or the arguments contradict each other.

    Example:
        >>> import robacc
        >>> robot, model = "sample_data/trace/robot.yaml", "sample_data/trace/truth.yaml"
        >>> result = robacc.correct(robacc.simulate(robot, poses=20, seed=1).data, model=model, nominal=robot)
        >>> result.n_corrected, f"{1e3 * result.before.position.max():.1f} mm"
        (20, '1.4 mm')
    """
    inputs = Inputs(locals(), "targets")
    refuse(
        *(
            (value is not None and not math.isfinite(value), f"`{name}`: expected a finite number, found {value!r}")
            for name, value in (("payload", payload), ("temperature", temperature), ("time", time))
        ),
        (strict_range and beyond_range, "`strict_range` refuses what `beyond_range` corrects; give one of them"),
    )
    arm = inputs.robot(model)
    arm, left_out = standing_campaign(arm, campaign)
    fit = model_fit(arm)
    controller = _nominal(inputs, arm, fit)
    check_same_joints(arm, controller)
    grades = inputs.scale()
    data = inputs.poses(targets, controller, ordered=False, kind="targets", attained=False)
    limits, source = _limits(most, size(weight, "length", "`weight`"), beyond_range, fit)
    columns = circumstances(data, payload, temperature, time)
    low, high = (None if fit is None else fit.ranges.get("temperature_c")) or (-math.inf, math.inf)
    if (at := columns.temperature) is not None and at.size and not low <= at.min() <= at.max() <= high:
        inputs.warnings.append(
            f"the targets are at {at.min():g} to {at.max():g} °C, the model was fitted at {low:g} to {high:g} °C: "
            "of the temperature, only the model's effects are corrected"
        )
    inputs.warnings += (*left_out, *(() if fit is None else fit.warnings))
    try:
        body = correction(
            data,
            arm,
            controller,
            columns,
            fit,
            ordered=ordered,
            frame=frame,
            limits=limits,
            limits_source=source,
            scale=grades or default_scale(),
        )
    except MissingColumnError as error:
        raise MissingColumnError(
            f"{error}; `ordered`, `payload`, `temperature` and `time` give what a column lacks"
        ) from error
    outside = [
        (f"{body.causes['out_of_range']} of {data.n} targets are outside the model; the first: {refusal.reason}", i)
        for i, refusal in enumerate(body.refusals)
        if refusal is not None and refusal.cause == "out_of_range"
    ]
    fix = "leave these targets out, fit the model to poses that include them, or drop `strict_range`"
    refuse(*((strict_range, Problem(text, data.source, data.line(i), fix=fix)) for text, i in outside))
    result = Corrected(
        **fields_of(body),
        model=arm,
        nominal=controller,
        given=data,
        made=inputs.made("targets", "model", "nominal"),
    )
    if result.n_targets and not result.n_corrected:
        raise NothingCorrectedError(result)
    kept = f"{len(result.unchanged)} of {result.n_targets} targets are not corrected and keep their nominal command"
    refused = [f"{kept}: {'; '.join(_by_reason(result.unchanged))}"] if result.unchanged else []
    return replace(result, warnings=(*data.warnings, *inputs.warnings, *refused))


def _nominal(inputs: Inputs, model: Robot, fit: ModelFit | None) -> Robot:
    """Return the robot that the controller computes with, and note doubts about it."""
    if inputs.arguments["nominal"] is not None:
        return inputs.robot(inputs.arguments["nominal"], kind="nominal")
    doubt = (
        "the model does not contain the robot that it was fitted from, so its numbers without its effects count as the "
        "controller's; give `nominal`"
        if model.effects
        else "`model` has neither a fit nor effects, so every correction is zero: give the robot file that "
        "`write_model` wrote, or `nominal` with the controller's robot file"
    )
    inputs.warnings += [doubt] if fit is None else []
    return nominal_robot(model, fit)


def _limits(
    most: str | float | None, weight: float, beyond_range: bool, fit: ModelFit | None
) -> tuple[Limits, Literal["option", "model", "none"]]:
    """Return the limits of corrections and their source.

    Raises:
        UsageError: ``most`` is not one or two sizes.
    """
    refuse((weight <= 0, "`weight`: expected a length above zero"))
    # By default twice the largest correction on the poses of the fit.
    position, angle = (
        length_and_angle("most", most, "3mm,0.5deg")
        if most is not None or fit is None
        else [2.0 * largest for largest in fit.largest_correction]
    )
    limits = Limits(position, angle, weight, beyond_range, None if fit is None else fit.ranges)
    return limits, "option" if most is not None else "none" if fit is None else "model"


# Call that corrects the targets of a robot program: ``robacc correct PROGRAM``.


@dataclass(frozen=True, slots=True)
class CorrectedProgram:
    """Program with corrected targets."""

    program: Program
    data: bytes
    """The corrected program: the same bytes but for the numbers of targets."""
    corrections: tuple[Corrected, ...]
    """Corrections of the joint targets and of the Cartesian ones, as far as the program has them."""
    unchanged: tuple[tuple[int, str, str], ...]
    """Line, name and reason of each target that is not corrected."""
    doubts: tuple[str, ...] = ()
    """Doubts about the model and the robot that the controller computes with."""

    @property
    def n_corrected(self) -> int:
        """Number of corrected targets."""
        return len(self.program.targets) - len(self.unchanged)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings about the model, the unchanged targets, what the program computes, and the configuration."""
        count = self.corrections[0].q.shape[0]
        unread = (
            "Cartesian targets whose configuration is not given, or not read completely: the joints nearest to the "
            "last joint target before them are taken, or a solution within the limits where there is none"
        )
        are_unread = (
            target.kind == "cartesian" and not is_read(self.program.configurations, target.configuration, count)
            for target in self.program.targets
        )
        return (
            *self.doubts,
            *(f"not corrected: {text}" for text in _by_reason(self.unchanged)),
            *(f"line {note.line}: {note.text}: {note.reason}" for note in self.program.notes),
            *[unread] * any(are_unread),
        )


def correct_program(
    path: StrPath,
    *,
    model: StrPath | Robot,
    nominal: StrPath | Robot | None = None,
    frames: Sequence[StrPath] = (),
    **options: Any,
) -> CorrectedProgram:
    """Correct the targets of a robot program.

    Joint targets mean the pose that the nominal robot has there. Cartesian targets lead through their tool and base to
    a pose of the flange in the robot's base frame. Joint and Cartesian targets are corrected each in their own order.

    Args:
        path: Program of a dialect of :func:`robacc.programs.program.read_program`.
        model: Robot file of the real arm.
        nominal: Robot file that the controller computes with; None for the robot that the model was fitted from.
        frames: Files with tools and bases that the program only names.
        options: Further arguments of :func:`robacc.api.correct.correct`.

    Raises:
        InputError: The program cannot be read, or none of its targets can be corrected.
        UsageError: As :func:`robacc.api.correct.correct`.
    """
    inputs = Inputs(locals())
    program = read_program(path, frames)
    fix = "give the file that declares them"
    refuse((not program.targets, Problem("has no targets that can be corrected", program.file, fix=fix)))
    arm = inputs.robot(model)
    controller = _nominal(inputs, arm, model_fit(arm))
    flange_arm = replace(controller, tool=Frame(), targets={})
    known, flange, unknown = flange_targets(program)
    hint = "; give the file that defines it with `frames`"
    left = [(index, reason + hint * ("is in none of the files" in reason)) for index, reason in unknown]
    numbers, q = joint_targets(program)
    message = f"the joint target has {q.shape[0]} joints, the model's arm has {len(flange_arm.variables)}"
    line, fix = program.targets[(*numbers, 0)[0]].line, "give the model of the arm that runs this program"
    refuse((numbers and q.shape[0] != len(flange_arm.variables), Problem(message, program.file, line, fix=fix)))
    groups: list[tuple[tuple[int, ...], dict[str, Any]]] = [(numbers, {"q": q})] if numbers else []
    if known:
        solved, q_start, refused = _configured(program, known, flange, flange_arm)
        left += refused
        wanted = part_of(flange, solved)
        poses = {"commanded_position": wanted.translation, "commanded_rotation": wanted.rotation}
        groups += [(tuple(known[i] for i in solved), {"q": q_start, **poses})] if solved.size else []
    values: dict[int, Sequence[float]] = {}
    results = []
    advice: str | None = None
    for group, columns in groups:
        rows = np.array([program.targets[i].line for i in group], dtype=np.int64)
        data = Measurements(np.zeros((3, rows.size)), rows=rows, source=program.file, **columns)
        try:
            result = correct(data, model=arm, nominal=flange_arm, frame="base", **options)
        except NothingCorrectedError as error:
            # Targets of the other kind may be correctable.
            result, advice = error.result, error.problems[0].fix
        if group == numbers:
            new = [tuple(column) for column in result.q.T.tolist()]
        else:
            stated = [program.targets[number] for number in group]
            other = "the corrected joints have another configuration than that of the program"
            refusals = tuple(
                Refusal("configuration", f"{other}, {target.configuration}")
                if refusal is None and leaves_configuration(program.configurations, target.configuration, nominal, q)
                else refusal
                for target, refusal, nominal, q in zip(
                    stated, result.refusals, result.wanted.q.T, result.q.T, strict=True
                )
            )
            result = replace(result, refusals=refusals)
            new = values_at(program, group, result.setting.from_measuring(result.commanded))
        results.append(result)
        values |= {i: value for i, value, refusal in zip(group, new, result.refusals, strict=True) if refusal is None}
        left += [(i, refusal.reason) for i, refusal in zip(group, result.refusals, strict=True) if refusal is not None]
    unchanged = sorted((program.targets[i].line, program.targets[i].name, reason) for i, reason in left)
    if not values:
        raise InputError(_problems(unchanged, program.file, advice))
    doubts = tuple(dict.fromkeys((*inputs.warnings, *(text for result in results for text in result.made.warnings))))
    corrected = with_targets(program, [values.get(i) for i in range(len(program.targets))])
    return CorrectedProgram(program, corrected, tuple(results), tuple(unchanged), doubts)


def _configured(
    program: Program, numbers: Sequence[int], flange: Poses, flange_arm: Robot
) -> tuple[NDArray[np.int64], Array | None, list[tuple[int, str]]]:
    """Return the targets with a solution in their configuration, ``(N,)`` and joints ``(J, N)``, and those without.

    A target without a solution has its number and the reason. Where no configuration is read, the joints are those of
    the last joint target before.
    """
    before = _joints_before(program, numbers)
    chosen = [program.targets[i] for i in numbers]
    arm = Arm.of(replace(flange_arm, base=Frame()))
    variables = arm.robot.variables
    rules = program.configurations
    windows = [joint_window(rules, target.configuration, len(variables)) for target in chosen]
    if all(window is None for window in windows):
        return np.arange(len(chosen)), before, []
    limits, revolute = joint_ranges(arm), np.array([joint.type == "revolute" for joint in variables])
    # Enough starts for every configuration of an arm with eight, as a rule.
    solutions = inverse_kinematics(arm, flange, starts=48)
    result = np.zeros((len(variables), len(chosen)))
    refused, solved = [], []
    previous = np.zeros(len(variables))
    for i, (target, window) in enumerate(zip(chosen, windows, strict=True)):
        q, usable = solutions.q[:, i], solutions.converged[i]
        if window is not None:
            q = turned_into(window, q, limits, revolute)
            usable = usable & allowed_by_window(window, q) & rules.allows(arm, target.configuration, q)
        if before is not None and not is_read(rules, target.configuration, len(variables)):
            previous = before[:, i]
        if usable.any():
            distance = np.sum(np.square(q - previous[:, None]), axis=0)
            previous = result[:, i] = q[:, int(np.argmin(np.where(usable, distance, np.inf)))]
            solved.append(i)
        else:
            refused.append(
                (numbers[i], f"the nominal robot has no solution in its configuration {target.configuration}")
            )
    index = np.array(solved, dtype=np.int64)
    return index, result[:, index], refused


def _joints_before(program: Program, numbers: Sequence[int]) -> Array | None:
    """Return the joints ``(J, N)`` of the last joint target before each Cartesian one; None without a joint target."""
    before: dict[int, tuple[float, ...]] = {}
    joints = [program.targets[index].values for index in program.moves if program.targets[index].kind == "joint"]
    last = None
    for index in program.moves:
        target = program.targets[index]
        if target.kind == "joint":
            last = target.values
        elif last is not None:
            before.setdefault(index, last)
    return np.array([before.get(i, joints[0]) for i in numbers], dtype=float).T if joints else None
