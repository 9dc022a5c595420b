"""A calibration and a trace: causes, before and after, coefficients, findings, remaining error, detection limits."""

from __future__ import annotations

import math
import re
import statistics
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

from robacc.effects import REGISTRY
from robacc.effects.request import FRAMES
from robacc.render.text.layout import (
    IN_DEGREES,
    IN_MM,
    Document,
    effect_label,
    grouped,
    measured,
    odds,
    p_value,
    table_unit,
    three_digits,
    with_table_unit,
)
from robacc.render.views.elements import (
    Block,
    Cell,
    Form,
    Grid,
    Listing,
    Number,
    ReportHeadline,
    Section,
    Text,
    Tile,
    amount,
    effect_families,
    number,
    of_robot,
    tile,
    with_unit,
)

Part = Mapping[str, Any]

_NOISE_SOURCES = {
    "file": "from the file's sigma columns",
    "file and misfit": "from the file's sigma columns and what the remaining error adds to them",
    "repeats": "from repeated poses",
}
"""Where a known measurement noise comes from; any other source is the remaining error alone."""
_STAGES = {
    "trace": {
        "nominal": "nominal, base and tool registered",
        "before": "baseline (declared effects)",
        "after": "extended model (findings)",
    },
    "calibrate": {"nominal": "nominal, base and tool registered", "before": "baseline", "after": "calibrated"},
}
SHORT_STAGES = {
    command: {"nominal": "nominal, registered", "before": "baseline", "after": after}
    for command, after in (("trace", "extended model"), ("calibrate", "calibrated"))
}
"""The same for key figures and charts."""
_POSE_SETS = (
    ("held_out", "held-out poses"),
    ("held_out_inliers", "held-out poses without outliers"),
    ("fitted", "calibration poses"),
    ("fitted_inliers", "calibration poses without outliers"),
)
_VERDICTS = {
    "clean": ("clean", "good", "nothing found beyond the declared effects"),
    "explained": ("explained", "good", "explained"),
    "partly_explained": ("partly explained", "open", "partly explained"),
    "unexplained": ("unexplained", "bad", "unexplained: the residual is structured and no candidate explains it"),
}
"""Name, tone and sentence of a verdict."""
_UNSTRUCTURED = "the remaining error has no structure"
"""The text does not say noise: the size of the noise may be unknown."""
_PARTS = {
    "noise": "noise",
    "scatter": "scatter of the joints",
    "pose": "error that depends on the pose",
    "wander": "wander over time",
}
_IN_HEADLINE = 3
_NOTABLE = 0.01
"""Least share of the error of a cause that is listed."""
_CONVINCING = 0.01
_MAX_CAUSES = 8
_MAX_HINTS = 3
_WORTH_CORRECTING = 0.9
"""Ratio of the errors after and before from which a model is not worth its use."""
_MORE = {
    "trace": "`full=True` adds candidates, tests, coefficients, errors before and after, and detection limits",
    "calibrate": "`full=True` adds coefficients, errors before and after, and the quality of the fit",
}
_MAX_CANDIDATES = 5
_MAX_PARAMETERS = 8
_INDISTINGUISHABLE = 0.9999
"""Similarity from which two effects predict the same on the poses."""
_MAX_COEFFICIENTS = 60
_MAX_NAMES = 6
_MAX_DROPPED = 3
_MAX_PAIRS = 8


# The first screen: key figures, and what the fit means in a sentence.


def trace_headline(document: Document) -> ReportHeadline:
    """Return the headline of a result of ``trace``."""
    label, tone, _ = _VERDICTS[document["verdict"]]
    declared = document["options"].get("declared") or "none"
    unexplained = document["unexplained"]
    remaining = ("Remaining error", f"{amount(unexplained['rms_m'])}, structured")
    facts = [
        ("Declared effects", declared.replace(",", ", ")),
        ("Measurement noise", _noise(document)),
        *([remaining] if unexplained["structured"] else []),
        ("Next", _next(document)),
    ]
    title = f"Trace{of_robot(document)}: {label}"
    return ReportHeadline(title, _trace_summary(document), _tiles(document), [(label, tone)], facts)


