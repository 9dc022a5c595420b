"""`robacc trace` from files to its table, its JSON and the model it writes."""

from __future__ import annotations

import dataclasses
import hashlib
from functools import cache
from pathlib import Path
from typing import Any

import commands
import numpy as np
import pytest
from arms import arm
from commands import in_order, missing, one_line, output, refused, run

from robacc.modelling.model import predict
from robacc.modelling.robot_file import read_robot
from robacc.poses.csv_file import read_poses
from robacc.robots.yaml_robot import robot_to_yaml

DECLARED = "base_frame,tool_frame,joint_offset"


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Path:
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


def command(files: Path, *more: str, poses: str = "poses", declared: str = DECLARED) -> tuple[str, ...]:
    return ("trace", str(files / f"{poses}.csv"), "--robot", str(files / "arm.yaml"), "--declared", declared, *more)


@cache
def document(files: Path, *more: str, poses: str = "poses") -> dict[str, Any]:
    return commands.document(*command(files, *more, poses=poses))


FIGURES = {"rms_m", "mean_error_m", "p95_m", "max_m"}


def test_json_has_the_contract_keys(files: Path) -> None:
    found = document(files)
    assert found["schema"] == "robacc.trace/2"
    assert {"robacc", "command", "options", "inputs", "seed", "candidates"} <= set(found)
    assert (found["n_poses"], found["verdict"], found["seed"]) == (50, "explained", 0)
    assert set(found["noise"]) >= {"position_m", "orientation_rad", "source"}
    for stage in ("nominal", "before", "after"):
        for kind in ("fitted", "held_out"):
            assert set(found[stage][kind]["position"]) >= FIGURES
            assert found[stage][kind]["orientation"] is None
    (finding,) = found["findings"]
    keys = {"effect", "joints", "alternatives", "p_value", "held_out_before_m", "held_out_after_m", "parameters"}
    assert keys <= set(finding)
    assert (finding["effect"], finding["joints"]) == ("backlash", ["j2"])
    assert all({"effect", "joints"} <= set(other) for other in finding["alternatives"])
    (parameter,) = finding["parameters"]
    assert (parameter["name"], parameter["unit"]) == ("backlash.j2", "rad")
    assert abs(parameter["value"] - 2e-4) < 4 * parameter["std"]
    assert set(found["unexplained"]) >= {"rms_m", "noise_rms_m", "structured", "p_value", "hints"}
    for one in found["parameters"]:
        assert set(one) >= {"name", "value", "std", "unit"}
        assert (one["std"] is None) == ("why" in one)
    hashes = {Path(one["name"]).name: one["sha256"] for one in found["inputs"]}
    for name in ("poses.csv", "arm.yaml"):
        assert hashes[name] == hashlib.sha256((files / name).read_bytes()).hexdigest()


def test_every_candidates_score_at_every_step_is_there(files: Path) -> None:
    steps = document(files)["candidates"]
    assert [step["step"] for step in steps] == list(range(len(steps)))
    (added,) = {step["effect"] for step in steps if step["action"] == "add"}
    assert added == "backlash[j2]"
    first = steps[0]["ranking"]
    assert {("backlash", ("j2",)), ("gear_ratio", ("j3",)), ("joint_compliance", ("j2",))} <= {
        (one["effect"], tuple(one["joints"])) for one in first
    }
    assert all({"evidence", "p_value", "log_prior"} <= set(one) for one in first)
    assert all(0 <= one["p_value"] <= 1 for step in steps for one in step["ranking"])
    offered = {one["effect"] for one in document(files)["not_offered"]}
    assert {"payload_compliance", "frame_drift"} <= offered


def test_before_is_the_declared_and_after_the_finding(files: Path) -> None:
    found = document(files)
    rms = {stage: found[stage]["held_out"]["position"]["rms_m"] for stage in ("nominal", "before", "after")}
    assert rms["nominal"] > 3 * rms["before"] > 9 * rms["after"]
    # Delivered figures are what `robacc estimate` says of the same poses.
    estimate = ("estimate", files / "poses.csv", "--robot", files / "arm.yaml")
    unregistered = found["nominal_unregistered"]["fitted"]["position"]["rms_m"]
    assert unregistered == pytest.approx(commands.document(*estimate)["position"]["rms_m"], rel=1e-11)
    registered = commands.document(*estimate, "--align", "base_frame,tool_frame")
    # An estimate holds out each pose of the registration, a trace a fold at a time.
    assert found["nominal"]["fitted"]["position"]["rms_m"] < registered["position"]["rms_m"]
    assert found["nominal"]["held_out"]["position"]["rms_m"] == pytest.approx(registered["position"]["rms_m"], rel=0.05)
    assert found["gain_m"]["low"] < found["gain_m"]["value"] < found["gain_m"]["high"]


def test_the_table_has_its_sections_in_order(files: Path) -> None:
    done = run(*command(files), "--full")
    parts = ("Trace of 50 measured poses: explained", "1. Residual", "2. Candidates", "3. Findings")
    stages = ("nominal, base and tool registered", "baseline (declared effects)", "extended model (findings)")
    sections = (*parts, "1) backlash on j2", "4. Before and after", *stages, "5. Remaining error")
    assert in_order(done.stdout, sections)
    assert ("held-out poses" in done.stdout, done.exit_code, done.stderr) == (True, 0, "")


