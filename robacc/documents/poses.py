"""What pictures of a result need beside its figures: the robot in outline, every pose, and the curves of effects.

Numbers a pose are rounded to 1e-12 m or rad, far below any instrument, which halves the document.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from robacc.accuracy.stages import Residuals
from robacc.diagnostics.partial_residuals import PartialResidual
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.robots.arm import Arm, skeleton, typical_pose
from robacc.robots.description import Robot

_DECIMALS = 12


def robot_document(robot: Robot | None, q: Array | None) -> dict[str, Any] | None:
    """Name, joints, and the arm's outline at the most usual of the poses ``q`` ``(J, N)``; None without a robot."""
    if robot is None:
        return None
    arm = Arm.of(robot)
    outline = None
    if q is not None and q.shape[1]:
        typical = q[:, typical_pose(q)]
        outline = {"q": typical, "line_m": rounded(skeleton(arm, typical))}
    return {
        "name": robot.name,
        "joints": [{"name": joint.name, "type": joint.type} for joint in robot.variables],
        "effects": list(dict.fromkeys(str(entry.get("effect", "?")) for entry in robot.effects)),
        "fitted_to": list(robot.fitted_to),
        "outline": outline,
    }


def pose_document(
    data: Measurements, commanded: Array, found: Residuals | None = None, used: NDArray[np.bool_] | None = None
) -> dict[str, Any]:
    """A column a key, a row a pose: where it stands in the file, what was commanded and measured, what was missed.

    ``commanded`` ``(3, N)`` is where the target was to be in the measuring frame. Rows with one ``group`` are
    repetitions of one commanded pose.
    """
    return {
        "line": [data.line(i) for i in range(data.n)],
        "pose": _texts(data.pose),
        "cycle": _texts(data.cycle),
        "target": _texts(data.target),
        "group": data.groups(),
        "q": None if data.q is None else rounded(data.q),
        "commanded_m": rounded(commanded),
        "attained_m": rounded(data.position),
        "time_s": data.time,
        "temperature_c": data.temperature,
        "payload_kg": data.payload,
        "used": used,
        **({} if found is None else _stages(found)),
    }


def _stages(found: Residuals) -> dict[str, Any]:
    named = {
        "nominal": found.nominal,
        "before": found.before,
        "after": found.after,
        "held_out_before": found.held_out_before,
        "held_out_after": found.held_out_after,
    }
    return {
        "errors_m": {name: None if one is None else rounded(one[:3]) for name, one in named.items()},
        "errors_rad": None
        if found.nominal.shape[0] == 3
        else {name: None if one is None else rounded(one[3:]) for name, one in named.items()},
    }


def curve_document(curve: PartialResidual) -> dict[str, Any]:
    """One curve of an effect; ``unit`` is of every value, ``driver_unit`` of ``x`` and ``grid``."""
    spectrum = curve.spectrum
    return {
        "joint": curve.joint,
        "driver": curve.driver,
        "driver_unit": curve.driver_unit,
        "unit": curve.unit,
        "x": curve.x,
        "effect": rounded(curve.effect),
        "residual_before": rounded(curve.before),
        "residual_after": rounded(curve.after),
        "sd": rounded(curve.sd),
        "grid": curve.grid,
        "curve": None if curve.value is None else rounded(curve.value),
        "spectrum": None
        if spectrum is None
        else {
            "orders": spectrum.orders,
            "before_rad": rounded(spectrum.before),
            "after_rad": rounded(spectrum.after),
            "noise_rad": spectrum.noise,
        },
    }


def rounded(values: Array) -> Array:
    """Poses first, as a document lists them, without digits that mean nothing."""
    result: Array = np.round(values, _DECIMALS).T
    return result


def _texts(column: NDArray[Any] | None) -> list[str] | None:
    return None if column is None else [str(value) for value in column]
