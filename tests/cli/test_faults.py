"""Every exit status, what ends a run from outside, robots at the edges, and files made to mislead."""

import json
import math
import os
import re
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import commands
import numpy as np
import pytest
from commands import output, refused, run
from pose_files import Reader
from results import run as run_in_project
from sample_files import SAMPLES, saved

import robacc
from robacc import InputError, Measurements
from robacc.__main__ import main
from robacc.cli.main import Commands
from robacc.io.dialect import find_dialect
from robacc.io.files import sha256_of
from robacc.poses.csv_file import format_poses, read_poses
from robacc.poses.reading import is_documented

# Every exit status, and what ends a run from outside: an interrupt, a full disk, a broken pipe, a second run.

COMMANDED = "x,y,z,cmd_x,cmd_y,cmd_z"

ESTIMATE = ("estimate", str(SAMPLES / "poses.csv"), "--robot", str(SAMPLES / "robot.yaml"))


def process_words(*arguments: str) -> tuple[str, ...]:
    return (sys.executable, "-m", "robacc", *arguments)


def shell(line: str) -> subprocess.CompletedProcess[str]:
    command = f'"{sys.executable}" -m robacc'
    poses, robot = SAMPLES / "trace" / "poses.csv", SAMPLES / "trace" / "robot.yaml"
    # Poses whose result is longer than the buffer of a pipe.
    long = f"{{ cat {poses}; for i in 1 2 3; do tail -n 150 {poses}; done; }}"
    warm = f"sed 's/^q1/temperatur_c,q1/;s/^[-0-9]/20,&/' {poses} | cat"
    estimate = f"{command} {' '.join(ESTIMATE)}"
    line = line.format(robacc=command, estimate=estimate, samples=SAMPLES, long=long, warm=warm, robot=robot)
    return subprocess.run(("bash", "-c", line), capture_output=True, text=True, timeout=60, check=False)


def processor_time(process: int) -> float:
    """Seconds of the processor that a process has taken (proc(5), fields 14 and 15)."""
    fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
    return sum(map(int, fields[11:13])) / os.sysconf("SC_CLK_TCK")


