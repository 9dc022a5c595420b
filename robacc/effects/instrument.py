"""Errors of the measurement: the instrument's scale and angles, its target, and the joints read back.

An error that turns with the line of sight has the instrument's place as a setting, which a trace searches for.
"""

from __future__ import annotations

import abc
import dataclasses
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from robacc.chain import BASE
from robacc.effects.base import (
    SCALE_OF_INSTRUMENT,
    About,
    Beyond,
    Effect,
    Need,
    Over,
    Part,
    Term,
    Traits,
    commanded,
    needed,
    register,
    setting,
    settings_of,
    varies,
)
from robacc.effects.frames import frame_terms
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.robots.arm import Arm

Place = tuple[float, float, float]
FARTHEST = 12.0
"""Largest distance, m, from which an arm is measured. Seen from farther away, an angle's error is a scale along an
axis, and a drift of the scale is one of the base."""


@dataclass(frozen=True)
class LineOfSight(Effect):
    """Shifts of the measured point along directions that the line of sight decides.

    The poses rarely state where the instrument stands, so a trace searches for it. The directions are those at the
    commanded pose of the registered arm: an error of the direction of 1 mrad changes a shift by a thousandth.
    """

    place: Place = setting((0.0, 0.0, 0.0), key="instrument", unit="length", written=True, last=True)
    """Instrument's place in the measuring frame, m."""

    def forms(self) -> Iterator[LineOfSight]:
        """Yield every form, each at this place: one for each choice of its setting that has choices."""
        for declared in settings_of(type(self)).values():
            for choice in declared.choices:
                yield dataclasses.replace(self, **{declared.field: choice})  # type: ignore[arg-type]

    @property
    @abc.abstractmethod
    def labels(self) -> tuple[str, ...]:
        """Label of each coefficient."""

    @abc.abstractmethod
    def shifts(self, position: Array, rotation: Array, places: Array) -> Array:
        """Return ``(P, Q, 3, N)`` shift of the measured point for each of the Q coefficients at 1.

        Args:
            position: ``(3, N)`` targets in the measuring frame, m.
            rotation: ``(3, 3, N)`` orientation of the tool.
            places: ``(P, 3)`` places of the instrument.
        """

    def at(self, place: Place) -> LineOfSight:
        """Return the same form at another place."""
        return dataclasses.replace(self, place=place)

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return the coefficients, each of which moves the base along x, y and z of the measuring frame."""
        position, rotation = lines_of_sight(arm, data, self.name)
        shifts = self.shifts(position, rotation, np.array([self.place]))[0]
        return tuple(
            Term(
                f"{self.name}.{label}",
                "rad" if label in ("cos", "sin") else "m",
                1e-5,
                tuple(Part(arm.chain.index(BASE, axis), shift[i]) for i, axis in enumerate("xyz")),
            )
            for label, shift in zip(self.labels, shifts, strict=True)
        )

    def stated(self, values: Mapping[str, float]) -> tuple[str, str]:
        """Return the size of the error of fitted ``values``, mm or mrad, and the instrument's place, m, as texts."""
        size = math.hypot(*(values.get(f"{self.name}.{label}", 0.0) for label in self.labels))
        return f"{1e3 * size:.2g}", ", ".join(f"{value:.2g}" for value in self.place)


def lines_of_sight(arm: Arm, data: Measurements, effect: str) -> tuple[Array, Array]:
    """Return ``(3, N)`` targets and ``(3, 3, N)`` orientations of the tool at the commanded poses."""
    poses = arm.chain.poses(arm.chain.scalars(commanded(data, effect)), data.n)
    position = np.broadcast_to(poses.translation, (3, data.n))
    return position, np.broadcast_to(poses.rotation, (3, 3, data.n))


def beams(position: Array, places: Array) -> tuple[Array, Array]:
    """Return ``(P, 3, N)`` unit vectors from the places to the targets, and ``(P, N)`` distances."""
    offset = position - places[:, :, None]
    distance = np.maximum(np.sqrt(np.sum(np.square(offset), axis=1)), 1e-9)
    return offset / distance[:, None], distance


