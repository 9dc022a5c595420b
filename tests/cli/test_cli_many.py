"""`robacc estimate` on several files: one table, one document or a file each, failures in their place."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from pathlib import Path
from xml.etree import ElementTree

import commands
import pytest
from commands import missing, refused

from robacc.cli.many import distinct_names, each

ROOT = Path(__file__).resolve().parents[2]
SAMPLE = ROOT / "sample_data"
ROBOT = ("--robot", str(SAMPLE / "robot.yaml"))
run, document = partial(commands.run, "estimate"), partial(commands.document, "estimate")
HOW = (*ROBOT, "--align", "base_frame,tool_frame")
GATE = "robacc_gate: 1\nname: g\ncriteria:\n  - {{key: position.rms, limit: {limit} mm, reason: r}}\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Three files: the sample's poses, the first half of them, and one with two bad rows between them."""
    lines = (SAMPLE / "poses.csv").read_text(encoding="utf-8").splitlines(keepends=True)
    (tmp_path / "a.csv").write_text("".join(lines), encoding="utf-8")
    (tmp_path / "b.csv").write_text("".join([*lines[:8], "1,2,3\n", "1,2\n"]), encoding="utf-8")
    (tmp_path / "c.csv").write_text("".join(lines[:32]), encoding="utf-8")
    return tmp_path


def files(folder: Path, names: str = "abc") -> list[str]:
    return [str(folder / f"{name}.csv") for name in names]


def test_one_table_with_the_failure_in_its_place(folder: Path) -> None:
    done = run(*files(folder, "cba"), *HOW)
    assert done.exit_code == 3
    rows = [line for line in done.stdout.splitlines() if ".csv " in line]
    assert [row.split()[0] for row in rows] == ["c.csv", "b.csv", "a.csv"]
    for row, name in ((rows[0], "c"), (rows[2], "a")):
        found = document(*files(folder, name), *HOW)
        sizes = [1e3 * found["position"][key] for key in ("rms_m", "p95_m", "max_m")]
        assert [float(cell) for cell in row.split()[2:5]] == pytest.approx(sizes, rel=6e-3)
        proven = "yes" if found["grade"]["demonstrated"] else "no"
        assert row.split()[-2:] == [found["grade"]["grade"], proven]
    assert rows[1].split(maxsplit=1)[1] == "failed"
    why = "- b.csv, failed: line 9: found 3 fields, expected 14 as in the header (and 1 more)"
    assert commands.missing(done.stdout.replace("\n  ", " "), why, "1 of 3 files could not be estimated") == []
    assert [line.split(": ")[1] for line in done.stderr.splitlines() if line.startswith("error")] == [
        f"{folder / 'b.csv'}:{line}" for line in (9, 10)
    ]


def test_all_of_them_well_is_status_0_and_says_nothing_more(folder: Path) -> None:
    done = run(*files(folder, "ac"), *HOW)
    assert (done.exit_code, done.stderr, "could not" in done.stdout) == (0, "", False)


@pytest.mark.parametrize("form", ["table", "json", "markdown", "github"])
def test_output_to_a_file_is_what_standard_output_shows(folder: Path, form: str) -> None:
    call, target = (*files(folder), *HOW, "--format", form), folder / "all.out"
    shown = run(*call).stdout
    assert (run(*call, "--output", target).stdout, target.read_text(encoding="utf-8")) == ("", shown)


def test_one_document_holds_what_each_file_alone_gives(folder: Path) -> None:
    done = run(*files(folder), *HOW, "--format", "json")
    found = json.loads(done.stdout)
    assert (done.exit_code, found["schema"], found["n_files"], found["n_failed"]) == (3, "robacc.estimate-many/1", 3, 1)
    assert [one["kind"] for one in found["inputs"]] == ["robot"]
    assert str(folder) not in done.stdout
    first, failed, last = found["results"]
    assert [one["file"] for one in found["results"]] == ["a.csv", "b.csv", "c.csv"]
    assert (failed["done"], failed["exit_status"], failed["summary"], failed["n_problems"]) == (False, 3, None, 2)
    assert ([problem["line"] for problem in failed["problems"]], "result" in failed) == ([9, 10], False)
    for name, one in (("a", first), ("c", last)):
        alone = document(*files(folder, name), *HOW)
        assert one["result"] == alone
        assert one["summary"]["rms_m"] == alone["position"]["rms_m"]
        assert one["summary"]["n_poses"] == alone["n_poses"]


@pytest.mark.slow
def test_processes_change_nothing(folder: Path) -> None:
    alone = run(*files(folder), *HOW, "--format", "json", "--jobs", "1")
    several = run(*files(folder), *HOW, "--format", "json", "--jobs", "3")
    assert (several.exit_code, several.stdout, several.stderr) == (alone.exit_code, alone.stdout, alone.stderr)


