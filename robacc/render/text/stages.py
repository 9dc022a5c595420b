"""What calibrate and trace both show: before and after side by side, and the form of the deflections."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from robacc.accuracy.figures import PoseMetrics
from robacc.accuracy.stages import Gain, Stage
from robacc.fitting.deflection_model import BETTER, DeflectionChoice
from robacc.render.text.layout import TextLine, columns
from robacc.render.text.numbers import three_digits

_IN_MM = 1e3
_IN_MRAD = 1e3


def stages(named: Sequence[tuple[str, Stage]]) -> Iterator[TextLine]:
    """Poses held out first, because those are what counts."""
    for kind, title in (("held_out", "poses held out"), ("fitted", "poses fitted")):
        figures = [(name, getattr(stage, kind)) for name, stage in named]
        if any(one is None for _, one in figures):
            continue
        for quantity, unit, factor in (("position", "mm", _IN_MM), ("orientation", "mrad", _IN_MRAD)):
            if getattr(figures[0][1], quantity) is not None:
                yield from _table(f"{quantity}, {unit}, {title}", quantity, factor, figures)


def gain_line(gain: Gain | None) -> Iterator[TextLine]:
    """The gain with its interval, where there is one."""
    if gain is None or gain.low != gain.low:
        return
    value, low, high = (three_digits(number * _IN_MM) for number in (gain.value, gain.low, gain.high))
    percent = f"{100 * gain.confidence:.0f} %"
    yield TextLine(f"gain on poses held out: {value} mm of rms, {percent} interval {low} to {high} mm")


def _table(title: str, quantity: str, factor: float, figures: Sequence[tuple[str, PoseMetrics]]) -> list[TextLine]:
    rows = []
    for name, stage in figures:
        one = getattr(stage, quantity)
        rows.append([name, *(three_digits(value * factor) for value in (one.rms, one.mean, one.p95, one.max))])
    return columns([title, "rms", "mean", "95 %", "max"], rows)


def deflection(found: DeflectionChoice | None) -> Iterator[str]:
    """At which pose the moments of elastic effects are taken, and why, where there are such effects."""
    if found is None:
        return
    differing = f"the prediction by {three_digits(found.difference * _IN_MM)} mm rms"
    if found.gain is None:
        yield f"deflections in equilibrium: moments at the undeflected pose change {differing}, too little to tell"
        return
    better = f"moments at the undeflected pose change {differing} and twice the log-likelihood by {found.gain:+.3g}"
    if found.form == "equilibrium":
        yield f"deflections in equilibrium: {better}, where more than +{BETTER:g} is asked for"
    else:
        yield f"deflection: rigid, as the poses show it: {better}, more than the +{BETTER:g} asked for"
