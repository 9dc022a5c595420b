"""Commands of the documentation print the outputs of its pages, and generated parts agree with the program."""

import importlib.util
import os
import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import pytest
from typer.testing import CliRunner

from robacc.cli.main import COMMANDS, FORMS, app

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
sys.path.insert(0, str(DOCS / "tools"))

from generated import with_made_parts  # noqa: E402
from transcripts import Ran, Session, agrees, blocks, brought_up_to_date, commands, lost_ends, same_line  # noqa: E402

PAGES = sorted(path for path in DOCS.rglob("*.md") if "pictures" not in path.parts)
NAMES = [str(path.relative_to(DOCS)) for path in PAGES]
CACHE: dict[str, Ran] = {}


@pytest.mark.parametrize("path", PAGES, ids=NAMES)
def test_commands_print_what_the_page_shows(path: Path, tmp_path: Path) -> None:
    session = Session(tmp_path, CACHE)
    for block in blocks(path.read_text(encoding="utf-8")):
        if block.file is not None:
            session.write(block)
            continue
        for shown in commands(block.text):
            output = session.run(shown.command)
            assert agrees(shown.output, output), f"{shown.command}\nprints\n{output}"
    assert session.status == 0


@pytest.mark.parametrize("path", PAGES, ids=NAMES)
def test_generated_parts_are_up_to_date(path: Path) -> None:
    page = path.read_text(encoding="utf-8")
    assert with_made_parts(page) == page, "run python docs/tools/refresh.py"


def test_every_command_and_effect_is_in_the_reference() -> None:
    from robacc.effects import REGISTRY

    reference = (DOCS / "reference" / "commands.md").read_text(encoding="utf-8")
    assert {*re.findall(r"^## ([\w -]+)$", reference, re.MULTILINE)} == {*COMMANDS, *FORMS}
    catalogue = (DOCS / "reference" / "effects.md").read_text(encoding="utf-8")
    assert re.findall(r"^## (\w+)$", catalogue, re.MULTILINE) == list(REGISTRY)


def test_every_option_is_in_the_reference() -> None:
    reference = (DOCS / "reference" / "commands.md").read_text(encoding="utf-8")
    sections = dict(re.findall(r"^## ([\w -]+)\n(.*?)(?=^## |^<!-- end)", reference, re.MULTILINE | re.DOTALL))
    for name in [*COMMANDS, *FORMS]:
        shown = CliRunner().invoke(app, [*name.split(), "--help"], terminal_width=200).stdout
        options = set(re.findall(r"--[a-z][a-z-]+", shown)) - {"--help", "--from", "--for"}
        missing = {option for option in options if option not in sections[name]}
        assert not missing, f"{name}: {missing}"
        assert name != "estimate" or {"--robot", "--align", "--per-pose"} <= options


def test_every_page_is_in_the_navigation() -> None:
    navigation = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    for name in NAMES:
        assert f"{name}\n" in navigation, name


def test_the_architecture_names_files_that_exist() -> None:
    page = (DOCS / "architecture.md").read_text(encoding="utf-8")
    named = set(re.findall(r"`((?:robacc|tests|docs)/[\w./]+)`", page))
    assert len(named) > 20
    assert not {name for name in named if "NAME" not in name and not (ROOT / name).exists()}
    steps = {
        name
        for walk in re.findall(r"```text\n(.*?)```", page, re.DOTALL)
        for name in re.findall(r"\w+/[\w/]+\.py", walk)
    }
    assert len(steps) > 20
    assert not {name for name in steps if not (ROOT / "robacc" / name).exists()}
    parts = {
        path.stem for path in (ROOT / "robacc").iterdir() if path.suffix == ".py" or (path / "__init__.py").exists()
    }
    assert not {name for name in parts - {"__init__", "__main__"} if not re.search(rf"`{name}(?:\.py|/)`", page)}


def test_a_difference_from_the_page_is_noticed(tmp_path: Path) -> None:
    session = Session(tmp_path, {})
    output = session.run("robacc show effects gear_ratio")
    first, *rest = output.splitlines()
    assert agrees((first, *rest), output)
    assert agrees((first, "…"), output)
    assert agrees((first, "…", rest[-1]), output)
    assert not agrees((first,), output)
    assert not agrees((first, "…", rest[-1] + "?"), output)
    assert not agrees((first, *rest[1:]), output)


