"""Other kinds of measurement in a pose file: the target in a socket, on a plane, and at measured distances.

A row has the joints of its pose, a column ``kind`` where the file has several kinds, and the columns of its kind:

- ``point``: ``socket``, the name of a socket in which the target rests at the same unknown point;
- ``plane``: ``plane``, the name of an unknown plane, and ``reading``, the height of the target above it (default 0);
- ``distance``: ``distance``, and either ``anchor``, the name of an unknown fixed point, or ``from``, the pose of an
  earlier row (one without any of the three is such a pose alone);
- ``position``: ``x``, ``y``, ``z``.

``sigma`` is the standard deviation of the measured number. Lengths have a unit in the name, or are in m.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from robacc.geometry import Array
from robacc.io.dialect import number_of
from robacc.io.files import clip
from robacc.io.table import Table, TableBody
from robacc.measurements import SHOWN, Measurements
from robacc.poses.columns import AXES, UNITS, Heading, heading_of, labelled, source_of
from robacc.poses.reading import Reading
from robacc.poses.reshaped_tables import ReshapedTable, Rows
from robacc.poses.row_checks import SMALLEST_SIGMA

_NAMED_BY = {"point": ("socket",), "plane": ("plane",), "distance": ("anchor", "from")}
"""Columns that name what a row of each kind is measured from."""
_LENGTHS = ("distance", "reading", "sigma", *AXES)
_TEXTS = ("kind", "socket", "plane", "anchor", "from")
_LARGEST = 100.0
"""m; a larger length is in another unit."""


def _key(heading: Heading) -> str:
    """Return the key of a column: its name without capitals, and without the unit of a length."""
    return heading.text if heading.text in _LENGTHS else heading.name.lower()


class KindTable(ReshapedTable):
    """Table without the columns of other kinds of measurement, whose cells it keeps."""

    def __init__(self, table: Table, apart: Mapping[str, int], unit: str) -> None:
        """Take the columns ``apart``, by their keys, out of a table; lengths without a unit are in ``unit``."""
        super().__init__(table, apart.values(), {}, ([], [*apart.values()]), self._keep, "")
        table.sparse = apart.values()
        self._units = dict.fromkeys(_LENGTHS, unit)
        for index, heading in enumerate(map(heading_of, table.names)):
            if (key := _key(heading)) in apart and apart[key] != index:
                self.log.add("the column is a duplicate", self.line, heading.name, "keep one of them")
            elif key in apart and heading.unit is not None and key in _LENGTHS:
                self._units[key] = heading.unit
                if UNITS[heading.unit][0] != "length":
                    self.log.add("expected a unit of length (m, mm, um)", self.line, heading.name)
        self._names = {key: table.names[index] for key, index in apart.items()}
        self._cells: dict[str, list[str]] = {}

    @classmethod
    def of(cls, table: Table, reading: Reading) -> KindTable | None:
        """Return the table without its columns of other kinds of measurement; None if it has none."""
        headings = [*map(heading_of, table.names)]
        keys = {_key(heading): i for i, heading in enumerate(headings)}
        apart = {key: keys[key] for key in (*_TEXTS, *_LENGTHS) if key in keys}
        is_other = not {"distance", "socket", "plane"}.isdisjoint(apart)
        parts = [part for each in headings if (part := labelled(each)) and source_of(each.words) >= 0]
        has_positions = any(axis != "turn" for _, axis in parts)
        stated = reading.unit_of.get("length", "m")
        return cls(table, apart, stated) if is_other and ("kind" in apart or not has_positions) else None

    def _keep(self, old: TableBody) -> Rows:
        self._cells = {key: column.tolist() for key, column in zip(self._names, old.texts, strict=True)}
        return np.arange(old.lines.size)[None], []

    def measured(self, data: Measurements) -> Measurements:
        """Return the commanded poses with what was measured at them.

        Raises:
            InputError: A row lacks what its kind needs; with every problem.
        """
        n, cells = data.n, self._cells
        kinds = self._kinds(data)
        position, fixture, earlier = np.zeros((3, n)), [""] * n, list(range(n))
        of_distance = [self._column(key) for key in ("distance", "anchor", "from")]
        is_start = np.array([not any(row) for row in zip(*of_distance, strict=True)], dtype=bool) & (
            kinds == "distance"
        )
        owners: dict[str, str] = {}
        rows_of: dict[str, list[int]] = {}
        for row, pose in enumerate([] if data.pose is None else data.pose.tolist()):
            rows_of.setdefault(pose, []).append(row)
        for row in np.flatnonzero(np.isin(kinds, [*_NAMED_BY]) & ~is_start).tolist():
            names = _NAMED_BY[str(kinds[row])]
            given = [key for key in names if key in cells and cells[key][row]]
            if len(given) != 1:
                found = "both" if given else "none"
                self._add(f"a row of kind {kinds[row]} needs {' or '.join(names)}, found {found}", data, row)
            elif given == ["from"]:
                same = rows_of.get(cells["from"][row], [])
                if before := bisect_left(same, row):
                    earlier[row] = same[before - 1]
                else:
                    fix = "name the rows in a column pose" if data.pose is None else None
                    self._add(f"no earlier row is of the pose {clip(cells['from'][row])}", data, row, "from", fix)
            elif owners.setdefault(cells[given[0]][row], given[0]) != given[0]:
                name, fix = cells[given[0]][row], "give every socket, plane and anchor its own name"
                self._add(f"{name} is also the name of a {owners[name]}", data, row, given[0], fix)
            else:
                fixture[row] = cells[given[0]][row]
        for axis, key in enumerate(AXES):
            position[axis] = self._lengths(key, kinds == "position", data)
        position[2] += self._lengths("distance", (kinds == "distance") & ~is_start, data, least=0.0)
        position[2] += self._lengths("reading", kinds == "plane", data, 0.0)
        sigma = self._lengths("sigma", ~is_start, data, least=SMALLEST_SIGMA) if "sigma" in cells else None
        if data.sigma_position is not None:
            self.log.add("sigma_x, sigma_y and sigma_z are of positions", self.line, fix="give one column sigma")
        if data.rotation is not None:
            self.log.warn("orientation is not used beside other kinds of measurement", of_file=True)
        self.log.raise_if_any()
        return replace(
            data,
            rotation=None,
            sigma_rotation=None,
            warnings=self.log.warnings,
            position=position,
            sigma_position=None if sigma is None else np.tile(sigma, (3, 1)),
            kind=kinds,
            fixture=np.array(fixture),
            reference=None if earlier == list(range(n)) else data.subset(np.array(earlier)),
            copies=None,
        ).subset(np.flatnonzero(~is_start))

    def _kinds(self, data: Measurements) -> NDArray[np.str_]:
        """Return the kind of each row."""
        found = [kind for kind, names in _NAMED_BY.items() if not self._cells.keys().isdisjoint((kind, *names))]
        if "kind" not in self._cells and len(found) > 1:
            self.log.add(f"the file has columns of the kinds {' and '.join(found)}", self.line, fix="add a column kind")
            self.log.raise_if_any()
        kinds = [kind.lower() for kind in self._cells.get("kind", [found[0]] * data.n)]
        for row, kind in enumerate(kinds):
            if kind not in SHOWN:
                fix = (
                    "beside other kinds, name the row position: its orientation is not used" if kind == "pose" else None
                )
                self._add(f"found {kind!r}, expected one of {', '.join(SHOWN)}", data, row, "kind", fix)
        return np.array(kinds, dtype=str)

    def _column(self, key: str) -> list[str]:
        """Return the cells of a column, empty ones where the file has none."""
        return self._cells.get(key) or [""] * len(next(iter(self._cells.values())))

    def _lengths(
        self,
        key: str,
        rows: NDArray[np.bool_],
        data: Measurements,
        default: float | None = None,
        least: float = -_LARGEST,
    ) -> Array:
        """Return the numbers ``(N,)`` of a column in m, 0 outside the ``rows``; ``default`` stands for empty cells."""
        values, cells = np.zeros(data.n), self._column(key)
        divisor = UNITS[self._units[key]][1]
        for row in np.flatnonzero(rows).tolist():
            value = number_of(cells[row], self.dialect.decimal_comma) if cells[row] else default
            if value is None or not np.isfinite(value):
                found = f"found {clip(cells[row])}" if cells[row] else "the value is missing"
                self._add(f"{found}, expected a number", data, row, key)
            elif not least <= value / divisor <= _LARGEST:
                fix = f"name the column {key}_mm if it is in mm" if value > 0.0 and divisor == 1.0 else None
                found = f"found {value / divisor:.4g} m, expected {least:g} to {_LARGEST:g} m"
                self._add(found, data, row, key, fix)
            else:
                values[row] = value / divisor
        return values

    def _add(self, message: str, data: Measurements, row: int, key: str | None = None, fix: str | None = None) -> None:
        """Add a problem of a row to the log."""
        self.log.add(message, data.line(row), None if key is None else self._names.get(key, key), fix)
