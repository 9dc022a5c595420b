"""Validity ranges: stored with every effect, held at their ends, counted, and refused on request."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from arms import arm, circumstances, suited

import robacc
from robacc.effects import REGISTRY
from robacc.effects.base import Effect
from robacc.effects.elastic import JointHardening
from robacc.effects.frames import FrameDrift
from robacc.effects.periodic import TransmissionError
from robacc.effects.specification import Known, entry_of, known_effects
from robacc.errors import InputError
from robacc.fitting.parameters import apply_fit
from robacc.fitting.solver import fit
from robacc.gravity import weight_torques
from robacc.measurements import Measurements
from robacc.modelling.model import Model, predict
from robacc.modelling.validity import outside_validity
from robacc.robots.arm import Arm
from robacc.robots.description import Robot
from robacc.robots.yaml_robot import parse_robot, robot_to_yaml

HELD = {"transmission_error", "axis_wobble", "joint_correction", "frame_drift", "joint_hardening", "joint_warmup"} | {
    "rail_errors",
    "compliance_variation",
    "counterbalance",
}
"""Effects that stop at the end of a narrow range; the others follow a physical law, or have no driver."""


def narrow(robot: Robot, n: int, seed: int = 0) -> Measurements:
    """Poses over a quarter of each driver's range, in its middle."""
    data = circumstances(robot, n, seed)
    middle = {name: getattr(data, name) for name in ("q", "time", "temperature", "payload", "speed")}
    shrunk = {name: np.median(values, axis=-1, keepdims=True) * 0.75 + 0.25 * values for name, values in middle.items()}
    return dataclasses.replace(data, **shrunk)


def entry(effect: Effect, robot: Robot, data: Measurements, size: float = 1e-4) -> dict[str, object]:
    one = Arm.of(robot)
    terms = effect.terms(one, data)
    return entry_of(effect, {term.name: size for term in terms}, effect.validity(one, data))


@pytest.mark.parametrize("name", tuple(REGISTRY))
def test_every_effect_keeps_its_range_and_stops_or_extrapolates_as_it_says(name: str) -> None:
    one = suited(name, arm("puma560"))
    inside, wide = narrow(one.robot, 40), circumstances(one.robot, 60, 2)
    cls = REGISTRY[name]
    effect = cls.default(one, inside, cls.possible_joints(one)[1:2] or cls.possible_joints(one) or None)
    robot = dataclasses.replace(one.robot, effects=(entry(effect, one.robot, inside),))
    robot = parse_robot(robot_to_yaml(robot), "model.yaml")
    known = known_effects(robot)[0]
    assert known.validity == effect.validity(one, inside)
    assert bool(known.validity) == bool(effect.validity_drivers(one))
    free = Model(one, (), (effect,))
    theta = np.full(len(effect.terms(one, inside)), 1e-4)
    # Inside, the range changes nothing, bit for bit.
    assert np.array_equal(predict(robot, inside).translation, free.bind(inside).poses(theta).translation)
    unlimited = free.bind(wide).poses(theta).translation
    limited = predict(robot, wide).translation
    outside = outside_validity(robot, wide)
    if known.validity:
        assert outside is not None
        assert outside.n_poses > 30, "a quarter of the range leaves most poses outside"
        assert outside.warnings()[0].startswith(f"{outside.n_poses} of 60 poses are outside")
    else:
        assert outside is None
    if name in HELD:
        # A correction without a stored range stops at that of its polynomials.
        assert name == "joint_correction" or np.abs(limited - unlimited).max() > 1e-9
        assert outside.std_max > 0
        assert all(item.is_held for item in outside.ranges)
    else:
        np.testing.assert_array_equal(limited, unlimited)
        assert outside is None or not any(item.is_held for item in outside.ranges)
        assert cls.traits.extrapolates or cls.traits.is_constant or name == "thermal_expansion"


