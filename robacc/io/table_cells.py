"""Read the cells of a table one by one, where its rows are not plain numbers; every problem is logged."""

from __future__ import annotations

import math
from collections.abc import Mapping

from robacc.io.cell_units import split_cell
from robacc.io.dialect import TableDialect
from robacc.io.number_text import GAPS, advice, is_grouped, number_of
from robacc.io.problem_log import ProblemLog, clip
from robacc.io.table_parts import MAX_TEXT

_SKIP = "give `skip_gaps` to leave out rows with a missing value"


class CellReader:
    """Reader of the cells of one table."""

    def __init__(self, dialect: TableDialect, units: Mapping[int, str], skip_gaps: bool, log: ProblemLog) -> None:
        """Read cells whose columns of the indices ``units`` have these units; problems go to ``log``."""
        self.dialect = dialect
        self.units = units
        self.skip_gaps = skip_gaps
        self.log = log
        self.gaps: set[int] = set()
        """Lines with a missing value that are left out."""
        self.has_grouped = False
        """Whether a number had separators of thousands."""

    def number(self, cell: str, line: int, index: int, column: str) -> float:
        """Return the number in a cell of the column with this index and name; NaN where there is none."""
        return self._number(self._bare(cell, line, index, column), line, column)

    def text(self, cell: str, line: int, column: str) -> str:
        """Return the text in a cell, cut to the greatest length."""
        if not cell:
            self.log.add("the value is missing, expected text", line, column)
        elif len(cell) > MAX_TEXT:
            self.log.add(f"the text has {len(cell)} characters, expected at most {MAX_TEXT}", line, column)
        return cell[:MAX_TEXT]

    def _bare(self, cell: str, line: int, index: int, column: str) -> str:
        """Return a cell without its unit; log a unit that is not the column's."""
        if index not in self.units or not any(sign.isdecimal() for sign in cell):
            return cell
        expected, (number, unit) = self.units[index], split_cell(cell)
        if unit is not None and unit != expected:
            fix = "export the column in one unit"
            self.log.add(f"found {clip(cell)}, but the first cell is in {expected}", line, column, fix)
        elif unit is None and number_of(number, self.dialect.decimal_comma) is not None:
            fix = f"export every cell with its unit, or none and {expected} in the column's name"
            self.log.add(f"found {clip(cell)} without the unit {expected}", line, column, fix)
        return number

    def _number(self, cell: str, line: int, column: str) -> float:
        if self.skip_gaps and cell.lower() in GAPS:
            self.gaps.add(line)
            return math.nan
        if not cell:
            self.log.add("the value is missing, expected a number", line, column, _SKIP)
            return math.nan
        value = number_of(cell, self.dialect.decimal_comma)
        if value is None:
            fix = _SKIP if cell.lower() in GAPS else advice(cell, column, self.dialect.decimal_comma)
            self.log.add(f"found {clip(cell)}, expected a number", line, column, fix)
            return math.nan
        self.has_grouped |= is_grouped(cell, self.dialect.decimal_comma)
        if not math.isfinite(value):
            fix = _SKIP if cell.lower() in GAPS else None
            self.log.add(f"found {clip(cell)}, expected a finite number", line, column, fix)
            return math.nan
        return value
