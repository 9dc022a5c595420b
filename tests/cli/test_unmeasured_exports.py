"""Targets, candidates and poses to visit as exports: the options that answer what their names leave open."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import robacc
from robacc.cli.main import app

SAMPLES = Path(__file__).resolve().parents[2] / "sample_data"
ROBOT, MODEL = str(SAMPLES / "trace" / "robot.yaml"), str(SAMPLES / "trace" / "truth.yaml")


@pytest.fixture
def export(tmp_path: Path) -> tuple[str, np.ndarray]:
    """Return a German UTF-16 table of joint targets without units, and its joints in rad."""
    q = robacc.simulate(ROBOT, poses=8, seed=4).data.q
    assert q is not None
    rows = [";".join([f"P{i}", *(f"{math.degrees(a):.4f}" for a in row)]) for i, row in enumerate(q.T)]
    names = ";".join(f"A{i}" for i in range(1, 7))
    text = "\n".join(["Ziele;Zelle 4", f"Punkt;{names}", *rows, ""]).replace(".", ",")
    path = tmp_path / "ziele.csv"
    path.write_text(text, encoding="utf-16")
    return str(path), q


def run(*arguments: str) -> tuple[int, str, str]:
    result = CliRunner().invoke(app, list(arguments))
    return result.exit_code, result.stdout, result.stderr


def written(result: robacc.Corrected, folder: Path) -> Path:
    result.write(folder / "expected.csv")
    return folder / "expected.csv"


def test_without_units_each_command_asks(export: tuple[str, np.ndarray], tmp_path: Path) -> None:
    path, out = tmp_path / "radians.csv", str(tmp_path / "out.csv")
    # Radians may be small angles in degrees.
    rows = "\n".join(";".join(f"{angle:.6f}" for angle in row) for row in export[1].T)
    path.write_text(";".join(f"A{i}" for i in range(1, 7)) + f"\n{rows}\n")
    for arguments in (
        ("correct", str(path), "--model", MODEL, "--nominal", ROBOT),
        ("simulate", ROBOT, "--at", str(path)),
        ("plan", ROBOT, "--poses", "6", "--task", str(path)),
    ):
        status, _, messages = run(*arguments, "-o", out)
        assert status == 3, arguments
        assert f"{path.name}:1, A1, A2, A3, A4, A5, A6: these columns state no unit" in messages
        assert "--units" in messages
        assert not Path(out).exists()


def test_limits_leave_one_unit(export: tuple[str, np.ndarray], tmp_path: Path) -> None:
    out = str(tmp_path / "out.csv")
    status, _, messages = run("simulate", ROBOT, "--at", export[0], "-o", out)
    assert status == 0
    np.testing.assert_allclose(robacc.read_poses(out, robot=robacc.read_robot(ROBOT)).q, export[1], atol=2e-6)
    assert "A1, A2, A3, A4, A5, A6 taken as deg: no other unit agrees with the values" in messages


def test_correct_reads_them(export: tuple[str, np.ndarray], tmp_path: Path) -> None:
    out = tmp_path / "corrected.csv"
    options = ("--units", "deg", "--format", "json", "-o", str(out))
    status, document, _ = run("correct", export[0], "--model", MODEL, "--nominal", ROBOT, *options)
    assert status == 0
    corrected = robacc.simulate(ROBOT, at=out).data.q
    expected = robacc.correct(robacc.simulate(ROBOT, poses=8, seed=4).data, model=MODEL, nominal=ROBOT)
    np.testing.assert_allclose(corrected, robacc.simulate(ROBOT, at=written(expected, tmp_path)).data.q, atol=5e-6)
    (record,) = [file for file in json.loads(document)["inputs"] if file["kind"] == "targets"]
    assert record["reading"] == {"units": "deg"}


def test_simulate_visits_them(export: tuple[str, np.ndarray], tmp_path: Path) -> None:
    out = tmp_path / "simulated.csv"
    options = ("--units", "deg", "--format", "json", "-o", str(out))
    status, document, _ = run("simulate", ROBOT, "--at", export[0], *options)
    assert status == 0
    data = robacc.read_poses(out, robot=robacc.read_robot(ROBOT))
    np.testing.assert_allclose(data.q, export[1], atol=2e-6)
    assert json.loads(document)["inputs"][1]["reading"] == {"units": "deg"}


def test_plan_adds_to_them(export: tuple[str, np.ndarray], tmp_path: Path) -> None:
    out = tmp_path / "plan.csv"
    options = ("--candidates", "200", "--already", export[0], "--units", "deg", "--format", "json", "-o", str(out))
    status, document, _ = run("plan", ROBOT, "--poses", "6", *options)
    assert status == 0
    assert [file.get("reading") for file in json.loads(document)["inputs"]] == [None, {"units": "deg"}]


def test_options_of_measurements_are_not_there(export: tuple[str, np.ndarray]) -> None:
    for command in ("correct", "simulate", "plan"):
        assert run(command, "--help")[1].count("--coverage") == 0


def test_a_program_states_its_own_units(tmp_path: Path) -> None:
    program = tmp_path / "drill.script"
    program.write_text("def drill():\n  movej([0.1, -1.2, 1.0, 0.2, 0.3, 0.4])\nend\n")
    out = tmp_path / "out.script"
    status, _, messages = run("correct", str(program), "--model", MODEL, "--units", "mm,deg", "-o", str(out))
    assert status == 2
    assert "a program states its own units" in messages
    assert not out.exists()
