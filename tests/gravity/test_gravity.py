"""Weight of links, of branches that move and of joints that follow others, against potential energies and matrices."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import pytest
from arms import arm, circumstances
from homogeneous import frame

from robacc import InputError, Measurements, Robot, correct, read_poses, read_robot
from robacc.effects.specification import build, parse_requests
from robacc.fitting.fit_result import Options
from robacc.fitting.solver import fit
from robacc.gravity import (
    gravity_torques,
    weight_torques,
)
from robacc.modelling.model import Model, predict
from robacc.robots.arm import Arm
from robacc.robots.urdf import parse_urdf
from robacc.robots.yaml_robot import parse_robot, robot_to_yaml
from robacc.tracing.search import search
from robacc_plugins.urdf import robot_to_urdf

ARMS = ("puma560", "panda", "stanford", "urdf:puma560")
N = 5


@pytest.mark.parametrize("name", ARMS)
def test_joint_torques_against_a_difference_of_the_energy(name: str) -> None:
    robot_arm = arm(name)
    q = circumstances(robot_arm.robot, N).q
    result = gravity_torques(robot_arm, q)

    def energy(at: np.ndarray) -> np.ndarray:
        total = np.zeros(N)
        for body in robot_arm.chain.bodies:
            frame = robot_arm.chain.sweep(robot_arm.chain.scalars(at), N, (), (body.after,)).frames[0]
            place = np.einsum("ijn,j->in", frame.rotation, np.array(body.com)) + frame.translation
            total -= body.mass * np.array(robot_arm.robot.gravity) @ place
        return total

    for i in range(len(robot_arm.names)):
        step = np.zeros_like(q)
        step[i] = 1e-5
        slope = (energy(q + step) - energy(q - step)) / 2e-5
        # A central difference of a hundred joules leaves some 1e-9; a torque of the wrong sign or lever is far from it.
        np.testing.assert_allclose(result[i], -slope, rtol=0, atol=1e-7)
    assert np.abs(result).max() > 1.0


# name, parent, origin, axis, mass of the link, its centre of mass
TORSO = ("waist", "pelvis", (0.0, 0.0, 0.6), (0.0, 1.0, 0.0), 14.0, (0.02, 0.0, 0.25))


def _arm(side: str, y: float) -> list[tuple[str, str, tuple, tuple, float, tuple]]:
    return [
        (f"{side}_pan", "waist", (0.0, y, 0.5), (0.0, 0.0, 1.0), 2.5, (0.0, 0.3 * y, 0.05)),
        (f"{side}_lift", f"{side}_pan", (0.0, 0.3 * y, 0.05), (0.0, 1.0, 0.0), 3.0, (0.15, 0.0, 0.02)),
        (f"{side}_elbow", f"{side}_lift", (0.35, 0.0, 0.0), (0.0, 1.0, 0.0), 2.0, (0.12, 0.01, 0.0)),
    ]


JOINTS = [TORSO, *_arm("left", 0.25), *_arm("right", -0.25)]
CHAIN = ("waist", "right_pan", "right_lift", "right_elbow")
BESIDE = ("left_pan", "left_lift", "left_elbow")
HAND = np.array([0.3, 0.0, 0.05])
COMPLIANCE = np.array([2e-5, 0.0, 4e-6, 0.0])
NOISE = 3e-5
GRAVITY = 9.81


def urdf() -> str:
    lines = ['<robot name="torso">', '<link name="pelvis"/>']
    for name, parent, origin, axis, mass, com in JOINTS:
        carrier = parent if parent == "pelvis" else f"{parent}_link"
        lines += [
            f'<joint name="{name}" type="revolute"><origin xyz="{" ".join(map(str, origin))}"/>',
            f'<parent link="{carrier}"/><child link="{name}_link"/><axis xyz="{" ".join(map(str, axis))}"/>',
            '<limit lower="-1.5" upper="1.5" effort="0" velocity="0"/></joint>',
            f'<link name="{name}_link"><inertial><origin xyz="{" ".join(map(str, com))}"/><mass value="{mass}"/>',
            '<inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/></inertial></link>',
        ]
    for side in ("left", "right"):
        lines += [
            f'<joint name="{side}_hand" type="fixed"><origin xyz="{" ".join(map(str, HAND))}"/>',
            f'<parent link="{side}_elbow_link"/><child link="{side}_hand_link"/></joint>',
            f'<link name="{side}_hand_link"><inertial><mass value="0.8"/>',
            '<inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/></inertial></link>',
        ]
    return "\n".join([*lines, "</robot>"])


def link_frames(angles: dict[str, float]) -> dict[str, np.ndarray]:
    """Frames (4, 4) of all links, by Rodrigues' formula."""
    frames = {"pelvis": np.eye(4)}
    for name, parent, origin, axis, *_ in JOINTS:
        x, y, z = axis
        skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        step = np.eye(4)
        step[:3, :3] += np.sin(angles[name]) * skew + (1 - np.cos(angles[name])) * skew @ skew
        step[:3, 3] = origin
        frames[name] = frames[parent] @ step
    return frames


