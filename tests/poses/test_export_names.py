"""Names of columns in exports: what each is taken for, what is asked, and what stays as documented."""

from __future__ import annotations

import numpy as np
import pytest
from pose_files import Reader, problem_texts

from robacc.errors import UsageError
from robacc.poses.columns import heading_of, meaning_of
from robacc.poses.reading import KnownRobot, Reading

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
    "dX": (None, None),
    "X deviation": (None, None),
    "velocity x": (None, None),
    "Comment": (None, None),
    "E1": (None, None),
}


@pytest.mark.parametrize("name", NAMES)
def test_a_name_has_the_meaning_of_its_words(name: str) -> None:
    heading = heading_of(name)
    meaning = meaning_of(heading, ABC | {heading.text})
    key, unit = NAMES[name]
    assert (None if meaning is None else meaning.key) == key
    if key is not None:
        assert heading.unit == unit


def test_single_letters_mean_angles_only_together() -> None:
    assert meaning_of(heading_of("B"), frozenset({"b"})) is None


def test_documented_files_are_read_as_documented(read: Reader) -> None:
    """Names that would mean something in an export stay unknown in a file that needs none of them."""
    data = read("q1,x,y,z,Name,Rx,Ry,Rz,temp\n0.1,1,2,3,a,1,2,3,20\n")
    assert data.pose is None
    assert data.rotation is None
    assert data.temperature is None
    assert len(data.warnings) == 5


def test_units_are_asked_for(read: Reader) -> None:
    text = "A1;A2;X;Y;Z\n1;2;1000;0;500\n3;-2;900;100;700\n"
    (problem,) = problem_texts(read, text)
    assert problem == (
        "1, A1, A2, X, Y, Z: these columns state no unit (lengths up to 1000, joint variables up to 3); "
        "give `units`, for example mm,deg or m,rad, or write the units into the names, as in q1_deg"
    )


def test_two_columns_for_the_same_are_asked_for(read: Reader) -> None:
    (problem,) = problem_texts(read, "J1 [deg];X [mm];X act [mm];Y [mm];Z [mm]\n1;2;3;4;5\n1;2;3;4;6\n")
    assert "found several columns for x: 'X [mm]' or 'X act [mm]'; choose with `columns`" in problem


def test_uncertainties_of_an_unknown_coverage_are_not_used(read: Reader) -> None:
    text = "J1 [deg];X [mm];Y [mm];Z [mm];Ux [mm];Uy [mm];Uz [mm]\n1;2;3;4;0.1;0.1;0.1\n"
    data = read(text)
    assert data.sigma_position is None
    warnings = "\n".join(data.warnings)
    assert "not used: 'Ux [mm]', 'Uy [mm]', 'Uz [mm]'" in warnings
    assert "to use the uncertainties Ux [mm], Uy [mm], Uz [mm], give `coverage`: 1 for a standard" in warnings


def test_joints_counted_from_zero(read: Reader) -> None:
    data = read("joint_0 [deg];joint_1 [deg];X [m];Y [m];Z [m]\n1;2;3;4;5\n")
    np.testing.assert_allclose(np.degrees(data.q[:, 0]), [1, 2])


@pytest.mark.parametrize(
    ("column", "entries", "seconds"),
    [
        ("Time", ("2026-11-22T10:00:00.5Z", "2026-11-22 10:00:01"), (36000.5, 36001.0)),
        ("Timestamp", ("22.11.2026 10:00:00,25", "23.11.2026 00:00:01"), (36000.25, 86401.0)),
        ("Zeit", ("23:59:59", "00:00:01"), (86399.0, 86401.0)),
        ("Time", ("11/22/2026 1:00:00 PM", "11/22/2026 1:00:01 PM"), (46800.0, 46801.0)),
        ("time [ms]", ("1500", "2500"), (1.5, 2.5)),
        ("timestamp", ("1795341600.5", "1795341601.5"), (36000.5, 36001.5)),
        ("stamp", ("1795341600500000000", "1795341601500000000"), (36000.5, 36001.5)),
    ],
)
def test_times(read: Reader, column: str, entries: tuple[str, str], seconds: tuple[float, float]) -> None:
    rows = "".join(f"{entry};1;2;3;{i}\n" for i, entry in enumerate(entries))
    data = read(f"{column};J1 [deg];X [m];Y [m];Z [m]\n{rows}")
    # Nanoseconds since 1970 have 19 digits, of which a float keeps 16.
    np.testing.assert_allclose(data.time, seconds, rtol=0, atol=1e-6)


def test_day_and_month_that_may_be_exchanged_are_refused(read: Reader) -> None:
    rows = "03/04/2026 10:00:00;1;2;3;4\n04/04/2026 10:00:00;1;2;3;5\n"
    (problem,) = problem_texts(read, f"Time;J1 [deg];X [m];Y [m];Z [m]\n{rows}")
    assert "in which either number may be the day" in problem


def test_statements_that_are_wrong() -> None:
    for bad in ({"units": "mm,m"}, {"units": "furlong"}, {"angles": "euler"}, {"coverage": 0.0}):
        with pytest.raises(UsageError):
            Reading(**bad)  # type: ignore[arg-type]


def test_names_that_resemble_documented_ones_get_a_question(read: Reader) -> None:
    data = read("J1 [deg];X [m];Y [m];Z [m];temperature_f;Operator\n1;2;3;4;5;6\n")
    (warning,) = [text for text in data.warnings if "not used" in text]
    assert warning.endswith("not used: 'temperature_f' (did you mean temperature_c?), 'Operator'")


def test_four_q_columns_may_be_a_quaternion(read: Reader) -> None:
    (problem,) = problem_texts(
        read, "x,y,z,q1,q2,q3,q4\n1,2,3,1,0,0,0\n", robot=KnownRobot(joint_names=[f"j{i}" for i in range(6)])
    )
    assert "if q1 … q4 are a quaternion, as ABB writes it, name them qw, qx, qy, qz or use `columns`" in problem


@pytest.mark.parametrize("name", ["time", "timestamp", "t"])
def test_a_time_beside_documented_names_is_one(read: Reader, name: str) -> None:
    data = read(f"q1,x,y,z,{name}\n0,1,2,3,12.5\n0.1,1,2,4,13\n")
    assert data.time.tolist() == [12.5, 13.0]
    assert data.warnings == ()
