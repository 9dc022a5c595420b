"""Play with a memory (hysteresis) is noticed in the residual; play without one, and chance, are not."""

from __future__ import annotations

import numpy as np
from independent_arm import LIMITS, Run, measured, torques
from searched import fitted

from robacc.diagnostics.recorded import memory_of_play
from robacc.effects.base import effect_class

N = 120


def sequence(seed: int) -> Run:
    """Poses that follow each other; the direction is that of the move."""
    rng = np.random.default_rng(seed)
    low, high = np.array(LIMITS).T[..., None]
    q = rng.uniform(low, high, (6, N))
    return Run(q, np.sign(np.diff(q, axis=1, prepend=0.0)), 30.0 * np.arange(N))


def memory_p_value(poses: Run, memory: float, seed: int) -> float:
    """Return the p-value for joint 3 with play of 0.2 mrad and a share of it that follows the torque's change."""
    torque = np.array([torques(q)[2] for q in poses.q.T])
    change = np.sign(np.diff(torque, prepend=torque[0]))
    position = poses.turned(2, 2e-4 * ((1 - memory) * poses.direction[2] + memory * change))
    data = measured(poses, position, 2e-5, seed, timed=True, directed=True)
    play = effect_class("backlash").from_settings(("j3",), {})
    return memory_of_play(fitted(data, (play,)), data, ["j3"])["j3"]


def test_a_memory_is_noticed() -> None:
    assert memory_p_value(sequence(1), 0.25, 1) < 1e-4


def test_play_alone_has_none() -> None:
    """Twelve arms: the smallest of twelve uniform p-values is below 0.002 in one of forty runs; the seeds are fixed."""
    p_values = [memory_p_value(sequence(seed), 0.0, seed) for seed in range(2, 8)]
    assert min(p_values) > 0.002
    assert max(p_values) > 0.2
