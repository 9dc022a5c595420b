"""Corrected commands reach their poses on any arm; the record of a fit predicts how well, and measurements check it."""

import dataclasses
import json
import os
import subprocess
import sys
from functools import cache
from itertools import product
from pathlib import Path

import independent_arm
import numpy as np
import pytest
from arms import CONFIGS, arm, circumstances
from commands import output, refused
from slow_parameters import some_fast

import robacc
from robacc.comparison.comparing import promise_test
from robacc.correction import length_bound
from robacc.effects import REGISTRY
from robacc.effects.specification import absorbed, entry_of, with_effect_units
from robacc.fitting.parameters import absorb_constants
from robacc.geometry import Array, log_between
from robacc.measurements import Measurements, motion_between_rows
from robacc.modelling.model import Model, predict
from robacc.prediction.model_uncertainty import ModelFit, coverage, model_fit, model_uncertainty
from robacc.render.plots.canvas import as_part
from robacc.render.plots.results import chart_of
from robacc.robots.arm import Arm
from robacc.robots.description import Frame, Robot
from robacc.robots.yaml_robot import parse_robot, robot_to_yaml
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


def test_an_independent_arm_reaches_its_wanted_poses() -> None:
    """Geometry, gear ratios, play by the approach, and sag in equilibrium."""
    flange, rng = dataclasses.replace(independent_arm.robot(), tool=Frame()), np.random.default_rng(5)
    geometry = np.zeros((6, 4))
    geometry[[1, 2, 3], [2, 3, 1]] = 3e-4, -4e-4, 2e-4
    offsets, scale = rng.normal(scale=5e-4, size=(6, 1)), rng.normal(scale=2e-4, size=(6, 1))
    play, compliance = np.array([[0, 1e-4, -2e-4, 0, 0, 5e-5], [0, 1e-6, 2e-6, 0, 0, 0]])[..., None]
    errors = {"joint_offset": offsets, "gear_ratio": scale, "backlash": play, "joint_compliance": compliance}
    entries = [
        {
            "effect": effect,
            "joints": [*flange.variable_names],
            "values": dict(zip(flange.variable_names, sizes[:, 0], strict=True)),
        }
        for effect, sizes in errors.items()
    ]
    lengths = {"j2.a": 3e-4, "j3.alpha": -4e-4, "j4.d": 2e-4}
    entries.append({"effect": "link_geometry", "joints": ["j2", "j3", "j4"], "values": lengths})
    model = dataclasses.replace(flange, effects=tuple(entries), effect_units=(1.0, 1.0))
    q = middle_joints(flange, 30, seed=2)
    result = robacc.correct(joint_targets(q), model=model, nominal=flange)
    chosen = result.is_corrected
    assert chosen.sum() >= 25

    def reached(commands: Array) -> Array:
        turned = rigid = commands * (1 + scale) + offsets + play * np.sign(np.diff(commands, prepend=commands[:, :1]))
        for _ in range(30):
            turned = rigid + compliance * independent_arm.torques(turned, geometry=geometry)
        return independent_arm.link_frames(turned, geometry)[-1][chosen]

    wanted = independent_arm.link_frames(q)[-1][chosen]
    real, uncorrected = reached(result.q), reached(q)
    # Central differences of an energy of some 1e3 J with steps of 1e-5 leave 1e-7 N m, here 1e-13 rad.
    assert np.linalg.norm((real - wanted)[:, :3, 3], axis=1).max() < MICROMETRE
    assert np.abs((real - wanted)[:, :3, :3]).max() < 1e-6
    before = np.linalg.norm((uncorrected - wanted)[:, :3, 3], axis=1)
    np.testing.assert_allclose(before, result.before.position[chosen], rtol=0, atol=1e-8)
    assert before.min() > 100 * MICROMETRE


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


