"""Covariance of all rows: its likelihood with gradient, its restricted maximum likelihood, and gross errors.

The residuals y of N rows of M components are

    y = X b + e,    b ~ N(0, S),    e ~ N(0, V),    V = D + sum of the terms' F_c K_c F_c',

with D the independent noise. The log marginal likelihood is -(log|V| + log|I + Q'Q| + y'P y) / 2, with Q the whitened
columns of X times S^(1/2); with S broad it is the restricted likelihood (Rasmussen and Williams 2006, section 2.7). Its
derivative by a parameter t is tr((a a' - P) dV/dt) / 2 with a = P y (section 5.4.1), where P is the inverse of
V + X S X'.

Inside, vectors of all rows are ordered component by component, so that kernels are added to whole blocks.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.linalg.lapack import dpotrf, dpotri, dpotrs
from scipy.special import bdtrc

from robacc.error_model.terms import TERMS, Carried, Linearised
from robacc.fitting.visits import first_ranks
from robacc.geometry import Array


@dataclass(frozen=True, eq=False)
class CovarianceParameters:
    """Parameters of the covariance."""

    log_std: Array
    """Log standard deviation of independent noise beyond what the file states: ``(1,)`` of position, m, ``(2,)`` of
    position and orientation, rad; ``(3,)`` or ``(4,)`` where x, y and z have their own."""
    factor: Array
    """``(N,)`` factor on the standard deviation of each row: above 1 for gross errors."""
    terms: dict[str, Array] = dataclasses.field(default_factory=dict)
    """Parameters of the terms in the covariance, by name."""

    @property
    def std(self) -> Array:
        """Standard deviations of the noise, m and rad."""
        return np.exp(self.log_std)

    @property
    def has_axes(self) -> bool:
        """Return whether x, y and z have noise of their own."""
        return len(self.log_std) > 2

    def kinds(self, components: int) -> NDArray[np.int64]:
        """Return ``(M,)`` the number of the standard deviation of each component."""
        return np.minimum(np.arange(components) // (1 if self.has_axes else 3), len(self.log_std) - 1)

    def own_variance(self, components: int) -> Array:
        """Return ``(N, M)`` variances of the noise beyond what the file states."""
        return np.asarray(np.square(self.std[self.kinds(components)]) * np.square(self.factor)[:, None])

    def by_kind(self, values: Array) -> Array:
        """Return the sums of ``values`` ``(N, M)`` over the rows and the components of each standard deviation."""
        return np.bincount(self.kinds(values.shape[1]), weights=values.sum(axis=0)).astype(np.float64)

    @property
    def packed(self) -> Array:
        """All parameters but the factors of the rows."""
        return np.concatenate((self.log_std, *self.terms.values()))

    def unpacked(self, packed: Array) -> CovarianceParameters:
        """Return the same terms with other parameters."""
        at, terms = len(self.log_std), {}
        for name, values in self.terms.items():
            terms[name] = packed[at : at + len(values)]
            at += len(values)
        return CovarianceParameters(packed[: len(self.log_std)], self.factor, terms)

    def with_term(self, name: str, parameters: Array) -> CovarianceParameters:
        """Return the noise with one more term."""
        return dataclasses.replace(self, terms={**self.terms, name: parameters})

    def without(self, name: str) -> CovarianceParameters:
        """Return the noise without a term."""
        return dataclasses.replace(self, terms={n: p for n, p in self.terms.items() if n != name})

    def independent(self, stated: Array) -> Array:
        """Return ``(N, M)`` standard deviations of the independent noise beside ``stated`` variances."""
        variance = stated + np.square(self.std[self.kinds(stated.shape[1])])
        return np.sqrt(variance) * self.factor[:, None]


@dataclass(frozen=True)
class Whitened:
    """Rows whitened by V, and the posterior of the coefficients."""

    columns: Array
    """``(n, P)`` whitened columns times the prior's standard deviations, Q."""
    y: Array
    """``(n,)``"""
    triangle: Array
    """``(P, P)`` lower factor of I + Q'Q."""
    reduced: Array
    """``(P,)`` triangle^-1 Q'y."""
    log_likelihood: float
    apply: Callable[[Array], Array]
    """Whitens ``(N, M, …)`` to ``(n, …)``."""
    factor: Array
    """``(n, n)`` lower factor of V, or ``(n,)`` its standard deviations where it is diagonal."""

    @property
    def coefficients(self) -> Array:
        """Return the posterior mean ``(P,)`` in units of the prior's standard deviations."""
        return np.asarray(solve_triangular(self.triangle, self.reduced, lower=True, trans="T"))

    def weighted_residual(self, components: int, kept: NDArray[np.int64] | None = None) -> Array:
        """Return P y ``(N, M)``, with some of the columns if ``kept`` names them."""
        if kept is None:
            white = self.y - self.columns @ self.coefficients
        else:
            columns = self.columns[:, kept]
            system = columns.T @ columns + np.eye(kept.size)
            white = self.y - columns @ np.linalg.solve(system, columns.T @ self.y)
        if self.factor.ndim == 1:
            white = white / self.factor
        else:
            white = solve_triangular(self.factor, white, lower=True, trans="T", check_finite=False)
        return white.reshape(components, -1).T