@pytest.fixture(scope="module")
def many(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """So many poses that a trace is at work for some seconds."""
    path = tmp_path_factory.mktemp("faults") / "poses.csv"
    truth = str(SAMPLES / "trace" / "truth.yaml")
    options = ("--poses", "2500", "--seed", "3", "--noise", "0.02mm", "--position-only", "-o", str(path))
    commands.output("simulate", truth, *options)
    return path


@pytest.mark.parametrize(
    ("number", "times", "status", "told"),
    [
        (signal.SIGINT, 1, 130, "interrupted; nothing was written\n"),
        pytest.param(signal.SIGINT, 3, 130, "interrupted; nothing was written\n", marks=pytest.mark.slow),
        pytest.param(signal.SIGTERM, 1, 143, "", marks=pytest.mark.slow),
    ],
)
def test_a_trace_that_is_ended_at_work(
    many: Path, tmp_path: Path, number: int, times: int, status: int, told: str
) -> None:
    """One line and no file, however often it is interrupted."""
    robot = str(SAMPLES / "trace" / "robot.yaml")
    declared = ("--declared", "base_frame,tool_frame,joint_offset,link_geometry")
    files = ("-o", str(tmp_path / "t.txt"), "--write-model", str(tmp_path / "m.yaml"))
    process = subprocess.Popen(
        process_words("trace", str(many), "--robot", robot, *declared, *files),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    # At work, however fast or loaded the machine is: reading and importing take less of the processor.
    while process.poll() is None and processor_time(process.pid) < 1.5:
        time.sleep(0.02)
    assert process.poll() is None
    for _ in range(times):
        if process.poll() is None:
            (os.killpg if number == signal.SIGINT else os.kill)(process.pid, number)
        time.sleep(0.02)
    out, err = process.communicate(timeout=20)
    # After an interrupt within exec() Python ends itself by the signal, which a shell shows as the same 130.
    assert process.returncode in (status, -number)
    assert (out, err, list(tmp_path.iterdir())) == ("", told, [])


@pytest.mark.parametrize("delay", [0.15, 0.3])
def test_an_interrupt_while_it_starts(delay: float) -> None:
    process = subprocess.Popen(
        process_words("trace", str(SAMPLES / "trace/poses.csv"), "--robot", str(SAMPLES / "trace/robot.yaml")),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    # Until Python itself is up, an interrupt is Python's to answer.
    while process.poll() is None and "robacc" not in Path(f"/proc/{process.pid}/cmdline").read_text():
        time.sleep(0.005)
    time.sleep(delay)
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=20)
    assert out == ""
    # On a loaded machine the signal may end the process before Python has a handler, or its own start.
    if process.returncode != -signal.SIGINT and not re.search("runpy|init_import_site", err):
        assert err == "interrupted; nothing was written\n"


def test_an_interrupt_before_the_command_is_told(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(Commands, "make_context", interrupted)
    monkeypatch.setattr("robacc.__main__._handle_signals", lambda: None)
    monkeypatch.setattr(sys, "argv", ["robacc", "show", "robots"])
    with pytest.raises(SystemExit) as end:
        main()
    assert end.value.code == 130
    assert capsys.readouterr() == ("", "interrupted; nothing was written\n")


def limited() -> None:
    """No file above 4 kB, as on a full disk."""
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))


def test_a_full_disk_leaves_the_file_that_was_there(tmp_path: Path) -> None:
    path = saved(tmp_path / "result.json", "old")
    words = process_words(*ESTIMATE, "--format", "json", "-o", str(path))
    done = subprocess.run(words, capture_output=True, text=True, timeout=60, check=False, preexec_fn=limited)
    assert (done.returncode, done.stdout, done.stderr) == (3, "", f"error: {path}: cannot be written: file too large\n")
    assert [(one.name, one.read_text()) for one in tmp_path.iterdir()] == [("result.json", "old")]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
@pytest.mark.parametrize("command", ["{estimate} --format json", "{robacc} --help"])
def test_a_full_standard_output(command: str) -> None:
    done = shell(f"{command} > /dev/full")
    told = "error: standard output: cannot be written: no space left on device\n"
    assert (done.returncode, done.stderr) == (3, told)


@pytest.mark.parametrize(
    ("line", "status", "told"),
    [
        ("{estimate} >&-", 3, "error: standard output: cannot be written: not writable\n"),
        ("{estimate} -o /dev/null >&-", 0, ""),
        ("{robacc} estimate - <&-", 3, "error: <stdin>: the file is empty\n"),
        ("{robacc} estimate nowhere.csv 2>&-", 3, ""),
        ("{long} | {robacc} estimate - --robot {robot} --format json | head -1; exit ${{PIPESTATUS[1]}}", 141, ""),
        ("{warm} | {robacc} estimate - --robot {robot} | true; exit ${{PIPESTATUS[2]}}", 141, "warning: <stdin>:"),
        ("{robacc} --help | true; exit ${{PIPESTATUS[0]}}", 141, ""),
        ("{robacc} estimate nowhere.csv 2>&1 | true; exit ${{PIPESTATUS[0]}}", 141, ""),
    ],
)
def test_closed_streams_and_broken_pipes(line: str, status: int, told: str) -> None:
    done = shell(line)
    assert done.returncode == status
    assert done.stderr.startswith(told)
    assert "Traceback" not in done.stderr


@pytest.mark.skipif(not Path("/dev/stdout").exists(), reason="needs /dev/stdout")
def test_pipes_that_have_a_name_are_written_to(tmp_path: Path) -> None:
    plain = shell("{estimate} --format json").stdout
    for line in ("{estimate} --format json -o /dev/stdout | cat", "{estimate} --format json -o >(cat) | cat"):
        done = shell(line)
        assert (done.returncode, done.stdout, done.stderr) == (0, plain, "")


@pytest.mark.parametrize("option", ["-o", "--write-model", "--report"])
def test_an_output_without_a_folder_is_refused_before_the_work(option: str, tmp_path: Path) -> None:
    path, long = tmp_path / "none" / "x", option.replace("-o", "--output")
    for given, status, message in (
        (path, 3, f"{path}: cannot be written: its folder does not exist tip: create the folder first"),
        (tmp_path, 3, f"{tmp_path}: is a folder, not a file tip: name a file in it"),
        ("", 2, f"{long}: expected the name of a file, found nothing"),
    ):
        # The poses are not looked at: what is wrong with them would be said first.
        told = refused("trace", "nowhere.csv", "--robot", "nowhere.yaml", option, given, status=status)
        assert told == f"error: {message}"


def test_two_runs_on_one_file_and_one_that_is_killed(tmp_path: Path) -> None:
    """Whoever comes last has written the whole file; one that is killed at any moment has written nothing of it."""
    path = tmp_path / "result.json"
    command = process_words(*ESTIMATE, "--format", "json", "-o", str(path))
    for one in [subprocess.Popen(command) for _ in range(2)]:
        assert one.wait(60) == 0
    whole = path.read_text()
    assert json.loads(whole)["n_poses"] == 60
    code = (
        "import os, signal\nfrom robacc.io import files\n"
        "files.os.fsync = lambda _: os.kill(os.getpid(), signal.SIGKILL)\n"
        f"files.write_file({str(path)!r}, 'new' * 100000)"
    )
    assert subprocess.run((sys.executable, "-c", code), check=False).returncode == -signal.SIGKILL
    assert path.read_text() == whole


OPEN_GATE = "{robacc_gate: 1, name: g, criteria: [{key: position.rms, limit: 9 mm, reason: r}]}"


@pytest.mark.parametrize(
    ("line", "status", "wanted"),
    [
        ("{robacc} show <(cat {samples}/robot.yaml) --format json", 0, "{digest}"),
        ("{robacc} export - --urdf - < {samples}/robot.yaml 2> /dev/null | {robacc} show -", 0, "sample arm"),
        ("{estimate} --gate <(echo '{gate}') --format json", 0, '"outcome": "pass"'),
        ("{estimate} --format json | {robacc} check - --gate <(echo '{gate}')", 0, "pass"),
    ],
)
def test_dash_is_standard_input_and_output_everywhere(line: str, status: int, wanted: str) -> None:
    digest = sha256_of(SAMPLES / "robot.yaml")
    # The line is a format.
    done = shell(line.replace("{gate}", OPEN_GATE.replace("{", "{{").replace("}", "}}")))
    assert done.returncode == status, done.stderr
    assert wanted.replace("{digest}", digest) in done.stdout + done.stderr


def test_dash_of_several_inputs_and_outputs() -> None:
    written = output(*ESTIMATE, "--gate", "-", "--junit", "-", "-o", os.devnull, text=OPEN_GATE)
    assert '<testsuite id="0"' in written
    assembly = SAMPLES.parent / "configs" / "gates" / "assembly.yaml"
    told = refused(*ESTIMATE, "--gate", assembly, "--junit", "-")
    assert "both name standard output; name a file for one of them" in told
    assert "standard input can be read only once" in refused("estimate", "-", "--robot", "-")


def repeats(folder: Path, head: str, rows: Iterable[Iterable[object]]) -> str:
    """What is said of repeated rows of a pose file, without its name."""
    path = saved(folder / "poses.csv", "\n".join([head, *(",".join(map(str, row)) for row in rows)]))
    return "; ".join(text for text in read_poses(path).warnings if "repeat" in text).removeprefix(f"{path}: ")


def test_rows_that_repeat_one_another_are_told_of(tmp_path: Path) -> None:
    rows = np.random.default_rng(0).normal(size=(40, 6)).tolist()
    assert repeats(tmp_path, COMMANDED, rows) == ""
    told = repeats(tmp_path, COMMANDED, [*rows, rows[7], rows[3]])
    assert told.startswith("2 rows repeat an earlier row in every column (line 4")


@pytest.mark.parametrize(
    ("copies", "digits", "told"),
    [
        (0, 17, None),
        (3, 17, "3 rows repeat an earlier row of another visit to the last digit (line 59 repeats"),
        (20, 4, None),
    ],
)
def test_a_measurement_copied_to_another_visit_is_told_of(
    copies: int, digits: int, told: str | None, tmp_path: Path
) -> None:
    """Three of sixty rows have the values of another visit; of rounded values many repeat by chance."""
    copied = np.round(np.random.default_rng(0).normal(size=(60, 6)), digits)
    copied[60 - copies :] = copied[:copies]
    found = repeats(tmp_path, f"visit,{COMMANDED}", ([f"v{i}", *row] for i, row in enumerate(copied.tolist())))
    assert found.startswith(told) if told else found == ""


def test_measured_values_copied_with_new_times_are_told_of(tmp_path: Path) -> None:
    """Every row twice, with another time; visits of one pose that agree to 1 um now and then are no copies."""
    rng = np.random.default_rng(0)
    commanded = rng.normal(size=(40, 3))
    once = np.hstack([np.round(commanded + rng.normal(0, 1e-5, commanded.shape), 6), commanded])
    often = np.repeat(commanded, 30, axis=0)
    noisy = np.hstack([np.round(often + rng.normal(0, 4e-6, often.shape), 6), often])
    assert np.unique(noisy[:, :3], axis=0).shape[0] < 1200
    tables = (once, np.repeat(once, 2, axis=0), noisy, np.hstack([np.round(often, 4), often]))
    head = f"time_s,{COMMANDED}"
    found = [repeats(tmp_path, head, ([30 * i, *row] for i, row in enumerate(table.tolist()))) for table in tables]
    assert found.pop(1).startswith("40 rows repeat the measured values of an earlier row to the last digit (line 3 ")
    assert found == ["", "", ""]


SAMPLE = ("sample_data/poses.csv", "--robot", "sample_data/robot.yaml")

GATES = {
    "pass": "  - {key: position.rms, limit: 9 mm, reason: r}\n",
    "fail": "  - {key: position.rms, limit: 1 mm, reason: r}\n  - {key: verdict, limit: clean, reason: r}\n",
    "inconclusive": "  - {key: position.rms, limit: 1.85 mm, reason: r}\n",
    "missing": "  - {key: position.rms, limit: 9 mm, reason: r}\n  - {key: verdict, limit: clean, reason: r}\n",
    "bad": "  - {key: position.rms, limit: 9, reason: r}\n",
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    made = tmp_path_factory.mktemp("gates")
    for name, text in GATES.items():
        (made / f"{name}.yaml").write_text(f"robacc_gate: 1\nname: g\ncriteria:\n{text}")
    output("estimate", *SAMPLE, "--format", "json", "-o", made / "result.json")
    (made / "broken.json").write_text('{"schema": "robacc.estimate/1", ')
    return made


@pytest.mark.parametrize(
    ("command", "status"),
    [
        ("{estimate}", 0),
        ("{estimate} --gate {folder}/pass.yaml", 0),
        ("check {folder}/result.json --gate {folder}/pass.yaml", 0),
        ("check - --gate {folder}/pass.yaml", 0),
        ("estimate", 2),
        ("estimates x.csv", 2),
        ("check {folder}/result.json", 2),
        ("{estimate} --junit {folder}/j.xml", 2),
        ("estimate nowhere.csv", 3),
        ("{estimate} --gate {folder}/bad.yaml", 3),
        ("{estimate} --gate {folder}/nowhere.yaml", 3),
        ("check {folder}/broken.json --gate {folder}/pass.yaml", 3),
        ("check sample_data/poses.csv --gate {folder}/pass.yaml", 3),
        ("{estimate} --gate {folder}/pass.yaml --junit {folder}/none/j.xml", 3),
        ("{estimate} --gate {folder}/fail.yaml", 4),
        ("check {folder}/result.json --gate {folder}/fail.yaml --format github", 4),
        ("{estimate} --gate {folder}/inconclusive.yaml", 5),
        ("check {folder}/result.json --gate {folder}/missing.yaml --format markdown", 5),
    ],
)
def test_status(command: str, status: int, folder: Path) -> None:
    words = command.replace("{estimate}", " ".join(("estimate", *SAMPLE))).split()
    done = run(
        *(word.format(folder=folder) for word in words), text=(folder / "result.json").read_text(encoding="utf-8")
    )
    assert done.exit_code == status, done.stderr
    # What cannot be used leaves nothing on standard output for the next program to take as a result.
    assert bool(done.stdout) == (status in (0, 4, 5))


# Robots, errors and poses at the edges of what there is: each command answers with finite numbers or says why.

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
    "no noise": (robot(6), 15, "0mm"),
    "1 pose": (robot(6), 1, "0.02mm"),
    "2 poses": (robot(6), 2, "0.02mm"),
    "base far off, pitch of 90 degrees": (robot(6, base=FAR), 30, "0.02mm"),
}

FIT = "base_frame,joint_offset,joint_compliance"

CALLS: dict[str, Callable[[str, str], robacc.Result]] = {
    "estimate": lambda poses, robot: robacc.estimate(poses, robot=robot),
    "predict": lambda poses, robot: robacc.predict(robot, samples=8),
    "calibrate": lambda poses, robot: robacc.calibrate(poses, robot=robot, fit=FIT, folds=2),
    "trace": lambda poses, robot: robacc.trace(poses, robot=robot, declared="base_frame,tool_frame", folds=2),
    "iso9283": lambda poses, robot: robacc.iso9283(poses, robot=robot),
}


def made(folder: Path, text: str, count: int, noise: str) -> dict[str, str]:
    """The robot file and poses measured on it."""
    files = {"robot": str(folder / "robot.yaml"), "poses": str(folder / "poses.csv")}
    Path(files["robot"]).write_text(text)
    options = ("--seed", "1", "--noise", noise, "--noise-orientation", "0.1mrad", "-o", files["poses"])
    done = run_in_project("simulate", files["robot"], "--poses", str(count), *options)
    assert done.exit_code == 0, done.stderr
    return files


def no_constant(constant: str) -> float:
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
    """The exit status and the document of a call as the command has them, its table looked over too."""
    try:
        result = CALLS[command](files["poses"], files["robot"])
    except InputError as error:
        return error.exit_status, {}
    document: dict[str, Any] = json.loads(result.to_json(), parse_constant=no_constant)
    reasoned(document)
    assert not {"nan", "inf", "-inf"} & set(str(result).lower().replace("(", " ").replace(",", " ").split())
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
    done = run_in_project("estimate", files["poses"], "--robot", files["robot"])
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
    files = made(tmp_path, robot(6).replace("[-2.5, 2.5]", "[0.1, 0.1]"), 20, "0.02mm")
    assert robacc.calibrate(files["poses"], robot=files["robot"], fit=FIT, folds=2).converged


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
    done = run_in_project("estimate", str(path), "--format", "json")
    assert done.exit_code == 0
    found = json.loads(done.stdout, parse_constant=no_constant)
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


# Files made to mislead: each gets one message, a warning, or the right reading; none gets a traceback.

URDF = (
    '<robot name="a"><link name="b"><collision><geometry><mesh filename="{mesh}"/></geometry></collision></link>'
    '<link name="t"/><joint name="j" type="revolute"><parent link="b"/><child link="t"/><axis xyz="0 0 1"/>'
    '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>'
)

TRACED_ROBOT = "sample_data/trace/robot.yaml"


@pytest.mark.skipif(not Path("/proc/self/mem").exists(), reason="needs a file that opens and cannot be read")
def test_an_input_that_fails_while_it_is_read_is_named() -> None:
    with pytest.raises(InputError, match="/proc/self/mem: cannot be read: input/output error"):
        robacc.read_poses("/proc/self/mem")


@pytest.mark.parametrize(
    ("mesh", "message"),
    [
        ("../secret.stl", r"mesh \.\./secret\.stl lies outside the folder or package of the URDF"),
        ("package://../secret.stl", "lies outside the folder or package of the URDF"),
        ("package://./../secret.stl", "(lies outside the folder or package of the URDF|is not there)"),
        ("poses.json", "a collision mesh cannot be read"),
        ("none.stl", r"mesh none\.stl is not there"),
    ],
)
@pytest.mark.filterwarnings("ignore")
def test_a_mesh_stays_inside_the_package_and_any_failure_is_one_message(
    tmp_path: Path, mesh: str, message: str
) -> None:
    pytest.importorskip("fcl")
    folder = tmp_path / "arm" / "urdf"
    folder.mkdir(parents=True)
    for name in ("arm/secret.stl", "arm/meshes.stl", "secret.stl", "arm/urdf/poses.json"):
        (tmp_path / name).write_text("{}")
    urdf = saved(folder / "arm.urdf", URDF.format(mesh=mesh))
    with pytest.raises(InputError, match=message):
        robacc.plan(urdf, poses=5, purpose="calibrate", collisions=True)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("mesh", ["../meshes/a.stl", "package://arm/meshes/a.stl", "package://tool/meshes/a.stl"])
def test_a_mesh_of_the_package_or_of_one_beside_it_is_read(tmp_path: Path, mesh: str) -> None:
    pytest.importorskip("fcl")
    import trimesh

    from robacc_plugins.collisions import read_link_shapes

    for name in ("arm/urdf", "arm/meshes", "tool/meshes"):
        (tmp_path / name).mkdir(parents=True)
    (tmp_path / "arm" / "package.xml").write_text("<package/>")
    for name in ("arm", "tool"):
        trimesh.creation.box((1, 1, 1)).export(tmp_path / name / "meshes" / "a.stl")
    urdf = saved(tmp_path / "arm" / "urdf" / "arm.urdf", URDF.format(mesh=mesh))
    (shape,) = read_link_shapes(str(urdf), robacc.read_robot(urdf))
    assert shape.faces.shape == (12, 3)


def test_ids_that_a_spreadsheet_would_run_are_marked_and_read_back(read: Reader, tmp_path: Path) -> None:
    ids = ["=1+1", "+cmd|x", "-2", "-a", "@sum", "'b", "P1", "+3.5"]
    data = Measurements(np.arange(24.0).reshape(3, 8), q=np.linspace(0, 1, 8)[None], pose=np.array(ids))
    text = format_poses(data)
    written = [line.rpartition(",")[2] for line in text.splitlines()[1:]]
    assert written == ["'=1+1", "'+cmd|x", "-2", "'-a", "'@sum", "'b", "P1", "+3.5"]
    assert read(text).pose.tolist() == ids
    commanded = Measurements(data.position, commanded_position=data.position + 1e-4, pose=data.pose)
    cells = [line.split(",")[1] for line in robacc.estimate(commanded).per_pose_csv().splitlines()[1:]]
    assert cells == written


def test_a_last_line_that_ends_inside_a_number_is_warned_of(read: Reader) -> None:
    rows = [f"{0.1 * i:.3f},1.000,2.000,{3 + 0.0125 * i:.4f}" for i in range(8)]
    text = "\n".join(["q1,x,y,z", *rows])
    assert read(text).warnings == read(text + "\n").warnings == ()
    (warning,) = read(text[:-2]).warnings
    assert "poses.csv: 3.08, the last number, has fewer decimals than those above" in warning
    assert read(text[:-2] + "\n").warnings == ()
    comma = text.replace(",", ";").replace(".", ",").replace("q1;x;y;z", "J1 [rad];X [m];Y [m];Z [m]")
    assert "3,08, the last number, has fewer decimals" in read(comma[:-2]).warnings[-1]


def test_a_payload_that_no_arm_carries_is_warned_of(read: Reader) -> None:
    (warning,) = read("q1,x,y,z,payload_kg\n0,1,2,3,4\n0.1,1,2,3.1,1e9\n0.2,1,2,3.2,4\n").warnings
    assert warning.endswith("poses.csv:3: payload_kg is 1e+09 kg, more than an arm carries")


@pytest.mark.parametrize("title", ["J1,X,Y,Z", "measured"])
@pytest.mark.parametrize("marks", [("---", "'12"), ("---", "'"), ("---", "''")])
def test_rows_of_marks_and_apostrophes_are_no_header(title: str, marks: tuple[str, str]) -> None:
    rng = np.random.default_rng(0)
    rows = [",".join([f"{rng.normal():.4f}", *rng.choice(marks, 3)]) for _ in range(200)]
    assert find_dialect([title, *rows], is_documented).header_line in (None, 0)


def test_a_temperature_that_no_effect_depends_on_refuses_no_target(tmp_path: Path) -> None:
    data = robacc.simulate("sample_data/trace/truth.yaml", poses=40, seed=2, temperature=(23, 25)).data
    targets = robacc.simulate(TRACED_ROBOT, poses=5, seed=3, motion=False).data
    frames = ("base_frame", "tool_frame", "joint_offset")
    plain, thermal = (
        robacc.calibrate(data, robot=TRACED_ROBOT, fit=fit).robot for fit in (frames, (*frames, "thermal_expansion"))
    )
    cold = {"temperature": 22, "most": "100mm,30deg", "strict_range": True}
    result = robacc.correct(targets, model=plain, **cold)
    assert result.n_corrected == 5
    (warning,) = [text for text in result.warnings if "temperature" in text]
    assert warning.startswith("the targets are at 22 to 22 °C, the model was fitted at 23")
    within = robacc.correct(targets, model=plain, temperature=24, most="1m")
    assert "°C" not in "\n".join(within.warnings)
    np.testing.assert_array_equal(result.q, within.q)
    with pytest.raises(InputError, match="temperature_c is outside the range"):
        robacc.correct(targets, model=thermal, **cold)
