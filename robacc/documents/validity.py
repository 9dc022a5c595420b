"""JSON key of the poses outside a model's validity ranges."""

from __future__ import annotations

from typing import Any

from robacc.modelling.validity import OutsideValidity


def outside_document(outside: OutsideValidity | None) -> dict[str, Any]:
    """Return the key ``outside_validity``; None is a model without ranges."""
    if outside is None:
        return {"n_poses": 0, "position_std_max_m": 0.0, "ranges": []}
    return {
        "n_poses": outside.n_poses,
        "position_std_max_m": outside.std_max,
        "ranges": [
            {
                "effect": item.effect,
                "driver": item.driver,
                "unit": item.unit,
                "low": item.low,
                "high": item.high,
                "n_poses": item.n_poses,
                "largest_excess": item.excess,
                "rule": "held" if item.is_held else "extrapolated",
            }
            for item in outside.ranges
        ],
    }
