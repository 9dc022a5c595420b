"""Limits that a result was held against: lines in its pictures."""

from __future__ import annotations

from dataclasses import dataclass

from robacc.pictures.picture import Document


@dataclass(frozen=True, slots=True)
class Limit:
    """One limit of an error's size."""

    label: str
    short: str
    """For beside the line."""
    value: float
    """m or rad"""


def limits_of(document: Document, unit: str) -> tuple[Limit, ...]:
    """The steps of the grade scale, in ``m`` or ``rad``; none where the result has no such scale."""
    key = "position_m" if unit == "m" else "orientation_rad"
    steps = (document.get("grade") or {}).get("steps") or ()
    return tuple(
        Limit(f"grade {step['grade']}", str(step["grade"]), step[key]) for step in steps if step[key] is not None
    )
