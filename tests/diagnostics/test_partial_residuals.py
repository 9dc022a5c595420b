"""The residual along an effect over its driver: against finite differences, hand computation and known truth."""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import Any

import numpy as np
import pytest
from arms import arm, circumstances, suited

from robacc.diagnostics.partial_residuals import PartialResidual, partial_residuals
from robacc.effects import REGISTRY
from robacc.effects.base import Effect
from robacc.fitting.fit_result import Fit, Options
from robacc.fitting.solver import fit
from robacc.geometry import compose as product, log_so3, transpose
from robacc.gravity import gravity_torques
from robacc.measurements import Measurements
from robacc.modelling.model import Model, predict, residuals
from robacc.robots.description import Frame

NOISE = 1e-5
N = 160
ENTRIES: dict[str, dict[str, Any]] = {
    "backlash": {"joints": ["j3"], "values": {"j3": -2e-4}},
    "approach_lag": {"joints": ["j2"], "values": {"j2": 3e-4}},
    "gear_ratio": {"joints": ["j2"], "values": {"j2": 4e-4}},
    "joint_coupling": {"joints": ["j6"], "drivers": ["j5"], "values": {"j6.j5": 1e-3}},
    "transmission_error": {"joints": ["j1"], "orders": [7.5], "values": {"j1.cos7.5": 1.2e-4, "j1.sin7.5": -1.6e-4}},
    "joint_compliance": {"joints": ["j2"], "values": {"j2": 5e-6}},
    "payload_compliance": {"joints": ["j2"], "values": {"j2": 2e-5}},
    "thermal_expansion": {"reference_c": 20, "values": {"value": 3e-5}},
    "frame_drift": {"origin_s": 1800, "span_s": 1800, "degree": 1, "values": {"x": 3e-4}},
    "instrument_scale": {"values": {"value": -3e-4}},
    "axis_wobble": {"joints": ["j2"], "values": {}},
    "base_compliance": {"values": {}},
    "joint_correction": {
        **{"joints": ["j3"], "drivers": ["j2"], "range": [[-3, 3]], "degree": 3},
        "values": {"j3.j2.T1": 1e-4, "j3.j2.T2": 2e-4},
    },
}


@cache
def fitted(name: str, oriented: bool = True) -> tuple[Fit, Effect, Measurements]:
    """Poses of an arm with one effect, and the fit of that effect to them."""
    nominal = dataclasses.replace(arm("puma560").robot, effects=())
    truth = dataclasses.replace(nominal, effects=({"effect": name, **ENTRIES[name]},), effect_units=(1.0, 1.0))
    blank = circumstances(nominal, N, seed=4)
    poses = predict(truth, blank)
    noise = np.random.default_rng(5).normal(scale=NOISE, size=(3, N))
    data = dataclasses.replace(blank, position=poses.translation + noise, rotation=poses.rotation if oriented else None)
    settings = {key: value for key, value in ENTRIES[name].items() if key not in ("joints", "values")}
    effect = REGISTRY[name].from_settings(tuple(ENTRIES[name].get("joints", ())), settings)
    return fit(Model.of(nominal, (effect,)), data, Options(misfit=(NOISE, NOISE))), effect, data


def curve(name: str, oriented: bool = True) -> PartialResidual:
    found, effect, data = fitted(name, oriented)
    (one,) = partial_residuals(effect, found, data)
    return one


@pytest.mark.parametrize("name", [name for name in ENTRIES if ENTRIES[name]["values"]])
def test_what_is_explained_is_the_difference_of_the_residuals(name: str) -> None:
    one = curve(name)
    good = np.isfinite(one.sd)
    assert good.sum() > 0.9 * N
    np.testing.assert_allclose((one.before - one.after)[good], one.effect[good], rtol=1e-9, atol=1e-15)
    # With the truth in the model what is left is the noise of each reading.
    ratio = one.after[good] / one.sd[good]
    assert np.sqrt(np.mean(np.square(ratio))) < 1.3


def payload_moment(data: Measurements) -> np.ndarray:
    """About the second axis by hand: the work of the payload's weight as the joint turns, by central differences."""
    robot = dataclasses.replace(arm("puma560").robot, effects=(), tool=Frame(arm("puma560").payload_com))

    def height(shift: float) -> np.ndarray:
        q = np.array(data.q)
        q[1] += shift
        return predict(robot, dataclasses.replace(data, q=q)).translation[2]

    # Gravity pulls along -z: what sinks is turned that way.
    rise: np.ndarray = (height(1e-5) - height(-1e-5)) / 2e-5
    return -9.81 * data.payload * rise


