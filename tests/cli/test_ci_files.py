"""Files for build servers: they are valid, and what they run exists."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import yaml
from typer.testing import CliRunner

from robacc.cli.hooks import main
from robacc.cli.main import COMMANDS, app

ROOT = Path(__file__).resolve().parents[2]


def test_the_action_runs_commands_and_options_that_exist() -> None:
    action = yaml.safe_load((ROOT / "action.yml").read_text(encoding="utf-8"))
    assert action["runs"]["using"] == "composite"
    scripts = "\n".join(step.get("run", "") for step in action["runs"]["steps"])
    # Inputs reach a script through its environment only: a text of a pull request is never part of a script.
    assert "${{" not in scripts
    used = set(re.findall(r"inputs\.([a-z-]+)", (ROOT / "action.yml").read_text(encoding="utf-8")))
    assert used == set(action["inputs"])
    assert action["inputs"]["command"]["default"] in COMMANDS
    help_text = CliRunner().invoke(app, ["check", "--help"]).stdout
    for option in ("--gate", "--format", "--junit"):
        assert option in scripts
        assert option in help_text


# https://docs.github.com/en/actions/reference/workflows-and-actions/metadata-syntax
TOP_KEYS = {"name", "author", "description", "inputs", "outputs", "runs", "branding"}
INPUT_KEYS = {"description", "required", "default", "deprecationMessage", "type"}
STEP_KEYS = {"name", "id", "if", "run", "shell", "env", "working-directory", "uses", "with", "continue-on-error"}


def test_the_action_follows_the_metadata_syntax() -> None:
    action = yaml.safe_load((ROOT / "action.yml").read_text(encoding="utf-8"))
    assert {"name", "description", "runs"} <= action.keys() <= TOP_KEYS
    for entry in action["inputs"].values():
        assert "description" in entry
        assert entry.keys() <= INPUT_KEYS
        # An input is required, or it has a default.
        assert ("default" in entry) != entry.get("required", False)
    assert action["runs"].keys() == {"using", "steps"}
    for step in action["runs"]["steps"]:
        assert step.keys() <= STEP_KEYS
        assert ("run" in step) != ("uses" in step)
        assert ("shell" in step) == ("run" in step)  # a composite action must name the shell of each script
        assert "uses" not in step or re.fullmatch(r"[\w-]+/[\w-]+@v\d+", step["uses"])


@pytest.mark.skipif(shutil.which("bash") is None, reason="the scripts of the action are for bash")
def test_the_scripts_of_the_action_measure_and_check(tmp_path: Path) -> None:
    rows = "".join(f"{i},{i % 7},{i % 5},{i}.1,{i % 7},{i % 5}\n" for i in range(8))
    (tmp_path / "poses of today.csv").write_text("cmd_x_mm,cmd_y_mm,cmd_z_mm,x_mm,y_mm,z_mm\n" + rows, encoding="utf-8")
    criterion = "{name: accurate, key: position.rms, limit: LIMIT, rule: simple, reason: as ordered}"
    text = f"robacc_gate: 1\nname: cell\ncriteria:\n  - {criterion.replace('LIMIT', '0.01 mm')}\n"
    (tmp_path / "gate.yaml").write_text(text, encoding="utf-8")
    command = tmp_path / "bin" / "robacc"
    command.parent.mkdir()
    command.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m robacc "$@"\n', encoding="utf-8")
    command.chmod(0o755)
    action = yaml.safe_load((ROOT / "action.yml").read_text(encoding="utf-8"))
    values = {name: str(entry.get("default", "")) for name, entry in action["inputs"].items()}
    values |= {"poses": "poses of today.csv", "arguments": "--frame base --confidence 0.9"}
    steps = {step.get("name"): step for step in action["runs"]["steps"]}

    def run(name: str, **given: str) -> subprocess.CompletedProcess[str]:
        step = steps[name]
        env = {key: (values | given)[text.strip("${} ").removeprefix("inputs.")] for key, text in step["env"].items()}
        path = f"{command.parent}{os.pathsep}{os.environ['PATH']}"
        env = {
            **os.environ,
            **env,
            "PATH": path,
            "PYTHONPATH": str(ROOT),
            "GITHUB_STEP_SUMMARY": str(tmp_path / "s.md"),
        }
        # The call of bash that GitHub documents for ``shell: bash``.
        bash = ["bash", "--noprofile", "--norc", "-eo", "pipefail", "-c", step["run"]]
        return subprocess.run(bash, cwd=tmp_path, env=env, capture_output=True, text=True, check=False)

    measured = run("Measure")
    assert measured.returncode == 0, measured.stderr
    assert json.loads((tmp_path / values["result"]).read_text(encoding="utf-8"))["options"]["confidence"] == 0.9
    failed = run("Check", gate="gate.yaml")
    assert failed.returncode == 4
    assert failed.stdout.startswith("::error title=cell%3A accurate::fail")
    assert 'failures="1"' in (tmp_path / values["junit"]).read_text(encoding="utf-8")
    summary = (tmp_path / "s.md").read_text(encoding="utf-8")
    assert "FAIL (1 fail)" in summary


def test_the_container_has_extras_and_the_command_that_exist() -> None:
    text = (ROOT / "Containerfile").read_text(encoding="utf-8")
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    built, installed = (set(found.split(",")) for found in re.findall(r"\[([a-z,]+)\]", text.replace('["robacc"]', "")))
    assert built == installed <= project["optional-dependencies"].keys()
    assert re.search(r'^ENTRYPOINT \["robacc"\]$', text, re.MULTILINE)
    assert "robacc" in project["scripts"]
    (version,) = set(re.findall(r"python:(\d\.\d+)-slim", text))
    assert f"Programming Language :: Python :: {version}" in project["classifiers"]


def test_the_hook_stops_at_a_wrong_robot_file(tmp_path: Path) -> None:
    (hook,) = yaml.safe_load((ROOT / ".pre-commit-hooks.yaml").read_text(encoding="utf-8"))
    assert hook["entry"] == "python -m robacc.cli.hooks"
    robots = sorted(map(str, (ROOT / "configs" / "robots").glob("*.yaml")))
    assert all(re.search(hook["files"], path) for path in robots)
    assert main(robots) == 0
    wrong = tmp_path / "wrong.yaml"
    wrong.write_text("robacc: 1\nname: x\n", encoding="utf-8")
    assert main([robots[0], str(wrong)]) == 3
