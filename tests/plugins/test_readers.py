"""Readers of other packages: an entry point of the group ``robacc.readers`` adds a kind of files."""

from __future__ import annotations

from importlib import metadata
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import robacc
from robacc.errors import InputError, UsageError
from robacc.io.column_table import ColumnTable
from robacc.io.table import Table, TableOptions

CSV = "x,y,z,cmd_x,cmd_y,cmd_z\n" + "".join(f"{i / 10},0,0,{i / 10},0,0.001\n" for i in range(4))


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

    entries = {
        f"counter{i or ''}": SimpleNamespace(value="site:reader", load=lambda r=reader: r())
        for i, reader in enumerate(readers)
    }

    def entry_points(group: str, name: str | None = None) -> Any:
        asked.append(group)
        return SimpleNamespace(names=entries.keys()) if name is None else [entries[name]]

    monkeypatch.setattr(metadata, "entry_points", entry_points)
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
    with pytest.raises(InputError, match="is a folder, expected a file"):
        robacc.read_poses(tmp_path)


def test_a_reader_that_cannot_be_loaded_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def missing() -> None:
        raise ImportError("No module named 'site_drivers'")

    offer(monkeypatch, missing)
    (tmp_path / "a.count").write_text("8")
    with pytest.raises(UsageError, match=r"the plug-in counter \(site:reader\) cannot be loaded: No module named"):
        robacc.read_poses(tmp_path / "a.count")
