"""Plan of a campaign: demands and what is known before, choice of poses, order of the visits, expected result."""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from robacc.accuracy.error_statistics import Statistic
from robacc.errors import applying, given, refuse
from robacc.fitting.parameters import Correlation, correlations
from robacc.fitting.warnings import NO_LENGTH
from robacc.geometry import Array, NDArray, rotate
from robacc.measurements import Measurements, motion_between_rows
from robacc.modelling.model import Model
from robacc.planning.candidates import (
    CandidatePoses,
    Conditions,
    Constraints,
    Zone,
    branches_at_rest,
    conditions_of,
    given_candidates,
    measured_in,
    sampled_candidates,
    task_joints,
)
from robacc.planning.design import (
    Criterion,
    DesignProblem,
    FitCriterion,
    Route,
    choose,
    exchanged,
    expected_power,
    greedy,
    information_of,
    route,
)
from robacc.planning.expected import (
    BATCH,
    CURVE_EXCHANGED,
    Expectation,
    ExpectedNoise,
    PlannedCoefficients,
    candidate_rows,
    choose_for_power,
    coefficients,
    detectability,
    expected_accuracy,
    expected_coefficients,
    free_effects,
    joint_repeatability,
    power_problem,
    region_rows,
    repeatability_at_target,
    sufficiency_of,
    whitened_rows,
    with_targets,
    worth_of,
)
from robacc.prediction.model_uncertainty import ModelFit, model_fit, scaled_inverse
from robacc.robots.description import Robot
from robacc.statistics.intervals import ASSURANCE, chi2_cdf, chi2_quantile, smallest_sufficient

# Number of poses that decides a limit, and poses spread over the task's region.
#
# The squared error length of n poses is taken as a chi-square with n degrees of freedom, as for errors along one
# direction; errors in three directions need fewer. A true value of r times the limit L is confirmed where the upper
# bound s sqrt(n / chi2(1 - c; n)) of the estimate s is within L, so with probability P(chi2_n <= chi2(1 - c; n) /
# r^2). A 95th percentile is bounded by order statistics: their variance is larger, and they need ln(1 - c) / ln 0.95
# poses at least (S. S. Wilks, "Determination of sample sizes for setting tolerance limits", Ann. Math. Statist. 12,
# 1941).

MOST_POSES = 2000


def needed(
    name: str, statistic: Statistic, limit: float, confidence: float, share: float = 0.95, expected: float | None = None
) -> Mapping[str, Any]:
    """Return the number of poses that decides a limit of the errors, m, with the keys of the result.

    It decides with probability 0.9 if the true value is ``expected``, and so do the numbers for other true values; None
    where more than :data:`MOST_POSES` are needed. ``share`` of all poses must lie within the limit of a largest error.
    """
    # True value over the limit for which the number is planned, if no expected value is given.
    ratio = 0.8 if expected is None else expected / limit
    return {
        "name": name,
        "statistic": statistic,
        "limit_m": limit,
        "confidence": confidence,
        "true_over_limit": ratio,
        "n_poses": poses_for(ratio, statistic, confidence, share),
        "by_ratio": [
            {"true_over_limit": each, "n_poses": poses_for(each, statistic, confidence, share)}
            for each in (0.5, 0.6, 0.7, 0.8, 0.9)
        ],
    }


