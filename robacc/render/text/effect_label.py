"""Name of a finding or an alternative for a reader."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any


def effect_label(effect: str, joints: Sequence[str], settings: Mapping[str, Any]) -> str:
    """Return ``backlash[j3]``, ``step[base]``: the effect, with its joints or with the part that changes."""
    part = settings.get("part")
    if joints and part != "payload":
        return f"{effect}[{','.join(joints)}]"
    where = settings.get("target") or part
    return f"{effect}[{where}]" if where else effect
