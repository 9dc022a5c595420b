"""Selection of the poses that a chart shows, reproducible and including the extremes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Rows = NDArray[np.int64]


def thinned(most: int, *columns: Array) -> Rows:
    """Return the rows to show, ascending: all of them up to ``most``.

    With more rows, a quarter of the selection are the rows with the largest and smallest values of each column
    ``(N,)``; the others are spread evenly over all rows. The selection keeps the range and the extremes.
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
    remaining = np.setdiff1d(np.arange(n), np.array(sorted(extreme)))
    evenly = remaining[np.linspace(0, remaining.size - 1, most - len(extreme)).round().astype(np.int64)]
    return np.sort(np.concatenate((np.array(sorted(extreme), dtype=np.int64), evenly)))


def thinning_note(count: int, total: int) -> str:
    """Return the sentence for a caption; an empty text if all poses are shown."""
    return "" if count >= total else f" The chart shows {count:,} of {total:,} poses, including the extremes."
