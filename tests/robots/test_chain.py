"""Kinematics of chains, couplings of joints, and the geometry beneath."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from homogeneous import dh, frame
from hypothesis import given, settings, strategies as st
from sample_files import saved
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from robacc import InputError, Robot, read_robot
from robacc.diagnostics.robot_poses import read_robot_poses
from robacc.geometry import (
    Array,
    Poses,
    compose,
    exp_so3,
    left_jacobian_inverse,
    log_between,
    log_so3,
    quaternion_from_rotation,
    rotation_from_quaternion,
    rotation_from_rpy,
    rpy_from_rotation,
    skew,
)
from robacc.robots.arm import BLOCK, Arm, Chain, build_chain, find_reach, inverse_kinematics, pose_jacobian
from robacc.robots.description import Frame, Joint, Mimic
from robacc.robots.urdf import parse_urdf
from robacc.robots.yaml_robot import parse_robot, robot_to_yaml
from robacc_plugins.urdf import robot_to_urdf

CONFIGS = sorted((Path(__file__).resolve().parents[2] / "configs" / "robots").glob("*.yaml"))
"""The arms that come with the project."""
PI = np.pi


def standard_matrix(theta: float, d: float, a: float, alpha: float) -> Array:
    """Paul (1981), eq. (2.33); Wu and Lee, eq. (1), multiplied out."""
    ct, st, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
    return np.array(
        [
            [ct, -st * ca, st * sa, a * ct],
            [st, ct * ca, -ct * sa, a * st],
            [0, sa, ca, d],
            [0, 0, 0, 1],
        ]
    )


def modified_matrix(theta: float, d: float, a: float, alpha: float) -> Array:
    """Craig, Introduction to Robotics, eq. (3.6), multiplied out."""
    ct, st, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
    return np.array(
        [
            [ct, -st, 0, a],
            [st * ca, ct * ca, -sa, -sa * d],
            [st * sa, ct * sa, ca, ca * d],
            [0, 0, 0, 1],
        ]
    )


def random_robot(rng: np.random.Generator, convention: str, count: int = 7) -> Robot:
    joints = tuple(
        Joint(
            f"j{i}",
            "prismatic" if i % 3 == 2 else "revolute",
            dict(zip(("theta", "d", "a", "alpha", "beta"), (*rng.uniform(-2, 2, 4), 0.0), strict=True)),
            sign=-1 if i % 2 else 1,
        )
        for i in range(count)
    )
    tool = Frame(tuple(rng.normal(size=3)), tuple(rng.normal(size=3)))
    return Robot("random", convention, joints, tool=tool)  # type: ignore[arg-type]


@pytest.mark.parametrize(("convention", "matrix"), [("standard", standard_matrix), ("modified", modified_matrix)])
def test_dh_table_is_the_textbook_product(convention, matrix) -> None:
    rng = np.random.default_rng(1)
    for _ in range(5):
        robot = replace(random_robot(rng, convention), base=Frame((0.3, -1.0, 0.2), (0.1, -0.7, 2.0)))
        q = rng.uniform(-3, 3, (7, 4))
        got = build_chain(robot).forward(q).matrices()
        for k in range(4):
            expected = frame(robot.base.xyz, robot.base.rpy)
            for joint, value in zip(robot.joints, q[:, k], strict=True):
                theta, d, a, alpha = (joint.parameters[name] for name in ("theta", "d", "a", "alpha"))
                if joint.type == "revolute":
                    theta += joint.sign * value
                else:
                    d += joint.sign * value
                expected = expected @ matrix(theta, d, a, alpha)
            # Seven products of numbers of order ten.
            np.testing.assert_allclose(got[k], expected @ frame(robot.tool.xyz, robot.tool.rpy), atol=1e-13)


def pose_of(name: str, *q: float) -> Array:
    path = next(path for path in CONFIGS if path.stem == name)
    return build_chain(read_robot(path)).forward(np.array(q, dtype=float)[:, None]).matrices()[0]


def pose(columns: str, *position: float) -> Array:
    """A pose whose axes are coordinate axes: ``"x -z y"`` are its columns."""
    matrix = np.eye(4)
    for k, axis in enumerate(columns.split()):
        matrix[:3, k] = np.eye(3)["xyz".index(axis[-1])] * (-1 if axis[0] == "-" else 1)
    matrix[:3, 3] = position
    return matrix


# Corke, Robotics, Vision and Control (2011), section 7.2: the arm's named configurations. The book prints four digits.
@pytest.mark.parametrize(
    ("q", "expected"),
    [
        ((0, 0, 0, 0, 0, 0), pose("x y z", 0.4521, -0.1500, 0.4318)),
        ((0, PI / 2, -PI / 2, 0, 0, 0), pose("x y z", 0.0203, -0.1500, 0.8636)),
        ((0, 0, -PI / 2, 0, 0, 0), pose("-z y x", 0.8636, -0.1500, -0.0203)),
        ((0, PI / 4, PI, 0, PI / 4, 0), pose("-z y x", 0.5963, -0.1501, -0.01435)),
    ],
    ids=["qz", "qr", "qs", "qn"],
)
def test_puma560_reaches_its_published_poses(q, expected) -> None:
    np.testing.assert_allclose(pose_of("puma560", *q), expected, atol=7e-5)


# The maker's zero position, worked out by hand: arm along -x, and the wrist's offsets across it.
def test_ur10_stands_where_its_maker_says() -> None:
    zero = pose("x z -y", -0.612 - 0.5723, -0.163941 - 0.0922, 0.1273 - 0.1157)
    np.testing.assert_allclose(pose_of("ur10", *[0] * 6), zero, atol=1e-15)
    # Upright: upper arm, forearm and wrist stand on top of each other.
    upright = pose_of("ur10", 0, -PI / 2, 0, -PI / 2, 0, 0)
    np.testing.assert_allclose(upright[:3, 3], [0, -0.163941 - 0.0922, 0.1273 + 0.612 + 0.5723 + 0.1157], atol=1e-15)


def test_the_other_arms_stand_where_their_drawings_say() -> None:
    # ABB: at zero the lower arm is upright, the upper arm horizontal, the flange looks forward.
    np.testing.assert_allclose(pose_of("irb1600", *[0] * 6), pose("-z y x", 0.815, 0, 1.1865), atol=1e-15)
    # Franka's "ready": the forearm horizontal, the flange looking down in front of the base. Links at 45 degrees count
    # with 1/sqrt(2): 0.316 - 0.0825 of the upper arm across, 0.316 + 0.0825 up.
    x = (-0.316 + 0.0825) / np.sqrt(2) + 0.384 + 0.088
    z = 0.333 + (0.316 + 0.0825) / np.sqrt(2) + 0.0825 - 0.107
    ready = pose_of("panda", 0, -PI / 4, 0, -3 * PI / 4, 0, PI / 2, PI / 4)
    half = 1 / np.sqrt(2)
    expected = [[half, -half, 0, x], [-half, -half, 0, 0], [0, 0, -1, z], [0, 0, 0, 1]]
    np.testing.assert_allclose(ready, expected, atol=1e-15)
    # As Franka's own controller prints it.
    np.testing.assert_allclose(ready[:3, 3], [0.30689, 0, 0.590282], atol=1e-6)
    # SCARA: stretched along x, the slide driven down by q3.
    np.testing.assert_allclose(pose_of("scara", 0, 0, 0.05, 0), pose("x -y -z", 0.8, 0, 0.877 - 0.2 - 0.05), atol=1e-15)
    # Stanford arm: shoulder offset to the side, the slide up, the hand on its end.
    stanford = pose_of("stanford", 0, 0, 0.5, 0, 0, 0)
    np.testing.assert_allclose(stanford[:3, 3], [0, 0.154, 0.412 + 0.5 + 0.263], atol=1e-15)


def finite_robots() -> list[Robot]:
    rng = np.random.default_rng(8)
    kinds = ("revolute", "prismatic", "fixed", "revolute")
    urdf_joints = tuple(
        Joint(
            f"u{i}",
            kind,  # type: ignore[arg-type]
            dict(zip(("x", "y", "z", "roll", "pitch", "yaw", "offset"), rng.normal(size=7), strict=True)),
            axis=tuple(axis / np.linalg.norm(axis)),
            mimic=Mimic("u0", -0.7, 0.3) if i == 3 else None,
        )
        for i, (kind, axis) in enumerate(zip(kinds, rng.normal(size=(4, 3)), strict=True))
    )
    return [Robot("urdf", "urdf", urdf_joints), random_robot(rng, "standard"), random_robot(rng, "modified")]


def complex_step(chain: Chain, q: Array) -> Array:
    """``(6, K, N)`` from the imaginary part of poses whose one scalar has an imaginary step: no cancellation.

    The step is a motion of its own behind the scalar's, E(s + i h) = E(s) E(i h): at s = pi the tangent of the half
    angle, which the chain takes, has a pole and no complex derivative.
    """
    step = 1e-30
    n = q.shape[1]
    result = np.empty((6, len(chain.motions), n))
    scalars = chain.scalars(q)
    for k, motion in enumerate(chain.motions):
        stepped = Chain((*chain.motions[: k + 1], motion._replace(label=""), *chain.motions[k + 1 :]), (), 0)
        poses = stepped.poses([*scalars[: k + 1], np.full(n, 1j * step), *scalars[k + 1 :]], n)
        result[:3, k] = poses.translation.imag / step
        # dR R^T is skew and holds dphi.
        spin = np.einsum("ijn,kjn->ikn", poses.rotation.imag / step, poses.rotation.real)
        result[3:, k] = spin[2, 1], spin[0, 2], spin[1, 0]
    return result


ROBOTS = [pytest.param(read_robot(path), id=path.stem) for path in CONFIGS]


ROBOTS += [pytest.param(robot, id=f"random-{robot.convention}") for robot in finite_robots()]


@pytest.mark.parametrize("robot", ROBOTS)
def test_jacobian_to_every_scalar_is_the_complex_step(robot: Robot) -> None:
    chain = build_chain(robot)
    q = np.random.default_rng(5).uniform(-2, 2, (chain.n_joints, 3))
    np.testing.assert_allclose(chain.jacobian(q), complex_step(chain, q), atol=1e-10)


def test_poses_do_not_depend_on_how_many_are_asked_for() -> None:
    chain = build_chain(read_robot(CONFIGS[0]))
    q = np.random.default_rng(7).uniform(-2, 2, (chain.n_joints, BLOCK + 17))
    together = chain.forward(q).matrices()
    for part in (slice(0, 1), slice(BLOCK - 3, BLOCK + 3)):
        np.testing.assert_array_equal(chain.forward(q[:, part]).matrices(), together[part])
    assert chain.forward(q[:, :0]).translation.shape == (3, 0)
    assert chain.jacobian(q[:, :0]).shape == (6, len(chain.motions), 0)


# A palletiser: the controller counts j3 from the horizontal, and rods keep the wrist level.
PALLETISER = """robacc: 1
name: palletiser
convention: standard
units: {length: mm, angle: deg}
tool: {xyz: [10, 20, 100], rpy: [5, 0, 30]}
joints:
  - {name: j1, type: revolute, theta: 0, d: 800, a: 150, alpha: -90, limits: [-170, 170]}
  - {name: j2, type: revolute, theta: -90, d: 0, a: 900, alpha: 0, limits: [-40, 85]}
  - {name: j3, type: revolute, theta: 90, d: 0, a: 1000, alpha: 0, limits: [-20, 110], sign: -1, coupling: {j2: 1}}
  - {name: rods, type: revolute, theta: 0, d: 0, a: 200, alpha: -90, passive: true, coupling: {j3: 1.0}, mass: 5}
  - {name: j4, type: revolute, theta: 0, d: -100, a: 0, alpha: 180, limits: [-300, 300]}