def _trace_summary(document: Document) -> str:
    is_structured = document["unexplained"]["structured"]
    start = (
        f"With the declared effects fitted, the model predicts the measured poses to {_rms(document, 'before')} rms "
        f"({_pose_set(document)[1]})."
    )
    names = [
        f"{finding['effect'].replace('_', ' ')}{' on ' * bool(finding['joints'])}{', '.join(finding['joints'])}"
        for finding in document["findings"]
    ]
    if not names:
        end = "the remaining error is structured, but no effect of the catalogue explains it"
        return f"{start} No effect was found; {end if is_structured else _UNSTRUCTURED}. {_arm_itself(document)}"
    causes = f"cause is {names[0]}" if len(names) == 1 else f"causes are {', '.join(names[:-1])} and {names[-1]}"
    end = "the remaining error has a structure that no candidate explains" if is_structured else _UNSTRUCTURED
    return (
        f"{start} The identified {causes}. With {'it' if len(names) == 1 else 'them'} added, the model predicts the "
        f"measured poses to {_rms(document, 'after')} rms; {end}. {_arm_itself(document)}"
    )


def calibrate_headline(document: Document) -> ReportHeadline:
    """Return the headline of a result of ``calibrate``."""
    summary = (
        f"With {document['options'].get('fit', '').replace(',', ', ')} fitted, the model predicts the measured poses "
        f"to {_rms(document, 'after')} rms ({_pose_set(document)[1]}); with only base and tool fitted, to "
        f"{_rms(document, 'before')}. {_arm_itself(document)}"
    )
    effects = ", ".join(effect["effect"] for effect in document["effects"])
    facts = [("Next", _next(document)), ("Fitted effects", effects), ("Measurement noise", _noise(document))]
    return ReportHeadline(f"Calibration{of_robot(document)}", summary, _tiles(document), (), facts)


def _pose_set(document: Document) -> tuple[str, str]:
    """Return the key and the name of the poses whose errors lead: held-out ones if there are any, without outliers."""
    sets = dict(_POSE_SETS)
    stages = [document[_nominal(document)], document["after"]]
    leading = ("held_out_inliers", "held_out", "fitted_inliers", "fitted")
    return next((key, sets[key]) for key in leading if all(stage.get(key) is not None for stage in stages))


def _nominal(document: Document) -> str:
    """Return the stage to compare a fit with: the nominal model, registered if the fit has a frame."""
    return (
        "nominal"
        if any(name.startswith(FRAMES) for name in document["declared"]["effects"])
        else "nominal_unregistered"
    )


def _rms(document: Document, stage: str) -> Number:
    return amount(document[stage][_pose_set(document)[0]]["position"]["rms_m"])


def _arm_itself(document: Document) -> str:
    """Return the error of the arm: a model changes no arm until it is used."""
    rms = _rms(document, "nominal")
    return (
        f"The arm itself keeps its error of {rms} rms, base and tool registered, until its controller uses the model."
    )


def _tiles(document: Document) -> list[Tile]:
    """Return the error before, with the baseline and after; without findings, the baseline is the last."""
    key, pose_set = _pose_set(document)
    is_clean, gain = document.get("findings") == [], document["gain_m"]
    errors = [
        (label, document[stage][key]["position"])
        for stage, label in [*SHORT_STAGES[document["command"]].items()][: 2 if is_clean else 3]
    ]
    tiles = [
        tile(f"{label}, rms", part["rms_m"], "m", (part.get("intervals") or {}).get("rms_m") or {}, pose_set)
        for label, part in errors
    ]
    if gain is not None and not is_clean:
        bounds = {"lower": gain["low"], "upper": gain["high"], "confidence": gain["confidence"]}
        tiles.append(tile("rms reduction", gain["value"], "m", bounds))
    return tiles


def _noise(document: Document) -> str:
    noise = document["noise"]
    source = _NOISE_SOURCES.get(noise["source"], "from the remaining error")
    return f"{amount(noise['position_m'])} along each axis, {source}"


def _next(document: Document) -> str:
    return next_step(document).replace("`robacc correct`", "robacc correct")


def _is_worth_it(document: Document) -> bool:
    """Return whether the model is better than the nominal arm by so much that it is worth its use."""
    poses, _ = _pose_set(document)
    before, after = (document[stage][poses]["position"]["rms_m"] for stage in (_nominal(document), "after"))
    return bool(after <= _WORTH_CORRECTING * before)


def next_step(document: Document, model: str | None = None) -> str:
    """Return what to do after a trace or a calibration; ``model`` is the file of the model if it was written."""
    if document.get("next_poses"):
        return "measure the poses that `full=True` lists: they distinguish a finding from its alternative"
    if not _is_worth_it(document):
        registered = " with base and tool registered" if _nominal(document) == "nominal" else ""
        return f"nothing to correct: the model is hardly better than the nominal arm{registered}"
    start = "" if model else "write the model (`write_model`), then "
    return f"{start}change the robot's targets: robacc correct TARGETS --model {model or 'MODEL'}"


