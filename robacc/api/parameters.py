"""Parameters of the calls: what each means and how the command line takes it; those of several calls are declared once.

The signature of a call is the only declaration of its parameters. :func:`call` makes the ``Args:`` of its docstring and
the checks of its arguments from it, and :mod:`robacc.cli.command` its options. Nothing heavy is imported here.
"""

from __future__ import annotations

import builtins
import functools
import inspect
import math
import os
import re
import sys
import textwrap
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from typing import (
    TYPE_CHECKING,
    Annotated,
    Any,
    Literal,
    NamedTuple,
    ParamSpec,
    TypeVar,
    get_args,
    get_origin,
    get_type_hints,
)

from robacc.errors import refuse
from robacc.plug_ins import plug_in_names
from robacc.quantities import optional_size
from robacc.workers import single_threaded

if TYPE_CHECKING:
    from robacc.measurements import Measurements
    from robacc.poses.reading import SupportsColumns
    from robacc.robots.description import Robot

    PosesSource = str | os.PathLike[str] | Measurements | SupportsColumns | Mapping[str, Any]
    """Poses: a file, poses read before, or a data frame (pandas, Polars, Arrow, or arrays by the names of columns)."""
    RobotSource = str | os.PathLike[str] | Robot
else:
    PosesSource = RobotSource = Any

P = ParamSpec("P")
Returned = TypeVar("Returned")
StrPath = str | os.PathLike[str]


class Help(NamedTuple):
    """Help of a parameter, in its annotation ``Annotated[type, Help(…)]``."""

    text: str
    """Sentence of ``--help`` and of the docstring; other parameters are named in backquotes."""
    metavar: str | None = None
    """What stands for the value in ``--help``."""
    python: str = ""
    """What the call takes besides; only the docstring says it."""
    least: float | None = None
    most: float | None = None
    names: tuple[str, ...] = ()
    """Names of the option, where it has another than the parameter: ``on/off`` is a pair, a letter a short option."""
    read: Callable[[str, str], object] | None = None
    """Makes the argument from the option's name and text; None for text, and for a number as it is annotated."""
    holds: Literal["", "measured poses", "planned poses", "output"] = ""
    """What a file holds, where the command line must know."""
    group: str = ""
    """Group of entry points whose names are further choices."""


def meanings(declared: Callable[..., Any]) -> dict[str, tuple[Any, Help]]:
    """Return the type and the meaning of each parameter of a function or a class."""
    names = {**vars(builtins), "Sequence": Sequence, **globals(), **vars(sys.modules[declared.__module__])}
    # A name that is not known, such as a class of a module not imported, is any type.
    hints = get_type_hints(declared, {}, defaultdict(lambda: Any, names), include_extras=True)
    return {
        name: (hint.__origin__, hint.__metadata__[0]) if hasattr(hint, "__metadata__") else (hint, Help(""))
        for name, hint in hints.items()
        if name != "return"
    }


def choices_of(kind: Any) -> tuple[Any, ...]:
    """Return the values of the literal in a type; none without one."""
    inner = (found for part in get_args(kind) if (found := choices_of(part)))
    return get_args(kind) if get_origin(kind) is Literal else next(inner, ())


def all_choices(kind: Any, meaning: Help) -> tuple[Any, ...]:
    """Return the values of the literal in a type, and the names of entry points that are choices too."""
    choices = choices_of(kind)
    return tuple(sorted({*choices, *plug_in_names(meaning.group)})) if meaning.group else choices


def call(function: Callable[P, Returned]) -> Callable[P, Returned]:
    """Return a call whose docstring explains its parameters, and which checks its arguments and runs in one thread."""
    signature = inspect.signature(function)
    declared = meanings(function)
    limited = single_threaded(function)

    @functools.wraps(function)
    def checked(*args: P.args, **kwargs: P.kwargs) -> Returned:
        for name in kwargs.keys() & declared.keys():
            _check(name, kwargs[name], *declared[name])
        return limited(*args, **kwargs)

    lines = [
        textwrap.fill(
            f"{name}: " + re.sub("(?<!`)`(?!`)", "``", f"{meaning.text} {meaning.python}".strip()),
            width=116,
            initial_indent=" " * 8,
            subsequent_indent=" " * 12,
        )
        for name, (_, meaning) in declared.items()
    ]
    summary, returns, rest = (function.__doc__ or "").partition("    Returns:\n")
    checked.__doc__ = "\n".join((f"{summary}    Args:", *lines, "", f"{returns}{rest}"))
    shown = [item.replace(annotation=_type_text(item.annotation)) for item in signature.parameters.values()]
    checked.__signature__ = signature.replace(parameters=shown)  # type: ignore[attr-defined]
    return checked


