"""`robacc estimate` from files to its table, its JSON and its per-pose CSV; several files at once."""

import csv
import hashlib
import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from xml.etree import ElementTree

import commands
import numpy as np
import pytest
from commands import missing, output
from sample_files import POSES, ROBOT, ROOT, agreed, saved
from scipy.spatial.transform import Rotation
from slow_parameters import some_fast

from robacc.cli.many import distinct_names
from robacc.workers import WorkerKilled, Workers

# `robacc estimate` from files to its table, its JSON and its per-pose CSV.

SAMPLE = (str(POSES), "--robot", str(ROBOT))

run, _, document, refused = commands.calls_of("estimate")

COMMANDED = """\
pose,x_mm,y_mm,z_mm,roll_deg,pitch_deg,yaw_deg,cmd_x_mm,cmd_y_mm,cmd_z_mm,cmd_roll_deg,cmd_pitch_deg,cmd_yaw_deg
a,100.12,200.00,300.05,0,0,90.02,100,200,300,0,0,90
b,400.00,-99.91,250.03,10,0.03,0,400,-100,250,10,0,0
c,-200.07,50.02,410.00,0,20,0,-200,50,410,0,20.01,0
d,10.00,20.00,29.80,0,0,45,10,20,30,0,0,45.04
e,15.03,20.06,30.02,-30.02,0,45,15,20,30,-30,0,45
"""


def independent_errors() -> tuple[np.ndarray, np.ndarray]:
    """Tool-frame errors of the commanded file, ``(n, 3)`` m and rad, by scipy."""
    rows = [[float(cell) for cell in line.split(",")[1:]] for line in COMMANDED.splitlines()[1:]]
    attained, commanded = np.hsplit(np.array(rows), 2)
    turn_a, turn_c = (Rotation.from_euler("xyz", part[:, 3:], degrees=True) for part in (attained, commanded))
    d = turn_c.inv().apply(attained[:, :3] - commanded[:, :3]) * 1e-3
    return d, (turn_c.inv() * turn_a).as_rotvec()


def test_json_has_the_contract_keys_and_the_right_numbers(tmp_path: Path) -> None:
    path = saved(tmp_path / "poses.csv", COMMANDED)
    found = document(str(path))
    assert (found["schema"], found["n_poses"], found["frame"], found["seed"]) == ("robacc.estimate/1", 5, "tool", 0)
    assert found["inputs"] == [
        {"name": "poses.csv", "sha256": hashlib.sha256(path.read_bytes()).hexdigest(), "kind": "poses"}
    ]
    for key, unit, errors in zip(("position", "orientation"), ("m", "rad"), independent_errors(), strict=True):
        part = found[key]
        size = np.linalg.norm(errors, axis=1)
        centred = errors - errors.mean(axis=0)
        for name, expected in {
            f"errors_{unit}": errors,
            f"mean_{unit}": errors.mean(axis=0),
            f"covariance_{unit}2": errors.T @ errors / 5,
            f"centred_covariance_{unit}2": centred.T @ centred / 5,
            f"rms_{unit}": np.sqrt(np.mean(size**2)),
            f"mean_error_{unit}": size.mean(),
            f"p95_{unit}": np.percentile(size, 95),
            f"max_{unit}": size.max(),
        }.items():
            np.testing.assert_allclose(part[name], expected, atol=1e-15, rtol=1e-10, err_msg=name)
    # The 95th percentile of the position error is 0.19 mm.
    assert found["grade"]["grade"] == "B"
    assert found["grade"]["demonstrated"] is False
    assert found["worst_poses"]["by_position"][0]["line"] == 5


def test_same_bytes_every_time_and_seed_matters() -> None:
    first, again = (run(*SAMPLE, "--format", "json").stdout for _ in range(2))
    assert (first, str(ROOT) in first) == (again, False)
    found = json.loads(first), document(*SAMPLE, "--seed", 1)
    assert len({one["position"]["intervals"]["mean_error_m"]["lower"] for one in found}) == 2


def test_table_is_as_it_was() -> None:
    shown = output("estimate", "-", "--full", text=COMMANDED)
    assert shown == agreed("estimate.txt", shown)


ALIGNED = (*SAMPLE, "--align", "base_frame,tool_frame")


@pytest.mark.parametrize("arguments", [SAMPLE, ALIGNED, (*ALIGNED, "--full"), (*SAMPLE, "--frame", "base", "--full")])
def test_table_fits_a_page_and_has_no_loose_ends(arguments: tuple[str, ...]) -> None:
    for line in run(*arguments).stdout.splitlines():
        assert len(line) <= 80 or " against the model " in line or " robacc trace " in line
        assert line == line.rstrip()