@lru_cache(maxsize=2)
def whitened(noise: CovarianceParameters, linear: Linearised) -> Whitened:
    """Whiten a linearised model; the latest are kept, since fit, evidence and scores ask for the same one.

    Raises:
        numpy.linalg.LinAlgError: The covariance is singular.
    """
    independent = noise.independent(linear.rows.stated)
    if not noise.terms:
        factor = _flat(independent)
        log_det = 2.0 * float(np.sum(np.log(factor)))

        def apply(a: Array) -> Array:
            flat = _flat(a)
            return flat / factor.reshape((-1,) + (1,) * (flat.ndim - 1))

    else:
        lower, info = dpotrf(covariance(noise, linear).T, lower=0, overwrite_a=1)
        if info:
            raise np.linalg.LinAlgError
        factor = np.tril(lower.T)
        log_det = _log_det(factor)

        def apply(a: Array) -> Array:
            flat = _flat(a)
            white: Array = solve_triangular(factor, flat.reshape(len(flat), -1), lower=True, check_finite=False)
            return white.reshape(flat.shape)

    columns, y = apply(linear.columns * linear.prior_std), apply(linear.y)
    triangle: Array = np.asarray(np.linalg.cholesky(columns.T @ columns + np.eye(columns.shape[1])), dtype=np.float64)
    reduced = solve_triangular(triangle, columns.T @ y, lower=True)
    log_likelihood = -0.5 * (log_det + _log_det(triangle) + float(y @ y - reduced @ reduced))
    return Whitened(columns, y, triangle, reduced, log_likelihood, apply, factor)


def covariance(noise: CovarianceParameters, linear: Linearised) -> Array:
    """Return ``(n, n)`` V, of which only the blocks on and below the diagonal are filled."""
    components, count = linear.y.shape[1], len(linear.y)
    matrix = np.zeros((components, count, components, count))
    kernels: list[Array | None] = [None] * len(linear.joints)
    for name, parameters in noise.terms.items():
        if TERMS[name].of_joints:
            added = TERMS[name].kernels(parameters, linear.rows)
            kernels = [a if b is None else b if a is None else a + b for a, b in zip(kernels, added, strict=True)]
        else:
            for axis, of_axis in enumerate(TERMS[name].kernels(parameters, linear.rows)):
                matrix[axis, :, axis] += 0.0 if of_axis is None else of_axis
    for joint, kernel in zip(linear.joints, kernels, strict=True):
        if kernel is not None:
            for b in range(components):
                right = kernel * joint[b]
                for a in range(b, components):
                    matrix[a, :, b] += joint[a][:, None] * right
    flat = matrix.reshape(components * count, components * count)
    flat[np.diag_indices(len(flat))] += np.square(_flat(noise.independent(linear.rows.stated)))
    return flat


