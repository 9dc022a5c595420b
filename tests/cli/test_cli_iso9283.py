"""`robacc iso9283` and `robacc plan --for iso9283` from files to tables, JSON, CSV and exit statuses."""

from __future__ import annotations

import csv
import hashlib
import json
import re
from functools import partial
from pathlib import Path
from typing import Any

import commands
import numpy as np
import pytest
from commands import missing, one_line, output, refused, run

ROOT = Path(__file__).resolve().parents[2]
SAMPLE = ROOT / "sample_data" / "iso9283"
POSES, ROBOT = SAMPLE / "poses.csv", SAMPLE / "robot.yaml"
document = partial(commands.document, "iso9283")
SCARA = ROOT / "configs" / "robots" / "scara.yaml"


@pytest.fixture(scope="module")
def sample() -> dict[str, Any]:
    return document(str(POSES), "--rated-load", "6")


def rows(path: Path) -> list[dict[str, str]]:
    lines = path.read_text(encoding="utf-8").splitlines()
    return list(csv.DictReader(line for line in lines if not line.startswith("#")))


def test_json_has_its_keys_and_the_right_numbers(sample: dict[str, Any]) -> None:
    assert (sample["schema"], sample["n_poses"], sample["n_commanded_poses"]) == ("robacc.iso9283/1", 150, 5)
    digest = hashlib.sha256(POSES.read_bytes()).hexdigest()
    assert sample["inputs"] == [{"name": "poses.csv", "sha256": digest, "kind": "poses"}]
    found = sample["iso9283"]
    assert list(found) == ["AP", "RP", "vAP", "AD", "RD", "drift", "exchangeability"]
    accuracy, repeatability = {}, {}
    for name in ("P1", "P2", "P3", "P4", "P5"):
        own = [row for row in rows(POSES) if row["pose"] == name]
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
    for absent in (found["vAP"], found["exchangeability"]):
        assert (absent["max_m"], bool(absent["why"])) == (None, True)
    assert (len(found["AD"]["poses"]), found["AD"]["poses"][0]["poses"]) == (10, ["P1", "P2"])
    met = ("five poses", "diagonal plane", "10 % from the corners", "30 cycles", "rated load", "temperature")
    unknown = ("stabilisation", "warm-up", "rated velocity")
    status = {one["condition"]: one["status"] for one in sample["protocol"]}
    assert dict.fromkeys(met, "met") | dict.fromkeys(unknown, "unknown") | status == status
    first = sample["visits"][0]
    assert (first["pose"], first["n"], len(first["attained_m"])) == ("P1", 30, 30)
    assert first["barycentre_m"] == pytest.approx(np.mean(first["attained_m"], axis=0).tolist())


def test_table_keeps_accuracy_and_repeatability_apart() -> None:
    table = output("iso9283", POSES, "--ordered", "--full")
    blocks = table.split("\n\n")
    accuracy = next(block for block in blocks if block.startswith("Accuracy: "))
    repeatability = next(block for block in blocks if block.startswith("Repeatability: "))
    assert missing(accuracy, "RP", "RD") == ["RP", "RD"]
    assert "accuracy" not in repeatability.lower()
    titles = [block.splitlines()[0] for block in blocks]
    assert sum("(not accuracy)" in title for title in titles) == 3
    assert all("(not accuracy)" in title for title in titles if title.startswith(("Pose repeat", "Distance repeat")))
    assert "every commanded pose was always approached from the same direction" in one_line(table)
    assert max(map(len, table.splitlines())) <= 80
    assert "30 cycles              6.9     met" in table


