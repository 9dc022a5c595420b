"""Settings of effects: fields of their dataclasses that declare how robot files and results state them."""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Literal, get_args, get_origin, get_type_hints

_NOUNS = {
    bool: ("true or false", "true or false"),
    int: ("a whole number", "whole numbers"),
    float: ("a number", "numbers"),
    str: ("a name", "names"),
}
"""Singular and plural of a kind of value."""


@dataclass(frozen=True, slots=True)
class Setting:
    """Declaration of a setting; see :func:`setting`."""

    default: Any
    key: str = ""
    """Key in files and results; by default the field's name."""
    written: bool | Callable[[Any], bool] = False
    """True if it is written even at its default; or a function of the effect that decides whether it is written."""
    unit: Literal["length", "angle"] | None = None
    """Unit of a robot file that its numbers follow."""
    choices: tuple[str, ...] = ()
    """Possible names, where the kind is not a ``Literal``."""
    above: float = -math.inf
    least: float = -math.inf
    below: float = math.inf
    most: float = math.inf
    """Limits of each number, in the units of the file; ``above`` and ``below`` are not possible themselves."""
    different: bool = False
    """True for a list of at least one number, where no two agree to six digits."""
    last: bool = False
    """True if it is written after the settings of subclasses."""
    field: str = ""
    """Name of the field."""
    kind: Any = None
    """Annotation of the field."""

    def read(self, value: Any) -> Any:
        """Return a value of a file as the field has it.

        Raises:
            ValueError: The value is not of the kind, or not within the limits.
        """
        try:
            result = self._converted(self.kind, value)
            if self.different and len({f"{number:.6g}" for number in result}) < max(len(result), 1):
                raise ValueError
        except (ValueError, OverflowError):
            raise ValueError(f"{self.key} must be {self._expected(self.kind)}, found {value!r}") from None
        return result

    def is_written(self, effect: Any) -> bool:
        """Return whether the settings of ``effect`` contain this one."""
        if callable(self.written):
            return self.written(effect)
        return self.written or getattr(effect, self.field) != self.default

    def _converted(self, kind: Any, value: Any) -> Any:
        """Return a value of a file as a value of a kind; a ``ValueError`` without text where that is not possible."""
        parts = get_args(kind)
        if get_origin(kind) is tuple:
            if not isinstance(value, list | tuple):
                raise ValueError
            kinds = parts[:1] * len(value) if parts[-1] is ... else parts
            return tuple(self._converted(part, item) for part, item in zip(kinds, value, strict=True))
        if parts:
            return None if value is None else self._converted(parts[0], value)
        if not isinstance(value, (int, float) if kind is float else kind) or isinstance(value, bool) != (kind is bool):
            raise ValueError
        within = kind is str or (self.above < value < self.below and self.least <= value <= self.most)
        if not within or (self.choices and value not in self.choices):
            raise ValueError
        return kind(value)

    def _expected(self, kind: Any, many: bool = False) -> str:
        """Return the values of a kind as text, in the plural if there are many."""
        parts = get_args(kind)
        if get_origin(kind) is tuple:
            count = "" if parts[-1] is ... else f"{len(parts)} "
            different = "different " if self.different else ""
            return f"{'lists' if many else 'a list'} of {count}{different}{self._expected(parts[0], True)}"
        if parts:
            return self._expected(parts[0], many)
        if self.choices:
            return f"some of {', '.join(self.choices)}" if many else " or ".join(self.choices)
        limits = {"above": self.above, "of at least": self.least, "below": self.below, "at most": self.most}
        texts = [f"{text} {limit:g}" for text, limit in limits.items() if math.isfinite(limit)]
        return " ".join((_NOUNS[kind][many], " and ".join(texts))).rstrip()


def setting(default: Any, **declared: Any) -> Any:
    """Return the field of an effect's dataclass that is a setting of this default.

    The annotation is the kind of its values: ``bool``, ``int``, ``float``, ``str``, a ``Literal`` of names, a tuple of
    kinds (in files a list), or one of these ``| None``, where null is none.

    Args:
        default: Value of an effect whose file does not have the setting.
        declared: Other attributes of :class:`Setting`, such as ``key``, ``above`` and ``unit``.
    """
    return dataclasses.field(default=default, metadata={"setting": Setting(default, **declared)})


@functools.cache
def settings_of(effect: type) -> Mapping[str, Setting]:
    """Return the settings of a class of effects by key, in the order in which they are written."""
    hints, settings = get_type_hints(effect), []
    for field in dataclasses.fields(effect):
        if declared := field.metadata.get("setting"):
            kind, choices = hints[field.name], declared.choices
            if get_origin(kind) is Literal:
                kind, choices = str, get_args(kind)
            key = declared.key or field.name
            settings.append(dataclasses.replace(declared, key=key, choices=choices, field=field.name, kind=kind))
    return {declared.key: declared for declared in sorted(settings, key=lambda declared: declared.last)}


def as_plain(value: Any) -> Any:
    """Return a setting's value with lists in place of tuples."""
    return [as_plain(item) for item in value] if isinstance(value, tuple) else value


def scaled(value: Any, size: float) -> Any:
    """Return a setting's value with each of its numbers times ``size``."""
    return tuple(scaled(item, size) for item in value) if isinstance(value, tuple) else value * size
