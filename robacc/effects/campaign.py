"""Effects of one measuring campaign: errors of the instrument and its target, joints read back, and step changes.

An error that turns with the line of sight has the instrument's place as a setting, which a trace searches for, as it
does for the place of a step in the sequence of poses.
"""

import abc
import functools
import itertools
import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePath
from typing import Any, Literal

import numpy as np

from robacc.effects.base import (
    FOLLOWED_SHARE,
    SCALE_OF_INSTRUMENT,
    About,
    Effect,
    Need,
    Over,
    Part,
    Term,
    Traits,
    commanded,
    compliance_unit,
    needed,
    register,
    setting,
    varies,
)
from robacc.effects.frames import frame_terms
from robacc.geometry import Array, NDArray, Poses
from robacc.gravity import gravity_torques, payload
from robacc.measurements import Measurements
from robacc.robots.arm import BASE, TOOL, Arm

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

    @abc.abstractmethod
    def shifts(self, along: Array, distance: Array, rotation: Array) -> dict[str, Array]:
        """Return ``(3, N)`` shift of the measured point for each coefficient at 1, by its label.

        Args:
            along: ``(3, N)`` unit vectors from the instrument to the targets, measuring frame.
            distance: ``(N,)`` distances of the targets from the instrument, m.
            rotation: ``(3, 3, N)`` orientation of the tool.
        """

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return the coefficients, each of which moves the base along x, y and z of the measuring frame."""
        targets = lines_of_sight(arm, data, self.name)
        offset = targets.translation - np.array(self.place)[:, None]
        distance = np.maximum(np.sqrt(np.sum(np.square(offset), axis=0)), 1e-9)
        return tuple(
            Term(
                f"{self.name}.{label}",
                "rad" if label in ("cos", "sin") else "m",
                1e-5,
                tuple(Part(arm.chain.index(BASE, axis), shift[i]) for i, axis in enumerate("xyz")),
            )
            for label, shift in self.shifts(offset / distance, distance, targets.rotation).items()
        )

    def stated(self, values: Mapping[str, float]) -> tuple[str, str]:
        """Return the size of the error of fitted ``values``, mm or mrad, and the instrument's place, m, as texts."""
        size = math.hypot(*(value for name, value in values.items() if name.startswith(f"{self.name}.")))
        return f"{1e3 * size:.2g}", ", ".join(f"{value:.2g}" for value in self.place)


