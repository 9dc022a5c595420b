"""One linearisation of a model and of everything that competes, from which any of its poses can choose."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from robacc.effects.base import Effect, Part, Term
from robacc.fitting.solver import Fit
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.modelling.observation import observed_jacobian, residuals
from robacc.tracing.candidate_scorer import CandidateScorer
from robacc.tracing.candidates import (
    BLOCK_LOG_PRIOR,
    Batch,
    Candidate,
    batches,
    corrections,
    named_candidates,
    order_grids,
    profiles,
)
from robacc.tracing.evidence import Columns
from robacc.tracing.selection import Selection

SELECTION_POSES = 800
"""Poses that a choice looks at, at most: fits and figures are of all of them."""
_COMPETED_ON = 4 * SELECTION_POSES
"""Poses that columns are made for: a choice without some of them, a fold's, still finds as many as it looks at."""
_OFF_GRID_LOG_PRIOR = -8.0
"""Of an order on a joint where this scene searches none: about that of an order searched elsewhere."""


@dataclass(frozen=True)
class LinearisedCandidates:
    """One linearisation of a model, from which any subset of poses can choose.

    It is made of :data:`_COMPETED_ON` poses at most (n of N), so that its memory does not grow with the poses.
    """

    model: Model
    data: Measurements
    """Those poses."""
    rows: NDArray[np.int64]
    """``(n,)`` their places among all."""
    base: Array
    """``(M, p, n)`` whitened columns of the declared effects' coefficients."""
    pool_columns: Array
    """``(M, P, n)`` whitened columns of the pool's terms, each once."""
    pool: tuple[Candidate, ...]
    places: tuple[NDArray[np.int64], ...]
    """For each of the pool its terms' numbers among :attr:`pool_columns`."""
    joint_columns: Array
    """``(M, J, n)`` whitened columns of each joint's variable."""
    residual: Array
    """``(M, n)`` whitened, with what earlier findings explain put back."""
    kept: NDArray[np.bool_]
    """``(n,)`` poses that took part in the fit."""
    missing: dict[str, str]
    """By effect, why it cannot compete."""
    only: tuple[str, ...] | None
    """Names of the effects that compete; None for all."""

    @cached_property
    def blocks(self) -> list[Candidate]:
        """Rich blocks: periodic profiles and empirical corrections."""
        arm = self.model.arm
        found = profiles(arm, self.data, self.only)
        found += corrections(arm, self.data, self.only)
        return found

    def selection(
        self, rows: NDArray[np.bool_], start: Sequence[Effect] = (), most: int = SELECTION_POSES
    ) -> Selection:
        """A choice on some of the poses, from nothing or from effects already found."""
        at = self._thinned(rows, most)
        count = self.base.shape[1]
        system = Columns(
            np.concatenate((self.base[:, :, at], self.pool_columns[:, :, at]), axis=1), self.residual[:, at]
        )
        data = self.data.subset(at)
        arm = self.model.arm

        def expand(candidate: Candidate) -> Array:
            terms = candidate.terms or candidate.effect.terms(arm, self.data)
            return self._columns_of(terms)[:, :, at]

        field = CandidateScorer(
            system,
            tuple(range(count)),
            self.pool,
            [place + count for place in self.places],
            order_grids(arm, data, self.only),
            self.joint_columns[:, :, at],
            expand,
            self.rows[at],
        )
        choice = Selection(field)
        for effect in start:
            choice.start_with(self._candidate(effect))
        return choice

    def batches(self, rows: NDArray[np.bool_], most: int) -> list[Batch]:
        """The rich blocks on the poses that :meth:`selection` chooses on."""
        return batches(self.model.arm, self.blocks, self._thinned(rows, most))

    def _thinned(self, rows: NDArray[np.bool_], most: int) -> NDArray[np.int64]:
        """Rows to choose on: all of them, or so many of them, drawn by commanded pose and not by place in the file."""
        return _thinned(self.data, np.flatnonzero(rows[self.rows] & self.kept), most)

    def _candidate(self, effect: Effect) -> Candidate:
        """The candidate that an effect is, with the prior it competes by."""
        for candidate in self.pool:
            if candidate.effect.key() == effect.key():
                return candidate
        terms = effect.terms(self.model.arm, self.data)
        if any(term.group for term in terms):
            return Candidate(effect, terms, BLOCK_LOG_PRIOR)
        searched = order_grids(self.model.arm, self.data, self.only)
        found = next((wave.log_prior for wave in searched if (wave.joint,) == effect.joints), _OFF_GRID_LOG_PRIOR)
        return Candidate(effect, terms, found)

    def _columns_of(self, terms: Sequence[Term]) -> Array:
        """Columns of terms that act on joint variables alone: the joint's column times the regressor."""
        number = {motion: i for i, motion in enumerate(self.model.arm.chain.joint_axis)}
        result = np.zeros((self.residual.shape[0], len(terms), self.data.n))
        for i, term in enumerate(terms):
            for part in term.parts:
                result[:, i] += self.joint_columns[:, number[part.motion]] * part.factor
        return result


def _thinned(data: Measurements, at: NDArray[np.int64], most: int) -> NDArray[np.int64]:
    """All of the rows ``at``, or so many of them, drawn by commanded pose and not by place in the file."""
    if at.size <= most:
        return at
    groups = data.groups()[at]
    draw = np.random.default_rng(0).permutation(int(groups.max()) + 1)[groups]
    return np.sort(at[np.argsort(draw, kind="stable")[:most]])


def linearise(
    found: Fit, data: Measurements, declared: Sequence[Effect], only: Sequence[str] | None = None
) -> LinearisedCandidates:
    """Columns of the declared effects and of everything that competes, at a fit that may hold findings besides.

    What the findings explain is put back into the residual, to first order, so that they compete again like the rest.
    """
    model = found.model
    arm = model.arm
    rows = _thinned(data, np.arange(data.n), _COMPETED_ON)
    data, white = data.subset(rows), found.whitening.subset(rows)
    pool, missing = named_candidates(arm, data, declared, only)
    # Terms that several forms share (order 1 alone and with order 2) stand once.
    unique: dict[str, Term] = {}
    for candidate in pool:
        for term in candidate.terms:
            unique.setdefault(candidate.effect.term_key(term), term)
    joints = tuple(Term(f"joint {i}", "", 1.0, (Part(motion),)) for i, motion in enumerate(arm.chain.joint_axis))
    bound = model.bind(data)
    count = len(bound.terms)
    extended = dataclasses.replace(bound, terms=(*bound.terms, *joints, *unique.values()))
    poses, jacobian = extended.linearise(np.concatenate((found.theta, np.zeros(len(joints) + len(unique)))))
    residual = residuals(data, poses)
    columns = np.moveaxis(white.apply(np.moveaxis(observed_jacobian(jacobian, residual), 1, 0)), 0, 1)
    own = sum(len(effect.terms(arm, data)) for effect in declared)
    whitened = white.apply(residual) + np.einsum("mpn,p->mn", columns[:, own:count], found.theta[own:])
    kept = found.identifiability.columns
    number = {key: i for i, key in enumerate(unique)}
    places = tuple(
        np.array([number[candidate.effect.term_key(term)] for term in candidate.terms]) for candidate in pool
    )
    return LinearisedCandidates(
        model=model,
        data=data,
        rows=rows,
        base=columns[:, kept[kept < own]],
        pool_columns=columns[:, count + len(joints) :],
        pool=tuple(pool),
        places=places,
        joint_columns=columns[:, count : count + len(joints)],
        residual=whitened,
        kept=found.inliers[rows],
        missing=missing,
        only=None if only is None else tuple(only),
    )
