r"""The variance components Vθ, Vr, Vl, Vα by maximum likelihood, from measured poses of one robot.

Each kind of parameter (theta, d, a, alpha; of a URDF the offsets, the lengths and the angles of origins) has its
predicted variances times one factor φ_c, so with the evidence y (see :mod:`robacc.prediction.sufficient_statistics`)

    y ~ N(0, C),  C = I + K_0 + Σ_c φ_c K_c,  K_c = E_c E_c^T,

E_c the whitened effects of one predicted standard deviation of each parameter of the kind, K_0 those of base and tool,
whose tolerances are taken as given. log-likelihood -(log|C| + y^T C^-1 y)/2; score and expected information in
log φ by S. R. Searle, G. Casella, C. E. McCulloch, Variance Components (1992), 6.2 and 6.3.

A kind has as many degrees of freedom as it has parameters that the poses show, six for six joints: a variance from six
numbers is known to a factor of three or so, however many poses there are. Intervals are by profile likelihood with
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
from robacc.prediction.sufficient_statistics import Evidence
from robacc.statistics.distributions import chi2_quantile

GIVEN = frozenset({"base", "tool"})
"""Components that are not estimated: lengths and angles of one frame are too few and too unlike to share a factor."""
_LOWEST, _HIGHEST = -16.0, 16.0
"""log φ: a millionth of a predicted standard deviation's square root and less is none."""
_STEPS = 200
_LONGEST_STEP = 2.0
_CONVERGED = 1e-7
_FEWEST = 1.0
"""Degrees of freedom that a component must be left with when the others are free too, to be called estimated."""


@dataclass(frozen=True, slots=True)
class Component:
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
    """Of ``factor``; None where the poses give no upper limit."""
    dof: float
    """Effective degrees of freedom, the other components free: 2 (expected information of log φ at the prediction)."""
    likelihood_ratio: float
    """Of the prediction for this component, the others free."""
    why: str | None
    """Why it is not told apart; the numbers are then of little worth."""


@dataclass(frozen=True, slots=True)
class Components:
    """All of them, and how well they were told apart."""

    components: tuple[Component, ...]
    confidence: float
    notes: tuple[str, ...]


def variance_components(
    evidence: Evidence, parameters: Sequence[ToleranceParameter], confidence: float = 0.95
) -> Components | None:
    """Estimate one factor for each kind of parameter; None where the poses show none of them.

    Args:
        evidence: Of ``parameters``.
        parameters: The predicted ones, in the evidence's order.
        confidence: Of the intervals.
    """
    problem = _Problem.of(evidence, parameters)
    if evidence.y.size == 0 or not problem.names:
        return None
    eta, top = problem.maximise(np.zeros(len(problem.names)), np.ones(len(problem.names), dtype=bool))
    information = problem.information(np.zeros(len(problem.names)))
    notes, components = [], []
    for c, name in enumerate(problem.names):
        own = [parameter for parameter in parameters if parameter.component == name]
        dof = 2.0 * _left(information, c)
        why = _why(problem.names, information, c, dof)
        predicted = math.sqrt(float(np.mean([parameter.sd**2 for parameter in own])))
        factor = math.exp(0.5 * eta[c]) if eta[c] > _LOWEST + 1.0 else 0.0
        threshold = chi2_quantile(confidence, 1.0) * bartlett_mean(max(dof, _FEWEST))
        lower, upper = problem.profile_interval(c, eta, top, threshold)
        ratio = max(0.0, 2.0 * (top - problem.at(c, 0.0, eta)[1]))
        components.append(
            Component(name, len(own), own[0].unit, predicted, factor, factor * predicted, lower, upper, dof, ratio, why)
        )
        if why is not None:
            notes.append(why)
    given = sorted({parameter.component for parameter in parameters} & GIVEN)
    if given:
        notes.append(f"the tolerances of {' and '.join(given)} are taken as given")
    return Components(tuple(components), confidence, tuple(notes))


def bartlett_mean(dof: float) -> float:
    """Mean of the likelihood ratio of a variance from ``dof`` Gaussian numbers at the truth: n (log(n/2) - ψ(n/2))."""
    half = 0.5 * dof
    return 2.0 * half * (math.log(half) - _digamma(half))


def _digamma(x: float) -> float:
    """ψ(x) for x > 0, by recurrence and the asymptotic series (DLMF 5.5.2, 5.11.2)."""
    total = 0.0
    while x < 12.0:
        total -= 1.0 / x
        x += 1.0
    square = 1.0 / (x * x)
    return total + math.log(x) - 0.5 / x - square * (1 / 12 - square * (1 / 120 - square * (1 / 252 - square / 240)))


