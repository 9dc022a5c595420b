"""Where most constants of an arm are as its table says, those that are not are found, and noise moves no others.

Constants of one kind (lengths, angles) are taken to be the table's value with probability 1 - pi, and else to differ
from it by a normal draw of standard deviation w ("spike and slab"). Both pi and w are the data's own, so the prior asks
for no size in advance. With theta_i = gamma_i mu_i, alpha_i = P(gamma_i = 1), G and m the normal equations of the
constants with all other coefficients eliminated, the mean-field posterior is found one constant at a time:

    v_i = 1 / (G_ii + 1/w^2),  mu_i = v_i (m_i - sum_{j != i} G_ij alpha_j mu_j),
    logit alpha_i = logit pi + log(v_i / w^2) / 2 + mu_i^2 / (2 v_i),

and then w and pi from all of a kind (P. Carbonetto and M. Stephens 2012, Scalable variational inference for Bayesian
variable selection). Its mean is the solution of the normal equations with prior precision

    G_ii (1/alpha_i - 1) + 1/(alpha_i w^2)

on each constant, with which the nonlinear fit is done again. Where most constants of a kind differ, as on most real
arms, the table is no guide: such a kind keeps plain least squares.

Standard errors stay those of the data alone. An interval about a drawn value then holds for a constant of any size,
while one by the posterior's width would hold only on average over constants that are spread as the prior says.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.fitting.solver import Fit, Options, fit
from robacc.geometry import Array
from robacc.measurements import Measurements

_FEWEST = 4
"""Constants of a kind below which pi and w are not to be learnt; drawing fewer than three never pays (Stein)."""
_MOST = 2.0 / 3.0
"""Share of a kind's constants that differ from which on the table is no guide."""
_ROUNDS = 200
_SETTLED = 1e-3
"""Of a standard error: a change by which the constants are found."""
_SMALLEST = 1e-9
"""m or rad: a width that is as good as none."""


@dataclass(frozen=True, slots=True)
class ShrunkKind:
    """Constants of one unit, and which of them differ from the robot file's."""

    unit: str
    names: tuple[str, ...]
    probability: tuple[float, ...]
    """That each differs."""
    width: float
    """By how much those do that differ, root mean square, in ``unit``."""


def shrink_to_nominal(
    found: Fit, data: Measurements, options: Options, effects: Sequence[str]
) -> tuple[Fit, tuple[ShrunkKind, ...]]:
    """The fit again with constants of ``effects`` drawn to the file's values, and the kinds of which that holds.

    Where it holds of none, ``found`` itself. The covariance is that of ``found``, without the prior.
    """
    kept = found.identifiability.kept
    kinds: dict[str, list[int]] = {}
    for place, column in enumerate(kept):
        if found.model.free[found.owners[column]].name in effects:
            kinds.setdefault(found.terms[column].unit, []).append(place)
    kinds = {unit: places for unit, places in kinds.items() if len(places) >= _FEWEST}
    result: list[_Selected] = []
    while kinds:
        result = _select(found, list(kinds.values()))
        guided = [one.probability.sum() <= _MOST * one.places.size for one in result]
        if all(guided):
            break
        kinds = {unit: places for (unit, places), good in zip(kinds.items(), guided, strict=True) if good}
    if not kinds:
        return found, ()
    deviation = np.full(found.theta.size, np.inf) if options.priors is None else options.priors.copy()
    for one in result:
        deviation[kept[one.places]] = 1.0 / np.sqrt(one.precision)
    start = dataclasses.replace(options, priors=deviation, start=found.theta, widths=found.widths, held=found.held)
    again = dataclasses.replace(fit(found.model, data, start), covariance=found.covariance)
    return again, tuple(
        ShrunkKind(unit, tuple(found.names[i] for i in kept[one.places]), tuple(one.probability.tolist()), one.width)
        for unit, one in zip(kinds, result, strict=True)
    )


@dataclass(frozen=True, slots=True)
class _Selected:
    places: NDArray[np.int64]
    """Among the coefficients kept."""
    probability: Array
    precision: Array
    width: float


def _select(found: Fit, kinds: Sequence[Sequence[int]]) -> list[_Selected]:
    """The mean-field posterior of the constants of some kinds, all other coefficients as free as they are."""
    places = np.concatenate([np.array(one, dtype=np.int64) for one in kinds])
    members = np.split(np.arange(places.size), np.cumsum([len(one) for one in kinds])[:-1])
    gram, moment = _alone(found, places)
    mean = np.asarray(np.linalg.solve(gram, moment), dtype=np.float64)
    diagonal = np.diag(gram)
    weight = np.empty(places.size)
    odds = np.zeros(places.size)
    for own in members:
        weight[own] = max(float(np.sqrt(np.mean(np.square(mean[own])))), _SMALLEST)
    for _ in range(_ROUNDS):
        before = mean.copy()
        probability, own_mean = _sweep(gram, moment, mean, 1.0 / np.square(weight), odds)
        spread = 1.0 / (diagonal + 1.0 / np.square(weight))
        for own in members:
            differ = float(probability[own].sum())
            energy = float(probability[own] @ (np.square(own_mean[own]) + spread[own]))
            weight[own] = max(np.sqrt(energy / max(differ, 1e-3)), _SMALLEST)
            share = (differ + 0.5) / (own.size + 1.0)
            odds[own] = np.log(share / (1.0 - share))
        if np.max(np.abs(mean - before) * np.sqrt(diagonal)) < _SETTLED:
            break
    precision = diagonal * (1.0 / probability - 1.0) + 1.0 / (probability * np.square(weight))
    return [_Selected(places[own], probability[own], precision[own], float(weight[own[0]])) for own in members]


def _sweep(gram: Array, moment: Array, mean: Array, precision: Array, odds: Array) -> tuple[Array, Array]:
    """Each constant once, given the others, its ``mean`` changed in place; P(differs) and mean where it does."""
    probability, own_mean = np.empty(mean.size), np.empty(mean.size)
    for i in range(mean.size):
        total = gram[i, i] + precision[i]
        own_mean[i] = (moment[i] - gram[i] @ mean + gram[i, i] * mean[i]) / total
        logit = odds[i] + 0.5 * np.log(precision[i] / total) + 0.5 * np.square(own_mean[i]) * total
        probability[i] = 1.0 / (1.0 + np.exp(-np.clip(logit, -40.0, 40.0)))
        mean[i] = probability[i] * own_mean[i]
    return probability, own_mean


def _alone(found: Fit, places: NDArray[np.int64]) -> tuple[Array, Array]:
    """Normal equations of the coefficients at ``places``, all others eliminated."""
    gram = found.gram + np.diag(found.precision)
    others = np.setdiff1d(np.arange(gram.shape[0]), places)
    cross = gram[np.ix_(others, places)]
    scale = 1.0 / np.sqrt(np.diag(gram)[others])
    rest = gram[np.ix_(others, others)] * scale[:, None] * scale
    right = np.column_stack((cross, found.moment[others])) * scale[:, None]
    answer = scale[:, None] * np.linalg.solve(rest, right)
    return gram[np.ix_(places, places)] - cross.T @ answer[:, :-1], found.moment[places] - cross.T @ answer[:, -1]
