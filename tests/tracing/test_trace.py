"""A trace: causes, verdict, processes over drivers, invariance, and arms with slides."""

import dataclasses
import math
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import independent_arm
import numpy as np
import pytest
from arms import arm, model_of
from draws import FRAMES, erring
from slow_parameters import some_fast

import robacc
from robacc import Measurements, Robot
from robacc.documents.fit import FINDING, NOISE, REPEATABILITY
from robacc.effects.base import effect_class
from robacc.effects.elastic import JointCompliance
from robacc.error_model.structure import Repeatability
from robacc.fitting.fit_result import Fit, Options
from robacc.fitting.levels import ACCEPTED
from robacc.fitting.priors import without_idle_rotations
from robacc.fitting.solver import by_effect, fit, refit
from robacc.fitting.visits import random_rows
from robacc.fitting.warnings import LackOfFit
from robacc.geometry import rms_length
from robacc.modelling.model import Known, Model, Noise, predict
from robacc.render.views.fit import _at_tool, _remaining_error, _residual
from robacc.robots.arm import Arm
from robacc.simulation.simulate import Plan, simulate
from robacc.tracing.calibrating import ErrorCause, causes
from robacc.tracing.search import Identified
from robacc.tracing.trace import Trace, _useless, assumption_of, trace

ESTIMATED = LackOfFit(Noise(2e-5, None, "residual"), None, 1.0)
TINY = LackOfFit(Noise(4e-8, None, "residual"), None, 1.0)
KNOWN = LackOfFit(Noise(2e-5, None, "file"), 0.3, 1.0)
SCATTER = Repeatability((("j1", 3e-5),), 8.6e-5, "residual", 0.0)


REPEATED = LackOfFit(Noise(2e-5, None, "repeats"), None, 1.0)
VISITED = replace(SCATTER, source="repeated visits")
NOISE_IS = "the measurement noise is {} mm along each axis (standard deviation); sigma columns or repeated poses"
ARM_IS = "the arm's own repeatability is 0.086 mm rms at the target"


@pytest.mark.parametrize(
    ("lack", "scatter", "presumed"),
    [
        (ESTIMATED, None, NOISE_IS.format("0.02")),
        (ESTIMATED, SCATTER, f"{ARM_IS} and {NOISE_IS.format('0.02')}"),
        # Noise that scatter of the joints hides gets no number: of 50 poses, the scatter took all but 65 nm.
        (TINY, None, NOISE_IS.format("4e-05")),
        (TINY, VISITED, NOISE_IS.format("4e-05")),
        (TINY, SCATTER, f"{ARM_IS}; repeated poses"),
        # Noise estimated beside scatter has no test, yet sigma columns or repeated visits tell it.
        *((replace(told, p_value=None), SCATTER, f"{ARM_IS}; repeated poses") for told in (KNOWN, REPEATED)),
        *((replace(told, p_value=None), VISITED, None) for told in (KNOWN, REPEATED)),
        (KNOWN, None, None),
    ],
)
def test_the_verdict_presumes_what_the_residual_alone_tells(
    lack: LackOfFit, scatter: Repeatability | None, presumed: str | None
) -> None:
    expected = presumed and f"explained if {presumed} would test this"
    assert (assumption_of("explained", lack, scatter), assumption_of("partly_explained", lack, scatter)) == (
        expected,
        None,
    )


def result_of(noise: LackOfFit, repeatability: Repeatability | None, rms: float, noise_rms: float | None) -> Any:
    return {
        "noise": NOISE.write(noise),
        "repeatability": REPEATABILITY.document(repeatability),
        "before": {"fitted": {"position": {"rms_m": 1.2e-4}}},
        "unexplained": {
            "rms_m": rms,
            "noise_rms_m": noise_rms,
            "structured": False,
            "p_value": 0.4,
            "hints": [],
            "parts": {"noise_m": rms},
        },
        "explained_share": 0.77,
        "findings": ["one"],
        "robot": {"joints": [{"name": "j1", "type": "revolute"}]},
    }


def test_the_table_names_hidden_noise() -> None:
    hidden = _residual(result_of(TINY, SCATTER, 7.7e-5, None))
    assert hidden == (
        "baseline: 0.120 mm rms; measurement noise: not distinguishable from the arm's repeatability (see the "
        "remaining error) because the file has neither sigma columns nor repeated poses"
    )
    assert "measurement noise: 0.0346 mm rms, estimated" in _residual(result_of(ESTIMATED, SCATTER, 7.7e-5, None))
    for known in (KNOWN, REPEATED):
        assert "neither sigma columns nor repeated poses" not in _residual(result_of(known, SCATTER, 7.7e-5, None))
    shares = [line for line in _remaining_error(result_of(TINY, SCATTER, 7.7e-5, None)) if "explainable" in line]
    assert shares == ["77 % of the explainable error is explained (held-out variance above noise and repeatability)"]


