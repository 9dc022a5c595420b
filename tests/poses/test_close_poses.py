"""Repetitions whose joints were logged as read, in files without a pose column."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from robacc.poses.csv_file import read_poses
from robacc.poses.reading import KnownRobot

JOINTS = [f"q{i + 1}" for i in range(6)]


def written(path: Path, q: np.ndarray, more: dict[str, list[str]] | None = None) -> Path:
    xyz = np.random.default_rng(5).uniform(0.2, 0.9, (len(q), 3))
    columns = more or {}
    lines = [",".join([*JOINTS, "x", "y", "z", *columns])]
    for i, row in enumerate(np.hstack((q, xyz))):
        lines.append(",".join([*(f"{value:.9f}" for value in row), *(values[i] for values in columns.values())]))
    path.write_text("\n".join(lines) + "\n")
    return path


def repeated(jitter: float, count: int = 12, cycles: int = 5) -> np.ndarray:
    rng = np.random.default_rng(1)
    q = np.tile(rng.uniform(-2.0, 2.0, (count, 6)), (cycles, 1))
    return q + rng.uniform(-jitter, jitter, q.shape)


def test_joints_as_read_give_the_repetitions(tmp_path: Path) -> None:
    data = read_poses(written(tmp_path / "poses.csv", repeated(1e-4)), robot=KnownRobot(joint_names=JOINTS))
    assert np.array_equal(data.groups(), np.tile(data.groups()[:12], 5))
    assert np.unique(data.groups()).size == 12
    (warning,) = data.warnings
    assert "60 rows are read as 12 commanded poses" in warning
    assert data.contradicted_ids() == ()


@pytest.mark.parametrize("jitter", [0.0, 5e-3])
def test_equal_joints_and_distant_poses_stay_as_they_are(tmp_path: Path, jitter: float) -> None:
    data = read_poses(written(tmp_path / "poses.csv", repeated(jitter)), robot=KnownRobot(joint_names=JOINTS))
    assert data.pose is None
    assert np.unique(data.groups()).size == (60 if jitter else 12)


def test_a_slow_sweep_has_no_repetitions(tmp_path: Path) -> None:
    q = np.zeros((100, 6)) + 0.3
    q[:, 1] = np.linspace(0.0, 0.04, 100)
    assert read_poses(written(tmp_path / "poses.csv", q), robot=KnownRobot(joint_names=JOINTS)).pose is None


def test_a_pose_column_decides(tmp_path: Path) -> None:
    ids = {"pose": [f"N{i}" for i in range(60)]}
    data = read_poses(written(tmp_path / "poses.csv", repeated(1e-4), ids), robot=KnownRobot(joint_names=JOINTS))
    assert np.unique(data.groups()).size == 60
