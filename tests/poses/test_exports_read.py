"""Exports of instruments and robots: what is read of them, what is refused, and names made to mislead."""

import math
import os
import subprocess
import sys
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import run
from pose_files import PLAIN, Reader, one_row, problem_texts
from sample_files import saved

from robacc.errors import MAX_PROBLEMS, InputError, UsageError
from robacc.io.dialect import split_cell
from robacc.poses.csv_file import read_poses
from robacc.poses.reading import KnownRobot, Reading, heading_of, meaning_of

# Texts of exports that are read: what each column is taken for, and what is said of it.

ABC = frozenset({"a", "b", "c"})
NAMES = {
    "X [mm]": ("x", "mm"),
    "Y_mm": ("y", "mm"),
    "z (µm)": ("z", "um"),
    "Pos X": ("x", None),
    "TCP_Z/in": ("z", "in"),
    "tx": ("x", None),
    "pose.position.y": ("y", None),
    "transform.translation.z": ("z", None),
    "Measured X": ("x", None),
    "J1": ("q1", None),
    "J 6 [deg]": ("q6", "deg"),
    "A3 (°)": ("q3", "deg"),
    "$AXIS_ACT.A1 [deg]": ("q1", "deg"),
    "actuator_2_deg": ("q2", "deg"),
    "joint_2": ("q2", None),
    "Achse 4": ("q4", None),
    "theta5_rad": ("q5", "rad"),
    "actual_q_0": ("q0", None),
    "Roll": ("roll", None),
    "Rx [°]": ("rx", "deg"),
    "B": ("ry", None),
    "Qw": ("qw", None),
    "Point Name": ("pose", None),
    "SMR": ("target", None),
    "Zeit [s]": ("time", "s"),
    "std x": ("sigma_x", None),
    "Temperature (°C)": ("temperature_c", "degC"),
    "Load [kg]": ("payload_kg", "kg"),
    "测量X(mm)": ("x", "mm"),
    "J2角度": ("q2", None),
    "第3軸 [deg]": ("q3", "deg"),
    **dict.fromkeys(("dX", "X deviation", "velocity x", "Comment", "E1", "误差X"), (None, None)),
}
CELLS = {
    "381.289 mm": ("381.289", "mm"),
    "-33,5°": ("-33,5", "deg"),
    "1e-3 m": ("1e-3", "m"),
    "1'381.5 mm": ("1'381.5", "mm"),
    **{text: (text, None) for text in ("12", "12 apples", "33°30'", "P1 m", "")},
}


@pytest.mark.parametrize("name", NAMES)
def test_a_name_has_the_meaning_of_its_words(name: str) -> None:
    heading = heading_of(name)
    meaning = meaning_of(heading, ABC | {heading.text})
    assert (None if meaning is None else meaning.key, meaning and heading.unit) == NAMES[name]
    assert meaning_of(heading_of("B"), frozenset({"b"})) is None  # single letters mean angles only together


@pytest.mark.parametrize("name", ["Quat{}", "orientation_{}", "Rotation {}"])
def test_four_numbered_orientations_are_a_quaternion_in_their_order(name: str) -> None:
    headings = [heading_of(name.format(number)) for number in range(1, 5)]
    together = frozenset(heading.text for heading in headings)
    assert [meaning_of(heading, together).key for heading in headings] == ["qw", "qx", "qy", "qz"]


@pytest.mark.parametrize("text", CELLS)
def test_a_cell_is_a_number_and_a_known_unit(text: str) -> None:
    assert split_cell(text) == CELLS[text]


DEGREE = math.pi / 180
SHOULDER = KnownRobot(["shoulder"])
RIGHT = [(-math.pi / 2, math.pi / 2)]
TURNING = {"robot": KnownRobot(["j1"], ["revolute"], RIGHT)}
PI = {"robot": KnownRobot(["j1"], ["revolute"], [(-3.14159, 3.14159)])}
UNITS = "Point,J1,J2,X,Y,Z\n"
IN_CELLS = "P1,10.5°,-20°,381.289 mm,-7.5 mm,1043.999 mm\nP2,30°,40.25°,1 mm,2 mm,3 mm\n"
OF_CELLS = {
    "q": np.radians([[10.5, 30], [-20, 40.25]]),
    "position": [[0.381289, 0.001], [-0.0075, 0.002], [1.043999, 3e-3]],
}
COMMAS = "J1 [°];J2 [°];X [mm];Y [mm];Z [mm]\n1,5;-2,5;{};200,5;300,5\n1,5;-2,5;100,5;200,5;300,5\n"
POINTS = "J1 [deg],X [mm],Y [mm],Z [mm]\n1.5,{},2.5,3.5\n2.5,100.5,3.5,4.5\n"
TIMES = "{};J1 [deg];X [m];Y [m];Z [m]\n{};1;2;3;0\n{};1;2;3;1\n"
LONG = "Point,Axis,Nominal [mm],Actual [mm],Deviation\n" + "".join(
    f"{point},{axis},{10 * k},{10 * k + 0.5},0.5\n"
    for point, axes in (("P1", "XYZ"), ("P2", "ZXY"))
    for k, axis in enumerate(axes, 1)
)
OF_LONG = {
    "position": np.array([[10.5, 20.5], [20.5, 30.5], [30.5, 10.5]]) / 1e3,
    "commanded_position": np.array([[10, 20], [20, 30], [30, 10]]) / 1e3,
    "pose": ["P1", "P2"],
    "rows": [2, 6],
}
WIDE = "J1 [deg],J2 [deg],X{0} [mm],Y{0} [mm],Z{0} [mm],X{1} [mm],Y{1} [mm],Z{1} [mm]\n0,0,400,0,410,420,50,430\n"
OF_WIDE = {"position": [[0.4, 0.42], [0, 0.05], [0.41, 0.43]], "visit": ["2", "2"]}


def uncertain(unit: str, names: str, value: str, position: str = "500,20,900") -> str:
    rows = "".join(f"{10 * i},{position},{value},{value},{value}\n" for i in range(2))
    return f"J1 (deg),X ({unit}),Y ({unit}),Z ({unit}),{names}\n{rows}"


def both(value: float) -> list[list[float]]:
    return [[value] * 2] * 3


