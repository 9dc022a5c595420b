"""What all tests share: linear algebra on one thread, as the command line runs it (see ``robacc.cli.main.main``)."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

if TYPE_CHECKING:
    from pose_files import Reader

    from robacc.measurements import Measurements

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


@pytest.fixture
def read(tmp_path: Path) -> Reader:
    """Reads text or bytes as a file called poses.csv."""
    from robacc.poses.csv_file import read_poses

    def reader(text: str | bytes, **options: Any) -> Measurements:
        path = tmp_path / "poses.csv"
        path.write_bytes(text.encode() if isinstance(text, str) else text)
        return read_poses(path, **options)

    return reader
