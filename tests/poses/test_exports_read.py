"""Texts of exports that are read: what each column is taken for, and what is said of it."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from pose_files import PLAIN, Reader, one_row

from robacc.io.dialect import split_cell
from robacc.poses.columns import heading_of, meaning_of
from robacc.poses.reading import KnownRobot

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
    **dict.fromkeys(("dX", "X deviation", "velocity x", "Comment", "E1"), (None, None)),
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
        [":2: q1_deg exceeds the joint's limits -90 to 90 deg by at most 0.0499 deg in 1 row, which is used"],
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
