"""Status S of KRL targets: the side of the wrist centre, on the package's KUKA arms, and the solution it selects."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from robacc.api.correct import correct_program
from robacc.geometry import Array
from robacc.modelling.robot_file import read_robot
from robacc.programs.targets import allowed_by_status, joint_window
from robacc.robots.arm import Arm
from robacc.robots.description import Frame, Robot

ROBOTS = Path(__file__).resolve().parents[2] / "robacc" / "data" / "robots"


def kuka(name: str = "kr10_r1100_sixx") -> Robot:
    return read_robot(ROBOTS / f"{name}.yaml")


def status(arm: Arm, q: Array) -> list[int]:
    """The only status from 0 to 7 that joints have."""
    allowed = np.array([allowed_by_status(arm, f"S {number},T 0", q) for number in range(8)])
    assert np.all(allowed.sum(axis=0) == 1)
    return [int(number) for number in np.argmax(allowed, axis=0)]


@pytest.mark.parametrize("name", ["kr10_r1100_sixx", "kr16_r2010_2", "kr210_r2700_extra"])
def test_status_follows_the_definition(name: str) -> None:
    """Axis angles in degrees: the home pose of KRC, and poses on the other side of one border each."""
    cases = {
        (0, -90, 90, 0, 20, 0): 2,
        (70, -90, 90, 0, 20, 0): 2,
        (0, -90, 90, 0, -20, 0): 6,
        # The forearm turned back over the shoulder: behind axis 1, and in front of the line from axis 2 to axis 3.
        (0, -150, 60, 0, 20, 0): 3,
        (0, -150, 60, 90, -20, 0): 7,
        # The elbow turned the other way.
        (0, -20, -60, 0, 20, 0): 0,
        (0, -20, -60, 0, -20, 50): 4,
    }
    arm = Arm.of(dataclasses.replace(kuka(name), base=Frame()))
    q = np.radians(np.array(list(cases), dtype=float)).T
    assert status(arm, q) == list(cases.values())


def test_arms_without_a_common_wrist_centre_have_the_sign_of_axis_5_alone() -> None:
    arm = Arm.of(read_robot(ROBOTS / "crx10ia_l.yaml"))
    q = np.full((6, 2), 0.4)
    q[4, 1] = -0.4
    assert allowed_by_status(arm, "S 0", q).tolist() == allowed_by_status(arm, "S 'B011'", q).tolist() == [True, False]
    assert allowed_by_status(arm, "S 6,T 16", q).tolist() == [False, True]
    assert allowed_by_status(arm, "T 16", q).tolist() == [True, True]


def test_a_status_without_turn_is_a_configuration() -> None:
    assert joint_window("krl", "S 2", 6) is not None
    assert joint_window("krl", "", 6) is None


def test_the_status_selects_the_elbow(tmp_path: Path) -> None:
    """The same pose with the elbow on either side, without a turn."""
    nominal = kuka()
    real = dataclasses.replace(
        nominal,
        joints=tuple(
            dataclasses.replace(joint, parameters={**joint.parameters, "a": joint.parameters["a"] + 2e-4})
            for joint in nominal.joints
        ),
    )
    arm = Arm.of(dataclasses.replace(nominal, base=Frame(), tool=Frame()))
    q = np.radians(np.array([[20.0, -50.0, 40.0, 30.0, 40.0, 10.0]])).T
    pose = arm.chain.forward(q).matrices()[0]
    a, b, c = Rotation.from_matrix(pose[:3, :3]).as_euler("ZYX", degrees=True)
    x, y, z = 1e3 * pose[:3, 3]
    used = []
    for number in (2, 0):
        text = (
            f"DEF m()\n$TOOL={{X 0,Y 0,Z 0,A 0,B 0,C 0}}\n$BASE={{X 0,Y 0,Z 0,A 0,B 0,C 0}}\nPTP {{X {x:.6f},Y {y:.6f},"
        )
        text += f"Z {z:.6f},A {a:.6f},B {b:.6f},C {c:.6f},S {number}}}\nEND\n"
        path = tmp_path / f"m{number}.src"
        path.write_text(text)
        used.append(correct_program(path, model=real, nominal=nominal).corrections[0].wanted.q)
        assert allowed_by_status(arm, f"S {number}", used[-1]).all()
    np.testing.assert_allclose(used[0], q, atol=1e-5)
    assert np.abs(used[1] - q).max() > 0.5
