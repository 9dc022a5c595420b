"""JSON text of a result: the same text for the same result, without NaN, which JSON does not have.

Keys keep their order. A list of numbers stands on one line, and a list of lists or records has one item a line, so that
ordinary tools can read and compare a result. Large arrays are encoded in pieces by orjson, in a fifteenth of the time
of Python's encoder; small ones are not, because its import takes longer than their text.
"""

from __future__ import annotations

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
    if isinstance(value, np.ndarray):
        yield from _array(value, indent)
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
    if isinstance(value, float):  # as are NumPy's
        return float.__repr__(value) if math.isfinite(value) else "null"
    return _text(value.item() if isinstance(value, np.generic) else value)


def _text(value: Any) -> str:
    """Return the JSON of a string or number; control and bidirectional characters are escaped for terminals."""
    text = _ENCODE(value)
    return text if text.isprintable() else json.dumps(value)


def _array(array: NDArray[Any], indent: str) -> Iterator[str]:
    if array.ndim > 2 or array.dtype.kind not in "fiub" or 0 in array.shape[:1]:
        yield from _pieces(list(array), indent)
        return
    inner = indent + "  "
    opening, between, closing = ("[", ", ", "]") if array.ndim == 1 else (f"[\n{inner}", f",\n{inner}", f"\n{indent}]")
    dumps = _dumps if len(array) <= _ROWS_AT_ONCE else _fast_dumps
    for start in range(0, len(array), _ROWS_AT_ONCE):
        rows = dumps(array[start : start + _ROWS_AT_ONCE])
        yield opening + rows[1:-1].replace("], [", f"],\n{inner}[")
        opening = between
    yield closing


def _fast_dumps(array: NDArray[Any]) -> str:
    """Return what :func:`_dumps` does, by orjson, without spaces in a row."""
    import orjson

    text = orjson.dumps(np.ascontiguousarray(array), option=orjson.OPT_SERIALIZE_NUMPY)
    return text.replace(b"],[", b"], [").decode()


def _dumps(array: NDArray[Any]) -> str:
    """Return an array's rows on one line; numbers that are not finite become null."""
    if array.dtype.kind == "f" and not np.all(np.isfinite(array)):
        finite = np.isfinite(array)
        array = array.astype(object)
        array[~finite] = None
    return _text(array.tolist())
