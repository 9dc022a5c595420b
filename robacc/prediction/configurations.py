"""Configurations for the prediction: the poses of a file, or samples spread evenly over the joints' ranges."""

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
    """Configurations of one arm, N of them."""

    q: Array
    """``(J, N)`` joint variables, rad or m."""
    scalars: tuple[Scalar, ...]
    """Nominal scalars of the chain at each configuration, with the target measured there."""
    labels: tuple[str, ...] | None
    """``(N,)`` label of each: its line in the file; None: its number."""
    source: str
    """Description of their source as text."""
    notes: tuple[str, ...] = ()

    @property
    def n(self) -> int:
        """Number of configurations."""
        return int(self.q.shape[1])

    def label(self, i: int) -> str:
        """Return the label of configuration ``i``."""
        return self.labels[i] if self.labels is not None else f"sample {i + 1}"


def configurations_of(robot: Robot, data: Measurements) -> Configurations:
    """Return the commanded configurations of measured or planned poses, each with its target.

    Raises:
        InputError: There are no poses or no joint variables.
        UsageError: The joint variables do not fit the robot.
    """
    if data.n == 0:
        raise InputError(Problem("has no poses to predict the accuracy at", data.source))
    if data.q is None:
        fix = "add q1, q2, …"
        raise InputError(Problem("has no joint columns: the prediction needs the joint values", data.source, fix=fix))
    bound_model = _nominal_model(robot).bind(data)
    labels = tuple(data.place(i) for i in range(data.n))
    return Configurations(
        data.q, bound_model.nominal, labels, f"the {data.n} pose{'s' * (data.n != 1)} of {data.source or 'the data'}"
    )


def sampled_configurations(robot: Robot, n: int, seed: int = 0, target: str | None = None) -> Configurations:
    """Return ``n`` configurations spread evenly over the joints' ranges; a revolute joint without limits turns fully.

    A low-discrepancy sequence (Richtmyer's) shifted by a random vector, modulo the unit cube: R. Cranley and
    T. N. L. Patterson, "Randomization of number theoretic methods for multiple integration", SIAM J. Numer. Anal. 13
    (1976) 904-914.

    Args:
        robot: The arm.
        n: Number of configurations.
        seed: Seed of the shift.
        target: Name of the target if the robot has several; None: the first.

    Raises:
        UsageError: ``n`` is less than one, or the robot has no such target.
        InputError: A prismatic joint has no limits.
    """
    if n < 1:
        raise UsageError(f"`samples` is at least 1, not {n}")
    low, high, notes = _ranges(robot)
    robot, target_notes = _with_target(robot, target)
    shift = np.random.default_rng(seed).random(len(low))
    points = (low_discrepancy(len(low), n) + shift[:, None]) % 1.0
    q = low[:, None] + (high - low)[:, None] * points
    scalars = tuple(Arm.of(robot).chain.scalars(q))
    source = f"{n} configuration{'s' * (n != 1)} spread evenly over the joint ranges (seed {seed})"
    return Configurations(q, scalars, None, source, (*notes, *target_notes))


def _nominal_model(robot: Robot) -> Model:
    """Return the model without effects, which change a covariance in second order only."""
    return Model.of(dataclasses.replace(robot, effects=()))


def _ranges(robot: Robot) -> tuple[Array, Array, list[str]]:
    endless = [joint.name for joint in robot.variables if joint.limits is None and joint.type == "revolute"]
    problems = [
        Problem(
            f"the prismatic joint {joint.name} has no limits to spread configurations over",
            fix="give it limits, or give the configurations with `poses`",
        )
        for joint in robot.variables
        if joint.limits is None and joint.type == "prismatic"
    ]
    if problems:
        raise InputError(problems)
    pairs = [joint.limits or (-np.pi, np.pi) for joint in robot.variables]
    low, high = np.array(pairs, dtype=float).T
    return low, high, [f"{_joint_list(endless)} without limits: sampled over a full turn"] if endless else []


def _with_target(robot: Robot, target: str | None) -> tuple[Robot, tuple[str, ...]]:
    if not robot.targets:
        if target is not None:
            raise UsageError(f"no target {target!r}; the robot file has no targets")
        return robot, ()
    name = target if target is not None else next(iter(robot.targets))
    if name not in robot.targets:
        raise UsageError(f"no target {name!r}; the robot file has {', '.join(robot.targets)}")
    single_target = dataclasses.replace(robot, tool=robot.targets[name], targets={})
    ambiguous = len(robot.targets) > 1 and target is None
    note = (f"predicted for the target {name}, the first of {len(robot.targets)}; `target` selects another",)
    return single_target, note if ambiguous else ()


def _joint_list(names: Sequence[str]) -> str:
    return f"joint{'s' * (len(names) != 1)} {', '.join(names)}"
