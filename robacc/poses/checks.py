"""Checks of a pose file: values row by row, and the units of columns without a unit in their names."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.geometry import Array
from robacc.io.problem_log import ProblemLog, clip
from robacc.poses.columns import AXES, QUATERNION, SIGMAS
from robacc.poses.foreign_columns import compact
from robacc.poses.layout import Layout, listing
from robacc.poses.plausibility import (
    EXCESS_TOLERANCE,
    angle_beyond_turn,
    degrees_likely,
    doubtful_sigma,
    excess_beyond_limits,
    lengths_too_large,
    outside_limits,
    thousandfold,
)

Limits = Sequence[tuple[float, float] | None]

QUATERNION_TOLERANCE = 1e-3
SPEED_TOLERANCE = 1e-6
ABSOLUTE_ZERO = -273.15
SMALLEST_SIGMA = 1e-12
"""m or rad; below it a weight 1/sigma^2 makes the other rows negligible."""
_LARGEST: Mapping[str, float] = {"length": 1e8, "angle": 1e6, "joint": 1e8, "number": 1e12}
"""m (geocentric coordinates are 6.4e6), rad, m or rad for a joint, and the units of circumstances."""
COMMANDED_QUATERNION = tuple(f"cmd_{name}" for name in QUATERNION)
COMMANDED_AXES = tuple(f"cmd_{axis}" for axis in AXES)


@dataclass(frozen=True, slots=True)
class Values:
    """Values of the columns in use, SI."""

    layout: Layout
    numbers: Array
    """``(C, N)``; NaN where a value could not be read."""
    row_index: Mapping[str, int]
    """Row of ``numbers`` by key; the keys of a set are adjacent."""
    texts: Mapping[str, NDArray[np.str_]]
    lines: NDArray[np.int64]
    """``(N,)`` line of the file, from 1."""

    def column(self, key: str) -> Array | None:
        """Return one column ``(N,)``; None where the file does not have it."""
        return self.numbers[self.row_index[key]] if key in self.row_index else None

    def column_set(self, keys: Sequence[str]) -> Array | None:
        """Return a set of columns ``(len(keys), N)`` without copying; None where one of them is missing."""
        if not keys or any(key not in self.row_index for key in keys):
            return None
        start = self.row_index[keys[0]]
        return self.numbers[start : start + len(keys)]

    def complete(self) -> Values:
        """Return the rows in which every number could be read."""
        complete = np.isfinite(self.numbers).all(axis=0)
        texts = {key: text[complete] for key, text in self.texts.items()}
        return Values(self.layout, self.numbers[:, complete], self.row_index, texts, self.lines[complete])


class RowChecks:
    """Checks of each row's values; problems go to the log, small excesses of limits to :attr:`warnings`."""

    def __init__(self, values: Values, log: ProblemLog, *, ignore_limits: bool = False) -> None:
        """Check ``values`` and report problems to ``log``; ``ignore_limits`` makes warnings of all excesses."""
        self.values = values
        self.log = log
        self.ignore_limits = ignore_limits
        self.warnings: list[str] = []

    def run(self, limits: Limits | None, target_names: Sequence[str] | None, skip_limits: frozenset[str]) -> None:
        """Run every check but that of :meth:`check_magnitudes`.

        Args:
            limits: Lowest and highest value of each joint (rad or m), None for a joint without limits.
            target_names: Targets, as in :func:`robacc.poses.csv_file.read_poses`.
            skip_limits: Joints whose unit is wrong; a limit check of every row would repeat that problem.
        """
        for keys in (QUATERNION, COMMANDED_QUATERNION):
            self._quaternion(keys)
        for key, limit in zip(self.values.layout.joints(), limits or (), strict=False):
            if limit is not None and key not in skip_limits:
                self._limits(key, limit)
        for key in self.values.layout.joints("dir_"):
            self._column(key, lambda v: ~np.isin(v, (-1.0, 0.0, 1.0)), "expected -1, 0 or 1")
        for key in self.values.layout.joints("speed_"):
            self._column(key, lambda v: np.abs(v) > 1 + SPEED_TOLERANCE, "expected a fraction of full speed, -1 to 1")
        for key in (*SIGMAS, "sigma_r"):
            self._column(key, lambda v: v <= 0, "expected a standard deviation above 0")
            self._column(
                key, lambda v: (v > 0) & (v < SMALLEST_SIGMA), f"expected at least {SMALLEST_SIGMA:g} m or rad"
            )
        self._column("payload_kg", lambda v: v < 0, "expected 0 kg or more")
        self._column("temperature_c", lambda v: v < ABSOLUTE_ZERO, f"expected {ABSOLUTE_ZERO} degrees Celsius or more")
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
        self.log.add_rows(
            excess > tolerance,
            self.values.lines,
            column.name,
            lambda i: (
                f"found {value[i] * column.divisor:.10g}{unit}, expected a value within the joint's limits "
                f"{limits_text}"
            ),
            "`ignore_limits` uses these rows all the same",
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
            fix = "list each target under targets: in the robot file instead of tool, or keep the rows of one target"
            self.log.add(message, int(self.values.lines[np.argmax(target == names[1])]), "target", fix)


class UnitChecks:
    """Checks of columns without a unit in their names; problems go to the log, doubts to :attr:`warnings`."""

    def __init__(self, values: Values, log: ProblemLog, line: int | None) -> None:
        """Check ``values``, in which every number could be read; ``line`` is the header's line."""
        self.values = values
        self.log = log
        self.line = line
        self.warnings: list[str] = []

    def run(self, limits: Limits | None) -> frozenset[str]:
        """Run every check and return the joints whose unit is wrong."""
        if self.values.lines.size == 0:
            return frozenset()
        layout = self.values.layout
        if layout.without_unit:
            return self._ask_units()
        wrong_joints = self._joints(limits)
        too_large = [keys for keys in (AXES, COMMANDED_AXES) if self._lengths(keys)]
        if not too_large:
            self._scales()
        for keys in (layout.orientation, layout.commanded_orientation):
            if keys is not None and len(keys) == 3:
                self._angles(keys)
        for keys in (SIGMAS, ("sigma_r",)):
            self._sigma(keys)
        return wrong_joints

    def _ask_units(self) -> frozenset[str]:
        """Report the columns of an export that need a unit, with what their values suggest; return their joints."""
        columns = self.values.layout.without_unit
        sizes = {}
        for kind, quantity in (("length", "lengths"), ("angle", "angles"), ("joint", "joint variables")):
            values = [self.values.column(column.key) for column in columns if column.kind == kind]
            largest = max((float(np.max(np.abs(value))) for value in values if value is not None), default=None)
            if largest is not None:
                sizes[quantity] = f"{quantity} up to {largest:.4g}"
        self.log.add(
            f"these columns state no unit ({', '.join(sizes.values())})",
            self.line,
            compact([column.name for column in columns]),
            "give `units`, for example mm,deg or m,rad",
        )
        return frozenset(self.values.layout.joints())

    def _refuse(self, keys: Sequence[str], message: str, unit: str, likely_unit: str) -> None:
        columns = [self.values.layout.columns[key] for key in keys]
        names = [column.name for column in columns]
        new_names = listing([f"{name}_{likely_unit}" for name in names])
        fix = f"if they are in {likely_unit}, name the columns {new_names}; if in {unit}, {names[0]}_{unit} and so on"
        self.log.add(message, self.line, listing(names), fix)

    def _bare(self, keys: Sequence[str]) -> Array | None:
        """Return a set of columns without units in their names; None for any other set."""
        group = self.values.layout.group(keys)
        if group is None or any(column.unit is not None for column in group):
            return None
        return self.values.column_set(keys)

    def _joints(self, limits: Limits | None) -> frozenset[str]:
        degrees: list[str] = []
        millimetres: list[str] = []
        largest = 0.0
        for i, key in enumerate(self.values.layout.joints()):
            q = self._bare((key,))
            if q is None:
                continue
            limit = limits[i] if limits is not None and i < len(limits) else None
            if self.values.layout.columns[key].kind == "length":
                if np.max(np.abs(q)) > 50.0 and (limit is None or outside_limits(q[0], limit).any()):
                    millimetres.append(key)
            elif degrees_likely(q[0], limit):
                degrees.append(key)
                largest = max(largest, float(np.max(np.abs(q))))
        if degrees:
            self._refuse(degrees, f"found joint angles up to {largest:.4g}, which cannot be rad", "rad", "deg")
        if millimetres:
            self._refuse(millimetres, "found joint travels of more than 50, which cannot be m", "m", "mm")
        if not degrees:
            return frozenset(millimetres)
        # One joint in degrees means all of them: limit checks of those that turned little would repeat the problem.
        columns = self.values.layout.columns
        return frozenset(
            key
            for key in self.values.layout.joints()
            if key in millimetres or (key in columns and columns[key].kind != "length" and columns[key].unit is None)
        )

    def _lengths(self, keys: Sequence[str]) -> bool:
        position = self._bare(keys)
        if position is None or not lengths_too_large(position):
            return False
        largest = float(np.max(np.abs(position)))
        self._refuse(keys, f"found positions up to {largest:.4g}, which cannot be m", "m", "mm")
        return True

    def _scales(self) -> None:
        """Report attained and commanded positions of which one is in mm."""
        attained, commanded = self.values.column_set(AXES), self.values.column_set(COMMANDED_AXES)
        if attained is None or commanded is None or attained.shape[1] < 2:
            return
        ratio = thousandfold(attained, commanded)
        if ratio is None:
            return
        names = [self.values.layout.columns[key].name for key in (*AXES, *COMMANDED_AXES)]
        message = f"attained positions spread {ratio:.3g} times as far as commanded ones, so one of the two is in mm"
        self.log.add(
            message, self.line, ", ".join(names), "put the unit in the columns' names, for example x_mm and cmd_x_m"
        )

    def _angles(self, keys: Sequence[str]) -> None:
        angles = self._bare(keys)
        if angles is not None and angle_beyond_turn(angles):
            largest = float(np.max(np.abs(angles)))
            self._refuse(keys, f"found angles up to {largest:.4g}, which cannot be rad", "rad", "deg")

    def _sigma(self, keys: Sequence[str]) -> None:
        sigma = self._bare(keys)
        if sigma is None:
            return
        kind = self.values.layout.columns[keys[0]].kind
        unit, likely_unit = ("m", "mm") if kind == "length" else ("rad", "deg")
        impossible, doubtful = doubtful_sigma(sigma, kind)
        message = f"found a typical measuring uncertainty of {float(np.median(sigma)):.3g} {unit}"
        if impossible:
            self._refuse(keys, f"{message}, which no instrument has", unit, likely_unit)
        elif doubtful:
            names = listing([f"{key}_{likely_unit}" for key in keys])
            self.warnings.append(f"{self.log.at(self.line)}: {message}; if it is in {likely_unit}, name it {names}")
