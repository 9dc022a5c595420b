"""Mistakes of data: units, signs, parts, rows, frames that moved, another arm."""

import dataclasses
import re
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import independent_arm
import numpy as np
import pytest
from arms import CONFIGURED, arm
from commands import one_line
from results import run
from scipy.spatial.transform import Rotation

import robacc
from robacc import InputError, Measurements, Robot, read_robot
from robacc.diagnostics.data_mistakes import Mistake, check_data, find_mistake, registered_poses
from robacc.effects.specification import build, parse_requests
from robacc.fitting.fit_result import Fit, Options
from robacc.fitting.solver import fit
from robacc.fitting.warnings import fit_warnings, lack_of_fit, moved_frames, suspected_mistakes
from robacc.geometry import exp_so3, quaternion_from_rotation, rotate, rotation_about, rotation_from_quaternion
from robacc.modelling.model import Model, predict
from robacc.poses.csv_file import read_poses
from robacc.robots.description import Frame
from robacc.simulation.simulate import Plan, simulate
from robacc.tracing.trace import trace

ERRORS = (
    {"effect": "joint_offset", "joints": ["j2", "j3"], "values": {"j2": 2e-3, "j3": -1e-3}},
    {"effect": "backlash", "joints": ["j2"], "values": {"j2": 2e-4}},
)
"""Errors of a real arm: three millimetres, which is no mistake."""


@cache
def good(orientation: bool = True) -> Measurements:
    plan = Plan(30, seed=6, noise_position=5e-5, noise_orientation=1e-4, orientation=orientation)
    robot = dataclasses.replace(
        arm("puma560").robot, effects=ERRORS, base=Frame((2.0, -3.0, 0.5), (0.3, -0.7, 2.9)), tool=Frame((0, 0.05, 0.1))
    )
    return simulate(robot, plan).data


def joints(
    change: Callable[[np.ndarray], np.ndarray], row: int | list[int] | None = None
) -> Callable[[Measurements], Measurements]:
    def changed(data: Measurements) -> Measurements:
        q = data.q.copy()
        at = slice(None) if row is None else row
        q[at] = change(q[at])
        return dataclasses.replace(data, q=q)

    return changed


def position(change: Callable[[np.ndarray], np.ndarray]) -> Callable[[Measurements], Measurements]:
    """Of the positions alone, as a wrong export has them."""
    return lambda data: dataclasses.replace(data, position=change(data.position))


MISTAKES = {
    "sign of j3": (joints(np.negative, 2), "the sign of joint j3 seems to be reversed"),
    "sign of j6": (joints(np.negative, 5), "the sign of joint j6 seems to be reversed"),
    "degrees": (joints(np.rad2deg), "the joint columns seem to be in degrees"),
    "one in degrees": (joints(np.rad2deg, 1), "the column of joint j2 seems to be in degrees"),
    "mm": (position(lambda p: 1e3 * p), "the positions seem to be in millimetres"),
    "um": (position(lambda p: 1e6 * p), "the positions seem to be in micrometres"),
    "mirrored": (position(lambda p: p * [[1], [-1], [1]]), "the column y seems to have a reversed sign"),
    "x and z": (position(lambda p: p[::-1]), "the columns x and z seem to be exchanged"),
    "q2 and q5": (joints(lambda two: two[::-1], [1, 4]), "the columns of joints j2 and j5 seem to be exchanged"),
    "q5 and q6": (joints(lambda two: two[::-1], [4, 5]), "the columns of joints j5 and j6 seem to be exchanged"),
}
REFUSED = [
    (joints(lambda q: np.roll(q, -1, axis=1)), "^the measured poses seem to be shifted by one row down against"),
    (joints(lambda q: np.roll(q, 1, axis=1)), "^the measured poses seem to be shifted by one row up against"),
    (MISTAKES["sign of j3"][0], "^the sign of joint j3 seems to be reversed: with base and tool registered, the .* mm"),
    # The file holds x, y, z, w under the names qw, qx, qy, qz.
    (
        lambda data: dataclasses.replace(
            data, rotation=rotation_from_quaternion(np.roll(quaternion_from_rotation(data.rotation), -1, axis=0))
        ),
        "the quaternions seem to be in the order x, y, z, w",
    ),
]


@pytest.mark.parametrize(("change", "message"), REFUSED)
def test_a_mistake_is_refused_before_a_search(change: Callable[[Measurements], Measurements], message: str) -> None:
    with pytest.raises(InputError, match=message):
        trace(Model.of(arm("puma560").robot), change(good()))


