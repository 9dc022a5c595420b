"""Robot description of a robot file or URDF, and the identity of what was tested: plain, frozen records."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple

import numpy as np

from robacc.geometry import Poses, rpy_from_rotation

Convention = Literal["standard", "modified", "urdf"]
JointType = Literal["revolute", "prismatic", "fixed"]
Vector = tuple[float, float, float]

ZERO: Vector = (0.0, 0.0, 0.0)
STANDARD_GRAVITY: Vector = (0.0, 0.0, -9.81)

DH_PARAMETERS = ("theta", "d", "a", "alpha", "beta")
"""``beta`` is Hayati's rotation about y, zero in a plain table; it tilts nearly parallel axes."""
FRAME_PARAMETERS = ("x", "y", "z", "roll", "pitch", "yaw")
ORIGIN_PARAMETERS = (*FRAME_PARAMETERS, "offset")
"""Parameters of a URDF joint: its origin, and the offset added to its variable."""
LENGTH_PARAMETERS = frozenset({"d", "a", "x", "y", "z"})
MAX_JOINTS = 100
"""Joints of one chain: three times a snake arm's; the work of a search for effects grows with their square."""

MAX_LENGTH = 50.0
"""m: no arm has a longer link, and no base is farther from its instrument."""
TURN = 2 * math.pi * 1.001
"""rad: a fixed angle beyond a turn (and rounding) was written in degrees."""
_LIMITS_IN_DEGREES = (4 * math.pi, 1000.0)
"""rad: limits beyond two turns are rare, for all joints of an arm unknown; much larger ones mean "no limit"."""
TRAVEL_IN_MM = (MAX_LENGTH, 1e4)
"""m: a travel between these values was written in mm; a longer travel means "no limit"."""


def unit_axis(xyz: Sequence[float]) -> Vector | None:
    """Return an axis with unit length; None for one that is so short that it has no direction.

    An axis that is nearly of unit length keeps its numbers, so that a file written and read again is the same.
    """
    length = math.hypot(*xyz)
    x, y, z = xyz if abs(length - 1) < 1e-12 else (value / max(length, 1e-9) for value in xyz)
    return (x, y, z) if length >= 1e-9 else None


@dataclass(frozen=True, slots=True)
class Frame:
    """Fixed transform ``T(xyz) Rz(yaw) Ry(pitch) Rx(roll)``, m and rad."""

    xyz: Vector = ZERO
    rpy: Vector = ZERO

    @classmethod
    def of(cls, pose: Poses) -> "Frame":
        """Return the frame of a single pose."""
        angles = rpy_from_rotation(pose.rotation)
        x, y, z, roll, pitch, yaw = (float(value) + 0.0 for value in (*pose.translation, *angles))
        return cls((x, y, z), (roll, pitch, yaw))

    @property
    def pose(self) -> Poses:
        """The frame as a single pose."""
        return Poses.from_xyz_rpy(np.array(self.xyz), np.array(self.rpy))


class Mimic(NamedTuple):
    """Rule of a joint that follows another: ``q = multiplier * q_master + offset``."""

    master: str
    multiplier: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True, slots=True)
class Joint:
    """Joint and the link it moves, in the robot's convention."""

    name: str
    type: JointType
    parameters: Mapping[str, float]
    """Values of :data:`DH_PARAMETERS`, or of :data:`ORIGIN_PARAMETERS` for a URDF's joint; m and rad."""
    axis: Vector = (0.0, 0.0, 1.0)
    """Unit vector in the joint's frame; other than z only in a URDF's joint."""
    limits: tuple[float, float] | None = None
    is_continuous: bool = False
    """True for a revolute joint that turns without end; without limits alone, the file does not say."""
    sign: Literal[1, -1] = 1
    gear_ratio: float | None = None
    mass: float | None = None
    com: Vector | None = None
    tolerance: Mapping[str, float] = field(default_factory=dict)
    """Standard deviation of each parameter with a tolerance, m and rad."""
    mimic: Mimic | None = None
    coupling: Mapping[str, float] = field(default_factory=dict)
    """Turn of this joint per unit of other joint variables: the joint moves by ``q_i + sum of c_k q_k``."""
    is_passive: bool = False
    """True for a joint without a motor: it moves by its coupling alone."""
    link: str | None = None
    """Name of the link that this joint moves; None where the description has no name."""
    outside: Mimic | None = field(default=None, compare=False)
    """Rule by which a joint variable of a URDF follows a joint outside the chain; None: it moves by itself."""

    @property
    def is_variable(self) -> bool:
        """True for a joint with a variable (a column ``q_i``)."""
        return self.type != "fixed" and self.mimic is None and not self.is_passive

    @property
    def offset_parameter(self) -> str:
        """Name of the parameter that is added to the joint's variable."""
        return "offset" if "offset" in self.parameters else "theta" if self.type == "revolute" else "d"


class BranchJoint(NamedTuple):
    """Joint outside the chain that moves mass: the other arm of a torso, a slide with a tool."""

    joint: Joint
    """Joint and its link, in the convention of a URDF."""
    parent: str | None
    """Joint of the chain, or earlier joint of a branch, whose link carries it; None: the base carries it."""
    position: float = 0.0
    """Its variable where the poses do not have it, rad or m."""


class Campaign(NamedTuple):
    """Facts of the measuring campaign that a model was fitted in."""

    poses: tuple[str, ...]
    """SHA-256 of its pose files."""
    base: Frame | None = None
    """Base before it was registered in the campaign; None if it was not."""
    tool: Frame | None = None
    """Tool before it was registered in the campaign; None if it was not."""
    targets: Mapping[str, Frame] = {}
    """Targets before they were registered in the campaign."""
    effects: tuple[Mapping[str, Any], ...] = ()
    """Entries of effects that hold for the campaign alone, in the units of the robot's effects."""
    kept: bool = False
    """True once the effects stand among the robot's own, for poses of the campaign."""


