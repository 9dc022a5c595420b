"""Checks of the values of a pose file, row by row."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from robacc.geometry import Array
from robacc.io.problem_log import ProblemLog, clip
from robacc.poses.columns import QUATERNION, SIGMAS
from robacc.poses.known_robot import JointLimits
from robacc.poses.layout import listing
from robacc.poses.plausibility import EXCESS_TOLERANCE, degrees_likely, excess_beyond_limits
from robacc.poses.values import COMMANDED_QUATERNION, Values

QUATERNION_TOLERANCE = 1e-3
SPEED_TOLERANCE = 1e-6
ABSOLUTE_ZERO = -273.15
READ_BACK_TOLERANCE = 0.1
"""rad or m; an arm that stands is never as far from its command."""
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
