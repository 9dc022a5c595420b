"""A spring between two points across joint 2, on an arm with matrices, torques and a spring's energy of its own."""

from __future__ import annotations

import numpy as np
import pytest
from independent_arm import measured, run, targets, torques
from searched import ARM, SearchEnd, searched

from robacc.effects import REGISTRY
from robacc.measurements import Measurements

NOISE = 1e-5
COMPLIANCE = 2e-6
STIFFNESS = 40000.0
FREE_LENGTH = 0.25
FIXED = 0.5 * np.array([np.cos(0.3), np.sin(0.3)])
"""Point of the link before the joint, in the plane of the joint, m."""
MOVING = np.array([0.2, 0.0])
"""Point of the joint's own link at the joint's zero, m."""


def spring_torque(angle: float) -> float:
    """Torque of the spring about joint 2: minus the slope of its energy."""

    def energy(at: float) -> float:
        turned = np.array([[np.cos(at), -np.sin(at)], [np.sin(at), np.cos(at)]]) @ MOVING
        return float(0.5 * STIFFNESS * (np.linalg.norm(turned - FIXED) - FREE_LENGTH) ** 2)

    return (energy(angle - 1e-5) - energy(angle + 1e-5)) / 2e-5


def poses(kind: str, n: int, seed: int, noise: float) -> Measurements:
    """Poses of an arm whose joint 2 is a spring, with a counterbalance or an eccentric gear beside it."""
    joints = run(n, seed)
    angle = joints.q[1]
    turn = COMPLIANCE * np.array([torques(q)[1] for q in joints.q.T])
    if kind == "counterbalance":
        turn = turn + COMPLIANCE * np.array([spring_torque(value) for value in angle])
    if kind == "eccentric":
        turn = turn + 3e-4 * np.cos(angle - 0.6) + 1e-4 * np.cos(2 * angle + 0.4)
    return measured(joints, joints.turned(1, turn), noise, seed)


def traced(kind: str, n: int, seed: int) -> SearchEnd:
    """The end of a search on poses of an arm of this kind."""
    return searched(poses(kind, n, seed, NOISE), poses(kind, 60, seed + 1, 0.0))


def test_a_counterbalance_is_found_and_predicts_other_poses() -> None:
    effects, values, error = traced("counterbalance", 120, 81)
    assert sorted(map(str, effects)) == ["counterbalance[j2]", "joint_compliance[j2]"]
    assert values["joint_compliance.j2"] == pytest.approx(COMPLIANCE, rel=0.05)
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
    effects, _, _ = traced("spring", 80, seed)
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


def test_wrong_settings_are_refused() -> None:
    for settings, message in (({"ratio": 1.0}, "below 1"), ({"tooth": 3}, "no setting"), ({"ratio": "x"}, "a number")):
        with pytest.raises(ValueError, match=message):
            REGISTRY["counterbalance"].from_settings(("j2",), settings)
