"""Checks of the units of columns without a unit in their names."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from robacc.geometry import Array
from robacc.io.problem_log import ProblemLog
from robacc.poses.columns import AXES, SIGMAS
from robacc.poses.foreign_columns import compact
from robacc.poses.known_robot import JointLimits
from robacc.poses.layout import listing
from robacc.poses.plausibility import (
    TURN,
    angle_beyond_turn,
    degrees_likely,
    doubtful_sigma,
    lengths_too_large,
    outside_limits,
    plausible_sigma,
    thousandfold,
)
from robacc.poses.values import COMMANDED_AXES, Values

_FEWEST_OTHERS = 5
"""Rows outside a stretch in another unit, at least …"""
_LEAST_OTHERS = 0.1
"""… and their least share of all rows."""
_MOSTLY = 0.8
"""Least share of the rows of a stretch that show its unit."""
_MOST_METRES = 30.0
"""Coordinate of a measured position from which it shows that it is in mm."""


class UnitChecks:
    """Checks of columns without a unit in their names; problems go to the log, doubts to :attr:`warnings`."""

    def __init__(self, values: Values, log: ProblemLog, line: int | None) -> None:
        """Check ``values``, in which every number could be read; ``line`` is the header's line."""
        self.values = values
        self.log = log
        self.line = line
        self.warnings: list[str] = []

    def run(self, limits: JointLimits | None) -> frozenset[str]:
        """Run every check and return the joints whose unit is wrong."""
        if self.values.lines.size == 0:
            return frozenset()
        layout = self.values.layout
        if layout.wrong_unit:
            return frozenset(layout.joints())
        if layout.without_unit:
            return self._ask_units()
        self._ask_unit_of_sigma()
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
            "give `units`, for example mm,deg or m,rad, or write the units into the names, as in q1_deg",
        )
        return frozenset(self.values.layout.joints())

    def _ask_unit_of_sigma(self) -> None:
        """Report uncertainties that are too large or too small in the unit of the position."""
        layout = self.values.layout
        sigma = self.values.column_set(SIGMAS)
        if not layout.unit_of_position or sigma is None or plausible_sigma(sigma):
            return
        columns = [layout.columns[key] for key in layout.unit_of_position]
        typical = float(np.median(sigma)) * columns[0].divisor
        self.log.add(
            f"these columns state no unit, and {typical:.3g} {columns[0].unit} is not a usual measuring uncertainty",
            self.line,
            compact([column.name for column in columns]),
            "give their unit with `units`, for example um, or write it into the names, as in Ux (um)",
        )

    def _refuse(
        self, keys: Sequence[str], message: str, unit: str, likely_unit: str, large: NDArray[np.bool_] | None = None
    ) -> None:
        """Report columns in another unit; ``large`` ``(N,)`` are the rows that show it."""
        columns = [self.values.layout.columns[key] for key in keys]
        names = [column.name for column in columns]
        stretch = None if large is None else self._stretch(large)
        if stretch is not None:
            message = f"{message}, from line {stretch[0]} to {stretch[1]} only"
            fix = f"these lines seem to be in {likely_unit} and the others in {unit}; convert one part of the file"
            self.log.add(message, self.line, listing(names), fix)
            return
        new_names = listing([f"{name}_{likely_unit}" for name in names])
        fix = f"if they are in {likely_unit}, name the columns {new_names}; if in {unit}, {names[0]}_{unit} and so on"
        self.log.add(message, self.line, listing(names), fix)

    def _stretch(self, large: NDArray[np.bool_]) -> tuple[int, int] | None:
        """Return the first and last line of the rows that are ``large`` ``(N,)``, if these are one part of the file."""
        rows = np.flatnonzero(large)
        if rows.size == 0:
            return None
        first, last = int(rows[0]), int(rows[-1])
        others = large.size - (last + 1 - first)
        if others < max(_FEWEST_OTHERS, _LEAST_OTHERS * large.size) or np.mean(large[first : last + 1]) < _MOSTLY:
            return None
        return int(self.values.lines[first]), int(self.values.lines[last])

    def _bare(self, keys: Sequence[str]) -> Array | None:
        """Return a set of columns without units in their names; None for any other set."""
        group = self.values.layout.group(keys)
        if group is None or any(column.unit is not None for column in group):
            return None
        return self.values.column_set(keys)

    def _joints(self, limits: JointLimits | None) -> frozenset[str]:
        degrees: list[str] = []
        millimetres: list[str] = []
        largest = 0.0
        large = np.zeros(self.values.lines.size, dtype=bool)
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
                large |= np.abs(q[0]) > TURN
        if degrees:
            self._refuse(degrees, f"found joint angles up to {largest:.4g}, which cannot be rad", "rad", "deg", large)
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
        far = np.max(np.abs(position), axis=0) > _MOST_METRES
        self._refuse(keys, f"found positions up to {largest:.4g}, which cannot be m", "m", "mm", far)
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
        message = f"attained positions spread {ratio:.3g} times as far as commanded positions, so one of them is in mm"
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
