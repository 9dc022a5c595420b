"""Findings of a trace: evidence, rivals, harmonics and range of each, the verdict, and the remaining error."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from robacc.accuracy.estimation import PoseMetrics, pose_metrics
from robacc.accuracy.stages import Stage
from robacc.diagnostics.joint_readings import Rounding, memory_of_play
from robacc.diagnostics.partial_residuals import PartialResidual, partial_residuals
from robacc.diagnostics.row_loads import unlogged_loads
from robacc.effects.base import Effect, effect_class
from robacc.effects.periodic import order_tolerance, orders_of, origin_of
from robacc.effects.step import place_of, place_text
from robacc.error_model.covariance import ACCEPTED
from robacc.error_model.structure import ErrorStructure, Repeatability
from robacc.error_model.terms import ErrorPart
from robacc.errors import RobaccError
from robacc.fitting.fit_result import Fit
from robacc.fitting.masses import with_deflection
from robacc.fitting.outliers import outlier_pattern
from robacc.fitting.parameters import FittedParameter
from robacc.fitting.warnings import LackOfFit, suspected_mistakes
from robacc.geometry import Array, log_between, rms_length
from robacc.measurements import Measurements
from robacc.robots.arm import Arm
from robacc.tracing.judging import Judged
from robacc.tracing.search import Alternative, Identified, SearchResult

# Harmonics of a joint's periodic error, each with its amplitude and phase.

_MOST_NAMED = 6
"""Largest number of harmonics named."""
_OF_COUNTERBALANCE = 2.5
"""Order up to which a periodic error may come from a counterbalance."""
_CLEAR = 2.0
"""Standard errors from which a harmonic of a profile is named: about 95 % confidence."""


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


def fitted_harmonics(effect: Effect, parameters: Sequence[FittedParameter], covariance: Array) -> tuple[Harmonic, ...]:
    """Return the harmonics of an effect, strongest first, from its parameters: cosine and sine of each order.

    ``covariance`` ``(2 K, 2 K)`` belongs to the parameters; NaN where a parameter is not identified.
    """
    harmonics = _harmonics_of(orders_of(effect), np.array([parameter.value for parameter in parameters]), covariance)
    return tuple(sorted(harmonics, key=lambda harmonic: -harmonic.amplitude))


def _harmonics_of(orders: Sequence[float], values: Array, covariance: Array) -> Iterator[Harmonic]:
    """Yield harmonics from alternating cosines and sines; errors by the law of propagation (JCGM 100, 5.2.2)."""
    for i, order in enumerate(orders):
        pair = slice(2 * i, 2 * i + 2)
        cosine, sine = (float(value) for value in values[pair])
        amplitude = math.hypot(cosine, sine)
        along, across = None, None
        if amplitude > 0.0:
            rotation = np.array([[cosine, sine], [-sine, cosine]]) / amplitude
            variance = np.diag(rotation @ covariance[pair, pair] @ rotation.T)
            if np.all(variance >= 0.0):
                along, across = (float(size) for size in np.sqrt(variance))
                across /= amplitude
        yield Harmonic(order, amplitude, along, math.atan2(sine, cosine), across)


def profile_harmonics(harmonics: Sequence[Harmonic]) -> tuple[Harmonic, ...]:
    """Return the strong harmonics of a joint's complete profile, strongest first."""
    clear = [h for h in harmonics if h.amplitude_std is not None and h.amplitude > _CLEAR * h.amplitude_std]
    return tuple(clear[:_MOST_NAMED])


def named_harmonics(
    harmonics: Sequence[Harmonic], aliases: Sequence[float], angle_range: float, arm: Arm, joint: str
) -> tuple[Harmonic, ...]:
    """Return harmonics with their physical origins and, of a single order, its aliases."""
    tolerance = order_tolerance(angle_range)
    ratio = arm.joint(joint).gear_ratio
    return tuple(
        dataclasses.replace(
            harmonic,
            origin=origin_of(harmonic.order, ratio, tolerance),
            aliases=tuple(aliases) if len(harmonics) == 1 else (),
        )
        for harmonic in harmonics
    )


