"""`robacc calibrate` and `trace` from files to tables, JSON and models; first screens; files of targets."""

import dataclasses
import hashlib
import json
import math
import re
import shutil
from functools import cache
from pathlib import Path
from typing import Any

import commands
import numpy as np
import pytest
from arms import arm
from commands import document, in_order, missing, one_line, output, refused, run
from sample_files import SAMPLES, TRACED_ROBOT, TRUTH, agreed, saved

import robacc
from robacc import Measurements, read_robot
from robacc.effects.specification import parse_requests
from robacc.modelling.model import predict
from robacc.poses.csv_file import read_poses
from robacc.robots.yaml_robot import robot_to_yaml
from robacc.simulation.simulate import Plan, simulate
from robacc.tracing.calibrating import calibrate

# `robacc calibrate` from files to its table, its JSON and the model it writes; calibration as a library.

GEOMETRY = "base_frame,tool_frame,joint_offset,link_geometry"

NOISE = 2e-5

TRUE = (
    {"effect": "joint_offset", "joints": ["j2", "j3"], "values": {"j2": 1e-3, "j3": -5e-4}},
    {"effect": "link_geometry", "joints": ["j2"], "values": {"j2.a": 4e-4, "j2.alpha": 3e-4}},
    {"effect": "gear_ratio", "joints": ["j2"], "values": {"j2": 5e-4}},
)


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """``arm.yaml`` with tolerances, ``poses.csv`` and ``apart.csv`` of one that is wrong, full poses."""
    folder = tmp_path_factory.mktemp("calibrate")
    robot = arm("puma560").robot
    tolerance = {"theta": 1e-6, "d": 1e-3, "a": 1e-3, "alpha": 1e-3}
    joints = tuple(dataclasses.replace(joint, tolerance=tolerance) for joint in robot.joints)
    plain = tuple(dataclasses.replace(joint, tolerance={}) for joint in robot.joints)
    for name, changes in (
        ("arm", {"joints": joints}),
        ("bare", {"joints": plain}),
        ("true", {"effects": TRUE, "effect_units": (1.0, 1.0)}),
    ):
        (folder / f"{name}.yaml").write_text(robot_to_yaml(dataclasses.replace(robot, **changes)), encoding="utf-8")
    for name, seed in (("poses", "1"), ("apart", "2")):
        noise = ["--noise", "0.02mm", "--noise-orientation", "0.02mrad"]
        arguments = ["--poses", "50", "--seed", seed, *noise, "-o", str(folder / f"{name}.csv")]
        output("simulate", folder / "true.yaml", *arguments)
    return folder


def calibrate_command(files: Path, fit: str, *more: str) -> tuple[str, ...]:
    return ("calibrate", str(files / "poses.csv"), "--robot", str(files / "arm.yaml"), "--fit", fit, *more)


@cache
def calibrated(files: Path, fit: str, *more: str) -> dict[str, Any]:
    return commands.document(*calibrate_command(files, fit, *more))


def values(found: dict[str, Any]) -> dict[str, dict[str, Any]]:
    return {one["name"]: one for one in found["parameters"]}


def test_coefficients_that_the_poses_do_not_show_have_their_reason(files: Path) -> None:
    found = calibrated(files, GEOMETRY)
    assert (found["schema"], found["n_poses"]) == ("robacc.calibrate/2", 50)
    for name, one in values(found).items():
        assert (one["std"] is None) == ("why" in one), name
    assert "joint_offset.j1 is not distinguishable from base_frame.yaw" in values(found)["joint_offset.j1"]["why"]
    identifiability = found["identifiability"]
    # The axes of joints 2 and 3 are parallel: their rotation about y is idle.
    assert (identifiability["n_identifiable"], identifiability["condition_number"] > 1) == (4 * 6 + 6 - 1, True)
    dropped = {one["name"] for one in identifiability["not_identifiable"]}
    assert dropped == {name for name, one in values(found).items() if one["std"] is None}


