"""Errors against an independent computation by scipy's rotations, and the call's own rules."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from arms import arm
from scipy.spatial.transform import Rotation

import robacc
from robacc.accuracy.estimation import estimate
from robacc.accuracy.pose_errors import Commanded, commanded_poses, pose_errors
from robacc.errors import InputError, UsageError
from robacc.measurements import Measurements
from robacc.modelling.model import predict
from robacc.robots.description import DH_PARAMETERS, Frame, Joint, Robot
from robacc.simulation.simulate import Plan, simulate

SAMPLES = Path(__file__).resolve().parents[2] / "sample_data"

N = 40


def dh_robot(**changes: object) -> Robot:
    rows = ((0.4, 0.1, -np.pi / 2), (0.0, 0.5, 0.3), (0.1, 0.2, 0.7))
    joints = tuple(
        Joint(f"j{i}", "revolute", dict.fromkeys(DH_PARAMETERS, 0.0) | {"d": d, "a": a, "alpha": alpha})
        for i, (d, a, alpha) in enumerate(rows)
    )
    robot = Robot("three", "standard", joints, tool=Frame((0.01, 0.02, 0.1), (0.1, 0.2, 0.3)))
    return dataclasses.replace(robot, **changes)


def dh_matrices(robot: Robot, q: np.ndarray) -> np.ndarray:
    """``(N, 4, 4)`` by the textbook's matrices, base at the origin."""
    tool = np.eye(4)
    tool[:3, :3] = Rotation.from_euler("xyz", robot.tool.rpy).as_matrix()
    tool[:3, 3] = robot.tool.xyz
    result = []
    for angles in q.T:
        pose = np.eye(4)
        for joint, theta in zip(robot.joints, angles, strict=True):
            d, a, alpha = (joint.parameters[name] for name in ("d", "a", "alpha"))
            ct, st, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
            pose = pose @ [
                [ct, -st * ca, st * sa, a * ct],
                [st, ct * ca, -ct * sa, a * st],
                [0, sa, ca, d],
                [0, 0, 0, 1],
            ]
        result.append(pose @ tool)
    return np.array(result)


@pytest.fixture(name="known")
def _known(request: pytest.FixtureRequest) -> tuple[Measurements, np.ndarray, np.ndarray]:
    """Measurements with commanded poses, and errors in the tool frame that were put into them."""
    rng = np.random.default_rng(3)
    size = getattr(request, "param", 1e-3)
    commanded = Rotation.random(N, rng=rng)
    translation = rng.normal(size=(N, 3))
    d, delta = rng.normal(scale=size, size=(2, N, 3))
    attained = commanded * Rotation.from_rotvec(delta)
    data = Measurements(
        position=(translation + commanded.apply(d)).T,
        rotation=np.moveaxis(attained.as_matrix(), 0, -1),
        commanded_position=translation.T,
        commanded_rotation=np.moveaxis(commanded.as_matrix(), 0, -1),
    )
    return data, d.T, delta.T


@pytest.mark.parametrize("known", [1e-9, 1e-3, 0.5], indirect=True)
def test_tool_frame_returns_the_errors_put_in(known: tuple[Measurements, np.ndarray, np.ndarray]) -> None:
    data, d, delta = known
    errors = pose_errors(data, commanded_poses(data, None), "tool")
    # Positions of order 1 carry rounding of some 1e-16 each.
    np.testing.assert_allclose(errors.position, d, atol=2e-15, rtol=0)
    np.testing.assert_allclose(errors.rotation, delta, atol=3e-15, rtol=0)


def test_base_frame_against_scipy(known: tuple[Measurements, np.ndarray, np.ndarray]) -> None:
    data, _, _ = known
    errors = pose_errors(data, commanded_poses(data, None), "base")
    attained = Rotation.from_matrix(np.moveaxis(data.rotation, -1, 0))
    commanded = Rotation.from_matrix(np.moveaxis(data.commanded_rotation, -1, 0))
    np.testing.assert_allclose(errors.position, data.position - data.commanded_position, atol=0)
    np.testing.assert_allclose(errors.rotation, (attained * commanded.inv()).as_rotvec().T, atol=2e-15, rtol=0)


