"""Inputs of calls: files by their paths, objects read before, or arrays, with the record of each."""

from __future__ import annotations

import itertools
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from hashlib import sha256
from typing import Annotated, Any, TypeVar

import numpy as np

from robacc.accuracy.grade import Scale, load_scale
from robacc.api.parameters import (
    Angles,
    Bag,
    BoardFile,
    CameraFile,
    Columns,
    Commanded,
    ContactSheet,
    Coverage,
    Help,
    IgnoreLimits,
    Ordered,
    PosesSource,
    RobotSource,
    Sheet,
    SkipGaps,
    StrPath,
    Units,
    call,
)
from robacc.diagnostics.robot_poses import check_size, nominal_poses, read_robot_poses, read_rows
from robacc.documents.envelope import InputFile, Provenance
from robacc.effects.specification import with_effect_units
from robacc.errors import LISTED, InputError, Note, Problem, UsageError, refuse
from robacc.geometry import Array, NDArray
from robacc.io.column_table import open_table
from robacc.io.files import read_text, sha256_of, write_file
from robacc.measurements import Measurements, commanded_groups, motion_between_visits, numbered_visits
from robacc.modelling.robot_file import read_robot, robot_path
from robacc.modelling.validity import OutsideValidity, outside_validity, resolve_campaign
from robacc.poses import csv_file
from robacc.poses.cameras import PHOTO, seen_from_board
from robacc.poses.checks import degrees_likely, doubtful_sigma, lengths_too_large
from robacc.poses.reading import (
    READING,
    TEXTS,
    UNKNOWN_ROBOT,
    KnownRobot,
    PoseFile,
    Reading,
    SupportsColumns,
    parts_of,
    reading_of,
)
from robacc.poses.reshaped_tables import unit_and_error
from robacc.robots.description import Fixture, Frame, Robot
from robacc.robots.yaml_robot import robot_to_yaml

Read = TypeVar("Read")
STDIN = "-"
RECORDED_APART = frozenset(
    ("poses", "robot", "scale", "tolerances", "against", "results", "seed", "jobs", "cluster", "progress", *READING)
)
"""Parameters that are not among the options: files and how they are read stand among the inputs, the seed has a key of
its own, and who did the work changes nothing."""


def path_of(source: object) -> str | None:
    """Return ``source`` as text if it is a path, else None."""
    return os.fspath(source) if isinstance(source, str | os.PathLike) else None


