"""What a million poses take: ``pytest tests/benchmarks -m slow -s`` prints times and memory; memory is judged.

The bounds are those that the README states; times are printed only, since another machine gives others.
"""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest
from costs import ROBACC, ROOT, Cost, costs, report, users_environment

pytestmark = pytest.mark.slow

MILLION = 1_000_000
FRAMES = "base_frame,tool_frame"
GEOMETRY = f"{FRAMES},joint_offset,link_geometry"
SAMPLE = ROOT / "sample_data"
TRACE = SAMPLE / "trace"


@pytest.fixture(scope="module")
def environment(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    return users_environment(tmp_path_factory.mktemp("bytecode"))


@pytest.fixture(scope="module")
def positions(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A million simulated positions with directions and speeds."""
    return simulated(tmp_path_factory.mktemp("size") / "positions.csv", TRACE / "truth.yaml", MILLION)


def simulated(path: Path, robot: Path, poses: int) -> Path:
    options = ("--poses", str(poses), "--noise", "0.02mm", "--position-only", "--output", str(path))
    subprocess.run((*ROBACC, "simulate", str(robot), *options), check=True, cwd=ROOT)
    return path


def judged(capsys: pytest.CaptureFixture[str], what: str, cost: Cost, bound: float) -> None:
    report(capsys, f"{what}: {cost.seconds:.1f} s, {cost.megabytes:.0f} MB (at most {bound:.0f})")
    assert cost.megabytes <= bound


def test_simulate_a_million(tmp_path: Path, capsys: pytest.CaptureFixture[str], environment: dict[str, str]) -> None:
    options = ("--poses", str(MILLION), "--position-only", "--output", str(tmp_path / "poses.csv"))
    (cost,) = costs(environment, 1, (*ROBACC, "simulate", str(TRACE / "truth.yaml"), *options))
    judged(capsys, "simulate 1 M positions", cost, 1500)


@pytest.mark.parametrize(
    ("options", "bound"),
    [((), 600), (("--align", FRAMES), 1300), (("--format", "json"), 1000)],
    ids=["table", "aligned", "json"],
)
def test_estimate_a_million(
    positions: Path,
    capsys: pytest.CaptureFixture[str],
    environment: dict[str, str],
    options: tuple[str, ...],
    bound: float,
) -> None:
    command = (*ROBACC, "estimate", str(positions), "--robot", str(TRACE / "robot.yaml"), *options)
    (cost,) = costs(environment, 1, command)
    judged(capsys, f"estimate 1 M positions {' '.join(options)}", cost, bound)


def test_estimate_a_million_from_parquet(
    positions: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], environment: dict[str, str]
) -> None:
    csv, parquet = pytest.importorskip("pyarrow.csv"), pytest.importorskip("pyarrow.parquet")
    comments = sum(line.startswith("#") for line in positions.read_text(encoding="utf-8")[:2000].splitlines())
    table = csv.read_csv(positions, read_options=csv.ReadOptions(skip_rows=comments))
    names = [name for name in table.column_names if name not in ("pose", "cycle")]
    parquet.write_table(table.select(names), tmp_path / "poses.parquet")
    robot = str(TRACE / "robot.yaml")
    (cost,) = costs(environment, 1, (*ROBACC, "estimate", str(tmp_path / "poses.parquet"), "--robot", robot))
    judged(capsys, "estimate 1 M positions from Parquet", cost, 800)


def test_calibrate_a_million(positions: Path, capsys: pytest.CaptureFixture[str], environment: dict[str, str]) -> None:
    command = (*ROBACC, "calibrate", str(positions), "--robot", str(TRACE / "robot.yaml"), "--fit", GEOMETRY)
    (cost,) = costs(environment, 1, command)
    judged(capsys, f"calibrate 1 M positions, {GEOMETRY}", cost, 2000)


def test_trace_twenty_thousand(tmp_path: Path, capsys: pytest.CaptureFixture[str], environment: dict[str, str]) -> None:
    poses = simulated(tmp_path / "poses.csv", TRACE / "truth.yaml", 20_000)
    command = (*ROBACC, "trace", str(poses), "--robot", str(TRACE / "robot.yaml"), "--declared", GEOMETRY)
    (cost,) = costs(environment, 1, command)
    judged(capsys, "trace 20,000 positions", cost, 600)
