"""`robacc compare` from stored results to its table and its JSON."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import commands
import numpy as np
import pytest
from commands import missing, one_line, output

from robacc.comparison.stored_results import read_compared_result

ROOT = Path(__file__).resolve().parents[2]
ROBOT = ROOT / "configs" / "robots" / "ur10.yaml"
STAGES = {"position", "before.held_out.position", "nominal.held_out.position", "after.fitted.position"}
run, document, refused = (partial(call, "compare") for call in (commands.run, commands.document, commands.refused))
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
def stored(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., str]:
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
def three(stored: Callable[..., str]) -> tuple[str, str, str]:
    return stored("good", 1, 5e-5), stored("fair", 2, 5.5e-5), stored("poor", 3, 2e-4)


@pytest.fixture
def good(three: tuple[str, str, str]) -> str:
    return three[0]


@pytest.fixture
def poor(three: tuple[str, str, str]) -> str:
    return three[2]


def test_json_has_every_shared_figure_with_its_difference(good: str, poor: str) -> None:
    found = document(good, poor)
    assert (found["schema"], found["warnings"]) == ("robacc.compare/1", [])
    assert [one["name"] for one in found["inputs"]] == ["good.json", "poor.json"]
    results = [(one["name"], one["command"], one["n_poses"]) for one in found["results"]]
    assert results == [("good", "estimate", 60), ("poor", "estimate", 60)]
    assert found["pairing"] == [
        {"first": "good", "second": "poor", "paired": True, "n_shared": 60, "n_first": 60, "n_second": 60}
    ]
    one, other = (json.loads(Path(path).read_text(encoding="utf-8"))["position"] for path in (good, poor))
    rms = found["statistics"][0]
    assert (rms["key"], rms["unit"]) == ("position.rms", "m")
    assert [value["value"] for value in rms["values"]] == [one["rms_m"], other["rms_m"]]
    assert rms["values"][0]["lower"] == one["intervals"]["rms_m"]["lower"]
    difference = rms["differences"][0]
    assert difference["value"] == pytest.approx(other["rms_m"] - one["rms_m"], rel=1e-12)
    assert (difference["paired"], difference["n_poses"]) == (True, 60)
    assert 0.0 < difference["lower"] < difference["value"] < difference["upper"]
    assert difference["p_value"] < 1e-6
    keys = [row["key"].removeprefix("position.") for row in found["statistics"]]
    assert missing(keys, "p95", "max", "mean_x", "sd_z", "longest_sd") == []
    ranking = found["ranking"]
    assert (ranking["by"], ranking["text"]) == ("position.rms", ["good is better than poor"])
    assert [one["name"] for one in ranking["order"]] == ["good", "poor"]


def test_equal_files_do_not_differ_and_warn_of_nothing(good: str, tmp_path: Path) -> None:
    copy = shutil.copy(good, tmp_path / "copy.json")
    result, found = run(good, copy), document(good, copy)
    assert (result.stderr, "- good and copy do not differ significantly" in result.stdout) == ("", True)
    for one in (row["differences"][0] for row in found["statistics"]):
        assert (one["value"], one["lower"], one["upper"], one["p_value"]) == (0.0, 0.0, 0.0, 1.0)
    assert [one["letters"] for one in found["ranking"]["order"]] == ["a", "a"]


def test_ranking_of_three_and_the_grade(three: tuple[str, str, str]) -> None:
    good, fair, poor = three
    found = document(poor, good, fair, "--grade", "B")
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
    assert verdicts["good"]["position_upper_bound_m"] == stored_grade["position"]["upper_bound_m"]
    table = one_line(run(poor, good, fair, "--grade", "B").stdout)
    scale = "Grade B (scale: CAD/CAM 0.1 mm, 0.1 degree)"
    assert missing(table, scale, "each grade by itself is confirmed at 95 % confidence, not all together") == []


MACHINING = str(ROOT / "configs" / "grades" / "machining.yaml")


def test_a_grade_met_but_not_demonstrated_says_how_many_poses_it_takes(good: str, stored: Callable[..., str]) -> None:
    call = (stored("near", 5, 7.5e-5, n=40), good, "--grade", "B")
    found = document(*call)["grade"]["results"][0]
    assert found["verdict"] == "met_not_demonstrated"
    assert 0.5 < found["probability"] < 0.95
    assert found["poses_to_demonstrate"] > 40
    assert "poses in total would probably confirm it" in one_line(run(*call).stdout)


def test_scales(good: str, poor: str, stored: Callable[..., str]) -> None:
    found = document(good, poor, "--grade", "medium", "--scale", MACHINING)
    assert (found["grade"]["statistic"], found["grade"]["demonstrated_by"]) == ("rms", ["good"])
    assert found["inputs"][-1]["kind"] == "scale"
    other = stored("machined", 1, 5e-5, "--scale", MACHINING)
    told = "graded on CAD/CAM 0.1 mm, 0.1 degree and machining; choose the scale with --scale"
    assert told in refused(good, other, "--grade", "B")
    told = "warning: made differently, grade scale: good: CAD/CAM 0.1 mm, 0.1 degree; machined: machining"
    assert told in run(good, other).stderr


def test_what_was_made_differently_is_said(good: str, stored: Callable[..., str]) -> None:
    other = stored("elsewhere", 4, 5e-5, "--confidence", "0.9", n=50, shift=0.3)
    told = (
        "made differently, poses: good and elsewhere have different poses",
        "made differently, confidence: good: 0.95; elsewhere: 0.9 (the intervals are not comparable)",
    )
    assert missing(run(good, other).stderr, *told) == []
    found = document(good, other)
    assert not found["pairing"][0]["paired"]
    assert "Welch's degrees of freedom" in found["statistics"][0]["differences"][0]["method"]
    version = json.loads(Path(good).read_text(encoding="utf-8"))
    older = Path(other).with_name("older.json")
    older.write_text(json.dumps(version | {"robacc": "0.0.1"}), encoding="utf-8")
    assert re.search(r"made differently, robacc version: good: .*; older: 0.0.1", run(good, str(older)).stderr)


def test_some_of_the_poses(good: str, stored: Callable[..., str]) -> None:
    told = run(good, stored("part", 6, 5e-5, n=45)).stderr
    assert "share 45 of 60 poses; only these are compared" in told


def test_baseline_by_name_or_path(good: str, poor: str) -> None:
    by_name, by_path = (document(good, poor, "--baseline", named) for named in ("poor", poor))
    difference = by_name["statistics"][0]["differences"][0]
    assert (by_name["baseline"], difference["name"], difference["value"] < 0.0) == ("poor", "good", True)
    assert (by_path["baseline"], by_path["statistics"]) == ("poor", by_name["statistics"])


def test_files_of_one_name_are_told_apart(good: str, poor: str, tmp_path: Path) -> None:
    paths = [tmp_path / folder / "result.json" for folder in ("one", "two")]
    for path, source in zip(paths, (good, poor), strict=True):
        path.parent.mkdir()
        shutil.copy(source, path)
    assert [one["name"] for one in document(*paths)["results"]] == ["one/result", "two/result"]
    assert document(good, good)["results"][1]["name"].endswith("good (2)")


def test_many_results_stand_in_rows(three: tuple[str, str, str], stored: Callable[..., str]) -> None:
    more = [stored(f"arm{i}", 10 + i, 1e-4) for i in range(3)]
    table = run(*three, *more).stdout
    assert re.search(r"Position error, mm\n +rms +mean +95th percentile +maximum\n", table)
    assert re.search(r"\narm2 +0\.\d+ +0\.\d+ +0\.\d+ +0\.\d+\n", table)


def test_tables_fit_a_page(three: tuple[str, str, str]) -> None:
    for paths in (three[::2], three):
        lines = run(*paths, "--grade", "B").stdout.splitlines()
        assert [line for line in lines if len(line) > 90 or line != line.rstrip()] == []


@pytest.fixture(scope="module")
def fits(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """An estimate, two calibrations and a prediction of one simulated arm."""
    folder = tmp_path_factory.mktemp("fits")
    poses, apart = (str(folder / f"{name}.csv") for name in ("poses", "holdout"))
    for path, seed in ((poses, "0"), (apart, "1")):
        output("simulate", ROBOT, "--poses", "40", "--noise", "0.05mm", "--seed", seed, "--output", path)
    fit = ("calibrate", poses, "--robot", ROBOT, "--folds", "2", "--fit")
    calls = {
        "estimate": ("estimate", poses, "--robot", ROBOT),
        "frames": (*fit, "base_frame"),
        "offsets": (*fit, "base_frame,joint_offset[all]"),
        "apart": (*fit, "base_frame", "--holdout", apart),
        "predict": ("predict", ROBOT, "--samples", "50"),
    }
    for name, call in calls.items():
        output(*call, "--format", "json", "--output", folder / f"{name}.json")
    return {name: str(folder / f"{name}.json") for name in calls}


@pytest.mark.slow
def test_two_calibrations_stage_by_stage(fits: dict[str, str]) -> None:
    found = document(fits["frames"], fits["offsets"])
    rows = {row["key"]: row for row in found["statistics"]}
    same = rows["nominal.held_out.position.rms"]["differences"][0]
    assert (same["value"], same["p_value"], same["method"]) == (0.0, 1.0, "the same at every pose")
    after = rows["position.rms"]["differences"][0]
    assert (after["paired"], after["p_value"] is None) == (True, False)
    one = json.loads(Path(fits["frames"]).read_text(encoding="utf-8"))["after"]
    figures = [rows[key]["values"][0]["value"] for key in ("position.rms", "after.fitted.position.rms")]
    assert figures == [one[kind]["position"]["rms_m"] for kind in ("held_out", "fitted")]
    table = run(fits["frames"], fits["offsets"]).stdout
    assert re.search(r"Position rms, mm\s+frames +offsets", table)
    assert "extended model, calibration poses" in table


@pytest.mark.parametrize("name", ["estimate", "frames", "apart"])
@pytest.mark.slow
def test_figures_are_those_of_the_errors_they_are_tested_by(fits: dict[str, str], name: str) -> None:
    found = read_compared_result(json.loads(Path(fits[name]).read_text(encoding="utf-8")), name, name, "")
    owners = {"estimate": {"position"}, "frames": STAGES, "apart": STAGES}[name]
    assert {owner for owner in found.errors if owner.endswith("position")} == owners
    for owner, errors in found.errors.items():
        lengths = np.linalg.norm(errors.vectors, axis=0)
        # Errors of a fit are stored to 1e-12 m.
        assert found.figures[f"{owner}.rms"].value == pytest.approx(np.sqrt(np.mean(lengths**2)), abs=2e-12)
        assert found.figures[f"{owner}.max"].value == pytest.approx(np.max(lengths), abs=2e-12)


def test_an_estimate_beside_a_calibration(fits: dict[str, str]) -> None:
    result = run(fits["estimate"], fits["offsets"])
    told = (
        "command: estimate: estimate; offsets: calibrate",
        "alignment: estimate: none; offsets: fitted with the model",
    )
    assert missing(result.stderr, *(f"made differently, {text}" for text in told)) == []
    found = document(fits["estimate"], fits["offsets"])
    assert found["pairing"][0]["paired"]
    assert "position.rms" in [row["key"] for row in found["statistics"]]


def test_a_prediction_demonstrates_nothing_and_is_not_ranked_with_an_arm(fits: dict[str, str]) -> None:
    alone = document(fits["estimate"], fits["predict"], "--grade", "D")
    predicted = alone["grade"]["results"][1]
    assert predicted["verdict"] in ("met_not_demonstrated", "not_met")
    assert (predicted["probability"], predicted["why"]) == (None, "predicted from tolerances, not measured")
    assert alone["statistics"][0]["differences"][0]["p_value"] is None
    assert [one["name"] for one in alone["ranking"]["order"]] == ["estimate"]
    assert (alone["ranking"]["pairs"], len(alone["ranking"]["text"])) == ([], 1)
    found = document(fits["predict"], fits["estimate"], fits["frames"])["ranking"]
    assert {one["name"] for one in found["order"]} == {"estimate", "frames"}
    assert found["text"][-1] == "predict is a prediction, which is not ranked with measured arms"
    assert len(document(fits["predict"], fits["predict"])["ranking"]["order"]) == 2


def test_files_of_poses_are_estimated_first(fits: dict[str, str], tmp_path: Path) -> None:
    poses = str(Path(fits["estimate"]).with_name("poses.csv"))
    apart = Path(poses).with_name("holdout.csv")
    other = str(tmp_path / "other.json")
    output("estimate", apart, "--robot", ROBOT, "--output", other)
    stored, files = document(fits["estimate"], other), document(poses, str(apart), "--robot", str(ROBOT))
    figures, expected = (
        [[one["value"] for one in row["values"]] + [one["p_value"] for one in row["differences"]] for row in found]
        for found in (files["statistics"], stored["statistics"])
    )
    assert figures == expected
    assert [one["name"] for one in files["inputs"]] == ["poses.csv", ROBOT.name, "holdout.csv"]
    assert [one["name"] for one in files["results"]] == ["poses", "holdout"]
    mixed = document(fits["estimate"], str(apart), "--robot", str(ROBOT))
    assert mixed["ranking"]["order"][0]["value"] == stored["ranking"]["order"][0]["value"]
    aligned = document(poses, str(apart), "--robot", str(ROBOT), "--align", "base_frame")
    assert aligned["results"][0]["made"]["alignment"] == "base_frame registered"
    assert "--robot is for files of poses" in refused(fits["estimate"], other, "--robot", ROBOT)


def test_iso9283_results_by_their_intervals(tmp_path: Path) -> None:
    poses, paths = tmp_path / "poses.csv", (tmp_path / "arm1.json", tmp_path / "arm2.json")
    for seed, path in enumerate(paths, start=1):
        output("simulate", ROBOT, "--poses", 5, "--cycles", 6, "--noise", "0.05mm", "--seed", seed, "-o", poses)
        output("iso9283", poses, "--robot", ROBOT, "--output", path)
    found = document(*paths)
    difference = next(row for row in found["statistics"] if row["key"] == "iso9283.RP.max")["differences"][0]
    assert found["ranking"]["by"] == "iso9283.AP.max"
    assert "Zou and Donner" in difference["method"]
    assert difference["p_value"] is not None
    assert re.search(r"\nRP +\d", run(*paths).stdout)


def test_standard_input_is_one_of_the_results(good: str, poor: str) -> None:
    found = document("-", poor, text=Path(good).read_text(encoding="utf-8"))
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
    assert message in refused(*(one.format(good=good) for one in arguments), status=status)


def test_the_problems_of_every_file_are_said_at_once(good: str, tmp_path: Path) -> None:
    cut, other = tmp_path / "cut.json", tmp_path / "other.json"
    cut.write_text(Path(good).read_text(encoding="utf-8")[:500], encoding="utf-8")
    other.write_text("{}", encoding="utf-8")
    told = refused(cut, other, good, status=3)
    assert missing(told, "is incomplete; the file was truncated", "is not a result of robacc") == []
