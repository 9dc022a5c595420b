"""Facts of one campaign: part of the prediction of its own poses, not inherited by other poses."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
import yaml
from arms import arm

import robacc
from robacc.errors import InputError, MissingColumnError
from robacc.modelling.robot_file import read_robot
from robacc.poses.csv_file import format_poses
from robacc.robots.description import Frame, Robot
from robacc.robots.yaml_robot import parse_robot, robot_to_yaml

DRIFT = {
    "effect": "frame_drift",
    "origin_s": 600,
    "span_s": 600,
    "degree": 1,
    "turning": False,
    "values": {"x": 1e-3, "z": -5e-4},
}
BASE = Frame((0.3, -0.2, 0.1), (0.0, 0.0, 0.02))


def measured(robot: Robot, n: int, seed: int) -> robacc.Measurements:
    plan = {"time_step": 1200 / n, "noise": 2e-5, "noise_orientation": 2e-5}
    return robacc.simulate(robot, poses=n, seed=seed, sampling="random", **plan).data


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the poses of a campaign, held-out poses, another day's poses, and the model of the campaign."""
    moved = dataclasses.replace(arm("puma560").robot, base=BASE)
    drifting = dataclasses.replace(moved, effects=(DRIFT,))
    poses = {"poses": (drifting, 120, 1), "held_out": (drifting, 60, 2), "another_day": (moved, 60, 3)}
    folder = written(tmp_path_factory.mktemp("campaign"), **poses)
    (folder / "untimed.csv").write_text(format_poses(dataclasses.replace(measured(moved, 60, 4), time=None)))
    fitted = robacc.calibrate(
        folder / "poses.csv", robot=folder / "nominal.yaml", fit="base_frame,tool_frame,frame_drift", folds=2
    )
    fitted.write_model(folder / "model.yaml")
    (folder / "rms").write_text(repr(fitted.after.fitted.position.rms))
    return folder


def written(folder: Path, **arms: tuple[Robot, int, int]) -> Path:
    """A folder with the nominal arm and with poses of arms, each with their number and seed."""
    (folder / "nominal.yaml").write_text(robot_to_yaml(arm("puma560").robot))
    for name, made in arms.items():
        (folder / f"{name}.csv").write_text(format_poses(measured(*made)))
    return folder


def said(result: robacc.Result, *parts: str) -> bool:
    """Whether a warning has all the parts."""
    return any(all(part in text for part in parts) for text in result.warnings)


def estimated(folder: Path, poses: str, **more: str) -> robacc.Result:
    return robacc.estimate(folder / f"{poses}.csv", robot=folder / "model.yaml", **more)


def rms(folder: Path, poses: str, **more: str) -> float:
    return estimated(folder, poses, **more).position.rms


def test_held_out_poses_of_the_campaign_are_recognised_by_their_errors(campaign: Path) -> None:
    result = estimated(campaign, "held_out")
    assert result.position.rms < 1.2 * float((campaign / "rms").read_text())
    assert said(result, "they are applied because they change the position error")
    assert rms(campaign, "held_out", campaign="keep") == result.position.rms


@pytest.mark.parametrize(
    ("poses", "parts"),
    [("another_day", ("frame_drift", "left out")), ("untimed", ("needs the column time_s", "left out"))],
)
def test_another_day_does_not_inherit_the_drift(campaign: Path, poses: str, parts: tuple[str, ...]) -> None:
    result = estimated(campaign, poses)
    assert (result.position.rms < 1e-4, said(result, *parts)) == (True, True)


def test_what_keeping_the_campaign_costs_other_poses(campaign: Path) -> None:
    assert rms(campaign, "another_day", campaign="keep") > 3e-4
    with pytest.raises(MissingColumnError):
        rms(campaign, "untimed", campaign="keep")


def test_drift_and_frames_stand_in_the_campaign_of_the_model(campaign: Path) -> None:
    document = yaml.safe_load((campaign / "model.yaml").read_text())
    assert "effects" not in document
    part = document["campaign"]
    assert (part["poses"], [effect["effect"] for effect in part["effects"]]) == (document["fitted_to"], ["frame_drift"])
    assert part["effects"][0]["validity"]["time_s"] == pytest.approx([0, 1190], abs=1)
    assert part["before"]["base"]["xyz"] == [0.0, 0.0, 0.0]
    robot = read_robot(campaign / "model.yaml")
    assert robot.base.xyz == pytest.approx(BASE.xyz, abs=1e-4)
    assert parse_robot(robot_to_yaml(robot), "again.yaml") == robot


