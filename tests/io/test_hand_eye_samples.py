"""Samples of hand-eye calibrations, as MoveIt and easy_handeye2 save them: the camera on the hand or beside the arm."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from homogeneous import frame, shift, turn
from independent_arm import link_frames, robot
from sample_files import saved
from scipy.spatial.transform import Rotation

import robacc

TOOL = shift(0.03, 0.05, 0.08) @ turn(0, 0.4) @ turn(2, -1.2)
WORLD = shift(0.6, 0.1, 0.02) @ frame((0.0, 0.0, 0.0), (2.9, 0.1, 0.3))
NOISE = 0.5e-3
"""m and rad, of each measured pose."""


def samples(mount: str) -> tuple[np.ndarray, list[np.ndarray], list[np.ndarray]]:
    """Joints, poses of the hand in the base, and poses of the board in the camera."""
    generator = np.random.default_rng(2)
    joints = np.array([0.2, 0.3, -0.2, 0.3, 0.9, 0.1]) + generator.uniform(-0.6, 0.6, (30, 6))
    hands = [link_frames(q)[-1] for q in joints]
    seen = []
    for hand in hands:
        exact = np.linalg.inv(hand @ TOOL) @ WORLD if mount == "hand" else np.linalg.inv(WORLD) @ hand @ TOOL
        seen.append(exact @ frame(NOISE * generator.standard_normal(3), NOISE * generator.standard_normal(3)))
    return joints, hands, seen


def of_moveit(hands: list[np.ndarray], seen: list[np.ndarray]) -> object:
    return [
        {"effector_wrt_world": hand.ravel().tolist(), "object_wrt_sensor": board.ravel().tolist()}
        for hand, board in zip(hands, seen, strict=True)
    ]


def of_easy_handeye(hands: list[np.ndarray], seen: list[np.ndarray]) -> object:
    def transform(pose: np.ndarray) -> dict[str, object]:
        quaternion = Rotation.from_matrix(pose[:3, :3]).as_quat().tolist()
        translation = dict(zip("xyz", pose[:3, 3].tolist(), strict=True))
        return {"translation": translation, "rotation": dict(zip("xyzw", quaternion, strict=True))}

    pairs = zip(hands, seen, strict=True)
    return {"samples": [{"robot": transform(hand), "optical": transform(board)} for hand, board in pairs]}


@pytest.mark.parametrize("written", [of_moveit, of_easy_handeye])
@pytest.mark.parametrize("mount", ["hand", "world"])
def test_samples_give_the_error_at_the_first_call(written: object, mount: str, tmp_path: Path) -> None:
    _, hands, seen = samples(mount)
    path = saved(tmp_path / "samples.yaml", yaml.safe_dump(written(hands, seen)))
    result = robacc.estimate(path)
    assert result.n_poses == 30
    # Three components of noise, and on the hand the noise of the angles over the distance of the board.
    assert 1e-3 * 0.5 < result.position.rms < 1.6e-3
    assert any("camera on the hand" in warning for warning in result.warnings) == (mount == "hand")


def test_joint_states_of_moveit_give_the_joints(tmp_path: Path) -> None:
    joints, hands, seen = samples("hand")
    (tmp_path / "samples.yaml").write_text(yaml.safe_dump(of_moveit(hands, seen)))
    states = {"joint_names": [f"j{i}" for i in range(1, 7)], "joint_values": joints.tolist()}
    (tmp_path / "joints.yaml").write_text(yaml.safe_dump(states))
    (tmp_path / "camera.yaml").write_text("mount: hand\n")
    stated = {"commanded": tmp_path / "joints.yaml", "camera": tmp_path / "camera.yaml"}
    result = robacc.estimate(robacc.PoseFile(tmp_path / "samples.yaml", **stated), robot=robot())
    assert 1e-3 * 0.5 < result.position.rms < 1.6e-3


def folders(tmp_path: Path, mount: str) -> None:
    """A file for each pose, as scripts beside a robot's driver write them: joints, the hand, the board by OpenCV."""
    for i, (q, hand, board) in enumerate(zip(*samples(mount), strict=True)):
        folder = tmp_path / f"pose_{i}"
        folder.mkdir()
        rvec, tvec = Rotation.from_matrix(board[:3, :3]).as_rotvec(), board[:3, 3]
        record = {
            "joint_pose": q.tolist(),
            "O_T_EE": hand.T.ravel().tolist(),  # by columns
            "camera_intrinsics": [[634.6, 0.0, 641.9], [0.0, 634.1, 359.0], [0.0, 0.0, 1.0]],
            "T_cam_target_rvec": rvec[:, None].tolist(),
            "T_cam_target_tvec": tvec[:, None].tolist(),
        }
        saved(folder / "data.json", json.dumps(record))


