"""The call behind ``robacc check``."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any, ClassVar

from robacc.api.inputs import StrPath
from robacc.api.result import Made, Result, parts
from robacc.api.stored import stored
from robacc.documents.gate_files import read_gate
from robacc.documents.read_result import StoredResult, understood
from robacc.gates.evaluate import GateOutcome, judge


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Checked(Result, GateOutcome):
    """What a gate says of a result, with what it was computed from."""

    command: ClassVar[str] = "check"
    result: StoredResult
    made: Made

    def payload(self) -> dict[str, Any]:
        """The result's own keys."""
        from robacc.documents.gate import gate_document

        keys = ("schema", "robacc", "command", "inputs")
        return {"result": {key: self.result.document.get(key) for key in keys}, "gate": gate_document(self)}


def check(result: StrPath | Result | StoredResult, gate: StrPath) -> Checked:
    """Hold a result against a gate.

    Args:
        result: Result of any command as JSON (``-`` is standard input), or what a call returned.
        gate: Gate file (YAML): what the result must meet.

    Returns:
        ``outcome`` and what became of each criterion; ``exit_status`` is what the command exits with: 0 where it
        passes, 4 where it fails, 5 where it is undecided.

    Raises:
        InputError: A file cannot be read, or the result is not what its command writes.

    Example:
        >>> import robacc
        >>> found = robacc.estimate(
        ...     "sample_data/poses.csv", robot="sample_data/robot.yaml", align=("base_frame", "tool_frame")
        ... )
        >>> checked = robacc.check(found, "configs/gates/assembly.yaml")
        >>> print(checked.outcome, checked.exit_status)
        fail 4
    """
    loaded = read_gate(os.fspath(gate))
    read = stored(result)
    with understood(read.name, read.command):
        found = judge(loaded.gate, read.document, loaded.baselines)
    return Checked(**parts(found), result=read, made=Made({}, (read.record, *loaded.records), None))
