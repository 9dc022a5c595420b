"""Calls that use stored results: check, compare, pairs of targets, and the results of arms over time."""

from __future__ import annotations

import json
import os
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from hashlib import sha256
from itertools import groupby
from pathlib import PurePath
from typing import Annotated, Any

import numpy as np

from robacc.accuracy.estimation import TOO_LARGE
from robacc.api.accuracy import estimate
from robacc.api.inputs import STDIN, Inputs, path_of, with_measured_targets
from robacc.api.parameters import (
    ArmName,
    BaseLink,
    Cluster,
    Confidence,
    Database,
    Help,
    IgnoreLimits,
    Jobs,
    NeededRobot,
    OptionalRobot,
    Ordered,
    Poses,
    PosesSource,
    Progress,
    RobotSource,
    Seed,
    StrPath,
    TipLink,
    call,
)
from robacc.api.result import Result, fields_of
from robacc.comparison.comparing import PairedTargets, compare as compare_results, noise_doubts, paired_targets
from robacc.comparison.stored_results import FITS, ComparedResult, read_compared_result
from robacc.documents.envelope import (
    InputFile,
    Provenance,
    StoredResult,
    csv_text,
    read_gate,
    read_result,
    understood,
)
from robacc.documents.history import TEST, date_text
from robacc.errors import InputError, Problem, UsageError, applying, given, refuse
from robacc.gates import GateOutcome, evaluate_gate
from robacc.history import (
    COLUMNS,
    ArmFit,
    Entry,
    Spread,
    add,
    arm_fit,
    arm_of,
    counted,
    document_of,
    find_changes,
    fleet_of,
    joint_tolerances,
    level_of,
    opened,
    quick_test,
    rows_of,
    series_of,
    slope_of,
    tests,
    typical_robot,
)
from robacc.measurements import different, too_far
from robacc.plug_ins import plug_in
from robacc.prediction.model_uncertainty import model_fit
from robacc.render.text import Section
from robacc.render.views import history as views
from robacc.robots.arm import build_chain
from robacc.robots.description import Robot
from robacc.robots.yaml_robot import robot_to_yaml
from robacc.version import __version__
from robacc.workers import Workers


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Checked(Result, GateOutcome, command="check"):
    """Outcome of a gate, with the result that was checked."""

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
    made = Provenance({}, (stored.record, *records))
    return Checked(**fields_of(outcome), result=stored, warnings=outcome.warnings, made=made)


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


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Compared(Result, command="compare"):
    """Comparison of results, with the files that they were read from; its parts have the keys of the document."""

    results: tuple[ComparedResult, ...]
    baseline: str
    confidence: float
    pairing: Sequence[Mapping[str, Any]]
    statistics: Sequence[Mapping[str, Any]]
    ranking: Mapping[str, Any]
    grade: Mapping[str, Any] | None
    notes: tuple[str, ...]


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
    names = {_path(source): item.name for source, item in reversed([*zip(results, compared_results, strict=True)])}
    comparison = compare_results(
        compared_results,
        baseline=baseline if baseline is None else names.get(baseline, baseline),
        by=by,
        required_grade=grade,
        scale=inputs.scale(),
        confidence=confidence,
        seed=seed,
    )
    made = inputs.made(baseline=comparison["baseline"], by=comparison["ranking"]["by"])
    return Compared(**{**comparison, "warnings": (*comparison["warnings"], *doubts)}, made=made)


def _are_poses(source: Source) -> bool:
    """Return whether a source is a file of poses: a folder, or a file that is no JSON object."""
    if isinstance(source, Result | StoredResult) or not os.path.isfile(source):
        return not isinstance(source, Result | StoredResult) and os.path.isdir(source)
    with open(source, "rb") as file:
        # Bytes of a file in which its first sign is looked for.
        return not file.read(256).lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"{")


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
    own = source.name if isinstance(source, StoredResult) else source.command if isinstance(source, Result) else source
    return os.fspath(own)


