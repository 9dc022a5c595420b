"""Names of a pose file's columns, and what is stated of the file: by its user, a column map and its robot."""

import difflib
import os
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np
import yaml

from robacc.errors import refuse
from robacc.geometry import Array, Poses, exp_so3, rotation_from_quaternion, rotation_from_rpy
from robacc.io.column_table import divided
from robacc.io.dialect import UNIT_NAMES
from robacc.io.files import read_text
from robacc.io.table import TableOptions
from robacc.io.yaml_nodes import Source, describe, is_null, join, top_section
from robacc.measurements import Measurements

# Meaning of column names that instruments and robots write: ``X [mm]``, ``J1``, ``pose.position.x``, ``Nominal Y``.

_WITH_UNIT = (
    re.compile(r"(.*?)\s+in\s+(\S+)"),
    re.compile(r"(.*?)\s*[\[(<{]\s*([^\])>}]*?)\s*[\])>}]"),
    re.compile(r"(.*?[^\s_/])\s*[_/ ]\s*(µm|μm|[a-zA-Z°]{2,}|[ms°])"),
    re.compile(r"(.*?)\s*[\[( _/]\s*(Grad)\s*[\])]?"),
)
"""Forms of a name with its unit; ``Grad`` is a degree in German, ``grad`` may be a gradian, 400 to the turn."""
_TOKEN = re.compile(r"[\u3040-\u9fff]+|[^\W\d_\u3040-\u9fff]+|\d+")
"""Words and numbers; those of Chinese and Japanese stand beside others without a blank: ``测量X``."""

