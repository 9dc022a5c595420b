"""Predicted accuracy from tolerances, tolerance files, registered poses, and uncertainty beyond the ranges of a fit."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
from arms import arm
from described_arm import forward
from robot_files import example_robots
from scipy.spatial.transform import Rotation

from robacc import InputError, Measurements, Robot, UsageError, read_robot
from robacc.accuracy.grade import default_scale
from robacc.effects.base import Beyond
from robacc.effects.frames import JointOffset
from robacc.effects.periodic import TransmissionError
from robacc.fitting.parameters import apply_fit
from robacc.fitting.registration import registration_fit
from robacc.geometry import Array, compose, exp_so3, log_between
from robacc.modelling.model import Model, predict, residuals
from robacc.modelling.validity import outside_validity
from robacc.prediction.model_uncertainty import (
    ModelFit,
    beyond_columns,
    coverage,
    model_fit,
    model_uncertainty,
    registered_uncertainty,
)
from robacc.prediction.predicting import (
    Prediction,
    ToleranceParameter,
    allocate,
    configurations_of,
    outer_sums,
    parse_tolerances,
    pose_covariances,
    predict_accuracy,
    sampled_configurations,
    uncertain_parameters,
)
from robacc.robots.arm import BLOCK, Arm
from robacc.robots.description import DH_PARAMETERS, ORIGIN_PARAMETERS, Frame, Joint
from robacc.robots.yaml_robot import parse_robot, robot_to_yaml

ROBOTS = Path(__file__).resolve().parents[2] / "configs" / "robots"
FOUR = {"theta": 1e-4, "d": 1e-4, "a": 1e-4, "alpha": 1e-4}


def row(name: str, kind: str = "revolute", limits: tuple[float, float] | None = (-2.0, 2.0), **values: float) -> Joint:
    return Joint(name, kind, dict.fromkeys(DH_PARAMETERS, 0.0) | values, limits=limits, tolerance=FOUR)  # type: ignore[arg-type]


def planar(a1: float = 0.5, a2: float = 0.3) -> Robot:
    return Robot("2R", "standard", (row("j1", a=a1), row("j2", a=a2)))


def robot_of(name: str) -> Robot:
    """One of the four arms of the proof, all 4N (URDF: 7N) parameters with a tolerance."""
    if name != "ur10":
        return read_robot(ROBOTS / f"{name}.yaml")
    urdf = example_robots() / "ur_description/urdf/ur10_robot.urdf"
    return read_robot(urdf, base_link="base_link", tip_link="tool0")


def with_tolerances(robot: Robot, all: dict[str, float], name: str = "") -> Robot:
    """The robot with tolerances of every joint, or of one, in place of its own."""
    joints = tuple(
        dataclasses.replace(joint, tolerance={**joint.tolerance, **all})
        if joint.type != "fixed" and name in ("", joint.name)
        else joint
        for joint in robot.joints
    )
    return dataclasses.replace(robot, joints=joints)


def toleranced(name: str) -> Robot:
    """An arm of the proof, with tolerances of the coordinates of a URDF's origins."""
    robot = robot_of(name)
    if robot.convention != "urdf":
        return robot
    lengths, angles = dict.fromkeys("xyz", 2e-4), dict.fromkeys(("roll", "pitch", "yaw", "offset"), 1.5e-4)
    robot = with_tolerances(robot, {**lengths, **angles})
    return dataclasses.replace(robot, base_tolerance={"x": 1e-4, "yaw": 1e-4}, tool_tolerance={"z": 3e-4})


def error_jacobian(robot: Robot, q: np.ndarray) -> np.ndarray:
    """``(P, 6)`` derivatives of the error [d; δ] in the tool's frame, equations (3) to (5), by the parameters."""
    parameters, step = uncertain_parameters(robot), 1e-5
    steps = step * np.concatenate((np.eye(len(parameters)), -np.eye(len(parameters))))
    errors: dict[str, dict[str, np.ndarray]] = {}
    for parameter, moved in zip(parameters, steps.T, strict=True):
        errors.setdefault(parameter.name.rpartition(".")[0], {})[parameter.kind] = moved
    relative = np.linalg.inv(forward(robot, q, {})) @ forward(robot, q, errors)
    turn = Rotation.from_matrix(relative[:, :3, :3]).as_rotvec()
    higher, lower = np.split(np.concatenate((relative[:, :3, 3], turn), axis=1), 2)
    return (higher - lower) / (2.0 * step)


@pytest.mark.parametrize("name", ["puma560", "stanford", "panda", "ur10"])
def test_covariances_are_those_of_the_exact_kinematics(name: str) -> None:
    """V = M S M^T, equations (7) and (8), with a different variance for every parameter, over more than a block."""
    robot, n = toleranced(name), BLOCK + 3
    configurations = sampled_configurations(robot, n, seed=4)
    parameters = [
        dataclasses.replace(parameter, sd=parameter.sd * (1.0 + 0.1 * i))
        for i, parameter in enumerate(uncertain_parameters(robot))
    ]
    covariances = pose_covariances(Arm.of(robot).chain, configurations.scalars, n, parameters)
    for k in (0, 1, n - 1):
        moved = error_jacobian(robot, configurations.q[:, k]) * np.array([[p.sd] for p in parameters])
        for part, columns in zip(covariances, (moved[:, :3], moved[:, 3:]), strict=False):
            expected = columns.T @ columns
            # Central differences with steps of 1e-5, of products of some twenty numbers.
            np.testing.assert_allclose(part[..., k], expected, rtol=0, atol=1e-8 * np.trace(expected))


