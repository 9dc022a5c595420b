"""Poses from Parquet: the same table as from CSV, the same checks, and rows in place of lines."""

import decimal
import hashlib
import os
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import document
from sample_files import POSES, ROBOT, saved

import robacc
from robacc.errors import InputError, UsageError
from robacc.io import table
from robacc.io.json_text import json_text
from robacc.poses.csv_file import read_poses
from robacc_plugins import parquet

pa = pytest.importorskip("pyarrow")
pq = pytest.importorskip("pyarrow.parquet")
PLAIN: Mapping[str, list[Any]] = {
    "x_mm": [1.0, 2.0, 3.0],
    "y_mm": [4.0, 5.0, 6.0],
    "z_mm": [7.0, 8.0, 9.0],
    "q1_deg": [10.0, 20.0, 30.0],
}


def written(path: Path, columns: Mapping[str, Any], **options: Any) -> str:
    pq.write_table(pa.table(dict(columns)), path, **options)
    return str(path)


def sample(path: Path) -> str:
    """The sample's poses as Parquet."""
    lines = [line.split(",") for line in POSES.read_text(encoding="utf-8").splitlines() if not line.startswith("#")]
    columns = {
        name: [row[i] if name in ("pose", "cycle", "target") else float(row[i]) for row in lines[1:]]
        for i, name in enumerate(lines[0])
    }
    return written(path, columns)


def problems(path: str) -> list[str]:
    with pytest.raises(InputError) as caught:
        read_poses(path)
    return [str(problem).removeprefix(path) for problem in caught.value.problems]


def test_the_same_measurements_as_from_csv(tmp_path: Path) -> None:
    path = sample(tmp_path / "poses.parquet")
    ours, theirs = read_poses(path), read_poses(POSES)
    for name in ("position", "rotation", "q", "pose", "cycle", "target", "time", "direction"):
        actual, expected = getattr(ours, name), getattr(theirs, name)
        assert (actual is None) == (expected is None), name
        if actual is not None:
            np.testing.assert_array_equal(actual, expected, err_msg=name)
    assert ours.sha256 == hashlib.sha256(Path(path).read_bytes()).hexdigest()
    assert (ours.place(0), theirs.place(0)) == ("row 1", "line 3")


def test_units_stand_in_the_names_and_row_groups_join(tmp_path: Path) -> None:
    data = read_poses(written(tmp_path / "p.parquet", {**PLAIN, "pose": ["a", "b", "c"]}, row_group_size=2))
    np.testing.assert_allclose(data.position, [[1e-3, 2e-3, 3e-3], [4e-3, 5e-3, 6e-3], [7e-3, 8e-3, 9e-3]])
    np.testing.assert_allclose(data.q, np.radians([[10, 20, 30]]))
    assert data.pose.tolist() == ["a", "b", "c"]


@pytest.mark.parametrize(
    ("values", "kind"),
    [
        ([1, 2, 3], "int32"),
        ([1, 2, 3], "uint64"),
        ([1.0, 2.0, 3.0], "float32"),
        ([decimal.Decimal(1), decimal.Decimal(2), decimal.Decimal(3)], "decimal128"),
    ],
)
def test_every_type_of_number_is_one(tmp_path: Path, values: list[Any], kind: str) -> None:
    column = pa.array(values, pa.decimal128(5, 2) if kind == "decimal128" else getattr(pa, kind)())
    data = read_poses(written(tmp_path / "p.parquet", {**PLAIN, "x_mm": column}))
    np.testing.assert_array_equal(data.position[0], [1e-3, 2e-3, 3e-3])


@pytest.mark.parametrize("kind", ["int64", "string", "large_string", "dictionary"])
def test_ids_are_texts_of_any_kind(tmp_path: Path, kind: str) -> None:
    column = pa.array([7, 8, 7]) if kind == "int64" else pa.array(["7", " 8 ", "7"])
    if kind == "dictionary":
        column = column.dictionary_encode()
    elif kind != "int64":
        column = column.cast(getattr(pa, kind)())
    data = read_poses(written(tmp_path / "p.parquet", {**PLAIN, "pose": column}))
    assert data.pose.tolist() == ["7", "8", "7"]


