"""The package's own source: imports point one way, names, docstrings and messages use the project's words.

``docs/glossary.md`` has the words, CONTRIBUTING the rules. A module may import from its own layer and those below it.
"""

import ast
import gc
import inspect
import json
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path
from types import FunctionType

import pytest

import robacc
from robacc.cli import commands as declarations
from robacc.cli.main import COMMANDS, FORMS
from robacc.render.text import _MARKED

ROOT = Path(__file__).resolve().parents[1]
PACKAGE = ROOT / "robacc"
VAGUE_NAMES = ("one", "ones", "found", "told", "mine", "seen", "alike", "drawn")
MOST_VAGUE_NAMES = 5.0
"""Of 1,000 bindings: a few such names are the right ones."""
OPENING = re.compile(r"(Of|What|How|Where|That)\b")
MOST_SUCH_OPENINGS = 0.01
REPLACED_PHRASES = (
    "as delivered",
    "chosen again",
    "declared fitted",
    "even chances",
    "had no part",
    "hardly show",
    "might as well be",
    "no part of the rest",
    "to bear in mind",
    "told apart",
    "what is left",
    "with findings",
)
"""Wordings that the glossary has a term for."""


@cache
def trees() -> dict[str, ast.Module]:
    """Every module of the package, by its path."""
    paths = sorted(PACKAGE.rglob("*.py"))
    gc.disable()  # each of its rounds looks at every node again
    found = {str(path.relative_to(ROOT)): ast.parse(path.read_text(encoding="utf-8")) for path in paths}
    gc.enable()
    return found


def bindings(nodes: Iterable[ast.AST]) -> Iterator[str]:
    """Names that are bound: variables, parameters, functions and classes."""
    for node in nodes:
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id
        elif isinstance(node, ast.arg):
            yield node.arg
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield node.name


def docstrings(nodes: Iterable[ast.AST]) -> Iterator[str]:
    """Docstrings of a module, its classes and its functions."""
    for node in nodes:
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            text = ast.get_docstring(node)
            if text:
                yield text


def strings(nodes: Iterable[ast.AST]) -> Iterator[str]:
    """Texts of string literals, docstrings among them; ``{}`` stands for the values of an f-string."""
    parts = set()
    for node in nodes:
        if isinstance(node, ast.JoinedStr):
            parts |= {id(part) for part in node.values}
            yield "".join(str(part.value) if isinstance(part, ast.Constant) else "{}" for part in node.values)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in parts:
            yield node.value


def replaced_phrases(text: str) -> list[str]:
    plain = " ".join(text.split()).lower()
    return [phrase for phrase in REPLACED_PHRASES if phrase in plain]


def package_texts() -> dict[str, list[str]]:
    """Everything that the package may print, by its file: strings, schemas, templates, data."""
    texts = {name: list(strings(nodes)) for name, nodes in modules().items()}
    for path in sorted(PACKAGE.rglob("*")):
        if path.suffix in (".json", ".yaml", ".html", ".css", ".js", ".j2"):
            text = path.read_text(encoding="utf-8")
            texts[str(path.relative_to(ROOT))] = [json.dumps(json.loads(text)) if path.suffix == ".json" else text]
    return texts


def pages() -> dict[str, list[str]]:
    """Texts for the project's readers; CHANGELOG is history, and keeps its words."""
    paths = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "sample_data" / "README.md"]
    paths += sorted((ROOT / "docs").rglob("*.md"))
    return {str(path.relative_to(ROOT)): [path.read_text(encoding="utf-8")] for path in paths}


def test_no_class_name_stands_twice() -> None:
    places: dict[str, list[str]] = {}
    for name, nodes in modules().items():
        for node in nodes:
            if isinstance(node, ast.ClassDef):
                places.setdefault(node.name, []).append(name)
    assert {cls: names for cls, names in places.items() if len(names) > 1} == {}


def test_names_say_what_an_object_is() -> None:
    counts = {name: Counter(bindings(nodes)) for name, nodes in modules().items()}
    vague = {name: sum(count[word] for word in VAGUE_NAMES) for name, count in counts.items()}
    rate = 1000 * sum(vague.values()) / sum(count.total() for count in counts.values())
    offenders = Counter(vague).most_common(30)
    assert rate < MOST_VAGUE_NAMES, f"{rate:.1f} of 1,000 names are vague: {offenders}"


