"""Variance components by maximum likelihood, from poses of one robot, their noise and sufficient statistics.

Each kind of parameter (theta, d, a, alpha; for a URDF the offsets, and the lengths and angles of origins) has its
predicted variances times one factor φ_c, so the sufficient statistic y
(see :mod:`robacc.prediction.components`) has the distribution

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

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from robacc.chain import BASE, TOOL, Scalar
from robacc.errors import InputError, Problem
from robacc.geometry import Array, Poses
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.modelling.observation import residuals
from robacc.prediction.tolerances import ToleranceParameter
from robacc.robots.arm import Arm
from robacc.robots.description import Robot
from robacc.statistics.distributions import chi2_quantile

# Measurement noise of the poses: given, from the file's columns, or estimated from the poses themselves.

NoiseSource = Literal["file", "given", "estimated"]

RANK_TOLERANCE = 1e-9
"""Singular values below this fraction of the largest are rounding."""
_MAX_REML_ROUNDS = 200


@dataclass(frozen=True, slots=True)
class MeasurementNoise:
    """Standard deviation of the measurement noise along each axis."""

    position: float
    """m, root mean square over poses and axes."""
    orientation: float | None
    """rad; None if no orientation was measured."""
    source_position: NoiseSource
    source_orientation: NoiseSource | None


def _stated_noise(
    data: Measurements, given_noise: tuple[float | None, float | None]
) -> tuple[list[Array], list[float | None], list[NoiseSource]]:
    """Return weights ``(3, N)``, standard deviation beside them, and source of the noise of each measured part.

    Weights are reciprocals of the file's uncertainty where it is used, else 1; a deviation of None is to be estimated.
    """
    weights: list[Array] = []
    sigma: list[float | None] = []
    sources: list[NoiseSource] = []
    problems = []
    columns = (("sigma_x, sigma_y, sigma_z", data.sigma_position), ("sigma_r", data.sigma_rotation))
    for (name, column), given in zip(columns, given_noise, strict=True):
        used = None if given is not None else column
        if used is not None and not np.all(used > 0):
            fix = "remove the column, or give `noise`"
            problems.append(Problem("the measuring uncertainty is 0, expected above 0", data.source, None, name, fix))
        weights.append(np.broadcast_to(1.0 if used is None or problems else 1.0 / used, (3, data.n)))
        sigma.append(given if used is None else 1.0)
        sources.append("given" if given is not None else "estimated" if used is None else "file")
    if problems:
        raise InputError(problems)
    parts = 1 if data.rotation is None else 2
    return weights[:parts], sigma[:parts], sources[:parts]


def _restricted_likelihood(
    data: Measurements, triangles: Sequence[Array], counts: Sequence[int], given_sigma: Sequence[float | None]
) -> list[float]:
    """Return standard deviations of position and orientation by REML, all columns treated as fixed effects.

    Fixed point of |r_k|² = σ_k² (n_k - tr(G^-1 G_k)), G_k the rows' part of the normal matrix G: H. D. Patterson,
    R. Thompson, "Recovery of inter-block information when block sizes are unequal", Biometrika 58 (1971).
    A deviation in ``given_sigma`` stays.
    """
    sigma = [
        given if given is not None else _rms_residual(triangle, n)
        for given, triangle, n in zip(given_sigma, triangles, counts, strict=True)
    ]
    for _ in range(_MAX_REML_ROUNDS):
        stacked = np.concatenate([triangle / std for triangle, std in zip(triangles, sigma, strict=True)])
        column_norms = np.sqrt(np.sum(np.square(stacked[:, :-1]), axis=0))
        column_norms[column_norms == 0.0] = 1.0
        u, singular_values, vt = np.linalg.svd(stacked[:, :-1] / column_norms, full_matrices=False)
        independent = (
            singular_values > RANK_TOLERANCE * singular_values[0] if singular_values.size else singular_values > 0
        )
        inverse = vt[independent].T / singular_values[independent]
        solution = inverse @ (u[:, independent].T @ stacked[:, -1])
        change = 0.0
        for k, (triangle, given) in enumerate(zip(triangles, given_sigma, strict=True)):
            if given is not None:
                continue
            rows = triangle[:, :-1] / column_norms
            residual = triangle[:, -1] - rows @ solution
            dof = counts[k] - float(np.sum(np.square((rows / sigma[k]) @ inverse)))
            if dof < 1.0:
                fix = "measure more poses, or give the noise with `noise` or sigma columns"
                raise InputError(Problem("too few poses to estimate the measurement noise", data.source, fix=fix))
            new_sigma = float(np.sqrt(residual @ residual / dof))
            if new_sigma < 1e-12 * _rms_residual(triangle, counts[k]) or new_sigma == 0.0:
                fix = "give the noise with `noise` or sigma columns"
                raise InputError(
                    Problem(
                        "the parameters explain every pose exactly, so the noise cannot be estimated",
                        data.source,
                        fix=fix,
                    )
                )
            change = max(change, abs(new_sigma / sigma[k] - 1.0))
            sigma[k] = new_sigma
        if change < 1e-10:
            break
    return sigma


def _rms_residual(triangle: Array, n: int) -> float:
    """Return the RMS residual as a start value; 1 if it is zero."""
    return float(np.linalg.norm(triangle[:, -1])) / np.sqrt(n) or 1.0


# Sufficient statistics of measured poses for the parameters' errors: as many numbers as there are parameters.
#
# All poses of one robot share the same parameter errors Δ. The residual of all poses together is
#
#     e = J Δ + ε,   Δ ~ N(0, V),   ε ~ N(0, Σ),   so   cov e = J V J^T + Σ,
#
# not a separate covariance for each pose. With W = Σ^(-1/2), A = W J V^(1/2) and the singular values A = U S Z^T,
#
#     y = U^T W e  has independent components  y_i ~ N(0, 1 + S_i²),
#     and W e is N(0, 1) in all other directions,
#
# exactly, with matrices no larger than the number of parameters. If base or tool were fitted to the same poses, the
# span of their columns is first projected out of A and e (the degrees of freedom that the fit used).

NEGLIGIBLE = 1e-4
"""Combinations of parameters with a predicted effect on all poses below this fraction of one standard deviation of the
noise are ignored: 1 + S² differs from 1 by 1e-8."""
_FRAME_MOTIONS = ("x", "y", "z", "turn_x", "turn_y", "turn_z")


@dataclass(frozen=True, slots=True)
class SufficientStatistics:
    """Whitened residual of all poses in the directions that the parameters' errors move."""

    names: tuple[str, ...]
    """Names of the P parameters."""
    effect: Array
    """``(R, P)`` U^T A: whitened effect of one standard deviation of each parameter; R directions."""
    strength: Array
    """``(R,)`` S, descending."""
    y: Array
    """``(R,)`` whitened residual in the R directions."""
    noise_squares: float
    """Sum of squares in all other directions, which contain noise only."""
    noise_dof: int
    n_poses: int
    n_values: int
    """Measured numbers: 3 or 6 a pose."""
    n_aligned: int
    """Combinations of base and tool coordinates that were fitted to the same poses."""
    noise: MeasurementNoise

    @property
    def noise_is_estimated(self) -> bool:
        """True if noise of position or orientation was estimated from the same poses."""
        return "estimated" in (self.noise.source_position, self.noise.source_orientation)


