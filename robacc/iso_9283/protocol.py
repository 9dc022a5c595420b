"""Which conditions of the standard's protocol the data meet, which they do not, and which they cannot show.

Clauses of ISO 9283:1998: 6.2 (conditions prior to testing), 6.3 (environment), 6.5 (instrumentation), 6.6 (load), 6.7
(velocity), 6.8 (poses), 6.9 (cycles), 7.2 (approaches), 7.4 (stabilisation).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from robacc.geometry import Array, Poses
from robacc.iso_9283.cube import PREFERRED_EDGES, CubeFit, fit_cube
from robacc.iso_9283.records import Characteristic, Condition, Status
from robacc.iso_9283.visits import CommandedPose
from robacc.measurements import Measurements, motion_between_rows
from robacc.robots.description import Robot

CYCLES = 30
_POSES = 5
_AMBIENT, _AMBIENT_BAND = 20.0, 2.0
_FULL = 0.02
"""A load or velocity within this part of the rated one is the rated one."""
_LOADS = (1.0, 0.1)
_VELOCITIES = (1.0, 0.5, 0.1)
_UNCERTAINTY = 0.25
"""Largest part of the criterion that the measuring uncertainty may be."""


def protocol(
    files: Sequence[Measurements],
    poses: Sequence[CommandedPose],
    robot: Robot | None,
    repeatability: Characteristic,
    shift: Characteristic,
    rated_load: float | None,
) -> tuple[Condition, ...]:
    """Every condition, in the order of the clauses."""
    own = [[pose for pose in poses if pose.number == number] for number in range(len(files))]
    return (
        _warm_up(shift),
        _temperature(files),
        _instrument(files, repeatability),
        _load(files, rated_load),
        _velocity(files),
        _five(own),
        *_cube(own, robot),
        _cycles(poses),
        _approach(files, poses),
        Condition(
            "stabilisation",
            "7.4",
            "unknown",
            "the data do not say how long after its arrival each pose was measured",
        ),
    )


def _warm_up(shift: Characteristic) -> Condition:
    lower = shift.position.interval.lower
    if lower is not None and lower > 0.0 and shift.position.value is not None:
        size = shift.position.value * 1e3
        why = f"the data do not say; but the barycentre of {shift.position_at} moved {size:.2g} mm during the run"
        return Condition("warm-up", "6.2", "unknown", why)
    return Condition("warm-up", "6.2", "unknown", "the data do not say whether the robot was warm")


def _temperature(files: Sequence[Measurements]) -> Condition:
    name, clause = "temperature", "6.3"
    logged = [data.temperature for data in files if data.temperature is not None]
    if len(logged) < len(files):
        return Condition(name, clause, "unknown", "no column temperature_c")
    low, high = min(float(t.min()) for t in logged), max(float(t.max()) for t in logged)
    found = f"{low:.1f} °C to {high:.1f} °C"
    if high - low > 2.0 * _AMBIENT_BAND:
        return Condition(name, clause, "not met", f"{found}: not held within ± {_AMBIENT_BAND:.0f} °C")
    if abs(low - _AMBIENT) <= _AMBIENT_BAND and abs(high - _AMBIENT) <= _AMBIENT_BAND:
        return Condition(name, clause, "met", f"{found}, within 20 °C ± {_AMBIENT_BAND:.0f} °C")
    return Condition(
        name, clause, "met", f"{found}: held within ± 2 °C, not about 20 °C, so to be stated with the result"
    )


def _instrument(files: Sequence[Measurements], repeatability: Characteristic) -> Condition:
    name, clause = "measuring uncertainty", "6.5"
    sigmas = [data.sigma_position for data in files if data.sigma_position is not None]
    smallest = [place.position.value for place in repeatability.places if place.position.value is not None]
    if len(sigmas) < len(files):
        return Condition(name, clause, "unknown", "no columns sigma_x, sigma_y, sigma_z")
    if not smallest:
        return Condition(name, clause, "unknown", "no RP to compare it with")
    expanded = 2.0 * max(float(np.max(sigma)) for sigma in sigmas)
    share = expanded / min(smallest) if min(smallest) > 0.0 else np.inf
    why = (
        f"expanded (k = 2) {expanded * 1e3:.2g} mm is {100 * share:.0f} % of the smallest RP, at most 25 % are allowed"
    )
    return Condition(name, clause, "met" if share <= _UNCERTAINTY else "not met", why)


def _load(files: Sequence[Measurements], rated: float | None) -> Condition:
    name, clause = "rated load", "6.6"
    loads = [data.payload for data in files if data.payload is not None]
    if len(loads) < len(files):
        return Condition(name, clause, "unknown", "no column payload_kg")
    low, high = min(float(load.min()) for load in loads), max(float(load.max()) for load in loads)
    if high - low > _FULL * max(high, 1e-9):
        return Condition(name, clause, "not met", f"the load varies from {low:g} kg to {high:g} kg")
    if rated is None:
        return Condition(name, clause, "unknown", f"{high:g} kg throughout; --rated-load says what the rated one is")
    share = high / rated
    return Condition(name, clause, *_nominal(share, _LOADS, f"{high:g} kg of {rated:g} kg", "load"))


def _velocity(files: Sequence[Measurements]) -> Condition:
    name, clause = "rated velocity", "6.7"
    speeds = [data.speed for data in files if data.speed is not None]
    if len(speeds) < len(files):
        return Condition(name, clause, "unknown", "no speed columns")
    if any(_from_order(data) for data in files):
        why = "speeds are derived from the order of rows: shares among the joints, not how fast"
        return Condition(name, clause, "unknown", why)
    fastest = np.concatenate([np.max(np.abs(speed), axis=0) for speed in speeds])
    fastest = fastest[fastest > 0.0]
    if fastest.size == 0:
        return Condition(name, clause, "unknown", "every speed is 0")
    if np.ptp(fastest) > _FULL:
        why = f"the fastest joint's speed varies from {100 * fastest.min():.0f} % to {100 * fastest.max():.0f} %"
        return Condition(name, clause, "not met", why)
    share = float(fastest.mean())
    return Condition(name, clause, *_nominal(share, _VELOCITIES, "the fastest joint's last motion", "velocity"))


def _from_order(data: Measurements) -> bool:
    """Whether the speeds are those that the rows' order gives, which are relative."""
    if data.speed is None or data.q is None:
        return False
    return bool(np.allclose(data.speed, motion_between_rows(data.q)[1], atol=1e-9))


