"""Repetitions of a commanded pose, from files to results."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
from typer.testing import CliRunner

from robacc.cli.main import app
from robacc.poses.csv_file import format_poses, read_poses

ROOT = Path(__file__).resolve().parents[2]


def test_a_pose_id_that_the_joints_contradict_is_no_repetition(tmp_path: Path) -> None:
    """Ids P0 … P9 over poses that were each measured once: nothing in them is pure error."""
    data = read_poses(ROOT / "sample_data" / "poses.csv")
    data = dataclasses.replace(data, pose=np.array([f"P{i % 10}" for i in range(data.n)]))
    (tmp_path / "poses.csv").write_text(format_poses(data), encoding="utf-8")
    arguments = (str(tmp_path / "poses.csv"), "--robot", str(ROOT / "sample_data" / "robot.yaml"), "--format", "json")
    warning = "10 of 10 pose ids have rows with different commands, for example P0 on line 2 and line "
    done = CliRunner().invoke(app, ["calibrate", *arguments, "--fit", "base_frame,tool_frame"], catch_exceptions=False)
    document = json.loads(done.stdout)
    assert document["noise"]["source"] == "residual"
    assert len(set(document["poses"]["group"])) == data.n
    assert any(warning in text for text in document["warnings"])
    assert warning in done.stderr
    estimated = json.loads(CliRunner().invoke(app, ["estimate", *arguments]).stdout)
    assert sum(warning in text for text in estimated["warnings"]) == 1
    # Cycles of ISO 9283 are by their ids all the same, with a warning of their own.
    judged = json.loads(CliRunner().invoke(app, ["iso9283", *arguments]).stdout)
    assert judged["n_commanded_poses"] == 10
    assert ["differs by" in text for text in judged["warnings"]] == [True]
