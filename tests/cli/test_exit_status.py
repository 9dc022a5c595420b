"""Every exit status of the command line."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from commands import output, run
from results import PROJECT as ROOT

SAMPLE = ("sample_data/poses.csv", "--robot", "sample_data/robot.yaml")
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
    output("estimate", *SAMPLE, "--format", "json", "-o", made / "result.json")
    (made / "broken.json").write_text('{"schema": "robacc.estimate/1", ')
    return made


@pytest.mark.parametrize(
    ("command", "status"),
    [
        ("{estimate}", 0),
        ("{estimate} --gate {folder}/pass.yaml", 0),
        ("check {folder}/result.json --gate {folder}/pass.yaml", 0),
        ("check - --gate {folder}/pass.yaml", 0),
        ("estimate", 2),
        ("estimates x.csv", 2),
        ("check {folder}/result.json", 2),
        ("{estimate} --junit {folder}/j.xml", 2),
        ("estimate nowhere.csv", 3),
        ("{estimate} --gate {folder}/bad.yaml", 3),
        ("{estimate} --gate {folder}/nowhere.yaml", 3),
        ("check {folder}/broken.json --gate {folder}/pass.yaml", 3),
        ("check sample_data/poses.csv --gate {folder}/pass.yaml", 3),
        ("{estimate} --gate {folder}/pass.yaml --junit {folder}/none/j.xml", 3),
        ("{estimate} --gate {folder}/fail.yaml", 4),
        ("check {folder}/result.json --gate {folder}/fail.yaml --format github", 4),
        ("{estimate} --gate {folder}/inconclusive.yaml", 5),
        ("check {folder}/result.json --gate {folder}/missing.yaml --format markdown", 5),
    ],
)
def test_status(command: str, status: int, folder: Path) -> None:
    words = command.format(estimate=" ".join(("estimate", *SAMPLE)), folder=folder).split()
    done = run(*words, text=(folder / "result.json").read_text(encoding="utf-8"))
    assert done.exit_code == status, done.stderr
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
        f'"{sys.executable}" -m robacc estimate {" ".join(SAMPLE)} --gate {folder}/inconclusive.yaml > /dev/null\n'
        'case $? in 0) echo pass;; 4) echo fail;; 5) echo "measure more";; *) echo broken;; esac\n'
    )
    done = subprocess.run(script, shell=True, cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout == "measure more\n"
