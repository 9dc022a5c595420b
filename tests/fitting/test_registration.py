"""Registration of frames, places of targets and origins of a URDF, in closed form and by fits."""

import dataclasses
import functools
import re
from pathlib import Path

import numpy as np
import pytest
from arms import arm, model_of
from robot_files import example_robots
from scipy.spatial.transform import Rotation
from slow_parameters import some_fast

import robacc
from robacc import InputError, Measurements, Robot, UsageError, read_robot
from robacc.effects.campaign import Step
from robacc.effects.frames import BaseFrame, LinkGeometry
from robacc.effects.specification import entry_of, parse_requests
from robacc.error_model.structure import with_error_structure
from robacc.fitting.fit_result import HoldOut, Options
from robacc.fitting.parameters import absorb_constants, apply_fit, parameters
from robacc.fitting.registration import align, align_commands
from robacc.fitting.solver import fit
from robacc.fitting.visits import places, places_warning
from robacc.geometry import compose, exp_so3, rpy_from_rotation
from robacc.modelling.model import Model, predict
from robacc.robots.arm import Arm
from robacc.robots.description import Frame
from robacc.robots.yaml_robot import parse_robot, robot_to_yaml
from robacc.simulation.simulate import Plan, simulate
from robacc.tracing.calibrating import calibrate

NOISE = 2e-5
BOTH = ("base_frame", "tool_frame")


def anywhere(rng: np.random.Generator, reach: float) -> Frame:
    """A frame up to ``reach`` away along each axis, turned about any axis by any angle."""
    axis = rng.normal(size=(3, 1))
    turn = exp_so3(rng.uniform(0, np.pi) * axis / np.linalg.norm(axis))
    return Frame(tuple(rng.uniform(-reach, reach, 3)), tuple(float(a) for a in rpy_from_rotation(turn[..., 0])))


def displaced(robot: Robot, seed: int) -> Robot:
    """The same arm standing elsewhere, with its target, or each of them, elsewhere on the flange."""
    rng = np.random.default_rng(seed)
    robot = dataclasses.replace(robot, base=anywhere(rng, 5.0))
    if robot.targets:
        return dataclasses.replace(robot, targets={name: anywhere(rng, 0.2) for name in robot.targets})
    return dataclasses.replace(robot, tool=anywhere(rng, 0.2))


def measured(name: str, seed: int, *, orientation: bool, noise: float = 0.0, outliers: int = 0) -> Measurements:
    plan = Plan(
        40,
        seed=seed,
        orientation=orientation,
        noise_position=noise,
        noise_orientation=noise,
        outliers=outliers,
        outlier_size=0.4,
    )
    return simulate(displaced(arm(name).robot, seed), plan).data


def turned_by(robot: Robot, data: Measurements) -> float:
    """Largest angle between predicted and measured orientation, rad."""
    cosine = 0.5 * (np.einsum("ijn,ijn->n", data.rotation, predict(robot, data).rotation) - 1.0)
    return float(np.arccos(np.clip(cosine, -1.0, 1.0)).max())


@pytest.mark.parametrize("orientation", [True, False])
@pytest.mark.parametrize("name", ["puma560", "panda", "stanford", "urdf:ur10", "targets:puma560"])
def test_exact_poses_are_met_from_any_start(name: str, orientation: bool) -> None:
    for seed in range(3):
        data = measured(name, seed, orientation=orientation)
        found = align(arm(name).robot, data, BOTH)
        # A rounding of five metres, some hundred operations on.
        np.testing.assert_allclose(predict(found.robot, data).translation, data.position, rtol=0, atol=1e-9)
        if orientation:
            assert turned_by(found.robot, data) < 1e-7  # arccos near one loses half the digits


