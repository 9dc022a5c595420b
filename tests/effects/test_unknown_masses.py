"""A pedestal that tilts, on an arm whose masses nobody knows: torques are those of independent matrices."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from independent_arm import DECLARED, DH, measured, on_a_pedestal, robot, run, target
from searched import error_at, fitted, found

from robacc.effects.elastic import BaseCompliance, LateralCompliance
from robacc.measurements import Measurements
from robacc.modelling.model import predict
from robacc.robots.arm import Arm

NOISE = 1e-5
COMPLIANCE = 6e-7


def arm_without_masses() -> Arm:
    described = robot()
    joints = tuple(dataclasses.replace(joint, mass=None, com=None) for joint in described.joints)
    return Arm.of(dataclasses.replace(described, joints=joints))


def poses(n: int, seed: int, noise: float) -> Measurements:
    joints = run(n, seed)
    position = np.array([on_a_pedestal(q, COMPLIANCE) for q in joints.q.T]).T
    return measured(joints, position, noise, seed)


def error_at_other_poses(effects: str) -> float:
    """RMS error (m) of a fit at poses that it has not seen and that have no noise."""
    return error_at(fitted(poses(100, 41, NOISE), (), arm_without_masses(), DECLARED + effects), poses(60, 42, 0.0))


def test_a_pedestals_tilt_is_fitted_without_masses() -> None:
    assert error_at_other_poses("") > 8e-5
    assert error_at_other_poses(",base_compliance") < 2.5e-5


@pytest.mark.slow
def test_a_pedestal_is_found_without_masses() -> None:
    (effect,) = found(poses(100, 41, NOISE), arm_without_masses())
    assert (str(effect), effect.settings()) == ("base_compliance", {"masses": "unknown"})


def test_unknown_masses_reproduce_known_ones() -> None:
    """The regressors times the masses are the moments of the known weight: both forms predict the same poses."""
    arm, data = Arm.of(robot()), poses(20, 43, 0.0)
    for cls, joints in ((BaseCompliance, ()), (LateralCompliance, ("j2",))):
        prefix = ".".join((cls.name, *joints))
        values = {}
        for i, (*_, mass, com) in enumerate(DH, 1):
            weights = {f"m{i}": mass, **{f"h{axis}{i}": mass * com[k] for k, axis in enumerate("xyz")}}
            values |= {label: COMPLIANCE * weight for label, weight in weights.items()}
        unknown = cls(joints=joints, masses="unknown")
        names = {term.name.removeprefix(f"{prefix}.") for term in unknown.terms(arm, data)}
        short = f"{joints[0]}." if joints else ""
        entries = (
            {"effect": cls.name, "joints": list(joints), "values": {joints[0] if joints else "value": COMPLIANCE}},
            {
                "effect": cls.name,
                "joints": list(joints),
                "masses": "unknown",
                "values": {f"{short}{label}": value for label, value in values.items() if label in names},
            },
        )
        first, second = (predict(dataclasses.replace(robot(), effects=(entry,)), data).translation for entry in entries)
        assert np.abs(first - target(data.q[:, 0])[:, None]).max() > 1e-5
        np.testing.assert_allclose(first, second, rtol=0, atol=1e-10)
