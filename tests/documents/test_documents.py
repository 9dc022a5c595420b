"""Schemas of results, results that are read again, identities, and JSON text."""

import csv
import io
import json
import math
import re
import sys
from collections.abc import Callable, Iterator
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import results
from commands import missing, output, refused
from hypothesis import HealthCheck, given, settings, strategies as st
from jsonschema import Draft202012Validator
from sample_files import SAMPLES, saved
from schemas import Document, closed, wrong

import robacc
from robacc import InputError, UsageError, __version__
from robacc.api.result import schema_names
from robacc.cli.main import COMMANDS, FORMS, RENAMED
from robacc.documents import envelope as module
from robacc.documents.envelope import InputFile, Provenance, csv_text, read_identity, read_result, schema_version
from robacc.io.json_text import json_text
from robacc.render.page import identity_rows
from robacc.robots.description import IDENTITY

NAMES = list(schema_names())
NO_RESULT = {"history", "report", "init", "schema", "plot", "import"}
"""Commands that write no JSON."""
CORRECT = (
    "correct",
    "sample_data/iso9283/plan.csv",
    "--model",
    "sample_data/truth.yaml",
    "--nominal",
    "sample_data/robot.yaml",
)
POSES, ROBOT = "sample_data/poses.csv", "sample_data/robot.yaml"


def run(*arguments: str) -> Document:
    done = results.run(*arguments, "--format", "json")
    assert done.stdout, done.stderr
    found: Document = json.loads(done.stdout)
    return found


def sample() -> robacc.Measurements:
    root = results.PROJECT
    return robacc.read_poses(root / POSES, robot=robacc.read_robot(root / ROBOT))


def made(found: robacc.Result) -> Document:
    document: Document = json.loads(found.to_json())
    return document


def few(n: int) -> Document:
    """So few poses that most intervals cannot be had."""
    return made(robacc.estimate(sample().subset(slice(0, n)), robot=results.PROJECT / ROBOT))


def repeated() -> Document:
    """Commanded poses that were repeated, two targets, a stated uncertainty, and no orientation."""
    import numpy as np

    noise = np.random.default_rng(0).normal(scale=1e-4, size=(3, 40))
    data = robacc.Measurements(
        position=noise,
        commanded_position=np.zeros((3, 40)),
        sigma_position=np.full((3, 40), 1e-5),
        pose=np.repeat(list("abcdefgh"), 5),
        target=np.tile(["upper", "lower"], 20),
    )
    return made(robacc.estimate(data))


def stored(folder: Path, *, alone: bool = False) -> tuple[str, ...]:
    paths = []
    for name in ("estimate",) if alone else ("calibrate", "trace"):
        paths.append(str(folder / f"{name}.json"))
        Path(paths[-1]).write_text(results.text(name), encoding="utf-8")
    return tuple(paths)


def gated(folder: Path) -> tuple[str, str]:
    (folder / "gate.yaml").write_text(results.GATE, encoding="utf-8")
    return "--gate", str(folder / "gate.yaml")


def holdout() -> Document:
    root = results.PROJECT
    data = sample()
    fit = robacc.calibrate(data.subset(slice(0, 40)), robot=root / ROBOT, holdout=data.subset(slice(40, 60)))
    return made(fit)


