"""Parameters of which a part runs by default, and the others with ``-m slow``."""

from collections.abc import Iterable
from typing import Any

import pytest


def some_fast(values: Iterable[Any], step: int) -> list[Any]:
    """Return the parameters, of which each ``step``-th runs by default."""
    return [value if i % step == 0 else pytest.param(value, marks=pytest.mark.slow) for i, value in enumerate(values)]
