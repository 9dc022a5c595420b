"""CSV text from columns reads back as the columns."""

from __future__ import annotations

import csv
import io

from robacc.documents.envelope import csv_text


def test_cells_of_any_text_read_back() -> None:
    texts = ["P1", "a,b", 'say "a"', 'say "a", b', "two\nlines", "two\r\nlines", ""]
    text = csv_text({"name": texts, "number": range(len(texts)), "none": None})
    rows = list(csv.reader(io.StringIO(text, newline="")))
    assert rows == [["name", "number"], *([name, str(i)] for i, name in enumerate(texts))]


def test_no_rows_leave_the_header() -> None:
    assert csv_text({"a": [], "b": []}) == "a,b\n"