READ: list[tuple[str | bytes, dict[str, Any], dict[str, Any], list[str]]] = [
    # Every column of a documented file.
    (
        PLAIN,
        {},
        {"q": [[0.1, -0.1], [0.2, 0.3]], "position": [[1, 1.5], [2, 2.5], [3, 3.5]], "rows": [2, 3]},
        [],
    ),
    ("x_mm,y_mm,z_mm,q1_deg\n1234.5,0.1,-7.3,90\n", {}, {"position": [[1.2345], [1e-4], [-7.3e-3]]}, []),
    # Rows with stale values that say they were not measured; a verdict on the values is another matter.
    *(
        (f"q1,x,y,z,{name}\n0,1,2,3,{yes}\n0.1,1,2,3,{no}\n0.2,1,2,4,{yes}\n", {}, {"rows": rows}, warnings)
        for name, yes, no, rows, warnings in (
            ("Valid", "1", "0", [2, 4], ["1 row incomplete or not measured, left out (line 3)"]),
            ("isTracked", "True", "False", [2, 4], ["1 row incomplete or not measured, left out (line 3)"]),
            ("Occluded", "0", "1", [2, 4], ["1 row incomplete or not measured, left out (line 3)"]),
            ("lost_frames", "0", "1", [2, 3, 4], ["unknown column 'lost_frames' is ignored"]),
            ("Target Status", "OK", "Lost", [2, 4], ["1 row incomplete or not measured, left out (line 3)"]),
            ("Result", "pass", "fail", [2, 3, 4], ["unknown column 'Result' is ignored"]),
        )
    ),
    ("q1,x,y,z\n0,1,2,3\n, ,,\n0.2,1,2,4\n", {}, {"rows": [2, 4]}, []),
    (
        "z,qz,q2,y,qw,q1,x,qy,qx\n3,0,0.2,2,1,0.1,1,0,0\n",
        {},
        {"q": [[0.1], [0.2]], "position": [[1], [2], [3]], "rotation": np.eye(3)[..., None]},
        [],
    ),
    (
        one_row(pose="P1", cycle=7, target="smr 1", time_s=12.5, temperature_c=-3, payload_kg=0),
        {},
        {"pose": ["P1"], "cycle": ["7"], "target": ["smr 1"], "time": [12.5], "temperature": [-3], "payload": [0]},
        [],
    ),
    ('x,y,z,pose,note\n1,2,3,P#1,a\n1,2,4,"P,#2",b\n', {}, {"pose": ["P#1", "P,#2"]}, ["'note'"]),
    ('x,y,z,pose\n1,2,3,"P 1"\n1,2,4,"6"" pipe"\n', {}, {"pose": ["P 1", '6" pipe']}, []),
    ("pose,x,y,z\nP1,1,2,3\nP1,1,2,4\n", {}, {"q": None, "commanded_position": None}, []),
    (
        "x,y,z,cmd_x,cmd_y,cmd_z\n1,2,3,1,2,3\n",
        {"robot": KnownRobot(["a", "b"])},
        {"q": None, "commanded_position": [[1], [2], [3]]},
        [],
    ),
    (
        "lift_mm,dir_elbow,elbow,x,y,z,speed_lift,speed_elbow,dir_q1\n250,-1,0.2,1,2,3,1,-0.5,1\n",
        {"robot": KnownRobot(["lift", "elbow"], ["prismatic", "revolute"])},
        {"q": [[0.25], [0.2]], "direction": [[1], [-1]], "speed": [[1], [-0.5]]},
        [],
    ),
    ("arm_m,x,y,z\n0.5,1,2,3\n", {"robot": KnownRobot(["arm_m"])}, {"q": [[0.5]]}, []),
    *(
        (
            f"{names},x,y,z\n{q},1,2,3\n",
            {"robot": KnownRobot(["q0", "q1", "q2"])},
            {"q": [[0.1], [0.2], [0.3]]},
            [],
        )
        for names, q in (("q2,q1,q0", "0.3,0.2,0.1"), ("q1,q2,q3", "0.1,0.2,0.3"))
    ),
    # Motion: from the order of rows, from columns, and what contradicts itself.
    (
        "q1,q2,x,y,z\n0,0,1,2,3\n0.5,-0.25,1,2,4\n0.5,-0.25,1,2,5\n0.5,0.75,1,2,6\n",
        {"ordered": True},
        {"direction": [[0, 1, 0, 0], [0, -1, 0, 1]], "speed": [[0, 1, 0, 0], [0, -0.5, 0, 1]]},
        [],
    ),
    (
        "q1,q2,x,y,z,dir_q2,speed_q1\n0,0,1,2,3,1,0.5\n0.5,-0.25,1,2,4,1,0.25\n",
        {"ordered": True},
        {"direction": [[0, 1], [1, 1]], "speed": [[0.5, 0.25], [0, -0.5]]},
        [],
    ),
    (
        "q1,q2,x,y,z,dir_q2\n0,0,1,2,3,-1\n",
        {},
        {"direction": [[0], [-1]], "speed": None},
        ["no column dir_q1: 0 (not moving) is assumed"],
    ),
    (
        "x,y,z,cmd_x,cmd_y,cmd_z,time_s\n1,2,3,1,2,3,5\n1,2,4,1,2,3,7\n1,2,5,1,2,3,6\n",
        {"ordered": True},
        {"direction": None, "ordered": [True]},
        [
            "the file has no joint columns, so the order of rows does not give the joints' directions",
            "time_s decreases at line 4: the clock was set back, or the rows are not in the order measured",
        ],
    ),
    ("q1,x,y,z,dir_q1,speed_q1\n0,1,2,3,1,0.5\n0,1,2,4,0,0.5\n0,1,2,5,1,0\n", {}, {"ordered": [False]}, []),
    (
        "q1,x,y,z,dir_q1,speed_q1\n0,1,2,3,1,0.5\n0,1,2,6,-1,0.5\n",
        {},
        {},
        ["dir_q1 and speed_q1 have opposite signs at line 3: one of them is wrong"],
    ),
    # Documented files are read as documented: names that would mean something in an export stay unknown.
    (
        "q1,x,y,z,Name,Rx,Ry,Rz,temp\n0.1,1,2,3,a,1,2,3,20\n",
        {},
        {"pose": None, "rotation": None, "temperature": None},
        ["'Name'", "'Rx'", "'Ry'", "'Rz'", "'temp' is ignored"],
    ),
    (
        "q1,x,y,z,tims,sigm_r,\n0,1,2,3,noon,,\n",
        {},
        {},
        [
            "1: unknown column 'tims' is ignored; the nearest known name is 'time_s'",
            "1: unknown column 'sigm_r' is ignored; the nearest known name is 'sigma_r'",
            "1: columns without a name are ignored: 1",
        ],
    ),
    (
        "q1,x,y,z,Ux (um),Uy,T air\n0.1,0.5,0.02,0.9,30,30,21\n",
        {},
        {},
        [
            "name is 'sigma_x_um'",
            "name is 'sigma_y'",
            "unknown column 'T air' is ignored; the nearest known name is 'temp",
        ],
    ),
    *(
        (f"q1,x,y,z,{name}\n0,1,2,3,12.5\n0.1,1,2,4,13\n", {}, {"time": [12.5, 13]}, [])
        for name in ("time", "timestamp", "t")
    ),
    ("q1_mm,x,y,z\n100,1,2,3\n", {}, {"q": [[0.1]]}, []),  # no robot, so it may be prismatic
    (
        one_row(qw=1.0009, qx=0, qy=0, qz=0, dir_q1=-1, speed_q1=-1.0000005, payload_kg=0, temperature_c=-273.15),
        {"robot": KnownRobot(limits=[(-0.1, 0.1 - 1e-10)])},
        {"payload": [0]},
        [],
    ),
    (one_row(), {"robot": KnownRobot(target_names=("smr1",))}, {"target": None}, []),
    ("q1,x,y,z,target\n0,1,2,3,a\n0,1,2,4,b\n", {}, {"target": ["a", "b"]}, []),
    ("q1,x,y,z,target\n0,1,2,3,a\n0,1,2,4,a\n", {"robot": KnownRobot(target_names=())}, {"target": ["a", "a"]}, []),
    ("visit,q1,x,y,z\n1,0,1,2,3\n2,0.5,1,2,4\n1,0,1,2,5\n", {}, {"visit": ["1", "2", "1"]}, []),
    # A small excess of a limit is a warning; rounding of a limit is nothing.
    (
        "q1_deg,x,y,z\n90.0499,0,0,1\n0,0,0,1\n-90,0,1,1\n",
        TURNING,
        {},
        [":2: q1_deg exceeds the limits of j1, -90 to 90 deg by at most 0.0499 deg in 1 row, which is used"],
    ),
    ("q1_deg,x,y,z\n90.0501,0,0,1\n", {**TURNING, "ignore_limits": True}, {}, ["by at most 0.0501 deg in 1 row"]),
    ("q1_deg,x,y,z\n180,0,0,1\n-180,0,1,1\n", PI, {}, []),
    ("q1_deg,x,y,z\n180.001,0,0,1\n-180,0,1,1\n", PI, {}, ["deg in 1 row, which is used"]),
    (
        "q1,x,y,z\n0.3004,0,0,1\n0.3,0,0,1\n",
        {"robot": KnownRobot(["rail"], ["prismatic"], [(0, 0.3)])},
        {},
        ["by at most 0.0004"],
    ),
    # Numbers and encodings of exports.
    (
        POINTS.format('"1,903.540"'),
        {},
        {"position": [[1.90354, 0.1005], [0.0025, 0.0035], [0.0035, 0.0045]]},
        ["thousands"],
    ),
    (
        POINTS.format("1'903.540"),
        {},
        {"position": [[1.90354, 0.1005], [0.0025, 0.0035], [0.0035, 0.0045]]},
        ["thousands"],
    ),
    *(
        (
            COMMAS.format(x),
            {},
            {"position": [[value, 0.1005], [0.2005] * 2, [0.3005] * 2]},
            ["decimal comma, separators of thousands"],
        )
        for x, value in (
            *(("1.043,999", 1.043999), ("-1.043,5", -1.0435), ("1'043,5", 1.0435), ("1'043", 1.043)),
            *(("1\u00a0043,5", 1.0435), ("1\u2019043,5", 1.0435)),
        )
    ),
    (
        COMMAS.format("\u2212100,5"),
        {},
        {"position": [[-0.1005, 0.1005], [0.2005] * 2, [0.3005] * 2]},
        ["decimal comma"],
    ),
    (
        "pose,q1_deg,x_mm,y_mm,z_mm\nPrüfling,1.5,1,2,3\nMüller 21 °C,2.5,3,4,5\n".encode("cp1252"),
        {},
        {"pose": ["Prüfling", "Müller 21 °C"]},
        ["poses.csv: Windows-1252"],
    ),
    (
        "A1;X;Y;Z\nGrad;mm;mm;mm\n90,0;1,5;2,5;3,5\n45,0;2,5;3,5;4,5\n",
        {},
        {"q": [[math.pi / 2, math.pi / 4]]},
        ["A1 [Grad] -> q1_deg"],
    ),
    ("pose,J1 (deg),x_mm,y_mm,z_mm\na,90,1,2,3\n", {"robot": SHOULDER}, {"q": [[math.pi / 2]]}, ["J1 (deg) -> q1_deg"]),
    (
        "Target;J1 (deg);X (mm);Y (mm);Z (mm)\nT0;1;100;200;300\nT1;2;110;200;300\n",
        {"robot": KnownRobot(target_names=())},
        {"target": None, "pose": ["T0", "T1"]},
        ["used as the names of the poses"],
    ),
    *(
        (f"{name};J1 [deg];X [mm];Y [mm];Z [mm]\nA;1;2;3;4\nB;2;3;4;5\n", {}, {"pose": ["A", "B"]}, [f"{name} -> pose"])
        for name in ("Label", "Element", "Feature name")
    ),
    # Names, units and uncertainties.
    ("joint_0 [deg];joint_1 [deg];X [m];Y [m];Z [m]\n1;2;3;4;5\n", {}, {"q": [[DEGREE], [2 * DEGREE]]}, ["joint_0"]),
    (
        "J1 [deg];X [m];Y [m];Z [m];temperature_f;Operator\n1;2;3;4;5;6\n",
        {},
        {},
        ["not used: 'temperature_f' (did you mean temperature_c?), 'Operator'"],
    ),
    (
        uncertain("mm", "Ux [mm],Uy [mm],Uz [mm]", "0.1"),
        {},
        {"sigma_position": None},
        [
            "not used: 'Ux [mm]', 'Uy [mm]', 'Uz [mm]'",
            "to use the uncertainties Ux [mm], Uy [mm], Uz [mm], give `coverage`: 1 for a standard",
        ],
    ),
    (
        uncertain("mm", "std x,std y,std z", "0.03"),
        {},
        {"sigma_position": both(3e-5)},
        ["std x, std y, std z taken as mm, the unit of X (mm); `units` states another"],
    ),
    (
        uncertain("in", "std x,std y,std z", "0.001", "20,1,40"),
        {},
        {"sigma_position": both(2.54e-5)},
        ["taken as in, the"],
    ),
    (uncertain("mm", "Ux,Uy,Uz", "0.03"), {"coverage": 2}, {"sigma_position": both(1.5e-5)}, ["taken as mm, the"]),
    (uncertain("mm", "Ux,Uy,Uz", "30"), {"coverage": 2, "units": "um,deg"}, {"sigma_position": both(1.5e-5)}, []),
    # Nanoseconds since 1970 have 19 digits, of which a float keeps 16.
    *(
        (TIMES.format(name, *entries), {}, {"time": seconds}, [])
        for name, entries, seconds in (
            ("Time", ("2026-11-22T10:00:00.5Z", "2026-11-22 10:00:01"), (36000.5, 36001.0)),
            ("Timestamp", ("22.11.2026 10:00:00,25", "23.11.2026 00:00:01"), (36000.25, 86401.0)),
            ("Zeit", ("23:59:59", "00:00:01"), (86399.0, 86401.0)),
            ("Time", ("11/22/2026 1:00:00 PM", "11/22/2026 1:00:01 PM"), (46800.0, 46801.0)),
            ("time", ("20261122_100000", "20261122_100001"), (36000.0, 36001.0)),
            ("timestamp", ("20261122100000", "20261122100001"), (36000.0, 36001.0)),
            ("time", ("20261122-100000_250000", "20261123-000001"), (36000.25, 86401.0)),
            ("time [ms]", ("1500", "2500"), (1.5, 2.5)),
            ("timestamp", ("1795341600.5", "1795341601.5"), (36000.5, 36001.5)),
            ("stamp", ("1795341600500000000", "1795341601500000000"), (36000.5, 36001.5)),
        )
    ),
    # Units in the cells.
    (UNITS + IN_CELLS, {}, OF_CELLS, ["X -> x_mm", "units in the cells: deg, mm"]),
    ("pose,q1,q2,x,y,z\n" + IN_CELLS, {}, OF_CELLS, ["units in the cells: deg, mm"]),
    ((UNITS + IN_CELLS).replace(",", ";").replace(".", ","), {}, OF_CELLS, ["decimal comma"]),
    (UNITS + "P0,1°,2°,---,,n/a\n" + IN_CELLS, {"skip_gaps": True}, OF_CELLS, ["left out"]),
    (
        UNITS + IN_CELLS,
        {"columns": {"Point": "pose", "J1": "q1", "J2": "q2", "X": "x", "Y": "y", "Z": "z"}},
        OF_CELLS,
        ["units in the cells: deg, mm"],
    ),
    # One row for each axis, and several targets in each row.
    (LONG, {}, OF_LONG, ["one row for each axis joined", "X [mm] -> x_mm"]),
    (LONG + "P2,T,0,0.1,0.1\n", {}, OF_LONG, ["rows of 'T' not used"]),
    (LONG.replace("30,30.5", "30,---", 1), {"skip_gaps": True}, {"pose": ["P2"]}, ["left out"]),
    (
        "Punkt;A1;Achse;Istwert\n"
        + "".join(f"P1;30°;{x};{10 * k + v},0 mm\n" for v in (1, 2) for k, x in enumerate("XYZ")),
        {},
        {"position": np.array([[1, 2], [11, 12], [21, 22]]) / 1e3, "pose": ["P1", "P1"]},
        ["one row for each axis joined"],
    ),
    (
        "Punkt;Achse;Istwert [mm]\nP1;X;1,5\nP1;Y;2,5\nP1;Z;3,5\n",
        {"commands": False},
        {"position": [[0.0015], [0.0025], [0.0035]]},
        ["decimal comma"],
    ),
    # Poses side by side in a row for each cycle.
    (
        "Zyklus;P1 X;P1 Y;P1 Z;P2 X;P2 Y;P2 Z\n1;0 mm;1 mm;2 mm;10 mm;11 mm;12 mm\n2;3 mm;4 mm;5 mm;13 mm;14 mm;15 mm",
        {},
        {
            "position": np.array([[0, 10, 3, 13], [1, 11, 4, 14], [2, 12, 5, 15]]) / 1e3,
            **{"pose": ["p1", "p2", "p1", "p2"], "cycle": ["1", "1", "2", "2"]},
        },
        ["several poses in each row: P1 X, P1 Y, P1 Z of pose p1; P2 X, P2 Y, P2 Z of pose p2"],
    ),
    *(
        (
            WIDE.format(*labels),
            {"robot": KnownRobot(["j1", "j2"], target_names=names)},
            {**OF_WIDE, "target": [*names]},
            [f"X{labels[1]} [mm], Y{labels[1]} [mm], Z{labels[1]} [mm] of target {names[1]}"],
        )
        for labels, names in (
            (("1", "2"), ("t1", "t2")),
            (("1", "2"), ("1", "2")),
            (("1", "2"), ("SMR1", "SMR2")),
            (("_left", "_right"), ("left", "right")),
        )
    ),
]


