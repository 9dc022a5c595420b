"""Poses to measure next: poses at which two rival effects predict most differently (T-optimal discrimination).

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
from robacc.fitting.fit_result import Fit
from robacc.fitting.solver import fit
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.tracing.refitting import SEARCH

_TRIAL_POSES = 600
"""Random poses among which those of largest difference are sought."""
_ADVISED = 4
_ELIGIBLE_SHARE = 0.6
"""Share of the largest difference from which a pose is eligible."""
_LEAST_DIFFERENCE = 0.5
"""Share of the noise below which a difference is not worth a pose."""


@dataclass(frozen=True, slots=True)
class Advice:
    """Poses that distinguish two effects."""

    text: str
    q: tuple[tuple[float, ...], ...]
    """Joint variables of each pose, rad or m."""
    difference: tuple[float, ...]
    """Distance between the two effects' predicted targets at each pose, m."""


def advise(
    declared: Fit,
    effects: Sequence[Effect],
    finding: Effect,
    rival: Effect,
    data: Measurements,
    noise: float,
    seed: int,
) -> Advice | None:
    """Return poses inside the joint limits (or the measured range) at which ``finding`` and ``rival`` differ most.

    Both models are fitted to all poses. Circumstances other than the joints are sampled from the measured rows.
    """
    others = [effect for effect in effects if effect is not finding]
    try:
        first = fit(declared.model.with_free(*others, finding), data, SEARCH)
        second = fit(declared.model.with_free(*others, rival), data, SEARCH)
        trial = _trial_poses(declared, data, seed)
        predicted = [fitted.model.bind(trial).poses(fitted.theta).translation for fitted in (first, second)]
    except RobaccError:
        return None
    difference = np.linalg.norm(predicted[0] - predicted[1], axis=0)
    if difference.max() < _LEAST_DIFFERENCE * noise:
        return Advice(
            f"{finding} and {rival} are not distinguishable at any pose within the joint limits: they differ by "
            f"at most {difference.max() * 1e3:.2g} mm; measure other data (another payload, an indicator on the base)",
            (),
            (),
        )
    assert trial.q is not None
    chosen = _choose_poses(trial.q, difference)
    q = tuple(tuple(float(value) for value in trial.q[:, i]) for i in chosen)
    return Advice(f"to distinguish {finding} from {rival}, measure:", q, tuple(float(difference[i]) for i in chosen))


def rival_effect(name: str, joints: tuple[str, ...], settings: dict[str, object]) -> Effect:
    """Return the effect that an alternative describes."""
    return effect_class(name).from_settings(joints, settings)


def _trial_poses(declared: Fit, data: Measurements, seed: int) -> Measurements:
    """Return random poses within limits, with the circumstances of randomly chosen measured rows."""
    assert data.q is not None
    generator = np.random.default_rng(seed)
    rows = generator.integers(0, data.n, _TRIAL_POSES)
    low, high = data.q.min(axis=1), data.q.max(axis=1)
    for i, joint in enumerate(declared.model.arm.robot.variables):
        if joint.limits is not None:
            low[i], high[i] = joint.limits
    q = low[:, None] + (high - low)[:, None] * generator.random((data.q.shape[0], _TRIAL_POSES))
    return dataclasses.replace(data.subset(rows), q=q)


def _choose_poses(q: Array, difference: Array) -> list[int]:
    """Return the pose of largest difference, then eligible poses that are far from those already chosen."""
    ranges = np.maximum(np.ptp(q, axis=1), 1e-9)[:, None]
    eligible = np.flatnonzero(difference >= _ELIGIBLE_SHARE * difference.max())
    chosen = [int(np.argmax(difference))]
    while len(chosen) < min(_ADVISED, eligible.size):
        gaps = np.min(
            [np.linalg.norm((q[:, eligible] - q[:, [i]]) / ranges, axis=0) for i in chosen],
            axis=0,
        )
        chosen.append(int(eligible[np.argmax(gaps)]))
    return chosen
