"""A calibration and a trace: causes, before and after, coefficients, findings, remaining error, detection limits."""

import re
import statistics
from collections import Counter
from collections.abc import Iterable, Sequence

from robacc.effects import REGISTRY
from robacc.effects.specification import FRAMES
from robacc.fitting.levels import NEGLIGIBLE
from robacc.render.text import (
    IN_DEGREES,
    IN_MM,
    MOST_ROWS,
    QUANTITIES,
    UNBOUNDED,
    Block,
    Document,
    Form,
    Grid,
    Listing,
    ReportHeadline,
    Section,
    Text,
    amount,
    coefficients,
    counted_poses,
    effect_families,
    effect_label,
    first_of,
    grid,
    grouped,
    joint_unit,
    number,
    odds,
    of_robot,
    p_value,
    parameter_tables,
    percent,
    shown,
    statistics_cells,
    three_digits,
    tile,
    unit_of,
    with_error,
    with_unit,
)

_NOISE_SOURCES = {
    "file": "from the file",
    "file and misfit": "from the file and what the remaining error adds to it",
    "repeats": "from repeated poses",
}
"""Where a known measurement noise comes from; any other source is the remaining error alone."""
_NOMINAL = ("nominal", "nominal, base and tool registered", "nominal, registered")
_STAGES = {
    True: (
        _NOMINAL,
        ("before", "baseline (declared effects)", "baseline"),
        ("after", "extended model (findings)", "extended model"),
    ),
    False: (_NOMINAL, ("before", "baseline", "baseline"), ("after", "calibrated", "calibrated")),
}
"""Key of each stage, its name in tables, and in key figures and charts; of a trace, and of a calibration."""
_POSE_SETS = {
    "held_out": "held-out poses",
    "held_out_inliers": "held-out poses without outliers",
    "fitted": "calibration poses",
    "fitted_inliers": "calibration poses without outliers",
}
_VERDICTS = {
    "clean": ("clean", "good", "nothing found beyond the declared effects"),
    "explained": ("explained", "good", "explained"),
    "partly_explained": ("partly explained", "open", "partly explained"),
    "unexplained": ("unexplained", "bad", "unexplained: the residual is structured and no candidate explains it"),
}
"""Name, tone and sentence of a verdict."""
_PARTS = {
    "noise_m": "noise",
    "scatter_m": "scatter of the joints",
    "pose_m": "error that depends on the pose",
    "wander_m": "wander over time",
}


def fit_stages(document: Document) -> Sequence[tuple[str, str, str]]:
    """Return key, name and short name of the stages; without findings, the baseline is the last."""
    return _STAGES["findings" in document][: 2 if document.get("findings") == [] else 3]


def _pose_set(document: Document) -> str:
    """Return the key of the poses whose errors lead: held-out ones if there are any, without outliers."""
    leading = ("held_out_inliers", "held_out", "fitted_inliers", "fitted")
    return next(k for k in leading if document[_nominal(document)].get(k) and document["after"].get(k))


def _nominal(document: Document) -> str:
    """Return the stage to compare a fit with: the nominal model, registered if the fit has a frame."""
    has_frame = any(name.startswith(FRAMES) for name in document["declared"]["effects"])
    return "nominal" if has_frame else "nominal_unregistered"


def _rms(document: Document, stage: str) -> float:
    return float(document[stage][_pose_set(document)]["position"]["rms_m"])


# The first screen: key figures, and what the fit means in a sentence.


