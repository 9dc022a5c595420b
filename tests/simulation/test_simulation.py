"""Simulated poses: what is asked for is there, what is random has the size asked for, and a seed is a seed."""

import dataclasses

import numpy as np
import pytest
from arms import arm
from scipy.spatial.transform import Rotation

from robacc import InputError, Robot, UsageError
from robacc.modelling.model import predict
from robacc.poses.csv_file import format_poses
from robacc.simulation.simulate import Plan, joint_samples, simulate

PUMA = arm("puma560").robot
WITH_EFFECTS = dataclasses.replace(
    PUMA,
    effects=(
        {"effect": "joint_compliance", "joints": ["j2"], "values": {"j2": 1e-5}},
        {"effect": "backlash", "joints": ["j3"], "values": {"j3": 2e-4}},
        {"effect": "approach_lag", "joints": ["j1"], "values": {"j1": 1e-4}},
        {"effect": "payload_compliance", "joints": ["j3"], "values": {"j3": 1e-5}},
        {"effect": "thermal_expansion", "values": {"value": 1e-5}},
        {"effect": "frame_drift", "span_s": 100, "values": {"z": 1e-4}},
    ),
)
EVERYTHING = Plan(50, cycles=3, time_step=10.0, temperature=(18.0, 28.0), payloads=(0.0, 2.0))


def test_without_noise_the_measured_pose_is_the_model_s_own() -> None:
    data = simulate(WITH_EFFECTS, EVERYTHING).data
    poses = predict(WITH_EFFECTS, data)
    np.testing.assert_array_equal(data.position, poses.translation)
    np.testing.assert_array_equal(data.rotation, poses.rotation)
    nominal = arm("puma560").chain.forward(data.q)
    assert np.linalg.norm(data.position - nominal.translation, axis=0).max() > 1e-4


@pytest.mark.parametrize("sampling", ["even", "random"])
def test_the_same_seed_gives_the_same_bytes_and_another_gives_other_poses(sampling: str) -> None:
    plan = dataclasses.replace(EVERYTHING, sampling=sampling, noise_position=1e-5, noise_orientation=1e-5, outliers=2)
    text = [format_poses(simulate(WITH_EFFECTS, dataclasses.replace(plan, seed=s)).data) for s in (5, 5, 6)]
    assert text[0] == text[1]
    assert text[0] != text[2]
    first, other = (joint_samples(PUMA, dataclasses.replace(plan, seed=s)) for s in (5, 6))
    assert not np.any(first == other)


def test_noise_and_outliers_leave_the_poses_where_they_are() -> None:
    plain = simulate(WITH_EFFECTS, EVERYTHING).data
    noisy = dataclasses.replace(EVERYTHING, noise_position=1e-5, noise_orientation=2e-5, outliers=5, sigma=True)
    data = simulate(WITH_EFFECTS, noisy).data
    for column in ("q", "direction", "speed", "time", "temperature", "payload"):
        np.testing.assert_array_equal(getattr(data, column), getattr(plain, column))
    assert np.all(data.sigma_position == 1e-5)
    assert np.all(data.sigma_rotation == 2e-5)


def test_noise_has_the_size_asked_for_along_and_about_each_axis() -> None:
    n = 4000
    data = simulate(PUMA, Plan(n, noise_position=3e-5, noise_orientation=7e-5)).data
    true = simulate(PUMA, Plan(n)).data
    shift = data.position - true.position
    turned = np.einsum("ijn,kjn->nik", data.rotation, true.rotation)
    turn = Rotation.from_matrix(turned).as_rotvec().T
    # A standard deviation of n numbers has a standard error of 1 / sqrt(2 n) = 1.1 %; six of them at 4 each.
    for noise, size in ((shift, 3e-5), (turn, 7e-5)):
        np.testing.assert_allclose(noise.std(axis=1), size, rtol=0.045)
        assert np.abs(noise.mean(axis=1)).max() < 4 * size / np.sqrt(n)
        assert np.abs(np.corrcoef(noise) - np.eye(3)).max() < 4.5 / np.sqrt(n)


def test_outliers_are_as_many_and_as_far_off_as_asked_for() -> None:
    done = simulate(PUMA, Plan(40, outliers=6, outlier_size=0.004))
    off = np.linalg.norm(done.data.position - simulate(PUMA, Plan(40)).data.position, axis=0)
    assert list(np.flatnonzero(off)) == list(done.outliers)
    np.testing.assert_allclose(off[done.outliers], 0.004, rtol=0, atol=1e-15)
    assert done.outliers.size == 6


@pytest.mark.parametrize("name", ["puma560", "stanford", "urdf:panda"])
@pytest.mark.parametrize("sampling", ["even", "random"])
def test_joints_keep_their_limits_and_fill_them(name: str, sampling: str) -> None:
    robot = arm(name).robot
    low, high = np.array([joint.limits for joint in robot.variables]).T[..., None]
    q = joint_samples(robot, Plan(400, sampling=sampling))
    assert np.all((low <= q) & (q <= high))
    unit = (q - low) / (high - low)
    counts = np.array([np.histogram(row, 10, (0, 1))[0] for row in unit])
    # 40 in each tenth: evenly spread ones miss it by few, random ones by a few times sqrt(40).
    assert np.abs(counts - 40).max() <= (8 if sampling == "even" else 28)


