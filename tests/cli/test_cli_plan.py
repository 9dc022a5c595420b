"""``robacc plan`` from the command line: its files, its answers, and its messages."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import commands
import numpy as np
import pytest
from commands import missing, one_line, output

from robacc.poses.csv_file import read_poses

ROOT = Path(__file__).resolve().parents[2]
ROBOT = ROOT / "sample_data" / "robot.yaml"
plan, document, refused = (partial(call, "plan") for call in (output, commands.document, commands.refused))
SMALL = ("--candidates", "200")


def test_the_plan_is_a_file_that_simulate_and_calibrate_take(tmp_path: Path) -> None:
    path, check, program = tmp_path / "plan.csv", tmp_path / "validation.csv", tmp_path / "plan.src"
    options = ("--full", "--program", program, "--validation", 5, "--validation-output", check)
    assert "Predicted standard errors" in plan(ROBOT, "--poses", 14, *SMALL, "-o", path, *options)
    poses = read_poses(path, attained=False)
    assert np.unique(poses.groups()).size == 14
    assert poses.direction is not None
    assert (read_poses(check, attained=False).n, program.read_text().count("PTP {")) == (5, poses.n)
    measured = tmp_path / "measured.csv"
    output("simulate", ROBOT, "--at", path, "--noise", "0.02mm", "--position-only", "-o", measured)
    read = read_poses(measured)
    np.testing.assert_array_equal(read.q, poses.q)
    # Derived from the order by the simulation, stated by the plan: the same motion.
    np.testing.assert_array_equal(read.direction, poses.direction)


def test_json_and_csv_agree(tmp_path: Path) -> None:
    path, words = tmp_path / "plan.csv", (ROBOT, "--poses", 12, *SMALL, "--min-height", "100mm")
    found = document(*words, "-o", path)
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
    assert "next: measure the poses in the order of" in plan(*words, "-o", path)


def test_enough_or_the_next_ten(tmp_path: Path) -> None:
    measured = (ROBOT, *SMALL, "--already", ROOT / "sample_data" / "poses.csv", "-o", tmp_path / "next.csv")
    fit = ("--fit", "base_frame,joint_offset")
    assert "Enough" in plan(*measured, *fit)
    strict = plan(*measured, *fit, "--target-error", "1um", "--full")
    told = ("Not enough: measure the next 10", "rows measured already: fit them together with the new rows")
    assert (missing(one_line(strict), *told), strict.count("more poses  ")) == ([], 1)
    assert read_poses(tmp_path / "next.csv", attained=False).n == 10


def test_acceptance_plans_for_a_gate(tmp_path: Path) -> None:
    gate = tmp_path / "gate.yaml"
    gate.write_text(
        "robacc_gate: 1\nname: cell\ncriteria:\n  - {key: position.p95, limit: 1mm, name: tool, reason: drawing}\n"
    )
    words = (ROBOT, "--for", "acceptance", "--gate", gate, *SMALL, "--expected")
    assert "59 poses" in plan(*words, "0.5mm", "-o", tmp_path / "a").splitlines()[0]
    assert f"robacc estimate PLAN --robot {ROBOT} --gate gate.yaml" in one_line(plan(*words, "0.5mm"))
    assert "no number of poses" in refused(*words, "0.99mm")


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