def fit_headline(document: Document) -> ReportHeadline:
    """Return the headline of a result of ``calibrate`` or ``trace``."""
    poses, options, noise = _pose_set(document), document["options"], document["noise"]
    nominal, before, after = (amount(_rms(document, stage)) for stage in ("nominal", "before", "after"))
    is_trace, source = "findings" in document, _NOISE_SOURCES.get(noise["source"], "from the remaining error")
    structured = is_trace and document["unexplained"]["structured"]
    # A model changes no arm until it is used.
    arm = (
        f"The arm itself keeps its error of {nominal} rms, base and tool registered, until its controller uses the "
        "model."
    )
    title, badges = f"Calibration{of_robot(document)}", []
    summary = (
        f"With {options.get('fit', '').replace(',', ', ')} fitted, the model predicts the measured poses to {after} "
        f"rms ({_POSE_SETS[poses]}); with only base and tool fitted, to {before}. {arm}"
    )
    if is_trace:
        label, tone, _ = _VERDICTS[document["verdict"]]
        title, badges = f"Trace{of_robot(document)}: {label}", [(label, tone)]
        summary = (
            f"With the declared effects fitted, the model predicts the measured poses to {before} rms "
            f"({_POSE_SETS[poses]}). {_found(document['findings'], structured, str(after))} {arm}"
        )
    return ReportHeadline(
        title,
        summary,
        [
            *(
                tile(f"{label}, rms", part["rms_m"], "m", bounds.get("rms_m") or UNBOUNDED, _POSE_SETS[poses])
                for stage, _, label in fit_stages(document)
                for part in [document[stage][poses]["position"]]
                for bounds in [part.get("intervals") or {}]
            ),
            *(
                tile("rms reduction", gain["value"], "m", {**gain, "lower": gain["low"], "upper": gain["high"]})
                for gain in [document["gain_m"]]
                if gain is not None and document.get("findings") != []
            ),
        ],
        badges,
        [
            ("Declared effects", (options.get("declared") or "none").replace(",", ", "))
            if is_trace
            else ("Fitted effects", ", ".join(effect["effect"] for effect in document["effects"])),
            ("Measurement noise", f"{amount(noise['position_m'])} along each axis, {source}"),
            ("Remaining error", f"{amount(document['unexplained']['rms_m'])}, structured" if structured else ""),
            ("Next", next_step(document)),
        ],
    )


def _found(findings: Sequence[Document], structured: bool, after: str) -> str:
    """Return what a trace found and what remains, in a sentence."""
    names = [
        f"{finding['effect'].replace('_', ' ')}{' on ' * bool(finding['joints'])}{', '.join(finding['joints'])}"
        for finding in findings
    ]
    if not names and structured:
        return "No effect was found; the remaining error is structured, but no effect of the catalogue explains it."
    # The text does not say noise: the size of the noise may be unknown.
    end = f"the remaining error has {'a structure that no candidate explains' if structured else 'no structure'}"
    if not names:
        return f"No effect was found; {end}."
    causes = f"cause is {names[0]}" if len(names) == 1 else f"causes are {', '.join(names[:-1])} and {names[-1]}"
    return (
        f"The identified {causes}. With {'it' if len(names) == 1 else 'them'} added, the model predicts the measured "
        f"poses to {after} rms; {end}."
    )


def _is_worth_it(document: Document) -> bool:
    """Return whether the model is better than the nominal arm by so much, a tenth, that it is worth its use."""
    return _rms(document, "after") <= 0.9 * _rms(document, _nominal(document))


def next_step(document: Document, model: str | None = None) -> str:
    """Return what to do after a trace or a calibration; ``model`` is the file of the model if it was written."""
    if document.get("next_poses"):
        return "measure the poses that `full=True` lists: they distinguish a finding from its alternative"
    if _is_worth_it(document):
        return (
            f"{'' if model else 'write the model (`write_model`), then '}change the robot's targets: robacc correct "
            f"TARGETS --model {model or 'MODEL'}; robacc predict {model or 'MODEL'} tells how accurate it is elsewhere"
        )
    registered = " with base and tool registered" * (_nominal(document) == "nominal")
    return f"nothing to correct: the model is hardly better than the nominal arm{registered}"


# The text and the page.


