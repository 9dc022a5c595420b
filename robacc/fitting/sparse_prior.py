"""Sparse prior: if most constants of an arm are nominal, those that differ are found, and noise moves no others.

Constants of one kind (lengths, angles) have their nominal value with probability 1 - pi, and otherwise differ from it
by a normal deviate of standard deviation w ("spike and slab"). Both pi and w are estimated from the data. With
theta_i = gamma_i mu_i, alpha_i = P(gamma_i = 1), G and m the normal equations of the constants with all other
coefficients eliminated, the mean-field posterior is found one constant at a time:

    v_i = 1 / (G_ii + 1/w^2),  mu_i = v_i (m_i - sum_{j != i} G_ij alpha_j mu_j),
    logit alpha_i = logit pi + log(v_i / w^2) / 2 + mu_i^2 / (2 v_i),

and then w and pi from all of a kind (P. Carbonetto and M. Stephens 2012, Scalable variational inference for Bayesian
variable selection). Its mean is the solution of the normal equations with prior precision

    G_ii (1/alpha_i - 1) + 1/(alpha_i w^2)

on each constant, with which the nonlinear fit is repeated. If most constants of a kind differ, as on most real arms,
that kind keeps the broad prior of :mod:`robacc.fitting.priors`.

The slab takes the place of the broad prior. A kind of which a constant is weakly identifiable keeps the broad prior.
Standard errors stay those without the sparse prior. The interval of a shrunk constant then covers the truth for a
constant of any size; a posterior interval would do so only on average over constants distributed as the prior.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.effects.base import Effect
from robacc.effects.frames import LinkGeometry
from robacc.fitting.fit_result import Fit, Options
from robacc.fitting.normal_equations import solved
from robacc.fitting.priors import weak_kinds
from robacc.fitting.solver import fit
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.robots.arm import Arm
from robacc.statistics.distributions import chi2_sf

_FEWEST = 4
"""Constants of a kind that estimates of pi and w need at least; shrinking fewer than three never pays (Stein)."""
_MOST = 2.0 / 3.0
"""Share of a kind's constants that differ, up to which the kind is shrunk."""
_ROUNDS = 200
_SETTLED = 1e-3
"""Change of a constant, over its standard error, at which the iteration ends."""
_SMALLEST = 1e-9
"""m or rad: least standard deviation of the slab."""


@dataclass(frozen=True, slots=True)
class ShrunkKind:
    """Constants of one unit, and which of them differ from the robot file's."""

    unit: str
    names: tuple[str, ...]
    probability: tuple[float, ...]
    """Probability of each constant to differ."""
    std: float
    """Root mean square deviation of the constants that differ, in ``unit``."""


def shrink_to_nominal(
    fitted: Fit, data: Measurements, options: Options, effects: Sequence[str]
) -> tuple[Fit, tuple[ShrunkKind, ...]]:
    """Return the fit with constants of ``effects`` shrunk to nominal, and the kinds that were shrunk.

    If no kind is, return ``fitted`` itself. The covariance stays that of ``fitted``.
    """
    columns = fitted.identifiability.columns
    weak = {(kind.effect, kind.unit) for kind in weak_kinds(fitted)}
    kinds: dict[str, list[int]] = {}
    for index, column in enumerate(columns):
        effect, unit = fitted.model.free[fitted.owners[column]].name, fitted.terms[column].unit
        if effect in effects and (effect, unit) not in weak:
            kinds.setdefault(unit, []).append(index)
    kinds = {unit: indices for unit, indices in kinds.items() if len(indices) >= _FEWEST}
    selections: list[_Selected] = []
    while kinds:
        selections = _select(fitted, list(kinds.values()))
        is_sparse = [selection.probability.sum() <= _MOST * selection.indices.size for selection in selections]
        if all(is_sparse):
            break
        kinds = {unit: indices for (unit, indices), sparse in zip(kinds.items(), is_sparse, strict=True) if sparse}
    if not kinds:
        return fitted, ()
    prior_std = np.full(fitted.theta.size, np.inf) if options.priors is None else options.priors.copy()
    for selection in selections:
        prior_std[columns[selection.indices]] = 1.0 / np.sqrt(selection.precision)
    start = dataclasses.replace(
        options,
        priors=prior_std,
        start=fitted.theta,
        identified=fitted.identifiability,
        group_stds=fitted.group_stds,
    )
    refit = dataclasses.replace(fit(fitted.model, data, start), covariance=fitted.covariance)
    return refit, tuple(
        ShrunkKind(
            unit,
            tuple(fitted.names[i] for i in columns[selection.indices]),
            tuple(selection.probability.tolist()),
            selection.std,
        )
        for unit, selection in zip(kinds, selections, strict=True)
    )


@dataclass(frozen=True, slots=True)
class _Selected:
    indices: NDArray[np.int64]
    """Indices among the identifiable coefficients."""
    probability: Array
    precision: Array
    std: float


