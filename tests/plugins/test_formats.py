"""Files of controllers, ROS, LeRobot and VAL3 hold the same arm, by kinematics and transforms of the tests' own."""

import dataclasses
import json
import re
import shlex
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml
from commands import output
from homogeneous import dh, frame, shift, turn
from sample_files import ROOT, saved
from scipy.spatial.transform import Rotation

import robacc
from robacc import Exported, InputError, Measurements, Robot, UsageError, export, import_
from robacc.exporters import remaining_error
from robacc.geometry import Array
from robacc.modelling.model import predict
from robacc.programs.program import read_program
from robacc.programs.targets import flange_targets, with_targets
from robacc.robots.arm import Arm
from robacc.robots.description import Frame, Joint, Mimic
from robacc.robots.yaml_robot import parse_robot
from robacc_plugins.ros import write_transforms

ROBOTS = sorted((ROOT / "configs" / "robots").glob("*.yaml"))
CONF = Path(__file__).parent / "samples" / "calibration.conf"
MICROMETRE = 1e-6
FORMS = ("urdf", "mdh", "json", "ur-calibration", "ur-kinematics", "xarm", "joint-offsets")

UR10 = {
    "d": (0.1273, 0, 0, 0.163941, 0.1157, 0.0922),
    "a": (0, -0.612, -0.5723, 0, 0, 0),
    "alpha": (np.pi / 2, 0, 0, np.pi / 2, -np.pi / 2, 0),
}
"""The maker's published table."""

UR10E = {
    "d": (0.1807, 0, 0, 0.17415, 0.11985, 0.11655),
    "a": (0, -0.6127, -0.57155, 0, 0, 0),
    "alpha": UR10["alpha"],
}


def of_frame(place: Frame) -> Array:
    return frame(place.xyz, place.rpy)


def perturbed(path: Path, seed: int = 3) -> Robot:
    """A robot with every constant off by about a millimetre and a milliradian, Hayati's among them."""
    robot = parse_robot(path.read_text(encoding="utf-8"), path.name)
    random = np.random.default_rng(seed)
    joints = [
        dataclasses.replace(
            joint,
            parameters={
                name: value + 1e-3 * random.normal() for name, value in {"beta": 0.0, **joint.parameters}.items()
            },
        )
        for joint in robot.joints
    ]
    base = Frame((0.1, -0.2, 0.3), (0.01, 0.02, 0.5))
    return dataclasses.replace(
        robot, joints=tuple(joints), base=base, tool=Frame((0.05, -0.02, 0.2), (0.3, -0.4, 0.5)), effects=(), targets={}
    )


def imported(folder: Path, text: str, arm: str | None = None) -> Robot:
    return import_(saved(folder / "file", text), arm=arm)


def samples(robot: Robot, n: int = 40) -> Array:
    random = np.random.default_rng(5)
    limits = np.array([joint.limits or (-np.pi, np.pi) for joint in robot.variables])
    return limits[:, :1] + (limits[:, 1:] - limits[:, :1]) * random.random((len(limits), n))


def model_poses(robot: Robot, q: Array) -> Array:
    return Arm.of(robot).chain.forward(q).matrices()


def assert_same(first: Array, second: Array, limit: float = MICROMETRE) -> None:
    assert np.max(np.linalg.norm(first[:, :3, 3] - second[:, :3, 3], axis=1)) < limit
    assert np.max(np.abs(first[:, :3, :3] - second[:, :3, :3])) < limit


@pytest.mark.parametrize("path", ROBOTS, ids=lambda path: path.stem)
@pytest.mark.parametrize("form", ["mdh", "json"])
def test_tables_and_json_are_read_back(path: Path, form: str, tmp_path: Path) -> None:
    robot = perturbed(path)
    exported = export(robot, format=form)
    if form == "mdh":
        again = parse_robot(exported.text, "mdh.yaml")
        assert again.convention == "modified"
    else:
        again = imported(tmp_path, exported.text)
    q = samples(robot)
    assert_same(model_poses(again, q), model_poses(robot, q), 1e-9)
    assert exported.remaining.position_max < 1e-9
    assert exported.not_carried == ()


@pytest.mark.parametrize("path", ROBOTS, ids=lambda path: path.stem)
@pytest.mark.parametrize("is_perturbed", [False, True])
def test_json_holds_both_tables(path: Path, is_perturbed: bool) -> None:
    robot = perturbed(path) if is_perturbed else parse_robot(path.read_text(encoding="utf-8"), path.name)
    document = json.loads(export(robot, format="json").text)
    q = samples(robot)

    base, *tools = (
        frame(document[key]["xyz"], document[key]["rpy"]) for key in ("dh_base", "dh_tool", "modified_dh_tool")
    )
    standard = modified = base
    for joint, values in zip(document["joints"], q, strict=True):
        row, other = joint["dh"], joint["modified_dh"]
        angle, way = (0.0, values) if joint["type"] == "prismatic" else (values, 0.0)
        standard = standard @ dh(row["theta"] + angle, row["d"] + way, row["a"], row["alpha"])
        modified = modified @ turn(0, other["alpha"]) @ shift(other["a"])
        modified = modified @ turn(2, other["theta"] + angle) @ shift(z=other["d"] + way)
    for poses, tool in zip((standard, modified), tools, strict=True):
        assert_same(poses @ tool, model_poses(robot, q), 1e-9)


