"""Poses held against the size of the robot that was measured, from the library and from the shell."""

from __future__ import annotations

import csv
import dataclasses
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import robacc
from robacc.cli.main import app
from robacc.diagnostics.robot_poses import read_robot_poses
from robacc.errors import InputError
from robacc.modelling.robot_file import read_robot

ROOT = Path(__file__).resolve().parents[2]
POSES = ROOT / "sample_data" / "poses.csv"
ROBOT = ROOT / "sample_data" / "robot.yaml"
AXES = ("x", "y", "z")


def rewritten(folder: Path, unit: str, factor: float, repeat: int = 1) -> Path:
    """The sample's poses, positions times ``factor`` in columns that say ``unit``."""
    with POSES.open(newline="") as stream:
        rows = list(csv.DictReader(line for line in stream if not line.startswith("#")))
    path = folder / "rewritten.csv"
    with path.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow([f"{name}_{unit}" if name in AXES else name for name in rows[0]])
        for row in rows * repeat:
            writer.writerow([float(value) * factor if name in AXES else value for name, value in row.items()])
    return path


@pytest.mark.parametrize(
    ("unit", "factor", "complaint", "tip"),
    [
        ("m", 1e3, "times as far as the robot moved (", "if they are in mm, name the columns x_mm, y_mm, z_mm"),
        ("mm", 1.0, "times less than the robot moved (", "if they are in m, name the columns x, y, z"),
    ],
)
@pytest.mark.parametrize("command", [("estimate",), ("calibrate", "--fit", "joint_offset"), ("trace",)])
def test_a_unit_that_does_not_suit_the_robot_is_refused(
    tmp_path: Path, command: tuple[str, ...], unit: str, factor: float, complaint: str, tip: str
) -> None:
    path = rewritten(tmp_path, unit, factor)
    name, *options = command
    found = CliRunner().invoke(app, [name, str(path), "--robot", str(ROBOT), *options], catch_exceptions=False)
    assert found.exit_code == 3
    assert found.stdout == ""
    assert f"error: {path}, x, y, z: the positions spread over" in found.stderr
    assert complaint in found.stderr
    assert tip in found.stderr


def test_metres_and_radians_read_as_millimetres_and_degrees_are_refused(tmp_path: Path) -> None:
    path = rewritten(tmp_path, "mm", 1.0)
    header, *rows = path.read_text().splitlines()
    names = [f"{name}_deg" if name.startswith("q") and name[1:].isdigit() else name for name in header.split(",")]
    path.write_text("\n".join([",".join(names), *rows]) + "\n")
    with pytest.raises(InputError, match=r"spread over 1.* mm only, .*if they are in m and rad, give `units` as m,rad"):
        read_robot_poses(path, read_robot(str(ROBOT)))


def test_rows_in_turn_are_not_judged_by_one_of_them(tmp_path: Path) -> None:
    """60 poses visited a hundred times, and more rows than are looked at: those are of many poses."""
    robot = read_robot(str(ROBOT))
    with pytest.raises(InputError, match="times as far as the robot moved"):
        read_robot_poses(rewritten(tmp_path, "m", 1e3, repeat=100), robot)
    data = read_robot_poses(rewritten(tmp_path, "mm", 1e3, repeat=100), robot)
    assert data.n == 6000


@pytest.mark.parametrize("offset", [0.0, 150.0])
def test_where_the_instrument_stands_does_not_matter(tmp_path: Path, offset: float) -> None:
    path = rewritten(tmp_path, "m", 1.0)
    with path.open(newline="") as stream:
        header, *rows = csv.reader(stream)
    at = header.index("x_m")
    with path.open("w", newline="") as stream:
        csv.writer(stream).writerows([header, *([*r[:at], float(r[at]) + offset, *r[at + 1 :]] for r in rows)])
    data = read_robot_poses(path, read_robot(str(ROBOT)))
    assert data.position[0].mean() == pytest.approx(offset, abs=1.0)
    assert np.ptp(data.position[0]) < 3.0


def test_several_targets_want_a_robot_that_tells_them_apart(tmp_path: Path) -> None:
    robot = read_robot(str(ROBOT))
    header, first, second = POSES.read_text(encoding="utf-8").splitlines()[1:4]
    path = tmp_path / "two.csv"
    path.write_text(f"{header},target\n{first},smr1\n{second},smr2\n", encoding="utf-8")
    found = CliRunner().invoke(app, ["estimate", str(path), "--robot", str(ROBOT)], catch_exceptions=False)
    assert (found.exit_code, found.stdout) == (3, "")
    assert (
        f"error: {path}:3, target: found several targets ('smr1', 'smr2'), but the robot has one tool" in found.stderr
    )
    with pytest.raises(InputError, match=r"found several targets \(smr1, smr2\), but the robot has one tool"):
        robacc.estimate(robacc.read_poses(path), robot=robot)
    several = dataclasses.replace(robot, targets={"smr1": robot.tool})
    with pytest.raises(InputError, match=r"found 'smr2', expected a target of the robot \(smr1\)"):
        robacc.estimate(robacc.read_poses(path), robot=several)
    path.write_text(f"{header},target\n{first},smr1\n{second},smr1\n", encoding="utf-8")
    assert read_robot_poses(path, robot).n == 2
