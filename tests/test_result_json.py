"""JSON text of results: the same as the standard library's reading, never NaN, arrays in pieces."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from robacc.io.result_json import json_pieces, json_text
from robacc.results import InputFile, envelope

values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=20,
)


@given(st.dictionaries(st.text(), values))
def test_reads_back_as_it_was(document: dict[str, object]) -> None:
    assert json.loads(json_text(document)) == to_twelve_digits(document)


def to_twelve_digits(value: object) -> object:
    """Round as the decimal text of a number with twelve significant digits says, which is independent of the code."""
    if isinstance(value, dict):
        return {key: to_twelve_digits(item) for key, item in value.items()}
    if isinstance(value, list):
        return [to_twelve_digits(item) for item in value]
    return float(f"{value:.11e}") if isinstance(value, float) else value


@pytest.mark.parametrize("shape", [(0,), (3,), (0, 3), (2, 3), (9000, 3), (2, 3, 3)])
def test_arrays_read_back_to_twelve_digits(shape: tuple[int, ...]) -> None:
    rng = np.random.default_rng(0)
    array = rng.normal(size=shape) * 10.0 ** rng.integers(-30, 30, size=shape)
    read = json.loads(json_text({"a": {"b": array, "c": 1}}))["a"]
    expected = np.array([float(f"{value:.11e}") for value in array.ravel()]).reshape(shape)
    np.testing.assert_array_equal(np.array(read["b"]).reshape(shape), expected)


def test_long_arrays_come_in_pieces() -> None:
    longest = max(len(piece) for piece in json_pieces({"a": np.full((100_000, 3), 1 / 3)}))
    # 4096 rows of three numbers of about 20 characters, and what stands between them.
    assert longest < 4096 * 3 * 30


def test_what_is_not_a_number_is_null() -> None:
    text = json_text(
        {"a": math.nan, "b": [math.inf, 1.0], "c": np.array([[1.0, np.nan], [-np.inf, 2.0]]), "d": np.float64("nan")}
    )
    assert json.loads(text, parse_constant=pytest.fail) == {
        "a": None,
        "b": [None, 1.0],
        "c": [[1.0, None], [None, 2.0]],
        "d": None,
    }


def test_layout_is_one_row_a_line() -> None:
    document = {"n": np.int64(2), "rows": np.array([[1, 2], [3, 4]]), "words": np.array(["a", "b"]), "none": {}}
    assert json_text(document) == (
        '{\n  "n": 2,\n  "rows": [\n    [1, 2],\n    [3, 4]\n  ],\n  "words": ["a", "b"],\n  "none": {}\n}\n'
    )


def test_what_has_no_form_in_json_is_a_defect() -> None:
    with pytest.raises(TypeError):
        json_text({"a": object()})


def test_envelope_says_how_the_result_was_made() -> None:
    file = InputFile.at("some/where/poses.csv", "ab" * 32, "poses")
    document = envelope("estimate", {"n_poses": 3}, options={"frame": "tool"}, inputs=[file], seed=7)
    assert list(document) == ["schema", "robacc", "command", "options", "inputs", "seed", "n_poses"]
    assert document["schema"] == "robacc.estimate/1"
    assert document["inputs"] == [{"name": "poses.csv", "sha256": "ab" * 32, "kind": "poses"}]
    assert InputFile.at("-", "", "poses").name == "-"