CASES = [(which, False) for which in MISTAKES] + [(which, True) for which in ("sign of j6", "mirrored", "x and z")]


@pytest.mark.parametrize(("which", "orientation"), CASES)
def test_each_mistake_is_named(which: str, orientation: bool) -> None:
    change, name = MISTAKES[which]
    if not orientation and which in ("mirrored", "x and z"):
        name = "the positions seem to be in a left-handed frame"
    mistake = find_mistake(arm("puma560").robot, change(good(orientation)))
    assert mistake.name == name
    assert mistake.after < mistake.before / 8
    assert mistake.text.startswith(f"{name}: with base and tool registered, the median error is ")


@pytest.mark.parametrize(("name", "other"), [("panda", "standard"), ("puma560", "modified")])
def test_a_table_of_the_other_convention(name: str, other: str) -> None:
    robot = arm(name).robot
    data = simulate(robot, Plan(30, seed=2, noise_position=5e-5, orientation=False)).data
    wrong = dataclasses.replace(robot, convention=other)
    with pytest.raises(InputError, match=f"the {robot.convention} Denavit-Hartenberg convention.*set convention"):
        check_data(wrong, data)
    assert find_mistake(robot, data) is None


@pytest.mark.parametrize("name", [*CONFIGURED, "urdf:puma560", pytest.param("targets:puma560", marks=pytest.mark.slow)])
def test_good_data_hold_no_mistake(name: str) -> None:
    robot = arm(name).robot
    rng = np.random.default_rng(0)
    base = Frame(tuple(rng.uniform(-4, 4, 3)), tuple(rng.uniform(-1.5, 1.5, 3)))
    for seed, orientation in ((0, True), (1, False)):
        plan = Plan(25, seed=seed, noise_position=1e-3, noise_orientation=1e-3, outliers=3, orientation=orientation)
        assert check_data(robot, simulate(dataclasses.replace(robot, base=base), plan).data) == ()


def test_few_poses_or_no_joints_are_not_judged() -> None:
    robot, data = arm("puma560").robot, MISTAKES["mm"][0](good())
    assert check_data(robot, data.subset(np.arange(7))) == ()
    assert check_data(robot, dataclasses.replace(data, q=None)) == ()


@pytest.mark.parametrize(
    ("order", "sign", "message"),
    [
        ([0, 1, 2, 3, 4, 5], [1, 1, 1, -1, 1, 1], "the sign of joint wrist_1_joint seems to be reversed"),
        (
            [0, 1, 2, 5, 4, 3],
            [1, 1, 1, 1, 1, 1],
            "the columns of joints wrist_1_joint and wrist_3_joint seem to be exch",
        ),
    ],
)
def test_mistakes_of_joints_are_refused_in_sockets_of_unknown_place(
    order: list[int], sign: list[int], message: str, tmp_path: Path
) -> None:
    lines = Path("sample_data/sockets/unknown.csv").read_text().splitlines()
    heading, *rows = (line.split(",") for line in lines if not line.startswith("#"))
    changed = [[f"{k * float(row[i])}" for k, i in zip(sign, order, strict=True)] + row[6:] for row in rows]
    file = tmp_path / "unknown.csv"
    file.write_text("\n".join(",".join(row) for row in [heading, *changed]) + "\n")
    with pytest.raises(InputError, match=message):
        robacc.calibrate(file, robot="ur10")


def test_readings_in_sockets_that_say_they_are_not_valid_are_left_out_with_a_warning(tmp_path: Path) -> None:
    lines = [line for line in Path("sample_data/sockets/unknown.csv").read_text().splitlines() if line[0] != "#"]
    stated = [f"{line},{'valid' if i == 0 else int(i not in (5, 9))}" for i, line in enumerate(lines)]
    (file := tmp_path / "unknown.csv").write_text("\n".join(stated) + "\n")
    data = read_poses(file)
    assert not np.isin([6, 10], data.rows).any()
    assert any("2 rows incomplete or not measured, left out (line 6, 10)" in text for text in data.warnings)


Matrix = np.ndarray


