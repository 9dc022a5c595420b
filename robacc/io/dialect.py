"""Dialect of a text table, separator, decimal sign, comments, and the numbers and units in its fields.

A file is first compared with the documented form (commas, points, the header in the first line). Only a file that is
not of this form is examined further, so that documented files are read exactly as documented.
"""

import csv
import itertools
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import NamedTuple

# Number in a field of a text table: its value, or what to do about a field that is no number.

GAPS = frozenset(
    {"", "-", "--", "---", "----", "nan", "-nan", "inf", "-inf", "+inf", "n/a", "#n/a", "na", "null", "none"}
)
"""Entries for a value that was not measured, in small letters."""
_GROUPED_BEFORE_POINT = r"[+-]?\d{1,3}((,\d{3})+\.\d*|('\d{3})+(\.\d*)?|( \d{3})+\.\d*)"
_GROUPED_BEFORE_COMMA = r"[+-]?\d{1,3}((\.\d{3})+,\d*|('\d{3})+(,\d*)?|( \d{3})+,\d*)"
_SIGNS = str.maketrans({"\u2212": "-", "\u2019": "'", "\u00a0": " ", "\u202f": " "})
"""Minus, apostrophe and unbreakable blanks of typesetting."""

_SPLITTING = frozenset(',"\n\r')
"""Signs at which a reader of a CSV would split a text without quotes."""


def is_grouped(field: str, decimal_comma: bool) -> bool:
    """Return whether a number has separators of thousands that cannot be its decimal sign: ``1,903.5``, ``1'903``."""
    grouped = _GROUPED_BEFORE_COMMA if decimal_comma else _GROUPED_BEFORE_POINT
    return bool(re.fullmatch(grouped, field.translate(_SIGNS)))


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


def cell(text: str) -> str:
    """Return a text as a field of a CSV, in quotes where a reader would split it; a spreadsheet runs none."""
    text = for_spreadsheet(text)
    return text if _SPLITTING.isdisjoint(text) else '"' + text.replace('"', '""') + '"'


def from_spreadsheet(text: str) -> str:
    """Return the text that :func:`for_spreadsheet` marked, without its apostrophe; any other text as it is."""
    return text[1:] if text and for_spreadsheet(text[1:]) == text else text


def advice(field: str, column: str, decimal_comma: bool) -> str | None:
    """Return what to do about a field that is no number."""
    bare, may_group = field.replace(",", ""), re.fullmatch(r"[+-]?\d{1,3}([.,' ]\d{3})+([.,]\d*)?", field)
    has_comma = not decimal_comma and field.count(",") == 1 and bare.lstrip("+-").isdecimal()
    either = f"the comma may separate thousands: write {bare} or {field.replace(',', '.')}"
    with_unit = re.fullmatch(r"[+-]?\d+([.,]\d*)?\s*(mm|m|um|µm|in|deg|rad|°|%)", field, re.IGNORECASE)
    rules = (
        (field == column, "delete the repeated header row"),
        (with_unit, "write the number alone, and the unit in the column's name"),
        (has_comma and may_group, either),
        (has_comma, "write decimals with a point, not a comma"),
        (may_group, "export numbers without a separator of thousands"),
        (decimal_comma and "." in field, "the file has decimal commas; a point could separate thousands"),
    )
    return next((text for applies, text in rules if applies), None)


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
    # First rows in which the unit of a column is looked for.
    for row in itertools.islice(rows, 50):
        for i, text in enumerate(row):
            if i not in first and any(sign.isdecimal() for sign in text):
                first[i] = split_cell(text)[1]
    return {i: unit for i, unit in first.items() if unit is not None}


NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
_MARK = r"^\s*(#+|//+|%+|!+)\s*"
"""Beginning of a comment."""
_SEPARATORS: tuple[str | None, ...] = ("\t", ";", ",", "|", None)
"""None: one or more blanks. Of separators that fit equally well the first is taken."""
_STATISTIC = re.compile(
    r"(?i)(mittelwert|mittel|mean|average|avg|std\.?-?( ?(dev|abw)\.?)?|standardabweichung|sigma|rms|min\.?|max\.?"
    r"|minimum|maximum|median|range|spannweite|sum|summe|total|count|anzahl|moyenne|promedio|media|ø|\d?σ|平均值?)\W*"
)
"""First field of a line in or below a table that sums it up."""
_FEWEST_NUMBERS = 2
"""Fields with numbers that make a line a row of measurements."""
_ABOVE = 3
"""Lines above the first row in which its header is looked for: names, and units in a line of their own."""
_UNIT_BEHIND = r"\s*[\[(<{][^\])>}]*[\])>}]\s*$"
"""Unit in brackets at the end of a name."""
_UNIT_FIELD = (
    r"[\[(<{]?\s*(m|mm|cm|um|µm|μm|in|inch|(milli)?met(er|re)s?|rad|mrad|radians?|deg|degrees?|Grad|grados?|gradi|degrés?|°|s|ms|sec|kg|°C|degC|C|-|)"
    r"\s*[\])>}]?"
)


class TableDialect(NamedTuple):
    """Form of one text table."""

    separator: str | None = ","
    """One character; None stands for any number of blanks."""
    decimal_comma: bool = False
    comments: tuple[str, ...] = ("#",)
    """Beginnings of lines that are skipped."""
    header_line: int | None = None
    """0-based index of the line of names; None without a header."""
    first_row: int = 0
    """0-based index of the first row of measurements below the header."""
    names: tuple[str, ...] = ()
    """Names of the columns, with their units where a line of its own gives them; empty without a header."""
    preamble: tuple[str, ...] = ()
    """Lines above the rows that are neither names nor blank."""
    sample: tuple[tuple[str, ...], ...] = ()
    """Fields of the first rows."""
    is_documented: bool = False
    """Whether the table has the documented form: commas, points, and documented names in its first line."""

    def description(self) -> str:
        """Return the deviations from the documented form, for a message; empty without any."""
        names = {"\t": "tabs", ";": "semicolons", "|": "bars", None: "blanks"}
        separated = f"separated by {names[self.separator]}" if self.separator in names else ""
        return ", ".join(filter(None, (separated, "decimal comma" * self.decimal_comma)))

    def split(self, line: str) -> list[str]:
        """Return the fields of a line, stripped and without quotes.

        Raises:
            csv.Error: Quotes do not match.
        """
        if self.separator is None:
            return line.split()
        fields = (
            next(csv.reader((line,), delimiter=self.separator, strict=True, skipinitialspace=True))
            if '"' in line
            else line.split(self.separator)
        )
        return [part.strip() for part in fields]

    def fields(self, line: str) -> list[str]:
        """Return the fields of a line as :meth:`split` does; none where quotes do not match."""
        try:
            return self.split(line)
        except csv.Error:
            return []

    def is_row(self, line: str) -> bool:
        """Return whether a line is neither blank, nor separators alone, as spreadsheets write one, nor a comment."""
        return bool(line.strip(' \t\r\n,;|"')) and not line.lstrip().startswith(self.comments)

    def is_footer(self, line: str, width: int) -> bool:
        """Return whether a line at the file's end is no row: blank, a mean, or few texts that are not a row's names."""
        fields = self.fields(line) if self.is_row(line) else []
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
        ) or self.are_statistics([line])[0]

    def are_statistics(self, lines: Iterable[str]) -> list[bool]:
        """Return whether each line sums up others, as a mean does; one that begins as a number does is told at once."""
        return [
            line[:1] not in "+-.0123456789"
            and _STATISTIC.match(line.lstrip(' \t,;|"')) is not None
            and _STATISTIC.fullmatch(next(filter(None, self.fields(line)), "")) is not None
            for line in lines
        ]

    def is_number(self, text: str) -> bool:
        """Return whether a field is a number in this dialect, with or without a unit behind it."""
        text = split_cell(text)[0]
        return bool(NUMBER.fullmatch(text) or (self.decimal_comma and NUMBER.fullmatch(text.replace(",", "."))))


PLAIN = TableDialect(is_documented=True)
"""The documented form."""


