"""Results as HTML: a page of one or of several side by side, and a few lines for a notebook."""

from __future__ import annotations

import gzip
import hashlib
import json
import re
import shlex
from base64 import b64encode
from collections.abc import Iterator, Mapping, Sequence
from html import escape
from itertools import chain
from types import MappingProxyType
from typing import Any

from robacc.render.plots.canvas import DARK, LIGHT, as_part, css_variables, need
from robacc.render.plots.catalogue import charts_of
from robacc.render.text.layout import Document
from robacc.render.text.parameter_names import as_options
from robacc.render.views.elements import Cell, Grid, Listing, ReportHeadline, Section, Text, shown
from robacc.render.views.gate import gate_section
from robacc.render.views.results import headline_of, sections_of
from robacc.robots.description import IDENTITY
from robacc.version import __version__

# A result in a few lines for a notebook or a Python shell; no library is needed.


def notebook_html(document: Document) -> str:
    """Return the headline of a result as HTML: title, summary, key figures and facts."""
    headline = headline_of(document)
    badges = "".join(f" <small>[{escape(text)}]</small>" for text, _ in headline.badges)
    cells = "".join(
        f"<tr><th style='text-align:left'>{escape(label)}</th><td style='text-align:left'>{escape(value)}</td>"
        f"<td style='text-align:left'>{escape(note)}</td></tr>"
        for label, value, note in _figures(headline)
    )
    return (
        f"<div><strong>{escape(headline.title)}</strong>{badges}<p>{escape(headline.summary)}</p>"
        f"<table>{cells}</table></div>"
    )


def notebook_text(document: Document) -> str:
    """Return the headline of a result as lines of text."""
    headline = headline_of(document)
    title = " ".join((headline.title, *(f"[{text}]" for text, _ in headline.badges)))
    rows = [(label, "  ".join(filter(None, texts))) for label, *texts in _figures(headline)]
    return "\n".join((title, headline.summary, *(line for line, _ in Grid(("", ""), rows, left=(0, 1)).lines(0))))


def _figures(headline: ReportHeadline) -> list[tuple[str, str, str]]:
    """Return label, value and interval of each figure, then the facts."""
    tiles = ((tile.label, str(tile.value), tile.interval) for tile in headline.tiles)
    return [*tiles, *((name, text, "") for name, text in headline.facts)]


# Rows of a page that say what was tested, as the robot file of a result or the user of the page states it.


def identity_rows(
    documents: Sequence[Document], names: Sequence[str], identity: Mapping[str, str]
) -> list[tuple[str, str]]:
    """Return labels and texts in the order of the page; a text of ``identity`` replaces those of the results.

    Different texts, such as the serial numbers of two arms, stand side by side with the names of the results; those
    of two files of one result with the names of the files.
    """
    rows = []
    for key, label in IDENTITY.items():
        texts = list(_stated(documents, names, key)) if key not in identity else [("", identity[key])]
        distinct = list(dict.fromkeys(text for _, text in texts))
        if distinct:
            many = "; ".join(f"{name}: {text}" for name, text in texts)
            rows.append((label, distinct[0] if len(distinct) == 1 else many))
    return rows


def _stated(documents: Sequence[Document], names: Sequence[str], key: str) -> Iterator[tuple[str, str]]:
    """Yield the name of each result whose robot files state ``key``, and its text.

    Where the robot files of a result state different texts, the name of each file stands in place of the result's, or
    behind it if there are several results.
    """
    for name, document in zip(names, documents, strict=True):
        files = [file for file in document["inputs"] if key in file.get("identity", ())]
        texts = [file["identity"][key] for file in files]
        if len(set(texts)) > 1:
            lead = f"{name}, " if len(documents) > 1 else ""
            yield from ((f"{lead}{file['name']}", text) for file, text in zip(files, texts, strict=True))
        elif texts:
            yield name, texts[0]


# The section about reproducing a result: command line, version, and hashes of the inputs.

