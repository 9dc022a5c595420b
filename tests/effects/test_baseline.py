"""Effects of a baseline that nobody declared: those of every arm that the poses support."""

from __future__ import annotations

import numpy as np
import pytest
from arms import arm

from robacc.effects import effect_class
from robacc.effects.request import CONSTANTS, FRAMES, build, default_baseline, parse_requests
from robacc.fitting.fit_result import Options
from robacc.fitting.solver import fit
from robacc.fitting.visits import places
from robacc.geometry import rms_length
from robacc.measurements import Measurements
from robacc.modelling.model import Model, predict
from robacc.simulation.simulate import Plan, simulate
from robacc.tracing.trace import trace

ALL = (*FRAMES, *CONSTANTS)


def poses(name: str, n: int, *, orientation: bool, visits: int = 1) -> Measurements:
    joints = arm(name)
    q = np.random.default_rng(1).uniform(-1.0, 1.0, (len(joints.names), n)).repeat(visits, axis=1)
    rotation = np.tile(np.eye(3)[..., None], n * visits) if orientation else None
    return Measurements(np.zeros((3, n * visits)), rotation, q=q)


@pytest.mark.parametrize(
    ("name", "n", "orientation", "expected"),
    [
        # One and a half coordinates for each coefficient: 6 axes have 24 constants and a target of 3 or 6.
        ("puma560", 14, False, ALL),
        ("puma560", 13, False, ALL[:3]),
        ("puma560", 8, True, ALL),
        ("puma560", 7, True, ALL[:3]),
        # 6 of the base, 3 of the target, 6 offsets.
        ("puma560", 8, False, ALL[:3]),
        ("puma560", 7, False, FRAMES),
        ("puma560", 4, True, FRAMES),
        # A prismatic joint has 2 constants, so a SCARA needs fewer poses than an arm of four turning joints.
        ("scara", 9, False, ALL),
    ],
)
def test_the_default_is_as_much_as_the_poses_support(
    name: str, n: int, orientation: bool, expected: tuple[str, ...]
) -> None:
    baseline = default_baseline(arm(name), poses(name, n, orientation=orientation), n)
    assert baseline.names == expected
    assert baseline.by_default
    assert [effect for effect, _ in baseline.left_out] == [effect for effect in ALL if effect not in expected]
    assert all(f"poses in {n} places give" in why for _, why in baseline.left_out)


def test_repetitions_support_no_more_coefficients() -> None:
    data = poses("puma560", 7, orientation=False, visits=5)
    assert default_baseline(arm("puma560"), data, np.unique(places(data)).size).names == FRAMES


@pytest.mark.parametrize("name", ["puma560", "scara", "stanford"])
@pytest.mark.parametrize("orientation", [True, False])
def test_the_count_of_coefficients_is_what_a_fit_identifies(name: str, orientation: bool) -> None:
    """The rule of Everett against the rank of the Jacobian: prismatic joints and a target without orientation."""
    joints = arm(name)
    data = simulate(joints.robot, Plan(60, seed=3, noise_position=1e-5, noise_orientation=1e-5)).data
    if not orientation:
        data = Measurements(data.position, q=data.q)
    effects = build(parse_requests(",".join(ALL)), joints, data)
    identified = int(fit(Model.of(joints.robot, effects), data, Options()).identifiability.columns.size)
    revolute = sum(joints.is_revolute(axis) for axis in joints.names)
    prismatic = len(joints.names) - revolute
    assert identified <= 4 * revolute + 2 * prismatic + (6 if orientation else 3)
    assert all(effect_class(effect).missing(joints, data) is None for effect in ALL)


@pytest.mark.parametrize(("name", "n"), [("puma560", 18), ("stanford", 20)])
def test_few_poses_of_an_arm_with_errors_of_geometry_are_clean(name: str, n: int) -> None:
    """Without geometry in the baseline its errors would be findings or noise, and other poses would miss them."""
    rng, noise = np.random.default_rng(5), 2e-5
    joints = arm(name)
    data, other = (simulate(joints.robot, Plan(count, seed=seed)).data for count, seed in ((n, 4), (200, 5)))
    effects = build(parse_requests(",".join(ALL)), joints, data)
    model = Model.of(joints.robot, effects)
    real = 3e-4 * rng.normal(size=len(model.bind(data).terms))
    position = model.bind(data).poses(real).translation + noise * rng.normal(size=(3, n))
    measured = Measurements(position, q=data.q)
    baseline = default_baseline(joints, measured, n)
    found = trace(Model.of(joints.robot, build(parse_requests(",".join(baseline.names)), joints, measured)), measured)
    error = predict(found.robot, other).translation - model.bind(other).poses(real).translation
    assert found.verdict == "clean"
    assert rms_length(error) < 5.0 * noise
