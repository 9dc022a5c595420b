"""Points of a board in photos: camera on the hand and beside the arm; arm and camera simulated independently."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from commands import run
from homogeneous import shift, turn
from independent_arm import DECLARED, link_frames, robot

import robacc
from robacc.api.inputs import with_measured_targets
from robacc.effects.base import effect_class
from robacc.errors import InputError
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.poses.cameras import Camera, three_points
from robacc.poses.reading import PoseFile

ZEROS = np.array([0.0, 6e-3, -5e-3, 4e-3, 5e-3, 0.0])
"""Errors of the joint zeros, rad."""
MIDDLE = np.array([0.2, 0.3, -0.2, 0.3, 0.9, 0.1])
"""Joints about which the photos are taken, rad."""
REACH = np.array([0.4, 0.4, 0.4, 0.8, 0.6, 0.8])
TOOL = shift(0.05, -0.03, 0.12) @ turn(2, 0.4) @ turn(0, 0.3)
"""The board, or the camera, on the last link."""
AHEAD = shift(-0.08, -0.06, 0.7) @ turn(0, 0.3)
"""The board in the camera, in the middle."""
BOARD = np.array([(x, y, 0.0) for y in np.arange(4) * 0.04 for x in np.arange(5) * 0.04]).T
FOCAL, CENTRE, DISTORTION = np.array([1400.0, 1410.0]), np.array([960.0, 540.0]), (-0.12, 0.05, 1e-3, -5e-4, 0.01)
LENS = f"fx: 1400\nfy: 1410\ncx: 960\ncy: 540\ndistortion: {list(DISTORTION)}\nsize: [1920, 1080]\n"
Photo = tuple[np.ndarray, np.ndarray]


def image(points: np.ndarray) -> np.ndarray:
    """Pixels (2, K) of points (3, K) before the camera: a pinhole and the distortion of Brown (1971)."""
    x, y = points[:2] / points[2]
    k1, k2, p1, p2, k3 = DISTORTION
    r = x * x + y * y
    radial = 1 + k1 * r + k2 * r**2 + k3 * r**3
    moved = np.stack(
        (x * radial + 2 * p1 * x * y + p2 * (r + 2 * x * x), y * radial + p1 * (r + 2 * y * y) + 2 * p2 * x * y)
    )
    return FOCAL[:, None] * moved + CENTRE[:, None]


def base_of(mount: str) -> np.ndarray:
    """The arm's base in the board, or in the camera."""
    at_hand = np.linalg.inv(AHEAD) if mount == "hand" else AHEAD
    return at_hand @ np.linalg.inv(link_frames(MIDDLE + ZEROS)[-1] @ TOOL)


@cache
def photos(mount: str, count: int, number: int = 1) -> tuple[Photo, ...]:
    """Joints (6,) and exact pixels (2, K) of photos in which the whole board is seen, by the camera of a number."""
    generator, found = np.random.default_rng(number), []
    aside = shift(0.05, -0.04, 0.1) @ turn(2, 0.5) if number > 1 else np.eye(4)
    base = base_of(mount)
    while len(found) < count:
        q = MIDDLE + REACH * generator.uniform(-1.0, 1.0, 6)
        target = base @ link_frames(q + ZEROS)[-1] @ TOOL
        board = np.linalg.inv(target @ aside) if mount == "hand" else aside @ target
        points = board[:3, :3] @ BOARD + board[:3, 3:]
        if points[2].min() > 0.3 and board[2, 2] > 0.5:
            pixels = image(points)
            if np.all((pixels > 0) & (pixels < 2 * CENTRE[:, None])):
                found.append((q, pixels))
    return tuple(found)


COLUMNS = "pose,q1,q2,q3,q4,q5,q6,board_x_mm,board_y_mm,u_px,v_px"


def lines(taken: tuple[Photo, ...], noise: float, seed: int = 5) -> Iterator[str]:
    """The rows of a pose file, one for each point."""
    generator = np.random.default_rng(seed)
    for number, (q, pixels) in enumerate(taken):
        joints = ",".join(map(repr, q.tolist()))
        seen = pixels + noise * generator.standard_normal(pixels.shape)
        for (x, y, _), (u, v) in zip(1e3 * BOARD.T, seen.T.tolist(), strict=True):
            yield f"p{number},{joints},{x:.6f},{y:.6f},{u!r},{v!r}"


