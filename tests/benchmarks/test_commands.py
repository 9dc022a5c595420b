"""What commands cost in processor time and memory: ``pytest tests/benchmarks -m slow -s`` prints both."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import NamedTuple

import pytest
from costs import ROBACC, ROOT, costs, report, users_environment

pytestmark = pytest.mark.slow

SAMPLE = "sample_data/trace"
GEOMETRY = "base_frame,tool_frame,joint_offset,link_geometry"
POSES = {
    "million": f"{SAMPLE}/truth.yaml --poses 1000000 --noise 0.02mm --position-only",
    "rows": "sample_data/robot.yaml --poses 1000000 --noise 0.1mm --no-motion",
    "hundred": "sample_data/robot.yaml --poses 100 --noise 0.1mm --no-motion",
    "poses_150": f"{SAMPLE}/truth.yaml --poses 150 --noise 0.02mm --position-only",
    "poses_400": f"{SAMPLE}/truth.yaml --poses 400 --noise 0.02mm --noise-orientation 0.003deg",
    "poses_1495": f"{SAMPLE}/truth.yaml --poses 1495 --noise 0.02mm --noise-orientation 0.003deg",
    "poses_11911": f"{SAMPLE}/truth.yaml --poses 11911 --noise 0.02mm --position-only",
}
"""Simulated poses by name; other machines do not have the sets that arms were measured on."""
TRACE = f"--robot {SAMPLE}/robot.yaml --declared {GEOMETRY}"


class Line(NamedTuple):
    what: str
    command: str
    """With the names of poses in braces."""
    seconds: float | None
    megabytes: float | None


LINES = (
    Line("simulate 1 M positions", f"simulate {POSES['million']} -o {{out}}.csv", 8, 600),
    Line("estimate 1 M poses", "estimate {rows} --robot sample_data/robot.yaml", 4, 300),
    Line(
        "estimate 1 M poses, aligned",
        "estimate {rows} --robot sample_data/robot.yaml --align base_frame,tool_frame",
        5,
        400,
    ),
    Line("estimate 1 M poses, JSON", "estimate {rows} --robot sample_data/robot.yaml --format json -o {out}", 6, 400),
    Line("calibrate 1 M positions", f"calibrate {{million}} --robot {SAMPLE}/robot.yaml --fit {GEOMETRY}", 20, 600),
    Line("trace 150 positions, with a report", f"trace {{poses_150}} {TRACE} --report {{out}}.html", 0.6, None),
    Line("trace 400 poses", f"trace {{poses_400}} {TRACE}", 3, 300),
    Line("trace 1,495 poses", f"trace {{poses_1495}} {TRACE}", 5, 400),
    Line("trace 11,911 positions", f"trace {{poses_11911}} {TRACE}", 20, 600),
)


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    folder = tmp_path_factory.mktemp("bytecode")
    found = users_environment(folder)
    # Commands that are measured once would compile the charts' library, a second for a report.
    words = f"trace {SAMPLE}/poses.csv {TRACE} --report {folder}/page.html".split()
    subprocess.run((*ROBACC, *words), env=found, cwd=ROOT, check=True, capture_output=True)
    return found


@pytest.fixture(scope="module")
def poses(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], str]:
    folder = tmp_path_factory.mktemp("poses")

    @cache
    def simulated(name: str) -> str:
        path = str(folder / f"{name}.csv")
        subprocess.run((*ROBACC, "simulate", *POSES[name].split(), "-o", path), check=True, cwd=ROOT)
        return path

    return simulated


@pytest.mark.parametrize("line", LINES, ids=lambda line: line.what.replace(" ", "_"))
def test_command(
    line: Line,
    poses: Callable[[str], str],
    tmp_path: Path,
    environment: dict[str, str],
    capsys: pytest.CaptureFixture[str],
) -> None:
    names = {name: poses(name) for name in POSES if f"{{{name}}}" in line.command}
    words = [word.format(out=tmp_path / "out", **names) if "{" in word else word for word in line.command.split()]
    (cost,) = costs(environment, 1, (*ROBACC, *words))
    report(capsys, line.what, (cost.seconds, "s", line.seconds), (cost.megabytes, "MB", line.megabytes))


def test_a_hundred_poses_above_importing_numpy(
    poses: Callable[[str], str], environment: dict[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    command = (*ROBACC, "estimate", poses("hundred"), "--robot", "sample_data/robot.yaml")
    base, whole = costs(environment, 9, (sys.executable, "-c", "import numpy"), command)
    report(
        capsys,
        "estimate 100 poses",
        (whole.seconds - base.seconds, "s above import numpy", 0.10),
        (whole.megabytes, "MB", None),
    )


def test_help_against_a_bare_typer_program(
    tmp_path: Path, environment: dict[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    bare = tmp_path / "bare.py"
    bare.write_text(
        "import typer\napp = typer.Typer()\n\n@app.command()\ndef hello(name: str) -> None:\n    'Say hello.'\n\n"
        "@app.command()\ndef bye(name: str) -> None:\n    'Say goodbye.'\n\napp()\n",
        encoding="utf-8",
    )
    base, whole = costs(environment, 9, (sys.executable, str(bare), "--help"), (*ROBACC, "--help"))
    report(capsys, "robacc --help", (whole.seconds / base.seconds, "times a bare typer program", 1.3))
