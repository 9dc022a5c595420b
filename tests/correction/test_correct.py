"""Corrected commands bring the simulated arm to its wanted poses, whatever its errors and its number of axes."""

from __future__ import annotations

import dataclasses
import itertools
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from arms import CONFIGS, arm, circumstances
from homogeneous import dh
from numpy.typing import NDArray
from slow_parameters import some_fast

import robacc
from robacc.correction import Evaluate, JointSolution, length_bound, solve
from robacc.effects.base import REGISTRY
from robacc.effects.specification import absorbed, entry_of
from robacc.geometry import Array, log_between
from robacc.measurements import Measurements, motion_between_rows
from robacc.modelling.model import predict
from robacc.robots.arm import Arm
from robacc.robots.description import Robot
from robacc.statistics.lengths import length_quantile

ROBOT, TRUTH = "sample_data/trace/robot.yaml", "sample_data/trace/truth.yaml"
MICROMETRE = 1e-6


def middle_joints(robot: Robot, n: int, seed: int = 0, share: float = 0.6) -> Array:
    """Joints in the middle of their ranges, away from limits."""
    low, high = np.array([joint.limits or (-2.0, 2.0) for joint in robot.variables]).T[..., None]
    unit = np.random.default_rng(seed).uniform(-1.0, 1.0, size=(low.size, n))
    return 0.5 * (low + high) + 0.5 * share * (high - low) * unit


def joint_targets(q: Array) -> Measurements:
    return Measurements(position=np.zeros((3, q.shape[1])), q=q)


# -- a simulation of its own: homogeneous matrices, and equilibrium from the potential energy


def frames_of(robot: Robot, q: Array, geometry: dict[str, dict[str, float]]) -> list[Array]:
    """Frames of the links ``(4, 4)`` at joint variables ``q`` ``(J,)``; base and tool left out."""
    frames, pose = [], np.eye(4)
    for joint, value in zip(robot.joints, q, strict=True):
        row = {name: joint.parameters[name] + geometry.get(joint.name, {}).get(name, 0.0) for name in _ROW}
        row["theta" if joint.type == "revolute" else "d"] += joint.sign * value
        pose = pose @ dh(*(row[name] for name in _ROW))
        frames.append(pose)
    return frames


_ROW = ("theta", "d", "a", "alpha")


def energy(robot: Robot, q: Array, geometry: dict[str, dict[str, float]]) -> float:
    """Potential energy of the links, J."""
    heights = [
        -joint.mass * np.dot(robot.gravity, (frame @ [*joint.com, 1.0])[:3])
        for joint, frame in zip(robot.joints, frames_of(robot, q, geometry), strict=True)
        if joint.mass and joint.com
    ]
    return float(sum(heights))


def real_pose(
    robot: Robot,
    q: Array,
    approach: Array,
    geometry: dict[str, dict[str, float]],
    offsets: Array,
    scale: Array,
    play: Array,
    compliance: Array,
) -> Array:
    """Pose ``(4, 4)`` of the arm: geometry, gear ratios, play by the approach, and sag in equilibrium."""
    rigid = q * (1.0 + scale) + offsets + play * np.sign(approach)
    turned = rigid
    step = 1e-5
    for _ in range(30):
        torque = [
            -(energy(robot, turned + step * unit, geometry) - energy(robot, turned - step * unit, geometry))
            / (2 * step)
            for unit in np.eye(q.size)
        ]
        turned = rigid + compliance * np.array(torque)
    return frames_of(robot, turned, geometry)[-1]


