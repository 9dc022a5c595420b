"""Options of commands that read pose files: what the names of an export leave open.

They are declared once here and added to the commands; a command gets paths that carry what was stated.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from functools import wraps
from typing import Annotated, Any, get_type_hints

import typer

from robacc.render.text import console

POSE_PARAMETERS = {
    "estimate": ("poses",),
    "trace": ("poses", "holdout"),
    "calibrate": ("poses", "holdout"),
    "iso9283": ("poses",),
    "predict": ("poses", "against"),
    "effects": ("poses",),
    "correct": ("targets",),
    "plan": ("candidates", "task", "already"),
    "simulate": ("at",),
}
"""Parameters of each command that name pose files."""
_UNMEASURED = frozenset({"correct", "plan", "simulate"})
"""Commands whose pose files need no measured poses."""

_ANGLES = Annotated[
    str | None,
    typer.Option(
        "--angles",
        metavar="NAME",
        help="Convention of angles: rotvec, fixed-xyz, moving-xyz, zyx, kuka-abc, zyz; of a quaternion: wxyz, xyzw.",
    ),
]
_UNITS = Annotated[
    str | None,
    typer.Option("--units", metavar="U,U", help="Units of columns whose names have none, such as mm,deg."),
]
_COLUMNS = Annotated[
    str | None,
    typer.Option("--columns", metavar="FILE", help="Column map (YAML) of an export; robacc init EXPORT writes it."),
]
_SKIP_GAPS = Annotated[bool, typer.Option("--skip-gaps", help="Leave out rows with a missing value, with a warning.")]
_COVERAGE = Annotated[
    float | None,
    typer.Option(
        "--coverage", metavar="K", help="Coverage factor of columns such as Ux: 1 if standard, 2 if expanded."
    ),
]
_SHEET = Annotated[str | None, typer.Option("--sheet", metavar="NAME", help="Sheet of a workbook.")]
_COMMANDED = Annotated[
    str | None,
    typer.Option(
        "--commanded",
        metavar="FILE",
        help="Commands of the measured poses in another file: robot program, or table of joints or poses.",
    ),
]
_BAG = Annotated[
    str | None,
    typer.Option(
        "--bag",
        metavar="KEY=VALUE,…",
        help="Topics and samples of a ROS bag: joints=, measured=, commanded=, at=rest|any, clock=stamp|recorder.",
    ),
]
_QUIET = Annotated[bool, typer.Option("--quiet", help="Leave out the notes on how files were read.")]
_OPTIONS: dict[str, tuple[Any, object]] = {
    "angles": (_ANGLES, None),
    "units": (_UNITS, None),
    "columns": (_COLUMNS, None),
    "skip_gaps": (_SKIP_GAPS, False),
    "coverage": (_COVERAGE, None),
    "sheet": (_SHEET, None),
    "commanded": (_COMMANDED, None),
    "bag": (_BAG, None),
    "quiet": (_QUIET, False),
}
_OF_MEASUREMENTS = ("coverage", "commanded", "bag")
"""Options that say something of measured poses only."""


def with_reading_options(command: Callable[..., None], name: str) -> Callable[..., None]:
    """Return the command of this name with the options of this module; its pose files become paths with statements."""
    parameters = POSE_PARAMETERS[name]
    options = {
        option: value for option, value in _OPTIONS.items() if not (name in _UNMEASURED and option in _OF_MEASUREMENTS)
    }
    hints = get_type_hints(command, include_extras=True)
    declared = [
        parameter.replace(annotation=hints[parameter.name])
        for parameter in inspect.signature(command).parameters.values()
    ]
    added = [
        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)
        for name, (annotation, default) in options.items()
    ]
    keyword_only = [parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY) for parameter in declared]

    @wraps(command)
    def run(**arguments: Any) -> None:
        console.is_quiet = arguments.pop("quiet")
        stated = {name: arguments.pop(name) for name in options if name != "quiet"}
        if any(stated.values()):
            arguments |= {name: _stated(arguments[name], stated) for name in parameters}
        command(**arguments)

    run.__signature__ = inspect.Signature([*keyword_only, *added])  # type: ignore[attr-defined]
    run.__annotations__ = {parameter.name: parameter.annotation for parameter in (*declared, *added)}
    return run


def _stated(paths: Any, stated: dict[str, Any]) -> Any:
    from robacc.poses.reading import PoseFile

    if isinstance(paths, list | tuple):
        return [PoseFile(path, **stated) for path in paths]
    # The candidates of a plan may be a number of samples.
    return paths if paths is None or paths.isdecimal() else PoseFile(paths, **stated)
