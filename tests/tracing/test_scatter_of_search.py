"""Scatter that targets of a visit share is not explained by effects, and stays known where findings are withdrawn."""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import Any

import numpy as np
import pytest
from arms import arm

from robacc.effects.request import build, parse_requests
from robacc.fitting.repeatability import Components
from robacc.measurements import Measurements
from robacc.modelling.model import Model, predict
from robacc.robots.description import Frame
from robacc.simulation.simulate import Plan, simulate
from robacc.tracing import loop
from robacc.tracing.confirmation import _with_effects
from robacc.tracing.loop import search
from robacc.tracing.remaining_scatter import with_remaining_scatter

SCATTER, NOISE = 1e-4, 2e-5
CANDIDATES = ("transmission_error", "joint_correction", "gear_ratio")
POSES = 50


@cache
def campaign() -> tuple[Model, Measurements]:
    """Three targets at each pose of a good arm whose joints scatter from visit to visit."""
    targets = {name: Frame(xyz=xyz) for name, xyz in zip("ABC", 0.1 * np.eye(3) + 0.05, strict=True)}
    robot = dataclasses.replace(arm("irb1600").robot, effects=(), targets=targets)
    data = simulate(robot, Plan(POSES, seed=4, noise_position=0.0, orientation=False)).data
    assert data.q is not None
    assert data.n == 3 * POSES
    visit = np.unique(data.q, axis=1, return_inverse=True)[1].ravel()
    rng = np.random.default_rng(7)
    moved = data.q + SCATTER * rng.standard_normal((data.q.shape[0], POSES))[:, visit]
    position = predict(robot, dataclasses.replace(data, q=moved)).translation
    data = dataclasses.replace(data, position=position + NOISE * rng.standard_normal(position.shape))
    start = Model.of(robot)
    free = build(parse_requests("base_frame,tool_frame,joint_offset"), start.arm, data)
    return Model(start.arm, start.known, free), data


def assert_is_known(components: Components | None) -> None:
    assert components is not None
    # 50 visits show the first three joints to about 13 % (standard error), and the noise to 5 %.
    assert components.scatter.visit_std[:3] == pytest.approx([SCATTER] * 3, rel=0.4)
    assert components.noise[0] == pytest.approx(NOISE, rel=0.2)


def test_scatter_is_not_explained_by_effects(monkeypatch: pytest.MonkeyPatch) -> None:
    ends: list[Any] = []

    def white(*end: Any) -> Any:
        ends.append(end)
        return end

    with monkeypatch.context() as patch:
        patch.setattr(loop, "_better_with_scatter", white)
        model, data = campaign()
        result = search(model, data, only=CANDIDATES)
    # Without the comparison, effects explain the scatter, and none is left.
    names = [str(effect) for effect in result.effects]
    assert len(names) > 2
    assert result.components is None
    # With it, the search starts with scatter, and finds no effect.
    state, last, settled = loop._better_with_scatter(*ends[0])
    assert settled
    assert [str(effect) for effect in last.effects] == []
    assert_is_known(state.components)
    # Where the effects are withdrawn instead, the scatter is estimated anew.
    assert id(with_remaining_scatter(result, result, data)) == id(result)
    clean = with_remaining_scatter(result, _with_effects(result, (), data), data)
    assert_is_known(clean.components)
    assert clean.options.scatter is not None
    assert clean.final.misfit[0] == pytest.approx(NOISE, rel=0.2)
    assert clean.selection.chosen == []
