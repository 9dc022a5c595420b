"""The frame of the command line: exit statuses, what goes to which stream, colour, completion."""

from __future__ import annotations

import inspect
import os
import pty
import re
import subprocess
import sys
from pathlib import Path

import commands
import pytest
from commands import missing, refused

import robacc
from robacc.cli import commands as declarations
from robacc.cli.main import COMMANDS, RENAMED
from robacc.errors import MAX_PROBLEMS, InputError, Problem, UsageError
from robacc.render.text import say_error

ROOT = Path(__file__).resolve().parents[2]
SAMPLE = (str(ROOT / "sample_data" / "poses.csv"), "--robot", str(ROOT / "sample_data" / "robot.yaml"))


def run(*arguments: str, code: str = "", **environment: str) -> subprocess.CompletedProcess[str]:
    """A process of its own: ``python -m robacc``, or ``code`` run before the command line."""
    start = ["-c", f"{code}\nfrom robacc.cli.main import main\nmain()"] if code else ["-m", "robacc"]
    return subprocess.run(
        [sys.executable, *start, *arguments],
        capture_output=True,
        text=True,
        cwd=ROOT,
        env={**os.environ, **environment},
        check=False,
    )


def test_version_and_help() -> None:
    done = run("--version")
    assert (done.returncode, done.stdout, done.stderr) == (0, f"robacc {robacc.__version__}\n", "")
    shown = commands.output("--help")
    assert missing(shown, *COMMANDS) == []
    assert not [name for name in RENAMED if f"\n  {name} " in shown]


@pytest.mark.parametrize("name", COMMANDS)
def test_each_command_says_what_the_list_says_of_it(name: str) -> None:
    function = getattr(declarations, name)
    assert (inspect.getdoc(function) or "").splitlines()[0] == COMMANDS[name]


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("robots ur5 --format json", "show robots ur5 --format json"),
        ("effects backlash --robot {0}/robot.yaml", "show --robot={0}/robot.yaml effects backlash"),
        ("schema robots", "show schema robots"),
        ("iso9283-poses {0}/robot.yaml --edge 300mm", "plan --edge 300mm {0}/robot.yaml --for=iso9283 -o -"),
        ("iso9283-poses {0}/robot.yaml -o {1}/five.csv", "plan {0}/robot.yaml --for iso9283"),
        ("import {2} --arm ur10e -o -", "init --from {2} --arm ur10e -o -"),
        ("import {2} --arm ur10e -o -", "init --arm ur10e --from={2} -o -"),
    ],
)
def test_names_of_0_2_do_what_the_new_ones_do_with_one_note(old: str, new: str, tmp_path: Path) -> None:
    files = ROOT / "sample_data", tmp_path, ROOT / "tests" / "controllers" / "samples" / "calibration.conf"
    before, now = (commands.run(*text.format(*files).split()) for text in (old, new))
    assert (before.exit_code, now.exit_code, now.stderr) == (0, 0, "")
    assert before.stdout == now.stdout != ""
    name = old.split()[0]
    assert before.stderr == f"note: robacc {name} is now robacc {RENAMED[name][0]}; the old name works until 0.4\n"


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("estimat", "Did you mean 'estimate'"),
        ("estimate", "Missing argument"),
        ("estimate --nonsense x.csv", "--nonsense"),
        ("estimate x --format y", "--format"),
    ],
)
def test_wrong_usage_is_status_2(words: str, told: str) -> None:
    assert told in refused(*words.split())


def test_bad_input_is_status_3_with_a_line_on_standard_error() -> None:
    done = commands.run("estimate", "nowhere.csv")
    assert (done.exit_code, done.stdout, done.stderr) == (3, "", "error: nowhere.csv: the file does not exist\n")


def test_every_problem_has_its_line_and_each_tip_stands_once(capsys: pytest.CaptureFixture[str]) -> None:
    problem = Problem("found 'a', expected a number", "p.csv", 3, "x", "write 0.5 or 5e-1")
    many = [problem, Problem("is empty", column="y", fix="write 0.5 or 5e-1"), Problem("is odd")]
    say_error(InputError(many, total=MAX_PROBLEMS + 3))
    assert capsys.readouterr().err.splitlines() == [
        "error: p.csv:3, x: found 'a', expected a number",
        "error: y: is empty",
        "error: is odd",
        f"error: … and {MAX_PROBLEMS} more problems",
        "  tip: write 0.5 or 5e-1",
    ]
    say_error(UsageError("one and two do not go together"))
    assert capsys.readouterr().err == "error: one and two do not go together\n"


