"""Open a table; and columns as one: of a data frame, a Parquet file, a recording, or the records of a document."""

import datetime as dt
import hashlib
import os
import re
import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import PurePath
from typing import Any, BinaryIO, Protocol

import numpy as np

from robacc.errors import InputError, Problem, given, refuse
from robacc.geometry import Array, NDArray
from robacc.io.dialect import GAPS
from robacc.io.files import STANDARD_STREAM, clip, opened
from robacc.io.table import MAX_TEXT, SKIP, Table, TableBody, TableOptions, TablePart, TableRows, TextTable, lost_words
from robacc.plug_ins import plug_in, plug_ins

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
        self.log.remarks.append(remark)
        self.sha256 = sha256
        if not sha256:
            digest = hashlib.sha256()
            for name, column in columns:
                is_plain = column.dtype.kind in "fiub"
                digest.update(f"{name.strip()}\0{column.dtype if is_plain else 'text'}\0".encode())
                texts = "" if is_plain else "\0".join(map(str, column.tolist()))
                digest.update(column.tobytes() if is_plain else texts.encode(errors="replace"))
            self.sha256 = digest.hexdigest()

    def body(self, numbers: Sequence[int], texts: Sequence[int]) -> TableBody:
        """Return every row, with the columns of the given indices only; :attr:`log` collects problems of values."""
        table = np.empty((len(numbers), self.n))
        for row, i in zip(table, numbers, strict=True):
            row[:] = self._numbers(*self.column(i), self.labels[i])
        self.log.gaps.update(
            place
            for i, label in enumerate(self.labels)
            if (words := lost_words(label))
            for place, cell in zip(self.places.tolist(), self.column(i)[0].tolist(), strict=True)
            if _text(cell).lower() in words
        )
        return TableBody(table, [self._texts(i) for i in texts], self.places).without(self.log.gaps)

    @property
    def places(self) -> NDArray[np.int64]:
        """Number of each row in the file."""
        return np.arange(1, self.n + 1, dtype=np.int64)

    def column(self, index: int) -> tuple[NDArray[Any], NDArray[np.bool_]]:
        """Return a column, and where its values are missing."""
        column = self._columns[index]
        if column.dtype.kind == "O":
            return column, np.array([_is_missing(value) for value in column.tolist()], dtype=bool)
        return column, np.isnan(column) if column.dtype.kind == "f" else np.zeros(column.size, dtype=bool)

    def _numbers(self, column: NDArray[Any], missing: NDArray[np.bool_], name: str) -> Array:
        """Return a column as numbers, with NaN where a problem was logged."""
        rows = self.places
        if column.dtype.kind not in "fiuO":
            self.log.add(f"the column holds {column.dtype}, expected numbers", None, name)
            return np.full(column.size, np.nan)
        is_object = column.dtype.kind == "O"
        values = np.full(column.size, np.nan) if is_object else column.astype(float)
        for i in np.flatnonzero(~missing).tolist() if is_object else ():
            try:
                if isinstance(column[i], _NOT_NUMBERS):
                    raise TypeError
                values[i] = float(column[i])
            except (TypeError, ValueError, OverflowError):
                self.log.add(
                    f"found {clip(str(column[i]))}, expected a number",
                    int(rows[i]),
                    name,
                    "convert the column to numbers" if isinstance(column[i], str) else None,
                )
        infinite = np.isinf(values) if is_object else ~np.isfinite(values) & ~missing
        if self.skip_gaps:
            self.log.gaps.update(rows[missing | infinite].tolist())
        else:
            self.log.add_rows(missing, rows, name, lambda i: "the value is missing, expected a number", SKIP)
            self.log.add_rows(infinite, rows, name, lambda i: f"found {clip(str(values[i]))}, expected a finite number")
        return np.where(infinite, np.nan, values)

    def _texts(self, index: int) -> NDArray[np.str_]:
        """Return a column as text, empty where the value is missing and need not be there."""
        column, name, is_sparse = self.column(index)[0], self.labels[index], index in self.sparse
        if column.dtype.kind == "M":
            texts = ["" if text == "NaT" else text for text in np.datetime_as_string(column).tolist()]
        else:
            texts = ["" if _is_missing(value) else _text(value) for value in column.tolist()]
        if is_sparse or not self.skip_gaps:
            rows = zip(self.places.tolist(), texts, strict=True)
            return np.array([self.text(text, i, name) if text or not is_sparse else "" for i, text in rows], dtype=str)
        self.log.gaps.update(i for i, text in zip(self.places.tolist(), texts, strict=True) if not text)
        return np.array([text[:MAX_TEXT] for text in texts], dtype=str)


