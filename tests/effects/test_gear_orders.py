"""Orders far above 40 are found, named by the gear, and their aliases listed; on an arm with matrices of its own."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from independent_arm import measured, robot, run
from searched import model

from robacc.effects.periodic import (
    HIGHEST_OF_ALL,
    HIGHEST_ORDER,
    ORDER_STEP,
    high_orders,
    order_tolerance,
    origin_of,
    supported_orders,
)
from robacc.robots.arm import Arm
from robacc.robots.description import Robot
from robacc.tracing.candidates import OrderGrid
from robacc.tracing.trace import Trace, trace


def with_ratio(ratio: float | None) -> Robot:
    joints = list(robot().joints)
    joints[1] = dataclasses.replace(joints[1], gear_ratio=ratio)
    return dataclasses.replace(robot(), joints=tuple(joints))


def traced(order: float, ratio: float | None, n: int = 110, amplitude: float = 2e-4) -> Trace:
    poses = run(n, seed=12)
    data = measured(poses, poses.turned(1, amplitude * np.cos(order * poses.q[1] - 0.7)), 2e-5, 12)
    return trace(model(data, Arm.of(with_ratio(ratio))), data, n_folds=3)


@pytest.mark.parametrize(("order", "ratio", "word"), [(81.0, None, "typical gear of ratio 81"), (126.0, 63.0, "wave")])
def test_a_high_order_is_found_and_named(order: float, ratio: float | None, word: str) -> None:
    result = traced(order, ratio)
    assert [(finding.effect, finding.joints) for finding in result.findings] == [("transmission_error", ("j2",))]
    (harmonic,) = result.findings[0].harmonics
    assert harmonic.order == pytest.approx(order, abs=0.1)
    assert harmonic.amplitude == pytest.approx(2e-4, rel=0.15)
    assert word in harmonic.origin
    assert result.findings[0].statement is not None


def test_evenly_spaced_angles_have_aliases() -> None:
    """Angles at multiples of a step show the orders n and 2 pi / step - n alike."""
    angle = np.arange(-30, 31) * (2 * np.pi / 98.25)
    uneven = np.random.default_rng(1).uniform(-2.0, 2.0, 61)
    for apart, expected in ((angle, {17.25, 81.0}), (uneven, {17.25})):
        grid = OrderGrid("j1", 0, np.arange(0.25, 98, 0.25), apart, 0.0)
        peaks = grid.peaks(np.cos(17.25 * apart - 0.3), np.ones(61))
        assert set(peaks[: len(expected)].tolist()) == expected


def test_grids_meet_and_end_at_what_the_poses_support() -> None:
    angle = np.random.default_rng(1).uniform(-2.5, 2.5, 200)
    low, high = supported_orders(angle), high_orders(angle)
    assert low[-1] == HIGHEST_ORDER
    assert high[0] == HIGHEST_ORDER + ORDER_STEP
    assert high[-1] == HIGHEST_OF_ALL
    # Steps of a twentieth of a turn support ten periods per turn.
    coarse = np.arange(-10, 11) * (2 * np.pi / 20)
    assert high_orders(coarse).size == 0
    assert supported_orders(coarse)[-1] == 10.0


def test_origins() -> None:
    tolerance = order_tolerance(5.0)
    assert tolerance == pytest.approx(0.126, abs=1e-3)
    assert "once per joint turn" in str(origin_of(1.0, None, tolerance))
    assert "once per motor turn" in str(origin_of(99.97, 100.0, tolerance))
    assert "twice per motor turn" in str(origin_of(-2 * -50.1, 50.0, tolerance))
    assert origin_of(81.0, 100.0, tolerance) is None
    assert origin_of(64.3, None, tolerance) is None
    # Poses over a quarter turn leave an order uncertain by 0.3.
    short = order_tolerance(1.7)
    assert short == pytest.approx(0.37, abs=0.01)
    assert "a typical gear of ratio 100" in str(origin_of(200.33, None, short))
    assert origin_of(200.33, None, tolerance) is None
    assert origin_of(200.5, None, 2.0) is None
