"""Weakly identifiable constants get a prior about nominal; all other constants get none."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from arms import arm

import robacc.fitting.solver
from robacc.effects.request import build, parse_requests
from robacc.fitting.fit_result import Fit, Options
from robacc.fitting.parameters import apply_fit
from robacc.fitting.solver import fit
from robacc.fitting.warnings import weak_parameters_warning
from robacc.measurements import Measurements
from robacc.modelling.model import Model, predict
from robacc.robots.description import Robot

GEOMETRY = "base_frame,tool_frame,joint_offset,link_geometry"
NOISE = 2e-4


def made(name: str, seed: int) -> Robot:
    """Return the arm as built: every constant differs by some half millimetre or milliradian."""
    rng = np.random.default_rng(seed)
    robot = arm(name).robot
    joints = tuple(
        dataclasses.replace(
            joint, parameters={label: value + rng.normal(scale=5e-4) for label, value in joint.parameters.items()}
        )
        for joint in robot.joints
    )
    return dataclasses.replace(robot, joints=joints, effects=())


def measured(robot: Robot, q: np.ndarray, seed: int, oriented: bool, noise: float = NOISE) -> Measurements:
    rng = np.random.default_rng(seed)
    data = Measurements(position=np.zeros((3, q.shape[1])), q=q)
    poses = predict(robot, data)
    position = poses.translation + rng.normal(scale=noise, size=poses.translation.shape)
    return dataclasses.replace(data, position=position, rotation=poses.rotation if oriented else None)


def geometry(name: str, data: Measurements, robot: Robot | None = None, options: Options | None = None) -> Fit:
    nominal = dataclasses.replace(robot or arm(name).robot, effects=())
    model = Model.of(nominal, build(parse_requests(GEOMETRY), Model.of(nominal).arm, data))
    return fit(model, data, options or Options())


def joints(name: str, n: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    limits = np.array([joint.limits for joint in arm(name).robot.variables])
    return rng.uniform(0.6 * limits[:, :1], 0.6 * limits[:, 1:], size=(len(limits), n))


def one_orientation(n: int, seed: int) -> np.ndarray:
    """Return poses of a UR10 with nearly one orientation of the target: the last joints turn by a few degrees."""
    q = joints("ur10", n, seed)
    q[3:] = np.array([[-1.0], [1.57], [0.3]]) + 0.05 * np.random.default_rng(seed).normal(size=(3, n))
    return q


@pytest.mark.slow
def test_few_orientations_do_not_change_links_by_centimetres(monkeypatch: pytest.MonkeyPatch) -> None:
    true = made("ur10", 1)
    data = measured(true, one_orientation(25, 2), 3, oriented=False)
    others = Measurements(position=np.zeros((3, 300)), q=joints("ur10", 300, 4))
    wanted = predict(true, others).translation

    def miss(found: Fit) -> float:
        return float(
            np.sqrt(np.mean(np.sum(np.square(predict(apply_fit(found), others).translation - wanted), axis=0)))
        )

    found = geometry("ur10", data)
    assert found.prior_stds
    # The arm was made with 0.5 mm and 0.5 mrad; 25 poses of one orientation leave it near its own prior, 3 mm.
    assert set(found.prior_stds) == {"joint_offset (rad)", "link_geometry (m)", "link_geometry (rad)"}
    assert all(3e-4 < std < 3e-3 for std in found.prior_stds.values())
    assert all(name.startswith(("joint_offset.", "link_geometry.")) for name in found.weak)
    (warning,) = weak_parameters_warning(found)
    assert warning.startswith("weakly identifiable on these poses: ")
    monkeypatch.setattr(robacc.fitting.solver, "WEAK", np.inf)
    free = geometry("ur10", data)
    assert free.prior_stds == {}
    assert weak_parameters_warning(free) == ()
    # With priors, errors at other orientations are those of the arm as built; without, noise makes them larger.
    assert miss(found) < 4e-3
    assert miss(free) > 3 * miss(found)


@pytest.mark.parametrize(("largest_std", "expected"), [(0.8e-3, False), (1.0e-3, True), (3e-3, True)])
def test_a_standard_error_above_a_millimetre_brings_a_prior(largest_std: float, expected: bool) -> None:
    # Standard errors are proportional to the stated noise, which is chosen for a largest one of so many m or rad.
    robot = dataclasses.replace(arm("ur10").robot, effects=())
    data = measured(robot, joints("ur10", 60, 2), 3, oriented=False, noise=0.0)
    reference = geometry("ur10", data, options=Options(misfit=(1e-7, 1e-7), robust=False))
    assert not reference.prior_stds
    constants = [i for i in reference.identifiability.columns if "_frame." not in reference.names[i]]
    std = np.sqrt(np.diag(reference.covariance))[constants]
    noise = 1e-7 * largest_std / std.max()
    fitted = geometry("ur10", data, options=Options(misfit=(noise, noise), robust=False))
    assert (reference.names[constants[std.argmax()]] in fitted.weak) is expected
    assert bool(fitted.prior_stds) is expected


def test_a_target_on_the_last_axis_lets_nothing_drift() -> None:
    """A Panda whose target is on the flange's axis: constants of joints 6 and 7 are weakly identifiable."""
    robot = dataclasses.replace(
        made("panda", 5), tool=dataclasses.replace(arm("panda").robot.tool, xyz=(0.0, 0.0, 0.1))
    )
    found = geometry("panda", measured(robot, joints("panda", 150, 6), 7, oriented=False))
    constants = [i for i, name in enumerate(found.names) if not name.startswith(("base_frame", "tool_frame"))]
    assert np.abs(found.theta[constants]).max() < 1e-2


def test_a_wrong_file_does_not_bring_a_prior() -> None:
    """A link that is 100 mm off its nominal length is found, if all others are nominal."""
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
    assert not found.prior_stds