def _is_missing(value: Any) -> bool:
    if value is None or (isinstance(value, str) and value.strip().lower() in GAPS):
        return True
    try:
        return bool(value != value)
    except TypeError:  # pandas.NA
        return True


def _text(value: Any) -> str:
    if isinstance(value, float):
        return str(int(value)) if value.is_integer() and abs(value) < 1e15 else repr(value)
    return value.isoformat() if isinstance(value, dt.datetime | dt.time) else " ".join(str(value).split())


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
            # A table that only speaks Arrow's stream interface, such as a database's relation.
            try:
                import pyarrow
            except ImportError as error:
                raise InputError(
                    Problem("is not a table whose columns can be read", name, fix="convert it to pandas")
                ) from error
            frame = pyarrow.table(frame)
        names = list(getattr(frame, "column_names", None) or frame.columns)
        get = frame.column if hasattr(frame, "column") else frame.__getitem__
        repeated = [key for key, count in Counter(map(str, names)).items() if count > 1]
        refuse(*((1, Problem(f"found two columns {clip(key)}", name, fix="rename one of them")) for key in repeated))
        pairs = [(key, get(key)) for key in names]
    columns = []
    for key, values in pairs:
        column = np.asarray(values.to_numpy() if hasattr(values, "to_numpy") else values)
        no_text = f"expected a text as the name of each column, found {key!r}"
        refuse(
            (not isinstance(key, str), Problem(no_text, name, fix="name the columns, for example q1, x_mm")),
            (
                column.ndim != 1,
                Problem(f"expected one value per row, found an array of shape {column.shape}", name, column=key),
            ),
        )
        columns.append((key, column))
    lengths = {column.size for _, column in columns}
    counts = f"{min(lengths, default=0)} to {max(lengths, default=0)} rows"
    refuse((len(lengths) > 1, Problem(f"the columns have {counts}", name)))
    return columns


# Open a table: a data frame, records, what a plug-in reads, or else text.
#
# Other packages add readers of further kinds of files, see :class:`Reader`.

_EXPORT, _UNPACK = "export the poses as CSV", "unpack it first"
_ARRAYS = "save its arrays with numpy.savez(file, joints=…, position=…), or export the poses as CSV"
_FOLDER = "export the poses as CSV; of photos of a board, name the folder"
_OTHER_FILES = {
    b"%PDF": ("a PDF document", _EXPORT),
    **dict.fromkeys((b"\x80\x03", b"\x80\x04", b"\x80\x05"), ("a pickle of Python", _ARRAYS)),
    b"\x89HDF": ("an HDF5 file", _ARRAYS),
    b"\x1f\x8b": ("compressed by gzip", _UNPACK),
    b"BZh": ("compressed by bzip2", _UNPACK),
    b"7z\xbc\xaf": ("an archive of 7-Zip", _UNPACK),
    b"\x89PNG": ("a PNG image", _FOLDER),
    b"\xff\xd8\xff": ("a JPEG image", _FOLDER),
    b"<!doctype": ("an HTML page", _EXPORT),
    b"<html": ("an HTML page", _EXPORT),
    b"<?xml": ("an XML document", _EXPORT),
}
"""What a file is that begins with these bytes, in small letters, and is no table, and what to do."""
_LONGEST = 4096
"""Bytes that tell one kind of file from another; cells that are lists may stand in the first row of a CSV only."""
_OF_TEXT = frozenset({"", ".csv", ".txt", ".tsv", ".tab", ".prn", ".dat", ".asc", ".log", ".tum"})
"""Ends of the names of text files. No plug-in is asked about these, unless they look like a document of records: the
search takes a tenth of a second."""
_OF_RECORDS = re.compile(
    rb"""(?xsm) [{\[] | --- | header: | hand, | [-+.\deE,;\ \t]{1000}
    | .*( [\n,;\t]"\[ | [\[({]\s*[-+.\d]+\s*,\s*[-+.\d] | :\s*[-+.\d]+,\s | \b(X|[AJ]1)\s*[:=\ ]\s*[-+.\d]
        | \bx\s*[:=]\s*[-+.\d]
        | ^\s*DIM\s | ^[\ \t\[]*(0(\.0*)?(e[-+]?0+)?[,;\s]+){3}1(\.0*)?(e[-+]?0+)?[\s\]]*$ )"""
)
"""Beginning of a document of records: JSON, YAML, pairs of hand and eye, matrices, a CSV whose cells are lists, a log
with lists or named values, a report of PC-DMIS."""


