"""Exports in the forms that users have: each is read with one command, and all give the figures of the plain file."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

import robacc
from robacc.cli.main import app
from robacc.errors import InputError, Note

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


def polyworks(c: Campaign) -> dict[str, str]:
    head = "PolyWorks|Inspector\nUnits: Millimeters\n\nObject Name\tControl\tX\tY\tZ\tTest\n"
    rows = [[f"point {i}", "Measured", *row.tolist(), "Pass"] for i, row in enumerate(c.position * MM, 1)]
    joints = lines(named(np.degrees(c.q), "point {}"), ";", "Name;A1;A2;A3;A4;A5;A6\n").replace(".", ",")
    tail = "\nReport generated 2026-11-22 14:05 by J. Meier\n"
    return {"points.txt": lines(rows, "\t", head, tail), "joints.csv": joints}


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


def rtde_and_leica(c: Campaign) -> dict[str, str]:
    names = ["timestamp", *(f"target_q_{i}" for i in range(6)), *(f"actual_q_{i}" for i in range(6)), "actual_qd_0"]
    rows = [[float(i), *q.tolist(), *(q + 1e-5).tolist(), 0.0] for i, q in enumerate(c.q)]
    head = "Leica Tracker Pilot\nPoint ID      X      Y      Z      U95 [um]\n"
    points = [[*row, 25] for row in named(c.position * MM)]
    return {"points.txt": lines(points, " ", head), "rtde.csv": lines(rows, " ", " ".join(names) + "\n")}


def vicon(c: Campaign) -> dict[str, str]:
    head = "Objects\n100\n,,Tool:Tool,,,,,,\nFrame,Sub Frame,RX,RY,RZ,RW,TX,TY,TZ\n,,,,,,mm,mm,mm\n"
    values = np.hstack((c.turn.as_quat(), c.position * MM))
    rows = [[i, 0, *row.tolist()] for i, row in enumerate(values, 1)]
    return {"vicon.csv": lines(rows, ",", head), "joints.csv": lines(np.degrees(c.q), ",", "J1,J2,J3,J4,J5,J6\n")}


def counted_quaternion(c: Campaign) -> dict[str, str]:
    values = np.hstack((c.position * MM, np.roll(c.turn.as_quat(), 1, axis=1)))
    files = {"points.csv": lines(named(values), ",", "name,x,y,z,q0,q1,q2,q3\n")}
    return files | {"joints.csv": lines(named(np.degrees(c.q)), ",", "name,J1,J2,J3,J4,J5,J6\n")}


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


def robodk(c: Campaign) -> dict[str, str]:
    rows = [[*row, 0.0] for row in named(np.hstack((np.degrees(c.q), c.position * MM)), "Target {}")]
    return {"robodk.csv": lines(rows, ",", "Name,J1,J2,J3,J4,J5,J6,X,Y,Z,Error\n")}


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
    return {"columns.json": json.dumps({"joints": c.q.tolist(), "position": c.position.tolist()})}


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


def hand_eye_transforms(c: Campaign) -> dict[str, str]:
    def transform(position: np.ndarray, quaternion: np.ndarray) -> dict[str, Any]:
        return {
            "translation": dict(zip("xyz", position.tolist(), strict=True)),
            "rotation": dict(zip("xyzw", quaternion.tolist(), strict=True)),
        }

    rows = zip(c.commanded, c.commanded_turn.as_quat(), c.position, c.turn.as_quat(), strict=True)
    samples = [{"robot": transform(p, o), "tracking": transform(x, u)} for p, o, x, u in rows]
    return {"samples.yaml": yaml.safe_dump({"samples": samples})}


def trajectories(c: Campaign) -> dict[str, str]:
    times = np.arange(N, dtype=float)[:, None]
    return {
        "m.tum": lines(np.hstack((times, c.position, c.turn.as_quat())), " "),
        "c.tum": lines(np.hstack((times, c.commanded, c.commanded_turn.as_quat())), " "),
    }


def mm(c: Campaign) -> dict[str, str]:
    return {"points.csv": lines(c.position * MM, ",", "X,Y,Z\n")}


def degrees(c: Campaign) -> dict[str, str]:
    return {"joints.csv": lines(named(np.degrees(c.q), "p{}"), ",", "Name,J1,J2,J3,J4,J5,J6\n")}


def bare_degrees_and_mm(c: Campaign) -> dict[str, str]:
    return {"poses.txt": lines(np.hstack((np.degrees(c.q), c.position * MM)), " ")}


def bare_points_and_joints(c: Campaign) -> dict[str, str]:
    return {"points.csv": lines(named(c.position * MM, "{}")), "joints.csv": lines(c.q)}


def bare_position_first(c: Campaign) -> dict[str, str]:
    return {"poses.csv": lines(np.hstack((c.position, c.q)))}


def bare_quaternions(c: Campaign) -> dict[str, str]:
    return {"poses.csv": lines(np.hstack((np.degrees(c.q), c.position * MM, c.turn.as_quat())))}


def bare_with_rows_of_nan(c: Campaign) -> dict[str, str]:
    return {"m.csv": lines(with_nan(np.hstack((c.q, c.position))))}


def with_nan(values: np.ndarray) -> list[list[Any]]:
    rows: list[list[Any]] = values.tolist()
    nan = ["NaN"] * len(rows[0])
    return [*rows[:3], nan, *rows[3:10], nan, *rows[10:]]


def matlab(c: Campaign) -> dict[str, str]:
    names = ",".join(f"{stem}_{i}" for stem, n in (("joint", 6), ("pos", 3)) for i in range(1, n + 1))
    return {"out.csv": lines(with_nan(np.hstack((c.q, c.position))), ",", names + "\n")}


def radian_tracker(c: Campaign) -> dict[str, str]:
    head = "API Radian Pro\nSerial: 40211\nUnits: in\n\n#\tName\tX\tY\tZ\tStd X\tStd Y\tStd Z\tTime\n"
    rows = [[i, *row] for i, row in enumerate(named(c.position / 0.0254, "p{}"), 1)]
    stamped = [[*row, 0.0004, 0.0004, 0.0004, f"11/22/2026 2:{row[0]:02d}:17 PM"] for row in rows]
    return {"radian.txt": lines(stamped, "\t", head)} | degrees(c)


def target_report(c: Campaign) -> dict[str, str]:
    head = "Target Report\nJob: Cell 3,Date: 11/22/2026\nUnits: in\n\nCollection,Target,X,Y,Z,Ux,Uy,Uz,Timestamp\n"
    rows = [["A", *row, 0.001, 0.001, 0.0012, "11/22/2026 2:05:17 PM"] for row in named(c.position / 0.0254, "p{}")]
    return {"report.csv": lines(rows, ",", head)} | degrees(c)


def creaform(c: Campaign) -> dict[str, str]:
    names = [f"Model1 {name}" for name in ("Tx (mm)", "Ty (mm)", "Tz (mm)", "Qx", "Qy", "Qz", "Qw")]
    head = "VXelements 10.1;;;;;;;;\n" + ";".join(["Time (s)", *names, "Status"]) + "\n"
    rows = [[*row, "OK"] for row in named(np.hstack((c.position * MM, c.turn.as_quat())), "{}")]
    return {"vxtrack.csv": lines(rows, ";", head)} | degrees(c)


def nikon(c: Campaign) -> dict[str, str]:
    head = "Nikon Metrology K-CMM\nOperator  J. Meier\n\n  ID      X[mm]      Y[mm]      Z[mm]   LEDs\n"
    return {"k.txt": lines([[*row, 3] for row in named(c.position * MM, "  {}")], "   ", head)} | degrees(c)


def optitrack(c: Campaign) -> dict[str, str]:
    head = [
        "Format Version,1.23,Take Name,Take,Capture Frame Rate,120.0,Rotation Type,Quaternion,Length Units,Meters\n",
        *(",Type" + 8 * ",Rigid Body", ",Name" + 8 * ",Tool", ",ID" + 8 * ",1"),
        "," + 4 * ",Rotation" + 3 * ",Position" + ",Mean Marker Error",
        "Frame,Time (Seconds),X,Y,Z,W,X,Y,Z,\n",
    ]
    values = np.hstack((np.arange(N)[:, None] / 120, c.turn.as_quat(), c.position, np.full((N, 1), 2e-4)))
    return {"take.csv": lines(named(values, "{}"), ",", "\n".join(head))} | degrees(c)


def qualisys(c: Campaign) -> dict[str, str]:
    head = "NO_OF_FRAMES\t24\nFREQUENCY\t100\nMARKER_NAMES\tTool\nFrame\tTime\tTool X\tTool Y\tTool Z\n"
    values = np.hstack((np.arange(N)[:, None] / 100, c.position * MM))
    return {"qtm.tsv": lines(named(values, "{}"), "\t", head)} | degrees(c)


def qualisys_bodies(c: Campaign) -> dict[str, str]:
    names = ["Frame", *"XYZ", "Roll", "Pitch", "Yaw", "Residual", *(f"Rot[{i}]" for i in range(9))]
    columns = c.turn.as_matrix().transpose(0, 2, 1).reshape(N, 9)
    angles = c.turn.as_euler("xyz", degrees=True)
    values = np.hstack((c.position * MM, angles, np.full((N, 1), 0.1), columns))
    head = "NO_OF_FRAMES\t24\nDATA_INCLUDED\t6D\nBODY_NAMES\tTool\n" + "\t".join(names) + "\n"
    return {"qtm6d.tsv": lines(named(values, "{}"), "\t", head)} | degrees(c)


def kawasaki(c: Campaign) -> dict[str, str]:
    head = "Robot log RS010N\n   No.   JT1     JT2     JT3     JT4     JT5     JT6\n"
    return mm(c) | {"as.log": lines(named(np.degrees(c.q), "  {}"), "  ", head)}


def yaskawa(c: Campaign) -> dict[str, str]:
    head = "\t".join(["Pos", *(f"{letter} [deg]" for letter in "SLURBT")]) + "\n"
    return mm(c) | {"pos.txt": lines(named(np.degrees(c.q), "C{}"), "\t", head)}


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


def two_header_lines(c: Campaign) -> dict[str, str]:
    head = "Point;Joint angles;;;;;;Measured position;;\n;J1;J2;J3;J4;J5;J6;X;Y;Z\n;[deg];;;;;;[mm];;\n"
    return {"sheet.csv": lines(named(np.hstack((np.degrees(c.q), c.position * MM))), ";", head)}


def german(c: Campaign) -> dict[str, str]:
    names = ["Punkt", *(f"Gelenk {i} [Grad]" for i in range(1, 7)), "X-Ist [mm]", "Y-Ist [mm]", "Z-Ist [mm]", "Datum"]
    rows = [[*row, "22#11#2026 14:05"] for row in named(np.hstack((np.degrees(c.q), c.position * MM)))]
    return {"messung.csv": lines(rows, ";", ";".join(names) + "\n").replace(".", ",").replace("#", ".")}


def comments_below(c: Campaign) -> dict[str, str]:
    values, names = np.hstack((np.degrees(c.q), c.position * MM)), "A1\tA2\tA3\tA4\tA5\tA6\tX\tY\tZ"
    return {"log.tsv": lines(values, "\t", f"% cell 3\n{names}\n", "% end of data\n% 24 points, rms 0.012\n")}


def side_by_side(c: Campaign) -> dict[str, str]:
    head = ",Joints,,,,,,Commanded,,,Measured,,\nPoint,J1,J2,J3,J4,J5,J6,X,Y,Z,X,Y,Z\n"
    return {"both.csv": lines(named(np.hstack((np.degrees(c.q), c.commanded * MM, c.position * MM))), ",", head)}


def commanded_and_read_joints(c: Campaign) -> dict[str, str]:
    head = "Point,Commanded,,,,,,Actual,,,,,,Measured,,\n,J1,J2,J3,J4,J5,J6,J1,J2,J3,J4,J5,J6,X,Y,Z\n"
    values = np.hstack((np.degrees(c.q), np.degrees(c.q) + 1e-3, c.position * MM))
    return {"both.csv": lines(named(values), ",", head)}


def table(head: str, *columns: np.ndarray, sep: str = ";", name: str = "", tail: str = "") -> str:
    values = np.hstack(columns)
    return lines(named(values, name) if name else values, sep, head + "\n", tail)


JOINTS = "A1;A2;A3;A4;A5;A6"


def beside(controller: str, measured: str) -> Form:
    """A controller's position, of its own frame, beside that of an instrument."""

    def form(c: Campaign) -> dict[str, str]:
        names = [text.format(axis) for text in (controller, measured) for axis in "XYZ"]
        return {"both.csv": table(";".join((JOINTS, *names)), np.degrees(c.q), c.commanded * MM, c.position * MM)}

    form.__name__ = f"{controller} beside {measured}"
    return form


