"""README is short, its example is what the program prints, and its commands and links exist."""

import re
import sys
import tomllib
from pathlib import Path

import pytest

from robacc.cli.main import COMMANDS

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "docs" / "tools"))

from transcripts import Session, agrees, blocks, commands  # noqa: E402

README = (ROOT / "README.md").read_text(encoding="utf-8")
EXAMPLE = [shown for block in blocks(README) for shown in commands(block.text)]


def test_it_is_short() -> None:
    assert len(README.splitlines()) <= 150
    assert sum(len(shown.output) for shown in EXAMPLE) <= 45
    assert README.count("](docs/pictures/") == 1


def test_the_example_asks_for_the_accuracy_then_for_the_cause_and_closes_the_loop() -> None:
    loop = ["estimate", "trace", "simulate", "simulate", "estimate", "correct", "simulate", "estimate"]
    assert [shown.command.split()[:2] for shown in EXAMPLE] == [["robacc", name] for name in loop]


@pytest.fixture(scope="module")
def outputs(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Outputs of all commands of the example, in one session."""
    session = Session(tmp_path_factory.mktemp("example"))
    return [session.run(shown.command) for shown in EXAMPLE]


@pytest.mark.parametrize("number", range(len(EXAMPLE)), ids=[shown.command.split()[1] for shown in EXAMPLE])
def test_the_example_is_real_output(number: int, outputs: list[str]) -> None:
    shown, output = EXAMPLE[number], outputs[number]
    assert agrees(shown.output, output), f"{shown.command}\nprints\n{output}"


def test_one_command_runs_the_main_job_and_one_the_tests() -> None:
    setup = [block for block in re.findall(r"```sh\n(.*?)```", README, re.DOTALL) if "venv" in block]
    main_job, tests = setup
    assert main_job.count("\n") == tests.count("\n") == 1
    assert f".venv/bin/{EXAMPLE[1].command}\n" in main_job
    assert "pytest" in tests


def test_every_extra_for_users_is_named() -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    (line,) = [line for line in README.splitlines() if line.startswith("Extras: ")]
    assert set(re.findall(r"`(\w+)`", line)) == extras.keys() - {"docs", "dev"}


@pytest.mark.parametrize("name", [*COMMANDS, "show robots", "show effects", "show schema"])
def test_every_command_is_named(name: str) -> None:
    assert f"robacc {name}" in README


def test_every_link_leads_to_a_file() -> None:
    links = re.findall(r"\]\(([^)#]+)[^)]*\)", README)
    assert {"CONTRIBUTING.md", "docs/tutorial.md", "docs/architecture.md", "docs/glossary.md"} <= set(links)
    for link in links:
        assert (ROOT / link).exists(), link