def test_warnings_go_to_standard_error_and_into_the_result() -> None:
    result = run("-", "--format", "json", text="x,y,z,cmd_x,cmd_y,cmd_z,cmd_yy\n1,2,3,1,2,3,0\n")
    assert (result.exit_code, result.stderr[:9], "cmd_yy" in result.stderr) == (0, "warning: ", True)
    assert any("cmd_yy" in warning for warning in json.loads(result.stdout)["warnings"])


def test_per_pose_csv(tmp_path: Path) -> None:
    target = tmp_path / "errors.csv"
    output("estimate", "-", "--per-pose", target, text=COMMANDED.replace("\na,", '\n"a, first",'))
    rows = list(csv.DictReader(target.read_text(encoding="utf-8").splitlines()))
    d, delta = independent_errors()
    assert ([row["line"] for row in rows], rows[0]["pose"]) == (["2", "3", "4", "5", "6"], "a, first")
    expected = np.column_stack((d, delta, np.linalg.norm(d, axis=1)))
    names = ("dx_m", "dy_m", "dz_m", "rx_rad", "ry_rad", "rz_rad", "error_m")
    np.testing.assert_allclose([[float(row[name]) for name in names] for row in rows], expected, atol=1e-15)


def test_several_targets_are_reported_apart() -> None:
    text = "target,x,y,z,cmd_x,cmd_y,cmd_z\n" + "".join(
        f"{name},1,2,{3 + error},1,2,3\n" for name, error in (("t1", 1e-3), ("t2", 2e-3), ("t1", 3e-3), ("t2", 4e-3))
    )
    found = document("-", text=text)
    assert [(target["target"], target["n_poses"]) for target in found["targets"]] == [("t1", 2), ("t2", 2)]
    np.testing.assert_allclose([target["mean_error_m"] for target in found["targets"]], [2e-3, 3e-3], rtol=1e-9)
    assert "Position error by target, mm" in run("-", text=text).stdout


def test_grade_scale_of_the_users_own(tmp_path: Path) -> None:
    scale = saved(
        tmp_path / "scale.yaml",
        "robacc: 1\nname: shop floor\nstatistic: max\nconfidence: 0.9\nunits: {length: mm, angle: deg}\n"
        "steps:\n  - {grade: good, position: 10, orientation: 5}\notherwise: poor\n",
    )
    found = document(*SAMPLE, "--scale", str(scale))
    assert (found["grade"]["grade"], found["grade"]["scale"]) == ("good", "shop floor")
    assert found["inputs"][2]["kind"] == "scale"
    # The scale demonstrates at its own confidence; the figures keep the one asked for.
    assert (found["grade"]["confidence"], found["position"]["confidence"]) == (0.9, 0.95)
    assert document(*SAMPLE, "--confidence", "0.99")["position"]["confidence"] == 0.99


def test_a_mean_without_an_interval_has_the_digits_of_the_errors() -> None:
    """One pose twice, as far to one side as to the other: a mean of nothing but rounding shows no nine zeros."""
    rows = "pose,x_mm,y_mm,z_mm,cmd_x_mm,cmd_y_mm,cmd_z_mm\na,100.3,0,0,100.1,0,0\na,99.9,0,0,100.1,0,0\n"
    shown = output("estimate", "-", "--full", text=rows)
    assert re.search(r"^mean vector.*\n *x +0\.000\b.*\n *y +0\.000\b.*\n *z +0\.000\b", shown, re.MULTILINE)


@pytest.mark.parametrize(
    ("name", "form", "start"),
    [
        ("r.json", (), "{"),
        ("R.JSON", (), "{"),
        ("r.md", (), "## robacc estimate"),
        ("r.txt", (), "Error of"),
        ("r.json", ("--format", "table"), "Error of"),
        ("r.txt", ("--format", "json"), "{"),
    ],
)
def test_ending_of_the_output_chooses_the_form(tmp_path: Path, name: str, form: tuple[str, ...], start: str) -> None:
    output("estimate", "-", "-o", tmp_path / name, *form, text=COMMANDED)
    assert (tmp_path / name).read_text(encoding="utf-8").startswith(start)


# `robacc estimate` on several files: one table, one document or a file each, failures in their place.

HOW = (*SAMPLE[1:], "--align", "base_frame,tool_frame")

GATE = "robacc_gate: 1\nname: g\ncriteria:\n  - {{key: position.rms, limit: {limit} mm, reason: r}}\n"


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Three files: the sample's poses, the first half of them, and one with two bad rows between them."""
    lines = POSES.read_text(encoding="utf-8").splitlines(keepends=True)
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
    assert commands.missing(done.stdout.replace("\n  ", " "), why, "1 of 3 files have no result") == []
    assert [line.split(": ")[1] for line in done.stderr.splitlines() if line.startswith("error")] == [
        f"{folder / 'b.csv'}:{line}" for line in (9, 10)
    ]


def test_all_of_them_well_is_status_0_and_says_nothing_more(folder: Path) -> None:
    done = run(*files(folder, "ac"), *HOW)
    assert (done.exit_code, done.stderr, "could not" in done.stdout) == (0, "", False)


