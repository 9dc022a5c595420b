"""Every call gives what its command gives, takes paths, objects, arrays and data frames, and says what is wrong."""

import ast
import csv
import dataclasses
import doctest
import hashlib
import importlib
import inspect
import json
import pkgutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import results
from commands import missing, output, run
from refusals import problems_of
from sample_files import ROBOT as SAMPLE_ROBOT, ROOT, SAMPLES, saved
from schemas import closed, wrong

import robacc
import robacc.api
from robacc.api.parameters import choices_of, meanings
from robacc.cli import commands
from robacc.cli.command import declared_options
from robacc.errors import InputError, UsageError
from robacc.io.json_text import json_text

POSES, ROBOT = "sample_data/poses.csv", "sample_data/robot.yaml"
PLAN = "sample_data/iso9283/plan.csv"
MODULES = [f"robacc.api.{one.name}" for one in pkgutil.iter_modules(robacc.api.__path__)]
FRAMES = ("base_frame", "tool_frame")
COMMANDS = ["calibrate", "check", "compare", "correct", "estimate", "export", "import_", "iso9283", "plan", "predict"]


COMMANDS += ["simulate", "trace"]


@pytest.fixture(autouse=True)
def _from_the_projects_folder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(ROOT)


def sample(**changes: Any) -> robacc.Measurements:
    return dataclasses.replace(robacc.read_poses(POSES, robot=robacc.read_robot(ROBOT)), **changes)


def printed(*words: str) -> str:
    """What a command writes to standard output, as JSON."""
    return output(*words, "--format", "json")


def document_of(*words: str) -> str:
    """Return the JSON that a command writes to a file."""
    output(*words, "--document", f"{FOLDER}/document.json")
    return Path(f"{FOLDER}/document.json").read_text(encoding="utf-8")