# The text and the page.


def trace_view(
    document: Document, poses: str = "", robot: str = "", form: Form = "page", model: str | None = None
) -> Iterator[Section]:
    """Return the view of a trace: in short, how good, why, and what now; else all that was tested.

    ``poses`` and ``robot`` are file names, and ``model`` that of the model if it was written. A page has every cause
    and coefficient.
    """
    if form == "page":
        yield from (*trace_sections(document, None), _all_coefficients(document))
        return
    said = _VERDICTS[document["verdict"]][2]
    if document["verdict"] == "clean" and _is_worth_it(document):
        said = "declared effects explain it; nothing else found"
    title = f"Trace of {document['n_poses']} measured poses: {said}"
    yield _opening(document, "declared", title, f"{poses} against the model {robot}")
    if form == "short":
        yield from _first_screen(document, _MORE["trace"], model)
        return
    causes, *sections = trace_sections(document)
    yield causes
    yield from (replace(section, title=f"{place}. {section.title}") for place, section in enumerate(sections, 1))


def _opening(document: Document, option: str, title: str, files: str) -> Section:
    """Return the title, the files, and the effects that the parameter ``option`` names."""
    declared = document["declared"]
    what = "declared" if option == "declared" else "fitted"
    names = ", ".join(declared["effects"]) or "none"
    facts = [
        f"{what} effects: {names}{f' (default; `{option}` changes them)' if declared['by_default'] else ''}",
        *(f"{each['effect']} is not {what}: {each['why']}" for each in declared["left_out"]),
    ]
    return Section(title, [Text(files, wraps=False), *map(Text, facts)])


def _first_screen(document: Document, more: str, model: str | None) -> Iterator[Section]:
    """Yield causes, what is not distinguishable, what remains, and what to do."""
    yield Section("", causes_blocks(document, 6, short=True))
    findings, unexplained = document.get("findings", ()), document.get("unexplained")
    notes = [f"{_label(finding)}: {_alternative(rival)}" for finding in findings for rival in finding["alternatives"]]
    if unexplained is not None:
        hints = unexplained["hints"]
        notes += [f"remaining error: {_remaining(unexplained)}{_parts_of(unexplained)}", *hints[:_MAX_HINTS]]
        notes += [f"and {len(hints) - _MAX_HINTS} more hints"] * (len(hints) > _MAX_HINTS)
    yield Section("", [Listing(notes), Text(more, is_note=True), Text(f"next: {next_step(document, model)}")])


def trace_sections(document: Document, most: int | None = _MAX_CAUSES) -> Iterator[Section]:
    """Return causes, residual, candidates, findings, stages, remaining error, and what to measure next."""
    yield Section("Causes", causes_blocks(document, most))
    assumption = [Text(document["assumption"])] if document["assumption"] is not None else []
    yield Section("Residual", [Text(_residual(document)), *assumption])
    yield Section("Candidates", _candidates(document))
    yield Section("Findings", _findings(document))
    yield Section("Before and after", stage_blocks(document, "trace"))
    yield Section("Remaining error", [Listing([*_remaining_error(document)])])
    if not document["findings"]:
        yield Section("Detection limits of these poses", _detection(document))
    if document["next_poses"]:
        yield Section("Poses to measure next", _next_poses(document))


def calibration_view(
    document: Document, poses: str = "", robot: str = "", form: Form = "page", model: str | None = None
) -> Iterator[Section]:
    """Return causes, stages, coefficients and the quality of the fit; in short, how good, why, and what now.

    ``poses`` and ``robot`` are file names, and ``model`` that of the model if it was written. A page has every cause
    and coefficient.
    """
    if form != "page":
        count = document["identifiability"]["n_identifiable"]
        title = f"Calibration from {document['n_poses']} measured poses: {count} coefficients fitted"
        yield _opening(document, "fit", title, f"{poses} against the model {robot}")
    if form == "short":
        yield from _first_screen(document, _MORE["calibrate"], model)
        return
    yield Section("Causes", causes_blocks(document, None if form == "page" else _MAX_CAUSES))
    yield Section("Before and after", stage_blocks(document, "calibrate"))
    if form != "page":
        estimated, masses = without_mass_coefficients(p for p in document["parameters"] if p["std"] is not None)
        others = len(estimated) - _MAX_COEFFICIENTS
        more = Text(f"and {others} more; the JSON result has all of them" * (others > 0))
        of_masses = (Text(_mass_coefficients(*each)) for each in masses.items())
        yield Section("Coefficients", [coefficients(estimated[:_MAX_COEFFICIENTS]), more, *of_masses])
    yield Section("Quality of the fit", [Listing([*_quality(document)])])
    if form == "page":
        yield _all_coefficients(document)


