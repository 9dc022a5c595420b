"""Models: evaluation, files, and the range in which they are valid."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
from arms import CONFIGURED, arm, circumstances, suited
from robot_files import URDF_LIKE
from sample_files import ROOT
from scipy.optimize import brentq

import robacc
from robacc import InputError, Measurements, Robot, UsageError, read_robot
from robacc.effects import REGISTRY
from robacc.effects.base import Effect
from robacc.effects.elastic import JointHardening
from robacc.effects.frames import FrameDrift
from robacc.effects.periodic import TransmissionError
from robacc.effects.specification import Known, entry_of, known_effects, with_effect_units
from robacc.fitting.parameters import apply_fit
from robacc.fitting.solver import fit
from robacc.gravity import weight_torques
from robacc.modelling.model import Model, predict
from robacc.modelling.robot_file import model_text
from robacc.modelling.validity import outside_validity
from robacc.robots.arm import Arm
from robacc.robots.description import DH_PARAMETERS, Campaign, Frame, Joint
from robacc.robots.yaml_robot import parse_robot, robot_document, robot_to_yaml
from robacc.simulation.simulate import Plan, simulate

# The model as a whole: values known and free, targets, elasticity against textbook statics.

GEOMETRY = ("base_frame", "tool_frame", "joint_offset", "link_geometry")


def pendulum(length: float = 1.0, mass: float = 10.0) -> Robot:
    """One joint of horizontal axis (y of the measuring frame, pointing away), a mass at the end of its link."""
    parameters = dict.fromkeys(DH_PARAMETERS, 0.0) | {"a": length}
    joint = Joint("j1", "revolute", parameters, mass=mass, com=(0.0, 0.0, 0.0))
    # Rx(90 deg) turns the axis to -y of the measuring frame: a positive angle lifts the mass.
    return Robot("pendulum", "standard", (joint,), base=Frame(rpy=(np.pi / 2, 0.0, 0.0)))


def at(*angles: float) -> Measurements:
    return Measurements(position=np.zeros((3, len(angles))), q=np.array([angles]))


def test_a_pendulum_sags_to_the_equilibrium_of_statics() -> None:
    # theta = q - c m g l cos(theta), solved here by bisection, independently of the sweeps.
    compliance, weight = 2e-3, 10.0 * 9.81
    entry = {"effect": "joint_compliance", "joints": ["j1"], "values": {"j1": compliance}}
    robot = dataclasses.replace(pendulum(), effects=(entry,))
    commanded = (0.0, 0.4, 1.2, -0.7)
    predicted = predict(robot, at(*commanded)).translation
    for i, q in enumerate(commanded):
        low, high = q - 1.0, q + 1.0
        for _ in range(100):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if middle < q - compliance * weight * np.cos(middle) else (low, middle)
        np.testing.assert_allclose(predicted[:, i], [np.cos(low), 0.0, np.sin(low)], rtol=0, atol=1e-13)


def test_a_pendulum_of_the_rigid_form_sags_by_the_moment_where_it_was_commanded() -> None:
    # theta = q + e + c tau(q + e): the zero error e moves the moment, what the joint gives way to does not.
    compliance, weight, zero = 2e-3, 10.0 * 9.81, 0.1
    rigid = {"joints": ["j1"], "deflection": "rigid"}
    entries = (
        {"effect": "joint_offset", "joints": ["j1"], "values": {"j1": zero}},
        {"effect": "joint_compliance", **rigid, "values": {"j1": compliance}},
    )
    robot = dataclasses.replace(pendulum(), effects=entries)
    commanded = np.array([0.0, 0.4, 1.2, -0.7])
    predicted = predict(robot, at(*commanded)).translation
    turned = commanded + zero - compliance * weight * np.cos(commanded + zero)
    np.testing.assert_allclose(predicted, [np.cos(turned), 0 * turned, np.sin(turned)], rtol=0, atol=1e-15)


def test_an_equilibrium_sees_the_deflections_of_the_rigid_form_and_not_the_other_way_round() -> None:
    compliance, weight, q = 2e-3, 10.0 * 9.81, 0.4
    first = {"effect": "joint_compliance", "joints": ["j1"], "deflection": "rigid", "values": {"j1": compliance}}
    second = {"effect": "payload_compliance", "joints": ["j1"], "values": {"j1": compliance}}
    robot = dataclasses.replace(pendulum(), effects=(second, first), payload_com=(0.0, 0.0, 0.0))
    predicted = predict(robot, dataclasses.replace(at(q), payload=np.array([10.0]))).translation[:, 0]
    sag = compliance * weight * np.cos(q)
    angle = brentq(lambda t: t - (q - sag - compliance * weight * np.cos(t)), -1.0, 1.0, xtol=1e-15)
    np.testing.assert_allclose(predicted, [np.cos(angle), 0.0, np.sin(angle)], rtol=0, atol=1e-13)


def test_a_payload_where_the_file_puts_it_sags_the_joint_and_none_does_not() -> None:
    entry = {"effect": "payload_compliance", "joints": ["j1"], "values": {"j1": 1e-5}}
    robot = dataclasses.replace(pendulum(), effects=(entry,), payload_com=(0.5, 0.0, 0.0))
    data = dataclasses.replace(at(0.0, 0.0), payload=np.array([0.0, 4.0]))
    height = predict(robot, data).translation[2]
    assert height[0] == 0.0
    # 4 kg at 1.5 m: first order c m g r, the second is 1e-7 of a 6e-4 rad turn.
    assert height[1] == pytest.approx(-1e-5 * 4 * 9.81 * 1.5, rel=1e-5)


def test_a_base_and_a_bearing_tilt_the_way_gravity_pulls() -> None:
    for effect, entry in (
        ("base_compliance", {"values": {"value": 1e-5}}),
        ("lateral_compliance", {"joints": ["j1"], "values": {"j1": 1e-5}}),
    ):
        # An axis that stands upright feels the weight as a bending moment alone, and so does the pedestal.
        robot = dataclasses.replace(pendulum(), base=Frame(), effects=({"effect": effect, **entry},))
        height = predict(robot, at(0.0)).translation[2, 0]
        assert height == pytest.approx(-1e-5 * 10 * 9.81, rel=1e-5), effect


@pytest.mark.parametrize("name", ["stanford", "scara", "urdf:stanford"])
def test_a_slides_travel_grows_with_the_links_unless_its_scale_does_not(name: str) -> None:
    """At the temperature that makes every length a thousandth longer the whole arm is as if drawn larger."""
    robot_arm = arm(name)
    bare = dataclasses.replace(robot_arm.robot, base=Frame(), tool=Frame(), targets={}, effects=())
    data = dataclasses.replace(circumstances(bare, 7), temperature=np.full(7, 120.0))
    nominal = predict(bare, data).translation
    entry = {"effect": "thermal_expansion", "values": {"value": 1e-5}}
    grown = predict(dataclasses.replace(bare, effects=(entry,)), data).translation
    np.testing.assert_allclose(grown, 1.001 * nominal, rtol=0, atol=1e-12)
    fixed = predict(dataclasses.replace(bare, effects=({**entry, "slides": False},)), data).translation
    slide = [joint.type for joint in bare.variables].index("prismatic")
    step = 1e-6
    moved = dataclasses.replace(data, q=data.q + step * np.eye(len(data.q))[:, [slide]])
    direction = (predict(bare, moved).translation - nominal) / step
    travel = robot_arm.chain.scalars(data.q)[robot_arm.chain.drives[slide].motion]
    np.testing.assert_allclose(grown - fixed, 1e-3 * travel * direction, rtol=0, atol=1e-8)


def test_poses_that_do_not_fit_the_robot_are_refused() -> None:
    robot_arm = arm("puma560")
    data = circumstances(robot_arm.robot, 3)
    with pytest.raises(UsageError, match="needs the column q1 … qN"):
        predict(robot_arm.robot, dataclasses.replace(data, q=None))
    with pytest.raises(UsageError, match="the robot has 6 joints, but the poses have 5"):
        predict(robot_arm.robot, dataclasses.replace(data, q=data.q[:5]))


def test_each_target_is_the_tool_of_its_rows() -> None:
    robot_arm = arm("targets:puma560")
    data = circumstances(robot_arm.robot, 12)
    both = predict(robot_arm.robot, data).translation
    for name, frame in robot_arm.robot.targets.items():
        alone = dataclasses.replace(robot_arm.robot, targets={}, tool=frame)
        rows = data.target == name
        # Same motions, constant here and one array there: rounding of a metre.
        np.testing.assert_allclose(both[:, rows], predict(alone, data).translation[:, rows], rtol=0, atol=1e-14)
    with pytest.raises(UsageError, match="the robot has the targets a, b; add a column target to the poses"):
        predict(robot_arm.robot, dataclasses.replace(data, target=None))


def measured(robot: Robot, n: int, *, orientation: bool = True) -> Measurements:
    plan = Plan(n, seed=4, noise_position=2e-5, noise_orientation=2e-5, orientation=orientation, payloads=(0.0, 3.0))
    return simulate(robot, plan).data


@pytest.mark.parametrize("name", CONFIGURED)
def test_number_of_identifiable_geometric_parameters(name: str) -> None:
    # 4 R + 2 P + 6: Everett, Driels, Mooring 1987. Of a point three of the tool's six cannot be seen.
    robot_arm = arm(name)
    revolute = sum(joint.type == "revolute" for joint in robot_arm.robot.variables)
    full = 4 * revolute + 2 * (len(robot_arm.names) - revolute) + 6
    for orientation, expected in ((True, full), (False, full - 3)):
        data = measured(robot_arm.robot, 60, orientation=orientation)
        free = [REGISTRY[effect].default(robot_arm, data) for effect in GEOMETRY]
        identified = fit(Model.of(robot_arm.robot, free), data).identifiability
        assert identified.columns.size == expected
        assert len(identified.dropped) == sum(len(e.terms(robot_arm, data)) for e in free) - expected
        assert all(why.why for why in identified.dropped)


# A fitted model keeps the units, comments, order and unchanged numbers of the robot file, and reads as the fit.


ROBOTS = [ROOT / "configs" / "robots" / f"{name}.yaml" for name in ("panda", "scara")]

ROBOTS += [ROOT / "robacc" / "data" / "robots" / f"{name}.yaml" for name in ("r2000ic_165f", "xarm5_lite")]

ARM = """# cell 7
robacc: 1
name: cell 7
identity: {customer: Example, serial_number: 1234}   # as on the order
convention: standard
units: {length: mm, angle: deg}
tool: {xyz: [40, 0, 180]}  # nest 1
joints:
  # the base turns
  - {name: j1, type: revolute, d: 486.5, a: 150, alpha: -90, limits: [-180, 180], mass: 95, com: [-60, 40, -20]}
  - name: j2
    type: prismatic
    theta: 30.0      # drawing 12-3
    d: 0
    a: 700
    alpha: 0
    limits: [0, 500]
    coupling: {j1: 2.5}
