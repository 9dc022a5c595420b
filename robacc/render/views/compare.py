"""A comparison: ranking, grades, statistics and differences; and targets before and after a correction."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from robacc.comparison.stored_results import split_key
from robacc.render.text.layout import IN_MM, Document, chance, decimals, fixed, p_value, table_unit, three_digits
from robacc.render.views.elements import (
    Cell,
    Form,
    Grid,
    Listing,
    Number,
    ReportHeadline,
    Section,
    Tile,
    amount,
    number,
    percent,
)

_STATISTICS = {
    "rms": "rms",
    "mean_error": "mean",
    "p95": "95th percentile",
    "max": "maximum",
    "max_radius95": "largest 95 % radius",
    "radius95": "95 % radius, Gaussian",
    "longest_sd": "principal axis 1, std",
    **{f"mean_{axis}": f"mean {axis}" for axis in "xyz"},
    **{f"sd_{axis}": f"sd {axis}" for axis in "xyz"},
}
_STAGES = {
    "before.held_out": "baseline, held-out poses",
    "nominal.held_out": "nominal, registered",
    "after.fitted": "extended model, calibration poses",
    "before.fitted": "baseline, calibration poses",
    "nominal.fitted": "nominal, registered",
}
_VERDICTS = {"demonstrated": "confirmed", "met_not_demonstrated": "met, not confirmed", "not_met": "not met"}
_ROUNDING = 1e-12
"""m or rad; smaller values are rounding errors."""
_ISO9283 = "iso9283."
_WITHOUT_ERRORS = ("iso9283", "predict")
"""Commands whose results have no error of each pose."""
_LISTED = ("rms", "mean_error", "p95")
"""Statistics whose differences a text lists for more than two results; the page and the JSON result have all."""
_MAX_COLUMNS = 4
"""Largest number of results that stand side by side; more stand in rows."""
_MAX_NAME = 24
"""Largest number of columns for a result's name."""


def comparison_headline(document: Document) -> ReportHeadline:
    """Return the headline of a result of ``compare``."""
    names, ranking = [result["name"] for result in document["results"]], document["ranking"]
    summary, tiles = "", []
    if ranking is not None:
        summary = f"By {ranking['by']}: {'; '.join(ranking['text'])}."
        tiles = [
            Tile(entry["name"], amount(entry["value"], ranking["unit"]), f"group {entry['letters']}")
            for entry in ranking["order"][:3]
            if ranking["unit"] in ("m", "rad")
        ]
    facts = [("Results", ", ".join(names)), ("Baseline", str(document["baseline"] or "none"))]
    return ReportHeadline(f"Comparison of {len(names)} results", summary, tiles, (), facts)


def comparison_view(document: Document, form: Form = "page") -> Iterator[Section]:
    """Return ranking, grades and statistics, with the methods of the differences.

    A page has every difference, and how each result was made.
    """
    results, complete = document["results"], form == "page"
    if not complete:
        title = f"{len(results)} results compared; baseline: {_short(document['baseline'])}"
        yield Section(title, [_results(document)])
    yield _ranking(document["ranking"])
    if document["grade"] is not None:
        yield _grade(document["grade"])
    statistics = document["statistics"]
    for owner in dict.fromkeys(split_key(row["key"])[0] for row in statistics):
        if _stage(owner) is None and not owner.startswith(_ISO9283):
            rows = [row for row in statistics if split_key(row["key"])[0] == owner]
            yield _block(document, f"{owner.capitalize()} error", rows, complete)
    for title, unit in (("ISO 9283, position", "m"), ("ISO 9283, orientation", "rad")):
        if rows := [row for row in statistics if row["key"].startswith(_ISO9283) and row["unit"] == unit]:
            yield _block(document, title, rows, complete)
    for quantity in ("position", "orientation"):
        if rows := [row for row in statistics if row["key"].endswith(f".{quantity}.rms") and _stage(row["key"])]:
            yield _block(document, f"{quantity.capitalize()} rms", rows, complete)
    methods: dict[str, dict[str, None]] = {}
    for row in statistics:
        for difference in row["differences"]:
            name = _label(row["key"]) if row["key"].startswith(_ISO9283) else _statistic(row["key"])
            methods.setdefault(difference["why"] or difference["method"], {})[name] = None
    yield Section("Differences", [Listing([f"{', '.join(names)}: {text}" for text, names in methods.items()])])
    if not complete:
        yield Section("Limitations", [Listing(document["notes"])])
        return
    keys = dict.fromkeys(key for result in results for key in result["made"])
    made = Grid(
        ("", *(result["name"] for result in results)),
        [
            *((key, *(str(result["made"].get(key, "–")) for result in results)) for key in keys),
            ("SHA-256", *(result["sha256"] for result in results)),
        ],
        is_text=True,
    )
    yield Section("Compared results", [_results(document), made])