# Call of ``robacc compare --paired``.


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class ComparedTargets(Result, PairedTargets, command="compare-paired"):
    """The same targets before and after a correction, with the inputs."""


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
    unwanted = (
        "neither file has wanted poses (cmd_ columns), so those of the nominal robot at the joints of `before` count; "
        "errors of base and tool frames are part of the figures"
    )
    has_none = first.commanded_position is None and second.commanded_position is None
    fit = None if arm is None else model_fit(arm)
    unloaded = "no sign that the correction was loaded: the targets are where they were before"
    warnings = (
        *(*first.warnings, *second.warnings, *[unwanted] * has_none),
        *(() if body.promise is None else noise_doubts(body.promise["noise"])),
        *(() if fit is None else fit.warnings),
        *[unloaded] * (body.loaded["verdict"] == "not_loaded"),
    )
    made = inputs.made("before", "after", "model", "nominal")
    return ComparedTargets(**fields_of(body), warnings=warnings, made=made)


# Calls of ``robacc history`` and its forms: a database of results, and what changed between them.


def _time(text: str | None) -> float | None:
    """Return a date as s since 1970; without a zone, it is UTC."""
    if text is None:
        return None
    try:
        date = datetime.fromisoformat(text)
        refuse((not 1970 < date.year < 3000, ""), error=ValueError)
    except ValueError:
        raise UsageError(f"`at`: expected a date such as 2026-05-31 or 2026-05-31T14:30, found {text!r}") from None
    return (date if date.tzinfo else date.replace(tzinfo=UTC)).timestamp()


def _own_date(path: str | None) -> float:
    """Return when a file was last changed, s since 1970; the present for a pipe and for what was no file."""
    return os.path.getmtime(path) if path and os.path.isfile(path) else time.time()


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class HistoryResult(Result):
    """Result from a database or over many arms."""

    def view(self) -> list[Section]:
        """Return what the command shows."""
        return views.VIEWS[self.command](self.payload())


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class HistoryAdded(HistoryResult, command="history-add"):
    """Results that were added to a database."""

    added: int
    known: int
    n_results: int
    arms: tuple[str, ...]


@call
def history_add(
    *results: Annotated[
        Source, Help("Results stored as JSON; - reads standard input.", "RESULT [RESULT …]", "Or results of calls.")
    ],
    db: Database,
    at: Annotated[
        str | None,
        Help(
            "Date of the tests, such as 2026-05-31 or 2026-05-31T14:30+02:00, UTC without a zone; default: that of "
            "each file's last change.",
            "DATE",
        ),
    ] = None,
    arm: Annotated[
        str | None, Help("Arm that was tested; default: serial number of the robot file, else its name.", "NAME")
    ] = None,
) -> HistoryAdded:
    """Add results to a database, which is made if there is none; a result that it has already changes nothing.

    Returns:
        ``added`` and ``known``, the numbers of new results and of those that the database had.

    Raises:
        InputError: A result cannot be read, or the database cannot be written; nothing is added then.
        UsageError: A result is of a command without figures to compare, or the date is none.

    Example:
        >>> import robacc, tempfile
        >>> result = robacc.estimate("sample_data/poses.csv", robot="sample_data/robot.yaml")
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     print(robacc.history_add(result, db=f"{folder}/arm.db", at="2026-05-31").added)
        1
    """
    refuse((not results, "name the results to add"))
    inputs, when, added = Inputs({"at": at, "arm": arm}), _time(at), 0
    with opened(os.fspath(db), writes=True) as base:
        for source in results:
            stored = stored_result(source)
            added += add(base, stored, _own_date(path_of(source)) if when is None else when, arm)
            inputs.records.append(stored.record)
        found = tests(base, None)
    return HistoryAdded(
        added=added,
        known=len(results) - added,
        n_results=len(found),
        arms=tuple(dict.fromkeys(test["arm"] for test in found)),
        made=inputs.made(),
    )


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class HistoryShown(HistoryResult, command="history-show"):
    """Results of a database."""

    results: Sequence[Mapping[str, Any]]
    db: str
    arm: str | None

    def table(self, path: StrPath) -> None:
        """Write every figure and coefficient, one a line, as a CSV or, by the ending of the name, as Parquet.

        Raises:
            InputError: The file cannot be written.
            UsageError: The name ends in .parquet, and pyarrow is not installed.
        """
        from robacc.io.files import write_file

        with opened(self.db) as base:
            columns = dict(zip(COLUMNS, zip(*rows_of(base, self.arm), strict=True), strict=False))
        columns["at"] = tuple(map(date_text, columns["at"]))
        if os.fspath(path).endswith(".parquet"):
            plug_in("robacc.readers", "parquet").write(path, columns)
            return
        texts = {name: ["" if cell is None else cell for cell in column] for name, column in columns.items()}
        write_file(path, csv_text(texts))


