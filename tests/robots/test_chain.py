"""The chain against textbook matrices, published poses, and its own derivative by a complex step."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from homogeneous import frame

from robacc.geometry import Array
from robacc.modelling.robot_file import read_robot
from robacc.robots.arm import BLOCK, Chain, build_chain
from robacc.robots.description import Frame, Joint, Mimic, Robot

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


def test_a_mimic_joint_follows_its_master() -> None:
    robot = finite_robots()[0]
    chain = build_chain(robot)
    assert chain.n_joints == 2
    free = build_chain(replace(robot, joints=(*robot.joints[:3], replace(robot.joints[3], mimic=None))))
    q = np.array([[0.4, -1.2], [0.1, 0.2]])
    followed = np.vstack((q, -0.7 * q[0] + 0.3))
    np.testing.assert_allclose(chain.forward(q).matrices(), free.forward(followed).matrices(), atol=1e-15)


def test_poses_do_not_depend_on_how_many_are_asked_for() -> None:
    chain = build_chain(read_robot(CONFIGS[0]))
    q = np.random.default_rng(7).uniform(-2, 2, (chain.n_joints, BLOCK + 17))
    together = chain.forward(q).matrices()
    for part in (slice(0, 1), slice(BLOCK - 3, BLOCK + 3)):
        np.testing.assert_array_equal(chain.forward(q[:, part]).matrices(), together[part])
    assert chain.forward(q[:, :0]).translation.shape == (3, 0)
    assert chain.jacobian(q[:, :0]).shape == (6, len(chain.motions), 0)
