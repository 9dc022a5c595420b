"""Change values in the text of a YAML file; comments, order, layout and unchanged values stay as they were written.

The nodes of the document know where they stand in the text, so a new value replaces the characters of the old value and
nothing else. A library that reads and writes whole documents (ruamel.yaml) would set indentation and line breaks anew.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import yaml

from robacc.io.yaml_nodes import compose, is_null
from robacc.quantities import significant

_WIDTH = 120
"""Characters of a line of new text."""


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
    edits = _Edits(text, rewritten)
    edits.mapping(compose(text, file), document)
    return edits.applied()


@dataclass
class _Edits:
    """Replacements of spans of a text: first index, index behind the last, new text."""

    text: str
    rewritten: Collection[str] = ()
    spans: list[tuple[int, int, str]] = field(default_factory=list)

    def applied(self) -> str:
        """Return the text with all replacements."""
        pieces, position = [], 0
        for start, end, new in sorted(self.spans, key=lambda span: span[:2]):
            pieces += [self.text[position:start], new]
            position = end
        return "".join((*pieces, self.text[position:]))

    def value(self, node: yaml.Node, value: Any) -> None:
        """Change a value to another."""
        if isinstance(node, yaml.MappingNode) and isinstance(value, Mapping):
            self.mapping(node, value)
        elif _has_items_for(node, value):
            for item, new in zip(node.value, value, strict=False):
                self.value(item, new)
            self.append(node, value[len(node.value) :])
        elif not _is_same(node, value):
            self.replace(node, value)

    def mapping(self, node: yaml.Node, document: Mapping[str, Any]) -> None:
        """Change the values of a mapping, and add keys."""
        entries = {key.value: (key, value) for key, value in node.value}
        place: yaml.Node | None = None
        for key, value in document.items():
            if key in entries:
                place = entries[key][1]
                is_new = key in self.rewritten and not (_is_alike(place, value) or _is_extended(place, value))
                (self.replace if is_new else self.value)(place, value)
            elif not _is_zero(value):
                self.insert(node, place, key, value)

    def replace(self, node: yaml.Node, value: Any) -> None:
        """Write a value in place of a node."""
        start, end = node.start_mark.index, self.end(node)
        if isinstance(node, yaml.ScalarNode) and is_null(node) and start == end:
            self.spans.append((start, end, f" {_flow(value)}"))
        elif _is_block(node):
            # A list may stand at the column of its key, where nothing else may stand.
            lead = 2 if isinstance(node, yaml.SequenceNode) else 0
            self.spans.append((start, end, " " * lead + _block(value, node.start_mark.column + lead)))
        else:
            self.spans.append((start, end, _flow(value)))

    def insert(self, node: yaml.Node, place: yaml.Node | None, key: str, value: Any) -> None:
        """Add a key behind the value ``place``, or in front of all."""
        if not _is_block(node):
            start = node.start_mark.index + 1 if place is None else self.end(place)
            item = _flow({key: value})[1:-1]
            if place is not None or any(span[0] == start for span in self.spans if not node.value):
                self.spans.append((start, start, f", {item}"))
            else:
                self.spans.append((start, start, f"{item}, " if node.value else item))
            return
        column = node.start_mark.column
        if place is None:
            start = node.start_mark.index
            self.spans.append((start, start, f"{_entry(key, value, column)}\n{' ' * column}"))
            return
        start = self.end_of_line(place)
        self.spans.append((start, start, f"\n{' ' * column}{_entry(key, value, column)}"))

    def append(self, node: yaml.Node, items: Sequence[Any]) -> None:
        """Add items at the end of a list."""
        if not items:
            return
        if not _is_block(node):
            start = self.end(node.value[-1]) if node.value else node.start_mark.index + 1
            lead = ", " if node.value else ""
            self.spans.append((start, start, lead + ", ".join(map(_flow, items))))
            return
        start, column = self.end_of_line(node.value[-1]), node.start_mark.column
        added = "".join(f"\n{' ' * column}- {_block(item, column + 2)}" for item in items)
        self.spans.append((start, start, added))

    def end(self, node: yaml.Node) -> int:
        """Return the index behind the last character of a node; the mark of a block is behind comments that follow."""
        if _is_block(node):
            last = node.value[-1]
            return self.end(last[1] if isinstance(last, tuple) else last)
        end = node.end_mark.index
        while end > node.start_mark.index and self.text[end - 1] in " \t\r\n":
            end -= 1
        return int(end)

    def end_of_line(self, node: yaml.Node) -> int:
        """Return the index of the end of a node's last line, behind a comment in that line."""
        end = self.text.index("\n", self.end(node))
        return end - 1 if self.text[end - 1] == "\r" else end


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


def _is_extended(node: yaml.Node, value: Any) -> bool:
    """Return whether a list has the items of the node, with other numbers, and possibly more items."""
    return (
        isinstance(node, yaml.SequenceNode)
        and isinstance(value, list)
        and len(value) >= len(node.value)
        and all(map(_is_alike, node.value, value))
    )


def _is_alike(node: yaml.Node, value: Any) -> bool:
    """Return whether a value differs from a node by numbers and added keys alone."""
    if isinstance(node, yaml.MappingNode):
        return isinstance(value, Mapping) and all(
            key.value in value and _is_alike(item, value[key.value]) for key, item in node.value
        )
    if isinstance(node, yaml.SequenceNode):
        return isinstance(value, list) and len(value) == len(node.value) and all(map(_is_alike, node.value, value))
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
    if isinstance(value, Mapping):
        return all(map(_is_zero, value.values()))
    if isinstance(value, list):
        return all(map(_is_zero, value))
    return isinstance(value, int | float) and not isinstance(value, bool) and value == 0


def _flow(value: Any) -> str:
    """Return a value as text in one line."""
    return _dumped(value, flow=True, width=math.inf)


def _block(value: Any, column: int) -> str:
    """Return a value as lines, the second and later ones indented."""
    return re.sub(r"\n(?=.)", "\n" + " " * column, _dumped(value, flow=None, width=_WIDTH - column))


def _dumped(value: Any, flow: bool | None, width: float) -> str:
    text: str = yaml.safe_dump(value, sort_keys=False, default_flow_style=flow, allow_unicode=True, width=width)
    return text.removesuffix("\n").removesuffix("\n...")


def _entry(key: str, value: Any, column: int) -> str:
    """Return a key with its value, in the same line if it fits."""
    text, name = _block(value, column + 2), _flow({key: 0})[1:-4]
    is_block = isinstance(value, Mapping | list) and text[0] not in "[{"
    return f"{name}:\n{' ' * (column + 2)}{text}" if is_block else f"{name}: {text}"
