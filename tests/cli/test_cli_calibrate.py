"""`robacc calibrate` from files to its table, its JSON and the model it writes; calibration as a library."""

from __future__ import annotations

import dataclasses
import json
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

import commands
import numpy as np
import pytest
from arms import arm
from commands import in_order, missing, one_line, output, refused, run

from robacc.effects.request import parse_requests
from robacc.measurements import Measurements
from robacc.modelling.model import predict
from robacc.modelling.robot_file import read_robot
from robacc.poses.csv_file import read_poses
from robacc.robots.yaml_robot import parse_robot, robot_to_yaml
from robacc.simulation.simulate import Plan, simulate
from robacc.tracing.calibrating import calibrate

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


def command(files: Path, fit: str, *more: str) -> tuple[str, ...]:
    return ("calibrate", str(files / "poses.csv"), "--robot", str(files / "arm.yaml"), "--fit", fit, *more)


@cache
def document(files: Path, fit: str, *more: str) -> dict[str, Any]:
    return commands.document(*command(files, fit, *more))


def values(found: dict[str, Any]) -> dict[str, dict[str, Any]]:
    return {one["name"]: one for one in found["parameters"]}


def test_json_has_the_contract_keys(files: Path) -> None:
    found = document(files, GEOMETRY)
    assert (found["schema"], found["n_poses"]) == ("robacc.calibrate/2", 50)
    assert set(found["noise"]) >= {"position_m", "orientation_rad", "source"}
    for stage, kind in product(("nominal", "before", "after"), ("fitted", "held_out")):
        for quantity, unit in (("position", "m"), ("orientation", "rad")):
            names = {f"{name}_{unit}" for name in ("rms", "mean_error", "p95", "max")}
            assert set(found[stage][kind][quantity]) >= names
    for name, one in values(found).items():
        assert set(one) >= {"name", "value", "std", "unit"}
        assert (one["std"] is None) == ("why" in one), name
    assert "joint_offset.j1 is not distinguishable from base_frame.yaw" in values(found)["joint_offset.j1"]["why"]
    identifiability = found["identifiability"]
    # The axes of joints 2 and 3 are parallel: their rotation about y is idle.
    assert identifiability["n_identifiable"] == 4 * 6 + 6 - 1
    assert set(identifiability["observability"]) == {"O1", "O2", "O3", "O4", "O5"}
    assert identifiability["condition_number"] > 1
    dropped = {one["name"] for one in identifiability["not_identifiable"]}
    assert dropped == {name for name, one in values(found).items() if one["std"] is None}


def test_stages_are_before_and_after(files: Path) -> None:
    found = document(files, f"{GEOMETRY},gear_ratio[j2]")
    rms = [found[stage]["held_out"]["position"]["rms_m"] for stage in ("nominal", "before", "after")]
    assert min(rms[:2]) > 5 * rms[2]
    assert rms[2] < 1.6 * np.sqrt(3) * NOISE
    assert found["after"]["fitted"]["position"]["rms_m"] < rms[2]
    gear = values(found)["gear_ratio.j2"]
    assert abs(gear["value"] - 5e-4) < 4 * gear["std"]
    # Noise by the residual: 300 numbers less 31.
    assert (found["noise"]["source"], found["noise"]["position_m"]) == ("residual", pytest.approx(NOISE, rel=0.2))
    assert found["gain_m"]["low"] > 0


@pytest.mark.slow
def test_joints_in_brackets_and_without(files: Path) -> None:
    exactly = document(files, "base_frame,joint_offset[j2,j3],gear_ratio[all]")
    names = set(values(exactly))
    assert {name for name in names if name.startswith("joint_offset")} == {"joint_offset.j2", "joint_offset.j3"}
    assert {name for name in names if name.startswith("gear_ratio")} == {f"gear_ratio.j{i}" for i in range(1, 7)}
    # Without brackets where the data show it.
    found = document(files, f"{GEOMETRY},gear_ratio")
    assert {name for name in values(found) if name.startswith("gear_ratio")} == {"gear_ratio.j2"}


def test_the_written_model_reproduces_the_prediction(files: Path, tmp_path: Path) -> None:
    model = tmp_path / "model.yaml"
    fitted = document(files, f"{GEOMETRY},gear_ratio[j2]", "--write-model", str(model))["after"]["fitted"]
    data = read_poses(str(files / "poses.csv"))
    residual = np.linalg.norm(data.position - predict(read_robot(model), data).translation, axis=0)
    assert fitted["position"]["rms_m"] == pytest.approx(np.sqrt(np.mean(residual**2)), rel=0, abs=1e-12)
    fresh = commands.document("estimate", files / "apart.csv", "--robot", model)
    assert fresh["position"]["rms_m"] < 1.6 * np.sqrt(3) * NOISE
    # Near nominal: no length of a kilometre that another takes back.
    for before, after in zip(read_robot(files / "arm.yaml").joints, read_robot(model).joints, strict=True):
        for label, value in after.parameters.items():
            assert abs(value - before.parameters.get(label, 0.0)) < 0.01


SLOW_ARMS = ("puma560", "urdf:ur10", "targets:puma560")


