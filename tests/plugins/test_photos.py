"""Photos of printed boards, drawn by OpenCV's warp of the flat board: an arm's zeros from the pixels themselves."""

from pathlib import Path

import numpy as np
import pytest
import yaml
from commands import run
from homogeneous import shift, turn
from independent_arm import link_frames, robot

import robacc
from robacc.errors import InputError, UsageError
from robacc.poses.reading import PoseFile
from robacc_plugins.photos import Board, page_of

cv2 = pytest.importorskip("cv2")

ZEROS = np.array([0.0, 12e-3, -10e-3, 8e-3, 10e-3, 0.0])
"""Errors of the joint zeros, rad."""
MIDDLE = np.array([0.2, 0.3, -0.2, 0.3, 0.9, 0.1])
REACH = np.array([0.4, 0.4, 0.4, 0.8, 0.6, 0.8])
TOOL = shift(0.05, -0.03, 0.12) @ turn(2, 0.4)
AHEAD = shift(-0.09, -0.06, 0.55) @ turn(0, 0.3)
"""The board in the camera, in the middle."""
BASE = np.linalg.inv(AHEAD) @ np.linalg.inv(link_frames(MIDDLE + ZEROS)[-1] @ TOOL)
CAMERA = "fx: 1000\nfy: 1000\ncx: 639.5\ncy: 479.5\nmount: hand\n"
LENS = np.array([[1000.0, 0.0, 639.5], [0.0, 1000.0, 479.5], [0.0, 0.0, 1.0]])
SIZE = (1280, 960)
SCALE = 10
"""Pixels of the print to the mm."""
BOARDS = {
    "charuco": "type: charuco\nsquares: [6, 4]\nsquare_mm: 30\nmarker_mm: 22\ndictionary: DICT_4X4_50\n",
    "apriltag": "type: apriltag\nsquares: [4, 3]\nsquare_mm: 45\nmarker_mm: 35\ndictionary: DICT_APRILTAG_36h11\n",
    "chessboard": "type: chessboard\nsquares: [8, 5]\nsquare_mm: 22\n",
}


def printed(kind: str) -> np.ndarray:
    """Picture of the board with a margin of 10 mm; its origin is the board's."""
    if kind == "chessboard":
        squares = np.add.outer(np.arange(5), np.arange(8)) % 2 * 255
        picture = np.kron(squares, np.ones((22 * SCALE, 22 * SCALE))).astype(np.uint8)
    elif kind == "charuco":
        known = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
        picture = cv2.aruco.CharucoBoard((6, 4), 0.03, 0.022, known).generateImage((180 * SCALE, 120 * SCALE))
    else:
        known = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
        picture = cv2.aruco.GridBoard((4, 3), 0.035, 0.01, known).generateImage((170 * SCALE, 125 * SCALE))
    return np.pad(picture, 10 * SCALE, constant_values=255)