def test_a_held_effect_has_the_value_of_the_end_of_its_range() -> None:
    """A cubic drift fitted to half an hour has at two hours and a half the value of its end."""
    one = arm("puma560")
    effect = FrameDrift(origin=900.0, span=900.0, degree=3)
    values = {"frame_drift.x": 1e-4, "frame_drift.y2": 2e-4, "frame_drift.z3": -3e-4}
    robot = dataclasses.replace(one.robot, effects=(entry_of(effect, values, {"time_s": (0.0, 1800.0)}),))
    q = np.random.default_rng(0).uniform(-1, 1, (6, 3))
    data = Measurements(position=np.zeros((3, 3)), q=q, time=np.array([9000.0, 1800.0, -50.0]))
    moved = predict(robot, data).translation - one.chain.forward(q).translation
    np.testing.assert_allclose(moved[:, 0], [1e-4, 2e-4, -3e-4], atol=1e-15)
    np.testing.assert_allclose(moved[:, 1], [1e-4, 2e-4, -3e-4], atol=1e-15)
    np.testing.assert_allclose(moved[:, 2], [-1e-4, 2e-4, 3e-4], atol=1e-15)
    outside = outside_validity(robot, data)
    assert outside is not None
    assert outside.n_poses == 2
    assert outside.ranges[0].driver == "time_s"
    assert outside.ranges[0].excess == pytest.approx(7200.0)


def test_harmonics_over_a_common_period_repeat_and_narrower_ones_are_held() -> None:
    one = arm("puma560")
    for orders, reach, is_held in (((1.0, 2.0), 6.2, True), ((1.0, 2.0), 6.3, False), ((17.0,), 0.4, False)):
        effect = TransmissionError(("j1",), orders)
        assert effect.beyond(one, "j1", (0.0, reach)).is_held == is_held


def test_the_written_model_reproduces_the_fit_and_is_bounded_beyond_its_range() -> None:
    one = arm("puma560")
    rng = np.random.default_rng(3)
    data = circumstances(one.robot, 150, 1)
    q = np.array(data.q)
    q[0] = rng.uniform(-0.8, 0.8, 150)
    data = dataclasses.replace(data, q=q)
    true = dataclasses.replace(one.robot, effects=(_harmonics(),))
    data = dataclasses.replace(data, position=predict(true, data).translation + rng.normal(0, 2e-5, (3, 150)))
    profile = TransmissionError(("j1",), tuple(float(n) for n in range(1, 30)), True)
    fitted = fit(Model.of(one.robot, [profile]), data)
    robot = parse_robot(robot_to_yaml(apply_fit(fitted)), "model.yaml")
    np.testing.assert_allclose(predict(robot, data).translation, fitted.poses.translation, rtol=0, atol=1e-15)
    beyond = circumstances(one.robot, 400, 5)
    np.testing.assert_array_equal(predict(robot, beyond).translation, fitted.predict(beyond).translation)
    lever = 1.2
    moved = np.linalg.norm(predict(robot, beyond).translation - one.chain.forward(beyond.q).translation, axis=0)
    assert moved.max() < 4 * 3e-4 * lever, "the profile is as large outside as inside, not larger"


def _harmonics() -> dict[str, object]:
    return {
        "effect": "transmission_error",
        "joints": ["j1"],
        "orders": [1, 17],
        "values": {"j1.cos1": 2e-4, "j1.sin17": 3e-4},
    }


def test_a_fit_of_a_listed_effect_widens_its_range() -> None:
    one = arm("puma560")
    effect = TransmissionError(("j1",), (1.0,))
    early = Known(effect, {"transmission_error.j1.cos1": 2e-4}, {"j1": (-0.2, 0.2)})
    data = narrow(one.robot, 80)
    position = one.chain.forward(data.q).translation
    fitted = fit(Model(one, (early,), (effect,)), dataclasses.replace(data, position=position))
    written = known_effects(apply_fit(fitted))[0]
    low, high = float(data.q[0].min()), float(data.q[0].max())
    assert written.validity["j1"] == (min(low, -0.2), max(high, 0.2))
    np.testing.assert_allclose(
        predict(apply_fit(fitted), data).translation, fitted.poses.translation, rtol=0, atol=1e-15
    )


@pytest.mark.parametrize(
    ("validity", "message"),
    [
        ({"j9": [0, 1]}, "validity.j9 is not a driver"),
        ({"j1": [1, 0]}, r"validity.j1 must be \[low, high\]"),
        ({"j1": 3}, r"validity.j1 must be \[low, high\]"),
        ([1, 2], "validity must be a mapping"),
    ],
)
def test_a_wrong_range_is_refused(validity: object, message: str) -> None:
    robot = dataclasses.replace(arm("puma560").robot, effects=({**_harmonics(), "validity": validity},))
    with pytest.raises(InputError, match=message):
        known_effects(robot)


