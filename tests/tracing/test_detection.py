"""What poses could have shown: limits against power computed from the Jacobian, and what they must depend on."""

from __future__ import annotations

import dataclasses
import math
from functools import cache

import numpy as np
import pytest
from arms import arm
from draws import KINDS, draw
from scipy import stats
from test_trace import DECLARED, NOISE, entry, measured

import robacc
from robacc.effects.base import effect_class
from robacc.effects.request import build, parse_requests
from robacc.effects.specification import entry_of
from robacc.measurements import Measurements
from robacc.modelling.model import Model, predict
from robacc.modelling.observation import observed_jacobian
from robacc.tracing.detection import DetectionLimit, decisive_test, detection_limits
from robacc.tracing.loop import SearchResult, search
from robacc.tracing.selection import FALSE_ALARM, fold_level
from robacc.tracing.trace import trace

CIRCUMSTANCES = {"time_step": 30.0, "temperature": (18.0, 30.0), "payloads": (0.0, 2.0, 5.0)}


def looped(name: str, data: Measurements) -> SearchResult:
    model = Model.of(arm(name).robot)
    return search(dataclasses.replace(model, free=build(parse_requests(DECLARED), model.arm, data)), data)


def limits(loop: SearchResult, n_folds: int = 0, share: float = 1.0) -> list[DetectionLimit]:
    return detection_limits(loop.selection, loop.final.weight[:, loop.final.inliers], n_folds, share)


@cache
def clean(name: str, n: int = 80, noise: float = NOISE) -> tuple[Measurements, SearchResult]:
    data = measured(name, n=n, noise_position=noise, **CIRCUMSTANCES)
    return data, looped(name, data)


def by_name(found: list[DetectionLimit]) -> dict[str, DetectionLimit]:
    return {f"{one.effect}{one.joints}{sorted(one.settings.items())}": one for one in found}


@pytest.mark.parametrize("name", ["puma560", "scara"])
@pytest.mark.parametrize("n_folds", [0, 5])
def test_at_the_limit_the_f_test_finds_every_second_one(name: str, n_folds: int) -> None:
    data, loop = clean(name)
    assert loop.effects == ()
    known = loop.final.identifiability.columns
    scorer = loop.selection.scorer
    priors = {candidate.key: candidate.log_prior for candidate in (*scorer.pool, *scorer.steps_in_the_middle())}
    learnt = 1 - 1 / n_folds if n_folds else 1.0
    checked = 0
    for one in limits(loop, n_folds):
        if one.limit is None:
            continue
        effect = effect_class(one.effect).from_settings(one.joints, one.settings)
        bound = loop.final.model.with_free(effect).bind(data)
        theta = np.concatenate((loop.final.theta, np.zeros(len(bound.terms) - loop.final.theta.size)))
        rows = observed_jacobian(bound.linearise(theta)[1], loop.final.residual) * loop.final.weight[:, None]
        columns = np.moveaxis(rows, 1, 2).reshape(-1, rows.shape[1])
        basis = np.linalg.qr(columns[:, known])[0]
        own = columns[:, loop.final.theta.size :]
        # The direction that is the hardest to see.
        seen = np.linalg.svd(own - basis @ (basis.T @ own), compute_uv=False)[-1] ** 2
        rank, freedom = own.shape[1], columns.shape[0] - known.size
        level = (fold_level(learnt) if n_folds else FALSE_ALARM) * math.exp(priors[effect.key()])
        rest = round(freedom * learnt) - rank
        # Search, folds and held-out gain must agree: see the next test.
        share = learnt / 1.12 if n_folds else 1.0
        power = stats.ncf.sf(stats.f.isf(level, rank, rest), rank, rest, share * one.limit**2 * seen)
        # The residual is whitened to a mean square of one by the fit, within what its convergence leaves.
        assert power == pytest.approx(0.5, abs=2e-3), one
        checked += 1
    assert checked > 30