class Inputs:
    """Arguments of a call, what it reads as they say, and the record of each file or object."""

    def __init__(self, arguments: Mapping[str, Any], *first: str) -> None:
        """Take the arguments by name, in their order, and the kinds of files that are recorded first."""
        self.arguments, self.first = dict(arguments), first
        self.links = self.arguments.get("base_link"), self.arguments.get("tip_link")
        self.records: list[InputFile] = []
        self.outside: OutsideValidity | None = None
        """Poses outside the validity ranges of the model; None without a model."""
        self.warnings: list[str] = []
        """Warnings about the use of the model on the poses."""

    def text(self, path: StrPath, kind: str, parse: Callable[[str, str], Read]) -> Read:
        """Return what ``parse`` makes of the text and the name of a file.

        Raises:
            InputError: The file cannot be read or is wrong.
        """
        name = os.fspath(path)
        read = parse(read_text(name), name)
        self.records.append(InputFile.at(name, sha256_of(name), kind))
        return read

    def scale(self) -> Scale | None:
        """Return the grade scale of the argument; None without one, for the package's own scale."""
        path = self.arguments["scale"]
        return None if path is None else self.text(path, "scale", load_scale)

    def robot(self, source: RobotSource, poses: PosesSource | None = None, kind: str = "robot") -> Robot:
        """Return a robot; one without a file is recorded as the robot file it would make.

        The links of the arguments are those of the ``robot``. The joint columns of ``poses``, a path or poses read
        before, choose the chain of a URDF without a ``tip_link``.

        Raises:
            InputError: The file cannot be read or is wrong.
            UsageError: A link does not exist, or is given with a robot that was read before.
        """
        base_link, tip_link = self.links if kind == "robot" else (None, None)
        if isinstance(source, Robot):
            refuse(
                (
                    base_link is not None or tip_link is not None,
                    "`base_link` and `tip_link` apply when a URDF is read; this robot has been read already",
                )
            )
            digest = sha256(robot_to_yaml(with_effect_units(source)).encode()).hexdigest()
            self.records.append(InputFile(source.name, digest, kind, identity=source.identity))
            return source
        robot = read_robot(source, base_link=base_link, tip_link=tip_link, joint_columns=lambda: _column_names(poses))
        self.records.append(InputFile.at(os.fspath(source), sha256_of(robot_path(source)), kind, robot.identity))
        return robot

    def optional_robot(self, poses: PosesSource | None = None) -> Robot | None:
        """Return :meth:`robot` of the argument; None without one.

        Raises:
            InputError: The file cannot be read or is wrong.
            UsageError: A link does not exist, or is given without a robot.
        """
        source = self.arguments["robot"]
        refuse(
            (
                source is None and any(self.links),
                "`base_link` and `tip_link` choose a chain of a URDF, so they need `robot`",
            )
        )
        return None if source is None else self.robot(source, poses)

    def stated(self, source: PosesSource) -> PosesSource:
        """Return poses whose file is read with the statements of the arguments, which are those of a ``PoseFile``.

        Raises:
            UsageError: Poses read before have statements.
        """
        reading = {name: self.arguments[name] for name in READING if self.arguments[name]}
        texts = (f"`{name}` applies when a file is read; use it in read_poses" for name in reading)
        if isinstance(source, Measurements):
            refuse(*((True, text) for text in texts))
        return PoseFile(source, **reading) if reading and not isinstance(source, Measurements) else source

    def poses(
        self,
        source: PosesSource,
        robot: Robot | None,
        *,
        ordered: bool | None = None,
        kind: str = "poses",
        attained: bool = True,
        any_target: bool = False,
        any_kind: bool = False,
        visited_by: KnownRobot | None = None,
    ) -> Measurements:
        """Return poses, checked against ``robot`` if there is one.

        Args:
            source: Path, ``-`` for standard input, a data frame, or poses that were read or made before.
            robot: Robot whose joints, limits and targets apply to the poses.
            ordered: The rows of the file are in the order measured; poses read before carry this themselves. None is
                the argument.
            kind: Kind of the input in the record.
            attained: The poses were measured; planned poses may lack x, y, z.
            any_target: Several targets are valid although the robot has one tool.
            any_kind: Other kinds of measurement than positions and poses are valid.
            visited_by: Names and limits that apply to poses to visit, which name no target: all are visited at each
                pose.

        Raises:
            InputError: The file or the arrays are wrong; with every problem.
            UsageError: The rows are ordered, and the poses were read before without their order.
        """
        ordered = self.arguments.get("ordered", False) if ordered is None else ordered
        limits = {"ignore_limits": self.arguments.get("ignore_limits", False)}
        if isinstance(source, Measurements):
            refuse(
                (
                    ordered and not source.ordered,
                    "`ordered` applies when a file is read; use read_poses(path, ordered=True)",
                )
            )
            data = checked_poses(source, robot)
            if robot is not None and visited_by is None and (robot.targets or not any_target):
                check_targets(data, robot)
            name, digest = "arrays", data.sha256
            if digest is not None:
                name = STDIN if data.source in (None, "<stdin>") else str(data.source)
            record = InputFile.at(name, digest or sha256(csv_file.format_poses(data).encode()).hexdigest(), kind)
        else:
            path, reading, options = pose_path(source), dict[str, Any](), dict[str, Any]()
            commands = path.reading.commanded if attained and isinstance(path, PoseFile) else None
            try:
                if commands is not None:
                    data, reading = _with_commands(path, commands, robot, ordered, **limits)
                elif visited_by is not None:
                    # Candidates may be places without joints.
                    options = {**limits, "commands": kind != "candidates", "planned_kinds": any_kind}
                    data = csv_file.read_poses(path, robot=visited_by, attained=False, **options)
                else:
                    options = {**limits, "attained": attained, "any_target": any_target, "planned_kinds": any_kind}
                    data = read_rows(path, robot, ordered=ordered, **options)
            except InputError:
                from robacc.programs.program import mistaken_for_poses

                if attained and commands is None and (problem := mistaken_for_poses(path)) is not None:
                    raise InputError(problem) from None
                raise
            record = InputFile.at(path, data.sha256 or "", kind)
            record = record._replace(reading={**(record.reading or {}), **reading} or None)
        if data.seen is not None and (any_kind or data.photos is not None):
            counted = (
                "three points of the board, whose six numbers are its pose"
                if any_kind
                else "one pose; calibrate and trace, where they read the photos, fit their points, which tells more"
            )
            data = replace(data, warnings=(*data.warnings, Note(f"{data.source}: each photo counts as {counted}")))
        is_of_photos = data.is_of_images
        if is_of_photos and not any_kind:
            data = replace(data.each_photo() or data, warnings=data.warnings)
        kinds = () if data.kind is None or is_of_photos else dict.fromkeys(map(str, data.kind))
        message = f"the rows are of kind {' and '.join(kinds)}, which are no positions"
        fix = "use calibrate or trace, which fit where sockets, planes and anchors are"
        below = "each row is incomplete or not measured" if data.gaps else "one row is needed at least below the header"
        none = Problem(f"there are no poses; {below}", data.source)
        refuse((kinds and not any_kind, Problem(message, data.source, fix=fix)), (not data.n, none))
        self.records.append(record)
        return data

    def measured(
        self, source: PosesSource, robot: Robot | None, *, any_target: bool, any_kind: bool = False
    ) -> tuple[Measurements, tuple[Callable[[], Measurements], ...]]:
        """Return :meth:`poses`, of a large file some, evenly spread, with functions that read its parts.

        A rule that looks at all rows at once, such as the order of visits, needs the whole file; there are no parts
        then.

        Raises:
            InputError: The file or the arrays are wrong; with every problem.
            UsageError: As :meth:`poses`.
        """
        if self.arguments["ordered"] or self.arguments["strict_range"] or not isinstance(source, str | os.PathLike):
            return self.poses(source, robot, any_target=any_target, any_kind=any_kind), ()
        sample, *parts = parts_of(pose_path(source)) or (source,)
        data = self.poses(sample, robot, any_target=any_target, any_kind=any_kind)
        limits = self.arguments["ignore_limits"]
        read = partial(read_rows, robot=robot, any_target=any_target, ignore_limits=limits)
        return data, tuple(partial(read, part) for part in parts)

    def campaign(
        self,
        robot: Robot,
        data: Measurements | None = None,
        *,
        measured: bool = True,
        digests: Sequence[str] | None = None,
    ) -> Robot:
        """Return the robot as it applies to ``data``, and note its warnings and the poses outside its ranges.

        The arguments ``campaign`` and ``strict_range`` hold. ``auto`` keeps the effects of the campaign that the model
        was fitted in for its own poses, and for measured poses that agree better with them than without.

        Args:
            robot: Robot as read.
            data: The poses; None if there are none, as for configurations over the joint ranges.
            measured: The positions of ``data`` were measured.
            digests: Digests of the files of the poses; by default that of the file read last.

        Raises:
            InputError: ``strict_range``, and a pose is outside.
        """
        digests = [self.records[-1].sha256] if digests is None else digests
        robot, notes = resolve_campaign(robot, data if measured else None, digests, self.arguments["campaign"])
        outside = (None if data is None else outside_validity(robot, data)) or OutsideValidity(0, 0, (), 0.0)
        if data is not None and self.arguments["strict_range"]:
            outside.refuse(data)
        self.outside = self.outside or outside
        self.warnings += (*notes, *outside.warnings())
        return robot

    def made(self, *files: str, **resolved: object) -> Provenance:
        """Return the options, inputs and seed of the result.

        Args:
            files: Further parameters that are not among the options.
            resolved: Values that replace arguments as given; a parameter named here is recorded in any case.
        """
        apart = RECORDED_APART.union(files) - resolved.keys()
        options = {name: value for name, value in {**self.arguments, **resolved}.items() if name not in apart}
        inputs = tuple(sorted(self.records, key=lambda record: record.kind not in self.first))
        return Provenance(options, inputs, self.arguments.get("seed"), self.outside, tuple(self.warnings))