@pytest.mark.parametrize(("text", "options", "values", "said"), READ, ids=lambda value: str(value)[:40])
def test_a_text_is_read_and_the_warnings_say_how(
    read: Reader, text: str | bytes, options: dict[str, Any], values: dict[str, Any], said: list[str]
) -> None:
    data = read(text, **options)
    for name, expected in values.items():
        actual = getattr(data, name)
        if expected is None or isinstance(expected[0], str):
            assert (actual if expected is None else actual.tolist()) == expected
        else:
            np.testing.assert_allclose(actual, expected, rtol=1e-13, atol=1e-6 if name == "time" else 0)
    assert all(any(part in warning for warning in data.warnings) for part in said)
    assert bool(said) == bool(data.warnings) or "time" in values or "Ux,Uy" in str(text)


def test_only_some_unknown_columns_are_listed(read: Reader) -> None:
    warnings = read("q1,x,y,z," + ",".join(f"u{i}" for i in range(25)) + "\n").warnings
    assert len(warnings) == 21
    assert warnings[-1].endswith("… and 5 more unknown columns")


# Texts that are no poses: each ends in its problems, with line and column, and with what to do.

Case = tuple[str | bytes, dict[str, Any], str]
"""A text, statements and options, and a part of its only problem."""
HOSTILE = "x,y,z,cmd_x,cmd_y,cmd_z\n"
BESIDE = "1,2,3,1,2,3.001\n"
ARM = KnownRobot(["base", "lift"], ["revolute", "prismatic"])
NO_TEXT = "the file is not UTF-8 text (it is UTF-16 or binary); save it as UTF-8"
ONLY_MEASURED = (
    "the file has measured poses only: neither joint variables nor commanded poses; give the commands with "
    "`commanded`: the robot program, or a table of joints or poses; or add columns "
)
SKIP = "give `skip_gaps` to leave out rows with a missing value"
IGNORE = "`ignore_limits` uses these rows all the same"
TARGETS = "q1,x,y,z,target\n0,1,2,3,smr1\n0,1,2,3,smr3x\n"
VISITS = "visit,q1,x,y,z\n1,0,1,2,3\n2,0.5,1,2,4\n1,{},1,2,5\n"
DEGREES_AND_MM = "J1 [deg],X [mm],Y [mm],Z [mm]\n1.5,{},2.5,3.5\n2.5,100.5,3.5,4.5\n"
WRONG_CELLS = "P1,10.5°,-20°,381.289 mm,-7.5 mm,1043.999 mm\n"
POINT_NAMES = "Point,J1,J2,X,Y,Z\n"
LINES = [
    "Point,Axis,Nominal [mm],Actual [mm],Deviation",
    "P1,X,10,10.5,0.5",
    "P1,Y,20,20.5,0.5",
    "P1,Z,30,30.5,0.5",
]
WIDE_WRONG = "J1 [deg],J2 [deg],X1 [mm],Y1 [mm],Z1 [mm],X2 [mm],Y2 [mm],Z2 [mm]\n0,0,400,0,400,400,50,400\n"
TWO = KnownRobot(["j1", "j2"], target_names=("t1", "t2"))
UX = "J1 (deg),X (mm),Y (mm),Z (mm),Ux,Uy,Uz\n" + "".join(f"{i},500,20,900,30,30,30\n" for i in range(4))
COMMANDED = "cmd_x,cmd_y,cmd_z,cmd_qw,cmd_qx,cmd_qy,cmd_qz"
NO_TABLES: list[Case] = [
    (b"", {}, "the file is empty; expected a header row of column names and one row per pose"),
    (b"# only a comment\n\n", {}, "the file is empty; expected a header row"),
    ("a;b;c;d\nred;green;blue;grey\n", {}, "1: the columns are separated by semicolons, expected commas; export the"),
    ("a\tb\tc\td\n", {}, "1: the columns are separated by tabs, expected commas"),
    ("a b c d\n", {}, "1: the columns are separated by spaces, expected commas"),
    (
        "0.1,1,2,3\n",
        {},
        "1: found numbers, expected a header row; give `robot`, whose motion shows the columns; or begin",
    ),
    (b"\xff\xfea", {}, NO_TEXT),
    ("q1,x,y,z\n".encode("utf-16-le"), {}, NO_TEXT),
    ((HOSTILE + BESIDE).encode("utf-16")[:-1], {}, NO_TEXT),
    (HOSTILE + "1,2,3\0,1,2,3\n", {}, NO_TEXT),
    ('"q1,x,y,z\n', {}, "1: the header row cannot be read (unexpected end of data); close every quote"),
    (",".join(f"c{i}" for i in range(100_000)), {}, "1: found 100000 columns; expected at most 2000"),
    (b"q1,x,y,z\n" + b"1" * (1 << 21), {}, "2: the line is longer than 1 MB; expected one line per pose"),
    (b"x,y,z,pose\n1,2,3,A\n1,2,3,M\x81ller\n", {}, "3: byte 8 of the line, 0x81, is not UTF-8; save the file as UTF"),
    (b"%PDF-1.7\n1,2,3\n", {}, "is a PDF document, expected a table of poses; export the poses as CSV"),
    (b"\x80\x04\x95\x1f\x00", {}, "is a pickle of Python, expected a table of poses; save its arrays with numpy.savez"),
    (b"\x89HDF\r\n\x1a\n", {}, "is an HDF5 file, expected a table of poses; save its arrays with numpy.savez"),
    (b"\x1f\x8b\x08\x001,2,3\n", {}, "is compressed by gzip, expected a table of poses; unpack it first"),
    ("\ufeff\n<!DOCTYPE HTML><html>", {}, "is an HTML page, expected a table of poses; export the poses as CSV"),
    ('{"q1": [1, 2]', {}, "cannot be read as JSON or YAML"),
    ("[[1, 2], [3, 4]]", {}, "has no list of records, expected a table of poses"),
    ('{"robot": "ur10e"}', {}, "has no list of records, expected a table of poses"),
    ("[" * 100_000, {}, "cannot be read as JSON or YAML"),
    ("header:\n  stamp:\n    sec: 1\n", {}, "has no list of records"),
    # A trajectory is known by its unit quaternions; alone it has no commands.
    ("1.5 1 2 3 0 0 0 1\n2.5 1 2 4 0 0.6 0 0.8\n", {}, "1: the file has measured poses only: neither joint variables"),
    ("1.5 1 2 3 0 0 0 2\n2.5 1 2 4 0 0.6 0 0.8\n", {}, "1: found numbers, expected a header row"),
    ("Index\tAz(deg)\tEl(deg)\tDist(mm)\n1\t10.5\t80.5\t2000.5\n", {}, "angles and distances of an instrument"),
]
HEADERS: list[Case] = [
    # In lower case a degree of German may be a gradian, 400 to the turn.
    ("A1;X;Y;Z\ngrad;mm;mm;mm\n90,0;1,5;2,5;3,5\n45,0;2,5;3,5;4,5\n", {}, "neither joint variables nor commanded"),
    ("q1,x,z", {}, "1: column y is missing; expected x, y, z: the attained position"),
    ("q1,X_mm,z", {}, "1: column y is missing; expected x, y, z: the attained position"),
    ("q1,Xa,z", {}, "1: columns x, y are missing; expected x, y, z: the attained position (unknown in this file: Xa)"),
    ("x,y,z", {}, f"1: {ONLY_MEASURED}q1 … qN (joint variables) or cmd_x,"),
    ("pose,x,y,z\n", {"robot": ARM}, f"{ONLY_MEASURED}q1 … q2 (joint variables)"),
    ("pose,K1,x,y,z\na,1,2,3,4\n", {"robot": KnownRobot(["shoulder"])}, "(unknown in this file: K1)"),
    ("q1,q3,x,y,z", {}, "1: column q2 is missing; expected q1 … q3 without a gap"),
    ("q1,x,y,z,cmd_x,cmd_z", {}, "1: column cmd_y is missing; expected cmd_x, cmd_y, cmd_z: the commanded position"),
    ("q1,x,y,z,cmd_qw,cmd_qx,cmd_qy,cmd_qz", {}, "1: columns cmd_x, cmd_y, cmd_z are missing"),
    ("q1,x,y,z,qw,qx,qz", {}, "1: column qy is missing; expected qw, qx, qy, qz: the attained orientation"),
    ("q1,x,y,z,ry", {}, "1: columns rx, rz are missing; expected rx, ry, rz: the attained orientation"),
    ("q1,x,y,z,roll,yaw", {}, "1: column pitch is missing; expected roll, pitch, yaw: the attained orientation"),
    ("q1,x,y,z,rx,ry,rz,roll,pitch,yaw", {}, "1: the attained orientation is given more than once: rx, ry, rz and"),
    ("q1,x,y,z,sigma_x,sigma_y", {}, "1: column sigma_z is missing; expected sigma_x, sigma_y, sigma_z: the measuring"),
    ("q1,x,y,z,y", {}, "1, y: the column is a duplicate; keep one of them"),
    ("q1,x,y,z,y_mm", {}, "1, y_mm: the column is a duplicate of y; keep one of them"),
    ("q1,x,y,z,note,note", {}, "1, 'note': the column is a duplicate; keep one of them"),
    ("q1,x_deg,y,z", {}, "1, x_deg: found unit deg in the name, expected a length (m, mm, um)"),
    ("q1,x,y,z,roll_mm,pitch,yaw", {}, "1, roll_mm: found unit mm in the name, expected an angle (rad, mrad, deg)"),
    ("q1,x,y,z,qw_m,qx,qy,qz", {}, "1, qw_m: found unit m in the name, expected no unit"),
    ("q1,x,y,z,dir_q3", {}, "1, dir_q3: the column belongs to joint 3, but the last joint column is q1"),
    ("q1,q2,q3,x,y,z\n", {"robot": ARM}, "1, q3: the column belongs to joint 3, but the robot has 2 joints"),
    (
        "base_mm,lift,x,y,z\n",
        {"robot": ARM},
        "1, base_mm: found unit mm in the name, expected an angle (rad, mrad, deg)",
    ),
    ("base,lift_deg,x,y,z\n", {"robot": ARM}, "1, lift_deg: found unit deg in the name, expected a length (m, mm, um)"),
    (
        "q1,x,y,z\n",
        {"robot": ARM},
        "1: the robot has 2 joints, the file has columns for 1: column q2 is missing; expected q1 … q2 without a gap, "
        "or the joints' names base, lift",
    ),
    # The file's q1 may be another joint: its values are not held against limits.
    ("q1,x,y,z\n2,1,2,3\n", {"robot": KnownRobot("ab", limits=[(-1, 1), (0, 1)])}, "column q2 is missing"),
    (
        "x,y,z,q1,q2,q3,q4\n1,2,3,1,0,0,0\n",
        {"robot": KnownRobot([f"j{i}" for i in range(6)])},
        "if q1 … q4 are a quaternion, as ABB writes it, name them qw, qx, qy, qz or use `columns`",
    ),
    (
        one_row(),
        {"robot": KnownRobot(target_names=("smr1", "smr3"))},
        "1: column target is missing: the robot file has 2 targets (smr1, smr3); add it with the measured target of",
    ),
    (
        "A1;A2;X;Y;Z\n1;2;1000;0;500\n3;-2;900;100;700\n",
        {},
        "1, A1, A2, X, Y, Z: these columns state no unit (lengths up to 1000, joint variables up to 3); "
        "give `units`, for example mm,deg or m,rad, or write the units into the names, as in q1_deg",
    ),
    (
        "J1 [deg];X [mm];X act [mm];Y [mm];Z [mm]\n1;2;3;4;5\n1;2;3;4;6\n",
        {},
        "found several columns for x: 'X [mm]' or 'X act [mm]'; choose with `columns`",
    ),
    ("Point,J1 [kg],X [mm],Y [mm],Z [mm]\nP1,20,5,1,2\nP2,30,4,2,2\n", {}, "expected a unit of angle"),
    ("Point,J1 [deg],X [deg],Y [mm],Z [mm]\nP1,20,5,1,2\nP2,30,4,2,2\n", {}, "expected a unit of length"),
    (UX, {"coverage": 2}, "1, Ux, Uy, Uz: these columns state no unit, and 30 mm is not a usual measuring uncertainty"),
    (
        "Time;J1 [deg];X [m];Y [m];Z [m]\n03/04/2026 10:00:00;1;2;3;4\n04/04/2026 10:00:00;1;2;3;5\n",
        {},
        "in which either number may be the day",
    ),
    (
        f"X [m],Y [m],Z [m],Rx [deg],Ry [deg],Rz [deg],{COMMANDED[:17]}\n0,0,0,1,2,3,0,0,0\n0,0,1,2,3,4,0,0,1\n",
        {},
        "these may be angles of several conventions; give `angles=rotvec` (Universal Robots) or `angles=fixed-xyz`",
    ),
    ("\n".join((LINES[0], *LINES[1:3], *LINES[1:])), {}, "point 'P1' has no row for Z"),
    ("\n".join((*LINES, LINES[2])), {}, "point 'P1' has no row for X and Z"),
    (
        "\n".join(LINES).replace(",X,", ",T,").replace(",Y,", ",T,").replace(",Z,", ",T,"),
        {},
        "found 'T', expected rows",
    ),
    ("Point,Axis,Value 1,Value 2\nP1,X,1,2\nP1,Y,1,2\nP1,Z,1,2\n", {}, "columns x, y, z are missing"),
    ("J1 [deg],Point,Axis,Value [mm]\n1,P,X,2\n2,P,Y,2\n2,P,Z,2\n", {}, "have different values"),
    (
        WIDE_WRONG,
        {},
        "each row holds the points 1, 2: for several targets at one pose, fit tool_frame, which finds their places",
    ),
]
VALUES: list[Case] = [
    (one_row(y=""), {}, f"2, y: the value is missing, expected a number; {SKIP}"),
    (one_row(q1="abc"), {}, "2, q1: found 'abc', expected a number"),
    (one_row(q1="a" * 99), {}, f"2, q1: found '{'a' * 39}…', expected a number"),
    (one_row(z="nan"), {}, f"2, z: found 'nan', expected a finite number; {SKIP}"),
    (one_row(z="-inf"), {}, f"2, z: found '-inf', expected a finite number; {SKIP}"),
    (one_row(z='"1,5"'), {}, "2, z: found '1,5', expected a number; write decimals with a point, not a comma"),
    (one_row(pose=" "), {}, "2, pose: the value is missing, expected text"),
    (one_row(pose="p" * 300), {}, "2, pose: the text has 300 characters, expected at most 256"),
    (one_row(qw=0.9, qx=0, qy=0, qz=0), {}, "2, qw, qx, qy, qz: found a quaternion of length 0.9, expected 1 within 0"),
    (
        one_row(**dict.fromkeys(COMMANDED.split(","), 1)),
        {},
        "2, cmd_qw, cmd_qx, cmd_qy, cmd_qz: found a quaternion of length 2, expected 1",
    ),
    (one_row(dir_q1=0.5), {}, "2, dir_q1: found 0.5, expected -1, 0 or 1"),
    (one_row(speed_q1=-1.01), {}, "2, speed_q1: found -1.01, expected a fraction of full speed, -1 to 1"),
    (one_row(sigma_x_mm=0, sigma_y=1e-5, sigma_z=1e-5), {}, "2, sigma_x_mm: found 0 mm, expected a standard deviation"),
    (one_row(sigma_x=5e-324, sigma_y=1e-5, sigma_z=1e-5), {}, "2, sigma_x: found 4.940656458e-324, expected at least"),
    (one_row(sigma_r=-1e-5), {}, "2, sigma_r: found -1e-05, expected a standard deviation above 0"),
    (one_row(payload_kg=-1), {}, "2, payload_kg: found -1, expected 0 kg or more"),
    (one_row(temperature_c=-300), {}, "2, temperature_c: found -300, expected -273.15 degrees Celsius or more"),
    (one_row(z="9" * 400), {}, "2, z: found '9999"),
    (one_row(z=1e308), {"units_check": False}, "2, z: found 1e+308, expected at most 1e+08"),
    (one_row(rx_deg=1e300, ry_deg=0, rz_deg=0), {}, "2, rx_deg: found 1e+300 deg, expected at most"),
    (one_row(time_s=-1e200), {}, "2, time_s: found -1e+200, expected at most 1e+12"),
    *((HOSTILE + BESIDE + f"1,2,{cell},1,2,3\n", {}, "3, z: ") for cell in ("NaN", "-nan", "-Infinity", "1e400")),
    *((HOSTILE + BESIDE + f"1,2,{cell},1,2,3\n", {}, "3, z: ") for cell in ("#N/A", "1_0", "0x1", "true", "١", "1 2")),
    (
        "q1,x,y,z\n9.2,1,2,3\n".replace("q1", "q1_rad"),
        {"robot": KnownRobot(limits=[(-math.pi / 2, math.pi / 2)])},
        "2, q1_rad: found 9.2 rad, expected a value within the limits of q1",
    ),
    (
        "q1_deg,x,y,z\n10,1,2,3\n95.5,1,2,3\n",
        {"robot": KnownRobot(limits=[(-math.pi / 2, math.pi / 2)])},
        f"3, q1_deg: found 95.5 deg, expected a value within the limits of q1, -90 to 90 deg; {IGNORE}",
    ),
    (
        "q1,q2,x,y,z\n0.2,0.6,1,2,3\n",
        {"robot": KnownRobot(limits=[None, (0, 0.5)])},
        f"2, q2: found 0.6, expected a value within the limits of q2, 0 to 0.5; {IGNORE}",
    ),
    ("q1_deg,x,y,z\n90.0501,0,0,1\n", {"robot": KnownRobot(limits=[(-math.pi / 2, math.pi / 2)])}, IGNORE),
    ("q1,x,y,z\n0.3006,0,0,1\n", {"robot": KnownRobot(["rail"], ["prismatic"], [(0, 0.3)])}, "2, q1: found 0.3006"),
    (
        "q1_rad,x,y,z\n60,1,2,3\n1,2,2,3\n",
        {"robot": KnownRobot(limits=[(-math.pi / 2, math.pi / 2)])},
        "if the joints are in degrees, name the columns as in q1_deg, or give `units` with deg; else",
    ),
    (
        TARGETS,
        {"robot": KnownRobot(target_names=("smr1", "smr3"))},
        "3, target: found 'smr3x', expected a target of the robot file (smr1, smr3); the nearest is smr3",
    ),
    # A robot with one tool: which of several targets it describes, nobody says.
    (
        TARGETS + "0,1,2,3,smr1\n",
        {"robot": KnownRobot(target_names=())},
        "3, target: found several targets ('smr1', 'smr3x'), but the robot has one tool and no targets; fit "
        "tool_frame, which finds their places (`align` of estimate, `fit` of calibrate; a trace does), list "
        "each target under targets: in the robot file instead of tool, or keep the rows of one target",
    ),
    (
        VISITS.format("0.5"),
        {},
        "4, visit: visit '1' has another command than on line 2; a visit is one arrival of the arm, so number each "
        "arrival differently",
    ),
    (VISITS.format("0"), {"ordered": True}, "4, visit: visit '1' continues after another visit began, although rows"),
    ((HOSTILE + BESIDE.replace("1,", "one,", 1)).replace(",", ";"), {}, "2, x: found 'one', expected a number"),
    (DEGREES_AND_MM.format('"1,903"'), {}, "2, X [mm]: found '1,903', expected a number; the comma may separate"),
    (DEGREES_AND_MM.format('"1,9035"'), {}, "write decimals with a point, not a comma"),
    (DEGREES_AND_MM.format('"1.903,540"'), {}, "export numbers without a separator of thousands"),
    (DEGREES_AND_MM.format("1 903"), {}, "export numbers without a separator of thousands"),
    # As a decimal point 1.043 would be 1 mm, as a separator of thousands 1043 mm.
    (COMMAS.format("1.043"), {}, "2, X [mm]: found '1.043', expected a number; export numbers without a separator of"),
    (COMMAS.format("100,5 mm"), {}, "without the unit mm; export every cell with its unit, or none"),
    (POINT_NAMES + WRONG_CELLS + "P3,1°,2°,0.001 m,2 mm,3 mm\n", {}, "found '0.001 m', but the first cell is in mm"),
    (POINT_NAMES + WRONG_CELLS + "P3,1°,2°,1.5,2 mm,3 mm\n", {}, "found '1.5' without the unit mm"),
    (POINT_NAMES + WRONG_CELLS + "P3,1°,2°,1.5 mm 2,2 mm,3 mm\n", {}, "expected a number"),
    ("pose,q1,q2,x,y,z\n" + WRONG_CELLS + "P3,1°,2°,1 mm,2 mm,3 mm,\n", {}, "3: found 7 fields"),
    ("pose,q1,q2,x_m,y_mm,z_mm\n" + WRONG_CELLS, {}, "the cells are in mm, but the name is of m"),
    ("Point,J1,J2,X,Y [m],Z\n" + WRONG_CELLS, {}, "the cells are in mm, but the name is of m"),
    ("pose,q1,q2,x,y,z\n" + WRONG_CELLS.replace("381.289 mm", "381 kg"), {}, "the cells are in kg, expected a length"),
    (POINT_NAMES + WRONG_CELLS.replace("381.289 mm", "381 kg"), {}, "found unit kg for x, expected a unit of length"),
    (
        POINT_NAMES + WRONG_CELLS,
        {"columns": {"Point": "pose", "J1": "q1", "J2": "q2", "X": "x_m", "Y": "y", "Z": "z"}},
        "the cells are in mm, but the name is of m",
    ),
]
SEVERAL: list[Case] = [
    (WIDE_WRONG, {"robot": KnownRobot(["j1", "j2"], target_names=("a3", "b4"))}, "each row holds the points 1, 2"),
    (WIDE_WRONG.replace("X2 [mm]", "X2 [m]"), {"robot": TWO}, "each row holds the points 1, 2"),
    (WIDE_WRONG.replace(",Z2 [mm]", "").replace(",50,400", ",50"), {"robot": TWO}, "but point 2 has no Z"),
    (
        COMMAS.format("1,5") + COMMAS[:35],
        {},
        "4, J1 [°]: found 'J1 [°]', expected a number; delete the repeated header",
    ),
    ("pose,q1,q2,x,y,payload_kg\n" + WRONG_CELLS, {"attained": False}, "the cells are in mm, but the name is of kg"),
    ("pose,q1,x,y,z\na,1,2,3,4\nb,2,3,4,5\n[Planes]\nc,1,2\n", {}, "4: found 1 field, expected 5 as in the header; if"),
]
"""Texts with more than one problem."""


