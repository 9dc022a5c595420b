"""`robacc check`, and `--gate` with its outputs on the commands that have a result."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Iterable
from itertools import product
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest
from commands import document, missing, one_line, output, refused, run

from robacc.comparison.stored_results import errors_behind
from robacc.gates import figure_at

ROOT = Path(__file__).resolve().parents[2]
POSES, ROBOT = (str(ROOT / "sample_data" / name) for name in ("poses.csv", "robot.yaml"))
ESTIMATE = ("estimate", POSES, "--robot", ROBOT)
PASSING = "{key: position.rms, limit: 9 mm, reason: r}"
FAILING = "{key: position.p95, limit: 0.1 mm, reason: r}"
ELSEWHERE = "{key: verdict, limit: clean, reason: r}"


def gate(folder: Path, *criteria: str, name: str = "gate.yaml") -> str:
    path = folder / name
    path.write_text("robacc_gate: 1\nname: g\ncriteria:\n" + "".join(f"  - {one}\n" for one in criteria))
    return str(path)


@pytest.fixture(scope="module")
def stored(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with ``estimate.json`` and ``calibrate.json`` of the sample data."""
    folder = tmp_path_factory.mktemp("stored")
    output(*ESTIMATE, "--format", "json", "-o", folder / "estimate.json")
    fitted = ("calibrate", POSES, "--robot", ROBOT, "--fit", "base_frame,tool_frame,joint_offset")
    output(*fitted, "--format", "json", "-o", folder / "calibrate.json")
    return folder


def test_a_stored_result_is_judged_as_the_command_itself_is(stored: Path, tmp_path: Path) -> None:
    path = gate(
        tmp_path,
        PASSING,
        "{key: position.p95, limit: 2.7 mm, reason: r}",
        "{key: position.max, limit: 3 mm, reason: r}",
        "{key: grade, limit: E, reason: r}",
        "{key: orientation.mean_error, limit: 0.2 deg, rule: guard_band, false_accept_risk: 0.01, reason: r}",
    )
    live = run(*ESTIMATE, "--gate", path, "--format", "json")
    after = run("check", str(stored / "estimate.json"), "--gate", path, "--format", "json")
    assert live.exit_code == after.exit_code == 4
    live, after = json.loads(live.stdout), json.loads(after.stdout)
    assert live["gate"] == after["gate"]
    assert (after["schema"], after["result"]["schema"]) == ("robacc.check/1", "robacc.estimate/1")
    kinds = [[record["kind"] for record in found["inputs"]] for found in (live, after)]
    assert kinds == [["poses", "robot", "gate"], ["result", "gate"]]


def test_held_out_figures_and_gains_of_a_calibration(stored: Path, tmp_path: Path) -> None:
    result = str(stored / "calibrate.json")
    good = gate(
        tmp_path,
        "{key: after.held_out.position.rms, limit: 0.5 mm, reason: r}",
        "{key: after.held_out.orientation.p95, limit: 1 deg, rule: guard_band, false_accept_risk: 0.05, reason: r}",
        "{key: after.held_out.position.max, limit: 1 mm, reason: r}",
        "{key: gain, at_least: 0.05 mm, reason: r}",
    )
    one = document("check", result, "--gate", good)["gate"]["criteria"][0]
    inside = json.loads((stored / "calibrate.json").read_text())["after"]["held_out"]["position"]
    assert one["value"] == inside["rms_m"]
    assert one["upper_bound"] == pytest.approx(inside["intervals"]["rms_m"]["upper_bound"], rel=1e-9)
    assert one["n_poses"] == inside["n_commanded_poses"] == 60


def carries_the_figures_of_its_own_errors(found: dict[str, Any], owners: Iterable[str]) -> None:
    for owner in owners:
        vectors, figure = errors_behind(found, owner).vectors, figure_at(found, f"{owner}.rms", 0.95)
        assert figure.value == pytest.approx(float((vectors**2).sum(axis=0).mean() ** 0.5), rel=1e-6), owner


def test_a_stored_calibration_carries_the_figures_of_its_own_errors(stored: Path) -> None:
    parts = (("nominal", "before", "after"), ("fitted", "held_out"), ("position", "orientation"))
    found = json.loads((stored / "calibrate.json").read_text())
    carries_the_figures_of_its_own_errors(found, map(".".join, product(*parts)))