MADE: dict[str, Callable[[Path], Document]] = {
    **{name: lambda _, name=name: results.document(name) for name in ("calibrate", "trace")},
    "estimate, gate": lambda folder: run("estimate", *results.CALLS["estimate"], *gated(folder)),
    "estimate, base frame": lambda _: run("estimate", POSES, "--robot", ROBOT, "--frame", "base"),
    "estimate, one pose": lambda _: few(1),
    "estimate, three poses": lambda _: few(3),
    "estimate, positions of repeated poses": lambda _: repeated(),
    "robots": lambda _: run("show", "robots", "kuka"),
    "estimate-many": lambda folder: run("estimate", POSES, f"{folder}/none.csv", "--robot", ROBOT),
    "calibrate, holdout": lambda _: holdout(),
    "compare": lambda folder: run("compare", *stored(folder)),
    "compare, grade": lambda folder: run("compare", *stored(folder, alone=True) * 2, "--grade", "B"),
    "correct, base frame": lambda folder: run(*CORRECT, "-o", f"{folder}/corrected.csv", "--frame", "base"),
    "show": lambda _: run("show", ROBOT),
    "show, masses": lambda _: run("show", "configs/robots/puma560.yaml"),
    "effects": lambda _: run("show", "effects"),
    "effects, poses": lambda _: run("show", "effects", "--robot", ROBOT, "--poses", POSES),
    "plan, enough": lambda folder: run(
        *("plan", ROBOT, "--candidates", "100", "--already", POSES, "-o", f"{folder}/next.csv")
    ),
    "plan, acceptance": lambda folder: run(
        *("plan", ROBOT, "--for", "acceptance", "--grade", "D", "--candidates", "400", "-o", f"{folder}/test.csv")
    ),
}
"""A result by what it is of, beside those of the calls of the API; the first word is the schema's name."""
CONTRACT = {
    "estimate": (
        "n_poses frame position orientation grade grade.grade grade.scale grade.demonstrated",
        "position.mean_m position.covariance_m2 position.centred_covariance_m2 position.rms_m position.mean_error_m",
        "position.p95_m position.max_m position.errors_m orientation.mean_rad orientation.covariance_rad2",
        "orientation.centred_covariance_rad2 orientation.rms_rad orientation.mean_error_rad orientation.p95_rad",
        "orientation.max_rad orientation.errors_rad",
    ),
    "predict": (
        "n_poses position.covariance_m2 position.rms_m position.worst.pose position.worst.rms_m",
        "orientation.covariance_rad2 orientation.rms_rad orientation.worst.rms_rad",
        "budget.0.parameter budget.0.joint budget.0.share_position budget.0.share_orientation",
    ),
    "calibrate": (
        "n_poses noise.position_m noise.orientation_rad noise.source parameters.0.name parameters.0.value",
        "parameters.0.std parameters.0.unit nominal.fitted.position.rms_m before.held_out.position.p95_m",
        "after.fitted.position.max_m after.held_out.position.mean_error_m after.held_out.orientation",
    ),
    "trace": (
        "n_poses verdict findings candidates unexplained.rms_m unexplained.noise_rms_m unexplained.structured",
        "unexplained.p_value unexplained.hints findings.0.effect findings.0.joints findings.0.alternatives",
        "findings.0.p_value findings.0.held_out_before_m findings.0.held_out_after_m findings.0.parameters",
        "nominal.fitted.position.rms_m before.held_out.position.p95_m after.held_out.position.mean_error_m",
    ),
    "iso9283": ("n_poses iso9283.AP.max_m iso9283.RP.max_m iso9283.RP.intervals.max_m protocol.0.status",),
}
"""Keys that other programs rely on, beside those that every result has."""
ALWAYS = "schema robacc command options inputs seed inputs.0.name inputs.0.sha256 inputs.0.kind"


@pytest.mark.parametrize("name", NAMES)
def test_schema_is_one_and_says_whose(name: str) -> None:
    found, version = robacc.schema(name), schema_version(name)
    Draft202012Validator.check_schema(found)
    assert (found["$id"], found["title"]) == (f"urn:robacc:schema:{name}:{version}", f"robacc.{name}/{version}")
    assert found["properties"]["schema"]["const"] == f"robacc.{name}/{version}"


def test_every_command_that_writes_json_has_a_schema() -> None:
    histories = {name.replace(" ", "-") for name in FORMS if name.startswith("history ")}
    assert set(NAMES) == ({*COMMANDS, *RENAMED} - NO_RESULT) | {"estimate-many", "compare-paired"} | histories


