"""A soft arm, the direction of gravity, and masses that are uncertain."""

import dataclasses

import numpy as np
import pytest
from arms import arm
from independent_arm import DH, Matrix, link_frames, measured, run, targets
from searched import ARM, model

from robacc import InputError, Measurements, Robot
from robacc.effects import REGISTRY
from robacc.effects.elastic import JointCompliance
from robacc.effects.specification import parse_requests
from robacc.fitting.fit_result import Fit
from robacc.fitting.levels import GROSS
from robacc.fitting.masses import with_mass_uncertainty
from robacc.fitting.normal_equations import posterior, solved
from robacc.fitting.parameters import parameters
from robacc.fitting.registration import align, gravity_warning, with_gravity_direction
from robacc.fitting.solver import fit
from robacc.fitting.warnings import fit_warnings, lack_of_fit
from robacc.geometry import rotation_from_rpy
from robacc.measurements import too_far
from robacc.modelling.model import Model, predict
from robacc.robots.arm import Arm
from robacc.robots.yaml_robot import parse_robot, robot_to_yaml
from robacc.simulation.simulate import Plan, simulate
from robacc.tracing.calibrating import calibrate
from robacc.tracing.trace import trace

NOISE = 2e-5
SPRINGS = np.array([0.0, 6e-7, 8e-7, 0.0, 0.0, 0.0])
DOWN = np.array([0.0, 0.0, -9.81])


def torques(q: Matrix, gravity: Matrix) -> Matrix:
    """Torques (6, N) at joints (6, N): the slope of the work of gravity (3,), stated in the base."""

    def work(at: Matrix) -> Matrix:
        weights = zip(link_frames(at), DH, strict=True)
        return sum(m * ((frame @ np.append(com, 1.0))[:, :3] @ gravity) for frame, (*_, m, com) in weights)

    step = 1e-5
    return np.array([(work(q + e) - work(q - e)) / (2 * step) for e in step * np.eye(6)[..., None]])


def campaign(tilt: Matrix, gravity: Matrix, springs: Matrix = SPRINGS, n: int = 80, seed: int = 1) -> Measurements:
    """Poses of an arm under ``gravity`` in its base, in a measuring frame in which the base is turned by ``tilt``."""
    poses = run(n, seed)
    bent = poses.q + springs[:, None] * torques(poses.q, gravity)
    return measured(poses, rotation_from_rpy(tilt) @ targets(bent), NOISE, seed)


def found(data: Measurements) -> tuple[Matrix, str | None]:
    shown = with_gravity_direction(model(data), data).arm.robot.gravity
    return np.array(shown), next(iter(gravity_warning(ARM.robot.gravity, shown)), None)


@pytest.mark.parametrize(
    "tilt",
    [(np.radians(4.0), 0.0, 0.3), (0.0, np.radians(-20.0), 2.0), (np.pi / 2, 0.0, 0.0), (np.pi, 0.0, 1.0)],
    ids=["four degrees", "twenty", "another axis up", "upside down"],
)
def test_deflections_show_where_gravity_acts_in_a_frame_that_is_not_level(tilt: tuple[float, float, float]) -> None:
    """The base stands upright; the frame of the instrument does not."""
    shown, warning = found(campaign(np.array(tilt), DOWN))
    true = rotation_from_rpy(np.array(tilt)) @ DOWN
    assert np.degrees(np.arccos(shown @ true / 9.81**2)) < 0.1
    assert "the measuring frame is not level" in warning


@pytest.mark.parametrize(
    "tilt", [(0.0, 0.0, 1.2), (np.pi / 2, 0.0, 0.0), (0.0, np.radians(30.0), 0.0), (np.pi, 0.0, 0.0)]
)
def test_an_arm_that_leans_in_a_level_frame_keeps_the_gravity_of_its_file(tilt: tuple[float, float, float]) -> None:
    """On a wall, on a slope, under a ceiling; the file does not say how the base stands."""
    shown, warning = found(campaign(np.array(tilt), rotation_from_rpy(np.array(tilt)).T @ DOWN))
    assert warning is None
    assert shown.tolist() == DOWN.tolist()


