"""`robacc trace`: search, findings with their rivals, errors before and after, remaining error, and the verdict."""

import contextlib
import dataclasses
import functools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from robacc.accuracy.estimation import PoseMetrics, pose_metrics
from robacc.diagnostics.data_mistakes import check_data
from robacc.diagnostics.partial_residuals import PartialResidual, partial_residuals
from robacc.diagnostics.recorded import Rounding, memory_of_play, unlogged_loads
from robacc.effects.base import Effect, effect_class
from robacc.effects.campaign import Step, place_text
from robacc.effects.periodic import order_tolerance, orders_of, origin_of
from robacc.effects.specification import CONSTANTS
from robacc.error_model.covariance import ErrorPart
from robacc.error_model.structure import (
    ErrorStructure,
    Repeatability,
    correction_of_position,
    with_error_structure,
)
from robacc.errors import LISTED, RobaccError
from robacc.fitting.fit_result import Fit, HoldOut, Options
from robacc.fitting.levels import ACCEPTED, ALIKE, ENOUGH, EXAMPLES, FEW, NEGLIGIBLE, SAMPLE, SIGNIFICANT
from robacc.fitting.masses import UndeclaredLoad, undeclared_load
from robacc.fitting.outliers import outlier_pattern
from robacc.fitting.parameters import FittedParameter
from robacc.fitting.priors import shrink_to_nominal, without_idle_rotations
from robacc.fitting.registration import with_gravity_direction
from robacc.fitting.solver import fit, refit
from robacc.fitting.warnings import LackOfFit, suspected_mistakes
from robacc.geometry import Array, log_between, rms_length
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.robots.arm import Arm
from robacc.tracing.calibrating import Judged, Progress, judge, with_directional_weights
from robacc.tracing.search import (
    Alternative,
    DetectionLimit,
    Identified,
    SearchResult,
    SearchStep,
    detection_limits,
    search,
)

# Harmonics of a joint's periodic error, each with its amplitude and phase.


@dataclass(frozen=True, slots=True)
class Harmonic:
    """One order of a periodic error, amplitude x cos(order q - phase), q the joint's commanded angle; rad."""

    order: float
    amplitude: float
    amplitude_std: float | None
    """Standard error; None, as the phase's, if cosine and sine are not identifiable."""
    phase: float
    phase_std: float | None
    origin: str | None = None
    """Physical origin that the order agrees with; None if there is none."""
    aliases: tuple[float, ...] = ()
    """Other orders that the poses do not distinguish from it."""


def fitted_harmonics(
    effect: Effect,
    parameters: Sequence[FittedParameter],
    covariance: Array,
    arm: Arm,
    angle: Array,
    aliases: Sequence[float],
) -> tuple[Harmonic, ...]:
    """Return the harmonics of an effect, strongest first, from its parameters: cosine and sine of each order.

    A part of a turn does not separate the orders of a profile. Its harmonics are therefore the waves that describe it
    over the measured angles by least squares, each in what the stronger ones leave (matching pursuit; Mallat and Zhang
    1993), while the amplitude is two standard errors or more. Standard errors follow by the law of propagation (JCGM
    100, 5.2.2).

    Args:
        effect: A periodic error of a joint that turns.
        parameters: Its coefficients.
        covariance: ``(2 K, 2 K)``, of the coefficients; NaN where one is not identified.
        arm: The arm, whose gears are possible origins.
        angle: ``(N,)`` the joint's angle at the poses, rad.
        aliases: Orders that the poses do not distinguish from its own, if it has one.
    """
    orders, harmonics = orders_of(effect), list[Harmonic]()
    gear_ratio, tolerance = arm.joint(effect.joints[0]).gear_ratio, order_tolerance(float(np.ptp(angle)))
    values, maps = np.array([parameter.value for parameter in parameters]), np.eye(2 * len(orders))
    if effect.is_profile():
        phases = np.multiply.outer(orders, angle)
        waves = np.stack((np.cos(phases), np.sin(phases)), axis=1)
        designs = [np.vstack((np.ones_like(angle), *pair)).T for pair in waves]
        # The poses hardly distinguish other orders from a constant, such as less than half a period (condition 4.6).
        fits = [np.linalg.pinv(design)[1:] * (np.linalg.cond(design) < 5.0) for design in designs]
        maps = np.concatenate(fits) @ waves.reshape(-1, angle.size).T
    others = np.ones(len(orders), dtype=bool)
    for _ in range(min(len(orders), LISTED)):
        pairs = (maps @ values).reshape(-1, 2)
        sizes = np.where(others, np.linalg.norm(pairs, axis=1), -1.0)
        # Angles on a grid do not distinguish an order from those that the grid mirrors: then it is the lowest.
        k = int(np.argmax(sizes >= 0.99 * sizes.max()))
        own, (cosine, sine) = slice(2 * k, 2 * k + 2), pairs[k]
        amplitude = math.hypot(cosine, sine)
        rotation = np.array([[cosine, sine], [-sine, cosine]]) / max(amplitude, 1e-300) @ maps[own]
        variance = np.diag(rotation @ covariance @ rotation.T)
        along = across = None
        if amplitude > 0.0 and np.all(variance >= 0.0):
            along, across = math.sqrt(variance[0]), math.sqrt(variance[1]) / amplitude
        if effect.is_profile() and (along is None or amplitude <= 2.0 * along):
            break
        values[own] -= pairs[k]
        others[k] = False
        origin = origin_of(orders[k], gear_ratio, tolerance)
        harmonics.append(Harmonic(orders[k], amplitude, along, math.atan2(sine, cosine), across, origin))
    if len(harmonics) == 1:
        harmonics[0] = dataclasses.replace(harmonics[0], aliases=tuple(aliases))
    return tuple(harmonics)


