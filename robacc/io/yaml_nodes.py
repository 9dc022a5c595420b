"""Read YAML with line numbers, as a safe tree of nodes with typed access that collects every problem; and change it."""

import contextlib
import difflib
import itertools
import math
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from typing import Any, NamedTuple, cast

import yaml

from robacc.errors import InputError, Problem, given
from robacc.io.files import ProblemLog, clip, spliced
from robacc.quantities import significant

MAX_DEPTH = 32
MAX_NODES = 50_000

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
        tag = getattr(event, "tag", None)
        is_anchored = isinstance(event, yaml.AliasEvent) or event.anchor is not None
        if is_anchored or tag is not None or depth >= MAX_DEPTH or count > MAX_NODES:
            large = f"nested deeper than {MAX_DEPTH}" if depth >= MAX_DEPTH else f"more than {MAX_NODES} entries"
            problem = large if tag is None else f"tags (!) are not supported, found {tag[:40]}"
            problem = "anchors (&) and aliases (*) are not supported" if is_anchored else problem
            raise yaml.MarkedYAMLError(problem=problem, problem_mark=event.start_mark)  # type: ignore[arg-type]
        depth += isinstance(event, yaml.CollectionStartEvent)


def compose(text: str, file: str) -> yaml.Node:
    """Return the document's root node.

    Raises:
        InputError: The text is not YAML, is empty, has several documents or anchors, or is nested too deep.
    """
    try:
        loader: Any = yaml.SafeLoader
        # PyYAML's two readers read these characters differently, or the limited one refuses them.
        if yaml.__with_libyaml__ and set("\t?&*!\ufeff\x85\u2028\u2029").isdisjoint(text):
            with contextlib.suppress(yaml.scanner.ScannerError, yaml.parser.ParserError):  # the other reader words it
                _check_events(text, yaml.CSafeLoader)
                loader = yaml.CSafeLoader
        if loader is yaml.SafeLoader:
            _check_events(text, loader)
        node: yaml.Node | None = yaml.compose(text, Loader=loader)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        message = f"cannot be read as YAML: {', '.join(part for part in (error.context, error.problem) if part)}"
        fix = "indent with blanks, not with tabs" if "'\\t'" in message else None
        raise InputError(Problem(message, file, mark.line + 1 if mark else None, fix=fix)) from None
    except yaml.reader.ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        message = f"cannot be read as YAML: the character U+{ord(text[error.position]):04X} is not allowed"
        raise InputError(Problem(message, file, line)) from None
    return given(node, Problem("the file is empty", file))


def top_section(document: str | yaml.Node, file: str, known: Sequence[str]) -> "YamlSection":
    """Return the whole of a document, or of its text: a mapping with the keys ``known``.

    Raises:
        InputError: The text is no such document.
    """
    source = Source(file)
    top = source.section(compose(document, file) if isinstance(document, str) else document, "", known)
    if top is None:
        source.raise_if_any()
    return cast(YamlSection, top)


class Source(ProblemLog):
    """YAML file and the problems found in it so far."""

    units: Any = None
    """Units of its numbers, as the reader of the file knows them."""

    def report(self, node: yaml.Node | None, path: str, message: str, fix: str | None = None) -> None:
        """Add a problem of a node, or of the file where ``node`` is None."""
        self.add(message, None if node is None else node.start_mark.line + 1, path or None, fix)

    def section(self, node: yaml.Node, path: str, known: Sequence[str]) -> "YamlSection | None":
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

    def numbers(
        self,
        node: yaml.Node,
        path: str,
        count: int,
        kind: "Callable[[Source, yaml.Node, str], float | None] | None" = None,
    ) -> tuple[float, ...] | None:
        """Return ``count`` numbers of a kind (default: finite); report other values and return None."""
        if not isinstance(node, yaml.SequenceNode) or len(node.value) != count:
            self.report(node, path, f"expected a list of {count} numbers, found {describe(node)}")
            return None
        values = [(kind or Source.number)(self, item, f"{path}[{i}]") for i, item in enumerate(node.value)]
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


