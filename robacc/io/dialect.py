"""Dialect of a text table, separator, decimal sign, comments, and the numbers and units in its fields.

A file is first compared with the documented form (commas, points, the header in the first line). Only a file that is
not of this form is examined further, so that documented files are read exactly as documented.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace

# Number in a field of a text table: its value, or what to do about a field that is no number.

GAPS = frozenset(
    {"", "-", "--", "---", "----", "nan", "-nan", "inf", "-inf", "+inf", "n/a", "#n/a", "na", "null", "none"}
)
"""Entries for a value that was not measured, in small letters."""
_GROUPED_BEFORE_POINT = re.compile(r"[+-]?\d{1,3}((,\d{3})+\.\d*|('\d{3})+(\.\d*)?|( \d{3})+\.\d*)")
_GROUPED_BEFORE_COMMA = re.compile(r"[+-]?\d{1,3}((\.\d{3})+,\d*|('\d{3})+(,\d*)?|( \d{3})+,\d*)")
_THOUSANDS = re.compile(r"[+-]?\d{1,3}([.,' ]\d{3})+([.,]\d*)?")
_WITH_UNIT = re.compile(r"[+-]?\d+([.,]\d*)?\s*(mm|m|um|µm|in|deg|rad|°|%)", re.IGNORECASE)
_SIGNS = str.maketrans({"\u2212": "-", "\u2019": "'", "\u00a0": " ", "\u202f": " "})
"""Minus, apostrophe and unbreakable blanks of typesetting."""


def is_grouped(field: str, decimal_comma: bool) -> bool:
    """Return whether a number has separators of thousands that cannot be its decimal sign: ``1,903.5``, ``1'903``."""
    grouped = _GROUPED_BEFORE_COMMA if decimal_comma else _GROUPED_BEFORE_POINT
    return bool(grouped.fullmatch(field.translate(_SIGNS)))


def number_of(field: str, decimal_comma: bool) -> float | None:
    """Return the value of a field, which may be infinite or NaN; None for a field that is no number."""
    text = field.translate(_SIGNS)
    if is_grouped(text, decimal_comma):
        text = re.sub(r"[.' ]" if decimal_comma else r"[,' ]", "", text)
    if decimal_comma:
        # A point alone may be a decimal sign or separate thousands.
        text = text.replace(".", "_").replace(",", ".")
    try:
        # float() also accepts 1_000 and digits of other scripts, which are not numbers in a CSV file.
        return float(text) if text.isascii() and "_" not in text else None
    except ValueError:
        return None


def for_spreadsheet(text: str) -> str:
    """Return a text that a spreadsheet does not run as a formula: with an apostrophe before a sign of one."""
    return f"'{text}" if text[:1] in ("=", "+", "-", "@") and number_of(text, False) is None else text


def from_spreadsheet(text: str) -> str:
    """Return the text that :func:`for_spreadsheet` marked, without its apostrophe; any other text as it is."""
    return text[1:] if text and for_spreadsheet(text[1:]) == text else text


def advice(field: str, column: str, decimal_comma: bool) -> str | None:
    """Return what to do about a field that is no number."""
    if field == column:
        return "delete the repeated header row"
    if _WITH_UNIT.fullmatch(field):
        return "write the number alone, and the unit in the column's name"
    if not decimal_comma and field.count(",") == 1 and field.replace(",", "").lstrip("+-").isdecimal():
        if _THOUSANDS.fullmatch(field):
            return f"the comma may separate thousands: write {field.replace(',', '')} or {field.replace(',', '.')}"
        return "write decimals with a point, not a comma"
    if _THOUSANDS.fullmatch(field):
        return "export numbers without a separator of thousands"
    if decimal_comma and "." in field:
        return "the file has decimal commas; a point could separate thousands"
    return None


# Units behind the numbers of a table: ``381.289 mm``, ``33.5°``.

