"""``robacc plan`` from the command line: its files, its answers, and its messages."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner, Result

from robacc.cli.main import app
from robacc.poses.csv_file import read_poses

ROOT = Path(__file__).resolve().parents[2]
ROBOT = ROOT / "sample_data" / "robot.yaml"
SMALL = ("--candidates", "200")


def run(*arguments: object) -> Result:
    return CliRunner().invoke(app, [str(argument) for argument in arguments], catch_exceptions=False)


def refused(*arguments: object, status: int = 2) -> str:
    result = run("plan", *arguments)
    assert result.exit_code == status
    assert result.stdout == ""
    return " ".join(result.stderr.split())


def test_the_plan_is_a_file_that_simulate_and_calibrate_take(tmp_path: Path) -> None:
    plan, check, program = tmp_path / "plan.csv", tmp_path / "validation.csv", tmp_path / "plan.src"
    result = run(
        *("plan", ROBOT, "--poses", 14, *SMALL, "-o", plan, "--program", program),
        *("--validation", 5, "--validation-output", check),
    )
    assert result.exit_code == 0, result.stderr
    assert "Predicted standard errors" in result.stdout
    poses = read_poses(plan, attained=False)
    assert np.unique(poses.groups()).size == 14
    assert poses.direction is not None
    assert read_poses(check, attained=False).n == 5
    assert program.read_text().count("PTP {") == poses.n
    measured = tmp_path / "measured.csv"
    simulated = run("simulate", ROBOT, "--at", plan, "--noise", "0.02mm", "--position-only", "-o", measured)
    assert simulated.exit_code == 0, simulated.stderr
    read = read_poses(measured)
    np.testing.assert_array_equal(read.q, poses.q)
    # Derived from the order by the simulation, stated by the plan: the same motion.
    np.testing.assert_array_equal(read.direction, poses.direction)


def test_json_and_csv_agree(tmp_path: Path) -> None:
    plan = tmp_path / "plan.csv"
    result = run("plan", ROBOT, "--poses", 12, *SMALL, "--min-height", "100mm", "--format", "json", "-o", plan)
    document = json.loads(result.stdout)
    poses = read_poses(plan, attained=False)
    assert document["schema"] == "robacc.plan/1"
    np.testing.assert_allclose(np.array(document["visits"]["q"]).T, poses.q)
    assert min(position[2] for position in document["visits"]["target_in_base_m"]) >= 0.1
    assert document["accuracy"]["planned"]["rms_m"] < document["accuracy"]["planned"]["random_rms_m"]
    assert run("plan", ROBOT, "--poses", 12, *SMALL, "--min-height", "100mm").stdout == plan.read_text()


def test_enough_or_the_next_ten(tmp_path: Path) -> None:
    measured = ("plan", ROBOT, *SMALL, "--already", ROOT / "sample_data" / "poses.csv")
    answer = run(*measured, "-o", tmp_path / "next.csv", "--fit", "base_frame,joint_offset")
    assert "Enough" in answer.stdout
    strict = run(
        *(*measured, "-o", tmp_path / "next.csv", "--fit", "base_frame,joint_offset"),
        *("--target-error", "1um"),
    )
    assert "Not enough: measure the next 10" in strict.stdout
    assert "rows measured already: fit them together with the new rows" in " ".join(strict.stdout.split())
    assert strict.stdout.count("more poses  ") == 1
    assert read_poses(tmp_path / "next.csv", attained=False).n == 10


def test_acceptance_plans_for_a_gate(tmp_path: Path) -> None:
    gate = tmp_path / "gate.yaml"
    gate.write_text(
        "robacc_gate: 1\nname: cell\ncriteria:\n  - {key: position.p95, limit: 1mm, name: tool, reason: drawing}\n"
    )
    result = run(
        "plan", ROBOT, "--for", "acceptance", "--gate", gate, "--expected", "0.5mm", *SMALL, "-o", tmp_path / "a"
    )
    assert result.exit_code == 0, result.stderr
    assert "59 poses" in result.stdout.splitlines()[0]
    close = refused(ROBOT, "--for", "acceptance", "--gate", gate, "--expected", "0.99mm", *SMALL)
    assert "no number of poses" in close


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
        (("--program", "plan.xyz"), "--program: expected a file name that ends in .src, .mod, .ls, .script"),
        (("--validation", "5"), "--validation N and --validation-output FILE belong together"),
        (("--grade", "D"), "set the number of acceptance poses"),
    ],
)
def test_messages(arguments: tuple[str, ...], message: str) -> None:
    status = 3 if "none.yaml" in arguments else 2
    assert message in refused(ROBOT, *SMALL, *arguments, status=status)


def test_another_arm_is_no_model() -> None:
    other = ROOT / "configs" / "robots" / "scara.yaml"
    assert "give the model of this robot" in refused(ROBOT, *SMALL, "--model", other)
