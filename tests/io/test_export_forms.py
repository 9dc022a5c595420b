"""Exports in the forms that users have: each is read with one command, and all give the figures of the plain file."""

import io
import itertools
import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from commands import document, one_line, output, refused, run
from sample_files import saved
from scipy.io import savemat
from scipy.spatial.transform import Rotation

import robacc
from robacc.errors import InputError, Note
from robacc.io.files import TEXT_LIMIT
from robacc.io.table import TableOptions
from robacc.plug_ins import plug_in

Form = Callable[["Campaign"], dict[str, str]]
N = 24
ROBOT = "ur10e"
MM = 1e3


@dataclass(frozen=True)
class Campaign:
    """Poses of an arm that an instrument measured from elsewhere, in SI."""

    q: np.ndarray
    commanded: np.ndarray
    commanded_turn: Rotation
    position: np.ndarray
    turn: Rotation


@pytest.fixture(scope="module")
def campaign() -> Campaign:
    made = robacc.simulate(ROBOT, poses=N, seed=3, noise="0.05mm", noise_orientation="0.003deg", commanded=True).data
    turn, commanded_turn = (
        Rotation.from_matrix(np.moveaxis(rotation, 2, 0)) for rotation in (made.rotation, made.commanded_rotation)
    )
    base, tool = Rotation.from_euler("xyz", [1, -2, 71], degrees=True), Rotation.from_rotvec([0.2, 0.3, 0.5])
    position = base.apply(made.position.T + turn.apply([0.02, -0.03, 0.11])) + np.array([2.1, -1.3, 0.4])
    return Campaign(made.q.T, made.commanded_position.T, commanded_turn, position, base * turn * tool)


def lines(rows: Iterable[Iterable[Any]], separator: str = ",", head: str = "", tail: str = "") -> str:
    body = (separator.join(f"{v:.8f}" if isinstance(v, float) else str(v) for v in row) for row in rows)
    return head + "".join(f"{row}\n" for row in body) + tail


def named(values: np.ndarray, name: str = "P{}") -> list[list[Any]]:
    return [[name.format(i), *row.tolist()] for i, row in enumerate(values, 1)]


def columns_of(c: Campaign) -> dict[str, np.ndarray]:
    """The columns that a table may have, by their names there."""
    counted = np.arange(N, dtype=float)[:, None]
    xyzw = c.turn.as_quat()
    return {
        **{"q": c.q, "deg": np.degrees(c.q), "deg_read": np.degrees(c.q) + 1e-3, "q_read": c.q + 1e-5},
        **{"m": c.position, "mm": c.position * MM, "cm": c.position * 100, "in": c.position / 0.0254},
        **{"xyzw": xyzw, "wxyz": np.roll(xyzw, 1, axis=1), "rotvec": c.turn.as_rotvec()},
        **{"rotvec_deg": np.degrees(c.turn.as_rotvec()), "moving_deg": c.turn.as_euler("XYZ", degrees=True)},
        **{"zyx": c.turn.as_euler("ZYX"), "rpy_deg": c.turn.as_euler("xyz", degrees=True)},
        "matrix": c.turn.as_matrix().transpose(0, 2, 1).reshape(N, 9),
        **{"cmd_m": c.commanded, "cmd_mm": c.commanded * MM, "cmd_xyzw": c.commanded_turn.as_quat()},
        "cmd_rpy": c.commanded_turn.as_euler("xyz"),
        "zyz_deg": c.turn.as_euler("ZYZ", degrees=True),
        **{"cmd_rotvec": c.commanded_turn.as_rotvec(), "constant": np.tile((-0.214, 50.02, 27.74), (N, 1))},
        **{"cmd_abc_deg": c.commanded_turn.as_euler("ZYX", degrees=True), "off_mm": (c.position - c.commanded) * MM},
        "off_cm": (c.position - c.commanded) * 100,
        "stamp": 1578493243.25 + 0.5 * counted,
        **{"count": counted, "seconds": 2.5 * counted, "frames": counted / 120, "zero": 0 * counted},
    }


@dataclass(frozen=True)
class Text:
    """A table: its head, the columns of its rows, and the texts that stand before and behind them."""

    head: str
    columns: str
    name: str = ""
    """Fields before the values; ``{0}`` is the number of the row."""
    sep: str = ";"
    more: str = ""
    """Fields behind the values."""
    tail: str = ""
    comma: bool = False
    backwards: bool = False

    def of(self, c: Campaign) -> str:
        values = np.hstack([columns_of(c)[name] for name in self.columns.split()])
        rows = []
        for i, row in enumerate(values.tolist(), 1):
            numbers = (f"{value:.8f}".replace(".", "," if self.comma else ".") for value in row)
            behind = [self.more.format(i)] if self.more else []
            rows.append(self.sep.join([*([self.name.format(i)] if self.name else []), *numbers, *behind]) + "\n")
        return (self.head + "\n" if self.head else "") + "".join(rows[::-1] if self.backwards else rows) + self.tail


JOINTS = "A1;A2;A3;A4;A5;A6"
J = "J1,J2,J3,J4,J5,J6"
DEGREES = {"joints.csv": Text(f"Name,{J}", "deg", "p{0}", ",")}
IN_ORDER = {"joints.csv": Text(JOINTS, "deg")}
POINTS = {"points.csv": Text("X,Y,Z", "mm", sep=",")}
DRIFT = "Drift A;2000;100;30\n"
"""A point without a command."""


def beside(controller: str, measured: str) -> dict[str, Text]:
    """A controller's position, of its own frame, beside that of an instrument."""
    names = [text.format(axis) for text in (controller, measured) for axis in "XYZ"]
    return {"both.csv": Text(";".join((JOINTS, *names)), "deg cmd_mm mm")}


def translated(joint: str, measured: str, units: str = "") -> dict[str, Text]:
    names = [*(joint.format(i) for i in range(1, 7)), *(measured.format(axis) for axis in "XYZ")]
    return {"mesure.csv": Text(";".join(["Punto", *names]) + units, "deg mm", "P{0}")}


def backwards(names: str) -> dict[str, Text]:
    """Commands in another order than the points."""
    return {"joints.csv": Text(f"Name;{JOINTS}", "deg", names, backwards=True)}