UNIT_NAMES: Mapping[str, str] = {
    **dict.fromkeys(("m", "meter", "meters", "metre", "metres"), "m"),
    **dict.fromkeys(("mm", "millimeter", "millimeters", "millimetre", "millimetres"), "mm"),
    **dict.fromkeys(("cm", "centimeter", "centimeters", "centimetre", "centimetres"), "cm"),
    **dict.fromkeys(("um", "µm", "μm", "micron", "microns", "micrometer", "micrometre"), "um"),
    **dict.fromkeys(("in", "inch", "inches"), "in"),
    **dict.fromkeys(("rad", "radian", "radians"), "rad"),
    **dict.fromkeys(("mrad",), "mrad"),
    **dict.fromkeys(("deg", "°", "degree", "degrees", "degré", "degrés", "grado", "grados", "gradi"), "deg"),
    **dict.fromkeys(("s", "sec", "second", "seconds"), "s"),
    **dict.fromkeys(("ms", "msec"), "ms"),
    **dict.fromkeys(("us", "µs"), "us"),
    **dict.fromkeys(("ns", "nsec"), "ns"),
    **dict.fromkeys(("min",), "min"),
    **dict.fromkeys(("h",), "h"),
    **dict.fromkeys(("kg",), "kg"),
    **dict.fromkeys(("g",), "g"),
    **dict.fromkeys(("°c", "c", "degc", "deg c", "celsius"), "degC"),
}
"""Unit by its name in small letters."""
_NUMBER_AND_UNIT = re.compile(r"([+\-\u2212]?[\d.,][\d.,' \u2019]*(?:[eE][+-]?\d+)?)\s*([^\d\s.,'+-].*)")
_CELLS_EXAMINED = 50
"""First rows in which the unit of a column is looked for."""


def split_cell(text: str) -> tuple[str, str | None]:
    """Return a cell's number and the unit behind it; the text as it is and None where there is no known unit."""
    if not text or text[-1].isdecimal():
        return text, None
    match = _NUMBER_AND_UNIT.fullmatch(text)
    unit = UNIT_NAMES.get(match[2].strip().lower()) if match else None
    return (text, None) if match is None or unit is None else (match[1].strip(), unit)


def units_of_columns(rows: Iterable[Sequence[str]]) -> dict[int, str]:
    """Return the unit in the first cell of each column that has one there; empty cells do not count."""
    first: dict[int, str | None] = {}
    for number, row in enumerate(rows):
        if number == _CELLS_EXAMINED:
            break
        for i, text in enumerate(row):
            if i not in first and any(sign.isdecimal() for sign in text):
                first[i] = split_cell(text)[1]
    return {i: unit for i, unit in first.items() if unit is not None}


NUMBER_POINT = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
_NUMBER_COMMA = re.compile(r"[+-]?(\d+,\d*|,\d+)([eE][+-]?\d+)?")
_DECIMAL = re.compile(r"[+-]?\d*[.,]\d+")
"""Number that is no name of a column, as a plain 1 may be."""
_COMMENTS = ("#", "//", "%", "!")
_MARK = re.compile(r"^\s*(#+|//+|%+|!+)\s*")
"""Beginning of a comment."""
_SEPARATORS: tuple[str | None, ...] = ("\t", ";", ",", "|", None)
"""None: one or more blanks. Of separators that fit equally well the first is taken."""
_STATISTIC = re.compile(
    r"(mittelwert|mittel|mean|average|avg|std\.?( ?dev\.?)?|standardabweichung|sigma|rms|min\.?|max\.?|minimum"
    r"|maximum|median|range|spannweite|sum|summe|total|count|anzahl)\W*",
    re.IGNORECASE,
)
"""First field of a line below a table that sums it up."""
_EXAMINED = 400
"""Lines that are examined; no instrument writes a longer preamble."""
_SAMPLED = 100
"""First lines of the table that are kept as a sample; of numbers without names they show the arm's motion."""
_FEWEST_NUMBERS = 2
"""Fields with numbers that make a line a row of measurements."""
_REMARKS = frozenset({"", "comment", "kommentar", "remark", "bemerkung", "commentaire"})
"""Names of a last column that every row may leave out with its separator."""
_ABOVE = 3
"""Lines above the first row in which its header is looked for: names, and units in a line of their own."""
_UNIT_BEHIND = re.compile(r"\s*[\[(<{][^\])>}]*[\])>}]\s*$")
"""Unit in brackets at the end of a name."""
_UNIT_FIELD = re.compile(
    r"[\[(<{]?\s*(m|mm|cm|um|µm|μm|in|inch|(milli)?met(er|re)s?|rad|mrad|radians?|deg|degrees?|Grad|grados?|gradi|degrés?|°|s|ms|sec|kg|°C|degC|C|-|)"
    r"\s*[\])>}]?"
)


