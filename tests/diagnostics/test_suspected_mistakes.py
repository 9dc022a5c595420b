"""Corrections that no arm needs are suspected mistakes; usual ones are not."""

from __future__ import annotations

import dataclasses

import independent_arm as arm
import numpy as np
import pytest
from test_mistake_sets import made

from robacc.calibration import calibrate
from robacc.diagnostics.suspected_mistakes import reach
from robacc.effects.request import parse_requests
from robacc.measurements import Measurements

N = 30


def warnings(length: float) -> list[str]:
    """Warnings of a calibration with a nominal forearm that is wrong by ``length``."""
    q, position, _ = made(N, 5)
    robot = arm.robot()
    joints = list(robot.joints)
    joints[3] = dataclasses.replace(joints[3], parameters={**joints[3].parameters, "d": arm.DH[3][1] + length})
    robot = dataclasses.replace(robot, joints=tuple(joints))
    requests = parse_requests("base_frame,tool_frame,link_geometry[j4]")
    result = calibrate(robot, Measurements(position=position, q=q), requests, n_folds=2)
    return [text for text in result.warnings if text.startswith("suspected data mistake")]


def test_reach_is_the_sum_of_the_lengths() -> None:
    assert reach(arm.robot()) == pytest.approx(sum(np.hypot(d, a) for _, d, a, *_ in arm.DH))


def test_a_length_that_is_far_off_is_suspected() -> None:
    (text,) = warnings(0.2)
    assert "link_geometry.j4.d is corrected by -19" in text


def test_a_usual_correction_is_not() -> None:
    assert warnings(2e-3) == []
