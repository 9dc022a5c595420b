"""Gates in documents: the ``gate`` part of a result, and the reader of a gate file with the baselines that it names."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from robacc.documents.envelope import InputFile, read_result, significant_document
from robacc.documents.keys import (
    INPUT,
    LEFT_OUT,
    Document,
    Key,
    Kind,
    anything,
    array,
    choice,
    count,
    flag,
    number,
    part,
    share,
    size,
    text,
)
from robacc.errors import InputError, Problem, refuse
from robacc.io.files import read_text, sha256_of
from robacc.statistics.intervals import ASSURANCE

if TYPE_CHECKING:
    from robacc.gates import Gate, GateOutcome

OUTCOME = dataclasses.replace(choice("pass", "fail", "inconclusive", "not_evaluated"), name="outcome")

GATE_RESULT = part(
    {
        "name": Key(text, "Name of the gate.", "gate.name"),
        "outcome": Key(OUTCOME, "Fail if one criterion fails, pass if all criteria pass."),
        "exit_status": Key(choice(0, 4, 5), "Exit status of the command: 0 pass, 4 fail, 5 undecided."),
        "assurance": Key(share, "Probability that poses_to_decide poses decide.", lambda _: ASSURANCE),
        "criteria": Key(
            array(
                part(
                    {
                        "name": Key(text, "Name of the criterion."),
                        "key": Key(text, "Key of the figure, as in position.p95."),
                        "outcome": Key(OUTCOME),
                        "why": Key(text | None, "Explanation of the outcome, if it needs one."),
                        "unit": Key(
                            text,
                            "Unit of value, limit, bounds and margin: m, rad or 1.",
                        ),
                        "value": Key(
                            Kind({"type": ["number", "string"]}) | None,
                            "Value of the result: a number, a grade or a word.",
                        ),
                        "limit": Key(
                            anything,
                            "Limit: a number, a grade, or the words that pass.",
                        ),
                        "at_least": Key(flag, "True if the limit is a minimum, not a maximum."),
                        "rule": Key(
                            choice("bound", "simple", "guard_band", "guarded_rejection"),
                            "Decision rule.",
                        ),
                        "rule_text": Key(
                            text,
                            "Description of the rule, with its source.",
                        ),
                        "confidence": Key(
                            share | None,
                            "Confidence of each one-sided bound; null if the rule uses no bound.",
                        ),
                        "share": Key(
                            share | None,
                            "Share of all poses that must lie within the limit of a largest error; otherwise null.",
                        ),
                        "lower_bound": Key(number | None, "One-sided lower bound at the confidence."),
                        "upper_bound": Key(number | None, "One-sided upper bound at the confidence."),
                        "margin": Key(number | None, "Distance to the limit; negative beyond the limit."),
                        "conformity_probability": Key(share | None, "Confidence that the true value meets the limit."),
                        "method": Key(text | None, "Method of the bounds."),
                        "n_poses": Key(count | None, "Number of commanded poses behind the value."),
                        "poses_to_decide": Key(
                            count | None,
                            (
                                "Total number of poses (of visits for ISO 9283) that would decide an inconclusive "
                                "criterion."
                            ),
                        ),
                        "poses_to_decide_if_value_is_true": Key(
                            count | None,
                            "The same number if the measured value is the true value.",
                        ),
                        "baseline": Key(
                            part(
                                {
                                    "file": Key(text, "Path from the gate file."),
                                    "value": Key(number | None, "Value of the figure in the baseline."),
                                }
                            )
                            | None,
                            "Stored result that the figure is compared with; otherwise null.",
                        ),
                        "instrument_uncertainty_over_limit": Key(
                            size | None,
                            "The instrument's expanded uncertainty over the limit; null if unknown.",
                        ),
                        "reason": Key(text, "Reason for the limit, from the gate file."),
                        "warnings": Key(array(text), "Warnings about this criterion."),
                        "operating_curve_over": Key(
                            choice("share_within_limit", "value"),
                            "Abscissa of the operating curve.",
                        ),
                        "operating_curve": Key(
                            array(array(number, 2)),
                            "Pairs of a true value and the probability to pass at that value.",
                        ),
                    }
                )
            ),
            "Criteria in the order of the gate.",
            "evaluations",
        ),
        "warnings": Key(array(text), "Warnings of all criteria, without repetitions."),
    },
    "gate_result",
    "Outcome of a gate.",
)

GATE_KEY = Key(GATE_RESULT, "Gate outcome; present only with a gate.", lambda _: LEFT_OUT, optional=True)
"""Key that a gate adds to a result."""

CHECK = part(
    {
        "result": Key(
            part(
                {
                    "schema": Key(text, "Schema of the result."),
                    "robacc": Key(text, "Version of robacc that made the result."),
                    "command": Key(text, "Command that made the result."),
                    "inputs": Key(array(INPUT), "Input files of the result."),
                }
            ),
            "Evaluated result.",
            lambda checked: {
                key: checked.result.document.get(key) for key in ("schema", "robacc", "command", "inputs")
            },
        ),
        "gate": Key(GATE_RESULT, source=""),
    },
    about="Evaluation of a gate on a stored result.",
)


def gate_document(outcome: GateOutcome) -> Document:
    """Return the outcome of the gate and of each criterion."""
    document: Document = significant_document(GATE_RESULT.write(outcome))
    return document


# Read a gate file and the baselines that it names.


Baselines = Mapping[str, Mapping[str, Any]]
"""Documents of the baselines, by their paths in the gate."""


def read_gate(path: str) -> tuple[Gate, Baselines, list[InputFile]]:
    """Return the gate of a file, its baselines, and the records of all these files.

    Paths of baselines start from the folder of the gate file.

    Raises:
        InputError: One of the files cannot be read, is not a gate, or is not a result.
    """
    from robacc.gates import load_gate

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
    refuse((problems, problems))
    return gate, baselines, records


def baseline_path(gate: str, name: str) -> str:
    """Return the path of a baseline that the file ``gate`` names."""
    return os.fspath(Path(gate).parent / name)
