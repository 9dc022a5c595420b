"""A result of any command as HTML: a page of one or of several side by side, and a few lines for a notebook."""

import gzip
import hashlib
import json
import re
import shlex
from base64 import b64encode
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from html import escape
from itertools import chain
from types import MappingProxyType
from typing import Any

from robacc.errors import listing
from robacc.render.plots.canvas import DARK, LIGHT, as_part, need
from robacc.render.plots.results import charts_of
from robacc.render.text import (
    NEGATIVE_OPTIONS,
    Cell,
    Document,
    Grid,
    Listing,
    ReportHeadline,
    Section,
    Text,
    as_options,
    of_robot,
    shown,
)
from robacc.render.views.accuracy import estimate_headline, estimate_view, iso9283_headline, iso9283_view
from robacc.render.views.compare import (
    LOOKS,
    check_headline,
    comparison_headline,
    comparison_view,
    gate_section,
    passed,
)
from robacc.render.views.expected import (
    correction_headline,
    correction_view,
    plan_headline,
    plan_view,
    predict_headline,
    prediction_view,
)
from robacc.render.views.fit import fit_headline, fit_view
from robacc.render.views.history import VIEWS
from robacc.robots.description import IDENTITY
from robacc.version import __version__

# The view of a result of any command: its headline, and the sections of its page.


def _plain_headline(document: Document) -> ReportHeadline:
    return ReportHeadline(f"Result of robacc {document['command'].replace('-', ' ')}{of_robot(document)}", "", ())


_VIEWS: dict[str, tuple[Callable[[Document], ReportHeadline], Callable[[Document], Iterable[Section]]]] = {
    "trace": (fit_headline, fit_view),
    "calibrate": (fit_headline, fit_view),
    "estimate": (estimate_headline, estimate_view),
    "predict": (predict_headline, prediction_view),
    "iso9283": (iso9283_headline, iso9283_view),
    "check": (check_headline, lambda document: ()),
    "compare": (comparison_headline, comparison_view),
    "correct": (correction_headline, correction_view),
    "plan": (plan_headline, plan_view),
    **{name: (_plain_headline, view) for name, view in VIEWS.items()},
}


def headline_of(document: Document) -> ReportHeadline:
    """Return the headline of a result of any command, with its robot, data and gate."""
    headline = _VIEWS.get(document["command"], (_plain_headline,))[0](document)
    inputs, robot, gate = document["inputs"], document.get("robot"), document.get("gate")
    robots = [record["name"] for record in inputs if record["kind"] == "robot"]
    if robot is not None:
        joints = ", ".join(joint["name"] for joint in robot["joints"])
        robots = [f"{robot['name']} (joints {joints})" if joints else robot["name"]]
    files = [record["name"] for record in inputs if record["kind"] in ("poses", "holdout", "against", "already")]
    # The poses of a plan are not measured yet.
    count = None if document["command"] == "plan" else document.get("n_poses")
    poses = f"{count:,} poses" if isinstance(count, int) else ""
    facts = [
        *(("Robot", name) for name in robots),
        ("Data", " from ".join(part for part in (poses, " and ".join(files)) if part)),
        ("Gate", f"{gate['name']}: {passed(gate)} passed" if gate else ""),
        *headline.facts,
    ]
    return headline._replace(
        badges=[
            *headline.badges,
            *((f"gate {look.gate}", look.tone) for look in ([LOOKS[gate["outcome"]]] if gate else [])),
        ],
        # What a reader asks first: why, and what now.
        facts=sorted((fact for fact in facts if fact[1]), key=lambda fact: fact[0] not in ("Why", "Next")),
    )


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


def notebook_view(document: Document) -> list[Section]:
    """Return the headline of a result as a section of a text."""
    headline = headline_of(document)
    title = " ".join((headline.title, *(f"[{text}]" for text, _ in headline.badges)))
    rows = [(label, "  ".join(filter(None, texts))) for label, *texts in _figures(headline)]
    return [Section(title, [Text(headline.summary, wraps=False), Grid(("", ""), rows, left=(0, 1))])]


def _figures(headline: ReportHeadline) -> list[tuple[str, str, str]]:
    """Return label, value and interval of each figure, then the facts."""
    return [
        *((tile.label, str(tile.value), tile.interval) for tile in headline.tiles),
        *((name, text, "") for name, text in headline.facts),
    ]


