"""Names of a pose file's columns: documented names, units, joint names, and what instruments and robots write."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from robacc.io.dialect import UNIT_NAMES

# Meaning of column names that instruments and robots write: ``X [mm]``, ``J1``, ``pose.position.x``, ``Nominal Y``.

_BRACKETED = re.compile(r"(.*?)\s*[\[(<{]\s*([^\])>}]*?)\s*[\])>}]")
_SUFFIXED = re.compile(r"(.*?[^\s_/])\s*[_/ ]\s*(µm|μm|[a-zA-Z°]{2,}|[ms°])")
_GERMAN_DEGREES = re.compile(r"(.*?)\s*[\[( _/]\s*(Grad)\s*[\])]?")
"""``Grad`` is a degree in German; ``grad`` may be a gradian, 400 to the turn."""
_CHANNEL = re.compile(r"\d+\s*<(.*)>")
"""Name of a channel behind its number, as loggers write it: ``101 <Trk X>``."""
_TOKEN = re.compile(r"[^\W\d_]+|\d+")

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
    ]
)
_ACTUAL = frozenset(["actual", "act", "ist", "istwert", "attained", "real", "aipos"])
"""Words of what an instrument or the controller may have attained."""
_ATTAINED = _ACTUAL | frozenset(
    [
        *("meas", "measured", "measurement", "observed", "messwert", "gemessen", "messung"),
        *("tracker", "tracking", "camera", "cam", "optical", "marker"),
        *("mesuré", "mesurée", "mesure", "medido", "medida", "misurato", "misurata"),
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
        *("mess", "analyzer", "gt", "truth", "ext", "extern", "external", "prism", "metrology"),
    ]
)
"""Instruments, and words that say measured by one."""
_CONTROLLER = frozenset(["robot", "roboter", "controller", "steuerung", "rist", "est", "estimated", "fk", "ctrl"])
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
        "winkel",
        "matrix",
        "joint",
        "joints",
        "states",
        "state",
        "axis",
        "header",
        "stamped",
    ]
)
_ORIENTED = frozenset(
    ["angle", "winkel", "orientation", "orient", "orientierung", "rotation", "rot", "quaternion", "quat"]
)
_REFUSED = frozenset(
    [
        "dev",
        "deviation",
        "delta",
        "diff",
        "difference",
        "error",
        "err",
        "abweichung",
        *("min", "max", "abw", "residual", "resid", "normal", "gyro", "imu", "écart", "ecart", "desviación", "scarto"),
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
        *("q", "j", "jt", "a", "joint", "joints", "axis", "ax", "achse", "gelenk", "theta", "th", "rax"),
        *("axe", "articulation", "articulación", "articulacion", "eje", "asse", "giunto", "junta"),
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
    **dict.fromkeys(("punto", "nombre", "nom", "nome", "merkmal", "characteristic name"), "pose"),
    **dict.fromkeys(("label", "feature", "feature name", "element", "element name"), "pose"),  # CAM2, PolyWorks, GOM
    **dict.fromkeys(("target name", "target id", "frame name"), "pose"),
    **dict.fromkeys(("cycle", "run", "repetition", "zyklus", "wiederholung", "lauf"), "cycle"),
    **dict.fromkeys(("target", "smr", "reflector", "marker", "reflektor"), "target"),
    **dict.fromkeys(("visit", "arrival"), "visit"),
    **dict.fromkeys(("time", "timestamp", "time stamp", "stamp", "t", "zeit", "zeitstempel", "uhrzeit"), "time"),
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


@dataclass(frozen=True, slots=True)
class Heading:
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


@dataclass(frozen=True, slots=True)
class Meaning:
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
_PLACED = re.compile(r"(?:observation)?(p|tvec|rvec|)\d+")
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
    matches = filter(None, (form.fullmatch(stem) for form in (_BRACKETED, _SUFFIXED, _GERMAN_DEGREES)))
    if match := next((match for match in matches if match[2] == "Grad" or match[2].lower() in UNIT_NAMES), None):
        stem, unit = match[1], UNIT_NAMES.get(match[2].lower(), "deg")
    if match := _CHANNEL.fullmatch(stem):
        stem = match[1]
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
    # Universal Robots' data exchange: target_q_0, target_TCP_pose_3.
    if match := re.fullmatch(r"(target|actual) q (\d+)", text):
        return Meaning(f"q{match[2]}", match[1] == "target", "ur")
    if match := re.fullmatch(r"target tcp pose ([0-5])", text):
        return Meaning((*AXES, *ROTATION_VECTOR)[int(match[1])], True, "ur")
    if words == ("q", "0") and {"qx", "qy", "qz"} <= siblings:  # NDI
        return Meaning("qw")
    commanded = True if _COMMANDED & set(words) else False if _ATTAINED & set(words) else None
    core = tuple(word for word in words if word not in _COMMANDED | _ATTAINED)
    of_joint = " ".join(word for word in core if word not in _FILLERS or word in _JOINT_WORDS)
    # A path such as /joint_states/j1/position has both words.
    if (match := re.fullmatch(r"(?:joint )?(\w+) (\d\d?)", of_joint)) and match[1] in _JOINT_WORDS:
        return Meaning(f"q{int(match[2])}", commanded)
    meaning = _uncertainty(core) or _coordinate(text, core, siblings)
    return None if meaning is None else replace(meaning, commanded=commanded)


_FORMS = _ORIENTED | {"pose", "position", "pos", "point", "translation", "trans"}
"""Words that say no more than the axis beside them."""
_PART_OF = {
    **{name: meaning.key for name, meaning in _COORDINATES.items() if meaning.key in AXES},
    **dict.fromkeys(itertools.chain(ROTATION_VECTOR, QUATERNION, RPY, *_FAMILIES.values()), "turn"),
    **dict.fromkeys(("rw", "phix", "phiy", "phiz"), "turn"),
}
"""Axis that a word of a coordinate's name stands for, ``turn`` for an angle."""


def labelled(heading: Heading) -> tuple[tuple[str, ...], str] | None:
    """Return the words beside a coordinate, and its axis or ``turn`` for an angle; None for another name."""
    words = heading.words
    at = next((i for i in (-1, 0) if words and words[i] in _PART_OF), None)
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
    if (match := _PLACED.fullmatch(joined)) and not oriented:  # pos_1, pos_2, pos_3; a pose has an orientation behind
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
    words = [word for word in core if word not in _FILLERS]
    axes = [word for word in words if word in AXES]
    if len(axes) == 1 and _SPREAD & set(core) and set(words) <= {axes[0], *_SPREAD}:
        return Meaning(f"sigma_{axes[0]}")
    if "".join(words) in ("ux", "uy", "uz"):
        return Meaning(f"sigma_{words[-1][-1]}", expanded=True)
    is_95 = "95" in core  # U95 names its coverage; without an axis it is of all of them
    if len(axes) in (1 - is_95, 1) and _UNCERTAIN & set(core) and set(words) <= {*axes, "95", *_UNCERTAIN}:
        return Meaning(f"sigma_{axes[0]}" if axes else "sigma", coverage=1.0 + is_95, expanded=not is_95)
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
    "deg": ("angle", 180.0 / math.pi),
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
    **dict.fromkeys(SIGMAS, "length"),
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


@dataclass(frozen=True, slots=True)
class BranchColumn:
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
