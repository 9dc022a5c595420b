"""Wind-up, hardening, loaded backlash, a common delay and a pedestal, on an arm with matrices of its own."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import pytest
from independent_arm import measured, on_a_pedestal, run, targets, torques
from searched import ARM, fitted, found, values_of

from robacc.effects.base import Effect
from robacc.gravity import gravity_torques
from robacc.measurements import Measurements

NOISE = 1e-5
N = 80
POSES = run(N, seed=21)
TORQUES = np.array([torques(q) for q in POSES.q.T]).T
TORQUE = TORQUES[1]


def positions(turn: np.ndarray) -> np.ndarray:
    """Targets with joint 2 turned by (N,) rad."""
    return POSES.turned(1, turn)


def coefficients(data: Measurements, effects: Sequence[Effect]) -> dict[str, float]:
    return values_of(fitted(data, effects))


def test_torques_of_the_independent_arm_agree() -> None:
    np.testing.assert_allclose(gravity_torques(ARM, POSES.q), TORQUES, atol=1e-5)


@pytest.mark.parametrize(
    ("turn", "seed", "directed", "expected", "sizes"),
    [
        (
            8e-7 * TORQUE - 2.5e-7 * np.abs(TORQUE) * POSES.direction[1],
            1,
            True,
            ["friction_windup[j2]", "joint_compliance[j2]"],
            {"friction_windup.j2": (-2.5e-7, 0.1), "joint_compliance.j2": (8e-7, 0.05)},
        ),
        (
            8e-7 * TORQUE * (1.0 + 0.3 * np.cos(2 * POSES.q[1] - 0.7)),
            8,
            False,
            ["compliance_variation[j2]", "joint_compliance[j2]"],
            {
                "joint_compliance.j2": (8e-7, 0.05),
                "compliance_variation.j2.cos2": (2.4e-7 * np.cos(0.7), 0.2),
                "compliance_variation.j2.sin2": (2.4e-7 * np.sin(0.7), 0.2),
            },
        ),
    ],
    ids=["friction that grows with the load, and no play", "a compliance that differs with the angle"],
)
def test_what_acts_beside_a_spring_is_found(
    turn: np.ndarray, seed: int, directed: bool, expected: list[str], sizes: dict[str, tuple[float, float]]
) -> None:
    data = measured(POSES, positions(turn), NOISE, seed, directed=directed)
    effects = found(data)
    assert sorted(map(str, effects)) == expected
    values = coefficients(data, effects)
    for name, (size, rel) in sizes.items():
        assert values[name] == pytest.approx(size, rel=rel)


@pytest.mark.slow
def test_a_hardening_spring_is_found() -> None:
    reference = float(np.abs(TORQUE).max())
    turn = 6e-4 * (TORQUE / reference) - 3e-4 * (TORQUE / reference) ** 3
    data = measured(POSES, positions(turn), NOISE, 2)
    effects = found(data)
    assert "joint_hardening[j2]" in map(str, effects)
    (hardening,) = [effect for effect in effects if effect.name == "joint_hardening"]
    values = coefficients(data, effects)
    at_largest = values["joint_hardening.j2"] * (reference / hardening.settings()["torque_nm"]) ** 3
    assert at_largest == pytest.approx(-3e-4, rel=0.15)


def test_backlash_whose_flank_gravity_decides_is_found_although_the_approach_is_known() -> None:
    turn = 1.5e-4 * np.sign(TORQUE)
    data = measured(POSES, positions(turn), NOISE, 3, directed=True)
    (effect,) = found(data)
    assert (effect.name, effect.joints, effect.settings()) == ("backlash", ("j2",), {"by": "gravity"})
    assert coefficients(data, [effect])["backlash.j2"] == pytest.approx(1.5e-4, rel=0.05)


def test_friction_keeps_a_lightly_loaded_gear_on_the_flank_of_its_approach() -> None:
    friction = 0.1 * float(np.abs(TORQUE).max())
    loaded = np.abs(TORQUE) > friction
    turn = 1.5e-4 * np.where(loaded, np.sign(TORQUE), POSES.direction[1])
    data = measured(POSES, positions(turn), NOISE, 7, directed=True)
    (effect,) = found(data)
    assert (effect.name, effect.joints, effect.settings()["by"]) == ("backlash", ("j2",), "gravity")
    assert effect.settings()["friction_nm"] == pytest.approx(friction, rel=0.5)
    assert coefficients(data, [effect])["backlash.j2"] == pytest.approx(1.5e-4, rel=0.05)
    assert "flank of its approach" in effect.statement(ARM, {})


def test_one_delay_is_common_to_all_joints() -> None:
    """All joints are read 12 ms late, at speeds of up to 0.02 rad/s that rise to the move's largest: one number."""
    rng = np.random.default_rng(5)
    speed = rng.uniform(-1, 1, (6, N))
    data = dataclasses.replace(measured(POSES, targets(POSES.q - 2e-4 * speed), NOISE, 5), speed=speed)
    (effect,) = found(data)
    assert str(effect) == "approach_lag[common]"
    assert coefficients(data, [effect])["approach_lag.common"] == pytest.approx(-2e-4, rel=0.05)


@pytest.mark.parametrize("height", [0.0, 1.2])
def test_a_pedestal_tilts_about_a_point_below(height: float) -> None:
    compliance = 5e-7
    rows = [on_a_pedestal(q, compliance, height) for q in POSES.q.T]
    data = measured(POSES, np.array(rows).T, NOISE, 6)
    effects = found(data)
    values = coefficients(data, effects)
    if height == 0.0:
        # A tilt about the base's origin and a first joint that bends are the same on an upright axis.
        assert str(effects[0]) in ("base_compliance", "lateral_compliance[j1]")
        assert (len(effects), effects[0].settings()) == (1, {})
        assert [values[name] for name in values if "compliance" in name] == [pytest.approx(compliance, rel=0.05)]
        return
    assert [effect.name for effect in effects] == ["base_compliance"]
    assert effects[0].settings() == {"below": True}
    assert values["base_compliance.tilt"] == pytest.approx(compliance, rel=0.05)
    assert values["base_compliance.shift"] / values["base_compliance.tilt"] == pytest.approx(height, rel=0.1)
    statement = effects[0].statement(ARM, values)
    assert "1.2 m below" in statement or "1.1 m below" in statement or "1.3 m below" in statement
    above = effects[0].statement(ARM, {"base_compliance.tilt": 2e-5, "base_compliance.shift": -4.4e-5})
    assert above == "the base tilts about a point 2.2 m above its origin"


def test_the_poses_cover_both_signs_of_the_torque() -> None:
    """Otherwise loaded backlash would be a constant, and the tests above would test nothing."""
    assert TORQUE.min() < 0 < TORQUE.max()
    light = np.abs(TORQUE) < 0.1 * np.abs(TORQUE).max()
    assert np.any(light & (np.sign(TORQUE) != POSES.direction[1]))