def test_parts_that_schemas_share_are_the_same_in_all() -> None:
    seen: dict[str, Any] = {}
    for owner in NAMES:
        for name, part in robacc.schema(owner)["$defs"].items():
            assert seen.setdefault(name, part) == part, (owner, name)


@pytest.mark.parametrize("name", NAMES)
def test_every_value_is_described_and_every_number_says_its_unit(name: str) -> None:
    for key, part in _properties(robacc.schema(name)):
        kinds = part.get("type", [])
        if not kinds or "object" in kinds or "items" in part:
            continue
        assert part.get("description"), key
        if "number" in kinds and (unit := re.search(r"_(m|rad)(2?)$", key)):
            assert re.search(rf"\b{unit[1]}{'²' if unit[2] else ''}(?![\w²])", part["description"]), (key, part)


def _properties(schema: Any) -> Iterator[tuple[str, Document]]:
    if isinstance(schema, list):
        for one in schema:
            yield from _properties(one)
    elif isinstance(schema, dict):
        if isinstance(schema.get("properties"), dict) and "type" in schema:
            yield from schema["properties"].items()
        for one in schema.values():
            yield from _properties(one)


@pytest.mark.parametrize("what", MADE)
def test_results_meet_their_schema_and_every_key_is_described(what: str, tmp_path: Path) -> None:
    document, name = MADE[what](tmp_path), what.split(",")[0]
    assert wrong(name, document, closed) == [], "a value or a key that the schema does not describe"
    if name == "estimate-many":
        assert [one["done"] for one in document["results"]] == [True, False]
        assert wrong("estimate", document["results"][0]["result"]) == []


def test_every_schema_is_held_against_a_result() -> None:
    """Results of the calls of the API are in ``tests/api``."""
    called = {name.replace("_", "-") for name in robacc.__all__}
    assert {what.split(",")[0] for what in MADE} | called >= set(NAMES)


def _shortened(value: Any) -> Any:
    """The first of long lists: what is wrong with one of their entries is with all."""
    if isinstance(value, dict):
        return {key: _shortened(one) for key, one in value.items()}
    return [_shortened(one) for one in value[:3]] if isinstance(value, list) else value


@pytest.mark.parametrize("name", CONTRACT)
def test_a_result_without_a_key_that_is_relied_on_is_refused(name: str) -> None:
    keys = f"{' '.join(CONTRACT[name])} {ALWAYS}".split()
    owners = {".".join(key.split(".")[:depth]) for key in keys for depth in range(1, key.count(".") + 1)}
    # Of a key that has others within it, the others could not be missing: two rounds.
    for lacking in ([key for key in keys if key not in owners], [key for key in keys if key in owners]):
        document: Any = _shortened(results.document(name))
        expected = []
        for *path, last in (key.split(".") for key in lacking):
            place = document
            for owner in path:
                place = place[int(owner)] if isinstance(place, list) else place[owner]
            place.pop(last)
            where = "".join(f"[{owner}]" if owner.isdigit() else f".{owner}" for owner in path)
            expected.append(f"${where}: '{last}' is a required property")
        assert missing(wrong(name, document), *expected) == []


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("n_poses", -1, "less than the minimum"),
        ("n_poses", 2.5, "is not of type 'integer'"),
        ("frame", "world", "is not one of ['tool', 'base']"),
        ("schema", "robacc.estimate/2", "'robacc.estimate/1' was expected"),
        ("seed", "0", "is not of type"),
        ("position", None, "is not of type 'object'"),
        ("warnings", "none", "is not of type 'array'"),
    ],
)
def test_a_broken_result_is_refused(key: str, value: Any, message: str) -> None:
    document = results.document("estimate") | {key: value}
    assert any(message in one for one in wrong("estimate", document))


