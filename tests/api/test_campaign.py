"""What a model remembers of its campaign, targets and programs that it corrects, and warnings of results."""

import csv
import dataclasses
import hashlib
import io
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from arms import arm
from commands import document, output
from independent_arm import TOOL, robot, run, target
from refusals import problems_of
from sample_files import POSES as CLEAN, PUMA, ROBOT as NOMINAL, ROOT, TRACED_ROBOT, TRUTH, saved
from scipy.spatial.transform import Rotation

import robacc
from robacc import InputError, Measurements, Robot, correct, read_robot
from robacc.api.correct import CorrectedProgram, correct_program
from robacc.effects.specification import with_effect_units
from robacc.errors import MissingColumnError
from robacc.geometry import Poses
from robacc.poses.csv_file import format_poses
from robacc.programs.program import ConfigurationRules, read_program
from robacc.programs.targets import (
    allowed_by_window,
    flange_targets,
    joint_window,
    leaves_configuration,
    turned_into,
)
from robacc.robots.arm import Arm, inverse_kinematics
from robacc.robots.description import Frame
from robacc.robots.yaml_robot import parse_robot, robot_to_yaml
from robacc_plugins import fanuc, krl, rapid, urscript

# Facts of one campaign: part of the prediction of its own poses, not inherited by other poses.
DRIFT = {
    "effect": "frame_drift",
    "origin_s": 600,
    "span_s": 600,
    "degree": 1,
    "turning": False,
    "values": {"x": 1e-3, "z": -5e-4},
}

BASE = Frame((0.3, -0.2, 0.1), (0.0, 0.0, 0.02))


def measured(robot: Robot, n: int, seed: int) -> robacc.Measurements:
    plan = {"time_step": 1200 / n, "noise": 2e-5, "noise_orientation": 2e-5}
    return robacc.simulate(robot, poses=n, seed=seed, sampling="random", **plan).data


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the poses of a campaign, held-out poses, another day's poses, and the model of the campaign."""
    moved = dataclasses.replace(arm("puma560").robot, base=BASE)
    drifting = dataclasses.replace(moved, effects=(DRIFT,))
    poses = {"poses": (drifting, 120, 1), "held_out": (drifting, 60, 2), "another_day": (moved, 60, 3)}
    folder = written(tmp_path_factory.mktemp("campaign"), **poses)
    (folder / "untimed.csv").write_text(format_poses(dataclasses.replace(measured(moved, 60, 4), time=None)))
    fitted = robacc.calibrate(
        folder / "poses.csv", robot=folder / "nominal.yaml", fit="base_frame,tool_frame,frame_drift", folds=2
    )
    fitted.write_model(folder / "model.yaml")
    (folder / "rms").write_text(repr(fitted.after.fitted.position.rms))
    return folder


def written(folder: Path, **arms: tuple[Robot, int, int]) -> Path:
    """A folder with the nominal arm and with poses of arms, each with their number and seed."""
    (folder / "nominal.yaml").write_text(robot_to_yaml(arm("puma560").robot))
    for name, made in arms.items():
        (folder / f"{name}.csv").write_text(format_poses(measured(*made)))
    return folder


def said(result: robacc.Result, *parts: str) -> bool:
    """Whether a warning has all the parts."""
    return any(all(part in text for part in parts) for text in result.warnings)


def estimated(folder: Path, poses: str, **more: str) -> robacc.Result:
    return robacc.estimate(folder / f"{poses}.csv", robot=folder / "model.yaml", **more)


def rms(folder: Path, poses: str, **more: str) -> float:
    return estimated(folder, poses, **more).position.rms


def test_held_out_poses_of_the_campaign_are_recognised_by_their_errors(campaign: Path) -> None:
    result = estimated(campaign, "held_out")
    assert result.position.rms < 1.2 * float((campaign / "rms").read_text())
    assert said(result, "they are applied because they change the position error")
    assert rms(campaign, "held_out", campaign="keep") == result.position.rms


@pytest.mark.parametrize(
    ("poses", "parts"),
    [("another_day", ("frame_drift", "left out")), ("untimed", ("needs the column time_s", "left out"))],
)
def test_another_day_does_not_inherit_the_drift(campaign: Path, poses: str, parts: tuple[str, ...]) -> None:
    result = estimated(campaign, poses)
    assert (result.position.rms < 1e-4, said(result, *parts)) == (True, True)


