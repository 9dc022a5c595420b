"""Plan of a campaign: what is known before, candidates, choice, order of the visits, and the expected result."""

from __future__ import annotations

import dataclasses
from typing import Any

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
from robacc.planning.candidates import (
    CandidatePoses,
    Conditions,
    conditions_of,
    given_candidates,
    sampled_candidates,
    task_joints,
)
from robacc.planning.design import DesignProblem, FitCriterion, choose, exchanged, greedy, information_of
from robacc.planning.expected import (
    BATCH,
    CURVE_EXCHANGED,
    Expectation,
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
    whitened_rows,
    with_targets,
)
from robacc.planning.power import choose_for_power, detectability, expected_power, power_problem, random_power
from robacc.planning.route import route_by_payload
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
    fitted = record is not None and record.noise[0] > 0.0
    position = settings.noise
    if position is None:
        position = record.noise[0] if record is not None and fitted else TYPICAL_NOISE
    sources = [
        "given noise" if settings.noise is not None else "noise of the model's fit" if fitted else "typical noise"
    ]
    size = settings.repeatability
    if size is None and record is not None:
        # A fit writes the scatter of the joints only where it is significant; the noise then includes the rest.
        joints = np.array([record.repeatability.get(name, 0.0) for name in model.arm.names])
        sources += ["repeatability of the model's fit"] if record.repeatability else []
    else:
        joints = joint_repeatability(model, task, TYPICAL_REPEATABILITY if size is None else size)
        sources.append(f"{'typical' if size is None else 'given'} repeatability")
    unexplained = settings.unexplained
    if record is not None and not unexplained:
        variance = float(np.trace(record.unexplained[:3, :3])) / 3.0
        contained = 0.0 if record.noise_is_separate else record.noise[0] ** 2
        unexplained = float(np.sqrt(max(variance - contained, 0.0)))
        if unexplained:
            sources.append("unexplained error of the model's fit")
    if position == 0.0 and unexplained == 0.0:
        raise UsageError("`noise` is zero; give the standard deviation of the instrument along each axis")
    return ExpectedNoise(position, settings.noise_orientation, joints, unexplained, ", ".join(sources))


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
    if already is not None:
        return information_of(whitened_rows(model, already, noise)[:, :, planned.columns])
    place = {name: i for i, name in enumerate(planned.names)}
    result = np.zeros((len(place), len(place)))
    common = [] if record is None else [(place[name], i) for i, name in enumerate(record.coefficients) if name in place]
    if record is not None and common:
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
    start: Array = _TIME_STEP * np.arange(visits.n, dtype=np.float64)
    temperature = conditions.constant_temperature(visits.n)
    timed = dataclasses.replace(visits, pose=None, cycle=None, time=start, temperature=temperature)
    data = with_targets(plan.robot, timed)
    if already is None:
        return data, data
    assert data.time is not None
    columns: dict[str, Any] = {"time": np.append(_TIME_STEP * np.arange(-already.n, 0), data.time)}
    if data.temperature is not None:
        columns["temperature"] = np.full(already.n + data.n, data.temperature[0])
    for name in ("position", "q", "target", "payload", "direction", "speed", "branches"):
        earlier, later = getattr(already, name), getattr(data, name)
        if later is not None:
            if earlier is None:
                usual = np.zeros(1) if name == "payload" else later[..., :1]
                earlier = np.repeat(usual, already.n, axis=-1)
            columns[name] = np.concatenate((earlier, later), axis=-1)
    return data, dataclasses.replace(data, **columns)


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
    purpose, seed, constraints = settings.purpose, settings.seed, settings.constraints
    model = Model.of(robot, free_effects(robot, settings.fit or DEFAULT_FIT[purpose]))
    conditions = conditions_of(model, settings.payloads, seed, purpose in ("calibrate", "health"))
    if candidates is None:
        feasible = sampled_candidates(model, constraints, settings.n_candidates, seed)
    else:
        feasible = given_candidates(model, constraints, candidates)
    pool = conditions.with_payloads(feasible)
    poses = conditions.at(pool.q, pool.payload)
    measured = None if already is None else commanded_part(already, conditions)
    task_poses = _task(model, conditions, settings, task)
    record = model_fit(robot)
    noise = expected_noise(model, task_poses, settings, record)
    repeatability = repeatability_at_target(model, task_poses, noise.joints)
    # Poses measured already, or else those of the model's fit.
    n_known = 0
    if measured is not None:
        n_known = measured.n
    elif record is not None and purpose == "calibrate":
        n_known = record.n_poses
    demands = tuple(needed(demand, settings.expected) for demand in settings.demands)
    count = _count(settings, demands, n_known, pool)

    rows = candidate_rows(model, poses, noise)
    planned = coefficients(model, rows)
    rows = rows[:, :, planned.columns]
    expectation = Expectation(
        rows,
        region_rows(model, task_poses)[:, :, planned.columns],
        planned,
        known_information(model, planned, noise, measured, record),
        float(np.sqrt(3.0) * np.hypot(repeatability, noise.unexplained)),
    )
    accuracy = worth = power = power_of_random = None
    if purpose == "acceptance":
        chosen = _spread(settings, pool, count)
    elif purpose == "trace":
        problem = power_problem(model, poses, noise, measured)
        chosen = choose_for_power(problem, count, seed)
        power, power_of_random = expected_power(problem, chosen), random_power(problem, count, seed)
    elif purpose == "health":
        is_offset = np.array([name.startswith("joint_offset") for name in planned.names], dtype=np.float64)
        design = _design_problem(expectation, FitCriterion("A", np.diag(is_offset)[None]))
        chosen = choose(design, greedy(design, count), seed)
    else:
        region = np.diag(1.0 / planned.prior_std)[None] if settings.criterion == "A" else expectation.region
        design = _design_problem(expectation, FitCriterion(settings.criterion, region))
        # The beginnings of a greedy design are those of fewer poses.
        order = greedy(design, 2 * count + BATCH)
        chosen = choose(design, order[:count], seed)
        accuracy = expected_accuracy(expectation, design, order, chosen, seed)
        # As many measurements of new poses, of half as many poses twice, and of two readings of each.
        repeated, readings = (
            candidate_rows(model, poses.subset(chosen), noise.reduced(*times))[:, :, planned.columns]
            for times in ((2, 1), (1, 2))
        )
        new_poses = rows[exchanged(design, order[: 2 * count], CURVE_EXCHANGED)]
        worth = worth_of(expectation, (new_poses, repeated, readings))

    default = 0 if already is not None else count if purpose == "health" else count // 10
    validation, validation_payload = _validation(model, conditions, settings)
    plan = CampaignPlan(
        robot,
        dataclasses.replace(settings, poses=count),
        pool,
        chosen,
        route_by_payload(
            pool.q[:, chosen],
            None if pool.payload is None else pool.payload[chosen],
            default if settings.repeats is None else settings.repeats,
            settings.check_every if already is None else 0,
            seed,
        ),
        _ids(pool, chosen, already),
        validation,
        validation_payload,
        noise,
        repeatability,
        accuracy=accuracy,
        worth=worth,
        needed=demands,
        power=power,
        random_power=power_of_random,
    )
    # Repeats and checks are measurements too, and the order gives the approaches.
    new, data = planned_visits(plan, conditions, measured)
    covariance = expectation.covariance(whitened_rows(model, new, noise)[:, :, planned.columns])
    plan = dataclasses.replace(
        plan,
        coefficients=expected_coefficients(planned, covariance),
        correlations=expected_correlations(planned, covariance),
    )
    if n_known:
        sufficiency = sufficiency_of(expectation, chosen, n_known, settings.target, already is None)
        plan = dataclasses.replace(plan, sufficiency=sufficiency)
    if purpose == "acceptance":
        # It fits nothing of the arm.
        return plan
    warnings = too_few_warning(count, n_known, rows.shape[1], planned.columns.size)
    return dataclasses.replace(plan, detectability=detectability(model, data, noise), warnings=warnings)


