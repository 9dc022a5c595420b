"""Rows of a page that say what was tested, as the robot file of a result or the user of the page states it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from robacc.robots.identity import IDENTITY

Document = Mapping[str, Any]


def identity_rows(
    documents: Sequence[Document], names: Sequence[str], identity: Mapping[str, str]
) -> list[tuple[str, str]]:
    """Return labels and texts in the order of the page; a text of ``identity`` replaces those of the results.

    Different texts of several results, such as the serial numbers of two arms, stand side by side with the results'
    names.
    """
    rows = []
    for key, label in IDENTITY.items():
        texts = dict(_stated(documents, names, key)) if key not in identity else {"": identity[key]}
        distinct = list(dict.fromkeys(texts.values()))
        if len(distinct) == 1:
            rows.append((label, distinct[0]))
        elif distinct:
            rows.append((label, "; ".join(f"{name}: {text}" for name, text in texts.items())))
    return rows


def _stated(documents: Sequence[Document], names: Sequence[str], key: str) -> list[tuple[str, str]]:
    """Return the name of each result whose robot file states ``key``, and its text."""
    return [
        (name, file["identity"][key])
        for name, document in zip(names, documents, strict=True)
        for file in document["inputs"]
        if key in file.get("identity", ())
    ]
