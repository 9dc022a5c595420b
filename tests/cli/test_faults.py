"""Every exit status, and what ends a run from outside: an interrupt, a full disk, a broken pipe, a second run."""

from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Iterable
from pathlib import Path

import commands
import numpy as np
import pytest
from commands import output, refused, run

from robacc.io.files import sha256_of
from robacc.poses.csv_file import read_poses

PROJECT = Path(__file__).resolve().parents[2]
COMMANDED = "x,y,z,cmd_x,cmd_y,cmd_z"
SAMPLES = PROJECT / "sample_data"
ESTIMATE = ("estimate", str(SAMPLES / "poses.csv"), "--robot", str(SAMPLES / "robot.yaml"))


def robacc(*arguments: str) -> tuple[str, ...]:
    return (sys.executable, "-m", "robacc", *arguments)


def shell(line: str) -> subprocess.CompletedProcess[str]:
    command = f'"{sys.executable}" -m robacc'
    poses, robot = SAMPLES / "trace" / "poses.csv", SAMPLES / "trace" / "robot.yaml"
    # Poses whose result is longer than the buffer of a pipe.
    long = f"{{ cat {poses}; for i in 1 2 3; do tail -n 150 {poses}; done; }}"
    estimate = f"{command} {' '.join(ESTIMATE)}"
    line = line.format(robacc=command, estimate=estimate, samples=SAMPLES, long=long, robot=robot)
    return subprocess.run(("bash", "-c", line), capture_output=True, text=True, timeout=60, check=False)


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
        robacc("trace", str(many), "--robot", robot, *declared, *files),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    time.sleep(2.0)
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
        robacc("trace", str(SAMPLES / "trace/poses.csv"), "--robot", str(SAMPLES / "trace/robot.yaml")),
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
    # On a loaded machine the signal may end the process before Python has a handler.
    if process.returncode != -signal.SIGINT and "runpy" not in err:
        assert err == "interrupted; nothing was written\n"


def limited() -> None:
    """No file above 4 kB, as on a full disk."""
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))


def test_a_full_disk_leaves_the_file_that_was_there(tmp_path: Path) -> None:
    path = tmp_path / "result.json"
    path.write_text("old")
    words = robacc(*ESTIMATE, "--format", "json", "-o", str(path))
    done = subprocess.run(words, capture_output=True, text=True, timeout=60, check=False, preexec_fn=limited)
    assert (done.returncode, done.stdout, done.stderr) == (3, "", f"error: {path}: cannot be written: file too large\n")
    assert [(one.name, one.read_text()) for one in tmp_path.iterdir()] == [("result.json", "old")]


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
@pytest.mark.parametrize(
    "command", ["{estimate} --format json", "{robacc} show {samples}/robot.yaml", "{robacc} --help"]
)
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
        ("{robacc} show {samples}/robot.yaml | true; exit ${{PIPESTATUS[0]}}", 141, ""),
        ("{robacc} --help | true; exit ${{PIPESTATUS[0]}}", 141, ""),
        ("{robacc} trace --help | true; exit ${{PIPESTATUS[0]}}", 141, ""),
        ("{robacc} --version | true; exit ${{PIPESTATUS[0]}}", 141, ""),
        ("{robacc} | true; exit ${{PIPESTATUS[0]}}", 141, ""),
        ("{robacc} estimate nowhere.csv 2>&1 | true; exit ${{PIPESTATUS[0]}}", 141, ""),
        ("{robacc} estimate --foo 2>&1 | true; exit ${{PIPESTATUS[0]}}", 141, ""),
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
    command = robacc(*ESTIMATE, "--format", "json", "-o", str(path))
    for one in [subprocess.Popen(command) for _ in range(2)]:
        assert one.wait(60) == 0
    whole = path.read_text()
    assert json.loads(whole)["n_poses"] == 60
    code = (
        "import os, signal\nfrom robacc.io import files\n"
        "files.os.fsync = lambda _: os.kill(os.getpid(), signal.SIGKILL)\n"
        f"files.write_text({str(path)!r}, 'new' * 100000)"
    )
    assert subprocess.run((sys.executable, "-c", code), check=False).returncode == -signal.SIGKILL
    assert path.read_text() == whole


@pytest.mark.parametrize(
    ("line", "status", "wanted"),
    [
        ("{robacc} show - < {samples}/robot.yaml", 0, "sample arm"),
        ("{robacc} show <(cat {samples}/robot.yaml) --format json", 0, "{digest}"),
        ("{robacc} export - --urdf - < {samples}/robot.yaml 2> /dev/null | {robacc} show -", 0, "sample arm"),
        ("echo '{gate}' | {estimate} --gate - --junit - -o /dev/null", 0, '<testsuite id="0"'),
        ("{estimate} --gate <(echo '{gate}') --format json", 0, '"outcome": "pass"'),
        ("{estimate} --format json | {robacc} check - --gate <(echo '{gate}')", 0, "pass"),
        ("{robacc} estimate - --robot - < {samples}/robot.yaml", 2, "standard input can be read only once"),
        ("{estimate} --gate g --junit -", 2, "both name standard output; name a file for one of them"),
    ],
)
def test_dash_is_standard_input_and_output_everywhere(line: str, status: int, wanted: str) -> None:
    gate = "{{robacc_gate: 1, name: g, criteria: [{{key: position.rms, limit: 9 mm, reason: r}}]}}"
    digest = sha256_of(SAMPLES / "robot.yaml")
    if "--gate g " in line:
        line = line.replace("--gate g", "--gate {samples}/../configs/gates/assembly.yaml")
    done = shell(line.replace("{gate}", gate))
    assert done.returncode == status, done.stderr
    assert wanted.replace("{digest}", digest) in done.stdout + done.stderr


def repeats(folder: Path, head: str, rows: Iterable[Iterable[object]]) -> str:
    """What is said of repeated rows of a pose file, without its name."""
    path = folder / "poses.csv"
    path.write_text("\n".join([head, *(",".join(map(str, row)) for row in rows)]))
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
HEAD = "robacc_gate: 1\nname: g\ncriteria:\n"
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
        (made / f"{name}.yaml").write_text(HEAD + text)
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
    words = command.format(estimate=" ".join(("estimate", *SAMPLE)), folder=folder).split()
    done = run(*words, text=(folder / "result.json").read_text(encoding="utf-8"))
    assert done.exit_code == status, done.stderr
    # What cannot be used leaves nothing on standard output for the next program to take as a result.
    assert bool(done.stdout) == (status in (0, 4, 5))


def test_a_shell_can_tell_fail_from_undecided(folder: Path) -> None:
    script = (
        f'"{sys.executable}" -m robacc estimate {" ".join(SAMPLE)} --gate {folder}/inconclusive.yaml > /dev/null\n'
        'case $? in 0) echo pass;; 4) echo fail;; 5) echo "measure more";; *) echo broken;; esac\n'
    )
    done = subprocess.run(script, shell=True, cwd=PROJECT, capture_output=True, text=True, check=True)
    assert done.stdout == "measure more\n"