def test_what_keeping_the_campaign_costs_other_poses(campaign: Path) -> None:
    assert rms(campaign, "another_day", campaign="keep") > 3e-4
    with pytest.raises(MissingColumnError):
        rms(campaign, "untimed", campaign="keep")


def test_drift_and_frames_stand_in_the_campaign_of_the_model(campaign: Path) -> None:
    document = yaml.safe_load((campaign / "model.yaml").read_text())
    assert "effects" not in document
    part = document["campaign"]
    assert (part["poses"], [effect["effect"] for effect in part["effects"]]) == (document["fitted_to"], ["frame_drift"])
    assert part["effects"][0]["validity"]["time_s"] == pytest.approx([0, 1190], abs=1)
    assert part["before"]["base"]["xyz"] == [0.0, 0.0, 0.0]
    robot = read_robot(campaign / "model.yaml")
    assert robot.base.xyz == pytest.approx(BASE.xyz, abs=1e-4)
    assert parse_robot(robot_to_yaml(robot), "again.yaml") == robot


def test_the_poses_of_the_campaign_get_the_fitted_prediction(campaign: Path) -> None:
    result = robacc.estimate(campaign / "poses.csv", robot=campaign / "model.yaml")
    assert result.position.rms == pytest.approx(float((campaign / "rms").read_text()), rel=1e-9)
    assert not said(result, "campaign")
    again = robacc.calibrate(campaign / "poses.csv", robot=campaign / "model.yaml", fit="base_frame", folds=2)
    # The noise beside base and tool alone is a little larger than beside the drift too, and so position and orientation
    # weigh a little differently when both are registered again.
    assert again.nominal.fitted.position.rms == pytest.approx(result.position.rms, rel=1e-4)
    assert [effect["effect"] for effect in again.robot.campaign.effects] == ["frame_drift"]
    assert again.robot.campaign.base == Frame()
    traced = robacc.trace(campaign / "poses.csv", robot=campaign / "model.yaml", folds=2)
    assert traced.nominal.fitted.position.rms <= result.position.rms * 1.01
    assert not traced.findings


def test_drop_restores_the_frames_before_the_campaign(campaign: Path) -> None:
    aligned = rms(campaign, "another_day", campaign="drop", align="base_frame,tool_frame")
    assert aligned < 1e-4
    raw = rms(campaign, "another_day", campaign="drop", align="none")
    assert raw == pytest.approx(np.linalg.norm(BASE.xyz), rel=0.2)
    # Frames that do not agree are registered without being asked.
    assert rms(campaign, "another_day", campaign="drop") == aligned


def test_simulation_leaves_the_campaign_out_and_says_so(campaign: Path) -> None:
    result = robacc.simulate(campaign / "model.yaml", poses=5)
    assert said(result, "frame_drift", "left out")
    kept = robacc.simulate(campaign / "model.yaml", poses=5, time_step=200, campaign="keep")
    assert np.abs(kept.data.position - result.data.position).max() > 1e-4


def test_a_wrong_campaign_is_refused(campaign: Path, tmp_path: Path) -> None:
    text = (campaign / "model.yaml").read_text()
    (tmp_path / "wrong.yaml").write_text(text.replace("effect: frame_drift", "effect: frame_drft"))
    with pytest.raises(InputError, match=r"campaign.effects\[0\].*frame_drft"):
        read_robot(tmp_path / "wrong.yaml")


@pytest.fixture(scope="module")
def shifted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with poses of a base that is pushed 0.4 mm after 600 s, with later poses, and with the fitted model."""
    nominal = arm("puma560").robot
    step = {"effect": "step", "part": "base", "from_time_s": 600.0, "values": {"x": 4e-4, "y": 0.0, "z": 0.0}}
    stepping = dataclasses.replace(nominal, base=BASE, effects=(step,))
    pushed = dataclasses.replace(nominal, base=dataclasses.replace(BASE, xyz=(0.3004, -0.2, 0.1)))
    poses = {"poses": (stepping, 120, 1), "held_out": (stepping, 60, 2), "later": (pushed, 60, 3)}
    folder = written(tmp_path_factory.mktemp("shifted"), **poses)
    traced = robacc.trace(
        folder / "poses.csv", robot=folder / "nominal.yaml", declared="base_frame,tool_frame", folds=2
    )
    assert [finding.effect for finding in traced.findings] == ["step"]
    traced.write_model(folder / "model.yaml")
    return folder


def test_poses_of_a_campaign_with_a_step_follow_their_times(shifted: Path) -> None:
    later = estimated(shifted, "later")
    # Later poses, whose clock starts anew, are taken after the step.
    assert (later.position.rms < 6e-5, said(later, "taken as measured after the step")) == (True, True)
    assert rms(shifted, "later", campaign="keep") > 2e-4
    assert rms(shifted, "held_out") < 6e-5


# A model remembers the poses that it was fitted to, and says so where it meets them again.
POSES, ROBOT = str(CLEAN), str(NOMINAL)
WARNING = "poses.csv: the robot file was fitted to these same poses, so the errors show how well the model fits them"
NOTE = "the robot file was fitted to these same poses"


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("model") / "better.yaml"
    fit = "base_frame,tool_frame,joint_offset,link_geometry,gear_ratio[j2]"
    output("calibrate", POSES, "--robot", ROBOT, "--fit", fit, "--folds", "2", "--write-model", str(path))
    return path


@pytest.fixture(scope="module")
def others(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same poses in a file that is not the same, as if they had been measured again."""
    path = saved(
        tmp_path_factory.mktemp("others") / "others.csv", Path(POSES).read_text(encoding="utf-8") + "# measured again\n"
    )
    return path


