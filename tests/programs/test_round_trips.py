"""Programs that are read, changed and written: round trips, mutations, frames, and new programs."""

import re
from pathlib import Path

import numpy as np
import pytest
from sample_files import saved
from scipy.spatial.transform import Rotation

from robacc.errors import InputError, UsageError
from robacc.programs.program import Program, ProgramFrame, ProgramSource, read_program
from robacc.programs.targets import flange_targets, joint_targets, values_at, with_targets
from robacc.robots.description import Frame
from robacc_plugins import fanuc, krl, rapid, urscript
from robacc_plugins.dialects import NUMBER

WRITERS = {"krl": krl, "rapid": rapid, "fanuc": fanuc, "urscript": urscript}
FOLDER = Path(__file__).parent / "samples"
SAMPLES = sorted(path for path in (*FOLDER.iterdir(), *FOLDER.glob("val3/*.dtx")) if path.is_file())


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
    path = saved(tmp_path / Path(program.file).name, data)
    return read_program(path)


def test_every_dialect_has_six_samples() -> None:
    counts = dict.fromkeys((*WRITERS, "val3"), 0)
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
def test_new_values_are_read_back_and_nothing_else_changes(path: Path, tmp_path: Path) -> None:
    program = read_program(path)
    wanted = moved(program, 1e-3)
    data = with_targets(program, wanted)
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
    again = reread(program, data, tmp_path)
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
        ("mod", b"MODULE a\nVAR jointtarget j1 = j:{1,2}{EJ 0}\nGLOBAL PROC main()\n", ":2: is a program of ROKAE"),
        ("script", b"def a():\n  movej([0,0,0,0,0,0])\n", ":1: is truncated: this def has no end"),
        ("script", b"def a():\n  movej([0,0,0,\nend\n", ":2: is truncated: this bracket is not closed"),
        ("src", b"DEF a()\r\nPTP {A1 0,A2 0,A3 0,A4 0,A5 0,A6 0}\r\n", "line 1|:1: is truncated"),
        ("src", b"PTP XP1\r\n", "has no DEF"),
        ("src", b"DEF a()\r\n; K\xc3\xbcche\r\n; K\xfcche\r\nEND\r\n", ":3: mixes UTF-8 with another encoding"),
        ("src", b"DEF a()\r\n\0\0\r\nEND\r\n", ":2: is not a text file"),
    ],
)
def test_bad_programs_get_one_message(suffix: str, text: bytes, message: str, tmp_path: Path) -> None:
    path = saved(tmp_path / f"bad.{suffix}", text)
    with pytest.raises(InputError, match=message) as caught:
        read_program(path)
    assert len(caught.value.problems) == 1


def matrix(xyz: tuple[float, ...], rotation: Rotation) -> np.ndarray:
    result = np.eye(4)
    result[:3, :3] = rotation.as_matrix()
    result[:3, 3] = xyz
    return result


def test_the_flange_is_where_tool_and_base_say() -> None:
    program = read_program(FOLDER / "weld.dat", [FOLDER / "config.dat"])
    numbers, flange, _ = flange_targets(program)
    assert numbers == (0, 1, 2, 3)
    # The numbers of $config.dat and of XP2, by hand.
    base = matrix((1.2, -0.4, 0.35), Rotation.from_euler("ZYX", (90, 0, 0), degrees=True))
    tool = matrix((0.0875, 0, 0.41225), Rotation.from_euler("ZYX", (0, -45, 0), degrees=True))
    angles = (177.082932, 4.31955290, -0.298484027)
    target = matrix((1.58776917, -0.890400757, 0.439605072), Rotation.from_euler("ZYX", angles, degrees=True))
    np.testing.assert_allclose(flange.matrices()[1], base @ target @ np.linalg.inv(tool), atol=1e-12)