def test_the_poses_of_the_campaign_get_the_fitted_prediction(campaign: Path) -> None:
    result = robacc.estimate(campaign / "poses.csv", robot=campaign / "model.yaml")
    assert result.position.rms == pytest.approx(float((campaign / "rms").read_text()), rel=1e-9)
    assert not said(result, "campaign")
    again = robacc.calibrate(campaign / "poses.csv", robot=campaign / "model.yaml", fit="base_frame", folds=2)
    # The noise beside base and tool alone is a little larger than beside the drift too, and so position and orientation
    # weigh a little differently when both are registered again.
    assert again.nominal.fitted.position.rms == pytest.approx(result.position.rms, rel=1e-4)
    assert [effect["effect"] for effect in again.robot.campaign.effects] == ["frame_drift"]
    assert again.robot.campaign.base == Frame()
    traced = robacc.trace(campaign / "poses.csv", robot=campaign / "model.yaml", folds=2)
    assert traced.nominal.fitted.position.rms <= result.position.rms * 1.01
    assert not traced.findings


def test_drop_restores_the_frames_before_the_campaign(campaign: Path) -> None:
    aligned = rms(campaign, "another_day", campaign="drop", align="base_frame,tool_frame")
    assert aligned < 1e-4
    raw = rms(campaign, "another_day", campaign="drop", align="none")
    assert raw == pytest.approx(np.linalg.norm(BASE.xyz), rel=0.2)
    # Frames that do not agree are registered without being asked.
    assert rms(campaign, "another_day", campaign="drop") == aligned


def test_simulation_leaves_the_campaign_out_and_says_so(campaign: Path) -> None:
    result = robacc.simulate(campaign / "model.yaml", poses=5)
    assert said(result, "frame_drift", "left out")
    kept = robacc.simulate(campaign / "model.yaml", poses=5, time_step=200, campaign="keep")
    assert np.abs(kept.data.position - result.data.position).max() > 1e-4


def test_a_wrong_campaign_is_refused(campaign: Path, tmp_path: Path) -> None:
    text = (campaign / "model.yaml").read_text()
    (tmp_path / "wrong.yaml").write_text(text.replace("effect: frame_drift", "effect: frame_drft"))
    with pytest.raises(InputError, match=r"campaign.effects\[0\].*frame_drft"):
        read_robot(tmp_path / "wrong.yaml")


@pytest.fixture(scope="module")
def shifted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with poses of a base that is pushed 0.4 mm after 600 s, with later poses, and with the fitted model."""
    nominal = arm("puma560").robot
    step = {"effect": "step", "part": "base", "from_time_s": 600.0, "values": {"x": 4e-4, "y": 0.0, "z": 0.0}}
    stepping = dataclasses.replace(nominal, base=BASE, effects=(step,))
    pushed = dataclasses.replace(nominal, base=dataclasses.replace(BASE, xyz=(0.3004, -0.2, 0.1)))
    poses = {"poses": (stepping, 120, 1), "held_out": (stepping, 60, 2), "later": (pushed, 60, 3)}
    folder = written(tmp_path_factory.mktemp("shifted"), **poses)
    traced = robacc.trace(
        folder / "poses.csv", robot=folder / "nominal.yaml", declared="base_frame,tool_frame", folds=2
    )
    assert [finding.effect for finding in traced.findings] == ["step"]
    traced.write_model(folder / "model.yaml")
    return folder


def test_poses_of_a_campaign_with_a_step_follow_their_times(shifted: Path) -> None:
    later = estimated(shifted, "later")
    # Later poses, whose clock starts anew, are taken after the step.
    assert (later.position.rms < 6e-5, said(later, "taken as measured after the step")) == (True, True)
    assert rms(shifted, "later", campaign="keep") > 2e-4
    assert rms(shifted, "held_out") < 6e-5
