"""Pose files as text, which several test modules read."""

from collections.abc import Callable
from typing import Any

import pytest

from robacc import InputError, Measurements

PLAIN = "q1,q2,x,y,z\n0.1,0.2,1,2,3\n-0.1,0.3,1.5,2.5,3.5\n"
Reader = Callable[..., Measurements]
"""Reads text or bytes as a file called poses.csv: the fixture ``read``."""


def problem_texts(reader: Reader, text: str | bytes, **options: Any) -> list[str]:
    """The problems of a file that must have some, without the folder's name."""
    with pytest.raises(InputError) as caught:
        reader(text, **options)
    return [str(problem).partition("poses.csv")[2].lstrip(":") for problem in caught.value.problems]


def one_row(**columns: object) -> str:
    """A file of one pose at joint 0.1, position 1, 2, 3 with these columns changed or added."""
    row = {"q1": 0.1, "x": 1, "y": 2, "z": 3} | columns
    return ",".join(row) + "\n" + ",".join(str(value) for value in row.values()) + "\n"
