"""Checks of the values of a pose file row by row, of repeated rows, and of poses close together."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.errors import Counted
from robacc.geometry import Array
from robacc.io.files import ProblemLog, clip
from robacc.measurements import Measurements
from robacc.poses.columns import AXES, QUATERNION, ROTATION_VECTOR, RPY, SIGMAS
from robacc.poses.layout import COMMANDED_QUATERNION, Values, listing
from robacc.poses.reading import JointLimits
from robacc.poses.units import EXCESS_TOLERANCE, degrees_likely, excess_beyond_limits

# Poses that lie close together; repetitions of one commanded pose whose joints were logged as read.

MOST_POSES = 5000
"""Largest number of poses that are compared; more are close to others in any case."""
_NEAR = 5e-4
"""rad or m; distance of two readings of a joint at one commanded pose at most. Servo errors are smaller, and the error
of an arm hardly changes over it."""
_EVIDENT = 0.25
"""Share of the rows that repeat a pose from which a file has repetitions."""


def with_repetitions(data: Measurements) -> tuple[Measurements, str | None]:
    """Return data without ids of poses with ids of those that were repeated, and a remark; unchanged if there are none.

    Joints that were logged as read differ a little from visit to visit of one commanded pose.
    """
    if data.pose is not None or data.q is None or not 2 <= data.n <= MOST_POSES:
        return data, None
    groups = data.groups()
    if np.unique(groups).size < data.n:
        return data, None
    place = close_groups(data.q, _NEAR, 2.0 * _NEAR)
    count = np.bincount(place)
    if np.mean(count[place] > 1) < _EVIDENT:
        return data, None
    names, number = np.unique(place, return_inverse=True)
    ids = np.array([f"P{k + 1}" for k in range(names.size)])[number]
    remark = (
        f"{data.n} rows are read as {names.size} commanded poses and their repetitions, because joints differ "
        f"by less than {1e3 * _NEAR:g} mrad (mm); a pose column states repetitions"
    )
    return dataclasses.replace(data, pose=ids), remark


def close_groups(values: Array, near: float, widest: float) -> NDArray[np.int64]:
    """Return ``(P,)`` a number that columns of ``(K, P)`` share if they are linked by steps of at most ``near``.

    A group that extends over more than ``widest`` in a row of ``values``, such as a sweep of a joint, is none.
    """
    place = np.arange(values.shape[1])
    first, second = _close_pairs(values, near)
    while True:
        # The lowest number spreads along the pairs.
        lowest = np.minimum(place[first], place[second])
        before = place.copy()
        np.minimum.at(place, first, lowest)
        np.minimum.at(place, second, lowest)
        if np.array_equal(place, before):
            break
    low, high = (np.full(values.shape, start) for start in (np.inf, -np.inf))
    for row, lower, upper in zip(values, low, high, strict=True):
        np.minimum.at(lower, place, row)
        np.maximum.at(upper, place, row)
    wide = (high - low).max(axis=0) > widest
    return np.where(wide[place], np.arange(place.size), place)


def _close_pairs(values: Array, near: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the pairs of columns that differ by at most ``near`` in each row, the lower in the first row first."""
    order = np.argsort(values[0], kind="stable")
    ends = np.searchsorted(values[0, order], values[0, order] + near, side="right")
    firsts, seconds = [], []
    for i, end in enumerate(ends):
        others = order[i + 1 : end]
        close = others[np.abs(values[:, others] - values[:, order[i], None]).max(axis=0, initial=0.0) <= near]
        firsts.append(np.full(close.size, order[i]))
        seconds.append(close)
    return np.concatenate(firsts).astype(np.int64), np.concatenate(seconds).astype(np.int64)


# Rows of a pose file that repeat an earlier row to the last digit.

_OF_VISIT = frozenset(("pose", "cycle", "visit"))
"""Columns that number the visits; a measurement is a copy whatever its visit is called."""
_FEW = 0.1
"""Largest share of rows that repeat the measurement of another visit for these to be called copies."""


_MEASURED = (*AXES, *QUATERNION, *ROTATION_VECTOR, *RPY)
_COARSE = 1e-5
"""m; positions rounded to this repeat by chance, since arms repeat within it."""
_CELL = 5e-6
"""m; size of the cells in which positions that nearly agree are counted."""
_NEAR_PER_EQUAL = 25.0
"""Pairs of a cell that differ, for each that is equal, from which equal ones are chance: five times fewer than noise
gives, at a resolution of 1 um."""


