"""`robacc estimate` from files to its table, its JSON and its per-pose CSV."""

from __future__ import annotations

import csv
import hashlib
import json
import re
from functools import partial
from pathlib import Path

import commands
import numpy as np
import pytest
from commands import in_order, missing, one_line, output
from scipy.spatial.transform import Rotation

ROOT = Path(__file__).resolve().parents[2]
POSES = ROOT / "sample_data" / "poses.csv"
ROBOT = ROOT / "sample_data" / "robot.yaml"
SAMPLE = (str(POSES), "--robot", str(ROBOT))
GOLDEN = Path(__file__).resolve().parents[1] / "golden" / "estimate.txt"

calls = (commands.run, commands.document, commands.refused)
run, document, refused = (partial(call, "estimate") for call in calls)
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
    path = tmp_path / "poses.csv"
    path.write_text(COMMANDED, encoding="utf-8")
    found = document(str(path))
    assert (found["schema"], found["n_poses"], found["frame"], found["seed"]) == ("robacc.estimate/1", 5, "tool", 0)
    assert found["inputs"] == [
        {"name": "poses.csv", "sha256": hashlib.sha256(path.read_bytes()).hexdigest(), "kind": "poses"}
    ]
    assert {"robacc", "command", "options", "notes", "warnings"} <= set(found)
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


def test_position_only_has_no_orientation() -> None:
    text = "x,y,z,cmd_x,cmd_y,cmd_z\n1,2,3,1,2,3.001\n1,2,4,1,2,4.002\n"
    found = document("-", text=text)
    assert (found["orientation"], found["frame"], found["inputs"][0]["name"]) == (None, "base", "-")
    np.testing.assert_allclose(found["position"]["errors_m"], [[0, 0, -1e-3], [0, 0, -2e-3]], atol=1e-15)
    assert "frame tool needs the commanded orientation" in refused("-", "--frame", "tool", text=text)


def test_same_bytes_every_time_and_seed_matters() -> None:
    first, again = (run(*SAMPLE, "--format", "json").stdout for _ in range(2))
    assert (first, str(ROOT) in first) == (again, False)
    found = json.loads(first), document(*SAMPLE, "--seed", 1)
    lower = {one["position"]["intervals"]["mean_error_m"]["lower"] for one in found}
    assert len(lower) == 2


def test_alignment_stands_beside_the_unaligned_figures() -> None:
    plain, aligned = document(*SAMPLE), document(*SAMPLE, "--align", "base_frame,tool_frame")
    assert plain["alignment"] is plain["unaligned"] is None
    assert aligned["alignment"]["what"] == ["base_frame", "tool_frame"]
    assert aligned["alignment"]["n_parameters"] == len(aligned["alignment"]["parameters"]) == 12
    for key, unit in (("position", "m"), ("orientation", "rad")):
        for name in (f"rms_{unit}", f"mean_error_{unit}", f"p95_{unit}", f"max_{unit}"):
            assert aligned["unaligned"][key][name] == pytest.approx(plain[key][name], rel=1e-12)
    assert aligned["position"]["rms_m"] < 0.5 * plain["position"]["rms_m"]
    table = run(*SAMPLE, "--align", "base_frame,tool_frame", "--full").stdout
    assert missing(table, "registered: base_frame and tool_frame fitted, 12 parameters", "unregistered") == []
    assert "unregistered" not in run(*SAMPLE, "--full").stdout
    assert "not registered" in run(*SAMPLE).stdout


def test_table_is_as_it_was() -> None:
    """Golden: a change of looks is a change to review. Rewrite with the command in the failure's message."""
    message = f"robacc estimate - --full > {GOLDEN.name} if it should be"
    assert output("estimate", "-", "--full", text=COMMANDED) == GOLDEN.read_text(encoding="utf-8"), message


ALIGNED = (*SAMPLE, "--align", "base_frame,tool_frame")


@pytest.mark.parametrize("arguments", [ALIGNED, SAMPLE])
def test_the_first_screen_answers_how_good_why_and_what_now(arguments: tuple[str, ...]) -> None:
    screen, found = run(*arguments).stdout, document(*arguments)
    assert len(screen.splitlines()) <= 25
    assert "\nnext: find the causes of the error: robacc trace " in screen
    sizes = [f"{found['position'][name] * 1e3:.3g}" for name in ("rms_m", "mean_error_m", "p95_m", "max_m")]
    assert missing(one_line(screen), f"Grade {found['grade']['grade']}, ", *sizes, "largest errors: line ") == []
    assert "--full adds covariances" in screen.splitlines()[-2]


