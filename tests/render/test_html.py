"""Reports without a browser: content of the page, agreement with the JSON, and escaping of names."""

import base64
import hashlib
import itertools
import json
import math
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
import results
from commands import missing
from pages import Element, parsed

from robacc.render.page import command_line, headline_of, render, script_json
from robacc.render.plots.results import charts_of

COMMANDS = tuple(results.CALLS)
LIMIT = 6_000_000
HOSTILE = "</script><script>alert(1)</script><img src=x onerror=alert(2)> $\\frac{ & \"'"


@cache
def page(command: str) -> str:
    return render([results.document(command)], [command])


@cache
def tree(command: str) -> Element:
    return parsed(page(command))


def numbers(value: Any) -> Iterator[float]:
    """Every number of a document."""
    if isinstance(value, dict):
        for item in value.values():
            yield from numbers(item)
    elif isinstance(value, list):
        for item in value:
            yield from numbers(item)
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield float(value)


@pytest.mark.parametrize("command", COMMANDS)
def test_every_number_shown_is_the_jsons(command: str) -> None:
    known = set(numbers(results.document(command)))
    cells = tree(command).all("data")
    assert len(cells) > 8
    factors = {"mm": 1e3, "µm": 1e6, "°": 180 / math.pi, "mm²": 1e6, "": 1.0}
    for cell in cells:
        value = float(cell.attributes["value"])
        assert value in known, cell.text
        match = re.fullmatch(r"(-?[\d.]+(?:e[-+]\d+)?)\s*(\D*)", cell.text.replace("−", "-"))
        digits, unit = match.groups()
        # Covariances have their unit in the head of the table, coefficients in the last column: any may apply.
        scales = [factors[unit]] if unit else [1.0, 1e3, 180 / math.pi, 1e6, (180 / math.pi) ** 2]
        decimals = len(digits.partition("e")[0].partition(".")[2])
        step = 10.0 ** (int(digits.partition("e")[2] or 0) - decimals)
        assert any(abs(float(digits) - value * scale) <= 0.51 * step for scale in scales), cell.text


def test_a_trace_shows_statements_of_findings_their_harmonics_and_the_undeclared_load() -> None:
    document = results.document("trace")
    finding = document["findings"][0]
    finding["statement"] = "from line 74 on, the target is displaced by 0.21 mm"
    document["undeclared_load"] = {"statement": "the torques of j2 point to 12 kg more on the link of j3"}
    harmonic = {"order": 1.0, "amplitude_rad": 5.33e-4, "phase_rad": 0.695}
    finding["harmonics"] = [harmonic | {"amplitude_std_rad": 4.6e-6, "phase_std_rad": 0.0087}]
    made = render([document], ["trace"])
    told = (
        "from line 74 on, the target is displaced by 0.21 mm",
        "undeclared load: the torques of j2 point to 12 kg more on the link of j3",
    )
    assert missing(parsed(made).text, *told) == []
    cells = (">0.03054°<", ">0.00026°<", ">39.82°<", ">0.50°<", "amplitude × cos(order × q − phase)")
    assert missing(made, *cells) == []


def test_the_first_screen_of_a_trace_has_the_summary() -> None:
    document = results.document("trace")
    first = next(s for s in tree("trace").all("section") if s.attributes.get("class", "").startswith("first"))
    summary = next(p for p in first.all("p") if p.attributes.get("class") == "summary").text
    held_out = {side: document[side]["held_out"]["position"]["rms_m"] * 1e3 for side in ("before", "after")}
    assert "joint compliance on j2 and backlash on j3" in summary
    assert f"{held_out['before']:.3f} mm" in summary
    assert f"{held_out['after']:.4f} mm" in summary
    tiles = {dt.text: dt.parent.all("data")[0] for dt in first.all("dt") if dt.parent and dt.parent.all("data")}
    assert float(tiles["rms reduction"].attributes["value"]) == document["gain_m"]["value"]
    assert "sample arm, 1.45 m" in first.text


def test_an_estimate_shows_its_grade_gate_and_intervals(tmp_path: Path) -> None:
    document = results.gated(tmp_path)
    report = parsed(render([document], ["estimate"]))
    badges = [span.text for span in report.all("span") if "badge" in span.attributes.get("class", "")]
    assert badges == ["grade D, confirmed at 95 % confidence", "gate inconclusive"]
    section = next(s for s in report.all("section") if s.text.strip().startswith("Gate cell: INCONCLUSIVE"))
    rows = [[cell.text for cell in row.all("th", "td")] for row in section.all("tr")]
    assert [row[:2] for row in rows[1:]] == [["reach", "pass"], ["tight", "inconclusive"]]
    bounds = document["position"]["intervals"]["rms_m"]
    assert f"{bounds['lower'] * 1e3:.3f} … {bounds['upper'] * 1e3:.3f} mm (95 %)" in report.text
    assert sum("operating curve" in h.text for h in report.all("h3")) == 2


