"""Poses held out in turn: each once, repeats together, whatever the order of rows."""

from __future__ import annotations

import dataclasses

import numpy as np
from arms import arm

from robacc.effects import REGISTRY
from robacc.fitting.cross_validation import LEAST_GROUPS, folds, held_out, parts
from robacc.fitting.solver import fit
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.simulation.simulate import Plan, simulate


def cycled(poses: int = 17, cycles: int = 3) -> Measurements:
    return simulate(arm("puma560").robot, Plan(poses, seed=1, cycles=cycles, noise_position=2e-5)).data


def test_every_row_is_held_out_once_and_repeats_are_never_split() -> None:
    data = cycled()
    assigned = folds(data, 5, 0)
    assert assigned is not None
    assert data.pose is not None
    for pose in np.unique(data.pose):
        assert np.unique(assigned[data.pose == pose]).size == 1
    seen = np.zeros(data.n)
    sizes = []
    for learn, rest in parts(assigned):
        assert not np.any(learn & rest)
        assert np.all(learn | rest)
        seen += rest
        sizes.append(np.unique(data.pose[rest]).size)
    assert np.all(seen == 1)
    assert sorted(sizes) == [3, 3, 3, 4, 4]


def test_a_poses_fold_depends_on_the_seed_and_not_on_the_order_of_rows() -> None:
    for data in (cycled(), dataclasses.replace(cycled(), pose=None)):
        assigned = folds(data, 5, 0)
        order = np.random.default_rng(1).permutation(data.n)
        shuffled = folds(data.subset(order), 5, 0)
        assert assigned is not None
        assert shuffled is not None
        np.testing.assert_array_equal(shuffled, assigned[order])
        assert not np.array_equal(folds(data, 5, 1), assigned)


def test_too_few_poses_hold_none_out() -> None:
    assert folds(cycled(LEAST_GROUPS - 1, 10), 5, 0) is None
    assert folds(cycled(LEAST_GROUPS, 1), 5, 0) is not None


def test_a_residual_held_out_is_of_a_prediction_the_pose_had_no_part_in() -> None:
    data = cycled(20, 1)
    one = arm("puma560")
    model = Model.of(one.robot, [REGISTRY["joint_offset"].default(one, data)])
    found = fit(model, data.subset(np.arange(15)))
    rest = data.subset(np.arange(15, 20))
    moved = dataclasses.replace(rest, position=rest.position + 1.0)
    np.testing.assert_allclose(held_out(found, moved)[:3] - held_out(found, rest)[:3], 1.0, rtol=0, atol=1e-12)
