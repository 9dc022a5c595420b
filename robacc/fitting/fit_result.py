"""A fit of a model to poses, its settings, the identifiability of its coefficients, and errors of held-out poses."""

import dataclasses
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from robacc.effects.base import Term
from robacc.effects.drivers import Validity
from robacc.errors import RobaccError
from robacc.fitting.levels import BLOCK_NUMBERS, DEPENDENT, EPSILON, EXAMPLES, FEW, NEW
from robacc.fitting.normal_equations import Whitening, blocks_of, posterior, solved
from robacc.fitting.visits import LEAST_PLACES, places
from robacc.geometry import Array, NDArray, Poses, compose, exp_so3
from robacc.measurements import Measurements, different
from robacc.modelling.model import Model, Noise, observed_jacobian, residuals

# Identifiability of coefficients on the poses, decided from the Jacobian before any fit.
#
# Columns are scaled to unit length and taken in the catalogue's order; a column that depends on those before it is not
# identifiable. The decision is by orthogonal factorisation with a fixed order and a fixed threshold, so it is the same
# on every run and machine. Observability indices O1 to O5: Sun and Hollerbach 2008.


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
        return float(self.singular_values[0] / self.singular_values[-1]) if self.singular_values.size else 1.0

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

    def information(self) -> dict[str, float]:
        """Return how many coefficients each kind of measurement determines, where there are several kinds.

        They are the traces of the kinds' parts of the normal matrix times the covariance under the priors: together
        the coefficients less what the priors determine, the effective number of parameters (MacKay 1992).
        """
        kinds = self.data.kind
        if kinds is None or not (kinds != kinds[0]).any():
            return {}
        rows = np.arange(self.data.n)
        white = self.whitening.rows(self.jacobian(rows, len(self.residual)), self.residual)[:, :-1] * self.inliers
        each = np.sum(white * (posterior(self.gram, self.precision) @ white), axis=(0, 1))
        return {str(kind): float(each[kinds == kind].sum()) for kind in np.unique(kinds)}

    def predict(self, data: Measurements, theta: Array | None = None) -> Poses:
        """Return the poses that the written model predicts: beyond their validity range, effects are held.

        ``theta`` ``(P,)`` replaces the fitted coefficients.
        """
        return self.model.bind(data, self.validity).poses(self.theta if theta is None else theta)

    @property
    def determined(self) -> float:
        """How many coefficients the poses determine, not the priors."""
        return self.data.count(self.inliers) - self.degrees_of_freedom

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


# Errors of held-out poses in closed form: each place in turn is predicted by the fit to all other places.
#
# With A_g the whitened Jacobian of the rows g, N = A'A + P (P the precision of the priors) and r_g the whitened
# residual of the fit to all rows, the coefficients without these rows differ, to first order, by
#
#     -(N - A_g'A_g)^-1 A_g'r_g = -N^-1 A_g'(I - H_gg)^-1 r_g,    H_gg = A_g N^-1 A_g'.
#
# Source: R. D. Cook, S. Weisberg, Residuals and Influence in Regression (1982), 2.2 and appendix A.2. Weights, outliers
# and the variances of priors are those of the fit to all rows.


@dataclass(frozen=True)
class HoldOut:
    """Poses that fits to ``data`` are judged on: validation poses, or places of its own poses in turn."""

    data: Measurements
    validation: Measurements | None
    groups: NDArray[np.int64]
    """``(N,)`` number of the places that are held out together."""

    @classmethod
    def of(cls, data: Measurements, validation: Measurements | None, count: int | None, seed: int) -> "HoldOut":
        """Hold out ``validation``, or each place of ``data`` in turn, or ``count`` parts of the places.

        A place's part depends on the place and the seed, not on the order of rows.
        """
        groups = places(data)
        total = int(groups.max(initial=-1)) + 1
        if count is not None and total:
            groups = (np.random.default_rng(seed).permutation(total) % min(count, total)).astype(np.int64)[groups]
        return cls(data, validation, groups)

    @cached_property
    def folds(self) -> int:
        """Number of groups that are held out in turn; 0 with validation poses, or where places are too few."""
        are_enough = self.validation is None and different(places(self.data)) >= LEAST_PLACES
        return different(self.groups) if are_enough else 0

    def share(self, fit: Fit) -> float:
        """Return how many poses of their own tell the error of ``fit`` elsewhere as well, as a share of its places.

        1 with validation poses. Of N numbers measured, each point of a place once, K are used by the coefficients.
        The mean of held-out squares is that of N - K independent ones; and it is independent of the coefficients' own
        error, which this fit has elsewhere and which adds K / N^2 to its relative variance of 1 / (N - K), in halves.
        """
        if self.validation is not None:
            return 1.0
        once = np.zeros(self.data.n, dtype=bool)
        once[np.unique(self.data.points(places(self.data)), return_index=True)[1]] = True
        used = fit.determined / self.data.count(once)
        return 1.0 / (1.0 / (1.0 - used) + used) if used < 1.0 else 0.0

    def residuals(self, fit: Fit, lacking: Sequence[Collection[int]] = ((),)) -> list[Array | None]:
        """Return ``(M, N)`` residuals of the held-out poses by ``fit``, and by models that lack some of its effects.

        None where nothing can be held out, or the arm without the effects has no equilibrium at the validation poses.

        Args:
            fit: Fit to ``data``.
            lacking: Numbers of the absent effects of each model, among the free ones; the rest is fitted again.
        """
        if self.validation is not None:
            return [_residuals(fit, self.validation, fit.without(absent)) for absent in lacking]
        if not self.folds:
            return [None for _ in lacking]
        poses = held_out_poses(fit, self.data, self.groups, lacking, components=fit.residual.shape[0])
        return [residuals(self.data, predicted) for predicted in poses]