@pytest.mark.parametrize(
    ("noise_rms", "text"),
    [
        (1.3e-3, "1.01 mm rms on the calibration poses; measurement noise alone is 1.30 mm"),
        (0.4e-3, "1.01 mm rms on the calibration poses, of which 0.400 mm is measurement noise"),
    ],
)
def test_noise_is_no_part_of_a_smaller_error(noise_rms: float, text: str) -> None:
    assert next(iter(_remaining_error(result_of(KNOWN, None, 1.01e-3, noise_rms)))) == text


def test_a_part_that_is_lost_beside_another_has_no_size() -> None:
    """Beside 64 µm of scatter a laser tracker's noise was stated as 0.17 µm."""
    result = result_of(KNOWN, None, 6.7e-5, None)
    result["unexplained"]["parts"] = {"noise_m": 1.7e-7, "scatter_m": 6.4e-5}
    assert "its parts, mm: noise not seen, scatter of the joints 0.0640" in _remaining_error(result)


NOISE_OF_TRACE = 2e-5
DECLARED = "base_frame,tool_frame,joint_offset,link_geometry"
Entry = dict[str, Any]


def entry(effect: str, joint: str, value: float) -> Entry:
    return {"effect": effect, "joints": [joint], "values": {joint: value}}


WAVE: Entry = {
    "effect": "transmission_error",
    "joints": ["j3"],
    "orders": [12.5],
    "values": {"j3.cos12.5": 2e-4, "j3.sin12.5": -1e-4},
}
CASES: dict[str, tuple[str, Entry]] = {
    "gear": ("puma560", entry("gear_ratio", "j2", 4e-4)),
    "backlash": ("irb1600", entry("backlash", "j3", 2e-4)),
    "wave": ("irb1600", WAVE),
    "compliance": ("panda", entry("joint_compliance", "panda_joint2", 5e-6)),
    # Hundreds of times the noise: next to it, the noise before it is no measure of what is plausible.
    "large": ("ur10", entry("gear_ratio", "shoulder_lift_joint", -2.4e-3)),
}


def geometry(name: str, seed: int = 0) -> Entry:
    """Errors of zeros that every trace here declares and fits."""
    rng = np.random.default_rng(seed)
    joints = list(arm(name).names[1:])
    return {
        "effect": "joint_offset",
        "joints": joints,
        "values": {joint: float(rng.normal(scale=1e-3)) for joint in joints},
    }


def measured(name: str, *effects: Entry, n: int = 60, seed: int = 1, **changes: Any) -> Measurements:
    plan = Plan(n, seed=seed, noise_position=NOISE_OF_TRACE, orientation=False)
    robot = dataclasses.replace(arm(name).robot, effects=(geometry(name), *effects))
    return simulate(robot, dataclasses.replace(plan, **changes)).data


def traced(robot: Robot, data: Measurements, declared: str = DECLARED, **options: Any) -> Trace:
    return trace(model_of(robot, declared, data), data, **options)


@cache
def case(which: str) -> tuple[Trace, list[str]]:
    """The trace of a case, and what it told of its progress."""
    (name, effect), told = CASES[which], []
    return traced(arm(name).robot, measured(name, effect), progress=lambda what, *_: told.append(what)), told


def named(found: Trace) -> list[tuple[str, tuple[str, ...]]]:
    return [(finding.effect, finding.joints) for finding in found.findings]


@pytest.mark.parametrize(
    "name", ["panda", "scara", *(pytest.param(name, marks=pytest.mark.slow) for name in ("puma560", "stanford"))]
)
def test_a_clean_arm_is_left_alone(name: str) -> None:
    found = traced(arm(name).robot, measured(name))
    assert (named(found), found.verdict, found.gain) == ([], "clean", None)
    assert not found.unexplained.structured
    assert found.after.fitted == found.before.fitted
    # Nothing found, so what is left is the noise: 180 numbers, 30 to 40 of them used.
    assert found.noise.noise.position == pytest.approx(NOISE_OF_TRACE, rel=0.3)


@pytest.mark.parametrize("which", CASES)
def test_what_is_there_is_named_and_nothing_besides(which: str) -> None:
    _, effect = CASES[which]
    found, told = case(which)
    assert told[:2] == ["searching", "searching, 1 finding"]
    assert named(found) == [(effect["effect"], tuple(effect["joints"]))]
    (finding,) = found.findings
    assert found.verdict == "explained"
    assert finding.p_value < 1e-6
    assert not finding.warnings
    for parameter, value in zip(finding.parameters, effect["values"].values(), strict=True):
        if which == "wave":  # its order is fitted too, which moves its phase
            continue
        assert abs(parameter.value - value) < 4 * parameter.std
    assert finding.held_out_after < 0.7 * finding.held_out_before
    assert found.after.held_out is not None
    # The only finding: without it is before, but for constants that take its place where they are not shrunk.
    assert 0.98 < finding.held_out_before / found.before.held_out.position.rms < 1.1
    assert 0 < found.gain.low < found.gain.value < found.gain.high


