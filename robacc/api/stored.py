"""Calls of ``robacc check``, ``robacc compare`` and ``robacc compare --paired``: results against others."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import PurePath
from typing import Annotated, Any, ClassVar

from robacc.api.accuracy import estimate
from robacc.api.inputs import STDIN, Inputs, path_of, read_result
from robacc.api.parameters import Confidence, Help, PosesSource, RobotSource, Seed, StrPath, call
from robacc.api.result import Provenance, Result, fields_of
from robacc.comparison.comparing import PairedTargets, compare as compare_results, noise_doubts, paired_targets
from robacc.comparison.stored_results import ComparedResult, read_compared_result
from robacc.documents.compare import COMPARE, COMPARE_PAIRED
from robacc.documents.envelope import CHECK, StoredResult, read_gate, understood
from robacc.errors import InputError, Problem, refuse
from robacc.gates import GateOutcome, evaluate_gate
from robacc.prediction.model_uncertainty import model_fit


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Checked(Result, GateOutcome):
    """Outcome of a gate, with the result that was checked."""

    command: ClassVar[str] = "check"
    keys = CHECK
    result: StoredResult


@call
def check(
    result: Annotated[
        StrPath | Result | StoredResult,
        Help("Result of any command as JSON; - reads standard input.", "RESULT", "Or the result of a call."),
    ],
    gate: Annotated[StrPath, Help("Gate file (YAML) with the criteria.", "FILE")],
) -> Checked:
    """Check a result against a gate.

    Returns:
        ``outcome`` of the gate and of each criterion; ``exit_status`` of the command: 0 for pass, 4 for fail, 5 for
        inconclusive.

    Raises:
        InputError: A file cannot be read, or the result is not what its command writes.

    Example:
        >>> import robacc
        >>> result = robacc.estimate(
        ...     "sample_data/poses.csv", robot="sample_data/robot.yaml", align=("base_frame", "tool_frame")
        ... )
        >>> checked = robacc.check(result, "configs/gates/assembly.yaml")
        >>> print(checked.outcome, checked.exit_status)
        fail 4
    """
    loaded, baselines, records = read_gate(os.fspath(gate))
    stored = stored_result(result)
    with understood(stored.name, stored.command):
        outcome = evaluate_gate(loaded, stored.document, baselines)
    return Checked(**fields_of(outcome), result=stored, made=Provenance({}, (stored.record, *records)))


def stored_result(source: StrPath | Result | StoredResult) -> StoredResult:
    """Return a stored result; one just computed becomes what its file would be, named by its command.

    Raises:
        InputError: The file cannot be read or holds no result.
    """
    if isinstance(source, Result):
        text = source.to_json()
        return StoredResult(json.loads(text), source.command, sha256(text.encode()).hexdigest(), source.command)
    return source if isinstance(source, StoredResult) else read_result(source)


Source = StrPath | Result | StoredResult
_START = 256
"""Bytes of a file in which its first sign is looked for."""


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Compared(Result):
    """Comparison of results, with the files that they were read from; its parts have the keys of the document."""

    command: ClassVar[str] = "compare"
    keys = COMPARE
    results: tuple[ComparedResult, ...]
    baseline: str
    confidence: float
    pairing: Sequence[Mapping[str, Any]]
    statistics: Sequence[Mapping[str, Any]]
    ranking: Mapping[str, Any]
    grade: Mapping[str, Any] | None
    notes: tuple[str, ...]
    warnings: tuple[str, ...]


@call
def compare(
    *results: Annotated[
        Source,
        Help(
            "Results stored as JSON, or files of poses, which are estimated first; two CSVs with `paired`; - reads a "
            "result from standard input.",
            "RESULT RESULT …",
            "Or results of calls. A file gives its name, another result that of its command; equal names get a number.",
            holds="measured poses",
        ),
    ],
    robot: Annotated[
        RobotSource | None, Help("Robot of the files of poses: robot file (YAML), URDF, or name of an arm.", "FILE")
    ] = None,
    align: Annotated[
        str | Sequence[str] | None, Help("Frames to fit to each file of poses first, as in estimate.", "FRAME,…")
    ] = None,
    baseline: Annotated[
        str | None, Help("Result that the others are compared with; default: the first.", "NAME")
    ] = None,
    by: Annotated[
        str | None, Help("Figure for the ranking, such as position.p95; default: position.rms.", "KEY")
    ] = None,
    grade: Annotated[str | None, Help("Grade to check each result for.", "GRADE")] = None,
    scale: Annotated[StrPath | None, Help("Grade scale (YAML) in place of the scale of the results.", "FILE")] = None,
    confidence: Confidence = 0.95,
    seed: Seed = 0,
) -> Compared:
    """Compare results or files of poses: shared figures, significant differences, and the grades that are confirmed.

    Differences are paired if the results have the same poses. A prediction is not ranked with measured arms.

    Returns:
        Every shared figure with its differences, the ranking, the grades, and other differences between the results.

    Raises:
        InputError: A result cannot be read; with the problems of every file.
        UsageError: A name, key or grade does not exist, or there is one result only.

    Example:
        >>> import robacc
        >>> plain = robacc.estimate("sample_data/poses.csv", robot="sample_data/robot.yaml")
        >>> aligned = robacc.estimate("sample_data/poses.csv", robot="sample_data/robot.yaml", align="base_frame")
        >>> [entry["name"] for entry in robacc.compare(plain, aligned).ranking["order"]]
        ['estimate (2)', 'estimate']
    """
    inputs = Inputs(locals())
    options: dict[str, Any] = {"robot": robot, "align": align}
    are_poses = [*map(_are_poses, results)]
    unused = [option for option in options if options[option] is not None and not any(are_poses)]
    refuse(
        (scale is not None and grade is None, "`scale` needs `grade`, the grade to check the results for"),
        (len(results) < 2, "a comparison takes at least two results"),
        ([path_of(source) for source in results].count(STDIN) > 1, "standard input can be read only once"),
        *((True, f"`{option}` is for files of poses, and all files are results") for option in unused),
    )
    problems: list[Problem] = []
    compared_results: list[ComparedResult] = []
    doubts: list[str] = []
    for source, name, is_poses in zip(results, _names(results), are_poses, strict=True):
        try:
            if is_poses:
                estimated = estimate(_path(source), **options)
                doubts += [type(text)(f"{name}: {text}") for text in estimated.warnings]
                result = stored_result(estimated)
                inputs.records += [record for record in estimated.made.inputs if record not in inputs.records]
            else:
                result = stored_result(source)
                inputs.records.append(result.record)
            with understood(result.name, result.command):
                compared_results.append(read_compared_result(result.document, name, result.name, result.sha256))
        except InputError as error:
            problems += error.problems
    refuse((problems, problems))
    grades = inputs.scale()
    names = {_path(source): item.name for source, item in reversed([*zip(results, compared_results, strict=True)])}
    comparison = compare_results(
        compared_results,
        baseline=baseline if baseline is None else names.get(baseline, baseline),
        by=by,
        required_grade=grade,
        scale=grades,
        confidence=confidence,
        seed=seed,
    )
    made = inputs.made(baseline=comparison["baseline"], by=comparison["ranking"]["by"])
    return Compared(**{**comparison, "warnings": (*comparison["warnings"], *doubts)}, made=made)


def _are_poses(source: Source) -> bool:
    """Return whether a source is a file of poses: a folder, or a file that is no JSON object."""
    if isinstance(source, Result | StoredResult) or not os.path.exists(source):
        return False
    if not os.path.isfile(source):
        return os.path.isdir(source)
    with open(source, "rb") as file:
        return not file.read(_START).lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"{")


def _names(results: Sequence[Source]) -> list[str]:
    """Return short unique names: the file's, with its folder or a number where files have the same name."""
    paths = [*map(_path, results)]
    names = ["standard input" if path == STDIN else PurePath(path).stem for path in paths]
    folders = [PurePath(path).parent.name for path in paths]
    names = [
        f"{folder}/{name}" if names.count(name) > 1 and folder else name
        for folder, name in zip(folders, names, strict=True)
    ]
    return [f"{name} ({names[:i].count(name) + 1})" if name in names[:i] else name for i, name in enumerate(names)]


