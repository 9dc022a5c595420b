"""Plan of a campaign: candidates, choice, order of the visits, and the expected result."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from robacc.effects.base import Effect
from robacc.effects.request import build, parse_requests
from robacc.effects.specification import every_column
from robacc.errors import UsageError
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.planning.acceptance import MOST_POSES, NeededPoses, needed, spread_poses
from robacc.planning.campaign import (
    DEFAULT_FIT,
    DEFAULT_POSES,
    TYPICAL_NOISE,
    TYPICAL_REPEATABILITY,
    CampaignPlan,
    CampaignSettings,
    Sufficiency,
)
from robacc.planning.candidates import given_candidates, sampled_candidates, task_joints
from robacc.planning.design import DesignProblem, choose, information_of
from robacc.planning.detectability import detectability
from robacc.planning.expected import (
    BATCH,
    ENOUGH_GAIN,
    Expectation,
    Worth,
    expected_accuracy,
    expected_coefficients,
    expected_correlations,
    worth_of,
)
from robacc.planning.linear_model import (
    ExpectedNoise,
    PlannedCoefficients,
    candidate_rows,
    coefficients,
    joint_repeatability,
    planned_data,
    region_rows,
    repeatability_at_target,
    whitened_columns,
)
from robacc.planning.power_design import PowerProblem, choose_for_power, expected_power, power_problem, random_power
from robacc.planning.route import Route, route
from robacc.robots.description import Robot

_TIME_STEP = 20.0
"""s from visit to visit, for the detection limit of a drift; the unit of time cancels."""


def plan_campaign(
    robot: Robot,
    settings: CampaignSettings,
    *,
    candidates: Measurements | None = None,
    task: Measurements | None = None,
    already: Measurements | None = None,
    known_noise: ExpectedNoise | None = None,
) -> CampaignPlan:
    """Return the plan of a measurement of ``robot``.

    Args:
        robot: The robot, with the effects that are known.
        settings: Purpose, number, constraints and noise.
        candidates: Poses to choose from; sampled within the joint limits if None.
        task: Poses where the accuracy matters, in place of a region.
        already: Poses measured already.
        known_noise: Noise from a calibrated model; the settings' values replace its values.

    Raises:
        UsageError: A demand cannot be met, or an effect cannot be fitted to this robot.
        InputError: A prismatic joint has no limits.
    """
    return _Planner(robot, settings, candidates, task, already, known_noise).plan()


class _Planner:
    """One planning: model, candidates and noise, made once."""

    def __init__(
        self,
        robot: Robot,
        settings: CampaignSettings,
        candidates: Measurements | None,
        task: Measurements | None,
        already: Measurements | None,
        known_noise: ExpectedNoise | None,
    ) -> None:
        self.robot, self.settings, self.already = robot, settings, already
        self.model = Model.of(robot, free_effects(robot, settings.fit or DEFAULT_FIT[settings.purpose]))
        constraints, seed = settings.constraints, settings.seed
        if candidates is None:
            self.candidates = sampled_candidates(self.model, constraints, settings.n_candidates, seed)
        else:
            self.candidates = given_candidates(self.model, constraints, candidates)
        if task is None:
            self.task = task_joints(self.model, constraints, settings.region, seed)
        elif task.q is None:
            raise UsageError("the poses of the task have no joint columns")
        else:
            self.task = task.q
        self.noise = self._noise(known_noise)
        self.repeatability = repeatability_at_target(self.model, self.task, self.noise.joints)

    def _noise(self, known: ExpectedNoise | None) -> ExpectedNoise:
        settings = self.settings
        sources = []
        if settings.noise is not None or known is None:
            position = TYPICAL_NOISE if settings.noise is None else settings.noise
            sources.append("typical noise" if settings.noise is None else "given noise")
        else:
            position = known.position
            sources.append("noise of the model file")
        if settings.repeatability is not None or known is None or not known.joints.any():
            size = TYPICAL_REPEATABILITY if settings.repeatability is None else settings.repeatability
            joints = joint_repeatability(self.model, self.task, size)
            kind = "typical" if settings.repeatability is None else "given"
            sources.append(f"{kind} repeatability")
        else:
            joints = known.joints
            sources.append("repeatability of the model file")
        unexplained = settings.unexplained or (0.0 if known is None else known.unexplained)
        if position == 0.0 and unexplained == 0.0:
            raise UsageError("`noise` is zero; give the standard deviation of the instrument along each axis")
        return ExpectedNoise(position, settings.noise_orientation, joints, unexplained, ", ".join(sources))

    def plan(self) -> CampaignPlan:
        """Return the plan."""
        settings = self.settings
        demands = tuple(needed(demand, settings.expected) for demand in settings.demands)
        count = self._count(demands)
        rows = candidate_rows(self.model, self.candidates.q, self.noise)
        planned = coefficients(self.model, rows)
        rows = rows[:, :, planned.columns]
        region = region_rows(self.model, self.task)[:, :, planned.columns]
        information = self._information(planned)
        problem = self._problem(rows, region, planned, information)
        chosen = self._choose(problem, count)
        powers = None
        if isinstance(problem, PowerProblem):
            powers = expected_power(problem, chosen), random_power(problem, count, settings.seed)
        path = self._route(chosen)
        plan = CampaignPlan(
            self.robot,
            dataclasses.replace(settings, poses=count),
            self.candidates,
            chosen,
            path,
            self._ids(chosen),
            self._validation(),
            self.noise,
            self.repeatability,
            needed=demands,
            power=None if powers is None else powers[0],
            random_power=None if powers is None else powers[1],
        )
        return self._with_expectation(plan, rows, region, planned, information)

    def _count(self, demands: tuple[NeededPoses, ...]) -> int:
        settings = self.settings
        count = settings.poses
        if count is None and self.already is not None:
            count = BATCH
        if count is None and demands:
            numbers = [entry.poses for entry in demands]
            if None in numbers:
                entry = demands[numbers.index(None)]
                raise UsageError(
                    f"no number of poses up to {MOST_POSES} decides {entry.demand.label} if the true value is "
                    f"{entry.ratio:.2g} times the limit; give `expected` farther from the limit, or `poses`"
                )
            count = max(number for number in numbers if number is not None)
        count = count or DEFAULT_POSES[settings.purpose]
        if count > self.candidates.n:
            reasons = self.candidates.excluded
            most = f"; most of the others are excluded by: {reasons[0].reason}" if reasons else ""
            raise UsageError(f"{count} poses are planned, but only {self.candidates.n} candidates are feasible{most}")
        return count

    def _information(self, planned: PlannedCoefficients) -> Array:
        """Return ``(P, P)`` information of the poses measured already."""
        size = planned.columns.size
        if self.already is None:
            return np.zeros((size, size))
        columns = whitened_columns(self.model, _as_planned(self.already), self.noise)[:, planned.columns]
        return information_of(np.moveaxis(columns, 1, 2))

    def _problem(
        self, rows: Array, region: Array, planned: PlannedCoefficients, information: Array
    ) -> DesignProblem | PowerProblem:
        """Return the problem of choice, in units of the priors."""
        if self.settings.purpose == "trace":
            return power_problem(self.model, self.candidates.q, self.noise, self.already, self.settings.seed)
        scale = planned.prior_std
        scaled = information * scale[:, None] * scale + np.eye(scale.size)
        interest = None
        criterion = self.settings.criterion
        if self.settings.purpose == "health":
            criterion = "A"
            is_offset = np.array([name.startswith("joint_offset") for name in planned.names])
            interest = np.where(is_offset, np.square(scale), 0.0)
        return DesignProblem(rows * scale, scaled, region * scale, criterion, interest)

    def _choose(self, problem: DesignProblem | PowerProblem, count: int) -> NDArray[np.int64]:
        settings = self.settings
        if settings.purpose == "acceptance":
            allowed = np.arange(self.candidates.n)
            if settings.region is not None:
                allowed = np.flatnonzero(settings.region.contains(self.candidates.position))
            if allowed.size < count:
                raise UsageError(
                    f"{count} poses are planned, but only {allowed.size} feasible candidates lie in `region`; "
                    "give a larger region or more `candidates`"
                )
            position, q = self.candidates.position[:, allowed], self.candidates.q[:, allowed]
            return allowed[spread_poses(position, q, count, settings.seed)]
        if isinstance(problem, PowerProblem):
            return choose_for_power(problem, count, settings.seed)
        return choose(problem, count)

    def _route(self, chosen: NDArray[np.int64]) -> Route:
        settings, q = self.settings, self.candidates.q[:, chosen]
        check = None
        if settings.check_every and self.already is None and chosen.size > 2:
            middle = np.median(q, axis=1, keepdims=True)
            span = np.maximum(np.ptp(q, axis=1, keepdims=True), 1e-9)
            check = int(np.argmin(np.sum(np.square((q - middle) / span), axis=0)))
        default = chosen.size if settings.purpose == "health" else chosen.size // 10
        repeats = default if settings.repeats is None else settings.repeats
        if settings.repeats is None and self.already is not None:
            repeats = 0
        return route(q, repeats, check, max(settings.check_every, 1), settings.seed)

    def _ids(self, chosen: NDArray[np.int64]) -> tuple[str, ...]:
        if self.candidates.ids is not None:
            return tuple(str(name) for name in self.candidates.ids[chosen])
        first = 1 if self.already is None else int(self.already.groups().max(initial=-1)) + 2
        digits = len(str(first + chosen.size))
        return tuple(f"P{first + i:0{digits}d}" for i in range(chosen.size))

    def _validation(self) -> Array | None:
        settings = self.settings
        if not settings.validation:
            return None
        constraints = dataclasses.replace(settings.constraints, inside=settings.region or settings.constraints.inside)
        pool = sampled_candidates(self.model, constraints, 10 * settings.validation, settings.seed + 2)
        if pool.n < settings.validation:
            raise UsageError(f"only {pool.n} of {settings.validation} validation poses are feasible")
        q = pool.q[:, : settings.validation]
        return q[:, route(q, 0, None, 1, settings.seed).visits]

    def _with_expectation(
        self, plan: CampaignPlan, rows: Array, region: Array, planned: PlannedCoefficients, information: Array
    ) -> CampaignPlan:
        """Return the plan with what to expect from it."""
        settings = self.settings
        noise_at_target = np.hypot(self.repeatability, self.noise.unexplained)
        expectation = Expectation(rows, region, planned, information, float(np.sqrt(3.0)) * float(noise_at_target))
        # Repeats and checks are measurements too.
        visited = rows[:, plan.chosen[plan.route.visits]]
        covariance = expectation.covariance(visited)
        data = planned_visits(plan, self.already)
        accuracy = worth = None
        if settings.purpose == "calibrate":
            scale = planned.prior_std
            scaled = information * scale[:, None] * scale + np.eye(scale.size)
            problem = DesignProblem(rows * scale, scaled, region * scale, settings.criterion)
            accuracy = expected_accuracy(expectation, problem, plan.chosen, settings.seed)
            worth = self._worth(expectation, problem, plan.chosen, planned)
        return dataclasses.replace(
            plan,
            coefficients=expected_coefficients(planned, covariance),
            correlations=expected_correlations(planned, covariance),
            accuracy=accuracy,
            worth=worth,
            detectability=None if settings.purpose == "acceptance" else detectability(self.model, data, self.noise),
            sufficiency=None if self.already is None else self._sufficiency(expectation, plan),
        )

    def _worth(
        self, expectation: Expectation, problem: DesignProblem, chosen: NDArray[np.int64], planned: PlannedCoefficients
    ) -> Worth:
        """Compare as many measurements of new poses, of half as many poses twice, and of two readings of each."""
        count = chosen.size
        new = choose(problem, min(2 * count, self.candidates.n), exchanged=200, passes=1)
        repeated, readings = (
            candidate_rows(self.model, self.candidates.q[:, chosen], self.noise.reduced(*times))[:, :, planned.columns]
            for times in ((2, 1), (1, 2))
        )
        return worth_of(
            expectation.point(expectation.rows[:, new], new.size),
            expectation.point(repeated, count),
            expectation.point(readings, count),
        )

    def _sufficiency(self, expectation: Expectation, plan: CampaignPlan) -> Sufficiency:
        assert self.already is not None
        now = expectation.point(expectation.rows[:, :0], 0)
        later = expectation.point(expectation.rows[:, plan.chosen], plan.chosen.size)
        n, target = int(self.already.n), self.settings.target
        totals = tuple(None if point is None else point.total for point in (now, later))
        if now is None or later is None:
            return Sufficiency(n, False, "the poses so far do not identify all coefficients", *totals)
        if target is not None:
            enough = now.rms <= target
            why = f"the predicted error of {now.rms * 1e3:.3g} mm {'meets' if enough else 'exceeds'} the target"
            return Sufficiency(n, enough, why, *totals)
        gain = 1.0 - later.total / now.total
        enough = gain < ENOUGH_GAIN
        why = f"{plan.chosen.size} more poses reduce the predicted error by {100 * gain:.0f} %"
        return Sufficiency(n, enough, why, *totals)


def free_effects(robot: Robot, fit: str) -> tuple[Effect, ...]:
    """Return the effects of a list such as ``base_frame,joint_offset[j2]``.

    Raises:
        UsageError: One of them does not exist or cannot be fitted to the robot.
    """
    arm = Model.of(robot).arm
    return build(parse_requests(fit), arm, every_column(arm))


def planned_visits(plan: CampaignPlan, already: Measurements | None = None) -> Measurements:
    """Return the planned visits with every target and the time of each, after the poses measured already."""
    visits = plan.visits()
    start: Array = np.linspace(0.0, _TIME_STEP * (visits.n - 1), visits.n)
    timed = dataclasses.replace(visits, pose=None, cycle=None, time=start)
    data = planned_data(plan.robot, plan.q, timed)
    if already is None or already.q is None:
        return data
    earlier = _as_planned(already)
    motion = earlier.direction is not None and earlier.speed is not None
    zero = np.zeros_like(already.q)
    assert data.time is not None
    before: Array = np.linspace(-_TIME_STEP * earlier.n, -_TIME_STEP, earlier.n)
    time: Array = np.concatenate((before, data.time))
    return dataclasses.replace(
        data,
        position=np.concatenate((np.zeros((3, earlier.n)), data.position), axis=1),
        q=_joined(already.q, data.q),
        target=None if data.target is None else np.concatenate((_target(earlier, data), data.target)),
        time=time,
        direction=_joined(earlier.direction if motion and earlier.direction is not None else zero, data.direction),
        speed=_joined(earlier.speed if motion and earlier.speed is not None else zero, data.speed),
    )


def _joined(first: Array, second: Array | None) -> Array:
    return first if second is None else np.concatenate((first, second), axis=1)


def _target(earlier: Measurements, data: Measurements) -> NDArray[np.str_]:
    assert data.target is not None
    return np.full(earlier.n, data.target[0]) if earlier.target is None else earlier.target


def _as_planned(data: Measurements) -> Measurements:
    """Return the commanded part of measured poses."""
    if data.q is None:
        raise UsageError("the poses measured already have no joint columns")
    return dataclasses.replace(data, position=np.zeros_like(data.position), rotation=None)
