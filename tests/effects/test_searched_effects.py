"""Effects that a search finds, and refines, on an arm with matrices of its own; loads and steps that no file states."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import independent_arm
import numpy as np
import pytest
from commands import missing
from independent_arm import (
    DECLARED,
    DH,
    TOOL,
    Matrix,
    Run,
    link_frames,
    load_torques,
    measured,
    measured_on_a_rail,
    measured_with_loads,
    on_a_pedestal,
    robot,
    robot_on_a_rail,
    run,
    target,
    targets,
    torques,
)
from scipy.optimize import brentq
from searched import ARM, SearchEnd, error_at, fitted, found, model, searched, values_of

from robacc import InputError, Measurements, UsageError, read_poses, write_poses
from robacc.effects import REGISTRY
from robacc.effects.base import Effect
from robacc.effects.campaign import InstrumentScale, Step, TrackerError
from robacc.effects.elastic import BaseCompliance, JointCompliance, LateralCompliance, PayloadCompliance
from robacc.effects.frames import JointWarmup
from robacc.effects.periodic import (
    order_tolerance,
    origin_of,
)
from robacc.effects.specification import build, known_effects, parse_requests
from robacc.fitting.masses import UndeclaredLoad, undeclared_load
from robacc.geometry import rotation_about
from robacc.gravity import gravity_torques
from robacc.modelling.model import Model, predict
from robacc.robots.arm import Arm
from robacc.tracing.search import search
from robacc.tracing.trace import Trace, trace

# Wind-up, hardening, loaded backlash, a common delay and a pedestal, on an arm with matrices of its own.
NOISE = 1e-5
N = 80
POSES = run(N, seed=21)
TORQUES = torques(POSES.q)
TORQUE = TORQUES[1]


def positions(turn: np.ndarray) -> np.ndarray:
    """Targets with joint 2 turned by (N,) rad."""
    return POSES.turned(1, turn)


def test_torques_of_the_independent_arm_agree() -> None:
    np.testing.assert_allclose(gravity_torques(ARM, POSES.q), TORQUES, atol=1e-5)


@pytest.mark.parametrize("height", [0.0, 1.2])
def test_a_pedestal_tilts_about_a_point_below(height: float) -> None:
    compliance = 5e-7
    data = measured(POSES, on_a_pedestal(POSES.q, compliance, height), NOISE, 6)
    effects = found(data)
    values = values_of(fitted(data, effects))
    if height == 0.0:
        # A tilt about the base's origin and a first joint that bends are the same on an upright axis.
        assert str(effects[0]) in ("base_compliance", "lateral_compliance[j1]")
        assert (len(effects), effects[0].settings()) == (1, {})
        assert [values[name] for name in values if "compliance" in name] == [pytest.approx(compliance, rel=0.05)]
        return
    assert [effect.name for effect in effects] == ["base_compliance"]
    assert effects[0].settings() == {"below": True}
    assert values["base_compliance.tilt"] == pytest.approx(compliance, rel=0.05)
    assert values["base_compliance.shift"] / values["base_compliance.tilt"] == pytest.approx(height, rel=0.1)
    statement = effects[0].statement(ARM, values)
    assert "1.2 m below" in statement or "1.1 m below" in statement or "1.3 m below" in statement
    above = effects[0].statement(ARM, {"base_compliance.tilt": 2e-5, "base_compliance.shift": -4.4e-5})
    assert above == "the base tilts about a point 2.2 m above its origin"


# Effects whose setting a search refines, or that it tries beside another, on an arm with matrices of its own.
SOFT = 2.5e-6
LARGEST = float(np.abs(torques(run(200, seed=90).q)[1]).max())
KNEE = 0.5 * LARGEST
FRICTION = 0.05 * LARGEST
PLAY = 1.5e-4
ORDER = 62.0
BALANCED = 2e-6
"""Compliance of a joint with a counterbalance, rad/(N m)."""
STIFFNESS = 40000.0
FREE_LENGTH = 0.25
FIXED = 0.5 * np.array([np.cos(0.3), np.sin(0.3)])
"""Point of the link before the joint, in the plane of the joint, m."""
MOVING = np.array([0.2, 0.0])
"""Point of the joint's own link at the joint's zero, m."""


def hardened(torque: float) -> float:
    """Deflection of a spring k x (1 + (x / x_knee)^2), by a search for its root."""
    knee = KNEE * SOFT
    return float(brentq(lambda x: x / SOFT * (1.0 + (x / knee) ** 2) - torque, -1.0, 1.0, xtol=1e-15))


def spring_torque(angle: float) -> float:
    """Torque of the spring about joint 2: minus the slope of its energy."""

    def energy(at: float) -> float:
        turned = np.array([[np.cos(at), -np.sin(at)], [np.sin(at), np.cos(at)]]) @ MOVING
        return float(0.5 * STIFFNESS * (np.linalg.norm(turned - FIXED) - FREE_LENGTH) ** 2)

    return (energy(angle - 1e-5) - energy(angle + 1e-5)) / 2e-5


def erring(mechanism: str, n: int, seed: int, noise: float) -> Measurements:
    """Poses of an arm whose joint 2 errs by one mechanism."""
    joints = run(n, seed)
    torque = torques(joints.q)[1]
    approach = joints.direction[1]
    turn = {
        "hardening": lambda: np.array([hardened(value) for value in torque]),
        "harmonic": lambda: 2e-4 * np.cos(ORDER * joints.q[1] - 0.4),
        "loaded harmonic": lambda: 2e-4 * (1.0 + 0.6 * torque / LARGEST) * np.cos(ORDER * joints.q[1] - 0.4),
        "loaded play": lambda: PLAY * np.where(np.abs(torque) > FRICTION, np.sign(torque), approach),
        "spring": lambda: SOFT * torque,
        "balanced spring": lambda: BALANCED * torque,
        "counterbalance": lambda: BALANCED * (torque + [spring_torque(value) for value in joints.q[1]]),
        "eccentric": lambda: (
            BALANCED * torque + 3e-4 * np.cos(joints.q[1] - 0.6) + 1e-4 * np.cos(2 * joints.q[1] + 0.4)
        ),
    }[mechanism]()
    return measured(joints, joints.turned(1, turn), noise, seed, directed=True)


def search_end(mechanism: str, n: int, seed: int) -> SearchEnd:
    """The end of a search on poses of an arm with this mechanism."""
    return searched(erring(mechanism, n, seed, NOISE), erring(mechanism, 60, seed + 1, 0.0))


@pytest.mark.parametrize("share", [0.01, 0.3, 1.0, 5.0])
def test_the_spring_is_the_root_of_its_cubic(share: float) -> None:
    """The column plus the linear spring is the deflection found by bisection, at any torque over the knee."""
    data = run(20, 5)
    torque = torques(data.q)[1]
    scale = share * LARGEST / np.abs(torque).max()
    # A torque and a knee that are both larger have a column that is as much larger.
    effect = REGISTRY["joint_hardening"].from_settings(("j2",), {"knee_nm": KNEE / scale})
    (term,) = effect.terms(ARM, Measurements(np.zeros((3, 20)), q=data.q))
    expected = [hardened(value) for value in scale * torque]
    np.testing.assert_allclose(SOFT * scale * (term.parts[0].factor + torque), expected, rtol=1e-8, atol=1e-13)


def test_a_harmonic_that_grows_with_the_load_is_found() -> None:
    effects, values, error = search_end("loaded harmonic", 110, 73)
    assert sorted(map(str, effects)) == ["compliance_variation[j2]", "transmission_error[j2]"]
    orders = [effect.settings()["orders"][0] for effect in effects]
    assert orders == pytest.approx([ORDER, ORDER], abs=0.2)
    sizes = [np.hypot(*(value for name, value in values.items() if name.startswith(effect.name))) for effect in effects]
    assert sizes[1] * LARGEST / sizes[0] == pytest.approx(0.6, rel=0.25)
    assert error < 2e-5


def test_friction_that_keeps_the_flank_is_refined() -> None:
    """The friction lies between the torques of the last pose that stays and of the first that is pressed over."""
    effects, values, _ = search_end("loaded play", 200, 77)
    assert [(effect.name, effect.joints) for effect in effects] == [("backlash", ("j2",))]
    joints = run(200, 77)
    torque = torques(joints.q)[1]
    opposed = np.abs(torque[np.sign(torque) != joints.direction[1]])
    low, high = opposed[opposed < FRICTION].max(), opposed[opposed > FRICTION].min()
    assert low < effects[0].settings()["friction_nm"] < high
    assert "flank of its approach" in effects[0].statement(ARM, {})
    assert values["backlash.j2"] == pytest.approx(PLAY, rel=0.05)


# A spring between two points across joint 2.
def test_a_counterbalance_is_found_and_predicts_other_poses() -> None:
    effects, values, error = search_end("counterbalance", 90, 81)
    assert sorted(map(str, effects)) == ["counterbalance[j2]", "joint_compliance[j2]"]
    assert values["joint_compliance.j2"] == pytest.approx(BALANCED, rel=0.05)
    assert values["counterbalance.j2.spring"] * values["counterbalance.j2.length"] < 0
    assert error < 1e-5
    (effect,) = [effect for effect in effects if effect.name == "counterbalance"]
    # The spring is longest where the moving point is opposite the fixed one.
    turn = (effect.settings()["centre_deg"] - np.degrees(0.3 + np.pi) + 180.0) % 360.0 - 180.0
    assert abs(turn) < 10.0
    assert "spring or cylinder across j2" in effect.statement(ARM, values)


@pytest.mark.parametrize("seed", [83, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(300, 320))])
def test_an_eccentric_gear_is_no_counterbalance(seed: int) -> None:
    effects, _, _ = search_end("eccentric", 100, seed)
    assert sorted({effect.name for effect in effects}) == ["joint_compliance", "transmission_error"]


@pytest.mark.parametrize("phase", [0.8, 3.2])
def test_what_cannot_be_is_no_alternative(phase: float) -> None:
    """With these second orders, a counterbalance of negative free length fits nearly as well: of an IRB 120, better."""
    joints = run(100, 83)
    turn = 3e-4 * np.cos(joints.q[1] - 0.6) + 5e-5 * np.cos(2.0 * joints.q[1] + phase)
    data = measured(joints, joints.turned(1, BALANCED * torques(joints.q)[1] + turn), NOISE, 83, directed=True)
    result = search(model(data), data)
    for found_effect, rival in ((one.effect, rival) for one in result.identified for rival in one.alternatives):
        effect = REGISTRY[rival.effect].from_settings(rival.joints, rival.settings)
        refitted = fitted(data, [*(one for one in result.effects if one is not found_effect), effect])
        own = [number for number, owner in enumerate(refitted.owners) if refitted.model.free[owner] == effect]
        values = [float(refitted.theta[number]) for number in own]
        assert effect.implausible([refitted.terms[number] for number in own], values) is None


def test_the_columns_are_the_torque_of_the_spring() -> None:
    """With the place of the simulated spring, both coefficients follow from stiffness and radii."""
    a, b = float(np.linalg.norm(FIXED)), float(np.linalg.norm(MOVING))
    reach = a**2 + b**2
    effect = REGISTRY["counterbalance"].from_settings(
        ("j2",), {"centre_deg": float(np.degrees(0.3 + np.pi)), "ratio": 2 * a * b / reach}
    )
    data = run(30, 9)
    measurements = measured(data, targets(data.q), 0.0, 9)
    spring, length = (term.parts[0].factor for term in effect.terms(ARM, measurements))
    # Length^2 = reach + 2 a b cos(q - q_0); torque = stiffness (length - free) / length a b sin(q - q_0).
    expected = [spring_torque(value) for value in data.q[1]]
    size = STIFFNESS * a * b
    np.testing.assert_allclose(size * (spring - FREE_LENGTH / np.sqrt(reach) * length), expected, rtol=1e-6, atol=1e-5)


# Orders far above 40 are found, named by the gear, and their aliases listed; on an arm with matrices of its own.
def test_a_high_order_is_found_and_named_beside_a_sag() -> None:
    """Such errors of five joints of an IRB 120 were sought only where nothing else was found."""
    order, poses = 242.0, run(110, seed=12)
    turn = SOFT * torques(poses.q)[1] + 2e-4 * np.cos(order * poses.q[1] - 0.7)
    data = measured(poses, poses.turned(1, turn), 2e-5, 12)
    result = trace(model(data), data, n_folds=3)
    assert [finding.effect for finding in result.findings] == ["joint_compliance", "transmission_error"]
    assert result.findings[1].joints == ("j2",)
    (harmonic,) = result.findings[1].harmonics
    assert harmonic.order == pytest.approx(order, abs=0.1)
    assert harmonic.amplitude == pytest.approx(2e-4, rel=0.15)
    assert "typical gear of ratio 121" in harmonic.origin
    assert result.findings[1].statement is not None


def test_orders_of_a_stated_gear_are_candidates_where_poses_show_them() -> None:
    """On a grid of angles, an order above its limit is a low order under another name."""
    geared = dataclasses.replace(robot().joints[1], gear_ratio=200.0)
    joints = [robot().joints[0], geared, *robot().joints[2:]]
    arm = Arm.of(dataclasses.replace(robot(), joints=tuple(joints)))
    random = measured(POSES, positions(0.0 * TORQUE), NOISE, 6)
    on_grid = dataclasses.replace(random, q=np.round(POSES.q / 0.05) * 0.05)
    found_orders = [
        {order for form in REGISTRY["transmission_error"].candidates(arm, data) for order in form.settings()["orders"]}
        for data in (random, on_grid)
    ]
    assert found_orders == [{1.0, 2.0, 200.0, 400.0}, {1.0, 2.0}]


def test_origins() -> None:
    tolerance = order_tolerance(5.0)
    assert tolerance == pytest.approx(0.126, abs=1e-3)
    assert "once per joint turn" in str(origin_of(1.0, None, tolerance))
    assert "once per motor turn" in str(origin_of(99.97, 100.0, tolerance))
    assert "twice per motor turn" in str(origin_of(-2 * -50.1, 50.0, tolerance))
    assert origin_of(81.0, 100.0, tolerance) is None
    # Once per turn of one motor is twice per turn of another.
    assert all(f"gear of ratio {ratio}" in str(origin_of(100.0, None, tolerance)) for ratio in (50, 100))
    assert origin_of(64.3, None, tolerance) is None
    # Poses over a quarter turn leave an order uncertain by 0.3.
    short = order_tolerance(1.7)
    assert short == pytest.approx(0.37, abs=0.01)
    assert "a typical gear of ratio 100" in str(origin_of(200.33, None, short))
    assert origin_of(200.33, None, tolerance) is None
    assert origin_of(200.5, None, 2.0) is None


# Tracker at an unknown place, decentred reflector, drifting air and joints that warm up, on an independent arm.
TRACKED = 90
TIMED = run(TRACKED, seed=31)
TRACKER = np.array([2.6, -1.9, 1.1])
ELAPSED = TIMED.time - TIMED.time[0]


def true_positions(poses: Run = TIMED) -> np.ndarray:
    """Targets (3, N) of the arm without errors."""
    return targets(poses.q)


def decentred(along: float, across: float, beyond: float) -> np.ndarray:
    """Targets whose optical centre is off in the frame of the beam, rolled by the tool's x."""
    sight, tool_x = true_positions() - TRACKER[:, None], link_frames(TIMED.q)[-1][:, :3, 0].T
    beam = sight / np.linalg.norm(sight, axis=0)
    side = tool_x - beam * np.sum(beam * tool_x, axis=0)
    side /= np.linalg.norm(side, axis=0)
    return true_positions() + along * beam + across * side + beyond * np.cross(beam, side, axis=0)


