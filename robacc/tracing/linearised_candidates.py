"""One linearisation of a model and of all candidates, from which any subset of its poses can choose."""

from __future__ import annotations

import dataclasses
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.chain import BASE
from robacc.effects.base import Effect, Part, Term
from robacc.effects.change_points import changes_load, is_step
from robacc.effects.orders import HIGHEST_ORDER
from robacc.effects.periodic import searched_order
from robacc.fitting.fit_result import Fit
from robacc.fitting.whitening import Whitening
from robacc.geometry import Array
from robacc.modelling.observation import observed_jacobian, residuals
from robacc.robots.arm import Arm
from robacc.tracing.candidate_pool import SELECTION_POSES, CandidatePool, log_prior_beside, thinned
from robacc.tracing.candidate_scorer import CandidateScorer
from robacc.tracing.candidates import BLOCK_LOG_PRIOR, TYPICAL_CANDIDATES, Batch, Candidate, order_grids
from robacc.tracing.form_families import FormFamilies
from robacc.tracing.place_scans import PlaceScan, is_placed, place_scan_for, place_scans
from robacc.tracing.selection import Selection
from robacc.tracing.step_scans import StepScan, late_places, scan_for, scan_of
from robacc.tracing.whitened_columns import Columns

_SHARE_OF_PRECISION = 1e-3
"""Share of the precision of a constant's prior that counts when candidates are scored: thirty times its standard
deviation. The prior is estimated where effects are missing, which makes it narrow; here it only excludes constants that
no arm has."""
_OFF_GRID_LOG_PRIOR = -8.0
"""Log prior of an order on a joint whose orders are not searched: about that of a searched order."""