@cache
def made(n: int = 40, seed: int = 3) -> tuple[Matrix, Matrix, Matrix]:
    """Joints (6, n), positions (3, n) and orientations (3, 3, n) of an arm with zeros wrong by 3 mrad."""
    rng = np.random.default_rng(seed)
    low, high = np.array(independent_arm.LIMITS).T
    q = rng.uniform(low, high, (n, 6))
    frames = independent_arm.link_frames((q + rng.normal(scale=3e-3, size=6)).T)[-1]
    base, shift = Rotation.from_euler("xyz", rng.uniform(-2, 2, 3)), rng.uniform(-3, 3, 3)
    position = (
        base.apply((frames @ np.append(independent_arm.TOOL, 1.0))[:, :3]) + shift + rng.normal(scale=5e-5, size=(n, 3))
    )
    turned = base * Rotation.from_matrix(frames[:, :3, :3]) * Rotation.from_euler("xyz", [0.3, 0.2, 1.0])
    return q.T, position.T, np.moveaxis(turned.as_matrix(), 0, 2)


def judged(q: Matrix, position: Matrix, rotation: Matrix | None = None) -> Mistake:
    mistake = find_mistake(independent_arm.robot(), Measurements(position=position, q=q, rotation=rotation))
    return mistake


def signs(joints: str) -> Matrix:
    return np.array([-1.0 if str(i + 1) in joints else 1.0 for i in range(6)])[:, None]


def interaction(q: Matrix, sign: float) -> Matrix:
    changed = q.copy()
    changed[2] += sign * q[1]
    return changed


def zero(q: Matrix, joint: int, degrees: float) -> Matrix:
    changed = q.copy()
    changed[joint - 1] += np.radians(degrees)
    return changed


@pytest.mark.parametrize(("joints", "oriented"), [("14", True), ("235", False), ("2345", False)])
def test_several_signs_together(joints: str, oriented: bool) -> None:
    q, position, rotation = made()
    mistake = judged(q * signs(joints), position, rotation if oriented else None)
    names = [f"j{number}" for number in joints]
    assert mistake.name == f"the signs of joints {', '.join(names[:-1])} and {names[-1]} seem to be reversed"
    assert mistake.after < 5e-3 < 0.1 < mistake.before


def test_the_mirrored_arm_is_not_distinguishable_from_a_left_handed_frame_without_orientations() -> None:
    # The arm is symmetric about its xz plane: with A1, A4 and A6 reversed it reaches the mirrored positions.
    q, position, rotation = made()
    texts = {"the positions seem to be in a left-handed frame", "the signs of joints j1, j4 and j6 seem to be reversed"}
    for mistake in (judged(q * signs("146"), position), judged(q, position * np.array([[1.0], [-1.0], [1.0]]))):
        assert {mistake.name, *mistake.alternatives} == texts
        assert "Not distinguishable on these poses: the signs of joints j1, j4 and j6" in mistake.text
    mistake = judged(q * signs("146"), position, rotation)
    assert mistake.name == "the signs of joints j1, j4 and j6 seem to be reversed"


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_interaction_that_was_not_undone(sign: float) -> None:
    q, position, _ = made()
    mistake = judged(interaction(q, sign), position)
    assert mistake.name == (
        f"the column of joint j3 seems to hold j3 {'+' if sign > 0 else '-'} j2 (interaction not removed)"
    )
    assert f"coupling: {{j2: {-sign:g}}}" in mistake.fix


Q, POSITION, _ = made()


@pytest.mark.parametrize(
    ("q", "texts"),
    [
        (
            interaction(Q, 1.0) * signs("14"),
            ("the signs of joints j1 and j4 seem to be reversed", "seems to hold j3 + j2"),
        ),
        (
            np.rad2deg(Q) * signs("14"),
            ("the signs of joints j1 and j4 seem to be reversed", "the joint columns seem to be in degrees"),
        ),
        (
            zero(zero(Q, 2, 90), 3, -90),
            (
                "joint j2 seems to count from a zero 90 degrees away; "
                "joint j3 seems to count from a zero 90 degrees away",
            ),
        ),
        (
            Q[[1, 2, 0, 3, 4, 5]],
            ("the joint columns seem to be in another order: they hold j2, j3, j1, j4, j5 and j6",),
        ),
    ],
    ids=["signs and an interaction", "signs and degrees", "zeros of two joints", "three columns in another order"],
)
def test_several_mistakes_of_the_joints(q: Matrix, texts: tuple[str, ...]) -> None:
    name = judged(q, POSITION).name
    assert all(text in name for text in texts)
    assert len(texts) == 2 or name == texts[0]


