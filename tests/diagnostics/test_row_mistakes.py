"""Rows that are exchanged or shifted are named with their numbers; scattered outliers are not."""

from __future__ import annotations

import dataclasses

import independent_arm as arm
import numpy as np
import pytest
from test_mistake_sets import made

from robacc.diagnostics.data_mistakes import check_data, registered_poses
from robacc.errors import InputError
from robacc.measurements import Measurements
from robacc.modelling.model import predict
from robacc.robots.description import Frame

N = 60


def data(order: np.ndarray | None = None) -> Measurements:
    """Measured rows in the given order; the joints stay."""
    q, position, _ = made(N, 5)
    return Measurements(position=position if order is None else position[:, order], q=q)


def reordered(rows: list[int], there: list[int]) -> np.ndarray:
    order = np.arange(N)
    order[rows] = there
    return order


@pytest.mark.parametrize(
    ("rows", "there", "text"),
    [
        ([11, 40], [40, 11], "lines 12, 41: the measured poses seem to be exchanged"),
        (
            [3, 20, 50],
            [20, 50, 3],
            "lines 4, 21, 51: the measured poses seem to be in another order than the joints",
        ),
    ],
)
def test_a_few_rows_elsewhere_are_named_and_the_others_used(rows: list[int], there: list[int], text: str) -> None:
    (warning,) = check_data(arm.robot(), data(reordered(rows, there)))
    assert warning.startswith(text)


def test_many_exchanged_rows_are_refused() -> None:
    with pytest.raises(InputError, match=r"^lines 4, 51; 12, 41: the measured poses seem to be exchanged"):
        check_data(arm.robot(), data(reordered([3, 50, 11, 40], [50, 3, 40, 11])))


def test_exchanged_names_of_targets() -> None:
    """Two targets of one visit: their rows have the same joints, so only the names can be exchanged."""
    robot = dataclasses.replace(arm.robot(), targets={"A": Frame(), "B": Frame(xyz=(0.1, 0.0, 0.05))})
    q, _, _ = made(N // 2, 5)
    both = Measurements(np.zeros((3, N)), q=np.repeat(q, 2, axis=1), target=np.tile(["A", "B"], N // 2))
    position = predict(robot, both).translation + 1e-5 * np.random.default_rng(2).normal(size=(3, N))
    names = both.target.copy()
    names[[20, 21]] = names[[21, 20]]
    (warning,) = check_data(robot, dataclasses.replace(both, position=position, target=names))
    assert warning.startswith("lines 21, 22: the names of the targets seem to be exchanged")
    assert "give each row the name of the target that was measured" in warning


@pytest.mark.parametrize(("first", "end", "shift"), [(20, 35, 1), (0, 40, -1), (30, 60, 2), (10, 55, 1)])
def test_a_shifted_stretch(first: int, end: int, shift: int) -> None:
    rows = list(range(first, end))
    with pytest.raises(InputError, match="the measured poses seem to be shifted") as info:
        check_data(arm.robot(), data(reordered(rows, np.roll(rows, shift).tolist())))
    text = str(info.value)
    count = "one row" if abs(shift) == 1 else f"{abs(shift)} rows"
    assert f"shifted by {count} {'down' if shift > 0 else 'up'} against the joints" in text
    named = [int(part) for part in text.partition(":")[0].removeprefix("lines ").split(" to ")]
    assert abs(named[0] - 1 - first) <= 2
    assert abs(named[1] - end) <= 2


def test_scattered_outliers_are_no_exchange() -> None:
    good = data()
    rng = np.random.default_rng(0)
    position = good.position.copy()
    position[:, [4, 17, 33, 48]] += rng.normal(scale=0.3, size=(3, 4))
    assert check_data(arm.robot(), dataclasses.replace(good, position=position)) == ()


@pytest.mark.parametrize("seed", range(4))
def test_permuted_rows_are_named_with_an_unknown_tool(seed: int) -> None:
    order = np.random.default_rng(seed).permutation(N)
    turned = registered_poses(arm.robot(), data()).rotation
    shifted = dataclasses.replace(
        data(), position=data().position + np.einsum("ijn,j->in", turned, (0.05, -0.02, 0.04))
    )
    for measured in (data(), shifted):
        permuted = dataclasses.replace(measured, position=measured.position[:, order])
        with pytest.raises(InputError, match="the measured poses seem to be in another order than the joints: sorted"):
            check_data(arm.robot(), permuted)


@pytest.mark.parametrize("seed", [6, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(7, 12))])
def test_other_joints_of_the_same_arm_are_no_permutation(seed: int) -> None:
    text = ""
    try:
        check_data(arm.robot(), dataclasses.replace(data(), q=made(N, seed)[0]))
    except InputError as error:
        text = str(error)
    assert "another order" not in text


def test_a_wrong_sign_is_no_permutation() -> None:
    q = data().q
    for joint in range(6):
        flipped = dataclasses.replace(data(), q=np.where(np.arange(6)[:, None] == joint, -q, q))
        with pytest.raises(InputError) as caught:
            check_data(arm.robot(), flipped)
        assert "another order" not in str(caught.value)
