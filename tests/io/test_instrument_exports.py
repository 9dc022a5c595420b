"""Exports of instruments that know no commands, and programs that are no measurement, in the forms of makers."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import robacc

SAMPLES = Path(__file__).resolve().parents[2] / "sample_data"
COUNT = 12


@pytest.fixture(scope="module")
def robot() -> robacc.Robot:
    return robacc.read_robot(SAMPLES / "robot.yaml")


@pytest.fixture(scope="module")
def data(robot: robacc.Robot) -> robacc.Measurements:
    return robacc.read_poses(SAMPLES / "poses.csv", robot=robot).subset(slice(0, COUNT))


def rotations(data: robacc.Measurements) -> Rotation:
    assert data.rotation is not None
    return Rotation.from_matrix(np.moveaxis(data.rotation, 2, 0))


def lines(head: str, row: str, *columns: np.ndarray) -> str:
    """Return a head, and a row for each pose with its number (from 1) and its values."""
    values = np.vstack(columns).T
    return head + "".join(row.format(*items, n=i) + "\n" for i, items in enumerate(values, 1))


def spatial_analyzer(data: robacc.Measurements) -> str:
    angles = rotations(data).as_euler("xyz", degrees=True).T
    head = '"Collection","Object","X","Y","Z","Rx","Ry","Rz"\n"","","(mm)","(mm)","(mm)","(deg)","(deg)","(deg)"\n'
    return lines(head, '"A","P{n}"' + ",{:.6f}" * 6, data.position * 1e3, angles)


def motive(data: robacc.Measurements) -> str:
    head = (
        "Format Version,1.23,Take Name,Take 7,Rotation Type,Quaternion,Length Units,Meters,Coordinate Space,Global\n\n"
        ",,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body,Rigid Body\n"
        ",,SMR,SMR,SMR,SMR,SMR,SMR,SMR,SMR\n"
        ",,Rotation,Rotation,Rotation,Rotation,Position,Position,Position,Mean Marker Error\n"
        "Frame,Time (Seconds),X,Y,Z,W,X,Y,Z,\n"
    )
    return lines(head, "{n},{n}.5" + ",{:.9f}" * 7 + ",0.0001", rotations(data).as_quat().T, data.position)


def merged_cells(data: robacc.Measurements) -> str:
    """The same groups as a spreadsheet program writes them, where one cell spans several columns."""
    head = "Take 7\n;Position;;;Rotation;;;\nPunkt;X [m];Y [m];Z [m];X;Y;Z;W\n"
    return lines(head, "P{n}" + ";{:.9f}" * 7, data.position, rotations(data).as_quat().T).replace(".", ",")


def vicon(data: robacc.Measurements) -> str:
    head = "Segments\n100\n,,Tool:Tool,,,,,\nFrame,Sub Frame,RX,RY,RZ,TX,TY,TZ\n,,deg,deg,deg,mm,mm,mm\n"
    return lines(head, "{n},0" + ",{:.6f}" * 6, np.degrees(rotations(data).as_rotvec().T), data.position * 1e3)


def ndi(data: robacc.Measurements) -> str:
    quaternion = np.roll(rotations(data).as_quat().T, 1, axis=0)
    head = "Tools,Port 1,Frame,Face,State,Q0,Qx,Qy,Qz,Tx,Ty,Tz,Error,Markers\n"
    return lines(head, "1,344,{n},1,OK" + ",{:.9f}" * 7 + ",0.05,4", quaternion, data.position * 1e3)


def radian(data: robacc.Measurements) -> str:
    head = "API Radian Pro\nSerial No,40123\nTemperature,20.1,C\n\nNo.,Name,X(mm),Y(mm),Z(mm),RMS X,RMS Y,RMS Z,Time\n"
    return lines(head, "{n},P{n}" + ",{:.6f}" * 3 + ",0.002,0.002,0.003,09:00:07.120", data.position * 1e3)


EXPORTS = (spatial_analyzer, motive, merged_cells, vicon, ndi, radian)


@pytest.mark.parametrize("export", EXPORTS, ids=lambda export: export.__name__)
def test_measured_poses_and_joints_of_another_file(
    export: Callable[[robacc.Measurements], str],
    data: robacc.Measurements,
    robot: robacc.Robot,
    tmp_path: Path,
) -> None:
    measured, joints = tmp_path / "measured.csv", tmp_path / "joints.csv"
    measured.write_text(export(data), encoding="utf-8")
    joints.write_text(lines("Name,J1,J2,J3,J4,J5,J6\n", "P{n}" + ",{:.7f}" * 6, np.degrees(data.q)), encoding="utf-8")
    read = robacc.read_poses(measured, robot=robot, commanded=joints, units="mm,deg")
    # Six digits of a millimetre, seven of a degree.
    np.testing.assert_allclose(read.position, data.position, atol=1e-9)
    np.testing.assert_allclose(read.q, data.q, atol=1e-8)
    if export is radian:
        assert read.rotation is None
    else:
        np.testing.assert_allclose(read.rotation, data.rotation, atol=3e-8)


def test_signals_of_robotstudio_have_a_path(data: robacc.Measurements, robot: robacc.Robot, tmp_path: Path) -> None:
    path = tmp_path / "signals.csv"
    names = [*(f"J{i} (deg)" for i in range(1, 7)), *(f"TCP {axis} (mm)" for axis in "XYZ")]
    head = ";".join(("Time (s)", *(f"System1\\ROB_1\\{name}" for name in names))) + "\n"
    path.write_text(lines(head, "{n}.0" + ";{:.7f}" * 9, np.degrees(data.q), data.position * 1e3), encoding="utf-8")
    read = robacc.read_poses(path, robot=robot)
    np.testing.assert_allclose(read.q, data.q, atol=1e-8)
    np.testing.assert_allclose(read.position, data.position, atol=1e-9)


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
