"""A model remembers the poses that it was fitted to, and says so where it meets them again."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

import pytest
from commands import document, missing, output

import robacc
from robacc.effects.specification import with_effect_units
from robacc.errors import InputError
from robacc.robots.yaml_robot import parse_robot, robot_to_yaml

ROOT = Path(__file__).resolve().parents[2]
POSES, ROBOT = (str(ROOT / "sample_data" / name) for name in ("poses.csv", "robot.yaml"))
WARNING = "poses.csv: the robot file was fitted to these same poses, so the errors show how well the model fits them"
NOTE = "the robot file was fitted to these same poses"


@pytest.fixture(scope="module")
def model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("model") / "better.yaml"
    fit = "base_frame,tool_frame,gear_ratio[j2]"
    output("calibrate", POSES, "--robot", ROBOT, "--fit", fit, "--write-model", str(path))
    return path


@pytest.fixture(scope="module")
def others(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The same poses in a file that is not the same, as if they had been measured again."""
    path = tmp_path_factory.mktemp("others") / "others.csv"
    path.write_text(Path(POSES).read_text(encoding="utf-8") + "# measured again\n", encoding="utf-8")
    return path


def test_the_model_names_its_poses(model: Path, others: Path) -> None:
    digest = hashlib.sha256(Path(POSES).read_bytes()).hexdigest()
    robot = robacc.read_robot(model)
    assert robot.fitted_to == (digest,)
    robot = with_effect_units(robot)
    assert parse_robot(robot_to_yaml(robot), "again.yaml") == robot
    assert document("show", str(model))["robot"]["fitted_to"] == [digest]
    assert f"fitted   to the poses of SHA-256 {digest[:16]}…" in output("show", str(model))
    # A fit on top of a fit is of both files' poses.
    twice = robacc.calibrate(others, robot=model, fit="base_frame")
    assert twice.robot.fitted_to == (digest, hashlib.sha256(others.read_bytes()).hexdigest())
    # The sample's arm has effects that its geometry alone does not explain.
    assert [text for text in twice.warnings if "a trace searches" not in text] == []


def test_its_own_poses_are_told_from_others(model: Path, others: Path, tmp_path: Path) -> None:
    own, other = (document("estimate", path, "--robot", str(model)) for path in (POSES, str(others)))
    assert (NOTE in own["notes"], any(WARNING in text for text in own["warnings"])) == (True, True)
    assert (NOTE in other["notes"], other["warnings"]) == (False, [])
    plain = document("estimate", POSES, "--robot", ROBOT)
    assert (plain["robot"]["effects"], plain["robot"]["fitted_to"], plain["notes"].count(NOTE)) == ([], [], 0)
    assert own["robot"]["effects"] == ["gear_ratio"]
    assert own["robot"]["fitted_to"]
    for command, more in (("calibrate", ("--fit", "base_frame")), ("iso9283", ())):
        again = document(command, POSES, "--robot", str(model), *more)
        assert any(WARNING in text for text in again["warnings"]), command
    for name, one in (("own", own), ("other", other)):
        (tmp_path / f"{name}.json").write_text(json.dumps(one), encoding="utf-8")
    compared = document("compare", str(tmp_path / "own.json"), str(tmp_path / "other.json"))
    told = "made differently, robot file: own: fitted to the same poses; other: not fitted to these poses"
    assert any(text.startswith(told) for text in compared["warnings"])


def test_arrays_have_a_digest_too(model: Path) -> None:
    data = robacc.read_poses(POSES)
    arrays = robacc.Measurements(position=data.position, rotation=data.rotation, q=data.q)
    found = robacc.calibrate(arrays, robot=ROBOT, fit="base_frame,tool_frame")
    assert NOTE in robacc.estimate(arrays, robot=found.robot).notes
    assert NOTE not in robacc.estimate(data, robot=found.robot).notes


@pytest.mark.slow
def test_the_headline_is_of_the_model(model: Path, tmp_path: Path) -> None:
    pages = []
    for name, robot in (("model", str(model)), ("arm", ROBOT)):
        page = tmp_path / f"{name}.html"
        output("estimate", POSES, "--robot", robot, "--report", str(page))
        pages.append(page.read_text(encoding="utf-8"))
    assert missing(pages[0], "The measured positions differ from the model&#39;s predictions by", WARNING) == []
    assert "The measured positions differ from the commanded positions by" in pages[1]


def test_a_digest_that_is_none_is_named() -> None:
    text = "robacc: 1\nconvention: standard\nunits: {length: m, angle: rad}\n" + "fitted_to: [poses.csv]\njoints:\n"
    text += "  - {type: revolute, theta: 0, d: 1, a: 0, alpha: 0}\n"
    with pytest.raises(InputError) as caught:
        parse_robot(text, "arm.yaml")
    assert [str(problem) for problem in caught.value.problems] == [
        "arm.yaml:4, fitted_to[0]: expected the SHA-256 of a pose file, 64 hexadecimal digits, found 'poses.csv'; "
        "`write_model` writes it; do not change it"
    ]
    assert parse_robot(text.replace("poses.csv", "'" + "0" * 64 + "'"), "arm.yaml").fitted_to == ("0" * 64,)
