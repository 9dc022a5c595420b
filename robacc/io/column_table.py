"""Columns in memory as a table: those of a data frame, the samples of a recording, or the records of a document."""

from __future__ import annotations

import datetime as dt
import hashlib
import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from robacc.errors import InputError, Problem
from robacc.geometry import Array
from robacc.io.dialect import GAPS
from robacc.io.files import clip, decode
from robacc.io.table import MAX_TEXT, Table, TableBody

_UNITS = frozenset({"m", "mm", "um", "rad", "mrad", "deg"})
_NOT_NUMBERS = (str, bytes, complex, dt.date, dt.time, dt.timedelta, np.datetime64, np.timedelta64)


class ColumnTable(Table):
    """Table of columns ``(N,)`` by name; rows count from 1."""

    def __init__(
        self,
        columns: Sequence[tuple[str, NDArray[Any]]],
        file: str,
        skip_gaps: bool,
        sha256: str = "",
        remark: str = "",
    ) -> None:
        """Take the columns.

        Args:
            columns: Names and columns of equal length.
            file: Name in messages.
            skip_gaps: Leave out rows with a missing value.
            sha256: Digest of the bytes that the columns come from; empty: that of the columns.
            remark: How the columns came to be, for a message.

        Raises:
            InputError: There are too many columns.
        """
        super().__init__(file, [name for name, _ in columns], skip_gaps=skip_gaps)
        self._columns = [column for _, column in columns]
        self.n = self._columns[0].size if columns else 0
        self.remarks.append(remark)
        self.sha256 = sha256 or self._digest()

    def body(self, numbers: Sequence[int], texts: Sequence[int]) -> TableBody:
        """Return every row, with the columns of the given indices only; :attr:`log` collects problems of values."""
        table = np.empty((len(numbers), self.n))
        for row, i in zip(table, numbers, strict=True):
            row[:] = self._numbers(*self.column(i), self.labels[i])
        columns = tuple(self._texts(i) for i in texts)
        return TableBody(table, columns, np.arange(1, self.n + 1, dtype=np.int64)).without(self.gaps)

    def _digest(self) -> str:
        digest = hashlib.sha256()
        for name, column in zip(self.names, self._columns, strict=True):
            is_plain = column.dtype.kind in "fiub"
            digest.update(f"{name}\0{column.dtype if is_plain else 'text'}\0".encode())
            values = column.tobytes() if is_plain else "\0".join(map(str, column.tolist())).encode(errors="replace")
            digest.update(values)
        return digest.hexdigest()

    def column(self, index: int) -> tuple[NDArray[Any], NDArray[np.bool_]]:
        """Return a column, and where its values are missing."""
        column = self._columns[index]
        if column.dtype.kind == "f":
            return column, np.isnan(column)
        if column.dtype.kind == "O":
            return column, np.array([_is_missing(value) for value in column.tolist()], dtype=bool)
        return column, np.zeros(column.size, dtype=bool)

    def _numbers(self, column: NDArray[Any], missing: NDArray[np.bool_], name: str) -> Array:
        """Return a column as numbers, with NaN where a problem was logged."""
        rows = np.arange(1, column.size + 1)
        if column.dtype.kind == "O":
            values = np.full(column.size, np.nan)
            for i in np.flatnonzero(~missing).tolist():
                values[i] = self._number(column[i], i + 1, name)
            infinite = np.isinf(values)
        elif column.dtype.kind in "fiu":
            values = column.astype(float)
            infinite = ~np.isfinite(values) & ~missing
        else:
            self.log.add(f"the column holds {column.dtype}, expected numbers", None, name)
            return np.full(column.size, np.nan)
        if self.skip_gaps:
            self.gaps.update(rows[missing | infinite].tolist())
        else:
            self.log.add_rows(missing, rows, name, lambda i: "the value is missing, expected a number")
            self.log.add_rows(infinite, rows, name, lambda i: f"found {clip(str(values[i]))}, expected a finite number")
        return np.where(infinite, np.nan, values)

    def _number(self, value: Any, row: int, name: str) -> float:
        """Return an object as a number, NaN where a problem was logged."""
        if not isinstance(value, _NOT_NUMBERS):
            try:
                return float(value)
            except (TypeError, ValueError, OverflowError):
                pass
        fix = "convert the column to numbers" if isinstance(value, str) else None
        self.log.add(f"found {clip(str(value))}, expected a number", row, name, fix)
        return np.nan

    def _texts(self, index: int) -> NDArray[np.str_]:
        texts = _as_text(self.column(index)[0])
        if self.skip_gaps:
            self.gaps.update(i for i, text in enumerate(texts, 1) if not text)
            return np.array([text[:MAX_TEXT] for text in texts], dtype=str)
        return np.array([self.text(text, i, self.labels[index]) for i, text in enumerate(texts, 1)], dtype=str)


def _is_missing(value: Any) -> bool:
    if value is None or (isinstance(value, str) and value.strip().lower() in GAPS):
        return True
    try:
        return bool(value != value)
    except TypeError:  # pandas.NA
        return True


def _as_text(column: NDArray[Any]) -> list[str]:
    """Return entries as text, empty where they are missing."""
    if column.dtype.kind == "M":
        texts = np.datetime_as_string(column).tolist()
        return ["" if text == "NaT" else text for text in texts]
    if column.dtype.kind in "iu":
        return [str(value) for value in column.tolist()]
    return ["" if _is_missing(value) else _text(value) for value in column.tolist()]


def _text(value: Any) -> str:
    if isinstance(value, float):
        return str(int(value)) if value.is_integer() and abs(value) < 1e15 else repr(value)
    if isinstance(value, dt.datetime | dt.time):
        return value.isoformat()
    return " ".join(str(value).split())


