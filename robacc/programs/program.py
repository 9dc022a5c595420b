"""Robot program: its text, written back byte for byte, its targets and motions. Dialects are plug-ins."""

import os
import re
from bisect import bisect_right
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import PurePath
from typing import Any, Literal, NamedTuple, cast

import numpy as np

from robacc.errors import Problem, by_key, refuse
from robacc.geometry import Array, NDArray, Poses
from robacc.io.files import read_bytes, read_text
from robacc.io.yaml_nodes import top_section
from robacc.plug_ins import plug_in, plug_in_names, plug_ins
from robacc.robots.arm import Arm
from robacc.robots.description import Frame
from robacc.robots.yaml_robot import FRAMES, read_fields, read_units

# Text of a program that is written back byte for byte.

PROGRAM_LIMIT = 64 * 2**20
"""Largest program that is read, bytes."""


@dataclass(frozen=True, slots=True)
class ProgramSource:
    """Program text whose unchanged parts are written back byte for byte."""

    file: str
    text: str
    encoding: str
    """``utf-8``, ``latin-1`` (for Windows and all other code pages), ``utf-16-le`` or ``utf-16-be``."""
    _starts: tuple[int, ...] = field(repr=False, compare=False)

    @classmethod
    def of(cls, data: bytes, file: str) -> "ProgramSource":
        """Return the source of a program's bytes.

        Raises:
            InputError: The bytes are no text, or mix UTF-8 with another encoding.
        """
        text, encoding = _decode(data, file)
        return cls(file, text, encoding, (0, *(match.end() for match in re.finditer(r"\r\n|\n|\r", text))))

    def line(self, position: int) -> int:
        """Return the 1-based line of a place in the text."""
        return bisect_right(self._starts, position)

    def excerpt(self, start: int, end: int) -> str:
        """Return a part of the text for a message: on one line, at most 60 characters, in the file's characters."""
        text = self.text[start : min(end, start + 200)]
        if self.encoding == "latin-1":
            text = text.encode("latin-1").decode("cp1252", errors="replace")
        text = " ".join(text.split())
        return text if len(text) <= 60 else text[:59] + "…"

    def problem(self, message: str, position: int | None = None, fix: str | None = None) -> Problem:
        """Return the problem of a program that cannot be read."""
        return Problem(message, self.file, None if position is None else self.line(position), fix=fix)


def _decode(data: bytes, file: str) -> tuple[str, str]:
    """Return text and encoding; a UTF-16 text keeps its mark."""
    if wide := {b"\xff\xfe": "utf-16-le", b"\xfe\xff": "utf-16-be"}.get(data[:2]):
        no_text = "is not UTF-16 text though it begins with its mark"
        refuse(
            (_not_decoded(data, wide) is not None, Problem(no_text, file, fix="export it from the controller again"))
        )
        return data.decode(wide), wide
    before, nul, _ = data.partition(b"\0")
    refuse(
        (
            nul,
            Problem(
                "is not a text file: it contains a NUL byte",
                file,
                before.count(b"\n") + 1,
                fix="export it from the controller as text",
            ),
        )
    )
    wrong = _not_decoded(data, "utf-8")
    if wrong is None:
        return data.decode("utf-8"), "utf-8"
    # A line beyond ASCII that is valid UTF-8 is rarely text of another encoding, except of an East Asian code page,
    # whose pairs of bytes can look like UTF-8, and in which no other text decodes.
    has_utf8 = any(not line.isascii() and _not_decoded(line, "utf-8") is None for line in data.splitlines())
    refuse(
        (
            has_utf8 and all(_not_decoded(data, name) is not None for name in ("gb2312", "euc_kr", "euc_jp")),
            Problem(
                f"mixes UTF-8 with another encoding (byte 0x{data[wrong]:02x} is not UTF-8)",
                file,
                data.count(b"\n", 0, wrong) + 1,
                fix="save it in one encoding",
            ),
        )
    )
    return data.decode("latin-1"), "latin-1"