def periodic_statement(effect: Effect, harmonics: Sequence[Harmonic], effects: Sequence[Effect] = ()) -> str | None:
    """Return the origins of a periodic error's orders, or that it has none and is a profile.

    ``effects`` are all findings. With a spring on the same joint, a counterbalance is a possible origin: a spring or
    cylinder of free length L between points at radii a and b of the axis turns the joint by its compliance times
    k a b sin(q + phi) (1 - L / sqrt(a^2 + b^2 + 2 a b cos(q + phi))): a function of the joint's angle alone, which
    orders 1 and 2 describe over a range of 2 rad.
    """
    springs = [other for other in effects if other.traits.is_spring and set(effect.joints) <= set(other.joints)]
    if springs and harmonics and all(harmonic.order < 3.0 for harmonic in harmonics):
        return (
            f"with {springs[0]}, a counterbalance across {effect.joints[0]} has the same shape: a spring or cylinder "
            "that the robot file does not state, whose torque follows the joint's angle"
        )
    origins = [f"order {harmonic.order:g}: {harmonic.origin}" for harmonic in harmonics if harmonic.origin is not None]
    if effect.is_profile() and not origins:
        return "a profile of the joint's error over its angle: no order agrees with a gear, a motor or an encoder"
    if not origins and harmonics:
        origins = ["no physical origin of this order is known: read it as a profile of the joint's error"]
    others = [f"{order:g}" for harmonic in harmonics for order in harmonic.aliases]
    if others:
        origins.append(f"orders {', '.join(others)} are not distinguishable from it on these poses")
    return "; ".join(origins) or None


@dataclass(frozen=True, slots=True)
class Finding:
    """One identified effect of a trace, with its test."""

    effect: str
    joints: tuple[str, ...]
    settings: dict[str, object]
    alternatives: tuple[Alternative, ...]
    p_value: float
    """Posterior probability that the effect is not there, prior odds of all candidates included."""
    evidence: float
    """Log Bayes factor."""
    held_out_before: float | None
    """Held-out position rms without it, m. None without held-out poses, and for a frame, without which nothing else
    can be fitted."""
    held_out_after: float | None
    parameters: tuple[FittedParameter, ...]
    harmonics: tuple[Harmonic, ...]
    validity: tuple[tuple[str, float, float], ...]
    """Validity range of each driver: name, low, high, SI."""
    implausible: str | None
    """Reason if the coefficients are beyond what the effect can be; else None."""
    warnings: tuple[str, ...]
    partial_residuals: tuple[PartialResidual, ...]
    """Partial residual of the effect over each driver, without and with it."""
    size_at_tool: float | None
    """RMS over the calibration poses of the distance by which the effect alone moves the target, m. None if the arm
    without the effect cannot be evaluated."""
    largest_at_tool: float | None
    """Largest such distance, m."""
    statement: str | None = None
    """What the finding means and what to do; None if its coefficients say it."""
    change: tuple[float, float, float] | None = None
    """Place of a step (s or line), and the first and last place of its 95 % interval."""
    held_out_turn: tuple[float | None, float | None] = (None, None)
    """Held-out orientation rms without it and with it, rad; None where orientation is not measured, or as above."""
    turn_at_tool: tuple[float | None, float | None] = (None, None)
    """RMS and largest angle by which the effect alone turns the target, rad; None where orientation is not measured, or
    as ``size_at_tool``."""


