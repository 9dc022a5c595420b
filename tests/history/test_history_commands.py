"""Database of results by its commands: what is added, shown and found; a kill, two writers, other files."""

import json
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import yaml
from commands import document, missing, one_line, output, refused, run
from sample_files import ROOT, saved

import robacc

NOMINAL = ROOT / "configs/robots/irb1600.yaml"
STEP = float(np.degrees(4e-4))
"""ArmChange of the third joint's zero from the seventh test on, degrees."""


def arm_with(folder, *, j3=0.0, x=0.0):
    content = yaml.safe_load(NOMINAL.read_text())
    content["effects"] = [
        {"effect": "base_frame", "values": {"x": 1.0 + x, "y": 2.0, "z": -1.0, "roll": 0.05, "yaw": 0.02}},
        {"effect": "joint_offset", "joints": ["j2", "j3", "j5"], "values": {"j2": 0.06, "j3": 0.1 + j3, "j5": -0.1}},
    ]
    return saved(folder / "arm.yaml", yaml.safe_dump(content))


def measured(folder, name, seed, poses=20, *, position_only=False, **arm):
    path = folder / name
    noises = {"noise": "0.03mm", "noise_orientation": "0.03mrad"}
    robacc.simulate(arm_with(folder, **arm), poses=poses, seed=seed, position_only=position_only, **noises).write(path)
    return path


@pytest.fixture(scope="module")
def tests(tmp_path_factory):
    """Ten weekly tests, as results of calibrate; the third joint's zero moved before the seventh."""
    folder, found = tmp_path_factory.mktemp("tests"), []
    for week in range(10):
        poses = measured(folder, f"w{week}.csv", week, j3=STEP * (week >= 6))
        result = robacc.calibrate(poses, robot=NOMINAL, fit="base_frame,tool_frame,joint_offset", folds=2)
        result.save(folder / f"w{week}.json")
        if week == 9:
            result.write_model(folder / "model.yaml")
        found.append(folder / f"w{week}.json")
    return found


@pytest.fixture(scope="module")
def database(tests, tmp_path_factory):
    path = tmp_path_factory.mktemp("db") / "arm.db"
    for week, result in enumerate(tests):
        output(
            "history", "add", result, "--db", path, "--at", f"2026-01-{1 + 7 * week:02d}" if week < 5 else _day(week)
        )
    return path


def _day(week):
    return str(np.datetime64("2026-01-01") + 7 * week)


def test_a_result_added_again_changes_nothing(tests, database, tmp_path):
    copy = shutil.copy(database, tmp_path / "copy.db")
    added = document("history", "add", tests[0], tests[1], "--db", copy)
    assert (added["added"], added["known"], added["n_results"]) == (0, 2, 10)
    assert "2 known already" in output("history", "add", *tests[:2], "--db", copy)


def test_show_lists_results_by_date(database):
    shown = document("history", "show", "--db", database)["results"]
    assert [one["at"] for one in shown] == [f"{_day(week)}T00:00:00Z" for week in range(10)]
    assert {one["command"] for one in shown} == {"calibrate"}
    assert {one["arm"] for one in shown} == {"ABB IRB 1600-x/1.45"}
    assert not missing(output("history", "show", "--db", database), "2026-01-08", "w1.json", "10 results")


def test_the_step_is_found_with_its_joint_date_and_size(database):
    found = document("history", "changes", "--db", database)
    (change,) = found["changes"]
    assert (change["key"], change["kind"], change["unit"]) == ("joint_offset.j3", "step", "rad")
    assert change["at"] == f"{_day(6)}T00:00:00Z"
    assert change["low"] < 4e-4 < change["high"]
    assert change["size"] == pytest.approx(4e-4, rel=0.1)
    limits = {limit["key"]: limit["limit"] for limit in found["arms"][0]["detection_limits"]}
    assert limits["joint_offset.j2"] < 4e-4
    text = one_line(output("history", "changes", "--db", database))
    assert not missing(text, "1 change in 10 tests", "joint_offset.j3", "2026-02-12", "0.023", "temperature_c")