def eccentric(cosine: float, sine: float) -> np.ndarray:
    """Targets as an instrument sees them whose horizontal circle is off its axis: polar coordinates, changed."""
    x, y, z = true_positions() - TRACKER[:, None]
    azimuth, flat = np.arctan2(y, x), np.hypot(x, y)
    azimuth = azimuth + cosine * np.cos(azimuth) + sine * np.sin(azimuth)
    return np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), z]) + TRACKER[:, None]


def longer(offset: float) -> np.ndarray:
    """Targets as an instrument sees them whose ranges are too long."""
    beam = true_positions() - TRACKER[:, None]
    return TRACKER[:, None] + beam * (1 + offset / np.linalg.norm(beam, axis=0))


def through_air(ppm: float) -> np.ndarray:
    """Targets seen through air whose index swings once over the poses."""
    scale = 1e-6 * ppm * np.sin(2 * np.pi * ELAPSED / ELAPSED[-1])
    return TRACKER[:, None] + (true_positions() - TRACKER[:, None]) * (1 + scale)


def warm(joint: int, size: float, time_constant: float) -> np.ndarray:
    """Targets of an arm whose joint warms up."""
    return TIMED.turned(joint, size * (1 - np.exp(-ELAPSED / time_constant)))


def test_an_eccentric_horizontal_circle_is_found_and_is_no_gear_of_joint_1() -> None:
    data = measured(TIMED, eccentric(2e-4, 1e-4), NOISE, 2)
    (effect,) = found(data)
    assert isinstance(effect, TrackerError)
    assert effect.kind == "horizontal"
    assert fitted(data, [effect]).misfit[0] < 1.15 * NOISE


