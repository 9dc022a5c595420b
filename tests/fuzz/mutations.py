"""Files made hostile: the words of a good one exchanged for such as broke programs before, and trees cut about."""

from __future__ import annotations

import json
import random
import re
from typing import Any

NUMBERS = (
    *("0", "-0", "1", "-1", "1e308", "-1e308", "1.8e308", "5e-324", "1e-300", "1e200", "1e16", "1e-9", "1e9"),
    *("nan", "NaN", ".nan", "inf", "-inf", ".inf", "Infinity", "1_000", "1:30", "0x10", "010", "1,5", "١٢", "½", "1e"),
    *("3.141592653589793", "6.283185307179586", "90", "1000", "1e5", "99999999999999999999999", "1" * 400, ""),
)
WORDS = (
    *("no", "off", "yes", "null", "~", "true", "{}", "[]", "- ", "&a", "*a", "<<: *a", "!x"),
    "!!python/object:os.system",
    *("\x00", "\x1b[31m", "\x07", "\r", "\u202e", "\u2028", "\ufeff", "\x85", "é", "𝒳", "\x7f", "#", '"', "'"),
    "a" * 300,
    *("<!DOCTYPE a>", "&lt;", "&#0;", "<!--", "]]>", "<joint/>", "%s", "{0}", "[bold]", "`", "|", "::error::", "\t"),
    ";",
    *("---", "...", "? ", "key: ", "mm", "deg", "j1", "q1", "base_frame", "revolute", "prismatic", "urdf", "modified"),
)
VALUES: tuple[Any, ...] = (
    *(None, True, False, 0, 1, -1, 2, 1e308, -1e308, 1e200, 5e-324, 1e-300, 10**30, "", "x", "nan"),
    *("\x1b[2J", "\u202e"),
    *([], {}, [[]], [None], [1], [1, 2, 3], {"a": 1}, "a" * 300, "[bold]", "m", "A", "E", 0.5, 1.0, 1e-9),
)
_WORD = re.compile(r"[^\s,:\[\]{}<>=\"']+|\n|.", re.DOTALL)


def of_text(data: bytes, rng: random.Random) -> bytes:
    """One to four of a text's words exchanged, dropped, doubled or moved, or some of its bytes."""
    if rng.random() < 0.1:
        return of_bytes(data, rng)
    words = _WORD.findall(data.decode(errors="surrogateescape"))
    for _ in range(rng.choice((1, 1, 2, 4))):
        if not words:
            break
        i, kind = rng.randrange(len(words)), rng.randrange(7)
        if kind <= 2:
            words[i] = rng.choice(NUMBERS if any(sign.isdigit() for sign in words[i]) or kind == 2 else WORDS)
        elif kind == 3:
            del words[i : i + rng.choice((1, 1, 3, 30))]
        elif kind == 4:
            words[i:i] = words[i : i + rng.choice((1, 3, 30))]
        elif kind == 5:
            words.insert(i, rng.choice(WORDS))
        else:
            j = rng.randrange(len(words))
            words[i], words[j] = words[j], words[i]
    return "".join(words).encode(errors="surrogateescape")


def of_bytes(data: bytes, rng: random.Random) -> bytes:
    """A byte changed, the end cut off, or another encoding."""
    kind, i = rng.randrange(4), rng.randrange(len(data) + 1)
    if kind == 0:
        return data[:i]
    if kind == 1:
        return data.decode(errors="replace").encode(rng.choice(("utf-16", "utf-16-le", "utf-8-sig", "utf-32")))
    if kind == 2:
        return data.replace(b"\n", rng.choice((b"\r\n", b"\r", b" ")))
    return data[:i] + bytes([rng.randrange(256)]) + data[i + 1 :]


def of_tree(data: bytes, rng: random.Random) -> bytes:
    """One to three values of a JSON document exchanged, dropped, doubled or moved."""
    if rng.random() < 0.05:
        return of_text(data, rng)
    try:
        document = json.loads(data)
    except ValueError:
        return of_text(data, rng)
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        holder, key = _place(document, rng)
        if holder is None:
            continue
        kind = rng.randrange(8)
        if kind <= 4:
            holder[key] = rng.choice(VALUES)
        elif kind == 5:
            del holder[key]
        elif kind == 6 and isinstance(holder, list):
            holder[key:key] = holder[key : key + rng.choice((1, 3))]
        else:
            other, name = _place(document, rng)
            if other is not None:
                holder[key] = json.loads(json.dumps(other[name]))
    return json.dumps(document, ensure_ascii=rng.random() < 0.5).encode(errors="replace")


def _place(document: Any, rng: random.Random) -> tuple[Any, Any]:
    """A holder and a key or index of it, at any depth: each level stops with the same chance."""
    holder, key, here = None, None, document
    while isinstance(here, dict | list) and here and (holder is None or rng.random() < 0.75):
        holder, key = here, rng.choice(list(here)) if isinstance(here, dict) else rng.randrange(len(here))
        here = holder[key]
    return holder, key