class YamlSection(NamedTuple):
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
            self.report(key, "is missing")
        return node

    def report(self, key: str, message: str, fix: str | None = None) -> None:
        """Add a problem of the value of a key, or of the mapping where the key is missing."""
        self.source.report(self.values.get(key, self.node), self.at(key), message, fix)

    def report_if(self, *cases: tuple[bool, str, str, str | None]) -> None:
        """Add the problem of each case that holds: whether it does, the key, the message, and how to repair it."""
        for holds, key, message, fix in cases:
            if holds:
                self.report(key, message, fix)

    def text(self, key: str, options: Collection[str] = (), *, needed: bool = False) -> str | None:
        """Return a line of text, one of ``options`` if there are any; report another value, and a missing one."""
        node = self.require(key) if needed else self.get(key)
        if node is None:
            return None
        source, path = self.source, self.at(key)
        return source.choice(node, path, tuple(options)) if options else source.text(node, path)

    def number(self, key: str, accepts: Callable[[float], bool], expected: str, default: float = math.nan) -> float:
        """Return a number that ``accepts`` takes; report another, and a missing one without a ``default``."""
        node = self.require(key) if math.isnan(default) else self.get(key)
        value = None if node is None else self.source.number(node, self.at(key))
        if value is not None and not accepts(value):
            self.report(key, f"found {value:g}, expected {expected}")
            value = None
        return default if value is None else value

    def sections(self, key: str, item_name: str, known: Sequence[str], if_empty: str) -> "list[YamlSection]":
        """Return the mappings of a list; report a missing or empty one, and items that are not mappings."""
        node = self.require(key)
        items = () if node is None else self.source.items(node, self.at(key), item_name)
        if isinstance(node, yaml.SequenceNode) and not items:
            self.report(key, if_empty)
        sections = (self.source.section(item, f"{self.at(key)}[{i}]", known) for i, item in enumerate(items))
        return [section for section in sections if section is not None]

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
    return "nothing" if is_null(node) else clip(str(node.value))


def nearest(name: str, known: Sequence[str]) -> str | None:
    """Return a question that suggests the nearest known name; None where none is near."""
    matches = difflib.get_close_matches(name.lower(), [candidate.lower() for candidate in known], 1, 0.6)
    suggestions = (candidate for candidate in known if matches and candidate.lower() == matches[0])
    return next((f"did you mean {candidate!r}?" for candidate in suggestions), None)


# Change values in the text of a document; comments, order, layout and unchanged values stay as they were written.
#
# The nodes know where they stand in the text, so a new value replaces the characters of the old value and nothing else.
# A library that reads and writes whole documents (ruamel.yaml) would set indentation and line breaks anew.


def edited(text: str, document: Mapping[str, Any], file: str, *, rewritten: Collection[str] = ()) -> str:
    """Return the text of a YAML file with the values of ``document``.

    A number keeps its text where it is the same to twelve digits. A key that only the file has stays. A key that the
    file does not have is added behind the key that precedes it in ``document``, unless its value is zero or empty,
    which is the default of the files of this package.

    Args:
        text: The file.
        document: Its new content.
        file: Its name, for messages.
        rewritten: Keys of the document whose values are written anew if more than numbers and additions changes, so
            that no key of the old value stays.

    Raises:
        InputError: The text is not YAML.
    """
    text = text.removeprefix("\ufeff")
    text = text if text.endswith("\n") else f"{text}\n"
    return spliced(text, _changes(text, compose(text, file), document, rewritten))


Edit = tuple[int, int, str]
"""First index of a span of the text, index behind its last, and new text."""


def _changes(text: str, node: yaml.Node, value: Any, rewritten: Collection[str]) -> Iterator[Edit]:
    """Yield the edits that change a value to another; keys ``rewritten`` of a mapping may be written anew."""
    if isinstance(node, yaml.MappingNode) and isinstance(value, Mapping):
        entries, place = {key.value: item for key, item in node.value}, None
        # New keys stand together behind the key that precedes them.
        for is_known, keys in itertools.groupby(value, entries.__contains__):
            if not is_known:
                added = [key for key in keys if not _is_zero(value[key])]
                column = node.start_mark.column
                items = [(_flow({key: value[key]})[1:-1], _entry(key, value[key], column)) for key in added]
                yield from _added(text, node, place, items)
                continue
            for key in keys:
                place = entries[key]
                is_new = key in rewritten and not _is_alike(place, value[key], longer=True)
                change = _changes(text, place, value[key], rewritten)
                yield from [_replaced(text, place, value[key])] if is_new else change
    elif _has_items_for(node, value):
        for item, new in zip(node.value, value, strict=False):
            yield from _changes(text, item, new, rewritten)
        column = node.start_mark.column + 2
        items = [(_flow(item), f"- {_block(item, column)}") for item in value[len(node.value) :]]
        yield from _added(text, node, node.value[-1] if node.value else None, items)
    elif not _is_same(node, value):
        yield _replaced(text, node, value)


def _replaced(text: str, node: yaml.Node, value: Any) -> Edit:
    """Return the edit that writes a value in place of a node."""
    start, end = node.start_mark.index, _end(text, node)
    if isinstance(node, yaml.ScalarNode) and is_null(node) and start == end:
        return start, end, f" {_flow(value)}"
    if not _is_block(node):
        return start, end, _flow(value)
    # A list may stand at the column of its key, where nothing else may stand.
    lead = 2 if isinstance(node, yaml.SequenceNode) else 0
    return start, end, " " * lead + _block(value, node.start_mark.column + lead)