@pytest.mark.parametrize("form", ["table", "json"])
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


@pytest.mark.parametrize(
    ("form", "suffix", "more"),
    [("json", ".json", ()), ("table", ".txt", ("--full",)), ("markdown", ".md", ())],
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
    gate = saved(folder / "gate.yaml", GATE.format(limit=limit))
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
    gate = saved(folder / "gate.yaml", GATE.format(limit=0.45))
    for more, level in (((), "notice"), (("--gate", gate), "warning")):
        lines = run(*files(folder), *HOW, "--format", "github", *more).stdout.splitlines()
        assert [line.split("::")[1].split()[0] for line in lines] == [level, "error", level]
        assert more or "60 poses; rms 0.490 mm" in lines[0]


def test_warnings_carry_their_files_name(folder: Path) -> None:
    far = "x,y,z,cmd_x,cmd_y,cmd_z,cmd_yy\n1,2,3,1,2,4,0\n1.1,2,3,1.1,2,4,0\n1,2.1,3.1,1.2,2,4,0\n"
    for path in files(folder, "ac"):
        Path(path).write_text(far, encoding="utf-8")
    done = run(*files(folder, "ac"))
    assert [line.partition("; ")[0].partition(": check")[0] for line in done.stderr.splitlines()] == [
        f"warning: {folder / 'c'}.csv:1: unknown column 'cmd_yy' is ignored",
        "warning: c.csv: the errors are too large for an arm",
    ]
    assert done.stderr.count("(the same in 2 files)") == 2


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
    told = refused(*words, status=status)
    assert message in told
    assert told.count("error: ") == 1


@pytest.mark.parametrize("command", some_fast(["calibrate", "trace"], 2))
def test_fits_of_several_files_are_one_table_with_models(tmp_path: Path, command: str) -> None:
    sample = ROOT / "sample_data" / "trace"
    for name in ("one", "two"):
        (tmp_path / f"{name}.csv").write_bytes((sample / "poses.csv").read_bytes())
    (tmp_path / "bad.csv").write_text("q1,x\n", encoding="utf-8")
    paths = [str(tmp_path / f"{name}.csv") for name in ("one", "two", "bad")]
    declared = "--fit" if command == "calibrate" else "--declared"
    how = ("--robot", str(sample / "robot.yaml"), declared, "base_frame,tool_frame,joint_offset")
    out, models = tmp_path / "out", tmp_path / "models"
    done = commands.run(command, *paths, *how, "--format", "json", "--output", f"{out}/", "--write-model", f"{models}/")
    assert done.exit_code == 3
    assert commands.missing(done.stdout, "rms of held-out poses", "bad.csv             failed", "1 of 3 files") == []
    assert sorted(path.name for path in models.iterdir()) == ["one.yaml", "two.yaml"]
    one, two = (json.loads((out / f"{name}.json").read_text(encoding="utf-8")) for name in ("one", "two"))
    assert one["after"]["held_out"] == two["after"]["held_out"]
    (row,) = (line for line in done.stdout.splitlines() if line.startswith("one.csv"))
    stages = [1e3 * one[stage]["held_out"]["position"]["rms_m"] for stage in ("nominal", "after")]
    assert [float(cell) for cell in row.split()[2:4]] == pytest.approx(stages, rel=6e-3)
    assert "several files need --output DIR/" in commands.run(command, *paths, *how, "--format", "json").stderr


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
    ("error", "message", "status"), [(WorkerKilled(), "lack of memory", 3), (KeyError(), "which is a defect", 1)]
)
def test_what_is_said_of_a_file_whose_process_died(
    folder: Path, monkeypatch: pytest.MonkeyPatch, error: Exception, message: str, status: int
) -> None:
    each = Workers.each

    def dying(workers: Workers, work: object, tasks: list[object]) -> object:
        yield 1, error
        yield from each(workers, work, tasks[:1])  # type: ignore[arg-type]

    monkeypatch.setattr(Workers, "each", dying)
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
    options = (*SAMPLE[1:], "--format", "json", "--jobs", "2", "--output", f"{out}/")
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


def test_the_next_step_reads_the_poses_as_this_one_did(tmp_path: Path) -> None:
    (tmp_path / "cell 3").mkdir()
    rows = [line.split(",") for line in POSES.read_text(encoding="utf-8").splitlines()[1:]]
    parts = {"joints.csv": slice(6), "points.csv": slice(6, 9)}
    joints, points = (
        saved(tmp_path / "cell 3" / name, "".join(",".join(row[part]) + "\n" for row in rows))
        for name, part in parts.items()
    )
    told = run(points, "--commanded", joints, "--robot", ROBOT, "--skip-gaps").stdout
    assert f"robacc trace {points} --robot {ROBOT} --skip-gaps --commanded '{joints}'" in told
