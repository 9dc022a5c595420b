"""Orders of a periodic error: the uncertainty of amplitude and phase."""

from __future__ import annotations

import math

import numpy as np
import pytest
from arms import arm

from robacc.effects.base import effect_class
from robacc.effects.periodic import TransmissionError
from robacc.fitting.parameters import FittedParameter
from robacc.tracing.trace import Harmonic, fitted_harmonics, periodic_statement


def line_of(values: np.ndarray, covariance: np.ndarray) -> tuple[float, float | None, float, float | None]:
    own = [FittedParameter(name, float(value), 1e-6, "rad") for name, value in zip("cs", values, strict=True)]
    (line,) = fitted_harmonics(
        TransmissionError(("j1",), (2.0,)), own, covariance, arm("puma560"), np.linspace(0.0, 3.0), ()
    )
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


def test_a_counterbalance_is_named_beside_the_spring_of_its_joint() -> None:
    """Orders 1 and 2 describe the torque of a spring between two points over 2 rad; only a springy joint shows it."""
    angle = np.linspace(-1.0, 1.0, 201)
    a, b, free = 0.35, 0.25, 0.3
    torque = a * b * np.sin(angle + 0.4) * (1 - free / np.sqrt(a**2 + b**2 + 2 * a * b * np.cos(angle + 0.4)))
    waves = np.array([np.ones_like(angle), *(f(n * angle) for n in (1, 2) for f in (np.cos, np.sin))]).T
    remainder = torque - waves @ np.linalg.lstsq(waves, torque, rcond=None)[0]
    assert np.std(remainder) < 0.02 * np.std(torque)
    wave = effect_class("transmission_error").from_settings(("j2",), {"orders": [1, 2]})
    spring = effect_class("joint_compliance").from_settings(("j2",), {})
    other = effect_class("joint_compliance").from_settings(("j3",), {})
    low = [Harmonic(order, 1e-4, 1e-6, 0.0, 0.1) for order in (1.0, 2.0)]
    text = periodic_statement(wave, low, (wave, other, spring))
    assert text is not None
    assert "with joint_compliance[j2], a counterbalance across j2" in text
    for effects, harmonics in (((wave, other), low), ((spring,), [*low, Harmonic(51.0, 1e-5, 1e-6, 0.0, 0.1)])):
        assert "counterbalance" not in (periodic_statement(wave, harmonics, effects) or "")


def test_harmonics_of_a_profile_are_the_waves_over_the_measured_angles() -> None:
    """Whole orders over 2.5 rad imitate order 17.25; over a whole turn the harmonics are the coefficients."""
    orders = tuple(float(order) for order in range(1, 37))
    effect = TransmissionError(("j1",), orders, True)
    angle = np.linspace(-0.3, 2.2, 400)
    waves = np.concatenate([(np.cos(n * angle), np.sin(n * angle)) for n in orders])
    values = np.linalg.lstsq(waves.T, 2e-4 * np.cos(17.25 * angle + 0.3), rcond=1e-4)[0]
    covariance = 1e-12 * np.eye(72)

    def strongest(values: np.ndarray, angle: np.ndarray) -> Harmonic:
        own = [FittedParameter(f"c{i}", float(value), 1e-6, "rad") for i, value in enumerate(values)]
        return fitted_harmonics(effect, own, covariance, arm("puma560"), angle, ())[0]

    assert strongest(values, angle).order == 17.0
    assert strongest(values, angle).amplitude == pytest.approx(2e-4, rel=0.1)
    values = np.zeros(72)
    values[[32, 33, 34, 35]] = [1e-4, -2e-4, 1e-4, 1e-4]
    whole = strongest(values, np.linspace(0.0, 2.0 * np.pi, 400, endpoint=False))
    assert (whole.order, whole.amplitude) == (17.0, pytest.approx(np.sqrt(5) * 1e-4))
    assert whole.phase == pytest.approx(math.atan2(-2, 1))
    assert whole.amplitude_std == pytest.approx(1e-6)