def _short(name: str) -> str:
    return name if len(name) <= _MAX_NAME else f"{name[: _MAX_NAME - 1]}…"


def _results(document: Document) -> Grid:
    paired = {match["second"]: "same poses" if match["paired"] else "different poses" for match in document["pairing"]}
    rows = []
    for result in document["results"]:
        cells = (result["name"], result["command"], result["robot"] or "–", result["n_poses"], result["grade"] or "–")
        poses = "" if result["command"] in _WITHOUT_ERRORS else paired.get(result["name"], "")
        rows.append([*(_short(str(cell)) for cell in cells), poses])
    return Grid(("result", "command", "robot", "poses", "grade", ""), rows)


def _ranking(ranking: Mapping[str, Any]) -> Section:
    key, unit = ranking["by"], ranking["unit"]
    quantity = split_key(key)[0].rpartition(".")[2]
    stage = _stage(key)
    name = _label(key) if key.startswith(_ISO9283) else f"{_statistic(key)} of the {quantity} error"
    description = name if stage is None else f"{name} ({stage})"
    pairs = {(pair["better"], pair["worse"]): pair for pair in ranking["pairs"]}
    names = [entry["name"] for entry in ranking["order"]]
    rows = []
    for entry, following in zip(ranking["order"], [*names[1:], ""], strict=True):
        cells: list[Cell] = [_short(entry["name"]), _amount(entry["value"], unit), entry["letters"], "", ""]
        if (pair := pairs.get((entry["name"], following))) is not None:
            cells[3:] = _difference(pair["difference"], unit)[0], p_value(pair["p_corrected"])
        rows.append(cells)
    is_grouped = any(entry["letters"] for entry in ranking["order"])
    header = ("", "", "group" if is_grouped else "", "difference to the next", "p, corrected for pairs")
    title = f"Ranking by {description}, {table_unit(unit)[1]}"
    return Section(title, [Grid(header, rows), Listing(ranking["text"])])


def _grade(grade: Mapping[str, Any]) -> Section:
    results, quantities = grade["results"], (("position", "m"), ("orientation", "rad"))
    rows = [
        (
            _short(each["name"]),
            _VERDICTS[each["verdict"]],
            each["grade"],
            "–" if each["probability"] is None else chance(each["probability"]),
            *(_bounded(each, quantity, unit) for quantity, unit in quantities),
        )
        for each in results
    ]
    reasons = [f"{each['name']}: {each['why']}" for each in results if each["why"]]
    later = [
        f"{each['name']}: if the estimate does not change, {each['poses_to_demonstrate']} poses in total would "
        "probably confirm it"
        for each in results
        if each["poses_to_demonstrate"] is not None
    ]
    header = ("", "", "grade", "probability", "position (bound), mm", "orientation (bound), °")
    return Section(f"Grade {grade['wanted']} (scale: {grade['scale']})", [Grid(header, rows), Listing(reasons + later)])


def _bounded(status: Mapping[str, Any], quantity: str, unit: str) -> str:
    value, bound = status[f"{quantity}_{unit}"], status[f"{quantity}_upper_bound_{unit}"]
    return f"{_amount(value, unit)}{'' if bound is None else f' ({_amount(bound, unit)})'}"


def _block(document: Document, title: str, rows: Sequence[Mapping[str, Any]], complete: bool) -> Section:
    """Return the tables of related statistics; few results stand in columns, many in rows."""
    unit = rows[0]["unit"]
    names = [_short(result["name"]) for result in document["results"]]
    title = f"{title}, {table_unit(unit)[1]}"
    interval_head = percent(document["confidence"])
    labels = [_stage(row["key"]) or _label(row["key"]) for row in rows]
    if len(names) == 2:
        table: list[Sequence[Cell]] = [
            [label, *_figures(row), *_difference(row["differences"][0], unit)]
            for label, row in zip(labels, rows, strict=True)
        ]
        return Section(title, [Grid(("", *names, "difference", interval_head, ""), table)])
    statistics = [split_key(row["key"])[1] for row in rows]
    listed = [i for i, name in enumerate(statistics) if complete or name in _LISTED] or [*range(len(rows))]
    if len(names) <= _MAX_COLUMNS:
        figures = Grid(("", *names), [[label, *_figures(row)] for label, row in zip(labels, rows, strict=True)])
    else:
        shown = [i for i, name in enumerate(statistics) if complete or name in (*_LISTED, "max")]
        shown = shown or [*range(len(rows))][:4]
        by_result = zip(names, *(_figures(rows[i]) for i in shown), strict=True)
        figures = Grid(("", *(labels[i] for i in shown)), [*by_result])
        listed = listed if complete else shown[:1]
    differences: list[Sequence[Cell]] = [
        [f"{labels[i]}, {_short(difference['name'])}", *_difference(difference, unit)]
        for i in listed
        for difference in rows[i]["differences"]
    ]
    head = f"difference from {_short(document['baseline'])}"
    return Section(title, [figures, Grid((head, "difference", interval_head, ""), differences)])


