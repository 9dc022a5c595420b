"""Parts of a text table that is too large for the memory: some bytes of it in whole lines, read as a table each."""

from __future__ import annotations

import hashlib
import io
import itertools
import os
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from robacc.errors import InputError
from robacc.io.files import opened
from robacc.io.table import BOM, Block, TableOptions, TextTable

LARGE = 1 << 26
"""Bytes from which a table is read in parts: half a million poses, whose columns fill some hundred megabytes."""
_PART = 1 << 24
"""Bytes of a part: the columns and errors of its poses are small beside the programs' own memory."""
_SAMPLES, _SAMPLE = 256, 1 << 13
"""Places of the file, evenly spread, and bytes at each, that are a sample of it: some ten thousand poses."""
_BLOCK = 1 << 20


class TablePart(NamedTuple):
    """Lines of a large text table."""

    path: str
    head: bytes
    """First lines of the file, up to the names of the columns."""
    spans: tuple[tuple[int, int, int], ...]
    """First byte, byte behind the last one, and number of the first line of each piece."""
    sha256: str
    """Digest of the whole file."""

    @classmethod
    def divided(cls, path: str, options: TableOptions) -> tuple[TablePart, ...]:
        """Return an evenly spread sample of a large file of the documented form, and the parts that are the whole.

        Nothing for any other file.

        The file is read once, for its digest and the numbers of its lines.

        Raises:
            InputError: The file cannot be read, or is no table.
        """
        is_small = "://" not in path and not (os.path.isfile(path) and os.path.getsize(path) >= LARGE)
        if options.frame is not None or is_small:
            return ()
        with opened(path) as stream:
            if (size := stream.seek(0, os.SEEK_END)) < LARGE:
                return ()
            stream.seek(0)
            lines = stream.read(_BLOCK).split(b"\n")
            names = next(
                (i for i, line in enumerate(lines) if line.strip() and not line.removeprefix(BOM).startswith(b"#")),
                None,
            )
            if names is None or b"\0" in lines[0]:
                return ()
            head = b"\n".join(lines[: names + 1]) + b"\n"
            try:
                table = TextTable(io.BytesIO(head), path, options)
            except InputError:
                return ()  # The whole file shows what it is.
            if not table.dialect.is_documented or not all(map(options.is_known, table.names)):
                return ()
            stream.seek(0)
            ends = np.linspace(len(head), size, 1 + -(-(size - len(head)) // _PART), dtype=np.int64)
            samples = np.linspace(len(head), size, 2 * _SAMPLES + 1, dtype=np.int64)[1::2]
            places = {len(head): (len(head), names + 2)}
            wanted = np.unique((*ends, *samples, *(samples + _SAMPLE))).tolist()[1:]
            digest, position, number = hashlib.sha256(), 0, 1
            while block := stream.read(_BLOCK):
                digest.update(block)
                while wanted and wanted[0] <= position + len(block):
                    end = block.find(b"\n", max(wanted[0] - position - 1, 0)) + 1
                    if not end:
                        break
                    places[wanted.pop(0)] = position + end, number + block.count(b"\n", 0, end)
                position, number = position + len(block), number + block.count(b"\n")
            places |= dict.fromkeys(wanted, (position, number))

        def part(first: np.int64, last: np.int64) -> tuple[int, int, int]:
            (start, line), (stop, _) = places[int(first)], places[int(last)]
            return start, stop, line

        spread = tuple(part(start, start + _SAMPLE) for start in samples)
        pieces = [spread, *((part(*pair),) for pair in itertools.pairwise(ends))]
        return tuple(cls(path, head, spans, digest.hexdigest()) for spans in pieces)


class PartTable(TextTable):
    """Table of a part; its rows have the numbers of their lines in the file."""

    def __init__(self, part: TablePart, options: TableOptions) -> None:
        """Read the names of the columns."""
        self._part, self.sha256 = part, part.sha256
        super().__init__(io.BytesIO(part.head), part.path, options)

    def _read_blocks(self, stream: io.BufferedIOBase, number: int = 1) -> Iterator[Block]:  # type: ignore[override]
        yield from super()._read_blocks(stream, number)  # type: ignore[arg-type]
        with opened(self._part.path) as whole:
            for start, stop, first in self._part.spans:
                whole.seek(start)
                yield from super()._read_blocks(io.BytesIO(whole.read(stop - start)), first)