@pytest.mark.parametrize(
    "name", ["panda", "stanford", *(pytest.param(name, marks=pytest.mark.slow) for name in SLOW_ARMS)]
)
def test_a_model_written_and_read_predicts_the_same(name: str) -> None:
    robot = arm(name).robot
    joint = arm(name).names[1]
    wrong = ({"effect": "joint_offset", "joints": [joint], "values": {joint: 1e-3}},)
    data = simulate(dataclasses.replace(robot, effects=wrong), Plan(40, seed=5, noise_position=NOISE)).data
    wave = f"transmission_error[{joint}]"
    found = calibrate(robot, data, parse_requests(f"{GEOMETRY},backlash[{joint}],{wave},instrument_scale"))
    poses = predict(parse_robot(robot_to_yaml(found.robot), "model.yaml"), data)
    np.testing.assert_allclose(poses.translation, found.fit.poses.translation, rtol=0, atol=1e-12)
    np.testing.assert_allclose(poses.rotation, found.fit.poses.rotation, rtol=0, atol=1e-12)


@pytest.mark.slow
def test_constants_that_do_not_differ_are_drawn_to_the_file(files: Path) -> None:
    # Of the lengths only a of the second joint is wrong, of the angles three.
    found, alone = document(files, GEOMETRY), document(files, GEOMETRY, "--no-shrink")
    chance = {one["name"]: one["probability"] for kind in found["shrinkage"] for one in kind["constants"]}
    assert {name for name, p in chance.items() if p > 0.5} >= {"link_geometry.j2.a", "joint_offset.j2"}
    assert ([kind["unit"] for kind in found["shrinkage"]], alone["shrinkage"]) == (["rad", "m"], [])
    assert found["degrees_of_freedom"] > alone["degrees_of_freedom"] + 3
    for name in chance:
        drawn, free = values(found)[name], values(alone)[name]
        assert drawn["std"] == pytest.approx(free["std"], rel=1e-6)
        assert abs(drawn["value"]) < 0.1 * drawn["std"] or chance[name] > 0.05
    assert document(files, "base_frame,tool_frame,joint_offset[all],link_geometry[all]")["shrinkage"] == []
    assert document(files, GEOMETRY, "--prior")["shrinkage"] == []


@pytest.mark.slow
def test_tolerances_as_priors(files: Path) -> None:
    free = document(files, "joint_offset,link_geometry")
    held = document(files, "joint_offset,link_geometry", "--prior")
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
    poses = tmp_path / "poses.csv"
    poses.write_text("\n".join(lines) + "\n", encoding="utf-8")
    arguments = ("calibrate", poses, "--robot", files / "arm.yaml", "--fit", GEOMETRY, "--format", "json")
    done, every = run(*arguments), json.loads(output(*arguments, "--all-rows"))
    assert [one["line"] for one in json.loads(done.stdout)["outliers"]] == [header + 8]
    assert f"outliers left out of the fit: 1 row, on line {header + 8}" in done.stderr
    assert every["outliers"] == []
    assert every["after"]["fitted"]["position"]["max_m"] > 5e-3


def test_the_first_screen_says_how_good_why_and_what_now(files: Path) -> None:
    screen = output(*command(files, GEOMETRY))
    lines = screen.splitlines()
    assert len(lines) <= 25
    assert max(map(len, lines[:1] + lines[2:])) <= 80
    parts = ("Calibration from 50 measured poses", "fitted effects: base_frame", " after, on held-out poses: ")
    assert in_order(one_line(screen), (*parts, "--full adds", "next: "))
    # Without --fit the effects of every arm are fitted, which these are.
    bare = output("calibrate", files / "poses.csv", "--robot", files / "arm.yaml")
    told = "joint_offset, link_geometry (default; --fit changes them)"
    assert one_line(bare) == one_line(screen).replace("joint_offset, link_geometry", told)


def test_the_table(files: Path) -> None:
    table = output(*command(files, GEOMETRY, "--full"))
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
    assert "shrunk to nominal" not in output(*command(files, GEOMETRY, "--no-shrink", "--full"))
    gear = command(files, "base_frame,tool_frame,gear_ratio[j2],link_geometry", "--full")
    assert "shrunk to nominal" in one_line(output(*gear))


def test_a_file_of_its_own_judges(files: Path) -> None:
    found = document(files, GEOMETRY, "--holdout", str(files / "apart.csv"))
    assert found["n_folds"] == 0
    assert found["after"]["held_out"] != document(files, GEOMETRY)["after"]["held_out"]


def test_without_frames_the_error_before_is_not_registered_either(files: Path) -> None:
    found = document(files, "joint_offset")
    before = found["nominal_unregistered"]["held_out"]["position"]["rms_m"]
    assert f"\n{1e3 * before:.3g}" in output(*command(files, "joint_offset"))
    assert all(cause["share"] <= (cause["error_without_m"] / before) ** 2 * 1.1 for cause in found["causes"])


@pytest.mark.parametrize(
    ("fit", "message"),
    [
        ("geer_ratio", "no effect 'geer_ratio', did you mean 'gear_ratio'?"),
        ("", "--fit names no effect"),
        ("thermal_expansion", "thermal_expansion cannot be fitted: neither temperature_c nor time_s varies"),
        ("gear_ratio[j7]", "no joint 'j7'"),
    ],
)
def test_wrong_usage_is_status_2(files: Path, fit: str, message: str) -> None:
    assert message in refused(*command(files, fit))


def test_too_few_poses_are_status_3(files: Path, tmp_path: Path) -> None:
    few = tmp_path / "few.csv"
    lines = (files / "poses.csv").read_text(encoding="utf-8").splitlines()
    few.write_text("\n".join(lines[:5]) + "\n", encoding="utf-8")
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
