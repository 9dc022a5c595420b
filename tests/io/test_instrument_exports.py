"""Exports of instruments that know no commands, and programs that are no measurement, in the forms of makers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import robacc

SAMPLES = Path(__file__).resolve().parents[2] / "sample_data"


@pytest.fixture(scope="module")
def robot() -> robacc.Robot:
    return robacc.read_robot(SAMPLES / "robot.yaml")


REFUSED = {
    "job.JBI": (
        "/JOB\n//NAME CALIB\n//POS\n///PULSE\nC00000=0,0,0,0,0,0\nC00001=12034,-3323,9921,0,-22001,11\nEND\n",
        "is a job of Yaskawa, whose positions count pulses of the motors; give the file of measured poses",
    ),
    "calib.ls": (
        "/PROG  CALIB\n/MN\n   1:J P[1] 10% FINE ;\n/POS\nP[1]{\n   GP1:\n\tUF : 0, UT : 1,\n"
        "\tJ1= 1.0 deg, J2= 2.0 deg, J3= 3.0 deg,\n\tJ4= 4.0 deg, J5= 5.0 deg, J6= 6.0 deg\n};\n/END\n",
        "is a robot program, which has commands but no measured poses; "
        "give the file of measured poses, and the program with `commanded`",
    ),
    "posreg.va": (
        "[*POSREG*]$POSREG\n    [1,1] =   'P1'   Group: 1\n  X:  100.0   Y:  200.0   Z:  300.0\n",
        "is a listing of FANUC variables; give the file of measured poses",
    ),
    "points.csv": (
        "Point Name,X (mm),Y (mm),Z (mm)\nP1,1023.4512,-233.1207,812.0031\nP2,998.2210,-120.8841,790.5502\n",
        "measured poses only: neither joint variables nor commanded poses; give the commands with `commanded`",
    ),
}


def test_rows_of_cam2_for_each_axis_are_joined(tmp_path: Path) -> None:
    text = (
        "Part:\tKR10\nUnits:\tMillimeters\n\nFeature\tAxis\tActual\tNominal\tDeviation\n"
        "P1\tX\t100.1\t100.0\t0.1\nP1\tY\t200.1\t200.0\t0.1\nP1\tZ\t300.1\t300.0\t0.1\n"
    )
    (tmp_path / "cam2.txt").write_text(text, encoding="utf-8")
    read = robacc.read_poses(tmp_path / "cam2.txt")
    np.testing.assert_allclose(1e3 * read.position[:, 0], [100.1, 200.1, 300.1], rtol=1e-14)
    np.testing.assert_allclose(1e3 * read.commanded_position[:, 0], [100, 200, 300], rtol=1e-14)


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_no_measurement_says_what_to_give(name: str, robot: robacc.Robot, tmp_path: Path) -> None:
    content, message = REFUSED[name]
    (tmp_path / name).write_text(content, encoding="utf-8")
    with pytest.raises(robacc.InputError) as caught:
        robacc.estimate(tmp_path / name, robot=robot)
    (problem,) = caught.value.problems
    assert message in str(problem)


def test_points_alone_name_the_option_without_a_robot_too(tmp_path: Path) -> None:
    (tmp_path / "points.csv").write_text(REFUSED["points.csv"][0], encoding="utf-8")
    with pytest.raises(robacc.UsageError, match=r"give `commanded`, a robot program or a table of joints or poses, or"):
        robacc.estimate(tmp_path / "points.csv")
