"""Commands made from the declarations of the calls, and from what a command's own function adds to its call.

A parameter is declared by ``Annotated[type, Help(…)]``: positional ones are arguments, others options.
"""

import inspect
import itertools
import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from importlib import import_module
from pathlib import Path
from types import UnionType
from typing import Annotated, Any, Literal, NamedTuple, Union, get_args, get_origin

import typer

from robacc.api import HOMES
from robacc.api.parameters import Help, all_choices, meanings
from robacc.cli import commands, output
from robacc.errors import refuse
from robacc.render import text as console
from robacc.render.text import as_options


class Declared(NamedTuple):
    """A declared argument or option."""

    kind: Any
    meaning: Help
    default: Any
    is_argument: bool
    is_repeated: bool
    owner: str
    """Who gets the value: ``call``, ``outlets``, ``reading``, or the command's function itself if empty."""


def load(name: str, form: str | None = None) -> Any:
    """Return a command with its options; the module of its call is imported when it runs."""
    show = getattr(commands, form or name)
    options = declared_options(show)

    def run(**given: Any) -> None:
        output.started = time.time()
        check_call(given, [name for name in given if options[name].meaning.holds == "output"])
        console.is_quiet = given.pop("quiet", False)
        reading = {name: given.pop(name) for name in [*given] if options[name].owner == "reading"}
        values: dict[str, dict[str, Any]] = {"": {}, "call": {}, "outlets": {}}
        for name, value in given.items():
            read, is_poses = options[name].meaning.read, "poses" in options[name].meaning.holds
            own = _read_as(name, value, reading) if is_poses and any(reading.values()) else value
            values[options[name].owner][name] = own if read is None or own is None else read(name, own)
        arguments, named = values[""], values["call"]
        if values["outlets"]:
            arguments["outlets"] = output.Outlets(**values["outlets"])
        if "call" in inspect.signature(show).parameters:
            call = getattr(import_module(f"robacc.{HOMES[show.__name__]}"), show.__name__)
            paths = [named.pop(name) for name in [*named] if options[name].is_argument and options[name].is_repeated]
            named = {name: options[name].default if value is None else value for name, value in named.items()}
            arguments["call"] = partial(call, *itertools.chain(*paths), **named)
        show(**arguments)

    parameters = [_typer_parameter(name, option) for name, option in options.items()]
    run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    run.__annotations__ = {item.name: item.annotation for item in parameters}
    run.__doc__ = show.__doc__
    program = typer.Typer(add_completion=False, rich_markup_mode=None)
    program.command(name)(run)
    return typer.main.get_command(program)


def declared_options(show: Callable[..., None]) -> dict[str, Declared]:
    """Return the arguments and options of a command: those of its call, its own, and how files of poses are read."""
    own = dict(_declared(show, ""))
    parameters = inspect.signature(show).parameters
    options = dict(_declared(_declaration(show.__name__), "call")) if "call" in parameters else {}
    outlets = _declared(output.Outlets, "outlets") if "outlets" in parameters else ()
    options |= {name: item._replace(is_argument=False) for name, item in outlets if name not in own} | own
    held = {item.meaning.holds for item in options.values()} & {"measured poses", "planned poses"}
    if held:
        # Parameters of ``read_poses`` that say how a file is read, and not for which robot.
        left_out = {"path", "robot", "ordered", "ignore_limits"}
        if "measured poses" not in held:
            left_out |= {"coverage", "commanded", "camera", "board", "bag", "contact_sheet"}
        reading = _declared(_declaration("read_poses"), "reading")
        options |= {name: item for name, item in reading if name not in left_out and name not in options}
        options["quiet"] = Declared(bool, Help("Leave out the notes on how files were read."), False, False, False, "")
    return options


def _declaration(name: str) -> Callable[..., Any]:
    """Return a call as its source declares it, which is not to be called: its module would import NumPy."""
    path = Path(__file__).parents[1].joinpath(*HOMES[name].split(".")).with_suffix(".py")
    source = path.read_text(encoding="utf-8")
    start = source.index(f"\ndef {name}(")
    names: dict[str, Any] = {"__name__": meanings.__module__}  # whose names the annotations use
    exec("from __future__ import annotations\n" + source[start : source.find("\n\n\n", start)], names)
    return names[name]  # type: ignore[no-any-return]


def _declared(function: Callable[..., Any], owner: str) -> Iterator[tuple[str, Declared]]:
    """Yield the parameters that ``--help`` explains."""
    declared = meanings(function)
    for name, item in inspect.signature(function).parameters.items():
        kind, meaning = declared[name]
        if meaning.text:
            several = [get_origin(leaf) in (list, Sequence) for leaf in _leaves(kind) if leaf is not type(None)]
            is_repeated = item.kind is item.VAR_POSITIONAL or (all(several) and meaning.read is None)
            yield name, Declared(kind, meaning, item.default, item.kind is not item.KEYWORD_ONLY, is_repeated, owner)