def _figures(row: Mapping[str, Any]) -> list[Number]:
    return [_amount(figure["value"], row["unit"]) for figure in row["values"]]


def _stage(key: str) -> str | None:
    """Return the label of a fit's stage, None for its main statistics."""
    return next((label for stage, label in _STAGES.items() if key.startswith(f"{stage}.")), None)


def _statistic(key: str) -> str:
    name = split_key(key)[1]
    return _STATISTICS.get(name, name)


def _label(key: str) -> str:
    """Return the name of a statistic, or of a criterion such as ``AP`` or ``drift of AP``."""
    if not key.startswith(_ISO9283):
        return _statistic(key)
    symbol = key.removeprefix(_ISO9283).removesuffix(".max").removesuffix(".orientation")
    kind, _, base = symbol.partition(".")
    return f"{kind} of {base}" if base else kind


def _amount(value: float | None, unit: str) -> Number:
    return Number("0", value) if value is not None and abs(value) < _ROUNDING else number(value, table_unit(unit)[0])


def _difference(difference: Mapping[str, Any], unit: str) -> tuple[Number, str, str]:
    """Return a difference, its interval and its p-value, with signs and the digits that the interval supports."""
    value, ends = difference["value"], [difference["lower"], difference["upper"]]
    factor = table_unit(unit)[0]
    known = [end * factor for end in ends if end is not None]
    places = decimals(value * factor, *(known if len(known) == 2 else (None, None)))
    texts = []
    for size in (value * factor, *known):
        text = "0" if abs(size) < _ROUNDING * factor else fixed(size, places)
        texts.append(text if text.startswith("-") or float(text) == 0.0 else f"+{text}")
    return Number(texts[0], value), " … ".join(texts[1:]) if len(known) == 2 else "–", p_value(difference["p_value"])


# Targets before and after a correction.

_LOADED = {
    "loaded": "the correction was loaded",
    "partly_loaded": "only a part of the correction was loaded",
    "not_loaded": "no sign that the correction was loaded",
    "undecided": "the measurements do not decide whether the correction was loaded",
}


def paired_view(document: Document, names: tuple[str, str]) -> Iterator[Section]:
    """Return the text of the comparison of the files ``names``."""
    yield Section(f"{document['n_targets']} targets before ({names[0]}) and after ({names[1]}) a correction", [])
    rows = [
        [stage, *(number(document[stage][f"{key}_m"], IN_MM) for key in ("rms", "mean_error", "p95", "max"))]
        for stage in ("before", "after")
    ]
    gain, loaded, promise = document["gain"], document["loaded"], document["promise"]
    low, high = (three_digits(gain[f"{end}_m"] * IN_MM) for end in ("lower", "upper"))
    texts = [
        f"gain {three_digits(gain['value_m'] * IN_MM)} mm of the rms error, 95 % interval {low} to {high} mm",
        f"{_LOADED[loaded['verdict']]}: the targets moved by {100 * loaded['slope']:.0f} % of the planned displacement "
        f"of {three_digits(loaded['planned_rms_m'] * IN_MM)} mm rms, 95 % interval {100 * loaded['lower']:.0f} to "
        f"{100 * loaded['upper']:.0f} %",
    ]
    if promise is not None:
        kept = "agrees with the model" if promise["kept"] else "does not agree with the model"
        texts.append(
            f"the error after {kept}: {three_digits(document['after']['rms_m'] * IN_MM)} mm rms measured, "
            f"{three_digits(promise['promised_rms_m'] * IN_MM)} mm rms predicted with measurement noise; chi-square "
            f"{promise['chi_square']:.4g} on {promise['degrees_of_freedom']} degrees of freedom, "
            f"{p_value(promise['p_value'])}"
        )
    yield Section("", [Grid(("error, mm", "rms", "mean", "95th pct.", "largest"), rows)])
    yield Section("", [Listing([*texts, *document["notes"]])])
