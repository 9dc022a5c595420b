"""Expected result of a campaign before anything is measured: its linear model, standard errors, accuracy and power.

The linear model has the whitened columns of the coefficients at planned poses, their priors, and the task's region.
"""

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from robacc.effects.base import Effect, Term, effect_class
from robacc.effects.specification import build, every_column, parse_requests
from robacc.fitting.fit_result import Dropped, identify_terms
from robacc.fitting.levels import ACCEPTED, NEW, ROUNDS
from robacc.fitting.normal_equations import whitening
from robacc.fitting.solver import BADLY_MADE, broad_stds, tolerance_priors
from robacc.fitting.visits import visit_numbers
from robacc.geometry import Array, NDArray, rms_length
from robacc.measurements import Measurements
from robacc.modelling.model import Model, joint_columns
from robacc.planning.design import (
    DesignProblem,
    PowerCriterion,
    choose,
    exchanged,
    information_of,
    random_designs,
    region_variance,
)
from robacc.robots.description import Robot
from robacc.tracing.candidates import Candidate, decisive_test, named_candidates, visible


@dataclass(frozen=True, slots=True)
class ExpectedNoise:
    """Errors that no model predicts, as standard deviations."""

    position: float
    """Instrument, along each axis, m."""
    orientation: float | None
    """Instrument, about each axis, rad; None where orientation is not measured."""
    joints: Array
    """``(J,)`` repeatability of each joint, rad or m."""
    unexplained: float
    """Error of the model that stays the same at one pose and differs from pose to pose, along each axis, m."""
    source: str

    def reduced(self, visits: int, readings: int) -> "ExpectedNoise":
        """Return the noise of the mean over ``visits`` of each pose, with ``readings`` at each visit."""
        share = 1.0 / np.sqrt(visits * readings)
        return replace(
            self,
            position=self.position * share,
            orientation=None if self.orientation is None else self.orientation * share,
            joints=self.joints / np.sqrt(visits),
        )


@dataclass(frozen=True, slots=True)
class PlannedCoefficients:
    """Coefficients that the campaign determines, with their priors."""

    terms: tuple[Term, ...]
    """Every coefficient of the free effects."""
    columns: NDArray[np.int64]
    """``(P,)`` numbers of the coefficients that are identifiable on some poses."""
    dropped: tuple[Dropped, ...]
    """Coefficients that no poses identify."""
    prior_std: Array
    """``(P,)`` prior standard deviations for the choice of poses: tolerance, else wide."""
    broad_std: Array
    """``(P,)`` standard deviation of the fit's broad prior of constants; inf for other coefficients."""

    @property
    def names(self) -> list[str]:
        """Names of the identifiable coefficients."""
        return [self.terms[i].name for i in self.columns]


def free_effects(robot: Robot, fit: str) -> tuple[Effect, ...]:
    """Return the effects of a list such as ``base_frame,joint_offset[j2]``.

    Raises:
        UsageError: One of them does not exist or cannot be fitted to the robot.
    """
    arm = Model.of(robot).arm
    return build(parse_requests(fit), arm, every_column(arm))


def with_targets(robot: Robot, poses: Measurements) -> Measurements:
    """Return unmeasured poses with every target at each pose, poses in order, targets innermost."""
    names = np.array(tuple(robot.targets))
    every = np.repeat(np.arange(poses.n), names.size)
    return replace(poses.subset(every), target=np.tile(names, poses.n)) if names.size else poses


def _jacobian(model: Model, data: Measurements, more: Iterable[Term] = ()) -> Array:
    """Return ``(6, P, N)`` columns of the model's free coefficients, then of ``more`` terms, for the rows of data."""
    bound = model.bind(data)
    extended = replace(bound, terms=(*bound.terms, *more))
    return extended.linearise(np.zeros(len(extended.terms)))[1]