# Rows of a page that say what was tested, as the robot file of a result or the user of the page states it.


def identity_rows(
    documents: Sequence[Document], names: Sequence[str], identity: Mapping[str, str]
) -> list[tuple[str, str]]:
    """Return labels and texts in the order of the page; a text of ``identity`` replaces those of the results.

    Different texts, such as the serial numbers of two arms, stand side by side with the names of the results; those
    of two files of one result with the names of the files, behind that of the result if there are several.
    """
    rows: list[tuple[str, str]] = []
    for key, label in IDENTITY.items():
        files = [[file for file in made["inputs"] if key in file.get("identity", ())] for made in documents]
        texts = dict.fromkeys(
            (
                name if is_one else f"{name}, {file['name']}" if len(documents) > 1 else file["name"],
                file["identity"][key],
            )
            for name, own in zip(names, files, strict=True)
            for is_one in [len({file["identity"][key] for file in own}) == 1]
            for file in own
        )
        many, distinct = "; ".join(f"{name}: {text}" for name, text in texts), {text for _, text in texts}
        rows.append((label, identity.get(key, many if len(distinct) > 1 else "".join(distinct))))
    return [(label, text) for label, text in rows if text]


# The section about reproducing a result: command line, version, and hashes of the inputs.


def command_line(document: Document) -> str:
    """Return the command line from the options and inputs of the result; files by name without folders."""
    command, inputs = document["command"], document["inputs"]
    seeded = ("estimate", "predict", "calibrate", "trace", "iso9283", "plan")
    leading = ({"predict": "robot", "plan": "robot"}.get(command, "poses"), "result")
    files = {record["kind"]: record["name"] for record in reversed(inputs)}
    # The options that were stated on the names of the poses' file.
    reading: Document = next((record["reading"] for record in inputs if "reading" in record), {})
    settings = [
        *((kind, name) for kind, name in files.items() if kind not in leading),
        *((name, value) for name, value in document["options"].items() if name not in files),
        *((n, "columns.yaml" if n == "columns" else value) for n, value in reading.items() if n != "commanded_sha256"),
        ("seed", document["seed"] if command in seeded else None),
    ]
    arguments = [
        "robacc",
        command.replace("history-", "history "),
        *(record["name"] for record in inputs if record["kind"] in leading),
    ]
    for name, value in settings:
        flag = {"purpose": "--for", **NEGATIVE_OPTIONS}.get(name, f"--{name.replace('_', '-')}")
        if isinstance(value, bool):
            arguments += [flag] * (value != (name in NEGATIVE_OPTIONS))
        elif value not in (None, [], ""):
            joined = ",".join(map(str, value)) if isinstance(value, list) else value
            own = value if name in ("outside", "half_space") else [joined]
            arguments += [word for each in own for word in (flag, str(each))]
    return " ".join(map(shlex.quote, arguments))


# Several results in one table, one column per result.


def _side_by_side(documents: Sequence[Document], headlines: Sequence[ReportHeadline], names: Sequence[str]) -> Section:
    """Return outcome, key figures and facts of each result, with warnings about different inputs."""
    figures = [{tile.label: tile.value for tile in headline.tiles} for headline in headlines]
    facts = [dict(headline.facts) for headline in headlines]
    rows: dict[str, Sequence[Cell]] = {
        "command": [str(document["command"]) for document in documents],
        "outcome": [", ".join(text for text, _ in headline.badges) or "–" for headline in headlines],
        **{label: [own.get(label, "–") for own in figures] for label in chain.from_iterable(figures)},
        **{label: [own.get(label, "–") for own in facts] for label in chain.from_iterable(facts)},
        "made by": [f"robacc {document['robacc']}" for document in documents],
        "call": [command_line(document) for document in documents],
    }
    is_mixed = len({document["robacc"] for document in documents}) > 1
    warnings = [
        *(
            f"the results were not made from the same {kind} file"
            for kind in ("poses", "robot", "holdout")
            if len({tuple(each["sha256"] for each in made["inputs"] if each["kind"] == kind) for made in documents}) > 1
        ),
        "the results were made by different versions of robacc" * is_mixed,
    ]
    table = Grid(("", *names), [(label, *cells) for label, cells in rows.items()], is_text=True)
    return next(shown([Section("Side by side", [table, Listing(warnings, "warning")])]))


