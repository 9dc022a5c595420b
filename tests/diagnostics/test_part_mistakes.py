"""A stretch of the rows with a mistake of its own is named with its lines; steps and outliers are none."""

from __future__ import annotations

from collections.abc import Callable

import independent_arm as arm
import numpy as np
import pytest
from test_mistake_sets import made

from robacc.diagnostics.data_mistakes import check_data
from robacc.errors import InputError
from robacc.measurements import Measurements

N = 80
Change = Callable[[np.ndarray, np.ndarray, slice], None]


def reversed_sign(q: np.ndarray, position: np.ndarray, part: slice) -> None:
    q[2, part] *= -1.0


def exchanged_joints(q: np.ndarray, position: np.ndarray, part: slice) -> None:
    q[[0, 3], part] = q[[3, 0], part]


def mirrored_axes(q: np.ndarray, position: np.ndarray, part: slice) -> None:
    position[[0, 1], part] = position[[1, 0], part]


def data(change: Change | None = None, part: slice = slice(0, 0), seed: int = 5) -> Measurements:
    q, position, _ = made(N, seed)
    q, position = q.copy(), position.copy()
    if change is not None:
        change(q, position, part)
    return Measurements(position=position, q=q)


CHANGES = (
    (reversed_sign, "the sign of joint"),
    (exchanged_joints, "seem to be exchanged"),
    (mirrored_axes, "left-handed frame"),
)
PARTS = (slice(50, N), slice(0, 30), slice(25, 60))
PAIRS = [
    pytest.param(*change, part, marks=() if i == k else pytest.mark.slow)
    for i, change in enumerate(CHANGES)
    for k, part in enumerate(PARTS)
]


@pytest.mark.parametrize(("change", "text", "part"), PAIRS)
def test_a_mistake_in_a_part_is_named_with_its_lines(change: Change, text: str, part: slice) -> None:
    with pytest.raises(InputError, match=text) as error:
        check_data(arm.robot(), data(change, part))
    first, last = (int(word) for word in str(error.value).partition(",")[0].removeprefix("lines ").split(" to "))
    # Poses near zero of the joint, or near the plane of the mirror, show nothing.
    assert abs(first - (part.start + 1)) <= 2
    assert abs(last - part.stop) <= 2
    assert "correct these rows only" in str(error.value)


def test_a_mistake_in_most_rows_of_a_short_file_is_named() -> None:
    """Twenty rows agree: a window that the frames are registered on has to lie within them."""
    with pytest.raises(InputError, match="unlike the other rows: the sign of joint"):
        check_data(arm.robot(), data(reversed_sign, slice(20, 50)).subset(slice(0, 50)))


def test_a_part_that_nothing_explains_is_told() -> None:
    def random(q: np.ndarray, position: np.ndarray, part: slice) -> None:
        q[:, part] = np.random.default_rng(1).uniform(-1.0, 1.0, q[:, part].shape)

    (warning,) = check_data(arm.robot(), data(random, slice(50, N)))
    assert warning.startswith("lines 51 to 80 do not agree with the other rows")


def moved_base(q: np.ndarray, position: np.ndarray, part: slice) -> None:
    turn = np.array([[np.cos(0.3), -np.sin(0.3), 0.0], [np.sin(0.3), np.cos(0.3), 0.0], [0.0, 0.0, 1.0]])
    position[:, part] = turn @ position[:, part] + np.array([[0.3], [-0.2], [0.1]])


def moved_base_and_a_poor_instrument(q: np.ndarray, position: np.ndarray, part: slice) -> None:
    position[:, part] += 0.012 * np.random.default_rng(3).normal(size=position[:, part].shape)
    moved_base(q, position, part)


def jumped_zero(q: np.ndarray, position: np.ndarray, part: slice) -> None:
    q[1, part] += 0.01


def outliers(q: np.ndarray, position: np.ndarray, part: slice) -> None:
    position[:, [3, 17, 40, 66]] += 0.2


@pytest.mark.parametrize("change", [None, moved_base, moved_base_and_a_poor_instrument, jumped_zero, outliers])
def test_steps_and_outliers_are_no_mistakes_of_a_part(change: Change | None) -> None:
    """A moved base and a joint whose zero jumped are steps, which a trace finds."""
    assert check_data(arm.robot(), data(change, slice(50, N))) == ()
