"""A load at the flange that changes between two poses and that nobody logged, on an arm with matrices of its own."""

from __future__ import annotations

import numpy as np
import pytest
from independent_arm import load_torques, measured, run, target
from searched import ARM, fitted, found, values_of

from robacc.effects import REGISTRY
from robacc.measurements import Measurements

NOISE = 2e-5
N = 90
AT = 50
"""Number of the first pose with the load, from 0: line 52 of the file."""
COMPLIANCE = np.array([0.0, 8e-7, 1.2e-6, 0.0, 0.0, 0.0])


def loaded(seed: int, mass: float, noise: float = NOISE) -> Measurements:
    """Poses of an arm whose joints 2 and 3 give way to its weight and, from pose AT on, to a load at the tool."""
    poses = run(N, seed)
    turned = [q + COMPLIANCE * load_torques(q, mass * (i >= AT)) for i, q in enumerate(poses.q.T)]
    return measured(poses, np.array([target(q) for q in turned]).T, noise, seed)


def names(data: Measurements) -> list[str]:
    return sorted(map(str, found(data)))


def test_the_load_is_found_with_its_line_and_size() -> None:
    data = loaded(4, 25.0)
    effects = found(data)
    assert sorted(map(str, effects)) == ["joint_compliance[j2]", "joint_compliance[j3]", "step[payload]"]
    (step,) = [effect for effect in effects if effect.name == "step"]
    assert abs(step.settings()["from_line"] - (AT + 2)) <= 3
    values = values_of(fitted(data, effects))
    assert [values["step.j2"], values["step.j3"]] == pytest.approx(25.0 * COMPLIANCE[1:3], rel=0.3)
    statement = step.statement(ARM, values)
    assert "carries another load" in statement
    assert "payload_kg" in statement


def test_its_column_is_the_difference_of_two_torques() -> None:
    """At a small deflection, the fitted coefficient times the torque of 1 kg is the deflection by the load."""
    effect = REGISTRY["step"].from_settings(("j2", "j3"), {"part": "payload", "from_line": AT + 2})
    values = values_of(fitted(loaded(5, 25.0, noise=0.0), (effect,), declared="joint_compliance[j2,j3]"))
    assert [values["step.j2"], values["step.j3"]] == pytest.approx(25.0 * COMPLIANCE[1:3], rel=2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(20))
def test_arms_whose_load_stays_have_no_step(seed: int) -> None:
    assert "step" not in " ".join(names(loaded(100 + seed, 0.0)))


@pytest.mark.slow
def test_a_load_is_found_from_its_detection_limit_on() -> None:
    """A load that moves the tool by three times the noise is found, one of a fifth of the noise is not."""
    share = [sum("step[payload]" in names(loaded(200 + seed, mass)) for seed in range(4)) for mass in (1.0, 15.0)]
    assert share[0] == 0
    assert share[1] >= 3


def test_settings_are_read_back() -> None:
    effect = REGISTRY["step"].from_settings(("j2", "j3"), {"part": "payload", "from_line": 52})
    assert REGISTRY["step"].from_settings(("j2", "j3"), effect.settings()) == effect
    assert str(effect) == "step[payload]"
    with pytest.raises(ValueError, match="payload with joints"):
        REGISTRY["step"].from_settings((), {"part": "payload", "from_line": 52})