def as_matrices(rotation: Rotation) -> Matrix:
    return np.moveaxis(rotation.as_matrix(), 0, 2)


READINGS: dict[str, tuple[Callable[[Rotation], Rotation], str]] = {
    "inverse": (lambda r: r.inv(), "the orientations seem to be inverted"),
    "euler as rotation vector": (
        lambda r: Rotation.from_rotvec(r.as_euler("xyz")),
        "angles about the fixed axes x, y, z, read as a rotation vector",
    ),
    "rotation vector as euler": (lambda r: Rotation.from_euler("xyz", r.as_rotvec()), "rotation vectors, read as roll"),
    "moving axes": (lambda r: Rotation.from_euler("xyz", r.as_euler("XYZ")), "angles about the moving axes x, y, z"),
    "quaternion": (lambda r: Rotation.from_quat(r.as_quat()[:, [1, 2, 3, 0]]), "in the order x, y, z, w"),
    "scalar first": (lambda r: Rotation.from_quat(r.as_quat()[:, [3, 0, 1, 2]]), "in the order w, x, y, z, read as x"),
}


@pytest.mark.parametrize("which", READINGS)
def test_orientations_read_wrongly(which: str) -> None:
    q, position, rotation = made()
    read, text = READINGS[which]
    mistake = judged(q, position, as_matrices(read(Rotation.from_matrix(np.moveaxis(rotation, 2, 0)))))
    assert text in mistake.name


def test_inverted_poses() -> None:
    q, position, rotation = made()
    inverse = np.swapaxes(rotation, 0, 1)
    mistake = judged(q, -np.einsum("ijn,jn->in", inverse, position), inverse)
    assert "the measured poses seem to be inverted" in mistake.name


def test_an_unseen_sign_is_said() -> None:
    # The target sits on the last axis, so that the sign of joint 6 moves nothing.
    rng = np.random.default_rng(0)
    low, high = np.array(independent_arm.LIMITS).T
    q = rng.uniform(low, high, (30, 6))
    position = independent_arm.target((q + 2e-3).T, np.array([0.0, 0.0, 0.1])).T
    mistake = judged(q.T * signs("2"), position)
    assert mistake.name == "the sign of joint j2 seems to be reversed"
    assert "These poses do not show the sign of j6" in mistake.text


N = 80
Change = Callable[[np.ndarray, np.ndarray, slice], None]


def reversed_sign(q: np.ndarray, position: np.ndarray, part: slice) -> None:
    q[2, part] *= -1.0


def exchanged_joints(q: np.ndarray, position: np.ndarray, part: slice) -> None:
    q[[0, 3], part] = q[[3, 0], part]


def mirrored_axes(q: np.ndarray, position: np.ndarray, part: slice) -> None:
    position[[0, 1], part] = position[[1, 0], part]


def data(change: Change | None = None, part: slice = slice(0, 0), seed: int = 5) -> Measurements:
    q, position, _ = made(N, seed)
    q, position = q.copy(), position.copy()
    if change is not None:
        change(q, position, part)
    return Measurements(position=position, q=q)


CHANGES = (
    (reversed_sign, "the sign of joint"),
    (exchanged_joints, "seem to be exchanged"),
    (mirrored_axes, "left-handed frame"),
)
PARTS = (slice(50, N), slice(0, 30), slice(25, 60))
PAIRS = [
    pytest.param(*change, part, marks=() if i == k else pytest.mark.slow)
    for i, change in enumerate(CHANGES)
    for k, part in enumerate(PARTS)
]


@pytest.mark.parametrize(("change", "text", "part"), PAIRS)
def test_a_mistake_in_a_part_is_named_with_its_lines(change: Change, text: str, part: slice) -> None:
    with pytest.raises(InputError, match=text) as error:
        check_data(independent_arm.robot(), data(change, part))
    first, last = (int(word) for word in str(error.value).partition(",")[0].removeprefix("lines ").split(" to "))
    # Poses near zero of the joint, or near the plane of the mirror, show nothing.
    assert abs(first - (part.start + 1)) <= 2
    assert abs(last - part.stop) <= 2
    assert "correct these rows only" in str(error.value)


def test_a_mistake_in_most_rows_of_a_short_file_is_named() -> None:
    """Twenty rows agree: a window that the frames are registered on has to lie within them."""
    with pytest.raises(InputError, match="unlike the other rows: the sign of joint"):
        check_data(independent_arm.robot(), data(reversed_sign, slice(20, 50)).subset(slice(0, 50)))


