"""Does a 95 % interval hold the truth 95 times in 100? Counted over 1,000 simulated sets for each interval."""

from __future__ import annotations

from collections import defaultdict

import numpy as np
import pytest

from robacc.accuracy.error_statistics import MatrixInterval, error_statistics
from robacc.statistics.intervals import Interval
from robacc.statistics.lengths import length_quantile

SETS = 1000
COVARIANCES = {
    "alike": np.eye(3),
    "oblique": np.array([[1.0, 0.3, 0.0], [0.3, 2.0, -0.5], [0.0, -0.5, 4.0]]),
    "long": np.diag([1.0, 9.0, 81.0]),
}


Held = dict[str, list[bool | None]]
"""Whether each named interval held the truth, in every set; None where there was no interval."""


def note(held: Held, name: str, interval: Interval, truth: float) -> None:
    if interval.lower is None or interval.upper is None or interval.upper_bound is None:
        held[name].append(None)
        return
    held[name].append(interval.lower <= truth <= interval.upper)
    held[f"{name}, upper bound"].append(truth <= interval.upper_bound)


def note_matrix(held: Held, name: str, interval: MatrixInterval, truth: np.ndarray) -> None:
    inside = (interval.lower <= truth) & (truth <= interval.upper)
    held[f"{name} diagonal"] += np.diag(inside).tolist()
    held[f"{name} off the diagonal"] += inside[np.triu_indices(3, 1)].tolist()


def simulate(covariance: np.ndarray, mean: np.ndarray, n: int, cycles: int = 1, within: float = 0.0) -> Held:
    rng = np.random.default_rng(11)
    root = np.linalg.cholesky(covariance)
    values, axes = np.linalg.eigh(covariance)
    about_zero = covariance + np.outer(mean, mean)
    lengths = np.linalg.norm(mean[:, None] + root @ rng.standard_normal((3, 2_000_000)), axis=0)
    radius = length_quantile(0.95, axes.T @ mean, values)
    scalars = {
        "rms": float(np.sqrt(np.trace(about_zero))),
        "mean_error": float(lengths.mean()),
        "p95": radius,
        "radius95_zero_mean": length_quantile(0.95, np.zeros(3), np.linalg.eigvalsh(about_zero)),
        "radius95_fitted_mean": radius,
    }
    sds = np.sqrt(np.linalg.eigvalsh(about_zero)[::-1])
    groups = None if cycles == 1 else np.repeat(np.arange(n), cycles)
    held: Held = defaultdict(list)
    for _ in range(SETS):
        own = np.repeat(root @ rng.standard_normal((3, n)), cycles, axis=1)
        errors = mean[:, None] + np.sqrt(1 - within) * own
        if within:
            errors += np.sqrt(within) * root @ rng.standard_normal((3, n * cycles))
        found = error_statistics(errors, "m", groups=groups, bootstrap=1000, seed=int(rng.integers(2**31)))
        intervals = found.intervals
        by_name = {name: getattr(intervals, name) for name in ("rms", "mean_error", "p95")}
        by_name |= {name: getattr(found, name).interval for name in ("radius95_zero_mean", "radius95_fitted_mean")}
        for name, interval in by_name.items():
            note(held, name, interval, scalars[name])
        for axis in range(3):
            note(held, "mean", intervals.mean[axis], float(mean[axis]))
            note(held, "principal sd", found.ellipsoid.intervals[axis], float(sds[axis]))
        note_matrix(held, "covariance", intervals.covariance, about_zero)
        note_matrix(held, "centred covariance", intervals.centred_covariance, covariance)
    return held


def judged(held: Held, at_least: set[str]) -> None:
    """Every coverage is 93 to 97 %; of ``at_least`` it may be more.

    The share of the sets is binomial about the coverage. It refutes one of 93 to 97 % beyond three standard errors,
    0.024 and 0.016: of 30 oblique poses the upper bound of p95 holds in 93.2 % of 10,000 sets, in some 1,000 in less.
    """
    shares = {name: np.mean([inside for inside in of_name if inside is not None]) for name, of_name in held.items()}
    least, most = (share + 3 * sign * np.sqrt(share * (1 - share) / SETS) for share, sign in ((0.93, -1), (0.97, 1)))
    assert {name: share for name, share in shares.items() if share < least} == {}
    assert {name: share for name, share in shares.items() if share > most and name not in at_least} == {}


@pytest.mark.slow
@pytest.mark.parametrize("n", [30, 100])
@pytest.mark.parametrize("offset", [0.0, 2.0])
@pytest.mark.parametrize("shape", COVARIANCES)
def test_coverage_of_independent_poses(shape: str, offset: float, n: int) -> None:
    held = simulate(COVARIANCES[shape], offset * np.array([1.0, 0.5, 0.0]), n)
    # Axes that cannot be told apart share an interval that holds at least as often as it says.
    judged(held, {"principal sd", "principal sd, upper bound"})
    # Where a test at 1 % rejects a Gaussian that is one, thirty poses leave the percentile without an interval.
    assert held["p95"].count(None) <= 0.05 * SETS


@pytest.mark.slow
def test_coverage_of_repeated_poses() -> None:
    """Half the variance between poses, half within: five repetitions are not five poses."""
    held = simulate(COVARIANCES["oblique"], np.zeros(3), 100, cycles=5, within=0.5)
    judged(held, {"p95", "p95, upper bound", "principal sd", "principal sd, upper bound"})
