"""Changes in the history of an arm, and fleets."""

import itertools

import numpy as np
import pytest
from scipy.optimize import brentq
from scipy.stats import chi2
from slow_parameters import some_fast

from robacc.documents.history import date_text
from robacc.history import ArmFit, ArmSeries, find_changes, fleet_of, level_of, slope_of

WEEK = 7 * 86400.0
LEVEL = WEEK / (365.25 * 86400.0)


def life(rng, n=80, p=20, *, between=1.0, heat=0.0, tails=None):
    """ArmSeries of ``p`` coefficients over ``n`` weekly tests without a change; six of them are of the set-up."""
    times = np.arange(n) * WEEK
    temperature = 20.0 + 6.0 * np.sin(times / (8 * WEEK) + rng.uniform(0, 6)) + rng.normal(0, 1, n)
    series = []
    for k in range(p):
        usual = 1e-5 * np.exp(rng.normal())
        stds = usual * np.exp(rng.normal(0, 0.15, n))
        noise = rng.normal(size=n) if tails is None else rng.standard_t(tails, n)
        values = rng.normal(0, 1e-3) + noise * np.hypot(stds, between * usual * abs(rng.normal()))
        values += heat * usual * (temperature - 20.0) * (k % 4 == 0)
        key = f"base_frame.{k}" if k >= p - 6 else f"joint_offset.j{k}"
        series.append(ArmSeries(key, "rad", times, values, stds, temperature if heat else np.full(n, np.nan)))
    return series


def cut(series, n):
    return [
        ArmSeries(s.key, s.unit, s.times[:n], s.values[:n], s.stds[:n], s.temperatures[:n], s.rivals) for s in series
    ]


def moved(series, key, change):
    return [
        ArmSeries(s.key, s.unit, s.times, s.values + change * (s.key == key), s.stds, s.temperatures, s.rivals)
        for s in series
    ]


def limit_of(series, key):
    return next(limit["limit"] for limit in find_changes(series, LEVEL)[1] if limit["key"] == key)


@pytest.mark.parametrize("kind", some_fast([{"heat": 1.0}, {"between": 3.0}, {}, {"tails": 5}], 4))
@pytest.mark.parametrize("arms", [2, pytest.param(4, marks=pytest.mark.slow)])
def test_a_life_without_a_change_gives_at_most_one_false_alarm_a_year(kind, arms):
    rng, alarms, years = np.random.default_rng(1), set(), 0.0
    for arm in range(arms):
        series = life(rng, **kind)
        for n in range(2, 81):
            found, *_ = find_changes(cut(series, n), LEVEL)
            alarms |= {(arm, c["key"], c["kind"]) for c in found if c["kind"] in ("step", "ramp") and c["confirmed"]}
        years += 80 * LEVEL
    assert len(alarms) <= years


@pytest.mark.parametrize("heat", [0.0, 1.0])
def test_a_step_of_twice_the_limit_is_found_within_two_tests_and_named_with_its_date_and_size(heat):
    rng, inside = np.random.default_rng(2), 0
    for _ in range(20):
        series, at = life(rng, heat=heat), int(rng.integers(20, 70))
        size = 2.0 * limit_of(cut(series, at), "joint_offset.j3")
        series = moved(series, "joint_offset.j3", size * (np.arange(80) >= at))
        soon = [c for c in find_changes(cut(series, at + 2), LEVEL)[0] if c["key"] == "joint_offset.j3"]
        assert any(c["kind"] == "step" and c["at"] == date_text(at * WEEK) for c in soon)
        steps = [c for c in find_changes(series, LEVEL)[0] if c["kind"] in ("step", "ramp")]
        assert [(c["key"], c["kind"], c["at"]) for c in steps] == [("joint_offset.j3", "step", date_text(at * WEEK))]
        assert steps[0]["earliest"] <= date_text(at * WEEK) <= steps[0]["latest"]
        assert steps[0]["p_value"] < LEVEL
        inside += steps[0]["low"] <= size <= steps[0]["high"]
    assert inside >= 17  # 19 expected; fewer than 17 of 20 has a probability of 0.3 % where intervals hold 95 %


