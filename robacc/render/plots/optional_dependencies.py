"""The optional libraries that charts and reports need."""

from __future__ import annotations

from importlib.util import find_spec

from robacc.errors import UsageError, install_advice


def need(*libraries: str) -> None:
    """Raise an error if a library of the extra ``report`` is missing.

    Raises:
        UsageError: a library is not installed; the message says how to install the extra.
    """
    missing = [name for name in libraries if find_spec(name) is None]
    if missing:
        raise UsageError(
            f"charts and reports need {' and '.join(missing)}, which is not installed; run {install_advice('report')}"
        )
