"""What a search reports was fitted together, whether its choice settled or not."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from arms import arm

from robacc.effects.request import build, parse_requests
from robacc.measurements import Measurements
from robacc.modelling.model import Model, predict
from robacc.simulation.simulate import Plan, simulate
from robacc.tracing import loop
from robacc.tracing.loop import SearchResult, search

BASELINE = "base_frame,tool_frame,joint_offset"


def measured(effects: str, seed: int) -> tuple[Model, Measurements]:
    """Return a model with the baseline free, and poses of an arm with ``effects`` besides."""
    robot = arm("irb1600").robot
    nominal = dataclasses.replace(robot, effects=())
    data = simulate(nominal, Plan(60, seed=seed, noise_position=2e-5, orientation=False)).data
    hidden = build(parse_requests(effects), Model.of(nominal).arm, data)
    model = Model.of(nominal, hidden)
    bound = model.bind(data)
    rng = np.random.default_rng(seed)
    theta = np.array([term.typical for term in bound.terms]) * rng.uniform(2.0, 6.0, len(bound.terms))
    shift = bound.poses(theta).translation - predict(nominal, data).translation
    data = dataclasses.replace(data, position=data.position + shift)
    return Model.of(nominal, build(parse_requests(BASELINE), Model.of(nominal).arm, data)), data


def assert_fitted_together(result: SearchResult) -> None:
    reported = {effect.search_key() for effect in result.effects}
    fitted = {effect.search_key() for effect in result.final.model.free[len(result.declared.model.free) :]}
    selected = {result.selection.refined(choice).search_key() for choice in result.selection.chosen}
    frames = {effect.search_key() for effect in result.effects if effect.is_frame}
    assert reported == fitted == selected | frames


@pytest.mark.parametrize("rounds", [0, pytest.param(1, marks=pytest.mark.slow), 4])
@pytest.mark.parametrize(
    "effects",
    [
        pytest.param("joint_compliance[j2,j3]", marks=pytest.mark.slow),
        "backlash[j3],joint_coupling[j5]",
        "gear_ratio[j2]",
    ],
)
def test_effects_fit_and_selection_agree(effects: str, rounds: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(loop, "_ROUNDS", rounds)
    model, data = measured(effects, 5)
    result = search(model, data)
    assert result.effects
    assert_fitted_together(result)
    # The rounds end before the choice repeats itself only where none are allowed.
    assert result.settled or rounds < 4
