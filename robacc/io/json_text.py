"""JSON text of a result: the same text for the same result, without NaN, which JSON does not have.

Keys keep their order. A list of numbers stands on one line, and a list of lists or records has one item a line, so that
ordinary tools can read and compare a result. Large arrays are encoded in pieces by orjson, in a fifteenth of the time
of Python's encoder; small ones are not, because its import takes longer than their text.
"""

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

_ENCODE = json.JSONEncoder(ensure_ascii=False).encode
_SCALARS = (float, str, int, type(None), np.generic)
_ROWS_AT_ONCE = 4096
"""Rows of an array that are converted to text at a time: some MB of Python objects at most."""


def json_text(document: Mapping[str, Any]) -> str:
    """Return the text of the document, with a newline at its end."""
    return "".join(json_pieces(document))


def json_pieces(document: Mapping[str, Any]) -> Iterator[str]:
    """Yield the text of the document in pieces, in order.

    Leaves may be None, bool, int, float, str, NumPy scalars and arrays; NaN and infinity become null.

    Raises:
        TypeError: a value of the document has no JSON form (a defect).
    """
    yield from _pieces(document, "")
    yield "\n"


def _pieces(value: Any, indent: str) -> Iterator[str]:
    """Yield the text of a value with items."""
    is_record = isinstance(value, dict | Mapping)
    if isinstance(value, np.ndarray) and value.ndim < 3 and value.dtype.kind in "fiub" and len(value) > _ROWS_AT_ONCE:
        yield from _array(value, indent)
    elif isinstance(value, np.ndarray):
        yield from _pieces(value.tolist(), indent)
    elif not value:
        yield "{}" if is_record else "[]"
    elif is_record or any(map(_is_nested, value)):
        items = value.items() if is_record else enumerate(value)
        between = "{\n" if is_record else "[\n"
        for key, item in items:
            label = f"{between}{indent}  {f'{_scalar(str(key))}: ' if is_record else ''}"
            if _is_nested(item):
                yield label
                yield from _pieces(item, f"{indent}  ")
            else:
                yield f"{label}{_scalar(item)}"
            between = ",\n"
        yield f"\n{indent}{'}' if is_record else ']'}"
    else:
        yield "[" + ", ".join(map(_scalar, value)) + "]"


def _is_nested(value: Any) -> bool:
    """Return whether a value has items; the types of most values come first, since the test of others is slow."""
    return not isinstance(value, _SCALARS) and isinstance(value, dict | list | tuple | np.ndarray | Mapping | Sequence)


def _scalar(value: Any) -> str:
    """Return the JSON of a string or number; control and bidirectional characters are escaped for terminals."""
    if isinstance(value, float):  # as are NumPy's
        return float.__repr__(value) if math.isfinite(value) else "null"
    value = value.item() if isinstance(value, np.generic) else value
    text = _ENCODE(value)
    return text if text.isprintable() else json.dumps(value)


def _array(array: NDArray[Any], indent: str) -> Iterator[str]:
    """Yield the text of a large array of numbers, without spaces in a row of several."""
    import orjson

    inner = indent + "  "
    opening, between, closing = ("[", ", ", "]") if array.ndim == 1 else (f"[\n{inner}", f",\n{inner}", f"\n{indent}]")
    for start in range(0, len(array), _ROWS_AT_ONCE):
        rows = np.ascontiguousarray(array[start : start + _ROWS_AT_ONCE])
        text = orjson.dumps(rows, option=orjson.OPT_SERIALIZE_NUMPY).decode()
        yield opening + text[1:-1].replace("],[", f"],\n{inner}[")
        opening = between
    yield closing
