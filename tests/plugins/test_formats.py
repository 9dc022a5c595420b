"""Controllers' formats hold the same arm: forward kinematics of the tests' own agree with those of the model."""

from __future__ import annotations

import dataclasses
import json
import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml
from homogeneous import dh, frame, shift, turn
from scipy.spatial.transform import Rotation

from robacc import Exported, InputError, UsageError, export, import_
from robacc.exporters import remaining_error
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.modelling.model import predict
from robacc.robots.arm import Arm
from robacc.robots.description import Frame, Joint, Mimic, Robot
from robacc.robots.yaml_robot import parse_robot
from robacc_plugins.denavit_hartenberg import dh_table, joint_frames

ROOT = Path(__file__).resolve().parents[2]
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
    path = folder / "file"
    path.write_text(text)
    return import_(path, arm=arm)


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
@pytest.mark.parametrize("is_perturbed", [False, True])
def test_a_dh_table_gives_the_same_poses(path: Path, is_perturbed: bool) -> None:
    robot = perturbed(path) if is_perturbed else parse_robot(path.read_text(encoding="utf-8"), path.name)
    table = dh_table(joint_frames(robot))
    q = samples(robot)
    made = of_frame(robot.base) @ table.base.matrices()
    for row, joint, values in zip(table.rows, robot.variables, q, strict=True):
        is_revolute = joint.type == "revolute"
        made = made @ dh(row.theta + values * is_revolute, row.d + values * (not is_revolute), row.a, row.alpha)
    assert_same(made @ table.tool.matrices() @ of_frame(robot.tool), model_poses(robot, q), 1e-9)


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


def test_json_holds_both_tables() -> None:
    robot = perturbed(ROBOTS[0])
    document = json.loads(export(robot, format="json").text)
    q = samples(robot)

    base, *tools = (
        frame(document[key]["xyz"], document[key]["rpy"]) for key in ("dh_base", "dh_tool", "modified_dh_tool")
    )
    standard = modified = base
    for joint, values in zip(document["joints"], q, strict=True):
        row, other = joint["dh"], joint["modified_dh"]
        standard = standard @ dh(row["theta"] + values, row["d"], row["a"], row["alpha"])
        modified = modified @ turn(0, other["alpha"]) @ shift(other["a"])
        modified = modified @ turn(2, other["theta"] + values) @ shift(z=other["d"])
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
    template = tmp_path / "kinematics.yaml"
    template.write_text("kinematics:\n  shoulder: {}\n  hash: calib_12345\n")
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
