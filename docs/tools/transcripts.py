r"""Run, compare and update the commands and outputs of Markdown pages.

A page is one session in a new folder with the checkout's ``sample_data`` and ``configs``. Its fenced blocks are read
in order:

- ``yaml``, ``csv``, ``python``, ``xml`` with a ``title="NAME"``: the file NAME, written into the folder.
- ``console``: ``$`` lines are commands, the lines below them their output. A line ``…`` stands for any number of
  lines. Commands are ``robacc``, ``cat``, ``head -n N``, ``tail -n +N``, ``python FILE …``, ``echo $?``;
  ``|``, ``>``, ``>>`` and a ``\`` at the end of a line do what they do in a shell. A command that does not end with
  status 0 must be followed by ``echo $?``.

Commands run in this process, without a new interpreter; an equal command on equal files runs once.
"""

from __future__ import annotations

import contextlib
import hashlib
import io
import os
import re
import runpy
import shlex
import shutil
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from typer.testing import CliRunner

ROOT = Path(__file__).resolve().parents[2]
SHARED_FOLDERS = ("sample_data", "configs")
"""Folders of the checkout that a session gets a copy of."""
OMITTED = "…"

_FENCE = re.compile(r"^```(\w+)([^\n]*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?(?![\w])")
_BLANKS = re.compile(r"[ ]+")
_TITLE = re.compile(r'title="([^"]+)"')
_FILES = ("yaml", "csv", "python", "xml")
_GATE_WORDS = ("--gate", "check")
"""Words of commands that may read files without naming them."""


@dataclass(frozen=True, slots=True)
class Block:
    """A fenced block of the session."""

    kind: str
    file: str | None
    """Name of the file; None for a console."""
    text: str
    start: int
    """Offset of its text in the page."""


@dataclass(frozen=True, slots=True)
class Shown:
    """One command of a console and the part of its output that the page shows."""

    lines: tuple[str, ...]
    """The command as written, with ``$``."""
    output: tuple[str, ...]

    @property
    def command(self) -> str:
        """The command on one line."""
        return " ".join(line.removesuffix("\\").strip() for line in self.lines).removeprefix("$ ")


@dataclass(frozen=True, slots=True)
class Ran:
    """Output, status and files of a command."""

    output: str
    status: int
    files: tuple[tuple[str, bytes], ...]
    """Files that it wrote, by name."""


def blocks(page: str) -> tuple[Block, ...]:
    """Return the blocks of a page that are files or consoles."""
    result = []
    for match in _FENCE.finditer(page):
        kind, title = match[1], _TITLE.search(match[2])
        if kind == "console" or (kind in _FILES and title):
            result.append(Block(kind, title[1] if title and kind != "console" else None, match[3], match.start(3)))
    return tuple(result)


def commands(text: str) -> tuple[Shown, ...]:
    """Return the commands of a console, each with the output below it."""
    pairs: list[tuple[list[str], list[str]]] = []
    continued = False
    for line in text.splitlines():
        if continued:
            pairs[-1][0].append(line)
        elif line.startswith("$ "):
            pairs.append(([line], []))
        else:
            pairs[-1][1].append(line)
        continued = bool(pairs[-1][0]) and not pairs[-1][1] and pairs[-1][0][-1].endswith("\\")
    return tuple(Shown(tuple(command), tuple(output)) for command, output in pairs)


def agrees(shown: tuple[str, ...], output: str) -> bool:
    """Return whether a page shows the output; a line ``…`` stands for any number of lines.

    Numbers agree within the last printed digit (see :func:`same_line`), because processors round differently.
    """
    parts: list[list[str]] = [[]]
    for line in shown:
        if line == OMITTED:
            parts.append([])
        else:
            parts[-1].append(line)
    actual = _ended(output).splitlines()
    if len(parts) == 1:
        return len(actual) == len(shown) and _same(parts[0], actual)
    first, last = parts[0], parts[-1]
    end = len(actual) - len(last)
    if not (len(first) <= end and _same(first, actual[: len(first)]) and _same(last, actual[end:])):
        return False
    place = len(first)
    for part in parts[1:-1]:
        starts = (i for i in range(place, end - len(part) + 1) if _same(part, actual[i : i + len(part)]))
        start = next(starts, None)
        if start is None:
            return False
        place = start + len(part)
    return True