class Fixture(NamedTuple):
    """What poses are measured from: a socket, a plane, a line, a sphere or an anchor."""

    kind: str
    """Kind of measurement, of :data:`robacc.measurements.SHOWN`."""
    base: Frame = Frame()
    """Where the robot's base stands, seen from it."""
    radius: float = 0.0
    """Radius of a sphere that is not known, m."""


@dataclass(frozen=True, slots=True)
class Robot:
    """Arm as its file describes it."""

    name: str
    convention: Convention
    joints: tuple[Joint, ...]
    base: Frame = Frame()
    """Transform from the measuring frame to the robot base."""
    tool: Frame = Frame()
    """Transform from the last link's frame to the measured target."""
    gravity: Vector = STANDARD_GRAVITY
    """m/s^2 in the measuring frame."""
    payload_com: Vector | None = None
    """Payload's centre of mass in the last link's frame, m; None: at the tool."""
    targets: Mapping[str, Frame] = field(default_factory=dict)
    fixtures: Mapping[str, Fixture] = field(default_factory=dict)
    """Sockets, planes, lines, spheres and anchors of the poses by name, and the measuring frame as "" if they have
    positions; no part of the robot file."""
    effects: tuple[Mapping[str, Any], ...] = ()
    """Entries of the file's ``effects:``, unchanged; :mod:`robacc.effects` reads them."""
    effect_units: tuple[float, float] = (1.0, 1.0)
    """Units of the numbers in ``effects``: of length in m, of angle in rad."""
    base_tolerance: Mapping[str, float] = field(default_factory=dict)
    tool_tolerance: Mapping[str, float] = field(default_factory=dict)
    base_link: str | None = None
    tip_link: str | None = None
    fitted_to: tuple[str, ...] = ()
    """SHA-256 of each pose file that the robot's numbers were fitted to."""
    campaign: Campaign | None = None
    mass_uncertainty: float | None = None
    """Relative standard deviation of each link's mass; None if it is not stated."""
    fit: Mapping[str, Any] | None = None
    """Part ``fit:`` of a model file, unchanged; :mod:`robacc.prediction.model_uncertainty` reads it."""
    branches: tuple[BranchJoint, ...] = ()
    """Joints outside the chain that move mass; each stands behind its parent."""
    identity: Mapping[str, str] = field(default_factory=dict)
    """What was tested, by the keys of :data:`robacc.robots.description.IDENTITY`."""
    file_text: str | None = field(default=None, compare=False, repr=False)
    """Text of the robot file that the robot was read from, whose comments and units a fitted model keeps."""

    @property
    def variables(self) -> tuple[Joint, ...]:
        """Joints that have a variable, in chain order: joint i is ``q_i`` of the poses."""
        return tuple(joint for joint in self.joints if joint.is_variable)

    @property
    def variable_names(self) -> tuple[str, ...]:
        """Names of the joints that have a variable."""
        return tuple(joint.name for joint in self.variables)

    @property
    def branch_variables(self) -> tuple[BranchJoint, ...]:
        """Moving joints outside the chain, in the order of :attr:`branches`: the rows of a measurement's branches."""
        return tuple(branch for branch in self.branches if branch.joint.is_variable)

    def carrier(self, branch: BranchJoint) -> str | None:
        """Return the joint of the chain whose link carries a joint of a branch; None for the base."""
        beside = {other.joint.name: other for other in self.branches}
        while branch.parent in beside:
            branch = beside[branch.parent]
        return branch.parent

    @property
    def has_masses(self) -> bool:
        """True where the weight that loads the joints is known: every moved link from the first mass on has a mass."""
        return any(joint.mass for joint in self.joints)


def finite_limits(kind: str, limits: tuple[float, float]) -> tuple[tuple[float, float] | None, str | None]:
    """Return a joint's limits, rad or m, None where large numbers mean "no limit", and a problem of them or None."""
    beyond = [abs(value) > (_LIMITS_IN_DEGREES if kind == "revolute" else TRAVEL_IN_MM)[1] for value in limits]
    if not any(beyond):
        return limits, None
    too_large = f"the limits {limits[0]:g} and {limits[1]:g} are too large for a joint"
    return None, None if all(beyond) and limits[0] < 0 < limits[1] else too_large


def limits_likely_degrees(joints: Sequence[Joint]) -> bool:
    """Return whether the limits of all revolute joints, in rad, only make sense in degrees."""
    limits = [joint.limits for joint in joints if joint.limits and joint.type == "revolute"]
    low, high = _LIMITS_IN_DEGREES
    return bool(limits) and all(low < max(map(abs, pair)) < high for pair in limits)


def effect_key(i: int) -> str:
    """Return the dotted key of an entry of the file's ``effects:``, for messages."""
    return f"effects[{i}]"


# Identity of what was tested: the arm's serial number, the instrument, who measured where and when.

IDENTITY = {
    "customer": "Customer",
    "order": "Order",
    "robot": "Robot",
    "serial_number": "Serial number",
    "controller": "Controller",
    "instrument": "Instrument",
    "instrument_serial": "Serial number of the instrument",
    "certificate": "Calibration certificate",
    "operator": "Operator",
    "place": "Place",
    "date": "Date of the measurement",
    "remarks": "Remarks",
}
"""Keys of an identity and their labels on a page, in the order of the page."""