def test_an_independent_arm_reaches_its_wanted_poses() -> None:
    robot = dataclasses.replace(
        robacc.read_robot(ROBOT), tool=arm("irb1600").robot.tool, base=dataclasses.replace(arm("irb1600").robot.base)
    )
    flange = dataclasses.replace(robot, tool=type(robot.tool)(), base=type(robot.base)())
    rng = np.random.default_rng(5)
    geometry = {"j2": {"a": 3e-4}, "j3": {"alpha": -4e-4}, "j4": {"d": 2e-4}}
    offsets, scale = rng.normal(scale=5e-4, size=6), rng.normal(scale=2e-4, size=6)
    play, compliance = np.array([0, 1e-4, -2e-4, 0, 0, 5e-5]), np.array([0, 1e-6, 2e-6, 0, 0, 0])
    names = flange.variable_names

    def values(numbers: Array) -> dict[str, float]:
        return {name: float(number) for name, number in zip(names, numbers, strict=True) if number}

    entries = (
        {"effect": "joint_offset", "joints": list(names), "values": values(offsets)},
        {
            "effect": "link_geometry",
            "joints": list(geometry),
            "values": {f"{joint}.{label}": size for joint, row in geometry.items() for label, size in row.items()},
        },
        {"effect": "gear_ratio", "joints": list(names), "values": values(scale)},
        {"effect": "backlash", "joints": list(values(play)), "values": values(play)},
        {"effect": "joint_compliance", "joints": list(values(compliance)), "values": values(compliance)},
    )
    model = dataclasses.replace(flange, effects=entries, effect_units=(1.0, 1.0))
    q = middle_joints(flange, 30, seed=2)
    result = robacc.correct(joint_targets(q), model=model, nominal=flange)
    chosen = result.is_corrected
    assert chosen.sum() >= 25
    commands = result.q
    approach = np.diff(commands, axis=1, prepend=commands[:, :1])
    for i in np.flatnonzero(chosen):
        wanted = frames_of(flange, q[:, i], {})[-1]
        real = real_pose(flange, commands[:, i], approach[:, i], geometry, offsets, scale, play, compliance)
        uncorrected = real_pose(
            flange, q[:, i], np.diff(q, axis=1, prepend=q[:, :1])[:, i], geometry, offsets, scale, play, compliance
        )
        # Central differences of an energy of some 1e3 J with steps of 1e-5 leave 1e-7 N m, here 1e-13 rad.
        assert np.linalg.norm(real[:3, 3] - wanted[:3, 3]) < MICROMETRE
        assert np.abs(real[:3, :3] - wanted[:3, :3]).max() < 1e-6
        before = np.linalg.norm(uncorrected[:3, 3] - wanted[:3, 3])
        assert before == pytest.approx(result.before.position[i], abs=1e-8)
        assert before > 100 * MICROMETRE


# -- every effect on arms of every kind, through the files


def five_axes() -> Robot:
    """The UR10 without its last axis."""
    robot = arm("ur10").robot
    return dataclasses.replace(robot, name="five axes", joints=robot.joints[:5])


def arms_of_all_kinds() -> dict[str, Robot]:
    names = ("irb1600", "ur10", "panda", "stanford", "scara", "urdf:irb1600", "urdf:panda", "targets:puma560")
    return {**{name: arm(name).robot for name in names}, "five axes": five_axes()}


def with_effect(robot: Robot, name: str, data: Measurements) -> Robot | None:
    """The robot with an effect of usual size on all joints; None where it cannot have it."""
    own = Arm.of(robot)
    cls = REGISTRY[name]
    if cls.missing(own, data) is not None or cls.traits.is_frame:
        return None
    effect = cls.default(own, data)
    rng = np.random.default_rng(len(name))
    terms = [term for term in effect.terms(own, data) if not term.name.endswith(".beta")]
    values = {term.name: 0.3 * term.typical * rng.uniform(0.5, 1.0) for term in terms}
    if effect.traits.is_constant:
        return absorbed(robot, [effect], values)
    return dataclasses.replace(robot, effects=(entry_of(effect, values),), effect_units=(1.0, 1.0))


