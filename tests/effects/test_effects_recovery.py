"""What is put into simulated poses comes out of the fit, within the uncertainty that the fit states."""

import dataclasses
from functools import cache
from itertools import product

import numpy as np
import pytest
from arms import CONFIGURED, arm, model_of
from slow_parameters import some_fast

from robacc import Measurements, Robot
from robacc.effects import REGISTRY
from robacc.effects.base import Effect
from robacc.effects.specification import CONSTANTS, FRAMES, default_baseline, entry_of
from robacc.fitting.fit_result import Fit
from robacc.fitting.solver import fit
from robacc.fitting.visits import places
from robacc.geometry import rms_length
from robacc.modelling.model import Model, predict
from robacc.robots.arm import Arm
from robacc.simulation.simulate import Plan, simulate
from robacc.tracing.trace import trace

# What is put into simulated poses comes out of the fit, within the uncertainty that the fit states.

NOISE = 2e-5
GEOMETRY = ("base_frame", "tool_frame", "joint_offset", "link_geometry")
PLAN = Plan(
    120,
    seed=3,
    noise_position=NOISE,
    noise_orientation=NOISE,
    time_step=30.0,
    temperature=(18.0, 30.0),
    payloads=(0.0, 2.0, 5.0),
)


@cache
def blank(name: str, n: int = 120) -> Measurements:
    """The plan's poses of an arm without effects."""
    return simulate(arm(name).robot, dataclasses.replace(PLAN, poses=n)).data


def one_joint(name: str, one: Arm, data: Measurements) -> Effect | None:
    """The effect's default form on one joint that shows it, the second where it does; None where the arm has none."""
    cls = REGISTRY[name]
    if cls.missing(one, data) is not None:
        return None
    if not cls.traits.per_joint:
        return cls.default(one, data)
    joints = cls.possible_joints(one)
    for joint in (*joints[1:], joints[0]):
        effect = cls.default(one, data, (joint,))
        bound = Model(one, free=(effect,)).bind(data)
        if np.abs(bound.linearise(np.zeros(len(bound.terms)))[1]).max(initial=0.0) > 1e-9:
            return effect
    return None


def truth_of(effect: Effect, one: Arm, data: Measurements, seed: int = 0) -> dict[str, float]:
    """Coefficients that move the target by some tenths of a millimetre or of a milliradian."""
    rng = np.random.default_rng(seed)
    terms = effect.terms(one, data)
    bound = Model(one, free=(effect,)).bind(data)
    reach = np.abs(bound.linearise(np.zeros(len(terms)))[1]).max(axis=(0, 2))
    size = 3e-4 / np.where(reach > 1e-9, reach, np.inf)
    return {
        term.name: float(s * rng.uniform(0.5, 1) * rng.choice([-1, 1])) for term, s in zip(terms, size, strict=True)
    }


def with_truth(one: Arm, effect: Effect, truth: dict[str, float]) -> Robot:
    return dataclasses.replace(one.robot, effects=(entry_of(effect, truth),))


def worst_of_prediction(found: Fit, robot: Robot, n: int = 40) -> float:
    """Largest error, in its own standard errors, of what the fit predicts at poses that it has not seen."""
    fresh = simulate(robot, dataclasses.replace(PLAN, poses=n, seed=77, noise_position=0.0, noise_orientation=0.0)).data
    poses, jacobian = found.model.bind(fresh).linearise(found.theta)
    kept = found.identifiability.columns
    columns = jacobian[:3, kept]
    variance = np.einsum("ipn,pq,iqn->in", columns, found.covariance[np.ix_(kept, kept)], columns)
    error = poses.translation - fresh.position
    return float(np.max(np.abs(error) / np.sqrt(variance)))


@pytest.mark.parametrize(("name", "arm_name"), some_fast(product(REGISTRY, CONFIGURED), 5))
def test_recovery_within_four_standard_errors(name: str, arm_name: str) -> None:
    one = arm(arm_name)
    effect = one_joint(name, one, blank(arm_name))
    if effect is None:
        assert (name, arm_name) in HAS_IT_NOT
        return
    assert (name, arm_name) not in HAS_IT_NOT
    truth = truth_of(effect, one, blank(arm_name))
    robot = with_truth(one, effect, truth)
    data = simulate(robot, PLAN).data
    others = [REGISTRY[part].default(one, data) for part in GEOMETRY if part != name]
    whole = REGISTRY[name].default(one, data) if effect.traits.is_constant else effect
    found = fit(Model.of(one.robot, [*others, whole]), data)
    assert found.inliers.all()
    # 4 of 120 numbers' worth of normal tails would be one seed in a hundred; 5 leaves the seed free.
    assert worst_of_prediction(found, robot) < 5.0
    # What a fit shrinks, or cannot tell from geometry, has no number of its own to compare: its prediction was.
    shrunk = any(term.group for term in effect.terms(one, data))
    if effect.traits.is_constant or shrunk or any(drop.name in truth for drop in found.identifiability.dropped):
        return
    for term, value in truth.items():
        i = found.names.index(term)
        assert abs(found.theta[i] - value) < 4 * np.sqrt(found.covariance[i, i]), term


