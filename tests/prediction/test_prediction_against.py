"""Predicted against measured: the algebra against dense matrices, and the tests' behaviour over simulated robots."""

import dataclasses
import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import optimize, special, stats

from robacc import InputError, Measurements, UsageError, read_robot
from robacc.geometry import Array, compose, exp_so3
from robacc.modelling.model import residuals
from robacc.prediction.comparison import (
    SufficientStatistics,
    bartlett_mean,
    compare_with_measured,
    consistency,
    reduce_residuals,
    scale_test,
    variance_components,
)
from robacc.prediction.predicting import ToleranceParameter, sampled_configurations, uncertain_parameters
from robacc.robots.arm import BASE, Arm
from robacc.robots.description import Frame

ROBOTS = Path(__file__).resolve().parents[2] / "configs" / "robots"
ROBOT = dataclasses.replace(read_robot(ROBOTS / "puma560.yaml"), tool=Frame((0.05, 0.0, 0.1)))
PARAMETERS = uncertain_parameters(ROBOT)
CHAIN = Arm.of(ROBOT).chain
NOISE = 2e-5
N = 30


def simulated(
    seed: int, *, n: int = N, factor: float = 1.0, full: bool = True, sigma: bool = True, noise: float = NOISE
) -> Measurements:
    """One robot drawn from the tolerances times ``factor``, by exact kinematics, measured at ``n`` poses."""
    rng = np.random.default_rng(seed)
    q = sampled_configurations(ROBOT, n).q
    scalars = CHAIN.scalars(q)
    for parameter in PARAMETERS:
        scalars[parameter.motion] = scalars[parameter.motion] + factor * parameter.sd * rng.standard_normal()
    poses = CHAIN.poses(scalars, n)
    turned = compose(exp_so3(noise * rng.standard_normal((3, n))), poses.rotation)
    return Measurements(
        position=poses.translation + noise * rng.standard_normal((3, n)),
        rotation=turned if full else None,
        q=q,
        sigma_position=np.full((3, n), noise) if sigma else None,
        sigma_rotation=np.full(n, noise) if sigma and full else None,
    )


def dense(data: Measurements) -> tuple[Array, Array, Array]:
    """Residual, J V^(1/2) and noise variances of all measured numbers, one below the other."""
    error = residuals(data, CHAIN.forward(data.q))
    rows = error.shape[0]
    sd = np.array([parameter.sd for parameter in PARAMETERS])
    jacobian = CHAIN.jacobian(data.q, [parameter.motion for parameter in PARAMETERS])[:rows]
    columns = (jacobian * sd[:, None]).transpose(2, 0, 1).reshape(-1, sd.size)
    return error.T.ravel(), columns, np.full(rows * data.n, NOISE**2)


NOISE_OF_FILE = reduce_residuals(ROBOT, simulated(0), PARAMETERS).noise


@pytest.mark.parametrize("full", [True, False])
def test_normalised_squared_error_is_that_of_the_joint_covariance(full: bool) -> None:
    data = simulated(0, full=full)
    error, columns, noise = dense(data)
    expected = error @ np.linalg.solve(columns @ columns.T + np.diag(noise), error)
    tests, _, _ = consistency(reduce_residuals(ROBOT, data, PARAMETERS))
    assert (tests["total"]["statistic"], tests["total"]["dof"]) == (pytest.approx(expected, rel=1e-7), error.size)
    low, high = stats.chi2.ppf((0.025, 0.975), error.size)
    assert (tests["total"]["lower"], tests["total"]["upper"]) == (pytest.approx(low), pytest.approx(high))
    expected_p = 2 * min(stats.chi2.cdf(expected, error.size), stats.chi2.sf(expected, error.size))
    assert tests["total"]["p_value"] == pytest.approx(expected_p, rel=1e-5)


def test_registration_projects_out_base_and_tool() -> None:
    data = simulated(1)
    error, columns, noise = dense(data)
    arm = Arm.of(ROBOT)
    labels = ("x", "y", "z", "turn_x", "turn_y", "turn_z")
    motions = [arm.chain.index(owner, label) for owner in (BASE, -2) for label in labels]
    fixed = CHAIN.jacobian(data.q, motions).transpose(2, 0, 1).reshape(-1, 12)
    basis = np.linalg.svd(fixed, full_matrices=True)[0][:, 12:]
    covariance = basis.T @ (columns @ columns.T + np.diag(noise)) @ basis
    projected_error = basis.T @ error
    tests, _, _ = consistency(reduce_residuals(ROBOT, data, PARAMETERS, aligned=("base_frame", "tool_frame")))
    assert tests["total"]["dof"] == error.size - 12
    assert tests["total"]["statistic"] == pytest.approx(
        projected_error @ np.linalg.solve(covariance, projected_error), rel=1e-6
    )
    # A frame that was moved and registered leaves the same evidence: that is what "taken out" means.
    moved = dataclasses.replace(data, position=data.position + np.array([[1e-5], [2e-5], [-1e-5]]))
    after_move, _, _ = consistency(reduce_residuals(ROBOT, moved, PARAMETERS, aligned=("base_frame",)))
    before, _, _ = consistency(reduce_residuals(ROBOT, data, PARAMETERS, aligned=("base_frame",)))
    assert after_move["total"]["statistic"] == pytest.approx(before["total"]["statistic"], rel=1e-9)