def test_a_searched_order_is_found_off_the_grid() -> None:
    (finding,) = case("wave")[0].findings
    (line,) = finding.harmonics
    # The truth is 2e-4 and -1e-4; three standard errors hold nearly always, and are a small part of the amplitude.
    assert abs(line.amplitude - math.hypot(2e-4, 1e-4)) < 3 * line.amplitude_std < 0.3 * line.amplitude
    assert abs(line.phase - math.atan2(-1, 2)) < 3 * line.phase_std < 0.3
    assert line.order == pytest.approx(12.5, abs=0.05)
    assert line.amplitude == pytest.approx(np.hypot(2e-4, 1e-4), rel=0.15)
    ((joint, low, high),) = finding.validity
    assert joint == "j3"
    assert low < high


def test_a_beam_break_is_no_effect() -> None:
    plan = Plan(80, seed=1, noise_position=NOISE_OF_TRACE, orientation=False, outliers=3, outlier_size=0.01)
    made = simulate(arm("puma560").robot, plan)
    found = traced(arm("puma560").robot, made.data)
    assert named(found) == []
    assert found.fit.outliers.tolist() == made.outliers.tolist()
    assert any(warning.startswith("outliers left out of the fit: 3 rows") for warning in found.warnings)


def test_frames_that_nobody_declared_are_found() -> None:
    robot = arm("ur10").robot
    data = simulate(robot, Plan(60, seed=3, noise_position=NOISE_OF_TRACE, orientation=False)).data
    moved = dataclasses.replace(data, position=data.position + np.array([[3e-4], [-2e-4], [5e-4]]))
    found = traced(robot, moved, "")
    assert named(found) == [("base_frame", ())]
    assert found.nominal_unregistered.fitted == found.before.fitted
    frame = {parameter.name: parameter.value for parameter in found.findings[0].parameters}
    assert frame["base_frame.z"] == pytest.approx(robot.base.xyz[2] + 5e-4, abs=5e-5)


@pytest.mark.parametrize("declared", some_fast([FRAMES, DECLARED], 2))
def test_constants_that_nobody_declared_are_a_hint_where_no_cause_is_named(declared: str) -> None:
    """Of 25 poses the search names four links, not all; 18 constants declared leave noise alone."""
    built = erring(arm("irb1600").robot, np.random.default_rng(1), offsets=True, lengths=True)
    data = simulate(built, Plan(25, seed=1, noise_position=NOISE_OF_TRACE, orientation=False)).data
    found = traced(arm("irb1600").robot, data, declared)
    is_empirical = any(finding.effect == "joint_correction" for finding in found.findings)
    hint = "every arm deviates in joint_offset and link_geometry too"
    assert is_empirical == any(hint in text for text in found.unexplained.hints) == (declared == FRAMES)


def test_a_row_of_the_table_that_is_wrong_is_told_with_its_joint() -> None:
    """Named whole, it is not the arm's whole geometry, of which idle rotations would be left out."""
    row = {"j2.a": 8e-4, "j2.alpha": 6e-4, "j2.d": -5e-4}
    wrong: Entry = {"effect": "link_geometry", "joints": ["j2"], "labels": ["d", "a", "alpha"], "values": row}
    robot = arm("irb1600").robot
    plan = Plan(100, seed=1, noise_position=NOISE_OF_TRACE, orientation=False)
    data = simulate(dataclasses.replace(robot, effects=(wrong,)), plan).data
    found = traced(robot, data, "base_frame,tool_frame")
    assert {("link_geometry", ("j2",))} == set(named(found))
    assert found.after.held_out.position.rms < 1.2 * np.sqrt(3) * NOISE_OF_TRACE


def test_what_is_left_is_held_against_its_neighbours() -> None:
    """A tracker that sways is not in the catalogue."""
    data = measured("puma560", n=100)
    swaying = data.position + 1e-4 * np.sin(2 * np.pi * np.arange(data.n) / 8)
    found = traced(arm("puma560").robot, dataclasses.replace(data, position=swaying), n_folds=2)
    assert found.verdict == "unexplained"
    assert found.unexplained.p_value < 1e-4
    assert any("correlated in time" in hint for hint in found.unexplained.hints)


