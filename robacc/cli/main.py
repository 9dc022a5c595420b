"""Entry point of the command line: the commands, and the exit status of every error.

The commands are imported when one runs, so that ``robacc --help`` is fast. For the same reason, their modules import
NumPy and its users inside their functions.
"""

import io
import os
import sys
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from robacc.errors import InputError, Problem, RobaccError, UsageError
from robacc.render.text import say, say_error
from robacc.version import __version__
from robacc.workers import THREADS_VARIABLE

COMMANDS = {
    "estimate": "Compute the Cartesian error of measured poses, its covariances and the accuracy grade.",
    "trace": "Find the effects that explain the residual, and report the error before and after on held-out poses.",
    "calibrate": "Fit named effects to measured poses, and report fitted and held-out errors before and after.",
    "predict": "Predict covariances, error budget and grade from parameter tolerances or the fit of a model file.",
    "correct": "Compute the commands that make the real arm reach its targets, from a model of the arm.",
    "iso9283": "Compute the pose criteria of ISO 9283 from cycles of commanded poses.",
    "check": "Check a stored result against a gate; exit 0: pass, 4: fail, 5: inconclusive.",
    "compare": "Compare stored results or files of poses: significant differences, ranking and confirmed grades.",
    "report": "Write stored results as an HTML page with charts and tables, or one chart as SVG, PNG or PDF.",
    "fleet": "Compute the tolerances of a model of arm from the fits of many, and name the arms unlike the others.",
    "health": "Say from a few poses whether a coefficient of an arm moved since its last full test.",
    "history": "Keep results in a database, and say what changed, when and by how much: add, show, trend, changes.",
    "show": "Show a robot file or URDF; or the arms, effects and result schemas that robacc knows.",
    "init": "Write files to start from: a robot file and a CSV of poses, the map of an export, or a board to print.",
    "plan": "Plan a measurement: choose the poses worth measuring, order them, and predict the result.",
    "simulate": "Simulate measured poses of a robot with the effects of its file, and write them as a CSV.",
    "export": "Write a robot model for a controller, a driver or a simulator, with the error that remains there.",
}
"""Each command and its line in ``robacc --help``; its function has the same name."""
FORMS = {
    "history add": "history_add",
    "history show": "history_show",
    "history trend": "history_trend",
    "history changes": "history_changes",
    "show robots": "robots",
    "show effects": "effects",
    "show schema": "schema",
    "plan --for iso9283": "iso9283_poses",
    "init --from": "import_",
}
"""Forms of a command with arguments and options of their own: the words that choose them, and the function."""
RENAMED: dict[str, tuple[str, list[str]]] = {
    "robots": ("show robots", []),
    "effects": ("show effects", []),
    "schema": ("show schema", []),
    "iso9283-poses": ("plan --for iso9283", ["--output", "-"]),
    "plot": ("report --chart", ["--chart", ""]),
    "import": ("init --from", []),
}
"""Names of commands in 0.2, which work until 0.4: the new name, and what was the default then."""


class Commands(TyperGroup):
    """Group of commands; loads the requested command, and turns errors into messages and exit statuses."""

    def parse_args(self, ctx: Any, args: list[str]) -> Any:
        """Print the help on standard output if there are no arguments; click would print it on standard error."""
        if not args and not ctx.resilient_parsing:
            print(ctx.get_help())
            raise typer.Exit(UsageError.exit_status)
        return super().parse_args(ctx, args)

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return the name, the command with its options, and the remaining arguments."""
        name, command, arguments = super().resolve_command(ctx, args)
        if name is None:  # while a shell completes a name
            return name, command, arguments
        from robacc.cli.command import load

        if name in RENAMED:
            new, was_default = RENAMED[name]
            say(f"note: robacc {name} is now robacc {new}; the old name works until 0.4")
            name, arguments = new if new in FORMS else new.split()[0], [*was_default, *arguments]
        else:
            name, arguments = form_of(name, arguments)
        return name, load(name, FORMS.get(name)), arguments

    def invoke(self, ctx: Any) -> Any:
        """Run the command and report its error; no other function writes errors to the terminal."""
        try:
            return super().invoke(ctx)
        except RobaccError as error:
            say_error(error)
            raise typer.Exit(error.exit_status) from error
        except KeyboardInterrupt as interrupt:
            # Without this module, nothing was written yet.
            written = getattr(sys.modules.get("robacc.io.files"), "WRITTEN", ())
            done = f"{', '.join(written)} was written, nothing else" if written else "nothing was written"
            say(f"interrupted; {''.join(map(str, interrupt.args)) or done}", "dim")
            raise typer.Exit(130) from None  # as a shell has it: 128 + SIGINT


def form_of(name: str, arguments: list[str]) -> tuple[str, list[str]]:
    """Return the form of a command that its arguments choose, or its name, and the arguments without these words."""
    for i, argument in enumerate(arguments):
        rest = [*argument.split("=", 1), *arguments[i + 1 :]]
        for form in FORMS:
            head, *words = form.split()
            if head == name and rest[: len(words)] == words:
                return form, [*arguments[:i], *rest[len(words) :]]
    return name, arguments


def _version(is_requested: bool) -> None:
    if is_requested:
        print(f"robacc {__version__}")
        raise typer.Exit


def _placeholder() -> None:
    """Stand for a command in ``robacc --help``; :class:`Commands` replaces it when it runs."""


app = typer.Typer(name="robacc", cls=Commands, rich_markup_mode=None)


@app.callback()
def robacc(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Measure the accuracy of a robot arm, find the causes of its errors, and correct its model."""


for _name, _summary in COMMANDS.items():
    # click cuts a help at 45 characters; a short help is wrapped.
    app.command(_name, help=_summary, short_help=_summary)(_placeholder)
for _name in RENAMED:
    app.command(_name, hidden=True)(_placeholder)


def main() -> None:
    """Run the command line, help and version included, write all of its output, and exit with its status.

    A defect of robacc shows a traceback and exits with 1.
    """
    # Set before NumPy is imported, so that no thread is started.
    os.environ.setdefault(THREADS_VARIABLE, "1")
    # Standard output for reading: a result on it is an error, a result in a file is not.
    for name, mode in (("stdin", "r"), ("stdout", "r"), ("stderr", "w")):
        stream = getattr(sys, name)
        if stream is None:  # the shell closed it (``>&-``), and the next file would get its number
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: SIM115 (until the process ends)
        elif name != "stdin" and isinstance(stream, io.TextIOWrapper):
            # A terminal that cannot show "±" shows "?"; without this, the program would end.
            stream.reconfigure(errors="replace")
    try:
        try:
            typer.main.get_command(app)(prog_name="robacc")
        except SystemExit as end:
            if isinstance(end.__context__, BrokenPipeError):
                # typer and rich would exit with the status of a crash.
                raise BrokenPipeError from end
            if isinstance(getattr(end.__context__, "__cause__", None), KeyboardInterrupt):
                # Before the command typer would say nothing.
                raise KeyboardInterrupt from end
            sys.stdout.flush()
            raise
    except OSError as error:
        status = 141  # The reader of the output has closed it: 128 + SIGPIPE.
        if not isinstance(error, BrokenPipeError):
            if error.filename is not None:
                raise
            # An error without a file name is about standard output, which is full or closed.
            say_error(
                InputError(Problem(f"cannot be written: {str(error.strerror or error).lower()}", "standard output"))
            )
            status = InputError.exit_status
        # Else the interpreter reports the same error again at its exit, when it writes buffered output.
        null_device = os.open(os.devnull, os.O_WRONLY)
        for number in (1, 2):
            os.dup2(null_device, number)
        sys.exit(status)
