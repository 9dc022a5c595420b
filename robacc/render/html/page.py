"""The HTML page of one result or of several results side by side."""

from __future__ import annotations

import gzip
import hashlib
import json
from base64 import b64encode
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from robacc.render.html.blocks import Listing, ReportHeadline, ReportSection
from robacc.render.html.compare_sections import compare_sections
from robacc.render.html.correct_sections import correct_sections
from robacc.render.html.estimate_sections import estimate_sections
from robacc.render.html.fit_sections import fit_sections, outliers
from robacc.render.html.gate_section import gate_section
from robacc.render.html.headline import headline_of
from robacc.render.html.identity import identity_rows
from robacc.render.html.iso9283_sections import iso9283_sections
from robacc.render.html.plan_sections import plan_sections
from robacc.render.html.predict_sections import predict_sections
from robacc.render.html.reproduce import reproduce
from robacc.render.html.side_by_side import side_by_side
from robacc.render.plots.canvas import as_part
from robacc.render.plots.catalogue import charts_of
from robacc.render.plots.chart import Chart, ChartTable, Document
from robacc.render.plots.optional_dependencies import need
from robacc.render.plots.palette import DARK, LIGHT, css_variables
from robacc.render.text.parameter_names import as_options
from robacc.version import __version__

_SECTIONS: dict[str, Callable[[Document], Iterator[ReportSection]]] = {
    "trace": fit_sections,
    "calibrate": fit_sections,
    "estimate": estimate_sections,
    "predict": predict_sections,
    "iso9283": iso9283_sections,
    "compare": compare_sections,
    "correct": correct_sections,
    "plan": plan_sections,
}


@dataclass(frozen=True, slots=True)
class PageChart:
    """A chart laid out for the page."""

    id: str
    title: str
    caption: str
    alt: str
    svg: str
    table: ChartTable
    scene: str | None
    """JSON of its view in three dimensions, safe within a script element."""
    note: str
    starts: bool
    """True if the page opens with the interactive 3-D view of this chart."""


@dataclass(frozen=True, slots=True)
class ResultSection:
    """One result laid out for the page."""

    id: str
    headline: ReportHeadline
    first: PageChart | None
    """Next to the headline."""
    drawings: Sequence[PageChart]
    sections: Sequence[ReportSection]
    """The command's tables and texts."""
    leading: Sequence[ReportSection]
    """Sections that come first: the gate, warnings and notes."""
    reproduce: ReportSection


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
    results: Sequence[ResultSection],
    documents: Sequence[Document],
    names: Sequence[str],
    identity: Mapping[str, str] = MappingProxyType({}),
) -> str:
    """Return the page of results that :func:`result_of` has laid out."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    interactive = any(drawing.scene for result in results for drawing in _all(result))
    loader = PackageLoader("robacc.render.html")
    environment = Environment(
        loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.filters["options"] = as_options
    library = _library() if interactive else ""
    script = environment.get_template("scenes.js").render() if interactive else ""
    is_multiple = len(results) > 1
    return environment.get_template("page.html").render(
        title=f"{len(results)} results side by side" if is_multiple else results[0].headline.title,
        results=results,
        names=names,
        identity=identity_rows(documents, names, identity),
        overview=side_by_side(documents, [result.headline for result in results], names) if is_multiple else None,
        library=b64encode(gzip.compress(library.encode(), 6, mtime=0)).decode() if interactive else "",
        script=script,
        policy=_policy([library, script] if interactive else []),
        version=__version__,
        light=css_variables(LIGHT),
        dark=css_variables(DARK),
    )


def result_of(document: Document, place: int) -> ResultSection:
    """Return one result laid out, the ``place``-th of its page.

    Raises:
        UsageError: the extra ``report`` is not installed.
    """
    need("matplotlib", "plotly", "jinja2")
    number = f"r{place}"
    drawings = [_drawing(chart, f"{number}p{i}") for i, chart in enumerate(charts_of(document), 1)]
    gate = gate_section(document)
    sections = _SECTIONS.get(document["command"], _nothing)(document)
    warnings = [*dict.fromkeys([*document.get("warnings", ()), *outliers(document)])]
    notes = list(document.get("notes", ()))
    blocks = [*([Listing(warnings, "warning")] if warnings else []), *([Listing(notes)] if notes else [])]
    return ResultSection(
        number,
        headline_of(document),
        drawings[0] if drawings else None,
        drawings[1:],
        [*sections],
        [*([gate] if gate is not None else []), *([ReportSection("Warnings and notes", blocks)] if blocks else [])],
        reproduce(document),
    )


def _nothing(document: Document) -> Iterator[ReportSection]:
    return iter(())


def _all(result: ResultSection) -> Iterator[PageChart]:
    if result.first is not None:
        yield result.first
    yield from result.drawings


def _drawing(chart: Chart, number: str) -> PageChart:
    scene = chart.scene
    return PageChart(
        number,
        chart.title,
        chart.caption,
        chart.alt,
        as_part(chart.draw, chart.size, number),
        chart.table,
        None if scene is None else script_json({"traces": scene.traces, "axes": scene.axes}),
        "" if scene is None else scene.note,
        chart.kind in ("poses", "corrections", "planned-poses"),
    )


def script_json(value: Any) -> str:
    """Return JSON that cannot end a script element, whatever its strings contain."""
    text = json.dumps(value, ensure_ascii=False, separators=(",", ":"), allow_nan=False)
    for sign in "<>&\u2028\u2029":
        text = text.replace(sign, f"\\u{ord(sign):04x}")
    return text


def _library() -> str:
    """Return the source of plotly.js from its package."""
    from plotly.offline import get_plotlyjs

    text: str = get_plotlyjs()
    return text


def _policy(scripts: Sequence[str]) -> str:
    """Return the content security policy: only the page's own scripts, no network."""
    hashes = [f"'sha256-{b64encode(hashlib.sha256(text.encode()).digest()).decode()}'" for text in scripts]
    allowed = " ".join(hashes) if hashes else "'none'"
    return (
        f"default-src 'none'; script-src {allowed}; style-src 'unsafe-inline'; img-src data: blob:; "
        "base-uri 'none'; form-action 'none'"
    )
