"""``robacc report``, ``robacc plot`` and ``--report`` on the command line."""

from __future__ import annotations

import importlib.util
import json
from pathlib import Path
from typing import Any

import pytest
import results
from pages import parsed

MAGIC = {"png": b"\x89PNG", "pdf": b"%PDF", "svg": b"<?xml"}


@pytest.fixture
def stored(tmp_path: Path) -> Path:
    path = tmp_path / "iso.json"
    path.write_text(results.text("iso9283"), encoding="utf-8")
    return path


def test_a_stored_result_becomes_a_page(stored: Path, tmp_path: Path) -> None:
    page = tmp_path / "report.html"
    done = results.run("report", str(stored), "--output", str(page))
    assert (done.exit_code, done.stdout, done.stderr) == (0, "", "")
    found = parsed(page.read_text(encoding="utf-8"))
    assert found.all("h1")[0].text.startswith("ISO 9283 pose criteria")
    again = results.run("report", str(stored), "-o", "-")
    assert again.stdout == page.read_text(encoding="utf-8")


@pytest.mark.parametrize("command", ["iso9283", pytest.param("estimate", marks=pytest.mark.slow)])
def test_report_beside_the_command_is_the_page_of_its_json(command: str, tmp_path: Path) -> None:
    page, other, stored = tmp_path / "a.html", tmp_path / "b.html", tmp_path / command
    done = results.run(command, *results.CALLS[command], "--report", str(page))
    assert done.exit_code == 0
    assert "mm" in done.stdout
    stored.write_text(results.text(command), encoding="utf-8")
    assert results.run("report", str(stored), "-o", str(other)).exit_code == 0
    assert page.read_bytes() == other.read_bytes()


def test_a_failing_gate_is_in_the_report_and_in_the_exit_status(tmp_path: Path) -> None:
    gate, page = tmp_path / "gate.yaml", tmp_path / "a.html"
    criterion = "{name: reach, key: position.p95, limit: 0.1 mm, reason: the part}"
    gate.write_text(f"robacc_gate: 1\nname: cell\ncriteria:\n  - {criterion}\n", encoding="utf-8")
    done = results.run("estimate", *results.CALLS["estimate"], "--gate", str(gate), "--report", str(page))
    assert done.exit_code == 4
    assert "gate failed" in page.read_text(encoding="utf-8")


def test_several_results_of_one_name_are_told_apart(stored: Path, tmp_path: Path) -> None:
    page = tmp_path / "report.html"
    assert results.run("report", str(stored), str(stored), "-o", str(page)).exit_code == 0
    header = parsed(page.read_text(encoding="utf-8")).all("table")[0].all("tr")[0]
    assert [cell.text for cell in header.all("th")] == ["", "iso.json (1)", "iso.json (2)"]


@pytest.mark.parametrize("form", ["svg", "png", "pdf"])
def test_a_picture_becomes_a_file(form: str, stored: Path, tmp_path: Path) -> None:
    picture = tmp_path / f"x.{form}"
    done = results.run("plot", str(stored), "--kind", "iso9283", "--output", str(picture))
    assert (done.exit_code, done.stdout, done.stderr) == (0, "", "")
    data = picture.read_bytes()
    assert data.startswith(MAGIC[form])
    assert len(data) > 5000
    assert results.run("plot", str(stored), "--kind", "iso9283", "--output", str(picture)).exit_code == 0
    assert picture.read_bytes() == data


def test_plot_says_what_it_can_do(stored: Path, tmp_path: Path) -> None:
    done = results.run("plot", str(stored), "--kind", "poses", "-o", str(tmp_path / "x.gif"))
    assert done.exit_code == 2
    assert "ends in .svg, .png or .pdf" in done.stderr
    done = results.run("plot", str(stored), "--kind", "budget", "-o", str(tmp_path / "x.png"))
    assert done.exit_code == 2
    assert "it has iso9283, iso9283-cloud" in done.stderr
    assert not list(tmp_path.glob("x.*"))


@pytest.mark.parametrize("command", ["report", "plot"])
def test_without_the_extra_the_way_to_it_is_said(
    command: str, stored: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = importlib.util.find_spec
    monkeypatch.setattr(
        "robacc.render.plots.canvas.find_spec", lambda name: None if name == "matplotlib" else real(name)
    )
    more = ("--kind", "poses") if command == "plot" else ()
    done = results.run(command, str(stored), *more, "-o", str(tmp_path / "x.png"))
    assert done.exit_code == 2
    assert "pip install '.[report]' in a checkout" in " ".join(done.stderr.split())
    # Said before anything is computed, too.
    done = results.run("estimate", "no such file", "--report", str(tmp_path / "x.html"))
    assert done.exit_code == 2
    assert "matplotlib" in done.stderr


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda d: d.pop("visits"), "has no key 'visits'"),
        (lambda d: d.update(iso9283=5), "has an unexpected value"),
        (lambda d: d["visits"][0].update(attained_m=[[1, 2]]), "has an unexpected value"),
        (lambda d: d["visits"][0].update(commanded_m="x"), "has an unexpected value"),
    ],
)
def test_a_result_that_its_command_did_not_write_is_refused_by_name(change: Any, told: str, tmp_path: Path) -> None:
    document = results.document("iso9283")
    change(document)
    broken = tmp_path / "broken.json"
    broken.write_text(json.dumps(document), encoding="utf-8")
    done = results.run("report", str(broken), "-o", str(tmp_path / "x.html"))
    assert done.exit_code == 3
    assert "broken.json" in done.stderr
    assert told in " ".join(done.stderr.split())
    assert not list(tmp_path.glob("*.html"))


def test_the_result_is_not_overwritten_by_its_page(stored: Path) -> None:
    done = results.run("report", str(stored), "-o", str(stored))
    assert done.exit_code == 2
    assert "would be overwritten" in done.stderr
    assert results.run("report", "-", "-", "-o", str(stored.with_suffix(".html"))).exit_code == 2


@pytest.mark.slow
def test_a_page_of_1500_poses_stays_small(tmp_path: Path) -> None:
    poses, stored, page = (str(tmp_path / name) for name in ("p.csv", "r.json", "r.html"))
    simulated = ("sample_data/truth.yaml", "--poses", "1500", "--seed", "1", "--noise", "0.03mm", "-o", poses)
    assert results.run("simulate", *simulated).exit_code == 0
    robot = ("--robot", "sample_data/robot.yaml", "--align", "base_frame,tool_frame")
    assert results.run("estimate", poses, *robot, "--format", "json", "-o", stored).exit_code == 0
    assert results.run("report", stored, "-o", page).exit_code == 0
    assert Path(page).stat().st_size < 6_000_000