def deltas(text: str) -> dict[str, list[float]]:
    found = re.findall(r"^delta_(\w+) = \[(.*)\]$", text, re.M)
    return {name: [float(part) for part in values.split(",")] for name, values in found}


def ur_poses(text: str, nominal: dict[str, tuple[float, ...]], q: Array) -> Array:
    """What the controller computes at the flange from its nominal table and a calibration file."""
    change = deltas(text)
    pose = np.eye(4)
    for i, values in enumerate(q):
        d, a, alpha = (nominal[name][i] + change[name][i] for name in ("d", "a", "alpha"))
        pose = pose @ dh(values + change["theta"][i], d, a, alpha)
    return pose


def test_ur_calibration_makes_the_controller_compute_the_model() -> None:
    robot = perturbed(ROOT / "configs" / "robots" / "ur10.yaml")
    exported = export(robot, format="ur-calibration")
    assert exported.arm == "ur10"
    change = deltas(exported.text)
    assert change["a"][5] == change["alpha"][5] == 0, "the controller has neither behind the last axis"
    assert max(map(abs, change["d"])) > 0.1, "nearly parallel axes give large offsets, as in the maker's files"
    q = samples(robot)
    attained = of_frame(robot.base) @ ur_poses(exported.text, UR10, q) @ of_frame(exported.tool)
    assert_same(attained, model_poses(robot, q))
    assert exported.remaining.position_max < MICROMETRE


def test_calibration_conf_is_read_and_comes_back() -> None:
    text = CONF.read_text(encoding="ascii")
    robot = import_(CONF, arm="ur10e")
    q = samples(robot)
    poses = ur_poses(text, UR10E, q)
    assert_same(model_poses(robot, q), poses)
    # Its joint frames stand where the nominal arm has them, not hundreds of metres away.
    assert max(abs(joint.parameters[axis]) for joint in robot.joints for axis in "xyz") < 0.7
    again = export(robot, format="ur-calibration", template=CONF).text
    assert_same(ur_poses(again, UR10E, q), poses)
    kept, written = ([line for line in one.splitlines() if not line.startswith("delta_")] for one in (text, again))
    assert written == kept
    with pytest.raises(UsageError, match="does not say which arm it belongs to; name the arm, one of ur3"):
        import_(CONF)


def link_poses(text: str, q: Array) -> Array:
    """What a URDF with the origins of a kinematics file computes at the last joint's frame."""
    links = [value for name, value in yaml.safe_load(text)["kinematics"].items() if name != "hash"]
    pose = np.eye(4)
    for link, values in zip(links, q, strict=True):
        origin = frame((link["x"], link["y"], link["z"]), (link["roll"], link["pitch"], link["yaw"]))
        pose = pose @ origin @ turn(2, values)
    return pose


@pytest.mark.parametrize(("form", "name"), [("ur-kinematics", "ur10"), ("xarm", "panda")])
def test_ros_kinematics_files_hold_the_arm(form: str, name: str, tmp_path: Path) -> None:
    robot = perturbed(ROOT / "configs" / "robots" / f"{name}.yaml")
    exported = export(robot, format=form)
    q = samples(robot)
    attained = of_frame(robot.base) @ link_poses(exported.text, q) @ of_frame(exported.tool)
    assert_same(attained, model_poses(robot, q), 1e-9)
    again = imported(tmp_path, exported.text)
    assert_same(model_poses(again, q), link_poses(exported.text, q), 1e-9)
    assert len(again.joints) == len(robot.joints)


def test_the_hash_of_the_arm_is_kept(tmp_path: Path) -> None:
    robot = perturbed(ROOT / "configs" / "robots" / "ur10.yaml")
    template = saved(tmp_path / "kinematics.yaml", "kinematics:\n  shoulder: {}\n  hash: calib_12345\n")
    text = export(robot, format="ur-kinematics", template=template).text
    assert yaml.safe_load(text)["kinematics"]["hash"] == "calib_12345"


@pytest.mark.parametrize("form", ["urdf", "mdh"])
def test_effects_that_a_format_lacks_are_fitted_not_cut_off(form: str) -> None:
    path = ROOT / "configs" / "robots" / "puma560.yaml"
    rigid = parse_robot(path.read_text(encoding="utf-8"), path.name)
    _, second, third, *_ = rigid.variable_names
    entry = {"effect": "joint_compliance", "joints": [second, third], "values": {second: 2e-5, third: 3e-5}}
    model = dataclasses.replace(rigid, effects=(entry,))
    exported, cut_off = export(model, format=form), remaining_error(model, rigid)
    assert exported.refitted == ("joint_compliance",)
    assert 0 < exported.remaining.position_rms < 0.8 * cut_off.position_rms
    assert exported.remaining.position_max >= exported.remaining.position_rms