@pytest.mark.slow
def test_a_scale_along_one_axis_is_never_called_explained() -> None:
    """It is not in the catalogue; a pedestal that tilts and profiles of joints imitate a part of it."""
    data = measured("puma560", n=100)
    stretched = dataclasses.replace(data, position=data.position * np.array([[1.0], [1.0], [1.0004]]))
    assert traced(arm("puma560").robot, stretched).verdict in ("unexplained", "partly_explained")


def test_an_uncertainty_that_the_poses_refute_is_warned_of() -> None:
    data = measured("puma560")
    for factor, warned in ((1.0, False), (5.0, True)):
        stated = dataclasses.replace(data, sigma_position=np.full(data.position.shape, factor * NOISE_OF_TRACE))
        found = traced(arm("puma560").robot, stated, n_folds=2)
        assert named(found) == []
        assert any("too large (wrong unit, or k = 2)" in text for text in found.warnings) is warned


@pytest.mark.slow
@pytest.mark.parametrize(("name", "value", "noise"), [("puma560", 4e-6, NOISE_OF_TRACE), ("panda", 9e-6, 1e-5)])
def test_effects_that_do_the_same_are_alternatives(name: str, value: float, noise: float) -> None:
    """The pedestal's tilt and the bearing of an upright first axis: the same moment, about the same place."""
    data = measured(name, {"effect": "base_compliance", "values": {"value": value}}, noise_position=noise)
    found = traced(arm(name).robot, data)
    (finding,) = found.findings
    stands_for = {finding.effect: 0.0, **{other.effect: other.evidence_difference for other in finding.alternatives}}
    assert {"base_compliance", "lateral_compliance"} <= set(stands_for)
    assert max(stands_for.values()) <= ACCEPTED
    assert all(0.5 <= other.similarity <= 1 + 1e-9 for other in finding.alternatives)
    assert found.next_poses


def test_noise_beyond_what_the_file_says_is_unexplained_and_not_an_effect() -> None:
    data = measured("puma560", noise_position=5 * NOISE_OF_TRACE)
    stated = dataclasses.replace(data, sigma_position=np.full(data.position.shape, NOISE_OF_TRACE))
    found = traced(arm("puma560").robot, stated)
    assert named(found) == []
    assert found.verdict == "unexplained"
    assert found.unexplained.structured
    assert found.unexplained.noise_rms == pytest.approx(np.sqrt(3) * NOISE_OF_TRACE)
    assert found.noise.noise.source == "file"
    assert found.noise.ratio == pytest.approx(5, rel=0.2)
    assert any("times the measurement noise (known from the file)" in hint for hint in found.unexplained.hints)


def test_the_columns_that_would_show_a_cause_are_named() -> None:
    # A lag whose speeds differ at each visit, and were not recorded, looks like scatter of the joints.
    rng = np.random.default_rng(5)
    once = measured("puma560", n=50)
    rows = np.tile(np.arange(once.n), 3)
    visits = dataclasses.replace(once.subset(rows), pose=rows, cycle=np.repeat(np.arange(3), once.n))
    speed = rng.uniform(-1.0, 1.0, (6, visits.n))
    lag = {"effect": "approach_lag", "joints": ["j2", "j3"], "values": {"j2": 6e-4, "j3": -5e-4}}
    robot = dataclasses.replace(arm("puma560").robot, effects=(geometry("puma560"), lag))
    position = predict(robot, dataclasses.replace(visits, speed=speed)).translation
    moved = position + rng.normal(scale=NOISE_OF_TRACE, size=position.shape) + 1e-4 * np.sin(np.arange(visits.n) / 9.0)
    bare = dataclasses.replace(visits, position=moved, speed=None, direction=None)
    found = traced(arm("puma560").robot, bare, n_folds=2)
    assert found.unexplained.parts["scatter"] > 5 * NOISE_OF_TRACE
    (hint,) = [hint for hint in found.unexplained.hints if "approach_lag" in hint]
    assert "no speed_q columns" in hint
    assert "record what they need" in hint


def test_too_few_poses_hold_none_out_and_say_so() -> None:
    found = traced(arm("scara").robot, measured("scara", n=5, orientation=True), "base_frame")
    assert found.after.held_out is None
    assert found.n_folds == 0
    assert any("too few to hold any out" in warning for warning in found.warnings)