effects:
  # measured in March
  - {effect: backlash, joints: [j1], values: {j1: 0.01}}
  - {effect: joint_correction, joints: [j1], drivers: [j2], range: [[0, 250]], degree: 3,
     values: {j1.j2.T2: 0.01}, validity: {j2: [0, 250]}}
"""


def numbers(value: object) -> list[float]:
    if isinstance(value, dict):
        return [number for item in value.values() for number in numbers(item)]
    if isinstance(value, list | tuple):
        return [number for item in value for number in numbers(item)]
    return [value] if isinstance(value, float) else []


def assert_same(first: Robot, second: Robot) -> None:
    documents = [robot_document(with_effect_units(robot)) for robot in (first, second)]
    values = [np.array(numbers(document)) for document in documents]
    # Twelve digits of 150 degrees or millimetres.
    np.testing.assert_allclose(*values, rtol=1e-11, atol=1e-11)
    assert [str(document.keys()) for document in documents[:1]] == [str(document.keys()) for document in documents[1:]]


def fitted(robot: Robot) -> Robot:
    """Return a robot with other numbers in every place that a fit changes."""
    random = np.random.default_rng(1)
    joints = tuple(
        dataclasses.replace(
            joint, parameters={name: value + 1e-3 * random.normal() for name, value in joint.parameters.items()}
        )
        for joint in robot.joints
    )
    frame = Frame((0.001, 0.0, -0.5), (0.0, 0.25, 0.0))
    entry = {"effect": "backlash", "joints": [robot.variable_names[-1]], "values": {robot.variable_names[-1]: 1e-4}}
    return dataclasses.replace(
        with_effect_units(robot),
        joints=joints,
        base=frame,
        effects=(*with_effect_units(robot).effects, entry),
        fitted_to=("0" * 64,),
        fit={"names": ["a", "b"], "values": [1e-3, 2.5]},
        campaign=Campaign(("0" * 64,), base=frame),
    )


@pytest.mark.parametrize("path", ROBOTS, ids=lambda path: path.stem)
def test_models_of_every_robot_file_read_as_the_fit(path: Path) -> None:
    robot = fitted(read_robot(path))
    text = model_text(robot, ("made by a test",))
    assert_same(parse_robot(text, "model.yaml"), robot)
    lines = text.splitlines()
    assert lines.pop(0) == "# made by a test"
    if "#" in path.read_text(encoding="utf-8"):
        assert lines.pop(0) == "# the comments below are those of the robot file before the fit"
    comments = [line for line in path.read_text(encoding="utf-8").splitlines() if line.lstrip().startswith("#")]
    assert [line for line in lines if line.lstrip().startswith("#")] == comments


def test_a_model_differs_from_its_file_by_what_was_fitted_alone() -> None:
    robot = parse_robot(ARM, "arm.yaml")
    joint = robot.joints[1]
    changed = dataclasses.replace(joint, parameters={**joint.parameters, "d": 0.0125, "theta": math.radians(30.5)})
    si = with_effect_units(robot)
    entry = {"effect": "joint_compliance", "joints": ["j1"], "values": {"j1": math.radians(5e-5)}}
    model = dataclasses.replace(
        si, joints=(robot.joints[0], changed), tool=Frame((0.0402, 0.0, 0.18)), effects=(*si.effects, entry)
    )
    expected = (
        ARM.replace("30.0 ", "30.5 ").replace("d: 0\n", "d: 12.5\n").replace("[40, 0", "[40.2, 0")
        + "  - effect: joint_compliance\n    joints: [j1]\n    values: {j1: 5.0e-05}\n"
    )
    remark = "# the comments below are those of the robot file before the fit\n"
    assert model_text(model) == remark + expected
    assert model_text(robot) == remark + ARM
    # A model that is fitted again has the remark once.
    assert model_text(parse_robot(remark + ARM, "arm.yaml")) == remark + ARM
    assert_same(parse_robot(expected, "arm.yaml"), model)


def test_effects_that_a_fit_absorbs_leave_the_file() -> None:
    without = dataclasses.replace(with_effect_units(parse_robot(ARM, "arm.yaml")), effects=())
    text = model_text(without)
    assert "# drawing 12-3" in text
    assert parse_robot(text, "arm.yaml").effects == ()


def test_a_part_of_an_older_fit_does_not_stay() -> None:
    robot = parse_robot(ARM + "fit: {old: 1, names: [x]}   # of May\n", "arm.yaml")
    text = model_text(dataclasses.replace(with_effect_units(robot), fit={"names": ["y", "z"], "new": 2.0}))
    assert "old" not in text
    assert parse_robot(text, "arm.yaml").fit == {"names": ["y", "z"], "new": 2.0}
    assert "# nest 1" in text


@pytest.mark.parametrize(
    ("robot", "units"),
    [
        pytest.param(fitted(parse_robot(URDF_LIKE, "arm.yaml")), "{length: mm, angle: deg}", id="joints of a URDF"),
        pytest.param(
            dataclasses.replace(parse_robot(ARM, "arm.yaml"), file_text=None), "{length: m, angle: rad}", id="no file"
        ),
    ],
)
def test_a_model_has_the_units_of_its_file_or_metres_and_radians(robot: Robot, units: str) -> None:
    text = model_text(robot)
    assert f"units: {units}" in text
    assert_same(parse_robot(text, "arm.yaml"), robot)


def test_a_form_that_cannot_be_kept_is_written_anew_in_the_same_units() -> None:
    # The fit left the coupling out, which the file's joint states.
    robot = parse_robot(ARM, "arm.yaml")
    joints = (robot.joints[0], dataclasses.replace(robot.joints[1], coupling={}))
    model = dataclasses.replace(robot, joints=joints)
    text = model_text(model, ("made by a test",))
    assert text.startswith("# made by a test\nrobacc: 1\n")
    assert "units: {length: mm, angle: deg}" in text
    assert "identity: {customer: Example, serial_number: '1234'}" in text
    assert_same(parse_robot(text, "arm.yaml"), model)


# Validity ranges: stored with every effect, held at their ends, counted, and refused on request.

HELD = {"transmission_error", "axis_wobble", "joint_correction", "frame_drift", "joint_hardening", "joint_warmup"} | {
    "rail_errors",
    "compliance_variation",
    "counterbalance",
}
"""Effects that stop at the end of a narrow range; the others follow a physical law, or have no driver."""


def narrow(robot: Robot, n: int, seed: int = 0) -> Measurements:
    """Poses over a quarter of each driver's range, in its middle."""
    data = circumstances(robot, n, seed)
    middle = {name: getattr(data, name) for name in ("q", "time", "temperature", "payload", "speed")}
    shrunk = {name: np.median(values, axis=-1, keepdims=True) * 0.75 + 0.25 * values for name, values in middle.items()}
    return dataclasses.replace(data, **shrunk)


