"""The README's worked example is what the program prints."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from robacc.cli.main import COMMANDS, app

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "docs" / "tools"))

from transcripts import agrees  # noqa: E402

README = (ROOT / "README.md").read_text(encoding="utf-8")


BLOCKS = re.findall(r"```text\n\$ robacc (.*)\n([\s\S]*?)```", README)


@pytest.mark.parametrize(("command", "output"), BLOCKS, ids=[command.split()[0] for command, _ in BLOCKS])
def test_examples_are_real_output(command: str, output: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)
    result = CliRunner().invoke(app, command.split(), catch_exceptions=False)
    assert result.exit_code in (0, 4, 5)
    assert agrees(tuple(output.splitlines()), result.stdout)


def test_the_worked_examples_are_there() -> None:
    assert {"trace", "estimate"} <= {command.split()[0] for command, _ in BLOCKS}
    assert all(len(output.splitlines()) > 20 for command, output in BLOCKS[:2])


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_is_named(name: str) -> None:
    assert f"robacc {name}" in README


def test_every_option_of_estimate_is_explained() -> None:
    shown = CliRunner().invoke(app, ["estimate", "--help"], terminal_width=200).stdout
    options = set(re.findall(r"--[a-z][a-z-]+", shown)) - {"--help"}
    assert {"--robot", "--align", "--per-pose"} <= options
    for option in options:
        assert f"`{option}" in README, option