@pytest.mark.parametrize(
    ("text", "options", "part"), [*NO_TABLES, *HEADERS, *VALUES, *SEVERAL], ids=lambda value: str(value)[:40]
)
def test_a_text_has_one_problem_that_is_named(
    read: Reader, text: str | bytes, options: dict[str, Any], part: str
) -> None:
    problems = problem_texts(read, text, **options)
    assert any(problem.startswith(part) if part[0].isdecimal() else part in problem for problem in problems)
    assert (len(problems) > 1) == ((text, options, part) in SEVERAL)


BAD_ROWS = {
    "1,2,3": "2: found 3 fields, expected 4 as in the header",
    "1,2,3,4,": "2: found 5 fields, expected 4 as in the header",
    "1,0,2,0,3,0,4,0": "2: found 8 fields, expected 4 as in the header; write decimals with a point, not a comma",
    '1,2,3,"4': "2: the row cannot be read (unexpected end of data); close every quote on its line",
}


@pytest.mark.parametrize("row", BAD_ROWS)
@pytest.mark.parametrize("header", ["q1,x,y,z", "note,x,y,z", "pose,x,y,z"])
def test_rows_that_do_not_fit_the_header(read: Reader, row: str, header: str) -> None:
    problem = [text for text in problem_texts(read, f"{header}\n{row}\n") if text.startswith("2")]
    assert problem == [BAD_ROWS[row]]