def test_a_refit_decides_what_can_be_told_apart_at_the_nominal_robot() -> None:
    # Parallel axes that were fitted a little apart look as if both of two lengths along them could be found.
    one = arm("puma560")
    tilted = {"effect": "link_geometry", "joints": ["j2", "j3"], "values": {"j2.alpha": 2e-3, "j3.alpha": -3e-3}}
    data = measured("puma560", tilted)
    model = model_of(one.robot, DECLARED, data)
    found = fit(model, data, Options())
    again = refit(found, model.free, data, Options())
    assert again.identifiability.columns.tolist() == found.identifiability.columns.tolist()
    assert np.abs(again.theta).max() < 0.1
    # Others are nominal, wherever they start.
    frames = fit(model_of(one.robot, "base_frame,tool_frame", data), data, Options())
    start = by_effect(model.free, found.owners, found.names, np.full(found.theta.size, 1e-4))
    from_there = refit(frames, model.free, data, Options(), start)
    assert from_there.identifiability.columns.tolist() == found.identifiability.columns.tolist()
    others = np.setdiff1d(np.arange(found.theta.size), found.identifiability.columns)
    assert others.size
    assert not from_there.theta[others].any()
    assert rms_length(from_there.residual) == pytest.approx(rms_length(found.residual), rel=1e-6)


def test_the_smaller_side_of_a_backlash_is_no_outlier() -> None:
    # Beside a fit without the effect, its rows are outliers; left out, they would not show it.
    one = arm("irb1600")
    data = measured("irb1600", entry("backlash", "j1", 5e-4), n=100)
    up, down = (np.flatnonzero(data.direction[0] == sign) for sign in (1, -1))
    few = data.subset(np.sort(np.concatenate((up, down[:3]))))
    declared = fit(model_of(one.robot, DECLARED, few), few, Options())
    assert np.flatnonzero(few.direction[0] < 0).tolist() == declared.outliers.tolist()
    effect = effect_class("backlash").from_settings(("j1",), {})
    again = refit(declared, [*declared.model.free, effect], few, Options(), {(effect.key(), "backlash.j1"): 4e-4})
    assert not again.outliers.size
    assert again.theta[-1] == pytest.approx(5e-4, rel=0.1)
    kept = without_idle_rotations(again, again.model, few, Options())
    assert kept is not again
    assert not kept.outliers.size


@pytest.mark.slow
def test_a_finding_states_the_held_out_orientation_where_it_is_measured() -> None:
    wave = {"effect": "transmission_error", "joints": ["j1"], "values": {"j1.cos1": 2e-3}}
    data = measured("scara", wave, n=40, orientation=True, noise_orientation=1e-4)
    found = traced(arm("scara").robot, data, "base_frame")
    finding = next(finding for finding in found.findings if finding.joints == ("j1",))
    before, after = finding.held_out_turn
    # The error of the joint turns the tool by up to 2 mrad; without it, noise remains.
    assert before > 5e-4
    assert after < 0.5 * before
    size, largest = finding.turn_at_tool
    assert size == pytest.approx(before, rel=0.3)
    assert 1.5e-3 < largest < 2.5e-3
    assert " and turns it by up to 0.1" in _at_tool(FINDING.write(finding), None)


NOISE_OF_CAUSES = 5e-5
FIT = "base_frame,tool_frame,joint_offset,link_geometry,gear_ratio[j3]"
ZEROS = {"j2": 4e-4, "j3": -3e-4}
EFFECTS = (
    {"effect": "joint_offset", "joints": list(ZEROS), "values": ZEROS},
    {"effect": "link_geometry", "joints": ["j2"], "values": {"j2.a": 3e-4}},
    {"effect": "gear_ratio", "joints": ["j3"], "values": {"j3": 2e-4}},
)


def fitted(seed: int, asked: str = FIT) -> tuple[Fit, Measurements]:
    one = arm("puma560")
    robot = dataclasses.replace(one.robot, effects=EFFECTS)
    data = simulate(robot, Plan(80, seed=seed, noise_position=NOISE_OF_CAUSES, orientation=False)).data
    return fit(model_of(one.robot, asked, data), data, Options(robust=False)), data


def by_name(found: tuple[ErrorCause, ...]) -> dict[tuple[str, tuple[str, ...]], ErrorCause]:
    return {(cause.effect, cause.joints): cause for cause in found}


def test_the_causes_are_those_that_are_there_the_largest_first() -> None:
    fitted_to, data = fitted(1)
    found = causes(fitted_to, data, 1e-3)
    assert [cause.left for cause in found] == sorted((cause.left for cause in found), reverse=True)
    assert {(cause.effect, cause.joints[0]) for cause in found[:4]} == {
        ("joint_offset", "j2"),
        ("joint_offset", "j3"),
        ("link_geometry", "j2"),
        ("gear_ratio", "j3"),
    }
    assert all(cause.declared for cause in found)
    effects = [effect for effect in fitted_to.model.free if effect.name == "gear_ratio"]
    assert not by_name(causes(fitted_to, data, 1e-3, effects))["gear_ratio", ("j3",)].declared


def test_the_error_without_a_cause_is_that_of_a_fit_without_it() -> None:
    whole, data = fitted(2)
    lacking, _ = fitted(2, FIT.rpartition(",")[0])
    cause = by_name(causes(whole, data, 1e-3))["gear_ratio", ("j3",)]
    squares = [float(np.mean(np.sum(np.square(one.residual), axis=0))) for one in (whole, lacking)]
    assert cause.left == pytest.approx(np.sqrt(squares[1] - squares[0]), rel=0.02)
    assert cause.share == pytest.approx(cause.left**2 / 1e-6)