_COMMANDED = frozenset(
    [
        "cmd",
        "command",
        "commanded",
        "nominal",
        "nom",
        "soll",
        "set",
        "setpoint",
        "desired",
        "des",
        "ref",
        "reference",
        "programmed",
        "prog",
        "planned",
        "goal",
        *("sollwert", "aspos", "rsol", "théorique", "theorique", "consigne", "teorico", "teórico", "nominale"),
        *("名义", "标称", "理论", "指令", "目标", "目標", "指令値"),
    ]
)
_ACTUAL = frozenset(["actual", "act", "ist", "istwert", "attained", "real", "aipos", "实际"])
"""Words of what an instrument or the controller may have attained."""
_ATTAINED = _ACTUAL | frozenset(
    [
        *("meas", "measured", "measurement", "observed", "messwert", "gemessen", "messung"),
        *("tracker", "tracking", "camera", "cam", "optical", "marker", "sensor"),
        *("mesuré", "mesurée", "mesure", "medido", "medida", "misurato", "misurata", "测量", "实测", "測定", "計測"),
    ]
)
_INSTRUMENTS = (_ATTAINED - _ACTUAL) | frozenset(
    [
        *("trk", "lasertracker", "laser", "lt", "leica", "at", "faro", "api", "radian", "vantage", "smr", "mac"),
        *("mocap", "aruco", "optitrack", "motive", "vicon", "qualisys", "polaris", "ndi", "optotrak", "creaform"),
        *(
            "track",
            "ctrack",
            "vxtrack",
            "photogrammetry",
            "cmm",
            "romer",
            "theodolite",
            "nikon",
            "reflector",
            "reflektor",
        ),
        *("mess", "analyzer", "gt", "truth", "true", "opti", "ext", "extern", "external", "prism", "metrology"),
        *("tag", "apriltag", "charuco", "chessboard", "checkerboard", "eye"),
    ]
)
"""Instruments, and words that say measured by one."""
_CONTROLLER = frozenset(
    ["robot", "roboter", "controller", "steuerung", "rist", "est", "estimated", "fk", "ctrl", "effector", "gripper"]
)
"""Words of a position that the controller computed."""
_FILLERS = frozenset(
    [
        "pose",
        "position",
        "positions",
        "pos",
        "point",
        "translation",
        "trans",
        "transform",
        "orientation",
        "orient",
        "orientierung",
        "rotation",
        "rot",
        "tool",
        "tcp",
        "robot",
        "coordinate",
        "coord",
        "koordinate",
        "value",
        "wert",
        "tip",
        "ee",
        "cartesian",
        "cart",
        "quaternion",
        "quat",
        "angle",
        "euler",
        "winkel",
        "matrix",
        "joint",
        "joints",
        "states",
        "state",
        "axis",
        "header",
        "stamped",
        *("effector", "gripper", "object", "wrt", "world", "角度", "位置", "坐标", "座標", "值", "値", "第"),
    ]
)
_ORIENTED = frozenset(
    ["angle", "winkel", "orientation", "orient", "orientierung", "rotation", "rot", "quaternion", "quat", "euler"]
)
DEVIATIONS = frozenset(
    [
        *("dev", "deviation", "delta", "diff", "dif", "difference", "error", "err", "abweichung", "abw"),
        *("écart", "ecart", "desviación", "scarto", "偏差", "误差"),
    ]
)
"""Words of a measured value less the commanded one."""
_REFUSED = DEVIATIONS | frozenset(
    [
        *("min", "max", "residual", "resid", "normal", "gyro", "imu"),
        *("余量", "公差", "誤差"),
        "tolerance",
        "tol",
        "offset",
        "velocity",
        "vel",
        "speed",
        "acceleration",
        "acc",
        "force",
        "torque",
        "moment",
        "current",
        "twist",
        "linear",
        "angular",
        "rms",
        "dx",
        "dy",
        "dz",
    ]
)
"""Words that make a name none of a pose's: a deviation from the nominal value, a velocity, a force."""
_JOINT_WORDS = frozenset(
    [
        *("q", "j", "jt", "a", "joint", "joints", "axis", "ax", "actuator", "achse", "gelenk", "theta", "th", "rax"),
        *(
            "axe",
            "articulation",
            "articulación",
            "articulacion",
            "eje",
            "asse",
            "giunto",
            "junta",
            "关节",
            "轴",
            "関節",
            "軸",
        ),
    ]
)
_ARMS = (
    ("s", "l", "u", "r", "b", "t"),
    ("base", "shoulder", "elbow", "wrist 1", "wrist 2", "wrist 3"),
    ("base", "shoulder", "elbow", "w 1", "w 2", "w 3"),
)
"""Names of the six axes from the base: Yaskawa's letters, and those on the pendant of Universal Robots."""
_SPREAD = frozenset(["sigma", "std", "stdev", "stddev", "sd"])
_UNCERTAIN = frozenset(["u", "uncertainty", "unc", "unsicherheit"])
_WHOLE_NAMES = {
    **dict.fromkeys(("pose", "id", "pose id", "pose name", "pose number"), "pose"),
    **dict.fromkeys(
        ("point", "point name", "pointname", "point id", "name", "punkt", "punktname", "messpunkt"), "pose"
    ),
    **dict.fromkeys(("object", "object name", "collection group point"), "pose"),  # SpatialAnalyzer
    **dict.fromkeys(
        ("punto", "nombre", "nom", "nome", "merkmal", "characteristic name", "名称", "点名", "点号", "测点"), "pose"
    ),
    **dict.fromkeys(("label", "feature", "feature name", "element", "element name"), "pose"),  # CAM2, PolyWorks, GOM
    **dict.fromkeys(("target name", "target id", "frame name"), "pose"),
    **dict.fromkeys(("image", "image name", "image file", "photo", "file", "file name", "filename"), "pose"),
    **dict.fromkeys(("cycle", "run", "repetition", "zyklus", "wiederholung", "lauf"), "cycle"),
    **dict.fromkeys(("target", "smr", "reflector", "marker", "reflektor"), "target"),
    **dict.fromkeys(("visit", "arrival"), "visit"),
    **dict.fromkeys(
        ("time", "timestamp", "time stamp", "stamp", "t", "zeit", "zeitstempel", "uhrzeit", "时间"), "time"
    ),
    **dict.fromkeys(("datetime", "date time", "datum zeit", "date and time"), "time"),
    **dict.fromkeys(("date", "datum"), "date"),
    **dict.fromkeys(("stamp sec", "header stamp sec", "header stamp secs", "stamp secs"), "seconds"),
    **dict.fromkeys(("stamp nanosec", "stamp nsec", "header stamp nanosec", "header stamp nsecs"), "nanoseconds"),
    **dict.fromkeys(("temperature", "temp", "temperatur", "air temperature", "t air"), "temperature_c"),
    **dict.fromkeys(("ambient temperature", "room temperature", "lufttemperatur", "raumtemperatur"), "temperature_c"),
    **dict.fromkeys(("payload", "load", "nutzlast", "traglast"), "payload_kg"),
}
"""Keys of names that are known as a whole, in small letters, words separated by blanks."""
TIME_KEYS = ("time", "date", "seconds", "nanoseconds")
"""Keys of the columns that give a time together, as text."""
AXES = ("x", "y", "z")
QUATERNION = ("qw", "qx", "qy", "qz")
ROTATION_VECTOR = ("rx", "ry", "rz")
RPY = ("roll", "pitch", "yaw")


class Heading(NamedTuple):
    """Column name of an instrument or robot, taken apart."""

    name: str
    """Name in the file."""
    words: tuple[str, ...]
    """Words and numbers of the name without its unit, in small letters."""
    unit: str | None
    """Unit in the name, in the package's spelling."""

    @property
    def text(self) -> str:
        """Return the words separated by blanks."""
        return " ".join(self.words)


class Meaning(NamedTuple):
    """Documented column that a name stands for."""

    key: str
    """Documented name without a unit; a joint is ``q`` and its number as the file counts."""
    commanded: bool | None = None
    """Whether the name says commanded or attained; None where it says neither."""
    family: str | None = None
    """Kind of angles: ``axes`` (Rx, Ry, Rz), ``abc``, ``wpr``, ``oat``, ``ur`` (a rotation vector)."""
    coverage: float = 1.0
    """Coverage factor that the name states."""
    expanded: bool = False
    """Whether the name is of an uncertainty whose coverage factor it does not say."""

    @property
    def full_key(self) -> str:
        """The key, of a commanded pose with ``cmd_`` before it."""
        return f"cmd_{self.key}" if self.commanded and f"cmd_{self.key}" in FIXED_KINDS else self.key