def test_many_problems_are_in_the_order_of_lines_and_counted(read: Reader) -> None:
    text = "q1,x,y,z,note, with a comma\n" + "0,1,2,3,a\n" * 50
    assert problem_texts(read, text) == [
        "2: found 5 fields here and in the 49 rows below, expected 6 as in the header; "
        "give each column one name, with the same separator as in the rows"
    ]
    assert len(problem_texts(read, text + "0,1,2,3,a,b\n")) == 20  # a row fits: the others are named
    header = "q1,x,y,z,qw,qx,qy,qz,x,dir_q1,pose"
    rows = ["0,1,2,3,1,0,0,0,1,0,A", "0,1,2,3,2,0,0,0,1,5,B", "0,one,2,,1,0,0,0,1,0,C", "9,1", "0,1,2,3,1,0,0,0,1,7,D"]
    problems = problem_texts(read, "\n".join([header, *rows]))
    assert [text.partition(" ")[0] for text in problems] == ["1,", "3,", "3,", "4,", "4,", "5:", "6,"]
    for cell in ("word", "9e9"):
        with pytest.raises(InputError) as caught:
            read("q1,x,y,z,speed_q1\n" + f"0,1,2,3,{cell}\n" * 3000)
        assert caught.value.total == 3000
        assert [problem.line for problem in caught.value.problems] == list(range(2, 2 + MAX_PROBLEMS))
        assert str(caught.value).endswith("… and 2980 more problems")