def poses_for(ratio: float, statistic: Statistic, confidence: float, share: float) -> int | None:
    """Return the number of poses that decides if the true value is ``ratio`` times the limit, below or above it."""
    is_below, fewest, cost = ratio < 1.0, 3, 1.0
    if statistic == "p95":
        # Variance of order statistics relative to that of a Gaussian's radius, as in the decision on a gate.
        fewest, cost = math.ceil(math.log(1.0 - confidence) / math.log(0.95)), 2.4
    elif statistic == "max":
        return math.ceil(math.log(1.0 - confidence) / math.log(share)) if ratio <= 1.0 else fewest

    def decides(n: int) -> bool:
        below = chi2_cdf(chi2_quantile(1.0 - confidence if is_below else confidence, n) / max(ratio**2, 1e-12), n)
        return (below if is_below else 1.0 - below) >= ASSURANCE

    enough = smallest_sufficient(decides, 4, most=MOST_POSES)
    number = MOST_POSES + 1 if enough is None else max(math.ceil(cost * enough), fewest)
    return number if number <= MOST_POSES else None


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
    # Poses, drawn at random, that stand for all in the mean distance.
    sample = np.random.default_rng([seed, 3]).permutation(n)[:500]
    spaces = []
    mean_distance, to_chosen = np.zeros(n), np.zeros(n)
    for space in (position, q):
        values = space / np.maximum(np.std(space, axis=1, keepdims=True), 1e-9)
        distance = np.mean([np.linalg.norm(values - values[:, [at]], axis=0) for at in sample], axis=0)
        scale = float(distance.mean()) or 1.0
        spaces.append(values / scale)
        mean_distance += distance / scale

    def energy(chosen: NDArray[np.int64]) -> Array:
        """Return the cost ``(n,)`` of each pose beside those chosen, the distances to which add up."""
        for values in spaces if chosen.size else ():
            np.add(to_chosen, np.linalg.norm(values - values[:, chosen[-1:]], axis=0), out=to_chosen)
        return mean_distance - to_chosen / (chosen.size + 1)

    return greedy(energy, n, count)


Purpose = Literal["calibrate", "trace", "acceptance", "health"]
_DEFAULTS: dict[Purpose, tuple[str, int]] = {
    "calibrate": ("base_frame,tool_frame,joint_offset,link_geometry", 30),
    "trace": ("base_frame,tool_frame,joint_offset,link_geometry", 60),
    "acceptance": ("base_frame,tool_frame", 60),
    "health": ("base_frame,joint_offset", 8),
}
"""Free effects and number of poses by purpose."""
DEFAULT_CANDIDATES = 5000


@dataclass(frozen=True, slots=True)
class CampaignPlan:
    """Planned poses in their order, and the expected result."""

    robot: Robot
    purpose: Purpose
    criterion: Criterion
    fit: str
    """Effects that are free in the fit, as given."""
    constraints: Constraints
    payloads: tuple[float, ...]
    """kg; each pose has one of them."""
    candidates: CandidatePoses
    chosen: NDArray[np.int64]
    """Numbers of the chosen candidates; pose k of the route is ``chosen[k]``."""
    route: Route
    visits: Measurements
    """All visits in order as poses to measure, with direction and speed of approach."""
    validation: Measurements | None
    """Validation poses in the order of their visits."""
    noise: ExpectedNoise
    repeatability: float
    """At the target along each axis, m rms over the task."""
    coefficients: Sequence[Mapping[str, Any]]
    correlations: tuple[Correlation, ...]
    accuracy: Mapping[str, Any] | None
    """Predicted accuracy of the planned poses and over the number of poses, with the keys of the result."""
    worth: Mapping[str, Any] | None
    detectability: Mapping[str, Any] | None
    """What a trace can find: :func:`robacc.planning.expected.detectability`."""
    needed: Sequence[Mapping[str, Any]]
    sufficiency: Mapping[str, Any] | None
    power: Mapping[str, float] | None
    """Mean over the catalogue at the usual sizes, before repeats and checks, of the chosen and of as many random
    candidates; None unless the purpose is a trace."""
    warnings: tuple[str, ...]

    @property
    def payload_blocks(self) -> Sequence[Mapping[str, Any]]:
        """Visits in a row with one payload, in order, with the keys of the result; empty where no payload was given."""
        if (payload := self.visits.payload) is None:
            return ()
        return [
            {
                "payload_kg": float(payload[start]),
                "first_visit": int(start) + 1,
                "n_visits": int(end - start),
                "n_poses": np.unique(self.route.visits[start:end]).size,
            }
            for start, end in itertools.pairwise([*np.flatnonzero(np.diff(payload, prepend=np.nan) != 0), payload.size])
        ]


def planned_visits(robot: Robot, pool: CandidatePoses, at: NDArray[np.int64], ids: NDArray[np.str_]) -> Measurements:
    """Return the visits of the candidates ``at`` ``(V,)`` by their ``ids`` as poses to measure."""
    cycle = [str(int(np.count_nonzero(at[: i + 1] == number))) for i, number in enumerate(at)]
    data = _to_measure(robot, pool.q[:, at], ids, None if pool.payload is None else pool.payload[at])
    base, socket = robot.base.pose, None if pool.socket is None else pool.socket[at]
    position = np.round(rotate(base.rotation, pool.position[:, at]) + base.translation[:, None], 6)
    return measured_in(replace(data, position=position, cycle=np.array(cycle)), socket)


