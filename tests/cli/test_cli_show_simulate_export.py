"""`robacc show`, `simulate`, `export` and `init --from` on the command line."""

import dataclasses
import hashlib
import re
import shlex
from dataclasses import replace
from pathlib import Path

import commands
import numpy as np
import pytest
from commands import document, missing, one_line, output, refused, run
from sample_files import (
    CONFIGS,
    POSES,
    PUMA,
    ROBOT,
    ROOT,
    SAMPLES,
    SCARA,
    TRACED_POSES,
    TRACED_ROBOT,
    TRUTH,
    UR10,
    agreed,
    saved,
)

from robacc.documents.descriptions import SHOW
from robacc.modelling.model import predict
from robacc.modelling.robot_file import read_robot
from robacc.poses.csv_file import read_poses
from robacc.poses.reading import KnownRobot
from robacc.render.text import lines_of
from robacc.render.views.robot import robot_view
from robacc.robots.arm import build_chain, find_reach, summarise
from robacc.robots.description import Frame, Joint, Mimic, Robot
from robacc.robots.yaml_robot import robot_to_yaml

# ``robacc show``: its figures, its table, its JSON, its exit statuses.

_, show, shown, _ = commands.calls_of("show")


def drawn(robot: Robot, width: int = 100) -> str:
    return "\n".join(line for line, _ in lines_of(robot_view(robot, SHOW.write(robot, **summarise(robot))), width))


AT_REST = dict.fromkeys(("x", "y", "z", "roll", "pitch", "yaw", "offset"), 0.0)
ALL_OF_URDF = Robot(
    "u",
    "urdf",
    (
        Joint("stand", "fixed", AT_REST | {"z": 0.5}),
        Joint(
            "turn", "revolute", AT_REST | {"roll": np.pi / 2, "offset": 0.1}, (0.0, 1.0, 0.0), sign=-1, gear_ratio=80.0
        ),
        Joint("copy", "revolute", AT_REST, mimic=Mimic("turn", -2.0), mass=1.25, com=(0.1, 0.0, 0.0)),
    ),
    base_link="foot",
    tip_link="hand",
    effects=tuple({"effect": e, "joints": ["turn"], "values": {"turn": 1e-4}} for e in ("backlash", "gear_ratio")),
)
ORIGIN = '<origin xyz="-0.61265292 -0.11586873 0.1639417" rpy="1.5707963 0.0049321 -0.0845777"/>'
WIDE = "".join(f'<link name="l{i}"/>' for i in range(4)) + "".join(
    f'<joint name="shoulder_lift_joint_{i}" type="revolute"><parent link="l{i}"/><child link="l{i + 1}"/>{ORIGIN}'
    '<axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint>'
    for i in range(3)
)
MANY = "\neffects:\n" + "".join(
    f"  - {{effect: transmission_error, joints: [j{i}], orders: [{', '.join(map(str, range(1, 25)))}], "
    f"values: {{{', '.join(f'j{i}.cos{n}: 1.0e-5' for n in range(1, 25))}}}}}\n"
    for i in (1, 2)
)


def test_arms_are_shown_in_millimetres_and_degrees(tmp_path: Path) -> None:
    """Names and numbers are whole in narrow terminals and wide tables; many coefficients are counted."""
    wide = show(saved(tmp_path / "arm.urdf", f'<robot name="arm">{WIDE}</robot>'))
    assert max(map(len, wide.splitlines())) <= 80
    shown = [show("configs/robots/irb1600.yaml"), drawn(ALL_OF_URDF), drawn(read_robot(UR10), width=60), show(TRUTH)]
    shown += [wide, show(saved(tmp_path / "arm.yaml", ROBOT.read_text() + MANY)).partition("effects")[2]]
    assert "\n\n".join(shown) == agreed("show.txt", "\n\n".join(shown))