class Reader(Protocol):
    """Reader of a further kind of files: an entry point of the group ``robacc.readers`` names an object or a module.

    A reader that has ``read_stream(stream, file, options)`` gets the open file in place of its path, so that it reads
    pipes too; ``file`` is the name for messages.

    Readers are asked about a folder, and about a file whose name or first bytes are not those of a table as text.
    """

    def takes(self, path: str, first: bytes) -> bool:
        """Return whether a file is of this kind, by its name or its first 16 bytes; of a folder there are none."""

    def read(self, path: str, options: TableOptions) -> Table:
        """Return the file as a table; ``-`` is standard input, of which the first bytes are not consumed yet.

        Raises:
            InputError: The file cannot be read; with its name, and the line where there is one.
            UsageError: A statement of ``options`` is wrong, or a package is missing.
        """


def _by_plug_in(path: str, first: bytes, options: TableOptions, stream: BinaryIO | None = None) -> Table | None:
    """Return the table that the first reader among the plug-ins makes of a file; None where none takes it."""
    # That of records comes first: the others import more.
    readers: Iterator[Reader] = plug_ins("robacc.readers", "records")
    reader = next((reader for reader in readers if reader.takes(path, first)), None)
    if reader is not None and stream is not None and hasattr(reader, "read_stream"):
        table: Table = reader.read_stream(stream, "<stdin>" if path == STANDARD_STREAM else path, options)
        return table
    return None if reader is None else reader.read(path, options)


def is_of_files(path: str) -> bool:
    """Return whether a path names files by a pattern, or a folder in an object store."""
    return ("*" in path and not os.path.isfile(path)) or ("://" in path and path.endswith("/"))


def divided(path: str, options: TableOptions) -> Sequence[TableRows]:
    """Return a sample of a large table, and the parts that are the whole; nothing for a table that is read at once.

    Raises:
        InputError: A file cannot be read, or is no table.
        UsageError: A file is Parquet, and the extra ``parquet`` is not installed.
    """
    if path.endswith((".parquet", ".pq")) or os.path.isdir(path) or is_of_files(path):
        parts: Sequence[TableRows] = plug_in("robacc.readers", "parquet").divided(path, options)
        return parts
    return TablePart.divided(path, options)


@contextmanager
def open_table(path: str, options: TableOptions) -> Iterator[Table]:
    """Open the file, or standard input for ``-``, as a table.

    Raises:
        InputError: The file cannot be opened or read.
        UsageError: The file is Parquet, and the extra ``parquet`` is not installed.
    """
    if isinstance(options.frame, TableRows):
        yield options.frame.table(options)
    elif options.frame is not None:
        yield ColumnTable(frame_columns(options.frame, path), path, options.skip_gaps)
    elif os.path.isdir(path) or is_of_files(path):
        fix = (
            "name a file, or a folder that has photos (.jpg, .png), Parquet files alone, meta/info.json (LeRobot), "
            "metadata.yaml (ROS 2), a file for each pose (JSON, YAML, 4 x 4 matrix), or a table of joints alone for "
            "each socket"
        )
        message = "is a folder, expected a file" if os.path.isdir(path) else "found no files of poses there"
        yield given(_by_plug_in(path, b"", options), Problem(message, path, fix=fix))
    else:
        with opened(path) as stream:
            yield _table(stream, "<stdin>" if path == STANDARD_STREAM else path, options)


def _table(stream: BinaryIO, file: str, options: TableOptions) -> Table:
    if hasattr(stream, "peek"):
        first = bytes(stream.peek(_LONGEST)[:_LONGEST])
    else:
        first = stream.read(_LONGEST)
        stream.seek(0)
    text = first.removeprefix(b"\xef\xbb\xbf").lstrip()
    suffix = PurePath(file).suffix.lower()
    kind, fix = next(
        (kind for start, kind in _OTHER_FILES.items() if start in (first[: len(start)], text.lower()[: len(start)])),
        ("", ""),
    )
    is_text = b"\0" not in first or first.startswith((b"\xff\xfe", b"\xfe\xff"))  # UTF-16
    is_marked = first.startswith(b"PAR1") or bool(_OF_RECORDS.match(text))
    if kind or is_marked or not is_text or suffix not in _OF_TEXT:
        path = STANDARD_STREAM if stream is sys.stdin.buffer else file
        if (table := _by_plug_in(path, first, options, stream)) is not None:
            return table
    again = "export it again, or rename it to .csv if it is text"
    refuse(
        (kind, Problem(f"is {kind}, expected a table of poses", file, fix=fix)),
        (suffix in (".parquet", ".pq"), Problem("is not a Parquet file: it does not begin with PAR1", file, fix=again)),
    )
    return TextTable(stream, file, options)