def test_a_range_offset_moves_targets_along_the_line_of_sight() -> None:
    """The shift is that of independent polar coordinates, and a fit at the true place returns it."""
    data = measured(TIMED, longer(3e-4), NOISE, 3)
    place = (float(TRACKER[0]), float(TRACKER[1]), float(TRACKER[2]))
    result = fitted(data, [TrackerError(place=place)])
    i = result.names.index("tracker_error.offset")
    assert abs(result.theta[i] - 3e-4) < 4 * np.sqrt(result.covariance[i, i])


def test_air_that_drifts_is_one_effect_about_the_instrument() -> None:
    data = measured(TIMED, through_air(40.0), NOISE, 4, timed=True)
    (effect,) = found(data)
    assert isinstance(effect, InstrumentScale)
    assert effect.drift in (3, 5)
    result = fitted(data, [effect])
    assert result.misfit[0] < 1.3 * NOISE
    statement = effect.statement(ARM, values_of(result))
    place = [float(text) for text in statement.split("about the point ")[1].split(" m:")[0].split(",")]
    np.testing.assert_allclose(place, TRACKER, atol=0.5)


def test_a_frame_that_wanders_is_no_drift_of_the_scale() -> None:
    """Shifts that no scale about one point explains: a drift of the scale of degree 5 follows them best of all."""
    moved = true_positions() + np.array([[1e-4], [-2e-4], [1.5e-4]]) * np.exp(-ELAPSED / ELAPSED[8])
    effects = found(measured(TIMED, moved, NOISE, 8, timed=True))
    assert "instrument_scale" not in {effect.name for effect in effects}