def test_large_orientation_error_is_the_exact_logarithm() -> None:
    vector = np.array([[0.0, 3.0, 0.0]]).T
    turned = np.moveaxis(Rotation.from_rotvec(vector.T).as_matrix(), 0, -1)
    data = Measurements(position=np.zeros((3, 1)), rotation=turned)
    eye = np.eye(3)[..., None]
    errors = pose_errors(data, Commanded.at(np.zeros((3, 1)), eye, "file"), "tool")
    np.testing.assert_allclose(errors.rotation, vector, atol=1e-14)


def test_blocks_do_not_change_the_errors(
    monkeypatch: pytest.MonkeyPatch, known: tuple[Measurements, np.ndarray, np.ndarray]
) -> None:
    data = known[0]
    whole = pose_errors(data, commanded_poses(data, None), "tool")
    monkeypatch.setattr("robacc.accuracy.pose_errors._BLOCK", 7)
    parts = pose_errors(data, commanded_poses(data, None), "tool")
    np.testing.assert_array_equal(whole.position, parts.position)
    np.testing.assert_array_equal(whole.rotation, parts.rotation)


def test_the_robot_commands_the_pose_and_wins_over_the_file() -> None:
    rng = np.random.default_rng(5)
    robot = dh_robot()
    q = rng.uniform(-2, 2, size=(3, N))
    matrices = dh_matrices(robot, q)
    d = rng.normal(scale=1e-3, size=(3, N))
    position = matrices[:, :3, 3].T + np.einsum("nij,jn->in", matrices[:, :3, :3], d)
    data = Measurements(position=position, q=q, commanded_position=position)
    result = estimate(data, robot)
    assert result.commanded == "robot"
    assert result.orientation is None
    assert any("cmd_ columns of the file were not used" in note for note in result.notes)
    assert any("no orientation was measured" in note for note in result.notes)
    np.testing.assert_allclose(result.errors.position, d, atol=3e-15)
    np.testing.assert_allclose(estimate(data).errors.position, 0, atol=0)


def test_an_arm_without_effects_is_its_chain_bit_for_bit() -> None:
    q = np.random.default_rng(6).uniform(-2, 2, size=(3, N))
    data = Measurements(position=np.zeros((3, N)), q=q)
    position, rotation = commanded_poses(data, dh_robot()).block(slice(None))
    predicted = predict(dh_robot(), data)
    np.testing.assert_array_equal(position, predicted.translation)
    np.testing.assert_array_equal(rotation, predicted.rotation)


def test_statistics_know_repeated_poses() -> None:
    position = np.random.default_rng(7).normal(scale=1e-4, size=(3, 20))
    data = Measurements(
        position=position, commanded_position=np.zeros((3, 20)), pose=np.repeat([f"p{i}" for i in range(10)], 2)
    )
    assert (estimate(data).position.n, estimate(data).position.n_poses) == (20, 10)
    alone = dataclasses.replace(data, pose=np.array([f"p{i}" for i in range(20)]))
    assert estimate(alone).position.n_poses == 20


def test_worst_poses_and_ties() -> None:
    size = np.array([1.0, 3.0, 2.0, 3.0, 0.5, 3.0, 4.0, 3.0, 3.0])
    data = Measurements(position=np.vstack((size, 0 * size, 0 * size)), commanded_position=np.zeros((3, size.size)))
    worst = estimate(data).worst_position
    assert [pose.line for pose in worst] == [7, 2, 4, 6, 8]
    assert [pose.position for pose in worst] == [4.0, 3.0, 3.0, 3.0, 3.0]
    assert {(pose.pose, pose.target, pose.orientation) for pose in worst} == {(None, None, None)}