"""


# A spindle: turning it by j4 moves the quill by 20 mm a turn.
SPINDLE = """robacc: 1
name: spindle
convention: standard
units: {length: mm, angle: deg}
joints:
  - {name: j1, type: revolute, theta: 0, d: 300, a: 250, alpha: 0}
  - {name: j3, type: prismatic, theta: 0, d: 0, a: 0, alpha: 180, limits: [0, 200], coupling: {j4: 0.05555555555}}
  - {name: j4, type: revolute, theta: 0, d: 0, a: 0, alpha: 0}
"""


def test_joints_turn_by_their_own_and_the_coupled_variables() -> None:
    # Written out by hand: joint 3 turns by -(q3 + q2), and the rods turn back by q3.
    robot = parse_robot(PALLETISER.replace("tool: {xyz: [10, 20, 100], rpy: [5, 0, 30]}\n", ""), "p.yaml")
    q = np.array([0.3, -0.2, 0.5, 0.7])
    quarter = np.pi / 2
    expected = (
        dh(q[0], 0.8, 0.15, -quarter)
        @ dh(q[1] - quarter, 0, 0.9, 0)
        @ dh(quarter - (q[2] + q[1]), 0, 1.0, 0)
        @ dh(q[2], 0, 0.2, -quarter)
        @ dh(q[3], -0.1, 0, np.pi)
    )
    assert robot.variable_names == ("j1", "j2", "j3", "j4")
    np.testing.assert_allclose(build_chain(robot).forward(q[:, None]).matrices()[0], expected, atol=1e-14)


@pytest.mark.parametrize("text", [PALLETISER, SPINDLE])
def test_the_jacobian_is_the_derivative(text: str) -> None:
    arm = Arm.of(parse_robot(text, "p.yaml"))
    q = np.random.default_rng(1).uniform(-0.5, 0.5, (arm.chain.n_joints, 7))
    jacobian = pose_jacobian(arm, q)[1]
    for joint in range(q.shape[0]):
        step = np.zeros_like(q)
        step[joint] = 1e-6
        ahead, behind = arm.chain.forward(q + step), arm.chain.forward(q - step)
        np.testing.assert_allclose(
            jacobian[:3, joint], (ahead.translation - behind.translation) / 2e-6, atol=1e-8
        )  # the central difference's own error is of order 1e-10
        turn = np.einsum("ikn,jkn->ijn", ahead.rotation - behind.rotation, arm.chain.forward(q).rotation) / 2e-6
        np.testing.assert_allclose(jacobian[3:, joint], [turn[2, 1], turn[0, 2], turn[1, 0]], atol=1e-8)


@pytest.mark.parametrize("text", [PALLETISER, SPINDLE])
def test_written_files_are_the_same_arm(text: str) -> None:
    robot = parse_robot(text, "p.yaml")
    assert parse_robot(robot_to_yaml(robot), "again.yaml").joints == robot.joints
    urdf, losses = robot_to_urdf(robot)
    reread = parse_urdf(urdf, "again.urdf")
    assert reread.variable_names == robot.variable_names
    assert not any("coupl" in line for line in losses)
    ours, theirs = ([joint.mass for joint in one.joints if joint.mass] for one in (robot, reread))
    assert theirs == ours
    q = np.random.default_rng(2).uniform(-1, 1, (len(robot.variables), 20))
    np.testing.assert_allclose(
        build_chain(reread).forward(q).matrices(), build_chain(robot).forward(q).matrices(), atol=1e-12
    )


def test_units_of_a_mixed_coupling_are_the_files() -> None:
    robot = parse_robot(SPINDLE, "s.yaml")
    assert robot.joints[1].coupling["j4"] * 2 * np.pi == pytest.approx(0.02, rel=1e-9)
    q = np.array([[0.0, 0.0], [0.05, 0.05], [0.0, 2 * np.pi]])
    height = build_chain(robot).forward(q).translation[2]
    assert height[1] - height[0] == pytest.approx(0.02, rel=1e-9)


def test_inverse_kinematics_and_reach_of_coupled_joints() -> None:
    arm = Arm.of(parse_robot(PALLETISER, "p.yaml"))
    q = np.array([[0.4, -0.3], [0.3, 0.6], [0.7, 0.2], [1.0, -1.0]])
    assert inverse_kinematics(arm, arm.chain.forward(q), starts=16).converged.any(axis=1).all()
    reach = find_reach(arm.robot, arm.robot.tool)
    slide = find_reach(parse_robot(SPINDLE, "s.yaml"), arm.robot.tool)
    for each in (reach, slide):
        assert 0.3 < (each["sampled_m"] or 0.0) <= (each["bound_m"] or 0.0) + 1e-12


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("coupling: {j2: 1}", "coupling: {j9: 1}", "joints[2].coupling.j9: 'j9' is not another joint with a variable"),
        ("coupling: {j2: 1}", "coupling: {j3: 1}", "joints[2].coupling.j3: 'j3' is not another joint with a variable"),
        ("coupling: {j2: 1}", "coupling: {rods: 1}", "'rods' is not another joint with a variable; there are j1, j2"),
        ("coupling: {j2: 1}", "coupling: {j2: x}", "joints[2].coupling.j2: expected a number, found 'x'"),
        ("coupling: {j2: 1}", "coupling: j2", "joints[2].coupling: expected joints with their ratios"),
        ("passive: true, coupling: {j3: 1.0}", "passive: true", "joints[3].passive: a passive joint moves by its"),
        ("passive: true", "passive: perhaps", "joints[3].passive: expected true or false, found 'perhaps'"),
    ],
)
def test_wrong_couplings_are_reported(old: str, new: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        parse_robot(PALLETISER.replace(old, new), "p.yaml")
    assert any(message in str(problem) for problem in caught.value.problems), caught.value


HAND = """<robot name="hand">
  <link name="palm"/><link name="thumb"/><link name="left"/><link name="right"/><link name="tip"/>
  <joint name="lead" type="revolute"><parent link="palm"/><child link="thumb"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
  <joint name="a" type="revolute"><origin xyz="0 0.1 0"/><parent link="palm"/><child link="left"/><axis xyz="0 0 1"/>
    <limit lower="-2" upper="2" effort="1" velocity="1"/><mimic joint="lead" multiplier="2" offset="0.1"/></joint>
  <joint name="b" type="revolute"><origin xyz="0.1 0 0"/><parent link="left"/><child link="right"/><axis xyz="0 0 1"/>
    <limit lower="-2" upper="2" effort="1" velocity="1"/><mimic joint="lead" multiplier="-1" offset="0.3"/></joint>
  <joint name="c" type="fixed"><origin xyz="0.1 0 0"/><parent link="right"/><child link="tip"/></joint>