def predicted(robot: Robot, n: int = 64) -> Prediction:
    parameters = uncertain_parameters(robot)
    return predict_accuracy(robot, parameters, sampled_configurations(robot, n), default_scale())


def test_budget_sums_to_one_and_equals_the_reduction_without_a_parameter() -> None:
    robot = robot_of("puma560")
    full = predicted(robot)
    for shares in (full.budget, full.by_joint, full.by_kind):
        sums = [sum(share[f"share_{quantity}"] for share in shares) for quantity in ("position", "orientation")]
        assert sums == pytest.approx([1.0, 1.0], abs=1e-12)
    share = next(share for share in full.budget if share["parameter"] == "j2.theta")
    without = predicted(with_tolerances(robot, {"theta": 0.0}, "j2"))
    assert len(without.parameters) == len(full.parameters) - 1
    assert 1 - (without.position.rms / full.position.rms) ** 2 == pytest.approx(share["share_position"], rel=1e-9)
    assert 1 - (without.orientation.rms / full.orientation.rms) ** 2 == pytest.approx(
        share["share_orientation"], rel=1e-9
    )
    assert np.all(np.diff([share["share_position"] for share in full.budget]) < 1e-9)


def test_figures_over_poses_and_the_worst_pose() -> None:
    prediction = predicted(robot_of("panda"), n=50)
    for errors in (prediction.position, prediction.orientation):
        traces = np.trace(errors.covariance)
        assert errors.rms == pytest.approx(np.sqrt(traces.mean()), rel=1e-12)
        worst, unit = errors.worst, errors.unit
        index = worst["pose"]
        assert index == np.flatnonzero(traces > traces.max() * (1 - 1e-9))[0]
        assert worst[f"rms_{unit}"] == pytest.approx(np.sqrt(traces.max()), rel=1e-12)
        np.testing.assert_array_equal(worst["q"], prediction.configurations.q[:, index])
        along = worst["direction"] @ errors.covariance[..., index] @ worst["direction"]
        assert along == pytest.approx(np.linalg.eigvalsh(errors.covariance[..., index])[-1], rel=1e-9)
        assert worst[f"sd_{unit}"] == pytest.approx(np.sqrt(along), rel=1e-9)
        assert errors.percentiles(errors.pose_rms)["p50"] == pytest.approx(np.median(errors.pose_rms))


def test_p95_is_that_of_robots_and_poses_drawn_at_random() -> None:
    prediction = predicted(robot_of("stanford"), n=40)
    rng = np.random.default_rng(5)
    roots = np.linalg.cholesky(np.moveaxis(prediction.position.covariance, -1, 0))
    lengths = np.linalg.norm(np.einsum("nij,nmj->nmi", roots, rng.standard_normal((40, 5000, 3))), axis=2)
    # 200,000 draws: the sample's 95th percentile is uncertain by some 0.15 %, its mean by 0.1 %.
    assert prediction.position.p95 == pytest.approx(np.quantile(lengths, 0.95), rel=0.008)
    assert prediction.position.mean_error == pytest.approx(lengths.mean(), rel=0.005)
    share_within = np.mean(lengths <= prediction.position.pose_radius95[:, None])
    assert share_within == pytest.approx(0.95, abs=0.003)


def test_grade_and_the_share_of_poses_that_meet_it() -> None:
    prediction = predicted(robot_of("puma560"))
    assert (prediction.grade["grade"], prediction.grade["limited_by"]) == ("D", ("position",))
    expected = np.mean(
        (prediction.position.pose_radius95 <= 0.5e-3) & (prediction.orientation.pose_radius95 <= np.deg2rad(0.5))
    )
    assert prediction.grade["share_of_poses_meeting"]["C"] == expected
    rough = predicted(with_tolerances(robot_of("puma560"), {"theta": 0.1}))
    assert rough.grade["grade"] == "F"
    assert not any(rough.grade["share_of_poses_meeting"].values())


@pytest.mark.parametrize("grade", ["A", "C"])
def test_allocation_reaches_the_grade_and_is_the_cheapest(grade: str) -> None:
    robot = robot_of("puma560")
    prediction = predicted(robot)
    allocation = allocate(robot, prediction, grade)
    limit = {"A": 1e-4, "C": 5e-4}[grade]
    assert allocation["met"]
    assert 0.998 * limit < allocation["verified"].position.p95 <= limit
    repeated = predict_accuracy(
        robot,
        [
            dataclasses.replace(parameter, sd=entry["needed_sd"])
            for parameter, entry in zip(prediction.parameters, allocation["tolerances"], strict=True)
        ],
        prediction.configurations,
        default_scale(),
    )
    assert repeated.position.p95 == allocation["verified"].position.p95
    factors = np.array([entry["factor"] for entry in allocation["tolerances"]])
    assert np.all(factors <= 1.0)
    assert allocation["uniform_factor"] == pytest.approx(limit / prediction.position.p95, rel=1e-9)
    # At the same total variance, no other allocation costs less: stationarity, 1/f^3 in proportion to the share.
    shares = {share["parameter"]: share["share_position"] for share in prediction.budget}
    share = np.array([shares[entry["parameter"]] for entry in allocation["tolerances"]])
    tightened = factors < 1.0 - 1e-9
    price = factors[tightened] ** -3 / share[tightened]
    np.testing.assert_allclose(price, price[0], rtol=1e-6)
    assert np.all(price[0] * share[~tightened] <= 1.0 + 1e-6)
    assert np.sum(1 / factors) < factors.size / allocation["uniform_factor"]


