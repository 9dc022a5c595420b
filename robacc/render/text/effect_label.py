"""Name of a finding or an alternative for a reader."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any


def effect_label(effect: str, joints: Sequence[str], settings: Mapping[str, Any]) -> str:
    """Return ``backlash[j3]``, ``step[base]``: the effect, with its joints or with the part that changes.

    Masses that are fitted too are named: the same effect with the file's masses may be another finding.
    """
    masses = settings.get("masses", "known")
    if masses != "known":
        return f"{effect_label(effect, joints, {**settings, 'masses': 'known'})} with {masses} masses"
    part = settings.get("part")
    if joints and part != "payload":
        return f"{effect}[{','.join(joints)}]"
    where = settings.get("target") or part
    return f"{effect}[{where}]" if where else effect
