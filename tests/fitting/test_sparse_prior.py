"""Constants drawn to the table: fewer errors where few are wrong, none more where all are, intervals that hold."""

from __future__ import annotations

import dataclasses
from functools import cache
from itertools import product

import numpy as np
import pytest
from arms import arm

from robacc.effects import REGISTRY
from robacc.fitting.fit_result import Fit, Options
from robacc.fitting.priors import shrink_to_nominal
from robacc.fitting.solver import fit
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.robots.description import Robot
from robacc.simulation.simulate import Plan, simulate

NOISE = 2e-5
PLAN = Plan(60, noise_position=NOISE, orientation=False)
CONSTANTS = ("joint_offset", "link_geometry")
ONE = ({"effect": "link_geometry", "joints": ["j2"], "values": {"j2.a": 5e-4}},)


def measured(effects: tuple[dict[str, object], ...], seed: int, name: str = "puma560") -> Measurements:
    robot = dataclasses.replace(arm(name).robot, effects=effects, effect_units=(1.0, 1.0))
    return simulate(robot, dataclasses.replace(PLAN, seed=seed)).data


def plain(data: Measurements, *names: str, robot: str = "puma560") -> Fit:
    one = arm(robot)
    free = [REGISTRY[name].default(one, data) for name in ("base_frame", "tool_frame", *names)]
    return fit(Model.of(one.robot, free), data, Options(misfit=(NOISE, NOISE)))


@cache
def everywhere() -> tuple[dict[str, object], ...]:
    """Every constant off by some 0.2 mm or mrad, as a robot file has it."""
    found = plain(measured((), 0), *CONSTANTS)
    rng = np.random.default_rng(3)
    entries: list[dict[str, object]] = []
    for number, effect in enumerate(found.model.free):
        if effect.name in CONSTANTS:
            own = [n for n, owner in zip(found.names, found.owners, strict=True) if owner == number]
            values = {n.partition(".")[2]: float(rng.choice([-1, 1]) * rng.uniform(1e-4, 3e-4)) for n in own}
            entries.append({"effect": effect.name, "joints": list(effect.joints), "values": values})
    return tuple(entries)


def error(found: Fit, robot: Robot) -> float:
    """Root mean square of what is predicted wrong at poses of their own, m."""
    fresh = simulate(robot, Plan(200, seed=77, orientation=False)).data
    missed = fresh.position - found.model.bind(fresh).poses(found.theta).translation
    return float(np.sqrt(np.mean(np.sum(np.square(missed), axis=0))))


def test_where_one_length_is_wrong_it_is_found_and_noise_moves_no_other() -> None:
    robot = dataclasses.replace(arm("puma560").robot, effects=ONE, effect_units=(1.0, 1.0))
    squares = np.zeros(2)
    for seed in range(1, 6):
        data = measured(ONE, seed)
        alone = plain(data, "link_geometry")
        found, kinds = shrink_to_nominal(alone, data, Options(misfit=(NOISE, NOISE)), CONSTANTS)
        lengths = next(kind for kind in kinds if kind.unit == "m")
        chances = dict(zip(lengths.names, lengths.probability, strict=True))
        assert chances.pop("link_geometry.j2.a") > 0.999
        assert max(chances.values()) < 0.5
        assert lengths.std == pytest.approx(5e-4, rel=0.2)
        # What is found is as least squares has it, and standard errors are those of least squares.
        at = found.names.index("link_geometry.j2.a")
        deviation = float(np.sqrt(alone.covariance[at, at]))
        assert found.theta[at] == pytest.approx(5e-4, abs=4 * deviation)
        np.testing.assert_array_equal(found.covariance, alone.covariance)
        assert found.degrees_of_freedom > alone.degrees_of_freedom + 4
        squares += np.square((error(found, robot), error(alone, robot)))
    # 26 coefficients against 10 known in advance: sqrt(10 / 26) at best.
    assert np.sqrt(squares[0] / squares[1]) < 0.75


def test_where_most_are_wrong_least_squares_stays() -> None:
    data = measured(everywhere(), 1)
    alone = plain(data, *CONSTANTS)
    found, kinds = shrink_to_nominal(alone, data, Options(misfit=(NOISE, NOISE)), CONSTANTS)
    assert kinds == ()
    assert found is alone


def test_kinds_are_judged_apart() -> None:
    # Every offset wrong, no length: only lengths are drawn.
    entry = {"effect": "joint_offset", "joints": ["j2", "j3", "j4", "j5", "j6"]}
    values = {"j2": 1e-3, "j3": -8e-4, "j4": 9e-4, "j5": -1e-3, "j6": 7e-4}
    twists = {"effect": "link_geometry", "joints": ["j1", "j2", "j3", "j4", "j5"]}
    off = {f"j{i}.alpha": 1e-3 * (-1) ** i for i in range(1, 6)}
    data = measured(({**entry, "values": values}, {**twists, "values": off}), 2)
    alone = plain(data, *CONSTANTS)
    found, kinds = shrink_to_nominal(alone, data, Options(misfit=(NOISE, NOISE)), CONSTANTS)
    assert [kind.unit for kind in kinds] == ["m"]
    lengths = [i for i in found.identifiability.columns if found.names[i] in kinds[0].names]
    assert np.linalg.norm(found.theta[lengths]) < 0.5 * np.linalg.norm(alone.theta[lengths])


def test_probabilities_are_those_of_all_subsets_counted() -> None:
    # Bayes' rule over the 2^n models of which offsets differ, with the widths and shares that were found.
    entry = {"effect": "joint_offset", "joints": ["panda_joint4"], "values": {"panda_joint4": 4e-4}}
    data = measured((entry,), 4, "panda")
    alone = plain(data, "joint_offset", robot="panda")
    _, (kind,) = shrink_to_nominal(alone, data, Options(misfit=(NOISE, NOISE)), CONSTANTS)
    kept = [alone.names[i] for i in alone.identifiability.columns]
    own, others = [kept.index(name) for name in kind.names], [i for i, n in enumerate(kept) if n not in kind.names]
    share = (sum(kind.probability) + 0.5) / (len(own) + 1.0)
    evidence, models = [], list(product((False, True), repeat=len(own)))
    for chosen in models:
        inside = [own[i] for i in np.flatnonzero(chosen)]
        columns = others + inside
        prior = np.array([0.0] * len(others) + [kind.std**-2] * len(inside))
        matrix = alone.gram[np.ix_(columns, columns)] + np.diag(prior)
        moment = alone.rhs[columns]
        log = 0.5 * moment @ np.linalg.solve(matrix, moment) - 0.5 * np.linalg.slogdet(matrix)[1]
        log += 0.5 * np.log(prior[len(others) :]).sum() + len(inside) * np.log(share / (1.0 - share))
        evidence.append(log)
    weight = np.exp(np.array(evidence) - max(evidence))
    exact = (weight @ np.array(models, dtype=float)) / weight.sum()
    # The mean field takes each offset's neighbours at their mean.
    np.testing.assert_allclose(kind.probability, exact, atol=0.01)
    assert sorted(exact)[-1] > 0.99