@functools.lru_cache(maxsize=2)
def lines_of_sight(arm: Arm, data: Measurements, effect: str) -> Poses:
    """Return the targets, and the orientations of the tool, at the commanded poses; kept for reuse."""
    return arm.chain.forward(commanded(data, effect))


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

    def shifts(self, along: Array, distance: Array, rotation: Array) -> dict[str, Array]:
        """Return the line of sight, or the tangents times cosine and sine of the angle."""
        if self.kind == "range":
            return {"offset": along}
        flat = np.maximum(np.hypot(along[0], along[1]), 1e-9)
        x, y, z = along[0] / flat, along[1] / flat, along[2]
        cosine, sine, tangent = (
            (flat, z, np.stack((-z * x, -z * y, flat)) * distance)
            if self.kind == "vertical"
            else (x, y, np.stack((-y, x, np.zeros_like(x))) * (flat * distance))
        )
        return {"cos": tangent * cosine, "sin": tangent * sine}

    def implausible(self, terms: Sequence[Term], values: Sequence[float]) -> str | None:
        """Return the reason if an offset, or an angle's error, is more than a tracker can have; else None."""
        if self.kind == "range":
            return super().implausible(terms, values)
        size = math.hypot(*values)
        return (
            None
            if size <= _LARGEST_ANGLE
            else (
                f"{self.name}: an error of {1e3 * size:.2g} mrad of the {self.kind} angle is implausible; usual "
                "amplitudes are 0.002 to 0.1 mrad"
            )
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

    def shifts(self, along: Array, distance: Array, rotation: Array) -> dict[str, Array]:
        """Return the line of sight, the tool's axis across it, and their product."""
        axis = rotation[:, "xyz".index(self.axis)]
        across = axis - along * np.sum(axis * along, axis=0)
        across = across / np.maximum(np.sqrt(np.sum(np.square(across), axis=0)), 1e-9)
        return {"along": along, "across": across, "beyond": np.cross(along, across, axis=0)}

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

    traits = Traits(
        per_joint=False,
        drivers=(),
        chart=Over("distance"),
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
        if data.has_length:
            yield cls()
        if data.has_length and data.time is not None and varies(data.time):
            low, high = float(data.time.min()), float(data.time.max())
            yield from (cls(drift=degree, origin=(low + high) / 2, span=(high - low) / 2) for degree in _DEGREES)

    @property
    def form(self) -> Traits:
        """Return what a drift is: it ends with the poses, and its shifts would let it follow any drift of the frame."""
        over = Over("time_s", is_only=False)
        changes: dict[str, Any] = {"drivers": ("time_s",), "chart": over, "extrapolates": None}
        return self.traits._replace(**changes, rejects_implausible=True) if self.drift else self.traits

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
        moved, left_over = (float(np.sum(np.square(part))) for part in (shifts, shifts + np.outer(scale, centre)))
        if (distance := math.hypot(*centre)) > FARTHEST:
            return (
                f"{self.name}: its centre is {distance:.2g} m away, which is implausible: an instrument stands nearer"
            )
        # Share of the shifts' mean square over time that a scale about one point leaves, from which there is no such
        # point: in simulations drifting air leaves at most 0.12 of it (0.48 where hardly noticeable), errors that
        # wander 0.99 and more.
        moves = f"{self.name}: its shifts are not those of a scale about one point: the frame of the poses moves"
        return moves if left_over > 0.5 * moved else super().implausible(terms, values)

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


@register
class ReadBack(Effect):
    """Joint variables shifted by a share of the difference between the joints read back and those commanded.

    A share of 1 means that the arm stood at the joints read back when it was measured, a share of 0 that it stood at
    its command, whatever was read before.
    """

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
        rejects_implausible=True,  # an arm stands between its command and the joints read back
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


# A step change between two poses: of the base, the target, a joint's zero, or the load at the flange.


@register
@dataclass(frozen=True)
class Step(Effect):
    """Coordinates of the base, the target, or one joint, or the load at the flange, that change at one time or line.

    A load that nobody logged turns each of its joints by the compliance times the mass times the torque of 1 kg.

    Poses without a time, without lines, or of another file than ``file`` come after the step: the arm is as it is now.
    """

    part: Literal["base", "target", "joint", "payload"] = setting("base", written=lambda step: step.part != "joint")
    from_line: int | None = setting(None)
    """Line (or row) of the first pose after the step, as messages count it."""
    from_time: float | None = setting(None, key="from_time_s")
    """s, the time of the step; it is used in place of the line where poses have a time."""
    file: str | None = setting(None)
    """Name of the file that the line belongs to; None for any."""
    target: str | None = setting(None)
    """Name of the only target that moved; None for all."""
    turning: bool = setting(False)
    """True if the base, or the target, turns too."""

    traits = Traits(
        joints_optional=True,
        needs=(
            Need(
                "the poses have neither a time_s that varies nor lines",
                lambda arm, data: varies(data.time) or data.rows is not None,
            ),
        ),
        is_searched=True,
        drivers=(),
        extrapolates="a change stays after its step",
        is_event=True,
    )
    about = About(
        summary="a step change between two poses: the base moved, the target was bumped, a joint's zero jumped, or the "
        "load changed",
        equation="base or tool x, y, z (and its rotations), or theta_j, + c from one pose on, 0 before it; part: "
        "payload: theta_j + c_j times the torque of 1 kg at the flange from one pose on",
        unit="rad (m for a prismatic joint), m for the base and the target; part: payload: rad/(N m) kg",
        usual_size="5e-5 to 5e-3 rad, 5e-5 to 5e-3 m; a motor turn over the gear ratio where an encoder lost a turn",
        usual_range=(5e-5, 5e-3),
        needs="time_s, or rows in the order of measurement",
        confused_with="frame_drift where it is gradual; joint errors where all poses after the step differ from those "
        "before it in a joint; payload_compliance where a load changes that was not logged",
        source="G. Lorden, Annals of Mathematical Statistics 42 (1971) 1897: likelihood ratio over all change points",
        example="{effect: step, part: target, from_time_s: 1800, values: {x: 2e-4, y: -1e-4, z: 5e-5}}",
    )

    @classmethod
    def usual(cls, arm: Arm, data: Measurements, joints: tuple[str, ...]) -> Effect:
        """Return a step in the middle of the run: of the base, or of the zero of ``joints``."""
        return cls(joints, "joint" if joints else "base").starting(float(np.median(sequence_of(data))), data)

    @property
    def form(self) -> Traits:
        """Return that it is drawn over the time, or the line."""
        over = Over("line" if self.from_time is None else "time_s", is_only=False)
        return self.traits._replace(chart=over)

    def starting(self, at: float, data: Measurements) -> "Step":
        """Return the same step at a time (s) or line of ``data``."""
        timed = varies(data.time)
        return Step(
            self.joints,
            self.part,
            None if timed else math.ceil(at),
            at if timed else None,
            None if timed or data.source is None else PurePath(data.source).name,
            self.target,
            self.turning,
        )

    @property
    def place(self) -> float:
        """Return the place of the step in the sequence, s or line."""
        return float(self.from_line or 0) if self.from_time is None else self.from_time

    def after(self, data: Measurements) -> Array:
        """Return ``(N,)`` 1 for poses after the step, 0 for poses before it."""
        now = np.ones(data.n)
        if self.from_time is not None:
            return now if data.time is None else (data.time >= self.from_time).astype(float)
        elsewhere = self.file is not None and data.source is not None and PurePath(data.source).name != self.file
        if self.from_line is None or data.rows is None or elsewhere:
            return now
        return (data.rows >= self.from_line).astype(float)

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return one term per joint, or three or six of the base or the target."""
        after = self.after(data)
        if self.part == "payload":
            torques = dict(zip(arm.names, after * unit_torques(arm, data), strict=True))
            return tuple(
                self.joint_term(arm, joint, torques[joint], typical=5e-5, unit=f"{compliance_unit(arm, joint)} kg")
                for joint in self.joints
            )
        if self.part == "joint":
            return tuple(self.joint_term(arm, joint, after) for joint in self.joints)
        if self.target is not None and data.target is not None:
            after = after * (data.target == self.target)
        return frame_terms(arm, BASE if self.part == "base" else TOOL, self.name, after, turning=self.turning)

    @classmethod
    def from_settings(cls, joints: tuple[str, ...], settings: Mapping[str, Any]) -> Effect:
        """Return the step; without ``part``, it is one of the joints if there are any, else of the base."""
        return super().from_settings(joints, {"part": "joint" if joints else "base", **settings})

    def conflict(self, given: Collection[str]) -> str | None:
        """Return the reason if the part does not go with the joints, the place, the target, or a turn."""
        if (self.part in ("joint", "payload")) != bool(self.joints):
            return (
                "expected part: base or part: target without joints, part: payload with joints, or joints without part"
            )
        if (self.from_line is None) == (self.from_time is None):
            return "expected from_line or from_time_s, the place of the step"
        is_misplaced = (self.target is not None and self.part != "target") or (self.turning and self.joints)
        return "target belongs to part: target, turning to the base or the target" if is_misplaced else None

    def statement(
        self, arm: Arm, values: Mapping[str, float], between: tuple[str, str, str] | None = None
    ) -> str | None:
        """Return what moved, from where on and by how much, and what to do."""
        shift = math.hypot(*(values.get(f"{self.name}.{label}", 0.0) for label in "xyz")) * 1e3
        turn = math.hypot(*(values.get(f"{self.name}.{label}", 0.0) for label in ("roll", "pitch", "yaw"))) * 1e3
        size = f"{shift:.3g} mm" + (f" and {turn:.3g} mrad" if self.turning else "")
        place = f"line {self.from_line}" if self.from_time is None else f"{self.from_time:.6g} s"
        start = f"from {between[0] if between else place} on"
        if between is not None and between[1] != between[2]:
            start += f" (95 % between {between[1]} and {between[2]})"
        jumps = ", ".join(
            f"{joint} jumps by {1e3 * values.get(f'{self.name}.{joint}', 0.0):.3g} "
            f"{'mrad' if arm.is_revolute(joint) else 'mm'}"
            for joint in self.joints
        )
        what, check = {
            "base": (
                f"base is displaced by {size}",
                "check the mounting of the base and the instrument's tripod, and measure these poses again",
            ),
            "target": (
                f"target {f'{self.target} ' * (self.target is not None)}is displaced by {size}",
                "check its seat, and measure the earlier poses again",
            ),
            "payload": (
                f"arm carries another load, which deflects {', '.join(self.joints)}",
                "write payload_kg for each row (a part, another tool, a hose), and trace again",
            ),
            "joint": (
                f"zero of {jumps}",
                "look for a collision, a lost encoder count or a new mastering; master the joint and measure again",
            ),
        }[self.part]
        if self.from_time is None and self.part in ("base", "joint"):
            check += "; without time_s, a warm-up or a drift looks so, too: record it and trace again"
        return f"{start}, the {what}: {check}"

    def __str__(self) -> str:
        """Return ``step[j2]`` or ``step[base]``."""
        joints = "" if self.part == "payload" else ",".join(self.joints)
        return f"{self.name}[{joints or self.target or self.part}]"


@functools.lru_cache(maxsize=2)
def unit_torques(arm: Arm, data: Measurements) -> Array:
    """Return ``(J, N)`` torque of gravity (N m) or force (N) on each joint by a payload of 1 kg; kept for reuse."""
    return gravity_torques(arm, commanded(data, Step.name), payload(arm, np.ones(data.n)))


def sequence_of(data: Measurements) -> Array:
    """Return ``(N,)`` the quantity that orders the poses: the time if it varies, else the line in the file."""
    in_file = np.arange(data.n, dtype=float) if data.rows is None else data.rows.astype(float)
    return data.time if data.time is not None and varies(data.time) else in_file


# Steps as a search builds them: every part that can move, and the poses where its step may lie.

FEWEST = 5
"""Visits on each side of a step that a search demands: fewer deviating visits are outliers."""
_LEAST_TORQUE = 0.1
"""Least torque of a load on a joint that a search for a changed load includes, over the largest on any joint."""


def step_forms(arm: Arm, data: Measurements) -> Iterator[Step]:
    """Yield every form of a step, before all poses: the base, turning or not, the target or targets, each joint."""
    if Step.missing(arm, data) is not None:
        return
    turns = data.rotation is not None
    names = [] if data.target is None else np.unique(data.target).tolist()
    forms = [Step((), "base"), Step((), "base", turning=True), Step((), "target", turning=turns)]
    forms += [Step((), "target", target=str(name), turning=turns) for name in names if len(names) > 1]
    forms += [Step((joint,), "joint") for joint in arm.names]
    # A load that changes is in the column of a payload that is logged. Without masses, the weight that the arm always
    # carries has no effect of one coefficient, and a step of the load near the first pose would stand for it.
    if data.payload is None and arm.chain.bodies:
        torque = np.sqrt(np.mean(np.square(unit_torques(arm, data)), axis=1))
        loaded = torque > _LEAST_TORQUE * torque.max()
        forms += [Step(tuple(itertools.compress(arm.names, loaded)), "payload")] if loaded.any() else []
    for form in forms:
        yield form.starting(float(sequence_of(data).min()), data)


def possible_places(form: Step, between: Array) -> Array:
    """Return the places, of ``between`` poses, where a search lets a step of a form lie.

    A changed load lies after a quarter of the visits: nearer to the first pose, it would stand for a load that is there
    all the time.
    """
    return between[between.size // 4 :] if form.part == "payload" else between


def places(data: Measurements, visits: NDArray[np.int64]) -> tuple[NDArray[np.int64], Array]:
    """Return ``(N,)`` each pose's number in the sequence, and ``(P,)`` the place before each number but the first.

    A time lies half-way between two poses; a line is that of the first pose after it. Rows of a visit, numbered
    ``(N,)``, have the same number.
    """
    sequence = sequence_of(data)
    start = np.full(int(visits.max(initial=0)) + 1, np.inf)
    np.minimum.at(start, visits, sequence)
    values, number = np.unique(start[visits], return_inverse=True)
    before = 0.5 * (values[1:] + values[:-1]) if sequence is data.time else values[1:]
    return number.astype(np.int64), before


def place_text(place: float, step: Step, data: Measurements) -> str:
    """Return a place of a step as text: the first pose after it, with its time where the step has one."""
    sequence = sequence_of(data)
    after = np.flatnonzero(sequence >= place)
    line = data.place(int(after[np.argmin(sequence[after])])) if after.size else "the end"
    return line if step.from_time is None else f"{place:.6g} s ({line})"