@pytest.mark.parametrize(
    ("form", "suffix", "more"),
    [("json", ".json", ()), ("table", ".txt", ()), ("table", ".txt", ("--full",)), ("markdown", ".md", ())],
)
def test_a_folder_takes_each_result_as_the_command_alone_writes_it(
    folder: Path, form: str, suffix: str, more: tuple[str, ...]
) -> None:
    out = folder / "new" / "results"
    errors = folder / "errors"
    options = (*HOW, *more, "--format", form)
    done = run(*files(folder), *options, "--output", f"{out}/", "--per-pose", f"{errors}/")
    assert (done.exit_code, sorted(path.name for path in out.iterdir())) == (3, [f"a{suffix}", f"c{suffix}"])
    for name in "ac":
        alone = run(*files(folder, name), *options, "--per-pose", str(folder / "alone.csv"))
        assert (out / f"{name}{suffix}").read_text(encoding="utf-8") == alone.stdout
        assert (errors / f"{name}.csv").read_bytes() == (folder / "alone.csv").read_bytes()
    if form == "json":
        entries = json.loads(done.stdout)["results"]
        assert [one["written"] for one in entries] == ["a.json", None, "c.json"]
        assert not any("result" in one for one in entries)
    else:
        assert "b.csv" in done.stdout


@pytest.mark.parametrize(
    ("limit", "names", "status"), [(9, "ac", 0), (0.45, "ac", 5), (0.1, "ac", 4), (9, "abc", 3), (0.1, "abc", 3)]
)
def test_the_gate_judges_each_and_the_worst_status_counts(folder: Path, limit: float, names: str, status: int) -> None:
    gate = folder / "gate.yaml"
    gate.write_text(GATE.format(limit=limit), encoding="utf-8")
    junit = folder / "junit.xml"
    done = run(*files(folder, names), *HOW, "--gate", str(gate), "--junit", str(junit))
    assert done.exit_code == status
    word = {0: "pass", 4: "fail", 5: "inconclusive"}.get(status, "pass" if limit == 9 else "fail")
    assert (done.stdout.splitlines()[4].split()[-1], "a.csv, position.rms: " in done.stdout) == (word, word != "pass")
    suites = list(ElementTree.parse(junit).getroot())
    assert [suite.get("name") for suite in suites] == [f"{name}.csv" for name in names]
    assert [suite.get("id") for suite in suites] == [str(number) for number in range(len(names))]
    failed = [bool(int(suite.get("failures", "")) + int(suite.get("errors", ""))) for suite in suites]
    assert failed == [name == "b" or word != "pass" for name in names]
    if status == 5:
        first = json.loads(run(*files(folder, names), *HOW, "--gate", gate, "--format", "json").stdout)["results"][0]
        assert first["gate"] == first["result"]["gate"]


def test_annotations_say_what_became_of_each_file(folder: Path) -> None:
    gate = folder / "gate.yaml"
    gate.write_text(GATE.format(limit=0.45), encoding="utf-8")
    for more, level in (((), "notice"), (("--gate", gate), "warning")):
        lines = run(*files(folder), *HOW, "--format", "github", *more).stdout.splitlines()
        assert [line.split("::")[1].split()[0] for line in lines] == [level, "error", level]
        assert more or "60 poses; rms 0.490 mm" in lines[0]


def test_warnings_carry_their_files_name(folder: Path) -> None:
    far = "x,y,z,cmd_x,cmd_y,cmd_z,cmd_yy\n1,2,3,1,2,4,0\n1.1,2,3,1.1,2,4,0\n1,2.1,3.1,1.2,2,4,0\n"
    for path in files(folder, "ac"):
        Path(path).write_text(far, encoding="utf-8")
    done = run(*files(folder, "ac"))
    assert [line.partition("; ")[0] for line in done.stderr.splitlines()] == [
        f"warning: {folder / 'c'}.csv:1: unknown column 'cmd_yy' is ignored",
        "warning: c.csv: the errors are too large for an arm and suggest frames that are not registered",
    ]
    assert done.stderr.count("(the same in 2 files)") == 2


@pytest.mark.slow
def test_one_page_has_the_results_side_by_side(folder: Path) -> None:
    page = folder / "page.html"
    assert run(*files(folder), *HOW, "--report", str(page)).exit_code == 3
    assert missing(page.read_text(encoding="utf-8"), "2 results side by side", "a.csv") == []


def test_a_file_that_the_call_does_not_fit_fails_alone(folder: Path) -> None:
    (folder / "c.csv").write_text("x,y,z,cmd_x,cmd_y,cmd_z\n1,2,3,1,2,3.001\n1,2,4,1,2,4.002\n", encoding="utf-8")
    table, found = run(*files(folder, "ac")), run(*files(folder, "ac"), "--format", "json")
    assert (table.exit_code, json.loads(found.stdout)["results"][0]["exit_status"]) == (3, 2)
    assert "a.csv, failed: the poses have no commanded positions" in table.stdout