_FAMILIES = {"abc": ("a", "b", "c"), "abg": ("alpha", "beta", "gamma"), "wpr": ("w", "p", "r"), "oat": ("o", "a", "t")}
"""Names of three angles that mean an orientation together."""
_OF_REPORTS = {f"{sign}{axis}": Meaning(axis, sign == "n") for sign in "nm" for axis in AXES}
"""Meaning of the names NX … MZ of nominal and measured coordinates, where a file has both."""
_COORDINATES: Mapping[str, Meaning] = {
    **{f"{prefix}{axis}": Meaning(axis) for prefix in ("", "t", "p") for axis in AXES},
    **{name: Meaning(name) for name in (*QUATERNION, *RPY)},
    **{name: Meaning(name, family="axes") for name in ROTATION_VECTOR},
}
"""Meaning of a name's words without those that say nothing, joined."""


def heading_of(name: str) -> Heading:
    """Return the parts of a column's name."""
    # Signals of RobotStudio have a path: System1\ROB_1\J1; fields of rostopic begin with field.
    stem, unit = name.strip().strip("'\"").rpartition("\\")[2].removeprefix("field."), None
    words = tuple(_TOKEN.findall(stem.lower()))
    if _WHOLE_NAMES.get(" ".join(words)) in TIME_KEYS:  # seconds of a stamp, not a stamp in seconds
        return Heading(name, words, None)
    matches = filter(None, (form.fullmatch(stem) for form in _WITH_UNIT))
    if match := next((match for match in matches if match[2] == "Grad" or match[2].lower() in UNIT_NAMES), None):
        stem, unit = match[1], UNIT_NAMES.get(match[2].lower(), "deg")
    stem = re.sub(r"^\d+\s*<(.*)>$", r"\1", stem)  # a channel behind its number, as loggers write it: 101 <Trk X>
    spaced = re.sub(r"(?<=[a-zäöü])(?=[A-Z])|(?<=\b[XYZ])(?=[A-Z][a-z])", " ", stem)
    return Heading(name, tuple(_TOKEN.findall(spaced.lower())), unit)


def meaning_of(heading: Heading, siblings: frozenset[str]) -> Meaning | None:
    """Return what a name stands for; None for a name that is none of a pose's columns.

    Args:
        heading: The name.
        siblings: Texts of all headings of the file, which make single letters unambiguous.
    """
    words, text = heading.words, heading.text
    for axes in _ARMS:
        if text in axes and {*axes} <= siblings:
            return Meaning(f"q{axes.index(text) + 1}")
    if key := _WHOLE_NAMES.get(text):
        return Meaning(key)
    if _REFUSED & set(words) or not words:
        return None
    # Mx alone may be a moment.
    if words[0] in _OF_REPORTS and ({*words[1:]} & {"coord", "coordinate"} or {text, *_OF_REPORTS} <= siblings):
        return _OF_REPORTS[words[0]]
    # Universal Robots' data exchange: target_q_0, target_TCP_pose_3.
    if match := re.fullmatch(r"(target|actual) q (\d+)", text):
        return Meaning(f"q{match[2]}", match[1] == "target", "ur")
    if match := re.fullmatch(r"target tcp pose ([0-5])", text):
        return Meaning((*AXES, *ROTATION_VECTOR)[int(match[1])], True, "ur")
    if words == ("q", "0") and {"qx", "qy", "qz"} <= siblings and "q 1" not in siblings:  # NDI
        return Meaning("qw")
    commanded = True if _COMMANDED & set(words) else False if _ATTAINED & set(words) else None
    core = tuple(word for word in words if word not in _COMMANDED | _ATTAINED)
    of_joint = " ".join(word for word in core if word not in _FILLERS or word in _JOINT_WORDS)
    of_joint = re.sub(r"^(\d\d?) (轴|軸)$", r"\2 \1", of_joint)
    # A path such as /joint_states/j1/position has both words.
    # Commands without another word stand beside the joints that were read back: cmd1 … cmd6.
    if (match := re.fullmatch(r"(?:(?:joint |axis )?(\w+) )?(\d\d?)", of_joint)) and (
        match[1] in _JOINT_WORDS
        or re.match(r"joint angles? ", of_joint)
        or (commanded and not match[1] and {f"{text[:-1]}{i}" for i in range(1, 7)} <= siblings)
    ):
        return Meaning(f"q{int(match[2])}", commanded)
    meaning = _uncertainty(core) or _coordinate(text, core, siblings)
    return None if meaning is None else meaning._replace(commanded=commanded)