def test_a_joint_that_warms_up_is_found_with_its_time_constant() -> None:
    data = measured(TIMED, warm(1, 3e-4, 500.0), NOISE, 5, timed=True)
    (effect,) = found(data)
    assert isinstance(effect, JointWarmup)
    assert f"{effect.time_constant / 60:.3g} min" in effect.statement(ARM, {})
    assert effect.joints == ("j2",)
    assert 250 < effect.time_constant < 1000
    assert values_of(fitted(data, [effect]))["joint_warmup.j2"] == pytest.approx(3e-4, rel=0.25)


def test_a_warm_up_does_not_depend_on_the_clocks_zero() -> None:
    data = measured(TIMED, warm(2, 3e-4, 400.0), NOISE, 6, timed=True)
    later = dataclasses.replace(data, time=data.time + 1e9)
    first, second = (fitted(at, [JointWarmup.default(ARM, at, ("j3",))]) for at in (data, later))
    np.testing.assert_allclose(second.theta, first.theta, rtol=0, atol=1e-9)


# An arm on a rail that is bent and twisted: kinematics are those of the independent arm, carried by hand.
ON_A_RAIL = Arm.of(robot_on_a_rail())


# A pedestal that tilts, on an arm whose masses nobody knows: torques are those of independent matrices.
COMPLIANCE = 6e-7


def arm_without_masses() -> Arm:
    described = robot()
    joints = tuple(dataclasses.replace(joint, mass=None, com=None) for joint in described.joints)
    return Arm.of(dataclasses.replace(described, joints=joints))


def on_a_tilting_pedestal(n: int, seed: int, noise: float) -> Measurements:
    joints = run(n, seed)
    return measured(joints, on_a_pedestal(joints.q, COMPLIANCE), noise, seed)


def error_at_other_poses(effects: str) -> float:
    """RMS error (m) of a fit at poses that it has not seen and that have no noise."""
    return error_at(
        fitted(on_a_tilting_pedestal(100, 41, NOISE), (), arm_without_masses(), DECLARED + effects),
        on_a_tilting_pedestal(60, 42, 0.0),
    )


def test_a_pedestals_tilt_is_fitted_without_masses() -> None:
    assert error_at_other_poses("") > 8e-5
    assert error_at_other_poses(",base_compliance") < 2.5e-5


def test_unknown_masses_reproduce_known_ones() -> None:
    """The regressors times the masses are the moments of the known weight: both forms predict the same poses."""
    arm, data = Arm.of(robot()), on_a_tilting_pedestal(20, 43, 0.0)
    for cls, joints in ((BaseCompliance, ()), (LateralCompliance, ("j2",))):
        prefix = ".".join((cls.name, *joints))
        values = {}
        for i, (*_, mass, com) in enumerate(DH, 1):
            weights = {f"m{i}": mass, **{f"h{axis}{i}": mass * com[k] for k, axis in enumerate("xyz")}}
            values |= {label: COMPLIANCE * weight for label, weight in weights.items()}
        unknown = cls(joints=joints, masses="unknown")
        names = {term.name.removeprefix(f"{prefix}.") for term in unknown.terms(arm, data)}
        short = f"{joints[0]}." if joints else ""
        entries = (
            {"effect": cls.name, "joints": list(joints), "values": {joints[0] if joints else "value": COMPLIANCE}},
            {
                "effect": cls.name,
                "joints": list(joints),
                "masses": "unknown",
                "values": {f"{short}{label}": value for label, value in values.items() if label in names},
            },
        )
        first, second = (predict(dataclasses.replace(robot(), effects=(entry,)), data).translation for entry in entries)
        assert np.abs(first - target(data.q[:, 0])[:, None]).max() > 1e-5
        np.testing.assert_allclose(first, second, rtol=0, atol=1e-10)


