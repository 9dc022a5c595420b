"""Partial residuals, recorded joints, poses of a known robot, loads of rows, and the memory of an approach."""

import csv
import dataclasses
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from arms import arm, circumstances, suited
from commands import missing, refused
from independent_arm import DECLARED, LIMITS, Run, load_torques, measured, robot, run, targets, torques
from sample_files import POSES as SAMPLE_POSES, ROBOT, saved
from searched import ARM, fitted, found, model, values_of

import robacc
from robacc import InputError, Measurements, read_robot
from robacc.diagnostics.partial_residuals import PartialResidual, partial_residuals
from robacc.diagnostics.recorded import RowLoads, evident_rounding, memory_of_play, read_back_warning, unlogged_loads
from robacc.diagnostics.robot_poses import read_robot_poses
from robacc.effects import REGISTRY
from robacc.effects.base import Effect, effect_class
from robacc.fitting.fit_result import Fit, Options
from robacc.fitting.solver import fit
from robacc.gravity import gravity_torques
from robacc.modelling.model import Model, predict
from robacc.poses.csv_file import format_poses, read_poses
from robacc.simulation.simulate import Plan, simulate
from robacc.tracing.search import search
from robacc.tracing.trace import trace

NOISE = 1e-5
N = 80
POSES = run(N, seed=41)
OFF = np.random.default_rng(42).normal(scale=2e-4, size=(6, N))
"""How far the joints read back are off the commanded ones, rad."""


def with_both(share: float) -> Measurements:
    """An arm that stands a share of the way from its command to the joints read back."""
    data = measured(POSES, targets(POSES.q + share * OFF), NOISE, 3)
    return dataclasses.replace(data, read_back=POSES.q + OFF)


def test_an_arm_that_stands_at_the_joints_read_back_is_told() -> None:
    data = with_both(1.0)
    (effect,) = found(data)
    assert str(effect) == "read_back"
    final = fitted(data, (effect,))
    values = values_of(final)
    assert values["read_back"] == pytest.approx(1.0, abs=0.05)
    assert "follow the joints read back, not those commanded" in effect.statement(ARM, values)
    assert not list(read_back_warning(final, data))


def test_joints_read_before_settling_leave_the_commanded_ones_in_force() -> None:
    data = with_both(0.0)
    assert found(data) == ()
    (text,) = read_back_warning(fitted(data), data)
    assert "read before the arm had settled" in text
    assert abs(float(text.split("share of ")[1].split(" ")[0])) < 0.05


def test_a_fit_without_the_effect_says_where_the_arm_stood() -> None:
    data = with_both(1.0)
    (text,) = read_back_warning(fitted(data), data)
    assert "give the joints read back as q1 … qN" in text
    assert float(text.split("share of ")[1].split(" ")[0]) == pytest.approx(1.0, abs=0.05)


def test_joints_of_another_unit_are_an_error(tmp_path: Path) -> None:
    path = saved(tmp_path / "poses.csv", "q1,read_q1,x,y,z\n0.5,28.6,1,0,0\n0.6,34.4,1,0,0\n")
    with pytest.raises(Exception, match="check the unit and the order of the columns read back"):
        read_poses(path)


def test_commanded_joints_may_say_so(tmp_path: Path) -> None:
    path = saved(tmp_path / "poses.csv", "cmd_q1_deg,cmd_q2_deg,x,y,z\n10,20,1,0,0\n11,21,1,0,0\n")
    np.testing.assert_allclose(np.degrees(read_poses(path).q), [[10, 11], [20, 21]])


def test_an_export_with_both_has_both(tmp_path: Path) -> None:
    rows = "\n".join(f"{i},{2 * i},{i + 0.01},{2 * i + 0.02},{100 + i},{i},{2 * i}" for i in range(10, 20))
    path = saved(
        tmp_path / "export.csv",
        "J1 cmd [deg],J2 cmd [deg],J1 actual [deg],J2 actual [deg],X [mm],Y [mm],Z [mm]\n" + rows + "\n",
    )
    data = read_poses(path)
    np.testing.assert_allclose(np.degrees(data.read_back - data.q), np.tile([[0.01], [0.02]], 10), atol=1e-9)


def rounded(step_degrees: float, is_command: bool) -> Measurements:
    """Poses with joints in whole steps: commanded so, or recorded so."""
    whole = np.radians(np.round(np.degrees(POSES.q) / step_degrees) * step_degrees)
    position = targets(whole if is_command else POSES.q)
    return measured(Run(whole, POSES.direction, POSES.time), position, NOISE, 4)


