"""Detection limits as text: the smallest and the largest of each effect over its joints."""

from __future__ import annotations

import statistics
from collections.abc import Iterator, Sequence

from robacc.render.text.layout import TextLine, columns, wrapped
from robacc.render.text.numbers import three_digits
from robacc.render.text.units import IN_MM, table_unit
from robacc.tracing.detection import DetectionLimit


def draw_detection(limits: Sequence[DetectionLimit], width: int) -> Iterator[TextLine]:
    """Return a line per effect: its lowest and highest detection limit and the motion it causes at the target."""
    families: dict[str, list[DetectionLimit]] = {}
    for limit in limits:
        families.setdefault(limit.effect, []).append(limit)
    rows, undetectable = [], []
    for name, family in families.items():
        detectable = sorted(
            (limit for limit in family if limit.limit is not None), key=lambda limit: limit.limit or 0.0
        )
        undetectable += [_label(limit) for limit in family if limit.limit is None]
        if detectable:
            motion = statistics.median(limit.rms or 0.0 for limit in detectable) * IN_MM
            highest = _size(detectable[-1]) if len(detectable) > 1 else ""
            rows.append([name, _size(detectable[0]), highest, table_unit(detectable[0].unit)[1], three_digits(motion)])
    yield from columns(["detection limit", "lowest", "highest", "unit", "at the target, mm"], rows)
    yield TextLine("detection limit: smallest size found with probability 1/2", "dim")
    if undetectable:
        names = ", ".join(dict.fromkeys(undetectable))
        yield from (TextLine(line.text, "dim") for line in wrapped(f"not identifiable on these poses: {names}", width))


def _label(limit: DetectionLimit) -> str:
    return f"{limit.effect}[{','.join(limit.joints)}]" if limit.joints else limit.effect


def _size(limit: DetectionLimit) -> str:
    joints = f" {','.join(limit.joints)}" if limit.joints else ""
    return f"{(limit.limit or 0.0) * table_unit(limit.unit)[0]:.1e}{joints}"
