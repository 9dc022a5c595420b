"""Charts of a plan: its poses in space, the predicted error over the number of poses, the detection limits."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from robacc.render.plots.chart import Chart, ChartTable, Document
from robacc.render.plots.columns import Array, numbers
from robacc.render.plots.palette import LIGHT
from robacc.render.plots.plan_poses import planned_poses_chart
from robacc.render.plots.units import length_unit

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def plan_charts(document: Document) -> Iterator[Chart]:
    """Return the charts of a plan."""
    yield planned_poses_chart(document)
    accuracy = document["accuracy"]
    if accuracy is not None and len(accuracy["curve"]) > 1:
        yield _accuracy_chart(accuracy)
    families = effect_families(document)
    if families:
        yield _limits_chart(families)


def _accuracy_chart(accuracy: Mapping[str, Any]) -> Chart:
    points, knee, planned = accuracy["curve"], accuracy["knee"], accuracy["planned"]
    unit = length_unit(*(point["total_rms_m"] for point in points))
    if knee is None:
        ending = "Ten more poses still reduce it by more than 10 %."
    else:
        ending = f"From {knee} poses on (the knee), ten more reduce it by less than 10 %."
    at_plan = "" if planned is None else f" The plan of {planned['n_poses']} poses has {unit.text(planned['rms_m'])}."
    return Chart(
        "expected-accuracy",
        "Predicted error over the number of poses",
        f"Predicted rms position error of the calibrated model over the task, for planned and random poses.{at_plan}"
        f" The upper line adds what no fit removes: repeatability and unexplained error. {ending}",
        f"Predicted error in {unit.name} over the number of poses, planned below random; knee at {knee or 'none'}",
        lambda figure: _draw_accuracy(figure, points, knee, planned, unit.factor, unit.name),
        ChartTable(
            ("poses", "rms", "random poses, rms", "worst", "with repeatability, rms"),
            [
                [
                    str(point["n_poses"]),
                    *(unit.text(point[key]) for key in ("rms_m", "random_rms_m", "worst_m", "total_rms_m")),
                ]
                for point in points
            ],
        ),
        (4.9, 3.0),
    )


def _draw_accuracy(
    figure: Figure,
    points: Sequence[Mapping[str, Any]],
    knee: int | None,
    planned: Mapping[str, Any] | None,
    factor: float,
    unit: str,
) -> None:
    axes = figure.add_subplot()
    n = [point["n_poses"] for point in points]
    lines = (
        ("total_rms_m", "with repeatability", "nominal", "-", "s"),
        ("random_rms_m", "random poses", "before", "--", "^"),
        ("rms_m", "planned poses", "after", "-", "o"),
    )
    for key, label, role, style, marker in lines:
        values = numbers(point[key] for point in points) * factor
        axes.plot(n, values, marker, ls=style, ms=3.4, color=LIGHT[role], label=label)
    if planned is not None:
        axes.plot(
            planned["n_poses"], planned["rms_m"] * factor, "o", ms=8, mfc="none", color=LIGHT["ink"], label="this plan"
        )
    if knee is not None:
        axes.axvline(knee, color=LIGHT["limit"], linewidth=1.1, linestyle=(0, (3, 2)), label=f"knee, {knee} poses")
    axes.set(xlabel="number of poses", ylabel=f"predicted error, {unit}", ylim=(0, None))
    figure.legend(loc="outside upper center", ncols=3, columnspacing=1.0)


@dataclass(frozen=True, slots=True)
class EffectFamily:
    """Detection limits of one effect over its joints and forms."""

    name: str
    unit: str
    usual: float
    limits: Array
    """Limits that exist, ascending; empty where no form of the effect is ever found."""
    power: float
    """Mean probability that the usual size is found."""

    @property
    def ends(self) -> tuple[float, float] | None:
        """Lowest and highest limit as multiples of the usual size."""
        return (float(self.limits[0] / self.usual), float(self.limits[-1] / self.usual)) if self.limits.size else None


def effect_families(document: Document) -> list[EffectFamily]:
    """Return the detection limits by effect, those found most surely first."""
    by_name: dict[str, list[Mapping[str, Any]]] = {}
    for limit in document["detection_limits"] or ():
        by_name.setdefault(limit["effect"], []).append(limit)
    families = [
        EffectFamily(
            name,
            entries[0]["unit"],
            entries[0]["usual_size"],
            np.sort(numbers(entry["limit"] for entry in entries if entry["limit"] is not None)),
            float(np.mean([entry["power"] for entry in entries])),
        )
        for name, entries in by_name.items()
    ]
    return sorted(families, key=lambda family: -family.power)


def _limits_chart(families: Sequence[EffectFamily]) -> Chart:
    detectable = [family for family in families if family.ends is not None]
    sure = sum(family.power >= 0.5 for family in families)
    rows = [
        [
            family.name,
            *([f"{family.limits[0]:.1e}", f"{family.limits[-1]:.1e}"] if family.ends else ["–", "–"]),
            family.unit,
            f"{family.usual:.1e}",
            f"{100 * family.power:.0f} %",
        ]
        for family in families
    ]
    return Chart(
        "detection-limits",
        "Detection limits",
        "Size of each effect that a trace of these poses finds with probability 1/2, over its usual size; a line joins "
        f"the most and the least visible joint. Left of 1, the usual size is found. {sure} of {len(families)} effects "
        "are found at their usual size with a mean probability of at least 1/2.",
        f"Ranges of detection limits over usual sizes for {len(detectable)} effects, logarithmic",
        lambda figure: _draw_limits(figure, detectable),
        ChartTable(("effect", "lowest limit", "highest", "unit", "usual size", "mean power"), rows),
        (4.9, 0.9 + 0.24 * max(len(detectable), 3)),
    )


def _draw_limits(figure: Figure, families: Sequence[EffectFamily]) -> None:
    axes = figure.add_subplot()
    for place, family in enumerate(reversed(families)):
        assert family.ends is not None
        role = "after" if family.power >= 0.5 else "before"
        axes.plot(
            family.ends, (place, place), "-o", color=LIGHT[role], ms=4, mfc=LIGHT[role] if role == "after" else "none"
        )
    axes.axvline(1.0, color=LIGHT["limit"], linewidth=1.1, linestyle=(0, (3, 2)))
    axes.set(xscale="log", xlabel="detection limit over the usual size", ylim=(-0.7, len(families) - 0.3))
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set_yticks(range(len(families)), [family.name for family in reversed(families)])
    axes.grid(axis="y", visible=False)
