"""Report of one finding: its evidence, its rivals, its parameters and its validity range."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from robacc.accuracy.metrics import PoseMetrics, pose_metrics
from robacc.diagnostics.partial_residuals import PartialResidual, partial_residuals
from robacc.effects.base import Effect
from robacc.effects.change_points import place_of, place_text
from robacc.effects.periodic import orders_of
from robacc.errors import RobaccError
from robacc.fitting.deflection_model import with_deflection
from robacc.fitting.fit_result import Fit
from robacc.fitting.parameters import FittedParameter
from robacc.geometry import Array, log_between
from robacc.measurements import Measurements
from robacc.tracing.harmonics import (
    Harmonic,
    fitted_harmonics,
    named_harmonics,
    periodic_statement,
    profile_harmonics,
)
from robacc.tracing.judging import Judged
from robacc.tracing.search import Alternative, Identified

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
        if without is not None and not effect.is_frame:
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