def test_wear_is_a_ramp_and_its_interval_holds_the_rise():
    rng, inside = np.random.default_rng(3), 0
    for _ in range(15):
        series, at = life(rng), int(rng.integers(10, 40))
        size = 3.0 * limit_of(cut(series, at), "joint_offset.j1")
        rise = np.maximum(np.arange(80) - at + 1, 0) / (80 - at)
        series = moved(series, "joint_offset.j1", size * rise)
        (ramp,) = [c for c in find_changes(series, LEVEL)[0] if c["kind"] in ("step", "ramp")]
        assert (ramp["key"], ramp["kind"]) == ("joint_offset.j1", "ramp")
        assert "temperature" in ramp["alternatives"]  # none was recorded
        inside += ramp["low"] <= size <= ramp["high"]
    assert inside >= 12


def test_a_dependence_on_temperature_is_no_ramp():
    found = find_changes(life(np.random.default_rng(4), heat=2.0), LEVEL)[0]
    heated = {*(f"joint_offset.j{k}" for k in (0, 4, 8, 12)), "base_frame.16"}
    assert {c["key"] for c in found if c["kind"] == "temperature"} == heated
    assert all(c["unit"] == "rad/K" for c in found if c["kind"] == "temperature")
    assert not [c for c in found if c["kind"] in ("step", "ramp")]


def test_a_base_set_up_anew_is_no_change_of_the_arm():
    series = moved(life(np.random.default_rng(5)), "base_frame.15", 1e-3 * (np.arange(80) >= 40))
    assert [(c["key"], c["kind"]) for c in find_changes(series, LEVEL)[0]] == [("base_frame.15", "setup")]


def test_one_bad_test_is_no_change_once_others_follow():
    series = moved(life(np.random.default_rng(6)), "joint_offset.j2", 1e-3 * (np.arange(80) == 40))
    assert not find_changes(series, LEVEL)[0]
    (last,) = find_changes(cut(series, 41), LEVEL)[0]
    assert (last["key"], last["kind"], last["confirmed"]) == ("joint_offset.j2", "step", False)


def test_two_changes_of_one_coefficient_are_both_found():
    series = life(np.random.default_rng(7))
    order = np.arange(80)
    series = moved(series, "joint_offset.j5", 5e-4 * (order >= 30) - 8e-4 * (order >= 60))
    found = sorted((c["at"], c["size"]) for c in find_changes(series, LEVEL)[0])
    assert [at for at, _ in found] == [date_text(30 * WEEK), date_text(60 * WEEK)]
    assert [size for _, size in found] == pytest.approx([5e-4, -8e-4], abs=2e-4)


def test_few_tests_of_few_coefficients_give_no_change_and_no_error():
    rng = np.random.default_rng(8)
    for n, p in itertools.product((2, 3, 4), (1, 2, 3)):
        changes, limits, _ = find_changes(
            [
                ArmSeries(f"k{k}", "m", np.arange(n) * WEEK, rng.normal(size=n), np.ones(n), np.full(n, np.nan))
                for k in range(p)
            ],
            LEVEL,
        )
        assert not changes
        assert [limit["key"] for limit in limits] == [f"k{k}" for k in range(p)]
        assert all(limit["limit"] > 0.0 for limit in limits)


def test_slope_agrees_with_numpy():
    rng, n = np.random.default_rng(9), 12
    values = rng.normal(size=n)
    slope, low, high = slope_of(np.arange(n) * WEEK, values, np.full(n, 0.1))
    line, covariance = np.polyfit(np.arange(n) * LEVEL, values, 1, cov=True)
    assert slope == pytest.approx(line[0], rel=1e-9)
    from scipy.stats import t

    assert (high - low) / 2 == pytest.approx(t.ppf(0.975, n - 2) * covariance[0, 0] ** 0.5, rel=1e-6)


