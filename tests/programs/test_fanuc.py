"""FANUC .LS: positions, frames and notes of the sample programs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from robacc.programs.program import read_program
from robacc.programs.targets import with_targets

SAMPLES = Path(__file__).parent / "samples"


def test_positions_have_frames_configuration_and_motion() -> None:
    program = read_program(SAMPLES / "pick.ls")
    assert [target.name for target in program.targets] == ["P[1]", "P[2:Prise]", "P[3]", "P[4]"]
    assert program.moves == (0, 1, 1, 2, 3)
    assert program.targets[3].configuration == "F U T, 0, -1, 1"
    tool, base = program.targets[0].tool, program.targets[0].base
    assert (tool.name, tool.frame, base.name, base.frame) == ("3", None, "1", None)
    world = program.targets[2].base
    assert world.frame is not None


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
