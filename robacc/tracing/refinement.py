"""Refinement of a finding: its order, its place, or another setting that a search tries on a coarse grid first."""

from __future__ import annotations

import dataclasses

import numpy as np

from robacc.effects.base import Effect
from robacc.effects.change_points import is_step
from robacc.effects.instrument_place import LineOfSight
from robacc.effects.orders import ORDER_STEP
from robacc.effects.periodic import of_order, searched_order
from robacc.tracing.candidate_scorer import CandidateScorer
from robacc.tracing.candidates import Candidate
from robacc.tracing.conditioned_columns import Conditioned
from robacc.tracing.place_scans import is_placed, place_scan_for
from robacc.tracing.ranking import Chosen

_CLEARLY = 1.0
"""Evidence by which a form of one more setting must be better to take a finding's place."""
_EQUAL = 1e-6
"""Difference of evidence that rounding makes."""
_ROUNDS = 4
"""Largest number of times that a form is refined around the best."""


def refined(scorer: CandidateScorer, conditioned: Conditioned, finding: Chosen) -> Candidate:
    """Return a finding with its searched setting improved, given the model ``conditioned`` without it."""
    effect = finding.candidate.effect
    if is_step(effect):
        return _best_step(scorer, conditioned, effect) or finding.candidate
    if is_placed(effect):
        return _best_place(scorer, conditioned, effect) or finding.candidate
    order = searched_order(effect)
    if order is None:
        return _best_form(scorer, conditioned, finding)
    return _best_order(scorer, conditioned, finding.candidate, order)


def _best_order(scorer: CandidateScorer, conditioned: Conditioned, candidate: Candidate, order: float) -> Candidate:
    """Return the periodic error of the order near ``order`` with the largest evidence."""
    grid = next((grid for grid in scorer.order_grids if grid.joint in candidate.effect.joints), None)
    if grid is None:
        return candidate
    for span in (ORDER_STEP, ORDER_STEP / 8):
        orders, family = scorer.families.orders_near(grid, order, span)
        order = float(orders[family.best(conditioned)[0]])
    return dataclasses.replace(candidate, effect=of_order(grid.joint, round(order, 4)), terms=())


def _best_step(scorer: CandidateScorer, conditioned: Conditioned, effect: Effect) -> Candidate | None:
    """Return the step of the same form near ``effect`` with the largest evidence; None if none is searched."""
    near = scorer.families.steps_near(effect)
    if near is None:
        return None
    scan, steps = near
    return scan.candidate(int(steps.places[steps.best(conditioned)[0]]))


def _best_place(scorer: CandidateScorer, conditioned: Conditioned, effect: Effect) -> Candidate | None:
    """Return the effect of the line of sight at the place of largest evidence; None if none is searched."""
    scan = place_scan_for(scorer.place_scans, effect)
    if scan is None or not isinstance(effect, LineOfSight):
        return None
    return scan.refined(conditioned, scorer.system, scorer.poses, effect.place)


def _best_form(scorer: CandidateScorer, conditioned: Conditioned, finding: Chosen) -> Candidate:
    """Return the finding in the form of largest evidence.

    A form with a setting that the finding lacks must be better by :data:`_CLEARLY`.
    """
    best = finding.candidate
    largest = scorer.score(finding, conditioned).evidence
    for _ in range(_ROUNDS):
        around = best
        for batch, family in scorer.families.refined(around.effect):
            evidence = family.judge(conditioned).evidence
            is_refined = around.key in {candidate.key for candidate in batch.candidates}
            i = int(np.argmax(evidence))
            if evidence[i] > largest + (_EQUAL if is_refined else _CLEARLY):
                best = dataclasses.replace(batch.candidates[i], log_prior=finding.candidate.log_prior)
                largest = float(evidence[i])
        if best is around:
            break
    return best
