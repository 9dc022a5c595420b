"""A result as columns with one entry for each row of the poses, for tables and arrays in a notebook."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

Document = Mapping[str, Any]
Columns = dict[str, NDArray[Any]]
_LABELS = ("line", "pose", "cycle", "target", "time_s", "temperature_c", "payload_kg", "used")


def pose_columns(document: Document) -> Columns:
    """Return the columns of the poses: ids, circumstances, joints, positions in m, errors in m and rad.

    Every column has as many entries as there are rows. A result without poses gives no column.
    """
    poses = document.get("poses")
    if not isinstance(poses, Mapping) or poses.get("line") is None:
        return {}
    columns: Columns = {name: np.asarray(poses[name]) for name in _LABELS if poses.get(name) is not None}
    if poses.get("q") is not None:
        columns |= {f"q{i + 1}": values for i, values in enumerate(np.asarray(poses["q"], dtype=float).T)}
    for prefix, key in (("cmd_", "commanded_m"), ("", "attained_m")):
        columns |= _vector(f"{prefix}{{}}_m", poses.get(key))
    for unit in ("m", "rad"):
        columns |= _errors(document, poses.get(f"errors_{unit}"), unit)
    return columns


def _errors(document: Document, stages: object, unit: str) -> Columns:
    """Return the errors of each stage of a fit, or the errors of an estimate."""
    if isinstance(stages, Mapping):
        columns: Columns = {}
        for stage, errors in stages.items():
            columns |= _with_length(f"{stage}_error", errors, unit)
        return columns
    quantity = document.get("position" if unit == "m" else "orientation")
    errors = quantity.get(f"errors_{unit}") if isinstance(quantity, Mapping) else None
    return _with_length("error" if unit == "m" else "turn", errors, unit)


def _with_length(name: str, errors: object, unit: str) -> Columns:
    if errors is None:
        return {}
    columns = _vector(f"{name}_{{}}_{unit}", errors)
    columns[f"{name}_{unit}"] = np.linalg.norm(np.asarray(errors, dtype=float), axis=1)
    return columns


def _vector(pattern: str, rows: object) -> Columns:
    if rows is None:
        return {}
    return {pattern.format(axis): values for axis, values in zip("xyz", np.asarray(rows, dtype=float).T, strict=True)}
