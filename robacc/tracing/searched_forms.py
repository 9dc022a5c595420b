"""Forms of effects with a searched parameter (an order, the place of a step, an instrument's place), scored together.

Each form is a family of candidates, one for each value of the parameter. Of each form only the best value competes.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from robacc.geometry import Array
from robacc.tracing.candidates import Candidate, EffectName
from robacc.tracing.conditioned_columns import Conditioned, Family
from robacc.tracing.ranking import Ranked


@dataclass(frozen=True, eq=False)
class SearchedForm:
    """A form of an effect."""

    family: Family
    """Candidates at B values of the parameter."""
    candidate: Callable[[int], Candidate]
    """Function that returns the candidate of a number from 0 to B - 1."""

    @property
    def effect_name(self) -> EffectName:
        """Return the name and the joints of the effect."""
        return self.candidate(0).effect_name

    def best_allowed(self, conditioned: Conditioned, is_excluded: Callable[[Candidate], bool]) -> Ranked | None:
        """Return the best candidate that is not excluded, given a model; None if all are."""
        scores = self.family.judge(conditioned)
        for number in np.argsort(-scores.evidence, kind="stable").tolist():
            candidate = self.candidate(number)
            if not is_excluded(candidate):
                return Ranked(candidate, scores, number)
        return None


class _Union(Family):
    """Candidates of several families with equally many columns each."""

    def __init__(self, parts: Sequence[Family]) -> None:
        self._parts = parts
        self.shrunk = parts[0].shrunk
        self.gram = np.concatenate([part.gram for part in parts])
        self.rhs = np.concatenate([part.rhs for part in parts])
        self._store_none(self.rhs.size)

    def new_products(self, columns: Array) -> Array:
        """Return ``(A, B Q)`` products of ``columns`` ``(M, A, N)`` with every column of all families."""
        return np.concatenate([part.new_products(columns) for part in self._parts], axis=1)


@dataclass(frozen=True, eq=False)
class _FormBatch:
    """Forms with equally many columns."""

    numbers: tuple[int, ...]
    union: _Union
    groups: tuple[slice, ...]
    """Candidates of each form in the union."""


class SearchedForms:
    """Several forms; those with equally many columns are scored at once."""

    def __init__(self, forms: Sequence[SearchedForm]) -> None:
        """Join the families of equal size."""
        self._forms = forms
        by_size: dict[int, list[int]] = {}
        for number, form in enumerate(forms):
            by_size.setdefault(form.family.rhs.shape[1], []).append(number)
        self._batches = []
        for numbers in by_size.values():
            families = [forms[number].family for number in numbers]
            ends = np.cumsum([len(family.rhs) for family in families]).tolist()
            groups = tuple(slice(end - len(family.rhs), end) for end, family in zip(ends, families, strict=True))
            self._batches.append(_FormBatch(tuple(numbers), _Union(families), groups))

    def best(
        self,
        conditioned: Conditioned,
        is_excluded: Callable[[Candidate], bool] = lambda candidate: False,
        is_absent: Callable[[SearchedForm], bool] = lambda form: False,
    ) -> list[Ranked]:
        """Return the best candidate of each form given a model, of those that are not excluded.

        Forms that are scored together are left out if all of them are absent.
        """
        ranked: dict[int, Ranked] = {}
        for batch in self._batches:
            if all(is_absent(self._forms[number]) for number in batch.numbers):
                continue
            scores = batch.union.judge(conditioned, batch.groups)
            for number, group in zip(batch.numbers, batch.groups, strict=True):
                best = int(np.argmax(scores.evidence[group]))
                entry = Ranked(self._forms[number].candidate(best), scores, group.start + best)
                if not is_excluded(entry.candidate):
                    ranked[number] = entry
                elif (allowed := self._forms[number].best_allowed(conditioned, is_excluded)) is not None:
                    ranked[number] = allowed
        return [ranked[number] for number in sorted(ranked)]
