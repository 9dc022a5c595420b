"""What the reader of a pose file knows of the robot that the poses are of."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

from robacc.geometry import Array
from robacc.poses.columns import BranchColumn

JointLimits = Sequence[tuple[float, float] | None]
"""Lowest and highest value of each joint, rad or m; None for a joint without limits."""
OrientationAt = Callable[[Array], Array]
"""Nominal orientations ``(3, 3, N)`` of the robot at joint variables ``(J, N)``."""


@dataclass(frozen=True, slots=True)
class KnownRobot:
    """Names, limits and targets of a robot, which the columns of its poses are checked against."""

    joint_names: Sequence[str] | None = None
    """Joints in chain order; their names stand for ``q1 … qN``. None: no robot is known."""
    joint_types: Sequence[str] | None = None
    """``revolute`` or ``prismatic`` of each joint; None: a joint's unit may be an angle or a length."""
    limits: JointLimits | None = None
    """Limits of each joint; None: unknown."""
    target_names: Sequence[str] | Literal["any"] | None = None
    """Targets of the robot file, empty for a robot with one tool; None: no robot is known, and any name is valid.
    ``any``: several targets are valid although the robot has one tool, as columns ``x1 … z2`` too."""
    branches: Sequence[BranchColumn] = ()
    """Joints outside the chain that move mass; each stands at its position where it has no column."""
    outside: Mapping[str, str] = field(default_factory=dict)
    """Joints outside the chain that a joint variable follows, and the rule by which it does."""
    orientation_at: OrientationAt | None = None
    """Nominal orientations of the robot, which show the convention of ambiguous angles."""

    @property
    def targets(self) -> tuple[str, ...]:
        """Names of the targets of the robot file; empty where it has one tool, or no robot is known."""
        return () if self.target_names is None or self.target_names == "any" else tuple(self.target_names)

    @property
    def valid_targets(self) -> tuple[str, ...] | None:
        """Names that the column ``target`` may have; None: any."""
        return None if self.target_names is None or self.target_names == "any" else self.targets

    @property
    def targets_in_columns(self) -> tuple[str, ...] | None:
        """Targets that columns ``x1 … z2`` may be of; None: any."""
        return None if self.target_names == "any" else self.targets


UNKNOWN_ROBOT = KnownRobot()
"""No robot is known."""
