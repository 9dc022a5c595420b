"""Numbers with units."""

import pytest

from robacc.quantities import parse_quantity


@pytest.mark.parametrize("text", ["20um", "20 um", "20µm", "20 \N{GREEK SMALL LETTER MU}m"])
def test_micrometres_are_read_with_any_of_their_letters(text: str) -> None:
    assert parse_quantity(text) == (pytest.approx(2e-5, rel=1e-12), "length")


@pytest.mark.parametrize("text", ["20 µ", "20 µrd", "mm", "nan mm"])
def test_other_texts_are_no_quantity(text: str) -> None:
    assert parse_quantity(text) is None