def test_every_bad_value_is_named_by_its_row(tmp_path: Path) -> None:
    columns = {
        "x_mm": [1.0, 2.0, None],
        "y_mm": [float("nan"), 5.0, 6.0],
        "z_mm": [7.0, float("inf"), 9.0],
        "q1_deg": [10.0, 20.0, 30.0],
        "pose": ["a", "", "c"],
        "cycle": ["1", "2", "3" * 257],
    }
    assert problems(written(tmp_path / "p.parquet", columns)) == [
        ", row 1, y_mm: found 'nan', expected a finite number",
        ", row 2, z_mm: found 'inf', expected a finite number",
        ", row 2, pose: the value is missing, expected text",
        ", row 3, x_mm: the value is missing, expected a number; "
        "give `skip_gaps` to leave out rows with a missing value",
        ", row 3, cycle: the text has 257 characters, expected at most 256",
    ]


def test_columns_of_another_type_are_refused(tmp_path: Path) -> None:
    columns = {**PLAIN, "x_mm": ["1", "2", "3"], "pose": [1.5, 2.5, 3.5], "time_s": [[1.0], [2.0], [3.0]]}
    assert problems(written(tmp_path / "p.parquet", columns)) == [
        ", x_mm: the column holds string, expected numbers; store it as double",
        ", time_s: the column holds list<element: double>, expected numbers; store it as double",
        ", pose: the column holds double, expected text; store it as string",
    ]


def test_duplicate_columns_are_named(tmp_path: Path) -> None:
    columns = pa.table([pa.array([1.0])] * 5, names=["x", "y", "z", "q1", "x"])
    pq.write_table(columns, tmp_path / "p.parquet")
    assert problems(str(tmp_path / "p.parquet")) == [", x: the column is a duplicate; keep one of them"]


def test_pandas_index_is_no_column(tmp_path: Path) -> None:
    data = read_poses(written(tmp_path / "p.parquet", {**PLAIN, "__index_level_0__": [0, 1, 2]}))
    assert data.warnings == ()