_SWITCHES = {"empirical": "--named-only", "robust": "--all-rows"}
"""Options that are on by default, with the flags that switch them off."""
_SEEDED = {"estimate", "predict", "calibrate", "trace", "iso9283", "plan"}
_FLAGS = {"purpose": "--for"}
"""Options whose flag has another name than the parameter."""
_REPEATED = {"outside", "half_space"}
"""Options that are given once for each value."""
_FIRST = {"predict": "robot", "plan": "robot"}
"""Kind of the input that follows the command's name; poses for the others."""


def reproduce(document: Document) -> Section:
    """Return the last section of a result."""
    rows = [(record["kind"], record["name"], record["sha256"]) for record in document["inputs"]]
    origin = Text(
        f"Made by robacc {document['robacc']} (schema {document['schema']}). On one machine the same call on the same "
        "files gives the same bytes."
    )
    command = Text(command_line(document), kind="command")
    return Section(
        "How to reproduce this result", [origin, command, Grid(("input", "file", "SHA-256"), rows, is_text=True)]
    )


def command_line(document: Document) -> str:
    """Return the command line from the options and inputs of the result; files by name without folders."""
    files = {record["kind"]: record["name"] for record in reversed(document["inputs"])}
    leading = (_FIRST.get(document["command"], "poses"), "result")
    arguments = ["robacc", document["command"]]
    arguments += [record["name"] for record in document["inputs"] if record["kind"] in leading]
    for kind, name in files.items():
        arguments += [] if kind in leading else [f"--{kind}", name]
    arguments += (*_options(document, set(files)), *_reading(document))
    if document["seed"] is not None and document["command"] in _SEEDED:
        arguments += ["--seed", str(document["seed"])]
    return " ".join(shlex.quote(argument) for argument in arguments)


def _reading(document: Document) -> Iterator[str]:
    """Yield the options that were stated on the names of the poses' file."""
    stated: dict[str, object] = next((record["reading"] for record in document["inputs"] if "reading" in record), {})
    for name, value in stated.items():
        if name != "commanded_sha256":
            yield f"--{name.replace('_', '-')}"
            yield from () if value is True else ("columns.yaml" if name == "columns" else f"{value}",)


def _options(document: Document, files: set[str]) -> Iterator[str]:
    for name, value in document["options"].items():
        flag = _FLAGS.get(name, f"--{name.replace('_', '-')}")
        if name in files or value in (None, [], ""):
            continue
        if name in _SWITCHES:
            words = [] if value else [_SWITCHES[name]]
        elif isinstance(value, bool):
            words = [flag] * value
        elif name in _REPEATED:
            words = [word for each in value for word in (flag, str(each))]
        else:
            words = [flag, ",".join(map(str, value)) if isinstance(value, list) else f"{value}"]
        yield from words


# Several results in one table, one column per result.

_SAME = ("poses", "robot", "holdout")


def side_by_side(documents: Sequence[Document], headlines: Sequence[ReportHeadline], names: Sequence[str]) -> Section:
    """Return outcome, key figures and facts of each result, with warnings about different inputs."""
    rows: dict[str, Sequence[Cell]] = {
        "command": [str(document["command"]) for document in documents],
        "outcome": [", ".join(text for text, _ in headline.badges) or "–" for headline in headlines],
    }
    for figures in (
        [{tile.label: tile.value for tile in headline.tiles} for headline in headlines],
        [dict(headline.facts) for headline in headlines],
    ):
        rows |= {label: [own.get(label, "–") for own in figures] for label in chain.from_iterable(figures)}
    rows["made by"] = [f"robacc {document['robacc']}" for document in documents]
    rows["call"] = [command_line(document) for document in documents]
    warnings = [
        f"the results were not made from the same {kind} file"
        for kind in _SAME
        if len({tuple(each["sha256"] for each in made["inputs"] if each["kind"] == kind) for made in documents}) > 1
    ]
    if len({document["robacc"] for document in documents}) > 1:
        warnings.append("the results were made by different versions of robacc")
    table = Grid(("", *names), [(label, *cells) for label, cells in rows.items()], is_text=True)
    (section,) = shown([Section("Side by side", [table, Listing(warnings, "warning")])])
    return section