@pytest.mark.parametrize("arguments", [SAMPLE, ALIGNED, (*ALIGNED, "--full"), (*SAMPLE, "--frame", "base", "--full")])
def test_table_fits_a_page_and_has_no_loose_ends(arguments: tuple[str, ...]) -> None:
    for line in run(*arguments).stdout.splitlines():
        assert len(line) <= 80 or " against the model " in line or " robacc trace " in line
        assert line == line.rstrip()


def test_output_is_written_whole_or_not_at_all(tmp_path: Path) -> None:
    target = tmp_path / "result.json"
    assert run(*SAMPLE, "--format", "json", "--output", str(target)).stdout == ""
    whole = target.read_text(encoding="utf-8")
    assert whole == run(*SAMPLE, "--format", "json").stdout
    bad = tmp_path / "bad.csv"
    bad.write_text("x,y,z\n1,2,oops\n", encoding="utf-8")
    refused(bad, "--format", "json", "--output", target, status=3)
    assert target.read_text(encoding="utf-8") == whole
    refused(*SAMPLE, "--output", tmp_path / "no" / "where.txt", status=3)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bad.csv", "result.json"]


def test_bad_rows_are_all_named_with_line_and_column(tmp_path: Path) -> None:
    path = tmp_path / "poses.csv"
    path.write_text("x,y,z,cmd_x,cmd_y,cmd_z\n1,2,3,1,2,3\n1,,3,1,2,3\n1,2,3,1,2,up\n", encoding="utf-8")
    told = refused(path, "--format", "json", status=3)
    assert in_order(told, (f"error: {path}:3, y", f"error: {path}:4, cmd_z"))
    assert told.count("error: ") == 2


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
    scale = tmp_path / "scale.yaml"
    scale.write_text(
        "robacc: 1\nname: shop floor\nstatistic: max\nconfidence: 0.9\nunits: {length: mm, angle: deg}\n"
        "steps:\n  - {grade: good, position: 10, orientation: 5}\notherwise: poor\n",
        encoding="utf-8",
    )
    found = document(*SAMPLE, "--scale", str(scale))
    assert (found["grade"]["grade"], found["grade"]["scale"]) == ("good", "shop floor")
    assert found["inputs"][2]["kind"] == "scale"
    # The scale demonstrates at its own confidence; the figures keep the one asked for.
    assert (found["grade"]["confidence"], found["position"]["confidence"]) == (0.9, 0.95)
    assert document(*SAMPLE, "--confidence", "0.99")["position"]["confidence"] == 0.99


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((str(POSES),), "the poses have no commanded positions"),
        ((*SAMPLE, "--align", "backlash"), "cannot align backlash"),
        ((*SAMPLE, "--confidence", "2"), "at least 0.5 and less than 1"),
        ((str(POSES), "--tip-link", "flange"), "choose a chain of a URDF, so they need --robot"),
    ],
)
def test_calls_that_do_not_fit_together_are_status_2(arguments: tuple[str, ...], message: str) -> None:
    assert message in refused(*arguments)


def test_poses_that_are_too_few_for_a_registration_are_status_3(tmp_path: Path) -> None:
    few, align = tmp_path / "poses.csv", ("--align", "base_frame,tool_frame")
    few.write_text("".join(POSES.read_text(encoding="utf-8").splitlines(keepends=True)[:4]), encoding="utf-8")
    for files in ((few,), (few, POSES)):
        result = run(*files, *SAMPLE[1:], *align)
        assert result.exit_code == 3
        assert "2 commanded poses, 12 numbers measured" in one_line(result.stdout + result.stderr)
    told = refused("-", *align, status=3, text="\n".join(COMMANDED.splitlines()[:3]) + "\n")
    assert "2 commanded poses, 12 numbers measured: the 12 parameters of base_frame and tool_frame" in told
    assert told.endswith("state the frames in the robot file and omit --align")


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