def torques(angles: dict[str, float]) -> np.ndarray:
    """Gravity's torque about the chain's joints: axis times the sum of levers x weights of what the joint moves."""
    frames = link_frames(angles)
    bodies = [(name, mass, frames[name] @ np.append(com, 1.0)) for name, *_, mass, com in JOINTS]
    bodies += [(f"{side}_elbow", 0.8, frames[f"{side}_elbow"] @ np.append(HAND, 1.0)) for side in ("left", "right")]
    parents = {name: parent for name, parent, *_ in JOINTS}
    axes = {name: axis for name, _, _, axis, *_ in JOINTS}

    def is_behind(name: str, joint: str) -> bool:
        return name == joint or (name in parents and is_behind(parents[name], joint))

    result = []
    for joint in CHAIN:
        # Gravity along -z: the moment of m g (0, 0, -1) at the lever (x, y, z) is m g (-y, x, 0).
        levers = [(m, (at - frames[joint][:, 3])[:3]) for name, m, at in bodies if is_behind(name, joint)]
        moment = sum(m * GRAVITY * np.array([-lever[1], lever[0], 0.0]) for m, lever in levers)
        result.append(float(frames[joint][:3, :3] @ axes[joint] @ moment))
    return np.array(result)


def measured(n: int, seed: int, noise: float = NOISE) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Joints of the chain (4, n), of the other arm (3, n), and positions of the right hand with noise (3, n)."""
    rng = np.random.default_rng(seed)
    q, other = rng.uniform(-1.4, 1.4, (4, n)), rng.uniform(-1.4, 1.4, (3, n))
    q[0] *= 0.4
    positions = []
    for right, left in zip(q.T, other.T, strict=True):
        commanded = dict(zip((*CHAIN, *BESIDE), (*right, *left), strict=True))
        deflected, previous = commanded, None
        while previous is None or max(abs(deflected[j] - previous[j]) for j in CHAIN) > 1e-9:
            sag = COMPLIANCE * torques(deflected)
            previous, deflected = deflected, commanded | {j: commanded[j] + d for j, d in zip(CHAIN, sag, strict=True)}
        positions.append((link_frames(deflected)["right_elbow"] @ np.append(HAND, 1.0))[:3])
    return q, other, np.array(positions).T + rng.normal(scale=noise, size=(3, n))


def _as_measured(n: int, seed: int, with_branches: bool, noise: float) -> Measurements:
    q, other, position = measured(n, seed, noise)
    return Measurements(position, q=q, branches=other if with_branches else None)


def written(tmp_path: Path, n: int, seed: int, columns: tuple[str, ...] = (*CHAIN, *BESIDE)) -> tuple[Path, Path]:
    q, other, position = measured(n, seed)
    rows = dict(zip((*CHAIN, *BESIDE, "x", "y", "z"), (*q, *other, *position), strict=True))
    names = [*columns, "x", "y", "z"]
    lines = [",".join(names), *(",".join(repr(float(rows[name][i])) for name in names) for i in range(n))]
    poses, robot = tmp_path / f"poses{seed}.csv", tmp_path / "torso.urdf"
    poses.write_text("\n".join(lines) + "\n")
    robot.write_text(urdf())
    return poses, robot


def test_torques_of_the_chain_count_the_other_arm_where_it_stands() -> None:
    q, other, _ = measured(20, 1)
    arm = Arm.of(parse_urdf(urdf(), "torso.urdf", tip_link="right_hand_link"))
    data = Measurements(np.zeros((3, 20)), q=q, branches=other, branch_names=BESIDE)
    expected = np.array(
        [torques(dict(zip((*CHAIN, *BESIDE), (*a, *b), strict=True))) for a, b in zip(q.T, other.T, strict=True)]
    ).T
    np.testing.assert_allclose(weight_torques(arm, data), expected, atol=1e-9)
    at_zero = np.array([torques(dict(zip((*CHAIN, *BESIDE), (*a, 0.0, 0.0, 0.0), strict=True))) for a in q.T]).T
    np.testing.assert_allclose(weight_torques(arm, Measurements(np.zeros((3, 20)), q=q)), at_zero, atol=1e-9)


@pytest.mark.parametrize("form", ["yaml", "urdf"])
def test_a_robot_with_branches_is_written_and_read_back(form: str) -> None:
    robot = parse_urdf(urdf(), "torso.urdf", tip_link="right_hand_link")
    assert [branch.joint.name for branch in robot.branches] == list(BESIDE)
    assert [branch.parent for branch in robot.branches] == ["waist", "left_pan", "left_lift"]
    assert robot.branches[2].joint.mass == pytest.approx(2.8)  # with the hand
    if form == "yaml":
        again = parse_robot(robot_to_yaml(robot), "torso.yaml")
        assert again.branches == robot.branches
    else:
        again = parse_urdf(robot_to_urdf(robot)[0], "again.urdf", tip_link="right_hand_link")
    q, other, _ = measured(10, 2)
    data = Measurements(np.zeros((3, 10)), q=q, branches=other)
    np.testing.assert_allclose(weight_torques(Arm.of(again), data), weight_torques(Arm.of(robot), data), atol=1e-9)


def error_at_other_poses(with_branches: bool) -> float:
    """RMS error (m) of a fit at poses that it has not seen and that have no noise."""
    arm = Arm.of(parse_urdf(urdf(), "torso.urdf", tip_link="right_hand_link"))
    poses, fresh = (_as_measured(80, seed, with_branches, noise) for seed, noise in ((3, NOISE), (5, 0.0)))
    effects = build(parse_requests("tool_frame,joint_compliance[waist,right_lift]"), arm, poses)
    result = fit(Model(arm, free=effects), poses, Options())
    predicted = result.model.bind(fresh).poses(result.theta).translation
    return float(np.sqrt(np.mean(np.sum(np.square(fresh.position - predicted), axis=0))))


def test_the_other_arms_joints_bring_the_fit_to_the_floor() -> None:
    # 80 poses of three coordinates and five coefficients leave about a sixth of the noise.
    assert error_at_other_poses(True) < 0.5 * NOISE
    assert error_at_other_poses(False) > 5 * NOISE


def test_a_trace_names_the_joints_that_give_way_to_both_arms() -> None:
    arm = Arm.of(parse_urdf(urdf(), "torso.urdf", tip_link="right_hand_link"))
    data = _as_measured(80, 3, True, NOISE)
    start = Model(arm, free=build(parse_requests("tool_frame"), arm, data))
    effects = search(start, data).effects
    assert sorted((effect.name, effect.joints) for effect in effects) == [
        ("joint_compliance", ("right_lift",)),
        ("joint_compliance", ("waist",)),
    ]


def test_joints_beside_the_chain_without_a_column_stand_at_zero_and_are_named(tmp_path: Path) -> None:
    poses, robot_path = written(tmp_path, 12, 4, (*CHAIN, "left_lift"))
    data = read_poses(poses, robot=read_robot(robot_path, tip_link="right_hand_link"))
    assert not data.branches[[0, 2]].any()
    assert data.branches[1].any()
    (warning,) = [text for text in data.warnings if "outside the chain" in text]
    assert "left_pan, left_elbow outside the chain have no column and count as fixed at zero" in warning


def test_a_branch_of_a_robot_file_stands_at_its_position(tmp_path: Path) -> None:
    text = """robacc: 1
