"""Tracker at an unknown place, decentred reflector, drifting air and joints that warm up, on an independent arm."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from independent_arm import Run, link_frames, measured, run, target, targets
from scipy import stats
from searched import ARM, fitted, found, values_of

from robacc.effects.base import Effect
from robacc.effects.campaign import InstrumentScale, TargetDecentre, TrackerError
from robacc.effects.frames import JointWarmup

NOISE = 1e-5
N = 90
POSES = run(N, seed=31)
TRACKER = np.array([2.6, -1.9, 1.1])
ELAPSED = POSES.time - POSES.time[0]


def positions(poses: Run = POSES) -> np.ndarray:
    """Targets (3, N) of the arm without errors."""
    return targets(poses.q)


def decentred(along: float, across: float, beyond: float) -> np.ndarray:
    """Targets whose optical centre is off in the frame of the beam, rolled by the tool's x."""
    rows = []
    for q in POSES.q.T:
        point, tool_x = target(q), link_frames(q)[-1][:3, 0]
        beam = (point - TRACKER) / np.linalg.norm(point - TRACKER)
        side = tool_x - beam * (beam @ tool_x)
        side /= np.linalg.norm(side)
        rows.append(point + along * beam + across * side + beyond * np.cross(beam, side))
    return np.array(rows).T


def eccentric(cosine: float, sine: float) -> np.ndarray:
    """Targets as an instrument sees them whose horizontal circle is off its axis: polar coordinates, changed."""
    x, y, z = positions() - TRACKER[:, None]
    azimuth, flat = np.arctan2(y, x), np.hypot(x, y)
    azimuth = azimuth + cosine * np.cos(azimuth) + sine * np.sin(azimuth)
    return np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), z]) + TRACKER[:, None]


def longer(offset: float) -> np.ndarray:
    """Targets as an instrument sees them whose ranges are too long."""
    beam = positions() - TRACKER[:, None]
    return TRACKER[:, None] + beam * (1 + offset / np.linalg.norm(beam, axis=0))


def through_air(ppm: float) -> np.ndarray:
    """Targets seen through air whose index swings once over the poses."""
    scale = 1e-6 * ppm * np.sin(2 * np.pi * ELAPSED / ELAPSED[-1])
    return TRACKER[:, None] + (positions() - TRACKER[:, None]) * (1 + scale)


def warm(joint: int, size: float, time_constant: float) -> np.ndarray:
    """Targets of an arm whose joint warms up."""
    return POSES.turned(joint, size * (1 - np.exp(-ELAPSED / time_constant)))


def test_a_decentred_reflector_is_found_with_the_instruments_place() -> None:
    data = measured(POSES, decentred(0.0, 1.2e-4, -6e-5), NOISE, 1)
    (effect,) = found(data)
    assert isinstance(effect, TargetDecentre)
    assert effect.axis == "x"
    np.testing.assert_allclose(effect.place, TRACKER, atol=0.4)
    values = values_of(fitted(data, [effect]))
    assert values["target_decentre.across"] == pytest.approx(1.2e-4, rel=0.1)
    assert values["target_decentre.beyond"] == pytest.approx(-6e-5, rel=0.15)
    assert "turn it in its nest" in effect.statement(ARM, values)


def test_an_eccentric_horizontal_circle_is_found_and_is_no_gear_of_joint_1() -> None:
    data = measured(POSES, eccentric(2e-4, 1e-4), NOISE, 2)
    (effect,) = found(data)
    assert isinstance(effect, TrackerError)
    assert effect.kind == "horizontal"
    assert fitted(data, [effect]).misfit[0] < 1.15 * NOISE


def test_a_range_offset_moves_targets_along_the_line_of_sight() -> None:
    """The shift is that of independent polar coordinates, and a fit at the true place returns it."""
    data = measured(POSES, longer(3e-4), NOISE, 3)
    place = (float(TRACKER[0]), float(TRACKER[1]), float(TRACKER[2]))
    result = fitted(data, [TrackerError(place=place)])
    i = result.names.index("tracker_error.offset")
    assert abs(result.theta[i] - 3e-4) < 4 * np.sqrt(result.covariance[i, i])


