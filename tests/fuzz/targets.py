"""One call for each reader of robacc: bytes in, and an AssertionError where robacc breaks a rule.

For any bytes, a command ends with the status 0 (valid input), 2, 3, 4 or 5; an error is printable text; printed JSON
has finite numbers only; a valid robot file gives the same robot when it is written and read again.
"""

import contextlib
import io
import json
import os
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import typer
from sample_files import saved

PROJECT = Path(__file__).resolve().parents[2]
SAMPLES = PROJECT / "sample_data"
ALLOWED = frozenset({0, 2, 3, 4, 5})


def folder() -> Path:
    """Return a temporary folder of this process."""
    if not _FOLDER:
        _FOLDER.append(tempfile.TemporaryDirectory(prefix="robacc-fuzz-"))
    return Path(_FOLDER[0].name)


_FOLDER: list[tempfile.TemporaryDirectory[str]] = []


def call(*arguments: str) -> tuple[int, str, str]:
    """Run a command in this process; return exit status, standard output and standard error, raise its defects."""
    from robacc.cli.main import app

    out, err = io.StringIO(), io.StringIO()
    status = 0
    with warnings.catch_warnings(), contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        warnings.simplefilter("error")
        try:
            typer.main.get_command(app)(args=list(arguments), prog_name="robacc")
        except SystemExit as ended:
            status = ended.code if isinstance(ended.code, int) else 0
    return status, out.getvalue(), err.getvalue()


def clean(*arguments: str) -> tuple[int, str]:
    """Run a command, assert the rules that hold for every command, and return status and standard output."""
    status, out, err = call(*arguments)
    assert status in ALLOWED, (status, err)
    assert status in (0, 4, 5) or err, "an error without a message"
    assert status in (0, 4, 5) or not out, "an error with a result"
    for text in (out, err):
        assert all(sign.isprintable() or sign in "\n\t" for sign in text), f"control characters: {text!r:.500}"
    if "json" in arguments and status in (0, 4, 5):
        json.loads(out, parse_constant=_refused)
    return status, out


def _refused(constant: str) -> float:
    raise AssertionError(f"{constant} in a result")


def _written(data: bytes, name: str) -> str:
    path = saved(folder() / name, data)
    return os.fspath(path)


def poses(data: bytes) -> None:
    """Read a CSV of measured poses without a robot."""
    clean("estimate", _written(data, "poses.csv"), "--format", "json")


def robot_poses(data: bytes) -> None:
    """Read a CSV of measured poses of a robot."""
    path = _written(data, "poses.csv")
    clean("estimate", path, "--robot", str(SAMPLES / "robot.yaml"), "--ordered")


def cycles(data: bytes) -> None:
    """Read a CSV of cycles for ISO 9283."""
    clean("iso9283", _written(data, "cycles.csv"), "--format", "json")


def _robot(path: str) -> None:
    status, _ = clean("show", path)
    if status != 0:
        return
    import numpy as np

    from robacc.errors import RobaccError
    from robacc.fitting.parameters import absorb_constants
    from robacc.modelling.robot_file import read_robot
    from robacc.robots.arm import build_chain
    from robacc.robots.yaml_robot import parse_robot, robot_to_yaml

    robot = read_robot(path)
    chain = build_chain(robot)
    poses_at_zero = chain.forward(np.zeros((len(robot.variables), 2)))
    assert np.all(np.isfinite(poses_at_zero.translation))
    assert np.all(np.isfinite(poses_at_zero.rotation))
    try:
        written = robot_to_yaml(absorb_constants(robot))
    except RobaccError:  # errors in effects, which show does not read
        return
    assert robot_to_yaml(parse_robot(written, "again.yaml")) == written


def robot(data: bytes) -> None:
    """Read a robot file."""
    _robot(_written(data, "robot.yaml"))


def robot_used(data: bytes) -> None:
    """Use a robot file with its effects."""
    path = _written(data, "robot.yaml")
    clean("estimate", str(SAMPLES / "poses.csv"), "--robot", path, "--format", "json")
    clean("predict", path, "--samples", "8", "--format", "json")


def urdf(data: bytes) -> None:
    """Read a URDF."""
    _robot(_written(data, "robot.urdf"))


def gate(data: bytes) -> None:
    """Read a gate file."""
    clean("check", str(result_file("estimate")), "--gate", _written(data, "gate.yaml"), "--format", "json")


def scale(data: bytes) -> None:
    """Read a grade scale."""
    path = _written(data, "scale.yaml")
    clean("estimate", str(SAMPLES / "poses.csv"), "--robot", str(SAMPLES / "robot.yaml"), "--scale", path)


