"""One linearisation of a model and of all candidates, from which any subset of its poses can choose."""

from __future__ import annotations

import dataclasses
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from robacc.chain import BASE
from robacc.effects import REGISTRY
from robacc.effects.base import Effect, Part, Term
from robacc.effects.change_points import CHANGE_POINT, is_step, mixed_places, places, step_forms
from robacc.effects.orders import HIGHEST_ORDER
from robacc.effects.periodic import searched_order
from robacc.fitting.fit_result import Fit
from robacc.fitting.visits import visit_numbers
from robacc.fitting.whitening import Whitening
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.modelling.observation import observed_jacobian, residuals
from robacc.robots.arm import Arm
from robacc.tracing.candidate_scorer import CandidateScorer
from robacc.tracing.candidates import (
    BLOCK_LOG_PRIOR,
    TYPICAL_CANDIDATES,
    Batch,
    Candidate,
    batches,
    corrections,
    named_candidates,
    order_grids,
    profiles,
)
from robacc.tracing.form_families import FormFamilies
from robacc.tracing.place_scans import PlaceScan, is_placed, place_scan_for, place_scans
from robacc.tracing.selection import Selection
from robacc.tracing.step_scans import StepScan, scan_for, scan_of, usable_places
from robacc.tracing.whitened_columns import Columns

SELECTION_POSES = 800
"""Largest number of poses that a selection uses; fits and figures use all poses."""
_LINEARISED_POSES = 4 * SELECTION_POSES
"""Largest number of poses that columns are made for: a fold's selection, which lacks some, still has enough."""
_SHARE_OF_PRECISION = 1e-3
"""Share of the precision of a constant's prior that counts beside candidates: thirty times its standard deviation. The
prior is estimated where effects are missing, which makes it narrow; here it only excludes constants that no arm has."""
_OFF_GRID_LOG_PRIOR = -8.0
"""Log prior of an order on a joint whose orders are not searched: about that of a searched order."""


