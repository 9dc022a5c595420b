"""Photos of printed boards: an arm's zeros from the pixels themselves, and what is said of photos without the board."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from boards import BOARDS, CAMERA, cv2, photos, printed
from commands import missing, run
from independent_arm import robot

import robacc
from robacc import InputError, PoseFile, UsageError
from robacc_plugins.boards import Board, page_of

ZEROS = np.array([0.0, 6e-3, -5e-3, 4e-3, 5e-3, 0.0])
"""Errors of the joint zeros, rad."""


def taken(folder: Path, kind: str, count: int) -> PoseFile:
    """A folder of photos with the joints in a table beside it, and the files of the board and the camera."""
    joints, pictures = photos(kind, count, tuple(ZEROS))
    (folder / "photos").mkdir()
    lines = ["pose,q1,q2,q3,q4,q5,q6"]
    for number, (q, picture) in enumerate(zip(joints.tolist(), pictures, strict=True), 1):
        cv2.imwrite(str(folder / "photos" / f"IMG_{number}.png"), picture)
        lines.append(f"IMG_{number},{','.join(map(repr, q))}")
    (folder / "joints.csv").write_text("\n".join(lines) + "\n")
    (folder / "board.yaml").write_text(BOARDS[kind])
    (folder / "camera.yaml").write_text(CAMERA)
    files = {name: folder / f"{name}.yaml" for name in ("board", "camera")}
    return PoseFile(folder / "photos", commanded=folder / "joints.csv", **files)


@pytest.mark.parametrize("kind", [*BOARDS])
def test_photos_show_the_joint_zeros(kind: str, tmp_path: Path) -> None:
    path = taken(tmp_path, kind, 10)
    result = robacc.calibrate(path, robot=robot(), fit="base_frame,tool_frame,joint_offset")
    assert any("10 of 10 photos show the board" in warning for warning in result.warnings)
    values = {parameter.name: parameter for parameter in result.parameters}
    for number in (2, 3, 4, 5):
        assert values[f"joint_offset.j{number}"].value == pytest.approx(ZEROS[number - 1], abs=5e-4)


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


def test_bad_photos_are_named_with_what_they_show_and_cost_only_themselves(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, aruco = taken(tmp_path, "charuco", 6), cv2.aruco
    monkeypatch.chdir(tmp_path)
    good = robacc.estimate(path, robot=robot())
    right = cv2.resize(printed("charuco"), (600, 420), interpolation=cv2.INTER_AREA)
    others = {"mirrored": right[:, ::-1], "moved": cv2.blur(right, (31, 1)), "wall": np.full((420, 600), 200, np.uint8)}
    for name, dictionary, first in (("numbers", aruco.DICT_4X4_50, 20), ("family", aruco.DICT_6X6_50, 0)):
        known = aruco.getPredefinedDictionary(dictionary)
        other = aruco.CharucoBoard((6, 4), 0.03, 0.022, known, np.arange(first, first + 12))
        others[name] = other.generateImage((600, 420), marginSize=30)
    for name, picture in others.items():
        cv2.imwrite(f"photos/{name}.png", picture)
    Path("photos/text.jpg").write_bytes(b"no photo")
    path.reading = replace(path.reading, contact_sheet="sheet.png")
    result = robacc.estimate(path, robot=robot())
    assert (good.data.place(2), result.n_poses) == ("photo IMG_3", 6)
    assert result.position.rms == pytest.approx(good.position.rms, rel=1e-9)
    warning = next(text for text in result.warnings if "left out" in text)
    expected = ("mirrored: mirrored print", "moved: blurred", "wall: no board", "text: no image")
    of_markers = (
        "numbers: another board (markers 20 to 31, expected 0 to 11)",
        "family: another board (markers of DICT_6X6)",
    )
    assert not missing(warning, *expected, *of_markers)
    # The second row of the sheet, of five: the board, and two others, a mirrored and a moved one.
    assert len(np.unique(cv2.imread("sheet.png")[253, 1::260], axis=0)) == 4
    assert "the photos of one folder" in run("trace", "a", "b", "--robot", "ur5", "--contact-sheet", "s.png").stderr
    with pytest.raises(UsageError, match=r"ends in .jpg or .png, found 'sheet.pdf'"):
        robacc.read_poses(PoseFile("photos", board="board.yaml", contact_sheet="sheet.pdf"))


def test_a_photo_counts_as_the_chip_saw_it_and_another_size_is_of_another_lens(tmp_path: Path) -> None:
    path = taken(tmp_path, "charuco", 7)
    upright = robacc.estimate(path, robot=robot())
    first, second, third, fourth, *_ = sorted((tmp_path / "photos").iterdir())
    content = cv2.imencode(".jpg", cv2.imread(str(first)), [cv2.IMWRITE_JPEG_QUALITY, 100])[1].tobytes()
    # Exif with nothing but an orientation: a quarter of a turn.
    turned = b"Exif\0\0II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0"
    first.with_suffix(".jpg").write_bytes(content[:2] + b"\xff\xe1\0\x22" + turned + content[2:])
    first.unlink()
    cv2.imwrite(str(second), cv2.imread(str(second))[:, 20:])
    third.rename(third.with_suffix(".HEIC"))
    cv2.imwrite(str(fourth), 16 * cv2.imread(str(fourth), cv2.IMREAD_GRAYSCALE).astype(np.uint16))
    result = robacc.estimate(path, robot=robot())
    expected = f"{second.stem}: another size (1260 x 960 px, most have 1280 x 960)", f"does not read {third.stem}.HEIC"
    assert not missing("\n".join(result.warnings), *expected)
    assert (result.n_poses, result.position.rms) == (5, pytest.approx(upright.position.rms, rel=1.0))


def test_the_contact_sheet_shows_what_the_fit_leaves_of_each_photo(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    taken(tmp_path, "charuco", 12)
    robacc.write_robot(tmp_path / "arm.yaml", robot())
    Path("others").mkdir()
    for photo in sorted(Path("photos").iterdir())[:4]:
        photo.rename(Path("others") / photo.name)
    files = ("--joints", "joints.csv", "--board", "board.yaml", "--camera", "camera.yaml", "--robot", "arm.yaml")
    assert run("estimate", "photos", *files, "--contact-sheet", "plain.png").exit_code == 0
    done = run("calibrate", "photos", *files, "--holdout", "others", "--contact-sheet", "sheet.png", "--fit", FIT)
    assert done.exit_code == 0, done.stderr
    plain, sheet, other = (cv2.imread(f"{name}.png") for name in ("plain", "sheet", "sheet-holdout"))
    # Four photos across of eight, three of four: the held-out ones have a sheet of their own.
    assert (sheet.shape, other.shape) == (plain.shape, (plain.shape[0], 3 * 260, 3))
    assert (plain != sheet).any(axis=(1, 2)).nonzero()[0].min() > 192  # below the photos only


def test_an_interrupt_says_that_the_sheet_was_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    taken(tmp_path, "charuco", 4)
    robacc.write_robot(tmp_path / "arm.yaml", robot())

    def interrupted(*arguments: object, **options: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("robacc.api.accuracy.estimate_errors", interrupted)
    files = ("--joints", "joints.csv", "--board", "board.yaml", "--camera", "camera.yaml", "--robot", "arm.yaml")
    assert run("estimate", "photos", *files).stderr.endswith("interrupted; nothing was written\n")
    done = run("estimate", "photos", *files, "--contact-sheet", "sheet.png")
    assert (done.exit_code, Path("sheet.png").exists()) == (130, True)
    assert done.stderr.endswith("interrupted; sheet.png was written, nothing else\n")


FIT = "base_frame,tool_frame,joint_offset"


def test_photos_of_another_size_than_the_lens_are_refused(tmp_path: Path) -> None:
    path = taken(tmp_path, "charuco", 5)
    (tmp_path / "camera.yaml").write_text(CAMERA + "size: [1280, 960]\n")
    assert robacc.estimate(path, robot=robot()).n_poses == 5
    for size, fix in (("[1920, 1440]", "multiply fx, fy, cx, cy and size by 0.666667"), ("[1920, 1080]", "")):
        (tmp_path / "camera.yaml").write_text(CAMERA + f"size: {size}\n")
        with pytest.raises(InputError) as caught:
            robacc.estimate(path, robot=robot())
        (problem,) = caught.value.problems
        stated = size.strip("[]").replace(", ", " x ")
        assert f"the photos are 1280 x 960 px, the camera file states {stated} px" in problem.message
        assert ("multiply" in str(problem.fix)) == bool(fix)
        assert fix in str(problem.fix)


def test_each_camera_has_a_folder_and_a_lens_of_its_own(tmp_path: Path) -> None:
    path = taken(tmp_path, "charuco", 14)
    folder = tmp_path / "photos"
    for number, photo in enumerate(sorted(folder.iterdir())):
        own = folder / ("left" if number % 2 else "right")
        own.mkdir(exist_ok=True)
        picture = cv2.imread(str(photo))
        # The right camera has fewer pixels.
        cv2.imwrite(str(own / photo.name), picture if number % 2 else cv2.resize(picture, None, fx=0.75, fy=0.75))
        photo.unlink()
    lens = yaml.safe_load(CAMERA)
    fewer = {**lens, "fx": 750, "fy": 750, "cx": 479.5, "cy": 359.5, "size": [960, 720]}
    cameras = {"cameras": {"left": {**lens, "size": [1280, 960]}, "right": fewer}}
    (tmp_path / "camera.yaml").write_text(yaml.safe_dump(cameras))
    result = robacc.calibrate(path, robot=robot(), fit=FIT)
    assert any("14 of 14 photos show the board" in warning for warning in result.warnings)
    assert any("camera left: " in warning for warning in result.warnings)
    values = {parameter.name: parameter for parameter in result.parameters}
    for number in (2, 3, 4, 5):
        found = values[f"joint_offset.j{number}"]
        assert found.value == pytest.approx(ZEROS[number - 1], abs=max(4.0 * (found.std or 0.0), 1.5e-3))
    assert result.fit.data.n == 3 * 14
    (tmp_path / "camera.yaml").write_text(yaml.safe_dump({"cameras": {"left": lens}}))
    with pytest.raises(InputError, match=r"found 'right', expected a camera of"):
        robacc.calibrate(path, robot=robot(), fit=FIT)


def test_what_is_lacking_is_said(tmp_path: Path) -> None:
    path = taken(tmp_path, "charuco", 2)
    with pytest.raises(UsageError, match="state the board that they show"):
        robacc.estimate(PoseFile(str(path), camera=tmp_path / "camera.yaml"), robot=robot())
    (tmp_path / "board.yaml").write_text(BOARDS["charuco"].replace("22", "40"))
    with pytest.raises(InputError, match="a size below square_mm"):
        robacc.estimate(path, robot=robot())
    (tmp_path / "board.yaml").write_text(BOARDS["charuco"].replace("4X4", "7X7"))
    with pytest.raises(InputError, match=r"none of 2 photos shows the board .* \(IMG_1, IMG_2: another board"):
        robacc.estimate(path, robot=robot())
    (tmp_path / "photos/IMG_1.jpg").touch()
    with pytest.raises(InputError, match=r"IMG_1.jpg and another photo have one name"):
        robacc.estimate(path, robot=robot())


def test_init_writes_a_board_in_true_size_and_its_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("matplotlib")
    monkeypatch.chdir(tmp_path)
    done = run("init", "--board", "8x5")
    assert done.exit_code == 0, done.stderr
    assert b"/MediaBox [ 0 0 841.8" in (tmp_path / "board.pdf").read_bytes().replace(b"[0", b"[ 0")
    square = yaml.safe_load((tmp_path / "board.yaml").read_text())["square_mm"]
    # Five pixels to the mm.
    page_of(8, 5, square, (297.0, 210.0)).savefig(tmp_path / "page.png", dpi=127)
    pixels, points = Board("board.yaml", cv2).seen_in(cv2.imread(str(tmp_path / "page.png"), cv2.IMREAD_GRAYSCALE))
    assert len(points) == 28
    across, along = ((np.linalg.norm(part - part[0], axis=1)) for part in (pixels, 1e3 * points))
    np.testing.assert_allclose(across, 5.0 * along, atol=0.5)
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
