"""Wrong sizes of a board and a lens, which the lengths of the arm contradict."""

import csv
from importlib import resources
from pathlib import Path

import pytest
import yaml
from sample_files import saved

import robacc
from robacc.poses.reading import PoseFile

SAMPLE = Path("sample_data/photos")
ZEROS = "base_frame,tool_frame,joint_offset"
LENGTHS = f"{ZEROS},link_geometry"


@pytest.mark.parametrize(
    ("board", "lens", "fit", "said", "share"),
    [
        (1.0, 1.0, LENGTHS, "", 0.0),
        (1.012, 1.0, LENGTHS, "board", -1.19),
        # A gross error, which a search for mistakes of the data follows.
        (1.0, 0.97, ZEROS, "focal lengths", 3.09),
    ],
)
def test_a_wrong_board_and_a_wrong_lens_are_named(
    board: float, lens: float, fit: str, said: str, share: float, tmp_path: Path
) -> None:
    lines = (SAMPLE / "points.csv").read_text().splitlines()
    rows = [*csv.DictReader(line for line in lines if line[0] != "#")]
    photos = [*dict.fromkeys(row["pose"] for row in rows)][::3]
    rows = [row for row in rows if row["pose"] in photos][::2]
    with open(tmp_path / "points.csv", "w", newline="") as stream:
        table = csv.DictWriter(stream, rows[0])
        table.writeheader()
        sizes = ("board_x_mm", "board_y_mm")
        table.writerows({**row, **{name: board * float(row[name]) for name in sizes}} for row in rows)
    camera = yaml.safe_load((SAMPLE / "camera.yaml").read_text())
    camera |= {name: lens * camera[name] for name in ("fx", "fy")}
    (tmp_path / "camera.yaml").write_text(yaml.safe_dump(camera))
    poses = PoseFile(tmp_path / "points.csv", camera=tmp_path / "camera.yaml")
    found = [text for text in robacc.calibrate(poses, robot="ur10", fit=fit).warnings if "the images fit" in text]
    assert len(found) == bool(said)
    for text in found:
        amount, _, std = text.removeprefix(f"the images fit {'a ' * (said == 'board')}{said} ").split(" ")[:3]
        # One step of a fit with a wrong size is off by its square.
        assert float(amount) == pytest.approx(abs(share), abs=max(float(std), 0.1 + share**2 / 100.0))
        assert ("smaller" in text or "shorter" in text) == (share < 0.0)


def test_two_links_that_are_longer_are_no_smaller_board(tmp_path: Path) -> None:
    """Both long links are 3 mm longer than in this file, and no other length: priors hold the others, not the board."""
    text = resources.files("robacc").joinpath("data/robots/ur10.yaml").read_text()
    text = text.replace("a: -612,", "a: -608.7,").replace("a: -572.3,", "a: -569.7,")
    arm = saved(tmp_path / "arm.yaml", text)
    poses = PoseFile(SAMPLE / "points.csv", camera=SAMPLE / "camera.yaml")
    assert not any("the images fit" in text for text in robacc.calibrate(poses, robot=arm).warnings)
