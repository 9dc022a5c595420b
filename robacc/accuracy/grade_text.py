"""A grade in words: what was found, what limits it, whether it is demonstrated, and what is missing to the next."""

from __future__ import annotations

import math

from robacc.accuracy.grade import NextGrade, QuantityGrade
from robacc.accuracy.grade_scale import Quantity, Scale
from robacc.statistics.records import Statistic, Unit

_NAMES: dict[Statistic, str] = {
    "rms": "RMS error",
    "mean_error": "mean error",
    "p95": "95th percentile of the error",
    "max": "largest error",
}


def reason_of(
    scale: Scale,
    rank: int,
    quantities: dict[Quantity, QuantityGrade],
    limited_by: tuple[Quantity, ...],
    following: NextGrade | None,
    demonstrated: bool,
    demonstrated_grade: str | None,
) -> str:
    """Why a grade is what it is, in sentences."""
    statistic = _NAMES[scale.statistic]
    found = []
    for name, quantity in quantities.items():
        value = f"{name}: {statistic} {_amount(quantity.value, quantity.unit)}"
        if quantity.limit is not None:
            value += f", within {_amount(quantity.limit, quantity.unit)}"
        elif rank == len(scale.steps) and name in limited_by:
            last = scale.steps[-1].limit(name)
            value += f", beyond {_amount(last or math.inf, quantity.unit)} of {scale.steps[-1].grade}"
        found.append(value)
    sentences = ["; ".join(found)]
    if "orientation" not in quantities:
        sentences.append("orientation was not measured, so the grade is of position only")
    if following is not None:
        by_quantity: tuple[tuple[str, Unit, float | None], ...] = (
            ("position", "m", following.position),
            ("orientation", "rad", following.orientation),
        )
        missing = [f"{_amount(excess, unit)} less in {name}" for name, unit, excess in by_quantity if excess]
        sentences.append(f"limited by {' and '.join(limited_by)}: {following.grade} takes {' and '.join(missing)}")
    sentences.append(_demonstration(scale, rank, quantities, demonstrated, demonstrated_grade))
    return ". ".join(sentences)


def _demonstration(
    scale: Scale, rank: int, quantities: dict[Quantity, QuantityGrade], demonstrated: bool, proven: str | None
) -> str:
    confidence = f"{100 * scale.confidence:g} %"
    if demonstrated:
        return f"demonstrated: the upper {confidence} bound meets it ({_bounds(quantities)})"
    unknown = [f"{name}: {quantity.why}" for name, quantity in quantities.items() if quantity.why]
    if unknown:
        return f"not demonstrated: no upper bound of {'; of '.join(unknown)}"
    if rank == len(scale.steps):
        return "no step of the scale is met, so there is nothing to demonstrate"
    shown = f"{proven} is demonstrated" if proven else "no grade is demonstrated"
    return f"not demonstrated: the upper {confidence} bound is beyond a limit ({_bounds(quantities)}); {shown}"


def _bounds(quantities: dict[Quantity, QuantityGrade]) -> str:
    return ", ".join(
        f"{name} {_amount(quantity.upper_bound, quantity.unit)}"
        for name, quantity in quantities.items()
        if quantity.upper_bound is not None
    )


def _amount(value: float, unit: Unit) -> str:
    """In mm or degrees, three digits."""
    return f"{1e3 * value:.3g} mm" if unit == "m" else f"{math.degrees(value):.3g}°"
