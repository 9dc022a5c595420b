"""Every sample program comes back byte for byte but for its targets, and its targets come back as they were set."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from robacc.programs.program import NUMBER, Program, ProgramSource, read_program
from robacc.programs.targets import SUFFIX, with_targets

FOLDER = Path(__file__).parent / "samples"
SAMPLES = sorted(path for path in (*FOLDER.iterdir(), *FOLDER.glob("val3/*.dtx")) if path.is_file())
FANUC_RESOLUTION = 0.5e-3


def moved(program: Program, size: float, seed: int = 7) -> list[tuple[float, ...]]:
    """Values of all targets, each changed by about ``size`` m and rad, the quaternions of unit length."""
    random = np.random.default_rng(seed)
    result = []
    for target in program.targets:
        values = np.array(target.values) + size * random.uniform(0.5, 1.5, len(target.values))
        if target.kind == "cartesian":
            values[3:] /= np.linalg.norm(values[3:])
        result.append(tuple(float(value) for value in values))
    return result


def reread(program: Program, data: bytes, tmp_path: Path) -> Program:
    """The program of bytes, beside copies of the files that the sample is read with."""
    for path in (*SAMPLES, *FOLDER.glob("val3/*.p*")):
        (tmp_path / path.name).write_bytes(path.read_bytes())
    path = tmp_path / Path(program.file).name
    path.write_bytes(data)
    return read_program(path)


def test_every_dialect_has_six_samples() -> None:
    counts = dict.fromkeys((*SUFFIX, "val3"), 0)
    for path in SAMPLES:
        counts[read_program(path).dialect] += 1
    assert min(counts.values()) >= 6, counts


@pytest.mark.parametrize("path", SAMPLES, ids=lambda path: path.name)
def test_targets_that_keep_their_values_keep_every_byte(path: Path) -> None:
    program = read_program(path)
    data = path.read_bytes()
    assert with_targets(program, [None] * len(program.targets)) == data
    assert with_targets(program, [target.values for target in program.targets]) == data


@pytest.mark.parametrize("path", SAMPLES, ids=lambda path: path.name)
def test_only_numbers_of_targets_change(path: Path, tmp_path: Path) -> None:
    program = read_program(path)
    data = with_targets(program, moved(program, 1e-3))
    old, new = ProgramSource.of(path.read_bytes(), "old"), ProgramSource.of(data, "new")
    assert new.encoding == old.encoding
    # The same text between the numbers, but for the spaces before an aligned column.
    inside = sorted((n.start, n.end) for target in program.targets for n in target.numbers)
    pieces = []
    position = 0
    for start, end in inside:
        pieces.append(re.escape(old.text[position:start].rstrip(" ")) + " *" + NUMBER)
        position = end
    assert re.fullmatch("".join(pieces) + re.escape(old.text[position:]), new.text)


@pytest.mark.parametrize("path", SAMPLES, ids=lambda path: path.name)
def test_new_values_are_read_back(path: Path, tmp_path: Path) -> None:
    program = read_program(path)
    wanted = moved(program, 1e-3)
    again = reread(program, with_targets(program, wanted), tmp_path)
    assert len(again.targets) == len(program.targets)
    for before, after, values in zip(program.targets, again.targets, wanted, strict=True):
        assert (after.name, after.line, after.kind) == (before.name, before.line, before.kind)
        assert (after.tool, after.base, after.configuration) == (before.tool, before.base, before.configuration)
        new = np.array(values)
        if before.kind == "cartesian" and np.dot(new[3:], after.values[3:]) < 0:
            new[3:] *= -1
        # .LS files have three decimals of mm and degrees; the others resolve 0.1 um and 0.2 urad.
        length, angle = (6e-7, 1.5e-5) if program.dialect == "fanuc" else (1.01e-7, 3e-7)
        limits = [angle] * len(new) if before.kind == "joint" else [length] * 3 + [angle] * 4
        assert np.all(np.abs(new - after.values) <= limits), (before.name, new - after.values)


@pytest.mark.parametrize("path", SAMPLES, ids=lambda path: path.name)
def test_a_single_target_changes_alone(path: Path) -> None:
    program = read_program(path)
    lines = path.read_bytes().splitlines()
    for i, values in enumerate(moved(program, 1e-3)):
        changes: list[tuple[float, ...] | None] = [None] * len(program.targets)
        changes[i] = values
        after = with_targets(program, changes).splitlines()
        changed = [k + 1 for k, (a, b) in enumerate(zip(lines, after, strict=True)) if a != b]
        first = program.targets[i].line
        last = program.source.line(program.targets[i].numbers[-1].start)
        assert changed
        assert first <= min(changed) <= max(changed) <= last
