"""The library names parameters, the command line options: no text outside ``robacc.cli`` is spelled for one of them."""

from __future__ import annotations

import ast
import inspect
import re
from collections.abc import Iterator
from pathlib import Path
from types import FunctionType

import pytest

import robacc
from robacc.cli import commands
from robacc.cli.main import COMMANDS, FORMS
from robacc.errors import InputError, Problem, UsageError
from robacc.render.text import _MARKED, as_options, say_error

PACKAGE = Path(robacc.__file__).parent
OPTION = re.compile(r"(?<![\w-])--[a-z]")
SHOWS_COMMANDS = {
    "render/page.py",  # the command that makes a result again
    "render/views/accuracy.py",  # the command that comes next
    "render/views/fit.py",  # the same
    "render/views/expected.py",  # the same
    "simulation/templates.py",  # comments of files that `robacc init` writes
    "poses/column_proposal.py",  # the same
    "render/plots/canvas.py",  # variables of CSS
    "render/text.py",
}


def library_files() -> Iterator[tuple[str, Path]]:
    for path in sorted(PACKAGE.rglob("*.py")):
        name = path.relative_to(PACKAGE).as_posix()
        if not name.startswith("cli/"):
            yield name, path


def texts(path: Path) -> Iterator[str]:
    """String literals of a file, parts of f-strings included and docstrings left out."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    docstrings = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docstrings:
            yield node.value


def test_no_text_of_the_library_has_an_option():
    with_options = {
        name
        for name, path in library_files()
        if name not in SHOWS_COMMANDS and any(OPTION.search(text) for text in texts(path))
    }
    assert with_options == set()


def test_every_marked_name_is_a_parameter_of_a_call():
    functions = [call for call in (getattr(robacc, name) for name in robacc.__all__) if isinstance(call, FunctionType)]
    functions += [getattr(commands, name) for name in (*COMMANDS, *FORMS.values())]
    parameters = {name for function in functions for name in inspect.signature(function).parameters}
    for name, path in library_files():
        marked = {match[1] for text in texts(path) for match in _MARKED.finditer(text)}
        assert marked <= parameters, name


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("`align` needs `against`", "--align needs --against"),
        ("`base_link`, `tip_link`: none", "--base-link, --tip-link: none"),
        ('try `align="base_frame,tool_frame"`', "try --align base_frame,tool_frame"),
        ("try `jobs=1` (or `ordered=True`)", "try --jobs 1 (or --ordered)"),
        ("`shrink=False`, `robust=False`, `empirical=False`", "--no-shrink, --all-rows, --named-only"),
        ("unknown key '`robot`', ``x``, a`b`c, \"`y`\"", "unknown key '`robot`', ``x``, a`b`c, \"`y`\""),
    ],
)
def test_marked_names_become_options(text, shown):
    assert as_options(text) == shown


def test_errors_show_options_on_the_terminal_only(capsys):
    error = UsageError("`poses` and `samples` both say where to predict")
    say_error(error)
    say_error(InputError(Problem("no column", "poses.csv", fix="give `robot`")))
    assert str(error) == "`poses` and `samples` both say where to predict"
    assert capsys.readouterr().err == (
        "error: --poses and --samples both say where to predict\nerror: poses.csv: no column\n  tip: give --robot\n"
    )
