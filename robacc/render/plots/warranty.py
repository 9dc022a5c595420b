"""Map of the grade that a calibrated arm holds in each part of its workspace, in space."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from robacc.render.plots.chart import Chart, ChartTable, Document, Scene3D
from robacc.render.plots.columns import Array, numbers, vectors
from robacc.render.plots.palette import LIGHT
from robacc.render.plots.space import fit_box
from robacc.render.plots.thinning import thinned, thinning_note
from robacc.render.plots.units import length_unit

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_LOOKS = (("after", "s", "square"), ("third", "o", "circle"), ("fourth", "^", "diamond"), ("before", "D", "cross"))
"""Colour, mark of the chart and mark of the view, from the best grade; the last stands for all wider grades too."""
_DRAWN = 1500
_ROWS = 60


def warranty_charts(document: Document) -> Iterator[Chart]:
    """Return the map of a prediction from the fit of a model."""
    voxels = document.get("warranty_map")
    if document["command"] != "predict" or not voxels or not voxels["grade"]:
        return
    at, grades, bound = vectors(voxels["centre_m"]), list(voxels["grade"]), numbers(voxels["bound95_m"])
    order = [*document["grade"]["share_of_poses_meeting"]]
    present = [name for name in order if name in grades]
    present += sorted(set(grades) - set(present))
    counts = {name: grades.count(name) for name in present}
    shares = ", ".join(f"{name} in {count}" for name, count in counts.items())
    unit = length_unit(float(bound.max()))
    worst = int(np.argmax(bound))
    rows = thinned(_DRAWN, bound)
    edge = f"{1e3 * voxels['voxel_m']:g} mm"
    yield Chart(
        "warranty",
        "Grade over the workspace",
        f"Grade that the 95 % bound of every configuration meets, by voxel of {edge}: {shares} of {len(at)} voxels. "
        f"The largest bound is {unit.text(float(bound[worst]))} at x {at[worst, 0]:.2f}, y {at[worst, 1]:.2f}, "
        f"z {at[worst, 2]:.2f} m. Voxels without a configuration are empty."
        f"{thinning_note(rows.size, len(at))}",
        f"Voxels of {edge} in x, y, z in m of the measuring frame, marked by grade: {shares}",
        lambda figure: _draw(figure, at[rows], [grades[i] for i in rows], present),
        _table(at, voxels, present, unit.text),
        (4.9, 4.2),
        _scene(at[rows], [grades[i] for i in rows], bound[rows], present, unit.text),
    )


def _look(number: int) -> tuple[str, str, str]:
    return _LOOKS[min(number, len(_LOOKS) - 1)]


def _draw(figure: Figure, at: Array, grades: Sequence[str], present: Sequence[str]) -> None:
    axes: Any = figure.add_subplot(projection="3d")
    named = np.array(grades)
    for number, name in enumerate(present):
        colour, mark, _ = _look(number)
        axes.plot(*at[named == name].T, mark, ms=3.2, mew=0, color=LIGHT[colour], label=f"grade {name}", alpha=0.75)
    fit_box(axes, at)
    figure.legend(loc="outside upper center", ncols=len(present))


def _scene(at: Array, grades: Sequence[str], bound: Array, present: Sequence[str], text: Any) -> Scene3D:
    named = np.array(grades)
    traces = []
    for number, name in enumerate(present):
        colour, _, symbol = _look(number)
        index = np.flatnonzero(named == name)
        columns = np.round(at[index], 4).T.tolist()
        traces.append(
            {
                "type": "scatter3d",
                "mode": "markers",
                "name": f"grade {name}",
                **dict(zip("xyz", columns, strict=True)),
                "marker": {"size": 4, "symbol": symbol, "color": f"role:{colour}"},
                "text": [f"95 % bound {text(float(bound[i]))}" for i in index],
                "hovertemplate": "%{text}<extra></extra>",
            }
        )
    return Scene3D(tuple(traces), ("x, m", "y, m", "z, m"), "Drag to rotate, scroll to zoom, point at a voxel.")


def _table(at: Array, voxels: Mapping[str, Any], present: Sequence[str], text: Any) -> ChartTable:
    """Return the voxels with the largest bounds."""
    bound = numbers(voxels["bound95_m"])
    order = np.argsort(-bound, kind="stable")[:_ROWS]
    rows = [
        [voxels["grade"][i], *(f"{value:.3f}" for value in at[i]), str(voxels["configurations"][i]), text(bound[i])]
        for i in map(int, order)
    ]
    header = ("grade", "x, m", "y, m", "z, m", "configurations", "95 % bound")
    note = f"The {len(order)} voxels with the largest bounds of {len(at)}; the JSON result has all of them."
    return ChartTable(header, rows, note if len(order) < len(at) else "Sorted by bound, the largest first.")
