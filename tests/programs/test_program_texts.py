"""Programs of KUKA, ABB, FANUC and Universal Robots."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from sample_files import saved
from scipy.spatial.transform import Rotation

from robacc import InputError, Robot, read_robot
from robacc.api.correct import correct_program
from robacc.geometry import Array
from robacc.programs.program import Program, ProgramTarget, read_program
from robacc.programs.targets import with_targets
from robacc.robots.arm import Arm
from robacc.robots.description import Frame
from robacc_plugins.krl import allowed_by_status, joint_window
from robacc_plugins.rapid import allowed_by_cfx

SAMPLES = Path(__file__).parent / "samples"


def notes(program: Program) -> dict[int, str]:
    return {note.line: note.reason for note in program.notes}


def line_of(name: str, start: str) -> int:
    lines = (SAMPLES / name).read_text(encoding="cp1252").splitlines()
    return next(k for k, line in enumerate(lines, start=1) if line.strip().startswith(start))


def test_inline_forms_give_tool_and_base_by_number() -> None:
    program = read_program(SAMPLES / "weld.dat", [SAMPLES / "config.dat"])
    assert [t.name for t in program.targets] == ["XP1", "XP2", "XP3", "XP4"]
    assert program.moves == (0, 1, 2, 3)
    assert all(t.tool is not None and t.tool.name == "3" for t in program.targets)
    first = program.targets[0]
    np.testing.assert_allclose(first.tool.frame.xyz, (0.0875, 0, 0.41225))
    np.testing.assert_allclose(first.tool.frame.rpy, np.radians([0, -45, 0]), atol=1e-15)
    np.testing.assert_allclose(first.base.frame.rpy, np.radians([0, 0, 90]), atol=1e-15)
    assert first.configuration == "S 18,T 2"


def test_abc_is_rz_ry_rx() -> None:
    target = read_program(SAMPLES / "weld.dat").targets[1]
    np.testing.assert_allclose(target.values[:3], (1.58776917, -0.890400757, 0.439605072))
    x, y, z, w = Rotation.from_euler("ZYX", (177.082932, 4.31955290, -0.298484027), degrees=True).as_quat()
    np.testing.assert_allclose(target.values[3:], np.array((w, x, y, z)) * np.sign(w), atol=1e-15)


def test_a_src_names_the_file_that_declares_its_targets() -> None:
    program = read_program(SAMPLES / "weld.src")
    assert program.targets == ()
    reasons = notes(program)
    assert "4 targets are declared in weld.dat" in " ".join(reasons.values())
    assert reasons[line_of("weld.src", "PTP  XHOME")] == "the target's numbers are in none of the files read"


def test_literals_of_motions_and_of_single_assignments_are_targets() -> None:
    program = read_program(SAMPLES / "expert.src", [SAMPLES / "config.dat"])
    by_line = {target.line: target for target in program.targets}
    joint = by_line[line_of("expert.src", "PTP {A1 10.0")]
    np.testing.assert_allclose(joint.values, np.radians([10, -95.5, 100.25, 0, 85.25, -10]))
    np.testing.assert_allclose(joint.tool.frame.xyz, (0.0125, 0, 0.21075))
    assert {line_of("expert.src", start) for start in ("ptp {E6AXIS", "target =")} <= {*by_line}


def test_a_tool_set_in_a_branch_is_unknown_after_it() -> None:
    program = read_program(SAMPLES / "expert.src", [SAMPLES / "config.dat"])
    by_line = {target.line: target for target in program.targets}
    inside, after = (by_line[line_of("expert.src", f"LIN {{X {x}.0")] for x in (840, 850))
    assert inside.tool.name == "2"
    assert after.tool is None
    assert after.base.name == "4"


@pytest.mark.parametrize(
    ("start", "reason"),
    [
        ("LIN target : lift", "the target is computed at run time"),
        ("LIN {X 830.0}", "the instruction leaves numbers of the target out or computes them"),
        ("LIN_REL", "a relative motion has no target of its own"),
        ("PTP_REL", "a relative motion has no target of its own"),
    ],
)
def test_what_is_computed_at_run_time_is_listed(start: str, reason: str) -> None:
    assert notes(read_program(SAMPLES / "expert.src"))[line_of("expert.src", start)] == reason


def test_targets_that_the_program_changes_are_left_alone() -> None:
    program = read_program(SAMPLES / "expert.dat")
    assert [target.name for target in program.targets] == ["unused", "PARK"]
    reasons = [(note.text.partition(":")[0], note.reason) for note in program.notes]
    line = line_of("expert.src", "pallet.X")
    assert ("pallet", f"the program assigns it at run time in line {line} of expert.src") in reasons
    assert ("fixture", "is a FRAME that no motion of the files read goes to") in reasons


def test_spline_motions_name_their_frames_themselves() -> None:
    program = read_program(SAMPLES / "spline.dat", [SAMPLES / "config.dat"])
    by_name = {target.name: target for target in program.targets}
    first = by_name["XP1"]
    assert (first.tool.name, first.base.name) == ("1", "0")
    np.testing.assert_allclose(first.tool.frame.xyz, (0, 0, 0.15))
    assert by_name["XS[3]"].base.frame is None, "a base on a moving unit is not known from the text"


def test_a_huge_file_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("robacc.programs.program.PROGRAM_LIMIT", 1000)
    path = saved(tmp_path / "huge.src", b"DEF a()\r\n" + b"; text\r\n" * 1000 + b"END\r\n")
    with pytest.raises(InputError, match="is larger than"):
        read_program(path)


def test_a_component_that_is_computed_makes_no_target(tmp_path: Path) -> None:
    path = saved(
        tmp_path / "a.src", b"DEF a()\nLIN {X nHeight,Y 0,Z 0,A 0,B 0,C 0}\nLIN {X 1+2,Y 0,Z 0,A 0,B 0,C 0}\nEND\n"
    )
    program = read_program(path)
    assert program.targets == ()
    assert sorted(notes(program)) == [2, 3]


def test_a_declared_target_with_a_broken_aggregate_is_listed(tmp_path: Path) -> None:
    path = saved(tmp_path / "a.dat", b"DEFDAT a\nDECL E6POS XP1={X 1,Y 2]0,Z 3,A 0,B 0,C 0}\nENDDAT\n")
    assert notes(read_program(path)) == {2: "XP1 lacks some of the numbers of a target"}


ROBOTS = Path(__file__).resolve().parents[2] / "robacc" / "data" / "robots"


def kuka(name: str = "kr10_r1100_sixx") -> Robot:
    return read_robot(ROBOTS / f"{name}.yaml")


def status(arm: Arm, q: Array) -> list[int]:
    """The only status from 0 to 7 that joints have."""
    allowed = np.array([allowed_by_status(arm, f"S {number},T 0", q) for number in range(8)])
    assert np.all(allowed.sum(axis=0) == 1)
    return [int(number) for number in np.argmax(allowed, axis=0)]


@pytest.mark.parametrize("name", ["kr10_r1100_sixx", "kr16_r2010_2", "kr210_r2700_extra"])
def test_status_follows_the_definition(name: str) -> None:
    """Axis angles in degrees: the home pose of KRC, and poses on the other side of one border each."""
    cases = {
        (0, -90, 90, 0, 20, 0): 2,
        (70, -90, 90, 0, 20, 0): 2,
        (0, -90, 90, 0, -20, 0): 6,
        # The forearm turned back over the shoulder: behind axis 1, and in front of the line from axis 2 to axis 3.
        (0, -150, 60, 0, 20, 0): 3,
        (0, -150, 60, 90, -20, 0): 7,
        # The elbow turned the other way.
        (0, -20, -60, 0, 20, 0): 0,
        (0, -20, -60, 0, -20, 50): 4,
    }
    arm = Arm.of(dataclasses.replace(kuka(name), base=Frame()))
    q = np.radians(np.array(list(cases), dtype=float)).T
    assert status(arm, q) == list(cases.values())
    # RAPID numbers the same sides otherwise: 4 behind axis 1, 2 behind the lower arm, 1 for a negative axis 5.
    of_cfx = [[*allowed_by_cfx(arm, f"[0,0,0,{cfx}]", q)] for cfx in range(8)]
    numbers = [{2: 0, 6: 1, 3: 4, 7: 5, 0: 2, 4: 3}[number] for number in cases.values()]
    assert of_cfx == [[number == cfx for number in numbers] for cfx in range(8)]


def test_arms_without_a_common_wrist_centre_have_the_sign_of_axis_5_alone() -> None:
    arm = Arm.of(read_robot(ROBOTS / "crx10ia_l.yaml"))
    q = np.full((6, 2), 0.4)
    q[4, 1] = -0.4
    assert allowed_by_status(arm, "S 0", q).tolist() == allowed_by_status(arm, "S 'B011'", q).tolist() == [True, False]
    assert allowed_by_status(arm, "S 6,T 16", q).tolist() == [False, True]
    assert allowed_by_status(arm, "T 16", q).tolist() == [True, True]


def test_a_status_without_turn_is_a_configuration() -> None:
    assert joint_window("S 2") is not None
    assert joint_window("") is None


def test_the_status_selects_the_elbow(tmp_path: Path) -> None:
    """The same pose with the elbow on either side, without a turn."""
    nominal = kuka()
    real = dataclasses.replace(
        nominal,
        joints=tuple(
            dataclasses.replace(joint, parameters={**joint.parameters, "a": joint.parameters["a"] + 2e-4})
            for joint in nominal.joints
        ),
    )
    arm = Arm.of(dataclasses.replace(nominal, base=Frame(), tool=Frame()))
    q = np.radians(np.array([[20.0, -50.0, 40.0, 30.0, 40.0, 10.0]])).T
    pose = arm.chain.forward(q).matrices()[0]
    a, b, c = Rotation.from_matrix(pose[:3, :3]).as_euler("ZYX", degrees=True)
    x, y, z = 1e3 * pose[:3, 3]
    used = []
    for number in (2, 0):
        text = (
            f"DEF m()\n$TOOL={{X 0,Y 0,Z 0,A 0,B 0,C 0}}\n$BASE={{X 0,Y 0,Z 0,A 0,B 0,C 0}}\nPTP {{X {x:.6f},Y {y:.6f},"
        )
        text += f"Z {z:.6f},A {a:.6f},B {b:.6f},C {c:.6f},S {number}}}\nEND\n"
        path = saved(tmp_path / f"m{number}.src", text)
        used.append(correct_program(path, model=real, nominal=nominal).corrections[0].wanted.q)
        assert allowed_by_status(arm, f"S {number}", used[-1]).all()
    np.testing.assert_allclose(used[0], q, atol=1e-5)
    assert np.abs(used[1] - q).max() > 0.5


def by_name(program: Program) -> dict[str, ProgramTarget]:
    return {target.name: target for target in program.targets}


def reasons(program: Program) -> list[str]:
    return [note.reason for note in program.notes]


def test_targets_have_tool_and_work_object() -> None:
    targets = by_name(read_program(SAMPLES / "glue.mod"))
    assert list(targets) == ["p10", "p20", "p30", "jHome"]
    np.testing.assert_allclose(targets["jHome"].values, np.radians([0, -20.5, 30, 0, 80.25, -10]))
    p20 = targets["p20"]
    np.testing.assert_allclose(p20.values, (0.506291651, -0.150257853, 0.679799999, 0.5, 0, 0.866025404, 0), atol=1e-9)
    np.testing.assert_allclose(p20.tool.frame.xyz, (0.031792631019, 0, 0.229638935148))
    # The object frame lies in the user frame, which is turned by 90 degrees about z.
    np.testing.assert_allclose(p20.base.frame.xyz, (0.98, -0.03, 0.83), atol=1e-9)
    np.testing.assert_allclose(p20.base.frame.rpy, (0, 0, np.pi / 2), atol=1e-8)
    moving = targets["p30"]
    assert moving.base.frame is None
    assert moving.configuration == "[0,-2,-1,4]"


def test_quaternions_begin_with_the_scalar() -> None:
    w, x, y, z = by_name(read_program(SAMPLES / "glue.mod"))["p10"].values[3:]
    rotation = Rotation.from_quat((x, y, z, w)).as_matrix()
    expected = Rotation.from_quat((0.727571, 0.686033, -2.82384e-06, 1.13796e-06)).as_matrix()
    np.testing.assert_allclose(rotation, expected, atol=1e-12)


def test_offs_and_reltool_are_listed() -> None:
    program = read_program(SAMPLES / "glue.mod")
    assert [note.text for note in program.notes] == ["MoveL Offs(p20,0,0,100),v100,fine,tGlue\\WObj:=wDoor;"]
    assert reasons(program) == ["the target is computed at run time"]


def test_elements_of_an_array_are_targets() -> None:
    program = read_program(SAMPLES / "array.mod")
    assert [target.name for target in program.targets] == ["cube{1}", "cube{2}", "cube{3}"]
    assert program.moves == (0, 1, 2, 1)
    assert reasons(program) == ["the target is computed at run time"]


def test_names_are_local_to_their_routine() -> None:
    program = read_program(SAMPLES / "literal.mod")
    assert [target.name for target in program.targets].count("pLocal") == 1
    np.testing.assert_allclose(by_name(program)["pLocal"].values[:3], (0.007, 0.008, 0.009))
    assert "the program assigns it at run time in line 12" in reasons(program)


def test_literals_of_instructions_are_targets() -> None:
    program = read_program(SAMPLES / "literal.mod")
    kinds = [target.kind for target in program.targets if target.name != "pLocal"]
    assert kinds == ["joint", *["cartesian"] * 4]
    assert program.moves == (0, 1, 2, 3, 4, 5)
    assert "the target is computed at run time" in reasons(program)


def test_search_points_and_displacements_are_listed() -> None:
    program = read_program(SAMPLES / "weldline.mod", [SAMPLES / "cell.sys"])
    targets = by_name(program)
    assert list(targets) == ["pW10", "pW20", "pSearch"]
    assert "the program assigns it at run time in line 11" in reasons(program)
    assert "pBad lacks some of the numbers of a robtarget" in reasons(program)
    assert any(reason.startswith("PDispOn moves targets") for reason in reasons(program))
    np.testing.assert_allclose(targets["pW20"].tool.frame.xyz, (0, 0, 0.4005))
    assert targets["pW10"].tool is None, "two tools go to it"


def test_ten_thousand_targets_take_linear_time(tmp_path: Path) -> None:
    unused = "[9E9,9E9,9E9,9E9,9E9,9E9]"
    lines = [f"CONST robtarget p{i}:=[[{i},0,1],[1,0,0,0],[0,0,0,0],{unused}];" for i in range(10_000)]
    moves = [f"MoveL p{i},v100,fine,tool0;" for i in range(10_000)]
    path = saved(tmp_path / "large.mod", "\n".join(["MODULE a", *lines, "PROC main()", *moves, "ENDPROC", "ENDMODULE"]))
    program = read_program(path)
    assert len(program.targets) == len(program.moves) == 10_000
    np.testing.assert_allclose([target.values[0] for target in program.targets], np.arange(10_000) * 1e-3)


def test_positions_have_frames_configuration_and_motion() -> None:
    program = read_program(SAMPLES / "pick.ls")
    assert [target.name for target in program.targets] == ["P[1]", "P[2:Prise]", "P[3]", "P[4]"]
    assert program.moves == (0, 1, 1, 2, 3)
    assert program.targets[3].configuration == "F U T, 0, -1, 1"
    tool, base = program.targets[0].tool, program.targets[0].base
    assert (tool.name, tool.frame, base.name, base.frame) == ("3", None, "1", None)
    assert program.targets[2].base.frame is not None


def test_wpr_turns_about_fixed_axes() -> None:
    target = read_program(SAMPLES / "pick.ls").targets[1]
    np.testing.assert_allclose(target.values[:3], (0.534015, 0.478032, 0.637))
    x, y, z, w = Rotation.from_euler("xyz", (-0.098, 19.856, -179.9), degrees=True).as_quat()
    np.testing.assert_allclose(np.abs(np.dot((w, x, y, z), target.values[3:])), 1, atol=1e-15)


def test_offsets_and_registers_are_listed() -> None:
    reasons = {note.line: note.reason for note in read_program(SAMPLES / "pick.ls").notes}
    lines = (SAMPLES / "pick.ls").read_text(encoding="cp1252").splitlines()
    at = {line.split(":")[0].strip(): k for k, line in enumerate(lines, start=1) if line[:4].strip().isdecimal()}
    assert reasons[at["6"]] == "Offset moves the target at run time"
    assert reasons[at["9"]] == reasons[at["10"]] == "the target is in a register, which is known at run time only"
    assert len(reasons) == 3


def test_joints_and_other_groups() -> None:
    program = read_program(SAMPLES / "home.ls")
    np.testing.assert_allclose(program.targets[0].values, np.radians([0, -12.5, 45, 0, -0.5, 200]))
    assert len(program.targets) == 2


def test_untaught_and_incremental_positions_are_left_alone() -> None:
    german = read_program(SAMPLES / "german.ls")
    assert [target.name for target in german.targets] == ["P[2]"]
    assert [note.reason for note in german.notes] == [
        "P[1] is not a target of this program",
        "P[1] is not taught, or lacks some of its numbers",
    ]
    program = read_program(SAMPLES / "incr.ls")
    assert [target.name for target in program.targets] == ["P[1]"]
    assert "the motion in line 5 is incremental" in [note.reason for note in program.notes]


def test_columns_stay_aligned() -> None:
    program = read_program(SAMPLES / "pick.ls")
    values = [(-0.0005, *target.values[1:]) for target in program.targets]
    lines = with_targets(program, values).decode("cp1252").splitlines()
    assert "\tX =     -.500  mm,\tY =   397.980  mm,\tZ =  1033.305  mm," in lines


def test_variables_literals_and_inverse_kinematics_are_targets() -> None:
    program = read_program(SAMPLES / "pick.script")
    assert [(target.name, target.kind) for target in program.targets] == [
        ("home", "joint"),
        ("above_p", "cartesian"),
        ("line 10", "cartesian"),
        ("line 12", "cartesian"),
        ("line 13", "cartesian"),
    ]
    above = program.targets[1]
    np.testing.assert_allclose(above.values[:3], (-0.050273197644, -0.341535366440, 0.102459786423))
    vector = (-0.032924896149, 3.141372266899, -0.000292544836)
    x, y, z, w = Rotation.from_rotvec(vector).as_quat()
    np.testing.assert_allclose(np.abs(np.dot((w, x, y, z), above.values[3:])), 1, atol=1e-15)
    np.testing.assert_allclose(above.tool.frame.xyz, (0, 0, 0.0777))


def test_what_is_computed_is_listed() -> None:
    notes = {note.line: note.reason for note in read_program(SAMPLES / "pick.script").notes}
    assert notes == {
        7: "is a pose that no motion goes to directly",
        11: "the target is computed at run time",
        14: "the target is computed at run time",
    }


def test_the_tcp_is_known_only_where_the_text_decides_it() -> None:
    program = read_program(SAMPLES / "polyscope.script")
    tools = {round(target.values[0], 3): target.tool for target in program.targets}
    assert tools[0.1] is None, "a routine may be called with any TCP"
    assert tools[0.4] is None, "the call at the loop's end changes the TCP"
    assert tools[0.374] is None
    assert tools[0.5] is None


def test_variables_that_change_are_left_alone() -> None:
    program = read_program(SAMPLES / "changed.script")
    assert [target.line for target in program.targets] == [17]
    assert program.targets[0].tool is None, "a TCP that is set in a branch is unknown after it"
    assert {note.line: note.reason for note in program.notes} == {
        6: "the program assigns target at run time in line 5",
        10: "the program assigns start at run time in line 9",
        13: "the program assigns other at run time in line 12",
    }


def test_a_routine_that_sets_the_tcp_through_another_leaves_it_unknown(tmp_path: Path) -> None:
    lines = [
        "def inner():",
        "  set_tcp(p[0,0,0.1,0,0,0])",
        "end",
        "def outer():",
        "  inner()",
        "end",
        "set_tcp(p[0,0,0.2,0,0,0])",
        "movel(p[0.1,0,0,0,0,0])",
        "outer()",
        "movel(p[0.2,0,0,0,0,0])",
    ]
    first, second = read_program(saved(tmp_path / "calls.script", "\n".join(lines))).targets
    assert first.tool is not None
    assert second.tool is None
