"""The libraries that pictures and reports are made with, which a plain installation does not have."""

from __future__ import annotations

from importlib.util import find_spec

from robacc.errors import UsageError


def need(*libraries: str) -> None:
    """Make sure that libraries of the extra ``report`` are there.

    Raises:
        UsageError: one is not; the message says how to install them all.
    """
    missing = [name for name in libraries if find_spec(name) is None]
    if missing:
        raise UsageError(
            f"pictures and reports need {' and '.join(missing)}, which is not installed: pip install 'robacc[report]'"
        )
