"""Reader of robot programs: recognises the dialect and reads the files that belong to a program.

Other packages add dialects, see :data:`PLUG_INS`.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path, PurePath
from typing import Any

from robacc.errors import InputError, Problem
from robacc.io.files import read_bytes, read_text
from robacc.plug_ins import plug_in, plug_in_names
from robacc.programs.frames import parse_frames, with_frames
from robacc.programs.program import PROGRAM_LIMIT, Dialect, Program, ProgramSource

PLUG_INS = "robacc.programs"
"""Group of entry points that add dialects.

The name of an entry point is the suffix of the files, without its point; its object, such as a module, has ``SIGN``, a
pattern of text that only such programs have, ``companions(path)``, the paths of files that a program is read with, and
``parse(source, others)``, the :class:`Program`.
"""
SUFFIXES = {
    ".src": Dialect.krl,
    ".dat": Dialect.krl,
    ".sub": Dialect.krl,
    ".mod": Dialect.rapid,
    ".modx": Dialect.rapid,
    ".sys": Dialect.rapid,
    ".sysx": Dialect.rapid,
    ".prg": Dialect.rapid,
    ".ls": Dialect.fanuc,
    ".script": Dialect.urscript,
    ".urscript": Dialect.urscript,
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
    (Dialect.fanuc, re.compile(r"^/PROG\b", re.M)),
    (Dialect.urscript, re.compile(r"^\s*(?:def|thread|sec)\s+\w+\s*\([^)\n]*\)\s*:", re.M)),
    (Dialect.rapid, re.compile(r"^\s*(?:%%%|MODULE\s+\w|(?:LOCAL\s+)?PROC\s+\w)", re.I | re.M)),
    (Dialect.krl, re.compile(r"^\s*(?:&ACCESS\b|(?:GLOBAL\s+)?DEF(?:DAT|FCT)?\s+[\w$])", re.I | re.M)),
    (Dialect.urscript, re.compile(r"\b(?:movej|movel|movep|movec)\s*\(")),
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
    reader = _reader(source)
    others = [_source(other) for other in getattr(reader, "companions", companions)(name)]
    tables = []
    for other in (os.fspath(frame) for frame in frames):
        if PurePath(other).suffix.lower() in (".yaml", ".yml"):
            tables.append(parse_frames(read_text(other), other))
        else:
            others.append(_source(other))
    program: Program = reader.parse(source, others)
    for table in tables:
        program = with_frames(program, table)
    return program


def _reader(source: ProgramSource) -> Any:
    """Return the module of a program's dialect, by its text, or by its suffix where the text is no proof.

    Raises:
        InputError: Neither suffix nor text is that of a robot program.
    """
    suffix = PurePath(source.file).suffix.lower()
    if (reader := _reader_by_text(source.text)) is not None:
        return reader
    if suffix in SUFFIXES:
        return import_module(f"robacc.programs.{SUFFIXES[suffix]}")
    if suffix[1:] in plug_in_names(PLUG_INS):
        return plug_in(PLUG_INS, suffix[1:])
    fix = "give KUKA .src or .dat, ABB .mod, FANUC .ls, URScript .script or Staubli .dtx"
    raise source.error("is not a robot program that robacc reads", fix=fix)


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