def likelihood_derivatives(noise: CovarianceParameters, linear: Linearised) -> tuple[float, Array, Array]:
    """Return the log likelihood, its gradient ``(K,)`` by :attr:`CovarianceParameters.packed`, and the information.

    The information ``(K, K)`` is the average of the observed and the expected one, a' dV/dt P dV/du a / 2, a = P y
    (average-information REML; Gilmour, Thompson and Cullis 1995): it costs no more than products with vectors.

    Raises:
        numpy.linalg.LinAlgError: The covariance is singular.
    """
    components, count = linear.y.shape[1], len(linear.y)
    own = noise.own_variance(components)
    if not noise.terms:
        white = whitened(noise, linear)
        independent = _flat(noise.independent(linear.rows.stated))
        error = white.y - white.columns @ white.coefficients
        spread = solve_triangular(white.triangle, white.columns.T, lower=True)
        share = _flat(own) / np.square(independent)
        slope = (np.square(error) - 1.0 + np.sum(np.square(spread), axis=0)) * share
        expected = noise.by_kind(2.0 * np.square(share).reshape(components, -1).T)
        return white.log_likelihood, noise.by_kind(slope.reshape(components, -1).T), np.diag(expected)
    columns, y = _flat(linear.columns * linear.prior_std), _flat(linear.y)
    matrix = covariance(noise, linear)
    matrix += columns @ columns.T
    # The lower triangle by rows is LAPACK's upper triangle by columns.
    factor, info = dpotrf(matrix.T, lower=0, overwrite_a=1)
    if info:
        raise np.linalg.LinAlgError
    log_det = _log_det(factor)
    weighted = dpotrs(factor, y, lower=0)[0]
    by_term = {name: list(TERMS[name].derivatives(values, linear.rows)) for name, values in noise.terms.items()}
    moved = solve_triangular(
        factor, _flat(_slopes_times(noise, linear, weighted, by_term)), trans="T", check_finite=False
    )
    slopes = dpotri(factor, lower=0, overwrite_c=1)[0].T
    np.subtract(np.multiply.outer(weighted, weighted), slopes, out=slopes)
    blocks = slopes.reshape(components, count, components, count)
    of_axes = [np.tril(blocks[a, :, a]) for a in range(components)]
    of_axes = [lower + np.tril(lower, -1).T for lower in of_axes]
    gradient = [noise.by_kind(np.diag(slopes).reshape(components, -1).T * own)]
    of_joints = (
        _joint_weights(blocks, of_axes, linear.joints) if any(TERMS[name].of_joints for name in noise.terms) else []
    )
    for name, parameters in noise.terms.items():
        weights, by_parameter = of_joints if TERMS[name].of_joints else of_axes, np.zeros(len(parameters))
        sums: dict[tuple[int, ...], Array] = {}
        for number, carriers, slope in by_term[name]:
            key = tuple(carriers)
            if key not in sums:
                sums[key] = sum((weights[i] for i in key[1:]), start=weights[key[0]])
            by_parameter[number] += 0.5 * np.vdot(sums[key], slope)
        gradient.append(by_parameter)
    return -0.5 * (log_det + float(y @ weighted)), np.concatenate(gradient), 0.5 * moved.T @ moved


def _slopes_times(
    noise: CovarianceParameters, linear: Linearised, weighted: Array, by_term: Mapping[str, Sequence[Carried]]
) -> Array:
    """Return ``(N, M, K)`` the derivative of V by each parameter times ``weighted`` ``(M N,)``.

    ``by_term`` holds the derivatives of the kernels of each term.
    """
    components = linear.y.shape[1]
    by_row = weighted.reshape(components, -1).T
    by_joint = np.einsum("jan,na->jn", linear.joints, by_row)
    result = np.zeros((*by_row.shape, noise.packed.size))
    own = 2.0 * noise.own_variance(components) * by_row
    for component, kind in enumerate(noise.kinds(components)):
        result[:, component, kind] = own[:, component]
    at = len(noise.log_std)
    for name, parameters in noise.terms.items():
        for number, carriers, slope in by_term[name]:
            if TERMS[name].of_joints:
                moved = slope @ by_joint[carriers].T
                result[:, :, at + number] += np.einsum("jan,nj->na", linear.joints[carriers], moved)
            else:
                result[:, carriers, at + number] += slope @ by_row[:, carriers]
        at += len(parameters)
    return result


def _joint_weights(blocks: Array, of_axes: list[Array], joints: Array) -> list[Array]:
    """Return for each joint ``(N, N)`` weights of its kernel: F' A F summed over components, in sums with symmetric.

    Only the lower triangle of A is there; blocks below the diagonal count twice.
    """
    weights = np.zeros((len(joints), *blocks.shape[1:4:2]))
    for a, diagonal in enumerate(of_axes):
        left = np.zeros_like(weights)
        for b in range(a):
            left += blocks[a, :, b] * joints[:, b, None]
        left *= 2.0
        left += diagonal * joints[:, a, None]
        left *= joints[:, a, :, None]
        weights += left
    return list(weights)


