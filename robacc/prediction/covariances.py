"""V_d and V_δ of each pose, equations (7) and (8), and each parameter's share, in blocks of poses.

With J the columns of equation (6) and s_p the parameters' standard deviations, V = Σ_p s_p² J_p J_pᵀ, and the trace of
V divides among the parameters as Σ_n s_p² |J_pn|². The trace does not hang on the frame, so the sums are made where the
sweep leaves them, in the measuring frame, and only the 3 x 3 results are turned into the tool's.

The Jacobian of a block is the largest working array; nothing but the 3 x 3 results and the shares outlives the block.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from robacc.chain import Chain, Scalar
from robacc.geometry import Array, compose, transpose
from robacc.prediction.parameters import ToleranceParameter


@dataclass(frozen=True, slots=True)
class PoseCovariances:
    """Covariances of the tool's error at N poses, in the tool's frame, and what each parameter contributes."""

    position: Array
    """``(3, 3, N)`` V_d, m²."""
    orientation: Array
    """``(3, 3, N)`` V_δ, rad²."""
    position_power: Array
    """``(P,)`` part of each parameter in the sum of all traces of V_d, m²."""
    orientation_power: Array
    """``(P,)`` rad²"""


def pose_covariances(
    chain: Chain, scalars: Sequence[Scalar], n: int, parameters: Sequence[ToleranceParameter]
) -> PoseCovariances:
    """Equations (7) and (8) for ``n`` poses with the chain's ``scalars`` (floats, or ``(n,)`` where they vary)."""
    # Rotations first: only they have an angular part, which is then one slice.
    order = sorted(range(len(parameters)), key=lambda i: chain.motions[parameters[i].motion].kind != "rotation")
    turning = sum(chain.motions[parameter.motion].kind == "rotation" for parameter in parameters)
    wanted = [parameters[i].motion for i in order]
    sd = np.array([parameters[i].sd for i in order])[:, None]
    position, orientation = np.empty((3, 3, n)), np.empty((3, 3, n))
    power = np.zeros((2, len(order)))
    for block in chain.blocks(n):
        count = block.stop - block.start
        local = [scalar if isinstance(scalar, float) else scalar[block] for scalar in scalars]
        sweep = chain.sweep(local, count, wanted)
        scaled = sweep.jacobian
        scaled *= sd
        for target, part, row, size in (
            (position, scaled[:3], 0, len(order)),
            (orientation, scaled[3:, :turning], 1, turning),
        ):
            target[:, :, block] = _in_tool_frame(_outer_sums(part), sweep.poses.rotation)
            power[row, :size] += np.einsum("ipn,ipn->p", part, part)
    unsorted = np.empty_like(power)
    unsorted[:, order] = power
    return PoseCovariances(position, orientation, unsorted[0], unsorted[1])


def _outer_sums(columns: Array) -> Array:
    """Σ_p c_p c_pᵀ ``(3, 3, n)`` of columns ``(3, P, n)``."""
    result = np.empty((3, 3, columns.shape[2]))
    for i in range(3):
        for j in range(i, 3):
            np.einsum("pn,pn->n", columns[i], columns[j], out=result[i, j])
            result[j, i] = result[i, j]
    return result


def _in_tool_frame(covariance: Array, rotation: Array) -> Array:
    return compose(transpose(rotation), compose(covariance, rotation))
