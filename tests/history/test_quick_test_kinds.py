"""The quick test with the tip in sockets, and with photos of a board: the joint whose zero moved, and by how much."""

import csv
import json
from pathlib import Path

import pytest
from commands import document, run

SAMPLES = Path("sample_data")
CAMERA = ("--camera", SAMPLES / "photos/camera.yaml")


@pytest.mark.parametrize(("file", "options"), [("sockets/unknown.csv", ()), ("photos/points.csv", CAMERA)])
def test_it_names_the_joint_that_moved(file, options, tmp_path):
    written = ("--fit", "base_frame,tool_frame,joint_offset", "--write-model", tmp_path / "model.yaml")
    full = document("calibrate", SAMPLES / file, "--robot", "ur10", *options, *written)
    (tmp_path / "full.json").write_text(json.dumps(full))
    document("history", "add", tmp_path / "full.json", "--db", tmp_path / "arm.db", "--at", "2026-01-01")
    lines = [line for line in (SAMPLES / file).read_text().splitlines() if line[0] != "#"]
    rows = [row for row in csv.DictReader(lines) if row["pose"][-1] in "02468"]
    for moved, key in ((0.0, []), (0.004, ["joint_offset.elbow_joint"])):
        done = quick_test(tmp_path, [{**row, "q3": float(row["q3"]) + moved} for row in rows], options)
        assert "too large for an arm" not in done.stderr
        found = json.loads(done.stdout)
        assert [change["key"] for change in found["changes"]] == key
        assert all(change["low"] < -moved < change["high"] < 0.0 for change in found["changes"])
        assert all(0.0 < limit["limit"] < 0.006 for limit in found["detection_limits"])
    if not options:
        # A joint counted the other way round is a mistake of the data, not a change of the arm.
        done = quick_test(tmp_path, [{**row, "q3": -float(row["q3"])} for row in rows], options)
        assert "too large for an arm" in done.stderr


def quick_test(folder, rows, options):
    with open(folder / "quick.csv", "w", newline="") as stream:
        table = csv.DictWriter(stream, rows[0])
        table.writeheader()
        table.writerows(rows)
    robot = ("--robot", folder / "model.yaml", "--db", folder / "arm.db", "--at", "2026-02-01")
    return run("health", folder / "quick.csv", *robot, *options, "--format", "json")
