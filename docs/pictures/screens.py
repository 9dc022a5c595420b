#!/usr/bin/env python3
"""Make the pictures of a terminal and of a notebook: python docs/pictures/screens.py, from the project's folder.

A picture of a terminal is an SVG of what the command prints on a terminal of 80 columns, colours included. That of a
notebook is the HTML of a result in the browser chromium; without chromium it stays as it is.
"""

from __future__ import annotations

import os
import pty
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from rich._export_format import CONSOLE_SVG_FORMAT
from rich.console import Console
from rich.terminal_theme import MONOKAI
from rich.text import Text

FOLDER = Path(__file__).resolve().parent
PROJECT = FOLDER.parents[1]
WIDTH = 80
FRAMES = "base_frame,tool_frame"
TRACE = ("sample_data/trace/poses.csv", "--robot", "sample_data/trace/robot.yaml")
TERMINALS = {
    "terminal-estimate": ("estimate", "sample_data/poses.csv", "--robot", "sample_data/robot.yaml", "--align", FRAMES),
    "terminal-trace": ("trace", *TRACE, "--declared", f"{FRAMES},joint_offset,link_geometry"),
}
"""Command of each picture."""
LINES = {"terminal-trace": 40}
"""First lines that a picture shows; by default all of them."""
# The fonts of the template are on a server; a page must not need a network.
TEMPLATE = re.sub(r"@font-face \{\{.*?\}\}\s*", "", CONSOLE_SVG_FORMAT, flags=re.DOTALL)
PAGE = """<!doctype html><meta charset="utf-8"><style>
body {{ font: 14px system-ui, sans-serif; margin: 16px; background: #fff; color: #111; }}
pre {{ background: #f5f5f5; border: 1px solid #ddd; padding: 8px 10px; font-size: 13px; margin: 0 0 10px; }}
</style><pre>{code}</pre>{result}"""
CODE = """import robacc

result = robacc.estimate(
    "sample_data/trace/poses.csv",
    robot="sample_data/trace/robot.yaml",
    align=("base_frame", "tool_frame"),
)
result"""


def printed(arguments: tuple[str, ...]) -> str:
    """Return what a command prints on a terminal of 80 columns, with its colours."""
    pid, terminal = pty.fork()
    if pid == 0:
        os.environ.update(TERM="xterm-256color", COLUMNS=str(WIDTH), LINES="50", PYTHONPATH=str(PROJECT))
        os.environ.pop("NO_COLOR", None)
        os.chdir(PROJECT)
        os.execv(sys.executable, [sys.executable, "-m", "robacc", *arguments])
    pieces = []
    try:
        while piece := os.read(terminal, 65536):
            pieces.append(piece)
    except OSError:  # the terminal is closed when the command ends
        pass
    os.waitpid(pid, 0)
    text = b"".join(pieces).decode().replace("\r\n", "\n")
    # A line of progress ends with a carriage return, and the next text replaces it; its bar may stay as a line.
    lines = [re.sub(r"\x1b\[\d?K", "", line).rpartition("\r")[2] for line in text.split("\n")]
    return "\n".join(line for line in lines if "\u2501" not in line)


def draw_terminal(name: str, arguments: tuple[str, ...], scratch: Path) -> None:
    """Write the picture of a command and its output."""
    words = tuple(word.format(scratch=scratch) for word in arguments)
    output = printed(words).replace(f"{scratch}/", "").rstrip().split("\n")
    shown = output[: LINES.get(name, len(output))]
    shown += ["…"] if len(shown) < len(output) else []
    with open(os.devnull, "w", encoding="utf-8") as nowhere:
        console = Console(record=True, width=WIDTH, file=nowhere, force_terminal=True, color_system="truecolor")
        console.print(Text(f"$ robacc {' '.join(words)}".replace(f"{scratch}/", ""), style="bold"), soft_wrap=False)
        console.print(Text.from_ansi("\n".join(shown)))
    svg = console.export_svg(title="robacc", theme=MONOKAI, code_format=TEMPLATE, unique_id=name)
    (FOLDER / f"{name}.svg").write_text(svg, encoding="utf-8")


def draw_notebook(scratch: Path) -> None:
    """Write the picture of a cell of a notebook and its result."""
    browser = shutil.which("chromium")
    if browser is None:
        print("no chromium: the picture of a notebook stays as it is", file=sys.stderr)
        return
    os.chdir(PROJECT)
    import robacc

    frames = ("base_frame", "tool_frame")
    result = robacc.estimate(TRACE[0], robot=TRACE[2], align=frames)
    page = scratch / "notebook.html"
    page.write_text(PAGE.format(code=CODE, result=result._repr_html_()), encoding="utf-8")
    flags = "--headless=new --no-sandbox --disable-gpu --no-first-run --disable-background-networking --hide-scrollbars"
    command = [browser, *flags.split(), f"--user-data-dir={scratch / 'profile'}", "--window-size=820,390"]
    picture = FOLDER / "notebook.png"
    subprocess.run([*command, f"--screenshot={picture}", f"file://{page}"], check=True, capture_output=True)


def main() -> None:
    """Make the pictures of the terminals that are named, by default all pictures."""
    with tempfile.TemporaryDirectory() as folder:
        scratch = Path(folder)
        for name in sys.argv[1:] or TERMINALS:
            draw_terminal(name, TERMINALS[name], scratch)
        if not sys.argv[1:]:
            draw_notebook(scratch)


if __name__ == "__main__":
    main()