def unaccounted(noise: CovarianceParameters, linear: Linearised, white: Whitened) -> Array:
    """Return ``(N, M)`` what noise and scatter must account for: y less the posterior mean of all else."""
    weighted = white.weighted_residual(linear.y.shape[1])
    left = np.square(noise.independent(linear.rows.stated)) * weighted
    if "scatter" in noise.terms:
        by_row = np.einsum("jan,na->jn", linear.joints, weighted)
        by_visit = np.stack([np.bincount(linear.rows.visit, weights=moved) for moved in by_row])
        variance = np.exp(2.0 * noise.terms["scatter"])
        left = left + np.einsum("jan,jn->na", linear.joints, variance[:, None] * by_visit[:, linear.rows.visit])
    return left


def scatter_covariance(noise: CovarianceParameters, linear: Linearised) -> Array:
    """Return ``(N, M, M)`` the covariance of each row by scatter of the joints."""
    if "scatter" not in noise.terms:
        return np.zeros((len(linear.y), linear.y.shape[1], linear.y.shape[1]))
    moved = linear.joints * np.exp(noise.terms["scatter"])[:, None, None]
    return np.asarray(np.einsum("jan,jbn->nab", moved, moved))


def usual_std(noise: CovarianceParameters, linear: Linearised) -> Array:
    """Return the root mean squares of noise and scatter together, m and rad: what a further term starts from."""
    shared = np.einsum("naa->na", scatter_covariance(noise, linear))
    std = np.sqrt(np.square(noise.independent(linear.rows.stated)) + shared)
    variance = np.mean(np.square(std / noise.factor[:, None]), axis=0)
    return np.asarray(np.sqrt(variance.reshape(-1, 3).mean(axis=1)))


def _flat(a: Array) -> Array:
    """Return ``(N, M, …)`` as ``(M N, …)``, component by component."""
    return np.moveaxis(a, 1, 0).reshape((a.shape[0] * a.shape[1], *a.shape[2:]))


def _log_det(triangle: Array) -> float:
    """Return the log determinant of a matrix from its triangular factor."""
    return 2.0 * float(np.sum(np.log(np.diag(triangle)))) if len(triangle) else 0.0


# Restricted maximum likelihood of the covariance's parameters, gross errors, and what the parameters cost.

ACCEPTED = 3.0
"""Log odds beyond which an effect or a term is accepted: 20 to 1, "strong" (Kass and Raftery 1995)."""
GROSS_SHARE = 0.01
"""Prior share of rows with a gross error."""
GROSS_FACTORS = np.array([1.0, 6.0, 30.0, 1000.0])
"""Factors on a row's noise: none, a disturbed reading, a wrong one, a broken beam."""
_LOG_SHARES = np.log([1.0 - GROSS_SHARE, *[GROSS_SHARE / 3.0] * 3])
MOST_COMPONENTS = 500
"""Components that the parameters are estimated on: the time grows with their cube."""
_SMALL = -3.0
"""Log factor on a term's start at which its score statistics are computed."""
_STEPS = 40
_LONGEST = 2.0
"""Longest step of a log standard deviation or length: beyond it their exponentials are far from linear."""
_WORTH = 0.5
"""Gain, by a lower bound, from which a term is estimated; it decides about time."""
_GAINS = 0.01
"""Least gain of a term beyond what it costs: smaller ones are rounding."""
LEAST = math.log(1e-7)
"""Least log standard deviation of noise, m or rad: below the resolution of any instrument."""
NOISE_STDS = (LEAST, math.log(0.1))
"""Bounds of a log standard deviation of noise."""


def estimated(noise: CovarianceParameters, linear: Linearised, most: int = MOST_COMPONENTS) -> CovarianceParameters:
    """Return the parameters of largest restricted likelihood, with the rows' factors as they are.

    Beside terms, of more than ``most`` components a random part is used.
    """
    part, start = on_subset(noise, linear) if noise.terms and linear.y.size > most else (linear, noise)
    bounds = [NOISE_STDS] * len(noise.log_std)
    for name, parameters in noise.terms.items():
        bounds += TERMS[name].bounds(len(parameters))
    found = climbed(noise.packed, bounds, lambda at: likelihood_derivatives(start.unpacked(at), part))
    return noise if found is None else dataclasses.replace(start.unpacked(found[0]), factor=noise.factor)


