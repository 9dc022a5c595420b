"""Effects whose setting a search refines, or that it tries beside another, on an arm with matrices of its own."""

from __future__ import annotations

import numpy as np
import pytest
from independent_arm import measured, run, targets, torques
from scipy.optimize import brentq
from searched import ARM, SearchEnd, searched

from robacc.effects import REGISTRY
from robacc.measurements import Measurements

NOISE = 1e-5
COMPLIANCE = 2.5e-6
LARGEST = max(abs(torques(q)[1]) for q in run(200, seed=90).q.T)
KNEE = 0.5 * LARGEST
FRICTION = 0.05 * LARGEST
PLAY = 1.5e-4
ORDER = 62.0
BALANCED = 2e-6
"""Compliance of a joint with a counterbalance, rad/(N m)."""
STIFFNESS = 40000.0
FREE_LENGTH = 0.25
FIXED = 0.5 * np.array([np.cos(0.3), np.sin(0.3)])
"""Point of the link before the joint, in the plane of the joint, m."""
MOVING = np.array([0.2, 0.0])
"""Point of the joint's own link at the joint's zero, m."""


def hardened(torque: float) -> float:
    """Deflection of a spring k x (1 + (x / x_knee)^2), by a search for its root."""
    knee = KNEE * COMPLIANCE
    return float(brentq(lambda x: x / COMPLIANCE * (1.0 + (x / knee) ** 2) - torque, -1.0, 1.0, xtol=1e-15))


def spring_torque(angle: float) -> float:
    """Torque of the spring about joint 2: minus the slope of its energy."""

    def energy(at: float) -> float:
        turned = np.array([[np.cos(at), -np.sin(at)], [np.sin(at), np.cos(at)]]) @ MOVING
        return float(0.5 * STIFFNESS * (np.linalg.norm(turned - FIXED) - FREE_LENGTH) ** 2)

    return (energy(angle - 1e-5) - energy(angle + 1e-5)) / 2e-5


def poses(mechanism: str, n: int, seed: int, noise: float) -> Measurements:
    """Poses of an arm whose joint 2 errs by one mechanism."""
    joints = run(n, seed)
    torque = np.array([torques(q)[1] for q in joints.q.T])
    approach = joints.direction[1]
    turn = {
        "hardening": lambda: np.array([hardened(value) for value in torque]),
        "harmonic": lambda: 2e-4 * np.cos(ORDER * joints.q[1] - 0.4),
        "loaded harmonic": lambda: 2e-4 * (1.0 + 0.6 * torque / LARGEST) * np.cos(ORDER * joints.q[1] - 0.4),
        "loaded play": lambda: PLAY * np.where(np.abs(torque) > FRICTION, np.sign(torque), approach),
        "spring": lambda: COMPLIANCE * torque,
        "balanced spring": lambda: BALANCED * torque,
        "counterbalance": lambda: BALANCED * (torque + [spring_torque(value) for value in joints.q[1]]),
        "eccentric": lambda: (
            BALANCED * torque + 3e-4 * np.cos(joints.q[1] - 0.6) + 1e-4 * np.cos(2 * joints.q[1] + 0.4)
        ),
    }[mechanism]()
    return measured(joints, joints.turned(1, turn), noise, seed, directed=True)


def traced(mechanism: str, n: int, seed: int) -> SearchEnd:
    """The end of a search on poses of an arm with this mechanism."""
    return searched(poses(mechanism, n, seed, NOISE), poses(mechanism, 60, seed + 1, 0.0))


def test_the_knee_of_a_hardening_spring_is_found() -> None:
    """The cube of the torque alone leaves more than noise, which a correction would describe."""
    effects, values, error = traced("hardening", 120, 71)
    assert sorted(map(str, effects)) == ["joint_compliance[j2]", "joint_hardening[j2]"]
    (hardening,) = [effect for effect in effects if effect.name == "joint_hardening"]
    assert hardening.settings()["knee_nm"] == pytest.approx(KNEE, rel=0.15)
    assert values["joint_compliance.j2"] == pytest.approx(COMPLIANCE, rel=0.05)
    assert values["joint_hardening.j2"] == pytest.approx(COMPLIANCE, rel=0.15)
    assert error < 1e-5
    assert "twice as stiff at" in hardening.statement(ARM, values)


@pytest.mark.parametrize("share", [0.01, 0.3, 1.0, 5.0])
def test_the_spring_is_the_root_of_its_cubic(share: float) -> None:
    """The column plus the linear spring is the deflection found by bisection, at any torque over the knee."""
    data = run(20, 5)
    torque = np.array([torques(q)[1] for q in data.q.T])
    scale = share * LARGEST / np.abs(torque).max()
    # A torque and a knee that are both larger have a column that is as much larger.
    effect = REGISTRY["joint_hardening"].from_settings(("j2",), {"knee_nm": KNEE / scale})
    (term,) = effect.terms(ARM, Measurements(np.zeros((3, 20)), q=data.q))
    expected = [hardened(value) for value in scale * torque]
    np.testing.assert_allclose(COMPLIANCE * scale * (term.parts[0].factor + torque), expected, rtol=1e-8, atol=1e-13)