def entry(effect: Effect, robot: Robot, data: Measurements, size: float = 1e-4) -> dict[str, object]:
    one = Arm.of(robot)
    terms = effect.terms(one, data)
    return entry_of(effect, {term.name: size for term in terms}, effect.validity(one, data))


@pytest.mark.parametrize("name", tuple(REGISTRY))
def test_every_effect_keeps_its_range_and_stops_or_extrapolates_as_it_says(name: str) -> None:
    one = suited(name, arm("puma560"))
    inside, wide = narrow(one.robot, 40), circumstances(one.robot, 60, 2)
    cls = REGISTRY[name]
    effect = cls.default(one, inside, cls.possible_joints(one)[1:2] or cls.possible_joints(one) or None)
    robot = dataclasses.replace(one.robot, effects=(entry(effect, one.robot, inside),))
    robot = parse_robot(robot_to_yaml(robot), "model.yaml")
    known = known_effects(robot)[0]
    assert known.validity == effect.validity(one, inside)
    assert bool(known.validity) == bool(effect.validity_drivers(one))
    free = Model(one, (), (effect,))
    theta = np.full(len(effect.terms(one, inside)), 1e-4)
    # Inside, the range changes nothing, bit for bit.
    assert np.array_equal(predict(robot, inside).translation, free.bind(inside).poses(theta).translation)
    unlimited = free.bind(wide).poses(theta).translation
    limited = predict(robot, wide).translation
    outside = outside_validity(robot, wide)
    if known.validity:
        assert outside.n_poses > 30, "a quarter of the range leaves most poses outside"
        assert outside.warnings()[0].startswith(f"{outside.n_poses} of 60 poses are outside")
    else:
        assert outside is None
    if name in HELD:
        # A correction without a stored range stops at that of its polynomials.
        assert name == "joint_correction" or np.abs(limited - unlimited).max() > 1e-9
        assert outside.std_max > 0
        assert all(item["rule"] == "held" for item in outside.ranges)
    else:
        np.testing.assert_array_equal(limited, unlimited)
        assert outside is None or not any(item["rule"] == "held" for item in outside.ranges)
        assert cls.traits.extrapolates or cls.traits.is_constant or name == "thermal_expansion"


