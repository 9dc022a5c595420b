"""Table of ``robacc export``, at most 80 columns."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping
from typing import Any, TextIO

from robacc.render.text.numbers import three_digits
from robacc.render.text.units import IN_DEGREES, IN_MM

_WIDTH = 80
_LEAST = 1e-4
"""Smallest error that is shown as a number, mm or degrees: below it, the digits of the file decide."""
_LABEL = 19
"""Columns that the labels take."""


def write_export(stream: TextIO, result: Mapping[str, Any]) -> None:
    """Write what the file holds, the error that remains in it, and the tool to set."""
    remaining = result["remaining_error"]
    arm = f" of {result['arm']}" if result["arm"] else ""
    lines = [f"Export as {result['format']}{arm}"]
    if result["refitted"]:
        lines += _labelled("fitted again to", ", ".join(result["refitted"]))
    if result["not_carried"]:
        lines += _labelled("not in the format", ", ".join(result["not_carried"]))
    lines += _labelled("remaining error", f"position {_sizes(remaining['position'], 'm', IN_MM, ' mm')};")
    lines += _labelled("", f"orientation {_sizes(remaining['orientation'], 'rad', IN_DEGREES, '°')};")
    lines += _labelled("", f"over {remaining['n_poses']} poses within the joint limits")
    place = ", ".join(_fixed(IN_MM * value, 4) for value in result["tool"]["xyz_m"])
    turn = ", ".join(_fixed(math.degrees(value), 5) for value in result["tool"]["rpy_rad"])
    lines += _labelled("tool to set", f"x, y, z {place} mm")
    lines += _labelled("", f"roll, pitch, yaw {turn}°")
    print("\n".join(lines), file=stream)


def _sizes(errors: Mapping[str, float], unit: str, factor: float, name: str) -> str:
    sizes = (errors[f"{key}_{unit}"] * factor for key in ("rms", "max"))
    rms, largest = (three_digits(size) if size >= _LEAST else f"< {_LEAST:g}" for size in sizes)
    return f"{rms}{name} rms, {largest}{name} largest"


def _labelled(label: str, text: str) -> list[str]:
    """Return a label and its text, wrapped with a hanging indent."""
    return textwrap.wrap(
        text, _WIDTH, initial_indent=f"{label:<{_LABEL}}", subsequent_indent=" " * _LABEL, break_on_hyphens=False
    )


def _fixed(value: float, places: int) -> str:
    return f"{round(value, places) + 0.0:.{places}f}"
