"""A gate file and the stored results that it compares with."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from robacc.documents.envelope import InputFile
from robacc.documents.read_result import read_result
from robacc.errors import InputError, Problem
from robacc.gates.criteria import Gate
from robacc.gates.gate_file import load_gate
from robacc.io.files import read_text, sha256_of


@dataclass(frozen=True, slots=True)
class LoadedGate:
    """A gate with all that it needs."""

    gate: Gate
    baselines: Mapping[str, Mapping[str, Any]]
    """Documents of the stored results, by their paths in the gate."""
    records: tuple[InputFile, ...]
    """Of the gate file and the stored results."""


def read_gate(path: str) -> LoadedGate:
    """The gate in a file, and its baselines, whose paths are from the gate file's folder.

    Raises:
        InputError: One of the files cannot be read or is not what it should be.
    """
    gate = load_gate(read_text(path), path)
    records = [InputFile.at(path, sha256_of(path), "gate")]
    baselines = {}
    problems: list[Problem] = []
    for name in gate.baselines:
        place = baseline_path(path, name)
        try:
            stored = read_result(place)
        except InputError as error:
            problems += error.problems
            continue
        baselines[name] = stored.document
        records.append(InputFile.at(place, stored.sha256, "baseline"))
    if problems:
        raise InputError(problems)
    return LoadedGate(gate, baselines, tuple(records))


def baseline_path(gate: str, name: str) -> str:
    """Where a baseline lies that the file ``gate`` names."""
    return os.fspath(Path(gate).parent / name)