def describe_finding(
    identified: Identified,
    others: Sequence[Effect],
    judged: Judged,
    without: Array | None,
    data: Measurements,
) -> Finding:
    """Return the finding of an effect: its rivals, held-out errors, and parameters in the final fit.

    ``others`` are all findings, ``without`` the residuals of held-out poses without this one.
    """
    final, effect = judged.fit, identified.effect
    arm, number = final.model.arm, final.model.free.index(effect)
    columns = [i for i, owner in enumerate(final.owners) if owner == number]
    after, apart = _rms(judged.after.held_out_inliers or judged.after.held_out), judged.after.held_out_inliers_mask
    # Without a frame nothing else can be fitted.
    before = _rms(None if without is None or effect.traits.is_frame else pose_metrics(without[:, apart]))
    coefficients = tuple(judged.parameters[i] for i in columns)
    change = between = None
    if isinstance(effect, Step) and identified.places is not None:
        place, low, high = change = (effect.place, *identified.places)
        between = (place_text(place, effect, data), place_text(low, effect, data), place_text(high, effect, data))
    values = {parameter.name: parameter.value for parameter in coefficients}
    statement, harmonics = effect.statement(arm, values, between), tuple[Harmonic, ...]()
    if orders_of(effect) and all(map(arm.is_revolute, effect.joints)):
        assert data.q is not None
        covariance, angle = final.covariance[np.ix_(columns, columns)], data.q[arm.number(effect.joints[0])]
        harmonics = fitted_harmonics(effect, coefficients, covariance, arm, angle, identified.aliases)
        statement = periodic_statement(effect, harmonics, others) if harmonics else statement
    implausible = effect.implausible([final.terms[i] for i in columns], [float(final.theta[i]) for i in columns])
    warnings = [] if implausible is None else [implausible]
    # Distances and angles by which the effect alone moves the target at the inliers.
    of_position: tuple[float | None, float | None] = (None, None)
    of_orientation, moved = of_position, np.zeros(0)
    with contextlib.suppress(RobaccError):
        alone = final.model.bind(data).poses(np.where(np.array(final.owners) == number, 0.0, final.theta))
        moved = np.linalg.norm((alone.translation - final.poses.translation)[:, final.inliers], axis=0)
        of_position = _rms_and_largest(moved)
        if data.rotation is not None:
            turned = log_between(alone.rotation, final.poses.rotation)[:, final.inliers]
            of_orientation = _rms_and_largest(np.linalg.norm(turned, axis=0))
    if moved.any():
        share = np.sort(np.square(moved))[::-1]
        count = int(np.searchsorted(np.cumsum(share) / share.sum(), 0.5)) + 1
        if count < min(ENOUGH, NEGLIGIBLE * share.size):
            warnings.insert(0, f"more than half of the contribution of {effect} comes from only {count} poses")
    return Finding(
        effect.name,
        effect.joints,
        effect.settings(),
        identified.alternatives,
        identified.p_value,
        identified.evidence,
        before[0],
        after[0],
        coefficients,
        harmonics,
        tuple((driver, low, high) for driver, (low, high) in effect.validity(arm, data).items()),
        implausible,
        tuple(warnings),
        partial_residuals(effect, final, data),
        *of_position,
        statement,
        change,
        (before[1], after[1]),
        of_orientation,
    )


def _rms(metrics: PoseMetrics | None) -> tuple[float | None, float | None]:
    """Return the rms of position, m, and of orientation, rad; None where it is not measured, or nothing is held out."""
    if metrics is None:
        return None, None
    return metrics.position.rms, None if metrics.orientation is None else metrics.orientation.rms