def test_the_written_model_reproduces_the_prediction(files: Path, tmp_path: Path) -> None:
    model = tmp_path / "model.yaml"
    fitted = calibrated(files, f"{GEOMETRY},gear_ratio[j2]", "--write-model", str(model))["after"]["fitted"]
    data = read_poses(str(files / "poses.csv"))
    residual = np.linalg.norm(data.position - predict(read_robot(model), data).translation, axis=0)
    assert fitted["position"]["rms_m"] == pytest.approx(np.sqrt(np.mean(residual**2)), rel=0, abs=1e-12)
    fresh = commands.document("estimate", files / "apart.csv", "--robot", model)
    assert fresh["position"]["rms_m"] < 1.6 * np.sqrt(3) * NOISE
    # Near nominal: no length of a kilometre that another takes back.
    for before, after in zip(read_robot(files / "arm.yaml").joints, read_robot(model).joints, strict=True):
        for label, value in after.parameters.items():
            assert abs(value - before.parameters.get(label, 0.0)) < 0.01


@pytest.mark.slow
def test_tolerances_as_priors(files: Path) -> None:
    free = calibrated(files, "joint_offset,link_geometry")
    held = calibrated(files, "joint_offset,link_geometry", "--prior")
    # The file is sure of its zeros to a microradian: they stay there, though a milliradian off.
    assert abs(values(free)["joint_offset.j2"]["value"]) > 5e-4
    assert abs(values(held)["joint_offset.j2"]["value"]) < 2e-5
    assert values(held)["joint_offset.j2"]["std"] <= 1.01e-6
    bare = ("calibrate", files / "poses.csv", "--robot", files / "bare.yaml", "--fit", GEOMETRY, "--prior")
    assert "has none on any joint" in refused(*bare)


def test_outliers_are_named_by_their_line(files: Path, tmp_path: Path) -> None:
    lines = (files / "poses.csv").read_text(encoding="utf-8").splitlines()
    header = next(i for i, line in enumerate(lines) if not line.startswith("#"))
    x, row = lines[header].split(",").index("x"), lines[header + 7].split(",")
    row[x] = str(float(row[x]) + 0.02)
    lines[header + 7] = ",".join(row)
    poses = saved(tmp_path / "poses.csv", "\n".join(lines) + "\n")
    how = ("--fit", GEOMETRY, "--folds", "2", "--format", "json")
    arguments = ("calibrate", poses, "--robot", files / "arm.yaml", *how)
    done, every = run(*arguments), json.loads(output(*arguments, "--all-rows"))
    assert [one["line"] for one in json.loads(done.stdout)["outliers"]] == [header + 8]
    assert f"outliers left out of the fit: 1 row, on line {header + 8}" in done.stderr
    assert every["outliers"] == []
    assert every["after"]["fitted"]["position"]["max_m"] > 5e-3


def test_the_table(files: Path) -> None:
    table = output(*calibrate_command(files, GEOMETRY, "--folds", "2", "--full"))
    parts = ("Calibration from 50 measured poses", "Before and after", "nominal, base and tool registered", "baseline")
    assert in_order(table, (*parts, "calibrated"))
    # Without sigma columns the residual gives the row weights, so that chi-square tests nothing.
    told = ("Coefficients", "standard error", "joint_offset.j2", "condition number", "chi-square")
    assert missing(table, *told) == ["chi-square"]
    told = (
        "mm along each axis (standard deviation), estimated",
        "not distinguishable from fitted coefficients on these poses: joint_offset",
        "1 of 8 lengths differs from nominal: link_geometry.j2.a; the others are shrunk to nominal",
        "standard errors come from the poses alone, without the prior; --no-shrink fits without it",
    )
    assert missing(one_line(table), *told) == []
    assert "shrunk to nominal" not in output(
        *calibrate_command(files, GEOMETRY, "--folds", "2", "--no-shrink", "--full")
    )


def test_without_frames_the_error_before_is_not_registered_either(files: Path) -> None:
    found = calibrated(files, "joint_offset", "--folds", "2")
    before = found["nominal_unregistered"]["held_out"]["position"]["rms_m"]
    assert f"\n{1e3 * before:.3g}" in output(*calibrate_command(files, "joint_offset", "--folds", "2"))
    assert all(cause["share"] <= (cause["error_without_m"] / before) ** 2 * 1.1 for cause in found["causes"])


