"""Plan of a campaign: what is known before, candidates, choice, order of the visits, and the expected result."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from robacc.errors import UsageError
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.planning.campaign import (
    DEFAULT_FIT,
    DEFAULT_POSES,
    MOST_POSES,
    TYPICAL_NOISE,
    TYPICAL_REPEATABILITY,
    CampaignPlan,
    CampaignSettings,
    NeededPoses,
    needed,
    spread_poses,
    too_few_warning,
)
from robacc.planning.candidates import Conditions, conditions_of, given_candidates, sampled_candidates, task_joints
from robacc.planning.design import Criterion, DesignProblem, choose, information_of
from robacc.planning.expected import (
    BATCH,
    Expectation,
    Worth,
    expected_accuracy,
    expected_coefficients,
    expected_correlations,
    sufficiency_of,
    worth_of,
)
from robacc.planning.linear_model import (
    ExpectedNoise,
    PlannedCoefficients,
    candidate_rows,
    coefficients,
    free_effects,
    joint_repeatability,
    region_rows,
    repeatability_at_target,
    whitened_columns,
    with_targets,
)
from robacc.planning.power import (
    PowerProblem,
    choose_for_power,
    detectability,
    expected_power,
    power_problem,
    random_power,
)
from robacc.planning.route import Route, route_by_payload
from robacc.prediction.model_fit import ModelFit, model_fit
from robacc.robots.description import Robot

# Knowledge before a campaign: the noise, and the information of earlier poses or of a fitted model.

_TIME_STEP = 20.0
"""s from visit to visit, for the detection limit of a drift; the unit of time cancels."""


def expected_noise(
    model: Model, task: Measurements, settings: CampaignSettings, record: ModelFit | None
) -> ExpectedNoise:
    """Return the noise to expect: as given, else that of the model's fit, else typical.

    Args:
        model: The robot.
        task: Poses over which the scatter at the target is meant.
        settings: Given noise.
        record: Record of the robot's fit; None if it has none.

    Raises:
        UsageError: Instrument and model have no error at all.
    """
    sources = []
    if settings.noise is not None:
        position = settings.noise
        sources.append("given noise")
    elif record is not None and record.noise[0] > 0.0:
        position = record.noise[0]
        sources.append("noise of the model's fit")
    else:
        position = TYPICAL_NOISE
        sources.append("typical noise")
    fitted = {} if record is None else record.repeatability
    if settings.repeatability is None and fitted:
        joints = np.array([fitted.get(name, 0.0) for name in model.arm.names])
        sources.append("repeatability of the model's fit")
    elif settings.repeatability is None and record is not None:
        # A fit writes the scatter of the joints only where it is significant; the noise then includes the rest.
        joints = np.zeros(len(model.arm.names))
    else:
        size = TYPICAL_REPEATABILITY if settings.repeatability is None else settings.repeatability
        joints = joint_repeatability(model, task, size)
        sources.append(f"{'typical' if settings.repeatability is None else 'given'} repeatability")
    unexplained = settings.unexplained or _unexplained(record)
    if unexplained and not settings.unexplained:
        sources.append("unexplained error of the model's fit")
    if position == 0.0 and unexplained == 0.0:
        raise UsageError("`noise` is zero; give the standard deviation of the instrument along each axis")
    return ExpectedNoise(position, settings.noise_orientation, joints, unexplained, ", ".join(sources))


def _unexplained(record: ModelFit | None) -> float:
    """Return the unexplained error along each axis, m, without the noise that the record may contain."""
    if record is None:
        return 0.0
    variance = float(np.trace(record.unexplained[:3, :3])) / 3.0
    contained = 0.0 if record.noise_is_separate else record.noise[0] ** 2
    return float(np.sqrt(max(variance - contained, 0.0)))


def known_information(
    model: Model,
    planned: PlannedCoefficients,
    noise: ExpectedNoise,
    already: Measurements | None,
    record: ModelFit | None,
) -> Array:
    """Return ``(P, P)`` information of the poses measured ``already``, or else of the model's fit.

    ``already`` has the commanded part alone.
    """
    size = planned.columns.size
    if already is not None:
        columns = whitened_columns(model, already, noise)[:, planned.columns]
        return information_of(np.moveaxis(columns, 1, 2))
    result = np.zeros((size, size))
    if record is None:
        return result
    place = {name: i for i, name in enumerate(planned.names)}
    common = [(place[name], i) for i, name in enumerate(record.coefficients) if name in place]
    if common:
        ours, theirs = (np.array(numbers) for numbers in zip(*common, strict=True))
        # The part of a covariance is that of its coefficients, the others unknown.
        covariance = record.covariance[np.ix_(theirs, theirs)]
        scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
        inverse = np.linalg.pinv(covariance / scale[:, None] / scale, rcond=1e-12, hermitian=True)
        result[np.ix_(ours, ours)] = inverse / scale[:, None] / scale
    return result


def planned_visits(
    plan: CampaignPlan, conditions: Conditions, already: Measurements | None = None
) -> tuple[Measurements, Measurements]:
    """Return the planned visits with every target and the time of each, alone and after the poses measured already.

    ``already`` has the commanded part alone.
    """
    visits = plan.visits()
    start: Array = np.linspace(0.0, _TIME_STEP * (visits.n - 1), visits.n)
    temperature = conditions.constant_temperature(visits.n)
    timed = dataclasses.replace(visits, pose=None, cycle=None, time=start, temperature=temperature)
    data = with_targets(plan.robot, timed)
    return data, data if already is None else _after(already, data)


def _after(earlier: Measurements, data: Measurements) -> Measurements:
    """Return the rows of ``earlier``, then those of ``data``, which have all columns."""
    assert earlier.q is not None
    assert data.time is not None
    before: Array = np.linspace(-_TIME_STEP * earlier.n, -_TIME_STEP, earlier.n)
    time: Array = np.concatenate((before, data.time))
    payload = None
    if data.payload is not None:
        zero = np.zeros(earlier.n) if earlier.payload is None else earlier.payload
        payload = np.concatenate((zero, data.payload))
    temperature = None
    if data.temperature is not None:
        temperature = np.full(time.size, data.temperature[0])
    return dataclasses.replace(
        data,
        position=np.concatenate((np.zeros((3, earlier.n)), data.position), axis=1),
        q=_joined(earlier.q, data.q),
        target=None if data.target is None else np.concatenate((_target(earlier, data), data.target)),
        time=time,
        temperature=temperature,
        payload=payload,
        direction=_joined(earlier.direction, data.direction),
        speed=_joined(earlier.speed, data.speed),
        branches=_joined(earlier.branches, data.branches),
    )


def _joined(first: Array | None, second: Array | None) -> Array | None:
    return second if first is None or second is None else np.concatenate((first, second), axis=1)


def _target(earlier: Measurements, data: Measurements) -> NDArray[np.str_]:
    assert data.target is not None
    return np.full(earlier.n, data.target[0]) if earlier.target is None else earlier.target


def commanded_part(data: Measurements, conditions: Conditions) -> Measurements:
    """Return the commanded part of measured poses; direction and speed of an approach that was not logged are zero.

    Raises:
        UsageError: They have no joint columns.
    """
    if data.q is None:
        raise UsageError("the poses measured already have no joint columns")
    has_motion = data.direction is not None and data.speed is not None
    zero = np.zeros_like(data.q)
    temperature = data.temperature
    if temperature is None:
        temperature = conditions.constant_temperature(data.n)
    return dataclasses.replace(
        data,
        position=np.zeros_like(data.position),
        rotation=None,
        direction=data.direction if has_motion else zero,
        speed=data.speed if has_motion else zero,
        temperature=temperature,
    )


_TASK_STREAM = 6
"""Random numbers of the task's approaches, apart from those of the candidates."""


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
        self.robot, self.settings = robot, settings
        self.model = Model.of(robot, free_effects(robot, settings.fit or DEFAULT_FIT[settings.purpose]))
        self.conditions = conditions_of(
            self.model, settings.payloads, settings.seed, settings.purpose in ("calibrate", "health")
        )
        constraints, seed = settings.constraints, settings.seed
        if candidates is None:
            feasible = sampled_candidates(self.model, constraints, settings.n_candidates, seed)
        else:
            feasible = given_candidates(self.model, constraints, candidates)
        self.candidates = self.conditions.with_payloads(feasible)
        self.poses = self.conditions.at(self.candidates.q, self.candidates.payload)
        self.already = None if already is None else commanded_part(already, self.conditions)
        self.task = self._task(task)
        self.record = model_fit(robot)
        self.noise = expected_noise(self.model, self.task, settings, self.record)
        self.repeatability = repeatability_at_target(self.model, self.task, self.noise.joints)

    def _task(self, stated: Measurements | None) -> Measurements:
        """Return the poses of the task with their payloads; those of the plan in turn where ``stated`` has none."""
        if stated is None:
            q = task_joints(self.model, self.settings.constraints, self.settings.region, self.settings.seed)
        elif stated.q is None:
            raise UsageError("the poses of the task have no joint columns")
        else:
            q = stated.q
        payload = None if stated is None else stated.payload
        return self.conditions.at(q, self.conditions.in_turn(q.shape[1]) if payload is None else payload, _TASK_STREAM)

    def plan(self) -> CampaignPlan:
        """Return the plan."""
        settings = self.settings
        demands = tuple(needed(demand, settings.expected) for demand in settings.demands)
        count = self._count(demands)
        rows = candidate_rows(self.model, self.poses, self.noise)
        planned = coefficients(self.model, rows)
        rows = rows[:, :, planned.columns]
        region = region_rows(self.model, self.task)[:, :, planned.columns]
        information = known_information(self.model, planned, self.noise, self.already, self.record)
        problem = self._problem(rows, region, planned, information)
        chosen = self._choose(problem, count)
        powers = None
        if isinstance(problem, PowerProblem):
            powers = expected_power(problem, chosen), random_power(problem, count, settings.seed)
        validation, validation_payload = self._validation()
        plan = CampaignPlan(
            self.robot,
            dataclasses.replace(settings, poses=count),
            self.candidates,
            chosen,
            self._route(chosen),
            self._ids(chosen),
            validation,
            validation_payload,
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
            n = self.candidates.n
            number = f"only {n} candidate{'s are' if n > 1 else ' is'} feasible"
            raise UsageError(f"{count} poses are planned, but {number}{most}")
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
            return power_problem(self.model, self.poses, self.noise, self.already)
        if self.settings.purpose == "health":
            is_offset = np.array([name.startswith("joint_offset") for name in planned.names])
            interest = np.where(is_offset, np.square(planned.prior_std), 0.0)
            return _design_problem(rows, region, planned, information, "A", interest)
        return _design_problem(rows, region, planned, information, self.settings.criterion)

    def _choose(self, problem: DesignProblem | PowerProblem, count: int) -> NDArray[np.int64]:
        settings = self.settings
        if settings.purpose == "acceptance":
            return self._spread(count)
        if isinstance(problem, PowerProblem):
            return choose_for_power(problem, count, settings.seed)
        return choose(problem, count)

    def _spread(self, count: int) -> NDArray[np.int64]:
        """Return the numbers of ``count`` candidates that represent the task, with the payloads in turn."""
        settings, n = self.settings, self.candidates.n_poses
        position, q = self.candidates.position[:, :n], self.candidates.q[:, :n]
        allowed = np.arange(n)
        if settings.region is not None:
            allowed = np.flatnonzero(settings.region.contains(position))
        if allowed.size < count:
            raise UsageError(
                f"{count} poses are planned, but only {allowed.size} feasible candidates lie in `region`; "
                "give a larger region or more `candidates`"
            )
        chosen = allowed[spread_poses(position[:, allowed], q[:, allowed], count, settings.seed)]
        # Poses come in an order in which every first part represents the task, so each payload's poses do so too.
        return chosen + n * (np.arange(count) % self.candidates.n_payloads)

    def _route(self, chosen: NDArray[np.int64]) -> Route:
        settings = self.settings
        default = chosen.size if settings.purpose == "health" else chosen.size // 10
        repeats = default if settings.repeats is None else settings.repeats
        if settings.repeats is None and self.already is not None:
            repeats = 0
        payload = self.candidates.payload
        return route_by_payload(
            self.candidates.q[:, chosen],
            None if payload is None else payload[chosen],
            repeats,
            0 if self.already is not None else settings.check_every,
            settings.seed,
        )

    def _ids(self, chosen: NDArray[np.int64]) -> tuple[str, ...]:
        if self.candidates.ids is not None:
            return tuple(str(name) for name in self.candidates.ids[chosen])
        first = 1 if self.already is None else int(self.already.groups().max(initial=-1)) + 2
        digits = len(str(first + chosen.size))
        return tuple(f"P{first + i:0{digits}d}" for i in range(chosen.size))

    def _validation(self) -> tuple[Array | None, Array | None]:
        """Return joint variables and payloads of the validation poses, in the order of their visits."""
        settings = self.settings
        if not settings.validation:
            return None, None
        constraints = dataclasses.replace(settings.constraints, inside=settings.region or settings.constraints.inside)
        pool = sampled_candidates(self.model, constraints, 10 * settings.validation, settings.seed + 2)
        if pool.n < settings.validation:
            raise UsageError(f"only {pool.n} of {settings.validation} validation poses are feasible")
        q = pool.q[:, : settings.validation]
        payload = self.conditions.in_turn(settings.validation)
        visits = route_by_payload(q, payload, 0, 0, settings.seed).visits
        return q[:, visits], None if payload is None else payload[visits]

    def _with_expectation(
        self, plan: CampaignPlan, rows: Array, region: Array, planned: PlannedCoefficients, information: Array
    ) -> CampaignPlan:
        """Return the plan with what to expect from it."""
        settings = self.settings
        noise_at_target = np.hypot(self.repeatability, self.noise.unexplained)
        expectation = Expectation(rows, region, planned, information, float(np.sqrt(3.0)) * float(noise_at_target))
        # Repeats and checks are measurements too, and the order gives the approaches.
        new, data = planned_visits(plan, self.conditions, self.already)
        columns = whitened_columns(self.model, new, self.noise)[:, planned.columns]
        covariance = expectation.covariance(np.moveaxis(columns, 1, 2))
        accuracy = worth = None
        if settings.purpose == "calibrate":
            problem = _design_problem(rows, region, planned, information, settings.criterion)
            accuracy = expected_accuracy(expectation, problem, plan.chosen, settings.seed)
            worth = self._worth(expectation, problem, plan.chosen, planned)
        return dataclasses.replace(
            plan,
            coefficients=expected_coefficients(planned, covariance),
            correlations=expected_correlations(planned, covariance),
            accuracy=accuracy,
            worth=worth,
            detectability=None if settings.purpose == "acceptance" else detectability(self.model, data, self.noise),
            sufficiency=sufficiency_of(expectation, plan.chosen, self._n_known, settings.target, self.already is None)
            if self._n_known
            else None,
            warnings=self._warnings(plan, rows.shape[0], planned),
        )

    def _warnings(self, plan: CampaignPlan, components: int, planned: PlannedCoefficients) -> tuple[str, ...]:
        """Return the plan's warnings, and that it is too small for its fit; acceptance fits nothing of the arm."""
        if self.settings.purpose == "acceptance":
            return plan.warnings
        return *plan.warnings, *too_few_warning(plan.chosen.size, self._n_known, components, planned.columns.size)

    def _worth(
        self, expectation: Expectation, problem: DesignProblem, chosen: NDArray[np.int64], planned: PlannedCoefficients
    ) -> Worth:
        """Compare as many measurements of new poses, of half as many poses twice, and of two readings of each."""
        count = chosen.size
        new = choose(problem, min(2 * count, self.candidates.n), exchanged=200, passes=1)
        repeated, readings = (
            candidate_rows(self.model, self.poses.subset(chosen), self.noise.reduced(*times))[:, :, planned.columns]
            for times in ((2, 1), (1, 2))
        )
        return worth_of(
            expectation.point(expectation.rows[:, new], new.size),
            expectation.point(repeated, count),
            expectation.point(readings, count),
        )


def _design_problem(
    rows: Array,
    region: Array,
    planned: PlannedCoefficients,
    information: Array,
    criterion: Criterion,
    interest: Array | None = None,
) -> DesignProblem:
    """Return the problem of choice with each coefficient in units of its prior's standard deviation."""
    scale = planned.prior_std
    scaled = information * scale[:, None] * scale + np.eye(scale.size)
    return DesignProblem(rows * scale, scaled, region * scale, criterion, interest)
