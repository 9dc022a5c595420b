"""`robacc predict`, `plan` and `iso9283` from files to tables, JSON, CSV and exit statuses."""

import csv
import io
import json
from pathlib import Path

import commands
import numpy as np
import pytest
from commands import missing, one_line, output, refused, run
from sample_files import ROBOT as PLANNED_ROBOT, SAMPLES, SCARA, saved

from robacc.poses.csv_file import read_poses

# ``robacc predict`` as a process: exit statuses, standard output, the contract's keys, files.

PUMA = "configs/robots/puma560.yaml"

_, _, predicted, refused_predict = commands.calls_of("predict")

TOLERANCES = "units: {length: mm, angle: deg}\nall: {theta: 0.02, d: 0.2, a: 0.2, alpha: 0.01}\n"


@pytest.fixture
def tolerances(tmp_path: Path) -> Path:
    return saved(tmp_path / "tolerances.yaml", TOLERANCES)


def test_a_robot_without_tolerances_is_bad_input() -> None:
    told = "no parameter of sample arm has a tolerance, so no error can be predicted"
    shown = refused_predict("sample_data/robot.yaml", status=3)
    assert missing(shown, told, "tip: give a tolerance file with --tolerances") == []


def test_per_pose_file(tmp_path: Path) -> None:
    target = tmp_path / "poses.csv"
    found = predicted(PUMA, "--samples", "7", "--per-pose", str(target))
    rows = list(csv.DictReader(io.StringIO(target.read_text())))
    assert [row["pose"] for row in rows] == [f"sample {k}" for k in range(1, 8)]
    v_xz, j1, rms = ([float(row[name]) for row in rows] for name in ("v_xz_m2", "j1", "rms_rad"))
    assert v_xz == [covariance[0][2] for covariance in found["position"]["covariance_m2"]]
    worst = found["position"]["worst"]
    assert j1[worst["pose"]] == worst["q"][0]
    traces = np.trace(found["orientation"]["covariance_rad2"], axis1=1, axis2=2)
    np.testing.assert_allclose(rms, np.sqrt(traces))


def test_poses_of_a_file_and_another_scale(tmp_path: Path, tolerances: Path) -> None:
    scale = saved(
        tmp_path / "scale.yaml",
        "robacc: 1\nname: mine\nstatistic: rms\nconfidence: 0.95\nunits: {length: mm, angle: deg}\n"
        "steps: [{grade: fine, position: 5}]\notherwise: coarse\n",
    )
    poses = ("sample_data/robot.yaml", "--poses", "sample_data/poses.csv")
    found = predicted(*poses, "--scale", scale, "--tolerances", tolerances)
    assert (found["n_poses"], found["grade"]["grade"]) == (60, "fine")
    assert found["grade"]["share_of_poses_meeting"] == {"fine": 1.0}
    assert found["position"]["worst"]["label"].startswith("line ")


@pytest.mark.parametrize(
    ("arguments", "status", "message"),
    [
        (("--poses", "a.csv", "--samples", "5"), 2, "--poses and --samples both say where to predict; give only one"),
        (("--against", "a.csv", "--samples", "5"), 2, "--against predicts at the measured poses; leave out --samples"),
        (("--align", "base_frame"), 2, "--align applies to measured poses, so it needs --against"),
        (("--noise", "1mm"), 2, "--noise applies to measured poses, so it needs --against"),
        (("--poses", "a.csv", "--target", "t"), 2, "--target applies to sampled configurations"),
        (("--poses", "-", "--against", "-"), 2, "standard input can be read only once"),
        (("--allocate", "Z"), 2, "no grade 'Z' on the scale CAD/CAM 0.1 mm, 0.1 degree; it has A, B, C, D, E"),
        (("--against", "sample_data/poses.csv", "--noise", "0.02"), 2, "--noise: '0.02' has no unit; add a unit"),
        (("--against", "sample_data/poses.csv", "--noise", "1,2,3"), 2, "--noise: expected a length and perhaps an"),
        (("--tolerances", "nowhere.yaml"), 3, "nowhere.yaml: the file does not exist"),
    ],
)
def test_wrong_usage(arguments: tuple[str, ...], status: int, message: str) -> None:
    assert message in refused_predict(PUMA, *arguments, status=status)


