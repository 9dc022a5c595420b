"""Choice of effects on one linearisation: named effects first, or corrections together with them from the start."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from robacc.effects.base import Effect
from robacc.tracing.candidate_pool import SELECTION_POSES
from robacc.tracing.linearised_candidates import LinearisedCandidates
from robacc.tracing.selection import FALSE_ALARM, MOST_FINDINGS, Selection

_BETTER = 10.0
"""Evidence (log Bayes factor) by which a selection with a correction must beat the named one (odds of 20,000 to 1)."""
_MANY = 3
"""Named findings from which a correction is tried in place of them even if they leave no structure."""


def choose(
    candidates: LinearisedCandidates,
    rows: NDArray[np.bool_],
    start: Sequence[Effect] = (),
    empirical: bool = True,
    max_poses: int = SELECTION_POSES,
    most: int = MOST_FINDINGS,
    named_first: bool | None = None,
    level: float = FALSE_ALARM,
    known: Sequence[Effect] = (),
) -> Selection:
    """Select named effects first; if they leave structure or are many, select corrections too and return the better.

    A selection of ``most`` named effects is returned as it is. ``named_first`` gives the order of an earlier selection
    (:attr:`Selection.named_first`): only that order is tried. ``level`` is the corrected p-value of a finding. If the
    named findings are ``known``, those of an earlier selection that tried other sets, no other sets are tried.
    """
    if named_first is False and empirical and not start:
        mixed = candidates.selection(rows, start, max_poses)
        mixed.scorer.blocks = candidates.batches(rows, max_poses)
        mixed.named_first, mixed.level = False, level
        mixed.run(with_blocks=True)
        return mixed
    named = candidates.selection(rows, start, max_poses)
    named.most, named.level, named.known = most, level, tuple(known)
    named.prune()
    blocks = candidates.batches(rows, max_poses) if empirical else []
    named.scorer.blocks = blocks
    if any(choice.candidate.is_correction for choice in named.chosen):
        named.run(with_blocks=True)
        return named
    named.run()
    if not blocks or MOST_FINDINGS > most <= len(named.chosen):
        return named
    remaining = named.rank(with_blocks=True)
    structured = bool(remaining) and remaining[0].p_value <= level
    if structured and named_first:
        named.run(with_blocks=True)
    if named_first or (not structured and (len(named.chosen) < _MANY or named.is_known())):
        return named
    mixed = Selection(named.scorer, level=level, named_first=False)
    mixed.run(with_blocks=True)
    if structured:
        named.run(with_blocks=True)
    return mixed if mixed.total() > named.total() + (0.0 if structured else _BETTER) else named
