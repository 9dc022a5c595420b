"""Conventions of three angles that form an orientation, and the trial of the data against each.

A name such as ``Rx`` does not say which convention it belongs to: a rotation vector on one controller, angles about
fixed axes on the next. Turns between poses depend neither on the measuring frame nor on the mounting of the target, so
they show which convention the orientations follow.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from robacc.geometry import Array, exp_so3, rotation_from_rpy

_PLACES = 400
"""Comparisons at most."""
_AGREES = np.radians(3.0)
"""rad; typical disagreement of a convention that fits: no arm turns its flange by more than it was commanded to."""
_RATIO = 5.0
"""Ratio of the typical disagreements at which the second convention is ruled out."""
_FEWEST = 4
"""Comparisons that a decision needs."""


def _axis(axis: int, angle: Array) -> Array:
    """Return the rotations ``(3, 3, N)`` about a coordinate axis."""
    vector = np.zeros((3, angle.size))
    vector[axis] = angle
    return exp_so3(vector)


def _product(*rotations: Array) -> Array:
    result = rotations[0]
    for rotation in rotations[1:]:
        result = np.einsum("ijn,jkn->ikn", result, rotation)
    return result


def _moving_xyz(angles: Array) -> Array:
    return _product(_axis(0, angles[0]), _axis(1, angles[1]), _axis(2, angles[2]))


def _kuka(angles: Array) -> Array:
    return _product(_axis(2, angles[0]), _axis(1, angles[1]), _axis(0, angles[2]))


def _zyz(angles: Array) -> Array:
    return _product(_axis(2, angles[0]), _axis(1, angles[1]), _axis(2, angles[2]))


CONVENTIONS: Mapping[str, Callable[[Array], Array]] = {
    "rotvec": exp_so3,
    "fixed-xyz": rotation_from_rpy,
    "moving-xyz": _moving_xyz,
    "zyx": rotation_from_rpy,
    "kuka-abc": _kuka,
    "zyz": _zyz,
}
"""Rotation ``(3, 3, N)`` of three angles ``(3, N)``, rad.

``rotvec``: rotation vector. ``fixed-xyz``: about the fixed axes x, then y, then z; ``zyx`` is the same rotation
described about moving axes z, y, x. ``moving-xyz``: about the moving axes x, y, z. ``kuka-abc``: A about z, B about the
moving y, C about the moving x. ``zyz``: about the moving axes z, y, z, as Kawasaki's O, A, T.
"""


@dataclass(frozen=True, slots=True)
class AngleTrial:
    """Disagreement of each convention with known orientations."""

    disagreement: Mapping[str, float]
    """rad; median difference between measured and known turn, by convention."""

    @property
    def best(self) -> str:
        """Return the convention with the smallest disagreement."""
        return min(self.disagreement, key=lambda name: self.disagreement[name])

    def rules_out(self, name: str) -> bool:
        """Return whether the best convention fits and ``name`` does not."""
        best = self.disagreement[self.best]
        return bool(best < _AGREES and self.disagreement[name] > max(_RATIO * best, _AGREES))

    @property
    def decided(self) -> bool:
        """Return whether every convention but the best is ruled out."""
        return all(name == self.best or self.rules_out(name) for name in self.disagreement)


def try_conventions(angles: Array, known: Array, conventions: Sequence[str]) -> AngleTrial | None:
    """Compare turns between poses under each convention with those of known orientations.

    The turn of R_i^T R_j R_k^T R_l depends on no frame. Two poses alone would not tell a convention from its mirror
    image, such as angles about x, y, z from angles about z, y, x.

    Args:
        angles: ``(3, N)`` rad.
        known: ``(3, 3, N)`` orientations of the same poses, in any frame and of any part of the same body.
        conventions: Names of :data:`CONVENTIONS`.

    Returns:
        The trial; None if too few poses differ.
    """
    n = angles.shape[1]
    first = np.unique(np.linspace(0, n - 1, min(n, _PLACES)).astype(int))
    steps = (0, 1, n // 3 + 1, 2 * n // 3 + 1)
    fours = np.stack([(first + step) % n for step in steps])
    turned = _turns(known, fours)
    fours, turned = fours[:, turned > 2 * _AGREES], turned[turned > 2 * _AGREES]
    if n < len(steps) or turned.size < _FEWEST:
        return None
    result = {}
    for name in conventions:
        result[name] = float(np.median(np.abs(_turns(CONVENTIONS[name](angles), fours) - turned)))
    return AngleTrial(result)


def _turns(rotation: Array, fours: Array) -> Array:
    """Return the angle of the rotation R_i^T R_j R_k^T R_l of each four poses ``(4, M)``, rad."""
    first, second, third, fourth = (rotation[..., rows] for rows in fours)
    left = np.einsum("ian,ibn->abn", first, second)
    right = np.einsum("ian,ibn->abn", third, fourth)
    trace = np.einsum("abn,ban->n", left, right)
    result: Array = np.arccos(np.clip((trace - 1) / 2, -1.0, 1.0))
    return result
