"""Other kinds of measurement in a pose file: the target in a socket, on a plane, at a distance, and points in photos.

A row has the joints of its pose, a column ``kind`` where the file has several kinds, and the columns of its kind:

- ``point``: ``socket``, the name of a socket in which the target rests at the same unknown point;
- ``plane``: ``plane``, the name of an unknown plane, and ``reading``, the height of the target above it (default 0);
- ``distance``: ``distance``, and either ``anchor``, the name of an unknown fixed point, or ``from``, the pose of an
  earlier row (one without any of the three is such a pose alone);
- ``image``: ``u_px`` and ``v_px``, the pixel at which a ``camera`` shows the point ``board_x``, ``board_y``,
  ``board_z`` (default 0) of a board: one row for each point of a photo;
- ``position``: ``x``, ``y``, ``z``.

``sigma`` is the standard deviation of the measured number. Lengths have a unit in the name, or are in m.
"""

from __future__ import annotations

import math
import statistics
from bisect import bisect_left
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from robacc.errors import Note
from robacc.geometry import Array
from robacc.io.dialect import number_of
from robacc.io.files import clip
from robacc.io.table import Table, TableBody
from robacc.measurements import IMAGES, Measurements
from robacc.poses.cameras import calibrated, photos_of, rays_of, read_cameras, three_points
from robacc.poses.columns import AXES, UNITS, Heading, heading_of, labelled, source_of
from robacc.poses.layout import listing
from robacc.poses.motion import numbered, numbered_visits
from robacc.poses.reading import Reading
from robacc.poses.reshaped_tables import ReshapedTable, Rows
from robacc.poses.row_checks import SMALLEST_SIGMA

_NAMED_BY = {"point": ("socket",), "plane": ("plane",), "distance": ("anchor", "from")}
"""Columns that name what a row of each kind is measured from."""
_PIXELS = ("u_px", "v_px")
_BOARD = ("board_x", "board_y", "board_z")
_LENGTHS = ("distance", "reading", "sigma", *AXES, *_BOARD)
_TEXTS = ("kind", "socket", "plane", "anchor", "from", "camera", *_PIXELS)
_LARGEST = 100.0
"""m; a larger length is in another unit."""
_LEAST_PIXELS = 1e-3
"""px; no corner is found as well."""
_FAR_OFF = 1.0
"""px; points that are found well lie a tenth to a third of it off the board that the lens shows."""
_MOST_PIXELS = 1e5
"""px; no sensor is wider."""


def _key(heading: Heading) -> str:
    """Return the key of a column: its name without capitals, and without the unit of a length."""
    text = heading.text.replace(" ", "_")
    return text if text in _LENGTHS else heading.name.lower()