def _to_measure(robot: Robot, q: Array, ids: NDArray[np.str_], payload: Array | None) -> Measurements:
    """Return unmeasured poses at ``q`` ``(J, n)`` in their order, with direction and speed of approach."""
    direction, speed = motion_between_rows(q)
    branches, branch_names = branches_at_rest(robot, q.shape[1])
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


# Knowledge before a campaign: the noise, and the information of earlier poses or of a fitted model.

_TIME_STEP = 20.0
"""s from visit to visit, for the detection limit of a drift; the unit of time cancels."""


def expected_noise(
    model: Model,
    task: Measurements,
    record: ModelFit | None,
    position: float | None,
    orientation: float | None,
    size: float | None,
    unexplained: float,
) -> ExpectedNoise:
    """Return the noise to expect: as given, else that of the model's fit, else typical.

    Args:
        model: The robot.
        task: Poses over which the scatter at the target is meant.
        record: Record of the robot's fit; None if it has none.
        position: Given noise of the instrument, m.
        orientation: The same of orientation, rad; None where it is not measured.
        size: Given repeatability, m along each axis.
        unexplained: Given error that no model explains, m.

    Raises:
        UsageError: Instrument and model have no error at all.
    """
    sources = ["given noise"]
    if position is None and record is not None and record.noise[0] > 0.0:
        position, sources = record.noise[0], ["noise of the model's fit"]
    elif position is None:
        # m; a laser tracker at some metres.
        position, sources = 2e-5, ["typical laser tracker"]
    if size is None and record is not None:
        # A fit writes the scatter of the joints only where it is significant; the noise then includes the rest.
        joints = np.array([record.repeatability.get(name, 0.0) for name in model.arm.names])
        sources += ["repeatability of the model's fit"] if record.repeatability else []
    else:
        # m along each axis; an arm with a stated pose repeatability (mean + 3 sd of the distance) of about 0.08 mm.
        joints = joint_repeatability(model, task, 2e-5 if size is None else size)
        sources.append("typical arm" if size is None else "given repeatability")
    if record is not None and not unexplained:
        noise = 0.0 if record.noise_is_separate else record.noise[0]
        unexplained = math.sqrt(max(float(np.trace(record.unexplained[:3, :3])) / 3.0 - noise**2, 0.0))
        sources += ["unexplained error of the model's fit"] if unexplained else []
    refuse(
        (
            position == 0.0 and unexplained == 0.0,
            "`noise` is zero; give the standard deviation of the instrument along each axis",
        )
    )
    return ExpectedNoise(position, orientation, joints, unexplained, ", ".join(sources))


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
    result, known = np.zeros((planned.columns.size,) * 2), () if record is None else record.coefficients
    ours = [i for i, name in enumerate(planned.names) if name in known]
    if record is not None and ours:
        theirs = [known.index(planned.names[i]) for i in ours]
        # The part of a covariance is that of its coefficients, the others unknown.
        result[np.ix_(ours, ours)] = scaled_inverse(record.covariance[np.ix_(theirs, theirs)])
    return result


def expectation_of(
    model: Model,
    poses: Measurements,
    task: Measurements,
    noise: ExpectedNoise,
    already: Measurements | None,
    record: ModelFit | None,
) -> Expectation:
    """Return the predicted errors at ``task`` of fits of the free effects of ``model`` to some of the ``poses``."""
    rows = candidate_rows(model, poses, noise)
    planned = coefficients(model, rows)
    scatter = repeatability_at_target(model, task, noise.joints)
    return Expectation(
        rows[:, :, planned.columns],
        region_rows(model, task)[:, :, planned.columns],
        planned,
        known_information(model, planned, noise, already, record),
        math.sqrt(3.0) * math.hypot(scatter, noise.unexplained),
    )


