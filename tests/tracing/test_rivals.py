"""Rivals behind in evidence are alternatives where the errors of the poses do not tell the two apart."""

from __future__ import annotations

import numpy as np
import pytest
from independent_arm import DECLARED, measured, robot, run, target, torques

from robacc.effects.request import build, parse_requests
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.robots.arm import Arm
from robacc.tracing.loop import SearchResult, search
from robacc.tracing.rivals import RIVAL, FittedRival, lag_refitted, rivals

ARM = Arm.of(robot())


@pytest.fixture(scope="module", name="springy")
def _springy() -> tuple[SearchResult, Measurements]:
    """An arm whose second joint is a spring, as a search finds it."""
    poses = run(70, seed=3)
    moved = poses.q.copy()
    moved[1] += 8e-7 * np.array([torques(q)[1] for q in poses.q.T])
    data = measured(poses, np.array([target(q) for q in moved.T]).T, 1e-5, 3)
    loop = search(Model(ARM, free=build(parse_requests(DECLARED), ARM, data)), data, empirical=False)
    assert [str(effect) for effect in loop.effects] == ["joint_compliance[j2]"]
    return loop, data


@pytest.mark.parametrize(("difference", "is_named"), [(0.4, True), (1.7, False)])
def test_errors_within_their_uncertainty_make_an_alternative(
    springy: tuple[SearchResult, Measurements], difference: float, is_named: bool
) -> None:
    loop, _ = springy
    (finding,) = loop.selection.chosen
    _, named = rivals(loop.selection, finding, lambda ranked, rival: FittedRival(4 * RIVAL, difference))
    behind = [alternative for alternative in named if alternative.within_uncertainty]
    assert bool(behind) == is_named
    assert all(alternative.similarity >= 0.8 for alternative in behind)


def test_a_rival_that_fits_clearly_worse_differs_by_many_standard_errors(
    springy: tuple[SearchResult, Measurements],
) -> None:
    loop, data = springy
    (finding,) = loop.selection.chosen
    ranked, ranking = loop.selection.contest(finding)
    pedestal = next(rival for rival in ranking if rival.candidate.effect.name == "base_compliance")
    fitted = lag_refitted(loop, finding, loop.effects[0], data)(ranked, pedestal)
    assert fitted is not None
    assert fitted.lag > RIVAL
    assert fitted.difference > 3.0


def test_a_counterbalance_competes_with_a_periodic_error_at_its_best_place() -> None:
    poses = run(100, seed=7000)
    angle = poses.q[1] - np.radians(70.0)
    moved = poses.q.copy()
    moved[1] += 8e-7 * np.array([torques(q)[1] for q in poses.q.T])
    moved[1] += 2e-3 * np.sin(angle) - 1.5e-3 * np.sin(angle) / np.sqrt(1 + 0.7 * np.cos(angle))
    data = measured(poses, np.array([target(q) for q in moved.T]).T, 1e-5, 7000)
    loop = search(Model(ARM, free=build(parse_requests(DECLARED), ARM, data)), data, empirical=False)
    number = [effect.name for effect in loop.effects].index("transmission_error")
    effect = loop.effects[number]
    finding = next(c for c in loop.selection.chosen if c.candidate.effect.search_key() == effect.search_key())
    _, named = rivals(loop.selection, finding, lag_refitted(loop, finding, effect, data))
    # The forms of a spring that the search tries first are 15 degrees apart: the best of them fits clearly worse.
    (spring,) = [alternative for alternative in named if alternative.effect == "counterbalance"]
    assert spring.similarity > 0.999
    assert spring.settings["centre_deg"] % 15.0 != 0.0