def taken(folder: Path, kind: str, count: int) -> PoseFile:
    """A folder of photos with the joints in a table beside it, and the files of the board and the camera."""
    generator, picture = np.random.default_rng(4), printed(kind)
    photos = folder / "photos"
    photos.mkdir()
    lines = ["pose,q1,q2,q3,q4,q5,q6"]
    # From a pixel of the print, whose corners lie half a pixel outside of its middle, to m on the board.
    on_board = np.array([[1.0, 0.0, 0.5 - 10 * SCALE], [0.0, 1.0, 0.5 - 10 * SCALE], [0.0, 0.0, 1e3 * SCALE]])
    while len(lines) <= count:
        q = MIDDLE + REACH * generator.uniform(-1.0, 1.0, 6)
        board = np.linalg.inv(BASE @ link_frames(q + ZEROS)[-1] @ TOOL)
        corners = board[:3, :3] @ np.array([(x, y, 0.0) for x in (0.0, 0.2) for y in (0.0, 0.13)]).T + board[:3, 3:]
        pixels = LENS @ corners / corners[2]
        if (
            corners[2].min() > 0.3
            and board[2, 2] > 0.6
            and np.all((pixels[:2].T > 30) & (np.array(SIZE) - 30 > pixels[:2].T))
        ):
            warp = LENS @ board[:3][:, [0, 1, 3]] @ on_board
            photo = cv2.warpPerspective(picture, warp, SIZE, flags=cv2.INTER_AREA, borderValue=255)
            name = f"IMG_{len(lines)}"
            cv2.imwrite(str(photos / f"{name}.png"), cv2.GaussianBlur(photo, (0, 0), 0.8))
            lines.append(f"{name},{','.join(map(repr, q.tolist()))}")
    (folder / "joints.csv").write_text("\n".join(lines) + "\n")
    (folder / "board.yaml").write_text(BOARDS[kind])
    (folder / "camera.yaml").write_text(CAMERA)
    files = {name: folder / f"{name}.yaml" for name in ("board", "camera")}
    return PoseFile(photos, commanded=folder / "joints.csv", **files)


@pytest.mark.parametrize("kind", [*BOARDS])
def test_photos_show_the_joint_zeros(kind: str, tmp_path: Path) -> None:
    path = taken(tmp_path, kind, 14)
    result = robacc.calibrate(path, robot=robot(), fit="base_frame,tool_frame,joint_offset")
    assert any("14 of 14 photos show the board" in warning for warning in result.warnings)
    values = {parameter.name: parameter for parameter in result.parameters}
    for number in (2, 3, 4, 5):
        found = values[f"joint_offset.j{number}"]
        assert found.value == pytest.approx(ZEROS[number - 1], abs=max(4.0 * (found.std or 0.0), 1e-3))