def test_the_model_names_its_poses(model: Path, others: Path) -> None:
    digest = hashlib.sha256(Path(POSES).read_bytes()).hexdigest()
    robot = robacc.read_robot(model)
    assert robot.fitted_to == (digest,)
    robot = with_effect_units(robot)
    assert parse_robot(robot_to_yaml(robot), "again.yaml") == robot
    assert document("show", str(model))["robot"]["fitted_to"] == [digest]
    assert f"fitted   to the poses of SHA-256 {digest[:16]}…" in output("show", str(model))
    # A fit on top of a fit is of both files' poses.
    twice = robacc.calibrate(others, robot=model, folds=2)
    assert twice.robot.fitted_to == (digest, hashlib.sha256(others.read_bytes()).hexdigest())
    # The sample's arm has effects that its geometry alone does not explain.
    assert [text for text in twice.warnings if "a trace searches" not in text] == []


def test_its_own_poses_are_told_from_others(model: Path, others: Path, tmp_path: Path) -> None:
    own, other = (document("estimate", path, "--robot", str(model)) for path in (POSES, str(others)))
    assert (NOTE in own["notes"], any(WARNING in text for text in own["warnings"])) == (True, True)
    assert (NOTE in other["notes"], other["warnings"]) == (False, [])
    plain = document("estimate", POSES, "--robot", ROBOT)
    assert (plain["robot"]["effects"], plain["robot"]["fitted_to"], plain["notes"].count(NOTE)) == ([], [], 0)
    assert own["robot"]["effects"] == ["gear_ratio"]
    assert own["robot"]["fitted_to"]
    for command, more in (("calibrate", ("--folds", "2")), ("iso9283", ())):
        again = document(command, POSES, "--robot", str(model), *more)
        assert any(WARNING in text for text in again["warnings"]), command
    for name, one in (("own", own), ("other", other)):
        (tmp_path / f"{name}.json").write_text(json.dumps(one), encoding="utf-8")
    compared = document("compare", str(tmp_path / "own.json"), str(tmp_path / "other.json"))
    told = "made differently, robot file: own: fitted to the same poses; other: not fitted to these poses"
    assert any(text.startswith(told) for text in compared["warnings"])


def test_a_digest_that_is_none_is_named() -> None:
    text = "robacc: 1\nconvention: standard\nunits: {length: m, angle: rad}\n" + "fitted_to: [poses.csv]\njoints:\n"
    text += "  - {type: revolute, theta: 0, d: 1, a: 0, alpha: 0}\n"
    assert problems_of(parse_robot, text, "arm.yaml") == [
        "arm.yaml:4, fitted_to[0]: expected the SHA-256 of a pose file, 64 hexadecimal digits, found 'poses.csv'; "
        "`write_model` writes it; do not change it"
    ]
    assert parse_robot(text.replace("poses.csv", "'" + "0" * 64 + "'"), "arm.yaml").fitted_to == ("0" * 64,)


# Targets that the poses name and the robot file does not have: a fit of the tool finds their places.
NOISE = 2e-5
PLACES = {"N1": TOOL, "N2": TOOL + np.array([0.2, 0.1, 0.0]), "N3": TOOL + np.array([-0.1, 0.2, 0.05])}
FRAMES = "base_frame,tool_frame"


