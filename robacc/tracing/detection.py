"""Detection limits of effects on the measured poses, and poses to measure next.

An effect of coefficients c whose columns have, given the present model, the new part G (whitened Gram matrix) raises
the statistic t^2 by c' G c over the noise variance. A search accepts q coefficients from the t^2 on at which the
evidence at the best prior size, (t^2 - q)/2 - q/2 log(t^2/q), exceeds the prior odds and :data:`ACCEPTED`; an effect
has its detection limit where the noise takes it there with probability 1/2.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.effects.base import Effect, effect_class
from robacc.effects.step import is_step
from robacc.error_model.covariance import ACCEPTED
from robacc.errors import RobaccError
from robacc.fitting.fit_result import Fit
from robacc.fitting.solver import SEARCH, fit
from robacc.geometry import Array, rms_length
from robacc.measurements import Measurements
from robacc.statistics.distributions import chi2_sf, f_critical, needed_noncentrality, noncentral_f_sf
from robacc.tracing.candidates import Candidate
from robacc.tracing.search import Alternative, SearchResult

# Poses to measure next: poses at which two rival effects predict most differently (T-optimal discrimination).
#
# Source of the criterion: A. C. Atkinson and V. V. Fedorov, "The design of experiments for discriminating between two
# rival models", Biometrika 62, 1975.

_TRIAL_POSES = 600
"""Random poses among which those of largest difference are sought."""
_ADVISED = 4
_ELIGIBLE_SHARE = 0.6
"""Share of the largest difference from which a pose is eligible."""
_LEAST_DIFFERENCE = 0.5
"""Share of the noise below which a difference is not worth a pose."""


@dataclass(frozen=True, slots=True)
class Advice:
    """Poses that distinguish two effects."""

    text: str
    q: tuple[tuple[float, ...], ...]
    """Joint variables of each pose, rad or m."""
    difference: tuple[float, ...]
    """Distance between the two effects' predicted targets at each pose, m."""


def advise(
    declared: Fit,
    effects: Sequence[Effect],
    finding: Effect,
    alternative: Alternative,
    data: Measurements,
    noise: float,
    seed: int,
) -> Advice | None:
    """Return poses inside the joint limits (or the measured range) at which a finding and its alternative differ most.

    Both models are fitted to all poses. Circumstances other than the joints are sampled from the measured rows.
    """
    rival = effect_class(alternative.effect).from_settings(alternative.joints, alternative.settings)
    others = [effect for effect in effects if effect is not finding]
    try:
        first = fit(declared.model.with_free(*others, finding), data, SEARCH)
        second = fit(declared.model.with_free(*others, rival), data, SEARCH)
        trial = _trial_poses(declared, data, seed)
        predicted = [fitted.model.bind(trial).poses(fitted.theta).translation for fitted in (first, second)]
    except RobaccError:
        return None
    difference = np.linalg.norm(predicted[0] - predicted[1], axis=0)
    if difference.max() < _LEAST_DIFFERENCE * noise:
        return Advice(
            f"{finding} and {rival} are not distinguishable at any pose within the joint limits: they differ by "
            f"at most {difference.max() * 1e3:.2g} mm; measure other data (another payload, an indicator on the base)",
            (),
            (),
        )
    assert trial.q is not None
    chosen = _choose_poses(trial.q, difference)
    q = tuple(tuple(float(value) for value in trial.q[:, i]) for i in chosen)
    return Advice(f"to distinguish {finding} from {rival}, measure:", q, tuple(float(difference[i]) for i in chosen))


def _trial_poses(declared: Fit, data: Measurements, seed: int) -> Measurements:
    """Return random poses within limits, with the circumstances of randomly chosen measured rows."""
    assert data.q is not None
    generator = np.random.default_rng(seed)
    rows = generator.integers(0, data.n, _TRIAL_POSES)
    low, high = data.q.min(axis=1), data.q.max(axis=1)
    for i, joint in enumerate(declared.model.arm.robot.variables):
        if joint.limits is not None:
            low[i], high[i] = joint.limits
    q = low[:, None] + (high - low)[:, None] * generator.random((data.q.shape[0], _TRIAL_POSES))
    return dataclasses.replace(data.subset(rows), q=q)


def _choose_poses(q: Array, difference: Array) -> list[int]:
    """Return the pose of largest difference, then eligible poses that are far from those already chosen."""
    ranges = np.maximum(np.ptp(q, axis=1), 1e-9)[:, None]
    eligible = np.flatnonzero(difference >= _ELIGIBLE_SHARE * difference.max())
    chosen = [int(np.argmax(difference))]
    while len(chosen) < min(_ADVISED, eligible.size):
        gaps = np.min(
            [np.linalg.norm((q[:, eligible] - q[:, [i]]) / ranges, axis=0) for i in chosen],
            axis=0,
        )
        chosen.append(int(eligible[np.argmax(gaps)]))
    return chosen


_LARGEST = 300.0
"""Largest limit, in multiples of the usual size; an effect that needs more has no detection limit."""
_LEAST_NEW = 1e-6
"""Share of its squared length below which the new part of a direction counts as explained by the present model."""