BESIDE = [
    *(
        ("{}", text)
        for text in ("Laser {}", "{}_tracker", "T-Mac {}", "AT960_{}", "OptiTrack {}", "{}_LT", "{} Messung")
    ),
    *(("{}", text) for text in ("{}_meas", "{} Messung", "{}_ext", "gt_{}", "SMR {}", "Leica{}")),
    *(("Robot {}", "{}"), ("{} Roboter", "{} Lasertracker"), ("TCP {}", "Laser {}"), ("Actual {}", "Laser {}")),
    *(("{}_est", "{}_gt"), ("RIst.{}", "TRK.{}"), ("Controller\\TCP\\{}", "Tracker {}"), ("Pos_{}", "Trk_{}")),
]


def controller_pose_and_leica(c: Campaign) -> dict[str, str]:
    angles = c.commanded_turn.as_euler("ZYX", degrees=True)
    head = f"Nr;{JOINTS};X;Y;Z;A;B;C;Leica X;Leica Y;Leica Z"
    return {"kuka.csv": table(head, np.degrees(c.q), c.commanded * MM, angles, c.position * MM, name="{}")}


def joints_in_another_order(c: Campaign, name: str, of: str) -> dict[str, str]:
    """Points of which one has no command, and commands in another order, whose names are alike."""
    points = table("Name;X;Y;Z", c.position * MM, name=name, tail="Drift A;2000;100;30\n")
    rows = named(np.degrees(c.q), of)[::-1]
    return {"points.csv": points, "joints.csv": lines(rows, ";", f"Name;{JOINTS}\n")}


