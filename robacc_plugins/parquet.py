"""Parquet: a file, or the files of a folder or a pattern as one table; read one column at a time, written too.

Needs the extra ``parquet``. A table that is too large for the memory is read in parts, which are the same rows however
they are spread over files and row groups.
"""

from __future__ import annotations

import glob
import hashlib
import io
import itertools
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from robacc.errors import InputError, Problem, UsageError, install_advice, refuse
from robacc.io.column_table import ColumnTable
from robacc.io.files import opened, write_file
from robacc.io.table import TableBody, TableOptions, TableRows

_MOST_ROWS = 50_000_000
"""A small file can repeat a value a billion times; nobody reads that many poses at once."""
_MOST_NUMBERS = 2_000_000_000
"""Numbers of all columns in use: 16 GB."""
_PIPE_LIMIT = 2 << 30
"""Largest pipe, bytes: Parquet is read from its end, so a pipe is read completely."""
_INDEX = re.compile(r"__index_level_\d+__")
"""Columns in which pandas stores its row numbers."""
_ENDINGS = (".parquet", ".pq")
LARGE = 1 << 19
"""Rows from which a table is read in parts, as a text table of so many poses is."""
_PART = 1 << 17
"""Rows of a part."""
_SAMPLES, _SAMPLE = 256, 40
"""Places of the table, evenly spread, and rows at each, that are a sample of it: some ten thousand poses."""
_BATCH = 1 << 16
"""Rows of a row group that are decoded at a time."""


def takes(path: str, first: bytes) -> bool:
    """Return whether a file is Parquet, by its first bytes, or a folder or a pattern is of such files alone."""
    return first.startswith(b"PAR1") or (not first and bool(_files_of(path)))


def read_stream(stream: BinaryIO, file: str, options: TableOptions) -> ColumnTable:
    """Return a file as a table."""
    if not stream.seekable():
        data = stream.read(_PIPE_LIMIT + 1)
        pipe = f"the pipe holds more than {_PIPE_LIMIT >> 30} GiB"
        refuse((len(data) > _PIPE_LIMIT, Problem(pipe, file, fix="name a file instead")))
        stream = io.BytesIO(data)
    return ParquetTable(ParquetPart(file, (file,)), options.skip_gaps, lambda name: nullcontext(stream))


def read(path: str, options: TableOptions) -> ColumnTable:
    """Return the files of a folder or a pattern as one table, in the order of their names."""
    return ParquetTable(ParquetPart(path, _files_of(path)), options.skip_gaps)


def divided(path: str, options: TableOptions) -> tuple[ParquetPart, ...]:
    """Return an evenly spread sample of a large table with documented names, and the parts that are the whole.

    Nothing for any other table.

    Raises:
        InputError: A file cannot be read, or has other columns than the first.
    """
    files = _files_of(path)
    if not files:
        return ()
    table = ParquetTable(ParquetPart(path, files), False, is_in_parts=True)
    if table.n < LARGE or not all(map(options.is_known, table.names)):
        return ()
    ends = [*range(0, table.n, _PART), table.n]
    samples = np.linspace(0, table.n, 2 * _SAMPLES + 1, dtype=np.int64)[1::2].tolist()
    spread = tuple((start, min(start + _SAMPLE, table.n)) for start in samples)
    pieces = [spread, *(((first, last),) for first, last in itertools.pairwise(ends))]
    return tuple(table.part(spans) for spans in pieces)


def _files_of(path: str) -> tuple[str, ...]:
    """Return the files that a path stands for, numbers in their names in order; nothing for another folder.

    A folder has Parquet files alone, beside hidden files and such that begin with an underscore.
    """
    if "://" in path:
        found = [path] if path.endswith(_ENDINGS) and "*" not in path else _stored_files(path)
    elif os.path.isdir(path):
        found = [os.path.join(path, name) for name in os.listdir(path) if name[0] not in "._"]
    else:
        found = glob.glob(path) if "*" in path else [path] * os.path.isfile(path)
    is_parquet = bool(found) and all(name.endswith(_ENDINGS) for name in found)
    return tuple(sorted(found, key=_in_order)) if is_parquet else ()


def _stored_files(path: str) -> list[str]:
    """Return the files of a folder or a pattern in an object store."""
    try:
        import fsspec

        store, place = fsspec.core.url_to_fs(path)
        found = store.glob(place if "*" in place else f"{place.rstrip('/')}/*.parquet")
        return [store.unstrip_protocol(name) for name in found]
    except (ImportError, ValueError, OSError):
        return []  # The error is reported when the path is opened as a file.