def _all_coefficients(document: Document) -> Section:
    note = (
        "base_frame and tool_frame are the fitted frames; other values are corrections to the values of the robot "
        "file. Lengths are in mm, angles in degrees; the JSON result is in SI units."
    )
    blocks = [Text(note), *parameter_tables(document["parameters"])]
    return Section("Coefficients", blocks if document["parameters"] else [Text("No coefficient was fitted.")])


def parameter_tables(parameters: Sequence[Part]) -> list[Block]:
    """Return the coefficients with their standard errors, and the reasons of those that are not identifiable."""
    reasons = [(p["name"], str(p.get("why", ""))) for p in parameters if p["std"] is None]
    return [coefficients(parameters), Grid(("not identifiable", "reason"), reasons, is_text=True)]


def coefficients(parameters: Iterable[Part]) -> Grid:
    """Return name, value, standard error and unit of the identifiable coefficients."""
    rows = [
        (parameter["name"], *_with_error(parameter["value"], parameter["std"], factor), unit)
        for parameter in parameters
        if parameter["std"] is not None
        for factor, unit in [table_unit(str(parameter["unit"]))]
    ]
    return Grid(("name", "value", "standard error", "unit"), rows)


def _with_error(value: float, error: float | None, factor: float, sign: str = "") -> tuple[Number, Number]:
    """Return a value and its standard error, with the digits that the error supports."""
    if error is None:
        return Number(f"{three_digits(value * factor)}{sign}", value), Number("–", None)
    texts = measured(value * factor, error * factor)
    return Number(f"{texts[0]}{sign}", value), Number(f"{texts[1]}{sign}", error)


def _label(effect: Part) -> str:
    return effect_label(effect["effect"], effect["joints"], effect["settings"])


# Coefficients of uncertain masses: many, and only their sum is determined.

_OF_MASS = re.compile(r"(?P<effect>.+)\.(?:h[xyz]|m)\d+")
"""Coefficient of an elastic effect times a mass, or times a first moment of mass, of one link."""


def without_mass_coefficients(parameters: Iterable[Part]) -> tuple[list[Part], dict[str, int]]:
    """Return the parameters that are not of uncertain masses, and how many are, by effect and joint."""
    matches = [(each, " kg" in each["unit"] and _OF_MASS.fullmatch(each["name"])) for each in parameters]
    return [each for each, match in matches if not match], Counter(match["effect"] for _, match in matches if match)


def _mass_coefficients(effect: str, count: int) -> str:
    return (
        f"{effect}: {count} coefficients, because masses are uncertain; the poses determine their sum, not each "
        "(the JSON result has each)"
    )


# Parts of calibration and trace: causes, stages, repeatability, deflection.


def causes_blocks(document: Document, most: int | None = _MAX_CAUSES, *, short: bool = False) -> Iterator[Block]:
    """Yield what the error was and is, its largest causes, and a table of at most ``most`` causes, all if None.

    With ``short`` the table has no column of the error that no other effect can describe.
    """
    causes = document.get("causes", ())
    poses, of_poses = _pose_set(document)
    before, after = (with_unit(document[stage][poses]["position"]["rms_m"]) for stage in (_nominal(document), "after"))
    notable = [
        cause for cause in causes if cause["share"] is None or cause["share"] >= _NOTABLE or not cause["declared"]
    ]
    named = ", ".join(map(_label, notable[:_IN_HEADLINE])) or "no single cause"
    others = " and others" if len(notable) > _IN_HEADLINE else ""
    yield Text(f"{before} rms before, {after} rms after, on {of_poses}: {named}{others}")
    # Effects that were found come before declared ones where there is no room for all.
    first = sorted(notable, key=lambda cause: cause["declared"])[:most]
    shown = causes if most is None else [cause for cause in notable if cause in first]
    if not shown:
        return
    is_mixed = len({cause["declared"] for cause in causes}) > 1
    table: list[tuple[str, list[Cell]]] = [
        ("effect", [f"{_label(cause)}{' (declared)' * (cause['declared'] and is_mixed)}" for cause in shown]),
        ("coefficient", [_coefficient(document, cause) for cause in shown]),
        ("moves, mm", [number(cause["size_at_tool_m"], IN_MM) for cause in shown]),
        (
            "95 % interval",
            [" to ".join(three_digits(cause[end] * IN_MM) for end in ("low_m", "high_m")) for cause in shown],
        ),
        ("without it, mm", [number(cause["error_without_m"], IN_MM) for cause in shown]),
        ("share", ["–" if cause["share"] is None else f"{100 * cause['share']:.0f} %" for cause in shown]),
    ]
    columns = [column for column in table if not (short and column[0].startswith("without"))]
    yield Grid([head for head, _ in columns], [*zip(*(cells for _, cells in columns), strict=True)])
    if hidden := len(causes) - len(shown):
        yield Text(f"and {hidden} of a smaller share; the JSON result has all of them", is_note=True)
    without = "" if short else "without it: rms error that no other effect can describe; "
    yield Text(
        f"moves: rms distance by which the effect alone moves the tool; {without}share: part of the nominal "
        "model's mean square error that no other effect can describe, so that shares need not add up to 100 %",
        is_note=True,
    )