def urdf_poses(text: str, q: Array) -> Array:
    """What a URDF computes at the end of its longest chain."""
    root = ElementTree.fromstring(text)
    joints = {joint.find("child").get("link"): joint for joint in root.iter("joint")}  # type: ignore[union-attr]
    parents = {joint.find("parent").get("link") for joint in joints.values()}  # type: ignore[union-attr]
    chains = []
    for link in set(joints) - parents:
        chain = []
        while link in joints:
            chain.append(joints[link])
            link = joints[link].find("parent").get("link")  # type: ignore[union-attr]
        chains.append(chain[::-1])
    pose, remaining = np.eye(4), list(q)
    for joint in max(chains, key=len):
        origin = joint.find("origin")
        numbers = {} if origin is None else origin.attrib
        pose = pose @ frame(*([float(v) for v in numbers.get(key, "0 0 0").split()] for key in ("xyz", "rpy")))
        if joint.get("type") != "fixed":
            axis = np.array([float(v) for v in joint.find("axis").get("xyz").split()])  # type: ignore[union-attr]
            turned = np.tile(np.eye(4), (q.shape[1], 1, 1))
            turned[:, :3, :3] = Rotation.from_rotvec(np.outer(remaining.pop(0), axis)).as_matrix()
            pose = pose @ turned
    return pose


def written_poses(folder: Path, exported: Exported, nominal: Robot, model: Robot, q: Array) -> Array:
    """What the written file computes, with the base of the model and the tool that the export names."""
    base, tool, form = of_frame(model.base), of_frame(exported.tool), exported.format
    if form == "urdf":
        return urdf_poses(exported.text, q)
    if form == "mdh":
        return model_poses(parse_robot(exported.text, "mdh.yaml"), q)
    if form == "json":
        return model_poses(imported(folder, exported.text), q)
    if form == "ur-calibration":
        return base @ ur_poses(exported.text, UR10, q) @ tool
    if form == "joint-offsets":
        rows = [line.split(",") for line in exported.text.splitlines() if not line.startswith("#")][1:]
        shifted = q + np.radians([float(row[1]) for row in rows])[:, None]
        controller = exported.controller
        return model_poses(dataclasses.replace(nominal, base=controller.base, tool=controller.tool), shifted)
    return base @ link_poses(exported.text, q) @ tool


@pytest.mark.parametrize("form", FORMS)
def test_each_file_holds_the_restricted_fit_of_an_elastic_arm(form: str, tmp_path: Path) -> None:
    path = ROOT / "configs" / "robots" / "ur10.yaml"
    nominal = parse_robot(path.read_text(encoding="utf-8"), path.name)
    nominal = dataclasses.replace(nominal, effects=(), targets={})
    rigid = perturbed(path)
    names = rigid.variable_names[1:3]
    entry = {"effect": "joint_compliance", "joints": list(names), "values": dict(zip(names, (2e-5, 3e-5), strict=True))}
    model = dataclasses.replace(rigid, effects=(entry,))
    exported = export(model, format=form, nominal=nominal if form == "joint-offsets" else None)
    q = samples(model)
    assert_same(written_poses(tmp_path, exported, nominal, model, q), model_poses(exported.controller, q))
    # What the format lacks is stated, with the error that it leaves.
    assert exported.not_carried[0] == "effect joint_compliance"
    assert ("link geometry" in exported.not_carried) == (form == "joint-offsets")
    elastic = predict(model, Measurements(np.zeros((3, q.shape[1])), q=q)).translation.T
    left = np.linalg.norm(model_poses(exported.controller, q)[:, :3, 3] - elastic, axis=1)
    # 40 other poses than the thousand of the figure.
    assert np.sqrt(np.mean(left**2)) == pytest.approx(exported.remaining.position_rms, rel=0.5)
    assert exported.remaining.position_rms > 1e-6


def test_joint_offsets_are_those_of_the_model() -> None:
    path = ROOT / "configs" / "robots" / "ur10.yaml"
    nominal = parse_robot(path.read_text(encoding="utf-8"), path.name)
    offsets = np.array([1.0, -2.0, 3.0, -0.5, 0.25, 1.5]) * 1e-3
    joints = [
        dataclasses.replace(joint, parameters={**joint.parameters, "theta": joint.parameters["theta"] + offset})
        for joint, offset in zip(nominal.joints, offsets, strict=True)
    ]
    model = dataclasses.replace(nominal, joints=tuple(joints), tool=Frame((0.1, 0.0, 0.1)))
    exported = export(model, format="joint-offsets", nominal=nominal)
    rows = [line.split(",") for line in exported.text.splitlines() if not line.startswith("#")][1:]
    np.testing.assert_allclose([float(row[1]) for row in rows], np.degrees(offsets), atol=1e-6)
    assert exported.remaining.position_max < MICROMETRE
    off_table = export(perturbed(path), format="joint-offsets", nominal=nominal)
    assert off_table.remaining.position_rms > 1e-4, "link lengths cannot be mastered away"


