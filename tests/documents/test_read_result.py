"""Stored results are read back; a hostile or truncated file gives one clear error."""

from __future__ import annotations

import io
import json
import os
import sys
import threading
from hashlib import sha256
from pathlib import Path
from typing import Any

import pytest

from robacc import __version__
from robacc.documents import envelope as module
from robacc.documents.envelope import InputFile, envelope, read_result
from robacc.errors import InputError
from robacc.io.json_text import json_text


def good(**changes: Any) -> dict[str, Any]:
    inputs = [InputFile("poses.csv", "ab", "poses")]
    return envelope("estimate", {"n_poses": 3}, options={"frame": "tool"}, inputs=inputs, seed=0) | changes


def stored(tmp_path: Path, text: str | bytes) -> str:
    path = tmp_path / "result.json"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return str(path)


def problems(tmp_path: Path, text: str | bytes) -> str:
    with pytest.raises(InputError) as caught:
        read_result(stored(tmp_path, text))
    return str(caught.value).replace(f"{tmp_path}/", "")


def test_a_result_is_read_back_as_it_was_written(tmp_path: Path) -> None:
    text = json_text(good(note="Prüfung ✓"))
    path = stored(tmp_path, text)
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


def test_a_pipe_is_read_once(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    text = json_text(good()).encode()
    writer = threading.Thread(target=pipe.write_bytes, args=(text,))
    writer.start()
    assert read_result(str(pipe)).sha256 == sha256(text).hexdigest()
    writer.join()


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
        read_result(stored(tmp_path, json.dumps(good(command=None, options=None, inputs=[3]))))
    assert [problem.column for problem in caught.value.problems] == ["command", "options", "inputs[0]"]


def test_size_is_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "RESULT_LIMIT", 64)
    assert "is larger than" in problems(tmp_path, json_text(good()))
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(b" " * 65)))
    with pytest.raises(InputError, match=r"^<stdin>: is larger than 6\.10352e-05 MiB, the limit for text files$"):
        read_result("-")
