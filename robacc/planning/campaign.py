"""Demands on a campaign, the number of poses that decides a limit, and the plan with its expected result."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from robacc.errors import UsageError
from robacc.fitting.parameters import Correlation
from robacc.geometry import Array
from robacc.measurements import Measurements, motion_between_rows
from robacc.planning.candidates import CandidatePoses, Constraints, SafetyBox
from robacc.planning.collisions import branches_at_rest
from robacc.planning.design import Criterion
from robacc.planning.expected import ExpectedAccuracy, ExpectedCoefficient, Sufficiency, Worth
from robacc.planning.linear_model import ExpectedNoise
from robacc.planning.power import Detectability, ExpectedPower
from robacc.planning.route import Route
from robacc.robots.description import Robot
from robacc.statistics.confidence_curves import smallest_sufficient
from robacc.statistics.distributions import chi2_cdf, chi2_quantile

# Plans with fewer measured coordinates than the fit has coefficients.


def too_few_warning(n_poses: int, n_known: int, components: int, n_coefficients: int) -> tuple[str, ...]:
    """Return a warning about a plan that cannot determine its fit; nothing if it can.

    Args:
        n_poses: Planned poses.
        n_known: Poses that are measured already.
        components: Measured coordinates of a pose: 3 of a position, 6 with the orientation.
        n_coefficients: Coefficients that the feasible poses identify.
    """
    measured = components * (n_poses + n_known)
    if measured >= n_coefficients:
        return ()
    enough = math.ceil(n_coefficients / components) - n_known
    return (
        f"{n_poses + n_known} pose{'s' * (n_poses + n_known != 1)} measure {measured} coordinates, fewer than the "
        f"{n_coefficients} coefficients of the fit: the fit would stay near the nominal model in some directions and "
        f"be arbitrary in others; plan at least {enough} poses, and more for a check on held-out poses",
    )


# Number of poses that decides a limit, and poses spread over the task's region.
#
# The squared error length of n poses is taken as a chi-square with n degrees of freedom, as for errors along one
# direction; errors in three directions need fewer. A true value of r times the limit L is confirmed where the upper
# bound s sqrt(n / chi2(1 - c; n)) of the estimate s is within L, so with probability P(chi2_n <= chi2(1 - c; n) /
# r^2). A 95th percentile is bounded by order statistics: their variance is larger, and they need ln(1 - c) / ln 0.95
# poses at least (S. S. Wilks, "Determination of sample sizes for setting tolerance limits", Ann. Math. Statist. 12,
# 1941).

AcceptanceStatistic = Literal["rms", "mean_error", "p95", "max"]

ASSURANCE = 0.9
"""Probability that the planned number of poses decides."""
MOST_POSES = 2000
RATIOS = (0.5, 0.6, 0.7, 0.8, 0.9)
EXPECTED_RATIO = 0.8
"""True value over the limit for which the number is planned, if no expected value is given."""
_REPRESENTED = 500
"""Poses, drawn at random, that stand for all in the mean distance."""
_PERCENTILE_COST = 2.4
"""Variance of order statistics relative to that of a Gaussian's radius, as in the decision on a gate."""


@dataclass(frozen=True, slots=True)
class Demand:
    """One limit that the measurement is to decide."""

    label: str
    statistic: AcceptanceStatistic
    limit: float
    """m"""
    confidence: float
    share: float = 0.95
    """Share of all poses that must lie within the limit of a largest error."""


@dataclass(frozen=True, slots=True)
class NeededPoses:
    """Numbers of poses that decide one demand."""

    demand: Demand
    ratio: float
    """True value over the limit that the number is for."""
    poses: int | None
    """None where more than :data:`MOST_POSES` are needed."""
    by_ratio: tuple[tuple[float, int | None], ...]


def needed(demand: Demand, expected: float | None) -> NeededPoses:
    """Return the number of poses that decides ``demand`` with probability 0.9 if the true value is ``expected``."""
    ratio = EXPECTED_RATIO if expected is None else expected / demand.limit
    by_ratio = tuple((each, poses_for(demand, each)) for each in RATIOS)
    return NeededPoses(demand, ratio, poses_for(demand, ratio), by_ratio)


