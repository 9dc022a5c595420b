"""Read a gate file and the baselines that it names."""

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
    """A gate with its baselines."""

    gate: Gate
    baselines: Mapping[str, Mapping[str, Any]]
    """Documents of the baselines, by their paths in the gate."""
    records: tuple[InputFile, ...]
    """Records of the gate file and the baselines."""


def read_gate(path: str) -> LoadedGate:
    """Return the gate of a file with its baselines, whose paths start from the folder of the gate file.

    Raises:
        InputError: One of the files cannot be read, is not a gate, or is not a result.
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
    """Return the path of a baseline that the file ``gate`` names."""
    return os.fspath(Path(gate).parent / name)