@pytest.mark.parametrize("what", [("base_frame",), ("tool_frame",)])
def test_one_frame_alone_is_found_and_the_other_left(what: tuple[str, ...]) -> None:
    robot = arm("puma560").robot
    rng = np.random.default_rng(5)
    base, tool = (anywhere(rng, 3.0), robot.tool) if what == ("base_frame",) else (robot.base, anywhere(rng, 0.2))
    data = simulate(dataclasses.replace(robot, base=base, tool=tool), Plan(20, seed=5)).data
    found = align(robot, data, what)
    assert found.effects == what
    assert found.n_parameters == 6
    for name, value in (("base", base), ("tool", tool)):
        frame = getattr(found.robot, name)
        np.testing.assert_allclose(frame.xyz, value.xyz, rtol=0, atol=1e-9)
        np.testing.assert_allclose(frame.rpy, value.rpy, rtol=0, atol=1e-9)
    expected = [(f"{what[0]}.{label}") for label in ("x", "y", "z", "roll", "pitch", "yaw")]
    assert [one.name for one in found.parameters] == expected
    assert [one.unit for one in found.parameters] == ["m"] * 3 + ["rad"] * 3


@pytest.mark.parametrize("orientation", [True, False])
@pytest.mark.parametrize("name", ["puma560", "panda", "targets:puma560"])
def test_gross_errors_do_not_move_the_frames(name: str, orientation: bool) -> None:
    for seed in range(3):
        clean = measured(name, seed, orientation=orientation)
        # A tenth of the rows half a metre off.
        data = measured(name, seed, orientation=orientation, noise=NOISE, outliers=clean.n // 10)
        found = align(arm(name).robot, data, BOTH)
        error = np.linalg.norm(predict(found.robot, clean).translation - clean.position, axis=0)
        # Twelve coefficients (more with two targets) from over a hundred numbers: well below the noise on average.
        assert np.sqrt(np.mean(error**2)) < NOISE


def test_what_a_point_cannot_show_is_said() -> None:
    found = align(arm("puma560").robot, measured("puma560", 1, orientation=False), BOTH)
    assert found.n_parameters == 9
    assert found.notes == tuple(
        f"tool_frame.{label} has no effect on these poses" for label in ("roll", "pitch", "yaw")
    )


@pytest.mark.parametrize(
    ("what", "n", "message"),
    [
        (("joint_offset",), 40, "cannot align joint_offset; choose among base_frame, tool_frame"),
        ((), 40, "cannot align nothing; choose among base_frame, tool_frame"),
        (BOTH, 2, "2 poses: registration of base_frame or tool_frame needs at least 3"),
        (BOTH, 3, r"9 numbers measured \(3 poses\), too few for 9 coefficients"),
    ],
)
def test_what_cannot_be_aligned_is_refused(what: tuple[str, ...], n: int, message: str) -> None:
    data = measured("puma560", 1, orientation=False).subset(np.arange(n))
    with pytest.raises((InputError, UsageError), match=message):
        align(arm("puma560").robot, data, what)


def commanded_poses(seed: int, *, orientation: bool, n: int = 30) -> tuple[Measurements, Rotation, np.ndarray]:
    """Poses measured as B C G for commanded poses C, with B metres away and G off the commanded point."""
    rng = np.random.default_rng(seed)
    base, tool = Rotation.random(random_state=rng), Rotation.from_rotvec(rng.normal(size=3))
    shift, offset = rng.uniform(-5, 5, 3), rng.uniform(-0.2, 0.2, 3)
    position, turn = rng.uniform(-1, 1, (n, 3)), Rotation.random(n, random_state=rng)
    measured_position = base.apply(position + turn.apply(offset)) + shift + rng.normal(scale=NOISE, size=(n, 3))
    matrices = [np.moveaxis((rotation).as_matrix(), 0, -1) for rotation in (base * turn * tool, turn)]
    data = Measurements(
        measured_position.T,
        matrices[0] if orientation else None,
        commanded_position=position.T,
        commanded_rotation=matrices[1],
    )
    return data, base, offset


@pytest.mark.parametrize("orientation", [True, False])
def test_commanded_poses_are_registered_without_a_robot(orientation: bool) -> None:
    data, base, offset = commanded_poses(3, orientation=orientation)
    alignment = align_commands(data, BOTH)
    errors = data.position - alignment.commanded.translation
    # The noise along three axes, of which 9 or 12 coordinates took a part.
    assert np.sqrt(np.mean(np.sum(errors**2, axis=0))) < 2.0 * NOISE
    np.testing.assert_allclose(alignment.robot.tool.xyz, offset, atol=NOISE)
    assert (Rotation.from_euler("xyz", alignment.robot.base.rpy).inv() * base).magnitude() < NOISE
    if orientation:
        np.testing.assert_allclose(alignment.commanded.rotation, data.rotation, atol=1e-4)


def test_commanded_positions_alone_register_the_base_as_points_do() -> None:
    data, *_ = commanded_poses(4, orientation=False)
    positions = dataclasses.replace(data, commanded_rotation=None)
    alignment = align_commands(positions, ("base_frame",))
    # Kabsch's solution is the least squares of points; scipy has it too.
    centred = [x - x.mean(axis=1, keepdims=True) for x in (positions.position, positions.commanded_position)]
    best, residual = Rotation.align_vectors(centred[0].T, centred[1].T)
    assert np.linalg.norm(positions.position - alignment.commanded.translation) == pytest.approx(residual, rel=1e-6)
    assert (Rotation.from_euler("xyz", alignment.robot.base.rpy).inv() * best).magnitude() < 1e-6
    with pytest.raises(UsageError, match="add the columns cmd_qw"):
        align_commands(positions, BOTH)


def poses(q: np.ndarray) -> Measurements:
    return Measurements(position=np.zeros((3, q.shape[1])), q=q, rows=np.arange(2, q.shape[1] + 2), source="poses.csv")


def random_poses(count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-2.5, 2.5, (6, count))


@pytest.mark.parametrize("jitter", [1e-6, 1e-4, 0.03])
def test_repetitions_with_measured_joints_are_one_place(jitter: float) -> None:
    rng = np.random.default_rng(1)
    q = np.repeat(random_poses(25), 4, axis=1) + rng.normal(scale=jitter, size=(6, 100))
    order = rng.permutation(100)
    data = poses(q[:, order])
    truth = np.repeat(np.arange(25), 4)[order]
    place = places(data)
    assert [len(set(place[truth == k])) for k in range(25)] == [1] * 25
    assert len(set(place)) == 25
    assigned = HoldOut.of(data, None, 5, 0).groups
    assert all(len(set(assigned[truth == k])) == 1 for k in range(25))
    (warning,) = places_warning(data)
    assert warning.startswith("poses.csv: 100 poses lie in 25 places")


SWEEP = random_poses(1).repeat(200, axis=1)
SWEEP[2] = np.linspace(-1.5, 1.5, 200)


@pytest.mark.parametrize(
    "q",
    [
        random_poses(2000),
        np.repeat(random_poses(12), 5, axis=1),
        SWEEP,
        # Of four places, five folds would leave no pose to fit.
        np.repeat(random_poses(4), 20, axis=1) + np.random.default_rng(2).normal(scale=0.01, size=(6, 80)),
    ],
    ids=["random", "repetitions of equal joints", "a sweep of one joint", "few places"],
)
def test_poses_that_do_not_lie_in_places_are_held_out_as_their_joints_say(q: np.ndarray) -> None:
    data = poses(q)
    assert np.array_equal(places(data), data.groups())
    assert places_warning(data) == ()


def test_the_order_of_rows_and_the_unit_do_not_matter() -> None:
    rng = np.random.default_rng(3)
    q = np.repeat(random_poses(15), 3, axis=1) + rng.normal(scale=0.02, size=(6, 45))
    order = rng.permutation(45)
    first, second = places(poses(q)), places(poses(q[:, order] * np.array([1, 1, 1, 1, 1, 1000.0])[:, None]))
    assert np.array_equal(second[:, None] == second, (first[:, None] == first)[np.ix_(order, order)])


@pytest.mark.parametrize("draws", [4, pytest.param(12, marks=pytest.mark.slow)])
def test_errors_that_poses_of_a_place_share_widen_the_intervals(draws: int) -> None:
    """16 groups of six poses, joints wrong by 50 urad in each: joint zeros are right within their standard errors."""
    robot, rng = arm("puma560").robot, np.random.default_rng(4)
    scores: dict[bool, list[float]] = {True: [], False: []}
    for _ in range(draws):
        q = np.repeat(rng.uniform(-1.5, 1.5, (6, 16)), 6, axis=1) + rng.normal(scale=0.02, size=(6, 96))
        arrived = q + np.repeat(rng.normal(scale=5e-5, size=(6, 16)), 6, axis=1)
        exact = predict(robot, poses(arrived)).translation
        data = dataclasses.replace(poses(q), position=exact + rng.normal(scale=1e-5, size=exact.shape))
        model = model_of(robot, "base_frame,tool_frame,joint_offset", data)
        plain = fit(model, data)
        allowed = with_error_structure(plain, data, Options(), functools.partial(fit, model, data)).fit
        for shared, answer in ((False, plain), (True, allowed)):
            zeros = [i for i in answer.identifiability.columns if answer.names[i].startswith("joint_offset")]
            scores[shared].extend(answer.theta[zeros] / np.sqrt(np.diag(answer.covariance)[zeros]))
    # Of 48 scores, the root mean square of standard Gaussians lies between 0.8 and 1.2 with 95 % probability.
    assert np.sqrt(np.mean(np.square(scores[False]))) > 2.0
    assert 0.7 < np.sqrt(np.mean(np.square(scores[True]))) < 1.4


ARMS = (
    "ur_description/urdf/ur10_robot.urdf",
    "ur_description/urdf/ur10_joint_limited_robot.urdf",
    "ur_description/urdf/ur3_robot.urdf",
    "ur_description/urdf/ur3_gripper.urdf",
    "ur_description/urdf/ur3_joint_limited_robot.urdf",
    "ur_description/urdf/ur5_robot.urdf",
    "ur_description/urdf/ur5_gripper.urdf",
    "ur_description/urdf/ur5_joint_limited_robot.urdf",
    "baxter_description/urdf/baxter.urdf",
    "tiago_description/robots/tiago_no_hand.urdf",
    "hyq_description/robots/hyq_no_sensors.urdf",
    "panda_description/urdf/panda.urdf",
    "kinova_description/robots/kinova.urdf",
    "xarm_description/urdf/xarm7.urdf",
    "z1_description/urdf/z1.urdf",
    "so_arm_description/urdf/so100.urdf",
    "talos_data/robots/talos_left_arm.urdf",
    "pr2_description/urdf/pr2.urdf",
    "romeo_description/urdf/romeo_small.urdf",
    "anymal_b_simple_description/robots/anymal-kinova.urdf",
)
"""Twenty arms; the first eleven have origins at a pitch of 90 degrees."""
POSITION_STD, ORIENTATION_STD = 2e-5, 2e-5
TOOL = Frame((0.05, 0.02, 0.1), (0.1, -0.2, 0.3))


def read_any_chain(path: Path) -> Robot | None:
    """The longest chain, or the first of those equally long; None of a file without a serial chain."""
    try:
        return read_robot(path)
    except InputError as error:
        if "the tree ends at " not in str(error):
            return None
        leaf = str(error).split("the tree ends at ")[1].split(",")[0].split(" ")[0]
    try:
        return read_robot(path, tip_link=leaf)
    except InputError:
        return None


def with_errors(robot: Robot, rng: np.random.Generator) -> Robot:
    """The arm as built: every origin is off by 0.5 mm and by a turn of 0.5 mrad about any axis."""
    joints = []
    for joint in robot.joints:
        place = {axis: joint.parameters[axis] + rng.normal(0, 5e-4) for axis in "xyz"}
        turn = Rotation.from_euler("xyz", [joint.parameters[angle] for angle in ("roll", "pitch", "yaw")])
        roll, pitch, yaw = (turn * Rotation.from_rotvec(rng.normal(0, 5e-4, 3))).as_euler("xyz")
        moved = joint.parameters | place | {"roll": roll, "pitch": pitch, "yaw": yaw}
        joints.append(dataclasses.replace(joint, parameters=moved) if joint.is_variable else joint)
    return dataclasses.replace(robot, joints=tuple(joints), base=Frame((0.7, -0.2, 0.4), (0.4, -0.3, 1.0)))


@pytest.mark.parametrize("name", some_fast(ARMS, 4))
def test_random_errors_of_every_origin_are_fitted_to_the_noise(name: str) -> None:
    robot = read_any_chain(example_robots() / name)
    robot, rng, n = dataclasses.replace(robot, tool=TOOL), np.random.default_rng(7), 150
    low, high = np.array([np.clip(joint.limits or (-3, 3), -3, 3) for joint in robot.variables]).T[..., None]
    data = Measurements(np.zeros((3, n)), q=rng.uniform(low, high, (len(robot.variables), n)))
    real = predict(with_errors(robot, rng), data)
    data = dataclasses.replace(
        data,
        position=real.translation + rng.normal(0, POSITION_STD, (3, n)),
        rotation=compose(exp_so3(rng.normal(0, ORIENTATION_STD, (3, n))), real.rotation),
        sigma_position=np.full((3, n), POSITION_STD),
        sigma_rotation=np.full(n, ORIENTATION_STD),
    )
    result = calibrate(robot, data, parse_requests("base_frame,tool_frame,joint_offset,link_geometry"), n_folds=2)
    # Mean square per coordinate, over the noise's: one for a model with every error, within five standard deviations.
    fitted = result.fit
    assert fitted.inliers.all()
    for rows, noise_std in ((slice(0, 3), POSITION_STD), (slice(3, 6), ORIENTATION_STD)):
        mean_square = float(np.mean(np.square(fitted.residual[rows]))) / noise_std**2
        dof_share = 1.0 - fitted.identifiability.columns.size / (6 * n)
        assert abs(mean_square / dof_share - 1.0) < 5.0 * np.sqrt(2.0 / (3 * n))
    # Estimation adds to the true position at most the noise of as many numbers as there are coefficients.
    error = np.sqrt(np.mean(np.sum(np.square(predict(result.robot, data).translation - real.translation), axis=0)))
    assert error < 1.5 * POSITION_STD * np.sqrt(fitted.identifiability.columns.size / n)


def ur10() -> Robot:
    path = example_robots() / "ur_description/urdf/ur10_robot.urdf"
    return dataclasses.replace(read_robot(path, tip_link="tool0"), tool=TOOL)


def test_findings_of_one_origin_are_applied_as_they_were_fitted() -> None:
    """Turns about three axes do not commute, so single constants of one origin are written together."""
    robot = ur10()
    joint = Arm.of(robot).names[1]
    sizes = {"yaw": 3e-3, "roll": -2e-3, "pitch": 4e-3}
    effects = [LinkGeometry((joint,), (label,)) for label in sizes]
    values = [{f"link_geometry.{joint}.{label}": size} for label, size in sizes.items()]
    data = Measurements(position=np.zeros((3, 9)), q=np.random.default_rng(1).uniform(-2, 2, (6, 9)))
    for listed in (0, 1, 3):
        entries = tuple(entry_of(e, v) for e, v in zip(effects[:listed], values[:listed], strict=True))
        model = Model.of(dataclasses.replace(robot, effects=entries), effects[listed:])
        theta = np.array([value for coefficients in values[listed:] for value in coefficients.values()])
        expected = model.bind(data).poses(theta)
        exact = dataclasses.replace(data, position=expected.translation)
        fitted = dataclasses.replace(fit(model, exact), theta=theta)
        written = apply_fit(fitted) if listed < 3 else absorb_constants(model.arm.robot)
        assert not written.effects
        if listed < 3:
            assert (
                apply_fit(dataclasses.replace(fitted, theta=0.0 * theta)).joints
                == absorb_constants(model.arm.robot).joints
            )
        found = predict(parse_robot(robot_to_yaml(written), "again.yaml"), data)
        # Rounding of the angles near the pole of roll, pitch and yaw.
        np.testing.assert_allclose(found.translation, expected.translation, rtol=0, atol=3e-15)
        np.testing.assert_allclose(found.rotation, expected.rotation, rtol=0, atol=3e-15)


def test_a_frame_at_the_pole_has_no_standard_error_of_roll_and_yaw() -> None:
    robot = dataclasses.replace(ur10(), base=Frame((0.1, 0.2, 0.3), (0.0, np.pi / 2, 0.0)))
    rng = np.random.default_rng(5)
    q = rng.uniform(-2, 2, (6, 40))
    exact = predict(robot, Measurements(position=np.zeros((3, 40)), q=q))
    data = Measurements(position=exact.translation + rng.normal(0, 1e-5, (3, 40)), q=q)
    fitted = {p.name: p for p in parameters(fit(Model.of(robot, [BaseFrame.default(Arm.of(robot), data)]), data))}
    pitch = fitted["base_frame.pitch"]
    assert abs(pitch.value - np.pi / 2) < 5 * pitch.std + 1e-4
    for label in ("roll", "yaw"):
        assert fitted[f"base_frame.{label}"].std is None
        assert "same axis" in (fitted[f"base_frame.{label}"].why)


def test_steps_whose_coefficients_share_names_keep_their_own_values() -> None:
    """All had the values of the last one."""
    robot, rng = ur10(), np.random.default_rng(5)
    q = rng.uniform(-2, 2, (6, 60))
    exact = predict(robot, Measurements(position=np.zeros((3, 60)), q=q))
    moved = np.repeat([[0.0, 1e-3, 3e-3], [0.0] * 3, [0.0] * 3], 20, axis=1)
    data = Measurements(exact.translation + moved, q=q, rows=np.arange(2, 62))
    steps = [Step((), "base", from_line=line) for line in (22, 42)]
    values = [p.value for p in parameters(fit(Model.of(robot, steps), data)) if p.name == "step.x"]
    np.testing.assert_allclose(values, (1e-3, 2e-3), rtol=1e-6)


def test_held_out_intervals_count_every_target_of_a_pose(tmp_path: Path) -> None:
    """Of N numbers and K coefficients they count as many poses as 1 / (1 / (1 - K / N) + K / N) of all."""
    text = Path("sample_data/robot.yaml").read_text(encoding="utf-8")
    lines = [line for line in text.splitlines() if not line.startswith("tool:")]
    places = {"a": [0, 0, 120], "b": [90, 0, 60], "c": [0, 80, 40]}
    targets = [f"  {name}: {{xyz: {xyz}}}" for name, xyz in places.items()]
    path = tmp_path / "robot.yaml"
    path.write_text("\n".join([*lines, "targets:", *targets]) + "\n", encoding="utf-8")
    made = robacc.simulate(path, poses=20, seed=3, noise="0.1mm", position_only=True)
    result = robacc.calibrate(made.data, robot=path, fit="base_frame,tool_frame,joint_offset", shrink=False)
    used = sum(parameter.std is not None for parameter in result.parameters) / (20 * 3 * 3)
    method = result.document()["after"]["held_out"]["position"]["intervals"]["rms_m"]["method"]
    found = re.search(r"20 poses, of which the fit leaves ([\d.]+)", method)
    assert found is not None, method
    assert float(found[1]) == pytest.approx(20 / (1 / (1 - used) + used), rel=0.01)
