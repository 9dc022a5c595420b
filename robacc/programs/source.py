"""Text of a program that is written back byte for byte, and masks that hide its comments and strings."""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Iterable
from dataclasses import dataclass, field

from robacc.errors import InputError, Problem

PROGRAM_LIMIT = 64 * 2**20
"""Largest program that is read, bytes."""
NUMBER = r"[+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d+)?"
"""Pattern of a number in every dialect."""

_EAST_ASIAN = ("gb2312", "euc_kr", "euc_jp")
"""Code pages whose pairs of bytes can look like UTF-8, and in which no other text decodes."""


@dataclass(frozen=True, slots=True)
class ProgramSource:
    """Program text whose unchanged parts are written back byte for byte."""

    file: str
    text: str
    encoding: str
    """``utf-8``, ``8-bit`` (Windows and other code pages), ``utf-16-le`` or ``utf-16-be``. The first two have a
    character per byte, so that places in the text are places in the file."""
    _starts: tuple[int, ...] = field(repr=False, compare=False)

    @classmethod
    def of(cls, data: bytes, file: str) -> ProgramSource:
        """Return the source of a program's bytes.

        Raises:
            InputError: The bytes are no text, or mix UTF-8 with another encoding.
        """
        text, encoding = _decode(data, file)
        return cls(file, text, encoding, (0, *(match.end() for match in re.finditer(r"\r\n|\n|\r", text))))

    def line(self, position: int) -> int:
        """Return the 1-based line of a place in the text."""
        return bisect_right(self._starts, position)

    def excerpt(self, start: int, end: int) -> str:
        """Return a part of the text for a message: on one line, at most 60 characters, in the file's characters."""
        text = self.text[start : min(end, start + 200)]
        if not self.encoding.startswith("utf-16"):
            text = text.encode("latin-1").decode("utf-8" if self.encoding == "utf-8" else "cp1252", errors="replace")
        text = " ".join(text.split())
        return text if len(text) <= 60 else text[:59] + "…"

    def name(self, text: str) -> str:
        """Return a name from the text in the file's characters."""
        return text if text.isascii() or self.encoding != "utf-8" else text.encode("latin-1").decode("utf-8")

    def replaced(self, edits: Iterable[tuple[int, int, str]]) -> bytes:
        """Return the file's bytes with ``(start, end, text)`` replaced; the edits do not overlap."""
        pieces = []
        position = 0
        for start, end, text in sorted(edits):
            pieces += [self.text[position:start], text]
            position = end
        pieces.append(self.text[position:])
        text = "".join(pieces)
        return text.encode(self.encoding if self.encoding.startswith("utf-16") else "latin-1")

    def error(self, message: str, position: int | None = None, fix: str | None = None) -> InputError:
        """Return the error of a program that cannot be read."""
        return InputError(Problem(message, self.file, None if position is None else self.line(position), fix=fix))


def mask(text: str, hidden: re.Pattern[str]) -> str:
    """Return the text with spaces in place of every match of ``hidden`` (comments and strings), line ends kept."""
    return hidden.sub(lambda match: re.sub(r"[^\r\n]", " ", match[0]), text)


def _decode(data: bytes, file: str) -> tuple[str, str]:
    """Return text and encoding; a UTF-16 text keeps its mark."""
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        wide = "utf-16-le" if data[:2] == b"\xff\xfe" else "utf-16-be"
        try:
            text = data.decode(wide)
        except UnicodeDecodeError:
            fix = "export it from the controller again"
            raise InputError(Problem("is not UTF-16 text though it begins with its mark", file, fix=fix)) from None
        return text, wide
    position = data.find(b"\0")
    if position >= 0:
        line = data.count(b"\n", 0, position) + 1
        fix = "export it from the controller as text"
        raise InputError(Problem("is not a text file: it contains a NUL byte", file, line, fix=fix))
    text = data.decode("latin-1")
    try:
        data.decode("utf-8")
    except UnicodeDecodeError as error:
        if _has_utf8_line(data) and not _is_east_asian(data):
            line = data.count(b"\n", 0, error.start) + 1
            message = f"mixes UTF-8 with another encoding (byte 0x{data[error.start]:02x} is not UTF-8)"
            raise InputError(Problem(message, file, line, fix="save it in one encoding")) from None
        return text, "8-bit"
    return text, "utf-8"


def _has_utf8_line(data: bytes) -> bool:
    """Return whether a line with characters beyond ASCII is valid UTF-8, which text of another encoding rarely is."""
    for line in data.splitlines():
        if not line.isascii():
            try:
                line.decode("utf-8")
            except UnicodeDecodeError:
                continue
            return True
    return False


def _is_east_asian(data: bytes) -> bool:
    """Return whether the bytes are text of an East Asian code page."""
    for encoding in _EAST_ASIAN:
        try:
            data.decode(encoding)
        except UnicodeDecodeError:
            continue
        return True
    return False