def test_a_held_effect_has_the_value_of_the_end_of_its_range() -> None:
    """A cubic drift fitted to half an hour has at two hours and a half the value of its end."""
    one = arm("puma560")
    effect = FrameDrift(origin=900.0, span=900.0, degree=3)
    values = {"frame_drift.x": 1e-4, "frame_drift.y2": 2e-4, "frame_drift.z3": -3e-4}
    robot = dataclasses.replace(one.robot, effects=(entry_of(effect, values, {"time_s": (0.0, 1800.0)}),))
    q = np.random.default_rng(0).uniform(-1, 1, (6, 3))
    data = Measurements(position=np.zeros((3, 3)), q=q, time=np.array([9000.0, 1800.0, -50.0]))
    moved = predict(robot, data).translation - one.chain.forward(q).translation
    np.testing.assert_allclose(moved[:, 0], [1e-4, 2e-4, -3e-4], atol=1e-15)
    np.testing.assert_allclose(moved[:, 1], [1e-4, 2e-4, -3e-4], atol=1e-15)
    np.testing.assert_allclose(moved[:, 2], [-1e-4, 2e-4, 3e-4], atol=1e-15)
    outside = outside_validity(robot, data)
    assert outside.n_poses == 2
    assert outside.ranges[0]["driver"] == "time_s"
    assert outside.ranges[0]["largest_excess"] == pytest.approx(7200.0)


