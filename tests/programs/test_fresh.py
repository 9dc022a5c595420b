"""New programs are read back with the targets that they were written with."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from robacc.errors import UsageError
from robacc.programs.program import read_program
from robacc.programs.targets import SUFFIX, write_program

JOINTS = [(0.1, -1.2, 1.3, -0.4, 0.5, 3.0), (0.0, -1.5707963, 1.5707963, 0.0, 1e-9, -3.1)]
RESOLUTION = {"fanuc": 1.2e-5}
"""rad; .LS files have three decimals of degrees."""


@pytest.mark.parametrize("dialect", SUFFIX)
def test_new_programs_are_read_back(dialect: str, tmp_path: Path) -> None:
    targets = [(f"j{i}", q) for i, q in enumerate(JOINTS)]
    text = write_program(dialect, targets, name="acceptance 1")
    path = tmp_path / f"new{SUFFIX[dialect]}"
    path.write_bytes(text.encode("ascii"))
    program = read_program(path)
    assert program.dialect is dialect
    assert program.notes == ()
    order = list(program.moves)
    assert [program.targets[i].kind for i in order] == ["joint"] * 2
    for i, wanted in zip(order, JOINTS, strict=True):
        values = np.array(program.targets[i].values)
        assert np.all(np.abs(values - np.array(wanted)) <= RESOLUTION.get(dialect, 3e-7))


def test_line_ends_are_those_of_the_controller() -> None:
    targets = [("a", JOINTS[0])]
    for dialect in ("krl", "rapid", "fanuc"):
        text = write_program(dialect, targets)
        assert text.count("\n") == text.count("\r\n") > 3
    assert "\r" not in write_program("urscript", targets)


def test_a_prismatic_joint_is_in_mm() -> None:
    text = write_program("krl", [("a", (0.5, 0.25))], linear=[1])
    assert "PTP {A1 28.64789,A2 250.00000}" in text


@pytest.mark.parametrize(
    ("dialect", "joints", "message"),
    [
        ("krl", 7, "target a has 7 joints; a krl program's targets have 1 to 6"),
        ("urscript", 5, "a URScript target has 6"),
    ],
)
def test_what_a_dialect_cannot_hold_is_refused(dialect: str, joints: int, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        write_program(dialect, [("a", [0.1] * joints)])