def test_control_charts_show_the_change_and_its_limits(database, tmp_path):
    from robacc.render.plots.results import charts_of

    page = tmp_path / "page.html"
    output("history", "changes", "--db", database, "--output", tmp_path / "changes.json", "--report", page)
    found = json.loads((tmp_path / "changes.json").read_text())
    series = {one["key"]: one for one in found["arms"][0]["series"]}
    assert series.keys() == {limit["key"] for limit in found["arms"][0]["detection_limits"]}
    third = series["joint_offset.j3"]["values"]
    steps = np.diff([value["expected"] for value in third])
    assert steps[5] == pytest.approx(found["changes"][0]["size"])
    assert np.delete(steps, 5) == pytest.approx(0.0, abs=1e-12)
    assert all(value["low"] < value["value"] < value["high"] for one in series.values() for value in one["values"])
    charts = charts_of(found)
    assert charts[0].title == "joint_offset.j3 of ABB IRB 1600-x/1.45"
    assert f"step at {_day(6)} by" in charts[0].caption
    assert (len(charts), "nothing changed" in charts[1].caption) == (len(series), True)
    assert not missing(page.read_text(), "joint_offset.j3 of", "step at")
    output("report", tmp_path / "changes.json", "--chart", "control", "--output", tmp_path / "chart.svg")
    assert "<svg" in (tmp_path / "chart.svg").read_text()
    (trend,) = charts_of(document("history", "trend", "joint_offset.j3", "--db", database))
    assert "a year" in trend.caption


def test_charts_of_several_arms_are_of_what_changed(database, tests, tmp_path):
    copy = shutil.copy(database, tmp_path / "copy.db")
    output(
        "history", "add", tests[0], "--db", tmp_path / "other.db", "--arm", "other", "--at", "2026-01-01T10:30+02:00"
    )
    assert "2026-01-01 08:30 UTC" in output("history", "show", "--db", tmp_path / "other.db")
    with sqlite3.connect(copy) as base:
        base.execute("ATTACH ? AS other", [str(tmp_path / "other.db")])
        columns = "at, name, arm, model, command, version, n_poses, grade, temperature_c, document"
        base.execute(f"INSERT INTO results (sha256, {columns}) SELECT 'x', {columns} FROM other.results")
    arms = document("history", "changes", "--db", copy)["arms"]
    assert [[one["key"] for one in arm["series"]] for arm in arms] == [["joint_offset.j3"], []]


def test_a_gate_judges_a_change_by_its_size(database, tmp_path):
    gate = tmp_path / "gate.yaml"

    def status(limit, key):
        criterion = {"name": "zero", "key": key, "limit": limit, "reason": "What the cell can bear."}
        gate.write_text(yaml.safe_dump({"robacc_gate": 1, "name": "change", "criteria": [criterion]}))
        return run("history", "changes", "--db", database, "--gate", gate).exit_code

    assert status("0.2 mrad", "history.step.joint_offset.j3") == 4
    assert status("0.5 mrad", "history.step.joint_offset.j3") == 0
    assert status("0.2 mrad", "history.step.joint_offset.j2") == 0  # no change, and 0.2 mrad would have been seen
    assert status("0.001 mrad", "history.step.joint_offset.j2") == 5  # so small a change would not


def test_trend_and_tables(database, tmp_path):
    trend = document("history", "trend", "joint_offset.j3", "--db", database)
    (arm,) = trend["trends"]
    assert (trend["unit"], len(arm["values"])) == ("rad", 10)
    assert 0.0 < arm["low"] < arm["rate_per_year"] < arm["high"]
    output("history", "show", "--db", database, "--table", tmp_path / "all.csv")
    output("history", "show", "--db", database, "--table", tmp_path / "all.parquet")
    rows = (tmp_path / "all.csv").read_text().splitlines()
    assert rows[0] == "arm,at,result,key,value,std,unit"
    from pyarrow import parquet

    assert parquet.read_table(tmp_path / "all.parquet").num_rows == len(rows) - 1


def test_other_programs_read_the_database(database):
    with sqlite3.connect(database) as base:
        found = base.execute(
            "SELECT r.at, c.value FROM coefficients c JOIN results r ON r.id = c.result "
            "WHERE c.key = 'joint_offset.j3' ORDER BY r.at"
        ).fetchall()
    assert [value for _, value in found[6:]] == pytest.approx([np.radians(0.1 + STEP)] * 4, abs=5e-5)