def find_dialect(lines: Sequence[str], is_known: Callable[[str], bool]) -> TableDialect:
    """Return the dialect of a table that begins with these lines; the documented one for what is no table.

    Args:
        lines: First lines of the file, without their ends; one is neither blank nor a comment.
        is_known: Whether a name is a documented column name.
    """
    at = next(i for i, line in enumerate(lines) if PLAIN.is_row(line))
    documented = PLAIN._replace(header_line=at, first_row=at + 1)
    if any(map(is_known, PLAIN.fields(lines[at]))):
        return documented
    declared = re.fullmatch(r"\s*sep=(.)\s*", lines[0])  # by a spreadsheet program
    # A table with one number in each row is told from other text by its names.
    ways = ((_FEWEST_NUMBERS, 0, (declared[1],) if declared else _SEPARATORS), (1, 3, (";", "\t", "|")))
    for fewest, least_names, separators in ways:
        # Lines that are examined; no instrument writes a longer preamble.
        tables = (_table(list(lines[:400]), separator, is_known, fewest) for separator in separators)
        scored = [table for table in tables if table is not None and len(table[1].names) >= least_names]
        if scored:
            return max(scored, key=lambda table: table[0])[1]
    # A header without rows is judged by its names.
    headers = (documented._replace(separator=sign, is_documented=False) for sign in _SEPARATORS)
    named = (header._replace(names=tuple(header.fields(lines[at]))) for header in headers)
    return next(
        (item for item in named if len(item.names) > 1 and sum(map(is_known, item.names)) > len(item.names) / 2),
        documented,
    )


def _table(
    lines: list[str], separator: str | None, is_known: Callable[[str], bool], fewest: int
) -> tuple[tuple[int, bool, int], TableDialect] | None:
    """Return the longest table with this separator, and its score; None where no line has ``fewest`` numbers."""
    # A line below the names of a table with bars.
    dialect = TableDialect(separator, comments=("#", "//", "%", "!", "|--", "| --", "|:-", "| :-", "+--"))
    grid = [dialect.fields(line) for line in lines]
    if separator != ",":
        rows = (fields for line, fields in zip(lines, grid, strict=True) if dialect.is_row(line))
        texts = [split_cell(text)[0] for text in itertools.chain.from_iterable(rows)]
        points = sum("." in text and NUMBER.fullmatch(text) is not None for text in texts)
        commas = sum("," in text and NUMBER.fullmatch(text.replace(",", ".")) is not None for text in texts)
        dialect = dialect._replace(decimal_comma=commas > points)
    tables: dict[tuple[int, int], list[int]] = {}  # rows by the line without numbers above them, and their width
    above = 0
    for i, (line, fields) in enumerate(zip(lines, grid, strict=True)):
        if not dialect.is_row(line):
            continue
        numbers = sum(map(dialect.is_number, fields))
        gaps = sum(text.lower() in GAPS for text in fields if text)
        if numbers and numbers + gaps >= fewest:
            # A row of another width, such as one with a separator in a text, does not begin another table.
            tables.setdefault((above, len(fields)), []).append(i)
        elif numbers or gaps < fewest:  # else all values of a row are missing
            above = i
    if not tables:
        return None
    longest = max(tables.values(), key=len)
    result = _with_header(lines, grid, dialect, longest[0], is_known)
    # Names above the rows are as good as twice as many rows: a text may split into more fields at blanks.
    return (len(longest) * (2 if result.names else 1), separator is not None, len(grid[longest[0]])), result