# ``robacc plan`` from the command line: its files, its answers, and its messages.

_, plan, planned, refused_plan = commands.calls_of("plan")

SMALL = ("--candidates", "200")


def test_the_plan_is_a_file_that_simulate_and_calibrate_take(tmp_path: Path) -> None:
    path, check, program = tmp_path / "plan.csv", tmp_path / "validation.csv", tmp_path / "plan.src"
    options = ("--full", "--program", program, "--validation", 5, "--validation-output", check)
    assert "Predicted standard errors" in plan(PLANNED_ROBOT, "--poses", 14, *SMALL, "-o", path, *options)
    poses = read_poses(path, attained=False)
    assert np.unique(poses.groups()).size == 14
    assert poses.direction is not None
    assert (read_poses(check, attained=False).n, program.read_text().count("PTP {")) == (5, poses.n)
    measured = tmp_path / "measured.csv"
    output("simulate", PLANNED_ROBOT, "--at", path, "--noise", "0.02mm", "--position-only", "-o", measured)
    read = read_poses(measured)
    np.testing.assert_array_equal(read.q, poses.q)
    # Derived from the order by the simulation, stated by the plan: the same motion.
    np.testing.assert_array_equal(read.direction, poses.direction)


def test_json_and_csv_agree(tmp_path: Path) -> None:
    path, words = tmp_path / "plan.csv", (PLANNED_ROBOT, "--poses", 12, *SMALL, "--min-height", "100mm")
    found = planned(*words, "-o", path)
    assert found["schema"] == "robacc.plan/1"
    np.testing.assert_allclose(np.array(found["visits"]["q"]).T, read_poses(path, attained=False).q)
    assert min(position[2] for position in found["visits"]["target_in_base_m"]) >= 0.1
    assert found["accuracy"]["planned"]["rms_m"] < found["accuracy"]["planned"]["random_rms_m"]
    assert plan(*words, "-o", "-") == path.read_text()
    summary = plan(*words).splitlines()
    assert len(summary) <= 25
    assert summary[0] == "Plan for the calibration of sample arm: 12 poses, 15 visits"
    counted = "15 visits: each of the 12 poses once, 1 of them a second time, one of them 2 more times to show drift"
    ahead = "next: write the poses (--output PLAN), measure them in the order of PLAN, add the columns x, y, z"
    assert missing(one_line(" ".join(summary)), counted, ahead) == []


def test_enough_or_the_next_ten(tmp_path: Path) -> None:
    measured = (PLANNED_ROBOT, *SMALL, "--already", SAMPLES / "poses.csv", "-o", tmp_path / "next.csv")
    fit = ("--fit", "base_frame,joint_offset")
    assert "Enough" in plan(*measured, *fit)
    strict = plan(*measured, *fit, "--target-error", "1um", "--full")
    told = ("Not enough: measure the next 10", "rows measured already: fit them together with the new rows")
    assert (missing(one_line(strict), *told), strict.count("more poses  ")) == ([], 1)
    assert read_poses(tmp_path / "next.csv", attained=False).n == 10


def test_acceptance_plans_for_a_gate(tmp_path: Path) -> None:
    gate = saved(
        tmp_path / "gate.yaml",
        "robacc_gate: 1\nname: cell\ncriteria:\n  - {key: position.p95, limit: 1mm, name: tool, reason: drawing}\n",
    )
    words = (PLANNED_ROBOT, "--for", "acceptance", "--gate", gate, *SMALL, "--expected")
    assert "59 poses" in plan(*words, "0.5mm", "-o", tmp_path / "a").splitlines()[0]
    assert f"robacc estimate PLAN --robot {PLANNED_ROBOT} --gate gate.yaml" in one_line(plan(*words, "0.5mm"))
    assert "no number of poses" in refused_plan(*words, "0.99mm")
    assert "true value of 0 % of the limit" in plan(*words, "0mm", "--full")