def test_allocation_keeps_sufficient_tolerances_and_meets_two_limits() -> None:
    robot = robot_of("puma560")
    prediction = predicted(robot)
    assert all(entry["factor"] == 1.0 for entry in allocate(robot, prediction, "E")["tolerances"])
    rough = predicted(with_tolerances(robot, {"theta": 2e-3, "alpha": 2e-3}))
    allocation = allocate(robot, rough, "A")
    assert allocation["met"]
    assert allocation["verified"].grade["grade"] == "A"
    assert allocation["verified"].orientation.p95 <= np.deg2rad(0.1)
    # Lengths alone turn nothing: the orientation has no variance to allocate.
    lengths = predicted(with_tolerances(robot, {"theta": 0.0, "alpha": 0.0, "beta": 0.0, "a": 3e-4, "d": 3e-4}))
    assert allocate(robot, lengths, "B")["met"]
    with pytest.raises(UsageError, match=r"no grade 'Z' on the scale .*; it has A, B, C, D, E"):
        allocate(robot, prediction, "Z")


def test_samples_fill_the_limits_evenly_and_depend_on_the_seed() -> None:
    robot = robot_of("puma560")
    first, repeated, other_seed = (sampled_configurations(robot, 512, seed).q for seed in (0, 0, 1))
    np.testing.assert_array_equal(first, repeated)
    assert not np.array_equal(first, other_seed)
    limits = np.array([joint.limits for joint in robot.variables])
    shares = (first - limits[:, :1]) / (limits[:, 1:] - limits[:, :1])
    assert shares.min() >= 0
    assert shares.max() <= 1
    # Random points would miss the mean of the cube by 0.013; these by some 0.001.
    np.testing.assert_allclose(shares.mean(axis=1), 0.5, atol=4e-3)


def test_configurations_that_cannot_be_sampled() -> None:
    slide = Robot("slide", "standard", (row("s", "prismatic", None), row("r", limits=None)))
    for refusal, call, message in (
        (
            InputError,
            lambda: sampled_configurations(slide, 4),
            "the prismatic joint s has no limits to spread configurations over; give it limits",
        ),
        (UsageError, lambda: sampled_configurations(planar(), 0), "`samples` is at least 1, not 0"),
        (
            UsageError,
            lambda: sampled_configurations(planar(), 4, target="smr1"),
            "no target 'smr1'; the robot file has no targets",
        ),
        (
            InputError,
            lambda: configurations_of(planar(), Measurements(np.zeros((3, 2)))),
            "has no joint columns: the prediction needs the joint values",
        ),
        (
            InputError,
            lambda: configurations_of(planar(), Measurements(np.zeros((3, 0)), q=np.zeros((2, 0)))),
            "has no poses to predict the accuracy at",
        ),
    ):
        with pytest.raises(refusal, match=message):
            call()
    endless = Robot("endless", "standard", (row("r", limits=None),))
    configurations = sampled_configurations(endless, 100)
    assert configurations.notes == ("joint r without limits: sampled over a full turn",)
    assert np.ptp(configurations.q) > 6.0


def test_targets_are_predicted_each_by_itself() -> None:
    frames = {"near": Frame((0.0, 0.0, 0.0)), "far": Frame((0.0, 0.4, 0.3))}
    robot = dataclasses.replace(robot_of("puma560"), targets=frames)
    single = {name: dataclasses.replace(robot, tool=value, targets={}) for name, value in frames.items()}
    chosen = sampled_configurations(robot, 16, target="far")
    assert chosen.notes == ()
    assert sampled_configurations(robot, 16).notes[0].startswith("predicted for the target near, the first of 2")
    parameters = uncertain_parameters(robot)
    far = predict_accuracy(robot, parameters, chosen, default_scale())
    assert far.position.rms == pytest.approx(predicted(single["far"], 16).position.rms, rel=1e-12)
    with pytest.raises(UsageError, match="no target 'left'; the robot file has near, far"):
        sampled_configurations(robot, 4, target="left")
    data = Measurements(np.zeros((3, 16)), q=chosen.q, target=np.array(["near", "far"] * 8))
    mixed = pose_covariances(Arm.of(robot).chain, configurations_of(robot, data).scalars, 16, parameters)
    np.testing.assert_allclose(mixed[0][..., 1::2], far.position.covariance[..., 1::2], rtol=1e-9, atol=1e-20)


DH = Robot(
    "dh",
    "standard",
    (
        Joint("j1", "revolute", dict.fromkeys(DH_PARAMETERS, 0.0), tolerance={"theta": 1e-3, "a": 2e-3}),
        Joint("slide", "prismatic", dict.fromkeys(DH_PARAMETERS, 0.0)),
    ),
    base_tolerance={"x": 5e-4},
)
BARE = Robot("bare", "standard", (Joint("j1", "revolute", dict.fromkeys(DH_PARAMETERS, 0.0)),))
URDF = Robot(
    "urdf",
    "urdf",
    (
        Joint("mount", "fixed", dict.fromkeys(ORIGIN_PARAMETERS, 0.0)),
        Joint("lift", "prismatic", dict.fromkeys(ORIGIN_PARAMETERS, 0.0)),
        Joint("turn", "revolute", dict.fromkeys(ORIGIN_PARAMETERS, 0.0)),
    ),
)
UNITS = "units: {length: mm, angle: deg}\n"


def read(text: str, robot: Robot = DH) -> dict[str, ToleranceParameter]:
    toleranced, _ = parse_tolerances(UNITS + text, "t.yaml", robot)
    return {parameter.name: parameter for parameter in uncertain_parameters(toleranced)}