@pytest.fixture(scope="module")
def table() -> list[list[str]]:
    """Forty poses, each a row of six joints and three targets."""
    poses, rng = run(40, seed=3), np.random.default_rng(3)
    rows = []
    for q in poses.q.T:
        points = [target(q, place) + rng.normal(scale=NOISE, size=3) for place in PLACES.values()]
        rows.append([*map(repr, q.tolist()), *(repr(value) for point in points for value in point.tolist())])
    return rows


def in_columns(table: list[list[str]], path: Path) -> Path:
    names = [f"q{j}" for j in range(1, 7)] + [f"{axis}{number}" for number in (1, 2, 3) for axis in "xyz"]
    path.write_text("\n".join(",".join(row) for row in [names, *table]))
    return path


def in_rows(table: list[list[str]], path: Path) -> Path:
    lines = ["visit,target," + ",".join(f"q{j}" for j in range(1, 7)) + ",x,y,z"]
    for visit, row in enumerate(table):
        for number, name in enumerate(PLACES):
            first = 6 + 3 * number
            lines.append(",".join([str(visit), name, *row[:6], *row[first : first + 3]]))
    path.write_text("\n".join(lines))
    return path


@pytest.mark.parametrize("layout", [in_rows, in_columns])
def test_places_are_found_from_the_tool(
    layout: Callable[[list[list[str]], Path], Path], table: list[list[str]], tmp_path: Path
) -> None:
    poses = robacc.PoseFile(layout(table, tmp_path / "poses.csv"), units="m,rad")
    result = robacc.calibrate(poses, robot=robot(), fit=FRAMES, folds=2)
    assert any("are not in the robot file: each starts at its tool" in text for text in result.warnings)
    assert len(result.robot.targets) == 3
    for place, frame in zip(PLACES.values(), result.robot.targets.values(), strict=True):
        # Standard errors are some 4 um: 2e-5 over the root of 40, and the base's part.
        np.testing.assert_allclose(frame.xyz, place, atol=3e-5)
    model = tmp_path / "model.yaml"
    result.write_model(model)
    assert set(robacc.read_robot(model).targets) == set(result.robot.targets)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda path: robacc.calibrate(path, robot=robot(), fit="base_frame", folds=2), "fit tool_frame, which finds"),
        (lambda path: robacc.trace(path, robot=robot(), declared="base_frame", folds=2), "found several targets"),
        (lambda path: robacc.estimate(path, robot=robot()), "found several targets"),
        (lambda path: robacc.estimate(path, robot=robot(), align="base_frame"), "found several targets"),
    ],
)
def test_without_a_fit_of_the_tool_the_places_are_unknown(
    call: Callable[[Path], object], message: str, table: list[list[str]], tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=message):
        call(in_rows(table, tmp_path / "poses.csv"))


def test_an_estimate_that_fits_the_tool_finds_the_places(table: list[list[str]], tmp_path: Path) -> None:
    result = robacc.estimate(in_rows(table, tmp_path / "poses.csv"), robot=robot(), align=FRAMES)
    # The arm has no error but the noise: sqrt(3) times 20 um, less what 15 fitted coefficients of 360 take up.
    assert result.position.rms == pytest.approx(np.sqrt(3.0) * NOISE, rel=0.1)
    assert any("are not in the robot file: each starts at its tool" in text for text in result.warnings)


def test_one_name_is_the_tool(table: list[list[str]], tmp_path: Path) -> None:
    path = in_rows(table, tmp_path / "poses.csv")
    lines = path.read_text().splitlines()
    path.write_text("\n".join([lines[0], *(line for line in lines if ",N1," in line)]))
    result = robacc.calibrate(path, robot=robot(), fit=FRAMES, folds=2)
    assert result.robot.targets == {}
    np.testing.assert_allclose(result.robot.tool.xyz, TOOL, atol=3e-5)


# Results that could be taken for more than they are: a warning says so, and unknown figures are absent.
@pytest.fixture(scope="module")
def without_frames() -> robacc.Calibrated:
    few = robacc.read_poses(CLEAN, robot=robacc.read_robot(NOMINAL)).subset(slice(0, 24))
    return robacc.calibrate(few, robot=NOMINAL, fit=("joint_offset[j2]", "gear_ratio"), folds=2)


def test_a_requested_effect_that_no_joint_shows_is_named(without_frames: robacc.Calibrated) -> None:
    assert any("no joint shows gear_ratio" in text for text in without_frames.warnings)