def climbed(
    start: Array, bounds: Sequence[tuple[float, float]], likelihood: Callable[[Array], tuple[float, Array, Array]]
) -> tuple[Array, float] | None:
    """Return the parameters ``(K,)`` of largest likelihood, and its logarithm; None if it is singular at ``start``.

    Steps of the average information, damped (Marquardt 1963), until the next would gain less than :data:`_GAINS`.
    ``likelihood`` returns logarithm, gradient ``(K,)`` and information ``(K, K)``.
    """
    low, high = np.array(bounds).T
    at, best, damping = np.clip(start, low, high), None, 1.0
    step = np.zeros_like(at)
    for _ in range(_STEPS):
        try:
            found = likelihood(at + step)
        except np.linalg.LinAlgError:
            found = None
        if found is not None and (best is None or found[0] > best[0]):
            at, best, damping = at + step, found, 0.1 * damping
        elif best is None:
            return None
        else:
            damping *= 10.0
        _, gradient, information = best
        free = np.flatnonzero(((at > low) | (gradient > 0.0)) & ((at < high) | (gradient < 0.0)))
        ahead = np.linalg.solve(information[np.ix_(free, free)] + damping * np.eye(free.size), gradient[free])
        if 0.5 * gradient[free] @ ahead < _GAINS:
            break
        step = np.zeros_like(at)
        step[free] = ahead * min(1.0, _LONGEST / float(np.abs(ahead).max()))
        step = np.clip(at + step, low, high) - at
    return None if best is None else (at, best[0])


def on_subset(noise: CovarianceParameters, linear: Linearised) -> tuple[Linearised, CovarianceParameters]:
    """Return model and noise at the rows of random poses that the parameters are estimated on."""
    if linear.y.size <= MOST_COMPONENTS:
        return linear, noise
    index, part = _subset(linear)
    return part, dataclasses.replace(noise, factor=noise.factor[index])


