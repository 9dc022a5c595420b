"""Report of one finding: its evidence, its rivals, its parameters and its validity range."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from robacc.accuracy.metrics import pose_metrics
from robacc.diagnostics.partial_residuals import PartialResidual, partial_residuals
from robacc.effects.base import Effect
from robacc.effects.change_points import is_step, place_of, place_text
from robacc.effects.periodic import orders_of
from robacc.errors import RobaccError
from robacc.fitting.deflection_model import with_deflection
from robacc.fitting.fit_result import Fit
from robacc.fitting.parameters import FittedParameter
from robacc.geometry import Array, log_between
from robacc.measurements import Measurements
from robacc.tracing.cross_validation import CrossValidation
from robacc.tracing.harmonics import (
    Harmonic,
    fitted_harmonics,
    named_harmonics,
    periodic_statement,
    profile_harmonics,
)
from robacc.tracing.loop import SearchResult
from robacc.tracing.ranking import Chosen
from robacc.tracing.rivals import MOST_TO_REFIT, Alternative, lag_refitted, rivals
from robacc.tracing.selection import FALSE_ALARM, SelectionStep

_FEW_POSES = 8
"""Rows below which a finding gets a warning, if they carry more than half of its contribution."""
_FEW_SHARE = 0.1
"""The same limit as a share of all rows, for small sets."""
_LEAST_STABILITY = 0.6
"""Share of the folds below which a finding gets a warning."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One identified effect of a trace, with its test."""

    effect: str
    joints: tuple[str, ...]
    settings: dict[str, object]
    alternatives: tuple[Alternative, ...]
    p_value: float
    """Corrected for the number of candidates."""
    evidence: float
    held_out_before: float | None
    """Held-out position rms without it, m. None without cross-validation, and for a frame, without which nothing else
    can be fitted."""
    held_out_after: float | None
    stability: tuple[int, int]
    """Number of folds in which it recurs, and number of folds."""
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
    search_result: SearchResult,
    effect: Effect,
    final: Fit,
    all_parameters: Sequence[FittedParameter],
    inflation: Array,
    validation: CrossValidation | None,
    data: Measurements,
) -> Finding:
    """Return the finding of ``effect``: its rivals, held-out errors, and parameters in the final fit.

    ``all_parameters`` are the coefficients of ``final``, and ``inflation`` ``(P,)`` their variances over those beside
    independent errors, whose mean the p-value allows for. Candidates are in equilibrium form; the final fit may contain
    the effect in the other form.
    """
    number = _number_of(effect, final)
    fitted = final.model.free[number]
    columns = _columns_of(effect, final)
    inflated = mean_inflation(effect, final, inflation)
    choice = next(
        (c for c in search_result.selection.chosen if c.candidate.effect.search_key() == effect.search_key()), None
    )
    if choice is not None:
        refitted = lag_refitted(search_result, choice, effect, data) if final.theta.size <= MOST_TO_REFIT else None
        ranked, alternatives = rivals(search_result.selection, choice, refitted)
        p_value, evidence = ranked.p_value_beside(inflated), ranked.evidence
    else:
        p_value, evidence, alternatives = _score_when_added(search_result.steps, effect, inflated)
    before = after = None
    turn_before = turn_after = None
    if validation is not None:
        rows = final.inliers if validation.folds else slice(None)
        without = validation.without.get(effect.key())
        before, turn_before = (None, None) if without is None else _rms(without[:, rows])
        after, turn_after = _rms(validation.after[:, rows])
    coefficients = tuple(all_parameters[i] for i in columns)
    choices = None if validation is None else validation.choices
    folds_chosen = (0, 0) if choices is None else (choices.count(effect), choices.folds)
    change = _change(search_result, effect, choice)
    values = {parameter.name: parameter.value for parameter in coefficients}
    between = None
    if change is not None:
        place, low, high = (place_text(at, effect, data) for at in change)
        between = (place, low, high)
    harmonics = _harmonics(search_result, effect, choice, coefficients, final.covariance[np.ix_(columns, columns)])
    implausible = fitted.implausible([final.terms[i] for i in columns], [float(final.theta[i]) for i in columns])
    moved, turned = _motion(fitted, final, data)
    return Finding(
        effect.name,
        effect.joints,
        fitted.settings(),
        alternatives,
        p_value,
        evidence,
        before,
        after,
        folds_chosen,
        coefficients,
        harmonics,
        _validity(fitted, final, data),
        implausible,
        (*_finding_warnings(fitted, moved, folds_chosen, p_value), *(() if implausible is None else (implausible,))),
        partial_residuals(fitted, final, data),
        _rms_of(moved),
        None if moved is None else float(np.max(moved)),
        periodic_statement(effect, harmonics, search_result.effects)
        if harmonics
        else fitted.statement(final.model.arm, values, between),
        change,
        (turn_before, turn_after),
        (_rms_of(turned), None if turned is None else float(np.max(turned))),
    )