def test_arms_that_do_not_fit_a_format_are_refused() -> None:
    puma, scara = (perturbed(ROOT / "configs" / "robots" / f"{name}.yaml") for name in ("puma560", "scara"))
    follower = Joint("follower", "revolute", dict(puma.joints[0].parameters), mimic=Mimic(puma.joints[0].name))
    for robot, form, message in (
        (puma, "ur-calibration", "arms of Universal Robots"),
        (scara, "xarm", "revolute joints only"),
        (puma, "joint-offsets", "needs the nominal model"),
        (dataclasses.replace(puma, joints=(*puma.joints, follower)), "json", "follower follows other joints"),
    ):
        with pytest.raises(UsageError, match=message):
            export(robot, format=form)


@pytest.mark.parametrize(
    ("text", "arm", "message"),
    [
        ("delta_theta = [ 0, 0, 0, 0, 0]\n", "ur5", ":1: delta_theta needs six numbers"),
        ("delta_theta = [ 0, 0, 0, 0, 0, 0]\n", "ur5", "delta_a, delta_d, delta_alpha is missing"),
        ("kinematics:\n  joint1: {x: 0, y: 0}\n", None, r":2, kinematics.joint1.z: is missing"),
        ("kinematics:\n  arm: {x: 0, y: 0, z: 0, roll: 0, pitch: 0, yaw: 0}\n", None, "the joints are arm"),
        ("kinematics: 1\n", None, "has no key kinematics"),
        ("robot: 1\n", None, "is no kinematics file; give a calibration.conf of Universal Robots"),
        ("{}", None, "is no kinematics file"),
        ('{"schema": "robacc.kinematics/1",', None, "is not JSON"),
        ('{"schema": "robacc.kinematics/2"}', None, "is not a kinematics file of robacc"),
        ('{"schema": "robacc.kinematics/1", "joints": [{}]}', None, r"joints\[0\].origin: is missing"),
    ],
)
def test_bad_files_are_refused(text: str, arm: str | None, message: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=message):
        imported(tmp_path, text, arm)


def test_a_file_with_all_lengths_needs_no_name_of_an_arm(tmp_path: Path) -> None:
    text = export(perturbed(ROBOTS[0]), format="json").text
    with pytest.raises(UsageError, match=r"only a calibration\.conf needs the name of its arm; .*file has all lengths"):
        imported(tmp_path, text, "ur5")


DIGITS = 1e-8
"""The commands have nine decimals."""


def transforms(text: str) -> dict[tuple[str, str], Array]:
    """What the commands publish: the child's frame in the parent's."""
    found = {}
    for line in text.splitlines()[1:]:
        words = shlex.split(line)
        assert words[:4] == ["ros2", "run", "tf2_ros", "static_transform_publisher"]
        options = dict(zip(words[4::2], words[5::2], strict=True))
        pose = np.eye(4)
        pose[:3, :3] = Rotation.from_quat([float(options[f"--q{axis}"]) for axis in "xyzw"]).as_matrix()
        pose[:3, 3] = [float(options[f"--{axis}"]) for axis in "xyz"]
        found[options["--frame-id"], options["--child-frame-id"]] = pose
    return found


def test_base_and_tool_stand_where_the_model_has_them() -> None:
    base, tool = Frame((0.1, -0.2, 0.3), (0.01, 0.02, 2.5)), Frame((0.05, -0.02, 0.2), (0.3, -0.4, 3.0))
    robot = dataclasses.replace(robacc.read_robot("so101"), base=base, tool=tool)
    result = robacc.export(robot, format="static-transform")
    found = transforms(result.text)
    assert [*found] == [("measuring_frame", "base_link"), ("flange", "tool0")]
    for pose, place in zip(found.values(), (base, tool), strict=True):
        np.testing.assert_allclose(pose, frame(place.xyz, place.rpy), atol=DIGITS)
    assert result.not_carried == ("joint zeros and link geometry, which the format urdf has",)


def test_links_and_targets_have_their_names() -> None:
    targets = {"ball; left": Frame((0.1, 0.0, 0.0)), "right": Frame((-0.1, 0.0, 0.0))}
    robot = dataclasses.replace(
        robacc.read_robot("so101"), name="arm\nof 1", base_link="base", tip_link="wrist", targets=targets
    )
    found = transforms(robacc.export(robot, format="static-transform").text)
    assert [*found] == [("measuring_frame", "base"), ("wrist", "ball; left"), ("wrist", "right")]
    np.testing.assert_allclose(found["wrist", "ball; left"], frame((0.1, 0.0, 0.0), (0.0, 0.0, 0.0)), atol=DIGITS)


def test_a_camera_beside_the_arm_is_the_measuring_frame(tmp_path: Path) -> None:
    model, sample = tmp_path / "model.yaml", ROOT / "sample_data" / "lerobot"
    fitted = ("--camera", sample / "camera.yaml", "--fit", "base_frame,tool_frame,joint_offset")
    output("calibrate", sample / "points.csv", "--robot", "so101", *fitted, "--write-model", model)
    found = transforms(robacc.export(model, format="static-transform").text)
    assert [*found] == [("camera_optical_frame", "base_link"), ("flange", "board")]
    # The sample was made with the camera at this place in the base.
    at = np.linalg.inv(found["camera_optical_frame", "base_link"])[:3, 3]
    np.testing.assert_allclose(at, (0.1151, -0.0935, 0.3141), atol=1e-3)


