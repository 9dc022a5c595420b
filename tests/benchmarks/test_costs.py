"""What calls, commands and rules of gates cost: ``pytest tests/benchmarks -m slow -s`` prints it."""

import dataclasses
import subprocess
import sys
import tracemalloc
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from arms import arm
from costs import ROBACC, ROOT, costs, fastest, report, users_environment
from peer import by_scipy
from sample_files import saved

import robacc
from robacc.accuracy.error_statistics import error_statistics
from robacc.accuracy.grade import default_scale
from robacc.effects import REGISTRY
from robacc.fitting.fit_result import Fit, Options
from robacc.fitting.solver import fit
from robacc.measurements import Measurements
from robacc.modelling.model import Model, predict
from robacc.planning.design import DesignProblem, FitCriterion, choose
from robacc.poses.csv_file import read_poses
from robacc.prediction.predicting import predict_accuracy, sampled_configurations, uncertain_parameters
from robacc.robots.arm import Arm
from robacc.simulation.simulate import Plan, simulate

pytestmark = pytest.mark.slow
NOISE = 2e-5
GEOMETRY = ("base_frame", "tool_frame", "joint_offset", "link_geometry")
OPTIONS = Options(robust=False, misfit=(NOISE, NOISE))


def problem(n: int) -> tuple[Model, Measurements]:
    """30 parameters that full poses of a PUMA tell apart; the arm a milliradian and some tenths of a millimetre off."""
    one = arm("puma560")
    robot = one.robot
    zeros = {"effect": "joint_offset", "joints": ["j2", "j3", "j5"], "values": {"j2": 1e-3, "j3": -2e-3, "j5": 1e-3}}
    lengths = {"effect": "link_geometry", "joints": ["j2"], "values": {"j2.a": 4e-4, "j2.alpha": 3e-4}}
    wrong = dataclasses.replace(robot, effects=(zeros, lengths), effect_units=(1.0, 1.0))
    data = simulate(wrong, Plan(n, seed=1, noise_position=NOISE, noise_orientation=NOISE)).data
    return Model.of(robot, [REGISTRY[name].default(one, data) for name in GEOMETRY]), data


def peer(found: Fit, data: Measurements) -> np.ndarray:
    """All coefficients by scipy's trust region with the same Jacobian, from the same start, at its own tolerances."""
    solution, size = by_scipy(found, data, NOISE, method="trf")
    theta = np.zeros(found.theta.size)
    theta[found.identifiability.columns] = solution.x * size
    return theta


def peak(call: object) -> float:
    """Largest memory of a call, MB."""
    tracemalloc.start()
    assert callable(call)
    call()
    largest = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return largest / 1e6