def test_rounding_is_named_and_counts_as_scatter() -> None:
    data = rounded(0.1, is_command=False)
    result = trace(model(data), data, n_folds=2)
    assert result.verdict == "clean"
    (text,) = [warning for warning in result.warnings if "rounded" in warning]
    assert text.startswith("the joint variables are rounded to 0.1 degrees")
    expected = evident_rounding(fitted(data), data)
    np.testing.assert_allclose(expected.std, np.radians(0.1) / np.sqrt(12.0))
    moved = targets(data.q) - targets(POSES.q)
    assert expected.position == pytest.approx(float(np.sqrt(np.mean(np.sum(moved**2, axis=0)))), rel=0.15)


def test_commands_in_whole_steps_and_exact_positions_show_no_rounding() -> None:
    data = rounded(0.1, is_command=True)
    result = fitted(data)
    assert evident_rounding(result, data) is None
    exact = dataclasses.replace(result, residual=np.zeros_like(result.residual))
    assert evident_rounding(exact, data) is None


def test_an_error_that_resembles_the_difference_is_no_settling() -> None:
    """The measured positions move against the difference, as no arm between command and reading does."""
    data = with_both(-0.8)
    (text,) = read_back_warning(fitted(data), data)
    assert "only 0 to 1 is possible" in text
    assert "settled" not in text
    assert search(model(data), data, only=["read_back", "gear_ratio"]).effects == ()


@pytest.mark.parametrize("is_command", [False, True])
def test_an_estimate_names_the_rounding_that_its_errors_show(tmp_path: Path, is_command: bool) -> None:
    path = saved(tmp_path / "poses.csv", format_poses(rounded(0.1, is_command)))
    warnings = robacc.estimate(path, robot=robot(), align=("base_frame", "tool_frame")).warnings
    texts = [text for text in warnings if "rounded" in text]
    assert len(texts) == (0 if is_command else 1)
    if texts:
        assert texts[0].startswith("the joint variables are rounded to 0.1 degrees, which moves the target by ")


def test_positions_that_a_controller_computed_are_told_from_measured_ones(tmp_path: Path) -> None:
    path = tmp_path / "poses.csv"
    for noise, told in ((0.0, True), (2e-5, False)):
        data = simulate(arm("puma560").robot, Plan(40, seed=4, noise_position=noise, orientation=False)).data
        rounded_to_um = dataclasses.replace(data, position=np.round(data.position, 6))
        path.write_text(format_poses(rounded_to_um), encoding="utf-8")
        warnings = robacc.estimate(path, robot=arm("puma560").robot, align="none").warnings
        assert any("look computed from the joints, not measured" in text for text in warnings) == told


@pytest.mark.parametrize("digits", [3, 12])
def test_positions_of_many_digits_are_computed_ones_too(tmp_path: Path, digits: int) -> None:
    """A controller shows joints to 0.001 degrees, and a program writes all digits of its positions."""
    data = simulate(arm("puma560").robot, Plan(40, seed=4, noise_position=0.0, orientation=False)).data
    q = np.radians(np.round(np.degrees(data.q), digits))
    path = saved(tmp_path / "poses.csv", format_poses(dataclasses.replace(data, q=q)))
    warnings = robacc.estimate(path, robot=arm("puma560").robot, align="none").warnings
    assert any("look computed from the joints, not measured: give those of an" in text for text in warnings)


N_OF_PARTIAL_RESIDUALS = 160
ENTRIES: dict[str, dict[str, Any]] = {
    "backlash": {"joints": ["j3"], "values": {"j3": -2e-4}},
    "approach_lag": {"joints": ["j2"], "values": {"j2": 3e-4}},
    "gear_ratio": {"joints": ["j2"], "values": {"j2": 4e-4}},
    "joint_coupling": {"joints": ["j6"], "drivers": ["j5"], "values": {"j6.j5": 1e-3}},
    "transmission_error": {"joints": ["j1"], "orders": [7.5], "values": {"j1.cos7.5": 1.2e-4, "j1.sin7.5": -1.6e-4}},
    "joint_compliance": {"joints": ["j2"], "values": {"j2": 5e-6}},
    "payload_compliance": {"joints": ["j2"], "values": {"j2": 2e-5}},
    "thermal_expansion": {"reference_c": 20, "values": {"value": 3e-5}},
    "frame_drift": {"origin_s": 1800, "span_s": 1800, "degree": 1, "values": {"x": 3e-4}},
    "instrument_scale": {"values": {"value": -3e-4}},
    "axis_wobble": {"joints": ["j2"], "values": {}},
    "base_compliance": {"values": {}},
    "joint_correction": {
        **{"joints": ["j3"], "drivers": ["j2"], "range": [[-3, 3]], "degree": 3},
        "values": {"j3.j2.T1": 1e-4, "j3.j2.T2": 2e-4},
    },
}