def test_effects_have_their_values_in_si() -> None:
    found = shown("sample_data/trace/truth.yaml")["robot"]["coefficients"]
    # The file has degrees.
    assert {"name": "backlash.j3", "value": pytest.approx(np.deg2rad(-0.009)), "unit": "rad"} in found


def test_reach_of_arms_that_can_be_worked_out() -> None:
    # A SCARA stretched out: 0.8 m across; its hand lowest is 0.877 - 0.2 - 0.195 up, highest 0.677.
    scara = find_reach(read_robot(CONFIGS / "scara.yaml"), Frame())
    assert scara["sampled_m"] == pytest.approx(np.hypot(0.8, 0.677), abs=1e-6)
    # The bound knows no directions: (0.425, 0.877), (0.375), (slide 0.195 and hand 0.2 along one axis).
    assert scara["bound_m"] == pytest.approx(np.hypot(0.425, 0.877) + np.hypot(0.375, 0.195) + 0.2)
    # A slide counts with the end that lies farther out.
    slide = Joint("s", "prismatic", dict.fromkeys(("theta", "d", "a", "alpha"), 0.0), limits=(-0.3, 0.1))
    assert find_reach(Robot("r", "standard", (slide,)), Frame()) == {"sampled_m": 0.3, "bound_m": 0.3}
    robot = read_robot(CONFIGS / "ur10.yaml")
    reach = find_reach(robot, Frame())
    # Against a search that shares nothing with it but the chain.
    q = np.random.default_rng(0).uniform(-np.pi, np.pi, (6, 20_000))
    found = np.linalg.norm(build_chain(robot).forward(q).translation, axis=0).max()
    assert found - 1e-3 < reach["sampled_m"] <= reach["bound_m"]


def test_reach_is_measured_from_the_robots_base_and_per_target() -> None:
    robot = read_robot(CONFIGS / "scara.yaml")
    moved = replace(robot, base=Frame((5.0, 0, 0)), targets={"a": Frame(), "b": Frame((0, 0, 0.1))})
    reach = summarise(moved)["reach"]
    assert reach["a"] == find_reach(robot, Frame())
    assert reach["b"]["sampled_m"] == pytest.approx(np.hypot(0.8, 0.577), abs=1e-6)
    assert missing(drawn(moved), "reach    b: 986 mm", "target   a: (0, 0, 0) mm, rpy (0, 0, 0)°") == []


def test_a_slide_without_limits_has_no_reach() -> None:
    robot = read_robot(CONFIGS / "stanford.yaml")
    robot = replace(robot, joints=tuple(replace(joint, limits=None) for joint in robot.joints))
    assert find_reach(robot, Frame())["sampled_m"] is None
    assert "reach    unknown: a prismatic joint has no limits" in drawn(robot)


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
    text = (CONFIGS / "irb1600.yaml").read_text(encoding="utf-8")
    start = text.count("\n") + 2
    path = saved(tmp_path / "bad.yaml", f"{text}effects:\n{BAD_EFFECTS}")
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


# ``robacc simulate``, ``robacc show effects``, ``export`` and ``init --from`` from the command line.


@pytest.mark.parametrize("motion", [(), ("--no-motion",)])
def test_what_simulate_writes_reads_back_to_the_last_digit(motion: tuple[str, ...], tmp_path: Path) -> None:
    path, call = tmp_path / "poses.csv", ("simulate", TRUTH, "--poses", 30, "--seed", 4, *motion)
    output(*call, "-o", path)
    # The columns left out, the order of rows gives the same prediction: backlash of the third joint included.
    data = read_poses(path, robot=KnownRobot(joint_names=read_robot(TRUTH).variable_names), ordered=bool(motion))
    assert data.n == 30
    np.testing.assert_array_equal(data.position, predict(read_robot(TRUTH), data).translation)
    assert output(*call) == path.read_text(encoding="utf-8")