@pytest.mark.parametrize(("n", "wanted"), [(50, 5), (500, 10), (5_000, 10), (50_000, 20)])
def test_fit_against_scipy(n: int, wanted: float, capsys: pytest.CaptureFixture[str]) -> None:
    model, data = problem(n)
    found = fit(model, data, OPTIONS)
    kept = found.identifiability.columns
    assert kept.size == 30
    error = np.sqrt(np.diag(found.covariance))[kept]
    assert np.abs((found.theta - peer(found, data))[kept] / error).max() < 1e-2
    same_start = dataclasses.replace(OPTIONS, start=np.zeros(len(found.terms)))
    times = max(2, min(30, 5_000 // n))
    own = fastest(lambda: fit(found.model, data, same_start), times)
    other = fastest(lambda: peer(found, data), max(2, times // 3))
    memory = peak(lambda: fit(found.model, data, same_start))
    ratio = (own / other, "times scipy's time", 1 / wanted)
    report(capsys, f"fit of 30 parameters, {n} poses", ratio, (1e3 * own, "ms", None), (memory, "MB", None))


def test_predictions_against_the_jacobian(capsys: pytest.CaptureFixture[str]) -> None:
    robot = robacc.read_robot(ROOT / "configs" / "robots" / "irb1600.yaml")
    chain, parameters, n = Arm.of(robot).chain, uncertain_parameters(robot), 100_000
    where = sampled_configurations(robot, n)
    jacobian = fastest(lambda: chain.jacobian(where.q, [parameter.motion for parameter in parameters]))
    whole = fastest(lambda: predict_accuracy(robot, parameters, where, default_scale()), 2)
    memory = peak(lambda: predict_accuracy(robot, parameters, where, default_scale()))
    report(capsys, f"predict {n} poses", (whole / jacobian, "times the Jacobian", 6), (memory, "MB", None))


@pytest.mark.parametrize("text", ["", ",P7,3"], ids=["numbers", "numbers and texts"])
def test_reading_against_loadtxt(tmp_path: Path, text: str, capsys: pytest.CaptureFixture[str]) -> None:
    rng = np.random.default_rng(1)
    quaternion = rng.normal(size=(100_000, 4))
    quaternion /= np.linalg.norm(quaternion, axis=1, keepdims=True)
    table = np.hstack((rng.uniform(-3, 3, (100_000, 6)), rng.uniform(-1, 1, (100_000, 3)), quaternion))
    path, header = tmp_path / "poses.csv", "q1,q2,q3,q4,q5,q6,x,y,z,qw,qx,qy,qz" + (",pose,cycle" if text else "")
    np.savetxt(path, table, fmt=",".join(["%.9f"] * 13) + text, header=header, comments="")
    own = fastest(lambda: read_poses(path))
    other = fastest(lambda: np.loadtxt(path, delimiter=",", skiprows=1, usecols=range(13)))
    what = f"reading 100,000 rows{' with texts' if text else ''}"
    report(capsys, what, (own / other, "times numpy.loadtxt", 1.2), (peak(lambda: read_poses(path)), "MB", None))


def test_forward_kinematics_and_correction(capsys: pytest.CaptureFixture[str]) -> None:
    folder = ROOT / "sample_data" / "trace"
    robot = robacc.read_robot(folder / "robot.yaml")
    effects = ",".join((*GEOMETRY, "joint_compliance[j2,j3]", "backlash[j3]"))
    model = robacc.calibrate(folder / "poses.csv", robot=robot, fit=effects, folds=2).robot
    data = robacc.simulate(robot, poses=10_000, seed=5, motion=False).data
    kinematics = fastest(lambda: predict(robot, data))
    corrected = fastest(lambda: robacc.correct(data, model=model, nominal=robot))
    # 300 to 400 times on two machines.
    report(capsys, "correct 10,000 targets", (corrected / kinematics, "times forward kinematics", 800))


def test_statistics_against_sorting(capsys: pytest.CaptureFixture[str]) -> None:
    rng = np.random.default_rng(1)
    errors, shuffled = rng.normal(scale=1e-4, size=(3, 1_000_000)), rng.permutation(2_000_000.0 + np.arange(2_000_000))
    own = fastest(lambda: error_statistics(errors, "m"))
    other = fastest(lambda: np.sort(shuffled, kind="stable"))
    report(capsys, "statistics of 1 M poses", (own / other, "times sorting 2 M numbers", None))


def test_choice_of_poses(capsys: pytest.CaptureFixture[str]) -> None:
    rng = np.random.default_rng(0)
    case = DesignProblem(rng.normal(size=(10_000, 3, 40)), np.eye(40), FitCriterion("I", rng.normal(size=(3, 400, 40))))
    # 2 s on a quiet core.
    report(capsys, "choose 60 of 10,000 poses", (fastest(lambda: choose(case, case.best(60), 0), 1), "s", 3))


SAMPLE = "sample_data/trace"
FITTED = "base_frame,tool_frame,joint_offset,link_geometry"
POSES = {
    "million": f"{SAMPLE}/truth.yaml --poses 1000000 --noise 0.02mm --position-only",
    "rows": "sample_data/robot.yaml --poses 1000000 --noise 0.1mm --no-motion",
    "hundred": "sample_data/robot.yaml --poses 100 --noise 0.1mm --no-motion",
    "poses_150": f"{SAMPLE}/truth.yaml --poses 150 --noise 0.02mm --position-only",
    "poses_400": f"{SAMPLE}/truth.yaml --poses 400 --noise 0.02mm --noise-orientation 0.003deg",
    "poses_1495": f"{SAMPLE}/truth.yaml --poses 1495 --noise 0.02mm --noise-orientation 0.003deg",
    "poses_11911": f"{SAMPLE}/truth.yaml --poses 11911 --noise 0.02mm --position-only",
}
"""Simulated poses by name; other machines do not have the sets that arms were measured on."""
TRACE = f"--robot {SAMPLE}/robot.yaml --declared {FITTED}"


class Line(NamedTuple):
    what: str
    command: str
    """With the names of poses in braces."""
    seconds: float | None
    megabytes: float | None


LINES = (
    Line("simulate 1 M positions", f"simulate {POSES['million']} -o {{out}}.csv", 8, 600),
    Line("estimate 1 M poses", "estimate {rows} --robot sample_data/robot.yaml", 4, 300),
    Line(
        "estimate 1 M poses, aligned",
        "estimate {rows} --robot sample_data/robot.yaml --align base_frame,tool_frame",
        5,
        400,
    ),
    Line("estimate 1 M poses, JSON", "estimate {rows} --robot sample_data/robot.yaml --format json -o {out}", 6, 400),
    Line("calibrate 1 M positions", f"calibrate {{million}} --robot {SAMPLE}/robot.yaml --fit {FITTED}", 20, 600),
    Line("trace 150 positions, with a report", f"trace {{poses_150}} {TRACE} --report {{out}}.html", 0.6, None),
    Line("trace 400 poses", f"trace {{poses_400}} {TRACE}", 3, 300),
    Line("trace 1,495 poses", f"trace {{poses_1495}} {TRACE}", 5, 400),
    Line("trace 11,911 positions", f"trace {{poses_11911}} {TRACE}", 20, 600),
)


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    folder = tmp_path_factory.mktemp("bytecode")
    found = users_environment(folder)
    # Commands that are measured once would compile the charts' library, a second for a report.
    words = f"trace {SAMPLE}/poses.csv {TRACE} --report {folder}/page.html".split()
    subprocess.run((*ROBACC, *words), env=found, cwd=ROOT, check=True, capture_output=True)
    return found


@pytest.fixture(scope="module")
def poses(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], str]:
    folder = tmp_path_factory.mktemp("poses")

    @cache
    def simulated(name: str) -> str:
        path = str(folder / f"{name}.csv")
        subprocess.run((*ROBACC, "simulate", *POSES[name].split(), "-o", path), check=True, cwd=ROOT)
        return path

    return simulated


@pytest.mark.parametrize("line", LINES, ids=lambda line: line.what.replace(" ", "_"))
def test_command(
    line: Line,
    poses: Callable[[str], str],
    tmp_path: Path,
    environment: dict[str, str],
    capsys: pytest.CaptureFixture[str],
) -> None:
    names = {name: poses(name) for name in POSES if f"{{{name}}}" in line.command}
    words = [word.format(out=tmp_path / "out", **names) if "{" in word else word for word in line.command.split()]
    (cost,) = costs(environment, 1, (*ROBACC, *words))
    report(capsys, line.what, (cost.seconds, "s", line.seconds), (cost.megabytes, "MB", line.megabytes))


def test_a_hundred_poses_above_importing_numpy(
    poses: Callable[[str], str], environment: dict[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    command = (*ROBACC, "estimate", poses("hundred"), "--robot", "sample_data/robot.yaml")
    base, whole = costs(environment, 9, (sys.executable, "-c", "import numpy"), command)
    report(
        capsys,
        "estimate 100 poses",
        (whole.seconds - base.seconds, "s above import numpy", 0.10),
        (whole.megabytes, "MB", None),
    )


def test_help_against_a_bare_typer_program(
    tmp_path: Path, environment: dict[str, str], capsys: pytest.CaptureFixture[str]
) -> None:
    bare = saved(
        tmp_path / "bare.py",
        "import typer\napp = typer.Typer()\n\n@app.command()\ndef hello(name: str) -> None:\n    'Say hello.'\n\n"
        "@app.command()\ndef bye(name: str) -> None:\n    'Say goodbye.'\n\napp()\n",
    )
    base, whole = costs(environment, 9, (sys.executable, str(bare), "--help"), (*ROBACC, "--help"))
    report(capsys, "robacc --help", (whole.seconds / base.seconds, "times a bare typer program", 1.3))
