"""Pages and README say what the commands do; the effect of a page keeps the contract."""

import importlib.util
import os
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path

import pytest
import test_effects_contract as contract
from arms import arm
from generated import with_made_parts
from sample_files import ROOT, saved
from transcripts import (
    Ran,
    Session,
    agrees,
    blocks,
    brought_up_to_date,
    commands,
    lost_ends,
    same_line,
)
from typer.testing import CliRunner

from robacc.cli.main import COMMANDS, FORMS, app
from robacc.effects import REGISTRY

DOCS = ROOT / "docs"
PAGES = sorted(path for path in DOCS.rglob("*.md") if "pictures" not in path.parts)
NAMES = [str(path.relative_to(DOCS)) for path in PAGES]
CACHE: dict[str, Ran] = {}
LONG = ("fleet", "history", "photos", "plan", "report", "sockets")
"""How-to guides whose commands take more than a few seconds."""
SHOWN = [
    pytest.param(path, id=name, marks=[pytest.mark.slow] * (path.parent.name == "how-to" and path.stem in LONG))
    for path, name in zip(PAGES, NAMES, strict=True)
    if blocks(path.read_text(encoding="utf-8"))
]


@pytest.mark.parametrize("path", SHOWN)
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
    output = Session(tmp_path, {}).run("robacc show effects gear_ratio")
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


PAGE = ROOT / "docs" / "how-to" / "own-effect.md"
NAME = "zero_drift"


@pytest.fixture
def registered(tmp_path: Path) -> Iterator[None]:
    """The page's file, imported as its reader would."""
    known = dict(REGISTRY)
    (source,) = (block.text for block in blocks(PAGE.read_text(encoding="utf-8")) if block.file == f"{NAME}.py")
    spec = importlib.util.spec_from_file_location(NAME, saved(tmp_path / f"{NAME}.py", source))
    module = importlib.util.module_from_spec(spec)
    sys.modules[NAME] = module
    try:
        spec.loader.exec_module(module)
        yield
    finally:
        REGISTRY.clear()
        REGISTRY.update(known)
        del sys.modules[NAME]


def values_of(check: object, argument: str) -> tuple[object, ...] | None:
    """Values that a check is parametrised by."""
    for mark in getattr(check, "pytestmark", ()):
        if mark.name == "parametrize" and mark.args[0] == argument:
            return tuple(mark.args[1])
    return None


def checks() -> list[str]:
    """Checks of the contract that run over the whole registry."""
    return [name for name, check in vars(contract).items() if values_of(check, "name") == contract.EFFECTS]


@pytest.mark.usefixtures("registered")
@pytest.mark.parametrize("name", checks())
def test_the_effect_of_the_page_keeps_the_contract(name: str) -> None:
    check = getattr(contract, name)
    arms: tuple[object, ...] = values_of(check, "arm_name") or tuple(arm(known) for known in contract.ARMS)
    if check.__code__.co_argcount == 1:
        check(NAME)
    else:
        for second in arms:
            check(NAME, second)


def test_the_contract_has_checks() -> None:
    assert len(checks()) >= 8


README = (ROOT / "README.md").read_text(encoding="utf-8")
EXAMPLE = [shown for block in blocks(README) for shown in commands(block.text)]


def test_it_is_short() -> None:
    assert len(README.splitlines()) <= 150
    assert sum(len(shown.output) for shown in EXAMPLE) <= 45
    assert README.count("](docs/pictures/") == 1


def test_the_example_asks_for_the_accuracy_then_for_the_cause_and_closes_the_loop() -> None:
    loop = ["estimate", "trace", "simulate", "simulate", "estimate", "correct", "simulate", "estimate"]
    assert [shown.command.split()[:2] for shown in EXAMPLE] == [["robacc", name] for name in loop]


@pytest.fixture(scope="module")
def outputs(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """Outputs of all commands of the example, in one session."""
    session = Session(tmp_path_factory.mktemp("example"), CACHE)
    return [session.run(shown.command) for shown in EXAMPLE]


@pytest.mark.parametrize("number", range(len(EXAMPLE)), ids=[shown.command.split()[1] for shown in EXAMPLE])
def test_the_example_is_real_output(number: int, outputs: list[str]) -> None:
    shown, output = EXAMPLE[number], outputs[number]
    assert agrees(shown.output, output), f"{shown.command}\nprints\n{output}"


def test_one_command_runs_the_main_job_and_one_the_tests() -> None:
    setup = [block for block in re.findall(r"```sh\n(.*?)```", README, re.DOTALL) if "venv" in block]
    main_job, tests = setup
    assert main_job.count("\n") == tests.count("\n") == 1
    assert f".venv/bin/{EXAMPLE[1].command}\n" in main_job
    assert "pytest" in tests


def test_every_extra_for_users_is_named() -> None:
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    (line,) = [line for line in README.splitlines() if line.startswith("Extras: ")]
    assert set(re.findall(r"`(\w+)`", line)) == extras.keys() - {"docs", "dev"}


@pytest.mark.parametrize("name", [*COMMANDS, "show robots", "show effects", "show schema"])
def test_every_command_is_named(name: str) -> None:
    assert f"robacc {name}" in README


def test_every_link_leads_to_a_file() -> None:
    links = re.findall(r"\]\(([^)#]+)[^)]*\)", README)
    assert {"CONTRIBUTING.md", "docs/tutorial.md", "docs/architecture.md", "docs/glossary.md"} <= set(links)
    for link in links:
        assert (ROOT / link).exists(), link
