"""What reading poses costs beside ``numpy.loadtxt``: ``pytest tests/benchmarks -m slow --benchmark-enable -s``.

The ratio is of one run on one file, printed and not judged: a machine that others use gives other ratios.
"""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from robacc.poses.csv_file import read_poses

pytestmark = pytest.mark.slow
ROWS = 100_000
HEADER = "q1,q2,q3,q4,q5,q6,x,y,z,qw,qx,qy,qz"


@pytest.mark.parametrize("digits", ["%.9f", "%.17g"])
@pytest.mark.parametrize("text", ["", ",P7,3"], ids=["numbers", "numbers and texts"])
def test_reading_against_loadtxt(
    tmp_path: Path, benchmark: BenchmarkFixture, capsys: pytest.CaptureFixture[str], digits: str, text: str
) -> None:
    rng = np.random.default_rng(1)
    quaternion = rng.normal(size=(ROWS, 4))
    quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    table = np.hstack((rng.uniform(-3, 3, (ROWS, 6)), rng.uniform(-1, 1, (ROWS, 3)), quaternion))
    path = tmp_path / "poses.csv"
    header = HEADER + (",pose,cycle" if text else "")
    np.savetxt(path, table, fmt=",".join([digits] * 13) + text, header=header, comments="")

    reading = []

    def read() -> None:
        begin = time.perf_counter()
        assert read_poses(path).n == ROWS
        reading.append(time.perf_counter() - begin)

    read()
    benchmark(read)
    base = []
    for _ in range(3):
        begin = time.perf_counter()
        loaded = np.loadtxt(path, delimiter=",", skiprows=1, usecols=range(13))
        base.append(time.perf_counter() - begin)
    assert loaded.shape == (ROWS, 13)
    ratio = min(reading) / min(base)
    with capsys.disabled():
        rate = ROWS / min(reading) / 1e6
        print(f"\n  {digits}{' with texts' if text else ''}: {rate:.2f} M rows/s, {ratio:.2f} times numpy.loadtxt")
