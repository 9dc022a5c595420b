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
from robacc.io.files import ProblemLog, clip, decode
from robacc.io.table import MAX_COLUMNS, MAX_TEXT, Header, TableBody, TableOptions

_UNITS = frozenset({"m", "mm", "um", "rad", "mrad", "deg"})
_NOT_NUMBERS = (str, bytes, complex, dt.date, dt.time, dt.timedelta, np.datetime64, np.timedelta64)


class ColumnTable:
    """Table of columns ``(N,)`` by name; rows count from 1."""

    def __init__(
        self,
        columns: Sequence[tuple[str, NDArray[Any]]],
        file: str,
        options: TableOptions,
        sha256: str | None = None,
        remark: str = "",
    ) -> None:
        """Take the columns.

        Args:
            columns: Names and columns of equal length.
            file: Name in messages.
            options: Freedom of the reader.
            sha256: Digest of the bytes that the columns come from; None: that of the columns.
            remark: How the columns came to be, for a message.

        Raises:
            InputError: There are too many columns, or two have one name.
        """
        self.file = file
        self.log = ProblemLog(file, "row")
        self._columns = [column for _, column in columns]
        self._names = [name for name, _ in columns]
        self._skip_gaps = options.skip_gaps
        self._gaps: set[int] = set()
        self._remark = remark
        self._sha256 = sha256
        if len(columns) > MAX_COLUMNS:
            raise InputError(Problem(f"found {len(columns)} columns", file, fix=f"expected at most {MAX_COLUMNS}"))
        repeated = [name for name, count in Counter(self._names).items() if count > 1]
        if repeated:
            raise InputError(Problem(f"found two columns {clip(repeated[0])}", file, fix="rename one of them"))

    @property
    def sha256(self) -> str:
        """Digest of the source's bytes, or of the columns."""
        if self._sha256 is None:
            digest = hashlib.sha256()
            for name, column in zip(self._names, self._columns, strict=True):
                is_plain = column.dtype.kind in "fiub"
                digest.update(f"{name}\0{column.dtype if is_plain else 'text'}\0".encode())
                values = column.tobytes() if is_plain else "\0".join(map(str, column.tolist())).encode(errors="replace")
                digest.update(values)
            self._sha256 = digest.hexdigest()
        return self._sha256

    def header(self) -> Header:
        """Return the columns' names."""
        return Header(tuple(name.strip() for name in self._names), None)

    def description(self) -> str:
        """Return how the columns came to be."""
        return self._remark

    def body(self, numbers: Sequence[int], texts: Sequence[int]) -> TableBody:
        """Return every row, with the columns of the given indices only."""
        n = self._columns[0].size if self._columns else 0
        table = np.empty((len(numbers), n))
        for row, i in zip(table, numbers, strict=True):
            row[:] = self._numbers(i)
        columns = tuple(self._texts(i) for i in texts)
        return TableBody(table, columns, np.arange(1, n + 1, dtype=np.int64)).without(self._gaps)

    def _numbers(self, index: int) -> Array:
        """Return a column as numbers, with NaN where a problem was logged."""
        column, name = self._columns[index], self._names[index]
        if column.dtype.kind in "fiu":
            values = column.astype(float)
        elif column.dtype.kind == "O":
            values = np.array(
                [self._number(value, i + 1, name) for i, value in enumerate(column.tolist())], dtype=float
            )
        else:
            self.log.add(f"the column holds {column.dtype}, expected numbers", None, name)
            return np.full(column.size, np.nan)
        rows = np.arange(1, values.size + 1)
        missing = np.isnan(values) & (column.dtype.kind != "O")
        infinite = np.isinf(values)
        if self._skip_gaps:
            self._gaps.update(rows[missing | infinite].tolist())
        else:
            self.log.add_rows(missing, rows, name, lambda i: "the value is missing, expected a number")
            self.log.add_rows(infinite, rows, name, lambda i: f"found {values[i]}, expected a finite number")
        return np.where(infinite, np.nan, values)

    def _number(self, value: Any, row: int, name: str) -> float:
        """Return an object as a number, NaN where a problem was logged."""
        if _is_missing(value):
            self._missing(row, name, "a number")
            return np.nan
        if not isinstance(value, _NOT_NUMBERS):
            try:
                return float(value)
            except (TypeError, ValueError, OverflowError):
                pass
        fix = "convert the column to numbers" if isinstance(value, str) else None
        self.log.add(f"found {clip(str(value))}, expected a number", row, name, fix)
        return np.nan

    def _missing(self, row: int, name: str, expected: str) -> None:
        if self._skip_gaps:
            self._gaps.add(row)
        else:
            self.log.add(f"the value is missing, expected {expected}", row, name)

    def _texts(self, index: int) -> NDArray[np.str_]:
        column, name = self._columns[index], self._names[index]
        texts = []
        for i, text in enumerate(_as_text(column)):
            if not text:
                self._missing(i + 1, name, "text")
            elif len(text) > MAX_TEXT:
                self.log.add(f"the text has {len(text)} characters, expected at most {MAX_TEXT}", i + 1, name)
            texts.append(text[:MAX_TEXT])
        return np.array(texts, dtype=str)


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


def records_table(data: bytes, file: str, options: TableOptions) -> ColumnTable:
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
        elif not file.lower().endswith((".yaml", ".yml")):
            document = json.loads(text)
        elif any(isinstance(event, yaml.AliasEvent) for event in yaml.parse(text, Loader=yaml.CSafeLoader)):
            raise ValueError("it has aliases")  # they could stand for more records than the memory holds
        else:
            document = yaml.load(text, Loader=yaml.CSafeLoader)
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
    return ColumnTable(columns, file, options, hashlib.sha256(data).hexdigest())


def _leaves(value: Any, path: tuple[str, ...]) -> Iterator[tuple[str, Any]]:
    """Yield the name and value of each number and text in a record."""
    if isinstance(value, dict):
        for key, item in value.items():
            yield from _leaves(item, (*path, str(key)))
    elif isinstance(value, list):
        in_matrix = any(isinstance(item, list) for item in value) or (path and path[-1].isdecimal())
        for i, item in enumerate(value):
            yield from _leaves(item, (*path, str(i) if in_matrix else "xyz"[i] if len(value) == 3 else str(i + 1)))
    else:
        yield "_".join(sorted("_".join(path).split("_"), key=_UNITS.__contains__)), value