OPTITRACK = "\n".join(
    [
        "Format Version,1.23,Take Name,Take,Capture Frame Rate,120.0,Rotation Type,Quaternion,Length Units,Meters\n",
        *(",Type" + 8 * ",Rigid Body", ",Name" + 8 * ",Tool", ",ID" + 8 * ",1"),
        "," + 4 * ",Rotation" + 3 * ",Position" + ",Mean Marker Error",
        "Frame,Time (Seconds),X,Y,Z,W,X,Y,Z,",
    ]
)
QTM = ["Frame", *"XYZ", "Roll", "Pitch", "Yaw", "Residual", *(f"Rot[{i}]" for i in range(9))]
LABVIEW = "LabVIEW Measurement\t\nSeparator\tTab\n{0}\t\nChannels\t9\nX0\t0.0\n{0}".format("***End_of_Header***\t\n")
TABLES_OF_POSITIONS: dict[str, dict[str, Text]] = {
    "polyworks": {
        "points.txt": Text(
            "PolyWorks|Inspector\nUnits: Millimeters\n\nObject Name\tControl\tX\tY\tZ\tTest",
            *("mm", "point {0}\tMeasured", "\t", "Pass", "\nReport generated 2026-11-22 14:05 by J. Meier\n"),
        ),
        "joints.csv": Text(f"Name;{JOINTS}", "deg", "point {0}", comma=True),
    },
    "rtde_and_leica": {
        "points.txt": Text("Leica Tracker Pilot\nPoint ID      X      Y      Z      U95 [um]", "mm", "P{0}", " ", "25"),
        "rtde.csv": Text(
            "timestamp {} {} actual_qd_0".format(
                *(" ".join(f"{kind}_q_{i}" for i in range(6)) for kind in ("target", "actual"))
            ),
            *("count q q_read zero", "", " "),
        ),
    },
    "targets_and_differences": {
        "grid.csv": Text(
            "step_order,x_t,y_t,z_t,x_dif,y_dif,z_dif," + ",".join(f"joint_{i}" for i in range(1, 7)),
            *("cmd_mm off_mm deg", "{0}", ","),
        )
    },
    "nominal_values_and_deviations": {
        "report.csv": Text(
            "Nominal X [mm];Nominal Y [mm];Nominal Z [mm];X-Abweichung [cm];Y-Abweichung [cm];Z-Abweichung [cm];"
            + JOINTS,
            "cmd_mm off_cm deg",
        )
    },
    "keyence": {
        "cmm.csv": Text("Element Name;Number;Deviation;MX Coord.;MY Coord.;MZ Coord.", "mm", "Point{0:03d};1;0.012"),
        "joints.csv": Text(f"Name;{JOINTS}", "deg", "Point{0:03d}"),
    },
    "robodk": {"robodk.csv": Text(f"Name,{J},X,Y,Z,Error", "deg mm zero", "Target {0}", ",")},
    "bare_degrees_and_mm": {"poses.txt": Text("", "deg mm", sep=" ")},
    "bare_with_times_since_1970": {
        "lt.txt": Text("", "stamp m", sep=","),
        "joints.txt": Text("", "deg", sep=" "),
    },
    "bare_with_constant_angles": {"poses.csv": Text("", "deg mm constant", sep=",")},
    "bare_points_and_poses": {
        "lt.txt": Text("", "mm", "{0}", "   "),
        "ur.txt": Text("", "cmd_m cmd_rotvec", "{0}", ","),
    },
    "bare_points_with_ids": {
        "lt.txt": Text("", "mm", "{0}7", ",  "),
        "joints.txt": Text("", "deg", "{0}7", ","),
    },
    "leica_with_uncertainty_of_axes": {
        "points.csv": Text(
            ",".join(f"{name}  [mm]" for name in ("X", "Y", "Z", "U(95)", "U(95) X", "U(95) Y", "U(95) Z"))
            + ",Tilt  [deg],Target,Temperature  [°C],Time Stamp,Delete",
            *("mm", "", ",", "0.02,0.01,0.01,0.014,29.9,TMC 30-B #5320,22.8,'11.10.2022 15:06:{0:02d}.043,"),
        ),
        **IN_ORDER,
    },
    "bare_points_and_joints": {"points.csv": Text("", "mm", "{0}", ","), "joints.csv": Text("", "q", sep=",")},
    "bare_position_first": {"poses.csv": Text("", "m q", sep=",")},
    "radian_tracker": {
        "radian.txt": Text(
            "API Radian Pro\nSerial: 40211\nUnits: in\n\n#\tName\tX\tY\tZ\tStd X\tStd Y\tStd Z\tTime",
            *("in", "{0}\tp{0}", "\t", "0.0004\t0.0004\t0.0004\t11/22/2026 2:{0:02d}:17 PM"),
        ),
        **DEGREES,
    },
    "target_report": {
        "report.csv": Text(
            "Target Report\nJob: Cell 3,Date: 11/22/2026\nUnits: in\n\nCollection,Target,X,Y,Z,Ux,Uy,Uz,Timestamp",
            *("in", "A,p{0}", ",", "0.001,0.001,0.0012,11/22/2026 2:05:17 PM"),
        ),
        **DEGREES,
    },
    "nikon": {
        "k.txt": Text(
            "Nikon Metrology K-CMM\nOperator  J. Meier\n\n  ID      X[mm]      Y[mm]      Z[mm]   LEDs",
            *("mm", "  p{0}", "   ", "3"),
        ),
        **DEGREES,
    },
    "qualisys": {
        "qtm.tsv": Text(
            "NO_OF_FRAMES\t24\nFREQUENCY\t100\nMARKER_NAMES\tTool\nFrame\tTime\tTool X\tTool Y\tTool Z",
            *("frames mm", "{0}", "\t"),
        ),
        **DEGREES,
    },
    "kawasaki": {
        **POINTS,
        "as.log": Text("Robot log RS010N\n   No.   JT1     JT2     JT3     JT4     JT5     JT6", "deg", "  {0}", "  "),
    },
    "yaskawa": {
        **POINTS,
        "pos.txt": Text("Pos\t" + "\t".join(f"{letter} [deg]" for letter in "SLURBT"), "deg", "C{0}", "\t"),
    },
    "two_header_lines": {
        "sheet.csv": Text(
            "Point;Joint angles;;;;;;Measured position;;\n;J1;J2;J3;J4;J5;J6;X;Y;Z\n;[deg];;;;;;[mm];;",
            "deg mm",
            "P{0}",
        )
    },
    "german": {
        "messung.csv": Text(
            "Punkt;" + ";".join(f"Gelenk {i} [Grad]" for i in range(1, 7)) + ";X-Ist [mm];Y-Ist [mm];Z-Ist [mm];Datum",
            "deg mm",
            "P{0}",
            more="22.11.2026 14:05",
            comma=True,
        )
    },
    "comments_below": {
        "log.tsv": Text(
            "% cell 3\nA1\tA2\tA3\tA4\tA5\tA6\tX\tY\tZ",
            "deg mm",
            sep="\t",
            tail="% end of data\n% 24 points, rms 0.012\n",
        )
    },
    "side_by_side": {
        "both.csv": Text(f",Joints,,,,,,Commanded,,,Measured,,\nPoint,{J},X,Y,Z,X,Y,Z", "deg cmd_mm mm", "P{0}", ",")
    },
    "commanded_and_read_joints": {
        "both.csv": Text(f"Point,Commanded,,,,,,Actual,,,,,,Measured,,\n,{J},{J},X,Y,Z", "deg deg_read mm", "P{0}", ",")
    },
    "controller_pose_and_leica": {
        "kuka.csv": Text(f"Nr;{JOINTS};X;Y;Z;A;B;C;Leica X;Leica Y;Leica Z", "deg cmd_mm cmd_abc_deg mm", "{0}")
    },
    "names_by_number": {"points.csv": Text("Name;X;Y;Z", "mm", "Pos {0}", tail=DRIFT), **backwards("XP{0:03d}")},
    "names_in_groups": {
        "points.csv": Text("Collection::Group::Point;X;Y;Z", "mm", "Cell::Arm::P{0}", tail=DRIFT),
        **backwards("P{0}"),
    },
    "documented_points_with_names": {
        "points.csv": Text("Point,x_mm,y_mm,z_mm", "mm", "P{0}", ",", tail=DRIFT.replace(";", ",")),
        **backwards("P{0}"),
    },
    "documented_points_with_an_index_of_pandas": {
        "points.csv": Text(",x,y,z", "m", "J{0:03d}", ","),
        "joints.csv": Text(",q1,q2,q3,q4,q5,q6", "q", "J{0:03d}", ",", backwards=True),
    },
    "points_with_an_index_of_pandas": {
        "points.csv": Text(";X [mm];Y [mm];Z [mm];X error", "mm zero", "J{0:03d}"),
        **backwards("J{0:03d}"),
    },
    "small_letters_with_angles_of_kuka": {
        "vive.csv": Text("x,y,z", "mm", sep=","),
        "robot.csv": Text("x,y,z,A,B,C", "cmd_mm cmd_abc_deg", sep=","),
    },
    "names_of_repetitions": {"points.csv": Text("Name;X;Y;Z", "mm", "P{0}_1", tail=DRIFT), **backwards("P{0}")},
    "istwert": {
        "ist.csv": Text(
            ";".join(
                ["Merkmal", *(f"{word} {axis}" for word in ("Istwert", "Sollwert", "Abweichung") for axis in "XYZ")]
            ),
            *("mm cmd_mm off_mm", "P{0}"),
        ),
        "joints.csv": Text(f"Name;{JOINTS}", "deg", "P{0}"),
    },
    "prose_below": {
        "points.csv": Text(
            "Element;X;Y;Z;Form", "mm zero", "XP{0}", tail=";;;;\nErstellt am 25.11.2026 um 14:02;;;;\n"
        ),
        **IN_ORDER,
    },
    "labview": {
        "run.lvm": Text(
            LABVIEW + "X_Value\tJ1\tJ2\tJ3\tJ4\tJ5\tJ6\tTrk X\tTrk Y\tTrk Z\tComment", "seconds deg mm", sep="\t"
        )
    },
    "radian_in_millimetres": {
        "radian.csv": Text(
            "API Radian Pro\nSerial No,40123\nTemperature,20.1,C\n\nNo.,Name,X(mm),Y(mm),Z(mm),RMS X,RMS Y,RMS Z,Time",
            *("mm", "{0},p{0}", ",", "0.002,0.002,0.003,09:00:07.120"),
        ),
        **DEGREES,
    },
    "robotstudio": {
        "signals.csv": Text(
            ";".join(
                (
                    "Time (s)",
                    *(f"System1\\ROB_1\\J{i} (deg)" for i in range(1, 7)),
                    *(f"System1\\ROB_1\\TCP {axis} (mm)" for axis in "XYZ"),
                )
            ),
            *("deg mm", "{0}.0"),
        )
    },
    "pendant": {"ur.txt": Text("base shoulder elbow wrist1 wrist2 wrist3 tx ty tz", "q m", sep=" ")},
    "matlab_table": {"run.csv": Text("t,q_1,q_2,q_3,q_4,q_5,q_6,p_1,p_2,p_3", "seconds q m", sep=",")},
    "letter_behind_the_axis": {"vive.csv": Text("q1,q2,q3,q4,q5,q6,px_r,py_r,pz_r,joint", "q m count", sep=",")},
    "centimetres": {"cm.csv": Text(f"{JOINTS};X;Y;Z", "deg cm")},
    "optotrak": {
        "marker.csv": Text(
            "Number of frames: 24\nUnits: mm\n\nFrame,Marker_1 x,Marker_1 y,Marker_1 z", "mm", "{0}", ","
        ),
        **IN_ORDER,
    },
    "channels": {
        "scan.csv": Text("Name:,Scan\n\nScan,101 <Trk X> (mm),102 <Trk Y> (mm),103 <Trk Z> (mm)", "mm", "{0}", ","),
        **IN_ORDER,
    },
    "units_behind_in": {
        "lab.csv": Text(
            "Punkt;" + ";".join(f"A{i} in °" for i in range(1, 7)) + ";X in mm;Y in mm;Z in mm",
            "deg mm",
            "P{0}",
            comma=True,
        )
    },
    "joints_from_zero": {**POINTS, "log.csv": Text("q0,q1,q2,q3,q4,q5", "q", sep=",")},
    "nominal_and_measured": {
        "cmm.csv": Text("Feature;NX;NY;NZ;MX;MY;MZ;DX;DY;DZ", "cmd_mm mm off_mm", "P{0}"),
        "joints.csv": Text(f"Name;{JOINTS}", "deg", "P{0}"),
    },
    "bars": {
        "run.md": Text(
            "| Point | "
            + " | ".join(f"{name} [deg]" for name in J.split(","))
            + " | X [mm] | Y [mm] | Z [mm] |\n|"
            + "---|" * 10,
            *("deg mm", "| P{0}", " | ", "|"),
        )
    },
    "french": translated("Axe {} (°)", "{} mesuré (mm)"),
    "spanish": translated("Articulación {}", "{} medido"),
    "chinese": translated("关节{}(°)", "实测{}(mm)"),
    "japanese": translated("第{}軸", "測定{}"),
    "italian": translated("Asse {}", "{} misurato", "\n;" + ";".join(["gradi"] * 6 + ["mm"] * 3)),
    **{
        f"{controller} beside {measured}": beside(controller, measured)
        for controller, measured in (
            *(("{}", text) for text in ("Laser {}", "{}_tracker", "T-Mac {}", "AT960_{}", "OptiTrack {}", "{}_LT")),
            *(("{}", text) for text in ("{}_meas", "{} Messung", "{}_ext", "gt_{}", "SMR {}", "Leica{}")),
            *(("Robot {}", "{}"), ("{} Roboter", "{} Lasertracker"), ("TCP {}", "Laser {}"), ("Actual {}", "Laser {}")),
            *(("{}_est", "{}_gt"), ("RIst.{}", "TRK.{}"), ("Controller\\TCP\\{}", "Tracker {}"), ("Pos_{}", "Trk_{}")),
        )
    },
}
TABLES_OF_POSES: dict[str, dict[str, Text]] = {
    "commands_by_number_and_joints_read_back": {
        "log.csv": Text(
            ",".join([f"cmd{i}" for i in range(1, 7)] + [f"j{i}" for i in range(1, 7)])
            + ",x,y,z,euler_x,euler_y,euler_z",
            *("deg deg_read mm rpy_deg", "", ","),
        )
    },
    "documented_names_in_mm_and_degrees": {
        "xarm.csv": Text(f"{J},x,y,z,roll,pitch,yaw", "deg mm rpy_deg", sep=","),
    },
    "pendant_of_universal_robots": {"ur.csv": Text(f"{J},X,Y,Z,RX,RY,RZ", "deg mm rotvec", sep=",")},
    "doosan_table": {"posx.csv": Text(f"{J},x,y,z,a,b,c", "deg mm zyz_deg", sep=",")},
    "goals_in_m_and_a_tracker_in_mm": {
        "series.csv": Text(
            "Goal x;Goal y;Goal z;Goal roll;Goal pitch;Goal yaw;"
            + ";".join(f"joint_{i}" for i in range(1, 7))
            + ";measurement_x;measurement_y;measurement_z;measurement_rx;measurement_ry;measurement_rz",
            *("cmd_m cmd_rpy q mm moving_deg", "", ";", "", "", True),
        )
    },
    "vicon": {
        "vicon.csv": Text(
            "Objects\n100\n,,Tool:Tool,,,,,,\nFrame,Sub Frame,RX,RY,RZ,RW,TX,TY,TZ\n,,,,,,mm,mm,mm",
            *("xyzw mm", "{0},0", ","),
        ),
        "joints.csv": Text(J, "deg", sep=","),
    },
    "counted_quaternion": {
        "points.csv": Text("name,x,y,z,q0,q1,q2,q3", "mm wxyz", "P{0}", ","),
        "joints.csv": Text(f"name,{J}", "deg", "P{0}", ","),
    },
    "bare_quaternions": {"poses.csv": Text("", "deg mm xyzw", sep=",")},
    "tag_and_hand": {
        "poses.csv": Text(
            ",".join(f"{of}_{part}" for of in ("ee", "tag") for part in ("x", "y", "z", "qx", "qy", "qz", "qw")),
            *("cmd_m cmd_xyzw m xyzw", "", ","),
        ),
    },
    "documented_names_in_degrees": {
        "points.csv": Text("x,y,z,roll,pitch,yaw", "mm rpy_deg", sep=","),
        "joints.csv": Text("q1,q2,q3,q4,q5,q6", "deg", sep=","),
    },
    "polyworks_in_chinese": {
        "points.txt": Text(
            "\t".join(
                (
                    "名称",
                    *(f"{of} {a}" for of in ("名义", "测量") for a in ("X", "Y", "Z", "Rx", "Ry", "Rz")),
                    "余量 位置",
                )
            ),
            *("mm rpy_deg mm rpy_deg", "Motion{0}", "\t", "0.118"),
        ),
        "joints.csv": Text("名称,关节1,关节2,关节3,关节4,关节5,关节6", "deg", "Motion{0}", ","),
    },
    "creaform": {
        "vxtrack.csv": Text(
            "VXelements 10.1;;;;;;;;\nTime (s);"
            + ";".join(f"Model1 {name}" for name in ("Tx (mm)", "Ty (mm)", "Tz (mm)", "Qx", "Qy", "Qz", "Qw"))
            + ";Status",
            *("mm xyzw", "{0}", ";", "OK"),
        ),
        **DEGREES,
    },
    "optitrack": {"take.csv": Text(OPTITRACK, "frames xyzw m", "{0}", ",", "0.0002"), **DEGREES},
    "qualisys_bodies": {
        "qtm6d.tsv": Text(
            "NO_OF_FRAMES\t24\nDATA_INCLUDED\t6D\nBODY_NAMES\tTool\n" + "\t".join(QTM),
            *("mm rpy_deg zero matrix", "{0}", "\t"),
        ),
        **DEGREES,
    },
    "trajectories": {
        "m.tum": Text("", "count m xyzw", sep=" "),
        "c.tum": Text("", "count cmd_m cmd_xyzw", sep=" "),
    },
    "spatial_analyzer": {
        "points.csv": Text(
            '"Collection","Object","X","Y","Z","Rx","Ry","Rz"\n"","","(mm)","(mm)","(mm)","(deg)","(deg)","(deg)"',
            *("mm rpy_deg", '"A","p{0}"', ","),
        ),
        **DEGREES,
    },
    "merged_cells": {
        "take.csv": Text(
            "Take 7\n;Position;;;Rotation;;;\nPunkt;X [m];Y [m];Z [m];X;Y;Z;W", "m xyzw", "p{0}", comma=True
        ),
        **DEGREES,
    },
    "vicon_rotation_vector": {
        "segments.csv": Text(
            "Segments\n100\n,,Tool:Tool,,,,,\nFrame,Sub Frame,RX,RY,RZ,TX,TY,TZ\n,,deg,deg,deg,mm,mm,mm",
            *("rotvec_deg mm", "{0},0", ","),
        ),
        "joints.csv": Text(J, "deg", sep=","),
    },
    "ndi": {
        "port.csv": Text(
            "Tools,Port 1,Frame,Face,State,Q0,Qx,Qy,Qz,Tx,Ty,Tz,Error,Markers",
            *("wxyz mm", "1,344,{0},1,OK", ",", "0.05,4"),
        ),
        "joints.csv": Text(J, "deg", sep=","),
    },
    "ndi_stray_markers": {
        "port.csv": Text(
            "Tools,Port 1,Frame,Face,State,Q0,Qx,Qy,Qz,Tx,Ty,Tz,Error,Markers" + ",State,Tx,Ty,Tz" * 2,
            *("wxyz mm", "1,344,{0},1,OK", ",", "0.05,4,OK,{0},5,6,OK,7,8,{0}"),
        ),
        "joints.csv": Text(J, "deg", sep=","),
    },
    "motive_in_groups": {
        "take.csv": Text(
            "Format Version,1.23,Rotation Type,Quaternion,Length Units,Meters,Coordinate Space,Global\n"
            f"\n,{',Rigid Body' * 8}\n,{',SMR' * 8}\n,{',Rotation' * 4}{',Position' * 3},Mean Marker Error\n"
            "Frame,Time (Seconds),X,Y,Z,W,X,Y,Z,",
            *("xyzw m", "{0},{0}.5", ",", "0.0001"),
        ),
        **DEGREES,
    },
    "motive_in_millimetres": {
        "take.csv": Text(
            "Format Version,1.23,Rotation Type,Quaternion,Length Units,Millimeters,Coordinate Space,Global\n"
            f"\n,Type{',Rigid Body' * 8}\n,Name{',Tool' * 8}\n,ID{',8E1C00FF' * 8}\n\n"
            f",{',Rotation' * 4}{',Position' * 3},Mean Marker Error\nFrame,Time (Seconds),X,Y,Z,W,X,Y,Z,",
            *("seconds xyzw mm", "{0}", ",", "0.0002"),
        ),
        **DEGREES,
    },
    "qualisys_moving_axes": {
        "qtm6d.tsv": Text(
            "NO_OF_FRAMES\t60\nNO_OF_CAMERAS\t8\nNO_OF_BODIES\t1\nFREQUENCY\t100\nDESCRIPTION\t--\n"
            "TIME_STAMP\t2026-11-20, 10:47:17\t22107.99179716\nDATA_INCLUDED\t6D\nBODY_NAMES\tTool\n"
            "Frame\tTime\tTool X\tY\tZ\tRoll\tPitch\tYaw\tResidual\tRot[0]\tRot[1]",
            *("seconds mm moving_deg", "{0}", "\t", "0.21\t1.0\t0.0"),
        ),
        **DEGREES,
    },
    "rostopic": {
        "pose.csv": Text(
            ",".join(
                [
                    *("%time", "field.header.seq", "field.header.frame_id"),
                    *(f"field.pose.position.{axis}" for axis in "xyz"),
                    *(f"field.pose.orientation.{axis}" for axis in "xyzw"),
                ]
            ),
            *("m xyzw", "17636356{0:02d}123456789,{0},tracker", ","),
        ),
        "joints.csv": Text(J, "deg", sep=","),
    },
    "auto_id": {"tags.txt": Text("", "mm rpy_deg deg", "Tag{0}", "\t")},
    "open_cv": {
        "aruco.csv": Text(
            ",".join(f"{stem}_{i}" for stem, n in (("joint", 6), ("tvec", 3), ("rvec", 3)) for i in range(n)),
            *("q m rotvec", "", ","),
        )
    },
    "euler_radians": {
        "abc.csv": Text(";".join(f"A{i} [rad]" for i in range(1, 7)) + ";X;Y;Z;Alpha;Beta;Gamma", "q mm zyx")
    },
}


