"""Mutated files through every reader: each is read to sound numbers or refused. See tests/fuzz/run.py."""

import random
from pathlib import Path

import numpy as np
import pytest
from mutations import mutate_json, mutate_text
from targets import READERS, seeds

from robacc import PoseFile, RobaccError
from robacc.poses.csv_file import propose_columns, read_poses

SEEDS = (
    "Titel;Zelle 3\nPunkt;A1;A2;X [mm];Y [mm];Z [mm];A;B;C;Zeit\n"
    + "P1;1,5;-20;850,1;3;4;10;20;30;22.11.2026 10:00:05\n" * 3,
    "// SpatialAnalyzer, Units: mm\n" + "A Main p1 1.5 2.5 3.5 0.01 0.01 0.02\n" * 3,
    "Time\tJ1\tJ2\tPos X\tPos Y\tPos Z\tUx\tUy\tUz\nms\tdeg\tdeg\tmm\tmm\tmm\tmm\tmm\tmm\n"
    + "5\t1\t2\t3\t4\t5\t.1\t.1\t.1\n" * 3,
    "1.5 0.1 0.2 0.3 0 0 0 1\n" * 4,
    "header.stamp.sec,header.stamp.nanosec,/joint_states/j1/position,pose.position.x,pose.position.y,pose.position.z\n"
    + "1795341600,5,0.1,1,2,3\n" * 3,
    "sep=;\nNominal X;Nominal Y;Nominal Z;X act;Y act;Z act;Rx;Ry;Rz;Name\n" + "1;2;3;1.1;2.1;3.1;10;20;30;a\n" * 3,
)
STATEMENTS = ({}, {"units": "mm,deg", "angles": "fixed-xyz", "coverage": 2.0, "skip_gaps": True})


def attacked(count: int, seed: int, path: Path) -> int:
    """The number of files that could be read."""
    rng = random.Random(seed)
    accepted = 0
    for number in range(count):
        encoding = rng.choice(("utf-8", "cp1252", "utf-16"))
        data = mutate_text(rng.choice(SEEDS).encode(encoding), rng)
        path.write_bytes(data)
        for statements in STATEMENTS:
            try:
                poses = read_poses(PoseFile(path, **statements), ordered=number % 2 == 0, commands=False)  # type: ignore[arg-type]
                accepted += 1
                for values in (poses.position, poses.rotation, poses.q, poses.time, poses.sigma_position):
                    assert values is None or np.isfinite(values).all()
                propose_columns(path, "columns.yaml")
            except RobaccError:
                continue
            except Exception as error:
                error.add_note(f"file {number} of seed {seed}: {data!r}")
                raise
    return accepted


def test_mutated_exports_are_read_or_refused(tmp_path: Path) -> None:
    assert attacked(60, 0, tmp_path / "export.txt") > 10


@pytest.mark.slow
def test_many_mutated_exports(tmp_path: Path) -> None:
    assert attacked(1500, 1, tmp_path / "export.txt") > 100


# Files on which a reader once failed.
REGRESSIONS: dict[str, tuple[bytes, ...]] = {
    "poses": (
        # Three rows of two poses: the bias correction of a principal axis was of the wrong sign.
        b"x_mm,y_mm,z_mm,cmd_x_mm,cmd_y_mm,cmd_z_mm,pose\n1,2,3,11,2,3.1,a\n1,2,4,1,2,3.1,a\n5,2,3,5,2.1,3,b\n",
        b"x,y,z,cmd_x,cmd_y,cmd_z,rx_deg,ry_deg,rz_deg\n1,2,3,1,2,3,1e308,0,0\n",
        b"pose,x,y,z,cmd_x,cmd_y,cmd_z\n\x1b[2J,1,2,3,1,2,3\n",
        b"// SpatialAnalyzer, Units: mm\nA Main p1 1.5 2.5 3.5 0.01 0.01 0.02\nA Main p2 1.5 2.5 3.5 0.01 1e308 0.02\n",
    ),
    "robot_poses": (b"q1,q2,q3,q4,q5,q6,x,y,z\n0,0,0,0,0,0,1e308,-1e308,0\n0,0,0,0,0,0,-1e308,1e308,0\n",),
    "cycles": (b"pose,cycle,x_m,y_m,z_m,cmd_x_m,cmd_y_m,cmd_z_m\na,1,1e200,0,0,0,0,0\na,2,0,0,0,0,0,0\n",),
    "urdf": (
        b'<robot name="r"><link name="a"/><link name="b"/><joint name="j" type="prismatic"><parent link="a"/>'
        b'<child link="b"/><origin><x/></origin><limit lower="-1e308" upper="1e308" velocity="x"/></joint></robot>',
    ),
    "gate": (b"robacc_gate: 1\nname: \xc2\xa0x\ncriteria: [{key: position.rms, limit: 1 mm, reason: \xe2\x80\xae}]\n",),
}


@pytest.mark.parametrize("reader", REGRESSIONS)
def test_files_that_once_failed(reader: str) -> None:
    for data in REGRESSIONS[reader]:
        READERS[reader](data)


def test_nanoseconds_beyond_all_time_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "log.csv"
    head = next(seed for seed in SEEDS if seed.startswith("header.stamp"))
    for number in ("1.8e308", "1.7e308"):
        path.write_text(f"{head}1795341600,{number},0.1,1,2,3\n")
        with pytest.raises(RobaccError, match=f"5, header.stamp.nanosec: found '{number}'"):
            read_poses(PoseFile(path), commands=False)


def attacked_of_hostile_fuzz(reader: str, count: int, seed: int) -> None:
    rng = random.Random(f"{reader} {seed}")
    pool = seeds(reader)
    mutate = mutate_json if pool[0].startswith(b"{") else mutate_text
    for number in range(count):
        data = mutate(rng.choice(pool), rng)
        try:
            READERS[reader](data)
        except Exception as error:
            error.add_note(f"{reader}, file {number} of seed {seed}: {data[:2000]!r}")
            raise


QUICK = [reader for reader in READERS if reader not in ("result", "page", "robot_used", "cycles")]


@pytest.mark.parametrize("reader", QUICK)
def test_a_few_files(reader: str) -> None:
    attacked_of_hostile_fuzz(reader, 8, 0)


@pytest.mark.slow
@pytest.mark.parametrize("reader", READERS)
def test_many_files(reader: str) -> None:
    attacked_of_hostile_fuzz(reader, 30 if reader == "page" else 200, 1)
