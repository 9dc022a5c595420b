"""Circumstance that outliers share: rows that a lacking effect displaces, and no accidents of the instrument.

A beam break strikes rows at random. Rows that all lie at large angles of one joint, in one corner, or at one time have
a common cause. Each circumstance is tested by ranks: all outliers among the extreme rows (hypergeometric), or their
rank sum (Mann and Whitney). Significance is for all circumstances together (Bonferroni).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.geometry import Array
from robacc.measurements import Measurements

_FEWEST = 3
"""Outliers from which a common circumstance is looked for."""
_SIGNIFICANT = 1e-3
"""Probability of a pattern by chance, over all circumstances, below which it is reported."""
_MOST_OF_ALL = 0.5
"""Share of all rows up to which rows beyond a limit are a particular circumstance."""


@dataclass(frozen=True, slots=True)
class OutlierPattern:
    """Range of one quantity in which the outliers lie."""

    quantity: str
    side: str
    """``above`` or ``below``."""
    limit: float
    unit: str
    inside: int
    """Outliers within the range."""
    outliers: int
    share: float
    """Share of all rows within the range."""
    p_value: float

    @property
    def text(self) -> str:
        """Return the pattern as a sentence."""
        return (
            f"{self.inside} of {self.outliers} outliers have {self.quantity} {self.side} {self.limit:.4g} {self.unit}, "
            f"but only {100 * self.share:.0f} % of all rows have: the outliers have a common cause"
        )


def outlier_pattern(data: Measurements, outliers: NDArray[np.bool_], names: tuple[str, ...]) -> OutlierPattern | None:
    """Return the circumstance that the outliers share; None if they look accidental.

    Args:
        data: Measured poses.
        outliers: ``(N,)`` mask of the outliers.
        names: Names of the joints, in the order of ``data.q``.
    """
    count = int(np.count_nonzero(outliers))
    if count < _FEWEST or count == outliers.size:
        return None
    tested = list(_quantities(data, names))
    best: OutlierPattern | None = None
    for quantity, unit, values in tested:
        for side, ordered in (("above", values), ("below", -values)):
            p_value = min(1.0, _by_chance(ordered, outliers) * 2.0 * len(tested))
            if p_value <= _SIGNIFICANT and (best is None or p_value < best.p_value):
                best = _pattern(quantity, unit, side, ordered, outliers, p_value)
    return best


def _quantities(data: Measurements, names: tuple[str, ...]) -> Iterator[tuple[str, str, Array]]:
    """Yield name, unit and value per row of every circumstance that varies."""
    columns: list[tuple[str, str, Array | None]] = []
    if data.q is not None:
        for name, values in zip(names, data.q, strict=True):
            columns.append((name, "(rad or m)", values))
            columns.append(
                (f"the distance of {name} from its median", "(rad or m)", np.abs(values - np.median(values)))
            )
    for name, values in zip("xyz", data.position, strict=True):
        columns.append((name, "m", values))
    columns.append(("the distance from the centre of the poses", "m", _from_centre(data.position)))
    columns.append(("time", "s", data.time))
    columns.append(("temperature", "°C", data.temperature))
    columns.append(("payload", "kg", data.payload))
    columns.append(("row number", "", np.arange(1.0, data.n + 1.0)))
    for name, unit, column in columns:
        if column is not None and np.ptp(column) > 0:
            yield name, unit, column


def _from_centre(position: Array) -> Array:
    centre = np.median(position, axis=1, keepdims=True)
    distance: Array = np.linalg.norm(position - centre, axis=0)
    return distance


def _by_chance(values: Array, outliers: NDArray[np.bool_]) -> float:
    """Return the probability that as many random rows lie as high as the outliers do."""
    n, k = values.size, int(np.count_nonzero(outliers))
    beyond = int(np.count_nonzero(values >= values[outliers].min()))
    all_extreme = math.exp(_log_choose(beyond, k) - _log_choose(n, k))
    order = np.argsort(values, kind="stable")
    rank = np.empty(n)
    rank[order] = np.arange(1, n + 1)
    _, first, size = np.unique(values, return_inverse=True, return_counts=True)
    rank = (np.bincount(first, weights=rank) / size)[first]  # equal values share their mean rank
    mean = k * (n + 1) / 2.0
    std = math.sqrt(k * (n - k) * (n + 1) / 12.0)
    z = (float(rank[outliers].sum()) - mean) / std
    rank_sum = 0.5 * math.erfc(z / math.sqrt(2.0)) if k >= 8 else 1.0
    return 2.0 * min(all_extreme, rank_sum)


def _log_choose(n: int, k: int) -> float:
    return math.lgamma(n + 1) - math.lgamma(k + 1) - math.lgamma(n - k + 1)


def _pattern(
    quantity: str, unit: str, side: str, ordered: Array, outliers: NDArray[np.bool_], p_value: float
) -> OutlierPattern | None:
    """Return the range that holds most outliers and few other rows; None if it holds most rows."""
    levels = np.sort(ordered[outliers])
    inside = np.array([np.count_nonzero(outliers & (ordered >= level)) for level in levels])
    share = np.array([np.count_nonzero(ordered >= level) for level in levels]) / ordered.size
    best = int(np.argmax(inside / inside.max() - share))
    if share[best] > _MOST_OF_ALL:
        return None
    limit = float(levels[best] if side == "above" else -levels[best])
    return OutlierPattern(
        quantity, side, limit, unit, int(inside[best]), int(inside.max()), float(share[best]), p_value
    )