# Payloads whose centre of mass the robot file does not state.
FAR = np.array([0.3, -0.2, 0.45])
"""Centre of mass in the last link's frame, m; the file has none, which means the tool's place."""


def with_centre(n: int, seed: int, noise: float, com: Matrix) -> Measurements:
    """Poses of an arm whose joint 2 gives way to payloads of 0, 20 and 60 kg."""
    mass = np.random.default_rng(seed).choice([0.0, 20.0, 60.0], n)
    return dataclasses.replace(measured_with_loads(n, seed, noise, COMPLIANCE, mass, com), payload=mass)


def test_first_moments_times_the_centre_are_the_payload() -> None:
    """Both forms predict the same poses where the coefficients are those of the centre."""
    data = with_centre(20, 63, 0.0, FAR)
    moved = Arm.of(dataclasses.replace(robot(), payload_com=tuple(FAR.tolist())))
    known = Model(moved, free=(PayloadCompliance(("j2",)),)).bind(data).poses(np.array([COMPLIANCE]))
    uncertain = Model(ARM, free=(PayloadCompliance(("j2",), "uncertain"),)).bind(data)
    poses = uncertain.poses(COMPLIANCE * np.array([1.0, *(FAR - TOOL)]))
    np.testing.assert_allclose(poses.translation, known.translation, atol=1e-12)


# Loads of unknown mass that a column names.
LOADS = {"none": 0.0, "gripper": 20.0, "part": 60.0}
"""Masses at the tool, kg."""


def with_named_loads(n: int, seed: int, noise: float) -> Measurements:
    """Poses of an arm whose joint 2 gives way to loads that only have names."""
    names = np.random.default_rng(seed).choice(list(LOADS), n)
    mass = np.array([LOADS[name] for name in names])
    return dataclasses.replace(measured_with_loads(n, seed, noise, COMPLIANCE, mass), payload_group=names)


def test_named_loads_are_found_with_their_ratios_and_predict_other_poses(tmp_path: Path) -> None:
    write_poses(tmp_path / "poses.csv", with_named_loads(80, 61, NOISE))
    data = read_poses(tmp_path / "poses.csv", robot=robot())
    (effect,) = found(data)
    assert effect == PayloadCompliance(("j2",), groups=("gripper", "part"))
    result = fitted(data, (effect,))
    values = values_of(result)
    # 80 poses of 10 um show a product of 6e-7 rad/(N m) and 60 kg to about 1 %.
    assert values["payload_compliance.j2.part"] == pytest.approx(60 * COMPLIANCE, rel=0.05)
    assert values["payload_compliance.j2.gripper"] == pytest.approx(20 * COMPLIANCE, rel=0.15)
    assert "part 1.00" in effect.statement(ARM, values)
    # Some thirty coefficients of 240 coordinates leave 0.6 of the noise of three coordinates.
    assert error_at(result, with_named_loads(60, 62, 0.0)) < 1.2e-5


def test_a_load_of_another_name_and_a_single_name_are_refused() -> None:
    data = with_named_loads(40, 63, NOISE)
    effect = PayloadCompliance(("j2",), groups=("gripper",))
    with pytest.raises(UsageError, match="a row carries 'part'"):
        effect.terms(ARM, data)
    alone = dataclasses.replace(data, payload_group=np.full(data.n, "part"))
    assert PayloadCompliance.missing(ARM, alone) == PayloadCompliance.traits.needs[2].reason
    again = PayloadCompliance.from_settings(("j2",), {"com": "uncertain", "groups": ["gripper"]})
    assert again == PayloadCompliance(("j2",), "uncertain", ("gripper",))


# A load at the flange that changes between two poses and that nobody logged.
N_OF_LOADS_AND_STEPS = 90
AT = 50
"""Number of the first pose with the load, from 0: line 52 of the file."""
OF_BOTH = np.array([0.0, 8e-7, 1.2e-6, 0.0, 0.0, 0.0])


def with_a_change(seed: int, mass: float, noise: float = 2e-5) -> Measurements:
    """Poses of an arm whose joints 2 and 3 give way to its weight and, from pose AT on, to a load at the tool."""
    poses = run(N_OF_LOADS_AND_STEPS, seed)
    torque = load_torques(poses.q, mass * (np.arange(N_OF_LOADS_AND_STEPS) >= AT))
    return measured(poses, targets(poses.q + OF_BOTH[:, None] * torque), noise, seed)


def test_its_column_is_the_difference_of_two_torques() -> None:
    """At a small deflection, the fitted coefficient times the torque of 1 kg is the deflection by the load."""
    effect = REGISTRY["step"].from_settings(("j2", "j3"), {"part": "payload", "from_line": AT + 2})
    values = values_of(fitted(with_a_change(5, 25.0, noise=0.0), (effect,), declared="joint_compliance[j2,j3]"))
    assert [values["step.j2"], values["step.j3"]] == pytest.approx(25.0 * OF_BOTH[1:3], rel=2e-3)


# A constant load at a link that the robot file does not state.
OF_TWO = np.array([0.0, 6e-7, 8e-7, 0.0, 0.0, 0.0])


def with_undeclared_load(n: int, seed: int, noise: float, link: int, mass: float, com: Matrix) -> Measurements:
    """Poses of an arm whose joints 2 and 3 give way to its own weight and to a mass at link ``link``, from 0."""
    poses = run(n, seed)
    torque = load_torques(poses.q, mass, com, link)
    return measured(poses, targets(poses.q + OF_TWO[:, None] * torque), noise, seed)


