"""The likelihood of the error model, and its structure."""

import dataclasses
import functools
from functools import cache

import independent_arm
import numpy as np
import pytest
from arms import arm
from scipy.stats import multivariate_normal

from robacc.effects.base import Effect
from robacc.effects.periodic import TransmissionError
from robacc.effects.specification import build, parse_requests
from robacc.error_model.covariance import (
    GROSS_FACTORS,
    TERMS,
    CovarianceParameters,
    Linearised,
    Rows,
    estimated,
    likelihood_derivatives,
    log_evidence,
    too_many_gross_errors,
    unaccounted,
    whitened,
    with_gross_errors,
)
from robacc.error_model.structure import with_error_structure
from robacc.fitting.fit_result import Fit, Options
from robacc.fitting.levels import ACCEPTED
from robacc.fitting.normal_equations import GAIN
from robacc.fitting.solver import fit
from robacc.fitting.visits import row_ranks
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.robots.arm import Arm
from robacc.simulation.simulate import Plan, simulate

NOISE = 2e-5


@cache
def linearised(orientation: bool = False, n: int = 24) -> Linearised:
    """Return the frames of an arm linearised on poses with three rows a visit, and two visits a place."""
    robot = dataclasses.replace(arm("irb1600").robot, effects=())
    data = simulate(robot, Plan(n, seed=3, noise_position=NOISE, orientation=orientation, time_step=20.0)).data
    visit = np.repeat(np.arange(n // 3), 3)
    q = data.q[:, 6 * (np.arange(n) // 6)]
    data = dataclasses.replace(data, q=q, visit=visit.astype(str), pose=(visit // 2).astype(str))
    model = Model.of(robot)
    model = model.with_free(*build(parse_requests("base_frame,joint_offset"), model.arm, data))
    bound = model.bind(data)
    theta = np.zeros(len(bound.terms))
    return Linearised.at(bound, theta, np.full(theta.size, 1e-3), Rows.of(model.arm, data, row_ranks(data)), data)


def noise_with(linear: Linearised, *names: str) -> CovarianceParameters:
    """Return noise with terms at their starts, moved a little from symmetric values."""
    kinds = linear.y.shape[1] // 3
    factor = np.ones(len(linear.y))
    factor[4] = GROSS_FACTORS[1]
    noise = CovarianceParameters(np.log([NOISE, 1e-4][:kinds]), factor)
    rng = np.random.default_rng(5)
    for name in names:
        start = TERMS[name].starts(linear, noise.std)[0]
        noise = noise.with_term(name, start + rng.normal(scale=0.2, size=start.shape))
    return noise


def dense(noise: CovarianceParameters, linear: Linearised) -> Array:
    """Return the covariance of all rows, pose by pose, by sums over pairs of rows."""
    count, components = linear.y.shape
    matrix = np.zeros((count, components, count, components))
    for name, parameters in noise.terms.items():
        for carrier, kernel in enumerate(TERMS[name].kernels(parameters, linear.rows)):
            for i in range(count):
                for k in range(count):
                    if TERMS[name].of_joints:
                        left, right = linear.joints[carrier][:, i], linear.joints[carrier][:, k]
                        matrix[i, :, k] += kernel[i, k] * np.outer(left, right)
                    else:
                        matrix[i, carrier, k, carrier] += kernel[i, k]
    flat = matrix.reshape(count * components, -1)
    flat += np.diag(np.square(noise.independent(linear.rows.stated)).ravel())
    columns = (linear.columns * linear.prior_std).reshape(count * components, -1)
    result: Array = flat + columns @ columns.T
    return result


CASES = [(), *((name,) for name in TERMS), tuple(TERMS)]


@pytest.mark.parametrize("names", CASES, ids=lambda names: "+".join(names) or "independent")
@pytest.mark.parametrize("orientation", [False, True])
def test_the_likelihood_is_the_dense_gaussian_density(names: tuple[str, ...], orientation: bool) -> None:
    linear = linearised(orientation)
    noise = noise_with(linear, *names)
    density = multivariate_normal(cov=dense(noise, linear), allow_singular=False).logpdf(linear.y.ravel())
    density += 0.5 * linear.y.size * np.log(2 * np.pi)
    assert whitened(noise, linear).log_likelihood == pytest.approx(density, rel=1e-8)
    assert likelihood_derivatives(noise, linear)[0] == pytest.approx(density, rel=1e-8)


@pytest.mark.parametrize("names", CASES, ids=lambda names: "+".join(names) or "independent")
def test_the_gradient_is_that_of_differences(names: tuple[str, ...]) -> None:
    linear = linearised(True)
    noise = noise_with(linear, *names)
    packed, step = noise.packed, 1e-4
    differences = []
    for i in range(packed.size):
        up, down = packed.copy(), packed.copy()
        up[i] += step
        down[i] -= step
        ends = [whitened(noise.unpacked(end), linear).log_likelihood for end in (up, down)]
        differences.append((ends[0] - ends[1]) / (2 * step))
    # Central differences of a value of some 1e3 with 1e-13 relative rounding.
    np.testing.assert_allclose(likelihood_derivatives(noise, linear)[1], differences, rtol=1e-5, atol=2e-5)


@pytest.mark.parametrize("names", [(), ("wander",), ("scatter", "wander")])
def test_what_noise_and_scatter_account_for_is_their_posterior_mean(names: tuple[str, ...]) -> None:
    linear = linearised()
    noise = noise_with(linear, *names)
    weighted = np.linalg.solve(dense(noise, linear), linear.y.ravel())
    own = dataclasses.replace(noise, terms={n: p for n, p in noise.terms.items() if n == "scatter"})
    without_columns = dataclasses.replace(linear, columns=0.0 * linear.columns)
    expected = (dense(own, without_columns) @ weighted).reshape(linear.y.shape)
    np.testing.assert_allclose(unaccounted(noise, linear, whitened(noise, linear)), expected, rtol=1e-7, atol=1e-12)


def test_estimates_are_near_the_truth_that_the_errors_were_drawn_with() -> None:
    linear = linearised(n=150)
    truth = noise_with(linear, "scatter")
    truth = dataclasses.replace(truth, factor=np.ones(150))
    rng = np.random.default_rng(8)
    y = np.linalg.cholesky(dense(truth, linear)) @ rng.normal(size=linear.y.size)
    drawn = dataclasses.replace(linear, y=y.reshape(linear.y.shape))
    start = noise_with(linear).with_term("scatter", TERMS["scatter"].starts(linear, np.array([NOISE]))[0])
    found = estimated(dataclasses.replace(start, factor=np.ones(150)), drawn)
    assert found.std[0] == pytest.approx(NOISE, rel=0.15)
    assert likelihood_derivatives(found, drawn)[0] >= likelihood_derivatives(truth, drawn)[0]


def test_scatter_kept_off_zero_is_the_most_probable_under_its_prior() -> None:
    """Of few visits without scatter: the log prior is the sum of the logarithms of the standard deviations."""
    linear = linearised()
    y = np.random.default_rng(8).normal(scale=NOISE, size=linear.y.shape)
    linear = dataclasses.replace(linear, y=y)
    noise = dataclasses.replace(noise_with(linear, "scatter"), factor=np.ones(len(y)))
    found, plain = (estimated(noise, linear, off_zero=name) for name in ("scatter", ""))
    assert np.all(found.terms["scatter"] > plain.terms["scatter"])

    def log_density(packed: Array) -> float:
        other = found.unpacked(packed)
        return whitened(other, linear).log_likelihood + float(other.terms["scatter"].sum())

    most = log_density(found.packed)
    for move in np.vstack((np.eye(found.packed.size), -np.eye(found.packed.size))):
        assert log_density(found.packed + 0.3 * move) < most + GAIN


def test_gross_errors_are_told_from_noise() -> None:
    linear = linearised(n=150)
    rng = np.random.default_rng(1)
    y = rng.normal(scale=NOISE, size=linear.y.shape)
    y[[7, 50]] += 30 * NOISE
    noise = with_gross_errors(CovarianceParameters(np.log([2 * NOISE]), np.ones(150)), dataclasses.replace(linear, y=y))
    assert np.flatnonzero(noise.factor > 1).tolist() == [7, 50]
    assert noise.std[0] == pytest.approx(NOISE, rel=0.1)
    assert not too_many_gross_errors(noise)
    assert too_many_gross_errors(dataclasses.replace(noise, factor=np.where(np.arange(150) < 20, 6.0, 1.0)))


NOISE_OF_STRUCTURE, N = 2e-5, 80


def drawn(kind: str, seed: int, n: int = N, ordered: bool = True) -> Measurements:
    """Poses of the nominal arm, in the order of joint 2 if ``ordered``, with errors of a kind."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(-1.2, 1.2, (6, n))
    q = q[:, np.argsort(q[1])] if ordered else q
    error = NOISE_OF_STRUCTURE * rng.standard_normal((3, n))
    moved = q.copy()
    if kind == "wander":
        steps = rng.standard_normal((3, n))
        walk = np.zeros((3, n))
        for i in range(n):
            walk[:, i] = steps[:, i] if i == 0 else 0.85 * walk[:, i - 1] + np.sqrt(1 - 0.85**2) * steps[:, i]
        error += 3 * NOISE_OF_STRUCTURE * walk
    if kind == "process":
        centres, weights = rng.uniform(-1.2, 1.2, (6, 30)), rng.standard_normal((6, 30))
        distance = np.sum(np.square(q[:, :, None] - centres[:, None]), axis=0)
        moved += 1e-4 * weights @ np.exp(-0.5 * distance / 1.5**2).T
    return Measurements(position=independent_arm.targets(moved) + error, q=q)


def fits(data: Measurements, *more: Effect) -> tuple[Fit, Fit]:
    """The fit that takes errors as independent, and the one that allows for their structure."""
    robot = independent_arm.robot()
    effects = build(parse_requests("base_frame,tool_frame,joint_offset[j2,j3,j4,j5]"), Arm.of(robot), data)
    model = Model.of(robot, [*effects, *more])
    plain = fit(model, data)
    return plain, with_error_structure(plain, data, Options(), functools.partial(fit, model, data)).fit


@pytest.mark.parametrize(
    ("kind", "draws"),
    [
        *(("white", 6), ("wander", 10)),
        *(pytest.param(kind, 16, marks=pytest.mark.slow) for kind in ("white", "wander", "process")),
    ],
)
def test_standard_errors_are_those_of_many_draws(kind: str, draws: int) -> None:
    scores = []
    for seed in range(draws):
        for number, fitted in enumerate(fits(drawn(kind, seed))):
            zeros = [i for i in fitted.identifiability.columns if fitted.names[i].startswith("joint_offset")]
            scores.append((number, fitted.theta[zeros] / np.sqrt(np.diag(fitted.covariance)[zeros])))
    plain, structured = (
        float(np.sqrt(np.mean(np.square(np.concatenate([s for n, s in scores if n == number]))))) for number in (0, 1)
    )
    # 64 scores, not all independent: their root mean square is within 25 % of that of Gaussians.
    assert 0.75 < structured < 1.3
    assert plain < 1.3 if kind == "white" else plain > 1.4


def test_no_variance_is_negative_where_a_part_of_the_rows_shows_what_they_share() -> None:
    """Waves that change from row to row: what pairs of rows share may look indefinite."""
    waves = TransmissionError(("j2", "j4"), tuple(float(order) for order in range(1, 60)), shrunk=True)
    plain, structured = fits(drawn("process", 1, 1500, ordered=False), waves)
    columns = plain.identifiability.columns
    usual = np.sqrt(np.diag(plain.covariance)[columns])
    relative = structured.covariance[np.ix_(columns, columns)] / usual / usual[:, None]
    assert not np.allclose(relative, plain.covariance[np.ix_(columns, columns)] / usual / usual[:, None], rtol=0.1)
    assert np.linalg.eigvalsh(relative).min() > 0.0


def test_many_readings_have_the_standard_errors_of_their_means() -> None:
    """Of 1,600 rows a part is seen, in which rows of a pose come together: its pairs counted 2.2 times too much."""
    means, rng = drawn("white", 3, 200, ordered=False), np.random.default_rng(3)
    means = dataclasses.replace(means, position=means.position + 1e-4 * rng.standard_normal((3, 200)))
    position = np.repeat(means.position, 8, axis=1) + NOISE_OF_STRUCTURE * rng.standard_normal((3, 1600))
    # Joints that are read back differ at each reading of a pose.
    q = np.repeat(means.q, 8, axis=1) + 1e-7 * rng.standard_normal((6, 1600))
    readings = dataclasses.replace(means, position=position, q=q, pose=np.repeat(np.arange(200), 8).astype(str))
    of_means, of_readings = (
        np.sqrt(np.diag(fitted.covariance)[fitted.identifiability.columns])
        for _, fitted in (fits(means), fits(readings))
    )
    assert np.mean(of_readings / of_means) == pytest.approx(1.0, abs=0.2)


def test_scatter_costs_by_the_visits_that_show_it() -> None:
    linear = linearised()
    alone, with_scatter = noise_with(linear), noise_with(linear, "scatter")
    price = log_evidence(alone, linear) - whitened(alone, linear).log_likelihood
    price -= log_evidence(with_scatter, linear) - whitened(with_scatter, linear).log_likelihood
    count = TERMS["scatter"].variances(with_scatter.terms["scatter"], linear, alone.std)
    assert count > 0
    assert price == pytest.approx(0.5 * np.log(8) * count + ACCEPTED)  # 24 rows of 8 visits