def _same(shown: list[str], actual: list[str]) -> bool:
    return len(shown) == len(actual) and all(same_line(a, b) for a, b in zip(shown, actual, strict=True))


def same_line(shown: str, actual: str) -> bool:
    """Return whether two lines are equal, except for the last digit of their numbers and for spacing.

    A number may differ by one unit of its last printed digit, or by one part in 10^9 where more digits are printed:
    other processors sum in another order.
    """
    shown, actual = shown.rstrip(), actual.rstrip()
    if shown == actual:
        return True
    if _NUMBER.sub("#", _BLANKS.sub(" ", shown)) != _NUMBER.sub("#", _BLANKS.sub(" ", actual)):
        return False
    numbers = zip(_NUMBER.findall(shown), _NUMBER.findall(actual), strict=True)
    return all(a == b or abs(float(a) - float(b)) <= max(_unit(a), _unit(b), 1e-9 * abs(float(a))) for a, b in numbers)


def _unit(number: str) -> float:
    """Return one unit of the last digit of a printed number, plus 1 % for rounding; 0 for an integer."""
    digits, _, exponent = number.lower().partition("e")
    if "." not in digits and not exponent:
        return 0.0
    return 1.01 * 10.0 ** (int(exponent or 0) - len(digits.partition(".")[2]))


def brought_up_to_date(shown: tuple[str, ...], output: str) -> tuple[str, ...] | None:
    """Return the output without the parts that the page omits; None if the end of a part is missing.

    The first and last line of a part are compared without digits and signs, so that figures may change.
    """
    actual = [line.rstrip() for line in output.splitlines()]
    parts: list[list[str]] = [[]]
    for line in shown:
        if line == OMITTED:
            parts.append([])
        else:
            parts[-1].append(line)
    patterns, result, place = [_pattern(line) for line in actual], [], 0
    for number, part in enumerate(parts):
        first, last = number == 0, number == len(parts) - 1
        if number:
            result.append(OMITTED)
        if not part and not (first and last):
            continue
        begin = 0 if first else _find(patterns, part[0], place, place)
        if begin is None:
            return None
        end = len(actual) - 1 if last else _find(patterns, part[-1], begin, begin + len(part) - 1)
        if end is None:
            return None
        result += actual[begin : end + 1]
        place = end + 1
    return tuple(result)


def lost_ends(shown: tuple[str, ...], output: str) -> list[str]:
    """Return the lines beside an omission that the output no longer has."""
    patterns = [_pattern(line) for line in output.splitlines()]
    ends = {i for i, line in enumerate(shown) if OMITTED in (line, *shown[max(i - 1, 0) : i], *shown[i + 1 : i + 2])}
    lines = [shown[i] for i in sorted(ends) if shown[i] != OMITTED]
    return [line for line in lines if _find(patterns, line, 0, 0) is None]


def _find(patterns: list[str], line: str, start: int, expected: int) -> int | None:
    """Return the number of the equal line nearest to ``expected``, else of a line that begins with it."""
    wanted = _pattern(line)
    places = [i for i in range(start, len(patterns)) if patterns[i] == wanted]
    places = places or [i for i in range(start, len(patterns)) if wanted and patterns[i].startswith(wanted)]
    return min(places, key=lambda i: abs(i - expected), default=None)


def _pattern(line: str) -> str:
    return re.sub(r"[-+]?\d[\d.]*(e[-+]?\d+)?|\s+", "#", line.strip())


def _ended(text: str) -> str:
    return "".join(line.rstrip() + "\n" for line in text.splitlines())