def test_the_command_takes_a_folder_of_photos(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    taken(tmp_path, "charuco", 6)
    robacc.write_robot(tmp_path / "arm.yaml", robot())
    arguments = ["estimate", "photos", "--joints", "joints.csv", "--board", "board.yaml", "--camera", "camera.yaml"]
    done = run(*arguments, "--robot", "arm.yaml")
    assert done.exit_code == 0, done.stderr
    assert "Error of 6 measured poses" in done.stdout


@pytest.mark.parametrize("form", ["image,photos/{}.png", "filename,{}.PNG", "id,{number}", ""])
def test_joints_are_joined_however_the_photos_are_named(form: str, tmp_path: Path) -> None:
    path = taken(tmp_path, "charuco", 6)
    head, *rows = (tmp_path / "joints.csv").read_text().splitlines()
    name, _, entry = form.partition(",")
    lines = [",".join(filter(None, (name, head.partition(",")[2])))]
    for number, row in enumerate(rows, 1):
        photo, _, joints = row.partition(",")
        lines.append(",".join(filter(None, (entry.format(photo, number=number), joints))))
    (tmp_path / "joints.csv").write_text("\n".join(lines) + "\n")
    result = robacc.estimate(path, robot=robot())
    assert result.n_poses == 6
    assert result.position.rms < 5e-3


def test_the_number_of_joints_is_compared_with_that_of_photos(tmp_path: Path) -> None:
    path = taken(tmp_path, "charuco", 6)
    rows = [line.partition(",")[2] for line in (tmp_path / "joints.csv").read_text().splitlines()]
    (tmp_path / "joints.csv").write_text("\n".join(rows[:5]) + "\n")
    with pytest.raises(InputError, match=r"found 6 measured poses \(\d+ rows\) and 4 commands"):
        robacc.estimate(path, robot=robot())


def test_a_photo_without_the_board_is_named(tmp_path: Path) -> None:
    path = taken(tmp_path, "charuco", 6)
    cv2.imwrite(str(tmp_path / "photos" / "IMG_3.png"), np.full((960, 1280), 200, np.uint8))
    result = robacc.estimate(path, robot=robot())
    assert result.n_poses == 5
    assert any("5 of 6 photos show the board (not: IMG_3.png)" in warning for warning in result.warnings)


def test_what_is_lacking_is_said(tmp_path: Path) -> None:
    path = taken(tmp_path, "charuco", 2)
    with pytest.raises(UsageError, match="state the board that they show"):
        robacc.estimate(PoseFile(str(path), camera=tmp_path / "camera.yaml"), robot=robot())
    (tmp_path / "board.yaml").write_text(BOARDS["charuco"].replace("22", "40"))
    with pytest.raises(InputError, match="a size below square_mm"):
        robacc.estimate(path, robot=robot())
    (tmp_path / "board.yaml").write_text(BOARDS["charuco"].replace("4X4", "7X7"))
    with pytest.raises(InputError, match="none of 2 photos shows the board"):
        robacc.estimate(path, robot=robot())
    (tmp_path / "photos" / "IMG_1.png").write_bytes(b"no photo")
    with pytest.raises(InputError, match=r"IMG_1.png: is no photo that OpenCV can read"):
        robacc.estimate(path, robot=robot())


def test_init_writes_a_board_in_true_size_and_its_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("matplotlib")
    monkeypatch.chdir(tmp_path)
    done = run("init", "--board", "8x5")
    assert done.exit_code == 0, done.stderr
    assert b"/MediaBox [ 0 0 841.8" in (tmp_path / "board.pdf").read_bytes().replace(b"[0", b"[ 0")
    square = yaml.safe_load((tmp_path / "board.yaml").read_text())["square_mm"]
    # Ten pixels to the mm.
    page_of(8, 5, square, (297.0, 210.0)).savefig(tmp_path / "page.png", dpi=254)
    pixels, points = Board("board.yaml", cv2).seen_in(cv2.imread(str(tmp_path / "page.png"), cv2.IMREAD_GRAYSCALE))
    assert len(points) == 28
    across, along = ((np.linalg.norm(part - part[0], axis=1)) for part in (pixels, 1e3 * points))
    np.testing.assert_allclose(across, 10.0 * along, atol=1.0)
    assert run("init", "--board", "8x5").exit_code == 2
    assert "expected two numbers" in run("init", "--board", "8", "--folder", "other").stderr


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("[8, 5]", "[7, 5]"), "looks the same when it is turned by half"),
        (("[8, 5]", "[8.5, 5]"), "expected whole numbers from 4 to 100, found 8.5, 5"),
        (("[8, 5]", "[100000, 3]"), "expected whole numbers from 4 to 100"),
        (("chessboard", "charuco\nmarker_mm: 15\ndictionary: DICT_4X4_50\nother: 1"), "other"),
        (
            ("chessboard\nsquares: [8, 5]", "charuco\nmarker_mm: 15\ndictionary: DICT_4X4_50\nsquares: [20, 9]"),
            "90 markers",
        ),
    ],
)
def test_a_wrong_board_is_refused(change: tuple[str, str], message: str, tmp_path: Path) -> None:
    (tmp_path / "board.yaml").write_text(BOARDS["chessboard"].replace(*change))
    with pytest.raises(InputError) as caught:
        Board(str(tmp_path / "board.yaml"), cv2)
    assert message in str(caught.value)


def test_a_chessboard_is_numbered_from_its_black_corner_however_it_is_turned(tmp_path: Path) -> None:
    (tmp_path / "board.yaml").write_text(BOARDS["chessboard"])
    board, picture = Board(str(tmp_path / "board.yaml"), cv2), printed("chessboard")[::2, ::2]
    upright, points = board.seen_in(picture)
    turned, same = board.seen_in(picture[::-1, ::-1].copy())
    np.testing.assert_array_equal(points, same)
    np.testing.assert_allclose(turned, np.array(picture.shape[::-1]) - 1 - upright, atol=0.5)
