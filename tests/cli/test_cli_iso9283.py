"""`robacc iso9283` and `robacc iso9283-poses` from files to tables, JSON, CSV and exit statuses."""

from __future__ import annotations

import csv
import hashlib
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from robacc.cli.main import app

ROOT = Path(__file__).resolve().parents[2]
SAMPLE = ROOT / "sample_data" / "iso9283"
POSES, ROBOT = SAMPLE / "poses.csv", SAMPLE / "robot.yaml"
SCARA = ROOT / "configs" / "robots" / "scara.yaml"


def run(*arguments: str, text: str | None = None) -> Result:
    return CliRunner().invoke(app, list(arguments), input=text, catch_exceptions=False)


def document(*arguments: str) -> dict[str, Any]:
    result = run("iso9283", *arguments, "--format", "json")
    assert result.exit_code == 0
    found: dict[str, Any] = json.loads(result.stdout, parse_constant=pytest.fail)
    return found


@pytest.fixture(scope="module")
def sample() -> dict[str, Any]:
    return document(str(POSES), "--rated-load", "6")


def rows() -> list[dict[str, str]]:
    lines = [line for line in POSES.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    return list(csv.DictReader(lines))


def test_json_has_its_keys_and_the_right_numbers(sample: dict[str, Any]) -> None:
    assert (sample["schema"], sample["n_poses"], sample["n_commanded_poses"]) == ("robacc.iso9283/1", 150, 5)
    digest = hashlib.sha256(POSES.read_bytes()).hexdigest()
    assert sample["inputs"] == [{"name": "poses.csv", "sha256": digest, "kind": "poses"}]
    found = sample["iso9283"]
    assert list(found) == ["AP", "RP", "vAP", "AD", "RD", "drift", "exchangeability"]
    accuracy, repeatability = {}, {}
    for name in ("P1", "P2", "P3", "P4", "P5"):
        own = [row for row in rows() if row["pose"] == name]
        attained = np.array([[float(row[axis]) for axis in "xyz"] for row in own])
        commanded = np.array([float(own[0][f"cmd_{axis}"]) for axis in "xyz"])
        length = np.linalg.norm(attained - attained.mean(axis=0), axis=1)
        accuracy[name] = float(np.linalg.norm(attained.mean(axis=0) - commanded))
        repeatability[name] = float(length.mean() + 3 * length.std(ddof=1))
    for key, expected in (("AP", accuracy), ("RP", repeatability)):
        assert {one["pose"]: one["position_m"] for one in found[key]["poses"]} == pytest.approx(expected, rel=1e-9)
        assert found[key]["max_m"] == pytest.approx(max(expected.values()), rel=1e-9)
        assert found[key]["max_at"] == max(expected, key=expected.__getitem__)
        interval = found[key]["intervals"]["max_m"]
        assert interval["lower"] < found[key]["max_m"] < interval["upper_bound"] < interval["upper"]
        assert interval["confidence"] == 0.95
    assert found["AP"]["orientation"]["max_rad"] == pytest.approx(4.0e-4, rel=0.05)
    assert set(found["drift"]) == {"AP", "RP", "barycentre"}
    for missing in (found["vAP"], found["exchangeability"]):
        assert missing["max_m"] is None
        assert missing["why"]
    assert len(found["AD"]["poses"]) == 10
    assert found["AD"]["poses"][0]["poses"] == ["P1", "P2"]


def test_json_says_which_conditions_are_met(sample: dict[str, Any]) -> None:
    status = {one["condition"]: one["status"] for one in sample["protocol"]}
    assert status["five poses"] == status["diagonal plane"] == status["10 % from the corners"] == "met"
    assert status["30 cycles"] == status["rated load"] == status["temperature"] == "met"
    assert status["stabilisation"] == status["warm-up"] == status["rated velocity"] == "unknown"


def test_json_holds_every_visit(sample: dict[str, Any]) -> None:
    first = sample["visits"][0]
    assert (first["pose"], first["n"], len(first["attained_m"])) == ("P1", 30, 30)
    assert first["barycentre_m"] == pytest.approx(np.mean(first["attained_m"], axis=0).tolist())


def test_equal_input_gives_equal_bytes() -> None:
    one, other = (run("iso9283", str(POSES), "--format", "json").stdout for _ in range(2))
    assert one == other


def test_table_keeps_accuracy_and_repeatability_apart() -> None:
    result = run("iso9283", str(POSES), "--ordered")
    assert result.exit_code == 0
    blocks = result.stdout.split("\n\n")
    accuracy = next(block for block in blocks if block.startswith("Accuracy: "))
    repeatability = next(block for block in blocks if block.startswith("Repeatability: "))
    assert "RP" not in accuracy
    assert "RD" not in accuracy
    assert "accuracy" not in repeatability.lower()
    titles = [block.splitlines()[0] for block in blocks]
    assert sum("(not accuracy)" in title for title in titles) == 3
    assert all("(not accuracy)" in title for title in titles if title.startswith(("Pose repeat", "Distance repeat")))
    assert "every commanded pose was always approached from the same direction" in " ".join(result.stdout.split())
    assert max(map(len, result.stdout.splitlines())) <= 80
    assert "30 cycles              6.9     met" in result.stdout


def test_robot_and_alignment() -> None:
    """The robot commands the poses as the cmd_ columns do; a frame fitted to them takes part of AP away, RP stays."""
    given, robot = document(str(POSES)), document(str(POSES), "--robot", str(ROBOT))
    assert robot["commanded"] == "robot"
    assert robot["iso9283"]["AP"]["max_m"] == pytest.approx(given["iso9283"]["AP"]["max_m"], rel=1e-6)
    aligned = document(str(POSES), "--robot", str(ROBOT), "--align", "base_frame")
    assert aligned["unaligned"]["AP_max_m"] == pytest.approx([given["iso9283"]["AP"]["max_m"]], rel=1e-6)
    assert aligned["iso9283"]["AP"]["max_m"] < 0.7 * given["iso9283"]["AP"]["max_m"]
    assert aligned["iso9283"]["RP"]["max_m"] == given["iso9283"]["RP"]["max_m"]
    assert aligned["alignment"][0]["what"] == ["base_frame"]
    assert any("fitted to the same poses" in note for note in aligned["notes"])
    shown = run("iso9283", str(POSES), "--robot", str(ROBOT), "--align", "base_frame").stdout
    assert "registered: base_frame fitted, 6 parameters" in shown
    assert "largest AP before registration: 0.137 mm" in shown


@pytest.mark.slow
def test_several_files_are_robots(tmp_path: Path) -> None:
    other = tmp_path / "other.csv"
    made = run(
        *("simulate", str(ROBOT), "--at", str(SAMPLE / "plan.csv"), "--seed", "3"),
        *("--noise", "0.01mm", "--commanded", "-o", str(other)),
    )
    assert made.exit_code == 0
    found = document(str(POSES), str(other))
    assert found["files"] == ["poses.csv", "other.csv"]
    barycentres = [
        {one["pose"]: one["barycentre_m"] for one in found["visits"] if one["file"] == name} for name in found["files"]
    ]
    apart = {name: float(np.linalg.norm(np.subtract(*(b[name] for b in barycentres)))) for name in barycentres[0]}
    exchangeability = found["iso9283"]["exchangeability"]
    assert {one["pose"]: one["position_m"] for one in exchangeability["poses"]} == pytest.approx(apart, rel=1e-9)
    assert exchangeability["max_m"] == pytest.approx(max(apart.values()), rel=1e-9)
    shown = run("iso9283", str(POSES), str(other)).stdout
    assert "Exchangeability E by pose, mm" in shown
    assert "poses.csv and other.csv" in shown
    aligned = document(str(POSES), str(other), "--robot", str(ROBOT), "--align", "base_frame")
    assert aligned["iso9283"]["exchangeability"]["max_m"] < exchangeability["max_m"]


@pytest.mark.parametrize(
    ("limit", "status", "word"), [("1 mm", 0, "pass"), ("0.01 mm", 4, "fail"), ("0.08 mm", 5, "inconclusive")]
)
def test_gate(tmp_path: Path, limit: str, status: int, word: str) -> None:
    gate = tmp_path / "gate.yaml"
    gate.write_text(
        f"robacc_gate: 1\nname: cell\ncriteria:\n  - key: iso9283.RP.max\n    limit: {limit}\n    reason: a test\n",
        encoding="utf-8",
    )
    result = run("iso9283", str(POSES), "--gate", str(gate), "--format", "json")
    assert result.exit_code == status
    # Standard output is the document; the log of a job has the outcome all the same.
    assert result.stderr.startswith(f"Gate cell: {word.upper()} (1 {word})" if status else "")
    assert bool(result.stderr) == bool(status)
    assert json.loads(result.stdout)["gate"]["criteria"][0]["outcome"] == word


def test_what_the_data_lack_is_not_evaluated(tmp_path: Path) -> None:
    gate = tmp_path / "gate.yaml"
    gate.write_text(
        "robacc_gate: 1\nname: cell\ncriteria:\n  - key: iso9283.vAP.max\n    limit: 1 mm\n    reason: a test\n",
        encoding="utf-8",
    )
    result = run("iso9283", str(POSES), "--gate", str(gate), "--format", "json")
    assert result.exit_code == 5
    criterion = json.loads(result.stdout)["gate"]["criteria"][0]
    assert criterion["outcome"] == "not_evaluated"
    assert "approach directions are not known" in criterion["why"]


def test_positions_of_one_pose_without_a_command() -> None:
    text = "pose,x_mm,y_mm,z_mm\nP1,0,0,0\nP1,0,0,0.1\nP1,0.1,0,0\n"
    result = run("iso9283", "-", text=text)
    assert result.exit_code == 0
    assert "1 commanded pose, 3 visits\nno commanded poses" in result.stdout
    assert "no AP (pose accuracy): the commanded poses are not known" in " ".join(result.stdout.split())
    assert "RP  pose repeatability" in result.stdout


@pytest.mark.parametrize(
    ("arguments", "status", "message"),
    [
        (("iso9283", "-", "-"), 2, "standard input can be read only once"),
        (("iso9283", str(POSES), "--base-link", "x"), 2, "choose a chain of a URDF, so they need --robot"),
        (("iso9283", str(POSES), "--align", "backlash"), 2, "cannot align backlash"),
        (("iso9283", str(POSES), "--drift-windows", "1"), 2, "--drift-windows is at least 2, not 1"),
        (("iso9283", "nowhere.csv"), 3, "nowhere.csv"),
        (("iso9283-poses", str(SCARA)), 3, "found no cube of 250 mm or more"),
        (("iso9283-poses", str(SCARA), "--edge", "15deg"), 2, "--edge: expected a number with a unit"),
        (("iso9283-poses", str(SCARA), "--format", "json"), 2, "--format json needs --output"),
        (("simulate", str(ROBOT)), 2, "give either --poses"),
        (("simulate", str(ROBOT), "--at", str(SAMPLE / "plan.csv"), "--cycles", "2"), 2, "have cycles already"),
    ],
)
def test_errors(arguments: tuple[str, ...], status: int, message: str) -> None:
    result = run(*arguments)
    assert result.exit_code == status
    assert message in result.stderr
    assert result.stdout == ""


@pytest.mark.slow
def test_sample_data_are_what_their_commands_make(tmp_path: Path) -> None:
    plan, poses = tmp_path / "plan.csv", tmp_path / "poses.csv"
    assert run("iso9283-poses", str(ROBOT), "--payload", "6", "-o", str(plan)).exit_code == 0
    assert "cube with an edge of 630 mm" in plan.read_text(encoding="utf-8")
    command = next(line for line in (ROOT / "sample_data" / "README.md").read_text().splitlines() if "--at" in line)
    arguments = [str(ROOT / one) if one.startswith("sample_data") else one for one in command.split()[1:]]
    arguments[arguments.index("-o") + 1] = str(poses)
    assert run(*arguments).exit_code == 0
    # Not the bytes: another machine's mathematical library may round a sine the other way.
    assert agrees(POSES.read_text(encoding="utf-8"), poses.read_text(encoding="utf-8"))


def agrees(stored: str, made: str) -> bool:
    """Return whether two files hold the same text, and numbers that are the same to 1e-12."""
    cells = zip(re.split(r"[,\n]", stored), re.split(r"[,\n]", made), strict=True)
    return all(a == b or abs(float(a) - float(b)) <= 1e-12 for a, b in cells)


def test_planned_poses_are_met_by_the_robot(tmp_path: Path) -> None:
    """Simulated without effects or noise at the planned joints, the robot is where the plan commands it, to 1e-9."""
    plan, visited = tmp_path / "plan.csv", tmp_path / "visited.csv"
    made = run("iso9283-poses", str(SCARA), "--edge", "150mm", "--cycles", "2", "-o", str(plan))
    assert made.exit_code == 0
    assert "cube with an edge of 150 mm" in made.stdout
    assert "j3, mm" in made.stdout
    assert max(map(len, made.stdout.splitlines())) <= 80
    assert run("simulate", str(SCARA), "--at", str(plan), "-o", str(visited)).exit_code == 0
    wanted, attained = (
        list(csv.DictReader(line for line in path.read_text().splitlines() if not line.startswith("#")))
        for path in (plan, visited)
    )
    assert [(row["pose"], row["cycle"]) for row in wanted] == [(row["pose"], row["cycle"]) for row in attained]
    for axis in "xyz":
        apart = [float(a[axis]) - float(b[f"cmd_{axis}"]) for a, b in zip(attained, wanted, strict=True)]
        assert np.max(np.abs(apart)) < 1e-9


def test_plan_on_standard_output_and_as_json(tmp_path: Path) -> None:
    printed = run("iso9283-poses", str(ROBOT), "--cycles", "1", "--plane", "y+", "--edge", "400mm")
    assert printed.exit_code == 0
    lines = [line for line in printed.stdout.splitlines() if not line.startswith("#")]
    assert (len(lines), "cycle" in lines[0], "x" in lines[0].split(",")) == (6, False, False)
    assert "towards y+" in printed.stdout
    told = run("iso9283-poses", str(ROBOT), "--format", "json", "-o", str(tmp_path / "plan.csv"))
    found = json.loads(told.stdout)
    assert found["schema"] == "robacc.iso9283-poses/1"
    assert found["cube"]["edge_m"] == 0.63
    assert [one["pose"] for one in found["poses"]] == ["P1", "P2", "P3", "P4", "P5"]


def test_planned_poses_without_measurements_are_refused() -> None:
    result = run("iso9283", str(SAMPLE / "plan.csv"))
    assert result.exit_code == 3
    assert "columns x, y, z are missing" in result.stderr
