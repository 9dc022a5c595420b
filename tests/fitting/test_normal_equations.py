"""Normal equations: the gradient of the cost itself, blocks, rows left out, and a Jacobian built in part."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from arms import arm

import robacc.fitting.normal_equations
from robacc.effects import REGISTRY
from robacc.effects.periodic import TransmissionError
from robacc.fitting.fit_result import Options
from robacc.fitting.normal_equations import PoseEquations, Whitening, joint_columns, whitening
from robacc.fitting.solver import fit
from robacc.geometry import compose, exp_so3
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.simulation.simulate import Plan, simulate

ORIENTATION = (True, False)
EVERY_KIND = (
    "base_frame",
    "joint_offset",
    "link_geometry",
    "gear_ratio",
    "joint_compliance",
    "payload_compliance",
    "lateral_compliance",
    "axis_wobble",
    "instrument_scale",
)


def measured(n: int = 40, *, orientation: bool = True) -> Measurements:
    return simulate(
        arm("puma560").robot,
        Plan(n, seed=3, noise_position=2e-5, noise_orientation=2e-5, orientation=orientation, payloads=(0.0, 2.0)),
    ).data


def model(data: Measurements, *names: str) -> Model:
    one = arm("puma560")
    return Model.of(one.robot, [REGISTRY[name].default(one, data) for name in names])


def weights(equations: PoseEquations, n: int, seed: int = 0) -> np.ndarray:
    """Of position as it comes, one weight for a pose's three orientations."""
    rng = np.random.default_rng(seed)
    turned = np.broadcast_to(rng.uniform(1e3, 1e4, n), (equations.components - 3, n))
    return np.concatenate((rng.uniform(1e4, 1e5, (3, n)), turned))


def test_the_gradient_is_that_of_the_cost_for_orientations_far_off() -> None:
    data = measured()
    rng = np.random.default_rng(1)
    turned = compose(exp_so3(rng.normal(scale=0.5, size=(3, data.n))), data.rotation)
    far = dataclasses.replace(data, rotation=turned)
    equations = PoseEquations(model(far, "joint_offset", "link_geometry", "joint_compliance"), far)
    weight = weights(equations, far.n)
    theta = rng.normal(scale=1e-3, size=len(equations.terms)) * [term.typical / 1e-3 for term in equations.terms]
    _, normal = equations.linearise(theta, Whitening(weight))
    for i, term in enumerate(equations.terms):
        step = np.zeros(theta.size)
        step[i] = 1e-2 * term.typical
        costs = [float(np.square(equations.residual(theta + s * step) * weight).sum()) for s in (1, -1)]
        # Central difference: rounding 1e-16 of the cost, curvature 1e-5 squared of it.
        slope = (costs[1] - costs[0]) / (4 * step[i])
        assert slope == pytest.approx(normal.gradient[i], rel=1e-6, abs=1e-9 * normal.cost / step[i])


@pytest.mark.parametrize("visit_rows", [None, 1, 2, "some twice"])
@pytest.mark.parametrize("block", [4096, 14])
def test_profiles_are_summed_as_their_built_columns(
    visit_rows: int | str | None, block: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(robacc.fitting.normal_equations, "BLOCK", block)
    data = measured(28)
    robot = arm("puma560").robot
    orders = tuple(float(order) for order in range(1, 8))
    free = (
        REGISTRY["base_frame"].default(arm("puma560"), data),
        TransmissionError(("j2",), orders, shrunk=True),
        REGISTRY["joint_compliance"].default(arm("puma560"), data),
        TransmissionError(("j1",), orders, shrunk=True),
    )
    equations = PoseEquations(Model.of(robot, free), data)
    rng = np.random.default_rng(5)
    theta = rng.normal(scale=1e-6, size=len(equations.terms))
    white = Whitening(weights(equations, data.n))
    if visit_rows is not None:
        scatter = np.full(6, 1e-4)
        # Of the first half two rows each belong together, and those of the second half to nothing.
        visits = np.arange(data.n)
        visits[: data.n // 2] //= 2
        if isinstance(visit_rows, int):
            visits = np.arange(data.n) // visit_rows
        white = whitening(white.weight, joint_columns(Model.of(robot), data), scatter, visits)
    left, normal = equations.linearise(theta, white)
    _, jacobian = Model.of(robot, free).bind(data).linearise(theta)
    rows = white.apply(np.moveaxis(jacobian, 1, 0)).reshape(theta.size, -1)
    scale = np.sqrt(np.sum(np.square(rows), axis=1))
    expected = (rows / scale[:, None]) @ (rows / scale[:, None]).T
    np.testing.assert_allclose(normal.gram / scale / scale[:, None], expected, rtol=0, atol=1e-12)
    residual = white.apply(left).ravel()
    np.testing.assert_allclose(normal.gradient / scale, rows @ residual / scale, rtol=1e-9, atol=1e-9)
    assert normal.cost == pytest.approx(residual @ residual, rel=1e-12)
    root = normal.root() / scale
    np.testing.assert_allclose(root.T @ root, expected, rtol=0, atol=1e-12)


def test_columns_built_in_part_are_those_of_the_whole() -> None:
    data = measured()
    bound = model(data, *EVERY_KIND).bind(data)
    rng = np.random.default_rng(5)
    theta = rng.normal(size=len(bound.terms)) * [0.1 * term.typical for term in bound.terms]
    poses, whole = bound.linearise(theta)
    for columns in (np.arange(0, theta.size, 3), np.array([theta.size - 1, 2]), np.zeros(0, dtype=np.int64)):
        again, some = bound.linearise(theta, columns)
        np.testing.assert_allclose(some, whole[:, columns], rtol=1e-13, atol=1e-15)
        np.testing.assert_array_equal(again.translation, poses.translation)


@pytest.mark.parametrize("n", [12, 40])
def test_steps_end_where_rounding_begins(n: int) -> None:
    data = measured(n)
    found = fit(
        model(data, "joint_offset", "link_geometry"), data, Options(robust=False, misfit=(2e-5, 2e-5), tolerance=1e-15)
    )
    assert found.steps <= 6
    # One step more from there moves no coefficient by a millionth of its standard error.
    again = PoseEquations(found.model, data)
    again.columns = found.identifiability.columns
    _, normal = again.linearise(found.theta, found.whitening)
    error = np.sqrt(np.diag(found.covariance))[again.columns]
    gradient = normal.gradient - found.precision * normal.theta
    assert np.abs(np.linalg.solve(normal.gram + np.diag(found.precision), gradient) / error).max() < 1e-6


@pytest.mark.parametrize("orientation", ORIENTATION)
def test_the_same_coefficients_are_identifiable_in_blocks(orientation: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    data = measured(80, orientation=orientation)
    whole = fit(model(data, *EVERY_KIND), data).identifiability
    monkeypatch.setattr(robacc.fitting.normal_equations, "BLOCK", 64)
    parts = fit(model(data, *EVERY_KIND), data).identifiability
    np.testing.assert_array_equal(parts.columns, whole.columns)
    # The root of the normal matrix has half of the digits: 1e-8 over the smallest singular value.
    np.testing.assert_allclose(parts.singular_values, whole.singular_values, rtol=0, atol=1e-8)
