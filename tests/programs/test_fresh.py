"""New programs are read back with the targets that they were written with."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from robacc.errors import UsageError
from robacc.programs.program import Dialect
from robacc.programs.reading import read_program
from robacc.programs.writing import SUFFIX, cartesian_target, joint_target, write_program

JOINTS = [(0.1, -1.2, 1.3, -0.4, 0.5, 3.0), (0.0, -1.5707963, 1.5707963, 0.0, 1e-9, -3.1)]
POSES = [(0.8, -0.25, 1.2, 0.5, 0.5, -0.5, 0.5), (0.7, 0.0, 0.3, 0.0, 1.0, 0.0, 0.0)]
RESOLUTION = {Dialect.fanuc: (0.51e-6, 1.2e-5)}
"""m and rad; .LS files have three decimals of mm and degrees."""


@pytest.mark.parametrize("dialect", [dialect for dialect in Dialect if dialect in SUFFIX])
def test_new_programs_are_read_back(dialect: Dialect, tmp_path: Path) -> None:
    targets = [joint_target(f"j{i}", q) for i, q in enumerate(JOINTS)]
    targets += [cartesian_target(f"c{i}", values) for i, values in enumerate(POSES)]
    text = write_program(dialect, targets, name="acceptance 1", pause=1.5)
    path = tmp_path / f"new{SUFFIX[dialect]}"
    path.write_bytes(text.encode("ascii"))
    program = read_program(path)
    assert program.dialect is dialect
    assert program.notes == ()
    order = [move.target for move in program.moves]
    assert [program.targets[i].kind for i in order] == ["joint"] * 2 + ["cartesian"] * 2
    assert [program.targets[i].motion for i in order] == ["joint"] * 2 + ["linear"] * 2
    length, angle = RESOLUTION.get(dialect, (1e-7, 3e-7))
    for i, wanted in zip(order, [*JOINTS, *POSES], strict=True):
        values = np.array(program.targets[i].values)
        expected = np.array(wanted)
        if program.targets[i].kind == "cartesian":
            expected[3:] *= np.sign(np.dot(expected[3:], values[3:]))
            assert np.all(np.abs(values - expected) <= [length] * 3 + [angle] * 4)
        else:
            assert np.all(np.abs(values - expected) <= angle)


def test_line_ends_are_those_of_the_controller() -> None:
    targets = [joint_target("a", JOINTS[0])]
    for dialect in (Dialect.krl, Dialect.rapid, Dialect.fanuc):
        text = write_program(dialect, targets)
        assert text.count("\n") == text.count("\r\n") > 3
    assert "\r" not in write_program(Dialect.urscript, targets)


def test_a_prismatic_joint_is_in_mm() -> None:
    text = write_program(Dialect.krl, [joint_target("a", (0.5, 0.25))], linear=[1])
    assert "PTP {A1 28.64789,A2 250.00000}" in text


@pytest.mark.parametrize(
    ("dialect", "joints", "options", "message"),
    [
        (Dialect.krl, 7, {}, "target a has 7 joints; a krl program's targets have 1 to 6"),
        (Dialect.urscript, 5, {}, "a URScript target has 6"),
        (Dialect.krl, 6, {"speed": 0.0}, "not a fraction of the largest"),
        (Dialect.krl, 6, {"pause": float("nan")}, "cannot be waited for"),
    ],
)
def test_what_a_dialect_cannot_hold_is_refused(
    dialect: Dialect, joints: int, options: dict[str, float], message: str
) -> None:
    with pytest.raises(UsageError, match=message):
        write_program(
            dialect,
            [joint_target("a", [0.1] * joints)],
            speed=options.get("speed", 0.1),
            pause=options.get("pause", 1.0),
        )