def test_robot_and_alignment() -> None:
    """The robot commands the poses as the cmd_ columns do; a frame fitted to them takes part of AP away, RP stays."""
    call = (POSES, "--robot", ROBOT)
    given, robot, aligned = document(POSES), document(*call), document(*call, "--align", "base_frame")
    accuracy, repeatability = (
        [one["iso9283"][key]["max_m"] for one in (given, robot, aligned)] for key in ("AP", "RP")
    )
    assert (robot["commanded"], accuracy[1]) == ("robot", pytest.approx(accuracy[0], rel=1e-6))
    assert aligned["unaligned"]["AP_max_m"] == pytest.approx([accuracy[0]], rel=1e-6)
    assert accuracy[2] < 0.7 * accuracy[0]
    assert repeatability[2] == repeatability[0]
    assert aligned["alignment"][0]["what"] == ["base_frame"]
    assert any("fitted to the same poses" in note for note in aligned["notes"])
    shown = output("iso9283", *call, "--align", "base_frame")
    told = ("registered: base_frame fitted, 6 parameters", "largest AP before registration: 0.137 mm")
    assert missing(shown, *told) == []


@pytest.mark.slow
def test_several_files_are_robots(tmp_path: Path) -> None:
    other = tmp_path / "other.csv"
    options = ("--seed", "3", "--noise", "0.01mm", "--commanded", "-o", other)
    output("simulate", ROBOT, "--at", SAMPLE / "plan.csv", *options)
    found = document(str(POSES), str(other))
    assert found["files"] == ["poses.csv", "other.csv"]
    barycentres = [
        {one["pose"]: one["barycentre_m"] for one in found["visits"] if one["file"] == name} for name in found["files"]
    ]
    apart = {name: float(np.linalg.norm(np.subtract(*(b[name] for b in barycentres)))) for name in barycentres[0]}
    exchangeability = found["iso9283"]["exchangeability"]
    assert {one["pose"]: one["position_m"] for one in exchangeability["poses"]} == pytest.approx(apart, rel=1e-9)
    assert exchangeability["max_m"] == pytest.approx(max(apart.values()), rel=1e-9)
    shown = run("iso9283", str(POSES), str(other), "--full").stdout
    assert missing(shown, "Exchangeability E by pose, mm", "poses.csv and other.csv") == []
    aligned = document(str(POSES), str(other), "--robot", str(ROBOT), "--align", "base_frame")
    assert aligned["iso9283"]["exchangeability"]["max_m"] < exchangeability["max_m"]


@pytest.mark.parametrize(
    ("key", "limit", "status", "outcome"),
    [
        ("RP", "1 mm", 0, "pass"),
        ("RP", "0.01 mm", 4, "fail"),
        ("RP", "0.08 mm", 5, "inconclusive"),
        ("vAP", "1 mm", 5, "not_evaluated"),
    ],
)
def test_gate(tmp_path: Path, key: str, limit: str, status: int, outcome: str) -> None:
    gate = tmp_path / "gate.yaml"
    criterion = f"{{key: iso9283.{key}.max, limit: {limit}, reason: a test}}"
    gate.write_text(f"robacc_gate: 1\nname: cell\ncriteria:\n  - {criterion}\n", encoding="utf-8")
    result = run("iso9283", POSES, "--gate", gate, "--format", "json")
    assert result.exit_code == status
    if key == "RP":
        # Standard output is the document; the log of a job has the outcome all the same.
        assert result.stderr.startswith(f"Gate cell: {outcome.upper()} (1 {outcome})" if status else "")
        assert bool(result.stderr) == bool(status)
    criterion = json.loads(result.stdout)["gate"]["criteria"][0]
    assert criterion["outcome"] == outcome
    # What the data lack is not evaluated.
    assert outcome != "not_evaluated" or "approach directions are not known" in criterion["why"]


def test_positions_of_one_pose_without_a_command() -> None:
    text = "pose,x_mm,y_mm,z_mm\nP1,0,0,0\nP1,0,0,0.1\nP1,0.1,0,0\n"
    table = output("iso9283", "-", text=text)
    assert missing(table, "1 commanded pose, 3 visits\nno commanded poses", "RP  pose repeatability") == []
    assert "no AP (pose accuracy): the commanded poses are not known" in one_line(table)
    assert len(table.splitlines()) <= 25


