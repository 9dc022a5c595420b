"""The order of the visits: short, both directions, repeats and checks in their places, drift apart from place."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from robacc.planning.route import LEAST_DIRECTION_SHARE, direction_shares, route


def poses(n: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-2.0, 2.0, (6, n))


@pytest.mark.parametrize("n", [12, 30, 60])
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_routes_are_short_and_come_from_both_sides(n: int, seed: int) -> None:
    q = poses(n, seed)
    path = route(q, n // 10, 0, 10, seed)
    visited = q[:, path.visits]
    shares = direction_shares(np.sign(np.diff(visited, axis=1)))
    assert shares.min() >= LEAST_DIRECTION_SHARE
    np.testing.assert_allclose(path.direction_share, shares)
    assert path.length < 0.95 * path.random_length
    assert path.speed_std.min() > 0.1


def test_every_pose_is_visited_and_checks_recur() -> None:
    path = route(poses(25), 4, 7, 6, 0)
    visits = path.visits.tolist()
    assert set(visits) == set(range(25))
    checks = [i for i, node in enumerate(visits) if node == 7]
    assert checks[0] == 0
    assert checks[-1] == len(visits) - 1
    assert max(np.diff(checks)) == 7  # six visits between two checks
    assert path.roles.count("repeat") == 4
    assert [role == "check" for role in path.roles] == [node == 7 for node in visits]
    # A repeat is a new arrival: never the pose just visited.
    assert all(a != b for a, b in itertools.pairwise(visits))


def test_drift_is_not_confused_with_place() -> None:
    for seed in range(4):
        path = route(poses(40, seed), 4, 0, 10, seed)
        assert path.drift_share < 0.5


def test_small_sets() -> None:
    assert route(poses(1), 0, None, 1, 0).visits.tolist() == [0]
    assert sorted(route(poses(2), 0, None, 1, 0).visits.tolist()) == [0, 1]
    assert route(poses(3), 0, 1, 10, 0).visits.tolist()[0] == 1
