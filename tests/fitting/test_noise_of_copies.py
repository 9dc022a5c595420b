"""Copied rows show no noise: neither the noise nor its structure is taken from them."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from arms import arm

import robacc
from robacc.measurements import Measurements
from robacc.modelling.model import predict

NOISE = 2e-5
DECLARED = "base_frame,tool_frame,joint_offset"


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Eighty measured poses, and the same file with twenty rows copied to its end."""
    folder = tmp_path_factory.mktemp("copies")
    plain, copied = folder / "plain.csv", folder / "copied.csv"
    rng = np.random.default_rng(3)
    q = rng.uniform(-1.5, 1.5, (6, 80))
    nominal = predict(arm("puma560").robot, Measurements(position=np.zeros((3, 80)), q=q)).translation
    position = nominal + NOISE * rng.standard_normal((3, 80))
    rows = [[*map(repr, map(float, values))] for values in np.vstack((q, position, 60.0 * np.arange(80))).T]
    header = [*(f"q{i + 1}" for i in range(6)), "x", "y", "z", "time_s"]
    for path, more in ((plain, []), (copied, rows[10:70:3])):
        with path.open("w", newline="") as stream:
            csv.writer(stream).writerows((header, *rows, *more))
    return plain, copied


def test_copies_are_no_repeats(files: tuple[Path, Path]) -> None:
    plain, copied = (
        robacc.trace(path, robot=arm("puma560").robot, declared=DECLARED, ignore_limits=True) for path in files
    )
    assert any("20 rows repeat an earlier row" in text for text in copied.warnings)
    for result in (plain, copied):
        assert result.verdict == "clean"
        assert result.noise.noise.source == "residual"
        assert result.noise.noise.position == pytest.approx(NOISE, rel=0.15)
        assert not any("correlated in time" in text or "are similar where" in text for text in result.warnings)
