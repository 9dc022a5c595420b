"""Readers and other entry points of a site's own package: a kind of files, a dialect, an effect, an exporter."""

import itertools
import os
import subprocess
import sys
from importlib import metadata
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from sample_files import ROOT

import robacc
from robacc.errors import UsageError
from robacc.io.column_table import ColumnTable
from robacc.io.table import Table, TableOptions
from robacc.plug_ins import plug_in
from robacc.programs.program import is_program, read_program

CSV = "x,y,z,cmd_x,cmd_y,cmd_z\n" + "".join(f"{i / 10},0,0,{i / 10},0,0.001\n" for i in range(4))

OFFERS = itertools.count()


class Counter:
    """Reader of files whose names end in .count: so many poses on a line."""

    def takes(self, path: str, first: bytes) -> bool:
        return path.endswith(".count") or first.startswith(b"COUNT")

    def read(self, path: str, options: TableOptions) -> Table:
        n = int(Path(path).read_bytes().split()[-1].rstrip(b"\0"))
        names = ("X [mm]", "Y [mm]", "Z [mm]", "Nominal X", "Nominal Y", "Nominal Z")
        columns = [(name, 100.0 * np.arange(n)) for name in names]
        return ColumnTable(columns, path, options.skip_gaps, remark=f"{n} poses counted")


def offer(monkeypatch: pytest.MonkeyPatch, *readers: Any) -> list[str]:
    """Offer readers as entry points, and return the list of the groups that are asked for."""
    asked: list[str] = []

    class Entries(dict[str, Any]):
        names = property(dict.keys)

    entries = Entries(
        (f"counter{i or ''}", SimpleNamespace(name="counter", value="site:reader", load=lambda r=reader: r()))
        for i, reader in enumerate(readers)
    )

    def entry_points(group: str) -> Any:
        asked.append(group)
        return entries

    monkeypatch.setattr(metadata, "entry_points", entry_points)
    monkeypatch.syspath_prepend(f"/offers/{next(OFFERS)}")  # a path whose entry points are not known yet
    return asked


@pytest.mark.parametrize(("name", "content"), [("a.count", b"8"), ("a.csv", b"COUNT \0 8")])
def test_a_reader_is_asked_by_name_and_first_bytes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, content: bytes
) -> None:
    asked = offer(monkeypatch, Counter)
    (tmp_path / name).write_bytes(content)
    data = robacc.read_poses(tmp_path / name, units="mm")
    np.testing.assert_allclose(data.position[1], 0.1 * np.arange(8))
    assert any("8 poses counted" in text for text in data.warnings)
    assert {*asked} == {"robacc.readers"}