def mm(c: Campaign) -> dict[str, str]:
    return {"points.csv": POINTS["points.csv"].of(c)}


def cam2_and_kuka(c: Campaign) -> dict[str, str]:
    head = "FARO CAM2 Measure 10\n(Millimeters)\n\nLabel,Feature,X,Y,Z,RMS\n"
    rows = [[f"XP{i}", "Point", *row.tolist(), 0.012] for i, row in enumerate(c.position * MM, 1)]
    axes = (",".join(f"A{k} {v:.7f}" for k, v in enumerate(row, 1)) for row in np.degrees(c.q))
    declared = "".join(f"DECL E6AXIS XP{i}={{{text}}}\n" for i, text in enumerate(axes, 1))
    moves = "".join(f"PTP XP{i}\n" for i in range(1, N + 1))
    return {
        "points.csv": lines(rows, ",", head),
        "cell.src": f"DEF cell( )\n{moves}END\n",
        "cell.dat": f"DEFDAT cell\n{declared}ENDDAT\n",
    }


def kuka_points_alone(c: Campaign) -> dict[str, str]:
    files = cam2_and_kuka(c)
    points = "".join(line + "\n" for line in files["cell.dat"].splitlines() if line.startswith("DECL"))
    return {"points.csv": files["points.csv"], "points.dat": points}


def fanuc_in_inches(c: Campaign) -> dict[str, str]:
    rows = named(c.position / 0.0254, "P[{}]")
    blocks = []
    for i, q in enumerate(np.degrees(c.q), 1):
        joints = [f"J{k}= {v:.7f} deg" for k, v in enumerate(q, 1)]
        blocks.append(
            f"P[{i}]{{\n   GP1:\n\tUF : 0, UT : 1,\n\t{','.join(joints[:3])},\n\t{','.join(joints[3:])}\n}};\n"
        )
    moves = "".join(f"{i:4d}:J P[{i}] 10% FINE ;\n" for i in range(1, N + 1))
    program = f"/PROG  CALIB\n/MN\n{moves}/POS\n{''.join(blocks)}/END\n"
    return {"points.csv": lines(rows, ",", "Radian, units: inches\nPoint,X,Y,Z\n"), "calib.ls": program}


def laboratory(c: Campaign) -> dict[str, str]:
    values = np.hstack((np.degrees(c.q), c.position * MM))
    head = "Messprotokoll\n\nNr.;A1;A2;A3;A4;A5;A6;X;Y;Z;U95 [um];Bemerkung\n"
    rows = [[i, *row.tolist(), 40, "SMR gereinigt" if i == 7 else ""] for i, row in enumerate(values, 1)]
    mean = ";".join(f"{v:.5f}" for v in values.mean(axis=0))
    tail = f";;;;;;;;;;;\nMittelwert;{mean};40;\nUnterschrift:;J. Meier;;;;;;;;;;\n"
    return {"lab.csv": lines(rows, ";", head, tail).replace(".", ",")}


def spatial_analyzer_and_rapid(c: Campaign) -> dict[str, str]:
    rows = named(c.position * MM, "A::Main::p{}")[::-1]
    declared = "".join(
        f"  CONST jointtarget p{i}:=[[{','.join(f'{v:.7f}' for v in q)}],[9E9,9E9,9E9,9E9,9E9,9E9]];\n"
        for i, q in enumerate(np.degrees(c.q), 1)
    )
    moves = "".join(f"    MoveAbsJ p{i},v100,fine,tool0;\n" for i in range(1, N + 1))
    program = f"MODULE Calib\n{declared}  PROC main()\n{moves}  ENDPROC\nENDMODULE\n"
    return {"points.csv": lines(rows, ",", "Point Name,X (mm),Y (mm),Z (mm)\n"), "cell.mod": program}


def lists_in_cells(c: Campaign) -> dict[str, str]:
    """As pandas writes columns of lists."""
    rows = zip(c.q.round(9).tolist(), c.position.round(9).tolist(), strict=True)
    text = "".join(f'{i}.5,"{q}","{p}",\n' for i, (q, p) in enumerate(rows))
    return {"log.csv": "timestamp,joint_positions,tracker_position,comment\n" + text}


def json_lines(c: Campaign) -> dict[str, str]:
    rows = zip(c.q.tolist(), c.position.tolist(), c.turn.as_quat().tolist(), strict=True)
    records = ({"joints": q, "position": p, "orientation": o} for q, p, o in rows)
    return {"log.jsonl": "".join(json.dumps(record) + "\n" for record in records)}


def json_records(c: Campaign) -> dict[str, str]:
    turns = [dict(zip("xyzw", row, strict=True)) for row in c.turn.as_quat().tolist()]
    rows = zip(np.degrees(c.q).tolist(), (c.position * MM).tolist(), turns, strict=True)
    records = [{"name": f"P{i}", "joints_deg": q, "position": p, "orientation": o} for i, (q, p, o) in enumerate(rows)]
    return {"records.json": json.dumps({"station": "AT960", "poses": records}, indent=1)}


def json_columns(c: Campaign) -> dict[str, str]:
    columns = {"joint_angles_deg": np.degrees(c.q).tolist(), "position": c.position.tolist()}
    return {"columns.json": json.dumps({"robot": ROBOT, **columns})}


def json_by_name(c: Campaign) -> dict[str, str]:
    rows = enumerate(zip(c.q.tolist(), c.position.tolist(), strict=True), 1)
    return {"poses.json": json.dumps({f"pose_{i}": {"joints": q, "position": place} for i, (q, place) in rows})}


def means_between_rows(c: Campaign) -> dict[str, str]:
    """Groups of eight rows, each with its mean below."""
    rows = np.hstack((np.degrees(c.q), c.position * MM))
    groups = [[*named(group), ["Mean", *group.mean(axis=0).tolist()]] for group in np.split(rows, 3)]
    return {"groups.csv": lines(itertools.chain(*groups), ";", f"Name;{JOINTS};X;Y;Z\n")}


def names_on_each_line(c: Campaign) -> dict[str, str]:
    form = " ".join([*(f"J{i}={{}}" for i in range(1, 7)), "X={}", "Y={}", "Z={}\n"])
    return {"log.txt": "".join(form.format(*row) for row in np.hstack((np.degrees(c.q), c.position * MM)).round(7))}


def franka_matrices(c: Campaign) -> dict[str, str]:
    matrix = homogeneous(c.position, c.turn).transpose(0, 2, 1).reshape(N, 16)
    head = [*(f"q[{i}]" for i in range(6)), *(f"O_T_EE[{i}]" for i in range(16))]
    return {"franka.csv": lines(np.hstack((c.q, matrix)).tolist(), ",", ",".join(head) + "\n")}


def yaml_records(c: Campaign) -> dict[str, str]:
    rows = zip(np.degrees(c.q).tolist(), (c.position * MM).tolist(), strict=True)
    return {"records.yaml": yaml.safe_dump([{"joints": q, "position": p} for q, p in rows])}


def trials(c: Campaign) -> dict[str, str]:
    rows = [[i, "OK", *row.tolist()] for i, row in enumerate(np.hstack((np.degrees(c.q), c.position * MM)), 1)]
    rows.insert(4, [5, "LOST", *rows[4][2:8], "", "", ""])
    rows.insert(9, [9, "FAILED", *rows[9][2:8], "nan", "nan", "nan"])
    return {"trials.csv": lines(rows, ",", "trial,status,j1,j2,j3,j4,j5,j6,x,y,z\n")}


def homogeneous(position: np.ndarray, turn: Rotation) -> np.ndarray:
    matrices = np.tile(np.eye(4), (N, 1, 1))
    matrices[:, :3, :3], matrices[:, :3, 3] = turn.as_matrix(), position
    return matrices


def bare_matrices(c: Campaign) -> dict[str, str]:
    return {"bare.txt": lines(np.hstack((c.q, homogeneous(c.position, c.turn).reshape(N, 16))), " ")}


def hand_eye_matrices(c: Campaign) -> dict[str, str]:
    pairs = zip(homogeneous(c.commanded, c.commanded_turn), homogeneous(c.position, c.turn), strict=True)
    return {"handeye.json": json.dumps([{"robot_pose": a.tolist(), "camera_pose": b.tolist()} for a, b in pairs])}


def rotations_and_translations(c: Campaign) -> dict[str, str]:
    """The two parts of each pose by the names that OpenCV has for them."""
    robot, camera = homogeneous(c.commanded, c.commanded_turn), homogeneous(c.position, c.turn)
    parts = {"R_gripper2base": robot[:, :3, :3].reshape(N, 9), "t_gripper2base": robot[:, :3, 3:]}
    parts |= {"R_target2cam": camera[:, :3, :3], "t_target2cam": camera[:, :3, 3]}
    return {"handeye.json": json.dumps({name: part.tolist() for name, part in parts.items()})}


def base_seen_from_the_hand(c: Campaign) -> dict[str, str]:
    """The robot's part as OpenCV wants it of a camera beside the arm, in the YAML of OpenCV, a matrix for each pose."""
    robot = np.linalg.inv(homogeneous(c.commanded, c.commanded_turn))
    camera, text = homogeneous(c.position, c.turn), "%YAML:1.0\n---\n"
    for i, (arm, seen) in enumerate(zip(robot, camera, strict=True)):
        for name, pose in (("base2gripper", arm), ("target2cam", seen)):
            for letter, part in (("R", pose[:3, :3]), ("t", pose[:3, 3:])):
                rows = f"rows: 3\n   cols: {part.shape[1]}\n   dt: d\n   data: {part.ravel().tolist()}"
                text += f"{letter}_{name}_{i}: !!opencv-matrix\n   {rows}\n"
    return {"handeye.yaml": text}