CALLS: dict[str, tuple[Callable[[], robacc.Result], Callable[[], str]]] = {
    "estimate": (
        lambda: robacc.estimate(POSES, robot=ROBOT, align=FRAMES),
        lambda: results.text("estimate"),
    ),
    "estimate, options": (
        lambda: robacc.estimate(
            Path(POSES), robot=ROBOT, frame="base", scale="configs/grades/machining.yaml", confidence=0.9, seed=3
        ),
        lambda: printed(
            *("estimate", POSES, "--robot", ROBOT, "--frame", "base", "--confidence", "0.9", "--seed", "3"),
            *("--scale", "configs/grades/machining.yaml"),
        ),
    ),
    "predict": (
        lambda: robacc.predict("configs/robots/puma560.yaml", samples=200, allocate="C"),
        lambda: results.text("predict"),
    ),
    "iso9283_poses": (
        lambda: robacc.iso9283_poses("configs/robots/puma560.yaml", edge="250mm", cycles=3),
        lambda: printed("plan", "configs/robots/puma560.yaml", "--for", "iso9283", "--edge", "250mm", "--cycles", "3"),
    ),
    "predict, against": (
        lambda: robacc.predict(
            "configs/robots/puma560.yaml", poses=f"{FOLDER}/p.csv", against=f"{FOLDER}/p.csv", noise="0.05mm,0.01deg"
        ),
        lambda: printed(
            *("predict", "configs/robots/puma560.yaml", "--poses", f"{FOLDER}/p.csv"),
            *("--against", f"{FOLDER}/p.csv", "--noise", "0.05mm,0.01deg"),
        ),
    ),
    "calibrate": (
        lambda: robacc.calibrate(
            "sample_data/trace/poses.csv",
            robot="sample_data/trace/robot.yaml",
            fit=(*results.DECLARED.split(","), "joint_compliance[j2]", "backlash[j3]"),
            folds=2,
        ),
        lambda: results.text("calibrate"),
    ),
    "trace": (
        lambda: robacc.trace(POSES, robot=ROBOT, folds=2, progress=lambda *one: TOLD.append(one)),
        lambda: printed("trace", POSES, "--robot", ROBOT, "--folds", "2"),
    ),
    "iso9283": (
        lambda: robacc.iso9283("sample_data/iso9283/poses.csv", robot="sample_data/iso9283/robot.yaml", align=FRAMES),
        lambda: results.text("iso9283"),
    ),
    "correct": (
        lambda: robacc.correct(PLAN, model="sample_data/truth.yaml", nominal=ROBOT, most="2mm", frame="base"),
        lambda: printed(
            *("correct", PLAN, "--model", "sample_data/truth.yaml", "--nominal", ROBOT),
            *("--most", "2mm", "--frame", "base", "-o", f"{FOLDER}/corrected.csv"),
        ),
    ),
    "compare": (
        lambda: robacc.compare(f"{FOLDER}/a.json", f"{FOLDER}/b.json", by="position.p95", grade="D"),
        lambda: printed("compare", f"{FOLDER}/a.json", f"{FOLDER}/b.json", "--by", "position.p95", "--grade", "D"),
    ),
    "compare_paired": (
        lambda: robacc.compare_paired(f"{FOLDER}/p.csv", f"{FOLDER}/p.csv", nominal="configs/robots/puma560.yaml"),
        lambda: printed(
            *("compare", "--paired", f"{FOLDER}/p.csv", f"{FOLDER}/p.csv"),
            *("--nominal", "configs/robots/puma560.yaml"),
        ),
    ),
    "check": (
        lambda: robacc.check(f"{FOLDER}/a.json", f"{FOLDER}/gate.yaml"),
        lambda: run("check", f"{FOLDER}/a.json", "--gate", f"{FOLDER}/gate.yaml", "--format", "json").stdout,
    ),
    "plan": (
        lambda: robacc.plan(ROBOT, poses=12, candidates=100, min_height="100mm", noise="0.05mm"),
        lambda: printed(
            *("plan", ROBOT, "--poses", "12", "--candidates", "100", "--min-height", "100mm", "--noise", "0.05mm"),
            *("-o", f"{FOLDER}/plan.csv"),
        ),
    ),
    "export": (
        lambda: robacc.export(ROBOT, format="mdh"),
        lambda: document_of("export", ROBOT, "--format", "mdh", "-o", f"{FOLDER}/m.yaml"),
    ),
    "simulate": (
        lambda: robacc.simulate(ROBOT, poses=9, noise="0.02mm", outliers=2, temperature=(20, 25), payload=(0, 2)),
        lambda: printed(
            *("simulate", ROBOT, "--poses", "9", "--noise", "0.02mm", "--outliers", "2", "--temperature", "20:25"),
            *("--payload", "0,2", "-o", f"{FOLDER}/made.csv"),
        ),
    ),
    "history_add": (
        lambda: robacc.history_add(f"{FOLDER}/c.json", db=f"{FOLDER}/1.db", at="2026-05-31"),
        lambda: printed("history", "add", f"{FOLDER}/c.json", "--db", f"{FOLDER}/2.db", "--at", "2026-05-31"),
    ),
    "history_show": (
        lambda: robacc.history_show(db=f"{FOLDER}/arm.db"),
        lambda: printed("history", "show", "--db", f"{FOLDER}/arm.db"),
    ),
    "history_trend": (
        lambda: robacc.history_trend("position.rms", db=f"{FOLDER}/arm.db"),
        lambda: printed("history", "trend", "position.rms", "--db", f"{FOLDER}/arm.db"),
    ),
    "history_changes": (
        lambda: robacc.history_changes(db=f"{FOLDER}/arm.db"),
        lambda: printed("history", "changes", "--db", f"{FOLDER}/arm.db"),
    ),
    "health": (
        lambda: robacc.health(POSES, robot=f"{FOLDER}/model.yaml", db=f"{FOLDER}/arm.db"),
        lambda: printed("health", POSES, "--robot", f"{FOLDER}/model.yaml", "--db", f"{FOLDER}/arm.db"),
    ),
    "fleet": (
        lambda: robacc.fleet(f"{FOLDER}/c.json", f"{FOLDER}/d.json"),
        lambda: printed("fleet", f"{FOLDER}/c.json", f"{FOLDER}/d.json"),
    ),
}
"""A call and the command that does the same."""
TOLD: list[tuple[str, int, int]] = []
"""How far the trace was."""
FOLDER = ""
"""Of the files that some of them read; set before they run."""


@pytest.fixture(scope="module", autouse=True)
def _files(tmp_path_factory: pytest.TempPathFactory) -> None:
    global FOLDER
    folder = tmp_path_factory.mktemp("api")
    FOLDER = str(folder)
    made = robacc.simulate(ROOT / "configs/robots/puma560.yaml", poses=8, noise="0.05mm", noise_orientation="0.01deg")
    made.write(folder / "p.csv")
    robacc.estimate(ROOT / POSES, robot=ROOT / ROBOT).save(folder / "a.json")
    robacc.estimate(ROOT / POSES, robot=ROOT / ROBOT, align="base_frame").save(folder / "b.json")
    (folder / "gate.yaml").write_text(results.GATE, encoding="utf-8")
    poses = robacc.read_poses(ROOT / POSES, robot=robacc.read_robot(ROOT / ROBOT))
    for name, rows in (("c", slice(0, 60)), ("d", slice(0, 40))):
        fitted = robacc.calibrate(poses.subset(rows), robot=ROOT / ROBOT, folds=2)
        fitted.save(folder / f"{name}.json")
        fitted.write_model(folder / "model.yaml")
    for month, name in enumerate("abcd", 1):
        robacc.history_add(folder / f"{name}.json", db=folder / "arm.db", at=f"2026-{month:02d}-01")