def test_a_joint_without_limits_takes_a_turn_and_a_slide_without_is_an_error() -> None:
    free = dataclasses.replace(PUMA, joints=tuple(dataclasses.replace(j, limits=None) for j in PUMA.joints))
    q = joint_samples(free, Plan(300))
    assert np.abs(q).max() <= np.pi
    assert np.all(np.ptp(q, axis=1) > 6.0)
    stanford = arm("stanford").robot
    slides = dataclasses.replace(
        stanford, joints=tuple(dataclasses.replace(joint, limits=None) for joint in stanford.joints)
    )
    with pytest.raises(
        InputError, match="the prismatic joint j3 has no limits to sample within; give it limits"
    ) as caught:
        simulate(slides, Plan(5))
    assert caught.value.problems[0].column == "joints.j3.limits"


def test_cycles_repeat_the_poses_in_their_order() -> None:
    data = simulate(WITH_EFFECTS, EVERYTHING).data
    assert data.n == 150
    assert list(data.cycle) == ["1"] * 50 + ["2"] * 50 + ["3"] * 50
    for cycle in (1, 2):
        rows = slice(50 * cycle, 50 * cycle + 50)
        np.testing.assert_array_equal(data.q[:, rows], data.q[:, :50])
        np.testing.assert_array_equal(data.pose[rows], data.pose[:50])
        np.testing.assert_array_equal(data.payload[rows], data.payload[:50])
    assert len(set(data.pose)) == 50
    assert data.groups().max() == 49


def test_time_temperature_and_payload() -> None:
    data = simulate(PUMA, EVERYTHING).data
    np.testing.assert_array_equal(data.time, 10.0 * np.arange(150))
    rise = (data.temperature - 18.0) / 10.0
    assert rise[0] == 0.0
    assert rise[-1] == pytest.approx(1 - np.exp(-3))
    assert np.all(np.diff(rise) > 0)
    assert set(data.payload) == {0.0, 2.0}
    still = simulate(PUMA, Plan(4, temperature=(24.0, 24.0))).data
    assert list(still.temperature) == [24.0] * 4
    assert still.time is None
    assert still.payload is None


def test_commanded_poses_are_those_of_the_robot_without_effects() -> None:
    data = simulate(WITH_EFFECTS, dataclasses.replace(EVERYTHING, commanded=True)).data
    nominal = arm("puma560").chain.forward(data.q)
    np.testing.assert_array_equal(data.commanded_position, nominal.translation)
    np.testing.assert_array_equal(data.commanded_rotation, nominal.rotation)
    points = simulate(PUMA, Plan(3, commanded=True, orientation=False, sigma=True, noise_position=1e-5)).data
    assert points.rotation is None
    assert points.commanded_rotation is None
    assert points.sigma_rotation is None


@pytest.mark.parametrize(
    ("robot", "plan", "message"),
    [
        (PUMA, Plan(40, outliers=41), "41 outliers are more than the 40 rows"),
        # Before they are made.
        (PUMA, Plan(200_000, cycles=100_000), "20000000000 rows are more than the limit of 2000000"),
        (WITH_EFFECTS, Plan(3), "payload_compliance needs the column payload_kg"),
    ],
)
def test_plans_that_cannot_be_simulated_are_refused(robot: Robot, plan: Plan, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        simulate(robot, plan)


def test_with_a_clock_the_order_of_even_poses_is_drawn_and_the_poses_are_the_same() -> None:
    plain, timed = (joint_samples(PUMA, Plan(50, seed=4, time_step=step)) for step in (None, 20.0))
    assert not np.array_equal(plain, timed)
    np.testing.assert_array_equal(np.sort(plain, axis=1), np.sort(timed, axis=1))
    # An even sequence steps by a constant share of the range; in the order of a clock no step is like the next.
    assert np.unique(np.round(np.diff(plain[0]), 4)).size < 5 < np.unique(np.round(np.diff(timed[0]), 4)).size


def test_lengths_are_nominal_at_the_reference_temperature_and_grow_from_there() -> None:
    def reached(temperature: float) -> np.ndarray:
        entry = {"effect": "thermal_expansion", "reference_c": 25.0, "values": {"value": 1e-4}}
        robot = dataclasses.replace(PUMA, effects=(entry,))
        return simulate(robot, Plan(20, temperature=(temperature, temperature))).data.position

    nominal = simulate(PUMA, Plan(20)).data.position
    np.testing.assert_allclose(reached(25.0), nominal, rtol=0, atol=1e-15)
    np.testing.assert_allclose(reached(35.0) - nominal, nominal - reached(15.0), rtol=0, atol=1e-9)
    assert np.linalg.norm(reached(35.0) - nominal, axis=0).max() > 1e-4
