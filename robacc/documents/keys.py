"""Declarations of the keys of results: a key is stated once, and the document and its JSON Schema both come from it.

A :class:`Kind` says what a value is. A kind with ``keys`` is an object of the document, written from a record: each
:class:`Key` takes its value from the record's attribute of the same name without the unit, unless it says otherwise.
"""

from __future__ import annotations

import dataclasses
import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import chain
from types import NoneType
from typing import Any

_TYPES: dict[str, tuple[str, frozenset[type]]] = {
    "string": ("text", frozenset({str})),
    "number": ("a number", frozenset({int, float})),
    "integer": ("a whole number", frozenset({int})),
    "boolean": ("true or false", frozenset({bool})),
    "array": ("a list", frozenset({list})),
    "object": ("an object", frozenset({dict})),
}
"""Names for messages, and Python's types, of the types of JSON Schema."""
_UNIT = re.compile(r"_(m|rad)2?$")
Document = dict[str, Any]
_LIMITS = (("least", "minimum"), ("most", "maximum"))
LEFT_OUT: Any = object()
"""Value of a key that a document lacks."""


class Later(Mapping[str, Any]):
    """Object of a document whose values are computed when they are read: one column of many rows at a time."""

    def __init__(self, values: Mapping[str, Callable[[], Any]]) -> None:
        """Take the functions that compute the values."""
        self._values = values

    def __getitem__(self, key: str) -> Any:
        """Compute the value of a key."""
        return self._values[key]()

    def __iter__(self) -> Iterator[str]:
        """Return the keys in their order."""
        return iter(self._values)

    def __len__(self) -> int:
        """Return the number of keys."""
        return len(self._values)

    def map(self, function: Callable[[Any], Any]) -> Later:
        """Return the same object with ``function`` of each value."""
        return Later({key: partial(lambda value: function(value()), value) for key, value in self._values.items()})


@dataclass(frozen=True, slots=True)
class Kind:
    """Kind of a value of a document."""

    words: Mapping[str, Any] = field(default_factory=dict)
    """Words of JSON Schema: the type and its limits."""
    null: bool = False
    """Whether null may stand for a missing value."""
    items: Kind | None = None
    """Kind of the entries of a list, or of the values of an object with any keys."""
    keys: Mapping[str, Key] | None = None
    """Keys of an object, in their order in the document."""
    name: str = ""
    """Name of a part that several places share."""
    about: str = ""
    """Description of a shared part."""

    def __or__(self, other: None) -> Kind:
        """Return the kind of values that may be null."""
        return dataclasses.replace(self, null=True)

    def write(self, record: Any, **given: Any) -> Document:
        """Return the object of a record; ``given`` are values of keys that the record does not have.

        A record that is a mapping has its keys already.
        """
        entries, values = self.keys or {}, record
        if not isinstance(record, Mapping):
            values = {key: given[key] if key in given else entry.value(key, record) for key, entry in entries.items()}
        return {
            key: entries[key].kind.document(value) if key in entries else value
            for key, value in values.items()
            if value is not LEFT_OUT
        }

    def document(self, value: Any) -> Any:
        """Return a value as it stands in a document; values without keys stay as they are, arrays included."""
        if isinstance(value, Later | None) or (self.keys is None and (self.items is None or self.items.keys is None)):
            return value
        if self.items is None:
            return self.write(value)
        if isinstance(value, Mapping):
            return {key: self.items.document(item) for key, item in value.items()}
        return [self.items.document(item) for item in value]

    def problems(self, value: Any, path: str = "") -> Iterator[tuple[str, str]]:
        """Yield the path of every value of a parsed document that is not of the kind, and what was expected.

        Objects may lack keys, as those of earlier versions do, and have others.
        """
        if value is None and (self.null or not (self._types or "const" in self.words or "enum" in self.words)):
            return
        choices = [self.words["const"]] if "const" in self.words else self.words.get("enum", [value])
        if (self._types and type(value) not in self._accepted) or value not in choices:
            names = [_TYPES[name][0] for name in self._types] or map(str, choices)
            yield path, f"expected {' or '.join(names)}, found {shortened(value)}"
        elif isinstance(value, list):
            least, most = self.words.get("minItems") or 0, self.words.get("maxItems")
            if len(value) < least or (most is not None and len(value) > most):
                yield path, f"expected {f'{most} entries' if most else f'at least {least} entries'}, found {len(value)}"
            if self.items is not None and not self.items.fits_all(value):
                for i, item in enumerate(value):
                    yield from self.items.problems(item, f"{path}[{i}]")
        elif isinstance(value, dict):
            for key, item in value.items():
                kind = self.items if self.keys is None else self.keys[key].kind if key in self.keys else None
                if kind is not None:
                    yield from kind.problems(item, f"{path}.{key}".lstrip("."))
        elif value < self.words.get("minimum", value) or value > self.words.get("maximum", value):
            limits = (f"at {word} {self.words[name]}" for word, name in _LIMITS if name in self.words)
            yield path, f"expected a number of {' and '.join(limits)}, found {value}"

    def fits_all(self, values: Sequence[Any]) -> bool:
        """Return whether all values are of the kind by a fast test, which is only for lists of plain values."""
        is_typed = set(map(type, values)) <= self._accepted
        if self.items is None or not is_typed:
            return is_typed and self.words.keys() == {"type"}
        lengths = {self.words[name] for name in ("minItems", "maxItems") if name in self.words}
        is_list = set(map(type, values)) == {list} and (not lengths or set(map(len, values)) == lengths)
        return is_list and self.items.fits_all([*chain.from_iterable(values)])

    @property
    def _types(self) -> Sequence[str]:
        """Types of JSON Schema; none for any value."""
        names = self.words.get("type", () if self.keys is None else "object")
        return [names] if isinstance(names, str) else names

    @property
    def _accepted(self) -> frozenset[type]:
        """Types of Python that a value may have."""
        return frozenset({NoneType} if self.null else ()).union(*(_TYPES[name][1] for name in self._types))

    def schema(self, shared: dict[str, Document]) -> Document:
        """Return the JSON Schema of the kind; parts with a name are added to ``shared``."""
        words = dict(self.words)
        if self.items is not None:
            words["items" if words["type"] == "array" else "additionalProperties"] = self.items.schema(shared)
        if self.keys is not None:
            required = [key for key, entry in self.keys.items() if not entry.optional]
            properties = {key: entry.schema(shared) for key, entry in self.keys.items()}
            words = {"type": "object", "required": required, "properties": properties, **words}
        if self.name:
            shared[self.name] = ({"description": self.about} if self.about else {}) | words
            reference = {"$ref": f"#/$defs/{self.name}"}
            return {"anyOf": [reference, {"type": "null"}]} if self.null else reference
        if self.null and "enum" in words:
            words["enum"] = [*words["enum"], None]
        elif self.null:
            words["type"] = [*(words["type"] if isinstance(words["type"], list) else [words["type"]]), "null"]
        return words