def fit_view(
    document: Document, poses: str = "", robot: str = "", form: Form = "page", model: str | None = None
) -> list[Section]:
    """Return the view of a calibration or a trace: in short, how good, why, and what now; else all that was tested.

    ``poses`` and ``robot`` are file names, and ``model`` that of the model if it was written. A page has every cause
    and coefficient.
    """
    is_trace, declared = "findings" in document, document["declared"]
    start = counted_poses(document["n_poses"], document["after"]["fitted"]["position"]["n_commanded_poses"])
    if is_trace:
        option, verb, said = "declared", "declared", _VERDICTS[document["verdict"]][2]
        if document["verdict"] == "clean" and _is_worth_it(document):
            said = "declared effects explain it; nothing else found"
        title = f"Trace of {start}: {said}"
        parts = [
            Section("Residual", [Text(_residual(document)), Text(document["assumption"] or "")]),
            Section("Candidates", _candidates(document)),
            Section("Findings", _findings(document)),
            Section("Before and after", _stage_blocks(document)),
            Section("Remaining error", [Listing(_remaining_error(document))]),
            Section("Detection limits of these poses", [] if document["findings"] else _detection(document)),
            Section("Poses to measure next", _next_poses(document)),
        ]
        if form != "page":
            parts = [part._replace(title=f"{place}. {part.title}") for place, part in enumerate(shown(parts), 1)]
    else:
        option, verb, count = "fit", "fitted", document["identifiability"]["n_identifiable"]
        free = document.get("n_determined") or count
        held = f", of which priors leave {free:.0f} free" * (2 * free < count)
        title = f"Calibration from {start}: {count} coefficients fitted{held}"
        estimated, masses = _without_masses(p for p in document["parameters"] if p["std"] is not None)
        others = f"and {len(estimated) - MOST_ROWS} more; the JSON result has all of them" * (
            len(estimated) > MOST_ROWS
        )
        listed: list[Block] = [coefficients(estimated[:MOST_ROWS]), Text(others), *map(Text, masses)]
        parts = [
            Section("Before and after", _stage_blocks(document)),
            Section("Coefficients", listed if form == "full" else []),
            Section("Quality of the fit", [Listing(_quality(document))]),
        ]
    default = f" (default; `{option}` changes them)" * declared["by_default"]
    opening = Section(
        title,
        [
            Text(f"{poses} against the model {robot}", wraps=False),
            Text(f"{verb} effects: {', '.join(declared['effects']) or 'none'}{default}"),
            *map(Text, _information(document["information"])),
            *(Text(f"{each['effect']} is not {verb}: {each['why']}") for each in declared["left_out"]),
        ],
    )
    if form == "short":
        more = (
            "`full=True` adds candidates, tests, coefficients, errors before and after, and detection limits"
            if is_trace
            else "`full=True` adds coefficients, errors before and after, and the quality of the fit"
        )
        ahead = f"next: {next_step(document, model)}"
        return [
            opening,
            Section("", _causes(document, 6, short=True)),
            Section("", [Listing(_doubts(document)), Text(more, is_note=True), Text(ahead)]),
        ]
    if form == "full":
        return [opening, Section("Causes", _causes(document, 8)), *parts]
    note = Text(
        "base_frame and tool_frame are the fitted frames; other values are corrections to the values of the robot "
        "file. Lengths are in mm, angles in degrees; the JSON result is in SI units."
    )
    tables: list[Block] = (
        [Text("No coefficient was fitted.")]
        if not document["parameters"]
        else [note, *parameter_tables(document["parameters"])]
    )
    return [Section("Causes", _causes(document, None)), *parts, Section("Coefficients", tables)]


def _doubts(document: Document) -> list[str]:
    """Return what is not distinguishable from a finding, and what remains."""
    unexplained: Document | None = document.get("unexplained")
    return [
        *(
            f"{_label(finding)}: {_alternative(rival)}"
            for finding in document.get("findings", ())
            for rival in finding["alternatives"]
        ),
        "" if unexplained is None else f"remaining error: {_remaining(unexplained)}{_parts_of(unexplained)}",
        *first_of((unexplained or {}).get("hints", ()), 3, "more hints"),
    ]