def test_intervals_hold_what_the_effects_really_do() -> None:
    inside = {("gear_ratio", "j3"): 0, ("joint_offset", "j2"): 0, ("link_geometry", "j2"): 0}
    for seed in range(100, 100 + 60):
        whole, data = fitted(seed)
        truth = np.zeros(whole.theta.size)
        for entry in EFFECTS:
            for name, value in entry["values"].items():  # type: ignore[attr-defined]
                truth[whole.names.index(f"{entry['effect']}.{name}")] = value
        _, jacobian = whole.model.bind(data).linearise(whole.theta, None, 3)
        found = by_name(causes(whole, data, 1e-3))
        for effect, joint in inside:
            mask = np.array([name.startswith(f"{effect}.{joint}") for name in whole.names])
            moved = np.einsum("mkn,k->mn", jacobian[:, mask], truth[mask])
            size = float(np.sqrt(np.mean(np.sum(moved**2, axis=0))))
            low, high = found[effect, (joint,)].interval
            inside[effect, joint] += low <= size <= high
    # 95 % of 60: 50 or fewer have a probability of 0.1 %.
    assert min(inside.values()) > 50


def test_a_zero_turns_the_target_by_its_own_angle_where_orientation_is_measured() -> None:
    nominal = arm("puma560").robot
    plan = Plan(40, seed=4, noise_position=NOISE_OF_CAUSES, noise_orientation=1e-5)
    data = simulate(dataclasses.replace(nominal, effects=EFFECTS[:1]), plan).data
    calibrated = robacc.calibrate(data, robot=nominal, fit="base_frame,tool_frame,joint_offset")
    zeros = {part.name: abs(part.value) for part in calibrated.parameters}
    turns = {cause.joints[0]: cause.turn for cause in calibrated.causes}
    for joint in ZEROS:
        assert turns[joint] == pytest.approx(zeros[f"joint_offset.{joint}"], rel=1e-3)
    assert "turns, °" in str(calibrated)
    of_positions = robacc.calibrate(dataclasses.replace(data, rotation=None), robot=nominal, fit="joint_offset[j2,j3]")
    assert {cause.turn for cause in of_positions.causes} == {None}
    assert "turns" not in str(of_positions)


def test_what_the_poses_do_not_distinguish_from_nothing_is_no_cause() -> None:
    one = arm("puma560")
    plan = Plan(60, seed=3, noise_position=NOISE_OF_CAUSES, orientation=False)
    data = simulate(dataclasses.replace(one.robot, effects=()), plan).data
    whole = fit(model_of(one.robot, FIT, data), data)
    found = causes(whole, data, NOISE_OF_CAUSES)
    assert len(found) <= 4  # 5 % of some thirteen groups, by chance
    assert all(cause.size < 3 * NOISE_OF_CAUSES for cause in found)


NOISE_OF_PROCESS, SIZE, LENGTH = 8e-6, 3e-5, 0.5
"""m, m, rad: along each axis."""


def poses(paths: int, points: int, rng: np.random.Generator) -> np.ndarray:
    """Return joints ``(6, N)`` on straight lines in joint space, about 0.35 rad long for each joint."""
    start = rng.uniform(-0.6, 0.6, (paths, 1, 6))
    along = np.linspace(0.0, 1.0, points)[None, :, None] * rng.normal(scale=0.35, size=(paths, 1, 6))
    return (start + along).reshape(-1, 6).T


@cache
def traced_of_process(paths: int, points: int, size: float, seed: int) -> Trace:
    """Return the trace of a campaign whose arm has a process of the stated size, by cosines of random directions."""
    rng = np.random.default_rng(seed)
    q = poses(paths, points, rng)
    angle = rng.normal(scale=1.0 / LENGTH, size=(300, 6)) @ q + rng.uniform(0.0, 2.0 * np.pi, (300, 1))
    process = size * np.sqrt(2.0 / 300) * rng.normal(size=(3, 300)) @ np.cos(angle)
    offsets = rng.normal(scale=4e-4, size=(6, 1))
    position = independent_arm.targets(q + offsets) + process
    data = Measurements(position=position + NOISE_OF_PROCESS * rng.standard_normal(position.shape), q=q)
    return trace(model_of(independent_arm.robot(), independent_arm.DECLARED, data), data)