def fit_design(expectation: Expectation, criterion: Criterion, *, is_of_zeros: bool = False) -> DesignProblem:
    """Return the choice of poses by a criterion of the fit's errors, or by the errors of the joints' zeros alone."""
    planned, interest = expectation.planned, expectation.region
    if is_of_zeros:
        criterion, interest = "A", np.diag([float(name.startswith("joint_offset")) for name in planned.names])[None]
    elif criterion == "A":
        interest = np.diag(1.0 / planned.prior_std)[None]
    # Each coefficient is in units of its prior's standard deviation.
    scale = planned.prior_std
    return DesignProblem(
        expectation.rows * scale,
        expectation.already * scale[:, None] * scale + np.eye(scale.size),
        FitCriterion(criterion, interest * scale),
    )


def timed_visits(
    robot: Robot, visits: Measurements, conditions: Conditions, already: Measurements | None = None
) -> tuple[Measurements, Measurements]:
    """Return the visits with every target and the time of each, alone and after the poses measured already.

    ``already`` has the commanded part alone.
    """
    time, temperature = _TIME_STEP * np.arange(0.0, visits.n), conditions.constant_temperature(visits.n)
    data = with_targets(robot, replace(visits, pose=None, cycle=None, time=time, temperature=temperature))
    if already is None:
        return data, data
    before = replace(already, time=_TIME_STEP * np.arange(-already.n, 0.0), temperature=None)
    columns: dict[str, Array] = {}
    names = ("position", "q", "target", "time", "temperature", "payload", "direction", "speed", "branches")
    for name in (*names, "kind", "fixture"):
        earlier, later = getattr(before, name), getattr(data, name)
        if later is not None:
            if earlier is None:
                earlier = np.repeat(np.zeros(1) if name == "payload" else later[..., :1], before.n, axis=-1)
            columns[name] = np.concatenate((earlier, later), axis=-1)
    return data, replace(data, **columns)  # type: ignore[arg-type]


def commanded_part(data: Measurements, conditions: Conditions) -> Measurements:
    """Return the commanded part of measured poses; direction and speed of an approach that was not logged are zero.

    Raises:
        UsageError: They have no joint columns.
    """
    q = given(data.q, "the poses measured already have no joint columns")
    is_logged = data.direction is not None and data.speed is not None
    return replace(
        data,
        position=np.zeros_like(data.position),
        rotation=None,
        direction=data.direction if is_logged else np.zeros_like(q),
        speed=data.speed if is_logged else np.zeros_like(q),
        temperature=conditions.constant_temperature(data.n) if data.temperature is None else data.temperature,
    )


