"""A trace does not depend on the order of the rows."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from arms import arm

import robacc
from robacc.effects.joint_compliance import JointCompliance
from robacc.modelling.model import Model
from robacc.simulation.simulate import Plan, simulate


def test_the_order_of_rows_does_not_matter() -> None:
    robot = dataclasses.replace(arm("puma560").robot, effects=())
    data = simulate(robot, Plan(60, seed=4, noise_position=2e-5, orientation=False)).data
    bound = Model.of(robot, [JointCompliance(("j2",))]).bind(data)
    theta = np.full(len(bound.terms), 5e-6)
    sag = bound.poses(theta).translation - bound.poses(0.0 * theta).translation
    # Ids keep each pose in its fold: without ids, the fold of a pose follows from its place.
    data = dataclasses.replace(data, position=data.position + sag, pose=np.arange(60).astype(str), rows=None)
    order = np.random.default_rng(1).permutation(60)
    first, second = (
        robacc.trace(rows, robot=robot, declared=("base_frame", "tool_frame", "joint_offset"))
        for rows in (data, data.subset(order))
    )
    assert [finding.effect for finding in first.findings] == ["joint_compliance"]
    values = [[p.value for finding in result.findings for p in finding.parameters] for result in (first, second)]
    assert values[1] == pytest.approx(values[0], rel=1e-9)
    assert first.after.held_out is not None
    assert second.after.held_out is not None
    assert second.after.held_out.position.rms == pytest.approx(first.after.held_out.position.rms, rel=1e-9)
    assert second.before.fitted.position.rms == pytest.approx(first.before.fitted.position.rms, rel=1e-9)