def written(folder: Path, mount: str, count: int = 30, noise: float = 0.0, lens: str = LENS) -> PoseFile:
    camera, path = folder / "camera.yaml", folder / "points.csv"
    camera.write_text(f"{lens}mount: {mount}\n")
    path.write_text("\n".join([COLUMNS, *lines(photos(mount, count), noise)]) + "\n")
    return PoseFile(path, camera=camera)


@pytest.mark.parametrize("mount", ["hand", "world"])
def test_exact_pixels_give_exact_zeros_and_the_place_of_all(mount: str, tmp_path: Path) -> None:
    result = robacc.calibrate(written(tmp_path, mount), robot=robot(), fit="tool_frame,joint_offset")
    values = {parameter.name: parameter.value for parameter in result.parameters}
    for number in (2, 3, 4, 5):
        assert values[f"joint_offset.j{number}"] == pytest.approx(ZEROS[number - 1], abs=1e-8)
    places = (result.robot.tool, TOOL), (result.robot.base, base_of(mount))
    for place, true in places:
        np.testing.assert_allclose(place.pose.matrices(), true, atol=1e-8)
    assert result.after.held_out.position.rms < 1e-8


@pytest.mark.parametrize("mounts", [("world", "world"), ("hand", "hand"), ("hand", "world")], ids="+".join)
def test_two_cameras_show_the_zeros_together(mounts: tuple[str, str], tmp_path: Path) -> None:
    lens = LENS.replace("\n", "\n    ")
    cameras = "".join(f"  {name}:\n    {lens}mount: {mount}\n" for name, mount in zip("ab", mounts, strict=True))
    (tmp_path / "cameras.yaml").write_text(f"cameras:\n{cameras}")
    rows = [
        f"{name},{name}{line}"
        for number, (name, mount) in enumerate(zip("ab", mounts, strict=True), 1)
        for line in lines(photos(mount, 20, number), 0.0)
    ]
    (tmp_path / "points.csv").write_text("\n".join([f"camera,{COLUMNS}", *rows]) + "\n")
    path = PoseFile(tmp_path / "points.csv", camera=tmp_path / "cameras.yaml")
    result = robacc.calibrate(path, robot=robot(), fit="tool_frame,joint_offset")
    values = {parameter.name: parameter.value for parameter in result.parameters}
    for number in (2, 3, 4, 5):
        assert values[f"joint_offset.j{number}"] == pytest.approx(ZEROS[number - 1], abs=1e-8)
    assert result.after.held_out.position.rms < 1e-8


@pytest.mark.parametrize("mount", ["hand", "world"])
def test_noisy_pixels_give_intervals_that_hold(mount: str, tmp_path: Path) -> None:
    result = robacc.calibrate(written(tmp_path, mount, noise=0.2), robot=robot(), fit=DECLARED)
    parameters = {parameter.name: parameter for parameter in result.parameters}
    for number in (2, 3, 4, 5):
        found = parameters[f"joint_offset.j{number}"]
        assert found.std is not None
        assert found.std < 1e-3
        assert abs(found.value - ZEROS[number - 1]) < 3.5 * found.std
    assert any("600 of 600 points in 30 of 30 photos are 0.2 px" in warning for warning in result.warnings)


@pytest.mark.parametrize("mount", ["hand", "world"])
def test_estimate_has_the_errors_of_the_pose_in_mm(mount: str, tmp_path: Path) -> None:
    """Of the nominal arm they are those of exact poses; of the arm with its true zeros nothing remains."""
    q = np.array([joints for joints, _ in photos(mount, 30)]).T
    poses = np.array([base_of(mount) @ link_frames(joints + ZEROS)[-1] @ TOOL for joints in q.T])
    exact = Measurements(poses[:, :3, 3].T, np.moveaxis(poses[:, :3, :3], 0, 2), q=q)
    result, expected = (
        robacc.estimate(each, robot=robot(), align="base_frame,tool_frame")
        for each in (written(tmp_path, mount), exact)
    )
    assert result.n_poses == 30
    assert result.position.rms == pytest.approx(expected.position.rms, rel=1e-6)
    assert result.orientation.rms == pytest.approx(expected.orientation.rms, rel=1e-6)
    calibrated = robacc.calibrate(written(tmp_path, mount), robot=robot(), fit="tool_frame,joint_offset").robot
    left = robacc.estimate(written(tmp_path, mount), robot=calibrated, align="base_frame,tool_frame")
    assert left.position.rms < 1e-7
    assert left.orientation.rms < 1e-7


