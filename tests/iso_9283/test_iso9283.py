"""ISO 9283: criteria, intervals, protocol, and the poses of the standard."""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from arms import CONFIGS, CONFIGURED, arm
from commands import missing
from scipy import stats
from scipy.spatial.transform import Rotation
from slow_parameters import some_fast

from robacc import InputError, Measurements, Robot, UsageError, read_robot
from robacc.accuracy.estimation import commanded_poses
from robacc.geometry import Poses, compose, log_so3, transpose
from robacc.iso_9283 import criteria as estimates
from robacc.iso_9283.criteria import (
    DELTA,
    Characteristic,
    characteristic,
    distance,
    drift,
    position_repeatability,
    repeatability,
    visits_of,
)
from robacc.iso_9283.evaluation import (
    ORIENTATIONS,
    PLANES,
    corners,
    fit_cube,
    five_points,
    iso9283,
    planned_poses,
    propose,
    protocol,
)
from robacc.measurements import motion_between_rows
from robacc.robots.arm import Arm, inverse_kinematics, joint_ranges
from robacc.robots.description import Frame

MM = 1e-3


def data(visits: dict[str, list[list[float]]], commanded: dict[str, list[float]] | None = None) -> Measurements:
    """Visits of named poses in mm, cycle after cycle."""
    rows = [
        (name, cycle) for cycle in range(max(map(len, visits.values()))) for name in visits if cycle < len(visits[name])
    ]
    commanded_positions = None
    if commanded is not None:
        commanded_positions = np.array([commanded[name] for name, _ in rows], dtype=float).T * MM
    return Measurements(
        position=np.array([visits[name][cycle] for name, cycle in rows], dtype=float).T * MM,
        commanded_position=commanded_positions,
        pose=np.array([name for name, _ in rows]),
        cycle=np.array([str(cycle + 1) for _, cycle in rows]),
    )