@dataclass(frozen=True, slots=True)
class TableDialect:
    """Form of one text table."""

    separator: str | None = ","
    """One character; None stands for any number of blanks."""
    decimal_comma: bool = False
    comments: tuple[str, ...] = ("#",)
    """Beginnings of lines that are skipped."""
    header_line: int | None = None
    """0-based index of the line of names; None: the first line that is no comment."""
    first_row: int = 0
    """0-based index of the first row of measurements below the header."""
    names: tuple[str, ...] = ()
    """Names of the columns, with their units where a line of its own gives them; empty without a header."""
    preamble: tuple[str, ...] = field(default=(), repr=False)
    """Lines above the rows that are neither names nor blank."""
    sample: tuple[tuple[str, ...], ...] = field(default=(), repr=False)
    """Fields of the first rows."""

    def description(self) -> str:
        """Return the deviations from the documented form, for a message; empty without any."""
        names = {"\t": "tabs", ";": "semicolons", "|": "bars", None: "blanks"}
        parts = [f"separated by {names[self.separator]}"] if self.separator in names else []
        if self.decimal_comma:
            parts.append("decimal comma")
        return ", ".join(parts)

    def split(self, line: str) -> list[str]:
        """Return the fields of a line, stripped and without quotes.

        Raises:
            csv.Error: Quotes do not match.
        """
        if self.separator is None:
            return line.split()
        if '"' not in line:
            return [part.strip() for part in line.split(self.separator)]
        reader = csv.reader((line,), delimiter=self.separator, strict=True, skipinitialspace=True)
        return [part.strip() for part in next(reader)]

    def is_row(self, line: str) -> bool:
        """Return whether a line is neither blank nor a comment."""
        stripped = line.lstrip()
        return bool(stripped) and not stripped.startswith(self.comments)

    def is_footer(self, line: str, width: int) -> bool:
        """Return whether a line at the file's end is no row: blank, a mean, or few texts that are not a row's names."""
        fields = _split(self, line) if self.is_row(line) else []
        texts = {i: text for i, text in enumerate(fields) if text.lower() not in GAPS}
        first = dict(enumerate(self.sample[0] if self.sample else ()))
        return (
            len(texts) <= width / 2
            and not any(map(self.is_number, texts.values()))
            and (
                not texts
                or len(fields) != width
                or any(self.is_number(first.get(i, "")) for i in texts)
                or all(text.count(" ") > max(1, first.get(i, "").count(" ")) for i, text in texts.items())  # prose
            )
        ) or bool(_STATISTIC.fullmatch(next(iter(texts.values()), "")))

    def is_number(self, text: str) -> bool:
        """Return whether a field is a number in this dialect, with or without a unit behind it."""
        text = split_cell(text)[0]
        return bool(NUMBER_POINT.fullmatch(text) or (self.decimal_comma and _NUMBER_COMMA.fullmatch(text)))


PLAIN = TableDialect()
"""The documented form."""