def test_ranges_of_joints_are_in_the_files_angles() -> None:
    effect = {"effect": "gear_ratio", "joints": ["j1"], "values": {"j1": 1e-4}, "validity": {"j1": [-90, 45]}}
    robot = dataclasses.replace(arm("puma560").robot, effects=(effect,), effect_units=(1e-3, np.pi / 180))
    assert known_effects(robot)[0].validity["j1"] == pytest.approx((-np.pi / 2, np.pi / 4))


@pytest.mark.slow
def test_every_command_counts_poses_outside_and_refuses_them_on_request() -> None:
    one = arm("puma560")
    limited = {**_harmonics(), "validity": {"j1": [-0.5, 0.5]}}
    robot = dataclasses.replace(one.robot, effects=(limited,))
    data = robacc.simulate(robot, poses=40, seed=1, noise=2e-5, noise_orientation=1e-5).data
    count = int(np.count_nonzero(np.abs(data.q[0]) > 0.51))
    tolerant = dataclasses.replace(
        robot, joints=tuple(dataclasses.replace(joint, tolerance={"theta": 1e-4}) for joint in robot.joints)
    )
    calls = (
        lambda **more: robacc.estimate(data, robot=robot, **more),
        lambda **more: robacc.iso9283(data, robot=robot, **more),
        lambda **more: robacc.predict(tolerant, poses=data, **more),
        lambda **more: robacc.simulate(robot, poses=40, seed=1, **more),
        lambda **more: robacc.calibrate(data, robot=robot, fit="base_frame", folds=2, **more),
        lambda **more: robacc.trace(data, robot=robot, declared="base_frame,tool_frame", folds=2, **more),
    )
    for call in calls:
        result = call()
        outside = result.document()["outside_validity"]
        assert outside["n_poses"] == count, result.command
        assert outside["ranges"][0]["driver"] == "j1"
        assert any(f"{count} of 40 poses are outside the validity range" in text for text in result.warnings)
        with pytest.raises(InputError, match="outside the validity range"):
            call(strict_range=True)
    inside = robacc.estimate(data.subset(np.abs(data.q[0]) < 0.5), robot=robot, strict_range=True)
    assert inside.document()["outside_validity"]["n_poses"] == 0


@pytest.mark.parametrize("knee", [None, 20.0])
def test_hardening_is_held_well_beyond_the_torques_that_were_seen(knee: float | None) -> None:
    one = Arm.of(arm("puma560").robot)
    wide = circumstances(one.robot, 200, 2)
    torque = weight_torques(one, wide)[one.number("j2")]
    few = np.flatnonzero(np.abs(torque) < 0.2 * np.abs(torque).max())
    effect = JointHardening(("j2",), 50.0, knee)
    validity = effect.validity(one, wide.subset(few))
    low, high = torque[few].min(), torque[few].max()
    assert validity["torque_j2"] == pytest.approx((low, high))
    (free,), (held,) = effect.terms(one, wide), effect.within(validity).terms(one, wide)
    inside = np.abs(torque) <= 1.5 * max(-low, high)
    np.testing.assert_array_equal(held.parts[0].factor[inside], free.parts[0].factor[inside])
    share = 1.5 * max(-low, high) / (knee or 50.0)
    root = max(np.roots([1.0, 0.0, 1.0, -share]), key=lambda root: -abs(root.imag)).real
    largest = share**3 if knee is None else knee * (share - root)
    assert np.abs(held.parts[0].factor).max() == pytest.approx(largest)
    assert np.abs(free.parts[0].factor).max() > 8 * largest
    # A model file keeps the range of the torque, and what it predicts keeps to it.
    written = dataclasses.replace(one.robot, effects=(entry(effect, one.robot, wide.subset(few)),))
    known = parse_robot(robot_to_yaml(written), "model.yaml")
    bare = dataclasses.replace(one.robot, effects=())
    moved = predict(known, wide).translation - predict(bare, wide).translation
    assert np.linalg.norm(moved, axis=0).max() < 1.5 * 1e-4 * largest