def _coefficient(document: Document, cause: Part) -> str:
    """Return the one coefficient of a cause; a dash if it has several."""
    names = tuple(f"{cause['effect']}.{joint}." for joint in cause["joints"])
    own = [part for part in document["parameters"] if f"{part['name']}.".startswith(names) and part["std"] is not None]
    if len(own) != 1:
        return "–"
    factor, unit = table_unit(own[0]["unit"])
    return with_table_unit(str(_with_error(own[0]["value"], own[0]["std"], factor)[0]), unit)


def stage_blocks(document: Document, command: str) -> Iterator[Block]:
    """Yield the errors of each stage, held-out poses first, and the gain with its interval."""
    stages = {key: label for key, label in _STAGES[command].items() if key != "after" or document.get("findings") != []}
    for pose_set, title in _POSE_SETS:
        figures = {label: document[key].get(pose_set) for key, label in stages.items()}
        if None in figures.values():
            continue
        for quantity, sign, unit, factor in (("position", "mm", "m", IN_MM), ("orientation", "°", "rad", IN_DEGREES)):
            keys = [f"{key}_{unit}" for key in ("rms", "mean_error", "p95", "max")]
            parts = {label: part[quantity] for label, part in figures.items() if part[quantity] is not None}
            rows: list[Sequence[Cell]] = [
                (label, *(number(part[key], factor) for key in keys)) for label, part in parts.items()
            ]
            yield Grid((f"{quantity}, {sign}, {title}", "rms", "mean", "95th pct.", "max"), rows)
    gain = document["gain_m"]
    if gain is not None and gain["low"] is not None:
        value, low, high = (three_digits(gain[key] * IN_MM) for key in ("value", "low", "high"))
        share = f"{100 * gain['confidence']:.0f} %"
        yield Text(f"rms reduction on held-out poses: {value} mm ({share} interval {low} to {high} mm)", wraps=False)
    note = "rows are of models; the arm itself keeps the error of the first row until its controller uses the model"
    yield Text(note * (command == "trace"), is_note=True)


def _repeatability(document: Document) -> Iterator[str]:
    """Yield the intrinsic repeatability joint by joint, and its limitation; nothing if it is not significant."""
    repeatability = document["repeatability"]
    if repeatability is None:
        return
    units = {joint["name"]: "m" if joint["type"] == "prismatic" else "rad" for joint in document["robot"]["joints"]}
    joints = ", ".join(
        f"{name} {with_unit(std, units[name])}" for name, std in repeatability["joints"].items() if std is not None
    )
    known = joints or "not identifiable joint by joint"
    yield f"intrinsic repeatability: {with_unit(repeatability['position_m'])} rms at the target ({known})"
    if repeatability["source"] == "residual":
        yield "without repeated visits, repeatability is not distinguishable from effects outside the catalogue"


def _deflection(choice: Part | None) -> Iterator[str]:
    """Yield the deflection model used by elastic effects and the reason for it."""
    if choice is None:
        return
    form = "equilibrium" if choice["form"] == "equilibrium" else "undeflected pose"
    text = (
        f"deflection model: {form}; torques at the undeflected pose change the prediction by "
        f"{with_unit(choice['difference_rms_m'])} rms"
    )
    if choice["rigid_better_by"] is None:
        yield f"{text}, too little to distinguish the two models"
    else:
        gain, needed = choice["rigid_better_by"], choice["needed"]
        yield f"{text} and twice the log-likelihood by {gain:+.3g}; threshold +{needed:g}"


# The quality of a calibration.