def names_by_number(c: Campaign) -> dict[str, str]:
    return joints_in_another_order(c, "Pos {}", "XP{:03d}")


def names_in_groups(c: Campaign) -> dict[str, str]:
    files = joints_in_another_order(c, "Cell::Arm::P{}", "P{}")
    return files | {"points.csv": files["points.csv"].replace("Name", "Collection::Group::Point", 1)}


def names_of_repetitions(c: Campaign) -> dict[str, str]:
    return joints_in_another_order(c, "P{}_1", "P{}")


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


def in_rows(c: Campaign, head: str, sep: str, row: Callable[[int, str, float], str], above: str = "") -> dict[str, str]:
    text = "".join(
        above.format(i) + "".join(row(i, axis, value) for axis, value in zip("XYZ", values, strict=True))
        for i, values in enumerate(c.position * MM, 1)
    )
    return {"report.txt": head + text, "joints.csv": table(JOINTS, np.degrees(c.q))}


def polyworks_blocks(c: Campaign) -> dict[str, str]:
    head = "Report\nUnits: Millimeters\n\nName\tControl\tNominal\tMeasured\tTest\n"
    return in_rows(
        c,
        head,
        "\t",
        lambda i, axis, v: (
            f"{f'P{i}' * (axis == 'X')}\t{axis}\t{v + 1:.6f}\t{v:.6f}\tPass\n" + "\t3D Dist\t\t\tPass\n" * (axis == "Z")
        ),
    )