def test_docstrings_open_with_a_verb_or_a_noun() -> None:
    texts = [(name, text) for name, nodes in modules().items() for text in docstrings(nodes)]
    offenders = [f"{name}: {text.splitlines()[0]}" for name, text in texts if OPENING.match(text)]
    assert len(offenders) < MOST_SUCH_OPENINGS * len(texts), "\n".join(offenders)


@pytest.mark.parametrize("texts", [package_texts, pages])
def test_replaced_phrases_stay_out(texts: Callable[[], dict[str, list[str]]]) -> None:
    found = {name: replaced_phrases("\0".join(parts)) for name, parts in texts().items()}
    assert {name: phrases for name, phrases in found.items() if phrases} == {}


def test_the_checks_notice_what_they_look_for() -> None:
    source = '"""How a\n    chair is made."""\n\ndef one(found: int) -> str:\n    return f"what is {found} left"\n'
    tree = [*ast.walk(ast.parse(source))]
    assert set(bindings(tree)) == {"one", "found"}
    assert all(OPENING.match(text) for text in docstrings(tree))
    assert "what is {} left" in set(strings(tree))
    assert replaced_phrases("But what\n  is left of it") == ["what is left"]
    assert not OPENING.match("Offset of a joint.")


# Layers: each module may use its own layer and those below it, and nothing above.

LAYERS = (
    ("robacc.errors", "robacc.version"),
    ("robacc.geometry", "robacc.plug_ins", "robacc.quantities", "robacc.workers"),
    ("robacc.io",),
    ("robacc.measurements", "robacc.statistics"),
    ("robacc.poses",),
    ("robacc.robots",),
    ("robacc.programs",),
    ("robacc.gravity",),
    ("robacc.effects",),
    ("robacc.modelling",),
    ("robacc.fitting",),
    ("robacc.error_model",),
    ("robacc.accuracy",),
    ("robacc.simulation", "robacc.diagnostics"),
    ("robacc.tracing",),
    ("robacc.correction", "robacc.exporters", "robacc.iso_9283", "robacc.prediction"),
    ("robacc.planning",),
    ("robacc.comparison", "robacc.gates"),
    ("robacc.documents",),
    ("robacc.history",),
    ("robacc.render.text",),
    ("robacc.render.views",),
    ("robacc.render.plots",),
    ("robacc.render.page",),
    ("robacc.render",),
    ("robacc.api",),
    ("robacc.cli",),
    ("robacc", "robacc.__main__"),
)
"""From the ground up. A package stands for all of its modules."""
PLACES = {name: number for number, names in enumerate(LAYERS) for name in names}
OPENS_FILES = (
    "robacc.io.",
    "robacc.documents.envelope",
    "robacc.documents.accuracy",
    "robacc.documents.envelope",
    "robacc.history",
    "robacc.modelling.robot_file",
    "robacc.programs.program",
    "robacc.poses.cameras",
    "robacc.poses.reading",
    "robacc.api.",
    "robacc.cli.",
)
"""Modules that name a file to read or write; all but those of io do so through io."""
FILE_CALLS = {"open", "read_text", "write_text", "read_bytes", "write_bytes"}


def module_name(path: str) -> str:
    """The name of a module by its path in the project."""
    return path.removesuffix(".py").replace("/", ".").removesuffix(".__init__")


@cache
def modules() -> dict[str, list[ast.AST]]:
    """Every node of each module, by the module's name: trees are walked once."""
    return {module_name(path): list(ast.walk(tree)) for path, tree in trees().items()}


def imports(nodes: Iterable[ast.AST]) -> set[str]:
    """Modules of this package that nodes import, inside functions and for type checking too."""
    found, known = set(), modules()
    for node in nodes:
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"relative import of {node.module}"
            for alias in node.names:
                member = f"{node.module}.{alias.name}"
                found.add(member if member in known else str(node.module))
    return {name for name in found if name == "robacc" or name.startswith("robacc.")}


