"""YAML with line numbers: a safe tree of nodes, and typed access to it that collects every problem."""

from __future__ import annotations

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
"""Characters: far above any file of these, and what takes some ten seconds to be found fault with."""

_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")
"""Decimal numbers only: YAML 1.1 would take 1e-4 for text, 010 for eight and 1:30 for ninety."""
_POINT = "write decimals with a point, as in 162.5; a comma separates entries"
_NOT_FINITE = re.compile(r"[-+]?\.?(inf(inity)?|nan)", re.IGNORECASE)


class _Loader(yaml.SafeLoader):
    """PyYAML's safe loader without tags and aliases (a few lines expand to gigabytes), of bounded depth and size."""

    depth = 0
    count = 0

    def compose_node(self, parent: yaml.Node | None, index: int) -> yaml.Node | None:
        event = self.peek_event()  # type: ignore[no-untyped-call]
        self.count += 1
        problem = None
        if isinstance(event, yaml.AliasEvent) or getattr(event, "anchor", None) is not None:
            problem = "anchors (&) and aliases (*) are not taken"
        elif getattr(event, "tag", None) is not None:
            problem = f"tags (!) are not taken, found {event.tag[:40]}"
        elif self.depth >= MAX_DEPTH:
            problem = f"nested deeper than {MAX_DEPTH}"
        elif self.count > MAX_NODES:
            problem = f"more than {MAX_NODES} entries"
        if problem:
            raise yaml.MarkedYAMLError(problem=problem, problem_mark=event.start_mark)
        self.depth += 1
        node: yaml.Node | None = super().compose_node(parent, index)
        self.depth -= 1
        return node


