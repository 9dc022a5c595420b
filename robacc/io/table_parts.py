"""Parts of a table that a reader returns, whatever form the table has: names of columns, rows, and the options."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robacc.geometry import Array
from robacc.io.bag_options import NO_BAG_OPTIONS, BagOptions
from robacc.io.dialect import PLAIN, TableDialect

MAX_TEXT = 256
"""Characters of an id; text columns are as wide as their longest entry."""


@dataclass(frozen=True, slots=True)
class TableOptions:
    """Freedom that a reader has."""

    is_known: Callable[[str], bool] | None = None
    """Whether a name is a documented one; None: only the documented form of a table is read."""
    skip_gaps: bool = False
    """Leave out rows with a missing value, in place of a problem for each."""
    sheet: str | None = None
    """Sheet of a workbook; None for its only sheet."""
    bag: BagOptions = NO_BAG_OPTIONS
    """Topics and samples of a recording."""
    frame: Any = None
    """Data frame that is read in place of a file."""


@dataclass(frozen=True, slots=True)
class Header:
    """Names that a file gives its columns."""

    names: tuple[str, ...]
    line: int | None
    """1-based line of the names; None where the file has no lines."""
    dialect: TableDialect = PLAIN
    """Form of the table, where it is not the documented one."""
    cell_units: Mapping[int, str] = field(default_factory=dict)
    """Units behind the numbers of the cells, by the index of the column."""


@dataclass(frozen=True, slots=True)
class TableBody:
    """Rows below the header."""

    numbers: Array
    """``(C, N)`` columns of numbers; NaN where a problem was logged."""
    texts: tuple[NDArray[np.str_], ...]
    """Columns of text, ``(N,)`` each."""
    lines: NDArray[np.int64]
    """``(N,)`` 1-based line of each row, or its row number where the file has no lines."""
    gaps: tuple[int, ...] = ()
    """Lines of the rows that were left out because a value is missing."""

    def without(self, gaps: Collection[int]) -> TableBody:
        """Return the rows that are not on the lines ``gaps``."""
        if not gaps:
            return self
        complete = ~np.isin(self.lines, list(gaps))
        texts = tuple(column[complete] for column in self.texts)
        return TableBody(self.numbers[:, complete], texts, self.lines[complete], tuple(sorted(gaps)))
