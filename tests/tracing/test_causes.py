"""Causes: what each effect of a fit does at the target, against the truth of a simulation and against refits."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from arms import arm

from robacc.effects.specification import build, parse_requests
from robacc.fitting.fit_result import Fit, Options
from robacc.fitting.solver import fit
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.simulation.simulate import Plan, simulate
from robacc.tracing.calibrating import ErrorCause, causes

NOISE = 5e-5
FIT = "base_frame,tool_frame,joint_offset,link_geometry,gear_ratio[j3]"
ZEROS = {"j2": 4e-4, "j3": -3e-4}
EFFECTS = (
    {"effect": "joint_offset", "joints": list(ZEROS), "values": ZEROS},
    {"effect": "link_geometry", "joints": ["j2"], "values": {"j2.a": 3e-4}},
    {"effect": "gear_ratio", "joints": ["j3"], "values": {"j3": 2e-4}},
)


def fitted(seed: int, asked: str = FIT) -> tuple[Fit, Measurements]:
    one = arm("puma560")
    robot = dataclasses.replace(one.robot, effects=EFFECTS)
    data = simulate(robot, Plan(80, seed=seed, noise_position=NOISE, orientation=False)).data
    return fit(Model.of(one.robot, build(parse_requests(asked), one, data)), data, Options(robust=False)), data


def by_name(found: tuple[ErrorCause, ...]) -> dict[tuple[str, tuple[str, ...]], ErrorCause]:
    return {(cause.effect, cause.joints): cause for cause in found}


def test_the_causes_are_those_that_are_there_the_largest_first() -> None:
    fitted_to, data = fitted(1)
    found = causes(fitted_to, data, 1e-3)
    assert [cause.left for cause in found] == sorted((cause.left for cause in found), reverse=True)
    assert {(cause.effect, cause.joints[0]) for cause in found[:4]} == {
        ("joint_offset", "j2"),
        ("joint_offset", "j3"),
        ("link_geometry", "j2"),
        ("gear_ratio", "j3"),
    }
    assert all(cause.declared for cause in found)
    effects = [effect for effect in fitted_to.model.free if effect.name == "gear_ratio"]
    again = by_name(causes(fitted_to, data, 1e-3, effects))
    assert not again["gear_ratio", ("j3",)].declared


def test_the_error_without_a_cause_is_that_of_a_fit_without_it() -> None:
    whole, data = fitted(2)
    lacking, _ = fitted(2, FIT.rpartition(",")[0])
    cause = by_name(causes(whole, data, 1e-3))["gear_ratio", ("j3",)]
    squares = [float(np.mean(np.sum(np.square(one.residual), axis=0))) for one in (whole, lacking)]
    assert cause.left == pytest.approx(np.sqrt(squares[1] - squares[0]), rel=0.02)
    assert cause.share == pytest.approx(cause.left**2 / 1e-6)


def test_intervals_hold_what_the_effects_really_do() -> None:
    inside = {("gear_ratio", "j3"): 0, ("joint_offset", "j2"): 0, ("link_geometry", "j2"): 0}
    runs = 60
    for seed in range(100, 100 + runs):
        whole, data = fitted(seed)
        truth = np.zeros(whole.theta.size)
        for entry in EFFECTS:
            for name, value in entry["values"].items():  # type: ignore[attr-defined]
                truth[whole.names.index(f"{entry['effect']}.{name}")] = value
        bound = whole.model.bind(data)
        _, jacobian = bound.linearise(whole.theta, None, 3)
        found = by_name(causes(whole, data, 1e-3))
        for effect, joint in inside:
            mask = np.array([name.startswith(f"{effect}.{joint}") for name in whole.names])
            moved = np.einsum("mkn,k->mn", jacobian[:, mask], truth[mask])
            size = float(np.sqrt(np.mean(np.sum(moved**2, axis=0))))
            low, high = found[effect, (joint,)].interval
            inside[effect, joint] += low <= size <= high
    # 95 % of 60: 50 or fewer have a probability of 0.1 %.
    assert min(inside.values()) > 50


def test_what_the_poses_do_not_distinguish_from_nothing_is_no_cause() -> None:
    one = arm("puma560")
    plan = Plan(60, seed=3, noise_position=NOISE, orientation=False)
    data = simulate(dataclasses.replace(one.robot, effects=()), plan).data
    whole = fit(Model.of(one.robot, build(parse_requests(FIT), one, data)), data)
    found = causes(whole, data, NOISE)
    assert len(found) <= 4  # 5 % of some thirteen groups, by chance
    assert all(cause.size < 3 * NOISE for cause in found)
