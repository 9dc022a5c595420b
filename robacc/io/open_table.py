"""Open a table: a Parquet file, a workbook or a recording, known by its first bytes, a data frame, or else text."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import PurePath
from typing import BinaryIO, Protocol

from robacc.errors import InputError, Problem
from robacc.io.files import STANDARD_STREAM, TEXT_LIMIT, ProblemLog
from robacc.io.table import Header, TableBody, TableOptions, TableReader

_PARQUET = b"PAR1"
"""First and last bytes of every Parquet file."""
SIGNATURES = (b"PK\x03\x04", b"\xd0\xcf\x11\xe0")
"""First bytes of zipped and of old workbooks."""
_RECORDINGS = (b"\x89MCAP0\r\n", b"SQLite format 3\x00", b"#ROSBAG V")
"""First bytes of an MCAP file, of a ROS 2 bag in SQLite, and of a ROS 1 bag."""
_OTHER_FILES = {
    b"%PDF": "a PDF document",
    b"\x1f\x8b": "compressed by gzip",
    b"BZh": "compressed by bzip2",
    b"7z\xbc\xaf": "an archive of 7-Zip",
    b"\x89PNG": "a PNG image",
    b"\xff\xd8\xff": "a JPEG image",
    b"<!doctype": "an HTML page",
    b"<html": "an HTML page",
    b"<?xml": "an XML document",
    b"header:": "a text of ROS messages",
    b"---\nheader:": "a text of ROS messages",
}
"""What a file is that begins with these bytes, in small letters, and is no table."""
_LONGEST = 16
"""Bytes that tell one kind of file from another."""
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
        InputError: The file cannot be opened or read.
        UsageError: The file is Parquet, and the extra ``parquet`` is not installed.
    """
    if options is not None and options.frame is not None:
        from robacc.io.column_table import ColumnTable, frame_columns

        yield ColumnTable(frame_columns(options.frame, path), path, options)
        return
    if os.path.isdir(path):
        yield _folder(path, options)
        return
    is_stream = path == STANDARD_STREAM
    file = "<stdin>" if is_stream else path
    try:
        with nullcontext(sys.stdin.buffer) if is_stream else open(path, "rb") as stream:
            yield _reader(stream, file, options)
    except FileNotFoundError:
        raise InputError(Problem("the file does not exist", file)) from None
    except OSError as error:
        raise InputError(Problem(f"cannot be read: {str(error.strerror).lower()}", file)) from error


def _reader(stream: BinaryIO, file: str, options: TableOptions | None) -> Table:
    first = _first_bytes(stream)
    if first.startswith(_RECORDINGS):
        if stream is sys.stdin.buffer:
            raise InputError(
                Problem("is a recording, which is not read from a pipe", file, fix="name the file instead")
            )
        from robacc.io.bag import bag_table

        return bag_table(file, options or TableOptions())
    if first.startswith(_PARQUET):
        from robacc.io.parquet import ParquetReader

        return ParquetReader(stream, file, options)
    if first.startswith(SIGNATURES):
        from robacc.io.workbook import WorkbookReader

        return WorkbookReader(stream, file, options or TableOptions())
    start_of_text = first.removeprefix(b"\xef\xbb\xbf").lstrip()
    if start_of_text.startswith(b"["):
        start_of_text = b"[" + start_of_text[1:].lstrip()
    if start_of_text.startswith((b"{", b"[{", b"[[")) or file.lower().endswith((".yaml", ".yml")):
        from robacc.io.column_table import records_table

        return records_table(stream.read(TEXT_LIMIT), file, options or TableOptions())
    for start, kind in _OTHER_FILES.items():
        if first.startswith(start) or start_of_text.lower().startswith(start):
            fix = "unpack it first" if "compressed" in kind or "archive" in kind else "export the poses as CSV"
            fix = "record the topics in a bag (ros2 bag record), which is read as it is" if "ROS" in kind else fix
            raise InputError(Problem(f"is {kind}, expected a table of poses", file, fix=fix))
    if PurePath(file).suffix.lower() in _SUFFIXES:
        fix = "export it again, or rename it to .csv if it is text"
        raise InputError(Problem("is not a Parquet file: it does not begin with PAR1", file, fix=fix))
    return TableReader(stream, file, options)


def _folder(path: str, options: TableOptions | None) -> Table:
    """Return the table of a folder, which is the recording of a ROS 2 bag.

    Raises:
        InputError: It is another folder.
    """
    from robacc.io.bag import is_recording_folder

    if not is_recording_folder(path):
        fix = "name a file, or the folder of a ROS 2 bag with its metadata.yaml"
        raise InputError(Problem("is a folder, expected a file", path, fix=fix))
    from robacc.io.bag import bag_table

    return bag_table(path, options or TableOptions())


def _first_bytes(stream: BinaryIO) -> bytes:
    """Return the stream's first bytes without consuming them."""
    if hasattr(stream, "peek"):
        return bytes(stream.peek(_LONGEST)[:_LONGEST])
    start = stream.read(_LONGEST)
    stream.seek(0)
    return start