@dataclass(frozen=True, slots=True)
class DetectionLimit:
    """Smallest size of one form of an effect that these poses show with probability 1/2."""

    effect: str
    joints: tuple[str, ...]
    settings: dict[str, object]
    limit: float | None
    """Size in ``unit``. With several coefficients: the length of their vector in its least visible direction, such as
    the amplitude of a periodic error whatever its phase. None if no plausible size is found."""
    unit: str
    rms: float | None
    """Displacement of the target by an effect of that size, root mean square over the poses, m."""


@dataclass(frozen=True, slots=True)
class DecisiveTest:
    """F test at the level that the accepted odds are worth."""

    level: float
    dof: tuple[float, float]
    """Degrees of freedom of the effect and of the residual."""

    @property
    def noncentrality_at_limit(self) -> float:
        """Return the noncentrality at which an effect is found with probability 1/2; infinite without any dof."""
        return math.inf if self.dof[1] <= 0.0 else needed_noncentrality(0.5, self.level, *self.dof)

    def power(self, noncentrality: float) -> float:
        """Return the probability that an effect is found."""
        if self.dof[1] <= 0.0:
            return 0.0
        return noncentral_f_sf(f_critical(self.level, *self.dof), *self.dof, noncentrality)


def decisive_test(rank: int, dof: float, log_prior: float) -> DecisiveTest:
    """Return the test that decides about a candidate with ``rank`` new directions.

    Args:
        rank: Number of new directions.
        dof: Degrees of freedom of the residual without the effect.
        log_prior: Log prior probability of the candidate at its most probable size.
    """
    needed = ACCEPTED - log_prior
    # The evidence grows with the statistic by (1 - q / t^2) / 2: Newton steps from above converge.
    statistic = 2.0 * (needed + rank)
    for _ in range(50):
        evidence = 0.5 * (statistic - rank) - 0.5 * rank * math.log(statistic / rank)
        statistic += (needed - evidence) / (0.5 * (1.0 - rank / statistic))
    return DecisiveTest(max(chi2_sf(statistic, float(rank)), 1e-300), (float(rank), float(round(dof) - rank)))


def detection_limits(found: SearchResult) -> list[DetectionLimit]:
    """Return the limit of every named candidate given the findings, except forms of mixed units."""
    reduced, _, square = found.evidence.conditioned(np.arange(len(found.state.theta)))
    dof = found.evidence.columns.shape[0] - found.evidence.effective(np.ones(len(found.state.theta), dtype=bool))
    present = {effect.key() for effect in found.effects}
    weight = 1.0 / found.noise.independent(found.state.linear.rows.stated).T
    result = []
    for candidate, columns in _forms(found):
        if candidate.key in present:
            continue
        own = found.evidence.columns[:, columns]
        values, vectors = visible(found.evidence.new(reduced, columns, columns), np.einsum("nq,nq->q", own, own))
        effect, size, rms = candidate.effect, None, None
        if values[0] > 0 and dof > 0:
            needed = decisive_test(values.size, dof, candidate.log_prior_of_size).noncentrality_at_limit
            multiple = math.sqrt(needed * square / dof / float(values[0]))
            size = multiple * float(candidate.sizes[0]) if multiple <= _LARGEST else None
            if size is not None:
                moved = (own @ vectors[:, 0]).reshape(weight.shape)[:3] / weight[:3]
                rms = multiple * rms_length(moved)
        result.append(DetectionLimit(effect.name, effect.joints, effect.settings(), size, candidate.terms[0].unit, rms))
    return result


def visible(blocks: Array, lengths: Array) -> tuple[Array, Array]:
    """Return ``(Q,)`` eigenvalues, ascending, and ``(Q, Q)`` eigenvectors of a new part; 0 for explained directions.

    ``lengths`` ``(Q,)`` are the squared lengths of the complete columns.
    """
    values, vectors = np.linalg.eigh(blocks)
    return np.where(values > _LEAST_NEW * max(float(lengths.max()), 1e-300), values, 0.0), vectors


def _forms(found: SearchResult) -> Iterator[tuple[Candidate, NDArray[np.int64]]]:
    """Yield forms with coefficients of a common unit, except forms that contain another form; steps in the middle."""
    named = [c for c in found.pool.named if len({term.unit for term in c.terms}) == 1]
    names = {candidate.key: {term.name for term in candidate.terms} for candidate in named}
    steps: dict[tuple[object, ...], list[tuple[Candidate, NDArray[np.int64]]]] = {}
    for number, columns in found.evidence.places.items():
        candidate = found.pool.all[number]
        if (own := names.get(candidate.key)) is not None:
            if not any(other < own for other in names.values()):
                yield candidate, columns
        elif is_step(candidate.effect) and len({term.unit for term in candidate.terms}) == 1:
            form = (candidate.effect.joints, *(term.name for term in candidate.terms))
            steps.setdefault(form, []).append((candidate, columns))
    for same in steps.values():
        yield same[len(same) // 2]