def reduce_residuals(
    robot: Robot,
    data: Measurements,
    parameters: Sequence[ToleranceParameter],
    *,
    noise: tuple[float | None, float | None] = (None, None),
    aligned: Sequence[str] = (),
) -> SufficientStatistics:
    """Reduce the residuals of measured poses to :class:`SufficientStatistics`.

    Args:
        robot: Robot with base and tool as registered; its effects are part of the command.
        data: Measured poses with joint variables.
        parameters: Parameters with predicted errors.
        noise: Standard deviation of position (m) and of orientation (rad) along each axis; None: from the file's
            columns, else estimated by restricted maximum likelihood from the part that no parameter explains.
        aligned: ``base_frame``, ``tool_frame`` or both, if fitted to these poses.

    Raises:
        InputError: There are too few poses to estimate the noise, or the noise is zero.
    """
    weights, stated, sources = _stated_noise(data, noise)
    triangles = _triangles(robot, data, parameters, weights, aligned)
    counts = [3 * data.n] * len(triangles)
    n_fixed = triangles[0].shape[1] - len(parameters) - 1
    sigma = _restricted_likelihood(data, triangles, counts, stated)
    stacked = np.concatenate([triangle / s for triangle, s in zip(triangles, sigma, strict=True)])
    projected, n_aligned = _project_out_registered(stacked, n_fixed)
    scaled, residual = projected[:, :-1], projected[:, -1]
    directions, strength, _ = np.linalg.svd(scaled, full_matrices=False)
    significant = strength > NEGLIGIBLE
    directions, strength = directions[:, significant], strength[significant]
    y = directions.T @ residual
    oriented = data.rotation is not None
    in_file = [
        mean if source == "file" and mean is not None else std
        for std, source, mean in zip(sigma, sources, data.stated_noise, strict=False)
    ]
    noise_squares = max(float(residual @ residual - y @ y), 0.0)
    return SufficientStatistics(
        tuple(parameter.name for parameter in parameters),
        directions.T @ scaled,
        strength,
        y,
        noise_squares,
        sum(counts) - n_aligned - int(significant.sum()),
        data.n,
        sum(counts),
        n_aligned,
        MeasurementNoise(in_file[0], in_file[1] if oriented else None, sources[0], sources[1] if oriented else None),
    )