def arm_that_states(link: int, mass: float, com: Matrix) -> Arm:
    """The arm of a file that has the load in its link."""
    joints = list(robot().joints)
    joint = joints[link]
    own, total = np.array(joint.com), float(joint.mass or 0.0) + mass
    together = tuple(((joint.mass or 0.0) * own + mass * com) / total)
    joints[link] = dataclasses.replace(joint, mass=total, com=together)
    return Arm.of(dataclasses.replace(robot(), joints=tuple(joints)))


@pytest.mark.parametrize(
    ("link", "mass", "com"),
    [
        pytest.param(2, 12.0, (0.05, 0.1, 0.1), id="valve block on the upper arm", marks=pytest.mark.slow),
        pytest.param(5, 15.0, (0.1, 0.05, 0.2), id="tool"),
    ],
)
def test_an_undeclared_load_is_named_and_the_fit_reaches_the_floor(link: int, mass: float, com: tuple) -> None:
    place = np.array(com)
    data, fresh = (
        with_undeclared_load(80, 1, NOISE, link, mass, place),
        with_undeclared_load(60, 2, 0.0, link, mass, place),
    )
    effects = found(data)
    assert {str(effect) for effect in effects} == {"joint_compliance[j2]", "joint_compliance[j3]"}
    uncertain = [effect for effect in effects if effect.settings() == {"masses": "uncertain"}]
    assert "a link carries a load that the file does not state" in uncertain[0].statement(ARM, {})
    springs = build(parse_requests("joint_compliance[j2],joint_compliance[j3]"), ARM, data)
    floor = error_at(fitted(data, springs, arm_that_states(link, mass, place)), fresh)
    # The noise is three times the floor. At 80 poses the evidence is for uncertain masses in one spring alone, which
    # is 1.7 times the floor; uncertain masses in both are 1.4 times.
    assert error_at(fitted(data, effects), fresh) < 1.8 * floor
    assert error_at(fitted(data, springs), fresh) > 1.4 * floor


def judged(data: Measurements, arm: Arm = ARM) -> UndeclaredLoad:
    """What the springs of joints 2 and 3 point to, with uncertain masses."""
    return undeclared_load(fitted(data, (JointCompliance(("j2", "j3"), "uncertain"),), arm), data)


def test_a_tool_that_is_not_declared_is_named_with_its_mass() -> None:
    load = judged(with_undeclared_load(80, 1, NOISE, 5, 15.0, np.array([0.1, 0.05, 0.2])))
    assert load.is_named
    assert [place.link for place in load.places] == ["j6"]
    assert load.places[0].low < 15.0 < load.places[0].high
    # The poses determine compliance times first moment: the mass is known to a factor of two or three.
    assert 7.0 < load.places[0].mass < 30.0
    assert "kg more on the link of j6 (95 %:" in load.statement


def test_a_link_that_can_hardly_be_lighter_is_tried_with_more_alone() -> None:
    light = arm_that_states(5, -2.9, np.array(DH[5][5]))
    load = judged(with_undeclared_load(80, 1, NOISE, 5, 15.0, np.array([0.1, 0.05, 0.2])), light)
    assert load.is_named
    assert load.places[0].link == "j6"


@pytest.mark.parametrize("error", [None, 0.02], ids=["10 percent", "2 percent"])
def test_a_load_within_the_errors_of_the_masses_is_named_only_if_these_are_known(error: float | None) -> None:
    arm = Arm.of(dataclasses.replace(robot(), mass_uncertainty=error))
    load = judged(with_undeclared_load(80, 1, NOISE, 2, 20.0, np.array([0.05, 0.1, 0.1])), arm)
    # The link of j3 has 30 kg in the file.
    assert load.is_named == (error is not None)
    assert load.places[0].link == "j3"
    assert load.places[0].low < 20.0 < load.places[0].high


@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(1, 40))])
def test_no_load_is_named_where_the_masses_of_the_file_are_wrong(seed: int, monkeypatch: pytest.MonkeyPatch) -> None:
    factors = np.clip(1.0 + 0.2 * np.random.default_rng(seed).normal(size=6), 0.2, None)
    wrong = tuple((*row[:4], row[4] * factor, row[5]) for row, factor in zip(DH, factors, strict=True))
    monkeypatch.setattr(independent_arm, "DH", wrong)
    load = judged(with_undeclared_load(80, seed, NOISE, 0, 0.0, np.zeros(3)))
    assert not load.is_named
    assert "is not distinguishable from errors" in load.statement


# Step changes on an arm with kinematics of its own: part, place and size are found, and clean arms have none.
STEP_NOISE = 2e-5
STEPPED = 55
"""Number of the first pose after the step, from 0: line 57 of the file."""


def positions_of_loads_and_steps(poses: Run, part: str, size: float) -> np.ndarray:
    """Targets of a run whose base, target or third joint steps at pose STEPPED."""
    tool = TOOL + (part == "target") * size * np.array([0.6, -0.6, 0.53])
    zero = (part == "joint") * size * np.eye(6)[2]
    after = target(poses.q + zero[:, None], tool)
    if part == "base":
        after = after @ rotation_about(2, size).T + size * np.array([0.0, 0.8, -0.6])
    return np.where(np.arange(poses.q.shape[1]) >= STEPPED, after.T, targets(poses.q))


def traced(data: Measurements) -> Trace:
    return trace(model(data), data, n_folds=2)