def _typer_parameter(name: str, option: Declared) -> inspect.Parameter:
    """Return the parameter of typer for an argument or option."""
    meaning, default = option.meaning, None if option.default == () else option.default
    plain = (kind for kind in (bool, int, float) if {*_leaves(option.kind)} <= {kind, type(None)})
    choices = all_choices(option.kind, meaning)
    if meaning.group:
        # A line of --help has no room for all: they stand in the text, which has line breaks.
        meaning = meaning._replace(metavar="NAME", text=f"{meaning.text} Names: {', '.join(choices)}.")
    kind: Any = list[str] if option.is_repeated else Literal[choices] if choices else next(plain, str)
    kind = kind if default is not None else kind | None
    about: Any = {
        "metavar": meaning.metavar,
        "help": as_options(meaning.text),
        "min": meaning.least,
        "max": meaning.most,
    }
    names = meaning.names or (name.replace("_", "-"),)
    spelled = (f"-{name}" if len(name) == 1 else f"--{name.replace('/', '/--')}" for name in names)
    annotation = Annotated[kind, typer.Argument(**about) if option.is_argument else typer.Option(*spelled, **about)]
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)


def _leaves(kind: Any) -> tuple[Any, ...]:
    """Return the members of a union, or the type itself."""
    return get_args(kind) if get_origin(kind) in (Union, UnionType) else (kind,)


def _read_as(name: str, value: Any, reading: Mapping[str, Any]) -> Any:
    """Return paths of files of poses, the value of an option, as paths that carry how the files are read."""
    from robacc.poses.reading import PoseFile

    if name == "holdout" and reading["contact_sheet"]:
        # The contact sheet of validation poses is sheet-holdout.png beside sheet.png.
        stem, ending = os.path.splitext(reading["contact_sheet"])
        reading = {**reading, "contact_sheet": f"{stem}-holdout{ending}"}
    if isinstance(value, list):
        return [PoseFile(path, **reading) for path in value]
    return PoseFile(value, **reading) if isinstance(value, str) else value


# Checks of the options of a call before anything is computed.


def check_call(parameters: Mapping[str, Any], outputs: Sequence[str]) -> None:
    """Raise an error for options that cannot work, before anything is computed.

    Args:
        parameters: Values of the options by the names of their parameters.
        outputs: Parameters that name files to write.

    Raises:
        UsageError: an output has no name or would overwrite an input or another output, standard input is named twice,
            ``--junit`` is given without ``--gate``, or a library that ``--report`` needs is not installed.
        InputError: the gate cannot be read, or an output is a folder or in a folder that does not exist.
    """
    from robacc.io.files import WRITTEN, target_of

    WRITTEN.clear()
    gate = parameters.get("gate")
    refuse(
        (
            parameters.get("junit") is not None and gate is None,
            "--junit writes the outcome of a gate, so it needs --gate",
        )
    )
    if parameters.get("report") is not None:
        from robacc.render.plots.canvas import need

        need("matplotlib", "plotly", "jinja2")
    texts = [text for name, value in parameters.items() if name not in outputs for text in _texts(value)]
    refuse((texts.count("-") > 1, "standard input can be read only once, but - is given more than once; name files"))
    inputs = [*filter(os.path.isfile, texts)]
    # A gate from a pipe can be read only once, which happens when there is a result to check.
    if gate is not None and gate != "-" and (os.path.isfile(gate) or os.path.isdir(gate) or not os.path.exists(gate)):
        from robacc.documents.envelope import baseline_path, read_gate

        inputs += [baseline_path(gate, name) for name in read_gate(gate)[1]]
    written: dict[str, str] = {}
    for option, path in (
        (f"--{name.replace('_', '-')}", path) for name in sorted(outputs) for path in _texts(parameters[name])
    ):
        other = written.setdefault(path if path == "-" else os.path.realpath(path), option)
        both, fix = ("standard output", "a file for one of them") if path == "-" else (path, "two files")
        is_input = path != "-" and os.path.isfile(path) and any(os.path.samefile(path, file) for file in inputs)
        refuse(
            (not path, f"{option}: expected the name of a file, found nothing"),
            (is_input, f"{option} {path} is also an input and would be overwritten; name another file"),
            (other != option, f"{other} and {option} both name {both}; name {fix}"),
        )
        # With several files of poses, each result is a file in a folder, which is made.
        is_folder = len(_texts(parameters.get("poses"))) > 1 and (path.endswith(("/", os.sep)) or os.path.isdir(path))
        if path != "-" and not is_folder:
            target_of(path)


def _texts(value: Any) -> tuple[str, ...]:
    return tuple(item for item in (value if isinstance(value, list | tuple) else (value,)) if isinstance(item, str))
