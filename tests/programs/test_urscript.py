"""URScript: targets, TCP and notes of the sample scripts."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from robacc.programs.program import read_program

SAMPLES = Path(__file__).parent / "samples"


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
    path = tmp_path / "calls.script"
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
    path.write_text("\n".join(lines), encoding="ascii")
    first, second = read_program(path).targets
    assert first.tool is not None
    assert second.tool is None