def test_each_target_has_its_own_metrics() -> None:
    position = np.array([[1e-3, -1e-3, 3e-3, 4e-3], [0, 0, 0, 0], [0, 0, 0, 0]])
    data = Measurements(position=position, commanded_position=np.zeros((3, 4)), target=np.array(["a", "a", "b", "b"]))
    a, b = estimate(data).targets
    assert (a.name, a.n_poses, b.name, b.n_poses) == ("a", 2, "b", 2)
    assert a.position.rms == pytest.approx(1e-3)
    assert b.position.rms == pytest.approx(np.sqrt(12.5) * 1e-3)
    # 3 and 4 mm: 95 % of the way from one to the other.
    assert (b.position.mean, b.position.p95, b.position.max) == pytest.approx((3.5e-3, 3.95e-3, 4e-3))


def test_alignment_removes_the_frames_and_keeps_the_noise() -> None:
    rng = np.random.default_rng(8)
    robot = dh_robot()
    q = rng.uniform(-2, 2, size=(3, N))
    matrices = dh_matrices(robot, q)
    base = Rotation.from_rotvec([0.3, -1.0, 2.0])
    noise = rng.normal(scale=1e-5, size=(3, N))
    data = Measurements(
        position=base.as_matrix() @ matrices[:, :3, 3].T + np.array([[1.0], [2.0], [-0.5]]) + noise,
        rotation=np.moveaxis((base * Rotation.from_matrix(matrices[:, :3, :3])).as_matrix(), 0, -1),
        q=q,
    )
    unaligned = estimate(data, robot, align=())
    aligned = estimate(data, robot, align=("base_frame",))
    assert any("frames that are not registered" in warning for warning in unaligned.warnings)
    assert aligned.alignment.n_parameters == 6
    assert aligned.warnings == ()
    assert aligned.unaligned.position.rms == pytest.approx(unaligned.position.rms, rel=1e-12)
    assert aligned.unaligned.orientation.max == pytest.approx(unaligned.orientation.max, rel=1e-12)
    # Six parameters of 3 N = 120 coordinates (orientations are exact): noise loses a few percent.
    assert np.sqrt(np.mean(aligned.errors.position**2)) == pytest.approx(1e-5, rel=0.15)


def test_frame_follows_the_commanded_orientation() -> None:
    zero = np.zeros((3, 2))
    eye = np.repeat(np.eye(3)[..., None], 2, axis=2)
    bare = estimate(Measurements(position=zero + 1e-3, rotation=eye, commanded_position=zero))
    assert bare.errors.frame == "base"
    assert bare.orientation is None
    assert any("no orientation was commanded, so the errors are in the measuring frame" in note for note in bare.notes)
    assert any("no orientation was commanded" in note for note in bare.notes)
    full = Measurements(position=zero + 1e-3, rotation=eye, commanded_position=zero, commanded_rotation=eye)
    assert estimate(full).errors.frame == "tool"
    assert estimate(full, frame="base").errors.frame == "base"


def test_measuring_uncertainty_is_mentioned() -> None:
    data = Measurements(
        position=np.zeros((3, 2)),
        commanded_position=np.zeros((3, 2)),
        sigma_position=np.full((3, 2), 2e-5 / np.sqrt(3)),
    )
    assert any("0.02 mm rms" in note for note in estimate(data).notes)


def test_effects_of_the_robot_file_are_named() -> None:
    robot = dh_robot(effects=({"effect": "joint_offset", "joints": ["j1"], "values": {"j1": 0.01}},))
    data = Measurements(position=np.ones((3, 2)), q=np.zeros((3, 2)))
    assert any("effects of the robot file are applied: joint_offset" in note for note in estimate(data, robot).notes)