def _quality(document: Document) -> Iterator[str]:
    noise, identifiability = document["noise"], document["identifiability"]
    axes = noise["along_axes_m"]
    sizes = ", ".join(three_digits(std * IN_MM) for std in axes or [noise["position_m"]])
    source = _NOISE_SOURCES.get(noise["source"], "estimated from the residual")
    along = "each axis" if axes is None else "x, y, z"
    yield f"measurement noise {sizes} mm along {along} (standard deviation), {source}"
    if noise["lack_of_fit_p_value"] is not None:
        # With noise estimated from the residual, chi-square equals the degrees of freedom for every model.
        yield (
            f"residual {noise['residual_over_noise']:.3g} times this noise; lack-of-fit test "
            f"{p_value(noise['lack_of_fit_p_value'])}"
        )
        freedom = f"{document['degrees_of_freedom']:.1f} degrees of freedom"
        yield f"weighted chi-square {document['chi_square']:.4g} on {freedom}"
    indices = ", ".join(f"{name} {value:.3g}" for name, value in identifiability["observability"].items())
    yield f"condition number {identifiability['condition_number']:.3g}; observability indices {indices}"
    yield from _repeatability(document)
    yield from map(_shrinkage, document["shrinkage"])
    if document["shrinkage"]:
        yield "standard errors come from the poses alone, without the prior; `shrink=False` fits without it"
    yield from _deflection(document["deflection"])
    yield from _not_identifiable(identifiability["not_identifiable"])
    pairs = document["correlations"]
    yield from (
        f"correlation {pair['correlation']:+.3f} between {pair['first']} and {pair['second']}"
        for pair in pairs[:_MAX_PAIRS]
    )
    if len(pairs) > _MAX_PAIRS:
        yield f"and {len(pairs) - _MAX_PAIRS} more pairs with a correlation above 0.9"
    yield from (
        f"line {row['line']} determines {100 * row['share']:.0f} % of its own prediction (leverage)"
        for row in document["leverage"][:5]
    )


def _not_identifiable(dropped: Sequence[Part]) -> Iterator[str]:
    """Yield what the poses do not determine: a few coefficients each with its reason, many by reason."""
    if len(dropped) <= _MAX_DROPPED:
        yield from (f"not identifiable: {each['why']}" for each in dropped)
        return
    if without_effect := [each["name"] for each in dropped if not each["partners"]]:
        yield f"not identifiable: without effect on these poses: {grouped(without_effect)}"
    if confounded := [each["name"] for each in dropped if each["partners"]]:
        yield (
            f"not identifiable: not distinguishable from fitted coefficients on these poses: {grouped(confounded)} "
            "(the JSON result names the partners of each)"
        )


def _shrinkage(kind: Part) -> str:
    count, quantity = len(kind["constants"]), {"m": "lengths", "rad": "angles"}[kind["unit"]]
    differing = [constant["name"] for constant in kind["constants"] if constant["probability"] > 0.5]
    if not differing:
        return f"none of the {count} {quantity} differs significantly from nominal; all are shrunk to nominal"
    listed = ", ".join(differing[:_MAX_NAMES]) + " …" * (len(differing) > _MAX_NAMES)
    return (
        f"{len(differing)} of {count} {quantity} differ{'s' * (len(differing) == 1)} from nominal: {listed}; the "
        "others are shrunk to nominal as far as the poses allow"
    )


# A trace: residual and noise, candidates, findings with their tests, remaining error, detection limits.


def _residual(document: Document) -> str:
    from robacc.tracing.findings import HIDDEN_NOISE

    noise, repeatability = document["noise"], document["repeatability"]
    size = math.sqrt(3) * noise["position_m"]
    rms = with_unit(document["before"]["fitted"]["position"]["rms_m"])
    text = f"baseline: {rms} rms; measurement noise: "
    if noise["source"] in _NOISE_SOURCES:
        return f"{text}{with_unit(size)} rms, {_NOISE_SOURCES[noise['source']]}"
    why = "because the file has neither sigma columns nor repeated poses"
    if (
        noise["lack_of_fit_p_value"] is None
        and repeatability is not None
        and repeatability["source"] == "residual"
        and size < HIDDEN_NOISE * repeatability["position_m"]
    ):
        return f"{text}not distinguishable from the arm's repeatability (see the remaining error) {why}"
    return f"{text}{with_unit(size)} rms, estimated from the remaining error {why}"


