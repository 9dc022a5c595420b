"""Calibration files of LeRobot: the degrees of the corrected file are those of the calibrated joints."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import robacc
from robacc import UsageError
from robacc.robots.arm import Arm
from robacc.robots.description import Robot

NAMES = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll")
RANGES = ((750, 3420), (893, 3207), (850, 3078), (817, 3190), (0, 4095), (2010, 3500))
HOMING = (101, -1208, 1502, -1997, 33, 1240)
OFFSETS = np.array([1.2, -0.9, 0.7, -3.04, 0.4])
"""Degrees by which LeRobot's angles are short."""
QUARTER_OF_A_COUNT = 360 / 4095 / 4


def calibration(names: tuple[str, ...] = (*NAMES, "gripper")) -> dict[str, dict[str, int]]:
    return {
        name: {"id": i + 1, "drive_mode": 0, "homing_offset": homing, "range_min": ends[0], "range_max": ends[1]}
        for i, (name, ends, homing) in enumerate(zip(names, RANGES, HOMING, strict=True))
    }


def degrees(motor: dict[str, int], encoder: float, make: str) -> float:
    """What LeRobot reports for a position of the motor's encoder, counts."""
    sign = {"Feetech": -1, "Dynamixel": 1}[make]
    present = encoder + sign * motor["homing_offset"]
    return (present - (motor["range_min"] + motor["range_max"]) / 2) * 360 / 4095


def arms(sign: int = 1) -> tuple[Robot, Robot]:
    """The arm as it was believed to be, and with its true zeros."""
    nominal = robacc.read_robot("so101")
    nominal = dataclasses.replace(
        nominal, joints=(dataclasses.replace(nominal.joints[0], sign=sign), *nominal.joints[1:])
    )
    joints = [
        dataclasses.replace(
            joint, parameters={**joint.parameters, "theta": joint.parameters["theta"] + joint.sign * np.radians(offset)}
        )
        for joint, offset in zip(nominal.joints, OFFSETS, strict=True)
    ]
    return nominal, dataclasses.replace(nominal, joints=tuple(joints))


def exported(folder: Path, before: Any, nominal: Robot, model: Robot) -> robacc.Exported:
    path = folder / "calibration.json"
    path.write_text(before if isinstance(before, str) else json.dumps(before))
    return robacc.export(model, format="lerobot", nominal=nominal, template=path)


@pytest.mark.parametrize("make", ["Feetech", "Dynamixel"])
@pytest.mark.parametrize("sign", [1, -1])
def test_the_corrected_file_reports_the_true_angles(make: str, sign: int, tmp_path: Path) -> None:
    before, (nominal, model) = calibration(), arms(sign)
    result = exported(tmp_path, before, nominal, model)
    after = json.loads(result.text)
    encoder = np.random.default_rng(2).uniform(0, 4096, 5)
    reported, corrected = (
        np.array([degrees(motors[name], at, make) for name, at in zip(NAMES, encoder, strict=True)])
        for motors in (before, after)
    )
    assert np.max(np.abs(corrected - reported - OFFSETS)) <= QUARTER_OF_A_COUNT + 1e-9
    # The nominal arm at the corrected angles is the calibrated arm at the angles that were reported.
    poses = (
        Arm.of(arm).chain.forward(np.radians(angles)[:, None]).matrices()[0]
        for arm, angles in ((nominal, corrected), (result.controller, reported), (model, reported))
    )
    attained, stated, true = poses
    np.testing.assert_allclose(attained, stated, atol=1e-12)
    # Five joints, each a quarter of a count off, on an arm of 0.5 m.
    assert np.linalg.norm(attained[:3, 3] - true[:3, 3]) < 5 * np.radians(QUARTER_OF_A_COUNT) * 0.5


def test_only_the_ranges_change_and_stay_within_the_recorded_ones(tmp_path: Path) -> None:
    before = calibration()
    result = exported(tmp_path, before, *arms())
    after = json.loads(result.text)
    assert after["gripper"] == before["gripper"]
    for name, offset in zip(NAMES, OFFSETS, strict=True):
        old, new = before[name], after[name]
        assert {key: new[key] for key in ("id", "drive_mode", "homing_offset")} == {
            key: old[key] for key in ("id", "drive_mode", "homing_offset")
        }
        cut = old["range_max"] - new["range_max"] if offset > 0 else new["range_min"] - old["range_min"]
        assert cut == round(2 * abs(offset) * 4095 / 360)
        assert (new["range_min"] == old["range_min"]) == (offset > 0)
    assert result.not_carried == (
        "link geometry",
        "zeros between counts: up to 0.021°",
        "range: up to 6.1° at one end of a joint",
    )
    assert 0 < result.remaining.orientation_rms < np.radians(2 * QUARTER_OF_A_COUNT)


def test_joints_of_other_names_have_their_motors_in_order(tmp_path: Path) -> None:
    nominal, model = arms()
    renamed = [
        dataclasses.replace(
            arm, joints=tuple(dataclasses.replace(joint, name=f"joint_{i}") for i, joint in enumerate(arm.joints))
        )
        for arm in (nominal, model)
    ]
    before = calibration()
    shuffled = dict(reversed(before.items()))
    assert json.loads(exported(tmp_path, shuffled, *renamed).text) == json.loads(
        exported(tmp_path, before, nominal, model).text
    )


def test_a_model_without_other_zeros_leaves_the_file_alone(tmp_path: Path) -> None:
    before, (nominal, _) = calibration(), arms()
    result = exported(tmp_path, before, nominal, nominal)
    assert (json.loads(result.text), result.not_carried) == (before, ())


def changed(**values: object) -> str:
    before: Any = calibration()
    before["elbow_flex"] |= values
    return json.dumps(before)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "`template` is not JSON: line 1"),
        ("[]", "is no calibration of LeRobot: expected motors, each with drive_mode, homing_offset, id"),
        ('{"homing_offset": [0, 0], "motor_names": ["a", "b"]}', "calibrate an arm of LeRobot before 0.2 again"),
        (changed(range_min=0.5), "is no calibration of LeRobot"),
        (changed(range_min=-90), "the range of elbow_flex begins at -90; a motor with counts begins at 0 or above"),
        (changed(range_min=3100), "the range of elbow_flex is from 3100 to 3078"),
        (changed(range_min=3070), r"elbow_flex is 0\.7° off, more than its range in `template` allows"),
        (json.dumps(calibration(tuple("abcdef"))).replace('"id": 3', '"id": 4'), "are not those of the model"),
    ],
)
def test_other_files_are_refused(text: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=message):
        exported(tmp_path, text, *arms())


def test_both_files_are_needed() -> None:
    nominal, model = arms()
    with pytest.raises(UsageError, match=r"the format lerobot needs `nominal`, .*, and `template`"):
        robacc.export(model, format="lerobot", nominal=nominal)