def test_a_long_line_deep_in_a_file(read: Reader) -> None:
    rows = [b"%d,1,2,3" % (i % 7) for i in range(100_000)]
    rows[50_000] = b"1" * ((1 << 20) + 1) + b",1,2,3"
    assert problem_texts(read, b"\n".join([b"q1,x_m,y_m,z_m", *rows])) == [
        "50002: the line is longer than 1 MB; expected one line per pose"
    ]
    rows[50_000] = b"1.0" + b"0" * ((1 << 20) - 20) + b",1,2,3"
    assert read(b"\n".join([b"q1,x_m,y_m,z_m", *rows])).n == 100_000


def test_files_that_cannot_be_opened_and_statements_that_are_wrong(tmp_path: Path) -> None:
    for path, reason in (
        (tmp_path / "none.csv", "the file does not exist"),
        (tmp_path, "is a folder, expected a file; name a file, or a folder that has photos"),
        (Path(os.devnull), "the file is empty"),
    ):
        with pytest.raises(InputError, match=rf"{path.name}: {reason}"):
            read_poses(path)
    for bad in ({"units": "mm,m"}, {"units": "furlong"}, {"angles": "euler"}, {"coverage": 0.0}):
        with pytest.raises(UsageError):
            Reading(**bad)  # type: ignore[arg-type]


