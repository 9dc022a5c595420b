"""Database of results: one SQLite file with every result of one arm or of many, and what robacc compares of them.

Tables, for other programs that read the file:

- ``results``: ``id``, ``sha256`` of the result file, ``at`` (s since 1970, of the test), ``name`` of the file, ``arm``
  (serial number, else the robot's name), ``model`` (command, robot file and effects, which must be the
  same in results that are compared), ``command``, ``version`` of robacc,
  ``n_poses``, ``grade``, ``temperature_c`` (mean), ``document`` (JSON without its lists of poses, compressed by zlib).
- ``figures``: ``result``, ``key`` as gates name it (``position.rms``), ``value``, ``low``, ``high`` (95 %), ``unit``.
- ``coefficients``: ``result``, ``key`` (``joint_offset.j3``), ``value``, ``std``, ``unit``, or ``why`` without std.

A result is added as a whole or not at all, by one transaction; write-ahead logging lets several programs add and read.
"""

from __future__ import annotations

import itertools
import json
import os
import re
import sqlite3
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from typing import Any
from urllib.parse import quote

import numpy as np

from robacc.comparison.stored_results import FITS, read_compared_result, unit_of
from robacc.documents.envelope import StoredResult, understood
from robacc.errors import InputError, Problem, refuse
from robacc.history.changes import ArmSeries
from robacc.statistics.intervals import normal_quantile

_SCHEMAS = (
    """
    CREATE TABLE results (id INTEGER PRIMARY KEY, sha256 TEXT NOT NULL UNIQUE, at REAL NOT NULL, name TEXT NOT NULL,
        arm TEXT NOT NULL, model TEXT NOT NULL, command TEXT NOT NULL, version TEXT NOT NULL, n_poses INTEGER NOT NULL,
        grade TEXT, temperature_c REAL, document BLOB NOT NULL);
    CREATE TABLE figures (result INTEGER NOT NULL REFERENCES results, key TEXT NOT NULL, value REAL NOT NULL,
        low REAL, high REAL, unit TEXT NOT NULL, PRIMARY KEY (result, key)) WITHOUT ROWID;
    CREATE TABLE coefficients (result INTEGER NOT NULL REFERENCES results, key TEXT NOT NULL, value REAL, std REAL,
        unit TEXT NOT NULL, why TEXT, PRIMARY KEY (result, key)) WITHOUT ROWID;
    CREATE INDEX results_by_arm ON results (arm, at);
    """,
)
"""Statements that bring a database of each version to the next; its version is SQLite's ``user_version``."""
_OTHER = "is not a database of robacc history"
_PATIENCE = 30.0
"""s to wait for another program that writes."""
_WITHOUT = ("poses", "poses_apart", "candidates", "worst_poses", "detection_limits", "next_poses")
"""Lists that the stored document lacks: they are long, and the result file has them."""
_STATED = ("fit", "declared", "align")
"""Options that say which effects a result has."""
_RIVAL = re.compile(r"is not distinguishable from (\S+) on these poses")
"""Reason that names one other coefficient."""
_STD = f"(t.high - t.low) / {2.0 * normal_quantile(0.975)!r}"
_COMPARED = "(t.key LIKE '%.rms' OR t.key LIKE 'iso9283.%') AND t.high > t.low AND r.command IN ('estimate', 'iso9283')"
"""Figures that are series of their own: the others say the same of the same poses."""


Test = Mapping[str, Any]
"""A result of the database, by :data:`_TEST`."""
_TEST = ("id", "at", "name", "arm", "model", "command", "n_poses", "grade", "temperature_c")