def whitened_rows(model: Model, data: Measurements, noise: ExpectedNoise, more: Iterable[Term] = ()) -> Array:
    """Return ``(N, M, P)`` columns of the free coefficients, then of ``more`` terms, for the rows of ``data``.

    They are in units of the noise: instrument, repeatability and unexplained error.
    """
    size = 3 if noise.orientation is None else 6
    weight = np.full((size, data.n), 1.0 / np.hypot(noise.position, noise.unexplained))
    if noise.orientation is not None:
        weight[3:] = 1.0 / noise.orientation
    white = whitening(weight, joint_columns(model, data)[:size], noise.joints, visit_numbers(data))
    return white.apply(np.moveaxis(_jacobian(model, data, more)[:size], 1, 0)).T


def candidate_rows(model: Model, poses: Measurements, noise: ExpectedNoise, more: Iterable[Term] = ()) -> Array:
    """Return ``(N, M, P)`` the same of N unmeasured poses; M counts the components of all targets."""
    rows = np.ascontiguousarray(whitened_rows(model, with_targets(model.arm.robot, poses), noise, more))
    return rows.reshape(poses.n, -1, rows.shape[2])


def region_rows(model: Model, task: Measurements) -> Array:
    """Return ``(3, T, P)`` displacement of each target by each coefficient at the task's poses, m."""
    return np.ascontiguousarray(np.moveaxis(_jacobian(model, with_targets(model.arm.robot, task))[:3], 1, 2))