@dataclass(frozen=True, slots=True)
class DuplicateRows:
    """Rows that repeat an earlier row, or its measured values alone, which noise hardly ever does."""

    warnings: tuple[str, ...] = ()
    copies: NDArray[np.bool_] | None = None
    """``(N,)`` the later rows; None without any."""


def duplicate_rows(values: Values, file: str, counted: Counted) -> DuplicateRows:
    """Return the rows that repeat an earlier row, with a warning."""
    if values.lines.size < 2:
        return DuplicateRows()
    measured = values.numbers[[values.row_index[key] for key in _MEASURED if key in values.row_index]]
    same_measured = _equal_pairs(measured if len(measured) else values.numbers)
    if not same_measured[0].size:
        return DuplicateRows()
    first, second = _equal_pairs(values.numbers)
    equal = np.ones(first.size, dtype=bool)
    same_visit = equal.copy()
    for name, text in values.texts.items():
        agrees = text[first] == text[second]
        if name in _OF_VISIT:
            same_visit &= agrees
        else:
            equal &= agrees
    duplicate = equal & same_visit
    if duplicate.any():
        return _found(values, (first[duplicate], second[duplicate]), "an earlier row in every column", file, counted)
    # Rounded values of many visits repeat by chance; a few to the last digit are copies.
    if 0 < np.count_nonzero(equal) <= _FEW * values.lines.size:
        where = "an earlier row of another visit to the last digit"
        return _found(values, (first[equal], second[equal]), where, file, counted)
    if "x" in values.row_index and _are_copies(measured[:3], same_measured[0].size):
        return _found(values, same_measured, "the measured values of an earlier row to the last digit", file, counted)
    return DuplicateRows()