@pytest.mark.slow
def test_a_trace_carries_the_figures_of_its_own_errors_too(tmp_path: Path) -> None:
    lines = Path(POSES).read_text().splitlines()
    x, cells = lines[1].split(",").index("x"), lines[8].split(",")
    cells[x] = repr(float(cells[x]) * 1.1)  # a broken beam, which is left out
    lines[8] = ",".join(cells)
    (tmp_path / "poses.csv").write_text("\n".join(lines) + "\n")
    command = ("trace", str(tmp_path / "poses.csv"), "--robot", ROBOT, "--declared", "base_frame,tool_frame")
    traced = document(*command, "--named-only")
    assert traced["poses"]["used"].count(False) == 1
    stages = ("nominal.held_out", "before.held_out", "after.held_out", "before.fitted", "after.fitted")
    carries_the_figures_of_its_own_errors(traced, (f"{stage}.position" for stage in stages))


def test_a_regression_gate_reads_its_baseline_from_beside_itself(stored: Path, tmp_path: Path) -> None:
    baseline = shutil.copy(stored / "estimate.json", tmp_path / "baseline.json")
    path = gate(tmp_path, "{key: position.rms, baseline: baseline.json, reason: r}")
    assert "1.80 mm, same as the 1.80 mm in baseline.json" in one_line(output(*ESTIMATE, "--gate", path))
    output(*ESTIMATE, "--align", "base_frame", "--gate", path)
    output(*ESTIMATE, "--align", "base_frame", "--format", "json", "-o", baseline)
    worse = run(*ESTIMATE, "--gate", path, "--format", "json")
    assert worse.exit_code == 4
    assert [record["kind"] for record in json.loads(worse.stdout)["inputs"]][-2:] == ["gate", "baseline"]
    baseline.unlink()
    assert f"{baseline}: the file does not exist" in refused(*ESTIMATE, "--gate", path, status=3)


def test_a_bad_gate_file_is_found_before_anything_is_computed(tmp_path: Path) -> None:
    path = gate(tmp_path, "{key: positon.p95, limit: 1 mm, reason: r}", "{key: position.rms, limit: 1, reason: r}")
    done = run("estimate", "nowhere.csv", "--gate", path)
    assert (done.exit_code, done.stdout) == (3, "")
    lines = done.stderr.splitlines()
    assert lines[0] == f"error: {path}:4, criteria[0].key: no result has the key 'positon.p95'"
    assert "expected a number with its unit" in lines[1]
    assert "  tip: did you mean position.p95?" in lines


def test_a_stored_result_that_is_not_what_its_command_writes(stored: Path, tmp_path: Path) -> None:
    document = json.loads((stored / "estimate.json").read_text())
    document["poses"]["group"] = ["a"] * 60
    (tmp_path / "odd.json").write_text(json.dumps(document))
    told = refused("check", tmp_path / "odd.json", "--gate", gate(tmp_path, PASSING), status=3)
    assert f"error: {tmp_path / 'odd.json'}, poses.group[0]: expected a whole number, found " in told


def test_junit_and_output_are_written_whatever_the_outcome(stored: Path, tmp_path: Path) -> None:
    path = gate(tmp_path, PASSING, FAILING, ELSEWHERE)
    junit, summary = tmp_path / "junit.xml", tmp_path / "summary.md"
    refused(*ESTIMATE, "--gate", path, "--junit", junit, "--format", "markdown", "-o", summary, status=4)
    (suite,) = ElementTree.parse(junit).getroot()
    assert (suite.get("tests"), suite.get("failures"), suite.get("errors")) == ("3", "1", "1")
    text = summary.read_text(encoding="utf-8")
    assert text.startswith("## robacc estimate\n")
    assert "Error of 60 measured poses" in text
    annotations = run(*ESTIMATE, "--gate", path, "--format", "github")
    assert annotations.exit_code == 4
    levels = [line.partition(" ")[0] for line in annotations.stdout.splitlines()]
    assert levels == ["::notice", "::error", "::warning", "::error"]


def test_a_table_ends_with_the_gate_and_a_stored_results_summary_is_the_gate_alone(
    stored: Path, tmp_path: Path
) -> None:
    path = gate(tmp_path, PASSING)
    table = output(*ESTIMATE, "--gate", path)
    assert missing(table, "Error of 60 measured poses", "Gate g: PASS (1 pass)\n") == []
    summary = output("check", stored / "estimate.json", "--gate", path, "--format", "markdown")
    assert summary.startswith("## robacc check\n\n### ✅ Gate g: PASS (1 pass)\n")
    assert summary.endswith("- **position.rms**: pass. Reason: r\n")