def test_a_registration_has_standard_errors_and_reasons_and_notes_name_options() -> None:
    document = results.document("estimate")
    x, yaw = document["alignment"]["parameters"][0], document["alignment"]["parameters"][5]
    x |= {"value": 2.1, "std": 2.7e-6}
    yaw |= {"value": -0.0, "std": None, "why": "tool_frame.yaw has no effect on these poses"}
    document["notes"] = ["give `robot` or `ordered=True`"]
    made = render([document], ["estimate"])
    told = (">2100.0000<", ">0.0027<", "tool_frame.yaw has no effect on these poses", "give --robot or --ordered")
    assert missing(made, *told, ">-0<") == [">-0<"]


def test_a_trace_shows_the_error_before_and_no_figure_twice() -> None:
    document = results.document("trace")
    labels = [tile.label for tile in headline_of(document).tiles]
    assert labels == ["nominal, registered, rms", "baseline, rms", "extended model, rms", "rms reduction"]
    document["findings"] = []
    assert [tile.label for tile in headline_of(document).tiles] == labels[:2]


def test_the_first_screen_says_why_and_what_next() -> None:
    facts = headline_of(results.document("estimate")).facts
    assert [name for name, _ in facts[:2]] == ["Why", "Next"]
    assert facts[1][1].endswith(": robacc trace poses.csv --robot robot.yaml")
    assert headline_of(results.document("trace")).facts[0][0] == "Next"


def test_numbers_below_zero_have_minus_signs() -> None:
    cells = [cell.text for cell in tree("estimate").all("data")]
    assert any(text.startswith("−") for text in cells)
    assert not any("-" in text for text in cells)


def test_the_remaining_error_is_not_called_noise() -> None:
    document = results.document("trace")
    assert "mm rms; the remaining error has no structure." in headline_of(document).summary
    document["findings"] = []
    assert "No effect was found; the remaining error has no structure." in headline_of(document).summary


def test_a_comparison_shows_its_ranking_and_every_difference(tmp_path: Path) -> None:
    document = results.compared(tmp_path)
    report = parsed(render([document], ["compare"]))
    assert document["ranking"]["text"][0] in report.text
    assert report.all("figure")[0].all("h2")[0].text == "position.rms of each result"
    assert all(listing.all("li") for listing in report.all("ul"))
    known = set(numbers(document))
    values = [float(cell.attributes["value"]) for cell in report.all("data")]
    assert len(values) > 20
    assert set(values) <= known


@pytest.mark.parametrize("command", COMMANDS)
def test_every_chart_has_a_caption_a_table_and_a_drawing(command: str) -> None:
    charts = charts_of(results.document(command))
    figures = tree(command).all("figure")
    assert len(figures) == len(charts) >= 6
    for chart, figure in zip(charts, figures, strict=True):
        assert figure.all("h2", "h3", "h4")[0].text == chart.title
        assert len(figure.all("figcaption")[0].text) > 60
        still = next(div for div in figure.all("div") if div.attributes.get("class") == "still")
        assert still.attributes["role"] == "img"
        assert len(still.attributes["aria-label"]) > 20
        assert len(figure.all("table")[0].all("tr")) == len(chart.table.rows) + 1 > 1
        assert all(len(row) == len(chart.table.header) for row in chart.table.rows), chart.kind


@pytest.mark.parametrize("command", COMMANDS)
def test_every_svg_is_well_formed_and_drawn_with_units(command: str) -> None:
    for svg in re.findall(r"<svg .*?</svg>", page(command), re.DOTALL):
        tags = [element.tag.rpartition("}")[2] for element in ElementTree.fromstring(svg).iter()]
        assert tags.count("path") + tags.count("use") > 10
        assert "text" in tags
        assert "metadata" not in tags


@pytest.mark.parametrize("command", COMMANDS)
def test_ids_are_unique_and_references_resolve(command: str) -> None:
    text = re.sub(r"<script.*?</script>", "", page(command), flags=re.DOTALL)
    ids = re.findall(r'\bid="([^"]*)"', text)
    assert len(ids) == len(set(ids))
    wanted = set(re.findall(r'(?:href="#|url\(#|aria-labelledby=")([^")]+)', text))
    assert wanted <= set(ids)


@pytest.mark.parametrize("command", COMMANDS)
def test_headings_are_in_order(command: str) -> None:
    levels = [int(heading.tag[1]) for heading in tree(command).all("h1", "h2", "h3", "h4", "h5", "h6")]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(later <= earlier + 1 for earlier, later in itertools.pairwise(levels))