def _task(
    model: Model, conditions: Conditions, settings: CampaignSettings, stated: Measurements | None
) -> Measurements:
    """Return the poses of the task with their payloads; those of the plan in turn where ``stated`` has none."""
    if stated is None:
        q, payload = task_joints(model, settings.constraints, settings.region, settings.seed), None
    elif stated.q is None:
        raise UsageError("the poses of the task have no joint columns")
    else:
        q, payload = stated.q, stated.payload
    return conditions.at(q, conditions.in_turn(q.shape[1]) if payload is None else payload, _TASK_STREAM)


def _count(
    settings: CampaignSettings, demands: tuple[NeededPoses, ...], n_known: int, candidates: CandidatePoses
) -> int:
    """Return the number of poses: as given, else a batch beside known poses, else what decides all demands."""
    count = settings.poses or (BATCH if n_known else None)
    undecided = next((entry for entry in demands if entry.poses is None), None)
    if count is None and undecided is not None:
        raise UsageError(
            f"no number of poses up to {MOST_POSES} decides {undecided.demand.label} if the true value is "
            f"{undecided.ratio:.2g} times the limit; give `expected` farther from the limit, or `poses`"
        )
    count = count or max((entry.poses or 0 for entry in demands), default=DEFAULT_POSES[settings.purpose])
    if count > candidates.n:
        reasons = candidates.excluded
        most = f"; most of the others are excluded by: {reasons[0].reason}" if reasons else ""
        number = f"only {candidates.n} candidate{'s are' if candidates.n > 1 else ' is'} feasible"
        raise UsageError(f"{count} poses are planned, but {number}{most}")
    return count


