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


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ((HEAD + ROW).encode("utf-16")[:-1], "the file is not UTF-8 text (it is UTF-16 or binary); save it as UTF-8"),
        (HEAD.encode("utf-16-le"), "the file is not UTF-8 text (it is UTF-16 or binary); save it as UTF-8"),
        ((HEAD + "1,2,3\0,1,2,3\n").encode(), "the file is not UTF-8 text (it is UTF-16 or binary); save it as UTF-8"),
        (("pose," + HEAD).encode() + b"p\x81," + ROW.encode(), ":2: byte 2 of the line, 0x81, is not UTF-8"),
        (
            (HEAD + ROW.replace("1", "one").replace("2", "two")).replace(",", ";").encode(),
            ":2, x: found 'one', expected a number",
        ),
        ((HEAD + '"1,5",2,3,1,2,3\n').encode(), ":2, x: found '1,5', expected a number; write decimals with a point"),
        ((HEAD + "1,5,2,3,1,2,3\n").encode(), ":2: found 7 fields, expected 6 as in the header"),
        ((HEAD + "1,2,3,1,2," + "9" * 400 + "\n").encode(), ":2, cmd_z: found '9999"),
        ((HEAD + "1,2,1e308,1,2,3\n").encode(), ":2, z: found 1e+308, expected at most 1e+08"),
        (
            b"sigma_x,sigma_y,sigma_z," + (HEAD + "5e-324,1e-5,1e-5," + ROW).encode(),
            ":2, sigma_x: found 4.940656458e-324, expected at least 1e-12 m or rad",
        ),
        (b"rx_deg,ry_deg,rz_deg," + (HEAD + "1e300,0,0," + ROW).encode(), ":2, rx_deg: found 1e+300 deg, expected at"),
        (b"time_s," + (HEAD + "-1e200," + ROW).encode(), ":2, time_s: found -1e+200, expected at most 1e+12"),
        (",".join(f"c{i}" for i in range(100_000)).encode(), ":1: found 100000 columns; expected at most 2000"),
        ((HEAD + '"1,2,3,1,2,3\n').encode(), ":2: the row cannot be read"),
        (b"# nothing\n#\n", "the file is empty; expected a header row of column names and one row per pose"),
    ],
)
def test_a_file_that_cannot_be_used(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "poses.csv"
    path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        read_poses(path, units_check=False)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    "cell", ["nan", "NaN", "-nan", "inf", "-Infinity", "1e400", "#N/A", "", "1_0", "0x1", "true", "١", "1 2", "--1"]
)
def test_what_is_no_finite_number(tmp_path: Path, cell: str) -> None:
    path = tmp_path / "poses.csv"
    path.write_text(HEAD + ROW + f"1,2,{cell},1,2,3\n", encoding="utf-8")
    with pytest.raises(InputError) as caught:
        read_poses(path)
    (problem,) = caught.value.problems
    assert (problem.line, problem.column) == (3, "z")


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