@pytest.mark.parametrize(
    ("words", "status", "told"),
    [
        ("history", 2, "add, show, trend or changes"),
        ("history show --db {text}", 3, "is not a database of robacc history"),
        ("history show --db {none}", 3, "no such database"),
        ("history show --db {database} --arm other", 2, "has no arm 'other'"),
        ("history trend joint_offset.j9 --db {database}", 2, "the keys are"),
        ("history add {result} --db {other}", 3, "is not a database of robacc"),
        ("history add {result} {broken} --db {none}", 3, "truncated"),
        ("history add {result} --db {none} --at yesterday", 2, "expected a date"),
        ("history changes --db {later}", 3, "version 99"),
        ("fleet", 2, "name the results"),
        ("fleet {result}", 2, "at least two arms"),
        ("fleet {result} {result}", 2, "named twice"),
    ],
)
def test_calls_and_files_that_are_wrong(words, status, told, database, tests, tmp_path):
    later, other, none = (tmp_path / f"{name}.db" for name in ("later", "other", "none"))
    shutil.copy(database, later)
    for path, change in ((later, "PRAGMA user_version = 99"), (other, "CREATE TABLE things (name TEXT)")):
        with sqlite3.connect(path) as base:
            base.execute(change)
    text = saved(tmp_path / "text.db", "not a database, but a text that is long enough to be one")
    broken = saved(tmp_path / "broken.json", tests[0].read_text()[:3000])
    files = {"later": later, "other": other, "none": none, "text": text, "broken": broken}
    call = [word.format(database=database, result=tests[0], **files) for word in words.split()]
    assert told in refused(*call, status=status)
    assert "no such database" in refused("history", "show", "--db", none, status=3)


def test_a_reader_leaves_nothing_beside_the_database(tests, tmp_path):
    folder = tmp_path / "db"
    folder.mkdir()
    path = folder / "arm.db"
    output("history", "add", *tests[:3], "--db", path, "--at", "2026-01-01")
    before = path.read_bytes()
    quick = measured(tmp_path, "quick.csv", 50, poses=12)
    output("health", quick, "--robot", tests[0].parent / "model.yaml", "--db", path)
    output("history", "changes", "--db", path)
    assert ([file.name for file in folder.iterdir()], path.read_bytes() == before) == (["arm.db"], True)


def test_two_writers_add_everything(tests, tmp_path):
    path = tmp_path / "two.db"
    command = [sys.executable, "-m", "robacc", "history", "add"]
    with ThreadPoolExecutor(2) as pool:
        ended = pool.map(lambda file: subprocess.run([*command, file, "--db", path], cwd=ROOT).returncode, tests[:2])
    assert [*ended] == [0] * 2
    assert len(document("history", "show", "--db", path)["results"]) == 2


@pytest.mark.slow
def test_a_kill_at_any_moment_loses_nothing(tests, tmp_path):
    path, added = tmp_path / "killed.db", 0
    script = (
        "import sys, robacc\n"
        "for name in sys.argv[2:]:\n"
        "    robacc.history_add(name, db=sys.argv[1]); print(name, flush=True)"
    )
    rng = np.random.default_rng(0)
    for round_ in range(20):
        files = []
        for i in range(10):
            copy = saved(
                tmp_path / f"r{round_}_{i}.json",
                tests[i].read_text().replace('"seed": 0', f'"seed": {100 * round_ + i}'),
            )
            files.append(str(copy))
        with subprocess.Popen([sys.executable, "-c", script, path, *files], stdout=subprocess.PIPE, text=True) as child:
            assert child.stdout.readline()
            time.sleep(rng.uniform(0.0, 0.05))
            child.send_signal(signal.SIGKILL)
            added += 1 + len(child.stdout.read().splitlines())
        with sqlite3.connect(path) as base:
            assert base.execute("PRAGMA integrity_check").fetchone() == ("ok",)
            (count,) = base.execute("SELECT count(*) FROM results").fetchone()
            (whole,) = base.execute("SELECT count(DISTINCT result) FROM coefficients").fetchone()
        assert added <= count == whole <= added + round_ + 1


# Quick tests.


