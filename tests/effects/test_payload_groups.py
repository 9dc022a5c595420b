"""Loads of unknown mass that a column names, on an arm with torques of its own."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from independent_arm import measured_with_loads, robot
from searched import ARM, error_at, fitted, found, values_of

from robacc.api.inputs import read_poses, write_poses
from robacc.effects.elastic import PayloadCompliance
from robacc.errors import UsageError
from robacc.measurements import Measurements

NOISE = 1e-5
COMPLIANCE = 6e-7
LOADS = {"none": 0.0, "gripper": 20.0, "part": 60.0}
"""Masses at the tool, kg."""


def loaded(n: int, seed: int, noise: float) -> Measurements:
    """Poses of an arm whose joint 2 gives way to loads that only have names."""
    names = np.random.default_rng(seed).choice(list(LOADS), n)
    mass = np.array([LOADS[name] for name in names])
    return dataclasses.replace(measured_with_loads(n, seed, noise, COMPLIANCE, mass), payload_group=names)


def test_named_loads_are_found_with_their_ratios_and_predict_other_poses(tmp_path: Path) -> None:
    write_poses(tmp_path / "poses.csv", loaded(80, 61, NOISE))
    data = read_poses(tmp_path / "poses.csv", robot=robot())
    (effect,) = found(data)
    assert effect == PayloadCompliance(("j2",), groups=("gripper", "part"))
    result = fitted(data, (effect,))
    values = values_of(result)
    # 80 poses of 10 um show a product of 6e-7 rad/(N m) and 60 kg to about 1 %.
    assert values["payload_compliance.j2.part"] == pytest.approx(60 * COMPLIANCE, rel=0.05)
    assert values["payload_compliance.j2.gripper"] == pytest.approx(20 * COMPLIANCE, rel=0.15)
    assert "part 1.00" in effect.statement(ARM, values)
    # Some thirty coefficients of 240 coordinates leave 0.6 of the noise of three coordinates.
    assert error_at(result, loaded(60, 62, 0.0)) < 1.2e-5


def test_a_load_of_another_name_and_a_single_name_are_refused() -> None:
    data = loaded(40, 63, NOISE)
    effect = PayloadCompliance(("j2",), groups=("gripper",))
    with pytest.raises(UsageError, match="a row carries 'part'"):
        effect.terms(ARM, data)
    alone = dataclasses.replace(data, payload_group=np.full(data.n, "part"))
    assert PayloadCompliance.missing(ARM, alone) == PayloadCompliance.traits.needs[2].reason
    again = PayloadCompliance.from_settings(("j2",), {"com": "uncertain", "groups": ["gripper"]})
    assert again == PayloadCompliance(("j2",), "uncertain", ("gripper",))
