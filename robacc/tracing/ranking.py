"""Candidates in a model, and the scores of candidates given it."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from robacc.geometry import Array
from robacc.tracing.candidates import Candidate
from robacc.tracing.evidence import Scores

_LEAST_EVIDENCE = 2.0
"""Evidence (log Bayes factor) below which no significance test is made."""


@dataclass(frozen=True, eq=False)
class Chosen:
    """A candidate in the model, with the numbers of its columns in the system."""

    candidate: Candidate
    columns: NDArray[np.int64]
    precision: Array


@dataclass(frozen=True)
class Ranked:
    """A candidate's score at one step."""

    candidate: Candidate
    scores: Scores
    """Scores of the candidates that it was scored with."""
    number: int
    """Its number among them."""
    handicap: float = 0.0
    """Log prior odds against implausible coefficients."""

    @property
    def evidence(self) -> float:
        """Return the log Bayes factor."""
        return float(self.scores.evidence[self.number])

    @property
    def is_tested(self) -> bool:
        """Return whether there is evidence enough for a test of significance."""
        return bool(self.scores.evidence[self.number] > _LEAST_EVIDENCE)

    @property
    def gain(self) -> float:
        """Return the whitened sum of squares that least squares explains."""
        return float(self.scores.gain[self.number])

    @property
    def prior_var(self) -> float:
        """Return the prior variance of largest evidence."""
        return float(self.scores.prior_var[self.number])

    @property
    def log_prior(self) -> float:
        """Return the log prior odds, less the handicap."""
        return self.candidate.log_prior - self.handicap

    @cached_property
    def p_value(self) -> float:
        """Significance, corrected for the number of candidates; 1 if there is hardly any evidence."""
        return self.p_value_beside(1.0)

    def p_value_beside(self, inflation: float) -> float:
        """Return the significance if the coefficients' variance is ``inflation`` times that of independent errors."""
        if not self.is_tested:
            return 1.0
        corrected = min(1.0, self.scores.p_value(self.number, inflation) * math.exp(-self.candidate.log_prior))
        if not self.handicap:
            return corrected
        return math.exp(min(0.0, math.log(max(corrected, 1e-300)) + self.handicap))

    @property
    def total(self) -> float:
        """Return the log posterior odds, up to a constant."""
        return float(self.scores.evidence[self.number]) + self.candidate.log_prior - self.handicap


def sorted_by_odds(ranked: Iterable[Ranked]) -> list[Ranked]:
    """Return scores, best first.

    If two candidates explain exactly the same, rounding (and so the order of rows) must not choose between them.
    """
    entries = list(ranked)
    order = np.argsort(-np.round([entry.total for entry in entries], 6), kind="stable")
    return [entries[i] for i in order.tolist()]