def test_results_may_gain_keys() -> None:
    document = results.document("estimate") | {"new": 1}
    document["position"]["new"] = 2
    assert wrong("estimate", document) == []
    assert len(wrong("estimate", document, closed)) == 2


def test_the_command_prints_the_schema(tmp_path: Path) -> None:
    assert json.loads(output("show", "schema", "trace")) == robacc.schema("trace")
    assert output("show", "schema").split() == NAMES
    target = tmp_path / "check.json"
    output("show", "schema", "check", "-o", target)
    assert json.loads(target.read_text(encoding="utf-8")) == robacc.schema("check")
    told = refused("show", "schema", "estimat")
    assert f"no schema 'estimat'; choose one of {', '.join(NAMES)}" in told


def good(**changes: Any) -> dict[str, Any]:
    inputs = (InputFile("poses.csv", "ab", "poses"),)
    return Provenance({"frame": "tool"}, inputs, 0).document("estimate", {"n_poses": 3}) | changes


def stored_of_read_result(tmp_path: Path, text: str | bytes) -> str:
    return str(saved(tmp_path / "result.json", text if isinstance(text, bytes) else text.encode()))


def problems(tmp_path: Path, text: str | bytes) -> str:
    with pytest.raises(InputError) as caught:
        read_result(stored_of_read_result(tmp_path, text))
    return str(caught.value).replace(f"{tmp_path}/", "")


def test_a_result_is_read_back_as_it_was_written(tmp_path: Path) -> None:
    text = json_text(good(note="Prüfung ✓"))
    path = stored_of_read_result(tmp_path, text)
    result = read_result(path)
    assert result.document == good(note="Prüfung ✓")
    assert (result.command, result.name, result.sha256) == ("estimate", path, sha256(text.encode()).hexdigest())
    assert result.record == InputFile("result.json", result.sha256, "result")


def test_standard_input(monkeypatch: pytest.MonkeyPatch) -> None:
    text = json_text(good())
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(text.encode())))
    result = read_result("-")
    assert (result.name, result.record.name, result.document["n_poses"]) == ("-", "-", 3)
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(b"{")))
    with pytest.raises(InputError, match=r"^<stdin>:1: is incomplete; the file was truncated$"):
        read_result("-")