@pytest.mark.parametrize("what", CALLS)
def test_call_gives_what_the_command_gives_byte_for_byte(what: str) -> None:
    call, command = CALLS[what]
    found, text = call(), command()
    assert isinstance(found, robacc.Result)
    document = json.loads(text)
    assert (found.to_json(), list(found.document())) == (text, list(document))
    name = document["schema"].removeprefix("robacc.").partition("/")[0]
    assert wrong(name, document, closed) == [], "a value or a key that the schema does not describe"
    assert isinstance(found.warnings, tuple)
    assert repr(found) == f"<robacc.{type(found).__name__} of {', '.join(file.name for file in found.made.inputs)}>"
    if what == "trace":
        # Every round of the search is step 0 of one: how many there will be is unknown.
        assert {(done, of) for _, done, of in TOLD} == {(0, 1)}


def test_every_call_is_held_against_its_command() -> None:
    functions = {name for name in robacc.__all__ if name.islower() and not name.startswith(("_", "read_", "write_"))}
    assert {what.split(",")[0] for what in CALLS} == functions - {"schema", "import_"}


def test_gate_stands_in_the_document_as_the_command_has_it(tmp_path: Path) -> None:
    gate = f"{FOLDER}/gate.yaml"
    found = robacc.estimate(POSES, robot=ROBOT, align=FRAMES)
    text = run("estimate", *results.CALLS["estimate"], "--gate", gate, "--format", "json").stdout
    assert found.to_json(gate=gate) == text
    found.save(tmp_path / "r.json", gate=gate)
    assert (tmp_path / "r.json").read_text(encoding="utf-8") == text
    checked = robacc.check(found, gate)
    assert (checked.outcome, checked.exit_status) == ("inconclusive", 5)
    assert json.loads(checked.to_json())["gate"] == json.loads(text)["gate"]


def test_files_that_commands_write_beside_the_result(tmp_path: Path) -> None:
    output("estimate", POSES, "--robot", ROBOT, "--per-pose", tmp_path / "e.csv")
    assert robacc.estimate(POSES, robot=ROBOT).per_pose_csv() == (tmp_path / "e.csv").read_text(encoding="utf-8")
    puma = "configs/robots/puma560.yaml"
    output("predict", puma, "--samples", 4, "--per-pose", tmp_path / "p.csv")
    assert robacc.predict(puma, samples=4).per_pose_csv() == (tmp_path / "p.csv").read_text(encoding="utf-8")
    assert robacc.simulate(puma, poses=4, outliers=1).csv() == output("simulate", puma, "--poses", 4, "--outliers", 1)


@pytest.mark.parametrize("name", COMMANDS)
def test_the_options_of_a_command_are_the_parameters_of_its_call(name: str) -> None:
    call = inspect.unwrap(getattr(robacc, name))
    options = declared_options(getattr(commands, name))
    for key, parameter in inspect.signature(call).parameters.items():
        # The declaration is read from the source, without the names that the call's module imports.
        kind, meaning = meanings(call)[key]
        if key == "progress":
            assert key not in options
        elif options[key].owner == "call":
            assert options[key][1:3] == (meaning, parameter.default)
            assert choices_of(options[key].kind) == choices_of(kind)


def test_help_explains_every_parameter_with_its_type() -> None:
    for name in [*COMMANDS, "compare_paired", "read_poses"]:
        call = getattr(robacc, name)
        for key, parameter in inspect.signature(call).parameters.items():
            assert f"        {key}: " in call.__doc__
            assert "Help(" not in str(parameter.annotation)


def test_what_was_read_before_is_as_good_as_its_path(tmp_path: Path) -> None:
    robot = robacc.read_robot(ROBOT)
    by_path = robacc.estimate(POSES, robot=ROBOT, align=FRAMES).document()
    by_object = robacc.estimate(robacc.read_poses(POSES, robot=robot), robot=robot, align="base_frame, tool_frame")
    np.testing.assert_array_equal(
        robacc.read_poses(POSES, robot=ROBOT).q, robacc.read_poses(POSES, robot=robot).q, strict=True
    )
    document = by_object.document()
    assert document["inputs"][0] == by_path["inputs"][0]
    robacc.write_robot(tmp_path / "same.yaml", robot)
    sha256 = hashlib.sha256((tmp_path / "same.yaml").read_bytes()).hexdigest()
    assert document["inputs"][1] == {"name": "sample arm", "sha256": sha256, "kind": "robot"}
    for one in (document, by_path):
        del one["inputs"]
    assert json_text(document) == json_text(by_path)


