r"""Variance components Vθ, Vr, Vl, Vα by maximum likelihood, from measured poses of one robot.

Each kind of parameter (theta, d, a, alpha; for a URDF the offsets, and the lengths and angles of origins) has its
predicted variances times one factor φ_c, so the sufficient statistic y
(see :mod:`robacc.prediction.sufficient_statistics`) has the distribution

    y ~ N(0, C),  C = I + K_0 + Σ_c φ_c K_c,  K_c = E_c E_c^T,

with E_c the whitened effects of one predicted standard deviation of each parameter of the kind, and K_0 those of base
and tool, whose tolerances are not estimated. The log-likelihood is -(log|C| + y^T C^-1 y)/2; score and expected
information in log φ by S. R. Searle, G. Casella, C. E. McCulloch, Variance Components (1992), 6.2 and 6.3.

A kind has as many degrees of freedom as it has identifiable parameters, six for six joints: a variance from six numbers
is known to a factor of about three, regardless of the number of poses. Intervals are by profile likelihood with
Bartlett's correction for that many degrees of freedom: for a variance from n Gaussian numbers the likelihood ratio at
the truth has mean n (log(n/2) - ψ(n/2)) rather than 1 (M. S. Bartlett, Proc. Royal Society A 160 (1937) 268-282).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.geometry import Array
from robacc.prediction.parameters import ToleranceParameter
from robacc.prediction.sufficient_statistics import SufficientStatistics
from robacc.statistics.distributions import chi2_quantile

GIVEN = frozenset({"base", "tool"})
"""Components that are not estimated: a frame has too few lengths and angles, too different to share a factor."""
_LOG_FACTOR_MIN, _LOG_FACTOR_MAX = -16.0, 16.0
"""Range of log φ; a factor at its lower end counts as zero."""
_MAX_STEPS = 200
_STEP_LIMIT = 2.0
_LIKELIHOOD_TOLERANCE = 1e-7
_MIN_DOF = 1.0
"""Smallest number of degrees of freedom, with the other components free, of an estimated component."""


@dataclass(frozen=True, slots=True)
class VarianceComponent:
    """One variance component."""

    name: str
    n_parameters: int
    unit: str
    predicted: float
    """RMS of its parameters' predicted standard deviations, m or rad."""
    factor: float
    """Estimated over predicted standard deviation, √φ."""
    estimate: float
    """``factor`` times ``predicted``."""
    lower: float
    upper: float | None
    """Limit of ``factor``; None if the poses give no upper limit."""
    dof: float
    """Effective degrees of freedom, the other components free: 2 (expected information of log φ at the prediction)."""
    likelihood_ratio: float
    """Likelihood ratio of the prediction for this component, the others free."""
    why: str | None
    """Reason why the component is not identifiable; its numbers are then unreliable."""


@dataclass(frozen=True, slots=True)
class VarianceComponents:
    """All variance components, with notes on those that are not identifiable."""

    components: tuple[VarianceComponent, ...]
    confidence: float
    notes: tuple[str, ...]


def variance_components(
    statistics: SufficientStatistics, parameters: Sequence[ToleranceParameter], confidence: float = 0.95
) -> VarianceComponents | None:
    """Estimate one factor for each kind of parameter; return None if no parameter affects the poses.

    Args:
        statistics: Sufficient statistics of the poses for ``parameters``.
        parameters: Parameters with predicted errors, in the order of the statistics.
        confidence: Confidence of the intervals.
    """
    problem = _LikelihoodProblem.of(statistics, parameters)
    if statistics.y.size == 0 or not problem.names:
        return None
    log_factors, maximum = problem.maximise(np.zeros(len(problem.names)), np.ones(len(problem.names), dtype=bool))
    information = problem.information(np.zeros(len(problem.names)))
    notes, components = [], []
    for index, name in enumerate(problem.names):
        members = [parameter for parameter in parameters if parameter.component == name]
        dof = 2.0 * _marginal_information(information, index)
        reason = _unidentified_reason(problem.names, information, index, dof)
        predicted = math.sqrt(float(np.mean([parameter.sd**2 for parameter in members])))
        factor = math.exp(0.5 * log_factors[index]) if log_factors[index] > _LOG_FACTOR_MIN + 1.0 else 0.0
        threshold = chi2_quantile(confidence, 1.0) * bartlett_mean(max(dof, _MIN_DOF))
        lower, upper = problem.profile_interval(index, log_factors, maximum, threshold)
        ratio = max(0.0, 2.0 * (maximum - problem.maximise_with(index, 0.0, log_factors)[1]))
        components.append(
            VarianceComponent(
                name,
                len(members),
                members[0].unit,
                predicted,
                factor,
                factor * predicted,
                lower,
                upper,
                dof,
                ratio,
                reason,
            )
        )
        if reason is not None:
            notes.append(reason)
    not_estimated = sorted({parameter.component for parameter in parameters} & GIVEN)
    if not_estimated:
        notes.append(f"the tolerances of {' and '.join(not_estimated)} are used as given, not estimated")
    return VarianceComponents(tuple(components), confidence, tuple(notes))


