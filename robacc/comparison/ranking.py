"""Who is better, as far as the data tell: every pair tested, corrected for their number, and groups that overlap.

Sources: S. Holm, "A simple sequentially rejective multiple test procedure", Scandinavian Journal of Statistics 6
(1979) 65-70; H.-P. Piepho, "An algorithm for a letter-based representation of all-pairwise comparisons", Journal of
Computational and Graphical Statistics 13 (2004) 456-466 (insert and absorb).
"""

from __future__ import annotations

from collections.abc import Sequence, Set

from robacc.comparison.differences import Difference


def holm(p_values: Sequence[float | None]) -> list[float | None]:
    """p-values corrected for their number, in their order: the chance of any false difference among all stays below.

    None, which is no test, stays None and counts for nothing.
    """
    tested = sorted((p, i) for i, p in enumerate(p_values) if p is not None)
    corrected: list[float | None] = [None] * len(p_values)
    largest = 0.0
    for rank, (p, i) in enumerate(tested):
        largest = max(largest, min(1.0, (len(tested) - rank) * p))
        corrected[i] = largest
    return corrected


def groups(count: int, different: Set[tuple[int, int]]) -> list[tuple[int, ...]]:
    """The largest groups of ``count`` members that hold no pair of ``different`` (first index below the second).

    Members that share a group cannot be told apart; those that share none are different. The group of the first
    member comes first.
    """
    found: list[frozenset[int]] = [frozenset(range(count))]
    for first, second in sorted(different):
        split: list[frozenset[int]] = []
        for group in found:
            if first in group and second in group:
                split += [group - {second}, group - {first}]
            else:
                split.append(group)
        found = [one for one in dict.fromkeys(split) if not any(one < other for other in split)]
    return sorted(tuple(sorted(group)) for group in found)


def letters(count: int, found: Sequence[tuple[int, ...]]) -> list[str]:
    """The letters of each member: a for the first group, b for the second …; past z, a1, b1 …."""
    names = [chr(ord("a") + i % 26) + (str(i // 26) if i >= 26 else "") for i in range(len(found))]
    return ["".join(name for name, group in zip(names, found, strict=True) if i in group) for i in range(count)]


def decided(
    pairs: Sequence[tuple[int, int, Difference]], level: float
) -> tuple[list[float | None], set[tuple[int, int]]]:
    """The corrected p-value of each pair, and the pairs that are different at ``level``."""
    corrected = holm([one.p_value for _, _, one in pairs])
    different = {
        (min(i, j), max(i, j)) for (i, j, _), p in zip(pairs, corrected, strict=True) if p is not None and p < level
    }
    return corrected, different
