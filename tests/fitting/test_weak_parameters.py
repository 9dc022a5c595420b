"""Constants that the poses hardly show are held near the robot file's values; all others are as free as they were."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from arms import arm

import robacc.fitting.solver
from robacc.effects.request import build, parse_requests
from robacc.fitting.apply_fit import apply_fit
from robacc.fitting.solver import Fit, fit
from robacc.fitting.warnings import weak_parameters_warning
from robacc.measurements import Measurements
from robacc.modelling.model import Model, predict
from robacc.robots.description import Robot

GEOMETRY = "base_frame,tool_frame,joint_offset,link_geometry"
NOISE = 2e-4


def made(name: str, seed: int) -> Robot:
    """The arm as it was made: every constant off by half a millimetre or milliradian."""
    rng = np.random.default_rng(seed)
    robot = arm(name).robot
    joints = tuple(
        dataclasses.replace(
            joint, parameters={label: value + rng.normal(scale=5e-4) for label, value in joint.parameters.items()}
        )
        for joint in robot.joints
    )
    return dataclasses.replace(robot, joints=joints, effects=())


def measured(robot: Robot, q: np.ndarray, seed: int, oriented: bool) -> Measurements:
    rng = np.random.default_rng(seed)
    data = Measurements(position=np.zeros((3, q.shape[1])), q=q)
    poses = predict(robot, data)
    position = poses.translation + rng.normal(scale=NOISE, size=poses.translation.shape)
    return dataclasses.replace(data, position=position, rotation=poses.rotation if oriented else None)


def geometry(name: str, data: Measurements, robot: Robot | None = None) -> Fit:
    robot = robot or arm(name).robot
    one = dataclasses.replace(robot, effects=())
    return fit(Model.of(one, build(parse_requests(GEOMETRY), Model.of(one).arm, data)), data)


def joints(name: str, n: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    limits = np.array([joint.limits for joint in arm(name).robot.variables])
    return rng.uniform(0.6 * limits[:, :1], 0.6 * limits[:, 1:], size=(len(limits), n))


def one_orientation(n: int, seed: int) -> np.ndarray:
    """A UR10 whose target keeps nearly one orientation to the last joints: they turn by a few degrees only."""
    q = joints("ur10", n, seed)
    q[3:] = np.array([[-1.0], [1.57], [0.3]]) + 0.05 * np.random.default_rng(seed).normal(size=(3, n))
    return q


def test_few_orientations_do_not_make_links_of_centimetres(monkeypatch: pytest.MonkeyPatch) -> None:
    true = made("ur10", 1)
    data = measured(true, one_orientation(25, 2), 3, oriented=False)
    others = Measurements(position=np.zeros((3, 300)), q=joints("ur10", 300, 4))
    wanted = predict(true, others).translation

    def miss(found: Fit) -> float:
        return float(
            np.sqrt(np.mean(np.sum(np.square(predict(apply_fit(found), others).translation - wanted), axis=0)))
        )

    found = geometry("ur10", data)
    assert found.held
    assert set(found.held.values()) == {3e-3}
    assert all(name.startswith(("joint_offset.", "link_geometry.")) for name in found.held)
    (warning,) = weak_parameters_warning(found)
    assert warning.startswith("these poses hardly show ")
    monkeypatch.setattr(robacc.fitting.solver, "WEAK", np.inf)
    free = geometry("ur10", data)
    assert free.held == {}
    assert weak_parameters_warning(free) == ()
    # Held, the other orientations are no worse than the arm was made; free, noise throws them off by more.
    assert miss(found) < 4e-3
    assert miss(free) > 3 * miss(found)


def test_a_target_on_the_last_axis_lets_nothing_drift() -> None:
    """Of a Panda that carries its target on the flange's axis, joints 6 and 7 could be almost anything."""
    robot = dataclasses.replace(
        made("panda", 5), tool=dataclasses.replace(arm("panda").robot.tool, xyz=(0.0, 0.0, 0.1))
    )
    found = geometry("panda", measured(robot, joints("panda", 150, 6), 7, oriented=False))
    constants = [i for i, name in enumerate(found.names) if not name.startswith(("base_frame", "tool_frame"))]
    assert np.abs(found.theta[constants]).max() < 1e-2


def test_a_wrong_file_is_no_reason_to_hold_anything() -> None:
    """A link that is 100 mm longer than the table says is found though all else is as it was."""
    true = arm("ur10").robot
    long = tuple(
        dataclasses.replace(joint, parameters={**joint.parameters, "a": joint.parameters["a"] + 0.1})
        if i == 1
        else joint
        for i, joint in enumerate(true.joints)
    )
    data = measured(true, joints("ur10", 60, 8), 9, oriented=True)
    found = geometry("ur10", data, dataclasses.replace(true, joints=long))
    value = dict(zip(found.names, found.theta, strict=True))
    name = next(
        name for name in value if name.startswith("link_geometry.") and name.endswith(f"{true.joints[1].name}.a")
    )
    assert value[name] == pytest.approx(-0.1, abs=1e-3)
    assert name not in found.held
