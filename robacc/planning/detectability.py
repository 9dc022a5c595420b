"""Detection limits and power of every effect at planned poses, and pairs of effects that are not distinguishable.

The poses are in their planned order, so directions and speeds of approach and the time are known. The noise is known
too; the test is that of a trace (:mod:`robacc.tracing.detection`).
"""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.effects.base import REGISTRY, Term
from robacc.error_model.estimate import ACCEPTED
from robacc.fitting.identifiability import identify_terms
from robacc.geometry import Array, rms_length
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.planning.linear_model import ExpectedNoise, whitened
from robacc.tracing.candidates import Candidate, named_candidates
from robacc.tracing.detection import decisive_test, visible

_LARGEST = 300.0
"""Largest limit, in multiples of the typical size."""
_CERTAIN = 10.0
"""Multiple of the noncentrality at probability 1/2 from which an effect is found for certain, to nine digits."""
_DETECTABLE = 0.5
"""Power from which an effect counts as detectable at its usual size."""


@dataclass(frozen=True, slots=True)
class ExpectedLimit:
    """Detection limit of one form of an effect, and the power at its usual size."""

    effect: str
    joints: tuple[str, ...]
    settings: dict[str, object]
    unit: str
    limit: float | None
    """Size found with probability 1/2; with several coefficients, in the direction least visible. None: never."""
    usual: float
    """Usual size: geometric mean of the catalogue's range."""
    power: float
    """Probability that an effect of the usual size is found."""
    rms: float | None
    """Displacement of the target by an effect of the limit's size, m rms over the poses."""

    @property
    def where(self) -> str:
        """``backlash[j2]``, without settings."""
        return self.effect + (f"[{','.join(self.joints)}]" if self.joints else "")

    @property
    def label(self) -> str:
        """``backlash[j2]``, with settings."""
        settings = ", ".join(f"{key} {_text(value)}" for key, value in self.settings.items())
        return self.where + (f" ({settings})" if settings else "")


def _text(value: object) -> str:
    """Return a setting as text: the members of a list with ``+`` between them."""
    if isinstance(value, list | tuple):
        return "+".join(map(_text, value))
    return f"{value:g}" if isinstance(value, float) else str(value)


@dataclass(frozen=True, slots=True)
class InseparablePair:
    """Two effects of which the second explains the first, at its usual size, within the noise."""

    first: str
    second: str
    similarity: float
    """Largest cosine between the new parts of their columns."""
    evidence: float
    """Expected difference in evidence (log Bayes factor) if the first is the truth, at its usual size."""


@dataclass(frozen=True, slots=True)
class Detectability:
    """What a trace of the planned poses can find."""

    limits: tuple[ExpectedLimit, ...]
    pairs: tuple[InseparablePair, ...]
    missing: dict[str, str]
    """Reason why an effect cannot be tested, by effect."""


@dataclass(frozen=True)
class _Form:
    candidate: Candidate
    columns: NDArray[np.int64]
    limit: ExpectedLimit


def detectability(model: Model, data: Measurements, noise: ExpectedNoise) -> Detectability:
    """Return detection limits given the free effects of ``model``, for the rows of ``data`` in their order."""
    pool, missing = named_candidates(model.arm, data, model.free)
    pool = [c for c in pool if len({term.unit for term in c.terms}) == 1]
    names = [{term.name for term in candidate.terms} for candidate in pool]
    pool = [c for c, terms in zip(pool, names, strict=True) if not any(other < terms for other in names)]
    base, columns, places = _columns(model, data, noise, pool)
    orthogonal = _without(base, columns)
    gram = orthogonal.T @ orthogonal
    lengths = np.sum(np.square(columns), axis=0)
    dof = float(columns.shape[0] - base.shape[1])
    if dof <= 0:
        return Detectability((), (), missing)
    weight = 1.0 / math.hypot(noise.position, noise.unexplained)
    rows = columns.reshape(-1, data.n, columns.shape[1])
    forms = [
        _Form(candidate, place, _limit(candidate, place, gram, lengths, dof, rows, weight))
        for candidate, place in zip(pool, places, strict=True)
    ]
    return Detectability(tuple(form.limit for form in forms), _pairs(forms, gram), missing)


