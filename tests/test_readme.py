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
    block = re.search(r"```text\n\$ robacc (.*)\n([\s\S]*?)```", README)
    assert block is not None
    result = CliRunner().invoke(app, block[1].split(), catch_exceptions=False)
    assert result.exit_code == 0
    assert result.stdout.startswith(block[2])
    assert len(block[2].splitlines()) > 20


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_is_named(name: str) -> None:
    assert f"robacc {name}" in README


def test_every_option_of_estimate_is_explained() -> None:
    shown = CliRunner().invoke(app, ["estimate", "--help"], terminal_width=200).stdout
    options = set(re.findall(r"--[a-z][a-z-]+", shown)) - {"--help"}
    assert {"--robot", "--align", "--per-pose"} <= options
    for option in options:
        assert f"`{option}" in README, option