def test_too_few_poses_are_status_3(files: Path, tmp_path: Path) -> None:
    lines = (files / "poses.csv").read_text(encoding="utf-8").splitlines()
    few = saved(tmp_path / "few.csv", "\n".join(lines[:5]) + "\n")
    told = refused("calibrate", few, "--robot", files / "arm.yaml", "--fit", GEOMETRY, status=3)
    assert missing(told, "too few for", "measure more poses or fit fewer effects") == []


def few_poses(n: int) -> Measurements:
    robot = arm("puma560").robot
    return simulate(
        dataclasses.replace(robot, effects=TRUE), Plan(n, seed=3, noise_position=NOISE, orientation=False)
    ).data


def test_warnings_of_poses_too_few() -> None:
    robot, geometry = arm("puma560").robot, parse_requests(GEOMETRY)
    found, drawn = (calibrate(robot, few_poses(14), geometry, shrink=shrink) for shrink in (False, True))
    told = (
        "more measured values than fitted coefficients: measure more poses",
        "error on held-out poses is much larger than on calibration poses: fit fewer effects or measure more poses",
    )
    assert missing("\n".join(found.warnings), *told) == []
    assert told[0] in "\n".join(drawn.warnings)
    shares = [share for _, share in found.leverage]
    assert shares[0] == max(shares)
    assert all(0.5 < share <= 1 + 1e-9 for share in shares)
    tiny = calibrate(robot, few_poses(5), parse_requests("base_frame"))
    assert tiny.after.held_out is None
    assert "too few to hold any out" in "\n".join(tiny.warnings)


def test_leverages_are_the_hat_matrix() -> None:
    data = few_poses(14)
    found = calibrate(arm("puma560").robot, data, parse_requests("joint_offset,link_geometry"), shrink=False)
    kept = found.fit.identifiability.columns
    _, jacobian = found.fit.model.bind(data).linearise(found.fit.theta)
    rows = (jacobian[:3, kept] * found.fit.weight[:, None, :]).transpose(2, 0, 1).reshape(-1, kept.size)
    # Constants that so few poses hardly show are held by priors, which are rows of their own.
    whole = np.vstack((rows, np.diag(np.sqrt(found.fit.precision))))
    hat = np.diag(whole @ np.linalg.pinv(whole))[: rows.shape[0]].reshape(-1, 3).mean(axis=1)
    # The normal equations are the last linearisation's, one short step before the coefficients.
    assert dict(found.leverage) == pytest.approx({i: hat[i] for i in np.flatnonzero(hat > 0.5)}, rel=1e-3)


def test_correlations_are_those_of_the_covariance() -> None:
    found = calibrate(arm("puma560").robot, few_poses(30), parse_requests(GEOMETRY))
    sigma = np.sqrt(np.diag(found.fit.covariance))
    pairs = [(found.fit.names.index(pair.first), found.fit.names.index(pair.second)) for pair in found.correlations]
    sizes = [pair.value for pair in found.correlations]
    assert sizes == pytest.approx([found.fit.covariance[i, j] / (sigma[i] * sigma[j]) for i, j in pairs])
    assert min(map(abs, sizes)) > 0.9
    assert sizes == sorted(sizes, key=abs, reverse=True)


# `robacc trace` from files to its table, its JSON and the model it writes.

DECLARED = "base_frame,tool_frame,joint_offset"


