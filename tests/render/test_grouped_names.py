"""Names in few words, and coefficients of uncertain masses in one sentence."""

from __future__ import annotations

import io

import pytest

import robacc
from robacc.modelling.robot_file import read_robot
from robacc.render.text import grouped
from robacc.robots.library import find_arm
from robacc.simulation.simulate import Plan, simulate


@pytest.mark.parametrize(
    ("names", "text"),
    [
        (["tool_frame.a.roll", "tool_frame.a.yaw", "joint_offset.j1"], "tool_frame.a (roll, yaw), joint_offset.j1"),
        (["alone"], "alone"),
        (["a", "b"], "a, b"),
    ],
)
def test_names_with_a_common_beginning_stand_together(names: list[str], text: str) -> None:
    assert grouped(names) == text


def test_a_calibration_without_orientations_and_masses_stays_short() -> None:
    entry = find_arm("irb120_3_58")
    assert entry is not None
    robot = read_robot(entry.path)
    data = simulate(robot, Plan(50, seed=2, noise_position=5e-5, orientation=False)).data
    fit = ("base_frame", "tool_frame", "joint_offset", "link_geometry", "joint_compliance[j2]")
    result = robacc.calibrate(data, robot=robot, fit=fit)
    stream = io.StringIO()
    result.draw(stream, full=True)
    lines = stream.getvalue().splitlines()
    assert sum("not identifiable" in line for line in lines) == 2
    assert not any(".hx2" in line for line in lines)
    assert sum(line.startswith("joint_compliance.j2: ") for line in lines) == 1
    # The JSON result keeps each of them.
    text = result.to_json()
    assert text.count('"joint_compliance.j2.h') > 10
    assert all(dropped.name in text for dropped in result.identifiability.dropped)
