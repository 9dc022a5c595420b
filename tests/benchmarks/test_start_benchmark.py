"""What the command line costs, as ratios within one run: ``pytest tests/benchmarks -m slow -s`` prints them.

Times are of the processor (user and system), the whole process on a million rows also on the clock, since a thread
takes part of it; each is the least of several runs by turns, so that what else the machine does counts little. They are
not pass or fail, since another machine gives other ratios; memory is, and a command that fails.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from costs import ROBACC, ROOT, costs, report, users_environment

from robacc.chain import Chain
from robacc.modelling.robot_file import read_robot
from robacc.robots.arm import build_chain

ROBOT = ROOT / "sample_data" / "robot.yaml"
PYBOTICS_LOOP = 0.04e6
"""Poses/s of pybotics' published forward kinematics, which goes pose by pose."""

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """As of a user, who has the bytecode of what is installed; the first run of a command writes it here."""
    return users_environment(tmp_path_factory.mktemp("bytecode"))


def make_poses(path: Path, n: int) -> None:
    """A CSV of 13 columns: six joints, position, quaternion, as an instrument writes them."""
    rng = np.random.default_rng(1)
    robot = read_robot(str(ROBOT))
    limits = np.array([joint.limits for joint in robot.variables])
    q = rng.uniform(0.9 * limits[:, :1], 0.9 * limits[:, 1:], size=(6, n))
    from robacc.geometry import quaternion_from_rotation

    poses = build_chain(robot).forward(q)
    position = poses.translation + rng.normal(scale=1e-4, size=(3, n))
    columns = np.vstack((q, position, quaternion_from_rotation(poses.rotation))).T
    header = ",".join([*(f"q{i + 1}_rad" for i in range(6)), "x_m", "y_m", "z_m", "qw", "qx", "qy", "qz"])
    np.savetxt(path, columns, fmt="%.9f", delimiter=",", header=header, comments="")


def test_a_million_rows_against_loadtxt(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], environment: dict[str, str]
) -> None:
    poses = tmp_path / "poses.csv"
    make_poses(poses, 1_000_000)
    load = (sys.executable, "-c", f"import numpy; numpy.loadtxt({str(poses)!r}, delimiter=',', skiprows=1)")
    base, whole = costs(environment, 3, load, (*ROBACC, "estimate", str(poses), "--robot", str(ROBOT)))
    report(
        capsys,
        f"1 M rows of 13 columns: {whole.clock:.2f} s on the clock, {whole.clock / base.clock:.2f} times numpy.loadtxt "
        f"({base.clock:.2f} s; wanted 2), {whole.seconds / base.seconds:.2f} times in processor time; "
        f"{whole.megabytes:.0f} MB (loadtxt {base.megabytes:.0f} MB; wanted 600)",
    )
    assert whole.megabytes <= 600


def test_a_hundred_poses_against_importing_numpy(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], environment: dict[str, str]
) -> None:
    poses = tmp_path / "poses.csv"
    make_poses(poses, 100)
    command = (*ROBACC, "estimate", str(poses), "--robot", str(ROBOT))
    base, whole = costs(environment, 9, (sys.executable, "-c", "import numpy"), command)
    output = subprocess.run((*command, "--format", "json"), cwd=ROOT, check=True, capture_output=True).stdout
    assert json.loads(output)["n_poses"] == 100
    report(
        capsys,
        f"100 poses: {whole.seconds:.3f} s, {whole.seconds - base.seconds:.3f} s above import numpy "
        f"({base.seconds:.3f} s; wanted 0.15)",
    )


def test_help_against_a_bare_typer_program(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], environment: dict[str, str]
) -> None:
    bare = tmp_path / "bare.py"
    bare.write_text(
        "import typer\napp = typer.Typer()\n\n@app.command()\ndef hello(name: str) -> None:\n    'Say hello.'\n\n"
        "@app.command()\ndef bye(name: str) -> None:\n    'Say goodbye.'\n\napp()\n",
        encoding="utf-8",
    )
    base, whole = costs(environment, 9, (sys.executable, str(bare), "--help"), (*ROBACC, "--help"))
    report(
        capsys,
        f"robacc --help: {whole.seconds:.3f} s, {whole.seconds / base.seconds:.2f} times a bare typer program "
        f"({base.seconds:.3f} s; wanted 1.3)",
    )


def test_forward_kinematics_against_matrices(capsys: pytest.CaptureFixture[str]) -> None:
    chain = build_chain(read_robot(str(ROBOT)))
    q = np.random.default_rng(2).uniform(-2, 2, size=(6, 1_000_000))
    matmul = rate(lambda part: matrices(chain, part), q[:, :100_000])
    own = rate(chain.forward, q)
    np.testing.assert_allclose(matrices(chain, q[:, :5]), chain.forward(q[:, :5]).matrices(), atol=1e-12)
    report(
        capsys,
        f"forward kinematics: {own / 1e6:.1f} M poses/s, {own / matmul:.1f} times batched 4x4 matmul "
        f"({matmul / 1e6:.2f} M/s), {own / PYBOTICS_LOOP:.0f} times pybotics' published loop (wanted 100)",
    )


def rate(function: Callable[[np.ndarray], object], q: np.ndarray) -> float:
    """Poses per second, the best of three."""
    times = []
    for _ in range(3):
        begin = time.perf_counter()
        function(q)
        times.append(time.perf_counter() - begin)
    return q.shape[1] / min(times)


def matrices(chain: Chain, q: np.ndarray) -> np.ndarray:
    """``(N, 4, 4)`` poses by a product of stacked 4x4 matrices, one a driven joint and one a run of constants."""
    product = np.broadcast_to(np.eye(4), (q.shape[1], 4, 4))
    constant = np.eye(4)
    for motion, scalar in zip(chain.motions, chain.scalars(q), strict=True):
        step = np.zeros((*np.shape(scalar), 4, 4))
        step[..., range(4), range(4)] = 1.0
        if motion.kind == "translation":
            step[..., motion.axis, 3] = scalar
        else:
            j, k = (motion.axis + 1) % 3, (motion.axis + 2) % 3
            step[..., j, j] = step[..., k, k] = np.cos(scalar)
            step[..., k, j] = np.sin(scalar)
            step[..., j, k] = -np.sin(scalar)
        if step.ndim == 2:
            constant = constant @ step
        else:
            product = product @ constant @ step
            constant = np.eye(4)
    return product @ constant
