"""Arms of the package: their robot files against URDFs, published tables and published reaches."""

import math
from pathlib import Path

import numpy as np
import pytest
from commands import output
from homogeneous import frame, shift, turn
from library_facts import URDF_FACTS, Facts, UrdfJoint
from robot_files import example_robots

import robacc
from robacc.errors import InputError
from robacc.geometry import rotation_from_rpy
from robacc.modelling.robot_file import find_arm, library, read_robot, robot_path, similar_arms
from robacc.robots.arm import build_chain
from robacc.robots.description import Frame
from robacc.robots.urdf import parse_urdf

KEYS = [arm["name"] for arm in library()]


def about(axis: str, angle: np.ndarray) -> np.ndarray:
    return turn("xyz".index(axis[-1]), -angle if axis[0] == "-" else angle)


def placed(joint: UrdfJoint) -> np.ndarray:
    return frame(joint.xyz, np.radians(joint.rpy))


def flange_poses(facts: Facts, q: np.ndarray) -> np.ndarray:
    """Return the flange's poses (N, 4, 4), mm, in the controller's base frame, at joints (J, N)."""
    angles = q.copy()
    angles[2] += facts.ratio * angles[1]
    pose = shift(z=-facts.base_height)
    for joint, angle in zip(facts.joints, angles, strict=True):
        pose = pose @ placed(joint) @ about(joint.axis, angle)
    return pose @ placed(facts.flange)


@pytest.mark.parametrize("key", URDF_FACTS)
def test_arms_are_those_of_their_urdf(key: str) -> None:
    facts = URDF_FACTS[key]
    robot = read_robot(key)
    q = np.random.default_rng(0).uniform(-2, 2, (len(facts.joints), 12))
    poses, expected = build_chain(robot).forward(q).matrices(), flange_poses(facts, q)
    np.testing.assert_allclose(poses[:, :3, 3] * 1e3, expected[:, :3, 3], atol=1e-9)
    np.testing.assert_allclose(poses[:, :3, :3], expected[:, :3, :3], atol=1e-12)


def reach_of(facts: Facts, robot: robacc.Robot) -> float:
    """Return the reach in mm from the facts: the point and the axis that the maker measures between."""
    (a1, _, _), (x, side, z) = facts.joints[1].xyz, facts.joints[2].xyz
    upper = x + z
    _, _, up = facts.joints[3].xyz
    along = facts.joints[3].xyz[0] + facts.joints[4].xyz[0]
    if facts.reach_of == "wrist":
        return a1 + upper + math.hypot(up, along)
    if facts.reach_of == "wrist along axis 4":
        return a1 + upper + abs(up)
    if facts.reach_of == "wrist within limits":
        # The second joint's limit keeps the arm from lying flat: stretch the forearm at that limit.
        end = (robot.joints[1].limits or (0.0, 0.0))[1]
        return a1 + upper * math.sin(end) + math.hypot(up, along)
    if facts.reach_of == "shoulder to flange":
        return sum(abs(value) for joint in facts.joints[2:] for value in joint.xyz)
    lateral = abs(side) if facts.reach_of == "flange" and not facts.joints[4].xyz[1] else abs(facts.joints[4].xyz[1])
    forward = a1 + upper + facts.joints[4].xyz[0] + facts.joints[4].xyz[2]
    forward += facts.joints[5].xyz[0] + facts.flange.xyz[2]
    return math.hypot(forward, lateral) if facts.ratio else forward


@pytest.mark.parametrize("key", [key for key, facts in URDF_FACTS.items() if facts.reach is not None])
def test_reach_is_the_published_one(key: str) -> None:
    # KUKA's large arms cannot lie flat either and are published up to 5 mm shorter; ABB rounds to a centimetre.
    facts = URDF_FACTS[key]
    assert reach_of(facts, read_robot(key)) == pytest.approx(facts.reach, abs=5.0 if key[:2] in ("kr", "ir") else 1.5)
    assert next(arm for arm in library() if arm["name"] == key)["reach_m"] * 1e3 == pytest.approx(facts.reach)


# UFACTORY publishes two tables. The files hold the standard one; this is the modified one: alpha, a, theta, d; mm, deg.
TWIST, LONG = math.degrees(math.atan2(284.5, 53.5)), math.hypot(284.5, 53.5)
FORE, FORE_LENGTH = math.degrees(math.atan2(342.5, 77.5)), math.hypot(77.5, 342.5)
MODIFIED = {
    "xarm5_lite": [
        (0, 0, 0, 267),
        (-90, 0, -TWIST, 0),
        (0, LONG, TWIST + FORE, 0),
        (0, FORE_LENGTH, -FORE, 0),
        (-90, 76, 0, 97),
    ],
    "xarm6": [
        (0, 0, 0, 267),
        (-90, 0, -TWIST, 0),
        (0, LONG, TWIST, 0),
        (-90, 77.5, 0, 342.5),
        (90, 0, 0, 0),
        (-90, 76, 0, 97),
    ],
    "xarm7": [
        (0, 0, 0, 267),
        (-90, 0, 0, 0),
        (90, 0, 0, 293),
        (90, 52.5, 0, 0),
        (90, 77.5, 0, 342.5),
        (90, 0, 0, 0),
        (-90, 76, 0, 97),
    ],
    "lite6": [
        (0, 0, 0, 243.3),
        (-90, 0, -90, 0),
        (180, 200, -90, 0),
        (90, 87, 0, 227.6),
        (90, 0, 0, 0),
        (-90, 0, 0, 61.5),
    ],
}


