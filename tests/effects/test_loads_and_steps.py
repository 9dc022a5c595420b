"""Loads and steps that the files do not state, on an arm with kinematics and torques of its own."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import independent_arm
import numpy as np
import pytest
from independent_arm import (
    DH,
    TOOL,
    Matrix,
    Run,
    load_torques,
    measured,
    measured_with_loads,
    robot,
    run,
    target,
    targets,
)
from searched import ARM, error_at, fitted, found, model, values_of

from robacc.api.inputs import read_poses, write_poses
from robacc.effects import REGISTRY
from robacc.effects.campaign import Step
from robacc.effects.elastic import JointCompliance, PayloadCompliance
from robacc.effects.specification import build, known_effects, parse_requests
from robacc.errors import InputError, UsageError
from robacc.fitting.masses import UndeclaredLoad, undeclared_load
from robacc.geometry import rotation_about
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.robots.arm import Arm
from robacc.tracing.trace import Trace, trace

# Loads that the robot file or the poses do not state, or only by name, on an arm with torques of its own.

NOISE = 1e-5

COMPLIANCE = 6e-7

# Payloads whose centre of mass the robot file does not state.
FAR = np.array([0.3, -0.2, 0.45])

"""Centre of mass in the last link's frame, m; the file has none, which means the tool's place."""


def with_centre(n: int, seed: int, noise: float, com: Matrix) -> Measurements:
    """Poses of an arm whose joint 2 gives way to payloads of 0, 20 and 60 kg."""
    mass = np.random.default_rng(seed).choice([0.0, 20.0, 60.0], n)
    return dataclasses.replace(measured_with_loads(n, seed, noise, COMPLIANCE, mass, com), payload=mass)


def error_with_centre(effect: PayloadCompliance, com: Matrix) -> float:
    return error_at(fitted(with_centre(80, 61, NOISE, com), (effect,)), with_centre(60, 62, 0.0, com))


def test_another_centre_is_found_and_predicts_other_poses() -> None:
    assert found(with_centre(80, 61, NOISE, FAR)) == (PayloadCompliance(("j2",), "uncertain"),)
    assert error_with_centre(PayloadCompliance(("j2",), "uncertain"), FAR) < 1.2e-5
    assert error_with_centre(PayloadCompliance(("j2",)), FAR) > 2.4e-5


def test_first_moments_times_the_centre_are_the_payload() -> None:
    """Both forms predict the same poses where the coefficients are those of the centre."""
    data = with_centre(20, 63, 0.0, FAR)
    moved = Arm.of(dataclasses.replace(robot(), payload_com=tuple(FAR.tolist())))
    known = Model(moved, free=(PayloadCompliance(("j2",)),)).bind(data).poses(np.array([COMPLIANCE]))
    uncertain = Model(ARM, free=(PayloadCompliance(("j2",), "uncertain"),)).bind(data)
    poses = uncertain.poses(COMPLIANCE * np.array([1.0, *(FAR - TOOL)]))
    np.testing.assert_allclose(poses.translation, known.translation, atol=1e-12)


# Loads of unknown mass that a column names.
LOADS = {"none": 0.0, "gripper": 20.0, "part": 60.0}

"""Masses at the tool, kg."""


def with_named_loads(n: int, seed: int, noise: float) -> Measurements:
    """Poses of an arm whose joint 2 gives way to loads that only have names."""
    names = np.random.default_rng(seed).choice(list(LOADS), n)
    mass = np.array([LOADS[name] for name in names])
    return dataclasses.replace(measured_with_loads(n, seed, noise, COMPLIANCE, mass), payload_group=names)


def test_named_loads_are_found_with_their_ratios_and_predict_other_poses(tmp_path: Path) -> None:
    write_poses(tmp_path / "poses.csv", with_named_loads(80, 61, NOISE))
    data = read_poses(tmp_path / "poses.csv", robot=robot())
    (effect,) = found(data)
    assert effect == PayloadCompliance(("j2",), groups=("gripper", "part"))
    result = fitted(data, (effect,))
    values = values_of(result)
    # 80 poses of 10 um show a product of 6e-7 rad/(N m) and 60 kg to about 1 %.
    assert values["payload_compliance.j2.part"] == pytest.approx(60 * COMPLIANCE, rel=0.05)
    assert values["payload_compliance.j2.gripper"] == pytest.approx(20 * COMPLIANCE, rel=0.15)
    assert "part 1.00" in effect.statement(ARM, values)
    # Some thirty coefficients of 240 coordinates leave 0.6 of the noise of three coordinates.
    assert error_at(result, with_named_loads(60, 62, 0.0)) < 1.2e-5


def test_a_load_of_another_name_and_a_single_name_are_refused() -> None:
    data = with_named_loads(40, 63, NOISE)
    effect = PayloadCompliance(("j2",), groups=("gripper",))
    with pytest.raises(UsageError, match="a row carries 'part'"):
        effect.terms(ARM, data)
    alone = dataclasses.replace(data, payload_group=np.full(data.n, "part"))
    assert PayloadCompliance.missing(ARM, alone) == PayloadCompliance.traits.needs[2].reason
    again = PayloadCompliance.from_settings(("j2",), {"com": "uncertain", "groups": ["gripper"]})
    assert again == PayloadCompliance(("j2",), "uncertain", ("gripper",))


# A load at the flange that changes between two poses and that nobody logged.
N = 90

AT = 50

"""Number of the first pose with the load, from 0: line 52 of the file."""

OF_BOTH = np.array([0.0, 8e-7, 1.2e-6, 0.0, 0.0, 0.0])


def with_a_change(seed: int, mass: float, noise: float = 2e-5) -> Measurements:
    """Poses of an arm whose joints 2 and 3 give way to its weight and, from pose AT on, to a load at the tool."""
    poses = run(N, seed)
    turned = [q + OF_BOTH * load_torques(q, mass * (i >= AT)) for i, q in enumerate(poses.q.T)]
    return measured(poses, np.array([target(q) for q in turned]).T, noise, seed)


def names(data: Measurements) -> list[str]:
    return sorted(map(str, found(data)))


def test_the_load_is_found_with_its_line_and_size() -> None:
    data = with_a_change(4, 25.0)
    effects = found(data)
    assert sorted(map(str, effects)) == ["joint_compliance[j2]", "joint_compliance[j3]", "step[payload]"]
    (step,) = [effect for effect in effects if effect.name == "step"]
    assert abs(step.settings()["from_line"] - (AT + 2)) <= 3
    values = values_of(fitted(data, effects))
    assert [values["step.j2"], values["step.j3"]] == pytest.approx(25.0 * OF_BOTH[1:3], rel=0.3)
    statement = step.statement(ARM, values)
    assert "carries another load" in statement
    assert "payload_kg" in statement


def test_its_column_is_the_difference_of_two_torques() -> None:
    """At a small deflection, the fitted coefficient times the torque of 1 kg is the deflection by the load."""
    effect = REGISTRY["step"].from_settings(("j2", "j3"), {"part": "payload", "from_line": AT + 2})
    values = values_of(fitted(with_a_change(5, 25.0, noise=0.0), (effect,), declared="joint_compliance[j2,j3]"))
    assert [values["step.j2"], values["step.j3"]] == pytest.approx(25.0 * OF_BOTH[1:3], rel=2e-3)


# A constant load at a link that the robot file does not state.
OF_TWO = np.array([0.0, 6e-7, 8e-7, 0.0, 0.0, 0.0])


def with_undeclared_load(n: int, seed: int, noise: float, link: int, mass: float, com: Matrix) -> Measurements:
    """Poses of an arm whose joints 2 and 3 give way to its own weight and to a mass at link ``link``, from 0."""
    poses = run(n, seed)
    torque = np.array([load_torques(q, mass, com, link) for q in poses.q.T]).T
    return measured(poses, targets(poses.q + OF_TWO[:, None] * torque), noise, seed)


def arm_that_states(link: int, mass: float, com: Matrix) -> Arm:
    """The arm of a file that has the load in its link."""
    joints = list(robot().joints)
    joint = joints[link]
    own, total = np.array(joint.com), float(joint.mass or 0.0) + mass
    together = tuple(((joint.mass or 0.0) * own + mass * com) / total)
    joints[link] = dataclasses.replace(joint, mass=total, com=together)
    return Arm.of(dataclasses.replace(robot(), joints=tuple(joints)))


@pytest.mark.parametrize(
    ("link", "mass", "com"),
    [
        pytest.param(2, 12.0, (0.05, 0.1, 0.1), id="valve block on the upper arm", marks=pytest.mark.slow),
        pytest.param(5, 15.0, (0.1, 0.05, 0.2), id="tool"),
    ],
)
def test_an_undeclared_load_is_named_and_the_fit_reaches_the_floor(link: int, mass: float, com: tuple) -> None:
    place = np.array(com)
    data, fresh = (
        with_undeclared_load(80, 1, NOISE, link, mass, place),
        with_undeclared_load(60, 2, 0.0, link, mass, place),
    )
    effects = found(data)
    assert {str(effect) for effect in effects} == {"joint_compliance[j2]", "joint_compliance[j3]"}
    uncertain = [effect for effect in effects if effect.settings() == {"masses": "uncertain"}]
    assert "a link carries a load that the file does not state" in uncertain[0].statement(ARM, {})
    springs = build(parse_requests("joint_compliance[j2],joint_compliance[j3]"), ARM, data)
    floor = error_at(fitted(data, springs, arm_that_states(link, mass, place)), fresh)
    # The noise is three times the floor. At 80 poses the evidence is for uncertain masses in one spring alone, which
    # is 1.7 times the floor; uncertain masses in both are 1.4 times.
    assert error_at(fitted(data, effects), fresh) < 1.8 * floor
    assert error_at(fitted(data, springs), fresh) > 1.4 * floor


def judged(data: Measurements, arm: Arm = ARM) -> UndeclaredLoad:
    """What the springs of joints 2 and 3 point to, with uncertain masses."""
    return undeclared_load(fitted(data, (JointCompliance(("j2", "j3"), "uncertain"),), arm), data)


def test_a_tool_that_is_not_declared_is_named_with_its_mass() -> None:
    load = judged(with_undeclared_load(80, 1, NOISE, 5, 15.0, np.array([0.1, 0.05, 0.2])))
    assert load.is_named
    assert [place.link for place in load.places] == ["j6"]
    assert load.places[0].low < 15.0 < load.places[0].high
    # The poses determine compliance times first moment: the mass is known to a factor of two or three.
    assert 7.0 < load.places[0].mass < 30.0
    assert "kg more on the link of j6 (95 %:" in load.statement


@pytest.mark.parametrize("error", [None, 0.02], ids=["10 percent", "2 percent"])
def test_a_load_within_the_errors_of_the_masses_is_named_only_if_these_are_known(error: float | None) -> None:
    arm = Arm.of(dataclasses.replace(robot(), mass_uncertainty=error))
    load = judged(with_undeclared_load(80, 1, NOISE, 2, 20.0, np.array([0.05, 0.1, 0.1])), arm)
    # The link of j3 has 30 kg in the file.
    assert load.is_named == (error is not None)
    assert load.places[0].link == "j3"
    assert load.places[0].low < 20.0 < load.places[0].high


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(1, 40))])
def test_no_load_is_named_where_the_masses_of_the_file_are_wrong(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    factors = np.clip(1.0 + 0.2 * np.random.default_rng(seed).normal(size=6), 0.2, None)
    wrong = tuple((*row[:4], row[4] * factor, row[5]) for row, factor in zip(DH, factors, strict=True))
    monkeypatch.setattr(independent_arm, "DH", wrong)
    load = judged(with_undeclared_load(80, seed, NOISE, 0, 0.0, np.zeros(3)))
    assert not load.is_named
    assert "is not distinguishable from errors" in load.statement


# Step changes on an arm with kinematics of its own: part, place and size are found, and clean arms have none.

STEP_NOISE = 2e-5

STEPPED = 55

"""Number of the first pose after the step, from 0: line 57 of the file."""


def positions(poses: Run, part: str, size: float) -> np.ndarray:
    """Targets of a run whose base, target or third joint steps at pose AT."""
    result = []
    for i, q in enumerate(poses.q.T):
        after = i >= STEPPED
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
    result = traced(measured(poses, positions(poses, part, 2e-4), STEP_NOISE, 4, timed=timed))
    (finding,) = result.findings
    assert finding.effect == "step"
    assert finding.settings.get("part", "joint") == part
    assert finding.joints == (("j3",) if part == "joint" else ())
    place, low, high = finding.change
    assert low <= place <= high
    # A single pose shows steps of ten times the noise; the place may be off by a pose or two of small displacement.
    expected = float(poses.time[STEPPED - 1 : STEPPED + 1].mean()) if timed else STEPPED + 2
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
    result = traced(measured(poses, position, STEP_NOISE, 6))
    assert sorted(finding.settings["part"] for finding in result.findings) == ["base", "target"]
    at = {finding.settings["part"]: finding.settings["from_line"] for finding in result.findings}
    assert abs(at["target"] - (STEPPED + 2)) <= 2
    assert abs(at["base"] - 77) <= 2


def test_errors_that_wander_are_no_steps() -> None:
    """A tracker's mounting that creeps: correlated over some 30 poses, one and a half times the noise."""
    poses, memory = run(N, 41), 0.97
    wander = np.random.default_rng(41).normal(size=(3, N))
    for i in range(1, N):
        wander[:, i] = memory * wander[:, i - 1] + np.sqrt(1 - memory**2) * wander[:, i]
    data = measured(poses, targets(poses.q) + 1.5 * STEP_NOISE * wander, STEP_NOISE, 41)
    assert "step" not in [finding.effect for finding in traced(data).findings]


