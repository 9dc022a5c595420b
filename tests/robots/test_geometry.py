"""Rotations: exponential and logarithm, roll-pitch-yaw, quaternions, any batch shape, near zero and near pi too."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from robacc.geometry import (
    Array,
    Poses,
    compose,
    exp_so3,
    left_jacobian_inverse,
    log_between,
    log_so3,
    quaternion_from_rotation,
    rotation_from_quaternion,
    rotation_from_rpy,
    rpy_from_rotation,
    skew,
)

EPS = np.finfo(float).eps

# Magnitudes that matter: zero, below and above the series' threshold, ordinary, and pi from below.
ANGLES = st.one_of(
    st.sampled_from([0.0, 1e-300, 1e-12, 1e-8, 9.9e-5, 1.01e-4, 1e-3, np.pi - 1e-3, np.pi - 1e-7, np.pi - 1e-12]),
    st.floats(0.0, np.pi - 1e-9),
)


@st.composite
def rotation_vectors(draw: st.DrawFn) -> Array:
    direction = np.array(draw(st.tuples(*[st.floats(-1, 1)] * 3)))
    length = np.linalg.norm(direction)
    direction = direction / length if length > 1e-3 else np.array([0.0, 0.6, -0.8])
    return direction * draw(ANGLES)


@given(rotation_vectors())
@settings(max_examples=80, deadline=None)
def test_exponential_is_the_matrix_exponential(vector: Array) -> None:
    # scipy's Pade approximation is good to some ten roundings.
    np.testing.assert_allclose(exp_so3(vector), expm(skew(vector)), atol=40 * EPS)


@given(rotation_vectors())
@settings(max_examples=80, deadline=None)
def test_logarithm_undoes_the_exponential(vector: Array) -> None:
    # The angle is resolved to rounding everywhere: no square root of epsilon near zero or pi.
    np.testing.assert_allclose(log_so3(exp_so3(vector)), vector, rtol=0, atol=20 * EPS)


@given(rotation_vectors())
@settings(max_examples=40, deadline=None)
def test_small_rotations_keep_their_relative_precision(vector: Array) -> None:
    length = float(np.linalg.norm(vector))
    if 0 < length < 1 and length > 1e-150:
        assert np.linalg.norm(log_so3(exp_so3(vector)) - vector) <= 1e-14 * length


def test_logarithm_at_pi_is_one_of_its_two_vectors() -> None:
    for axis in np.vstack((np.eye(3), [[0.6, -0.8, 0.0], [-0.36, 0.48, 0.8]])):
        rotation = 2 * np.outer(axis, axis) - np.eye(3)
        vector = log_so3(rotation)
        assert min(np.linalg.norm(vector - np.pi * axis), np.linalg.norm(vector + np.pi * axis)) < 1e-14


@given(rotation_vectors())
@settings(max_examples=60, deadline=None)
def test_quaternion_is_scipys_and_comes_back(vector: Array) -> None:
    rotation = Rotation.from_rotvec(vector).as_matrix()
    quaternion = quaternion_from_rotation(rotation)
    theirs = Rotation.from_matrix(rotation).as_quat(canonical=True, scalar_first=True)
    sign = np.sign(quaternion @ theirs)  # at pi the two signs are one rotation
    np.testing.assert_allclose(quaternion, sign * theirs, atol=1e-14)
    assert quaternion[0] >= 0
    np.testing.assert_allclose(rotation_from_quaternion(quaternion), rotation, atol=1e-14)


@given(st.tuples(st.floats(-3.1, 3.1), st.floats(-1.57, 1.57), st.floats(-3.1, 3.1)))
@settings(max_examples=60, deadline=None)
def test_rpy_are_rotations_about_fixed_axes(rpy: tuple[float, float, float]) -> None:
    rotation = rotation_from_rpy(np.array(rpy))
    np.testing.assert_allclose(rotation, Rotation.from_euler("xyz", rpy).as_matrix(), atol=1e-15)
    # Up to 8e-4 rad from the pole each of roll and yaw has lost three digits of sixteen.
    np.testing.assert_allclose(rpy_from_rotation(rotation), rpy, atol=2e-12)


@pytest.mark.parametrize("pitch", [np.pi / 2, -np.pi / 2])
def test_rpy_at_the_pole_sets_roll_to_zero_and_keeps_the_rotation(pitch: float) -> None:
    rotation = rotation_from_rpy(np.array([0.4, pitch, 1.1]))
    rotation = np.where(np.abs(rotation) < 1e-15, 0.0, rotation)
    rpy = rpy_from_rotation(rotation)
    assert rpy[0] == 0
    np.testing.assert_allclose(rotation_from_rpy(rpy), rotation, atol=1e-15)


@given(rotation_vectors(), st.integers(0, 2))
@settings(max_examples=60, deadline=None)
def test_left_jacobian_inverse_is_the_logarithms_derivative(vector: Array, axis: int) -> None:
    if np.linalg.norm(vector) > 3.0:
        return  # the logarithm jumps at pi; a difference quotient across the jump means nothing
    step = 1e-6
    turn = [exp_so3(np.eye(3)[axis] * sign * step) for sign in (1, -1)]
    rotation = exp_so3(vector)
    quotient = (log_so3(turn[0] @ rotation) - log_so3(turn[1] @ rotation)) / (2 * step)
    # Truncation is of order step^2 times a third derivative that grows towards pi, rounding 1e-16 / step.
    np.testing.assert_allclose(left_jacobian_inverse(vector)[:, axis], quotient, atol=2e-9)


def test_poses_are_homogeneous_matrices() -> None:
    rng = np.random.default_rng(4)
    first, second = (Poses(exp_so3(rng.normal(size=(3, 7))), rng.normal(size=(3, 7))) for _ in range(2))
    product = first.matrices() @ second.matrices()
    np.testing.assert_allclose((first @ second).matrices(), product, atol=1e-14)
    np.testing.assert_allclose(first.inverse().matrices(), np.linalg.inv(first.matrices()), atol=1e-14)
    np.testing.assert_array_equal(Poses.identity(7).matrices(), np.broadcast_to(np.eye(4), (7, 4, 4)))
    made = Poses.from_xyz_rpy(np.array([1.0, 2, 3]), np.array([0, 0, np.pi / 2]))
    np.testing.assert_allclose(made.matrices(), [[0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]], atol=1e-16)


@pytest.mark.parametrize("scale", [0.0, 1e-9, 1e-5, 1e-3, 0.3, 1.0, 3.0])
def test_the_rotation_between_two_is_that_of_their_product(scale: float) -> None:
    rng = np.random.default_rng(7)
    second = exp_so3(rng.normal(size=(3, 200)))
    vector = rng.normal(size=(3, 200))
    vector *= scale / np.linalg.norm(vector, axis=0)
    first = compose(exp_so3(vector), second)
    # Rounding of a product of matrices, in the angle; next to half a turn the axis loses digits.
    np.testing.assert_allclose(log_between(first, second), vector, rtol=0, atol=1e-15 * (1 + 50 * scale**2))
