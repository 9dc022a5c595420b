r"""Commands and their output in Markdown pages: run, compared, and brought up to date.

A page is one session in a folder of its own that holds ``sample_data`` and ``configs``, as a checkout does. Its fenced
blocks are gone through in order:

- ``yaml``, ``csv``, ``python``, ``xml`` with a ``title="NAME"``: the file NAME, written into the folder.
- ``console``: ``$`` lines are commands, what follows is what a terminal shows. A line that is ``…`` alone stands for
  any number of lines. Commands are ``robacc``, ``cat``, ``head -n N``, ``tail -n +N``, ``python FILE …``, ``echo $?``;
  ``|``, ``>``, ``>>`` and a ``\`` at the end of a line do what they do in a shell. A command that does not end with
  status 0 must be followed by ``echo $?``.

Commands run in this process, which spares each of them the start of an interpreter; an equal command on equal files is
run once.
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

from typer.testing import CliRunner

ROOT = Path(__file__).resolve().parents[2]
LENT = ("sample_data", "configs")
"""Folders of the checkout that a session finds in its own."""
OMITTED = "…"

_FENCE = re.compile(r"^```(\w+)([^\n]*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
_NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?(?![\w])")
_BLANKS = re.compile(r"[ ]+")
_TITLE = re.compile(r'title="([^"]+)"')
_FILES = ("yaml", "csv", "python", "xml")
_JUDGES = ("--gate", "check")
"""Words of a command that may read files which it does not name."""


@dataclass(frozen=True, slots=True)
class Block:
    """A fenced block that takes part in the session."""

    kind: str
    file: str | None
    """The file that it is; None for a console."""
    text: str
    start: int
    """Where its text begins in the page."""


@dataclass(frozen=True, slots=True)
class Shown:
    """One command of a console and what the page shows of its output."""

    lines: tuple[str, ...]
    """The command as it stands there, with ``$``."""
    output: tuple[str, ...]

    @property
    def command(self) -> str:
        """The command in one line."""
        return " ".join(line.removesuffix("\\").strip() for line in self.lines).removeprefix("$ ")


@dataclass(frozen=True, slots=True)
class Ran:
    """What a command did."""

    output: str
    status: int
    files: tuple[tuple[str, bytes], ...]
    """That it wrote, by their names."""


def blocks(page: str) -> tuple[Block, ...]:
    """The blocks of a page that are files or consoles."""
    found = []
    for match in _FENCE.finditer(page):
        kind, title = match[1], _TITLE.search(match[2])
        if kind == "console" or (kind in _FILES and title):
            found.append(Block(kind, title[1] if title and kind != "console" else None, match[3], match.start(3)))
    return tuple(found)


def commands(text: str) -> tuple[Shown, ...]:
    """The commands of a console, each with the output shown below it."""
    found: list[tuple[list[str], list[str]]] = []
    continued = False
    for line in text.splitlines():
        if continued:
            found[-1][0].append(line)
        elif line.startswith("$ "):
            found.append(([line], []))
        else:
            found[-1][1].append(line)
        continued = bool(found[-1][0]) and not found[-1][1] and found[-1][0][-1].endswith("\\")
    return tuple(Shown(tuple(command), tuple(output)) for command, output in found)


def agrees(shown: tuple[str, ...], output: str) -> bool:
    """Return whether a page shows the output, ``…`` alone on a line standing for any number of lines.

    Numbers agree within the last digit printed (see :func:`same_line`), since processors round differently.
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
    """Return whether two lines are equal but for the last digit of their numbers and the blanks that this moves.

    A number may differ by one unit of its last printed digit, and by one part in 10^9 where more digits are printed:
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
    """Return one unit of the last digit of a printed number, with 1 % more for rounding; 0 of a whole number."""
    digits, _, exponent = number.lower().partition("e")
    if "." not in digits and not exponent:
        return 0.0
    return 1.01 * 10.0 ** (int(exponent or 0) - len(digits.partition(".")[2]))


def brought_up_to_date(shown: tuple[str, ...], output: str) -> tuple[str, ...] | None:
    """The output with the parts left out that the page leaves out; None where a part's ends are found no more.

    A part's first and last line are looked for with digits and signs made equal, so that figures may change.
    """
    actual = [line.rstrip() for line in output.splitlines()]
    parts: list[list[str]] = [[]]
    for line in shown:
        if line == OMITTED:
            parts.append([])
        else:
            parts[-1].append(line)
    alike, result, place = [_alike(line) for line in actual], [], 0
    for number, part in enumerate(parts):
        first, last = number == 0, number == len(parts) - 1
        if number:
            result.append(OMITTED)
        if not part and not (first and last):
            continue
        begin = 0 if first else _find(alike, part[0], place, place)
        if begin is None:
            return None
        end = len(actual) - 1 if last else _find(alike, part[-1], begin, begin + len(part) - 1)
        if end is None:
            return None
        result += actual[begin : end + 1]
        place = end + 1
    return tuple(result)


def _find(alike: list[str], line: str, start: int, expected: int) -> int | None:
    """Where a line stands, or else one that begins like it, from ``start`` on, nearest to where it is expected."""
    wanted = _alike(line)
    places = [i for i in range(start, len(alike)) if alike[i] == wanted]
    places = places or [i for i in range(start, len(alike)) if wanted and alike[i].startswith(wanted)]
    return min(places, key=lambda i: abs(i - expected), default=None)


def _alike(line: str) -> str:
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
        """Lend the folder what a checkout has."""
        for name in LENT:
            shutil.copytree(ROOT / name, self.folder / name)

    def write(self, block: Block) -> None:
        """Put a file of the page into the folder."""
        path = self.folder / str(block.file)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(block.text, encoding="utf-8")

    def run(self, command: str) -> str:
        """What a terminal shows of a command; its status is kept for ``echo $?``."""
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
        if any(word in _JUDGES for word in words):
            read |= {name for name, _ in self._own_files()}
        digest = hashlib.sha256("\0".join(words).encode())
        for name in sorted(read):
            digest.update(name.encode() + b"\0" + (self.folder / name).read_bytes())
        return digest.hexdigest()

    def _own_files(self) -> Iterator[tuple[str, bytes]]:
        for path in sorted(self.folder.rglob("*")):
            name = str(path.relative_to(self.folder))
            if path.is_file() and not name.startswith(LENT):
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


def _robacc(words: list[str], stdin: str) -> tuple[str, int]:
    from robacc.cli.main import app

    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    result = CliRunner().invoke(app, words, input=stdin, catch_exceptions=False, prog_name="robacc")
    return result.output, result.exit_code


def _python(name: str, words: list[str]) -> tuple[str, int]:
    """A script of the folder; effects and modules that it brings along are gone when it has ended."""
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
