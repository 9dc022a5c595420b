"""Held-out errors in closed form, against fits that were made without the poses."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from arms import arm

from robacc.effects.specification import build, parse_requests
from robacc.fitting.fit_result import Fit, HoldOut, Options, held_out_poses
from robacc.fitting.solver import fit
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.modelling.model import Model, residuals
from robacc.simulation.simulate import Plan, simulate

FIT = "base_frame,tool_frame,joint_offset,link_geometry,joint_compliance[j2,j3]"
NOISE = 5e-5


def measured(poses: int = 40, cycles: int = 1, *, orientation: bool = True) -> Measurements:
    robot = dataclasses.replace(
        arm("puma560").robot,
        effects=({"effect": "joint_compliance", "joints": ["j2", "j3"], "values": {"j2": 2e-5, "j3": 3e-5}},),
    )
    plan = Plan(poses, seed=1, cycles=cycles, noise_position=NOISE, noise_orientation=1e-4, orientation=orientation)
    return simulate(robot, plan).data


def fitted(data: Measurements, asked: str = FIT, **options: object) -> Fit:
    one = arm("puma560")
    return fit(Model.of(one.robot, build(parse_requests(asked), one, data)), data, Options(**options))  # type: ignore[arg-type]


def refitted(data: Measurements, groups: Array, asked: str, like: Fit) -> Array:
    """Residuals of each group by fits to all others."""
    apart = np.empty((3 if data.rotation is None else 6, data.n))
    for group in np.unique(groups):
        inside = np.flatnonzero(groups == group)
        part = fitted(data.subset(np.flatnonzero(groups != group)), asked, misfit=like.misfit, robust=False)
        apart[:, inside] = residuals(data.subset(inside), part.predict(data.subset(inside)))
    return apart


@pytest.mark.parametrize(("cycles", "orientation"), [(1, False), (1, True), (3, True)])
@pytest.mark.parametrize("folds", [None, 5])
def test_each_pose_is_predicted_as_by_a_fit_without_it(cycles: int, orientation: bool, folds: int | None) -> None:
    data = measured(36, cycles, orientation=orientation)
    found = fitted(data, robust=False)
    how = HoldOut.of(data, None, folds, 0)
    (apart,) = how.residuals(found)
    np.testing.assert_allclose(
        apart, refitted(data, how.groups, FIT, found), rtol=0, atol=0.05 * np.std(found.residual[:3])
    )
    assert np.std(apart) > 1.02 * np.std(found.residual)


def test_a_model_without_an_effect_is_fitted_again_without_it() -> None:
    data = measured()
    found = fitted(data, robust=False)
    how = HoldOut.of(data, None, None, 0)
    (lacking,) = how.residuals(found, [[4]])
    reference = refitted(data, how.groups, FIT.partition(",joint_compliance")[0], found)
    size = np.sqrt(np.mean(np.square(reference[:3])))
    assert size > 3 * NOISE
    assert np.sqrt(np.mean(np.square((lacking - reference)[:3]))) < 0.02 * size


def test_repeats_are_held_out_together_whatever_the_order_of_rows() -> None:
    data = measured(17, 3)
    for one in (data, dataclasses.replace(data, pose=None)):
        how = HoldOut.of(one, None, 5, 0)
        for pose in np.unique(one.q, axis=1).T:
            assert np.unique(how.groups[np.all(one.q == pose[:, None], axis=0)]).size == 1
        assert sorted(np.bincount(how.groups)) == [9, 9, 9, 12, 12]
        order = np.random.default_rng(1).permutation(one.n)
        np.testing.assert_array_equal(HoldOut.of(one.subset(order), None, 5, 0).groups, how.groups[order])
        assert not np.array_equal(HoldOut.of(one, None, 5, 1).groups, how.groups)


def test_a_coefficient_that_one_pose_alone_determines_is_nominal_for_that_pose() -> None:
    # Only the last pose turns j1, so that only it separates its gear ratio from a turn of the base.
    data = measured(30, orientation=False)
    q = data.q.copy()
    q[0, :-1] = 0.3
    one = arm("puma560")
    model = Model.of(one.robot, build(parse_requests("gear_ratio[j1],base_frame"), one, data))
    moved = dataclasses.replace(data, q=q)
    bound = model.bind(moved)
    exact = bound.poses(np.array([2e-3 * name.startswith("gear_ratio") for name in bound.names]))
    moved = dataclasses.replace(moved, position=exact.translation)
    found = fit(model, moved, Options(robust=False))
    alone: list[list[int]] = []
    (poses,) = held_out_poses(found, moved, np.arange(moved.n), undetermined=lambda rows: alone.append(rows.tolist()))
    assert alone == [[29]]
    # The base explains the others; a nominal gear ratio leaves the whole error at the last pose.
    error = np.linalg.norm(moved.position - poses.translation, axis=0)
    assert error[:-1].max() < 1e-6
    assert error[-1] > 1e-4