def _not_decoded(data: bytes, encoding: str) -> int | None:
    """Return the place of the first byte that is not of an encoding; None where all are."""
    try:
        data.decode(encoding)
    except UnicodeDecodeError as error:
        return error.start
    return None


# Conventions of robot programs for orientations, converted to unit quaternions and back.
#
# Numbers are batched ``(components, N)`` in m and rad. The way back chooses, among the numbers of one orientation,
# those nearest to the numbers in the program, so that a small correction changes them little.


@dataclass(frozen=True, slots=True)
class Convention:
    """Meaning of the numbers of a Cartesian target that follow x, y and z."""

    rotation: Callable[[Array], Array]
    """Rotations ``(3, 3, N)`` of the numbers."""
    numbers: Callable[[Array, Array], Array]
    """Numbers of unit quaternions ``(4, N)``, nearest to other numbers."""


def rotation_distance(first: Array, second: Array) -> Array:
    """Return the angle ``(N,)`` in rad between orientations given as unit quaternions ``(4, N)``."""
    squares = (np.sum(np.square(first + sign * second), axis=0) for sign in (-1, 1))
    return np.asarray(4 * np.arcsin(np.minimum(np.sqrt(np.minimum(*squares)) / 2, 1.0)))


@dataclass(frozen=True, slots=True)
class ProgramFrame:
    """Tool or base frame that a program names."""

    name: str
    """Name or number in the program: ``tGripper``, ``1``; empty where the program sets a frame without a name."""
    frame: Frame | None
    """Tool in the flange's frame, or base in the robot's base frame; None where the program does not contain it."""


@dataclass(frozen=True, slots=True)
class ProgramNumber:
    """Number of a target, and its place in the text."""

    start: int
    end: int
    value: float
    """Value in the program's unit."""
    unit: float
    """Size of the program's unit in m, rad or 1."""


@dataclass(frozen=True, slots=True)
class ProgramTarget:
    """Target, or frame, that is written in the program as numbers."""

    convention: Convention | None
    """None for joint variables."""
    numbers: tuple[ProgramNumber, ...]
    """Numbers in the order of the program's components."""
    configuration: str = ""
    """Configuration of a Cartesian target, as written: ``S 2,T 10``, ``[0,-1,0,0]``, ``N U T, 0, 0, 0``."""
    name: str = ""
    """Name in the program; ``line 12`` for a target without a name."""
    line: int = 0
    """1-based line of its first number."""
    values: tuple[float, ...] = ()
    """Joint target: joint variables, rad (m for a joint in mm), as the program counts them. Cartesian target:
    x, y, z (m) and the quaternion w, x, y, z of the tool in the base frame of the target."""
    tool: ProgramFrame | None = None
    """Tool of its motions; None where none is named, or where its motions name several."""
    base: ProgramFrame | None = None
    """Base frame (work object, user frame) of its motions; None as for ``tool``."""

    @property
    def place(self) -> tuple[int, int]:
        """Beginning of its first number in the text, and end of its last."""
        return self.numbers[0].start, self.numbers[-1].end

    @property
    def kind(self) -> Literal["joint", "cartesian"]:
        """Whether the numbers are joint variables or a pose."""
        return "joint" if self.convention is None else "cartesian"

    @property
    def frame(self) -> Frame:
        """Frame of Cartesian numbers."""
        values, turn = native_of([self]), cast(Convention, self.convention).rotation
        return Frame.of(Poses(turn(values[3:])[..., 0], values[:3, 0]))


@dataclass(frozen=True, slots=True)
class ProgramNote:
    """Part of the program that is left as it is, and the reason."""

    line: int
    text: str
    """Excerpt of the program."""
    reason: str


class ConfigurationRules(NamedTuple):
    """What the configurations of a dialect's Cartesian targets say of the joints of a six-axis arm."""

    window: Callable[[str], Array | None] = lambda text: None
    """Least and largest value ``(2, 6)`` of each joint, rad, infinite where a configuration says nothing; None for one
    that is not given, or not read."""
    allows: Callable[[Arm, str, Array], NDArray[np.bool_]] = lambda arm, text, q: np.ones(q.shape[1], dtype=bool)
    """``(N,)`` whether joints ``(J, N)`` of a nominal arm, with the identity as its base frame, have a configuration
    besides."""
    are_read_whole: bool = False
    """Whether nothing of them is unread."""