def compose(text: str, file: str) -> yaml.Node:
    """The document's root node.

    Raises:
        InputError: The text is no YAML, empty, several documents, or uses anchors, or is nested or long beyond reason.
    """
    if len(text) > MAX_LENGTH:
        raise InputError(Problem(f"is larger than {MAX_LENGTH / 2**20:g} MiB, the most that is read as YAML", file))
    try:
        node = yaml.compose(text, Loader=_Loader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        message = f"not readable as YAML: {', '.join(part for part in (error.context, error.problem) if part)}"
        raise InputError(Problem(message, file, mark.line + 1 if mark else None)) from None
    except yaml.reader.ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        message = f"not readable as YAML: the character U+{ord(text[error.position]):04X} is not allowed"
        raise InputError(Problem(message, file, line)) from None
    if node is None:
        raise InputError(Problem("the file is empty", file))
    return node


@dataclass(frozen=True, slots=True)
class Source:
    """The file that is read, and what was found wrong with it so far."""

    file: str
    problems: list[Problem] = field(default_factory=list)

    def complain(self, node: yaml.Node | None, path: str, message: str, fix: str | None = None) -> None:
        """Note a problem at a node (None: of the file as a whole)."""
        line = node.start_mark.line + 1 if node is not None else None
        self.problems.append(Problem(message, self.file, line, path or None, fix))

    def finish(self) -> None:
        """Raise everything found, in the order of the file.

        Raises:
            InputError: There was a problem.
        """
        if self.problems:
            raise InputError(sorted(self.problems, key=lambda problem: problem.line or 0))

    def section(self, node: yaml.Node, path: str, known: Sequence[str]) -> YamlSection | None:
        """A mapping whose keys are all ``known``; None where the node is something else."""
        if not isinstance(node, yaml.MappingNode):
            self.complain(node, path, f"expected keys with values ({', '.join(known)}), found {found(node)}")
            return None
        values: dict[str, yaml.Node] = {}
        for key, key_node, value in self.entries(node, path):
            if key in known:
                values[key] = value
            else:
                fix = nearest(key, known) or f"known here: {', '.join(known)}"
                if is_null(value) and _NUMBER.fullmatch(key):
                    # Between braces "d: 162,5" is a d of 162, and a key 5 with nothing behind it.
                    fix = _POINT
                self.complain(key_node, join(path, key), "unknown key", fix)
        return YamlSection(self, node, path, values)

    def entries(self, node: yaml.MappingNode, path: str) -> Iterator[tuple[str, yaml.Node, yaml.Node]]:
        """Key, key's node and value's node of each entry; repeated keys and keys that are no text are complained of."""
        lines: dict[str, int] = {}
        for key_node, value in node.value:
            if not isinstance(key_node, yaml.ScalarNode):
                self.complain(key_node, path, "a key must be a plain name")
                continue
            key = str(key_node.value)
            if not key.isprintable():
                self.complain(key_node, path, f"a key has printable characters only, found {found(key_node)}")
                continue
            if key in lines:
                self.complain(key_node, join(path, key), f"is given twice, first in line {lines[key]}")
                continue
            lines[key] = key_node.start_mark.line + 1
            yield key, key_node, value

    def items(self, node: yaml.Node, path: str, what: str) -> Sequence[yaml.Node]:
        """The nodes of a list; empty, with a complaint, where the node is something else."""
        if not isinstance(node, yaml.SequenceNode):
            self.complain(node, path, f"expected a list of {what}, found {found(node)}")
            return ()
        return list(node.value)

    def number(self, node: yaml.Node, path: str) -> float | None:
        """A finite number; None with a complaint where it is none."""
        text = str(node.value) if isinstance(node, yaml.ScalarNode) and node.style is None else ""
        if _NUMBER.fullmatch(text):
            value = float(text)
            if math.isfinite(value):
                return value
            self.complain(node, path, f"{text} is too large for a number")
        elif _NOT_FINITE.fullmatch(text):
            self.complain(node, path, f"expected a finite number, found {text}")
        else:
            quoted = isinstance(node, yaml.ScalarNode) and _NUMBER.fullmatch(str(node.value))
            comma = isinstance(node, yaml.ScalarNode) and _NUMBER.fullmatch(str(node.value).replace(",", ".", 1))
            fix = "remove the quotes" if quoted else _POINT if comma else None
            self.complain(node, path, f"expected a number, found {found(node)}", fix)
        return None

    def numbers(self, node: yaml.Node, path: str, count: int) -> tuple[float, ...] | None:
        """``count`` finite numbers; None with a complaint where they are not."""
        if not isinstance(node, yaml.SequenceNode) or len(node.value) != count:
            self.complain(node, path, f"expected a list of {count} numbers, found {found(node)}")
            return None
        values = [self.number(item, f"{path}[{i}]") for i, item in enumerate(node.value)]
        good = tuple(value for value in values if value is not None)
        return good if len(good) == count else None

    def text(self, node: yaml.Node, path: str) -> str | None:
        """A non-empty line of printable text."""
        if isinstance(node, yaml.ScalarNode) and node.value.strip() and node.value.isprintable():
            return str(node.value).strip()
        self.complain(node, path, f"expected a name, found {found(node)}")
        return None

    def choice(self, node: yaml.Node, path: str, options: Sequence[str]) -> str | None:
        """One of ``options``."""
        if isinstance(node, yaml.ScalarNode) and node.value in options:
            return str(node.value)
        fix = nearest(str(node.value), options) if isinstance(node, yaml.ScalarNode) else None
        self.complain(node, path, f"expected {' or '.join(options)}, found {found(node)}", fix)
        return None

    def plain(self, node: yaml.Node, path: str) -> Any:
        """The node as plain dictionaries, lists, numbers, booleans and text (1e-4 is a number, 010 is ten)."""
        if isinstance(node, yaml.MappingNode):
            return {key: self.plain(value, join(path, key)) for key, _, value in self.entries(node, path)}
        if isinstance(node, yaml.SequenceNode):
            return [self.plain(item, f"{path}[{i}]") for i, item in enumerate(node.value)]
        text = str(node.value)
        if not text.isprintable():
            self.complain(node, path, f"expected printable characters, found {found(node)}")
        if not isinstance(node, yaml.ScalarNode) or node.style is not None:
            return text
        if _NUMBER.fullmatch(text) or _NOT_FINITE.fullmatch(text):
            return int(text) if text.lstrip("+-").isdigit() else self.number(node, path)
        if node.tag == "tag:yaml.org,2002:bool":
            return text.lower() in ("true", "yes", "on")
        return None if is_null(node) else text


@dataclass(frozen=True, slots=True)
class YamlSection:
    """A mapping of the file with its known keys."""

    source: Source
    node: yaml.Node
    path: str
    values: Mapping[str, yaml.Node]

    def get(self, key: str) -> yaml.Node | None:
        """The value's node; None where the key is absent or has nothing behind it."""
        node = self.values.get(key)
        return None if node is None or is_null(node) else node

    def require(self, key: str) -> yaml.Node | None:
        """The same; absence is complained of."""
        node = self.get(key)
        if node is None:
            self.source.complain(self.values.get(key, self.node), self.at(key), "is missing")
        return node

    def at(self, key: str) -> str:
        """The dotted name of a key."""
        return join(self.path, key)


def join(path: str, key: str) -> str:
    """``path.key``."""
    return f"{path}.{key}" if path else key


def is_null(node: yaml.Node) -> bool:
    """Whether a node is nothing: ``key:``, ``~`` or ``null``."""
    return bool(node.tag == "tag:yaml.org,2002:null")


def found(node: yaml.Node) -> str:
    """What a node is, for a message."""
    if isinstance(node, yaml.MappingNode):
        return "keys with values"
    if isinstance(node, yaml.SequenceNode):
        return f"a list of {len(node.value)}"
    if is_null(node):
        return "nothing"
    text = str(node.value)
    return repr(text if len(text) <= 40 else text[:39] + "…")


def nearest(name: str, known: Sequence[str]) -> str | None:
    """A question that offers the nearest known name; None where none is near."""
    near = difflib.get_close_matches(name.lower(), [other.lower() for other in known], 1, 0.6)
    return next((f"did you mean {other!r}?" for other in known if near and other.lower() == near[0]), None)
