"""Effects stay beside scatter where they predict held-out poses, and only there."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
from arms import arm

from robacc.effects.base import Effect
from robacc.effects.periodic import of_order
from robacc.effects.request import build, parse_requests
from robacc.fitting.fit_result import Fit
from robacc.fitting.solver import fit
from robacc.measurements import Measurements
from robacc.modelling.model import Model, predict
from robacc.simulation.simulate import Plan, simulate
from robacc.tracing.held_out_gain import gain_of, gain_score
from robacc.tracing.refitting import SEARCH, refit


@cache
def campaign() -> tuple[Fit, Measurements]:
    """60 poses visited three times by an arm whose second joint has a wave, and the fit of its declared effects."""
    rng = np.random.default_rng(4)
    robot = dataclasses.replace(arm("irb1600").robot, effects=())
    poses = simulate(robot, Plan(60, seed=5, noise_position=0.0, orientation=False)).data
    data = poses.subset(np.repeat(np.arange(60), 3))
    assert data.q is not None
    turned = data.q + 5e-5 * rng.standard_normal((data.q.shape[0], 60))[:, np.repeat(np.arange(60), 3)]
    turned[1] += 2e-4 * np.cos(7.0 * data.q[1])
    position = predict(robot, dataclasses.replace(data, q=turned)).translation
    data = dataclasses.replace(data, position=position + 2e-5 * rng.standard_normal(position.shape))
    start = Model.of(robot)
    free = build(parse_requests("base_frame,tool_frame,joint_offset"), start.arm, data)
    return fit(Model(start.arm, start.known, free), data), data


def with_effects(*effects: Effect) -> tuple[Fit, Fit, Measurements]:
    """The fit with more effects, that without, and their poses."""
    declared, data = campaign()
    return refit(declared, (*declared.model.free, *effects), data, SEARCH), declared, data


def test_the_true_wave_predicts_held_out_poses() -> None:
    assert gain_of(*with_effects(of_order("j2", 7.0))) > 3.0


def test_waves_that_are_not_there_do_not() -> None:
    waves = [of_order(joint, order) for joint in ("j1", "j3", "j4") for order in (3.0, 5.5, 9.0)]
    complete, declared, data = with_effects(*waves)
    # They explain poses that they were fitted to: errors that visits of a pose share.
    assert np.sum(np.square(complete.residual)) < 0.97 * np.sum(np.square(declared.residual))
    assert gain_of(complete, declared, data) < 1.0


def test_the_score_counts_places_and_not_rows() -> None:
    without, after = np.ones((3, 8)), np.zeros((3, 8))
    without[:, :2] = 2.0
    once = gain_score(without, after, np.arange(8))
    repeated = gain_score(np.repeat(without, 5, axis=1), np.repeat(after, 5, axis=1), np.repeat(np.arange(8), 5))
    assert repeated == pytest.approx(once)
    gain = np.array([12.0, 12.0, 3.0, 3.0, 3.0, 3.0, 3.0, 3.0])
    assert once == pytest.approx(gain.mean() / (gain.std(ddof=1) / np.sqrt(8.0)))
