"""Restricted maximum likelihood of the covariance's parameters, gross errors, and what the parameters cost."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterable, Iterator

import numpy as np

from robacc.error_model.covariance import (
    CovarianceParameters,
    likelihood_and_gradient,
    scatter_covariance,
    score_statistics,
    unaccounted,
    usual_std,
    whitened,
)
from robacc.error_model.rows import Linearised
from robacc.error_model.terms import TERMS
from robacc.fitting.visits import first_ranks
from robacc.geometry import Array

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
_WARM = 6
"""Iterations from parameters that were estimated before a small change of the model."""
_FLAT = 1e-5
"""Relative change of the log likelihood at which an estimate ends: of some thousands, well below one in log odds."""
_WORSE = 1e12
_WORTH = 0.5
"""Gain, by a lower bound, from which a term is estimated; it decides about time."""
_GAINS = 0.01
"""Least gain of a term beyond what it costs: smaller ones are rounding."""
LEAST = math.log(1e-7)
"""Least log standard deviation of noise, m or rad: below the resolution of any instrument."""
_SCORINGS = 20
_SETTLED = 1e-4
"""Change of a log standard deviation at which scoring ends."""


def estimated(noise: CovarianceParameters, linear: Linearised, iterations: int = 40) -> CovarianceParameters:
    """Return the parameters of largest restricted likelihood, with the rows' factors as they are."""
    if not noise.terms:
        return _independent(noise, linear)
    from scipy.optimize import minimize  # half a second, which clean data are spared

    part, start = on_subset(noise, linear)

    def objective(packed: Array) -> tuple[float, Array]:
        try:
            value, gradient = likelihood_and_gradient(start.unpacked(packed), part)
        except np.linalg.LinAlgError:
            return _WORSE, np.zeros(packed.size)
        return -value, -gradient

    bounds = [(LEAST, math.log(0.1))] * len(noise.log_std)
    for name, parameters in noise.terms.items():
        bounds += TERMS[name].bounds(len(parameters))
    low, high = np.array(bounds).T
    found = minimize(
        objective,
        np.clip(noise.packed, low, high),
        jac=True,
        method="L-BFGS-B",
        bounds=bounds,
        options={"maxiter": iterations, "ftol": _FLAT},
    )
    if not found.fun < _WORSE:
        return noise
    return dataclasses.replace(start.unpacked(found.x), factor=noise.factor)


def _independent(noise: CovarianceParameters, linear: Linearised) -> CovarianceParameters:
    """Return independent noise of largest restricted likelihood, by Fisher's scoring."""
    for _ in range(_SCORINGS):
        _, gradient = likelihood_and_gradient(noise, linear)
        own = noise.own_variance(linear.y.shape[1])
        share = np.square(own / np.square(noise.independent(linear.rows.stated)))
        information = 2.0 * noise.by_kind(share)
        step = np.clip(gradient / np.maximum(information, 1e-300), -1.0, 1.0)
        log_std = np.maximum(noise.log_std + step, LEAST)
        moved = float(np.max(np.abs(log_std - noise.log_std)))
        noise = dataclasses.replace(noise, log_std=log_std)
        if moved < _SETTLED:
            break
    return noise


