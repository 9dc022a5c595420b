"""Settings of effects in robot files."""

from __future__ import annotations

from collections.abc import Iterable


def refuse_settings(effect: str, keys: Iterable[str]) -> None:
    """Refuse settings that an effect does not have: whatever is left after those it has.

    Raises:
        ValueError: There is a key.
    """
    if unknown := list(keys):
        raise ValueError(f"{effect} has no setting {', '.join(map(repr, unknown))}")
