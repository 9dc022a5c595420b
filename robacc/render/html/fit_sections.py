"""What `trace` and `calibrate` say beside their pictures."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from robacc.render.html.blocks import Block, Cell, Grid, Listing, Number, ReportSection, Text, angle, length, shown
from robacc.render.plots.chart import Document
from robacc.render.plots.stage_errors import STAGE_MEANINGS
from robacc.render.plots.units import DEGREE, MICRORADIAN, Unit
from robacc.render.text.numbers import measured, odds, p_value

_STAGES = {"nominal": "as delivered", "before": "before", "after": "after"}
_LIKE = 0.9999


def fit_sections(document: Document) -> Iterator[ReportSection]:
    """In the order of the story."""
    if "findings" in document:
        yield _findings(document)
    yield _stages(document)
    if "unexplained" in document:
        yield _left(document)
    yield _parameters(document)
    if document.get("identifiability") is not None:
        yield _identifiability(document)


def _findings(document: Document) -> ReportSection:
    found = document["findings"]
    if not found:
        return ReportSection(
            "What was found", [Text("Nothing, at a false-alarm rate below 1 % over everything that competed.")]
        )
    rows: list[Sequence[Cell]] = [
        [
            effect_name(one),
            p_value(one["p_value"]),
            f"{one['stability']['folds']} of {one['stability']['of']}" if one["stability"]["of"] else "–",
            length(one["held_out_before_m"]),
            length(one["held_out_after_m"]),
        ]
        for one in found
    ]
    header = ("effect", "significance", "chosen again in folds", "rms held out without it", "with it")
    blocks: list[Block] = [Grid(header, rows)]
    rivals = [_alternative(one, other) for one in found for other in one["alternatives"]]
    if rivals:
        blocks += [Text("What might be the cause instead, on these poses:"), Listing(rivals)]
    warnings = [f"{effect_name(one)}: {text}" for one in found for text in one["warnings"]]
    if warnings:
        blocks.append(Listing(warnings, "warning"))
    lines = [(one, line) for one in found for line in one["harmonics"]]
    if lines:
        told: list[Sequence[Cell]] = [
            [
                f"{effect_name(one)}, order {line['order']:g}",
                *_with_error(line["amplitude_rad"], line["amplitude_std_rad"], MICRORADIAN),
                *_with_error(line["phase_rad"], line["phase_std_rad"], DEGREE),
            ]
            for one, line in lines
        ]
        blocks.append(Text("A periodic error is amplitude × cos(order × q − phase), q the joint's commanded angle."))
        blocks.append(Grid(("periodic error", "amplitude", "standard error", "phase", "standard error"), told))
    return ReportSection("What was found", blocks)


def effect_name(one: Mapping[str, Any]) -> str:
    """``backlash [j3]``."""
    joints = ", ".join(one["joints"])
    return f"{one['effect']} [{joints}]" if joints else str(one["effect"])


def _with_error(value: float, error: float | None, unit: Unit) -> tuple[Number, Number]:
    """An angle and its standard error."""
    if error is None:
        return shown(value, unit), Number("–", None)
    texts = measured(value * unit.factor, error * unit.factor)
    first, second = (f"{text}{'' if unit is DEGREE else ' '}{unit.name}" for text in texts)
    return Number(first, value), Number(second, error)


def _alternative(finding: Mapping[str, Any], other: Mapping[str, Any]) -> str:
    if other["similarity"] > _LIKE:
        return f"{effect_name(finding)} cannot be told from {effect_name(other)}"
    return (
        f"{effect_name(finding)}, or {effect_name(other)}: what it explains is {100 * other['similarity']:.0f} % alike, "
        f"its odds {odds(other['evidence_difference'])}"
    )


def _stages(document: Document) -> ReportSection:
    blocks: list[Block] = []
    for which, words in (("held_out", "poses held out"), ("fitted", "poses fitted")):
        stages = [(name, document[key][which]) for key, name in _STAGES.items() if document[key][which] is not None]
        if not stages:
            continue
        for part, unit, show in (("position", "m", length), ("orientation", "rad", angle)):
            if stages[0][1][part] is not None:
                rows: list[Sequence[Cell]] = [
                    [name, *(show(one[part][f"{key}_{unit}"]) for key in ("rms", "mean_error", "p95", "max"))]
                    for name, one in stages
                ]
                blocks.append(Grid((f"{part}, {words}", "rms", "mean", "95 %", "largest"), rows))
    folds = document["n_folds"]
    held = "poses of their own" if document.get("poses_apart") else f"each of {folds} folds, fitted without it"
    meaning = STAGE_MEANINGS[document["command"]]
    note = f"{meaning[0].upper()}{meaning[1:]}."
    if document["after"]["held_out"] is not None:
        note += f" Held out: {held}."
    return ReportSection("Before and after", [Text(note), *blocks])


def _left(document: Document) -> ReportSection:
    left = document["unexplained"]
    lines = [f"rms {length(left['rms_m'])} over the poses fitted"]
    if left["noise_rms_m"] is not None:
        lines[0] += f"; measuring noise alone makes {length(left['noise_rms_m'])}"
    lines.append(
        f"there is structure in it ({p_value(left['p_value'])})"
        if left["structured"]
        else f"no structure in it that anything tried would explain ({p_value(left['p_value'])})"
    )
    blocks: list[Block] = [Listing([*lines, *left["hints"]])]
    joints = [joint["name"] for joint in (document.get("robot") or {}).get("joints", ())]
    for advice in document["next_poses"]:
        blocks.append(Text(advice["text"]))
        if advice["q"]:
            rows: list[Sequence[Cell]] = [
                [str(number), *(f"{value:.3f}" for value in q), length(difference)]
                for number, (q, difference) in enumerate(zip(advice["q"], advice["difference_m"], strict=True), 1)
            ]
            blocks.append(Grid(("pose", *joints, "differ by"), rows))
    missing = [f"{one['effect']}: {one['why']}" for one in document["not_offered"]]
    if missing:
        blocks += [Text("Not offered for these data:"), Listing(missing)]
    return ReportSection("What is left", blocks)


def _parameters(document: Document) -> ReportSection:
    found = [one for one in document["parameters"] if one["std"] is not None]
    without = [[one["name"], str(one.get("why", ""))] for one in document["parameters"] if one["std"] is None]
    if not found and not without:
        return ReportSection("Parameters", [Text("No parameter was fitted.")])
    note = "Each with its standard deviation, in SI units. They are added to the robot file's own values."
    grid = Grid(("parameter", "value", "standard deviation", "unit"), [parameter_row(one) for one in found])
    blocks: list[Block] = [Text(note), grid]
    if without:
        blocks.append(Grid(("parameter without a number", "why"), without, words=True))
    return ReportSection("Parameters", blocks)


def parameter_row(one: Mapping[str, Any]) -> list[Cell]:
    """Name, value, standard error and unit of a coefficient that has them."""
    unit = "" if one["unit"] == "1" else str(one["unit"])
    value, error = measured(one["value"], one["std"])
    return [one["name"], Number(value, one["value"]), Number(error, one["std"]), unit]


def _identifiability(document: Document) -> ReportSection:
    found = document["identifiability"]
    blocks: list[Block] = [
        Text(
            f"{found['n_identifiable']} coefficients can be told from these poses; condition number "
            f"{found['condition_number']:.3g} of the scaled columns."
        )
    ]
    indices = [[name, f"{value:.3g}"] for name, value in found["observability"].items()]
    blocks.append(Grid(("observability index", "value"), indices))
    if document.get("correlations"):
        rows = [[f"{c['first']} and {c['second']}", f"{c['correlation']:+.3f}"] for c in document["correlations"]]
        blocks.append(Grid(("strongly correlated", "correlation"), rows))
    return ReportSection("What these poses can tell", blocks)


def outliers(document: Document) -> Iterable[str]:
    """Rows that were left out, as a warning."""
    lines = [str(one["line"]) for one in document.get("outliers", ())]
    if lines:
        more = f" and {len(lines) - 20} more" if len(lines) > 20 else ""
        yield f"left out as no part of the rest: line(s) {', '.join(lines[:20])}{more}"
