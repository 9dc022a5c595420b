"""The section about reproducing a result: command line, version, and hashes of the inputs."""

from __future__ import annotations

import shlex
from collections.abc import Iterator

from robacc.render.html.blocks import Block, Command, Grid, ReportSection, Text
from robacc.render.plots.chart import Document

_SWITCHES = {"empirical": "--named-only", "robust": "--all-rows"}
"""Options that are on by default, with the flags that switch them off."""
_SEEDED = {"estimate", "predict", "calibrate", "trace", "iso9283", "plan"}
_FLAGS = {"purpose": "--for"}
"""Options whose flag has another name than the parameter."""
_REPEATED = {"outside", "half_space"}
"""Options that are given once for each value."""
_FIRST = {"predict": "robot", "plan": "robot"}
"""Kind of the input that follows the command's name; poses for the others."""


def reproduce(document: Document) -> ReportSection:
    """Return the last section of a result."""
    blocks: list[Block] = [
        Text(
            f"Made by robacc {document['robacc']} (schema {document['schema']}). On one machine the same call on the "
            "same files gives the same bytes."
        ),
        Command(command_line(document)),
    ]
    if document["inputs"]:
        rows = [[record["kind"], record["name"], record["sha256"]] for record in document["inputs"]]
        blocks.append(Grid(("input", "file", "SHA-256"), rows, is_text=True))
    return ReportSection("How to reproduce this result", blocks)


def command_line(document: Document) -> str:
    """Return the command line from the options and inputs of the result; files by name without folders."""
    arguments = ["robacc", document["command"]]
    files = {record["kind"]: record["name"] for record in reversed(document["inputs"])}
    first = _FIRST.get(document["command"], "poses")
    arguments += [record["name"] for record in document["inputs"] if record["kind"] in (first, "result")]
    for kind, name in files.items():
        if kind not in (first, "result"):
            arguments += [f"--{kind}", name]
    arguments += _options(document, set(files))
    arguments += _reading(document)
    if document["seed"] is not None and document["command"] in _SEEDED:
        arguments += ["--seed", str(document["seed"])]
    return " ".join(shlex.quote(argument) for argument in arguments)


def _reading(document: Document) -> Iterator[str]:
    """Yield the options that were stated on the names of the poses' file."""
    stated: dict[str, object] = next((record["reading"] for record in document["inputs"] if "reading" in record), {})
    for name, value in stated.items():
        if name == "commanded_sha256":
            continue
        yield f"--{name.replace('_', '-')}"
        if value is not True:
            yield "columns.yaml" if name == "columns" else f"{value}"


def _options(document: Document, files: set[str]) -> Iterator[str]:
    for name, value in document["options"].items():
        flag = _FLAGS.get(name, f"--{name.replace('_', '-')}")
        if name in files or value is None or value == [] or value == "":
            continue
        if name in _SWITCHES:
            if value is False:
                yield _SWITCHES[name]
        elif name in _REPEATED:
            for each in value:
                yield from (flag, str(each))
        elif value is True:
            yield flag
        elif value is not False:
            yield flag
            yield ",".join(map(str, value)) if isinstance(value, list) else f"{value}"
