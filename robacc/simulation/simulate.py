"""Measured poses made up: a robot with its effects commanded through its joint ranges, and an instrument's noise.

The prediction is the model's own, exact and nonlinear, elastic equilibrium included. Everything random comes from one
seed, in a stream for each purpose, so that asking for noise does not move the poses.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from robacc.errors import InputError, Problem, UsageError
from robacc.geometry import Array, compose, exp_so3
from robacc.measurements import Measurements, motion_between_rows
from robacc.modelling.model import predict
from robacc.robots.description import Robot
from robacc.robots.summary import low_discrepancy

_DECIMALS = 6
"""Of commanded joint variables: a microradian or micrometre, about what a controller's display resolves."""
_STREAMS = {"poses": 0, "payload": 1, "position": 2, "orientation": 3, "outliers": 4, "order": 5}
_MOST_ROWS = 2_000_000
"""Some GB of arrays and text; what more is meant to be is a slip of the keyboard."""
_WARM_UP = 3.0
"""Time constants that a warm-up lasts: 95 % of the rise is then over."""


@dataclass(frozen=True, slots=True)
class Plan:
    """What is measured, in which circumstances and how well. SI units."""

    poses: int
    """Commanded poses."""
    seed: int = 0
    cycles: int = 1
    """Times that all commanded poses are gone through, in the same order."""
    sampling: Literal["even", "random"] = "even"
    """Low-discrepancy or independent uniform joint variables, within the limits."""
    noise_position: float = 0.0
    """Standard deviation along each axis, m."""
    noise_orientation: float = 0.0
    """Standard deviation about each axis, rad."""
    sigma: bool = False
    """Whether the measuring uncertainty is among the columns."""
    outliers: int = 0
    """Rows whose position is wrong by ``outlier_size`` in some direction."""
    outlier_size: float = 0.01
    orientation: bool = True
    commanded: bool = False
    """Whether the commanded poses, of the robot without its effects, are among the columns."""
    motion: bool = True
    """Whether direction and speed of approach are among the columns, as the order of poses gives them."""
    time_step: float | None = None
    """s from one pose to the next; None: no time."""
    temperature: tuple[float, float] | None = None
    """Degrees Celsius at the start, and what a warm-up tends to; equal: constant."""
    payloads: tuple[float, ...] = ()
    """kg; each commanded pose has one of them, at random."""


@dataclass(frozen=True, slots=True)
class Simulation:
    """Measured poses, and what is known of them because they were made up."""

    data: Measurements
    outliers: NDArray[np.int64]
    """Rows that were made wrong, ascending, counted from 0."""


def simulate(robot: Robot, plan: Plan, at: Measurements | None = None) -> Simulation:
    """Measure ``robot``, with the effects its file lists, as ``plan`` says.

    With several targets each is measured at every pose, one row a target. Commanded poses ``at``, in the order visited,
    take the place of sampled ones; of them joint variables, ids and cycles are used.

    Raises:
        InputError: a slide has no limits, or the robot's effects cannot be read.
        UsageError: the plan lacks a circumstance that an effect depends on, or has more outliers than rows, or too many
            rows, or repeats cycles.
    """
    data = _circumstances(robot, plan, at)
    poses = predict(robot, data)
    position, rotation = poses.translation, poses.rotation
    shape = position.shape
    if plan.noise_position > 0:
        position = position + _stream(plan, "position").normal(scale=plan.noise_position, size=shape)
    if plan.noise_orientation > 0:
        rotation = compose(
            exp_so3(_stream(plan, "orientation").normal(scale=plan.noise_orientation, size=shape)), rotation
        )
    wrong, shift = _outliers(plan, data.n)
    position = position.copy()
    position[:, wrong] += shift
    nominal = predict(dataclasses.replace(robot, effects=()), data) if plan.commanded else None
    measured = dataclasses.replace(
        data,
        position=position,
        rotation=rotation if plan.orientation else None,
        commanded_position=None if nominal is None else nominal.translation,
        commanded_rotation=None if nominal is None or not plan.orientation else nominal.rotation,
        sigma_position=np.full(shape, plan.noise_position) if plan.sigma else None,
        sigma_rotation=np.full(data.n, plan.noise_orientation) if plan.sigma and plan.orientation else None,
        direction=data.direction if plan.motion else None,
        speed=data.speed if plan.motion else None,
    )
    return Simulation(measured, wrong)


