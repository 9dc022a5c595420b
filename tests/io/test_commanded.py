"""Measured points and their commands in two files: joined by names, or by order where the files share none."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import robacc
from robacc.cli.main import app

SAMPLES = Path(__file__).resolve().parents[2] / "sample_data"
ROBOT = SAMPLES / "robot.yaml"
COUNT = 12


@pytest.fixture
def data() -> robacc.Measurements:
    return robacc.read_poses(SAMPLES / "poses.csv", robot=robacc.read_robot(ROBOT)).subset(slice(0, COUNT))


def tracker(data: robacc.Measurements, order: list[int], names: bool = True) -> str:
    """A point list of SpatialAnalyzer, as its manual describes the export of points."""
    rows = ["// SpatialAnalyzer, Units: Millimeters"]
    for i in order:
        x, y, z = (f"{value * 1e3:.4f}" for value in data.position[:, i])
        rows.append(f"A Main {f'p{i}' if names else 'x'} {x} {y} {z}" if names else f"{i} {x} {y} {z}")
    return "\n".join(rows) + "\n"


def joints(data: robacc.Measurements, order: list[int], names: bool = True) -> str:
    head = [*(["Name"] if names else []), *(f"J{i} [deg]" for i in range(1, 7))]
    rows = [[*([f"P{i}"] if names else []), *(f"{value:.6f}" for value in np.degrees(data.q[:, i]))] for i in order]
    return "\n".join(";".join(row) for row in (head, *rows)) + "\n"


def test_points_and_joints_are_joined_by_name(data: robacc.Measurements, tmp_path: Path) -> None:
    order = list(range(COUNT))
    measured = [*order[::-1], 3]  # another order, and a point that was measured twice
    (tmp_path / "points.txt").write_text(tracker(data, measured), encoding="utf-8")
    (tmp_path / "joints.csv").write_text(joints(data, order), encoding="utf-8")
    arguments = ["estimate", f"{tmp_path}/points.txt", "--commanded", f"{tmp_path}/joints.csv", "--robot", str(ROBOT)]
    done = CliRunner().invoke(app, [*arguments, "--format", "json"], catch_exceptions=False)
    assert done.exit_code == 0, done.stderr
    result = json.loads(done.stdout)
    called = robacc.estimate(tmp_path / "points.txt", commanded=tmp_path / "joints.csv", robot=ROBOT, units="mm,deg")
    assert json.loads(called.to_json())["position"] == result["position"]
    assert json.loads(called.to_json())["options"] == result["options"]
    with pytest.raises(robacc.UsageError, match="`units` applies when a file is read; use it in read_poses"):
        robacc.estimate(data, robot=ROBOT, units="mm,deg")
    assert "joined by the names of the poses" in done.stderr
    assert result["inputs"][0]["reading"]["commanded"] == "joints.csv"
    expected = robacc.estimate(data, robot=ROBOT, frame="base").errors.position
    frame = robacc.estimate(data, robot=ROBOT).errors.position
    found = np.array(result["position"]["errors_m"]).T
    assert found.shape == (3, COUNT + 1)
    # Six digits of a degree are 1e-8 rad, at two metres less than a tenth of a micrometre.
    np.testing.assert_allclose(np.linalg.norm(found, axis=0), np.linalg.norm(expected[:, measured], axis=0), atol=2e-7)
    np.testing.assert_allclose(found, frame[:, measured], atol=2e-7)


def test_files_without_common_names_are_joined_by_order(data: robacc.Measurements, tmp_path: Path) -> None:
    order = list(range(COUNT))
    text = "X;Y;Z\n" + "".join(";".join(f"{v * 1e3:.4f}" for v in data.position[:, i]) + "\n" for i in order)
    (tmp_path / "points.csv").write_text(text, encoding="utf-8")
    (tmp_path / "joints.csv").write_text(joints(data, order), encoding="utf-8")
    robot = robacc.read_robot(ROBOT)
    read = robacc.read_poses(
        tmp_path / "points.csv", robot=robot, units="mm", commanded=tmp_path / "joints.csv", ordered=True
    )
    np.testing.assert_allclose(read.q, data.q, atol=1e-8)
    np.testing.assert_array_equal(read.direction[:, 1:], np.sign(np.diff(read.q)))
    assert any("joined by the order of rows: the files share no names" in warning for warning in read.warnings)
    (tmp_path / "joints.csv").write_text(joints(data, order[:-1]), encoding="utf-8")
    with pytest.raises(robacc.InputError, match=r"12 measured rows and 11 commands in .*, which share no names"):
        robacc.read_poses(tmp_path / "points.csv", robot=robot, units="mm", commanded=tmp_path / "joints.csv")


def test_commands_of_a_robot_program(data: robacc.Measurements, tmp_path: Path) -> None:
    moves = [f"  movej([{', '.join(f'{angle:.9f}' for angle in q)}], a=1.4, v=1.05)" for q in data.q.T]
    (tmp_path / "poses.script").write_text("def poses():\n" + "\n".join(moves) + "\nend\n", encoding="utf-8")
    (tmp_path / "points.txt").write_text(tracker(data, list(range(COUNT))), encoding="utf-8")
    robot = robacc.read_robot(ROBOT)
    read = robacc.read_poses(tmp_path / "points.txt", robot=robot, commanded=tmp_path / "poses.script")
    np.testing.assert_allclose(read.q, data.q, atol=1e-8)
    assert any("joined by the order of rows" in warning for warning in read.warnings)


def test_points_without_a_command_are_left_out_unless_they_are_most(data: robacc.Measurements, tmp_path: Path) -> None:
    (tmp_path / "points.txt").write_text(tracker(data, list(range(COUNT))), encoding="utf-8")
    (tmp_path / "joints.csv").write_text(joints(data, list(range(2, COUNT))), encoding="utf-8")
    read = robacc.read_poses(tmp_path / "points.txt", commanded=tmp_path / "joints.csv")
    np.testing.assert_allclose(read.q, data.q[:, 2:], atol=1e-8)
    assert any("rows without a command in " in text and text.endswith(": p0, p1") for text in read.warnings)
    (tmp_path / "joints.csv").write_text(joints(data, list(range(8, COUNT))), encoding="utf-8")
    with pytest.raises(robacc.InputError, match=r"8 of the measured poses have no command in .*joints\.csv: p0, p1"):
        robacc.read_poses(tmp_path / "points.txt", commanded=tmp_path / "joints.csv")


def test_commands_given_twice_are_refused(data: robacc.Measurements, tmp_path: Path) -> None:
    (tmp_path / "joints.csv").write_text(joints(data, list(range(COUNT))), encoding="utf-8")
    with pytest.raises(robacc.InputError, match="the measured poses have commands of their own"):
        robacc.read_poses(SAMPLES / "poses.csv", commanded=tmp_path / "joints.csv")