def counterbalance_statement(effect: Effect, harmonics: Sequence[Harmonic], effects: Sequence[Effect]) -> str | None:
    """Return that a counterbalance has the shape of a periodic error; None unless its joint is a spring, too.

    A spring or cylinder of free length L between points at radii a and b of the axis turns the joint by its compliance
    times k a b sin(q + phi) (1 - L / sqrt(a^2 + b^2 + 2 a b cos(q + phi))): a function of the joint's angle alone,
    which orders 1 and 2 describe over a range of 2 rad.
    """
    springs = [other for other in effects if other.traits.is_spring and set(effect.joints) <= set(other.joints)]
    if not springs or not harmonics or any(harmonic.order > _OF_COUNTERBALANCE for harmonic in harmonics):
        return None
    return (
        f"with {springs[0]}, a counterbalance across {effect.joints[0]} has the same shape: a spring or cylinder that "
        "the robot file does not state, whose torque follows the joint's angle"
    )


def periodic_statement(effect: Effect, harmonics: Sequence[Harmonic], effects: Sequence[Effect] = ()) -> str | None:
    """Return the origins of a periodic error's orders, or that it has none and is a profile.

    ``effects`` are all findings; a spring on the same joint makes a counterbalance a possible origin.
    """
    if text := counterbalance_statement(effect, harmonics, effects):
        return text
    if effect.is_profile():
        known = [harmonic for harmonic in harmonics if harmonic.origin is not None]
        if not known:
            return "a profile of the joint's error over its angle: no order agrees with a gear, a motor or an encoder"
    origins = [f"order {harmonic.order:g}: {harmonic.origin}" for harmonic in harmonics if harmonic.origin is not None]
    if not origins and harmonics:
        origins = ["no physical origin of this order is known: read it as a profile of the joint's error"]
    others = [f"{order:g}" for harmonic in harmonics for order in harmonic.aliases]
    if others:
        origins.append(f"orders {', '.join(others)} are not distinguishable from it on these poses")
    return "; ".join(origins) or None


_FEW_POSES = 8
"""Rows below which a finding gets a warning, if they carry more than half of its contribution."""
_FEW_SHARE = 0.1
"""The same limit as a share of all rows, for small sets."""


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

    ``others`` are all findings, ``without`` the residuals of held-out poses without this one. Candidates are in
    equilibrium form; the final fit may contain the effect in the other form.
    """
    final, effect = judged.fit, identified.effect
    number = number_of(effect, final)
    fitted = final.model.free[number]
    columns = _columns_of(effect, final)
    before = after = None
    turn_before = turn_after = None
    if (held_out := judged.after.held_out_inliers or judged.after.held_out) is not None:
        after, turn_after = _rms(held_out)
        # Without a frame nothing else can be fitted.
        if without is not None and not effect.traits.is_frame:
            rows = slice(None) if judged.holdout is not None else final.inliers
            before, turn_before = _rms(pose_metrics(without[:, rows]))
    coefficients = tuple(judged.parameters[i] for i in columns)
    change = None if identified.places is None else (place_of(effect), *identified.places)
    values = {parameter.name: parameter.value for parameter in coefficients}
    between = None
    if change is not None:
        place, low, high = (place_text(at, effect, data) for at in change)
        between = (place, low, high)
    harmonics = _harmonics(identified, final, data, coefficients, final.covariance[np.ix_(columns, columns)])
    implausible = fitted.implausible([final.terms[i] for i in columns], [float(final.theta[i]) for i in columns])
    moved, turned = _motion(fitted, final, data)
    return Finding(
        effect.name,
        effect.joints,
        fitted.settings(),
        identified.alternatives,
        identified.ranked.p_value,
        identified.ranked.evidence,
        before,
        after,
        coefficients,
        harmonics,
        _validity(fitted, final, data),
        implausible,
        (*_finding_warnings(fitted, moved), *(() if implausible is None else (implausible,))),
        partial_residuals(fitted, final, data),
        _rms_of(moved),
        None if moved is None else float(np.max(moved)),
        periodic_statement(effect, harmonics, others)
        if harmonics
        else fitted.statement(final.model.arm, values, between),
        change,
        (turn_before, turn_after),
        (_rms_of(turned), None if turned is None else float(np.max(turned))),
    )


def number_of(effect: Effect, final: Fit) -> int:
    """Return the number of a candidate's effect among those of the final fit, which may hold it in another form."""
    return with_deflection(final.model.free, "equilibrium").index(effect)


def _columns_of(effect: Effect, final: Fit) -> list[int]:
    """Return the numbers of an effect's coefficients in the final fit."""
    number = number_of(effect, final)
    return [i for i, owner in enumerate(final.owners) if owner == number]


