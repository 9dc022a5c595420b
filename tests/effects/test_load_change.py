"""A load at the flange that changes between two poses and that nobody logged, on an arm with matrices of its own."""

from __future__ import annotations

import numpy as np
import pytest
from independent_arm import DECLARED, GRAVITY, TOOL, Run, measured, robot, run, target, torques

from robacc.effects import REGISTRY
from robacc.effects.request import build, parse_requests
from robacc.fitting.fit_result import Options
from robacc.fitting.solver import fit
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.robots.arm import Arm
from robacc.tracing.search import search

NOISE = 2e-5
N = 90
AT = 50
"""Number of the first pose with the load, from 0: line 52 of the file."""
COMPLIANCE = np.array([0.0, 8e-7, 1.2e-6, 0.0, 0.0, 0.0])
ARM = Arm.of(robot())


def positions(poses: Run, mass: float) -> np.ndarray:
    """Targets of an arm whose joints 2 and 3 give way to its weight and, from pose AT on, to a load at the tool."""
    result = []
    for i, q in enumerate(poses.q.T):
        weight = mass * GRAVITY * (i >= AT)
        torque = torques(q, lambda frames, weight=weight: weight * float((frames[-1] @ np.append(TOOL, 1.0))[2]))
        result.append(target(q + COMPLIANCE * torque))
    return np.array(result).T


def loaded(seed: int, mass: float, noise: float = NOISE) -> Measurements:
    poses = run(N, seed)
    return measured(poses, positions(poses, mass), noise, seed)


def names(data: Measurements) -> list[str]:
    """What a search beside frames, zeros and geometry finds."""
    declared = build(parse_requests(DECLARED), ARM, data)
    return sorted(map(str, search(Model(ARM, free=declared), data).effects))


def test_the_load_is_found_with_its_line_and_size() -> None:
    data = loaded(4, 25.0)
    declared = build(parse_requests(DECLARED), ARM, data)
    effects = search(Model(ARM, free=declared), data).effects
    assert sorted(map(str, effects)) == ["joint_compliance[j2]", "joint_compliance[j3]", "step[payload]"]
    (step,) = [effect for effect in effects if effect.name == "step"]
    assert abs(step.settings()["from_line"] - (AT + 2)) <= 3
    result = fit(Model(ARM, free=(*declared, *effects)), data, Options())
    values = dict(zip(result.names, result.theta.tolist(), strict=True))
    assert values["step.j2"] == pytest.approx(25.0 * COMPLIANCE[1], rel=0.3)
    assert values["step.j3"] == pytest.approx(25.0 * COMPLIANCE[2], rel=0.3)
    statement = step.statement(ARM, values)
    assert statement is not None
    assert "carries another load" in statement
    assert "payload_kg" in statement


def test_its_column_is_the_difference_of_two_torques() -> None:
    """At a small deflection, the fitted coefficient times the torque of 1 kg is the deflection by the load."""
    data = loaded(5, 25.0, noise=0.0)
    effect = REGISTRY["step"].from_settings(("j2", "j3"), {"part": "payload", "from_line": AT + 2})
    declared = build(parse_requests("joint_compliance[j2,j3]"), ARM, data)
    result = fit(Model(ARM, free=(*declared, effect)), data, Options())
    values = dict(zip(result.names, result.theta.tolist(), strict=True))
    assert values["step.j2"] == pytest.approx(25.0 * COMPLIANCE[1], rel=2e-3)
    assert values["step.j3"] == pytest.approx(25.0 * COMPLIANCE[2], rel=2e-3)


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
