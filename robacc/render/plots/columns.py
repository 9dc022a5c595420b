"""Columns of a document as arrays."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def numbers(values: Iterable[Any]) -> Array:
    """Return ``(N,)`` numbers, NaN for null."""
    return np.array([math.nan if value is None else value for value in values], dtype=np.float64)


def vectors(rows: Iterable[Any]) -> Array:
    """Return ``(N, 3)`` from three numbers per pose."""
    return np.array(list(rows), dtype=np.float64).reshape(-1, 3)


def lengths(rows: Array) -> Array:
    """Return the lengths ``(N,)`` of vectors ``(N, 3)``."""
    result: Array = np.sqrt(np.sum(np.square(rows), axis=1))
    return result


def place(poses: Mapping[str, Any], i: int) -> str:
    """Return the label of a pose: its line in the file, and its ids if it has any."""
    if "label" in poses:
        return str(poses["label"][i])
    parts = [f"line {poses['line'][i]}"]
    parts += [f"{name} {poses[name][i]}" for name in ("pose", "cycle", "target") if poses.get(name)]
    return ", ".join(parts)