def tolerances(data: bytes) -> None:
    """Read a tolerance file."""
    path = _written(data, "tolerances.yaml")
    clean("predict", str(SAMPLES / "robot.yaml"), "--tolerances", path, "--samples", "8", "--format", "json")


def result(data: bytes) -> None:
    """Check a stored result against a gate and compare it with another result."""
    path = _written(data, "result.json")
    clean("check", path, "--gate", str(gate_file()), "--format", "json")
    clean("compare", path, str(result_file("estimate")), "--format", "json")


def page(data: bytes) -> None:
    """Render a stored result as a page with charts."""
    path = _written(data, "result.json")
    clean("report", path, "--output", str(folder() / "page.html"))


READERS: Mapping[str, Callable[[bytes], None]] = {
    reader.__name__: reader
    for reader in (poses, robot_poses, cycles, robot, robot_used, urdf, gate, scale, tolerances, result, page)
}
CALLS = {
    "estimate": ("poses.csv", "--robot", "robot.yaml", "--align", "base_frame,tool_frame"),
    "predict": ("../configs/robots/puma560.yaml", "--samples", "20", "--allocate", "C"),
    "calibrate": ("poses.csv", "--robot", "robot.yaml", "--fit", "base_frame,tool_frame", "--folds", "2"),
    "iso9283": ("iso9283/poses.csv", "--robot", "iso9283/robot.yaml", "--align", "base_frame,tool_frame"),
    "trace": ("poses.csv", "--robot", "robot.yaml", "--declared", "base_frame,tool_frame", "--folds", "2"),
}


def result_file(command: str) -> Path:
    """Return the path of a result on the sample data, computed once."""
    path = folder() / f"{command}.json"
    if not path.exists():
        arguments = [str(SAMPLES / name) if (SAMPLES / name).is_file() else name for name in CALLS[command]]
        status, out, err = call(command, *arguments, "--format", "json")
        assert status == 0, err
        path.write_text(out)
    return path


def gate_file() -> Path:
    """Return the path of a gate with a criterion of each kind."""
    path = folder() / "given_gate.yaml"
    if not path.exists():
        path.write_text(GATE)
    return path


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


def seeds(reader: str) -> Iterator[bytes]:
    """Yield valid files of the reader to start from."""
    if reader in ("poses", "cycles"):
        lines = (SAMPLES / "iso9283" / "poses.csv").read_text().splitlines()
        yield "\n".join(lines[:14]).encode()
        yield b"x_mm,y_mm,z_mm,cmd_x_mm,cmd_y_mm,cmd_z_mm,rx_deg,ry_deg,rz_deg,cmd_rx,cmd_ry,cmd_rz,pose,cycle\n" + (
            b"1,2,3,1,2,3.1,0,0,1,0,0,0,a,1\n1,2,4,1,2,3.1,0,0,1,0,0,0,a,2\n5,2,3,5,2.1,3,0,0,1,0,0,0.1,b,1\n"
        )
    elif reader == "robot_poses":
        lines = (SAMPLES / "poses.csv").read_text().splitlines()
        yield "\n".join(lines[:12]).encode()
        yield "\n".join((SAMPLES / "trace" / "poses.csv").read_text().splitlines()[:12]).encode()
    elif reader in ("robot", "robot_used"):
        for path in (SAMPLES / "truth.yaml", SAMPLES / "trace" / "truth.yaml", *(PROJECT / "configs/robots").iterdir()):
            yield path.read_bytes()
    elif reader == "urdf":
        for name in ("puma560", "stanford"):
            yield call("export", str(PROJECT / f"configs/robots/{name}.yaml"), "--urdf", "-")[1].encode()
    elif reader == "gate":
        yield GATE.encode()
        for path in (PROJECT / "configs/gates").iterdir():
            yield path.read_bytes()
    elif reader == "scale":
        for path in (PROJECT / "configs/grades").iterdir():
            yield path.read_bytes()
    elif reader == "tolerances":
        yield b"units: {length: mm, angle: deg}\ndistribution: limits\ncoverage: 3\nall: {theta: 0.01, d: 0.2}\n" + (
            b"joints:\n  j2: {a: 0.5}\nbase: {x: 0.5, yaw: 0.05}\ntool: {z: 0.1}\n"
        )
    else:
        for command in CALLS:
            yield result_file(command).read_bytes()


if __name__ == "__main__":
    READERS[sys.argv[1]](Path(sys.argv[2]).read_bytes())