def bartlett_mean(dof: float) -> float:
    """Return n (log(n/2) - ψ(n/2)), the mean likelihood ratio at the truth of a variance from n = ``dof`` numbers."""
    half = 0.5 * dof
    return 2.0 * half * (math.log(half) - _digamma(half))


def _digamma(x: float) -> float:
    """Return ψ(x) for x > 0, by recurrence and the asymptotic series (DLMF 5.5.2, 5.11.2)."""
    result = 0.0
    while x < 12.0:
        result -= 1.0 / x
        x += 1.0
    square = 1.0 / (x * x)
    return result + math.log(x) - 0.5 / x - square * (1 / 12 - square * (1 / 120 - square * (1 / 252 - square / 240)))


@dataclass(frozen=True, slots=True)
class _LikelihoodProblem:
    """Likelihood of log φ."""

    names: tuple[str, ...]
    y: Array
    effect: Array
    """``(R, P)`` effects of the parameters of estimated components."""
    member: Array
    """``(C, P)`` 1 if the parameter belongs to the component."""
    fixed: Array
    """``(R, R)`` I + K_0"""

    @classmethod
    def of(cls, statistics: SufficientStatistics, parameters: Sequence[ToleranceParameter]) -> _LikelihoodProblem:
        estimated_parameters = [i for i, parameter in enumerate(parameters) if parameter.component not in GIVEN]
        given_parameters = [i for i, parameter in enumerate(parameters) if parameter.component in GIVEN]
        names = tuple(dict.fromkeys(parameters[i].component for i in estimated_parameters))
        member = np.array([[float(parameters[i].component == name) for i in estimated_parameters] for name in names])
        given_effects = statistics.effect[:, given_parameters]
        fixed = np.eye(statistics.y.size) + given_effects @ given_effects.T
        return cls(names, statistics.y, statistics.effect[:, estimated_parameters], member, fixed)

    def evaluate(self, eta: Array) -> tuple[float, Array, Array]:
        """Return log-likelihood, score and expected information in log φ."""
        phi = np.exp(eta)
        weighted = self.effect * (phi @ self.member)
        covariance = self.fixed + weighted @ self.effect.T
        triangle = np.linalg.cholesky(covariance)
        solved = np.linalg.solve(triangle, np.column_stack((self.effect, self.y)))
        products = solved[:, :-1].T @ solved
        gram, gradient_term = products[:, :-1], products[:, -1]
        log_likelihood = -float(np.sum(np.log(np.diag(triangle)))) - 0.5 * float(solved[:, -1] @ solved[:, -1])
        score = 0.5 * phi * (self.member @ (np.square(gradient_term) - np.diag(gram)))
        information = 0.5 * np.outer(phi, phi) * (self.member @ np.square(gram) @ self.member.T)
        return log_likelihood, score, information

    def information(self, eta: Array) -> Array:
        """Return the expected information in log φ."""
        return self.evaluate(eta)[2]

    def maximise(self, eta: Array, free: NDArray[np.bool_]) -> tuple[Array, float]:
        """Return the most likely log φ over the ``free`` components, the others fixed, and its log-likelihood.

        Fisher scoring with the step shortened until the likelihood rises.
        """
        eta = eta.copy()
        log_likelihood, score, information = self.evaluate(eta)
        for _ in range(_MAX_STEPS):
            active = free & ~((eta <= _LOG_FACTOR_MIN) & (score <= 0)) & ~((eta >= _LOG_FACTOR_MAX) & (score >= 0))
            if not np.any(active):
                break
            step = np.zeros_like(eta)
            block = information[np.ix_(active, active)]
            ridge = np.diag(1e-9 * np.diag(block) + 1e-14)
            step[active] = np.linalg.solve(block + ridge, score[active])
            step = np.clip(step, -_STEP_LIMIT, _STEP_LIMIT)
            improved = False
            for _ in range(30):
                trial_eta = np.clip(eta + step, _LOG_FACTOR_MIN, _LOG_FACTOR_MAX)
                candidate = self.evaluate(trial_eta)
                if candidate[0] > log_likelihood:
                    improved = True
                    break
                step *= 0.5
            if not improved:
                break
            converged = candidate[0] - log_likelihood < _LIKELIHOOD_TOLERANCE
            eta, (log_likelihood, score, information) = trial_eta, candidate
            if converged:
                break
        return eta, log_likelihood

    def maximise_with(self, index: int, fixed_value: float, start: Array) -> tuple[Array, float]:
        """Return the maximum with component ``index`` fixed at log φ = ``fixed_value``."""
        fixed_eta = start.copy()
        fixed_eta[index] = fixed_value
        free = np.ones(fixed_eta.size, dtype=bool)
        free[index] = False
        return self.maximise(fixed_eta, free)

    def profile_interval(self, index: int, eta: Array, maximum: float, threshold: float) -> tuple[float, float | None]:
        """Return the factors √φ at which twice the profile log-likelihood is ``threshold`` below its maximum."""
        limits: list[float | None] = []
        for sign, bound in ((-1.0, _LOG_FACTOR_MIN), (1.0, _LOG_FACTOR_MAX)):
            inside_value, start, step = float(eta[index]), eta, 0.5
            outside_value = None
            while outside_value is None and sign * (bound - inside_value) > 0.0:
                trial_value = max(min(inside_value + sign * step, _LOG_FACTOR_MAX), _LOG_FACTOR_MIN)
                best_eta, log_likelihood = self.maximise_with(index, trial_value, start)
                if 2.0 * (maximum - log_likelihood) > threshold:
                    outside_value = trial_value
                else:
                    inside_value, start, step = trial_value, best_eta, 2.0 * step
            limits.append(
                None
                if outside_value is None
                else self._boundary(index, inside_value, outside_value, start, maximum, threshold)
            )
        lower = 0.0 if limits[0] is None else math.exp(0.5 * limits[0])
        return lower, None if limits[1] is None else math.exp(0.5 * limits[1])

    def _boundary(
        self, index: int, inside_value: float, outside_value: float, start: Array, maximum: float, threshold: float
    ) -> float:
        while abs(outside_value - inside_value) > 1e-3:
            middle = 0.5 * (inside_value + outside_value)
            best_eta, log_likelihood = self.maximise_with(index, middle, start)
            if 2.0 * (maximum - log_likelihood) > threshold:
                outside_value = middle
            else:
                inside_value, start = middle, best_eta
        return 0.5 * (inside_value + outside_value)


def _marginal_information(information: Array, index: int) -> float:
    """Return the information on component ``index`` with the other components free."""
    other_indices = [i for i in range(information.shape[0]) if i != index]
    total = float(information[index, index])
    if not other_indices:
        return total
    cross = information[other_indices, index]
    return max(
        0.0,
        total - float(cross @ np.linalg.pinv(information[np.ix_(other_indices, other_indices)], rcond=1e-12) @ cross),
    )


def _unidentified_reason(names: Sequence[str], information: Array, index: int, dof: float) -> str | None:
    """Return the reason why the component is not identifiable, or None."""
    if dof >= _MIN_DOF:
        return None
    component_dof = 2.0 * float(information[index, index])
    if component_dof < _MIN_DOF:
        return f"{names[index]} is weakly identifiable on these poses: {component_dof:.2g} degrees of freedom"
    scales = np.sqrt(np.diag(information))
    correlations = np.abs(information[index]) / np.where(scales > 0, scales * scales[index], 1.0)
    correlations[index] = 0.0
    partners = [names[i] for i in np.argsort(-correlations) if correlations[i] > 0.5] or [
        names[int(np.argmax(correlations))]
    ]
    return f"{names[index]} is not distinguishable from {' and '.join(partners)} on these poses"