def _label(effect: Document) -> str:
    return effect_label(effect["effect"], effect["joints"], effect["settings"])


# Coefficients of uncertain masses: many, and only their sum is determined.


def _without_masses(parameters: Iterable[Document]) -> tuple[list[Document], list[str]]:
    """Return the parameters that are not of uncertain masses, and a text for those of each effect and joint."""
    # Of an elastic effect times a mass, or times a first moment of mass, of one link.
    of_mass = r"(?P<effect>.+)\.(?:h[xyz]|m)\d+"
    matches = [(each, " kg" in each["unit"] and re.fullmatch(of_mass, each["name"])) for each in parameters]
    return [each for each, match in matches if not match], [
        f"{effect}: {count} coefficients, because masses are not known exactly; the poses determine their sum, not "
        "each (the JSON result has each)"
        for effect, count in Counter(match["effect"] for _, match in matches if match).items()
    ]


# Parts of calibration and trace: causes, stages, repeatability.


def _causes(document: Document, most: int | None, *, short: bool = False) -> list[Block]:
    """Return what the error was and is, its largest causes, and a table of at most ``most`` causes, all if None.

    With ``short`` the table has no column of the error that no other effect can describe.
    """
    causes = document.get("causes", ())
    before, after = (with_unit(_rms(document, stage)) for stage in (_nominal(document), "after"))
    notable = [cause for cause in causes if cause["share"] is None or cause["share"] >= 0.01 or not cause["declared"]]
    named = f"{', '.join(map(_label, notable[:3])) or 'no single cause'}{' and others' * (len(notable) > 3)}"
    size = Text(f"{before} rms before, {after} rms after, on {_POSE_SETS[_pose_set(document)]}: {named}")
    # Behind the three that are named, effects that were found come before declared ones.
    first = [*notable[:3], *sorted(notable[3:], key=lambda cause: cause["declared"])][:most]
    shown = causes if most is None else [cause for cause in notable if cause in first]
    if not shown:
        return [size]
    hidden, is_mixed = len(causes) - len(shown), len({cause["declared"] for cause in causes}) > 1
    without = "" if short else "without it: rms error that no other effect can describe; "
    turned = any(cause.get("turn_at_tool_rad") is not None for cause in shown)
    return [
        size,
        grid(
            (
                "effect",
                "coefficient",
                "moves, mm",
                "95 % interval",
                "turns, °" if turned else None,
                None if short else "without it, mm",
                "share",
            ),
            [
                (
                    f"{_label(cause)}{' (declared)' * (cause['declared'] and is_mixed)}",
                    _coefficient(document, cause),
                    number(cause["size_at_tool_m"], IN_MM),
                    " to ".join(three_digits(cause[end] * IN_MM) for end in ("low_m", "high_m")),
                    number(cause["turn_at_tool_rad"], IN_DEGREES) if turned else "",
                    number(cause["error_without_m"], IN_MM),
                    # A share below one per cent has a digit, since the causes stand in this order.
                    "–"
                    if cause["share"] is None
                    else f"{100 * cause['share']:{'.0f' if cause['share'] >= 0.01 else '.1f'}} %",
                )
                for cause in shown
            ],
        ),
        Text(f"and {hidden} of a smaller share; the JSON result has all of them" * (hidden > 0), is_note=True),
        Text(
            f"moves{', turns' * turned}: rms distance {'and angle ' * turned}by which the effect alone moves the tool; "
            f"{without}share: part of the nominal "
            "model's mean square error that no other effect can describe, so that shares need not add up to 100 %",
            is_note=True,
        ),
    ]


