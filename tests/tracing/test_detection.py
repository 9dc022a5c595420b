"""What poses could have shown: limits against power computed from the Jacobian, and what they must depend on."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
from arms import arm
from draws import KINDS, draw
from scipy import stats
from test_trace import DECLARED, NOISE, entry, measured

import robacc
from robacc.effects.base import effect_class
from robacc.effects.specification import build, entry_of, parse_requests
from robacc.measurements import Measurements
from robacc.modelling.model import Model, predict
from robacc.tracing.candidates import decisive_test
from robacc.tracing.search import DetectionLimit, SearchResult, detection_limits, search
from robacc.tracing.trace import trace

CIRCUMSTANCES = {"time_step": 30.0, "temperature": (18.0, 30.0), "payloads": (0.0, 2.0, 5.0)}


def looped(name: str, data: Measurements) -> SearchResult:
    model = Model.of(arm(name).robot)
    return search(dataclasses.replace(model, free=build(parse_requests(DECLARED), model.arm, data)), data)


@cache
def clean(name: str, n: int = 80, noise: float = NOISE) -> tuple[Measurements, SearchResult]:
    data = measured(name, n=n, noise_position=noise, **CIRCUMSTANCES)
    return data, looped(name, data)


def by_name(found: list[DetectionLimit]) -> dict[str, DetectionLimit]:
    return {f"{one.effect}{one.joints}{sorted(one.settings.items())}": one for one in found}


@pytest.mark.parametrize("name", ["puma560", "scara"])
def test_at_the_limit_the_f_test_finds_every_second_one(name: str) -> None:
    data, found = clean(name)
    assert found.effects == ()
    state, candidates = found.state, {candidate.key: candidate for candidate in found.pool.all}
    known = state.linear.columns / state.noise.independent(state.linear.rows.stated)[:, :, None]
    known = known.reshape(-1, known.shape[2]) * state.linear.prior_std
    # The priors are one more row a coefficient.
    basis = np.linalg.qr(np.concatenate((known, np.eye(known.shape[1]))))[0]
    effective = known.shape[1] - float(np.trace(np.linalg.inv(known.T @ known + np.eye(known.shape[1]))))
    checked = 0
    for one in detection_limits(found):
        if one.limit is None:
            continue
        effect = effect_class(one.effect).from_settings(one.joints, one.settings)
        candidate = candidates[effect.key()]
        bound = found.model.with_free(effect).bind(data)
        theta = np.concatenate((state.theta, np.zeros(len(bound.terms) - state.theta.size)))
        columns = np.moveaxis(bound.linearise(theta, rows=3)[1], -1, 0)[:, :, state.theta.size :]
        own = (columns / state.noise.independent(state.linear.rows.stated)[:, :, None]).reshape(len(known), -1)
        own = np.concatenate((own * candidate.sizes / candidate.sizes[0], np.zeros((known.shape[1], own.shape[1]))))
        # The direction that is the hardest to see.
        seen = np.linalg.svd(own - basis @ (basis.T @ own), compute_uv=False)[-1] ** 2
        rank, rest = own.shape[1], len(known) - effective - own.shape[1]
        level = decisive_test(rank, rest + rank, candidate.log_prior_of_size).level
        power = stats.ncf.sf(stats.f.isf(level, rank, rest), rank, rest, one.limit**2 * seen)
        assert power == pytest.approx(0.5, abs=0.02), one
        checked += 1
    assert checked > 30


@pytest.mark.parametrize("poses", [10, 11])
def test_a_trace_of_few_poses_ends(poses: int) -> None:
    """Two and five degrees of freedom are left beside the geometry."""
    robot = arm("puma560").robot
    q = np.random.default_rng(4).uniform(-1.5, 1.5, (6, poses))
    position = predict(robot, Measurements(position=np.zeros((3, poses)), q=q)).translation
    data = Measurements(position=position + 2e-5 * np.random.default_rng(5).standard_normal((3, poses)), q=q)
    result = robacc.trace(data, robot=robot, declared="base_frame,tool_frame,joint_offset,link_geometry")
    assert not result.findings
    assert len(result.document()["detection_limits"]) > 20


@pytest.mark.slow
def test_limits_follow_noise_and_number_of_poses() -> None:
    few, many, noisy = (
        by_name(detection_limits(clean("puma560", *which)[1])) for which in ((80,), (320,), (80, 3 * NOISE))
    )
    seen = [key for key, one in few.items() if one.limit and key in many and many[key].limit and noisy[key].limit]
    assert len(seen) > 50
    assert np.median([few[key].limit / many[key].limit for key in seen]) == pytest.approx(2.0, rel=0.15)  # type: ignore[operator]
    for key in seen:
        # The noise is the same numbers three times as large, but for the curvature of what is fitted.
        assert noisy[key].limit == pytest.approx(3 * few[key].limit, rel=0.03), key  # type: ignore[operator]


def test_what_no_size_shows_has_no_limit() -> None:
    found = by_name(detection_limits(clean("puma560")[1]))
    # The first axis is upright: gravity has no moment about it. All lengths free: no scale of the instrument besides.
    for key in ("joint_compliance('j1',)[]", "instrument_scale()[]"):
        assert (found[key].limit, found[key].rms) == (None, None)
    assert found["joint_compliance('j2',)[]"].limit is not None


def test_the_shift_at_the_limit_is_what_such_an_effect_does() -> None:
    data, loop = clean("puma560")
    robot = arm("puma560").robot
    checked = 0
    for one in detection_limits(loop):
        effect = effect_class(one.effect).from_settings(one.joints, one.settings)
        terms = effect.terms(arm("puma560"), data)
        if one.limit is None or len(terms) > 1:
            continue
        other = dataclasses.replace(robot, effects=(entry_of(effect, {terms[0].name: one.limit}),))
        moved = predict(other, data).translation - predict(robot, data).translation
        # To first order, and from a fitted arm rather than the nominal one.
        assert one.rms == pytest.approx(float(np.sqrt(np.mean(np.sum(moved**2, axis=0)))), rel=0.03)
        checked += 1
    assert checked > 20


def test_limits_stand_beside_what_was_found() -> None:
    data = measured("puma560", entry("gear_ratio", "j2", 4e-4), **CIRCUMSTANCES)
    loop = looped("puma560", data)
    assert [str(effect) for effect in loop.effects] == ["gear_ratio[j2]"]
    found, before = by_name(detection_limits(loop)), by_name(detection_limits(clean("puma560")[1]))
    assert "gear_ratio('j2',)[]" not in found
    # What is found is in the model, so its residual is not noise; what is like it is seen less well.
    assert found["backlash('j6',)[]"].limit == pytest.approx(before["backlash('j6',)[]"].limit, rel=0.1)
    alike = "transmission_error('j2',)[('orders', [1.0])]"
    assert found[alike].limit > 1.1 * before[alike].limit  # type: ignore[operator]


@pytest.mark.parametrize("which", [pytest.param("backlash", marks=pytest.mark.slow), "thermal_expansion"])
def test_far_beyond_the_limit_an_effect_is_named_and_far_below_it_is_not(which: str) -> None:
    one = draw(KINDS[which], 0)
    for times, expected in ((10.0, True), (0.1, False)):
        data = one.measured(times)
        found = trace(one.model(data), data, n_folds=2)
        assert one.is_named(found) is expected
        assert len(found.findings) == expected
        assert one.power(times) == pytest.approx(float(expected), abs=1e-3)
