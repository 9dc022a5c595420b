"""Estimates of poses: frames, registration, repetitions, and files read in parts."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any, NamedTuple

import independent_arm
import numpy as np
import pytest
from arms import arm
from sample_files import ROOT, saved
from scipy.spatial.transform import Rotation

import robacc
from robacc import InputError, Measurements, Robot, UsageError
from robacc.accuracy.error_sums import count_commands, smallest_hashes
from robacc.accuracy.estimation import EstimateResult, commanded_poses, estimate, moved_warning, pose_errors
from robacc.fitting.registration import align
from robacc.io.json_text import json_text
from robacc.modelling.model import predict, residuals
from robacc.simulation.simulate import Plan, simulate

N = 40
FRAMES = ("base_frame", "tool_frame")
ROBOT = independent_arm.robot()
LOW, HIGH = np.array(independent_arm.LIMITS).T[..., None]
NOISE = 1e-5


class Arm(NamedTuple):
    """An arm with errors ``(6, 4)`` of its table and of its joints, which vary once to three times a turn."""

    geometry: Any
    size: Any
    phase: Any
    order: Any

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> Arm:
        scale = 3e-4 * np.exp(rng.normal(0.0, 0.7, (6, 4)))
        waves = 2e-4 * rng.normal(size=(6, 1)), rng.uniform(0.0, 6.3, (6, 1)), rng.integers(1, 4, (6, 1))
        return cls(scale * rng.normal(size=(6, 4)), *waves)

    def poses(self, q: Any) -> tuple[Any, Any]:
        """Positions ``(3, N)`` and rotations ``(3, 3, N)`` of the target."""
        turned = q + self.size * np.sin(self.order * q + self.phase)
        pose = independent_arm.link_frames(turned, self.geometry)[-1]
        return (pose @ [*independent_arm.TOOL, 1.0])[:, :3].T, np.moveaxis(pose[:, :3, :3], 0, 2)


TABLE = np.array([row[:4] for row in independent_arm.DH])
NOMINAL = Arm(0.0, 0.0, 0.0, 0.0)


# Positions of order 1 carry rounding of some 1e-16 each; the last case has more poses than are computed at a time.
@pytest.mark.parametrize(
    ("size", "n", "atol"), [(1e-9, N, 3e-15), (1e-3, N, 2e-15), (0.5, N, 3e-15), (1e-3, 20_000, 1e-14)]
)
def test_errors_in_either_frame_are_those_put_in(size: float, n: int, atol: float) -> None:
    rng = np.random.default_rng(3)
    commanded, translation = Rotation.random(n, rng=rng), rng.normal(size=(n, 3))
    d, delta = rng.normal(scale=size, size=(2, n, 3))
    attained = commanded * Rotation.from_rotvec(delta)
    data = Measurements(
        position=(translation + commanded.apply(d)).T,
        rotation=np.moveaxis(attained.as_matrix(), 0, -1),
        commanded_position=translation.T,
        commanded_rotation=np.moveaxis(commanded.as_matrix(), 0, -1),
    )
    tool, base = (pose_errors(data, *commanded_poses(data, None), frame) for frame in ("tool", "base"))
    np.testing.assert_allclose(tool.position, d.T, atol=atol, rtol=0)
    np.testing.assert_allclose(tool.rotation, delta.T, atol=atol, rtol=0)
    np.testing.assert_allclose(base.position, data.position - data.commanded_position, atol=0)
    np.testing.assert_allclose(base.rotation, (attained * commanded.inv()).as_rotvec().T, atol=atol, rtol=0)


def test_the_robot_commands_the_pose_and_wins_over_the_file() -> None:
    rng = np.random.default_rng(5)
    q, d = rng.uniform(LOW, HIGH, (6, N)), rng.normal(scale=1e-3, size=(3, N))
    position, rotation = NOMINAL.poses(q)
    position = position + np.einsum("ijn,jn->in", rotation, d)
    data = Measurements(position=position, q=q, commanded_position=position)
    result = estimate(data, ROBOT)
    assert (result.commanded, result.orientation) == ("robot", None)
    assert any("the cmd_ columns count only without `robot`" in text for text in result.warnings)
    assert any("no orientation was measured" in note for note in result.notes)
    np.testing.assert_allclose(result.errors.position, d, atol=3e-15)
    np.testing.assert_allclose(estimate(data).errors.position, 0, atol=0)


def test_worst_poses_and_ties() -> None:
    size = np.array([1.0, 3.0, 2.0, 3.0, 0.5, 3.0, 4.0, 3.0, 3.0])
    data = Measurements(position=np.vstack((size, 0 * size, 0 * size)), commanded_position=np.zeros((3, size.size)))
    worst = estimate(data).worst_position
    assert [pose.line for pose in worst] == [7, 2, 4, 6, 8]
    assert [pose.position for pose in worst] == [4.0, 3.0, 3.0, 3.0, 3.0]
    assert {(pose.pose, pose.target, pose.orientation) for pose in worst} == {(None, None, None)}


def test_alignment_removes_the_frames_and_keeps_the_noise() -> None:
    rng = np.random.default_rng(8)
    q = rng.uniform(LOW, HIGH, (6, N))
    position, rotation = NOMINAL.poses(q)
    base, noise = Rotation.from_rotvec([0.3, -1.0, 2.0]).as_matrix(), rng.normal(scale=1e-5, size=(3, N))
    position = base @ position + np.array([[1.0], [2.0], [-0.5]]) + noise
    data = Measurements(position=position, rotation=np.einsum("ij,jkn->ikn", base, rotation), q=q)
    unaligned = estimate(data, ROBOT, align=())
    aligned = estimate(data, ROBOT, align=("base_frame",))
    assert any("frames that are not registered" in warning for warning in unaligned.too_large)
    assert aligned.alignment.n_parameters == 6
    assert aligned.warnings == aligned.too_large == ()
    assert aligned.unaligned.position.rms == pytest.approx(unaligned.position.rms, rel=1e-12)
    assert aligned.unaligned.orientation.max == pytest.approx(unaligned.orientation.max, rel=1e-12)
    # Six parameters of 3 N = 120 coordinates (orientations are exact): noise loses a few percent.
    assert np.sqrt(np.mean(aligned.errors.position**2)) == pytest.approx(1e-5, rel=0.15)


def test_frame_follows_the_commanded_orientation() -> None:
    zero, eye = np.zeros((3, 2)), np.repeat(np.eye(3)[..., None], 2, axis=2)
    full = Measurements(position=zero + 1e-3, rotation=eye, commanded_position=zero, commanded_rotation=eye)
    bare = estimate(dataclasses.replace(full, commanded_rotation=None))
    assert (bare.errors.frame, bare.orientation) == ("base", None)
    assert any("no orientation was commanded, so the errors are in the measuring frame" in note for note in bare.notes)
    assert [estimate(full, frame=frame).errors.frame for frame in (None, "base")] == ["tool", "base"]


@pytest.mark.parametrize(
    ("changes", "robot", "note"),
    [
        ({"sigma_position": np.full((3, 2), 2e-5 / np.sqrt(3))}, None, "0.02 mm rms"),
        (
            {"q": np.zeros((6, 2)), "commanded_position": None},
            dataclasses.replace(ROBOT, effects=({"effect": "joint_offset", "joints": ["j1"], "values": {"j1": 0.01}},)),
            "effects of the robot file are applied: joint_offset",
        ),
    ],
)
def test_notes_of_uncertainty_and_effects(changes: dict[str, Any], robot: Robot | None, note: str) -> None:
    data = Measurements(position=np.zeros((3, 2)), commanded_position=np.zeros((3, 2)))
    assert any(note in text for text in estimate(dataclasses.replace(data, **changes), robot).notes)


ZERO = Measurements(position=np.zeros((3, 2)), commanded_position=np.zeros((3, 2)))
JOINTS = np.zeros((6, 2))


@pytest.mark.parametrize(
    ("changes", "robot", "options", "message"),
    [
        ({}, None, {"frame": "tool"}, "frame tool needs the commanded orientation"),
        ({"commanded_position": None}, None, {}, "no commanded positions: give `commanded`, a robot program"),
        ({"commanded_position": None, "q": JOINTS}, None, {}, "the poses have no commanded positions: give `robot`"),
        ({"q": JOINTS}, ROBOT, {"align": ("backlash",)}, "cannot align backlash; choose among base_frame, tool_f"),
        (
            {},
            None,
            {"align": ("base_frame", "tool_frame")},
            r"add the columns cmd_qw.*or use `align` with base_frame a",
        ),
        ({}, None, {"align": ("backlash",)}, "cannot align backlash"),
        *(({}, None, {"confidence": wrong}, r"at least 0\.5 and less than 1") for wrong in (0.3, 1.0, float("nan"))),
        ({}, ROBOT, {}, r"no columns of commanded joints .* omit `robot`"),
    ],
)
def test_calls_that_do_not_fit(
    changes: dict[str, Any], robot: Robot | None, options: dict[str, Any], message: str
) -> None:
    with pytest.raises(InputError if robot and not options else UsageError, match=message):
        estimate(dataclasses.replace(ZERO, **changes), robot, **options)


def test_a_correction_used_outside_its_validity_range_gives_a_warning() -> None:
    puma = arm("puma560")
    correction = {"effect": "joint_correction", "joints": ["j3"], "drivers": ["j2"], "degree": 2}
    correction |= {"range": [[-1.0, 1.0]], "values": {"j3.j2.T2": 1e-4}}
    robot = dataclasses.replace(puma.robot, effects=(correction,))
    q = np.zeros((6, 5))
    q[1] = [-1.5, -1.01, 0.0, 1.0, 1.2]
    data = Measurements(position=np.zeros((3, 5)), q=q)
    data = dataclasses.replace(data, position=predict(robot, data).translation)
    (warning,) = [text for text in robacc.estimate(data, robot=robot).warnings if "validity range" in text]
    assert warning.startswith("2 of 5 poses are outside the validity range of the model")
    assert warning.endswith("joint_correction[j3] held at the end by j2, 2 poses up to 0.5 rad beyond [-1, 1]")
    inside = robacc.estimate(data.subset(np.arange(2, 4)), robot=robot).warnings
    assert not any("validity range" in text for text in inside)
    assert not any("validity range" in text for text in robacc.estimate(data, robot=puma.robot).warnings)


def test_frames_that_do_not_agree_are_registered_unless_the_call_says_no() -> None:
    robot = arm("puma560").robot
    data = simulate(dataclasses.replace(robot, effects=()), Plan(40, seed=3, noise_position=5e-5)).data
    moved = dataclasses.replace(data, position=data.position + np.array([[4.0], [-2.0], [0.5]]))
    found, raw = estimate(moved, robot), estimate(moved, robot, align=())
    assert found.alignment.effects == ("base_frame", "tool_frame")
    assert found.position.rms < 3 * 5e-5
    assert found.unaligned.position.rms == raw.position.rms == pytest.approx(np.linalg.norm([4.0, -2.0, 0.5]), rel=1e-3)
    # Errors that an arm may have are left as they are; what frames do not explain is told from what they leave.
    assert estimate(data, robot).alignment is None
    rng = np.random.default_rng(1)
    exchanged = dataclasses.replace(data, position=data.position[:, rng.permutation(data.n)])
    mixed = estimate(exchanged, robot)
    assert mixed.alignment is not None
    assert mixed.too_large[0].startswith("the errors are too large for an arm: check the units, the joint signs")


def test_an_estimate_names_the_mistake_that_a_trace_would_refuse() -> None:
    """Angles about fixed axes, read as a rotation vector, on an arm whose links are 3 % longer than its file says."""
    rng = np.random.default_rng(5)
    q = rng.uniform(0.3 * LOW, 0.3 * HIGH, (6, N)) + np.array([[0.0], [0.4], [0.6], [0.0], [-0.9], [0.0]])
    position, rotation = Arm(TABLE * [0.0, 0.03, 0.03, 0.0], 0.0, 0.0, 1).poses(q)
    angles = Rotation.from_matrix(np.moveaxis(rotation, 2, 0)).as_euler("xyz")
    misread = np.moveaxis(Rotation.from_rotvec(angles).as_matrix(), 0, 2)
    right, wrong = (robacc.estimate(Measurements(position, turned, q=q), robot=ROBOT) for turned in (rotation, misread))
    assert not any("seem" in text for text in right.warnings)
    said = next(text for text in wrong.warnings if "seem" in text)
    assert said.startswith("the orientations seem to be angles about the fixed axes x, y, z, read as a rotation vector")
    assert not any("too large for an arm" in text for text in wrong.warnings)


def test_one_wild_row_is_named_and_starts_no_search_for_mistakes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr("robacc.api.accuracy.check_data")
    data = robacc.read_poses("sample_data/poses.csv", robot="sample_data/robot.yaml")
    position, rotation = data.position.copy(), data.rotation
    position[0, 7] += 20.0
    if rotation is not None:
        rotation = rotation.copy()
        rotation[..., 7] = -rotation[..., 7] @ np.diag([1.0, 1.0, -1.0])
    wild = Measurements(position, rotation, q=data.q)
    (warning,) = robacc.estimate(wild, robot="sample_data/robot.yaml", align="base_frame,tool_frame").warnings
    assert "far beyond the other errors" in warning


SHIFT = np.array([[2.4e-3], [3.2e-3], [0.0]])


@pytest.mark.parametrize("align", ["base_frame,tool_frame", "none"])
def test_a_step_is_named_with_its_size_and_line(align: str) -> None:
    data = robacc.read_poses("sample_data/poses.csv", robot="sample_data/robot.yaml")
    position = data.position + np.where(np.arange(data.n) >= 35, SHIFT, 0.0)
    moved = Measurements(position, q=data.q)
    still = robacc.estimate(Measurements(data.position, q=data.q), robot="sample_data/robot.yaml", align=align)
    assert not any("moved" in text for text in still.warnings)
    (warning,) = robacc.estimate(moved, robot="sample_data/robot.yaml", align="base_frame,tool_frame").warnings
    assert warning.startswith("the errors change by 4")
    assert "at line 36, as if the instrument or the robot base had moved there" in warning


def test_commanded_poses_show_it_without_a_robot() -> None:
    rng = np.random.default_rng(0)
    commanded = rng.uniform(-1, 1, (3, 40))
    error = rng.normal(scale=3e-4, size=(3, 40)) + np.where(np.arange(40) >= 20, SHIFT, 0.0)
    (warning,) = robacc.estimate(Measurements(commanded + error, commanded_position=commanded)).warnings
    assert "at line 21, as if the instrument" in warning


def test_chance_gives_no_step() -> None:
    rng = np.random.default_rng(3)
    for n in (5, 20, 30, 200):
        for _ in range(50):
            error = rng.normal(size=(3, n)) * rng.lognormal(size=n)
            assert moved_warning(Measurements(np.zeros((3, n))), error) == ()


def test_two_positions_in_another_frame_have_no_figure() -> None:
    commanded = np.array([[0.0, 0.5], [0.0, 0.2], [1.0, 0.7]])
    far = Measurements(commanded + 2.0, commanded_position=commanded)
    with pytest.raises(
        robacc.InputError, match=r"2 positions whose errors, 3\.46e\+03 mm rms, .* registration needs more"
    ):
        robacc.estimate(far)
    assert robacc.estimate(far, align="none").position.rms == pytest.approx(2.0 * np.sqrt(3))
    near = Measurements(commanded + 1e-4, commanded_position=commanded)
    assert robacc.estimate(near).position.rms == pytest.approx(1e-4 * np.sqrt(3))


def measured(arm: Arm, q: Any, rng: np.random.Generator, turned: bool) -> Measurements:
    position, rotation = arm.poses(q)
    noise = Rotation.from_rotvec(rng.normal(scale=NOISE, size=(q.shape[1], 3))).as_matrix()
    return Measurements(
        position=position + rng.normal(scale=NOISE, size=position.shape),
        rotation=np.einsum("nij,jkn->ikn", noise, rotation) if turned else None,
        q=q,
    )


def true_rms(result: EstimateResult, arm: Arm, rng: np.random.Generator) -> tuple[float, float]:
    """Rms of position and orientation error of the registered nominal model at fresh poses."""
    q = rng.uniform(LOW, HIGH, (6, 1500))
    base, tool = result.alignment.robot.base, result.alignment.robot.tool
    place, turn = NOMINAL.poses(q)
    turn_base, turn_tool = (Rotation.from_euler("xyz", frame.rpy).as_matrix() for frame in (base, tool))
    shift = np.array(tool.xyz) - independent_arm.TOOL
    predicted = np.array(base.xyz)[:, None] + turn_base @ (place + np.einsum("ijn,j->in", turn, shift))
    position, rotation = arm.poses(q)
    apart = np.einsum("ijn,kjn->nik", rotation, np.einsum("ij,jkn,kl->iln", turn_base, turn, turn_tool))
    lengths = np.linalg.norm(position - predicted, axis=0), Rotation.from_matrix(apart).magnitude()
    # The noise of a fresh measurement is part of a fresh error.
    return tuple(float(np.sqrt(np.mean(length**2) + 3 * NOISE**2)) for length in lengths)  # type: ignore[return-value]


def ratios(n: int, turned: bool, arms: int) -> Any:
    """Lower limit, figure, upper limit and upper bound of the rms over the true rms, ``(arms or 2 arms, 4)``."""
    rows = []
    for seed in range(arms):
        rng = np.random.default_rng([n, seed])
        arm = Arm.drawn(rng)
        result = estimate(measured(arm, rng.uniform(LOW, HIGH, (6, n)), rng, turned), ROBOT, align=FRAMES)
        for statistics, true in zip((result.position, result.orientation), true_rms(result, arm, rng), strict=True):
            if statistics is not None:
                interval = statistics.intervals.rms
                rows.append(np.array([interval.lower, statistics.rms, interval.upper, interval.upper_bound]) / true)
    return np.array(rows)


@pytest.mark.parametrize("turned", [False, True], ids=["positions", "poses"])
def test_held_out_errors_are_those_of_refits(turned: bool) -> None:
    rng = np.random.default_rng(5)
    q = rng.uniform(LOW, HIGH, (6, 9))[:, [0, 1, 2, 3, 4, 5, 6, 7, 8, 2, 2]]
    data = measured(Arm.drawn(rng), q, rng, turned)
    if turned:
        # Stated noise above the errors, so that a refit weighs position against orientation as the fit does.
        sigma = np.full(q.shape[1], 0.01)
        data = dataclasses.replace(data, sigma_position=np.tile(sigma, (3, 1)), sigma_rotation=sigma)
    found = align(ROBOT, data, FRAMES, held_out=True)
    errors = residuals(data, found.commanded)
    for rows in ([0], [5], [2, 9, 10]):
        others, own = data.subset(np.setdiff1d(np.arange(11), rows)), data.subset(np.array(rows))
        refitted = residuals(own, predict(align(ROBOT, others, FRAMES).robot, own))
        # First order in errors of 1 mm and 1 mrad.
        np.testing.assert_allclose(errors[:, rows], refitted, atol=1e-5)
    assert found.share == pytest.approx(1.0 - (12 / 54 if turned else 9 / 27))


def test_the_rms_of_few_registered_poses_is_that_of_fresh_poses() -> None:
    """With residuals and without counting parameters, 89 % of the upper limits were too low at 5 poses, 53 % at 12."""
    for n, tolerance in ((5, 0.4), (12, 0.1)):
        found = ratios(n, False, 40)
        assert np.median(found[:, 1]) == pytest.approx(1.0, abs=tolerance)
        # A limit that is missed with probability 2.5 % is missed 5 times of 40 with probability 0.003.
        assert np.sum(found[:, 2] < 1.0) <= 4
        assert np.sum(found[:, 0] > 1.0) <= 4


Q = np.random.default_rng(7).uniform(LOW, HIGH, (6, 4))
BASE = ("base_frame",)


@pytest.mark.parametrize(
    ("rows", "turned", "frames", "message"),
    [
        (
            [0],
            False,
            FRAMES,
            "1 commanded position, 3 numbers measured: the 9 .* need 12; measure at least 4 positions",
        ),
        ([0, 1], False, FRAMES, "2 commanded positions, 6 numbers .*: the 9 .* need 12; measure at least 4 positions"),
        (
            [0, 1, 2],
            False,
            FRAMES,
            "3 commanded positions, 9 numbers .*: the 9 .* need 12; measure at least 4 positions",
        ),
        ([0, 1], True, FRAMES, "at least 3 poses, register base_frame alone, or state .* omit `align`"),
        # Repetitions add no components.
        ([0, 1, 0, 1, 1], False, BASE, "2 commanded positions, 6 numbers .* at least 3 positions, or state"),
        ([0, 1, 2], False, BASE, "the other poses do not determine the fitted frames without the pose of line"),
    ],
)
def test_too_few_components_are_an_error(rows: list[int], turned: bool, frames: tuple[str, ...], message: str) -> None:
    data = measured(NOMINAL, Q[:, rows], np.random.default_rng(7), turned)
    with pytest.raises(InputError, match=message):
        estimate(data, ROBOT, align=frames)
    commanded = Measurements(position=Q[:3, :2], commanded_position=Q[:3, :2])
    with pytest.raises(InputError, match=r"2 commanded positions, 6 numbers measured: the 6 parameters"):
        estimate(commanded, align=BASE)


ROBOT_OF_IN_PARTS = str(ROOT / "sample_data" / "robot.yaml")
BIN = 1 / 4096
"""Relative width of a bin of lengths, the most by which a quantile may differ."""


def in_parts(monkeypatch: pytest.MonkeyPatch, size: int = 1 << 15) -> None:
    """Take every file for a large one, of which a part has some two hundred poses."""
    for name, value in (("LARGE", 1), ("_PART", size), ("_SAMPLES", 40), ("_SAMPLE", 1 << 10)):
        monkeypatch.setattr(f"robacc.io.table.{name}", value)


def simulated(path: Path, robot: str = ROBOT_OF_IN_PARTS, n: int = 2000, **options: object) -> str:
    plan = robacc.simulate(robot, poses=n, seed=3, noise="0.1mm", **options)  # type: ignore[arg-type]
    path.write_text(plan.csv(), encoding="utf-8")
    return str(path)


def check_same(whole: robacc.Estimate, parts: robacc.Estimate, fitted: bool = False) -> None:
    """Check every figure; frames that are fitted to some 300 of the poses add their uncertainty to all errors."""
    near = 0.15 if fitted else 1e-12
    assert any("was read in" in note for note in parts.notes)
    assert parts.n_poses == whole.n_poses
    for one, other in ((whole.position, parts.position), (whole.orientation, parts.orientation)):
        if one is None or other is None:
            assert one is other
            continue
        scale = one.rms
        assert (one.n, one.n_poses) == (other.n, other.n_poses)
        assert other.mean == pytest.approx(one.mean, abs=near * scale)
        assert other.covariance == pytest.approx(one.covariance, abs=near * scale**2)
        assert other.centred_covariance == pytest.approx(one.centred_covariance, abs=near * scale**2)
        for name in ("rms", "mean_error", "max"):
            assert getattr(other, name) == pytest.approx(getattr(one, name), rel=near), name
        assert other.p95 == pytest.approx(one.p95, rel=near + BIN + 4.0 / one.n)
        for name in ("rms", "mean_error", "p95"):
            # Groups of commands are as good as the commands: a standard error from 2000 poses has one of 1.6 per cent.
            mine, its = (getattr(each.intervals, name) for each in (one, other))
            assert its.upper - its.lower == pytest.approx(mine.upper - mine.lower, rel=0.5 if fitted else 0.12), name
    lines = [[pose.line for pose in each.worst_position] for each in (whole, parts)]
    assert fitted or lines[0] == lines[1]
    assert [each.name for each in parts.targets] == [each.name for each in whole.targets]
    assert parts.grade.grade == whole.grade.grade


@pytest.mark.parametrize("align", [None, ("base_frame", "tool_frame")])
def test_an_estimate_in_parts_is_that_of_the_whole_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, align: tuple[str, ...] | None
) -> None:
    path = simulated(tmp_path / "poses.csv")
    whole = robacc.estimate(path, robot=ROBOT_OF_IN_PARTS, align=align)
    in_parts(monkeypatch)
    parts = robacc.estimate(path, robot=ROBOT_OF_IN_PARTS, align=align)
    check_same(whole, parts, fitted=align is not None)
    # All rows, in their order.
    rows = [[line.split(",") for line in each.per_pose_csv().splitlines()] for each in (whole, parts)]
    assert [row[:2] for row in rows[0]] == [row[:2] for row in rows[1]]
    lengths = np.array([[float(row[5]) for row in each[1:]] for each in rows])
    assert lengths[1] == pytest.approx(lengths[0], abs=1e-15 if align is None else 0.3 * whole.position.rms)


TRUE_ARM = str(ROOT / "sample_data" / "trace" / "truth.yaml")
REPEATED = {"cycles": 4, "motion": True, "time_step": 5.0, "temperature": (20.0, 30.0)}
COMMANDED = {"commanded": True, "noise_orientation": "0.01deg"}


@pytest.mark.parametrize(
    ("robot", "n", "made", "call"),
    [
        (TRUE_ARM, 600, REPEATED, {"robot": TRUE_ARM}),
        (ROBOT_OF_IN_PARTS, 2000, COMMANDED, {"align": ("base_frame",)}),
        (ROBOT_OF_IN_PARTS, 300, {}, {"robot": ROBOT_OF_IN_PARTS}),
    ],
    ids=["repetitions, effects and circumstances", "commands of the file", "few poses"],
)
def test_files_with_a_byte_order_mark_are_read_in_parts(
    robot: str, n: int, made: dict[str, Any], call: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = Path(simulated(tmp_path / "poses.csv", robot, n, **made))
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())
    whole = robacc.estimate(str(path), **call)
    in_parts(monkeypatch)
    parts = robacc.estimate(str(path), **call)
    check_same(whole, parts, fitted="align" in call)
    assert ("read in parts" in parts.position.structure.text) == ("cycles" in made)


def test_a_wrong_number_is_named_with_its_line_in_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = Path(simulated(tmp_path / "poses.csv"))
    lines = path.read_text(encoding="utf-8").split("\n")
    lines[1500] = lines[1500].replace(",", ",x", 1)
    path.write_text("\n".join(lines), encoding="utf-8")
    in_parts(monkeypatch)
    with pytest.raises(InputError, match=r"poses\.csv:1501, q2: found 'x"):
        robacc.estimate(str(path), robot=ROBOT_OF_IN_PARTS)


def test_a_reading_far_beyond_the_others_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = Path(simulated(tmp_path / "poses.csv"))
    lines = path.read_text(encoding="utf-8").split("\n")
    cells = lines[1500].split(",")
    cells[6] = str(float(cells[6]) + 0.02)
    lines[1500] = ",".join(cells)
    path.write_text("\n".join(lines), encoding="utf-8")
    whole = robacc.estimate(str(path), robot=ROBOT_OF_IN_PARTS)
    in_parts(monkeypatch)
    for result in (whole, robacc.estimate(str(path), robot=ROBOT_OF_IN_PARTS)):
        (warning,) = (text for text in result.warnings if "far beyond" in text)
        assert "line 1501 (" in warning
        assert " more;" not in warning


def test_a_file_in_an_object_store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fsspec = pytest.importorskip("fsspec")
    path = simulated(tmp_path / "poses.csv", n=300)
    with fsspec.open("memory://poses.csv", "wb") as stream:
        stream.write(Path(path).read_bytes())
    whole = robacc.estimate("memory://poses.csv", robot=ROBOT_OF_IN_PARTS)
    assert whole.position.rms == robacc.estimate(path, robot=ROBOT_OF_IN_PARTS).position.rms
    in_parts(monkeypatch)
    check_same(whole, robacc.estimate("memory://poses.csv", robot=ROBOT_OF_IN_PARTS))


def test_what_is_not_of_the_documented_form_is_read_as_a_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = Path(simulated(tmp_path / "poses.csv", n=100))
    semicolons = saved(tmp_path / "semicolons.csv", path.read_text(encoding="utf-8").replace(",", ";"))
    in_parts(monkeypatch)
    assert not any("was read in" in note for note in robacc.estimate(str(semicolons), robot=ROBOT_OF_IN_PARTS).notes)


@pytest.mark.parametrize("count", [1, 60, 20_000, 600_000])
def test_different_commands_are_counted(count: int) -> None:
    rng = np.random.default_rng(count)
    hashes = rng.integers(0, 2**64, size=count, dtype=np.uint64)
    parts = [smallest_hashes(rng.permutation(hashes)) for _ in range(3)]
    # Its standard error is 0.14 per cent, and nought for few commands.
    assert count_commands(smallest_hashes(*parts), 3 * count) == pytest.approx(count, rel=0.006, abs=0.5)
    assert count_commands(parts[0], count) == count


def test_a_calibration_in_parts_is_that_of_all_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    truth, robot = (str(ROOT / "sample_data" / "trace" / f"{name}.yaml") for name in ("truth", "robot"))
    path = simulated(tmp_path / "poses.csv", truth, 900, position_only=True)
    fit = "base_frame,tool_frame,joint_offset,link_geometry,joint_compliance[j2],backlash[j3]"
    whole = robacc.calibrate(path, robot=robot, fit=fit, shrink=False)
    in_parts(monkeypatch)
    one, two = (robacc.calibrate(path, robot=robot, fit=fit, shrink=False, jobs=jobs) for jobs in (1, 2))
    assert json_text(one.document()) == json_text(two.document())
    assert any("coefficients are fitted to all rows" in text for text in one.warnings)
    assert one.fit.data.n < 500 < whole.fit.data.n
    mine, its = ({each.name: each for each in result.parameters} for result in (whole, one))
    for name, each in mine.items():
        if each.std:
            # The same rows, other weights; one without a structure, so its standard error is that of independent noise.
            assert its[name].value == pytest.approx(each.value, abs=0.1 * each.std), name
            assert 0.6 * each.std < its[name].std < 3.0 * each.std, name
    assert one.after.held_out_rms == pytest.approx(whole.after.held_out_rms, rel=0.15)


def test_a_trace_in_parts_names_the_effects_and_fits_all_rows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    truth, robot = (str(ROOT / "sample_data" / "trace" / f"{name}.yaml") for name in ("truth", "robot"))
    path = simulated(tmp_path / "poses.csv", truth, 1500, position_only=True)
    in_parts(monkeypatch)
    declared = "base_frame,tool_frame,joint_offset,link_geometry"
    result = robacc.trace(path, robot=robot, declared=declared)
    compliance, backlash = result.findings
    assert (compliance.effect, compliance.joints) == ("joint_compliance", ("j2",))
    # Some three hundred poses do not tell a backlash from its nearest likeness.
    assert ("backlash", ("j3",)) in {(each.effect, each.joints) for each in (backlash, *backlash.alternatives)}
    assert len(result.fit_inputs.parts) > 5


def test_distances_are_those_of_all_pairs_wherever_the_base_is() -> None:
    """By two loops over an arm that is 200 ppm too long and turned and moved away, against the same arm in place."""
    rng = np.random.default_rng(3)
    commanded = rng.uniform(-0.6, 0.6, (3, 25))
    place = Rotation.from_euler("xyz", (0.3, -0.8, 2.0)).as_matrix()
    noise = 2e-5 * rng.normal(size=commanded.shape)
    true = {(i, j): (np.linalg.norm(commanded[:, i] - commanded[:, j]), i, j) for i in range(25) for j in range(i)}
    results = []
    for turned, moved in ((np.eye(3), 0.0), (place, 0.4)):
        measured = turned @ ((1.0 + 2e-4) * commanded + noise) + moved
        data = Measurements(position=measured, commanded_position=commanded)
        results.append(estimate(data, align=() if moved == 0.0 else None).distances)
    found, elsewhere = results
    measured = (1.0 + 2e-4) * commanded + noise
    errors = {
        pair: np.linalg.norm(measured[:, pair[0]] - measured[:, pair[1]]) - size for pair, (size, *_) in true.items()
    }
    largest = max(errors, key=lambda pair: abs(errors[pair]))
    assert found["n_pairs"] == len(errors) == sum(band["n_pairs"] for band in found["bands"])
    assert found["rms_m"] == pytest.approx(np.sqrt(np.mean(np.square([*errors.values()]))), rel=1e-9)
    assert found["max_m"] == pytest.approx(abs(errors[largest]), rel=1e-9)
    assert found["between"] == tuple(data.place(end) for end in sorted(largest))
    assert found["distance_m"] == pytest.approx(true[largest][0], rel=1e-12)
    assert found["scale"] == pytest.approx(2e-4, abs=3e-5)
    assert [band["up_to_m"] for band in found["bands"]] == sorted(band["up_to_m"] for band in found["bands"])
    assert found["bands"][-1]["rms_m"] > 2.0 * found["bands"][0]["rms_m"]
    assert elsewhere["rms_m"] == pytest.approx(found["rms_m"], rel=1e-6)


def test_one_pose_has_no_distances() -> None:
    """Nor have visits of one commanded pose."""
    position = np.array([[0.1, 0.1], [0.2, 0.2], [0.3, 0.3]])
    assert estimate(Measurements(position=position + 1e-5, commanded_position=position)).distances is None


def test_a_commanded_orientation_tells_poses_at_one_place_apart() -> None:
    rng = np.random.default_rng(3)
    place = np.repeat(rng.uniform(-0.5, 0.5, (3, 4)), 3, axis=1)
    turn = np.moveaxis(Rotation.random(12, random_state=4).as_matrix(), 0, 2)
    data = Measurements(place, turn, commanded_position=place, commanded_rotation=turn)
    twice = data.subset(np.tile(np.arange(12), 2))
    groups = twice.groups().reshape(2, 12)
    assert np.array_equal(*groups)
    assert np.unique(groups).size == 12
    assert dataclasses.replace(twice, commanded_rotation=None).groups().max() == 3


def test_measured_orientations_say_nothing_of_the_frames_of_commanded_positions() -> None:
    rng = np.random.default_rng(5)
    commanded, base = rng.uniform(-0.5, 0.5, (3, 20)), Rotation.from_euler("xyz", (3, -2, 71), degrees=True)
    position = base.apply(commanded.T).T + np.array([[2.0], [-1.0], [0.5]]) + 1e-5 * rng.normal(size=(3, 20))
    turn = np.moveaxis(Rotation.random(20, random_state=6).as_matrix(), 0, 2)
    data = Measurements(position, commanded_position=commanded)
    found = [robacc.estimate(each).position.rms for each in (data, dataclasses.replace(data, rotation=turn))]
    assert found[1] == pytest.approx(found[0])
    assert found[0] < 3e-5