def test_harmonics_over_a_common_period_repeat_and_narrower_ones_are_held() -> None:
    one = arm("puma560")
    for orders, reach, is_held in (((1.0, 2.0), 6.2, True), ((1.0, 2.0), 6.3, False), ((17.0,), 0.4, False)):
        assert TransmissionError(("j1",), orders).beyond(one, "j1", (0.0, reach)).is_held == is_held


def _harmonics() -> dict[str, object]:
    return {
        "effect": "transmission_error",
        "joints": ["j1"],
        "orders": [1, 17],
        "values": {"j1.cos1": 2e-4, "j1.sin17": 3e-4},
    }


def test_a_fit_of_a_listed_effect_widens_its_range() -> None:
    one = arm("puma560")
    effect = TransmissionError(("j1",), (1.0,))
    early = Known(effect, {"transmission_error.j1.cos1": 2e-4}, {"j1": (-0.2, 0.2)})
    data = narrow(one.robot, 80)
    position = one.chain.forward(data.q).translation
    fitted = fit(Model(one, (early,), (effect,)), dataclasses.replace(data, position=position))
    written = known_effects(apply_fit(fitted))[0]
    low, high = float(data.q[0].min()), float(data.q[0].max())
    assert written.validity["j1"] == (min(low, -0.2), max(high, 0.2))
    np.testing.assert_allclose(
        predict(apply_fit(fitted), data).translation, fitted.poses.translation, rtol=0, atol=1e-15
    )


