"""Step changes on an arm with kinematics of its own: part, place and size are found, and clean arms have none."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from independent_arm import DECLARED, TOOL, Run, measured, robot, run, target, targets
from searched import ARM, model

import robacc
from robacc.effects.base import Effect
from robacc.effects.campaign import Step
from robacc.effects.specification import known_effects
from robacc.errors import InputError
from robacc.geometry import rotation_about
from robacc.measurements import Measurements
from robacc.robots.arm import Arm
from robacc.tracing.trace import Trace, trace

NOISE = 2e-5
N = 90
AT = 55
"""Number of the first pose after the step, from 0: line 57 of the file."""


def positions(poses: Run, part: str, size: float) -> np.ndarray:
    """Targets of a run whose base, target or third joint steps at pose AT."""
    result = []
    for i, q in enumerate(poses.q.T):
        after = i >= AT
        tool = TOOL + after * (part == "target") * size * np.array([0.6, -0.6, 0.53])
        zero = after * (part == "joint") * size * np.array([0, 0, 1, 0, 0, 0])
        point = target(q + zero, tool)
        if after and part == "base":
            point = rotation_about(2, size) @ point + size * np.array([0.0, 0.8, -0.6])
        result.append(point)
    return np.array(result).T


def traced(data: Measurements) -> Trace:
    return trace(model(data), data, n_folds=4)


@pytest.mark.parametrize(("part", "timed"), [("target", False), ("base", True), ("joint", False)])
def test_part_place_and_size_are_found(part: str, timed: bool) -> None:
    poses = run(N, seed=4)
    result = traced(measured(poses, positions(poses, part, 2e-4), NOISE, 4, timed=timed))
    (finding,) = result.findings
    assert finding.effect == "step"
    assert finding.settings.get("part", "joint") == part
    assert finding.joints == (("j3",) if part == "joint" else ())
    place, low, high = finding.change
    assert low <= place <= high
    # A single pose shows steps of ten times the noise; the place may be off by a pose or two of small displacement.
    expected = float(poses.time[AT - 1 : AT + 1].mean()) if timed else AT + 2
    assert abs(place - expected) <= (70.0 if timed else 2)
    assert low <= expected <= high
    sizes = np.array([p.value for p in finding.parameters if p.unit == "m" or part == "joint"])
    assert np.linalg.norm(sizes) == pytest.approx(2e-4, rel=0.2)
    assert "line 5" in finding.statement
    assert ("jumps" if part == "joint" else "displaced") in finding.statement


@pytest.mark.slow
def test_two_steps_are_found() -> None:
    poses = run(N, seed=6)
    position = positions(poses, "target", 2.5e-4)
    late = np.arange(N) >= 75
    position = np.where(late, position + np.array([[3e-4], [0.0], [-3e-4]]), position)
    result = traced(measured(poses, position, NOISE, 6))
    assert sorted(finding.settings["part"] for finding in result.findings) == ["base", "target"]
    at = {finding.settings["part"]: finding.settings["from_line"] for finding in result.findings}
    assert abs(at["target"] - (AT + 2)) <= 2
    assert abs(at["base"] - 77) <= 2


def test_clean_arms_have_no_step() -> None:
    """Two arms here; twenty in the study that docs/explanation/tracing.md quotes."""
    for seed in (31, 32):
        poses = run(N, seed)
        assert traced(measured(poses, targets(poses.q), NOISE, seed)).findings == ()


def test_errors_that_wander_are_no_steps() -> None:
    """A tracker's mounting that creeps: correlated over some 30 poses, one and a half times the noise."""
    poses, memory = run(N, 41), 0.97
    wander = np.random.default_rng(41).normal(size=(3, N))
    for i in range(1, N):
        wander[:, i] = memory * wander[:, i - 1] + np.sqrt(1 - memory**2) * wander[:, i]
    data = measured(poses, targets(poses.q) + 1.5 * NOISE * wander, NOISE, 41)
    assert "step" not in [finding.effect for finding in traced(data).findings]


