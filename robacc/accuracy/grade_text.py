"""Sentences that explain a grade: the estimates, their limits, the confirmation, and the next better grade."""

from __future__ import annotations

import math
from collections.abc import Sequence

from robacc.accuracy.grade import NextGrade, QuantityGrade
from robacc.accuracy.grade_scale import Quantity, Scale
from robacc.statistics.records import Statistic, Unit

_NAMES: dict[Statistic, str] = {
    "rms": "rms error",
    "mean_error": "mean error",
    "p95": "95th percentile of the error",
    "max": "largest error",
}
_DIGITS = 3
_MOST_DIGITS = 6


def grade_reason(
    scale: Scale,
    rank: int,
    quantities: dict[Quantity, QuantityGrade],
    limited_by: tuple[Quantity, ...],
    following: NextGrade | None,
    demonstrated: bool,
    demonstrated_grade: str | None,
) -> str:
    """Explain a grade in sentences."""
    statistic = _NAMES[scale.statistic]
    estimates = []
    for name, quantity in quantities.items():
        limits = [limit for step in scale.steps if (limit := step.limit(name)) is not None]
        text = f"{name}: {statistic} {_beside(quantity.value, limits, quantity.unit)}"
        if quantity.limit is not None:
            text += f", within {_amount(quantity.limit, quantity.unit)}"
        elif rank == len(scale.steps) and name in limited_by:
            last = scale.steps[-1].limit(name)
            text += f", beyond the limit of {scale.steps[-1].grade}, {_amount(last or math.inf, quantity.unit)}"
        estimates.append(text)
    sentences = ["; ".join(estimates)]
    if "orientation" not in quantities:
        sentences.append("orientation was not measured, so the grade covers position only")
    if following is not None:
        by_quantity: tuple[tuple[str, Unit, float | None], ...] = (
            ("position", "m", following.position),
            ("orientation", "rad", following.orientation),
        )
        missing = [f"{_amount(excess, unit)} less in {name}" for name, unit, excess in by_quantity if excess]
        sentences.append(
            f"limited by {' and '.join(limited_by)}: grade {following.grade} needs {' and '.join(missing)}"
        )
    sentences.append(_confirmation(scale, rank, quantities, demonstrated, demonstrated_grade))
    return ". ".join(sentences)


def _confirmation(
    scale: Scale, rank: int, quantities: dict[Quantity, QuantityGrade], demonstrated: bool, confirmed: str | None
) -> str:
    confidence = f"{100 * scale.confidence:g} %"
    at_confidence = f"at {confidence} confidence"
    if demonstrated:
        return f"confirmed {at_confidence}: the upper bound is within the limit ({_bounds(quantities)})"
    missing = [f"{name} has no upper bound ({quantity.why})" for name, quantity in quantities.items() if quantity.why]
    if missing:
        return f"not confirmed {at_confidence}: {'; '.join(missing)}"
    if rank == len(scale.steps):
        return "no step of the scale is met, so no grade can be confirmed"
    best = f"grade {confirmed} is confirmed" if confirmed else "no grade is confirmed"
    return f"not confirmed {at_confidence}: the upper bound is beyond a limit ({_bounds(quantities)}); {best}"


def _bounds(quantities: dict[Quantity, QuantityGrade]) -> str:
    return ", ".join(
        f"{name} {_amount(quantity.upper_bound, quantity.unit)}"
        for name, quantity in quantities.items()
        if quantity.upper_bound is not None
    )


def _beside(value: float, limits: Sequence[float], unit: Unit) -> str:
    """Format as :func:`_amount`, with more digits where rounding would move the value onto or over a limit."""
    factor = 1e3 if unit == "m" else math.degrees(1.0)
    for digits in range(_DIGITS, _MOST_DIGITS):
        rounded = float(f"{factor * value:.{digits}g}")
        if all((rounded > factor * limit * (1 + 1e-12)) == (value > limit) for limit in limits):
            return _amount(value, unit, digits)
    return _amount(value, unit, _MOST_DIGITS)


def _amount(value: float, unit: Unit, digits: int = _DIGITS) -> str:
    """Format in mm or degrees, with three significant digits unless more are asked for."""
    shown = 1e3 * value if unit == "m" else math.degrees(value)
    # Without an exponent for errors of metres.
    return f"{float(f'{shown:.{digits}g}'):.{max(digits, 6)}g}{' mm' if unit == 'm' else '°'}"