# By default each effect on one arm or two, and each arm with several effects.
@pytest.mark.parametrize(("name", "kind"), some_fast(product(REGISTRY, arms_of_all_kinds()), 8))
def test_every_effect_on_every_arm(name: str, kind: str) -> None:
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
    real, wanted = predict(model, dataclasses.replace(data, q=targets.q)), predict(robot, data)
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
    assert nominal.base.xyz == (0.0, 0.0, 0.0)
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
    paths = os.pathsep.join([str(STUDIES.parent), os.environ.get("PYTHONPATH", "")])
    environment = os.environ | {"PYTHONPATH": paths}
    subprocess.run([*words, "--json", str(result)], cwd=STUDIES, check=True, timeout=1200, env=environment)
    rows = json.loads(result.read_text())["rows"]
    assert len(rows) == 6
    assert max(row["ratio"] for row in rows) <= 1.2
    # Targets of one arm share the errors of its coefficients: six arms bound the share loosely.
    assert np.mean([flag for row in rows for flag in row["covered"]]) > 0.85


FIT = "base_frame,tool_frame,joint_offset[j2,j3,j4,j5],link_geometry[j1,j2,j3,j4],joint_compliance[j2],backlash[j3]"


@cache
def calibrated(seed: int, n: int = 60, *, orientation: bool = True) -> robacc.Calibrated:
    """A calibration of simulated poses with known noise."""
    noise = {"noise": "0.03mm", "noise_orientation": "0.03mrad", "sigma": True}
    data = robacc.simulate(TRUTH, poses=n, seed=seed, position_only=not orientation, **noise).data
    return robacc.calibrate(data, robot=ROBOT, fit=FIT, folds=4, shrink=False)


def test_model_file_keeps_the_record() -> None:
    result = calibrated(1)
    robot = parse_robot(result.model_yaml(), "model.yaml")
    own, read = model_fit(result.robot), model_fit(robot)
    assert read.coefficients == own.coefficients
    np.testing.assert_allclose(read.covariance, own.covariance, rtol=1e-10)
    assert set(read.coefficients) <= {parameter.name for parameter in result.parameters}
    columns = [result.fit.names.index(name) for name in read.coefficients]
    np.testing.assert_allclose(read.covariance, result.fit.covariance[np.ix_(columns, columns)], rtol=1e-10)
    # The writer writes what it read, byte for byte, and other commands do not mind the part.
    robot = with_effect_units(robot)
    assert robot_to_yaml(parse_robot(robot_to_yaml(robot), "again.yaml")) == robot_to_yaml(robot)
    assert robacc.simulate(robot, poses=3).data.n == 3


def test_nominal_robot_comes_back_from_the_model() -> None:
    result = calibrated(1)
    targets = robacc.simulate(ROBOT, poses=12, seed=5, motion=False).data
    own = robacc.correct(targets, model=result.robot)
    given = robacc.correct(targets, model=result.robot, nominal=ROBOT)
    np.testing.assert_allclose(own.q, given.q, atol=1e-9)
    limit, largest = own.document()["limit"], model_fit(result.robot).largest_correction[0]
    assert (own.warnings, limit["source"], limit["position_m"]) == ((), "model", pytest.approx(2 * largest))


@pytest.mark.parametrize("orientation", [pytest.param(True, marks=pytest.mark.slow), False])
def test_errors_after_the_correction_keep_their_bound(orientation: bool) -> None:
    truth, inside, ratio = robacc.read_robot(TRUTH), [], []
    for seed in range(3):
        model = calibrated(seed, orientation=orientation).robot
        targets = robacc.simulate(ROBOT, poses=60, seed=100 + seed, motion=False).data
        result = robacc.correct(targets, model=model, beyond_range=True)
        real = predict(truth, result.data).translation
        chosen = result.is_corrected
        error = np.linalg.norm(real - result.wanted.poses.translation, axis=0)[chosen]
        bound = result.after.position_bound
        inside.append(np.mean(error <= bound[chosen]))
        spread = np.sqrt(np.mean((bound[chosen] / 1.8) ** 2) + 3 * 0.03e-3**2)
        ratio.append(np.sqrt(np.mean(error**2)) / spread)
        assert np.sqrt(np.mean(error**2)) < 0.1 * np.sqrt(np.mean(result.before.position[chosen] ** 2))
    # Errors of one fit belong together, so few fits leave a wide range; an unknown noise makes the bound wide.
    assert 0.88 <= np.mean(inside) <= 1.0
    assert max(ratio) < 1.2


