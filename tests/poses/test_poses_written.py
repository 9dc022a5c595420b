"""Writing pose files: what is written is read back."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from hypothesis import HealthCheck, given, settings, strategies as st
from pose_files import Reader
from scipy.spatial.transform import Rotation

from robacc.measurements import Measurements
from robacc.poses.csv_file import format_poses

finite = st.floats(-1e8, 1e8)  # what a file of poses may hold
ids = st.text(st.characters(codec="utf-8", exclude_categories=("C", "Z")), min_size=1, max_size=8)


@st.composite
def measurements(draw: st.DrawFn) -> Measurements:
    """Any measurements that a file can hold."""
    n, joints = draw(st.integers(0, 4)), draw(st.integers(1, 3))

    def array(elements: st.SearchStrategy[Any], *shape: int) -> Any:
        count = math.prod(shape)
        return np.array(draw(st.lists(elements, min_size=count, max_size=count)), dtype=float).reshape(shape)

    def maybe(make: Callable[[], Any]) -> Any:
        return make() if draw(st.booleans()) else None

    def rotation() -> Any:
        seed = draw(st.integers(0, 2**32 - 1))
        return np.moveaxis(Rotation.random(n, rng=np.random.default_rng(seed)).as_matrix(), 0, -1).reshape(3, 3, n)

    def text() -> Any:
        return np.array(draw(st.lists(ids, min_size=n, max_size=n)), dtype=str)

    positive = st.floats(1e-12, 1e6)
    return Measurements(
        position=array(finite, 3, n),
        rotation=maybe(rotation),
        q=array(finite, joints, n),
        commanded_position=array(finite, 3, n),
        commanded_rotation=maybe(rotation),
        sigma_position=maybe(lambda: array(positive, 3, n)),
        sigma_rotation=maybe(lambda: array(positive, n)),
        pose=maybe(text),
        cycle=maybe(text),
        target=maybe(text),
        time=maybe(lambda: array(finite, n)),
        temperature=maybe(lambda: array(st.floats(-273.15, 1e9), n)),
        payload=maybe(lambda: array(st.floats(0, 1e9), n)),
        direction=maybe(lambda: array(st.sampled_from([-1, 0, 1]), joints, n)),
        speed=maybe(lambda: array(st.floats(-1, 1), joints, n)),
    )


EXACT = ("position", "q", "commanded_position", "sigma_position", "sigma_rotation", "pose", "cycle", "target")
EXACT += ("time", "temperature", "payload", "direction", "speed")


@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None, max_examples=100)
@given(data=measurements())
def test_what_is_written_is_read_back(read: Reader, data: Measurements) -> None:
    text = format_poses(data)
    back = read(text, units_check=False)
    for name in EXACT:
        expected, values = getattr(data, name), getattr(back, name)
        if name == "pose" and expected is None and values is not None:
            # Joints that differ by less than readings do are visits of one pose, and a warning says so.
            assert any("and their repetitions" in warning for warning in back.warnings)
            continue
        assert (expected is None) == (values is None), name
        if expected is not None:
            np.testing.assert_array_equal(values, expected, err_msg=name)
    for expected, values in ((data.rotation, back.rotation), (data.commanded_rotation, back.commanded_rotation)):
        assert (expected is None) == (values is None)
        if expected is not None and values is not None:
            np.testing.assert_allclose(values, expected, atol=2e-15)  # through a quaternion and back
    assert format_poses(data) == text


def test_written_columns() -> None:
    data = Measurements(
        position=np.array([[0.1], [1 / 3], [-2e-7]]),
        rotation=np.eye(3)[..., None],
        q=np.array([[0.5], [1e22]]),
        pose=np.array(["#1"]),
        direction=np.array([[1.0], [-1.0]]),
        speed=np.array([[1.0], [-0.25]]),
    )
    row = "0.5,1e+22,0.1,0.3333333333333333,-2e-07,1.0,0.0,0.0,0.0,1,-1,1.0,-0.25,#1\n"
    numbered = "q1,q2,x,y,z,qw,qx,qy,qz,dir_q1,dir_q2,speed_q1,speed_q2,pose\n"
    assert format_poses(data) == numbered + row
