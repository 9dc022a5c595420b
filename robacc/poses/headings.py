"""Meaning of column names that instruments and robots write: ``X [mm]``, ``J1``, ``pose.position.x``, ``Nominal Y``."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from robacc.io.cell_units import UNIT_NAMES

_BRACKETED = re.compile(r"(.*?)\s*[\[(<{]\s*([^\])>}]*?)\s*[\])>}]")
_SUFFIXED = re.compile(r"(.*?[^\s_/])\s*[_/ ]\s*(µm|μm|[a-zA-Z°]+)")
_GERMAN_DEGREES = re.compile(r"(.*?)\s*[\[( _/]\s*Grad\s*[\])]?")
"""``Grad`` is a degree in German; ``grad`` may be a gradian, 400 to the turn."""
_TOKEN = re.compile(r"[^\W\d_]+|\d+")

_ROS_FIELD = re.compile(r"(^|[./])(position|translation|orientation|rotation)[./][xyzw]$|[./]position$")

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
    ]
)
_ATTAINED = frozenset(
    ["actual", "act", "meas", "measured", "measurement", "ist", "attained", "real", "observed", "tracker"]
)
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
        "joint",
        "joints",
        "states",
        "state",
        "axis",
        "header",
        "stamped",
    ]
)
_ORIENTED = frozenset(["orientation", "orient", "orientierung", "rotation", "rot", "quaternion", "quat"])
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
_JOINT_WORDS = frozenset(["q", "j", "a", "joint", "axis", "ax", "achse", "gelenk", "theta", "th", "rax"])
_SPREAD = frozenset(["sigma", "std", "stdev", "stddev", "sd"])
_UNCERTAIN = frozenset(["u", "uncertainty", "unc", "unsicherheit"])
_TEXT_NAMES = {
    **dict.fromkeys(("pose", "pose id", "pose name", "pose number"), "pose"),
    **dict.fromkeys(
        ("point", "point name", "pointname", "point id", "name", "punkt", "punktname", "messpunkt"), "pose"
    ),
    **dict.fromkeys(("object", "object name"), "pose"),  # frames of SpatialAnalyzer
    **dict.fromkeys(("label", "feature", "feature name", "element", "element name"), "pose"),  # CAM2, PolyWorks, GOM
    **dict.fromkeys(("target name", "target id", "frame name"), "pose"),
    **dict.fromkeys(("cycle", "run", "repetition", "zyklus", "wiederholung", "lauf"), "cycle"),
    **dict.fromkeys(("target", "smr", "reflector", "marker", "reflektor"), "target"),
    **dict.fromkeys(("visit", "arrival"), "visit"),
}
_TIME_NAMES = {
    **dict.fromkeys(("time", "timestamp", "time stamp", "stamp", "t", "zeit", "zeitstempel", "uhrzeit"), "time"),
    **dict.fromkeys(("datetime", "date time", "datum zeit", "date and time"), "time"),
    **dict.fromkeys(("date", "datum"), "date"),
    **dict.fromkeys(("stamp sec", "header stamp sec", "header stamp secs", "stamp secs"), "seconds"),
    **dict.fromkeys(("stamp nanosec", "stamp nsec", "header stamp nanosec", "header stamp nsecs"), "nanoseconds"),
}
TIME_KEYS = ("time", "date", "seconds", "nanoseconds")
"""Keys of the columns that give a time together, as text."""
_CIRCUMSTANCES = {
    **dict.fromkeys(("temperature", "temp", "temperatur", "air temperature", "t air"), "temperature_c"),
    **dict.fromkeys(("ambient temperature", "room temperature", "lufttemperatur", "raumtemperatur"), "temperature_c"),
    **dict.fromkeys(("payload", "load", "nutzlast", "traglast"), "payload_kg"),
}


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
    si: bool = False
    """Whether the name is of ROS, whose units are SI."""
    expanded: bool = False
    """Whether the name is of an uncertainty whose coverage factor it does not say."""


def heading_of(name: str) -> Heading:
    """Return the parts of a column's name."""
    # Signals of RobotStudio have a path: System1\ROB_1\J1; fields of rostopic begin with field.
    stem, unit = name.strip().strip("'\"").rpartition("\\")[2].removeprefix("field."), None
    if ((match := _BRACKETED.fullmatch(stem)) and match[2].lower() in UNIT_NAMES) or (
        (match := _SUFFIXED.fullmatch(stem)) and match[2].lower() in UNIT_NAMES and len(match[2]) > 1
    ):
        stem, unit = match[1], UNIT_NAMES[match[2].lower()]
    elif match and match[2] in ("m", "s", "°"):
        stem, unit = match[1], UNIT_NAMES[match[2]]
    elif (match := _GERMAN_DEGREES.fullmatch(stem)) is not None:
        stem, unit = match[1], "deg"
    spaced = re.sub(r"([a-zäöü])([A-Z])", r"\1 \2", stem)
    return Heading(name, tuple(_TOKEN.findall(spaced.lower())), unit)


def is_of_ros(heading: Heading) -> bool:
    """Return whether a name is the path of a ROS message's field, whose unit is SI (REP 103)."""
    return bool(_ROS_FIELD.search(heading.name))


