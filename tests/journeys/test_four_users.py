"""Journeys of four new users, command by command: each with its number of steps and the messages that lead on."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

import robacc
from robacc.cli.main import app

SAMPLES = Path(__file__).resolve().parents[2] / "sample_data"
ROBOT = str(SAMPLES / "robot.yaml")


class Journey:
    """Commands of one user; each command is a step."""

    def __init__(self) -> None:
        self.steps = 0

    def robacc(self, *arguments: str, status: int = 0) -> Result:
        self.steps += 1
        result = CliRunner().invoke(app, list(arguments))
        assert result.exit_code == status, result.output
        assert "Traceback" not in result.output
        return result


@pytest.fixture
def journey(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Journey:
    monkeypatch.chdir(tmp_path)
    return Journey()


def test_technician_with_a_tracker_export(journey: Journey) -> None:
    data = robacc.read_poses(SAMPLES / "poses.csv", robot=robacc.read_robot(ROBOT)).subset(slice(0, 20))
    assert data.q is not None
    rows = np.vstack([np.degrees(data.q), data.position * 1e3]).T
    lines = [";".join(f"{value:.4f}" for value in row).replace(".", ",") for row in rows]
    lines[4] = lines[4].rsplit(";", 1)[0] + ";"  # the beam broke
    text = "Messprotokoll Zelle 3\n\nA1;A2;A3;A4;A5;A6;X;Y;Z\n" + "\n".join(lines) + "\n"
    Path("tracker.csv").write_bytes(text.encode("cp1252"))
    # The refusal names the option that answers it; the units have one answer.
    first = journey.robacc("estimate", "tracker.csv", "--robot", ROBOT, status=3)
    assert "tracker.csv:8, Z: the value is missing" in first.stderr
    second = journey.robacc("estimate", "tracker.csv", "--robot", ROBOT, "--skip-gaps")
    assert "warning: tracker.csv: 1 row with a missing value left out" in second.stderr
    assert "note: tracker.csv: X, Y, Z taken as mm: no other unit agrees" in second.stderr
    assert "Error of 19 measured poses" in second.stdout
    assert journey.steps == 2


def test_engineer_with_a_urdf(journey: Journey) -> None:
    journey.robacc("show", "robots", "ur5e")
    model = journey.robacc("init", "ur5e", "--folder", "cell")
    files = re.findall(r"wrote (\S+)", model.output) or [str(path) for path in Path("cell").iterdir()]
    assert files
    robot, poses = next(Path("cell").glob("*.yaml")), next(Path("cell").glob("*.csv"))
    journey.robacc("export", str(robot), "--format", "urdf", "--output", "cell.urdf")
    answer = journey.robacc("estimate", str(poses), "--robot", "cell.urdf", "--align", "base_frame,tool_frame")
    assert "Grade" in answer.stdout
    assert journey.steps == 4


def test_ci_gates_a_result(journey: Journey) -> None:
    Path("gate.yaml").write_text(
        "robacc_gate: 1\nname: cell 3\ncriteria:\n"
        "  - {key: position.p95, limit: 5 mm, rule: simple, reason: tolerance of the gripper}\n",
        encoding="utf-8",
    )
    arguments = ("estimate", str(SAMPLES / "poses.csv"), "--robot", ROBOT, "--gate", "gate.yaml")
    result = journey.robacc(*arguments, "--junit", "junit.xml", "--format", "json")
    assert json.loads(result.stdout)["gate"]["outcome"] == "pass"
    assert 'tests="1" failures="0"' in Path("junit.xml").read_text(encoding="utf-8")
    assert journey.steps == 1


def test_customer_reads_the_report(journey: Journey) -> None:
    pytest.importorskip("jinja2")
    pytest.importorskip("plotly")
    journey.robacc("estimate", str(SAMPLES / "poses.csv"), "--robot", ROBOT, "--format", "json", "-o", "result.json")
    wrong = journey.robacc("report", "result.json", "--identity", "serial=A-17", "--output", "report.html", status=2)
    assert "serial_number" in wrong.stderr
    assert not Path("report.html").exists()
    identity = ("--identity", "serial_number=A-17", "--identity", "customer=Muster AG")
    journey.robacc("report", "result.json", *identity, "--output", "report.html")
    page = Path("report.html").read_text(encoding="utf-8")
    assert "A-17" in page
    assert "Muster AG" in page
    assert journey.steps == 3
