"""The frame of the command line: exit statuses, streams, colour, completion, help, names of options, build servers."""

import contextlib
import inspect
import itertools
import json
import os
import pty
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from functools import cache
from pathlib import Path

import commands
import pytest
import results
import yaml
from commands import missing, output, refused, run
from sample_files import CONFIGS, POSES, ROBOT, ROOT, SAMPLES, saved
from typer.testing import CliRunner

import robacc
from robacc.api.fitting import Calibrated
from robacc.cli import commands as declarations
from robacc.cli.hooks import main
from robacc.cli.main import COMMANDS, FORMS, RENAMED, app, form_of
from robacc.errors import MAX_PROBLEMS, InputError, Problem, UsageError
from robacc.render.text import as_options, say_error

# The frame of the command line: exit statuses, what goes to which stream, colour, completion.

ESTIMATED = (str(POSES), "--robot", str(ROBOT))


def process(*arguments: str, code: str = "", **environment: str) -> subprocess.CompletedProcess[str]:
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
    done = process("--version")
    assert (done.returncode, done.stdout, done.stderr) == (0, f"robacc {robacc.__version__}\n", "")
    shown = commands.output("--help")
    assert missing(shown, *COMMANDS) == []
    assert not [name for name in RENAMED if f"\n  {name} " in shown]


@pytest.mark.parametrize("name", COMMANDS)
def test_each_command_says_what_the_list_says_of_it(name: str) -> None:
    assert (inspect.getdoc(getattr(declarations, name)) or "").splitlines()[0] == COMMANDS[name]


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("robots ur5 --format json", "show robots ur5 --format json"),
        ("effects backlash --robot {0}/robot.yaml", "show --robot={0}/robot.yaml effects backlash"),
        ("schema robots", "show schema robots"),
        ("iso9283-poses {0}/robot.yaml --edge 250mm -o {1}/five.csv", "plan {0}/robot.yaml --for iso9283 --edge 250mm"),
        ("import {2} --arm ur10e -o -", "init --arm ur10e --from={2} -o -"),
    ],
)
def test_names_of_0_2_do_what_the_new_ones_do_with_one_note(old: str, new: str, tmp_path: Path) -> None:
    files = SAMPLES, tmp_path, ROOT / "tests" / "plugins" / "samples" / "calibration.conf"
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
    done = process("estimate", *ESTIMATED, code=code)
    assert (done.returncode, done.stdout) == (status, "")
    assert done.stderr.startswith(start)
    assert done.stderr.endswith(end)
    assert status == 1 or done.stderr == start


WARM = "q1_deg,q2_deg,q3_deg,q4_deg,q5_deg,q6_deg,x,y,z,temperatur_c\n0,0,0,0,60,0,0.6355,0,0.6972,21.5\n"


@pytest.mark.parametrize("n_files", [1, 2])
def test_warnings_stand_below_the_result(tmp_path: Path, n_files: int) -> None:
    paths = [tmp_path / f"{number}.csv" for number in range(n_files)]
    for path in paths:
        path.write_text(WARM)
    shown = terminal("estimate", *map(str, paths), *ESTIMATED[1:], NO_COLOR="1")
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
    # Linux says by an error that the other side has closed.
    with contextlib.suppress(OSError):
        while part := os.read(ours, 65536):
            text += part
    process.wait()
    os.close(ours)
    return text.decode()


def test_colour_on_a_terminal_only_and_not_against_the_readers_wish() -> None:
    assert "\033[1m" in terminal("estimate", *ESTIMATED, NO_COLOR="")
    assert "\033[31merror: " in terminal("estimate", "nowhere.csv", NO_COLOR="")
    plain = (
        terminal("estimate", "nowhere.csv", NO_COLOR="1"),
        terminal("estimate", *ESTIMATED, TERM="dumb", NO_COLOR=""),
    )
    assert "\033" not in "".join((*plain, process("estimate", *ESTIMATED, NO_COLOR="").stdout))