def test_a_quick_test_names_the_joint_that_moved(tests, database, tmp_path):
    folder = tests[0].parent
    same = measured(tmp_path, "same.csv", 50, poses=12, j3=STEP, x=0.7)
    words = ("--robot", folder / "model.yaml", "--db", database)
    found = document("health", same, *words)
    assert found["changes"] == []
    limits = {limit["key"]: limit["limit"] for limit in found["detection_limits"]}
    assert 1e-5 < limits["joint_offset.j3"] < 3e-4
    moved = measured(tmp_path, "moved.csv", 51, poses=12, j3=2 * STEP, x=0.7)
    (change,) = document("health", moved, *words)["changes"]
    assert (change["key"], change["kind"]) == ("joint_offset.j3", "step")
    assert change["low"] < 4e-4 < change["high"]
    assert change["earliest"] == f"{_day(9)}T00:00:00Z"
    assert "joint_offset.j3 moved" in output("health", moved, *words)
    assert "has no fit" in refused("health", moved, "--robot", NOMINAL, "--db", database)


def test_a_quick_test_of_a_fit_to_few_poses_has_the_limits_of_its_errors(database, tmp_path):
    """The errors of 15 poses had no variance along one direction, and the limit of a zero was 0.35 rad."""
    poses = measured(tmp_path, "few.csv", 9, poses=15, j3=STEP)
    robacc.calibrate(poses, robot=NOMINAL, fit="base_frame,tool_frame,joint_offset", folds=2).write_model(
        tmp_path / "few.yaml"
    )
    found = document(
        "health", measured(tmp_path, "q.csv", 50, poses=12, j3=STEP), "--robot", tmp_path / "few.yaml", "--db", database
    )
    assert max(limit["limit"] for limit in found["detection_limits"]) < 1e-3


def test_a_quick_test_of_positions_sees_what_they_show(tests, database, tmp_path):
    words = ("--robot", tests[0].parent / "model.yaml", "--db", database)
    path = tmp_path / "positions.csv"
    truth = arm_with(tmp_path, j3=2 * STEP)
    robacc.simulate(truth, poses=16, seed=3, noise="0.03mm", position_only=True).write(path)
    found = document("health", path, *words)
    assert [change["key"] for change in found["changes"]] == ["joint_offset.j3"]
    assert {"joint_offset.j1", "joint_offset.j6"} <= {*found["hidden"]}
    few = measured(tmp_path, "few.csv", 4, poses=2)
    assert "2 poses say nothing" in refused("health", few, *words, status=3)
    assert "older than the last test" in refused("health", path, *words, "--at", "2020-01-01")
    assert not robacc.health(path, robot=words[1], db=database).warnings
    calibrated = robacc.calibrate(path, robot=NOMINAL, fit="base_frame,joint_offset")
    calibrated.write_model(tmp_path / "other.yaml")
    assert "not fitted to the poses of the last test" in run(
        "health", path, "--robot", tmp_path / "other.yaml", "--db", database
    ).stderr.replace("\n", " ")


def test_fits_of_other_effects_are_not_compared(tests, database, tmp_path):
    copy = shutil.copy(database, tmp_path / "copy.db")
    robacc.calibrate(measured(tmp_path, "w.csv", 70, j3=STEP), robot=NOMINAL).save(tmp_path / "w.json")
    output("history", "add", tmp_path / "w.json", "--db", copy, "--at", _day(10))
    found = document("history", "changes", "--db", copy)
    assert found["changes"] == []
    assert found["arms"][0]["notes"][0].startswith("1 of them count")


# Fleets.


@pytest.fixture(scope="module")
def fleet_results(tmp_path_factory):
    """Eight arms whose third joint's zero has a standard deviation of 1 mrad; one arm is far off."""
    folder, rng, found = tmp_path_factory.mktemp("fleet"), np.random.default_rng(4), []
    for arm in range(8):
        j3 = float(np.degrees(rng.normal(0, 1e-3))) if arm != 5 else 1.5
        poses = measured(folder, f"a{arm}.csv", arm, 20, j3=j3, position_only=True)
        own = saved(folder / f"n{arm}.yaml", f"{NOMINAL.read_text()}\nidentity: {{serial_number: SN{arm:02d}}}\n")
        fitted = robacc.calibrate(poses, robot=own, fit="base_frame,tool_frame,joint_offset", shrink=False, folds=2)
        fitted.save(folder / f"a{arm}.json")
        found.append(folder / f"a{arm}.json")
    return found


