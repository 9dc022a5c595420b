"""Tests of every pair of results, corrected for their number, and groups of results that do not differ.

Sources: S. Holm, "A simple sequentially rejective multiple test procedure", Scandinavian Journal of Statistics 6
(1979) 65-70; H.-P. Piepho, "An algorithm for a letter-based representation of all-pairwise comparisons", Journal of
Computational and Graphical Statistics 13 (2004) 456-466 (insert and absorb).
"""

from __future__ import annotations

from collections.abc import Sequence, Set

from robacc.comparison.differences import Difference


def holm(p_values: Sequence[float | None]) -> list[float | None]:
    """Return p-values corrected for their number, which bounds the probability of any false difference.

    None stands for a pair without a test, stays None and does not count.
    """
    tested = sorted((p, i) for i, p in enumerate(p_values) if p is not None)
    corrected: list[float | None] = [None] * len(p_values)
    largest = 0.0
    for rank, (p, i) in enumerate(tested):
        largest = max(largest, min(1.0, (len(tested) - rank) * p))
        corrected[i] = largest
    return corrected


def indistinguishable_groups(count: int, different: Set[tuple[int, int]]) -> list[tuple[int, ...]]:
    """Return the largest groups of ``count`` members without a pair of ``different`` (first index below the second).

    Members with a common group do not differ; members without a common group do. The group of the first member comes
    first.
    """
    groups: list[frozenset[int]] = [frozenset(range(count))]
    for first, second in sorted(different):
        split: list[frozenset[int]] = []
        for group in groups:
            if first in group and second in group:
                split += [group - {second}, group - {first}]
            else:
                split.append(group)
        groups = [group for group in dict.fromkeys(split) if not any(group < other for other in split)]
    return sorted(tuple(sorted(group)) for group in groups)


def group_letters(count: int, groups: Sequence[tuple[int, ...]]) -> list[str]:
    """Return the letters of each member: a for the first group, b for the second …; past z, a1, b1 …."""
    names = [chr(ord("a") + i % 26) + (str(i // 26) if i >= 26 else "") for i in range(len(groups))]
    return ["".join(name for name, group in zip(names, groups, strict=True) if i in group) for i in range(count)]


def significant_pairs(
    pairs: Sequence[tuple[int, int, Difference]], level: float
) -> tuple[list[float | None], set[tuple[int, int]]]:
    """Return the corrected p-value of each pair, and the pairs that differ at ``level``."""
    corrected = holm([difference.p_value for _, _, difference in pairs])
    different = {
        (min(i, j), max(i, j)) for (i, j, _), p in zip(pairs, corrected, strict=True) if p is not None and p < level
    }
    return corrected, different
