"""Plug-ins: objects that other packages offer by entry points, looked up when nothing in this package serves."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

from robacc.errors import UsageError


def plug_in_names(group: str) -> Collection[str]:
    """Return the names of the entry points of a group."""
    from importlib.metadata import entry_points

    return entry_points(group=group).names


def plug_in(group: str, name: str) -> Any:
    """Return the object of an entry point.

    Raises:
        UsageError: No installed package offers it, or it cannot be loaded.
    """
    from importlib.metadata import entry_points

    for entry in entry_points(group=group, name=name):
        try:
            return entry.load()
        except (ImportError, AttributeError) as error:
            raise UsageError(f"the plug-in {name} ({entry.value}) cannot be loaded: {error}") from error
    raise UsageError(f"no installed package offers the plug-in {name} of {group}")