def mean_inflation(effect: Effect, final: Fit, inflation: Array) -> float:
    """Return the mean of ``inflation`` ``(P,)``, given for each coefficient of a fit, over those of an effect."""
    columns = _columns_of(effect, final)
    return float(np.mean(inflation[columns])) if columns else 1.0


def _number_of(effect: Effect, final: Fit) -> int:
    """Return the number of a candidate's effect among those of the final fit, which may hold it in another form."""
    return with_deflection(final.model.free, "equilibrium").index(effect)


def _columns_of(effect: Effect, final: Fit) -> list[int]:
    """Return the numbers of an effect's coefficients in the final fit."""
    number = _number_of(effect, final)
    return [i for i, owner in enumerate(final.owners) if owner == number]


def _rms(residual: Array) -> tuple[float, float | None]:
    """Return the rms of position, m, and of orientation, rad; None where it is not measured."""
    metrics = pose_metrics(residual)
    return metrics.position.rms, None if metrics.orientation is None else metrics.orientation.rms


def _score_when_added(
    steps: Sequence[SelectionStep], effect: Effect, inflation: float
) -> tuple[float, float, tuple[Alternative, ...]]:
    """Return the score of a frame in the step that added it: it is no candidate afterwards."""
    for step in steps:
        if step.action == "add" and step.ranking and step.ranking[0].candidate.effect.key() == effect.key():
            return step.ranking[0].p_value_beside(inflation), step.ranking[0].evidence, ()
    return float("nan"), float("nan"), ()


def _change(search_result: SearchResult, effect: Effect, choice: Chosen | None) -> tuple[float, float, float] | None:
    """Return the place of a step with its interval, given all other findings."""
    if not is_step(effect):
        return None
    place = place_of(effect)
    if choice is None:
        return place, place, place
    scorer = search_result.selection.scorer
    interval = scorer.step_interval(scorer.condition(search_result.selection.chosen, without=choice), effect)
    return (place, place, place) if interval is None else (place, *interval)


def _harmonics(
    search_result: SearchResult,
    effect: Effect,
    choice: Chosen | None,
    coefficients: Sequence[FittedParameter],
    covariance: Array,
) -> tuple[Harmonic, ...]:
    """Return the strong harmonics of a periodic error of a joint that turns."""
    arm = search_result.final.model.arm
    if not orders_of(effect) or not all(map(arm.is_revolute, effect.joints)):
        return ()
    if effect.is_profile() and choice is not None:
        harmonics = profile_harmonics(search_result.selection, choice)
    else:
        harmonics = fitted_harmonics(effect, coefficients, covariance)
    return named_harmonics(harmonics, search_result.selection, choice, arm, effect.joints[0])


def _validity(effect: Effect, final: Fit, data: Measurements) -> tuple[tuple[str, float, float], ...]:
    limits = effect.validity(final.model.arm, data)
    return tuple((driver, low, high) for driver, (low, high) in limits.items())


def _finding_warnings(effect: Effect, moved: Array | None, chosen: tuple[int, int], p_value: float) -> tuple[str, ...]:
    warnings = []
    if p_value > FALSE_ALARM:
        warnings.append(
            f"{effect} lowers the error of held-out poses, but is not significant given the structure of the errors "
            f"that remain (p = {p_value:.2g}): it may stand for an effect that the model lacks"
        )
    if chosen[1] and chosen[0] < _LEAST_STABILITY * chosen[1]:
        warnings.append(f"{effect} was found in only {chosen[0]} of {chosen[1]} folds")
    n_poses = None if moved is None else _decisive_poses(moved)
    if n_poses is not None:
        warnings.append(f"more than half of the contribution of {effect} comes from only {n_poses} poses")
    return tuple(warnings)


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