@cache
def fitted_of_partial_residuals(name: str, oriented: bool = True) -> tuple[Fit, Effect, Measurements]:
    """Poses of an arm with one effect, and the fit of that effect to them."""
    nominal = dataclasses.replace(arm("puma560").robot, effects=())
    truth = dataclasses.replace(nominal, effects=({"effect": name, **ENTRIES[name]},), effect_units=(1.0, 1.0))
    blank = circumstances(nominal, N_OF_PARTIAL_RESIDUALS, seed=4)
    poses = predict(truth, blank)
    noise = np.random.default_rng(5).normal(scale=NOISE, size=(3, N_OF_PARTIAL_RESIDUALS))
    data = dataclasses.replace(blank, position=poses.translation + noise, rotation=poses.rotation if oriented else None)
    settings = {key: value for key, value in ENTRIES[name].items() if key not in ("joints", "values")}
    effect = REGISTRY[name].from_settings(tuple(ENTRIES[name].get("joints", ())), settings)
    return fit(Model.of(nominal, (effect,)), data, Options(misfit=(NOISE, NOISE))), effect, data


def curve(name: str, oriented: bool = True) -> PartialResidual:
    found, effect, data = fitted_of_partial_residuals(name, oriented)
    (one,) = partial_residuals(effect, found, data)
    return one


@pytest.mark.parametrize("name", [name for name in ENTRIES if ENTRIES[name]["values"]])
def test_what_is_explained_is_the_difference_of_the_residuals(name: str) -> None:
    one = curve(name)
    good = np.isfinite(one.sd)
    assert good.sum() > 0.9 * N_OF_PARTIAL_RESIDUALS
    np.testing.assert_allclose((one.before - one.after)[good], one.effect[good], rtol=1e-9, atol=1e-15)
    # With the truth in the model what is left is the noise of each reading.
    ratio = one.after[good] / one.sd[good]
    assert np.sqrt(np.mean(np.square(ratio))) < 1.3


EXPECTED = {
    "backlash": lambda data: -2e-4 * data.direction[2],
    "approach_lag": lambda data: 3e-4 * data.speed[1],
    "gear_ratio": lambda data: 4e-4 * data.q[1],
    "joint_coupling": lambda data: 1e-3 * data.q[4],
    "transmission_error": lambda data: 1.2e-4 * np.cos(7.5 * data.q[0]) - 1.6e-4 * np.sin(7.5 * data.q[0]),
    "joint_compliance": lambda data: 5e-6 * gravity_torques(arm("puma560"), data.q)[1],
}


@pytest.mark.parametrize("oriented", [True, False])
@pytest.mark.parametrize("name", EXPECTED)
def test_a_joints_effect_is_told_as_its_own_angle(name: str, oriented: bool) -> None:
    one = curve(name, oriented)
    _, _, data = fitted_of_partial_residuals(name, oriented)
    wanted = EXPECTED[name](data)
    assert one.unit == "rad"
    assert one.joint == ENTRIES[name]["joints"][0]
    # To first order in angles of some 1e-4, and of a coefficient that noise moves by less than a hundredth.
    sure = np.isfinite(one.sd) & (one.sd < 20 * np.nanmedian(one.sd))
    assert np.max(np.abs(one.effect - wanted)[sure]) < 0.03 * np.max(np.abs(wanted))


def test_the_spectrum_shows_the_order_and_nothing_after() -> None:
    spectrum = curve("transmission_error").spectrum
    strongest = int(np.argmax(spectrum.before))
    assert spectrum.orders[strongest] == 7.5
    # The simulated amplitude is that of 1.2 and 1.6: 2, of 1e-4.
    assert spectrum.before[strongest] == pytest.approx(2e-4, rel=0.05)
    assert spectrum.after.max() < 5 * spectrum.noise
    # An amplitude of noise has the mean square 4 sigma^2 / N of two coefficients.
    assert np.sqrt(np.mean(np.square(spectrum.after))) == pytest.approx(spectrum.noise, rel=0.5)


