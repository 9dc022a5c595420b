"""Generalised forces of gravity against the derivative of the potential energy, and their derivatives."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from arms import arm, circumstances

from robacc.geometry import Poses
from robacc.gravity import (
    Load,
    Weighted,
    bears_weight,
    combined,
    force_derivatives,
    forces,
    gravity_torques,
    own_weight,
    payload,
    unit_loads,
)
from robacc.robots.arm import Arm, Sweep

ARMS = ("puma560", "panda", "stanford", "urdf:puma560")
STEP = 1e-30
"""Of the complex step: no difference is taken, so it may be as small as the derivative is exact."""
N = 5


def swept(robot_arm: Arm, scalars: list[np.ndarray], loads: tuple[Load, ...]) -> tuple[Sweep, dict[int, Poses]]:
    counts = sorted({load.after for load in loads})
    sweep = robot_arm.chain.sweep(scalars, N, None, counts)
    return sweep, dict(zip(counts, sweep.frames, strict=True))


def all_forces(robot_arm: Arm, scalars: list[np.ndarray], loads: tuple[Load, ...]) -> np.ndarray:
    """The force along every motion, in one call."""
    sweep, frames = swept(robot_arm, scalars, loads)
    linear, angular = sweep.twists()
    weighted = [Weighted(motion, loads) for motion in range(len(robot_arm.chain.motions))]
    return forces(gravity(robot_arm), weighted, frames, linear, angular)


def start(robot_arm: Arm) -> list[np.ndarray]:
    """Every scalar off zero, so that no motion is special."""
    rng = np.random.default_rng(1)
    q = circumstances(robot_arm.robot, N).q
    return [np.broadcast_to(s, (N,)) + rng.normal(scale=0.05, size=N) for s in robot_arm.chain.scalars(q)]


def loads_of(robot_arm: Arm, kind: str) -> tuple[Load, ...]:
    if kind == "own":
        return own_weight(robot_arm)
    if kind == "payload":
        return payload(robot_arm, np.linspace(0.0, 4.0, N))
    return tuple(load for group in unit_loads(robot_arm, 1).values() for load in group)


def gravity(robot_arm: Arm) -> np.ndarray:
    """Leaning, so that no component of it is special."""
    return np.array(robot_arm.robot.gravity) + np.array([1.5, -2.0, 0.3])


def work(robot_arm: Arm, scalars: list[np.ndarray], loads: tuple[Load, ...]) -> np.ndarray:
    """Minus the potential energy, g . sum m c, from the frames alone."""
    _, frames = swept(robot_arm, scalars, loads)
    total = np.zeros((3, N))
    for load in loads:
        own_moment = np.array([np.broadcast_to(part, (N,)) for part in load.first_moment])
        total = total + np.einsum("ijn,jn->in", frames[load.after].rotation, own_moment)
        total = total + load.mass * frames[load.after].translation
    return gravity(robot_arm) @ total


def stepped(scalars: list[np.ndarray], motion: int) -> list[np.ndarray]:
    return [s + 1j * STEP if k == motion else s for k, s in enumerate(scalars)]


@pytest.mark.parametrize("kind", ["own", "payload", "unit"])
@pytest.mark.parametrize("name", ARMS)
def test_force_is_the_derivative_of_the_potential_energy(name: str, kind: str) -> None:
    robot_arm = arm(name)
    loads, scalars = loads_of(robot_arm, kind), start(robot_arm)
    assert loads
    for motion, result in enumerate(all_forces(robot_arm, scalars, loads)):
        expected = np.imag(work(robot_arm, stepped(scalars, motion), loads)) / STEP
        # Hundreds of N m, by products of some twenty numbers.
        np.testing.assert_allclose(result, expected, rtol=1e-12, atol=1e-10)


@pytest.mark.parametrize("kind", ["own", "payload", "unit"])
@pytest.mark.parametrize("name", ARMS)
def test_derivatives_of_the_force_agree_with_a_complex_step(name: str, kind: str) -> None:
    robot_arm = arm(name)
    loads, scalars = loads_of(robot_arm, kind), start(robot_arm)
    sweep, frames = swept(robot_arm, scalars, loads)
    linear, angular = sweep.twists()
    wanted = tuple(range(len(robot_arm.chain.motions)))
    expected = np.empty((len(wanted), len(wanted), N))
    for k in wanted:
        expected[:, k] = np.imag(all_forces(robot_arm, stepped(scalars, k), loads)) / STEP
    for motion in wanted:
        result = force_derivatives(gravity(robot_arm), Weighted(motion, loads), frames, wanted, linear, angular)
        np.testing.assert_allclose(result, expected[motion], rtol=1e-11, atol=1e-10)
    # Second derivatives of one energy: the order of the two motions does not matter.
    np.testing.assert_allclose(expected, np.swapaxes(expected, 0, 1), rtol=1e-11, atol=1e-10)


@pytest.mark.parametrize("name", ARMS)
def test_joint_torques_against_a_difference_of_the_energy(name: str) -> None:
    robot_arm = arm(name)
    q = circumstances(robot_arm.robot, N).q
    result = gravity_torques(robot_arm, q)

    def energy(at: np.ndarray) -> np.ndarray:
        total = np.zeros(N)
        for body in robot_arm.chain.bodies:
            frame = robot_arm.chain.sweep(robot_arm.chain.scalars(at), N, (), (body.after,)).frames[0]
            place = np.einsum("ijn,j->in", frame.rotation, np.array(body.com)) + frame.translation
            total -= body.mass * np.array(robot_arm.robot.gravity) @ place
        return total

    for i in range(len(robot_arm.names)):
        step = np.zeros_like(q)
        step[i] = 1e-5
        slope = (energy(q + step) - energy(q - step)) / 2e-5
        # A central difference of a hundred joules leaves some 1e-9; a torque of the wrong sign or lever is far from it.
        np.testing.assert_allclose(result[i], -slope, rtol=0, atol=1e-7)
    assert np.abs(result).max() > 1.0


def test_an_upright_axis_carries_no_torque_and_an_arm_without_masses_none_at_all() -> None:
    puma = arm("puma560")
    q = circumstances(puma.robot, N).q
    np.testing.assert_allclose(gravity_torques(puma, q)[0], 0.0, rtol=0, atol=1e-12)
    bare = arm("irb1600")
    q = circumstances(bare.robot, N).q
    assert not np.any(gravity_torques(bare, q))


def test_a_load_in_front_of_the_motion_is_not_moved_by_it() -> None:
    robot_arm = arm("puma560")
    load = own_weight(robot_arm)[0]
    result = all_forces(robot_arm, start(robot_arm), (load,))
    assert np.any(result[: load.after])
    assert not np.any(result[load.after :])


def test_loads_with_factors_act_as_their_sum() -> None:
    panda = arm("panda")
    scalars, own, carried = start(panda), own_weight(panda), payload(panda, np.linspace(0.0, 4.0, N))
    expected = 0.5 * all_forces(panda, scalars, own) - 2.0 * all_forces(panda, scalars, carried)
    together = combined([(0.5, own), (-2.0, carried)])
    assert len(together) == len({load.after for load in (*own, *carried)})
    np.testing.assert_allclose(all_forces(panda, scalars, together), expected, rtol=1e-12, atol=1e-10)


@pytest.mark.parametrize("name", [*ARMS, "scara"])
@pytest.mark.parametrize("leaning", [0.0, 0.5, 2.0])
def test_a_joint_bears_weight_if_a_mass_on_its_link_can_load_it(name: str, leaning: float) -> None:
    """Against the work of a first moment of 1 kg m, and of 1 kg on a slide; within a degree an axis counts as level."""
    robot = arm(name).robot
    lean = np.radians(leaning)
    down = 9.81 * np.array([np.sin(lean), 0.0, -np.cos(lean)])
    one = Arm.of(dataclasses.replace(robot, gravity=tuple(down)))
    q = circumstances(robot, 40).q
    loads = unit_loads(one, 0)
    for number, owner in enumerate(one.owners):
        labels = ("hx", "hy", "hz") if one.is_revolute(one.names[number]) else ("m",)
        torque = np.array([gravity_torques(one, q, loads[f"{label}{owner + 1}"])[number] for label in labels])
        largest = np.linalg.norm(torque, axis=0).max() / 9.81
        assert bears_weight(one, q)[number] is bool(largest > np.sin(np.radians(1.0))), one.names[number]
