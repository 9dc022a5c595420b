"""Damaged programs are read or refused with a message; they never crash, and their bytes come back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from robacc.errors import InputError
from robacc.programs.reading import read_program
from robacc.programs.writing import with_targets

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