def test_arrays_are_estimated_and_recorded(tmp_path: Path) -> None:
    wanted = np.random.default_rng(0).uniform(size=(3, 30))
    error = np.random.default_rng(1).normal(scale=1e-4, size=(3, 30))
    found = robacc.estimate(robacc.Measurements(position=wanted + error, commanded_position=wanted))
    assert found.position.rms == pytest.approx(np.sqrt(np.mean(np.sum(error**2, axis=0))), rel=1e-9)
    (record,) = found.made.inputs
    robacc.write_poses(tmp_path / "made.csv", found.data)
    assert record.sha256 == hashlib.sha256((tmp_path / "made.csv").read_bytes()).hexdigest()
    assert robacc.estimate(tmp_path / "made.csv").position.rms == found.position.rms
    lists = robacc.Measurements(position=wanted.tolist(), commanded_position=wanted.tolist(), pose=range(30))  # type: ignore[arg-type]
    assert robacc.estimate(lists).position.max == 0.0


def test_joint_variables_alone_are_enough_to_predict() -> None:
    q = np.random.default_rng(0).uniform(-1, 1, size=(6, 5))
    arm = "configs/robots/puma560.yaml"
    found = robacc.predict(arm, poses=q)
    q[0, 0] += 0.0  # still the caller's own to change
    same = robacc.predict(arm, poses=robacc.Measurements(position=np.zeros((3, 5)), q=q))
    assert found.to_json() == same.to_json()


def test_fit_of_poses_that_were_read_says_which_file_they_are_of() -> None:
    robot = robacc.read_robot(ROBOT)
    found = robacc.calibrate(robacc.read_poses(POSES, robot=robot), robot=robot, folds=2)
    assert (found.made.options["poses"], found.made.options["robot"]) == (POSES, None)
    assert found.model_yaml().startswith(f"# written by robacc {robacc.__version__} calibrate from poses.csv\n")
    arrays = sample(source=None, sha256=None, rows=None)
    made = robacc.calibrate(arrays, robot=robot, folds=2)
    assert made.made.options["poses"] is None
    assert "calibrate from arrays\n" in made.model_yaml()


def test_a_written_robot_has_its_effects_in_its_own_units(tmp_path: Path) -> None:
    entry = "\neffects:\n  - {effect: backlash, joints: [j2], values: {j2: 0.01}}\n"
    robot = robacc.read_robot(saved(tmp_path / "arm.yaml", (ROOT / ROBOT).read_text(encoding="utf-8") + entry))
    robacc.write_robot(tmp_path / "si.yaml", robot)
    again = robacc.read_robot(tmp_path / "si.yaml")
    assert (again.effects[0]["values"]["j2"], again.joints) == (0.01 * np.deg2rad(1), robot.joints)


def test_results_are_compared_and_checked_without_files() -> None:
    plain = robacc.estimate(POSES, robot=ROBOT)
    aligned = robacc.estimate(POSES, robot=ROBOT, align="base_frame")
    found = robacc.compare(plain, f"{FOLDER}/b.json", robacc.read_result(f"{FOLDER}/a.json"), aligned)
    assert [one.name for one in found.results] == ["estimate", "b", "a", "estimate (2)"]
    assert found.made.inputs[0].sha256 == robacc.read_result(f"{FOLDER}/a.json").sha256
    same = next(row["values"] for row in found.statistics if row["key"] == "position.rms")
    assert [value["value"] for value in same[:2]] == [value["value"] for value in same[2:]]


FLAT = np.zeros((3, 4))

WRONG_ARRAYS = {
    "position: expected an array of shape (3, 4), found (4, 3); components come first and poses last, so give "
    "position.T": {"position": np.zeros((4, 3))},
    "q: expected an array of shape (6, 4), found (4, 6); components come first and poses last, so give q.T": {
        "q": np.zeros((4, 6))
    },
    "rotation: expected an array of shape (3, 3, 4), found (4, 3, 3); components come first and poses last, so give "
    "numpy.moveaxis(rotation, 0, -1)": {"rotation": np.zeros((4, 3, 3))},
    "position: found positions up to 1000, which cannot be m; give metres": {
        "position": np.array([[0, 500, 900, 1000.0], [0, 10, 20, 30], [0, 0, 0, 0]])
    },
    "q: found joint angles up to 90, which cannot be rad; give radians: numpy.radians(q)": {"q": np.full((6, 4), 90.0)},
    "sigma_position: found a typical uncertainty of 0.2 m, which no instrument has": {"sigma_position": FLAT + 0.2},
    "q: expected an array of shape (6, 4), found (5, 4)": {"q": np.zeros((5, 4))},
    "time: expected an array of shape (4), found (3,)": {"time": np.zeros(3)},
    "pose: expected an array of shape (4), found (2,)": {"pose": ["a", "b"]},
    "position: pose 2 has a value that is not finite": {"position": np.where(np.arange(4) == 1, np.nan, FLAT)},
    "position: expected numbers, found <U1": {"position": np.full((3, 4), "x")},
    "rotation: pose 1 is not a rotation matrix": {"rotation": np.ones((3, 3, 4))},
    "commanded_rotation: pose 3 is not a rotation matrix": {
        "commanded_rotation": np.eye(3)[..., None] * np.array([1, 1, -1, 1])
    },
    "sigma_position: expected standard deviations above 0": {"sigma_position": FLAT},
}


