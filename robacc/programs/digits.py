"""Numbers written as the program writes them: decimals, column width, sign and leading zero."""

from __future__ import annotations

import re

from robacc.programs.program import ProgramNumber
from robacc.programs.source import ProgramSource


def edit(
    source: ProgramSource, number: ProgramNumber, value: float, decimals: int, bare_point: bool
) -> tuple[int, int, str] | None:
    """Return the edit ``(start, end, text)`` that gives a number the ``value`` (program's unit); None for no change.

    Args:
        source: Text of the program.
        number: Number to change.
        value: New value.
        decimals: Least decimals; a number with more keeps them.
        bare_point: Omit the zero before the decimal point.
    """
    old = source.text[number.start : number.end]
    decimals = max(decimals, _decimals(old))
    new = f"{value:.{decimals}f}"
    if float(new) == number.value or new == f"{number.value:.{decimals}f}":
        return None
    if float(new) == 0 and new.startswith("-"):
        new = new[1:]
    if bare_point:
        new = re.sub(r"^(-?)0\.", r"\1.", new)
    if old.startswith("+") and not new.startswith("-"):
        new = f"+{new}"
    start = number.start
    spaces = start
    while spaces > 0 and source.text[spaces - 1] == " ":
        spaces -= 1
    if start - spaces >= 2:
        # A column that is aligned to the right: the spaces give way, all but the last.
        start = spaces + 1
        new = new.rjust(number.end - start)
    return start, number.end, new


def _decimals(text: str) -> int:
    if "e" in text.lower():
        return 0
    return len(text.partition(".")[2])
