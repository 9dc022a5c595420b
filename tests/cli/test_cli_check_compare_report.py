"""`robacc check`, `compare` and `report` on stored results, and --gate and --report beside a command."""

import importlib.util
import json
import re
import shutil
from collections.abc import Callable, Iterable
from itertools import product
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import commands
import numpy as np
import pytest
import results
from commands import missing, one_line, output, refused, run
from pages import parsed
from sample_files import POSES, ROBOT, ROOT, UR10, saved

from robacc.comparison.stored_results import errors_behind
from robacc.gates import figure_at

# `robacc check`, and `--gate` with its outputs on the commands that have a result.

ESTIMATE = ("estimate", str(POSES), "--robot", str(ROBOT))

PASSING = "{key: position.rms, limit: 9 mm, reason: r}"

FAILING = "{key: position.p95, limit: 0.1 mm, reason: r}"

ELSEWHERE = "{key: verdict, limit: clean, reason: r}"


def gate(folder: Path, *criteria: str, name: str = "gate.yaml") -> str:
    path = saved(folder / name, "robacc_gate: 1\nname: g\ncriteria:\n" + "".join(f"  - {one}\n" for one in criteria))
    return str(path)


@pytest.fixture(scope="module")
def stored(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with ``estimate.json`` and ``calibrate.json`` of the sample data."""
    folder = tmp_path_factory.mktemp("stored")
    output(*ESTIMATE, "--format", "json", "-o", folder / "estimate.json")
    output("calibrate", POSES, "--robot", ROBOT, "--folds", "2", "--format", "json", "-o", folder / "calibrate.json")
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


def carries_the_figures_of_its_own_errors(found: dict[str, Any], owners: Iterable[str]) -> None:
    for owner in owners:
        vectors, figure = errors_behind(found, owner).vectors, figure_at(found, f"{owner}.rms", 0.95)
        assert figure.value == pytest.approx(float((vectors**2).sum(axis=0).mean() ** 0.5), rel=1e-6), owner


def test_a_stored_calibration_carries_the_figures_of_its_own_errors(stored: Path) -> None:
    parts = (("nominal", "before", "after"), ("fitted", "held_out"), ("position", "orientation"))
    carries_the_figures_of_its_own_errors(
        json.loads((stored / "calibrate.json").read_text()), map(".".join, product(*parts))
    )


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


def test_junit_and_output_are_written_whatever_the_outcome(stored: Path, tmp_path: Path) -> None:
    path = gate(tmp_path, PASSING, FAILING, ELSEWHERE)
    junit, summary = (tmp_path / name for name in ("junit.xml", "summary.md"))
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


# `robacc compare` from stored results to its table and its JSON.


run_compare, _, compared, refused_compare = commands.calls_of("compare")

PLACES = np.random.default_rng(7).uniform(-0.8, 0.8, (60, 3))


def poses_csv(path: Path, seed: int, scale: float, n: int = 60, shift: float = 0.0) -> str:
    """Commanded and attained positions, and ids; the same commands whatever the seed."""
    places = PLACES[:n] + shift
    attained = places + scale * np.random.default_rng(seed).standard_normal((n, 3))
    lines = ["pose,cmd_x,cmd_y,cmd_z,x,y,z"]
    lines += [",".join([f"P{i}", *(f"{value:.9f}" for value in (*places[i], *attained[i]))]) for i in range(n)]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return str(path)


@pytest.fixture(scope="module")
def estimates(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., str]:
    """Estimates of made-up robots, each computed once: the path of the result."""
    folder = tmp_path_factory.mktemp("results")

    def estimate(name: str, seed: int, scale: float, *options: str, **changes: Any) -> str:
        target = folder / f"{name}.json"
        if not target.exists():
            poses = poses_csv(folder / f"{name}.csv", seed, scale, **changes)
            output("estimate", poses, "--format", "json", "--output", target, *options)
        return str(target)

    return estimate


@pytest.fixture
def three(estimates: Callable[..., str]) -> tuple[str, str, str]:
    return estimates("good", 1, 5e-5), estimates("fair", 2, 5.5e-5), estimates("poor", 3, 2e-4)


@pytest.fixture
def good(three: tuple[str, str, str]) -> str:
    return three[0]


@pytest.fixture
def poor(three: tuple[str, str, str]) -> str:
    return three[2]


def test_equal_files_do_not_differ_and_warn_of_nothing(good: str, tmp_path: Path) -> None:
    copy = shutil.copy(good, tmp_path / "copy.json")
    result, found = run_compare(good, copy), compared(good, copy)
    assert (result.stderr, "- good and copy do not differ significantly" in result.stdout) == ("", True)
    for one in (row["differences"][0] for row in found["statistics"]):
        assert (one["value"], one["lower"], one["upper"], one["p_value"]) == (0.0, 0.0, 0.0, 1.0)
    assert [one["letters"] for one in found["ranking"]["order"]] == ["a", "a"]


def test_ranking_of_three_and_the_grade(three: tuple[str, str, str]) -> None:
    good, fair, poor = three
    found = compared(poor, good, fair, "--grade", "B")
    order = [(one["name"], one["letters"]) for one in found["ranking"]["order"]]
    assert order == [("good", "a"), ("fair", "a"), ("poor", "b")]
    assert found["ranking"]["indistinguishable"] == [["good", "fair"]]
    grade = found["grade"]
    assert (grade["wanted"], grade["scale"]) == ("B", "CAD/CAM 0.1 mm, 0.1 degree")
    assert grade["demonstrated_by"] == ["good", "fair"]
    verdicts = {one["name"]: one for one in grade["results"]}
    assert (verdicts["poor"]["verdict"], verdicts["poor"]["grade"]) == ("not_met", "D")
    assert verdicts["poor"]["probability"] < 0.01
    stored_grade = json.loads(Path(good).read_text(encoding="utf-8"))["grade"]
    # Computed again from errors that were stored with 12 digits.
    bound = stored_grade["position"]["upper_bound_m"]
    assert verdicts["good"]["position_upper_bound_m"] == pytest.approx(bound, rel=1e-11)
    table = one_line(run_compare(poor, good, fair, "--grade", "B").stdout)
    scale = "Grade B (scale: CAD/CAM 0.1 mm, 0.1 degree)"
    assert missing(table, scale, "each grade by itself is confirmed at 95 % confidence, not all together") == []


MACHINING = str(ROOT / "configs" / "grades" / "machining.yaml")


def test_a_grade_met_but_not_demonstrated_says_how_many_poses_it_takes(
    good: str, estimates: Callable[..., str]
) -> None:
    call = (estimates("near", 5, 7.5e-5, n=40), good, "--grade", "B")
    found = compared(*call)["grade"]["results"][0]
    assert found["verdict"] == "met_not_demonstrated"
    assert 0.5 < found["probability"] < 0.95
    assert found["poses_to_demonstrate"] > 40
    assert "poses in total would probably confirm it" in one_line(run_compare(*call).stdout)


def test_scales(good: str, poor: str, estimates: Callable[..., str]) -> None:
    found = compared(good, poor, "--grade", "medium", "--scale", MACHINING)
    assert (found["grade"]["statistic"], found["grade"]["demonstrated_by"]) == ("rms", ["good"])
    assert found["inputs"][-1]["kind"] == "scale"
    other = estimates("machined", 1, 5e-5, "--scale", MACHINING)
    told = "graded on CAD/CAM 0.1 mm, 0.1 degree and machining; choose the scale with --scale"
    assert told in refused_compare(good, other, "--grade", "B")
    told = "warning: made differently, grade scale: good: CAD/CAM 0.1 mm, 0.1 degree; machined: machining"
    assert told in run_compare(good, other).stderr


def test_what_was_made_differently_is_said(good: str, estimates: Callable[..., str]) -> None:
    other = estimates("elsewhere", 4, 5e-5, "--confidence", "0.9", n=50, shift=0.3)
    told = (
        "made differently, poses: good and elsewhere have different poses",
        "made differently, confidence: good: 0.95; elsewhere: 0.9 (the intervals are not comparable)",
    )
    assert missing(run_compare(good, other).stderr, *told) == []
    found = compared(good, other)
    assert not found["pairing"][0]["paired"]
    assert "Welch's degrees of freedom" in found["statistics"][0]["differences"][0]["method"]
    version = json.loads(Path(good).read_text(encoding="utf-8"))
    older = Path(other).with_name("older.json")
    older.write_text(json.dumps(version | {"robacc": "0.0.1"}), encoding="utf-8")
    assert re.search(r"made differently, robacc version: good: .*; older: 0.0.1", run_compare(good, str(older)).stderr)


def test_some_of_the_poses(good: str, estimates: Callable[..., str]) -> None:
    told = run_compare(good, estimates("part", 6, 5e-5, n=45)).stderr
    assert "share 45 of 60 poses; only these are compared" in told


def test_baseline_by_name_or_path(good: str, poor: str) -> None:
    by_name, by_path = (compared(good, poor, "--baseline", named) for named in ("poor", poor))
    difference = by_name["statistics"][0]["differences"][0]
    assert (by_name["baseline"], difference["name"], difference["value"] < 0.0) == ("poor", "good", True)
    assert (by_path["baseline"], by_path["statistics"]) == ("poor", by_name["statistics"])


def test_files_of_one_name_are_told_apart(good: str, poor: str, tmp_path: Path) -> None:
    paths = [tmp_path / folder / "result.json" for folder in ("one", "two")]
    for path, source in zip(paths, (good, poor), strict=True):
        path.parent.mkdir()
        shutil.copy(source, path)
    assert [one["name"] for one in compared(*paths)["results"]] == ["one/result", "two/result"]
    assert compared(good, good)["results"][1]["name"].endswith("good (2)")


def test_many_results_stand_in_rows(three: tuple[str, str, str], estimates: Callable[..., str]) -> None:
    more = [estimates(f"arm{i}", 10 + i, 1e-4) for i in range(3)]
    table = run_compare(*three, *more).stdout
    assert re.search(r"Position error, mm\n +rms +mean +95th percentile +maximum\n", table)
    assert re.search(r"\narm2 +0\.\d+ +0\.\d+ +0\.\d+ +0\.\d+\n", table)


def test_tables_fit_a_page(three: tuple[str, str, str]) -> None:
    for paths in (three[::2], three):
        lines = run_compare(*paths, "--grade", "B").stdout.splitlines()
        assert [line for line in lines if len(line) > 90 or line != line.rstrip()] == []


@pytest.fixture(scope="module")
def fits(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """An estimate, two calibrations and a prediction of one simulated arm."""
    folder = tmp_path_factory.mktemp("fits")
    poses, apart = (str(folder / f"{name}.csv") for name in ("poses", "holdout"))
    for path, seed in ((poses, "0"), (apart, "1")):
        output("simulate", UR10, "--poses", "40", "--noise", "0.05mm", "--seed", seed, "--output", path)
    fit = ("calibrate", poses, "--robot", UR10, "--folds", "2", "--fit")
    calls = {
        "estimate": ("estimate", poses, "--robot", UR10),
        "framed": ("estimate", poses, "--robot", UR10, "--frame", "base"),
        "frames": (*fit, "base_frame"),
        "offsets": (*fit, "base_frame,joint_offset[all]"),
        "predict": ("predict", UR10, "--samples", "50"),
    }
    for name, call in calls.items():
        output(*call, "--format", "json", "--output", folder / f"{name}.json")
    return {name: str(folder / f"{name}.json") for name in calls}


def test_an_estimate_beside_a_calibration(fits: dict[str, str]) -> None:
    result = run_compare(fits["estimate"], fits["offsets"])
    told = (
        "command: estimate: estimate; offsets: calibrate",
        "alignment: estimate: none; offsets: fitted with the model",
    )
    assert missing(result.stderr, *(f"made differently, {text}" for text in told)) == []
    framed = run_compare(fits["estimate"], fits["framed"]).stderr
    assert "made differently, frame: estimate: tool; framed: base" in framed
    found = compared(fits["estimate"], fits["offsets"])
    assert found["pairing"][0]["paired"]
    assert "position.rms" in [row["key"] for row in found["statistics"]]


def test_a_prediction_demonstrates_nothing_and_is_not_ranked_with_an_arm(fits: dict[str, str]) -> None:
    alone = compared(fits["estimate"], fits["predict"], "--grade", "D")
    predicted = alone["grade"]["results"][1]
    assert predicted["verdict"] in ("met_not_demonstrated", "not_met")
    assert (predicted["probability"], predicted["why"]) == (None, "predicted from tolerances, not measured")
    untested = alone["statistics"][0]["differences"][0]
    assert untested["p_value"] is None
    assert untested["why"].startswith("a prediction describes robots yet to be built")
    assert alone["statistics"][0]["differences"][0]["p_value"] is None
    assert [one["name"] for one in alone["ranking"]["order"]] == ["estimate"]
    assert (alone["ranking"]["pairs"], len(alone["ranking"]["text"])) == ([], 1)
    found = compared(fits["predict"], fits["estimate"], fits["frames"])["ranking"]
    assert {one["name"] for one in found["order"]} == {"estimate", "frames"}
    assert found["text"][-1] == "predict is a prediction, which is not ranked with measured arms"
    assert len(compared(fits["predict"], fits["predict"])["ranking"]["order"]) == 2


def test_files_of_poses_are_estimated_first(fits: dict[str, str], tmp_path: Path) -> None:
    poses = str(Path(fits["estimate"]).with_name("poses.csv"))
    apart = Path(poses).with_name("holdout.csv")
    other = str(tmp_path / "other.json")
    output("estimate", apart, "--robot", UR10, "--output", other)
    estimates, files = compared(fits["estimate"], other), compared(poses, str(apart), "--robot", str(UR10))
    figures, expected = (
        [[one["value"] for one in row["values"]] + [one["p_value"] for one in row["differences"]] for row in found]
        for found in (files["statistics"], estimates["statistics"])
    )
    assert figures == expected
    assert [one["name"] for one in files["inputs"]] == ["poses.csv", UR10.name, "holdout.csv"]
    assert [one["name"] for one in files["results"]] == ["poses", "holdout"]
    mixed = compared(fits["estimate"], str(apart), "--robot", str(UR10))
    assert mixed["ranking"]["order"][0]["value"] == estimates["ranking"]["order"][0]["value"]
    aligned = compared(poses, str(apart), "--robot", str(UR10), "--align", "base_frame")
    assert aligned["results"][0]["made"]["alignment"] == "base_frame registered"
    assert "--robot is for files of poses" in refused_compare(fits["estimate"], other, "--robot", UR10)


def test_iso9283_results_by_their_intervals(estimates: Callable[..., str], tmp_path: Path) -> None:
    poses, paths = tmp_path / "poses.csv", (tmp_path / "arm1.json", tmp_path / "arm2.json")
    for seed, path in enumerate(paths, start=1):
        output("simulate", UR10, "--poses", 5, "--cycles", 6, "--noise", "0.05mm", "--seed", seed, "-o", poses)
        output("iso9283", poses, "--robot", UR10, "--output", path)
    found = compared(*paths)
    difference = next(row for row in found["statistics"] if row["key"] == "iso9283.RP.max")["differences"][0]
    assert found["ranking"]["by"] == "iso9283.AP.max"
    assert "Zou and Donner" in difference["method"]
    assert difference["p_value"] is not None
    assert re.search(r"\nRP +\d", run_compare(*paths).stdout)
    told = "results of estimate and iso9283 have no figure in common to compare"
    assert told in refused_compare(estimates("good", 1, 5e-5), paths[0])


def test_standard_input_is_one_of_the_results(good: str, poor: str) -> None:
    found = compared("-", poor, text=Path(good).read_text(encoding="utf-8"))
    assert found["results"][0]["name"] == "standard input"


@pytest.mark.parametrize(
    ("arguments", "status", "message"),
    [
        (("{good}",), 2, "a comparison takes at least two results"),
        (("-", "-"), 2, "standard input can be read only once"),
        (("{good}", "{good}", "--scale", "x.yaml"), 2, "--scale needs --grade"),
        (("{good}", "{good}", "--grade", "Z"), 2, "has no grade 'Z'"),
        (("{good}", "{good}", "--baseline", "x"), 2, "no result is named 'x'"),
        (("{good}", "{good}", "--by", "x"), 2, "--by: the results have no common figure 'x'"),
        (("{good}", "none.json"), 3, "none.json: the file does not exist"),
    ],
)
def test_calls_and_files_that_are_wrong(good: str, arguments: tuple[str, ...], status: int, message: str) -> None:
    assert message in refused_compare(*(one.format(good=good) for one in arguments), status=status)


def test_the_problems_of_every_file_are_said_at_once(good: str, tmp_path: Path) -> None:
    cut, other = tmp_path / "cut.json", tmp_path / "other.json"
    cut.write_text(Path(good).read_text(encoding="utf-8")[:500], encoding="utf-8")
    other.write_text("{}", encoding="utf-8")
    told = refused_compare(cut, other, good, status=3)
    assert missing(told, "is incomplete; the file was truncated", "is not a result of robacc") == []


# ``robacc report`` and ``--report`` on the command line.

MAGIC = {"png": b"\x89PNG", "pdf": b"%PDF", "svg": b"<?xml"}


@pytest.fixture
def iso_result(tmp_path: Path) -> Path:
    return saved(tmp_path / "iso.json", results.text("iso9283"))


def test_a_stored_result_becomes_a_page(iso_result: Path) -> None:
    done = run("report", iso_result, "--identity", "serial_number=A-17", "--output", "-")
    assert (done.exit_code, done.stderr) == (0, "")
    text = done.stdout
    assert parsed(text).all("h1")[0].text.startswith("ISO 9283 pose criteria")
    assert text.startswith("<!doctype html>")
    assert "A-17" in text


def test_the_page_of_two_results_without_a_name_is_in_the_folder(
    iso_result: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert output("report", iso_result, iso_result) == "wrote report.html\n"
    header = parsed(Path("report.html").read_text(encoding="utf-8")).all("table")[0].all("tr")[0]
    assert [cell.text for cell in header.all("th")] == ["", "iso.json (1)", "iso.json (2)"]


def test_a_picture_without_a_kind_is_the_main_chart(iso_result: Path, tmp_path: Path) -> None:
    picture, old = tmp_path / "a.svg", tmp_path / "b.svg"
    done = results.run("report", str(iso_result), "-o", str(picture))
    note = "note: drew the main chart, iso9283; other charts by --chart: iso9283-cloud\n"
    assert (done.exit_code, done.stdout, done.stderr) == (0, "", note)
    done = results.run("plot", str(iso_result), "--kind", "iso9283", "-o", str(old))
    renamed = "note: robacc plot is now robacc report --chart; the old name works until 0.4\n"
    assert (done.exit_code, done.stdout, done.stderr) == (0, "", renamed)
    assert old.read_bytes() == picture.read_bytes()
    assert results.run("report", str(iso_result), str(iso_result), "--chart", "iso9283", "-o", str(old)).exit_code == 2


@pytest.mark.parametrize("command", ["iso9283", pytest.param("estimate", marks=pytest.mark.slow)])
def test_report_beside_the_command_is_the_page_beside_its_json(command: str, tmp_path: Path) -> None:
    page, beside = tmp_path / "a.html", tmp_path / "stored.html"
    assert "mm" in output(command, *results.CALLS[command], "--report", page)
    stored = saved(tmp_path / "stored.json", results.text(command))
    assert output("report", stored) == f"wrote {beside}\n"
    assert page.read_bytes() == beside.read_bytes()


@pytest.mark.parametrize("form", ["svg", "png", "pdf"])
def test_a_picture_becomes_a_file(form: str, iso_result: Path, tmp_path: Path) -> None:
    pictures = tmp_path / f"x.{form}", tmp_path / f"y.{form}"
    for picture in pictures:
        done = run("report", iso_result, "--chart", "iso9283", "--output", picture)
        assert (done.exit_code, done.stdout, done.stderr) == (0, "", "")
    data, again = (picture.read_bytes() for picture in pictures)
    assert (data[: len(MAGIC[form])], len(data) > 5000, data == again) == (MAGIC[form], True, True)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("{result}", "--chart", "poses", "-o", "{x}.gif"), "ends in .svg, .png or .pdf"),
        (("{result}", "--chart", "budget", "-o", "{x}.png"), "it has iso9283, iso9283-cloud"),
        (("{result}", "-o", "{result}"), "would be overwritten"),
        (("-", "-", "-o", "{x}.html"), "standard input can be read only once"),
        (("{result}", "--identity", "serial=A-17", "-o", "{x}.html"), "serial_number"),
    ],
)
def test_pages_and_charts_that_cannot_be_made(
    words: tuple[str, ...], message: str, iso_result: Path, tmp_path: Path
) -> None:
    assert message in refused("report", *(word.format(result=iso_result, x=tmp_path / "x") for word in words))
    assert not list(tmp_path.glob("x.*"))


@pytest.mark.parametrize("more", [(), ("--chart", "poses")])
def test_without_the_extra_the_way_to_it_is_said(
    more: tuple[str, ...], iso_result: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = importlib.util.find_spec
    monkeypatch.setattr(
        "robacc.render.plots.canvas.find_spec", lambda name: None if name == "matplotlib" else real(name)
    )
    told = refused("report", iso_result, *more, "-o", tmp_path / "x.png")
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
    broken = saved(tmp_path / "broken.json", json.dumps(document))
    assert missing(refused("report", broken, "-o", tmp_path / "x.html", status=3), "broken.json", told) == []
    assert not list(tmp_path.glob("*.html"))