@dataclass(frozen=True, slots=True)
class Key:
    """One key of an object of a document."""

    kind: Kind
    about: str = ""
    """Meaning, with the unit; a shared part may describe itself."""
    source: str | Callable[[Any], Any] | None = None
    """Attribute of the record by its dotted path, in which a missing owner has no value; the empty path is the record
    itself. Or a function of the record. None is the attribute with the key's name without its unit."""
    optional: bool = False
    """Whether a document may lack the key, as where its value is :data:`LEFT_OUT`."""

    def value(self, key: str, record: Any) -> Any:
        """Return the value of the key ``key`` for a record."""
        if callable(self.source):
            return self.source(record)
        path = _UNIT.sub("", key) if self.source is None else self.source
        for name in path.split(".") if path else ():
            record = None if record is None else getattr(record, name)
        return record

    def schema(self, shared: dict[str, Document]) -> Document:
        """Return the JSON Schema of the key's value."""
        return ({"description": self.about} if self.about else {}) | self.kind.schema(shared)


def shortened(value: Any) -> str:
    """Return a value as JSON, shortened for a message."""
    text = "nothing" if value is None else json.dumps(value, ensure_ascii=False)
    return text if len(text) <= 60 else f"{text[:57]}…"


def part(keys: Mapping[str, Key], name: str = "", about: str = "", *, has_others: bool = False) -> Kind:
    """Return the kind of objects with ``keys``, and with other keys if ``has_others``."""
    return Kind({"additionalProperties": True} if has_others else {}, keys=keys, name=name, about=about)


def within(path: str, keys: Mapping[str, Key]) -> dict[str, Key]:
    """Return keys whose record is the attribute ``path`` of the owner's record."""
    return {
        key: dataclasses.replace(entry, source=f"{path}.{entry.source or _UNIT.sub('', key)}")
        for key, entry in keys.items()
    }


def array(kind: Kind, length: int | None = None, least: int | None = None) -> Kind:
    """Return the kind of lists of ``length`` entries, of at least ``least`` entries, or of any number of entries."""
    limits = {"minItems": least if length is None else length, "maxItems": length}
    return Kind({"type": "array", **{word: limit for word, limit in limits.items() if limit is not None}}, items=kind)


def table(kind: Kind | None = None) -> Kind:
    """Return the kind of objects with any keys, whose values are of ``kind``."""
    return Kind({"type": "object"}, items=kind)


def choice(*values: Any) -> Kind:
    """Return the kind of a value from a list."""
    return Kind({"enum": list(values)})


def constant(value: Any) -> Kind:
    """Return the kind of one value."""
    return Kind({"const": value})


anything = Kind()
text = Kind({"type": "string"})
digest = Kind({"type": "string", "pattern": "^[0-9a-f]{64}$"})
flag = Kind({"type": "boolean"})
number = Kind({"type": "number"})
size = Kind({"type": "number", "minimum": 0})
share = Kind({"type": "number", "minimum": 0, "maximum": 1})
integer = Kind({"type": "integer"})
count = Kind({"type": "integer", "minimum": 0})
ordinal = Kind({"type": "integer", "minimum": 1})
vector3 = dataclasses.replace(array(number, 3), name="vector3")
rows3 = dataclasses.replace(array(array(number | None, 3)), name="rows3")
matrix3 = dataclasses.replace(array(vector3, 3), name="matrix3")