def _columns(
    model: Model, data: Measurements, noise: ExpectedNoise, pool: list[Candidate]
) -> tuple[Array, Array, list[NDArray[np.int64]]]:
    """Return whitened columns ``(M N, K)`` of the free effects that are identifiable, and of the pool's terms."""
    unique: dict[str, Term] = {}
    for candidate in pool:
        for term in candidate.terms:
            unique.setdefault(candidate.effect.term_key(term), term)
    number = {key: i for i, key in enumerate(unique)}
    places = [np.array([number[c.effect.term_key(term)] for term in c.terms], dtype=np.int64) for c in pool]
    bound = model.bind(data)
    count = len(bound.terms)
    extended = dataclasses.replace(bound, terms=(*bound.terms, *unique.values()))
    rows = 3 if noise.orientation is None else 6
    jacobian = extended.linearise(np.zeros(len(extended.terms)))[1][:rows]
    white = whitened(model, data, noise, jacobian)
    flat = np.moveaxis(white, 1, 2).reshape(-1, white.shape[1])
    free = flat[:, :count]
    triangle = np.asarray(np.linalg.qr(free, mode="r"))
    terms = bound.terms
    identified = identify_terms(triangle, terms, data.n)
    return free[:, identified.columns], flat[:, count:], places


def _without(base: Array, columns: Array) -> Array:
    """Return the part of ``columns`` that is orthogonal to ``base``, taken out twice for the sake of rounding."""
    if base.shape[1] == 0:
        return columns
    basis = np.linalg.qr(base / np.linalg.norm(base, axis=0))[0]
    for _ in range(2):
        columns = columns - basis @ (basis.T @ columns)
    return columns


def _limit(
    candidate: Candidate,
    place: NDArray[np.int64],
    gram: Array,
    lengths: Array,
    dof: float,
    rows: Array,
    weight: float,
) -> ExpectedLimit:
    effect = candidate.effect
    usual = usual_size(effect.name)
    values, vectors = visible(gram[np.ix_(place, place)], lengths[place])
    size = rms = None
    power = 0.0
    if values[0] > 0:
        test = decisive_test(values.size, dof, candidate.log_prior_of_size)
        needed = test.noncentrality_at_limit
        size = math.sqrt(needed / float(values[0]))
        noncentrality = usual**2 * float(values[0])
        power = 1.0 if noncentrality > _CERTAIN * needed else test.power(noncentrality)
        if size > _LARGEST * candidate.terms[0].typical:
            size = None
    if size is not None:
        moved = np.einsum("mnq,q->mn", rows[:3][:, :, place], vectors[:, 0]) / weight
        rms = size * rms_length(moved)
    return ExpectedLimit(
        effect.name, effect.joints, effect.settings(), candidate.terms[0].unit, size, usual, power, rms
    )


def usual_size(effect: str) -> float:
    """Return the geometric mean of the catalogue's usual range of a coefficient."""
    low, high = REGISTRY[effect].about.usual_range
    return math.sqrt(low * high)


def _pairs(forms: list[_Form], gram: Array) -> tuple[InseparablePair, ...]:
    """Return the pairs of detectable effects, one form for each effect and joint, that are not distinguishable."""
    first_forms: dict[tuple[str, tuple[str, ...]], _Form] = {}
    for form in forms:
        if form.limit.power >= _DETECTABLE:
            first_forms.setdefault((form.limit.effect, form.limit.joints), form)
    entries = list(first_forms.values())
    pairs = []
    for form in entries:
        block = gram[np.ix_(form.columns, form.columns)]
        usual = form.limit.usual
        for rival in entries:
            if rival is form:
                continue
            cross = gram[np.ix_(form.columns, rival.columns)]
            explained = cross @ np.linalg.pinv(gram[np.ix_(rival.columns, rival.columns)], rcond=1e-9) @ cross.T
            remaining = max(float(np.linalg.eigvalsh(block - explained)[0]), 0.0)
            evidence = 0.5 * usual**2 * remaining
            if evidence < ACCEPTED:
                whitener = np.linalg.pinv(block, rcond=1e-12, hermitian=True)
                similarity = math.sqrt(min(max(float(np.linalg.eigvals(whitener @ explained).real.max()), 0.0), 1.0))
                pairs.append(InseparablePair(form.limit.label, rival.limit.label, similarity, evidence))
    return tuple(sorted(pairs, key=lambda pair: (-round(pair.similarity, 9), pair.evidence)))
