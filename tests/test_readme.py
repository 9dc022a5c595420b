"""The README's worked example is what the program prints."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from robacc.cli.main import COMMANDS, app

ROOT = Path(__file__).resolve().parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_worked_example_is_real_output(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    blocks = re.findall(r"```text\n\$ robacc ((?:trace|estimate) .*)\n([\s\S]*?)```", README)
    assert len(blocks) == 2
    for command, output in blocks:
        result = CliRunner().invoke(app, command.split(), catch_exceptions=False)
        assert result.exit_code == 0
        assert result.stdout.startswith(output)
        assert len(output.splitlines()) > 20


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_is_named(name: str) -> None:
    assert f"robacc {name}" in README


def test_every_option_of_estimate_is_explained() -> None:
    shown = CliRunner().invoke(app, ["estimate", "--help"], terminal_width=200).stdout
    options = set(re.findall(r"--[a-z][a-z-]+", shown)) - {"--help"}
    assert {"--robot", "--align", "--per-pose"} <= options
    for option in options:
        assert f"`{option}" in README, option
