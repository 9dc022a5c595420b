"""Sets of data mistakes on an arm simulated without the package are named; what cannot be distinguished is said."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache

import independent_arm as arm
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from robacc.diagnostics.data_mistakes import Mistake, find_mistake
from robacc.measurements import Measurements

Matrix = np.ndarray


@cache
def made(n: int = 40, seed: int = 3) -> tuple[Matrix, Matrix, Matrix]:
    """Joints (6, n), positions (3, n) and orientations (3, 3, n) of an arm with zeros wrong by 3 mrad."""
    rng = np.random.default_rng(seed)
    low, high = np.array(arm.LIMITS).T
    q = rng.uniform(low, high, (n, 6))
    frames = np.array([arm.link_frames(row)[-1] for row in q + rng.normal(scale=3e-3, size=6)])
    base, shift = Rotation.from_euler("xyz", rng.uniform(-2, 2, 3)), rng.uniform(-3, 3, 3)
    position = base.apply((frames @ np.append(arm.TOOL, 1.0))[:, :3]) + shift + rng.normal(scale=5e-5, size=(n, 3))
    turned = base * Rotation.from_matrix(frames[:, :3, :3]) * Rotation.from_euler("xyz", [0.3, 0.2, 1.0])
    return q.T, position.T, np.moveaxis(turned.as_matrix(), 0, 2)


def judged(q: Matrix, position: Matrix, rotation: Matrix | None = None) -> Mistake:
    mistake = find_mistake(arm.robot(), Measurements(position=position, q=q, rotation=rotation))
    return mistake


def signs(joints: str) -> Matrix:
    return np.array([-1.0 if str(i + 1) in joints else 1.0 for i in range(6)])[:, None]


def interaction(q: Matrix, sign: float) -> Matrix:
    changed = q.copy()
    changed[2] += sign * q[1]
    return changed


def zero(q: Matrix, joint: int, degrees: float) -> Matrix:
    changed = q.copy()
    changed[joint - 1] += np.radians(degrees)
    return changed


@pytest.mark.parametrize("joints", ["14", "235", "2345"])
@pytest.mark.parametrize("oriented", [False, True])
def test_several_signs_together(joints: str, oriented: bool) -> None:
    q, position, rotation = made()
    mistake = judged(q * signs(joints), position, rotation if oriented else None)
    names = [f"j{number}" for number in joints]
    assert mistake.name == f"the signs of joints {', '.join(names[:-1])} and {names[-1]} seem to be reversed"
    assert mistake.after < 5e-3 < 0.1 < mistake.before


def test_the_mirrored_arm_is_not_distinguishable_from_a_left_handed_frame_without_orientations() -> None:
    # The arm is symmetric about its xz plane: with A1, A4 and A6 reversed it reaches the mirrored positions.
    q, position, rotation = made()
    texts = {"the positions seem to be in a left-handed frame", "the signs of joints j1, j4 and j6 seem to be reversed"}
    for mistake in (judged(q * signs("146"), position), judged(q, position * np.array([[1.0], [-1.0], [1.0]]))):
        assert {mistake.name, *mistake.alternatives} == texts
        assert "Not distinguishable on these poses: the signs of joints j1, j4 and j6" in mistake.text
    mistake = judged(q * signs("146"), position, rotation)
    assert mistake.name == "the signs of joints j1, j4 and j6 seem to be reversed"


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_interaction_that_was_not_undone(sign: float) -> None:
    q, position, _ = made()
    mistake = judged(interaction(q, sign), position)
    assert mistake.name == (
        f"the column of joint j3 seems to hold j3 {'+' if sign > 0 else '-'} j2 (interaction not removed)"
    )
    assert f"coupling: {{j2: {-sign:g}}}" in mistake.fix


Q, POSITION, _ = made()


@pytest.mark.parametrize(
    ("q", "texts"),
    [
        (
            interaction(Q, 1.0) * signs("14"),
            ("the signs of joints j1 and j4 seem to be reversed", "seems to hold j3 + j2"),
        ),
        (
            np.rad2deg(Q) * signs("14"),
            ("the signs of joints j1 and j4 seem to be reversed", "the joint columns seem to be in degrees"),
        ),
        (
            zero(zero(Q, 2, 90), 3, -90),
            (
                "joint j2 seems to count from a zero 90 degrees away; "
                "joint j3 seems to count from a zero 90 degrees away",
            ),
        ),
        (
            Q[[1, 2, 0, 3, 4, 5]],
            ("the joint columns seem to be in another order: they hold j2, j3, j1, j4, j5 and j6",),
        ),
    ],
    ids=["signs and an interaction", "signs and degrees", "zeros of two joints", "three columns in another order"],
)
def test_several_mistakes_of_the_joints(q: Matrix, texts: tuple[str, ...]) -> None:
    name = judged(q, POSITION).name
    assert all(text in name for text in texts)
    assert len(texts) == 2 or name == texts[0]


def as_matrices(rotation: Rotation) -> Matrix:
    return np.moveaxis(rotation.as_matrix(), 0, 2)


READINGS: dict[str, tuple[Callable[[Rotation], Rotation], str]] = {
    "inverse": (lambda r: r.inv(), "the orientations seem to be inverted"),
    "euler as rotation vector": (
        lambda r: Rotation.from_rotvec(r.as_euler("xyz")),
        "angles about the fixed axes x, y, z, read as a rotation vector",
    ),
    "rotation vector as euler": (lambda r: Rotation.from_euler("xyz", r.as_rotvec()), "rotation vectors, read as roll"),
    "moving axes": (lambda r: Rotation.from_euler("xyz", r.as_euler("XYZ")), "angles about the moving axes x, y, z"),
    "quaternion": (lambda r: Rotation.from_quat(r.as_quat()[:, [1, 2, 3, 0]]), "in the order x, y, z, w"),
}


@pytest.mark.parametrize("which", READINGS)
def test_orientations_read_wrongly(which: str) -> None:
    q, position, rotation = made()
    read, text = READINGS[which]
    mistake = judged(q, position, as_matrices(read(Rotation.from_matrix(np.moveaxis(rotation, 2, 0)))))
    assert text in mistake.name


def test_inverted_poses() -> None:
    q, position, rotation = made()
    inverse = np.swapaxes(rotation, 0, 1)
    mistake = judged(q, -np.einsum("ijn,jn->in", inverse, position), inverse)
    assert "the measured poses seem to be inverted" in mistake.name


def test_an_unseen_sign_is_said() -> None:
    # The target sits on the last axis, so that the sign of joint 6 moves nothing.
    rng = np.random.default_rng(0)
    low, high = np.array(arm.LIMITS).T
    q = rng.uniform(low, high, (30, 6))
    position = np.array([arm.target(row, np.array([0.0, 0.0, 0.1])) for row in q + 2e-3]).T
    mistake = judged(q.T * signs("2"), position)
    assert mistake.name == "the sign of joint j2 seems to be reversed"
    assert "These poses do not show the sign of j6" in mistake.text
