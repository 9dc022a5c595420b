"""Commands in this process: what ends, the document of a success, the message of a refusal."""

import json
from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

import pytest
from typer.testing import CliRunner, Result

from robacc.cli.main import app


def run(*words: object, text: str | None = None) -> Result:
    """Run a command with ``text`` on standard input; standard output and standard error are kept apart."""
    return CliRunner().invoke(app, [str(word) for word in words], input=text, catch_exceptions=False)


def output(*words: object, text: str | None = None) -> str:
    """Return the standard output of a command that succeeds."""
    ended = run(*words, text=text)
    assert ended.exit_code == 0, ended.stderr
    return ended.stdout


def document(*words: object, text: str | None = None) -> dict[str, Any]:
    """Return the one JSON document that a command writes; NaN and Infinity are no JSON."""
    found: dict[str, Any] = json.loads(output(*words, "--format", "json", text=text), parse_constant=pytest.fail)
    return found


def refused(*words: object, status: int = 2, text: str | None = None) -> str:
    """Return the messages of a command that ends with ``status`` and writes no result, in one line."""
    ended = run(*words, text=text)
    assert (ended.exit_code, ended.stdout) == (status, "")
    return one_line(ended.stderr)


def calls_of(command: str) -> tuple[Callable[..., Any], ...]:
    """Return :func:`run`, :func:`output`, :func:`document` and :func:`refused` of one command."""
    return tuple(partial(call, command) for call in (run, output, document, refused))


def one_line(text: str) -> str:
    """Return a text with every run of white space as one space."""
    return " ".join(text.split())


def missing(whole: Any, *parts: Any) -> list[Any]:
    """Return the parts that a text or collection does not have."""
    return [part for part in parts if part not in whole]


def in_order(text: str, parts: Iterable[str]) -> bool:
    """Whether the text has the parts one behind the other."""
    at = 0
    for part in parts:
        at = text.index(part, at) + len(part)
    return True
