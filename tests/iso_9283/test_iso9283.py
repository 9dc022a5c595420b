"""The criteria of ISO 9283: by hand, by plain loops, and what data without cycles, commands or angles give."""

from __future__ import annotations

import dataclasses
import math
from itertools import combinations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from robacc.errors import InputError, UsageError
from robacc.iso_9283.evaluation import iso9283
from robacc.iso_9283.visits import Characteristic, Iso9283Result
from robacc.measurements import Measurements

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


def test_accuracy_and_repeatability_by_hand() -> None:
    """Visits ±1 along x and ±3 along y about (2, 2, 0): l = 1, 1, 3, 3, so RP = 2 + 3 sqrt(4/3)."""
    result = iso9283([data({"P1": [[3, 2, 0], [1, 2, 0], [2, 5, 0], [2, -1, 0]]}, {"P1": [0, 0, 0]})])
    accuracy, repeatability = result.characteristic("AP"), result.characteristic("RP")
    assert accuracy.position.value == pytest.approx(math.sqrt(8) * MM, rel=1e-12)
    assert [figure.value for figure in accuracy.places[0].axes or ()] == pytest.approx([2 * MM, 2 * MM, 0], abs=1e-15)
    assert repeatability.position.value == pytest.approx((2 + 3 * math.sqrt(4 / 3)) * MM, rel=1e-12)
    assert repeatability.places[0].mean_distance == pytest.approx(2 * MM)
    assert repeatability.places[0].sd_distance == pytest.approx(math.sqrt(4 / 3) * MM)
    assert accuracy.position_at == repeatability.position_at == "P1"
    assert (accuracy.clause, repeatability.clause) == ("7.2.1", "7.2.2")


def test_distances_by_hand() -> None:
    """D = 100.1, 100.2, 100.0 for 100: AD = 0.1, RD = 3 x 0.1."""
    visits = {"P1": [[0, 0, 0], [0.1, 0, 0], [0, 0, 0]], "P2": [[100.1, 0, 0], [100.3, 0, 0], [100, 0, 0]]}
    result = iso9283([data(visits, {"P1": [0, 0, 0], "P2": [100, 0, 0]})])
    accuracy, repeatability = result.characteristic("AD"), result.characteristic("RD")
    assert accuracy.position.value == pytest.approx(0.1 * MM, rel=1e-9)
    assert repeatability.position.value == pytest.approx(0.3 * MM, rel=1e-9)
    assert accuracy.position_at == "P1–P2"
    shorter = iso9283([data(visits, {"P1": [0, 0, 0], "P2": [101, 0, 0]})]).characteristic("AD")
    assert shorter.places[0].position.value == pytest.approx(-0.9 * MM, rel=1e-9)
    assert shorter.position.value == pytest.approx(0.9 * MM, rel=1e-9)


def test_distances_are_matched_by_cycle_and_not_by_row() -> None:
    """The second cycle of P1 was lost: D of cycles 1 and 3 remain."""
    all_visits = data({"P1": [[0, 0, 0], [9, 0, 0], [0, 0, 0]], "P2": [[10, 0, 0], [10, 0, 0], [12, 0, 0]]})
    remaining = all_visits.subset(np.flatnonzero((all_visits.pose != "P1") | (all_visits.cycle != "2")))
    result = iso9283([remaining]).characteristic("RD")
    assert result.places[0].n == 2
    assert result.position.value == pytest.approx(3 * math.sqrt(2) * MM, rel=1e-12)


def test_approaches_by_hand() -> None:
    """From below the barycentre is (0, 0, 0), from above (3, 4, 0), from aside (0, 4, 0): vAP = 5."""
    visits = [[0, 0, 1], [0, 0, -1], [3, 4, 1], [3, 4, -1], [0, 4, 1], [0, 4, -1]]
    ways = np.array([[1, 1, -1, -1, 0, 0], [1, 1, 1, 1, -1, -1]], dtype=float)
    result = iso9283([dataclasses.replace(data({"P1": visits}), direction=ways)]).characteristic("vAP")
    assert result.position.value == pytest.approx(5 * MM, rel=1e-12)
    assert result.places[0].between == "−+ and ++"
    assert result.clause == "7.2.3"