def test_a_model_worse_than_registration_alone_is_named(without_frames: robacc.Calibrated) -> None:
    after, registered = without_frames.after.fitted.position.rms, without_frames.nominal.fitted.position.rms
    assert after > registered
    [text] = [text for text in without_frames.warnings if "worse" in text]
    assert f"{1e3 * after:.3g} mm" in text
    assert text.endswith("add base_frame,tool_frame to `fit`")


def test_a_fit_to_positions_expects_no_orientation_error() -> None:
    poses = robacc.simulate(TRUTH, poses=60, seed=3, noise="0.02mm", position_only=True).data
    fitted = robacc.calibrate(poses, robot=TRACED_ROBOT, folds=2)
    targets = robacc.simulate(TRACED_ROBOT, poses=4, seed=5, motion=False).data
    result = robacc.correct(targets, model=fitted.robot, beyond_range=True, most="50mm,5deg")
    document = result.document()
    after = document["expected"]["after"]
    assert after["position"]["expected_rms_m"] > 0
    assert (after["orientation"]["expected_rms_rad"], document["targets"]["after"]["rms_rad"]) == (None, None)
    columns = next(csv.reader(io.StringIO(result.per_target_csv())))
    assert "after_rms_m" in columns
    assert "after_rms_rad" not in columns


DRILL = Frame((0.0, 0.0, 0.05))


def arms(tool: Frame = DRILL) -> tuple[Robot, Robot]:
    """The nominal arm, and the real one with other links and zeros."""
    nominal = dataclasses.replace(read_robot(PUMA), effects=(), tool=tool)
    random = np.random.default_rng(4)
    joints = [
        dataclasses.replace(
            joint, parameters={name: value + 5e-4 * random.normal() for name, value in joint.parameters.items()}
        )
        for joint in nominal.joints
    ]
    return nominal, dataclasses.replace(nominal, joints=tuple(joints))


def corrected(path: Path, text: str, **options: Any) -> CorrectedProgram:
    """Write a program and correct it."""
    path.write_text(text)
    return correct_program(path, **options)


def flange(robot: Robot, q: np.ndarray) -> np.ndarray:
    """Poses of the flange in the robot's base frame."""
    return Arm.of(dataclasses.replace(robot, base=Frame(), tool=Frame(), targets={})).chain.forward(q).matrices()


Q = np.array([[0.2, -0.3, 0.4, 0.3, 0.8, -0.2], [-0.4, -0.2, 0.3, -0.2, 0.7, 0.5], [0.6, -0.4, 0.2, 0.1, 1.0, 0.1]]).T


def test_joint_targets_bring_the_real_arm_to_the_nominal_pose(tmp_path: Path) -> None:
    nominal, real = arms()
    path = tmp_path / "joints.script"
    result = corrected(
        path,
        urscript.write([(f"t{i}", q) for i, q in enumerate(Q.T)]),
        model=real,
        nominal=nominal,
    )
    assert result.n_corrected == 3
    path.write_bytes(result.data)
    q = np.array([target.values for target in read_program(path).targets]).T
    # Seven decimals of a radian, six joints, and less than a metre.
    np.testing.assert_allclose(flange(real, q), flange(nominal, Q), atol=1e-6)


