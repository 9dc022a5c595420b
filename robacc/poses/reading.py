"""What is stated of a pose file: by its user, in a column map, and by the robot that it is of."""

from __future__ import annotations

import difflib
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import partial
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np
import yaml
from numpy.typing import NDArray

from robacc.errors import refuse
from robacc.geometry import Array, Poses, exp_so3, rotation_from_quaternion, rotation_from_rpy
from robacc.io.files import read_text
from robacc.io.table import TableOptions
from robacc.io.yaml_nodes import Source, compose, describe, is_null, join
from robacc.poses.columns import FIXED_KINDS, NAME_UNITS, TIME_KEYS, UNITS, BranchColumn, is_documented, time_column

# Conventions of three angles that form an orientation, and the trial of the data against each.
#
# A name such as ``Rx`` does not say which convention it belongs to: a rotation vector on one controller, angles about
# fixed axes on the next. Turns between poses depend neither on the measuring frame nor on the mounting of the target,
# so they show which convention the orientations follow.

AGREES = np.radians(3.0)
"""rad; typical disagreement of a convention that fits: no arm turns its flange by more than it was commanded to."""
_FEWEST = 4
"""Comparisons that a decision needs."""


def _about(axes: Sequence[int], angles: Array) -> Array:
    """Return the rotations ``(3, 3, N)`` about these moving axes by ``angles`` ``(3, N)``, rad."""
    first, second, third = (exp_so3(np.eye(3)[:, axis, None] * angle) for axis, angle in zip(axes, angles, strict=True))
    return np.asarray(np.einsum("ijn,jkn,kln->iln", first, second, third))


CONVENTIONS: Mapping[str, Callable[[Array], Array]] = {
    "rotvec": exp_so3,
    "fixed-xyz": rotation_from_rpy,
    "moving-xyz": partial(_about, (0, 1, 2)),
    "zyx": rotation_from_rpy,
    "kuka-abc": partial(_about, (2, 1, 0)),
    "zyz": partial(_about, (2, 1, 2)),
    "wxyz": rotation_from_quaternion,
    "xyzw": lambda quaternion: rotation_from_quaternion(np.roll(quaternion, 1, axis=0)),
}
"""Rotation ``(3, 3, N)`` of three angles ``(3, N)``, rad.

``rotvec``: rotation vector. ``fixed-xyz``: about the fixed axes x, then y, then z; ``zyx`` is the same rotation
described about moving axes z, y, x. ``moving-xyz``: about the moving axes x, y, z. ``kuka-abc``: A about z, B about the
moving y, C about the moving x. ``zyz``: about the moving axes z, y, z, as Kawasaki's O, A, T.
``wxyz`` and ``xyzw`` are quaternions ``(4, N)`` with the scalar part first or last.
"""


def is_ruled_out(name: str, trial: Mapping[str, float]) -> bool:
    """Return whether the convention with the smallest disagreement fits and another one does not."""
    best = min(trial.values())
    # Ratio of the typical disagreements at which the second convention is ruled out.
    return bool(best < AGREES and trial[name] > max(5.0 * best, AGREES))