def test_options_become_columns() -> None:
    arguments = ("--poses", 4, "--cycles", 2, "--noise", "20um", "--noise-orientation", "0.001deg", "--sigma")
    more = ("--commanded", "--time-step", 30, "--temperature", "22:28", "--payload", "0,2", "--sampling", "random")
    header = run("simulate", PUMA, *arguments, *more).stdout.splitlines()[1].split(",")
    columns = "cmd_x cmd_qw sigma_x sigma_r time_s temperature_c payload_kg dir_q1 speed_q6 pose cycle qw"
    assert missing(header, *columns.split()) == []
    header = run("simulate", PUMA, "--poses", 4, "--position-only", "--no-motion").stdout.splitlines()[1]
    assert header == "q1,q2,q3,q4,q5,q6,x,y,z,pose"


def test_noise_comes_in_the_unit_behind_it() -> None:
    none, zero, um, mm, m = (
        [line.split(",")[6] for line in output("simulate", PUMA, "--poses", 3, *options).splitlines()[2:]]
        for options in ((), *(("--noise", size) for size in ("0", "20um", "0.02mm", "2e-5m")))
    )
    assert none == zero != um == mm == m


@pytest.mark.parametrize(
    ("options", "end"),
    [
        ("", " with seed 0, no noise; nothing was measured."),
        ("--noise 20um --noise-orientation 0.02mrad", ", noise 0.02 mm and 0.02 mrad; nothing was measured."),
        ("--noise 20um --noise-orientation 0.02mrad --position-only", ", noise 0.02 mm; nothing was measured."),
    ],
)
def test_the_file_says_what_noise_is_in_it(options: str, end: str) -> None:
    assert output("simulate", PUMA, "--poses", 3, *options.split()).splitlines()[0].endswith(end)


def test_a_plan_names_no_target_and_all_are_measured_at_each_of_its_poses(tmp_path: Path) -> None:
    robot = dataclasses.replace(read_robot(PUMA), targets={"a": Frame((0.05, 0.0, 0.1)), "b": Frame((0.0, 0.05, 0.1))})
    file, plan, poses = tmp_path / "robot.yaml", tmp_path / "plan.csv", tmp_path / "poses.csv"
    file.write_text(robot_to_yaml(robot), encoding="utf-8")
    plan.write_text("q1,q2,q3,q4,q5,q6\n0.1,0.2,0.3,0.4,0.5,0.6\n0.2,0.2,0.3,0.4,0.5,0.6\n", encoding="utf-8")
    output("simulate", file, "--at", plan, "-o", poses)
    data = read_poses(poses)
    assert (data.target.tolist(), data.q[0].tolist()) == (["a", "b", "a", "b"], [0.1, 0.1, 0.2, 0.2])


def test_outliers_are_named_by_the_file_s_lines(tmp_path: Path) -> None:
    path = tmp_path / "poses.csv"
    arguments = ("simulate", PUMA, "--poses", 20, "--outliers", 2, "--outlier-size", "3mm")
    found = document(*arguments, "-o", path)
    assert (found["schema"], found["n_poses"], found["seed"]) == ("robacc.simulate/1", 20, 0)
    assert found["file_sha256"] == hashlib.sha256(path.read_bytes()).hexdigest()
    head = path.read_text(encoding="utf-8").splitlines()[1]
    assert head == f"# Outliers on lines {', '.join(map(str, found['outlier_lines']))}"
    data = read_poses(path)
    off = np.linalg.norm(data.position - predict(read_robot(PUMA), data).translation, axis=0)
    assert [data.line(i) for i in np.flatnonzero(off > 1e-3)] == found["outlier_lines"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--noise", "2cm"), "--noise: expected a number with a unit (m, mm, um), found '2cm'"),
        (("--noise", "0.02"), "--noise: '0.02' has no unit; add a unit (m, mm, um), for example 0.02mm"),
        (("--noise-orientation", "1e-4"), "--noise-orientation: '1e-4' has no unit; add a unit (rad, mrad,"),
        (("--outlier-size", "3"), "--outlier-size: '3' has no unit"),
        (("--noise", "-1mm"), "--noise: expected a size that is not negative, found '-1mm'"),
        (("--noise-orientation", "x"), "--noise-orientation: expected a number with a unit (rad, mrad, urad, deg)"),
        (("--temperature", "warm"), "--temperature: expected numbers separated by ':', found 'warm'"),
        (("--temperature", "1:2:3"), "--temperature: expected a number, or two such as 22:28, found '1:2:3'"),
        (("--payload", "1,x"), "--payload: expected numbers separated by ',', found '1,x'"),
        (("--payload", "1,-2"), "--payload: expected masses of at least 0 kg, found -2"),
        (("--sigma",), "--sigma needs --noise above zero, and --noise-orientation unless --position-only"),
        (("--outliers", "9"), "9 outliers are more than the 5 rows"),
        (("--format", "json"), "--format json needs --output, the CSV that it describes"),
    ],
)
def test_each_wrong_option_has_its_message(arguments: tuple[str, ...], message: str) -> None:
    assert message in refused("simulate", PUMA, "--poses", 5, *arguments)