@pytest.mark.parametrize(
    ("seen", "frames"),
    [
        (("board",), [("board", "base_link"), ("flange", "camera_optical_frame")]),
        (("left", "right"), [("measuring_frame", "base_link"), ("flange", "tool0")]),
    ],
)
def test_the_board_of_one_camera_on_the_hand_is_the_measuring_frame(
    seen: tuple[str, ...], frames: list[tuple[str, str]]
) -> None:
    coefficients = [f"base_frame.{name}.x" for name in seen]
    robot = dataclasses.replace(robacc.read_robot("so101"), fit={"coefficients": coefficients})
    assert [*transforms(write_transforms(robot).text)] == frames


NAMES = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll")
RANGES = ((750, 3420), (893, 3207), (850, 3078), (817, 3190), (0, 4095), (2010, 3500))
HOMING = (101, -1208, 1502, -1997, 33, 1240)
OFFSETS = np.array([1.2, -0.9, 0.7, -3.04, 0.4])
"""Degrees by which LeRobot's angles are short."""
QUARTER_OF_A_COUNT = 360 / 4095 / 4


def calibration(names: tuple[str, ...] = (*NAMES, "gripper")) -> dict[str, dict[str, int]]:
    return {
        name: {"id": i + 1, "drive_mode": 0, "homing_offset": homing, "range_min": ends[0], "range_max": ends[1]}
        for i, (name, ends, homing) in enumerate(zip(names, RANGES, HOMING, strict=True))
    }


def degrees(motor: dict[str, int], encoder: float, make: str) -> float:
    """What LeRobot reports for a position of the motor's encoder, counts."""
    present = encoder + {"Feetech": -1, "Dynamixel": 1}[make] * motor["homing_offset"]
    return (present - (motor["range_min"] + motor["range_max"]) / 2) * 360 / 4095


def arms(sign: int = 1) -> tuple[Robot, Robot]:
    """The arm as it was believed to be, and with its true zeros."""
    nominal = robacc.read_robot("so101")
    nominal = dataclasses.replace(
        nominal, joints=(dataclasses.replace(nominal.joints[0], sign=sign), *nominal.joints[1:])
    )
    joints = [
        dataclasses.replace(
            joint, parameters={**joint.parameters, "theta": joint.parameters["theta"] + joint.sign * np.radians(offset)}
        )
        for joint, offset in zip(nominal.joints, OFFSETS, strict=True)
    ]
    return nominal, dataclasses.replace(nominal, joints=tuple(joints))


def exported(folder: Path, before: Any, nominal: Robot, model: Robot) -> robacc.Exported:
    path = saved(folder / "calibration.json", before if isinstance(before, str) else json.dumps(before))
    return robacc.export(model, format="lerobot", nominal=nominal, template=path)


@pytest.mark.parametrize("make", ["Feetech", "Dynamixel"])
@pytest.mark.parametrize("sign", [1, -1])
def test_the_corrected_file_reports_the_true_angles(make: str, sign: int, tmp_path: Path) -> None:
    before, (nominal, model) = calibration(), arms(sign)
    result = exported(tmp_path, before, nominal, model)
    after = json.loads(result.text)
    encoder = np.random.default_rng(2).uniform(0, 4096, 5)
    reported, corrected = (
        np.array([degrees(motors[name], at, make) for name, at in zip(NAMES, encoder, strict=True)])
        for motors in (before, after)
    )
    assert np.max(np.abs(corrected - reported - OFFSETS)) <= QUARTER_OF_A_COUNT + 1e-9
    # The nominal arm at the corrected angles is the calibrated arm at the angles that were reported.
    poses = (
        Arm.of(arm).chain.forward(np.radians(angles)[:, None]).matrices()[0]
        for arm, angles in ((nominal, corrected), (result.controller, reported), (model, reported))
    )
    attained, stated, true = poses
    np.testing.assert_allclose(attained, stated, atol=1e-12)
    # Five joints, each a quarter of a count off, on an arm of 0.5 m.
    assert np.linalg.norm(attained[:3, 3] - true[:3, 3]) < 5 * np.radians(QUARTER_OF_A_COUNT) * 0.5


def test_only_the_ranges_change_and_stay_within_the_recorded_ones(tmp_path: Path) -> None:
    before = calibration()
    result = exported(tmp_path, before, *arms())
    after = json.loads(result.text)
    assert after["gripper"] == before["gripper"]
    for name, offset in zip(NAMES, OFFSETS, strict=True):
        old, new = before[name], after[name]
        assert {key: new[key] for key in ("id", "drive_mode", "homing_offset")} == {
            key: old[key] for key in ("id", "drive_mode", "homing_offset")
        }
        cut = old["range_max"] - new["range_max"] if offset > 0 else new["range_min"] - old["range_min"]
        assert cut == round(2 * abs(offset) * 4095 / 360)
        assert (new["range_min"] == old["range_min"]) == (offset > 0)
    assert result.not_carried == (
        "link geometry",
        "zeros between counts: up to 0.021°",
        "range: up to 6.1° at one end of a joint",
    )
    assert 0 < result.remaining.orientation_rms < np.radians(2 * QUARTER_OF_A_COUNT)


