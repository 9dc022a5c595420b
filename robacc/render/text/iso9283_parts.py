"""The tables of an ISO 9283 evaluation, place by place."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence

from robacc.iso_9283.records import Characteristic, CriterionFigure, Iso9283Result, IsoCriterion
from robacc.render.text.layout import BLANK, TextLine, columns, heading
from robacc.render.text.numbers import decimals, fixed

IN_MM = 1e3
IN_DEGREES = 180.0 / math.pi
_MOST_ROWS = 12
"""Places listed; the rest is in the JSON."""


def measured(figure: CriterionFigure, factor: float) -> tuple[str, str]:
    """The value and its interval, with the decimals that the interval leaves meaning to."""
    if figure.value is None:
        return "–", "–"
    lower, upper = (None if end is None else end * factor for end in _ends(figure))
    places = decimals(figure.value * factor, lower, upper)
    if lower is None or upper is None:
        return fixed(figure.value * factor, places), "–"
    return fixed(figure.value * factor, places), f"{fixed(lower, places)} … {fixed(upper, places)}"


def pose_tables(result: Iso9283Result) -> Iterator[TextLine]:
    """What is of single poses, each criterion in a table of its own."""
    percent = f"{100 * result.confidence:g} % interval"
    several = len(result.sources) > 1
    accuracy = result.characteristic("AP")
    yield from _table(
        "Pose accuracy AP by pose, mm",
        accuracy,
        several,
        ("visits", "AP_p", percent, "x", "y", "z"),
        lambda one: (str(one.n), *measured(one.position, IN_MM), *_parts(one.axes, IN_MM)),
    )
    yield from _angles("Pose accuracy AP of orientation by pose, °", accuracy, several)
    repeatability = result.characteristic("RP")
    yield from _table(
        "Pose repeatability RP by pose, mm (not accuracy)",
        repeatability,
        several,
        ("visits", "RP_l", percent, "mean l", "S_l"),
        lambda one: (str(one.n), *measured(one.position, IN_MM), *_distances(one)),
    )
    yield from _angles("Pose repeatability RP of orientation by pose, ± ° (not accuracy)", repeatability, several)
    for symbol, title in (
        ("vAP", "Multi-directional variation vAP by pose, mm"),
        ("E", "Exchangeability E by pose, mm"),
    ):
        yield from _table(
            title,
            next(one for one in result.characteristics if one.symbol == symbol),
            several and symbol == "vAP",
            ("visits", symbol, percent, "between"),
            lambda one: (str(one.n), *measured(one.position, IN_MM), one.between or ""),
        )


def pair_tables(result: Iso9283Result) -> Iterator[TextLine]:
    """Distances between poses: accuracy and repeatability each in a table of its own."""
    percent = f"{100 * result.confidence:g} % interval"
    several = len(result.sources) > 1
    for symbol, title in (
        ("AD", "Distance accuracy AD by pair of poses, mm"),
        ("RD", "Distance repeatability RD by pair of poses, ± mm (not accuracy)"),
    ):
        one = next(one for one in result.characteristics if one.symbol == symbol)
        yield from _table(
            title,
            one,
            several,
            ("visits", f"{symbol}_p", percent, "x", "y", "z"),
            lambda place: (str(place.n), *measured(place.position, IN_MM), *_parts(place.axes, IN_MM)),
        )


def _table(
    title: str,
    found: Characteristic,
    several: bool,
    header: Sequence[str],
    cells: Callable[[IsoCriterion], Sequence[str]],
) -> Iterator[TextLine]:
    """One row a place; the largest first where there are too many to list."""
    if not found.places:
        return
    places = list(found.places)
    if len(places) > _MOST_ROWS:
        places = sorted(places, key=lambda one: -abs(one.position.value or 0.0))[:_MOST_ROWS]
        title += f" (the {_MOST_ROWS} largest of {len(found.places)})"
    files = ["file"] if several else []
    rows = [("–".join(one.poses), *([one.source or ""] if several else []), *cells(one)) for one in places]
    yield from (BLANK, heading(title), *columns(("", *files, *header), rows))


def _angles(title: str, found: Characteristic, several: bool) -> Iterator[TextLine]:
    """The three angles, where there are any."""
    if all(one.angles is None for one in found.places):
        return

    yield from _table(title, found, several, ("a", "b", "c"), lambda one: _parts(one.angles, IN_DEGREES))


def _parts(figures: Sequence[CriterionFigure] | None, factor: float) -> list[str]:
    """Values with the decimals that the widest of their intervals leaves, as many for all."""
    if figures is None:
        return []
    places = min(
        decimals((one.value or 0.0) * factor, *(end if end is None else end * factor for end in _ends(one)))
        for one in figures
    )
    return [fixed(None if one.value is None else one.value * factor, places) for one in figures]


def _ends(figure: CriterionFigure) -> tuple[float | None, float | None]:
    return figure.interval.lower, figure.interval.upper


def _distances(one: IsoCriterion) -> list[str]:
    """Mean and standard deviation of the distances from the barycentre, as fine as RP."""
    ends = (None if end is None else end * IN_MM for end in _ends(one.position))
    places = decimals((one.position.value or 0.0) * IN_MM, *ends)
    return [fixed(None if value is None else value * IN_MM, places) for value in (one.mean_distance, one.sd_distance)]