def test_air_that_drifts_is_one_effect_about_the_instrument() -> None:
    data = measured(POSES, through_air(40.0), NOISE, 4, timed=True)
    (effect,) = found(data)
    assert isinstance(effect, InstrumentScale)
    assert effect.drift in (3, 5)
    result = fitted(data, [effect])
    assert result.misfit[0] < 1.3 * NOISE
    statement = effect.statement(ARM, values_of(result))
    place = [float(text) for text in statement.split("about the point ")[1].split(" m:")[0].split(",")]
    np.testing.assert_allclose(place, TRACKER, atol=0.5)


def test_a_base_that_drifts_is_no_drift_of_the_scale() -> None:
    """A drift of the scale about a point far away is one of the base: the simpler name stays."""
    share = ELAPSED / ELAPSED[-1] - 0.5
    moved = positions() + np.array([[-2e-4], [3e-4], [1e-4]]) * share
    (effect,) = found(measured(POSES, moved, NOISE, 6, timed=True))
    assert effect.name == "frame_drift"


@pytest.mark.parametrize("share", [np.exp(-ELAPSED / ELAPSED[8]), np.sin(9.0 * ELAPSED / ELAPSED[-1]) ** 3])
def test_a_frame_that_wanders_is_no_drift_of_the_scale(share: np.ndarray) -> None:
    """Shifts that no scale about one point explains: a drift of the scale of degree 5 follows them best of all."""
    moved = positions() + np.array([[1e-4], [-2e-4], [1.5e-4]]) * share
    effects = found(measured(POSES, moved, NOISE, 8, timed=True))
    assert "instrument_scale" not in {effect.name for effect in effects}


def test_a_joint_that_warms_up_is_found_with_its_time_constant() -> None:
    data = measured(POSES, warm(1, 3e-4, 500.0), NOISE, 5, timed=True)
    (effect,) = found(data)
    assert isinstance(effect, JointWarmup)
    minutes = effect.time_constant / 60
    assert f"{minutes:.3g} min" in effect.statement(ARM, {})
    assert effect.joints == ("j2",)
    assert 250 < effect.time_constant < 1000
    assert values_of(fitted(data, [effect]))["joint_warmup.j2"] == pytest.approx(3e-4, rel=0.25)


def test_a_warm_up_does_not_depend_on_the_clocks_zero() -> None:
    data = measured(POSES, warm(2, 3e-4, 400.0), NOISE, 6, timed=True)
    later = dataclasses.replace(data, time=data.time + 1e9)
    first, second = (fitted(at, [JointWarmup.default(ARM, at, ("j3",))]) for at in (data, later))
    np.testing.assert_allclose(second.theta, first.theta, rtol=0, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effect", "position", "truth"),
    [
        (TargetDecentre(place=tuple(TRACKER)), decentred(2e-5, 1e-4, -5e-5), {"along": 2e-5, "across": 1e-4}),
        (TrackerError(place=tuple(TRACKER), kind="horizontal"), eccentric(1e-4, 5e-5), {"cos": 1e-4, "sin": 5e-5}),
        (JointWarmup(("j2",), 600.0, float(POSES.time[0])), warm(1, 2e-4, 600.0), {"j2": 2e-4}),
    ],
)
def test_intervals_hold_the_truth(effect: Effect, position: np.ndarray, truth: dict[str, float]) -> None:
    """Of 40 seeds and two coefficients, intervals of 95 % hold the truth in all but a few."""
    hits = []
    for seed in range(40):
        result = fitted(measured(POSES, position, NOISE, seed, timed=True), [effect])
        limit = stats.t.ppf(0.975, result.degrees_of_freedom)
        for label, value in truth.items():
            i = result.names.index(f"{effect.name}.{label}")
            hits.append(abs(result.theta[i] - value) < limit * np.sqrt(result.covariance[i, i]))
    # Below 0.88 by chance with a probability under one in a hundred.
    assert np.mean(hits) >= 0.88


@pytest.mark.slow
def test_clean_arms_are_left_alone() -> None:
    """Twenty arms with a clock and directions, and nothing wrong but noise: no finding."""
    names = []
    for seed in range(20):
        poses = run(80, seed=100 + seed)
        names += [
            str(effect) for effect in found(measured(poses, positions(poses), NOISE, seed, timed=True, directed=True))
        ]
    assert names == []
