"""Equations (6) to (8) against matrices written out, finite differences, and a Monte Carlo without any Jacobian."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from homogeneous import frame, shift, turn
from paper_matrices import error_matrices
from robot_files import example_robots
from scipy.spatial.transform import Rotation

from robacc.accuracy.grade import default_scale
from robacc.errors import InputError, UsageError
from robacc.measurements import Measurements
from robacc.modelling.robot_file import read_robot
from robacc.prediction.predicting import (
    Prediction,
    allocate,
    configurations_of,
    pose_covariances,
    predict_accuracy,
    sampled_configurations,
    uncertain_parameters,
)
from robacc.robots.arm import BLOCK, Arm
from robacc.robots.description import DH_PARAMETERS, Frame, Joint, Robot

ROBOTS = Path(__file__).resolve().parents[2] / "configs" / "robots"
FOUR = {"theta": 1e-4, "d": 1e-4, "a": 1e-4, "alpha": 1e-4}


def row(name: str, kind: str = "revolute", limits: tuple[float, float] | None = (-2.0, 2.0), **values: float) -> Joint:
    parameters = dict.fromkeys(DH_PARAMETERS, 0.0) | values
    return Joint(name, kind, parameters, limits=limits, tolerance=FOUR)  # type: ignore[arg-type]


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


def frame_with(value: Frame, errors: Mapping[str, np.ndarray]) -> np.ndarray:
    xyz = [value.xyz[i] + errors.get(name, 0.0) for i, name in enumerate("xyz")]
    nominal = frame(xyz, value.rpy)
    for axis, name in enumerate(("roll", "pitch", "yaw")):
        nominal = nominal @ turn(axis, errors.get(name, 0.0))
    return nominal


def link(joint: Joint, convention: str, q: float, errors: Mapping[str, np.ndarray]) -> np.ndarray:
    """A joint's transform from the textbook's definition, each parameter with its errors ``(M,)``; no chain."""
    p = {name: value + errors.get(name, 0.0) for name, value in joint.parameters.items()}
    if convention == "urdf":
        xyz, rpy = ([joint.parameters[k] for k in names] for names in ("xyz", ("roll", "pitch", "yaw")))
        before = frame_with(Frame(tuple(xyz), tuple(rpy)), errors)
        if joint.type == "fixed":
            return before
        angle = np.atleast_1d(q + p["offset"])
        result = np.tile(np.eye(4), (angle.size, 1, 1))
        result[:, :3, :3] = Rotation.from_rotvec(angle[:, None] * np.array(joint.axis)).as_matrix()
        return before @ result
    p["theta" if joint.type == "revolute" else "d"] += joint.sign * q
    z = turn(2, p["theta"]) @ shift(z=p["d"])
    x, along, y = turn(0, p["alpha"]), shift(p["a"]), turn(1, p["beta"])
    return z @ along @ x @ y if convention == "standard" else x @ along @ y @ z


def forward(robot: Robot, q: np.ndarray, errors: Mapping[str, Mapping[str, np.ndarray]]) -> np.ndarray:
    """Tool pose ``(M, 4, 4)`` at one configuration, with errors by owner and parameter."""
    pose = np.eye(4)[None] @ frame_with(robot.base, errors.get("base", {}))
    values = iter(q)
    for joint in robot.joints:
        joint_errors = errors.get(joint.name, {})
        pose = pose @ link(joint, robot.convention, next(values) if joint.is_variable else 0.0, joint_errors)
    return pose @ frame_with(robot.tool, errors.get("tool", {}))


def monte_carlo(robot: Robot, q: np.ndarray, draws: int, seed: int) -> np.ndarray:
    """``(M, 6)`` exact errors [d; δ] in the tool's frame, equations (3) to (5), of robots drawn from the tolerances."""
    rng = np.random.default_rng(seed)
    result = []
    for count in np.diff(np.append(np.arange(0, draws, 20_000), draws)):
        errors: dict[str, dict[str, np.ndarray]] = {}
        for parameter in uncertain_parameters(robot):
            owner = parameter.name.rpartition(".")[0]
            errors.setdefault(owner, {})[parameter.kind] = parameter.sd * rng.standard_normal(count)
        relative = np.linalg.inv(forward(robot, q, {})) @ forward(robot, q, errors)
        delta = Rotation.from_matrix(relative[:, :3, :3]).as_rotvec()
        result.append(np.concatenate((relative[:, :3, 3], delta), axis=1))
    return np.concatenate(result)