</robot>
"""


def test_followers_of_a_joint_outside_the_chain_move_together() -> None:
    robot = parse_urdf(HAND, "hand.urdf", None, "tip")
    assert robot.variable_names == ("a",)
    lead = 0.4
    a, b = 2 * lead + 0.1, -lead + 0.3
    position = build_chain(robot).forward(np.array([[a]])).translation[:, 0]
    expected = [0.1 * np.cos(a) + 0.1 * np.cos(a + b), 0.1 + 0.1 * np.sin(a) + 0.1 * np.sin(a + b), 0]
    np.testing.assert_allclose(position, expected, atol=1e-15)


@pytest.mark.parametrize("name", ["lead", "lead_deg"])
def test_a_column_of_a_joint_outside_the_chain_is_answered_by_the_rule(tmp_path: Path, name: str) -> None:
    """A lifting column logs the joint that its two stages follow; only the first stage may have a column."""
    robot = parse_urdf(HAND, "hand.urdf", None, "tip")
    poses = saved(tmp_path / "poses.csv", f"{name},x,y,z\n0.1,0.1,0.1,0.0\n")
    with pytest.raises(InputError) as caught:
        read_robot_poses(poses, robot)
    assert f"{name!r} is outside the robot's chain, so write the column a = 2 * lead + 0.1 (rad)" in str(caught.value)


EPS = np.finfo(float).eps


# Magnitudes that matter: zero, below and above the series' threshold, ordinary, and pi from below.
ANGLES = st.one_of(
    st.sampled_from([0.0, 1e-300, 1e-12, 1e-8, 9.9e-5, 1.01e-4, 1e-3, np.pi - 1e-3, np.pi - 1e-7, np.pi - 1e-12]),
    st.floats(0.0, np.pi - 1e-9),
)


@st.composite
def rotation_vectors(draw: st.DrawFn) -> Array:
    direction = np.array(draw(st.tuples(*[st.floats(-1, 1)] * 3)))
    length = np.linalg.norm(direction)
    direction = direction / length if length > 1e-3 else np.array([0.0, 0.6, -0.8])
    return direction * draw(ANGLES)


@given(rotation_vectors())
@settings(max_examples=80, deadline=None)
def test_exponential_is_the_matrix_exponential_and_the_logarithm_undoes_it(vector: Array) -> None:
    # scipy's Pade approximation is good to some ten roundings.
    np.testing.assert_allclose(exp_so3(vector), expm(skew(vector)), atol=40 * EPS)
    # The angle is resolved to rounding everywhere: no square root of epsilon near zero or pi.
    np.testing.assert_allclose(log_so3(exp_so3(vector)), vector, rtol=0, atol=20 * EPS)
    length = float(np.linalg.norm(vector))
    if 1e-150 < length < 1:
        assert np.linalg.norm(log_so3(exp_so3(vector)) - vector) <= 1e-14 * length


def test_logarithm_at_pi_is_one_of_its_two_vectors() -> None:
    for axis in np.vstack((np.eye(3), [[0.6, -0.8, 0.0], [-0.36, 0.48, 0.8]])):
        rotation = 2 * np.outer(axis, axis) - np.eye(3)
        vector = log_so3(rotation)
        assert min(np.linalg.norm(vector - np.pi * axis), np.linalg.norm(vector + np.pi * axis)) < 1e-14


@given(rotation_vectors())
@settings(max_examples=60, deadline=None)
def test_quaternion_is_scipys_and_comes_back(vector: Array) -> None:
    rotation = Rotation.from_rotvec(vector).as_matrix()
    quaternion = quaternion_from_rotation(rotation)
    theirs = Rotation.from_matrix(rotation).as_quat(canonical=True, scalar_first=True)
    # At pi the two signs are one rotation.
    np.testing.assert_allclose(quaternion, np.sign(quaternion @ theirs) * theirs, atol=1e-14)
    assert quaternion[0] >= 0
    np.testing.assert_allclose(rotation_from_quaternion(quaternion), rotation, atol=1e-14)


@given(st.tuples(st.floats(-3.1, 3.1), st.floats(-1.57, 1.57), st.floats(-3.1, 3.1)))
@settings(max_examples=60, deadline=None)
def test_rpy_are_rotations_about_fixed_axes(rpy: tuple[float, float, float]) -> None:
    rotation = rotation_from_rpy(np.array(rpy))
    np.testing.assert_allclose(rotation, Rotation.from_euler("xyz", rpy).as_matrix(), atol=1e-15)
    # Up to 8e-4 rad from the pole each of roll and yaw has lost three digits of sixteen.
    np.testing.assert_allclose(rpy_from_rotation(rotation), rpy, atol=2e-12)


@pytest.mark.parametrize("pitch", [np.pi / 2, -np.pi / 2])
def test_rpy_at_the_pole_sets_roll_to_zero_and_keeps_the_rotation(pitch: float) -> None:
    rotation = rotation_from_rpy(np.array([0.4, pitch, 1.1]))
    rotation = np.where(np.abs(rotation) < 1e-15, 0.0, rotation)
    rpy = rpy_from_rotation(rotation)
    assert rpy[0] == 0
    np.testing.assert_allclose(rotation_from_rpy(rpy), rotation, atol=1e-15)


@given(rotation_vectors(), st.integers(0, 2))
@settings(max_examples=60, deadline=None)
def test_left_jacobian_inverse_is_the_logarithms_derivative(vector: Array, axis: int) -> None:
    if np.linalg.norm(vector) > 3.0:
        return  # the logarithm jumps at pi; a difference quotient across the jump means nothing
    step = 1e-6
    turn = [exp_so3(np.eye(3)[axis] * sign * step) for sign in (1, -1)]
    rotation = exp_so3(vector)
    quotient = (log_so3(turn[0] @ rotation) - log_so3(turn[1] @ rotation)) / (2 * step)
    # Truncation is of order step^2 times a third derivative that grows towards pi, rounding 1e-16 / step.
    np.testing.assert_allclose(left_jacobian_inverse(vector)[:, axis], quotient, atol=2e-9)


def test_poses_are_homogeneous_matrices() -> None:
    rng = np.random.default_rng(4)
    first, second = (Poses(exp_so3(rng.normal(size=(3, 7))), rng.normal(size=(3, 7))) for _ in range(2))
    product = first.matrices() @ second.matrices()
    np.testing.assert_allclose((first @ second).matrices(), product, atol=1e-14)
    np.testing.assert_allclose(first.inverse().matrices(), np.linalg.inv(first.matrices()), atol=1e-14)
    np.testing.assert_array_equal(Poses.identity(7).matrices(), np.broadcast_to(np.eye(4), (7, 4, 4)))
    made = Poses.from_xyz_rpy(np.array([1.0, 2, 3]), np.array([0, 0, np.pi / 2]))
    np.testing.assert_allclose(made.matrices(), [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]], atol=1e-16)


@pytest.mark.parametrize("scale", [0.0, 1e-9, 1e-5, 1e-3, 0.3, 1.0, 3.0])
def test_the_rotation_between_two_is_that_of_their_product(scale: float) -> None:
    rng = np.random.default_rng(7)
    second = exp_so3(rng.normal(size=(3, 200)))
    vector = rng.normal(size=(3, 200))
    vector *= scale / np.linalg.norm(vector, axis=0)
    first = compose(exp_so3(vector), second)
    # Rounding of a product of matrices, in the angle; next to half a turn the axis loses digits.
    np.testing.assert_allclose(log_between(first, second), vector, rtol=0, atol=1e-15 * (1 + 50 * scale**2))