def _triangles(
    robot: Robot,
    data: Measurements,
    parameters: Sequence[ToleranceParameter],
    weights: Sequence[Array],
    aligned: Sequence[str],
) -> list[Array]:
    """Return the R factors of [fitted columns, A, residual] of position and of orientation, with weights."""
    predicted = Model.of(robot).bind(data).poses(np.zeros(0))
    arm = Arm.of(robot)
    # Effects move the columns of the Jacobian in second order only.
    scalars = Model.of(dataclasses.replace(robot, effects=())).bind(data).nominal
    fixed = _registered_motions(arm, data, aligned)
    motions = [*(motion for motion, _ in fixed), *(parameter.motion for parameter in parameters)]
    n_columns = len(motions) + 1
    triangles = [np.zeros((0, n_columns)) for _ in weights]
    for block in arm.chain.blocks(data.n):
        columns = np.empty((6, n_columns, block.stop - block.start))
        local: list[Scalar] = [scalar if isinstance(scalar, float) else scalar[block] for scalar in scalars]
        columns[:, :-1] = arm.chain.sweep(local, block.stop - block.start, motions).jacobian
        for k, (_, rows) in enumerate(fixed):
            columns[:, k] *= 1.0 if rows is None else rows[block]
        columns[:, len(fixed) : -1] *= np.array([parameter.sd for parameter in parameters])[:, None]
        at = Poses(predicted.rotation[..., block], predicted.translation[..., block])
        columns[: 3 * len(weights), -1] = residuals(data.subset(block), at)
        for part, weight in enumerate(weights):
            weighted = columns[3 * part : 3 * part + 3] * weight[:, None, block]
            stacked = np.concatenate((triangles[part], weighted.transpose(0, 2, 1).reshape(-1, n_columns)))
            triangles[part] = np.asarray(np.linalg.qr(stacked, mode="r"))
    return triangles


def _registered_motions(arm: Arm, data: Measurements, aligned: Sequence[str]) -> list[tuple[int, Array | None]]:
    """Return the motions that were fitted, each with the rows that it moves (None: all)."""
    columns: list[tuple[int, Array | None]] = []
    if "base_frame" in aligned:
        columns += [(arm.chain.index(BASE, label), None) for label in _FRAME_MOTIONS]
    if "tool_frame" in aligned:
        targets = tuple(arm.robot.targets) if data.target is not None else ()
        for target in targets or (None,):
            rows = None if target is None else (np.asarray(data.target) == target).astype(float)
            columns += [(arm.chain.index(TOOL, label), rows) for label in _FRAME_MOTIONS]
    return columns


