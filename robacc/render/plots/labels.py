"""Names from files, shortened for charts."""

from __future__ import annotations


def short(text: str, longest: int = 26) -> str:
    """Return one printable line of at most ``longest`` characters; the tables have the full names."""
    line = "".join(sign if sign.isprintable() else " " for sign in text)
    return line if len(line) <= longest else f"{line[: longest - 1]}…"