def _coefficient(document: Document, cause: Document) -> str:
    """Return the one coefficient of a cause; a dash if it has several."""
    names = tuple(f"{cause['effect']}.{joint}." for joint in cause["joints"])
    own = [part for part in document["parameters"] if f"{part['name']}.".startswith(names) and part["std"] is not None]
    if len(own) != 1:
        return "–"
    unit = unit_of(own[0]["unit"])
    return unit.after(str(with_error(own[0]["value"], own[0]["std"], unit.factor)[0]))


def _stage_blocks(document: Document) -> list[Block]:
    """Return the errors of each stage, held-out poses first, and the gain with its interval."""
    whose = "rows are of models; the arm itself keeps the error of the first row until its controller uses the model"
    return [
        *(
            Grid(
                (f"{quantity}, {sign}, {title}", "rms", "mean", "95th pct.", "max"),
                [(label, *statistics_cells(part[quantity], unit, factor)) for label, part in parts if part[quantity]],
            )
            for pose_set, title in _POSE_SETS.items()
            for parts in [[(label, document[stage].get(pose_set)) for stage, label, _ in fit_stages(document)]]
            if all(part is not None for _, part in parts)
            for quantity, unit, sign, factor in QUANTITIES
        ),
        *(
            Text(f"rms reduction on held-out poses: {value} mm ({percent(gain['confidence'])} {ends} mm)", wraps=False)
            for gain in [document["gain_m"]]
            if gain is not None and gain["low"] is not None
            for value, *limits in [[three_digits(gain[key] * IN_MM) for key in ("value", "low", "high")]]
            for ends in [" to ".join(limits)]
        ),
        Text(whose * ("findings" in document), is_note=True),
        Text(
            "findings are chosen on all poses, held-out ones too, so that the error elsewhere may be larger; --holdout "
            "FILE measures it" * bool(document.get("findings") and document["n_folds"]),
            is_note=True,
        ),
    ]


def _repeatability(document: Document) -> list[str]:
    """Return the intrinsic repeatability joint by joint, and its limitation; nothing if it is not significant."""
    if (repeatability := document["repeatability"]) is None:
        return []
    units = {joint["name"]: joint_unit(joint) for joint in document["robot"]["joints"]}
    sizes = [f"{name} {units[name].text(std)}" for name, std in repeatability["joints"].items() if std is not None]
    return [
        f"intrinsic repeatability: {with_unit(repeatability['position_m'])} rms at the target "
        f"({', '.join(sizes) or 'not identifiable joint by joint'})",
        "without repeated visits, repeatability is not distinguishable from effects outside the catalogue"
        * (repeatability["source"] == "residual"),
    ]


# The quality of a calibration.


def _quality(document: Document) -> list[str]:
    noise, identifiability = document["noise"], document["identifiability"]
    axes, p_fit = noise["along_axes_m"], noise["lack_of_fit_p_value"]
    sizes = ", ".join(three_digits(std * IN_MM) for std in axes or [noise["position_m"]])
    indices = ", ".join(f"{name} {value:.3g}" for name, value in identifiability["observability"].items())
    pairs = [
        f"correlation {p['correlation']:+.3f} between {p['first']} and {p['second']}" for p in document["correlations"]
    ]
    # With noise estimated from the residual, chi-square equals the degrees of freedom for every model.
    return [
        f"measurement noise {sizes} mm along {'each axis' if axes is None else 'x, y, z'} (standard deviation), "
        f"{_NOISE_SOURCES.get(noise['source'], 'estimated from the residual')}",
        *(
            []
            if p_fit is None
            else [
                f"position residual {noise['residual_over_noise']:.3g} times this noise; lack-of-fit test of positions "
                f"{p_value(p_fit)}",
                f"weighted chi-square of all components {document['chi_square']:.4g} on "
                f"{document['degrees_of_freedom']:.1f} degrees of freedom",
            ]
        ),
        f"condition number {identifiability['condition_number']:.3g}; observability indices {indices}",
        *_repeatability(document),
        *map(_shrinkage, document["shrinkage"]),
        "standard errors come from the poses alone, without the prior; `shrink=False` fits without it"
        * bool(document["shrinkage"]),
        *_not_identifiable(identifiability["not_identifiable"]),
        *first_of(pairs, 8, "more pairs with a correlation above 0.9"),
        *(
            f"line {row['line']} determines {100 * row['share']:.0f} % of its own prediction (leverage)"
            for row in document["leverage"][:5]
        ),
    ]