def _rms_and_largest(sizes: Array) -> tuple[float, float]:
    return float(np.sqrt(np.mean(np.square(sizes)))), float(np.max(sizes))


# Error that remains after the findings of a trace, and hints on its cause.

_USUAL = 1.2e-4
"""Remaining error, m rms, that a laser tracker at some metres (0.03 to 0.05 mm along each axis) and a data sheet's
repeatability (0.02 to 0.1 mm) leave together."""
_LOOKS_LIKE: Mapping[ErrorPart, tuple[str, tuple[str, ...]]] = {
    "scatter": ("scatters from visit to visit", ("backlash", "friction_windup", "approach_lag")),
    "wander": ("wanders over time", ("thermal_expansion", "joint_warmup", "frame_drift")),
}
"""Parts of the error, what they look like, and effects that look so where their columns are missing."""


@dataclass(frozen=True, slots=True)
class Unexplained:
    """Remaining error after the findings."""

    rms: float
    """Root mean square of the fitted residual's length, m."""
    noise_rms: float | None
    """Root mean square of the measurement noise's length, m; None if neither file nor repeats give it."""
    structured: bool
    """Whether the error has a structure; each structure has a hint."""
    p_value: float
    hints: tuple[str, ...]
    parts: Mapping[ErrorPart, float]
    """Root mean square of each part at the target, m."""


def remaining_error(
    found: SearchResult,
    findings: Sequence[Finding],
    final: Fit,
    noise: LackOfFit,
    data: Measurements,
    structure: ErrorStructure,
    rounding: Rounding | None = None,
) -> Unexplained:
    """Return the error that remains after the findings, whether it has a structure, and hints on its cause."""
    hints = list(structure.warnings)
    if any(effect_class(finding.effect).traits.is_empirical for finding in findings):
        absent = [name for name in CONSTANTS if all(effect.name != name for effect in found.model.free)]
        hints.append(
            "joint_correction corrects an error that depends smoothly on the pose: no effect of the catalogue "
            "describes that error as well, so no cause is named"
            + f"; every arm deviates in {' and '.join(absent)} too, which were not declared: add {','.join(absent)} to "
            "the effects of `declared`" * bool(absent)
        )
    p_values = [0.0] if hints else [found.next[0].p_value] if found.next else [1.0]
    playing = {joint: effect for effect in final.model.free if effect.form.follows_approach for joint in effect.joints}
    memories = memory_of_play(final, data, tuple(playing))
    for joint, p_value in memories.items():
        if p_value * len(memories) <= SIGNIFICANT:
            p_values.append(p_value * len(memories))
            hints.append(
                f"in addition to {playing[joint]}, the errors of {joint} follow the change of its torque since the "
                "previous visit: its play has a memory (hysteresis), which the direction of approach alone does not "
                "describe"
            )
    if hints and (loads := unlogged_loads(final, data)) is not None:
        hints.insert(0, loads.text)
    rms, repeatability = rms_length(final.residual[:3, final.inliers]), structure.repeatability
    hints.extend(suspected_mistakes(final))
    pattern, share = outlier_pattern(data, ~final.inliers, final.model.arm.names), final.outliers.size / data.n
    if pattern is not None:
        hints.append(pattern)
    if share > FEW:
        hints.append(f"{final.outliers.size} of {data.n} rows ({100 * share:.0f} %) are outliers: too many for chance")
    # Of poses that are visited once, scatter of the joints looks like an effect outside the catalogue.
    is_shown = noise.p_value is not None or (repeatability is not None and repeatability.source == "repeated visits")
    if (
        (findings or repeatability is not None)
        and not is_shown
        and rms > math.hypot(_USUAL, 0.0 if rounding is None else ALIKE * rounding.position)
    ):
        hints.append(
            f"the remaining error, {1e3 * rms:.3g} mm rms, is larger than usual instrument noise and repeatability, "
            "and neither sigma columns nor repeated poses show that it is noise: part of it may have a cause outside "
            "the model, such as a load that was not recorded; measure some poses repeatedly"
        )
    if noise.p_value is not None and noise.p_value <= SIGNIFICANT:
        p_values.append(noise.p_value)
        source = "repeats" if noise.noise.source == "repeats" else "the file"
        hints.append(
            f"the residual is {noise.ratio:.3g} times the measurement noise (known from {source})"
            + "; no candidate explains this error: it is repeatability, or an effect outside the catalogue"
            * (not found.next or found.next[0].log_odds < ACCEPTED)
        )
    for part, (looks, names) in _LOOKS_LIKE.items() if hints else ():
        untested = [f"{name} ({found.pool.missing[name]})" for name in names if name in found.pool.missing]
        if untested and (size := structure.parts.get(part, 0.0)) > structure.parts["noise"]:
            hints.append(
                f"{1e3 * size:.2g} mm rms {looks}: it may be {' or '.join(untested)}, which were not tested; record "
                "what they need and trace again"
            )
    return Unexplained(
        rms=rms,
        noise_rms=None if noise.p_value is None else noise.rms,
        structured=bool(hints),
        p_value=min(p_values),
        hints=tuple(hints),
        parts=structure.parts,
    )