def _rms(metrics: PoseMetrics) -> tuple[float, float | None]:
    """Return the rms of position, m, and of orientation, rad; None where it is not measured."""
    return metrics.position.rms, None if metrics.orientation is None else metrics.orientation.rms


def _harmonics(
    identified: Identified,
    final: Fit,
    data: Measurements,
    coefficients: Sequence[FittedParameter],
    covariance: Array,
) -> tuple[Harmonic, ...]:
    """Return the strong harmonics of a periodic error of a joint that turns."""
    arm, effect = final.model.arm, identified.effect
    if not orders_of(effect) or not all(map(arm.is_revolute, effect.joints)):
        return ()
    harmonics = fitted_harmonics(effect, coefficients, covariance)
    if effect.is_profile():
        harmonics = profile_harmonics(harmonics)
    assert data.q is not None
    extent = float(np.ptp(data.q[arm.number(effect.joints[0])]))
    return named_harmonics(harmonics, identified.aliases, extent, arm, effect.joints[0])


def _validity(effect: Effect, final: Fit, data: Measurements) -> tuple[tuple[str, float, float], ...]:
    limits = effect.validity(final.model.arm, data)
    return tuple((driver, low, high) for driver, (low, high) in limits.items())


def _finding_warnings(effect: Effect, moved: Array | None) -> tuple[str, ...]:
    n_poses = None if moved is None else _decisive_poses(moved)
    if n_poses is None:
        return ()
    return (f"more than half of the contribution of {effect} comes from only {n_poses} poses",)


def _rms_of(sizes: Array | None) -> float | None:
    return None if sizes is None else float(np.sqrt(np.mean(np.square(sizes))))


def _motion(effect: Effect, final: Fit, data: Measurements) -> tuple[Array | None, Array | None]:
    """Return the distances (m) and angles (rad) ``(n,)`` by which the effect alone moves the target at the inliers.

    The angles are None where orientation is not measured; both are None if the arm cannot be evaluated without it.
    """
    bound = final.model.bind(data)
    number = final.model.free.index(effect)
    theta_without = np.where(np.array(final.owners) == number, 0.0, final.theta)
    try:
        without = bound.poses(theta_without)
    except RobaccError:
        return None, None
    distances: Array = np.linalg.norm((without.translation - final.poses.translation)[:, final.inliers], axis=0)
    if data.rotation is None:
        return distances, None
    angles: Array = np.linalg.norm(log_between(without.rotation, final.poses.rotation)[:, final.inliers], axis=0)
    return distances, angles


def _decisive_poses(moved: Array) -> int | None:
    """Return the number of poses that carry half of a finding's contribution, or None if they are many."""
    share = np.sort(np.square(moved))[::-1]
    if share.sum() <= 0:
        return None
    count = int(np.searchsorted(np.cumsum(share) / share.sum(), 0.5)) + 1
    return count if count < min(_FEW_POSES, _FEW_SHARE * share.size) else None


# Error that remains after the findings of a trace, and hints on its cause.

_CHANCE = 0.002
"""Probability below which a structure of the remaining error is no chance: some five tests share one in a hundred."""
_OF_EVERY_ARM = ("joint_offset", "link_geometry")
"""Effects by which every nominal model deviates."""
_MOST_REPEATABILITY = 1e-4
"""Largest plausible repeatability at the target, m (data sheets: 0.02 to 0.1 mm)."""
_MOST_PRESUMED = 1.2e-4
"""Remaining error, m rms, up to which noise that nothing confirms may be presumed: a laser tracker at some metres
(0.03 to 0.05 mm along each axis) and a data sheet's repeatability together."""
_UNCERTAIN = 1.2
"""Factor by which an estimate of scatter from some hundred rows exceeds the rounding that causes it."""
_SMALL_POSE_ERROR = 1e-5
"""Error common to all visits of a pose that no instrument resolves, m."""
_LOOKS_LIKE: Mapping[ErrorPart, tuple[str, tuple[str, ...]]] = {
    "scatter": ("scatters from visit to visit", ("backlash", "friction_windup", "approach_lag")),
    "wander": ("wanders over time", ("thermal_expansion", "joint_warmup", "frame_drift")),
}
"""Parts of the error, what they look like, and effects that look so where their columns are missing."""
_MANY_OUTLIERS = 0.05
"""Share of the rows from which outliers are not accidental."""


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


