"""JSON Schemas of the results, made from the declarations of their keys."""

from __future__ import annotations

from importlib import import_module
from typing import Any

from robacc.documents.envelope import schema_version
from robacc.documents.keys import Key, Kind, array, constant, count, part, table, text
from robacc.documents.parts import INPUT

MODULES = {
    "calibrate": "fit",
    "check": "gate",
    "compare": "compare",
    "compare-paired": "compare",
    "correct": "correct",
    "effects": "descriptions",
    "estimate": "estimate",
    "estimate-many": "estimate",
    "export": "export",
    "iso9283": "iso9283",
    "iso9283-poses": "iso9283",
    "plan": "plan",
    "predict": "predict",
    "robots": "descriptions",
    "show": "descriptions",
    "simulate": "descriptions",
    "trace": "fit",
}
"""Module of :mod:`robacc.documents` that declares a result, by the result's name, which is the declaration's too."""


def result_kind(name: str) -> Kind:
    """Return the declaration of a result: its envelope, then its own keys, of which an unknown command has none."""
    own = part({})
    if name in MODULES:
        own = getattr(import_module(f"robacc.documents.{MODULES[name]}"), name.upper().replace("-", "_"))
    envelope = {
        "schema": Key(constant(f"robacc.{name}/{schema_version(name)}"), "Name and version of this schema."),
        "robacc": Key(text, "Version of robacc that made the result."),
        "command": Key(constant(name), "Command that made the result."),
        "options": Key(table(), "Options that the figures depend on, by their names on the command line with _ for -."),
        "inputs": Key(array(INPUT), "Every input file."),
        "seed": Key(count | None, "Seed of all random numbers; null if there are none."),
    }
    return part({**envelope, **(own.keys or {})}, about=own.about)


def result_schema(name: str) -> dict[str, Any]:
    """Return the JSON Schema (draft 2020-12) of a result."""
    kind, version = result_kind(name), schema_version(name)
    shared: dict[str, Any] = {}
    schema = kind.schema(shared)
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": f"urn:robacc:schema:{name}:{version}",
        "title": f"robacc.{name}/{version}",
        "description": f"{kind.about} Lengths in m, angles in rad; missing numbers are null. Keys may be added.",
        **schema,
        "$defs": shared,
    }