def test_cartesian_targets_lead_through_tool_and_base(tmp_path: Path) -> None:
    nominal, real = arms()
    home = ",".join(f"{np.degrees(v):.6f}" for v in Q[:, 0])
    unused = "[9E9,9E9,9E9,9E9,9E9,9E9]"
    text = f"""MODULE m
PERS tooldata t:=[TRUE,[[10,20,150],[0.92387953,0,0.38268343,0]],[1,[0,0,1],[1,0,0,0],0,0,0]];
PERS wobjdata w:=[FALSE,TRUE,"",[[400,-100,50],[0.70710678,0,0,0.70710678]],[[0,0,0],[1,0,0,0]]];
CONST jointtarget home:=[[{home}],{unused}];
CONST robtarget p1:=PLACE1;
CONST robtarget p2:=PLACE2;
PROC main()
  MoveAbsJ home\\NoEOffs,v100,fine,tool0;
  MoveL p1,v100,fine,t\\WObj:=w; ! approach
  MoveL p2,v100,fine,t\\WObj:=w;
  MoveL Offs(p2,0,0,10),v100,fine,t\\WObj:=w;
ENDPROC
ENDMODULE
"""
    base = np.eye(4)
    base[:3, :3], base[:3, 3] = Rotation.from_euler("z", 90, degrees=True).as_matrix(), (0.4, -0.1, 0.05)
    tool = np.eye(4)
    tool[:3, :3], tool[:3, 3] = Rotation.from_euler("y", 45, degrees=True).as_matrix(), (0.01, 0.02, 0.15)
    for i, pose in enumerate(flange(nominal, Q[:, 1:]), start=1):
        target = np.linalg.inv(base) @ pose @ tool
        x, y, z, w = Rotation.from_matrix(target[:3, :3]).as_quat()
        place = ",".join(f"{1e3 * value:.6f}" for value in target[:3, 3])
        turn = ",".join(f"{value:.10f}" for value in (w, x, y, z))
        quarters = ",".join(str(int(np.floor(2 * Q[axis, i] / np.pi))) for axis in (0, 3, 5))
        # In front is where axis 2 turns the upright arm, which is the other side on this arm.
        text = text.replace(f"PLACE{i}", f"[[{place}],[{turn}],[{quarters},4],{unused}]")
    path = tmp_path / "cell.mod"
    result = corrected(path, text, model=real, nominal=nominal)
    assert result.n_corrected == 3
    assert any("Offs(p2" in warning for warning in result.warnings)
    path.write_bytes(result.data)
    commanded = flange_targets(read_program(path))[1]
    # The joints at which the controller has the commanded poses, by the corrected joint of the same pose.
    direct = correct(
        Measurements(np.zeros((3, 2)), q=Q[:, 1:]),
        model=real,
        nominal=dataclasses.replace(nominal, tool=Frame()),
        frame="base",
    )
    np.testing.assert_allclose(commanded.matrices(), flange(nominal, direct.q), atol=1e-6)
    np.testing.assert_allclose(flange(real, direct.q), flange(nominal, Q[:, 1:]), atol=1e-6)
    assert b"! approach" in result.data


def test_the_configuration_of_the_program_decides() -> None:
    q = np.array([[0.1, -0.5, 1.0, -1.0, 0.3, -0.2], [0.1, 0.5, 1.0, -1.0, 0.3, -0.2]]).T
    cases = {
        (krl, "S 2,T 42"): [True, False],
        (krl, "S 'B010',T 'B101000'"): [False, True],
        (rapid, "[0,-1,-1,0]"): [True, True],
        (rapid, "[0,0,-1,0]"): [False, False],
        (fanuc, "N U T, 0, 0, 0"): [True, True],
        (fanuc, "F D B, 0, 0, -1"): [False, False],
    }
    for (dialect, text), expected in cases.items():
        assert allowed_by_window(joint_window(dialect.CONFIGURATIONS, text, 6), q).tolist() == expected
    assert joint_window(ConfigurationRules(), "lefty epositive wpositive", 6) is None
    # On a rail the bits are of the arm's axes, not of the chain's joints.
    assert (joint_window(krl.CONFIGURATIONS, "T 5", 7), joint_window(krl.CONFIGURATIONS, "", 6)) == (None, None)


def test_turn_numbers_of_tp_programs_count_from_half_a_turn() -> None:
    wide, revolute = (np.full(6, -np.inf), np.full(6, np.inf)), np.ones(6, dtype=bool)
    q = np.array([[0.1, 0.2, 0.3, 0.1, 0.2, 0.4]]).T
    # The first two numbers are unequal: sources differ on the axes that they count.
    for text, fourth in (("N U T, 0, 1, -1", 0.1), ("N U T, 1, 1, -1", 0.1 + 2 * np.pi)):
        window = joint_window(fanuc.CONFIGURATIONS, text, 6)
        turned = turned_into(window, q, wide, revolute)[:, 0]
        np.testing.assert_allclose(turned, [0.1, 0.2, 0.3, fourth, 0.2, 0.4 - 2 * np.pi])
    window = joint_window(fanuc.CONFIGURATIONS, "N U T, 0, 0, 0", 6)
    beyond = np.array([[0, 0, 0, 0, 0, 3.2], [0, 0, 0, 3.2, 0, 0], [3.2, 0, 0, 0, 3.2, 0]]).T
    assert allowed_by_window(window, beyond).tolist() == [False, False, True]


