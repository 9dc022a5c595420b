"""Demands on a campaign, and its plan: the poses in their order, and the expected result."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from robacc.errors import UsageError
from robacc.fitting.parameters import Correlation
from robacc.geometry import Array
from robacc.measurements import Measurements, motion_between_rows
from robacc.planning.acceptance import Demand, NeededPoses
from robacc.planning.branches_at_rest import branches_at_rest
from robacc.planning.candidates import CandidatePoses
from robacc.planning.constraints import Constraints, SafetyBox
from robacc.planning.design import Criterion
from robacc.planning.detectability import Detectability
from robacc.planning.expected import (
    ExpectedAccuracy,
    ExpectedCoefficient,
    Sufficiency,
    Worth,
)
from robacc.planning.linear_model import (
    ExpectedNoise,
)
from robacc.planning.power_design import ExpectedPower
from robacc.planning.route import Route
from robacc.robots.description import Robot

Purpose = Literal["calibrate", "trace", "acceptance", "health"]
PURPOSES: tuple[Purpose, ...] = ("calibrate", "trace", "acceptance", "health")
DEFAULT_FIT: dict[Purpose, str] = {
    "calibrate": "base_frame,tool_frame,joint_offset,link_geometry",
    "trace": "base_frame,tool_frame,joint_offset,link_geometry",
    "acceptance": "base_frame,tool_frame",
    "health": "base_frame,joint_offset",
}
DEFAULT_POSES: dict[Purpose, int] = {"calibrate": 30, "trace": 60, "acceptance": 60, "health": 8}
TYPICAL_NOISE = 2e-5
"""m; a laser tracker at some metres."""
TYPICAL_REPEATABILITY = 2e-5
"""m along each axis; an arm with a stated pose repeatability (mean + 3 sd of the distance) of about 0.08 mm."""


@dataclass(frozen=True, slots=True)
class CampaignSettings:
    """Demands on a plan. SI units."""

    purpose: Purpose
    poses: int | None = None
    """Number of different poses; None for the default of the purpose."""
    criterion: Criterion = "I"
    fit: str = ""
    """Effects that are free in the fit; empty for the default of the purpose."""
    constraints: Constraints = field(default_factory=Constraints)
    region: SafetyBox | None = None
    """Box in the base frame where the accuracy matters; None: everywhere the robot may be."""
    noise: float | None = None
    noise_orientation: float | None = None
    """rad; None where orientation is not measured."""
    repeatability: float | None = None
    """m along each axis."""
    unexplained: float = 0.0
    check_every: int = 10
    """Visits between drift checks; 0 for none."""
    repeats: int | None = None
    """Poses visited a second time; None for a tenth of the poses."""
    validation: int = 0
    """Poses of the validation set."""
    target: float | None = None
    """Error after calibration that is good enough, m rms; None: until more poses gain little."""
    demands: tuple[Demand, ...] = ()
    expected: float | None = None
    """Expected true value of the statistic, m, for the number of acceptance poses."""
    n_candidates: int = 5000
    payloads: tuple[float, ...] = ()
    """kg; each pose has one of them."""
    seed: int = 0


@dataclass(frozen=True, slots=True)
class PayloadBlock:
    """Visits in a row with the same payload."""

    payload: float
    """kg"""
    first: int
    """Number of the first visit, from 1."""
    n_visits: int
    n_poses: int
    """Number of different poses."""


@dataclass(frozen=True, slots=True)
class CampaignPlan:
    """Planned poses in their order, and the expected result."""

    robot: Robot
    settings: CampaignSettings
    candidates: CandidatePoses
    chosen: NDArray[np.int64]
    """Numbers of the chosen candidates; pose k of the route is ``chosen[k]``."""
    route: Route
    ids: tuple[str, ...]
    """Name of each pose of the route."""
    validation: Array | None
    """``(J, V)`` joint variables of the validation poses, in the order of their visits."""
    validation_payload: Array | None
    """``(V,)`` kg"""
    noise: ExpectedNoise
    repeatability: float
    """At the target along each axis, m rms over the task."""
    coefficients: tuple[ExpectedCoefficient, ...] = ()
    correlations: tuple[Correlation, ...] = ()
    accuracy: ExpectedAccuracy | None = None
    worth: Worth | None = None
    detectability: Detectability | None = None
    needed: tuple[NeededPoses, ...] = ()
    sufficiency: Sufficiency | None = None
    power: ExpectedPower | None = None
    """Mean over the catalogue at the usual sizes, before repeats and checks; None unless the purpose is a trace."""
    random_power: ExpectedPower | None = None
    """The same of random candidates in the same number."""
    warnings: tuple[str, ...] = ()

    @property
    def q(self) -> Array:
        """``(J, V)`` joint variables of all visits, in order."""
        return self.candidates.q[:, self.chosen[self.route.visits]]

    @property
    def payload_kg(self) -> Array | None:
        """``(V,)`` payload of all visits; None where no payload was given."""
        payload = self.candidates.payload
        return None if payload is None else payload[self.chosen[self.route.visits]]

    @property
    def payload_blocks(self) -> tuple[PayloadBlock, ...]:
        """Visits in a row with one payload, in order; empty where no payload was given."""
        if self.payload_kg is None:
            return ()
        starts = np.flatnonzero(np.diff(self.payload_kg, prepend=np.nan) != 0)
        ends = [*starts[1:], self.payload_kg.size]
        return tuple(
            PayloadBlock(
                float(self.payload_kg[start]),
                int(start) + 1,
                int(end - start),
                np.unique(self.route.visits[start:end]).size,
            )
            for start, end in zip(starts, ends, strict=True)
        )

    def visits(self) -> Measurements:
        """Return the visits as poses to measure, with direction and speed of approach."""
        q = self.q
        direction, speed = motion_between_rows(q)
        numbers = self.route.visits
        branches, branch_names = branches_at_rest(self.robot, q.shape[1])
        cycle = [str(int(np.count_nonzero(numbers[: i + 1] == number))) for i, number in enumerate(numbers)]
        return Measurements(
            position=np.zeros((3, q.shape[1])),
            q=q,
            pose=np.array([self.ids[number] for number in numbers]),
            cycle=np.array(cycle),
            payload=self.payload_kg,
            branches=branches,
            branch_names=branch_names,
            direction=direction,
            speed=speed,
            ordered=True,
        )

    def validation_poses(self) -> Measurements:
        """Return the validation poses in the order of their visits.

        Raises:
            UsageError: The plan has none.
        """
        if self.validation is None:
            raise UsageError("the plan has no validation poses; give their number as `validation`")
        n = self.validation.shape[1]
        ids = np.array([f"V{i + 1:0{len(str(n))}d}" for i in range(n)])
        direction, speed = motion_between_rows(self.validation)
        branches, branch_names = branches_at_rest(self.robot, n)
        return Measurements(
            position=np.zeros((3, n)),
            q=self.validation,
            pose=ids,
            payload=self.validation_payload,
            branches=branches,
            branch_names=branch_names,
            direction=direction,
            speed=speed,
            ordered=True,
        )
