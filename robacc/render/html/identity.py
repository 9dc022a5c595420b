"""Rows of a page that say what was tested, as the robot file of a result or the user of the page states it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from robacc.robots.identity import IDENTITY

Document = Mapping[str, Any]


def identity_rows(
    documents: Sequence[Document], names: Sequence[str], identity: Mapping[str, str]
) -> list[tuple[str, str]]:
    """Return labels and texts in the order of the page; a text of ``identity`` replaces those of the results.

    Different texts, such as the serial numbers of two arms, stand side by side with the names of the results; those
    of two files of one result with the names of the files.
    """
    rows = []
    for key, label in IDENTITY.items():
        texts = list(_stated(documents, names, key)) if key not in identity else [("", identity[key])]
        distinct = list(dict.fromkeys(text for _, text in texts))
        if len(distinct) == 1:
            rows.append((label, distinct[0]))
        elif distinct:
            rows.append((label, "; ".join(f"{name}: {text}" for name, text in texts)))
    return rows


def _stated(documents: Sequence[Document], names: Sequence[str], key: str) -> Iterator[tuple[str, str]]:
    """Yield the name of each result whose robot files state ``key``, and its text.

    Where the robot files of a result state different texts, the name of each file stands in place of the result's, or
    behind it if there are several results.
    """
    for name, document in zip(names, documents, strict=True):
        files = [file for file in document["inputs"] if key in file.get("identity", ())]
        texts = [file["identity"][key] for file in files]
        if len(set(texts)) > 1:
            lead = f"{name}, " if len(documents) > 1 else ""
            yield from ((f"{lead}{file['name']}", text) for file, text in zip(files, texts, strict=True))
        elif texts:
            yield name, texts[0]