def first_places(position: Array) -> Array:
    """Return ``(P, 3)`` places about the targets where a search begins: the origin if it is outside them, and a grid.

    The grid has twelve directions about the vertical at the targets' height and 30 degrees above, at 1.6 and 3.2 times
    the targets' reach.
    """
    centre = position.mean(axis=1)
    reach = float(np.sqrt(np.max(np.sum(np.square(position - centre[:, None]), axis=0), initial=0.0)))
    azimuth, elevation, distance = np.meshgrid(
        np.arange(12) * np.pi / 6, (0.0, np.pi / 6), (1.6 * reach, 3.2 * reach), indexing="ij"
    )
    grid = centre + spherical(azimuth.ravel(), elevation.ravel(), distance.ravel())
    origin_is_outside = float(np.sqrt(centre @ centre)) > 1.2 * reach
    return np.concatenate((np.zeros((1, 3)), grid)) if origin_is_outside else grid


def spherical(azimuth: Array, elevation: Array, distance: Array) -> Array:
    """Return ``(P, 3)`` vectors of these directions and lengths."""
    flat = distance * np.cos(elevation)
    return np.stack((flat * np.cos(azimuth), flat * np.sin(azimuth), distance * np.sin(elevation)), axis=1)


def neighbours(place: Array, centre: Array, step: float) -> Array:
    """Return ``(27, 3)`` places about ``place`` that differ by ``step`` in azimuth, elevation and log distance.

    None is farther than :data:`FARTHEST` from the centre, unless ``place`` is.
    """
    x, y, z = (place - centre).tolist()
    distance, azimuth, elevation = math.hypot(x, y, z), math.atan2(y, x), math.atan2(z, math.hypot(x, y))
    steps = np.array((-step, 0.0, step))
    turned, raised, scaled = (part.ravel() for part in np.meshgrid(steps, steps, steps, indexing="ij"))
    raised = np.clip(elevation + raised, -1.5, 1.5)
    distances = np.minimum(distance * np.exp(scaled), max(distance, FARTHEST))
    return centre + spherical(azimuth + turned, raised, distances)


_LARGEST_ANGLE = 3e-4
"""Largest plausible amplitude of an angle's error, rad: three times what a tracker in need of service has."""


@register
@dataclass(frozen=True)
class TrackerError(LineOfSight):
    """Measured point shifted along the line of sight, or turned about the instrument by its angle error.

    The instrument's standing axis is the measuring frame's z.
    """

    kind: Literal["range", "horizontal", "vertical"] = setting("range", written=True)

    name = "tracker_error"
    traits = Traits(
        per_joint=False,
        is_searched=True,
        drivers=(),
        extrapolates="the geometry of the instrument",
        is_of_measurement=True,
        implausible_factor=3.0,
    )
    about = About(
        summary="the tracker's own geometry: a wrong range offset (home point), an eccentric horizontal or vertical "
        "encoder",
        equation="p measured = p + c u; or + r_h (c cos A + s sin A) e_A; or + r (c cos E + s sin E) e_E; u the line "
        "of sight, A azimuth, E elevation",
        unit="m (rad for the angles)",
        usual_size="5e-6 to 5e-4 m; 2e-6 to 1e-4 rad",
        usual_range=(5e-6, 5e-4),
        needs="targets in several directions and at several distances from the instrument",
        confused_with="transmission_error of joint 1 where the instrument stands close to its axis, instrument_scale",
        source="Hughes, Forbes, Lewis, Sun, Veal, Nasr, Measurement Science and Technology 22 (2011) 045103",
        example="{effect: tracker_error, kind: range, instrument: [3, -2, 1], values: {offset: 5e-5}}",
    )

    @property
    def labels(self) -> tuple[str, ...]:
        """Return the offset of the range, or cosine and sine of an angle's error."""
        return ("offset",) if self.kind == "range" else ("cos", "sin")

    def shifts(self, position: Array, rotation: Array, places: Array) -> Array:
        """Return the line of sight, or the tangents times cosine and sine of the angle."""
        along, distance = beams(position, places)
        if self.kind == "range":
            return along[:, None]
        flat = np.maximum(np.hypot(along[:, 0], along[:, 1]), 1e-9)
        x, y, z = along[:, 0] / flat, along[:, 1] / flat, along[:, 2]
        cosine, sine, tangent = x, y, np.stack((-y, x, np.zeros_like(x)), axis=1) * (flat * distance)[:, None]
        if self.kind == "vertical":
            cosine, sine, tangent = flat, z, np.stack((-z * x, -z * y, flat), axis=1) * distance[:, None]
        return np.stack((tangent * cosine[:, None], tangent * sine[:, None]), axis=1)

    def implausible(self, terms: Sequence[Term], values: Sequence[float]) -> str | None:
        """Return the reason if an offset, or an angle's error, is more than a tracker can have; else None."""
        if self.kind == "range":
            return super().implausible(terms, values)
        size = math.hypot(*values)
        if size <= _LARGEST_ANGLE:
            return None
        return (
            f"{self.name}: an error of {1e3 * size:.2g} mrad of the {self.kind} angle is implausible; usual "
            "amplitudes are 0.002 to 0.1 mrad"
        )

    def statement(
        self, arm: Arm, values: Mapping[str, float], between: tuple[str, str, str] | None = None
    ) -> str | None:
        """Return the size of the error, and what to do."""
        size, place = self.stated(values)
        unit = "mm" if self.kind == "range" else "mrad"
        return (
            f"the instrument near {place} m has an error of {size} {unit} in its {self.kind} reading: run its "
            "compensation routine and a two-face check, and measure again"
        )