def lists_of_matrices(c: Campaign) -> dict[str, str]:
    pairs = {"seen.json": (c.position, c.turn), "robot.json": (c.commanded, c.commanded_turn)}
    return {name: json.dumps(homogeneous(*pair).tolist()) for name, pair in pairs.items()}


def hand_eye_transforms(c: Campaign) -> dict[str, str]:
    def transform(position: np.ndarray, quaternion: np.ndarray) -> dict[str, Any]:
        return {
            "translation": dict(zip("xyz", position.tolist(), strict=True)),
            "rotation": dict(zip("xyzw", quaternion.tolist(), strict=True)),
        }

    rows = zip(c.commanded, c.commanded_turn.as_quat(), c.position, c.turn.as_quat(), strict=True)
    samples = [{"robot": transform(p, o), "tracking": transform(x, u)} for p, o, x, u in rows]
    return {"samples.yaml": yaml.safe_dump({"samples": samples})}


def bare_with_rows_of_nan(c: Campaign) -> dict[str, str]:
    return {"m.csv": lines(with_nan(np.hstack((c.q, c.position))))}


def with_nan(values: np.ndarray) -> list[list[Any]]:
    rows: list[list[Any]] = values.tolist()
    nan = ["NaN"] * len(rows[0])
    return [*rows[:3], nan, *rows[3:10], nan, *rows[10:]]


def matlab(c: Campaign) -> dict[str, str]:
    names = ",".join(f"{stem}_{i}" for stem, n in (("joint", 6), ("pos", 3)) for i in range(1, n + 1))
    return {"out.csv": lines(with_nan(np.hstack((c.q, c.position))), ",", names + "\n")}


UR_JOINTS = [f"{name}_joint" for name in ("elbow", "shoulder_lift", "shoulder_pan", "wrist_1", "wrist_2", "wrist_3")]


def ros_echo(c: Campaign) -> dict[str, str]:
    messages = []
    for i, q in enumerate(c.q[:, [2, 1, 0, 3, 4, 5]].tolist()):
        header = {"stamp": {"sec": 1763800000 + i, "nanosec": 5}, "frame_id": ""}
        messages.append({"header": header, "name": UR_JOINTS, "position": q, "velocity": [0.0] * 6, "effort": []})
    return mm(c) | {"joints.txt": "---\n".join(yaml.safe_dump(item, sort_keys=False) for item in messages) + "---\n"}


def plotjuggler(c: Campaign) -> dict[str, str]:
    names = ["__time", *(f"/joint_states/{name}/position" for name in UR_JOINTS), "/joint_states/elbow_joint/velocity"]
    rows = np.hstack((1763800000.5 + np.arange(N)[:, None], c.q[:, [2, 1, 0, 3, 4, 5]], np.zeros((N, 1))))
    return mm(c) | {"joints.csv": lines(rows, ",", ",".join(names) + "\n")}


def rostopic_joint_states(c: Campaign) -> dict[str, str]:
    """Names of the joints in each row, in the order in which the driver of Universal Robots sorts them."""
    head = ",".join(["%time", *(f"field.{part}{i}" for part in ("name", "position") for i in range(6))]) + "\n"
    rows = ([k, *UR_JOINTS, *q] for k, q in enumerate(c.q[:, [2, 1, 0, 3, 4, 5]].tolist()))
    return mm(c) | {"joints.csv": lines(rows, ",", head)}


def table(head: str, *columns: np.ndarray, sep: str = ";", name: str = "", tail: str = "") -> str:
    values = np.hstack(columns)
    return lines(named(values, name) if name else values, sep, head + "\n", tail)


def stamped(c: Campaign) -> dict[str, str]:
    """Rows at rest, of which each file lacks another one, by times that differ by some milliseconds."""
    at = 1.7956e9 + 5.0 * np.arange(N + 2)[:, None]
    poses = np.vstack((c.position[:1] + 0.1, c.position))
    turns = np.vstack((c.turn.as_quat()[:1], c.turn.as_quat()))
    head = "# timestamp tx ty tz qx qy qz qw"
    joints = np.vstack((c.q, c.q[:1] + 0.1))
    names = "time," + ",".join(f"q{i}_rad" for i in range(1, 7))
    return {
        "measured.tum": table(head, at[:-1] + 0.017, poses, turns, sep=" "),
        "joints.csv": table(names, at[1:], joints, sep=","),
    }


def in_rows(row: str, head: str, above: str = "", behind_z: str = "") -> Form:
    """A report with a line for each coordinate; its deviation is -1 mm."""

    def files(c: Campaign) -> dict[str, str]:
        text = "".join(
            above.format(i)
            + "".join(row.format(i=i, a=a, lower=a.lower(), n=v + 1, v=v) for a, v in zip("XYZ", values, strict=True))
            + behind_z
            for i, values in enumerate(c.position * MM, 1)
        )
        return {"report.txt": head + text, "joints.csv": table(JOINTS, np.degrees(c.q))}

    return files


LOCATION = "\nDIM LOC{0}= LOCATION OF POINT P{0}  UNITS=MM"
REPORTS: dict[str, Form] = {
    "polyworks_blocks": in_rows(
        "P{i}\t{a}\t{n:.6f}\t{v:.6f}\tPass\n",
        "Report\nUnits: Millimeters\n\nName\tControl\tNominal\tMeasured\tTest\n",
        behind_z="\t3D Dist\t\t\tPass\n",
    ),
    "metrolog": in_rows(
        "P{i}\tPoint\t{a}\t{n:.6f}\t{v:.6f}\tOK\n",
        "METROLOG\tcell 4\nElement\tType\tAxe\tNominal\tMesuré\tStatus\n",
    ),
    "pc_dmis": in_rows(
        "{a} {n:.6f} 0.5 {v:.6f} -1.0\n",
        "PART NAME  : CELL\n",
        LOCATION + "\nAX    NOMINAL    +TOL    MEAS    DEV\n",
    ),
    "pc_dmis_with_graphs": in_rows(
        "{a} {n:.4f} 0.5 0.5 {v:.6f} -1.0 0.0 ----#----\n",
        "PART NAME  : CELL\n",
        LOCATION
        + " ,$\nGRAPH=OFF  TEXT=OFF  MULT=10.00  OUTPUT=BOTH\n"
        + "AX    NOMINAL       +TOL       -TOL       MEAS        DEV     OUTTOL\n",
    ),
    "calypso": in_rows(
        "c\t1\tP{i}_{a}\t{a}1\t{lower}Value\t{v:.7f}\t{n:.7f}\t1\t-1\tP{i}\t\tmm\n",
        "planid\tpartnb\tid\ttype\tidsymbol\tactual\tnominal\tuppertol\tdeviation\tfeatureid\tcomment\tunit\n",
    ),
    # No column says which axis a line is of.
    "names_with_axes": in_rows(
        "Punkt{i}_{a}   {v:.6f}   {n:.6f}   -1.0000\n",
        "Messplan: Zelle\n\nName   Istwert   Nennwert   Abweichung\n",
    ),
    "names_of_calypso": in_rows("{a}-Wert_Punkt{i}\t{n:.6f}\t{v:.6f}\t-1.0\n", "Merkmal\tNennmaß\tIstmaß\tAbw.\n"),
    "axes_of_measured_values": in_rows(
        "P{i}\tM{a}\t{n:.6f}\t{v:.6f}\t-1\n", "Feature\tAxis\tNominal\tMeasured\tDeviation\n"
    ),
}


def body_and_marker(c: Campaign) -> dict[str, str]:
    """Motive's export with a marker of the rigid body, and rows in which the body was lost."""
    head = ",Type" + ",Rigid Body" * 7 + ",Rigid Body Marker" * 3 + "\n,ID" + ',"7A2"' * 7 + ',"7A3"' * 3 + "\n"
    head += f",,{'Rotation,' * 4}{'Position,' * 6}".rstrip(",") + "\nFrame,Time (Seconds),X,Y,Z,W,X,Y,Z,X,Y,Z\n"
    rows = [[i, i / 120, *row] for i, row in enumerate(np.hstack((c.turn.as_quat(), c.position, c.position + 0.03)), 1)]
    lost = "0,0.0" + "," * 10 + "\n"
    joints = np.vstack((c.q[:1] + 0.1, c.q))
    return {"take.csv": lines(rows, ",", head + lost), "joints.csv": table("J1;J2;J3;J4;J5;J6", joints)}


def tool_and_stray(c: Campaign) -> dict[str, str]:
    head = "Tools,Frame,State,Q0,Qx,Qy,Qz,Tx,Ty,Tz,Error,State,Tx,Ty,Tz\n"
    values = np.hstack((np.roll(c.turn.as_quat(), 1, axis=1), c.position * MM))
    rows = [["1", i, "OK", *row, 0.04, "OK", *(row[4:] + 20)] for i, row in enumerate(values)]
    rows.insert(3, ["1", 99, "Missing", *[""] * 8, "Missing", *[""] * 3])
    joints = np.insert(c.q, 3, 0.5, axis=0)
    return {"polaris.csv": lines(rows, ",", head), "joints.csv": table("J1;J2;J3;J4;J5;J6", joints)}


def yaskawa_job(c: Campaign) -> dict[str, str]:
    places = lines(named(np.degrees(c.q), "C{:05d}=")).replace("=,", "=")
    moves = "".join(f"MOVJ C{i:05d} VJ=10.00 ' P{i}\n" for i in range(1, N + 1))
    job = f"/JOB\n//POS\n///POSTYPE ANGLE\n///ANGLE\n{places}//INST\nNOP\n{moves}END\n"
    return {"points.csv": table("Target name;X;Y;Z", c.position * MM, name="P{}"), "calib.JBI": job}


def le_robot(c: Campaign) -> dict[str, str]:
    pose = np.hstack((c.position, c.turn.as_quat())).tolist()
    rows = [{"observation.state": q, "action": q, "observation.tracker_pose": p, "timestamp": i / 30}
            for i, (q, p) in enumerate(zip(c.q.tolist(), pose, strict=True))]  # fmt: skip
    return {"episode.jsonl": "".join(f"{json.dumps(row)}\n" for row in rows)}


def numbers(values: Iterable[float], pattern: str = "{:.7f}", sep: str = ",") -> str:
    return sep.join(map(pattern.format, values))


def logged(form: str, column: str) -> Form:
    """A log of the controller, a line for each pose, beside the points of an instrument."""

    def files(c: Campaign) -> dict[str, str]:
        text = "".join(form.format(i, numbers(row)) + "\n" for i, row in enumerate(columns_of(c)[column].tolist(), 1))
        return {"points.csv": table("Name;X;Y;Z", c.position * MM, name="P{}"), "robot.log": "Log of cell 3\n" + text}

    return files


NO_AXES = "[9E+09,9E+09,9E+09,9E+09,9E+09,9E+09]"
LOGS: dict[str, Form] = {
    "abb_jointtargets": logged("22-11-2026 14:05:{0:02d} P{0}: CJointT = [[{1}]," + NO_AXES + "] ok", "deg"),
    "abb_targets_in_order": logged("jPos:=[[{1}]," + NO_AXES + "]", "deg"),
    "universal_robots_messages": logged("INFO 14:05:{0:02d} joints: [{1}] pose: p[0.1, 0.2, 0.3, 0.0, 3.1, 0.0]", "q"),
    "doosan": logged("movej(posj({1}), v=30, a=30)", "deg"),
    "xarm": logged("arm.set_servo_angle(angle=[{1}], speed=20, wait=True)", "deg"),
}


def kuka_axes(c: Campaign) -> dict[str, str]:
    rows = (numbers(q, "{:.6f}").split(",") for q in np.degrees(c.q))
    axes = (", ".join(f"A{k} {v}" for k, v in enumerate(row, 1)) for row in rows)
    text = "".join(f"14:05:{i:02d} XP{i} $AXIS_ACT={{E6AXIS: {row}, E1 0.0}}\n" for i, row in enumerate(axes, 1))
    return {"points.csv": table("Name;X;Y;Z", c.position * MM, name="XP{}"), "kuka.log": text}


def fanuc_registers(c: Campaign) -> dict[str, str]:
    """POSREG.VA of a backup; its registers are rounded to 0.001 degree."""
    text = "[*POSREG*]$POSREG  Storage: SHADOW  Access: RW  : ARRAY[1,200] OF Position Reg\n"
    for i, q in enumerate(np.degrees(c.q), 1):
        halves = ["   ".join(f"J{k + 1} = {q[k]:12.6f} deg" for k in part) for part in ((0, 1, 2), (3, 4, 5))]
        text += f"    [1,{i}] =   'P{i}'   Group: 1\n  {halves[0]} \n  {halves[1]} \n\n"
    points = table("Name;X;Y;Z", c.position * MM, name="P{}")
    return {"points.csv": points, "posreg.va": f"{text}    [1,99] =   '' Uninitialized\n"}