@pytest.mark.parametrize(
    ("shown", "actual", "same"),
    [
        ("rms 0.472 mm", "rms 0.473 mm", True),
        ("rms 0.472 mm", "rms 0.474 mm", False),
        ("joint_compliance.j2 = 8.736e-07 ± 3.0e-09", "joint_compliance.j2 = 8.735e-07 ± 3.1e-09", True),
        ("value: 8.73598987455e-07", "value: 8.73598987459e-07", True),
        ("value: 8.73598987455e-07", "value: 8.73599987455e-07", False),
        ("5 of 5 folds", "4 of 5 folds", False),
        ("x   9.99  y", "x  10.00  y", True),
        ("joint_offset.j2", "joint_offset.j3", False),
        ("rms 0.472 mm", "rms 0.472 um", False),
    ],
)
def test_numbers_agree_within_their_last_digit(shown: str, actual: str, same: bool) -> None:
    assert same_line(shown, actual) is same


def test_a_failed_command_must_be_shown_as_failed(tmp_path: Path) -> None:
    session = Session(tmp_path, {})
    session.run("robacc show effects gear_ration")
    with pytest.raises(AssertionError, match="status 2"):
        session.run("robacc show effects gear_ratio")
    assert session.run("echo $?") == "2\n"


def test_a_session_has_the_files_of_the_page_and_of_its_commands(tmp_path: Path) -> None:
    page = '```yaml title="a.yaml"\nx: 1\n```\n\n```console\n$ cat a.yaml \\\n  > b.yaml\n$ cat b.yaml\nx: 1\n```\n'
    cache: dict[str, Ran] = {}
    for folder in (tmp_path / "first", tmp_path / "second"):
        folder.mkdir()
        session = Session(folder, cache)
        file, console = blocks(page)
        session.write(file)
        first, second = commands(console.text)
        assert (first.command, second.output) == ("cat a.yaml > b.yaml", ("x: 1",))
        assert session.run(first.command) == ""
        assert session.run(second.command) == "x: 1\n"


def test_omitted_lines_stay_omitted_when_figures_change() -> None:
    output = "title 2\na 1.5\nb -2\nc 3\nd 4\nend\n"
    assert brought_up_to_date(("title 1", "…", "c 9", "d 9", "…"), output) == ("title 2", "…", "c 3", "d 4", "…")
    assert brought_up_to_date(("…", "b 7", "…", "end"), output) == ("…", "b -2", "…", "end")
    assert brought_up_to_date(("old", "lines"), output) == tuple(output.splitlines())
    assert brought_up_to_date(("title 1", "…", "gone", "…"), output) is None
    assert lost_ends(("title 1", "…", "gone", "gone too", "c 9", "…", "end"), output) == ["gone"]


class _Fetched(HTMLParser):
    """Addresses that a browser fetches to show a page."""

    def __init__(self) -> None:
        super().__init__()
        self.addresses: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        given = dict(attrs)
        if tag in ("script", "img", "iframe", "source", "video", "audio", "embed"):
            self.addresses.append(given.get("src") or "")
        if tag == "link" and given.get("rel") not in ("canonical", "prev", "next"):
            self.addresses.append(given.get("href") or "")


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("mkdocs") is None, reason="needs the extra docs")
def test_the_site_builds_without_warnings_and_needs_no_network(tmp_path: Path) -> None:
    site = tmp_path / "site"
    build = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(site)]
    quiet = os.environ | {"NO_MKDOCS_2_WARNING": "1"}  # an announcement of the theme, not a warning of the build
    done = subprocess.run(build, cwd=ROOT, capture_output=True, text=True, timeout=300, env=quiet)
    assert done.returncode == 0, done.stderr
    assert "WARNING" not in done.stderr
    pages = sorted(site.rglob("*.html"))
    assert len(pages) >= len(PAGES)
    for page in pages:
        text = page.read_text(encoding="utf-8")
        fetched = _Fetched()
        fetched.feed(text)
        assert fetched.addresses
        assert not [address for address in fetched.addresses if "//" in address], page.name
        assert 'class="arithmatex"' not in text
    for style in site.rglob("*.css"):
        assert not re.findall(r"url\(\s*[\"']?https?:|@import", style.read_text(encoding="utf-8"))
