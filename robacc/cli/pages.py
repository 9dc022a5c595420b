"""What `report`, `plot` and `--report` have in common: from a document to a page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from robacc.documents.read_result import StoredResult


def page_of_results(results: Sequence[StoredResult]) -> str:
    """The page of stored results.

    Raises:
        InputError: a result is not what its command writes.
        UsageError: the extra ``report`` is not installed.
    """
    from robacc.documents.read_result import understood
    from robacc.render.html.page import page_of, result_of

    laid_out = []
    for place, one in enumerate(results, 1):
        with understood(one.name, one.command):
            laid_out.append(result_of(one.document, place))
    names = [one.record.name for one in results]
    return page_of(laid_out, [one.document for one in results], _distinct(names))


def page_of_document(document: Mapping[str, Any]) -> str:
    """The page of a result that was just computed, from its JSON text as it would be stored."""
    import json

    from robacc.io.json_text import json_text
    from robacc.render.html.page import render

    return render([json.loads(json_text(document))], [str(document["command"])])


def _distinct(names: Sequence[str]) -> list[str]:
    """Names of which none stands twice."""
    return [
        name if names.count(name) == 1 else f"{name} ({names[: i + 1].count(name)})" for i, name in enumerate(names)
    ]