@register
@dataclass(frozen=True)
class TargetDecentre(LineOfSight):
    """Target shifted by a constant in the frame of the line of sight.

    A reflector that is turned to the instrument at each pose turns in its nest. Its decentring is constant along the
    line of sight and across it; the roll about the line of sight is that of an axis of the tool.
    """

    axis: Literal["x", "y", "z"] = setting("x", written=True)
    """Axis of the tool that decides the reflector's roll about the line of sight."""

    name = "target_decentre"
    traits = Traits(
        per_joint=False,
        is_searched=True,
        drivers=(),
        extrapolates="the decentring is a constant of the reflector",
        is_of_measurement=True,
    )
    about = About(
        summary="the reflector's optical centre is not the centre of its sphere, and it is turned to the instrument at "
        "each pose; or its nest holds it off centre along the line of sight",
        equation="p measured = p + c_along u + c_across v + c_beyond u x v, u the line of sight, v the part of the "
        "tool's axis perpendicular to it",
        unit="m",
        usual_size="3e-6 to 1e-5 m for a good reflector, up to 5e-4 m after a fall",
        usual_range=(3e-6, 5e-4),
        needs="a tool that turns against the line of sight",
        confused_with="tool_frame where the tool keeps its direction to the instrument",
        source="ASME B89.4.19-2006: optical and mechanical centre of a spherically mounted retroreflector",
        example="{effect: target_decentre, axis: x, instrument: [3, -2, 1], values: {across: 1e-4, beyond: 5e-5}}",
    )

    @property
    def labels(self) -> tuple[str, ...]:
        """Return the shift along the line of sight, and two across it."""
        return ("along", "across", "beyond")

    def shifts(self, position: Array, rotation: Array, places: Array) -> Array:
        """Return the line of sight, the tool's axis across it, and their product."""
        along, _ = beams(position, places)
        axis = rotation[:, "xyz".index(self.axis)]
        across = axis - along * np.sum(axis * along, axis=1, keepdims=True)
        across = across / np.maximum(np.sqrt(np.sum(np.square(across), axis=1, keepdims=True)), 1e-9)
        return np.stack((along, across, np.cross(along, across, axis=1)), axis=1)

    def statement(
        self, arm: Arm, values: Mapping[str, float], between: tuple[str, str, str] | None = None
    ) -> str | None:
        """Return how far the centre is off, and what to do."""
        size, place = self.stated(values)
        return (
            f"the reflector's optical centre is {size} mm from the centre of its sphere, for an instrument near "
            f"{place} m: turn it in its nest and watch the reading; replace it, or keep the same side "
            "towards the instrument"
        )


_DEGREES = (1, 3, 5)
"""Degrees of the drifts that a trace tries."""
_ABOUT_NO_POINT = 0.5
"""Share of the shifts' mean square over time that a scale about one point leaves, from which there is no such point. In
simulations drifting air leaves at most 0.12 of it (0.48 where hardly noticeable), errors that wander 0.99 and more."""