def test_plug_ins_are_not_looked_up_for_files_that_the_package_reads(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = offer(monkeypatch, Counter)
    (tmp_path / "a.csv").write_text(CSV)
    assert robacc.read_poses(tmp_path / "a.csv").n == 4
    assert asked == []


def test_a_file_that_no_reader_takes_is_text(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    offer(monkeypatch, Counter)
    (tmp_path / "a.poses").write_text(CSV)
    assert robacc.read_poses(tmp_path / "a.poses").n == 4


def test_a_reader_that_cannot_be_loaded_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def missing() -> None:
        raise ImportError("No module named 'site_drivers'")

    offer(monkeypatch, missing)
    (tmp_path / "a.count").write_text("8")
    with pytest.raises(UsageError, match=r"the plug-in counter \(site:reader\) cannot be loaded: No module named"):
        robacc.read_poses(tmp_path / "a.count")


DIALECT = """
import re

from robacc.programs.program import ProgramTarget
from robacc_plugins.dialects import AXIS_UNITS, Draft, arguments, numbers

SIGN = re.compile(r"^CELL PROGRAM", re.M)


def companions(path):
    return []


def parse(source, others=()):
    draft = Draft(source, "cell")
    for match in re.finditer(r"^GOTO ", source.text, re.M):
        places, _ = arguments(source.text, match.end(), source.text.index("\\n", match.end()))
        target = ProgramTarget(None, numbers(source.text, places, AXIS_UNITS))
        draft.move(match.span(), [draft.add("", target)])
    return draft.program()
"""

IMPORTER = """
from robacc import read_robot


def read(text, file):
    return read_robot("so101") if text.startswith("# zeros, deg") else None
"""

BROKEN = "import a_module_that_is_not_there\n"


def example(page: str, file: str) -> str:
    """A file that a page of the documentation shows."""
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    return text.partition(f'title="{file}"\n')[2].partition("```")[0]


@pytest.fixture
def site(tmp_path: Path) -> Path:
    """A folder with an installed package of a site: its modules and its entry points."""
    effect = example("how-to/own-effect.md", "zero_drift.py")
    exporter = example("reference/plug-ins.md", "arm.py")
    for name, text in (("dialect", DIALECT), ("exporter", exporter), ("drift", effect), ("importer", IMPORTER)):
        (tmp_path / f"site_{name}.py").write_text(text)
    (tmp_path / "site_broken.py").write_text(BROKEN)
    info = tmp_path / "site_cell-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: site-cell\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        "[robacc.programs]\ncell = site_dialect\n[robacc.exporters]\ncell-arm = site_exporter:write\n"
        "[robacc.importers]\na-cell = site_importer:read\n[robacc.effects]\ndrift = site_drift\n"
        "[robacc.collisions]\nbroken = site_broken\n"
    )
    return tmp_path


def run(site: Path, *arguments: str) -> str:
    path = os.pathsep.join((str(site), str(ROOT)))
    command = [sys.executable, "-m", "robacc", *arguments]
    done = subprocess.run(command, env={**os.environ, "PYTHONPATH": path}, cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize("name", ["line.cell", "line.txt", "line.src"])
def test_a_dialect_is_known_by_its_suffix_or_its_text(site: Path, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(site)
    (site / name).write_text("CELL PROGRAM\nGOTO 1,2,3,4,5,60\nGOTO 1,2,3,4,5,90\n")
    program = read_program(site / name)
    assert (program.dialect, len(program.targets), len(program.moves)) == ("cell", 2, 2)
    assert is_program(site / name) is not name.endswith("txt")


def test_an_effect_is_in_the_catalogue_and_in_robot_files(site: Path) -> None:
    assert "zero_drift" in run(site, "effects")
    assert "rad/s (m/s for a prismatic joint)" in run(site, "effects", "zero_drift")
    robot = (ROOT / "sample_data" / "robot.yaml").read_text()
    entry = "{effect: zero_drift, joints: [j3], values: {j3: 1e-7}}"
    (site / "drifting.yaml").write_text(f"{robot.partition('effects:')[0]}effects: [{entry}]\n")
    assert "zero_drift" in run(site, "show", str(site / "drifting.yaml"))


def test_an_exporter_is_a_format(site: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    robot, own = str(ROOT / "sample_data" / "robot.yaml"), site / "own.txt"
    own.write_text("serial = 7\n")
    shown = run(site, "export", robot, "--format", "cell-arm", "--template", str(own), "--output", "-")
    assert shown.startswith("serial = 7\nj1 = 0.0000\n")
    assert "cell-arm" in run(site, "export", "--help")
    monkeypatch.syspath_prepend(site)
    result = robacc.export(robot, format="cell-arm")
    assert (len(result.text.splitlines()), result.not_carried) == (7, ("link geometry",))
    result.write(site / "written.txt")
    assert robacc.import_(site / "written.txt") == robacc.read_robot("so101")
    with pytest.raises(UsageError, match=r"`format`: expected one of 'cell-arm', .*, 'xarm', None, found 'another'"):
        robacc.export(robot, format="another")
    with pytest.raises(UsageError, match="`template` belongs to `format` cell-arm and lerobot and ur-calibration"):
        robacc.export(robot, format="mdh", template=own)


def test_a_plug_in_that_is_not_there_or_cannot_be_loaded_is_named(site: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(site)
    with pytest.raises(UsageError, match=r"plug-in broken \(site_broken\) cannot be loaded: No module named"):
        plug_in("robacc.collisions", "broken")
    with pytest.raises(UsageError, match=r"no installed package offers the plug-in other of robacc\.collisions"):
        plug_in("robacc.collisions", "other")
