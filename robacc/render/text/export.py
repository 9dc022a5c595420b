"""Table of ``robacc export``."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, TextIO


def write_export(stream: TextIO, result: Mapping[str, Any]) -> None:
    """Write what the file holds, the error that remains in it, and the tool to set."""
    position, orientation = result["remaining_error"]["position"], result["remaining_error"]["orientation"]
    arm = f" of {result['arm']}" if result["arm"] else ""
    lines = [f"Export as {result['format']}{arm}"]
    if result["refitted"]:
        lines.append(f"fitted again to    {', '.join(result['refitted'])}")
    if result["not_carried"]:
        lines.append(f"not in the format  {', '.join(result['not_carried'])}")
    lines.append(
        f"remaining error    position {_mm(position['rms_m'])} mm rms, {_mm(position['max_m'])} mm max; "
        f"orientation {_deg(orientation['rms_rad'])}° rms, {_deg(orientation['max_rad'])}° max"
    )
    lines.append(f"                   over {result['remaining_error']['n_poses']} poses within the joint limits")
    place = ", ".join(_mm(value) for value in result["tool"]["xyz_m"])
    turn = ", ".join(_deg(value) for value in result["tool"]["rpy_rad"])
    lines.append(f"tool to set        x, y, z {place} mm")
    lines.append(f"                   roll, pitch, yaw {turn}°")
    print("\n".join(lines), file=stream)


def _mm(value: float) -> str:
    return f"{round(1e3 * value, 4) + 0.0:.4f}"


def _deg(value: float) -> str:
    return f"{round(math.degrees(value), 5) + 0.0:.5f}"