@pytest.mark.slow
def test_two_steps_of_one_part_have_coefficients_of_their_own() -> None:
    poses = run(N, seed=7)
    position = targets(poses.q)
    for first, shift in ((30, 4e-4), (62, -7e-4)):
        position = np.where(np.arange(N) >= first, position + np.array([[0.0], [shift], [0.6 * shift]]), position)
    result = robacc.trace(measured(poses, position, NOISE, 7), robot=robot(), declared=DECLARED)
    assert [finding.effect for finding in result.findings] == ["step", "step"]
    assert result.robot.fit["coefficients"].count("step.x") == 2


def test_a_knocked_tracker_is_found_with_three_targets_a_visit() -> None:
    places_of_targets = {"N1": TOOL, "N2": TOOL + np.array([0.2, 0.1, 0.0]), "N3": TOOL + np.array([-0.1, 0.2, 0.05])}
    visits, first = 60, 35
    poses = run(visits, seed=12)
    rng = np.random.default_rng(12)
    position = np.array([target(q, place) for q in poses.q.T for place in places_of_targets.values()]).T
    visit = np.repeat(np.arange(visits), 3)
    position += (visit >= first) * np.array([[2e-4], [0.0], [-1e-4]]) + rng.normal(scale=NOISE, size=position.shape)
    data = Measurements(
        position=position,
        q=poses.q[:, visit],
        target=np.tile(np.array(list(places_of_targets)), visits),
        visit=visit.astype(str),
        rows=np.arange(2, 3 * visits + 2),
        source="poses.csv",
    )
    (finding,) = trace(model(data, Arm.of(robot(places_of_targets))), data, n_folds=4).findings
    assert (finding.effect, finding.settings["part"]) == ("step", "base")
    assert finding.settings["from_line"] == 3 * first + 2


def test_poses_of_another_file_come_after_the_step() -> None:
    step = Step((), "target", from_line=40, file="poses.csv")
    data = measured(run(60, 1), np.zeros((3, 60)), NOISE, 1)
    np.testing.assert_array_equal(step.after(data), np.arange(2, 62) >= 40)
    assert step.after(dataclasses.replace(data, source="folder/other.csv")).all()
    assert step.after(dataclasses.replace(data, rows=None)).all()
    timed = Step(("j2",), "joint", from_time=100.0)
    assert timed.after(data).all()
    late = dataclasses.replace(data, time=np.linspace(0, 199, 60))
    np.testing.assert_array_equal(timed.after(late), late.time >= 100.0)


@pytest.mark.parametrize(
    "effect",
    [
        Step((), "base", from_line=12, turning=True),
        Step((), "target", from_time=12.5, target="a"),
        Step(("j2",), "joint", from_line=12, file="poses.csv"),
        Step(("j2", "j3"), "payload", from_line=52),
    ],
)
def test_settings_are_read_back(effect: Effect) -> None:
    assert Step.from_settings(effect.joints, effect.settings()) == effect
    terms = effect.terms(ARM, measured(run(5, 1), np.zeros((3, 5)), NOISE, 1))
    assert len(terms) == {"base": 6, "target": 3, "joint": 1, "payload": 2}[effect.part]  # type: ignore[attr-defined]


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ({"effect": "step", "values": {"x": 1e-4}}, "expected from_line or from_time_s"),
        ({"effect": "step", "part": "floor", "from_line": 3, "values": {"x": 1e-4}}, "part must be base or target"),
        ({"effect": "step", "joints": ["j2"], "part": "base", "from_line": 3, "values": {"j2": 1e-4}}, "expected part"),
        ({"effect": "step", "from_line": 2.5, "values": {"x": 1e-4}}, "whole number"),
        ({"effect": "step", "part": "payload", "from_line": 52, "values": {"x": 1e-4}}, "payload with joints"),
        ({"effect": "step", "from_line": 2, "target": "a", "values": {"x": 1e-4}}, "target belongs to"),
    ],
)
def test_wrong_entries_are_refused(entry: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        known_effects(dataclasses.replace(robot(), effects=(entry,)))