def test_criteria_without_a_number_of_poses_are_named(tmp_path: Path) -> None:
    criteria = (
        "{key: grade, limit: E, reason: a}",
        "{key: position.rms, limit: 0 mm, reason: a}",
        "{key: position.p95, at_least: 1 mm, reason: a}",
        "{key: position.max, limit: 1 mm, baseline: old.json, reason: a}",
        "{key: orientation.rms, limit: 1 deg, reason: a}",
    )
    saved(
        tmp_path / "old.json", output("estimate", SAMPLES / "poses.csv", "--robot", PLANNED_ROBOT, "--format", "json")
    )
    gate = saved(tmp_path / "gate.yaml", "robacc_gate: 1\nname: a\ncriteria:\n  - " + "\n  - ".join(criteria) + "\n")
    ended = run("plan", PLANNED_ROBOT, "--for", "acceptance", "--gate", gate, *SMALL, "--expected", "1mm", "--full")
    assert ended.stdout.count("planned for ") == ended.stdout.count("planned for grade E: ") == 1
    others = "position.rms, position.p95, position.max, orientation.rms"
    assert f"the number of poses does not count {others} of the gate" in one_line(ended.stderr)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--inside", "x=9:10"), "no pose is feasible: of 8000 poses, 8000 are excluded by: target outside the box"),
        (("--inside", "x=2:1"), "--inside: x ends before it begins"),
        (("--reflector", "0,0,1"), "--reflector and --distance need --instrument"),
        (("--noise", "0.02"), "--noise: '0.02' has no unit"),
        (("--poses", "300"), "300 poses are planned, but only 200 candidates are feasible"),
        (("--fit", "magic"), "no effect 'magic'"),
        (("--gate", "none.yaml"), "none.yaml"),
        (("--program", "plan.xyz"), "--program: expected a file name that ends in .src, .ls, .mod, .script"),
        (("--validation", "5"), "--validation N and --validation-output FILE belong together"),
        (("--grade", "D"), "set the number of acceptance poses"),
    ],
)
def test_messages(arguments: tuple[str, ...], message: str) -> None:
    status = 3 if "none.yaml" in arguments else 2
    assert message in refused_plan(PLANNED_ROBOT, *SMALL, *arguments, status=status)


def test_another_arm_is_no_model() -> None:
    assert "give the model of this robot" in refused_plan(PLANNED_ROBOT, *SMALL, "--model", SCARA)


# `robacc iso9283` and `robacc plan --for iso9283` from files to tables, JSON, CSV and exit statuses.

SAMPLE = SAMPLES / "iso9283"

POSES, ROBOT = SAMPLE / "poses.csv", SAMPLE / "robot.yaml"

judged = commands.calls_of("iso9283")[2]


def rows(path: Path) -> list[dict[str, str]]:
    lines = path.read_text(encoding="utf-8").splitlines()
    return list(csv.DictReader(line for line in lines if not line.startswith("#")))


def test_robot_and_alignment() -> None:
    """The robot commands the poses as the cmd_ columns do; a frame fitted to them takes part of AP away, RP stays."""
    call = (POSES, "--robot", ROBOT)
    given, robot, aligned = judged(POSES), judged(*call), judged(*call, "--align", "base_frame")
    accuracy, repeatability = (
        [one["iso9283"][key]["max_m"] for one in (given, robot, aligned)] for key in ("AP", "RP")
    )
    assert (robot["commanded"], accuracy[1]) == ("robot", pytest.approx(accuracy[0], rel=1e-6))
    assert aligned["unaligned"]["AP_max_m"] == pytest.approx([accuracy[0]], rel=1e-6)
    assert accuracy[2] < 0.7 * accuracy[0]
    assert repeatability[2] == repeatability[0]
    assert aligned["alignment"][0]["what"] == ["base_frame"]
    assert any("fitted to the same poses" in note for note in aligned["notes"])
    shown = output("iso9283", *call, "--align", "base_frame")
    told = ("registered: base_frame fitted, 6 parameters", "largest AP before registration: 0.137 mm")
    assert missing(shown, *told) == []


