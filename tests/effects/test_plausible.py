"""Coefficients beyond what an effect can be are named, and compete with a handicap."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from arms import arm

from robacc.effects import REGISTRY
from robacc.effects.base import Effect
from robacc.effects.elastic import JointCompliance, JointHardening
from robacc.effects.request import build, parse_requests
from robacc.modelling.model import Model
from robacc.simulation.simulate import Plan, simulate
from robacc.tracing.search import search


@pytest.mark.parametrize("name", sorted(REGISTRY))
def test_usual_sizes_are_plausible_and_ten_thousand_times_that_is_not(name: str) -> None:
    cls: type[Effect] = REGISTRY[name]
    robot = dataclasses.replace(arm("irb1600").robot, effects=())
    data = simulate(robot, Plan(20, seed=1, noise_position=1e-5, orientation=False)).data
    data = dataclasses.replace(
        data, time=np.arange(20.0), temperature=20 + np.arange(20.0) / 5, payload=np.tile([0.0, 5.0], 10)
    )
    if cls.missing(Model.of(robot).arm, data):
        pytest.skip("not possible on these poses")
    (effect,) = build(parse_requests(name), Model.of(robot).arm, data)
    terms = effect.terms(Model.of(robot).arm, data)
    usual = cls.about.usual_range[1]
    assert effect.implausible(terms, [usual] * len(terms)) is None
    if not cls.traits.is_constant and any(term.unit == cls.about.unit.partition(" (")[0] for term in terms):
        assert "implausible" in effect.implausible(terms, [1e4 * usual] * len(terms))


def test_a_joint_that_hardly_carries_a_load_does_not_harden_by_it() -> None:
    one = Model.of(arm("puma560").robot).arm
    data = simulate(arm("puma560").robot, Plan(20, seed=1, noise_position=1e-5, orientation=False)).data
    for torque, is_plausible in ((80.0, True), (0.0019, False)):
        effect = JointHardening(("j5",), torque)
        reason = effect.implausible(effect.terms(one, data), [3.6e-4])
        assert (reason is None) is is_plausible
        if reason is not None:
            assert reason.endswith("is implausible: the joint would have a compliance of 0.57 rad/(N m)")


def test_a_negative_compliance_is_implausible_and_never_a_finding() -> None:
    robot = dataclasses.replace(arm("puma560").robot, effects=())
    data = simulate(robot, Plan(60, seed=2, noise_position=1e-5, orientation=False)).data
    compliance = JointCompliance(("j2",), masses="known")
    found = {}
    for value in (8e-6, -8e-6):
        bound = Model.of(robot, [compliance]).bind(data)
        theta = np.full(len(bound.terms), value)
        assert (compliance.implausible(bound.terms, theta.tolist()) is None) is (value > 0)
        shifted = dataclasses.replace(
            data, position=data.position + bound.poses(theta).translation - bound.poses(0 * theta).translation
        )
        model = Model.of(robot, build(parse_requests("base_frame"), Model.of(robot).arm, data))
        found[value > 0] = [effect.key() for effect in search(model, shifted).effects]
    assert found[True] == [compliance.key()]
    assert compliance.key() not in found[False]
