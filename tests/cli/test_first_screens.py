"""First screens of the commands on the sample data, at 80 columns, as a user sees them.

``UPDATE_GOLDEN=1 python -m pytest tests/cli/test_first_screens.py`` writes the golden texts again.
"""

from __future__ import annotations

import os
import re
import shutil
from pathlib import Path

import pytest
from commands import missing, one_line, output, refused, run

ROOT = Path(__file__).resolve().parents[2]
GOLDEN = Path(__file__).resolve().parents[1] / "golden"
SCREENS = {
    "estimate": "estimate poses.csv --robot robot.yaml",
    "trace": "trace poses.csv --robot robot.yaml",
    "calibrate": "calibrate poses.csv --robot robot.yaml --write-model model.yaml",
    "correct": "correct poses.csv --model model.yaml --output corrected.csv",
    "plan": "plan robot.yaml --output plan.csv --program plan.src",
    "correct_program": "correct plan.src --model model.yaml --output corrected.src",
    "plan_trace": "plan robot.yaml --for trace --candidates 1000",
    "plan_acceptance": "plan robot.yaml --for acceptance --grade D --candidates 1000",
}
UNKNOWN_WORDS = ("evidence", "prior odds", "folds", "equilibrium", "campaign")
"""Words that a field engineer does not know."""
NUMBER = re.compile(r" *(?<![\w.])[-+]?(\d+(?:\.\d+)?)(?!\w)")
"""A number with the spaces before it, whose count changes with its digits; no digits of names."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the sample data."""
    return tmp_path_factory.mktemp("first")


@pytest.fixture(scope="module")
def screens(folder: Path) -> dict[str, str]:
    """Standard output of each command, in the folder."""
    for name in ("poses.csv", "robot.yaml"):
        shutil.copy(ROOT / "sample_data" / name, folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        return {name: output(*words.split()) for name, words in SCREENS.items()}


@pytest.mark.parametrize("name", SCREENS)
def test_a_first_screen_is_as_agreed(name: str, screens: dict[str, str]) -> None:
    path, screen = GOLDEN / f"first_screen_{name}.txt", screens[name]
    if os.environ.get("UPDATE_GOLDEN"):
        path.write_text(screen, encoding="utf-8")
    agreed = path.read_text(encoding="utf-8")
    assert NUMBER.sub("#", screen) == NUMBER.sub("#", agreed)
    numbers, others = ([float(text) for text in NUMBER.findall(each)] for each in (agreed, screen))
    assert others == pytest.approx(numbers, rel=0.02)


@pytest.mark.parametrize("name", SCREENS)
def test_a_first_screen_is_short_and_says_what_is_next(name: str, screens: dict[str, str]) -> None:
    lines = screens[name].splitlines()
    assert len(lines) <= 25
    assert max(map(len, lines)) <= 80
    assert any(line.startswith("next: ") for line in lines)
    assert [word for word in UNKNOWN_WORDS if word in screens[name].lower()] == []


def test_one_summary_says_that_a_model_has_nothing_to_correct(screens: dict[str, str], folder: Path) -> None:
    for targets, written in (("poses.csv", "same.csv"), ("plan.src", "same.src")):
        screen = output("correct", folder / targets, "--model", folder / "robot.yaml", "-o", folder / written)
        assert "robot.yaml: nothing to correct" in one_line(screen)
        assert "error before" not in screen
    assert (folder / "same.src").read_bytes() == (folder / "plan.src").read_bytes()


def test_refused_targets_stand_once_for_each_reason(screens: dict[str, str], folder: Path) -> None:
    words = ("--model", folder / "model.yaml", "-o", folder / "none", "--most")
    ended = run("correct", folder / "poses.csv", *words, "0.4mm")
    told = (
        "(line 3, line 4, line 5, line 6, line 7 and 44 more): at the first, the correction of",
        "2 targets (line 21",
    )
    assert (missing(ended.stderr, *told), ended.stderr.count("is larger than 0.4 mm")) == ([], 1)
    for targets, first in (("poses.csv", "57 targets (line 3"), ("plan.src", "5 targets (line 13")):
        message = refused("correct", folder / targets, *words, "0.01mm", status=3)
        assert f": not corrected: {first}" in message
        assert message.count("error: ") < 5
        assert message.count("tip: no target can be corrected") == 1