def _column_names(poses: PosesSource | None) -> Sequence[str]:
    """Return the names of a pose file's columns, or q1 … qN of poses read before; nothing for a pipe or a bad file."""
    if poses is None or isinstance(poses, Measurements):
        return [f"q{i + 1}" for i in range(0 if poses is None or poses.q is None else poses.q.shape[0])]
    path = pose_path(poses)
    if not (os.path.isfile(path) or os.path.isdir(path) or reading_of(path).frame is not None):
        return []
    # The reader of the poses reports what is wrong with the file.
    with suppress(InputError, UsageError), open_table(path, reading_of(path)) as table:
        return table.names
    return []


def pose_path(source: StrPath | SupportsColumns | Mapping[str, Any]) -> str:
    """Return the path of a pose file, or of a data frame a path that carries it."""
    return os.fspath(source) if isinstance(source, str | os.PathLike) else PoseFile(source)


def fitted_pose_warnings(robot: Robot | None, inputs: Sequence[InputFile]) -> tuple[str, ...]:
    """Return a warning for each file of ``inputs`` whose poses the robot was fitted to."""
    digests = () if robot is None else robot.fitted_to
    return tuple(
        f"{record.name}: the robot file was fitted to these same poses, so the errors show how well the model fits "
        "them; measure other poses to show how accurate the model is"
        for record in inputs
        if record.sha256 in digests
    )


# Calls that read and write robots, poses and results.


