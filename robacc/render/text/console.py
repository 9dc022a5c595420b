"""Terminal output: messages on standard error, tables on standard output, colour only on a terminal.

Colour is used on a terminal unless NO_COLOR is set and not empty (https://no-color.org) or TERM is ``dumb``.
"""

from __future__ import annotations

import os
import shutil
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import Literal, TextIO

from robacc.errors import InputError, Note, RobaccError
from robacc.render.text.parameter_names import as_options

Style = Literal["", "bold", "dim", "green", "red", "yellow", "bold red", "bold yellow"]
_CODES = {"bold": "1", "dim": "2", "green": "32", "red": "31", "yellow": "33"}
"""Select Graphic Rendition of ECMA-48, 8.3.117."""
_SPACES = frozenset("\u00a0\u2002\u2003\u2007\u2009\u202f\u3000")
"""Spaces that Python counts as unprintable, and that do no more than a space."""
is_quiet = False
"""Whether notes are left out; the command line sets it."""

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


def say(text: str, style: Style = "") -> None:
    """Write a message to standard error."""
    write_lines(((line, style) for line in text.split("\n")), sys.stderr)


def say_error(error: RobaccError) -> None:
    """Write a red line for each problem, then the tips."""
    if not isinstance(error, InputError):
        say(f"error: {error}", "red")
        return
    for problem in error.problems:
        where = f"{problem.place}: " if problem.place else ""
        say(f"error: {where}{problem.message}", "red")
    if error.total > len(error.problems):
        say(f"error: … and {error.total - len(error.problems)} more problems", "red")
    for fix in dict.fromkeys(problem.fix for problem in error.problems if problem.fix):
        say(f"  tip: {fix}")


def say_warnings(warnings: Iterable[str]) -> None:
    """Write a yellow line for each warning, then a dim line for each note."""
    for text in sorted(warnings, key=lambda text: isinstance(text, Note)):
        if not isinstance(text, Note):
            say(f"warning: {text}", "yellow")
        elif not is_quiet:
            say(f"note: {text}", "dim")


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
    say(f"interrupted; {done}", "dim")


def width_of(stream: TextIO) -> int:
    """Return the columns for text: the terminal's up to :data:`WIDEST`, :data:`PLAIN_WIDTH` without a terminal."""
    return min(shutil.get_terminal_size().columns, WIDEST) if stream.isatty() else PLAIN_WIDTH


def write_lines(lines: Iterable[tuple[str, Style]], stream: TextIO) -> None:
    """Write lines with their styles, which only a terminal shows."""
    is_styled = uses_colour(stream)
    for line, style in lines:
        text = as_options(visible(line))
        codes = ";".join(_CODES[word] for word in style.split()) if is_styled else ""
        stream.write(f"\033[{codes}m{text}\033[0m\n" if codes else f"{text}\n")
