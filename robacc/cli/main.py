"""The command line's frame: which commands there are, and what an error becomes.

A command's module is imported when the command runs, so ``robacc --help`` costs what a bare typer program costs.
Command modules import NumPy and what uses it inside their functions, for the same reason.
"""

from __future__ import annotations

import io
import os
import sys
from collections.abc import Callable
from importlib import import_module
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from robacc.errors import InputError, Problem, RobaccError
from robacc.render.text.console import say_error, say_interrupted
from robacc.version import __version__

COMMANDS = {
    "estimate": "Cartesian error at each measured pose, its covariances, and an accuracy grade.",
    "trace": (
        "Close the loop: residual, cause, correction, and the error before and after on poses that had no part in it."
    ),
    "calibrate": "Fit the named effects to measured poses and report the error before and after, fitted and held out.",
    "predict": "Covariances, error budget and grade to be expected from parameter tolerances.",
    "iso9283": "The pose criteria of ISO 9283 that cycles of commanded poses support, and which conditions they meet.",
    "iso9283-poses": "The cube of ISO 9283 in an arm's workspace and its five poses, with joint angles, as a CSV.",
    "check": "Hold a stored result against a gate: exit 0 where it passes, 4 where it fails, 5 where it is undecided.",
    "compare": "Stored results side by side: which differences are real, and which results demonstrate a grade.",
    "report": "Stored results as one HTML page: story, pictures, tables, to be looked at, printed and signed.",
    "plot": "One picture of a stored result as SVG, PNG or PDF.",
    "show": "The chain, joints, limits, reach and masses of a robot file or URDF.",
    "effects": "The catalogue of effects: equation, unit, usual size, needs, and what each is confused with.",
    "init": "A robot file and a CSV of measured poses to begin with, commented, from a URDF or a number of joints.",
    "simulate": "A CSV of simulated poses, exact and nonlinear, with the effects that the robot file lists.",
    "export": "A model as URDF, as far as a URDF can carry it; the rest is said.",
    "schema": "The JSON Schema of a command's result: every key, its unit, and which keys are always there.",
}
"""Name of each command, with _ for - its module's and its function's too, and its line in ``robacc --help``."""

INTERRUPTED = 130
"""128 + SIGINT, what a shell reports of a program that was interrupted."""
BROKEN_PIPE = 141
"""128 + SIGPIPE: whoever read the output had enough."""


class Commands(TyperGroup):
    """The group of commands; loads the one that is asked for, and turns errors into lines and exit statuses."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """The command that ``args`` names, with its own options; the rest of the arguments."""
        name, command, rest = super().resolve_command(ctx, args)
        return name, _load(name) if name in COMMANDS else command, rest

    def invoke(self, ctx: Any) -> Any:
        """Run the command; the one place where an error meets the terminal."""
        try:
            return super().invoke(ctx)
        except RobaccError as error:
            say_error(error)
            raise typer.Exit(error.exit_status) from error
        except KeyboardInterrupt as interrupt:
            say_interrupted(*map(str, interrupt.args))
            raise typer.Exit(INTERRUPTED) from interrupt


class CheckedCommand(TyperCommand):
    """A command whose call is looked over before it runs."""

    def invoke(self, ctx: Any) -> Any:
        """Run the command, unless it would overwrite what it reads or be of no use."""
        from robacc.cli.output import check_call

        check_call(ctx.params)
        return super().invoke(ctx)


def _load(name: str) -> Any:
    """The command ``name`` from its own module."""
    single, own = typer.Typer(add_completion=False), name.replace("-", "_")
    single.command(name, cls=CheckedCommand)(getattr(import_module(f"robacc.cli.commands.{own}"), own))
    return typer.main.get_command(single)


def _version(wanted: bool) -> None:
    if wanted:
        print(f"robacc {__version__}")
        raise typer.Exit


def _placeholder() -> Callable[[], None]:
    def command() -> None:
        """Stands for a command in lists of commands; :class:`Commands` puts the real one in its place."""

    return command


app = typer.Typer(name="robacc", cls=Commands, no_args_is_help=True, rich_markup_mode="rich")


@app.callback()
def robacc(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """How accurate is the arm, why, and what would make it better."""


for _name, _summary in COMMANDS.items():
    app.command(_name, help=_summary)(_placeholder())


def main() -> None:
    """Run the command line and exit with its status; a defect ends in Python's own traceback and status 1."""
    # Before NumPy is loaded: on the small matrices of this work, threads of the linear algebra wait for one another for
    # longer than they compute (100 poses took eight times as long). One thread rounds alike on every machine.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    _open_closed_streams()
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            # A terminal that cannot show "±" shows "?" instead of ending the program.
            stream.reconfigure(errors="replace")
    try:
        _run()
    except KeyboardInterrupt:
        say_interrupted()
        sys.exit(INTERRUPTED)
    except BrokenPipeError:
        _discard_output()
        sys.exit(BROKEN_PIPE)
    except OSError as error:
        if error.filename is not None:
            raise
        # Files name themselves, and say_error() told of them already: this is standard output, full or closed.
        say_error(InputError(Problem(f"cannot be written: {str(error.strerror or error).lower()}", "standard output")))
        _discard_output()
        sys.exit(InputError.exit_status)


def _run() -> None:
    """Run the command that is asked for, help and version included, and write all of its output.

    Raises:
        SystemExit: always, with the status.
        BrokenPipeError: whoever read standard output or the messages had enough.
    """
    try:
        typer.main.get_command(app)(prog_name="robacc")
    except SystemExit as end:
        if isinstance(end.__context__, BrokenPipeError):
            # typer and rich end the program themselves then, with the status of a crash.
            raise BrokenPipeError from end
        sys.stdout.flush()
        raise


def _open_closed_streams() -> None:
    """A stream that the shell closed (``>&-``) is None, and its number would be the next file's."""
    if sys.stdin is None:
        sys.stdin = open(os.devnull, encoding="utf-8")  # noqa: SIM115 (until the process ends)
    if sys.stdout is None:
        # For reading, so that a result that goes nowhere is an error, and one that goes to a file is none.
        sys.stdout = open(os.devnull, encoding="utf-8")  # noqa: SIM115
    if sys.stderr is None:
        sys.stderr = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115


def _discard_output() -> None:
    """What is still buffered would fail again, loudly, when the interpreter closes the streams."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for number in (1, 2):
        os.dup2(nowhere, number)