def test_a_harmonic_that_grows_with_the_load_is_found() -> None:
    effects, values, error = traced("loaded harmonic", 150, 73)
    assert sorted(map(str, effects)) == ["compliance_variation[j2]", "transmission_error[j2]"]
    orders = [effect.settings()["orders"][0] for effect in effects]
    assert orders == pytest.approx([ORDER, ORDER], abs=0.2)
    sizes = [np.hypot(*(value for name, value in values.items() if name.startswith(effect.name))) for effect in effects]
    assert sizes[1] * LARGEST / sizes[0] == pytest.approx(0.6, rel=0.25)
    assert error < 2e-5


@pytest.mark.slow
def test_a_harmonic_without_load_brings_no_variation_of_the_compliance() -> None:
    assert [str(effect) for effect in traced("harmonic", 150, 75).effects] == ["transmission_error[j2]"]


def test_friction_that_keeps_the_flank_is_refined() -> None:
    """The friction lies between the torques of the last pose that stays and of the first that is pressed over."""
    effects, values, _ = traced("loaded play", 200, 77)
    assert [(effect.name, effect.joints) for effect in effects] == [("backlash", ("j2",))]
    joints = run(200, 77)
    torque = np.array([torques(q)[1] for q in joints.q.T])
    opposed = np.abs(torque[np.sign(torque) != joints.direction[1]])
    low, high = opposed[opposed < FRICTION].max(), opposed[opposed > FRICTION].min()
    assert low < effects[0].settings()["friction_nm"] < high
    assert values["backlash.j2"] == pytest.approx(PLAY, rel=0.05)


@pytest.mark.slow
def test_a_linear_spring_has_no_knee() -> None:
    effects, values, error = traced("spring", 120, 79)
    assert [str(effect) for effect in effects] == ["joint_compliance[j2]"]
    assert values["joint_compliance.j2"] == pytest.approx(COMPLIANCE, rel=0.05)
    assert error < 1e-5


# A spring between two points across joint 2.


def test_a_counterbalance_is_found_and_predicts_other_poses() -> None:
    effects, values, error = traced("counterbalance", 120, 81)
    assert sorted(map(str, effects)) == ["counterbalance[j2]", "joint_compliance[j2]"]
    assert values["joint_compliance.j2"] == pytest.approx(BALANCED, rel=0.05)
    assert values["counterbalance.j2.spring"] * values["counterbalance.j2.length"] < 0
    assert error < 1e-5
    (effect,) = [effect for effect in effects if effect.name == "counterbalance"]
    # The spring is longest where the moving point is opposite the fixed one.
    opposite = np.degrees(0.3 + np.pi)
    turn = (effect.settings()["centre_deg"] - opposite + 180.0) % 360.0 - 180.0
    assert abs(turn) < 10.0
    assert "spring or cylinder across j2" in effect.statement(ARM, values)


@pytest.mark.parametrize("seed", [83, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(300, 320))])
def test_an_eccentric_gear_is_no_counterbalance(seed: int) -> None:
    effects, _, _ = traced("eccentric", 100, seed)
    assert sorted({effect.name for effect in effects}) == ["joint_compliance", "transmission_error"]


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(400, 420))
def test_a_spring_alone_is_no_counterbalance(seed: int) -> None:
    effects, _, _ = traced("balanced spring", 80, seed)
    assert [str(effect) for effect in effects] == ["joint_compliance[j2]"]


def test_the_columns_are_the_torque_of_the_spring() -> None:
    """With the place of the simulated spring, both coefficients follow from stiffness and radii."""
    a, b = float(np.linalg.norm(FIXED)), float(np.linalg.norm(MOVING))
    reach = a**2 + b**2
    effect = REGISTRY["counterbalance"].from_settings(
        ("j2",), {"centre_deg": float(np.degrees(0.3 + np.pi)), "ratio": 2 * a * b / reach}
    )
    data = run(30, 9)
    measurements = measured(data, targets(data.q), 0.0, 9)
    spring, length = (term.parts[0].factor for term in effect.terms(ARM, measurements))
    # Length^2 = reach + 2 a b cos(q - q_0); torque = stiffness (length - free) / length a b sin(q - q_0).
    expected = [spring_torque(value) for value in data.q[1]]
    size = STIFFNESS * a * b
    np.testing.assert_allclose(size * (spring - FREE_LENGTH / np.sqrt(reach) * length), expected, rtol=1e-6, atol=1e-5)