def test_a_correction_into_another_configuration_is_seen() -> None:
    before = np.array([0.1, -0.5, 1.0, -1.0, 1e-4, 3.1415])
    over = before + np.array([0, 0, 0, 0, 0, 2e-4])
    flipped = before + np.array([0, 0, 0, 0, -2e-4, 0])
    config = "N U T, 0, 0, 0"
    assert [leaves_configuration(fanuc.CONFIGURATIONS, config, before, q) for q in (before, over, flipped)] == [0, 1, 1]
    # A turn of KRL is the sign of each axis, and knows nothing of half a turn.
    for rules, stated, at_border in (
        (krl.CONFIGURATIONS, "S 2,T 10", 0),
        (krl.CONFIGURATIONS, "S 2", 0),
        (rapid.CONFIGURATIONS, "[0,-1,1,0]", 1),
    ):
        found = [leaves_configuration(rules, stated, before, q) for q in (before, over, flipped)]
        assert found == [0, at_border, 1]
    assert [leaves_configuration(ConfigurationRules(), "", before, q) for q in (before, over, flipped)] == [0, 0, 0]
    on_border = np.where(np.arange(6) == 5, np.pi, before)
    assert not leaves_configuration(fanuc.CONFIGURATIONS, config, on_border, on_border + 1e-4 * np.eye(6)[5])


def test_whole_turns_follow_the_configuration_within_the_limits() -> None:
    q = np.array([[0.1, 0.2, 0.3, 0.1, 0.2, 0.4]]).T
    limits, revolute = (np.full(6, -6.1), np.full(6, 6.1)), np.ones(6, dtype=bool)
    window = joint_window(krl.CONFIGURATIONS, "S 0,T 40", 6)  # axes 4 and 6 negative; 0.1 - 2 pi is beyond the limit
    np.testing.assert_allclose(
        turned_into(window, q, limits, revolute)[:, 0], [0.1, 0.2, 0.3, 0.1, 0.2, 0.4 - 2 * np.pi]
    )
    assert not allowed_by_window(window, turned_into(window, q, limits, revolute))[0]
    wide = (np.full(6, -np.inf), np.full(6, np.inf))
    window = joint_window(rapid.CONFIGURATIONS, "[0,-4,4,0]", 6)
    turned = turned_into(window, q, wide, revolute)
    np.testing.assert_allclose(turned[[3, 5], 0], [0.1 - 2 * np.pi, 0.4 + 2 * np.pi])
    assert allowed_by_window(window, turned)[0]


def test_krl_target_keeps_the_elbow_that_its_turn_names(tmp_path: Path) -> None:
    """Two targets of one flange pose differ by S and T alone: each is corrected for its own joints."""
    nominal, real = arms(Frame())
    q = Q[:, 0]
    pose = flange(nominal, q[:, None])[0]
    solutions = inverse_kinematics(
        Arm.of(dataclasses.replace(nominal, base=Frame())), Poses(pose[:3, :3, None], pose[:3, 3:]), starts=48
    )
    other = next(
        s.T for s in solutions.q[:, 0, solutions.converged[0]].T if np.any(np.sign(s) != np.sign(q)) and np.all(s != 0)
    )
    a, b, c = Rotation.from_matrix(pose[:3, :3]).as_euler("ZYX", degrees=True)
    place = ",".join(f"{name} {1e3 * value:.6f}" for name, value in zip("XYZ", pose[:3, 3], strict=True))
    lines = [
        f"PTP {{{place},A {a:.8f},B {b:.8f},C {c:.8f},T {sum(1 << i for i, v in enumerate(joints) if v < 0)}}}"
        for joints in (q, other)
    ]
    text = "DEF two()\n$TOOL=$NULLFRAME\n$BASE=$NULLFRAME\n" + "\n".join(lines) + "\nEND\n"
    path = tmp_path / "two.src"
    result = corrected(path, text, model=real, nominal=nominal)
    assert result.n_corrected == 2
    np.testing.assert_allclose(result.corrections[0].wanted.q.T, [q, other], atol=1e-6)
    result = corrected(path, text.replace("T " + lines[0].split("T ")[-1], "T 63}"), model=real, nominal=nominal)
    assert result.n_corrected == 1
    assert "no solution in its configuration" in result.unchanged[0][2]


def test_targets_without_frames_stay(tmp_path: Path) -> None:
    nominal, real = arms()
    for name, message in (("pick", "the tool 3 is in none of the files read"), ("nopos", "has no targets")):
        with pytest.raises(InputError, match=message):
            correct_program(ROOT / "tests" / "programs" / "samples" / f"{name}.ls", model=real, nominal=nominal)