def test_a_robot_that_lacks_something_is_named(tmp_path: Path) -> None:
    path = saved(tmp_path / "robot.yaml", SCARA.read_text(encoding="utf-8").replace("limits: [0, 195]", ""))
    assert "the prismatic joint j3 has no limits" in refused("simulate", path, "--poses", 3, status=3)
    entry = "effects: [{effect: frame_drift, values: {x: 1e-4}}]\n"
    path.write_text(PUMA.read_text(encoding="utf-8") + entry, encoding="utf-8")
    told = ("frame_drift needs the column time_s", "--time-step, --temperature and --payload add such columns")
    assert missing(refused("simulate", path, "--poses", 3), *told) == []


def documented_commands() -> list[str]:
    return re.findall(r"^robacc simulate .*$", (SAMPLES / "README.md").read_text(encoding="utf-8"), re.MULTILINE)


@pytest.mark.parametrize("command", documented_commands())
def test_sample_data_are_what_their_readme_says(command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    *arguments, target = shlex.split(command)[1:]
    monkeypatch.chdir(ROOT)
    output(*arguments, tmp_path / "poses.csv")
    robot = read_robot(ROOT / arguments[1])
    again = read_poses(tmp_path / "poses.csv", robot=KnownRobot(joint_names=robot.variable_names))
    stored = read_poses(ROOT / target, robot=KnownRobot(joint_names=robot.variable_names))
    # Not the bytes: another machine's mathematical library may round a sine the other way.
    np.testing.assert_allclose(again.position, stored.position, rtol=0, atol=1e-12)
    np.testing.assert_array_equal(again.q, stored.q)


def test_every_file_of_the_sample_data_has_a_line_in_their_readme() -> None:
    text = (SAMPLES / "README.md").read_text(encoding="utf-8")
    files = [path.relative_to(SAMPLES) for path in SAMPLES.rglob("*") if path.is_file() and path.name != "README.md"]
    assert len(files) > 6
    for path in files:
        assert f"| `{path.as_posix()}` |" in text, path
    assert len(documented_commands()) == 3


def test_one_effect_in_detail_and_one_that_is_none() -> None:
    text = run("show", "effects", "backlash", "--robot", PUMA).stdout
    told = ("{effect: backlash, joints: [j2], values: {j2: -1e-4}}", "applicable to j1, j2, j3, j4, j5, j6")
    assert missing(text, *told, "backlash.j2 (rad)", "Ruderman") == []
    assert "36 more" in run("show", "effects", "joint_correction", "--robot", PUMA).stdout


def test_what_is_offered_for_a_robot_and_its_poses() -> None:
    def offers(*options: object) -> dict[str, str | None]:
        found = document("show", "effects", *options)
        assert all(effect["offered"] == (effect["why"] is None) for effect in found["effects"])
        return {effect["name"]: effect["why"] for effect in found["effects"]}

    robot = offers("--robot", SCARA)
    without = {"joint_hardening", "friction_windup", "compliance_variation"}  # the file has no masses
    assert {name: why for name, why in robot.items() if why} == dict.fromkeys(without, "no masses in the robot file")
    both = offers("--robot", TRACED_ROBOT, "--poses", TRACED_POSES)
    expected = {"payload_compliance": "no payload_kg column", "frame_drift": "no time_s column that varies"}
    assert both | expected | {"backlash": None} == both
    no_motion = ("--robot", ROBOT, "--poses", POSES)
    assert offers(*no_motion)["approach_lag"] == "no speed_q columns, and `ordered` is not set"
    assert offers(*no_motion, "--ordered")["approach_lag"] is None
    text = run("show", "effects", "--robot", SCARA).stdout
    assert "not applicable: no masses in the robot file" in one_line(text)


def test_export_to_standard_output_is_the_urdf_and_nothing_else() -> None:
    result = run("export", PUMA, "--urdf", "-")
    assert re.fullmatch(r"<\?xml.*</robot>\s*", result.stdout, re.DOTALL)
    assert "warning: a URDF cannot represent gear ratio" in result.stderr


CONF = ROOT / "tests" / "plugins" / "samples" / "calibration.conf"


def test_an_arm_of_universal_robots_goes_to_its_controller(tmp_path: Path) -> None:
    conf = tmp_path / "new.conf"
    for model, name in ((UR10, "ur10"), ("ur10e", "ur10e"), ("ur3", "ur3")):
        result = run("export", model, "--output", conf)
        note = f"note: format ur-calibration, which the controller of a {name} reads; --format names another\n"
        assert (result.exit_code, result.stderr) == (0, note)
        assert result.stdout.startswith(f"Export as ur-calibration of {name}\n")
        assert "delta_theta" in conf.read_text(encoding="ascii")


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("show",), "Missing argument"),
        (("show", UR10, "--tip-link", "x"), "choose a chain of a URDF"),
        (("show", "effects", "backlsh"), "no effect 'backlsh', did you mean 'backlash'?"),
        (
            ("show", "effects", "--poses", POSES),
            "--poses, --ordered, --ignore-limits, --base-link and --tip-link need --robot",
        ),
        (("simulate", PUMA, "--poses", 0), "Invalid value for '--poses'"),
        (
            ("export", PUMA, "--urdf", "-", "--format", "json"),
            "--format json and --urdf - both write to standard output; name a file for --urdf",
        ),
        (("export", PUMA, "-o", "-"), "name the format of the file with --format: joint-offsets, json"),
        (("export", UR10, "--format", "mdh"), "name the file to write with --output"),
        (("export", UR10, "--format", "mdh", "--urdf", "-"), "--urdf writes a URDF, --format mdh another file"),
        (("export", UR10, "--format", "mdh", "-o", "-", "--arm", "ur5"), "--arm belongs to --format ur-calibration"),
        (("export", UR10, "--format", "ur-calibration", "-o", "-", "--arm", "x"), "no arm 'x' of Universal Robots"),
        (("export", UR10, "--format", "mdh", "-o", "-", "--template", CONF), "--template belongs to"),
        (("export", UR10, "--format", "mdh", "-o", "-", "--nominal", UR10), "--nominal belongs to"),
        (("init", "--from", CONF, "-o", "-"), "does not say which arm it belongs to"),
    ],
)
def test_wrong_usage_is_explained(words: tuple[object, ...], message: str) -> None:
    assert message in refused(*words)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("show", "nothing.yaml"), "error: nothing.yaml: the file does not exist"),
        (("export", PUMA, "--urdf", "no/x.urdf"), "its folder does not exist"),
    ],
)
def test_files_that_are_not_there_are_named(words: tuple[object, ...], message: str) -> None:
    assert message in refused(*words, status=3)
