"""Results do not depend on the order of the rows, nor on the unit of the file."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from arms import arm

import robacc
from robacc.effects.elastic import JointCompliance
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
    assert second.after.held_out.position.rms == pytest.approx(first.after.held_out.position.rms, rel=1e-9)
    assert second.before.fitted.position.rms == pytest.approx(first.before.fitted.position.rms, rel=1e-9)


def test_the_unit_of_the_file_does_not_matter(tmp_path: Path) -> None:
    robot = dataclasses.replace(arm("puma560").robot, effects=())
    data = simulate(robot, Plan(40, seed=5, noise_position=2e-5, orientation=False)).data
    texts = {}
    for unit, factor in (("m", 1.0), ("mm", 1e3)):
        # 17 digits: the same numbers in either unit, to rounding.
        lines = [
            ",".join(f"{value:.17g}" for value in (*q, *(factor * position)))
            for q, position in zip(data.q.T, data.position.T, strict=True)
        ]
        suffix = "" if unit == "m" else "_mm"
        heading = ",".join((*(f"q{i}" for i in range(1, 7)), *(f"{axis}{suffix}" for axis in "xyz")))
        texts[unit] = tmp_path / f"{unit}.csv"
        texts[unit].write_text("\n".join([heading, *lines]) + "\n", encoding="utf-8")
    results = [robacc.calibrate(texts[unit], robot=robot, fit=("base_frame", "joint_offset")) for unit in ("m", "mm")]
    values = [np.array([p.value for p in result.parameters]) for result in results]
    np.testing.assert_allclose(values[1], values[0], rtol=1e-9, atol=1e-13)