def metrolog(c: Campaign) -> dict[str, str]:
    head = "METROLOG\tcell 4\nFeature\tType\tCharacteristic\tNominal\tActual\tStatus\n"
    return in_rows(c, head, "\t", lambda i, axis, v: f"P{i}\tPoint\t{axis}\t{v + 1:.6f}\t{v:.6f}\tOK\n")


def pc_dmis(c: Campaign) -> dict[str, str]:
    above = "\nDIM LOC{0}= LOCATION OF POINT P{0}  UNITS=MM\nAX    NOMINAL    +TOL    MEAS    DEV\n"
    return in_rows(c, "PART NAME  : CELL\n", " ", lambda i, axis, v: f"{axis} {v + 1:.6f} 0.5 {v:.6f} -1.0\n", above)


def istwert(c: Campaign) -> dict[str, str]:
    names = [f"{word} {axis}" for word in ("Istwert", "Sollwert", "Abweichung") for axis in "XYZ"]
    values = (c.position * MM, c.commanded * MM, c.position * MM - c.commanded * MM)
    text = table(";".join(["Merkmal", *names]), *values, name="P{}")
    return {"ist.csv": text, "joints.csv": table(f"Name;{JOINTS}", np.degrees(c.q), name="P{}")}


def prose_below(c: Campaign) -> dict[str, str]:
    tail = ";;;;\nErstellt am 25.11.2026 um 14:02;;;;\n"
    points = table("Element;X;Y;Z;Form", c.position * MM, 0 * c.position[:, :1], name="XP{}", tail=tail)
    return {"points.csv": points, "joints.csv": table(JOINTS, np.degrees(c.q))}