@pytest.mark.parametrize(
    ("paths", "points", "most"), [(10, 10, 2.2e-5), pytest.param(200, 1, 3e-5, marks=pytest.mark.slow)]
)
def test_an_error_without_a_cause_is_corrected_between_the_poses(paths: int, points: int, most: float) -> None:
    result = traced_of_process(paths, points, SIZE, 1)
    assert [finding.effect for finding in result.findings] == ["joint_correction"]
    before, after = (stage.held_out.position.rms for stage in (result.before, result.after))
    assert NOISE_OF_PROCESS * np.sqrt(3.0) < after < most < 0.75 * before
    assert result.verdict == "partly_explained"
    assert any("no cause is named" in hint for hint in result.unexplained.hints)


def test_a_calibration_beside_a_process_fits_what_was_asked() -> None:
    """The joints of the compliance are searched, which needs the process that the arm has in place of one."""
    robot, rng = arm("ur10").robot, np.random.default_rng(0)
    data = simulate(robot, Plan(80, orientation=False, sampling="random")).data
    waves, sizes = rng.normal(scale=0.7, size=(30, 6)), 5e-4 * rng.normal(size=(6, 30))
    read = data.q + sizes @ np.cos(waves @ data.q + rng.uniform(0.0, 2.0 * np.pi, (30, 1)))
    position = predict(robot, replace(data, q=read)).translation + 2e-5 * rng.normal(size=(3, 80))
    data, fitted = replace(data, position=position), "base_frame,tool_frame,joint_offset,joint_compliance"
    names = {parameter.name.split(".")[0] for parameter in robacc.calibrate(data, robot=robot, fit=fitted).parameters}
    assert names <= {*fitted.split(",")}


@pytest.mark.parametrize("seed", some_fast(range(3), 3))
def test_white_noise_on_paths_is_no_process(seed: int) -> None:
    result = traced_of_process(10, 10, 0.0, seed)
    assert result.findings == ()
    assert result.verdict == "clean"


def test_the_correction_moves_the_position_along_measuring_axes_and_fades() -> None:
    robot = independent_arm.robot()
    turned = dataclasses.replace(robot, base=dataclasses.replace(robot.base, rpy=(0.3, -0.2, 1.0)))
    joints = [f"j{i}" for i in range(1, 7)]
    centre = [0.1, 0.2, -0.3, 0.4, 0.5, 0.0]
    effect = effect_class("joint_correction").from_settings(
        tuple(joints), {"lengths": [0.5] * 6, "centres": [centre], "moves": "position"}
    )
    q = np.array([centre, np.add(centre, [0.5, 0, 0, 0, 0, 0]), np.add(centre, 2.0)]).T
    data = Measurements(position=np.zeros((3, 3)), q=q)
    values = {"joint_correction.x.c1": 1e-3, "joint_correction.y.c1": 0.0, "joint_correction.z.c1": -2e-3}
    nominal = Model(Arm.of(turned)).bind(data).poses(np.zeros(0)).translation
    moved = Model(Arm.of(turned), known=(Known(effect, values),)).bind(data).poses(np.zeros(0)).translation
    share = np.exp(-0.5 * np.square([0.0, 2.0 * np.sin(0.25) / 0.5]))
    np.testing.assert_allclose((moved - nominal)[:, :2], np.outer([1e-3, 0.0, -2e-3], share), atol=1e-9)
    assert np.abs(moved - nominal)[:, 2].max() < 1e-9


def test_the_order_of_rows_does_not_matter() -> None:
    robot = dataclasses.replace(arm("puma560").robot, effects=())
    data = simulate(robot, Plan(60, seed=4, noise_position=2e-5, orientation=False)).data
    bound = Model.of(robot, [JointCompliance(("j2",))]).bind(data)
    theta = np.full(len(bound.terms), 5e-6)
    sag = bound.poses(theta).translation - bound.poses(0.0 * theta).translation
    # Ids keep each pose in its fold: without ids, the fold of a pose follows from its place.
    data = dataclasses.replace(data, position=data.position + sag, pose=np.arange(60).astype(str), rows=None)
    order = np.random.default_rng(1).permutation(60)
    first, second = (
        robacc.trace(rows, robot=robot, declared=("base_frame", "tool_frame", "joint_offset"))
        for rows in (data, data.subset(order))
    )
    assert [finding.effect for finding in first.findings] == ["joint_compliance"]
    values = [[p.value for finding in result.findings for p in finding.parameters] for result in (first, second)]
    assert values[1] == pytest.approx(values[0], rel=1e-9)
    assert second.after.held_out.position.rms == pytest.approx(first.after.held_out.position.rms, rel=1e-9)
    assert second.before.fitted.position.rms == pytest.approx(first.before.fitted.position.rms, rel=1e-9)


