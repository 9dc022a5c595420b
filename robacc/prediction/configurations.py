"""Where the arm is predicted: the poses of a file, or configurations spread evenly over the joints' ranges."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from robacc.chain import Scalar
from robacc.errors import InputError, Problem, UsageError
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.robots.arm import Arm
from robacc.robots.description import Robot
from robacc.robots.summary import low_discrepancy


@dataclass(frozen=True, slots=True)
class Configurations:
    """N configurations of one arm."""

    q: Array
    """``(J, N)`` joint variables, rad or m."""
    scalars: tuple[Scalar, ...]
    """The chain's nominal scalars there, each row with the target that it measures."""
    labels: tuple[str, ...] | None
    """``(N,)`` what to call each: its line in the file; None: its number."""
    source: str
    """In words."""
    notes: tuple[str, ...] = ()

    @property
    def n(self) -> int:
        """Number of configurations."""
        return int(self.q.shape[1])

    def label(self, i: int) -> str:
        """What to call configuration ``i``."""
        return self.labels[i] if self.labels is not None else f"sample {i + 1}"


def configurations_of(robot: Robot, data: Measurements) -> Configurations:
    """The configurations that measured or planned poses were commanded at, each with its target.

    Raises:
        InputError: no poses, or no joint variables.
        UsageError: they do not fit the robot.
    """
    if data.n == 0:
        raise InputError(Problem("has no poses to predict the accuracy of", data.source))
    if data.q is None:
        fix = "add q1, q2, …"
        raise InputError(Problem("has no joint columns: the prediction needs the configurations", data.source, fix=fix))
    bound = _nominal(robot).bind(data)
    labels = tuple(data.place(i) for i in range(data.n))
    return Configurations(
        data.q, bound.nominal, labels, f"the {data.n} pose{'s' * (data.n != 1)} of {data.source or 'the data'}"
    )


def sampled_configurations(robot: Robot, n: int, seed: int = 0, target: str | None = None) -> Configurations:
    """``n`` configurations spread evenly over the joints' ranges; a revolute joint without limits gets a whole turn.

    A low-discrepancy sequence (Richtmyer's) shifted by a random vector, modulo the unit cube: R. Cranley and
    T. N. L. Patterson, "Randomization of number theoretic methods for multiple integration", SIAM J. Numer. Anal. 13
    (1976) 904-914. The seed is that of the shift.

    Args:
        robot: The arm.
        n: How many.
        seed: Of the shift.
        target: Of a robot with several, the one to predict; None: the first.

    Raises:
        UsageError: fewer than one, or a target that there is not.
        InputError: a slide without limits.
    """
    if n < 1:
        raise UsageError(f"at least one configuration must be sampled, not {n}")
    low, high, notes = _ranges(robot)
    robot, chosen = _with_target(robot, target)
    shift = np.random.default_rng(seed).random(len(low))
    points = (low_discrepancy(len(low), n) + shift[:, None]) % 1.0
    q = low[:, None] + (high - low)[:, None] * points
    scalars = tuple(Arm.of(robot).chain.scalars(q))
    source = f"{n} configuration{'s' * (n != 1)} spread evenly over the joint ranges (seed {seed})"
    return Configurations(q, scalars, None, source, (*notes, *chosen))


def _nominal(robot: Robot) -> Model:
    """Without effects: they change a covariance in second order only."""
    return Model.of(dataclasses.replace(robot, effects=()))


def _ranges(robot: Robot) -> tuple[Array, Array, list[str]]:
    endless = [joint.name for joint in robot.variables if joint.limits is None and joint.type == "revolute"]
    problems = [
        Problem(
            f"the slide {joint.name} has no limits to spread configurations over",
            fix="give it limits, or give the configurations by --poses",
        )
        for joint in robot.variables
        if joint.limits is None and joint.type == "prismatic"
    ]
    if problems:
        raise InputError(problems)
    pairs = [joint.limits or (-np.pi, np.pi) for joint in robot.variables]
    low, high = np.array(pairs, dtype=float).T
    return low, high, [f"{_listed(endless)} without limits: a whole turn was taken"] if endless else []


def _with_target(robot: Robot, target: str | None) -> tuple[Robot, tuple[str, ...]]:
    if not robot.targets:
        if target is not None:
            raise UsageError(f"the robot file names no targets, so there is no {target!r}")
        return robot, ()
    name = target if target is not None else next(iter(robot.targets))
    if name not in robot.targets:
        raise UsageError(f"no target {name!r}; the robot file has {', '.join(robot.targets)}")
    chosen = dataclasses.replace(robot, tool=robot.targets[name], targets={})
    several = len(robot.targets) > 1 and target is None
    note = (f"predicted for the target {name}, the first of {len(robot.targets)}; --target chooses another",)
    return chosen, note if several else ()


def _listed(names: Sequence[str]) -> str:
    return f"joint{'s' * (len(names) != 1)} {', '.join(names)}"