def test_predict_gives_the_accuracy_of_the_calibrated_arm(tmp_path: Path) -> None:
    model = tmp_path / "model.yaml"
    calibrated(1).write_model(model)
    prediction = robacc.predict(model, samples=200)
    names = {share["parameter"] for share in prediction.budget}
    assert names == {"coefficients", "repeatability", "unexplained", "extrapolation"}
    assert sum(share["share_position"] for share in prediction.budget) == pytest.approx(1.0)
    assert prediction.position.rms < 1e-4
    assert prediction.grade["grade"] in "AB"
    rows = prediction.map_csv("250mm").splitlines()
    assert rows[0].startswith("x_m,y_m,z_m,configurations,rms_m,bound95_m")
    assert sum(int(row.split(",")[3]) for row in rows[1:]) == 200
    measured = robacc.simulate(TRUTH, poses=80, seed=55, noise="0.03mm", noise_orientation="0.03mrad").data
    # The poses state no noise, which is larger than the model's error: the fit knows that of its own poses.
    bare = robacc.predict(model, against=measured).coverage["position"]
    assert bare["noise_source"] == "fit"
    assert 0.85 < bare["share"] <= 1.0
    assert robacc.predict(model, against=measured, noise="0.001mm,0.001mrad").coverage["position"]["share"] < 0.5
    against = robacc.predict(model, against=measured, noise="0.03mm,0.03mrad")
    position = against.coverage["position"]
    # Two standard errors of a share of 80 poses are 5 %, and the errors of one fit belong together.
    assert 0.85 < position["share"] <= 1.0
    document = against.payload()["coverage"]
    told = {"n_poses": 80, "n_inside": position["n_inside"], "share": position["share"], "noise_source": "given"}
    assert (document["position"], list(document["registered"])) == (told, [])
    with pytest.raises(robacc.InputError, match="tolerance"):
        robacc.predict(ROBOT)


def test_warranty_map_is_in_the_result_and_drawn() -> None:
    prediction = robacc.predict(calibrated(1).robot, samples=120)
    document = json.loads(prediction.to_json())
    voxels = document["warranty_map"]
    csv = [row.split(",") for row in prediction.map_csv(voxels["voxel_m"]).splitlines()[1:]]
    assert ([row[-1] for row in csv], [int(row[3]) for row in csv]) == (voxels["grade"], voxels["configurations"])
    # The grade of a voxel is that of its worst configuration.
    q = prediction.configurations.q
    sampled = robacc.Measurements(position=np.zeros((3, q.shape[1])), q=q)
    poses = predict(dataclasses.replace(prediction.robot, effects=()), sampled).translation
    for centre, n, bound in zip(voxels["centre_m"], voxels["configurations"], voxels["bound95_m"], strict=True):
        inside = np.all(np.abs(poses - np.array(centre)[:, None]) < 0.5 * voxels["voxel_m"], axis=0)
        assert np.count_nonzero(inside) == n
        assert prediction.position.pose_radius95[inside].max() == pytest.approx(bound, rel=1e-9)
    chart = chart_of(document, "warranty")
    assert sum(len(trace["x"]) for trace in chart.scene["traces"]) == len(voxels["grade"])
    assert f"of {len(voxels['grade'])} voxels" in chart.caption
    assert "grade" in as_part(chart, "x")