def test_a_terminal_without_the_signs_is_no_reason_to_crash() -> None:
    done = process("estimate", *ESTIMATED, PYTHONIOENCODING="ascii", PYTHONUTF8="0")
    assert (done.returncode, "95 % interval" in done.stdout) == (0, True)


@pytest.mark.parametrize(
    ("words", "number", "found"), [("robacc est", 1, "estimate"), ("robacc estimate --al", 2, "--align")]
)
def test_completion_knows_commands_and_their_options(words: str, number: int, found: str) -> None:
    asked = {"_ROBACC_COMPLETE": "complete_bash", "COMP_WORDS": words, "COMP_CWORD": str(number)}
    completed = process(code="import sys; sys.argv = ['robacc']", **asked).stdout.split()
    assert found in completed
    assert number == 2 or completed == [found]


# The example that ends every command's help runs as it stands, on the sample data.

FILES = {
    "poses.csv": POSES,
    "robot.yaml": ROBOT,
    "targets.csv": SAMPLES / "iso9283" / "plan.csv",
    "model.yaml": SAMPLES / "truth.yaml",
    "cycles.csv": SAMPLES / "iso9283" / "poses.csv",
    "calibration.conf": ROOT / "tests" / "plugins" / "samples" / "calibration.conf",
    "gate.yaml": ROOT / "configs" / "gates" / "machine_tending.yaml",
}
"""What the examples name, by the sample that stands in for it."""

IDENTITY = "serial_number: '12345'\ncustomer: works\n"

TOLERANCES = "units: {length: mm, angle: deg}\nall: {theta: 0.006, d: 0.1, a: 0.1, alpha: 0.006}\n"

ESTIMATE = ("estimate", "poses.csv", "--robot", "robot.yaml", "--align", "base_frame,tool_frame", "--format", "json")

FIT = ("calibrate", "poses.csv", "--robot", "robot.yaml", "--format", "json")

RESULTS = {
    "result.json": ESTIMATE,
    "arm1.json": ESTIMATE,
    "arm2.json": (*ESTIMATE, "--frame", "base"),
    "fit1.json": (*FIT, "--folds", "2"),
    "fit2.json": (*FIT, "--folds", "3"),
}
"""Results that examples name, by the command that makes them."""


@cache
def result(file: str) -> str:
    return results.text("trace") if file == "trace.json" else output(*RESULTS[file])


@cache
def calibrated() -> Calibrated:
    """The full test that a quick test and a history need."""
    return robacc.calibrate(POSES, robot=ROBOT, folds=2)


def example(name: str) -> str:
    text = output(*name.split(), "--help")
    assert max(map(len, text.splitlines())) <= 80
    description = re.split(r"^(?:Arguments|Options):$", text, flags=re.MULTILINE)[0]
    last_paragraph = " ".join(description.strip().split("\n\n")[-1].split())
    match = re.fullmatch(r"Example: (robacc \S.*)", last_paragraph)
    assert match, f"the help of {name} ends with {last_paragraph!r}, not with an example"
    return match[1]