def test_trace_names_a_gear_that_photos_show(tmp_path: Path) -> None:
    path = written(tmp_path, "world", 70, 0.1)
    rows = Path(path).read_text().splitlines()
    for i, row in enumerate(rows[1:], 1):
        cells = row.split(",")
        # The joint stands where its gear takes it: the commanded angle differs by the gear's error.
        cells[3] = repr(float(cells[3]) - 1.5e-3 * math.sin(2.0 * float(cells[3]) + 0.4))
        rows[i] = ",".join(cells)
    Path(path).write_text("\n".join(rows) + "\n")
    result = robacc.trace(path, robot=robot(), declared=DECLARED)
    assert ("transmission_error", ("j3",)) in [(finding.effect, finding.joints) for finding in result.findings]


def test_photos_in_their_order_show_the_backlash_of_a_servo(tmp_path: Path) -> None:
    """Half a degree in the third joint, as servos of low-cost arms have it."""
    gap, taken, before = math.radians(0.5), [], MIDDLE
    for reached, pixels in photos("world", 64):
        # The joint stands where its gear leaves it: behind its command by the gap, on the side that it came from.
        q, side = reached.copy(), math.copysign(1.0, reached[2] - before[2])
        if abs(reached[2] - before[2]) > 2 * gap:
            q[2] -= gap * side
            taken.append((q, pixels))
            before = q
    path = written(tmp_path, "world")
    Path(path).write_text("\n".join([COLUMNS, *lines(tuple(taken), 0.2)]) + "\n")
    result = robacc.trace(path, robot=robot(), declared=DECLARED, ordered=True)
    (finding,) = result.findings
    assert (finding.effect, finding.joints) == ("backlash", ("j3",))
    (value,) = (parameter.value for parameter in result.parameters if parameter.name == "backlash.j3")
    assert value == pytest.approx(gap, rel=0.05)


def test_a_wrong_corner_is_left_out(tmp_path: Path) -> None:
    path = written(tmp_path, "hand", noise=0.1)
    rows = Path(path).read_text().splitlines()
    *cells, u, v = rows[47].split(",")
    rows[47] = ",".join([*cells, str(float(u) + 25.0), v])
    Path(path).write_text("\n".join(rows) + "\n")
    result = robacc.estimate(path, robot=robot())
    assert any("599 of 600 points" in warning for warning in result.warnings)


def test_the_photos_show_the_lens_if_the_file_does_not(tmp_path: Path) -> None:
    pytest.importorskip("cv2")
    path = written(tmp_path, "hand", lens="")
    result = robacc.calibrate(path, robot=robot(), fit="tool_frame,joint_offset")
    assert any("of 1400, 1410, 960, 540" in warning for warning in result.warnings)
    values = {parameter.name: parameter.value for parameter in result.parameters}
    for number in (2, 3, 4, 5):
        assert values[f"joint_offset.j{number}"] == pytest.approx(ZEROS[number - 1], abs=2e-5)


def test_derivatives_of_images_are_those_of_the_predictions() -> None:
    generator, n = np.random.default_rng(8), 12
    seen = np.concatenate((generator.uniform(-0.1, 0.1, (3, n)), np.full((1, n), 0.6)))
    kind = np.array(["image", "image from hand"] * 6)
    fixture = np.where(kind == "image", "camera", "board")
    q = (MIDDLE + REACH * generator.uniform(-1.0, 1.0, (n, 6))).T
    data = Measurements(np.zeros((3, n)), q=q, kind=kind, fixture=fixture, seen=seen)
    arm, _ = with_measured_targets(robot(), data)
    effects = [effect_class(name).default(Model.of(arm).arm, data) for name in DECLARED.split(",")]
    bound = Model.of(arm, effects).bind(data)
    theta = 1e-2 * generator.standard_normal(len(bound.terms))
    jacobian = bound.linearise(theta, rows=3)[1]
    near = np.abs(bound.poses(theta).translation).max(axis=0) < 3.0  # Others are seen at more than 75 degrees.
    assert near.sum() >= 6
    for column, step in enumerate(1e-6 * np.eye(theta.size)):
        difference = bound.poses(theta + step).translation - bound.poses(theta - step).translation
        np.testing.assert_allclose(jacobian[:, column, near], difference[:, near] / 2e-6, rtol=1e-6, atol=1e-7)


def test_rays_undo_the_lens() -> None:
    points = np.random.default_rng(2).uniform(-0.3, 0.3, (3, 50)) + np.array([[0.0], [0.0], [1.0]])
    camera = Camera(tuple(FOCAL), tuple(CENTRE), DISTORTION)
    np.testing.assert_allclose(camera.rays(image(points)), points[:2] / points[2], atol=1e-10)