_FORMS = _ORIENTED | {"pose", "position", "pos", "point", "translation", "trans"}
"""Words that say no more than the axis beside them."""
_PART_OF = {
    **{name: meaning.key for name, meaning in _COORDINATES.items() if meaning.key in AXES},
    **dict.fromkeys((*ROTATION_VECTOR, *QUATERNION, *RPY, "rw", "phix", "phiy", "phiz"), "turn"),
    **{name: "turn" for names in _FAMILIES.values() for name in names},
}
"""Axis that a word of a coordinate's name stands for, ``turn`` for an angle."""


def labelled(heading: Heading) -> tuple[tuple[str, ...], str] | None:
    """Return the words beside a coordinate, and its axis or ``turn`` for an angle; None for another name."""
    words = heading.words
    # px_r is no angle
    at = next((i for kinds in (AXES, ("turn",)) for i in (-1, 0) if words and _PART_OF.get(words[i]) in kinds), None)
    if at is None:
        return None
    label = tuple(word for i, word in enumerate(words) if i != at % len(words) and word not in _FORMS)
    return label, "turn" if _ORIENTED & {*words} else _PART_OF[words[at]]


def source_of(label: Collection[str]) -> int:
    """Return how surely a position was measured whose axes have these words beside them.

    3: by an instrument; 2: attained; 1: no word says how; 0: computed by the controller; -1: no attained position.
    """
    other = _COMMANDED | _REFUSED | _SPREAD | _UNCERTAIN | {"set"} | {*"deavfw" * (len(label) == 1)}  # dX, vX
    ranks = ((-1, other), (0, _CONTROLLER), (3, _INSTRUMENTS), (2, _ACTUAL))
    return next((rank for rank, words in ranks if words & {*label}), 1)


SAY_LITTLE = _FILLERS | _ATTAINED
"""Words that tell no point from another."""


def is_point_name(name: str) -> bool:
    """Return whether a name is that of a column of point or pose names."""
    return _WHOLE_NAMES.get(heading_of(name).text) == "pose"


def _coordinate(text: str, core: Sequence[str], siblings: frozenset[str]) -> Meaning | None:
    """Return the meaning of a coordinate or an angle, whose words without commanded and attained are ``core``."""
    joined = "".join(word for word in core if word not in _FILLERS)
    oriented = bool(_ORIENTED & set(core))
    if oriented and joined in ("x", "y", "z", "w"):
        is_quaternion = any("w" in sibling.split() for sibling in siblings)
        return Meaning(f"q{joined}") if is_quaternion else Meaning(f"r{joined}", family="axes")
    if (
        match := re.fullmatch(r"(?:observation|.*(?=[tr]vec))?(p|tvec|rvec|)\d+", joined)
    ) and not oriented:  # pos_1, pos_2, pos_3; a pose has an orientation behind
        places = sorted(sibling for sibling in siblings if sibling.rpartition(" ")[0] == text.rpartition(" ")[0])
        keys = ROTATION_VECTOR if match[1] == "rvec" else AXES
        if len(places) in (6, 7) and "pose" in core and not {"tcp", "robot", "ee"} & set(core):
            keys = (*AXES, *(QUATERNION if len(places) == 7 else ROTATION_VECTOR))
        key = keys[places.index(text)] if len(places) == len(keys) else None
        family = "ur" if match[1] == "rvec" else "quaternion" if key in QUATERNION else "axes"
        return None if key is None else Meaning(key, family=None if key in AXES else family)
    if joined in ("rx", "ry", "rz", "rw") and "rw" in siblings:  # Vicon
        return Meaning(f"q{joined[1]}")
    if oriented and joined[-1:] in {*"1234"} and {n for n in "0123456789" if text[:-1] + n in siblings} == {*"1234"}:
        return Meaning(QUATERNION[int(joined[-1]) - 1], family="quaternion")
    letters = {"".join(word for word in name.split() if word not in _COMMANDED | _ATTAINED) for name in siblings}
    for family, names in _FAMILIES.items():
        if joined in names and {*names} <= letters:
            return Meaning(ROTATION_VECTOR[names.index(joined)], family=family)
    return _COORDINATES.get(joined)


def _uncertainty(core: Sequence[str]) -> Meaning | None:
    """Return the meaning of a standard deviation or of an uncertainty along an axis."""
    split = (word if word in ("ux", "uy", "uz") else (word,) for word in core if word not in _FILLERS)
    words = [word for parts in split for word in parts]
    axes = [word for word in words if word in AXES]
    known = _SPREAD if _SPREAD & {*words} else _UNCERTAIN
    is_95 = "95" in core  # U95 names its coverage; without an axis it is of all of them
    if len(axes) in (1 - is_95, 1) and known & {*words} and {*words} <= {*axes, "95", *known}:
        is_open = known is _UNCERTAIN and not is_95
        return Meaning(f"sigma_{axes[0]}" if axes else "sigma", coverage=1.0 + is_95, expanded=is_open)
    return None


Kind = Literal["length", "angle", "joint", "ratio", "number", "text"]