def _type_text(annotation: str) -> str:
    """Return the type in an annotation as text, without the meaning."""
    known = globals().get(annotation)
    if known is not None and hasattr(known, "__metadata__"):
        kind = known.__origin__
        return str(getattr(kind, "__forward_arg__", None) or inspect.formatannotation(kind))
    return annotation.removeprefix("Annotated[").partition(", Help(")[0]


def _check(parameter: str, value: Any, kind: Any, meaning: Help) -> None:
    """Raise UsageError for an argument outside the choices or the range of its annotation."""
    choices = all_choices(kind, meaning)
    listed = ", ".join(map(repr, (*choices, *((None,) if type(None) in get_args(kind) else ()))))
    is_other = choices and value not in (None, *choices)
    refuse((is_other, f"`{parameter}`: expected one of {listed}, found {value!r}"))
    if meaning.least is not None and value is not None:
        check_range(parameter, value, meaning.least, math.inf if meaning.most is None else meaning.most)


def check_range(parameter: str, value: float, low: float, high: float = math.inf) -> None:
    """Raise UsageError unless ``low <= value <= high``."""
    limits = f"of at least {low:g}" if math.isinf(high) else f"between {low:g} and {high:g}"
    refuse((not low <= value <= high, f"`{parameter}`: expected a number {limits}, found {value!r}"))


# Texts of options as arguments.


def numbers(name: str, text: str, separator: str = ",") -> tuple[float, ...]:
    """Return the finite numbers of a list.

    Raises:
        UsageError: A part of the list is not a finite number.
    """
    try:
        values = tuple(float(part) for part in text.split(separator))
    except ValueError:
        values = (math.nan,)
    refuse(
        (not all(map(math.isfinite, values)), f"`{name}`: expected numbers separated by {separator!r}, found {text!r}")
    )
    return values


def length_and_angle(
    name: str, value: str | float | Sequence[float | None] | None, example: str
) -> tuple[float | None, float | None]:
    """Return a length, m, and an angle, rad, of text such as ``3mm,0.5deg``, of a number in m or of a pair.

    Raises:
        UsageError: The value is not one or two sizes of at least zero.
    """
    parts = value.split(",") if isinstance(value, str) else [value] if isinstance(value, float | int) else value or ()
    refuse((len(parts) > 2, f"`{name}`: expected a length and perhaps an angle, as in {example}, found {value!r}"))
    length, angle = (*parts, None, None)[:2]
    return optional_size(length, "length", f"`{name}`"), optional_size(angle, "angle", f"`{name}`")


def masses(name: str, values: Sequence[float]) -> tuple[float, ...]:
    """Return masses in kg as numbers.

    Raises:
        UsageError: A mass is negative or not finite.
    """
    expected = f"`{name}`: expected masses of at least 0 kg"
    refuse(*((not 0 <= mass < math.inf, f"{expected}, found {mass:g}") for mass in values))
    return tuple(map(float, values))


def temperatures(name: str, text: str) -> tuple[float, float]:
    """Return the first and the last temperature of ``22:28``, or of ``22``.

    Raises:
        UsageError: The text is not one or two numbers.
    """
    ends = numbers(name, text, ":")
    refuse((len(ends) > 2, f"`{name}`: expected a number, or two such as 22:28, found {text!r}"))
    return ends[0], ends[-1]


def count_or_path(_: str, text: str) -> int | str:
    """Return the number if the text is one of digits, else the text."""
    return int(text) if text.isdecimal() else text


# Parameters of several calls.

