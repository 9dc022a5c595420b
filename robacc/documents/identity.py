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
    from robacc.io.files import read_text
    from robacc.io.yaml_nodes import Source, compose, nearest

    identity: dict[str, str] = {}
    for source in sources:
        key, sign, value = (word.strip() for word in source.partition("="))
        if not sign or os.path.isfile(source):
            file = Source(source)
            top = file.section(compose(read_text(source), source), "", tuple(IDENTITY))
            stated = {} if top is None else read_section(top)
            file.finish()
            if not stated:
                fix = f"write at least one of {', '.join(IDENTITY)}"
                raise InputError(Problem("names nothing of what was tested", source, fix=fix))
            identity |= stated
        elif key not in IDENTITY:
            fix = nearest(key, tuple(IDENTITY)) or f"known keys: {', '.join(IDENTITY)}"
            raise UsageError(f"`identity`: unknown key {key!r}; {fix}")
        elif not value or not value.isprintable():
            raise UsageError(f"`identity`: expected one line of text for {key}, found {value!r}")
        else:
            identity[key] = value
    return {key: identity[key] for key in IDENTITY if key in identity}