def _in_order(name: str) -> tuple[Any, ...]:
    return tuple((int(part) if part.isdecimal() else 0, part) for part in re.split(r"(\d+)", name))


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


@dataclass(frozen=True, slots=True)
class ParquetPart(TableRows):
    """Rows of a table in one file or several."""

    path: str
    """Name of the table in messages."""
    files: tuple[str, ...]
    firsts: tuple[int, ...] = ()
    """Number of the first row of each file, from 0; empty for files that were not opened yet."""
    spans: tuple[tuple[int, int], ...] = ()
    """First row, and row behind the last, of each piece; empty for all rows."""
    sha256: str = ""
    """Digest of the bytes of all files of the table."""

    def table(self, options: TableOptions) -> ColumnTable:
        """Return the rows as a table."""
        return ParquetTable(self, options.skip_gaps)


class ParquetTable(ColumnTable):
    """Table of Parquet files, without pandas' index, of which Arrow reads one column at a time."""

    def __init__(
        self,
        part: ParquetPart,
        skip_gaps: bool,
        opened: Callable[[str], AbstractContextManager[BinaryIO]] = opened,
        is_in_parts: bool = False,
    ) -> None:
        """Read the names of the columns.

        Args:
            part: The files and rows.
            skip_gaps: Leave out rows with a missing value.
            opened: Opens a file.
            is_in_parts: Whether the table is to be divided, so that it may have any number of rows, and need not be
                read for its digest before it is known to be large.

        Raises:
            UsageError: The extra ``parquet`` is not installed.
            InputError: A file is damaged or too large, or has other columns than the first.
        """
        try:
            from pyarrow.parquet import read_metadata
        except ImportError as error:
            raise UsageError(
                f"{part.path} is Parquet, which needs an optional package; run {install_advice('parquet')}"
            ) from error
        self.file, self._part, self._opened = part.path, part, opened
        digest, counts, self._about = hashlib.sha256(), list[int](), list[Any]()
        for name in part.files:
            with self._arrow_errors(name), opened(name) as stream:
                if not (part.sha256 or is_in_parts):
                    self._add_to(digest, stream)
                self._about.append(read_metadata(stream))
            counts.append(self._about[-1].num_rows)
        self.firsts = part.firsts or tuple(np.cumsum([0, *counts[:-1]]).tolist())
        self.spans = part.spans or ((0, sum(counts)),)
        fields, *others = ([field for field in about.schema.to_arrow_schema()] for about in self._about)
        fields = [field for field in fields if not _INDEX.fullmatch(field.name)]
        names = [field.name for field in fields]
        for path, other in zip(part.files[1:], others, strict=True):
            differs = set(names) ^ {field.name for field in other if not _INDEX.fullmatch(field.name)}
            refuse((differs, Problem(f"{part.files[0]} has other columns: {', '.join(sorted(differs))}", path)))
        self._parts = [(field, place) for field in fields for place in self._places(field)]
        self._kinds = [field.type if place is None else field.type.value_type for field, place in self._parts]
        names = [field.name if place is None else f"{field.name}_{place + 1}" for field, place in self._parts]
        sha256 = part.sha256 or digest.hexdigest()
        super().__init__([(name, np.empty(0)) for name in names], self.file, skip_gaps, sha256)
        self.n = sum(last - first for first, last in self.spans)
        many = Problem(f"found {self.n} rows", self.file, fix=f"expected at most {_MOST_ROWS}")
        refuse((not 0 <= self.n <= _MOST_ROWS and not is_in_parts, many))

    def part(self, spans: tuple[tuple[int, int], ...]) -> ParquetPart:
        """Return the rows of a whole table within these spans, with the files that have them."""
        if self.sha256 == hashlib.sha256().hexdigest():
            digest = hashlib.sha256()
            for name in self._part.files:
                with self._opened(name) as stream:
                    self._add_to(digest, stream)
            self.sha256 = digest.hexdigest()
        ends = [*self.firsts[1:], self.n]
        own = [
            (name, first)
            for name, first, end in zip(self._part.files, self.firsts, ends, strict=True)
            if any(start < end and last > first for start, last in spans)
        ]
        files, firsts = zip(*own, strict=True)
        return ParquetPart(self.file, files, firsts, spans, self.sha256)

    @staticmethod
    def _add_to(digest: Any, stream: BinaryIO) -> None:
        while block := stream.read(1 << 20):
            digest.update(block)
        stream.seek(0)

    @property
    def places(self) -> NDArray[np.int64]:
        """Number of each row in the table, from 1."""
        return np.concatenate([np.arange(first + 1, last + 1, dtype=np.int64) for first, last in self.spans])

    def _places(self, field: Any) -> Sequence[int | None]:
        """Return the places in the lists of a column, as long as its first one; None for a column without lists."""
        from pyarrow import types

        if not (types.is_list(field.type) or types.is_fixed_size_list(field.type)):
            return [None]
        with self._arrow_errors(self._part.files[0]), self._opened_as_parquet(0) as file:
            first = next(file.iter_batches(1, columns=[field.name]), None)
        length = len(first.column(0)[0] or ()) if first is not None else 0
        return range(length) if length > 1 else [None]

    def body(self, numbers: Sequence[int], texts: Sequence[int]) -> TableBody:
        """Return every row, with the columns of the given indices only; :attr:`log` collects problems of values.

        Raises:
            InputError: A file is damaged, or the type of a column does not fit its name.
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
        of_files = [self._column(number, index) for number in range(len(self._part.files))]
        values, missing = map(np.concatenate, zip(*of_files, strict=True)) if len(of_files) > 1 else of_files[0]
        announced = f"its header announces {self.n} rows, the data has another number"
        refuse((values.size != self.n, self._damaged(self.file, announced)))
        return values, missing

    def _column(self, number: int, index: int) -> tuple[NDArray[Any], NDArray[np.bool_]]:
        """Return the rows of a file in a column, and where the values are missing."""
        from pyarrow import compute, float64, string, types

        (field, place), name = self._parts[index], self._part.files[number]
        with self._arrow_errors(name):
            stored = self._rows(number, field.name)
            if place is not None:
                stored = compute.list_element(stored, place)
            kind = stored.type
            inner = kind.value_type if types.is_dictionary(kind) else kind
            is_text = types.is_string(inner) or types.is_large_string(inner) or types.is_timestamp(inner)
            missing = np.asarray(stored.is_null())
            if is_text or not types.is_integer(inner) or stored.null_count:
                stored = stored.cast(string() if is_text else float64(), safe=False)
            return stored.to_numpy(), missing

    def _rows(self, number: int, name: str) -> Any:
        """Return the rows of a file that are in the table, of one column."""
        from pyarrow import array, chunked_array

        about, first = self._about[number], self.firsts[number]
        own = [(max(start - first, 0), min(last - first, about.num_rows)) for start, last in self.spans]
        own = [span for span in own if span[0] < span[1]]
        with self._opened_as_parquet(number) as file:
            if not self._part.spans:
                return file.read([name], use_threads=False).column(0)
            chunks, row = [], 0
            for group in range(about.num_row_groups):
                size = about.row_group(group).num_rows
                if not any(start < row + size and last > row for start, last in own):
                    row += size
                    continue
                for batch in file.iter_batches(_BATCH, row_groups=[group], columns=[name], use_threads=False):
                    ranges = [
                        np.arange(max(start - row, 0), min(last - row, len(batch)))
                        for start, last in own
                        if start < row + len(batch) and last > row
                    ]
                    # Copies: a slice would keep its batch in the memory.
                    chunks += [batch.column(0).take(array(np.concatenate(ranges)))] if ranges else []
                    row += len(batch)
            return chunked_array(chunks)

    @contextmanager
    def _opened_as_parquet(self, number: int) -> Iterator[Any]:
        from pyarrow.parquet import ParquetFile

        with self._opened(self._part.files[number]) as stream:
            stream.seek(0)
            yield ParquetFile(stream, metadata=self._about[number], pre_buffer=False, page_checksum_verification=True)

    @contextmanager
    def _arrow_errors(self, name: str) -> Iterator[None]:
        """Raise errors of Arrow as problems of a file."""
        from pyarrow import ArrowException

        try:
            yield
        except (ArrowException, OSError, UnicodeDecodeError) as error:
            raise InputError(self._damaged(name, str(error).strip().partition("\n")[0][:200])) from error

    @staticmethod
    def _damaged(name: str, why: str) -> Problem:
        return Problem(f"cannot be read as Parquet ({why})", name, fix="it is damaged or cut short")