@dataclass(frozen=True, slots=True)
class Program:
    """Robot program that was read."""

    file: str
    dialect: str
    source: ProgramSource
    targets: tuple[ProgramTarget, ...]
    moves: tuple[int, ...]
    """Index of the target of each motion in the order of the text; loops and branches are not followed."""
    notes: tuple[ProgramNote, ...] = ()
    """Everything that the program computes at run time or that the reader does not know, by line."""
    configurations: ConfigurationRules = field(default_factory=ConfigurationRules)
    decimals: Mapping[float, int] = field(default_factory=dict)
    """Decimals of corrected numbers by their unit's size, where these are not what the correction needs."""


def by_convention(targets: Mapping[int, ProgramTarget]) -> Iterable[tuple[Convention | None, list[int]]]:
    """Return the keys of targets that are converted at once: of one convention and number of components."""
    groups = by_key(((target.convention, len(target.numbers)), i) for i, target in targets.items())
    return ((convention, rows) for (convention, _), rows in groups.items())


def native_of(targets: Sequence[ProgramTarget]) -> Array:
    """Return the programs' numbers ``(components, N)`` of targets of one convention, m and rad."""
    return np.array([[n.value * n.unit for n in target.numbers] for target in targets], dtype=float).T


# Reader of robot programs: recognises the dialect and reads the files that belong to a program.
#
# Dialects are plug-ins, see :data:`PLUG_INS`.

PLUG_INS = "robacc.programs"
"""Group of entry points that add dialects.

The name of an entry point is the suffix of the files, without its point; its object, such as a module, has ``SIGN``, a
pattern of text that only such programs have, ``parse(source, others)``, the :class:`Program`, and, where a program is
read with other files, ``companions(path)``, their paths.
"""
_TABLES = frozenset({"", ".csv", ".tsv", ".txt", ".xlsx", ".parquet"})
"""Suffixes of tables of poses, about which no plug-in is asked."""
_BINARY = {
    ".tp": ("is a binary TP program", "write it as text first: kconvars/PrintTP, or Save As ASCII on the pendant"),
    ".urp": ("is a PolyScope program, whose script is not in it as text", "give the .script file beside it"),
    ".jbi": ("is a job of Yaskawa", "list the joint angles in degrees, or the poses, in a CSV"),
    ".va": ("is a listing of FANUC variables", "save the positions as a TP program (.ls), or list them in a CSV"),
    ".pgx": ("is a VAL3 program, whose points are in the data file of its application", "give the .dtx file beside it"),
    ".pjx": ("is a VAL3 project, whose points are in its data files", "give the .dtx file beside it"),
    ".pcp": ("is a compiled KAREL program", "its positions are not in a text that can be edited"),
}
LISTINGS = (".jbi", ".va")
"""Suffixes of files among these whose positions are read as a table of commands or targets."""


def is_program(path: str | os.PathLike[str]) -> bool:
    """Return whether the name of a file is that of a robot program."""
    suffix = PurePath(os.fspath(path)).suffix.lower()
    return suffix in _BINARY or (suffix not in _TABLES and suffix[1:] in plug_in_names(PLUG_INS))


def mistaken_for_poses(path: str | os.PathLike[str]) -> Problem | None:
    """Return the problem of a file that was given as measured poses and is a robot program; None for another file."""
    name = os.fspath(path)
    suffix = PurePath(name).suffix.lower()
    if suffix in _BINARY:
        return Problem(_BINARY[suffix][0], name, fix="give the file of measured poses, such as a CSV")
    if is_program(name) and _reader_by_text(_source(name).text, suffix) is not None:
        return Problem(
            "is a robot program, which has commands but no measured poses",
            name,
            fix="give the file of measured poses, and the program with `commanded`",
        )
    return None


