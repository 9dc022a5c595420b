"""A model fitted on a part of a real arm's poses is never worse elsewhere than its geometry alone; slow.

``python tests/tracing/test_subsets_slow.py 0 200`` prints the ratio of 200 parts.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

import robacc
from robacc.measurements import Measurements
from robacc.modelling.model import predict
from robacc.modelling.validity import standing_campaign
from robacc.robots.description import Robot

DATA = Path(__file__).resolve().parents[2].parent / "shared" / "data" / "ipa_ur10"
GEOMETRY = "base_frame,tool_frame,joint_offset,link_geometry"
PARTS = 10
WORST = 1.05


def part(data: Measurements, seed: int) -> np.ndarray:
    """Return the poses with one joint, drawn at random, in a range that holds 30 to 70 % of them."""
    rng = np.random.default_rng(seed)
    values = data.q[rng.integers(data.q.shape[0])]
    share = rng.uniform(0.3, 0.7)
    first = rng.uniform(0.0, 1.0 - share)
    low, high = np.quantile(values, (first, first + share))
    return np.asarray((values >= low) & (values <= high))


def rms(robot: Robot, data: Measurements) -> float:
    """Return the root mean square position error of a model as the arm stands after its campaign, m."""
    errors = data.position - predict(standing_campaign(robot, "auto")[0], data).translation
    return float(np.sqrt(np.mean(np.sum(np.square(errors), axis=0))))


def ratio(seed: int) -> tuple[float, str]:
    """Return the error elsewhere over that with geometry alone, and the findings as text."""
    robot = robacc.read_robot(DATA / "robot.yaml")
    data = robacc.read_poses(DATA / "series_B.csv", robot=robot)
    inside = part(data, seed)
    fitted, elsewhere = data.subset(np.flatnonzero(inside)), data.subset(np.flatnonzero(~inside))
    geometry = robacc.calibrate(fitted, robot=robot, fit=GEOMETRY, folds=2).robot
    traced = robacc.trace(fitted, robot=robot, declared=GEOMETRY)
    return rms(traced.robot, elsewhere) / rms(geometry, elsewhere), ", ".join(
        f["effect"] for f in traced.document()["findings"]
    )


@pytest.mark.slow
@pytest.mark.skipif(not DATA.is_dir(), reason="the shared data are not beside this checkout")
@pytest.mark.parametrize("seed", range(PARTS))
def test_a_model_of_a_part_is_no_worse_elsewhere_than_geometry(seed: int) -> None:
    worse, findings = ratio(seed)
    assert worse <= WORST, findings


if __name__ == "__main__":
    for number in range(*map(int, sys.argv[1:3])):
        print(number, *ratio(number), flush=True)
