"""Read a Parquet file as columns of numbers and text: the same table as from CSV, with rows in place of lines.

Arrow, the format's reference implementation, reads batches of rows on one thread, so the memory used besides the
columns does not grow with the file.
"""

from __future__ import annotations

import hashlib
import io
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, BinaryIO

import numpy as np
from numpy.typing import NDArray

from robacc.errors import InputError, Problem, UsageError, install_advice
from robacc.geometry import Array
from robacc.io.files import ProblemLog, clip
from robacc.io.table import MAX_COLUMNS, MAX_TEXT, Header, TableBody, TableOptions

if TYPE_CHECKING:
    import pyarrow
    from pyarrow.parquet import ParquetFile

_ROWS_AT_ONCE = 1 << 16
_MOST_ROWS = 50_000_000
"""A small file can repeat a value a billion times; nobody measures that many poses."""
_MOST_NUMBERS = 2_000_000_000
"""Numbers of all columns in use: 16 GB."""
_PIPE_LIMIT = 2 << 30
"""Largest pipe, bytes: the format is read from its end, so a pipe is read completely."""
_INDEX = re.compile(r"__index_level_\d+__")
"""Columns in which pandas stores its row numbers."""


class ParquetReader:
    """Reader of one Parquet file: first :meth:`header`, then :meth:`body`."""

    def __init__(self, stream: BinaryIO, file: str, options: TableOptions | None = None) -> None:
        """Read ``stream``, called ``file`` in messages.

        Raises:
            UsageError: The extra ``parquet`` is not installed.
        """
        try:
            import pyarrow.parquet  # noqa: F401
        except ImportError as error:
            message = f"{file} is Parquet, which needs an optional package; run {install_advice('parquet')}"
            raise UsageError(message) from error
        self.file = file
        self.log = ProblemLog(file, "row")
        self._stream = stream
        self._sha256 = ""
        self._opened: ParquetFile | None = None
        self._names: list[str] = []
        self._skip_gaps = options is not None and options.skip_gaps
        self._gaps: set[int] = set()

    @property
    def sha256(self) -> str:
        """Digest of the file's bytes."""
        return self._sha256

    def header(self) -> Header:
        """Return the columns' names, without pandas' index.

        Raises:
            InputError: The file is damaged, or too large.
        """
        from pyarrow.parquet import ParquetFile

        stream = self._seekable()
        with self._arrow_errors():
            self._opened = ParquetFile(stream, pre_buffer=False, page_checksum_verification=True)
            schema = self._opened.schema_arrow
            rows = self._opened.metadata.num_rows
        self._names = [name for name in schema.names if not _INDEX.fullmatch(name)]
        if len(self._names) > MAX_COLUMNS:
            raise self._error(f"found {len(self._names)} columns", f"expected at most {MAX_COLUMNS}")
        if not 0 <= rows <= _MOST_ROWS:
            raise self._error(f"found {rows} rows", f"expected at most {_MOST_ROWS}")
        return Header(tuple(name.strip() for name in self._names), None)

    def description(self) -> str:
        """Return nothing: a Parquet file has one form."""
        return ""

    def body(self, numbers: Sequence[int], texts: Sequence[int]) -> TableBody:
        """Return every row, with the columns of the given indices only; :attr:`log` collects problems of values.

        Raises:
            InputError: The file is damaged, or the type of a column does not fit its name.
        """
        if self._opened is None:
            raise ValueError("header() must be called before body()")
        names = [self._names[i] for i in (*numbers, *texts)]
        self._check_types(numbers, texts)
        # Arrow cannot select one of two columns with the same name; the log has that problem already.
        if any(Counter(self._names)[name] > 1 for name in names):
            self.log.raise_if_any()
        n = self._opened.metadata.num_rows
        if n * len(numbers) > _MOST_NUMBERS:
            raise self._error(f"found {n} rows of {len(numbers)} columns", "split the file")
        table = np.empty((len(numbers), n))
        columns: list[list[NDArray[np.str_]]] = [[np.empty(0, dtype=str)] for _ in texts]
        n_read = 0
        with self._arrow_errors():
            for batch in self._opened.iter_batches(_ROWS_AT_ONCE, columns=names, use_threads=False):
                end = n_read + batch.num_rows
                if end > n:
                    break
                for values, i in zip(table, numbers, strict=True):
                    values[n_read:end] = self._numbers(batch.column(self._names[i]), self._names[i], n_read)
                for column, i in zip(columns, texts, strict=True):
                    column.append(self._texts(batch.column(self._names[i]), self._names[i], n_read))
                n_read = end
        if n_read != n:
            raise self._damaged(f"its header announces {n} rows, the data has another number")
        body = TableBody(table, tuple(map(np.concatenate, columns)), np.arange(1, n + 1, dtype=np.int64))
        return body.without(self._gaps)

    def _seekable(self) -> BinaryIO:
        """Return the stream, or the content of a pipe, and store its digest."""
        stream = self._stream
        if not stream.seekable():
            data = stream.read(_PIPE_LIMIT + 1)
            if len(data) > _PIPE_LIMIT:
                raise self._error(f"the pipe holds more than {_PIPE_LIMIT >> 30} GiB", "name a file instead")
            stream = io.BytesIO(data)
        self._sha256 = hashlib.file_digest(stream, "sha256").hexdigest()  # type: ignore[arg-type]
        stream.seek(0)
        return stream

    def _error(self, message: str, fix: str | None = None) -> InputError:
        return InputError(Problem(message, self.file, fix=fix))

    @contextmanager
    def _arrow_errors(self) -> Iterator[None]:
        """Raise errors of Arrow as problems of the file."""
        from pyarrow import ArrowException

        try:
            yield
        except (ArrowException, OSError, UnicodeDecodeError) as error:
            raise self._damaged(str(error).strip().partition("\n")[0][:200]) from error

    def _damaged(self, why: str) -> InputError:
        return self._error(f"cannot be read as Parquet ({why})", "it is damaged or cut short")

    def _check_types(self, numbers: Sequence[int], texts: Sequence[int]) -> None:
        """Raise an error for columns whose type is not numbers, or not text."""
        from pyarrow import types

        if self._opened is None:
            return
        types_by_name = dict(zip(self._opened.schema_arrow.names, self._opened.schema_arrow.types, strict=True))
        for i in numbers:
            kind = types_by_name[self._names[i]]
            if not (types.is_integer(kind) or types.is_floating(kind) or types.is_decimal(kind) or types.is_null(kind)):
                self.log.add(f"the column holds {kind}, expected numbers", None, self._names[i], "store it as double")
        for i in texts:
            kind = types_by_name[self._names[i]]
            inner = kind.value_type if types.is_dictionary(kind) else kind
            if not (types.is_string(inner) or types.is_large_string(inner) or types.is_integer(inner)):
                self.log.add(f"the column holds {kind}, expected text", None, self._names[i], "store it as string")
        self.log.raise_if_any()

    def _numbers(self, column: pyarrow.Array, name: str, first: int) -> Array:
        """Return one batch of a column, with NaN where a problem was logged; ``first`` rows precede it."""
        from pyarrow import float64

        missing = np.asarray(column.is_null())
        values: Array = column.cast(float64(), safe=False).to_numpy(zero_copy_only=False)
        rows = np.arange(first + 1, first + 1 + len(values))
        infinite = ~np.isfinite(values) & ~missing
        if self._skip_gaps:
            self._gaps.update(rows[missing | infinite].tolist())
            return values
        if missing.any():
            self.log.add_rows(missing, rows, name, lambda i: "the value is missing, expected a number")
        if infinite.any():
            stored = values
            self.log.add_rows(infinite, rows, name, lambda i: f"found {clip(str(stored[i]))}, expected a finite number")
            values = np.where(infinite, np.nan, stored)
        return values

    def _texts(self, column: pyarrow.Array, name: str, first: int) -> NDArray[np.str_]:
        from pyarrow import string

        texts = [(text or "").strip() for text in column.cast(string()).to_pylist()]
        for i, text in enumerate(texts):
            if not text:
                self.log.add("the value is missing, expected text", first + i + 1, name)
            elif len(text) > MAX_TEXT:
                message = f"the text has {len(text)} characters, expected at most {MAX_TEXT}"
                self.log.add(message, first + i + 1, name)
        return np.array([text[:MAX_TEXT] for text in texts], dtype=str)
