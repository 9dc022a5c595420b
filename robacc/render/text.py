"""Texts of results and messages: numbers with the digits that their uncertainty supports, units, names, terminals.

Messages go to standard error and tables to standard output, in colour only on a terminal, unless NO_COLOR is set and
not empty (https://no-color.org) or TERM is ``dumb``.
"""

from __future__ import annotations

import math
import os
import re
import shutil
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, Literal, NamedTuple, TextIO

from robacc.errors import InputError, Note, RobaccError

Document = Mapping[str, Any]
"""A JSON result, or an object in it."""

# Parameter names in texts of the library, shown as options of the command line: the library names a parameter of a call
# in backquotes, as its signature spells it: ```align` needs `against```; on the terminal: ``--align needs --against``.

_MARKED = re.compile(r"""(?<![\w'"`/\\])`([a-z][a-z0-9_]*)(?:=("?)([^\s`"]+)\2)?`(?![\w'"`/\\])""")
"""A name in backquotes, perhaps with a value; not within quotes, where it is text of a user's file."""
NEGATIVE_OPTIONS = {"empirical": "--named-only", "robust": "--all-rows"}
"""Options that set a parameter to False and are not spelled ``--no-`` and its name."""


def as_options(text: str) -> str:
    """Return ``text`` with every parameter name in backquotes replaced by the option of that name.

    A plain name keeps its length, so lines that are wrapped already stay as they are.

    >>> as_options('`align` needs `against`; try `align="base_frame,tool_frame"` or `shrink=False`')
    '--align needs --against; try --align base_frame,tool_frame or --no-shrink'
    """
    return _MARKED.sub(_option, text)


def _option(match: re.Match[str]) -> str:
    name, value = match[1].replace("_", "-"), match[3]
    if value == "False":
        return NEGATIVE_OPTIONS.get(match[1], f"--no-{name}")
    return f"--{name}" if value in (None, "True") else f"--{name} {value}"


# Terminal output.

Style = Literal["", "bold", "dim", "green", "red", "yellow", "bold red", "bold yellow"]
_CODES = {"bold": "1", "dim": "2", "green": "32", "red": "31", "yellow": "33"}
"""Select Graphic Rendition of ECMA-48, 8.3.117."""
_SPACES = frozenset("\u00a0\u2002\u2003\u2007\u2009\u202f\u3000")
"""Spaces that Python counts as unprintable, and that do no more than a space."""
is_quiet = False
"""Whether notes are left out; the command line sets it."""
PLAIN_WIDTH = 80
"""Columns of a table written to a file or a pipe; fits a mail, a ticket and a printed page."""


def say(text: str, style: Style = "") -> None:
    """Write a message to standard error."""
    write_lines(((line, style) for line in text.split("\n")), sys.stderr)


def say_error(error: RobaccError) -> None:
    """Write a red line for each problem, then the tips."""
    if not isinstance(error, InputError):
        say(f"error: {error}", "red")
        return
    for problem in error.problems:
        say(f"error: {f'{problem.place}: ' if problem.place else ''}{problem.message}", "red")
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


def width_of(stream: TextIO) -> int:
    """Return the columns for text: a terminal's up to 100, beyond which reading is hard; else :data:`PLAIN_WIDTH`."""
    return min(shutil.get_terminal_size().columns, 100) if stream.isatty() else PLAIN_WIDTH


def write_lines(lines: Iterable[tuple[str, Style]], stream: TextIO) -> None:
    """Write lines with their styles, which only a terminal shows, and with unprintable characters escaped.

    Names and texts from files reach messages and tables; an escape sequence in them could clear or rewrite the screen.
    """
    is_styled = stream.isatty() and not os.environ.get("NO_COLOR") and os.environ.get("TERM") != "dumb"
    for line, style in lines:
        text = as_options(
            "".join(sign if sign.isprintable() or sign in _SPACES else ascii(sign)[1:-1] for sign in line)
        )
        codes = ";".join(_CODES[word] for word in style.split()) if is_styled else ""
        stream.write(f"\033[{codes}m{text}\033[0m\n" if codes else f"{text}\n")


# Numbers as text: as many digits as the uncertainty supports.

_DIGITS_OF_UNCERTAINTY = 2
"""Digits of an interval's half width (JCGM 100:2008, 7.2.6)."""
_DIGITS_WITHOUT = 3
"""Digits of a number of unknown uncertainty."""


def decimals(value: float, lower: float | None, upper: float | None) -> int:
    """Return the decimals of a value with the interval ``lower … upper``; three significant digits without one."""
    size, digits = abs(value), _DIGITS_WITHOUT
    if lower is not None and upper is not None and upper > lower:
        size, digits = 0.5 * (upper - lower), _DIGITS_OF_UNCERTAINTY
    if size <= 0.0 or not math.isfinite(size):
        return _DIGITS_WITHOUT
    # Rounding first makes 0.0996 count as 0.10.
    return min(max(digits - 1 - math.floor(math.log10(float(f"{size:.{digits - 1}e}"))), 0), 9)


def fixed(value: float | None, places: int) -> str:
    """Return the number with ``places`` decimals, zero without a sign; a dash for None and NaN."""
    if value is None or not math.isfinite(value):
        return "–"
    text = f"{value:.{places}f}"
    return text.removeprefix("-") if float(text) == 0.0 else text


