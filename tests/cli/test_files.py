"""Text in and out, and which format a robot is in."""

import os
import stat
from pathlib import Path

import pytest
from refusals import problems_of
from robot_files import MINIMAL
from sample_files import saved

from robacc import InputError, UsageError, read_robot
from robacc.io.files import read_text, sha256_of, write_file


def test_text_is_read_whatever_marks_its_encoding(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    for encoding in ("utf-8", "utf-8-sig", "utf-16"):
        path.write_text("name: bär\r\n", encoding=encoding, newline="")
        assert read_text(path).splitlines() == ["name: bär"]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"a\nb\0c", ":2: is not a text file: it contains a NUL byte"),
        (b"a\nb\n\xe4", ":3: is not UTF-8 text (byte 0xe4); save it as UTF-8"),
        (b"\xff\xfea", ":1: is not UTF-16 text"),
        (b"x" * 2000, ": is larger than 0.000976562 MiB, the limit for text files"),
    ],
)
def test_what_is_no_text_is_said(tmp_path: Path, content: bytes, message: str) -> None:
    path = saved(tmp_path / "a.yaml", content)
    assert f"{path}{message}" in problems_of(read_text, path, limit=1024)[0]


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    for path, message in (
        (tmp_path, "is a folder, not a file"),
        (tmp_path / "no.yaml", "the file does not exist"),
        (write(tmp_path / "file", "x") / "a.yaml", "cannot be read: not a directory"),
        ("a\0b", "cannot be read"),
    ):
        with pytest.raises(InputError, match=message):
            read_text(path)
    with pytest.raises(InputError, match="the file does not exist"):
        sha256_of(tmp_path / "no.yaml")


def write(path: Path, text: str) -> Path:
    path.write_text(text, encoding="utf-8")
    return path


def test_a_digest_is_of_the_bytes_that_were_read(tmp_path: Path) -> None:
    path = write(tmp_path / "abc", "abc")
    # FIPS 180-2, appendix B.1.
    digest = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    assert sha256_of(path) == digest
    read_text(path)
    write(path, "changed meanwhile")
    assert sha256_of(path) == digest
    assert sha256_of(path) != digest


def test_text_is_written_whole_and_keeps_permissions_and_links(tmp_path: Path) -> None:
    path = write(tmp_path / "out.txt", "old")
    path.chmod(0o640)
    link = tmp_path / "link"
    link.symlink_to(path)
    write_file(link, "neu ü\r\n")
    assert path.read_bytes() == "neu ü\r\n".encode()
    assert link.is_symlink()
    assert stat.S_IMODE(path.stat().st_mode) == 0o640
    write_file(tmp_path / "fresh", "x")
    mask = os.umask(0)
    os.umask(mask)
    assert stat.S_IMODE((tmp_path / "fresh").stat().st_mode) == 0o666 & ~mask
    assert sorted(item.name for item in tmp_path.iterdir()) == ["fresh", "link", "out.txt"]


def test_a_failed_write_leaves_the_old_file_and_no_other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write(tmp_path / "out.txt", "old")

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(InputError, match="cannot be written: no space left on device"):
        write_file(path, "new")
    assert (path.read_text(), list(tmp_path.iterdir())) == ("old", [path])


def test_places_that_cannot_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    dangling = tmp_path / "link.json"
    dangling.symlink_to(tmp_path / "missing" / "r.json")
    for path, message in (
        (tmp_path / "no" / "out.txt", "its folder does not exist; create the folder first"),
        (dangling, "its folder does not exist; create the folder first"),
        (tmp_path, "is a folder, not a file; name a file in it"),
    ):
        with pytest.raises(InputError, match=message):
            write_file(path, "x")
    assert list(tmp_path.iterdir()) == [dangling]
    path = write(tmp_path / "out.txt", "old")
    monkeypatch.setattr(os, "access", lambda *_: False)  # root may write anything, so the mode alone shows nothing
    with pytest.raises(InputError, match="cannot be written: the file is write-protected"):
        write_file(path, "new")
    assert path.read_text() == "old"


def test_what_is_no_plain_file_is_written_to() -> None:
    write_file(os.devnull, "x")
    assert Path(os.devnull).is_char_device()


URDF = (
    '<?xml version="1.0"?>\n<robot name="r"><link name="a"/><link name="b"/><joint name="j" type="continuous">'
    '<parent link="a"/><child link="b"/></joint></robot>'
)


@pytest.mark.parametrize(
    ("name", "content", "links", "convention"),
    [
        ("robot.txt", URDF, {}, "urdf"),
        ("robot.urdf", URDF, {"base_link": "a", "tip_link": "b"}, "urdf"),
        ("robot.cfg", MINIMAL, {}, "standard"),
        ("bom.yaml", "\ufeff" + MINIMAL, {}, "standard"),
    ],
)
def test_content_decides_the_format(
    tmp_path: Path, name: str, content: str, links: dict[str, str], convention: str
) -> None:
    robot = read_robot(write(tmp_path / name, content), **links)
    assert (robot.convention, robot.name) == (convention, "r" if convention == "urdf" else "arm")
    assert convention == "standard" or robot.tip_link == "b"


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        (
            "a.stl",
            "solid",
            "is a mesh (.stl), which has no joints; give a robot file (YAML), a URDF, or a table",
        ),
        (
            "arm.m",
            "L(1) = Link('d', 0.4)\n",
            "is a program, which is not run; give a robot file (YAML), a URDF, or a table",
        ),
        ("a.urdf.xacro", "<robot/>", "is xacro, not URDF; convert it first"),
        (
            "a.csv",
            "x,y\n1,2\n",
            "is a table, not a robot description; give a robot file (YAML), a URDF, or a table",
        ),
        (
            "calibration.conf",
            "[mounting]\ndelta_theta = [ 0, 0, 0, 0, 0, 0]\n",
            "is a kinematics file; convert it first: robacc init --from FILE --output robot.yaml",
        ),
        (
            "a.yaml",
            "kinematics:\n  shoulder: {x: 0}\n",
            "is a kinematics file; convert it first: robacc init --from FILE --output robot.yaml",
        ),
        ("a.sdf", "<sdf/>", "the root element is <sdf>, so this is an SDF model"),
        ("a.xml", "<mujoco/>", "the root element is <mujoco>, so this is a MuJoCo model"),
        ("a.urdf", "robacc: 1", "not well-formed XML"),
    ],
)
def test_other_files_are_named(tmp_path: Path, name: str, content: str, message: str) -> None:
    assert message in problems_of(read_robot, write(tmp_path / name, content))[0]


def test_links_with_a_robot_file_are_wrong_usage(tmp_path: Path) -> None:
    path = write(tmp_path / "arm.yaml", MINIMAL)
    for option in ({"base_link": "a"}, {"tip_link": "b"}):
        with pytest.raises(UsageError, match="`base_link` and `tip_link` choose a chain of a URDF"):
            read_robot(path, **option)