@pytest.mark.parametrize(
    ("validity", "message"),
    [
        ({"j9": [0, 1]}, "validity.j9 is not a driver"),
        ({"j1": [1, 0]}, r"validity.j1 must be \[low, high\]"),
        ({"j1": 3}, r"validity.j1 must be \[low, high\]"),
        ([1, 2], "validity must be a mapping"),
    ],
)
def test_a_wrong_range_is_refused(validity: object, message: str) -> None:
    robot = dataclasses.replace(arm("puma560").robot, effects=({**_harmonics(), "validity": validity},))
    with pytest.raises(InputError, match=message):
        known_effects(robot)


def test_ranges_of_joints_are_in_the_files_angles() -> None:
    effect = {"effect": "gear_ratio", "joints": ["j1"], "values": {"j1": 1e-4}, "validity": {"j1": [-90, 45]}}
    robot = dataclasses.replace(arm("puma560").robot, effects=(effect,), effect_units=(1e-3, np.pi / 180))
    assert known_effects(robot)[0].validity["j1"] == pytest.approx((-np.pi / 2, np.pi / 4))


@pytest.mark.slow
def test_every_command_counts_poses_outside_and_refuses_them_on_request() -> None:
    one = arm("puma560")
    limited = {**_harmonics(), "validity": {"j1": [-0.5, 0.5]}}
    robot = dataclasses.replace(one.robot, effects=(limited,))
    data = robacc.simulate(robot, poses=40, seed=1, noise=2e-5, noise_orientation=1e-5).data
    count = int(np.count_nonzero(np.abs(data.q[0]) > 0.51))
    tolerant = dataclasses.replace(
        robot, joints=tuple(dataclasses.replace(joint, tolerance={"theta": 1e-4}) for joint in robot.joints)
    )
    calls = (
        lambda **more: robacc.estimate(data, robot=robot, **more),
        lambda **more: robacc.iso9283(data, robot=robot, **more),
        lambda **more: robacc.predict(tolerant, poses=data, **more),
        lambda **more: robacc.simulate(robot, poses=40, seed=1, **more),
        lambda **more: robacc.calibrate(data, robot=robot, fit="base_frame", folds=2, **more),
        lambda **more: robacc.trace(data, robot=robot, declared="base_frame,tool_frame", folds=2, **more),
    )
    for call in calls:
        result = call()
        outside = result.document()["outside_validity"]
        assert outside["n_poses"] == count, result.command
        assert outside["ranges"][0]["driver"] == "j1"
        assert any(f"{count} of 40 poses are outside the validity range" in text for text in result.warnings)
        with pytest.raises(InputError, match="outside the validity range"):
            call(strict_range=True)
    inside = robacc.estimate(data.subset(np.abs(data.q[0]) < 0.5), robot=robot, strict_range=True)
    assert inside.document()["outside_validity"]["n_poses"] == 0