def test_joints_of_other_names_have_their_motors_in_order(tmp_path: Path) -> None:
    nominal, model = arms()
    renamed = [
        dataclasses.replace(
            arm, joints=tuple(dataclasses.replace(joint, name=f"joint_{i}") for i, joint in enumerate(arm.joints))
        )
        for arm in (nominal, model)
    ]
    before = calibration()
    shuffled = dict(reversed(before.items()))
    assert json.loads(exported(tmp_path, shuffled, *renamed).text) == json.loads(
        exported(tmp_path, before, nominal, model).text
    )


def changed(**values: object) -> str:
    before: Any = calibration()
    before["elbow_flex"] |= values
    return json.dumps(before)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "`template` is not JSON: line 1"),
        ("[]", "is no calibration of LeRobot: expected motors, each with drive_mode, homing_offset, id"),
        ('{"homing_offset": [0, 0], "motor_names": ["a", "b"]}', "calibrate an arm of LeRobot before 0.2 again"),
        (changed(range_min=0.5), "is no calibration of LeRobot"),
        (changed(range_min=-90), "the range of elbow_flex begins at -90; a motor with counts begins at 0 or above"),
        (changed(range_min=3100), "the range of elbow_flex is from 3100 to 3078"),
        (changed(range_min=3070), r"elbow_flex is 0\.7° off, more than its range in `template` allows"),
        (json.dumps(calibration(tuple("abcdef"))).replace('"id": 3', '"id": 4'), "are not those of the model"),
    ],
)
def test_other_files_are_refused(text: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=message):
        exported(tmp_path, text, *arms())


def test_both_files_are_needed() -> None:
    nominal, model = arms()
    with pytest.raises(UsageError, match=r"the format lerobot needs `nominal`, .*, and `template`"):
        robacc.export(model, format="lerobot", nominal=nominal)


SAMPLES = Path(__file__).parents[1] / "programs" / "samples" / "val3"


def transform(x: float, y: float, z: float, rx: float, ry: float, rz: float) -> np.ndarray:
    """The matrix of mm and degrees about moving axes, in mm."""
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_euler("XYZ", (rx, ry, rz), degrees=True).as_matrix()
    matrix[:3, 3] = x, y, z
    return matrix


def test_points_lead_through_nested_frames_and_tools_to_the_flange() -> None:
    program = read_program(SAMPLES / "cell.dtx")
    numbers, flange, _ = flange_targets(program)
    places = {program.targets[number].name: k for k, number in enumerate(numbers)}
    table = transform(362.042, -49.91, -265.9, 0, 0, 90)
    gripper = transform(0, 5, 180, 0, 45, 0)
    pick = transform(169.837325, -700.0334453, 372.398311, -179.999244, -0.000734286, 88.845311)
    expected = {
        "pPick[0]": table @ pick @ np.linalg.inv(gripper @ transform(0, 0, 20, 0, 0, 0)),
        "pPick[1]": table @ transform(10, 20, 30, 10, -20, 30) @ transform(100.5, 20, 0.25, 170, -30, 45)
        @ np.linalg.inv(gripper),
    }  # fmt: skip
    assert set(places) == set(expected)
    for name, matrix in expected.items():
        k = places[name]
        np.testing.assert_allclose(flange.translation[:, k], 1e-3 * matrix[:3, 3], atol=1e-12)
        np.testing.assert_allclose(flange.rotation[..., k], matrix[:3, :3], atol=1e-12)


def test_angles_stay_near_those_of_the_program() -> None:
    program = read_program(SAMPLES / "crlf.dtx")
    x, y, z, *quaternion = program.targets[0].values
    turned = Rotation.from_euler("XYZ", (-179.9, 0.05, 0.02), degrees=True).as_quat()
    assert quaternion == pytest.approx([0, 1, 0, 0], abs=1e-15)
    text = with_targets(program, [(x, y, z, turned[3], *turned[:3]), None]).decode()
    assert 'rx="180.10000" ry="0.05000" rz="0.02000"' in text or 'rx="-179.90000" ry="0.05000" rz="0.02000"' in text
    assert text.count("\r\n") == text.count("\n")


CELL = (SAMPLES / "cell.dtx").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("cut.dtx", CELL[: CELL.index("</Datas>")], "is truncated: it has no </Database>"),
        ("other.dtx", "<Database><Datas/></Database>", "is not a VAL3 data file"),
        ("main.pgx", (SAMPLES / "main.pgx").read_text(encoding="utf-8"), r"give the \.dtx file beside it"),
        ("inch.dtx", CELL, "belongs to a project in inches"),
    ],
)
def test_files_that_cannot_be_read_get_one_message(name: str, text: str, message: str, tmp_path: Path) -> None:
    if name == "inch.dtx":
        saved(tmp_path / "app.pjx", '<Project><Parameters millimeterUnit="false" /></Project>')
    with pytest.raises(InputError, match=message):
        read_program(saved(tmp_path / name, text))


