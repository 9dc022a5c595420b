"""A comparison: ranking, grades, statistics and differences; and targets before and after a correction."""

from __future__ import annotations

from collections.abc import Sequence

from robacc.comparison.stored_results import split_key
from robacc.render.text import (
    IN_MM,
    QUANTITIES,
    Document,
    Form,
    Grid,
    Listing,
    Number,
    ReportHeadline,
    Section,
    Tile,
    amount,
    chance,
    decimals,
    fixed,
    named_by_text,
    number,
    p_value,
    percent,
    statistics_cells,
    three_digits,
    unit_of,
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
_LISTED = ("rms", "mean_error", "p95")
"""Statistics whose differences a text lists for more than two results; the page and the JSON result have all."""
_MAX_NAME = 24
"""Largest number of columns for a result's name."""


def comparison_headline(document: Document) -> ReportHeadline:
    """Return the headline of a result of ``compare``."""
    names, ranking = [result["name"] for result in document["results"]], document["ranking"] or {}
    return ReportHeadline(
        f"Comparison of {len(names)} results",
        f"By {ranking['by']}: {'; '.join(ranking['text'])}." if ranking else "",
        [
            Tile(entry["name"], amount(entry["value"], ranking["unit"]), f"group {entry['letters']}")
            for entry in ranking.get("order", ())[:3]
            if ranking["unit"] in ("m", "rad")
        ],
        (),
        [("Results", ", ".join(names)), ("Baseline", str(document["baseline"] or "none"))],
    )


def comparison_view(document: Document, form: Form = "page") -> list[Section]:
    """Return ranking, grades and statistics, with the methods of the differences.

    A page has every difference, and how each result was made.
    """
    results, rows, complete = document["results"], document["statistics"], form == "page"
    owners = {row["key"]: split_key(row["key"])[0] for row in rows}
    main = [row for row in rows if _stage(owners[row["key"]]) is None and not row["key"].startswith(_ISO9283)]
    groups = {
        f"{owner.capitalize()} error": [row for row in main if owners[row["key"]] == owner]
        for owner in dict.fromkeys(owners[row["key"]] for row in main)
    }
    groups |= {
        f"ISO 9283, {name}": [row for row in rows if row["key"].startswith(_ISO9283) and row["unit"] == unit]
        for name, unit, *_ in QUANTITIES
    }
    groups |= {
        f"{name.capitalize()} rms": [r for r in rows if r["key"].endswith(f".{name}.rms") and _stage(r["key"])]
        for name, *_ in QUANTITIES
    }
    methods = ((_label(row["key"]), each["why"] or each["method"]) for row in rows for each in row["differences"])
    title = f"{len(results)} results compared; baseline: {_short(document['baseline'])}"
    made = [
        *(
            (key, *(str(result["made"].get(key, "–")) for result in results))
            for key in dict.fromkeys(key for result in results for key in result["made"])
        ),
        ("SHA-256", *(result["sha256"] for result in results)),
    ]
    table = Grid(("", *(result["name"] for result in results)), made, is_text=True)
    return [
        *([] if complete else [Section(title, [_results(document)])]),
        _ranking(document["ranking"]),
        *([] if document["grade"] is None else [_grade(document["grade"])]),
        *(_block(document, heading, group, complete) for heading, group in groups.items() if group),
        Section("Differences", [Listing(named_by_text(methods))]),
        Section("Limitations", [Listing(() if complete else document["notes"])]),
        Section("Compared results", [_results(document), table] if complete else []),
    ]


def _short(name: str) -> str:
    return name if len(name) <= _MAX_NAME else f"{name[: _MAX_NAME - 1]}…"


def _results(document: Document) -> Grid:
    paired = {match["second"]: "same poses" if match["paired"] else "different poses" for match in document["pairing"]}
    return Grid(
        ("result", "command", "robot", "poses", "grade", ""),
        [
            (
                *(_short(str(result[key] or "–")) for key in ("name", "command", "robot", "n_poses", "grade")),
                "" if result["command"] in ("iso9283", "predict") else paired.get(result["name"], ""),
            )
            for result in document["results"]
        ],
    )


def _ranking(ranking: Document) -> Section:
    key, unit, order = ranking["by"], ranking["unit"], ranking["order"]
    is_iso, stage = key.startswith(_ISO9283), _stage(key)
    of_quantity = "" if is_iso else f" of the {split_key(key)[0].rpartition('.')[2]} error"
    pairs = {
        (pair["better"], pair["worse"]): (_difference(pair["difference"], unit)[0], p_value(pair["p_corrected"]))
        for pair in ranking["pairs"]
    }
    rows = [
        (
            _short(entry["name"]),
            _amount(entry["value"], unit),
            entry["letters"],
            *pairs.get((entry["name"], following["name"]), ("", "")),
        )
        for entry, following in zip(order, [*order[1:], {"name": ""}], strict=True)
    ]
    is_grouped = any(entry["letters"] for entry in order)
    of_stage = "" if stage is None else f" ({stage})"
    return Section(
        f"Ranking by {_label(key)}{of_quantity}{of_stage}, {unit_of(unit).name}",
        [
            Grid(("", "", "group" if is_grouped else "", "difference to the next", "p, corrected for pairs"), rows),
            Listing(ranking["text"]),
        ],
    )


def _grade(grade: Document) -> Section:
    results = grade["results"]
    rows = [
        (
            _short(each["name"]),
            _VERDICTS[each["verdict"]],
            each["grade"],
            "–" if each["probability"] is None else chance(each["probability"]),
            *(
                f"{_amount(each[f'{name}_{unit}'], unit)}{'' if bound is None else f' ({_amount(bound, unit)})'}"
                for name, unit, *_ in QUANTITIES
                for bound in [each[f"{name}_upper_bound_{unit}"]]
            ),
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
    return Section(
        f"Grade {grade['wanted']} (scale: {grade['scale']})",
        [
            Grid(("", "", "grade", "probability", "position (bound), mm", "orientation (bound), °"), rows),
            Listing(reasons + later),
        ],
    )


def _block(document: Document, title: str, rows: Sequence[Document], complete: bool) -> Section:
    """Return the tables of related statistics; few results stand in columns, many in rows."""
    unit = rows[0]["unit"]
    names = [_short(result["name"]) for result in document["results"]]
    title, interval_head = f"{title}, {unit_of(unit).name}", percent(document["confidence"])
    labels = [_stage(row["key"]) or _label(row["key"]) for row in rows]
    figures = [[_amount(figure["value"], unit) for figure in row["values"]] for row in rows]
    if len(names) == 2:
        return Section(
            title,
            [
                Grid(
                    ("", *names, "difference", interval_head, ""),
                    [
                        [label, *own, *_difference(row["differences"][0], unit)]
                        for label, own, row in zip(labels, figures, rows, strict=True)
                    ],
                )
            ],
        )
    statistics, every = [split_key(row["key"])[1] for row in rows], range(len(rows))
    listed: Sequence[int] = [i for i in every if complete or statistics[i] in _LISTED] or every
    if len(names) <= 4:
        grid = Grid(("", *names), [[label, *own] for label, own in zip(labels, figures, strict=True)])
    else:
        shown = [i for i in every if complete or statistics[i] in (*_LISTED, "max")] or every[:4]
        grid = Grid(("", *(labels[i] for i in shown)), [*zip(names, *(figures[i] for i in shown), strict=True)])
        listed = listed if complete else shown[:1]
    return Section(
        title,
        [
            grid,
            Grid(
                (f"difference from {_short(document['baseline'])}", "difference", interval_head, ""),
                [
                    [f"{labels[i]}, {_short(difference['name'])}", *_difference(difference, unit)]
                    for i in listed
                    for difference in rows[i]["differences"]
                ],
            ),
        ],
    )


def _stage(key: str) -> str | None:
    """Return the label of a fit's stage, None for its main statistics."""
    return next((label for stage, label in _STAGES.items() if key.startswith(f"{stage}.")), None)


def _label(key: str) -> str:
    """Return the name of a statistic, or of a criterion such as ``AP`` or ``drift of AP``."""
    if not key.startswith(_ISO9283):
        return _STATISTICS.get(split_key(key)[1], split_key(key)[1])
    kind, _, base = key.removeprefix(_ISO9283).removesuffix(".max").removesuffix(".orientation").partition(".")
    return f"{kind} of {base}" if base else kind


def _amount(value: float | None, unit: str) -> Number:
    return Number("0", value) if value is not None and abs(value) < _ROUNDING else number(value, unit_of(unit).factor)


def _difference(difference: Document, unit: str) -> tuple[Number, str, str]:
    """Return a difference, its interval and its p-value, with signs and the digits that the interval supports."""
    value, factor = difference["value"], unit_of(unit).factor
    known = [end * factor for end in (difference["lower"], difference["upper"]) if end is not None]
    places = decimals(value * factor, *(known if len(known) == 2 else (None, None)))
    size, *ends = (
        text if text.startswith("-") or float(text) == 0.0 else f"+{text}"
        for number in (value * factor, *known)
        for text in ["0" if abs(number) < _ROUNDING * factor else fixed(number, places)]
    )
    return Number(size, value), " … ".join(ends) if len(ends) == 2 else "–", p_value(difference["p_value"])


# Targets before and after a correction.

_LOADED = {
    "loaded": "the correction was loaded",
    "partly_loaded": "only a part of the correction was loaded",
    "not_loaded": "no sign that the correction was loaded",
    "undecided": "the measurements do not decide whether the correction was loaded",
}


def paired_view(document: Document, names: tuple[str, str]) -> list[Section]:
    """Return the text of the comparison of the files ``names``."""
    gain, loaded = document["gain"], document["loaded"]
    value, low, high = (three_digits(gain[f"{end}_m"] * IN_MM) for end in ("value", "lower", "upper"))
    return [
        Section(f"{document['n_targets']} targets before ({names[0]}) and after ({names[1]}) a correction"),
        Section(
            "",
            [
                Grid(
                    ("error, mm", "rms", "mean", "95th pct.", "largest"),
                    [(stage, *statistics_cells(document[stage], "m", IN_MM)) for stage in ("before", "after")],
                )
            ],
        ),
        Section(
            "",
            [
                Listing(
                    [
                        f"gain {value} mm of the rms error, 95 % interval {low} to {high} mm",
                        f"{_LOADED[loaded['verdict']]}: the targets moved by {100 * loaded['slope']:.0f} % of the "
                        f"planned displacement of {three_digits(loaded['planned_rms_m'] * IN_MM)} mm rms, 95 % "
                        f"interval {100 * loaded['lower']:.0f} to {100 * loaded['upper']:.0f} %",
                        _promise(document["promise"], document["after"]["rms_m"]),
                        *document["notes"],
                    ]
                )
            ],
        ),
    ]


def _promise(promise: Document | None, rms: float) -> str:
    """Return whether the error after a correction is that of the model; empty without a model."""
    return (
        ""
        if promise is None
        else (
            f"the error after {'agrees' if promise['kept'] else 'does not agree'} with the model: "
            f"{three_digits(rms * IN_MM)} mm rms measured, {three_digits(promise['promised_rms_m'] * IN_MM)} mm rms "
            f"predicted with measurement noise; chi-square {promise['chi_square']:.4g} on "
            f"{promise['degrees_of_freedom']} degrees of freedom, {p_value(promise['p_value'])}"
        )
    )