@register
@dataclass(frozen=True)
class InstrumentScale(Effect):
    """The measured position multiplied by 1 + k, or by 1 + k(t) about the instrument's place.

    A drift has the scale k1 u + k2 u^2 + ... of u, the time from -1 to 1 over the poses, and with each power a shift:
    minus the scale times the instrument's place, which is unknown where the poses are in another frame than its own.
    """

    drift: int = setting(0, least=0, most=9)
    """Degree of the drift; 0 for a scale that does not change."""
    origin: float = setting(0.0, key="origin_s", written=lambda scale: scale.drift > 0)
    """s, the time at which there is no drift."""
    span: float = setting(1.0, key="span_s", above=0.0, written=lambda scale: scale.drift > 0)
    """s, the unit of time: a coefficient is the drift over it."""

    name = "instrument_scale"
    traits = Traits(
        per_joint=False,
        extrapolates="a scale acts in proportion to the distance",
        is_of_measurement=True,
        shared_by=("origin", "span"),
    )
    about = About(
        summary="the instrument's own scale: refractive index, a camera's focal length, a wrong length "
        "standard; with drift, air whose index changes while the poses are measured",
        equation="p measured = (1 + k) p; with drift: p + k(t) (p - p0), k a polynomial of time, p0 the instrument",
        unit="1",
        usual_size="1e-6 to 1e-3; drift 1e-6 (1 K or 4 hPa) to 1e-4",
        usual_range=(1e-06, 0.001),
        needs="positions spread over a volume; drift: time_s",
        confused_with="link_geometry: all lengths of the arm scaled together, thermal_expansion at one temperature; "
        "with drift, frame_drift",
        source="Ciddor, Applied Optics 35 (1996) 1566: 0.96e-6 per K, 0.27e-6 per hPa",
        example="{effect: instrument_scale, values: {value: 2e-5}}",
    )

    @classmethod
    def candidates(cls, arm: Arm, data: Measurements) -> Iterator[Effect]:
        """Yield a constant scale, and drifts if the time varies."""
        yield cls()
        if data.time is not None and varies(data.time):
            low, high = float(data.time.min()), float(data.time.max())
            yield from (cls(drift=degree, origin=(low + high) / 2, span=(high - low) / 2) for degree in _DEGREES)

    @property
    def rejects_implausible(self) -> bool:
        """Return whether the scale drifts: shifts of its own let it follow any drift of the frame."""
        return self.drift > 0

    def depends_on(self, arm: Arm) -> tuple[str, ...]:
        """Return the time of a drift."""
        return ("time_s",) if self.drift else ()

    def beyond(self, arm: Arm, driver: str, limits: tuple[float, float]) -> Beyond:
        """Return that a drift ends with the poses."""
        return Beyond(is_held=True)

    def chart(self) -> Over:
        """Return the distance from the instrument, or the time of a drift."""
        return Over("time_s", is_only=False) if self.drift else Over("distance")

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return one term, or four per power of time."""
        if not self.drift:
            return (Term(self.name, "1", 1e-5, (Part(SCALE_OF_INSTRUMENT),)),)
        elapsed = (needed(data.time, "time_s", self.name) - self.origin) / self.span
        return tuple(
            term
            for power in range(1, self.drift + 1)
            for term in (
                Term(f"{self.name}.k{power}", "1", 1e-5, (Part(SCALE_OF_INSTRUMENT, elapsed**power),)),
                *frame_terms(arm, BASE, self.name, elapsed**power, turning=False, suffix=f"{power}"),
            )
        )

    def implausible(self, terms: Sequence[Term], values: Sequence[float]) -> str | None:
        """Return the reason if the shifts of a drift are not those of a scale about an instrument's place."""
        scale, shifts, centre = self._curves({term.name: value for term, value in zip(terms, values, strict=True)})
        if centre is None:
            return super().implausible(terms, values)
        if math.hypot(*centre) > FARTHEST:
            distance = f"{math.hypot(*centre):.2g} m away"
            return f"{self.name}: its centre is {distance}, which is implausible: an instrument stands nearer"
        moved, left_over = (float(np.sum(np.square(part))) for part in (shifts, shifts + np.outer(scale, centre)))
        if left_over > _ABOUT_NO_POINT * moved:
            return f"{self.name}: its shifts are not those of a scale about one point: the frame of the poses moves"
        return super().implausible(terms, values)

    def _curves(self, values: Mapping[str, float]) -> tuple[Array, Array, Array | None]:
        """Return ``(T,)`` the scale and ``(T, 3)`` the shifts over the time of the poses, and ``(3,)`` their centre, m.

        The centre is the point about which the scale drifts; None without drift.
        """
        powers = range(1, self.drift + 1)
        scale = np.array([values.get(f"{self.name}.k{power}", 0.0) for power in powers])
        shifts = np.array([[values.get(f"{self.name}.{label}{power}", 0.0) for label in "xyz"] for power in powers])
        curves = np.linspace(-1, 1, 101)[:, None] ** np.arange(1, self.drift + 1)
        centre = -(scale @ shifts) / (scale @ scale) if scale.any() else None
        return curves @ scale, curves @ shifts.reshape(-1, 3), centre

    def statement(
        self, arm: Arm, values: Mapping[str, float], between: tuple[str, str, str] | None = None
    ) -> str | None:
        """Return how far a drifting scale ranges, and about which point."""
        scale, _, centre = self._curves(values)
        if centre is None:
            return None
        place = ", ".join(f"{coordinate:.2g}" for coordinate in centre)
        return (
            f"the instrument's scale changes by {1e6 * float(np.ptp(scale)):.2g} ppm during the measurement, about the "
            f"point {place} m: log temperature and pressure of the air, and measure a fixed target between the poses"
        )


