"""Measured poses as validated, read-only columns in SI units, poses last."""

from __future__ import annotations

import dataclasses
import zlib
from typing import Any, NamedTuple

import numpy as np

from robacc.errors import Counted
from robacc.geometry import Array, NDArray, Poses, rms_length

MOVES_UNUSED = "moves and is not used"
"""What a note of a column for an axis outside the robot says, at its end."""
STILL = 1e-6
"""rad or m; joints or commanded poses that differ by less are equal: below any encoder, above the rounding of files."""
ONE_COMMAND = 5e-4
"""rad or m; distance of two readings of a joint at one commanded pose at most. Servo errors are smaller, and the error
of an arm hardly changes over it."""
FAR = 0.05
"""Position error, as a share of the standard deviation of the positions, above which its cause is a frame or a unit,
not the arm, whose errors are some mm on a reach of a metre."""
IMAGES = ("image", "image from hand")
"""Kinds of images: of a camera beside the arm, and of one on its hand."""
SHOWN = {
    "position": (True, True, True),
    "point": (True, True, True),
    "line": (True, True, False),
    **dict.fromkeys(("plane", "sphere", "distance"), (False, False, True)),
    **dict.fromkeys(IMAGES, (True, True, False)),
}
"""Kinds of measurement, and which of three components each shows; see :mod:`robacc.modelling.model`."""


class Grouping(NamedTuple):
    """Assignment of rows to commanded poses."""

    numbers: NDArray[np.int64]
    """``(N,)`` from 0, equal for rows of the same pose."""
    contradicted: NDArray[np.bool_] | None = None
    """``(N,)`` rows whose commands contradict their id; None if there are none."""