@call
def read_poses(
    path: Annotated[
        StrPath | SupportsColumns | Mapping[str, Any],
        Help(
            "File to read, ``-`` for standard input, or a data frame: pandas, Polars, Arrow, or arrays by the names of "
            "columns."
        ),
    ],
    *,
    robot: Annotated[
        StrPath | Robot | None,
        Help("Robot or its file; its joints, limits and targets apply to the columns. None for no robot."),
    ] = None,
    ordered: Ordered = False,
    ignore_limits: IgnoreLimits = False,
    angles: Angles = None,
    units: Units = None,
    columns: Columns = None,
    skip_gaps: SkipGaps = False,
    coverage: Coverage = None,
    sheet: Sheet = None,
    commanded: Commanded = None,
    camera: CameraFile = None,
    board: BoardFile = None,
    bag: Bag = None,
    contact_sheet: ContactSheet = None,
) -> Measurements:
    """Read and check the measured poses of a file or a data frame.

    Returns:
        Arrays in SI units, components first and poses last: ``position`` is ``(3, N)``, ``q`` is ``(J, N)``.

    Raises:
        InputError: The file is wrong; with every problem, its line and column.

    Example:
        >>> import robacc
        >>> data = robacc.read_poses("sample_data/poses.csv", robot="sample_data/robot.yaml")
        >>> data.n, data.position.shape
        (60, (3, 60))
    """
    inputs = Inputs(locals())
    poses = inputs.stated(path)
    return inputs.poses(poses, inputs.optional_robot(poses))


def write_poses(path: StrPath, data: Measurements) -> None:
    """Write poses to a CSV file that :func:`read_poses` reads back to the same numbers.

    Raises:
        InputError: An array is wrong, or the file cannot be written.
    """
    write_file(path, csv_file.pose_pieces(checked_poses(data, check_units=False)))


def write_robot(path: StrPath, robot: Robot) -> None:
    """Write a robot to a robot file (YAML, m and rad) that :func:`read_robot` reads back to the same numbers.

    Raises:
        InputError: The robot's effects cannot be read, or the file cannot be written.
    """
    write_file(path, robot_to_yaml(with_effect_units(robot)))


# Checks of poses that were made of arrays, as the reader of pose files checks columns, and of their targets.

_LEADING_AXES: dict[str, tuple[int, ...]] = {
    "position": (3,),
    "rotation": (3, 3),
    "commanded_position": (3,),
    "commanded_rotation": (3, 3),
    "sigma_position": (3,),
    "noise_covariance": (3, 3),
    **dict.fromkeys(("sigma_rotation", "time", "temperature", "payload"), ()),
}
"""Lengths of all axes but the last, which is over poses, for each field of numbers."""
_JOINT_FIELDS = ("q", "direction", "speed", "read_back", "branches")


def checked_poses(data: Measurements, robot: Robot | None = None, *, check_units: bool = True) -> Measurements:
    """Return poses made of arrays or lists with every field as a float array of the right shape; ids become text.

    Args:
        data: The arrays.
        robot: Robot whose joints they are.
        check_units: Raise an error for values that cannot be in m and rad.

    Raises:
        InputError: An array has the wrong shape or a value that is not finite, a matrix is not a rotation, or the
            number of joints is not the robot's; with every problem.
    """
    columns = {name: getattr(data, name) for name in (*_LEADING_AXES, *_JOINT_FIELDS, *TEXTS)}
    arrays = {name: np.asarray(column) for name, column in columns.items() if column is not None}
    # A units check of columns of a file was made with the units that the file states.
    units = _wrong_units(arrays, robot) if check_units and data.source is None else ()
    found = [*_wrong_arrays(arrays, robot)] or [*units]
    refuse((found, [Problem(text, data.source, column=name, fix=fix) for name, text, fix in found]))
    fields: dict[str, Any] = {
        name: array.astype(str if name in TEXTS else float, copy=False) for name, array in arrays.items()
    }
    if "noise_covariance" in fields:
        fields["sigma_position"] = np.sqrt(np.einsum("iin->in", fields["noise_covariance"]))
    return replace(data, **fields)


