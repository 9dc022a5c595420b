"""Robots, errors and poses at the edges of what there is: each command answers with finite numbers or says why."""

from __future__ import annotations

import itertools
import json
import math
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from results import PROJECT, run

DECLARED = "base_frame,tool_frame"
FAR = f"\nbase: {{xyz: [40, -50, 3], rpy: [3.1, {math.pi / 2!r}, 1]}}"
TWISTS = (math.pi / 2, 0.0, -math.pi / 2, 0.3)


def robot(n: int, kinds: str = "r", size: float = 0.2, base: str = "") -> str:
    """A robot file of ``n`` joints, ``kinds`` (r, p) in turn, links of ``size`` m."""
    lines = [
        "robacc: 1\nname: arm\nconvention: standard\nunits: {length: m, angle: rad}",
        f"tool: {{xyz: [{0.05 * size}, {0.1 * size}, {0.5 * size}], rpy: [0, 0, 0]}}{base}\njoints:",
    ]
    for i in range(n):
        kind = "revolute" if kinds[i % len(kinds)] == "r" else "prismatic"
        limits = "[-2.5, 2.5]" if kind == "revolute" else f"[0, {size}]"
        tolerance = f"{{theta: 1e-4, d: {1e-4 * size}, a: {1e-4 * size}, alpha: 1e-4}}"
        lines.append(
            f"  - {{name: j{i + 1}, type: {kind}, theta: 0, d: {0.5 * size}, a: {size}, alpha: {TWISTS[i % 4]!r}, "
            f"limits: {limits}, mass: 2, com: [{-0.5 * size}, 0, 0], tolerance: {tolerance}}}"
        )
    return "\n".join(lines) + "\n"


CASES: dict[str, tuple[str, int, str]] = {
    "1 joint": (robot(1), 12, "0.02mm"),
    "2 joints": (robot(2), 12, "0.02mm"),
    "7 joints": (robot(7), 40, "0.02mm"),
    "12 joints": (robot(12), 60, "0.02mm"),
    "1 slide": (robot(1, "p"), 12, "0.02mm"),
    "3 slides": (robot(3, "p"), 20, "0.02mm"),
    "slides and turns": (robot(4, "rp"), 30, "0.02mm"),
    "reach of 1 mm": (robot(6, size=2e-4), 30, "0.1um"),
    "reach of 100 m": (robot(6, size=18.0), 30, "0.02mm"),
    "errors of 1 nm": (robot(6), 30, "0.001um"),
    "errors of 1 m": (robot(6), 30, "1m"),
    "no noise": (robot(6), 30, "0mm"),
    "1 pose": (robot(6), 1, "0.02mm"),
    "2 poses": (robot(6), 2, "0.02mm"),
    "base far off, pitch of 90 degrees": (robot(6, base=FAR), 30, "0.02mm"),
}
COMMANDS: dict[str, tuple[str, ...]] = {
    "estimate": ("{poses}", "--robot", "{robot}"),
    "predict": ("{robot}", "--samples", "8"),
    "calibrate": ("{poses}", "--robot", "{robot}", "--fit", "base_frame,joint_offset,joint_compliance"),
    "trace": ("{poses}", "--robot", "{robot}", "--declared", DECLARED),
    "iso9283": ("{poses}", "--robot", "{robot}"),
}


def made(folder: Path, text: str, count: int, noise: str) -> dict[str, str]:
    """The robot file and poses measured on it."""
    files = {"robot": str(folder / "robot.yaml"), "poses": str(folder / "poses.csv")}
    Path(files["robot"]).write_text(text)
    options = ("--seed", "1", "--noise", noise, "--noise-orientation", "0.1mrad", "-o", files["poses"])
    done = run("simulate", files["robot"], "--poses", str(count), *options)
    assert done.exit_code == 0, done.stderr
    return files


def refused(constant: str) -> float:
    raise AssertionError(f"{constant} in a result")


