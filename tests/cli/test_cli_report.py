"""``robacc report`` and ``--report`` on the command line."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path
from typing import Any

import pytest
import results
from commands import missing, output, refused, run
from pages import parsed
from typer.testing import CliRunner

from robacc.cli.main import app

MAGIC = {"png": b"\x89PNG", "pdf": b"%PDF", "svg": b"<?xml"}


@pytest.fixture
def stored(tmp_path: Path) -> Path:
    path = tmp_path / "iso.json"
    path.write_text(results.text("iso9283"), encoding="utf-8")
    return path


def test_a_stored_result_becomes_a_page(stored: Path, tmp_path: Path) -> None:
    page = tmp_path / "report.html"
    done = run("report", stored, "--output", page)
    assert (done.exit_code, done.stdout, done.stderr) == (0, "", "")
    text = page.read_text(encoding="utf-8")
    assert parsed(text).all("h1")[0].text.startswith("ISO 9283 pose criteria")
    assert output("report", stored, "-o", "-") == text
    header = parsed(output("report", stored, stored, "-o", "-")).all("table")[0].all("tr")[0]
    assert [cell.text for cell in header.all("th")] == ["", "iso.json (1)", "iso.json (2)"]


def test_without_a_name_the_page_is_beside_the_result(
    stored: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    done = results.run("report", str(stored))
    assert (done.exit_code, done.stdout, done.stderr) == (0, f"wrote {stored.with_suffix('.html')}\n", "")
    assert stored.with_suffix(".html").read_text(encoding="utf-8").startswith("<!doctype html>")
    monkeypatch.chdir(tmp_path)
    assert CliRunner().invoke(app, ["report", str(stored), str(stored)]).stdout == "wrote report.html\n"
    assert Path("report.html").exists()


def test_a_picture_without_a_kind_is_the_main_chart(stored: Path, tmp_path: Path) -> None:
    picture, old = tmp_path / "a.svg", tmp_path / "b.svg"
    done = results.run("report", str(stored), "-o", str(picture))
    note = "note: drew the main chart, iso9283; other charts by --chart: iso9283-cloud\n"
    assert (done.exit_code, done.stdout, done.stderr) == (0, "", note)
    done = results.run("plot", str(stored), "--kind", "iso9283", "-o", str(old))
    renamed = "note: robacc plot is now robacc report --chart; the old name works until 0.4\n"
    assert (done.exit_code, done.stdout, done.stderr) == (0, "", renamed)
    assert old.read_bytes() == picture.read_bytes()
    assert results.run("report", str(stored), str(stored), "--chart", "iso9283", "-o", str(old)).exit_code == 2


@pytest.mark.parametrize("command", ["iso9283", pytest.param("estimate", marks=pytest.mark.slow)])
def test_report_beside_the_command_is_the_page_of_its_json(command: str, tmp_path: Path) -> None:
    page, other, stored = tmp_path / "a.html", tmp_path / "b.html", tmp_path / command
    assert "mm" in output(command, *results.CALLS[command], "--report", page)
    stored.write_text(results.text(command), encoding="utf-8")
    output("report", stored, "-o", other)
    assert page.read_bytes() == other.read_bytes()


def test_a_failing_gate_is_in_the_report_and_in_the_exit_status(tmp_path: Path) -> None:
    gate, page = tmp_path / "gate.yaml", tmp_path / "a.html"
    criterion = "{name: reach, key: position.p95, limit: 0.1 mm, reason: the part}"
    gate.write_text(f"robacc_gate: 1\nname: cell\ncriteria:\n  - {criterion}\n", encoding="utf-8")
    done = run("estimate", *results.CALLS["estimate"], "--gate", str(gate), "--report", str(page))
    assert done.exit_code == 4
    assert "gate failed" in page.read_text(encoding="utf-8")


@pytest.mark.parametrize("form", ["svg", "png", "pdf"])
def test_a_picture_becomes_a_file(form: str, stored: Path, tmp_path: Path) -> None:
    pictures = tmp_path / f"x.{form}", tmp_path / f"y.{form}"
    for picture in pictures:
        done = run("report", stored, "--chart", "iso9283", "--output", picture)
        assert (done.exit_code, done.stdout, done.stderr) == (0, "", "")
    data, again = (picture.read_bytes() for picture in pictures)
    assert (data[: len(MAGIC[form])], len(data) > 5000, data == again) == (MAGIC[form], True, True)


def test_plot_says_what_it_can_do(stored: Path, tmp_path: Path) -> None:
    for kind, name, message in (
        ("poses", "x.gif", "ends in .svg, .png or .pdf"),
        ("budget", "x.png", "it has iso9283, iso9283-cloud"),
    ):
        assert message in refused("report", stored, "--chart", kind, "-o", tmp_path / name)
    assert not list(tmp_path.glob("x.*"))


@pytest.mark.parametrize("more", [(), ("--chart", "poses")])
def test_without_the_extra_the_way_to_it_is_said(
    more: tuple[str, ...], stored: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = importlib.util.find_spec
    monkeypatch.setattr(
        "robacc.render.plots.canvas.find_spec", lambda name: None if name == "matplotlib" else real(name)
    )
    told = refused("report", stored, *more, "-o", tmp_path / "x.png")
    assert "pip install '.[report]' in a checkout" in told
    # Said before anything is computed, too.
    assert "matplotlib" in refused("estimate", "no such file", "--report", tmp_path / "x.html")


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda d: d.pop("visits"), "has no key 'visits'"),
        (lambda d: d.update(iso9283=5), "iso9283: expected an object, found 5"),
        (lambda d: d["visits"][0].update(attained_m=[[1, 2]]), "visits[0].attained_m[0]: expected 3 entries, found 2"),
        (lambda d: d["visits"][0].update(commanded_m="x"), 'visits[0].commanded_m: expected a list, found "x"'),
    ],
)
def test_a_result_that_its_command_did_not_write_is_refused_by_name(change: Any, told: str, tmp_path: Path) -> None:
    document = results.document("iso9283")
    change(document)
    broken = tmp_path / "broken.json"
    broken.write_text(json.dumps(document), encoding="utf-8")
    assert missing(refused("report", broken, "-o", tmp_path / "x.html", status=3), "broken.json", told) == []
    assert not list(tmp_path.glob("*.html"))


def test_the_result_is_not_overwritten_by_its_page(stored: Path) -> None:
    assert "would be overwritten" in refused("report", stored, "-o", stored)
    refused("report", "-", "-", "-o", stored.with_suffix(".html"))


@pytest.mark.slow
def test_a_page_of_1500_poses_stays_small(tmp_path: Path) -> None:
    poses, stored, page = (str(tmp_path / name) for name in ("p.csv", "r.json", "r.html"))
    simulated = ("sample_data/truth.yaml", "--poses", "1500", "--seed", "1", "--noise", "0.03mm", "-o", poses)
    output("simulate", *simulated)
    robot = ("--robot", "sample_data/robot.yaml", "--align", "base_frame,tool_frame")
    output("estimate", poses, *robot, "--format", "json", "-o", stored)
    output("report", stored, "-o", page)
    assert Path(page).stat().st_size < 6_000_000
