"""What poses could have shown: the smallest and the largest detection limit of each effect over its joints."""

from __future__ import annotations

import statistics
from collections.abc import Iterator, Sequence

from robacc.render.text.layout import TextLine, columns, wrapped
from robacc.render.text.numbers import three_digits
from robacc.tracing.detection import DetectionLimit

_IN_MM = 1e3


def draw_detection(limits: Sequence[DetectionLimit], width: int) -> Iterator[TextLine]:
    """A line for each effect: the size found with even chances where it shows best and worst, and how far it moves."""
    families: dict[str, list[DetectionLimit]] = {}
    for one in limits:
        families.setdefault(one.effect, []).append(one)
    rows, hidden = [], []
    for name, forms in families.items():
        seen = sorted((one for one in forms if one.limit is not None), key=lambda one: one.limit or 0.0)
        hidden += [_where(one) for one in forms if one.limit is None]
        if seen:
            moved = statistics.median(one.rms or 0.0 for one in seen) * _IN_MM
            last = _size(seen[-1]) if len(seen) > 1 else ""
            rows.append([name, _size(seen[0]), last, seen[0].unit, three_digits(moved)])
    yield from columns(["found with even chances", "from", "to", "unit", "moves the target, mm"], rows)
    if hidden:
        names = ", ".join(dict.fromkeys(hidden))
        yield from (TextLine(one.text, "dim") for one in wrapped(f"not to be seen on these poses: {names}", width))


def _where(one: DetectionLimit) -> str:
    return f"{one.effect}[{','.join(one.joints)}]" if one.joints else one.effect


def _size(one: DetectionLimit) -> str:
    at = f" {','.join(one.joints)}" if one.joints else ""
    return f"{one.limit:.1e}{at}"