def test_a_part_that_nothing_explains_is_told() -> None:
    def random(q: np.ndarray, position: np.ndarray, part: slice) -> None:
        q[:, part] = np.random.default_rng(1).uniform(-1.0, 1.0, q[:, part].shape)

    (warning,) = check_data(independent_arm.robot(), data(random, slice(50, N)))
    assert warning.startswith("lines 51 to 80 do not agree with the other rows")


def moved_base(q: np.ndarray, position: np.ndarray, part: slice) -> None:
    turn = np.array([[np.cos(0.3), -np.sin(0.3), 0.0], [np.sin(0.3), np.cos(0.3), 0.0], [0.0, 0.0, 1.0]])
    position[:, part] = turn @ position[:, part] + np.array([[0.3], [-0.2], [0.1]])


def moved_base_and_a_poor_instrument(q: np.ndarray, position: np.ndarray, part: slice) -> None:
    position[:, part] += 0.012 * np.random.default_rng(3).normal(size=position[:, part].shape)
    moved_base(q, position, part)


def jumped_zero(q: np.ndarray, position: np.ndarray, part: slice) -> None:
    q[1, part] += 0.01


def outliers(q: np.ndarray, position: np.ndarray, part: slice) -> None:
    position[:, [3, 17, 40, 66]] += 0.2


@pytest.mark.parametrize("change", [None, moved_base, moved_base_and_a_poor_instrument, jumped_zero, outliers])
def test_steps_and_outliers_are_no_mistakes_of_a_part(change: Change | None) -> None:
    """A moved base and a joint whose zero jumped are steps, which a trace finds."""
    assert check_data(independent_arm.robot(), data(change, slice(50, N))) == ()


N_OF_ROW_MISTAKES = 60


def data_of_row_mistakes(order: np.ndarray | None = None) -> Measurements:
    """Measured rows in the given order; the joints stay."""
    q, position, _ = made(N_OF_ROW_MISTAKES, 5)
    return Measurements(position=position if order is None else position[:, order], q=q)


def reordered(rows: list[int], there: list[int]) -> np.ndarray:
    order = np.arange(N_OF_ROW_MISTAKES)
    order[rows] = there
    return order


@pytest.mark.parametrize(
    ("rows", "there", "text"),
    [
        ([11, 40], [40, 11], "lines 12, 41: the measured poses seem to be exchanged"),
        (
            [3, 20, 50],
            [20, 50, 3],
            "lines 4, 21, 51: the measured poses seem to be in another order than the joints",
        ),
    ],
)
def test_a_few_rows_elsewhere_are_named_and_the_others_used(rows: list[int], there: list[int], text: str) -> None:
    (warning,) = check_data(independent_arm.robot(), data_of_row_mistakes(reordered(rows, there)))
    assert warning.startswith(text)


def test_many_exchanged_rows_are_refused() -> None:
    with pytest.raises(InputError, match=r"^lines 4, 51; 12, 41: the measured poses seem to be exchanged"):
        check_data(independent_arm.robot(), data_of_row_mistakes(reordered([3, 50, 11, 40], [50, 3, 40, 11])))