@pytest.mark.parametrize(
    ("key", "limit", "status", "outcome"),
    [
        ("RP", "1 mm", 0, "pass"),
        ("RP", "0.01 mm", 4, "fail"),
        ("vAP", "1 mm", 5, "not_evaluated"),
    ],
)
def test_gate(tmp_path: Path, key: str, limit: str, status: int, outcome: str) -> None:
    criterion = f"{{key: iso9283.{key}.max, limit: {limit}, reason: a test}}"
    gate = saved(tmp_path / "gate.yaml", f"robacc_gate: 1\nname: cell\ncriteria:\n  - {criterion}\n")
    result = run("iso9283", POSES, "--gate", gate, "--format", "json")
    assert result.exit_code == status
    if key == "RP":
        # Standard output is the document; the log of a job has the outcome all the same.
        assert result.stderr.startswith(f"Gate cell: {outcome.upper()} (1 {outcome})" if status else "")
        assert bool(result.stderr) == bool(status)
    criterion = json.loads(result.stdout)["gate"]["criteria"][0]
    assert criterion["outcome"] == outcome
    # What the data lack is not evaluated.
    assert outcome != "not_evaluated" or "approach directions are not known" in criterion["why"]


def test_positions_of_one_pose_without_a_command() -> None:
    table = output("iso9283", "-", text="pose,x_mm,y_mm,z_mm\nP1,0,0,0\nP1,0,0,0.1\nP1,0.1,0,0\n")
    assert missing(table, "1 commanded pose, 3 visits\nno commanded poses", "RP  pose repeatability") == []
    assert "no AP (pose accuracy): the commanded poses are not known" in one_line(table)
    assert len(table.splitlines()) <= 25


@pytest.mark.parametrize(
    ("arguments", "status", "message"),
    [
        (("iso9283", "-", "-"), 2, "standard input can be read only once"),
        (("iso9283", str(POSES), "--base-link", "x"), 2, "choose a chain of a URDF, so they need --robot"),
        (("iso9283", str(POSES), "--align", "backlash"), 2, "cannot align backlash"),
        (("iso9283", str(POSES), "--drift-windows", "1"), 2, "--drift-windows is at least 2, not 1"),
        (("iso9283", "nowhere.csv"), 3, "nowhere.csv"),
        (("plan", "--for", "iso9283", str(SCARA)), 3, "found no cube of 250 mm or more"),
        (("plan", "--for", "iso9283", str(SCARA), "--edge", "15deg"), 2, "--edge: expected a number with a unit"),
        (("plan", "--for", "iso9283", str(SCARA), "-o", "-", "--format", "json"), 2, "--format json needs --output"),
        (("simulate", str(ROBOT)), 2, "give either --poses"),
        (("simulate", str(ROBOT), "--at", str(SAMPLE / "plan.csv"), "--cycles", "2"), 2, "have cycles already"),
    ],
)
def test_errors(arguments: tuple[str, ...], status: int, message: str) -> None:
    assert message in refused(*arguments, status=status)


def test_planned_poses_are_met_by_the_robot(tmp_path: Path) -> None:
    """Simulated without effects or noise at the planned joints, the robot is where the plan commands it, to 1e-9."""
    plan, visited = tmp_path / "plan.csv", tmp_path / "visited.csv"
    made = output("plan", "--for", "iso9283", SCARA, "--edge", "150mm", "--cycles", "2", "-o", plan)
    assert missing(made, "cube with an edge of 150 mm", "j3, mm") == []
    assert max(map(len, made.splitlines())) <= 80
    output("simulate", SCARA, "--at", plan, "-o", visited)
    for wanted, attained in zip(rows(plan), rows(visited), strict=True):
        assert (wanted["pose"], wanted["cycle"]) == (attained["pose"], attained["cycle"])
        apart = [float(attained[axis]) - float(wanted[f"cmd_{axis}"]) for axis in "xyz"]
        assert np.max(np.abs(apart)) < 1e-9


def test_the_plane_of_a_plan_is_that_asked_for() -> None:
    planned = output("plan", "--for", "iso9283", "-o", "-", ROBOT, "--cycles", "1", "--plane", "y+", "--edge", "250mm")
    assert "towards y+" in planned


def test_planned_poses_without_measurements_are_refused() -> None:
    assert "columns x, y, z are missing" in refused("iso9283", SAMPLE / "plan.csv", status=3)