@dataclass(frozen=True)
class LinearisedCandidates:
    """One linearisation of a model, from which any subset of poses can choose.

    It uses :data:`_LINEARISED_POSES` poses at most (n of N), so that its memory does not grow with the poses.
    """

    model: Model
    data: Measurements
    """Measurements of those poses."""
    rows: NDArray[np.int64]
    """``(n,)`` their row numbers in the complete data."""
    base: Array
    """``(M, p, n)`` whitened columns of the declared effects' coefficients."""
    base_precision: Array
    """``(p,)`` prior precision of those coefficients, whitened; zero for none."""
    pool_columns: Array
    """``(M, P, n)`` whitened columns of the pool's terms, each once."""
    pool: tuple[Candidate, ...]
    places: tuple[NDArray[np.int64], ...]
    """Numbers of each candidate's terms among :attr:`pool_columns`."""
    joint_columns: Array
    """``(M, J + 3, n)`` whitened columns of each joint's variable, and of the base's x, y, z."""
    whitening: Whitening
    """Map that whitens the columns and the residual."""
    step_scans: tuple[StepScan, ...]
    """Forms of a step, each with the places where it may lie."""
    place_scans: tuple[PlaceScan, ...]
    """Forms of effects of the line of sight, each with the places where the instrument may stand."""
    residual: Array
    """``(M, n)`` whitened residual, with the contributions of earlier findings and of coefficients with a prior put
    back."""
    inliers: NDArray[np.bool_]
    """``(n,)`` inlier mask of the fit."""
    missing: dict[str, str]
    """Reason why an effect is no candidate, by effect."""
    only: tuple[str, ...] | None
    """Names of the effects that are candidates; None for all."""
    _refined_forms: dict[tuple[object, ...], list[Candidate]] = dataclasses.field(default_factory=dict)
    """Forms of the effects that any selection has refined, by their keys."""
    _forms_beside: dict[tuple[object, ...], list[Candidate]] = dataclasses.field(default_factory=dict)
    """Candidates beside the effects that any selection has found, by their keys."""

    @cached_property
    def blocks(self) -> list[Candidate]:
        """Rich blocks: periodic profiles and empirical corrections."""
        arm = self.model.arm
        candidates = profiles(arm, self.data, self.only)
        candidates += corrections(arm, self.data, self.only)
        return candidates

    def selection(
        self, rows: NDArray[np.bool_], start: Sequence[Effect] = (), max_poses: int = SELECTION_POSES
    ) -> Selection:
        """Return a selection on a subset of the poses, empty or with the effects ``start``."""
        at = self._thinned(rows, max_poses)
        count = self.base.shape[1]
        system = Columns(
            np.concatenate((self.base[:, :, at], self.pool_columns[:, :, at]), axis=1), self.residual[:, at]
        )
        data = self.data.subset(at)
        arm = self.model.arm

        families = FormFamilies(
            system,
            self.joint_columns[:, :, at],
            at,
            self.whitening.subset(at),
            self.step_scans,
            lambda effect: self._refinements(effect, at),
            lambda effect: self._beside(effect, at),
        )

        def expand(candidate: Candidate) -> Array:
            scan = scan_for(self.step_scans, candidate.effect) if is_step(candidate.effect) else None
            if scan is not None:
                return scan.whitened(candidate, self.whitening)[:, :, at]
            terms = candidate.terms or candidate.effect.terms(arm, self.data)
            return self._columns_of(terms)[:, :, at]

        scorer = CandidateScorer(
            system,
            tuple(range(count)),
            self.base_precision,
            self.pool,
            [place + count for place in self.places],
            order_grids(arm, data, self.only),
            order_grids(arm, data, self.only, high=True),
            families,
            expand,
            self.rows[at],
            self.step_scans,
            at,
            self.place_scans,
        )
        choice = Selection(scorer)
        for effect in start:
            choice.start_with(self._candidate(effect))
        return choice

    def batches(self, rows: NDArray[np.bool_], max_poses: int) -> list[Batch]:
        """Return the rich blocks on the poses that :meth:`selection` uses."""
        return batches(self.model.arm, self.blocks, self._thinned(rows, max_poses))

    def _thinned(self, rows: NDArray[np.bool_], max_poses: int) -> NDArray[np.int64]:
        """Return the rows for a selection: all, or ``max_poses`` of them, sampled by commanded pose."""
        return _thinned(self.data, np.flatnonzero(rows[self.rows] & self.inliers), max_poses)

    def _candidate(self, effect: Effect) -> Candidate:
        """Return the candidate of an effect, with its prior in the search."""
        search_key, key = effect.search_key(), effect.key()
        same = [candidate for candidate in self.pool if candidate.effect.search_key() == search_key]
        for candidate in same:
            if candidate.key == key:
                return candidate
        terms = effect.terms(self.model.arm, self.data)
        if same:
            return Candidate(effect, terms, same[0].log_prior)
        if is_step(effect) and (scan := scan_for(self.step_scans, effect)) is not None:
            return Candidate(effect, terms, scan.log_prior)
        if is_placed(effect) and (place_scan := place_scan_for(self.place_scans, effect)) is not None:
            return Candidate(effect, terms, place_scan.log_prior)
        if any(term.group for term in terms):
            return Candidate(effect, terms, BLOCK_LOG_PRIOR)
        if effect.odds_beside < 1.0:
            return Candidate(effect, terms, _beside(effect))
        order = searched_order(effect)
        is_high = order is not None and order > HIGHEST_ORDER
        searched = order_grids(self.model.arm, self.data, self.only, high=is_high)
        log_prior = next((grid.log_prior for grid in searched if (grid.joint,) == effect.joints), _OFF_GRID_LOG_PRIOR)
        return Candidate(effect, terms, log_prior)

    def _refinements(self, effect: Effect, at: NDArray[np.int64]) -> list[Batch]:
        """Return the forms in which a search refines an effect, on the poses ``at``."""
        key = effect.key()
        if key not in self._refined_forms:
            self._refined_forms[key] = self._candidates_of(effect.refinements(self.model.arm, self.data))
        return batches(self.model.arm, self._refined_forms[key], at)

    def _beside(self, effect: Effect, at: NDArray[np.int64]) -> list[Batch]:
        """Return what is a candidate only beside an effect, on the poses ``at``."""
        key = effect.key()
        if key not in self._forms_beside:
            classes = [cls for name, cls in REGISTRY.items() if self.only is None or name in self.only]
            forms = [form for cls in classes for form in cls.beside(effect, self.model.arm, self.data)]
            self._forms_beside[key] = self._candidates_of(forms)
        return batches(self.model.arm, self._forms_beside[key], at)

    def _candidates_of(self, effects: Iterable[Effect]) -> list[Candidate]:
        return [Candidate(form, form.terms(self.model.arm, self.data), _beside(form)) for form in effects]

    def _columns_of(self, terms: Sequence[Term]) -> Array:
        """Return columns of terms that act on joint variables or on the base's x, y, z."""
        number = {motion: i for i, motion in enumerate(_followed(self.model.arm))}
        result = np.zeros((self.residual.shape[0], len(terms), self.data.n))
        for i, term in enumerate(terms):
            for part in term.parts:
                result[:, i] += self.joint_columns[:, number[part.motion]] * part.factor
        return result


def _beside(effect: Effect) -> float:
    """Return the log prior of an effect that is a candidate only beside a finding."""
    return math.log(effect.odds_beside / TYPICAL_CANDIDATES)


