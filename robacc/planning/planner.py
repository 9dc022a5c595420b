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
    CampaignPlan,
    CampaignSettings,
    Sufficiency,
)
from robacc.planning.candidates import given_candidates, sampled_candidates, task_joints
from robacc.planning.design import DesignProblem, choose
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
from robacc.planning.known import expected_noise, known_information, planned_visits
from robacc.planning.linear_model import (
    PlannedCoefficients,
    candidate_rows,
    coefficients,
    region_rows,
    repeatability_at_target,
)
from robacc.planning.power_design import PowerProblem, choose_for_power, expected_power, power_problem, random_power
from robacc.planning.route import Route, route
from robacc.prediction.model_fit import model_fit
from robacc.robots.description import Robot


def plan_campaign(
    robot: Robot,
    settings: CampaignSettings,
    *,
    candidates: Measurements | None = None,
    task: Measurements | None = None,
    already: Measurements | None = None,
) -> CampaignPlan:
    """Return the plan of a measurement of ``robot``.

    Args:
        robot: The robot, with the effects that are known; the record of its fit, if it has one, tells the noise, and
            without ``already`` what is known of the coefficients.
        settings: Purpose, number, constraints and noise.
        candidates: Poses to choose from; sampled within the joint limits if None.
        task: Poses where the accuracy matters, in place of a region.
        already: Poses measured already.

    Raises:
        UsageError: A demand cannot be met, or an effect cannot be fitted to this robot.
        InputError: A prismatic joint has no limits.
    """
    return _Planner(robot, settings, candidates, task, already).plan()


class _Planner:
    """One planning: model, candidates and noise, made once."""

    def __init__(
        self,
        robot: Robot,
        settings: CampaignSettings,
        candidates: Measurements | None,
        task: Measurements | None,
        already: Measurements | None,
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
        self.record = model_fit(robot)
        self.noise = expected_noise(self.model, self.task, settings, self.record)
        self.repeatability = repeatability_at_target(self.model, self.task, self.noise.joints)

    def plan(self) -> CampaignPlan:
        """Return the plan."""
        settings = self.settings
        demands = tuple(needed(demand, settings.expected) for demand in settings.demands)
        count = self._count(demands)
        rows = candidate_rows(self.model, self.candidates.q, self.noise)
        planned = coefficients(self.model, rows)
        rows = rows[:, :, planned.columns]
        region = region_rows(self.model, self.task)[:, :, planned.columns]
        information = known_information(self.model, planned, self.noise, self.already, self.record)
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
        if count is None and self._n_known:
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

    @property
    def _n_known(self) -> int:
        """Return the number of poses measured already, or else of the model's fit."""
        if self.already is not None:
            return int(self.already.n)
        return 0 if self.record is None or self.settings.purpose != "calibrate" else self.record.n_poses

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
            sufficiency=self._sufficiency(expectation, plan) if self._n_known else None,
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
        now = expectation.point(expectation.rows[:, :0], 0)
        later = expectation.point(expectation.rows[:, plan.chosen], plan.chosen.size)
        n, target = self._n_known, self.settings.target
        of_model = self.already is None
        totals = [None if point is None else point.total for point in (now, later)]
        if now is None or later is None:
            return Sufficiency(
                n, False, "the poses so far do not identify all coefficients", totals[0], totals[1], of_model
            )
        if target is not None:
            enough = now.rms <= target
            why = f"the predicted error of {now.rms * 1e3:.3g} mm {'meets' if enough else 'exceeds'} the target"
            return Sufficiency(n, enough, why, totals[0], totals[1], of_model)
        gain = 1.0 - later.total / now.total
        enough = gain < ENOUGH_GAIN
        why = f"{plan.chosen.size} more poses reduce the predicted error by {100 * gain:.0f} %"
        return Sufficiency(n, enough, why, totals[0], totals[1], of_model)


def free_effects(robot: Robot, fit: str) -> tuple[Effect, ...]:
    """Return the effects of a list such as ``base_frame,joint_offset[j2]``.

    Raises:
        UsageError: One of them does not exist or cannot be fitted to the robot.
    """
    arm = Model.of(robot).arm
    return build(parse_requests(fit), arm, every_column(arm))