@call
def history_show(*, db: Database, arm: ArmName = None) -> HistoryShown:
    """Show the results of a database by arm and date.

    Returns:
        ``results`` with date, command, rms error and grade.

    Raises:
        InputError: The file is no database of results.
        UsageError: The database has no such arm.

    Example:
        >>> import robacc, tempfile
        >>> result = robacc.estimate("sample_data/poses.csv", robot="sample_data/robot.yaml")
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     added = robacc.history_add(result, db=f"{folder}/arm.db")
        ...     print(robacc.history_show(db=f"{folder}/arm.db").results[0]["command"])
        estimate
    """
    with opened(os.fspath(db)) as base:
        errors = {row[-1]: row[4] for row in rows_of(base, arm, "position.rms")}
        found = [{**test, "at": date_text(test["at"]), "rms_m": errors.get(test["id"])} for test in tests(base, arm)]
    results = [{key: test[key] for key in TEST.keys or ()} for test in found]
    return HistoryShown(results=results, db=os.fspath(db), arm=arm, made=Inputs({"arm": arm}).made())


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class HistoryTrend(HistoryResult, command="history-trend"):
    """One figure or coefficient over time."""

    key: str
    unit: str
    trends: Sequence[Mapping[str, Any]]


@call
def history_trend(
    key: Annotated[str, Help("Figure or coefficient, such as position.rms or joint_offset.j3.", "KEY")],
    *,
    db: Database,
    arm: ArmName = None,
) -> HistoryTrend:
    """Show one figure or coefficient over time, with its slope.

    Returns:
        ``trends``: the values of each arm, and the slope of a straight line with its 95 % interval.

    Raises:
        InputError: The file is no database of results.
        UsageError: No result has the key, or the database has no such arm.

    Example:
        >>> import robacc, tempfile
        >>> result = robacc.estimate("sample_data/poses.csv", robot="sample_data/robot.yaml")
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     added = robacc.history_add(result, db=f"{folder}/arm.db")
        ...     print(robacc.history_trend("position.rms", db=f"{folder}/arm.db").unit)
        m
    """
    with opened(os.fspath(db)) as base:
        tests(base, arm)
        rows = [row for row in rows_of(base, arm, key) if row[4] is not None]
        keys = "" if rows else ", ".join(dict.fromkeys(row[3] for row in rows_of(base, arm)))
    refuse((not rows, f"no result has the key {key!r}; the keys are {keys or 'none'}"))
    trends = []
    for name, group in groupby(rows, key=lambda row: row[0]):
        own = [(at, value, std) for _, at, _, _, value, std, *_ in group]
        known = np.array([row for row in own if row[2]], dtype=float).reshape(-1, 3)
        slope = slope_of(*known.T) if len(known) > 2 and np.ptp(known[:, 0]) > 0.0 else (None, None, None)
        values = [{"at": date_text(at), "value": value, "std": std} for at, value, std in own]
        trends.append(
            {"arm": name, "values": values, **dict(zip(("rate_per_year", "low", "high"), slope, strict=True))}
        )
    return HistoryTrend(key=key, unit=rows[0][6], trends=trends, made=Inputs({"key": key, "arm": arm}).made())


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class HistoryChanges(HistoryResult, command="history-changes"):
    """What changed in the tests of each arm."""

    arms: Sequence[Mapping[str, Any]]
    changes: Mapping[str, Sequence[Entry]]
    """Changes of each arm."""