def _nominal(share: float, steps: tuple[float, ...], what: str, quantity: str) -> tuple[Status, str]:
    """The status of a share of the rated value, and why; the standard's optional steps are named."""
    step = next((step for step in steps if abs(share - step) <= _FULL * max(step, 0.1)), None)
    if step == 1.0:
        return "met", f"{what}: 100 %"
    optional = ", ".join(f"{100 * one:.0f} %" for one in steps[1:])
    if step is not None:
        return (
            "met",
            f"{what}: {100 * step:.0f} %, one of the optional steps; a test at 100 % {quantity} is needed beside it",
        )
    return "not met", f"{what}: {100 * share:.0f} %; the standard's is 100 %, and {optional} as an option"


def _five(files: Sequence[Sequence[CommandedPose]]) -> Condition:
    counts = sorted({len(poses) for poses in files})
    found = f"{' and '.join(map(str, counts))} commanded pose{'s' * (counts != [1])}"
    return Condition("five poses", "6.8", "met" if counts == [_POSES] else "not met", found)


def _cube(files: Sequence[Sequence[CommandedPose]], robot: Robot | None) -> tuple[Condition, Condition]:
    """The diagonal plane and the distance from the corners, judged on the first file."""
    names = ("diagonal plane", "10 % from the corners")
    poses = files[0]
    points = [pose.commanded for pose in poses if pose.commanded is not None]
    if len(points) < len(poses):
        return _both(names, "unknown", "the commanded positions are not known")
    if len(points) != _POSES:
        return _both(names, "not met", "needs five commanded poses")
    fit = fit_cube(_in_base(np.stack(points, axis=1), robot))
    if isinstance(fit, str):
        return _both(names, "not met", fit)
    first = Condition(
        names[0],
        "6.8",
        "met",
        f"{poses[fit.centre].label} is the centre, and the plane rises at 45° towards {fit.plane}",
    )
    if fit.plane is None:
        first = Condition(
            names[0], "6.8", "not met", "a diagonal plane, but an upright one: the standard's rise at 45°"
        )
    return first, _distance_from_corners(names[1], fit)


def _both(names: tuple[str, str], status: Status, why: str) -> tuple[Condition, Condition]:
    return Condition(names[0], "6.8", status, why), Condition(names[1], "6.8", status, why)


def _distance_from_corners(name: str, fit: CubeFit) -> Condition:
    edge = f"a cube of {fit.edge * 1e3:.0f} mm"
    if any(abs(fit.edge - preferred) < 1e-9 for preferred in PREFERRED_EDGES):
        return Condition(name, "6.8", "met", f"{100 * fit.from_corner:.1f} % in {edge}")
    sizes = ", ".join(f"{1e3 * preferred:.0f}" for preferred in reversed(PREFERRED_EDGES))
    return Condition(name, "6.8", "unknown", f"10 % if {edge} was meant; the preferred edges are {sizes} mm")


def _in_base(points: Array, robot: Robot | None) -> Array:
    """The points in the axes of the robot's base, where it is known."""
    if robot is None:
        return points
    base = Poses.from_xyz_rpy(np.array(robot.base.xyz), np.array(robot.base.rpy))
    result: Array = base.rotation.T @ (points - base.translation[:, None])
    return result


def _cycles(poses: Sequence[CommandedPose]) -> Condition:
    fewest, most = min(pose.n for pose in poses), max(pose.n for pose in poses)
    found = (
        f"{most} visits of each commanded pose" if fewest == most else f"{fewest} to {most} visits of a commanded pose"
    )
    return Condition("30 cycles", "6.9", "met" if fewest >= CYCLES else "not met", found)


def _approach(files: Sequence[Measurements], poses: Sequence[CommandedPose]) -> Condition:
    name, clause = "one approach", "7.2"
    if any(data.direction is None for data in files):
        return Condition(
            name, clause, "unknown", "approach directions are not known; --ordered derives them from the rows"
        )
    several = []
    for pose in poses:
        assert pose.direction is not None
        known = pose.direction[:, np.any(pose.direction != 0, axis=0)]
        if np.unique(known, axis=1).shape[1] > 1:
            several.append(pose.label)
    if several:
        why = f"{', '.join(several[:3])}{' …' * (len(several) > 3)} reached in several ways: AP and RP contain vAP"
        return Condition(name, clause, "not met", why)
    return Condition(name, clause, "met", "each pose was always reached with the joints turning the same way")