@pytest.mark.parametrize("poses", ["poses", "clean"])
def test_the_first_screen_says_how_good_why_and_what_now(files: Path, poses: str) -> None:
    done = run(*command(files, poses=poses))
    lines = done.stdout.splitlines()
    assert len(lines) <= 25
    assert max(len(line) for line in lines if str(files) not in line) <= 80
    found = document(files, poses=poses)
    held_out = [found[stage]["held_out"]["position"]["rms_m"] * 1e3 for stage in ("nominal", "after")]
    assert "{:.3g} mm rms before, {:.3g} mm rms after, on held-out poses".format(*held_out) in done.stdout
    assert ("backlash[j2]" in done.stdout) == (poses == "poses")
    assert ("next: nothing to correct" in done.stdout) == (held_out[1] > 0.9 * held_out[0])
    assert "--full adds" in done.stdout


def test_a_clean_arm(files: Path) -> None:
    found, table = document(files, poses="clean"), output(*command(files, poses="clean"), "--full")
    assert (found["verdict"], found["findings"], found["after"]) == ("clean", [], found["before"])
    told = ("declared effects explain it; nothing else found", "none, at a false-alarm rate")
    assert missing(table, *told, "extended model") == ["extended model"]


@pytest.mark.slow
def test_the_written_model_is_a_robot_file_that_finds_nothing_more(files: Path, tmp_path: Path) -> None:
    model = tmp_path / "model.yaml"
    found = document(files, "--write-model", str(model))
    data = read_poses(str(files / "poses.csv"))
    residual = np.linalg.norm(data.position - predict(read_robot(model), data).translation, axis=0)
    fitted = found["after"]["fitted"]["position"]
    assert fitted["rms_m"] == pytest.approx(np.sqrt(np.mean(residual**2)), rel=0, abs=1e-12)
    assert fitted["max_m"] == pytest.approx(residual.max(), rel=0, abs=1e-12)
    text = model.read_text(encoding="utf-8")
    assert text.startswith("# written by robacc")
    assert "poses.csv" in text.splitlines()[0]
    assert "backlash" in text
    again = commands.document("trace", files / "poses.csv", "--robot", model, "--declared", DECLARED)
    assert again["findings"] == []
    # Poses that had no part in it: what is left is noise, root three times 0.02 mm, and the coefficients' own error.
    fresh = commands.document("estimate", files / "apart.csv", "--robot", model)
    assert fresh["position"]["rms_m"] < 1.3 * np.sqrt(3) * 2e-5


def test_poses_held_out_by_a_file(files: Path) -> None:
    found = document(files, "--holdout", str(files / "apart.csv"))
    assert (found["n_folds"], [one["kind"] for one in found["inputs"]]) == (0, ["poses", "robot", "holdout"])
    assert found["after"]["held_out"]["position"]["rms_m"] < 1.3 * np.sqrt(3) * 2e-5


@pytest.mark.parametrize("name", ["trace", "calibrate"])
def test_poses_that_were_fitted_are_not_held_out(files: Path, tmp_path: Path, name: str) -> None:
    lines = (files / "apart.csv").read_text(encoding="utf-8").splitlines()
    lines.append((files / "poses.csv").read_text(encoding="utf-8").splitlines()[-1])
    mixed = tmp_path / "mixed.csv"
    mixed.write_text("\n".join(lines) + "\n", encoding="utf-8")
    option = {"trace": "--declared", "calibrate": "--fit"}[name]
    arguments = [str(files / "poses.csv"), "--robot", str(files / "arm.yaml"), option, DECLARED]
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
    ],
)
def test_wrong_declarations_are_status_2(files: Path, declared: str, message: str) -> None:
    assert message in refused(*command(files, declared=declared))


def test_nothing_is_written_where_the_data_are_refused(files: Path, tmp_path: Path) -> None:
    poses, other = files / "poses.csv", tmp_path / "other.csv"
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
        call = ("trace", other, "--robot", files / "arm.yaml", "--declared", DECLARED, *outputs)
        assert message in refused(*call, status=status)
        assert list(tmp_path.iterdir()) == [other]
    refused("trace", poses, "--robot", poses, status=3)
    refused("trace", poses)


def test_what_is_declared_by_default_is_said_and_recorded(files: Path) -> None:
    bare = ("trace", str(files / "poses.csv"), "--robot", str(files / "arm.yaml"))
    text = one_line(output(*bare, "--full"))
    assert "declared effects: base_frame, tool_frame, joint_offset, link_geometry (default; --declared changes" in text
    # What the effect does at the tool comes before its coefficients.
    finding = text.index("1) backlash on j2 moves the tool by up to ")
    assert finding < text.index("backlash.j2 = ")
    found = commands.document(*bare)
    names = ["base_frame", "tool_frame", "joint_offset", "link_geometry"]
    assert found["declared"] == {"effects": names, "by_default": True, "left_out": []}
    assert found["options"]["declared"] == ",".join(names)
    named = commands.document(*command(files, declared=",".join(names)))
    assert named["declared"]["by_default"] is False
    assert named["findings"] == found["findings"]


def test_the_size_at_the_tool_is_that_of_the_effect_alone(files: Path) -> None:
    (finding,) = document(files)["findings"]
    # Backlash turns j2 by its coefficient one way or the other: the target moves by that angle times its distance
    # from the axis, which no pose has further than the arm is long.
    assert 0.3 < finding["largest_at_tool_m"] / abs(finding["parameters"][0]["value"]) < 1.5
    assert 0.0 < finding["size_at_tool_m"] <= finding["largest_at_tool_m"]


def test_nothing_is_declared_by_none(files: Path) -> None:
    found = document(files, poses="clean")
    assert found["declared"]["effects"] == ["base_frame", "tool_frame", "joint_offset"]
    done = run(*command(files, declared="none,backlash"))
    assert done.exit_code == 2