def render(
    documents: Sequence[Document], names: Sequence[str], identity: Mapping[str, str] = MappingProxyType({})
) -> str:
    """Return the page of results from their JSON documents.

    Args:
        documents: One document per result.
        names: Labels of the results, used if there are several.
        identity: Texts by the keys of an identity; they replace those of the results.

    Raises:
        UsageError: the extra ``report`` is not installed.
    """
    results = [result_of(document, number) for number, document in enumerate(documents, 1)]
    return page_of(results, documents, names, identity)


def page_of(
    results: Sequence[Mapping[str, Any]],
    documents: Sequence[Document],
    names: Sequence[str],
    identity: Mapping[str, str] = MappingProxyType({}),
) -> str:
    """Return the page of results that :func:`result_of` has laid out."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    interactive = any(chart["scene"] for result in results for chart in result["charts"])
    loader = PackageLoader("robacc.render.html")
    environment = Environment(
        loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters |= {"options": as_options, "minus": _with_minus_signs}
    library = script = ""
    if interactive:
        from plotly.offline import get_plotlyjs

        library, script = get_plotlyjs(), environment.get_template("scenes.js").render()
    is_multiple = len(results) > 1
    return environment.get_template("page.html").render(
        title=f"{len(results)} results side by side" if is_multiple else results[0]["headline"].title,
        results=results,
        names=names,
        identity=identity_rows(documents, names, identity),
        overview=side_by_side(documents, [result["headline"] for result in results], names) if is_multiple else None,
        library=b64encode(gzip.compress(library.encode(), 6, mtime=0)).decode() if interactive else "",
        script=script,
        policy=_policy([library, script] if interactive else []),
        version=__version__,
        light=css_variables(LIGHT),
        dark=css_variables(DARK),
    )


def _with_minus_signs(text: str) -> str:
    """Return the text with minus signs, which are as wide as a digit, for the hyphens of numbers."""
    return re.sub(r"(?<![\w.:/-])-(?=\d)|(?<=\de)-(?=\d)", "−", text)


def result_of(document: Document, place: int) -> dict[str, Any]:
    """Return the parts of one result as the templates take them, the ``place``-th of its page.

    Raises:
        UsageError: the extra ``report`` is not installed.
    """
    need("matplotlib", "plotly", "jinja2")
    number = f"r{place}"
    warnings = [*dict.fromkeys(document.get("warnings", ()))]
    if lines := [str(outlier["line"]) for outlier in document.get("outliers", ())]:
        others = f" and {len(lines) - 20} more" if len(lines) > 20 else ""
        warnings.append(f"excluded as outliers: line(s) {', '.join(lines[:20])}{others}")
    lists = [Listing(warnings, "warning"), Listing([*document.get("notes", ()), *document.get("input_notes", ())])]
    return {
        "id": number,
        "headline": headline_of(document),
        "charts": [
            {
                "id": f"{number}p{i}",
                "chart": chart,
                "svg": as_part(chart.draw, chart.size, f"{number}p{i}"),
                "scene": None if chart.scene is None else script_json(chart.scene),
                "starts": chart.kind in ("poses", "corrections", "planned-poses"),
            }
            for i, chart in enumerate(charts_of(document), 1)
        ],
        "sections": sections_of(document),
        "leading": [*shown((*gate_section(document), Section("Warnings and notes", lists)))],
        "how": reproduce(document),
    }


def script_json(value: Any) -> str:
    """Return JSON that cannot end a script element, whatever its strings contain."""
    text = json.dumps(value, ensure_ascii=False, separators=(",", ":"), allow_nan=False)
    return re.sub("[<>&\u2028\u2029]", lambda sign: f"\\u{ord(sign[0]):04x}", text)


def _policy(scripts: Sequence[str]) -> str:
    """Return the content security policy: only the page's own scripts, no network."""
    hashes = [f"'sha256-{b64encode(hashlib.sha256(text.encode()).digest()).decode()}'" for text in scripts]
    allowed = " ".join(hashes) if hashes else "'none'"
    return (
        f"default-src 'none'; script-src {allowed}; style-src 'unsafe-inline'; img-src data: blob:; "
        "base-uri 'none'; form-action 'none'"
    )