def _wrong_arrays(arrays: Mapping[str, NDArray[Any]], robot: Robot | None) -> Iterator[tuple[str, str, str | None]]:
    """Yield what is wrong with the shapes and the values of arrays: a field, what is wrong with it, and the advice."""
    position = arrays["position"]
    is_transposed = position.ndim == 2 and position.shape[1] == 3 != position.shape[0]
    n = position.shape[0 if is_transposed else -1] if position.ndim else 0
    for name, array in arrays.items():
        leading = _LEADING_AXES.get(name, ())
        if name in _JOINT_FIELDS and robot is not None:
            leading = (len(robot.branch_variables if name == "branches" else robot.variables),)
        elif name in _JOINT_FIELDS:
            leading = array.shape[:1] if array.ndim == 2 else (1,)
        if array.shape != (*leading, n):
            transposed = f"{name}.T" if array.ndim == 2 else f"numpy.moveaxis({name}, 0, -1)"
            fix = f"components come first and poses last, so give {transposed}"
            text = f"expected an array of shape ({', '.join(map(str, (*leading, n)))}), found {array.shape}"
            yield name, text, fix if array.ndim > 1 and array.shape == (n, *leading) else None
        elif name in TEXTS:
            continue
        elif array.dtype.kind not in "fiu":
            yield name, f"expected numbers, found {array.dtype}", None
        elif not (finite := np.isfinite(array)).all():
            pose = int(np.argmin(finite.reshape(-1, n).all(axis=0)))
            yield name, f"pose {pose + 1} has a value that is not finite", None
        elif name.endswith("rotation") and array.ndim == 3:
            deviation = np.abs(np.einsum("kin,kjn->ijn", array, array) - np.eye(3)[..., None]).max(axis=(0, 1))
            # Largest deviation of ``R @ R.T`` from the identity; files allow quaternions the same deviation from unit
            # length.
            invalid = (deviation > 1e-3) | (np.linalg.det(np.moveaxis(array, -1, 0)) < 0)
            if np.any(invalid):
                yield name, f"pose {int(np.argmax(invalid)) + 1} is not a rotation matrix", None
        elif name == "noise_covariance" and not (
            np.allclose(array, array.swapaxes(0, 1), atol=1e-9 * float(np.abs(array).max()))
            and np.linalg.eigvalsh(array.T).min() > 0
        ):
            yield name, "expected symmetric, positive definite matrices", None
        elif name.startswith("sigma") and np.any(array <= 0):
            yield name, "expected standard deviations above 0", None


def _wrong_units(arrays: Mapping[str, NDArray[Any]], robot: Robot | None) -> Iterator[tuple[str, str, str | None]]:
    """Yield each array that is in mm or degrees, as far as its values show it."""
    if not arrays["position"].size:
        return
    for name in ("position", "commanded_position"):
        if name in arrays and lengths_too_large(arrays[name]):
            largest = f"{np.max(np.abs(arrays[name])):.4g}"
            yield name, f"found positions up to {largest}, which cannot be m", "give metres"
    joints = () if robot is None else robot.variables
    if any(
        joint.type == "revolute" and degrees_likely(q, joint.limits)
        for joint, q in zip(joints, arrays.get("q", ()), strict=False)
    ):
        text = f"found joint angles up to {np.max(np.abs(arrays['q'])):.4g}, which cannot be rad"
        yield "q", text, "give radians: numpy.radians(q)"
    for name, kind, unit in (("sigma_position", "length", "m"), ("sigma_rotation", "angle", "rad")):
        if name in arrays and doubtful_sigma(arrays[name], kind)[0]:
            typical = f"{np.median(arrays[name]):.3g} {unit}"
            yield name, f"found a typical uncertainty of {typical}, which no instrument has", None


def check_targets(data: Measurements, robot: Robot) -> None:
    """Raise InputError unless every target is the robot's; a robot with one tool has one target."""
    names = [] if data.target is None or data.q is None else np.unique(data.target).tolist()
    unknown = [name for name in names if name not in robot.targets]
    expected = f"expected a target of the robot ({', '.join(robot.targets)})"
    several = f"found several targets ({', '.join(names)}), but the robot has one tool"
    fix = (
        "fit tool_frame, which finds their places, list them under targets: in the robot file instead of tool, or "
        "keep the rows of one target"
    )
    refuse(
        *((robot.targets, Problem(f"found {name!r}, {expected}", data.source, column="target")) for name in unknown),
        (not robot.targets and len(names) > 1, Problem(several, data.source, column="target", fix=fix)),
    )


def with_measured_targets(robot: Robot, data: Measurements) -> tuple[Robot, Measurements]:
    """Return the robot with the fixtures that the poses are measured from, and their targets if it has none; the poses.

    Several targets start at the tool each, and the poses carry a warning.
    """
    if data.fixture is not None and data.kind is not None:
        named = dict(zip(data.fixture.tolist(), data.kind.tolist(), strict=True))
        named |= {"": "position"} if (data.kind == "position").any() else {}
        fixtures = {name: Fixture(kind) for name, kind in named.items() if name or kind == "position"}
        robot = replace(robot, fixtures=fixtures)
    names = [] if robot.targets or data.target is None else list(dict.fromkeys(data.target.tolist()))
    if len(names) < 2:
        return robot, data
    text = (
        f"targets {', '.join(names)} are not in the robot file: each starts at its tool, and tool_frame fits its place"
    )
    warned = replace(data, warnings=(*data.warnings, text))
    return replace(robot, tool=Frame(), targets=dict.fromkeys(names, robot.tool)), warned


# Commands of measured poses from another file: a robot program, or a table of joints or commanded poses.

_DAY = 86400.0


