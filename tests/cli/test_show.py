"""``robacc show``: its figures, its table, its JSON, its exit statuses."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial
from pathlib import Path

import commands
import numpy as np
import pytest
from commands import missing

from robacc.io.files import sha256_of
from robacc.modelling.robot_file import read_robot
from robacc.render.text import lines_of
from robacc.render.views.robot import robot_view
from robacc.robots.arm import build_chain
from robacc.robots.description import Frame, Joint, Mimic, Robot
from robacc.robots.library import Reach, find_reach, low_discrepancy, summarise

PROJECT = Path(__file__).resolve().parents[2]
calls = (commands.output, commands.document, commands.refused)
show, document, refused = (partial(call, "show") for call in calls)
CONFIGS = PROJECT / "configs" / "robots"


def drawn(robot: Robot, width: int = 100) -> str:
    return "\n".join(line for line, _ in lines_of(robot_view(summarise(robot)), width))


def row(text: str, heading: str, name: str) -> list[str]:
    """The cells of the row ``name`` of the table under ``heading``."""
    lines = text[text.index(heading) :].splitlines()
    return next(line.split() for line in lines[1:] if line.split()[:1] == [name])


def test_table_is_in_millimetres_and_degrees() -> None:
    text = show("configs/robots/irb1600.yaml")
    assert text.startswith("ABB IRB 1600-x/1.45\nstandard DH: Rz(theta) Tz(d) Tx(a) Rx(alpha); 6 joints\n")
    rows = [row(text, *place) for place in (("Geometry", "j1"), ("Geometry", "j2"), ("Drives", "j3"))]
    geometry = [["j1", "q", "486.5", "150", "-90"], ["j2", "q", "-", "90", "0", "700", "0"]]
    assert rows == [*geometry, ["j3", "revolute", "-245", "65", "°", "+1", "-"]]
    told = ("payload  at (0, 0, 100) mm in the last link's frame", "masses   unknown", "effects  none")
    assert missing(text, *told, "\x1b") == ["\x1b"]


def test_json_is_the_contracts_and_nothing_else() -> None:
    path = CONFIGS / "stanford.yaml"
    result = commands.run("show", path, "--format", "json")
    assert (result.exit_code, result.stderr, str(PROJECT) in result.stdout) == (0, "", False)
    found = json.loads(result.stdout)
    robot = read_robot(path)
    assert {key: found[key] for key in ("schema", "inputs", "options", "n_joints")} == {
        "schema": "robacc.show/1",
        "inputs": [{"name": path.name, "sha256": sha256_of(path), "kind": "robot"}],
        "options": {"base_link": None, "tip_link": None},
        "n_joints": 6,
    }
    third = found["joints"][2]
    assert (third["type"], third["unit"], third["limits"]) == ("prismatic", "m", [0.3048, 1.27])
    assert third["parameters"] == pytest.approx(dict(robot.joints[2].parameters), rel=1e-11)
    assert found["moved_mass_kg"] == pytest.approx(9.29 + 5.01 + 4.25 + 1.08 + 0.63 + 0.51)
    assert set(found["reach"]) == {"tool"}


def test_exit_statuses() -> None:
    assert "error: nothing.yaml: the file does not exist" in refused("nothing.yaml", status=3)
    assert "choose a chain of a URDF" in refused("configs/robots/ur10.yaml", "--tip-link", "x")
    commands.refused("show")


def test_reach_of_arms_that_can_be_worked_out() -> None:
    # A SCARA stretched out: 0.8 m across; its hand lowest is 0.877 - 0.2 - 0.195 up, highest 0.677.
    scara = find_reach(read_robot(CONFIGS / "scara.yaml"), Frame())
    assert scara.sampled == pytest.approx(np.hypot(0.8, 0.677), abs=1e-6)
    # The bound knows no directions: (0.425, 0.877), (0.375), (slide 0.195 and hand 0.2 along one axis).
    assert scara.bound == pytest.approx(np.hypot(0.425, 0.877) + np.hypot(0.375, 0.195) + 0.2)
    # A slide counts with the end that lies farther out.
    slide = Joint("s", "prismatic", dict.fromkeys(("theta", "d", "a", "alpha"), 0.0), limits=(-0.3, 0.1))
    assert find_reach(Robot("r", "standard", (slide,)), Frame()) == Reach(0.3, 0.3)
    robot = read_robot(CONFIGS / "ur10.yaml")
    reach = find_reach(robot, Frame())
    # Against a search that shares nothing with it but the chain.
    q = np.random.default_rng(0).uniform(-np.pi, np.pi, (6, 20_000))
    found = np.linalg.norm(build_chain(robot).forward(q).translation, axis=0).max()
    assert found - 1e-3 < reach.sampled <= reach.bound


def test_reach_is_measured_from_the_robots_base_and_per_target() -> None:
    robot = read_robot(CONFIGS / "scara.yaml")
    moved = replace(robot, base=Frame((5.0, 0, 0)), targets={"a": Frame(), "b": Frame((0, 0, 0.1))})
    summary = summarise(moved)
    assert summary.reach["a"] == find_reach(robot, Frame())
    assert summary.reach["b"].sampled == pytest.approx(np.hypot(0.8, 0.577), abs=1e-6)
    assert missing(drawn(moved), "reach    b: 986 mm", "target   a: (0, 0, 0) mm, rpy (0, 0, 0)°") == []


def test_a_slide_without_limits_has_no_reach() -> None:
    robot = read_robot(CONFIGS / "stanford.yaml")
    robot = replace(robot, joints=tuple(replace(joint, limits=None) for joint in robot.joints))
    assert find_reach(robot, Frame()).sampled is None
    assert "reach    unknown: a prismatic joint has no limits" in drawn(robot)


@pytest.mark.parametrize("dimensions", [1, 2, 6, 12])
def test_samples_fill_the_cube_more_evenly_than_chance(dimensions: int) -> None:
    points = low_discrepancy(dimensions, 1000)
    assert points.shape == (dimensions, 1000)
    assert np.all((points >= 0) & (points < 1))
    # Twenty a bin; chance alone would scatter by 4.4.
    assert max(np.histogram(line, bins=50, range=(0, 1))[0].std() for line in points) < 2


def test_urdf_joints_are_shown_with_origin_axis_and_master() -> None:
    zero = dict.fromkeys(("x", "y", "z", "roll", "pitch", "yaw", "offset"), 0.0)
    joints = (
        Joint("stand", "fixed", zero | {"z": 0.5}),
        Joint(
            "turn",
            "revolute",
            zero | {"roll": np.pi / 2, "offset": 0.1},
            axis=(0.0, 1.0, 0.0),
            sign=-1,
            gear_ratio=80.0,
        ),
        Joint("copy", "revolute", zero, mimic=Mimic("turn", -2.0), mass=1.25, com=(0.1, 0.0, 0.0)),
    )
    effects = ({"effect": "backlash"}, {"effect": "gear_ratio"})
    text = drawn(Robot("u", "urdf", joints, base_link="foot", tip_link="hand", effects=effects))
    assert "URDF: T(x, y, z) Rz(yaw) Ry(pitch) Rx(roll), then the axis; 1 joint, foot to hand" in text
    for heading, cells in (
        ("Geometry", ["stand", "0", "0", "500", "0", "0", "0", "0", "fixed"]),
        ("Geometry", ["turn", "0", "0", "0", "90", "0", "0", "5.7296", "y"]),
        ("Drives", ["turn", "revolute", "-", "-", "°", "-1", "80"]),
        ("Drives", ["copy", "revolute", "-", "-", "°", "+1", "-", "-2", "x", "turn"]),
        ("Links", ["copy", "1.25", "100", "0", "0"]),
    ):
        assert row(text, heading, cells[0]) == cells
    assert "effects  backlash, gear_ratio" in text


def test_names_are_not_cut_in_a_narrow_terminal() -> None:
    assert "shoulder_lift_joint" in drawn(read_robot(CONFIGS / "ur10.yaml"), width=60)


def test_output_file_holds_what_standard_output_would(tmp_path: Path) -> None:
    words = ("configs/robots/ur10.yaml", "--format", "json")
    assert (show(*words, "--output", tmp_path / "out.json"), (tmp_path / "out.json").read_text()) == ("", show(*words))


BAD_EFFECTS = """  - {effect: wobble, joints: [shoulder]}
  - {effect: backlash, joints: [j7], values: {j7: 1}}
  - {effect: backlash, joints: [j1], values: }
  - {effect: backlash, joints: [j1], values: {j1: "1"}}
  - {effect: backlash, joints: [j1], size: 3, values: {j1: 1}}
  - {effect: backlash, joints: [j1]}
  - {effect: joint_offset, joints: [j1], values: {j1: 6.2}}
  - {effect: joint_offset, joints: [j1], values: {j1: 0.1}}
  - {effect: joint_offset, joints: [j2], values: {j2: 1e9}}