def reasoned(value: Any, path: str = "") -> None:
    """A standard deviation, radius or test that is null has its reason beside it."""
    if isinstance(value, dict):
        if "why" in value and {"std", "radius_m", "statistic"} & value.keys():
            empty = [key for key in ("std", "radius_m", "statistic") if key in value and value[key] is None]
            assert not empty or value["why"], path
        for key, item in value.items():
            reasoned(item, f"{path}.{key}")
    elif isinstance(value, list):
        for i, item in enumerate(value):
            reasoned(item, f"{path}[{i}]")


def answers(files: dict[str, str], command: str) -> tuple[int, dict[str, Any]]:
    """A command's exit status and document, its table looked over too."""
    arguments = [argument.format(**files) for argument in COMMANDS[command]]
    done = run(command, *arguments, "--format", "json")
    if done.exit_code != 0:
        assert done.exit_code == 3
        assert done.stderr.startswith("error: ")
        return done.exit_code, {}
    document: dict[str, Any] = json.loads(done.stdout, parse_constant=refused)
    reasoned(document)
    table = run(command, *arguments)
    assert table.exit_code == 0
    assert not {"nan", "inf", "-inf"} & set(table.stdout.lower().replace("(", " ").replace(",", " ").split())
    return 0, document


QUICK = ("no noise", "1 pose")
NAMES = [one if one in QUICK else pytest.param(one, marks=pytest.mark.slow) for one in CASES]


@pytest.mark.parametrize("name", NAMES)
def test_estimate_and_predict(name: str, tmp_path: Path) -> None:
    text, count, noise = CASES[name]
    files = made(tmp_path, text, count, noise)
    status, found = answers(files, "estimate")
    # The noise is of each coordinate, so the error's RMS is sqrt(3) of it; a third is far beyond chance for 12 poses.
    sigma = {"0.02mm": 2e-5, "0.1um": 1e-7, "0.001um": 1e-9, "1m": 1.0, "0mm": 0.0}[noise]
    rms = pytest.approx(math.sqrt(3) * sigma, rel=1.0 if count < 12 else 0.35, abs=1e-14)
    assert (status, found["position"]["rms_m"]) == (0, rms)
    assert (answers(files, "predict")[0], answers(files, "iso9283")[0]) == (0, 0)


@pytest.mark.parametrize("name", NAMES)
def test_calibrate_and_trace(name: str, tmp_path: Path) -> None:
    text, count, noise = CASES[name]
    files = made(tmp_path, text, count, noise)
    calibrated, traced = answers(files, "calibrate"), answers(files, "trace")
    if count == 1:
        # Six numbers for six coordinates of a frame: neither can be had, and both say so.
        assert (calibrated[0], traced[0]) == (3, 3)
    else:
        assert (calibrated[0], traced[0], traced[1]["findings"]) == (0, 0, [])


@pytest.mark.parametrize("alike", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_poses_that_are_all_one_or_two(alike: int, tmp_path: Path) -> None:
    """Copies: told of; and their errors, which do not differ, have no scatter but the rounding that is none."""
    files = made(tmp_path, robot(6), alike, "0.02mm")
    path = Path(files["poses"])
    head, *rows = [line for line in path.read_text().splitlines() if not line.startswith("#")]
    path.write_text("\n".join([head, *(rows * 15)]) + "\n")
    done = run("estimate", *(one.format(**files) for one in COMMANDS["estimate"]))
    assert f"{14 * alike} rows repeat an earlier row in every column" in done.stderr
    assert "not registered" not in done.stderr
    status, found = answers(files, "estimate")
    assert status == 0
    centred = np.array(found["position"]["centred_covariance_m2"])
    if alike == 1:
        assert not centred.any()
    for command in ("calibrate", "iso9283", *(["trace"] if alike == 2 else [])):
        assert answers(files, command)[0] == 0, command


def test_a_repeated_pose_is_no_mistake_of_units(tmp_path: Path) -> None:
    """Scatter about one pose was taken for positions in micrometres: all errors are smaller in a smaller unit."""
    text = robot(6).replace("[-2.5, 2.5]", "[0.1, 0.1]")
    files = made(tmp_path, text, 20, "0.02mm")
    status, found = answers(files, "calibrate")
    assert (status, found["n_poses"]) == (0, 20)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-6, 1.0, math.pi - 1e-6, math.pi - 1e-12, math.pi])
