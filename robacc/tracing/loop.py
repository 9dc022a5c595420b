"""The loop: fit what is declared, linearise, choose, refit everything together, and again until nothing changes."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from robacc.effects.base import Effect, Part, Term
from robacc.effects.transmission_error import TransmissionError
from robacc.fitting.registration import ALIGNABLE
from robacc.fitting.solver import Fit, Options, fit
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.modelling.observation import observed_jacobian, residuals
from robacc.tracing.candidates import (
    BLOCK_LOG_PRIOR,
    ORDER_STEP,
    Batch,
    Candidate,
    batches,
    corrections,
    named_candidates,
    profiles,
    waves,
)
from robacc.tracing.competition import Competition
from robacc.tracing.evidence import Columns
from robacc.tracing.selection import FALSE_ALARM, Selection, Step

_ROUNDS = 4
"""Times at most that everything is fitted together and chosen again."""
SELECTION_POSES = 800
"""Poses that a choice looks at, at most: fits and figures are of all of them."""
_COMPETED_ON = 4 * SELECTION_POSES
"""Poses that columns are made for: a choice without some of them, a fold's, still finds as many as it looks at."""
_BETTER = 10.0
"""Nats by which an explanation with a correction in it must beat the named one (odds of 20,000 to 1)."""
_MANY = 3
"""Named findings from which a correction is tried in place of them though they leave no structure."""
_OFF_GRID_LOG_PRIOR = -8.0
"""Of an order on a joint where this scene searches none: about that of an order searched elsewhere."""
SEARCH = Options(tolerance=1e-4, settled=1e-2)
"""Fits that a choice is made on; those that are reported converge further."""