def complaint(text: str, robot: Robot = DH) -> str:
    with pytest.raises(InputError) as caught:
        parse_tolerances(text, "t.yaml", robot)
    return str(caught.value)


def test_the_files_go_before_the_robots_own_parameter_by_parameter() -> None:
    parameters = read("all: {theta: 0.1, d: 0.2}\njoints:\n  slide: {d: 0.5}\nbase: {yaw: 0.3}\ntool: {z: 1}\n")
    assert {name: parameter.sd for name, parameter in parameters.items()} == pytest.approx(
        {
            "base.x": 5e-4,
            "base.yaw": math.radians(0.3),
            "j1.theta": math.radians(0.1),
            "j1.d": 2e-4,
            "j1.a": 2e-3,
            "slide.theta": math.radians(0.1),
            "slide.d": 5e-4,
            "tool.z": 1e-3,
        }
    )
    assert parameters["base.x"].joint is None
    assert (parameters["slide.d"].joint, parameters["slide.d"].kind, parameters["slide.d"].unit) == ("slide", "d", "m")


def test_a_zero_says_that_a_parameter_is_exact() -> None:
    assert "j1.a" not in read("joints: {j1: {a: 0}}")


@pytest.mark.parametrize(
    ("text", "divisor", "meaning"),
    [
        ("", 1.0, "normal: a tolerance t is one standard deviation, variance t²"),
        ("distribution: normal\n", 1.0, "normal: a tolerance t is one standard deviation, variance t²"),
        ("distribution: uniform\n", math.sqrt(3), "uniform: a tolerance t is the half width, variance t²/3"),
        ("distribution: limits\n", 3.0, "limits: a tolerance t is 3 standard deviations, variance (t/3)²"),
        ("distribution: limits\ncoverage: 2\n", 2.0, "limits: a tolerance t is 2 standard deviations, variance (t/2)²"),
    ],
)
def test_how_a_tolerance_becomes_a_standard_deviation(text: str, divisor: float, meaning: str) -> None:
    content = UNITS + text + "all: {d: 0.3}"
    robot, stated = parse_tolerances(content, "t.yaml", BARE)
    assert (robot.joints[0].tolerance["d"], stated) == (pytest.approx(3e-4 / divisor), meaning)


def test_a_urdf_has_tolerances_per_coordinate_of_its_origins() -> None:
    parameters = read(
        "all: {x: 0.1, yaw: 0.2}\njoints: {mount: {z: 1}, lift: {offset: 0.5}, turn: {offset: 0.5}}", URDF
    )
    # "all" is of moving joints: a fixed one often only names a frame.
    assert {name: parameter.sd for name, parameter in parameters.items()} == pytest.approx(
        {
            "mount.z": 1e-3,
            "lift.x": 1e-4,
            "lift.yaw": math.radians(0.2),
            "lift.offset": 5e-4,
            "turn.x": 1e-4,
            "turn.yaw": math.radians(0.2),
            "turn.offset": math.radians(0.5),
        }
    )
    assert {parameter.component for parameter in parameters.values()} == {"offset", "origin_length", "origin_angle"}
    assert parameters["lift.offset"].unit == "m"


def test_no_tolerance_at_all_is_an_error_that_shows_how_to_give_them() -> None:
    with pytest.raises(
        InputError, match="no parameter of bare has a tolerance, so no error can be predicted"
    ) as caught:
        uncertain_parameters(BARE)
    assert "all: {theta: 0.006, d: 0.1, a: 0.1, alpha: 0.006}" in str(caught.value)
    with pytest.raises(InputError, match=r"all: \{x: 0.1, y: 0.1, z: 0.1, offset: 0.01\}"):
        uncertain_parameters(URDF)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[1]", "t.yaml:1: expected keys with values (units, distribution, coverage, all, joints, base, tool)"),
        ("all: {d: 1}", "t.yaml:1, units: is missing"),
        ("units: {length: mm}\nall: {d: 1}", "t.yaml:1, units.angle: is missing"),
        ("units: {length: inch, angle: deg}\nall: {d: 1}", "t.yaml:1, units.length: expected m or mm, found 'inch'"),
        (UNITS, "t.yaml: no tolerance is given; add all, joints, base or tool"),
        (UNITS + "all: {d: -1}", "t.yaml:2, all.d: a tolerance cannot be negative, found '-1'"),
        (UNITS + "all: {depth: 1}", "t.yaml:2, all.depth: unknown key"),
        (UNITS + "all: {x: 1}", "t.yaml:2, all.x: unknown key"),
        (UNITS + "joints: {j1: {d: wide}}", "t.yaml:2, joints.j1.d: expected a number, found 'wide'"),
        (UNITS + "joints: {j11: {d: 1}}", "t.yaml:2, joints.j11: the robot has no such joint; did you mean 'j1'?"),
        (UNITS + "joints: {q: {d: 1}}", "the robot has no such joint; the joints are j1, slide"),
        (UNITS + "joints: [1]", "t.yaml:2, joints: expected names of joints with tolerances, found a list of 1"),
        (UNITS + "distribution: flat\nall: {d: 1}", "expected normal or uniform or limits, found 'flat'"),
        (
            UNITS + "coverage: 2\nall: {d: 1}",
            "t.yaml:2, coverage: applies only to limits; write distribution: limits",
        ),
        (
            UNITS + "distribution: limits\ncoverage: 0\nall: {d: 1}",
            "t.yaml:3, coverage: found 0, expected standard deviations, above 0 and at most 10",
        ),
    ],
)
def test_complaints(text: str, message: str) -> None:
    assert message in complaint(text)


