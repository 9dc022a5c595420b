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


LIMITED = {"robot": KnownRobot(limits=[(-3.1, 3.1)] * 6)}
TYPES = ["revolute"] * 2 + ["prismatic"] + ["revolute"] * 3
NAMES = [f"j{i}" for i in range(6)]
RAIL = {"robot": KnownRobot(NAMES, TYPES, [None, None, (0, 1), *[None] * 3])}
SMALL = {f"cmd_{axis}": 0.02 * good()[f"cmd_{axis}"] for axis in "xyz"}
FIRST = np.arange(N) < N // 2


def turned(*names: str) -> dict[str, Any]:
    """Good poses whose orientations are these three columns, in degrees."""
    data = {key: value for key, value in good().items() if key not in ("roll", "pitch", "yaw")}
    return data | dict(zip(names, np.random.default_rng(8).uniform(-90, 90, (3, N)), strict=True))


def wrong_at(row: int, data: dict[str, Any], name: str) -> dict[str, Any]:
    return data | {name: np.where(np.arange(N) == row, np.nan, data[name])}


PROBLEMS: list[tuple[dict[str, Any], dict[str, Any], list[str]]] = [
    (
        scaled(DEGREES, *ALL_JOINTS),
        LIMITED,
        [
            f"1, q1, q2, q3, q4, q5, q6: found joint angles up to "
            f"{max(np.abs(good()[name]).max() for name in ALL_JOINTS) * DEGREES:.4g}, which cannot be rad; if they "
            "are in deg, name the columns q1_deg, q2_deg, q3_deg, q4_deg, q5_deg, q6_deg; if in rad, q1_rad and so on"
        ],
    ),
    (
        {"q1": [90.0], "q2": [-2.0], "x": [1.0], "y": [1.0], "z": [1.0]},
        {"robot": KnownRobot(limits=[(-3.1, 3.1), (-1, 1)])},
        ["1, q1: found joint angles up to 90, which cannot be rad"],
    ),
    # Small angles are noticed by the limits, and a few values that no joint reaches are enough.
    (good() | {"q2": np.linspace(-11, 11, N)}, LIMITED, ["1, q2: found joint angles up to 11, which cannot be rad"]),
    (
        good() | {"q2": np.r_[np.zeros(N - 1), -3.3]},
        LIMITED,
        [f"{N + 1}, q2: found -3.3, expected a value within the joint's limits -3.1 to 3.1"],
    ),
    (
        good() | {"q2": np.r_[np.full(N - 1, 0.5), 30.0]},
        {},
        ["1, q2: found joint angles up to 30, which cannot be rad"],
    ),
    (good() | {"q6": np.linspace(-60, 60, N)}, {}, ["1, q6: found joint angles up to 60"]),
    (
        good() | {"q3": np.linspace(0, 900, N)},
        RAIL,
        [
            "1, q3: found joint travels of more than 50, which cannot be m; if they are in mm, name the columns q3_mm; "
            "if in m, q3_m and so on"
        ],
    ),
    *(
        (
            scaled(1e3, *(f"{prefix}{axis}" for axis in "xyz")),
            {},
            [
                f"1, {prefix}x, {prefix}y, {prefix}z: found positions up to ",
                f"cannot be m; if they are in mm, name the columns {prefix}x_mm, {prefix}y_mm, {prefix}z_mm",
            ],
        )
        for prefix in ("", "cmd_")
    ),
    (
        {"q1": [0.5], "x": [812.5], "y": [-20.0], "z": [400.0]},
        {},
        ["found positions up to 812.5, which cannot be m"],
    ),
    (
        good() | SMALL | {axis: 1e3 * SMALL[f"cmd_{axis}"] for axis in "xyz"},
        {},
        [
            "attained positions spread 1e+03 times as far as commanded positions, so one of them is in mm",
            "put the unit in the columns' names, for example x_mm and cmd_x_m",
        ],
    ),
    *(
        (
            turned(*(f"{prefix}{name}" for name in names)),
            {},
            [
                f"1, {prefix}{names[0]}, {prefix}{names[1]}, {prefix}{names[2]}: found angles up to ",
                f"which cannot be rad; if they are in deg, name the columns {prefix}{names[0]}_deg, ",
            ],
        )
        for prefix in ("", "cmd_")
        for names in (("roll", "pitch", "yaw"), ("rx", "ry", "rz"))
    ),
    (
        scaled(2e4, *SIGMAS),
        {},
        [
            "1, sigma_x, sigma_y, sigma_z: found a typical measuring uncertainty of 0.4 m, which no instrument has; "
            "if they are in mm, name the columns sigma_x_mm"
        ],
    ),
    (scaled(1e4, "sigma_r"), {}, ["found a typical measuring uncertainty of 1 rad, which no instrument has"]),
    # Units are judged beside other problems.
    (wrong_at(3, scaled(DEGREES, *ALL_JOINTS), "y"), {}, ["1, q1, q2, q3, q4, q5, q6: found", "\n5, y: found 'nan'"]),
    (wrong_at(3, scaled(1e3, "x", "y", "z"), "x"), {}, ["1, x, y, z: found", "\n5, x: found 'nan'"]),
    # A part in another unit is named with its lines.
    (
        good() | {name: np.where(FIRST, good()[name], np.degrees(good()[name])) for name in ALL_JOINTS},
        LIMITED,
        [f", from line {N // 2 + 2} to {N + 1} only; these lines seem to be in deg and the others in rad"],
    ),
    (
        good() | {name: np.where(FIRST, 1e3 * good()[name], good()[name]) for name in "xyz"},
        {},
        [f", from line 2 to {N // 2 + 1} only; these lines seem to be in mm and the others in m"],
    ),
]