def test_a_part_of_many_readings_has_all_poses_whatever_their_order() -> None:
    """Of 1,000 poses with three targets, a search saw 133: a gear's error of five joints was found of 400."""
    rng = np.random.default_rng(0)
    data = Measurements(rng.standard_normal((3, 1800)), q=np.repeat(rng.standard_normal((6, 60)), 30, axis=1))
    part = random_rows(data, 400)
    assert len(part) == 400
    assert len(np.unique(part // 30)) == 60
    order = rng.permutation(1800)
    assert set(order[random_rows(data.subset(order), 400)]) == set(part)


def test_the_unit_of_the_file_does_not_matter(tmp_path: Path) -> None:
    robot = dataclasses.replace(arm("puma560").robot, effects=())
    data = simulate(robot, Plan(40, seed=5, noise_position=2e-5, orientation=False)).data
    texts = {}
    for unit, factor in (("m", 1.0), ("mm", 1e3)):
        # 17 digits: the same numbers in either unit, to rounding.
        lines = [
            ",".join(f"{value:.17g}" for value in (*q, *(factor * position)))
            for q, position in zip(data.q.T, data.position.T, strict=True)
        ]
        suffix = "" if unit == "m" else "_mm"
        heading = ",".join((*(f"q{i}" for i in range(1, 7)), *(f"{axis}{suffix}" for axis in "xyz")))
        texts[unit] = tmp_path / f"{unit}.csv"
        texts[unit].write_text("\n".join([heading, *lines]) + "\n", encoding="utf-8")
    results = [robacc.calibrate(texts[unit], robot=robot, fit=("base_frame", "joint_offset")) for unit in ("m", "mm")]
    values = [np.array([p.value for p in result.parameters]) for result in results]
    np.testing.assert_allclose(values[1], values[0], rtol=1e-9, atol=1e-13)


DECLARED_OF_SLIDES = "base_frame,tool_frame,joint_offset"


@pytest.mark.parametrize("order", some_fast([314.0, 12.0], 2))
def test_a_screw_is_named_with_its_period(order: float) -> None:
    """The larger order is above those that compete with every candidate."""
    nominal = dataclasses.replace(arm("stanford").robot, effects=())
    screw = {
        "effect": "transmission_error",
        "joints": ["j3"],
        "orders": [order],
        "values": {f"j3.cos{order:g}": 6e-5, f"j3.sin{order:g}": -8e-5},
    }
    robot = dataclasses.replace(nominal, effects=(screw,))
    data = simulate(robot, Plan(150, seed=4, noise_position=2e-5, orientation=False)).data
    result = robacc.trace(data, robot=nominal, declared=DECLARED_OF_SLIDES, folds=3)
    (finding,) = result.findings
    assert (finding.effect, finding.joints, result.verdict) == ("transmission_error", ("j3",), "explained")
    assert finding.settings["orders"] == pytest.approx([order], abs=0.5)
    amplitude = np.hypot(*(parameter.value for parameter in finding.parameters))
    assert amplitude == pytest.approx(1e-4, rel=0.15)
    assert {parameter.unit for parameter in finding.parameters} == {"m"}
    assert finding.harmonics == ()
    assert float(str(finding.statement).split()[1]) == pytest.approx(2e3 * np.pi / order, rel=0.02)


def test_a_slide_that_scatters_has_no_period() -> None:
    nominal = dataclasses.replace(arm("stanford").robot, effects=())
    exact = simulate(nominal, Plan(50, seed=2, noise_position=2e-5, orientation=False)).data
    q = exact.q.copy()
    q[2] += 6e-5 * np.random.default_rng(3).standard_normal(50)
    position = predict(nominal, dataclasses.replace(exact, q=q)).translation
    noise = 2e-5 * np.random.default_rng(5).standard_normal(position.shape)
    data = dataclasses.replace(exact, position=position + noise)
    assert robacc.trace(data, robot=nominal, declared=DECLARED_OF_SLIDES, folds=3).findings == ()


class EqualPlaces:
    """Held-out residuals that are next to equal with and without an effect."""

    def residuals(self, fitted: Fit, without: Any) -> list[Any]:
        """Return the residual, larger by a millionth where an effect is left out."""
        return [fitted.residual * (1.0 + 1e-6 * k) for k in range(len(without))]


def test_an_effect_that_predicts_next_to_nothing_is_useless() -> None:
    """A TIAGo's error was found to depend on the pose, by 1e-5 mm of 1.65 mm."""
    data = Measurements(position=independent_arm.targets(q := poses(10, 10, np.random.default_rng(0))), q=q)
    data = replace(data, position=data.position + 1e-5 * np.random.default_rng(1).standard_normal(data.position.shape))
    fitted = fit(model_of(independent_arm.robot(), "base_frame,joint_offset", data), data)
    one = Identified(fitted.model.free[-1], 0.0, 0.0, 0.0)
    assert _useless(fitted, [one], EqualPlaces()) == [one]