@pytest.mark.parametrize("message", WRONG_ARRAYS)
def test_wrong_arrays_are_bad_input(message: str) -> None:
    columns = {"position": FLAT, "q": np.zeros((6, 4))} | WRONG_ARRAYS[message]
    assert message in problems_of(robacc.estimate, robacc.Measurements(**columns), robot=ROBOT)


WRONG_CALLS: dict[str, Callable[[], object]] = {
    "`frame`: expected one of 'tool', 'base', None, found 'world'": lambda: robacc.estimate(
        POSES,
        robot=ROBOT,
        frame="world",  # type: ignore[arg-type]
    ),
    "`seed`: expected a number of at least 0, found -1": lambda: robacc.estimate(POSES, robot=ROBOT, seed=-1),
    "`folds`: expected a number between 2 and 50, found 1": lambda: robacc.calibrate(
        POSES, robot=ROBOT, fit="base_frame", folds=1
    ),
    "`fit` names no effect": lambda: robacc.calibrate(POSES, robot=ROBOT, fit=()),
    "`base_link` and `tip_link` apply when a URDF is read; this robot has been read already": lambda: robacc.estimate(
        POSES, robot=robacc.read_robot(ROBOT), tip_link="flange"
    ),
    "`base_link` and `tip_link` choose a chain of a URDF, so they need `robot`": lambda: robacc.estimate(
        POSES, base_link="base"
    ),
    "`ordered` applies when a file is read; use read_poses(path, ordered=True)": lambda: robacc.trace(
        sample(), robot=ROBOT, ordered=True
    ),
    "the poses has no joint columns q1 … q6, which a fit needs": lambda: robacc.trace(
        robacc.Measurements(position=FLAT), robot=ROBOT
    ),
    "`noise`: expected a length and perhaps an angle": lambda: robacc.predict(
        ROBOT, against=POSES, noise="1mm,1deg,1deg"
    ),
    "`noise`: expected a size that is not negative, found -0.1": lambda: robacc.simulate(ROBOT, poses=3, noise=-0.1),
    "`noise`: expected a number with a unit (m, mm, um), found nan": lambda: robacc.simulate(
        ROBOT, poses=3, noise=float("nan")
    ),
    "`poses`: expected a number between 1 and 1e+06, found 0": lambda: robacc.simulate(ROBOT, poses=0),
    "`payload`: expected masses of at least 0 kg, found -1": lambda: robacc.simulate(ROBOT, poses=3, payload=(1, -1)),
    "`temperature`: expected finite numbers": lambda: robacc.simulate(ROBOT, poses=3, temperature=float("inf")),
    "`time_step`: expected a number of at least 0, found -2": lambda: robacc.simulate(ROBOT, poses=3, time_step=-2),
    "standard input can be read only once, but - is given more than once": lambda: robacc.iso9283("-", "-"),
    "standard input can be read only once: give - to `poses` or to `against`": lambda: robacc.predict(
        ROBOT, poses="-", against="-"
    ),
    "standard input can be read only once": lambda: robacc.compare("-", "-"),
    "no schema 'estimat'; choose one of calibrate, check": lambda: robacc.schema("estimat"),
}


@pytest.mark.parametrize("message", WRONG_CALLS)
def test_wrong_calls_are_usage_errors(message: str) -> None:
    with pytest.raises(robacc.UsageError) as caught:
        WRONG_CALLS[message]()
    assert message in str(caught.value)


def test_errors_have_one_root_and_every_problem() -> None:
    assert issubclass(robacc.InputError, robacc.RobaccError)
    assert issubclass(robacc.UsageError, robacc.RobaccError)
    data = robacc.Measurements(position=FLAT, q=np.zeros((5, 4)), sigma_position=FLAT, time=np.full(4, np.inf))
    with pytest.raises(robacc.InputError) as caught:
        robacc.estimate(data, robot=ROBOT)
    assert [type(one) for one in caught.value.problems] == [robacc.Problem] * 3


