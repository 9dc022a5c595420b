"""Charts of the candidates at each step of a trace, with their evidence."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from robacc.render.plots.chart import Chart, ChartTable, Document
from robacc.render.plots.labels import short
from robacc.render.plots.palette import LIGHT
from robacc.render.text.effect_label import effect_label
from robacc.render.text.numbers import p_value

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_BARS = 8
_ROWS = 40


def candidate_charts(document: Document) -> Iterator[Chart]:
    """Return one chart per step, the best candidate of each effect and joint by evidence."""
    for number, step in enumerate(_shown_steps(document.get("candidates", ())), 1):
        ranked = _distinct(step["ranking"])
        if ranked:
            yield _chart(number, ranked, _name(step["ranking"][0]) if step["action"] == "add" else None)


def _shown_steps(steps: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    """Return the steps that add an effect and the last step that adds none, without exchanges of forms."""
    last = next((step for step in reversed(steps) if step["action"] == "stop"), None)
    return [step for step in steps if step["action"] == "add"] + ([] if last is None else [last])


def _distinct(ranking: Sequence[Mapping[str, Any]]) -> list[Mapping[str, Any]]:
    best: dict[str, Mapping[str, Any]] = {}
    # The ranking combines evidence and prior; bars show and follow the evidence alone.
    for candidate in sorted(ranking, key=lambda candidate: -candidate["evidence"]):
        best.setdefault(_name(candidate), candidate)
    return list(best.values())


def _name(candidate: Mapping[str, Any]) -> str:
    """Return the effect with its joints or the part that changes; forms of an effect have one name."""
    settings = candidate.get("settings") or {}
    part = {key: settings[key] for key in ("part", "target") if key in settings}
    return effect_label(candidate["effect"], candidate["joints"], part)


def _chart(number: int, ranked: Sequence[Mapping[str, Any]], chosen: str | None) -> Chart:
    first = ranked[0]
    runner_up = f"; next is {_name(ranked[1])} with {ranked[1]['evidence']:.1f}" if len(ranked) > 1 else ""
    outcome = "No effect was added."
    if chosen is not None:
        added = "It" if chosen == _name(first) else f"{chosen}, which has a higher prior,"
        outcome = f"{added} was added to the model."
    return Chart(
        "candidates",
        f"Step {number}: candidates" if chosen is not None else "Last step: remaining candidates",
        f"Evidence (log Bayes factor) for each candidate effect; the highest is {_name(first)} with "
        f"{first['evidence']:.1f}, {p_value(first['p_value'])}{runner_up}. {outcome}",
        "Bars of evidence (log Bayes factor): "
        + "; ".join(f"{_name(candidate)} {candidate['evidence']:.1f}" for candidate in ranked[:_BARS]),
        lambda figure: _draw(figure, ranked[:_BARS], chosen),
        ChartTable(
            ("effect", "evidence", "significance"),
            [
                [_name(candidate), f"{candidate['evidence']:.1f}", p_value(candidate["p_value"])]
                for candidate in ranked[:_ROWS]
            ],
            f"The best {_ROWS} of {len(ranked)}." if len(ranked) > _ROWS else "",
        ),
        (4.9, 0.9 + 0.27 * min(len(ranked), _BARS)),
    )


def _draw(figure: Figure, ranked: Sequence[Mapping[str, Any]], chosen: str | None) -> None:
    axes = figure.add_subplot()
    values = [candidate["evidence"] for candidate in ranked]
    colours = [LIGHT["after"] if _name(candidate) == chosen else LIGHT["nominal"] for candidate in ranked]
    bars = axes.barh(range(len(ranked)), values, color=colours, height=0.62)
    axes.bar_label(bars, [f"{value:.1f}" for value in values], padding=3, fontsize=8)
    axes.set_yticks(range(len(ranked)), [short(_name(candidate), 34) for candidate in ranked])
    axes.tick_params(axis="y", length=0)
    axes.grid(visible=False, axis="y")
    axes.invert_yaxis()
    axes.set_xlim(0, 1.16 * max(*values, 1e-9) if len(values) > 1 else 1.16 * max(values[0], 1e-9))
    axes.set_xlabel("evidence (log Bayes factor)")