UNITS: Mapping[str, tuple[str, float]] = {
    "m": ("length", 1.0),
    "mm": ("length", 1e3),
    "um": ("length", 1e6),
    "cm": ("length", 1e2),
    "in": ("length", 1.0 / 0.0254),
    "rad": ("angle", 1.0),
    "mrad": ("angle", 1e3),
    "deg": ("angle", 180.0 / np.pi),
    "s": ("time", 1.0),
    "ms": ("time", 1e3),
    "us": ("time", 1e6),
    "ns": ("time", 1e9),
    "min": ("time", 1.0 / 60.0),
    "h": ("time", 1.0 / 3600.0),
    "kg": ("mass", 1.0),
    "g": ("mass", 1e3),
    "degC": ("temperature", 1.0),
}
"""Quantity of each unit, and how many make one SI unit (x / 1e3 rounds once, x * 1e-3 twice)."""
NAME_UNITS = ("m", "mm", "um", "rad", "mrad", "deg")
"""Units that a documented name may end in; the others stand in the names of instruments."""

ORIENTATIONS = (QUATERNION, ROTATION_VECTOR, RPY)
COMMANDED_AXES = tuple(f"cmd_{axis}" for axis in AXES)
COMMANDED_QUATERNION = tuple(f"cmd_{name}" for name in QUATERNION)
SIGMAS = tuple(f"sigma_{axis}" for axis in AXES)
CORRELATIONS = ("corr_xy", "corr_xz", "corr_yz")
BY_SIGHT = ("sigma_range", "sigma_across")
INSTRUMENT = tuple(f"instrument_{axis}" for axis in AXES)
TEXTS = ("pose", "cycle", "visit", "target", "payload_group")
CIRCUMSTANCES = ("time_s", "temperature_c", "payload_kg")


FIXED_KINDS: Mapping[str, Kind] = {
    **dict.fromkeys(TEXTS, "text"),
    **dict.fromkeys(AXES, "length"),
    **dict.fromkeys(QUATERNION, "ratio"),
    **dict.fromkeys((*ROTATION_VECTOR, *RPY), "angle"),
    **dict.fromkeys(COMMANDED_AXES, "length"),
    **dict.fromkeys(COMMANDED_QUATERNION, "ratio"),
    **dict.fromkeys((f"cmd_{name}" for name in (*ROTATION_VECTOR, *RPY)), "angle"),
    **dict.fromkeys((*SIGMAS, *BY_SIGHT, *INSTRUMENT), "length"),
    **dict.fromkeys(CORRELATIONS, "ratio"),
    "sigma_r": "angle",
    **dict.fromkeys(CIRCUMSTANCES, "number"),
}
"""Kind of every column name without a joint's number."""
JOINT_COLUMN = re.compile(r"(dir_|speed_|read_)?q([1-9]\d{0,2})", re.ASCII)


@dataclass(frozen=True, slots=True)
class Column:
    """Column of the file that robacc reads."""

    name: str
    """Name in the file."""
    index: int
    """Position in the file, from 0."""
    key: str
    """Documented name without a unit: ``q1``, ``cmd_x``, ``dir_q2``."""
    kind: Kind
    unit: str | None
    """Unit in the name, or as stated by the user; None for a bare name, which is SI."""
    coverage: float = 1.0
    """Coverage factor of an uncertainty."""

    @property
    def label(self) -> str:
        """Documented name with the unit."""
        has_unit = self.unit is not None and self.key not in ("temperature_c", "payload_kg")
        return f"{self.key}_{self.unit}" if has_unit else self.key

    @property
    def divisor(self) -> float:
        """Number of the column's unit that makes one SI unit."""
        return (1.0 if self.unit is None else UNITS[self.unit][1]) * self.coverage


class BranchColumn(NamedTuple):
    """Joint outside the robot's chain that moves mass, and may have a column."""

    name: str
    type: str
    """``revolute`` or ``prismatic``."""
    position: float
    """Its variable where there is no column, rad or m."""
    loads_joints: bool
    """True if a joint of the chain carries its mass."""


def split_unit(name: str) -> tuple[str, str | None]:
    """Return a name without its unit, and the unit; the name and None where it has no unit."""
    stem, _, unit = name.rpartition("_")
    return (stem, unit) if stem and unit in NAME_UNITS else (name, None)


def is_documented(name: str) -> bool:
    """Return whether a name, with or without its unit, is a documented one."""
    texts = (name, split_unit(name)[0])
    return any(text in FIXED_KINDS or JOINT_COLUMN.fullmatch(text.removeprefix("cmd_")) for text in texts)


def time_column(name: str, index: int = 0, label: str = "") -> Column | None:
    """Return the column of a time that a column map names ``time``, ``date`` or ``time_ms``; None for another name."""
    stem, _, unit = name.rpartition("_")
    if name in TIME_KEYS:
        return Column(label, index, name, "text", None)
    known = stem == "time" and unit in UNITS and UNITS[unit][0] == "time"
    return Column(label, index, "time", "text", unit) if known else None


# What is stated of a pose file: by its user, in a column map, and by the robot that it is of.

