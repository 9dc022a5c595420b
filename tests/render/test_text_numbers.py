"""Printed digits follow the uncertainty; names in few words, coefficients of uncertain masses in one sentence."""

from __future__ import annotations

import io
import math
from collections.abc import Callable
from functools import partial
from typing import Any

import pytest

import robacc
from robacc.modelling.robot_file import find_arm, read_robot
from robacc.render.text import (
    decimals,
    draw,
    effect_label,
    fixed,
    grouped,
    measured,
    odds,
    p_value,
    three_digits,
)
from robacc.simulation.simulate import Plan, simulate


@pytest.mark.parametrize(
    ("value", "lower", "upper", "expected"),
    [
        (0.7172, 0.650, 0.801, 3),  # half width 0.0755: two digits of it are thousandths
        (0.7172, 0.60, 0.85, 2),  # 0.125 -> 0.13
        (100.0, 90.01, 109.93, 0),  # 9.96 rounds to 10, whose second digit is the unit
        (1234.0, 900.0, 1500.0, 0),
        (0.01234, None, None, 4),  # three digits of the value
        (12.34, None, None, 1),
        (0.0, None, None, 3),
        (0.5, 0.5, 0.5, 3),
        (1e-20, None, None, 9),
    ],
)
def test_decimals(value: float, lower: float | None, upper: float | None, expected: int) -> None:
    assert decimals(value, lower, upper) == expected


@pytest.mark.parametrize(
    ("form", "values", "texts"),
    [
        (three_digits, (0.0, 1e-25, 1e-5, 0.00123), ("0", "0", "1.00e-05", "0.00123")),
        (three_digits, (1.2345, 123.4, 98765.4, 1e7), ("1.23", "123", "98765", "1.00e+07")),
        (partial(fixed, places=3), (-0.0004, -0.0006), ("0.000", "-0.001")),
        (partial(fixed, places=2), (None, math.nan), ("–", "–")),
        (p_value, (None, 1e-9, 0.0321, 1.0), ("–", "p < 1e-6", "p = 0.032", "p = 1")),
        # Odds are those of the alternative.
        (odds, (0.0, math.log(5), -math.log(20), 800.0), ("1 to 1", "1 to 5", "20 to 1", "1 to 1.01e+304")),
        # Names with a common beginning stand together.
        (
            grouped,
            (["tool_frame.a.roll", "tool_frame.a.yaw", "joint_offset.j1"], ["alone"], ["a", "b"]),
            ("tool_frame.a (roll, yaw), joint_offset.j1", "alone", "a, b"),
        ),
    ],
)
def test_a_value_as_text(form: Callable[[Any], str], values: tuple[Any, ...], texts: tuple[str, ...]) -> None:
    assert tuple(map(form, values)) == texts


@pytest.mark.parametrize(
    ("value", "error", "shown"),
    [
        (2.1, 2.7e-6, ("2.1000000", "2.7e-06")),
        (0.40034312, 4.04e-6, ("0.4003431", "4.0e-06")),
        (-5.16489e-7, 3.7e-6, ("-5e-07", "3.7e-06")),
        (-4e-8, 3.7e-6, ("0", "3.7e-06")),
        (9.6e-8, 3.7e-6, ("1e-07", "3.7e-06")),
        (8.7361e-7, 3.01e-9, ("8.736e-07", "3.0e-09")),
        (-0.00015784, 3.3e-6, ("-0.0001578", "3.3e-06")),
        (-0.0003778, 0.000996, ("-0.0004", "0.0010")),  # 9.96 rounds to 10
        (-0.00001, 0.0123, ("0.000", "0.012")),
        (5678.0, 123.0, ("5680", "120")),
        (0.0, 1e-5, ("0", "1.0e-05")),
        (1.5, 1e-18, ("1.50000000000000", "1.0e-18")),
        (0.25, 0.0, ("0.25", "0")),
        (-0.0, 0.0, ("0", "0")),
    ],
)
def test_a_value_ends_where_its_standard_error_does(value: float, error: float, shown: tuple[str, str]) -> None:
    assert measured(value, error) == shown


@pytest.mark.parametrize("value", [3.7, 1.234567e-3, -2.2e-7, 9.87654e5, 6.1e9])
@pytest.mark.parametrize("error", [1.04e-10, 9.96e-8, 3.3e-5, 0.0707, 25.0])
def test_rounding_a_value_costs_less_than_a_twentieth_of_its_error(value: float, error: float) -> None:
    """Half a unit of the second digit of an error that begins with 1 is 0.05 of it."""
    shown, its_error = measured(value, error)
    assert abs(float(shown) - value) <= max(0.051 * error, 1e-14 * abs(value))
    assert float(its_error) == pytest.approx(error, rel=0.051)


def test_the_label_of_an_effect_tells_its_forms_apart() -> None:
    assert effect_label("joint_compliance", ["j2"], {}) == "joint_compliance[j2]"
    assert effect_label("joint_compliance", ["j2"], {"masses": "uncertain"}) == (
        "joint_compliance[j2] with uncertain masses"
    )
    assert effect_label("step", [], {"part": "base"}) == "step[base]"


def test_a_calibration_without_orientations_and_masses_stays_short() -> None:
    entry = find_arm("irb120_3_58")
    assert entry is not None
    robot = read_robot(entry["path"])
    data = simulate(robot, Plan(50, seed=2, noise_position=5e-5, orientation=False)).data
    fit = ("base_frame", "tool_frame", "joint_offset", "link_geometry", "joint_compliance[j2]")
    result = robacc.calibrate(data, robot=robot, fit=fit)
    stream = io.StringIO()
    draw(result.view(full=True), stream)
    lines = stream.getvalue().splitlines()
    assert sum("not identifiable" in line for line in lines) == 2
    assert not any(".hx2" in line for line in lines)
    assert sum(line.startswith("joint_compliance.j2: ") for line in lines) == 1
    # The JSON result keeps each of them.
    text = result.to_json()
    assert text.count('"joint_compliance.j2.h') > 10
    assert all(dropped.name in text for dropped in result.identifiability.dropped)
