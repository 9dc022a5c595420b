"""Comparison of the prediction with measured poses of one robot: tests and estimated variance components.

The measured poses are reduced to sufficient statistics. They decide the tests of the predicted covariance, and the
variance components. Tests and components are mappings with the keys of the result (``robacc show schema predict``).
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, Literal

import numpy as np

from robacc.accuracy.estimation import check_confidence
from robacc.effects.base import Part, Term, effect_class
from robacc.errors import Problem, applying, refuse
from robacc.fitting import registration
from robacc.fitting.levels import EPSILON
from robacc.fitting.normal_equations import most_likely, whitening
from robacc.geometry import Array, rms_length
from robacc.measurements import Measurements
from robacc.modelling.model import Model, predict, residuals
from robacc.prediction.predicting import ToleranceParameter
from robacc.robots.description import Robot
from robacc.statistics.intervals import chi2_cdf, chi2_quantile, chi2_sf

# Measurement noise of the poses: given, from the file's columns, or estimated from the poses themselves.

Noise = tuple[float | None, float | None]
"""Standard deviation of the position (m) and the orientation (rad) along each axis; None where it is not given."""
RANK_TOLERANCE = 1e-9
"""Singular values below this fraction of the largest are rounding."""


def _stated_noise(
    data: Measurements, given_noise: Noise
) -> list[tuple[Array, float | None, Literal["file", "given", "estimated"]]]:
    """Return weights ``(3, N)``, standard deviation beside them, and source of the noise of each measured part.

    Weights are reciprocals of the file's uncertainty where it is used, else 1; a deviation of None is to be estimated.
    """
    columns = data.sigma_position, data.sigma_rotation
    used = [column if given is None else None for column, given in zip(columns, given_noise, strict=True)]
    message, fix = "the measuring uncertainty is 0, expected above 0", "remove the column, or give `noise`"
    wrong = [
        Problem(message, data.source, None, name, fix)
        for name, column in zip(("sigma_x, sigma_y, sigma_z", "sigma_r"), used, strict=True)
        if column is not None and not np.all(column > 0)
    ]
    refuse((wrong, wrong))
    return [
        (np.ones((3, data.n)), given, "estimated" if given is None else "given")
        if column is None
        else (np.broadcast_to(1.0 / column, (3, data.n)), 1.0, "file")
        for column, given in list(zip(used, given_noise, strict=True))[: 1 if data.rotation is None else 2]
    ]


def _restricted_likelihood(
    data: Measurements, triangles: Sequence[Array], given_sigma: Sequence[float | None]
) -> list[float]:
    """Return standard deviations of position and orientation by REML, all columns treated as fixed effects.

    Fixed point of |r_k|² = σ_k² (n - tr(G^-1 G_k)), G_k the rows' part of the normal matrix G: H. D. Patterson,
    R. Thompson, "Recovery of inter-block information when block sizes are unequal", Biometrika 58 (1971).
    A deviation in ``given_sigma`` stays.
    """
    n, give = 3 * data.n, "give the noise with `noise` or sigma columns"
    few = Problem("too few poses to estimate the measurement noise", data.source, fix=f"measure more poses, or {give}")
    exact = Problem(
        "the parameters explain every pose exactly, so the noise cannot be estimated", data.source, fix=give
    )
    rms = [float(np.linalg.norm(triangle[:, -1])) / math.sqrt(n) or 1.0 for triangle in triangles]
    sigma = np.array([start if given is None else given for given, start in zip(given_sigma, rms, strict=True)])
    for _ in range(200):
        before = sigma.copy()
        stacked = np.concatenate([triangle / std for triangle, std in zip(triangles, sigma, strict=True)])
        column_norms = _norms(stacked[:, :-1])
        inverse = np.linalg.pinv(stacked[:, :-1] / column_norms, rcond=RANK_TOLERANCE)
        for k in (k for k, given in enumerate(given_sigma) if given is None):
            rows = triangles[k][:, :-1] / column_norms
            dof = n - float(np.sum(np.square((rows / sigma[k]) @ inverse)))
            refuse((dof < 1.0, few))
            sigma[k] = np.linalg.norm(triangles[k][:, -1] - rows @ (inverse @ stacked[:, -1])) / math.sqrt(dof)
            refuse((sigma[k] < 1e-12 * rms[k] or sigma[k] == 0.0, exact))
        if np.all(np.abs(sigma / before - 1.0) < 1e-10):
            break
    return [float(std) for std in sigma]


def _norms(columns: Array) -> Array:
    """Return the lengths of columns, 1 for a column of zeros."""
    norms = np.sqrt(np.sum(np.square(columns), axis=0))
    return np.where(norms > 0.0, norms, 1.0)


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


@dataclass(frozen=True, slots=True)
class SufficientStatistics:
    """Whitened residual of all poses in the directions that the parameters' errors move."""

    effect: Array
    """``(R, P)`` U^T A: whitened effect of one standard deviation of each of P parameters; R directions."""
    strength: Array
    """``(R,)`` S, descending."""
    y: Array
    """``(R,)`` whitened residual in the R directions."""
    noise_squares: float
    """Sum of squares in all other directions, which contain noise only."""
    noise_dof: int
    n_poses: int
    n_aligned: int
    """Combinations of base and tool coordinates that were fitted to the same poses."""
    noise: Mapping[str, Any]
    """Noise along each axis, root mean square over poses and axes, and the source of each."""


