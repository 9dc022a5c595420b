"""Orders of a periodic error: the uncertainty of amplitude and phase."""

from __future__ import annotations

import math

import numpy as np

from robacc.effects.transmission_error import TransmissionError
from robacc.fitting.parameters import FittedParameter
from robacc.tracing.harmonics import fitted_harmonics


def line_of(values: np.ndarray, covariance: np.ndarray) -> tuple[float, float | None, float, float | None]:
    own = [FittedParameter(name, float(value), 1e-6, "rad") for name, value in zip("cs", values, strict=True)]
    (line,) = fitted_harmonics(TransmissionError(("j1",), (2.0,)), own, covariance)
    return line.amplitude, line.amplitude_std, line.phase, line.phase_std


def test_errors_of_amplitude_and_phase_are_those_of_draws() -> None:
    """A standard deviation of 20000 draws is known to 0.5 %; the curvature at 3 % of the amplitude adds less."""
    values, covariance = np.array([3e-4, -4e-4]), 1e-12 * np.array([[160.0, 60.0], [60.0, 90.0]])
    amplitude, along, phase, across = line_of(values, covariance)
    assert math.isclose(amplitude, 5e-4)
    assert math.isclose(phase, math.atan2(-4, 3))
    cosine, sine = np.random.default_rng(0).multivariate_normal(values, covariance, 20_000).T
    assert along is not None
    assert across is not None
    assert math.isclose(along, float(np.std(np.hypot(cosine, sine))), rel_tol=0.02)
    assert math.isclose(across, float(np.std(np.arctan2(sine, cosine))), rel_tol=0.02)


def test_what_is_not_identified_has_no_error() -> None:
    values = np.array([3e-4, 4e-4])
    assert line_of(values, np.full((2, 2), np.nan))[1::2] == (None, None)
    assert line_of(np.zeros(2), np.eye(2))[1::2] == (None, None)