@lru_cache(maxsize=1)
def _subset(linear: Linearised) -> tuple[NDArray[np.int64], Linearised]:
    """Return the rows of random poses; kept, with their kernels, while the same model is asked for."""
    index = first_ranks(linear.rows.draw, MOST_COMPONENTS // linear.y.shape[1])
    return index, linear.subset(index)


def with_gross_errors(noise: CovarianceParameters, linear: Linearised, rounds: int = 6) -> CovarianceParameters:
    """Return the noise estimated again, with the factor of each row that is most probable."""
    noise = estimated(noise, linear)
    for _ in range(rounds):
        left = unaccounted(noise, linear, whitened(noise, linear))
        usual = noise.independent(linear.rows.stated) / noise.factor[:, None]
        shared = scatter_covariance(noise, linear)
        log_posterior = []
        for factor, log_share in zip(GROSS_FACTORS, _LOG_SHARES, strict=True):
            if noise.terms.get("scatter") is None:
                std = factor * usual
                log_density = -np.sum(np.log(std), axis=1) - 0.5 * np.sum(np.square(left / std), axis=1)
            else:
                triangle = np.linalg.cholesky(shared + np.square(factor * usual)[:, :, None] * np.eye(left.shape[1]))
                white = np.linalg.solve(triangle, left[:, :, None])[:, :, 0]
                log_det = np.sum(np.log(np.diagonal(triangle, axis1=1, axis2=2)), axis=1)
                log_density = -log_det - 0.5 * np.sum(np.square(white), axis=1)
            log_posterior.append(log_share + log_density)
        factor = GROSS_FACTORS[np.argmax(log_posterior, axis=0)]
        if np.array_equal(factor, noise.factor):
            break
        noise = estimated(dataclasses.replace(noise, factor=factor), linear)
    return noise


def too_many_gross_errors(noise: CovarianceParameters) -> bool:
    """Return whether so many rows have gross errors that chance, at their share, is rejected at the accepted odds."""
    gross = int(np.count_nonzero(noise.factor > 1.0))
    return gross > 0 and float(bdtrc(gross - 1, noise.factor.size, GROSS_SHARE)) < math.exp(-ACCEPTED)


def log_evidence(noise: CovarianceParameters, linear: Linearised) -> float:
    """Return the log likelihood with what the terms and the gross errors cost.

    A term costs half the log of the rows a parameter (Schwarz 1978), and the odds for acceptance; gross errors cost
    their prior probability.
    """
    usual, gross = usual_std(noise, linear), int(np.count_nonzero(noise.factor > 1.0))
    count = sum(TERMS[name].variances(values, linear, usual) for name, values in noise.terms.items())
    cost = 0.5 * math.log(len(linear.y)) * (count + 2 * noise.has_axes) + ACCEPTED * len(noise.terms)
    log_prior = float(gross * _LOG_SHARES[1] + (noise.factor.size - gross) * _LOG_SHARES[0])
    return whitened(noise, linear).log_likelihood + log_prior - cost


def with_terms_that_gain(
    noise: CovarianceParameters, linear: Linearised, names: Iterable[str] = tuple(TERMS)
) -> CovarianceParameters:
    """Return the noise with the terms ``names`` that gain, added one by one, the best first.

    A term mostly gains less beside more terms, so after one is added the others are estimated again in the order of
    their last gains, until the best is known (accelerated greedy; Minoux 1978). Before the end all are.
    """
    gains = dict.fromkeys((name for name in names if name not in noise.terms), math.inf)
    found: dict[str, CovarianceParameters] = {}
    while gains:
        name = max(gains, key=lambda name: gains[name])
        if gains[name] <= _GAINS:
            unknown = [name for name in gains if name not in found]
            if not unknown:
                break
            name = unknown[0]
        if name in found:
            noise = found[name]
            del gains[name]
            found.clear()
        else:
            gains[name], found[name] = _with_one_more(noise, linear, name)
    return without_idle_terms(noise, linear)


def has_term_that_gains(noise: CovarianceParameters, linear: Linearised) -> bool:
    """Return whether any term gains."""
    return any(_with_one_more(noise, linear, name)[0] > _GAINS for name in TERMS if name not in noise.terms)


def _with_one_more(noise: CovarianceParameters, linear: Linearised, name: str) -> tuple[float, CovarianceParameters]:
    """Return the gain of evidence by a further term, and the noise with it; 0 if it is not worth estimating.

    Score statistics and two sizes of it tell, for three evaluations of the likelihood a start; an estimate costs some
    twenty of likelihood and gradient.
    """
    part, noise_of_part = on_subset(noise, linear)
    most, best = 0.0, np.empty(0)
    for gain, start in _gains_at_sizes(noise_of_part, part, name):
        try:
            _, gradient, information = likelihood_derivatives(_with_sized(noise_of_part, name, start, _SMALL), part)
        except np.linalg.LinAlgError:
            continue
        amplitudes = np.arange(-len(start), 0)[TERMS[name].amplitudes]
        slopes, curvatures = np.maximum(gradient[amplitudes], 0.0), np.diag(information)[amplitudes]
        scores = float(np.sum(np.square(slopes) / (2.0 * np.maximum(curvatures, 1e-300))))
        if max(scores, gain) > most:
            most, best = max(scores, gain), start
    if most < _WORTH:
        return 0.0, noise
    other = with_gross_errors(estimated(noise.with_term(name, best), linear), linear, 1)
    return log_evidence(other, linear) - log_evidence(noise, linear), other


def without_idle_terms(noise: CovarianceParameters, linear: Linearised) -> CovarianceParameters:
    """Return the noise without the terms that no longer gain, the worst first."""
    while noise.terms:
        best, most = None, log_evidence(noise, linear)
        for name in noise.terms:
            other = with_gross_errors(estimated(noise.without(name), linear), linear, 1)
            if (total := log_evidence(other, linear)) > most:
                best, most = other, total
        if best is None:
            return noise
        noise = best
    return noise


def least_gain(noise: CovarianceParameters, linear: Linearised, name: str) -> float:
    """Return how much the term ``name`` gains at some sizes of it, which is no more than it gains at its best."""
    part, noise = on_subset(noise, linear)
    return max((gain for gain, _ in _gains_at_sizes(noise, part, name)), default=0.0)


def _gains_at_sizes(noise: CovarianceParameters, part: Linearised, name: str) -> Iterator[tuple[float, Array]]:
    """Yield the gain of likelihood at two sizes of each start of a term, and that start."""
    for start in TERMS[name].starts(part, usual_std(noise, part)):
        try:
            sizes = [whitened(_with_sized(noise, name, start, by), part).log_likelihood for by in (0.0, 0.7)]
            yield max(sizes) - whitened(noise, part).log_likelihood, start
        except np.linalg.LinAlgError:
            yield 0.0, start


def _with_sized(noise: CovarianceParameters, name: str, start: Array, by: float) -> CovarianceParameters:
    """Return the noise with a term at ``start``, its standard deviations times exp(``by``)."""
    parameters = start.copy()
    parameters[TERMS[name].amplitudes] += by
    return noise.with_term(name, parameters)