def _equal_pairs(numbers: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the numbers of pairs of rows with equal columns of ``numbers`` ``(C, N)``, the earlier row first."""
    # Equal rows have equal sums, term by term; only rows with equal sums are compared in full.
    sums = np.zeros(numbers.shape[1])
    for number, row in enumerate(numbers, 2):
        sums += math.sqrt(number) * row
    ordered = np.sort(sums)
    if not np.any(ordered[1:] == ordered[:-1]):
        return np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64)
    order = np.argsort(sums, kind="stable")
    equal_sums = np.flatnonzero(sums[order][1:] == sums[order][:-1])
    first, second = order[equal_sums], order[equal_sums + 1]
    equal = (numbers[:, first] == numbers[:, second]).all(axis=0)
    return first[equal], second[equal]


def _are_copies(position: Array, equal: int) -> bool:
    """Return whether ``equal`` pairs of equal positions ``(3, N)`` are too many for chance.

    By chance, many more pairs differ in the last digits than agree in all of them.
    """
    steps = position / _COARSE
    if np.count_nonzero(np.abs(steps - np.round(steps)) > 1e-4) < 0.5 * position.size:
        return False
    distinct = np.unique(position, axis=1)
    cells = np.unique(np.floor(distinct / _CELL), axis=1, return_counts=True)[1]
    near = float(np.sum(cells * (cells - 1)) / 2)
    return near < _NEAR_PER_EQUAL * equal


def _found(
    values: Values, pairs: tuple[NDArray[np.int64], NDArray[np.int64]], where: str, file: str, counted: Counted
) -> DuplicateRows:
    """Return the later rows of the pairs, and a warning with that whose copy comes first as the example."""
    first, second = pairs
    i = int(np.argmin(values.lines[second]))
    count = first.size
    rows = f"{count} row{'s repeat' if count > 1 else ' repeats'} {where}"
    example = f"{counted} {int(values.lines[second[i]])} repeats {counted} {int(values.lines[first[i]])}"
    copies = np.zeros(values.lines.size, dtype=bool)
    copies[second] = True
    warning = f"{file}: {rows} ({example}); every row counts as a measurement, so delete copies"
    return DuplicateRows((warning,), copies)


QUATERNION_TOLERANCE = 1e-3
SPEED_TOLERANCE = 1e-6
ABSOLUTE_ZERO = -273.15
READ_BACK_TOLERANCE = 0.1
"""rad or m; an arm that stands is never as far from its command."""
LARGEST_PAYLOAD = 5000.0
"""kg; twice that of the strongest arm."""
SMALLEST_SIGMA = 1e-12
"""m or rad; below it a weight 1/sigma^2 makes the other rows negligible."""
_LARGEST: Mapping[str, float] = {"length": 1e8, "angle": 1e6, "joint": 1e8, "number": 1e12}
"""m (geocentric coordinates are 6.4e6), rad, m or rad for a joint, and the units of circumstances."""


class RowChecks:
    """Checks of each row's values; problems go to the log, small excesses of limits to :attr:`warnings`."""

    def __init__(self, values: Values, log: ProblemLog, *, ignore_limits: bool = False) -> None:
        """Check ``values`` and report problems to ``log``; ``ignore_limits`` makes warnings of all excesses."""
        self.values = values
        self.log = log
        self.ignore_limits = ignore_limits
        self.warnings: list[str] = []

    def run(self, limits: JointLimits | None, target_names: Sequence[str] | None, skip_limits: frozenset[str]) -> None:
        """Run every check but that of :meth:`check_magnitudes`.

        Args:
            limits: Lowest and highest value of each joint (rad or m), None for a joint without limits.
            target_names: Targets, as in :func:`robacc.poses.csv_file.read_poses`.
            skip_limits: Joints whose unit is wrong; a limit check of every row would repeat that problem.

        Where the file lacks joints, its columns may belong to others: no limit is checked.
        """
        for keys in (QUATERNION, COMMANDED_QUATERNION):
            self._quaternion(keys)
        layout = self.values.layout
        if all(key in layout.columns for key in layout.joints()):
            for key, limit in zip(layout.joints(), limits or (), strict=False):
                if limit is not None and key not in skip_limits:
                    self._limits(key, limit)
        for key in self.values.layout.joints("dir_"):
            self._column(key, lambda v: ~np.isin(v, (-1.0, 0.0, 1.0)), "expected -1, 0 or 1")
        for key in self.values.layout.joints("speed_"):
            self._column(key, lambda v: np.abs(v) > 1 + SPEED_TOLERANCE, "expected a fraction of full speed, -1 to 1")
        self._read_back()
        for key in (*SIGMAS, "sigma_r"):
            self._column(key, lambda v: v <= 0, "expected a standard deviation above 0")
            self._column(
                key, lambda v: (v > 0) & (v < SMALLEST_SIGMA), f"expected at least {SMALLEST_SIGMA:g} m or rad"
            )
        self._column("payload_kg", lambda v: v < 0, "expected 0 kg or more")
        self._column("temperature_c", lambda v: v < ABSOLUTE_ZERO, f"expected {ABSOLUTE_ZERO} degrees Celsius or more")
        if (payload := self.values.column("payload_kg")) is not None and (heavy := payload > LARGEST_PAYLOAD).any():
            self.warnings.append(
                f"{self.log.at(int(self.values.lines[np.argmax(heavy)]))}: payload_kg is {payload[heavy][0]:g} kg, "
                "more than an arm carries"
            )
        self._targets(target_names)

    def check_magnitudes(self) -> None:
        """Report numbers that are too large to compute with and set them to NaN; run this check first."""
        for key, column in self.values.layout.columns.items():
            limit, value = _LARGEST.get(column.kind), self.values.column(key)
            if limit is not None and value is not None:
                limit_text = f"{limit * column.divisor:g}{f' {column.unit}' if column.unit else ''}"
                self._column(key, lambda v, limit=limit: np.abs(v) > limit, f"expected at most {limit_text}")  # type: ignore[misc]
                value[np.abs(value) > limit] = np.nan

    def _quaternion(self, keys: Sequence[str]) -> None:
        quaternion = self.values.column_set(keys)
        if quaternion is None:
            return
        with np.errstate(over="ignore"):
            length = np.sqrt(np.einsum("in,in->n", quaternion, quaternion))
        self.log.add_rows(
            np.abs(length - 1) > QUATERNION_TOLERANCE,
            self.values.lines,
            ", ".join(self.values.layout.columns[key].name for key in keys),
            lambda i: f"found a quaternion of length {length[i]:.6g}, expected 1 within {QUATERNION_TOLERANCE:g}",
        )

    def _read_back(self) -> None:
        """Report joints that were read back far from their command: another unit, another order, or another row."""
        for key in self.values.layout.joints():
            command, value = self.values.column(key), self.values.column(f"read_{key}")
            column = self.values.layout.columns.get(f"read_{key}")
            if command is None or value is None or column is None or not column.name.startswith("read_"):
                continue
            with np.errstate(invalid="ignore"):
                far = np.abs(value - command) > READ_BACK_TOLERANCE
            self.log.add_rows(
                far,
                self.values.lines,
                column.name,
                lambda i, value=value, command=command: (  # type: ignore[misc]
                    f"found {value[i]:.6g}, but the commanded joint is {command[i]:.6g} (rad or m); check the unit and "
                    "the order of the columns read back"
                ),
            )

    def _limits(self, key: str, limits: tuple[float, float]) -> None:
        column = self.values.layout.columns.get(key)
        if column is None:
            return
        value = self.values.column(key)
        if value is None:
            return
        unit = f" {column.unit}" if column.unit else ""
        low, high = (limit * column.divisor for limit in limits)
        limits_text = f"{low:.6g} to {high:.6g}{unit}"
        tolerance = np.inf if self.ignore_limits else EXCESS_TOLERANCE.get(column.kind, EXCESS_TOLERANCE["length"])
        excess = excess_beyond_limits(value, limits)
        small = (excess > 0) & (excess <= tolerance)
        if small.any():
            self._warn_of_excess(column.name, limits_text, f"{excess[small].max() * column.divisor:.3g}{unit}", small)
        fix = "`ignore_limits` uses these rows all the same"
        if column.unit == "rad" and degrees_likely(value, limits):
            fix = "if the joints are in degrees, name the columns as in q1_deg, or give `units` with deg; else " + fix
        self.log.add_rows(
            excess > tolerance,
            self.values.lines,
            column.name,
            lambda i: (
                f"found {value[i] * column.divisor:.10g}{unit}, expected a value within the joint's limits "
                f"{limits_text}"
            ),
            fix,
        )

    def _warn_of_excess(self, name: str, limits_text: str, excess_text: str, rows: NDArray[np.bool_]) -> None:
        count = int(np.count_nonzero(rows))
        first = int(self.values.lines[np.argmax(rows)])
        self.warnings.append(
            f"{self.log.at(first)}: {name} exceeds the joint's limits {limits_text} by at most {excess_text} "
            f"in {count} {'row' if count == 1 else 'rows'}, which {'is' if count == 1 else 'are'} used"
        )

    def _column(self, key: str, test: Callable[[Array], NDArray[np.bool_]], expected: str) -> None:
        value = self.values.column(key)
        if value is None:
            return
        column = self.values.layout.columns[key]
        unit = f" {column.unit}" if column.unit else ""
        with np.errstate(invalid="ignore"):
            failed = test(value) & ~np.isnan(value)
        describe: Callable[[int], str] = lambda i: f"found {value[i] * column.divisor:.10g}{unit}, {expected}"  # noqa: E731
        self.log.add_rows(failed, self.values.lines, column.name, describe)

    def _targets(self, target_names: Sequence[str] | None) -> None:
        target = self.values.texts.get("target")
        if target is None or target_names is None:
            return
        if not target_names:
            # The robot's tool is not used where the file has commanded poses.
            if self.values.layout.group(self.values.layout.joints()) is not None:
                self._single_target(target)
            return
        unknown = ~np.isin(target, target_names) & (target != "")

        def describe(i: int) -> str:
            import difflib

            nearest = difflib.get_close_matches(str(target[i]), target_names, n=1, cutoff=0.0)[0]
            expected = f"expected a target of the robot file ({listing(target_names)})"
            return f"found {clip(str(target[i]))}, {expected}; the nearest is {nearest}"

        self.log.add_rows(unknown, self.values.lines, "target", describe)

    def _single_target(self, target: NDArray[np.str_]) -> None:
        """Report several targets for a robot with one tool: the tool would be wrong for all but one of them."""
        names = list(dict.fromkeys(target[target != ""].tolist()))
        if len(names) > 1:
            names_text = listing([clip(name) for name in names])
            message = f"found several targets ({names_text}), but the robot has one tool and no targets"
            fix = (
                "fit tool_frame, which finds their places (`align` of estimate, `fit` of calibrate; a trace does), "
                "list each target under targets: in the robot file instead of tool, or keep the rows of one target"
            )
            self.log.add(message, int(self.values.lines[np.argmax(target == names[1])]), "target", fix)