def _project_out_registered(stacked: Array, n_fixed: int) -> tuple[Array, int]:
    """Return the other columns outside the span of the first ``n_fixed``, and the dimension of that span."""
    if n_fixed == 0:
        return stacked, 0
    fixed = stacked[:, :n_fixed]
    column_norms = np.sqrt(np.sum(np.square(fixed), axis=0))
    u, singular_values, _ = np.linalg.svd(fixed / np.where(column_norms > 0, column_norms, 1.0), full_matrices=True)
    absorbed = int(np.sum(singular_values > RANK_TOLERANCE * singular_values[0]))
    return u[:, absorbed:].T @ stacked[:, n_fixed:], absorbed


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
    at_prediction = np.zeros(len(problem.names))
    log_factors, maximum = problem.maximise(at_prediction)
    information = problem.evaluate(at_prediction)[2]
    notes, components = [], []
    for index, name in enumerate(problem.names):
        members = [parameter for parameter in parameters if parameter.component == name]
        dof = 2.0 * _marginal_information(information, index)
        reason = _unidentified_reason(problem.names, information, index, dof)
        predicted = math.sqrt(float(np.mean([parameter.sd**2 for parameter in members])))
        factor = math.exp(0.5 * log_factors[index]) if log_factors[index] > _LOG_FACTOR_MIN + 1.0 else 0.0
        threshold = chi2_quantile(confidence, 1.0) * bartlett_mean(max(dof, _MIN_DOF))
        lower, upper = problem.profile_interval(index, log_factors, maximum, threshold)
        ratio = max(0.0, 2.0 * (maximum - problem.maximise(log_factors, (index, 0.0))[1]))
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

    def maximise(self, start: Array, held: tuple[int, float] | None = None) -> tuple[Array, float]:
        """Return the most likely log φ, with one component ``held`` at a value if given, and its log-likelihood.

        Fisher scoring with the step shortened until the likelihood rises.
        """
        eta = start.copy()
        free = np.ones(eta.size, dtype=bool)
        if held is not None:
            eta[held[0]], free[held[0]] = held[1], False
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
            for _ in range(30):
                trial_eta = np.clip(eta + step, _LOG_FACTOR_MIN, _LOG_FACTOR_MAX)
                candidate = self.evaluate(trial_eta)
                if candidate[0] > log_likelihood:
                    break
                step *= 0.5
            else:
                break
            converged = candidate[0] - log_likelihood < _LIKELIHOOD_TOLERANCE
            eta, (log_likelihood, score, information) = trial_eta, candidate
            if converged:
                break
        return eta, log_likelihood

    def profile_interval(self, index: int, eta: Array, maximum: float, threshold: float) -> tuple[float, float | None]:
        """Return the factors √φ at which twice the profile log-likelihood is ``threshold`` below its maximum."""
        limits: list[float | None] = []
        for sign, bound in ((-1.0, _LOG_FACTOR_MIN), (1.0, _LOG_FACTOR_MAX)):
            inside, start, step, outside = float(eta[index]), eta, 0.5, None
            while sign * (bound - inside) > 0.0 and (outside is None or abs(outside - inside) > 1e-3):
                trial = 0.5 * (inside + outside) if outside is not None else inside + sign * step
                trial = max(min(trial, _LOG_FACTOR_MAX), _LOG_FACTOR_MIN)
                best_eta, log_likelihood = self.maximise(start, (index, trial))
                if 2.0 * (maximum - log_likelihood) > threshold:
                    outside = trial
                else:
                    inside, start, step = trial, best_eta, 2.0 * step
            limits.append(None if outside is None else math.exp(0.25 * (inside + outside)))
        return limits[0] or 0.0, limits[1]


def _marginal_information(information: Array, index: int) -> float:
    """Return the information on component ``index`` with the other components free."""
    cross = np.delete(information[:, index], index)
    others = np.delete(np.delete(information, index, axis=0), index, axis=1)
    return max(0.0, float(information[index, index] - cross @ np.linalg.pinv(others, rcond=1e-12) @ cross))


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