def _candidates(document: Document) -> Iterator[Block]:
    first = next((step for step in document["candidates"] if step["ranking"]), None)
    if first is None:
        yield Text("none: no effect can be tested on these data")
        return
    best: dict[tuple[str, ...], Part] = {}
    for ranked in first["ranking"]:
        best.setdefault((ranked["effect"], *ranked["joints"]), ranked)
    rows = [
        (_label(ranked), f"{ranked['evidence']:.1f}", p_value(ranked["p_value"]))
        for ranked in [*best.values()][:_MAX_CANDIDATES]
    ]
    yield Grid(("best candidates, first step", "evidence", "significance"), rows)
    yield Text("evidence: log Bayes factor against the baseline; sorted with prior odds", is_note=True)
    untested = "; ".join(f"{each['effect']} ({each['why']})" for each in document["not_offered"])
    yield Text(f"not tested: {untested}" * bool(untested), is_note=True)


def _findings(document: Document) -> Iterator[Block]:
    findings, held_out = document["findings"], document["before"]["held_out"]
    rms = None if held_out is None else held_out["position"]["rms_m"]
    yield Text("none, at a false-alarm rate below 1 % over all candidates" * (not findings))
    for place, finding in enumerate(findings, 1):
        joints, settings = f" on {', '.join(finding['joints'])}" * bool(finding["joints"]), finding["settings"]
        if "part" in settings:
            joints = f" of the {' '.join(settings[key] for key in ('part', 'target') if key in settings)}"
        yield Text(f"{place}) {finding['effect']}{joints} {_at_tool(finding, rms)}")
        yield Listing([*_details(finding)])
        rows = [
            (
                f"{harmonic['order']:g}",
                *_with_error(harmonic["amplitude_rad"], harmonic["amplitude_std_rad"], IN_DEGREES, "°"),
                *_with_error(harmonic["phase_rad"], harmonic["phase_std_rad"], IN_DEGREES, "°"),
            )
            for harmonic in finding["harmonics"]
        ]
        yield Grid(("order per turn", "amplitude", "standard error", "phase", "standard error"), rows)
        yield Listing(finding["warnings"], "warning")
    if any(finding["harmonics"] for finding in findings):
        text = "a harmonic is amplitude × cos(order × q − phase), with q the commanded joint angle"
        yield Text(text, is_note=True)
    if findings:
        yield Text(
            "% of the residual: share of the baseline's mean square error on held-out poses that the effect removes "
            "if it is added last (shares need not add up to 100 %); ±: one standard error",
            is_note=True,
        )
    yield from map(Text, _deflection(document["deflection"]))
    if (load := document.get("undeclared_load")) is not None:
        yield Text(f"undeclared load: {load['statement']}")


def _details(finding: Part) -> Iterator[str]:
    # A result may name an effect of another package, which is not loaded here.
    if finding["effect"] in REGISTRY:
        yield REGISTRY[finding["effect"]].about.summary
    yield from filter(None, (finding.get("statement"), p_value(finding["p_value"])))
    errors = [finding["held_out_before_m"], finding["held_out_after_m"]]
    if None not in errors:
        text = "held-out poses: {} rms without it, {} rms with it".format(*map(with_unit, errors))
        turns = [finding["held_out_before_rad"], finding["held_out_after_rad"]]
        if None not in turns:
            text += "; orientation {} and {}".format(*(with_unit(turn, "rad") for turn in turns))
        yield text
    if not finding["harmonics"]:
        parameters, masses = without_mass_coefficients(finding["parameters"])
        yield from map(_parameter, parameters[:_MAX_PARAMETERS])
        if len(parameters) > _MAX_PARAMETERS:
            yield f"and {len(parameters) - _MAX_PARAMETERS} more coefficients"
        yield from (_mass_coefficients(*each) for each in masses.items())
    yield from map(_alternative, finding["alternatives"])


def _at_tool(finding: Part, baseline_rms: float | None) -> str:
    """Return what the effect does at the tool, and its share of the mean square error of the baseline."""
    keys = ("size_at_tool_m", "largest_at_tool_m", "largest_turn_at_tool_rad", "held_out_before_m", "held_out_after_m")
    rms, largest, turn, without, with_it = (finding[key] for key in keys)
    if rms is None or largest is None:
        return "cannot be evaluated alone"
    text = f"moves the tool by up to {with_unit(largest)} ({with_unit(rms)} rms)"
    if turn is not None:
        text += f" and turns it by up to {with_unit(turn, 'rad')}"
    if without is None or with_it is None or not baseline_rms:
        return text
    share = (without**2 - with_it**2) / baseline_rms**2
    return f"{text}, {f'{100 * min(share, 1.0):.0f}' if share >= 0.01 else 'less than 1'} % of the residual"