def test_drift_by_hand() -> None:
    """First window about (1, 0, 0) with y = -1, 0, 1, second about (3, 0, 0) with y = -2, 0, 2."""
    visits = [[1, -1, 0], [1, 0, 0], [1, 1, 0], [3, -2, 0], [3, 0, 0], [3, 2, 0]]
    result = iso9283([data({"P1": visits}, {"P1": [0, 0, 0]})], windows=2)
    repeatability = 2 / 3 + 3 * math.sqrt(1 / 3)
    assert result.characteristic("dAP").position.value == pytest.approx(2 * MM, rel=1e-12)
    assert result.characteristic("dRP").position.value == pytest.approx(repeatability * MM, rel=1e-12)
    assert result.characteristic("shift").position.value == pytest.approx(2 * MM, rel=1e-12)


def test_drift_goes_by_time_and_not_by_row() -> None:
    visits = [[1, -1, 0], [1, 0, 0], [1, 1, 0], [3, -2, 0], [3, 0, 0], [3, 2, 0]]
    mixed = np.array([3, 0, 4, 1, 5, 2])
    shuffled = dataclasses.replace(data({"P1": visits}, {"P1": [0, 0, 0]}), time=np.arange(6.0)).subset(mixed)
    result = iso9283([shuffled], windows=2).characteristic("dAP")
    assert result.position.value == pytest.approx(2 * MM, rel=1e-12)
    assert result.notes == (
        "2 windows of 3 visits, by time_s, the first and the last 0.05 min apart; each against the first",
    )


def test_drift_that_leaves_accuracy_alone_is_a_shift() -> None:
    """Half a circle round the command: AP stands, the barycentre has moved by twice AP."""
    visits = [[1, 0, 0.1], [1, 0, -0.1], [1, 0, 0], [-1, 0, 0.1], [-1, 0, -0.1], [-1, 0, 0]]
    result = iso9283([data({"P1": visits}, {"P1": [0, 0, 0]})], windows=2)
    assert result.characteristic("dAP").position.value == pytest.approx(0, abs=1e-15)
    assert result.characteristic("shift").position.value == pytest.approx(2 * MM, rel=1e-12)
    assert any("the robot drifted during the run" in note for note in result.notes)


def test_exchangeability_by_hand() -> None:
    """Barycentres at (0, 0, 0), (3, 4, 0), (0, 4, 0): the largest distance is 5."""
    commanded_positions = {"P1": [0, 0, 0]}
    files = [
        dataclasses.replace(data({"P1": [[x, y, 1], [x, y, -1]]}, commanded_positions), source=f"/somewhere/{name}.csv")
        for name, x, y in (("a", 0, 0), ("b", 3, 4), ("c", 0, 4))
    ]
    result = iso9283(files)
    assert result.characteristic("E").position.value == pytest.approx(5 * MM, rel=1e-12)
    assert result.characteristic("E").places[0].between == "a.csv and b.csv"
    assert result.characteristic("AP").position.value == pytest.approx(5 * MM, rel=1e-12)
    assert result.characteristic("AP").position_at == "P1 of b.csv"


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


