"""A torso with two arms: the weight of the other arm, which moves, against a simulation with matrices of its own."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from robacc.api.correct import correct
from robacc.api.inputs import read_poses
from robacc.effects.specification import build, parse_requests
from robacc.errors import InputError
from robacc.fitting.fit_result import Options
from robacc.fitting.solver import fit
from robacc.gravity import weight_torques
from robacc.measurements import Measurements
from robacc.modelling.model import Model, predict
from robacc.modelling.robot_file import read_robot
from robacc.robots.arm import Arm
from robacc.robots.urdf import parse_urdf, robot_to_urdf
from robacc.robots.yaml_robot import parse_robot, robot_to_yaml
from robacc.tracing.search import search

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