def test_every_truncation_is_one_clear_error(tmp_path: Path) -> None:
    text = json_text(good(position={"rms_m": 1.25e-4, "errors_m": [[1.5, -2.0], [None, True]]})).rstrip()
    for length in [*range(1, len(text), 3), len(text) - 1]:
        assert "is incomplete; the file was truncated" in problems(tmp_path, text[:length]), text[:length]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "result.json: is empty; save the result as JSON"),
        (" \n", "result.json: is empty; save the result as JSON"),
        ("Error of 5 poses", "result.json:1: is not JSON: Expecting value at character 1; save the result as JSON"),
        ('{"a": 1,\n "b" 2}', "result.json:2: is not JSON: Expecting ':' delimiter at character 6"),
        ('{"a": [1}', "result.json:1: is not JSON: Expecting ',' delimiter at character 9"),
        ("{} {}", "result.json:1: is not JSON: Extra data at character 4"),
        ('{"a": 1, "b": 2, "a": 3}', "result.json: is not a result: an object has the key 'a' twice"),
        ('{"a": NaN}', "result.json: is not a result: NaN is not a number of JSON"),
        ('{"a": -Infinity}', "result.json: is not a result: -Infinity is not a number of JSON"),
        ('{"a": 1e999}', "result.json: is not a result: the number 1e999 is too large"),
        ('{"a": %s}' % ("9" * 5000), f"result.json: is not a result: the number {'9' * 40} is too large"),
        ("[" * 100_000, "result.json: is nested more deeply than any result"),
        ('{"a": "\\ud800"}', "result.json: contains half of a surrogate pair, which is not a character"),
        (b'{"a": \x00}', "result.json:1: is not a text file: it contains a NUL byte"),
        (b'{"a": "\xe4"}', "result.json:1: is not UTF-8 text (byte 0xe4)"),
        ("[]", "result.json: is not a result of robacc: it is not a JSON object; save the result as JSON"),
        ("{}", "result.json: is not a result of robacc: it has no key 'schema'; save the result as JSON"),
    ],
)
def test_what_is_no_result_is_said(tmp_path: Path, text: str | bytes, message: str) -> None:
    assert problems(tmp_path, text).startswith(message)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"schema": 3}, "result.json, schema: found 3, expected robacc.COMMAND/VERSION"),
        (
            {"schema": "other.estimate/1"},
            'result.json, schema: found "other.estimate/1", expected robacc.COMMAND/VERSION',
        ),
        ({"schema": "robacc.estimate/1\n"}, "result.json, schema: found "),
        ({"schema": "x" * 500}, f'result.json, schema: found "{"x" * 56}…, expected robacc.COMMAND/VERSION'),
        (
            {"schema": "robacc.estimate/2"},
            f'result.json, schema: has version 2 of the schema, from robacc "{__version__}"; this robacc reads '
            "version 1; compute the result again with this robacc, or read it with the robacc that made it",
        ),
        ({"command": "trace"}, 'result.json, command: expected estimate, found "trace"'),
        ({"robacc": None}, "result.json, robacc: expected text, found nothing"),
        ({"options": []}, "result.json, options: expected an object, found []"),
        ({"inputs": {}}, "result.json, inputs: expected a list, found {}"),
        (
            {"inputs": [{"name": "a", "sha256": 3, "kind": "poses"}]},
            "result.json, inputs[0].sha256: expected text, found 3",
        ),
    ],
)
def test_what_every_result_carries_is_checked(tmp_path: Path, changes: dict[str, Any], message: str) -> None:
    assert problems(tmp_path, json.dumps(good(**changes))).startswith(message)


def test_every_problem_at_once(tmp_path: Path) -> None:
    with pytest.raises(InputError) as caught:
        read_result(stored_of_read_result(tmp_path, json.dumps(good(command=None, options=None, inputs=[3]))))
    assert [problem.column for problem in caught.value.problems] == ["command", "options", "inputs[0]"]


def test_size_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "RESULT_LIMIT", 64)
    assert "is larger than" in problems(tmp_path, json_text(good()))
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(b" " * 65)))
    with pytest.raises(InputError, match=r"^<stdin>: is larger than 6\.10352e-05 MiB, the limit for text files$"):
        read_result("-")


def test_later_sources_replace_keys_and_the_order_is_that_of_the_page(tmp_path: Path) -> None:
    path = saved(
        tmp_path / "identity.yaml", 'serial_number: "12345"\nplace: hall 4\ncustomer: A & B\ndate: 2026-11-22\n'
    )
    identity = read_identity([str(path), "place=hall 5 = new", "operator=N. N."])
    assert identity == {
        "customer": "A & B",
        "serial_number": "12345",
        "operator": "N. N.",
        "place": "hall 5 = new",
        "date": "2026-11-22",
    }
    assert list(identity) == [key for key in IDENTITY if key in identity]
    assert read_identity([]) == {}


@pytest.mark.parametrize(
    ("given", "error", "message"),
    [
        ("serial: 12345\nplace: [a]\n", InputError, r"identity\.yaml:1, serial: .*identity\.yaml:2, place: "),
        ("place:\n", InputError, "names nothing of what was tested"),
        ("operater=x", UsageError, "unknown key 'operater'; did you mean 'operator'"),
        ("place=", UsageError, "expected one line of text for place"),
        ("nowhere.yaml", InputError, "the file does not exist"),
    ],
)
def test_mistakes(given: str, error: type[Exception], message: str, tmp_path: Path) -> None:
    source = str(saved(tmp_path / "identity.yaml", given)) if "\n" in given else given
    with pytest.raises(error, match=f"(?s){message}"):
        read_identity([source])


