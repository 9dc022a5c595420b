"""Plug-ins: objects that other packages offer by entry points, looked up when nothing in this package serves."""

from collections.abc import Collection, Iterator
from typing import TYPE_CHECKING, Any

from robacc.errors import UsageError, refuse

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint, EntryPoints


def plug_in_names(group: str) -> Collection[str]:
    """Return the names of the entry points of a group."""
    return _entries(group).names


def plug_in(group: str, name: str) -> Any:
    """Return the object of an entry point.

    Raises:
        UsageError: No installed package offers it, or it cannot be loaded.
    """
    entries = _entries(group)
    refuse((name not in entries.names, f"no installed package offers the plug-in {name} of {group}"))
    return _loaded(entries[name])


def plug_ins(group: str, first: str = "") -> Iterator[Any]:
    """Yield the objects of a group in the order of their names, that of the name ``first`` before the others.

    Raises:
        UsageError: One cannot be loaded.
    """
    entries = _entries(group)
    for name in sorted(entries.names, key=lambda name: (name != first, name)):
        yield _loaded(entries[name])


def _entries(group: str) -> "EntryPoints":
    from importlib.metadata import entry_points

    return entry_points(group=group)


def _loaded(entry: "EntryPoint") -> Any:
    try:
        return entry.load()
    except (ImportError, AttributeError) as error:
        raise UsageError(f"the plug-in {entry.name} ({entry.value}) cannot be loaded: {error}") from error