@pytest.mark.parametrize("name", list(REGISTRY))
@pytest.mark.parametrize("kind", some_fast(arms_of_all_kinds(), 3))
def test_every_effect_on_every_arm(kind: str, name: str) -> None:
    robot = arms_of_all_kinds()[kind]
    data = dataclasses.replace(circumstances(robot, 24, seed=4), q=middle_joints(robot, 24, seed=4))
    model = with_effect(robot, name, data)
    if model is None:
        pytest.skip("the arm cannot have the effect")
    result = robacc.correct(data, model=model, nominal=robot)
    targets, chosen = result, result.is_corrected
    assert chosen.sum() >= 16, [refusal.reason for refusal in targets.refusals if refusal]
    if REGISTRY[name].traits.is_of_measurement:
        np.testing.assert_array_equal(targets.q, data.q)
        return
    at_commands = dataclasses.replace(data, q=targets.q)
    real, wanted = predict(model, at_commands), predict(robot, data)
    position = np.linalg.norm(real.translation - wanted.translation, axis=0)[chosen]
    turn = np.linalg.norm(log_between(real.rotation, wanted.rotation), axis=0)[chosen]
    before = np.linalg.norm(predict(model, data).translation - wanted.translation, axis=0)[chosen]
    if len(robot.variables) >= 6:
        assert position.max() < MICROMETRE
        assert turn.max() < MICROMETRE
    else:
        # Position comes first: what remains of it is what the weight trades against orientation.
        assert np.sqrt(np.mean(position**2)) <= 0.2 * np.sqrt(np.mean(before**2)) + MICROMETRE


def test_redundant_arm_stays_nearest_to_its_nominal_joints() -> None:
    robot = arm("panda").robot
    data = dataclasses.replace(circumstances(robot, 20, seed=1), q=middle_joints(robot, 20, seed=1))
    model = with_effect(robot, "link_geometry", data)
    result = robacc.correct(data, model=model, nominal=robot)
    from robacc.robots.arm import pose_jacobian

    move = result.q - result.wanted.q
    _, jacobian = pose_jacobian(Arm.of(model), result.q)
    for i in np.flatnonzero(result.is_corrected):
        null = np.linalg.svd(jacobian[..., i])[2][-1]
        # A way along the null space would bring the joints nearer: none is left.
        assert abs(null @ move[:, i]) < 1e-6 * np.linalg.norm(move[:, i]) + 1e-9


def test_weight_decides_between_position_and_orientation() -> None:
    robot = five_axes()
    data = dataclasses.replace(circumstances(robot, 20, seed=1), q=middle_joints(robot, 20, seed=1))
    model = with_effect(robot, "link_geometry", data)
    results = [robacc.correct(data, model=model, nominal=robot, weight=weight) for weight in ("1mm", "10mm", "3m")]
    chosen = np.all([result.is_corrected for result in results], axis=0)
    assert chosen.sum() >= 15
    position = [float(result.after.position[chosen].mean()) for result in results]
    orientation = [float(result.after.orientation[chosen].mean()) for result in results]
    assert position[0] < position[1] < position[2]
    assert orientation[0] > orientation[2]
    assert position[0] < 1e-7
    assert any("5 axes" in note and "0.175 mm" in note for note in results[1].notes)


# -- forms of targets


def test_cartesian_targets_with_and_without_joints() -> None:
    nominal, model = robacc.read_robot(ROBOT), robacc.read_robot(TRUTH)
    q = middle_joints(nominal, 12, seed=3)
    by_joints = robacc.correct(joint_targets(q), model=model, nominal=nominal)
    wanted = by_joints.wanted.poses
    empty = np.zeros((3, 12))
    # The direction of approach of the first target is unknown in each form; all other moves are the same.
    seeded = Measurements(
        position=empty, q=q + 0.02, commanded_position=wanted.translation, commanded_rotation=wanted.rotation
    )
    result = robacc.correct(seeded, model=model, nominal=nominal)
    np.testing.assert_allclose(result.wanted.q, q, atol=1e-6)
    np.testing.assert_allclose(result.q, by_joints.q, atol=1e-6)
    free = Measurements(position=empty, commanded_position=wanted.translation, commanded_rotation=wanted.rotation)
    result = robacc.correct(free, model=model, nominal=nominal)
    chosen = result.is_corrected
    assert chosen.sum() >= 10
    assert result.after.position[chosen].max() < MICROMETRE