def test_noise_by_reml_is_the_maximum_of_the_restricted_likelihood() -> None:
    data = simulated(2, sigma=False, n=12)
    statistics = reduce_residuals(ROBOT, data, PARAMETERS)
    error, columns, _ = dense(data)
    rank = np.linalg.matrix_rank(columns / np.linalg.norm(columns, axis=0))
    basis = np.linalg.svd(columns, full_matrices=True)[0][:, rank:]

    def restricted(log_sigma: Array) -> float:
        noise = np.tile(np.repeat(np.exp(2 * log_sigma), 3), data.n)
        covariance = basis.T @ (noise[:, None] * basis)
        projected_error = basis.T @ error
        return float(np.linalg.slogdet(covariance)[1] + projected_error @ np.linalg.solve(covariance, projected_error))

    best = optimize.minimize(restricted, np.log([NOISE, NOISE]), method="Nelder-Mead", options={"xatol": 1e-7})
    assert statistics.noise["source_position"] == statistics.noise["source_orientation"] == "estimated"
    assert np.log([statistics.noise["position_m"], statistics.noise["orientation_rad"]]) == pytest.approx(
        best.x, abs=1e-4
    )


def test_noise_is_the_given_one_before_the_files() -> None:
    data = simulated(3)
    in_file = reduce_residuals(ROBOT, data, PARAMETERS)
    given = reduce_residuals(ROBOT, data, PARAMETERS, noise=(2 * NOISE, 2 * NOISE))
    assert (in_file.noise["source_position"], in_file.noise["position_m"]) == ("file", pytest.approx(NOISE))
    assert given.noise["source_position"] == "given"
    np.testing.assert_allclose(given.strength, in_file.strength / 2, rtol=1e-9)
    assert given.noise_squares == pytest.approx(in_file.noise_squares / 4, rel=1e-9)


def test_likelihood_ratio_and_its_factor_against_a_direct_maximisation() -> None:
    rng = np.random.default_rng(0)
    variances = np.exp(rng.uniform(-1, 6, 20))
    y = 1.7 * np.sqrt(1 + variances) * rng.standard_normal(20)

    def minus(log_factor: float) -> float:
        total = 1 + math.exp(log_factor) * variances
        return float(0.5 * np.sum(np.log(total) + y**2 / total))

    best = optimize.minimize_scalar(minus, bounds=(-5, 5), method="bounded", options={"xatol": 1e-9})
    result = scale_test(y, variances)
    assert result["factor"] == pytest.approx(math.exp(best.x / 2), rel=1e-4)
    assert result["statistic"] == pytest.approx(2 * (minus(0.0) - best.fun), rel=1e-6)
    assert result["p_value_asymptotic"] == pytest.approx(stats.chi2.sf(result["statistic"], 1), rel=1e-9)


def test_likelihood_ratio_rejects_the_prediction_itself_in_5_percent() -> None:
    variances = np.square(reduce_residuals(ROBOT, simulated(0), PARAMETERS).strength)
    y = np.random.default_rng(11).standard_normal((1000, variances.size)) * np.sqrt(1 + variances)
    assert np.mean([scale_test(row, variances)["p_value"] < 0.05 for row in y]) == pytest.approx(0.05, abs=0.015)


TINY = tuple(dataclasses.replace(parameter, sd=1e-12) for parameter in PARAMETERS)


@pytest.mark.parametrize(
    ("data", "parameters", "noise", "verdict"),
    [
        (
            simulated(5, factor=2.0),
            PARAMETERS,
            None,
            "^the measured errors are larger than the tolerances predict: about ",
        ),
        (simulated(5, factor=0.3), PARAMETERS, None, "^the measured errors are smaller than the tolerances predict"),
        (simulated(6), PARAMETERS, None, "^the measured errors are consistent with the tolerances$"),
        (
            simulated(6),
            PARAMETERS,
            NOISE / 2,
            "the part that no parameter explains is 2 times the stated noise: effects other than",
        ),
        (simulated(6), PARAMETERS, 2 * NOISE, "the part that no parameter explains is 0.49 times the stated noise"),
        (
            simulated(0, factor=0.0),
            TINY,
            None,
            "far below the noise on these poses, so the tolerances cannot be tested$",
        ),
    ],
)
def test_verdicts(
    data: Measurements, parameters: tuple[ToleranceParameter, ...], noise: float | None, verdict: str
) -> None:
    result = compare_with_measured(ROBOT, data, parameters, noise=(noise, noise))
    assert re.search(verdict, result["verdict"])
    assert (result["variance_components"] is None) == (parameters is TINY)
    if "larger" in verdict:
        assert 1.4 < result["likelihood_ratio"]["factor"] < 2.8
    if noise == NOISE / 2:
        assert result["normalised_squared_error"]["noise"]["p_value"] < 1e-6


