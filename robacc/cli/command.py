"""Commands made from the declarations of the calls, and from what a command's own function adds to its call.

A parameter is declared by ``Annotated[type, Help(…)]``: positional ones are arguments, others options. The function
of a command may have a parameter ``call``, which gets the call with its arguments, and groups of options.
"""

from __future__ import annotations

import ast
import inspect
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any, NamedTuple, Union, get_args, get_origin

import typer

from robacc.api.parameters import Help, choices_of, meaning_of
from robacc.cli import clock
from robacc.render import text as console
from robacc.render.text import as_options

_API = Path(__file__).parents[1] / "api"
_READING = ("angles", "units", "columns", "skip_gaps", "coverage", "sheet", "commanded", "bag")
"""Parameters of ``read_poses`` that are options of every command with a file of poses."""
_OF_MEASUREMENTS = ("coverage", "commanded", "bag")
"""Those of them that say something of measured poses only."""
_QUIET = Help("Leave out the notes on how files were read.")


class Declared(NamedTuple):
    """A declared argument or option."""

    kind: Any
    meaning: Help
    default: Any
    is_argument: bool
    is_repeated: bool
    owner: str
    """Parameter of the command's function that gets the value: ``call``, a group, or of its own name."""


def load(name: str, module: str | None = None) -> Any:
    """Import the module of a command and return the command; the call's module is imported when it runs."""
    module = module or name
    show = getattr(import_module(f"robacc.cli.commands.{module}"), module)
    options = declared_options(show, module)
    program = typer.Typer(add_completion=False, rich_markup_mode=None)
    program.command(name)(_command(show, module, options))
    return typer.main.get_command(program)


def declared_options(show: Callable[..., None], module: str) -> dict[str, Declared]:
    """Return the arguments and options of a command: those of its call, its own, and how files of poses are read."""
    own = inspect.signature(show).parameters
    found = dict(_declared(declaration(module, module), "call")) if "call" in own else {}
    for name, group in _groups(show).items():
        found |= {key: item._replace(is_argument=False) for key, item in _declared(group, name) if key not in own}
    found |= {name: item._replace(owner=name) for name, item in _declared(show, "")}
    held = {item.meaning.holds for item in found.values()} & {"measured poses", "planned poses"}
    if held:
        reading = dict(_declared(declaration("reading", "read_poses"), "reading"))
        left_out = _OF_MEASUREMENTS if "measured poses" not in held else ()
        found |= {name: reading[name] for name in _READING if name not in left_out and name not in found}
        found["quiet"] = Declared(bool, _QUIET, False, False, False, "quiet")
    return found


def declaration(module: str, name: str) -> Callable[..., Any]:
    """Return an empty function with the signature of a call, read from its source: its module would import NumPy."""
    tree = ast.parse((_API / f"{module}.py").read_text(encoding="utf-8"))
    call = next(item for item in tree.body if isinstance(item, ast.FunctionDef) and item.name == name)
    call.decorator_list, call.body = [], call.body[:1]  # the docstring
    future = next(item for item in tree.body if isinstance(item, ast.ImportFrom))
    names: dict[str, Any] = {}
    exec(compile(ast.Module([future, call], []), module, "exec"), names)
    return names[name]  # type: ignore[no-any-return]


def _groups(show: Callable[..., None]) -> dict[str, type]:
    """Return the groups of options among the parameters of a command's function."""
    names = sys.modules[show.__module__].__dict__
    kinds = {name: meaning_of(item.annotation, names)[0] for name, item in inspect.signature(show).parameters.items()}
    return {name: kind for name, kind in kinds.items() if isinstance(kind, type) and issubclass(kind, tuple)}