def _with_header(
    lines: list[str], grid: list[list[str]], dialect: TableDialect, start: int, is_known: Callable[[str], bool]
) -> TableDialect:
    """Return the dialect with the names that stand above the first row, if there are any; ``grid`` are the fields."""
    width = len(grid[start])
    names: tuple[str, ...] = ()
    units: list[str] | None = None
    header_line, first_row = None, start
    as_wide = [i for i in range(start) if len(grid[i]) == width]
    # Below the first line with as many fields as the rows, a line with a number is a row.
    rows_above = {i for i in as_wide[1:] if any(map(dialect.is_number, grid[i]))}
    for i in [i for i in range(start - 1, -1, -1) if lines[i].strip() and i not in rows_above][:_ABOVE]:
        fields = _names_in(lines[i], grid[i], grid[start], dialect, is_known)
        if len(fields) != width or _is_gap(fields) or any(re.fullmatch(r"[+-]?\d*[.,]\d+", text) for text in fields):
            continue
        if units is None and all(re.fullmatch(_UNIT_FIELD, text) for text in fields) and any(fields):
            units = fields
        elif sum(bool(text) and not dialect.is_number(text) for text in fields) > width / 2:
            names, header_line = _with_groups(tuple(fields), grid[:i]), i
            # Rows of another width below the names are rows too: the reader reports them.
            below = (
                j for j in range(i + 1, start) if dialect.is_row(lines[j]) and _is_measured(grid[j], width, dialect)
            )
            first_row = next(below, start)
            break
    if names and units is not None:
        stems = [unit.strip("[]()<>{} ") for unit in units]
        names = tuple(f"{name} [{unit}]" if unit.strip("-") else name for name, unit in zip(names, stems, strict=True))
    preamble = tuple(line for i, line in enumerate(lines[:start]) if line.strip() and i != header_line)
    # Of numbers without names, the first lines show the arm's motion.
    rows = tuple(tuple(grid[i]) for i in range(start, min(start + 100, len(lines))) if dialect.is_row(lines[i]))
    return dialect._replace(header_line=header_line, first_row=first_row, names=names, preamble=preamble, sample=rows)


def _names_in(
    line: str, marked: list[str], row: list[str], dialect: TableDialect, is_known: Callable[[str], bool]
) -> list[str]:
    """Return the fields of a line above the rows, which may be a comment, as one for each field of the first row.

    An uncommented line decides; a comment gives names only if it has as many fields as the rows.
    """
    width = len(row)
    if len(marked) != width or marked[0] != "#":  # else the name of a count
        line = re.sub(_MARK, "", line).strip() if re.match(_MARK, line) else line
    fields = dialect.fields(line if dialect.separator else re.sub(r"\s+(?=[\[(])", "", line))
    if len(fields) > width and sum(is_known(re.sub(_UNIT_BEHIND, "", text).lower()) for text in fields) > 1:
        # Words of the first name, or a last column that every row leaves out.
        extra = 0 if dialect.separator else len(fields) - width
        fields = [" ".join(fields[: extra + 1]), *fields[extra + 1 :]][:width]
    # A column of remarks, which every row may leave out with its separator.
    if len(fields) == width + 1 and re.fullmatch(r"|comment(aire)?|kommentar|remark|bemerkung", fields[-1].lower()):
        fields = fields[:-1]
    # Every row may end with a separator.
    return [*fields, ""] if len(fields) == width - 1 and not row[-1] else fields


def _is_measured(fields: Sequence[str], width: int, dialect: TableDialect) -> bool:
    """Return whether a line below the names is a row: with numbers, with gaps, or as wide as the rows."""
    numbers = sum(map(dialect.is_number, fields))
    return (
        numbers >= _FEWEST_NUMBERS
        or _is_gap(fields)
        or (len(fields) == width and 0 < numbers == sum(map(bool, fields)))
    )


def _is_gap(fields: Sequence[str]) -> bool:
    """Return whether a row has missing values, such as ``---``, and is no line of units (``-`` is a unit too)."""
    marks = sum(text.lower() in GAPS for text in fields if text)
    return marks >= _FEWEST_NUMBERS and not all(re.fullmatch(_UNIT_FIELD, text) for text in fields)


def _with_groups(names: tuple[str, ...], above: Sequence[Sequence[str]]) -> tuple[str, ...]:
    """Return names with their group in the line above where a name is repeated: ``Position X``, ``Rotation X``.

    A group applies to the columns to its right up to the next group.
    """
    for groups in reversed(above[-_ABOVE:]):
        stems = [re.sub(_UNIT_BEHIND, "", name) for name in names]
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