def test_a_knocked_tracker_is_found_with_three_targets_a_visit() -> None:
    places_of_targets = {"N1": TOOL, "N2": TOOL + np.array([0.2, 0.1, 0.0]), "N3": TOOL + np.array([-0.1, 0.2, 0.05])}
    visits, first = 60, 35
    poses = run(visits, seed=12)
    rng = np.random.default_rng(12)
    position = np.array([target(q, place) for q in poses.q.T for place in places_of_targets.values()]).T
    visit = np.repeat(np.arange(visits), 3)
    position += (visit >= first) * np.array([[2e-4], [0.0], [-1e-4]]) + rng.normal(
        scale=STEP_NOISE, size=position.shape
    )
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
    data = measured(run(60, 1), np.zeros((3, 60)), STEP_NOISE, 1)
    np.testing.assert_array_equal(step.after(data), np.arange(2, 62) >= 40)
    assert step.after(dataclasses.replace(data, source="folder/other.csv")).all()
    assert step.after(dataclasses.replace(data, rows=None)).all()
    timed = Step(("j2",), "joint", from_time=100.0)
    assert timed.after(data).all()
    late = dataclasses.replace(data, time=np.linspace(0, 199, 60))
    np.testing.assert_array_equal(timed.after(late), late.time >= 100.0)


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
