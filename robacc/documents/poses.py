"""Parts of a JSON result for charts: the robot's outline, every pose, and the curves of effects.

Values of poses are rounded to 1e-12 m or rad, far below any instrument, which halves the size of the document.
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
    """Return the robot's name, joints, and outline at a typical pose of ``q`` ``(J, N)``; None without a robot."""
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
    data: Measurements, commanded: Array, residuals: Residuals | None = None, used: NDArray[np.bool_] | None = None
) -> dict[str, Any]:
    """Return columns with an entry for each row: its line, ids, commanded and measured values, and residuals.

    Rows with the same ``group`` are repetitions of one commanded pose.

    Args:
        data: The measured rows.
        commanded: ``(3, N)`` commanded position of the target in the measuring frame, m.
        residuals: Residuals of a fit, if there is a fit.
        used: ``(N,)`` rows without outliers.
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
        **({} if residuals is None else _stages(residuals)),
    }


def _stages(residuals: Residuals) -> dict[str, Any]:
    by_stage = {
        "nominal_unregistered": residuals.unregistered,
        "nominal": residuals.nominal,
        "before": residuals.before,
        "after": residuals.after,
        "held_out_nominal": residuals.held_out_nominal,
        "held_out_before": residuals.held_out_before,
        "held_out_after": residuals.held_out_after,
    }
    return {
        "errors_m": {name: None if errors is None else rounded(errors[:3]) for name, errors in by_stage.items()},
        "errors_rad": None
        if residuals.nominal.shape[0] == 3
        else {name: None if errors is None else rounded(errors[3:]) for name, errors in by_stage.items()},
    }


def curve_document(curve: PartialResidual) -> dict[str, Any]:
    """Return one curve of an effect; ``x`` and ``grid`` are in ``driver_unit``, all other values in ``unit``."""
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
    """Return rounded values with poses first, the order of a document."""
    result: Array = np.round(values, _DECIMALS).T
    return result


def _texts(column: NDArray[Any] | None) -> list[str] | None:
    return None if column is None else [str(value) for value in column]
