"""The example that ends every command's help runs as it stands, on the sample data."""

from __future__ import annotations

import itertools
import re
import shlex
import shutil
from functools import cache
from pathlib import Path

import pytest
from commands import output, run

from robacc.cli.main import COMMANDS, FORMS, form_of

ROOT = Path(__file__).resolve().parents[2]
SAMPLE = ROOT / "sample_data"
FILES = {
    "poses.csv": SAMPLE / "poses.csv",
    "robot.yaml": SAMPLE / "robot.yaml",
    "targets.csv": SAMPLE / "iso9283" / "plan.csv",
    "model.yaml": SAMPLE / "truth.yaml",
    "cycles.csv": SAMPLE / "iso9283" / "poses.csv",
    "calibration.conf": ROOT / "tests" / "controllers" / "samples" / "calibration.conf",
    "gate.yaml": ROOT / "configs" / "gates" / "machine_tending.yaml",
}
"""What the examples name, by the sample that stands in for it."""
IDENTITY = "serial_number: '12345'\ncustomer: works\n"
TOLERANCES = "units: {length: mm, angle: deg}\nall: {theta: 0.006, d: 0.1, a: 0.1, alpha: 0.006}\n"
ESTIMATE = ("estimate", "poses.csv", "--robot", "robot.yaml", "--align", "base_frame,tool_frame", "--format", "json")
TRACE = ("trace", str(SAMPLE / "trace" / "poses.csv"), "--robot", str(SAMPLE / "trace" / "robot.yaml"))
DECLARED = ("--declared", "base_frame,tool_frame,joint_offset,link_geometry", "--format", "json")
RESULTS = {
    "result.json": ESTIMATE,
    "arm1.json": ESTIMATE,
    "arm2.json": (*ESTIMATE, "--frame", "base"),
    "trace.json": (*TRACE, *DECLARED),
}
"""Results that examples name, by the command that makes them."""
GATED = {"check": (0, 4, 5)}
"""Exit statuses of what is no error, where a gate decides."""


@cache
def result(file: str) -> str:
    return output(*RESULTS[file])


def example(name: str) -> str:
    text = output(*name.split(), "--help")
    assert max(map(len, text.splitlines())) <= 80
    description = re.split(r"^(?:Arguments|Options):$", text, flags=re.MULTILINE)[0]
    last_paragraph = " ".join(description.strip().split("\n\n")[-1].split())
    match = re.fullmatch(r"Example: (robacc \S.*)", last_paragraph)
    assert match, f"the help of {name} ends with {last_paragraph!r}, not with an example"
    return match[1]


@pytest.mark.parametrize("name", [*COMMANDS, *FORMS])
def test_the_example_at_the_end_of_the_help_runs(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    words = shlex.split(example(name))
    assert words[0] == "robacc"
    assert form_of(words[1], words[2:])[0] == name
    monkeypatch.chdir(tmp_path)
    for file, source in FILES.items():
        shutil.copy(source, file)
    Path("tolerances.yaml").write_text(TOLERANCES, encoding="utf-8")
    Path("cell7.yaml").write_text(IDENTITY, encoding="utf-8")
    for file in set(words) & RESULTS.keys():
        Path(file).write_text(result(file), encoding="utf-8")
    before = set(tmp_path.iterdir())
    done = run(*words[1:])
    assert done.exit_code in GATED.get(name, (0,)), done.stderr
    assert "error:" not in done.stderr
    assert done.stdout or set(tmp_path.iterdir()) > before
    for flag, file in itertools.pairwise(words):
        if flag in ("--output", "--write-model", "--urdf", "--folder"):
            assert (tmp_path / file).exists()
