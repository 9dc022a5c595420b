"""Fitted coefficients as a part of a JSON result."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from robacc.fitting.parameters import FittedParameter


def parameters_document(found: Iterable[FittedParameter]) -> list[dict[str, Any]]:
    """Name, value, standard error and unit of each; where there is no standard error, why. No zero has a sign."""
    return [
        {"name": p.name, "value": p.value + 0.0, "std": p.std, "unit": p.unit, **({"why": p.why} if p.why else {})}
        for p in found
    ]
