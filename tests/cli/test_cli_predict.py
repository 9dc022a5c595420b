"""``robacc predict`` as a process: exit statuses, standard output, the contract's keys, files."""

from __future__ import annotations

import csv
import io
import os
import re
import subprocess
import sys
from functools import partial
from pathlib import Path

import commands
import numpy as np
import pytest
from commands import missing

PROJECT = Path(__file__).resolve().parents[2]
PUMA = "configs/robots/puma560.yaml"
SAMPLE = ("sample_data/robot.yaml", "--against", "sample_data/poses.csv")
calls = (commands.run, commands.document, commands.refused)
run, document, refused = (partial(call, "predict") for call in calls)
TOLERANCES = "units: {length: mm, angle: deg}\nall: {theta: 0.02, d: 0.2, a: 0.2, alpha: 0.01}\n"


@pytest.fixture
def tolerances(tmp_path: Path) -> Path:
    path = tmp_path / "tolerances.yaml"
    path.write_text(TOLERANCES)
    return path


def test_a_robot_without_tolerances_is_bad_input() -> None:
    told = "no parameter of sample arm has a tolerance, so no error can be predicted"
    shown = refused("sample_data/robot.yaml", status=3)
    assert missing(shown, told, "tip: give a tolerance file with --tolerances") == []


def test_as_a_process() -> None:
    environment = os.environ | {"PYTHONPATH": str(PROJECT), "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, "-m", "robacc", "predict", PUMA, "--samples", "20", "--format", "json"]
    result = subprocess.run(command, cwd=PROJECT, env=environment, capture_output=True, text=True)
    # The same call gives the same bytes, in another process too.
    same = run(PUMA, "--samples", "20", "--format", "json").stdout
    assert (result.returncode, result.stderr, result.stdout) == (0, "", same)


def test_json_has_the_contracts_keys() -> None:
    found = document(PUMA, "--samples", "50", "--allocate", "C", "--seed", "3")
    assert (found["schema"], found["seed"], found["n_poses"], found["against"]) == ("robacc.predict/1", 3, 50, None)
    assert [file["kind"] for file in found["inputs"]] == ["robot"]
    for name, unit in (("position", "m"), ("orientation", "rad")):
        part = found[name]
        covariances = np.array(part[f"covariance_{unit}2"])
        assert covariances.shape == (50, 3, 3)
        traces = np.trace(covariances, axis1=1, axis2=2)
        assert part[f"rms_{unit}"] == pytest.approx(np.sqrt(traces.mean()))
        assert part["worst"][f"rms_{unit}"] == pytest.approx(np.sqrt(traces[part["worst"]["pose"]]))
        assert len(part["worst"]["q"]) == 6
    for name in ("share_position", "share_orientation"):
        assert sum(entry[name] for entry in found["budget"]) == pytest.approx(1.0, abs=1e-9)
    assert {"parameter", "joint"} <= set(found["budget"][0])
    assert found["budget"][0]["parameter"].startswith(found["budget"][0]["joint"])
    assert found["allocation"]["met"] is True


def test_table_is_plain_and_at_most_80_columns_wide(tolerances: Path) -> None:
    result = run(*SAMPLE, "--align", "base_frame,tool_frame", "--tolerances", str(tolerances), "--allocate", "C")
    assert (result.exit_code, result.stderr) == (0, "")
    text = result.stdout
    assert "\x1b" not in text
    assert max(map(len, text.splitlines())) <= 80
    parts = (
        "Expected accuracy of sample arm, from 24 tolerances\nat the 60 poses of sample_data/poses.csv\n",
        "normal: a tolerance t is one standard deviation, variance t²",
        "Grade E predicted (scale: CAD/CAM 0.1 mm, 0.1 degree)",
        "█",
        "Tolerances for grade C",
        "Compared with 60 measured poses of sample_data/poses.csv",
        "measured, registered: base_frame and tool_frame fitted\n",
        "Likelihood ratio of the predicted covariance",
        "Variance components (one standard deviation)",
        "Limits of data from one robot",
    )
    assert missing(text, *parts) == []
    # Each line of the budget has its share and its bar, the largest filling its columns.
    line = next(line for line in text.splitlines() if line.startswith("j2.theta"))
    assert line.split()[1] == "0.0200°"
    assert not re.search(r"\d °", text)
    enough = run(PUMA, "--samples", "10", "--allocate", "E").stdout
    assert "the given tolerances already reach this grade" in enough


def test_against_in_json(tolerances: Path) -> None:
    found = document(*SAMPLE, "--tolerances", str(tolerances), "--align", "base_frame", "--noise", "0.05mm,0.1mrad")
    against = found["against"]
    assert (against["noise"]["position_m"], against["noise"]["source_orientation"]) == (pytest.approx(5e-5), "given")
    tests = against["normalised_squared_error"]
    assert tests["total"]["dof"] == 6 * 60 - 6
    assert tests["total"]["dof"] == tests["parameters"]["dof"] + tests["noise"]["dof"]
    assert tests["total"]["statistic"] == pytest.approx(tests["parameters"]["statistic"] + tests["noise"]["statistic"])
    assert {"factor", "statistic", "p_value"} <= set(against["likelihood_ratio"])
    names = [component["name"] for component in against["variance_components"]["components"]]
    assert names == ["theta", "d", "a", "alpha"]
    assert [file["kind"] for file in found["inputs"]] == ["robot", "tolerances", "against"]


def test_per_pose_file(tmp_path: Path) -> None:
    target = tmp_path / "poses.csv"
    found = document(PUMA, "--samples", "7", "--per-pose", str(target))
    rows = list(csv.DictReader(io.StringIO(target.read_text())))
    assert [row["pose"] for row in rows] == [f"sample {k}" for k in range(1, 8)]
    v_xz, j1, rms = ([float(row[name]) for row in rows] for name in ("v_xz_m2", "j1", "rms_rad"))
    assert v_xz == [covariance[0][2] for covariance in found["position"]["covariance_m2"]]
    worst = found["position"]["worst"]
    assert j1[worst["pose"]] == worst["q"][0]
    traces = np.trace(found["orientation"]["covariance_rad2"], axis1=1, axis2=2)
    np.testing.assert_allclose(rms, np.sqrt(traces))


def test_poses_of_a_file_and_another_scale(tmp_path: Path, tolerances: Path) -> None:
    scale = tmp_path / "scale.yaml"
    scale.write_text(
        "robacc: 1\nname: mine\nstatistic: rms\nconfidence: 0.95\nunits: {length: mm, angle: deg}\n"
        "steps: [{grade: fine, position: 5}]\notherwise: coarse\n"
    )
    poses = ("sample_data/robot.yaml", "--poses", "sample_data/poses.csv")
    found = document(*poses, "--scale", scale, "--tolerances", tolerances)
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
    assert message in refused(PUMA, *arguments, status=status)
