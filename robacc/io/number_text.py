"""Number in a field of a text table: its value, or what to do about a field that is no number."""

from __future__ import annotations

import re

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
