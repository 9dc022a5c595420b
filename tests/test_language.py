"""Names, docstrings and messages use the project's words: ``docs/glossary.md`` has them, CONTRIBUTING the rules."""

import ast
import json
import re
from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

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
    return {str(path.relative_to(ROOT)): ast.parse(path.read_text(encoding="utf-8")) for path in paths}


def bindings(tree: ast.AST) -> Iterator[str]:
    """Names that are bound: variables, parameters, functions and classes."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            yield node.id
        elif isinstance(node, ast.arg):
            yield node.arg
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            yield node.name


def docstrings(tree: ast.AST) -> Iterator[str]:
    """Docstrings of a module, its classes and its functions."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            text = ast.get_docstring(node)
            if text:
                yield text


def strings(tree: ast.AST) -> Iterator[str]:
    """Texts of string literals, docstrings among them; ``{}`` stands for the values of an f-string."""
    parts = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            parts |= {id(part) for part in node.values}
            yield "".join(str(part.value) if isinstance(part, ast.Constant) else "{}" for part in node.values)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in parts:
            yield node.value


def replaced_phrases(text: str) -> list[str]:
    plain = " ".join(text.split()).lower()
    return [phrase for phrase in REPLACED_PHRASES if phrase in plain]


@cache
def files_with(where: str) -> dict[str, set[str]]:
    """Files of the package, or pages, in which each of the replaced phrases stands."""
    texts = package_texts() if where == "package" else {name: [text] for name, text in pages().items()}
    files: dict[str, set[str]] = {phrase: set() for phrase in REPLACED_PHRASES}
    for name, parts in texts.items():
        for phrase in replaced_phrases("\0".join(parts)):
            files[phrase].add(name)
    return files


def package_texts() -> dict[str, list[str]]:
    """Everything that the package may print, by its file: strings, schemas, templates, data."""
    texts = {name: list(strings(tree)) for name, tree in trees().items()}
    for path in sorted(PACKAGE.rglob("*")):
        if path.suffix in (".json", ".yaml", ".html", ".css", ".js", ".j2"):
            text = path.read_text(encoding="utf-8")
            texts[str(path.relative_to(ROOT))] = [json.dumps(json.loads(text)) if path.suffix == ".json" else text]
    return texts


def pages() -> dict[str, str]:
    """Texts for the project's readers; CHANGELOG is history, and keeps its words."""
    paths = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", ROOT / "sample_data" / "README.md"]
    paths += sorted((ROOT / "docs").rglob("*.md"))
    return {str(path.relative_to(ROOT)): path.read_text(encoding="utf-8") for path in paths}


def test_no_class_name_stands_twice() -> None:
    places: dict[str, list[str]] = {}
    for name, tree in trees().items():
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef):
                places.setdefault(node.name, []).append(name)
    assert {cls: names for cls, names in places.items() if len(names) > 1} == {}


def test_names_say_what_an_object_is() -> None:
    counts = {name: Counter(bindings(tree)) for name, tree in trees().items()}
    vague = {name: sum(count[word] for word in VAGUE_NAMES) for name, count in counts.items()}
    rate = 1000 * sum(vague.values()) / sum(count.total() for count in counts.values())
    offenders = Counter(vague).most_common(30)
    assert rate < MOST_VAGUE_NAMES, f"{rate:.1f} of 1,000 names are vague: {offenders}"


def test_docstrings_open_with_a_verb_or_a_noun() -> None:
    texts = [(name, text) for name, tree in trees().items() for text in docstrings(tree)]
    offenders = [f"{name}: {text.splitlines()[0]}" for name, text in texts if OPENING.match(text)]
    assert len(offenders) < MOST_SUCH_OPENINGS * len(texts), "\n".join(offenders)


@pytest.mark.parametrize("phrase", REPLACED_PHRASES)
def test_replaced_phrases_stay_out_of_the_package(phrase: str) -> None:
    assert not files_with("package")[phrase]


@pytest.mark.parametrize("phrase", REPLACED_PHRASES)
def test_replaced_phrases_stay_out_of_the_pages(phrase: str) -> None:
    assert not files_with("pages")[phrase]


def test_the_checks_notice_what_they_look_for() -> None:
    source = '"""How a\n    chair is made."""\n\ndef one(found: int) -> str:\n    return f"what is {found} left"\n'
    tree = ast.parse(source)
    assert set(bindings(tree)) == {"one", "found"}
    assert all(OPENING.match(text) for text in docstrings(tree))
    assert "what is {} left" in set(strings(tree))
    assert replaced_phrases("But what\n  is left of it") == ["what is left"]
    assert not OPENING.match("Offset of a joint.")