def find_dialect(lines: Sequence[str], is_known: Callable[[str], bool]) -> TableDialect | None:
    """Return the dialect of a table that begins with these lines; None for the documented form and for no table.

    Args:
        lines: First lines of the file, without their ends.
        is_known: Whether a name is a documented column name.
    """
    head = next((line for line in lines if PLAIN.is_row(line)), None)
    if head is None or any(is_known(name) for name in _split(PLAIN, head)):
        return None
    declared = re.fullmatch(r"\s*sep=(.)\s*", lines[0])  # by a spreadsheet program
    candidates = [
        candidate
        for separator in ((declared[1],) if declared else _SEPARATORS)
        if (candidate := _candidate(list(lines[:_EXAMINED]), separator, is_known)) is not None
    ]
    if not candidates:
        # A table with one number in each row is told from other text by its names.
        single = (_candidate(list(lines[:_EXAMINED]), separator, is_known, fewest=1) for separator in (";", "\t", "|"))
        candidates = [candidate for candidate in single if candidate is not None and len(candidate[1].names) > 2]
    if candidates:
        return max(candidates, key=lambda item: item[0])[1]
    return _without_rows(head, lines.index(head), is_known)


def _without_rows(head: str, line: int, is_known: Callable[[str], bool]) -> TableDialect | None:
    """Return the dialect of a header without rows, judged by its names."""
    for separator in _SEPARATORS:
        dialect = TableDialect(separator)
        names = _split(dialect, head)
        if len(names) > 1 and sum(map(is_known, names)) > len(names) / 2:
            return TableDialect(separator, header_line=line, first_row=line + 1, names=tuple(names))
    return None


def _candidate(
    lines: list[str], separator: str | None, is_known: Callable[[str], bool], fewest: int = _FEWEST_NUMBERS
) -> tuple[tuple[int, bool, int], TableDialect] | None:
    """Return the best table with this separator and its score; None where there is none."""
    dialect = TableDialect(separator, comments=_COMMENTS)
    grid = [_split(dialect, line) for line in lines]
    if separator != ",":
        texts = [split_cell(text)[0] for line, fields in zip(lines, grid, strict=True) for text in fields
                 if dialect.is_row(line)]  # fmt: skip
        points = sum("." in text and NUMBER_POINT.fullmatch(text) is not None for text in texts)
        commas = sum(_NUMBER_COMMA.fullmatch(text) is not None for text in texts)
        dialect = replace(dialect, decimal_comma=commas > points)
    best: tuple[int, int, int] | None = None  # rows, start, fields
    start, width, rows = 0, 0, 0
    first_of_width: dict[int, int] = {}  # of the rows since the last line without numbers
    for i, (line, fields) in enumerate(zip(lines, grid, strict=True)):
        if not dialect.is_row(line):
            continue
        numbers = sum(map(dialect.is_number, fields))
        gaps = sum(text.lower() in GAPS for text in fields if text)
        if rows and not numbers and gaps >= fewest and len(fields) == width:
            continue  # a row whose values are all missing
        if not numbers or numbers + gaps < fewest:
            rows = 0
            first_of_width = {}
            continue
        if rows == 0 or len(fields) != width:
            # A row of another width, such as one with a separator in a text, does not begin another table.
            start, width, rows = first_of_width.setdefault(len(fields), i), len(fields), 0
        rows += 1
        if best is None or rows > best[0]:
            best = (rows, start, width)
    if best is None:
        return None
    rows, start, width = best
    result = _with_header(lines, grid, dialect, start, is_known)
    # Names above the rows are as good as twice as many rows: a text may split into more fields at blanks.
    return (rows * (2 if result.names else 1), separator is not None, width), result