def _scatter_hints(repeatability: Repeatability | None, rounding: Rounding | None) -> Iterator[str]:
    """Yield hints on scatter of the joints that is too large, or too repeatable, for repeatability and rounding."""
    if repeatability is None:
        return
    most = math.hypot(_MOST_REPEATABILITY, 0.0 if rounding is None else _UNCERTAIN * rounding.position)
    if repeatability.source == "residual" and repeatability.position > most:
        yield (
            f"the joints scatter by {1e3 * repeatability.position:.3g} mm rms at the target, more than an arm's "
            "repeatability: an effect outside the catalogue, or a payload or load that was not recorded; "
            "measure some poses repeatedly to distinguish these"
        )
    if repeatability.pose_position > max(repeatability.position, _SMALL_POSE_ERROR):
        yield (
            "visits of a pose, or of poses close together, share an error of "
            f"{1e3 * repeatability.pose_position:.3g} mm rms that no candidate explains"
        )


def _process_hints(found: SearchResult, findings: Sequence[Finding]) -> Iterator[str]:
    """Yield a hint on an error that depends on the pose and that no named effect describes."""
    sizes = [one.size_at_tool or 0.0 for one in findings if effect_class(one.effect).traits.is_empirical]
    if not sizes:
        return
    yield (
        f"an error of about {1e3 * math.hypot(*sizes):.2g} mm rms depends smoothly on the pose, and no effect of the "
        "catalogue describes it better than chance: no cause is named"
    )
    absent = [name for name in _OF_EVERY_ARM if all(effect.name != name for effect in found.model.free)]
    if absent:
        yield (
            f"every arm deviates in {' and '.join(absent)} too, which were not declared: add "
            f"{','.join(absent)} to the effects of `declared`"
        )


def _outlier_hints(final: Fit, data: Measurements) -> Iterator[str]:
    """Yield hints on outliers that are not accidental."""
    pattern = outlier_pattern(data, ~final.inliers, final.model.arm.names)
    if pattern is not None:
        yield pattern
    share = final.outliers.size / data.n
    if share > _MANY_OUTLIERS:
        yield f"{final.outliers.size} of {data.n} rows ({100 * share:.0f} %) are outliers: too many for chance"


def _size_hints(
    has_findings: bool,
    noise: LackOfFit,
    repeatability: Repeatability | None,
    rounding: Rounding | None,
    rms: float,
) -> Iterator[str]:
    """Yield a hint if findings leave more than usual noise and nothing confirms that it is noise."""
    unconfirmed = noise.p_value is None and (repeatability is None or repeatability.source == "residual")
    most = math.hypot(_MOST_PRESUMED, 0.0 if rounding is None else _UNCERTAIN * rounding.position)
    if unconfirmed and has_findings and rms > most:
        yield (
            f"the remaining error, {1e3 * rms:.3g} mm rms, is larger than usual instrument noise and repeatability, "
            "and neither sigma columns nor repeated poses show that it is noise: part of it may have a cause outside "
            "the model"
        )


def _memory_hints(final: Fit, data: Measurements) -> Iterator[tuple[float, str]]:
    """Yield p-value and hint on each joint whose play remembers the previous visit."""
    playing = {joint: effect for effect in final.model.free if effect.follows_approach for joint in effect.joints}
    p_values = memory_of_play(final, data, tuple(playing))
    for joint, p_value in p_values.items():
        if p_value * len(p_values) <= _CHANCE:
            yield (
                p_value * len(p_values),
                f"in addition to {playing[joint]}, the errors of {joint} follow the change of its torque since the "
                "previous visit: its play has a memory (hysteresis), which the direction of approach alone does not "
                "describe",
            )


