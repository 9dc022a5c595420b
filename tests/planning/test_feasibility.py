"""Poses that are feasible, acceptance plans, payloads, and branches at rest."""

import dataclasses
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import yaml
from arms import arm
from commands import refused
from sample_files import ROBOT, saved
from test_design import target_poses

import robacc
from robacc import InputError, Measurements, Planned, UsageError
from robacc.diagnostics.robot_poses import read_robot_poses
from robacc.modelling.model import Model
from robacc.planning.candidates import (
    Constraints,
    Sight,
    filtered,
    given_candidates,
    joint_condition,
    lengths,
    moving_points,
    parse_box,
    parse_half_space,
    sampled_candidates,
    task_joints,
)


def model(name: str = "irb1600") -> Model:
    return Model(arm(name))


def forward(which: Model, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Position and rotation of the target, by matrices."""
    pose = target_poses(which.arm.robot, q, {})
    return pose[:, :3, 3].T, np.moveaxis(pose[:, :3, :3], 0, 2)


def samples(which: Model, n: int = 300) -> np.ndarray:
    low, high = np.array([joint.limits for joint in which.arm.robot.variables]).T[..., None]
    return np.random.default_rng(1).uniform(low, high, (len(low), n))


def test_targets_and_visibility_agree_with_matrices() -> None:
    which = model()
    q = samples(which)
    sight = Sight((2.5, 0.4, 1.0), (0.3, 0.0, 1.0), np.radians(40), (1.5, 3.0))
    target, excluded = filtered(which, q, Constraints(margin=0.0, sight=sight))
    position, rotation = forward(which, q)
    np.testing.assert_allclose(target, position, atol=1e-12)
    ray = np.array(sight.position)[:, None] - position
    distance = np.linalg.norm(ray, axis=0)
    axis = np.einsum("ijn,j->in", rotation, np.array(sight.axis) / np.linalg.norm(sight.axis))
    angle = np.degrees(np.arccos(np.sum(axis * ray, axis=0) / distance))
    visible = (distance >= 1.5) & (distance <= 3.0) & (angle <= 40)
    assert 0 < np.count_nonzero(visible) < 300
    np.testing.assert_array_equal(np.any(list(excluded.values()), axis=0), ~visible)


def test_places_hold_for_every_moving_point() -> None:
    which = model()
    q = samples(which)
    points = moving_points(which.arm, q)
    position, _ = forward(which, q)
    for text, wanted in (("z>=0.2", 0.2), ("y<=0.3", 0.3)):
        side = parse_half_space(text, "half_space")
        _, excluded = filtered(which, q, Constraints(margin=0.0, half_spaces=(side,)))
        row = np.concatenate((points, position[:, None]), axis=1)["xyz".index(text[0])]
        inside = np.all(row >= wanted, axis=0) if ">" in text else np.all(row <= wanted, axis=0)
        np.testing.assert_array_equal(np.any(list(excluded.values()), axis=0), ~inside)
        assert 0 < np.count_nonzero(inside) < 300
    _, excluded = filtered(which, q, Constraints(margin=0.0, half_spaces=(parse_half_space("z>=0.2", "min_height"),)))
    below = np.any(np.concatenate((points, position[:, None]), 1)[2] < 0.2, axis=0)
    np.testing.assert_array_equal(np.any(list(excluded.values()), axis=0), below)


def test_the_outline_has_the_elbow_and_not_the_pedestal() -> None:
    which = model()
    q = samples(which, 50)
    points = moving_points(which.arm, q)
    assert np.ptp(points, axis=2).max(axis=0).min() > 1e-3
    # The elbow: the origin after the second row lies one upper arm away from the shoulder.
    joints = which.arm.robot.joints
    shoulder = np.array([joints[0].parameters["a"] * np.cos(q[0]), joints[0].parameters["a"] * np.sin(q[0])])
    upper = joints[1].parameters["a"]
    distances = np.hypot(np.linalg.norm(points[:2] - shoulder[:, None], axis=0), points[2] - joints[0].parameters["d"])
    assert np.any(np.all(np.abs(distances - upper) < 1e-9, axis=1))


def test_singular_poses_have_a_large_condition() -> None:
    which = model("puma560")
    q = samples(which, 40)
    q[4, :20] = 1e-6  # wrist: axes 4 and 6 in line
    condition = joint_condition(which.arm, q)
    assert condition[:20].min() > 1e4 > np.median(condition[20:])


def test_exclusions_are_counted_by_reason() -> None:
    which = model()
    constraints = Constraints(
        half_spaces=(parse_half_space("z>=0.3", "min_height"),), inside=parse_box("x=0.2:1.2", "inside")
    )
    candidates = sampled_candidates(which, constraints, 400, 0)
    assert candidates.n == 400
    _, masks = filtered(which, candidates.q, constraints)
    assert not np.any(list(masks.values()))
    by_reason = {entry["reason"]: entry for entry in candidates.excluded}
    assert set(by_reason) == {"a point of the arm beyond z>=0.3", "target outside the box x=0.2:1.2"}
    both = sum(entry["count"] for entry in candidates.excluded) - sum(entry["alone"] for entry in candidates.excluded)
    excluded = sum(entry["alone"] for entry in candidates.excluded) + both // 2
    assert excluded <= candidates.n_drawn - candidates.n


def test_infeasible_demands_name_the_largest_reason() -> None:
    constraints = Constraints(
        inside=parse_box("x=20:30", "inside"), half_spaces=(parse_half_space("z>=0.3", "min_height"),)
    )
    with pytest.raises(UsageError, match=r"no pose is feasible: of 16000 poses, 16000 are excluded by: target outside"):
        sampled_candidates(model(), constraints, 400, 0)
    with pytest.raises(UsageError, match="no pose of the task is feasible"):
        task_joints(model(), Constraints(), parse_box("z=9:10", "region"), 0)


def test_given_candidates_outside_the_margin_are_counted() -> None:
    which = model()
    q = samples(which, 60)
    q[0, 0] = which.arm.robot.variables[0].limits[1]  # type: ignore[index]
    rows = Measurements(position=np.zeros((3, 60)), q=q)
    candidates = given_candidates(which, Constraints(margin=0.05), rows, 100, 0)
    assert candidates.n < 60
    assert candidates.excluded[0]["reason"] == "joint limits with margin"
    assert candidates.excluded[0]["count"] == 60 - candidates.n


def test_a_prismatic_joint_without_limits_is_an_error() -> None:
    which = arm("stanford").robot
    joints = tuple(
        dataclasses.replace(joint, limits=None) if joint.type == "prismatic" else joint for joint in which.joints
    )
    with pytest.raises(InputError, match="no limits to choose poses within"):
        sampled_candidates(Model.of(dataclasses.replace(which, joints=joints)), Constraints(), 100, 0)


@pytest.mark.parametrize(
    ("call", "text"),
    [
        (parse_box, "x=0.5:0.2"),
        (parse_box, "w=0:1"),
        (parse_box, "0:1"),
        (parse_half_space, "z=0.1"),
        (parse_half_space, "0.5q>=1"),
        (parse_half_space, "z>=fast"),
        (parse_half_space, "0z>=1"),
        (partial(lengths, expected="three numbers such as 2.5,0,1.2"), "1,2"),
        (partial(lengths, expected="three numbers such as 2.5,0,1.2"), "1,2,3deg"),
        (partial(lengths, expected="nearest and farthest such as 0.5:15"), "5"),
    ],
)
def test_texts_that_mean_nothing_are_refused(call: object, text: str) -> None:
    with pytest.raises(UsageError, match="`option`"):
        call(text, "option")  # type: ignore[operator]


def test_a_farthest_distance_before_the_nearest_is_refused() -> None:
    with pytest.raises(UsageError, match="`distance`: the farthest distance must be beyond the nearest, found '5:2'"):
        robacc.plan(arm("irb1600").robot, instrument="2,0,1", distance="5:2")


def test_texts_of_places() -> None:
    side = parse_half_space("3x - 4y <= 500mm", "half_space")
    assert (side.normals, side.offsets) == (pytest.approx(np.array([[0.6, -0.8, 0.0]])), pytest.approx([0.1]))
    box = parse_box("x=-100mm:0.2,z=0.1:", "inside")
    assert box.offsets.tolist() == [0.2, np.inf, np.inf, 0.1, np.inf, -0.1]


FIT = "base_frame,tool_frame,joint_offset,payload_compliance[j2,j3]"
NOISE = 2e-5


def planned(purpose: str = "calibrate", payload: tuple[float, ...] = (0.0, 5.0), **more: object) -> Planned:
    arguments = {"candidates": 150, "noise": f"{NOISE}m", "repeatability": "0mm", **more}
    return robacc.plan(ROBOT, purpose=purpose, payload=payload, **arguments)  # type: ignore[arg-type]


def with_effects(tmp_path: Path, *entries: dict[str, object]) -> Path:
    text = yaml.safe_load(ROBOT.read_text())
    text["effects"] = list(entries)
    return saved(tmp_path / "model.yaml", yaml.safe_dump(text))


@pytest.fixture(scope="module")
def plan() -> Planned:
    return planned(fit=FIT, poses=12)


def test_each_payload_is_mounted_once(plan: Planned) -> None:
    payload = plan.visits.payload
    assert (np.count_nonzero(np.diff(payload)), set(payload.tolist())) == (1, {0.0, 5.0})
    blocks = plan.payload_blocks
    assert [block["payload_kg"] for block in blocks] == [0.0, 5.0]
    assert sum(block["n_poses"] for block in blocks) == 12
    assert sum(block["n_visits"] for block in blocks) == payload.size
    # Every payload has its own drift checks, at its start and at its end.
    roles = plan.route.roles
    for block in blocks:
        last = block["first_visit"] + block["n_visits"] - 2
        assert roles[block["first_visit"] - 1] == roles[last] == "check"


def test_the_poses_are_better_than_random_ones_with_random_payloads(plan: Planned) -> None:
    assert plan.accuracy["planned"]["rms_m"] < 0.95 * plan.accuracy["planned"]["random_rms_m"]


def test_acceptance_gives_every_payload_its_share() -> None:
    plan = planned("acceptance", poses=11, repeats=0, check_every=0)
    assert ([block["n_poses"] for block in plan.payload_blocks], np.unique(plan.visits.q, axis=1).shape[1]) == (
        [6, 5],
        11,
    )
    assert plan.validation is None


def test_a_trace_tests_the_effect_of_the_payload() -> None:
    loaded = planned("trace", poses=14, candidates=60)
    assert any(limit["effect"] == "payload_compliance" for limit in loaded.detectability["limits"])  # type: ignore[union-attr]
    empty = planned("trace", (), poses=14, candidates=60)
    assert "payload_compliance" in empty.detectability["missing"]  # type: ignore[union-attr]


def test_validation_poses_have_payloads() -> None:
    plan = planned(fit=FIT, poses=10, validation=5)
    assert plan.validation.payload.tolist() == [0.0, 0.0, 0.0, 5.0, 5.0]
    assert "payload_kg" in plan.validation_csv()


def test_a_model_whose_effects_need_circumstances_is_planned(tmp_path: Path) -> None:
    path = with_effects(
        tmp_path,
        {"effect": "payload_compliance", "joints": ["j2"], "values": {"j2": 1e-6}},
        {"effect": "backlash", "joints": ["j3"], "values": {"j3": 1e-4}},
        {"effect": "thermal_expansion", "values": {"value": 1e-5}},
    )
    plan = robacc.plan(path, candidates=100, poses=12)
    assert [block["payload_kg"] for block in plan.payload_blocks] == [0.0]


def test_the_simulation_carries_the_planned_payload(plan: Planned, tmp_path: Path) -> None:
    path = tmp_path / "plan.csv"
    plan.write(path)
    simulated = robacc.simulate(ROBOT, at=path, position_only=True).data
    np.testing.assert_array_equal(simulated.payload, plan.visits.payload)
    # A payload that is given replaces the planned one.
    assert set(robacc.simulate(ROBOT, at=path, payload=[3.0]).data.payload.tolist()) == {3.0}  # type: ignore[union-attr]


def test_each_payload_has_its_program(plan: Planned, tmp_path: Path) -> None:
    programs = plan.programs(tmp_path / "plan.src")
    assert [Path(name).name for name in programs] == ["plan_0kg.src", "plan_5kg.src"]
    counts = [text.count("PTP {") for text in programs.values()]
    assert counts == [block["n_visits"] for block in plan.payload_blocks]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--fit", FIT), "payload_compliance needs loads: no payload_kg column; give --payload, such as 0,5"),
        (("--fit", FIT, "--payload", "0"), "payload_kg is zero throughout; give --payload"),
        (("--fit", "base_frame,frame_drift"), "frame_drift cannot be planned"),
        (("--payload", "0,5"), "no effect of --fit depends on the payload, so any pose may have any; add payload"),
        (("--payload", "5,5"), "--payload: expected at most 5 different masses, found 5, 5"),
        (("--payload=-1,2",), "--payload: expected masses of at least 0 kg, found -1"),
        (("--payload", "5kg"), "--payload: expected numbers separated by ',', found '5kg'"),
    ],
)
def test_messages(options: tuple[str, ...], message: str) -> None:
    assert message in refused("plan", ROBOT, "--candidates", "50", *options)


ROBOT_OF_BRANCHES_AT_REST = """robacc: 1
convention: urdf
units: {length: m, angle: deg}
joints:
  - {name: waist, type: revolute, origin: {xyz: [0, 0, 0.6], rpy: [0, 0, 0]}, axis: [0, 1, 0], limits: [-40, 40],
     mass: 14, com: [0.02, 0, 0.25]}
  - {name: pan, type: revolute, origin: {xyz: [0, -0.3, 0.5], rpy: [0, 0, 0]}, axis: [0, 0, 1], limits: [-80, 80],
     mass: 3, com: [0, -0.1, 0]}
  - {name: lift, type: revolute, origin: {xyz: [0, -0.1, 0], rpy: [0, 0, 0]}, axis: [0, 1, 0], limits: [-80, 80],
     mass: 3, com: [0.15, 0, 0.02]}
tool: {xyz: [0.5, 0, 0], rpy: [0, 0, 0]}
branches:
  - {name: other, parent: waist, type: revolute, origin: {xyz: [0, 0.3, 0.5], rpy: [0, 0, 0]}, axis: [0, 1, 0],
     mass: 5, com: [0.25, 0, 0.02], position: 30}
"""
CANDIDATES = "q1_deg,q2_deg,q3_deg,other_deg\n" + "".join(f"{i % 40},{2 * i % 70},{-i % 60},30\n" for i in range(60))


def planned_of_branches_at_rest(folder: Path, candidates: str | None = None) -> Planned:
    (folder / "torso.yaml").write_text(ROBOT_OF_BRANCHES_AT_REST)
    source: Path | int = 60
    if candidates is not None:
        source = saved(folder / "candidates.csv", candidates)
    fit = "tool_frame,joint_compliance[waist]"
    return robacc.plan(folder / "torso.yaml", poses=8, fit=fit, candidates=source, repeats=0, check_every=0)


def test_planned_rows_state_where_the_joints_beside_the_chain_stand(tmp_path: Path) -> None:
    plan = planned_of_branches_at_rest(tmp_path)
    (warning,) = [text for text in plan.warnings if "outside the chain" in text]
    assert "other at 30°" in warning
    plan.write(tmp_path / "plan.csv")
    again = read_robot_poses(tmp_path / "plan.csv", robacc.read_robot(tmp_path / "torso.yaml"), attained=False)
    np.testing.assert_allclose(again.branches, np.radians(30.0), atol=1e-12)


def test_candidates_may_state_the_position_and_nothing_else(tmp_path: Path) -> None:
    assert planned_of_branches_at_rest(tmp_path, CANDIDATES).visits.n == 8
    moved = CANDIDATES.splitlines()
    moved[5] = moved[5].removesuffix("30") + "31"
    with pytest.raises(InputError, match=r"candidates.csv:6, other: found 31°, expected 30°") as caught:
        planned_of_branches_at_rest(tmp_path, "\n".join(moved) + "\n")
    assert "set the position of this joint" in str(caught.value)
