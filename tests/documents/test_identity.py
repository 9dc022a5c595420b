"""Identity of what was tested: from files and texts, with every mistake reported."""

from __future__ import annotations

from pathlib import Path

import pytest

from robacc.documents.identity import IDENTITY, read_identity
from robacc.errors import InputError, UsageError


def test_later_sources_replace_keys_and_the_order_is_that_of_the_page(tmp_path: Path) -> None:
    path = tmp_path / "identity.yaml"
    path.write_text('serial_number: "12345"\nplace: hall 4\ncustomer: A & B\ndate: 2026-11-22\n', encoding="utf-8")
    identity = read_identity([str(path), "place=hall 5 = new", "operator=N. N."])
    assert identity == {
        "customer": "A & B",
        "serial_number": "12345",
        "operator": "N. N.",
        "place": "hall 5 = new",
        "date": "2026-11-22",
    }
    assert list(identity) == [key for key in IDENTITY if key in identity]
    assert read_identity([]) == {}


def test_mistakes(tmp_path: Path) -> None:
    path = tmp_path / "identity.yaml"
    path.write_text("serial: 12345\nplace: [a]\n", encoding="utf-8")
    with pytest.raises(InputError) as caught:
        read_identity([str(path)])
    assert [(problem.line, problem.column) for problem in caught.value.problems] == [(1, "serial"), (2, "place")]
    path.write_text("place:\n", encoding="utf-8")
    with pytest.raises(InputError, match="names nothing of what was tested"):
        read_identity([str(path)])
    with pytest.raises(UsageError, match="unknown key 'operater'; did you mean 'operator'"):
        read_identity(["operater=x"])
    with pytest.raises(UsageError, match="expected one line of text for place"):
        read_identity(["place="])
    with pytest.raises(InputError, match="there is no such file"):
        read_identity([str(tmp_path / "nowhere.yaml")])