def reported(
    rng: np.random.Generator, poses: int, free: int, rank: int, noncentrality: float, log_prior: float
) -> bool:
    """Whether one linear campaign passes the three tests of a trace: search, three of five folds, held-out gain."""
    base, effect = rng.normal(size=(3 * poses, free)), rng.normal(size=(3 * poses, rank))
    both = np.hstack((base, effect))
    basis = np.linalg.qr(base)[0]
    true = effect @ rng.normal(size=rank)
    seen = true - basis @ (basis.T @ true)
    y = rng.normal(size=3 * poses) + true * math.sqrt(noncentrality / float(seen @ seen))
    fold = np.repeat(rng.permutation(np.arange(poses) % 5), 3)

    def tested(rows: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        errors = [y - columns @ np.linalg.lstsq(columns[rows], y[rows])[0] for columns in (base, both)]
        without, beside = (float(e[rows] @ e[rows]) for e in errors)
        dof = int(rows.sum()) - free - rank
        return float(stats.f.sf((without - beside) / rank / (beside / dof), rank, dof)), errors[0], errors[1]

    if tested(np.ones(3 * poses, bool))[0] > FALSE_ALARM * math.exp(log_prior):
        return False
    gain, recurs = np.zeros(3 * poses), 0
    for number in range(5):
        p_value, without, beside = tested(fold != number)
        recurs += p_value <= fold_level(0.8) * math.exp(log_prior)
        gain += np.where(fold == number, without**2 - beside**2, 0.0)
    per_pose = gain.reshape(poses, 3).sum(axis=1)
    return recurs >= 3 and float(per_pose.mean()) > 1.0 * float(per_pose.std(ddof=1)) / math.sqrt(poses)


def test_without_a_degree_of_freedom_nothing_is_found() -> None:
    """As many coefficients as values: no test, and no division by zero."""
    test = decisive_test(1, 1.0, -math.log(80.0))
    assert test.dof[1] == 0.0
    assert test.noncentrality_at_limit == math.inf
    assert test.power(1e9) == 0.0


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


@pytest.mark.parametrize(("poses", "free", "rank"), [(40, 15, 1), (60, 30, 2)])
def test_at_the_limit_search_folds_and_gain_agree_in_half_of_the_campaigns(poses: int, free: int, rank: int) -> None:
    log_prior = -math.log(80.0)
    limit = decisive_test(rank, 3.0 * poses - free, log_prior, 5).noncentrality_at_limit
    rng = np.random.default_rng(3)
    share = {
        f: np.mean([reported(rng, poses, free, rank, f**2 * limit, log_prior) for _ in range(200)]) for f in (1, 2)
    }
    # 200 campaigns: three standard deviations are 0.11.
    assert share[1] == pytest.approx(0.5, abs=0.12)
    assert share[2] > 0.99


@pytest.mark.slow
def test_limits_follow_noise_and_number_of_poses() -> None:
    few, many, noisy = (by_name(limits(clean("puma560", *which)[1])) for which in ((80,), (320,), (80, 3 * NOISE)))
    seen = [key for key, one in few.items() if one.limit and key in many and many[key].limit and noisy[key].limit]
    assert len(seen) > 50
    assert np.median([few[key].limit / many[key].limit for key in seen]) == pytest.approx(2.0, rel=0.15)  # type: ignore[operator]
    for key in seen:
        # The noise is the same numbers three times as large, but for the curvature of what is fitted.
        assert noisy[key].limit == pytest.approx(3 * few[key].limit, rel=0.03), key  # type: ignore[operator]


def test_a_share_of_the_poses_stands_for_all_of_them() -> None:
    loop = clean("puma560")[1]
    whole, half = by_name(limits(loop)), by_name(limits(loop, share=0.5))
    for key, one in whole.items():
        if one.limit is not None and half[key].limit is not None:
            # Twice the poses, and so twice the degrees of freedom, which are worth another percent or two, the more the
            # lower the level is: a step's is that of a search over its places.
            assert half[key].limit == pytest.approx(one.limit / math.sqrt(2), rel=0.03)


def test_what_no_size_shows_has_no_limit() -> None:
    found = by_name(limits(clean("puma560")[1]))
    # The first axis is upright: gravity has no moment about it. All lengths free: no scale of the instrument besides.
    for key in ("joint_compliance('j1',)[]", "instrument_scale()[]"):
        assert (found[key].limit, found[key].rms) == (None, None)
    assert found["joint_compliance('j2',)[]"].limit is not None


def test_the_shift_at_the_limit_is_what_such_an_effect_does() -> None:
    data, loop = clean("puma560")
    robot = arm("puma560").robot
    checked = 0
    for one in limits(loop):
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
    found, before = by_name(limits(loop)), by_name(limits(clean("puma560")[1]))
    assert "gear_ratio('j2',)[]" not in found
    # What is found is in the model, so its residual is not noise; what is like it is seen less well.
    assert found["backlash('j6',)[]"].limit == pytest.approx(before["backlash('j6',)[]"].limit, rel=0.1)
    alike = "transmission_error('j2',)[('orders', [1.0])]"
    assert found[alike].limit > 1.1 * before[alike].limit  # type: ignore[operator]


def test_a_form_that_others_make_up_is_not_repeated() -> None:
    found = limits(clean("puma560")[1])
    orders = [one.settings["orders"] for one in found if one.effect == "transmission_error" and one.joints == ("j2",)]
    assert orders == [[1.0], [2.0], [107.815]]
    assert all(one.effect != "base_frame" for one in found)


@pytest.mark.parametrize("which", [pytest.param("backlash", marks=pytest.mark.slow), "thermal_expansion"])
def test_far_beyond_the_limit_an_effect_is_named_and_far_below_it_is_not(which: str) -> None:
    one = draw(KINDS[which], 0)
    for times, expected in ((10.0, True), (0.1, False)):
        data = one.measured(times)
        found = trace(one.model(data), data, n_folds=2)
        assert one.is_named(found) is expected
        assert len(found.findings) == expected
        assert one.power(times, 2) == pytest.approx(float(expected), abs=1e-3)