def labview(c: Campaign) -> dict[str, str]:
    end = "***End_of_Header***\t\n"
    head = f"LabVIEW Measurement\t\nSeparator\tTab\n{end}\t\nChannels\t9\nX0\t0.0\n{end}"
    names = "\t".join(["X_Value", *(f"J{i}" for i in range(1, 7)), "Trk X", "Trk Y", "Trk Z", "Comment"])
    times = 2.5 * np.arange(N)[:, None]
    return {"run.lvm": table(head + names, times, np.degrees(c.q), c.position * MM, sep="\t")}


def translated(joint: str, measured: str, units: str = "") -> Form:
    def form(c: Campaign) -> dict[str, str]:
        names = [*(joint.format(i) for i in range(1, 7)), *(measured.format(axis) for axis in "XYZ")]
        text = table(";".join(["Punto", *names]) + units, np.degrees(c.q), c.position * MM, name="P{}")
        return {"mesure.csv": text}

    form.__name__ = joint
    return form


def pendant(c: Campaign) -> dict[str, str]:
    head = "base shoulder elbow wrist1 wrist2 wrist3 tx ty tz"
    return {"ur.txt": table(head, c.q, c.position, sep=" ")}


def matlab_table(c: Campaign) -> dict[str, str]:
    names = [*(f"q_{i}" for i in range(1, 7)), "p_1", "p_2", "p_3"]
    return {"run.csv": table(",".join(["t", *names]), 7.0 * np.arange(N)[:, None], c.q, c.position, sep=",")}


def centimetres(c: Campaign) -> dict[str, str]:
    return {"cm.csv": table(f"{JOINTS};X;Y;Z", np.degrees(c.q), c.position * 100)}


def open_cv(c: Campaign) -> dict[str, str]:
    names = [f"{stem}_{i}" for stem, n in (("joint", 6), ("tvec", 3), ("rvec", 3)) for i in range(n)]
    return {"aruco.csv": table(",".join(names), c.q, c.position, c.turn.as_rotvec(), sep=",")}


def euler_radians(c: Campaign) -> dict[str, str]:
    names = ";".join(f"A{i} [rad]" for i in range(1, 7))
    return {"abc.csv": table(f"{names};X;Y;Z;Alpha;Beta;Gamma", c.q, c.position * MM, c.turn.as_euler("ZYX"))}


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


def optotrak(c: Campaign) -> dict[str, str]:
    head = "Number of frames: 24\nUnits: mm\n\nFrame,Marker_1 x,Marker_1 y,Marker_1 z\n"
    return {"marker.csv": lines(named(c.position * MM, "{}"), ",", head), "joints.csv": table(JOINTS, np.degrees(c.q))}