def _path(source: Source) -> str:
    """Return the path of a file, or the command of a result without one."""
    if isinstance(source, StoredResult):
        return source.name
    return source.command if isinstance(source, Result) else os.fspath(source)


# Call of ``robacc compare --paired``.


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class ComparedTargets(Result, PairedTargets):
    """The same targets before and after a correction, with the inputs."""

    command: ClassVar[str] = "compare-paired"
    keys = COMPARE_PAIRED
    doubts: tuple[str, ...]

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings of the poses read, and a correction that is not loaded."""
        unloaded = "no sign that the correction was loaded: the targets are where they were before"
        return (*self.doubts, *[unloaded] * (self.loaded["verdict"] == "not_loaded"))


@call
def compare_paired(
    before: Annotated[PosesSource, Help("Poses measured without the correction.")],
    after: Annotated[PosesSource, Help("Poses measured with the correction.")],
    *,
    model: Annotated[
        RobotSource | None,
        Help("Model of the correction, to test whether the remaining error agrees with its prediction."),
    ] = None,
    nominal: Annotated[
        RobotSource | None,
        Help("Robot file that the controller computes with; only for files without ``cmd_`` columns."),
    ] = None,
    noise: Annotated[
        str | float | None,
        Help(
            "Standard deviation of the measurement noise along each axis, m or text; None for that of `after`, else of "
            "the model's fit. Where the unexplained error of the model contains the noise of its own measurements, it "
            "is only the lower bound of that error, with a warning."
        ),
    ] = None,
) -> ComparedTargets:
    """Compare the same targets, measured before and after a correction.

    Rows belong together by their ``pose``, or by their order where both files have no such column. Wanted poses are the
    ``cmd_`` columns of ``after``, as ``correct`` writes them, else of ``before``, else the poses of the nominal robot
    at the joints of ``before``.

    Returns:
        The gain with its interval, the remaining error, whether the correction was loaded, and whether the remaining
            error agrees with the model.

    Raises:
        InputError: A file cannot be used, or the files share fewer than three targets.
        UsageError: The arguments contradict each other.

    Example:
        >>> from dataclasses import replace
        >>> import robacc
        >>> robot, model = "sample_data/trace/robot.yaml", "sample_data/trace/truth.yaml"
        >>> targets = robacc.simulate(robot, poses=20, seed=1).data
        >>> planned = robacc.correct(targets, model=model, nominal=robot)
        >>> old = replace(targets, commanded_position=planned.wanted.poses.translation)
        >>> new = replace(old, q=planned.q)
        >>> before = robacc.simulate(model, at=old, noise="0.02mm", seed=2).data
        >>> after = robacc.simulate(model, at=new, noise="0.02mm", seed=3).data
        >>> result = robacc.compare_paired(before, after)
        >>> result.loaded["verdict"], result.metrics_after.rms < 0.1 * result.metrics_before.rms
        ('loaded', True)
    """
    inputs = Inputs(locals(), "before", "after")
    arm, controller = (None if robot is None else inputs.robot(robot) for robot in (model, nominal))
    first = inputs.poses(before, controller or arm, kind="before")
    second = inputs.poses(after, controller or arm, kind="after")
    body = paired_targets(first, second, controller, arm, noise)
    doubts = [*first.warnings, *second.warnings]
    if first.commanded_position is None and second.commanded_position is None:
        doubts.append(
            "neither file has wanted poses (cmd_ columns), so those of the nominal robot at the joints of `before` "
            "count; errors of base and tool frames are part of the figures"
        )
    if arm is not None and body.promise is not None:
        fit = model_fit(arm)
        doubts += (*noise_doubts(body.promise["noise"]), *(() if fit is None else fit.warnings))
    made = inputs.made("before", "after", "model", "nominal")
    return ComparedTargets(**fields_of(body), doubts=tuple(doubts), made=made)
