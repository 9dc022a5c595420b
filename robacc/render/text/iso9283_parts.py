"""The tables of an ISO 9283 evaluation by pose and by pair of poses."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from robacc.iso_9283.records import Characteristic, CriterionFigure, Iso9283Result, IsoCriterion
from robacc.render.text.layout import BLANK, TextLine, columns, heading
from robacc.render.text.numbers import decimals, fixed
from robacc.render.text.units import IN_DEGREES, IN_MM

_MAX_ROWS = 12
"""Places in a table; the JSON result has all of them."""


def measured(figure: CriterionFigure, factor: float) -> tuple[str, str]:
    """Return the value and its interval with the decimals that the interval supports."""
    if figure.value is None:
        return "–", "–"
    lower, upper = (None if end is None else end * factor for end in _ends(figure))
    places = decimals(figure.value * factor, lower, upper)
    if lower is None or upper is None:
        return fixed(figure.value * factor, places), "–"
    return fixed(figure.value * factor, places), f"{fixed(lower, places)} … {fixed(upper, places)}"


def pose_tables(result: Iso9283Result) -> Iterator[TextLine]:
    """Return the tables by pose, one for each criterion."""
    percent = f"{100 * result.confidence:g} % interval"
    multiple_files = len(result.sources) > 1
    accuracy = result.characteristic("AP")
    yield from _table(
        "Pose accuracy AP by pose, mm",
        accuracy,
        multiple_files,
        ("visits", "AP_p", percent, "x", "y", "z"),
        lambda place: (str(place.n), *measured(place.position, IN_MM), *_parts(place.axes, IN_MM)),
    )
    yield from _angles("Pose accuracy AP of orientation by pose, °", accuracy, multiple_files)
    repeatability = result.characteristic("RP")
    yield from _table(
        "Pose repeatability RP by pose, mm (not accuracy)",
        repeatability,
        multiple_files,
        ("visits", "RP_l", percent, "mean l", "S_l"),
        lambda place: (str(place.n), *measured(place.position, IN_MM), *_distances(place)),
    )
    yield from _angles(
        "Pose repeatability RP of orientation by pose, ± ° (not accuracy)", repeatability, multiple_files
    )
    for symbol, title in (
        ("vAP", "Multi-directional variation vAP by pose, mm"),
        ("E", "Exchangeability E by pose, mm"),
    ):
        yield from _table(
            title,
            next(item for item in result.characteristics if item.symbol == symbol),
            multiple_files and symbol == "vAP",
            ("visits", symbol, percent, "between"),
            lambda place: (str(place.n), *measured(place.position, IN_MM), place.between or ""),
        )


def pair_tables(result: Iso9283Result) -> Iterator[TextLine]:
    """Return the tables of the distances between poses, accuracy and repeatability separately."""
    percent = f"{100 * result.confidence:g} % interval"
    multiple_files = len(result.sources) > 1
    for symbol, title in (
        ("AD", "Distance accuracy AD by pair of poses, mm"),
        ("RD", "Distance repeatability RD by pair of poses, ± mm (not accuracy)"),
    ):
        characteristic = next(
            characteristic for characteristic in result.characteristics if characteristic.symbol == symbol
        )
        yield from _table(
            title,
            characteristic,
            multiple_files,
            ("visits", f"{symbol}_p", percent, "x", "y", "z"),
            lambda place: (str(place.n), *measured(place.position, IN_MM), *_parts(place.axes, IN_MM)),
        )


def _table(
    title: str,
    characteristic: Characteristic,
    multiple_files: bool,
    header: Sequence[str],
    cells: Callable[[IsoCriterion], Sequence[str]],
) -> Iterator[TextLine]:
    """Return one row per place, the largest first if there are too many."""
    if not characteristic.places:
        return
    places = list(characteristic.places)
    if len(places) > _MAX_ROWS:
        places = sorted(places, key=lambda place: -abs(place.position.value or 0.0))[:_MAX_ROWS]
        title += f" (the {_MAX_ROWS} largest of {len(characteristic.places)})"
    files = ["file"] if multiple_files else []
    rows = [
        ("–".join(place.poses), *([place.source or ""] if multiple_files else []), *cells(place)) for place in places
    ]
    yield from (BLANK, heading(title), *columns(("", *files, *header), rows))


def _angles(title: str, characteristic: Characteristic, multiple_files: bool) -> Iterator[TextLine]:
    """Return the table of the three angles, empty without orientations."""
    if all(place.angles is None for place in characteristic.places):
        return

    yield from _table(
        title, characteristic, multiple_files, ("a", "b", "c"), lambda place: _parts(place.angles, IN_DEGREES)
    )


def _parts(figures: Sequence[CriterionFigure] | None, factor: float) -> list[str]:
    """Return values with the decimals that the widest of their intervals supports."""
    if figures is None:
        return []
    places = min(
        decimals((figure.value or 0.0) * factor, *(end if end is None else end * factor for end in _ends(figure)))
        for figure in figures
    )
    return [fixed(None if figure.value is None else figure.value * factor, places) for figure in figures]


def _ends(figure: CriterionFigure) -> tuple[float | None, float | None]:
    return figure.interval.lower, figure.interval.upper


def _distances(place: IsoCriterion) -> list[str]:
    """Return mean and standard deviation of the distances from the barycentre with the decimals of RP."""
    ends = (None if end is None else end * IN_MM for end in _ends(place.position))
    places = decimals((place.position.value or 0.0) * IN_MM, *ends)
    return [
        fixed(None if value is None else value * IN_MM, places) for value in (place.mean_distance, place.sd_distance)
    ]