# Hostile files of poses: each ends in a message, bounded in time and memory, and nothing acts on the terminal.

HEAD = "x,y,z,cmd_x,cmd_y,cmd_z\n"
ROW = "1,2,3,1,2,3.001\n"
MEMORY = 2 * 2**30
"""Bytes of address space: the libraries take some 0.5 GB of it, and the files here pretend to be 10 GB."""


def estimate(*arguments: str, text: bytes = b"") -> subprocess.CompletedProcess[str]:
    """``robacc estimate`` as a process that may neither fill the memory nor take long."""
    code = (
        f"import resource; resource.setrlimit(resource.RLIMIT_AS, ({MEMORY}, {MEMORY}));"
        "from robacc.__main__ import main; main()"
    )
    done = subprocess.run(
        (sys.executable, "-c", code, "estimate", *arguments), input=text, capture_output=True, timeout=60, check=False
    )
    return subprocess.CompletedProcess(done.args, done.returncode, done.stdout.decode(), done.stderr.decode())


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_ends_of_lines_and_denormal_numbers_are_taken(tmp_path: Path, end: str) -> None:
    path = saved(tmp_path / "poses.csv", (HEAD + "5e-324,2,3,0,2,3\n" + ROW).replace("\n", end).encode())
    assert read_poses(path).position[0].tolist() == [5e-324, 1.0]