def joint_samples(robot: Robot, plan: Plan) -> Array:
    """``(J, poses)`` commanded joint variables within the limits; a turn for a revolute joint without.

    Raises:
        InputError: a prismatic joint has no limits; each one that has none.
    """
    problems = [
        Problem(f"the slide {joint.name} has no limits to sample within", column=f"joints.{joint.name}.limits")
        for joint in robot.variables
        if joint.limits is None and joint.type == "prismatic"
    ]
    if problems:
        raise InputError([dataclasses.replace(problem, fix="give it limits") for problem in problems])
    low, high = np.array([joint.limits or (-np.pi, np.pi) for joint in robot.variables]).T[..., None]
    rng = _stream(plan, "poses")
    if plan.sampling == "random":
        unit = rng.uniform(size=(len(low), plan.poses))
    else:
        # Turned by a random amount (Cranley and Patterson 1976), so that a seed has poses of its own, still even.
        unit = (low_discrepancy(len(low), plan.poses) + rng.uniform(size=(len(low), 1))) % 1.0
        if plan.time_step is not None:
            # The sequence runs evenly through each joint's range, so in its own order a drift over time would look like
            # a periodic error of a joint.
            unit = unit[:, _stream(plan, "order").permutation(plan.poses)]
    result: Array = np.clip(np.round(low + (high - low) * unit, _DECIMALS), low, high)
    return result


def _circumstances(robot: Robot, plan: Plan, at: Measurements | None) -> Measurements:
    """Everything but what is measured: poses visited in order, cycle after cycle, and each target measured there."""
    targets = tuple(robot.targets) if len(robot.targets) > 1 else (None,)
    one_cycle = plan.poses if at is None else at.n
    visits = one_cycle * plan.cycles
    if visits * len(targets) > _MOST_ROWS:
        raise UsageError(f"{visits * len(targets)} rows are more than the {_MOST_ROWS} that are made at once")
    stand = np.tile(np.arange(one_cycle), plan.cycles)
    visit = np.arange(visits).repeat(len(targets))
    q, ids = (joint_samples(robot, plan), _numbered(np.arange(plan.poses))) if at is None else _planned(at)
    direction, speed = motion_between_rows(q[:, stand])
    cycle = None if at is None else at.cycle
    if plan.cycles > 1:
        if cycle is not None:
            raise UsageError("the poses to visit have cycles already: leave out --cycles, or their column cycle")
        cycle = np.repeat(np.arange(1, plan.cycles + 1), one_cycle).astype(str)
    pose = stand[visit]
    weights = np.array(plan.payloads)
    chosen = None
    if weights.size:
        same = np.arange(one_cycle) if at is None else at.groups()
        chosen = _stream(plan, "payload").choice(weights, size=int(same.max()) + 1)[same]
    return Measurements(
        position=np.zeros((3, visit.size)),
        q=q[:, pose],
        pose=ids[pose],
        cycle=None if cycle is None else cycle[visit],
        target=None if targets == (None,) else np.tile(np.array(targets), visits),
        time=None if plan.time_step is None else plan.time_step * visit.astype(float),
        temperature=None if plan.temperature is None else _temperature(plan.temperature, visits)[visit],
        payload=None if chosen is None else chosen[pose],
        direction=direction[:, visit],
        speed=speed[:, visit],
    )


def _planned(at: Measurements) -> tuple[Array, NDArray[np.str_]]:
    """Joint variables ``(J, n)`` and ids ``(n,)`` of poses to visit."""
    if at.q is None:
        raise UsageError("the poses to visit have no joint columns")
    return at.q, _numbered(at.groups()) if at.pose is None else at.pose


def _numbered(poses: NDArray[np.int64]) -> NDArray[np.str_]:
    """Ids P1, P2 … of numbers from 0, all of one width."""
    digits = len(str(int(poses.max(initial=0)) + 1))
    return np.array([f"P{number + 1:0{digits}d}" for number in poses])


def _temperature(ends: tuple[float, float], visits: int) -> Array:
    """``(visits,)``: first-order rise from the first to the second, evenly spaced in time."""
    start, end = ends
    result: Array = end + (start - end) * np.exp(-_WARM_UP * np.arange(visits) / max(visits - 1, 1))
    return result


def _outliers(plan: Plan, n: int) -> tuple[NDArray[np.int64], Array]:
    """Rows ``(K,)`` and how far each is off, ``(3, K)`` m."""
    if plan.outliers > n:
        raise UsageError(f"{plan.outliers} outliers are more than the {n} rows")
    rng = _stream(plan, "outliers")
    rows = np.sort(rng.choice(n, size=plan.outliers, replace=False)).astype(np.int64)
    way = rng.normal(size=(3, plan.outliers))
    return rows, plan.outlier_size * way / np.sqrt(np.sum(np.square(way), axis=0))


def _stream(plan: Plan, purpose: str) -> np.random.Generator:
    return np.random.default_rng([plan.seed, _STREAMS[purpose]])