@pytest.mark.parametrize(
    ("arguments", "status", "message"),
    [
        (["a", "-"], 2, "- (standard input) has no name"),
        (["a", "c", "a"], 2, "a.csv is given twice"),
        (["a", "c", "--confidence", "2"], 2, "less than 1, not 2"),
        (["a", "c", "--align", "base_frme"], 2, "cannot align base_frme; choose among base_frame, tool_frame"),
        (["a", "c", "--tip-link", "t"], 2, "choose a chain of a URDF, so they need --robot"),
        (["a", "c", "--robot", "none.yaml"], 3, "none.yaml: the file does not exist"),
        (["a", "c", "--scale", "none.yaml"], 3, "none.yaml: the file does not exist"),
        (["a", "c", "--per-pose", "x.csv"], 2, "several files need a folder"),
        (["a", "c", "--per-pose", "./"], 2, "a.csv is also an input and would be overwritten"),
        (["a", "c", "--output", "a.csv/"], 3, "a.csv/: cannot be created: "),
        (["sub/c", "c", "sub-c", "--output", "out/"], 2, "would both be written to out/sub-c.txt"),
    ],
)
def test_what_is_wrong_for_all_is_said_once(
    folder: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], status: int, message: str
) -> None:
    monkeypatch.chdir(folder)
    Path("sub").mkdir()
    for name in ("sub/c", "sub-c"):
        Path(f"{name}.csv").write_bytes(Path("a.csv").read_bytes())
    words = [f"{one}.csv" if one in ("a", "c", "sub/c", "sub-c") else one for one in arguments]
    told = refused("estimate", *words, status=status)
    assert message in told
    assert told.count("error: ") == 1


@pytest.mark.parametrize(
    ("paths", "names"),
    [
        (["x/a.csv", "x/b.csv"], ["a.csv", "b.csv"]),
        (["x/a.csv", "y/a.csv", "y/b.csv"], ["x/a.csv", "y/a.csv", "b.csv"]),
        (["m/x/a.csv", "n/x/a.csv", "./a.csv"], ["m/x/a.csv", "n/x/a.csv", "a.csv"]),
    ],
)
def test_names_are_as_short_as_they_can_be_told_apart(paths: list[str], names: list[str]) -> None:
    assert distinct_names(paths) == names


@pytest.mark.parametrize(
    ("error", "message", "status"), [(BrokenProcessPool(), "lack of memory", 3), (KeyError(), "which is a defect", 1)]
)
def test_what_is_said_of_a_file_whose_process_died(
    folder: Path, monkeypatch: pytest.MonkeyPatch, error: Exception, message: str, status: int
) -> None:
    def dying(work: object, tasks: list[object], jobs: int) -> object:
        yield 1, error
        yield from each(work, tasks[:1], 1)  # type: ignore[arg-type]

    monkeypatch.setattr("robacc.cli.many.each", dying)
    done = run(*files(folder, "ac"), *HOW)
    assert done.exit_code == status
    assert missing(done.stdout, message, "a.csv                   60") == []


def test_an_interrupt_leaves_whole_files_and_no_process(folder: Path) -> None:
    # A pipe that nobody writes to: its reader waits for ever, so the command is at work when the interrupt comes,
    # however fast or loaded the machine is.
    waiting = [folder / f"waiting{number}.csv" for number in range(2)]
    for path in waiting:
        os.mkfifo(path)
    out = folder / "out"
    options = (*ROBOT, "--format", "json", "--jobs", "2", "--output", f"{out}/")
    process = subprocess.Popen(
        [sys.executable, "-m", "robacc", "estimate", *files(folder, "ac"), *map(str, waiting), *options],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=ROOT,
        start_new_session=True,
        # A shell's background job ignores interrupts, and its children with it.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.default_int_handler),
    )
    while process.poll() is None and not all((out / f"{name}.json").exists() for name in "ac"):
        time.sleep(0.01)
    # As a terminal does: to every process of the group.
    os.killpg(process.pid, signal.SIGINT)
    shown, errors = process.communicate()
    assert (process.returncode, shown) == (130, "")
    assert errors.startswith("interrupted; ")
    assert errors.count("\n") == 1
    assert f"of 4 results are in {out}/" in errors
    for path in out.iterdir():
        assert path.suffix == ".json", "a half-written file is left"
        json.loads(path.read_text(encoding="utf-8"))
    assert len(list(out.iterdir())) == 2
    assert _ended(process.pid), "a process is left"


def _ended(group: int) -> bool:
    """Whether no process of the group is left, soon or after a long wait."""
    for _ in range(60_000):
        try:
            os.killpg(group, 0)
        except ProcessLookupError:
            return True
        time.sleep(0.01)
    return False
