"""Names from files, as short as a picture has room for."""

from __future__ import annotations


def short(text: str, longest: int = 26) -> str:
    """One line of at most so many signs, what cannot be printed replaced; the rest of it stands in the tables."""
    line = "".join(sign if sign.isprintable() else " " for sign in text)
    return line if len(line) <= longest else f"{line[: longest - 1]}…"