@pytest.mark.parametrize(("part", "timed"), [("target", False), ("base", True), ("joint", False)])
def test_part_place_and_size_are_found(part: str, timed: bool) -> None:
    poses = run(N_OF_LOADS_AND_STEPS, seed=4)
    result = traced(measured(poses, positions_of_loads_and_steps(poses, part, 2e-4), STEP_NOISE, 4, timed=timed))
    (finding,) = result.findings
    assert finding.effect == "step"
    assert finding.settings.get("part", "joint") == part
    assert finding.joints == (("j3",) if part == "joint" else ())
    place, low, high = finding.change
    assert low <= place <= high
    # A single pose shows steps of ten times the noise; the place may be off by a pose or two of small displacement.
    expected = float(poses.time[STEPPED - 1 : STEPPED + 1].mean()) if timed else STEPPED + 2
    assert abs(place - expected) <= (70.0 if timed else 2)
    assert low <= expected <= high
    sizes = np.array([p.value for p in finding.parameters if p.unit == "m" or part == "joint"])
    assert np.linalg.norm(sizes) == pytest.approx(2e-4, rel=0.2)
    assert "line 5" in finding.statement
    assert ("jumps" if part == "joint" else "displaced") in finding.statement


def test_errors_that_wander_are_no_steps() -> None:
    """A tracker's mounting that creeps: correlated over some 30 poses, one and a half times the noise."""
    poses, memory = run(N_OF_LOADS_AND_STEPS, 41), 0.97
    wander = np.random.default_rng(41).normal(size=(3, N_OF_LOADS_AND_STEPS))
    for i in range(1, N_OF_LOADS_AND_STEPS):
        wander[:, i] = memory * wander[:, i - 1] + np.sqrt(1 - memory**2) * wander[:, i]
    data = measured(poses, targets(poses.q) + 1.5 * STEP_NOISE * wander, STEP_NOISE, 41)
    assert "step" not in [finding.effect for finding in traced(data).findings]


def test_a_knocked_tracker_is_found_with_three_targets_a_visit() -> None:
    places_of_targets = {"N1": TOOL, "N2": TOOL + np.array([0.2, 0.1, 0.0]), "N3": TOOL + np.array([-0.1, 0.2, 0.05])}
    visits, first = 60, 35
    poses = run(visits, seed=12)
    rng = np.random.default_rng(12)
    position = np.stack([target(poses.q, at) for at in places_of_targets.values()], axis=1).reshape(-1, 3).T
    visit = np.repeat(np.arange(visits), 3)
    position += (visit >= first) * np.array([[2e-4], [0.0], [-1e-4]]) + rng.normal(
        scale=STEP_NOISE, size=position.shape
    )
    data = Measurements(
        position=position,
        q=poses.q[:, visit],
        target=np.tile(np.array(list(places_of_targets)), visits),
        visit=visit.astype(str),
        rows=np.arange(2, 3 * visits + 2),
        source="poses.csv",
    )
    (finding,) = trace(model(data, Arm.of(robot(places_of_targets))), data, n_folds=2).findings
    assert (finding.effect, finding.settings["part"]) == ("step", "base")
    assert finding.settings["from_line"] == 3 * first + 2