def named_values(c: Campaign) -> dict[str, str]:
    """Names before the values on each line, of a joint and a coordinate."""
    names = [*(f"J{i}" for i in range(1, 7)), *"XYZ"]
    rows = np.hstack((np.degrees(c.q), c.position * MM)).tolist()
    pairs = (" ".join(f"{name}={v:.7f}" for name, v in zip(names, row, strict=True)) for row in rows)
    return {"run.log": "".join(f"[14:05:{i:02d}] INFO {text}\n" for i, text in enumerate(pairs))}


def blocks_of_lists(c: Campaign) -> dict[str, str]:
    block = "Point: P{}\nJoints (deg): {}\nMeasured (mm): {}\n\n".format
    rows = enumerate(zip(np.degrees(c.q), c.position * MM, strict=True), 1)
    return {"run.txt": "".join(block(i, numbers(q, sep=", "), numbers(p, sep=", ")) for i, (q, p) in rows)}


def python_lists(c: Campaign) -> dict[str, str]:
    rows = zip(np.degrees(c.q), c.position * MM, strict=True)
    return {"run.txt": "".join(f"[{numbers(q, sep=', ')}] [{numbers(p, sep=', ')}]\n" for q, p in rows)}


def lists_behind_names(c: Campaign) -> dict[str, str]:
    """Points, and poses of ABB without brackets around their two lists; numbers alone tell which belong together."""
    poses = zip(c.commanded * MM, np.roll(c.commanded_turn.as_quat(), 1, axis=1), strict=True)
    robot = (f"Print{i}=[{numbers(place)}],[{numbers(turn)}]\n" for i, (place, turn) in enumerate(poses, 1))
    points = (f"P{i}=[{numbers(place)}]\n" for i, place in enumerate(c.position * MM, 1))
    return {"points.txt": "".join(points), "robot.txt": "".join(robot)}


def printed_arrays(c: Campaign) -> dict[str, str]:
    """Matrices as NumPy prints them, one behind the other."""
    with np.printoptions(precision=10):
        seen = "".join(f"{matrix}\n" for matrix in homogeneous(c.position, c.turn))
    return {"seen.txt": seen, "joints.csv": Text(JOINTS, "deg").of(c)}


def matrices_in_a_log(c: Campaign) -> dict[str, str]:
    """Matrices below lines that say what they are of, between other lines."""
    text, where = "Server listening on port 59153...\n", "Camera Position in Marker Coordinate Space"
    hands, eyes = homogeneous(c.commanded * MM, c.commanded_turn), homogeneous(c.position * MM, c.turn)
    for i, (hand, eye) in enumerate(zip(hands, eyes, strict=True)):
        of_hand, of_eye = (lines(matrix, "  ") for matrix in (hand, eye))
        text += f">>> Robot TCP Position:\n{of_hand}Scan was triggered, Frame Id: {i}\n>>> {where}:\n{of_eye}"
    return {"scan.log": text}


def abb_with_tracker(c: Campaign) -> dict[str, str]:
    """Joints, the controller's position and that of an instrument on each line."""
    rows = zip(np.degrees(c.q), c.commanded * MM, c.position * MM, strict=True)
    texts = (f"[[{numbers(q)}],{NO_AXES}] at [[{numbers(r)}],[1,0,0,0],[0,0,0,0],{NO_AXES}] tracker [{numbers(p)}]"
             for q, r, p in rows)  # fmt: skip
    return {"abb.log": "".join(f"Pose {i} joints {text}\n" for i, text in enumerate(texts, 1))}


def rokae(c: Campaign) -> dict[str, str]:
    """Targets of a program of ROKAE, with the seventh axis that the arm does not have."""
    rows = enumerate(np.degrees(c.q), 1)
    text = "".join(f"LOCAL VAR jointtarget j{i} = j:{{\t{numbers(q)}  ,0\t}}\t{{EJ 0,0,0,0,0,0}}\n" for i, q in rows)
    return {"points.csv": POINTS["points.csv"].of(c), "angle.csv": text}


def robtargets(c: Campaign) -> dict[str, str]:
    """As TPWrite and Write of RAPID print them, beside a tracker of 6 degrees of freedom."""
    rows = zip(c.commanded * MM, np.roll(c.commanded_turn.as_quat(), 1, axis=1), strict=True)
    text = "".join(
        f"Print{i}=[[{numbers(p)}],[{numbers(q, '{:.9f}')}],[0,-1,0,1],{NO_AXES}]\n" for i, (p, q) in enumerate(rows, 1)
    )
    head = "Name;" + ";".join((*(f"{axis} [mm]" for axis in "XYZ"), *(f"Q{axis}" for axis in "xyzw")))
    return {"points.csv": table(head, c.position * MM, c.turn.as_quat(), name="Print{}"), "log.txt": text}


def kuka_poses(c: Campaign) -> dict[str, str]:
    rows = np.hstack((c.commanded * MM, c.commanded_turn.as_euler("ZYX", degrees=True))).tolist()
    pairs = (", ".join(f"{k} {v:.7f}" for k, v in zip("XYZABC", row, strict=True)) for row in rows)
    text = "".join(f"P{i} $POS_ACT={{E6POS: {pair}, S 2, T 35, E1 0.0}}\n" for i, pair in enumerate(pairs, 1))
    return {"points.csv": robtargets(c)["points.csv"].replace("Print", "P"), "kuka.log": text}


def dmis(c: Campaign) -> dict[str, str]:
    rows = enumerate(c.position * MM, 1)
    text = "".join(f"FA(P{i})=FEAT/POINT,CART,{numbers(row)},0.0,0.0,1.0\n" for i, row in rows)
    return {
        "out.dmo": f"DMISMN/'CELL',05.2\nUNITS/MM,ANGDEC\n{text}ENDFIL\n",
        "joints.csv": table(JOINTS, np.degrees(c.q)),
    }


def stacked_matrices(c: Campaign) -> dict[str, str]:
    def text(matrices: np.ndarray) -> str:
        return "\n".join(lines(matrix, " ") for matrix in matrices)

    return {
        "board.txt": text(homogeneous(c.position, c.turn)),
        "robot.txt": text(homogeneous(c.commanded, c.commanded_turn)),
    }


def matrices_side_by_side(c: Campaign) -> dict[str, str]:
    return {
        "board.csv": lines(np.hstack(homogeneous(c.position, c.turn))),
        "RobotToolPose.csv": lines(np.hstack(homogeneous(c.commanded, c.commanded_turn))),
    }


def pairs_with_euler_angles(c: Campaign) -> dict[str, str]:
    """Both poses in one convention, which no name says."""
    columns = [c.commanded * MM, c.commanded_turn.as_euler("xyz", degrees=True), c.position * MM]
    names = (f"{who}_{key}" for who in ("robot", "cam") for key in ("x", "y", "z", "rx", "ry", "rz"))
    return {"pairs.csv": table(",".join(names), *columns, c.turn.as_euler("xyz", degrees=True), sep=",")}


def coordinates_and_markers(c: Campaign) -> dict[str, str]:
    """Six numbers of the controller beside what a camera saw, and times as programs name files."""
    turns = c.commanded_turn.as_euler("xyz", degrees=True)
    rows = zip(c.commanded * MM, turns, c.position * MM, c.turn.as_rotvec(), strict=True)
    records = [
        {
            "timestamp": f"20260131_1818{i:02d}",
            "robot_coords": [*p.tolist(), *angles.tolist()],
            "aruco_markers": [{"id": 0, "translation_mm": seen.tolist(), "rotation_vector": turn.tolist()}],
        }
        for i, (p, angles, seen, turn) in enumerate(rows)
    ]
    return {"record.json": json.dumps(records)}


def lines_of_hand_and_eye(c: Campaign) -> dict[str, str]:
    """As handeye-calib writes them for aubo, elfin and JAKA."""
    turns = (turn.as_euler("xyz", degrees=True) for turn in (c.commanded_turn, c.turn))
    hand, eye = (np.hstack((p, angles)) for p, angles in zip((c.commanded, c.position), turns, strict=True))
    pairs = zip(hand, eye, strict=True)
    return {"pairs.csv": "".join(f"hand,{numbers(a, sep=', ')}\neye,{numbers(b, sep=', ')}\n" for a, b in pairs)}


def tf_echo(c: Campaign) -> dict[str, str]:
    """As tf of ROS prints a transform; the angles repeat the quaternion."""
    block = (
        "At time {}.5\n- Translation: [{}]\n- Rotation: in Quaternion [{}]\n            in RPY (radian) [{}]\n".format
    )
    rows = zip(c.position, c.turn.as_quat(), c.turn.as_euler("xyz"), strict=True)
    texts = (block(1763635600 + i, *(numbers(v, "{:.8f}", ", ") for v in row)) for i, row in enumerate(rows))
    return {"tf.txt": "".join(texts), "joints.csv": table(JOINTS, np.degrees(c.q))}


def franka_states(c: Campaign) -> dict[str, str]:
    """States one behind the other, as libfranka prints them."""
    states = (f'{{\n  "q": {q},\n "dq": {[0.0] * 6},\n  "robot_mode": "Idle"\n}}\n' for q in c.q.tolist())
    return mm(c) | {"states.txt": "".join(states)}


PANDAS = {
    "columns": lambda names, rows: {k: {str(i): row[j] for i, row in enumerate(rows)} for j, k in enumerate(names)},
    "index": lambda names, rows: {str(i): dict(zip(names, row, strict=True)) for i, row in enumerate(rows)},
    "split": lambda names, rows: {"columns": names, "index": [*range(len(rows))], "data": rows},
    "values": lambda _, rows: rows,
}
"""Documents of the orientations of ``DataFrame.to_json``."""


def pandas(orient: str) -> Form:
    def files(c: Campaign) -> dict[str, str]:
        rows = np.hstack((c.q, c.position)).round(9).tolist()
        return {"log.json": json.dumps(PANDAS[orient]([*(f"q{i}" for i in range(1, 7)), "x", "y", "z"], rows))}

    return files


POSITIONS: tuple[Form, ...] = (
    *(cam2_and_kuka, kuka_points_alone, fanuc_in_inches, laboratory, spatial_analyzer_and_rapid, yaml_records),
    *(json_by_name, means_between_rows, names_on_each_line),
    *(json_columns, trials, bare_with_rows_of_nan, matlab, ros_echo, plotjuggler),
    rostopic_joint_states,
    *(yaskawa_job, lists_in_cells, kuka_axes, fanuc_registers, named_values, blocks_of_lists, python_lists),
    *(
        abb_with_tracker,
        rokae,
        dmis,
        franka_states,
        lists_behind_names,
    ),
)
POSES: tuple[Form, ...] = (
    *(rotations_and_translations, base_seen_from_the_hand, lists_of_matrices),
    *(json_lines, json_records, bare_matrices, hand_eye_matrices, hand_eye_transforms, stamped, body_and_marker),
    *(tool_and_stray, le_robot, robtargets, kuka_poses, stacked_matrices, matrices_side_by_side),
    *(pairs_with_euler_angles, lines_of_hand_and_eye, tf_echo, printed_arrays, matrices_in_a_log),
    *(coordinates_and_markers, franka_matrices),
)
FORMS: dict[str, Form | dict[str, Text]] = {
    **TABLES_OF_POSITIONS,
    **TABLES_OF_POSES,
    **{form.__name__: form for form in (*POSITIONS, *POSES)},
    **LOGS,
    **REPORTS,
    **{f"pandas_{orient}": pandas(orient) for orient in PANDAS},
}
WITH_ORIENTATION = (*TABLES_OF_POSES, *(form.__name__ for form in POSES))
WITHOUT_ROBOT = (
    *("hand_eye_matrices", "hand_eye_transforms", "trajectories", "robtargets", "kuka_poses", "stacked_matrices"),
    *("matrices_side_by_side", "pairs_with_euler_angles", "lines_of_hand_and_eye", "rotations_and_translations"),
    *(
        "lists_behind_names",
        "base_seen_from_the_hand",
        "matrices_in_a_log",
        "goals_in_m_and_a_tracker_in_mm",
        "coordinates_and_markers",
    ),
    *("small_letters_with_angles_of_kuka",),
)


@cache
def arm() -> robacc.Robot:
    return robacc.read_robot(ROBOT)


def made(form: str, c: Campaign) -> dict[str, str]:
    """The files of a form."""
    files = FORMS[form]
    return {name: text.of(c) for name, text in files.items()} if isinstance(files, dict) else files(c)


