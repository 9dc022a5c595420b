"""Base and target found from any start: metres away at any angle, several targets, rows that are gross errors."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from arms import arm
from scipy.spatial.transform import Rotation

from robacc.errors import InputError, UsageError
from robacc.fitting.registration import align, align_commands
from robacc.geometry import exp_so3, rpy_from_rotation
from robacc.measurements import Measurements
from robacc.modelling.model import predict
from robacc.robots.description import Frame, Robot
from robacc.simulation.simulate import Plan, simulate

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
    truth = dataclasses.replace(robot, base=base, tool=tool)
    data = simulate(truth, Plan(20, seed=5)).data
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


def test_frames_of_a_wrong_arm_are_the_least_squares_ones() -> None:
    # Beside it every nearby frame is worse: the alignment of an arm with other errors is a minimum all the same.
    robot = arm("puma560").robot
    wrong = dataclasses.replace(robot, effects=({"effect": "joint_offset", "joints": ["j3"], "values": {"j3": 3e-3}},))
    data = simulate(displaced(wrong, 3), Plan(40, seed=3, orientation=False)).data
    found = align(robot, data, BOTH).robot

    def squares(candidate: Robot) -> float:
        return float(np.sum(np.square(predict(candidate, data).translation - data.position)))

    best = squares(found)
    assert best > 1e-6
    for frame in ("base", "tool"):
        for axis in range(3):
            for step in (-1e-5, 1e-5):
                was = getattr(found, frame)
                xyz = tuple(value + step * (i == axis) for i, value in enumerate(was.xyz))
                assert squares(dataclasses.replace(found, **{frame: Frame(xyz, was.rpy)})) > best
                if frame == "base":
                    rpy = tuple(value + step * (i == axis) for i, value in enumerate(was.rpy))
                    assert squares(dataclasses.replace(found, base=Frame(was.xyz, rpy))) > best


def test_what_a_point_cannot_show_is_said() -> None:
    data = measured("puma560", 1, orientation=False)
    found = align(arm("puma560").robot, data, BOTH)
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
    turned = Rotation.from_euler("xyz", alignment.robot.base.rpy)
    assert (turned.inv() * base).magnitude() < NOISE
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
    turned = Rotation.from_euler("xyz", alignment.robot.base.rpy)
    assert (turned.inv() * best).magnitude() < 1e-6
    with pytest.raises(UsageError, match="add the columns cmd_qw"):
        align_commands(positions, BOTH)
