"""Candidates in a model, and the scores of candidates beside it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.geometry import Array
from robacc.tracing.candidates import Candidate


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
    evidence: float
    log_prior: float
    p_value: float
    """Corrected for the number of candidates."""
    gain: float
    prior_var: float

    @property
    def total(self) -> float:
        """Log posterior odds, up to a constant."""
        return self.evidence + self.log_prior