def test_frame_base_takes_targets_of_the_controller() -> None:
    nominal, model = robacc.read_robot(ROBOT), robacc.read_robot(TRUTH)
    q = middle_joints(nominal, 10, seed=3)
    own = nominal.base
    assert own.xyz == (0.0, 0.0, 0.0)
    pose = predict(nominal, joint_targets(q))
    data = Measurements(
        position=np.zeros((3, 10)), q=q, commanded_position=pose.translation, commanded_rotation=pose.rotation
    )
    result = robacc.correct(data, model=model, nominal=nominal, frame="base")
    np.testing.assert_allclose(result.wanted.q, q, atol=1e-7)
    # The controller computes q from the Cartesian command in its own frames.
    command = result.setting.from_measuring(result.commanded)
    np.testing.assert_allclose(command.translation, predict(nominal, joint_targets(result.q)).translation, atol=1e-12)


def test_positions_alone_leave_the_orientation_free() -> None:
    nominal, model = robacc.read_robot(ROBOT), robacc.read_robot(TRUTH)
    q = middle_joints(nominal, 10, seed=3)
    position = predict(model, dataclasses.replace(joint_targets(q), direction=np.zeros((6, 10)))).translation + 2e-4
    data = Measurements(position=np.zeros((3, 10)), q=q, commanded_position=position)
    result = robacc.correct(data, model=model, nominal=nominal)
    assert result.after.position.max() < MICROMETRE
    assert not result.wanted.oriented


# -- refusals


def test_limits_and_reasons() -> None:
    nominal, model = robacc.read_robot(ROBOT), robacc.read_robot(TRUTH)
    q = middle_joints(nominal, 6, seed=3)
    q[4, 0] = 0.0  # wrist stretched
    q[1, 1] = nominal.variables[1].limits[1]  # type: ignore[index]
    result = robacc.correct(joint_targets(q), model=model, nominal=nominal, most="1.2mm")
    causes = [None if refusal is None else refusal.cause for refusal in result.refusals]
    assert causes[0] == "singular"
    far = result.before.position > 1.3e-3
    assert {causes[i] for i in np.flatnonzero(far)} <= {"too_large", "limit", "singular"}
    np.testing.assert_array_equal(result.q[:, ~result.is_corrected], q[:, ~result.is_corrected])
    assert "see `most`" in " ".join(result.warnings) or not any(far)
    assert any("keep their nominal command" in warning for warning in result.warnings)
    low, high = np.array([joint.limits for joint in nominal.variables]).T[..., None]
    assert np.all((result.q >= low) & (result.q <= high))


def test_no_target_left_is_an_error() -> None:
    nominal = robacc.read_robot(ROBOT)
    for refusal, message, options in (
        (robacc.InputError, r"larger than 0\.001 mm, see `most`", {"most": "1um"}),
        (robacc.InputError, "has the joints", {"nominal": CONFIGS / "scara.yaml"}),
        (robacc.UsageError, "`ordered`", {"ordered": False}),
    ):
        with pytest.raises(refusal, match=message):
            robacc.correct(joint_targets(middle_joints(nominal, 3)), model=TRUTH, **{"nominal": nominal, **options})


def test_approach_is_that_of_the_corrected_commands() -> None:
    """Joints that hardly move approach from another side once they are corrected; the model takes that side."""
    nominal, model = robacc.read_robot(ROBOT), robacc.read_robot(TRUTH)
    q = np.repeat(middle_joints(nominal, 1, seed=3), 40, axis=1)
    rng = np.random.default_rng(0)
    q += rng.normal(scale=0.1, size=q.shape) * (rng.random(q.shape) < 0.6)
    result = robacc.correct(joint_targets(q), model=model, nominal=nominal)
    commands = result.q
    direction, speed = motion_between_rows(commands)
    real = predict(
        model, Measurements(position=np.zeros((3, 40)), q=commands, direction=direction, speed=speed)
    ).translation
    chosen = result.is_corrected
    assert chosen.sum() >= 30
    assert np.linalg.norm(real - result.wanted.poses.translation, axis=0)[chosen].max() < MICROMETRE


# -- bounds, files, speed