@call
def history_changes(*, db: Database, arm: ArmName = None) -> HistoryChanges:
    """Say what changed between the tests of an arm, when, by how much, and whether by a step, a ramp or temperature.

    Coefficients come from results of calibrate and trace, the rms error from those of estimate. A coefficient of
    base_frame or tool_frame tells that the set-up changed, not the arm. A false alarm is expected once in a year.

    Returns:
        ``changes`` of each arm, the most certain first, with date, size and 95 % interval; ``arms`` with the detection
        limits of each.

    Raises:
        InputError: The file is no database of results.
        UsageError: The database has no such arm.

    Example:
        >>> import robacc, tempfile
        >>> result = robacc.estimate("sample_data/poses.csv", robot="sample_data/robot.yaml")
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     added = robacc.history_add(result, db=f"{folder}/arm.db")
        ...     print(robacc.history_changes(db=f"{folder}/arm.db").changes)
        {'sample arm': []}
    """
    with opened(os.fspath(db)) as base:
        arms, changed = [], {}
        groups = [(name, [*group]) for name, group in groupby(tests(base, arm), key=lambda test: test["arm"])]
        for name, own in groups:
            level = level_of(np.array([test["at"] for test in own]))
            used = counted(own)
            changed[name], limits, controls = find_changes(series_of(base, used), level)
            notes = [
                f"{len(used)} of them count: the others have another robot file, or other effects were fitted"
                * (len(used) < len(own)),
                "fewer than three tests: how much tests differ without a change is not known yet" * (len(used) < 3),
                "without a temperature in every test (column temperature_c), warmth may look like a change"
                * any(test["temperature_c"] is None for test in used),
            ]
            moved = {change["key"] for change in changed[name]}
            charts = [control for control in controls if control["key"] in moved or len(groups) == 1]
            entry = {"arm": name, "n_tests": len(own), "level": level, "detection_limits": limits, "series": charts}
            arms.append({**entry, "notes": [*filter(None, notes)]})
    return HistoryChanges(arms=arms, changes=changed, made=Inputs({"arm": arm}).made())


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Health(HistoryResult, command="health"):
    """Quick test of an arm."""

    arm: str
    n_poses: int
    rms: float
    level: float
    changes: tuple[Entry, ...]
    detection_limits: Sequence[Entry]
    hidden: tuple[str, ...]


