"""How a result can be made again: the command line, the version, and the hashes of what went in."""

from __future__ import annotations

import shlex
from collections.abc import Iterator

from robacc.render.html.blocks import Block, Command, Grid, ReportSection, Text
from robacc.render.plots.chart import Document

_SWITCHES = {"empirical": "--named-only", "robust": "--all-rows"}
"""Options that are on unless this says otherwise."""
_SEEDED = {"estimate", "predict", "calibrate", "trace", "iso9283"}


def reproduce(document: Document) -> ReportSection:
    """The last part of every result."""
    blocks: list[Block] = [
        Text(
            f"Made by robacc {document['robacc']} (schema {document['schema']}). On one machine the same call on the "
            "same files gives the same bytes."
        ),
        Command(command_line(document)),
    ]
    if document["inputs"]:
        rows = [[record["kind"], record["name"], record["sha256"]] for record in document["inputs"]]
        blocks.append(Grid(("input", "file", "SHA-256"), rows, words=True))
    return ReportSection("How to reproduce it", blocks)


def command_line(document: Document) -> str:
    """The call, from the options and inputs that the result carries; files by their names without folders."""
    words = ["robacc", document["command"]]
    files = {record["kind"]: record["name"] for record in reversed(document["inputs"])}
    first = "robot" if document["command"] == "predict" else "poses"
    words += [record["name"] for record in document["inputs"] if record["kind"] in (first, "result")]
    for kind, name in files.items():
        if kind not in (first, "result"):
            words += [f"--{kind}", name]
    words += _options(document, set(files))
    if document["seed"] is not None and document["command"] in _SEEDED:
        words += ["--seed", str(document["seed"])]
    return " ".join(shlex.quote(word) for word in words)


def _options(document: Document, files: set[str]) -> Iterator[str]:
    for name, value in document["options"].items():
        flag = f"--{name.replace('_', '-')}"
        if name in files or value is None or value == [] or value == "":
            continue
        if name in _SWITCHES:
            if value is False:
                yield _SWITCHES[name]
        elif value is True:
            yield flag
        elif value is not False:
            yield flag
            yield ",".join(map(str, value)) if isinstance(value, list) else f"{value}"
