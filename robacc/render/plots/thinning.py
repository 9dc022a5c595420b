"""Which poses a picture shows when there are more than it can: always the same ones, the extremes among them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Rows = NDArray[np.int64]


def thinned(most: int, *columns: Array) -> Rows:
    """Rows to show, ascending: all of them up to ``most``.

    Beyond, a quarter are the rows with the largest and the smallest values of each column ``(N,)``, and the rest are
    spread evenly over all rows. A picture that shows fewer points so keeps its range and what sticks out.
    """
    n = columns[0].size
    if n <= most:
        return np.arange(n)
    each = max(1, most // (8 * len(columns)))
    extreme: set[int] = set()
    for column in columns:
        order = np.argsort(np.where(np.isfinite(column), column, np.nanmedian(column)), kind="stable")
        extreme.update(order[:each].tolist())
        extreme.update(order[-each:].tolist())
    rest = np.setdiff1d(np.arange(n), np.array(sorted(extreme)))
    spread = rest[np.linspace(0, rest.size - 1, most - len(extreme)).round().astype(np.int64)]
    return np.sort(np.concatenate((np.array(sorted(extreme), dtype=np.int64), spread)))


def shown(count: int, of: int) -> str:
    """What a caption says of it; nothing where all are shown."""
    return "" if count >= of else f" {count:,} of {of:,} poses are drawn, the extremes among them."