@pytest.mark.parametrize("key", MODIFIED)
def test_arms_agree_with_the_makers_other_table(key: str) -> None:
    rows = np.array(MODIFIED[key], dtype=float)
    q = np.random.default_rng(1).uniform(-2, 2, (len(rows), 10))
    expected = np.eye(4)
    for (alpha, a, theta, d), angle in zip(rows, q, strict=True):
        expected = (
            expected @ shift(a) @ turn(0, math.radians(alpha)) @ shift(z=d) @ turn(2, angle + math.radians(theta))
        )
    poses = build_chain(read_robot(key)).forward(q).matrices()
    np.testing.assert_allclose(poses[:, :3, 3] * 1e3, expected[:, :3, 3], atol=1e-6)
    np.testing.assert_allclose(poses[:, :3, :3], expected[:, :3, :3], atol=1e-9)


@pytest.mark.parametrize(
    ("key", "heights"), [("lbr_iiwa_7_r800", (340, 740, 1140)), ("lbr_iiwa_14_r820", (360, 780, 1180))]
)
def test_iiwa_axes_are_those_measured_from_the_makers_cad(key: str, heights: tuple[float, float, float]) -> None:
    # explicit-robotics.github.io, kuka_LBR_iiwa7 and 14: axes 2, 4, 6 along y, -y, y at these heights, the others up.
    chain = build_chain(read_robot(key))
    jacobian = chain.jacobian(np.zeros((7, 1)), list(chain.joint_axis))[..., 0]
    expected = np.array([[0, 0, 1], [0, 1, 0], [0, 0, 1], [0, -1, 0], [0, 0, 1], [0, 1, 0], [0, 0, 1]]).T
    np.testing.assert_allclose(jacobian[3:], expected, atol=1e-12)
    top = chain.forward(np.zeros((7, 1))).translation[2, 0]
    # A turn about an axis along ±y at height h moves the flange by ±(top - h) along x.
    np.testing.assert_allclose(top - jacobian[0, [1, 3, 5]] * [1, -1, 1], np.array(heights) * 1e-3, atol=1e-12)


EXAMPLES = [
    ("ur3", "ur_description/urdf/ur3_robot.urdf", "tool0", 180.0),
    ("ur5", "ur_description/urdf/ur5_robot.urdf", "tool0", 180.0),
    ("ur10", "ur_description/urdf/ur10_robot.urdf", "tool0", 180.0),
    ("panda", "panda_description/urdf/panda.urdf", "panda_link8", 0.0),
    ("xarm7", "xarm_description/urdf/xarm7.urdf", "link_eef", 0.0),
]


@pytest.mark.parametrize(("key", "urdf", "tip", "yaw"), EXAMPLES, ids=[row[0] for row in EXAMPLES])
def test_arms_agree_with_example_robot_data(key: str, urdf: str, tip: str, yaw: float) -> None:
    theirs = parse_urdf((example_robots() / urdf).read_text(), urdf, None, tip)
    q = np.random.default_rng(1).uniform(-2, 2, (len(theirs.variables), 20))
    position = (
        rotation_from_rpy(np.array([0, 0, math.radians(yaw)])) @ build_chain(read_robot(key)).forward(q).translation
    )
    # These URDFs are rounded to 0.1 mm and 1e-5 rad.
    np.testing.assert_allclose(position, build_chain(theirs).forward(q).translation, atol=8e-4)


# Second sources of the e-series, in m: d1, a2, a3, d4, d5, d6. UR3e, UR5e: a package of tables; UR5e, UR10e:
# link frames of NVIDIA's assets; UR16e, UR20: tables of two other controllers' kinematics.
SECOND_SOURCES = {
    "ur3e": (0.15185, -0.24355, -0.2132, 0.13105, 0.08535, 0.0921),
    "ur5e": (0.1625, -0.425, -0.3922, 0.1333, 0.0997, 0.0996),
    "ur10e": (0.1807, -0.6127, -0.57155, 0.17415, 0.11985, 0.11655),
    "ur16e": (0.1807, -0.4784, -0.36, 0.17415, 0.11985, 0.11655),
    "ur20": (0.2363, -0.8620, -0.7287, 0.201, 0.1593, 0.1543),
}


@pytest.mark.parametrize("key", SECOND_SOURCES)
def test_universal_robots_tables_agree_with_a_second_source(key: str) -> None:
    p = [joint.parameters for joint in read_robot(key).joints]
    numbers = (p[0]["d"], p[1]["a"], p[2]["a"], p[3]["d"], p[4]["d"], p[5]["d"])
    assert numbers == pytest.approx(SECOND_SOURCES[key], abs=1e-12)
    assert [row["alpha"] for row in p] == pytest.approx([math.pi / 2, 0, 0, math.pi / 2, -math.pi / 2, 0])