@dataclass(frozen=True, slots=True)
class _Problem:
    """The likelihood of log φ."""

    names: tuple[str, ...]
    y: Array
    effect: Array
    """``(R, P)`` of the parameters of components that are estimated."""
    member: Array
    """``(C, P)`` one where the parameter is of the component."""
    fixed: Array
    """``(R, R)`` I + K_0"""

    @classmethod
    def of(cls, evidence: Evidence, parameters: Sequence[ToleranceParameter]) -> _Problem:
        free = [i for i, parameter in enumerate(parameters) if parameter.component not in GIVEN]
        given = [i for i, parameter in enumerate(parameters) if parameter.component in GIVEN]
        names = tuple(dict.fromkeys(parameters[i].component for i in free))
        member = np.array([[float(parameters[i].component == name) for i in free] for name in names])
        rest = evidence.effect[:, given]
        fixed = np.eye(evidence.y.size) + rest @ rest.T
        return cls(names, evidence.y, evidence.effect[:, free], member, fixed)

    def evaluate(self, eta: Array) -> tuple[float, Array, Array]:
        """Log-likelihood, score and expected information in log φ."""
        phi = np.exp(eta)
        weighted = self.effect * (phi @ self.member)
        covariance = self.fixed + weighted @ self.effect.T
        triangle = np.linalg.cholesky(covariance)
        solved = np.linalg.solve(triangle, np.column_stack((self.effect, self.y)))
        inner = solved[:, :-1].T @ solved
        gram, pull = inner[:, :-1], inner[:, -1]
        value = -float(np.sum(np.log(np.diag(triangle)))) - 0.5 * float(solved[:, -1] @ solved[:, -1])
        score = 0.5 * phi * (self.member @ (np.square(pull) - np.diag(gram)))
        information = 0.5 * np.outer(phi, phi) * (self.member @ np.square(gram) @ self.member.T)
        return value, score, information

    def information(self, eta: Array) -> Array:
        """Expected information in log φ."""
        return self.evaluate(eta)[2]

    def maximise(self, eta: Array, free: NDArray[np.bool_]) -> tuple[Array, float]:
        """The most likely log φ over the ``free`` components, the others held, and the log-likelihood there.

        Fisher scoring with the step shortened until it gains.
        """
        eta = eta.copy()
        value, score, information = self.evaluate(eta)
        for _ in range(_STEPS):
            inside = free & ~((eta <= _LOWEST) & (score <= 0)) & ~((eta >= _HIGHEST) & (score >= 0))
            if not np.any(inside):
                break
            step = np.zeros_like(eta)
            part = information[np.ix_(inside, inside)]
            ridge = np.diag(1e-9 * np.diag(part) + 1e-14)
            step[inside] = np.linalg.solve(part + ridge, score[inside])
            step = np.clip(step, -_LONGEST_STEP, _LONGEST_STEP)
            gained = False
            for _ in range(30):
                trial = np.clip(eta + step, _LOWEST, _HIGHEST)
                found = self.evaluate(trial)
                if found[0] > value:
                    gained = True
                    break
                step *= 0.5
            if not gained:
                break
            small = found[0] - value < _CONVERGED
            eta, (value, score, information) = trial, found
            if small:
                break
        return eta, value

    def at(self, c: int, value: float, start: Array) -> tuple[Array, float]:
        """The best with component ``c`` held at log φ = ``value``."""
        held = start.copy()
        held[c] = value
        free = np.ones(held.size, dtype=bool)
        free[c] = False
        return self.maximise(held, free)

    def profile_interval(self, c: int, eta: Array, top: float, threshold: float) -> tuple[float, float | None]:
        """Factors √φ between which twice the profile log-likelihood stays within ``threshold`` of the top."""
        ends: list[float | None] = []
        for sign, limit in ((-1.0, _LOWEST), (1.0, _HIGHEST)):
            inside, start, step = float(eta[c]), eta, 0.5
            outside = None
            while outside is None and sign * (limit - inside) > 0.0:
                trial = max(min(inside + sign * step, _HIGHEST), _LOWEST)
                there, value = self.at(c, trial, start)
                if 2.0 * (top - value) > threshold:
                    outside = trial
                else:
                    inside, start, step = trial, there, 2.0 * step
            ends.append(None if outside is None else self._boundary(c, inside, outside, start, top, threshold))
        lower = 0.0 if ends[0] is None else math.exp(0.5 * ends[0])
        return lower, None if ends[1] is None else math.exp(0.5 * ends[1])

    def _boundary(self, c: int, inside: float, outside: float, start: Array, top: float, threshold: float) -> float:
        while abs(outside - inside) > 1e-3:
            middle = 0.5 * (inside + outside)
            there, value = self.at(c, middle, start)
            if 2.0 * (top - value) > threshold:
                outside = middle
            else:
                inside, start = middle, there
        return 0.5 * (inside + outside)


def _left(information: Array, c: int) -> float:
    """What is left of the information on component ``c`` when the others are free."""
    others = [i for i in range(information.shape[0]) if i != c]
    own = float(information[c, c])
    if not others:
        return own
    cross = information[others, c]
    return max(0.0, own - float(cross @ np.linalg.pinv(information[np.ix_(others, others)], rcond=1e-12) @ cross))


def _why(names: Sequence[str], information: Array, c: int, dof: float) -> str | None:
    """Why the component is not told apart, or None."""
    if dof >= _FEWEST:
        return None
    own = 2.0 * float(information[c, c])
    if own < _FEWEST:
        return f"the poses hardly show {names[c]}: {own:.2g} degrees of freedom"
    size = np.sqrt(np.diag(information))
    alike = np.abs(information[c]) / np.where(size > 0, size * size[c], 1.0)
    alike[c] = 0.0
    partners = [names[i] for i in np.argsort(-alike) if alike[i] > 0.5] or [names[int(np.argmax(alike))]]
    return f"{names[c]} cannot be told from {' and '.join(partners)} at these poses"
