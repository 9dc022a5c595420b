"""Limits that a result was held against: lines in its pictures."""

from __future__ import annotations

from dataclasses import dataclass

from robacc.render.plots.chart import Document


@dataclass(frozen=True, slots=True)
class Limit:
    """One limit of an error's size."""

    label: str
    short: str
    """For beside the line."""
    value: float
    """m or rad"""


def limits_of(document: Document, unit: str) -> tuple[Limit, ...]:
    """Of the gate in ``m`` or ``rad`` where there is one, else the steps of the grade scale."""
    quantity = "position" if unit == "m" else "orientation"
    asked = tuple(
        Limit(f"gate {one['name']} ({one['key']})", str(one["name"]), float(one["limit"]))
        for one in (document.get("gate") or {}).get("criteria", ())
        if one["unit"] == unit and quantity in one["key"].split(".") and one["baseline"] is None
        if isinstance(one["limit"], int | float)
    )
    if asked:
        return asked
    steps = (document.get("grade") or {}).get("steps") or ()
    key = f"{quantity}_{unit}"
    return tuple(
        Limit(f"grade {step['grade']}", str(step["grade"]), step[key]) for step in steps if step[key] is not None
    )
