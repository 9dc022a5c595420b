"""Corrections that no arm needs are suspected mistakes; usual ones are not."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import independent_arm as arm
import numpy as np
import pytest
from results import run
from test_mistake_sets import made

import robacc
from robacc.effects.specification import parse_requests
from robacc.geometry import exp_so3
from robacc.measurements import Measurements
from robacc.robots.description import Robot
from robacc.tracing.calibrating import calibrate

N = 30
EFFECTS = "base_frame,tool_frame,link_geometry[j4]"


def campaign(length: float) -> tuple[Robot, Measurements]:
    """A robot file whose forearm is wrong by ``length``, and poses of the true arm."""
    q, position, _ = made(N, 5)
    robot = arm.robot()
    joints = list(robot.joints)
    joints[3] = dataclasses.replace(joints[3], parameters={**joints[3].parameters, "d": arm.DH[3][1] + length})
    return dataclasses.replace(robot, joints=tuple(joints)), Measurements(position=position, q=q)


def warnings(length: float) -> list[str]:
    """Warnings of a calibration with a nominal forearm that is wrong by ``length``."""
    robot, data = campaign(length)
    result = calibrate(robot, data, parse_requests(EFFECTS), n_folds=2)
    return [text for text in result.warnings if text.startswith("suspected data mistake")]


def files(folder: Path, length: float) -> list[str]:
    """Words of the command line: poses and robot file of a campaign."""
    robot, data = campaign(length)
    robacc.write_robot(folder / "robot.yaml", robot)
    robacc.write_poses(folder / "poses.csv", data)
    return [str(folder / "poses.csv"), "--robot", str(folder / "robot.yaml")]


def test_a_length_that_is_far_off_is_suspected_and_a_usual_correction_is_not() -> None:
    (text,) = warnings(0.2)
    assert "link_geometry.j4.d is corrected by -" in text
    assert warnings(2e-3) == []


@pytest.mark.parametrize(("size", "suspected"), [(0.1, True), (0.01, False)])
def test_orientations_of_another_convention_are_suspected(size: float, suspected: bool) -> None:
    """Rotations about random axes of some 6 degrees, as angles of another order leave them, or of half a degree."""
    q, position, exact = made(N, 5)
    rng = np.random.default_rng(3)
    turns = exp_so3(rng.normal(scale=size / np.sqrt(3), size=(3, N)))
    data = Measurements(position=position, q=q, rotation=np.einsum("ijn,jkn->ikn", exact, turns))
    result = calibrate(arm.robot(), data, parse_requests("base_frame,tool_frame"), n_folds=2)
    assert any("median orientation error" in text for text in result.warnings) == suspected


FITS = (("calibrate", "--fit"), pytest.param("trace", "--declared", marks=pytest.mark.slow))


@pytest.mark.parametrize(("command", "option"), FITS)
def test_a_model_with_a_suspected_mistake_says_so_wherever_it_is_used(
    command: str, option: str, tmp_path: Path
) -> None:
    model = tmp_path / "model.yaml"
    words = [command, *files(tmp_path, 0.2), option, EFFECTS, "--folds", "2", "--write-model", str(model)]
    outcome = run(*words)
    assert outcome.exit_code == 5
    assert "must not be used until the suspected data mistake is resolved" in outcome.stderr
    head = model.read_text().splitlines()[:3]
    assert head[1] == "# do not use this model until the following is resolved:"
    assert "link_geometry.j4.d is corrected by -" in head[2]
    text = "doubtful model: suspected data mistake: link_geometry.j4.d is corrected by -"
    for result in (robacc.predict(model, samples=20), robacc.export(model, format="mdh")):
        assert any(warning.startswith(text) for warning in result.warnings)
    # The model itself is as it was fitted: only the words are added.
    assert robacc.read_robot(model).joints[3].parameters["d"] == pytest.approx(arm.DH[3][1], abs=10e-3)


@pytest.mark.parametrize(("command", "option"), FITS)
def test_a_model_without_a_suspicion_is_written_as_ever(command: str, option: str, tmp_path: Path) -> None:
    model = tmp_path / "model.yaml"
    words = [command, *files(tmp_path, 2e-3), option, EFFECTS, "--folds", "2", "--write-model", str(model)]
    assert run(*words).exit_code == 0
    assert "suspected" not in model.read_text()
    assert "do not use" not in model.read_text()
    assert robacc.predict(model, samples=20).warnings == ()


def test_a_trace_heeds_the_suspicions_on_its_final_fit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("robacc.api.fitting.suspected_mistakes", lambda fit: ("suspected data mistake: a test",))
    model = tmp_path / "model.yaml"
    words = ["trace", *files(tmp_path, 2e-3), "--declared", EFFECTS, "--folds", "2", "--write-model", str(model)]
    assert run(*words).exit_code == 5
    assert model.read_text().splitlines()[2] == "# suspected data mistake: a test"
    assert robacc.predict(model, samples=5).warnings == ("doubtful model: suspected data mistake: a test",)
