"""What is known of an arm's constants beside the poses: weakly identifiable constants, and those that are nominal.

**Weakly identifiable** are constants that the broad prior of :mod:`robacc.fitting.solver` bounds.

**Sparse prior**: if most constants of an arm are nominal, those that differ are found, and noise moves no others.
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
that kind keeps the broad prior, and so does one of which a constant is weakly identifiable.

Standard errors stay those without the sparse prior. The interval of a shrunk constant then covers the truth for a
constant of any size; a posterior interval would do so only on average over constants distributed as the prior.
"""

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from robacc.effects.frames import LinkGeometry
from robacc.errors import by_key
from robacc.fitting.fit_result import Fit, Options
from robacc.fitting.levels import ROUNDING, SETTLED, SIGNIFICANT, STEPS
from robacc.fitting.normal_equations import posterior, solved
from robacc.fitting.solver import broad_precision, broad_stds, by_effect, fit, refit
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.robots.description import DH_PARAMETERS
from robacc.statistics.intervals import chi2_sf

WEAK = 0.3
"""Share of the broad prior's standard deviation above which a standard error makes a constant weakly identifiable: the
poses alone would leave the usual size, 1 / sqrt(1 + 3^2)."""


@dataclass(frozen=True, slots=True)
class WeakKind:
    """Constants of one effect and unit, of which some are weakly identifiable."""

    effect: str
    unit: str
    std: float
    """Standard deviation of the broad prior near nominal, in ``unit``."""
    names: tuple[str, ...]
    """Names of the weakly identifiable constants."""


def weak_kinds(fit: Fit) -> tuple[WeakKind, ...]:
    """Return the kinds of constants of which some are weakly identifiable: the broad prior bounds these.

    Constants with another prior are not weakly identifiable.
    """
    columns = fit.identifiability.columns
    broad = broad_stds(fit.model, fit.terms, fit.owners)[columns]
    is_weak = np.sqrt(np.diag(posterior(fit.gram, fit.precision))) > WEAK * broad
    is_weak &= np.isclose(fit.precision, broad_precision(broad, fit.theta[columns]), rtol=0.5)
    weak = zip(columns[is_weak].tolist(), broad[is_weak].tolist(), strict=True)
    kinds = by_key(((fit.model.free[fit.owners[i]].name, fit.terms[i].unit, std), fit.names[i]) for i, std in weak)
    return tuple(WeakKind(*kind, tuple(names)) for kind, names in kinds.items())


# Sparse prior.

_FEWEST = 4
"""Constants of a kind that estimates of pi and w need at least; shrinking fewer than three never pays (Stein)."""
_MOST = 2.0 / 3.0
"""Share of a kind's constants that differ, up to which the kind is shrunk."""


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
    named = [(fitted.model.free[fitted.owners[column]].name, fitted.terms[column].unit) for column in columns]
    kinds = by_key((kind[1], i) for i, kind in enumerate(named) if kind[0] in effects and kind not in weak)
    kinds = {unit: indices for unit, indices in kinds.items() if len(indices) >= _FEWEST}
    while kinds:
        found = _select(fitted, kinds)
        sparse = {unit for unit, (probability, *_) in found.items() if np.mean(probability) <= _MOST}
        if len(sparse) == len(kinds):
            break
        kinds = {unit: indices for unit, indices in kinds.items() if unit in sparse}
    if not kinds:
        return fitted, ()
    priors, shrunk = np.full(fitted.theta.size, np.inf) if options.priors is None else options.priors.copy(), []
    for unit, indices in kinds.items():
        probability, precision, std = found[unit]
        priors[columns[indices]] = 1.0 / np.sqrt(precision)
        names = tuple(fitted.names[i] for i in columns[indices])
        shrunk.append(ShrunkKind(unit, names, tuple(probability.tolist()), std))
    again = dataclasses.replace(
        options,
        priors=priors,
        start=fitted.theta,
        identified=fitted.identifiability,
        group_stds=fitted.group_stds,
    )
    found_again = fit(fitted.model, data, again)
    return dataclasses.replace(found_again, covariance=fitted.covariance), tuple(shrunk)