def reduce_residuals(
    robot: Robot,
    data: Measurements,
    parameters: Sequence[ToleranceParameter],
    *,
    noise: Noise = (None, None),
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
    weights, stated, sources = zip(*_stated_noise(data, noise), strict=True)
    data = data if sources[0] == "file" else replace(data, noise_covariance=None)
    triangles = _triangles(robot, data, parameters, weights, aligned)
    n_fixed = triangles[0].shape[1] - len(parameters) - 1
    sigma = _restricted_likelihood(data, triangles, stated)
    stacked = np.concatenate([triangle / s for triangle, s in zip(triangles, sigma, strict=True)])
    # What base and tool explain is taken out.
    basis, sizes, _ = np.linalg.svd(stacked[:, :n_fixed] / _norms(stacked[:, :n_fixed]), full_matrices=True)
    n_aligned = int(np.sum(sizes > RANK_TOLERANCE * sizes.max(initial=0.0)))
    projected = basis[:, n_aligned:].T @ stacked[:, n_fixed:]
    scaled, residual = projected[:, :-1], projected[:, -1]
    directions, strength, _ = np.linalg.svd(scaled, full_matrices=False)
    significant = strength > NEGLIGIBLE
    directions, strength = directions[:, significant], strength[significant]
    y = directions.T @ residual
    in_file = [
        mean if source == "file" else std for std, source, mean in zip(sigma, sources, data.stated_noise, strict=False)
    ]
    return SufficientStatistics(
        directions.T @ scaled,
        strength,
        y,
        max(float(residual @ residual - y @ y), 0.0),
        3 * data.n * len(triangles) - n_aligned - strength.size,
        data.n,
        n_aligned,
        {
            "position_m": in_file[0],
            "orientation_rad": in_file[1] if len(in_file) > 1 else None,
            "source_position": sources[0],
            "source_orientation": sources[1] if len(sources) > 1 else None,
        },
    )


def _triangles(
    robot: Robot,
    data: Measurements,
    parameters: Sequence[ToleranceParameter],
    weights: Sequence[Array],
    aligned: Sequence[str],
) -> list[Array]:
    """Return the R factors of [fitted columns, A, residual] of position and of orientation, with weights."""
    model = Model.of(robot)
    frames = tuple(effect_class(name).default(model.arm, data) for name in registration.ALIGNABLE if name in aligned)
    moved = tuple(Term(parameter.name, "", 1.0, (Part(parameter.motion),)) for parameter in parameters)
    triangles: list[list[Array]] = [[] for _ in weights]
    for block in model.arm.chain.blocks(data.n):
        part = data.subset(block)
        # Effects move the columns of the Jacobian in second order only.
        rigid = Model(model.arm, (), frames).bind(part)
        size = np.array([1.0] * len(rigid.terms) + [parameter.sd for parameter in parameters])
        jacobian = replace(rigid, terms=(*rigid.terms, *moved)).linearise(np.zeros(size.size))[1]
        error = residuals(part, model.bind(part).poses(np.zeros(0)))
        columns = np.concatenate((jacobian[: len(error)] * size[:, None], error[:, None]), axis=1)
        for number, weight in enumerate(weights):
            white = whitening(weight[:, block], noise=None if number else part.correlated_noise)
            weighted = white.apply(columns[3 * number : 3 * number + 3].swapaxes(0, 1)).transpose(1, 2, 0)
            stacked = np.concatenate((*triangles[number], weighted.reshape(-1, columns.shape[1])))
            triangles[number] = [np.asarray(np.linalg.qr(stacked, mode="r"))]
    return [triangle for (triangle,) in triangles]


# Tests of the measured errors against the prediction, with all poses of one robot treated jointly.
#
# Both tests use :class:`SufficientStatistics`: y_i ~ N(0, 1 + S_i²)
# independent, all other directions N(0, 1).
#
# - Chi-square: the normalised squared error e^T (J V J^T + Σ)^-1 e is Σ y_i²/(1 + S_i²) + |other directions|², with as
#   many degrees of freedom as measured numbers (less those used by registration). Most of these depend on the noise
#   only;
#   the first sum, with one degree of freedom for each direction that the parameters move, depends on the tolerances.
# - Likelihood ratio of the predicted covariance V against s² V with s² estimated. With about twenty directions of very
#   different strength the chi-square limit is inaccurate, so the null distribution is simulated from the prediction.

DRAWS = 1999
"""Samples of the likelihood ratio's null distribution; a p-value is a multiple of 1/2000, its error at 5 % is 0.5 %."""
SIGNIFICANT = 0.05


def chi_square(statistic: float, dof: int) -> Mapping[str, float] | None:
    """Return the test of a sum of squares against its chi-square distribution; None without degrees of freedom.

    It has the 95 % range of the statistic if the prediction is right, a two-sided p-value, and the ratio of the
    statistic to its expectation.
    """
    if dof < 1:
        return None
    lower, upper = (chi2_quantile(tail, dof) for tail in (0.5 * SIGNIFICANT, 1.0 - 0.5 * SIGNIFICANT))
    return {
        "statistic": statistic,
        "dof": dof,
        "lower": lower,
        "upper": upper,
        "p_value": min(2.0 * min(chi2_cdf(statistic, dof), chi2_sf(statistic, dof)), 1.0),
        "ratio": statistic / dof,
    }


def consistency(
    statistics: SufficientStatistics, *, seed: int = 0
) -> tuple[Mapping[str, Mapping[str, float] | None], Mapping[str, float] | None, str]:
    """Return tests of the measured errors against the prediction, that of a common scale, and a conclusion as text.

    The tests are by what they are of: ``total``, all measured numbers; ``parameters``, the directions that the errors
    of the parameters move, None if there are none; ``noise``, all others. Total and noise are None if these estimate
    the noise. ``seed`` is the seed of the likelihood ratio's null distribution.
    """
    normalised_squares = float(np.sum(np.square(statistics.y) / (1.0 + np.square(statistics.strength))))
    n_directions = statistics.y.size
    parameters = chi_square(normalised_squares, n_directions)
    total = noise = None
    if "estimated" not in statistics.noise.values():
        total = chi_square(normalised_squares + statistics.noise_squares, n_directions + statistics.noise_dof)
        noise = chi_square(statistics.noise_squares, statistics.noise_dof)
    scale = scale_test(statistics.y, np.square(statistics.strength), seed) if n_directions else None
    if parameters is None or scale is None:
        verdict = "the predicted errors are far below the noise on these poses, so the tolerances cannot be tested"
    elif scale["p_value"] < SIGNIFICANT:
        verdict = (
            f"the measured errors are {'larger' if scale['factor'] > 1.0 else 'smaller'} than the tolerances predict: "
            f"about {scale['factor']:.2g} times the predicted size"
        )
    elif parameters["p_value"] < SIGNIFICANT:
        verdict = (
            "the measured errors have the predicted size but not the predicted pattern: some parameters have larger "
            "errors, or there are causes other than these parameters"
        )
    else:
        verdict = "the measured errors are consistent with the tolerances"
    if parameters is not None and noise is not None and noise["p_value"] < SIGNIFICANT:
        verdict += f"; the part that no parameter explains is {math.sqrt(noise['ratio']):.2g} times the stated noise"
        verdict += ": effects other than these parameters, or more noise than stated" * (noise["ratio"] > 1.0)
    return {"total": total, "parameters": parameters, "noise": noise}, scale, verdict


def scale_test(y: Array, variances: Array, seed: int = 0) -> Mapping[str, float]:
    """Test y_i ~ N(0, 1 + v_i) against N(0, 1 + s² v_i): the likelihood ratio of the prediction against a scaled one.

    Args:
        y: ``(R,)``
        variances: ``(R,)`` v, above zero.
        seed: Seed of the null distribution.

    Returns:
        The estimated common factor s of all tolerances, the statistic, its p-value from draws of the prediction, and
        the p-value from a chi-square distribution for comparison.
    """
    squared_factor, ratio = (float(value[0]) for value in _likelihood_ratios(y[None], variances))
    n_larger = int(np.count_nonzero(_null_distribution(variances.tobytes(), seed) >= ratio - 1e-9))
    return {
        "factor": math.sqrt(squared_factor),
        "statistic": ratio,
        "p_value": (1.0 + n_larger) / (1.0 + DRAWS),
        "p_value_asymptotic": chi2_sf(ratio, 1.0),
        "draws": DRAWS,
    }


@lru_cache(maxsize=16)
def _null_distribution(variances: bytes, seed: int) -> Array:
    """Return samples of the likelihood ratio under the prediction."""
    sizes = np.frombuffer(variances)
    y = np.random.default_rng(seed).standard_normal((DRAWS, sizes.size)) * np.sqrt(1.0 + sizes)
    return _likelihood_ratios(y, sizes)[1]


def _likelihood_ratios(y: Array, variances: Array) -> tuple[Array, Array]:
    """Return the most likely s² and the likelihood ratio, ``(D,)`` each, for samples ``(D, R)``."""
    squares = np.square(y)

    def log_likelihood(log_factor: Array) -> Array:
        """Return twice the log-likelihood, ``(D, F)``, at logarithms ``(D, F)`` of s²."""
        total = 1.0 + np.exp(log_factor)[..., None] * variances
        return np.asarray(-np.sum(np.log(total) + squares[:, None, :] / total, axis=-1))

    best = np.zeros((y.shape[0], 1))
    at_prediction = log_likelihood(best)[:, 0]
    # Grids of log s², the first over a factor of a million in variance, each of the others about the best of those
    # before: the first locates the highest of possibly several maxima.
    for grid in (np.linspace(-14.0, 14.0, 57), *(0.5**power * np.linspace(-1.0, 1.0, 9) for power in range(1, 15, 2))):
        values = log_likelihood(best + grid)
        best = best + grid[np.argmax(values, axis=1)][:, None]
    # s² = 0, no effect of the parameters, is a limit that the grid cannot reach.
    highest, no_effect = np.max(values, axis=1), -np.sum(squares, axis=1)
    factor = np.where(no_effect >= highest, 0.0, np.exp(best[:, 0]))
    return factor, np.maximum(np.maximum(highest, no_effect) - at_prediction, 0.0)


# Variance components by maximum likelihood.
#
# Each kind of parameter (theta, d, a, alpha; for a URDF the offsets, and the lengths and angles of origins) has its
# predicted variances times one factor φ_c, so the sufficient statistic y
# above has the distribution
#
#     y ~ N(0, C),  C = I + K_0 + Σ_c φ_c K_c,  K_c = E_c E_c^T,
#
# with E_c the whitened effects of one predicted standard deviation of each parameter of the kind, and K_0 those of base
# and tool, whose tolerances are not estimated. The log-likelihood is -(log|C| + y^T C^-1 y)/2; score and expected
# information in log φ by S. R. Searle, G. Casella, C. E. McCulloch, Variance Components (1992), 6.2 and 6.3.
#
# A kind has as many degrees of freedom as it has identifiable parameters, six for six joints: a variance from six
# numbers is known to a factor of about three, regardless of the number of poses. Intervals are by profile likelihood
# with Bartlett's correction for that many degrees of freedom: for a variance from n Gaussian numbers the likelihood
# ratio at the truth has mean n (log(n/2) - ψ(n/2)) rather than 1 (M. S. Bartlett, Proc. Royal Society A 160 (1937)
# 268-282).

GIVEN = frozenset({"base", "tool"})
"""Components that are not estimated: a frame has too few lengths and angles, too different to share a factor."""
_LOG_FACTOR_MIN, _LOG_FACTOR_MAX = -16.0, 16.0
"""Range of log φ; a factor at its lower end counts as zero."""
_MIN_DOF = 1.0
"""Smallest number of degrees of freedom, with the other components free, of an estimated component."""

Likelihood = Callable[[Array], tuple[float, Array, Array]]
"""Returns log-likelihood, score and expected information at log φ ``(C,)``."""


def variance_components(
    statistics: SufficientStatistics, parameters: Sequence[ToleranceParameter], confidence: float = 0.95
) -> Mapping[str, Any] | None:
    """Estimate one factor for each kind of parameter; return None if no parameter affects the poses.

    The numbers of a component that is not identifiable, for the reason ``why``, are unreliable.

    Args:
        statistics: Sufficient statistics of the poses for ``parameters``.
        parameters: Parameters with predicted errors, in the order of the statistics.
        confidence: Confidence of the intervals.
    """
    is_given = np.array([parameter.component in GIVEN for parameter in parameters], dtype=bool)
    estimated = [parameter.component for parameter in parameters if parameter.component not in GIVEN]
    names = tuple(dict.fromkeys(estimated))
    if statistics.y.size == 0 or not names:
        return None
    member = np.array([[float(component == name) for component in estimated] for name in names])
    given_effects = statistics.effect[:, is_given]
    fixed = np.eye(statistics.y.size) + given_effects @ given_effects.T
    likelihood = _likelihood(statistics.y, statistics.effect[:, ~is_given], member, fixed)
    log_factors, maximum = _maximised(likelihood, np.zeros(len(names)))
    information = likelihood(np.zeros(len(names)))[2]
    components: list[dict[str, Any]] = []
    for index, name in enumerate(names):
        members = [parameter for parameter in parameters if parameter.component == name]
        cross = np.delete(information[:, index], index)
        others = np.linalg.pinv(np.delete(np.delete(information, index, axis=0), index, axis=1), rcond=1e-12)
        dof = 2.0 * max(0.0, float(information[index, index] - cross @ others @ cross))
        predicted = math.sqrt(float(np.mean([parameter.sd**2 for parameter in members])))
        factor = math.exp(0.5 * log_factors[index]) if log_factors[index] > _LOG_FACTOR_MIN + 1.0 else 0.0
        threshold = chi2_quantile(confidence, 1.0) * bartlett_mean(max(dof, _MIN_DOF))
        lower, upper = _profile_interval(likelihood, index, log_factors, maximum, threshold)
        at_prediction = _maximised(likelihood, log_factors, (index, 0.0))[1]
        components.append(
            {
                "name": name,
                "n_parameters": len(members),
                "unit": members[0].unit,
                "predicted": predicted,
                "factor": factor,
                "estimate": factor * predicted,
                "lower": lower,
                "upper": upper,
                "dof": dof,
                "likelihood_ratio": max(0.0, 2.0 * (maximum - at_prediction)),
                "why": _unidentified_reason(names, information, index, dof),
            }
        )
    not_estimated = sorted({parameter.component for parameter in parameters} & GIVEN)
    notes = applying(
        *((component["why"], component["why"]) for component in components),
        (not_estimated, f"the tolerances of {' and '.join(not_estimated)} are used as given, not estimated"),
    )
    return {"confidence": confidence, "components": components, "notes": notes}


def bartlett_mean(dof: float) -> float:
    """Return n (log(n/2) - ψ(n/2)), the mean likelihood ratio at the truth of a variance from n = ``dof`` numbers."""
    from scipy.special import digamma

    return dof * (math.log(0.5 * dof) - float(digamma(0.5 * dof)))


def _likelihood(y: Array, effect: Array, member: Array, fixed: Array) -> Likelihood:
    """Return the likelihood of log φ.

    Args:
        y: ``(R,)``
        effect: ``(R, P)`` effects of the parameters of estimated components.
        member: ``(C, P)`` 1 if the parameter belongs to the component.
        fixed: ``(R, R)`` I + K_0
    """

    def evaluate(eta: Array) -> tuple[float, Array, Array]:
        phi = np.exp(eta)
        triangle = np.linalg.cholesky(fixed + (effect * (phi @ member)) @ effect.T)
        solved = np.linalg.solve(triangle, np.column_stack((effect, y)))
        products = solved[:, :-1].T @ solved
        gram, gradient_term = products[:, :-1], products[:, -1]
        log_likelihood = -float(np.sum(np.log(np.diag(triangle)))) - 0.5 * float(solved[:, -1] @ solved[:, -1])
        score = 0.5 * phi * (member @ (np.square(gradient_term) - np.diag(gram)))
        return log_likelihood, score, 0.5 * np.outer(phi, phi) * (member @ np.square(gram) @ member.T)

    return evaluate


def _maximised(likelihood: Likelihood, start: Array, held: tuple[int, float] | None = None) -> tuple[Array, float]:
    """Return the most likely log φ, with one component ``held`` at a value if given, and its log-likelihood."""
    bounds = np.full((2, start.size), [[_LOG_FACTOR_MIN], [_LOG_FACTOR_MAX]])
    if held is not None:
        bounds[:, held[0]] = held[1]
    return most_likely(lambda eta, least: likelihood(eta), start, bounds, gains=EPSILON)


def _profile_interval(
    likelihood: Likelihood, index: int, eta: Array, maximum: float, threshold: float
) -> tuple[float, float | None]:
    """Return the factors √φ at which twice the profile log-likelihood is ``threshold`` below its maximum.

    The upper one is None if the poses give no upper limit.
    """
    from scipy.optimize import brentq

    def excess(log_factor: float) -> float:
        return 2.0 * (maximum - _maximised(likelihood, eta, (index, log_factor))[1]) - threshold

    lower, upper = (
        math.exp(0.5 * brentq(excess, eta[index], bound, xtol=1e-6)) if excess(bound) > 0.0 else None
        for bound in (_LOG_FACTOR_MIN, _LOG_FACTOR_MAX)
    )
    return lower or 0.0, upper


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
    order = np.argsort(-correlations)
    partners = [names[i] for i in order if correlations[i] > 0.5] or [names[order[0]]]
    return f"{names[index]} is not distinguishable from {' and '.join(partners)} on these poses"


def compare_with_measured(
    robot: Robot,
    data: Measurements,
    parameters: Sequence[ToleranceParameter],
    *,
    align: Sequence[str] = (),
    noise: Noise = (None, None),
    confidence: float = 0.95,
    seed: int = 0,
) -> Mapping[str, Any]:
    """Test the measured errors against the prediction, and estimate the tolerances from them.

    Return the tests, the components and the verdict with the keys of the result.

    Args:
        robot: Nominal robot; its effects are part of the command.
        data: Measured poses with joint variables.
        parameters: Parameters with predicted errors.
        align: ``base_frame``, ``tool_frame`` or both are fitted to the poses first.
        noise: See :func:`reduce_residuals`.
        confidence: Confidence of the components' intervals.
        seed: Seed of the likelihood ratio's null distribution.

    Raises:
        InputError: There are no poses or no joints, or the noise cannot be estimated.
        UsageError: The noise is not positive, the confidence is out of range, or a frame cannot be fitted.
    """
    lacking = "has no joint columns: the comparison needs the joint values"
    refuse(
        (data.n == 0, Problem("has no poses to compare with the prediction", data.source)),
        (data.q is None, Problem(lacking, data.source, fix="add q1, q2, …")),
        (not all(std is None or 0.0 < std < math.inf for std in noise), "`noise` is a standard deviation above 0"),
    )
    check_confidence(confidence)
    # With fewer poses, base and tool absorb everything that was measured.
    refuse(
        (
            bool(align) and data.n < 3,
            Problem(
                f"fitting frames to {data.n} poses leaves no errors to compare",
                data.source,
                fix="measure more poses, or leave out `align`",
            ),
        )
    )
    alignment = registration.align(robot, data, align) if align else None
    registered_robot = robot if alignment is None else alignment.robot
    statistics = reduce_residuals(registered_robot, data, parameters, noise=noise, aligned=tuple(align))
    errors = residuals(data, predict(registered_robot, data))
    tests, scale, verdict = consistency(statistics, seed=seed)
    hint = None
    # Errors larger than the prediction by this factor come from frames or units, not from tolerances.
    if scale is not None and scale["factor"] >= 20.0:
        cause = (
            'frames that do not agree; try `align="base_frame,tool_frame"`'
            if alignment is None
            else "units, joint signs or the order of the joints, not from tolerances"
        )
        hint = f"errors this large come from {cause}"
    return {
        "n_poses": data.n,
        "measured": {
            "position_rms_m": rms_length(errors[:3]),
            "orientation_rms_rad": None if data.rotation is None else rms_length(errors[3:]),
        },
        "alignment": alignment
        and {
            "what": alignment.effects,
            "degrees_of_freedom": statistics.n_aligned,
            "parameters": alignment.parameters,
        },
        "noise": statistics.noise,
        "verdict": verdict,
        "hint": hint,
        "normalised_squared_error": tests,
        "likelihood_ratio": scale,
        "variance_components": variance_components(statistics, parameters, confidence),
        "one_draw": _one_draw(statistics),
    }


def _one_draw(statistics: SufficientStatistics) -> str:
    n, n_directions = statistics.n_poses, statistics.y.size
    text = (
        f"all {n} poses are of one robot and share the same parameter errors, so they are not {n} independent tests of "
        "the tolerances. The tests use the covariance of all poses, J V Jᵀ + noise. Of "
        f"{n_directions + statistics.noise_dof + statistics.n_aligned} measured numbers, {n_directions} depend on the "
        "parameters"
    )
    more = "more robots improve it, more poses do not" if statistics.noise_dof else "more poses would improve it"
    # The standard deviation of a variance from n Gaussian numbers is sqrt(2/n), of its root half that.
    size = 100 / math.sqrt(2 * max(n_directions, 1))
    further = applying(
        (n_directions, f": the size of the tolerances is known to about {size:.0f} %; {more}"),
        (
            statistics.n_aligned,
            f". Fitting the frames used {statistics.n_aligned} degrees of freedom, which are not counted",
        ),
    )
    return "".join((text, *further))