def _thinned(data: Measurements, at: NDArray[np.int64], max_poses: int) -> NDArray[np.int64]:
    """Return the rows ``at``, or ``max_poses`` of them, sampled by commanded pose and not by place in the file."""
    if at.size <= max_poses:
        return at
    groups = data.groups()[at]
    draw = np.random.default_rng(0).permutation(int(groups.max()) + 1)[groups]
    return np.sort(at[np.argsort(draw, kind="stable")[:max_poses]])


def linearise(
    fit: Fit, data: Measurements, declared: Sequence[Effect], only: Sequence[str] | None = None
) -> LinearisedCandidates:
    """Return columns of the declared effects and of all candidates, at a fit that may contain findings besides.

    The contribution of the findings is put back into the residual, to first order, so that they are candidates again.
    Weakly identifiable coefficients keep the prior of the fit: without it, some directions of theirs with hardly any
    effect on the poses would reproduce a finding by coefficients that no arm has.
    """
    model = fit.model
    arm = model.arm
    rows = _thinned(data, np.arange(data.n), _LINEARISED_POSES)
    data, whitening = data.subset(rows), fit.whitening.subset(rows)
    pool, missing = named_candidates(arm, data, declared, only)
    # Terms that several forms share (order 1 alone and with order 2) occur once.
    unique: dict[str, Term] = {}
    for candidate in pool:
        for term in candidate.terms:
            unique.setdefault(candidate.effect.term_key(term), term)
    joints = tuple(Term(f"motion {motion}", "", 1.0, (Part(motion),)) for motion in _followed(arm))
    is_searched = only is None or CHANGE_POINT in only
    steps = {form: form.terms(arm, data) for form in step_forms(arm, data)} if is_searched else {}
    bound = model.bind(data)
    count = len(bound.terms)
    added = (*joints, *unique.values(), *(term for terms in steps.values() for term in terms))
    extended = dataclasses.replace(bound, terms=(*bound.terms, *added))
    poses, jacobian = extended.linearise(np.concatenate((fit.theta, np.zeros(len(added)))))
    residual = residuals(data, poses)
    observed = observed_jacobian(jacobian, residual)
    first_step = count + len(joints) + len(unique)
    columns = np.moveaxis(whitening.apply(np.moveaxis(observed[:, :first_step], 1, 0)), 0, 1)
    n_declared = sum(len(effect.terms(arm, data)) for effect in declared)
    identified = fit.identifiability.columns
    in_base = identified < n_declared
    precision = np.zeros(count)
    precision[identified] = fit.precision
    put_back = np.arange(count) >= n_declared
    put_back |= precision > 0.0
    whitened = whitening.apply(residual) + np.einsum("mpn,p->mn", columns[:, :count][:, put_back], fit.theta[put_back])
    number = {key: i for i, key in enumerate(unique)}
    places = tuple(
        np.array([number[candidate.effect.term_key(term)] for term in candidate.terms]) for candidate in pool
    )
    return LinearisedCandidates(
        model=model,
        data=data,
        rows=rows,
        base=columns[:, identified[in_base]],
        base_precision=_SHARE_OF_PRECISION * fit.precision[in_base],
        pool_columns=columns[:, count + len(joints) :],
        pool=tuple(pool),
        places=places,
        joint_columns=columns[:, count : count + len(joints)],
        whitening=whitening,
        step_scans=_step_scans(arm, data, steps, observed[:, first_step:]),
        place_scans=place_scans(arm, data, columns[:, count + len(joints) - 3 : count + len(joints)], only),
        residual=whitened,
        inliers=fit.inliers[rows],
        missing=missing,
        only=None if only is None else tuple(only),
    )


def _followed(arm: Arm) -> tuple[int, ...]:
    """Return the motions of the joints' variables, and those of the base's x, y, z."""
    return (*arm.chain.joint_axis, *(arm.chain.index(BASE, label) for label in "xyz"))


def _step_scans(
    arm: Arm, data: Measurements, forms: Mapping[Effect, Sequence[Term]], columns: Array
) -> tuple[StepScan, ...]:
    """Return the scans of the forms of a step, of which ``columns`` ``(M, S, n)`` holds those of all terms in turn."""
    if not forms or data.n < 2:
        return ()
    numbered = places(data, visit_numbers(data))
    usable = usable_places(mixed_places(data, numbered[0]))
    same_part = Counter(form.joints or form.settings()["part"] for form in forms)
    scans, start = [], 0
    for form, terms in forms.items():
        log_prior = -math.log(TYPICAL_CANDIDATES * same_part[form.joints or form.settings()["part"]])
        part = columns[:, start : start + len(terms)]
        start += len(terms)
        scan = scan_of(form, arm, data, part, numbered, usable, log_prior)
        if scan is not None:
            scans.append(scan)
    return tuple(scans)
