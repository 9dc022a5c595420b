"""Open a table: a Parquet file, recognised by its first bytes, or else CSV text."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import PurePath
from typing import BinaryIO, Protocol

from robacc.errors import InputError, Problem
from robacc.io.files import STANDARD_STREAM
from robacc.io.problem_log import ProblemLog
from robacc.io.table import Header, TableBody, TableReader

_PARQUET = b"PAR1"
"""First and last bytes of every Parquet file."""
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

    def body(self, numbers: Sequence[int], texts: Sequence[int]) -> TableBody:
        """Return every row, with the columns of the given indices only."""


@contextmanager
def open_table(path: str) -> Iterator[Table]:
    """Open the file, or standard input for ``-``, as a table.

    Raises:
        InputError: The file cannot be opened.
        UsageError: The file is Parquet, and the extra ``parquet`` is not installed.
    """
    if path == STANDARD_STREAM:
        yield _reader(sys.stdin.buffer, "<stdin>")
        return
    try:
        stream = open(path, "rb")  # noqa: SIM115 (closed below; only the failure to open is an error of the input)
    except OSError as error:
        raise InputError(Problem(f"cannot be read ({error.strerror})", path)) from error
    with stream:
        yield _reader(stream, path)


def _reader(stream: BinaryIO, file: str) -> Table:
    if _first_bytes(stream) == _PARQUET:
        from robacc.io.parquet import ParquetReader

        return ParquetReader(stream, file)
    if PurePath(file).suffix.lower() in _SUFFIXES:
        fix = "export it again, or rename it to .csv if it is text"
        raise InputError(Problem("is not a Parquet file: it does not begin with PAR1", file, fix=fix))
    return TableReader(stream, file)


def _first_bytes(stream: BinaryIO) -> bytes:
    """Return the stream's first bytes without consuming them."""
    if hasattr(stream, "peek"):
        return bytes(stream.peek(len(_PARQUET))[: len(_PARQUET)])
    start = stream.read(len(_PARQUET))
    stream.seek(0)
    return start
