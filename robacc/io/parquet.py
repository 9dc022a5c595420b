"""A Parquet file as columns of numbers and of text: the same table as a CSV file's, with rows in place of lines.

It is read in batches of rows by Arrow, the format's reference implementation, on one thread: what is held besides the
columns themselves does not grow with the file.
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

from robacc.errors import InputError, Problem, UsageError
from robacc.geometry import Array
from robacc.io.problem_log import ProblemLog, clip
from robacc.io.table import MAX_COLUMNS, MAX_TEXT, Header, TableBody

if TYPE_CHECKING:
    import pyarrow
    from pyarrow.parquet import ParquetFile

_ROWS_AT_ONCE = 1 << 16
_MOST_ROWS = 50_000_000
"""A small file can say that one value stands a billion times; nobody measures that many poses."""
_MOST_NUMBERS = 2_000_000_000
"""16 GB, the columns of such a file all in use."""
_PIPE_LIMIT = 2 << 30
"""Bytes of a pipe that are held: the format is read from its end, so a pipe is read whole."""
_INDEX = re.compile(r"__index_level_\d+__")
"""Columns that pandas keeps its own numbering of rows in."""


class ParquetReader:
    """Reads one Parquet file: first :meth:`header`, then :meth:`body`."""

    def __init__(self, stream: BinaryIO, file: str) -> None:
        """Read ``stream``, called ``file`` in messages.

        Raises:
            UsageError: The extra ``parquet`` is not installed.
        """
        try:
            import pyarrow.parquet  # noqa: F401
        except ImportError as error:
            message = f"{file} is Parquet, which needs an extra: pip install 'robacc[parquet]'"
            raise UsageError(message) from error
        self.file = file
        self.log = ProblemLog(file, "row")
        self._stream = stream
        self._sha256 = ""
        self._opened: ParquetFile | None = None
        self._names: list[str] = []

    @property
    def sha256(self) -> str:
        """Digest of the file's bytes."""
        return self._sha256

    def header(self) -> Header:
        """The columns' names; pandas' index is none.

        Raises:
            InputError: The file is damaged, or too large.
        """
        from pyarrow.parquet import ParquetFile

        stream = self._whole()
        with self._understood():
            self._opened = ParquetFile(stream, pre_buffer=False, page_checksum_verification=True)
            schema = self._opened.schema_arrow
            rows = self._opened.metadata.num_rows
        self._names = [name for name in schema.names if not _INDEX.fullmatch(name)]
        if len(self._names) > MAX_COLUMNS:
            raise self._refused(f"found {len(self._names)} columns", f"expected at most {MAX_COLUMNS}")
        if not 0 <= rows <= _MOST_ROWS:
            raise self._refused(f"found {rows} rows", f"expected at most {_MOST_ROWS}")
        return Header(tuple(name.strip() for name in self._names), None)

    def body(self, numbers: Sequence[int], texts: Sequence[int]) -> TableBody:
        """Every row, the columns of the given indices only; what is wrong with values goes to :attr:`log`.

        Raises:
            InputError: The file is damaged, or a column is of a type that cannot be what its name says.
        """
        if self._opened is None:
            raise ValueError("the header is read first")
        wanted = [self._names[i] for i in (*numbers, *texts)]
        self._check_types(numbers, texts)
        # Of two columns of one name neither can be asked for; the log says so already.
        if any(Counter(self._names)[name] > 1 for name in wanted):
            self.log.raise_if_any()
        n = self._opened.metadata.num_rows
        if n * len(numbers) > _MOST_NUMBERS:
            raise self._refused(f"found {n} rows of {len(numbers)} columns", "measure less at a time")
        table = np.empty((len(numbers), n))
        columns: list[list[NDArray[np.str_]]] = [[np.empty(0, dtype=str)] for _ in texts]
        done = 0
        with self._understood():
            for batch in self._opened.iter_batches(_ROWS_AT_ONCE, columns=wanted, use_threads=False):
                end = done + batch.num_rows
                if end > n:
                    break
                for values, i in zip(table, numbers, strict=True):
                    values[done:end] = self._numbers(batch.column(self._names[i]), self._names[i], done)
                for column, i in zip(columns, texts, strict=True):
                    column.append(self._texts(batch.column(self._names[i]), self._names[i], done))
                done = end
        if done != n:
            raise self._damaged(f"{n} rows are announced, others are there")
        return TableBody(table, tuple(map(np.concatenate, columns)), np.arange(1, n + 1, dtype=np.int64))

    def _whole(self) -> BinaryIO:
        """The stream, or for a pipe what came through it; its digest is taken."""
        stream = self._stream
        if not stream.seekable():
            data = stream.read(_PIPE_LIMIT + 1)
            if len(data) > _PIPE_LIMIT:
                raise self._refused(f"more than {_PIPE_LIMIT >> 30} GiB come through the pipe", "name a file instead")
            stream = io.BytesIO(data)
        self._sha256 = hashlib.file_digest(stream, "sha256").hexdigest()  # type: ignore[arg-type]
        stream.seek(0)
        return stream

    def _refused(self, message: str, fix: str | None = None) -> InputError:
        return InputError(Problem(message, self.file, fix=fix))

    @contextmanager
    def _understood(self) -> Iterator[None]:
        """Turn what Arrow cannot read into an error of the file."""
        from pyarrow import ArrowException

        try:
            yield
        except (ArrowException, OSError, UnicodeDecodeError) as error:
            raise self._damaged(str(error).strip().partition("\n")[0][:200]) from error

    def _damaged(self, why: str) -> InputError:
        return self._refused(f"cannot be read as Parquet ({why})", "it is damaged or cut short")

    def _check_types(self, numbers: Sequence[int], texts: Sequence[int]) -> None:
        """Refuse columns whose type holds no numbers, or no ids."""
        from pyarrow import types

        if self._opened is None:
            return
        kinds = dict(zip(self._opened.schema_arrow.names, self._opened.schema_arrow.types, strict=True))
        for i in numbers:
            kind = kinds[self._names[i]]
            if not (types.is_integer(kind) or types.is_floating(kind) or types.is_decimal(kind) or types.is_null(kind)):
                self.log.add(f"the column holds {kind}, expected numbers", None, self._names[i], "store it as double")
        for i in texts:
            kind = kinds[self._names[i]]
            inner = kind.value_type if types.is_dictionary(kind) else kind
            if not (types.is_string(inner) or types.is_large_string(inner) or types.is_integer(inner)):
                self.log.add(f"the column holds {kind}, expected text", None, self._names[i], "store it as string")
        self.log.raise_if_any()

    def _numbers(self, column: pyarrow.Array, name: str, first: int) -> Array:
        """One batch of a column; NaN where a problem was logged. ``first`` rows stand above it."""
        from pyarrow import float64

        missing = np.asarray(column.is_null())
        values: Array = column.cast(float64(), safe=False).to_numpy(zero_copy_only=False)
        rows = np.arange(first + 1, first + 1 + len(values))
        wrong = ~np.isfinite(values) & ~missing
        if missing.any():
            self.log.add_rows(missing, rows, name, lambda i: "the value is missing, expected a number")
        if wrong.any():
            values = values.copy()
            found = values.copy()
            self.log.add_rows(wrong, rows, name, lambda i: f"found {clip(str(found[i]))}, expected a finite number")
            values[wrong] = np.nan
        return values

    def _texts(self, column: pyarrow.Array, name: str, first: int) -> NDArray[np.str_]:
        from pyarrow import string

        texts = [(text or "").strip() for text in column.cast(string()).to_pylist()]
        for i, text in enumerate(texts):
            if not text:
                self.log.add("the value is missing, expected a text", first + i + 1, name)
            elif len(text) > MAX_TEXT:
                message = f"the text has {len(text)} characters, expected at most {MAX_TEXT}"
                self.log.add(message, first + i + 1, name)
        return np.array([text[:MAX_TEXT] for text in texts], dtype=str)
