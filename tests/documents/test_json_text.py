"""JSON and CSV text of results: the same as the standard library's reading, never NaN, arrays in pieces."""

from __future__ import annotations

import csv
import io
import json
import math

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from robacc.documents.envelope import InputFile, csv_text, envelope
from robacc.io.json_text import json_text

values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=20,
)


@settings(suppress_health_check=[HealthCheck.too_slow], deadline=None, max_examples=40)
@given(st.dictionaries(st.text(), values))
def test_reads_back_as_it_was(document: dict[str, object]) -> None:
    assert json.loads(json_text(document)) == document


@pytest.mark.parametrize("shape", [(0,), (3,), (9000,), (0, 3), (2, 3), (9000, 3), (2, 3, 3)])
def test_arrays_read_back_exactly(shape: tuple[int, ...]) -> None:
    array = np.random.default_rng(0).normal(size=shape)
    read = json.loads(json_text({"a": {"b": array, "c": 1}}))["a"]
    np.testing.assert_array_equal(np.array(read["b"]).reshape(shape), array)


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
    many = json_text({"a": np.array([[1.0, np.nan], [-np.inf, 2.0]] * 3000)})
    assert json.loads(many, parse_constant=pytest.fail) == {"a": [[1.0, None], [None, 2.0]] * 3000}


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


def test_a_document_has_twelve_digits() -> None:
    rng = np.random.default_rng(0)
    array = rng.normal(size=(300, 3)) * 10.0 ** rng.integers(-30, 30, size=(300, 3))
    expected = [[float(f"{value:.11e}") for value in row] for row in array.tolist()]
    payload = {"array": array, "list": [1 / 3, None, "a"], "number": np.float64(2 / 3), "count": 7, "zero": -0.0}
    document = envelope("estimate", payload, options={}, inputs=[], seed=None)
    np.testing.assert_array_equal(document["array"], expected)
    assert document["list"] == [0.333333333333, None, "a"]
    assert (document["number"], document["count"], str(document["zero"])) == (0.666666666667, 7, "0.0")
    assert np.isnan(envelope("x", {"a": np.array([np.nan])}, options={}, inputs=[], seed=None)["a"]).all()


def test_cells_of_any_text_read_back() -> None:
    texts = ["P1", "a,b", 'say "a"', 'say "a", b', "two\nlines", "two\r\nlines", ""]
    text = csv_text({"name": texts, "number": range(len(texts)), "none": None})
    rows = list(csv.reader(io.StringIO(text, newline="")))
    assert rows == [["name", "number"], *([name, str(i)] for i, name in enumerate(texts))]
    assert csv_text({"a": [], "b": []}) == "a,b\n"
