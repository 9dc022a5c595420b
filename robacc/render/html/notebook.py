"""A result in a few lines for a notebook or a Python shell: title, summary and key figures; no library is needed."""

from __future__ import annotations

from html import escape

from robacc.render.text.layout import Document
from robacc.render.views.elements import ReportHeadline
from robacc.render.views.results import headline_of


def notebook_html(document: Document) -> str:
    """Return the headline of a result as HTML."""
    headline = headline_of(document)
    badges = "".join(f" <small>[{escape(text)}]</small>" for text, _ in headline.badges)
    cells = "".join(
        f"<tr><th style='text-align:left'>{escape(label)}</th><td style='text-align:left'>{escape(value)}</td>"
        f"<td style='text-align:left'>{escape(note)}</td></tr>"
        for label, value, note in _rows(headline)
    )
    return (
        f"<div><strong>{escape(headline.title)}</strong>{badges}<p>{escape(headline.summary)}</p>"
        f"<table>{cells}</table></div>"
    )


def notebook_text(document: Document) -> str:
    """Return the headline of a result as lines of text."""
    headline = headline_of(document)
    rows = [(label, "  ".join(part for part in (value, note) if part)) for label, value, note in _rows(headline)]
    width = max((len(label) for label, _ in rows), default=0)
    title = " ".join((headline.title, *(f"[{text}]" for text, _ in headline.badges)))
    return "\n".join((title, headline.summary, *(f"{label:<{width}}  {text}" for label, text in rows)))


def _rows(headline: ReportHeadline) -> list[tuple[str, str, str]]:
    """Return label, value and interval of each figure, then the facts."""
    return [
        *((tile.label, str(tile.value), tile.interval) for tile in headline.tiles),
        *((name, text, "") for name, text in headline.facts),
    ]
