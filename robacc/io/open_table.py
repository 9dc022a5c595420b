"""Which of the two kinds of table a file is: CSV text, or Parquet, which its first bytes say."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import PurePath
from typing import BinaryIO, Protocol

from robacc.errors import InputError, Problem
from robacc.io.problem_log import ProblemLog
from robacc.io.table import Header, TableBody, TableReader

STDIN = "-"
_PARQUET = b"PAR1"
"""What every Parquet file begins with, and ends."""
_SUFFIXES = frozenset({".parquet", ".pq"})


class Table(Protocol):
    """A table that is read from front to back."""

    log: ProblemLog
    """Takes what is wrong with it."""
    file: str
    """Its name, for messages."""

    @property
    def sha256(self) -> str:
        """Of the file's bytes, once the body was read."""

    def header(self) -> Header:
        """The columns' names."""

    def body(self, numbers: Sequence[int], texts: Sequence[int]) -> TableBody:
        """Every row, the columns of the given indices only."""


@contextmanager
def open_table(path: str) -> Iterator[Table]:
    """A reader of the file, or of standard input for ``-``.

    Raises:
        InputError: It cannot be opened.
        UsageError: It is Parquet, and the extra ``parquet`` is not installed.
    """
    if path == STDIN:
        yield _reader(sys.stdin.buffer, "<stdin>")
        return
    try:
        stream = open(path, "rb")  # noqa: SIM115 (closed below; only opening may fail as the user's mistake)
    except OSError as error:
        raise InputError(Problem(f"cannot be read ({error.strerror})", path)) from error
    with stream:
        yield _reader(stream, path)


def _reader(stream: BinaryIO, file: str) -> Table:
    if _beginning(stream) == _PARQUET:
        from robacc.io.parquet import ParquetReader

        return ParquetReader(stream, file)
    if PurePath(file).suffix.lower() in _SUFFIXES:
        fix = "write it again, or name it .csv if it is text"
        raise InputError(Problem("is no Parquet file: it does not begin with PAR1", file, fix=fix))
    return TableReader(stream, file)


def _beginning(stream: BinaryIO) -> bytes:
    """The first bytes, which stay to be read."""
    if hasattr(stream, "peek"):
        return bytes(stream.peek(len(_PARQUET))[: len(_PARQUET)])
    start = stream.read(len(_PARQUET))
    stream.seek(0)
    return start