def written(files: dict[str, str], folder: Path) -> list[str]:
    """Write the files, and return the arguments that name the measured poses and, if there are any, the commands."""
    for name, text in files.items():
        (folder / name).write_text(text, encoding="utf-8")
    first, *others = files
    return [str(folder / first), *(["--commanded", str(folder / others[0])] if others else [])]


def figures(arguments: list[str]) -> dict[str, Any]:
    return document("estimate", *arguments)


@pytest.fixture(scope="module")
def plain(campaign: Campaign, tmp_path_factory: pytest.TempPathFactory) -> dict[bool, dict[str, Any]]:
    """The figures of the plain file, with orientations and without."""
    head, found = ",".join(f"q{i}" for i in range(1, 7)) + ",x,y,z", {}
    for turned in (True, False):
        values = np.hstack((campaign.q, campaign.position, *([campaign.turn.as_quat()] if turned else [])))
        text = lines(values, ",", f"{head}{',qx,qy,qz,qw' * turned}\n")
        path = saved(tmp_path_factory.mktemp("plain") / "plain.csv", text)
        found[turned] = figures([str(path), "--robot", ROBOT])
        assert found[turned]["position"]["rms_m"] < 1e-4
    return found


def in_order(x: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Rows by their first coordinate: a program may visit the poses in another order than the file."""
    return values[np.argsort(x)]


@pytest.mark.parametrize("form", FORMS)
def test_a_form_is_read_as_what_was_measured(form: str, campaign: Campaign, tmp_path: Path) -> None:
    path, *commanded = written(made(form, campaign), tmp_path)
    for robot in (arm(), *([None] if form in WITHOUT_ROBOT else [])):
        data = robacc.read_poses(path, robot=robot, commanded=commanded[-1] if commanded else None)
        position = data.position.T
        x, own_x = position[:, 0], campaign.position[:, 0]
        np.testing.assert_allclose(in_order(x, position), in_order(own_x, campaign.position), atol=2e-6)
        if data.q is None:
            np.testing.assert_allclose(data.commanded_position.T, campaign.commanded, atol=2e-6)
            commanded_turn = np.moveaxis(campaign.commanded_turn.as_matrix(), 0, 2)
            np.testing.assert_allclose(data.commanded_rotation, commanded_turn, atol=2e-6)
        else:
            np.testing.assert_allclose(in_order(x, data.q.T), in_order(own_x, campaign.q), atol=2e-6)
        if form in WITH_ORIENTATION:
            np.testing.assert_allclose(data.rotation, np.moveaxis(campaign.turn.as_matrix(), 0, 2), atol=2e-6)


@pytest.mark.parametrize(
    "rows",
    [
        lambda c: np.hstack((c.q, c.commanded, c.position)),  # two columns of positions follow the arm
        lambda c: np.hstack((c.q, c.position))[:7],  # too few rows
        lambda c: np.hstack((c.q, c.position[::-1])),  # no position does
        lambda c: np.hstack(
            (c.q, c.position * np.resize([[1, 1, np.nan], [np.nan, 1, 1]], (N, 3)))
        ),  # gaps in all rows
    ],
    ids=["two", "few", "none", "gaps"],
)
def test_numbers_without_one_reading_stay_a_question(
    rows: Callable[[Campaign], np.ndarray], campaign: Campaign, tmp_path: Path
) -> None:
    path = written({"bare.csv": lines(rows(campaign))}, tmp_path)[0]
    with pytest.raises(InputError, match="found numbers, expected a header row"):
        robacc.read_poses(path, robot=ROBOT)


def test_three_targets_without_names_are_found_by_their_motion(campaign: Campaign, tmp_path: Path) -> None:
    """As savetxt of NumPy writes them, with columns of zeros between."""
    at = [campaign.position + campaign.turn.apply(place) for place in np.diag([0.1, 0.15, -0.1])]
    path = str(tmp_path / "three.csv")
    np.savetxt(path, np.hstack((*(MM * each for each in at), np.zeros((N, 6)), np.degrees(campaign.q))))
    words = ("estimate", path, "--robot", ROBOT)
    assert "each row holds the points 1, 2, 3" in refused(*words, status=3)
    found = figures([*words[1:], "--align", "base_frame,tool_frame"])
    assert found["n_poses"] == 3 * N
    assert found["position"]["rms_m"] < 2e-4  # of noise of 0.05 mm along each axis, and of the orientation at 0.15 m


def test_a_count_that_skips_a_number_has_the_names_of_points(campaign: Campaign, tmp_path: Path) -> None:
    ids = np.delete(np.arange(1, N + 3), (1, 4))
    kept = np.delete(np.arange(N), 9)
    points, joints = (np.column_stack((ids, values)) for values in (campaign.position * MM, np.degrees(campaign.q)))
    for name, values in (("lt.txt", points), ("joints.txt", joints[kept])):
        saved(tmp_path / name, lines(([int(row[0]), *row[1:].tolist()] for row in values), ", "))
    arguments = [str(tmp_path / "lt.txt"), "--commanded", str(tmp_path / "joints.txt"), "--robot", ROBOT]
    result = figures(arguments)
    assert (result["n_poses"], result["position"]["rms_m"] < 1e-4) == (N - 1, True)
    assert f"are left out: {ids[9]}" in one_line(run("estimate", *arguments).stderr)


@pytest.mark.parametrize("lever", [0.15, 0.0])
def test_of_readings_that_agree_the_best_is_taken(lever: float, campaign: Campaign, tmp_path: Path) -> None:
    """Small turns are alike in all conventions; without an offset of the target all are the same."""
    turn = Rotation.from_rotvec(0.03 * campaign.q[:, :3])
    measured = campaign.commanded + turn.apply([lever, -lever, lever])
    saved(tmp_path / "lt.txt", lines(named(MM * measured, "{}"), ", "))
    saved(tmp_path / "pose.txt", lines(named(np.hstack((campaign.commanded, turn.as_rotvec())), "{}")))
    words = ("estimate", str(tmp_path / "lt.txt"), "--commanded", str(tmp_path / "pose.txt"))
    if not lever:
        assert "these columns state no unit" in refused(*words, status=3)
        return
    assert document(*words)["position"]["rms_m"] < 1e-6
    assert "poses in m,rad, rotvec: no other reading agrees as well" in one_line(run(*words).stderr)


def test_gaps_of_records_have_a_tip(campaign: Campaign, tmp_path: Path) -> None:
    rows = [{"joints": q, "position": p} for q, p in zip(campaign.q.tolist(), campaign.position.tolist(), strict=True)]
    rows[3] = {"joints": rows[3]["joints"]}
    path = str(saved(tmp_path / "log.json", json.dumps(rows)))
    text = refused("estimate", path, "--robot", ROBOT, status=3)
    assert "row 4, position_x: the value is missing" in text
    assert text.count("give --skip-gaps to leave out rows with a missing value") == 1
    assert figures([path, "--robot", ROBOT, "--skip-gaps"])["n_poses"] == N - 1


def test_stated_units_of_commands_are_not_those_of_points_that_they_cannot_be(
    campaign: Campaign, tmp_path: Path
) -> None:
    poses = np.hstack((campaign.commanded, campaign.commanded_turn.as_rotvec()))
    measured, commanded = saved(tmp_path / "lt.txt", lines(named(campaign.position * MM, "{}"), ", ")), tmp_path / "c"
    saved(commanded, lines(named(poses, "{}")))
    units = ["--units", "m,rad", "--angles", "rotvec"]
    assert figures([str(measured), "--commanded", str(commanded), *units])["position"]["rms_m"] < 1e-4


def test_arrays_of_numpy_in_cells_are_the_poses_of_hand_and_instrument(campaign: Campaign, tmp_path: Path) -> None:
    """Matrices over several lines; no word says that the other transform is the commanded one."""
    hands, seen = np.zeros((2, N, 4, 4))
    hands[:], seen[:] = np.eye(4), np.eye(4)
    hands[:, :3, :3], hands[:, :3, 3] = campaign.commanded_turn.as_matrix(), campaign.commanded
    seen[:, :3, :3], seen[:, :3, 3] = campaign.turn.as_matrix(), campaign.position
    with np.printoptions(precision=9, suppress=True):
        rows = "".join(f'{i},"{hand}","{other}"\n' for i, (hand, other) in enumerate(zip(hands, seen, strict=True)))
    path = saved(tmp_path / "matched.csv", f"frame_number,SI Transform,NDI Transform\n{rows}")
    assert figures([str(path), "--units", "m"])["position"]["rms_m"] < 1e-4


BARE = (
    "columns 1 to 9 read as q1_deg, q2_deg, q3_deg, q4_deg, q5_deg, q6_deg, X [mm], Y [mm], Z [mm], "
    "only this reading agrees with the motion"
)


@pytest.mark.parametrize(
    ("form", "told"),
    [
        ("bare_degrees_and_mm", BARE),
        ("qualisys_moving_axes", "Roll, Pitch, Yaw taken as moving-xyz"),
    ],
)
def test_one_note_says_how_numbers_were_read(form: str, told: str, campaign: Campaign, tmp_path: Path) -> None:
    measured, *commanded = written(made(form, campaign), tmp_path)
    data = robacc.read_poses(measured, robot=ROBOT, commanded=commanded[1] if commanded else None)
    assert len([text for text in data.warnings if told in text]) == 1


def test_notes_say_how_a_file_was_read_and_quiet_leaves_them_out(campaign: Campaign, tmp_path: Path) -> None:
    arguments = ["estimate", *written(laboratory(campaign), tmp_path), "--robot", ROBOT]
    spoken = run(*arguments).stderr.splitlines()
    words = [line.partition(":")[0] for line in spoken]
    assert words == sorted(words, reverse=True)  # warnings first
    notes = [line for line in spoken if line.startswith("note: ")]
    assert sum("not read in or below the table: " in line for line in notes) == 1
    assert any("A1, A2, A3, A4, A5, A6 taken as deg: no other unit" in line for line in notes)
    assert any("X, Y, Z taken as mm: no other unit" in line for line in notes)
    assert any("U95 [um] -> sigma_x_um times 2" in line for line in notes)
    assert run(*arguments, "--quiet").stderr.splitlines() == [line for line in spoken if not line.startswith("note: ")]


def test_rows_without_a_measurement_are_left_out_by_their_status(campaign: Campaign, tmp_path: Path) -> None:
    path = written(trials(campaign), tmp_path)[0]
    data = robacc.read_poses(path, robot=ROBOT)
    assert data.n == N
    (left_out,) = [text for text in data.warnings if "left out" in text]
    assert "2 rows incomplete or not measured, left out (line 6, 11)" in left_out
    assert not isinstance(left_out, Note)
    text = Path(path).read_text(encoding="utf-8").replace("FAILED", "OK")
    Path(path).write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"11, x: found 'nan', expected a finite number"):
        robacc.read_poses(path, robot=ROBOT)


def test_a_row_without_a_measurement_at_the_end_is_no_footer(campaign: Campaign, tmp_path: Path) -> None:
    path = saved(tmp_path / "points.csv", lines(named(campaign.position * MM), ",", "Name,X,Y,Z\n", "P99,,,\n"))
    with pytest.raises(InputError, match=f"{N + 2}, X: the value is missing"):
        robacc.read_poses(path)


def test_init_proposes_a_matrix(campaign: Campaign, tmp_path: Path) -> None:
    path = written(bare_matrices(campaign), tmp_path)[0]
    assert "reads 13 of 13 columns" in output("init", path, "--folder", tmp_path)
    text = (tmp_path / "columns.yaml").read_text(encoding="utf-8")
    assert "m_00 … m_23 as a matrix: X, Y, Z and the orientation" in text
    (tmp_path / "columns.yaml").write_text(text.replace("unknown", "m,rad"), encoding="utf-8")
    stated = ["--columns", str(tmp_path / "columns.yaml")]
    assert figures([path, "--robot", ROBOT, *stated])["position"] == figures([path, "--robot", ROBOT])["position"]


def test_points_and_joints_as_two_positional_files_get_one_hint(campaign: Campaign, tmp_path: Path) -> None:
    arguments = written(made("counted_quaternion", campaign), tmp_path)
    told = run("estimate", arguments[0], arguments[2], "--robot", ROBOT)
    assert (told.exit_code, told.stderr.count(f"robacc estimate {arguments[0]} --commanded {arguments[2]}")) == (3, 1)


def test_two_readings_stay_a_question(campaign: Campaign, tmp_path: Path) -> None:
    """Joints of a small motion may be in degrees or radians, and points without an arm in millimetres or inches."""
    (tmp_path / "joints.csv").write_text(lines(campaign.q, ",", "J1,J2,J3,J4,J5,J6\n"), encoding="utf-8")
    (tmp_path / "points.csv").write_text(lines(campaign.position * MM / 20, ",", "X,Y,Z\n"), encoding="utf-8")
    for arguments in (
        ["points.csv", "--commanded", "joints.csv", "--robot", ROBOT],
        ["points.csv", "--commanded", "points.csv"],
    ):
        paths = [str(tmp_path / text) if text.endswith(".csv") else text for text in arguments]
        assert "these columns state no unit" in refused("estimate", *paths, status=3)


def test_a_part_in_another_unit_is_refused(campaign: Campaign, tmp_path: Path) -> None:
    q = np.vstack((np.degrees(campaign.q[:8]), campaign.q[8:]))
    head = ",".join(f"q{i}" for i in range(1, 7)) + ",x,y,z\n"
    path = saved(tmp_path / "poses.csv", lines(np.hstack((q, campaign.position)), ",", head))
    with pytest.raises(InputError, match="from line 2 to 9 only"):
        robacc.read_poses(path, robot=ROBOT)


@pytest.mark.parametrize(
    "text", ['{"joints": [1, 2', '[{"joints": 1}, 2]', "a: &a [1]\nb: [*a, *a]\n", '{"poses": []}'], ids=str
)
def test_documents_without_records_get_one_message(text: str, tmp_path: Path) -> None:
    path = saved(tmp_path / "poses.yaml", text)
    with pytest.raises(InputError) as caught:
        robacc.read_poses(path)
    assert len(caught.value.problems) == 1


def test_arrays_that_numpy_saved_by_name_are_read(campaign: Campaign, tmp_path: Path) -> None:
    arrays = {"joints": campaign.q, "position": campaign.position, "orientation": campaign.turn.as_quat()}
    np.savez(tmp_path / "named.npz", seed=np.array(3), **arrays)
    fields = np.rec.fromarrays([*campaign.q.T, *campaign.position.T], names="q1,q2,q3,q4,q5,q6,x,y,z")
    np.save(tmp_path / "fields.npy", fields)
    for name in ("named.npz", "fields.npy"):
        data = robacc.read_poses(tmp_path / name, robot=ROBOT)
        np.testing.assert_allclose(data.q.T, campaign.q)
        np.testing.assert_allclose(data.position.T, campaign.position)
    turn = robacc.read_poses(tmp_path / "named.npz", robot=ROBOT).rotation
    np.testing.assert_allclose(np.moveaxis(turn, -1, 0), campaign.turn.as_matrix(), atol=1e-12)


def test_an_array_without_names_gives_its_rows_or_matrices(
    campaign: Campaign, plain: dict[bool, dict[str, Any]], tmp_path: Path
) -> None:
    np.save(tmp_path / "seen.npy", homogeneous(campaign.position, campaign.turn))
    np.save(tmp_path / "joints.npy", campaign.q)
    seen, joints = str(tmp_path / "seen.npy"), str(tmp_path / "joints.npy")
    found = figures([seen, "--commanded", joints, "--units", "m,rad", "--robot", ROBOT])
    for part, key in (("position", "rms_m"), ("orientation", "rms_rad")):
        assert found[part][key] == pytest.approx(plain[True][part][key], rel=2e-3)


def test_arrays_that_make_no_table_are_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "unnamed.npy", np.zeros(9))
    np.savez(tmp_path / "unequal.npz", joints=np.zeros((9, 6)), position=np.zeros((8, 3)))
    np.save(tmp_path / "objects.npy", np.array([{}, {}]), allow_pickle=True)
    saved(tmp_path / "broken.npz", "PK\x03\x04")
    for name, said in (
        ("unnamed.npy", r"save arrays by name with a row for each pose, as numpy.savez\(file, joints=…"),
        ("unequal.npz", "has no list of records"),
        ("objects.npy", r"cannot be read as arrays \(Object arrays cannot be loaded"),
        ("broken.npz", "cannot be read as arrays"),
    ):
        with pytest.raises(InputError, match=said) as caught:
            robacc.read_poses(tmp_path / name, robot=ROBOT)
        assert len(caught.value.problems) == 1


def test_a_second_position_of_unknown_kind_is_a_question(campaign: Campaign, tmp_path: Path) -> None:
    for name in ("Foo {}", "ref_{}"):
        path = written({"both.csv": beside("{}", name)["both.csv"].of(campaign)}, tmp_path)[0]
        with pytest.raises(InputError, match=r"found several positions: 'X, Y, Z' or .* say with `columns`"):
            robacc.read_poses(path, robot=ROBOT)
    pose = Text(f"{J},ee_x,ee_y,ee_z,ee_qx,ee_qy,ee_qz,ee_qw,foo_x,foo_y,foo_z", "deg cmd_m cmd_xyzw m", sep=",")
    path = written({"pose.csv": pose.of(campaign)}, tmp_path)[0]
    with pytest.raises(InputError, match=r"found several positions: 'ee_x, ee_y, ee_z' or 'foo_x, foo_y, foo_z'"):
        robacc.read_poses(path, robot=ROBOT)


@pytest.mark.parametrize("name", ["d{}", "{} dev", "Vel {}", "v{}", "Abw. {}", "RMS {}"])
def test_what_is_no_position_is_no_rival(name: str, campaign: Campaign, tmp_path: Path) -> None:
    path = written({"both.csv": beside(name, "{}")["both.csv"].of(campaign)}, tmp_path)[0]
    data = robacc.read_poses(path, robot=ROBOT)
    np.testing.assert_allclose(data.position.T, campaign.position, atol=1e-9)


def test_a_controllers_position_is_the_command_without_joints(campaign: Campaign, tmp_path: Path) -> None:
    text = table("Nr;x;y;z;Leica X;Leica Y;Leica Z", campaign.commanded * MM, campaign.position * MM, name="{}")
    data = robacc.read_poses(written({"both.csv": text}, tmp_path)[0])
    np.testing.assert_allclose(data.position.T, campaign.position, atol=1e-9)
    np.testing.assert_allclose(data.commanded_position.T, campaign.commanded, atol=1e-9)


def test_times_without_overlap_are_refused(campaign: Campaign, tmp_path: Path) -> None:
    files = stamped(campaign)
    head, *rows = files["joints.csv"].splitlines()
    late = [f"{float(row.partition(',')[0]) + 3000:.3f},{row.partition(',')[2]}" for row in rows]
    arguments = written(files | {"joints.csv": "\n".join([head, *late]) + "\n"}, tmp_path)
    with pytest.raises(InputError, match=r"the times of the rows \(.* s\) are not those of the commands in"):
        robacc.read_poses(arguments[0], robot=ROBOT, commanded=arguments[2])


def test_joints_of_a_moving_arm_are_interpolated(campaign: Campaign, tmp_path: Path) -> None:
    at = np.arange(40) * 0.1
    of = lambda time: 0.5 * np.sin(time[:, None] + np.arange(6))  # noqa: E731
    head = "time," + ",".join(f"q{i}_rad" for i in range(1, 7))
    joints = {"joints.csv": table(head, 100 + at[:, None], of(at), sep=",")}
    points = {"points.csv": table("t;X [m];Y [m];Z [m]", 100.03 + at[:24, None], campaign.position)}
    arguments = written(points | joints, tmp_path)
    data = robacc.read_poses(arguments[0], robot=ROBOT, commanded=arguments[2])
    np.testing.assert_allclose(data.q.T, of(at[:24] + 0.03), atol=1e-5)


def test_an_external_axis_that_moves_is_named(campaign: Campaign, tmp_path: Path) -> None:
    rail = 0.4 * (np.arange(N) % 3)[:, None]
    points = campaign.position + rail * [0, 1, 0]
    path = written({"rail.csv": table(f"{JOINTS};E1;X;Y;Z", np.degrees(campaign.q), rail * MM, points * MM)}, tmp_path)
    told = one_line(run("estimate", *path, "--robot", ROBOT).stderr)
    assert "the errors are too large for an arm, and E1 moves and is not used" in told


def test_a_job_of_poses_has_commanded_poses(campaign: Campaign, tmp_path: Path) -> None:
    poses = np.hstack((campaign.commanded * MM, campaign.commanded_turn.as_euler("xyz", degrees=True)))
    files = yaskawa_job(campaign)
    places = lines(named(poses, "C{:05d}=")).replace("=,", "=")
    job = files["calib.JBI"].partition("///POSTYPE")[0] + f"///POSTYPE BASE\n///RECTAN\n{places}"
    job += files["calib.JBI"][files["calib.JBI"].index("//INST") :]
    arguments = written(files | {"calib.JBI": job}, tmp_path)
    data = robacc.read_poses(arguments[0], robot=ROBOT, commanded=arguments[2])
    np.testing.assert_allclose(data.commanded_position.T, campaign.commanded, atol=1e-9)
    np.testing.assert_allclose(
        np.moveaxis(data.commanded_rotation, 2, 0), campaign.commanded_turn.as_matrix(), atol=1e-7
    )


def test_positions_of_a_job_in_several_frames_are_refused(tmp_path: Path) -> None:
    places = "C00000=1,2,3,0,0,0\nC00001=4,5,6,0,0,0\n"
    user = f"///USER 2\n///POSTYPE USER\n///RECTAN\n{places}"
    base = "///TOOL 1\n///POSTYPE BASE\n///RECTAN\nP00001=9,9,9,0,0,0\n///POSTYPE PULSE\n///PULSE\nC00009=1,2,3,4,5,6\n"
    reader = plug_in("robacc.readers", "jobs")

    def read(moves: str) -> Any:
        job = f"/JOB\n//POS\n{user}{base}//INST\nNOP\n{moves}END\n"
        return reader.read_stream(io.BytesIO(job.encode()), "run.jbi", TableOptions(lambda text: False))

    assert read("MOVL C00000\nMOVL C00001\n").n == 2
    with pytest.raises(InputError, match=r"positions of several kinds: BASE with TOOL 1, USER 2 with TOOL 0"):
        read("MOVL C00000\nMOVL P00001\n")
    with pytest.raises(InputError, match="positions of several kinds: PULSE, RECTAN"):
        read("MOVL C00000\nMOVJ C00009\n")


WORK_OBJECTS = (
    (np.array([400.0, -100.0, 50.0]), Rotation.from_euler("z", 40, degrees=True)),
    (np.array([0.0, 200.0, 30.0]), Rotation.from_euler("z", -25, degrees=True)),
)


def rapid_of_work_objects(c: Campaign, *, defined: bool) -> str:
    """Moves of the commanded poses, in two work objects in turn, with one tool that the module does not define."""
    lines, moves = [], []
    for k, (origin, turn) in enumerate(WORK_OBJECTS if defined else ()):
        frame = f"[{numbers(origin)}],[{numbers(turn.as_quat()[[3, 0, 1, 2]])}]"
        lines.append(f'PERS wobjdata w{k}:=[FALSE,TRUE,"",[{frame}],[[0,0,0],[1,0,0,0]]];')
    for i, (place, turn) in enumerate(zip(c.commanded * MM, c.commanded_turn, strict=True)):
        origin, frame = WORK_OBJECTS[i % 2]
        pose = (
            f"[{numbers(frame.inv().apply(place - origin))}],[{numbers((frame.inv() * turn).as_quat()[[3, 0, 1, 2]])}]"
        )
        lines.append(f"CONST robtarget p{i}:=[{pose},[0,0,0,0],[9E9,9E9,9E9,9E9,9E9,9E9]];")
        moves.append(f"MoveL p{i},v100,fine,tSmr\\WObj:=w{i % 2};")
    return "\n".join(["MODULE m", *lines, "PROC main()", *moves, "ENDPROC", "ENDMODULE", ""])


def test_commands_in_several_work_objects_are_poses_in_the_base(campaign: Campaign, tmp_path: Path) -> None:
    """Registration fits one base: poses of two work objects read as of one have errors of decimetres."""
    points = saved(tmp_path / "points.csv", mm(campaign)["points.csv"])
    module = saved(tmp_path / "cell.mod", rapid_of_work_objects(campaign, defined=True))
    data = robacc.read_poses(points, commanded=module)
    np.testing.assert_allclose(data.commanded_position.T, campaign.commanded, atol=1e-6)
    turns = np.moveaxis(data.commanded_rotation, 2, 0)
    np.testing.assert_allclose(turns, campaign.commanded_turn.as_matrix(), atol=1e-6)
    module = saved(tmp_path / "other.mod", rapid_of_work_objects(campaign, defined=False))
    said = refused("estimate", points, "--commanded", module, status=3)
    assert "has several tools or base frames, and the base w0 is in none of the files read" in said


@pytest.mark.parametrize(
    ("captions", "end", "line"),
    [
        (("tracker_point {}", "flange_point {}"), "\n", 3),
        (("type: 1 index: {}", "type: 0 index: {}"), "\n", 3),
        # In one line, captions that reached back to its beginning would take time as the square of its length.
        (("eye {}", "arm {}"), " ", 2),
    ],
)
def test_a_log_of_two_kinds_of_poses_is_refused(
    campaign: Campaign, tmp_path: Path, captions: tuple[str, str], end: str, line: int
) -> None:
    """The captions before tell the poses of the instrument from those of the arm, which have the same names."""
    text = "Thread started.\n"
    for i, (measured, commanded) in enumerate(zip(campaign.position * MM, campaign.commanded * MM, strict=True)):
        for caption, place in zip(captions, (measured, commanded), strict=True):
            pose = f"point x:{place[0]:.3f} y:{place[1]:.3f} z:{place[2]:.3f} A:0.1 B:0.2 C:0.3"
            text += f"{caption.format(i)}{end}{pose}{end}"
    path = saved(tmp_path / "print.txt", text)
    with pytest.raises(InputError, match=rf"has poses of 2 kinds in turn, by their captions: '.*' \(line {line}\)"):
        robacc.read_poses(path, robot=ROBOT)


def test_rows_of_several_tools_name_this_cause(campaign: Campaign, tmp_path: Path) -> None:
    places = np.repeat(campaign.position * MM, 2, axis=0)
    rows = "".join(f"{i // 2},{i % 2 + 1},{numbers(place)}\n" for i, place in enumerate(places))
    points = saved(tmp_path / "ndi.csv", f"Frame,Tool ID,Tx,Ty,Tz\n{rows}")
    joints = saved(tmp_path / "q.csv", table(JOINTS, np.degrees(campaign.q)))
    said = one_line(refused("estimate", points, "--commanded", joints, "--robot", ROBOT, status=3))
    assert "found 48 measured rows and 24 commands" in said
    assert "give each of several tools (Tool ID) its own file" in said


@pytest.mark.parametrize("names", ["dX;dY;dZ", "Fx;Fy;Fz;Mx;My;Mz"])
def test_deviations_and_moments_are_no_positions(names: str, campaign: Campaign, tmp_path: Path) -> None:
    positions = np.tile(campaign.position, len(names.split(";")) // 3)
    text = table(f"{JOINTS};{names}", np.degrees(campaign.q), positions)
    with pytest.raises(InputError, match="columns x, y, z are missing"):
        robacc.read_poses(saved(tmp_path / "log.csv", text), robot=ROBOT)


@pytest.mark.parametrize(
    ("form", "old", "new", "said"),
    [
        ("abb_with_tracker", " tracker [", " lost (", r"abb\.log:1, tracker X \[mm\]: the value is missing"),
        ("pc_dmis_with_graphs", "UNITS=MM", "UNITS=IN", "but the first cell is in in"),
        ("names_with_axes", "Punkt1_Y", "Punkt1_D", r"report\.txt:4: point 'Punkt1' has no row for Y"),
        ("lines_of_hand_and_eye", "eye,", "eye;", r"pairs\.csv:2: the line is not one of a pair"),
        ("lines_of_hand_and_eye", "\neye,", "\nhand,", r"pairs\.csv:2: the line is not one of a pair"),
    ],
)
def test_a_log_or_report_that_lacks_a_value_names_its_line(
    form: str, old: str, new: str, said: str, campaign: Campaign, tmp_path: Path
) -> None:
    name, text = next(iter(made(form, campaign).items()))
    path = saved(tmp_path / name, text.replace(old, new, 1))
    with pytest.raises(InputError, match=said):
        robacc.read_poses(path, robot=ROBOT)


def test_joints_that_a_line_lacks_are_not_those_of_another(campaign: Campaign, tmp_path: Path) -> None:
    rows = abb_with_tracker(campaign)["abb.log"].splitlines(keepends=True)
    rows[5] = "Pose 6 tracker" + rows[5].partition("tracker")[2]
    path = saved(tmp_path / "abb.log", "".join(rows))
    with pytest.raises(InputError, match=r"abb\.log:6, J1 \[deg\]: the value is missing"):
        robacc.read_poses(path, robot=ROBOT)
    data = robacc.read_poses(path, robot=ROBOT, skip_gaps=True)
    np.testing.assert_allclose(data.q.T, np.delete(campaign.q, 5, axis=0), atol=1e-8)


def test_a_joint_that_the_arm_lacks_is_named_where_units_are_open(campaign: Campaign, tmp_path: Path) -> None:
    text = table("J1;J2;J3;J4;J5;J7;X;Y;Z", np.degrees(campaign.q), campaign.position * MM)
    with pytest.raises(InputError, match="J7: the column belongs to joint 7, but the robot has 6 joints"):
        robacc.read_poses(saved(tmp_path / "log.csv", text), robot=ROBOT)


DMIS = "UNITS/MM\nFA(P1)=FEAT/POINT,CART,1,2,{},0,0,1\nFA(P2)=FEAT/POINT,CART,1,2,3,0,0,1\n"


@pytest.mark.parametrize(
    ("name", "text", "said"),
    [
        ("run.dmo", DMIS.format("x"), r"run\.dmo: found x of P1, expected a number"),
        ("run.dmo", DMIS.replace("FA(", "F(").format("3"), r"run\.dmo: has no features that were measured"),
        ("pairs.txt", "hand,1,2,3,4,5,6\neye,1,2,3,4,5,1e\n", r"pairs\.txt:2: the line is not one of a pair"),
        ("run.jbi", "/JOB\n///ANGLE\nC0=1,2\nMOVJ C0\n", r"run\.jbi:3: expected six numbers for position C0"),
        ("run.jbi", "/JOB\n///ANGLE\nC0=1,2,3,4,5,a\nMOVJ C0\n", r"run\.jbi:3: expected six numbers for position C0"),
        ("run.log", "p[1,2,3,4,5,6]\n".ljust(TEXT_LIMIT + 1), r"run\.log: is larger than 64 MiB"),
    ],
    ids=["DMIS", "DMIS nominal", "pair", "short job", "job", "log"],
)
def test_a_text_of_a_plug_in_that_is_damaged_or_too_large_is_refused(
    name: str, text: str, said: str, tmp_path: Path
) -> None:
    reader = plug_in("robacc.readers", {"dmo": "reports", "txt": "hand-eye", "jbi": "jobs", "log": "logs"}[name[-3:]])
    with pytest.raises(InputError, match=said):
        reader.read_stream(io.BytesIO(text.encode()), name, TableOptions(lambda text: False))


def test_pulses_of_a_job_and_other_variables_are_refused(campaign: Campaign, tmp_path: Path) -> None:
    points = written(mm(campaign), tmp_path)[0]
    job = saved(tmp_path / "calib.JBI", "/JOB\n//POS\n///PULSE\nC00000=12034,-3323,9921,0,-22001,11\n//INST\nEND\n")
    said = refused("estimate", points, "--commanded", job, "--robot", ROBOT, status=3)
    assert "calib.JBI: is a job of Yaskawa, whose positions count pulses of the motors" in said
    large = tmp_path / "run.mat"
    large.write_bytes(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM" + bytes(512))
    with pytest.raises(InputError, match=r"it is of version 7\.3; save it with -v7"):
        robacc.read_poses(large, robot=ROBOT)
    savemat(tmp_path / "cut.mat", {"q": campaign.q})
    cut = tmp_path / "cut.mat"
    cut.write_bytes(cut.read_bytes()[:130])
    with pytest.raises(InputError, match="cannot be read as arrays"):
        robacc.read_poses(cut, robot=ROBOT)


@pytest.mark.parametrize("form", ["arrays", "columns", "structure", "structures"])
def test_variables_of_matlab_are_read(form: str, campaign: Campaign, tmp_path: Path) -> None:
    q, position = campaign.q, campaign.position
    structures = np.zeros(N, dtype=[("name", "O"), ("q", "O"), ("position", "O")])
    for i in range(N):
        structures[i] = (f"P{i}", q[i], position[i])
    variables = {
        "arrays": {"q": q, "p": position},
        "columns": {"joints": q.T, "position": position.T, "rate": 100.0},
        "structure": {"data": {"q": q, "pos": position, "name": "run 7"}},
        "structures": {"poses": structures},
    }
    savemat(tmp_path / "run.mat", variables[form])
    data = robacc.read_poses(tmp_path / "run.mat", robot=ROBOT)
    np.testing.assert_allclose(data.q.T, q, rtol=1e-12)
    np.testing.assert_allclose(data.position.T, position, rtol=1e-12)


def test_the_sign_of_differences_is_a_warning_and_of_deviations_a_note(campaign: Campaign, tmp_path: Path) -> None:
    opposite = "taken as measured less commanded; if they are the opposite, change their sign"
    for form, is_open in (("targets_and_differences", True), ("nominal_values_and_deviations", False)):
        data = robacc.read_poses(written(made(form, campaign), tmp_path)[0], robot=ROBOT)
        said = [text for text in data.warnings if not isinstance(text, Note)]
        assert any(opposite in text for text in said) == is_open
        np.testing.assert_allclose(data.position.T, campaign.position, atol=1e-9)
        np.testing.assert_allclose(data.commanded_position.T, campaign.commanded, atol=1e-9)


def test_matrices_without_a_partner_are_refused(campaign: Campaign, tmp_path: Path) -> None:
    log = matrices_in_a_log(campaign)["scan.log"]
    path = saved(tmp_path / "scan.log", log[: log.rindex(">>> Camera")])
    with pytest.raises(InputError, match=f"has {N} matrices of robot and {N - 1} matrices of camera"):
        robacc.read_poses(path)


def test_an_uncertainty_that_an_instrument_rounds_to_0_is_its_least(campaign: Campaign, tmp_path: Path) -> None:
    uncertainty = np.tile((2e-3, 4e-3, 8e-3), (N, 1))
    uncertainty[::3, 1] = 0.0
    head = f"{JOINTS};X [mm];Y [mm];Z [mm];U(95) X [mm];U(95) Y [mm];U(95) Z [mm]"
    text = table(head, np.degrees(campaign.q), campaign.position * MM, uncertainty)
    data = robacc.read_poses(saved(tmp_path / "leica.csv", text), robot=ROBOT)
    np.testing.assert_allclose(data.sigma_position.T, np.tile((1e-6, 2e-6, 4e-6), (N, 1)))
    assert any("U(95) Y [mm] counts as its smallest value above 0 where it is 0" in text for text in data.warnings)
    zero = saved(tmp_path / "zero.csv", table(head, np.degrees(campaign.q), campaign.position * MM, 0 * uncertainty))
    with pytest.raises(InputError, match="expected a standard deviation above 0"):
        robacc.read_poses(zero, robot=ROBOT)


ENTRIES = {"nm": "pose", "label": "pose", **{f"ax{i}": f"q{i}_deg" for i in range(1, 7)}}
MAP = "robacc_columns: 1\ncolumns:\n" + "".join(f"  {name}: {key}\n" for name, key in ENTRIES.items())


def test_a_column_map_names_the_columns_of_the_commands_too(campaign: Campaign, tmp_path: Path) -> None:
    points = table("nm;ex;ey;ez", campaign.position * MM, name="P{}")
    joints = table("label;" + ";".join(f"ax{i}" for i in range(1, 7)), np.degrees(campaign.q), name="P{}")
    arguments = written({"points.csv": points, "joints.csv": joints}, tmp_path)
    columns = saved(tmp_path / "map.yaml", MAP + "  ex: x_mm\n  ey: y_mm\n  ez: z_mm\n")
    data = robacc.read_poses(arguments[0], robot=ROBOT, commanded=arguments[2], columns=columns)
    np.testing.assert_allclose(data.q.T, campaign.q, atol=1e-9)
    np.testing.assert_allclose(data.position.T, campaign.position, atol=1e-9)
    alone = saved(tmp_path / "alone.yaml", MAP)
    with pytest.raises(InputError, match="columns x, y, z are missing"):
        robacc.read_poses(arguments[0], robot=ROBOT, commanded=arguments[2], columns=alone)
    wrong = saved(tmp_path / "wrong.yaml", MAP + "  foo: x_mm\n")
    with pytest.raises(InputError, match="the map names a column 'foo', which the file does not have"):
        robacc.read_poses(arguments[0], robot=ROBOT, commanded=arguments[2], columns=wrong)


def test_commands_that_no_unit_makes_readable_are_refused_soon(
    campaign: Campaign, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    numbers = table("alpha;foo;bar", campaign.q[:, :3])
    points, _, commands = written({"points.csv": POINTS["points.csv"].of(campaign), "commands.csv": numbers}, tmp_path)
    read, calls = robacc.poses.csv_file.read_poses, []
    monkeypatch.setattr(robacc.poses.csv_file, "read_poses", lambda *a, **k: calls.append(a) or read(*a, **k))
    with pytest.raises(InputError, match=r"commands\.csv:1: the file has neither joint variables nor commanded poses"):
        robacc.read_poses(points, commanded=commands)
    assert len(calls) < 24  # of each convention of angles in one unit, not of all units
