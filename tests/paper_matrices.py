"""Matrices M1 … M4 of equation (6), in the tool's frame.

Source: C. H. Wu and C. C. Lee, "Estimation of the Accuracy of a Robot Manipulator" (IEEE TAC, 1985), eq. (6):

    [d; δ] = [M1; M2] Δθ + [M2; 0] Δr + [M3; 0] Δl + [M4; M3] Δα

with d the translation and δ the rotation of the tool, both in the tool's frame, and r, l the parameters d, a. They are
columns of the chain's exact parameter Jacobian. With z_i the axis of θ_i and d_i, x_i the axis of a_i and α_i, o a
point on the axis and p the tool's origin,

    M1 = R^T (z × (p - o)),  M2 = R^T z,  M3 = R^T x,  M4 = R^T (x × (p - o)).

The same holds for modified (Craig) rows, where x_i comes before z_i. For a prismatic joint θ_i is a constant with an
error, and d_i is the variable.
"""

from dataclasses import dataclass

import numpy as np

from robacc.geometry import Array
from robacc.robots.arm import Arm
from robacc.robots.description import Robot


@dataclass(frozen=True, slots=True)
class ErrorMatrices:
    """Matrices M1 … M4, each ``(3, n_joints, n_poses)``: tool frame, columns in joint order."""

    m1: Array
    """Translation per error of theta, m/rad."""
    m2: Array
    """Directions of the z axes: rotation per error of theta (rad/rad), translation per error of d (m/m)."""
    m3: Array
    """Directions of the x axes: rotation per error of alpha (rad/rad), translation per error of a (m/m)."""
    m4: Array
    """Translation per error of alpha, m/rad."""


def error_matrices(robot: Robot, q: Array) -> ErrorMatrices:
    """Return M1 … M4 of equation (6) at joint variables ``q`` ``(J, N)`` in rad or m."""
    chain, n_joints = Arm.of(robot).chain, len(robot.joints)
    motions = [chain.index(owner, label) for label in ("theta", "alpha") for owner in range(n_joints)]
    sweep = chain.sweep(chain.scalars(q), q.shape[1], motions)
    rotation = sweep.poses.rotation
    linear = np.einsum("jin,jpn->ipn", rotation, sweep.jacobian[:3])
    angular = np.einsum("jin,jpn->ipn", rotation, sweep.jacobian[3:])
    return ErrorMatrices(
        m1=linear[:, :n_joints], m2=angular[:, :n_joints], m3=angular[:, n_joints:], m4=linear[:, n_joints:]
    )
