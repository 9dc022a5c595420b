"""Problem of choice for a trace: poses at which every effect of the catalogue shows at its usual size.

All effects are coefficients of one model, each with a prior of its usual size. The sum of their variances after the
measurement, in units of the priors (Bayesian A-optimality, K. Chaloner and I. Verdinelli, "Bayesian experimental
design: a review", Statistical Science 10, 1995), is small only if each effect shows beside the frames and the declared
effects, and beside every other effect: power and separation in one number.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from robacc.effects.base import Term
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.planning.design import DesignProblem, information_of
from robacc.planning.detectability import usual_size
from robacc.planning.linear_model import ExpectedNoise, coefficients, planned_data, pose_rows, whitened
from robacc.tracing.candidates import named_candidates


def power_problem(
    model: Model, q: Array, noise: ExpectedNoise, already: Measurements | None, seed: int
) -> DesignProblem:
    """Return the problem for candidates ``q`` ``(J, N)``.

    Directions and speeds of approach are random: the order of the visits, which is found later, gives each joint both.
    """
    generator = np.random.default_rng([seed, 4])
    speed = generator.uniform(-1.0, 1.0, q.shape)
    motion = Measurements(position=np.zeros((3, q.shape[1])), direction=np.sign(speed), speed=speed)
    data = planned_data(model.arm.robot, q, motion)
    terms, sizes = _terms(model, data)
    rows = pose_rows(_columns(model, data, noise, terms), max(len(model.arm.robot.targets), 1))
    count = rows.shape[2] - len(terms)
    planned = coefficients(model, rows[:, :, :count])
    kept = np.concatenate((planned.columns, count + np.arange(len(terms))))
    scale = np.concatenate((planned.prior_std, sizes))
    interest = np.concatenate((np.zeros(planned.columns.size), np.ones(len(terms))))
    information = np.eye(scale.size)
    if already is not None and already.q is not None:
        earlier = dataclasses.replace(already, position=np.zeros_like(already.position), rotation=None)
        if earlier.direction is None or earlier.speed is None:
            zero = np.zeros_like(already.q)
            earlier = dataclasses.replace(earlier, direction=zero, speed=zero)
        columns = _columns(model, earlier, noise, _terms_like(model, earlier, terms))[:, kept]
        information = information + information_of(np.moveaxis(columns, 1, 2) * scale)
    empty = np.zeros((3, 1, scale.size))
    return DesignProblem(rows[:, :, kept] * scale, information, empty, "A", interest)


def _terms(model: Model, data: Measurements) -> tuple[dict[str, Term], Array]:
    """Return the terms of all named effects that these poses can show, each once, and their usual sizes."""
    pool, _ = named_candidates(model.arm, data, model.free)
    terms: dict[str, Term] = {}
    sizes: list[float] = []
    for candidate in pool:
        if candidate.is_block:
            continue
        for term in candidate.terms:
            key = candidate.effect.term_key(term)
            if key not in terms:
                terms[key] = term
                sizes.append(usual_size(candidate.effect.name))
    return terms, np.array(sizes)


def _terms_like(model: Model, data: Measurements, wanted: dict[str, Term]) -> dict[str, Term]:
    """Return the same terms for other poses; one that these poses do not have is zero there."""
    available, _ = _terms(model, data)
    return {key: available.get(key, dataclasses.replace(term, parts=())) for key, term in wanted.items()}


def _columns(model: Model, data: Measurements, noise: ExpectedNoise, terms: dict[str, Term]) -> Array:
    """Return whitened columns ``(M, P, N)`` of the free effects, then of ``terms``."""
    bound = model.bind(data)
    extended = dataclasses.replace(bound, terms=(*bound.terms, *terms.values()))
    rows = 3 if noise.orientation is None else 6
    return whitened(model, data, noise, extended.linearise(np.zeros(len(extended.terms)))[1][:rows])
