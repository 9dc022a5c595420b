"""Parquet files, read one column at a time, and written; needs the extra ``parquet``."""

from __future__ import annotations

import hashlib
import io
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from robacc.errors import InputError, Problem, UsageError, install_advice, refuse
from robacc.io.column_table import ColumnTable
from robacc.io.files import write_file
from robacc.io.table import TableBody, TableOptions

_MOST_ROWS = 50_000_000
"""A small file can repeat a value a billion times; nobody measures that many poses."""
_MOST_NUMBERS = 2_000_000_000
"""Numbers of all columns in use: 16 GB."""
_PIPE_LIMIT = 2 << 30
"""Largest pipe, bytes: Parquet is read from its end, so a pipe is read completely."""
_INDEX = re.compile(r"__index_level_\d+__")
"""Columns in which pandas stores its row numbers."""


def takes(path: str, first: bytes) -> bool:
    """Return whether a file is Parquet, by its first bytes."""
    return first.startswith(b"PAR1")


def read_stream(stream: BinaryIO, file: str, options: TableOptions) -> ColumnTable:
    """Return a file as a table."""
    return ParquetTable(stream, file, options.skip_gaps)


def write(path: str | os.PathLike[str], columns: Mapping[str, Sequence[Any]]) -> None:
    """Write columns as a Parquet file, completely or not at all.

    Raises:
        InputError: The file cannot be written.
        UsageError: pyarrow is not installed.
    """
    try:
        from pyarrow import BufferOutputStream, parquet, table
    except ImportError as error:
        raise UsageError(f"Parquet needs an optional package; run {install_advice('parquet')}") from error
    stream = BufferOutputStream()
    parquet.write_table(table(dict(columns)), stream)
    write_file(path, stream.getvalue().to_pybytes())


class ParquetTable(ColumnTable):
    """Table of one Parquet file, without pandas' index, of which Arrow reads one column at a time."""

    def __init__(self, stream: BinaryIO, file: str, skip_gaps: bool) -> None:
        """Read the names of the columns of ``stream``, called ``file`` in messages.

        Raises:
            UsageError: The extra ``parquet`` is not installed.
            InputError: The file is damaged, or too large.
        """
        try:
            from pyarrow.parquet import ParquetFile
        except ImportError as error:
            raise UsageError(
                f"{file} is Parquet, which needs an optional package; run {install_advice('parquet')}"
            ) from error
        self.file = file
        if not stream.seekable():
            data = stream.read(_PIPE_LIMIT + 1)
            pipe = f"the pipe holds more than {_PIPE_LIMIT >> 30} GiB"
            refuse((len(data) > _PIPE_LIMIT, Problem(pipe, file, fix="name a file instead")))
            stream = io.BytesIO(data)
        digest = hashlib.file_digest(stream, "sha256").hexdigest()  # type: ignore[arg-type]
        stream.seek(0)
        with self._arrow_errors():
            self._opened = ParquetFile(stream, pre_buffer=False, page_checksum_verification=True)
            fields = [field for field in self._opened.schema_arrow if not _INDEX.fullmatch(field.name)]
            self._parts = [(field, part) for field in fields for part in self._places(field)]
        self._kinds = [field.type if part is None else field.type.value_type for field, part in self._parts]
        names = [field.name if part is None else f"{field.name}_{part + 1}" for field, part in self._parts]
        super().__init__([(name, np.empty(0)) for name in names], file, skip_gaps, digest)
        self.n = self._opened.metadata.num_rows
        many = Problem(f"found {self.n} rows", file, fix=f"expected at most {_MOST_ROWS}")
        refuse((not 0 <= self.n <= _MOST_ROWS, many))

    def _places(self, field: Any) -> Sequence[int | None]:
        """Return the places in the lists of a column, as long as its first one; None for a column without lists."""
        from pyarrow import types

        if not (types.is_list(field.type) or types.is_fixed_size_list(field.type)):
            return [None]
        first = next(self._opened.iter_batches(1, columns=[field.name]), None)
        length = len(first.column(0)[0] or ()) if first is not None else 0
        return range(length) if length > 1 else [None]

    def body(self, numbers: Sequence[int], texts: Sequence[int]) -> TableBody:
        """Return every row, with the columns of the given indices only; :attr:`log` collects problems of values.

        Raises:
            InputError: The file is damaged, or the type of a column does not fit its name.
        """
        from pyarrow import types

        of_numbers = (types.is_integer, types.is_floating, types.is_decimal, types.is_null)
        of_texts = (types.is_string, types.is_large_string, types.is_integer)
        for i in (*numbers, *({*texts} - self.times - {*self.sparse})):
            kind = self._kinds[i]
            inner = kind.value_type if types.is_dictionary(kind) and i not in numbers else kind
            if not any(is_kind(inner) for is_kind in (of_numbers if i in numbers else of_texts)):
                expected, stored = ("numbers", "double") if i in numbers else ("text", "string")
                self.log.add(
                    f"the column holds {kind}, expected {expected}", None, self.labels[i], f"store it as {stored}"
                )
        # Arrow cannot select one of two columns with the same name; the log has that problem already.
        self.log.raise_if_any()
        many = Problem(f"found {self.n} rows of {len(numbers)} columns", self.file, fix="split the file")
        refuse((self.n * len(numbers) > _MOST_NUMBERS, many))
        return super().body(numbers, texts)

    def column(self, index: int) -> tuple[NDArray[Any], NDArray[np.bool_]]:
        """Return a column, and where its values are missing."""
        from pyarrow import compute, float64, string, types

        (field, part), kind = self._parts[index], self._kinds[index]
        inner = kind.value_type if types.is_dictionary(kind) else kind
        is_text = types.is_string(inner) or types.is_large_string(inner) or types.is_timestamp(inner)
        with self._arrow_errors():
            stored = self._opened.read([field.name], use_threads=False).column(0)
            if part is not None:
                stored = compute.list_element(stored, part)
            missing = np.asarray(stored.is_null())
            if is_text or not types.is_integer(inner) or stored.null_count:
                stored = stored.cast(string() if is_text else float64(), safe=False)
            values = stored.to_numpy()
        refuse(
            (values.size != self.n, self._damaged(f"its header announces {self.n} rows, the data has another number"))
        )
        return values, missing

    @contextmanager
    def _arrow_errors(self) -> Iterator[None]:
        """Raise errors of Arrow as problems of the file."""
        from pyarrow import ArrowException

        try:
            yield
        except (ArrowException, OSError, UnicodeDecodeError) as error:
            raise InputError(self._damaged(str(error).strip().partition("\n")[0][:200])) from error

    def _damaged(self, why: str) -> Problem:
        return Problem(f"cannot be read as Parquet ({why})", self.file, fix="it is damaged or cut short")