def plan_campaign(
    robot: Robot,
    purpose: Purpose,
    poses: int | None = None,
    criterion: Criterion = "I",
    fit: str = "",
    *,
    constraints: Constraints | None = None,
    region: Zone | None = None,
    noise: float | None = None,
    noise_orientation: float | None = None,
    repeatability: float | None = None,
    unexplained: float = 0.0,
    check_every: int = 10,
    repeats: int | None = None,
    validation: int = 0,
    target: float | None = None,
    demands: Sequence[Mapping[str, Any]] = (),
    n_candidates: int = DEFAULT_CANDIDATES,
    payloads: tuple[float, ...] = (),
    seed: int = 0,
    candidates: Measurements | None = None,
    task: Measurements | None = None,
    already: Measurements | None = None,
) -> CampaignPlan:
    """Return the plan of a measurement of ``robot``.

    Args:
        robot: The robot, with the effects that are known; the record of its fit, if it has one, tells the noise, and
            without ``already`` what is known of the coefficients.
        purpose: What the poses are for.
        poses: Number of different poses; None for the default of the purpose.
        criterion: What the poses of a calibration are chosen by.
        fit: Effects that are free in the fit; empty for the default of the purpose.
        constraints: What decides whether a pose is feasible.
        region: Box in the base frame where the accuracy matters; None: everywhere the robot may be.
        noise: Standard deviation of the instrument along each axis, m.
        noise_orientation: The same about each axis, rad; None where orientation is not measured.
        repeatability: That of the arm, m along each axis.
        unexplained: Error of the model that stays the same at a pose, m along each axis.
        check_every: Visits between drift checks; 0 for none.
        repeats: Poses visited a second time; None for a tenth of the poses.
        validation: Poses of the validation set.
        target: Error after calibration that is good enough, m rms; None: until more poses gain little.
        demands: Limits that the measurement is to decide, from :func:`needed`.
        n_candidates: Number of candidates to sample.
        payloads: kg; each pose has one of them.
        seed: Seed of all choices.
        candidates: Poses to choose from; sampled within the joint limits if None.
        task: Poses where the accuracy matters, in place of a region.
        already: Poses measured already.

    Raises:
        UsageError: A demand cannot be met, or an effect cannot be fitted to this robot.
        InputError: A prismatic joint has no limits.
    """
    constraints = constraints or Constraints()
    default_fit, default_count = _DEFAULTS[purpose]
    model = Model.of(robot, free_effects(robot, fit or default_fit))
    conditions = conditions_of(model, payloads, seed, purpose in ("calibrate", "health"))
    pool = conditions.with_payloads(
        sampled_candidates(model, constraints, n_candidates, seed)
        if candidates is None
        else given_candidates(model, constraints, candidates, n_candidates, seed)
    )
    rows_of_pool = measured_in(conditions.at(pool.q, pool.payload), pool.socket)
    measured = None if already is None else commanded_part(already, conditions)
    # Payloads of the plan in turn where the poses of the task have none.
    q = task_joints(model, constraints, region, seed) if task is None else task.q
    q, payload = given(q, "the poses of the task have no joint columns"), None if task is None else task.payload
    # Random numbers of the task's approaches, apart from those of the candidates.
    task_poses = conditions.at(q, conditions.in_turn(q.shape[1]) if payload is None else payload, 6)
    record = model_fit(robot)
    errors = expected_noise(model, task_poses, record, noise, noise_orientation, repeatability, unexplained)
    scatter = repeatability_at_target(model, task_poses, errors.joints)
    # Poses measured already, or else those of the model's fit.
    n_known = 0 if measured is None else measured.n
    if measured is None and record is not None and purpose == "calibrate":
        n_known = record.n_poses
    count = _count(poses or (BATCH if n_known else None), default_count, demands, pool)

    expectation = expectation_of(model, rows_of_pool, task_poses, errors, measured, record)
    planned, rows = expectation.planned, expectation.rows
    accuracy = worth = power = None
    if purpose == "acceptance":
        n = pool.n_poses
        position, q = pool.position[:, :n], pool.q[:, :n]
        allowed = np.arange(n) if region is None else np.flatnonzero(region.contains(position))
        refuse(
            (
                allowed.size < count,
                f"{count} poses are planned, but only {allowed.size} feasible candidates lie in `region`; give a "
                "larger region or more `candidates`",
            )
        )
        # Poses come in an order in which every first part represents the task, so each payload's poses do so too.
        chosen = allowed[spread_poses(position[:, allowed], q[:, allowed], count, seed)] + n * (
            np.arange(count) % pool.n_payloads
        )
    elif purpose == "trace":
        problem, power_criterion = power_problem(model, rows_of_pool, errors, measured)
        chosen = choose_for_power(problem, count, seed)
        power = expected_power(problem, power_criterion, chosen, seed)
    else:
        design = fit_design(expectation, criterion, is_of_zeros=purpose == "health")
        # The beginnings of a greedy design are those of fewer poses.
        order = design.best(count if purpose == "health" else 2 * count + BATCH)
        chosen = choose(design, order[:count], seed)
    if purpose == "calibrate":
        accuracy = expected_accuracy(expectation, design, order, chosen, seed)
        # As many measurements of new poses, of half as many poses twice, and of two readings of each.
        repeated, readings = (
            candidate_rows(model, rows_of_pool.subset(chosen), errors.reduced(*times))[:, :, planned.columns]
            for times in ((2, 1), (1, 2))
        )
        worth = worth_of(
            expectation, (rows[exchanged(design, order[: 2 * count], CURVE_EXCHANGED)], repeated, readings)
        )
        if pool.in_sockets:
            free = Model.of(replace(robot, fixtures={}), model.free)
            anywhere = conditions.with_payloads(sampled_candidates(free, constraints, n_candidates, seed))
            by_tracker = expected_noise(free, task_poses, record, None, None, repeatability, unexplained)
            poses_anywhere = conditions.at(anywhere.q, anywhere.payload)
            tracked = expectation_of(free, poses_anywhere, task_poses, by_tracker, None, record)
            problem = fit_design(tracked, criterion)
            best = choose(problem, problem.best(count), seed)
            accuracy = {**accuracy, "of_tracker": tracked.point_of(best, seed)}

    # Names of given candidates, else numbers that go on from those measured already.
    first = 1 if already is None else int(already.groups().max(initial=-1)) + 2
    digits = len(str(first + count))
    if repeats is None:
        repeats = 0 if already is not None else count if purpose == "health" else count // 10
    ids = np.array([f"P{first + i:0{digits}d}" for i in range(count)]) if pool.ids is None else pool.ids[chosen]
    payload = None if pool.payload is None else pool.payload[chosen]
    sequence = route(pool.q[:, chosen], payload, repeats, check_every if already is None else 0, seed)
    visits = planned_visits(robot, pool, chosen[sequence.visits], ids[sequence.visits])
    # Repeats and checks are measurements too, and the order gives the approaches.
    new, data = timed_visits(robot, visits, conditions, measured)
    covariance = expectation.covariance(whitened_rows(model, new, errors)[:, :, planned.columns])
    # Coordinates: 3 of a position, 6 with the orientation.
    n, components, n_coefficients = count + n_known, rows.shape[1], planned.columns.size
    warnings = applying(
        (
            purpose != "acceptance" and components * n < n_coefficients,
            f"{n} pose{'s' * (n != 1)} measure {components * n} coordinates, fewer than the {n_coefficients} "
            "coefficients of the fit: the fit would stay near the nominal model in some directions and be arbitrary in "
            f"others; plan at least {math.ceil(n_coefficients / components) - n_known} poses, and more for a check on "
            "held-out poses",
        ),
        (not rows_of_pool.has_length, NO_LENGTH),
    )
    return CampaignPlan(
        robot,
        purpose,
        criterion,
        fit,
        constraints,
        payloads,
        pool,
        chosen,
        sequence,
        visits,
        _validation(model, conditions, replace(constraints, inside=region or constraints.inside), validation, seed),
        errors,
        scatter,
        coefficients=expected_coefficients(planned, covariance),
        correlations=() if covariance is None else correlations(planned.names, covariance),
        accuracy=accuracy,
        worth=worth,
        detectability=detectability(model, data, errors) if purpose != "acceptance" else None,
        needed=demands,
        sufficiency=sufficiency_of(expectation, chosen, n_known, target, already is None) if n_known else None,
        power=power,
        warnings=warnings,
    )