@pytest.mark.slow
def test_a_file_of_ten_gigabytes_and_streams_without_an_end(tmp_path: Path) -> None:
    sparse = tmp_path / "sparse.csv"
    with sparse.open("wb") as stream:
        stream.truncate(10 * 2**30)
    for path in (str(sparse), "/dev/zero"):
        done = estimate(path)
        assert (done.returncode, done.stdout) == (3, "")
        assert f"error: {path}:1: the line is longer than 1 MB" in done.stderr


def test_a_pipe_is_read_once(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe.csv"
    os.mkfifo(pipe)
    writer = threading.Thread(target=lambda: pipe.write_text(HEAD + ROW))
    writer.start()
    assert read_poses(pipe).n == 1
    writer.join()


def test_names_cannot_act_on_the_terminal() -> None:
    """Neither a column's nor a pose's; a terminal would take the escape for "clear the screen"."""
    text = f"pose,\x1b[2Jcolumn\u202e,{HEAD}\x1b[31mred\x07\u202e,1,{ROW}b,1,{ROW}"
    done = run("estimate", "-", text=text)
    assert done.exit_code == 0
    output = done.stdout + done.stderr
    assert "\\x1b[31mred\\x07\\u202e" in done.stdout
    assert "\\x1b[2Jcolumn\\u202e" in done.stderr
    assert all(sign.isprintable() or sign == "\n" for sign in output)
    done = run("estimate", "-", "--format", "json", text=text)
    assert all(sign.isprintable() or sign == "\n" for sign in done.stdout)
    done = run("estimate", "no\x1b[2J.csv")
    assert done.stderr.startswith("error: no\\x1b[2J.csv")
