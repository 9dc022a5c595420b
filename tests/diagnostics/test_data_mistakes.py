"""Mistakes in the data or the robot file are reported; good data are accepted."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from arms import CONFIGURED, arm
from typer.testing import CliRunner

from robacc.cli.main import app
from robacc.diagnostics.data_mistakes import check_data, find_mistake
from robacc.errors import InputError
from robacc.geometry import quaternion_from_rotation, rotation_from_quaternion
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.robots.description import Frame, Robot
from robacc.robots.yaml_robot import robot_to_yaml
from robacc.simulation.simulate import Plan, simulate
from robacc.tracing.trace import trace

ERRORS = (
    {"effect": "joint_offset", "joints": ["j2", "j3"], "values": {"j2": 2e-3, "j3": -1e-3}},
    {"effect": "backlash", "joints": ["j2"], "values": {"j2": 2e-4}},
)
"""Errors of a real arm: three millimetres, which is no mistake."""


@cache
def good(orientation: bool = True) -> Measurements:
    plan = Plan(30, seed=6, noise_position=5e-5, noise_orientation=1e-4, orientation=orientation)
    robot = dataclasses.replace(
        arm("puma560").robot, effects=ERRORS, base=Frame((2.0, -3.0, 0.5), (0.3, -0.7, 2.9)), tool=Frame((0, 0.05, 0.1))
    )
    return simulate(robot, plan).data


def joints(
    change: Callable[[np.ndarray], np.ndarray], row: int | list[int] | None = None
) -> Callable[[Measurements], Measurements]:
    def changed(data: Measurements) -> Measurements:
        q = data.q.copy()
        at = slice(None) if row is None else row
        q[at] = change(q[at])
        return dataclasses.replace(data, q=q)

    return changed


def position(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Measurements], Measurements]:
    """Of the positions alone, as a wrong export has them."""
    return lambda data: dataclasses.replace(data, position=change(data.position))


MISTAKES = {
    "sign of j3": (joints(np.negative, 2), "the sign of joint j3 seems to be reversed"),
    "sign of j6": (joints(np.negative, 5), "the sign of joint j6 seems to be reversed"),
    "degrees": (joints(np.rad2deg), "the joint columns seem to be in degrees"),
    "one in degrees": (joints(np.rad2deg, 1), "the column of joint j2 seems to be in degrees"),
    "mm": (position(lambda p: 1e3 * p), "the positions seem to be in millimetres"),
    "um": (position(lambda p: 1e6 * p), "the positions seem to be in micrometres"),
    "mirrored": (position(lambda p: p * [[1], [-1], [1]]), "the column y seems to have a reversed sign"),
    "x and z": (position(lambda p: p[::-1]), "the columns x and z seem to be exchanged"),
    "q2 and q5": (joints(lambda two: two[::-1], [1, 4]), "the columns of joints j2 and j5 seem to be exchanged"),
    "q5 and q6": (joints(lambda two: two[::-1], [4, 5]), "the columns of joints j5 and j6 seem to be exchanged"),
}


REFUSED = [
    (joints(lambda q: np.roll(q, -1, axis=1)), "^the measured poses seem to be shifted by one row down against"),
    (joints(lambda q: np.roll(q, 1, axis=1)), "^the measured poses seem to be shifted by one row up against"),
    (MISTAKES["sign of j3"][0], "^the sign of joint j3 seems to be reversed: with base and tool registered, the .* mm"),
    # The file holds x, y, z, w under the names qw, qx, qy, qz.
    (
        lambda data: dataclasses.replace(
            data, rotation=rotation_from_quaternion(np.roll(quaternion_from_rotation(data.rotation), -1, axis=0))
        ),
        "the quaternions seem to be in the order x, y, z, w",
    ),
]


@pytest.mark.parametrize(("change", "message"), REFUSED)
def test_a_mistake_is_refused_before_a_search(change: Callable[[Measurements], Measurements], message: str) -> None:
    with pytest.raises(InputError, match=message):
        check_data(arm("puma560").robot, change(good()))
    with pytest.raises(InputError, match=message):
        trace(Model.of(arm("puma560").robot), change(good()))


CASES = [(which, False) for which in MISTAKES] + [(which, True) for which in ("sign of j6", "mirrored", "x and z")]


@pytest.mark.parametrize(("which", "orientation"), CASES)
def test_each_mistake_is_named(which: str, orientation: bool) -> None:
    change, name = MISTAKES[which]
    if not orientation and which in ("mirrored", "x and z"):
        name = "the positions seem to be in a left-handed frame"
    mistake = find_mistake(arm("puma560").robot, change(good(orientation)))
    assert mistake.name == name
    assert mistake.after < mistake.before / 8
    assert mistake.text.startswith(f"{name}: with base and tool registered, the median error is ")


@pytest.mark.parametrize(("name", "other"), [("panda", "standard"), ("puma560", "modified")])
def test_a_table_of_the_other_convention(name: str, other: str) -> None:
    robot = arm(name).robot
    data = simulate(robot, Plan(30, seed=2, noise_position=5e-5, orientation=False)).data
    wrong = dataclasses.replace(robot, convention=other)
    with pytest.raises(InputError, match=f"the {robot.convention} Denavit-Hartenberg convention.*set convention"):
        check_data(wrong, data)
    assert find_mistake(robot, data) is None


@pytest.mark.parametrize("name", [*CONFIGURED, "urdf:puma560", pytest.param("targets:puma560", marks=pytest.mark.slow)])
def test_good_data_hold_no_mistake(name: str) -> None:
    robot = arm(name).robot
    rng = np.random.default_rng(0)
    base = Frame(tuple(rng.uniform(-4, 4, 3)), tuple(rng.uniform(-1.5, 1.5, 3)))
    for seed, orientation in ((0, True), (1, False)):
        plan = Plan(25, seed=seed, noise_position=1e-3, noise_orientation=1e-3, outliers=3, orientation=orientation)
        data = simulate(dataclasses.replace(robot, base=base), plan).data
        assert find_mistake(robot, data) is None
        assert check_data(robot, data) == ()


@pytest.mark.slow
def test_a_large_error_that_no_mistake_explains_is_left_to_the_fit() -> None:
    robot = arm("puma560").robot
    rng = np.random.default_rng(0)
    data = good()
    turned = dataclasses.replace(data, position=data.position + rng.normal(scale=0.1, size=(3, data.n)))
    assert find_mistake(robot, turned) is None
    longer = dataclasses.replace(
        robot, effects=({"effect": "link_geometry", "joints": ["j2"], "values": {"j2.a": 0.15}},)
    )
    assert find_mistake(robot, simulate(longer, Plan(25, seed=1)).data) is None


def test_few_poses_or_no_joints_are_not_judged() -> None:
    robot, data = arm("puma560").robot, MISTAKES["mm"][0](good())
    assert check_data(robot, data.subset(np.arange(7))) == ()
    assert check_data(robot, dataclasses.replace(data, q=None)) == ()


@pytest.mark.parametrize("command", [("trace",), ("calibrate", "--fit", "base_frame,tool_frame,joint_offset")])
def test_the_command_line_exits_with_3(tmp_path: Path, command: tuple[str, ...]) -> None:
    robot: Robot = arm("puma560").robot
    (tmp_path / "arm.yaml").write_text(robot_to_yaml(robot), encoding="utf-8")
    data = MISTAKES["sign of j6"][0](good(False))
    lines = ["q1,q2,q3,q4,q5,q6,x,y,z"]
    lines += [",".join(f"{value:.9f}" for value in (*data.q[:, i], *data.position[:, i])) for i in range(data.n)]
    (tmp_path / "poses.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    name, *rest = command
    done = CliRunner().invoke(
        app, [name, str(tmp_path / "poses.csv"), "--robot", str(tmp_path / "arm.yaml"), *rest, "--format", "json"]
    )
    assert done.exit_code == 3
    assert done.stdout == ""
    assert "poses.csv: the sign of joint j6 seems to be reversed" in done.stderr
    assert "set sign: -1 for the joint in the robot file, or reverse the sign of its column" in done.stderr