def test_level_is_one_alarm_a_year_at_most_five_percent():
    assert level_of(np.arange(10) * WEEK) == pytest.approx(7 / 365.25)
    assert level_of(np.arange(3) * 365.25 * 86400.0) == 0.05
    assert level_of(np.array([5.0, 5.0])) == 0.05


def fleet(values, stds):
    return [
        ArmFit(f"a{i}", {"joint_offset.j1": (float(v), float(s), "rad")}, {("joint_offset.j1",) * 2: float(s) ** 2})
        for i, (v, s) in enumerate(zip(values, stds, strict=True))
    ]


@pytest.mark.parametrize("n", [5, 30])
@pytest.mark.parametrize("ratio", [0.5, 3.0])
def test_intervals_of_mean_and_spread_hold_the_truth(n, ratio):
    rng, spread, mean, draws = np.random.default_rng(n), 0, 0, 400
    for _ in range(draws):
        stds = 1e-5 * np.exp(rng.normal(0, 0.5, n))
        values = 1e-3 + rng.normal(0, ratio * 1e-5, n) + rng.normal(0, stds)
        (one,), _, _ = fleet_of(fleet(values, stds))
        spread += one["std_low"] <= ratio * 1e-5 <= one["std_high"]
        mean += one["mean_low"] <= 1e-3 <= one["mean_high"]
    # 95 % with 400 draws: 92 to 98 % are 2.8 standard deviations; strangers that are none narrow a few.
    assert 0.92 <= spread / draws <= 0.98
    assert 0.91 <= mean / draws <= 1.0


def test_spread_agrees_with_another_solver():
    rng, n = np.random.default_rng(1), 12
    stds = rng.uniform(0.5, 2.0, n)
    values = rng.normal(0, 2.0, n) + rng.normal(0, stds)

    def squares(variance):
        weights = 1.0 / (stds**2 + variance)
        return weights @ (values - np.average(values, weights=weights)) ** 2

    (one,), strangers, _ = fleet_of(fleet(values, stds))
    assert not strangers
    wanted = [n - 1, chi2.ppf(0.975, n - 1), chi2.ppf(0.025, n - 1)]
    found = [brentq(lambda v, q=q: squares(v) - q, 0, 1e3) if squares(0) > q else 0.0 for q in wanted]
    assert np.square([one["std"], one["std_low"], one["std_high"]]) == pytest.approx(found, rel=1e-6)


def test_strangers_are_rare_in_fleets_without_one_and_found_in_fleets_with_one():
    rng, false = np.random.default_rng(2), 0
    for _ in range(200):
        values, stds = rng.normal(0, 1.0, 20), np.full(20, 0.3)
        false += bool(fleet_of(fleet(values, stds))[1])
        values[3] = 8.0
        assert fleet_of(fleet(values, stds))[1][0]["arm"] == "a3"
    assert false <= 200 * 0.05 + 3 * np.sqrt(200 * 0.05 * 0.95)


def test_covariance_over_arms_is_that_of_the_coefficients_without_the_noise_of_the_fits():
    rng, n = np.random.default_rng(3), 4000
    truth = np.array([[1.0, 0.6], [0.6, 2.0]])
    noise = np.array([[0.5, 0.2], [0.2, 0.3]])
    values = rng.multivariate_normal([0, 0], truth, n) + rng.multivariate_normal([0, 0], noise, n)
    keys = ("joint_offset.j1", "joint_offset.j2")
    arms = [
        ArmFit(
            f"a{i}",
            {key: (float(row[k]), float(noise[k, k] ** 0.5), "rad") for k, key in enumerate(keys)},
            {(keys[a], keys[b]): float(noise[a, b]) for a in range(2) for b in range(a + 1)},
        )
        for i, row in enumerate(values)
    ]
    _, _, covariance = fleet_of(arms)
    assert covariance["names"] == [*keys]
    assert covariance["matrix"] == pytest.approx(truth, abs=0.15)