convention: standard
units: {length: mm, angle: deg}
joints:
  - {name: tilt, type: revolute, theta: 0, d: 0, a: 500, alpha: 0, mass: 10, com: [-100, 0, 0]}
branches:
  - {name: other, parent: tilt, type: revolute, origin: {xyz: [0, 0, 0], rpy: [90, 0, 0]}, axis: [0, 0, 1],
     mass: 2, com: [300, 0, 0], position: 30}
gravity: [0, -9.81, 0]
"""
    robot = parse_robot(text, "tilt.yaml")
    data = Measurements(np.zeros((3, 1)), q=np.zeros((1, 1)))
    # Gravity along -y: the torque about z is -g (10 * 0.4 + 2 * (0.5 + 0.3 cos 30 degrees)).
    expected = -9.81 * (10 * 0.4 + 2 * (0.5 + 0.3 * np.cos(np.radians(30))))
    assert weight_torques(Arm.of(robot), data)[0, 0] == pytest.approx(expected, rel=1e-12)
    assert parse_robot(robot_to_yaml(robot), "tilt.yaml").branches == robot.branches
    with pytest.raises(InputError, match="neither base nor a joint in front of it"):
        parse_robot(text.replace("parent: tilt", "parent: nobody"), "tilt.yaml")


def test_targets_are_corrected_for_the_other_arm_where_it_stands(tmp_path: Path) -> None:
    robot = parse_urdf(urdf(), "torso.urdf", tip_link="right_hand_link")
    entry = {"effect": "joint_compliance", "joints": ["waist"], "values": {"waist": float(COMPLIANCE[0])}}
    model = dataclasses.replace(robot, effects=(entry,))
    q, other, _ = measured(6, 7)
    targets = Measurements(np.zeros((3, 6)), q=q, branches=other, branch_names=BESIDE)
    wanted = predict(robot, targets).translation
    errors = {}
    for name, columns in (("with", targets), ("without", dataclasses.replace(targets, branches=None))):
        # Four joints reach positions, not whole poses: an orientation counts little.
        commands = correct(columns, model=model, nominal=robot, weight="1m").q
        attained = predict(model, dataclasses.replace(targets, q=commands)).translation
        errors[name] = float(np.max(np.linalg.norm(attained - wanted, axis=0)))
    assert errors["with"] < 1e-6
    assert errors["without"] > 2e-4


YAML = """robacc: 1
convention: urdf
units: {length: mm, angle: deg}
gravity: [0, 0, -9.81]
joints:
  - {name: waist, type: revolute, origin: {xyz: [0, 0, 600], rpy: [0, 0, 0]}, axis: [0, 1, 0],
     mass: 14, com: [20, 0, 250]}
  - {name: lift, type: revolute, origin: {xyz: [0, -300, 500], rpy: [0, 0, 0]}, axis: [0, 1, 0],
     mass: 3, com: [150, 0, 20]}
