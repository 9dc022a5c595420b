"""What to measure next: poses at which rival explanations predict most differently (T-optimal discrimination).

Source of the criterion: A. C. Atkinson and V. V. Fedorov, "The design of experiments for discriminating between two
rival models", Biometrika 62, 1975.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from robacc.effects.base import Effect, effect_class
from robacc.errors import RobaccError
from robacc.fitting.solver import Fit, fit
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.tracing.loop import SEARCH

_TRIED = 600
"""Poses drawn to find those of largest difference among."""
_ADVISED = 4
_NEARLY = 0.6
"""Share of the largest difference from which a pose decides nearly as well."""
_WORTH = 0.5
"""A difference below this share of the noise is not worth a pose."""


@dataclass(frozen=True, slots=True)
class Advice:
    """Poses that would decide between two explanations."""

    text: str
    q: tuple[tuple[float, ...], ...]
    """Joint variables of each pose, rad or m."""
    difference: tuple[float, ...]
    """How far apart the two predict the target there, m."""


def advise(
    declared: Fit, effects: Sequence[Effect], own: Effect, rival: Effect, data: Measurements, noise: float, seed: int
) -> Advice | None:
    """Poses inside the joint limits (or the range measured) where ``own`` and ``rival`` differ most.

    Both models are fitted to all poses; circumstances other than the joints are drawn from those measured.
    """
    others = [effect for effect in effects if effect is not own]
    try:
        first = fit(declared.model.with_free(*others, own), data, SEARCH)
        second = fit(declared.model.with_free(*others, rival), data, SEARCH)
        tried = _trial_poses(declared, data, seed)
        apart = [one.model.bind(tried).poses(one.theta).translation for one in (first, second)]
    except RobaccError:
        return None
    difference = np.linalg.norm(apart[0] - apart[1], axis=0)
    if difference.max() < _WORTH * noise:
        return Advice(
            f"no pose within the joint limits tells {own} from {rival}: they differ by at most "
            f"{difference.max() * 1e3:.2g} mm; only other data do (another payload, an indicator on the base)",
            (),
            (),
        )
    assert tried.q is not None
    chosen = _spread(tried.q, difference)
    q = tuple(tuple(float(value) for value in tried.q[:, i]) for i in chosen)
    return Advice(f"to tell {own} from {rival}, measure:", q, tuple(float(difference[i]) for i in chosen))


def rival_effect(name: str, joints: tuple[str, ...], settings: dict[str, object]) -> Effect:
    """An alternative as an effect."""
    return effect_class(name).from_settings(joints, settings)


def _trial_poses(declared: Fit, data: Measurements, seed: int) -> Measurements:
    """Random poses within limits, with circumstances of measured rows drawn at random."""
    assert data.q is not None
    generator = np.random.default_rng(seed)
    rows = generator.integers(0, data.n, _TRIED)
    low, high = data.q.min(axis=1), data.q.max(axis=1)
    for i, joint in enumerate(declared.model.arm.robot.variables):
        if joint.limits is not None:
            low[i], high[i] = joint.limits
    q = low[:, None] + (high - low)[:, None] * generator.random((data.q.shape[0], _TRIED))
    return dataclasses.replace(data.subset(rows), q=q)


def _spread(q: Array, difference: Array) -> list[int]:
    """The pose of largest difference, then those nearly as good that are far from the ones taken."""
    spread = np.maximum(np.ptp(q, axis=1), 1e-9)[:, None]
    good = np.flatnonzero(difference >= _NEARLY * difference.max())
    chosen = [int(np.argmax(difference))]
    while len(chosen) < min(_ADVISED, good.size):
        gaps = np.min(
            [np.linalg.norm((q[:, good] - q[:, [i]]) / spread, axis=0) for i in chosen],
            axis=0,
        )
        chosen.append(int(good[np.argmax(gaps)]))
    return chosen