def _parameter(parameter: Part) -> str:
    factor, unit = table_unit(parameter["unit"])
    if parameter["std"] is None:
        return f"{parameter['name']}: not identifiable, {parameter['why']}"
    sizes = " ± ".join(map(str, _with_error(parameter["value"], parameter["std"], factor)))
    return f"{parameter['name']} = {with_table_unit(sizes, unit)}"


def _alternative(alternative: Part) -> str:
    text = f"not distinguishable from {_label(alternative)} on these poses"
    if alternative["similarity"] > _INDISTINGUISHABLE:
        return f"{text}: same predictions"
    return (
        f"{text}: predictions {100 * alternative['similarity']:.0f} % similar, odds of the alternative "
        f"{odds(alternative['evidence_difference'])}"
    )


def _remaining(unexplained: Part) -> str:
    """Return the size of the remaining error, and that of the measurement noise in it."""
    text = f"{with_unit(unexplained['rms_m'])} rms on the calibration poses"
    if unexplained["noise_rms_m"] is None:
        return text
    size = with_unit(unexplained["noise_rms_m"])
    is_part = unexplained["noise_rms_m"] < unexplained["rms_m"]
    return text + (f", of which {size} is measurement noise" if is_part else f"; measurement noise alone is {size}")


def _remaining_error(document: Document) -> Iterator[str]:
    unexplained = document["unexplained"]
    yield _remaining(unexplained)
    shown = p_value(unexplained["p_value"])
    if unexplained["structured"]:
        # The p-value stands where it is what shows the structure.
        yield f"structured: not noise alone{f' ({shown})' if unexplained['p_value'] < _CONVINCING else ''}"
    else:
        yield f"no structure that any candidate explains ({shown})"
    if document["explained_share"] is not None and document["findings"]:
        floor = "noise" if document["repeatability"] is None else "noise and repeatability"
        share = f"{100 * document['explained_share']:.0f} %"
        yield f"{share} of the explainable error is explained (held-out variance above {floor})"
    if parts := _parts_of(unexplained):
        yield f"its parts{parts}"
    yield from (*_repeatability(document), *unexplained["hints"])


def _parts_of(unexplained: Part) -> str:
    """Return the parts of the remaining error; empty if it is noise alone."""
    parts = unexplained.get("parts", {})
    if len(parts) < 2:
        return ""
    sizes = (f"{_PARTS[name.removesuffix('_m')]} {three_digits(size * IN_MM)}" for name, size in parts.items())
    return f", mm: {', '.join(sizes)}"


def _detection(document: Document) -> Iterator[Block]:
    """Yield the lowest and highest detection limit of each effect and the motion it causes at the target."""
    families = effect_families(document)
    rows: list[Sequence[Cell]] = []
    for family in (each for each in families if each.known):
        found, (factor, unit) = family.known, table_unit(family.known[0]["unit"])
        lowest, highest = (
            f"{each['limit'] * factor:.1e} {','.join(each['joints'])}".rstrip() for each in (found[0], found[-1])
        )
        motion = statistics.median(each["rms_m"] or 0.0 for each in found)
        rows.append((family.name, lowest, highest * (len(found) > 1), unit, number(motion, IN_MM)))
    hidden = dict.fromkeys(
        effect_label(family.name, each["joints"], {})
        for family in families
        for each in family.entries
        if each["limit"] is None
    )
    yield Grid(("detection limit", "lowest", "highest", "unit", "at the target, mm"), rows)
    yield Text("detection limit: smallest size found with probability 1/2", is_note=True)
    yield Text(f"not identifiable on these poses: {', '.join(hidden)}" * bool(hidden), is_note=True)


def _next_poses(document: Document) -> Iterator[Block]:
    joints = document["robot"]["joints"]
    units = [table_unit("m" if joint["type"] == "prismatic" else "rad") for joint in joints]
    names = [f"{joint['name']}, {unit}" for joint, (_, unit) in zip(joints, units, strict=True)]
    for advice in document["next_poses"]:
        yield Text(advice["text"])
        rows: list[Sequence[Cell]] = [
            (
                str(place),
                *(f"{value * factor:.2f}" for value, (factor, _) in zip(q, units, strict=True)),
                number(difference, IN_MM),
            )
            for place, (q, difference) in enumerate(zip(advice["q"], advice["difference_m"], strict=True), 1)
        ]
        yield Grid(("pose", *names, "difference, mm"), rows)
