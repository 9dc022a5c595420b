"""Tables without a header whose form is known: TUM trajectories, and point lists of SpatialAnalyzer."""

from __future__ import annotations

import math
from collections.abc import Sequence

from robacc.errors import InputError, Problem
from robacc.io.dialect import TableDialect
from robacc.io.table_parts import Header

_TUM = ("time", "x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")
_UNIT_LENGTH = 1e-3
_POINT = ("X", "Y", "Z")
_UNCERTAINTY = ("Ux", "Uy", "Uz")


def with_known_names(header: Header, file: str) -> Header:
    """Return the header with the names that the rows themselves show.

    Raises:
        InputError: The rows have no known form.
    """
    dialect = header.dialect
    names = _tum(dialect) or _spatial_analyzer(dialect)
    if names is not None:
        return Header(names, header.line, dialect)
    fix = (
        "begin the file with the columns' names, or name them with `columns`: a file with entries such as "
        "'column 1: x_mm', which the command init writes"
    )
    raise InputError(Problem("found numbers, expected a header row", file, header.line, fix=fix))


def _tum(dialect: TableDialect) -> tuple[str, ...] | None:
    """Return the names of a TUM trajectory: eight numbers, the last four a unit quaternion with w last."""
    rows = [_numbers(fields) for fields in dialect.sample]
    if not rows or dialect.separator is not None or any(row is None or len(row) != len(_TUM) for row in rows):
        return None
    lengths = [math.hypot(*row[4:]) for row in rows if row is not None]
    return _TUM if all(abs(length - 1) < _UNIT_LENGTH for length in lengths) else None


def _spatial_analyzer(dialect: TableDialect) -> tuple[str, ...] | None:
    """Return the names of a point list: collection, group and point, of which some may be missing, then x, y, z."""
    first = dialect.sample[0] if dialect.sample else ()
    texts = next((i for i, text in enumerate(first) if dialect.is_number(text)), 0)
    numbers = len(first) - texts
    if not 1 <= texts <= 3 or not any("spatialanalyzer" in line.lower().replace(" ", "") for line in dialect.preamble):
        return None
    labels = ("Collection", "Group", "Point")[3 - texts :]
    if numbers == 3:
        return (*labels, *_POINT)
    return (*labels, *_POINT, *_UNCERTAINTY) if numbers == 6 else None


def _numbers(fields: Sequence[str]) -> list[float] | None:
    try:
        return [float(text) for text in fields]
    except ValueError:
        return None