def _with_commands(
    path: str, commands: str, robot: Robot | None, ordered: bool, ignore_limits: bool
) -> tuple[Measurements, dict[str, Any]]:
    """Return measured poses with the commands of another file, and the record of that file as statements.

    Rows are joined by the names of their poses; without names in one of the files, by their order. Open units and
    angles of the commands are those under which the measured positions follow them, if no others do.

    Raises:
        InputError: A file is wrong, has no commands, or does not fit the other.
    """
    reading = reading_of(path)
    try:
        return _read_with_commands(path, commands, robot, reading, ordered, ignore_limits)
    except InputError as error:
        readings = {}
        stated = itertools.product(
            (robot,) if robot is None else (robot, None),
            (None, "rotvec", "fixed-xyz", "moving-xyz", "kuka-abc", "wxyz", "xyzw")
            if reading.angles is None
            else (reading.angles,),
        )
        for arm, angles in stated if any(problem.file == commands for problem in error.problems) else ():
            for units in ("mm,deg", "mm,rad", "m,deg", "m,rad") if reading.units is None else (reading.units,):
                trial = replace(reading, units=units, angles=angles)
                try:
                    data, record = _read_with_commands(path, commands, arm, trial, ordered, ignore_limits)
                    poses = nominal_poses(data, arm)
                except InputError as wrong:
                    if wrong.problems == error.problems:
                        break  # what is wrong has to do with no unit
                    continue
                unit, remaining = unit_and_error(data.position, *poses)
                if unit == "m":
                    taken = f"poses in {units}, {angles}" if data.q is None else f"joints taken as {units[-3:]}"
                    readings[str(poses)] = remaining, data, record, taken
        ranked = sorted(readings.values(), key=lambda reading: reading[0])
        # One reading must follow the positions much better than the others, also where these are exact.
        if not ranked or any(remaining < 4.0 * ranked[0][0] + 1e-6 for remaining, *_ in ranked[1:]):
            raise
        _, data, record, taken = ranked[0]
        note = Note(f"{commands}: {taken}: no other reading agrees as well with the measured positions")
        return replace(data, warnings=(*data.warnings, note)), record


def _read_with_commands(
    path: str, commands: str, robot: Robot | None, reading: Reading, ordered: bool, ignore_limits: bool
) -> tuple[Measurements, dict[str, Any]]:
    """Return measured poses with commands, whose open units and angles are as stated, and the record of these."""
    from robacc.programs.program import LISTINGS, is_program

    entries = reading.columns or {}
    own_names, their_names = ({*_column_names(each)} if entries else set() for each in (path, commands))
    theirs = {name: entry for name, entry in entries.items() if name in their_names}
    others = {name: entry for name, entry in entries.items() if name in own_names or name not in their_names}
    path = PoseFile.of(path, replace(reading_of(path), columns=others or None))
    if is_program(commands) and not commands.lower().endswith(LISTINGS):
        planned = _program(commands)
    else:
        planned = _table(commands, replace(reading, columns=theirs or None), robot, ignore_limits)

    def known_poses(rows: Measurements) -> tuple[Array | None, Array | None]:
        given, found, _ = _joined(rows, planned, commands, path)
        position, rotation = (
            None if part is None else np.where(found, part, np.nan) for part in nominal_poses(given, robot)
        )
        return position, rotation

    known = UNKNOWN_ROBOT if robot is None else KnownRobot(target_names=tuple(robot.targets))
    measured = csv_file.read_poses(path, robot=known, commands=False, known_poses=known_poses)
    if reading.units and lengths_too_large(measured.position):  # the stated unit is that of the commands
        of_commands = PoseFile.of(path, replace(reading_of(path), units=None))
        measured = csv_file.read_poses(of_commands, robot=known, commands=False, known_poses=known_poses)
    own, fix = "the measured poses have commands of their own", "leave out `commanded`, or those columns"
    has_own = measured.q is not None or (measured.commands is not None and planned.q is None)
    refuse((has_own, Problem(own, measured.source, fix=fix)))
    if robot is not None:
        check_targets(measured, robot)
    given, found, remarks = _joined(measured, planned, commands, measured.source)
    given = given.subset(found)
    names = ("q", "commanded_position", "commanded_rotation", "pose", "direction", "speed", "branches", "branch_names")
    columns = {name: getattr(given, name) for name in names}
    data = replace(measured.subset(found), **columns, ordered=ordered)
    if ordered and data.q is not None and data.direction is None:
        visits = numbered_visits(data.groups(), data.visit, data.cycle, data.target)
        direction, speed = motion_between_visits(data.q, visits)
        data = replace(data, direction=direction, speed=speed)
    size_warnings = () if robot is None else check_size(data, robot)
    texts = (type(remark)(f"{measured.source}: {remark}") for remark in remarks)
    warnings = (*data.warnings, *size_warnings, *planned.warnings, *texts)
    record = InputFile.at(commands, planned.sha256 or "", "commanded")
    data = replace(data, warnings=warnings)
    data = seen_from_board(data, reading.camera, partial(nominal_poses, robot=robot))
    return data, {"commanded": record.name, "commanded_sha256": record.sha256}


