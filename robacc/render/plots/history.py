"""Control charts: a figure or coefficient over the tests of an arm, with its limits and the changes found."""

from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from robacc.render.plots.canvas import Array, Axis, Chart, Panel, Series, numbers, short
from robacc.render.text import Document, Grid, day, unit_of

_MOST = 40
"""Charts of a page, those of the most certain changes first; and last tests that the table of a chart lists."""


def control_charts(document: Document) -> Iterator[Chart]:
    """Return a chart of each series in a result of ``history changes`` or ``history trend``."""
    if document["command"] == "history-trend":
        named = {"key": document["key"], "unit": document["unit"]}
        yield from (_chart(trend["arm"], {**trend, **named}, []) for trend in document["trends"])
    if document["command"] == "history-changes":
        changes = sorted(document["changes"], key=lambda change: float(change["p_value"]))
        names = [(change["arm"], change["key"]) for change in changes]
        series = {(arm["arm"], one["key"]): one for arm in document["arms"] for one in arm.get("series", ())}
        for name in [*dict.fromkeys(name for name in (*names, *series) if name in series)][:_MOST]:
            own = [change for change, of_series in zip(changes, names, strict=True) if of_series == name]
            yield _chart(name[0], series[name], own)


def _chart(arm: str, series: Document, changes: Sequence[Document]) -> Chart:
    values, key = series["values"], series["key"]
    unit = unit_of(series["unit"], *(value["value"] for value in values))
    at, dated = _days(value["at"] for value in values), [one for one in changes if one["kind"] != "temperature"]
    value, std, expected, low, high = (
        unit.factor * numbers(value.get(name) for value in values)
        for name in ("value", "std", "expected", "low", "high")
    )
    gap = np.full(len(at), np.nan)
    bars = (
        np.stack([at, at, gap], axis=1).ravel(),
        np.stack([value - 2.0 * std, value + 2.0 * std, gap], axis=1).ravel(),
    )
    drawn = [
        Series(bars, "nominal", "± 2 standard deviations", line="-", width=0.8),
        Series((at, value), "after", "test", marker="o", size=3.4),
    ]
    said = [f"{unit.text(series['rate_per_year'])} a year"] if series.get("rate_per_year") is not None else []
    if said:
        line = np.mean(value) + unit.factor * series["rate_per_year"] * (at - at.mean()) / 365.25
        drawn.append(Series((at, line), "ink", "straight line", line="-"))
    about = f"Value of each test, and the straight line through them: {said[0]}." if said else "Value of each test."
    if has_limits := bool(np.isfinite(expected).all()):
        # A step breaks the lines.
        breaks = np.searchsorted(at, _days(one["at"] for one in dated if one["kind"] != "ramp"))
        x, *lines = (np.insert(line, breaks, np.nan) for line in (at, expected, low, high))
        is_beyond = (value < low) | (value > high)
        is_within = not is_beyond.any()
        drawn += [
            Series((x, lines[0]), "ink", "expected", line="-"),
            *(Series((x, end), "limit", "limits", line=(0, (3, 2)), width=0.9) for end in lines[1:]),
            *([] if is_within else [Series((at[is_beyond], value[is_beyond]), "before", "beyond", marker="x", size=6)]),
        ]
        said = [_said(change) for change in changes] or ["nothing changed beyond the limits"]
        about = (
            f"Value of each test; {'; '.join(said)}. The line is what is expected with the changes found; a test alone "
            "beyond the dashed limits is an alarm. The band is when a change may have begun (95 %)."
        )
        floor, top = float(np.nanmin((low, value))), float(np.nanmax((high, value)))
        for change in dated:
            # Half a day on both sides, so that a date without doubt is seen too.
            span = _days((change["earliest"], change["latest"])) + np.array([-0.5, 0.5])
            drawn.append(Series((span, [floor] * 2, [top] * 2), "third", "change", "band", alpha=0.25))
    rules = [(float(_days([change["at"]])[0]), change["kind"]) for change in dated]
    names = ("value", "std", *("expected", "low", "high") * has_limits)
    return Chart(
        "control",
        f"{key} of {arm}",
        about,
        f"{key} in {unit.name} over the dates of {len(at)} tests; {'; '.join(said)}".rstrip("; "),
        [Panel((Axis("", is_date=True, rules=rules), Axis(f"{short(key, 34)}, {unit.name}")), drawn)],
        Grid(
            ("date", *names),
            [(day(one["at"]), *(unit.text(one[name]) for name in names)) for one in values[-_MOST:]],
            note=f"The last {_MOST} of {len(at)} tests; the JSON result has all of them." * (len(at) > _MOST),
        ),
        (4.9, 3.0),
    )


def _said(change: Document) -> str:
    """Return kind, date and size of a change with its interval."""
    unit = unit_of(change["unit"])
    size, low, high = (unit.text(change[name]) for name in ("size", "low", "high"))
    when = "with temperature" if change["kind"] == "temperature" else f"{change['kind']} at {day(change['at'])}"
    return f"{when} by {size} ({low} to {high})"


def _days(dates: Iterable[str]) -> Array:
    """Return dates as days since 1970."""
    return np.array([date.removesuffix("Z") for date in dates], dtype="datetime64[s]").astype(float) / 86400.0