def test_a_fleet_has_tolerances_and_names_the_stranger(fleet_results, tmp_path):
    paths = tmp_path / "tolerances.yaml", tmp_path / "typical.yaml"
    words = ("--robot", NOMINAL, "--write-tolerances", paths[0], "--write-robot", paths[1])
    found = document("fleet", *fleet_results, *words)
    (stranger,) = found["strangers"]
    assert stranger["arm"] == "SN05"
    assert stranger["key"] == "joint_offset.j3"
    assert stranger["value"] == pytest.approx(np.radians(1.6), rel=0.05)
    by_key = {one["key"]: one for one in found["coefficients"]}
    third = by_key["joint_offset.j3"]
    assert third["n_arms"] == 7
    assert third["std_low"] < 1e-3 < third["std_high"]
    assert third["mean_low"] < np.radians(0.1) < third["mean_high"]
    assert by_key["joint_offset.j2"]["std"] < 1e-5
    assert np.linalg.eigvalsh(np.array(found["covariance"]["matrix"])).min() > -1e-18
    # The tolerances are those of predict, the typical arm is a robot whose tolerances are priors of calibrate.
    budget = document("predict", NOMINAL, "--tolerances", paths[0], "--samples", 50)["budget"]
    assert max(budget, key=lambda entry: entry["share_position"])["joint"] == "j3"
    typical = robacc.read_robot(paths[1])
    assert typical.joints[2].tolerance["theta"] == pytest.approx(third["std"], rel=1e-6)
    poses = measured(tmp_path, "next.csv", 99, poses=20)
    assert robacc.calibrate(poses, robot=paths[1], fit="base_frame,tool_frame,joint_offset", prior=True).converged
    assert "none" not in output("fleet", *fleet_results).split("Arms out of family")[1]


def test_a_fleet_takes_only_coefficients_that_mean_the_same_and_come_from_the_poses(fleet_results, tmp_path):
    """One arm lacks a coefficient that others make up for; in all fits a prior holds the fourth joint's zero."""
    paths = []
    for number, path in enumerate(fleet_results):
        result = json.loads(path.read_text())
        names, entries = result["parameter_covariance"]["names"], result["parameters"]
        rows = result["parameter_covariance"]["lower_triangle"]
        at, beside = names.index("joint_offset.j4"), names.index("joint_offset.j5")
        # The fifth joint's zero has all of its variance from the fourth's, that of the second none.
        first, second = sorted((at, beside))
        rows[second][first] = (rows[first][first] * rows[second][second]) ** 0.5
        weak = {"effect": "joint_offset", "unit": "rad", "std": 3e-3, "weakly_identifiable": ["joint_offset.j4"]}
        result["priors"] = [weak]
        if number == 2:
            next(entry for entry in entries if entry["name"] == "joint_offset.j2").update(
                std=None, why="not identifiable"
            )
        paths.append(saved(tmp_path / path.name, json.dumps(result)))
    found = document("fleet", *paths)
    by_key = {one["key"]: one for one in found["coefficients"]}
    assert "joint_offset.j4" not in by_key
    assert "joint_offset.j5" not in by_key
    assert by_key["joint_offset.j3"]["n_arms"] == 6
    assert [stranger["arm"] for stranger in found["strangers"]] == ["SN05"]
    assert any(note.startswith("fits left out: 1;") for note in found["notes"])
    # The same fit under another name, with a space more.
    again = saved(tmp_path / "again.json", fleet_results[0].read_text() + " ")
    notes = document("fleet", *fleet_results, again)["notes"]
    assert any(note.startswith("results of the same measured poses as another: 1;") for note in notes)


def test_a_fleet_is_the_same_bytes_whoever_read_its_results(fleet_results, monkeypatch):
    own = output("fleet", *fleet_results, "--format", "json")
    assert output("fleet", *fleet_results, "--format", "json", "--jobs", 2) == own
    pytest.importorskip("distributed")
    monkeypatch.setattr("robacc.workers._TIMEOUT", 0.5)
    absent = "tcp://127.0.0.1:9"
    assert f"no scheduler of Dask answers at {absent}" in refused("fleet", *fleet_results, "--cluster", absent)


def test_a_fleet_of_a_database_takes_the_latest_fit_of_each_arm(fleet_results, tests, tmp_path):
    path = tmp_path / "fleet.db"
    for result in fleet_results[:3]:
        output("history", "add", result, "--db", path)
    assert document("fleet", "--db", path)["n_arms"] == 3
    assert "SN00" in output("history", "show", "--db", path)
    output("history", "add", tests[0], "--db", path, "--arm", "SN00")
    assert len(document("history", "show", "--db", path, "--arm", "SN00")["results"]) == 2
    assert document("fleet", "--db", path)["n_arms"] == 3
