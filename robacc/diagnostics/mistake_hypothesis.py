"""Hypothesis on mistakes in the data, and the choice of the simplest that explains them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from robacc.diagnostics.joint_changes import JointChange, reversed_signs
from robacc.diagnostics.measured_changes import MeasuredPoses
from robacc.diagnostics.mistake import Mistake
from robacc.diagnostics.screening import Screen
from robacc.robots.description import Robot

_SAME = 1.5
"""Ratio of errors up to which two hypotheses are not distinguishable."""
_MOST_ALTERNATIVES = 3
_MORE_MISTAKES = 2
"""Mistakes that an alternative has at most beyond those of the simplest hypothesis."""


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """Mistakes that are undone together, and the registered error that remains."""

    robot: Robot
    other_convention: bool
    measured: MeasuredPoses
    changes: tuple[JointChange, ...]
    total: float
    """Position error over the spread of the positions, plus orientation error in rad."""
    rank: float
    """The same, tolerant of orientations that are wrong in themselves."""
    position: float
    """Median position error, m."""
    orientation: float | None
    """Median orientation error, rad."""

    @property
    def complexity(self) -> int:
        """Return the number of mistakes."""
        joints = sum(change.complexity for change in self.changes)
        return joints + self.measured.complexity + self.other_convention

    @property
    def signs(self) -> frozenset[str]:
        """Return the joints whose sign is reversed."""
        signs: frozenset[str] = frozenset()
        for change in self.changes:
            signs ^= change.signs
        return signs

    @property
    def _merged(self) -> list[JointChange]:
        """Return the changes with all signs as one."""
        names = self.robot.variable_names
        reversed_joints = [i for i, name in enumerate(names) if name in self.signs]
        signs = [reversed_signs(names, reversed_joints)] if reversed_joints else []
        return [*signs, *(change for change in self.changes if not change.signs)]

    @property
    def only_signs(self) -> bool:
        """Return whether all mistakes are signs of joints."""
        return not self.measured.texts and not self.other_convention and all(item.signs for item in self.changes)

    @property
    def texts(self) -> tuple[str, ...]:
        """Return what is wrong, by mistake."""
        table = (f"the table seems to be of the {self.robot.convention} Denavit-Hartenberg convention",)
        return (
            *self.measured.texts,
            *(table if self.other_convention else ()),
            *(change.text for change in self._merged),
        )

    @property
    def fixes(self) -> tuple[str, ...]:
        """Return how to correct it, by mistake."""
        table = (f"set convention: {self.robot.convention}",)
        return (
            *self.measured.fixes,
            *(table if self.other_convention else ()),
            *(change.fix for change in self._merged),
        )


def hypothesis(
    robot: Robot,
    measured: MeasuredPoses,
    changes: tuple[JointChange, ...],
    result: Screen,
    i: int,
    other_convention: bool,
) -> Hypothesis:
    """Return hypothesis ``i`` of a screening."""
    return Hypothesis(
        robot,
        other_convention,
        measured,
        changes,
        float(result.total[i]),
        float(result.rank[i]),
        float(result.joint_position[i]),
        None if result.orientation is None else float(result.orientation[i]),
    )


def simplest(pool: Sequence[Hypothesis], null: Hypothesis, improvement: float) -> Mistake | None:
    """Return the simplest of the hypotheses that explain the error; None if none does.

    Args:
        pool: Hypotheses.
        null: The data as they are.
        improvement: Factor by which a correction has to reduce the error.
    """
    least = min(item.total for item in pool)
    if least * improvement >= null.total:
        return None
    limit = min(_SAME * least, null.total / improvement)
    equal = sorted(
        (item for item in pool if item.total <= limit and item.texts), key=lambda item: (item.complexity, item.total)
    )
    best = equal[0]
    alternatives: list[str] = []
    unseen: set[str] = set()
    for item in equal[1:]:
        if item.only_signs and best.only_signs and item.signs > best.signs:
            unseen |= item.signs - best.signs
        elif item.complexity <= best.complexity + _MORE_MISTAKES and not set(best.texts) <= set(item.texts):
            alternatives.append(" and ".join(item.texts))
    return Mistake(
        "; ".join(best.texts),
        "; ".join(dict.fromkeys(best.fixes)),
        null.position,
        best.position,
        null.orientation,
        best.orientation,
        tuple(dict.fromkeys(alternatives))[:_MOST_ALTERNATIVES],
        tuple(sorted(unseen)),
    )
