"""Targets, candidates and poses to visit as exports: the options that answer what their names leave open."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from commands import document, missing, output, refused, run

import robacc

SAMPLES = Path(__file__).resolve().parents[2] / "sample_data"
ROBOT, MODEL = str(SAMPLES / "trace" / "robot.yaml"), str(SAMPLES / "trace" / "truth.yaml")


@pytest.fixture
def export(tmp_path: Path) -> tuple[str, np.ndarray]:
    """Return a German UTF-16 table of joint targets without units, and its joints in rad."""
    q = robacc.simulate(ROBOT, poses=8, seed=4).data.q
    rows = [";".join([f"P{i}", *(f"{math.degrees(a):.4f}" for a in row)]) for i, row in enumerate(q.T)]
    names = ";".join(f"A{i}" for i in range(1, 7))
    text = "\n".join(["Ziele;Zelle 4", f"Punkt;{names}", *rows, ""]).replace(".", ",")
    path = tmp_path / "ziele.csv"
    path.write_text(text, encoding="utf-16")
    return str(path), q


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
        told = refused(*arguments, "-o", out, status=3)
        columns = f"{path.name}:1, A1, A2, A3, A4, A5, A6: these columns state no unit"
        assert missing(told, columns, "--units") == []
        assert not Path(out).exists()


def test_limits_leave_one_unit(export: tuple[str, np.ndarray], tmp_path: Path) -> None:
    out = str(tmp_path / "out.csv")
    done = run("simulate", ROBOT, "--at", export[0], "-o", out)
    assert done.exit_code == 0
    np.testing.assert_allclose(robacc.read_poses(out, robot=robacc.read_robot(ROBOT)).q, export[1], atol=2e-6)
    assert "A1, A2, A3, A4, A5, A6 taken as deg: no other unit agrees with the values" in done.stderr


def test_correct_reads_them(export: tuple[str, np.ndarray], tmp_path: Path) -> None:
    out, right = tmp_path / "corrected.csv", tmp_path / "expected.csv"
    found = document("correct", export[0], "--model", MODEL, "--nominal", ROBOT, "--units", "deg", "-o", out)
    robacc.correct(robacc.simulate(ROBOT, poses=8, seed=4).data, model=MODEL, nominal=ROBOT).write(right)
    corrected, expected = (robacc.simulate(ROBOT, at=path).data.q for path in (out, right))
    np.testing.assert_allclose(corrected, expected, atol=5e-6)
    assert [file["reading"] for file in found["inputs"] if file["kind"] == "targets"] == [{"units": "deg"}]


def test_simulate_visits_them_and_plan_adds_to_them(export: tuple[str, np.ndarray], tmp_path: Path) -> None:
    out, options = tmp_path / "simulated.csv", ("--candidates", "200", "-o", tmp_path / "plan.csv")
    visited = document("simulate", ROBOT, "--at", export[0], "--units", "deg", "-o", out)
    np.testing.assert_allclose(robacc.read_poses(out, robot=robacc.read_robot(ROBOT)).q, export[1], atol=2e-6)
    planned = document("plan", ROBOT, "--poses", "6", "--already", export[0], "--units", "deg", *options)
    for found in (visited, planned):
        assert [file.get("reading") for file in found["inputs"]] == [None, {"units": "deg"}]


@pytest.mark.parametrize("command", ["correct", "simulate", "plan"])
def test_options_of_measurements_are_not_there(command: str) -> None:
    assert "--coverage" not in output(command, "--help")


def test_a_program_states_its_own_units(tmp_path: Path) -> None:
    program = tmp_path / "drill.script"
    program.write_text("def drill():\n  movej([0.1, -1.2, 1.0, 0.2, 0.3, 0.4])\nend\n")
    out = tmp_path / "out.script"
    told = refused("correct", program, "--model", MODEL, "--units", "mm,deg", "-o", out)
    assert "a program states its own units" in told
    assert not out.exists()