def channels(c: Campaign) -> dict[str, str]:
    head = "Name:,Scan\n\nScan,101 <Trk X> (mm),102 <Trk Y> (mm),103 <Trk Z> (mm)\n"
    return {"scan.csv": lines(named(c.position * MM, "{}"), ",", head), "joints.csv": table(JOINTS, np.degrees(c.q))}


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


POSITIONS: tuple[Form, ...] = (
    *(polyworks, cam2_and_kuka, kuka_points_alone, rtde_and_leica, fanuc_in_inches, robodk, laboratory),
    *(spatial_analyzer_and_rapid, yaml_records, json_columns, trials),
    *(bare_degrees_and_mm, bare_points_and_joints, bare_position_first, bare_with_rows_of_nan, matlab),
    *(radian_tracker, target_report, nikon, qualisys, kawasaki, yaskawa, ros_echo, plotjuggler),
    *(two_header_lines, german, comments_below, side_by_side, commanded_and_read_joints),
    *(beside(controller, measured) for controller, measured in BESIDE),
    *(controller_pose_and_leica, names_by_number, names_in_groups, names_of_repetitions, polyworks_blocks, metrolog),
    *(pc_dmis, istwert, prose_below, labview, pendant, matlab_table, centimetres, optotrak, channels, yaskawa_job),
    *(translated("Axe {} (°)", "{} mesuré (mm)"), translated("Articulación {}", "{} medido")),
    translated("Asse {}", "{} misurato", "\n;" + ";".join(["gradi"] * 6 + ["mm"] * 3)),
)
POSES: tuple[Form, ...] = (
    *(vicon, counted_quaternion, json_lines, json_records, bare_matrices),
    *(bare_quaternions, creaform, optitrack, qualisys_bodies),
    *(hand_eye_matrices, hand_eye_transforms, trajectories),
    *(stamped, open_cv, euler_radians, body_and_marker, tool_and_stray, le_robot),
)
WITHOUT_ROBOT = (hand_eye_matrices, hand_eye_transforms, trajectories)


def written(files: dict[str, str], folder: Path) -> list[str]:
    """Write the files, and return the arguments that name the measured poses and, if there are any, the commands."""
    for name, text in files.items():
        (folder / name).write_text(text, encoding="utf-8")
    first, *others = files
    return [str(folder / first), *(["--commanded", str(folder / others[0])] if others else [])]


def figures(arguments: list[str]) -> dict[str, Any]:
    done = CliRunner().invoke(app, ["estimate", *arguments, "--format", "json"], catch_exceptions=False)
    assert done.exit_code == 0, done.stderr
    document: dict[str, Any] = json.loads(done.stdout)
    return document


@pytest.mark.parametrize("form", [*POSITIONS, *POSES], ids=lambda form: form.__name__)
def test_a_form_gives_the_figures_of_the_plain_file(form: Form, campaign: Campaign, tmp_path: Path) -> None:
    joints = ",".join(f"q{i}" for i in range(1, 7))
    plain = np.hstack((campaign.q, campaign.position, *([campaign.turn.as_quat()] if form in POSES else [])))
    head = f"{joints},x,y,z{',qx,qy,qz,qw' if form in POSES else ''}\n"
    expected = figures([*written({"plain.csv": lines(plain, ",", head)}, tmp_path), "--robot", ROBOT])
    assert expected["position"]["rms_m"] < 1e-4
    for robot in (["--robot", ROBOT], *([[]] if form in WITHOUT_ROBOT else [])):
        found = figures([*written(form(campaign), tmp_path), *robot])
        for key in ("rms_m", "p95_m", "max_m"):
            assert found["position"][key] == pytest.approx(expected["position"][key], rel=2e-3)
        if form in POSES:
            assert found["orientation"]["rms_rad"] == pytest.approx(expected["orientation"]["rms_rad"], rel=2e-3)


