"""Hostile files of poses: each ends in a message, bounded in time and memory, and nothing acts on the terminal."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from robacc.errors import InputError
from robacc.poses.csv_file import read_poses

HEAD = "x,y,z,cmd_x,cmd_y,cmd_z\n"
ROW = "1,2,3,1,2,3.001\n"
MEMORY = 2 * 2**30
"""Bytes of address space: the libraries take some 0.5 GB of it, and the files here pretend to be 10 GB."""


def estimate(*arguments: str, text: bytes = b"") -> subprocess.CompletedProcess[str]:
    """``robacc estimate`` as a process that may neither fill the memory nor take long."""
    code = (
        f"import resource; resource.setrlimit(resource.RLIMIT_AS, ({MEMORY}, {MEMORY}));"
        "from robacc.__main__ import main; main()"
    )
    done = subprocess.run(
        (sys.executable, "-c", code, "estimate", *arguments), input=text, capture_output=True, timeout=60, check=False
    )
    return subprocess.CompletedProcess(done.args, done.returncode, done.stdout.decode(), done.stderr.decode())


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_ends_of_lines_and_denormal_numbers_are_taken(tmp_path: Path, end: str) -> None:
    path = tmp_path / "poses.csv"
    path.write_bytes((HEAD + "5e-324,2,3,0,2,3\n" + ROW).replace("\n", end).encode())
    assert read_poses(path).position[0].tolist() == [5e-324, 1.0]


@pytest.mark.slow
def test_a_file_of_ten_gigabytes_and_streams_without_an_end(tmp_path: Path) -> None:
    sparse = tmp_path / "sparse.csv"
    with sparse.open("wb") as stream:
        stream.truncate(10 * 2**30)
    for path in (str(sparse), "/dev/zero"):
        done = estimate(path)
        assert (done.returncode, done.stdout) == (3, "")
        assert f"error: {path}:1: the line is longer than 1 MB" in done.stderr


def test_no_file_of_rows(tmp_path: Path) -> None:
    for path, message in ((str(tmp_path), "is a folder, expected a file"), (os.devnull, "the file is empty")):
        with pytest.raises(InputError, match=message):
            read_poses(path)


def test_a_pipe_is_read_once(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe.csv"
    os.mkfifo(pipe)
    writer = threading.Thread(target=lambda: pipe.write_text(HEAD + ROW))
    writer.start()
    assert read_poses(pipe).n == 1
    writer.join()


def test_names_cannot_act_on_the_terminal() -> None:
    """Neither a column's nor a pose's; a terminal would take the escape for "clear the screen"."""
    text = f"pose,\x1b[2Jcolumn\u202e,{HEAD}\x1b[31mred\x07\u202e,1,{ROW}b,1,{ROW}"
    done = estimate("-", text=text.encode())
    assert done.returncode == 0
    output = done.stdout + done.stderr
    assert "\\x1b[31mred\\x07\\u202e" in done.stdout
    assert "\\x1b[2Jcolumn\\u202e" in done.stderr
    assert all(sign.isprintable() or sign == "\n" for sign in output)
    done = estimate("-", "--format", "json", text=text.encode())
    assert all(sign.isprintable() or sign == "\n" for sign in done.stdout)
    done = estimate("no\x1b[2J.csv")
    assert done.stderr.startswith("error: no\\x1b[2J.csv")
