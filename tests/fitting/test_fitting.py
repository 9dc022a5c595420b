"""The fit: truth within its standard errors, scipy's solution, outliers named, priors, exact data."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
from arms import arm
from peer import by_scipy
from scipy import stats

import robacc.fitting.normal_equations
from robacc.effects import REGISTRY
from robacc.effects.base import Effect
from robacc.effects.periodic import TransmissionError
from robacc.effects.specification import entry_of
from robacc.fitting.fit_result import Options
from robacc.fitting.solver import fit
from robacc.measurements import Measurements
from robacc.modelling.model import Model, observed_jacobian, predict
from robacc.robots.description import Frame, Robot
from robacc.simulation.simulate import Plan, simulate

NOISE = 2e-5
ARMS = ("puma560", "panda")
PLAN = Plan(60, seed=1, noise_position=NOISE, noise_orientation=NOISE)


def effects(name: str, *wanted: str) -> list[Effect]:
    """``gear_ratio:2`` is the effect on the second joint, ``joint_offset`` its default form."""
    one, data = arm(name), blank(name)
    found = []
    for text in wanted:
        effect, _, number = text.partition(":")
        found.append(REGISTRY[effect].default(one, data, (one.names[int(number) - 1],) if number else None))
    return found


@cache
def blank(name: str) -> Measurements:
    return simulate(arm(name).robot, PLAN).data


def truth_for(name: str, free: list[Effect], data: Measurements, seed: int = 0) -> tuple[Robot, np.ndarray]:
    """An arm with values of all coefficients that poses tell apart, each some 0.3 mm or mrad; the values."""
    one = arm(name)
    found = fit(Model.of(one.robot, free), data, Options(misfit=(NOISE, NOISE)))
    reach = np.abs(found.model.bind(data).linearise(np.zeros(len(found.terms)))[1]).max(axis=(0, 2))
    value = np.zeros(len(found.terms))
    kept = found.identifiability.columns
    value[kept] = np.random.default_rng(seed).normal(scale=3e-4, size=kept.size) / reach[kept]
    entries = []
    for number, effect in enumerate(free):
        own = {n: float(v) for n, v, owner in zip(found.names, value, found.owners, strict=True) if owner == number}
        entries.append(entry_of(effect, own))
    return dataclasses.replace(one.robot, effects=tuple(entries)), value


SEVERAL = ("joint_offset", "link_geometry", "gear_ratio:2", "backlash:3")


@pytest.mark.parametrize("orientation", [True, False])
@pytest.mark.parametrize("name", ARMS)
def test_estimates_scatter_about_the_truth_as_the_covariance_says(name: str, orientation: bool) -> None:
    free = effects(name, *SEVERAL)
    plan = dataclasses.replace(PLAN, orientation=orientation)
    robot, truth = truth_for(name, free, simulate(arm(name).robot, plan).data)
    statistic, count = 0.0, 0
    for seed in range(6):
        data = simulate(robot, dataclasses.replace(plan, seed=seed)).data
        found = fit(Model.of(arm(name).robot, free), data, Options(misfit=(NOISE, NOISE)))
        kept = found.identifiability.columns
        error = (found.theta - truth)[kept]
        statistic += float(error @ np.linalg.solve(found.covariance[np.ix_(kept, kept)], error))
        count += kept.size
        freedom = found.degrees_of_freedom
        # Priors take as much of the coefficients' freedom as they have of the information.
        of_priors = float(found.precision @ np.diag(found.covariance)[kept])
        assert freedom == pytest.approx(data.n * (6 if orientation else 3) - kept.size + of_priors, rel=1e-9)
        assert 1e-4 < stats.chi2.sf(found.chi_square, freedom) < 1 - 1e-4
    # Chi-square of the estimates: one tail in ten thousand, both ways.
    assert 1e-4 < stats.chi2.sf(statistic, count) < 1 - 1e-4


@pytest.mark.parametrize(("name", "orientation"), [("puma560", True), ("puma560", False), ("panda", True)])
def test_the_solution_is_scipys(name: str, orientation: bool) -> None:
    # From the registered start, frames metres away included; scipy's trust region on the same residuals.
    free = effects(name, "base_frame", "tool_frame", "joint_compliance:2", *SEVERAL)
    robot, _ = truth_for(name, effects(name, "joint_compliance:2", *SEVERAL), blank(name))
    data = simulate(robot, dataclasses.replace(PLAN, orientation=orientation)).data
    found = fit(Model.of(arm(name).robot, free), data, Options(robust=False, misfit=(NOISE, NOISE), tolerance=1e-13))
    kept = found.identifiability.columns
    peer, size = by_scipy(found, data, NOISE, method="trf", xtol=1e-15, ftol=1e-15, gtol=1e-15)
    assert kept.size > 25
    assert np.linalg.norm(found.theta[kept] - peer.x * size) <= 1e-9 * np.linalg.norm(found.theta[kept])
    # Standard errors are those of the Jacobian at the solution.
    np.testing.assert_allclose(
        found.covariance[np.ix_(kept, kept)] / size[:, None] / size, np.linalg.inv(peer.jac.T @ peer.jac), atol=1e-5
    )


@pytest.mark.parametrize("name", ARMS)
def test_exact_data_give_exact_coefficients(name: str) -> None:
    free = effects(name, *SEVERAL)
    robot, truth = truth_for(name, free, blank(name))
    exact = dataclasses.replace(PLAN, noise_position=0.0, noise_orientation=0.0)
    for data in (simulate(robot, exact).data, simulate(robot, dataclasses.replace(exact, orientation=False)).data):
        found = fit(Model.of(arm(name).robot, free), data)
        np.testing.assert_allclose(found.poses.translation, data.position, rtol=0, atol=1e-12)
        if data.rotation is not None:
            np.testing.assert_allclose(found.theta, truth, rtol=0, atol=1e-10)
        assert found.inliers.all()


@pytest.mark.parametrize("orientation", [True, False])
def test_rows_that_are_no_part_of_the_rest_are_named_and_no_others(orientation: bool) -> None:
    free = effects("puma560", "base_frame", "tool_frame", *SEVERAL)
    robot, _ = truth_for("puma560", effects("puma560", *SEVERAL), blank("puma560"))
    for seed, size in ((1, 0.5e-3), (2, 5e-3), (3, 0.3)):
        plan = dataclasses.replace(PLAN, seed=seed, outliers=4, outlier_size=size, orientation=orientation)
        made = simulate(robot, plan)
        found = fit(Model.of(arm("puma560").robot, free), made.data)
        assert found.outliers.tolist() == made.outliers.tolist()
        assert found.misfit[0] == pytest.approx(NOISE, rel=0.3)
        every = fit(Model.of(arm("puma560").robot, free), made.data, Options(robust=False))
        assert every.inliers.all()
        assert every.misfit[0] > 1.5 * NOISE


def test_rows_are_weighed_by_their_own_sigma() -> None:
    # Half the rows a hundred times worse, and saying so: the fit is nearly that of the good half.
    data = blank("puma560")
    rng = np.random.default_rng(4)
    sigma = np.where(np.arange(data.n) % 2, 2e-3, NOISE)
    position = predict(arm("puma560").robot, data).translation + sigma * rng.normal(size=(3, data.n))
    measured = dataclasses.replace(
        data, position=position, rotation=None, sigma_position=np.broadcast_to(sigma, (3, data.n)).copy()
    )
    free = effects("puma560", "joint_offset")
    found = fit(Model.of(arm("puma560").robot, free), measured)
    good = fit(Model.of(arm("puma560").robot, free), measured.subset(np.flatnonzero(sigma == NOISE)))
    kept = np.intersect1d(found.identifiability.columns, good.identifiability.columns)
    ratio = np.sqrt(np.diag(found.covariance)[kept] / np.diag(good.covariance)[kept])
    assert np.all(ratio <= 1 + 1e-9)
    assert np.all(ratio > 0.9)
    assert found.inliers.all()
    assert found.misfit[0] < NOISE
    assert 1e-3 < stats.chi2.sf(found.chi_square, found.degrees_of_freedom) < 1 - 1e-3


def test_priors_are_rows_of_their_own() -> None:
    data = blank("puma560")
    free = effects("puma560", "joint_offset", "gear_ratio:2")
    robot, _ = truth_for("puma560", free, data)
    data = simulate(robot, PLAN).data
    count = len(fit(Model.of(arm("puma560").robot, free), data).terms)
    deviation = np.full(count, np.inf)
    deviation[:3] = 5e-6, 2e-6, 1e-9
    options = Options(priors=deviation, misfit=(NOISE, NOISE), robust=False, tolerance=1e-12)
    found = fit(Model.of(arm("puma560").robot, free), data, options)
    # Linear algebra on the last linearisation: a prior is one more measurement, of zero.
    _, columns = found.model.bind(data).linearise(found.theta)
    jacobian = np.moveaxis(observed_jacobian(columns, found.residual) * found.weight[:, None, :], 1, 2)
    jacobian = jacobian.reshape(-1, count)
    right = (found.residual * found.weight).ravel() + jacobian @ found.theta
    rows = np.diag(1 / deviation)[:3]
    expected = np.linalg.lstsq(np.vstack((jacobian, rows)), np.concatenate((right, np.zeros(3))), rcond=None)[0]
    np.testing.assert_allclose(found.theta, expected, rtol=1e-6, atol=1e-12)
    assert abs(found.theta[2]) < 5e-9
    np.testing.assert_array_less(np.sqrt(np.diag(found.covariance))[:3], deviation[:3])


def test_a_profile_is_shrunk_by_its_own_width() -> None:
    one = arm("puma560")
    rng = np.random.default_rng(2)
    profile = TransmissionError((one.names[1],), tuple(float(n) for n in range(3, 23)), True)
    names = [term.name for term in profile.terms(one, blank("puma560"))]
    values = dict(zip(names, rng.normal(scale=5e-5, size=len(names)), strict=True))
    robot = dataclasses.replace(one.robot, effects=(entry_of(profile, values),))
    data = simulate(robot, dataclasses.replace(PLAN, poses=150)).data
    found = fit(
        Model.of(one.robot, [*effects("puma560", "joint_offset"), profile]), data, Options(misfit=(NOISE, NOISE))
    )
    (width,) = found.group_stds.values()
    # Forty values known to a part of their size tell it to a tenth.
    assert width == pytest.approx(np.std(list(values.values())), rel=0.3)
    # Shrunk coefficients count for less than one each; the truth, drawn from a prior, lies where the posterior says.
    assert found.degrees_of_freedom > data.n * 6 - found.identifiability.columns.size
    at = [found.names.index(name) for name in names]
    error = found.theta[at] - np.array(list(values.values()))
    statistic = error @ np.linalg.solve(found.covariance[np.ix_(at, at)], error)
    assert 1e-3 < stats.chi2.sf(statistic, len(at)) < 1 - 1e-3


def test_order_of_rows_and_size_of_blocks_do_not_matter(monkeypatch: pytest.MonkeyPatch) -> None:
    free = effects("puma560", "base_frame", "tool_frame", *SEVERAL)
    robot, _ = truth_for("puma560", effects("puma560", *SEVERAL), blank("puma560"))
    data = simulate(robot, PLAN).data
    model = Model.of(arm("puma560").robot, free)
    first = fit(model, data)
    order = np.random.default_rng(6).permutation(data.n)
    shuffled = fit(model, data.subset(order))
    np.testing.assert_allclose(shuffled.poses.translation, first.poses.translation[:, order], rtol=0, atol=1e-10)
    monkeypatch.setattr(robacc.fitting.normal_equations, "BLOCK", 7)
    blocked = fit(model, data)
    np.testing.assert_allclose(blocked.poses.translation, first.poses.translation, rtol=0, atol=1e-10)
    assert blocked.chi_square == pytest.approx(first.chi_square, rel=1e-6)


@pytest.mark.parametrize("n", [300, 600])
def test_a_direction_that_the_poses_hardly_show_does_not_hold_up_the_others(n: int) -> None:
    # Positions of a target on the last axis: registering it makes up levers of a micrometre, along which a step is
    # radians long. Every other coefficient still reaches its minimum, which takes its share of chi-square.
    noise = 2e-5
    plan = Plan(n, seed=1, noise_position=noise, orientation=False, motion=False)
    robot = dataclasses.replace(arm("puma560").robot, tool=Frame())
    data = simulate(robot, plan).data
    left = []
    for names in (("base_frame", "tool_frame"), ("base_frame", "tool_frame", "joint_offset", "link_geometry")):
        found = fit(Model.of(robot, effects("puma560", *names)), data, Options(robust=False))
        left.append((float(np.square(found.residual / noise).sum()), found.identifiability.columns.size))
    (before, few), (after, many) = left
    assert stats.chi2.cdf(before - after, many - few) > 1e-3
    assert stats.chi2.sf(before - after, many - few) > 1e-3