FOLLOWED_SHARE = 0.5
"""Share from which the joints read back describe the arm better than those commanded."""


@register
@dataclass(frozen=True)
class ReadBack(Effect):
    """Joint variables shifted by a share of the difference between the joints read back and those commanded.

    A share of 1 means that the arm stood at the joints read back when it was measured, a share of 0 that it stood at
    its command, whatever was read before.
    """

    name = "read_back"
    traits = Traits(
        per_joint=False,
        needs=(
            Need(
                "no read_q columns that differ from the commanded joints",
                lambda arm, data: (
                    data.read_back is not None and data.q is not None and bool(np.any(data.read_back != data.q))
                ),
            ),
        ),
        drivers=(),
        extrapolates="the difference is that of each pose",
        is_of_measurement=True,
        is_nonnegative=True,
        implausible_factor=1.5,
    )
    about = About(
        summary="the arm stood at the joints read back, not at those commanded: it had not settled, or its "
        "controller leaves a constant error",
        equation="theta_j + c (q_read_j - q_j), the same c for all joints",
        unit="1",
        usual_size="0.5 to 1: 1 where the arm stood at the joints read back",
        usual_range=(0.5, 1.0),
        needs="q1 … qN as commanded and read_q1 … read_qN as read back",
        confused_with="approach_lag and backlash where the difference follows the last motion",
        source="a parameter times a regressor, as every effect here",
        example="{effect: read_back, values: {value: 1}}",
    )

    @property
    def rejects_implausible(self) -> bool:
        """Return True: an arm stands between its command and the joints read back, so no share is far above 1."""
        return True

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return the share, common to all joints."""
        difference = needed(data.read_back, "read_q1 … read_qN", self.name) - commanded(data, self.name)
        parts = tuple(Part(arm.axis_motion(joint), difference[arm.number(joint)]) for joint in arm.names)
        return (Term(self.name, "1", 1.0, parts),)

    def statement(
        self, arm: Arm, values: Mapping[str, float], between: tuple[str, str, str] | None = None
    ) -> str | None:
        """Return which joints the measured positions follow, and what to do."""
        share = values.get(self.name, 0.0)
        if share < FOLLOWED_SHARE:
            return (
                f"the measured positions follow only a share of {share:.2g} of the difference between the joints read "
                "back and those commanded: the joints were read before the arm had settled; read and measure at the "
                "same time"
            )
        return (
            f"the measured positions follow the joints read back, not those commanded (share {share:.2g}): the arm was "
            "measured before it had settled, or its controller leaves a constant error; wait longer before "
            "a measurement, or give the joints read back as q1 … qN"
        )
