"""Read and write files: text is decoded with a clear error, files are written whole, problems are collected."""

import errno
import hashlib
import os
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from robacc.errors import MAX_PROBLEMS, Counted, InputError, Note, Problem, UsageError, install_advice, refuse

# Problems of one file, collected so that one error reports them all.


class ProblemLog:
    """Problems, remarks and warnings of one file: stores enough problems to report, and counts them all."""

    def __init__(self, file: str, counted: Counted = "line") -> None:
        """Collect problems of ``file``; places in it are counted in lines, or in rows where it has no lines."""
        self.file, self.counted = file, counted
        self.total = 0
        self.problems: list[Problem] = []
        """The problems so far, as far as they are stored."""
        self.remarks: list[str] = []
        """How the file differs from the documented form, and how its rows came to be."""
        self.gaps: set[int] = set()
        """Lines or rows that are left out because a value is missing."""
        self._warnings: list[tuple[bool, str]] = []

    def add(self, message: str, line: int | None = None, column: str | None = None, fix: str | None = None) -> None:
        """Add a problem."""
        self.total += 1
        # Problems stored while reading: they come in the file's order, so the first ones are those to report.
        if len(self.problems) < 1000:
            line, row = (None, line) if self.counted != "line" else (line, None)
            self.problems.append(Problem(message, self.file, line, column, fix, row))

    def add_rows(
        self,
        bad: NDArray[np.bool_],
        lines: NDArray[np.int64],
        column: str,
        describe: Callable[[int], str],
        fix: str | None = None,
    ) -> None:
        """Add a problem for each True of ``bad`` ``(N,)``; ``describe(i)`` returns the message of row i.

        The first of them has the ``fix``.
        """
        rows = np.flatnonzero(bad)
        for i in rows[:MAX_PROBLEMS]:
            self.add(describe(int(i)), int(lines[i]), column, fix if i == rows[0] else None)
        self.total += max(rows.size - MAX_PROBLEMS, 0)

    def warn(self, text: str, line: int | None = None, *, of_file: bool = False) -> None:
        """Add a warning, or a :class:`~robacc.errors.Note`, of a line or row, or of the file as a whole."""
        line, row = (None, line) if self.counted != "line" else (line, None)
        place = self.file if of_file else Problem("", self.file, line, row=row).place
        self._warnings.append((of_file, type(text)(f"{place}: {text}")))

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings of places in the file, then the remarks, gaps and warnings of the file as a whole."""
        first = ", ".join(map(str, sorted(self.gaps)[:6])) + " …" * (len(self.gaps) > 6)
        rows = f"{len(self.gaps)} row{'s' * (len(self.gaps) > 1)}"
        return (
            *(text for of_file, text in self._warnings if not of_file),
            *([Note(f"{self.file}: {self.remark}")] if self.remark else []),
            *(
                [f"{self.file}: {rows} incomplete or not measured, left out ({self.counted} {first})"]
                if self.gaps
                else []
            ),
            *(text for of_file, text in self._warnings if of_file),
        )

    @property
    def remark(self) -> str:
        """The remarks as one text; empty for a file of the documented form."""
        return ", ".join(filter(None, self.remarks))

    def raise_if_any(self) -> None:
        """Raise an error where there is a problem.

        Raises:
            InputError: The first problems in the order of their lines.
        """
        if self.total:
            ordered = sorted(self.problems, key=lambda problem: problem.line or problem.row or 0)
            raise InputError(ordered, total=self.total)


def clip(text: str) -> str:
    """Return the text in quotes for a message, cut to 40 characters."""
    return repr(text if len(text) <= 40 else text[:39] + "…")


def spliced(text: str, edits: Iterable[tuple[int, int, str]]) -> str:
    """Return a text with ``(start, end, new)`` replaced; the edits do not overlap."""
    pieces, position = [], 0
    for start, end, new in sorted(edits, key=lambda edit: edit[:2]):
        pieces += [text[position:start], new]
        position = end
    return "".join((*pieces, text[position:]))


TEXT_LIMIT = 64 * 2**20
"""Largest text file that is read, bytes: far above any robot file, far below what would exhaust the memory."""

STANDARD_STREAM = "-"
"""Stands for standard input where a file is read, and for standard output where a file is written."""
WRITTEN: list[str] = []
"""Files that were written, for the message of an interrupt."""
_READ: dict[str, str] = {}
"""Digest of each file's bytes as last read, by the file's name; :func:`sha256_of` removes it."""


def read_text(path: str | os.PathLike[str], limit: int = TEXT_LIMIT) -> str:
    """Return the text of a UTF-8 file (with or without byte order mark) or of a UTF-16 file with its mark.

    Args:
        path: File to read; ``-`` is standard input.
        limit: Largest accepted size, bytes.

    Raises:
        InputError: The file is missing, a folder, unreadable, too large, binary, or in another encoding.
    """
    name = os.fspath(path)
    return decode(read_bytes(name, limit), "<stdin>" if name == STANDARD_STREAM else name)


def decode(data: bytes, name: str) -> str:
    """Return the text of a file's bytes in the encodings of :func:`read_text`; ``name`` is for messages.

    Raises:
        InputError: The bytes are not text, or are in another encoding.
    """
    encoding = "utf-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig"
    before, nul, _ = data.partition(b"\0")
    no_text = Problem("is not a text file: it contains a NUL byte", name, before.count(b"\n") + 1)
    refuse((nul and encoding != "utf-16", no_text))
    try:
        return data.decode(encoding)
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise InputError(
            Problem(
                f"is not {encoding.removesuffix('-sig').upper()} text (byte 0x{data[error.start]:02x})",
                name,
                line,
                fix="save it as UTF-8",
            )
        ) from None


def bytes_of(stream: BinaryIO, label: str, limit: int = TEXT_LIMIT) -> bytes:
    """Return the bytes of a stream; ``label`` is its name in messages.

    Raises:
        InputError: There are more than ``limit``.
    """
    data = stream.read(limit + 1)
    refuse((len(data) > limit, Problem(f"is larger than {limit / 2**20:g} MiB, the limit for text files", label)))
    return data


def read_bytes(name: str, limit: int) -> bytes:
    """Return the bytes of a file, or of standard input for ``-``, read once so that a pipe works.

    Raises:
        InputError: The file is missing, a folder, unreadable or larger than ``limit`` bytes.
    """
    with opened(name) as stream:
        data = bytes_of(stream, "<stdin>" if name == STANDARD_STREAM else name, limit)
    _READ[name] = hashlib.sha256(data).hexdigest()
    return data


@contextmanager
def opened(name: str) -> Iterator[BinaryIO]:
    """Open a file, standard input for ``-``, or an object of a store such as ``s3://``, to read its bytes.

    Raises:
        InputError: The file is missing, a folder, or cannot be read.
        UsageError: It is in a store, and the extra ``cluster`` is not installed.
    """
    refuse((os.path.isdir(name), Problem("is a folder, not a file", name)))
    try:
        if "\0" in name:
            raise OSError(errno.EINVAL, "embedded null byte")
        with nullcontext(sys.stdin.buffer) if name == STANDARD_STREAM else _opened(name) as stream:
            yield stream
    except FileNotFoundError:
        raise InputError(Problem("the file does not exist", name)) from None
    except OSError as error:
        raise InputError(Problem(f"cannot be read: {_reason(error)}", name)) from error


def _opened(name: str) -> AbstractContextManager[BinaryIO]:
    if "://" not in name:
        return open(name, "rb")
    try:
        import fsspec

        opened: AbstractContextManager[BinaryIO] = fsspec.open(name, "rb")
    except ModuleNotFoundError as error:
        raise UsageError(f"{name} needs an optional package; run {install_advice('cluster')}") from error
    except (ImportError, ValueError) as error:  # fsspec raises ImportError for a missing package of a store
        raise InputError(Problem(f"cannot be read: {error}", name)) from error
    return opened


def sha256_of(path: str | os.PathLike[str]) -> str:
    """Return the SHA-256 of a file's bytes, in hexadecimal: of the bytes last read, where the file was just read.

    A pipe cannot be read twice, and a file may change meanwhile; a result records the bytes it was computed from.

    Raises:
        InputError: The file cannot be read.
    """
    if (digest := _READ.pop(os.fspath(path), None)) is not None:
        return digest
    with opened(os.fspath(path)) as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()  # type: ignore[arg-type]


def make_folder(path: str | os.PathLike[str]) -> None:
    """Create a folder and its parents; an existing folder stays as it is.

    Raises:
        InputError: The folder cannot be created.
    """
    try:
        os.makedirs(path, exist_ok=True)
    except OSError as error:
        raise InputError(Problem(f"cannot be created: {_reason(error)}", os.fspath(path))) from None


def target_of(path: str | os.PathLike[str]) -> Path:
    """Return the file that writing to ``path`` creates or replaces, with links followed.

    The path of anything but a plain file is returned unchanged: the link of ``/dev/stdout``, or of a shell's
    ``>(command)``, names a pipe that has no path of its own.

    Raises:
        InputError: ``path`` is a folder or a link to itself, or its folder does not exist.
    """
    name = os.fspath(path)
    if os.path.exists(name) and not os.path.isfile(name) and not os.path.isdir(name):
        return Path(name)
    target = Path(os.path.realpath(name))
    no_folder = Problem("cannot be written: its folder does not exist", name, fix="create the folder first")
    refuse(
        (target.is_symlink(), Problem("cannot be written: it is a link to itself", name, fix="name another file")),
        (target.is_dir(), Problem("is a folder, not a file", name, fix="name a file in it")),
        (not target.parent.is_dir(), no_folder),
    )
    return target


def write_file(path: str | os.PathLike[str], content: str | bytes | Iterable[str | bytes]) -> None:
    """Write text as UTF-8 or bytes, completely or not at all: to a file beside ``path`` that then replaces it.

    Content of any length may come in pieces. A link is followed, and an existing file keeps its permissions. A pipe or
    a terminal is written to directly; ``-`` is standard output.

    Raises:
        InputError: The folder does not exist, or the folder or the file is not writable.
    """
    name, pieces = os.fspath(path), (content,) if isinstance(content, str | bytes) else content
    data = (piece.encode() if isinstance(piece, str) else piece for piece in pieces)
    if name == STANDARD_STREAM:
        for piece in data:
            sys.stdout.write(piece.decode())
        sys.stdout.flush()
        return
    _READ.pop(name, None)
    target = target_of(name)
    try:
        if target.exists() and not target.is_file():
            with target.open("wb") as stream:
                stream.writelines(data)
        else:
            _replace(target, data)
    except OSError as error:
        raise InputError(Problem(f"cannot be written: {_reason(error)}", name)) from None
    WRITTEN.append(name)


def _replace(target: Path, pieces: Iterable[bytes]) -> None:
    mode = target.stat().st_mode & 0o777 if target.exists() else None
    if mode is not None and not os.access(target, os.W_OK):
        # Another file could replace it; a write-protected file stays as it is all the same.
        raise PermissionError(None, "the file is write-protected")
    temporary = target.with_name(f".{target.name}.{os.urandom(6).hex()}.part")
    try:
        with open(temporary, "xb", opener=lambda path, flags: os.open(path, flags, mode or 0o666)) as raw:
            raw.writelines(pieces)
            raw.flush()
            os.fsync(raw.fileno())
        if mode is not None:  # the mask for new files may have taken permissions away
            os.chmod(temporary, mode)
        os.replace(temporary, target)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def _reason(error: OSError) -> str:
    text = error.strerror or str(error)
    return text[:1].lower() + text[1:]
