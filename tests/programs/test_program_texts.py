"""Programs of KUKA, ABB, FANUC and Universal Robots."""

import dataclasses
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
from sample_files import agreed, saved
from scipy.spatial.transform import Rotation

from robacc import InputError, Robot, read_robot
from robacc.api.correct import correct_program
from robacc.geometry import Array
from robacc.programs.program import Program, ProgramFrame, read_program
from robacc.programs.targets import with_targets
from robacc.robots.arm import Arm
from robacc.robots.description import Frame
from robacc_plugins.krl import allowed_by_status, joint_window
from robacc_plugins.rapid import allowed_by_cfx

SAMPLES = Path(__file__).parent / "samples"
MM, DEGREES = 3 * (1e3,), 3 * (180.0 / np.pi,)


def notes(program: Program) -> dict[int, str]:
    return {note.line: note.reason for note in program.notes}


READ = {
    **dict.fromkeys(("weld.dat", "expert.src", "spline.dat"), ("config.dat",)),
    **dict.fromkeys(("weld.src", "expert.dat", "glue.mod", "array.mod", "literal.mod"), ()),
    "weldline.mod": ("cell.sys",),
    **dict.fromkeys(("pick.ls", "home.ls", "german.ls", "incr.ls"), ()),
    **dict.fromkeys(("pick.script", "polyscope.script", "changed.script"), ()),
    **dict.fromkeys(("val3/cell.dtx", "val3/scara.dtx"), ()),
}
"""Sample programs, and the files that are read beside them."""


def numbers(values: Iterable[float], *factors: float) -> str:
    return " ".join(f"{round(value * factor, 4) + 0.0:g}" for value, factor in zip(values, factors, strict=True))


def placed(frame: ProgramFrame | None) -> str:
    if frame is None or frame.frame is None:
        return f"{frame.name} of unknown place" if frame else "unknown"
    return f"{frame.name!r} {numbers((*frame.frame.xyz, *frame.frame.rpy), *MM, *DEGREES)}"


def listing(name: str) -> str:
    """Moves, targets and notes of a sample, in mm and degrees."""
    program = read_program(SAMPLES / name, [SAMPLES / other for other in READ[name]])
    lines = [f"{name}, {program.dialect}: moves {program.moves}"]
    for target in program.targets:
        factors = 6 * (DEGREES[0],) if target.kind == "joint" else (*MM, 1.0, 1.0, 1.0, 1.0)
        lines.append(f"{target.line}: {target.name}, {target.kind} {numbers(target.values, *factors)}")
        lines.append(f"  tool {placed(target.tool)}; base {placed(target.base)}; {target.configuration}".rstrip("; "))
    lines += [f"{note.line}: {note.text!r} left alone, {note.reason}" for note in program.notes]
    return "".join(f"{line}\n" for line in lines)


def test_samples_have_their_targets_frames_moves_and_notes() -> None:
    text = "\n".join(map(listing, READ))
    assert text == agreed("programs.txt", text)


@pytest.mark.parametrize(
    ("name", "number", "turn"),
    [
        ("weld.dat", 1, Rotation.from_euler("ZYX", (177.082932, 4.31955290, -0.298484027), degrees=True)),
        ("glue.mod", 0, Rotation.from_quat((0.727571, 0.686033, -2.82384e-06, 1.13796e-06))),
        ("pick.ls", 1, Rotation.from_euler("xyz", (-0.098, 19.856, -179.9), degrees=True)),
        ("pick.script", 1, Rotation.from_rotvec((-0.032924896149, 3.141372266899, -0.000292544836))),
    ],
)
def test_orientations_are_those_of_each_dialect(name: str, number: int, turn: Rotation) -> None:
    w, x, y, z = read_program(SAMPLES / name).targets[number].values[3:]
    np.testing.assert_allclose(Rotation.from_quat((x, y, z, w)).as_matrix(), turn.as_matrix(), atol=1e-12)


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


def test_ten_thousand_targets_take_linear_time(tmp_path: Path) -> None:
    unused = "[9E9,9E9,9E9,9E9,9E9,9E9]"
    lines = [f"CONST robtarget p{i}:=[[{i},0,1],[1,0,0,0],[0,0,0,0],{unused}];" for i in range(10_000)]
    moves = [f"MoveL p{i},v100,fine,tool0;" for i in range(10_000)]
    path = saved(tmp_path / "large.mod", "\n".join(["MODULE a", *lines, "PROC main()", *moves, "ENDPROC", "ENDMODULE"]))
    program = read_program(path)
    assert len(program.targets) == len(program.moves) == 10_000
    np.testing.assert_allclose([target.values[0] for target in program.targets], np.arange(10_000) * 1e-3)


def test_columns_stay_aligned() -> None:
    program = read_program(SAMPLES / "pick.ls")
    values = [(-0.0005, *target.values[1:]) for target in program.targets]
    lines = with_targets(program, values).decode("cp1252").splitlines()
    assert "\tX =     -.500  mm,\tY =   397.980  mm,\tZ =  1033.305  mm," in lines


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
