"""Normal equations: the gradient of the cost itself, blocks, rows left out, and a Jacobian built in part."""

from __future__ import annotations

import numpy as np
import pytest
from arms import arm

import robacc.fitting.normal_equations
from robacc.effects import REGISTRY
from robacc.effects.periodic import TransmissionError
from robacc.fitting.normal_equations import PoseEquations, Whitening, joint_columns, whitening
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.simulation.simulate import Plan, simulate


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