@pytest.mark.parametrize("seed", range(5))
def test_a_rigid_arm_shows_no_direction(seed: int) -> None:
    tilt = np.array([np.radians(25.0), 0.0, 0.0])
    assert found(campaign(tilt, DOWN, np.zeros(6), 40, seed))[1] is None


def test_trace_names_the_springs_and_a_model_holds_in_other_frames() -> None:
    data = campaign(np.array([np.radians(15.0), np.radians(-7.0), 0.4]), DOWN)
    result = trace(model(data), data)
    assert {(finding.effect, finding.joints) for finding in result.findings} == {
        ("joint_compliance", ("j2",)),
        ("joint_compliance", ("j3",)),
    }
    assert any("not level" in warning for warning in result.warnings)
    other = campaign(np.array([0.0, np.radians(50.0), -1.0]), DOWN, n=30, seed=8)
    registered = align(result.robot, other, ["base_frame"])
    error = other.position - predict(registered.robot, other).translation
    assert np.sqrt(np.mean(np.sum(error**2, axis=0))) < 2.0 * NOISE * np.sqrt(3)
    assert any("not level" in note for note in registered.notes)


@pytest.mark.parametrize("known", [False, True])
def test_the_spring_of_a_soft_arm_is_found_in_equilibrium(known: bool) -> None:
    """The wrist of a Puma 560 sags by 2 mm: torques at the undeflected pose would be off by micrometres."""
    soft, noise = 1e-3, 8e-6
    entry = {"effect": "lateral_compliance", "joints": ["j4"], "values": {"j4": soft}}
    robot = dataclasses.replace(arm("puma560").robot, effects=(entry,))
    data = simulate(robot, Plan(120, seed=0, noise_position=noise)).data
    sigma = np.full((3, data.n), noise) if known else None
    data = dataclasses.replace(data, rotation=None, sigma_position=sigma, sigma_rotation=None)
    asked = parse_requests("base_frame,tool_frame,joint_offset,lateral_compliance[j4]")
    found = calibrate(arm("puma560").robot, data, asked, n_folds=2)
    one = next(one for one in found.parameters if one.name == "lateral_compliance.j4")
    assert one.value == pytest.approx(soft, abs=4 * one.std)
    assert found.after.held_out.position.rms < 1.15 * np.sqrt(3) * noise
    again = predict(parse_robot(robot_to_yaml(found.robot), "model.yaml"), data)
    np.testing.assert_allclose(again.translation, found.fit.poses.translation, rtol=0, atol=1e-12)


@pytest.mark.parametrize("names_springs", [False, True])
def test_what_springs_explain_is_no_mistake_of_units(names_springs: bool) -> None:
    entry = {"effect": "joint_compliance", "joints": ["j2", "j3"], "values": {"j2": 4e-4, "j3": 8e-4}}
    robot = arm("puma560").robot
    data = simulate(dataclasses.replace(robot, effects=(entry,)), Plan(60, seed=1, orientation=False)).data
    frames = [REGISTRY[name].default(Arm.of(robot), data) for name in ("base_frame", "tool_frame")]
    rigid, springs = (
        fit(Model(Arm.of(robot), (), (*frames, *more)), data) for more in ((), (JointCompliance(("j2", "j3")),))
    )
    found = springs if names_springs else rigid
    texts = list(fit_warnings(found, data, lack_of_fit(found, data), rigid, (1.0, 1.0)))
    assert any("than from the arm" in text for text in texts) is not names_springs


def test_what_is_left_in_sockets_near_each_other_is_no_mistake_of_units() -> None:
    """A Panda in two sockets 50 mm apart, calibrated to 0.26 mm, was told of wrong units and signs."""
    sockets = np.repeat([[0.0, 0.05], [0.0, 0.0], [0.0, 0.0]], 30, axis=1)
    assert not too_far(2.6e-4, sockets, GROSS)
    assert too_far(4e-3, sockets, GROSS)


