"""Outliers that a large error of the baseline hides cost no smaller effect its place."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
from arms import arm

from robacc.effects.request import build, parse_requests
from robacc.fitting.cross_validation import HoldOut
from robacc.fitting.misfit import outlier_limit
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.simulation.simulate import Plan, simulate
from robacc.tracing.cross_validation import fold_choices
from robacc.tracing.held_out_gain import bounded
from robacc.tracing.loop import SearchResult, search

NOISE = 2e-5
WRONG = np.arange(5, 160, 20)
"""Rows of the campaign that are wrong by 15 times the noise."""


@cache
def campaign() -> tuple[SearchResult, Measurements]:
    """Poses of an arm that sags by millimetres and has some backlash, eight rows wrong, and the search on them."""
    sag = {
        "effect": "joint_compliance",
        "joints": ["panda_joint2", "panda_joint4"],
        "values": {"panda_joint2": 4e-5, "panda_joint4": 8e-5},
    }
    play = {"effect": "backlash", "joints": ["panda_joint1"], "values": {"panda_joint1": 4e-5}}
    nominal = dataclasses.replace(arm("panda").robot, effects=())
    plan = Plan(160, seed=3, noise_position=NOISE, orientation=False)
    data = simulate(dataclasses.replace(nominal, effects=(sag, play)), plan).data
    wrong = np.zeros_like(data.position)
    wrong[:, WRONG] = 15.0 * NOISE * np.random.default_rng(0).choice([-1.0, 1.0], (3, WRONG.size))
    data = dataclasses.replace(data, position=data.position + wrong)
    start = Model.of(nominal)
    free = build(parse_requests("base_frame,tool_frame,joint_offset"), start.arm, data)
    return search(Model(start.arm, start.known, free), data), data


def test_folds_choose_without_the_outliers_of_the_final_fit() -> None:
    found, data = campaign()
    assert found.declared.inliers.all()
    assert np.flatnonzero(~found.final.inliers).tolist() == WRONG.tolist()
    (play,) = (effect for effect in found.effects if effect.name == "backlash")
    choices = fold_choices(found, data, HoldOut(), True, lambda *progress: None)
    assert choices is not None
    assert choices.count(play) == 5


def test_held_out_residuals_of_outliers_are_no_longer_than_their_limit() -> None:
    found, _ = campaign()
    final = found.final
    residual = np.where(np.arange(160) % 2, 1.0, 100.0) * final.residual
    kept = bounded(residual, final)
    np.testing.assert_array_equal(kept[:, final.inliers], residual[:, final.inliers])
    length = np.mean(np.square(kept * final.weight), axis=0)[WRONG]
    assert length == pytest.approx(outlier_limit(3, 160))
    across = np.cross(kept[:, WRONG], residual[:, WRONG], axis=0)
    np.testing.assert_allclose(across, 0.0, atol=1e-18)