def _table(path: PoseFile | str, reading: Reading, robot: Robot | None, ignore_limits: bool) -> Measurements:
    """Return a table of commands; the units and angles stated for the measured poses hold for its names too."""
    path = PoseFile(path, units=reading.units, angles=reading.angles, columns=reading.columns)
    if robot is not None:
        try:
            return read_robot_poses(path, robot, ignore_limits=ignore_limits, attained=False)
        except InputError as error:
            with suppress(InputError):
                data = _table(path, reading, None, ignore_limits)
                if data.q is None and data.commands is not None:
                    return data  # commanded poses
            raise error from None
    data = csv_file.read_poses(path, attained=False, commands=False)
    if data.commands is None and data.position.any():
        # A table of poses alone, such as a TUM trajectory: they are the commanded ones.
        return replace(data, commanded_position=data.position, commanded_rotation=data.rotation, rotation=None)
    return data if data.commands is not None else csv_file.read_poses(path, attained=False)


def _program(path: str) -> Measurements:
    """Return the targets of a robot program in the order of its motions."""
    from robacc.programs.program import ProgramFrame, companions, read_program
    from robacc.programs.targets import flange_targets

    # A KUKA program has its points in the file of the same name.
    program = max((read_program(name) for name in (path, *companions(path))), key=lambda item: len(item.targets))
    targets = [program.targets[index] for index in program.moves] or list(program.targets)
    kinds = {target.kind for target in targets}
    message = "the program has no targets in numbers" if not kinds else "the program mixes joints and poses"
    refuse((len(kinds) != 1, Problem(message, path, fix="list the commanded joints or poses in a CSV")))
    names = np.array([target.name for target in targets])
    values = np.array([target.values for target in targets]).T
    data = Measurements(np.zeros((3, names.size)), pose=names, source=path, sha256=sha256_of(path))
    if kinds == {"joint"}:
        return replace(data, q=values)
    # Registration fits one tool and one base, so a frame that all targets share need not be known.
    tools, bases = {target.tool for target in targets}, {target.base for target in targets}
    shared = ProgramFrame("", Frame())
    own = (
        replace(target, tool=target.tool if len(tools) > 1 else shared, base=target.base if len(bases) > 1 else shared)
        for target in targets
    )
    _, poses, unknown = flange_targets(replace(program, targets=tuple(own)))
    several, fix = "has several tools or base frames", "give a program for each tool and base frame"
    refuse(*((True, Problem(f"{several}, and {why}", path, targets[i].line, fix=fix)) for i, why in unknown))
    based = sorted({base.name for base in bases if base is not None and base.name})
    frame = "the robot's" if len(bases) > 1 else "the program's"
    warning = f"{path}: commanded poses are in {frame} base frame{' ' + ', '.join(based) if len(based) == 1 else ''}"
    return replace(data, commanded_position=poses.translation, commanded_rotation=poses.rotation, warnings=(warning,))


_GROUP = r".*(?:::|/|\\)_?"
_NAME_FORMS = (
    (r"^$", r"^$"),
    (_GROUP, _GROUP),
    (_GROUP, rf"{_GROUP}|[_(]+\d+\)?$"),
    (*[r"^(?:.*\D)?0*(?=\d+\D*$)|\D*$"] * 2,),
)
"""Parts that names of commands and of measured poses have beside what they share: none; groups, as in ``A::Main::p1``;
in measured ones the number of a repetition too, as in ``p1_2``; all but the last number, as in ``Pos 7``."""