def frame_columns(frame: Any, name: str) -> list[tuple[str, NDArray[Any]]]:
    """Return the columns of a data frame (pandas, Polars, Arrow, or a mapping of arrays) and its named index.

    Raises:
        InputError: The object is no table of columns.
    """
    if isinstance(frame, Mapping):
        pairs = [(key, frame[key]) for key in frame]
    else:
        if any(level is not None for level in getattr(getattr(frame, "index", None), "names", ()) or ()):
            frame = frame.reset_index()
        if not hasattr(frame, "column_names") and not hasattr(frame, "__getitem__"):
            frame = _as_arrow(frame, name)
        names = list(getattr(frame, "column_names", None) or frame.columns)
        get = frame.column if hasattr(frame, "column") else frame.__getitem__
        repeated = [key for key, count in Counter(map(str, names)).items() if count > 1]
        if repeated:
            raise InputError(Problem(f"found two columns {clip(repeated[0])}", name, fix="rename one of them"))
        pairs = [(key, get(key)) for key in names]
    if not all(isinstance(key, str) for key, _ in pairs):
        message = (
            f"expected a text as the name of each column, found {next(k for k, _ in pairs if type(k) is not str)!r}"
        )
        raise InputError(Problem(message, name, fix="name the columns, for example q1, x_mm"))
    columns = [(key, _column(values, key, name)) for key, values in pairs]
    lengths = {column.size for _, column in columns}
    if len(lengths) > 1:
        raise InputError(Problem(f"the columns have {min(lengths)} to {max(lengths)} rows", name))
    return columns


def _as_arrow(frame: Any, name: str) -> Any:
    """Return a table that only speaks Arrow's stream interface, such as a database's relation, as an Arrow table."""
    try:
        import pyarrow
    except ImportError as error:
        raise InputError(
            Problem("is not a table whose columns can be read", name, fix="convert it to pandas")
        ) from error
    return pyarrow.table(frame)


def _column(values: Any, key: str, name: str) -> NDArray[Any]:
    column = values.to_numpy() if hasattr(values, "to_numpy") else np.asarray(values)
    if column.ndim != 1:
        raise InputError(
            Problem(f"expected one value per row, found an array of shape {column.shape}", name, column=key)
        )
    return np.asarray(column)


def records_table(data: bytes, file: str, skip_gaps: bool) -> ColumnTable:
    """Return the records of a JSON, JSON Lines or YAML document, which are its longest list, as a table.

    A record gives one row. Its columns are named by its keys, then the place in a list, then a unit at a key's end.

    Raises:
        InputError: The text is no such document, or has no records.
    """
    import yaml

    text = decode(data, file)
    try:
        lines = [line.strip() for line in text.splitlines() if line.strip()]
        if len(lines) > 1 and all(line[0] + line[-1] == "{}" for line in lines):
            document = [json.loads(line) for line in lines]
        elif text.lstrip()[:1] in ("{", "[") and not file.lower().endswith((".yaml", ".yml")):
            document = json.loads(text)
        elif any(isinstance(event, yaml.AliasEvent) for event in yaml.parse(text, Loader=yaml.CSafeLoader)):
            raise ValueError("it has aliases")  # they could stand for more records than the memory holds
        else:
            # Messages of ros2 topic echo are a document each.
            documents = [item for item in yaml.load_all(text, Loader=yaml.CSafeLoader) if item is not None]
            document = documents[0] if len(documents) == 1 else documents
    except (ValueError, RecursionError, yaml.YAMLError) as error:
        reason = " ".join(str(error).split())[:200]
        raise InputError(Problem(f"cannot be read as JSON or YAML ({reason})", file, fix="export it again")) from None
    values: list[Any] = list(document.values()) if isinstance(document, dict) else []
    if len(values) > 1 and all(isinstance(items, list) and len(items) == len(values[0]) for items in values):
        document = [dict(zip(document, items, strict=True)) for items in zip(*values, strict=True)]
    lists = [items for items in ([document] if isinstance(document, list) else values) if isinstance(items, list)]
    rows = [dict(_leaves(record, ())) for record in max(lists, key=len, default=[]) if isinstance(record, dict)]
    if not rows or len(rows) < max(map(len, lists)):
        fix = "give a list of records, such as {joints: [...], position: [x, y, z]}, or export the poses as CSV"
        raise InputError(Problem("has no list of records, expected a table of poses", file, fix=fix))
    names = dict.fromkeys(name for row in rows for name in row)
    columns = [(name, np.array([row.get(name) for row in rows], dtype=object)) for name in names]
    return ColumnTable(columns, file, skip_gaps, hashlib.sha256(data).hexdigest())


def _leaves(value: Any, path: tuple[str, ...]) -> Iterator[tuple[str, Any]]:
    """Yield the name and value of each number and text in a record."""
    if isinstance(value, dict):
        names = value.get("name")
        for key, item in value.items():
            if isinstance(names, list) and isinstance(item, list) and item is not names and len(item) == len(names):
                # Lists beside one of names, as in joint states of ROS, have a value for each name.
                yield from ((f"{name}/{key}", entry) for name, entry in zip(names, item, strict=True))
            else:
                yield from _leaves(item, (*path, str(key)))
    elif isinstance(value, list):
        in_matrix = any(isinstance(item, list) for item in value) or (path and path[-1].isdecimal())
        for i, item in enumerate(value):
            yield from _leaves(item, (*path, str(i) if in_matrix else "xyz"[i] if len(value) == 3 else str(i + 1)))
    else:
        yield "_".join(sorted("_".join(path).split("_"), key=_UNITS.__contains__)), value