# Verdict of a trace, the assumption that it rests on, and the share of the error that the findings explain.

Verdict = Literal["clean", "explained", "partly_explained", "unexplained"]


def verdict_of(findings: Sequence[Finding], unexplained: Unexplained) -> Verdict:
    """Return the verdict on the findings and the error that remains after them."""
    if not findings:
        return "unexplained" if unexplained.structured else "clean"
    named = any(not effect_class(finding.effect).traits.is_empirical for finding in findings)
    plausible = all(finding.implausible is None for finding in findings)
    return "explained" if named and plausible and not unexplained.structured else "partly_explained"


def assumption_of(verdict: Verdict, noise: LackOfFit, repeatability: Repeatability | None) -> str | None:
    """Return what the verdict presumes of noise and repeatability that only the residual gives.

    None if they are known or not used.
    """
    if noise.p_value is not None or verdict not in ("clean", "explained"):
        return None
    presumed, test, least = [], "repeated poses", 0.0
    if repeatability is not None and repeatability.source == "residual":
        presumed.append(f"the arm's own repeatability is {1e3 * repeatability.position:.2g} mm rms at the target")
        least = NEGLIGIBLE * repeatability.position  # The residual alone separates them: next to no noise is left.
    if noise.noise.source not in ("file", "repeats") and noise.rms >= least:
        axes = noise.noise.along_axes
        sizes = ", ".join(f"{1e3 * std:.2g}" for std in axes or (noise.noise.position,))
        along = "each axis" if axes is None else "x, y, z"
        presumed.append(f"the measurement noise is {sizes} mm along {along} (standard deviation)")
        test = "sigma columns or repeated poses"
    return f"{verdict} if {' and '.join(presumed)}; {test} would test this" if presumed else None


# Poses to measure next: poses at which two rival effects predict most differently (T-optimal discrimination).
#
# Source of the criterion: A. C. Atkinson and V. V. Fedorov, "The design of experiments for discriminating between two
# rival models", Biometrika 62, 1975.


@dataclass(frozen=True, slots=True)
class Advice:
    """Poses that distinguish two effects."""

    text: str
    q: tuple[tuple[float, ...], ...]
    """Joint variables of each pose, rad or m."""
    difference: tuple[float, ...]
    """Distance between the two effects' predicted targets at each pose, m."""