def loops(measured: Measurements) -> dict[str, dict[str, float]]:
    """AP, RP, AD, RD, vAP, dAP and dRP with nothing but loops and the formulas of the clauses, m."""
    names = sorted(set(measured.pose))
    visits = {
        name: [measured.position[:, i].tolist() for i in range(measured.n) if measured.pose[i] == name]
        for name in names
    }
    ways = {name: [measured.direction[0, i] for i in range(measured.n) if measured.pose[i] == name] for name in names}
    commanded_positions = {
        name: measured.commanded_position[:, list(measured.pose).index(name)].tolist() for name in names
    }

    def barycentre(points: list[list[float]]) -> list[float]:
        return [sum(point[i] for point in points) / len(points) for i in range(3)]

    def apart(point: list[float], other_point: list[float]) -> float:
        return math.sqrt(sum((a - b) ** 2 for a, b in zip(point, other_point, strict=True)))

    def mean_and_sd(numbers: list[float]) -> tuple[float, float]:
        mean = sum(numbers) / len(numbers)
        return mean, math.sqrt(sum((x - mean) ** 2 for x in numbers) / (len(numbers) - 1))

    def repeatability(points: list[list[float]]) -> float:
        mean, sd = mean_and_sd([apart(point, barycentre(points)) for point in points])
        return mean + 3 * sd

    result: dict[str, dict[str, float]] = {key: {} for key in ("AP", "RP", "AD", "RD", "vAP", "dAP", "dRP")}
    for name in names:
        points = visits[name]
        result["AP"][name] = apart(barycentre(points), commanded_positions[name])
        result["RP"][name] = repeatability(points)
        up = [point for point, way in zip(points, ways[name], strict=True) if way > 0]
        down = [point for point, way in zip(points, ways[name], strict=True) if way < 0]
        result["vAP"][name] = apart(barycentre(up), barycentre(down))
        first, last = points[: len(points) // 2], points[len(points) // 2 :]
        result["dAP"][name] = abs(
            apart(barycentre(first), commanded_positions[name]) - apart(barycentre(last), commanded_positions[name])
        )
        result["dRP"][name] = abs(repeatability(first) - repeatability(last))
    for first, second in combinations(names, 2):
        distances = [apart(a, b) for a, b in zip(visits[first], visits[second], strict=True)]
        mean, sd = mean_and_sd(distances)
        result["AD"][f"{first}–{second}"] = mean - apart(commanded_positions[first], commanded_positions[second])
        result["RD"][f"{first}–{second}"] = 3 * sd
    return result


@pytest.mark.parametrize("seed", range(3))
def test_every_position_criterion_against_plain_loops(seed: int) -> None:
    measured = random_cycles(seed)
    result = iso9283([measured], windows=2)
    for symbol, expected in loops(measured).items():
        characteristic = result.characteristic(symbol)
        assert values(characteristic) == pytest.approx(expected, rel=1e-9), symbol
        worst = max(expected, key=lambda name: abs(expected[name]))
        assert (characteristic.position.value, characteristic.position_at) == (
            pytest.approx(abs(expected[worst])),
            worst,
        )


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
    for accuracy, repeatability in zip(
        result.characteristic("AP").places, result.characteristic("RP").places, strict=True
    ):
        rows = measured.pose == accuracy.poses[0]
        expected = deviation[rows].mean(axis=0)
        assert [figure.value for figure in accuracy.angles or ()] == pytest.approx(expected.tolist(), abs=1e-12)
        three_std = 3 * deviation[rows].std(axis=0, ddof=1)
        assert [figure.value for figure in repeatability.angles or ()] == pytest.approx(three_std.tolist(), rel=1e-9)
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


def reason(result: Iso9283Result, symbol: str) -> str:
    characteristic = result.characteristic(symbol)  # type: ignore[arg-type]
    assert characteristic.position.value is None
    return str(characteristic.position.interval.why)


def test_one_cycle_has_accuracy_and_no_repeatability() -> None:
    result = iso9283([random_cycles(0, cycles=1)])
    accuracy = result.characteristic("AP").position
    assert accuracy.value is not None
    assert accuracy.interval.upper is None
    assert accuracy.interval.why == "one visit has no scatter to estimate an interval from"
    assert reason(result, "RP") == "every commanded pose was visited only once: RP needs several cycles"
    assert "RD needs cycles" in reason(result, "RD")
    assert reason(result, "dRP") == "drift needs 6 visits of a commanded pose, 3 in each of 2 windows"
    assert result.characteristic("AD").position.value is not None


def test_one_pose_has_no_distances() -> None:
    result = iso9283([random_cycles(0, poses=1)])
    assert reason(result, "AD") == reason(result, "RD") == "one commanded pose has no distances"
    assert result.characteristic("RP").position.value is not None


def test_without_a_command_there_is_repeatability_and_no_accuracy() -> None:
    measured = dataclasses.replace(random_cycles(0), commanded_position=None, commanded_rotation=None)
    result = iso9283([measured])
    for symbol in ("AP", "AD", "dAP"):
        assert reason(result, symbol).startswith("the commanded poses are not known")
    given = iso9283([random_cycles(0)])
    assert result.commanded is None
    for symbol in ("RP", "RD", "dRP", "shift"):
        assert values(result.characteristic(symbol)) == values(given.characteristic(symbol))  # type: ignore[arg-type]
    assert result.characteristic("RP").angle.value == pytest.approx(given.characteristic("RP").angle.value, rel=1e-6)


def test_positions_alone_have_no_angles() -> None:
    result = iso9283([random_cycles(0, oriented=False)])
    assert result.characteristic("RP").angle.value is None
    assert result.characteristic("RP").angle.interval.why == "no orientation was measured"
    assert result.characteristic("AP").angle.interval.why == "no orientation was commanded and measured"


def test_approaches_that_cannot_be_compared() -> None:
    measured = random_cycles(0)
    assert "approach directions are not known" in reason(
        iso9283([dataclasses.replace(measured, direction=None)]), "vAP"
    )
    same = dataclasses.replace(measured, direction=np.ones((2, measured.n)))
    assert reason(iso9283([same]), "vAP") == "every commanded pose was always approached from the same direction"
    rng = np.random.default_rng(0)
    many = dataclasses.replace(random_cycles(0, cycles=30), direction=rng.choice([-1.0, 1.0], (6, 150)))
    assert "differ from visit to visit" in reason(iso9283([many]), "vAP")


def test_poses_without_names_are_grouped_by_their_command() -> None:
    measured = dataclasses.replace(random_cycles(4), pose=None, cycle=None)
    named = iso9283([random_cycles(4)])
    result = iso9283([measured])
    assert [pose.label for pose in result.poses] == [f"pose {i + 1}" for i in range(5)]
    for symbol in ("AP", "RP", "RD"):
        assert list(values(result.characteristic(symbol)).values()) == pytest.approx(  # type: ignore[arg-type]
            list(values(named.characteristic(symbol)).values())  # type: ignore[arg-type]
        )


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


def test_one_visit_from_each_side_shows_no_scatter() -> None:
    """vAP has a value, in position and orientation, and says why it has no interval."""
    result = iso9283([random_cycles(0, cycles=2)]).characteristic("vAP")
    for figure in (result.position, result.angle):
        assert figure.value
        assert figure.interval.upper is None
        assert figure.interval.why == "one visit has no scatter to estimate an interval from"


def test_a_note_says_which_poses_count() -> None:
    note_start = "every criterion is the largest over all measured poses or pairs of poses"
    assert any(note.startswith(note_start) for note in iso9283([random_cycles(0)]).notes)
    assert not any(note.startswith(note_start) for note in iso9283([random_cycles(0, poses=1)]).notes)


def test_a_command_that_moves_between_visits_is_warned_of() -> None:
    measured = random_cycles(0)
    moving = measured.commanded_position.copy()  # type: ignore[union-attr]
    moving[0, -1] += 0.002
    result = iso9283([dataclasses.replace(measured, commanded_position=moving)])
    assert any("the command of P5 differs by 2 mm between its visits" in text for text in result.warnings)
    assert not iso9283([measured]).warnings


def test_repeatability_is_never_called_accuracy() -> None:
    result = iso9283([random_cycles(0)])
    assert any("their distance from the commanded pose is AP" in note for note in result.notes)
    assert {characteristic.symbol for characteristic in result.characteristics} == {
        "AP",
        "RP",
        "vAP",
        "AD",
        "RD",
        "dAP",
        "dRP",
        "shift",
        "E",
    }


def test_a_note_reports_long_tails() -> None:
    measured = random_cycles(0, cycles=40)
    assert not any("longer tails" in note for note in iso9283([measured]).notes)
    outlying = measured.position.copy()
    outlying[:, ::37] += 2e-3
    result = iso9283([dataclasses.replace(measured, position=outlying)])
    assert any("has longer tails than a Gaussian" in note for note in result.notes)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        ({"windows": 1}, "`drift_windows` is at least 2, not 1"),
        ({"rated_load": 0.0}, "`rated_load` is above 0 kg, not 0"),
        ({"align": ("backlash",)}, "cannot align backlash"),
        ({"confidence": 1.0}, "at least 0.5 and less than 1"),
    ],
)
def test_calls_that_do_not_fit(call: dict[str, object], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        iso9283([random_cycles(0)], **call)  # type: ignore[arg-type]


def test_a_file_without_repetitions_in_number_is_refused() -> None:
    with pytest.raises(
        InputError, match="has 301 commanded poses; the standard's criteria need a few poses, at most 300"
    ):
        iso9283([random_cycles(0, poses=301, cycles=1)])


def test_visits_that_do_not_scatter_at_all() -> None:
    still = data({"P1": [[1, 2, 2]] * 6, "P2": [[5, 0, 0]] * 6}, {"P1": [0, 0, 0], "P2": [0, 0, 0]})
    result = iso9283([still])
    accuracy, repeatability = result.characteristic("AP").position, result.characteristic("RP").position
    assert (accuracy.value, accuracy.interval.upper) == pytest.approx((5 * MM, 5 * MM))
    assert (repeatability.value, repeatability.interval.upper) == (0.0, 0.0)
    assert result.characteristic("dRP").position.value == 0.0


def test_no_file_and_no_pose() -> None:
    with pytest.raises(UsageError, match="no file of measured poses is given; give at least one"):
        iso9283([])
    with pytest.raises(InputError, match="has no measured poses"):
        iso9283([random_cycles(0).subset(np.zeros(0, dtype=int))])


def test_rows_in_another_order_change_nothing_but_places() -> None:
    measured = random_cycles(2)
    timed = dataclasses.replace(measured, time=np.arange(measured.n, dtype=float))
    mixed = timed.subset(np.random.default_rng(0).permutation(timed.n))
    ordered, shuffled = iso9283([timed]), iso9283([mixed])
    for symbol in ("AP", "RP", "vAP", "dAP", "dRP", "shift"):
        ordered_characteristic, shuffled_characteristic = (
            ordered.characteristic(symbol),
            shuffled.characteristic(symbol),
        )  # type: ignore[arg-type]
        assert values(ordered_characteristic) == pytest.approx(values(shuffled_characteristic))
        assert ordered_characteristic.position.interval.upper == pytest.approx(
            shuffled_characteristic.position.interval.upper, rel=1e-4
        )


def test_unregistered_data_give_a_warning_and_are_registered_without_a_robot() -> None:
    here = random_cycles(2)
    turn = Rotation.from_euler("xyz", [0.3, -0.2, 2.0])
    assert here.rotation is not None
    elsewhere = dataclasses.replace(
        here,
        position=turn.as_matrix() @ here.position + np.array([[3.0], [-2.0], [0.4]]),
        rotation=np.einsum("ij,jkn->ikn", turn.as_matrix(), here.rotation),
    )
    plain = iso9283([elsewhere])
    accuracy = plain.characteristic("AP").position.value
    assert accuracy > 2.0
    assert any("too large for an arm and suggest frames that are not registered" in text for text in plain.warnings)
    assert not iso9283([here]).warnings
    registered = iso9283([elsewhere], align=("base_frame", "tool_frame"))
    figures = [result.characteristic("AP").position.value for result in (registered, iso9283([here]))]
    assert not registered.warnings
    assert registered.commanded == "file"
    # The offset of 0.52 mm at every pose goes into the frames.
    assert figures[0] < figures[1]
    before, after = (result.characteristic("RP").position.value for result in (plain, registered))
    assert after == pytest.approx(before, rel=1e-6)
