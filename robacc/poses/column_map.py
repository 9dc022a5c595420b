"""Column maps: YAML files that say which column of an export is which, and what its names leave open.

robacc_columns: 1
angles: fixed-xyz
units: mm,deg
columns:
  "A1 [°]": q1_deg
  "X [mm]": x_mm
  Comment:                       # not read
"""

from __future__ import annotations

import os
from typing import Any

import yaml

from robacc.io.files import read_text
from robacc.io.yaml_nodes import Source, YamlSection, compose, describe, is_null
from robacc.poses.angles import CONVENTIONS
from robacc.poses.columns import FIXED_KINDS, UNITS, is_documented, time_column
from robacc.poses.headings import TIME_KEYS

_VERSION = "1"
OPEN = "unknown"
"""Entry of a statement that the user has to fill in; a command refuses it."""
_KEYS = ("robacc_columns", "angles", "units", "coverage", "sheet", "bag", "columns")


def read_column_map(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Return the statements of a column map by their names in :class:`~robacc.poses.reading.Reading`.

    Raises:
        InputError: The file cannot be read, or has problems; with every problem, its line and key.
    """
    name = os.fspath(path)
    source = Source(name)
    top = source.section(compose(read_text(name), name), "", _KEYS)
    result: dict[str, Any] = {}
    if top is not None:
        version = top.require("robacc_columns")
        if version is not None and getattr(version, "value", None) != _VERSION:
            source.report(version, "robacc_columns", f"expected {_VERSION}, found {describe(version)}")
        if (node := top.get("angles")) is not None:
            result["angles"] = source.choice(node, "angles", tuple(CONVENTIONS))
        for key in ("units", "sheet", "bag"):
            if (node := top.get(key)) is not None:
                result[key] = source.text(node, key)
        if result.get("units") == OPEN:
            source.report(top.get("units"), "units", "is not filled in", "for example mm,deg")
        if (node := top.get("coverage")) is not None:
            result["coverage"] = source.number(node, "coverage")
        result["columns"] = _columns(top)
    source.finish()
    return result


def _columns(top: YamlSection) -> dict[str, str | None] | None:
    node = top.get("columns")
    if node is None:
        return None
    source = top.source
    if not isinstance(node, yaml.MappingNode):
        source.report(node, "columns", f"expected names with documented names, found {describe(node)}")
        return None
    result: dict[str, str | None] = {}
    for name, _, value in source.entries(node, "columns"):
        result[name] = None if is_null(value) else source.text(value, f"columns.{name}")
        meaning = result[name]
        if meaning is not None and not is_documented(meaning) and time_column(meaning, 0) is None:
            import difflib

            known = [*FIXED_KINDS, *TIME_KEYS, *(f"q{i}" for i in range(1, 8))]
            known += [f"{key}_{unit}" for key in known for unit in UNITS]
            nearest = difflib.get_close_matches(meaning.lower(), known, n=1, cutoff=0.0)[0]
            source.report(
                value, f"columns.{name}", f"expected a documented name, found {meaning!r}", f"did you mean {nearest}?"
            )
    return result
