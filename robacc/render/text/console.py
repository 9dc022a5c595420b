"""Terminal output: messages on standard error, tables on standard output, colour only on a terminal.

Colour is used on a terminal unless NO_COLOR is set and not empty (https://no-color.org) or TERM is ``dumb``.
"""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, TextIO

from robacc.errors import InputError, Note, RobaccError
from robacc.render.text.parameter_names import as_options

if TYPE_CHECKING:
    from rich.console import Console

    from robacc.render.text.layout import TextLine

_SPACES = frozenset("\u00a0\u2002\u2003\u2007\u2009\u202f\u3000")
"""Spaces that Python counts as unprintable, and that do no more than a space."""
GREEN, RED, YELLOW = "\033[32m", "\033[31m", "\033[33m"
is_quiet = False
"""Whether notes are left out; the command line sets it."""
_DIM, _RESET = "\033[2m", "\033[0m"

PLAIN_WIDTH = 80
"""Columns of a table written to a file or a pipe; fits a mail, a ticket and a printed page."""

WIDEST = 100
"""Upper limit of text columns; longer lines are hard to read."""


def uses_colour(stream: TextIO) -> bool:
    """Return whether to use colour on ``stream``."""
    return stream.isatty() and not os.environ.get("NO_COLOR") and os.environ.get("TERM") != "dumb"


def visible(text: str) -> str:
    """Return the text with control and other unprintable characters escaped.

    Names and texts from files reach messages and tables; an escape sequence in them could clear or rewrite the screen.
    """
    if text.isprintable():
        return text
    return "".join(sign if sign.isprintable() or sign in _SPACES else ascii(sign)[1:-1] for sign in text)


def say(text: str, colour: str = "") -> None:
    """Write one line to standard error."""
    text = as_options("\n".join(visible(line) for line in text.split("\n")))
    if colour and uses_colour(sys.stderr):
        text = f"{colour}{text}{_RESET}"
    print(text, file=sys.stderr)


def say_error(error: RobaccError) -> None:
    """Write a red line for each problem, then the tips."""
    if not isinstance(error, InputError):
        say(f"error: {error}", RED)
        return
    for problem in error.problems:
        where = f"{problem.place}: " if problem.place else ""
        say(f"error: {where}{problem.message}", RED)
    if error.total > len(error.problems):
        say(f"error: … and {error.total - len(error.problems)} more problems", RED)
    for fix in dict.fromkeys(problem.fix for problem in error.problems if problem.fix):
        say(f"  tip: {fix}")


def say_warnings(warnings: Iterable[str]) -> None:
    """Write a yellow line for each warning, then a dim line for each note."""
    for text in sorted(warnings, key=lambda text: isinstance(text, Note)):
        word, colour = ("note", _DIM) if isinstance(text, Note) else ("warning", YELLOW)
        if word == "warning" or not is_quiet:
            say(f"{word}: {text}", colour)


@contextmanager
def warnings_below(warnings: Iterable[str]) -> Iterator[None]:
    """Write the warnings after the body, which writes the result: below a long table they stay in view.

    They are also written if the body fails, for example because the reader of the result closed the pipe.
    """
    try:
        yield
    finally:
        say_warnings(warnings)


def say_interrupted(done: str = "nothing was written") -> None:
    """Write the line that reports an interrupt and the work done before it."""
    say(f"interrupted; {done}", _DIM)


def console_for(stream: TextIO) -> Console:
    """Return a rich console: the terminal's width and colours, or plain text in :data:`PLAIN_WIDTH` columns."""
    from rich.console import Console

    class Piped(Console):
        def on_broken_pipe(self) -> None:
            # rich would end the program here, with the status of a crash.
            raise BrokenPipeError

    if uses_colour(stream):
        return Piped(file=stream, highlight=False)
    width = None if stream.isatty() else PLAIN_WIDTH
    return Piped(file=stream, highlight=False, width=width, color_system=None, force_terminal=False)


def width_of(stream: TextIO) -> int:
    """Return the columns for text: the terminal's up to :data:`WIDEST`, :data:`PLAIN_WIDTH` without a terminal."""
    return min(shutil.get_terminal_size().columns, WIDEST) if stream.isatty() else PLAIN_WIDTH


def write_lines(lines: Iterable[TextLine], stream: TextIO) -> None:
    """Write the lines of a report, styled on a terminal."""
    if not uses_colour(stream):
        stream.writelines(f"{as_options(visible(line.text))}\n" for line in lines)
        return
    console = console_for(stream)
    for line in lines:
        console.print(
            as_options(visible(line.text)), style=line.style or None, markup=False, highlight=False, soft_wrap=True
        )
