"""Covariances V_d and V_delta of each pose, equations (7) and (8), and each parameter's share.

With J the columns of equation (6) and s_p the parameters' standard deviations, V = Σ_p s_p² J_p J_pᵀ, and the trace of
V divides among the parameters as Σ_n s_p² |J_pn|². The trace does not depend on the frame, so the sums are computed in
the measuring frame of the sweep, and only the 3 x 3 results are rotated into the tool's frame.

The Jacobian of a block is the largest working array; only the 3 x 3 results and the shares outlive the block.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from robacc.chain import Chain, Scalar
from robacc.effects.base import Part, Term
from robacc.geometry import Array, compose, transpose
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.prediction.tolerances import ToleranceParameter

# Derivatives of the poses to the scalars of single motions of the chain.


def motion_columns(model: Model, data: Measurements, motions: tuple[int, ...]) -> Array:
    """Return the derivative ``(6, len(motions), n)`` of the poses to the scalars of some motions."""
    bound = dataclasses.replace(model, free=()).bind(data)
    terms = tuple(Term(f"motion{motion}", "", 1.0, (Part(motion),)) for motion in motions)
    moved = dataclasses.replace(bound, terms=terms, owners=tuple(range(len(terms))))
    return moved.linearise(np.zeros(len(terms)))[1]


@dataclass(frozen=True, slots=True)
class PoseCovariances:
    """Covariances of the tool's error at N poses, in the tool's frame, and the contribution of each parameter."""

    position: Array
    """``(3, 3, N)`` V_d, m²."""
    orientation: Array
    """``(3, 3, N)`` V_δ, rad²."""
    power: Array
    """``(2, P)`` contribution of each parameter to the sum of all traces of V_d (m²) and of V_δ (rad²)."""


def pose_covariances(
    chain: Chain, scalars: Sequence[Scalar], n: int, parameters: Sequence[ToleranceParameter]
) -> PoseCovariances:
    """Return equations (7) and (8) for ``n`` poses with the chain's ``scalars`` (floats, or ``(n,)`` if they vary)."""
    # Rotations first: only they have an angular part, which is then a single slice.
    is_length = [chain.motions[parameter.motion].kind == "translation" for parameter in parameters]
    order = np.argsort(is_length, kind="stable")
    n_rotations = is_length.count(False)
    motions = [parameters[i].motion for i in order]
    sd = np.array([parameters[i].sd for i in order])[:, None]
    position, orientation = np.empty((3, 3, n)), np.empty((3, 3, n))
    power = np.zeros((2, len(order)))
    for block in chain.blocks(n):
        local = [scalar if isinstance(scalar, float) else scalar[block] for scalar in scalars]
        sweep = chain.sweep(local, block.stop - block.start, motions)
        scaled = sweep.jacobian
        scaled *= sd
        parts = (scaled[:3], scaled[3:, :n_rotations])
        for index, (covariances, columns) in enumerate(zip((position, orientation), parts, strict=True)):
            covariances[:, :, block] = in_tool_frame(outer_sums(columns), sweep.poses.rotation)
            power[index, order[: columns.shape[1]]] += np.einsum("ipn,ipn->p", columns, columns)
    return PoseCovariances(position, orientation, power)


def outer_sums(columns: Array) -> Array:
    """Return Σ_k c_k c_kᵀ ``(R, R, n)`` of columns ``(R, K, n)``."""
    size = columns.shape[0]
    result = np.empty((size, size, columns.shape[2]))
    for i in range(size):
        for j in range(i, size):
            np.einsum("kn,kn->n", columns[i], columns[j], out=result[i, j])
            result[j, i] = result[i, j]
    return result


def in_tool_frame(covariance: Array, rotation: Array) -> Array:
    """Return covariances ``(3, 3, n)`` of the measuring frame in the tool's, whose axes are ``rotation``."""
    return compose(transpose(rotation), compose(covariance, rotation))