def test_exchanged_names_of_targets() -> None:
    """Two targets of one visit: their rows have the same joints, so only the names can be exchanged."""
    robot = dataclasses.replace(independent_arm.robot(), targets={"A": Frame(), "B": Frame(xyz=(0.1, 0.0, 0.05))})
    q, _, _ = made(N_OF_ROW_MISTAKES // 2, 5)
    both = Measurements(
        np.zeros((3, N_OF_ROW_MISTAKES)), q=np.repeat(q, 2, axis=1), target=np.tile(["A", "B"], N_OF_ROW_MISTAKES // 2)
    )
    position = predict(robot, both).translation + 1e-5 * np.random.default_rng(2).normal(size=(3, N_OF_ROW_MISTAKES))
    names = both.target.copy()
    names[[20, 21]] = names[[21, 20]]
    (warning,) = check_data(robot, dataclasses.replace(both, position=position, target=names))
    assert warning.startswith("lines 21, 22: the names of the targets seem to be exchanged")
    assert "give each row the name of the target that was measured" in warning


@pytest.mark.parametrize(("first", "end", "shift"), [(20, 35, 1), (0, 40, -1), (30, 60, 2)])
def test_a_shifted_stretch(first: int, end: int, shift: int) -> None:
    rows = list(range(first, end))
    with pytest.raises(InputError, match="the measured poses seem to be shifted") as info:
        check_data(independent_arm.robot(), data_of_row_mistakes(reordered(rows, np.roll(rows, shift).tolist())))
    text = str(info.value)
    count = "one row" if abs(shift) == 1 else f"{abs(shift)} rows"
    assert f"shifted by {count} {'down' if shift > 0 else 'up'} against the joints" in text
    named = [int(part) for part in text.partition(":")[0].removeprefix("lines ").split(" to ")]
    assert abs(named[0] - 1 - first) <= 2
    assert abs(named[1] - end) <= 2


@pytest.mark.parametrize("seed", range(2))
def test_permuted_rows_are_named_with_an_unknown_tool(seed: int) -> None:
    order = np.random.default_rng(seed).permutation(N_OF_ROW_MISTAKES)
    turned = registered_poses(independent_arm.robot(), data_of_row_mistakes()).rotation
    shifted = dataclasses.replace(
        data_of_row_mistakes(),
        position=data_of_row_mistakes().position + np.einsum("ijn,j->in", turned, (0.05, -0.02, 0.04)),
    )
    for measured in (data_of_row_mistakes(), shifted):
        permuted = dataclasses.replace(measured, position=measured.position[:, order])
        with pytest.raises(InputError, match="the measured poses seem to be in another order than the joints: sorted"):
            check_data(independent_arm.robot(), permuted)


@pytest.mark.parametrize("seed", [6, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(7, 12))])
def test_other_joints_of_the_same_arm_are_no_permutation(seed: int) -> None:
    text = ""
    try:
        check_data(
            independent_arm.robot(), dataclasses.replace(data_of_row_mistakes(), q=made(N_OF_ROW_MISTAKES, seed)[0])
        )
    except InputError as error:
        text = str(error)
    assert "another order" not in text


N_OF_SUSPECTED_MISTAKES = 30
EFFECTS = "base_frame,tool_frame,link_geometry[j4]"


def campaign(length: float) -> tuple[Robot, Measurements]:
    """A robot file whose forearm is wrong by ``length``, and poses of the true arm."""
    q, position, _ = made(N_OF_SUSPECTED_MISTAKES, 5)
    robot = independent_arm.robot()
    joints = list(robot.joints)
    joints[3] = dataclasses.replace(
        joints[3], parameters={**joints[3].parameters, "d": independent_arm.DH[3][1] + length}
    )
    return dataclasses.replace(robot, joints=tuple(joints)), Measurements(position=position, q=q)


def files(folder: Path, length: float) -> list[str]:
    """Words of the command line: poses and robot file of a campaign."""
    robot, data = campaign(length)
    robacc.write_robot(folder / "robot.yaml", robot)
    robacc.write_poses(folder / "poses.csv", data)
    return [str(folder / "poses.csv"), "--robot", str(folder / "robot.yaml")]


@pytest.mark.parametrize(("size", "suspected"), [(0.1, True), (0.01, False)])
def test_orientations_of_another_convention_are_suspected(size: float, suspected: bool) -> None:
    """Rotations about random axes of some 6 degrees, as angles of another order leave them, or of half a degree."""
    q, position, exact = made(N_OF_SUSPECTED_MISTAKES, 5)
    rng = np.random.default_rng(3)
    turns = exp_so3(rng.normal(scale=size / np.sqrt(3), size=(3, N_OF_SUSPECTED_MISTAKES)))
    data = Measurements(position=position, q=q, rotation=np.einsum("ijn,jkn->ikn", exact, turns))
    start = Model.of(independent_arm.robot())
    model = Model(start.arm, free=build(parse_requests("base_frame,tool_frame"), start.arm, data))
    texts = suspected_mistakes(fit(model, data, Options()))
    assert any("median orientation error" in text for text in texts) == suspected


FITS = (("calibrate", "--fit"), pytest.param("trace", "--declared", marks=pytest.mark.slow))


@pytest.mark.parametrize(("command", "option"), FITS)
def test_a_model_with_a_suspected_mistake_says_so_wherever_it_is_used(
    command: str, option: str, tmp_path: Path
) -> None:
    model = tmp_path / "model.yaml"
    words = [command, *files(tmp_path, 0.2), option, EFFECTS, "--folds", "2", "--write-model", str(model)]
    outcome = run(*words)
    assert outcome.exit_code == 5
    assert "must not be used until the suspected data mistake is resolved" in outcome.stderr
    assert "warning: suspected data mistake: link_geometry.j4.d is corrected by -" in one_line(outcome.stderr)
    head = model.read_text().splitlines()[:3]
    assert head[1] == "# do not use this model until the following is resolved:"
    assert "link_geometry.j4.d is corrected by -" in head[2]
    text = "doubtful model: suspected data mistake: link_geometry.j4.d is corrected by -"
    for result in (robacc.predict(model, samples=20), robacc.export(model, format="mdh")):
        assert any(warning.startswith(text) for warning in result.warnings)
    # The model itself is as it was fitted: only the words are added.
    assert robacc.read_robot(model).joints[3].parameters["d"] == pytest.approx(independent_arm.DH[3][1], abs=10e-3)


@pytest.mark.parametrize(("command", "option"), FITS)
def test_a_model_without_a_suspicion_is_written_as_ever(command: str, option: str, tmp_path: Path) -> None:
    model = tmp_path / "model.yaml"
    words = [command, *files(tmp_path, 2e-3), option, EFFECTS, "--folds", "2", "--write-model", str(model)]
    outcome = run(*words)
    assert outcome.exit_code == 0
    assert "suspected" not in outcome.stderr + model.read_text()
    assert "do not use" not in model.read_text()
    assert robacc.predict(model, samples=20).warnings == ()


def test_a_trace_heeds_the_suspicions_on_its_final_fit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("robacc.api.fitting.suspected_mistakes", lambda fit: ("suspected data mistake: a test",))
    model = tmp_path / "model.yaml"
    words = ["trace", *files(tmp_path, 2e-3), "--declared", EFFECTS, "--folds", "2", "--write-model", str(model)]
    assert run(*words).exit_code == 5
    assert model.read_text().splitlines()[2] == "# suspected data mistake: a test"
    assert robacc.predict(model, samples=5).warnings == ("doubtful model: suspected data mistake: a test",)


NOISE = 2e-5
ENTRY = {"effect": "gear_ratio", "joints": ["j2"], "values": {"j2": 4e-4}}
DECLARED = "base_frame,tool_frame,joint_offset,link_geometry"


@cache
def campaigns() -> tuple[Robot, Measurements, Measurements]:
    """Nominal robot, calibration poses and validation poses of an arm whose second joint has another gear ratio."""
    robot = replace(arm("irb1600").robot, effects=())
    true = replace(robot, effects=(ENTRY,))
    plans = (Plan(n, seed=3 + n, noise_position=NOISE, orientation=False) for n in (70, 40))
    return robot, *(simulate(true, plan).data for plan in plans)


@cache
def calibrated() -> Fit:
    robot, data, _ = campaigns()
    start = Model.of(robot)
    return fit(Model(start.arm, start.known, build(parse_requests(DECLARED), start.arm, data)), data, Options())


def moved(data: Measurements, angle: float, shift: tuple[float, float, float]) -> Measurements:
    return replace(data, position=rotate(rotation_about(2, angle), data.position) + np.array(shift)[:, None])


def figures(text: str | None) -> tuple[float, ...]:
    """Return displacement (mm), angle (degrees), error with the frames registered (mm), and error as measured."""
    pattern = r"poses lie (\S+) mm and (\S+)° .* their error is (\S+) mm rms in place of (\S+) mm"
    return tuple(float(number) for number in re.search(pattern, str(text)).groups())


@pytest.mark.parametrize(
    ("angle", "shift"), [(0.02, (0.05, -0.03, 0.0)), (1.9, (3.0, -2.0, 0.4)), (0.0, (0.0, 0.02, 0.0))]
)
def test_a_moved_base_is_found(angle: float, shift: tuple[float, float, float]) -> None:
    fitted, second = calibrated(), moved(campaigns()[2], angle, shift)
    found = moved_frames(fitted, second)
    shifted, turned, registered, before = figures(found)
    assert np.radians(turned) == pytest.approx(angle, abs=2e-3)
    centre = moved(replace(second, position=fitted.predict(second).translation), angle, shift).position.mean(axis=1)
    expected = np.linalg.norm(centre - fitted.predict(second).translation.mean(axis=1))
    assert shifted == pytest.approx(1e3 * float(expected), rel=0.05)
    assert registered < 1.0 < 10 * registered < before
    assert "the instrument or the robot base moved between the files; with base registered on them" in found


def test_a_target_mounted_again_is_found() -> None:
    fitted, second = calibrated(), campaigns()[2]
    mount = np.einsum("ijn,j->in", fitted.predict(second).rotation, np.array([0.02, -0.01, 0.03]))
    found = moved_frames(fitted, moved(replace(second, position=second.position + mount), 0.3, (0.1, 0.2, 0.3)))
    assert figures(found)[2] < 1.0
    assert "or the target was mounted again; with base and target registered" in found


def test_the_same_setup_has_not_moved() -> None:
    fitted, second = calibrated(), campaigns()[2]
    assert moved_frames(fitted, second) is None
    # Errors that no motion of a frame explains, of the same size as a moved base's.
    rng = np.random.default_rng(5)
    assert moved_frames(fitted, replace(second, position=second.position + rng.normal(0, 0.02, (3, second.n)))) is None
    # Too few poses to say.
    assert moved_frames(fitted, moved(second, 0.02, (0.05, 0, 0)).subset(np.arange(8))) is None


def test_findings_are_judged_with_the_frames_registered() -> None:
    """A gear ratio went, as the error of the validation poses, 60 mm, was not lower with it than without."""
    robot, first, second = campaigns()
    same = robacc.trace(first, robot=robot, declared=DECLARED, holdout=second)
    other = robacc.trace(first, robot=robot, declared=DECLARED, holdout=moved(second, 0.02, (0.05, -0.03, 0.0)))
    for result in (same, other):
        assert [(finding.effect, finding.joints) for finding in result.findings] == [("gear_ratio", ("j2",))]
    assert not any("validation poses lie" in text for text in same.warnings)
    assert any("validation poses lie" in text for text in other.warnings)
    # The figures stay those of the poses as measured.
    assert other.after.held_out.position.rms > 0.04


def test_calibrate_says_that_the_setup_moved() -> None:
    robot, first, second = campaigns()
    fit_names = ("base_frame", "tool_frame", "joint_offset", "gear_ratio[j2]")
    result = robacc.calibrate(first, robot=robot, fit=fit_names, holdout=moved(second, 0.02, (0.05, -0.03, 0.0)))
    assert sum("the instrument or the robot base moved" in text for text in result.warnings) == 1
    assert not any("fit fewer effects" in text for text in result.warnings)


def test_a_larger_error_of_validation_poses_gives_a_warning() -> None:
    fitted, (_, data, second) = calibrated(), campaigns()
    texts = [
        " ".join(fit_warnings(fitted, data, lack_of_fit(fitted, data), fitted, (1e-4, error), second))
        for error in (1.9e-4, 7.5e-4)
    ]
    assert "that of the calibration poses" not in texts[0]
    assert "7.5 times that of the calibration poses" in texts[1]


def measured(arm: str, n: int = 40) -> Measurements:
    rng = np.random.default_rng(1)
    data = Measurements(np.zeros((3, n)), q=rng.uniform(-2.5, 2.5, (6, n)))
    position = predict(read_robot(arm), data).translation + rng.normal(scale=2e-4, size=(3, n))
    return Measurements(position + np.array([[2.0], [-1.0], [0.5]]), q=data.q)


def test_the_arm_that_was_measured_is_named() -> None:
    result = robacc.estimate(measured("ur10e"), robot="ur10")
    (warning,) = [text for text in result.warnings if "of the package" in text or "the package's" in text]
    assert "the package's ur10e 0." in warning
    assert "check that `robot` is the arm that was measured" in warning


def test_a_calibration_names_it_too() -> None:
    warnings = robacc.calibrate(measured("ur10e"), robot="ur10", fit="base_frame,tool_frame").warnings
    assert any("the package's ur10e" in text for text in warnings)


def test_an_arm_that_is_far_from_the_one_measured_is_refused() -> None:
    with pytest.raises(InputError, match=r"the package's ur10e 0.*check that `robot` is the arm that was measured"):
        robacc.trace(measured("ur10e"), robot="ur5e")


def test_the_right_arm_is_not_doubted() -> None:
    assert not any("package" in text for text in robacc.estimate(measured("ur10e"), robot="ur10e").warnings)
    other = measured("ur10e")
    noisy = Measurements(other.position + np.random.default_rng(2).normal(scale=0.01, size=(3, 40)), q=other.q)
    assert not any("package" in text for text in robacc.estimate(noisy, robot="ur10e").warnings)
