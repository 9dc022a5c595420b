"""Calls that must refuse bad input, and what they say."""

from collections.abc import Callable
from typing import Any

import pytest

from robacc.errors import InputError


def problems_of(call: Callable[..., object], *arguments: Any, **options: Any) -> list[str]:
    """The problems that a call names in its refusal of bad input."""
    with pytest.raises(InputError) as caught:
        call(*arguments, **options)
    return [str(problem) for problem in caught.value.problems]
