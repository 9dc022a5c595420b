"""Call that corrects the targets of a robot program: ``robacc correct PROGRAM``."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robacc.api.correct import Corrected, NothingCorrectedError, correct, load_nominal
from robacc.api.inputs import StrPath, load_robot
from robacc.errors import InputError, Problem
from robacc.geometry import Array, Poses
from robacc.measurements import Measurements
from robacc.programs.configuration import is_read, joint_window, leaves_configuration
from robacc.programs.flange import FlangeTargets, flange_targets, joint_targets, values_at
from robacc.programs.krl_status import allowed_by_status
from robacc.programs.program import Dialect, Program
from robacc.programs.reading import read_program
from robacc.programs.writing import with_targets
from robacc.robots.arm import Arm
from robacc.robots.description import Frame, Robot
from robacc.robots.inverse_kinematics import inverse_kinematics, joint_ranges

_STARTS = 48
"""Starts of the inverse kinematics: enough for every configuration of an arm with eight, as a rule."""


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
        lines = list(self.doubts)
        for line, name, reason in self.unchanged:
            place = f"line {line}"
            lines.append(f"{place if name == place else f'{place}: {name}'} is not corrected: {reason}")
        lines += [f"line {note.line}: {note.text}: {note.reason}" for note in self.program.notes]
        count = self.corrections[0].targets.q.shape[0]
        if any(
            target.kind == "cartesian" and not is_read(self.program.dialect, target.configuration, count)
            for target in self.program.targets
        ):
            lines.append(
                "Cartesian targets whose configuration is not given, or not read completely: the joints nearest to the "
                "last joint target before them are taken, or a solution within the limits where there is none"
            )
        return tuple(lines)


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
        path: Program of a dialect of :func:`robacc.programs.reading.read_program`.
        model: Robot file of the real arm.
        nominal: Robot file that the controller computes with; None for the robot that the model was fitted from.
        frames: Files with tools and bases that the program only names.
        options: Further arguments of :func:`robacc.api.correct.correct`.

    Raises:
        InputError: The program cannot be read, or none of its targets can be corrected.
        UsageError: As :func:`robacc.api.correct.correct`.
    """
    program = read_program(path, frames)
    if not program.targets:
        fix = "give the file that declares them"
        raise InputError(Problem("has no targets that can be corrected", program.file, fix=fix))
    arm, _ = load_robot(model)
    controller, _, doubts = load_nominal(nominal, arm)
    flange_arm = dataclasses.replace(controller, tool=Frame(), targets={})
    values: list[Sequence[float] | None] = [None] * len(program.targets)
    unchanged: list[tuple[int, str, str]] = []
    results = []
    cartesian = flange_targets(program)
    for index, reason in cartesian.unknown:
        hint = "; give the file that defines it with `frames`" if "is in none of the files" in reason else ""
        unchanged.append((program.targets[index].line, program.targets[index].name, reason + hint))
    numbers, q = joint_targets(program)
    count = len(flange_arm.variables)
    if numbers and q.shape[0] != count:
        message = f"the joint target has {q.shape[0]} joints, the model's arm has {count}"
        fix = "give the model of the arm that runs this program"
        raise InputError(Problem(message, program.file, program.targets[numbers[0]].line, fix=fix))
    groups: list[tuple[tuple[int, ...], Measurements]] = []
    if numbers:
        groups.append((numbers, _located(program, numbers, Measurements(np.zeros((3, len(numbers))), q=q))))
    if cartesian.numbers:
        solved, q_start, refused = _configured(program, cartesian, flange_arm)
        unchanged += refused
        if solved.size:
            group = tuple(cartesian.numbers[i] for i in solved)
            groups.append((group, _located(program, group, _wanted(cartesian, solved, q_start))))
    advice: str | None = None
    for group, data in groups:
        try:
            result = correct(data, model=arm, nominal=flange_arm, frame="base", **options)
        except NothingCorrectedError as error:
            # Targets of the other kind may be correctable.
            result, advice = error.result, error.problems[0].fix
        results.append(result)
        new = _values(program, group, result)
        reasons = _reasons(program, group, result)
        for index, value, doubt in zip(group, new, reasons, strict=True):
            if doubt is None:
                values[index] = value
            else:
                unchanged.append((program.targets[index].line, program.targets[index].name, doubt))
    if not any(value is not None for value in values):
        problems = [
            Problem(
                f"not corrected: {reason}" if name == f"line {line}" else f"{name} is not corrected: {reason}",
                program.file,
                line,
            )
            for line, name, reason in sorted(unchanged)
        ]
        raise InputError([dataclasses.replace(problems[0], fix=advice), *problems[1:]])
    doubts = tuple(dict.fromkeys((*doubts, *(doubt for result in results for doubt in result.doubts))))
    return CorrectedProgram(program, with_targets(program, values), tuple(results), tuple(sorted(unchanged)), doubts)