def tp_program(poses: np.ndarray, configurations: list[str], home: np.ndarray) -> str:
    """A TP program with a joint target and Cartesian targets in the robot's base frame."""
    joints = ", ".join(f"J{i + 1}= {np.degrees(v):.3f} deg" for i, v in enumerate(home))
    text = "/PROG  TWO\n/MN\n   1:J P[1] 10% FINE ;\n"
    positions = f"P[1]{{\n   GP1:\n\tUF : 0, UT : 1,\t\n\t{joints}\n}};\n"
    for k, (pose, configuration) in enumerate(zip(poses, configurations, strict=True), start=2):
        w, p, r = Rotation.from_matrix(pose[:3, :3]).as_euler("xyz", degrees=True)
        x, y, z = 1e3 * pose[:3, 3]
        text += f"   {k}:L P[{k}] 100mm/sec FINE ;\n"
        positions += f"P[{k}]{{\n   GP1:\n\tUF : 0, UT : 1,\t\tCONFIG : '{configuration}',\n"
        positions += f"\tX = {x:.6f} mm, Y = {y:.6f} mm, Z = {z:.6f} mm,\n"
        positions += f"\tW = {w:.8f} deg, P = {p:.8f} deg, R = {r:.8f} deg\n}};\n"
    return text + "/POS\n" + positions + "/END\n"


@pytest.fixture
def frames(tmp_path: Path) -> Path:
    """A file with a tool that is the flange."""
    path = saved(tmp_path / "frames.yaml", "units: {length: mm, angle: deg}\ntools: {1: {xyz: [0, 0, 0]}}\n")
    return path


def test_a_target_whose_correction_flips_the_wrist_stays(tmp_path: Path, frames: Path) -> None:
    nominal, real = arms()
    # The fifth joint's zero is off by 3 mrad, and the program wants it 1 mrad from zero.
    joints = [
        dataclasses.replace(j, parameters={**j.parameters, "theta": j.parameters.get("theta", 0.0) + 3e-3 * (i == 4)})
        for i, j in enumerate(nominal.joints)
    ]
    real = dataclasses.replace(nominal, joints=tuple(joints), tool=Frame())
    nominal = dataclasses.replace(nominal, tool=Frame())
    near = np.where(np.arange(6) == 4, 1e-3, Q[:, 0])
    path = tmp_path / "flip.ls"
    result = corrected(
        path,
        tp_program(flange(nominal, np.stack((Q[:, 1], near), axis=1)), ["N U T, 0, 0, 0"] * 2, Q[:, 0]),
        model=real,
        nominal=nominal,
        frames=[frames],
        most="50mm,5deg",
    )
    assert [name for _, name, _ in result.unchanged] == ["P[3]"]


def test_a_joint_target_out_of_range_does_not_refuse_the_cartesian_ones(tmp_path: Path) -> None:
    nominal, _ = arms()
    path = tmp_path / "home.script"
    # The zero of the last joint is off, so its correction at the limit leads beyond the limit.
    last = nominal.variables[5]
    real = dataclasses.replace(
        nominal,
        joints=(
            *nominal.joints[:5],
            dataclasses.replace(
                last, parameters={**last.parameters, "theta": last.parameters.get("theta", 0.0) + 1e-3}
            ),
        ),
    )
    home = ", ".join(f"{value:.9f}" for value in (*Q[:5, 0], last.limits[0]))
    matrix = flange(nominal, np.append(Q[:5, 0], last.limits[0] + 0.3)[:, None])[0]
    rotation = Rotation.from_matrix(matrix[:3, :3]).as_rotvec()
    pose = ", ".join(f"{value:.9f}" for value in (*matrix[:3, 3], *rotation))
    result = corrected(
        path,
        f"def p():\n  set_tcp(p[0, 0, 0, 0, 0, 0])\n  movej([{home}])\n  movel(p[{pose}])\nend\n",
        model=real,
        nominal=nominal,
        most="5mm",
    )
    assert (result.n_corrected, [line for line, _, _ in result.unchanged]) == (1, [3])
    with pytest.raises(InputError) as caught:
        corrected(path, f"def p():\n  movej([{home}])\nend\n", model=real, nominal=nominal)
    problem = caught.value.problems[0]
    assert (problem.file, problem.line) == (str(path), 2)
    assert "no target can be corrected" in (problem.fix or "")


def test_joint_targets_of_another_number_of_joints_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "six.script"
    with pytest.raises(InputError, match="has 6 joints, the model's arm has 7") as caught:
        corrected(path, "def p():\n  movej([0, 0, 0, 0, 0, 0])\nend\n", model="lbr_iiwa_7_r800")
    assert caught.value.problems[0].line == 2
