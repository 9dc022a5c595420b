"""Loads that differ from row to row: the groups of an arm with matrices of its own, and errors that are no loads."""

from __future__ import annotations

import numpy as np
import pytest
from independent_arm import DECLARED, load_torques, measured, run, targets
from searched import fitted

from robacc.diagnostics.recorded import RowLoads, unlogged_loads

NOISE = 2e-5
N = 90
COMPLIANCE = np.array([0.0, 8e-7, 1.2e-6, 0.0, 0.0, 0.0])


def groups_of(turn: np.ndarray, seed: int, declared: str = DECLARED) -> RowLoads | None:
    """Groups of an arm whose joints are turned by ``turn`` ``(6, N)`` beyond the commanded."""
    poses = run(N, seed)
    data = measured(poses, targets(poses.q + turn), NOISE, seed, directed=True)
    return unlogged_loads(fitted(data, declared=declared), data)


def deflections(seed: int, mass: np.ndarray) -> np.ndarray:
    """Turns ``(6, N)`` of the joints by the arm's weight and a load of ``mass`` ``(N,)`` at the tool."""
    pairs = zip(run(N, seed).q.T, mass, strict=True)
    return np.array([COMPLIANCE * load_torques(q, load) for q, load in pairs]).T


@pytest.mark.parametrize("loads", [(0.0, 20.0, 40.0), (0.0, 30.0)])
def test_rows_are_grouped_by_their_load(loads: tuple[float, ...]) -> None:
    number = np.random.default_rng(3).integers(0, len(loads), N)
    turn = deflections(11, np.array(loads)[number])
    found = groups_of(turn, 11, DECLARED + ",joint_compliance[j2,j3]")
    assert len(found.rows) == len(loads)
    right = sum(np.count_nonzero(number[rows] == i) for i, rows in enumerate(found.rows))
    assert right >= 0.95 * N
    assert found.loads == pytest.approx(np.array(loads) / loads[-1], abs=0.1)
    assert "if it changed, write payload_kg" in found.text
    assert "the cause is outside the catalogue" in found.text


def test_other_errors_are_no_loads() -> None:
    """A constant load, play, scatter of a joint, a spring that is not in the model, and noise alone."""
    rng = np.random.default_rng(5)
    joint_two = np.array([[0], [1], [0], [0], [0], [0]])
    poses = run(N, 12)
    for turn in (
        deflections(12, np.full(N, 30.0)),
        1.5e-4 * poses.direction * joint_two,
        3e-4 * rng.normal(size=N) * joint_two,
        deflections(12, np.zeros(N)) * 3.0,
        np.zeros((6, N)),
    ):
        assert groups_of(turn, 12) is None