def random_cycles(seed: int, poses: int = 5, cycles: int = 8, oriented: bool = True) -> Measurements:
    """Cycles with an offset and scatter of their own at each pose; orientations all round the sphere."""
    rng = np.random.default_rng(seed)
    index = np.tile(np.arange(poses), cycles)
    places = rng.uniform(-0.5, 0.5, (3, poses))
    turns = Rotation.from_euler(
        "ZYX", np.column_stack([rng.uniform(-3.1, 3.1, poses), rng.uniform(-1.2, 1.2, poses), [math.pi] * poses])
    )
    noise = rng.normal(scale=1e-4, size=(3, index.size)) * rng.uniform(0.3, 2, (1, poses))[:, index]
    spin = Rotation.from_rotvec(rng.normal(scale=2e-4, size=(index.size, 3)))
    attained = spin * turns[index]
    return Measurements(
        position=places[:, index] + 3e-4 + noise,
        rotation=np.moveaxis(attained.as_matrix(), 0, -1) if oriented else None,
        commanded_position=places[:, index],
        commanded_rotation=np.moveaxis(turns[index].as_matrix(), 0, -1) if oriented else None,
        pose=np.array([f"P{i + 1}" for i in index]),
        cycle=np.repeat(np.arange(cycles), poses).astype(str),
        direction=np.where(np.arange(index.size) // poses % 2, 1.0, -1.0)[None, :].repeat(2, axis=0),
    )


def values(characteristic: Characteristic) -> dict[str, float]:
    return {"–".join(place.poses): place.position.value or 0.0 for place in characteristic.places}


ORIGIN = {"P1": [0, 0, 0]}
CROSS = [data({"P1": [[3, 2, 0], [1, 2, 0], [2, 5, 0], [2, -1, 0]]}, ORIGIN)]
STRETCH = {"P1": [[0, 0, 0], [0.1, 0, 0], [0, 0, 0]], "P2": [[100.1, 0, 0], [100.3, 0, 0], [100, 0, 0]]}
LOST = data({"P1": [[0, 0, 0], [9, 0, 0], [0, 0, 0]], "P2": [[10, 0, 0], [10, 0, 0], [12, 0, 0]]})
LOST = LOST.subset(np.flatnonzero((LOST.pose != "P1") | (LOST.cycle != "2")))
WAYS = np.array([[1, 1, -1, -1, 0, 0], [1, 1, 1, 1, -1, -1]], dtype=float)
APPROACHED = data({"P1": [[0, 0, 1], [0, 0, -1], [3, 4, 1], [3, 4, -1], [0, 4, 1], [0, 4, -1]]})
WINDOWS = data({"P1": [[1, -1, 0], [1, 0, 0], [1, 1, 0], [3, -2, 0], [3, 0, 0], [3, 2, 0]]}, ORIGIN)
SHUFFLED = dataclasses.replace(WINDOWS, time=np.arange(6.0)).subset(np.array([3, 0, 4, 1, 5, 2]))
DRIFTED = {"dAP": 2.0, "dRP": 2 / 3 + 3 * math.sqrt(1 / 3), "shift": 2.0}
CIRCLE = data({"P1": [[1, 0, 0.1], [1, 0, -0.1], [1, 0, 0], [-1, 0, 0.1], [-1, 0, -0.1], [-1, 0, 0]]}, ORIGIN)
ROBOTS = [
    dataclasses.replace(data({"P1": [[x, y, 1], [x, y, -1]]}, ORIGIN), source=f"/somewhere/{name}.csv")
    for name, x, y in (("a", 0, 0), ("b", 3, 4), ("c", 0, 4))
]


@pytest.mark.parametrize(
    ("files", "windows", "expected"),
    [
        # Visits ±1 along x and ±3 along y about (2, 2, 0): l = 1, 1, 3, 3.
        pytest.param(CROSS, None, {"AP": math.sqrt(8), "RP": 2 + 3 * math.sqrt(4 / 3)}, id="one pose"),
        # D = 100.1, 100.2, 100.0 for 100, and for 101.
        pytest.param(
            [data(STRETCH, {"P1": [0, 0, 0], "P2": [100, 0, 0]})], None, {"AD": 0.1, "RD": 0.3}, id="distance"
        ),
        pytest.param([data(STRETCH, {"P1": [0, 0, 0], "P2": [101, 0, 0]})], None, {"AD": 0.9}, id="shorter distance"),
        # The second cycle of P1 was lost: D of cycles 1 and 3 remain.
        pytest.param([LOST], None, {"RD": 3 * math.sqrt(2)}, id="matched by cycle"),
        # From below the barycentre is (0, 0, 0), from above (3, 4, 0), from aside (0, 4, 0).
        pytest.param([dataclasses.replace(APPROACHED, direction=WAYS)], None, {"vAP": 5.0}, id="approaches"),
        # First window about (1, 0, 0) with y = -1, 0, 1, second about (3, 0, 0) with y = -2, 0, 2.
        pytest.param([WINDOWS], 2, DRIFTED, id="drift"),
        pytest.param([SHUFFLED], 2, DRIFTED, id="drift by time"),
        # Half a circle round the command: AP stands, the barycentre has moved by twice AP.
        pytest.param([CIRCLE], 2, {"dAP": 0.0, "shift": 2.0}, id="shift"),
        # Barycentres at (0, 0, 0), (3, 4, 0), (0, 4, 0).
        pytest.param(ROBOTS, None, {"E": 5.0, "AP": 5.0}, id="exchangeability"),
    ],
)
def test_criteria_by_hand(files: list[Measurements], windows: int | None, expected: dict[str, float]) -> None:
    result = iso9283(files, windows=windows)
    found = {symbol: result.characteristic(symbol).position.value / MM for symbol in expected}
    assert found == pytest.approx(expected, rel=1e-9, abs=1e-12)


def test_what_stands_beside_the_criteria() -> None:
    accuracy, repeatability = (iso9283(CROSS).characteristic(symbol) for symbol in ("AP", "RP"))
    assert [figure.value for figure in accuracy.places[0].axes or ()] == pytest.approx([2 * MM, 2 * MM, 0], abs=1e-15)
    (place,) = repeatability.places
    assert (place.mean_distance, place.sd_distance) == pytest.approx((2 * MM, math.sqrt(4 / 3) * MM))
    assert (accuracy.clause, repeatability.clause, accuracy.position_at) == ("7.2.1", "7.2.2", "P1")
    shorter = iso9283([data(STRETCH, {"P1": [0, 0, 0], "P2": [101, 0, 0]})]).characteristic("AD")
    assert (shorter.places[0].position.value, shorter.position_at) == (pytest.approx(-0.9 * MM, rel=1e-9), "P1–P2")
    assert iso9283([LOST]).characteristic("RD").places[0].n == 2
    approaches = iso9283([dataclasses.replace(APPROACHED, direction=WAYS)]).characteristic("vAP")
    assert (approaches.clause, approaches.places[0].between) == ("7.2.3", "−+ and ++")
    assert iso9283([SHUFFLED], windows=2).characteristic("dAP").notes == (
        "2 windows of 3 visits, by time_s, the first and the last 0.05 min apart; each against the first",
    )
    assert any("the robot drifted during the run" in note for note in iso9283([CIRCLE], windows=2).notes)
    robots = iso9283(ROBOTS)
    assert robots.characteristic("E").places[0].between == "a.csv and b.csv"
    assert robots.characteristic("AP").position_at == "P1 of b.csv"


def test_files_of_the_same_name_get_unique_names() -> None:
    measured = dataclasses.replace(data({"P1": [[0, 0, 0], [1, 0, 0]]}), source="poses.csv")
    assert iso9283([measured, measured]).sources == ("poses.csv (1)", "poses.csv (2)")


def test_exchangeability_needs_the_same_commands() -> None:
    first, second = (data({"P1": [[0, 0, 0], [0, 0, 1]]}, {"P1": [x, 0, 0]}) for x in (0, 2))
    result = iso9283([first, second]).characteristic("E")
    assert result.position.value is None
    assert "is commanded 2 mm from that of" in str(result.position.interval.why)
    other_names = iso9283([first, data({"Q": [[0, 0, 0]]}, {"Q": [0, 0, 0]})]).characteristic("E")
    assert other_names.position.interval.why == "the files share no commanded pose"


@pytest.mark.parametrize("seed", range(3))
def test_angles_against_scipy_with_roll_at_half_a_turn(seed: int) -> None:
    """Roll is pi: each visit's angle jumps by a turn as the noise has it, and the means must not."""
    measured = random_cycles(seed)
    result = iso9283([measured])
    attained, commanded = (
        Rotation.from_matrix(np.moveaxis(turn, -1, 0)).as_euler("ZYX")[:, ::-1]
        for turn in (measured.rotation, measured.commanded_rotation)
    )
    assert np.ptp(attained[:, 0]) > 6.0
    deviation = (attained - commanded + math.pi) % (2 * math.pi) - math.pi
    for accuracy, scatter in zip(result.characteristic("AP").places, result.characteristic("RP").places, strict=True):
        rows = measured.pose == accuracy.poses[0]
        expected = deviation[rows].mean(axis=0)
        assert [figure.value for figure in accuracy.angles or ()] == pytest.approx(expected.tolist(), abs=1e-12)
        three_std = 3 * deviation[rows].std(axis=0, ddof=1)
        assert [figure.value for figure in scatter.angles or ()] == pytest.approx(three_std.tolist(), rel=1e-9)
    largest = max(
        abs(figure.value or 0) for place in result.characteristic("AP").places for figure in place.angles or ()
    )
    assert result.characteristic("AP").angle.value == pytest.approx(largest)


def test_angles_next_to_the_pole_are_turns_about_the_axes() -> None:
    """Pitch of 90 degrees: roll and yaw mean nothing there, the turn from command to attained does."""
    rng = np.random.default_rng(0)
    spin = np.add(rng.normal(scale=1e-4, size=(10, 3)), [1e-3, -2e-3, 3e-3])
    level = Rotation.from_euler("y", 90, degrees=True)
    measured = dataclasses.replace(
        data({"P1": [[0, 0, i] for i in range(10)]}, {"P1": [0, 0, 0]}),
        rotation=np.moveaxis((Rotation.from_rotvec(spin) * level).as_matrix(), 0, -1),
        commanded_rotation=np.repeat(level.as_matrix()[..., None], 10, axis=2),
    )
    result = iso9283([measured])
    angles = [figure.value for figure in result.characteristic("AP").places[0].angles or ()]
    assert angles == pytest.approx(spin.mean(axis=0).tolist(), abs=1e-12)
    assert any("roll and yaw are not defined" in note for note in result.notes)


def test_angles_half_a_turn_apart_keep_their_distance() -> None:
    """AD_a of two poses half a turn apart: |a1 - a2| scatters about pi, and never from plus to minus."""
    noise = np.random.default_rng(1).normal(scale=1e-3, size=8)
    angles = np.concatenate([[math.pi / 2 + noise[i], -math.pi / 2] for i in range(8)])
    visits = data({"P1": [[0, 0, 0]] * 8, "P2": [[100, 0, 0]] * 8}, {"P1": [0, 0, 0], "P2": [100, 0, 0]})
    commanded_angles = np.tile([math.pi / 2, -math.pi / 2], 8)
    measured = dataclasses.replace(
        visits,
        rotation=np.moveaxis(Rotation.from_euler("z", angles[:, None]).as_matrix(), 0, -1),
        commanded_rotation=np.moveaxis(Rotation.from_euler("z", commanded_angles[:, None]).as_matrix(), 0, -1),
    )
    result = iso9283([measured])
    accuracy = (result.characteristic("AD").places[0].angles or ())[2].value
    assert accuracy == pytest.approx(noise.mean(), abs=1e-9)
    assert (result.characteristic("RD").places[0].angles or ())[2].value == pytest.approx(
        3 * noise.std(ddof=1), rel=1e-6
    )


ONCE = "one visit has no scatter to estimate an interval from"
UNKNOWN = "the commanded poses are not known: give `robot`, or columns cmd_x, cmd_y, cmd_z"
KNOWN = random_cycles(0)
WITHOUT_COMMAND = dataclasses.replace(KNOWN, commanded_position=None, commanded_rotation=None)
APPROACHES = np.random.default_rng(0).choice([-1.0, 1.0], (6, 150))


@pytest.mark.parametrize(
    ("measured", "why"),
    [
        (
            random_cycles(0, cycles=1),
            {
                "RP": "every commanded pose was visited only once: RP needs several cycles",
                "RD": "every pair of commanded poses was visited once: RD needs cycles",
                "dRP": "drift needs 6 visits of a commanded pose, 3 in each of 2 windows",
            },
        ),
        (
            random_cycles(0, poses=1),
            {"AD": "one commanded pose has no distances", "RD": "one commanded pose has no distances"},
        ),
        (WITHOUT_COMMAND, dict.fromkeys(("AP", "AD", "dAP"), UNKNOWN)),
        (
            dataclasses.replace(KNOWN, direction=None),
            {"vAP": "approach directions are not known: give dir_q columns, or `ordered`"},
        ),
        (
            dataclasses.replace(KNOWN, direction=np.ones((2, KNOWN.n))),
            {"vAP": "every commanded pose was always approached from the same direction"},
        ),
        (
            dataclasses.replace(random_cycles(0, cycles=30), direction=APPROACHES),
            {"vAP": "the moves to a pose differ from visit to visit: there are no approaches to compare"},
        ),
    ],
)
def test_what_cannot_be_had_says_why(measured: Measurements, why: dict[str, str]) -> None:
    result = iso9283([measured])
    for symbol, text in why.items():
        position = result.characteristic(symbol).position
        assert (position.value, position.interval.why) == (None, text)


def test_one_visit_has_a_value_and_no_interval() -> None:
    once, twice = iso9283([random_cycles(0, cycles=1)]), iso9283([random_cycles(0, cycles=2)]).characteristic("vAP")
    for figure in (once.characteristic("AP").position, twice.position, twice.angle):
        assert figure.value
        assert (figure.interval.upper, figure.interval.why) == (None, ONCE)
    assert once.characteristic("AD").position.value is not None
    assert iso9283([random_cycles(0, poses=1)]).characteristic("RP").position.value is not None


def test_without_a_command_there_is_repeatability_and_no_accuracy() -> None:
    result, given = iso9283([WITHOUT_COMMAND]), iso9283([KNOWN])
    assert result.commanded is None
    for symbol in ("RP", "RD", "dRP", "shift"):
        assert values(result.characteristic(symbol)) == values(given.characteristic(symbol))
    assert result.characteristic("RP").angle.value == pytest.approx(given.characteristic("RP").angle.value, rel=1e-6)


def test_poses_without_names_are_grouped_by_their_command() -> None:
    named, result = (
        iso9283([one]) for one in (random_cycles(4), dataclasses.replace(random_cycles(4), pose=None, cycle=None))
    )
    assert [pose.label for pose in result.poses] == [f"pose {i + 1}" for i in range(5)]
    for symbol in ("AP", "RP", "RD"):
        found, expected = (list(values(one.characteristic(symbol)).values()) for one in (result, named))
        assert found == pytest.approx(expected)


def test_targets_of_one_pose_are_poses_of_their_own() -> None:
    measured = dataclasses.replace(
        data({"P1": [[0, 0, 0], [50, 0, 0], [0, 0, 1], [50, 0, 1]]}), target=np.array(["a", "b", "a", "b"])
    )
    assert values(iso9283([measured]).characteristic("RP")) == pytest.approx({"P1 a": 0.5 * MM, "P1 b": 0.5 * MM})


def test_many_poses_are_paired_with_their_neighbours() -> None:
    result = iso9283([random_cycles(0, poses=11, cycles=3)]).characteristic("RD")
    assert [place.poses for place in result.places][:2] == [("P1", "P2"), ("P2", "P3")]
    assert len(result.places) == 10
    assert result.notes == ("with more than 10 commanded poses only neighbours in order of visit are paired",)


LARGEST = "every criterion is the largest over all measured poses or pairs of poses"
LONG = random_cycles(0, cycles=40)
OUTLYING = dataclasses.replace(LONG, position=LONG.position + 2e-3 * (np.arange(LONG.n) % 37 == 0))


@pytest.mark.parametrize(
    ("measured", "told", "untold"),
    [
        (KNOWN, (LARGEST, "their distance from the commanded pose is AP"), ()),
        (random_cycles(0, poses=1), (), (LARGEST,)),
        (LONG, (), ("longer tails",)),
        (OUTLYING, ("has longer tails than a Gaussian",), ()),
    ],
)
def test_notes(measured: Measurements, told: tuple[str, ...], untold: tuple[str, ...]) -> None:
    assert missing("\n".join(iso9283([measured]).notes), *told, *untold) == list(untold)


def test_a_command_that_moves_between_visits_is_warned_of() -> None:
    moving = KNOWN.commanded_position.copy()
    moving[0, -1] += 0.002
    result = iso9283([dataclasses.replace(KNOWN, commanded_position=moving)])
    assert any("the command of P5 differs by 2 mm between its visits" in text for text in result.warnings)
    assert not iso9283([KNOWN]).warnings


FEW = "has 301 commanded poses; the standard's criteria need a few poses, at most 300"


@pytest.mark.parametrize(
    ("files", "call", "error", "message"),
    [
        ([KNOWN], {"windows": 1}, UsageError, "`drift_windows` is at least 2, not 1"),
        ([KNOWN], {"rated_load": 0.0}, UsageError, "`rated_load` is above 0 kg, not 0"),
        ([KNOWN], {"align": ("backlash",)}, UsageError, "cannot align backlash"),
        ([KNOWN], {"confidence": 1.0}, UsageError, "at least 0.5 and less than 1"),
        ([], {}, UsageError, "no file of measured poses is given; give at least one"),
        ([KNOWN.subset(np.zeros(0, dtype=int))], {}, InputError, "has no measured poses"),
        ([random_cycles(0, poses=301, cycles=1)], {}, InputError, FEW),
    ],
)
def test_calls_that_do_not_fit(
    files: list[Measurements], call: dict[str, Any], error: type[Exception], message: str
) -> None:
    with pytest.raises(error, match=message):
        iso9283(files, **call)


def test_visits_that_do_not_scatter_at_all() -> None:
    still = data({"P1": [[1, 2, 2]] * 6, "P2": [[5, 0, 0]] * 6}, {"P1": [0, 0, 0], "P2": [0, 0, 0]})
    result = iso9283([still])
    accuracy, repeatability = result.characteristic("AP").position, result.characteristic("RP").position
    assert (accuracy.value, accuracy.interval.upper) == pytest.approx((5 * MM, 5 * MM))
    assert (repeatability.value, repeatability.interval.upper) == (0.0, 0.0)
    assert result.characteristic("dRP").position.value == 0.0
    assert any(warning.startswith("all visits of P1, P2 have the same position") for warning in result.warnings)


def test_rows_in_another_order_change_nothing_but_places() -> None:
    measured = random_cycles(2)
    timed = dataclasses.replace(measured, time=np.arange(measured.n, dtype=float))
    mixed = timed.subset(np.random.default_rng(0).permutation(timed.n))
    results = iso9283([timed]), iso9283([mixed])
    for symbol in ("AP", "RP", "vAP", "dAP", "dRP", "shift"):
        ordered, shuffled = (result.characteristic(symbol) for result in results)
        assert values(ordered) == pytest.approx(values(shuffled))
        upper = shuffled.position.interval.upper
        assert ordered.position.interval.upper == pytest.approx(upper, rel=1e-4)


def test_unregistered_data_give_a_warning_and_are_registered_without_a_robot() -> None:
    here, turn = random_cycles(2), Rotation.from_euler("xyz", [0.3, -0.2, 2.0]).as_matrix()
    elsewhere = dataclasses.replace(
        here,
        position=turn @ here.position + np.array([[3.0], [-2.0], [0.4]]),
        rotation=np.einsum("ij,jkn->ikn", turn, here.rotation),
    )
    plain, registered = iso9283([elsewhere]), iso9283([elsewhere], align=("base_frame", "tool_frame"))
    right = iso9283([here])
    assert any("too large for an arm and suggest frames that are not registered" in text for text in plain.warnings)
    assert (right.warnings, registered.warnings, registered.commanded) == ((), (), "file")
    accuracy = [result.characteristic("AP").position.value for result in (registered, right, plain)]
    # The offset of 0.52 mm at every pose goes into the frames.
    assert accuracy[0] < accuracy[1] < 2.0 < accuracy[2]
    before, after = (result.characteristic("RP").position.value for result in (plain, registered))
    assert after == pytest.approx(before, rel=1e-6)


TURN = Rotation.from_euler("xyz", [0.4, -0.7, 1.1]).as_matrix()


def test_mean_is_students() -> None:
    x = np.array([1.0, 2.0, 4.0, 4.5])
    interval = estimates.mean(x, 1.0).interval_at(0.9)
    low, high = stats.t.interval(0.9, 3, loc=x.mean() - 1.0, scale=x.std(ddof=1) / 2)
    assert (interval.lower, interval.upper) == pytest.approx((low, high), rel=1e-9)
    assert interval.upper_bound == pytest.approx(x.mean() - 1.0 + stats.t.ppf(0.9, 3) * x.std(ddof=1) / 2, rel=1e-9)


def test_threefold_standard_deviation_is_chi_square() -> None:
    x = np.array([1.0, 2.0, 4.0, 4.5])
    estimate = estimates.threefold_std(x)
    assert estimate.value == pytest.approx(3 * x.std(ddof=1))
    bounds = [3 * x.std(ddof=1) * math.sqrt(3 / stats.chi2.ppf(p, 3)) for p in (0.975, 0.025, 0.05)]
    interval = estimate.interval_at(0.95)
    assert [interval.lower, interval.upper, interval.upper_bound] == pytest.approx(bounds, rel=1e-9)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_size_of_a_signed_number(sign: float) -> None:
    clear = estimates.magnitude(estimates.student(sign * 5.0, 1.0, 30)).interval_at(0.95)
    t = stats.t.ppf(0.975, 30)
    assert (clear.lower, clear.upper) == pytest.approx((5 - t, 5 + t))
    assert clear.upper_bound == pytest.approx(5 + stats.t.ppf(0.95, 30))
    across = estimates.magnitude(estimates.student(sign * 0.5, 1.0, 30)).interval_at(0.95)
    assert (across.lower, across.upper) == pytest.approx((0.0, 0.5 + t))


def test_distance_with_scatter_alike_in_all_directions_is_noncentral_chi_square() -> None:
    """The limits are the noncentralities under which the distance found has the tail's probability."""
    variance, value, dof = 0.04, 1.0, 10_000_000.0
    estimate = distance(np.array([0.6, 0.0, 0.8]), variance * np.eye(3), dof).interval_at(0.95)
    for limit, tail in ((estimate.lower, 0.975), (estimate.upper, 0.025), (estimate.upper_bound, 0.05)):
        reached = stats.ncx2.cdf(value**2 / variance, 3, limit**2 / variance)
        assert reached == pytest.approx(tail, abs=1e-4)


def test_distance_that_is_all_scatter_may_be_zero() -> None:
    estimate = distance(np.array([0.01, 0.0, 0.0]), np.eye(3) * 0.01, 29).interval_at(0.95)
    assert estimate.lower == 0.0
    assert estimate.upper > 0.1
    none = distance(np.zeros(3), np.eye(3) * 0.01, 29).interval_at(0.95)
    assert (none.lower, none.upper) == (0.0, estimate.upper)


def test_repeatability_does_not_depend_on_unit_or_axes_and_repeats_with_its_seed() -> None:
    x = np.random.default_rng(3).normal(size=(3, 20)) * np.array([[1.0], [0.5], [0.2]])
    x -= x.mean(axis=1, keepdims=True)
    original, transformed = (position_repeatability(y, (1, 2)) for y in (x, 1e-3 * TURN @ x))
    assert transformed.value == pytest.approx(1e-3 * original.value)
    assert transformed.interval_at(0.95).upper == pytest.approx(1e-3 * (original.interval_at(0.95).upper or 0.0))
    assert position_repeatability(x, (1, 3)).interval_at(0.95) != original.interval_at(0.95)


def test_repeatability_of_many_visits_goes_over_into_the_delta_method() -> None:
    x = np.random.default_rng(3).normal(size=(3, 300))
    x -= x.mean(axis=1, keepdims=True)
    bootstrap = position_repeatability(x, (1,)).interval_at(0.95)
    twice = position_repeatability(np.hstack((x, x)), (1,)).interval_at(0.95)
    widths = [(interval.upper or 0.0) - (interval.lower or 0.0) for interval in (bootstrap, twice)]
    assert twice.method == DELTA
    assert widths[0] / widths[1] == pytest.approx(math.sqrt(2), rel=0.15)


def test_repeatability_of_two_visits_and_of_none_that_scatter() -> None:
    assert position_repeatability(np.array([[1.0, -1.0], [0, 0], [0, 0]]), (0,)).interval_at(0.95).upper is None
    still = position_repeatability(np.zeros((3, 5)), (0,))
    assert (still.value, still.interval_at(0.95).upper) == (0.0, 0.0)


def test_change_of_two_estimates_is_theirs_in_quadrature() -> None:
    after, before = estimates.student(5.0, 3.0, math.inf), estimates.student(1.0, 4.0, math.inf)
    estimate = estimates.change(after, before).interval_at(0.95)
    assert (estimate.lower, estimate.upper) == pytest.approx(
        tuple(stats.norm.interval(0.95, loc=4.0, scale=5.0)), rel=1e-6
    )
    assert estimate.upper_bound == pytest.approx(4.0 + 5.0 * stats.norm.ppf(0.95), rel=1e-6)
    missing = estimates.change(after, estimates.student(1.0, 0.0, 0)).interval_at(0.95)
    assert (missing.upper, missing.why) == (None, ONCE)


def test_largest_has_the_greatest_upper_limit_and_a_corrected_lower_one() -> None:
    three = [estimates.student(value, 1.0, math.inf) for value in (5.0, 4.9, -8.0)]
    best, figure = estimates.largest_figure([estimates.magnitude(estimate) for estimate in three], 0.95)
    assert (best, figure.value) == (2, 8.0)
    assert figure.interval.upper == pytest.approx(8.0 + stats.norm.ppf(0.975))
    assert figure.interval.lower == pytest.approx(8.0 - stats.norm.ppf(1 - 0.025 / 3))
    assert figure.interval.method.endswith("; largest of 3")


def visits(rng: np.random.Generator, scale: tuple[float, float, float], n: int, mean: np.ndarray) -> np.ndarray:
    return mean[:, None] + TURN @ (np.array(scale)[:, None] * rng.normal(size=(3, n)))


def cycles(n: int = 30, points: np.ndarray | None = None, **columns: Any) -> Measurements:
    """Visits of five points in turn, by default those of a cube of 630 mm."""
    points = five_points(np.array([0.6, 0.0, 0.5]), 0.63, "x-") if points is None else points
    index = np.tile(np.arange(points.shape[1]), n)
    noise = np.random.default_rng(7).normal(scale=2e-5, size=(3, index.size))
    base = Measurements(
        position=points[:, index] + noise,
        commanded_position=points[:, index],
        pose=np.array([f"P{i + 1}" for i in index]),
    )
    return dataclasses.replace(base, **columns)


def condition(name: str, data: Measurements, rated_load: float | None = None) -> Mapping[str, str]:
    """One condition, without the criteria that it does not look at."""
    commanded = data.commanded_position
    poses = visits_of(data, (None, None) if commanded is None else commanded_poses(data, None), "poses.csv", 0)
    repeated = repeatability(poses, 0.95, 0) if name == "measuring uncertainty" else characteristic("RP", [], 0.95, "")
    shift = drift(poses, 0.95, 0)[2] if name == "warm-up" else characteristic("shift", [], 0.95, "")
    return next(
        entry for entry in protocol([data], poses, None, repeated, shift, rated_load) if entry["condition"] == name
    )


ROWS = 150
ONES = np.ones(ROWS)
Q = np.tile(np.arange(5.0), 30)[None] * np.array([[0.1], [0.2]])
IN_ORDER = dict(zip(("direction", "speed"), motion_between_rows(Q), strict=True), q=Q)
FOUR_CYCLES = cycles(4, points=np.random.default_rng(0).uniform(0, 1, (3, 6)))
UPRIGHT = cycles(3, points=np.array([[0, 1, 1, -1, -1], [0, 1, 1, -1, -1], [0, 1, -1, -1, 1]]) * 0.2)
WITHOUT_COMMANDS = cycles(commanded_position=None)
SIZES = "10 % in a cube of 500 mm, not a preferred size; the preferred edges are 250, 400, 630, 1000 mm"


@pytest.mark.parametrize(
    ("name", "columns", "status", "why"),
    [
        ("temperature", {}, "unknown", "no column temperature_c"),
        ("temperature", {"temperature": np.linspace(19, 21, ROWS)}, "met", "19.0 °C to 21.0 °C, within 20 °C ± 2 °C"),
        (
            "temperature",
            {"temperature": np.linspace(24, 26, ROWS)},
            "met",
            "constant within ± 2 °C but not at 20 °C; state it",
        ),
        ("temperature", {"temperature": np.linspace(20, 25, ROWS)}, "not_met", "varies by more than ± 2 °C"),
        ("measuring uncertainty", {}, "unknown", "no columns sigma_x"),
        ("measuring uncertainty", {"sigma_position": np.full((3, ROWS), 1e-6)}, "met", "at most 25 % is allowed"),
        ("measuring uncertainty", {"sigma_position": np.full((3, ROWS), 2e-5)}, "not_met", "of the smallest RP"),
        ("rated load", {}, "unknown", "no column payload_kg"),
        ("rated load", {"payload": 5 * ONES}, "unknown", "5 kg throughout; give `rated_load` to compare"),
        ("rated load", {"payload": np.linspace(1, 5, ROWS)}, "not_met", "varies from 1 kg to 5 kg"),
        ("rated velocity", {}, "unknown", "no speed columns"),
        ("rated velocity", {"speed": np.zeros((2, ROWS))}, "unknown", "every speed is 0"),
        ("rated velocity", {"speed": np.vstack((-ONES, 0.3 * ONES))}, "met", "the fastest joint's last motion: 100 %"),
        ("rated velocity", {"speed": np.full((2, ROWS), 0.5)}, "met", "50 %, an optional step"),
        ("rated velocity", {"speed": np.full((2, ROWS), 0.1)}, "met", "10 %, an optional step"),
        (
            "rated velocity",
            {"speed": np.full((2, ROWS), 0.3)},
            "not_met",
            "30 %; the standard requires 100 %; optional steps are 50 %, 10 %",
        ),
        ("rated velocity", {"speed": np.linspace(0.2, 1, ROWS)[None]}, "not_met", "varies from 20 % to 100 %"),
        ("one approach", {}, "unknown", "approach directions are not known"),
        ("one approach", {"direction": np.ones((2, ROWS))}, "met", "has the same approach direction"),
        ("five poses", {}, "met", "5 commanded poses"),
        ("diagonal plane", {}, "met", "P1 is the centre, and the plane rises at 45° towards x-"),
        ("10 % from the corners", {}, "met", "10.0 % in a cube of 630 mm"),
        ("30 cycles", {}, "met", "30 visits of each commanded pose"),
        ("stabilisation", {}, "unknown", "the time between arrival and measurement is not recorded"),
        ("warm-up", {}, "unknown", "the warm-up is not recorded"),
        ("rated load, 5 kg", {"payload": 5 * ONES}, "met", "5 kg of 5 kg: 100 %"),
        (
            "rated load, 50 kg",
            {"payload": 5 * ONES},
            "met",
            "10 %, an optional step; a test at 100 % load is needed too",
        ),
        (
            "rated load, 10 kg",
            {"payload": 5 * ONES},
            "not_met",
            "50 %; the standard requires 100 %; optional steps are 10 %",
        ),
        ("rated velocity", cycles(**IN_ORDER), "unknown", "they are relative, not absolute"),
        ("one approach", cycles(**IN_ORDER), "met", "has the same approach direction"),
        (
            "one approach",
            cycles(direction=np.where(np.arange(ROWS) < 75, 1.0, -1.0)[None]),
            "not_met",
            "P1, P2, P3 … approached from several directions: AP and RP include vAP",
        ),
        ("30 cycles", FOUR_CYCLES, "not_met", "4 visits of each commanded pose"),
        ("30 cycles", cycles(4).subset(np.arange(19)), "not_met", "3 to 4 visits of a commanded pose"),
        ("five poses", FOUR_CYCLES, "not_met", "6 commanded poses"),
        ("diagonal plane", FOUR_CYCLES, "not_met", "needs five commanded poses"),
        ("diagonal plane", UPRIGHT, "not_met", "the diagonal plane is upright"),
        ("10 % from the corners", UPRIGHT, "unknown", SIZES),
        ("diagonal plane", WITHOUT_COMMANDS, "unknown", "the commanded positions are not known"),
        ("10 % from the corners", WITHOUT_COMMANDS, "unknown", "the commanded positions are not known"),
        (
            "warm-up",
            cycles(position=cycles().position + np.linspace(0, 3e-4, ROWS)),
            "unknown",
            "moved 0.3",
        ),
        (
            "measuring uncertainty",
            cycles(1, sigma_position=np.full((3, 5), 1e-6)),
            "unknown",
            "there is no RP to compare it with",
        ),
    ],
)
def test_conditions(name: str, columns: dict[str, Any] | Measurements, status: str, why: str) -> None:
    name, _, rated = name.partition(", ")
    data = cycles(**columns) if isinstance(columns, dict) else columns
    result = condition(name, data, float(rated.removesuffix(" kg")) if rated else None)
    assert result["status"] == status
    assert why in result["why"]


def test_a_plane_is_judged_in_the_axes_of_the_base() -> None:
    """The base is turned in the measuring frame: in its axes the five poses are a cube, in the frame's they are not."""
    turn = np.array([[np.cos(0.3), -np.sin(0.3), 0], [np.sin(0.3), np.cos(0.3), 0], [0, 0, 1]])
    data = cycles(3, points=turn @ five_points(np.array([0.6, 0.0, 0.5]), 0.63, "x-"))
    assert "not parallel to the axes of the base" in condition("diagonal plane", data)["why"]
    robot = Robot("turned", "standard", (), base=Frame((0.1, 0.2, 0.3), (0, 0, 0.3)))
    poses = visits_of(data, commanded_poses(data, None), "poses.csv", 0)
    conditions = protocol(
        [data], poses, robot, characteristic("RP", [], 0.95, ""), characteristic("shift", [], 0.95, ""), None
    )
    assert next(entry for entry in conditions if entry["condition"] == "diagonal plane")["status"] == "met"


def test_several_files_are_judged_together() -> None:
    warm, unknown = cycles(temperature=20 * ONES), cycles()
    conditions = {entry["condition"]: entry for entry in iso9283([warm, unknown]).protocol}
    assert conditions["temperature"]["status"] == "unknown"
    assert conditions["five poses"]["status"] == "met"


WITH_EDGE = {"scara": 0.15}
"""The stroke of the SCARA's slide is 195 mm: no preferred cube fits."""


def configured(name: str) -> Robot:
    return read_robot(CONFIGS / f"{name}.yaml")


def test_out_of_reach_is_not_converged_and_limits_are_kept() -> None:
    robot_arm = arm("ur10")
    far = Poses(np.eye(3)[..., None], np.array([[9.0], [0.0], [0.0]]))
    solution = inverse_kinematics(robot_arm, far)
    assert not solution.converged.any()
    assert np.min(solution.error) > 7.0
    free = inverse_kinematics(
        robot_arm, dataclasses.replace(far, translation=np.array([[0.5], [0.1], [0.4]])), oriented=False
    )
    assert free.converged.all()


def test_a_slide_without_limits_cannot_be_searched() -> None:
    robot = configured("stanford")
    joints = tuple(dataclasses.replace(j, limits=None) if j.type == "prismatic" else j for j in robot.joints)
    with pytest.raises(InputError, match="the prismatic joint j3 has no limits to search within"):
        propose(dataclasses.replace(robot, joints=joints))


def test_five_points_by_hand() -> None:
    """A cube of 1 m about the origin, plane rising to +x: x = z = ± 0.4, y = ± 0.4."""
    points = five_points(np.zeros(3), 1.0, "x+")
    expected = [[0, -0.4, -0.4, 0.4, 0.4], [0, -0.4, 0.4, 0.4, -0.4], [0, -0.4, -0.4, 0.4, 0.4]]
    assert points == pytest.approx(np.array(expected))
    assert points[:, 1] == pytest.approx(-points[:, 3])
    diagonal = math.sqrt(3)
    for i in range(1, 5):
        nearest = np.min(np.linalg.norm(corners(np.zeros(3), 1.0) - points[:, [i]], axis=0))
        assert nearest == pytest.approx(0.1 * diagonal)


@pytest.mark.parametrize("plane", PLANES)
def test_a_cube_is_recognised_in_any_order(plane: str) -> None:
    points = five_points(np.array([0.3, -0.2, 0.9]), 0.63, plane)  # type: ignore[arg-type]
    centre, edge, share, rising = fit_cube(points[:, [3, 1, 4, 0, 2]])
    assert (centre, rising) == (3, plane)
    assert (edge, share) == pytest.approx((0.63, 0.1))


def test_points_up_to_two_percent_off_are_still_of_a_preferred_cube() -> None:
    points = five_points(np.zeros(3), 0.4, "y-") * (0.5 - 0.085) / 0.4
    assert fit_cube(points)[1:3] == pytest.approx((0.4, 0.085))
    assert fit_cube(five_points(np.zeros(3), 0.5, "y-"))[1:3] == pytest.approx((0.5, 0.1))


GOOD = five_points(np.zeros(3), 0.4, "x+")
TURN_OF_ISO9283_POSES = np.array([[math.cos(0.4), -math.sin(0.4), 0], [math.sin(0.4), math.cos(0.4), 0], [0, 0, 1]])


@pytest.mark.parametrize(
    ("points", "reason"),
    [
        (TURN_OF_ISO9283_POSES @ GOOD, "not parallel to the axes of the base"),
        (GOOD + 0.05 * np.outer([1, 0, 0], [0, 1, 0, 0, 0]), "no pose is the centre of the other four"),
        (
            np.array([[0, 1, 1, -1, -1], [0, 2, -2, -2, 2], [0, 0, 0, 0, 0]]) * 0.1,
            "the outer poses form a rectangle of 200 mm by 400 mm; a diagonal plane has sides of 1 : √2",
        ),
        (np.zeros((3, 5)), "the five poses are at the same position"),
    ],
)
def test_points_that_are_no_cube_have_a_reason(points: np.ndarray, reason: str) -> None:
    assert reason in str(fit_cube(points))


def test_an_upright_plane_is_none_of_the_standards() -> None:
    assert fit_cube(np.array([[0, 1, 1, -1, -1], [0, 1, 1, -1, -1], [0, 1, -1, -1, 1]]) * 0.16)[3] is None


@pytest.mark.parametrize("name", some_fast(CONFIGURED, 2))
def test_five_poses_on_every_arm(name: str) -> None:
    """In the standard's cube, within the limits, met to 1e-9 by the robot's own kinematics, one orientation."""
    robot = configured(name)
    proposal = propose(robot, edge=WITH_EDGE.get(name))
    robot_arm = Arm.of(robot)
    low, high = joint_ranges(robot_arm)
    assert proposal.q.shape == (low.size, 5)
    assert np.all((proposal.q >= low[:, None]) & (proposal.q <= high[:, None]))
    reached = robot_arm.chain.forward(proposal.q)
    assert np.max(np.abs(reached.translation - proposal.poses.translation)) < 1e-9
    assert np.max(np.abs(log_so3(compose(proposal.poses.rotation, transpose(reached.rotation))))) < 1e-9
    assert proposal.poses.translation == pytest.approx(
        five_points(proposal.centre, proposal.edge, proposal.plane), abs=1e-12
    )
    assert np.max(np.abs(proposal.poses.rotation - proposal.poses.rotation[..., :1])) < 1e-12
    assert proposal.orientation in ("down", "own")
    if proposal.orientation == "down":
        assert proposal.poses.rotation[:, 2, 0] == pytest.approx([0, 0, -1], abs=1e-9)
    span = high - low
    margins = (
        np.minimum(proposal.q - low[:, None], high[:, None] - proposal.q)[np.isfinite(span)]
        / span[np.isfinite(span), None]
    )
    assert proposal.margin == pytest.approx(margins.min(), abs=1e-6)
    assert proposal.margin >= 0.01
    assert bool(proposal.notes) == (name in WITH_EDGE or proposal.orientation == "own")


def test_the_cube_stands_in_the_axes_of_the_base() -> None:
    """A base that is turned and moved takes the cube with it; joint angles stay."""
    robot = configured("ur10")
    moved = propose(dataclasses.replace(robot, base=Frame((1.0, 2.0, 0.5), (0.1, 0.2, 0.3))), edge=0.25)
    plain = propose(robot, edge=0.25)
    base = Poses.from_xyz_rpy(np.array([[1.0], [2.0], [0.5]]), np.array([[0.1], [0.2], [0.3]]))
    assert moved.q == pytest.approx(plain.q)
    assert moved.poses.translation == pytest.approx((base @ plain.poses).translation)


@pytest.mark.parametrize("orientation", ORIENTATIONS)
def test_orientations_that_are_asked_for(orientation: str) -> None:
    proposal = propose(configured("irb1600"), edge=0.25, orientation=orientation, plane="y+")  # type: ignore[arg-type]
    assert (proposal.orientation, proposal.plane) == (orientation, "y+")
    assert proposal.notes == ()
    axis = proposal.poses.rotation[:, 2]
    if orientation == "forward":
        assert axis[2] == pytest.approx(np.zeros(5), abs=1e-9)
    if orientation == "free":
        assert np.ptp(axis, axis=1).max() > 1e-3


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        (
            "scara",
            {},
            r"SCARA \(Adept One\): found no cube of 250 mm or more whose corners and five poses the arm reaches; "
            "give a smaller `edge`",
        ),
        ("scara", {"edge": 0.15, "orientation": "forward"}, "cube of 150 mm with the tool's z axis pointing level"),
        ("ur10", {"edge": 5.0, "plane": "x+"}, "no cube of 5000 mm with the plane x"),
        ("ur10", {"edge": 0.0}, "a length above 0, not 0 m"),
        ("ur10", {"target": "c"}, "no target 'c'; the robot file has one tool without a name"),
    ],
)
def test_an_arm_that_cannot(name: str, options: dict[str, Any], message: str) -> None:
    with pytest.raises((InputError, UsageError), match=message):
        propose(configured(name), **options)


def test_targets() -> None:
    robot = dataclasses.replace(configured("ur10"), targets={"a": Frame((0, 0, 0.1)), "b": Frame((0, 0, 0.2))})
    first, second = propose(robot, edge=0.25), propose(robot, edge=0.25, target="b")
    assert (first.target, second.target) == ("a", "b")
    assert first.notes == ("for the target a, the first of 2",)
    assert set(planned_poses(second, 2).target) == {"b"}
    with pytest.raises(UsageError, match="no target 'c'; the robot file has a, b"):
        propose(robot, target="c")


def test_a_note_says_that_effects_are_not_applied() -> None:
    robot = dataclasses.replace(configured("ur10"), effects=({"effect": "joint_offset"},))
    assert propose(robot, edge=0.25).notes == (
        "joint angles are those of the nominal kinematics; the robot file's effects are not applied",
    )
