"""Results of every command on the sample data, as their JSON, made once for the tests that report them."""

import contextlib
import json
from functools import cache
from pathlib import Path
from typing import Any

from typer.testing import CliRunner, Result

from robacc.cli.main import app

PROJECT = Path(__file__).resolve().parents[1]
DECLARED = "base_frame,tool_frame,joint_offset,link_geometry"
"""A fit that lacks the geometry leaves an error, whose description takes ten times as long as the fit."""
CALLS = {
    "estimate": ("sample_data/poses.csv", "--robot", "sample_data/robot.yaml", "--align", "base_frame,tool_frame"),
    "predict": ("configs/robots/puma560.yaml", "--samples", "200", "--allocate", "C"),
    "calibrate": (
        *("sample_data/trace/poses.csv", "--robot", "sample_data/trace/robot.yaml"),
        *("--fit", f"{DECLARED},joint_compliance[j2],backlash[j3]", "--folds", "2"),
    ),
    "trace": ("sample_data/trace/poses.csv", "--robot", "sample_data/trace/robot.yaml", "--declared", DECLARED),
    "iso9283": (
        *("sample_data/iso9283/poses.csv", "--robot", "sample_data/iso9283/robot.yaml"),
        *("--align", "base_frame,tool_frame"),
    ),
}


def run(*arguments: str) -> Result:
    """A command in this process, from the project's folder."""
    with contextlib.chdir(PROJECT):
        return CliRunner().invoke(app, list(arguments), catch_exceptions=False)


@cache
def text(command: str) -> str:
    """A result's JSON as a command writes it."""
    done = run(command, *CALLS[command], "--format", "json")
    assert done.exit_code == 0, done.stderr
    return done.stdout


def document(command: str) -> dict[str, Any]:
    """A result, read again, so that a test may change it."""
    found: dict[str, Any] = json.loads(text(command))
    return found


GATE = """robacc_gate: 1
name: cell
criteria:
  - {name: reach, key: position.p95, limit: 1 mm, reason: the gap of the part}
  - {name: tight, key: position.rms, limit: 0.48 mm, reason: what the old cell had}
"""


@cache
def compared(folder: Path) -> dict[str, Any]:
    """The calibration held against the trace of the same poses."""
    paths = []
    for command in ("calibrate", "trace"):
        paths.append(str(folder / f"{command}.json"))
        Path(paths[-1]).write_text(text(command), encoding="utf-8")
    done = run("compare", *paths, "--format", "json")
    assert done.exit_code == 0, done.stderr
    found: dict[str, Any] = json.loads(done.stdout)
    return found


@cache
def gated(folder: Path) -> dict[str, Any]:
    """The estimate held against a gate that it passes in part."""
    gate = folder / "gate.yaml"
    gate.write_text(GATE, encoding="utf-8")
    done = run("estimate", *CALLS["estimate"], "--gate", str(gate), "--format", "json")
    assert done.exit_code == 5
    found: dict[str, Any] = json.loads(done.stdout)
    return found
