"""Mutated exports: each is read to sound numbers or refused with a message, whatever was stated about it."""

from __future__ import annotations

import random
import sys
from pathlib import Path

import numpy as np
import pytest

from robacc.errors import RobaccError
from robacc.poses.csv_file import propose_columns, read_poses
from robacc.poses.reading import PoseFile

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "fuzz"))

from mutations import mutate_text

SEEDS = (
    "Titel;Zelle 3\nPunkt;A1;A2;X [mm];Y [mm];Z [mm];A;B;C;Zeit\n"
    + "P1;1,5;-20;850,1;3;4;10;20;30;22.11.2026 10:00:05\n" * 3,
    "// SpatialAnalyzer, Units: mm\n" + "A Main p1 1.5 2.5 3.5 0.01 0.01 0.02\n" * 3,
    "Time\tJ1\tJ2\tPos X\tPos Y\tPos Z\tUx\tUy\tUz\nms\tdeg\tdeg\tmm\tmm\tmm\tmm\tmm\tmm\n"
    + "5\t1\t2\t3\t4\t5\t.1\t.1\t.1\n" * 3,
    "1.5 0.1 0.2 0.3 0 0 0 1\n" * 4,
    "header.stamp.sec,header.stamp.nanosec,/joint_states/j1/position,pose.position.x,pose.position.y,pose.position.z\n"
    + "1795341600,5,0.1,1,2,3\n" * 3,
    "sep=;\nNominal X;Nominal Y;Nominal Z;X act;Y act;Z act;Rx;Ry;Rz;Name\n" + "1;2;3;1.1;2.1;3.1;10;20;30;a\n" * 3,
)
STATEMENTS = ({}, {"units": "mm,deg", "angles": "fixed-xyz", "coverage": 2.0, "skip_gaps": True})


def attacked(count: int, seed: int, path: Path) -> int:
    """The number of files that could be read."""
    rng = random.Random(seed)
    accepted = 0
    for number in range(count):
        encoding = rng.choice(("utf-8", "cp1252", "utf-16"))
        data = mutate_text(rng.choice(SEEDS).encode(encoding), rng)
        path.write_bytes(data)
        for statements in STATEMENTS:
            try:
                poses = read_poses(PoseFile(path, **statements), ordered=number % 2 == 0, commands=False)  # type: ignore[arg-type]
                accepted += 1
                for values in (poses.position, poses.rotation, poses.q, poses.time, poses.sigma_position):
                    assert values is None or np.isfinite(values).all()
                propose_columns(path, "columns.yaml")
            except RobaccError:
                continue
            except Exception as error:
                error.add_note(f"file {number} of seed {seed}: {data!r}")
                raise
    return accepted


def test_mutated_exports_are_read_or_refused(tmp_path: Path) -> None:
    assert attacked(60, 0, tmp_path / "export.txt") > 10


@pytest.mark.slow
def test_many_mutated_exports(tmp_path: Path) -> None:
    assert attacked(1500, 1, tmp_path / "export.txt") > 100
