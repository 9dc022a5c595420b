"""Orders of one joint are found only as far apart as the joint's range separates them."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
from arms import arm

from robacc.effects.periodic import are_separable, orders_of
from robacc.effects.specification import build, parse_requests
from robacc.modelling.model import Model, predict
from robacc.simulation.simulate import Plan, simulate
from robacc.tracing.search import search

AMPLITUDE, ORDER, RANGE = 3e-4, 12.6, 1.2


def test_a_wave_that_grows_with_the_angle_is_no_pair_of_large_waves() -> None:
    """Two orders close together describe it as well, with amplitudes ten times as large that cancel each other."""
    robot = dataclasses.replace(arm("irb1600").robot, effects=())
    poses = simulate(robot, Plan(400, seed=5, noise_position=0.0, orientation=False)).data
    rng, q = np.random.default_rng(0), poses.q.copy()
    q[1] = rng.uniform(-RANGE / 2, RANGE / 2, poses.n)
    turned = q.copy()
    turned[1] += AMPLITUDE * (1.0 + 0.5 * q[1]) * np.cos(ORDER * q[1])
    position = predict(robot, dataclasses.replace(poses, q=turned)).translation
    data = dataclasses.replace(poses, q=q, position=position + 1e-5 * rng.standard_normal(position.shape))
    start = Model.of(robot)
    free = build(parse_requests("base_frame,tool_frame,joint_offset"), start.arm, data)
    result = search(Model(start.arm, start.known, free), data, only=("transmission_error",))
    orders = sorted(order for effect in result.effects for order in orders_of(effect))
    assert min(abs(order - ORDER) for order in orders) < 0.5
    assert all(are_separable(low, high, RANGE) for low, high in itertools.pairwise(orders))
    values = [t for name, t in zip(result.state.bound.names, result.state.theta, strict=True) if "transmission" in name]
    assert max(map(abs, values)) < 1.5 * AMPLITUDE