# The page.


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
    return page_of([result_of(document, number) for number, document in enumerate(documents, 1)], names, identity)


def page_of(results: Sequence[Mapping[str, Any]], names: Sequence[str], identity: Mapping[str, str]) -> str:
    """Return the page of results that :func:`result_of` has laid out."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    documents, headlines = ([result[key] for result in results] for key in ("document", "headline"))
    environment = Environment(
        loader=PackageLoader("robacc.render"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    # Minus signs, which are as wide as a digit, for the hyphens of numbers.
    hyphens = r"(?<![\w.:/-])-(?=\d)|(?<=\de)-(?=\d)"
    environment.filters |= {"options": as_options, "minus": partial(re.sub, hyphens, "−")}
    scripts: list[str] = []
    if any(chart["scene"] for result in results for chart in result["charts"]):
        from plotly.offline import get_plotlyjs

        scripts = [get_plotlyjs(), environment.get_template("scenes.js").render()]
    is_multiple = len(results) > 1
    # Only the page's own scripts run, and nothing comes from the network.
    allowed = " ".join(
        [f"'sha256-{b64encode(hashlib.sha256(text.encode()).digest()).decode()}'" for text in scripts] or ["'none'"]
    )
    light, dark = (" ".join(f"--c-{role}: {value};" for role, value in colours.items()) for colours in (LIGHT, DARK))
    return environment.get_template("page.html").render(
        title=f"{len(results)} results side by side" if is_multiple else headlines[0].title,
        results=results,
        names=names,
        identity=identity_rows(documents, names, identity),
        overview=_side_by_side(documents, headlines, names) if is_multiple else None,
        library=b64encode(gzip.compress(scripts[0].encode(), 6, mtime=0)).decode() if scripts else "",
        script=scripts[1] if scripts else "",
        policy=(
            f"default-src 'none'; script-src {allowed}; style-src 'unsafe-inline'; img-src data: blob:; "
            "base-uri 'none'; form-action 'none'"
        ),
        version=__version__,
        light=light,
        dark=dark,
    )


def result_of(document: Document, place: int) -> dict[str, Any]:
    """Return the parts of one result as the templates take them, the ``place``-th of its page.

    Raises:
        UsageError: the extra ``report`` is not installed.
    """
    need("matplotlib", "plotly", "jinja2")
    number, (_, view) = f"r{place}", _VIEWS.get(document["command"], _VIEWS["check"])
    warnings = [*dict.fromkeys(document.get("warnings", ()))]
    if lines := [str(outlier["line"]) for outlier in document.get("outliers", ())]:
        warnings.append(f"excluded as outliers: line(s) {listing(lines, 20)}")
    leading = [
        *([gate_section(document["gate"])] if document.get("gate") else []),
        Section(
            "Warnings and notes",
            [Listing(warnings, "warning"), Listing([*document.get("notes", ()), *document.get("input_notes", ())])],
        ),
    ]
    return {
        "id": number,
        "document": document,
        "headline": headline_of(document),
        "charts": [
            {
                "id": f"{number}p{i}",
                "chart": chart,
                "svg": as_part(chart, f"{number}p{i}"),
                "scene": None if chart.scene is None else script_json(chart.scene),
                "starts": chart.kind in ("poses", "corrections", "planned-poses"),
            }
            for i, chart in enumerate(charts_of(document), 1)
        ],
        "sections": [*shown(view(document))],
        "leading": [*shown(leading)],
        "how": Section(
            "How to reproduce this result",
            [
                Text(
                    f"Made by robacc {document['robacc']} (schema {document['schema']}). On one machine the same call "
                    "on the same files gives the same bytes."
                ),
                Text(command_line(document), is_command=True),
                Grid(
                    ("input", "file", "SHA-256"),
                    [(record["kind"], record["name"], record["sha256"]) for record in document["inputs"]],
                    is_text=True,
                ),
            ],
        ),
    }


def script_json(value: Any) -> str:
    """Return JSON that cannot end a script element, whatever its strings contain."""
    text = json.dumps(value, ensure_ascii=False, separators=(",", ":"), allow_nan=False)
    return re.sub("[<>&\u2028\u2029]", lambda sign: f"\\u{ord(sign[0]):04x}", text)
