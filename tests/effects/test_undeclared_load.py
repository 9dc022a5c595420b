"""A constant load at a link that the robot file does not state, on an arm with torques of its own."""

from __future__ import annotations

import dataclasses

import independent_arm
import numpy as np
import pytest
from independent_arm import DH, Matrix, load_torques, measured, robot, run, targets
from searched import ARM, error_at, fitted, found

from robacc.effects.elastic import JointCompliance
from robacc.effects.request import build, parse_requests
from robacc.fitting.masses import UndeclaredLoad, undeclared_load
from robacc.measurements import Measurements
from robacc.robots.arm import Arm

NOISE = 1e-5
COMPLIANCE = np.array([0.0, 6e-7, 8e-7, 0.0, 0.0, 0.0])


def loaded(n: int, seed: int, noise: float, link: int, mass: float, com: Matrix) -> Measurements:
    """Poses of an arm whose joints 2 and 3 give way to its own weight and to a mass at link ``link``, from 0."""
    poses = run(n, seed)
    torque = np.array([load_torques(q, mass, com, link) for q in poses.q.T]).T
    return measured(poses, targets(poses.q + COMPLIANCE[:, None] * torque), noise, seed)


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
    data, fresh = loaded(80, 1, NOISE, link, mass, place), loaded(60, 2, 0.0, link, mass, place)
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
    load = judged(loaded(80, 1, NOISE, 5, 15.0, np.array([0.1, 0.05, 0.2])))
    assert load.is_named
    assert [place.link for place in load.places] == ["j6"]
    assert load.places[0].low < 15.0 < load.places[0].high
    # The poses determine compliance times first moment: the mass is known to a factor of two or three.
    assert 7.0 < load.places[0].mass < 30.0
    assert "kg more on the link of j6 (95 %:" in load.statement


@pytest.mark.parametrize("error", [None, 0.02], ids=["10 percent", "2 percent"])
def test_a_load_within_the_errors_of_the_masses_is_named_only_if_these_are_known(error: float | None) -> None:
    arm = Arm.of(dataclasses.replace(robot(), mass_uncertainty=error))
    load = judged(loaded(80, 1, NOISE, 2, 20.0, np.array([0.05, 0.1, 0.1])), arm)
    # The link of j3 has 30 kg in the file.
    assert load.is_named == (error is not None)
    assert load.places[0].link == "j3"
    assert load.places[0].low < 20.0 < load.places[0].high


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(1, 40))])
def test_no_load_is_named_where_the_masses_of_the_file_are_wrong(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    factors = np.clip(1.0 + 0.2 * np.random.default_rng(seed).normal(size=6), 0.2, None)
    wrong = tuple((*row[:4], row[4] * factor, row[5]) for row, factor in zip(DH, factors, strict=True))
    monkeypatch.setattr(independent_arm, "DH", wrong)
    load = judged(loaded(80, seed, NOISE, 0, 0.0, np.zeros(3)))
    assert not load.is_named
    assert "is not distinguishable from errors" in load.statement


def test_without_uncertain_masses_nothing_is_judged() -> None:
    data = loaded(40, 1, NOISE, 5, 15.0, np.zeros(3))
    result = fitted(data, (JointCompliance(("j2", "j3")),), declared="base_frame,tool_frame")
    assert undeclared_load(result, data) is None
