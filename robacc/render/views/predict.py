"""A prediction: its grade, errors and budget, the tolerances needed, and its comparison with measured poses."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from robacc.render.text.layout import IN_DEGREES, IN_MM, Document, p_value, table_unit, three_digits, with_table_unit
from robacc.render.views.elements import (
    Block,
    Cell,
    Form,
    Grid,
    Listing,
    ReportHeadline,
    Section,
    Text,
    Tile,
    amount,
    number,
    of_robot,
    percent,
    with_unit,
)

_QUANTITIES = (("position", "m", IN_MM), ("orientation", "rad", IN_DEGREES))
_STATISTICS = {
    "rms": "rms error",
    "mean_error": "mean error",
    "p95": "95 % of errors within",
    "max": "largest 95 % radius of any pose",
}
_LISTED = 12
"""Parameters of the budget in the table; the page and the JSON result have all of them."""
_BAR = 14
_UNCHANGED = 0.9995
"""Smallest factor that rounds to one with three decimals."""

Part = Mapping[str, Any]


def predict_headline(document: Document) -> ReportHeadline:
    """Return the headline of a result of ``predict``."""
    position, grade, worst = document["position"], document["grade"], document["position"]["worst"]
    source = "The tolerances give" if document["tolerances"]["parameters"] else "The fit of the model gives"
    rms, p95 = amount(position["rms_m"]), amount(position["p95_m"])
    summary = (
        f"{source} an expected position error of {rms} rms over robots and poses, 95 % of the errors within {p95}: "
        f"grade {grade['grade']}."
    )
    for first in document["budget"][:1]:
        share = f"{100 * first['share_position']:.0f} %"
        summary += f" The largest share of the variance, {share}, is from {first['parameter']}."
    facts = [
        ("Configurations", document["configurations"]),
        ("Grade", f"{grade['grade']}, expected, on the scale {grade['scale']}"),
    ]
    if document["against"] is not None:
        facts.append(("Compared with measured poses", str(document["against"]["verdict"]).replace("_", " ")))
    if (coverage := document["coverage"]) is not None:
        shares = [
            f"{name} {_percent(coverage[name]['share'])}" for name, *_ in _QUANTITIES if coverage[name] is not None
        ]
        facts.append(("Measured poses within their 95 % bound", ", ".join(shares)))
    return ReportHeadline(
        f"Predicted accuracy{of_robot(document)}",
        summary,
        [
            Tile("position, rms", rms, "over robots and poses"),
            Tile("position, 95th percentile", p95, "over robots and poses"),
            Tile("worst pose, rms", amount(worst["rms_m"]), f"at {worst['label']}"),
        ],
        [(f"grade {grade['grade']}, expected", "plain")],
        facts,
    )


def prediction_view(document: Document, source: str = "", form: Form = "page") -> Iterator[Section]:
    """Return grade, errors, worst poses and budget, then allocation and measured poses, whose file is ``source``.

    A page has a chart of the budget.
    """
    parameters = document["tolerances"]["parameters"]
    if form != "page":
        origin = f"{len(parameters)} tolerances" if parameters else "the fit of its model"
        facts = [Text(f"at {document['configurations']}", wraps=False), Text(document["tolerances"]["meaning"])]
        yield Section(f"Expected accuracy of {document['robot']['name']}, from {origin}", facts)
    grade = document["grade"]
    text = f"criterion: {_STATISTICS[grade['statistic']]}, over robots and poses"
    if grade["limited_by"]:
        text += f"; limited by {' and '.join(grade['limited_by'])}"
    shares = ", ".join(f"{name} {_percent(share)}" for name, share in grade["share_of_poses_meeting"].items())
    texts = [text, f"share of poses that meet each grade individually: {shares}"]
    yield Section(f"Grade {grade['grade']} predicted (scale: {grade['scale']})", [Listing(texts)])
    yield Section("Predicted error", _errors(document))
    yield Section("Worst pose", [Listing([_worst(document, name, unit) for name, unit, _ in _QUANTITIES])])
    if form != "page":
        title = "Error budget: share of the variance (parameters sorted by both shares)"
        yield Section(title, _budgets(document, bool(parameters)))
        for label in ("joint", "kind"):
            yield Section("", [_budget(label, "name", document[f"budget_by_{label}"])])
    if document["allocation"] is not None:
        yield _allocation(document["allocation"], grade["statistic"])
    if document["against"] is not None:
        yield from _against(document["against"], source)
    if document["coverage"] is not None:
        yield _coverage(document["coverage"])
    yield Section("Limitations", [Listing(document["notes"] if form != "page" else ())])


def _percent(share: float) -> str:
    return f"{100 * share:.1f} %"


def _errors(document: Document) -> list[Block]:
    errors = [(document[name], unit, factor) for name, unit, factor in _QUANTITIES]
    rows: list[Sequence[Cell]] = [
        [label, *(number(part[f"{key}_{unit}"], factor) for part, unit, factor in errors)]
        for label, key in (("rms", "rms"), ("mean", "mean_error"), ("95 % of errors within", "p95"))
    ]
    percentiles: list[Sequence[Cell]] = [
        [
            key.removeprefix("p"),
            *(
                number(part["percentiles_over_poses"][f"{name}_{unit}"][key], factor)
                for part, unit, factor in errors
                for name in ("rms", "radius95")
            ),
        ]
        for key in document["position"]["percentiles_over_poses"]["rms_m"]
    ]
    largest = [
        number(value, factor)
        for part, unit, factor in errors
        for value in (part["worst"][f"rms_{unit}"], part[f"max_radius95_{unit}"])
    ]
    header = ("percentile over poses", "rms, mm", "95 % within, mm", "rms, °", "95 % within, °")
    return [Grid(("over robots and poses", "mm", "°"), rows), Grid(header, [*percentiles, ["largest", *largest]])]


def _worst(document: Document, name: str, unit: str) -> str:
    worst, joints = document[name]["worst"], document["robot"]["joints"]
    direction = " ".join(f"{float(value):+.2f}" for value in worst["direction"])
    units = (table_unit("m" if joint["type"] == "prismatic" else "rad") for joint in joints)
    place = ", ".join(
        f"{joint['name']}={with_table_unit(f'{float(value) * factor:.1f}', symbol)}"
        for joint, value, (factor, symbol) in zip(joints, worst["q"], units, strict=True)
    )
    return (
        f"{name}: {worst['label']}, rms {with_unit(worst[f'rms_{unit}'], unit)}, 95 % within "
        f"{with_unit(worst[f'radius95_{unit}'], unit)}, largest along ({direction}) of the tool (standard deviation "
        f"{with_unit(worst[f'sd_{unit}'], unit)}), at {place}"
    )


def _budgets(document: Document, has_tolerances: bool) -> Iterator[Block]:
    """Yield the largest shares, and the sum of the others."""
    # Scatter that the fit did not separate and poses within its ranges have no share of their own.
    present = [part for part in document["budget"] if part["sd"] is not None or _both(part)]
    budget = sorted(present, key=lambda part: -round(_both(part), 9))
    yield _budget("parameter" if has_tolerances else "source", "parameter", budget[:_LISTED])
    if unlisted := budget[_LISTED:]:
        position, turn = (_percent(sum(part[f"share_{name}"] for part in unlisted)) for name, _, _ in _QUANTITIES)
        yield Text(f"{len(unlisted)} more parameters: {position} of position, {turn} of orientation")


def _both(part: Part) -> float:
    return float(part["share_position"] + part["share_orientation"])


def _budget(label: str, key: str, parts: Sequence[Part]) -> Grid:
    """Return shares with bars, which the largest share of the table fills."""
    # The bars share the columns that names, tolerances and percentages leave of 80.
    longest = max((len(part[key]) for part in parts), default=0)
    width = max(2, min(_BAR, (44 - longest) // 2)) if label == "parameter" else _BAR
    largest = {key: max((part[key] for part in parts), default=0.0) for key in ("share_position", "share_orientation")}
    bars = {name: [width * part[name] / (most or 1.0) for part in parts] for name, most in largest.items()}
    rows = [
        (
            part[key],
            *([with_unit(part["sd"], part["unit"])] if label == "parameter" else []),
            *(text for name in bars for text in (_percent(part[name]), ("█" * round(bars[name][i])).ljust(width))),
        )
        for i, part in enumerate(parts)
    ]
    return Grid((label, *(["1 sd"] if label == "parameter" else []), "position", "", "orientation", ""), rows)


def _allocation(allocation: Part, statistic: str) -> Section:
    title, tolerances = f"Tolerances for grade {allocation['grade']}", allocation["tolerances"]
    if all(tolerance["factor"] == 1.0 for tolerance in tolerances):
        return Section(title, [Text("the given tolerances already reach this grade")])
    rows = [
        [
            tolerance["parameter"],
            *(with_unit(tolerance[f"{which}_sd"], tolerance["unit"]) for which in ("given", "needed")),
            f"{tolerance['factor']:.3f}",
        ]
        for tolerance in sorted(tolerances, key=lambda tolerance: round(tolerance["factor"], 9))
        if tolerance["factor"] < _UNCHANGED
    ]
    key = f"{statistic}_"
    verified = ((allocation["verified"][name].get(key + unit), unit) for name, unit, _ in _QUANTITIES)
    sizes = ", ".join(str(with_unit(value, unit)) for value, unit in verified if value is not None)
    achieved = f": {_STATISTICS[statistic]} {sizes}" if sizes else ""
    text = (
        f"A new prediction with these tolerances {'meets' if allocation['met'] else 'does not meet'} the grade"
        f"{achieved}. The allocation minimises the cost, taken as 1/tolerance. With one factor for all tolerances, "
        f"this factor is {allocation['uniform_factor']:.3f}."
    )
    others = Text(f"the other {len(tolerances) - len(rows)} tolerances need no change")
    return Section(title, [Grid(("parameter", "given (1 sd)", "needed (1 sd)", "factor"), rows), others, Text(text)])


# The comparison of predicted and measured errors.

_NOISE_SOURCES = {"file": "from the file", "given": "given by the user", "fit": "that of the fit"}
_SOURCES = {"file": "from the file", "given": "given by the user", "estimated": "estimated from the poses"}


def _against(comparison: Part, source: str) -> Iterator[Section]:
    measured, noise, alignment = comparison["measured"], comparison["noise"], comparison["alignment"]
    registered = "not registered" if alignment is None else f"registered: {' and '.join(alignment['what'])} fitted"
    rows: list[Sequence[Cell]] = [
        (name, with_unit(rms, unit), with_unit(sigma, unit), _SOURCES[noise[f"source_{name}"] or "file"])
        for name, unit, _ in _QUANTITIES
        for rms, sigma in [(measured[f"{name}_rms_{unit}"], noise[f"{name}_{unit}"])]
        if rms is not None and sigma is not None
    ]
    errors = comparison["normalised_squared_error"]
    tests = [
        (
            label,
            number(errors[key]["statistic"]),
            f"{three_digits(errors[key]['lower'])} … {three_digits(errors[key]['upper'])}",
            p_value(errors[key]["p_value"]),
        )
        for label, key in (
            ("directions affected by parameters", "parameters"),
            ("other directions: measurement noise", "noise"),
            ("total", "total"),
        )
        if errors[key] is not None
    ]
    blocks: list[Block] = [
        Text(comparison["verdict"]),
        Text(f"measured, {registered}"),
        Grid(("", "rms error", "noise per axis (sd)", ""), rows),
        Grid(("normalised squared error", "measured", "expected, 95 %", ""), tests),
    ]
    if (scaled := comparison["likelihood_ratio"]) is not None:
        blocks.append(
            Text(
                "Likelihood ratio of the predicted covariance against the best scaled one (all tolerances times "
                f"{three_digits(scaled['factor'])}): {three_digits(scaled['statistic'])}, "
                f"{p_value(scaled['p_value'])}, from {scaled['draws']} simulated data sets."
            )
        )
    of_source = f" of {source}" if source else ""
    yield Section(f"Compared with {comparison['n_poses']} measured poses{of_source}", blocks)
    if comparison["variance_components"] is not None:
        yield _components(comparison["variance_components"])
    yield Section("Limits of data from one robot", [Text(comparison["one_draw"])])


def _components(components: Part) -> Section:
    rows: list[Sequence[Cell]] = []
    for component in components["components"]:
        factor, unit = table_unit(component["unit"])
        low, high = (
            "∞" if component[end] is None else three_digits(component[end] * component["predicted"] * factor)
            for end in ("lower", "upper")
        )
        estimate: Sequence[Cell] = ("–", "–", "–")
        if component["why"] is None:
            estimate = (number(component["estimate"], factor), f"{low} … {high}", number(component["factor"]))
        predicted = number(component["predicted"], factor)
        rows.append((component["name"], unit, predicted, *estimate, f"{component['dof']:.1f}"))
    header = ("kind", "", "predicted", "estimated", percent(components["confidence"]), "ratio", "dof")
    dof = "dof: effective number of independent parameter errors in the estimate"
    notes = Listing([dof, *components["notes"]])
    return Section("Variance components (one standard deviation)", [Grid(header, rows), notes])


def _coverage(coverage: Part) -> Section:
    """Return the measured poses within the bounds of a model."""
    parts = {name: coverage[name] for name, _, _ in _QUANTITIES if coverage.get(name) is not None}
    rows = [[name, f"{part['n_inside']} of {part['n_poses']}", _percent(part["share"])] for name, part in parts.items()]
    sources = " and ".join(dict.fromkeys(_NOISE_SOURCES[part["noise_source"]] for part in parts.values()))
    texts = [f"the bound contains the measurement noise, {sources}"]
    if registered := coverage["registered"]:
        texts.append(f"{' and '.join(registered)} fitted to one half of the poses for the errors of the other")
    title = f"Measured poses within the {100 * coverage['probability']:g} % bound of their error"
    return Section(title, [Grid(("", "poses", "share"), rows), Listing(texts)])