def _added(text: str, node: yaml.Node, place: yaml.Node | None, items: Sequence[tuple[str, str]]) -> Iterator[Edit]:
    """Yield the edit that adds entries, each as text for one line and as lines, behind ``place`` or first."""
    if not items:
        return
    between = f"\n{' ' * node.start_mark.column}"
    if _is_block(node):
        lines = between.join(text for _, text in items)
        # Behind a comment in the last line of a value.
        start = node.start_mark.index if place is None else text.index("\n", _end(text, place))
        start -= place is not None and text[start - 1] == "\r"
        yield start, start, f"{lines}{between}" if place is None else f"{between}{lines}"
    else:
        start = node.start_mark.index + 1 if place is None else _end(text, place)
        entries = ", ".join(text for text, _ in items)
        yield start, start, f", {entries}" if place is not None else f"{entries}, " if node.value else entries


def _end(text: str, node: yaml.Node) -> int:
    """Return the index behind the last character of a node; the mark of a block is behind comments that follow."""
    if _is_block(node):
        last = node.value[-1]
        return _end(text, last[1] if isinstance(last, tuple) else last)
    end = node.end_mark.index
    return node.start_mark.index + len(text[node.start_mark.index : end].rstrip(" \t\r\n"))


def _is_block(node: yaml.Node) -> bool:
    """Return whether a node is a mapping or list by indentation, not by braces."""
    return isinstance(node, yaml.CollectionNode) and not node.flow_style and bool(node.value)


def _has_items_for(node: yaml.Node, value: Any) -> bool:
    """Return whether each item of a list has an item of the same kind (mapping, list, scalar) in ``value``."""
    if not isinstance(node, yaml.SequenceNode) or not isinstance(value, list) or len(value) < len(node.value):
        return False
    nodes_and_values = ((yaml.MappingNode, Mapping), (yaml.SequenceNode, list))
    return all(
        isinstance(item, of_node) is isinstance(new, of_value)
        for item, new in zip(node.value, value, strict=False)
        for of_node, of_value in nodes_and_values
    )


def _is_alike(node: yaml.Node, value: Any, longer: bool = False) -> bool:
    """Return whether a value differs from a node by numbers and added keys alone, or by more items where ``longer``."""
    if isinstance(node, yaml.MappingNode):
        return isinstance(value, Mapping) and all(
            key.value in value and _is_alike(item, value[key.value]) for key, item in node.value
        )
    if isinstance(node, yaml.SequenceNode):
        has_items = isinstance(value, list) and len(value) >= len(node.value) and all(map(_is_alike, node.value, value))
        return has_items and (longer or len(value) == len(node.value))
    return isinstance(value, float) or _is_same(node, value)


def _is_same(node: yaml.Node, value: Any) -> bool:
    """Return whether a scalar's text reads as the value, a number to twelve digits."""
    if not isinstance(node, yaml.ScalarNode):
        return False
    is_plain, text = not node.style, str(node.value)
    if value is None or isinstance(value, bool):
        return is_plain and text.lower() == {None: "null", True: "true", False: "false"}[value]
    if isinstance(value, int | float):
        try:
            return is_plain and significant(float(text)) == significant(float(value))
        except ValueError:
            return False
    return bool(text == value and (not is_plain or node.tag == "tag:yaml.org,2002:str"))


def _is_zero(value: Any) -> bool:
    """Return whether a value is zero throughout."""
    if isinstance(value, Mapping | list):
        return all(map(_is_zero, value.values() if isinstance(value, Mapping) else value))
    return isinstance(value, int | float) and not isinstance(value, bool) and value == 0


def _flow(value: Any) -> str:
    """Return a value as text in one line."""
    return _dumped(value, flow=True, width=math.inf)


def _block(value: Any, column: int) -> str:
    """Return a value as lines, the second and later ones indented."""
    # Characters of a line of new text.
    return re.sub(r"\n(?=.)", "\n" + " " * column, _dumped(value, flow=None, width=120 - column))


def _dumped(value: Any, flow: bool | None, width: float) -> str:
    text: str = yaml.safe_dump(value, sort_keys=False, default_flow_style=flow, allow_unicode=True, width=width)
    return text.removesuffix("\n").removesuffix("\n...")


def _entry(key: str, value: Any, column: int) -> str:
    """Return a key with its value, in the same line if it fits."""
    text, name = _block(value, column + 2), _flow({key: 0})[1:-4]
    is_block = isinstance(value, Mapping | list) and text[0] not in "[{"
    return f"{name}:\n{' ' * (column + 2)}{text}" if is_block else f"{name}: {text}"