def test_errors_of_the_measurement_do_not_hide_errors_of_the_arm() -> None:
    """An unknown scale of the instrument leaves measured poses certain and the arm's own poses uncertain."""
    noise = {"noise": "0.05mm", "position_only": True, "sigma": True}
    data = robacc.simulate(ROBOT, poses=60, seed=3, **noise).data
    fit = "base_frame,tool_frame,joint_offset[j2,j3],instrument_scale"
    result = robacc.calibrate(data, robot=ROBOT, fit=fit, folds=2)
    record = model_fit(result.robot)
    bare = dataclasses.replace(record, unexplained=0 * record.unexplained, bound_factor=(1.0, 1.0))
    poses = robacc.simulate(ROBOT, poses=40, seed=9).data
    of_arm, of_measured = (model_uncertainty(result.robot, bare, poses, measured=flag)[0][0] for flag in (False, True))
    # Independent: propagate the coefficients, with the scale's column p dp/ds = position where it is measured.
    names = list(record.coefficients)
    scale = names.index("instrument_scale")
    others = [i for i in range(len(names)) if i != scale]
    draws = np.random.default_rng(0).multivariate_normal(np.zeros(len(names)), record.covariance, 4000)
    jacobian = differences(result.robot, record, poses)[:, others]
    moved = np.einsum("ipn,dp->din", jacobian, draws[:, others])
    expected = np.einsum("din,din->n", moved, moved) / len(draws)
    np.testing.assert_allclose(np.einsum("iin->n", of_arm), expected, rtol=0.12)
    moved += draws[:, scale, None, None] * predict(result.robot, poses).translation
    expected = np.einsum("din,din->n", moved, moved) / len(draws)
    np.testing.assert_allclose(np.einsum("iin->n", of_measured), expected, rtol=0.12)
    assert not np.allclose(np.einsum("iin->n", of_arm), np.einsum("iin->n", of_measured), rtol=0.12, atol=0.0)


def differences(robot: Robot, record: ModelFit, poses: robacc.Measurements) -> np.ndarray:
    """Derivative (3, P, N) of the predicted positions to the coefficients, by differences."""
    bound = Model.of(absorb_constants(robot), record.effects).bind(poses)
    columns = []
    for name in record.coefficients:
        step = np.zeros(len(bound.names))
        step[bound.names.index(name)] = 1e-6
        columns.append((bound.poses(step).translation - bound.poses(-step).translation) / 2e-6)
    return np.stack(columns, axis=1)


def test_records_that_were_changed_are_refused() -> None:
    robot = calibrated(1).robot
    for key, value in (("covariance", ["1", "2 3"]), ("coefficients", None), ("effects", [{"effect": "wrong"}])):
        with pytest.raises(robacc.InputError, match="fit"):
            robacc.predict(dataclasses.replace(robot, fit={**robot.fit, key: value}))
    without = dataclasses.replace(robot, fit={k: v for k, v in robot.fit.items() if k != "noise"})
    with pytest.raises(robacc.InputError, match="'noise' is missing"):
        robacc.correct(robacc.simulate(ROBOT, poses=3).data, model=without)


def test_targets_outside_the_ranges_of_the_fit_are_refused() -> None:
    model = calibrated(1).robot
    fit = model_fit(model)
    narrow = dataclasses.replace(fit, ranges={**fit.ranges, "j1": (-1.0, 1.0)})
    model = dataclasses.replace(model, fit=narrow.entry())
    targets = robacc.simulate(ROBOT, poses=20, seed=5, motion=False).data
    result, allowed = (robacc.correct(targets, model=model, beyond_range=beyond) for beyond in (False, True))
    outside = np.flatnonzero(np.abs(targets.q[0]) > 1.1)
    assert {result.refusals[i].cause for i in outside} == {"out_of_range"}
    assert allowed.n_corrected > result.n_corrected


# -- after the correction
def measured(robot: Robot, targets: robacc.Measurements, seed: int) -> robacc.Measurements:
    data = robacc.simulate(robot, at=targets, seed=seed, noise="0.02mm", noise_orientation="0.02mrad").data
    return dataclasses.replace(data, pose=np.array([f"P{i}" for i in range(data.n)]))


