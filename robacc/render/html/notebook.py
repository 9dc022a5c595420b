"""A result as a few lines of HTML for a notebook: title, summary and key figures; no library is needed."""

from __future__ import annotations

from html import escape

from robacc.render.html.headline import headline_of
from robacc.render.plots.chart import Document


def notebook_html(document: Document) -> str:
    """Return the headline of a result."""
    headline = headline_of(document)
    badges = "".join(f" <small>[{escape(badge.text)}]</small>" for badge in headline.badges)
    rows = [(tile.label, str(tile.value), tile.interval) for tile in headline.tiles]
    rows += [(name, text, "") for name, text in headline.facts]
    cells = "".join(
        f"<tr><th style='text-align:left'>{escape(label)}</th><td style='text-align:left'>{escape(value)}</td>"
        f"<td style='text-align:left'>{escape(note)}</td></tr>"
        for label, value, note in rows
    )
    return (
        f"<div><strong>{escape(headline.title)}</strong>{badges}<p>{escape(headline.summary)}</p>"
        f"<table>{cells}</table></div>"
    )
