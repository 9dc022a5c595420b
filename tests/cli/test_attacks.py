"""Files made to mislead: each gets one message, a warning, or the right reading; none gets a traceback."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from commands import refused
from pose_files import Reader

import robacc
from robacc.errors import InputError
from robacc.io.dialect import find_dialect
from robacc.io.files import write_text
from robacc.measurements import Measurements
from robacc.poses.columns import is_documented
from robacc.poses.csv_file import format_poses

URDF = (
    '<robot name="a"><link name="b"><collision><geometry><mesh filename="{mesh}"/></geometry></collision></link>'
    '<link name="t"/><joint name="j" type="revolute"><parent link="b"/><child link="t"/><axis xyz="0 0 1"/>'
    '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>'
)
ROBOT, POSES = "sample_data/trace/robot.yaml", "sample_data/trace/poses.csv"


def test_a_number_of_400_digits_in_a_result(tmp_path: Path) -> None:
    result = json.loads(robacc.estimate(POSES, robot=ROBOT).to_json())
    result["position"]["rms_m"] = int("9" * 400)
    path, gate = tmp_path / "r.json", tmp_path / "g.yaml"
    path.write_text(json.dumps(result))
    gate.write_text("robacc_gate: 1\nname: g\ncriteria:\n  - {key: position.rms, limit: 1 mm, reason: r}\n")
    for call in (["check", str(path), "--gate", str(gate)], ["compare", str(path), str(path)]):
        assert "is not a result: the number 9999" in refused(*call, status=3)


def test_a_loop_of_links_is_no_output(tmp_path: Path) -> None:
    first, second = tmp_path / "first", tmp_path / "second"
    first.symlink_to(second)
    second.symlink_to(first)
    with pytest.raises(InputError, match="first: cannot be written: it is a link to itself"):
        write_text(first, "x")
    assert first.is_symlink()
    (tmp_path / "new").symlink_to(tmp_path / "target")
    write_text(tmp_path / "new", "x")
    assert (tmp_path / "target").read_text() == "x"


@pytest.mark.skipif(not Path("/proc/self/mem").exists(), reason="needs a file that opens and cannot be read")
def test_an_input_that_fails_while_it_is_read_is_named() -> None:
    with pytest.raises(InputError, match="/proc/self/mem: cannot be read: input/output error"):
        robacc.read_poses("/proc/self/mem")


@pytest.mark.parametrize(
    ("mesh", "message"),
    [
        ("../secret.stl", r"mesh \.\./secret\.stl lies outside the folder or package of the URDF"),
        ("package://../secret.stl", "lies outside the folder or package of the URDF"),
        ("package://./../secret.stl", "(lies outside the folder or package of the URDF|is not there)"),
        ("poses.json", "a collision mesh cannot be read"),
        ("none.stl", r"mesh none\.stl is not there"),
    ],
)
@pytest.mark.filterwarnings("ignore")
def test_a_mesh_stays_inside_the_package_and_any_failure_is_one_message(
    tmp_path: Path, mesh: str, message: str
) -> None:
    pytest.importorskip("fcl")
    folder = tmp_path / "arm" / "urdf"
    folder.mkdir(parents=True)
    for name in ("arm/secret.stl", "arm/meshes.stl", "secret.stl", "arm/urdf/poses.json"):
        (tmp_path / name).write_text("{}")
    urdf = folder / "arm.urdf"
    urdf.write_text(URDF.format(mesh=mesh))
    with pytest.raises(InputError, match=message):
        robacc.plan(urdf, poses=5, purpose="calibrate", collisions=True)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("mesh", ["../meshes/a.stl", "package://arm/meshes/a.stl", "package://tool/meshes/a.stl"])
def test_a_mesh_of_the_package_or_of_one_beside_it_is_read(tmp_path: Path, mesh: str) -> None:
    pytest.importorskip("fcl")
    import trimesh

    from robacc_plugins.collisions import read_link_shapes

    for name in ("arm/urdf", "arm/meshes", "tool/meshes"):
        (tmp_path / name).mkdir(parents=True)
    (tmp_path / "arm" / "package.xml").write_text("<package/>")
    for name in ("arm", "tool"):
        trimesh.creation.box((1, 1, 1)).export(tmp_path / name / "meshes" / "a.stl")
    urdf = tmp_path / "arm" / "urdf" / "arm.urdf"
    urdf.write_text(URDF.format(mesh=mesh))
    (shape,) = read_link_shapes(str(urdf), robacc.read_robot(urdf))
    assert shape.faces.shape == (12, 3)


def test_ids_that_a_spreadsheet_would_run_are_marked_and_read_back(read: Reader, tmp_path: Path) -> None:
    ids = ["=1+1", "+cmd|x", "-2", "-a", "@sum", "'b", "P1", "+3.5"]
    data = Measurements(np.arange(24.0).reshape(3, 8), q=np.linspace(0, 1, 8)[None], pose=np.array(ids))
    text = format_poses(data)
    written = [line.rpartition(",")[2] for line in text.splitlines()[1:]]
    assert written == ["'=1+1", "'+cmd|x", "-2", "'-a", "'@sum", "'b", "P1", "+3.5"]
    again = read(text)
    assert again.pose.tolist() == ids
    commanded = Measurements(data.position, commanded_position=data.position + 1e-4, pose=data.pose)
    cells = [line.split(",")[1] for line in robacc.estimate(commanded).per_pose_csv().splitlines()[1:]]
    assert cells == written


def test_a_last_line_that_ends_inside_a_number_is_warned_of(read: Reader) -> None:
    rows = [f"{0.1 * i:.3f},1.000,2.000,{3 + 0.0125 * i:.4f}" for i in range(8)]
    text = "\n".join(["q1,x,y,z", *rows])
    assert read(text).warnings == read(text + "\n").warnings == ()
    (warning,) = read(text[:-2]).warnings
    assert "poses.csv: 3.08, the last number, has fewer decimals than those above" in warning
    assert read(text[:-2] + "\n").warnings == ()
    comma = text.replace(",", ";").replace(".", ",").replace("q1;x;y;z", "J1 [rad];X [m];Y [m];Z [m]")
    assert "3,08, the last number, has fewer decimals" in read(comma[:-2]).warnings[-1]


def test_a_payload_that_no_arm_carries_is_warned_of(read: Reader) -> None:
    (warning,) = read("q1,x,y,z,payload_kg\n0,1,2,3,4\n0.1,1,2,3.1,1e9\n0.2,1,2,3.2,4\n").warnings
    assert warning.endswith("poses.csv:3: payload_kg is 1e+09 kg, more than an arm carries")


@pytest.mark.parametrize("title", ["J1,X,Y,Z", "measured"])
@pytest.mark.parametrize("marks", [("---", "'12"), ("---", "'"), ("---", "''")])
def test_rows_of_marks_and_apostrophes_are_no_header(title: str, marks: tuple[str, str]) -> None:
    rng = np.random.default_rng(0)
    rows = [",".join([f"{rng.normal():.4f}", *rng.choice(marks, 3)]) for _ in range(200)]
    assert find_dialect([title, *rows], is_documented).header_line in (None, 0)


def test_a_temperature_that_no_effect_depends_on_refuses_no_target(tmp_path: Path) -> None:
    data = robacc.simulate("sample_data/trace/truth.yaml", poses=40, seed=2, temperature=(23, 25)).data
    targets = robacc.simulate(ROBOT, poses=5, seed=3, motion=False).data
    frames = ("base_frame", "tool_frame", "joint_offset")
    plain, thermal = (
        robacc.calibrate(data, robot=ROBOT, fit=fit).robot for fit in (frames, (*frames, "thermal_expansion"))
    )
    cold = {"temperature": 22, "most": "100mm,30deg", "strict_range": True}
    result = robacc.correct(targets, model=plain, **cold)
    assert result.n_corrected == 5
    (warning,) = [text for text in result.warnings if "temperature" in text]
    assert warning.startswith("the targets are at 22 to 22 °C, the model was fitted at 23")
    within = robacc.correct(targets, model=plain, temperature=24, most="1m")
    assert "°C" not in "\n".join(within.warnings)
    np.testing.assert_array_equal(result.q, within.q)
    with pytest.raises(InputError, match="temperature_c is outside the range"):
        robacc.correct(targets, model=thermal, **cold)