def try_conventions(angles: Array, known: Array, conventions: Sequence[str]) -> dict[str, float] | None:
    """Compare turns between poses under each convention with those of known orientations.

    The turn of R_i^T R_j R_k^T R_l depends on no frame. Two poses alone would not tell a convention from its mirror
    image, such as angles about x, y, z from angles about z, y, x.

    Args:
        angles: ``(3, N)`` rad.
        known: ``(3, 3, N)`` orientations of the same poses, in any frame and of any part of the same body.
        conventions: Names of :data:`CONVENTIONS`.

    Returns:
        Median difference between measured and known turn by convention, rad; None if too few poses differ.
    """
    n = angles.shape[1]
    # Comparisons at most.
    first = np.unique(np.linspace(0, n - 1, min(n, 400)).astype(int))
    steps = (0, 1, n // 3 + 1, 2 * n // 3 + 1)
    fours = np.stack([(first + step) % n for step in steps])
    turned = _turns(known, fours)
    fours, turned = fours[:, turned > 2 * AGREES], turned[turned > 2 * AGREES]
    if n < len(steps) or turned.size < _FEWEST:
        return None
    tried = {name: _turns(CONVENTIONS[name](angles), fours) - turned for name in conventions}
    return {name: float(np.median(np.abs(difference))) for name, difference in tried.items()}


def _turns(rotation: Array, fours: Array) -> Array:
    """Return the angle of the rotation R_i^T R_j R_k^T R_l of each four poses ``(4, M)``, rad."""
    first, second, third, fourth = (rotation[..., rows] for rows in fours)
    left = np.einsum("ian,ibn->abn", first, second)
    right = np.einsum("ian,ibn->abn", third, fourth)
    trace = np.einsum("abn,ban->n", left, right)
    return np.asarray(np.arccos(np.clip((trace - 1) / 2, -1.0, 1.0)))


# Column maps: YAML files that say which column of an export is which, and what its names leave open.
#
# robacc_columns: 1
# angles: fixed-xyz
# units: mm,deg
# columns:
#   "A1 [°]": q1_deg
#   "X [mm]": x_mm
#   Comment:                       # not read

_VERSION = "1"
OPEN = "unknown"
"""Entry of a statement that the user has to fill in; a command refuses it."""


def read_column_map(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Return the statements of a column map by their names in :class:`~robacc.poses.reading.Reading`.

    Raises:
        InputError: The file cannot be read, or has problems; with every problem, its line and key.
    """
    name = os.fspath(path)
    source = Source(name)
    kinds: dict[str, Callable[[yaml.Node, str], Any]] = {
        "angles": partial(source.choice, options=tuple(CONVENTIONS)),
        "units": source.text,
        "coverage": source.number,
        "sheet": source.text,
        "bag": source.text,
        "columns": partial(_read_columns, source),
    }
    result: dict[str, Any] = {}
    if (top := source.section(compose(read_text(name), name), "", ("robacc_columns", *kinds))) is not None:
        version = top.require("robacc_columns")
        if version is not None and getattr(version, "value", None) != _VERSION:
            source.report(version, "robacc_columns", f"expected {_VERSION}, found {describe(version)}")
        result = {key: read(node, key) for key, read in kinds.items() if (node := top.get(key)) is not None}
        if result.get("units") == OPEN:
            source.report(top.get("units"), "units", "is not filled in", "for example mm,deg")
    source.raise_if_any()
    return result


def _read_columns(source: Source, node: yaml.Node, path: str) -> dict[str, str | None]:
    """Return the documented name by the name in the file, None for a column that is not read."""
    if not isinstance(node, yaml.MappingNode):
        source.report(node, path, f"expected names with documented names, found {describe(node)}")
        return {}
    result: dict[str, str | None] = {}
    for name, _, value in source.entries(node, path):
        key = join(path, name)
        result[name] = meaning = None if is_null(value) else source.text(value, key)
        if meaning is not None and not is_documented(meaning) and time_column(meaning) is None:
            known = [*FIXED_KINDS, *TIME_KEYS, *(f"q{i}" for i in range(1, 8))]
            known += [f"{key}_{unit}" for key in known for unit in NAME_UNITS]
            nearest = difflib.get_close_matches(meaning.lower(), known, n=1, cutoff=0.0)[0]
            source.report(value, key, f"expected a documented name, found {meaning!r}", f"did you mean {nearest}?")
    return result


# What the reader of a pose file knows of the robot that the poses are of.

JointLimits = Sequence[tuple[float, float] | None]
"""Lowest and highest value of each joint, rad or m; None for a joint without limits."""
PoseAt = Callable[[Array], Poses]
"""Nominal poses of the robot at joint variables ``(J, N)``."""


class RowKeys(NamedTuple):
    """What rows of one file are joined to those of another by."""

    names: NDArray[Any] | None
    """``(N,)`` names of the poses."""
    time: Array | None
    """``(N,)`` s"""
    lines: NDArray[np.int64]
    """``(N,)`` line or row in the file."""
    gaps: tuple[int, ...] = ()
    """Lines of rows that were left out because a value is missing."""


KnownPoses = Callable[[RowKeys], tuple[Array | None, Array | None]]
"""Positions ``(3, N)`` and orientations ``(3, 3, N)`` that another file gives to rows, NaN where it has no such row;
None for what it does not give."""


@dataclass(frozen=True, slots=True)
class KnownRobot:
    """Names, limits and targets of a robot, which the columns of its poses are checked against."""

    joint_names: Sequence[str] | None = None
    """Joints in chain order; their names stand for ``q1 … qN``. None: no robot is known."""
    joint_types: Sequence[str] | None = None
    """``revolute`` or ``prismatic`` of each joint; None: a joint's unit may be an angle or a length."""
    limits: JointLimits | None = None
    """Limits of each joint; None: unknown."""
    target_names: Sequence[str] | Literal["any"] | None = None
    """Targets of the robot file, empty for a robot with one tool; None: no robot is known, and any name is valid.
    ``any``: several targets are valid although the robot has one tool, as columns ``x1 … z2`` too."""
    branches: Sequence[BranchColumn] = ()
    """Joints outside the chain that move mass; each stands at its position where it has no column."""
    outside: Mapping[str, str] = field(default_factory=dict)
    """Joints outside the chain that a joint variable follows, and the rule by which it does."""
    pose_at: PoseAt | None = None
    """Nominal poses of the robot, which show units and the convention of angles that names leave open."""

    @property
    def targets(self) -> tuple[str, ...]:
        """Names of the targets of the robot file; empty where it has one tool, or no robot is known."""
        return () if self.target_names is None or self.target_names == "any" else tuple(self.target_names)


UNKNOWN_ROBOT = KnownRobot()
"""No robot is known."""


_UNIT_WORDS = {"inch": "in", "°": "deg", "µm": "um"}


@dataclass(frozen=True, slots=True)
class Reading:
    """Statements on a pose file that apply where its own names leave a question open."""

    angles: str | None = None
    """Convention of three angles that form an orientation: ``rotvec``, ``fixed-xyz``, ``kuka-abc``, …"""
    units: str | None = None
    """Units of columns whose names have none: ``mm,deg``."""
    columns: Mapping[str, str | None] | None = None
    """Documented name (``x_mm``) of each column by its name in the file; None for a column that is not read."""
    skip_gaps: bool = False
    """Leave out rows with a missing value, with a warning."""
    coverage: float | None = None
    """Coverage factor of uncertainties ``U``: 1 for standard, 2 for expanded uncertainties at 95 %."""
    sheet: str | None = None
    """Name of a workbook's sheet; None for its only sheet."""
    commanded: str | None = None
    """File with the commands: a robot program, or a table of joints or commanded poses."""
    camera: str | None = None
    """File of the camera, or cameras, that took images of a board."""
    board: str | None = None
    """File of the board that photos show."""
    bag: str | None = None
    """Topics and samples of a recording: ``joints=/joint_states,measured=/tracker/pose,at=rest``."""

    def __post_init__(self) -> None:
        """Check the statements.

        Raises:
            UsageError: A convention or unit is unknown, or a coverage factor is not positive.
        """
        refuse(
            (
                self.angles is not None and self.angles not in CONVENTIONS,
                f"`angles`: expected one of {', '.join(CONVENTIONS)}, found {self.angles!r}",
            ),
            (
                self.coverage is not None and not 0 < self.coverage < 10,
                f"`coverage`: expected a coverage factor such as 1 or 2, found {self.coverage!r}",
            ),
        )
        self.unit_of  # noqa: B018 (the property checks)

    @property
    def unit_of(self) -> dict[str, str]:
        """Return the stated unit of ``length`` and of ``angle``.

        Raises:
            UsageError: A unit is unknown, or two units are of one quantity.
        """
        result: dict[str, str] = {}
        for part in (self.units or "").split(",") if self.units else ():
            unit = _UNIT_WORDS.get(part.strip(), part.strip())
            quantity = UNITS.get(unit, ("", 0.0))[0]
            refuse(
                (
                    quantity not in ("length", "angle") or quantity in result,
                    f"`units`: expected a unit of length (m, mm, um, in) and one of angle (rad, mrad, deg), such as "
                    f"mm,deg, found {self.units!r}",
                )
            )
            result[quantity] = unit
        return result

    def document(self) -> dict[str, Any]:
        """Return the statements that were made, for a result's options."""
        values = {item.name: getattr(self, item.name) for item in fields(self)}
        return {name: dict(value) if name == "columns" else value for name, value in values.items() if value}


FRAME = "DataFrame"
"""Name of a data frame in messages and records."""
AS_NAMED = Reading()
"""No statement: the names of the file decide."""


class SupportsColumns(Protocol):
    """Data frame: a table that gives its columns by their names (pandas, Polars, Arrow)."""

    @property
    def columns(self) -> Any:
        """Names of the columns."""


_OF_TABLES = ("columns", "column_names", "__arrow_c_stream__", "__dataframe__")
"""Attributes by which a data frame is known."""


class PoseFile(str):
    """Path of a pose file, or a data frame, with statements on what its names leave open.

    It stands wherever a path of poses does: ``robacc.estimate(PoseFile("export.csv", units="mm,deg"), robot=…)``.
    """

    __slots__ = ("frame", "reading")
    reading: Reading
    frame: Any
    """Data frame; None for a file."""

    def __new__(
        cls,
        path: str | os.PathLike[str] | SupportsColumns | Mapping[str, Any],
        *,
        angles: str | None = None,
        units: str | None = None,
        columns: str | os.PathLike[str] | Mapping[str, str | None] | None = None,
        skip_gaps: bool = False,
        coverage: float | None = None,
        sheet: str | None = None,
        commanded: str | os.PathLike[str] | None = None,
        camera: str | os.PathLike[str] | None = None,
        board: str | os.PathLike[str] | None = None,
        bag: str | None = None,
    ) -> PoseFile:
        """Return the path with the statements, which are those of :class:`Reading`.

        Args:
            path: The pose file, or a data frame: pandas, Polars, Arrow, or arrays by the names of columns.
            angles: See :class:`Reading`; likewise the other statements.
            units: See above.
            columns: A column map (YAML), or its entries. A map may also state the rest; arguments take precedence.
            skip_gaps: See above.
            coverage: See above.
            sheet: See above.
            commanded: See above.
            camera: See above.
            board: See above.
            bag: See above.

        Raises:
            UsageError: A statement is wrong, or ``path`` is neither a path nor a data frame.
            InputError: The column map cannot be read.
        """
        is_path = isinstance(path, str | os.PathLike)
        refuse(
            (
                not is_path and not isinstance(path, Mapping) and not any(hasattr(path, name) for name in _OF_TABLES),
                f"expected a path, a data frame or Measurements as poses, found {type(path).__name__}; make a data "
                "frame of records, or Measurements(position=…, q=…) of arrays",
            )
        )
        result = super().__new__(cls, os.fspath(path) if isinstance(path, str | os.PathLike) else FRAME)
        result.frame = getattr(path, "frame", None) if is_path else path
        stated = read_column_map(columns) if isinstance(columns, str | os.PathLike) else {"columns": columns}
        given = {"angles": angles, "units": units, "coverage": coverage, "sheet": sheet, "bag": bag}
        files = {"commanded": commanded, "camera": camera, "board": board}
        given |= {name: None if file is None else os.fspath(file) for name, file in files.items()}
        stated |= {name: value for name, value in given.items() if value is not None}
        result.reading = Reading(skip_gaps=skip_gaps, **stated)
        return result


def reading_of(path: str | os.PathLike[str]) -> Reading:
    """Return the statements that a path carries."""
    return path.reading if isinstance(path, PoseFile) else AS_NAMED


def table_options(path: str | os.PathLike[str]) -> TableOptions:
    """Return how the table at a path is to be read, with the statements that the path carries."""
    reading = reading_of(path)
    frame = path.frame if isinstance(path, PoseFile) else None
    return TableOptions(is_documented, reading.skip_gaps, reading.sheet, reading.bag, reading.board, frame)