def test_a_robot_file_states_the_identity_of_its_arm(tmp_path: Path) -> None:
    text = (SAMPLES / "robot.yaml").read_text(encoding="utf-8")
    path = saved(tmp_path / "arm.yaml", text + "identity:\n  serial_number: 007\n  place: hall 4\n")
    document = robacc.estimate(SAMPLES / "poses.csv", robot=path).document()
    (record,) = [record for record in document["inputs"] if record["kind"] == "robot"]
    assert record["identity"] == {"serial_number": "007", "place": "hall 4"}
    assert identity_rows([document], ["a"], {}) == [("Serial number", "007"), ("Place", "hall 4")]
    given = {"place": "hall 5", "operator": "N. N."}
    expected = [("Serial number", "007"), ("Operator", "N. N."), ("Place", "hall 5")]
    assert identity_rows([document], ["a"], given) == expected

    path.write_text(text + "identity: {serial: 7}\n", encoding="utf-8")
    with pytest.raises(InputError, match="identity\\.serial: unknown key; did you mean 'serial_number'"):
        robacc.read_robot(path)


def test_two_robot_files_of_a_result_keep_their_own_numbers() -> None:
    files = [
        {"name": name, "kind": "robot", "identity": {"serial_number": number, "place": "hall 4"}}
        for name, number in (("model.yaml", "7"), ("robot.yaml", "8"))
    ]
    document = {"inputs": [{"kind": "poses"}, *files]}
    assert identity_rows([document], ["a"], {}) == [
        ("Serial number", "model.yaml: 7; robot.yaml: 8"),
        ("Place", "hall 4"),
    ]
    other = {"inputs": [files[0]]}
    expected = ("Serial number", "a, model.yaml: 7; a, robot.yaml: 8; b: 7")
    assert identity_rows([document, other], ["a", "b"], {})[0] == expected
    assert identity_rows([document], ["a"], {"serial_number": "9"})[0] == ("Serial number", "9")


values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner),
    max_leaves=8,
)


@settings(suppress_health_check=[HealthCheck.too_slow], deadline=None, max_examples=15)
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
    document = Provenance({"frame": "tool"}, (file,), 7).document("estimate", {"n_poses": 3})
    assert list(document) == ["schema", "robacc", "command", "options", "inputs", "seed", "n_poses"]
    assert document["schema"] == "robacc.estimate/1"
    assert document["inputs"] == [{"name": "poses.csv", "sha256": "ab" * 32, "kind": "poses"}]
    assert InputFile.at("-", "", "poses").name == "-"


def test_a_document_has_twelve_digits() -> None:
    rng = np.random.default_rng(0)
    array = rng.normal(size=(300, 3)) * 10.0 ** rng.integers(-30, 30, size=(300, 3))
    expected = [[float(f"{value:.11e}") for value in row] for row in array.tolist()]
    payload = {"array": array, "list": [1 / 3, None, "a"], "number": np.float64(2 / 3), "count": 7, "zero": -0.0}
    document = Provenance({}, ()).document("estimate", payload)
    np.testing.assert_array_equal(document["array"], expected)
    assert document["list"] == [0.333333333333, None, "a"]
    assert (document["number"], document["count"], str(document["zero"])) == (0.666666666667, 7, "0.0")
    assert np.isnan(Provenance({}, ()).document("x", {"a": np.array([np.nan])})["a"]).all()


def test_cells_of_any_text_read_back() -> None:
    texts = ["P1", "a,b", 'say "a"', 'say "a", b', "two\nlines", "two\r\nlines", ""]
    text = csv_text({"name": texts, "number": range(len(texts)), "none": None})
    rows = list(csv.reader(io.StringIO(text, newline="")))
    assert rows == [["name", "number"], *([name, str(i)] for i, name in enumerate(texts))]
    assert csv_text({"a": [], "b": []}) == "a,b\n"