@pytest.mark.parametrize("command", COMMANDS)
def test_the_page_is_one_small_file_that_may_ask_for_nothing(command: str) -> None:
    text, report = page(command), tree(command)
    assert len(text.encode()) < LIMIT
    policy = next(m for m in report.all("meta") if m.attributes.get("http-equiv") == "Content-Security-Policy")
    rules = dict(rule.strip().partition(" ")[::2] for rule in policy.attributes["content"].split(";"))
    assert rules["default-src"] == "'none'"
    assert "unsafe" not in rules["script-src"]
    scripts = [script for script in report.all("script") if "type" not in script.attributes]
    for script in scripts:
        digest = base64.b64encode(hashlib.sha256(script.text.encode()).digest()).decode()
        assert f"'sha256-{digest}'" in rules["script-src"]
    for element in report.all("img", "link", "iframe", "object", "embed", "form", "base", "audio", "video"):
        pytest.fail(f"<{element.tag}> in a report")
    for element in report.all("a", "image", "use"):
        target = element.attributes.get("href") or element.attributes.get("xlink:href") or ""
        assert target.startswith(("#", "data:image/png;base64,")), target


def hostile(document: Any, within: bool = False) -> Any:
    """The document with every free text in it made hostile; keys, words that robacc chooses and hashes stay."""
    if isinstance(document, dict):
        free = {
            "name",
            "pose",
            "line_",
            "file",
            "target",
            "label",
            "declared",
            "fit",
            "reason",
            "text",
            "why",
            "joints",
        }
        return {key: hostile(value, key in free) for key, value in document.items()}
    if isinstance(document, list):
        return [hostile(item, within) for item in document]
    return document + HOSTILE if within and isinstance(document, str) else document


def executable(report: Element) -> list[Element]:
    """Scripts that a browser runs or unpacks; data for them left out."""
    return [script for script in report.all("script") if script.attributes.get("type") != "application/json"]


@pytest.mark.parametrize(
    "command",
    [
        "trace",
        "iso9283",
        *(pytest.param(name, marks=pytest.mark.slow) for name in ("estimate", "predict", "calibrate")),
    ],
)
def test_hostile_names_stay_text(command: str) -> None:
    document = hostile(results.document(command))
    document["warnings"] = [HOSTILE]
    report = parsed(render([document], [HOSTILE]))
    assert len(executable(report)) == len(executable(tree(command)))
    assert not report.all("img", "frac")
    # A name that broke out of the attribute it stands in would leave attributes of its own.
    known = {name for element in tree(command).all("div", "figure", "section") for name in element.attributes}
    assert {name for element in report.all("div", "figure", "section") for name in element.attributes} <= known
    assert HOSTILE in [item.text for item in report.all("li")]
    if document.get("robot"):
        assert HOSTILE in report.all("h1")[0].text
        assert HOSTILE in report.all("title")[0].text


def test_data_within_a_script_element_cannot_end_it() -> None:
    text = script_json({"a": "</script><!--\u2028&"})
    assert not set("<>&\u2028") & set(text)
    assert json.loads(text) == {"a": "</script><!--\u2028&"}


@pytest.mark.slow
def test_several_results_stand_side_by_side() -> None:
    documents = [results.document("calibrate"), results.document("iso9283")]
    report = parsed(render(documents, ["one", "two"]))
    assert report.all("h1")[0].text == "2 results side by side"
    table = report.all("table")[0]
    assert [cell.text for cell in table.all("tr")[0].all("th")] == ["", "one", "two"]
    rows = {row.all("th")[0].text: [c.text for c in row.all("td")] for row in table.all("tr")[1:]}
    after = documents[0]["after"]["held_out"]["position"]["rms_m"]
    assert float(rows["calibrated, rms"][0].removesuffix(" mm")) == pytest.approx(after * 1e3, rel=6e-3)
    assert rows["calibrated, rms"][1] == "–"
    warned = [ul.text for ul in report.all("ul") if ul.attributes.get("class") == "warning"]
    assert any("not made from the same poses file" in text for text in warned)
    assert len(report.all("article")) == 2


def test_switches_and_options_of_the_command_line() -> None:
    changed = {
        **results.document("trace"),
        "options": {"empirical": False, "ordered": True, "declared": "", "folds": 3},
    }
    assert (
        command_line(changed) == "robacc trace poses.csv --robot robot.yaml --named-only --ordered --folds 3 --seed 0"
    )
    robust = {**results.document("calibrate"), "options": {"robust": False, "prior": True, "align": ["a", "b"]}}
    assert command_line(robust).endswith("--all-rows --prior --align a,b --seed 0")