@pytest.mark.parametrize("key", [arm["name"] for arm in library() if "computed" in arm["source"]])
def test_computed_reach_is_the_greatest_distance_from_axis_1(key: str) -> None:
    facts, robot = URDF_FACTS[key], read_robot(key)
    low, high = np.array([joint.limits or (-math.pi, math.pi) for joint in robot.joints]).T
    foot = facts.joints[0].xyz

    def distance(q: np.ndarray) -> np.ndarray:
        place = flange_poses(facts, q)[:, :3, 3]
        return np.hypot(place[:, 0] - foot[0], place[:, 1] - foot[1])

    trials = np.random.default_rng(0).uniform(low[:, None], high[:, None], (low.size, 5000))
    q = trials[:, np.argsort(distance(trials))[-1:]]
    for joint in list(range(low.size)) * 12:
        trials = np.repeat(q, 2001, axis=1)
        trials[joint, 1:] = np.linspace(low[joint], high[joint], 2000)
        q = trials[:, [int(np.argmax(distance(trials)))]]
    reach = next(arm for arm in library() if arm["name"] == key)["reach_m"]
    assert float(distance(q)[0]) == pytest.approx(1e3 * reach, abs=0.6)


def test_the_scara_stretched_is_the_books() -> None:
    # Schilling, p_z = d1 - q3 - d4: 877 - 100 - 200 mm, at a reach of 425 + 375 mm.
    pose = build_chain(read_robot("adept_one")).forward(np.array([[0.0], [0.0], [0.1], [0.0]]))
    np.testing.assert_allclose(pose.translation[:, 0], [0.8, 0, 0.577], atol=1e-12)


def test_every_file_is_in_the_list_with_its_source() -> None:
    assert len(KEYS) >= 50
    assert sorted(path.stem for path in library()[0]["path"].parent.glob("*.yaml")) == sorted(KEYS)
    for arm in library():
        robot = read_robot(arm["path"])
        text = arm["path"].read_text(encoding="utf-8")
        assert (robot.name, len(robot.variables)) == (f"{arm['maker']} {arm['model']}", arm["n_axes"])
        assert "# Source: " in text
        assert "# Base: " in text
        # Base, targets and effects are left to the user.
        assert (robot.base, robot.targets, robot.effects) == (Frame(), {}, ())
        # The longest stretch to the flange is at least the published reach of the wrist, but for limits and heights.
        assert 0.95 * arm["reach_m"] < robacc_reach(robot) < 2.1 * arm["reach_m"], arm["name"]


def robacc_reach(robot: robacc.Robot) -> float:
    """Return the sum of the lengths in m."""
    table = [math.hypot(joint.parameters["a"], joint.parameters["d"]) for joint in robot.joints]
    return sum(table) + math.hypot(*robot.tool.xyz)


@pytest.mark.parametrize("name", ["ur10e", "UR10e", "Universal Robots UR10e", "kr6_r900_sixx", "KR 6 R900 sixx"])
def test_names_of_an_arm(name: str) -> None:
    arm = find_arm(name)
    assert read_robot(name).name == f"{arm['maker']} {arm['model']}"
    assert robot_path(name) == str(arm["path"])


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("kr6", r"neither a file nor an arm of the package.*did you mean kr6_r700_2 or kr6_r9"),
        ("ur10ee", r"did you mean .*ur10e"),
        ("qqqq", "robacc show robots lists the arms"),
        ("ur10e.yaml", "the file does not exist"),
    ],
)
def test_unknown_and_ambiguous_names_get_suggestions(name: str, message: str) -> None:
    with pytest.raises(InputError, match=message):
        read_robot(name)


def test_a_file_comes_before_an_arm_of_its_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert find_arm("irb1200") is None
    assert set(similar_arms("irb1200")) == {"irb1200_5_90", "irb1200_7_70"}
    monkeypatch.chdir(tmp_path)
    Path("ur10e").write_text(find_arm("ur5")["path"].read_text())  # type: ignore[index]
    assert read_robot("ur10e").name == "Universal Robots UR5"


def test_calls_take_a_name() -> None:
    made = robacc.simulate("ur10e", poses=20, noise="0.05mm", seed=1)
    found = robacc.estimate(made.data, robot="ur10e")
    assert found.position.rms < 2e-4
    record = next(file for file in found.document()["inputs"] if file["kind"] == "robot")
    assert record["name"] == "ur10e"
    assert len(record["sha256"]) == 64


def test_init_writes_a_copy_with_its_comments(tmp_path: Path) -> None:
    output("init", "KR 6 R900 sixx", "--folder", tmp_path)
    arm = find_arm("kr6_r900_sixx")
    assert (tmp_path / "robot.yaml").read_text(encoding="utf-8") == arm["path"].read_text(encoding="utf-8")
    robot = read_robot(tmp_path / "robot.yaml")
    found = robacc.estimate(tmp_path / "poses.csv", robot=robot, align=("base_frame", "tool_frame"))
    assert found.position.rms < 1e-2