@pytest.mark.parametrize(
    ("error", "status", "start", "end"),
    [
        ("ZeroDivisionError('here')", 1, "Traceback (most recent call last):", "ZeroDivisionError: here\n"),
        ("KeyboardInterrupt", 130, "interrupted; nothing was written\n", ""),
    ],
)
def test_a_defect_and_an_interrupt_have_their_status(error: str, status: int, start: str, end: str) -> None:
    code = f"import robacc.poses.csv_file as m\ndef f(*a, **k):\n    raise {error}\nm.read_poses = f"
    done = run("estimate", *SAMPLE, code=code)
    assert (done.returncode, done.stdout) == (status, "")
    assert done.stderr.startswith(start)
    assert done.stderr.endswith(end)
    assert status == 1 or done.stderr == start


def test_a_reader_that_leaves_is_no_error_and_loses_no_warning(tmp_path: Path) -> None:
    path = tmp_path / "warm.csv"
    path.write_text(WARM)
    for poses, told in ((SAMPLE[0], ""), (str(path), "temperatur_c")):
        reading, writing = os.pipe()
        words = [sys.executable, "-m", "robacc", "estimate", poses, *SAMPLE[1:]]
        process = subprocess.Popen(words, stdout=writing, stderr=subprocess.PIPE, cwd=ROOT, text=True)
        os.close(writing)
        os.close(reading)
        _, errors = process.communicate()
        assert process.returncode == 141
        assert told in errors if told else errors == ""


WARM = "q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,x,y,z,temperatur_c\n0,0,0,0,60,0,0.6355,0,0.6972,21.5\n"


@pytest.mark.parametrize("n_files", [1, 2])
def test_warnings_stand_below_the_result(tmp_path: Path, n_files: int) -> None:
    paths = [tmp_path / f"{number}.csv" for number in range(n_files)]
    for path in paths:
        path.write_text(WARM)
    shown = terminal("estimate", *map(str, paths), *SAMPLE[1:], NO_COLOR="1")
    # Several files have a line of progress, which is erased.
    assert n_files > 1 or "\033" not in shown
    result, *warnings = re.split(r"^warning: ", shown, flags=re.MULTILINE)
    assert "rms" in result
    assert all(len(warning.splitlines()) == 1 for warning in warnings)
    assert "temperatur_c" in "".join(warnings)


def terminal(*arguments: str, **environment: str) -> str:
    """What a terminal is sent on standard output and standard error."""
    ours, theirs = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, "-m", "robacc", *arguments],
        stdin=theirs,
        stdout=theirs,
        stderr=theirs,
        cwd=ROOT,
        env={**os.environ, "TERM": "xterm-256color", **environment},
    )
    os.close(theirs)
    text = b""
    while True:
        try:
            part = os.read(ours, 65536)
        except OSError:  # what Linux says when the other side has closed
            break
        if not part:
            break
        text += part
    process.wait()
    os.close(ours)
    return text.decode()


def test_colour_on_a_terminal_only_and_not_against_the_readers_wish() -> None:
    assert "\033[1m" in terminal("estimate", *SAMPLE, NO_COLOR="")
    assert "\033[31merror: " in terminal("estimate", "nowhere.csv", NO_COLOR="")
    plain = terminal("estimate", "nowhere.csv", NO_COLOR="1"), terminal("estimate", *SAMPLE, TERM="dumb", NO_COLOR="")
    piped = run("estimate", *SAMPLE, NO_COLOR="").stdout
    assert "\033" not in "".join((*plain, piped))


def test_a_terminal_without_the_signs_is_no_reason_to_crash() -> None:
    done = run("estimate", *SAMPLE, PYTHONIOENCODING="ascii", PYTHONUTF8="0")
    assert (done.returncode, "95 % interval" in done.stdout) == (0, True)


@pytest.mark.parametrize(
    ("words", "number", "found"), [("robacc est", 1, "estimate"), ("robacc estimate --al", 2, "--align")]
)
def test_completion_knows_commands_and_their_options(words: str, number: int, found: str) -> None:
    asked = {"_ROBACC_COMPLETE": "complete_bash", "COMP_WORDS": words, "COMP_CWORD": str(number)}
    completed = run(code="import sys; sys.argv = ['robacc']", **asked).stdout.split()
    assert found in completed
    assert number == 2 or completed == [found]