branches:
  - {name: shoulder, parent: waist, type: revolute, origin: {xyz: [0, 300, 500], rpy: [0, 0, 0]}, axis: [0, 1, 0],
     mass: 3, com: [150, 0, 20]}
  - {name: elbow, parent: shoulder, type: revolute, origin: {xyz: [350, 0, 0], rpy: [0, 0, 0]}, axis: [0, 1, 0],
     mass: 2, com: [120, 10, 0], mimic: {joint: shoulder, multiplier: -0.5, offset: 20}}
  - {name: counterweight, parent: waist, type: prismatic, origin: {xyz: [-100, 0, 300], rpy: [0, 0, 0]},
     axis: [1, 0, 0], mass: 5, com: [0, 0, 30], limits: [-100, 200], mimic: {joint: lift, multiplier: -2, offset: 50}}
"""


# Millimetres per degree in the file; m per rad here.
SLIDE = -2e-3 * 180 / np.pi


def energy(waist: float, lift: float, shoulder: float, elbow: float, slide: float) -> float:
    """Potential energy of all links."""
    trunk = frame((0, 0, 0.6), (0, waist, 0))
    arm = trunk @ frame((0, -0.3, 0.5), (0, lift, 0))
    upper = trunk @ frame((0, 0.3, 0.5), (0, shoulder, 0))
    fore = upper @ frame((0.35, 0, 0), (0, elbow, 0))
    bodies = [
        (trunk, 14.0, (0.02, 0, 0.25)),
        (arm, 3.0, (0.15, 0, 0.02)),
        (upper, 3.0, (0.15, 0, 0.02)),
        (fore, 2.0, (0.12, 0.01, 0)),
        (trunk, 5.0, (-0.1 + slide, 0, 0.33)),
    ]
    return sum(mass * GRAVITY * float((place @ np.append(com, 1.0))[2]) for place, mass, com in bodies)


def torques_of_copies(waist: float, lift: float, shoulder: float) -> list[float]:
    """Minus the slope of the energy along each joint of the chain; the drives of the others hold them still."""
    elbow, slide = -0.5 * shoulder + np.radians(20), SLIDE * lift + 0.05
    step, others = 1e-6, (shoulder, elbow, slide)
    return [
        (energy(waist - step, lift, *others) - energy(waist + step, lift, *others)) / (2 * step),
        (energy(waist, lift - step, *others) - energy(waist, lift + step, *others)) / (2 * step),
    ]


@pytest.fixture(name="poses", scope="module")
def _poses() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(4)
    return rng.uniform(-1.2, 1.2, (2, 15)), rng.uniform(-1.2, 1.2, (1, 15))


def followed(robot: Robot, poses: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    q, other = poses
    return weight_torques(Arm.of(robot), Measurements(np.zeros((3, q.shape[1])), q=q, branches=other))


@pytest.mark.parametrize("form", ["file", "yaml", "urdf"])
def test_joints_of_branches_follow_their_masters(form: str, poses: tuple[np.ndarray, np.ndarray]) -> None:
    robot = parse_robot(YAML, "torso.yaml")
    if form == "yaml":
        robot = parse_robot(robot_to_yaml(robot), "again.yaml")
    elif form == "urdf":
        robot = parse_urdf(robot_to_urdf(robot)[0], "again.urdf", tip_link="lift_link")
    assert [branch.joint.name for branch in robot.branch_variables] == ["shoulder"]
    expected = np.array([torques_of_copies(*q, *other) for q, other in zip(poses[0].T, poses[1].T, strict=True)]).T
    np.testing.assert_allclose(followed(robot, poses), expected, atol=1e-6)


def test_without_columns_masters_stand_at_their_positions(poses: tuple[np.ndarray, np.ndarray]) -> None:
    robot = parse_robot(
        YAML.replace("com: [150, 0, 20]}\n  - {name: elbow", "com: [150, 0, 20], position: 30}\n  - {name: elbow"),
        "t.yaml",
    )
    expected = np.array([torques_of_copies(*q, np.radians(30)) for q in poses[0].T]).T
    actual = weight_torques(Arm.of(robot), Measurements(np.zeros((3, 15)), q=poses[0]))
    np.testing.assert_allclose(actual, expected, atol=1e-6)


def test_a_master_that_a_joint_of_the_chain_follows_stands_as_that_one_tells() -> None:
    text = robot_to_urdf(parse_robot(YAML, "torso.yaml"))[0]
    # Lift follows the shoulder outside the chain: lift = 2 shoulder + 0.1, and lift has the column.
    follows = '<mimic joint="shoulder" multiplier="2" offset="0.1"/>'
    text = re.sub(r'(<joint name="lift".*?)(</joint>)', rf"\1{follows}\2", text, flags=re.DOTALL)
    robot = parse_urdf(text, "torso.urdf", tip_link="lift_link")
    assert robot.variable_names == ("waist", "lift")
    assert robot.branch_variables == ()
    q = np.random.default_rng(5).uniform(-1, 1, (2, 8))
    expected = np.array([torques_of_copies(waist, lift, (lift - 0.1) / 2) for waist, lift in q.T]).T
    actual = weight_torques(Arm.of(robot), Measurements(np.zeros((3, 8)), q=q))
    np.testing.assert_allclose(actual, expected, atol=1e-6)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("joint: shoulder,", "joint: nobody,", r"branches\[1\].mimic.joint: 'elbow' follows 'nobody', which is not"),
        ("joint: lift,", "joint: elbow,", "'counterweight' follows 'elbow', which follows another joint itself"),
        ("offset: 50}", "offset: 50}, position: 3", "a joint that follows another has no position of its own"),
    ],
)
def test_rules_that_nothing_can_follow_are_refused(old: str, new: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        parse_robot(YAML.replace(old, new), "torso.yaml")