@pytest.mark.parametrize("draws", [20_000, pytest.param(200_000, marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", ["puma560", "stanford", "panda", "ur10"])
def test_covariances_agree_with_exact_nonlinear_kinematics(name: str, draws: int) -> None:
    robot, n_poses = toleranced(name), 3
    configurations = sampled_configurations(robot, n_poses, seed=4)
    position, orientation, _ = pose_covariances(
        Arm.of(robot).chain, configurations.scalars, n_poses, uncertain_parameters(robot)
    )
    for k in range(n_poses):
        errors = monte_carlo(robot, configurations.q[:, k], draws, seed=k)
        for part, predicted in (
            (errors[:, :3], position[..., k]),
            (errors[:, 3:], orientation[..., k]),
        ):
            sampled = part.T @ part / draws
            # Of a Gaussian sample covariance: var v_ij = (v_ii v_jj + v_ij^2)/n. 4.5 sigma over some 100 elements.
            diagonal = np.diag(predicted)
            sampling = np.sqrt((np.outer(diagonal, diagonal) + np.square(predicted)) / draws)
            assert np.all(np.abs(sampled - predicted) < 4.5 * sampling)
            # And this would notice one parameter in the wrong place: the predicted trace is met to a few percent.
            assert np.trace(sampled) == pytest.approx(np.trace(predicted), rel=10 / np.sqrt(draws))


@pytest.mark.parametrize("name", ["puma560", "stanford", "panda"])
def test_matrices_are_equation_6(name: str) -> None:
    """Each column against central differences of the textbook's matrices, prismatic joints and modified rows too."""
    robot = robot_of(name)
    q = sampled_configurations(robot, 3, seed=1).q
    matrices = error_matrices(robot, q)
    zero = np.zeros_like(matrices.m1)
    expected = {
        "theta": (matrices.m1, matrices.m2),
        "d": (matrices.m2, zero),
        "a": (matrices.m3, zero),
        "alpha": (matrices.m4, matrices.m3),
    }
    step = 1e-6
    for k in range(q.shape[1]):
        nominal = np.linalg.inv(forward(robot, q[:, k], {}))[0]
        for j, joint in enumerate(robot.joints):
            for kind, (linear, angular) in expected.items():
                ends = forward(robot, q[:, k], {joint.name: {kind: np.array([step, -step])}})
                slope = nominal @ (ends[0] - ends[1]) / (2 * step)
                np.testing.assert_allclose(slope[:3, 3], linear[:, j, k], atol=1e-9)
                vector = (slope[2, 1], slope[0, 2], slope[1, 0])
                np.testing.assert_allclose(vector, angular[:, j, k], atol=1e-9)


def test_equations_7_and_8_from_the_matrices() -> None:
    """V from M1 … M4 as the paper writes it, with a different variance for every parameter, over more than a block."""
    rng = np.random.default_rng(0)
    base = robot_of("stanford")
    sds = {kind: rng.uniform(1e-5, 1e-3, 6) for kind in FOUR}
    joints = tuple(
        dataclasses.replace(joint, tolerance={kind: float(sds[kind][i]) for kind in FOUR})
        for i, joint in enumerate(base.joints)
    )
    robot = dataclasses.replace(base, joints=joints)
    n = BLOCK + 3
    configurations = sampled_configurations(robot, n)
    covariances = pose_covariances(Arm.of(robot).chain, configurations.scalars, n, uncertain_parameters(robot))
    matrices = error_matrices(robot, configurations.q)

    def part(matrix: np.ndarray, kind: str) -> np.ndarray:
        return np.einsum("ipn,p,jpn->ijn", matrix, np.square(sds[kind]), matrix)

    position = part(matrices.m1, "theta") + part(matrices.m2, "d") + part(matrices.m3, "a") + part(matrices.m4, "alpha")
    orientation = part(matrices.m2, "theta") + part(matrices.m3, "alpha")
    np.testing.assert_allclose(covariances[0], position, atol=1e-12 * position.max())
    np.testing.assert_allclose(covariances[1], orientation, atol=1e-12 * orientation.max())


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