def _information(kinds: Document) -> list[str]:
    """Return the share of the information that each kind of measurement brought, if there are several."""
    total = sum(kinds.values())
    parts = [f"{kind} {100.0 * count / total:.0f} %" for kind, count in sorted(kinds.items(), key=lambda e: -e[1])]
    return [f"information of each kind of measurement: {', '.join(parts)}"] if kinds else []


def _not_identifiable(dropped: Sequence[Document]) -> list[str]:
    """Return what the poses do not determine: a few coefficients each with its reason, many by reason."""
    listed = [f"not identifiable: {each['why']}" for each in dropped]
    return (
        listed
        if len(dropped) <= 3
        else [
            f"not identifiable: {reason}: {grouped(names)}{end}"
            for has_partners, reason, end in (
                (False, "without effect on these poses", ""),
                (
                    True,
                    "not distinguishable from fitted coefficients on these poses",
                    " (the JSON result names the partners of each)",
                ),
            )
            if (names := [each["name"] for each in dropped if bool(each["partners"]) == has_partners])
        ]
    )


def _shrinkage(kind: Document) -> str:
    count, quantity = len(kind["constants"]), {"m": "lengths", "rad": "angles"}[kind["unit"]]
    differing = [constant["name"] for constant in kind["constants"] if constant["probability"] > 0.5]
    return (
        f"none of the {count} {quantity} differs significantly from nominal; all are shrunk to nominal"
        if not differing
        else f"{len(differing)} of {count} {quantity} differ{'s' * (len(differing) == 1)} from nominal: "
        f"{', '.join(differing[:6])}{' …' * (len(differing) > 6)}; the others are shrunk to nominal as far as the "
        "poses allow"
    )


# A trace: residual and noise, candidates, findings with their tests, remaining error, detection limits.


def _residual(document: Document) -> str:
    noise, repeatability = document["noise"], document["repeatability"]
    size, source = noise["rms_m"], _NOISE_SOURCES.get(noise["source"])
    why = "because the file has neither sigma columns nor repeated poses"
    text = f"{with_unit(size)} rms, {source or f'estimated from the remaining error {why}'}"
    if (
        source is None
        and noise["lack_of_fit_p_value"] is None
        and repeatability is not None
        and repeatability["source"] == "residual"
        and size < NEGLIGIBLE * repeatability["position_m"]
    ):
        text = f"not distinguishable from the arm's repeatability (see the remaining error) {why}"
    return f"baseline: {with_unit(document['before']['fitted']['position']['rms_m'])} rms; measurement noise: {text}"


def _candidates(document: Document) -> list[Block]:
    best: dict[tuple[str, ...], Document] = {}
    for ranked in next((step["ranking"] for step in document["candidates"] if step["ranking"]), ()):
        best.setdefault((ranked["effect"], *ranked["joints"]), ranked)
    if not best:
        return [Text("none: no effect can be tested on these data")]
    untested = "; ".join(f"{each['effect']} ({each['why']})" for each in document["not_offered"])
    return [
        Grid(
            ("best candidates, first step", "evidence", "significance"),
            [
                (_label(ranked), f"{ranked['evidence']:.1f}", p_value(ranked["p_value"]))
                for ranked in [*best.values()][:5]
            ],
        ),
        Text("evidence: log Bayes factor against the baseline; sorted with prior odds", is_note=True),
        Text(f"not tested: {untested}" * bool(untested), is_note=True),
    ]