JOINTS = ("j2", "j3")
COMPLIANCE = {"j2": 3e-6, "j3": 8e-6}


def with_masses(robot: Robot, factors: np.ndarray) -> Robot:
    joints = tuple(
        dataclasses.replace(joint, mass=None if joint.mass is None else joint.mass * factor)
        for joint, factor in zip(robot.joints, factors, strict=True)
    )
    return dataclasses.replace(robot, joints=joints)


def measured_of_mass_uncertainty(robot: Robot, rng: np.random.Generator, n: int = 40) -> Measurements:
    """Noisy poses of an arm with compliant joints and these masses."""
    entry = {"effect": "joint_compliance", "joints": list(JOINTS), "values": COMPLIANCE}
    q = rng.uniform(-1.5, 1.5, (len(robot.variables), n))
    data = Measurements(position=np.zeros((3, n)), q=q)
    exact = predict(dataclasses.replace(robot, effects=(entry,)), data).translation
    sigma = np.full((3, n), NOISE)
    return dataclasses.replace(data, position=exact + rng.normal(0, NOISE, (3, n)), sigma_position=sigma)


def fitted(robot: Robot, data: Measurements) -> Fit:
    return fit(Model(Arm.of(robot), (), (JointCompliance(JOINTS),)), data)


def test_sensitivity_to_a_mass_is_that_of_a_fit_with_another_mass() -> None:
    robot = dataclasses.replace(arm("puma560").robot, mass_uncertainty=1.0)
    data = measured_of_mass_uncertainty(robot, np.random.default_rng(0))
    first = fitted(robot, data)
    added = with_mass_uncertainty(first, data).covariance - first.covariance
    expected = np.zeros((2, 2))
    for i, joint in enumerate(robot.joints):
        if joint.mass:
            factors = np.ones(len(robot.joints))
            factors[i] = 1.01
            change = (fitted(with_masses(robot, factors), data).theta - first.theta) / 0.01
            expected += np.outer(change, change)
    np.testing.assert_allclose(added, expected, rtol=0.03, atol=0.03 * np.abs(expected).max())


def test_the_default_is_stated_and_the_file_can_state_another() -> None:
    robot = arm("puma560").robot
    data = measured_of_mass_uncertainty(robot, np.random.default_rng(1))
    default = fitted(robot, data)
    texts = list(fit_warnings(default, data, lack_of_fit(default, data), default, (1.0, 1.0)))
    assert any("an uncertainty of 10 % of each link's mass" in text for text in texts)
    stds = []
    for share in (None, 0.1, 0.0):
        stated = dataclasses.replace(robot, mass_uncertainty=share)
        stated = parse_robot(robot_to_yaml(stated), "stated.yaml")
        assert stated.mass_uncertainty == share
        stds.append(parameters(with_mass_uncertainty(fitted(stated, data), data))[0].std)
    assert stds[0] == stds[1]
    assert stds[1] > 1.2 * stds[2], "10 % of a mass is as large as the noise of 40 poses"
    with pytest.raises(InputError, match=r"mass_uncertainty.*share from 0 to 1"):
        parse_robot(robot_to_yaml(robot) + "mass_uncertainty: 20\n", "wrong.yaml")


def test_singular_systems_have_a_solution_without_the_missing_direction() -> None:
    matrix = np.array([[1.0, 1.0, 0.0], [1.0, 1.0, 0.0], [0.0, 0.0, 0.0]])
    with pytest.raises(np.linalg.LinAlgError):
        np.linalg.solve(matrix, np.ones(3))
    np.testing.assert_allclose(solved(matrix, np.array([1.0, 1.0, 0.0])), [0.5, 0.5, 0.0], atol=1e-9)
    assert np.isfinite(posterior(matrix, np.zeros(3))).all()
