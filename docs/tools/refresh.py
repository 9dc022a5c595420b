"""Update outputs and generated parts of the pages: ``python docs/tools/refresh.py [PAGE …]``.

Without arguments it goes through README and all pages of ``docs``.
"""

from __future__ import annotations

import os
import sys
import tempfile
from pathlib import Path

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).parent))

from generated import with_made_parts
from transcripts import ROOT, Ran, Session, blocks, brought_up_to_date, commands, lost_ends

DOCS = ROOT / "docs"


def refreshed(page: str, name: str, cache: dict[str, Ran]) -> tuple[str, list[str]]:
    """Return the page with the current outputs, and the problems that need an edit by hand."""
    page, problems = with_made_parts(page), []
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
                    return page, [*problems, f"{name}: {error}; it printed {lines[-1:]}"]
                current = brought_up_to_date(shown.output, output)
                if current is None:
                    lost = "\n  ".join(lost_ends(shown.output, output)) or "the order of the parts"
                    problems.append(f"{name}: {shown.command}\n  {lost}\nis not in\n{output}")
                lines += [*shown.lines, *(shown.output if current is None else current)]
            parts.append("".join(line.rstrip() + "\n" for line in lines))
    return "".join(parts) + page[place:], problems


def main(names: list[str]) -> int:
    """Update pages; return status 1 if a page needs an edit by hand."""
    pages = [Path(name).resolve() for name in names] or [ROOT / "README.md", *sorted(DOCS.rglob("*.md"))]
    cache: dict[str, Ran] = {}
    problems: list[str] = []
    for path in pages:
        before = path.read_text(encoding="utf-8")
        after, page_problems = refreshed(before, path.name, cache)
        problems += page_problems
        if after != before:
            path.write_text(after, encoding="utf-8")
            print(f"refreshed {path.relative_to(ROOT)}")
    for line in problems:
        print(line, file=sys.stderr)
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
