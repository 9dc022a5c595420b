"""Noise of positions and of orientations: each from its own residuals less what they determine of the coefficients."""

from __future__ import annotations

import numpy as np
import pytest

import robacc
from robacc.effects.specification import build, parse_requests
from robacc.fitting.fit_result import Fit, Options
from robacc.fitting.solver import fit
from robacc.measurements import Measurements
from robacc.modelling.model import Model

ROBOT = "sample_data/trace/robot.yaml"
EFFECTS = "base_frame,tool_frame,joint_offset,link_geometry"
POSITION, ORIENTATION = 0.05e-3, 0.4e-3


def fitted(seed: int, poses: int) -> tuple[Fit, Measurements]:
    """A fit to full poses of the nominal robot, with noise."""
    noise = {"noise": POSITION, "noise_orientation": ORIENTATION}
    data = robacc.simulate(ROBOT, poses=poses, seed=seed, **noise).data
    model = Model.of(robacc.read_robot(ROBOT))
    model = Model(model.arm, model.known, build(parse_requests(EFFECTS), model.arm, data))
    return fit(model, data, Options(robust=False, tolerance=1e-10, settled=1e-6)), data


def hat_traces(result: Fit, data: Measurements) -> tuple[float, float]:
    """Sums of the leverages of position and of orientation, from differences of predictions and a dense hat matrix."""
    columns = result.identifiability.columns
    bound = result.model.bind(data)

    def prediction(theta: np.ndarray) -> np.ndarray:
        # Residual rotations about the prediction of the fit, from the antisymmetric part: they are tiny.
        poses = bound.poses(theta)
        turned = np.einsum("ijn,kjn->ikn", poses.rotation, result.poses.rotation)
        vector = 0.5 * np.stack([turned[2, 1] - turned[1, 2], turned[0, 2] - turned[2, 0], turned[1, 0] - turned[0, 1]])
        return np.concatenate((poses.translation / result.misfit[0], vector / result.misfit[1])).reshape(-1)

    step = 1e-6
    jacobian = np.stack(
        [
            (prediction(result.theta + step * unit) - prediction(result.theta - step * unit)) / (2 * step)
            for unit in np.eye(result.theta.size)[columns]
        ],
        axis=1,
    )
    whole = np.concatenate((jacobian, np.diag(np.sqrt(result.precision))))
    leverage = np.sum(np.square(np.linalg.qr(whole)[0]), axis=1)
    return float(leverage[: 3 * data.n].sum()), float(leverage[3 * data.n : 6 * data.n].sum())


def test_position_and_orientation_share_coefficients_by_leverage() -> None:
    result, data = fitted(1, 16)
    position, orientation = hat_traces(result, data)
    # Lengths and base are determined by positions alone, so the halves differ by far.
    assert position > 1.3 * orientation
    columns = result.identifiability.columns
    of_priors = float(result.precision @ np.diag(result.covariance)[columns])
    assert position + orientation == pytest.approx(columns.size - of_priors)
    for i, used in enumerate((position, orientation)):
        part = result.residual[3 * i : 3 * i + 3]
        assert result.misfit[i] == pytest.approx(np.sqrt(np.sum(np.square(part)) / (part.size - used)), rel=1e-4)