def test_predict_has_no_intervals_and_says_so(tmp_path: Path) -> None:
    tolerances = tmp_path / "t.yaml"
    tolerances.write_text("units: {length: mm, angle: deg}\nall: {theta: 0.01, d: 0.1, a: 0.1, alpha: 0.01}\n")
    command = ("predict", ROBOT, "--samples", "50", "--tolerances", tolerances, "--gate")
    done = run(*command, gate(tmp_path, "{key: position.p95, limit: 5 mm, reason: r}"))
    assert done.exit_code == 5, done.stderr
    assert "the result has no interval for position.p95, which rule: bound needs" in one_line(done.stdout)
    output(*command, gate(tmp_path, "{key: position.p95, limit: 5 mm, rule: simple, reason: r}"))


def test_the_same_call_gives_the_same_bytes(tmp_path: Path) -> None:
    path = gate(tmp_path, PASSING, FAILING, ELSEWHERE)
    made = []
    for _ in range(2):
        run(*ESTIMATE, "--gate", path, "--format", "json", "-o", tmp_path / "out", "--junit", tmp_path / "junit.xml")
        # A build server shows when and how long; all else is the same.
        timeless = re.sub(r' (time|timestamp)="[^"]*"', "", (tmp_path / "junit.xml").read_text(encoding="utf-8"))
        made.append(((tmp_path / "out").read_bytes(), timeless))
    assert made[0] == made[1]


READ = ("{poses.csv}", "--robot", "{robot.yaml}")
ESTIMATED = ("estimate", *READ)


@pytest.mark.parametrize(
    "words",
    [
        (*ESTIMATED, "--output", "{poses.csv}"),
        (*ESTIMATED, "--output", "{robot.yaml}"),
        (*ESTIMATED, "--output", "{link.csv}"),
        (*ESTIMATED, "--per-pose", "{poses.csv}"),
        (*ESTIMATED, "--gate", "{gate.yaml}", "--junit", "{gate.yaml}"),
        (*ESTIMATED, "--gate", "{gate.yaml}", "--junit", "{poses.csv}"),
        (*ESTIMATED, "--gate", "{regression.yaml}", "--output", "{base.json}"),
        ("calibrate", *READ, "--fit", "base_frame", "--write-model", "{robot.yaml}"),
        ("check", "{base.json}", "--gate", "{gate.yaml}", "--output", "{base.json}"),
    ],
)
def test_nothing_that_is_read_is_overwritten(words: tuple[str, ...], stored: Path, tmp_path: Path) -> None:
    for source in (POSES, ROBOT):
        shutil.copy(source, tmp_path)
    shutil.copy(stored / "estimate.json", tmp_path / "base.json")
    (tmp_path / "link.csv").symlink_to(tmp_path / "poses.csv")
    gate(tmp_path, "{key: position.rms, baseline: base.json, reason: r}", name="regression.yaml")
    gate(tmp_path, PASSING)
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    call = [str(tmp_path / word.strip("{}")) if word.startswith("{") else word for word in words]
    told = f"error: {call[-2]} {call[-1]} is also an input and would be overwritten; name another file"
    assert refused(*call) == told
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--output", "x", "--per-pose", "./x"), "error: --output and --per-pose both name "),
        (("--junit", "j.xml"), "error: --junit writes the outcome of a gate, so it needs --gate"),
    ],
)
def test_outputs_that_do_not_fit_the_call(options: tuple[str, ...], message: str) -> None:
    assert refused(*ESTIMATE, *options).startswith(message)


def test_examples_judge_what_they_are_written_for(stored: Path) -> None:
    found: dict[str, Any] = {}
    for name, result in (("assembly", "estimate"), ("machine_tending", "calibrate")):
        path = str(ROOT / "configs" / "gates" / f"{name}.yaml")
        done = run("check", str(stored / f"{result}.json"), "--gate", path, "--format", "json")
        assert done.exit_code in (0, 4, 5)
        found[name] = {one["key"]: one["outcome"] for one in json.loads(done.stdout)["gate"]["criteria"]}
    assert "not_evaluated" not in {outcome for one in found.values() for outcome in one.values()}
    assert found["machine_tending"]["after.held_out.position.p95"] == "pass"