def test_a_cause_of_no_joint_is_told_along_the_way_it_moves_the_target() -> None:
    warm = curve("thermal_expansion")
    _, _, data = fitted_of_partial_residuals("thermal_expansion")
    assert (warm.joint, warm.unit, warm.driver, warm.driver_unit) == (None, "m", "temperature_c", "°C")
    assert np.array_equal(np.sign(warm.effect), np.sign(data.temperature - 20.0))
    # The base moves along x by 0.3 mm in half the time: at every pose the same line through its middle.
    assert curve("frame_drift").effect == pytest.approx(3e-4 * (data.time - 1800) / 1800, abs=1e-5)
    scale = curve("instrument_scale")
    assert scale.driver == "distance"
    assert scale.effect == pytest.approx(-3e-4 * scale.x, rel=0.05)


def test_every_effect_of_a_joint_has_a_driver() -> None:
    for name, cls in REGISTRY.items():
        if cls.traits.per_joint and name not in ("link_geometry", "lateral_compliance", "step"):
            robot_arm = suited(name, arm("puma560"))
            data = circumstances(robot_arm.robot, 40)
            default = cls.default(robot_arm, data, cls.possible_joints(robot_arm)[:1])
            effect = next(iter(cls.candidates(robot_arm, data)), default)
            assert effect.driver(robot_arm, data, effect.joints[0]).values.shape == (40,)


def test_an_effect_without_a_single_driver_is_held_against_itself() -> None:
    one = curve("base_compliance")
    assert one.driver == "predicted"
    assert one.grid is not None
    assert one.value is not None
    assert np.array_equal(one.grid, one.value)


AXES = ("x", "y", "z")


def rewritten(folder: Path, unit: str, factor: float, repeat: int = 1) -> Path:
    """The sample's poses, positions times ``factor`` in columns that say ``unit``."""
    with SAMPLE_POSES.open(newline="") as stream:
        rows = list(csv.DictReader(line for line in stream if not line.startswith("#")))
    path = folder / "rewritten.csv"
    with path.open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow([f"{name}_{unit}" if name in AXES else name for name in rows[0]])
        for row in rows * repeat:
            writer.writerow([float(value) * factor if name in AXES else value for name, value in row.items()])
    return path


@pytest.mark.parametrize(
    ("unit", "factor", "complaint", "tip"),
    [
        ("m", 1e3, "times as far as the robot moved (", "if they are in mm, name the columns x_mm, y_mm, z_mm"),
        ("mm", 1.0, "times less than the robot moved (", "if they are in m, name the columns x, y, z"),
    ],
)
@pytest.mark.parametrize("command", [("estimate",), ("calibrate", "--fit", "joint_offset"), ("trace",)])
def test_a_unit_that_does_not_suit_the_robot_is_refused(
    tmp_path: Path, command: tuple[str, ...], unit: str, factor: float, complaint: str, tip: str
) -> None:
    path = rewritten(tmp_path, unit, factor)
    name, *options = command
    told = refused(name, path, "--robot", ROBOT, *options, status=3)
    assert missing(told, f"error: {path}, x, y, z: the positions spread over", complaint, tip) == []


def test_metres_and_radians_read_as_millimetres_and_degrees_are_refused(tmp_path: Path) -> None:
    path = rewritten(tmp_path, "mm", 1.0)
    header, *rows = path.read_text().splitlines()
    names = [f"{name}_deg" if name.startswith("q") and name[1:].isdigit() else name for name in header.split(",")]
    path.write_text("\n".join([",".join(names), *rows]) + "\n")
    with pytest.raises(InputError, match=r"spread over 1.* mm only, .*if they are in m and rad, give `units` as m,rad"):
        read_robot_poses(path, read_robot(str(ROBOT)))


def test_rows_in_turn_are_not_judged_by_one_of_them(tmp_path: Path) -> None:
    """60 poses visited a hundred times, and more rows than are looked at: those are of many poses."""
    robot = read_robot(str(ROBOT))
    with pytest.raises(InputError, match="times as far as the robot moved"):
        read_robot_poses(rewritten(tmp_path, "m", 1e3, repeat=100), robot)
    assert read_robot_poses(rewritten(tmp_path, "mm", 1e3, repeat=100), robot).n == 6000


def test_several_targets_want_a_robot_that_tells_them_apart(tmp_path: Path) -> None:
    robot = read_robot(str(ROBOT))
    header, first, second = SAMPLE_POSES.read_text(encoding="utf-8").splitlines()[1:4]
    path = saved(tmp_path / "two.csv", f"{header},target\n{first},smr1\n{second},smr2\n")
    several = "found several targets ('smr1', 'smr2'), but the robot has one tool"
    assert f"error: {path}:3, target: {several}" in refused("estimate", path, "--robot", ROBOT, status=3)
    with pytest.raises(InputError, match=r"found several targets \(smr1, smr2\), but the robot has one tool"):
        robacc.estimate(robacc.read_poses(path), robot=robot)
    several = dataclasses.replace(robot, targets={"smr1": robot.tool})
    with pytest.raises(InputError, match=r"found 'smr2', expected a target of the robot \(smr1\)"):
        robacc.estimate(robacc.read_poses(path), robot=several)
    path.write_text(f"{header},target\n{first},smr1\n{second},smr1\n", encoding="utf-8")
    assert read_robot_poses(path, robot).n == 2


