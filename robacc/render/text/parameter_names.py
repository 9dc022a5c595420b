"""Parameter names in texts of the library, shown as options of the command line.

The library names a parameter of a call in backquotes, as its signature spells it: ```align` needs `against```. On the
terminal the same text reads ``--align needs --against``.
"""

from __future__ import annotations

import re

_MARKED = re.compile(r"""(?<![\w'"`/\\])`([a-z][a-z0-9_]*)(?:=("?)([^\s`"]+)\2)?`(?![\w'"`/\\])""")
"""A name in backquotes, perhaps with a value; not within quotes, where it is text of a user's file."""
_NEGATIVE_OPTIONS = {"empirical": "--named-only", "robust": "--all-rows"}
"""Options that set a parameter to False and are not spelled ``--no-`` and its name."""


def as_options(text: str) -> str:
    """Return ``text`` with every parameter name in backquotes replaced by the option of that name.

    A plain name keeps its length, so lines that are wrapped already stay as they are.

    >>> as_options('`align` needs `against`; try `align="base_frame,tool_frame"` or `shrink=False`')
    '--align needs --against; try --align base_frame,tool_frame or --no-shrink'
    """
    return _MARKED.sub(_option, text)


def _option(match: re.Match[str]) -> str:
    name, value = match[1], match[3]
    option = f"--{name.replace('_', '-')}"
    if value is None or value == "True":
        return option
    if value == "False":
        return _NEGATIVE_OPTIONS.get(name, f"--no-{option.removeprefix('--')}")
    return f"{option} {value}"
