"""Poses on which few joints move: constants that they hardly show keep their prior while effects are judged."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
from arms import arm

from robacc.effects import REGISTRY
from robacc.fitting.solver import fit
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.tracing.candidate_pool import CandidatePools
from robacc.tracing.linearised_candidates import linearise
from robacc.tracing.loop import search
from robacc.tracing.refitting import SEARCH
from robacc.tracing.remaining_scatter import with_remaining_scatter

DECLARED = ("base_frame", "tool_frame", "joint_offset", "link_geometry")
N = 40


@cache
def measured(jitter: float = 5e-5) -> tuple[Model, Measurements]:
    """Return the declared effects, and poses of joints 1 and 2 alone; joints 2 and 4 err by the sine of joint 2.

    The other joints move by ``jitter``, rad.
    """
    robot = arm("panda").robot
    rng = np.random.default_rng(3)
    q = rng.normal(0.0, jitter, (7, N))
    q[3] -= 0.1
    q[0], q[1] = rng.uniform(-1.5, 2.7, N), rng.choice(np.linspace(-1.4, 1.4, 9), N)
    reached = q.copy()
    reached[1] += 4e-3 * np.sin(q[1])
    reached[3] -= 3e-3 * np.sin(q[1])
    nominal = Model.of(robot)
    true = nominal.bind(Measurements(q=reached, position=np.zeros((3, N)))).poses(np.zeros(0))
    data = Measurements(q=q, position=true.translation + rng.normal(0.0, 2e-4, (3, N)), rotation=true.rotation)
    return nominal.with_free(*(REGISTRY[name].default(nominal.arm, data) for name in DECLARED)), data


def ridge(design: np.ndarray, target: np.ndarray, precision: np.ndarray) -> tuple[np.ndarray, float]:
    """Return the coefficients, and the least of squares and prior together, as one longer least-squares problem."""
    rows = np.concatenate((design, np.diag(np.sqrt(precision))))
    values = np.concatenate((target, np.zeros(precision.size)))
    solution = np.linalg.lstsq(rows, values, rcond=1e-13)[0]
    return solution, float(np.sum(np.square(values - rows @ solution)))


def test_candidates_are_judged_beside_the_priors_of_the_fit() -> None:
    model, data = measured(2e-3)
    fitted = fit(model, data, SEARCH)
    candidates = linearise(fitted, CandidatePools(data).of(fitted.model.arm, model.free))
    precision = candidates.base_precision
    assert (precision > 0.0).any()
    scorer = candidates.selection(np.ones(N, dtype=bool)).scorer
    at = scorer.poses
    design = np.moveaxis(candidates.base[:, :, at], 1, 2).reshape(-1, precision.size)
    residual = candidates.residual[:, at].ravel()
    # With its whole prior, the fit is the minimum; coefficients without a prior start at the fit.
    coefficients, _ = ridge(design, residual, fitted.precision)
    cost = ridge(design, residual, precision)[1]
    columns = fitted.identifiability.columns
    expected = np.where(precision > 0.0, fitted.theta[columns], 0.0)
    np.testing.assert_allclose(design @ coefficients, design @ expected, atol=0.02 * np.sqrt(cost / residual.size))
    conditioned = scorer.condition([])
    assert conditioned.cost == pytest.approx(cost, rel=1e-6)
    for entry in scorer.rank(conditioned, [])[:3]:
        added = candidates.pool_columns[:, candidates.pool.term_numbers[scorer.pool.index(entry.candidate)]][:, :, at]
        block = np.moveaxis(added, 1, 2).reshape(design.shape[0], -1)
        alone = ridge(
            np.concatenate((design, block), axis=1), residual, np.concatenate((precision, np.zeros(block.shape[1])))
        )
        # Directions of the candidate that are nearly those of the model are left out of the evidence.
        assert entry.gain == pytest.approx(cost - alone[1], rel=0.02)


def test_an_error_that_no_finding_explains_does_not_pass_for_scatter() -> None:
    model, data = measured()
    found = search(model, data, SEARCH, only=("gear_ratio",), empirical=False)
    with_one = dataclasses.replace(found, effects=(REGISTRY["gear_ratio"].default(model.arm, data, ("panda_joint2",)),))
    result = with_remaining_scatter(with_one, dataclasses.replace(found, effects=(), final=found.declared), data)
    plain = fit(model, data, SEARCH)
    before, after = (float(np.mean(np.square(f.residual[:3]))) for f in (plain, result.declared))
    assert after <= 1.1 * before
