"""Degrees and millimetres without a unit in their names are noticed, and good data raise no alarm."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from robacc.errors import InputError
from robacc.measurements import Measurements
from robacc.poses.csv_file import read_poses
from robacc.poses.reading import KnownRobot
from robacc.poses.units import check_scale

RNG = np.random.default_rng(7)
N = 40


def good() -> dict[str, Any]:
    """Poses of a six-joint arm some metres from the instrument, SI."""
    rng = np.random.default_rng(11)
    names = [f"q{i + 1}" for i in range(6)]
    data: dict[str, Any] = dict(zip(names, rng.uniform(-3, 3, (6, N)), strict=True))
    for axis, offset in zip("xyz", (2.0, -5.0, 1.0), strict=True):
        data[axis] = offset + rng.uniform(-0.8, 0.8, N)
        data[f"cmd_{axis}"] = data[axis] - offset + rng.normal(0, 1e-3, N)
    data |= dict(zip(("roll", "pitch", "yaw"), rng.uniform(-3.1, 3.1, (3, N)), strict=True))
    data |= {f"sigma_{axis}": np.full(N, 2e-5) for axis in "xyz"} | {"sigma_r": np.full(N, 1e-4)}
    return data


def read(folder: Path, data: dict[str, Any], **options: Any) -> Measurements:
    path = folder / "poses.csv"
    np.savetxt(path, np.array(list(data.values())).T, delimiter=",", header=",".join(data), comments="", fmt="%.12g")
    return read_poses(path, **options)


def problem_texts(folder: Path, data: dict[str, Any], **options: Any) -> list[str]:
    with pytest.raises(InputError) as caught:
        read(folder, data, **options)
    return [str(problem).partition("poses.csv:")[2] for problem in caught.value.problems]


def scaled(factor: float, *names: str) -> dict[str, Any]:
    data = good()
    return data | {name: data[name] * factor for name in names}


def renamed(data: dict[str, Any], unit: str, *names: str) -> dict[str, Any]:
    return {f"{key}_{unit}" if key in names else key: value for key, value in data.items()}


ALL_JOINTS = tuple(f"q{i + 1}" for i in range(6))
SIGMAS = ("sigma_x", "sigma_y", "sigma_z")
DEGREES = math.degrees(1)


def test_good_data_raise_no_alarm(tmp_path: Path) -> None:
    assert read(tmp_path, good()).warnings == ()


@pytest.mark.parametrize(
    "change",
    [
        pytest.param({"q6": np.linspace(-2 * math.pi, 2 * math.pi, N)}, id="one turn either way"),
        pytest.param({"q6": np.r_[np.zeros(N - 5), np.full(5, 11.0)]}, id="nearly two turns, seldom"),
        pytest.param({"x": np.r_[np.zeros(N - 1), 900.0], "cmd_x": np.zeros(N)}, id="one wild reading"),
        pytest.param({axis: 60.0 + np.zeros(N) for axis in "xyz"}, id="a far instrument"),
        pytest.param({f"cmd_{axis}": np.zeros(N) for axis in "xyz"}, id="one commanded pose"),
        pytest.param({"roll": np.full(N, 2 * math.pi)}, id="a whole turn"),
        pytest.param(
            {axis: RNG.normal(0, 5e-5, N) for axis in "xyz"} | {f"cmd_{axis}": np.zeros(N) for axis in "xyz"},
            id="repeats",
        ),
    ],
)
def test_unusual_but_good_data_raise_no_alarm(tmp_path: Path, change: dict[str, Any]) -> None:
    assert read(tmp_path, good() | change).warnings == ()


def test_joints_in_degrees(tmp_path: Path) -> None:
    data = scaled(DEGREES, *ALL_JOINTS)
    (problem,) = problem_texts(tmp_path, data, robot=KnownRobot(limits=[(-3.1, 3.1)] * 6))
    largest = max(np.abs(data[name]).max() for name in ALL_JOINTS)
    assert problem == (
        f"1, q1, q2, q3, q4, q5, q6: found joint angles up to {largest:.4g}, which cannot be rad; if they are in deg, "
        "name the columns q1_deg, q2_deg, q3_deg, q4_deg, q5_deg, q6_deg; if in rad, q1_rad and so on"
    )
    q = read(tmp_path, renamed(data, "deg", *ALL_JOINTS), robot=KnownRobot(limits=[(-3.1, 3.1)] * 6)).q
    np.testing.assert_allclose(q, [good()[name] for name in ALL_JOINTS], rtol=1e-10)
    assert read(tmp_path, data, units_check=False).n == N
    assert read(tmp_path, renamed(data, "rad", *ALL_JOINTS)).n == N  # the user's word


def test_one_pose_in_degrees(tmp_path: Path) -> None:
    data = {"q1": [90.0], "q2": [-2.0], "x": [1.0], "y": [1.0], "z": [1.0]}
    (problem,) = problem_texts(tmp_path, data, robot=KnownRobot(limits=[(-3.1, 3.1), (-1, 1)]))
    assert problem.startswith("1, q1: found joint angles up to 90, which cannot be rad")


def test_small_angles_in_degrees_are_noticed_by_the_limits(tmp_path: Path) -> None:
    data = good() | {"q2": np.linspace(-11, 11, N)}
    limits = [(-3.1, 3.1)] * 6
    (problem,) = problem_texts(tmp_path, data, robot=KnownRobot(limits=limits))
    assert problem.startswith("1, q2: found joint angles up to 11, which cannot be rad")
    assert problem_texts(tmp_path, good() | {"q2": np.linspace(-3.3, 3.3, N)}, robot=KnownRobot(limits=limits))[
        0
    ].startswith("2, q2: found -3.3, expected a value within the joint's limits -3.1 to 3.1")


def test_turns_that_the_limits_allow_are_no_degrees(tmp_path: Path) -> None:
    data = good() | {"q6": np.linspace(-60, 60, N)}
    assert read(tmp_path, data, robot=KnownRobot(limits=[None] * 5 + [(-63, 63)])).n == N
    assert problem_texts(tmp_path, data)[0].startswith("1, q6: found joint angles up to 60")


def test_a_prismatic_joint_in_millimetres(tmp_path: Path) -> None:
    data = good() | {"q3": np.linspace(0, 900, N)}
    types = ["revolute"] * 2 + ["prismatic"] + ["revolute"] * 3
    names = [f"j{i}" for i in range(6)]
    (problem,) = problem_texts(
        tmp_path, data, robot=KnownRobot(joint_names=names, joint_types=types, limits=[None, None, (0, 1), *[None] * 3])
    )
    assert problem == (
        "1, q3: found joint travels of more than 50, which cannot be m; if they are in mm, name the columns q3_mm; "
        "if in m, q3_m and so on"
    )
    assert (
        read(tmp_path, good() | {"q3": np.linspace(0, 20, N)}, robot=KnownRobot(joint_names=names, joint_types=types)).n
        == N
    )


@pytest.mark.parametrize("prefix", ["", "cmd_"])
def test_positions_in_millimetres(tmp_path: Path, prefix: str) -> None:
    names = [f"{prefix}{axis}" for axis in "xyz"]
    (problem,) = problem_texts(tmp_path, scaled(1e3, *names))
    assert problem.startswith(f"1, {', '.join(names)}: found positions up to ")
    assert f"which cannot be m; if they are in mm, name the columns {prefix}x_mm, {prefix}y_mm, {prefix}z_mm" in problem
    assert read(tmp_path, renamed(scaled(1e3, *names), "mm", *names)).n == N


def test_one_position_in_millimetres(tmp_path: Path) -> None:
    data = {"q1": [0.5], "x": [812.5], "y": [-20.0], "z": [400.0]}
    assert "found positions up to 812.5, which cannot be m" in problem_texts(tmp_path, data)[0]


def test_small_moves_in_millimetres_are_noticed_beside_commanded_ones(tmp_path: Path) -> None:
    data = good()
    for axis in "xyz":
        data[f"cmd_{axis}"] = data[f"cmd_{axis}"] * 0.02
        data[axis] = data[f"cmd_{axis}"] * 1e3
    (problem,) = problem_texts(tmp_path, data)
    assert "attained positions spread 1e+03 times as far as commanded positions, so one of them is in mm" in problem
    assert problem.endswith("put the unit in the columns' names, for example x_mm and cmd_x_m")
    assert read(tmp_path, renamed(data, "mm", *"xyz")).n == N


@pytest.mark.parametrize("prefix", ["", "cmd_"])
@pytest.mark.parametrize("names", [("roll", "pitch", "yaw"), ("rx", "ry", "rz")])
def test_orientations_in_degrees(tmp_path: Path, prefix: str, names: tuple[str, ...]) -> None:
    data = {key: value for key, value in good().items() if key not in ("roll", "pitch", "yaw")}
    keys = [f"{prefix}{name}" for name in names]
    angles = dict(zip(keys, RNG.uniform(-90, 90, (3, N)), strict=True))
    (problem,) = problem_texts(tmp_path, data | angles)
    assert problem.startswith(f"1, {', '.join(keys)}: found angles up to ")
    assert f"which cannot be rad; if they are in deg, name the columns {keys[0]}_deg, " in problem
    assert read(tmp_path, data | renamed(angles, "deg", *keys)).n == N


def test_measuring_uncertainty_in_another_unit(tmp_path: Path) -> None:
    (problem,) = problem_texts(tmp_path, scaled(2e4, *SIGMAS))
    assert problem.startswith(
        "1, sigma_x, sigma_y, sigma_z: found a typical measuring uncertainty of 0.4 m, which no instrument has; "
        "if they are in mm, name the columns sigma_x_mm"
    )
    (problem,) = problem_texts(tmp_path, scaled(1e4, "sigma_r"))
    assert "found a typical measuring uncertainty of 1 rad, which no instrument has" in problem
    data = read(tmp_path, scaled(1e3, *SIGMAS, "sigma_r"))
    assert [text.partition("poses.csv:")[2] for text in data.warnings] == [
        "1: found a typical measuring uncertainty of 0.02 m; "
        "if it is in mm, name it sigma_x_mm, sigma_y_mm, sigma_z_mm",
        "1: found a typical measuring uncertainty of 0.1 rad; if it is in deg, name it sigma_r_deg",
    ]
    assert read(tmp_path, renamed(scaled(1e3, *SIGMAS), "m", *SIGMAS)).warnings == ()


def test_units_are_judged_beside_other_problems(tmp_path: Path) -> None:
    data = scaled(DEGREES, *ALL_JOINTS)
    data["y"][3] = np.nan
    problem = problem_texts(tmp_path, data)
    assert [text.partition(":")[0] for text in problem] == ["1, q1, q2, q3, q4, q5, q6", "5, y"]
    data = scaled(1e3, "x", "y", "z")
    data["x"][3] = np.nan
    problem = problem_texts(tmp_path, data)
    assert [text.partition(":")[0] for text in problem] == ["1, x, y, z", "5, x"]


def test_a_few_values_that_no_joint_reaches_are_enough(tmp_path: Path) -> None:
    (problem,) = problem_texts(tmp_path, good() | {"q2": np.r_[np.full(N - 1, 0.5), 30.0]})
    assert problem.startswith("1, q2: found joint angles up to 30, which cannot be rad")


# Against the robot's size


def arm(scale: float, n: int = 200) -> tuple[np.ndarray, np.ndarray]:
    """Positions of an arm of 1 m reach, ``scale`` times too large and 4 m off, and the nominal ones."""
    rng = np.random.default_rng(5)
    nominal = rng.uniform(-0.7, 0.7, (3, n))
    return (nominal + rng.normal(0, 1e-3, (3, n))) * scale + 4.0, nominal


def test_positions_of_the_robots_size_pass() -> None:
    check_scale(*arm(1.0), "poses.csv")
    check_scale(*arm(1e3, 1), "poses.csv")  # one pose has no spread


def test_repeats_and_a_target_that_only_turns_pass() -> None:
    position = 3.0 + np.random.default_rng(6).normal(0, 1e-4, (3, 50))
    check_scale(position, np.zeros((3, 50)), None)
    check_scale(position, position + 1.0, None)


def test_positions_a_thousand_times_too_large() -> None:
    with pytest.raises(InputError) as caught:
        check_scale(*arm(1e3), "poses.csv")
    assert str(caught.value).startswith("poses.csv, x, y, z: the positions spread over 1")
    assert "times as far as the robot moved (1.2" in str(caught.value)
    assert "; if they are in mm, name the columns x_mm, y_mm, z_mm" in str(caught.value)


def test_positions_a_thousand_times_too_small() -> None:
    with pytest.raises(
        InputError, match=r"less than the robot moved \(1.2.* m\); if they are in m, name the columns x, y"
    ):
        check_scale(*arm(1e-3), "poses.csv")


def test_a_part_in_another_unit_is_named_with_its_lines(tmp_path: Path) -> None:
    data = {name: np.array(column, copy=True) for name, column in good().items()}
    degrees, millimetres = dict(data), dict(data)
    half = N // 2
    for name in ALL_JOINTS:
        degrees[name] = np.where(np.arange(N) < half, data[name], np.degrees(data[name]))
    for name in "xyz":
        millimetres[name] = np.where(np.arange(N) < half, 1e3 * data[name], data[name])
    (problem,) = problem_texts(tmp_path, degrees, robot=KnownRobot(limits=[(-3.1, 3.1)] * 6))
    assert f", from line {half + 2} to {N + 1} only; these lines seem to be in deg and the others in rad" in problem
    (problem,) = problem_texts(tmp_path, millimetres)
    assert f", from line 2 to {half + 1} only; these lines seem to be in mm and the others in m" in problem
