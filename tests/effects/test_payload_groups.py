"""Loads of unknown mass that a column names, on an arm with torques of its own."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from independent_arm import DECLARED, GRAVITY, Matrix, measured, robot, run, target, torques

from robacc.api.inputs import read_poses, write_poses
from robacc.effects.elastic import PayloadCompliance
from robacc.effects.request import build, parse_requests
from robacc.errors import UsageError
from robacc.fitting.fit_result import Options
from robacc.fitting.solver import fit
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.robots.arm import Arm
from robacc.tracing.search import search

ARM = Arm.of(robot())
NOISE = 1e-5
COMPLIANCE = 6e-7
LOADS = {"none": (0.0, (0.0, 0.0, 0.0)), "gripper": (20.0, (0.05, -0.03, 0.12)), "part": (60.0, (0.05, -0.03, 0.12))}


def loaded(n: int, seed: int, noise: float) -> Measurements:
    """Poses of an arm whose joint 2 gives way to loads that only have names."""
    poses = run(n, seed)
    names = np.random.default_rng(seed).choice(list(LOADS), n)

    def extra(name: str) -> float:
        mass, com = LOADS[name]
        return lambda frames: mass * GRAVITY * float((frames[-1] @ np.append(com, 1.0))[2])

    moved: Matrix = poses.q.copy()
    pairs = zip(poses.q.T, names, strict=True)
    moved[1] += [COMPLIANCE * (torques(q, extra(name)) - torques(q))[1] for q, name in pairs]
    position = np.array([target(q) for q in moved.T]).T
    return dataclasses.replace(measured(poses, position, noise, seed), payload_group=names)


def test_named_loads_are_found_with_their_ratios_and_predict_other_poses(tmp_path: Path) -> None:
    write_poses(tmp_path / "poses.csv", loaded(80, 61, NOISE))
    data, fresh = read_poses(tmp_path / "poses.csv", robot=robot()), loaded(60, 62, 0.0)
    declared = build(parse_requests(DECLARED), ARM, data)
    (effect,) = search(Model(ARM, free=declared), data).effects
    assert effect == PayloadCompliance(("j2",), groups=("gripper", "part"))
    result = fit(Model(ARM, free=(*declared, effect)), data, Options())
    values = dict(
        zip([term.name for item in result.model.free for term in item.terms(ARM, data)], result.theta, strict=True)
    )
    # 80 poses of 10 um show a product of 6e-7 rad/(N m) and 60 kg to about 1 %.
    assert values["payload_compliance.j2.part"] == pytest.approx(60 * COMPLIANCE, rel=0.05)
    assert values["payload_compliance.j2.gripper"] == pytest.approx(20 * COMPLIANCE, rel=0.15)
    assert "part 1.00" in str(effect.statement(ARM, values))
    predicted = result.model.bind(fresh).poses(result.theta).translation
    # Some thirty coefficients of 240 coordinates leave 0.6 of the noise of three coordinates.
    assert np.sqrt(np.mean(np.sum(np.square(fresh.position - predicted), axis=0))) < 1.2e-5


def test_a_load_of_another_name_and_a_single_name_are_refused() -> None:
    data = loaded(40, 63, NOISE)
    effect = PayloadCompliance(("j2",), groups=("gripper",))
    with pytest.raises(UsageError, match="a row carries 'part'"):
        effect.terms(ARM, data)
    alone = dataclasses.replace(data, payload_group=np.full(data.n, "part"))
    assert PayloadCompliance.missing(ARM, alone) == PayloadCompliance.traits.needs[2].reason
    again = PayloadCompliance.from_settings(("j2",), {"com": "uncertain", "groups": ["gripper"]})
    assert again == PayloadCompliance(("j2",), "uncertain", ("gripper",))