def _columns_to_record(parts: Mapping[ErrorPart, float], missing: Mapping[str, str]) -> Iterator[str]:
    """Yield which columns would show whether a part of the error that is no noise has a cause."""
    for part, (looks, names) in _LOOKS_LIKE.items():
        untested = [f"{name} ({missing[name]})" for name in names if name in missing]
        if untested and (size := parts.get(part, 0.0)) > parts["noise"]:
            yield (
                f"{1e3 * size:.2g} mm rms {looks}: it may be {' or '.join(untested)}, which were not tested; record "
                "what they need and trace again"
            )


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
    hints = [*structure.warnings, *_process_hints(found, findings)]
    p_values = [0.0] if hints else [found.next[0].p_value] if found.next else [1.0]
    for p_value, hint in _memory_hints(final, data):
        p_values.append(p_value)
        hints.append(hint)
    if hints and (loads := unlogged_loads(final, data)) is not None:
        hints.insert(0, loads.text)
    residual = final.residual[:3, final.inliers]
    rms = rms_length(residual)
    hints.extend(_scatter_hints(structure.repeatability, rounding))
    hints.extend(suspected_mistakes(final))
    hints.extend(_outlier_hints(final, data))
    hints.extend(_size_hints(bool(findings), noise, structure.repeatability, rounding, rms))
    if noise.p_value is not None and noise.p_value <= _CHANCE:
        p_values.append(noise.p_value)
        source = "repeats" if noise.noise.source == "repeats" else "the file"
        hints.append(f"the residual is {noise.ratio:.3g} times the measurement noise (known from {source})")
        if not found.next or found.next[0].log_odds < ACCEPTED:
            hints.append("no candidate explains this error: it is repeatability, or an effect outside the catalogue")
    if hints:
        hints.extend(_columns_to_record(structure.parts, found.pool.missing))
    return Unexplained(
        rms=rms,
        noise_rms=None if noise.p_value is None else math.sqrt(3) * noise.noise.position,
        structured=bool(hints),
        p_value=min(p_values),
        hints=tuple(hints),
        parts=structure.parts,
    )


# Verdict of a trace, the assumption that it rests on, and the share of the error that the findings explain.

Verdict = Literal["clean", "explained", "partly_explained", "unexplained"]
HIDDEN_NOISE = 0.1
"""Ratio of noise to repeatability, of one residual, below which the noise is not resolved."""


def verdict_of(findings: Sequence[Finding], unexplained: Unexplained) -> Verdict:
    """Return the verdict on the findings and the error that remains after them."""
    if not findings:
        return "unexplained" if unexplained.structured else "clean"
    named = any(not effect_class(finding.effect).traits.is_empirical for finding in findings)
    plausible = all(finding.implausible is None for finding in findings)
    return "explained" if named and plausible and not unexplained.structured else "partly_explained"


def is_hidden_noise(noise: LackOfFit, repeatability: Repeatability | None) -> bool:
    """Return whether only the residual separates noise from repeatability, and leaves almost nothing for the noise."""
    if noise.p_value is not None or repeatability is None or repeatability.source != "residual":
        return False
    return math.sqrt(3) * noise.noise.position < HIDDEN_NOISE * repeatability.position


def assumption_of(verdict: Verdict, noise: LackOfFit, repeatability: Repeatability | None) -> str | None:
    """Return what the verdict presumes of noise and repeatability that only the residual gives.

    None if they are known or not used.
    """
    if noise.p_value is not None or verdict not in ("clean", "explained"):
        return None
    presumed, test = [], "repeated poses"
    if repeatability is not None and repeatability.source == "residual":
        presumed.append(f"the arm's own repeatability is {1e3 * repeatability.position:.2g} mm rms at the target")
    if noise.noise.source not in ("file", "repeats") and not is_hidden_noise(noise, repeatability):
        axes = noise.noise.along_axes
        size = f"{1e3 * noise.noise.position:.2g} mm along each axis (standard deviation)"
        if axes is not None:
            size = f"{', '.join(f'{1e3 * std:.2g}' for std in axes)} mm along x, y, z (standard deviation)"
        presumed.append(f"the measurement noise is {size}")
        test = "sigma columns or repeated poses"
    return f"{verdict} if {' and '.join(presumed)}; {test} would test this" if presumed else None


def explained_share(before: Stage, after: Stage, noise: LackOfFit, repeatability: Repeatability | None) -> float | None:
    """Return the share of the explainable held-out variance of the baseline that the findings explain, 0 to 1."""
    if before.held_out is None or after.held_out is None:
        return None
    floor = 3.0 * noise.noise.position**2 + (0.0 if repeatability is None else repeatability.position**2)
    total = before.held_out.position.rms**2 - floor
    if total <= 0.0:
        return None
    share = (before.held_out.position.rms**2 - after.held_out.position.rms**2) / total
    return float(min(max(share, 0.0), 1.0))
