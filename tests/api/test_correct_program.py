"""``robacc correct PROGRAM``: the real arm reaches what the program means, and only numbers change."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from robacc.api.correct_program import correct_program
from robacc.errors import InputError
from robacc.geometry import Poses
from robacc.programs.configuration import joint_window
from robacc.programs.flange import flange_targets
from robacc.programs.fresh import joint_target, write_program
from robacc.programs.program import Dialect
from robacc.programs.reading import read_program
from robacc.robots.arm import Arm
from robacc.robots.description import Frame, Robot
from robacc.robots.inverse_kinematics import inverse_kinematics
from robacc.robots.yaml_robot import parse_robot

ROOT = Path(__file__).resolve().parents[2]


def arms() -> tuple[Robot, Robot]:
    """The nominal arm, and the real one with other links and zeros."""
    path = ROOT / "configs" / "robots" / "puma560.yaml"
    nominal = parse_robot(path.read_text(encoding="utf-8"), path.name)
    nominal = dataclasses.replace(nominal, effects=(), tool=Frame((0.0, 0.0, 0.05)))
    random = np.random.default_rng(4)
    joints = [
        dataclasses.replace(
            joint, parameters={name: value + 5e-4 * random.normal() for name, value in joint.parameters.items()}
        )
        for joint in nominal.joints
    ]
    return nominal, dataclasses.replace(nominal, joints=tuple(joints))


def flange(robot: Robot, q: np.ndarray) -> np.ndarray:
    """Poses of the flange in the robot's base frame."""
    return Arm.of(dataclasses.replace(robot, base=Frame(), tool=Frame(), targets={})).chain.forward(q).matrices()


Q = np.array([[0.2, -0.3, 0.4, 0.3, 0.8, -0.2], [-0.4, -0.2, 0.3, -0.2, 0.7, 0.5], [0.6, -0.4, 0.2, 0.1, 1.0, 0.1]]).T


def test_joint_targets_bring_the_real_arm_to_the_nominal_pose(tmp_path: Path) -> None:
    nominal, real = arms()
    path = tmp_path / "joints.script"
    path.write_text(write_program(Dialect.urscript, [joint_target(f"t{i}", q) for i, q in enumerate(Q.T)]))
    result = correct_program(path, model=real, nominal=nominal)
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
    path.write_text(text)
    result = correct_program(path, model=real, nominal=nominal)
    assert result.n_corrected == 3
    assert any("Offs(p2" in warning for warning in result.warnings)
    path.write_bytes(result.data)
    commanded = flange_targets(read_program(path)).flange
    # The joints at which the controller has the commanded poses, by the corrected joint of the same pose.
    from robacc.api.correct import correct
    from robacc.measurements import Measurements

    direct = correct(
        Measurements(np.zeros((3, 2)), q=Q[:, 1:]),
        model=real,
        nominal=dataclasses.replace(nominal, tool=Frame()),
        frame="base",
    )
    np.testing.assert_allclose(commanded.matrices(), flange(nominal, direct.targets.q), atol=1e-6)
    np.testing.assert_allclose(flange(real, direct.targets.q), flange(nominal, Q[:, 1:]), atol=1e-6)
    assert b"! approach" in result.data


def test_the_configuration_of_the_program_decides() -> None:
    q = np.array([[0.1, -0.5, 1.0, -1.0, 0.3, -0.2], [0.1, 0.5, 1.0, -1.0, 0.3, -0.2]]).T
    cases = {
        (Dialect.krl, "S 2,T 42"): [True, False],
        (Dialect.krl, "S 'B010',T 'B101000'"): [False, True],
        (Dialect.rapid, "[0,-1,-1,0]"): [True, True],
        (Dialect.rapid, "[0,0,-1,0]"): [False, False],
    }
    for (dialect, text), expected in cases.items():
        window = joint_window(dialect, text, 6)
        assert window is not None
        assert window.allows(q).tolist() == expected
    assert joint_window(Dialect.fanuc, "N U T, 0, 0, 0", 6) is None
    # On a rail the bits are of the arm's axes, not of the chain's joints.
    assert joint_window(Dialect.krl, "T 5", 7) is None
    assert joint_window(Dialect.krl, "", 6) is None


def test_whole_turns_follow_the_configuration_within_the_limits() -> None:
    q = np.array([[0.1, 0.2, 0.3, 0.1, 0.2, 0.4]]).T
    limits, revolute = (np.full(6, -6.1), np.full(6, 6.1)), np.ones(6, dtype=bool)
    window = joint_window(Dialect.krl, "S 0,T 40", 6)  # axes 4 and 6 negative; 0.1 - 2 pi is beyond the limit
    assert window is not None
    np.testing.assert_allclose(window.turned(q, limits, revolute)[:, 0], [0.1, 0.2, 0.3, 0.1, 0.2, 0.4 - 2 * np.pi])
    assert not window.allows(window.turned(q, limits, revolute))[0]
    wide = (np.full(6, -np.inf), np.full(6, np.inf))
    window = joint_window(Dialect.rapid, "[0,-4,4,0]", 6)
    assert window is not None
    turned = window.turned(q, wide, revolute)
    np.testing.assert_allclose(turned[[3, 5], 0], [0.1 - 2 * np.pi, 0.4 + 2 * np.pi])
    assert window.allows(turned)[0]


def test_krl_target_keeps_the_elbow_that_its_turn_names(tmp_path: Path) -> None:
    """Two targets of one flange pose differ by S and T alone: each is corrected for its own joints."""
    nominal, real = arms()
    nominal, real = (dataclasses.replace(arm, tool=Frame()) for arm in (nominal, real))
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
    path.write_text(text)
    result = correct_program(path, model=real, nominal=nominal)
    assert result.n_corrected == 2
    np.testing.assert_allclose(result.corrections[0].targets.wanted.q.T, [q, other], atol=1e-6)
    path.write_text(text.replace("T " + lines[0].split("T ")[-1], "T 63}"))
    result = correct_program(path, model=real, nominal=nominal)
    assert result.n_corrected == 1
    assert "no solution in its configuration" in result.unchanged[0][2]


def test_targets_without_frames_stay(tmp_path: Path) -> None:
    nominal, real = arms()
    with pytest.raises(InputError, match="the tool 3 is in none of the files read"):
        correct_program(ROOT / "tests" / "programs" / "samples" / "pick.ls", model=real, nominal=nominal)
    with pytest.raises(InputError, match="has no targets"):
        correct_program(ROOT / "tests" / "programs" / "samples" / "nopos.ls", model=real, nominal=nominal)