def test_a_table_whose_last_row_has_lengths_is_of_craigs_form(tmp_path: Path) -> None:
    text = "alpha, a, d, theta\n0, 0, 285, 0\n-90, 0, 0, -90\n180, 760, 0, -90\n-90, 0, 540, 0\n"
    path = saved(tmp_path / "dh.csv", text)
    robot = robacc.read_robot(path)
    assert (robot, robot.convention) == (import_(path), "modified")
    assert [joint.parameters["a"] for joint in robot.joints] == [0.0, 0.0, 0.76, 0.0]


# A Stanford arm's first axes: theta, d, a, alpha, whether the joint slides, its sign. Each text has exactly these rows.
_ROWS = (
    (0.0, 0.4, 0.0, -np.pi / 2, False, 1),
    (-np.pi / 2, 0.15, 0.2, np.pi / 2, False, 1),
    (0.0, 0.0, 0.0, 0.0, True, 1),
)
_TURNING = (*_ROWS[:2], (*_ROWS[2][:4], False, 1))
_TURNED = (*_ROWS[:1], (*_ROWS[1][:5], -1), (*_ROWS[2][:4], False, 1))
_LISTING = """arm:: 3 axis, RRP, {form}, slowRNE
+---+-----------+-----------+-----------+-----------+-----------+
| j |     theta |         d |         a |     alpha |    offset |
+---+-----------+-----------+-----------+-----------+-----------+
|  1|         q1|        0.4|          0|      -pi/2|          0|
|  2|         q2|       0.15|        0.2|       pi/2|      -pi/2|
|  3|          0|         q3|          0|          0|          0|
+---+-----------+-----------+-----------+-----------+-----------+
grav =    0  base = 1  0  0  0
"""
SAME_ARM = {
    "joint type": (
        "theta,d,a,alpha,joint_type\n0,0.4,0,-90,revolute\n-90,0.15,0.2,90,revolute\n0,0,0,0,prismatic\n",
        _ROWS,
    ),
    "sigma": ("sigma,theta,d,a,alpha\n0,0,0.4,0,-90\n0,-90,0.15,0.2,90\n1,0,0,0,0\n", _ROWS),
    "variable in d": ("theta,d,a,alpha\nq1,400,0,-90\nq2 - 90,150,200,90\n0,q3,0,0\n", _ROWS),
    "units": ("theta_deg;d_mm;a_mm;alpha_deg\nq1;400;0;-90\nq2 - 90;150;200;90\n0 + q3;0;0;0\n", _TURNING),
    "rad": (
        "theta,d (m),a,alpha\n0,0.4,0,-1.5707963267949\n-1.5707963267949,0.15,0.2,1.5707963267949\n0,0,0,0\n",
        _TURNING,
    ),
    "letters": (
        "Joint\tType\tθ\td\ta\tα\n1\tR\t0\t0.4\t0\t-90\n2\tR\t-90\t0.15\t0.2\t90\n3\tP\t0\t0\t0\t0\n",
        _ROWS,
    ),
    # A program's own listing: blanks below a head of tabs, and the joint's offset in place of its angle.
    "offset": ("joint\t a\t d\t alpha\t offset\nS1 0.0 0.4 -90 0.0\nL1 0.2 0.15 90 -90\nT1 0 0 0 0\n", _TURNING),
    "listing": (_LISTING.format(form="stdDH"), _ROWS),
    "comment": ("".join(f"% {line}\n" for line in _LISTING.format(form="").splitlines()), _ROWS),
    "drawn": (
        "┌──┐\n│ θⱼ │ dⱼ │ aⱼ │ ⍺ⱼ │\n├──┤\n│ q1 │ 0.4 │ 0 │ -90.0° │\n│ q2 - 90.0° │ 0.15 │ 0.2 │ 90.0° │\n"
        "│ 0.0° │ q3 │ 0 │ 0.0° │\n└──┘\n",
        _ROWS,
    ),
    "sign": ("joint,theta,d,a,alpha,sign\n1,0,0.4,0,-90,1\n2,-90,0.15,0.2,90,-1\n3,0,0,0,0,1\n,,,,,\n", _TURNED),
    "offset first": (
        "theta_offset,theta,d,a,alpha,direction\n0,q1,0.4,0,-90,1\n,q2-90,0.15,0.2,90,-1\n0,q3,0,0,0,1\n",
        _TURNED,
    ),
    "TeX": (
        "| j | $\\theta_i$ | d<sub>i</sub> | a | \\alpha |\n|--|--|\n|1| \\theta_1 | 0.4 | 0 | -90 |\n"
        "|2| \\theta_2 - 90 | 0.15 | 0.2 | 90 |\n|3| 0 | d_3 | 0 | 0 |\n",
        _ROWS,
    ),
    "limits": (
        "name,min_theta,max_theta,theta,d (cm),a (cm),alpha,sign\n"
        "A,-170,170,0,40,0,-90,1\nB,-90,90,-90,15,20,90,-1\nC,-9,9,0,0,0,0,1\n",
        _TURNED,
    ),
}


