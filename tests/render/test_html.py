"""Reports without a browser: what stands in the page, that it is the JSON's, and that names stay text."""

from __future__ import annotations

import base64
import contextlib
import hashlib
import itertools
import json
import math
import re
import shlex
import shutil
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
import results
from pages import Element, parsed
from typer.testing import CliRunner

from robacc.cli.main import app
from robacc.render.html.headline import headline_of
from robacc.render.html.page import render, script_json
from robacc.render.html.reproduce import command_line
from robacc.render.plots.catalogue import pictures_of

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
        for one in value.values():
            yield from numbers(one)
    elif isinstance(value, list):
        for one in value:
            yield from numbers(one)
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield float(value)


@pytest.mark.parametrize("command", COMMANDS)
def test_every_number_shown_is_the_jsons(command: str) -> None:
    known = set(numbers(results.document(command)))
    shown = tree(command).all("data")
    assert len(shown) > 8
    factors = {"mm": 1e3, "µm": 1e6, "°": 180 / math.pi, "µrad": 1e6, "mm²": 1e6, "": 1.0}
    for one in shown:
        value = float(one.attributes["value"])
        assert value in known, one.text
        match = re.fullmatch(r"(-?[\d.]+(?:e[-+]\d+)?)\s*(\D*)", one.text)
        assert match is not None, one.text
        digits, unit = match.groups()
        # Covariances stand in a table whose head has the unit, so a bare number may be in any of them.
        scales = [factors[unit]] if unit else [1.0, 1e6, (180 / math.pi) ** 2]
        decimals = len(digits.partition("e")[0].partition(".")[2])
        exponent = int(digits.partition("e")[2] or 0)
        step = 10.0 ** (exponent - decimals)
        assert any(abs(float(digits) - value * scale) <= 0.51 * step for scale in scales), one.text


def test_the_first_screen_of_a_trace_tells_the_story() -> None:
    document = results.document("trace")
    first = next(s for s in tree("trace").all("section") if s.attributes.get("class", "").startswith("first"))
    story = next(p for p in first.all("p") if p.attributes.get("class") == "story").text
    held = {side: document[side]["held_out"]["position"]["rms_m"] * 1e3 for side in ("before", "after")}
    assert "joint compliance on j2 and backlash on j3" in story
    assert f"{held['before']:.3f} mm" in story
    assert f"{held['after']:.4f} mm" in story
    tiles = {dt.text: dt.parent.all("data")[0] for dt in first.all("dt") if dt.parent and dt.parent.all("data")}
    assert float(tiles["gain in rms"].attributes["value"]) == document["gain_m"]["value"]
    assert "sample arm, 1.45 m" in first.text


def test_an_estimate_shows_its_grade_gate_and_intervals(tmp_path: Path) -> None:
    document = results.gated(tmp_path)
    found = parsed(render([document], ["estimate"]))
    badges = [one.text for one in found.all("span") if "badge" in one.attributes.get("class", "")]
    assert badges == ["grade D, demonstrated", "gate inconclusive"]
    section = next(s for s in found.all("section") if s.text.strip().startswith("Gate cell: inconclusive"))
    rows = [[cell.text for cell in row.all("th", "td")] for row in section.all("tr")]
    assert [row[:2] for row in rows[1:]] == [["reach", "passed"], ["tight", "inconclusive"]]
    bounds = document["position"]["intervals"]["rms_m"]
    assert f"{bounds['lower'] * 1e3:.3f} … {bounds['upper'] * 1e3:.3f} mm (95 %)" in found.text
    assert sum("operating curve" in h.text for h in found.all("h3")) == 2


def test_an_alignment_has_standard_errors_and_no_number_for_what_the_poses_do_not_show() -> None:
    document = results.document("estimate")
    x, yaw = document["alignment"]["parameters"][0], document["alignment"]["parameters"][5]
    x |= {"value": 2.1, "std": 2.7e-6}
    yaw |= {"value": -0.0, "std": None, "why": "tool_frame.yaw has no effect on these poses"}
    made = render([document], ["estimate"])
    assert ">2.1000000<" in made
    assert ">2.7e-06<" in made
    assert "tool_frame.yaw has no effect on these poses" in made
    assert ">-0<" not in made


def test_orders_of_a_periodic_error_have_standard_errors() -> None:
    document = results.document("trace")
    line = {"order": 1.0, "amplitude_rad": 5.33e-4, "phase_rad": 0.695}
    document["findings"][0]["lines"] = [line | {"amplitude_std_rad": 4.6e-6, "phase_std_rad": 0.0087}]
    made = render([document], ["trace"])
    assert ">533.0 µrad<" in made
    assert ">4.6 µrad<" in made
    assert ">39.82°<" in made
    assert ">0.50°<" in made
    assert "amplitude × cos(order × q − phase)" in made


def test_what_is_left_is_not_called_noise() -> None:
    document = results.document("trace")
    assert headline_of(document).story.endswith("and what is left has no structure.")
    document["findings"] = []
    assert headline_of(document).story.endswith("; what is left has no structure, and nothing was added.")


def test_a_comparison_shows_its_ranking_and_every_difference(tmp_path: Path) -> None:
    document = results.compared(tmp_path)
    found = parsed(render([document], ["compare"]))
    assert document["ranking"]["text"][0] in found.text
    assert found.all("figure")[0].all("h2")[0].text == "position.rms of each result"
    known = set(numbers(document))
    shown = [float(one.attributes["value"]) for one in found.all("data")]
    assert len(shown) > 20
    assert set(shown) <= known


