"""Folds that choose different effects of one group, on an arm with a counterbalance and a simulation of its own."""

from __future__ import annotations

from functools import cache

import numpy as np
from independent_arm import DECLARED, measured, robot, run, target, torques

from robacc.effects.base import Effect
from robacc.effects.counterbalance import Counterbalance
from robacc.effects.gear_ratio import GearRatio
from robacc.effects.joint_compliance import JointCompliance
from robacc.effects.request import build, parse_requests
from robacc.fitting.cross_validation import held_out
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.robots.arm import Arm
from robacc.tracing.cross_validation import FoldChoices, _stood_for
from robacc.tracing.equal_votes import with_equal_votes
from robacc.tracing.loop import SearchResult, search
from robacc.tracing.refitting import refit
from robacc.tracing.without_finding import ReducedFits, fold_options

ARM = Arm.of(robot())
SPRING = JointCompliance(("j2",))
UNCERTAIN = JointCompliance(("j2",), "uncertain")


def balanced_arm(n: int, seed: int, size: float, noise: float = 1e-5) -> Measurements:
    """Poses of an arm whose joint 2 has a spring across it and gives way to the weight."""
    poses = run(n, seed)
    angle = poses.q[1] - np.radians(70.0)
    turn = 8e-7 * np.array([torques(q)[1] for q in poses.q.T])
    turn = turn + size * np.sin(angle) * (2e-3 - 1.5e-3 / np.sqrt(1 + 0.7 * np.cos(angle)))
    q = poses.q.copy()
    q[1] += turn
    return measured(poses, np.array([target(column) for column in q.T]).T, noise, seed)


@cache
def searched() -> tuple[SearchResult, Measurements, Effect]:
    """The search on 100 poses, which takes the counterbalance for a wave, and that wave."""
    data = balanced_arm(100, 7002, 0.085)
    result = search(Model(ARM, free=build(parse_requests(DECLARED), ARM, data)), data, empirical=False)
    (wave,) = (effect for effect in result.effects if effect.name == "transmission_error")
    assert set(result.effects) == {SPRING, wave}
    return result, data, wave


def choices_of(*by_fold: tuple[Effect, ...]) -> FoldChoices:
    """The choices of folds, matched to the findings of the search by name."""
    findings = searched()[0].effects
    matches = tuple({f.key(): tuple(e for e in fold if f.is_same_finding(e)) for f in findings} for fold in by_fold)
    return FoldChoices(matches, tuple(map(frozenset, by_fold)))


def test_a_fold_with_an_equal_of_a_finding_votes_for_it() -> None:
    result, data, wave = searched()
    split = choices_of((SPRING, wave), (SPRING, wave), (UNCERTAIN,), (UNCERTAIN,), (UNCERTAIN,))
    assert split.count(wave) == 2
    pooled = with_equal_votes(split, result, data)
    assert pooled.count(wave) == 5
    assert pooled.matching(wave, 4) == (UNCERTAIN,)


def test_a_fold_with_another_effect_does_not_vote_for_a_finding() -> None:
    result, data, wave = searched()
    other = GearRatio(("j5",))
    split = choices_of((SPRING, wave), (SPRING, wave), (SPRING, other), (SPRING, other), (SPRING,))
    assert with_equal_votes(split, result, data).count(wave) == 2


def test_an_alternative_that_half_of_the_folds_have_comes_in_the_findings_place() -> None:
    result, data, wave = searched()
    spring_across = Counterbalance(("j2",), 70.0, 0.7)
    three = choices_of((SPRING, wave), (SPRING, wave), *[(SPRING, spring_across)] * 3)
    assert with_equal_votes(three, result, data).count(wave) == 2
    two = choices_of((SPRING, wave), (SPRING,), (SPRING,), *[(SPRING, spring_across)] * 2)
    assert with_equal_votes(two, result, data).count(wave) == 3


def test_without_a_finding_an_effect_that_stood_for_two_leaves_the_other() -> None:
    result, data, wave = searched()
    assert _stood_for([SPRING, wave], [[UNCERTAIN], [UNCERTAIN]], 1) == [SPRING]
    assert _stood_for([SPRING, wave], [[SPRING], [wave]], 1) == []
    train, test = data.subset(np.arange(70)), data.subset(np.arange(70, 100))
    declared = result.declared.model.free
    options = fold_options(result.final)
    complete = refit(result.final, (*declared, UNCERTAIN), train, options)
    spring = refit(result.final, (*declared, SPRING), train, options)
    lacking = ReducedFits(complete, train, test, options).residuals([UNCERTAIN], [SPRING])
    assert lacking is not None
    # Two fits of the same model from different starts, to the convergence of a search.
    assert np.abs(lacking - held_out(spring, test))[:3].max() < 1e-7