@pytest.mark.parametrize(
    "rows",
    [
        lambda c: np.hstack((c.q, c.commanded, c.position)),  # two columns of positions follow the arm
        lambda c: np.hstack((c.q, c.position))[:7],  # too few rows
        lambda c: np.hstack((c.q, c.position[::-1])),  # no position does
    ],
    ids=["two", "few", "none"],
)
def test_numbers_without_one_reading_stay_a_question(
    rows: Callable[[Campaign], np.ndarray], campaign: Campaign, tmp_path: Path
) -> None:
    path = written({"bare.csv": lines(rows(campaign))}, tmp_path)[0]
    with pytest.raises(InputError, match="found numbers, expected a header row"):
        robacc.read_poses(path, robot=ROBOT)


def test_one_note_says_how_numbers_were_read(campaign: Campaign, tmp_path: Path) -> None:
    path = written(bare_degrees_and_mm(campaign), tmp_path)[0]
    joints = ", ".join(f"q{i}_deg" for i in range(1, 7))
    (note,) = [text for text in robacc.read_poses(path, robot=ROBOT).warnings if "no header" in text]
    assert f"columns 1 to 9 read as {joints}, X [mm], Y [mm], Z [mm], only this reading agrees with the motion" in note


def test_notes_say_how_a_file_was_read_and_quiet_leaves_them_out(campaign: Campaign, tmp_path: Path) -> None:
    arguments = ["estimate", *written(laboratory(campaign), tmp_path), "--robot", ROBOT]
    spoken = CliRunner().invoke(app, arguments).stderr.splitlines()
    words = [line.partition(":")[0] for line in spoken]
    assert words == sorted(words, reverse=True)  # warnings first
    notes = [line for line in spoken if line.startswith("note: ")]
    assert sum("not read below the table: " in line for line in notes) == 1
    assert any("A1, A2, A3, A4, A5, A6 taken as deg: no other unit" in line for line in notes)
    assert any("X, Y, Z taken as mm: no other unit" in line for line in notes)
    assert any("U95 [um] -> sigma_x_um times 2" in line for line in notes)
    quiet = CliRunner().invoke(app, [*arguments, "--quiet"]).stderr.splitlines()
    assert quiet == [line for line in spoken if not line.startswith("note: ")]


def test_rows_without_a_measurement_are_left_out_by_their_status(campaign: Campaign, tmp_path: Path) -> None:
    path = written(trials(campaign), tmp_path)[0]
    data = robacc.read_poses(path, robot=ROBOT)
    assert data.n == N
    (left_out,) = [text for text in data.warnings if "left out" in text]
    assert "2 rows with a missing value left out (line 6, 11)" in left_out
    assert not isinstance(left_out, Note)
    text = Path(path).read_text(encoding="utf-8").replace("FAILED", "OK")
    Path(path).write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"11, x: found 'nan', expected a finite number"):
        robacc.read_poses(path, robot=ROBOT)