@pytest.fixture(scope="module")
def traced_files(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """``arm.yaml`` as delivered, ``poses.csv`` of one with backlash, ``apart.csv`` more of them, ``clean.csv``."""
    folder = tmp_path_factory.mktemp("trace")
    robot = dataclasses.replace(arm("puma560").robot, effects=())
    zeros = {"effect": "joint_offset", "joints": ["j2", "j3"], "values": {"j2": 1e-3, "j3": -5e-4}}
    backlash = {"effect": "backlash", "joints": ["j2"], "values": {"j2": 2e-4}}
    for name, effects in (("arm", ()), ("true", (zeros, backlash)), ("clean", (zeros,))):
        text = robot_to_yaml(dataclasses.replace(robot, effects=effects, effect_units=(1.0, 1.0)))
        (folder / f"{name}.yaml").write_text(text, encoding="utf-8")
    for name, of, seed in (("poses", "true", "1"), ("apart", "true", "2"), ("clean", "clean", "3")):
        arguments = ["--poses", "50", "--seed", seed, "--noise", "0.02mm", "--position-only"]
        output("simulate", folder / f"{of}.yaml", *arguments, "-o", folder / f"{name}.csv")
    return folder


def trace_command(traced_files: Path, *more: str, poses: str = "poses", declared: str = DECLARED) -> tuple[str, ...]:
    return (
        "trace",
        str(traced_files / f"{poses}.csv"),
        "--robot",
        str(traced_files / "arm.yaml"),
        "--declared",
        declared,
        *more,
    )


@cache
def traced(traced_files: Path, *more: str, poses: str = "poses") -> dict[str, Any]:
    return commands.document(*trace_command(traced_files, *more, poses=poses))


def test_json_of_a_trace_names_the_finding_its_value_and_its_files(traced_files: Path) -> None:
    found = traced(traced_files)
    assert (found["schema"], found["n_poses"]) == ("robacc.trace/2", 50)
    assert (found["verdict"], found["seed"], found["after"]["held_out"]["orientation"]) == ("explained", 0, None)
    (finding,) = found["findings"]
    assert (finding["effect"], finding["joints"]) == ("backlash", ["j2"])
    (parameter,) = finding["parameters"]
    assert (parameter["name"], parameter["unit"]) == ("backlash.j2", "rad")
    assert abs(parameter["value"] - 2e-4) < 4 * parameter["std"]
    assert all((one["std"] is None) == ("why" in one) for one in found["parameters"])
    hashes = {Path(one["name"]).name: one["sha256"] for one in found["inputs"]}
    for name in ("poses.csv", "arm.yaml"):
        assert hashes[name] == hashlib.sha256((traced_files / name).read_bytes()).hexdigest()


def test_every_candidates_score_at_every_step_is_there(traced_files: Path) -> None:
    steps = traced(traced_files)["candidates"]
    assert [step["step"] for step in steps] == list(range(len(steps)))
    (added,) = {step["effect"] for step in steps if step["action"] == "add"}
    assert added == "backlash[j2]"
    first = steps[0]["ranking"]
    assert {("backlash", ("j2",)), ("gear_ratio", ("j3",)), ("joint_compliance", ("j2",))} <= {
        (one["effect"], tuple(one["joints"])) for one in first
    }
    assert all(0 <= one["p_value"] <= 1 for step in steps for one in step["ranking"])
    offered = {one["effect"] for one in traced(traced_files)["not_offered"]}
    assert {"payload_compliance", "frame_drift"} <= offered


def test_before_is_the_declared_and_after_the_finding(traced_files: Path) -> None:
    found = traced(traced_files)
    rms = {stage: found[stage]["held_out"]["position"]["rms_m"] for stage in ("nominal", "before", "after")}
    assert rms["nominal"] > 3 * rms["before"] > 9 * rms["after"]
    # Delivered figures are what `robacc estimate` says of the same poses.
    estimate = ("estimate", traced_files / "poses.csv", "--robot", traced_files / "arm.yaml")
    unregistered = found["nominal_unregistered"]["fitted"]["position"]["rms_m"]
    assert unregistered == pytest.approx(commands.document(*estimate)["position"]["rms_m"], rel=1e-11)
    registered = commands.document(*estimate, "--align", "base_frame,tool_frame")
    # An estimate holds out each pose of the registration, a trace a fold at a time.
    assert found["nominal"]["fitted"]["position"]["rms_m"] < registered["position"]["rms_m"]
    assert found["nominal"]["held_out"]["position"]["rms_m"] == pytest.approx(registered["position"]["rms_m"], rel=0.05)
    assert found["gain_m"]["low"] < found["gain_m"]["value"] < found["gain_m"]["high"]


def test_a_clean_arm(traced_files: Path) -> None:
    table = output(*trace_command(traced_files, poses="clean"), "--full")
    told = ("declared effects explain it; nothing else found", "none, at a false-alarm rate")
    assert missing(table, *told, "extended model") == ["extended model"]


def test_poses_held_out_by_a_file(traced_files: Path) -> None:
    found = traced(traced_files, "--holdout", str(traced_files / "apart.csv"))
    assert (found["n_folds"], [one["kind"] for one in found["inputs"]]) == (0, ["poses", "robot", "holdout"])
    assert found["after"]["held_out"]["position"]["rms_m"] < 1.3 * np.sqrt(3) * 2e-5


@pytest.mark.parametrize("name", ["trace", "calibrate"])
def test_poses_that_were_fitted_are_not_held_out(traced_files: Path, tmp_path: Path, name: str) -> None:
    lines = (traced_files / "apart.csv").read_text(encoding="utf-8").splitlines()
    lines.append((traced_files / "poses.csv").read_text(encoding="utf-8").splitlines()[-1])
    mixed = saved(tmp_path / "mixed.csv", "\n".join(lines) + "\n")
    option = {"trace": "--declared", "calibrate": "--fit"}[name]
    arguments = [str(traced_files / "poses.csv"), "--robot", str(traced_files / "arm.yaml"), option, DECLARED]
    told = refused(name, *arguments, "--holdout", mixed, status=3)
    message = "1 of 51 validation poses is also among the calibration poses; the first is line"
    assert missing(told, f"{mixed}:{len(lines)}: {message}", "remove these poses from one of the two files") == []


@pytest.mark.parametrize(
    ("declared", "message"),
    [
        ("base_frame,backlsh", "no effect 'backlsh', did you mean 'backlash'?"),
        ("joint_offset[j9]", "no joint 'j9'; this arm has j1, j2, j3, j4, j5, j6"),
        ("frame_drift", "frame_drift cannot be fitted: "),
        ("base_frame[j1]", "base_frame acts on no joint in particular; write it without brackets"),
        ("joint_offset[]", "joint_offset[] names no joint"),
        ("joint_offset[j1", "cannot read"),
        ("thermal_expansion", "thermal_expansion cannot be fitted: neither temperature_c nor time_s varies"),
        ("none,backlash", ""),
    ],
)
def test_wrong_declarations_are_status_2(traced_files: Path, declared: str, message: str) -> None:
    assert message in refused(*trace_command(traced_files, declared=declared))


def test_nothing_is_written_where_the_data_are_refused(traced_files: Path, tmp_path: Path) -> None:
    poses, other = traced_files / "poses.csv", tmp_path / "other.csv"
    lines = poses.read_text(encoding="utf-8").splitlines()
    header = next(i for i, line in enumerate(lines) if not line.startswith("#"))
    without_z = "\n".join(",".join(line.split(",")[:8]) for line in lines[header:]) + "\n"
    outputs = ("--write-model", tmp_path / "model.yaml", "--output", tmp_path / "result.json", "--format", "json")
    for text, status, message in (
        ("x,y,z\n1,2,3\n", 3, "or add columns q1 … q6 (joint variables)"),
        ("x,y,z,cmd_x,cmd_y,cmd_z\n1,2,3,1,2,3\n", 2, "has no joint columns q1 … q6, which a fit needs"),
        (without_z, 3, "z"),
        ("\n".join(lines[:4]) + "\n", 3, ""),
    ):
        other.write_text(text, encoding="utf-8")
        call = ("trace", other, "--robot", traced_files / "arm.yaml", "--declared", DECLARED, *outputs)
        assert message in refused(*call, status=status)
        assert list(tmp_path.iterdir()) == [other]
    refused("trace", poses, "--robot", poses, status=3)
    refused("trace", poses)


def test_what_is_declared_by_default_is_said_and_recorded(traced_files: Path) -> None:
    bare = ("trace", str(traced_files / "poses.csv"), "--robot", str(traced_files / "arm.yaml"))
    text = one_line(output(*bare, "--full", "--folds", "2"))
    assert "declared effects: base_frame, tool_frame, joint_offset, link_geometry (default; --declared changes" in text
    # What the effect does at the tool comes before its coefficients.
    assert text.index("1) backlash on j2 moves the tool by up to ") < text.index("backlash.j2 = ")
    found = commands.document(*bare, "--folds", "2")
    names = ["base_frame", "tool_frame", "joint_offset", "link_geometry"]
    assert found["declared"] == {"effects": names, "by_default": True, "left_out": []}
    assert found["options"]["declared"] == ",".join(names)
    assert traced(traced_files)["declared"]["by_default"] is False


def test_the_size_at_the_tool_is_that_of_the_effect_alone(traced_files: Path) -> None:
    (finding,) = traced(traced_files)["findings"]
    # Backlash turns j2 by its coefficient one way or the other: the target moves by that angle times its distance
    # from the axis, which no pose has further than the arm is long.
    assert 0.3 < finding["largest_at_tool_m"] / abs(finding["parameters"][0]["value"]) < 1.5
    assert 0.0 < finding["size_at_tool_m"] <= finding["largest_at_tool_m"]


# First screens of the commands on the sample data, at 80 columns, as a user sees them.

SCREENS = {
    "estimate": "estimate poses.csv --robot robot.yaml",
    "trace": "trace poses.csv --robot robot.yaml",
    "calibrate": "calibrate poses.csv --robot robot.yaml --write-model model.yaml",
    "correct": "correct poses.csv --model model.yaml --output corrected.csv",
    "plan": "plan robot.yaml --output plan.csv --program plan.src",
    "correct_program": "correct plan.src --model model.yaml --output corrected.src",
    "plan_trace": "plan robot.yaml --for trace --candidates 100",
    "plan_acceptance": "plan robot.yaml --for acceptance --grade D --candidates 300",
}

UNKNOWN_WORDS = ("evidence", "prior odds", "folds", "equilibrium", "campaign")
"""Words that a field engineer does not know."""

NUMBER = re.compile(r" *(?<![\w.])[-+]?(\d+(?:\.\d+)?)(?!\w)")
"""A number with the spaces before it, whose count changes with its digits; no digits of names."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the sample data."""
    return tmp_path_factory.mktemp("first")


@pytest.fixture(scope="module")
def screens(folder: Path) -> dict[str, str]:
    """Standard output of each command, in the folder."""
    for name in ("poses.csv", "robot.yaml"):
        shutil.copy(SAMPLES / name, folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        return {name: output(*words.split()) for name, words in SCREENS.items()}


@pytest.mark.parametrize("name", SCREENS)
def test_a_first_screen_is_as_agreed(name: str, screens: dict[str, str]) -> None:
    screen = screens[name]
    wanted = agreed(f"first_screen_{name}.txt", screen)
    assert NUMBER.sub("#", screen) == NUMBER.sub("#", wanted)
    numbers, others = ([float(text) for text in NUMBER.findall(each)] for each in (wanted, screen))
    assert others == pytest.approx(numbers, rel=0.02)


@pytest.mark.parametrize("name", SCREENS)
def test_a_first_screen_is_short_and_says_what_is_next(name: str, screens: dict[str, str]) -> None:
    lines = screens[name].splitlines()
    assert len(lines) <= 25
    assert max(map(len, lines)) <= 80
    assert any(line.startswith("next: ") for line in lines)
    assert [word for word in UNKNOWN_WORDS if word in screens[name].lower()] == []


def test_one_summary_says_that_a_model_has_nothing_to_correct(screens: dict[str, str], folder: Path) -> None:
    for targets, written in (("poses.csv", "same.csv"), ("plan.src", "same.src")):
        screen = output("correct", folder / targets, "--model", folder / "robot.yaml", "-o", folder / written)
        assert "robot.yaml: nothing to correct" in one_line(screen)
        assert "error before" not in screen
    assert (folder / "same.src").read_bytes() == (folder / "plan.src").read_bytes()


def test_refused_targets_stand_once_for_each_reason(screens: dict[str, str], folder: Path) -> None:
    words = ("--model", folder / "model.yaml", "-o", folder / "none", "--most")
    ended = run("correct", folder / "poses.csv", *words, "0.4mm")
    told = (
        "line 10, line 11, line 12 and 39 more): at the first, the correction of",
        "2 targets (line 21",
    )
    assert (missing(ended.stderr, *told), ended.stderr.count("is larger than 0.4 mm")) == ([], 1)
    for targets, first in (("poses.csv", "57 targets (line 3"), ("plan.src", "5 targets (line 13")):
        message = refused("correct", folder / targets, *words, "0.01mm", status=3)
        assert f": not corrected: {first}" in message
        assert message.count("error: ") < 5
        assert message.count("tip: no target can be corrected") == 1


# Targets, candidates and poses to visit as exports: the options that answer what their names leave open.

ROBOT, MODEL = str(TRACED_ROBOT), str(TRUTH)


@pytest.fixture
def export(tmp_path: Path) -> tuple[str, np.ndarray]:
    """Return a German UTF-16 table of joint targets without units, and its joints in rad."""
    q = robacc.simulate(ROBOT, poses=8, seed=4).data.q
    rows = [";".join([f"P{i}", *(f"{math.degrees(a):.4f}" for a in row)]) for i, row in enumerate(q.T)]
    names = ";".join(f"A{i}" for i in range(1, 7))
    text = "\n".join(["Ziele;Zelle 4", f"Punkt;{names}", *rows, ""]).replace(".", ",")
    path = tmp_path / "ziele.csv"
    path.write_text(text, encoding="utf-16")
    return str(path), q


def test_without_units_each_command_asks(export: tuple[str, np.ndarray], tmp_path: Path) -> None:
    path, out = tmp_path / "radians.csv", str(tmp_path / "out.csv")
    # Radians may be small angles in degrees.
    rows = "\n".join(";".join(f"{angle:.6f}" for angle in row) for row in export[1].T)
    path.write_text(";".join(f"A{i}" for i in range(1, 7)) + f"\n{rows}\n")
    for arguments in (
        ("correct", str(path), "--model", MODEL, "--nominal", ROBOT),
        ("simulate", ROBOT, "--at", str(path)),
        ("plan", ROBOT, "--poses", "6", "--task", str(path)),
    ):
        told = refused(*arguments, "-o", out, status=3)
        columns = f"{path.name}:1, A1, A2, A3, A4, A5, A6: these columns state no unit"
        assert missing(told, columns, "--units") == []
        assert not Path(out).exists()


def test_correct_reads_them(export: tuple[str, np.ndarray], tmp_path: Path) -> None:
    out = tmp_path / "corrected.csv"
    found = document("correct", export[0], "--model", MODEL, "--nominal", ROBOT, "--units", "deg", "-o", out)
    expected = robacc.correct(robacc.simulate(ROBOT, poses=8, seed=4).data, model=MODEL, nominal=ROBOT).q
    np.testing.assert_allclose(robacc.simulate(ROBOT, at=out).data.q, expected, atol=5e-6)
    assert [file["reading"] for file in found["inputs"] if file["kind"] == "targets"] == [{"units": "deg"}]


def test_simulate_visits_them_and_plan_adds_to_them(export: tuple[str, np.ndarray], tmp_path: Path) -> None:
    out, options = tmp_path / "simulated.csv", ("--candidates", "200", "-o", tmp_path / "plan.csv")
    visited = document("simulate", ROBOT, "--at", export[0], "--units", "deg", "-o", out)
    np.testing.assert_allclose(robacc.read_poses(out, robot=robacc.read_robot(ROBOT)).q, export[1], atol=2e-6)
    planned = document("plan", ROBOT, "--poses", "6", "--already", export[0], "--units", "deg", *options)
    for found in (visited, planned):
        assert [file.get("reading") for file in found["inputs"]] == [None, {"units": "deg"}]


@pytest.mark.parametrize("command", ["correct", "simulate", "plan"])
def test_options_of_measurements_are_not_there(command: str) -> None:
    assert "--coverage" not in output(command, "--help")


def test_a_program_states_its_own_units(tmp_path: Path) -> None:
    program = saved(tmp_path / "drill.script", "def drill():\n  movej([0.1, -1.2, 1.0, 0.2, 0.3, 0.4])\nend\n")
    out = tmp_path / "out.script"
    told = refused("correct", program, "--model", MODEL, "--units", "mm,deg", "-o", out)
    assert "a program states its own units" in told
    assert not out.exists()
