"""``robacc correct PROGRAM``: the real arm reaches what the program means, and only numbers change."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from robacc.api.correct import CorrectedProgram, correct, correct_program
from robacc.errors import InputError
from robacc.geometry import Poses
from robacc.measurements import Measurements
from robacc.programs.program import read_program
from robacc.programs.targets import (
    allowed_by_window,
    flange_targets,
    joint_window,
    leaves_configuration,
    turned_into,
    write_program,
)
from robacc.robots.arm import Arm, inverse_kinematics
from robacc.robots.description import Frame, Robot
from robacc.robots.yaml_robot import parse_robot

ROOT = Path(__file__).resolve().parents[2]


TOOL = Frame((0.0, 0.0, 0.05))


def arms(tool: Frame = TOOL) -> tuple[Robot, Robot]:
    """The nominal arm, and the real one with other links and zeros."""
    path = ROOT / "configs" / "robots" / "puma560.yaml"
    nominal = parse_robot(path.read_text(encoding="utf-8"), path.name)
    nominal = dataclasses.replace(nominal, effects=(), tool=tool)
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
        write_program("urscript", [(f"t{i}", q) for i, q in enumerate(Q.T)]),
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
        text = text.replace(f"PLACE{i}", f"[[{place}],[{turn}],[{quarters},0],{unused}]")
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
        ("krl", "S 2,T 42"): [True, False],
        ("krl", "S 'B010',T 'B101000'"): [False, True],
        ("rapid", "[0,-1,-1,0]"): [True, True],
        ("rapid", "[0,0,-1,0]"): [False, False],
        ("fanuc", "N U T, 0, 0, 0"): [True, True],
        ("fanuc", "F D B, 0, 0, -1"): [False, False],
    }
    for (dialect, text), expected in cases.items():
        window = joint_window(dialect, text, 6)
        assert allowed_by_window(window, q).tolist() == expected
    assert joint_window("val3", "lefty epositive wpositive", 6) is None
    # On a rail the bits are of the arm's axes, not of the chain's joints.
    assert (joint_window("krl", "T 5", 7), joint_window("krl", "", 6)) == (None, None)


def test_turn_numbers_of_tp_programs_count_from_half_a_turn() -> None:
    wide, revolute = (np.full(6, -np.inf), np.full(6, np.inf)), np.ones(6, dtype=bool)
    q = np.array([[0.1, 0.2, 0.3, 0.1, 0.2, 0.4]]).T
    # The first two numbers are unequal: sources differ on the axes that they count.
    for text, fourth in (("N U T, 0, 1, -1", 0.1), ("N U T, 1, 1, -1", 0.1 + 2 * np.pi)):
        window = joint_window("fanuc", text, 6)
        turned = turned_into(window, q, wide, revolute)[:, 0]
        np.testing.assert_allclose(turned, [0.1, 0.2, 0.3, fourth, 0.2, 0.4 - 2 * np.pi])
    window = joint_window("fanuc", "N U T, 0, 0, 0", 6)
    beyond = np.array([[0, 0, 0, 0, 0, 3.2], [0, 0, 0, 3.2, 0, 0], [3.2, 0, 0, 0, 3.2, 0]]).T
    assert allowed_by_window(window, beyond).tolist() == [False, False, True]


def test_a_correction_into_another_configuration_is_seen() -> None:
    before = np.array([0.1, -0.5, 1.0, -1.0, 1e-4, 3.1415])
    over = before + np.array([0, 0, 0, 0, 0, 2e-4])
    flipped = before + np.array([0, 0, 0, 0, -2e-4, 0])
    config = "N U T, 0, 0, 0"
    assert [leaves_configuration("fanuc", config, before, q) for q in (before, over, flipped)] == [0, 1, 1]
    # A turn of KRL is the sign of each axis, and knows nothing of half a turn.
    assert [leaves_configuration("krl", "S 2,T 10", before, q) for q in (before, over, flipped)] == [0, 0, 1]
    assert [leaves_configuration("val3", "", before, q) for q in (before, over, flipped)] == [0, 0, 0]
    on_border = np.where(np.arange(6) == 5, np.pi, before)
    assert not leaves_configuration("fanuc", config, on_border, on_border + 1e-4 * np.eye(6)[5])


def test_whole_turns_follow_the_configuration_within_the_limits() -> None:
    q = np.array([[0.1, 0.2, 0.3, 0.1, 0.2, 0.4]]).T
    limits, revolute = (np.full(6, -6.1), np.full(6, 6.1)), np.ones(6, dtype=bool)
    window = joint_window("krl", "S 0,T 40", 6)  # axes 4 and 6 negative; 0.1 - 2 pi is beyond the limit
    np.testing.assert_allclose(
        turned_into(window, q, limits, revolute)[:, 0], [0.1, 0.2, 0.3, 0.1, 0.2, 0.4 - 2 * np.pi]
    )
    assert not allowed_by_window(window, turned_into(window, q, limits, revolute))[0]
    wide = (np.full(6, -np.inf), np.full(6, np.inf))
    window = joint_window("rapid", "[0,-4,4,0]", 6)
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
    path = tmp_path / "frames.yaml"
    path.write_text("units: {length: mm, angle: deg}\ntools: {1: {xyz: [0, 0, 0]}}\n")
    return path


def test_tp_targets_have_the_turns_that_their_configuration_names(tmp_path: Path, frames: Path) -> None:
    nominal, real = arms(Frame())
    path = tmp_path / "two.ls"
    poses = flange(nominal, Q[:, [0, 0]])
    # Three decimals of a degree in the program's joint target.
    result = corrected(
        path,
        tp_program(poses, ["N U T, 0, 0, 0", "N U T, 0, 0, 1"], Q[:, 0]),
        model=real,
        nominal=nominal,
        frames=[frames],
    )
    wanted = result.corrections[1].wanted.q
    turned = Q[:, 0] + 2 * np.pi * np.eye(6)[5]
    if not all(j.limits is None or j.limits[1] >= turned[5] for j in nominal.variables[5:]):
        assert "no solution in its configuration N U T, 0, 0, 1" in result.unchanged[0][2]
        np.testing.assert_allclose(wanted.T, [Q[:, 0]], atol=1e-6)
    else:
        np.testing.assert_allclose(wanted.T, [Q[:, 0], turned], atol=1e-6)
    assert any("not read completely" in warning for warning in result.warnings)
    assert b"'N U T, 0, 0, 1'" in result.data


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


def test_a_model_without_a_fit_is_doubted(tmp_path: Path) -> None:
    nominal, _ = arms()
    path = tmp_path / "joints.script"
    result = corrected(path, write_program("urscript", [("t", Q[:, 0])]), model=nominal)
    assert any("every correction is zero" in warning for warning in result.warnings)


def test_joint_targets_of_another_number_of_joints_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "six.script"
    with pytest.raises(InputError, match="has 6 joints, the model's arm has 7") as caught:
        corrected(path, "def p():\n  movej([0, 0, 0, 0, 0, 0])\nend\n", model="lbr_iiwa_7_r800")
    assert caught.value.problems[0].line == 2
