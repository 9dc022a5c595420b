"""Candidates that a finding makes redundant: the same effect, or orders of a joint's complete profile.

Each answer is kept, because a selection asks for it after each step.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from robacc.tracing.candidates import Candidate
from robacc.tracing.searched_forms import SearchedForm

_Key = tuple[object, ...]


class Redundancy:
    """Redundancy of candidates on the poses of one selection."""

    def __init__(self, pool: Sequence[Candidate], ranges: Mapping[str, float]) -> None:
        """Store the candidates of the pool and the measured range of each joint."""
        self._pool, self._ranges = pool, ranges
        self._covered: dict[tuple[_Key, _Key], bool] = {}
        self._keys: dict[_Key, frozenset[_Key]] = {}
        self._forms: dict[tuple[_Key, SearchedForm], bool] = {}

    def covers(self, present: Candidate, other: Candidate) -> bool:
        """Return whether a candidate in the model makes another candidate redundant."""
        pair = present.key, other.key
        if pair not in self._covered:
            self._covered[pair] = present.covers(other, self._ranges)
        return self._covered[pair]

    def is_covered(self, candidate: Candidate, by: Iterable[Candidate]) -> bool:
        """Return whether one of the candidates ``by`` in the model makes ``candidate`` redundant."""
        return any(self.covers(present, candidate) for present in by)

    def keys_covered_by(self, present: Candidate) -> frozenset[_Key]:
        """Return the keys of the pool's candidates that a candidate in the model makes redundant."""
        if present.key not in self._keys:
            self._keys[present.key] = frozenset(c.key for c in self._pool if self.covers(present, c))
        return self._keys[present.key]

    def covers_form(self, present: Candidate, form: SearchedForm) -> bool:
        """Return whether a candidate in the model makes all candidates of a form redundant."""
        pair = present.key, form
        if pair not in self._forms:
            numbers = range(len(form.family.rhs))
            self._forms[pair] = all(self.covers(present, form.candidate(number)) for number in numbers)
        return self._forms[pair]