def _select(fitted: Fit, kinds: Sequence[Sequence[int]]) -> list[_Selected]:
    """Return the mean-field posterior of each kind of constants, all other coefficients eliminated."""
    indices = np.concatenate([np.array(kind, dtype=np.int64) for kind in kinds])
    members = np.split(np.arange(indices.size), np.cumsum([len(kind) for kind in kinds])[:-1])
    gram, rhs = _eliminated(fitted, indices)
    diagonal = np.diag(gram)
    scale = 1.0 / np.sqrt(diagonal)
    mean = scale * solved(gram * scale[:, None] * scale, scale * rhs)
    slab_std = np.empty(indices.size)
    odds = np.zeros(indices.size)
    for group in members:
        slab_std[group] = max(float(np.sqrt(np.mean(np.square(mean[group])))), _SMALLEST)
    for _ in range(_ROUNDS):
        previous_mean = mean.copy()
        probability, slab_mean = _sweep(gram, rhs, mean, 1.0 / np.square(slab_std), odds)
        posterior_var = 1.0 / (diagonal + 1.0 / np.square(slab_std))
        for group in members:
            differ = float(probability[group].sum())
            second_moment = float(probability[group] @ (np.square(slab_mean[group]) + posterior_var[group]))
            slab_std[group] = max(np.sqrt(second_moment / max(differ, 1e-3)), _SMALLEST)
            share = (differ + 0.5) / (group.size + 1.0)
            odds[group] = np.log(share / (1.0 - share))
        if np.max(np.abs(mean - previous_mean) * np.sqrt(diagonal)) < _SETTLED:
            break
    precision = diagonal * (1.0 / probability - 1.0) + 1.0 / (probability * np.square(slab_std))
    return [
        _Selected(indices[group], probability[group], precision[group], float(slab_std[group[0]])) for group in members
    ]


def _sweep(gram: Array, rhs: Array, mean: Array, precision: Array, odds: Array) -> tuple[Array, Array]:
    """Update each ``mean`` in place, given the others; return P(differs) and the mean if it does, of each constant."""
    probability, slab_mean = np.empty(mean.size), np.empty(mean.size)
    for i in range(mean.size):
        precision_sum = gram[i, i] + precision[i]
        slab_mean[i] = (rhs[i] - gram[i] @ mean + gram[i, i] * mean[i]) / precision_sum
        logit = odds[i] + 0.5 * np.log(precision[i] / precision_sum) + 0.5 * np.square(slab_mean[i]) * precision_sum
        probability[i] = 1.0 / (1.0 + np.exp(-np.clip(logit, -40.0, 40.0)))
        mean[i] = probability[i] * slab_mean[i]
    return probability, slab_mean


def _eliminated(fitted: Fit, indices: NDArray[np.int64]) -> tuple[Array, Array]:
    """Return the normal equations of the coefficients at ``indices`` without their prior, all others eliminated."""
    others = np.setdiff1d(np.arange(fitted.precision.size), indices)
    gram = fitted.gram.copy()
    gram[others, others] += fitted.precision[others]
    cross = gram[np.ix_(others, indices)]
    scale = 1.0 / np.sqrt(np.diag(gram)[others])
    others_gram = gram[np.ix_(others, others)] * scale[:, None] * scale
    coupled = np.column_stack((cross, fitted.rhs[others])) * scale[:, None]
    solution = scale[:, None] * solved(others_gram, coupled)
    return gram[np.ix_(indices, indices)] - cross.T @ solution[:, :-1], fitted.rhs[indices] - cross.T @ solution[:, -1]


# Hayati's rotation only if the data require it.
#
# Near-parallel axes need a rotation about y in the model, or their tilt cannot be described (Hayati 1983). If the
# axes are truly parallel, it is one more coefficient that fits noise, which costs accuracy at poses far from those
# measured. So if the whole geometry is fitted, the rotations are put to a joint Wald test once everything else is in
# the model, and left out if they are not significant.

_SIGNIFICANCE = 0.001
"""The rotations stay if their p-value is at most this."""


def without_idle_rotations(fitted: Fit, original: Model, data: Measurements, options: Options) -> Fit:
    """Return ``fitted``, or the fit of ``original`` without the rotations about y of a geometry fitted as a whole."""
    place = next((i for i, effect in enumerate(original.free) if _is_whole_geometry(effect, original.arm)), None)
    columns = fitted.identifiability.columns
    rotations = [i for i in columns if fitted.owners[i] == place and fitted.terms[i].label == "beta"]
    if place is None or not rotations or not np.isfinite(fitted.covariance[rotations, rotations]).all():
        return fitted
    value = fitted.theta[rotations]
    covariance = fitted.covariance[np.ix_(rotations, rotations)]
    std = np.sqrt(np.diag(covariance))
    statistic = float(value / std @ solved(covariance / std[:, None] / std, value / std))
    if chi2_sf(statistic, float(len(rotations))) <= _SIGNIFICANCE:
        return fitted
    effects = list(original.free)
    effects[place] = LinkGeometry(effects[place].joints, ("theta", "d", "a", "alpha"))
    return fit(dataclasses.replace(original, free=tuple(effects)), data, options)


def _is_whole_geometry(effect: Effect, arm: Arm) -> bool:
    """Return whether the effect is the arm's whole geometry, not a single row of it."""
    return isinstance(effect, LinkGeometry) and not effect.labels and set(effect.joints) == set(arm.names)