@pytest.mark.parametrize("knee", [None, 20.0])
def test_hardening_is_held_well_beyond_the_torques_that_were_seen(knee: float | None) -> None:
    one = Arm.of(arm("puma560").robot)
    wide = circumstances(one.robot, 200, 2)
    torque = weight_torques(one, wide)[one.number("j2")]
    few = np.flatnonzero(np.abs(torque) < 0.2 * np.abs(torque).max())
    effect = JointHardening(("j2",), 50.0, knee)
    validity = effect.validity(one, wide.subset(few))
    low, high = torque[few].min(), torque[few].max()
    assert validity["torque_j2"] == pytest.approx((low, high))
    (free,), (held,) = effect.terms(one, wide), effect.within(validity).terms(one, wide)
    inside = np.abs(torque) <= 1.5 * max(-low, high)
    np.testing.assert_array_equal(held.parts[0].factor[inside], free.parts[0].factor[inside])
    share = 1.5 * max(-low, high) / (knee or 50.0)
    root = max(np.roots([1.0, 0.0, 1.0, -share]), key=lambda root: -abs(root.imag)).real
    largest = share**3 if knee is None else knee * (share - root)
    assert np.abs(held.parts[0].factor).max() == pytest.approx(largest)
    assert np.abs(free.parts[0].factor).max() > 8 * largest
    # A model file keeps the range of the torque, and what it predicts keeps to it.
    written = dataclasses.replace(one.robot, effects=(entry(effect, one.robot, wide.subset(few)),))
    known = parse_robot(robot_to_yaml(written), "model.yaml")
    bare = dataclasses.replace(one.robot, effects=())
    moved = predict(known, wide).translation - predict(bare, wide).translation
    assert np.linalg.norm(moved, axis=0).max() < 1.5 * 1e-4 * largest
