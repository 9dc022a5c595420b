"""Effects of a baseline that nobody declared: those of every arm that the poses support."""

from __future__ import annotations

import numpy as np
import pytest
from arms import arm

from robacc.effects import effect_class
from robacc.effects.baseline import CONSTANTS, FRAMES, default_baseline
from robacc.effects.request import build, parse_requests
from robacc.fitting.fit_result import Options
from robacc.fitting.solver import fit
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.simulation.simulate import Plan, simulate

ALL = (*FRAMES, *CONSTANTS)


def poses(name: str, n: int, *, orientation: bool, visits: int = 1) -> Measurements:
    joints = arm(name)
    q = np.random.default_rng(1).uniform(-1.0, 1.0, (len(joints.names), n)).repeat(visits, axis=1)
    rotation = np.tile(np.eye(3)[..., None], n * visits) if orientation else None
    return Measurements(np.zeros((3, n * visits)), rotation, q=q)


@pytest.mark.parametrize(
    ("name", "n", "orientation", "expected"),
    [
        # Three coordinates for each coefficient: 6 axes have 24 constants and a target of 3 or 6.
        ("puma560", 27, False, ALL),
        ("puma560", 26, False, ALL[:3]),
        ("puma560", 15, True, ALL),
        ("puma560", 14, True, ALL[:3]),
        # 6 of the base, 3 of the target, 6 offsets.
        ("puma560", 15, False, ALL[:3]),
        ("puma560", 14, False, FRAMES),
        ("puma560", 4, True, FRAMES),
        # A prismatic joint has 2 constants, so a SCARA needs fewer poses than an arm of four turning joints.
        ("scara", 17, False, ALL),
    ],
)
def test_the_default_is_as_much_as_the_poses_support(
    name: str, n: int, orientation: bool, expected: tuple[str, ...]
) -> None:
    baseline = default_baseline(arm(name), poses(name, n, orientation=orientation))
    assert baseline.names == expected
    assert baseline.by_default
    assert [effect for effect, _ in baseline.left_out] == [effect for effect in ALL if effect not in expected]
    assert all(f"{n} commanded poses give" in why for _, why in baseline.left_out)


def test_repetitions_support_no_more_coefficients() -> None:
    few = default_baseline(arm("puma560"), poses("puma560", 10, orientation=False, visits=5))
    assert few.names == FRAMES


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