def _count(count: int | None, default: int, demands: Sequence[Mapping[str, Any]], candidates: CandidatePoses) -> int:
    """Return the number of poses: ``count`` as given, else what decides all demands."""
    refuse(
        *(
            (
                count is None and demand["n_poses"] is None,
                f"no number of poses up to {MOST_POSES} decides {demand['name']} if the true value is "
                f"{demand['true_over_limit']:.2g} times the limit; give `expected` farther from the limit, or `poses`",
            )
            for demand in demands
        )
    )
    count = count or max((entry["n_poses"] or 0 for entry in demands), default=default)
    most = "".join(f"; most of the others are excluded by: {each['reason']}" for each in candidates.excluded[:1])
    feasible = f"only {candidates.n} candidate{'s are' if candidates.n > 1 else ' is'} feasible"
    refuse((count > candidates.n, f"{count} poses are planned, but {feasible}{most}"))
    return int(count)


def _validation(
    model: Model, conditions: Conditions, constraints: Constraints, count: int, seed: int
) -> Measurements | None:
    """Return the validation poses in the order of their visits."""
    if not count:
        return None
    pool = sampled_candidates(model, constraints, 10 * count, seed + 2)
    refuse((pool.n < count, f"only {pool.n} of {count} validation poses are feasible"))
    q, payload = pool.q[:, :count], conditions.in_turn(count)
    visits = route(q, payload, 0, 0, seed).visits
    ids = np.array([f"V{i + 1:0{len(str(count))}d}" for i in range(count)])
    return _to_measure(model.arm.robot, q[:, visits], ids, None if payload is None else payload[visits])
