"""One thread or two of the linear algebra: the same figures to 1e-9, in m and rad."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

N = 20_000
"""So many that OpenBLAS does divide the sums over the errors among its threads."""


def leaves(value: Any) -> list[Any]:
    if isinstance(value, dict):
        return [leaf for item in value.values() for leaf in leaves(item)]
    if isinstance(value, list):
        return [leaf for item in value for leaf in leaves(item)]
    return [value]


@pytest.fixture(scope="module")
def poses(tmp_path_factory: pytest.TempPathFactory) -> Path:
    rng = np.random.default_rng(7)
    commanded = rng.uniform(-1, 1, size=(N, 3))
    path = tmp_path_factory.mktemp("threads") / "poses.csv"
    table = np.hstack((commanded + rng.normal(scale=(1e-4, 2e-4, 3e-4), size=(N, 3)), commanded))
    np.savetxt(path, table, fmt="%.9f", delimiter=",", header="x,y,z,cmd_x,cmd_y,cmd_z", comments="")
    return path


def test_an_estimate_does_not_hang_on_the_number_of_threads(poses: Path) -> None:
    found = []
    for threads in ("1", "2"):
        run = subprocess.run(
            (sys.executable, "-m", "robacc", "estimate", str(poses), "--format", "json"),
            env={**os.environ, "OPENBLAS_NUM_THREADS": threads},
            check=True,
            capture_output=True,
            text=True,
        )
        found.append(leaves(json.loads(run.stdout)))
    one, two = ([leaf for leaf in result if isinstance(leaf, float)] for result in found)
    assert len(one) > 3 * N
    np.testing.assert_allclose(two, one, rtol=1e-9, atol=1e-15)
    assert [leaf for leaf in found[0] if not isinstance(leaf, float)] == [
        leaf for leaf in found[1] if not isinstance(leaf, float)
    ]