def _joined(
    rows: Measurements, planned: Measurements, path: str, source: str | None
) -> tuple[Measurements, NDArray[np.bool_], tuple[str, ...]]:
    """Return the command of each measured row, the rows that have one, and how the rows were joined.

    Args:
        rows: Names, times and lines of the measured rows.
        planned: Commands.
        path: Their file.
        source: File of the measured poses.

    Raises:
        InputError: Most names or times have no command, a name has two, or the numbers of rows differ.
    """
    n, names = rows.n, rows.pose
    lines = np.arange(1, n + 1) if rows.rows is None else rows.rows
    at, most, poses = np.full(n, -1), 0.0, names
    taught, measured = (np.empty(0, dtype=str) if column is None else column for column in (planned.pose, names))
    is_named = measured.size > 0 and any(not str(name).startswith("line ") for name in taught.tolist())
    for form in _NAME_FORMS if is_named else ():
        if most == 1.0:
            break
        given, wanted = (
            [re.sub(pattern, "", re.sub(r"[\s_.-]+", "_", PHOTO.sub("", str(name).casefold()))) for name in column]
            for pattern, column in zip(form, (taught, measured), strict=True)
        )
        commands = {name: i for i, name in reversed([*enumerate(given)]) if name}
        alike = len({*given}) < len({*taught}) or len({*wanted}) < len({*measured})
        if form is _NAME_FORMS[-1] and (alike or not {*wanted} - {""} <= commands.keys()):
            continue  # one number of two names, or other numbers
        found = np.array([commands.get(key, -1) for key in wanted])
        if (share := float(np.mean(found >= 0))) > most:
            at, most, poses = found, share, names if form[0] == form[1] else taught[found]
            grouping = commanded_groups(np.array(given), planned.commands)
            if share > 0.5 and grouping is not None and grouping.contradicted is not None:
                message = f"pose {taught[np.argmax(grouping.contradicted)]} has two different commands"
                raise InputError(Problem(message, path, fix="give each pose its own name"))
    remark: str = Note(f"commands of {path} joined by the names of the poses")
    # A file that counts from 0 and one that does not have no clock in common.
    clocks = [time for time in (rows.time, planned.time) if time is not None and time.size > 1]
    if not most and len(clocks) == 2 and (clocks[0].min() == 0) == (clocks[1].min() == 0):
        planned, at = _by_time(clocks[0], clocks[1], planned)
        remark = Note(f"commands of {path} joined by the times of the rows")
        spans = [f"{np.min(time):.10g} to {np.max(time):.10g} s" for time in clocks]
        message = f"the times of the rows ({spans[0]}) are not those of the commands in {path} ({spans[1]})"
        fix = "set both clocks alike, name the poses in both files, or leave the times out of one of them"
        refuse((np.mean(at >= 0) <= 0.5, Problem(message, source, fix=fix)))
    elif not most:
        every = np.union1d(lines, np.array(rows.gaps, dtype=np.int64))
        order = {name: i for i, name in enumerate(dict.fromkeys(measured.tolist()))}
        poses_and_rows = f"{len(order)} measured poses ({n} rows)" if order else f"{n} measured rows"
        message = f"found {poses_and_rows} and {planned.n} commands in {path}, which share no names"
        problem = Problem(
            message,
            source,
            fix="name the poses in both files, in a column pose; give each of several tools (Tool ID) its own file",
        )
        refuse((planned.n not in (every.size, n, len(order)), problem))
        # Rows that were left out have a command too.
        at = np.searchsorted(every, lines) if every.size == planned.n else np.arange(n)
        if planned.n == len(order) < n:
            at = np.array([order[name] for name in measured.tolist()])
        remark = f"commands of {path} joined by the order of rows: the files share no names"
    unmatched = [f"line {line}" for line in lines[at < 0]] if names is None else names[at < 0].tolist()
    without = list(dict.fromkeys(map(str, unmatched)))
    listed = f"{', '.join(without[:LISTED])}{' …' * (len(without) > LISTED)}"
    message = f"{len(without)} of the measured poses have no command in {path}: {listed}"
    refuse((0 < most <= 0.5, Problem(message, source, column="pose", fix="give the poses the same names")))
    left_out = (f"rows without a command in {path} are left out: {listed}",) if without else ()
    chosen = planned.subset(at)
    return replace(chosen, pose=chosen.pose if poses is None else poses), at >= 0, (*left_out, remark)


def _by_time(time: Array, clock: Array, planned: Measurements) -> tuple[Measurements, NDArray[np.int64]]:
    """Return commands, and the row of them within half a step of each time ``(N,)`` s; -1 where there is none.

    The commands have the times ``clock``.

    Joints of an arm that moves between the rows are interpolated; then each time has its own row.
    """
    order = np.argsort(clock, kind="stable")
    clock = clock[order]
    # Each file counts from the midnight before its first row.
    time = time - _DAY * np.round((np.median(time) - np.median(clock)) / _DAY)
    right = np.clip(np.searchsorted(clock, time), 1, clock.size - 1)
    nearest = np.where(time - clock[right - 1] < clock[right] - time, right - 1, right)
    found = np.abs(clock[nearest] - time) <= np.median(np.diff(clock)) / 2
    at = order[nearest]
    # Rows of joints from which it shows whether the arm moves evenly between them.
    if planned.q is not None and clock.size > 8 and np.diff(clock).min() > 0:
        q = planned.q[:, order]
        first, second = (np.median(np.abs(np.diff(q, k)).max(axis=0)) for k in (1, 2))
        # Typical second difference of such joints, at most, as a share of the first: poses at random have more than 1.
        if second < 0.2 * first:
            from scipy.interpolate import CubicSpline

            planned = replace(planned.subset(at), q=CubicSpline(clock, q, axis=1)(time), time=time)
            at = np.arange(time.size)
    return planned, np.where(found, at, -1)