def on_subset(noise: CovarianceParameters, linear: Linearised) -> tuple[Linearised, CovarianceParameters]:
    """Return model and noise at the rows of random poses that the parameters are estimated on."""
    if linear.y.size <= MOST_COMPONENTS:
        return linear, noise
    index = first_ranks(linear.rows.draw, MOST_COMPONENTS // linear.y.shape[1])
    return linear.subset(index), dataclasses.replace(noise, factor=noise.factor[index])


def with_gross_errors(noise: CovarianceParameters, linear: Linearised, rounds: int = 6) -> CovarianceParameters:
    """Return the noise estimated again, with the factor of each row that is most probable."""
    noise = estimated(noise, linear, _WARM)
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
        noise = estimated(dataclasses.replace(noise, factor=factor), linear, _WARM)
    return noise


def log_prior_of_gross_errors(noise: CovarianceParameters) -> float:
    """Return the log prior probability of the rows' factors."""
    gross = int(np.count_nonzero(noise.factor > 1.0))
    return float(gross * _LOG_SHARES[1] + (noise.factor.size - gross) * _LOG_SHARES[0])


def too_many_gross_errors(noise: CovarianceParameters) -> bool:
    """Return whether so many rows have gross errors that chance, at their share, is rejected at the accepted odds."""
    count, gross = noise.factor.size, int(np.count_nonzero(noise.factor > 1.0))
    tail = sum(
        math.exp(
            math.lgamma(count + 1)
            - math.lgamma(i + 1)
            - math.lgamma(count - i + 1)
            + i * math.log(GROSS_SHARE)
            + (count - i) * math.log1p(-GROSS_SHARE)
        )
        for i in range(gross, count + 1)
    )
    return gross > 0 and tail < math.exp(-ACCEPTED)


def cost(noise: CovarianceParameters, linear: Linearised) -> float:
    """Return what the terms cost: half the log of the rows a parameter (Schwarz 1978), and the odds for acceptance."""
    usual = usual_std(noise, linear)
    count = sum(TERMS[name].variances(values, linear, usual) for name, values in noise.terms.items())
    count += 2 * noise.has_axes
    return 0.5 * math.log(len(linear.y)) * count + ACCEPTED * len(noise.terms)


def log_evidence(noise: CovarianceParameters, linear: Linearised) -> float:
    """Return the log likelihood with what the terms and the gross errors cost."""
    likely = whitened(noise, linear).log_likelihood
    return likely + log_prior_of_gross_errors(noise) - cost(noise, linear)


def with_terms_that_gain(
    noise: CovarianceParameters, linear: Linearised, names: Iterable[str] = tuple(TERMS)
) -> CovarianceParameters:
    """Return the noise with the terms ``names`` that gain, added one by one, the best first."""
    while (gains := list(_with_one_more(noise, linear, names))) != []:
        noise = max(gains, key=lambda gain: gain[0])[1]
    return without_idle_terms(noise, linear)


def has_term_that_gains(noise: CovarianceParameters, linear: Linearised) -> bool:
    """Return whether any term gains."""
    return next(_with_one_more(noise, linear, TERMS), None) is not None


def _with_one_more(
    noise: CovarianceParameters, linear: Linearised, names: Iterable[str]
) -> Iterator[tuple[float, CovarianceParameters]]:
    """Yield the noise with each further term that gains, and its evidence."""
    least = log_evidence(noise, linear) + _GAINS
    for name in names:
        if name in noise.terms:
            continue
        gain, start = worth_estimating(noise, linear, name)
        if gain >= _WORTH:
            other = with_gross_errors(estimated(noise.with_term(name, start), linear, 20), linear, 1)
            if (total := log_evidence(other, linear)) > least:
                yield total, other


def without_idle_terms(noise: CovarianceParameters, linear: Linearised) -> CovarianceParameters:
    """Return the noise without the terms that no longer gain, the worst first."""
    while noise.terms:
        best, most = None, log_evidence(noise, linear)
        for name in noise.terms:
            other = with_gross_errors(estimated(noise.without(name), linear, 25), linear, 1)
            if (total := log_evidence(other, linear)) > most:
                best, most = other, total
        if best is None:
            return noise
        noise = best
    return noise


def worth_estimating(noise: CovarianceParameters, linear: Linearised, name: str) -> tuple[float, Array]:
    """Return about how much the term ``name`` would gain, and the parameters to start from.

    Score statistics and two sizes of it tell, for three evaluations of the likelihood a start; an estimate costs some
    twenty of likelihood and gradient.
    """
    part, noise = on_subset(noise, linear)
    best, found = 0.0, np.empty(0)
    for start in TERMS[name].starts(part, usual_std(noise, part)):
        small = noise.with_term(name, _scaled(name, start, _SMALL))
        amplitudes = TERMS[name].amplitudes(len(start))
        try:
            gradient = likelihood_and_gradient(small, part)[1][-len(start) :]
        except np.linalg.LinAlgError:
            continue
        scores = score_statistics(small, part, name, gradient[amplitudes].tolist())
        if (gain := max(scores, _gain_at_sizes(noise, part, name, start))) > best:
            best, found = gain, start
    return best, found


def least_gain(noise: CovarianceParameters, linear: Linearised, name: str) -> float:
    """Return how much the term ``name`` gains at some sizes of it, which is no more than it gains at its best."""
    part, noise = on_subset(noise, linear)
    starts = TERMS[name].starts(part, usual_std(noise, part))
    return max((_gain_at_sizes(noise, part, name, start) for start in starts), default=0.0)


def _gain_at_sizes(noise: CovarianceParameters, part: Linearised, name: str, start: Array) -> float:
    try:
        without = whitened(noise, part).log_likelihood
        sizes = [noise.with_term(name, _scaled(name, start, by)) for by in (0.0, 0.7)]
        return max(whitened(size, part).log_likelihood - without for size in sizes)
    except np.linalg.LinAlgError:
        return 0.0


def _scaled(name: str, start: Array, by: float) -> Array:
    """Return a term's parameters with its standard deviations times exp(``by``)."""
    parameters = start.copy()
    parameters[TERMS[name].amplitudes(len(parameters))] += by
    return parameters
