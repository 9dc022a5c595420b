"""Fitted corrections and remaining errors that no arm has: suspected mistakes in the data or the robot file."""

from __future__ import annotations

import math

import numpy as np

from robacc.fitting.fit_result import Fit
from robacc.robots.description import LENGTH_PARAMETERS, Robot

_LENGTH = 0.05
"""Share of the reach that the correction of a length exceeds."""
_ANGLE = {"link_geometry": math.radians(5.0), "joint_offset": math.radians(10.0)}
"""rad; corrections of angles that no assembled arm needs."""
_RATIO = {"gear_ratio": 0.05, "joint_coupling": 0.5}
"""Corrections of ratios: of a gear that is known, and of a coupling that is an interaction."""
_ORIENTATION = math.radians(3.0)
"""rad; remaining orientation error that no instrument leaves."""
_SURE = 3.0
"""Standard errors by which a correction exceeds its limit."""
_LISTED = 4


def suspected_mistakes(fit: Fit) -> tuple[str, ...]:
    """Return what in a fit comes from a mistake in the data or the robot file rather than from the arm; else empty."""
    length = reach(fit.model.arm.robot)
    std = np.sqrt(np.maximum(np.diag(fit.covariance), 0.0))
    corrections = []
    for term, value, error in zip(fit.terms, fit.theta, std, strict=True):
        effect = term.name.partition(".")[0]
        limit = _RATIO.get(effect)
        if effect in _ANGLE:
            limit = _ANGLE[effect] if term.unit == "rad" else _LENGTH * length
        if limit is None or not np.isfinite(error) or abs(value) - _SURE * error <= limit:
            continue
        if effect in _RATIO:
            corrections.append(f"{term.name} is {value:.3g}")
        elif term.unit == "rad":
            corrections.append(f"{term.name} is corrected by {math.degrees(value):.3g} degrees")
        else:
            share = 100 * abs(value) / length
            corrections.append(f"{term.name} is corrected by {1e3 * value:.4g} mm ({share:.0f} % of the reach)")
    texts = []
    if corrections:
        more = "" if len(corrections) <= _LISTED else f", and {len(corrections) - _LISTED} more"
        texts.append(
            f"suspected data mistake: {', '.join(corrections[:_LISTED])}{more}; no assembled arm deviates this far; "
            "check the table's convention and lengths, the signs and zeros of the joints, and interactions of joints"
        )
    if fit.residual.shape[0] == 6:
        error = float(np.median(np.linalg.norm(fit.residual[3:, fit.inliers], axis=0)))
        if error > _ORIENTATION:
            texts.append(
                f"suspected data mistake: a median orientation error of {math.degrees(error):.3g} degrees remains; "
                "check the convention of the orientation columns (order of a quaternion, angles, unit)"
            )
    return tuple(texts)


def reach(robot: Robot) -> float:
    """Return the sum of the lengths of the arm's links, base and tool excluded, m."""
    total = 0.0
    for joint in robot.joints:
        total += math.sqrt(sum(value**2 for name, value in joint.parameters.items() if name in LENGTH_PARAMETERS))
    return max(total, 1e-3)
