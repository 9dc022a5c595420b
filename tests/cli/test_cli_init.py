"""`robacc init`: what it writes is valid at once, and nothing is written over unasked."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from commands import missing, output, refused, run

import robacc
from robacc.modelling.robot_file import read_robot
from robacc.poses.csv_file import read_poses
from robacc.poses.reading import KnownRobot
from robacc.robots.arm import build_chain
from robacc.simulation.simulate import poses_template

URDF = """<robot name="two">
  <link name="base"/><link name="arm"/><link name="hand"/>
  <joint name="turn" type="revolute"><parent link="base"/><child link="arm"/><origin xyz="0 0 0.3" rpy="0.1 0 0"/>
    <axis xyz="0 0 1"/><limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
  <joint name="slide" type="prismatic"><parent link="arm"/><child link="hand"/><origin xyz="0.4 0 0"/>
    <axis xyz="1 0 0"/>{limit}</joint>
</robot>
"""
LIMIT = '<limit lower="0" upper="0.2" effort="1" velocity="1"/>'


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("count", [1, 2, 3, 6, 7, 12])
def test_both_files_are_valid_at_once(count: int) -> None:
    done = run("init", "--joints", str(count))
    assert (done.exit_code, done.stderr) == (0, "")
    assert f"wrote robot.yaml ({count} joint{'s' * (count > 1)}) and poses.csv (8 simulated rows)" in done.stdout
    robot, data = read_robot("robot.yaml"), read_poses("poses.csv")
    assert (len(robot.variables), data.warnings) == (count, ())
    # The made-up error is of 0.1 mm along each axis.
    errors = data.position - build_chain(robot).forward(data.q).translation
    assert 2e-5 < np.sqrt(np.mean(errors**2)) < 3e-4
    for command in done.stdout.splitlines():
        words = command.split()
        if words[0] == "robacc" and (words[1] == "show" or count == 6):
            output(*words[1:])


def test_commented_out_fields_are_valid_too() -> None:
    run("init", "--joints", "6")
    text = Path("robot.yaml").read_text(encoding="utf-8")
    for line in ("sign: -1", "gear_ratio: 100", "mass: 40", "com: [", "tolerance: {", "effects:", "  - {effect:"):
        assert f"# {line}" in text
        text = text.replace(f"# {line}", line)
    text = "\n".join(line for line in text.splitlines() if not line.startswith("tool:")).replace(
        "#   targets", "targets"
    )
    Path("full.yaml").write_text(text, encoding="utf-8")
    robot = read_robot("full.yaml")
    joint = robot.variables[0]
    assert (joint.sign, joint.gear_ratio, joint.mass, joint.com) == (-1, 100.0, 40.0, pytest.approx((-0.1, 0.0, 0.05)))
    assert (set(joint.tolerance), list(robot.targets)) == ({"theta", "d", "a", "alpha"}, ["t1", "t2", "t3"])
    assert robot.effects[0]["effect"] == "joint_compliance"


def test_every_field_has_its_comment() -> None:
    run("init", "--joints", "6")
    lines = Path("robot.yaml").read_text(encoding="utf-8").splitlines()
    start = next(number for number, line in enumerate(lines) if line.startswith("joints:"))
    for line in lines[: start + 8]:
        if line and not line.startswith(("#", "joints:")):
            assert "# " in line, line


def test_from_a_urdf(folder: Path) -> None:
    Path("two.urdf").write_text(URDF.format(limit=LIMIT), encoding="utf-8")
    done = run("init", "two.urdf", "--folder", "new/place", "--robot", "r.yaml", "--poses", "p.csv")
    assert (done.exit_code, done.stderr) == (0, "")
    ours, theirs = read_robot("new/place/r.yaml"), read_robot("two.urdf")
    q = np.array([[0.3, -1.0], [0.1, 0.05]])
    np.testing.assert_array_equal(build_chain(ours).forward(q).matrices(), build_chain(theirs).forward(q).matrices())
    text = Path("new/place/p.csv").read_text(encoding="utf-8")
    assert missing(text, "q1 is turn; q2 is slide", "pose,q1_deg,q2_mm,x_mm,y_mm,z_mm") == []
    data = read_poses(
        "new/place/p.csv", robot=KnownRobot(joint_types=["revolute", "prismatic"], joint_names=["turn", "slide"])
    )
    assert 0.0 <= data.q[1].min() <= data.q[1].max() <= 0.2
    head = Path("new/place/r.yaml").read_text(encoding="utf-8").partition("robacc: 1")[0]
    assert "converted from two.urdf" in head
    assert all(line.startswith("#") for line in head.splitlines())
    assert str(folder) not in text + head


def test_a_slide_without_limits_has_no_example_rows() -> None:
    Path("two.urdf").write_text(URDF.format(limit=LIMIT), encoding="utf-8")
    robot = read_robot("two.urdf")
    joints = tuple(dataclasses.replace(joint, limits=None) for joint in robot.joints)
    table, rows = poses_template(dataclasses.replace(robot, joints=joints), "r.yaml", "p.csv")
    assert (rows, table.splitlines()[-1]) == (0, "pose,q1_deg,q2_mm,x_mm,y_mm,z_mm")
    assert "made up" not in table


def test_nothing_is_written_over_unasked() -> None:
    Path("poses.csv").write_text("mine", encoding="utf-8")
    assert "poses.csv exists already; overwrite with --force" in refused("init", "--joints", "6")
    assert not Path("robot.yaml").exists()
    assert Path("poses.csv").read_text(encoding="utf-8") == "mine"
    output("init", "--joints", "6", "--force")
    assert read_poses("poses.csv").n == 8
    assert "robot.yaml and poses.csv exist already" in refused("init", "--joints", "6")


@pytest.mark.parametrize(
    ("arguments", "status", "message"),
    [
        ((), 2, "give either a file or --joints"),
        (("two.urdf", "--joints", "2"), 2, "give either a file or --joints"),
        (("--joints", "0"), 2, "expected 1 to 30 joints, found 0"),
        (("--joints", "31"), 2, "expected 1 to 30 joints, found 31"),
        (("--joints", "2", "--robot", "x", "--poses", "./x"), 2, "both name x; name two files"),
        (("--joints", "2", "--tip-link", "hand"), 2, "choose a chain of a URDF"),
        (("two.urdf", "--robot", "two.urdf", "--force"), 2, "two.urdf is the URDF and would be overwritten"),
        (("none.urdf",), 3, "none.urdf: the file does not exist"),
        (("arm.yaml",), 2, "arm.yaml is a robot file already"),
        (("--joints", "2", "--folder", "two.urdf"), 3, "two.urdf: cannot be created: "),
    ],
)
def test_calls_that_do_not_fit(arguments: tuple[str, ...], status: int, message: str) -> None:
    Path("two.urdf").write_text(URDF.format(limit=LIMIT), encoding="utf-8")
    run("init", "--joints", "2", "--robot", "arm.yaml", "--poses", "arm.csv")
    assert message in refused("init", *arguments, status=status)
    assert not Path("robot.yaml").exists()


def test_a_map_asks_what_the_names_of_columns_leave_open(folder: Path) -> None:
    joints = ",".join(f"J{i} [deg]" for i in range(1, 7))
    (folder / "export.csv").write_text(
        f"Point,{joints},X [mm],Y [mm],Z [mm],Q1,Q2,Q3,Q4\nP1,10,20,30,40,5,6,500,100,200,1,0,0,0\n"
    )
    assert "  fill in angles in columns.yaml\n" in run("init", "export.csv").stdout
    text = (folder / "columns.yaml").read_text()
    for order, expected in (("wxyz", np.eye(3)), ("xyzw", np.diag([1.0, -1.0, -1.0]))):
        (folder / "columns.yaml").write_text(text.replace("angles: unknown", f"angles: {order}"))
        data = robacc.read_poses("export.csv", columns="columns.yaml", robot=read_robot("ur10e"))
        np.testing.assert_allclose(data.rotation, expected[:, :, None], atol=1e-12)


def test_a_map_asks_for_joints_under_names_of_a_robot(folder: Path) -> None:
    (folder / "export.csv").write_text("x1,y1,z1,phix1,phiy1,phiz1,shoulder,elbow\n0.1,0.2,0.3,0,0,0,0.4,0.5\n")
    done = run("init", "export.csv")
    question = "no column is taken for a joint; name the columns of joints q1 … qN, in the order of the chain"
    assert f"  decide in columns.yaml: {question}\n" in done.stdout
    text = (folder / "columns.yaml").read_text()
    assert missing(text, f"# open: {question}\n", '"z1": z\n', '"phiz1": rz\n', '"elbow":    # not read\n') == []


def test_a_map_of_a_file_without_names_says_what_to_name(folder: Path) -> None:
    (folder / "export.csv").write_text("1.5,2.5,300,400,500\n1.6,2.6,310,410,510\n")
    told = (
        "wrote columns.yaml (reads 0 of 5 columns of export.csv)\n",
        "decide in columns.yaml: the file has no names; name its columns, in their units, as in q1_deg",
    )
    assert missing(output("init", "export.csv"), *told) == []


def test_a_file_that_is_no_table_is_named_before_an_existing_map(folder: Path) -> None:
    (folder / "columns.yaml").write_text("")
    assert "nothing.csv: the file does not exist" in refused("init", "nothing.csv", status=3)
    (folder / "rows.json").write_text("[[1, 2]]")
    assert "rows.json: has no list of records" in refused("init", "rows.json", status=3)