@dataclass(frozen=True)
class LinearisedCandidates:
    """One linearisation of a model, from which any subset of poses can choose.

    It uses n of the N poses, those of the pool, so that its memory does not grow with the poses.
    """

    pool: CandidatePool
    base: Array
    """``(M, p, n)`` whitened columns of the declared effects' coefficients."""
    base_precision: Array
    """``(p,)`` prior precision of those coefficients, whitened; zero for none."""
    pool_columns: Array
    """``(M, P, n)`` whitened columns of the pool's terms, each once."""
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

    def selection(
        self, rows: NDArray[np.bool_], start: Sequence[Effect] = (), max_poses: int = SELECTION_POSES
    ) -> Selection:
        """Return a selection on a subset of the poses, empty or with the effects ``start``."""
        at = self._thinned(rows, max_poses)
        count = self.base.shape[1]
        system = Columns(
            np.concatenate((self.base[:, :, at], self.pool_columns[:, :, at]), axis=1), self.residual[:, at]
        )
        pool, arm = self.pool, self.pool.arm
        data = pool.data.subset(at)
        families = FormFamilies(
            system,
            self.joint_columns[:, :, at],
            at,
            self.whitening.subset(at),
            self.step_scans,
            lambda effect: pool.refinements(effect, at),
            lambda effect: pool.beside(effect, at),
        )

        def expand(candidate: Candidate) -> Array:
            scan = scan_for(self.step_scans, candidate.effect) if is_step(candidate.effect) else None
            if scan is not None:
                return scan.whitened(candidate, self.whitening)[:, :, at]
            terms = candidate.terms or candidate.effect.terms(arm, pool.data)
            return self._columns_of(terms)[:, :, at]

        scorer = CandidateScorer(
            system,
            tuple(range(count)),
            self.base_precision,
            pool.candidates,
            [numbers + count for numbers in pool.term_numbers],
            order_grids(arm, data, pool.only),
            order_grids(arm, data, pool.only, high=True),
            families,
            expand,
            pool.rows[at],
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
        return self.pool.block_batches(self._thinned(rows, max_poses))

    def _thinned(self, rows: NDArray[np.bool_], max_poses: int) -> NDArray[np.int64]:
        """Return the rows for a selection: all, or ``max_poses`` of them, sampled by commanded pose."""
        return thinned(self.pool.data, np.flatnonzero(rows[self.pool.rows] & self.inliers), max_poses)

    def _candidate(self, effect: Effect) -> Candidate:
        """Return the candidate of an effect, with its prior in the search."""
        arm, data, only = self.pool.arm, self.pool.data, self.pool.only
        search_key, key = effect.search_key(), effect.key()
        same = [candidate for candidate in self.pool.candidates if candidate.effect.search_key() == search_key]
        for candidate in same:
            if candidate.key == key:
                return candidate
        terms = effect.terms(arm, data)
        if same:
            return Candidate(effect, terms, same[0].log_prior)
        if is_step(effect) and (scan := scan_for(self.step_scans, effect)) is not None:
            return Candidate(effect, terms, scan.log_prior)
        if is_placed(effect) and (place_scan := place_scan_for(self.place_scans, effect)) is not None:
            return Candidate(effect, terms, place_scan.log_prior)
        if any(term.group for term in terms):
            return Candidate(effect, terms, BLOCK_LOG_PRIOR)
        if effect.odds_beside < 1.0:
            return Candidate(effect, terms, log_prior_beside(effect))
        order = searched_order(effect)
        is_high = order is not None and order > HIGHEST_ORDER
        searched = order_grids(arm, data, only, high=is_high)
        log_prior = next((grid.log_prior for grid in searched if (grid.joint,) == effect.joints), _OFF_GRID_LOG_PRIOR)
        return Candidate(effect, terms, log_prior)

    def _columns_of(self, terms: Sequence[Term]) -> Array:
        """Return columns of terms that act on joint variables or on the base's x, y, z."""
        number = {motion: i for i, motion in enumerate(_followed(self.pool.arm))}
        result = np.zeros((self.residual.shape[0], len(terms), self.pool.data.n))
        for i, term in enumerate(terms):
            for part in term.parts:
                result[:, i] += self.joint_columns[:, number[part.motion]] * part.factor
        return result


def linearise(fit: Fit, pool: CandidatePool) -> LinearisedCandidates:
    """Return columns of the declared effects and of all candidates, at a fit that may contain findings besides.

    ``pool`` is that of the fit's arm and declared effects. The contribution of the findings is put back into the
    residual, to first order, so that they are candidates again. Weakly identifiable coefficients keep the prior of the
    fit. Without it, directions with almost no effect on the poses would reproduce a finding by
    coefficients that no arm has.
    """
    model, arm, data = fit.model, pool.arm, pool.data
    whitening = fit.whitening.subset(pool.rows)
    joints = tuple(Term(f"motion {motion}", "", 1.0, (Part(motion),)) for motion in _followed(arm))
    bound = model.bind(data)
    count = len(bound.terms)
    added = (*joints, *pool.terms.values(), *(term for terms in pool.step_forms.values() for term in terms))
    extended = dataclasses.replace(bound, terms=(*bound.terms, *added))
    poses, jacobian = extended.linearise(np.concatenate((fit.theta, np.zeros(len(added)))), rows=fit.residual.shape[0])
    residual = residuals(data, poses)
    observed = observed_jacobian(jacobian, residual)
    first_step = count + len(joints) + len(pool.terms)
    steps = observed[:, first_step:].copy()
    columns = np.moveaxis(observed[:, :first_step], 1, 0).copy()
    del jacobian, observed
    columns = np.moveaxis(whitening.apply_inplace(columns), 0, 1)
    identified = fit.identifiability.columns
    in_base = identified < pool.declared_count
    precision = np.zeros(count)
    precision[identified] = fit.precision
    put_back = np.arange(count) >= pool.declared_count
    put_back |= precision > 0.0
    whitened = whitening.apply(residual) + np.einsum("mpn,p->mn", columns[:, :count][:, put_back], fit.theta[put_back])
    return LinearisedCandidates(
        pool=pool,
        base=columns[:, identified[in_base]],
        base_precision=_SHARE_OF_PRECISION * fit.precision[in_base],
        pool_columns=columns[:, count + len(joints) :],
        joint_columns=columns[:, count : count + len(joints)],
        whitening=whitening,
        step_scans=_step_scans(pool, steps),
        place_scans=place_scans(arm, data, columns[:, count + len(joints) - 3 : count + len(joints)], pool.only),
        residual=whitened,
        inliers=fit.inliers[pool.rows],
    )


def _followed(arm: Arm) -> tuple[int, ...]:
    """Return the motions of the joints' variables, and those of the base's x, y, z."""
    return (*arm.chain.joint_axis, *(arm.chain.index(BASE, label) for label in "xyz"))


def _step_scans(pool: CandidatePool, columns: Array) -> tuple[StepScan, ...]:
    """Return the scans of the forms of a step, of which ``columns`` ``(M, S, n)`` holds those of all terms in turn."""
    forms = pool.step_forms
    if not forms or pool.data.n < 2:
        return ()
    same_part = Counter(form.joints or form.settings()["part"] for form in forms)
    scans, start = [], 0
    for form, terms in forms.items():
        log_prior = -math.log(TYPICAL_CANDIDATES * same_part[form.joints or form.settings()["part"]])
        part = columns[:, start : start + len(terms)]
        start += len(terms)
        usable = pool.usable_step_places
        if changes_load(form):
            usable = usable & late_places(usable.size)
        scan = scan_of(form, pool.arm, pool.data, part, pool.step_places, usable, log_prior)
        if scan is not None:
            scans.append(scan)
    return tuple(scans)