@contextmanager
def opened(path: str, *, writes: bool = False) -> Iterator[sqlite3.Connection]:
    """Yield the database in a file; it is made if it is to be written, and is brought to this version of its tables.

    Raises:
        InputError: The file does not exist, is no such database, is of a later version, or cannot be written.
    """
    missing = Problem("no such database", path, fix="robacc history add makes it")
    refuse(
        (not writes and not os.path.exists(path), missing),
        (not path or os.path.isdir(path), Problem(f"expected the name of a database file, found {path!r}")),
    )
    try:
        # A folder that cannot be written has no place for the files of the log.
        is_fixed = not writes and not os.access(os.path.dirname(path) or ".", os.W_OK)
        uri = f"file:{quote(path)}?mode={'rwc' if writes else 'ro'}{'&immutable=1' * is_fixed}"
        with closing(sqlite3.connect(uri, _PATIENCE, uri=True, isolation_level=None)) as db:
            if writes:
                db.execute("PRAGMA journal_mode = WAL")
                db.execute("BEGIN IMMEDIATE")
            version = db.execute("PRAGMA user_version").fetchone()[0]
            is_empty = version == 0 and not db.execute("SELECT 1 FROM sqlite_master").fetchall()
            later = f"has tables of version {version}; this robacc knows {len(_SCHEMAS)}"
            refuse(
                (is_empty and not writes, missing),
                (version == 0 and not is_empty, Problem(_OTHER, path, fix="name another file")),
                (version > len(_SCHEMAS), Problem(later, path, fix="use a later version of robacc")),
            )
            if writes:
                for statement in ";".join(_SCHEMAS[version:]).split(";"):
                    db.execute(statement)
                db.execute(f"PRAGMA user_version = {len(_SCHEMAS)}")
            yield db
            if writes:
                db.execute("COMMIT")
    except sqlite3.Error as error:
        text = _OTHER if "not a database" in str(error) else f"cannot be used as a database: {error}"
        raise InputError(Problem(text, path)) from None


def arm_of(document: Mapping[str, Any]) -> str:
    """Return the serial number of the arm of a result, else the robot's name."""
    identities = (entry.get("identity") or {} for entry in document["inputs"] if entry["kind"] == "robot")
    serial = next((identity["serial_number"] for identity in identities if "serial_number" in identity), None)
    return str(serial or (document.get("robot") or {}).get("name") or "unnamed")


def add(db: sqlite3.Connection, result: StoredResult, at: float, arm: str | None = None) -> bool:
    """Add a result of ``arm``, by default of :func:`arm_of`; return whether it was new.

    Raises:
        UsageError: The command's results cannot be compared.
        InputError: The document lacks what its command writes.
    """
    document = result.document
    with understood(result.name, result.command):
        figures = read_compared_result(document, result.name, result.name, result.sha256).figures
        coefficients = document.get("parameters", [])
        robot: dict[str, Any] = next((entry for entry in document["inputs"] if entry["kind"] == "robot"), {})
        heat = [value for value in (document.get("poses") or {}).get("temperature_c") or () if value is not None]
        values = {
            "sha256": result.sha256,
            "at": at,
            "name": os.path.basename(result.name),
            "arm": arm or arm_of(document),
            "model": f"{result.command} {robot.get('sha256')} {[*map(document['options'].get, _STATED)]}",
            "command": result.command,
            "version": document["robacc"],
            "n_poses": document["n_poses"],
            "grade": (document.get("grade") or {}).get("grade"),
            "temperature_c": float(np.mean(heat)) if heat else None,
            "document": zlib.compress(json.dumps({k: v for k, v in document.items() if k not in _WITHOUT}).encode()),
        }
        names, marks = ", ".join(values), ", ".join("?" * len(values))
        added = db.execute(f"INSERT OR IGNORE INTO results ({names}) VALUES ({marks})", [*values.values()])
        if not added.rowcount:
            return False
        number = added.lastrowid
        of_figures = [
            (
                number,
                key,
                figure.value,
                *(getattr(figure.interval, end, None) for end in ("lower", "upper")),
                unit_of(key),
            )
            for key, figure in figures.items()
        ]
        of_coefficients = [
            (number, e["name"], e["value"] if e["std"] is not None else None, e["std"], e["unit"], e.get("why"))
            for e in coefficients
        ]
        db.executemany("INSERT INTO figures VALUES (?, ?, ?, ?, ?, ?)", of_figures)
        db.executemany("INSERT INTO coefficients VALUES (?, ?, ?, ?, ?, ?)", of_coefficients)
    return True