@pytest.mark.parametrize("name", [*COMMANDS, *FORMS])
def test_the_example_at_the_end_of_the_help_runs(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    words = shlex.split(example(name))
    assert words[0] == "robacc"
    assert form_of(words[1], words[2:])[0] in (name, f"{name} add")
    monkeypatch.chdir(tmp_path)
    for file, source in FILES.items():
        shutil.copy(source, file)
    Path("tolerances.yaml").write_text(TOLERANCES, encoding="utf-8")
    Path("cell7.yaml").write_text(IDENTITY, encoding="utf-8")
    for file in set(words) & {*RESULTS, "trace.json"}:
        Path(file).write_text(result(file), encoding="utf-8")
    if "arm.db" in words and "add" not in words:
        calibrated().write_model("calibrated.yaml")
        robacc.history_add(calibrated(), db="arm.db")
    before = set(tmp_path.iterdir())
    done = run(*words[1:])
    # A gate may fail or be undecided, which is no error.
    assert done.exit_code in ((0, 4, 5) if name == "check" else (0,)), done.stderr
    assert "error:" not in done.stderr
    assert done.stdout or set(tmp_path.iterdir()) > before
    for flag, file in itertools.pairwise(words):
        if flag in ("--output", "--write-model", "--urdf", "--folder"):
            assert (tmp_path / file).exists()


# Texts name parameters, which the terminal shows as options.


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("`align` needs `against`", "--align needs --against"),
        ("`base_link`, `tip_link`: none", "--base-link, --tip-link: none"),
        ('try `align="base_frame,tool_frame"`', "try --align base_frame,tool_frame"),
        ("try `jobs=1` (or `ordered=True`)", "try --jobs 1 (or --ordered)"),
        ("`shrink=False`, `robust=False`, `empirical=False`", "--no-shrink, --all-rows, --named-only"),
        ("unknown key '`robot`', ``x``, a`b`c, \"`y`\"", "unknown key '`robot`', ``x``, a`b`c, \"`y`\""),
    ],
)
def test_marked_names_become_options(text, shown):
    assert as_options(text) == shown


def test_errors_show_options_on_the_terminal_only(capsys):
    error = UsageError("`poses` and `samples` both say where to predict")
    say_error(error)
    say_error(InputError(Problem("no column", "poses.csv", fix="give `robot`")))
    assert str(error) == "`poses` and `samples` both say where to predict"
    assert capsys.readouterr().err == (
        "error: --poses and --samples both say where to predict\nerror: poses.csv: no column\n  tip: give --robot\n"
    )


# Files for build servers: they are valid, and what they run exists.


def test_the_action_runs_commands_and_options_that_exist() -> None:
    action = yaml.safe_load((ROOT / "action.yml").read_text(encoding="utf-8"))
    assert action["runs"]["using"] == "composite"
    scripts = "\n".join(step.get("run", "") for step in action["runs"]["steps"])
    # Inputs reach a script through its environment only: a text of a pull request is never part of a script.
    assert "${{" not in scripts
    used = set(re.findall(r"inputs\.([a-z-]+)", (ROOT / "action.yml").read_text(encoding="utf-8")))
    assert used == set(action["inputs"])
    assert action["inputs"]["command"]["default"] in COMMANDS
    help_text = CliRunner().invoke(app, ["check", "--help"]).stdout
    for option in ("--gate", "--format", "--junit"):
        assert option in scripts
        assert option in help_text


# https://docs.github.com/en/actions/reference/workflows-and-actions/metadata-syntax
TOP_KEYS = {"name", "author", "description", "inputs", "outputs", "runs", "branding"}

INPUT_KEYS = {"description", "required", "default", "deprecationMessage", "type"}

STEP_KEYS = {"name", "id", "if", "run", "shell", "env", "working-directory", "uses", "with", "continue-on-error"}


def test_the_action_follows_the_metadata_syntax() -> None:
    action = yaml.safe_load((ROOT / "action.yml").read_text(encoding="utf-8"))
    assert {"name", "description", "runs"} <= action.keys() <= TOP_KEYS
    for entry in action["inputs"].values():
        assert "description" in entry
        assert entry.keys() <= INPUT_KEYS
        # An input is required, or it has a default.
        assert ("default" in entry) != entry.get("required", False)
    assert action["runs"].keys() == {"using", "steps"}
    for step in action["runs"]["steps"]:
        assert step.keys() <= STEP_KEYS
        assert ("run" in step) != ("uses" in step)
        assert ("shell" in step) == ("run" in step)  # a composite action must name the shell of each script
        assert "uses" not in step or re.fullmatch(r"[\w-]+/[\w-]+@v\d+", step["uses"])