@call
def health(
    poses: Poses,
    *,
    db: Database,
    robot: NeededRobot,
    arm: Annotated[
        str | None, Help("Arm of the database; default: serial number or name of the robot file.", "NAME")
    ] = None,
    at: Annotated[
        str | None, Help("Date of the test, UTC without a zone; default: that of the file's last change.", "DATE")
    ] = None,
    ordered: Ordered = False,
    ignore_limits: IgnoreLimits = False,
    base_link: BaseLink = None,
    tip_link: TipLink = None,
) -> Health:
    """Say from a few poses whether a coefficient of an arm moved since its last full test, and which.

    The robot is the model that calibrate or trace wrote at the last full test. Base and target may be set up anew. The
    poses may be positions, sockets, planes, distances or images. The database tells how much the arm's tests differ
    without a change, and how often they are made.

    Returns:
        ``changes``: the coefficients that moved, with size and 95 % interval; ``detection_limits`` of the others.

    Raises:
        InputError: A file cannot be used, or the poses are too few.
        UsageError: The robot has no fit, or the database no such arm.

    Example:
        >>> import robacc, tempfile
        >>> poses, robot = "sample_data/poses.csv", "sample_data/robot.yaml"
        >>> result = robacc.calibrate(poses, robot=robot, fit="base_frame,tool_frame,joint_offset,link_geometry")
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     added = robacc.history_add(result, db=f"{folder}/arm.db")
        ...     result.write_model(f"{folder}/model.yaml")
        ...     print(robacc.health(poses, robot=f"{folder}/model.yaml", db=f"{folder}/arm.db").changes)
        ()
    """
    inputs = Inputs(locals(), "poses")
    model = inputs.robot(robot, poses)
    record = given(
        model_fit(model),
        f"{path_of(robot) or model.name} has no fit; give the model that calibrate or trace wrote with `write_model`",
    )
    model, data = with_measured_targets(model, inputs.poses(poses, model, any_kind=True))
    q = given(data.q, "the poses have no joint columns, which the model needs")
    own_name = arm or model.identity.get("serial_number") or model.name
    with opened(os.fspath(db)) as base:
        own = counted(tests(base, own_name))
        series = [one for one in series_of(base, own) if not one.is_of_setup]
        last = [test for test in own if test["command"] in FITS][-1:]
        digests = {entry["sha256"] for test in last for entry in document_of(base, test)["inputs"]}
    doubt = f"the model was not fitted to the poses of the last test of {own_name}; changes count from its own test"
    level, path = level_of(np.array([test["at"] for test in own])), path_of(poses)
    when = _time(at) or max(_own_date(path), own[-1]["at"])
    refuse(
        (when < own[-1]["at"], f"the quick test is older than the last test of {own_name}; state its date with `at`")
    )
    factor = Spread.of(series).factor
    changed, limits, hidden, rms = quick_test(model, record, data, level, factor, (own[-1]["at"], when))
    doubts = applying(
        (not digests & {*model.fitted_to}, doubt),
        (
            too_far(rms, build_chain(model).forward(q).translation),
            f"{TOO_LARGE}; the changes named say nothing of the arm until the cause is found",
        ),
    )
    return Health(
        arm=own_name,
        n_poses=different(data.groups()),
        level=level,
        changes=changed,
        detection_limits=limits,
        hidden=hidden,
        rms=rms,
        warnings=(*data.warnings, *inputs.warnings, *doubts),
        made=inputs.made("db", poses=path, robot=path_of(robot)),
    )


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Fleet(HistoryResult, command="fleet"):
    """Coefficients over the arms of a fleet."""

    n_arms: int
    coefficients: Sequence[Entry]
    strangers: Sequence[Entry]
    covariance: Entry
    notes: tuple[str, ...]
    robot: Robot | None

    def tolerances_yaml(self) -> str:
        """Return the standard deviations between arms as a tolerance file of ``predict``."""
        import yaml

        turns = any(one["key"].endswith((".roll", ".pitch", ".yaw")) for one in self.coefficients)
        is_urdf = turns if self.robot is None else self.robot.convention == "urdf"
        head = f"# Standard deviations between {self.n_arms} arms, written by robacc {__version__} fleet.\n"
        content = {"units": {"length": "m", "angle": "rad"}, "joints": joint_tolerances(self.coefficients, is_urdf)}
        return head + yaml.safe_dump(content, sort_keys=False)

    def robot_yaml(self) -> str:
        """Return the typical arm as a robot file: the nominal robot with the fleet's means and tolerances.

        Raises:
            UsageError: The call had no ``robot``.
        """
        robot = given(self.robot, "the typical arm needs `robot`, the nominal robot of the fleet")
        text = f"Typical arm of a fleet of {self.n_arms}, written by robacc {__version__}."
        return robot_to_yaml(typical_robot(robot, self.coefficients), [text])


def _fit_of_arm(source: StrPath | StoredResult) -> tuple[InputFile, ArmFit]:
    """Return the record of a result, and the fit of its arm.

    Raises:
        InputError: The result cannot be read.
        UsageError: It is not one of calibrate or trace.
    """
    stored = stored_result(source)
    other = f"{stored.name} is a result of {stored.command}; a fleet needs calibrate or trace"
    refuse((stored.command not in FITS, other))
    with understood(stored.name, stored.command):
        return stored.record, arm_fit(stored.document, arm_of(stored.document))


