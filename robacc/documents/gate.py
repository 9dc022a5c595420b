"""Gates in documents: the ``gate`` part of a result, and the reader of a gate file with the baselines that it names."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from robacc.documents.envelope import InputFile, significant_document
from robacc.documents.read_result import read_result
from robacc.errors import InputError, Problem
from robacc.gates.evaluate import CriterionEvaluation, GateOutcome
from robacc.gates.gate_file import RULES, Gate, GateCriterion, load_gate
from robacc.io.files import read_text, sha256_of
from robacc.statistics.confidence_curves import ASSURANCE

_UNITS = {"length": "m", "angle": "rad"}


def gate_document(outcome: GateOutcome) -> dict[str, Any]:
    """Return the outcome of the gate and of each criterion."""
    document = {
        "name": outcome.gate.name,
        "outcome": outcome.outcome,
        "exit_status": outcome.exit_status,
        "assurance": ASSURANCE,
        "criteria": [_criterion(evaluation) for evaluation in outcome.evaluations],
        "warnings": list(outcome.warnings),
    }
    rounded: dict[str, Any] = significant_document(document)
    return rounded


def _criterion(evaluation: CriterionEvaluation) -> dict[str, Any]:
    criterion, decision = evaluation.criterion, evaluation.decision
    baseline = None
    if criterion.baseline is not None:
        baseline = {"file": criterion.baseline, "value": evaluation.baseline_value}
    return {
        "name": criterion.name,
        "key": criterion.key,
        "outcome": evaluation.outcome,
        "why": decision.why,
        "unit": _UNITS.get(evaluation.dimension, "1"),
        "value": evaluation.value if evaluation.word is None else evaluation.word,
        "limit": _limit(criterion),
        "at_least": criterion.at_least,
        "rule": criterion.rule,
        "rule_text": RULES[criterion.rule],
        "confidence": None if criterion.rule == "simple" else criterion.confidence,
        "share": criterion.share if evaluation.is_by_share else None,
        "lower_bound": decision.lower_bound,
        "upper_bound": decision.upper_bound,
        "margin": decision.margin,
        "conformity_probability": decision.probability,
        "method": decision.method,
        "n_poses": evaluation.n,
        "poses_to_decide": decision.poses_to_decide,
        "poses_to_decide_if_value_is_true": decision.poses_if_true,
        "baseline": baseline,
        "instrument_uncertainty_over_limit": evaluation.instrument_ratio,
        "reason": criterion.reason,
        "warnings": list(evaluation.warnings),
        "operating_curve_over": "share_within_limit" if evaluation.is_by_share else "value",
        "operating_curve": [list(point) for point in decision.operating_curve],
    }


def _limit(criterion: GateCriterion) -> list[str] | str | float | None:
    if not criterion.accepted:
        return criterion.limit
    return list(criterion.accepted) if criterion.kind == "word" else criterion.accepted[0]


# Read a gate file and the baselines that it names.


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
