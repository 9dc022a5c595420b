"""Damaged programs are read or refused with a message; they never crash, and their bytes come back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from robacc.errors import InputError
from robacc.programs.program import read_program
from robacc.programs.targets import with_targets

FOLDER = Path(__file__).parent / "samples"
SAMPLES = sorted(path for path in (*FOLDER.iterdir(), *FOLDER.glob("val3/*.dtx")) if path.is_file())
PIECES = [
    b"{",
    b"}",
    b"[",
    b"]",
    b"(",
    b")",
    b",",
    b";",
    b":",
    b"=",
    b"\n",
    b"9E99",
    b"\xfc",
    b"\xc3\xbc",
    b"!",
    b'"',
    b"END",
]
MUTATIONS = 8


def damaged(data: bytes, random: np.random.Generator) -> bytes:
    """The bytes with a part cut off, removed, repeated or replaced."""
    start = int(random.integers(0, len(data) + 1))
    end = min(len(data), start + int(random.integers(0, 40)))
    kind = random.integers(0, 4)
    if kind == 0:
        return data[:start]
    if kind == 1:
        return data[:start] + data[end:]
    if kind == 2:
        return data[:end] + data[start:]
    return data[:start] + PIECES[int(random.integers(0, len(PIECES)))] + data[end:]


@pytest.mark.parametrize("path", SAMPLES, ids=lambda path: path.name)
def test_damaged_programs_do_not_crash(path: Path, tmp_path: Path) -> None:
    random = np.random.default_rng(sum(path.name.encode()))
    copy = tmp_path / path.name
    messages: list[int] = []
    for _ in range(MUTATIONS):
        data = damaged(path.read_bytes(), random)
        copy.write_bytes(data)
        try:
            program = read_program(copy)
        except InputError as error:
            messages.append(len(error.problems))
            continue
        assert with_targets(program, [None] * len(program.targets)) == data
        moved = [tuple(value + 1e-3 for value in target.values) for target in program.targets]
        assert with_targets(program, moved) != data or not moved
    assert set(messages) <= {1}, "one message a file"


@pytest.mark.parametrize(
    ("suffix", "text", "message"),
    [
        (
            "ls",
            b"/PROG A\n/MN\n   1:J P[1] 100% FINE ;\n/POS\nP[1]{\n   GP1:\n\tUF : 0, UT",
            "is truncated: it has no /END",
        ),
        (
            "ls",
            b"/PROG A\n/MN\n/POS\nP[1]{\n   GP1:\n\tUF : 0, UT : 1,\n/END\n",
            ":4: is truncated: this position has no }",
        ),
        ("mod", b"MODULE a\r\nPROC main()\r\nMoveL p10,v1", ":2: is truncated: this PROC has no ENDPROC"),
        ("mod", b"MODULE a\r\nPROC main()\r\nENDPROC\r\n", ":1: is truncated: this MODULE has no ENDMODULE"),
        ("mod", b"MODULE a\r\nENDPROC\r\nENDMODULE\r\n", ":2: ENDPROC ends no PROC"),
        ("script", b"def a():\n  movej([0,0,0,0,0,0])\n", ":1: is truncated: this def has no end"),
        ("script", b"def a():\n  movej([0,0,0,\nend\n", ":2: is truncated: this bracket is not closed"),
        ("src", b"DEF a()\r\nPTP {A1 0,A2 0,A3 0,A4 0,A5 0,A6 0}\r\n", "line 1|:1: is truncated"),
        ("src", b"PTP XP1\r\n", "has no DEF"),
        ("src", b"DEF a()\r\n; K\xc3\xbcche\r\n; K\xfcche\r\nEND\r\n", ":3: mixes UTF-8 with another encoding"),
        ("src", b"DEF a()\r\n\0\0\r\nEND\r\n", ":2: is not a text file"),
    ],
)
def test_bad_programs_get_one_message(suffix: str, text: bytes, message: str, tmp_path: Path) -> None:
    path = tmp_path / f"bad.{suffix}"
    path.write_bytes(text)
    with pytest.raises(InputError, match=message) as caught:
        read_program(path)
    assert len(caught.value.problems) == 1