@dataclass
class Session:
    """The folder of one page and the commands run in it."""

    folder: Path
    cache: dict[str, Ran] = field(default_factory=dict)
    """Shared between pages."""
    status: int = 0

    def __post_init__(self) -> None:
        """Copy the shared folders of the checkout."""
        for name in SHARED_FOLDERS:
            shutil.copytree(ROOT / name, self.folder / name)

    def write(self, block: Block) -> None:
        """Write a file of the page into the folder."""
        path = self.folder / str(block.file)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(block.text, encoding="utf-8")

    def run(self, command: str) -> str:
        """Run a command and return its output; keep its status for ``echo $?``."""
        if command == "echo $?":
            status, self.status = self.status, 0
            return f"{status}\n"
        if self.status:
            raise AssertionError(f"status {self.status} before {command!r}, and the page does not show it")
        words = shlex.split(command)
        target, mode = None, "w"
        for sign, meaning in ((">", "w"), (">>", "a")):
            if sign in words:
                words, target, mode = words[: words.index(sign)], words[-1], meaning
        key = self._key(words)
        if key not in self.cache:
            self.cache[key] = self._pipeline(words)
        ran = self.cache[key]
        for name, content in ran.files:
            (self.folder / name).parent.mkdir(parents=True, exist_ok=True)
            (self.folder / name).write_bytes(content)
        self.status = ran.status
        if target is None:
            return ran.output
        with (self.folder / target).open(mode, encoding="utf-8") as file:
            file.write(ran.output)
        return ""

    def _key(self, words: list[str]) -> str:
        read = {word for word in words if (self.folder / word).is_file()}
        if any(word in _GATE_WORDS for word in words):
            read |= {name for name, _ in self._own_files()}
        digest = hashlib.sha256("\0".join(words).encode())
        for name in sorted(read):
            digest.update(name.encode() + b"\0" + (self.folder / name).read_bytes())
        return digest.hexdigest()

    def _own_files(self) -> Iterator[tuple[str, bytes]]:
        for path in sorted(self.folder.rglob("*")):
            name = str(path.relative_to(self.folder))
            if path.is_file() and not name.startswith(SHARED_FOLDERS):
                yield name, path.read_bytes()

    def _pipeline(self, words: list[str]) -> Ran:
        before = dict(self._own_files())
        text, status = "", 0
        stages = [list(stage.split("\0")) for stage in "\0".join(words).split("\0|\0")]
        with contextlib.chdir(self.folder):
            for stage in stages:
                text, status = _run(stage, text)
        after = tuple((name, content) for name, content in self._own_files() if before.get(name) != content)
        return Ran(text, status, after)


def _run(words: list[str], stdin: str) -> tuple[str, int]:
    match words:
        case ["robacc", *rest]:
            return _robacc(rest, stdin)
        case ["cat", *files]:
            return "".join(Path(name).read_text(encoding="utf-8") for name in files), 0
        case ["head", "-n", count, name]:
            return "".join(Path(name).read_text(encoding="utf-8").splitlines(keepends=True)[: int(count)]), 0
        case ["tail", "-n", first, name] if first.startswith("+"):
            return "".join(Path(name).read_text(encoding="utf-8").splitlines(keepends=True)[int(first) - 1 :]), 0
        case ["python", name, *rest]:
            return _python(name, rest)
    raise AssertionError(f"a page may not run {' '.join(words)!r}")


class _TerminalRunner(CliRunner):
    """Runner that writes messages line by line, as Python does on a terminal, so that their order is the real one."""

    @contextlib.contextmanager
    def isolation(self, *args: Any, **kwargs: Any) -> Iterator[Any]:
        """Replace the standard streams."""
        with super().isolation(*args, **kwargs) as streams:
            if isinstance(sys.stderr, io.TextIOWrapper):
                sys.stderr.reconfigure(line_buffering=True)
            yield streams


def _robacc(words: list[str], stdin: str) -> tuple[str, int]:
    from robacc.cli.main import app

    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    result = _TerminalRunner().invoke(app, words, input=stdin, catch_exceptions=False, prog_name="robacc")
    return result.output, result.exit_code


def _python(name: str, words: list[str]) -> tuple[str, int]:
    """Run a script of the folder; its effects and modules are removed afterwards."""
    from robacc.effects import REGISTRY

    known, loaded, argv, path = dict(REGISTRY), set(sys.modules), sys.argv, sys.path
    sys.argv, sys.path = [name, *words], [os.getcwd(), *path]
    status = 0
    try:
        with contextlib.redirect_stdout(io.StringIO()) as printed:
            runpy.run_path(name, run_name="__main__")
    except SystemExit as end:
        status = int(end.code or 0)
    finally:
        sys.argv, sys.path = argv, path
        REGISTRY.clear()
        REGISTRY.update(known)
        for module in set(sys.modules) - loaded:
            if Path(getattr(sys.modules[module], "__file__", None) or "/").parent == Path.cwd():
                del sys.modules[module]
    return printed.getvalue(), status