CampaignUse = Literal["auto", "keep", "drop"]
_ROBOT = Help(
    "Robot file (YAML), URDF, or name of an arm that robacc show robots lists.", "FILE", "Or a robot read before."
)
Poses = Annotated[
    "PosesSource",
    Help(
        "Measured poses: CSV, export, workbook, Parquet, ROS bag, folder of photos or Parquet; - reads standard input.",
        "POSES",
        "Or poses read before, made of arrays, or a data frame.",
        holds="measured poses",
    ),
]
RobotArgument = Annotated[
    "RobotSource", Help("Robot file (YAML), URDF, or name of an arm.", "ROBOT", "Or a robot read before.")
]
NeededRobot = Annotated["RobotSource", _ROBOT]
OptionalRobot = Annotated["RobotSource | None", _ROBOT]
Database = Annotated["StrPath", Help("Database of results, one SQLite file.", "FILE")]
ArmName = Annotated[str | None, Help("Serial number or name of one arm; default: every arm.", "NAME")]
BaseLink = Annotated[str | None, Help("First link of the chain in a URDF.", "NAME")]
TipLink = Annotated[str | None, Help("Last link of the chain in a URDF; default: by the joint columns.", "NAME")]
Ordered = Annotated[
    bool, Help("Rows are in the order of measurement; directions and speeds of the joints are derived from it.")
]
IgnoreLimits = Annotated[
    bool,
    Help("Only warn of joint values outside the limits; by default, more than 0.05 deg or 0.5 mm is an error."),
]
Campaign = Annotated[
    CampaignUse,
    Help(
        "Apply drift and other effects of the campaign in which a model was measured; auto: if they fit.",
        python="``auto`` keeps them for the model's own poses and for measured poses that agree better with them.",
    ),
]
StrictRange = Annotated[bool, Help("Refuse poses outside the validity range of the model (exit 3).")]
Scale = Annotated[StrPath | None, Help("Grade scale (YAML) in place of the built-in scale.", "FILE")]
Seed = Annotated[int, Help("Seed of the random numbers, bootstrap included.", "N", least=0)]
Confidence = Annotated[float, Help("Confidence level of every interval, between 0.5 and 1.", "P")]
Holdout = Annotated[
    "PosesSource | None",
    Help("CSV of validation poses, in place of held-out poses of POSES.", "FILE", holds="measured poses"),
]
Folds = Annotated[
    int | None,
    Help(
        "Parts of the poses that are held out in turn; default: each pose in turn, with those close to it.",
        "K",
        least=2,
        most=50,
    ),
]
DEFAULT_SAMPLES = 1000
"""Number of configurations at which an arm is predicted."""
Samples = Annotated[
    int | None, Help(f"Number of configurations over the joint ranges; default: {DEFAULT_SAMPLES}.", "N")
]
Jobs = Annotated[
    int | None,
    Help(
        "Number of processes, for several files or a large one; default: the cores for several files of poses, else 1.",
        "N",
        least=1,
    ),
]
Cluster = Annotated[
    str | None, Help("Scheduler of a Dask cluster that does the work, such as tcp://HOST:8786.", "ADDRESS")
]
Progress = Annotated[
    Callable[[str, int, int], None] | None,
    Help("", python="Called with a label of the work, the number of steps done, and the number of all steps."),
]
"""Not an option: it has no text of ``--help``."""

# How a file of poses is read.

Angles = Annotated[
    str | None,
    Help(
        "Convention of angles: rotvec, fixed-xyz, moving-xyz, zyx, kuka-abc, zyz; of a quaternion: wxyz, xyzw.", "NAME"
    ),
]
Units = Annotated[str | None, Help("Units of columns whose names have none, such as mm,deg.", "U,U")]
Columns = Annotated[
    StrPath | Mapping[str, str | None] | None,
    Help(
        "Column map (YAML) of an export; robacc init EXPORT writes it.",
        "FILE",
        "Or documented names by the names in the file.",
    ),
]
SkipGaps = Annotated[bool, Help("Leave out rows with a missing value, with a warning.")]
Coverage = Annotated[float | None, Help("Coverage factor of columns such as Ux: 1 if standard, 2 if expanded.", "K")]
Sheet = Annotated[str | None, Help("Sheet of a workbook.", "NAME")]
Commanded = Annotated[
    StrPath | None,
    Help(
        "Commands of the measured poses in another file: robot program, or table of joints or poses.",
        "FILE",
        names=("commanded", "joints"),
    ),
]
CameraFile = Annotated[
    StrPath | None,
    Help("Camera that took the images of kind image: YAML with fx, fy, cx, cy, distortion, size, mount.", "FILE"),
]
BoardFile = Annotated[
    StrPath | None,
    Help("Board that photos show: YAML with type, squares, square_mm, marker_mm, dictionary.", "FILE"),
]
Bag = Annotated[
    str | None,
    Help(
        "Topics and samples of a ROS bag or LeRobot data set: joints=, measured=, commanded=, images=, at=rest|any, "
        "clock=stamp|recorder, calibration=FILE.",
        "KEY=VALUE,…",
    ),
]
ContactSheet = Annotated[
    StrPath | None,
    Help("Picture to write (.jpg, .png) of all photos: the points found, and what is wrong.", "FILE", holds="output"),
]