def test_all_cannot_give_one_offset_to_turns_and_slides() -> None:
    text = complaint(UNITS + "all: {offset: 1}", URDF)
    assert "t.yaml:2, all.offset: offset is an angle of revolute joints and a length of prismatic joints" in text


def test_all_problems_are_reported_at_once() -> None:
    text = complaint(UNITS + "all: {d: -1}\njoints: {j9: {d: 1}}\nbase: {w: 1}\n")
    assert len(text.splitlines()) == 3


LOW, HIGH, SIZE = -0.6, 0.4, 3e-4
OFFSET_STD, UNEXPLAINED_STD = 4e-4, (3e-5, 5e-5)
FRAMES = ("base_frame", "tool_frame")


def model() -> tuple[Robot, ModelFit]:
    entry = {
        "effect": "transmission_error",
        "joints": ["j2"],
        "orders": [2.0],
        "values": {"j2.cos2": SIZE, "j2.sin2": 0.0},
        "validity": {"j2": [LOW, HIGH]},
    }
    robot = dataclasses.replace(arm("puma560").robot, effects=(entry,))
    fit = ModelFit(
        effects=(JointOffset(("j3",)),),
        coefficients=("joint_offset.j3",),
        covariance=np.array([[OFFSET_STD**2]]),
        nominal={},
        repeatability={},
        unexplained=np.diag(np.repeat(np.square(UNEXPLAINED_STD), 3)),
        noise=(0.0, 0.0),
        noise_is_separate=False,
        bound_factor=(1.0, 1.0),
        largest_correction=(1e-3, 1e-3),
        ranges={},
        n_poses=100,
    )
    return robot, fit


def test_a_model_of_many_coefficients_is_read_again() -> None:
    """Six profiles and a process of a UR10 have 1,430 coefficients: the file of its model was refused as too large."""
    (robot, fit), size = model(), 1500
    covariance = np.outer(*[np.random.default_rng(0).standard_normal(size)] * 2) + np.eye(size)
    record = dataclasses.replace(fit, coefficients=tuple(f"c{k}" for k in range(size)), covariance=covariance)
    text = robot_to_yaml(dataclasses.replace(robot, fit=record.entry()))
    again = model_fit(parse_robot(text, "model.yaml"))
    assert again is not None
    np.testing.assert_allclose(again.covariance, covariance, rtol=1e-11)


def drawn(robot: Robot, data: Measurements, rng: np.random.Generator) -> Measurements:
    """Measured poses of an arm whose errors are a draw of the model's uncertainty."""
    q = np.array(data.q)
    q[2] += OFFSET_STD * rng.standard_normal()
    # The error of joint 2 is a process of its angle with a correlation length of a twentieth of the range.
    second = data.q[1]  # type: ignore[index]
    places = np.concatenate((second, np.clip(second, LOW, HIGH)))
    kernel = np.exp(-0.5 * np.square((places[:, None] - places) / (0.05 * (HIGH - LOW))))
    values = np.linalg.cholesky(kernel + 1e-9 * np.eye(places.size)) @ rng.standard_normal(places.size)
    n = data.n
    step = (values[:n] - values[n:]) / np.sqrt(np.maximum(2.0 * (1.0 - np.diag(kernel[:n, n:])), 1e-12))
    excess = np.maximum(np.maximum(LOW - second, second - HIGH), 0.0) / (HIGH - LOW)
    growth = np.where(excess > 0.01, np.minimum(10 * excess, 1.0), 0.0)
    angles = np.linspace(LOW, HIGH, 1001)
    q[1] += np.sqrt(2.0 * np.mean(np.square(SIZE * np.cos(2 * angles)))) * growth * step
    # The known ripple stays that of the commanded joints.
    still = dataclasses.replace(robot, effects=())
    known = predict(robot, data)
    nominal, moved = predict(still, data), predict(still, dataclasses.replace(data, q=q))
    rotation = compose(moved.rotation, compose(nominal.rotation.transpose(1, 0, 2), known.rotation))
    position = known.translation + moved.translation - nominal.translation
    position = position + UNEXPLAINED_STD[0] * rng.standard_normal((3, n))
    turned = compose(rotation, exp_so3(UNEXPLAINED_STD[1] * rng.standard_normal((3, n))))
    return dataclasses.replace(data, position=position, rotation=turned)


def moments(error: list[Array]) -> Array:
    """Root mean square of every component over draws, ``(6, N)``."""
    return np.sqrt(np.mean(np.square(error), axis=0))


def test_covariance_after_a_registration_is_that_of_registered_draws() -> None:
    robot, fit = model()
    rng = np.random.default_rng(4)
    q = rng.uniform(-1.2, 1.2, (6, 48))
    empty = Measurements(np.zeros((3, 48)), q=q, rotation=np.tile(np.eye(3)[:, :, None], (1, 1, 48)))
    used, judged = np.arange(32), np.arange(32, 48)
    errors, bare = [], []
    for _ in range(70):
        data = drawn(robot, empty, rng)
        registration = registration_fit(robot, data.subset(used), FRAMES)
        part = data.subset(judged)
        errors.append(residuals(part, predict(apply_fit(registration), part)))
        bare.append(residuals(part, predict(robot, part)))
    position, orientation = registered_uncertainty(robot, fit, empty.subset(judged), registration, data.subset(used))
    predicted = np.sqrt(np.concatenate((np.einsum("iin->in", position), np.einsum("iin->in", orientation))))
    ratio = moments(errors) / predicted
    # A standard deviation of 70 draws is known within 8.5 %; the mean over 48 correlated ones within some 4 %. With
    # 1,500 draws the ratios are 0.90 to 1.04.
    assert 0.9 < np.sqrt(np.mean(np.square(ratio[:3]))) < 1.1
    assert 0.9 < np.sqrt(np.mean(np.square(ratio[3:]))) < 1.1
    assert 0.65 < ratio.min() < ratio.max() < 1.4
    # Without the registration, it is the covariance of the model alone, which is another one.
    alone = model_uncertainty(robot, fit, empty.subset(judged), measured=True)[0]
    expected = np.sqrt(np.concatenate([np.einsum("iin->in", part) for part in alone]))
    assert 0.9 < np.sqrt(np.mean(np.square(moments(bare) / expected))) < 1.1
    assert np.abs(predicted / expected - 1.0).max() > 0.3