EXPECTED = {
    "backlash": lambda data: -2e-4 * data.direction[2],
    "approach_lag": lambda data: 3e-4 * data.speed[1],
    "gear_ratio": lambda data: 4e-4 * data.q[1],
    "joint_coupling": lambda data: 1e-3 * data.q[4],
    "transmission_error": lambda data: 1.2e-4 * np.cos(7.5 * data.q[0]) - 1.6e-4 * np.sin(7.5 * data.q[0]),
    "joint_compliance": lambda data: 5e-6 * gravity_torques(arm("puma560"), data.q)[1],
    "payload_compliance": lambda data: 2e-5 * payload_moment(data),
}


@pytest.mark.parametrize("oriented", [True, False])
@pytest.mark.parametrize("name", EXPECTED)
def test_a_joints_effect_is_told_as_its_own_angle(name: str, oriented: bool) -> None:
    one = curve(name, oriented)
    _, _, data = fitted(name, oriented)
    wanted = EXPECTED[name](data)
    assert one.unit == "rad"
    assert one.joint == ENTRIES[name]["joints"][0]
    # To first order in angles of some 1e-4, and of a coefficient that noise moves by less than a hundredth.
    sure = np.isfinite(one.sd) & (one.sd < 20 * np.nanmedian(one.sd))
    assert np.max(np.abs(one.effect - wanted)[sure]) < 0.03 * np.max(np.abs(wanted))


def test_the_reading_is_the_least_squares_angle_by_finite_differences() -> None:
    """Against the derivative of the prediction by central differences, and the normal equation written out."""
    one = curve("gear_ratio")
    found, _, data = fitted("gear_ratio")
    robot, step = found.model.arm.robot, 1e-6

    def reached(shift: float) -> Any:
        q = np.array(data.q)
        q[1] += shift
        return predict(robot, dataclasses.replace(data, q=q))

    ahead, back = reached(step), reached(-step)
    moved = (ahead.translation - back.translation) / (2 * step)
    turned = log_so3(product(ahead.rotation, transpose(back.rotation))) / (2 * step)
    column = np.concatenate((moved, turned))
    lacking = residuals(data, predict(robot, data))
    for i in (0, 17, 80):
        weight = np.diag(np.square(found.weight[:, i]))
        c, r = column[:, i], lacking[:, i]
        assert one.before[i] == pytest.approx(c @ weight @ r / (c @ weight @ c), rel=1e-4)
        assert one.sd[i] == pytest.approx((c @ weight @ c) ** -0.5, rel=1e-4)


def test_the_spectrum_shows_the_order_and_nothing_after() -> None:
    spectrum = curve("transmission_error").spectrum
    strongest = int(np.argmax(spectrum.before))
    assert spectrum.orders[strongest] == 7.5
    # The simulated amplitude is that of 1.2 and 1.6: 2, of 1e-4.
    assert spectrum.before[strongest] == pytest.approx(2e-4, rel=0.05)
    assert spectrum.after.max() < 5 * spectrum.noise
    # An amplitude of noise has the mean square 4 sigma^2 / N of two coefficients.
    assert np.sqrt(np.mean(np.square(spectrum.after))) == pytest.approx(spectrum.noise, rel=0.5)


def test_a_cause_of_no_joint_is_told_along_the_way_it_moves_the_target() -> None:
    warm = curve("thermal_expansion")
    _, _, data = fitted("thermal_expansion")
    assert (warm.joint, warm.unit, warm.driver, warm.driver_unit) == (None, "m", "temperature_c", "°C")
    assert np.array_equal(np.sign(warm.effect), np.sign(data.temperature - 20.0))
    drift = curve("frame_drift")
    # The base moves along x by 0.3 mm in half the time: at every pose the same line through its middle.
    assert drift.effect == pytest.approx(3e-4 * (data.time - 1800) / 1800, abs=1e-5)
    scale = curve("instrument_scale")
    assert scale.driver == "distance"
    assert scale.effect == pytest.approx(-3e-4 * scale.x, rel=0.05)


def test_an_effect_without_a_single_driver_is_held_against_itself() -> None:
    one = curve("base_compliance")
    assert one.driver == "predicted"
    assert one.grid is not None
    assert one.value is not None
    assert np.array_equal(one.grid, one.value)


def test_every_effect_of_a_joint_has_a_driver() -> None:
    for name, cls in REGISTRY.items():
        if cls.traits.per_joint and name not in ("link_geometry", "lateral_compliance", "step"):
            robot_arm = suited(name, arm("puma560"))
            data = circumstances(robot_arm.robot, 40)
            default = cls.default(robot_arm, data, cls.possible_joints(robot_arm)[:1])
            effect = next(iter(cls.candidates(robot_arm, data)), default)
            driver = effect.driver(robot_arm, data, effect.joints[0])
            assert driver.values.shape == (40,)