def test_compare_paired_sees_gain_promise_and_a_correction_that_is_not_loaded() -> None:
    truth, model = robacc.read_robot(TRUTH), calibrated(2).robot
    targets = robacc.simulate(ROBOT, poses=40, seed=7, motion=False).data
    correction = robacc.correct(targets, model=model, beyond_range=True)
    chosen = np.flatnonzero(correction.is_corrected)
    nominal, wanted = targets.subset(chosen), correction.wanted.poses
    corrected = dataclasses.replace(nominal, q=correction.q[:, chosen])
    before, after, again = (
        dataclasses.replace(
            measured(truth, visited, seed),
            commanded_position=wanted.translation[:, chosen],
            commanded_rotation=wanted.rotation[..., chosen],
        )
        for seed, visited in ((1, nominal), (2, corrected), (3, nominal))
    )
    result = robacc.compare_paired(before, after, model=model, noise="0.02mm")
    assert (result.loaded["verdict"], result.loaded["slope"]) == ("loaded", pytest.approx(1.0, abs=0.03))
    assert result.gain.low > 0.0
    assert result.metrics_after.rms < 0.1 * result.metrics_before.rms
    assert result.promise["kept"]
    # The robot drove to the nominal targets again.
    again = dataclasses.replace(again, q=corrected.q)
    result = robacc.compare_paired(before, again, model=model, noise="0.02mm")
    assert (result.loaded["verdict"], result.promise["kept"]) == ("not_loaded", False)
    assert any("no sign that the correction was loaded" in warning for warning in result.warnings)
    # Half of it, and no model: the plan is then the error before.
    half = 0.5 * (before.position + after.position)
    result = robacc.compare_paired(before, dataclasses.replace(after, position=half))
    assert (result.loaded["verdict"], result.loaded["slope"]) == ("partly_loaded", pytest.approx(0.5, abs=0.05))
    assert result.promise is None


def test_noise_that_the_unexplained_error_contains_is_not_ignored_without_a_word() -> None:
    """A model whose poses do not show their noise: it is part of the unexplained error."""
    data = robacc.simulate(TRUTH, poses=60, seed=4, noise="0.03mm", position_only=True).data
    model = robacc.calibrate(data, robot=ROBOT, fit=FIT, folds=4, shrink=False).robot
    assert not model_fit(model).noise_is_separate
    targets = robacc.simulate(ROBOT, poses=30, seed=7, motion=False).data
    before, after = (measured(robacc.read_robot(TRUTH), targets, seed) for seed in (1, 2))
    promises = {}
    for noise, told in (
        (None, None),
        ("0.001mm", "`noise` of 0.001 mm is not added"),
        ("2mm", "`noise` of 2 mm is not added"),
    ):
        result = robacc.compare_paired(before, after, model=model, nominal=ROBOT, noise=noise)
        promises[noise] = result.document()["promise"]
        warnings = "\n".join(result.warnings)
        assert told in warnings if told else "is not added" not in warnings
        if noise:
            stated = promises[noise]["noise"]
            assert (stated["treatment"], stated["source"]) == ("contained", "given")
    # Smaller than the unexplained error: nothing changes. Larger: the remaining error is at least the noise.
    assert promises["0.001mm"]["chi_square"] == promises[None]["chi_square"]
    assert promises["2mm"]["promised_rms_m"] == pytest.approx(np.sqrt(3) * 2e-3, rel=0.01)
    # The noise of the file counts alike.
    stated = dataclasses.replace(after, sigma_position=np.full((3, after.n), 2e-3))
    result = robacc.compare_paired(before, stated, model=model, nominal=ROBOT)
    promise = result.document()["promise"]
    assert (promise["noise"]["source"], promise["chi_square"]) == ("file", pytest.approx(promises["2mm"]["chi_square"]))
    assert any("the noise of `after` of 2 mm is not added" in warning for warning in result.warnings)


def test_noise_of_a_model_that_knows_it_is_added() -> None:
    model = calibrated(2).robot
    fit = model_fit(model)
    # As the poses stated it, without what is unexplained.
    assert (fit.noise_is_separate, fit.noise) == (True, pytest.approx((0.03e-3, 0.03e-3)))
    targets = robacc.simulate(ROBOT, poses=30, seed=7, motion=False).data
    before, after = (measured(robacc.read_robot(TRUTH), targets, seed) for seed in (1, 2))
    small, large = (
        robacc.compare_paired(before, after, model=model, nominal=ROBOT, noise=noise) for noise in (1e-5, 1e-3)
    )
    assert "is not added" not in "\n".join((*small.warnings, *large.warnings))
    added = large.promise["promised_rms_m"] ** 2 - small.promise["promised_rms_m"] ** 2
    assert added == pytest.approx(3e-6 - 3e-10, rel=1e-6)
    bare = dataclasses.replace(fit, unexplained=0.0 * fit.unexplained, repeatability={})
    certain = dataclasses.replace(model, fit=bare.entry())
    with pytest.raises(robacc.UsageError, match="`noise` must be more than 0"):
        robacc.compare_paired(before, after, model=certain, nominal=ROBOT, noise=0.0)