NOISE_OF_ROW_LOADS = 2e-5
N_OF_ROW_LOADS = 90
COMPLIANCE = np.array([0.0, 8e-7, 1.2e-6, 0.0, 0.0, 0.0])


def groups_of(turn: np.ndarray, seed: int, declared: str = DECLARED) -> RowLoads | None:
    """Groups of an arm whose joints are turned by ``turn`` ``(6, N)`` beyond the commanded."""
    poses = run(N_OF_ROW_LOADS, seed)
    data = measured(poses, targets(poses.q + turn), NOISE_OF_ROW_LOADS, seed, directed=True)
    return unlogged_loads(fitted(data, declared=declared), data)


def deflections(seed: int, mass: np.ndarray) -> np.ndarray:
    """Turns ``(6, N)`` of the joints by the arm's weight and a load of ``mass`` ``(N,)`` at the tool."""
    return COMPLIANCE[:, None] * load_torques(run(N_OF_ROW_LOADS, seed).q, mass)


@pytest.mark.parametrize("loads", [(0.0, 20.0, 40.0), (0.0, 30.0)])
def test_rows_are_grouped_by_their_load(loads: tuple[float, ...]) -> None:
    number = np.random.default_rng(3).integers(0, len(loads), N_OF_ROW_LOADS)
    turn = deflections(11, np.array(loads)[number])
    found = groups_of(turn, 11, DECLARED + ",joint_compliance[j2,j3]")
    assert len(found.rows) == len(loads)
    right = sum(np.count_nonzero(number[rows] == i) for i, rows in enumerate(found.rows))
    assert right >= 0.95 * N_OF_ROW_LOADS
    assert found.loads == pytest.approx(np.array(loads) / loads[-1], abs=0.1)
    assert "if it changed, write payload_kg" in found.text
    assert "the cause is outside the catalogue" in found.text


def test_other_errors_are_no_loads() -> None:
    """A constant load, play, scatter of a joint, a spring that is not in the model, and noise alone."""
    rng = np.random.default_rng(5)
    joint_two = np.array([[0], [1], [0], [0], [0], [0]])
    poses = run(N_OF_ROW_LOADS, 12)
    for turn in (
        deflections(12, np.full(N_OF_ROW_LOADS, 30.0)),
        1.5e-4 * poses.direction * joint_two,
        3e-4 * rng.normal(size=N_OF_ROW_LOADS) * joint_two,
        deflections(12, np.zeros(N_OF_ROW_LOADS)) * 3.0,
        np.zeros((6, N_OF_ROW_LOADS)),
    ):
        assert groups_of(turn, 12) is None


N_OF_APPROACH_MEMORY = 120


def sequence(seed: int) -> Run:
    """Poses that follow each other; the direction is that of the move."""
    rng = np.random.default_rng(seed)
    low, high = np.array(LIMITS).T[..., None]
    q = rng.uniform(low, high, (6, N_OF_APPROACH_MEMORY))
    return Run(q, np.sign(np.diff(q, axis=1, prepend=0.0)), 30.0 * np.arange(N_OF_APPROACH_MEMORY))


def memory_p_value(poses: Run, memory: float, seed: int) -> float:
    """Return the p-value for joint 3 with play of 0.2 mrad and a share of it that follows the torque's change."""
    torque = torques(poses.q)[2]
    change = np.sign(np.diff(torque, prepend=torque[0]))
    position = poses.turned(2, 2e-4 * ((1 - memory) * poses.direction[2] + memory * change))
    data = measured(poses, position, 2e-5, seed, timed=True, directed=True)
    play = effect_class("backlash").from_settings(("j3",), {})
    return memory_of_play(fitted(data, (play,)), data, ["j3"])["j3"]


def test_a_memory_is_noticed() -> None:
    assert memory_p_value(sequence(1), 0.25, 1) < 1e-4


def test_play_alone_has_none() -> None:
    """Twelve arms: the smallest of twelve uniform p-values is below 0.002 in one of forty runs; the seeds are fixed."""
    p_values = [memory_p_value(sequence(seed), 0.0, seed) for seed in range(2, 8)]
    assert min(p_values) > 0.002
    assert max(p_values) > 0.2