@pytest.mark.parametrize("command", COMMANDS)
def test_every_picture_has_words_numbers_and_something_drawn(command: str) -> None:
    pictures = pictures_of(results.document(command))
    figures = tree(command).all("figure")
    assert len(figures) == len(pictures) >= 6
    for picture, figure in zip(pictures, figures, strict=True):
        assert figure.all("h2", "h3", "h4")[0].text == picture.title
        assert len(figure.all("figcaption")[0].text) > 60
        still = next(one for one in figure.all("div") if one.attributes.get("class") == "still")
        assert still.attributes["role"] == "img"
        assert len(still.attributes["aria-label"]) > 20
        assert len(figure.all("table")[0].all("tr")) == len(picture.table.rows) + 1 > 1
        assert all(len(row) == len(picture.table.header) for row in picture.table.rows), picture.kind


@pytest.mark.parametrize("command", COMMANDS)
def test_every_svg_is_well_formed_and_drawn_with_units(command: str) -> None:
    for svg in re.findall(r"<svg .*?</svg>", page(command), re.DOTALL):
        root = ElementTree.fromstring(svg)
        tags = [one.tag.rpartition("}")[2] for one in root.iter()]
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
    levels = [int(one.tag[1]) for one in tree(command).all("h1", "h2", "h3", "h4", "h5", "h6")]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(later <= earlier + 1 for earlier, later in itertools.pairwise(levels))


@pytest.mark.parametrize("command", COMMANDS)
def test_the_page_is_one_small_file_that_may_ask_for_nothing(command: str) -> None:
    text, found = page(command), tree(command)
    assert len(text.encode()) < LIMIT
    policy = next(m for m in found.all("meta") if m.attributes.get("http-equiv") == "Content-Security-Policy")
    rules = dict(rule.strip().partition(" ")[::2] for rule in policy.attributes["content"].split(";"))
    assert rules["default-src"] == "'none'"
    assert "unsafe" not in rules["script-src"]
    scripts = [one for one in found.all("script") if "type" not in one.attributes]
    for script in scripts:
        digest = base64.b64encode(hashlib.sha256(script.text.encode()).digest()).decode()
        assert f"'sha256-{digest}'" in rules["script-src"]
    for one in found.all("img", "link", "iframe", "object", "embed", "form", "base", "audio", "video"):
        pytest.fail(f"<{one.tag}> in a report")
    for one in found.all("a", "image", "use"):
        target = one.attributes.get("href") or one.attributes.get("xlink:href") or ""
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
        return [hostile(one, within) for one in document]
    return document + HOSTILE if within and isinstance(document, str) else document


def executable(found: Element) -> list[Element]:
    """Scripts that a browser runs or unpacks; data for them left out."""
    return [one for one in found.all("script") if one.attributes.get("type") != "application/json"]


@pytest.mark.parametrize(
    "command",
    ["trace", "iso9283", *(pytest.param(one, marks=pytest.mark.slow) for one in ("estimate", "predict", "calibrate"))],
)
def test_hostile_names_stay_text(command: str) -> None:
    document = hostile(results.document(command))
    document["warnings"] = [HOSTILE]
    found = parsed(render([document], [HOSTILE]))
    assert len(executable(found)) == len(executable(tree(command)))
    assert not found.all("img", "frac")
    # A name that broke out of the attribute it stands in would leave attributes of its own.
    known = {name for one in tree(command).all("div", "figure", "section") for name in one.attributes}
    assert {name for one in found.all("div", "figure", "section") for name in one.attributes} <= known
    assert HOSTILE in [one.text for one in found.all("li")]
    if document.get("robot"):
        assert HOSTILE in found.all("h1")[0].text
        assert HOSTILE in found.all("title")[0].text


def test_data_within_a_script_element_cannot_end_it() -> None:
    text = script_json({"a": "</script><!--\u2028&"})
    assert not set("<>&\u2028") & set(text)
    assert json.loads(text) == {"a": "</script><!--\u2028&"}


def test_several_results_stand_side_by_side() -> None:
    documents = [results.document("calibrate"), results.document("iso9283")]
    found = parsed(render(documents, ["one", "two"]))
    assert found.all("h1")[0].text == "2 results side by side"
    table = found.all("table")[0]
    assert [cell.text for cell in table.all("tr")[0].all("th")] == ["", "one", "two"]
    rows = {row.all("th")[0].text: [c.text for c in row.all("td")] for row in table.all("tr")[1:]}
    after = documents[0]["after"]["held_out"]["position"]["rms_m"]
    assert float(rows["after, rms"][0].removesuffix(" mm")) == pytest.approx(after * 1e3, rel=6e-3)
    assert rows["after, rms"][1] == "–"
    warned = [ul.text for ul in found.all("ul") if ul.attributes.get("class") == "warning"]
    assert any("not of the same poses" in text for text in warned)
    assert len(found.all("article")) == 2


@pytest.mark.parametrize("command", ["estimate", "predict", "calibrate", "iso9283"])
def test_the_command_line_makes_the_same_result_again(command: str, tmp_path: Path) -> None:
    found = results.document(command)
    for word in results.CALLS[command]:
        if (results.PROJECT / word).is_file():
            shutil.copy(results.PROJECT / word, tmp_path)
    words = shlex.split(command_line(found))
    with contextlib.chdir(tmp_path):
        done = CliRunner().invoke(app, [*words[1:], "--format", "json"])
    assert done.exit_code == 0, done.stderr
    again = json.loads(done.stdout)
    # Some options are paths, as they were typed.
    assert {key: again[key] for key in again if key != "options"} == {
        key: found[key] for key in found if key != "options"
    }


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


def test_the_same_result_gives_the_same_page() -> None:
    assert render([results.document("iso9283")], ["iso9283"]) == page("iso9283")
