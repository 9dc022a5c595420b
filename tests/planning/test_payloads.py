"""Payloads of a plan: which poses have which, one mounting each, and what an effect of the payload costs."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from commands import refused

import robacc
from robacc.api.expected import Planned

ROBOT = Path(__file__).resolve().parents[2] / "sample_data" / "robot.yaml"
FIT = "base_frame,tool_frame,joint_offset,payload_compliance[j2,j3]"
NOISE = 2e-5


def planned(purpose: str = "calibrate", payload: tuple[float, ...] = (0.0, 5.0), **more: object) -> Planned:
    arguments = {"candidates": 150, "noise": f"{NOISE}m", "repeatability": "0mm", **more}
    return robacc.plan(ROBOT, purpose=purpose, payload=payload, **arguments)  # type: ignore[arg-type]


def with_effects(tmp_path: Path, *entries: dict[str, object]) -> Path:
    text = yaml.safe_load(ROBOT.read_text())
    text["effects"] = list(entries)
    path = tmp_path / "model.yaml"
    path.write_text(yaml.safe_dump(text))
    return path


@pytest.fixture(scope="module")
def plan() -> Planned:
    return planned(fit=FIT, poses=12)


def test_each_payload_is_mounted_once(plan: Planned) -> None:
    payload = plan.visits().payload
    assert (np.count_nonzero(np.diff(payload)), set(payload.tolist())) == (1, {0.0, 5.0})
    blocks = plan.payload_blocks
    assert [block["payload_kg"] for block in blocks] == [0.0, 5.0]
    assert sum(block["n_poses"] for block in blocks) == 12
    assert sum(block["n_visits"] for block in blocks) == payload.size
    # Every payload has its own drift checks, at its start and at its end.
    roles = plan.route.roles
    for block in blocks:
        last = block["first_visit"] + block["n_visits"] - 2
        assert roles[block["first_visit"] - 1] == roles[last] == "check"


def test_standard_errors_are_those_of_the_simulated_poses(plan: Planned, tmp_path: Path) -> None:
    """By the derivative of simulated positions: the covariance of least squares, without a prior."""
    path = tmp_path / "plan.csv"
    plan.write(path)
    joints_with_load, size, step = ("j2", "j3"), 1e-5, 1e-3
    columns = []

    def positions(**change: object) -> np.ndarray:
        text = yaml.safe_load(ROBOT.read_text()) | change
        robot = tmp_path / "changed.yaml"
        robot.write_text(yaml.safe_dump(text))
        return robacc.simulate(robot, at=path, position_only=True).data.position.ravel()

    nominal = positions()
    original = yaml.safe_load(ROBOT.read_text())
    for joint in joints_with_load:
        entry = {"effect": "payload_compliance", "joints": [joint], "values": {joint: size}}
        columns.append((positions(effects=[entry]) - nominal) / np.radians(size))
    for number in range(1, 5):
        joints = [dict(joint) for joint in original["joints"]]
        joints[number]["theta"] = joints[number].get("theta", 0.0) + step
        columns.append((positions(joints=joints) - nominal) / step)
    for frame in ("base", "tool"):
        for key in ("xyz", "rpy")[: 2 if frame == "base" else 1]:
            for axis in range(3):
                placed = {"xyz": [0.0] * 3, "rpy": [0.0] * 3} | original.get(frame, {})
                placed = {name: list(values) for name, values in placed.items()}
                placed[key][axis] += step
                columns.append((positions(**{frame: placed}) - nominal) / step)
    design = np.array(columns).T
    std = NOISE * np.sqrt(np.diag(np.linalg.inv(design.T @ design)))
    expected = {entry["name"]: entry["std"] for entry in plan.coefficients}
    for i, joint in enumerate(joints_with_load):
        # Differences of the file's mm and degrees leave some curvature, and the other constants have weak priors: 1 %.
        assert expected[f"payload_compliance.{joint}"] == pytest.approx(std[i], rel=0.01)


def test_the_poses_are_better_than_random_ones_with_random_payloads(plan: Planned) -> None:
    assert plan.accuracy["planned"]["rms_m"] < 0.95 * plan.accuracy["planned"]["random_rms_m"]


def test_acceptance_gives_every_payload_its_share() -> None:
    plan = planned("acceptance", poses=11, repeats=0, check_every=0)
    assert ([block["n_poses"] for block in plan.payload_blocks], np.unique(plan.q, axis=1).shape[1]) == ([6, 5], 11)
    assert plan.validation is None


def test_a_trace_tests_the_effect_of_the_payload() -> None:
    loaded = planned("trace", poses=14, candidates=60)
    assert any(limit["effect"] == "payload_compliance" for limit in loaded.detectability["limits"])  # type: ignore[union-attr]
    empty = planned("trace", (), poses=14, candidates=60)
    assert "payload_compliance" in empty.detectability["missing"]  # type: ignore[union-attr]


def test_validation_poses_have_payloads() -> None:
    plan = planned(fit=FIT, poses=10, validation=5)
    assert plan.validation is not None
    assert plan.validation.payload.tolist() == [0.0, 0.0, 0.0, 5.0, 5.0]
    assert "payload_kg" in plan.validation_csv()


def test_a_model_whose_effects_need_circumstances_is_planned(tmp_path: Path) -> None:
    path = with_effects(
        tmp_path,
        {"effect": "payload_compliance", "joints": ["j2"], "values": {"j2": 1e-6}},
        {"effect": "backlash", "joints": ["j3"], "values": {"j3": 1e-4}},
        {"effect": "thermal_expansion", "values": {"value": 1e-5}},
    )
    plan = robacc.plan(path, candidates=100, poses=12)
    assert [block["payload_kg"] for block in plan.payload_blocks] == [0.0]


def test_the_simulation_carries_the_planned_payload(plan: Planned, tmp_path: Path) -> None:
    path = tmp_path / "plan.csv"
    plan.write(path)
    simulated = robacc.simulate(ROBOT, at=path, position_only=True).data
    np.testing.assert_array_equal(simulated.payload, plan.visits().payload)
    # A payload that is given replaces the planned one.
    assert set(robacc.simulate(ROBOT, at=path, payload=[3.0]).data.payload.tolist()) == {3.0}  # type: ignore[union-attr]


def test_each_payload_has_its_program(plan: Planned, tmp_path: Path) -> None:
    programs = plan.programs(tmp_path / "plan.src")
    assert [Path(name).name for name in programs] == ["plan_0kg.src", "plan_5kg.src"]
    counts = [text.count("PTP {") for text in programs.values()]
    assert counts == [block["n_visits"] for block in plan.payload_blocks]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--fit", FIT), "payload_compliance needs loads: no payload_kg column; give --payload, such as 0,5"),
        (("--fit", FIT, "--payload", "0"), "payload_kg is zero throughout; give --payload"),
        (("--fit", "base_frame,frame_drift"), "frame_drift cannot be planned"),
        (("--payload", "0,5"), "no effect of --fit depends on the payload, so any pose may have any; add payload"),
        (("--payload", "5,5"), "--payload: expected at most 5 different masses, found 5, 5"),
        (("--payload=-1,2",), "--payload: expected masses of at least 0 kg, found -1"),
        (("--payload", "5kg"), "--payload: expected numbers separated by ',', found '5kg'"),
    ],
)
def test_messages(options: tuple[str, ...], message: str) -> None:
    assert message in refused("plan", ROBOT, "--candidates", "50", *options)