def _select(fitted: Fit, kinds: dict[str, list[int]]) -> dict[str, tuple[Array, Array, float]]:
    """Return of each kind P(differs), the prior precision and the slab's std, all other coefficients eliminated.

    ``kinds`` are indices among the identifiable coefficients.
    """
    members = [np.array(kind, dtype=np.int64) for kind in kinds.values()]
    indices = np.concatenate(members)
    places = np.split(np.arange(indices.size), np.cumsum([kind.size for kind in members])[:-1])
    others = np.setdiff1d(np.arange(fitted.precision.size), indices)
    cross = fitted.gram[np.ix_(others, indices)]
    normal = fitted.gram[np.ix_(others, others)] + np.diag(fitted.precision[others])
    eliminated = cross.T @ solved(normal, np.column_stack((cross, fitted.rhs[others])))
    gram = fitted.gram[np.ix_(indices, indices)] - eliminated[:, :-1]
    rhs = fitted.rhs[indices] - eliminated[:, -1]
    diagonal = np.diag(gram)
    mean, odds, slab_std = solved(gram, rhs), np.zeros(indices.size), np.empty(indices.size)
    probability, slab_mean = np.empty(indices.size), np.empty(indices.size)
    for kind in places:
        slab_std[kind] = max(float(np.sqrt(np.mean(np.square(mean[kind])))), ROUNDING)
    for _ in range(STEPS):
        before, total = mean.copy(), diagonal + 1.0 / np.square(slab_std)
        evidence = odds - 0.5 * np.log(np.square(slab_std) * total)
        for i in range(indices.size):
            slab_mean[i] = (rhs[i] - gram[i] @ mean + gram[i, i] * mean[i]) / total[i]
            logit = np.clip(evidence[i] + 0.5 * np.square(slab_mean[i]) * total[i], -40.0, 40.0)
            probability[i] = 1.0 / (1.0 + np.exp(-logit))
            mean[i] = probability[i] * slab_mean[i]
        for kind in places:
            differ = float(probability[kind].sum())
            second_moment = float(probability[kind] @ (np.square(slab_mean[kind]) + 1.0 / total[kind]))
            slab_std[kind] = max(np.sqrt(second_moment / max(differ, 1e-3)), ROUNDING)
            odds[kind] = np.log((differ + 0.5) / (kind.size - differ + 0.5))
        if np.max(np.abs(mean - before) * np.sqrt(diagonal)) < SETTLED:
            break
    precision = diagonal * (1.0 / probability - 1.0) + 1.0 / (probability * np.square(slab_std))
    return {
        unit: (probability[kind], precision[kind], float(slab_std[kind[0]]))
        for unit, kind in zip(kinds, places, strict=True)
    }


# Hayati's rotation only if the data require it.
#
# Near-parallel axes need a rotation about y in the model, or their tilt cannot be described (Hayati 1983). If the
# axes are truly parallel, it is one more coefficient that fits noise, which costs accuracy at poses far from those
# measured. So if the whole geometry is fitted, the rotations are put to a joint Wald test once everything else is in
# the model, and left out if they are not significant.


def without_idle_rotations(fitted: Fit, original: Model, data: Measurements, options: Options) -> Fit:
    """Return ``fitted``, or the fit of ``original`` without the rotations about y of a geometry fitted as a whole.

    With priors of coefficients in ``options``, ``fitted``.
    """
    whole = {
        number
        for number, effect in enumerate(original.free)
        if isinstance(effect, LinkGeometry) and not effect.labels and set(effect.joints) == set(original.arm.names)
    }
    columns = fitted.identifiability.columns
    rotations = [i for i in columns if fitted.owners[i] in whole and fitted.terms[i].label == "beta"]
    covariance, value = fitted.covariance[np.ix_(rotations, rotations)], fitted.theta[rotations]
    is_open = options.priors is None and rotations and np.isfinite(covariance).all()
    if not is_open or chi2_sf(float(value @ solved(covariance, value)), float(len(rotations))) <= SIGNIFICANT:
        return fitted
    labels = tuple(label for label in DH_PARAMETERS if label != "beta")
    effects = [LinkGeometry(e.joints, labels) if i in whole else e for i, e in enumerate(original.free)]
    return refit(fitted, effects, data, options, by_effect(effects, fitted.owners, fitted.names, fitted.theta))
