"""Parameters of which a part runs by default, and the others with ``-m slow``."""

from collections.abc import Iterable
from typing import Any

import pytest


def some_fast(values: Iterable[Any], step: int) -> list[Any]:
    """Return the parameters, of which each ``step``-th runs by default; a tuple holds several."""
    parameters = []
    for i, value in enumerate(values):
        several = value if isinstance(value, tuple) else (value,)
        parameters.append(pytest.param(*several, marks=() if i % step == 0 else pytest.mark.slow))
    return parameters
