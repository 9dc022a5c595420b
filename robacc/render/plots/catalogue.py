"""Every picture of a result, in the order that a reader wants them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from robacc.errors import UsageError
from robacc.render.plots.budget import budget_pictures
from robacc.render.plots.candidates import candidate_pictures
from robacc.render.plots.chart import Document, Picture
from robacc.render.plots.comparison import comparison_pictures
from robacc.render.plots.distribution import distributions
from robacc.render.plots.effects import effect_pictures
from robacc.render.plots.ellipsoids import ellipsoid_pictures
from robacc.render.plots.error_over_time import course_pictures
from robacc.render.plots.gate import gate_pictures
from robacc.render.plots.iso9283 import iso9283_pictures
from robacc.render.plots.workspace import workspace_pictures
from robacc.render.plots.workspace_3d import space_pictures

_FAMILIES: Sequence[Callable[[Document], Iterator[Picture]]] = (
    distributions,
    iso9283_pictures,
    comparison_pictures,
    gate_pictures,
    effect_pictures,
    candidate_pictures,
    space_pictures,
    ellipsoid_pictures,
    budget_pictures,
    course_pictures,
    workspace_pictures,
)


def pictures_of(document: Document) -> list[Picture]:
    """All pictures that the result has the numbers for."""
    return [picture for family in _FAMILIES for picture in family(document)]


def picture_of(document: Document, kind: str, number: int = 1) -> Picture:
    """The ``number``-th picture of a kind, counted from 1.

    Raises:
        UsageError: the result has none such; the message lists those it has.
    """
    every = pictures_of(document)
    mine = [picture for picture in every if picture.kind == kind]
    if 1 <= number <= len(mine):
        return mine[number - 1]
    command = document["command"]
    if mine:
        raise UsageError(f"this result of robacc {command} has {len(mine)} picture(s) {kind!r}, not {number}")
    kinds = ", ".join(dict.fromkeys(picture.kind for picture in every)) or "none at all"
    raise UsageError(f"this result of robacc {command} has no picture {kind!r}; it has {kinds}")