def _findings(document: Document) -> list[Block]:
    findings, rms = document["findings"], ((document["before"]["held_out"] or {}).get("position") or {}).get("rms_m")
    harmonics = "a harmonic is amplitude × cos(order × q − phase), with q the commanded joint angle"
    shares = (
        "% of the residual: share of the baseline's mean square error on held-out poses that the effect removes if it "
        "is added last (shares need not add up to 100 %); ±: one standard error"
    )
    return [
        Text("none, at a false-alarm rate below 1 % over all candidates" * (not findings)),
        *(block for place, finding in enumerate(findings, 1) for block in _finding(place, finding, rms)),
        Text(harmonics * any(finding["harmonics"] for finding in findings), is_note=True),
        Text(shares * bool(findings), is_note=True),
        Text(f"undeclared load: {load['statement']}" if (load := document.get("undeclared_load")) else ""),
    ]


def _finding(place: int, finding: Document, rms: float | None) -> list[Block]:
    """Return what a finding does at the tool, its details, its harmonics and its warnings."""
    settings, on_joints = finding["settings"], f" on {', '.join(finding['joints'])}" * bool(finding["joints"])
    of_part = f" of the {' '.join(settings[key] for key in ('part', 'target') if key in settings)}"
    errors, turns = ([finding[f"held_out_{stage}_{unit}"] for stage in ("before", "after")] for unit in ("m", "rad"))
    turn = "" if None in turns else "; orientation {} and {}".format(*(with_unit(turn, "rad") for turn in turns))
    parameters, masses = _without_masses(finding["parameters"])
    return [
        Text(f"{place}) {finding['effect']}{of_part if 'part' in settings else on_joints} {_at_tool(finding, rms)}"),
        Listing(
            [
                # A result may name an effect of another package, which is not loaded here.
                REGISTRY[finding["effect"]].about.summary if finding["effect"] in REGISTRY else "",
                finding.get("statement") or "",
                p_value(finding["p_value"])
                + " against no effect: see the odds of the alternatives" * bool(finding["alternatives"]),
                ""
                if None in errors
                else "held-out poses: {} rms without it, {} rms with it{}".format(*map(with_unit, errors), turn),
                *(
                    []
                    # Single coefficients of a profile, or of a correction's basis, say nothing.
                    if finding["harmonics"] or settings.keys() & {"shrunk", "centres"}
                    else [*first_of([*map(_parameter, parameters)], 8, "more coefficients"), *masses]
                ),
                *map(_alternative, finding["alternatives"]),
            ]
        ),
        Grid(
            ("order per turn", "amplitude", "standard error", "phase", "standard error"),
            [
                (
                    f"{harmonic['order']:g}",
                    *with_error(harmonic["amplitude_rad"], harmonic["amplitude_std_rad"], IN_DEGREES, "°"),
                    *with_error(harmonic["phase_rad"], harmonic["phase_std_rad"], IN_DEGREES, "°"),
                )
                for harmonic in finding["harmonics"]
            ],
        ),
        Listing(finding["warnings"], "warning"),
    ]


def _at_tool(finding: Document, baseline_rms: float | None) -> str:
    """Return what the effect does at the tool, and its share of the mean square error of the baseline."""
    keys = ("size_at_tool_m", "largest_at_tool_m", "largest_turn_at_tool_rad", "held_out_before_m", "held_out_after_m")
    rms, largest, turn, without, with_it = (finding[key] for key in keys)
    if rms is None or largest is None:
        return "cannot be evaluated alone"
    turned = "" if turn is None else f" and turns it by up to {with_unit(turn, 'rad')}"
    text = f"moves the tool by up to {with_unit(largest)} ({with_unit(rms)} rms){turned}"
    if without is None or with_it is None or not baseline_rms:
        return text
    share = (without**2 - with_it**2) / baseline_rms**2
    return f"{text}, {f'{100 * min(share, 1.0):.0f}' if share >= 0.01 else 'less than 1'} % of the residual"