def test_three_points_show_nearly_as_much_as_the_board() -> None:
    """Information of six numbers of a pose: of all points, and of three that count for as many."""
    points = np.random.default_rng(3).uniform(-0.06, 0.06, (3, 24)) * np.array([[1.0], [0.6], [0.0]])
    tilted = (turn(0, 0.5) @ turn(1, -0.3))[:3, :3]

    def information(of: np.ndarray) -> np.ndarray:
        def seen(step: np.ndarray) -> np.ndarray:
            small = shift(*step[:3]) @ turn(0, step[3]) @ turn(1, step[4]) @ turn(2, step[5])
            at = small[:3, :3] @ tilted @ of + small[:3, 3:] + np.array([[0.0], [0.0], [0.6]])
            return np.asarray((at[:2] / at[2]).ravel())

        slope = np.array([(seen(step) - seen(-step)) / 2e-6 for step in 1e-6 * np.eye(6)]).T
        return np.asarray(slope.T @ slope / of.shape[1])

    whole, three = information(points), information(three_points(points))
    ratio = np.linalg.eigvals(np.linalg.solve(whole, three)).real
    assert np.all((ratio > 0.5) & (ratio < 2.0))


@pytest.mark.parametrize(
    ("lens", "change", "message"),
    [
        ("fx: 1400\n", ("", ""), "camera.yaml:1, fy: is missing"),
        (LENS.replace("1400", "-1400"), ("", ""), "fx: found -1400, expected pixels, above 0 and below 1e+06"),
        (LENS.replace("-0.12", "900.0"), ("", ""), "the lens of the camera cannot show anything at this pixel"),
        (LENS, ("u_px", "u_pixel"), "images need the column u_px, which is missing"),
        (LENS, ("40.000000", "0.000000"), "no photo shows 4 points of a board that are not in a line"),
        (f"{LENS}cameras: {{a: {{mount: hand}}}}\n", ("", ""), "fx: stands beside cameras"),
        (LENS, ("120.000000", "x"), "board_x_mm: found 'x', expected a number"),
    ],
)
def test_bad_images_are_refused(lens: str, change: tuple[str, str], message: str, tmp_path: Path) -> None:
    path = written(tmp_path, "hand", 5, lens=lens)
    text = Path(path).read_text()
    if message.startswith("no photo"):
        rows = [row.split(",") for row in text.splitlines()]
        text = "\n".join(",".join([*row[:8], "0" if i else row[8], *row[9:]]) for i, row in enumerate(rows))
    else:
        text = text.replace(*change) if change[0] else text
    Path(path).write_text(text)
    with pytest.raises(InputError) as caught:
        robacc.calibrate(path, robot=robot())
    assert message in str(caught.value)


def test_the_command_asks_for_the_camera(tmp_path: Path) -> None:
    path, arm = written(tmp_path, "hand", 5), tmp_path / "arm.yaml"
    robacc.write_robot(arm, robot())
    done = run("estimate", str(path), "--robot", str(arm))
    assert done.exit_code == 3
    assert "images need the camera that took them" in done.stderr
    assert "--camera" in done.stderr
    done = run("estimate", str(path), "--robot", str(arm), "--camera", str(tmp_path / "camera.yaml"))
    assert done.exit_code == 0
    assert "Error of 5 measured poses" in done.stdout


def test_what_could_mislead_is_said(tmp_path: Path) -> None:
    path = written(tmp_path, "hand", 20, 0.1, LENS.replace("1400", "1250").replace("-0.12", "0.0"))
    result = robacc.estimate(path, robot=robot())
    assert any("px (rms) off the board" in warning and "check the lens" in warning for warning in result.warnings)
    path = written(tmp_path, "hand", 20, 0.1)
    rows = Path(path).read_text().splitlines()
    Path(path).write_text("\n".join([*rows, *rows[1:41]]) + "\n")
    result = robacc.estimate(path, robot=robot())
    assert result.n_poses == 20
    assert any("40 points repeat pixel and joints of earlier rows" in warning for warning in result.warnings)
    apart = tmp_path / "apart.csv"
    apart.write_text("\n".join(rows[:41]) + "\n")
    with pytest.raises(InputError, match="validation poses are also among the calibration poses"):
        robacc.calibrate(path, robot=robot(), holdout=PoseFile(apart, camera=tmp_path / "camera.yaml"))
    Path(path).write_text("\n".join(rows[:101] + rows[101:104]) + "\n")
    result = robacc.estimate(path, robot=robot())
    assert result.alignment is not None
    assert any("photos that do not show the board begin at line 102" in warning for warning in result.warnings)
