"""Open a table: a Parquet file or a workbook, recognised by its first bytes, or else text."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import PurePath
from typing import BinaryIO, Protocol

from robacc.errors import InputError, Problem
from robacc.io.files import STANDARD_STREAM
from robacc.io.problem_log import ProblemLog
from robacc.io.table import Header, TableBody, TableOptions, TableReader

_PARQUET = b"PAR1"
"""First and last bytes of every Parquet file."""
SIGNATURES = (b"PK\x03\x04", b"\xd0\xcf\x11\xe0")
"""First bytes of zipped and of old workbooks."""
_SUFFIXES = frozenset({".parquet", ".pq"})


class Table(Protocol):
    """Table that is read from front to back."""

    log: ProblemLog
    """Collects the table's problems."""
    file: str
    """Name of the file, for messages."""

    @property
    def sha256(self) -> str:
        """Digest of the file's bytes, once the body was read."""

    def header(self) -> Header:
        """Return the columns' names."""

    def description(self) -> str:
        """Return how the table differs from the documented form; empty where it does not."""

    def body(self, numbers: Sequence[int], texts: Sequence[int]) -> TableBody:
        """Return every row, with the columns of the given indices only."""


@contextmanager
def open_table(path: str, options: TableOptions | None = None) -> Iterator[Table]:
    """Open the file, or standard input for ``-``, as a table.

    Raises:
        InputError: The file cannot be opened.
        UsageError: The file is Parquet, and the extra ``parquet`` is not installed.
    """
    if path == STANDARD_STREAM:
        yield _reader(sys.stdin.buffer, "<stdin>", options)
        return
    try:
        stream = open(path, "rb")  # noqa: SIM115 (closed below; only the failure to open is an error of the input)
    except OSError as error:
        raise InputError(Problem(f"cannot be read ({error.strerror})", path)) from error
    with stream:
        yield _reader(stream, path, options)


def _reader(stream: BinaryIO, file: str, options: TableOptions | None) -> Table:
    if _first_bytes(stream) == _PARQUET:
        from robacc.io.parquet import ParquetReader

        return ParquetReader(stream, file, options)
    if _first_bytes(stream) in SIGNATURES:
        from robacc.io.workbook import WorkbookReader

        return WorkbookReader(stream, file, options or TableOptions())
    if PurePath(file).suffix.lower() in _SUFFIXES:
        fix = "export it again, or rename it to .csv if it is text"
        raise InputError(Problem("is not a Parquet file: it does not begin with PAR1", file, fix=fix))
    return TableReader(stream, file, options)


def _first_bytes(stream: BinaryIO) -> bytes:
    """Return the stream's first bytes without consuming them."""
    if hasattr(stream, "peek"):
        return bytes(stream.peek(len(_PARQUET))[: len(_PARQUET)])
    start = stream.read(len(_PARQUET))
    stream.seek(0)
    return start
