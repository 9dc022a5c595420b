"""What all tests share.

Modules of ``tests/effects``, ``tests/fuzz`` and ``docs/tools`` are there for tests of every room. Linear algebra is on
one thread, as the command line runs it (see ``robacc.cli.main.main``). Random examples are the same in every run;
``pytest --hypothesis-profile=default`` draws new ones.
"""

from __future__ import annotations

import gc
import os
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from hypothesis import settings

if TYPE_CHECKING:
    from pose_files import Reader

    from robacc.measurements import Measurements

ROOT = Path(__file__).resolve().parents[1]
sys.path += [str(ROOT / folder) for folder in ("tests/effects", "tests/fuzz", "docs/tools")]
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
settings.register_profile("repeatable", derandomize=True)
settings.load_profile("repeatable")


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> object:
    """Keep the tests of a module on one worker: results and fits that they share are made once."""
    from xdist.scheduler import LoadFileScheduling

    return LoadFileScheduling(config, log)


def pytest_collection_finish() -> None:
    """Take the tests themselves, which live to the end, out of the garbage collector's rounds."""
    gc.collect()
    gc.freeze()


@pytest.fixture
def read(tmp_path: Path) -> Reader:
    """Reads text or bytes as a file called poses.csv, with statements such as ``units`` and options of the reader."""
    from robacc.poses.csv_file import read_poses
    from robacc.poses.reading import PoseFile

    def reader(text: str | bytes, **options: Any) -> Measurements:
        path = tmp_path / "poses.csv"
        path.write_bytes(text.encode() if isinstance(text, str) else text)
        named = ("angles", "units", "columns", "skip_gaps", "coverage")
        stated = {name: options.pop(name) for name in named if name in options}
        return read_poses(PoseFile(path, **stated), **options)

    return reader
