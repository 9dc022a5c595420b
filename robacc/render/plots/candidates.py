"""What competed at each step of a trace, and how strongly the poses speak for it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from robacc.render.plots.chart import ChartTable, Document, Picture
from robacc.render.plots.labels import short
from robacc.render.plots.palette import LIGHT
from robacc.render.text.numbers import p_value

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_BARS = 8
_ROWS = 40


def candidate_pictures(document: Document) -> Iterator[Picture]:
    """One a step, the best of each effect and joint, by evidence."""
    for number, step in enumerate(_told(document.get("candidates", ())), 1):
        ranked = _distinct(step["ranking"])
        if ranked:
            yield _picture(number, ranked, _name(step["ranking"][0]) if step["action"] == "add" else None)


def _told(steps: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Each addition, and the last time that nothing more was added; exchanges of one form for another are left out."""
    last = next((step for step in reversed(steps) if step["action"] == "stop"), None)
    return [step for step in steps if step["action"] == "add"] + ([] if last is None else [last])


def _distinct(ranking: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    best: dict[tuple[str, tuple[str, ...]], Mapping[str, Any]] = {}
    # Competitors are ranked by evidence and prior together; bars show the evidence alone, so they follow it.
    for one in sorted(ranking, key=lambda one: -one["evidence"]):
        best.setdefault((one["effect"], tuple(one["joints"])), one)
    return list(best.values())


def _name(one: Mapping[str, Any]) -> str:
    joints = ", ".join(one["joints"])
    return f"{one['effect']} [{joints}]" if joints else str(one["effect"])


def _picture(number: int, ranked: Sequence[Mapping[str, Any]], chosen: str | None) -> Picture:
    first = ranked[0]
    second = f"; next is {_name(ranked[1])} with {ranked[1]['evidence_nats']:.1f}" if len(ranked) > 1 else ""
    outcome = "Nothing more was added."
    if chosen is not None:
        added = "It" if chosen == _name(first) else f"{chosen}, likelier beforehand,"
        outcome = f"{added} was added to the model."
    return Picture(
        "candidates",
        f"Step {number}: what competed" if chosen is not None else "At the end: what is left to compete",
        f"Evidence of the poses for each effect that the model might lack, in nats (natural logarithm of the odds that "
        f"the data give it); the best is {_name(first)} with {first['evidence_nats']:.1f}, "
        f"{p_value(first['p_value'])}{second}. {outcome}",
        "Bars of evidence in nats: " + "; ".join(f"{_name(one)} {one['evidence_nats']:.1f}" for one in ranked[:_BARS]),
        lambda figure: _draw(figure, ranked[:_BARS], chosen),
        ChartTable(
            ("effect", "evidence, nats", "significance"),
            [[_name(one), f"{one['evidence_nats']:.1f}", p_value(one["p_value"])] for one in ranked[:_ROWS]],
            f"The best {_ROWS} of {len(ranked)}." if len(ranked) > _ROWS else "",
        ),
        (4.9, 0.9 + 0.27 * min(len(ranked), _BARS)),
    )


def _draw(figure: Figure, ranked: Sequence[Mapping[str, Any]], chosen: str | None) -> None:
    axes = figure.add_subplot()
    values = [one["evidence"] for one in ranked]
    colours = [LIGHT["after"] if _name(one) == chosen else LIGHT["nominal"] for one in ranked]
    bars = axes.barh(range(len(ranked)), values, color=colours, height=0.62)
    axes.bar_label(bars, [f"{value:.1f}" for value in values], padding=3, fontsize=8)
    axes.set_yticks(range(len(ranked)), [short(_name(one), 34) for one in ranked])
    axes.tick_params(axis="y", length=0)
    axes.grid(visible=False, axis="y")
    axes.invert_yaxis()
    axes.set_xlim(0, 1.16 * max(*values, 1e-9) if len(values) > 1 else 1.16 * max(values[0], 1e-9))
    axes.set_xlabel("evidence, nats")