@call
def fleet(
    *results: Annotated[
        Source,
        Help("Results of calibrate or trace, one an arm; or `db`.", "[RESULT …]", "Or results of calls."),
    ],
    db: Annotated[
        StrPath | None, Help("Database of results, in place of files: the latest fit of each arm counts.", "FILE")
    ] = None,
    robot: OptionalRobot = None,
    base_link: BaseLink = None,
    tip_link: TipLink = None,
    jobs: Jobs = None,
    cluster: Cluster = None,
    progress: Progress = None,
) -> Fleet:
    """Compute mean and standard deviation of each coefficient over many arms, and name the arms unlike the others.

    The standard deviations are tolerances as built: the noise of each arm's fit is taken off.

    Returns:
        ``coefficients`` with 95 % intervals, ``strangers``, the arms out of family, and the ``covariance``.

    Raises:
        InputError: A result or the database cannot be read.
        UsageError: There are fewer than two arms, or a result is not one of calibrate or trace.

    Example:
        >>> import robacc
        >>> poses, robot = "sample_data/poses.csv", "sample_data/robot.yaml"
        >>> fits = [robacc.calibrate(poses, robot=robot, folds=folds) for folds in (2, 3)]
        >>> robacc.fleet(*fits).coefficients[0]["key"]
        'joint_offset.j2'
    """
    refuse((bool(results) == (db is not None), "name the results of the arms, or `db`"))
    inputs = Inputs({"base_link": base_link, "tip_link": tip_link})
    # A result just computed becomes what its file would be, which another process can be given.
    sources = [stored_result(source) if isinstance(source, Result) else source for source in results]
    if db is not None:
        with opened(os.fspath(db)) as base:
            latest = {test["arm"]: test for test in tests(base, None) if test["command"] in FITS}
            sources = [StoredResult(document_of(base, test), test["command"], "", arm) for arm, test in latest.items()]
    shown = partial(progress or (lambda label, done, total: None), "reading results")
    fits = [*Workers(jobs, cluster).in_order(_fit_of_arm, sources, shown)]
    inputs.records += [record for record, _ in fits if db is None]
    is_twice = len({record.sha256 for record in inputs.records}) < len(results)
    refuse(
        (len(fits) < 2, f"a fleet needs at least two arms, found {len(fits)}"),
        (is_twice, "a result is named twice; name one of each arm"),
    )
    arms: dict[str, ArmFit] = {}
    for number, (record, arm) in enumerate(fits, 1):
        name = arm.arm if db is None else record.name
        arms[name if name not in arms else f"{name} ({number})"] = arm
    usual = Counter(arm.dropped for arm in arms.values()).most_common(1)[0][0]
    comparable = [arm._replace(arm=name) for name, arm in arms.items() if arm.dropped == usual]
    coefficients, strangers, covariance = fleet_of(comparable)
    models, shrunk = {arm.robot for arm in arms.values()}, sum(arm.is_shrunk for arm in arms.values())
    repeated = len(arms) - len({arm.measured or name for name, arm in arms.items()})
    notes = (
        f"{shrunk} fits may be shrunk to nominal, which makes arms look alike; calibrate with `shrink=False`"
        * bool(shrunk),
        f"fits left out: {len(arms) - len(comparable)}; their poses identify other coefficients than those of most "
        "arms, so that one name means different things; measure all arms at the same poses"
        * (len(comparable) < len(arms)),
        f"the results are of {', '.join(sorted(models))}: are they one model of arm?" * (len(models) > 1),
        f"results of the same measured poses as another: {repeated}; an arm that counts twice makes the tolerances too "
        "narrow; give one result of each arm" * bool(repeated),
    )
    return Fleet(
        n_arms=len(arms),
        coefficients=coefficients,
        strangers=strangers,
        covariance=covariance,
        notes=tuple(filter(None, notes)),
        robot=None if robot is None else inputs.robot(robot),
        made=inputs.made(),
    )
