"""Bring outputs and made parts of the pages up to date: ``python docs/tools/refresh.py [PAGE …]``, all by default."""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parent))

from generated import with_made_parts
from transcripts import ROOT, Ran, Session, blocks, brought_up_to_date, commands

DOCS = ROOT / "docs"


def refreshed(page: str, name: str, cache: dict[str, Ran]) -> tuple[str, list[str]]:
    """The page with the outputs of today, and what has to be mended by hand."""
    page, trouble = with_made_parts(page), []
    with tempfile.TemporaryDirectory() as folder:
        session = Session(Path(folder), cache)
        parts, place = [], 0
        for block in blocks(page):
            parts.append(page[place : block.start])
            place = block.start + len(block.text)
            if block.file is not None:
                session.write(block)
                parts.append(block.text)
                continue
            lines: list[str] = []
            for shown in commands(block.text):
                try:
                    output = session.run(shown.command)
                except AssertionError as error:
                    return page, [*trouble, f"{name}: {error}; it printed {lines[-1:]}"]
                now = brought_up_to_date(shown.output, output)
                if now is None:
                    trouble.append(f"{name}: what is left out of {shown.command!r} cannot be found again in\n{output}")
                lines += [*shown.lines, *(shown.output if now is None else now)]
            parts.append("".join(line.rstrip() + "\n" for line in lines))
    return "".join(parts) + page[place:], trouble


def main(names: list[str]) -> int:
    """Refresh pages; status 1 where something has to be mended by hand."""
    pages = [Path(name).resolve() for name in names] or sorted(DOCS.rglob("*.md"))
    cache: dict[str, Ran] = {}
    trouble: list[str] = []
    for path in pages:
        before = path.read_text(encoding="utf-8")
        after, found = refreshed(before, path.name, cache)
        trouble += found
        if after != before:
            path.write_text(after, encoding="utf-8")
            print(f"refreshed {path.relative_to(ROOT)}")
    for line in trouble:
        print(line, file=sys.stderr)
    return 1 if trouble else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
