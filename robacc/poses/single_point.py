"""Coordinates of a table that numbers its only point: ``x1, y1, z1``, and angles ``phix1, phiy1, phiz1``."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping

from robacc.poses.columns import AXES
from robacc.poses.headings import Meaning

_NUMBERED = re.compile(r"(phi)?([xyz]) (\d+)")


def single_point(texts: Iterable[str]) -> Mapping[str, Meaning]:
    """Return what numbered coordinates stand for, by text of the heading; empty for no such point or for several.

    Args:
        texts: Texts of the headings of a table, such as ``x 1`` of ``X1``.
    """
    texts = frozenset(texts)
    matches = [match for text in texts if (match := _NUMBERED.fullmatch(text))]
    positions = sorted(match[2] for match in matches if not match[1])
    if len({match[3] for match in matches}) != 1 or positions != list(AXES) or texts & set(AXES):
        return {}
    return {match[0]: Meaning(f"r{match[2]}", family="axes") if match[1] else Meaning(match[2]) for match in matches}
