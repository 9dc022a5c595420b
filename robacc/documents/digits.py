"""Rounding of a document's numbers to significant digits, so that documents agree on all processors."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robacc.quantities import SIGNIFICANT_DIGITS, significant

_LARGEST_EXACT_POWER = 22
"""10^22 is the largest power of ten that a double holds exactly."""


def significant_document(value: Any) -> Any:
    """Return the document with every float rounded to :data:`SIGNIFICANT_DIGITS` significant digits."""
    # The types of most values come first, since the test of others is slow.
    if isinstance(value, float | np.floating):
        return significant(float(value))
    if isinstance(value, str | int | None):
        return value
    if isinstance(value, np.ndarray):
        return significant_array(value) if value.dtype.kind == "f" else value
    if isinstance(value, Mapping):
        return {key: significant_document(item) for key, item in value.items()}
    if isinstance(value, Sequence):
        return [significant_document(item) for item in value]
    return value


def significant_array(array: NDArray[Any]) -> NDArray[np.float64]:
    """Round each finite number of an array to :data:`SIGNIFICANT_DIGITS` significant digits, -0.0 to 0.0.

    An integer below 10^12 and 10^k up to k = 22 are exact, so their quotient is the double nearest to the decimal
    number and is written with no more digits than that. Numbers that need a larger power are rounded in a loop.
    """
    values = np.asarray(array, dtype=np.float64)
    size = np.abs(np.where(np.isfinite(values), values, 0.0))
    with np.errstate(divide="ignore"):
        places = SIGNIFICANT_DIGITS - 1 - np.floor(np.log10(size))
    exact = (places >= 0) & (places <= _LARGEST_EXACT_POWER)
    power = 10.0 ** np.where(exact, places, 0.0)
    result = np.where(exact, np.rint(values * power) / power, values) + 0.0
    inexact = ~exact & (size > 0.0)
    result[inexact] = [significant(value) for value in values[inexact].tolist()]
    return result