def read_program(path: str | os.PathLike[str], frames: Sequence[str | os.PathLike[str]] = ()) -> Program:
    """Read a robot program and the targets in it.

    Args:
        path: Program: KUKA ``.src``, ``.dat``; ABB ``.mod``, ``.modx``, ``.sys``, ``.prg``; FANUC ``.ls``; URScript
            ``.script``; Staubli ``.dtx``. A KUKA file is read together with the file of the same name and the other
            suffix, a Staubli file with the programs and the project in its folder.
        frames: Files that define tools and bases: files of the same dialect, such as ``$config.dat`` or a module with
            tooldata, and YAML files of frames by name.

    Raises:
        InputError: A file cannot be read, is no robot program, is truncated, or mixes encodings.
    """
    name = os.fspath(path)
    suffix = PurePath(name).suffix.lower()
    message, fix = _BINARY.get(suffix, ("", ""))
    refuse((message, Problem(message, name, fix=fix)))
    source = _source(name)
    # The dialect is that of the text, or of the suffix where the text is no proof.
    reader = _reader_by_text(source.text, suffix)
    if reader is None and suffix[1:] in plug_in_names(PLUG_INS):
        reader = plug_in(PLUG_INS, suffix[1:])
    fix = "give KUKA .src or .dat, ABB .mod, FANUC .ls, URScript .script or Staubli .dtx"
    refuse((reader is None, source.problem("is not a robot program that robacc reads", fix=fix)))
    paths = [os.fspath(frame) for frame in frames]
    tables = [path for path in paths if PurePath(path).suffix.lower() in (".yaml", ".yml")]
    others = [*_companions(reader, name), *(path for path in paths if path not in tables)]
    program: Program = reader.parse(source, [_source(other) for other in others])
    for table in tables:
        program = with_frames(program, table)
    return program


def _reader_by_text(text: str, suffix: str) -> Any:
    """Return the dialect that alone has such a text, that of the suffix first; None where there is none."""
    return next((reader for reader in plug_ins(PLUG_INS, suffix[1:]) if reader.SIGN.search(text)), None)


def _source(name: str) -> ProgramSource:
    return ProgramSource.of(read_bytes(name, PROGRAM_LIMIT), name)


def companions(path: str) -> list[str]:
    """Return the paths of other programs that a program is read with, such as the ``.dat`` of a ``.src``."""
    names, suffix = plug_in_names(PLUG_INS), PurePath(path).suffix.lower()[1:]
    others = _companions(plug_in(PLUG_INS, suffix), path) if suffix in names else []
    return [other for other in others if PurePath(other).suffix.lower()[1:] in names]


def _companions(reader: Any, path: str) -> list[str]:
    return list(reader.companions(path)) if hasattr(reader, "companions") else []


# Tools and bases that a controller knows by number or name and a program does not contain, from a YAML file.

DEFAULT = "default"
"""Name of the frame of targets for which the program names none."""


def with_frames(program: Program, path: str) -> Program:
    """Return the program with the frames of a YAML file where it names a frame but does not define it.

    The file has ``tools`` in the flange's frame and ``bases`` in the robot's base frame, by name. Names are compared
    without regard to case. The frame :data:`DEFAULT` stands for one that the program does not name.

    Raises:
        InputError: The file has problems; the error carries all of them, with line and key.
    """
    top = top_section(read_text(path), path, ("units", "tools", "bases"))
    table = read_fields(top, {"tools": FRAMES, "bases": FRAMES}) if read_units(top) else {}
    top.source.raise_if_any()
    tools, bases = ({name.lower(): at for name, at in table.get(key, {}).items()} for key in ("tools", "bases"))

    def known(frame: ProgramFrame | None, names: Mapping[str, Frame]) -> ProgramFrame | None:
        if frame is None:
            return ProgramFrame(DEFAULT, names[DEFAULT]) if DEFAULT in names else None
        return ProgramFrame(frame.name, names.get(frame.name.lower())) if frame.frame is None else frame

    return replace(
        program,
        targets=tuple(replace(t, tool=known(t.tool, tools), base=known(t.base, bases)) for t in program.targets),
    )
