"""Mutate valid files: replace tokens by ones that often break programs, and change JSON trees."""

import json
import random
import re
from typing import Any

NUMBERS = (
    *("0", "-0", "1", "-1", "1e308", "-1e308", "1.8e308", "5e-324", "1e-300", "1e200", "1e16", "1e-9", "1e9"),
    *("nan", "NaN", ".nan", "inf", "-inf", ".inf", "Infinity", "1_000", "1:30", "0x10", "010", "1,5", "١٢", "½", "1e"),
    *("3.141592653589793", "6.283185307179586", "90", "1000", "1e5", "99999999999999999999999", "1" * 400, ""),
)
TOKENS = (
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
_TOKEN = re.compile(r"[^\s,:\[\]{}<>=\"']+|\n|.", re.DOTALL)


def mutate_text(data: bytes, rng: random.Random) -> bytes:
    """Replace, drop, repeat or move one to four tokens of a text, or change its bytes."""
    if rng.random() < 0.1:
        return mutate_bytes(data, rng)
    tokens = _TOKEN.findall(data.decode(errors="surrogateescape"))
    for _ in range(rng.choice((1, 1, 2, 4))):
        if not tokens:
            break
        i, kind = rng.randrange(len(tokens)), rng.randrange(7)
        if kind <= 2:
            tokens[i] = rng.choice(NUMBERS if any(sign.isdigit() for sign in tokens[i]) or kind == 2 else TOKENS)
        elif kind == 3:
            del tokens[i : i + rng.choice((1, 1, 3, 30))]
        elif kind == 4:
            tokens[i:i] = tokens[i : i + rng.choice((1, 3, 30))]
        elif kind == 5:
            tokens.insert(i, rng.choice(TOKENS))
        else:
            j = rng.randrange(len(tokens))
            tokens[i], tokens[j] = tokens[j], tokens[i]
    return "".join(tokens).encode(errors="surrogateescape")


def mutate_bytes(data: bytes, rng: random.Random) -> bytes:
    """Change a byte, cut off the end, or change the encoding or line ends."""
    kind, i = rng.randrange(4), rng.randrange(len(data) + 1)
    if kind == 0:
        return data[:i]
    if kind == 1:
        return data.decode(errors="replace").encode(rng.choice(("utf-16", "utf-16-le", "utf-8-sig", "utf-32")))
    if kind == 2:
        return data.replace(b"\n", rng.choice((b"\r\n", b"\r", b" ")))
    return data[:i] + bytes([rng.randrange(256)]) + data[i + 1 :]


def mutate_json(data: bytes, rng: random.Random) -> bytes:
    """Replace, drop, repeat or move one to three values of a JSON document."""
    if rng.random() < 0.05:
        return mutate_text(data, rng)
    try:
        document = json.loads(data)
    except ValueError:
        return mutate_text(data, rng)
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
    """Return a container and a key or index of it, at a random depth: each level stops with the same chance."""
    holder, key, node = None, None, document
    while isinstance(node, dict | list) and node and (holder is None or rng.random() < 0.75):
        holder, key = node, rng.choice(list(node)) if isinstance(node, dict) else rng.randrange(len(node))
        node = holder[key]
    return holder, key
