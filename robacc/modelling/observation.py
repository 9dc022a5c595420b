"""Observation by the instrument: residuals, their exact derivative, and whitening."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from robacc.geometry import Array, Poses, left_jacobian_inverse, log_between
from robacc.measurements import Measurements

NoiseSource = Literal["file", "file and misfit", "repeats", "residual", "given"]


_EQUAL = 0.01
"""Share by which standard deviations along the axes may differ and count as equal."""


@dataclass(frozen=True, slots=True)
class Noise:
    """Standard deviation along each axis of the error that the model does not predict."""

    position: float
    """m, RMS over poses and axes."""
    orientation: float | None
    """rad; None where orientation was not measured."""
    source: NoiseSource
    along_axes: tuple[float, float, float] | None = None
    """m, along x, y, z of the measuring frame; None if they do not differ."""

    @classmethod
    def of_variances(cls, position: Array, orientation: float | None, source: NoiseSource) -> Noise:
        """Return the noise of mean variances ``position`` ``(3,)`` (m²) along the axes.

        ``orientation`` is a standard deviation, rad.
        """
        x, y, z = np.sqrt(position).tolist()
        differ = max(x, y, z) > (1.0 + _EQUAL) * min(x, y, z)
        return cls(float(np.sqrt(np.mean(position))), orientation, source, (x, y, z) if differ else None)


def residuals(data: Measurements, poses: Poses) -> Array:
    """Return the residuals ``(M, N)``: measured minus predicted pose, in the measuring frame.

    Position (m) comes first. Where orientation was measured (M = 6), the rotation vector log(R_measured R_predicted^T)
    (rad) follows.
    """
    position = data.position - poses.translation
    if data.rotation is None:
        return position
    return np.concatenate((position, log_between(data.rotation, poses.rotation)))


def observed_jacobian(jacobian: Array, residual: Array) -> Array:
    """Return minus the derivative of :func:`residuals`, ``(M, P, N)``, from rows dp, dphi of the predicted pose.

    log(R exp(-dphi)) = r - J_r^-1(r) dphi with J_r(r) = J_l(-r), so orientation is exact for residuals of any size.
    """
    if residual.shape[0] == 3:
        return jacobian[:3]
    turned = np.einsum("ijn,jpn->ipn", left_jacobian_inverse(-residual[3:]), jacobian[3:])
    return np.concatenate((jacobian[:3], turned))