# Conventions of three angles that form an orientation, and the trial of the data against each.
#
# A name such as ``Rx`` does not say which convention it belongs to: a rotation vector on one controller, angles about
# fixed axes on the next. Turns between poses depend neither on the measuring frame nor on the mounting of the target,
# so they show which convention the orientations follow.

AGREES = np.radians(3.0)
"""rad; typical disagreement of a convention that fits: no arm turns its flange by more than it was commanded to."""


def _about(axes: Sequence[int], angles: Array) -> Array:
    """Return the rotations ``(3, 3, N)`` about these moving axes by ``angles`` ``(3, N)``, rad."""
    first, second, third = (exp_so3(np.eye(3)[:, axis, None] * angle) for axis, angle in zip(axes, angles, strict=True))
    return np.asarray(np.einsum("ijn,jkn,kln->iln", first, second, third))


CONVENTIONS: Mapping[str, Callable[[Array], Array]] = {
    "rotvec": exp_so3,
    "fixed-xyz": rotation_from_rpy,
    "moving-xyz": partial(_about, (0, 1, 2)),
    "zyx": rotation_from_rpy,
    "kuka-abc": partial(_about, (2, 1, 0)),
    "zyz": partial(_about, (2, 1, 2)),
    "wxyz": rotation_from_quaternion,
    "xyzw": lambda quaternion: rotation_from_quaternion(np.roll(quaternion, 1, axis=0)),
}
"""Rotation ``(3, 3, N)`` of three angles ``(3, N)``, rad.

``rotvec``: rotation vector. ``fixed-xyz``: about the fixed axes x, then y, then z; ``zyx`` is the same rotation
described about moving axes z, y, x. ``moving-xyz``: about the moving axes x, y, z. ``kuka-abc``: A about z, B about the
moving y, C about the moving x. ``zyz``: about the moving axes z, y, z, as Kawasaki's O, A, T.
``wxyz`` and ``xyzw`` are quaternions ``(4, N)`` with the scalar part first or last.
"""


def is_ruled_out(name: str, trial: Mapping[str, float]) -> bool:
    """Return whether the convention with the smallest disagreement fits and another one does not."""
    best = min(trial.values())
    # Ratio of the typical disagreements at which the second convention is ruled out, and the least disagreement that
    # does: arms turn their flanges amiss by 0.5° at most.
    return bool(best < AGREES and trial[name] > max(5.0 * best, np.radians(0.5)))