def _with_header(
    lines: list[str], grid: list[list[str]], dialect: TableDialect, start: int, is_known: Callable[[str], bool]
) -> TableDialect:
    """Return the dialect with the names that stand above the first row, if there are any; ``grid`` are the fields."""
    width = len(grid[start])
    names: tuple[str, ...] = ()
    units: list[str] | None = None
    header_line = None
    alike = [i for i in range(start) if len(grid[i]) == width]
    # Below the first line with as many fields as the rows, a line with a number is a row.
    rows_above = {i for i in alike[1:] if any(map(dialect.is_number, grid[i]))}
    above = [i for i in range(start - 1, -1, -1) if lines[i].strip() and i not in rows_above][:_ABOVE]
    for i in above:
        # An uncommented line decides; a comment gives names only if it has as many fields as the rows.
        line, marked = lines[i], grid[i]
        if len(marked) != width or marked[0] != "#":  # else the name of a count
            line = _MARK.sub("", line).strip() if _MARK.match(line) else line
        fields = _split(dialect, line if dialect.separator else re.sub(r"\s+(?=[\[(])", "", line))
        if len(fields) > width and sum(is_known(_UNIT_BEHIND.sub("", text).lower()) for text in fields) > 1:
            # Words of the first name, or a last column that every row leaves out.
            extra = 0 if dialect.separator else len(fields) - width
            fields = [" ".join(fields[: extra + 1]), *fields[extra + 1 :]][:width]
        if len(fields) == width + 1 and fields[-1].lower() in _REMARKS:
            fields = fields[:-1]
        if len(fields) == width - 1 and not grid[start][-1]:
            fields = [*fields, ""]  # every row ends with a separator
        if len(fields) != width or _is_gap(fields) or any(map(_DECIMAL.fullmatch, fields)):
            continue
        if units is None and all(_UNIT_FIELD.fullmatch(text) for text in fields) and any(fields):
            units = fields
            continue
        if sum(bool(text) and not dialect.is_number(text) for text in fields) > width / 2:
            names, header_line = _with_groups(tuple(fields), grid[:i]), i
            break
    if names and units is not None:
        names = tuple(f"{name} [{unit.strip('[]()<>{} ')}]" if unit.strip("[]()<>{} -") else name
                      for name, unit in zip(names, units, strict=True))  # fmt: skip
    preamble = tuple(line for i, line in enumerate(lines[:start]) if line.strip() and i != header_line)
    rows = [tuple(grid[i]) for i in range(start, min(start + _SAMPLED, len(lines))) if dialect.is_row(lines[i])]
    if names and header_line is not None:
        # Rows of another width below the names are rows too: the reader reports them.
        start = next(
            (
                i
                for i in range(header_line + 1, start)
                if dialect.is_row(lines[i])
                if sum(map(dialect.is_number, grid[i])) >= _FEWEST_NUMBERS
                or _is_gap(grid[i])
                or (len(grid[i]) == width and any(grid[i]) and all(map(dialect.is_number, filter(None, grid[i]))))
            ),
            start,
        )
    return replace(
        dialect, header_line=header_line, first_row=start, names=names, preamble=preamble, sample=tuple(rows)
    )


def _is_gap(fields: Sequence[str]) -> bool:
    """Return whether a row has missing values, such as ``---``, and is no line of units (``-`` is a unit too)."""
    marks = sum(text.lower() in GAPS for text in fields if text)
    return marks >= _FEWEST_NUMBERS and not all(map(_UNIT_FIELD.fullmatch, fields))


def _with_groups(names: tuple[str, ...], above: Sequence[Sequence[str]]) -> tuple[str, ...]:
    """Return names with their group in the line above where a name is repeated: ``Position X``, ``Rotation X``.

    A group applies to the columns to its right up to the next group.
    """
    for groups in reversed(above[-_ABOVE:]):
        stems = [_UNIT_BEHIND.sub("", name) for name in names]
        repeated = {stem for stem in stems if stem and stems.count(stem) > 1}
        if not repeated or len(groups) != len(names):
            break
        filled = [next((text for text in reversed(groups[: i + 1]) if text), "") for i in range(len(names))]
        ambiguous = {group for group, stem in zip(filled, stems, strict=True) if stem in repeated}
        names = tuple(
            f"{group} {name}".strip() if group in ambiguous or not name else name
            for group, name in zip(filled, names, strict=True)
        )
    # A spreadsheet merges the name of a column over both lines.
    upper = above[-1] if above else []
    if len(upper) == len(names) and sum(map(bool, upper)) > 1:
        names = tuple(name or text for name, text in zip(names, upper, strict=True))
    return names


def _split(dialect: TableDialect, line: str) -> list[str]:
    try:
        return dialect.split(line)
    except csv.Error:
        return []
