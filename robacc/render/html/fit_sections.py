"""The sections of `trace` and `calibrate` reports."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from robacc.effects import REGISTRY
from robacc.render.html.blocks import Block, Cell, Grid, Listing, Number, ReportSection, Text, angle, length, quantity
from robacc.render.plots.canvas import DEGREE, Document
from robacc.render.plots.errors import STAGE_LABELS, STAGE_MEANINGS
from robacc.render.text.layout import effect_label, measured, odds, p_value, table_unit

_INDISTINGUISHABLE = 0.9999
"""Similarity from which two effects predict the same on the poses."""


def fit_sections(document: Document) -> Iterator[ReportSection]:
    """Return findings, errors before and after, remaining error, parameters and identifiability."""
    if document.get("causes"):
        yield _causes(document)
    if "findings" in document:
        yield _findings(document)
    yield _stages(document)
    if "unexplained" in document:
        yield _remaining_error(document)
    yield _parameters(document)
    if document.get("identifiability") is not None:
        yield _identifiability(document)


def _causes(document: Document) -> ReportSection:
    rows: list[Sequence[Cell]] = [
        [
            _label(cause),
            "declared" if cause["declared"] else "found",
            length(cause["size_at_tool_m"]),
            length(cause["low_m"]),
            length(cause["high_m"]),
            length(cause["error_without_m"]),
            "–" if cause["share"] is None else f"{100 * cause['share']:.1f} %",
        ]
        for cause in document["causes"]
    ]
    header = ("effect", "", "moves the tool, rms", "from", "to (95 %)", "error without it, rms", "share of the error")
    note = (
        "Error without it: what no other effect of the model can describe. Share: of the mean square error of the "
        "nominal model, registered, by that."
    )
    return ReportSection("Causes", [Grid(header, rows), Text(note)])


def _findings(document: Document) -> ReportSection:
    findings = document["findings"]
    if not findings:
        return ReportSection("Findings", [Text("None, at a false-alarm rate below 1 % over all candidates.")])
    rows: list[Sequence[Cell]] = [
        [
            _label(finding),
            "–" if finding["largest_at_tool_m"] is None else length(finding["largest_at_tool_m"]),
            p_value(finding["p_value"]),
            length(finding["held_out_before_m"]),
            length(finding["held_out_after_m"]),
        ]
        for finding in findings
    ]
    header = (
        "effect",
        "moves the tool by up to",
        "significance",
        "rms without it, held-out poses",
        "rms with it, held-out poses",
    )
    names = dict.fromkeys(str(finding["effect"]) for finding in findings)
    # A result may name an effect of another package, which is not loaded here.
    meanings = [f"{name}: {REGISTRY[name].about.summary}" for name in names if name in REGISTRY]
    blocks: list[Block] = [Grid(header, rows), *([Listing(meanings)] if meanings else [])]
    # Documents of earlier versions have neither statements nor an undeclared load.
    statements = [f"{_label(finding)}: {finding['statement']}" for finding in findings if finding.get("statement")]
    if statements:
        blocks.append(Listing(statements))
    alternatives = [
        _alternative(finding, alternative) for finding in findings for alternative in finding["alternatives"]
    ]
    if alternatives:
        blocks += [Text("Alternatives that are not distinguishable on these poses:"), Listing(alternatives)]
    warnings = [f"{_label(finding)}: {text}" for finding in findings for text in finding["warnings"]]
    if warnings:
        blocks.append(Listing(warnings, "warning"))
    harmonics = [(finding, harmonic) for finding in findings for harmonic in finding["harmonics"]]
    if harmonics:
        harmonic_rows: list[Sequence[Cell]] = [
            [
                f"{_label(finding)}, order {harmonic['order']:g}",
                *_with_error(harmonic["amplitude_rad"], harmonic["amplitude_std_rad"]),
                *_with_error(harmonic["phase_rad"], harmonic["phase_std_rad"]),
            ]
            for finding, harmonic in harmonics
        ]
        blocks.append(Text("A harmonic is amplitude × cos(order × q − phase), with q the commanded joint angle."))
        blocks.append(Grid(("harmonic", "amplitude", "standard error", "phase", "standard error"), harmonic_rows))
    load = document.get("undeclared_load")
    if load is not None:
        blocks.append(Text(f"Undeclared load: {load['statement']}."))
    return ReportSection("Findings", blocks)


def _with_error(value: float, error: float | None) -> tuple[Number, Number]:
    """Return an angle and its standard error in degrees."""
    if error is None:
        return quantity(value, DEGREE), Number("–", None)
    texts = measured(value * DEGREE.factor, error * DEGREE.factor)
    first, second = (f"{text}{DEGREE.name}" for text in texts)
    return Number(first, value), Number(second, error)


def _label(finding: Mapping[str, Any]) -> str:
    return effect_label(finding["effect"], finding["joints"], finding["settings"])


def _alternative(finding: Mapping[str, Any], alternative: Mapping[str, Any]) -> str:
    names = f"{_label(finding)} or {_label(alternative)}"
    if alternative["similarity"] > _INDISTINGUISHABLE:
        return f"{names}: same predictions"
    return (
        f"{names}: predictions {100 * alternative['similarity']:.0f} % similar, odds of the alternative "
        f"{odds(alternative['evidence_difference'])}"
    )


def _stages(document: Document) -> ReportSection:
    blocks: list[Block] = []
    labels = STAGE_LABELS[document["command"]]
    for pose_set, label in (("held_out", "held-out poses"), ("fitted", "calibration poses")):
        stages = [
            (name, document[key][pose_set]) for key, name in labels.items() if document[key][pose_set] is not None
        ]
        if not stages:
            continue
        for part, unit, show in (("position", "m", length), ("orientation", "rad", angle)):
            if stages[0][1][part] is not None:
                rows: list[Sequence[Cell]] = [
                    [name, *(show(metrics[part][f"{key}_{unit}"]) for key in ("rms", "mean_error", "p95", "max"))]
                    for name, metrics in stages
                ]
                blocks.append(Grid((f"{part}, {label}", "rms", "mean", "95th percentile", "largest"), rows))
    folds = document["n_folds"]
    held_out_note = "validation poses" if document.get("poses_apart") else f"{folds} groups of poses, each in turn"
    meaning = STAGE_MEANINGS[document["command"]]
    note = f"{meaning[0].upper()}{meaning[1:]}."
    if document["after"]["held_out"] is not None:
        note += f" Held-out poses: {held_out_note}."
    return ReportSection("Before and after", [Text(note), *blocks])


def _remaining_error(document: Document) -> ReportSection:
    unexplained = document["unexplained"]
    lines = [f"{length(unexplained['rms_m'])} rms on the calibration poses"]
    if unexplained["noise_rms_m"] is not None:
        size = length(unexplained["noise_rms_m"])
        is_part = unexplained["noise_rms_m"] < unexplained["rms_m"]
        lines[0] += f", of which {size} is measurement noise" if is_part else f"; measurement noise alone is {size}"
    lines.append(
        f"structured: not noise alone ({p_value(unexplained['p_value'])})"
        if unexplained["structured"]
        else f"no structure that any candidate explains ({p_value(unexplained['p_value'])})"
    )
    blocks: list[Block] = [Listing([*lines, *unexplained["hints"]])]
    joints = (document.get("robot") or {}).get("joints", ())
    units = [table_unit("m" if joint["type"] == "prismatic" else "rad") for joint in joints]
    names = [f"{joint['name']}, {unit}" for joint, (_, unit) in zip(joints, units, strict=True)]
    for advice in document["next_poses"]:
        blocks.append(Text(advice["text"][:1].upper() + advice["text"][1:]))
        if advice["q"]:
            rows: list[Sequence[Cell]] = [
                [
                    str(number),
                    *(f"{value * factor:.2f}" for value, (factor, _) in zip(q, units, strict=True)),
                    length(difference),
                ]
                for number, (q, difference) in enumerate(zip(advice["q"], advice["difference_m"], strict=True), 1)
            ]
            blocks.append(Grid(("pose", *names, "difference"), rows))
    missing = [f"{effect['effect']}: {effect['why']}" for effect in document["not_offered"]]
    if missing:
        blocks += [Text("Effects not tested on these data:"), Listing(missing)]
    return ReportSection("Remaining error", blocks)


def _parameters(document: Document) -> ReportSection:
    estimated = [parameter for parameter in document["parameters"] if parameter["std"] is not None]
    unidentified = [
        [parameter["name"], str(parameter.get("why", ""))]
        for parameter in document["parameters"]
        if parameter["std"] is None
    ]
    if not estimated and not unidentified:
        return ReportSection("Parameters", [Text("No parameter was fitted.")])
    note = (
        "base_frame and tool_frame are the fitted frames; other values are corrections to the values of the robot "
        "file. Lengths are in mm, angles in degrees; the JSON result is in SI units."
    )
    grid = Grid(("parameter", "value", "standard error", "unit"), [parameter_row(item) for item in estimated])
    blocks: list[Block] = [Text(note), grid]
    if unidentified:
        blocks.append(Grid(("parameter that is not identifiable", "reason"), unidentified, is_text=True))
    return ReportSection("Parameters", blocks)


def parameter_row(parameter: Mapping[str, Any]) -> list[Cell]:
    """Return name, value, standard error and unit of an identifiable coefficient."""
    factor, unit = table_unit(str(parameter["unit"]))
    value, error = measured(factor * parameter["value"], factor * parameter["std"])
    return [parameter["name"], Number(value, parameter["value"]), Number(error, parameter["std"]), unit]


def _identifiability(document: Document) -> ReportSection:
    identifiability = document["identifiability"]
    blocks: list[Block] = [
        Text(
            f"{identifiability['n_identifiable']} coefficients are identifiable on these poses; the condition number "
            f"of the scaled Jacobian is {identifiability['condition_number']:.3g}."
        )
    ]
    indices = [[name, f"{value:.3g}"] for name, value in identifiability["observability"].items()]
    blocks.append(Grid(("observability index", "value"), indices))
    if document.get("correlations"):
        rows = [[f"{c['first']} and {c['second']}", f"{c['correlation']:+.3f}"] for c in document["correlations"]]
        blocks.append(Grid(("strongly correlated", "correlation"), rows))
    return ReportSection("Identifiability", blocks)


def outliers(document: Document) -> Iterable[str]:
    """Return the warning about outliers that were excluded from the fit."""
    lines = [str(outlier["line"]) for outlier in document.get("outliers", ())]
    if lines:
        others = f" and {len(lines) - 20} more" if len(lines) > 20 else ""
        yield f"excluded as outliers: line(s) {', '.join(lines[:20])}{others}"
