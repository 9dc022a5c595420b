"""A fit of a model to measured poses, its settings, and the identifiability of its coefficients."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from robacc.effects.base import Term
from robacc.effects.drivers import Validity
from robacc.fitting.levels import EPSILON, EXAMPLES, FEW, HALF_DIGITS, SETTLED
from robacc.fitting.normal_equations import Whitening, solved
from robacc.geometry import Array, Poses
from robacc.measurements import Measurements
from robacc.modelling.model import Model, Noise

# Identifiability of coefficients on the poses, decided from the Jacobian before any fit.
#
# Columns are scaled to unit length and taken in the catalogue's order; a column that depends on those before it is not
# identifiable. The decision is by orthogonal factorisation with a fixed order and a fixed threshold, so it is the same
# on every run and machine. Observability indices O1 to O5: Sun and Hollerbach 2008.

DEPENDENT = 3e-5
"""A column with an independent part below this share of its length is dependent; a column below this share of the
longest of its unit carries no information. Model and rounding reach 1e-12; registering a target on the last axis from
noisy poses makes up levers of some micrometres, 1e-5 of an arm's reach; the weakest combinations of measured arms lie
above 1e-4."""


@dataclass(frozen=True, slots=True)
class Dropped:
    """A coefficient that is not identifiable on the poses."""

    name: str
    partners: tuple[str, ...]
    """The coefficients that have the same effect; empty if it has no effect at all."""

    @property
    def why(self) -> str:
        """Return the reason, one sentence."""
        if not self.partners:
            return f"{self.name} has no effect on these poses"
        listed = ", ".join(self.partners[:EXAMPLES]) + (" …" if len(self.partners) > EXAMPLES else "")
        together = "" if len(self.partners) == 1 else " together"
        return f"{self.name} is not distinguishable from {listed}{together} on these poses"


@dataclass(frozen=True)
class Identifiability:
    """The identifiable coefficients, and how well the poses determine them."""

    columns: NDArray[np.int64]
    """``(K,)`` numbers of the identifiable coefficients."""
    dropped: tuple[Dropped, ...]
    root: Array
    """``(K, K)`` triangular factor of the columns, scaled to unit length."""
    n_poses: int

    @cached_property
    def singular_values(self) -> Array:
        """Singular values of the scaled columns, descending."""
        return np.asarray(np.linalg.svd(self.root, compute_uv=False), dtype=np.float64)

    @property
    def condition(self) -> float:
        """Condition number of the scaled columns."""
        if self.singular_values.size == 0:
            return 1.0
        return float(self.singular_values[0] / self.singular_values[-1])

    def observability(self) -> dict[str, float]:
        """Return O1 = (prod s)^(1/L)/sqrt(m), O2 = s_L/s_1, O3 = s_L, O4 = s_L^2/s_1, O5 = 1/sum(1/s)."""
        s = self.singular_values
        if s.size == 0:
            return {}
        return {
            "O1": float(np.exp(np.mean(np.log(s))) / np.sqrt(self.n_poses)),
            "O2": float(s[-1] / s[0]),
            "O3": float(s[-1]),
            "O4": float(s[-1] ** 2 / s[0]),
            "O5": float(1.0 / np.sum(1.0 / s)),
        }


def identify_terms(triangle: Array, terms: Sequence[Term], n_poses: int) -> Identifiability:
    """Decide from ``triangle`` ``(R, P)``, any matrix with the Gram matrix of the whitened Jacobian of ``terms``.

    The length of a column is compared with columns of the same unit only. Modified Gram-Schmidt in the order of the
    columns: an independent column takes its direction out of all that follow. Its factor is as exact as Householder's
    (Bjorck 1967), and the directions of dependent columns never enter.
    """
    length = np.sqrt(np.sum(np.square(triangle), axis=0))
    nonzero = length > EPSILON * length.size * float(length.max(initial=0.0))
    units = np.array([term.unit for term in terms], dtype=str)
    for unit in np.unique(units):
        nonzero &= (units != unit) | (length > DEPENDENT * float(length[units == unit].max()))
    remaining = np.asfortranarray(triangle / np.where(nonzero, length, 1.0))
    factor = np.zeros((len(terms), len(terms)))
    columns: list[int] = []
    dropped = []
    for column, term in enumerate(terms):
        vector, count = remaining[:, column], len(columns)
        size = float(np.sqrt(vector @ vector))
        if nonzero[column] and size > max(DEPENDENT, term.least_part):
            shares = vector @ remaining[:, column:] / size
            remaining[:, column:] -= np.outer(vector / size, shares)
            factor[count, column:] = shares
            columns.append(column)
            continue
        shares = np.linalg.solve(factor[:count, columns], nonzero[column] * factor[:count, column])
        largest = np.argsort(-np.abs(shares), kind="stable")
        partners = [terms[columns[i]].name for i in largest if abs(shares[i]) > FEW]
        dropped.append(Dropped(term.name, tuple(partners)))
    root = factor[: len(columns), columns]
    return Identifiability(np.array(columns, dtype=np.int64), tuple(dropped), root, n_poses)


@dataclass(frozen=True, slots=True)
class Options:
    """Settings of a fit."""

    robust: bool = True
    """Leave out outliers."""
    priors: Array | None = None
    """``(P,)`` prior standard deviation of each coefficient about zero; inf or NaN for none, and for the broad prior of
    constants of the arm."""
    misfit: tuple[float, float] | None = None
    """Misfit of position (m) and orientation (rad), if known; else estimated."""
    tolerance: float = HALF_DIGITS
    """Change of the whitened prediction, as a share of the residual, at which a step is the last."""
    start: Array | None = None
    """``(P,)`` coefficients to start from; base and tool are then not registered in closed form first."""
    inliers: NDArray[np.bool_] | None = None
    """``(N,)`` mask of the rows to start from; all rows if None."""
    identified: Identifiability | None = None
    """Identifiable coefficients, if known from a fit of the same model to the same poses."""
    group_stds: Mapping[str, float] = field(default_factory=dict)
    """Prior standard deviations to start from, by group; default: the usual size of the group's terms."""
    scatter: Array | None = None
    """``(J,)`` standard deviation (rad or m) of the joints' scatter, which rows of one visit share; none if None."""
    settled: float = SETTLED
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
    data: Measurements = field(repr=False)
    """Poses of the fit."""
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
    log_prior: float = 0.0
    """Log density of the coefficients under the priors, up to a constant of the model's kind."""
    group_stds: dict[str, float] = field(default_factory=dict)
    """Prior standard deviation of each group, in units of its terms' weights."""
    validity: tuple[Validity, ...] = ()
    """Range of the drivers of each free effect over the poses."""

    @property
    def poses(self) -> Poses:
        """Return the predicted poses of all rows."""
        return self.model.bind(self.data).poses(self.theta)

    def without(self, effects: Collection[int]) -> Array:
        """Return ``(P,)`` the fit's coefficients without some free effects, to first order."""
        if not effects:
            return self.theta
        columns = self.identifiability.columns
        remaining = np.array([self.owners[i] not in effects for i in columns], dtype=bool)
        theta, normal = np.zeros_like(self.theta), self.gram + np.diag(self.precision)
        theta[columns[remaining]] = solved(normal[np.ix_(remaining, remaining)], self.rhs[remaining])
        return theta

    def jacobian(self, rows: NDArray[np.int64], components: int = 6) -> Array:
        """Return ``(components, K, n)`` the Jacobian of the identifiable coefficients at some rows of the poses."""
        bound = self.model.bind(self.data.subset(rows))
        return bound.linearise(self.theta, self.identifiability.columns, components)[1]

    def predict(self, data: Measurements, theta: Array | None = None) -> Poses:
        """Return the poses that the written model predicts: beyond their validity range, effects are held.

        ``theta`` ``(P,)`` replaces the fitted coefficients.
        """
        return self.model.bind(data, self.validity).poses(self.theta if theta is None else theta)

    @property
    def outliers(self) -> NDArray[np.int64]:
        """Return the numbers of the outliers."""
        return np.flatnonzero(~self.inliers)


def with_covariance(fit: Fit, covariance: Array) -> Fit:
    """Return the fit with ``covariance`` ``(K, K)`` of its K identifiable coefficients."""
    columns = fit.identifiability.columns
    whole = fit.covariance.copy()
    whole[np.ix_(columns, columns)] = covariance
    return dataclasses.replace(fit, covariance=whole)
