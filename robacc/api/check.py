"""Call of the command ``robacc check``."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

from robacc.api.inputs import load_result
from robacc.api.parameters import Help, StrPath, call
from robacc.api.result import Provenance, Result, fields_of
from robacc.documents.envelope import StoredResult, understood
from robacc.documents.gate import gate_document, read_gate
from robacc.gates.evaluate import GateOutcome, evaluate_gate


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Checked(Result, GateOutcome):
    """Outcome of a gate, with the result that was checked."""

    command: ClassVar[str] = "check"
    result: StoredResult

    def payload(self) -> dict[str, Any]:
        """Return the result's own keys."""
        keys = ("schema", "robacc", "command", "inputs")
        return {"result": {key: self.result.document.get(key) for key in keys}, "gate": gate_document(self)}


@call
def check(
    result: Annotated[
        StrPath | Result | StoredResult,
        Help("Result of any command as JSON; - reads standard input.", "RESULT", "Or the result of a call."),
    ],
    gate: Annotated[StrPath, Help("Gate file (YAML) with the criteria.", "FILE")],
) -> Checked:
    """Check a result against a gate.

    Returns:
        ``outcome`` of the gate and of each criterion; ``exit_status`` of the command: 0 for pass, 4 for fail, 5 for
        inconclusive.

    Raises:
        InputError: A file cannot be read, or the result is not what its command writes.

    Example:
        >>> import robacc
        >>> result = robacc.estimate(
        ...     "sample_data/poses.csv", robot="sample_data/robot.yaml", align=("base_frame", "tool_frame")
        ... )
        >>> checked = robacc.check(result, "configs/gates/assembly.yaml")
        >>> print(checked.outcome, checked.exit_status)
        fail 4
    """
    loaded = read_gate(os.fspath(gate))
    stored = load_result(result)
    with understood(stored.name, stored.command):
        outcome = evaluate_gate(loaded.gate, stored.document, loaded.baselines)
    return Checked(**fields_of(outcome), result=stored, made=Provenance({}, (stored.record, *loaded.records), None))
