"""Model of an arm with known and free effects, and its prediction of measured poses.

:meth:`Model.bind` evaluates every regressor of a :class:`Model` for given poses; the resulting :class:`BoundModel`
predicts and linearises. With all coefficients zero it predicts the nominal chain, bit for bit.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from robacc.chain import TOOL, Scalar
from robacc.effects.base import Effect, Term, commanded
from robacc.effects.beyond_range import faded, held_at_ends
from robacc.effects.specification import Known, known_effects
from robacc.effects.validity import Validity, united
from robacc.errors import UsageError
from robacc.geometry import Poses
from robacc.measurements import Measurements
from robacc.modelling.bound import BoundModel
from robacc.robots.arm import Arm
from robacc.robots.description import Robot


@dataclass(frozen=True)
class Model:
    """Arm, its known effects (with values), and the free effects to be fitted."""

    arm: Arm
    known: tuple[Known, ...] = ()
    free: tuple[Effect, ...] = ()

    @classmethod
    def of(cls, robot: Robot, free: Sequence[Effect] = ()) -> Model:
        """Return the model that a robot file describes, with ``free`` effects added.

        Raises:
            InputError: The ``effects:`` of the file cannot be read.
        """
        return cls(Arm.of(robot), known_effects(robot), tuple(free))

    def with_free(self, *effects: Effect) -> Model:
        """Return the model with more free effects."""
        return dataclasses.replace(self, free=(*self.free, *effects))

    def bind(self, data: Measurements, validity: Sequence[Validity] | None = None, *, fades: bool = True) -> BoundModel:
        """Evaluate every regressor for these poses.

        A known effect is held at the ends of its validity range, or fades beyond it. A free one does so only
        if ``validity`` gives the range that each was fitted on; a known effect that is free too then has the range of
        both. Without ``fades`` no free effect fades: its coefficients' uncertainty does not.

        Raises:
            UsageError: The poses lack a column that an effect needs, or do not fit the arm.
        """
        q = commanded(data, "a prediction from the robot")
        if q.shape[0] != self.arm.chain.n_joints:
            raise UsageError(f"the robot has {self.arm.chain.n_joints} joints, but the poses have {q.shape[0]}")
        fixed: list[Term] = []
        values: list[float] = []
        for known in self.known:
            limit = self._range_of(known, validity)
            terms = faded(known.effect, self.arm, held_at_ends(known.effect, self.arm, data, limit), limit)
            fixed.extend(terms)
            values.extend(known.values.get(term.name, 0.0) for term in terms)
        limits = validity if validity is not None else ({},) * len(self.free)
        free = [
            faded(effect, self.arm, held_at_ends(effect, self.arm, data, limit), limit if fades else {})
            for effect, limit in zip(self.free, limits, strict=True)
        ]
        nominal = _with_targets(self.arm, self.arm.chain.scalars(q), data)
        return BoundModel(
            self.arm,
            data.n,
            tuple(nominal),
            tuple(fixed),
            np.array(values),
            tuple(term for terms in free for term in terms),
            tuple(i for i, terms in enumerate(free) for _ in terms),
        )

    def _range_of(self, known: Known, validity: Sequence[Validity] | None) -> Validity:
        """Return the ranges beyond which a known effect is held or fades; empty for one that is fitted."""
        number = next((i for i, effect in enumerate(self.free) if effect.key() == known.effect.key()), None)
        if number is None:
            return known.validity
        return {} if validity is None else united(known.validity, validity[number])


def predict(robot: Robot, data: Measurements) -> Poses:
    """Predict the target poses ``(N)`` at the commanded joints, effects of the robot file included."""
    bound = Model.of(robot).bind(data)
    return bound.poses(np.zeros(0))


def _with_targets(arm: Arm, scalars: list[Scalar], data: Measurements) -> list[Scalar]:
    """Replace the tool by the measured target of each row."""
    targets = arm.robot.targets
    if not targets:
        return scalars
    if data.target is None:
        if len(targets) > 1:
            raise UsageError(f"the robot has the targets {', '.join(targets)}; add a column target to the poses")
        chosen = np.full(data.n, next(iter(targets)))
    else:
        chosen = data.target
    for axis, (place, turn) in enumerate((("x", "roll"), ("y", "pitch"), ("z", "yaw"))):
        for label, values in (
            (place, {name: frame.xyz[axis] for name, frame in targets.items()}),
            (turn, {name: frame.rpy[axis] for name, frame in targets.items()}),
        ):
            column = np.zeros(data.n)
            for name, value in values.items():
                column[chosen == name] = value
            scalars[arm.chain.index(TOOL, label)] = column
    return scalars
