"""Before and after side by side, which calibrate and trace both show."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from robacc.figures import Gain, PoseFigures, Stage
from robacc.report.layout import Line, columns
from robacc.report.numbers import three_digits

_IN_MM = 1e3
_IN_MRAD = 1e3


def stages(named: Sequence[tuple[str, Stage]]) -> Iterator[Line]:
    """Poses held out first, because those are what counts."""
    for kind, title in (("held_out", "poses held out"), ("fitted", "poses fitted")):
        figures = [(name, getattr(stage, kind)) for name, stage in named]
        if any(one is None for _, one in figures):
            continue
        for quantity, unit, factor in (("position", "mm", _IN_MM), ("orientation", "mrad", _IN_MRAD)):
            if getattr(figures[0][1], quantity) is not None:
                yield from _table(f"{quantity}, {unit}, {title}", quantity, factor, figures)


def gain_line(gain: Gain | None) -> Iterator[Line]:
    """The gain with its interval, where there is one."""
    if gain is None or gain.low != gain.low:
        return
    value, low, high = (three_digits(number * _IN_MM) for number in (gain.value, gain.low, gain.high))
    percent = f"{100 * gain.confidence:.0f} %"
    yield Line(f"gain on poses held out: {value} mm of rms, {percent} interval {low} to {high} mm")


def _table(title: str, quantity: str, factor: float, figures: Sequence[tuple[str, PoseFigures]]) -> list[Line]:
    rows = []
    for name, stage in figures:
        one = getattr(stage, quantity)
        rows.append([name, *(three_digits(value * factor) for value in (one.rms, one.mean, one.p95, one.max))])
    return columns([title, "rms", "mean", "95 %", "max"], rows)
