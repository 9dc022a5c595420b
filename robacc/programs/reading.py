"""Reader of robot programs: recognises the dialect and reads the files that belong to a program.

Other packages add dialects, see :data:`PLUG_INS`.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from importlib import import_module
from pathlib import Path, PurePath
from typing import Any

from robacc.errors import InputError, Problem
from robacc.io.files import read_bytes, read_text
from robacc.io.yaml_nodes import top_section
from robacc.plug_ins import plug_in, plug_in_names
from robacc.programs.program import PROGRAM_LIMIT, Program, ProgramFrame, ProgramSource
from robacc.robots.description import Frame
from robacc.robots.yaml_robot import FRAMES, read_fields, read_units

PLUG_INS = "robacc.programs"
"""Group of entry points that add dialects.

The name of an entry point is the suffix of the files, without its point; its object, such as a module, has ``SIGN``, a
pattern of text that only such programs have, ``companions(path)``, the paths of files that a program is read with, and
``parse(source, others)``, the :class:`Program`.
"""
SUFFIXES = {
    ".src": "krl",
    ".dat": "krl",
    ".sub": "krl",
    ".mod": "rapid",
    ".modx": "rapid",
    ".sys": "rapid",
    ".sysx": "rapid",
    ".prg": "rapid",
    ".ls": "fanuc",
    ".script": "urscript",
    ".urscript": "urscript",
}
"""Suffixes of program files."""
_TABLES = frozenset({"", ".csv", ".tsv", ".txt", ".xlsx", ".parquet"})
"""Suffixes of tables of poses, about which no plug-in is asked."""
_BINARY = {
    ".tp": ("is a binary TP program", "write it as text first: kconvars/PrintTP, or Save As ASCII on the pendant"),
    ".urp": ("is a PolyScope program, whose script is not in it as text", "give the .script file beside it"),
    ".jbi": (
        "is a job of Yaskawa, whose positions count pulses of the motors",
        "list the joint angles in degrees, or the poses, in a CSV",
    ),
    ".va": ("is a listing of FANUC variables", "save the positions as a TP program (.ls), or list them in a CSV"),
    ".pgx": ("is a VAL3 program, whose points are in the data file of its application", "give the .dtx file beside it"),
    ".pjx": ("is a VAL3 project, whose points are in its data files", "give the .dtx file beside it"),
    ".pcp": ("is a compiled KAREL program", "its positions are not in a text that can be edited"),
}
_SIGNS = (
    ("fanuc", re.compile(r"^/PROG\b", re.M)),
    ("urscript", re.compile(r"^\s*(?:def|thread|sec)\s+\w+\s*\([^)\n]*\)\s*:", re.M)),
    ("rapid", re.compile(r"^\s*(?:%%%|MODULE\s+\w|(?:LOCAL\s+)?PROC\s+\w)", re.I | re.M)),
    ("krl", re.compile(r"^\s*(?:&ACCESS\b|(?:GLOBAL\s+)?DEF(?:DAT|FCT)?\s+[\w$])", re.I | re.M)),
    ("urscript", re.compile(r"\b(?:movej|movel|movep|movec)\s*\(")),
)
"""Texts that only programs of a dialect have, in the order in which they are looked for."""


def is_program(path: str | os.PathLike[str]) -> bool:
    """Return whether the name of a file is that of a robot program."""
    suffix = PurePath(os.fspath(path)).suffix.lower()
    return suffix in SUFFIXES or suffix in _BINARY or (suffix not in _TABLES and suffix[1:] in plug_in_names(PLUG_INS))


def mistaken_for_poses(path: str | os.PathLike[str]) -> Problem | None:
    """Return the problem of a file that was given as measured poses and is a robot program; None for another file."""
    name = os.fspath(path)
    suffix = PurePath(name).suffix.lower()
    if suffix in _BINARY:
        return Problem(_BINARY[suffix][0], name, fix="give the file of measured poses, such as a CSV")
    if is_program(name) and _reader_by_text(_source(name).text) is not None:
        fix = "give the file of measured poses, and the program with `commanded`"
        return Problem("is a robot program, which has commands but no measured poses", name, fix=fix)
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
    if suffix in _BINARY:
        message, fix = _BINARY[suffix]
        raise InputError(Problem(message, name, fix=fix))
    source = _source(name)
    # The dialect is that of the text, or of the suffix where the text is no proof.
    reader = _reader_by_text(source.text)
    if reader is None and suffix in SUFFIXES:
        reader = import_module(f"robacc.programs.{SUFFIXES[suffix]}")
    elif reader is None and suffix[1:] in plug_in_names(PLUG_INS):
        reader = plug_in(PLUG_INS, suffix[1:])
    if reader is None:
        fix = "give KUKA .src or .dat, ABB .mod, FANUC .ls, URScript .script or Staubli .dtx"
        raise source.error("is not a robot program that robacc reads", fix=fix)
    paths = [os.fspath(frame) for frame in frames]
    tables = [path for path in paths if PurePath(path).suffix.lower() in (".yaml", ".yml")]
    others = [*getattr(reader, "companions", companions)(name), *(path for path in paths if path not in tables)]
    program: Program = reader.parse(source, [_source(other) for other in others])
    for table in tables:
        program = with_frames(program, parse_frames(read_text(table), table))
    return program


def _reader_by_text(text: str) -> Any:
    """Return the module of the dialect that alone has such a text; None where there is none."""
    for dialect, sign in _SIGNS:
        if sign.search(text):
            return import_module(f"robacc.programs.{dialect}")
    readers = (plug_in(PLUG_INS, name) for name in plug_in_names(PLUG_INS))
    return next((reader for reader in readers if reader.SIGN.search(text)), None)


def _source(name: str) -> ProgramSource:
    return ProgramSource.of(read_bytes(name, PROGRAM_LIMIT), name)


def companions(name: str) -> list[str]:
    """Return the path of the ``.dat`` of a ``.src`` or of the ``.src`` of a ``.dat``, where it exists."""
    path = Path(name)
    wanted = {".src": ".dat", ".dat": ".src"}.get(path.suffix.lower(), "")
    names = (path.with_suffix(suffix) for suffix in (wanted, wanted.upper(), wanted.capitalize()) if suffix)
    return [os.fspath(other) for other in names if other.is_file()][:1]


# Tools and bases that a controller knows by number or name and a program does not contain, from a YAML file.

DEFAULT = "default"
"""Name of the frame of targets for which the program names none."""


def parse_frames(text: str, file: str) -> dict[str, Mapping[str, Frame]]:
    """Return ``tools`` in the flange's frame and ``bases`` in the robot's base frame, by name, of a YAML file.

    Raises:
        InputError: The file has problems; the error carries all of them, with line and key.
    """
    top = top_section(text, file, ("units", "tools", "bases"))
    table = read_fields(top, {"tools": FRAMES, "bases": FRAMES}) if read_units(top) else {}
    top.source.finish()
    return table


def with_frames(program: Program, table: Mapping[str, Mapping[str, Frame]]) -> Program:
    """Return the program with the frames of a table where the program names a frame but does not define it.

    Names are compared without regard to case. The frame :data:`DEFAULT` stands for one that the program does not name.
    """
    tools, bases = ({name.lower(): at for name, at in table.get(key, {}).items()} for key in ("tools", "bases"))

    def known(frame: ProgramFrame | None, names: Mapping[str, Frame]) -> ProgramFrame | None:
        if frame is None:
            return ProgramFrame(DEFAULT, names[DEFAULT]) if DEFAULT in names else None
        return ProgramFrame(frame.name, names.get(frame.name.lower())) if frame.frame is None else frame

    targets = [replace(t, tool=known(t.tool, tools), base=known(t.base, bases)) for t in program.targets]
    return replace(program, targets=tuple(targets))