def _spread(settings: CampaignSettings, candidates: CandidatePoses, count: int) -> NDArray[np.int64]:
    """Return the numbers of ``count`` candidates that represent the task, with the payloads in turn."""
    n = candidates.n_poses
    position, q = candidates.position[:, :n], candidates.q[:, :n]
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
    return chosen + n * (np.arange(count) % candidates.n_payloads)


def _ids(candidates: CandidatePoses, chosen: NDArray[np.int64], already: Measurements | None) -> tuple[str, ...]:
    """Return the names of the poses: those of given candidates, else numbers that go on from those measured already."""
    if candidates.ids is not None:
        return tuple(str(name) for name in candidates.ids[chosen])
    first = 1 if already is None else int(already.groups().max(initial=-1)) + 2
    digits = len(str(first + chosen.size))
    return tuple(f"P{first + i:0{digits}d}" for i in range(chosen.size))


def _validation(model: Model, conditions: Conditions, settings: CampaignSettings) -> tuple[Array | None, Array | None]:
    """Return joint variables and payloads of the validation poses, in the order of their visits."""
    count = settings.validation
    if not count:
        return None, None
    constraints = dataclasses.replace(settings.constraints, inside=settings.region or settings.constraints.inside)
    pool = sampled_candidates(model, constraints, 10 * count, settings.seed + 2)
    if pool.n < count:
        raise UsageError(f"only {pool.n} of {count} validation poses are feasible")
    q, payload = pool.q[:, :count], conditions.in_turn(count)
    visits = route_by_payload(q, payload, 0, 0, settings.seed).visits
    return q[:, visits], None if payload is None else payload[visits]


def _design_problem(expectation: Expectation, criterion: FitCriterion) -> DesignProblem:
    """Return the problem of choice with each coefficient in units of its prior's standard deviation."""
    scale = expectation.planned.prior_std
    information = expectation.already * scale[:, None] * scale + np.eye(scale.size)
    scaled = FitCriterion(criterion.name, criterion.region * scale)
    return DesignProblem(expectation.rows * scale, information, scaled)
