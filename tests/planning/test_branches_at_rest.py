"""A plan for a torso: the other arm stands still, the planned rows state where; candidates that move it are refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import robacc
from robacc.api.expected import Planned
from robacc.diagnostics.robot_poses import read_robot_poses
from robacc.errors import InputError

ROBOT = """robacc: 1
convention: urdf
units: {length: m, angle: deg}
joints:
  - {name: waist, type: revolute, origin: {xyz: [0, 0, 0.6], rpy: [0, 0, 0]}, axis: [0, 1, 0], limits: [-40, 40],
     mass: 14, com: [0.02, 0, 0.25]}
  - {name: pan, type: revolute, origin: {xyz: [0, -0.3, 0.5], rpy: [0, 0, 0]}, axis: [0, 0, 1], limits: [-80, 80],
     mass: 3, com: [0, -0.1, 0]}
  - {name: lift, type: revolute, origin: {xyz: [0, -0.1, 0], rpy: [0, 0, 0]}, axis: [0, 1, 0], limits: [-80, 80],
     mass: 3, com: [0.15, 0, 0.02]}
tool: {xyz: [0.5, 0, 0], rpy: [0, 0, 0]}
branches:
  - {name: other, parent: waist, type: revolute, origin: {xyz: [0, 0.3, 0.5], rpy: [0, 0, 0]}, axis: [0, 1, 0],
     mass: 5, com: [0.25, 0, 0.02], position: 30}
"""
CANDIDATES = "q1_deg,q2_deg,q3_deg,other_deg\n" + "".join(f"{i % 40},{2 * i % 70},{-i % 60},30\n" for i in range(60))


def planned(folder: Path, candidates: str | None = None) -> Planned:
    (folder / "torso.yaml").write_text(ROBOT)
    source: Path | int = 60
    if candidates is not None:
        source = folder / "candidates.csv"
        source.write_text(candidates)
    fit = "tool_frame,joint_compliance[waist]"
    return robacc.plan(folder / "torso.yaml", poses=8, fit=fit, candidates=source, repeats=0, check_every=0)


def test_planned_rows_state_where_the_joints_beside_the_chain_stand(tmp_path: Path) -> None:
    plan = planned(tmp_path)
    (warning,) = [text for text in plan.warnings if "outside the chain" in text]
    assert "other at 30°" in warning
    plan.write(tmp_path / "plan.csv")
    again = read_robot_poses(tmp_path / "plan.csv", robacc.read_robot(tmp_path / "torso.yaml"), attained=False)
    np.testing.assert_allclose(again.branches, np.radians(30.0), atol=1e-12)


def test_candidates_may_state_the_position_and_nothing_else(tmp_path: Path) -> None:
    assert planned(tmp_path, CANDIDATES).visits().n == 8
    moved = CANDIDATES.splitlines()
    moved[5] = moved[5].removesuffix("30") + "31"
    with pytest.raises(InputError, match=r"candidates.csv:6, other: found 31°, expected 30°") as caught:
        planned(tmp_path, "\n".join(moved) + "\n")
    assert "set the position of this joint" in str(caught.value)