def test_verdict_names_an_unexpected_pattern() -> None:
    """What the parameters move much is of the right size, what they hardly move is not."""
    variances = np.repeat([1e4, 0.05], 10)
    y = np.repeat([100.0, 2.5], 10)
    statistics = SufficientStatistics(np.eye(20)[:, :1], np.sqrt(variances), y, 100.0, 100, 40, 0, NOISE_OF_FILE)
    _, _, verdict = consistency(statistics)
    assert verdict.startswith("the measured errors have the predicted size but not the predicted pat")


def test_components_are_the_maximum_of_the_dense_likelihood() -> None:
    data = simulated(7, full=True)
    error, columns, noise = dense(data)
    result = variance_components(reduce_residuals(ROBOT, data, PARAMETERS), PARAMETERS)
    names = [component["name"] for component in result["components"]]
    assert names == ["theta", "d", "a", "alpha"]
    parts = [columns[:, [p.component == name for p in PARAMETERS]] for name in names]
    scale = 1 / NOISE

    def minus(log_phi: Array) -> float:
        covariance = np.diag(noise) * scale**2
        for phi, part in zip(np.exp(log_phi), parts, strict=True):
            covariance = covariance + phi * (part * scale) @ (part * scale).T
        triangle = np.linalg.cholesky(covariance)
        solved = np.linalg.solve(triangle, error * scale)
        return float(np.sum(np.log(np.diag(triangle))) + 0.5 * solved @ solved)

    best = optimize.minimize(minus, np.zeros(4), method="BFGS")
    assert [component["factor"] for component in result["components"]] == pytest.approx(np.exp(best.x / 2), rel=2e-3)
    for component, parameter in zip(result["components"], ("theta", "d", "a", "alpha"), strict=True):
        members = [p for p in PARAMETERS if p.component == parameter]
        assert (component["n_parameters"], component["predicted"]) == (len(members), pytest.approx(members[0].sd))
        assert component["estimate"] == pytest.approx(component["factor"] * component["predicted"])
        assert component["lower"] < component["factor"] < (component["upper"] or math.inf)


def direct(y: Array, unit: float = 1e-4) -> tuple[SufficientStatistics, list[ToleranceParameter]]:
    """Return statistics in which each of ``y.size`` parameters of one kind is separate, 1000 times above the noise."""
    n = y.size
    parameters = [ToleranceParameter(f"j{i}.d", f"j{i}", "d", "d", i, "m", unit) for i in range(n)]
    return SufficientStatistics(1e3 * np.eye(n), np.full(n, 1e3), 1e3 * y, 0.0, 0, n, 0, NOISE_OF_FILE), parameters


def test_directly_measured_kind_has_the_textbook_interval() -> None:
    y = np.array([0.3, -1.2, 0.8, 2.0, -0.4, 1.1])
    (component,) = variance_components(*direct(y))["components"]
    variance = float(np.mean(y**2))
    assert (component["factor"] ** 2, component["dof"]) == (
        pytest.approx(variance, rel=1e-3),
        pytest.approx(6.0, rel=1e-3),
    )
    # n (x - 1 - log x) at both ends, x = estimate over truth, within the corrected quantile.
    threshold = stats.chi2.ppf(0.95, 1) * bartlett_mean(6.0)
    for end in (component["lower"], component["upper"]):
        x = variance / end**2
        assert 6 * (x - 1 - math.log(x)) == pytest.approx(threshold, rel=2e-2)


def test_bartletts_mean_is_that_of_the_likelihood_ratio() -> None:
    for n in (1.0, 2.5, 6.0, 40.0):
        assert bartlett_mean(n) == pytest.approx(n * (math.log(n / 2) - special.digamma(n / 2)), rel=1e-10)
    x = np.random.default_rng(0).chisquare(6, 400_000) / 6
    assert np.mean(6 * (x - 1 - np.log(x))) == pytest.approx(bartlett_mean(6.0), rel=0.01)


