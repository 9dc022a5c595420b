"""Open a table: a Parquet file, a workbook or a recording, known by its first bytes, a data frame, or else text."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import PurePath
from typing import BinaryIO

from robacc.errors import InputError, Problem
from robacc.io.files import STANDARD_STREAM, TEXT_LIMIT
from robacc.io.table import Table, TableOptions, TextTable

_PARQUET = b"PAR1"
"""First and last bytes of every Parquet file."""
SIGNATURES = (b"PK\x03\x04", b"\xd0\xcf\x11\xe0")
"""First bytes of zipped and of old workbooks."""
_RECORDINGS = (b"\x89MCAP0\r\n", b"SQLite format 3\x00", b"#ROSBAG V")
"""First bytes of an MCAP file, of a ROS 2 bag in SQLite, and of a ROS 1 bag."""
_EXPORT, _UNPACK = "export the poses as CSV", "unpack it first"
_OTHER_FILES = {
    b"%PDF": ("a PDF document", _EXPORT),
    b"\x1f\x8b": ("compressed by gzip", _UNPACK),
    b"BZh": ("compressed by bzip2", _UNPACK),
    b"7z\xbc\xaf": ("an archive of 7-Zip", _UNPACK),
    b"\x89PNG": ("a PNG image", _EXPORT),
    b"\xff\xd8\xff": ("a JPEG image", _EXPORT),
    b"<!doctype": ("an HTML page", _EXPORT),
    b"<html": ("an HTML page", _EXPORT),
    b"<?xml": ("an XML document", _EXPORT),
}
"""What a file is that begins with these bytes, in small letters, and is no table, and what to do."""
_LONGEST = 16
"""Bytes that tell one kind of file from another."""
_SUFFIXES = frozenset({".parquet", ".pq"})


@contextmanager
def open_table(path: str, options: TableOptions) -> Iterator[Table]:
    """Open the file, or standard input for ``-``, as a table.

    Raises:
        InputError: The file cannot be opened or read.
        UsageError: The file is Parquet, and the extra ``parquet`` is not installed.
    """
    is_stream = path == STANDARD_STREAM
    file = "<stdin>" if is_stream else path
    if options.frame is not None:
        from robacc.io.column_table import ColumnTable, frame_columns

        yield ColumnTable(frame_columns(options.frame, path), path, options.skip_gaps)
    elif os.path.isdir(path):
        if not os.path.isfile(os.path.join(path, "metadata.yaml")):
            fix = "name a file, or the folder of a ROS 2 bag with its metadata.yaml"
            raise InputError(Problem("is a folder, expected a file", path, fix=fix))
        yield _recording(path, options)
    else:
        try:
            with nullcontext(sys.stdin.buffer) if is_stream else open(path, "rb") as stream:
                yield _table(stream, file, options)
        except FileNotFoundError:
            raise InputError(Problem("the file does not exist", file)) from None
        except OSError as error:
            raise InputError(Problem(f"cannot be read: {str(error.strerror).lower()}", file)) from error


def _recording(path: str, options: TableOptions) -> Table:
    from robacc.io.bag import bag_table

    return bag_table(path, options)


def _table(stream: BinaryIO, file: str, options: TableOptions) -> Table:
    if hasattr(stream, "peek"):
        first = bytes(stream.peek(_LONGEST)[:_LONGEST])
    else:
        first = stream.read(_LONGEST)
        stream.seek(0)
    if first.startswith(_RECORDINGS):
        if stream is sys.stdin.buffer:
            fix = "name the file instead"
            raise InputError(Problem("is a recording, which is not read from a pipe", file, fix=fix))
        return _recording(file, options)
    if first.startswith(_PARQUET):
        from robacc.io.parquet import ParquetTable

        return ParquetTable(stream, file, options.skip_gaps)
    if first.startswith(SIGNATURES):
        from robacc.io.workbook import WorkbookTable

        return WorkbookTable(stream, file, options)
    text = first.removeprefix(b"\xef\xbb\xbf").lstrip()
    if re.match(rb"\{|\[\s*[\[{]|(---\s+)?header:", text) or file.lower().endswith((".yaml", ".yml")):
        from robacc.io.column_table import records_table

        return records_table(stream.read(TEXT_LIMIT), file, options.skip_gaps)
    for start, (kind, fix) in _OTHER_FILES.items():
        if first.startswith(start) or text.lower().startswith(start):
            raise InputError(Problem(f"is {kind}, expected a table of poses", file, fix=fix))
    if PurePath(file).suffix.lower() in _SUFFIXES:
        fix = "export it again, or rename it to .csv if it is text"
        raise InputError(Problem("is not a Parquet file: it does not begin with PAR1", file, fix=fix))
    return TextTable(stream, file, options)