def test_targets_of_equal_names_and_targets_that_were_not_fitted_are_compared() -> None:
    """Coefficients of two targets share no column, and a target that is not measured again has none."""

    robot = dataclasses.replace(
        robacc.read_robot(ROBOT), targets={"A": Frame(xyz=(0.05, 0.0, 0.1)), "B": Frame(xyz=(-0.05, 0.02, 0.1))}
    )
    data = robacc.simulate(robot, poses=40, seed=3, noise="0.03mm", position_only=True, sigma=True).data
    model = robacc.calibrate(data, robot=robot, fit="base_frame,tool_frame,joint_offset", folds=2).robot
    alone = data.subset(np.flatnonzero(data.target == "A")[:10])
    result = robacc.compare_paired(alone, alone, model=model, nominal=robot)
    assert result.promise["degrees_of_freedom"] == 30


def test_promise_is_kept_as_often_as_it_claims() -> None:
    """The normalised square of what is drawn from the promised covariance has the mean and variance of a chi-square."""

    rng = np.random.default_rng(0)
    n, count = 12, 5
    jacobian, root = rng.normal(size=(3, count, n)), np.diag(rng.uniform(0.5, 2.0, count))
    separate = np.repeat(np.diag([1.0, 2.0, 0.5])[:, :, None], n, axis=2)
    squares = []
    for _ in range(300):
        shared = np.einsum("ipn,p->in", jacobian, root @ rng.normal(size=count))
        own = np.sqrt([[1.0], [2.0], [0.5]]) * rng.normal(size=(3, n))
        squares.append(promise_test(shared + own, jacobian, root @ root.T, separate)["chi_square"])
    # Mean 36 with a standard error of sqrt(72 / 300) = 0.5.
    assert (np.mean(squares), np.var(squares)) == (pytest.approx(3 * n, abs=2.0), pytest.approx(6 * n, rel=0.35))


def test_approaches_that_no_file_states_are_not_held_against_measurements() -> None:
    """Directions were drawn at random, so that a model with backlash did not agree with its own arm."""
    stated = measured(robacc.read_robot(TRUTH), robacc.simulate(ROBOT, poses=30, seed=7).data, 1)
    unstated = dataclasses.replace(stated, direction=None, speed=None)
    model = calibrated(2).robot
    assert coverage(model, model_fit(model), stated, 0)["position"]["n_poses"] == 30
    with pytest.raises(robacc.UsageError, match="backlash needs the column dir_q1"):
        coverage(model, model_fit(model), unstated, 0)
    with pytest.raises(robacc.UsageError, match="backlash needs the column dir_q1"):
        robacc.compare_paired(unstated, unstated, model=model, nominal=ROBOT, noise="0.02mm")


JOB = """\
/JOB
//NAME CELL
//POS
///NPOS 2,0,0,0,0,0
///TOOL 0
///POSTYPE ANGLE
///ANGLE
C00000=10.0,20.0,-30.0,5.0,45.0,7.0
C00001=12.0,22.0,-32.0,5.0,45.0,9.0
//INST
NOP
MOVJ C00000 VJ=10.00
MOVJ C00001 VJ=10.00
END
"""


def test_positions_of_a_job_are_targets_that_a_csv_takes(tmp_path: Path) -> None:
    job, model, corrected = tmp_path / "cell.JBI", tmp_path / "model.yaml", tmp_path / "corrected.csv"
    job.write_text(JOB)
    robacc.write_robot(model, independent_arm.robot())
    words = ("correct", job, "--model", model, "--nominal", model, "--output")
    output(*words, corrected)
    found = np.loadtxt(corrected, delimiter=",", skiprows=2, usecols=range(6))
    np.testing.assert_allclose(np.degrees(found), [[10, 20, -30, 5, 45, 7], [12, 22, -32, 5, 45, 9]], atol=1e-6)
    assert "back.jbi is not written; name a CSV with --output" in refused(*words, tmp_path / "back.jbi")