def test_import_is_cheap_and_names_load_when_used() -> None:
    code = (
        "import sys, robacc; print([m for m in ('numpy', 'scipy', 'yaml', 'typer', 'json') if m in sys.modules]);"
        "print(robacc.estimate.__module__, 'numpy' in sys.modules, 'yourdfpy' in sys.modules, 'typer' in sys.modules)"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.split("\n")[:2] == ["[]", "robacc.api.accuracy True False False"]


def test_every_name_is_there_and_seen_by_type_checkers() -> None:
    tree = ast.parse(Path(robacc.__file__).read_text(encoding="utf-8"))
    seen = {
        alias.asname: f"{node.module}".removeprefix("robacc.")
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and str(node.module).startswith("robacc.")
        for alias in node.names
        if alias.name == alias.asname
    }
    assert (seen.pop("__version__"), seen) == ("version", robacc._HOMES)
    assert set(robacc.__all__) <= set(dir(robacc))
    for name in robacc.__all__:
        assert getattr(robacc, name).__doc__ if name != "__version__" else robacc.__version__
        if name.islower() and not name.startswith(("_", "write_", "read_r")):
            assert ">>> " in (inspect.getdoc(getattr(robacc, name)) or ""), name
    with pytest.raises(AttributeError, match=r"module 'robacc' has no attribute 'estimte'"):
        _ = robacc.estimte


@pytest.mark.parametrize("module", ["robacc", *MODULES])
def test_examples_of_docstrings_run(module: str) -> None:
    assert doctest.testmod(importlib.import_module(module)).failed == 0


SCRIPT = """\
import numpy as np
import robacc

robot: robacc.Robot = robacc.read_robot("robot.yaml")
data = robacc.read_poses("poses.csv", robot=robot)
found = robacc.estimate(data, robot=robot, align=("base_frame",), frame="tool")
rms: float = found.position.rms
grade: str = found.grade.grade
worst: tuple[int, ...] = tuple(pose.line for pose in found.worst_position)
fitted = robacc.calibrate("poses.csv", robot="robot.yaml", fit="base_frame")
fitted.write_model("better.yaml")
closed = robacc.trace("poses.csv", robot=fitted.robot, declared=["base_frame"])
named: list[str] = [one.effect for one in closed.findings]
predicted = robacc.predict(robot, poses=np.zeros((6, 3)), noise=None)
criteria = robacc.iso9283("a.csv", "b.csv", rated_load=10.0)
both = robacc.compare(found, closed, "stored.json", by="position.p95")
status: int = robacc.check(both, "gate.yaml").exit_status
made: robacc.Measurements = robacc.simulate(robot, poses=10, noise="0.02mm").data
try:
    text: str = predicted.to_json()
except robacc.InputError as error:
    problems: tuple[robacc.Problem, ...] = error.problems
results: list[robacc.Result] = [found, fitted, closed, predicted, criteria, both]
"""


@pytest.mark.slow
def test_a_typed_script_passes_mypy_and_a_wrong_one_does_not(tmp_path: Path) -> None:
    (tmp_path / "script.py").write_text(SCRIPT, encoding="utf-8")
    wrong = 'import robacc\nrobacc.estimte("p.csv")\nrobacc.estimate("p.csv", frame="world")\n'
    wrong += "x: str = robacc.compare().statistics\n"
    (tmp_path / "wrong.py").write_text(wrong, encoding="utf-8")
    checked = ["-m", "mypy", "--strict", "--config-file", "pyproject.toml", str(tmp_path / "script.py")]
    done = subprocess.run(
        [sys.executable, *checked, str(tmp_path / "wrong.py")], capture_output=True, text=True, check=False
    )
    assert "script.py" not in done.stdout
    assert done.stdout.endswith("Found 3 errors in 1 file (checked 2 source files)\n")
    lines = [line.split("wrong.py:")[1].split(":")[0] for line in done.stdout.splitlines() if "wrong.py:" in line]
    assert lines == ["2", "3", "4"]


def test_without_poses_there_is_nothing_to_do(tmp_path: Path) -> None:
    path = saved(tmp_path / "header.csv", "q1,q2,q3,q4,q5,q6,x,y,z\n")
    for call in (
        lambda: robacc.estimate(path, robot=ROBOT),
        lambda: robacc.estimate(path, robot=ROBOT, align="base_frame"),
        lambda: robacc.calibrate(path, robot=ROBOT, fit="base_frame"),
        lambda: robacc.simulate(ROBOT, at=path),
    ):
        assert problems_of(call) == [f"{path}: there are no poses; one row is needed at least below the header"]


def test_a_compliance_without_equilibrium_is_bad_input() -> None:
    soft = {"effect": "joint_compliance", "joints": ["j2"], "values": {"j2": 1.0}}
    robot = dataclasses.replace(robacc.read_robot("sample_data/trace/robot.yaml"), effects=(soft,))
    with pytest.raises(
        robacc.InputError, match="a compliance is too large for the arm's weight; check the unit"
    ) as caught:
        robacc.simulate(robot, poses=3)
    assert caught.value.exit_status == 3


# Data frames in place of pose files: pandas, Polars, Arrow, and mappings of arrays.
def columns() -> dict[str, list[Any]]:
    with (SAMPLES / "poses.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    texts = ("pose", "cycle", "target", "visit")
    return {name: [row[name] if name in texts else float(row[name]) for row in rows] for name in rows[0]}


class StreamOnly:
    """Table that speaks Arrow's stream interface only, as a database's relation does."""

    def __init__(self, table: Any) -> None:
        self._table = pytest.importorskip("pyarrow").table(table)

    def __arrow_c_stream__(self, schema: Any = None) -> Any:
        return self._table.__arrow_c_stream__(schema)


def as_mapping(table: dict[str, list[Any]]) -> Any:
    return {name: np.array(values) for name, values in table.items()}


TABLES = {
    "mapping": as_mapping,
    "arrow": lambda table: pytest.importorskip("pyarrow").table(table),
    "pandas": lambda table: pytest.importorskip("pandas").DataFrame(table),
    "polars": lambda table: pytest.importorskip("polars").DataFrame(table),
    "stream": StreamOnly,
}


@pytest.mark.parametrize("kind", TABLES)
def test_a_frame_gives_the_figures_of_its_file(kind: str) -> None:
    results = (
        robacc.estimate(source, robot=SAMPLE_ROBOT) for source in (SAMPLES / "poses.csv", TABLES[kind](columns()))
    )
    from_file, from_frame = (json.loads(result.to_json()) for result in results)
    record = from_frame["inputs"][0]
    assert (record["name"], len(record["sha256"])) == ("DataFrame", 64)
    for key in ("position", "orientation", "grade", "noise"):
        assert from_frame[key] == from_file[key]


def test_names_of_exports_are_read_in_frames_too() -> None:
    table = columns()
    frame = {f"J{i} [deg]": np.degrees(table[f"q{i}"]) for i in range(1, 7)}
    frame |= {f"{axis.upper()} [mm]": 1e3 * np.array(table[axis]) for axis in "xyz"}
    frame["Timestamp"] = np.datetime64("2026-11-22T10:00:00") + np.arange(len(table["x"])) * np.timedelta64(60, "s")
    data = robacc.read_poses(frame, robot=robacc.read_robot(SAMPLE_ROBOT))
    expected = robacc.read_poses(SAMPLES / "poses.csv", robot=robacc.read_robot(SAMPLE_ROBOT))
    np.testing.assert_allclose(data.q, expected.q, atol=1e-14)
    assert data.time[:2].tolist() == [36000.0, 36060.0]


def test_statements_apply_to_frames() -> None:
    table = columns()
    frame = {f"J{i}": np.degrees(table[f"q{i}"]) for i in range(1, 7)} | {axis: table[axis] for axis in "xyz"}
    with pytest.raises(InputError, match="state no unit"):
        robacc.read_poses(frame | {f"J{i}": table[f"q{i}"] for i in range(1, 7)})
    with_units = robacc.PoseFile(frame, units="m,deg")
    assert robacc.estimate(with_units, robot=SAMPLE_ROBOT).document()["inputs"][0]["reading"] == {"units": "m,deg"}


@pytest.mark.parametrize("missing", [None, float("nan"), "---"])
def test_gaps_of_frames_have_a_row_and_a_column(missing: object) -> None:
    table = columns()
    table["y"][3] = missing
    frame = {name: np.array(values, dtype=object if name == "y" else None) for name, values in table.items()}
    with pytest.raises(InputError, match="row 4, y: the value is missing"):
        robacc.read_poses(frame)
    data = robacc.read_poses(frame, skip_gaps=True)
    assert data.n == len(table["y"]) - 1
    assert any("1 row incomplete or not measured, left out (row 4)" in text for text in data.warnings)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"x": np.zeros((60, 2))}, r"x: expected one value per row, found an array of shape \(60, 2\)"),
        ({"x": np.zeros(7)}, "the columns have 7 to 60 rows"),
        ({"x": np.array(["1,5"] * 60)}, "x: the column holds <U3, expected numbers"),
        ({"x": np.array(["1,5"] * 60, dtype=object)}, "row 1, x: found '1,5', expected a number"),
        ({5: np.zeros(60)}, "expected a text as the name of each column, found 5"),
    ],
)
def test_frames_that_are_refused(change: dict[Any, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        robacc.read_poses({**as_mapping(columns()), **change})


def test_the_named_index_of_pandas_is_a_column() -> None:
    pandas = pytest.importorskip("pandas")
    table = columns()
    table["pose"] = [f"P{i}" for i in range(len(table["x"]))]
    data = robacc.read_poses(pandas.DataFrame(table).set_index("pose"))
    assert data.pose[:2].tolist() == ["P0", "P1"]


@pytest.mark.parametrize("poses", [[{"x": 1.0}], np.zeros((3, 4)), 5, None])
def test_what_is_no_table_is_a_wrong_argument(poses: Any) -> None:
    with pytest.raises(UsageError, match="expected a path, a data frame or Measurements as poses, found"):
        robacc.estimate(poses, robot=SAMPLE_ROBOT)


# Results in a notebook: headline, arrays, table, chart and report of the same figures.
@pytest.fixture(scope="module")
def result() -> robacc.Estimate:
    return robacc.estimate(SAMPLES / "poses.csv", robot=SAMPLES / "robot.yaml", align="base_frame,tool_frame")


def test_the_headline_has_the_figures_and_escapes_names(result: robacc.Estimate) -> None:
    text = result._repr_html_()
    assert missing(text, f"{result.position.rms * 1e3:.3f} mm", "grade D") == []
    assert text.count("<table>") == text.count("</table>") == 1


def test_the_text_of_a_result_is_the_first_screen_of_the_command(result: robacc.Estimate) -> None:
    command = ("estimate", SAMPLES / "poses.csv", "--robot", SAMPLES / "robot.yaml")
    screen = run(*command, "--align", "base_frame,tool_frame").stdout
    assert str(result).splitlines()[2:] == screen.replace(f"{SAMPLES}/", "").splitlines()[2:]
    assert str(result).splitlines()[1] == "poses.csv against the model robot.yaml"
    stepped = robacc.estimate(SAMPLES / "poses.csv", robot=SAMPLES / "robot.yaml", align="none", frame="base")
    assert str(dataclasses.replace(stepped, warnings=("a doubt",))).endswith("\nwarning: a doubt")


def test_the_text_of_poses_has_ten_lines_at_most() -> None:
    lines = str(robacc.read_poses(SAMPLES / "poses.csv", robot=SAMPLES / "robot.yaml")).splitlines()
    assert lines[0].endswith("poses.csv, in m and rad")
    assert lines[1].startswith("position           -0.66…0.82, ")
    assert lines[-1] == "pose               60 different"
    full = robacc.simulate(SAMPLES / "robot.yaml", poses=9, seed=1, temperature=(20, 25), payload=(0, 2)).data
    assert len(str(full).splitlines()) <= 10
    assert str(robacc.Measurements(np.zeros((3, 0)))) == "0 measured poses of arrays, in m and rad"


def test_arrays_are_those_of_the_document(result: robacc.Estimate) -> None:
    columns = result.to_numpy()
    assert {array.shape for array in columns.values()} == {(60,)}
    errors = np.stack([columns[f"error_{axis}_m"] for axis in "xyz"])
    np.testing.assert_allclose(errors, result.errors.position, atol=1e-11)
    assert np.sqrt(np.mean(columns["error_m"] ** 2)) == pytest.approx(result.position.rms, rel=1e-9)
    np.testing.assert_allclose(columns["turn_rad"], np.linalg.norm(result.errors.rotation, axis=0), atol=1e-11)
    assert robacc.compare(result, result).to_numpy() == {}


def test_a_data_frame_has_a_row_for_each_pose(result: robacc.Estimate) -> None:
    pandas = pytest.importorskip("pandas")
    frame = result.to_pandas()
    assert isinstance(frame, pandas.DataFrame)
    assert frame.shape == (60, len(result.to_numpy()))


def test_chart_and_report_of_a_result(result: robacc.Estimate, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    assert result.plot().axes
    path = tmp_path / "chart.svg"
    result.plot("time", path=path)
    assert path.read_text(encoding="utf-8").startswith("<?xml")
    with pytest.raises(robacc.UsageError, match="has no chart 'nothing'; it has distribution"):
        result.plot("nothing")
    page = tmp_path / "page.html"
    result.report(page, identity={"serial_number": "12345 <b>", "customer": "Example"})
    text = page.read_text(encoding="utf-8")
    assert "12345 &lt;b&gt;" in text
    assert text.index("Customer") < text.index("Serial number")
    with pytest.raises(robacc.UsageError, match="unknown key 'serial'"):
        result.report(page, identity={"serial": "1"})


@pytest.mark.parametrize("error", [np.linalg.LinAlgError("singular"), FloatingPointError("divide")])
def test_a_fit_that_no_arm_solves_is_one_message(error: Exception, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of 12 poses with a wrist that stands still, a tool without its base went metres away."""

    def unsolvable(*_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr("robacc.api.fitting.fit_effects", unsolvable)
    with pytest.raises(InputError, match="no arm like the robot explains what was measured"):
        robacc.calibrate(SAMPLES / "poses.csv", robot=SAMPLE_ROBOT, fit="tool_frame")