def try_conventions(angles: Array, known: Array, conventions: Sequence[str]) -> dict[str, float] | None:
    """Compare turns between poses under each convention with those of known orientations.

    The turn of R_i^T R_j R_k^T R_l depends on no frame. Two poses alone would not tell a convention from its mirror
    image, such as angles about x, y, z from angles about z, y, x.

    Args:
        angles: ``(3, N)`` rad.
        known: ``(3, 3, N)`` orientations of the same poses, in any frame and of any part of the same body.
        conventions: Names of :data:`CONVENTIONS`.

    Returns:
        Median difference between measured and known turn by convention, rad; None if too few poses differ.
    """
    n = angles.shape[1]
    # Comparisons at most.
    first = np.unique(np.linspace(0, n - 1, min(n, 400)).astype(int))
    steps = (0, 1, n // 3 + 1, 2 * n // 3 + 1)
    fours = np.stack([(first + step) % n for step in steps])
    turned = _turns(known, fours)
    fours, turned = fours[:, turned > 2 * AGREES], turned[turned > 2 * AGREES]
    if n < len(steps) or turned.size < 4:  # a decision needs four comparisons
        return None
    tried = {name: _turns(CONVENTIONS[name](angles), fours) - turned for name in conventions}
    return {name: float(np.median(np.abs(difference))) for name, difference in tried.items()}


def _turns(rotation: Array, fours: Array) -> Array:
    """Return the angle of the rotation R_i^T R_j R_k^T R_l of each four poses ``(4, M)``, rad."""
    first, second, third, fourth = (rotation[..., rows] for rows in fours)
    trace = np.einsum("abn,ban->n", np.einsum("ian,ibn->abn", first, second), np.einsum("ian,ibn->abn", third, fourth))
    return np.asarray(np.arccos(np.clip((trace - 1) / 2, -1.0, 1.0)))


# Column maps: YAML files that say which column of an export is which, and what its names leave open.
#
# robacc_columns: 1
# angles: fixed-xyz
# units: mm,deg
# columns:
#   "A1 [°]": q1_deg
#   "X [mm]": x_mm
#   Comment:                       # not read

OPEN = "unknown"
"""Entry of a statement that the user has to fill in; a command refuses it."""


def read_column_map(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Return the statements of a column map by their names in :class:`~robacc.poses.reading.Reading`.

    Raises:
        InputError: The file cannot be read, or has problems; with every problem, its line and key.
    """
    name = os.fspath(path)
    kinds: dict[str, Callable[[Source, yaml.Node, str], Any]] = {
        "angles": partial(Source.choice, options=tuple(CONVENTIONS)),
        "units": Source.text,
        "coverage": Source.number,
        "sheet": Source.text,
        "bag": Source.text,
        "columns": _read_columns,
    }
    top = top_section(read_text(name), name, ("robacc_columns", *kinds))
    version = top.require("robacc_columns")
    if version is not None and getattr(version, "value", None) != "1":
        top.report("robacc_columns", f"expected 1, found {describe(version)}")
    result = {key: read(top.source, node, key) for key, read in kinds.items() if (node := top.get(key)) is not None}
    if result.get("units") == OPEN:
        top.report("units", "is not filled in", "for example mm,deg")
    top.source.raise_if_any()
    return result


def _read_columns(source: Source, node: yaml.Node, path: str) -> dict[str, str | None]:
    """Return the documented name by the name in the file, None for a column that is not read."""
    if not isinstance(node, yaml.MappingNode):
        source.report(node, path, f"expected names with documented names, found {describe(node)}")
        return {}
    result: dict[str, str | None] = {}
    for name, _, value in source.entries(node, path):
        key = join(path, name)
        result[name] = meaning = None if is_null(value) else source.text(value, key)
        if meaning is not None and not is_documented(meaning) and time_column(meaning) is None:
            known = [*FIXED_KINDS, *TIME_KEYS, *(f"q{i}" for i in range(1, 8))]
            known += [f"{key}_{unit}" for key in known for unit in NAME_UNITS]
            nearest = difflib.get_close_matches(meaning.lower(), known, n=1, cutoff=0.0)[0]
            source.report(value, key, f"expected a documented name, found {meaning!r}", f"did you mean {nearest}?")
    return result


# What the reader of a pose file knows of the robot that the poses are of.


KnownPoses = Callable[[Measurements], tuple[Array | None, Array | None]]
"""Positions ``(3, N)`` and orientations ``(3, 3, N)`` that another file gives to rows, by their names, times and lines,
NaN where it has no such row; None for what it does not give."""


class KnownRobot(NamedTuple):
    """Names, limits and targets of a robot, which the columns of its poses are checked against."""

    joint_names: Sequence[str] | None = None
    """Joints in chain order; their names stand for ``q1 … qN``. None: no robot is known."""
    joint_types: Sequence[str] | None = None
    """``revolute`` or ``prismatic`` of each joint; None: a joint's unit may be an angle or a length."""
    limits: Sequence[tuple[float, float] | None] | None = None
    """Lowest and highest value of each joint, rad or m, None for a joint without limits; None: unknown."""
    target_names: Sequence[str] | Literal["any"] | None = None
    """Targets of the robot file, empty for a robot with one tool; None: no robot is known, and any name is valid.
    ``any``: several targets are valid although the robot has one tool, as columns ``x1 … z2`` too."""
    branches: Sequence[BranchColumn] = ()
    """Joints outside the chain that move mass; each stands at its position where it has no column."""
    outside: Mapping[str, str] = {}
    """Joints outside the chain that a joint variable follows, and the rule by which it does."""
    pose_at: Callable[[Array], Poses] | None = None
    """Nominal poses of the robot at joint variables ``(J, N)``, which show units and the convention of angles that
    names leave open."""

    @property
    def targets(self) -> tuple[str, ...]:
        """Names of the targets of the robot file; empty where it has one tool, or no robot is known."""
        return () if self.target_names is None or self.target_names == "any" else tuple(self.target_names)


UNKNOWN_ROBOT = KnownRobot()
"""No robot is known."""


READING = (
    "angles",
    "units",
    "columns",
    "skip_gaps",
    "coverage",
    "sheet",
    "commanded",
    "camera",
    "board",
    "bag",
    "contact_sheet",
)
"""Names of the statements of a :class:`Reading`."""


@dataclass(frozen=True, slots=True)
class Reading(TableOptions):
    """Statements on a pose file that apply where its own names leave a question open."""

    is_known: Callable[[str], bool] = is_documented
    angles: str | None = None
    """Convention of three angles that form an orientation: ``rotvec``, ``fixed-xyz``, ``kuka-abc``, …"""
    units: str | None = None
    """Units of columns whose names have none: ``mm,deg``."""
    columns: Mapping[str, str | None] | None = None
    """Documented name (``x_mm``) of each column by its name in the file; None for a column that is not read."""
    coverage: float | None = None
    """Coverage factor of uncertainties ``U``: 1 for standard, 2 for expanded uncertainties at 95 %."""
    commanded: str | None = None
    """File with the commands: a robot program, or a table of joints or commanded poses."""
    camera: str | None = None
    """File of the camera, or cameras, that took images of a board."""

    def __post_init__(self) -> None:
        """Check the statements.

        Raises:
            UsageError: A convention or unit is unknown, or a coverage factor is not positive.
        """
        refuse(
            (
                self.angles is not None and self.angles not in CONVENTIONS,
                f"`angles`: expected one of {', '.join(CONVENTIONS)}, found {self.angles!r}",
            ),
            (
                self.coverage is not None and not 0 < self.coverage < 10,
                f"`coverage`: expected a coverage factor such as 1 or 2, found {self.coverage!r}",
            ),
        )
        self.unit_of  # noqa: B018 (the property checks)

    @property
    def unit_of(self) -> dict[str, str]:
        """Return the stated unit of ``length`` and of ``angle``.

        Raises:
            UsageError: A unit is unknown, or two units are of one quantity.
        """
        result: dict[str, str] = {}
        for part in (self.units or "").split(",") if self.units else ():
            unit = {"inch": "in", "°": "deg", "µm": "um"}.get(part.strip(), part.strip())
            quantity = UNITS.get(unit, ("", 0.0))[0]
            refuse(
                (
                    quantity not in ("length", "angle") or quantity in result,
                    f"`units`: expected a unit of length (m, mm, um, in) and one of angle (rad, mrad, deg), such as "
                    f"mm,deg, found {self.units!r}",
                )
            )
            result[quantity] = unit
        return result

    def document(self) -> dict[str, Any]:
        """Return the statements that were made, for a result's options."""
        values = {name: getattr(self, name) for name in READING}
        return {name: dict(value) if name == "columns" else value for name, value in values.items() if value}


FRAME = "DataFrame"
"""Name of a data frame in messages and records."""
AS_NAMED = Reading()
"""No statement: the names of the file decide."""


class SupportsColumns(Protocol):
    """Data frame: a table that gives its columns by their names (pandas, Polars, Arrow)."""

    @property
    def columns(self) -> Any:
        """Names of the columns."""


class PoseFile(str):
    """Path of a pose file, or a data frame, with statements on what its names leave open.

    It stands wherever a path of poses does: ``robacc.estimate(PoseFile("export.csv", units="mm,deg"), robot=…)``.
    """

    __slots__ = ("reading",)
    reading: Reading

    def __new__(
        cls,
        path: str | os.PathLike[str] | SupportsColumns | Mapping[str, Any],
        *,
        angles: str | None = None,
        units: str | None = None,
        columns: str | os.PathLike[str] | Mapping[str, str | None] | None = None,
        skip_gaps: bool = False,
        coverage: float | None = None,
        sheet: str | None = None,
        commanded: str | os.PathLike[str] | None = None,
        camera: str | os.PathLike[str] | None = None,
        board: str | os.PathLike[str] | None = None,
        bag: str | None = None,
        contact_sheet: str | os.PathLike[str] | None = None,
    ) -> "PoseFile":
        """Return the path with the statements, which are those of :class:`Reading`.

        Args:
            path: The pose file, or a data frame: pandas, Polars, Arrow, or arrays by the names of columns.
            angles: See :class:`Reading`; likewise the other statements.
            units: See above.
            columns: A column map (YAML), or its entries. A map may also state the rest; arguments take precedence.
            skip_gaps: See above.
            coverage: See above.
            sheet: See above.
            commanded: See above.
            camera: See above.
            board: See above.
            bag: See above.
            contact_sheet: See above.

        Raises:
            UsageError: A statement is wrong, or ``path`` is neither a path nor a data frame.
            InputError: The column map cannot be read.
        """
        is_path = isinstance(path, str | os.PathLike)
        of_tables = ("columns", "column_names", "__arrow_c_stream__", "__dataframe__")
        refuse(
            (
                not is_path and not isinstance(path, Mapping) and not any(hasattr(path, name) for name in of_tables),
                f"expected a path, a data frame or Measurements as poses, found {type(path).__name__}; make a data "
                "frame of records, or Measurements(position=…, q=…) of arrays",
            )
        )
        name = os.fspath(path) if isinstance(path, str | os.PathLike) else FRAME
        stated: dict[str, Any] = (
            read_column_map(columns) if isinstance(columns, str | os.PathLike) else {"columns": columns}
        )
        given = {"angles": angles, "units": units, "coverage": coverage, "sheet": sheet, "bag": bag}
        files = {"commanded": commanded, "camera": camera, "board": board, "contact_sheet": contact_sheet}
        stated |= {name: value for name, value in given.items() if value is not None}
        stated |= {name: os.fspath(file) for name, file in files.items() if file is not None}
        stated["frame"] = reading_of(path).frame if isinstance(path, str | os.PathLike) else path
        return cls.of(name, Reading(skip_gaps=skip_gaps, **stated))

    @classmethod
    def of(cls, path: str, reading: Reading) -> "PoseFile":
        """Return the path with these statements."""
        result = super().__new__(cls, path)
        result.reading = reading
        return result


def parts_of(path: str) -> tuple[PoseFile, ...]:
    """Return a sample of a large file of the documented form, and its parts; nothing for any other file.

    Raises:
        InputError: The file cannot be read, or is no table.
    """
    reading = reading_of(path)
    named = reading.columns or reading.commanded or reading.camera or reading.board or reading.bag
    parts = () if named or reading.frame is not None else divided(path, reading)
    return tuple(PoseFile.of(path, replace(reading, frame=part)) for part in parts)


def reading_of(path: str | os.PathLike[str]) -> Reading:
    """Return the statements that a path carries."""
    return path.reading if isinstance(path, PoseFile) else AS_NAMED