HAS_IT_NOT = (
    {("read_back", name) for name in CONFIGURED}
    | {
        (effect, name)
        for effect in ("friction_windup", "joint_hardening", "compliance_variation")
        for name in ("irb1600", "scara")  # their masses are not published
    }
    | {("rail_errors", name) for name in ("irb1600", "panda", "puma560", "ur10")}
)  # no joint slides; the simulation reads no joints back
# Every effect on thousands of poses: several blocks, targets, folds, both deflection forms; slow.


# Effects of a baseline that nobody declared: those of every arm that the poses support.

ALL = (*FRAMES, *CONSTANTS)


def poses(name: str, n: int, *, orientation: bool, visits: int = 1) -> Measurements:
    joints = arm(name)
    q = np.random.default_rng(1).uniform(-1.0, 1.0, (len(joints.names), n)).repeat(visits, axis=1)
    rotation = np.tile(np.eye(3)[..., None], n * visits) if orientation else None
    return Measurements(np.zeros((3, n * visits)), rotation, q=q)


@pytest.mark.parametrize(
    ("name", "n", "orientation", "expected"),
    [
        # One and a half coordinates for each coefficient: 6 axes have 24 constants and a target of 3 or 6.
        ("puma560", 14, False, ALL),
        ("puma560", 13, False, ALL[:3]),
        ("puma560", 8, True, ALL),
        ("puma560", 7, True, ALL[:3]),
        # 6 of the base, 3 of the target, 6 offsets.
        ("puma560", 8, False, ALL[:3]),
        ("puma560", 7, False, FRAMES),
        ("puma560", 4, True, FRAMES),
        # A prismatic joint has 2 constants, so a SCARA needs fewer poses than an arm of four turning joints.
        ("scara", 9, False, ALL),
    ],
)
def test_the_default_is_as_much_as_the_poses_support(
    name: str, n: int, orientation: bool, expected: tuple[str, ...]
) -> None:
    baseline = default_baseline(arm(name), poses(name, n, orientation=orientation), n)
    assert baseline.names == expected
    assert baseline.by_default
    assert [effect for effect, _ in baseline.left_out] == [effect for effect in ALL if effect not in expected]
    assert all(f"poses in {n} places give" in why for _, why in baseline.left_out)


@pytest.mark.parametrize(("n_targets", "n", "expected"), [(3, 7, ALL), (3, 6, ALL[:3]), (2, 9, ALL), (2, 8, ALL[:3])])
def test_targets_at_one_pose_give_at_most_its_six_coordinates(
    n_targets: int, n: int, expected: tuple[str, ...]
) -> None:
    data = dataclasses.replace(
        poses("puma560", n, orientation=False, visits=n_targets), target=np.array(["a", "b", "c"][:n_targets] * n)
    )
    assert default_baseline(arm("puma560"), data, n).names == expected


def test_repetitions_support_no_more_coefficients() -> None:
    data = poses("puma560", 7, orientation=False, visits=5)
    assert default_baseline(arm("puma560"), data, np.unique(places(data)).size).names == FRAMES


@pytest.mark.parametrize(("name", "n"), [("puma560", 18), ("stanford", 20)])
def test_few_poses_of_an_arm_with_errors_of_geometry_are_clean(name: str, n: int) -> None:
    """Without geometry in the baseline its errors would be findings or noise, and other poses would miss them."""
    rng, noise = np.random.default_rng(5), 2e-5
    joints = arm(name)
    data, other = (simulate(joints.robot, Plan(count, seed=seed)).data for count, seed in ((n, 4), (200, 5)))
    model = model_of(joints.robot, ",".join(ALL), data)
    real = 3e-4 * rng.normal(size=len(model.bind(data).terms))
    position = model.bind(data).poses(real).translation + noise * rng.normal(size=(3, n))
    measured = Measurements(position, q=data.q)
    baseline = default_baseline(joints, measured, n)
    found = trace(model_of(joints.robot, ",".join(baseline.names), measured), measured)
    error = predict(found.robot, other).translation - model.bind(other).poses(real).translation
    assert found.verdict == "clean"
    assert rms_length(error) < 5.0 * noise