def _declared(function: Callable[..., Any], owner: str) -> Iterator[tuple[str, Declared]]:
    """Yield the parameters that ``--help`` explains."""
    names = getattr(sys.modules.get(function.__module__), "__dict__", {})
    for name, item in inspect.signature(function).parameters.items():
        kind, meaning = meaning_of(item.annotation, names)
        if meaning.text:
            several = [get_origin(leaf) in (list, Sequence) for leaf in _leaves(kind) if leaf is not type(None)]
            is_repeated = item.kind is item.VAR_POSITIONAL or (all(several) and meaning.read is None)
            yield name, Declared(kind, meaning, item.default, item.kind is not item.KEYWORD_ONLY, is_repeated, owner)


def _command(show: Callable[..., None], module: str, options: Mapping[str, Declared]) -> Callable[..., None]:
    """Return the function whose signature typer reads; it makes the arguments of the command's function."""

    def run(**given: Any) -> None:
        from robacc.cli.call_checks import check_call

        clock.start()
        check_call(given, [name for name in given if options[name].meaning.holds == "output"])
        console.is_quiet = given.pop("quiet", False)
        values: dict[str, dict[str, Any]] = {}
        for name, value in given.items():
            owner, read = options[name].owner, options[name].meaning.read
            values.setdefault(owner, {})[name] = value if read is None or value is None else read(name, value)
        reading = values.pop("reading", {})
        if any(reading.values()):
            _state(values, options, reading)
        arguments = {owner: own[owner] for owner, own in values.items() if owner in own}
        arguments |= {name: group(**values.get(name, {})) for name, group in _groups(show).items()}
        if "call" in values:
            arguments["call"] = _bound(module, options, values["call"])
        show(**arguments)

    parameters = [_typer_parameter(name, option) for name, option in options.items()]
    run.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
    run.__annotations__ = {item.name: item.annotation for item in parameters}
    run.__doc__ = show.__doc__
    return run


def _state(values: dict[str, dict[str, Any]], options: Mapping[str, Declared], reading: Mapping[str, Any]) -> None:
    """Replace the paths of files of poses by paths that carry how the files are read."""
    from robacc.poses.reading import PoseFile

    for own in values.values():
        for name, value in own.items():
            if options[name].meaning.holds in ("measured poses", "planned poses"):
                if isinstance(value, list):
                    own[name] = [PoseFile(path, **reading) for path in value]
                elif isinstance(value, str):
                    own[name] = PoseFile(value, **reading)


def _bound(module: str, options: Mapping[str, Declared], values: Mapping[str, Any]) -> partial[Any]:
    """Return the call with its arguments; an option that was not given leaves the default of the call."""
    function = getattr(import_module(f"robacc.api.{module}"), module)
    positional = [name for name in values if options[name].is_repeated and options[name].is_argument]
    named = {name: value for name, value in values.items() if name not in positional}
    given = {name: value for name, value in named.items() if value is not None or options[name].default is None}
    return partial(function, *(path for name in positional for path in values[name]), **given)


def _typer_parameter(name: str, option: Declared) -> inspect.Parameter:
    """Return the parameter of typer for an argument or option."""
    meaning, default = option.meaning, option.default
    kind: Any = next((kind for kind in (bool, int, float) if {*_leaves(option.kind)} <= {kind, type(None)}), str)
    if choices_of(option.kind):
        kind = option.kind
    if option.is_repeated:
        kind = list[str]
    default = None if default == () else default
    kind = kind if default is not None else kind | None
    about: Any = {
        "metavar": meaning.metavar,
        "help": as_options(meaning.text),
        "min": meaning.least,
        "max": meaning.most,
    }
    if option.is_argument:
        info = typer.Argument(**about)
    else:
        info = typer.Option(*map(_spelled, meaning.names or (name.replace("_", "-"),)), **about)
    annotation = Annotated[kind, info]
    return inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=annotation)


def _spelled(name: str) -> str:
    """Return the name of an option, or of a pair, with its dashes."""
    return f"-{name}" if len(name) == 1 else f"--{name.replace('/', '/--')}"


def _leaves(kind: Any) -> Iterator[Any]:
    """Yield the members of a union, or the type itself."""
    if get_origin(kind) is Union or type(kind).__name__ == "UnionType":
        for part in get_args(kind):
            yield from _leaves(part)
    else:
        yield kind