def three_digits(value: float) -> str:
    """Return three significant digits, with an exponent only for very small and very large values."""
    if 1e-4 <= abs(value) < 1e6:
        return fixed(value, decimals(value, None, None))
    return "0" if abs(value) < 1e-12 else f"{value:.2e}"


def measured(value: float, error: float) -> tuple[str, str]:
    """Return value and standard error: two digits of the error, the value to the same place (JCGM 100:2008, 7.2.6)."""
    if not (error > 0.0 and math.isfinite(error) and math.isfinite(value)):
        return f"{value + 0.0:.6g}", f"{error:g}"
    error_text = f"{error:.{_DIGITS_OF_UNCERTAINTY - 1}e}"
    place = int(error_text.partition("e")[2]) - (_DIGITS_OF_UNCERTAINTY - 1)
    if 1e-4 <= abs(float(error_text)) < 1e6:
        error_text = fixed(round(error, -place), max(-place, 0))
    size = max(abs(value), error)
    if 1e-4 <= size < 1e6:
        # A double has no more than fifteen digits, however small the error of noise-free poses.
        return fixed(round(value, -place), min(max(-place, 0), 14 - math.floor(math.log10(size)))), error_text
    digits = math.floor(math.log10(abs(value))) - place if value else -1
    if digits < 0:
        rounded = round(value * 10.0**-place)
        return ("0" if rounded == 0 else f"{rounded * 10.0**place:.0e}"), error_text
    return f"{value:.{min(digits, 14)}e}", error_text


def p_value(probability: float | None) -> str:
    """Return ``p = 0.032``, or ``p < 1e-6`` for smaller probabilities."""
    if probability is None or math.isnan(probability):
        return "–"
    return "p < 1e-6" if probability < 1e-6 else f"p = {probability:.2g}"


def chance(probability: float) -> str:
    """Return a probability in whole percent, at most ``> 99 %`` and at least ``< 1 %``."""
    if probability > 0.995:
        return "> 99 %"
    return "< 1 %" if probability < 0.005 else f"{100 * probability:.0f} %"


def odds(difference: float) -> str:
    """Return the odds of an alternative whose evidence is lower by ``difference`` (log Bayes factor)."""
    # Beyond 700 the exponential overflows.
    ratio = f"{math.exp(min(abs(difference), 700.0)):.3g}"
    return f"{ratio} to 1" if difference < 0 and ratio != "1" else f"1 to {ratio}"


# Units: mm and degrees in tables, whatever the unit of the result or of the robot file; charts and headlines use one
# unit each, chosen by its largest value.

IN_MM = 1e3
IN_DEGREES = 180.0 / math.pi
QUANTITIES = (("position", "m", "mm", IN_MM), ("orientation", "rad", "°", IN_DEGREES))
"""Quantity, unit of the result, unit of tables, and the factor between them."""
STATISTICS = (("rms", "rms"), ("mean", "mean_error"), ("95th percentile", "p95"), ("maximum", "max"))
"""Names and keys of the statistics of an error's length."""
_OF_SIZE = re.compile("(m|rad)([/ ].*)?")


class Unit(NamedTuple):
    """A display unit."""

    factor: float
    """Displayed number = factor times SI value."""
    name: str

    def text(self, value: float | None) -> str:
        """Return three digits and the unit; a dash for None and NaN."""
        if value is None or not math.isfinite(value):
            return "–"
        return self.after(three_digits(value * self.factor))

    def after(self, number: str) -> str:
        """Return a number with the unit; degrees follow without a space."""
        return f"{number}{'' if self.name.startswith('°') else ' '}{self.name}".rstrip()


def unit_of(unit: str, *sizes: float) -> Unit:
    """Return the unit that tables show for an SI unit; micrometres for lengths if all ``sizes`` are below 0.02 mm.

    ``rad/(N m)`` becomes ``°/(N m)``: only the unit before the first slash or space is that of an effect's size.
    """
    match = _OF_SIZE.fullmatch(unit)
    if match is None:
        return Unit(1.0, "" if unit == "1" else unit)
    if unit == "m" and sizes and max((abs(size) for size in sizes if math.isfinite(size)), default=0.0) < 2e-5:
        return Unit(1e6, "µm")
    factor, name = (IN_MM, "mm") if match[1] == "m" else (IN_DEGREES, "°")
    return Unit(factor, name + (match[2] or ""))


# Names.


def joint_unit(joint: Document) -> Unit:
    """Return the unit of the variable of a joint."""
    return unit_of("m" if joint["type"] == "prismatic" else "rad")


def grouped(names: Sequence[str]) -> str:
    """Return names with a common beginning together: ``tool_frame.a (roll, pitch)``."""
    members: dict[str, list[str]] = {}
    for name in names:
        start, _, last = name.rpartition(".")
        members.setdefault(start, []).append(last)
    return ", ".join(
        f"{start} ({', '.join(parts)})"
        if start and len(parts) > 1
        else ", ".join(f"{start}.{part}".lstrip(".") for part in parts)
        for start, parts in members.items()
    )


def effect_label(effect: str, joints: Sequence[str], settings: Mapping[str, Any]) -> str:
    """Return ``backlash[j3]``, ``step[base]``: the effect, with its joints or with the part that changes.

    Masses that are fitted too are named: the same effect with the file's masses may be another finding.
    """
    part, masses = settings.get("part"), settings.get("masses", "known")
    where = ",".join(joints) if joints and part != "payload" else settings.get("target") or part
    label = f"{effect}[{where}]" if where else effect
    return label if masses == "known" else f"{label} with {masses} masses"