def test_what_is_no_parquet_is_said(tmp_path: Path) -> None:
    path = saved(tmp_path / "p.parquet", "x,y,z,q1\n1,2,3,4\n")
    assert problems(str(path)) == [
        ": is not a Parquet file: it does not begin with PAR1; export it again, or rename it to .csv if it is text"
    ]
    content = Path(sample(tmp_path / "whole.parquet")).read_bytes()
    for length in (4, 12, len(content) // 2, len(content) - 1):
        path.write_bytes(content[:length])
        (message,) = problems(str(path))
        assert message.startswith(": cannot be read as Parquet (")
        assert message.endswith("; it is damaged or cut short")


def test_damage_in_the_middle_is_an_error_or_harmless(tmp_path: Path) -> None:
    content = bytearray(Path(sample(tmp_path / "whole.parquet")).read_bytes())
    path = tmp_path / "p.parquet"
    rng = np.random.default_rng(0)
    refused = 0
    for _ in range(60):
        damaged = content.copy()
        for at in rng.integers(4, len(content), 3):
            damaged[at] ^= int(rng.integers(1, 256))
        path.write_bytes(damaged)
        try:
            read_poses(path)
        except InputError:
            refused += 1
    assert refused > 10


def test_sizes_are_bounded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = written(tmp_path / "p.parquet", PLAIN)
    monkeypatch.setattr(parquet, "_MOST_NUMBERS", 11)
    assert problems(path) == [": found 3 rows of 4 columns; split the file"]
    monkeypatch.setattr(parquet, "_MOST_ROWS", 2)
    assert problems(path) == [": found 3 rows; expected at most 2"]
    monkeypatch.setattr(table, "MAX_COLUMNS", 3)
    assert problems(path) == [": found 4 columns; expected at most 3"]


def test_a_pipe_will_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    data = Path(written(tmp_path / "p.parquet", PLAIN)).read_bytes()

    def piped() -> robacc.Measurements:
        reading, writing = os.pipe()
        os.write(writing, data)
        os.close(writing)
        with os.fdopen(reading) as stream:
            monkeypatch.setattr(sys, "stdin", stream)
            return read_poses("-")

    found = piped()
    assert (found.n, found.sha256) == (3, hashlib.sha256(data).hexdigest())
    monkeypatch.setattr(parquet, "_PIPE_LIMIT", 100)
    with pytest.raises(InputError, match="the pipe holds more than 0 GiB; name a file instead"):
        piped()


def test_without_the_extra_the_way_to_it_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = written(tmp_path / "p.parquet", PLAIN)
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    expected = r"is Parquet, which needs an optional package; run pip install '\.\[parquet\]' in a checkout"
    with pytest.raises(UsageError, match=expected):
        read_poses(path)


# A campaign in several files, and in parts of the rows of all of them.


def campaign(folder: Path, n: int = 1500) -> tuple[str, str]:
    """The same poses in one file, and in three files of a folder whose names have numbers."""
    data = robacc.simulate(ROBOT, poses=n, seed=3, noise="0.1mm").data
    columns: dict[str, Any] = {f"q{i + 1}": row for i, row in enumerate(data.q)}
    columns |= {f"{axis}_m": row for axis, row in zip("xyz", data.position, strict=True)}
    columns["pose"] = [f"p{i}" for i in range(n)]
    whole = written(folder / "whole.parquet", columns, row_group_size=200)
    parts = folder / "parts"
    parts.mkdir()
    (parts / "_SUCCESS").touch()
    for name, rows, size in (("2", slice(0, 400), 130), ("10", slice(400, 410), 3), ("11", slice(410, n), 1000)):
        written(parts / f"part-{name}.parquet", {key: row[rows] for key, row in columns.items()}, row_group_size=size)
    return whole, str(parts)


def in_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in (("LARGE", 1), ("_PART", 190), ("_SAMPLES", 60), ("_SAMPLE", 5), ("_BATCH", 64)):
        monkeypatch.setattr(parquet, name, value)


def figures(result: robacc.Result) -> str:
    document = dict(result.document())
    return json_text({key: document[key] for key in document.keys() - {"inputs", "options", "warnings"}})


def test_files_of_a_folder_are_one_table(tmp_path: Path) -> None:
    whole, parts = campaign(tmp_path, 450)
    own, others = (robacc.estimate(path, robot=ROBOT) for path in (whole, parts))
    assert (figures(own), [pose.line for pose in own.worst_position]) == (
        figures(others),
        [pose.line for pose in others.worst_position],
    )
    (record,) = (entry for entry in others.made.inputs if entry.kind == "poses")
    digest = hashlib.sha256(b"".join((tmp_path / f"parts/part-{n}.parquet").read_bytes() for n in (2, 10, 11)))
    assert record.sha256 == digest.hexdigest()
    assert document("estimate", f"{parts}/*.parquet", "--robot", str(ROBOT))["n_poses"] == 450


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_campaign_in_parts_is_one_file_to_the_last_byte(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, jobs: int
) -> None:
    whole, parts = campaign(tmp_path)
    plain = robacc.estimate(whole, robot=ROBOT)
    in_parts(monkeypatch)
    own, others = (robacc.estimate(path, robot=ROBOT, jobs=jobs) for path in (whole, parts))
    assert figures(own) == figures(others)
    assert own.per_pose_csv() == others.per_pose_csv()
    assert any("read in 8 parts" in note for note in own.notes)
    assert own.position.rms == pytest.approx(plain.position.rms, rel=1e-12)
    lines = [[pose.line for pose in each.worst_position] for each in (plain, others)]
    assert lines[0] == lines[1]


def test_a_fit_in_parts_is_that_of_one_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole, parts = campaign(tmp_path)
    in_parts(monkeypatch)
    fits = [robacc.calibrate(path, robot=ROBOT, fit="base_frame,joint_offset[j2]") for path in (whole, parts)]
    assert figures(fits[0]) == figures(fits[1])


def test_a_campaign_in_an_object_store(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fsspec = pytest.importorskip("fsspec")
    whole, parts = campaign(tmp_path)
    for file in Path(parts).glob("*.parquet"):
        with fsspec.open(f"memory://campaign/{file.name}", "wb") as stream:
            stream.write(file.read_bytes())
    in_parts(monkeypatch)
    own = robacc.estimate(whole, robot=ROBOT)
    for path in ("memory://campaign/", "memory://campaign/part-*.parquet"):
        assert figures(robacc.estimate(path, robot=ROBOT)) == figures(own)
    with pytest.raises(InputError, match="found no files of poses there"):
        robacc.estimate("memory://nothing/", robot=ROBOT)


def test_a_wrong_value_has_its_row_in_the_campaign(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _, parts = campaign(tmp_path)
    last = tmp_path / "parts" / "part-11.parquet"
    table = pq.read_table(last).to_pydict()
    table["q2"][790] = float("nan")
    written(last, table)
    in_parts(monkeypatch)
    with pytest.raises(InputError, match=r"parts, row 1201, q2: found 'nan'"):
        robacc.estimate(parts, robot=ROBOT)


def test_files_of_a_campaign_have_the_same_columns(tmp_path: Path) -> None:
    _, parts = campaign(tmp_path, 450)
    table = pq.read_table(tmp_path / "parts" / "part-11.parquet").to_pydict()
    table.pop("q2")
    last = written(tmp_path / "parts" / "part-11.parquet", table)
    with pytest.raises(InputError, match=rf"{last}: {parts}/part-2\.parquet has other columns: q2"):
        robacc.estimate(parts, robot=ROBOT)