@dataclass(frozen=True)
class Scene:
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
        if self.only is None or "joint_correction" in self.only:
            found += corrections(arm, self.data)
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

        field = Competition(
            system,
            tuple(range(count)),
            self.pool,
            [place + count for place in self.places],
            waves(arm, data, self.only),
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
        searched = waves(self.model.arm, self.data, self.only)
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


def linearise(found: Fit, data: Measurements, declared: Sequence[Effect], only: Sequence[str] | None = None) -> Scene:
    """Columns of the declared effects and of everything that competes, at a fit that may hold findings besides.

    What the findings explain is put back into the residual, to first order, so that they compete again like the rest.
    """
    model = found.model
    arm = model.arm
    rows = _thinned(data, np.arange(data.n), _COMPETED_ON)
    data, weight = data.subset(rows), found.weight[:, rows]
    pool, missing = named_candidates(arm, data, declared, only)
    # Terms that several forms share (order 1 alone and with order 2) stand once.
    unique: dict[str, Term] = {}
    for candidate in pool:
        for term in candidate.terms:
            unique.setdefault(_identity(candidate.effect, term), term)
    joints = tuple(Term(f"joint {i}", "", 1.0, (Part(motion),)) for i, motion in enumerate(arm.chain.joint_axis))
    bound = model.bind(data)
    count = len(bound.terms)
    extended = dataclasses.replace(bound, terms=(*bound.terms, *joints, *unique.values()))
    poses, jacobian = extended.linearise(np.concatenate((found.theta, np.zeros(len(joints) + len(unique)))))
    residual = residuals(data, poses)
    columns = observed_jacobian(jacobian, residual) * weight[:, None, :]
    own = sum(len(effect.terms(arm, data)) for effect in declared)
    whitened = residual * weight + np.einsum("mpn,p->mn", columns[:, own:count], found.theta[own:])
    kept = found.identifiability.kept
    number = {key: i for i, key in enumerate(unique)}
    places = tuple(
        np.array([number[_identity(candidate.effect, term)] for term in candidate.terms]) for candidate in pool
    )
    return Scene(
        model=model,
        data=data,
        rows=rows,
        base=columns[:, kept[kept < own]],
        pool_columns=columns[:, count + len(joints) :],
        pool=tuple(pool),
        places=places,
        joint_columns=columns[:, count : count + len(joints)],
        residual=whitened,
        kept=found.kept[rows],
        missing=missing,
        only=None if only is None else tuple(only),
    )


def _identity(effect: Effect, term: Term) -> str:
    """What makes two terms of the pool the same column."""
    scope = "" if effect.name in ("transmission_error", "axis_wobble", "link_geometry") else str(effect.key())
    return f"{term.name}|{scope}"


def choose(
    scene: Scene,
    rows: NDArray[np.bool_],
    start: Sequence[Effect] = (),
    empirical: bool = True,
    most: int = SELECTION_POSES,
) -> Selection:
    """Named effects first; where they leave structure, or take many to explain it, a correction may do better."""
    named = scene.selection(rows, start, most)
    blocks = scene.batches(rows, most) if empirical else []
    named.field.blocks = blocks
    if any(one.candidate.is_correction for one in named.chosen):
        named.run(with_blocks=True)
        return named
    named.run()
    if not blocks:
        return named
    left = named.rank(with_blocks=True)
    structured = bool(left) and left[0].p_value <= FALSE_ALARM
    if not structured and len(named.chosen) < _MANY:
        return named
    mixed = scene.selection(rows, (), most)
    mixed.field.blocks = blocks
    mixed.run(with_blocks=True)
    if structured:
        named.run(with_blocks=True)
    return mixed if mixed.total() > named.total() + (0.0 if structured else _BETTER) else named


@dataclass(frozen=True)
class Loop:
    """What the loop found on one set of poses."""

    declared: Fit
    final: Fit
    effects: tuple[Effect, ...]
    steps: tuple[Step, ...]
    scene: Scene
    selection: Selection


def close_loop(
    model: Model,
    data: Measurements,
    options: Options = SEARCH,
    only: Sequence[str] | None = None,
    empirical: bool = True,
) -> Loop:
    """Fit, choose, refit, until the choice stands."""
    declared = fit(model, data, options)
    everything = np.ones(data.n, dtype=bool)
    first = scene = linearise(declared, data, model.free, only)
    selection = choose(scene, everything, empirical=empirical)
    steps = list(selection.steps)
    present: Fit = declared
    effects: tuple[Effect, ...] = ()
    frames: tuple[Effect, ...] = ()
    for _ in range(_ROUNDS):
        chosen = frames + tuple(selection.refined(one) for one in selection.chosen)
        if [coarse(effect) for effect in chosen] == [coarse(effect) for effect in effects]:
            break
        effects = chosen
        # A frame that was found is registered anew by every fit, so it does not compete again.
        frames = tuple(effect for effect in effects if effect.name in ALIGNABLE)
        rest = tuple(effect for effect in effects if effect.name not in ALIGNABLE)
        present = refit(present, (*declared.model.free, *frames, *rest), data, options)
        scene = linearise(present, data, (*model.free, *frames), only)
        selection = choose(scene, everything, rest, empirical)
        steps.extend(selection.steps)
    return Loop(declared, present, effects, tuple(steps), first, selection)


def refit(like: Fit, free: Sequence[Effect], data: Measurements, options: Options) -> Fit:
    """Fit a model with the effects ``free`` from where a similar fit ended, base and tool registered as they are there.

    What the other fit does not have starts at zero. The first step is always taken, so the poses of ``data`` decide.
    """
    model = dataclasses.replace(like.model, free=tuple(free))
    ended = {
        (like.model.free[owner].key(), name): value
        for owner, name, value in zip(like.owners, like.names, like.theta.tolist(), strict=True)
    }
    # A term's name does not depend on the poses, so one is enough to list them.
    one = data.subset(np.arange(1))
    start = [ended.get((effect.key(), term.name), 0.0) for effect in free for term in effect.terms(model.arm, one)]
    # Rows that are no part of the rest were found out once; where they are the same rows they start left out.
    kept = like.kept if options.robust and like.kept.size == data.n else None
    begin = dataclasses.replace(options, start=np.array(start), kept=kept, widths=like.widths, held=like.held)
    return fit(model, data, begin)


def frames_first(effects: Iterable[Effect]) -> tuple[Effect, ...]:
    """Frames first, so that they keep their parameters where poses cannot tell two apart."""
    return tuple(sorted(effects, key=lambda effect: effect.name not in ALIGNABLE))


def coarse(effect: Effect) -> tuple[object, ...]:
    """An effect's key with searched orders rounded to the grid: the same line found again has the same."""
    if isinstance(effect, TransmissionError) and not effect.shrunk:
        return (effect.name, effect.joints, tuple(round(order / ORDER_STEP) for order in effect.orders))
    return effect.key()