def coefficients(model: Model, rows: Array) -> PlannedCoefficients:
    """Return the coefficients that the candidates' ``rows`` ``(N, M, P)`` identify, and their priors."""
    bound = [effect.terms(model.arm, every_column(model.arm)) for effect in model.free]
    terms = tuple(term for own in bound for term in own)
    owners = [number for number, own in enumerate(bound) for _ in own]
    # Poses that decide which coefficients any poses identify.
    flat = rows[:: max(1, rows.shape[0] // 1500)].reshape(-1, rows.shape[2])
    identified = identify_terms(np.asarray(np.linalg.qr(flat, mode="r")), terms, flat.shape[0])
    columns = identified.columns
    tolerance = tolerance_priors(model.arm.robot)
    broad = broad_stds(model, terms, owners)
    # Prior standard deviation for the choice of poses: without a tolerance ten times the usual size, and 1 m or rad of
    # base and tool frames, which may be anywhere.
    prior = np.array(
        [
            tolerance.get(term.name) or (10.0 * term.typical if is_constant or term.typical < 1e-3 else 1.0)
            for term, is_constant in zip(terms, np.isfinite(broad), strict=True)
        ]
    )
    return PlannedCoefficients(terms, columns, identified.dropped, prior[columns], broad[columns])


def repeatability_at_target(model: Model, task: Measurements, joints: Array) -> float:
    """Return the scatter of the target along each axis, m rms, that joints' scatter ``(J,)`` gives over the task."""
    moved = joint_columns(model, with_targets(model.arm.robot, task))[:3] * joints[:, None]
    return float(np.sqrt(np.mean(np.sum(np.square(moved), axis=(0, 1))) / 3.0))


def joint_repeatability(model: Model, task: Measurements, size: float) -> Array:
    """Return ``(J,)`` equal scatter of all rotary joints that gives the target ``size`` m rms along each axis."""
    is_rotary = np.array([model.arm.is_revolute(name) for name in model.arm.names])
    if not is_rotary.any():
        return np.full(is_rotary.size, size)
    angle = size / repeatability_at_target(model, task, is_rotary.astype(np.float64))
    return np.asarray(np.where(is_rotary, angle, size / np.sqrt(3.0)))


ENOUGH_GAIN = 0.1
"""Ten more poses are not worth their time if they reduce the predicted error by less than this share."""
BATCH = 10
CURVE_EXCHANGED = 200
"""Candidates that exchange looks at for a point of the curve."""


def expected_coefficients(planned: PlannedCoefficients, covariance: Array | None) -> Sequence[Mapping[str, Any]]:
    """Return the predicted standard error of every coefficient, in the order of the effects, with the result's keys.

    It is None for a coefficient that is not identifiable, for the reason ``why``.
    """
    why = {entry.name: entry.why for entry in planned.dropped}
    result: list[dict[str, Any]] = [
        {"name": term.name, "unit": term.unit, "std": None, "prior_std": None, "why": why.get(term.name)}
        for term in planned.terms
    ]
    for i, column in enumerate(planned.columns.tolist()):
        result[column] |= {
            "std": None if covariance is None else float(np.sqrt(covariance[i, i])),
            "prior_std": float(planned.prior_std[i]),
            "why": "the planned poses are too few for this model" if covariance is None else None,
        }
    return result


@dataclass(frozen=True, slots=True)
class Expectation:
    """Computation of predicted errors for sets of candidates."""

    rows: Array
    """``(N, M, P)`` whitened columns of the candidates, identifiable coefficients."""
    region: Array
    """``(3, T, P)`` displacement of the target at the task's poses, m."""
    planned: PlannedCoefficients
    already: Array
    """``(P, P)`` information of poses measured already."""
    floor: float
    """Error that no fit removes, m: repeatability and unexplained error, length of the vector, rms."""

    def covariance(self, rows: Array) -> Array | None:
        """Return ``(P, P)`` covariance of the errors of a fit to poses ``(n, M, P)`` and those measured already.

        It is the mean over arms whose constants deviate by their usual size. Constants have the fit's broad prior
        (:mod:`robacc.fitting.priors`). None where the poses do not suffice.
        """
        normal = self.already + information_of(rows)
        scale, broad = np.sqrt(np.maximum(np.diag(normal), 1e-300)), np.square(self.planned.broad_std)
        usual = np.where(np.isfinite(broad), broad / BADLY_MADE**2, 0.0)
        estimated = usual
        for _ in range(ROUNDS):
            # Mean slope of a Cauchy prior's pull c / (b^2 + c^2 / 2) on estimates c of this variance, to first order.
            precision = 1.0 / (broad + 1.5 * estimated)
            scaled = (normal + np.diag(precision)) / scale[:, None] / scale
            # Condition number above which an information matrix counts as singular.
            if np.linalg.cond(scaled) > 1e14:
                return None
            gain = np.linalg.inv(scaled) / scale[:, None] / scale
            estimated = np.diag(gain @ (normal + normal * usual @ normal) @ gain)
        # The prior is wider than the usual deviations, so the error is less than the posterior covariance says.
        return np.asarray(gain @ (normal + np.diag(np.square(precision) * usual)) @ gain)

    def point(self, rows: Array, random_rms: float | None = None) -> dict[str, Any] | None:
        """Return the predicted errors over the region after a fit to poses ``(n, M, P)``, with the keys of the result.

        They are the root of the mean variance from the coefficients' uncertainty, that at the worst task pose, and the
        first with what no fit removes; beside them is the mean of random poses. None where the poses do not suffice.
        """
        covariance = self.covariance(rows)
        if covariance is None:
            return None
        variance = region_variance(self.region, covariance)
        mean = float(np.mean(variance))
        return {
            "n_poses": rows.shape[0],
            "rms_m": mean**0.5,
            "worst_m": float(variance.max()) ** 0.5,
            "total_rms_m": (mean + self.floor**2) ** 0.5,
            "random_rms_m": random_rms,
        }

    def point_of(self, chosen: NDArray[np.int64], seed: int) -> dict[str, Any] | None:
        """Return the predicted errors after a fit to the candidates ``chosen``, beside those of random poses."""
        return self.point(self.rows[chosen], self.random_rms(chosen.size, seed))

    def random_rms(self, n: int, seed: int) -> float | None:
        """Return the mean RMS of ``n`` random feasible poses over several draws; None if a draw does not suffice."""
        points = [self.point(self.rows[at]) for at in random_designs(self.rows.shape[0], n, n, seed)]
        values = [point["rms_m"] for point in points if point is not None]
        return float(np.mean(values)) if len(values) == len(points) else None


def expected_accuracy(
    expectation: Expectation, problem: DesignProblem, order: NDArray[np.int64], chosen: NDArray[np.int64], seed: int
) -> Mapping[str, Any]:
    """Return the predicted accuracy over the number of poses, planned and random, and of the chosen poses.

    It has the keys of the result. The curve ends at the number of poses in ``order``, a greedy design. Its knee is the
    number from which ten more poses gain little.
    """
    _, n_rows, n_coefficients = problem.rows.shape
    first = BATCH // 2 if expectation.already.any() else -(-n_coefficients // n_rows) + 2
    # Numbers of poses, besides the planned number, that the curve has at most.
    points = {}
    for n in {*np.round(np.geomspace(min(first, order.size), order.size, 8)).astype(int).tolist(), chosen.size}:
        design = chosen if n == chosen.size else exchanged(problem, order[:n], CURVE_EXCHANGED)
        points[n] = expectation.point_of(design, seed)
    curve, knee = [point for _, point in sorted(points.items()) if point is not None], None
    if len(curve) > 1:
        # Between the points, the logarithm of the error is linear in that of the number.
        log_n, log_total = np.log([(point["n_poses"], point["total_rms_m"]) for point in curve]).T
        counts = np.arange(curve[0]["n_poses"], curve[-1]["n_poses"] - BATCH + 1)
        now, later = (np.interp(np.log(n), log_n, log_total) for n in (counts, counts + BATCH))
        knee = next(iter(counts[later - now > np.log(1.0 - ENOUGH_GAIN)].tolist()), None)
    return {"planned": points[chosen.size], "curve": curve, "of_tracker": None, "knee": knee}


def worth_of(expectation: Expectation, efforts: tuple[Array, Array, Array]) -> Mapping[str, Any]:
    """Return the comparison of rows ``(n, M, P)`` of new poses, repeats, and readings, with the keys of the result.

    They are predicted RMS errors over the region for equal effort, m, and the verdict in words.
    """
    points = [expectation.point(rows) for rows in efforts]
    names = ("new poses are", "a second visit of every pose is", "a second reading at every pose is")
    known = [(point["total_rms_m"], name) for name, point in zip(names, points, strict=True) if point is not None]
    new, repeated, readings = (None if point is None else point["rms_m"] for point in points)
    return {
        "new_poses_rms_m": new,
        "repeated_poses_rms_m": repeated,
        "readings_rms_m": readings,
        "verdict": f"{min(known)[1]} worth most" if known else "the planned poses are too few for this model",
    }


def sufficiency_of(
    expectation: Expectation, chosen: NDArray[np.int64], n: int, target: float | None, of_model: bool
) -> Mapping[str, Any]:
    """Return whether ``n`` known poses are enough, with the next poses ``chosen``, with the keys of the result.

    Args:
        expectation: Predicted errors, with the information of the known poses.
        chosen: Next poses.
        n: Number of known poses.
        target: Predicted error that is good enough, m; None to ask what the next poses gain.
        of_model: The known poses are those that the model was fitted to.
    """
    now = expectation.point(expectation.rows[:0])
    later = expectation.point(expectation.rows[chosen])
    if now is None or later is None:
        enough, why = False, "the poses so far do not identify all coefficients"
    elif target is not None:
        enough = now["rms_m"] <= target
        why = f"the predicted error of {now['rms_m'] * 1e3:.3g} mm {'meets' if enough else 'exceeds'} the target"
    else:
        gain = 1.0 - later["total_rms_m"] / now["total_rms_m"]
        enough, why = gain < ENOUGH_GAIN, f"{chosen.size} more poses reduce the predicted error by {100 * gain:.0f} %"
    return {
        "n_already": n,
        "enough": enough,
        "why": why,
        "now_m": None if now is None else now["total_rms_m"],
        "later_m": None if later is None else later["total_rms_m"],
        "of_model": of_model,
    }


# Detection limits and power of every effect at planned poses, and pairs of effects that are not distinguishable.
#
# The poses are in their planned order, so directions and speeds of approach and the time are known. The noise is known
# too; the test is that of a trace (:func:`robacc.tracing.candidates.decisive_test`).


def detectability(model: Model, data: Measurements, noise: ExpectedNoise) -> Mapping[str, Any]:
    """Return what a trace of the rows of ``data`` in their order finds, given the free effects of ``model``.

    ``limits`` are the detection limits of every form of an effect, with the power at its usual size. ``pairs`` are
    effects of which the second explains the first, at its usual size, within the noise: the largest cosine between the
    new parts of their columns, and the expected difference in evidence if the first is the truth. ``missing`` is the
    reason why an effect cannot be tested, by effect.
    """
    pool, missing = named_candidates(model.arm, data, model.free)
    named = [(c, {term.name for term in c.terms}) for c in pool if len({term.unit for term in c.terms}) == 1]
    pool = [c for c, names in named if not any(other < names for _, other in named)]
    catalogue = _catalogue(pool)
    number = {key: i for i, key in enumerate(catalogue)}
    rows = whitened_rows(model, data, noise, (term for term, _ in catalogue.values()))
    count = rows.shape[2] - len(catalogue)
    flat = rows.reshape(-1, rows.shape[2])
    identified, columns = coefficients(model, rows[:, :, :count]).columns, flat[:, count:]
    new = _without(flat[:, identified], columns)
    gram, lengths = new.T @ new, np.sum(np.square(columns), axis=0)
    dof = float(columns.shape[0] - identified.size)
    if dof <= 0:
        return {"limits": (), "pairs": (), "missing": missing}
    tested = []
    for candidate in pool:
        effect, first = candidate.effect, candidate.terms[0]
        place = np.array([number[effect.term_key(term)] for term in candidate.terms], dtype=np.int64)
        values, vectors = visible(gram[np.ix_(place, place)], lengths[place])
        size, rms, usual, power = None, None, usual_size(effect.name), 0.0
        if values[0] > 0:
            test = decisive_test(values.size, dof, candidate.log_prior_of_size)
            needed = test.noncentrality_at_limit
            noncentrality = usual**2 * float(values[0])
            # Beyond ten times the noncentrality at probability 1/2 an effect is found for certain, to nine digits.
            power = 1.0 if noncentrality > 10.0 * needed else test.power(noncentrality)
            limit = math.sqrt(needed / float(values[0]))
            # A larger limit says no more than that the effect is not found.
            if limit <= 300.0 * first.typical:
                moved = rows[:, :3, count + place] @ vectors[:, 0] * math.hypot(noise.position, noise.unexplained)
                size, rms = limit, limit * rms_length(moved.T)
        tested.append(
            (
                place,
                {
                    "effect": effect.name,
                    "joints": effect.joints,
                    "settings": effect.settings(),
                    "limit": size,
                    "unit": first.unit,
                    "usual_size": usual,
                    "power": power,
                    "rms_m": rms,
                },
            )
        )
    return {"limits": [limit for _, limit in tested], "pairs": _pairs(tested, gram), "missing": missing}


def usual_size(effect: str) -> float:
    """Return the geometric mean of the catalogue's usual range of a coefficient."""
    low, high = effect_class(effect).about.usual_range
    return math.sqrt(low * high)


def _label(limit: Mapping[str, Any]) -> str:
    """Return ``backlash[j2]``, with settings."""
    settings = ", ".join(f"{key} {_text(value)}" for key, value in limit["settings"].items())
    joints = ",".join(limit["joints"])
    return f"{limit['effect']}{f'[{joints}]' * bool(joints)}{f' ({settings})' * bool(settings)}"


def _text(value: object) -> str:
    """Return a setting as text: the members of a list with ``+`` between them."""
    if isinstance(value, list | tuple):
        return "+".join(map(_text, value))
    return f"{value:g}" if isinstance(value, float) else str(value)


def _catalogue(pool: Sequence[Candidate]) -> dict[str, tuple[Term, Candidate]]:
    """Return each coefficient of the candidates once, with the first candidate that has it."""
    result: dict[str, tuple[Term, Candidate]] = {}
    for candidate in pool:
        for term in candidate.terms:
            result.setdefault(candidate.effect.term_key(term), (term, candidate))
    return result


def _without(base: Array, columns: Array) -> Array:
    """Return the part of ``columns`` that is orthogonal to ``base``, taken out twice for the sake of rounding."""
    basis = np.linalg.qr(base / np.linalg.norm(base, axis=0))[0]
    for _ in range(2):
        columns = columns - basis @ (basis.T @ columns)
    return columns


def _pairs(tested: Sequence[tuple[NDArray[np.int64], Mapping[str, Any]]], gram: Array) -> list[dict[str, Any]]:
    """Return the pairs of detectable effects, one form for each effect and joint, that are not distinguishable.

    ``tested`` has the columns of each form in the products ``gram`` of new parts, and its limit.
    """
    first_forms: dict[tuple[str, tuple[str, ...]], tuple[NDArray[np.int64], Mapping[str, Any]]] = {}
    for place, limit in tested:
        # Power from which an effect counts as detectable at its usual size.
        if limit["power"] >= 0.5:
            first_forms.setdefault((limit["effect"], limit["joints"]), (place, limit))
    pairs = []
    for (place, limit), (other, rival) in itertools.permutations(first_forms.values(), 2):
        block, cross = gram[np.ix_(place, place)], gram[np.ix_(place, other)]
        explained = cross @ np.linalg.pinv(gram[np.ix_(other, other)], rcond=1e-9) @ cross.T
        evidence = 0.5 * limit["usual_size"] ** 2 * max(float(np.linalg.eigvalsh(block - explained)[0]), 0.0)
        if evidence < ACCEPTED:
            whitener = np.linalg.pinv(block, rcond=1e-12, hermitian=True)
            square = float(np.linalg.eigvals(whitener @ explained).real.max())
            pairs.append(
                {
                    "first": _label(limit),
                    "second": _label(rival),
                    "similarity": math.sqrt(min(max(square, 0.0), 1.0)),
                    "evidence": evidence,
                }
            )
    return sorted(pairs, key=lambda pair: (-round(pair["similarity"], 9), pair["evidence"]))


# Choice of poses for a trace.


def choose_for_power(problem: DesignProblem, count: int, seed: int) -> NDArray[np.int64]:
    """Return ``count`` different candidates, chosen among some drawn at random."""
    # More than 800 candidates gain little.
    pool = np.random.default_rng([seed, 5]).permutation(problem.rows.shape[0])[: max(800, count)]
    part = replace(problem, rows=problem.rows[pool])
    return pool[choose(part, part.best(count), seed, 100)]


def power_problem(
    model: Model, candidates: Measurements, noise: ExpectedNoise, already: Measurements | None
) -> tuple[DesignProblem, PowerCriterion]:
    """Return the problem of choosing among ``candidates``, whose directions and speeds of approach are random.

    ``already`` has the commanded part of the poses measured already.
    """
    catalogue = _catalogue(named_candidates(model.arm, with_targets(model.arm.robot, candidates), model.free)[0])
    rows = candidate_rows(model, candidates, noise, (term for term, _ in catalogue.values()))
    count = rows.shape[2] - len(catalogue)
    planned = coefficients(model, rows[:, :, :count])
    n_free, n_effects = planned.columns.size, len(catalogue)
    used = np.concatenate((planned.columns, count + np.arange(n_effects)))
    # In units of the priors, and of the usual sizes.
    scale = np.append(planned.prior_std, [usual_size(candidate.effect.name) for _, candidate in catalogue.values()])
    rows = rows[:, :, used] * scale
    information = np.diag(np.repeat([1.0, 0.0], [n_free, n_effects]))
    if already is not None:
        available = _catalogue(named_candidates(model.arm, already, model.free)[0])
        # A term that the poses measured already do not have is zero there.
        terms = [available.get(key, (term._replace(parts=()),))[0] for key, (term, _) in catalogue.items()]
        information += information_of(whitened_rows(model, already, noise, terms)[:, :, used] * scale)
    dof = float(rows.shape[1] * max(30 + (0 if already is None else already.n), 60) - n_free)
    log_priors = [candidate.log_prior_of_size for _, candidate in catalogue.values()]
    chance = {value: decisive_test(1, dof, value).noncentrality_at_limit for value in set(log_priors)}
    flat = rows.reshape(-1, scale.size)
    columns = flat[:, n_free:]
    new = _without(flat[:, :n_free], columns)
    size = np.linalg.norm(new, axis=0)
    is_new = size > np.sqrt(NEW) * np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    new = new / np.where(is_new, size, np.inf)
    similarity = np.square(new.T @ new)
    similarity[similarity > 1.0 - NEW] = 0.0
    criterion = PowerCriterion(
        np.array([chance[value] for value in log_priors]),
        np.where(similarity.max(axis=1) > 0.0, np.argmax(similarity, axis=1), np.arange(size.size)),
    )
    return DesignProblem(rows, information, criterion), criterion
