"""Identity of what was tested, for a report: the arm's serial number, the instrument, who measured where and when."""

from __future__ import annotations

import os
from collections.abc import Sequence

from robacc.errors import InputError, Problem, UsageError
from robacc.robots.description import IDENTITY
from robacc.robots.description import read_identity as read_section


def read_identity(sources: Sequence[str]) -> dict[str, str]:
    """Return the identity of YAML files and of texts ``key=value``; a later source replaces a key of an earlier one.

    Raises:
        InputError: A file cannot be read, has an unknown key or a value that is not one line of text.
        UsageError: A text has an unknown key.
    """
    identity: dict[str, str] = {}
    for source in sources:
        key, sign, value = source.partition("=")
        if sign and not os.path.isfile(source):
            identity |= _pair(key.strip(), value.strip())
        else:
            identity |= _file(source)
    return {key: identity[key] for key in IDENTITY if key in identity}


def _pair(key: str, value: str) -> dict[str, str]:
    from robacc.io.yaml_nodes import nearest

    if key not in IDENTITY:
        fix = nearest(key, tuple(IDENTITY)) or f"known keys: {', '.join(IDENTITY)}"
        raise UsageError(f"`identity`: unknown key {key!r}; {fix}")
    if not value or not value.isprintable():
        raise UsageError(f"`identity`: expected one line of text for {key}, found {value!r}")
    return {key: value}


def _file(path: str) -> dict[str, str]:
    from robacc.io.files import read_text
    from robacc.io.yaml_nodes import Source, compose

    source = Source(path)
    top = source.section(compose(read_text(path), path), "", tuple(IDENTITY))
    identity = {} if top is None else read_section(top)
    source.finish()
    if not identity:
        fix = f"write at least one of {', '.join(IDENTITY)}"
        raise InputError(Problem("names nothing of what was tested", path, fix=fix))
    return identity
