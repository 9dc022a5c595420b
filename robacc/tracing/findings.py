"""One finding told in full: what it is, how sure, what else it could be, and where it was learnt."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from robacc.accuracy.metrics import pose_metrics
from robacc.diagnostics.partial_residuals import PartialResidual, partial_residuals
from robacc.effects.base import Effect
from robacc.effects.periodic import orders_of
from robacc.errors import RobaccError
from robacc.fitting.deflection_model import with_deflection
from robacc.fitting.parameters import FittedParameter, parameters
from robacc.fitting.solver import Fit
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.tracing.candidate_scorer import Chosen
from robacc.tracing.cross_validation import CrossValidation
from robacc.tracing.harmonics import Harmonic, fitted_harmonics, profile_harmonics
from robacc.tracing.loop import SearchResult
from robacc.tracing.rivals import Alternative, lag_refitted, rivals
from robacc.tracing.selection import SelectionStep

_FEW = 8
"""A finding whose gain rests for more than half on fewer rows than this is said to rest on few poses."""
_FEW_SHARE = 0.1
"""The same as a share of all rows, where they are few themselves."""
_MOST_TO_REFIT = 200
"""Coefficients beyond which rivals are not fitted in a finding's place."""
_AGAIN = 0.6
"""Share of the folds that a finding has to be chosen in again to be told without a warning."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One effect that the model lacked."""

    effect: str
    joints: tuple[str, ...]
    settings: dict[str, object]
    alternatives: tuple[Alternative, ...]
    p_value: float
    """Corrected for everything that competed."""
    evidence: float
    held_out_before: float | None
    """Held-out position rms without it, m; None where too few poses to hold any out, and of a frame, without which
    nothing else can be fitted."""
    held_out_after: float | None
    stability: tuple[int, int]
    """In how many of how many folds it was chosen again without the poses held out."""
    parameters: tuple[FittedParameter, ...]
    harmonics: tuple[Harmonic, ...]
    validity: tuple[tuple[str, float, float], ...]
    """Joint ranges that it was learnt in: name, low, high (rad or m)."""
    warnings: tuple[str, ...]
    partial_residuals: tuple[PartialResidual, ...]
    """The residual along it over what drives it, without and with it."""


def describe_finding(
    loop: SearchResult, effect: Effect, final: Fit, held: CrossValidation | None, data: Measurements
) -> Finding:
    """The finding that ``effect`` is: against its rivals, held out, and with its parameters in the final fit.

    It competes in equilibrium; the final fit may have it in the other form.
    """
    one = next((c for c in loop.selection.chosen if c.candidate.effect.search_key() == effect.search_key()), None)
    if one is not None:
        refitted = lag_refitted(loop, one, effect, data) if final.theta.size <= _MOST_TO_REFIT else None
        own, alternatives = rivals(loop.selection, one, refitted)
        p_value, evidence = own.p_value, own.evidence
    else:
        p_value, evidence, alternatives = _first_validity(loop.steps, effect)
    before = after = None
    if held is not None:
        rows = final.inliers if held.folds else slice(None)
        without = held.without.get(effect.key())
        before = None if without is None else pose_metrics(without[:, rows]).position.rms
        after = pose_metrics(held.after[:, rows]).position.rms
    number = with_deflection(final.model.free, "equilibrium").index(effect)
    fitted = final.model.free[number]
    mine = [i for i, owner in enumerate(final.owners) if owner == number]
    every = parameters(final)
    own_parameters = tuple(every[i] for i in mine)
    folds_chosen = (held.chosen.get(effect.key(), 0), held.folds) if held is not None else (0, 0)
    lines = _lines(loop, effect, one, own_parameters, final.covariance[np.ix_(mine, mine)])
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
        own_parameters,
        lines,
        _validity(fitted, final, data),
        _finding_warnings(fitted, final, data, folds_chosen),
        partial_residuals(fitted, final, data),
    )


def _first_validity(steps: Sequence[SelectionStep], effect: Effect) -> tuple[float, float, tuple[Alternative, ...]]:
    """Score of a frame when it was added: it does not compete afterwards."""
    for step in steps:
        if step.action == "add" and step.ranking and step.ranking[0].candidate.effect.key() == effect.key():
            return step.ranking[0].p_value, step.ranking[0].evidence, ()
    return float("nan"), float("nan"), ()


def _lines(
    loop: SearchResult, effect: Effect, one: Chosen | None, own: Sequence[FittedParameter], covariance: Array
) -> tuple[Harmonic, ...]:
    """The strong lines of a periodic error."""
    if not orders_of(effect):
        return ()
    if effect.is_profile() and one is not None:
        return profile_harmonics(loop.selection, one)
    return fitted_harmonics(effect, own, covariance)


def _validity(effect: Effect, final: Fit, data: Measurements) -> tuple[tuple[str, float, float], ...]:
    if data.q is None:
        return ()
    arm = final.model.arm
    return tuple(
        (joint, float(data.q[arm.number(joint)].min()), float(data.q[arm.number(joint)].max()))
        for joint in effect.joints
    )


def _finding_warnings(effect: Effect, final: Fit, data: Measurements, chosen: tuple[int, int]) -> tuple[str, ...]:
    warnings = []
    if chosen[1] and chosen[0] < _AGAIN * chosen[1]:
        warnings.append(f"{effect} was chosen again in only {chosen[0]} of {chosen[1]} folds")
    few = _rests_on(effect, final, data)
    if few is not None:
        warnings.append(f"more than half of what {effect} explains rests on {few} poses")
    return tuple(warnings)


def _rests_on(effect: Effect, final: Fit, data: Measurements) -> int | None:
    """Number of poses that carry half of a finding's contribution, where they are few."""
    bound = final.model.bind(data)
    number = final.model.free.index(effect)
    lacking = np.where(np.array(final.owners) == number, 0.0, final.theta)
    try:
        moved = bound.poses(lacking).translation - final.poses.translation
    except RobaccError:
        return None
    share = np.sort(np.sum(np.square(moved[:, final.inliers]), axis=0))[::-1]
    if share.sum() <= 0:
        return None
    count = int(np.searchsorted(np.cumsum(share) / share.sum(), 0.5)) + 1
    return count if count < min(_FEW, _FEW_SHARE * share.size) else None
