"""The nominal stage is registered to all poses, also where the poses without a fold are too few."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from arms import arm

from robacc.accuracy.stages import registered_residuals
from robacc.fitting.held_out import HoldOut
from robacc.simulation.simulate import Plan, simulate


def test_folds_that_cannot_be_fitted_do_not_undo_the_registration() -> None:
    robot = dataclasses.replace(arm("irb1600").robot, effects=())
    data = simulate(robot, Plan(6, seed=1, noise_position=1e-5, orientation=False)).data
    data = dataclasses.replace(data, position=data.position + np.array([[0.3], [-0.2], [0.1]]))
    rms = [
        float(
            np.sqrt(
                np.mean(np.sum(registered_residuals(robot, data, HoldOut.of(data, None, folds, 0))[0] ** 2, axis=0))
            )
        )
        for folds in (2, 6)
    ]
    assert rms[0] == pytest.approx(rms[1], rel=1e-6)
    assert rms[0] < 1e-3
