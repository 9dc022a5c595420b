"""Plug-ins: objects that other packages offer by entry points, looked up when nothing in this package serves."""

import sys
from collections.abc import Collection, Iterator
from functools import cache
from typing import TYPE_CHECKING, Any

from robacc.errors import UsageError, refuse

if TYPE_CHECKING:
    from importlib.metadata import EntryPoints


def plug_in_names(group: str) -> Collection[str]:
    """Return the names of the entry points of a group."""
    return _entries(group, tuple(sys.path)).names


def plug_in(group: str, name: str) -> Any:
    """Return the object of an entry point.

    Raises:
        UsageError: No installed package offers it, or it cannot be loaded.
    """
    entries = _entries(group, tuple(sys.path))
    refuse((name not in entries.names, f"no installed package offers the plug-in {name} of {group}"))
    try:
        return entries[name].load()
    except (ImportError, AttributeError) as error:
        raise UsageError(f"the plug-in {name} ({entries[name].value}) cannot be loaded: {error}") from error


def plug_ins(group: str, first: str = "") -> Iterator[Any]:
    """Yield the objects of a group in the order of their names, that of the name ``first`` before the others.

    Raises:
        UsageError: One cannot be loaded.
    """
    for name in sorted(plug_in_names(group), key=lambda name: (name != first, name)):
        yield plug_in(group, name)


@cache
def _entries(group: str, path: tuple[str, ...]) -> "EntryPoints":
    """Return a group's entry points of the packages on the path: a listing takes 20 ms, and a file asks for many."""
    from importlib.metadata import entry_points

    return entry_points(group=group)