@pytest.mark.parametrize("name", SAME_ARM)
@pytest.mark.parametrize("is_modified", [False, True])
def test_a_table_has_the_same_arm_in_every_form(tmp_path: Path, name: str, is_modified: bool) -> None:
    """By the products of the rows' own matrices."""
    text, rows = SAME_ARM[name]
    if is_modified:
        text = re.sub("alpha(_deg)?|α|⍺ⱼ", r"\g<0>(i-1)", text.replace("stdDH", "modDH"))
    robot = robacc.read_robot(saved(tmp_path / "dh.txt", text))
    assert robot.convention == ("modified" if is_modified else "standard")
    q, pose = (0.3, -0.4, 0.25), np.eye(4)
    for value, (theta, d, a, alpha, slides, sign) in zip(q, rows, strict=True):
        theta, d = (theta, d + value) if slides else (theta + sign * value, d)
        steps = [turn(2, theta), shift(0, 0, d), shift(a, 0, 0), turn(0, alpha)]
        for step in [steps[3], steps[2], steps[0], steps[1]] if is_modified else steps:
            pose = pose @ step
    found = Arm.of(robot).chain.forward(np.array(q)[:, None])
    np.testing.assert_allclose(found.translation[:, 0], pose[:3, 3], atol=1e-12)
    np.testing.assert_allclose(found.rotation[..., 0], pose[:3, :3], atol=1e-12)


def test_a_table_keeps_the_rotation_about_y(tmp_path: Path) -> None:
    text = "theta,d,a,alpha,beta\n0,0.4,0.1,-90,0\n0,0,0.5,0,0.5\n0,0,0.3,0,-0.2\n0,0.1,0,0,\n"
    robot = robacc.read_robot(saved(tmp_path / "dh.csv", text))
    assert [joint.parameters["beta"] for joint in robot.joints] == pytest.approx(np.radians([0.0, 0.5, -0.2, 0.0]))


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ("\n0,0.3,0,0\n0,0.2,0,0\n", "does not tell whether the table is standard or modified"),
        ("\n0,0.3,0,0\n0,x2,0.2,1.57\n", "dh.csv:3: found 'x2' in place of a number"),
        ("\n", "has a head and no rows"),
        (",type,offset\n0,0.3,0,0,P,0.1\n0,0.2,0.2,1.57,R,0\n", "has an offset of a linear joint"),
        (",offset\nq1,0.3,0,0,0\nq2-1.5,0.2,0.2,1.57,-1.5\n", "with an angle in theta, which may or may not have it"),
        (
            ",coupling\n0,0.3,0,0,0\n0,0.2,0.2,1.57,1\n",
            "the column 'coupling' may change the arm in a way that robacc does",
        ),
        (",α\n0,0.3,0,0,0\n0,0.2,0.2,1.57,1\n", "two columns say alpha"),
        (
            ",offset,sign\nq1,0.3,0,0,0,1\nq2,0.2,0.2,1.57,-1.5,-1\n",
            "has a sign other than 1 and -1, or one of -1 beside",
        ),
        (",type\n0,0.3,0,0,R\n0,0.2,0.2,1.57,fixed\n", "dh.csv:3: is neither revolute nor prismatic"),
        ("\nq1,d1,0,0\nq2,0.2,0.2,1.57\n", "dh.csv:2: has a symbol in place of a number in d or theta"),
        ("\n0,d1,0,0\n0,d2,0.2,1.57\n", "dh.csv:2: has a symbol in place of a number in d or theta"),
        ("\nq1,0.3,0,0\nq2,0.2,0.2,1.57\n0,0.1,0,0\n", "dh.csv:4: has no variable, unlike other rows"),
        ("\n0,0.3,0,0\n0,0.2,,1.57\n", "dh.csv:3: found '' in place of a number"),
        (
            "\n-90,0.3,0,1.5708\n0,0.2,0.2,0\n",
            "alpha is in quarter turns of rad, but another angle is too large for rad",
        ),
        ("\n0,1.5708,445,209\n0,0,0,780\n", "alpha is more than a turn"),
        ("\n0,pi/2,0.2,90°\n0,0.3,0,pi/2\n", "alpha has several units"),
        ("\n0,14,0,1.57\n0,0,10.5,0\n0,0,10.5,0\n", "does not tell the unit of the lengths: in m they sum to 35 m"),
        ("\n0,30,0,90\n0,0,25,0\n0,0,20,0\n", "does not tell the unit of the lengths: in mm they sum to 0.075 m"),
    ],
)
def test_a_table_that_leaves_a_question_is_refused(tmp_path: Path, rows: str, said: str) -> None:
    with pytest.raises(InputError, match=re.escape(said)):
        robacc.read_robot(saved(tmp_path / "dh.csv", f"theta,d,a,alpha{rows}"))
