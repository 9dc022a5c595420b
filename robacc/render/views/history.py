"""Results over time: a list of tests, the trend of one key, and what changed."""

from collections.abc import Callable, Sequence
from itertools import groupby

from robacc.history import SETUP
from robacc.render.text import (
    IN_MM,
    LISTED_ROWS,
    Document,
    Grid,
    Listing,
    Section,
    Text,
    amount,
    day,
    fixed,
    grid,
    number,
    p_value,
    three_digits,
    unit_of,
)

_KINDS = {
    "step": "step",
    "ramp": "ramp",
    "temperature": "with temperature",
    "setup": "set-up, not the arm",
}


def added_view(document: Document) -> list[Section]:
    """Return how many results were added."""
    counts = [(document["added"], "result"), (document["n_results"], "result"), (len(document["arms"]), "arm")]
    added, results, arms = (f"{number} {name}{'s' * (number != 1)}" for number, name in counts)
    known = f", {document['known']} known already" * bool(document["known"])
    return [Section("", [Text(f"added {added}{known}; the database has {results} of {arms}")])]


def history_view(document: Document) -> list[Section]:
    """Return a table of the results of each arm."""
    results = document["results"]
    heat = "°C" if any(result["temperature_c"] is not None for result in results) else None
    return [
        Section(
            f"{arm}: {len(own)} result{'s' * (len(own) != 1)}",
            [
                grid(
                    ("date", "command", "poses", "rms mm", "grade", heat, "file"),
                    [
                        (
                            day(result["at"]),
                            result["command"],
                            str(result["n_poses"]),
                            "–" if result["rms_m"] is None else fixed(result["rms_m"] * IN_MM, 4),
                            result["grade"] or "–",
                            "–" if result["temperature_c"] is None else fixed(result["temperature_c"], 1),
                            result["name"],
                        )
                        for result in own
                    ],
                    left=(0, 1, 6),
                )
            ],
        )
        for arm, group in groupby(results, key=lambda result: result["arm"])
        for own in [[*group]]
    ]


def trend_view(document: Document) -> list[Section]:
    """Return the values of each arm, and their slope."""
    unit = unit_of(document["unit"])
    sections = []
    for trend in document["trends"]:
        text = "fewer than three values with a standard deviation: no slope"
        if trend["rate_per_year"] is not None:
            slope, *ends = (three_digits(trend[name] * unit.factor) for name in ("rate_per_year", "low", "high"))
            text = f"slope {slope} {unit.name} a year, 95 % interval {' to '.join(ends)}"
        table = Grid(
            ("date", f"value {unit.name}".strip(), "std"),
            [
                (day(value["at"]), *(number(value[name], unit.factor) for name in ("value", "std")))
                for value in trend["values"]
            ],
        )
        sections.append(Section(f"{document['key']} of {trend['arm']}", [table, Text(text, is_note=True)]))
    return sections


def changes_view(document: Document) -> list[Section]:
    """Return the changes of each arm with their intervals, and the least change that is found."""
    return [
        section
        for arm in document["arms"]
        for own in [[change for change in document["changes"] if change["arm"] == arm["arm"]]]
        for unchanged in [
            "nothing changed beyond the limits below" if arm["detection_limits"] else "no change can be told yet"
        ]
        for section in (
            Section(
                f"{arm['arm']}: {len(own) or 'no'} change{'s' * (len(own) != 1)} in {arm['n_tests']} tests",
                [
                    change_table(own),
                    Listing(
                        [
                            *(
                                f"{one['key']}: {', '.join(one['alternatives'])} would explain the tests as well"
                                for one in own
                                if one["alternatives"]
                            ),
                            *(
                                f"{one['key']}: only the last test shows it; repeat the test"
                                for one in own
                                if not one["confirmed"]
                            ),
                            *([] if own else [unchanged]),
                            *arm["notes"],
                        ]
                    ),
                ],
            ),
            _limits(arm),
        )
    ]


def _limits(part: Document) -> Section:
    """Return the least change of each coefficient that is found, those of the set-up last."""
    limits = sorted(part["detection_limits"], key=lambda limit: (limit["key"].startswith(SETUP), limit["key"]))
    rows = [(limit["key"], unit_of(limit["unit"]).text(limit["limit"])) for limit in limits[:LISTED_ROWS]]
    more = f"; and {len(limits) - LISTED_ROWS} more in the JSON result" * (len(limits) > LISTED_ROWS)
    note = Text(
        f"a false alarm in a test has a probability of at most {100.0 * part['level']:.2g} %{more}", is_note=True
    )
    return Section("Least changes found", [Grid(("", "found with a probability of 95 %"), rows), note] if rows else [])


def health_view(document: Document) -> list[Section]:
    """Return what moved since the last full test, and the least change that is found."""
    changes, hidden = document["changes"], ", ".join(document["hidden"])
    moved = f"{', '.join(change['key'] for change in changes)} moved" if changes else "no change found"
    facts = [
        f"rms error of the model with base and target registered: {amount(document['rms_m'])} at "
        f"{document['n_poses']} poses",
        *(
            f"{change['key']}: {', '.join(change['alternatives'])} would explain the poses as well"
            for change in changes
            if change["alternatives"]
        ),
        *([f"not seen apart from the set-up or other coefficients: {hidden}"] if hidden else []),
    ]
    return [Section(f"{document['arm']}: {moved}", [change_table(changes), Listing(facts)]), _limits(document)]


def change_table(changes: Sequence[Document]) -> Grid:
    """Return a table of changes."""
    return Grid(
        ("changed", "how", "first seen", "by", "95 % interval", "p"),
        [
            (
                change["key"],
                _KINDS[change["kind"]],
                "–" if change["kind"] == "temperature" else day(change["at"]),
                unit_of(change["unit"]).text(change["size"]),
                " to ".join(str(number(change[end], unit_of(change["unit"]).factor)) for end in ("low", "high")),
                p_value(change["p_value"]).removeprefix("p ").removeprefix("= "),
            )
            for change in changes
        ],
        left=(0, 1, 2),
    )


def fleet_view(document: Document) -> list[Section]:
    """Return mean and standard deviation of each coefficient, and the arms out of family."""
    table = Grid(
        ("coefficient", "unit", "arms", "mean", "std of arms", "95 % interval"),
        [
            (
                one["key"],
                unit.name,
                str(one["n_arms"]),
                *(number(one[name], unit.factor) for name in ("mean", "std")),
                " to ".join(str(number(one[end], unit.factor)) for end in ("std_low", "std_high")),
            )
            for one in document["coefficients"]
            for unit in [unit_of(one["unit"])]
        ],
        left=(0, 1),
    )
    strangers = [
        f"{one['arm']}: {one['key']} is {unit_of(one['unit']).text(one['value'])}, other arms have "
        f"{unit_of(one['unit']).text(one['expected'])} ({p_value(one['p_value'])})"
        for one in document["strangers"]
    ]
    return [
        Section(f"Fleet of {document['n_arms']} arms", [table]),
        Section("Arms out of family", [Listing(strangers or ["none"])]),
        Section("", [Listing(document["notes"])]),
    ]


VIEWS: dict[str, Callable[[Document], list[Section]]] = {
    "history-add": added_view,
    "history-show": history_view,
    "history-trend": trend_view,
    "history-changes": changes_view,
    "health": health_view,
    "fleet": fleet_view,
}
"""View of the document of each command."""