def tests(db: sqlite3.Connection, arm: str | None) -> list[Test]:
    """Return the results of an arm, or of all, by arm and date.

    Raises:
        UsageError: The database has no such arm.
    """
    where, values = ("", []) if arm is None else ("WHERE arm = ?", [arm])
    own = db.execute(f"SELECT {', '.join(_TEST)} FROM results {where} ORDER BY arm, at, id", values)
    found: list[Test] = [dict(zip(_TEST, row, strict=True)) for row in own]
    arms = ", ".join(name for (name,) in db.execute("SELECT DISTINCT arm FROM results ORDER BY arm LIMIT 20"))
    refuse((arm is not None and not found, f"the database has no arm {arm!r}; it has {arms or 'no results'}"))
    return found


def document_of(db: sqlite3.Connection, test: Test) -> dict[str, Any]:
    """Return the stored document of a test."""
    (packed,) = db.execute("SELECT document FROM results WHERE id = ?", [test["id"]]).fetchone()
    document: dict[str, Any] = json.loads(zlib.decompress(packed))
    return document


COLUMNS = ("arm", "at", "result", "key", "value", "std", "unit")
"""Columns of :func:`rows`, and the id of the test."""


def rows(db: sqlite3.Connection, arm: str | None, key: str | None = None) -> list[tuple[Any, ...]]:
    """Return :data:`COLUMNS` of the figures and coefficients of an arm or of all, by key, arm and date.

    With ``key``, they are those of one key. The standard deviation of a figure is the width of its 95 % interval over
    twice the normal distribution's quantile.
    """
    one = "SELECT r.arm, r.at, r.name, t.key, t.value, {}, t.unit, r.id FROM {} t JOIN results r ON r.id = t.result"
    where = "WHERE ifnull(r.arm = ?1, 1) AND ifnull(t.key = ?2, 1)"
    both = f"{one.format(_STD, 'figures')} {where} UNION ALL {one.format('t.std', 'coefficients')} {where}"
    return db.execute(f"{both} ORDER BY 4, 1, 2, 8", [arm, key]).fetchall()


def counted(own: Sequence[Test]) -> list[Test]:
    """Return the tests of an arm that can be compared with the last of their kind: the same robot file and effects."""
    latest = {test["command"] in FITS or test["command"]: test["model"] for test in own}
    return [test for test in own if test["model"] == latest[test["command"] in FITS or test["command"]]]


def series_of(db: sqlite3.Connection, own: Sequence[Test]) -> list[ArmSeries]:
    """Return the series of tests of one arm: coefficients, and errors that estimates and ISO 9283 tests measured."""
    ids = json.dumps([test["id"] for test in own])
    of_tests = "t JOIN results r ON r.id = t.result WHERE r.id IN (SELECT value FROM json_each(?)) AND"
    columns = "t.key, t.unit, r.at, t.value, {}, r.temperature_c FROM {}"
    query = f"SELECT {columns} {of_tests} {{}} ORDER BY t.key, r.at, r.id"
    found = [
        *db.execute(query.format(_STD, "figures", _COMPARED), [ids]),
        *db.execute(query.format("t.std", "coefficients", "t.std > 0"), [ids]),
    ]
    rivals: dict[str, set[str]] = {}
    for key, why in db.execute(f"SELECT DISTINCT t.key, t.why FROM coefficients {of_tests} t.std IS NULL", [ids]):
        if (match := _RIVAL.search(why or "")) is not None:
            rivals.setdefault(match[1], set()).add(key)
    columns_of = {
        name: np.array([row[2:] for row in group], dtype=float).T
        for name, group in itertools.groupby(found, key=lambda row: row[:2])
    }
    return [
        ArmSeries(key, unit, times, values, stds, temperatures, tuple(sorted(rivals.get(key, ()))))
        for (key, unit), (times, values, stds, temperatures) in columns_of.items()
        if len(times) > 1
    ]
