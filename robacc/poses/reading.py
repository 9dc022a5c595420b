"""Statements of the user on a pose file that its names leave open: units, angles, columns."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

from robacc.errors import UsageError
from robacc.io.bag_options import BagOptions
from robacc.poses.angles import CONVENTIONS
from robacc.poses.columns import FOREIGN_UNITS, UNITS, is_documented

if TYPE_CHECKING:
    from robacc.io.table_parts import TableOptions

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
    bag: str | None = None
    """Topics and samples of a recording: ``joints=/joint_states,measured=/tracker/pose,at=rest``."""

    def __post_init__(self) -> None:
        """Check the statements.

        Raises:
            UsageError: A convention or unit is unknown, or a coverage factor is not positive.
        """
        if self.angles is not None and self.angles not in CONVENTIONS:
            raise UsageError(f"`angles`: expected one of {', '.join(CONVENTIONS)}, found {self.angles!r}")
        if self.coverage is not None and not 0 < self.coverage < 10:
            raise UsageError(f"`coverage`: expected a coverage factor such as 1 or 2, found {self.coverage!r}")
        BagOptions.of(self.bag)
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
            quantity = {**UNITS, **FOREIGN_UNITS}.get(unit, ("", 0.0))[0]
            if quantity not in ("length", "angle") or quantity in result:
                raise UsageError(
                    f"`units`: expected a unit of length (m, mm, um, in) and one of angle (rad, mrad, deg), such as "
                    f"mm,deg, found {self.units!r}"
                )
            result[quantity] = unit
        return result

    def document(self) -> dict[str, Any]:
        """Return the statements that were made, for a result's options."""
        names = ("angles", "units", "columns", "skip_gaps", "coverage", "sheet", "commanded", "bag")
        values = {name: getattr(self, name) for name in names}
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
            bag: See above.

        Raises:
            UsageError: A statement is wrong, or ``path`` is neither a path nor a data frame.
            InputError: The column map cannot be read.
        """
        is_table = isinstance(path, Mapping) or any(hasattr(path, name) for name in _OF_TABLES)
        if not is_table and not isinstance(path, str | os.PathLike):
            raise UsageError(
                f"expected a path, a data frame or Measurements as poses, found {type(path).__name__}; make a data "
                "frame of records, or Measurements(position=…, q=…) of arrays"
            )
        result = super().__new__(cls, os.fspath(path) if isinstance(path, str | os.PathLike) else FRAME)
        result.frame = (
            path.frame if isinstance(path, PoseFile) else None if isinstance(path, str | os.PathLike) else path
        )
        stated: dict[str, Any] = {"angles": angles, "units": units, "coverage": coverage, "sheet": sheet}
        stated["bag"] = bag
        stated = {name: value for name, value in stated.items() if value is not None}
        if isinstance(columns, str | os.PathLike):
            from robacc.poses.column_map import read_column_map

            stated = read_column_map(columns) | stated
        elif columns is not None:
            stated["columns"] = columns
        if commanded is not None:
            stated["commanded"] = os.fspath(commanded)
        result.reading = Reading(skip_gaps=skip_gaps, **stated)
        return result

    def __reduce__(self) -> tuple[object, ...]:
        """Return how to copy the path into another process."""
        return _restored, (str(self), self.reading, self.frame)


def _restored(path: str, reading: Reading, frame: Any) -> PoseFile:
    result = PoseFile(path)
    result.reading, result.frame = reading, frame
    return result


def reading_of(path: str | os.PathLike[str]) -> Reading:
    """Return the statements that a path carries."""
    return path.reading if isinstance(path, PoseFile) else AS_NAMED


def table_options(path: str | os.PathLike[str]) -> TableOptions:
    """Return how the table at a path is to be read, with the statements that the path carries."""
    from robacc.io.table_parts import TableOptions

    reading = reading_of(path)
    frame = path.frame if isinstance(path, PoseFile) else None
    return TableOptions(is_documented, reading.skip_gaps, reading.sheet, BagOptions.of(reading.bag), frame)
