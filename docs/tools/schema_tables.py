"""Schemas of results as tables: every key with its meaning; shared parts have tables of their own."""

from __future__ import annotations

import html
import json
import re
from collections.abc import Iterator
from typing import Any

from robacc.api.result import schema, schema_names

Schema = dict[str, Any]
_SHAPES = {"vector3": "[3]", "matrix3": "[3][3]", "rows3": "[n][3]"}
"""Shared parts that the tables show by their shape."""
_ORDER = ("estimate", "estimate-many", "predict", "calibrate", "trace", "iso9283", "compare", "check")


def results() -> str:
    """Return the keys of every result, a section for each result, and the shared parts."""
    names = (*_ORDER, *(name for name in schema_names() if name not in _ORDER))
    schemas = {name: _described(schema(name)) for name in names}
    first = schemas["estimate"]["properties"]
    every = ("schema", "robacc", "command", "options", "inputs", "seed", "gate")
    parts = ["## Every result", _table({key: first[key] for key in every}, every[:-1])]
    shared: dict[str, Schema] = {}
    for name, document in schemas.items():
        # The gate of a check is the result itself, not an optional part of it.
        shown = every[:-1] if name == "check" else every
        own = {key: value for key, value in document["properties"].items() if key not in shown}
        purpose = document["description"].split(" Lengths in m")[0]
        parts += [f"## {document['title']}", _prose(purpose), _table(own, document["required"])]
        shared |= document["$defs"]
    parts += ["## Shared parts", "Parts that several results or places use."]
    for name in sorted(set(shared) - set(_SHAPES)):
        part = shared[name]
        parts.append(f"### {_title(name)}")
        if "enum" in part:
            parts.append("One of " + ", ".join(f"`{value}`" for value in part["enum"]) + ".")
            continue
        parts += [_prose(part["description"]), _table(part["properties"], part["required"])]
    return "\n\n".join(parts)


def _described(document: Schema) -> Schema:
    """Return the schema with descriptions of shared parts copied to references without a description."""

    def described(value: Any) -> Any:
        if isinstance(value, list):
            return [described(item) for item in value]
        if not isinstance(value, dict):
            return value
        part = document["$defs"].get(value.get("$ref", "").rpartition("/")[2], {})
        known = {"description": part["description"]} if "description" in part else {}
        return known | {key: described(item) for key, item in value.items()}

    result: Schema = described(document)
    return result


def _table(properties: Schema, required: Any) -> str:
    rows = [f"| {key} | {kind} | {meaning} |" for key, kind, meaning in _rows(properties, required, "")]
    return "\n".join(["| key | value | meaning |", "| --- | --- | --- |", *rows])


def _rows(properties: Schema, required: Any, owner: str) -> Iterator[tuple[str, str, str]]:
    for key, part in properties.items():
        name, meaning = f"{owner}{key}", _prose(part.get("description", ""))
        if key not in required:
            meaning = f"{meaning} Optional."
        yield f"`{name}`", _kind(part), meaning.strip()
        inner, mark = part, "."
        while "items" in inner and "properties" not in inner:
            inner, mark = inner["items"], f"[]{mark}"
        if "properties" in inner:
            yield from _rows(inner["properties"], inner.get("required", ()), name + mark)


def _kind(part: Schema) -> str:
    """Return the type of a value as a word or a shape; shared parts as a link."""
    if "anyOf" in part:
        return " or ".join(_kind(choice) for choice in part["anyOf"])
    if "$ref" in part:
        name = part["$ref"].rpartition("/")[2]
        return _SHAPES.get(name) or f"[{_title(name)}](#{_title(name).lower().replace(' ', '-')})"
    if "const" in part:
        return f"`{json.dumps(part['const'])}`"
    if "enum" in part:
        return ", ".join(f"`{json.dumps(value)}`" for value in part["enum"])
    kinds = part.get("type", "anything")
    kinds = [kinds] if isinstance(kinds, str) else kinds
    return " or ".join(_list(part) if kind == "array" else kind for kind in kinds)


def _list(part: Schema) -> str:
    items = part.get("items", {})
    if "properties" in items or items.get("type") == "array":
        return "list"
    return f"list of {_kind(items)}"


def _title(name: str) -> str:
    return name.replace("_", " ").capitalize()


def _prose(text: str) -> str:
    return re.sub(r"([\\`*_\[\]|])", r"\\\1", html.escape(re.sub(r"\s+", " ", text), quote=False))
