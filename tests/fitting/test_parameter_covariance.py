"""Covariance of the parameters as a result reports them, against differences of the written robot's numbers."""

from __future__ import annotations

import dataclasses
import json

import numpy as np
import pytest
from arms import arm

from robacc.documents.keys import COVARIANCE
from robacc.effects.specification import build, parse_requests
from robacc.fitting.parameters import apply_fit, parameter_covariance
from robacc.fitting.solver import Fit, fit
from robacc.geometry import exp_so3
from robacc.io.json_text import json_text
from robacc.measurements import Measurements
from robacc.modelling.model import Model, predict
from robacc.robots.description import Frame

NOISE = 5e-5
EFFECTS = "base_frame,tool_frame,joint_offset[panda_joint2]"


def fitted(base_rpy: tuple[float, float, float]) -> Fit:
    """Fit frames and a joint offset to noisy poses of an arm with such a base."""
    robot = dataclasses.replace(arm("panda").robot, base=Frame((0.3, -0.2, 0.5), base_rpy))
    rng = np.random.default_rng(4)
    n = 40
    data = Measurements(position=np.zeros((3, n)), q=rng.uniform(-1.0, 1.0, (len(robot.variables), n)))
    exact = predict(robot, data)
    turn = exp_so3(rng.normal(0.0, NOISE, (3, n)))
    rotation = np.einsum("ijn,jkn->ikn", turn, exact.rotation)
    data = dataclasses.replace(data, position=exact.translation + rng.normal(0, NOISE, (3, n)), rotation=rotation)
    model = Model.of(robot)
    return fit(Model.of(robot, build(parse_requests(EFFECTS), model.arm, data)), data)


def written(result: Fit, theta: np.ndarray) -> dict[str, float]:
    """Return the coordinates of the frames that a fit with these coefficients writes."""
    robot = apply_fit(dataclasses.replace(result, theta=theta))
    return {
        f"{prefix}.{label}": value
        for prefix, frame in (("base_frame", robot.base), ("tool_frame", robot.tool))
        for label, value in zip(("x", "y", "z", "roll", "pitch", "yaw"), (*frame.xyz, *frame.rpy), strict=True)
    }


@pytest.mark.parametrize("base_rpy", [(0.4, -0.8, 1.9), (2.5, 0.3, -3.0)])
def test_matrix_is_that_of_the_reported_numbers(base_rpy: tuple[float, float, float]) -> None:
    result = fitted(base_rpy)
    covariance = parameter_covariance(result)
    columns = result.identifiability.columns
    assert covariance.names == tuple(result.names[i] for i in columns)
    slopes = np.zeros((len(covariance.names), columns.size))
    step = 1e-6
    for k, column in enumerate(columns):
        higher, lower = result.theta.copy(), result.theta.copy()
        higher[column] += step
        lower[column] -= step
        above, below = written(result, higher), written(result, lower)
        for i, name in enumerate(covariance.names):
            slopes[i, k] = (above[name] - below[name]) / (2 * step) if name in above else float(i == k)
    expected = slopes @ result.covariance[np.ix_(columns, columns)] @ slopes.T
    scale = np.sqrt(np.diag(expected))
    # Turns about a frame's axes, some 1e-5 rad after registration, count as rates: they do not commute exactly.
    np.testing.assert_allclose(covariance.matrix / scale / scale[:, None], expected / scale / scale[:, None], atol=1e-4)


def test_document_gives_the_covariance_by_its_triangle() -> None:
    result = fitted((0.4, -0.8, 1.9))
    covariance = parameter_covariance(result)
    document = json.loads(json_text(COVARIANCE.write(covariance)))
    assert tuple(document["names"]) == covariance.names
    size = len(covariance.names)
    assert [len(row) for row in document["lower_triangle"]] == list(range(1, size + 1))
    written = np.zeros((size, size))
    written[np.tril_indices(size)] = np.concatenate(document["lower_triangle"])
    written = np.where(written == 0.0, written.T, written)
    # The document has eight significant digits, twelve of variances.
    np.testing.assert_allclose(written, covariance.matrix, rtol=6e-8)
    np.testing.assert_allclose(np.diag(written), np.diag(covariance.matrix), rtol=1e-11)
    # Sums of coefficients whose errors cancel keep their variance.
    assert np.linalg.eigvalsh(written).min() > 0
