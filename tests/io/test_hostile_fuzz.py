"""Mutated files through every reader: a defect, a hang or a silent end is a failure. See tests/fuzz/run.py."""

from __future__ import annotations

import random
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "fuzz"))

from mutations import mutate_json, mutate_text
from targets import READERS, seeds

# Files on which a reader once failed.
REGRESSIONS: dict[str, tuple[bytes, ...]] = {
    "poses": (
        # Three rows of two poses: the bias correction of a principal axis was of the wrong sign.
        b"x_mm,y_mm,z_mm,cmd_x_mm,cmd_y_mm,cmd_z_mm,pose\n1,2,3,11,2,3.1,a\n1,2,4,1,2,3.1,a\n5,2,3,5,2.1,3,b\n",
        b"x,y,z,cmd_x,cmd_y,cmd_z,rx_deg,ry_deg,rz_deg\n1,2,3,1,2,3,1e308,0,0\n",
        b"pose,x,y,z,cmd_x,cmd_y,cmd_z\n\x1b[2J,1,2,3,1,2,3\n",
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


def attacked(reader: str, count: int, seed: int) -> None:
    rng = random.Random(f"{reader} {seed}")
    pool = list(seeds(reader))
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
    attacked(reader, 8, 0)


@pytest.mark.slow
@pytest.mark.parametrize("reader", READERS)
def test_many_files(reader: str) -> None:
    attacked(reader, 30 if reader == "page" else 200, 1)
