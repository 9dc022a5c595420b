"""Blocks of complete lines of a text file, read once: a pipe works like a file, and memory is bounded."""

from __future__ import annotations

import contextlib
import hashlib
import io
import os
import stat
from collections.abc import Iterator
from dataclasses import dataclass
from typing import BinaryIO

from robacc.errors import InputError, Problem

MAX_LINE = 1 << 20
"""Largest line, bytes: a file without line ends must not fill the memory before it is refused."""
_PIECE = 1 << 22
"""Bytes read at a time."""
_BLOCK = 1 << 18
"""Bytes split at a time: the block, its lines and its numbers fit the second-level cache."""
_BOM = b"\xef\xbb\xbf"
_UTF16 = (b"\xff\xfe", b"\xfe\xff")
_UTF16_LIMIT = 1 << 28
"""Largest UTF-16 file, bytes: it is decoded in one piece."""
_MOST_LINES = 1000
_NO_CHARACTER = b"\x81\x8d\x8f\x90\x9d"
"""Bytes that Windows-1252 leaves open."""


@dataclass(frozen=True, slots=True)
class Block:
    """Complete lines of the file, without their line ends."""

    lines: list[str]
    first: int
    """1-based number of the first line."""


class LineReader:
    """Reader of UTF-8 lines with any line end; it counts lines and computes the digest of the bytes."""

    def __init__(self, stream: BinaryIO, file: str) -> None:
        """Read ``stream``; ``file`` is its name in errors."""
        self._stream = stream
        self._file = file
        self.encoding = "UTF-8"
        """Windows-1252 where a line is not UTF-8."""
        self.not_text: list[Problem] = []
        """Lines with bytes that Windows-1252 does not have either, up to :data:`_MOST_LINES`."""
        self._digest = hashlib.sha256()
        self._size = 0
        """Size of a plain file, bytes; 0 for any other stream."""
        with contextlib.suppress(OSError):  # a stream in memory has no descriptor
            status = os.fstat(stream.fileno())
            self._size = status.st_size if stat.S_ISREG(status.st_mode) else 0
        self._consumed = 0
        self.ends_with_line = True
        """Whether the bytes read so far end with the end of a line."""

    @property
    def sha256(self) -> str:
        """Digest of the bytes read so far, in hexadecimal."""
        return self._digest.hexdigest()

    @property
    def share_read(self) -> float:
        """Share of the file that has been read, above 0 and up to 1; 0.5 where the file size is unknown."""
        return min(self._consumed / self._size, 1.0) if self._size else 0.5

    def blocks(self) -> Iterator[Block]:
        """Yield blocks of complete lines.

        Raises:
            InputError: The file is not text, or a line is longer than :data:`MAX_LINE`.
        """
        number = 1
        while piece := self._piece(number):
            view, start = memoryview(piece), 0
            while start < len(piece):
                end = piece.rfind(b"\n", start, start + _BLOCK) + 1 or piece.find(b"\n", start) + 1 or len(piece)
                if end - start > MAX_LINE:
                    raise self._too_long(number)
                try:
                    lines = str(view[start:end], "utf-8").split("\n")
                except UnicodeDecodeError:
                    lines = [self._decode(line, i) for i, line in enumerate(piece[start:end].split(b"\n"), number)]
                if not lines[-1]:
                    lines.pop()  # nothing follows the last line's end
                self._consumed += end - start
                yield Block(lines, number)
                number, start = number + len(lines), end

    def _piece(self, number: int) -> bytes:
        """Return the next bytes up to a line's end, with every line end as a line feed; empty at the file's end."""
        data = self._stream.read(_PIECE)
        if data and not data.endswith(b"\n"):
            tail = self._stream.readline(MAX_LINE)
            data += tail
            if len(tail) == MAX_LINE and not tail.endswith(b"\n"):
                raise self._too_long(number + data.count(b"\n"))
        self.ends_with_line = data.endswith((b"\n", b"\r")) if data else self.ends_with_line
        if self.encoding != "UTF-16":
            self._digest.update(data)
            if number == 1 and data.startswith(_UTF16):
                return self._transcoded(data)
        if b"\0" in data:
            raise self._binary()
        if number == 1:
            data = data.removeprefix(_BOM)
        return data.replace(b"\r\n", b"\n").replace(b"\r", b"\n") if b"\r" in data else data

    def _transcoded(self, start: bytes) -> bytes:
        """Return the first piece of a UTF-16 file as UTF-8, after reading all of it."""
        data = start + self._stream.read(_UTF16_LIMIT - len(start))
        if len(data) >= _UTF16_LIMIT:
            raise InputError(Problem("the UTF-16 file is too large", self._file, fix="save it as UTF-8"))
        self._digest.update(data[len(start) :])
        try:
            text = data.decode("utf-16")
        except UnicodeDecodeError:
            raise self._binary() from None
        self.encoding, self._size = "UTF-16", 0
        self._stream = io.BytesIO(text.encode("utf-8", errors="replace"))
        return self._piece(1)

    def _binary(self) -> InputError:
        message = "the file is not UTF-8 text (it is UTF-16 or binary)"
        return InputError(Problem(message, self._file, fix="save it as UTF-8"))

    def _too_long(self, line: int) -> InputError:
        message = f"the line is longer than {MAX_LINE / (1 << 20):g} MB"
        return InputError(Problem(message, self._file, line, fix="expected one line per pose"))

    def _decode(self, line: bytes, number: int) -> str:
        try:
            return line.decode()
        except UnicodeDecodeError as error:
            self.encoding = "Windows-1252"
            if any(byte in _NO_CHARACTER for byte in line) and len(self.not_text) < _MOST_LINES:
                message = f"byte {error.start + 1} of the line, 0x{line[error.start]:02x}, is not UTF-8"
                self.not_text.append(Problem(message, self._file, number, fix="save the file as UTF-8"))
            return line.decode("cp1252", errors="replace")