def measured_at(robot: Robot, q: Array) -> Measurements:
    """Measured poses of the arm as the model has it, with noise."""
    random = np.random.default_rng(12)
    data = Measurements(np.zeros((3, q.shape[1])), q=q)
    poses = predict(robot, data)
    return dataclasses.replace(
        data,
        position=poses.translation + 1e-5 * random.standard_normal(poses.translation.shape),
        rotation=compose(exp_so3(2e-5 * random.standard_normal((3, q.shape[1]))), poses.rotation),
    )


def test_frames_cannot_be_fitted_to_a_half_of_a_single_pose() -> None:
    robot, fit = model()
    q = np.repeat(np.random.default_rng(5).uniform(LOW, HIGH, (6, 1)), 30, axis=1)
    with pytest.raises(InputError, match="cannot be fitted to one half of the poses: all are the same commanded pose"):
        coverage(robot, fit, measured_at(robot, q), 0, aligned=FRAMES)


def test_repeats_of_a_pose_stay_in_its_half() -> None:
    robot, fit = model()
    once = np.random.default_rng(5).uniform(LOW, HIGH, (6, 12))
    repeated = measured_at(robot, np.repeat(once, 10, axis=1))
    covered = coverage(robot, fit, repeated, 0, aligned=FRAMES, noise=(1e-5, 2e-5))
    # The bounds have the uncertainty of a joint's zero, ten times the noise of these poses.
    shares = [covered[name]["share"] for name in ("position", "orientation")]
    assert (shares, covered["registered"]) == ([1.0, 1.0], FRAMES)


def test_bounds_have_the_correlation_of_the_noise() -> None:
    robot, fit = model()
    fit, n = dataclasses.replace(fit, noise_is_separate=True), 2000
    data = measured_at(robot, np.random.default_rng(6).uniform(LOW, HIGH, (6, n)))
    # 1 mm along one direction, to which the model's own error adds little: without the correlation, 92 % are inside.
    line = np.array([[1.0], [1.0], [0.0]]) / np.sqrt(2.0)
    noise = 1e-6 * line @ line.T + 1e-12 * np.eye(3)
    data = dataclasses.replace(
        data,
        position=data.position + 1e-3 * line * np.random.default_rng(7).standard_normal(n),
        sigma_position=np.repeat(np.sqrt(np.diag(noise))[:, None], n, axis=1),
        noise_covariance=np.repeat(noise[:, :, None], n, axis=2),
    )
    # Three standard errors of a share.
    assert coverage(robot, fit, data, 0)["position"]["share"] == pytest.approx(0.95, abs=0.015)


COS, SIN = 2e-4, -1e-4
LOW_OF_EXTRAPOLATION, HIGH_OF_EXTRAPOLATION = -1.0, 0.6


def ripple() -> Robot:
    """An arm with a periodic error of its second joint, fitted between LOW and HIGH."""
    entry = {
        "effect": "transmission_error",
        "joints": ["j2"],
        "orders": [2.0],
        "values": {"j2.cos2": COS, "j2.sin2": SIN},
        "validity": {"j2": [LOW_OF_EXTRAPOLATION, HIGH_OF_EXTRAPOLATION]},
    }
    return dataclasses.replace(arm("puma560").robot, effects=(entry,))


def geared(ratio: float) -> Robot:
    """The arm with a periodic error of several orders, and a gear ratio of its second joint."""
    robot = ripple()
    joints = tuple(dataclasses.replace(j, gear_ratio=ratio) if j.name == "j2" else j for j in robot.joints)
    return dataclasses.replace(robot, joints=joints, effects=({**robot.effects[0], "orders": [2.0, 5.0]},))


def poses_at(second: np.ndarray | float, n: int = 5) -> Measurements:
    """Poses with these variables of the second joint."""
    q = np.random.default_rng(3).uniform(-1, 1, (6, np.size(second) if np.ndim(second) else n))
    q[1] = second
    return Measurements(np.zeros((3, q.shape[1])), q=q)


def test_no_pose_beyond_the_range_has_an_extrapolation() -> None:
    assert beyond_columns(Model.of(ripple()), poses_at(HIGH_OF_EXTRAPOLATION)).shape[1] == 0


