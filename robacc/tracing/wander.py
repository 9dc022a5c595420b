"""Errors that wander slowly, and how much of a step's evidence they account for.

An instrument's mounting that creeps with the temperature of the hall, or a tracker whose compensation comes and goes,
gives errors that are correlated over many poses. Steps describe such errors piecewise. The wander is an
Ornstein-Uhlenbeck process in each component in addition to white noise,

    r_i = w(t_i) + e_i,   cov(w(s), w(t)) = a exp(-|s - t| / tau),   var(e_i) = 1,

of which the likelihood follows from a Kalman filter (G. E. Uhlenbeck, L. S. Ornstein, Phys. Rev. 36 (1930) 823; R. H.
Jones, Technometrics 22 (1980) 389). Amplitude, time constant and noise are those of the largest likelihood, for the
residual with the step and for that without it.
"""

from __future__ import annotations

import numpy as np

from robacc.fitting.fit_result import Fit
from robacc.geometry import Array
from robacc.measurements import Measurements

_MOST_POSES = 2000
"""Largest number of poses in the likelihood; of more, every second, third, … is used."""
_AMPLITUDES = np.concatenate(([0.0], np.geomspace(0.05, 50.0, 9)))
"""Grid of the wander's variance over that of the noise."""
_TIMES = np.geomspace(3.0, 300.0, 7)
"""Grid of the time constant over the median time between poses."""


def explained_by_wander(without: Fit, with_step: Fit, data: Measurements) -> float:
    """Return the part of a step's gain in log-likelihood that a wander of the errors accounts for.

    Args:
        without: Fit without the step.
        with_step: Fit with it.
        data: Poses of both fits.
    """
    rows = np.flatnonzero(without.inliers & with_step.inliers)
    time = np.arange(data.n, dtype=np.float64) if data.time is None else data.time
    rows = rows[np.argsort(time[rows], kind="stable")]
    thinning = -(-rows.size // _MOST_POSES)
    rows = rows[::thinning]
    gains = [likelihood_gain(fit.weight[:3, rows] * fit.residual[:3, rows], time[rows]) for fit in (without, with_step)]
    return thinning * (gains[0] - gains[1])


def likelihood_gain(residual: Array, time: Array) -> float:
    """Return the gain of log-likelihood of a wander plus noise over noise alone, at the best of a grid.

    Args:
        residual: ``(M, N)`` whitened residuals, in the order of time.
        time: ``(N,)`` time of each pose.
    """
    interval = np.diff(time)
    usual = float(np.median(interval[interval > 0])) if np.any(interval > 0) else 1.0
    amplitude, tau = (grid.ravel() for grid in np.meshgrid(_AMPLITUDES, _TIMES * usual))
    components, n = residual.shape
    mean = np.zeros((components, amplitude.size))
    variance = amplitude.copy()
    squares, log_determinant = np.zeros(amplitude.size), np.zeros(amplitude.size)
    for i in range(n):
        if i:
            memory = np.exp(-interval[i - 1] / tau)
            mean *= memory
            variance = memory**2 * variance + (1.0 - memory**2) * amplitude
        innovation, innovation_var = residual[:, i, None] - mean, variance + 1.0
        squares += np.sum(np.square(innovation), axis=0) / innovation_var
        log_determinant += components * np.log(innovation_var)
        gain = variance / innovation_var
        mean += gain * innovation
        variance = variance * (1.0 - gain)
    count = components * n
    likelihood = -0.5 * count * np.log(np.maximum(squares / count, 1e-300)) - 0.5 * log_determinant
    return float(likelihood.max() - likelihood[amplitude == 0.0].max())
