"""Read YAML with line numbers: a safe tree of nodes, and typed access that collects every problem."""

from __future__ import annotations

import contextlib
import difflib
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import yaml

from robacc.errors import InputError, Problem

MAX_DEPTH = 32
MAX_NODES = 50_000
MAX_LENGTH = 4 * 2**20
"""Characters: far above any robot or gate file; a faulty file of this size takes some ten seconds to check."""

_LONG = 100_000
"""Characters from which a file is likely written by a program, and read by the faster reader."""
_READ_OTHERWISE = frozenset("\t?&*!\ufeff\x85\u2028\u2029")
"""Characters that PyYAML's two readers read differently, or that the limited one refuses."""

_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
"""Decimal numbers only: YAML 1.1 reads 1e-4 as text, 010 as eight and 1:30 as ninety."""
_POINT = "write decimals with a point, as in 162.5; a comma separates entries"
_NOT_FINITE = re.compile(r"[-+]?\.?(inf(inity)?|nan)", re.IGNORECASE)


def _check_events(text: str, loader: Any) -> None:
    """Raise an error of a text that is too deep or too large, or has tags or aliases, which can expand to gigabytes."""
    depth = count = 0
    for event in yaml.parse(text, Loader=loader):
        if isinstance(event, yaml.DocumentEndEvent):
            return  # a second document is refused as such
        depth -= isinstance(event, yaml.CollectionEndEvent)
        if not isinstance(event, yaml.NodeEvent):
            continue
        count += 1
        problem = None
        if isinstance(event, yaml.AliasEvent) or event.anchor is not None:
            problem = "anchors (&) and aliases (*) are not supported"
        elif (tag := getattr(event, "tag", None)) is not None:
            problem = f"tags (!) are not supported, found {tag[:40]}"
        elif depth >= MAX_DEPTH:
            problem = f"nested deeper than {MAX_DEPTH}"
        elif count > MAX_NODES:
            problem = f"more than {MAX_NODES} entries"
        if problem:
            raise yaml.MarkedYAMLError(problem=problem, problem_mark=event.start_mark)  # type: ignore[arg-type]
        depth += isinstance(event, yaml.CollectionStartEvent)