def layer(module: str) -> int:
    """The layer of a module, or of the nearest package around it that has one."""
    name = module
    while name not in PLACES:
        assert "." in name.removeprefix("robacc."), f"{module} has no layer; give it one in {__name__}.LAYERS"
        name = name.rpartition(".")[0]
    return PLACES[name]


@cache
def imported() -> dict[str, set[str]]:
    """What each module imports of this package."""
    return {name: imports(nodes) for name, nodes in modules().items()}


def test_imports_point_down() -> None:
    above = {(module, name) for module, names in imported().items() for name in names if layer(name) > layer(module)}
    assert not above, "modules import from layers above their own"


def test_no_import_goes_round_in_a_circle() -> None:
    TopologicalSorter({module: names - {module} for module, names in imported().items()}).prepare()


def test_the_package_does_not_know_its_plug_ins() -> None:
    assert [name for name in trees() if "robacc_plugins" in (ROOT / name).read_text(encoding="utf-8")] == []


def test_reports_and_files_leave_each_other_alone() -> None:
    for module, names in imported().items():
        for one, other in (("robacc.documents", "robacc.render"), ("robacc.render", "robacc.documents")):
            assert not module.startswith(f"{one}.") or not any(name.startswith(other) for name in names), module


def test_the_checks_see_a_wrong_import() -> None:
    wrong = ast.walk(ast.parse("def f():\n    from robacc.cli import main\n"))
    assert imports(wrong) == {"robacc.cli.main"}
    assert layer("robacc.cli.main") > layer("robacc.render.text") > layer("robacc.geometry")


def test_only_io_opens_files() -> None:
    for module, nodes in modules().items():
        if module.startswith(OPENS_FILES):
            continue
        for node in nodes:
            if isinstance(node, ast.Call):
                name = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
                assert name not in FILE_CALLS, f"{module} line {node.lineno} opens a file"


def test_the_command_line_starts_without_numpy() -> None:
    names = [name for name in modules() if name.startswith("robacc.cli.")]
    code = f"import sys, {', '.join(names)}; print([m for m in ('numpy', 'yaml', 'scipy') if m in sys.modules])"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=ROOT, check=True)
    assert run.stdout.strip() == "[]"


# The library names parameters, the command line options: no text outside ``robacc.cli`` is spelled for one of them.

OPTION = re.compile(r"(?<![\w-])--[a-z]")

SHOWS_COMMANDS = {
    "render/page.py",  # the command that makes a result again
    "render/views/accuracy.py",  # the command that comes next
    "render/views/fit.py",  # the same
    "render/views/expected.py",  # the same
    "modelling/robot_file.py",  # the command that makes a robot file
    "simulation/simulate.py",  # comments of files that `robacc init` writes
    "poses/csv_file.py",  # the same
    "render/plots/canvas.py",  # variables of CSS
    "render/text.py",
}


@cache
def library_texts() -> dict[str, list[str]]:
    """String literals of each file outside ``robacc.cli``, parts of f-strings included and docstrings left out."""
    found = {}
    for path, nodes in zip(trees(), modules().values(), strict=True):
        left_out = {id(node.value) for node in nodes if isinstance(node, ast.Expr)}
        literals = (node for node in nodes if isinstance(node, ast.Constant) and isinstance(node.value, str))
        found[path.removeprefix("robacc/")] = [node.value for node in literals if id(node) not in left_out]
    return {name: texts for name, texts in found.items() if not name.startswith("cli/")}


def test_no_text_of_the_library_has_an_option() -> None:
    found = {name for name, texts in library_texts().items() if any(map(OPTION.search, texts))}
    assert found <= SHOWS_COMMANDS


def test_every_marked_name_is_a_parameter_of_a_call() -> None:
    functions = [call for call in (getattr(robacc, name) for name in robacc.__all__) if isinstance(call, FunctionType)]
    functions += [getattr(declarations, name) for name in (*COMMANDS, *FORMS.values())]
    parameters = {name for function in functions for name in inspect.signature(function).parameters}
    for name, texts in library_texts().items():
        marked = {match[1] for text in texts for match in _MARKED.finditer(text)}
        assert marked <= parameters, name