def test_beyond_the_range_the_joint_is_uncertain_by_the_size_of_the_effect() -> None:
    robot = ripple()
    data = poses_at(HIGH_OF_EXTRAPOLATION + 0.5 * (HIGH_OF_EXTRAPOLATION - LOW_OF_EXTRAPOLATION))
    covariance = outer_sums(beyond_columns(Model.of(robot), data))
    step = 1e-6
    moved = dataclasses.replace(data, q=data.q + step * np.eye(6)[1][:, None])
    still = dataclasses.replace(robot, effects=())
    first, second = predict(still, data), predict(still, moved)
    slope = np.vstack(
        ((second.translation - first.translation) / step, log_between(second.rotation, first.rotation) / step)
    )
    angles = np.linspace(LOW_OF_EXTRAPOLATION, HIGH_OF_EXTRAPOLATION, 2001)
    square = np.mean((COS * np.cos(2 * angles) + SIN * np.sin(2 * angles)) ** 2)
    expected = 2.0 * square * np.einsum("in,jn->ijn", slope, slope)
    # 200 samples of the range against 2,001, and the ripple itself changes the slope by 1e-4.
    np.testing.assert_allclose(covariance, expected, rtol=2e-2, atol=1e-3 * float(np.abs(expected).max()))


@pytest.mark.parametrize("periodic", [True, False])
def test_the_uncertainty_grows_with_the_distance(periodic: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    model = Model.of(ripple())
    effect = type(model.known[0].effect)
    monkeypatch.setattr(effect, "traits", effect.traits._replace(is_bounded=periodic))
    if not periodic:
        monkeypatch.setattr(effect, "beyond", lambda *_: Beyond(is_held=True))
    sizes = []
    for share in (0.02, 0.05, 0.1, 0.9, 2.0):
        covariance = outer_sums(
            beyond_columns(
                model, poses_at(HIGH_OF_EXTRAPOLATION + share * (HIGH_OF_EXTRAPOLATION - LOW_OF_EXTRAPOLATION), 1)
            )
        )
        reference = outer_sums(
            beyond_columns(
                model, poses_at(HIGH_OF_EXTRAPOLATION + 0.5 * (HIGH_OF_EXTRAPOLATION - LOW_OF_EXTRAPOLATION), 1)
            )
        )
        sizes.append(float(np.trace(covariance[3:, 3:, 0])) / float(np.trace(reference[3:, 3:, 0])))
    expected = [0.04, 0.25, 1.0, 1.0, 4.0]
    if periodic:
        # Order 2 repeats after half a turn: 0.9 of the range is just before the next lower end, twice the range just
        # behind the next upper end.
        reach = HIGH_OF_EXTRAPOLATION - LOW_OF_EXTRAPOLATION
        beyond = (math.pi - 1.9 * reach, 3.0 * reach - reach - math.pi)
        expected[3:] = [(10.0 * excess / reach) ** 2 for excess in beyond]
    assert sizes == pytest.approx(expected, rel=1e-6)


def test_a_pose_whole_turns_away_is_where_the_gear_was() -> None:
    robot = geared(100.0)
    near, far = poses_at(0.5), poses_at(0.5 + 2.0 * math.pi)
    assert beyond_columns(Model.of(robot), far).shape[1] == 0
    np.testing.assert_allclose(predict(robot, near).translation, predict(robot, far).translation, atol=1e-12)
    assert outside_validity(robot, far) is None or outside_validity(robot, far).n_poses == 0  # type: ignore[union-attr]
    # Between the ends, the effect keeps the value of the nearest end, a turn away or not.
    between = LOW_OF_EXTRAPOLATION + 2.0 * math.pi - 0.1
    first, second = predict(robot, poses_at(between)), predict(robot, poses_at(between - 2.0 * math.pi))
    np.testing.assert_allclose(first.translation, second.translation, atol=1e-12)


def test_a_gear_of_a_ratio_that_is_not_whole_repeats_nothing() -> None:
    assert beyond_columns(Model.of(geared(107.815)), poses_at(0.5 + 2.0 * math.pi)).any()


ORDERS = tuple(float(order) for order in range(1, 21))
STD, NOISE = 3e-5, 2e-5
"""rad: prior of each coefficient, and noise of a measured angle."""


def basis(angle: np.ndarray) -> np.ndarray:
    """Cosine and sine ``(n, 2 Q)`` of each order, in the order of the effect's coefficients."""
    phase = np.multiply.outer(angle, ORDERS)
    return np.stack((np.cos(phase), np.sin(phase)), axis=-1).reshape(len(angle), -1)


PERIOD = 2.0 * np.pi / ORDERS[-1]
"""Of the finest order, rad."""


def left(angle: np.ndarray) -> np.ndarray:
    """Regressors ``(n, 2 Q)`` that are left of a profile: beyond the range, their mean over one period at its end."""
    image = angle - 2.0 * np.pi * np.round(
        (angle - 0.5 * (LOW_OF_EXTRAPOLATION + HIGH_OF_EXTRAPOLATION)) / (2.0 * np.pi)
    )
    beyond = np.maximum(np.maximum(LOW_OF_EXTRAPOLATION - image, image - HIGH_OF_EXTRAPOLATION), 0.0)
    share = np.exp(-0.5 * np.square(beyond / (PERIOD / 4.0)))[:, None]
    inside = PERIOD * (np.arange(4000) + 0.5) / 4000
    at_low, at_high = (
        basis(LOW_OF_EXTRAPOLATION + inside).mean(axis=0),
        basis(HIGH_OF_EXTRAPOLATION - inside).mean(axis=0),
    )
    of_other = (beyond / (2.0 * np.pi - (HIGH_OF_EXTRAPOLATION - LOW_OF_EXTRAPOLATION)))[:, None]
    of_low = np.where(image[:, None] < LOW_OF_EXTRAPOLATION, 1.0 - of_other, of_other)
    return np.asarray(share * basis(angle) + (1.0 - share) * (of_low * at_low + (1.0 - of_low) * at_high))


def posterior(angle: np.ndarray) -> np.ndarray:
    """Covariance of the coefficients from measured angles."""
    design = basis(angle)
    return np.linalg.inv(design.T @ design / NOISE**2 + np.eye(design.shape[1]) / STD**2)


def names() -> list[str]:
    return [f"{kind}{order:g}" for order in ORDERS for kind in ("cos", "sin")]


def fitted(values: np.ndarray, covariance: np.ndarray) -> tuple[Robot, ModelFit]:
    """A Puma with a fitted profile of its second joint, and the record of the fit."""
    effect = TransmissionError(("j2",), ORDERS, True)
    entry = {
        "effect": effect.name,
        "joints": ["j2"],
        "orders": list(ORDERS),
        "shrunk": True,
        "values": {f"j2.{name}": float(value) for name, value in zip(names(), values, strict=True)},
        "validity": {"j2": [LOW_OF_EXTRAPOLATION, HIGH_OF_EXTRAPOLATION]},
    }
    record = ModelFit(
        effects=(effect,),
        coefficients=tuple(f"{effect.name}.j2.{name}" for name in names()),
        covariance=covariance,
        nominal={},
        repeatability={},
        unexplained=np.zeros((6, 6)),
        noise=(0.0, 0.0),
        noise_is_separate=False,
        bound_factor=(1.0, 1.0),
        largest_correction=(1e-3, 1e-3),
        ranges={"j2": (LOW_OF_EXTRAPOLATION, HIGH_OF_EXTRAPOLATION)},
        n_poses=100,
    )
    robot = arm("puma560").robot
    joints = tuple(dataclasses.replace(joint, gear_ratio=100.0) for joint in robot.joints)
    return dataclasses.replace(robot, joints=joints, effects=(entry,)), record


def joint_variance(second: np.ndarray, covariance: np.ndarray, values: np.ndarray | None = None) -> np.ndarray:
    """Variance of the second joint's error that the library states, from that of the orientation (a turn of 1)."""
    robot, record = fitted(np.zeros(covariance.shape[0]) if values is None else values, covariance)
    (_, orientation), _, _ = model_uncertainty(robot, record, poses_at(second), measured=True)
    return np.einsum("iin->n", orientation)


TRAINED = np.random.default_rng(1).uniform(LOW_OF_EXTRAPOLATION, HIGH_OF_EXTRAPOLATION, 150)
PLACES = np.array([-1.9, -1.1, LOW_OF_EXTRAPOLATION, -0.3, HIGH_OF_EXTRAPOLATION, 0.65, 0.8, 1.4, 0.2 + 2 * np.pi])
HERE, FADED = basis(PLACES), basis(PLACES) - left(PLACES)


def written_out(covariance: np.ndarray, values: np.ndarray) -> np.ndarray:
    """As :func:`joint_variance`: of the posterior, and the square of what fades."""
    return np.asarray(np.einsum("np,pq,nq->n", HERE, covariance, HERE) + np.square(FADED @ values))


def test_the_variance_is_that_of_the_posterior_and_of_what_fades() -> None:
    covariance, values = posterior(TRAINED), STD * np.random.default_rng(5).normal(size=2 * len(ORDERS))
    np.testing.assert_allclose(joint_variance(PLACES, covariance), written_out(covariance, 0.0 * values), rtol=1e-9)
    expected = written_out(covariance, values)
    # The level is a mean over 32 places: of the order that changes most there it is 1e-4 of its size off.
    np.testing.assert_allclose(joint_variance(PLACES, covariance, values), expected, rtol=1e-3)
    # Far from the range the posterior is the prior, of all orders.
    prior = len(ORDERS) * STD**2
    assert joint_variance(PLACES, covariance)[0] == pytest.approx(prior, rel=0.1)
    assert expected[3] < 0.05 * prior


def turned_by(robot: Robot, second: np.ndarray) -> np.ndarray:
    """Angles ``(N,)`` by which the effects turn the target."""
    data = poses_at(second)
    still = dataclasses.replace(robot, effects=())
    return np.linalg.norm(log_between(predict(robot, data).rotation, predict(still, data).rotation), axis=0)


@pytest.mark.parametrize("beyond", [0.0, 0.02, 0.1, 0.5])
def test_the_profile_fades_to_its_level_within_a_quarter_of_its_finest_period(beyond: float) -> None:
    values = STD * np.random.default_rng(2).normal(size=2 * len(ORDERS))
    robot, _ = fitted(values, posterior(TRAINED))
    angle = np.array([LOW_OF_EXTRAPOLATION - beyond])
    assert turned_by(robot, angle) == pytest.approx(np.abs(left(angle) @ values), rel=1e-3)
    outside = outside_validity(robot, poses_at(angle))
    assert (outside.std_max > 0.0) is (beyond > 0.016)
    assert all(item["rule"] != "held" for item in outside.ranges)


def test_a_gear_that_does_not_repeat_itself_is_held() -> None:
    values = STD * np.ones(2 * len(ORDERS))
    robot, _ = fitted(values, posterior(TRAINED))
    joints = tuple(dataclasses.replace(j, gear_ratio=107.8) if j.name == "j2" else j for j in robot.joints)
    robot = dataclasses.replace(robot, joints=joints)
    at_the_end = abs(float((basis(np.array([HIGH_OF_EXTRAPOLATION])) @ values)[0]))
    assert turned_by(robot, np.array([HIGH_OF_EXTRAPOLATION, HIGH_OF_EXTRAPOLATION + 0.5])) == pytest.approx(
        at_the_end, rel=1e-6
    )