@pytest.mark.parametrize("seed", range(6))
def test_bound_agrees_with_the_exact_quantile(seed: int) -> None:
    rng = np.random.default_rng(seed)
    variances = rng.uniform(0.0, 1.0, 3) ** 3 + 1e-6
    mean = rng.normal(scale=rng.choice([0.0, 1.0, 3.0]), size=3)
    exact = length_quantile(0.95, mean, variances)
    # Three cumulants: within 1 % (and Wilson and Hilferty's cube root within as much for few degrees of freedom).
    assert length_bound(0.95, mean[:, None], np.diag(variances)[..., None])[0] == pytest.approx(exact, rel=0.02)


def test_corrected_file_reads_as_commands(tmp_path: Path) -> None:
    nominal = robacc.read_robot(ROBOT)
    q = middle_joints(nominal, 8, seed=3)
    result = robacc.correct(joint_targets(q), model=TRUTH, nominal=ROBOT)
    result.write(tmp_path / "corrected.csv")
    data = robacc.simulate(TRUTH, at=tmp_path / "corrected.csv").data
    error = np.linalg.norm(data.position - result.wanted.poses.translation, axis=0)
    assert error[result.is_corrected].max() < MICROMETRE
    rows = result.per_target_csv().splitlines()
    assert len(rows) == 9
    assert rows[0].startswith("line,corrected,command_x_m")


def test_work_grows_in_proportion_to_the_targets() -> None:
    """Evaluations of the model, not seconds: every target takes a few, however many there are."""
    nominal, model = robacc.read_robot(ROBOT), robacc.read_robot(TRUTH)
    counts: dict[int, int] = {}

    def counted(n: int):  # type: ignore[no-untyped-def]
        def solved(evaluate: Evaluate, *rest: Any) -> JointSolution:
            def count(q: Array, index: NDArray[np.int64]) -> tuple[Array, Array]:
                counts[n] = counts.get(n, 0) + index.size
                return evaluate(q, index)

            return solve(count, *rest)

        return solved

    for n in (100, 800):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("robacc.correction.solve", counted(n))
            robacc.correct(joint_targets(middle_joints(nominal, n, seed=n)), model=model, nominal=nominal)
    per_target = [counts[n] / n for n in counts]
    assert max(per_target) < 15
    assert all(a < 1.6 * b for a, b in itertools.permutations(per_target, 2))


def test_joints_that_count_against_the_table_are_corrected() -> None:
    """Axes 1, 4 and 6 of a KUKA count against the table."""
    nominal = robacc.read_robot("robacc/data/robots/kr10_r1100_sixx.yaml")
    shifted = tuple(
        dataclasses.replace(joint, parameters={**joint.parameters, "theta": joint.parameters["theta"] + 2e-4})
        for joint in nominal.joints
    )
    q = np.radians([[20.0, -100.0, 100.0, 30.0, 40.0, 10.0], [-60.0, -70.0, 60.0, -50.0, -30.0, 90.0]]).T
    targets = Measurements(np.zeros((3, 2)), q=q)
    result = robacc.correct(targets, model=dataclasses.replace(nominal, joints=shifted), nominal=nominal, frame="base")
    assert result.is_corrected.all()
    signs = np.array([joint.sign for joint in nominal.joints])
    assert (signs < 0).sum() == 3
    np.testing.assert_allclose(result.q - q, np.outer(-2e-4 * signs, [1, 1]), atol=1e-8)


STUDIES = Path(__file__).resolve().parents[1] / "studies"


@pytest.mark.slow
def test_real_arms_reach_their_corrected_targets(tmp_path: Path) -> None:
    """Six arms of different kinds; the whole study of 100 arms is in tests/studies/README.md."""
    result = tmp_path / "result.json"
    numbers = "^(001|004|011|018|023|031)-"
    words = [sys.executable, "corrected_arms.py", "--robacc", f"{sys.executable} -m robacc", "--only", numbers]
    subprocess.run([*words, "--json", str(result)], cwd=STUDIES, check=True, timeout=1200)
    rows = json.loads(result.read_text())["rows"]
    assert len(rows) == 6
    assert max(row["ratio"] for row in rows) <= 1.2
    # Targets of one arm share the errors of its coefficients: six arms bound the share loosely.
    assert np.mean([flag for row in rows for flag in row["covered"]]) > 0.85
