"""Configurations of Cartesian targets as programs write them: which joints they allow.

KRL writes ``S s,T t``: bit i of T is set where axis i + 1 is negative (KUKA, Expert Programming, "Status and Turn").
RAPID writes ``[cf1,cf4,cf6,cfx]``: the quarter turns of axes 1, 4 and 6, 0 from 0 to 90 degrees and -1 from -90 to 0
degrees (ABB, Technical reference manual, "confdata"). S and cfx are not read. The letters of a FANUC ``CONFIG`` depend
on the arm and are not read.
"""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import NDArray

from robacc.geometry import Array
from robacc.programs.program import Dialect

_TURN = re.compile(r"\bT\s*'?(B[01]+|\d+)", re.IGNORECASE)
_NUMBERS = re.compile(r"-?\d+")
_AT_BORDER = 1e-3
"""rad: distance from a border within which both sides count."""
_CF_AXES = (0, 3, 5)


def allowed(dialect: Dialect, configuration: str, q: Array) -> NDArray[np.bool_] | None:
    """Return which joints ``(J, N)``, rad, a configuration allows; None where it is not read, or not given."""
    if dialect is Dialect.krl and (match := _TURN.search(configuration)):
        text = match[1]
        turn = int(text[1:], 2) if text[0] in "Bb" else int(text)
        signs = np.array([turn >> i & 1 for i in range(q.shape[0])], dtype=bool)[:, None]
        fits = np.where(signs, q < _AT_BORDER, q > -_AT_BORDER)
        result: NDArray[np.bool_] = np.all(fits, axis=0)
        return result
    if dialect is Dialect.rapid and q.shape[0] == 6:
        quarters = [int(number) for number in _NUMBERS.findall(configuration)[:3]]
        if len(quarters) < 3:
            return None
        low = 0.5 * np.pi * np.array(quarters)[:, None]
        angles = q[_CF_AXES, :]
        inside: NDArray[np.bool_] = np.all(
            (angles > low - _AT_BORDER) & (angles < low + np.pi / 2 + _AT_BORDER), axis=0
        )
        return inside
    return None
