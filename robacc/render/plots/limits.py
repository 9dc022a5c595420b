"""Limits of a gate or of a grade scale, drawn as lines in charts."""

from __future__ import annotations

from dataclasses import dataclass

from robacc.render.plots.chart import Document


@dataclass(frozen=True, slots=True)
class Limit:
    """One limit of an error's size."""

    label: str
    short_label: str
    """Printed next to the line."""
    value: float
    """m or rad"""


def limits_of(document: Document, unit: str) -> tuple[Limit, ...]:
    """Return the limits of the gate in ``m`` or ``rad``, or the steps of the grade scale without a gate."""
    quantity = "position" if unit == "m" else "orientation"
    gate_limits = tuple(
        Limit(f"gate {criterion['name']} ({criterion['key']})", str(criterion["name"]), float(criterion["limit"]))
        for criterion in (document.get("gate") or {}).get("criteria", ())
        if criterion["unit"] == unit and quantity in criterion["key"].split(".") and criterion["baseline"] is None
        if isinstance(criterion["limit"], int | float)
    )
    if gate_limits:
        return gate_limits
    steps = (document.get("grade") or {}).get("steps") or ()
    key = f"{quantity}_{unit}"
    return tuple(
        Limit(f"grade {step['grade']}", str(step["grade"]), step[key]) for step in steps if step[key] is not None
    )