def test_kinds_that_are_not_distinguishable_are_noted() -> None:
    rng = np.random.default_rng(0)
    effect = np.concatenate((100 * np.eye(5), 100 * np.eye(5)), axis=1)
    parameters = [
        ToleranceParameter(f"j{i}.{kind}", f"j{i}", kind, kind, i, "m", 1e-4) for kind in ("d", "a") for i in range(5)
    ]
    y = effect @ rng.standard_normal(10)
    result = variance_components(
        SufficientStatistics(effect, np.full(5, 141.0), y, 0.0, 0, 5, 0, NOISE_OF_FILE), parameters
    )
    assert [component["why"] for component in result["components"]] == [
        "d is not distinguishable from a on these poses",
        "a is not distinguishable from d on these poses",
    ]
    faint = dataclasses.replace(direct(np.ones(4))[0], effect=1e-3 * np.eye(4), y=np.ones(4))
    weak = variance_components(faint, direct(np.ones(4))[1])
    assert weak["notes"][0].startswith("d is weakly identifiable on these poses: ")


def test_base_and_tool_are_used_as_given() -> None:
    parameters = uncertain_parameters(
        dataclasses.replace(ROBOT, base_tolerance={"x": 1e-4}, tool_tolerance={"z": 1e-4})
    )
    result = variance_components(reduce_residuals(ROBOT, simulated(8), parameters), parameters)
    assert [component["name"] for component in result["components"]] == ["theta", "d", "a", "alpha"]
    assert result["notes"][-1] == "the tolerances of base and tool are used as given, not estimated"


def test_one_draw_text() -> None:
    comparison = compare_with_measured(ROBOT, simulated(9), PARAMETERS)
    assert comparison["one_draw"].startswith("all 30 poses are of one robot and share the same parameter errors")
    assert (
        "Of 180 measured numbers, 24 depend on the parameters: the size of the tolerances is known to about 14 %"
        in comparison["one_draw"]
    )
    aligned = compare_with_measured(ROBOT, simulated(9), PARAMETERS, align=("base_frame",))
    assert aligned["one_draw"].endswith("Fitting the frames used 6 degrees of freedom, which are not counted")
    assert aligned["alignment"] is not None
    assert aligned["measured"]["position_rms_m"] < comparison["measured"]["position_rms_m"]
    few = compare_with_measured(ROBOT, simulated(0, n=2), PARAMETERS)
    assert "Of 12 measured numbers, 12 depend on the parameters" in few["one_draw"]
    assert few["one_draw"].endswith("; more poses would improve it")
    assert few["normalised_squared_error"]["noise"] is None


UNSTATED = simulated(0, sigma=False)


@pytest.mark.parametrize(
    ("data", "options", "message"),
    [
        (UNSTATED.subset(np.arange(2)), {}, "too few poses to estimate the measurement noise; measure more poses"),
        (
            simulated(0, sigma=False, noise=0.0, factor=0.0),
            {},
            "explain every pose exactly, so the noise cannot be estimated; give the noise",
        ),
        (
            dataclasses.replace(simulated(0), sigma_rotation=np.zeros(N)),
            {},
            "sigma_r: the measuring uncertainty is 0, expected above 0; remove the column",
        ),
        (dataclasses.replace(UNSTATED, q=None), {}, "has no joint columns: the comparison needs the joint values"),
        (UNSTATED.subset(np.arange(0)), {}, "has no poses to compare with the prediction"),
        (
            simulated(0, n=2),
            {"align": ("base_frame", "tool_frame")},
            "fitting frames to 2 poses leaves no errors to compare; measure more poses",
        ),
        (UNSTATED, {"noise": (0.0, None)}, "`noise` is a standard deviation above 0"),
        (UNSTATED, {"confidence": 1.0}, "the confidence must be at least 0.5 and less than 1, not 1"),
    ],
)
def test_poses_that_cannot_be_compared(data: Measurements, options: dict[str, Any], message: str) -> None:
    usage = options.keys() & {"noise", "confidence"}
    with pytest.raises(UsageError if usage else InputError, match=message):
        compare_with_measured(ROBOT, data, PARAMETERS, **options)


def test_hint_for_frames_that_do_not_agree() -> None:
    data = simulated(0)
    moved = dataclasses.replace(data, position=data.position + 0.2)
    result = compare_with_measured(ROBOT, moved, PARAMETERS)
    assert result["hint"] == 'errors this large come from frames that do not agree; try `align="base_frame,tool_frame"`'
    aligned = compare_with_measured(ROBOT, moved, PARAMETERS, align=("base_frame",))
    assert (aligned["hint"], compare_with_measured(ROBOT, data, PARAMETERS)["hint"]) == (None, None)
    wrong = compare_with_measured(ROBOT, dataclasses.replace(data, q=-data.q), PARAMETERS, align=("base_frame",))
    assert wrong["hint"].startswith("errors this large come from units, joint signs")
