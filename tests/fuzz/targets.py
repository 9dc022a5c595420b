"""One call for each reader of robacc: bytes in, and an AssertionError where robacc breaks a rule.

For any bytes, a command ends with the status 0 (valid input), 2, 3, 4 or 5; an error is printable text; printed JSON
has finite numbers only; a valid robot file gives the same robot when it is written and read again.
"""

import json
import os
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterable, Mapping
from functools import cache, partial
from pathlib import Path

import commands
import numpy as np
from sample_files import CONFIGS, SAMPLES, saved

from robacc import RobaccError, read_robot
from robacc.fitting.parameters import absorb_constants
from robacc.robots.arm import build_chain
from robacc.robots.yaml_robot import parse_robot, robot_to_yaml

ALLOWED = frozenset({0, 2, 3, 4, 5})
READ = {
    "poses": ("poses.csv", "estimate {file} --format json"),
    "robot_poses": ("poses.csv", "estimate {file} --robot {samples}/robot.yaml --ordered"),
    "cycles": ("cycles.csv", "iso9283 {file} --format json"),
    "robot": ("robot.yaml", "show {file}"),
    "robot_used": (
        "robot.yaml",
        "estimate {samples}/poses.csv --robot {file} --format json",
        "predict {file} --samples 8 --format json",
    ),
    "urdf": ("robot.urdf", "show {file}"),
    "gate": ("gate.yaml", "check {estimate} --gate {file} --format json"),
    "scale": ("scale.yaml", "estimate {samples}/poses.csv --robot {samples}/robot.yaml --scale {file}"),
    "tolerances": (
        "tolerances.yaml",
        "predict {samples}/robot.yaml --tolerances {file} --samples 8 --format json",
    ),
    "result": (
        "result.json",
        "check {file} --gate {gate} --format json",
        "compare {file} {estimate} --format json",
    ),
    "page": ("result.json", "report {file} --output {folder}/page.html"),
}
"""Name of the file of a reader, and the commands that read it."""


@cache
def temporary() -> tempfile.TemporaryDirectory[str]:
    """Return a temporary folder of this process."""
    return tempfile.TemporaryDirectory(prefix="robacc-fuzz-")


def call(*arguments: str) -> tuple[int, str, str]:
    """Run a command in this process; return exit status, standard output and standard error, raise its defects."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        ended = commands.run(*arguments)
    return ended.exit_code, ended.stdout, ended.stderr


def clean(*arguments: str) -> int:
    """Run a command, assert the rules that hold for every command, and return its status."""
    status, out, err = call(*arguments)
    assert status in ALLOWED, (status, err)
    assert status in (0, 4, 5) or err, "an error without a message"
    assert status in (0, 4, 5) or not out, "an error with a result"
    for text in (out, err):
        assert all(sign.isprintable() or sign in "\n\t" for sign in text), f"control characters: {text!r:.500}"
    if "json" in arguments and status in (0, 4, 5):
        json.loads(out, parse_constant=_refused)
    return status


def _refused(constant: str) -> float:
    raise AssertionError(f"{constant} in a result")


def read(reader: str, data: bytes) -> None:
    """Read bytes as a file of the reader; a robot that is read is the same when it is written and read again."""
    name, *calls = READ[reader]
    folder = Path(temporary().name)
    path = saved(folder / name, data)
    places = {
        "file": path,
        "samples": SAMPLES,
        "folder": folder,
        "gate": gate_file(),
        "estimate": result_file("estimate"),
    }
    for line in calls:
        status = clean(*(word.format(**places) for word in line.split()))
    if name.startswith("robot.") and "show" in line and status == 0:
        written_again(path)


def written_again(path: Path) -> None:
    """Assert that a robot has a pose, and is the same when it is written and read again."""
    robot = read_robot(os.fspath(path))
    poses_at_zero = build_chain(robot).forward(np.zeros((len(robot.variables), 2)))
    assert np.all(np.isfinite(poses_at_zero.translation))
    assert np.all(np.isfinite(poses_at_zero.rotation))
    try:
        written = robot_to_yaml(absorb_constants(robot))
    except RobaccError:  # errors in effects, which show does not read
        return
    assert robot_to_yaml(parse_robot(written, "again.yaml")) == written


READERS: Mapping[str, Callable[[bytes], None]] = {reader: partial(read, reader) for reader in READ}
CALLS = {
    "estimate": ("poses.csv", "--robot", "robot.yaml", "--align", "base_frame,tool_frame"),
    "predict": ("../configs/robots/puma560.yaml", "--samples", "20", "--allocate", "C"),
    "calibrate": ("poses.csv", "--robot", "robot.yaml", "--fit", "base_frame,tool_frame", "--folds", "2"),
    "iso9283": ("iso9283/poses.csv", "--robot", "iso9283/robot.yaml", "--align", "base_frame,tool_frame"),
    "trace": ("poses.csv", "--robot", "robot.yaml", "--declared", "base_frame,tool_frame", "--folds", "2"),
}


@cache
def result_file(command: str) -> Path:
    """Return the path of a result on the sample data."""
    arguments = [str(SAMPLES / name) if (SAMPLES / name).is_file() else name for name in CALLS[command]]
    status, out, err = call(command, *arguments, "--format", "json")
    assert status == 0, err
    return saved(Path(temporary().name) / f"{command}.json", out)


@cache
def gate_file() -> Path:
    """Return the path of a gate with a criterion of each kind."""
    return saved(Path(temporary().name) / "given_gate.yaml", GATE)


GATE = """robacc_gate: 1
name: cell
criteria:
  - {key: position.p95, limit: 5 mm, reason: r}
  - {name: band, key: position.rms, limit: 1.85 mm, rule: guard_band, false_accept_risk: 0.05, reason: r}
  - {key: position.max, limit: 9 mm, share: 0.9, reason: r}
  - {key: orientation.rms, limit: 1 deg, rule: simple, reason: r}
  - {key: grade, limit: D, reason: r}
  - {key: verdict, limit: [clean, explained], reason: r}
  - {key: after.held_out.position.rms, limit: 1 mm, reason: r}
  - {key: gain, at_least: 0 mm, reason: r}