@pytest.mark.parametrize(("data", "options", "parts"), PROBLEMS, ids=lambda value: str(value)[:60])
def test_columns_in_another_unit_are_one_problem(
    tmp_path: Path, data: dict[str, Any], options: dict[str, Any], parts: list[str]
) -> None:
    problems = problem_texts(tmp_path, data, **options)
    assert all(part in "\n".join(problems) for part in parts)
    assert problems[0].startswith(parts[0]) or not parts[0][0].isdecimal()
    assert len(problems) == 1 + parts[-1].startswith("\n")


GOOD: list[tuple[dict[str, Any], dict[str, Any]]] = [
    (scaled(DEGREES, *ALL_JOINTS), {"units_check": False}),
    (renamed(scaled(DEGREES, *ALL_JOINTS), "rad", *ALL_JOINTS), {}),  # the user's word
    (good() | {"q6": np.linspace(-60, 60, N)}, {"robot": KnownRobot(limits=[None] * 5 + [(-63, 63)])}),
    (good() | {"q3": np.linspace(0, 20, N)}, {"robot": KnownRobot(NAMES, TYPES)}),
    (renamed(scaled(1e3, *"xyz"), "mm", *"xyz"), {}),
    (renamed(good() | SMALL | {axis: 1e3 * SMALL[f"cmd_{axis}"] for axis in "xyz"}, "mm", *"xyz"), {}),
    (renamed(turned("rx", "ry", "rz"), "deg", "rx", "ry", "rz"), {}),
]


@pytest.mark.parametrize(("data", "options"), GOOD, ids=lambda value: str(value)[:60])
def test_units_in_names_and_limits_are_believed(tmp_path: Path, data: dict[str, Any], options: dict[str, Any]) -> None:
    assert read(tmp_path, data, **options).n == N


def test_columns_in_degrees_and_doubtful_uncertainties(tmp_path: Path) -> None:
    q = read(tmp_path, renamed(scaled(DEGREES, *ALL_JOINTS), "deg", *ALL_JOINTS), **LIMITED).q
    np.testing.assert_allclose(q, [good()[name] for name in ALL_JOINTS], rtol=1e-10)
    data = read(tmp_path, scaled(1e3, *SIGMAS, "sigma_r"))
    assert [text.partition("poses.csv:")[2] for text in data.warnings] == [
        "1: found a typical measuring uncertainty of 0.02 m; "
        "if it is in mm, name it sigma_x_mm, sigma_y_mm, sigma_z_mm",
        "1: found a typical measuring uncertainty of 0.1 rad; if it is in deg, name it sigma_r_deg",
    ]
    assert read(tmp_path, renamed(scaled(1e3, *SIGMAS), "m", *SIGMAS)).warnings == ()


# Against the robot's size


def arm(scale: float, n: int = 200) -> tuple[np.ndarray, np.ndarray]:
    """Positions of an arm of 1 m reach, ``scale`` times too large and 4 m off, and the nominal ones."""
    rng = np.random.default_rng(5)
    nominal = rng.uniform(-0.7, 0.7, (3, n))
    return (nominal + rng.normal(0, 1e-3, (3, n))) * scale + 4.0, nominal


def test_positions_are_held_against_the_robots_size() -> None:
    check_scale(*arm(1.0), "poses.csv")
    check_scale(*arm(1e3, 1), "poses.csv")  # one pose has no spread
    position = 3.0 + np.random.default_rng(6).normal(0, 1e-4, (3, 50))
    check_scale(position, np.zeros((3, 50)), None)  # repeats
    check_scale(position, position + 1.0, None)  # a target that only turns
    for scale, message in (
        (
            1e3,
            r"^poses.csv, x, y, z: the positions spread over 1.*times as far as the robot moved \(1\.2.*; if they are "
            "in mm, name the columns x_mm, y_mm, z_mm",
        ),
        (1e-3, r"less than the robot moved \(1.2.* m\); if they are in m, name the columns x, y"),
    ):
        with pytest.raises(InputError, match=message):
            check_scale(*arm(scale), "poses.csv")
