"""HTML page of results, for the command ``report`` and the option ``--report``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from robacc.documents.read_result import StoredResult


def page_of_results(results: Sequence[StoredResult], identity: Mapping[str, str] | None = None) -> str:
    """Return the page of stored results, with the identity of what was tested if it is given.

    Raises:
        InputError: a result does not follow the schema of its command.
        UsageError: the extra ``report`` is not installed.
    """
    from robacc.documents.read_result import understood
    from robacc.render.html.page import page_of, result_of

    sections = []
    for number, result in enumerate(results, 1):
        with understood(result.name, result.command):
            sections.append(result_of(result.document, number))
    names = [result.record.name for result in results]
    return page_of(sections, [result.document for result in results], _unique(names), identity or {})


def page_of_document(document: Mapping[str, Any]) -> str:
    """Return the page of a result that was just computed, from the JSON text that would be stored."""
    import json

    from robacc.io.json_text import json_text
    from robacc.render.html.page import render

    return render([json.loads(json_text(document))], [str(document["command"])])


def _unique(names: Sequence[str]) -> list[str]:
    """Return the names with a number after each repeated name."""
    return [
        name if names.count(name) == 1 else f"{name} ({names[: i + 1].count(name)})" for i, name in enumerate(names)
    ]