def advise(
    declared: Fit,
    effects: Sequence[Effect],
    finding: Effect,
    alternative: Alternative,
    data: Measurements,
    noise: float,
    seed: int,
) -> Advice | None:
    """Return poses inside the joint limits (or the measured range) at which a finding and its alternative differ most.

    Both models are fitted to all poses. Circumstances other than the joints are sampled from the measured rows.
    """
    rival = effect_class(alternative.effect).from_settings(alternative.joints, alternative.settings)
    others = [effect for effect in effects if effect is not finding]
    assert data.q is not None
    low, high, generator = data.q.min(axis=1), data.q.max(axis=1), np.random.default_rng(seed)
    for i, joint in enumerate(declared.model.arm.robot.variables):
        if joint.limits is not None:
            low[i], high[i] = joint.limits
    rows = generator.integers(0, data.n, SAMPLE)
    q = low[:, None] + (high - low)[:, None] * generator.random((low.size, SAMPLE))
    trial = dataclasses.replace(data.subset(rows), q=q)
    try:
        first = fit(declared.model.with_free(*others, finding), data)
        second = fit(declared.model.with_free(*others, rival), data)
        predicted = [fitted.model.bind(trial).poses(fitted.theta).translation for fitted in (first, second)]
    except RobaccError:
        return None
    difference = np.linalg.norm(predicted[0] - predicted[1], axis=0)
    if difference.max() < 0.5 * noise:
        return Advice(
            f"{finding} and {rival} are not distinguishable at any pose within the joint limits: they differ by "
            f"at most {difference.max() * 1e3:.2g} mm; measure other data (another payload, an indicator on the base)",
            (),
            (),
        )
    # The pose of largest difference, then eligible poses that are far from those already chosen.
    scaled = q / np.maximum(np.ptp(q, axis=1), 1e-9)[:, None]
    eligible, chosen = np.flatnonzero(difference >= 0.5 * difference.max()), [int(np.argmax(difference))]
    while len(chosen) < min(EXAMPLES, eligible.size):
        gaps = np.linalg.norm(scaled[:, eligible, None] - scaled[:, None, chosen], axis=0).min(axis=1)
        chosen.append(int(eligible[np.argmax(gaps)]))
    return Advice(
        f"to distinguish {finding} from {rival}, measure:",
        tuple(tuple(pose) for pose in q[:, chosen].T.tolist()),
        tuple(difference[chosen].tolist()),
    )


# The trace: search, fits, and the result.


@dataclass(frozen=True)
class Trace(Judged):
    """Result of `robacc trace`; without findings there is no gain."""

    verdict: Verdict
    assumption: str | None
    """What the verdict presumes where the noise is known from the residual alone."""
    declared: Fit
    findings: tuple[Finding, ...]
    undeclared_load: UndeclaredLoad | None
    """Whether the torques point to a load on one link; None unless masses are uncertain."""
    unexplained: Unexplained
    explained_share: float | None
    """Share of the baseline's held-out variance above noise and repeatability that the findings explain."""
    steps: tuple[SearchStep, ...]
    settled: bool
    """Whether the search ended because no move gained."""
    missing: dict[str, str]
    detection: tuple[DetectionLimit, ...]
    """Detection limits of these poses, given the findings."""
    next_poses: tuple[Advice, ...]
    """Poses that distinguish a finding from its nearest rival."""


