"""Files for build servers: they are valid, and what they run exists."""

from __future__ import annotations

import re
from pathlib import Path

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


def test_the_hook_stops_at_a_wrong_robot_file(tmp_path: Path) -> None:
    (hook,) = yaml.safe_load((ROOT / ".pre-commit-hooks.yaml").read_text(encoding="utf-8"))
    assert hook["entry"] == "python -m robacc.cli.hooks"
    robots = sorted(map(str, (ROOT / "configs" / "robots").glob("*.yaml")))
    assert all(re.search(hook["files"], path) for path in robots)
    assert main(robots) == 0
    wrong = tmp_path / "wrong.yaml"
    wrong.write_text("robacc: 1\nname: x\n", encoding="utf-8")
    assert main([robots[0], str(wrong)]) == 3
