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


Form = Callable[[Campaign], dict[str, str]]
POSITIONS: tuple[Form, ...] = (
    *(polyworks, cam2_and_kuka, kuka_points_alone, rtde_and_leica, fanuc_in_inches, robodk, laboratory),
    *(spatial_analyzer_and_rapid, yaml_records, json_columns, trials),
)
POSES: tuple[Form, ...] = (
    *(vicon, counted_quaternion, json_lines, json_records, bare_matrices),
    *(hand_eye_matrices, hand_eye_transforms, trajectories),
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
    robot = [] if form in WITHOUT_ROBOT else ["--robot", ROBOT]
    found = figures([*written(form(campaign), tmp_path), *robot])
    assert expected["position"]["rms_m"] < 1e-4
    for key in ("rms_m", "p95_m", "max_m"):
        assert found["position"][key] == pytest.approx(expected["position"][key], rel=2e-3)
    if form in POSES:
        assert found["orientation"]["rms_rad"] == pytest.approx(expected["orientation"]["rms_rad"], rel=2e-3)


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