def test_usage_errors() -> None:
    data = Measurements(position=np.zeros((3, 2)), commanded_position=np.zeros((3, 2)))
    with pytest.raises(UsageError, match="frame tool needs the commanded orientation"):
        estimate(data, frame="tool")
    with pytest.raises(UsageError, match="the poses have no commanded positions: give `commanded`, a robot program"):
        estimate(Measurements(position=np.zeros((3, 2))))
    with pytest.raises(UsageError, match="the poses have no commanded positions: give `robot`"):
        estimate(Measurements(position=np.zeros((3, 2)), q=np.zeros((3, 2))))
    with pytest.raises(UsageError, match="cannot align backlash; choose among base_frame, tool_frame"):
        estimate(dataclasses.replace(data, q=np.zeros((3, 2))), dh_robot(), align=("backlash",))
    with pytest.raises(UsageError, match=r"add the columns cmd_qw.*or use `align` with base_frame alone"):
        estimate(data, align=("base_frame", "tool_frame"))
    with pytest.raises(UsageError, match="cannot align backlash"):
        estimate(data, align=("backlash",))
    for wrong in (0.3, 1.0, float("nan")):
        with pytest.raises(UsageError, match=r"at least 0\.5 and less than 1"):
            estimate(data, confidence=wrong)
    with pytest.raises(InputError, match=r"no columns of commanded joints .* omit `robot`"):
        estimate(data, dh_robot())


def test_a_correction_used_outside_its_validity_range_gives_a_warning() -> None:
    puma = arm("puma560")
    correction = {"effect": "joint_correction", "joints": ["j3"], "drivers": ["j2"], "degree": 2}
    correction |= {"range": [[-1.0, 1.0]], "values": {"j3.j2.T2": 1e-4}}
    robot = dataclasses.replace(puma.robot, effects=(correction,))
    q = np.zeros((6, 5))
    q[1] = [-1.5, -1.01, 0.0, 1.0, 1.2]
    data = Measurements(position=np.zeros((3, 5)), q=q)
    data = dataclasses.replace(data, position=predict(robot, data).translation)
    (warning,) = [text for text in robacc.estimate(data, robot=robot).warnings if "validity range" in text]
    assert warning.startswith("2 of 5 poses are outside the validity range of the model")
    assert warning.endswith("joint_correction[j3] held at the end by j2, 2 poses up to 0.5 rad beyond [-1, 1]")
    inside = robacc.estimate(data.subset(np.arange(2, 4)), robot=robot).warnings
    assert not any("validity range" in text for text in inside)
    assert not any("validity range" in text for text in robacc.estimate(data, robot=puma.robot).warnings)


def test_a_quaternion_in_another_order_is_not_blamed_on_the_joints(tmp_path: Path) -> None:
    text = (SAMPLES / "poses.csv").read_text(encoding="utf-8").replace("qw,qx,qy,qz", "qx,qy,qz,qw", 1)
    path = tmp_path / "poses.csv"
    path.write_text(text, encoding="utf-8")
    result = robacc.estimate(path, robot=SAMPLES / "robot.yaml", align="base_frame,tool_frame")
    assert any("the positions agree, but the orientation errors" in warning for warning in result.warnings)


def test_frames_that_do_not_agree_are_registered_unless_the_call_says_no() -> None:
    robot = arm("puma560").robot
    data = simulate(dataclasses.replace(robot, effects=()), Plan(40, seed=3, noise_position=5e-5)).data
    moved = dataclasses.replace(data, position=data.position + np.array([[4.0], [-2.0], [0.5]]))
    found, raw = estimate(moved, robot), estimate(moved, robot, align=())
    assert found.alignment.effects == ("base_frame", "tool_frame")
    assert found.position.rms < 3 * 5e-5
    assert any("so they were registered" in warning for warning in found.warnings)
    assert raw.position.rms == pytest.approx(np.linalg.norm([4.0, -2.0, 0.5]), rel=1e-3)
    # Errors that an arm may have are left as they are, and so are those that frames do not explain.
    assert estimate(data, robot).alignment is None
    rng = np.random.default_rng(1)
    exchanged = dataclasses.replace(data, position=data.position[:, rng.permutation(data.n)])
    assert estimate(exchanged, robot).alignment is None