@pytest.mark.parametrize("mount", ["hand", "world"])
def test_a_folder_with_a_file_for_each_pose_is_a_table(mount: str, tmp_path: Path) -> None:
    folders(tmp_path, mount)
    result = robacc.estimate(str(tmp_path), robot=robot())
    assert result.n_poses == 30
    assert 1e-3 * 0.5 < result.position.rms < 1.6e-3
    assert result.data.pose[[2, 10]].tolist() == ["pose_2", "pose_10"]  # in the order of the numbers
    assert any("each file is a pose: 30 files, pose_0 to pose_29" in text for text in result.warnings)
    assert any("camera on the hand" in warning for warning in result.warnings) == (mount == "hand")


def test_records_beside_photos_are_read_where_no_board_is_stated(tmp_path: Path) -> None:
    folders(tmp_path, "hand")
    for folder in tmp_path.iterdir():
        saved(folder / "image.png", b"\x89PNG")
    assert robacc.estimate(str(tmp_path), robot=robot()).n_poses == 30


def test_matrices_in_files_of_text_are_the_commands(tmp_path: Path) -> None:
    _, hands, seen = samples("hand")
    (tmp_path / "poses").mkdir()
    for i, hand in enumerate(hands):
        np.savetxt(tmp_path / "poses" / f"pose_{i:03d}.txt", hand)
    boards = [{"rotation": board[:3, :3].tolist(), "translation": board[:3, 3].tolist()} for board in seen]
    measured = saved(tmp_path / "boards.yaml", yaml.safe_dump({"poses": boards}))
    stated = robacc.PoseFile(measured, commanded=tmp_path / "poses", units="m")
    assert 1e-3 * 0.5 < robacc.estimate(stated).position.rms < 1.6e-3
    hand_poses = [{"rotation": hand[:3, :3].tolist(), "translation": hand[:3, 3].tolist()} for hand in hands]
    commanded = saved(tmp_path / "hands.yaml", yaml.safe_dump({"poses": hand_poses}))
    assert 1e-3 * 0.5 < robacc.estimate(robacc.PoseFile(measured, commanded=commanded)).position.rms < 1.6e-3


def test_two_files_of_a_number_are_one_pose(tmp_path: Path) -> None:
    _, hands, seen = samples("world")
    for i, (hand, board) in enumerate(zip(hands, seen, strict=True)):
        np.savetxt(tmp_path / f"{i}_robotpose.txt", hand)
        np.savetxt(tmp_path / f"{i}_markerpose.txt", board)
    assert 1e-3 * 0.5 < robacc.estimate(robacc.PoseFile(tmp_path, units="m")).position.rms < 1.6e-3


def test_files_that_hold_no_poses_are_none_of_a_folder(tmp_path: Path) -> None:
    saved(tmp_path / "one.json", '{"joints": [0, 0, 0, 0, 0, 0]}')
    saved(tmp_path / "a.txt", "1 2 3\n")
    saved(tmp_path / "b.json", "{")
    with pytest.raises(robacc.InputError, match="is a folder, expected a file"):
        robacc.read_poses(str(tmp_path))


def test_joints_in_a_file_of_their_own_belong_to_the_matrix_of_their_number(tmp_path: Path) -> None:
    for i, (q, _, board) in enumerate(zip(*samples("world"), strict=True)):
        np.savetxt(tmp_path / f"{i:03d}.csv", board)
        np.savetxt(tmp_path / f"{i:03d}_joints.txt", q)
    result = robacc.estimate(tmp_path, robot=robot(), align="base_frame,tool_frame")
    assert result.n_poses == 30
    assert 1e-3 * 0.5 < result.position.rms < 1.6e-3


@pytest.mark.timeout(100)
def test_long_lines_of_a_log_are_read_once(tmp_path: Path) -> None:
    _, hands, seen = samples("hand")
    text = "".join(
        f"Robot pose\n{matrix_text(hand)}Camera pose\n{matrix_text(board)}"
        for hand, board in zip(hands, seen, strict=True)
    )
    result = robacc.estimate(saved(tmp_path / "log.txt", f"{text}{'word ' * 100_000}\n{'1' * 100_000}\n"))
    assert result.n_poses == 30


def matrix_text(pose: np.ndarray) -> str:
    return "".join(" ".join(f"{value:.9f}" for value in row) + "\n" for row in pose)