@dataclasses.dataclass(frozen=True, slots=True, eq=False)
class Measurements:
    """N measured poses. A column that the file lacks is None; the others have no missing value."""

    position: Array
    """``(3, N)`` attained position of the target in the measuring frame, m; of other kinds of measurement, the measured
    number as z."""
    rotation: Array | None = None
    """``(3, 3, N)`` attained orientation."""
    q: Array | None = None
    """``(J, N)`` commanded joint variables, rad or m, in chain order."""
    commanded_position: Array | None = None
    commanded_rotation: Array | None = None
    sigma_position: Array | None = None
    """``(3, N)`` measuring uncertainty, one standard deviation along x, y, z of the measuring frame, m."""
    sigma_rotation: Array | None = None
    """``(N,)`` measuring uncertainty of the orientation about any axis, rad."""
    noise_covariance: Array | None = None
    """``(3, 3, N)`` covariance of the noise of each position in the measuring frame, m²: as the file states it, where
    ``sigma_position`` are the roots of its diagonal, or as a fit estimated it beyond equal noise; None if the noise
    along x, y, z is independent."""
    pose: NDArray[Any] | None = None
    """``(N,)`` id of the commanded pose, text."""
    cycle: NDArray[Any] | None = None
    target: NDArray[Any] | None = None
    """``(N,)`` name of the measured target, text."""
    kind: NDArray[Any] | None = None
    """``(N,)`` what each row shows, of :data:`SHOWN`; None: the position, and the orientation where there is one."""
    fixture: NDArray[Any] | None = None
    """``(N,)`` name of what a row is measured from, such as a socket or plane; empty for the measuring frame."""
    reference: Measurements | None = None
    """N poses that distances without an anchor are measured from."""
    seen: Array | None = None
    """``(5, N)`` point of a board, in its frame, of which a row is the image, the usual depth of such points before
    their camera, at which images are measured, m, and the focal length, px."""
    photos: Measurements | None = None
    """Pose of the board, or of a camera on the hand, as the photo of each row shows it; N poses."""
    visit: NDArray[Any] | None = None
    """``(N,)`` number or name of the arm's arrival, text: rows with the same visit were measured in one arrival."""
    time: Array | None = None
    """``(N,)`` s"""
    temperature: Array | None = None
    """``(N,)`` degrees Celsius"""
    payload: Array | None = None
    """``(N,)`` kg"""
    payload_group: NDArray[Any] | None = None
    """``(N,)`` name of the load at the flange, text: rows with the same name carried the same."""
    direction: Array | None = None
    """``(J, N)`` in {-1, 0, 1}"""
    speed: Array | None = None
    """``(J, N)`` signed fraction of full speed"""
    read_back: Array | None = None
    """``(J, N)`` joint variables as read back at the measurement, rad or m."""
    branches: Array | None = None
    """``(B, N)`` joint variables outside the chain that move mass, rad or m, in the order of the robot's branches."""
    branch_names: tuple[str, ...] = ()
    """Their names, B of them."""
    copies: NDArray[np.bool_] | None = None
    """``(N,)`` rows that repeat the measured values of an earlier row to the last digit: they show no noise."""
    rows: NDArray[np.int64] | None = None
    """``(N,)`` 1-based line of each pose in the file, or its row where the file has no lines."""
    gaps: tuple[int, ...] = ()
    """Lines or rows that were left out because a value is missing."""
    counted: Counted = "line"
    source: str | None = None
    """Name of the file as given."""
    sha256: str | None = None
    ordered: bool = False
    """Rows are in the order of measurement."""
    warnings: tuple[str, ...] = ()
    _known: list[Grouping] = dataclasses.field(init=False, repr=False, compare=False, default_factory=list)
    """Grouping of the rows, once known: a million rows take time."""

    def __post_init__(self) -> None:
        """Make every column read-only, because several computations share the record."""
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if isinstance(value, np.ndarray):
                value.flags.writeable = False

    def __str__(self) -> str:
        """Return the number of poses, and the ranges of the columns in SI units, in ten lines at most."""
        lines = [f"{self.n} measured poses of {self.source or 'arrays'}, in m and rad"]
        for field in dataclasses.fields(self):
            value = getattr(self, field.name)
            if isinstance(value, np.ndarray) and value.size and field.name not in ("rotation", "rows", "copies"):
                rows = value.reshape(-1, self.n) if value.dtype.kind == "f" else ()
                spans = ", ".join(f"{row.min():.2f}…{row.max():.2f}" for row in rows)
                lines.append(f"{field.name:<18} {spans or f'{np.unique(value).size} different'}")
        return "\n".join(lines[:10])

    @property
    def n(self) -> int:
        """Number of poses."""
        return int(self.position.shape[-1])

    @property
    def poses(self) -> Poses | None:
        """The attained poses, where orientation was measured."""
        return None if self.rotation is None else Poses(self.rotation, self.position)

    def subset(self, index: NDArray[Any] | slice) -> Measurements:
        """Return the poses of an index array, a boolean array or a slice (without a copy), in its order."""
        if isinstance(index, np.ndarray) and index.dtype == bool and index.all():
            return self
        changes: dict[str, Any] = {
            field.name: getattr(self, field.name)[..., index]
            for field in dataclasses.fields(self)
            if isinstance(getattr(self, field.name), np.ndarray)
        }
        nested = {"reference": self.reference, "photos": self.photos}
        changes |= {name: data.subset(index) for name, data in nested.items() if data is not None}
        return dataclasses.replace(self, **changes)

    @property
    def shown(self) -> NDArray[np.bool_] | None:
        """``(3, N)`` the components that each row shows; None if all."""
        return None if self.kind is None else np.array([SHOWN[kind] for kind in self.kind.tolist()]).T

    def each_photo(self) -> Measurements | None:
        """Return the pose that each photo shows; None without photos."""
        if self.photos is None:
            return None
        first = np.sort(np.unique(self.photos.position, axis=1, return_index=True)[1])
        of_pose = ("position", "rotation", "sigma_position", "sigma_rotation")
        columns = {name: getattr(self.photos.subset(first), name) for name in of_pose}
        return dataclasses.replace(self.subset(first), kind=None, fixture=None, seen=None, photos=None, **columns)

    @property
    def is_of_images(self) -> bool:
        """Whether all rows are images of points."""
        return self.kind is not None and bool(np.isin(self.kind, IMAGES).all())

    @property
    def is_placed_by_images(self) -> bool:
        """Whether images alone place the base: a camera does not show what is level, positions in its frame may."""
        kinds = [] if self.kind is None else self.kind.tolist()
        return any(image in kinds for image in IMAGES) and kinds.count("position") < 3

    @property
    def has_length(self) -> bool:
        """Whether any row measures a length; a smaller arm reaches the same sockets and planes in the same joints."""
        without = ("point", "plane", "line", "sphere")
        return self.kind is None or bool(np.isin(self.kind, without, invert=True).any())

    def count(self, rows: NDArray[np.bool_]) -> int:
        """Return how many numbers were measured in rows ``(N,)``."""
        if (shown := self.shown) is not None:
            return int(np.count_nonzero(shown & rows))
        return int(np.count_nonzero(rows)) * (3 if self.rotation is None else 6)

    def first_measured(self, mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Return the ``mask`` ``(N,)`` without copies of measurements."""
        return mask if self.copies is None else mask & ~self.copies

    def line(self, i: int) -> int:
        """Return the line of pose i in the file, or its number counted from 1 where there is no file."""
        return int(self.rows[i]) if self.rows is not None else i + 1

    def label(self, i: int) -> str:
        """Return the line or row of pose i as text, or the name of its photo."""
        return str(self.pose[i]) if self.counted in ("photo", "pose") and self.pose is not None else str(self.line(i))

    def place(self, i: int) -> str:
        """Return where pose i stands in its file: ``line 7``, ``row 7`` or ``photo IMG_007``."""
        return f"{self.counted} {self.label(i)}"

    @property
    def position_variance(self) -> Array | None:
        """Known variance ``(3, N)`` of the position, m², as stated or as estimated; None if none is."""
        if self.sigma_position is not None:
            return np.square(self.sigma_position)
        return None if self.noise_covariance is None else np.einsum("iin->in", self.noise_covariance)

    @property
    def stated_noise(self) -> tuple[float | None, float | None]:
        """Noise that the file states, RMS over poses and axes: of the position, m, and of the orientation, rad."""
        position, rotation = (
            None if sigma is None else float(np.sqrt(np.mean(np.square(sigma))))
            for sigma in (self.sigma_position, self.sigma_rotation)
        )
        return position, rotation

    @property
    def correlated_noise(self) -> Array | None:
        """Known covariance ``(3, 3, N)`` between coordinates of the position, m², 0 on its diagonal; None without."""
        return None if self.noise_covariance is None else self.noise_covariance * (1.0 - np.eye(3))[..., None]

    @property
    def states_covariance(self) -> bool:
        """Whether the covariance is that of single rows as the file states it, and no estimate over all of them."""
        return self.noise_covariance is not None and self.sigma_position is not None

    def along_noise(self, position: Array) -> tuple[Array, Array | float]:
        """Return values ``(3, N)`` along axes in which a row's noise is independent, and its variances there, m²."""
        if not self.states_covariance or self.noise_covariance is None:
            return position, 0.0 if self.position_variance is None else self.position_variance
        variance, axes = np.linalg.eigh(np.moveaxis(self.noise_covariance, -1, 0))
        return np.einsum("nij,in->jn", axes, position), variance.T

    @property
    def commands(self) -> Array | None:
        """Commanded joints ``(J, N)``, else positions, m, above rotations ``(3 or 12, N)``; None without commands."""
        if self.q is not None or self.commanded_position is None or self.commanded_rotation is None:
            return self.q if self.q is not None else self.commanded_position
        return np.vstack([self.commanded_position, self.commanded_rotation.reshape(9, -1)])

    def groups(self) -> NDArray[np.int64]:
        """Return the number ``(N,)`` of each row's commanded pose.

        The ``pose`` column decides where there is one, else equal commanded joints (or commanded positions). Where the
        commands of an id differ, only its rows with equal commands are the same pose.
        """
        return self._grouping().numbers

    def points(self, poses: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the number ``(N,)`` of each row's point at its pose, by ``poses`` ``(N,)``: repetitions share one."""
        columns = (self.target, self.fixture, *(() if self.seen is None else self.seen[:3]))
        return numbered(poses, *(column for column in columns if column is not None))

    def repetitions(self) -> NDArray[np.int64] | None:
        """Return :meth:`groups`, or None where no pose was measured more than once."""
        groups = self.groups()
        return None if groups.max(initial=-1) + 1 == groups.size else groups

    def hashed_commands(self) -> NDArray[np.uint64]:
        """Return a hash ``(N,)`` of each row's ``pose`` id, or without ids of its command."""
        hashes = hashed(self.position if self.commands is None else self.commands)
        if self.pose is not None:
            names = map(str, self.pose.tolist())
            hashes = np.fromiter((zlib.crc32(name.encode()) for name in names), np.uint64, self.n)
        # The finalizer of MurmurHash3, so that every bit of the hash decides on its remainders.
        mixed = (hashes ^ (hashes >> np.uint64(33))) * np.uint64(0xFF51AFD7ED558CCD)
        return mixed ^ (mixed >> np.uint64(33))

    def contradicted_ids(self) -> tuple[str, ...]:
        """Warn of rows that share a ``pose`` id but were commanded to different poses."""
        commands, contradicted = self.commands, self._grouping().contradicted
        if self.pose is None or commands is None or contradicted is None:
            return ()
        rows = np.flatnonzero(contradicted)
        names, count = np.unique(self.pose[rows]), np.unique(self.pose).size
        rows = rows[self.pose[rows] == names[0]]
        distance = np.abs(commands[:, rows] - commands[:, rows[:1]]).max(axis=0)
        places = f"{self.place(int(rows[0]))} and {self.place(int(rows[np.argmax(distance)]))}"
        verb = "has" if names.size == 1 else "have"
        ids = f"{names.size} of {count} pose ids {verb}" if count > 1 else "the pose id has"
        return (
            f"{f'{self.source}: ' if self.source else ''}{ids} rows with different commands, for example "
            f"{names[0]} on {places}; only rows with equal commands count as repetitions",
        )

    def _grouping(self) -> Grouping:
        if not self._known:
            self._known.append(commanded_groups(self.pose, self.commands) or Grouping(np.arange(self.n)))
        return self._known[0]


def different(numbers: NDArray[np.int64]) -> int:
    """Return how many different numbers from 0 occur, in a hundredth of the time of ``np.unique``."""
    return int(np.count_nonzero(np.bincount(numbers)))


def numbered(*columns: NDArray[Any]) -> NDArray[np.int64]:
    """Return the number ``(N,)`` of each row's combination of values; ``np.unique`` would import ``numpy.ma``."""
    order = np.lexsort(columns[::-1])
    number = np.zeros(order.size, dtype=np.int64)
    ordered = [column[order] for column in columns]
    number[order[1:]] = np.cumsum(np.any([column[1:] != column[:-1] for column in ordered], axis=0))
    return number


def motion_between_rows(q: Array) -> tuple[Array, Array]:
    """Return direction in {-1, 0, 1} and relative speed, both ``(J, N)``, of direct moves from row to row.

    Speed is dq over the largest |dq| of the move; all joints arrive together. The first row and a row equal to its
    predecessor get 0.
    """
    speed = np.diff(q, axis=1, prepend=q[:, :1])
    direction = np.sign(speed)
    largest = np.max(np.abs(speed), axis=0, initial=0.0)
    np.divide(speed, largest, out=speed, where=largest > 0)
    return direction, speed


def numbered_visits(
    groups: NDArray[np.int64],
    visit: NDArray[Any] | None,
    cycle: NDArray[Any] | None,
    target: NDArray[Any] | None,
    *,
    ordered: bool = True,
) -> NDArray[np.int64]:
    """Return the visit ``(N,)`` of each row.

    A column ``visit`` decides. Without it, rows with the same commanded pose and cycle are a visit. Without cycles, a
    target that is measured again belongs to the next visit, and so does each row of a file without targets.

    Args:
        groups: ``(N,)`` commanded pose of each row.
        visit: ``(N,)`` ids, or None; likewise ``cycle`` and ``target``.
        cycle: See ``visit``.
        target: See ``visit``.
        ordered: Rows are in the order measured: only consecutive rows share a visit.
    """
    if visit is not None:
        return numbered(visit)
    runs = groups if cycle is None else numbered(groups, cycle)
    runs = np.cumsum(np.diff(runs, prepend=-1) != 0) if ordered else runs
    if cycle is not None:
        return runs
    if target is None:
        return np.arange(groups.size)
    # A row's visit is the number of rows of the same target before it.
    numbers = numbered(runs, target)
    order, before = np.argsort(numbers, kind="stable"), np.empty_like(numbers)
    before[order] = np.arange(numbers.size) - np.searchsorted(numbers[order], numbers[order])
    return numbered(runs, before)


def motion_between_visits(q: Array, visits: NDArray[np.int64]) -> tuple[Array, Array]:
    """Return direction and relative speed, both ``(J, N)``, of direct moves from each visit to the next.

    Every row has the motion that led to its visit. Visits follow each other in the order of their first rows.
    """
    _, first, number = np.unique(visits, return_index=True, return_inverse=True)
    rows = np.sort(first)
    direction, speed = motion_between_rows(q[:, rows])
    place = np.searchsorted(rows, first)[number]
    return direction[:, place], speed[:, place]


def commanded_groups(ids: NDArray[Any] | None, commands: Array | None) -> Grouping | None:
    """Group rows by commanded pose, as :meth:`Measurements.groups` does; None without ids and commands.

    Args:
        ids: ``(N,)`` text, or None.
        commands: ``(K, N)`` rad or m, or None.
    """
    if ids is None:
        return None if commands is None else Grouping(numbered(hashed(commands)))
    number = numbered(ids)
    count = int(number.max(initial=-1)) + 1
    if commands is None or count == ids.size:
        return Grouping(number)
    last = np.empty(count, dtype=np.int64)
    last[number] = np.arange(number.size)
    # rad or m; largest difference between the commands of rows that share a ``pose`` id, from rounding or from joints
    # that were read back. An arm's error changes by about a thousandth of itself over such a distance.
    differ = np.any(np.abs(commands - commands[:, last[number]]) > 1e-3, axis=0)
    rows = (np.bincount(number, weights=differ) > 0.0)[number]
    number[rows] = count + numbered(hashed(commands[:, rows]))
    return Grouping(numbered(number), rows if rows.any() else None)


def even_rows(n: int, most: int) -> NDArray[np.int64]:
    """Return at most ``most`` of n rows, evenly spread; not every k-th, which may be of one target."""
    return np.linspace(0, n - 1, min(n, most)).astype(np.int64)


def hashed(values: Array) -> NDArray[np.uint64]:
    """Return a hash ``(N,)`` of each column of ``(K, N)``, rounded to 1e-9.

    Sorting it takes a tenth of the time of sorting columns; two of a million different columns share a hash once in
    thirty million files.
    """
    mixed = np.zeros(values.shape[1], dtype=np.uint64)
    for row in values:
        mixed = (mixed ^ (np.round(row, 9) + 0.0).view(np.uint64)) * np.uint64(0x9E3779B97F4A7C15)
        mixed ^= mixed >> np.uint64(29)
    return mixed


def too_far(error: float, position: Array, share: float = FAR) -> bool:
    """Return whether an error in m is too large for an arm that moved between the positions ``(3, N)``."""
    # m; an arm as it is built may be off by as much, however near its poses are to each other.
    return error > max(share * rms_length(position - position.mean(axis=1, keepdims=True)), 3e-3)
