"""Blocks of complete lines of a text file, read once: a pipe works like a file, and memory is bounded."""

from __future__ import annotations

import hashlib
import io
import os
import stat
import threading
from collections.abc import Iterator
from dataclasses import dataclass
from typing import BinaryIO

from robacc.errors import InputError, Problem
from robacc.io.files import ProblemLog

MAX_LINE = 1 << 20
"""Largest line, bytes: a file without line ends must not fill the memory before it is refused."""
_PIECE = 1 << 22
"""Bytes read at a time; a thread hashes them while their lines are parsed."""
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

    def __init__(self, stream: BinaryIO, log: ProblemLog) -> None:
        """Read ``stream``; ``log`` names the file in errors."""
        self._stream = stream
        self._log = log
        self.encoding = "UTF-8"
        self.not_utf8: list[Problem] = []
        """Lines with bytes that are not UTF-8, up to :data:`_MOST_LINES`; they were read as Windows-1252."""
        self.not_text: list[Problem] = []
        """Those of them with bytes that Windows-1252 does not have either."""
        self._digest = _Digest()
        self._size = _size(stream)
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
                end = self._end_of_block(piece, start, number)
                block = Block(self._lines(view[start:end], number), number)
                self._consumed += end - start
                number, start = number + len(block.lines), end
                yield block

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
            raise InputError(Problem("the UTF-16 file is too large", self._log.file, fix="save it as UTF-8"))
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
        return InputError(Problem(message, self._log.file, fix="save it as UTF-8"))

    def _end_of_block(self, piece: bytes, start: int, number: int) -> int:
        end = piece.rfind(b"\n", start, start + _BLOCK) + 1 or piece.find(b"\n", start) + 1 or len(piece)
        if end - start > MAX_LINE:
            raise self._too_long(number)
        return end

    def _too_long(self, line: int) -> InputError:
        message = f"the line is longer than {MAX_LINE / (1 << 20):g} MB"
        return InputError(Problem(message, self._log.file, line, fix="expected one line per pose"))

    def _lines(self, data: memoryview, first: int) -> list[str]:
        try:
            lines = str(data, "utf-8").split("\n")
        except UnicodeDecodeError:
            lines = [self._decode(line, number) for number, line in enumerate(data.tobytes().split(b"\n"), first)]
        if not lines[-1]:
            lines.pop()  # nothing follows the last line's end
        return lines

    def _decode(self, line: bytes, number: int) -> str:
        try:
            return line.decode()
        except UnicodeDecodeError as error:
            if len(self.not_utf8) < _MOST_LINES:
                message = f"byte {error.start + 1} of the line, 0x{line[error.start]:02x}, is not UTF-8"
                problem = Problem(message, self._log.file, number, fix="save the file as UTF-8")
                self.not_utf8.append(problem)
                if any(byte in _NO_CHARACTER for byte in line):
                    self.not_text.append(problem)
            return line.decode("cp1252", errors="replace")


class _Digest:
    """SHA-256 of bytes that arrive in pieces; a thread hashes a large piece while the caller continues."""

    def __init__(self) -> None:
        self._hash = hashlib.sha256()
        self._running: threading.Thread | None = None

    def update(self, data: bytes) -> None:
        self._wait()
        if len(data) < _PIECE:
            self._hash.update(data)
        else:
            self._running = threading.Thread(target=self._hash.update, args=(data,))
            self._running.start()

    def hexdigest(self) -> str:
        self._wait()
        return self._hash.hexdigest()

    def _wait(self) -> None:
        if self._running is not None:
            self._running.join()
            self._running = None


def _size(stream: BinaryIO) -> int:
    """Return the size of a plain file in bytes, 0 for any other stream."""
    try:
        status = os.fstat(stream.fileno())
    except OSError:  # a stream in memory has no descriptor
        return 0
    return status.st_size if stat.S_ISREG(status.st_mode) else 0
