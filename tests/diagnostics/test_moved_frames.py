"""Validation poses measured after the instrument, the base or the target was moved."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from arms import arm

import robacc
from robacc.effects.specification import build, parse_requests
from robacc.fitting.fit_result import Fit, Options
from robacc.fitting.solver import fit
from robacc.fitting.warnings import fit_warnings, lack_of_fit, moved_frames
from robacc.geometry import rotate, rotation_about
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.robots.description import Robot
from robacc.simulation.simulate import Plan, simulate

NOISE = 2e-5
ENTRY = {"effect": "gear_ratio", "joints": ["j2"], "values": {"j2": 4e-4}}
DECLARED = "base_frame,tool_frame,joint_offset,link_geometry"


@cache
def campaigns() -> tuple[Robot, Measurements, Measurements]:
    """Nominal robot, calibration poses and validation poses of an arm whose second joint has another gear ratio."""
    robot = replace(arm("irb1600").robot, effects=())
    true = replace(robot, effects=(ENTRY,))
    plans = (Plan(n, seed=3 + n, noise_position=NOISE, orientation=False) for n in (70, 40))
    return robot, *(simulate(true, plan).data for plan in plans)


@cache
def calibrated() -> Fit:
    robot, data, _ = campaigns()
    start = Model.of(robot)
    return fit(Model(start.arm, start.known, build(parse_requests(DECLARED), start.arm, data)), data, Options())


def moved(data: Measurements, angle: float, shift: tuple[float, float, float]) -> Measurements:
    return replace(data, position=rotate(rotation_about(2, angle), data.position) + np.array(shift)[:, None])


def figures(text: str | None) -> tuple[float, ...]:
    """Return displacement (mm), angle (degrees), error with the frames registered (mm), and error as measured."""
    pattern = r"poses lie (\S+) mm and (\S+)° .* their error is (\S+) mm rms in place of (\S+) mm"
    return tuple(float(number) for number in re.search(pattern, str(text)).groups())


@pytest.mark.parametrize(
    ("angle", "shift"), [(0.02, (0.05, -0.03, 0.0)), (1.9, (3.0, -2.0, 0.4)), (0.0, (0.0, 0.02, 0.0))]
)
def test_a_moved_base_is_found(angle: float, shift: tuple[float, float, float]) -> None:
    fitted, second = calibrated(), moved(campaigns()[2], angle, shift)
    found = moved_frames(fitted, second)
    shifted, turned, registered, before = figures(found)
    assert np.radians(turned) == pytest.approx(angle, abs=2e-3)
    centre = moved(replace(second, position=fitted.predict(second).translation), angle, shift).position.mean(axis=1)
    expected = np.linalg.norm(centre - fitted.predict(second).translation.mean(axis=1))
    assert shifted == pytest.approx(1e3 * float(expected), rel=0.05)
    assert registered < 1.0 < 10 * registered < before
    assert "the instrument or the robot base moved between the files; with base registered on them" in found


def test_a_target_mounted_again_is_found() -> None:
    fitted, second = calibrated(), campaigns()[2]
    mount = np.einsum("ijn,j->in", fitted.predict(second).rotation, np.array([0.02, -0.01, 0.03]))
    found = moved_frames(fitted, moved(replace(second, position=second.position + mount), 0.3, (0.1, 0.2, 0.3)))
    assert figures(found)[2] < 1.0
    assert "or the target was mounted again; with base and target registered" in found


def test_the_same_setup_has_not_moved() -> None:
    fitted, second = calibrated(), campaigns()[2]
    assert moved_frames(fitted, second) is None
    # Errors that no motion of a frame explains, of the same size as a moved base's.
    rng = np.random.default_rng(5)
    assert moved_frames(fitted, replace(second, position=second.position + rng.normal(0, 0.02, (3, second.n)))) is None
    # Too few poses to say.
    assert moved_frames(fitted, moved(second, 0.02, (0.05, 0, 0)).subset(np.arange(8))) is None


def test_findings_are_judged_with_the_frames_registered() -> None:
    """A gear ratio went, as the error of the validation poses, 60 mm, was not lower with it than without."""
    robot, first, second = campaigns()
    same = robacc.trace(first, robot=robot, declared=DECLARED, holdout=second)
    other = robacc.trace(first, robot=robot, declared=DECLARED, holdout=moved(second, 0.02, (0.05, -0.03, 0.0)))
    for result in (same, other):
        assert [(finding.effect, finding.joints) for finding in result.findings] == [("gear_ratio", ("j2",))]
    assert not any("validation poses lie" in text for text in same.warnings)
    assert any("validation poses lie" in text for text in other.warnings)
    # The figures stay those of the poses as measured.
    assert other.after.held_out.position.rms > 0.04


def test_calibrate_says_that_the_setup_moved() -> None:
    robot, first, second = campaigns()
    fit_names = ("base_frame", "tool_frame", "joint_offset", "gear_ratio[j2]")
    result = robacc.calibrate(first, robot=robot, fit=fit_names, holdout=moved(second, 0.02, (0.05, -0.03, 0.0)))
    assert sum("the instrument or the robot base moved" in text for text in result.warnings) == 1
    assert not any("fit fewer effects" in text for text in result.warnings)


def test_a_larger_error_of_validation_poses_gives_a_warning() -> None:
    fitted, (_, data, second) = calibrated(), campaigns()
    texts = [
        " ".join(fit_warnings(fitted, data, lack_of_fit(fitted, data), fitted, (1e-4, error), second))
        for error in (1.9e-4, 7.5e-4)
    ]
    assert "that of the calibration poses" not in texts[0]
    assert "7.5 times that of the calibration poses" in texts[1]