def trace(
    model: Model,
    data: Measurements,
    *,
    n_folds: int | None = None,
    seed: int = 0,
    holdout: Measurements | None = None,
    empirical: bool = True,
    progress: Progress = lambda stage, done, total: None,
    fitted_to_all: Callable[[Fit], Fit] = lambda fit: fit,
) -> Trace:
    """Search for effects on measured poses and report them with held-out errors.

    ``model`` holds the robot and the declared effects. Held-out figures are of models with the effects that all poses
    show, fitted without the pose: those of ``holdout``, of each place in turn, or of ``n_folds`` parts of the places.
    Where ``data`` are some poses of a large file, ``fitted_to_all`` fits the coefficients to all of them.

    Raises:
        InputError: the data contain a mistake that no effect should explain, or are too few.
        UsageError: the data lack a quantity that a declared effect needs.
    """
    declaring, poses, stated = model, data, model.arm.robot

    def run(data: Measurements) -> Trace:
        how, mistakes = HoldOut.of(data, holdout, n_folds, seed), check_data(stated, data)
        model = with_gravity_direction(declaring, data)

        def searching(count: int) -> None:
            progress(f"searching, {count} finding{'s' * (count != 1)}" if count else "searching", 0, 1)

        declared = without_idle_rotations(fit(model, data), model, data, Options())
        found = search(model, data, progress=searching)
        identified = [i for i in found.identified if empirical or not i.effect.is_profile()]
        own_places = HoldOut.of(data, None, None, seed)

        def fitted(some: Sequence[Identified]) -> Fit:
            """Return the fit with some effects."""
            if not some:
                return declared
            # Frames are first, so that they keep their parameters if poses cannot distinguish two.
            extended = model.with_free(
                *sorted((one.effect for one in some), key=lambda effect: not effect.traits.is_frame)
            )
            again = refit(declared, extended.free, data, Options(), found.coefficients)
            return again if again.group_stds else without_idle_rotations(again, extended, data, Options())

        final = fitted(identified)
        while useless := _useless(final, identified, own_places):
            identified = [one for one in identified if one not in useless]
            final = fitted(identified)

        def structured_beside(fitted: Fit) -> ErrorStructure:
            """Return a fit with the structure of its errors."""
            return with_error_structure(
                fitted,
                data,
                Options(),
                functools.partial(refit, fitted, fitted.model.free, data),
                tuple(found.state.noise.terms),
            )

        structured: ErrorStructure | None = None
        if empirical and (left := correction_of_position(final, data, found.state.noise)) is not None:
            correction = Identified(left[0], left[1], -left[2], 0.0)
            corrected = fitted([*identified, correction])
            # The scatter of visits may leave nothing to the correction.
            if not _useless(corrected, [correction], own_places) and not _useless(
                (beside := structured_beside(corrected)).fit, [correction], own_places
            ):
                identified.append(correction)
                structured = beside
        structured = structured or structured_beside(final)
        effects = [one.effect for one in identified]
        constants = [
            effect.name
            for effect in model.free
            if effect.name in CONSTANTS and effect.joints == effect.possible_joints(model.arm)
        ]
        final, _ = shrink_to_nominal(structured.fit, data, structured.options, constants)
        before = shrink_to_nominal(declared, data, Options(), constants)[0] if identified else final
        final = fitted_to_all(final)
        structured = dataclasses.replace(structured, fit=final)
        after, *without = how.residuals(final, [(), *([final.model.free.index(effect)] for effect in effects)])
        judged = judge(stated, mistakes, before, structured, data, how, after, effects)
        noise, repeatability, findings, advice = judged.noise, judged.repeatability, list[Finding](), list[Advice]()
        for one, residual in zip(identified, without, strict=True):
            findings.append(finding := describe_finding(one, effects, judged, residual, data))
            if finding.alternatives and final.theta.size <= SAMPLE:
                rival = finding.alternatives[0]
                poses = advise(declared, effects, one.effect, rival, data, noise.noise.position, seed)
                advice += [] if poses is None else [poses]
        unexplained = remaining_error(found, findings, final, noise, data, structured, judged.rounding)
        share, before_rms, after_rms = None, *(stage.held_out_rms for stage in (judged.before, judged.after))
        floor = noise.rms**2 + (0.0 if repeatability is None else repeatability.position**2)
        if before_rms is not None and after_rms is not None and (total := before_rms**2 - floor) > 0.0:
            share = float(np.clip((before_rms**2 - after_rms**2) / total, 0.0, 1.0))
        return Trace(
            **vars(judged if findings else dataclasses.replace(judged, gain=None)),
            verdict=(verdict := verdict_of(findings, unexplained)),
            assumption=assumption_of(verdict, noise, repeatability),
            declared=declared,
            findings=tuple(findings),
            undeclared_load=undeclared_load(final, data),
            unexplained=unexplained,
            explained_share=share,
            steps=found.state.steps,
            settled=found.settled,
            missing=found.pool.missing,
            detection=tuple(detection_limits(found)),
            next_poses=tuple(advice),
        )

    return with_directional_weights(run, poses, holdout)


def _useless(fit: Fit, identified: Sequence[Identified], own_places: HoldOut) -> list[Identified]:
    """Return the effects without which the poses, each held out in turn, are predicted hardly worse, the worst first.

    The search looks at a part of a large set, and its likelihood knows only the structures of its terms: an error
    outside the catalogue may resemble an effect there and not elsewhere. On 632 poses of a UR10 (series D), a profile
    of the last joint of 7 log units raised the error of held-out poses. Rows have the weights of the noise alone: with
    scatter in them, which the fits share, a lag of an IRB 120 was taken for useless.
    """
    kept, gone = list(identified), list[Identified]()
    while kept:
        absent = [fit.model.free.index(one.effect) for one in gone]
        residuals = own_places.residuals(fit, [absent, *([*absent, fit.model.free.index(one.effect)] for one in kept)])
        # Whitened sums of squares of held-out residuals of the inliers.
        costs = [
            math.inf if residual is None else float(np.sum(np.square(fit.whitening.apply(residual * fit.inliers))))
            for residual in residuals
        ]
        best = int(np.argmin(costs[1:]))
        if residuals[0] is None or costs[1 + best] > costs[0] + NEGLIGIBLE:
            break
        gone.append(kept.pop(best))
    return gone