def test_a_row_without_a_measurement_at_the_end_is_no_footer(campaign: Campaign, tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    path.write_text(lines(named(campaign.position * MM), ",", "Name,X,Y,Z\n", "P99,,,\n"), encoding="utf-8")
    with pytest.raises(InputError, match=f"{N + 2}, X: the value is missing"):
        robacc.read_poses(path)


def test_init_proposes_a_matrix(campaign: Campaign, tmp_path: Path) -> None:
    path = written(bare_matrices(campaign), tmp_path)[0]
    done = CliRunner().invoke(app, ["init", path, "--folder", str(tmp_path)])
    assert "reads 13 of 13 columns" in done.stdout
    text = (tmp_path / "columns.yaml").read_text(encoding="utf-8")
    assert "m_00 … m_23 as a matrix: X, Y, Z and the orientation" in text
    (tmp_path / "columns.yaml").write_text(text.replace("unknown", "m,rad"), encoding="utf-8")
    stated = ["--columns", str(tmp_path / "columns.yaml")]
    assert figures([path, "--robot", ROBOT, *stated])["position"] == figures([path, "--robot", ROBOT])["position"]


def test_points_and_joints_as_two_positional_files_get_one_hint(campaign: Campaign, tmp_path: Path) -> None:
    files = counted_quaternion(campaign)
    arguments = written(files, tmp_path)
    done = CliRunner().invoke(app, ["estimate", arguments[0], arguments[2], "--robot", ROBOT])
    assert done.exit_code == 3
    assert done.stderr.count(f"robacc estimate {arguments[0]} --commanded {arguments[2]}") == 1


def test_two_readings_stay_a_question(campaign: Campaign, tmp_path: Path) -> None:
    """Joints of a small motion may be in degrees or radians, and points without an arm in millimetres or inches."""
    (tmp_path / "joints.csv").write_text(lines(campaign.q, ",", "J1,J2,J3,J4,J5,J6\n"), encoding="utf-8")
    (tmp_path / "points.csv").write_text(lines(campaign.position * MM / 20, ",", "X,Y,Z\n"), encoding="utf-8")
    for arguments in (
        ["points.csv", "--commanded", "joints.csv", "--robot", ROBOT],
        ["points.csv", "--commanded", "points.csv"],
    ):
        paths = [str(tmp_path / text) if text.endswith(".csv") else text for text in arguments]
        done = CliRunner().invoke(app, ["estimate", *paths])
        assert done.exit_code == 3
        assert "these columns state no unit" in done.stderr


def test_a_part_in_another_unit_is_refused(campaign: Campaign, tmp_path: Path) -> None:
    q = np.vstack((np.degrees(campaign.q[:8]), campaign.q[8:]))
    head = ",".join(f"q{i}" for i in range(1, 7)) + ",x,y,z\n"
    path = tmp_path / "poses.csv"
    path.write_text(lines(np.hstack((q, campaign.position)), ",", head), encoding="utf-8")
    with pytest.raises(InputError, match="from line 2 to 9 only"):
        robacc.read_poses(path, robot=ROBOT)


@pytest.mark.parametrize(
    "text", ['{"joints": [1, 2', '[{"joints": 1}, 2]', "a: &a [1]\nb: [*a, *a]\n", '{"poses": []}'], ids=str
)
def test_documents_without_records_get_one_message(text: str, tmp_path: Path) -> None:
    path = tmp_path / "poses.yaml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InputError) as caught:
        robacc.read_poses(path)
    assert len(caught.value.problems) == 1


def test_a_second_position_of_unknown_kind_is_a_question(campaign: Campaign, tmp_path: Path) -> None:
    for name in ("Foo {}", "ref_{}"):
        path = written(beside("{}", name)(campaign), tmp_path)[0]
        with pytest.raises(InputError, match=r"found several positions: 'X, Y, Z' or .* say with `columns`"):
            robacc.read_poses(path, robot=ROBOT)


@pytest.mark.parametrize("name", ["d{}", "{} dev", "Vel {}", "v{}", "Abw. {}", "RMS {}"])
def test_what_is_no_position_is_no_rival(name: str, campaign: Campaign, tmp_path: Path) -> None:
    path = written(beside(name, "{}")(campaign), tmp_path)[0]
    data = robacc.read_poses(path, robot=ROBOT)
    np.testing.assert_allclose(data.position.T, campaign.position, atol=1e-9)


def test_a_controllers_position_is_the_command_without_joints(campaign: Campaign, tmp_path: Path) -> None:
    text = table("Nr;x;y;z;Leica X;Leica Y;Leica Z", campaign.commanded * MM, campaign.position * MM, name="{}")
    path = written({"both.csv": text}, tmp_path)[0]
    data = robacc.read_poses(path)
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
    done = CliRunner().invoke(app, ["estimate", *path, "--robot", ROBOT])
    assert "the errors are too large for an arm, and E1 moves and is not used" in " ".join(done.stderr.split())


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


def test_deviations_alone_are_no_positions(campaign: Campaign, tmp_path: Path) -> None:
    text = table(f"{JOINTS};dX;dY;dZ", np.degrees(campaign.q), campaign.position)
    with pytest.raises(InputError, match="columns x, y, z are missing"):
        robacc.read_poses(written({"deviations.csv": text}, tmp_path)[0], robot=ROBOT)