def poses_for(demand: Demand, ratio: float) -> int | None:
    """Return the number of poses that decides if the true value is ``ratio`` times the limit, below or above it."""
    fewest = 3
    if demand.statistic == "p95":
        fewest = math.ceil(math.log(1.0 - demand.confidence) / math.log(0.95))
    if demand.statistic == "max":
        return math.ceil(math.log(1.0 - demand.confidence) / math.log(demand.share)) if ratio <= 1.0 else fewest
    enough = smallest_sufficient(lambda n: _decides(n, ratio, demand.confidence), 4, most=MOST_POSES)
    if enough is None:
        return None
    cost = _PERCENTILE_COST if demand.statistic == "p95" else 1.0
    number = max(math.ceil(cost * enough), fewest)
    return number if number <= MOST_POSES else None


def _decides(n: int, ratio: float, confidence: float) -> bool:
    if ratio < 1.0:
        return chi2_cdf(chi2_quantile(1.0 - confidence, n) / ratio**2, n) >= ASSURANCE
    return 1.0 - chi2_cdf(chi2_quantile(confidence, n) / ratio**2, n) >= ASSURANCE


def spread_poses(position: Array, q: Array, count: int, seed: int) -> NDArray[np.int64]:
    """Return ``count`` poses that represent all, in position ``(3, N)`` and in joints ``(J, N)``.

    Each pose in turn is the one that lowers most the energy distance between the chosen poses and all: the mean
    distance to all poses less the mean distance to those chosen (S. Mak and V. R. Joseph, "Support points", Annals of
    Statistics 46, 2018). Distances of positions and of joints, each over its mean, are added. ``seed`` draws the poses
    that stand for all where there are many.
    """
    n = q.shape[1]
    if count >= n:
        return np.arange(n)
    sample = np.random.default_rng([seed, 3]).permutation(n)[:_REPRESENTED]
    spaces = []
    mean_distance = np.zeros(n)
    for space in (position, q):
        values = space / np.maximum(np.std(space, axis=1, keepdims=True), 1e-9)
        distance = np.mean([_distances(values, values[:, at]) for at in sample], axis=0)
        scale = float(distance.mean()) or 1.0
        spaces.append(values / scale)
        mean_distance += distance / scale
    to_chosen, chosen = np.zeros(n), np.zeros(count, dtype=np.int64)
    for i in range(count):
        score = mean_distance - to_chosen / (i + 1)
        score[chosen[:i]] = np.inf
        chosen[i] = np.argmin(score)
        to_chosen += sum(_distances(values, values[:, chosen[i]]) for values in spaces)
    return chosen


def _distances(values: Array, point: Array) -> Array:
    result: Array = np.linalg.norm(values - point[:, None], axis=0)
    return result


Purpose = Literal["calibrate", "trace", "acceptance", "health"]
PURPOSES: tuple[Purpose, ...] = ("calibrate", "trace", "acceptance", "health")
DEFAULT_FIT: dict[Purpose, str] = {
    "calibrate": "base_frame,tool_frame,joint_offset,link_geometry",
    "trace": "base_frame,tool_frame,joint_offset,link_geometry",
    "acceptance": "base_frame,tool_frame",
    "health": "base_frame,joint_offset",
}
DEFAULT_POSES: dict[Purpose, int] = {"calibrate": 30, "trace": 60, "acceptance": 60, "health": 8}
DEFAULT_CANDIDATES = 5000
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
    n_candidates: int = DEFAULT_CANDIDATES
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
        numbers = self.route.visits
        cycle = [str(int(np.count_nonzero(numbers[: i + 1] == number))) for i, number in enumerate(numbers)]
        poses = self._to_measure(self.q, np.array([self.ids[number] for number in numbers]), self.payload_kg)
        return dataclasses.replace(poses, cycle=np.array(cycle))

    def validation_poses(self) -> Measurements:
        """Return the validation poses in the order of their visits.

        Raises:
            UsageError: The plan has none.
        """
        if self.validation is None:
            raise UsageError("the plan has no validation poses; give their number as `validation`")
        n = self.validation.shape[1]
        ids = np.array([f"V{i + 1:0{len(str(n))}d}" for i in range(n)])
        return self._to_measure(self.validation, ids, self.validation_payload)

    def _to_measure(self, q: Array, ids: NDArray[np.str_], payload: Array | None) -> Measurements:
        """Return unmeasured poses at ``q`` ``(J, n)`` in their order."""
        direction, speed = motion_between_rows(q)
        branches, branch_names = branches_at_rest(self.robot, q.shape[1])
        return Measurements(
            position=np.zeros((3, q.shape[1])),
            q=q,
            pose=ids,
            payload=payload,
            branches=branches,
            branch_names=branch_names,
            direction=direction,
            speed=speed,
            ordered=True,
        )