def _located(program: Program, numbers: Sequence[int], data: Measurements) -> Measurements:
    """Return poses of the targets ``numbers`` with the file and the line of each."""
    rows = np.array([program.targets[i].line for i in numbers], dtype=np.int64)
    return dataclasses.replace(data, rows=rows, source=program.file)


def _wanted(targets: FlangeTargets, index: NDArray[np.int64], q: Array | None) -> Measurements:
    """Return the targets ``index`` as commanded poses, with joints ``(J, N)`` that choose their configurations."""
    position, rotation = targets.flange.translation[:, index], targets.flange.rotation[..., index]
    return Measurements(np.zeros_like(position), q=q, commanded_position=position, commanded_rotation=rotation)


def _configured(
    program: Program, targets: FlangeTargets, flange_arm: Robot
) -> tuple[NDArray[np.int64], Array | None, list[tuple[int, str, str]]]:
    """Return the targets with a solution in their configuration, ``(N,)`` and joints ``(J, N)``, and those without.

    A target without a solution has its line, name and reason. Where no configuration is read, the joints are those of
    the last joint target before.
    """
    before = _joints_before(program, targets.numbers)
    chosen = [program.targets[i] for i in targets.numbers]
    arm = Arm.of(dataclasses.replace(flange_arm, base=Frame()))
    variables = arm.robot.variables
    windows = [joint_window(program.dialect, target.configuration, len(variables)) for target in chosen]
    if not any(windows):
        return np.arange(len(chosen)), before, []
    limits, revolute = joint_ranges(arm), np.array([joint.type == "revolute" for joint in variables])
    solutions = inverse_kinematics(arm, targets.flange, starts=_STARTS)
    result = np.zeros((len(variables), len(chosen)))
    refused, solved = [], []
    previous = np.zeros(len(variables))
    for i, (target, window) in enumerate(zip(chosen, windows, strict=True)):
        q, usable = solutions.q[:, i], solutions.converged[i]
        if window is not None:
            q = window.turned(q, limits, revolute)
            usable = usable & window.allows(q)
            if program.dialect is Dialect.krl:
                usable &= allowed_by_status(arm, target.configuration, q)
        if before is not None and not is_read(program.dialect, target.configuration, len(variables)):
            previous = before[:, i]
        if not usable.any():
            reason = f"the nominal robot has no solution in its configuration {target.configuration}"
            refused.append((target.line, target.name, reason))
            continue
        distance = np.sum(np.square(q - previous[:, None]), axis=0)
        previous = result[:, i] = q[:, int(np.argmin(np.where(usable, distance, np.inf)))]
        solved.append(i)
    index = np.array(solved, dtype=np.int64)
    return index, result[:, index], refused


def _joints_before(program: Program, numbers: Sequence[int]) -> Array | None:
    """Return the joints ``(J, N)`` of the last joint target before each Cartesian one; None without a joint target."""
    before: dict[int, tuple[float, ...]] = {}
    last: tuple[float, ...] | None = None
    first: tuple[float, ...] | None = None
    for move in program.moves:
        target = program.targets[move.target]
        if target.kind == "joint":
            last = target.values
            first = first or last
        elif last is not None:
            before.setdefault(move.target, last)
    if first is None:
        return None
    start = first
    return np.array([before.get(i, start) for i in numbers], dtype=float).T


def _reasons(program: Program, numbers: Sequence[int], result: Corrected) -> Iterator[str | None]:
    """Yield for each target why it is not corrected; None for a target that is."""
    targets = result.targets
    for k, (number, refusal) in enumerate(zip(numbers, targets.refusals, strict=True)):
        target = program.targets[number]
        if refusal is not None:
            yield refusal.reason
        elif target.kind == "cartesian" and leaves_configuration(
            program.dialect, target.configuration, targets.wanted.q[:, k], targets.q[:, k]
        ):
            yield f"the corrected joints have another configuration than that of the program, {target.configuration}"
        else:
            yield None


def _values(program: Program, numbers: Sequence[int], result: Corrected) -> list[tuple[float, ...]]:
    """Return the corrected values of targets of one kind."""
    if program.targets[numbers[0]].kind == "joint":
        return [tuple(column) for column in result.targets.q.T.tolist()]
    command: Poses = result.targets.pair.from_measuring(result.targets.command)
    return values_at(program, numbers, command)