def compose(text: str, file: str) -> yaml.Node:
    """Return the document's root node.

    Raises:
        InputError: The text is not YAML, is empty, has several documents or anchors, or is too long or nested too deep.
    """
    if len(text) > MAX_LENGTH:
        raise InputError(Problem(f"is larger than {MAX_LENGTH / 2**20:g} MiB, the limit for YAML files", file))
    try:
        loader: Any = yaml.SafeLoader
        if yaml.__with_libyaml__ and _READ_OTHERWISE.isdisjoint(text):
            with contextlib.suppress(yaml.scanner.ScannerError, yaml.parser.ParserError):  # the other reader words it
                _check_events(text, yaml.CSafeLoader)
                loader = yaml.CSafeLoader if len(text) >= _LONG else None
        if loader is yaml.SafeLoader:
            _check_events(text, loader)
        node: yaml.Node | None = yaml.compose(text, Loader=loader or yaml.SafeLoader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        message = f"cannot be read as YAML: {', '.join(part for part in (error.context, error.problem) if part)}"
        fix = "indent with blanks, not with tabs" if "'\\t'" in message else None
        raise InputError(Problem(message, file, mark.line + 1 if mark else None, fix=fix)) from None
    except yaml.reader.ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        message = f"cannot be read as YAML: the character U+{ord(text[error.position]):04X} is not allowed"
        raise InputError(Problem(message, file, line)) from None
    if node is None:
        raise InputError(Problem("the file is empty", file))
    return node


@dataclass(frozen=True, slots=True)
class Source:
    """YAML file and the problems found in it so far."""

    file: str
    problems: list[Problem] = field(default_factory=list)

    def report(self, node: yaml.Node | None, path: str, message: str, fix: str | None = None) -> None:
        """Add a problem of a node, or of the file where ``node`` is None."""
        line = node.start_mark.line + 1 if node is not None else None
        self.problems.append(Problem(message, self.file, line, path or None, fix))

    def finish(self) -> None:
        """Raise an error where there is a problem.

        Raises:
            InputError: Every problem, in the order of the file.
        """
        if self.problems:
            raise InputError(sorted(self.problems, key=lambda problem: problem.line or 0))

    def section(self, node: yaml.Node, path: str, known: Sequence[str]) -> YamlSection | None:
        """Return a mapping with the keys ``known``, reporting any other key; None where the node is not a mapping."""
        if not isinstance(node, yaml.MappingNode):
            self.report(node, path, f"expected keys with values ({', '.join(known)}), found {describe(node)}")
            return None
        values: dict[str, yaml.Node] = {}
        for key, key_node, value in self.entries(node, path):
            if key in known:
                values[key] = value
            else:
                fix = nearest(key, known) or f"known keys: {', '.join(known)}"
                if is_null(value) and _NUMBER.fullmatch(key):
                    # Between braces "d: 162,5" is a d of 162 and a key 5 without a value.
                    fix = _POINT
                self.report(key_node, join(path, key), "unknown key", fix)
        return YamlSection(self, node, path, values)

    def entries(self, node: yaml.MappingNode, path: str) -> Iterator[tuple[str, yaml.Node, yaml.Node]]:
        """Yield key, key's node and value's node of each entry; report repeated keys and keys that are not text."""
        lines: dict[str, int] = {}
        for key_node, value in node.value:
            if not isinstance(key_node, yaml.ScalarNode):
                self.report(key_node, path, "expected a plain name as a key")
                continue
            key = str(key_node.value)
            if not key.isprintable():
                self.report(key_node, path, f"expected printable characters in a key, found {describe(key_node)}")
                continue
            if key in lines:
                self.report(key_node, join(path, key), f"is given twice, first in line {lines[key]}")
                continue
            lines[key] = key_node.start_mark.line + 1
            yield key, key_node, value

    def items(self, node: yaml.Node, path: str, item_name: str) -> Sequence[yaml.Node]:
        """Return the nodes of a list; report a problem and return none where the node is not a list."""
        if not isinstance(node, yaml.SequenceNode):
            self.report(node, path, f"expected a list of {item_name}, found {describe(node)}")
            return ()
        return list(node.value)

    def number(self, node: yaml.Node, path: str) -> float | None:
        """Return a finite number; report a problem and return None where the node is not one."""
        text = str(node.value) if isinstance(node, yaml.ScalarNode) and not node.style else ""
        if _NUMBER.fullmatch(text):
            value = float(text)
            if math.isfinite(value):
                return value
            self.report(node, path, f"{text} is too large for a number")
        elif _NOT_FINITE.fullmatch(text):
            self.report(node, path, f"expected a finite number, found {text}")
        else:
            quoted = isinstance(node, yaml.ScalarNode) and _NUMBER.fullmatch(str(node.value))
            comma = isinstance(node, yaml.ScalarNode) and _NUMBER.fullmatch(str(node.value).replace(",", ".", 1))
            fix = "remove the quotes" if quoted else _POINT if comma else None
            self.report(node, path, f"expected a number, found {describe(node)}", fix)
        return None

    def numbers(self, node: yaml.Node, path: str, count: int) -> tuple[float, ...] | None:
        """Return ``count`` finite numbers; report a problem and return None where the node is not such a list."""
        if not isinstance(node, yaml.SequenceNode) or len(node.value) != count:
            self.report(node, path, f"expected a list of {count} numbers, found {describe(node)}")
            return None
        values = [self.number(item, f"{path}[{i}]") for i, item in enumerate(node.value)]
        finite = tuple(value for value in values if value is not None)
        return finite if len(finite) == count else None

    def text(self, node: yaml.Node, path: str) -> str | None:
        """Return a non-empty line of printable text; report a problem and return None where the node is not one."""
        if isinstance(node, yaml.ScalarNode) and node.value.strip() and node.value.isprintable():
            return str(node.value).strip()
        self.report(node, path, f"expected a name, found {describe(node)}")
        return None

    def choice(self, node: yaml.Node, path: str, options: Sequence[str]) -> str | None:
        """Return one of ``options``; report a problem and return None where the node is not one."""
        if isinstance(node, yaml.ScalarNode) and node.value in options:
            return str(node.value)
        fix = nearest(str(node.value), options) if isinstance(node, yaml.ScalarNode) else None
        self.report(node, path, f"expected {' or '.join(options)}, found {describe(node)}", fix)
        return None

    def plain(self, node: yaml.Node, path: str) -> Any:
        """Return the node as plain dictionaries, lists, numbers, booleans and text (1e-4 is a number, 010 is ten)."""
        if isinstance(node, yaml.MappingNode):
            return {key: self.plain(value, join(path, key)) for key, _, value in self.entries(node, path)}
        if isinstance(node, yaml.SequenceNode):
            return [self.plain(item, f"{path}[{i}]") for i, item in enumerate(node.value)]
        text = str(node.value)
        if not text.isprintable():
            self.report(node, path, f"expected printable characters, found {describe(node)}")
        if not isinstance(node, yaml.ScalarNode) or node.style:
            return text
        if _NUMBER.fullmatch(text) or _NOT_FINITE.fullmatch(text):
            return int(text) if text.lstrip("+-").isdecimal() else self.number(node, path)
        if node.tag == "tag:yaml.org,2002:bool":
            return text.lower() in ("true", "yes", "on")
        return None if is_null(node) else text


@dataclass(frozen=True, slots=True)
class YamlSection:
    """Mapping of a YAML file with its known keys."""

    source: Source
    node: yaml.Node
    path: str
    values: Mapping[str, yaml.Node]

    def get(self, key: str) -> yaml.Node | None:
        """Return the value's node; None where the key is absent or has no value."""
        node = self.values.get(key)
        return None if node is None or is_null(node) else node

    def require(self, key: str) -> yaml.Node | None:
        """Return the value's node; report a problem where it is missing."""
        node = self.get(key)
        if node is None:
            self.source.report(self.values.get(key, self.node), self.at(key), "is missing")
        return node

    def at(self, key: str) -> str:
        """Return the dotted name of a key."""
        return join(self.path, key)


def join(path: str, key: str) -> str:
    """Return ``path.key``, or ``key`` where the path is empty."""
    return f"{path}.{key}" if path else key


def is_null(node: yaml.Node) -> bool:
    """Return whether a node is empty: ``key:``, ``~`` or ``null``."""
    return bool(node.tag == "tag:yaml.org,2002:null")


def describe(node: yaml.Node) -> str:
    """Return a description of a node for a message."""
    if isinstance(node, yaml.MappingNode):
        return "keys with values"
    if isinstance(node, yaml.SequenceNode):
        return f"a list of {len(node.value)}"
    if is_null(node):
        return "nothing"
    text = str(node.value)
    return repr(text if len(text) <= 40 else text[:39] + "…")


def nearest(name: str, known: Sequence[str]) -> str | None:
    """Return a question that suggests the nearest known name; None where none is near."""
    matches = difflib.get_close_matches(name.lower(), [candidate.lower() for candidate in known], 1, 0.6)
    suggestions = (candidate for candidate in known if matches and candidate.lower() == matches[0])
    return next((f"did you mean {candidate!r}?" for candidate in suggestions), None)