def _residuals(fit: Fit, data: Measurements, theta: Array) -> Array | None:
    """Return the residuals of a fit with other coefficients; None if the arm has no equilibrium with them."""
    try:
        return residuals(data, fit.predict(data, theta))
    except RobaccError:
        return None


def held_out_poses(
    fit: Fit,
    data: Measurements,
    groups: NDArray[np.int64],
    lacking: Sequence[Collection[int]] = ((),),
    undetermined: Callable[[NDArray[np.int64]], None] = lambda rows: None,
    components: int = 6,
) -> list[Poses]:
    """Predict each row ``(N)`` with the coefficients of the fit to the rows of the other groups, to first order.

    A combination of coefficients that the other groups do not determine keeps its nominal value. A model without
    effects is the fit in scaled coefficients, of normal matrix I, that are orthogonal to a few directions.

    Args:
        fit: Fit to ``data``.
        data: Poses of the fit.
        groups: ``(N,)`` number of each row's group.
        lacking: Numbers of the absent effects of each model, among the free ones.
        undetermined: Called with the rows of a group that alone determines a coefficient.
        components: 6 for poses, 3 for positions alone.

    Returns:
        The poses by each model.
    """
    from scipy.linalg import solve_triangular

    columns = fit.identifiability.columns
    size, rows_of = columns.size, fit.residual.shape[0]
    own = fit.poses if components == 6 else Poses(np.empty((3, 3, 0)), data.position - fit.residual[:3])
    poses = [Poses(own.rotation.copy(), own.translation.copy()) for _ in lacking]
    if not size:
        return poses
    most = 4 * BLOCK_NUMBERS // (rows_of * size)
    blocks = _whole_groups(groups, max(data.n if data.n <= most else most // 4, 1))

    def whitened(jacobian: Array, rows: NDArray[np.int64]) -> Array:
        """Return the whitened Jacobian of the inliers ``(K, M, n)``, from that of the poses ``(C, K, n)``."""
        white = fit.whitening.subset(rows).apply(observed_jacobian(jacobian, fit.residual[:, rows]).swapaxes(0, 1))
        white *= fit.inliers[rows]
        return white

    # The fit's own normal matrix is that of the step before the last.
    normal: Array = np.diag(fit.precision)
    latest = np.empty((0, 0, 0))
    for rows in blocks:
        latest = fit.jacobian(rows, components)
        white = whitened(latest, rows).reshape(size, -1)
        normal = normal + white @ white.T
    scale = 1.0 / np.sqrt(np.diag(normal))
    lower = np.linalg.cholesky(scale[:, None] * normal * scale)
    models = []
    for absent, predicted in zip(lacking, poses, strict=True):
        is_absent = np.array([fit.owners[i] in absent for i in columns], dtype=bool)
        directions = np.linalg.qr(solve_triangular(lower, np.diag(scale)[:, is_absent], lower=True))[0]
        left = fit.without(absent)
        whole, lost = (lower.T @ (theta[columns] / scale) for theta in (left, left - fit.theta))
        models.append((predicted, directions, whole, lost))
    for rows in blocks:
        # Of (n, C, K) and (n, M, K), in coefficients whose normal matrix is I.
        jacobian = (latest if len(blocks) == 1 else fit.jacobian(rows, components)).swapaxes(0, 1)
        flat = np.multiply(jacobian, scale[:, None, None], order="C").reshape(size, -1)
        solved_for = solve_triangular(lower, flat, lower=True, check_finite=False).reshape(jacobian.shape)
        observed = np.ascontiguousarray(whitened(solved_for.swapaxes(0, 1), rows).transpose(2, 1, 0))
        scaled = np.ascontiguousarray(solved_for.transpose(2, 1, 0))
        of_block, pieces = fit.whitening.subset(rows), 1 + 8 * flat.size // BLOCK_NUMBERS
        inside_groups = [
            piece for alike in blocks_of(groups[rows]) for piece in np.array_split(alike, min(pieces, len(alike)))
        ]
        white = (of_block.apply(fit.residual[:, rows]) * fit.inliers[rows]).T
        for predicted, directions, whole, lost in models:
            for inside in inside_groups:
                error = white[inside] - observed[inside] @ lost
                change, alone = _changes(scaled[inside], observed[inside], error, directions, whole)
                change += np.reshape(scaled[inside] @ lost, change.shape)
                for group in alone:
                    undetermined(rows[inside[group]])
                moved, at = change.reshape(-1, components).T, rows[inside.ravel()]
                predicted.translation[:, at] += moved[:3]
                if components == 6:
                    predicted.rotation[..., at] = compose(exp_so3(moved[3:]), predicted.rotation[..., at])
    return poses


def _whole_groups(numbers: NDArray[np.int64], size: int) -> list[NDArray[np.int64]]:
    """Return the rows in blocks of about ``size`` rows that leave rows with equal numbers together.

    Numbers come in the order of their first rows, so that a block's rows lie close together.
    """
    first = np.empty(int(numbers.max(initial=-1)) + 1, dtype=np.int64)
    first[numbers[::-1]] = np.arange(numbers.size)[::-1]
    order = np.argsort(first[numbers], kind="stable")
    last = np.flatnonzero(np.diff(numbers[order], append=-1)) + 1
    ends = np.minimum(np.arange(size, numbers.size + size, size), numbers.size)
    return np.split(order, np.unique(last[np.searchsorted(last, ends)])[:-1])


def _changes(poses: Array, columns: Array, white: Array, directions: Array, whole: Array) -> tuple[Array, list[int]]:
    """Return the change of each group's poses without the group, and the groups that alone determine a coefficient.

    Coefficients are scaled so that their normal matrix is I.

    Args:
        poses: ``(G, m, C, K)`` Jacobian of the poses of the m rows of each group.
        columns: ``(G, m, M, K)`` whitened Jacobian of the measurements.
        white: ``(G, m, M)`` whitened residuals.
        directions: ``(K, L)`` orthonormal combinations of the coefficients, which the model lacks.
        whole: ``(K,)`` coefficients of the fit to all rows.

    Returns:
        ``(G, m C)`` changes, and numbers of groups.
    """
    count, size = len(columns), whole.size
    moved, jacobian, residual = (each.reshape(count, -1, each.shape[-1]) for each in (poses, columns, white[..., None]))
    lacking = [
        np.reshape(each.reshape(-1, size) @ directions, (*each.shape[:2], directions.shape[1]))
        for each in (moved, jacobian)
    ]
    across = jacobian.swapaxes(1, 2)
    # Right singular vectors, or those times the singular values, by the smaller of the two products.
    if jacobian.shape[1] < size:
        share, vectors = np.linalg.eigh(jacobian @ across - lacking[1] @ lacking[1].swapaxes(1, 2))
        moved = (moved @ across - lacking[0] @ lacking[1].swapaxes(1, 2)) @ vectors
        known = jacobian @ whole - lacking[1] @ (directions.T @ whole)
        along, known = vectors.swapaxes(1, 2) @ residual, vectors.swapaxes(1, 2) @ known[..., None]
    else:
        jacobian = jacobian - lacking[1] @ directions.T
        across = jacobian.swapaxes(1, 2)
        share, vectors = np.linalg.eigh(across @ jacobian)
        moved = moved @ vectors
        along, known = vectors.swapaxes(1, 2) @ (across @ residual), vectors.swapaxes(1, 2) @ whole[:, None]
    alone = (1.0 - share < NEW)[:, :, None]
    left = np.where(alone, known, along / np.where(alone, 1.0, 1.0 - share[:, :, None]))
    return -(moved @ left)[..., 0], np.flatnonzero(alone.any(axis=(1, 2))).tolist()
