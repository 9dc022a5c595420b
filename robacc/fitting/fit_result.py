"""A fit of a model to measured poses, and the settings that it is made with."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from robacc.effects.base import Term
from robacc.effects.validity import Validity
from robacc.fitting.identifiability import Dropped, Identifiability
from robacc.fitting.linear_algebra import solved
from robacc.fitting.whitening import Whitening
from robacc.geometry import Array, Poses
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.modelling.observation import Noise


@dataclass(frozen=True, slots=True)
class Options:
    """Settings of a fit."""

    robust: bool = True
    """Leave out outliers."""
    priors: Array | None = None
    """``(P,)`` prior standard deviation of each coefficient about zero; inf or NaN for none."""
    misfit: tuple[float, float] | None = None
    """Misfit of position (m) and orientation (rad), if known; else estimated."""
    tolerance: float = 1e-8
    """Change of the whitened prediction, as a share of the residual, at which a step is the last."""
    start: Array | None = None
    """``(P,)`` coefficients to start from; base and tool are then not registered in closed form first."""
    inliers: NDArray[np.bool_] | None = None
    """``(N,)`` mask of the rows to start from; all rows if None."""
    group_stds: Mapping[str, float] = field(default_factory=dict)
    """Prior standard deviations to start from, by group; default: the usual size of the group's terms."""
    prior_stds: Mapping[str, float] = field(default_factory=dict)
    """Prior standard deviations (m or rad) of kinds of constants to start from, by kind."""
    scatter: Array | None = None
    """``(J,)`` standard deviation (rad or m) of the joints' scatter, which rows of one visit share; none if None."""
    settled: float = 1e-3
    """Change of the misfits, as a share, at which the fit ends (ten times it for the groups' priors)."""


@dataclass(frozen=True)
class Fit:
    """A fitted model."""

    model: Model
    """The model with base and tool registered: coefficients are relative to its robot."""
    names: tuple[str, ...]
    terms: tuple[Term, ...]
    owners: tuple[int, ...]
    """Number of each coefficient's effect among the model's free ones."""
    theta: Array
    """``(P,)`` coefficients; zero if not identifiable."""
    covariance: Array
    """``(P, P)`` covariance; NaN for coefficients that are not identifiable."""
    identifiability: Identifiability
    noise: Noise
    misfit: tuple[float, float]
    inliers: NDArray[np.bool_]
    """``(N,)`` mask of the rows that are not outliers."""
    poses: Poses
    """Predicted poses of all rows."""
    residual: Array
    """``(M, N)`` residuals of all rows."""
    weight: Array
    """``(M, N)`` reciprocal standard deviation of each component, correlations aside."""
    whitening: Whitening
    """Map that gives the residuals of all rows unit covariance."""
    scatter: Array | None
    """``(J,)`` scatter of the joints in the weights, rad or m; None without."""
    chi_square: float
    """Sum of whitened squares over the inliers."""
    degrees_of_freedom: float
    """Components of the inliers less effective coefficients."""
    steps: int
    converged: bool
    """False if the last iteration ended before its steps were short."""
    gram: Array
    """``(K, K)`` whitened normal matrix of the identifiable coefficients, without priors."""
    rhs: Array
    """``(K,)`` right-hand side of the normal equations: ``(gram + precision) theta = rhs`` at the solution."""
    precision: Array
    """``(K,)`` prior precision."""
    group_stds: dict[str, float] = field(default_factory=dict)
    """Prior standard deviation of each group, in units of its terms' weights."""
    validity: tuple[Validity, ...] = ()
    """Range of the drivers of each free effect over the poses."""
    prior_stds: dict[str, float] = field(default_factory=dict)
    """Estimated prior standard deviation about nominal (m or rad) of each kind of constants that has one."""
    weak: tuple[str, ...] = ()
    """Names of the weakly identifiable constants, for which the kinds have a prior."""

    @property
    def dropped(self) -> tuple[Dropped, ...]:
        """Return the coefficients that are not identifiable."""
        return self.identifiability.dropped

    def without(self, effects: Collection[int]) -> Array:
        """Return ``(P,)`` the fit's coefficients without some free effects, to first order."""
        columns = self.identifiability.columns
        remaining = np.array([self.owners[i] not in effects for i in columns], dtype=bool)
        theta = np.zeros_like(self.theta)
        matrix = (self.gram + np.diag(self.precision))[np.ix_(remaining, remaining)]
        scale = 1.0 / np.sqrt(np.diag(matrix))
        theta[columns[remaining]] = scale * solved(matrix * scale[:, None] * scale, scale * self.rhs[remaining])
        return theta

    def predict(self, data: Measurements, theta: Array | None = None) -> Poses:
        """Return the poses that the written model predicts: beyond their validity range, effects are held.

        ``theta`` ``(P,)`` replaces the fitted coefficients.
        """
        return self.model.bind(data, self.validity).poses(self.theta if theta is None else theta)

    @property
    def outliers(self) -> NDArray[np.int64]:
        """Return the numbers of the outliers."""
        return np.flatnonzero(~self.inliers)
