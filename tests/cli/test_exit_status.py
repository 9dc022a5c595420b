"""Every exit status of the command line, from a shell."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
ROBACC = f'"{sys.executable}" -m robacc'
ESTIMATE = f"{ROBACC} estimate sample_data/poses.csv --robot sample_data/robot.yaml"
HEAD = "robacc_gate: 1\nname: g\ncriteria:\n"
GATES = {
    "pass": "  - {key: position.rms, limit: 9 mm, reason: r}\n",
    "fail": "  - {key: position.rms, limit: 1 mm, reason: r}\n  - {key: verdict, limit: clean, reason: r}\n",
    "inconclusive": "  - {key: position.rms, limit: 1.85 mm, reason: r}\n",
    "missing": "  - {key: position.rms, limit: 9 mm, reason: r}\n  - {key: verdict, limit: clean, reason: r}\n",
    "bad": "  - {key: position.rms, limit: 9, reason: r}\n",
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("gates")
    for name, text in GATES.items():
        (made / f"{name}.yaml").write_text(HEAD + text)
    subprocess.run(f"{ESTIMATE} --format json -o {made}/result.json", shell=True, cwd=ROOT, check=True)
    (made / "broken.json").write_text('{"schema": "robacc.estimate/1", ')
    return made


@pytest.mark.parametrize(
    ("command", "status"),
    [
        ("{estimate}", 0),
        ("{estimate} --gate {folder}/pass.yaml", 0),
        ("{robacc} check {folder}/result.json --gate {folder}/pass.yaml", 0),
        ("{robacc} check - --gate {folder}/pass.yaml < {folder}/result.json", 0),
        ("{robacc} estimate", 2),
        ("{robacc} estimates x.csv", 2),
        ("{robacc} check {folder}/result.json", 2),
        ("{estimate} --junit {folder}/j.xml", 2),
        ("{robacc} estimate nowhere.csv", 3),
        ("{estimate} --gate {folder}/bad.yaml", 3),
        ("{estimate} --gate {folder}/nowhere.yaml", 3),
        ("{robacc} check {folder}/broken.json --gate {folder}/pass.yaml", 3),
        ("{robacc} check sample_data/poses.csv --gate {folder}/pass.yaml", 3),
        ("{estimate} --gate {folder}/pass.yaml --junit {folder}/none/j.xml", 3),
        ("{estimate} --gate {folder}/fail.yaml", 4),
        ("{robacc} check {folder}/result.json --gate {folder}/fail.yaml --format github", 4),
        ("{estimate} --gate {folder}/inconclusive.yaml", 5),
        ("{robacc} check {folder}/result.json --gate {folder}/missing.yaml --format markdown", 5),
    ],
)
def test_status(command: str, status: int, folder: Path) -> None:
    line = command.format(robacc=ROBACC, estimate=ESTIMATE, folder=folder)
    done = subprocess.run(line, shell=True, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == status, done.stderr
    assert "Traceback" not in done.stderr
    # What cannot be used leaves nothing on standard output for the next program to take as a result.
    assert bool(done.stdout) == (status in (0, 4, 5))


def test_a_defect_is_status_1(folder: Path) -> None:
    code = (
        "import robacc.gates.evaluate as m\n"
        "def f(*a, **k):\n    raise ZeroDivisionError('here')\n"
        "m.evaluate_gate = f\nfrom robacc.cli.main import main\nmain()"
    )
    line = [sys.executable, "-c", code, "check", f"{folder}/result.json", "--gate", f"{folder}/pass.yaml"]
    done = subprocess.run(line, cwd=ROOT, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.endswith("ZeroDivisionError: here\n")


def test_a_shell_can_tell_fail_from_undecided(folder: Path) -> None:
    script = (
        f"{ESTIMATE} --gate {folder}/inconclusive.yaml > /dev/null; status=$?\n"
        'case $status in 0) echo pass;; 4) echo fail;; 5) echo "measure more";; *) echo broken;; esac\n'
    )
    done = subprocess.run(script, shell=True, cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout == "measure more\n"