def test_the_way_back_gives_the_values() -> None:
    for name, frames in (("weld.dat", ["config.dat"]), ("glue.mod", []), ("pick.script", [])):
        program = read_program(FOLDER / name, [FOLDER / frame for frame in frames])
        numbers, flange, _ = flange_targets(program)
        assert numbers
        for i, values in zip(numbers, values_at(program, numbers, flange), strict=True):
            before = np.array(program.targets[i].values)
            after = np.array(values)
            after[3:] *= np.sign(np.dot(after[3:], before[3:]))
            np.testing.assert_allclose(after, before, atol=1e-12)


def test_unknown_frames_are_named() -> None:
    numbers, flange, unknown = flange_targets(read_program(FOLDER / "pick.ls"))
    assert numbers == ()
    assert flange.translation.shape == (3, 0)
    assert unknown[0] == (0, "the tool 3 is in none of the files read")
    assert flange_targets(read_program(FOLDER / "changed.script"))[2] == (
        (0, "the program names no tool, or several, for this target"),
    )


def test_joint_targets_are_columns() -> None:
    numbers, q = joint_targets(read_program(FOLDER / "lines.script"))
    assert numbers == (0, 1, 2)
    np.testing.assert_allclose(q[0], (0, 0.1, 0.2))
    assert q.shape == (6, 3)


FRAMES = """
units: {length: mm, angle: deg}
tools:
  3: {xyz: [0, 0, 120], rpy: [0, 90, 0]}
  default: {xyz: [0, 0, 50]}
bases: {1: {xyz: [1000, 0, 0]}}
"""


def test_frames_are_taken_by_number_and_default_for_those_without_a_name(tmp_path: Path) -> None:
    path = saved(tmp_path / "frames.yaml", FRAMES)
    target = read_program(FOLDER / "pick.ls", [path]).targets[0]
    np.testing.assert_allclose((target.tool.frame.xyz, target.tool.frame.rpy), ((0, 0, 0.12), (0, np.pi / 2, 0)))
    np.testing.assert_allclose(target.base.frame.xyz, (1, 0, 0))
    targets = read_program(FOLDER / "lines.script", [path]).targets
    assert {target.tool for target in targets} == {ProgramFrame("default", Frame((0.0, 0.0, 0.05)))}


def test_problems_have_line_and_key(tmp_path: Path) -> None:
    path = saved(tmp_path / "frames.yaml", "units: {length: mm, angle: deg}\ntools:\n  3: {xyz: [0, 0]}\n")
    with pytest.raises(InputError, match=r"frames.yaml:3, tools.3.xyz: expected a list of 3 numbers"):
        read_program(FOLDER / "pick.ls", [path])


JOINTS = [(0.1, -1.2, 1.3, -0.4, 0.5, 3.0), (0.0, -1.5707963, 1.5707963, 0.0, 1e-9, -3.1)]
RESOLUTION = {"fanuc": 1.2e-5}
"""rad; .LS files have three decimals of degrees."""


@pytest.mark.parametrize("dialect", WRITERS)
def test_new_programs_are_read_back(dialect: str, tmp_path: Path) -> None:
    targets = [(f"j{i}", q) for i, q in enumerate(JOINTS)]
    text = WRITERS[dialect].write(targets, name="acceptance 1")
    path = saved(tmp_path / f"new{WRITERS[dialect].NEW_SUFFIX}", text.encode("ascii"))
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
        text = WRITERS[dialect].write(targets)
        assert text.count("\n") == text.count("\r\n") > 3
    assert "\r" not in urscript.write(targets)


def test_a_prismatic_joint_is_in_mm() -> None:
    assert "PTP {A1 28.64789,A2 250.00000}" in krl.write([("a", (0.5, 0.25))], linear=[1])


@pytest.mark.parametrize(
    ("dialect", "joints", "message"),
    [
        ("krl", 7, "target a has 7 joints; a krl program's targets have 1 to 6"),
        ("urscript", 5, "a URScript target has 6"),
    ],
)
def test_what_a_dialect_cannot_hold_is_refused(dialect: str, joints: int, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        WRITERS[dialect].write([("a", [0.1] * joints)])