def _parameter(parameter: Document) -> str:
    if parameter["std"] is None:
        return f"{parameter['name']}: not identifiable, {parameter['why']}"
    unit = unit_of(parameter["unit"])
    sizes = " ± ".join(map(str, with_error(parameter["value"], parameter["std"], unit.factor)))
    return f"{parameter['name']} = {unit.after(sizes)}"


def _alternative(alternative: Document) -> str:
    said = (
        "same predictions"
        if alternative["similarity"] > 0.9999
        else f"predictions {100 * alternative['similarity']:.0f} % similar, odds of the alternative "
        f"{odds(alternative['evidence_difference'])}"
    )
    return f"not distinguishable from {_label(alternative)} on these poses: {said}"


def _remaining(unexplained: Document) -> str:
    """Return the size of the remaining error, and that of the measurement noise in it."""
    rms, noise, end = unexplained["rms_m"], unexplained["noise_rms_m"], ""
    if noise is not None:
        size = with_unit(noise)
        end = f", of which {size} is measurement noise" if noise < rms else f"; measurement noise alone is {size}"
    return f"{with_unit(rms)} rms on the calibration poses{end}"


def _remaining_error(document: Document) -> list[str]:
    unexplained, explained = document["unexplained"], document["explained_share"]
    shown, parts = p_value(unexplained["p_value"]), _parts_of(unexplained)
    end = "" if document["repeatability"] is None else " and repeatability"
    return [
        _remaining(unexplained),
        # The p-value stands where it is what shows the structure.
        f"structured: not noise alone{f' ({shown})' if unexplained['p_value'] < 0.01 else ''}"
        if unexplained["structured"]
        else f"no structure that any candidate explains ({shown})",
        f"{100 * explained:.0f} % of the explainable error is explained (held-out variance above noise{end})"
        if explained is not None and document["findings"]
        else "",
        f"its parts{parts}" if parts else "",
        *_repeatability(document),
        *unexplained["hints"],
    ]


def _parts_of(unexplained: Document) -> str:
    """Return the parts of the remaining error, of those too small to be seen the name alone; empty if there is one."""
    sizes = [
        f"{_PARTS[key]} {three_digits(size * IN_MM) if size > NEGLIGIBLE * unexplained['rms_m'] else 'not seen'}"
        for key, size in unexplained.get("parts", {}).items()
    ]
    return f", mm: {', '.join(sizes)}" if len(sizes) > 1 else ""


def _detection(document: Document) -> list[Block]:
    """Return the lowest and highest detection limit of each effect and the motion it causes at the target."""
    families = effect_families(document)
    hidden = dict.fromkeys(
        effect_label(family.name, each["joints"], {})
        for family in families
        for each in family.entries
        if each["limit"] is None
    )
    return [
        Grid(
            ("detection limit", "lowest", "highest", "unit", "at the target, mm"),
            [
                (*own.cells(named=True), number(statistics.median(each["rms_m"] or 0.0 for each in own.known), IN_MM))
                for own in families
                if own.known
            ],
        ),
        Text("detection limit: smallest size found with probability 1/2", is_note=True),
        Text(f"not identifiable on these poses: {', '.join(hidden)}" * bool(hidden), is_note=True),
    ]


def _next_poses(document: Document) -> list[Block]:
    units = {joint["name"]: joint_unit(joint) for joint in document["robot"]["joints"]}
    return [
        block
        for advice in document["next_poses"]
        for rows in [zip(advice["q"], advice["difference_m"], strict=True)]
        for block in (
            Text(advice["text"]),
            Grid(
                ("pose", *(f"{name}, {unit.name}" for name, unit in units.items()), "difference, mm"),
                [
                    (
                        str(place),
                        *(f"{value * unit.factor:.2f}" for value, unit in zip(q, units.values(), strict=True)),
                        number(difference, IN_MM),
                    )
                    for place, (q, difference) in enumerate(rows, 1)
                ],
            ),
        )
    ]