def test_poses_of_another_file_come_after_the_step() -> None:
    step = Step((), "target", from_line=40, file="poses.csv")
    data = measured(run(60, 1), np.zeros((3, 60)), STEP_NOISE, 1)
    np.testing.assert_array_equal(step.after(data), np.arange(2, 62) >= 40)
    assert step.after(dataclasses.replace(data, source="folder/other.csv")).all()
    assert step.after(dataclasses.replace(data, rows=None)).all()
    timed = Step(("j2",), "joint", from_time=100.0)
    assert timed.after(data).all()
    late = dataclasses.replace(data, time=np.linspace(0, 199, 60))
    np.testing.assert_array_equal(timed.after(late), late.time >= 100.0)


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ({"effect": "step", "values": {"x": 1e-4}}, "expected from_line or from_time_s"),
        ({"effect": "step", "part": "floor", "from_line": 3, "values": {"x": 1e-4}}, "part must be base or target"),
        ({"effect": "step", "joints": ["j2"], "part": "base", "from_line": 3, "values": {"j2": 1e-4}}, "expected part"),
        ({"effect": "step", "from_line": 2.5, "values": {"x": 1e-4}}, "whole number"),
        ({"effect": "step", "part": "payload", "from_line": 52, "values": {"x": 1e-4}}, "payload with joints"),
        ({"effect": "step", "from_line": 2, "target": "a", "values": {"x": 1e-4}}, "target belongs to"),
    ],
)
def test_wrong_entries_are_refused(entry: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        known_effects(dataclasses.replace(robot(), effects=(entry,)))


# What a search finds, and that the fit of it gives back its size and other poses.


class Case(NamedTuple):
    """Poses of an arm with something wrong, and what a search and a fit of what it finds say."""

    data: Callable[[], Measurements]
    effects: Sequence[str]
    values: Mapping[str, tuple[float, float]] = {}
    """Coefficients: value and relative tolerance."""
    settings: Mapping[str, object] = {}
    said: tuple[str, ...] = ()
    """Parts of the statements."""
    fresh: Callable[[], Measurements] | None = None
    """Poses without noise, which the fit has not seen."""
    error: tuple[float, float] = (0.0, 0.0)
    """RMS error there with what is found, at most, and with ``without`` in its place, at least; m."""
    without: tuple[Effect, ...] = ()
    arm: Arm = ARM


def delayed() -> Measurements:
    """Poses read 12 ms late, at speeds of up to 0.02 rad/s that rise to the largest of a move: one number for all."""
    speed = np.random.default_rng(5).uniform(-1, 1, (6, N))
    return dataclasses.replace(measured(POSES, targets(POSES.q - 2e-4 * speed), NOISE, 5), speed=speed)


FOUND = {
    "friction that grows with the load, and no play": Case(
        lambda: measured(
            POSES, positions(8e-7 * TORQUE - 2.5e-7 * np.abs(TORQUE) * POSES.direction[1]), NOISE, 1, directed=True
        ),
        ("friction_windup[j2]", "joint_compliance[j2]"),
        {"friction_windup.j2": (-2.5e-7, 0.1), "joint_compliance.j2": (8e-7, 0.05)},
    ),
    "a compliance that differs with the angle": Case(
        lambda: measured(POSES, positions(8e-7 * TORQUE * (1.0 + 0.3 * np.cos(2 * POSES.q[1] - 0.7))), NOISE, 8),
        ("compliance_variation[j2]", "joint_compliance[j2]"),
        {
            "joint_compliance.j2": (8e-7, 0.05),
            "compliance_variation.j2.cos2": (2.4e-7 * np.cos(0.7), 0.2),
            "compliance_variation.j2.sin2": (2.4e-7 * np.sin(0.7), 0.2),
        },
    ),
    "backlash whose flank gravity decides, although the approach is known": Case(
        lambda: measured(POSES, positions(1.5e-4 * np.sign(TORQUE)), NOISE, 3, directed=True),
        ("backlash[j2]",),
        {"backlash.j2": (1.5e-4, 0.05)},
        {"by": "gravity"},
    ),
    "one delay of all joints": Case(delayed, ("approach_lag[common]",), {"approach_lag.common": (-2e-4, 0.05)}),
    # The cube of the torque alone leaves more than noise, which a correction would describe.
    "the knee of a hardening spring": Case(
        lambda: erring("hardening", 90, 71, NOISE),
        ("joint_compliance[j2]", "joint_hardening[j2]"),
        {"joint_compliance.j2": (SOFT, 0.05), "joint_hardening.j2": (SOFT, 0.15)},
        {"knee_nm": pytest.approx(KNEE, rel=0.15)},
        ("twice as stiff at",),
        lambda: erring("hardening", 60, 72, 0.0),
        (1e-5, 0.0),
    ),
    "a harmonic without load": Case(lambda: erring("harmonic", 150, 75, NOISE), ("transmission_error[j2]",)),
    "a decentred reflector, with the instrument's place": Case(
        lambda: measured(TIMED, decentred(0.0, 1.2e-4, -6e-5), NOISE, 1),
        ("target_decentre",),
        {"target_decentre.across": (1.2e-4, 0.1), "target_decentre.beyond": (-6e-5, 0.15)},
        {"axis": "x", "instrument": pytest.approx(TRACKER.tolist(), abs=0.4)},
        ("turn it in its nest",),
    ),
    # A drift of the scale about a point far away is one of the base: the simpler name stays.
    "a base that drifts": Case(
        lambda: measured(
            TIMED,
            true_positions() + np.array([[-2e-4], [3e-4], [1e-4]]) * (ELAPSED / ELAPSED[-1] - 0.5),
            NOISE,
            6,
            timed=True,
        ),
        ("frame_drift",),
    ),
    "curves of a rail": Case(
        lambda: measured_on_a_rail(110, 51, 1e-5, 1.0),
        ("rail_errors[rail]",),
        fresh=lambda: measured_on_a_rail(60, 52, 0.0, 1.0),
        error=(2e-5, 5e-5),
        arm=ON_A_RAIL,
    ),
    "a straight rail": Case(lambda: measured_on_a_rail(90, 53, 1e-5, 0.0), (), arm=ON_A_RAIL),
    "a pedestal without masses": Case(
        lambda: on_a_tilting_pedestal(100, 41, NOISE),
        ("base_compliance",),
        settings={"masses": "unknown"},
        arm=arm_without_masses(),
    ),
    "another centre of the payload": Case(
        lambda: with_centre(80, 61, NOISE, FAR),
        ("payload_compliance[j2]",),
        settings={"com": "uncertain"},
        fresh=lambda: with_centre(60, 62, 0.0, FAR),
        error=(1.2e-5, 2.4e-5),
        without=(PayloadCompliance(("j2",)),),
    ),
    "a load that nobody logged, with its line and size": Case(
        lambda: with_a_change(4, 25.0),
        ("joint_compliance[j2]", "joint_compliance[j3]", "step[payload]"),
        {f"step.{joint}": (25.0 * size, 0.3) for joint, size in zip(("j2", "j3"), OF_BOTH[1:3], strict=True)},
        {"part": "payload", "from_line": pytest.approx(AT + 2, abs=3), "file": "poses.csv"},
        ("carries another load", "payload_kg"),
    ),
}
SLOW = ("a harmonic without load", "a pedestal without masses")


@pytest.mark.parametrize(
    "case", [pytest.param(case, id=name, marks=[pytest.mark.slow] * (name in SLOW)) for name, case in FOUND.items()]
)
def test_a_search_finds_what_is_wrong(case: Case) -> None:
    data = case.data()
    effects = found(data, case.arm)
    assert sorted(map(str, effects)) == list(case.effects)
    result = fitted(data, effects, case.arm)
    values = values_of(result)
    sizes = {name: pytest.approx(size, rel=rel) for name, (size, rel) in case.values.items()}
    assert {name: values[name] for name in sizes} == sizes
    if case.settings:
        assert {name: value for effect in effects for name, value in effect.settings().items()} == case.settings
    statements = " ".join(str(effect.statement(case.arm, values)) for effect in effects)
    assert missing(statements, *case.said) == []
    if case.fresh:
        fresh = case.fresh()
        assert error_at(result, fresh) < case.error[0]
        assert error_at(fitted(data, case.without, case.arm), fresh) > case.error[1]