"""


def seeds(reader: str) -> list[bytes]:
    """Return valid files of the reader to start from."""
    robots, cycles = CONFIGS.iterdir(), (_head("iso9283/poses.csv", 14), CYCLES)
    files: dict[str, Callable[[], Iterable[bytes]]] = {
        "poses": lambda: cycles,
        "cycles": lambda: cycles,
        "robot_poses": lambda: (_head("poses.csv", 12), _head("trace/poses.csv", 12)),
        "robot": lambda: map(Path.read_bytes, (SAMPLES / "truth.yaml", SAMPLES / "trace" / "truth.yaml", *robots)),
        "urdf": lambda: (
            call("export", str(CONFIGS / f"{name}.yaml"), "--urdf", "-")[1].encode() for name in ("puma560", "stanford")
        ),
        "gate": lambda: (GATE.encode(), *map(Path.read_bytes, (CONFIGS.parent / "gates").iterdir())),
        "scale": lambda: map(Path.read_bytes, (CONFIGS.parent / "grades").iterdir()),
        "tolerances": lambda: (TOLERANCES,),
        "result": lambda: (result_file(command).read_bytes() for command in CALLS),
    }
    return list(files[{"robot_used": "robot", "page": "result"}.get(reader, reader)]())


def _head(name: str, count: int) -> bytes:
    return "\n".join((SAMPLES / name).read_text().splitlines()[:count]).encode()


CYCLES = b"""x_mm,y_mm,z_mm,cmd_x_mm,cmd_y_mm,cmd_z_mm,rx_deg,ry_deg,rz_deg,cmd_rx,cmd_ry,cmd_rz,pose,cycle
1,2,3,1,2,3.1,0,0,1,0,0,0,a,1
1,2,4,1,2,3.1,0,0,1,0,0,0,a,2
5,2,3,5,2.1,3,0,0,1,0,0,0.1,b,1
"""
TOLERANCES = b"""units: {length: mm, angle: deg}
distribution: limits
coverage: 3
all: {theta: 0.01, d: 0.2}
joints:
  j2: {a: 0.5}
base: {x: 0.5, yaw: 0.05}
tool: {z: 0.1}
"""


if __name__ == "__main__":
    READERS[sys.argv[1]](Path(sys.argv[2]).read_bytes())