class KindTable(ReshapedTable):
    """Table without the columns of other kinds of measurement, whose cells it keeps."""

    def __init__(self, table: Table, apart: Mapping[str, int], unit: str, cameras: str | None) -> None:
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
        self._cameras = cameras
        self._names = {key: table.names[index] for key, index in apart.items()}
        self._cells: dict[str, list[str]] = {}

    @classmethod
    def of(cls, table: Table, reading: Reading) -> KindTable | None:
        """Return the table without its columns of other kinds of measurement; None if it has none."""
        headings = [*map(heading_of, table.names)]
        keys = {_key(heading): i for i, heading in enumerate(headings)}
        apart = {key: keys[key] for key in (*_TEXTS, *_LENGTHS) if key in keys}
        is_other = not {"distance", "socket", "plane", *_PIXELS}.isdisjoint(apart)
        others = [each for each in headings if _key(each) not in (*_BOARD, *_PIXELS)]
        parts = [part for each in others if (part := labelled(each)) and source_of(each.words) >= 0]
        if not is_other or (any(axis != "turn" for _, axis in parts) and "kind" not in apart):
            return None
        return cls(table, apart, reading.unit_of.get("length", "m"), reading.camera)

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
            position[axis] = self._numbers(key, kinds == "position", data)
        position[2] += self._numbers("distance", (kinds == "distance") & ~is_start, data, least=0.0)
        position[2] += self._numbers("reading", kinds == "plane", data, 0.0)
        of_lengths = ~is_start & (kinds != "image")
        sigma = self._numbers("sigma", of_lengths, data, least=SMALLEST_SIGMA) if "sigma" in cells else None
        if data.sigma_position is not None:
            self.log.add("sigma_x, sigma_y and sigma_z are of positions", self.line, fix="give one column sigma")
        if data.rotation is not None:
            self.log.warn("orientation is not used beside other kinds of measurement", of_file=True)
        self.log.raise_if_any()
        data = replace(
            data,
            rotation=None,
            sigma_rotation=None,
            position=position,
            sigma_position=None if sigma is None else np.tile(sigma, (3, 1)),
            kind=kinds,
            fixture=np.array(fixture),
            reference=None if earlier == list(range(n)) else data.subset(np.array(earlier)),
            copies=None,
        )
        data = self._with_images(data.subset(~is_start))
        self.log.raise_if_any()
        return replace(data, warnings=self.log.warnings)

    def _kinds(self, data: Measurements) -> NDArray[np.str_]:
        """Return the kind of each row."""
        named = {**_NAMED_BY, "image": _PIXELS}
        found = [kind for kind, names in named.items() if not self._cells.keys().isdisjoint((kind, *names))]
        if "kind" not in self._cells and len(found) > 1:
            self.log.add(f"the file has columns of the kinds {' and '.join(found)}", self.line, fix="add a column kind")
            self.log.raise_if_any()
        known = ("position", *named)
        kinds = [kind.lower() for kind in self._cells.get("kind", [found[0]] * data.n)]
        for row, kind in enumerate(kinds):
            if kind not in known:
                fix = (
                    "beside other kinds, name the row position: its orientation is not used" if kind == "pose" else None
                )
                self._add(f"found {kind!r}, expected one of {', '.join(known)}", data, row, "kind", fix)
        return np.array(kinds, dtype=str)

    def _with_images(self, data: Measurements) -> Measurements:
        """Return the data with what rows of kind image show, and with the photos they are from as visits."""
        assert data.kind is not None
        assert data.fixture is not None
        rows = data.kind == "image"
        if not rows.any():
            return data
        if self._cameras is None:
            self.log.add("images need the camera that took them", self.line, fix="give its file as `camera`")
        for key in (key for key in (*_PIXELS, *_BOARD[:2]) if key not in self._cells):
            self.log.add(f"images need the column {key}, which is missing", self.line)
        if "sigma" in self._cells and heading_of(self._names["sigma"]).unit is not None:
            self.log.add("the sigma of images is in px", self.line, self._names["sigma"], "name the column sigma")
        self.log.raise_if_any()
        known, names = read_cameras(self._cameras or ""), np.array(self._column("camera"))
        pixels = np.stack([self._numbers(key, rows, data) for key in _PIXELS])
        points = np.stack([self._numbers(key, rows, data, 0.0 if key == "board_z" else None) for key in _BOARD])
        noise = self._numbers("sigma", rows, data, least=_LEAST_PIXELS, unit="px") if "sigma" in self._cells else None
        self.log.raise_if_any()
        values = np.vstack((pixels, points, *([] if data.q is None else [data.q])))
        first = np.zeros(data.n, dtype=bool)
        first[np.unique(values, axis=1, return_index=True)[1]] = True
        if copied := int(np.count_nonzero(rows & ~first)):
            self.log.warn(f"{copied} points repeat pixel and joints of earlier rows and are left out", of_file=True)
        stay, rows = ~rows, rows & first
        photo = data.visit
        if photo is None:
            poses = data.groups() if data.cycle is None else numbered(data.groups(), data.cycle)
            photo = numbered_visits(poses, None, None, numbered(names, *points), ordered=False).astype(str)
        seen, place, spread = (np.zeros((count, data.n)) for count in (4, 3, 6))
        turn, position = np.zeros((3, 3, data.n)), data.position.copy()
        sigma = np.zeros((3, data.n)) if data.sigma_position is None else data.sigma_position.copy()
        kind, fixture = data.kind.astype(object), data.fixture.astype(object)
        for name in np.unique(names[rows]).tolist():
            mine = np.flatnonzero(rows & (names == name))
            only = next(iter(known.values())) if len(known) == 1 and name == "" else known.get("")
            if (camera := known.get(name, only)) is None:
                expected = f"expected a camera of {self._cameras}: {', '.join(known)}"
                self._add(f"found {name!r}, {expected}", data, int(mine[0]), "camera")
                continue
            of_board = points[:, mine], photo[mine]
            try:
                camera = calibrated(camera, pixels[:, mine], *of_board)
                rays = camera.rays(pixels[:, mine])
                for row in mine[np.isnan(rays).any(axis=0)].tolist():
                    self._add("the lens of the camera cannot show anything at this pixel", data, row, "u_px")
                self.log.raise_if_any()
                photos, rest = photos_of(rays, *of_board)
            except ValueError as error:
                self._add(str(error), data, int(mine[0]), fix="check u_px, v_px, board_x, board_y and the camera")
                continue
            depth = statistics.median(float(each.pose.translation[2]) for each in photos)
            focal, used = float(np.mean(camera.focal)), sum(each.rows.size for each in photos)
            for each in photos:
                # Three points stand for the photo: their six numbers are its pose.
                of_photo = mine[each.rows]
                three, corners = of_photo[:3], three_points(points[:, of_photo])
                std = rest if noise is None else math.sqrt(np.mean(np.square(noise[of_photo]))) / focal
                shown = each.of_camera() if camera.is_on_hand else each
                stay[three], seen[:3, three], seen[3, three] = True, corners, depth
                position[:2, three] = depth * rays_of(each.pose, corners)
                sigma[:, three] = depth * std * math.sqrt(3.0 / of_photo.size)
                place[:, three], turn[..., three] = shown.pose.translation[:, None], shown.pose.rotation[..., None]
                spread[:, three] = std * np.sqrt(np.diag(shown.covariance))[:, None]
            kind[mine], fixture[mine] = IMAGES[camera.is_on_hand], "board" if camera.is_on_hand else name or "camera"
            taken, lost = np.unique(photo[mine]), {*photo[mine]} - {photo[mine[each.rows[0]]] for each in photos}
            begins = [data.place(int(mine[photo[mine] == name][0])) for name in sorted(lost)]
            lens = ", ".join(f"{value:.5g}" for value in (*camera.focal, *camera.centre))
            text = (
                f"{f'camera {name}: ' if name else ''}{used} of {mine.size} points in {len(photos)} of {taken.size} "
                "photos are "
                f"{rest * focal:.2g} px (rms) off the board, with fx, fy, cx, cy of {lens}"
                f"{'; photos that do not show the board begin at ' * bool(lost)}{listing(begins)}"
            )
            if rest * focal > _FAR_OFF:
                text += "; usual is a third of a pixel or less: check the lens, its size, and the sizes of the board"
            self.log.warn(Note(text) if used == mine.size and rest * focal <= _FAR_OFF else text, of_file=True)
        if data.direction is not None and data.speed is not None:  # The points of a photo were reached by one motion.
            _, begin, which = np.unique(photo, return_index=True, return_inverse=True)
            begin = np.where(rows, begin[which], np.arange(data.n))
            data = replace(data, direction=data.direction[:, begin], speed=data.speed[:, begin])
        if len(known) > 1 and data.target is None and IMAGES[True] in kind:
            data = replace(data, target=np.where(kind == IMAGES[True], names, np.where(rows, "board", "")))
        return replace(
            data,
            kind=kind.astype(str),
            fixture=fixture.astype(str),
            position=position,
            sigma_position=sigma,
            visit=photo,
            seen=seen,
            photos=Measurements(
                place,
                turn,
                sigma_position=spread[:3],
                sigma_rotation=np.sqrt(np.square(spread[3:]).mean(axis=0)),
            ),
        ).subset(stay)

    def _column(self, key: str) -> list[str]:
        """Return the cells of a column, empty ones where the file has none."""
        return self._cells.get(key) or [""] * len(next(iter(self._cells.values())))

    def _numbers(
        self,
        key: str,
        rows: NDArray[np.bool_],
        data: Measurements,
        default: float | None = None,
        least: float = -np.inf,
        unit: str = "m",
    ) -> Array:
        """Return the numbers ``(N,)`` of a column in m or px, 0 outside the ``rows``; ``default`` is of empty cells."""
        values, cells = np.zeros(data.n), self._column(key)
        unit = "px" if key in _PIXELS else unit
        divisor, most = (1.0, _MOST_PIXELS) if unit == "px" else (UNITS[self._units[key]][1], _LARGEST)
        for row in np.flatnonzero(rows).tolist():
            value = number_of(cells[row], self.dialect.decimal_comma) if cells[row] else default
            if value is None or not np.isfinite(value):
                found = f"found {clip(cells[row])}" if cells[row] else "the value is missing"
                self._add(f"{found}, expected a number", data, row, key)
            elif not max(least, -most) <= value / divisor <= most:
                is_bare = unit == "m" and divisor == 1.0 and value > 0.0
                fix = f"name the column {key}_mm if it is in mm" if is_bare else None
                found = f"found {value / divisor:.4g} {unit}, expected {max(least, -most):g} to {most:g} {unit}"
                self._add(found, data, row, key, fix)
            else:
                values[row] = value / divisor
        return values

    def _add(self, message: str, data: Measurements, row: int, key: str | None = None, fix: str | None = None) -> None:
        """Add a problem of a row to the log."""
        self.log.add(message, data.line(row), None if key is None else self._names.get(key, key), fix)
