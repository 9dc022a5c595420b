"""An error of the position that depends smoothly on the pose and has no cause in the catalogue, on paths and apart."""

from __future__ import annotations

import dataclasses
from functools import cache

import independent_arm as arm
import numpy as np
import pytest
from slow_parameters import some_fast

from robacc.effects.base import effect_class
from robacc.effects.specification import build, parse_requests
from robacc.measurements import Measurements
from robacc.modelling.model import Known, Model
from robacc.robots.arm import Arm
from robacc.tracing.trace import Trace, trace

NOISE, SIZE, LENGTH = 8e-6, 3e-5, 0.5
"""m, m, rad: along each axis."""


def poses(paths: int, points: int, rng: np.random.Generator) -> np.ndarray:
    """Return joints ``(6, N)`` on straight lines in joint space, about 0.35 rad long for each joint."""
    start = rng.uniform(-0.6, 0.6, (paths, 1, 6))
    along = np.linspace(0.0, 1.0, points)[None, :, None] * rng.normal(scale=0.35, size=(paths, 1, 6))
    return (start + along).reshape(-1, 6).T


@cache
def traced(paths: int, points: int, size: float, seed: int) -> Trace:
    """Return the trace of a campaign whose arm has a process of the stated size, by cosines of random directions."""
    rng = np.random.default_rng(seed)
    q = poses(paths, points, rng)
    angle = rng.normal(scale=1.0 / LENGTH, size=(300, 6)) @ q + rng.uniform(0.0, 2.0 * np.pi, (300, 1))
    process = size * np.sqrt(2.0 / 300) * rng.normal(size=(3, 300)) @ np.cos(angle)
    offsets = rng.normal(scale=4e-4, size=(6, 1))
    position = np.array([arm.target(pose) for pose in (q + offsets).T]).T + process
    data = Measurements(position=position + NOISE * rng.standard_normal(position.shape), q=q)
    robot = arm.robot()
    return trace(Model.of(robot, build(parse_requests(arm.DECLARED), Arm.of(robot), data)), data)


@pytest.mark.parametrize(
    ("paths", "points", "most"), [(10, 20, 2.2e-5), pytest.param(200, 1, 3e-5, marks=pytest.mark.slow)]
)
def test_an_error_without_a_cause_is_corrected_between_the_poses(paths: int, points: int, most: float) -> None:
    result = traced(paths, points, SIZE, 1)
    assert [finding.effect for finding in result.findings] == ["joint_correction"]
    before, after = (stage.held_out.position.rms for stage in (result.before, result.after))
    assert NOISE * np.sqrt(3.0) < after < most < 0.75 * before
    assert result.verdict == "partly_explained"
    assert any("no cause is named" in hint for hint in result.unexplained.hints)


@pytest.mark.parametrize("seed", some_fast(range(3), 3))
def test_white_noise_on_paths_is_no_process(seed: int) -> None:
    result = traced(10, 20, 0.0, seed)
    assert result.findings == ()
    assert result.verdict == "clean"


def test_the_correction_moves_the_position_along_measuring_axes_and_fades() -> None:
    robot = arm.robot()
    turned = dataclasses.replace(robot, base=dataclasses.replace(robot.base, rpy=(0.3, -0.2, 1.0)))
    joints = [f"j{i}" for i in range(1, 7)]
    centre = [0.1, 0.2, -0.3, 0.4, 0.5, 0.0]
    effect = effect_class("joint_correction").from_settings(
        tuple(joints), {"lengths": [0.5] * 6, "centres": [centre], "moves": "position"}
    )
    q = np.array([centre, np.add(centre, [0.5, 0, 0, 0, 0, 0]), np.add(centre, 2.0)]).T
    data = Measurements(position=np.zeros((3, 3)), q=q)
    values = {"joint_correction.x.c1": 1e-3, "joint_correction.y.c1": 0.0, "joint_correction.z.c1": -2e-3}
    nominal = Model(Arm.of(turned)).bind(data).poses(np.zeros(0)).translation
    moved = Model(Arm.of(turned), known=(Known(effect, values),)).bind(data).poses(np.zeros(0)).translation
    share = np.exp(-0.5 * np.square([0.0, 2.0 * np.sin(0.25) / 0.5]))
    np.testing.assert_allclose((moved - nominal)[:, :2], np.outer([1e-3, 0.0, -2e-3], share), atol=1e-9)
    assert np.abs(moved - nominal)[:, 2].max() < 1e-9