@pytest.mark.parametrize(
    ("arguments", "status", "message"),
    [
        (("iso9283", "-", "-"), 2, "standard input can be read only once"),
        (("iso9283", str(POSES), "--base-link", "x"), 2, "choose a chain of a URDF, so they need --robot"),
        (("iso9283", str(POSES), "--align", "backlash"), 2, "cannot align backlash"),
        (("iso9283", str(POSES), "--drift-windows", "1"), 2, "--drift-windows is at least 2, not 1"),
        (("iso9283", "nowhere.csv"), 3, "nowhere.csv"),
        (("plan", "--for", "iso9283", str(SCARA)), 3, "found no cube of 250 mm or more"),
        (("plan", "--for", "iso9283", str(SCARA), "--edge", "15deg"), 2, "--edge: expected a number with a unit"),
        (("plan", "--for", "iso9283", str(SCARA), "-o", "-", "--format", "json"), 2, "--format json needs --output"),
        (("simulate", str(ROBOT)), 2, "give either --poses"),
        (("simulate", str(ROBOT), "--at", str(SAMPLE / "plan.csv"), "--cycles", "2"), 2, "have cycles already"),
    ],
)
def test_errors(arguments: tuple[str, ...], status: int, message: str) -> None:
    assert message in refused(*arguments, status=status)


@pytest.mark.slow
def test_sample_data_are_what_their_commands_make(tmp_path: Path) -> None:
    plan, poses = tmp_path / "plan.csv", tmp_path / "poses.csv"
    output("plan", "--for", "iso9283", ROBOT, "--payload", "6", "-o", plan)
    assert "cube with an edge of 630 mm" in plan.read_text(encoding="utf-8")
    command = next(line for line in (ROOT / "sample_data" / "README.md").read_text().splitlines() if "--at" in line)
    arguments = [str(ROOT / one) if one.startswith("sample_data") else one for one in command.split()[1:]]
    arguments[arguments.index("-o") + 1] = str(poses)
    output(*arguments)
    # Not the bytes: another machine's mathematical library may round a sine the other way.
    assert agrees(POSES.read_text(encoding="utf-8"), poses.read_text(encoding="utf-8"))


def agrees(stored: str, made: str) -> bool:
    """Return whether two files hold the same text, and numbers that are the same to 1e-12."""
    cells = zip(re.split(r"[,\n]", stored), re.split(r"[,\n]", made), strict=True)
    return all(a == b or abs(float(a) - float(b)) <= 1e-12 for a, b in cells)


def test_planned_poses_are_met_by_the_robot(tmp_path: Path) -> None:
    """Simulated without effects or noise at the planned joints, the robot is where the plan commands it, to 1e-9."""
    plan, visited = tmp_path / "plan.csv", tmp_path / "visited.csv"
    made = output("plan", "--for", "iso9283", SCARA, "--edge", "150mm", "--cycles", "2", "-o", plan)
    assert missing(made, "cube with an edge of 150 mm", "j3, mm") == []
    assert max(map(len, made.splitlines())) <= 80
    output("simulate", SCARA, "--at", plan, "-o", visited)
    for wanted, attained in zip(rows(plan), rows(visited), strict=True):
        assert (wanted["pose"], wanted["cycle"]) == (attained["pose"], attained["cycle"])
        apart = [float(attained[axis]) - float(wanted[f"cmd_{axis}"]) for axis in "xyz"]
        assert np.max(np.abs(apart)) < 1e-9


def test_plan_on_standard_output_and_as_json(tmp_path: Path) -> None:
    printed = output("plan", "--for", "iso9283", "-o", "-", ROBOT, "--cycles", "1", "--plane", "y+", "--edge", "400mm")
    lines = [line for line in printed.splitlines() if not line.startswith("#")]
    assert (len(lines), "cycle" in lines[0], "x" in lines[0].split(",")) == (6, False, False)
    assert "towards y+" in printed
    found = commands.document("plan", "--for", "iso9283", ROBOT, "-o", tmp_path / "plan.csv")
    assert (found["schema"], found["cube"]["edge_m"]) == ("robacc.iso9283-poses/1", 0.63)
    assert [one["pose"] for one in found["poses"]] == ["P1", "P2", "P3", "P4", "P5"]


def test_planned_poses_without_measurements_are_refused() -> None:
    assert "columns x, y, z are missing" in refused("iso9283", SAMPLE / "plan.csv", status=3)