"""


def test_effects_that_no_command_could_apply_are_refused_with_their_lines(tmp_path: Path) -> None:
    path = tmp_path / "bad.yaml"
    text = (CONFIGS / "irb1600.yaml").read_text(encoding="utf-8")
    start = text.count("\n") + 2
    path.write_text(f"{text}effects:\n{BAD_EFFECTS}", encoding="utf-8")
    result = commands.run("show", path)
    assert (result.exit_code, result.stdout) == (3, "")
    told = [line.removeprefix(f"error: {path}:") for line in result.stderr.splitlines() if line.startswith("error")]
    expected = [
        "effects[0]: no effect 'wobble', did you mean 'axis_wobble'? The catalogue: base_frame",
        "effects[1]: joints must be a list of j1, j2",
        "effects[2]: values must be a mapping of name to number, found None",
        "effects[3]: values.j1 must be a finite number, found '1'",
        "effects[4]: backlash has no setting 'size'",
        "effects[5]: backlash[j1] has no values, so it would do nothing; write values: {name: number}",
        "effects[7]: repeats joint_offset[j1] of effects[6]; their values would add up",
        "effects[8]: values.j2 is more than a turn; expected a small angle, found 1e+09",
    ]
    for line, one in zip(told, expected, strict=True):
        number = start + int(one[len("effects[")])
        assert line.startswith(f"{number}, {one}")
    assert "tip: give one entry with the sum of the values" in result.stderr


def test_effects_are_shown_with_their_values() -> None:
    truth = "sample_data/trace/truth.yaml"
    assert "         joint_compliance.j2 = 8.72665e-07 rad/(N m)\n" in show(truth)
    found = document(truth)["robot"]["coefficients"]
    # The file has degrees.
    assert {"name": "backlash.j3", "value": pytest.approx(np.deg2rad(-0.009)), "unit": "rad"} in found


def test_numbers_of_a_wide_table_stay_whole(tmp_path: Path) -> None:
    origin = '<origin xyz="-0.61265292 -0.11586873 0.1639417" rpy="1.5707963 0.0049321 -0.0845777"/>'
    links = "".join(f'<link name="l{i}"/>' for i in range(4))
    joints = "".join(
        f'<joint name="shoulder_lift_joint_{i}" type="revolute"><parent link="l{i}"/><child link="l{i + 1}"/>{origin}'
        '<axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint>'
        for i in range(3)
    )
    path = tmp_path / "arm.urdf"
    path.write_text(f'<robot name="arm">{links}{joints}</robot>')
    lines = show(path).splitlines()
    assert max(map(len, lines)) <= 80
    words = [line.split() for line in lines]
    cells = [["-612.6529", "-115.8687", "163.9417"], ["90", "0.2826", "-4.8459", "z"]]
    assert missing(words, *(["shoulder_lift_joint_1", *numbers] for numbers in cells)) == []


def test_many_coefficients_are_counted(tmp_path: Path) -> None:
    entries = "".join(
        f"  - {{effect: transmission_error, joints: [j{i}], orders: [{', '.join(map(str, range(1, 25)))}], "
        f"values: {{{', '.join(f'j{i}.cos{n}: 1.0e-5' for n in range(1, 25))}}}}}\n"
        for i in (1, 2)
    )
    path = tmp_path / "arm.yaml"
    text = (PROJECT / "sample_data" / "robot.yaml").read_text()
    path.write_text(f"{text}\neffects:\n{entries}")
    output = show(path)
    assert "effects  transmission_error (2 entries)" in output
    shown = sum(line.lstrip().startswith("transmission_error.") for line in output.splitlines())
    (more,) = [line for line in output.splitlines() if "more coefficients" in line]
    assert more.split() == ["…", "and", str(48 - shown), "more", "coefficients,", "in", "the", "robot", "file"]