def meaning_of(heading: Heading, siblings: frozenset[str]) -> Meaning | None:
    """Return what a name stands for; None for a name that is none of a pose's columns.

    Args:
        heading: The name.
        siblings: Texts of all headings of the file, which make single letters unambiguous.
    """
    words = heading.words
    if heading.text in _TEXT_NAMES:
        return Meaning(_TEXT_NAMES[heading.text])
    if heading.text in _TIME_NAMES:
        return Meaning(_TIME_NAMES[heading.text])
    if heading.text in _CIRCUMSTANCES:
        return Meaning(_CIRCUMSTANCES[heading.text])
    if _REFUSED & set(words) or not words:
        return None
    robot = _universal_robots(words)
    if robot is not None:
        return robot
    if words == ("q", "0") and {"qx", "qy", "qz"} <= siblings:  # NDI
        return Meaning("qw")
    commanded = True if _COMMANDED & set(words) else False if _ATTAINED & set(words) else None
    core = tuple(word for word in words if word not in _COMMANDED | _ATTAINED)
    if joint := _joint(core):
        return Meaning(joint, commanded, si=is_of_ros(heading))
    return _coordinate(heading, core, commanded, siblings)


def is_point_name(name: str) -> bool:
    """Return whether a name is that of a column of point or pose names."""
    return _TEXT_NAMES.get(heading_of(name).text) == "pose"


def axis_and_label(heading: Heading) -> tuple[str | None, str | None]:
    """Return axis and label of a measured coordinate, ``x`` and ``1`` of ``X1``; None, None for another name.

    The label of ``X`` and of ``Measured X`` is empty.
    """
    words = [word for word in heading.words if word not in _FILLERS | _ATTAINED]
    axes = [word for word in words if word in ("x", "y", "z")]
    if len(axes) != 1 or set(heading.words) & (_COMMANDED | _REFUSED | _SPREAD | _UNCERTAIN | _ORIENTED):
        return None, None
    return axes[0], "".join(word for word in words if word != axes[0])


def _universal_robots(words: Sequence[str]) -> Meaning | None:
    """Return the meaning of a name of Universal Robots' data exchange: ``target_q_0``, ``target_TCP_pose_3``."""
    if len(words) == 3 and words[0] in ("target", "actual") and words[1] == "q" and words[2].isdecimal():
        return Meaning(f"q{words[2]}", words[0] == "target", "ur")
    if len(words) == 4 and tuple(words[:3]) == ("target", "tcp", "pose") and words[3] in "012345":
        return Meaning(("x", "y", "z", "rx", "ry", "rz")[int(words[3])], True, "ur", si=True)
    return None


def _joint(core: Sequence[str]) -> str | None:
    """Return ``q`` and the number in the name of a joint's angle, else None."""
    words = [word for word in core if word not in _FILLERS or word in _JOINT_WORDS]
    if len(words) == 3 and words[0] == "joint":  # /joint_states/j1/position
        words = words[1:]
    if len(words) == 2 and words[0] in _JOINT_WORDS and words[1].isdecimal() and len(words[1]) < 3:
        return f"q{int(words[1])}"
    return None


def _coordinate(
    heading: Heading, core: tuple[str, ...], commanded: bool | None, siblings: frozenset[str]
) -> Meaning | None:
    """Return the meaning of a coordinate, an angle, or an uncertainty."""
    words = tuple(word for word in core if word not in _FILLERS)
    oriented = bool(_ORIENTED & set(core))
    si = is_of_ros(heading)
    joined = "".join(words)
    letters = {"".join(word for word in text.split() if word not in _COMMANDED | _ATTAINED) for text in siblings}
    if spread := _uncertainty(core, words):
        return spread
    if oriented and joined in ("x", "y", "z", "w"):
        quaternion = any({"w", *_ORIENTED} & set(text.split()) >= {"w"} for text in siblings)
        return Meaning(f"q{joined}", commanded) if quaternion else Meaning(f"r{joined}", commanded, "axes")
    if joined in ("x", "y", "z"):
        return Meaning(joined, commanded, si=si)
    if joined in ("tx", "ty", "tz") or joined in ("px", "py", "pz"):
        return Meaning(joined[1], commanded)
    if joined in ("qx", "qy", "qz", "qw"):
        return Meaning(joined, commanded)
    if joined in ("rx", "ry", "rz"):
        return Meaning(joined, commanded, "axes")
    if joined in ("roll", "pitch", "yaw"):
        return Meaning(joined, commanded)
    for family in ("abc", "wpr", "oat"):
        if joined in tuple(family) and set(family) <= letters:
            return Meaning(f"r{'xyz'[family.index(joined)]}", commanded, family)
    return None


def _uncertainty(core: Sequence[str], words: Sequence[str]) -> Meaning | None:
    """Return the meaning of a standard deviation or of an uncertainty along an axis."""
    axes = [word for word in words if word in ("x", "y", "z")]
    if len(axes) == 1 and _SPREAD & set(core) and set(words) <= {axes[0], *_SPREAD}:
        return Meaning(f"sigma_{axes[0]}")
    if "".join(words) in ("ux", "uy", "uz"):
        return Meaning(f"sigma_{words[-1][-1]}", expanded=True)
    if len(axes) == 1 and _UNCERTAIN & set(core) and set(words) <= {axes[0], *_UNCERTAIN}:
        return Meaning(f"sigma_{axes[0]}", expanded=True)
    return None