def test_rotations_up_to_half_a_turn(angle: float, tmp_path: Path) -> None:
    """An orientation error of any size has its length, and is no NaN where the axis' sign is anyone's choice."""
    path = tmp_path / "poses.csv"
    axis = np.array([1.0, -2.0, 2.0]) / 3.0
    half = 0.5 * angle
    turn = ",".join(map(repr, (math.cos(half), *(math.sin(half) * axis).tolist())))
    head = "x,y,z,qw,qx,qy,qz,cmd_x,cmd_y,cmd_z,cmd_qw,cmd_qx,cmd_qy,cmd_qz"
    rows = [f"{i},0,0,{turn},{i},0,0.001,1,0,0,0" for i in range(4)]
    path.write_text("\n".join([head, *rows]) + "\n")
    done = run("estimate", str(path), "--format", "json")
    assert done.exit_code == 0
    found = json.loads(done.stdout, parse_constant=refused)
    assert found["orientation"]["rms_rad"] == pytest.approx(angle, rel=1e-9, abs=1e-15)


def by_threads(*words: object) -> list[str]:
    """The JSON of a command with one thread of the linear algebra, and with two."""
    return [
        subprocess.run(
            (sys.executable, "-m", "robacc", *map(str, words), "--format", "json"),
            env={**os.environ, "OPENBLAS_NUM_THREADS": threads},
            check=True,
            capture_output=True,
            text=True,
        ).stdout
        for threads in ("1", "2")
    ]


FITS = {
    "calibrate": ("--fit", "base_frame,tool_frame,joint_offset,joint_compliance[j2],backlash[j3]", "--folds", "2"),
    "trace": ("--declared", "base_frame,tool_frame,joint_offset,link_geometry"),
}


@pytest.mark.parametrize("command", ["calibrate", pytest.param("trace", marks=pytest.mark.slow)])
def test_one_thread_or_two(command: str) -> None:
    """The linear algebra may divide its sums: what is found is the same, and the figures to 1e-9 of their size."""
    samples = PROJECT / "sample_data" / "trace"
    made = by_threads(command, samples / "poses.csv", "--robot", samples / "robot.yaml", *FITS[command])
    one, two = (json.loads(text) for text in made)
    for stage, of in itertools.product(("nominal", "before", "after"), ("fitted", "held_out")):
        first, second = (found[stage][of]["position"] for found in (one, two))
        figures, others = (
            {key: value for key, value in each.items() if isinstance(value, float)} for each in (first, second)
        )
        assert others == pytest.approx(figures, rel=1e-9), (stage, of)
    for first, second in zip(one["parameters"], two["parameters"], strict=True):
        assert first["name"] == second["name"]
        # A coefficient is as good as its standard deviation; of that, a billionth.
        assert second["value"] == pytest.approx(first["value"], rel=1e-9, abs=1e-9 * (first["std"] or 1e-3))
    if command == "trace":
        first, second = ((found["verdict"], [f["effect"] for f in found["findings"]]) for found in (one, two))
        assert first == second


N = 20_000
"""So many that OpenBLAS does divide the sums over the errors among its threads."""


def test_an_estimate_does_not_hang_on_the_number_of_threads(tmp_path: Path) -> None:
    rng = np.random.default_rng(7)
    commanded = rng.uniform(-1, 1, size=(N, 3))
    table = np.hstack((commanded + rng.normal(scale=(1e-4, 2e-4, 3e-4), size=(N, 3)), commanded))
    path, head = tmp_path / "poses.csv", "x,y,z,cmd_x,cmd_y,cmd_z"
    np.savetxt(path, table, fmt="%.9f", delimiter=",", header=head, comments="")
    # Every second part is a number with a point or an exponent.
    one, two = (re.split(r"(-?\d+\.\d+(?:e-?\d+)?|-?\d+e-?\d+)", text) for text in by_threads("estimate", path))
    assert one[::2] == two[::2]
    assert len(one) > 6 * N
    np.testing.assert_allclose(np.array(two[1::2], float), np.array(one[1::2], float), rtol=1e-9, atol=1e-15)