@pytest.mark.skipif(shutil.which("bash") is None, reason="the scripts of the action are for bash")
def test_the_scripts_of_the_action_measure_and_check(tmp_path: Path) -> None:
    rows = "".join(f"{i},{i % 7},{i % 5},{i}.1,{i % 7},{i % 5}\n" for i in range(8))
    (tmp_path / "poses of today.csv").write_text("cmd_x_mm,cmd_y_mm,cmd_z_mm,x_mm,y_mm,z_mm\n" + rows, encoding="utf-8")
    criterion = "{name: accurate, key: position.rms, limit: LIMIT, rule: simple, reason: as ordered}"
    text = f"robacc_gate: 1\nname: cell\ncriteria:\n  - {criterion.replace('LIMIT', '0.01 mm')}\n"
    (tmp_path / "gate.yaml").write_text(text, encoding="utf-8")
    command = tmp_path / "bin" / "robacc"
    command.parent.mkdir()
    command.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m robacc "$@"\n', encoding="utf-8")
    command.chmod(0o755)
    action = yaml.safe_load((ROOT / "action.yml").read_text(encoding="utf-8"))
    values = {name: str(entry.get("default", "")) for name, entry in action["inputs"].items()}
    values |= {"poses": "poses of today.csv", "arguments": "--frame base --confidence 0.9"}
    steps = {step.get("name"): step for step in action["runs"]["steps"]}

    def run(name: str, **given: str) -> subprocess.CompletedProcess[str]:
        step = steps[name]
        env = {key: (values | given)[text.strip("${} ").removeprefix("inputs.")] for key, text in step["env"].items()}
        path = f"{command.parent}{os.pathsep}{os.environ['PATH']}"
        env = {
            **os.environ,
            **env,
            "PATH": path,
            "PYTHONPATH": str(ROOT),
            "GITHUB_STEP_SUMMARY": str(tmp_path / "s.md"),
        }
        # The call of bash that GitHub documents for ``shell: bash``.
        bash = ["bash", "--noprofile", "--norc", "-eo", "pipefail", "-c", step["run"]]
        return subprocess.run(bash, cwd=tmp_path, env=env, capture_output=True, text=True, check=False)

    measured = run("Measure")
    assert measured.returncode == 0, measured.stderr
    assert json.loads((tmp_path / values["result"]).read_text(encoding="utf-8"))["options"]["confidence"] == 0.9
    failed = run("Check", gate="gate.yaml")
    assert failed.returncode == 4
    assert failed.stdout.startswith("::error title=cell%3A accurate::fail")
    assert 'failures="1"' in (tmp_path / values["junit"]).read_text(encoding="utf-8")
    assert "FAIL (1 fail)" in (tmp_path / "s.md").read_text(encoding="utf-8")


def test_the_container_has_extras_and_the_command_that_exist() -> None:
    text = (ROOT / "Containerfile").read_text(encoding="utf-8")
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    built, installed = (set(found.split(",")) for found in re.findall(r"\[([a-z,]+)\]", text.replace('["robacc"]', "")))
    assert built == installed <= project["optional-dependencies"].keys()
    assert re.search(r'^ENTRYPOINT \["robacc"\]$', text, re.MULTILINE)
    assert "robacc" in project["scripts"]
    (version,) = set(re.findall(r"python:(\d\.\d+)-slim", text))
    assert f"Programming Language :: Python :: {version}" in project["classifiers"]


def test_the_hook_stops_at_a_wrong_robot_file(tmp_path: Path) -> None:
    (hook,) = yaml.safe_load((ROOT / ".pre-commit-hooks.yaml").read_text(encoding="utf-8"))
    assert hook["entry"] == "python -m robacc.cli.hooks"
    robots = sorted(map(str, CONFIGS.glob("*.yaml")))
    assert all(re.search(hook["files"], path) for path in robots)
    assert main(robots) == 0
    assert main([robots[0], str(saved(tmp_path / "wrong.yaml", "robacc: 1\nname: x\n"))]) == 3
