"""Conventions of angles: their rotations, and the trial that tells them apart without knowing any frame."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from pose_files import Reader, problem_texts
from scipy.spatial.transform import Rotation

from robacc.poses.reading import CONVENTIONS, is_ruled_out, try_conventions

SCIPY = {"fixed-xyz": "xyz", "zyx": "xyz", "moving-xyz": "XYZ", "kuka-abc": "ZYX", "zyz": "ZYZ"}
"""scipy's letters: small for fixed axes, capital for moving ones."""


@pytest.mark.parametrize("name", ["rotvec", *SCIPY])
def test_rotation_of_a_convention(name: str) -> None:
    angles = np.random.default_rng(1).uniform(-1.4, 1.4, (3, 20))
    expected = Rotation.from_rotvec(angles.T) if name == "rotvec" else Rotation.from_euler(SCIPY[name], angles.T)
    np.testing.assert_allclose(np.moveaxis(CONVENTIONS[name](angles), -1, 0), expected.as_matrix(), atol=1e-12)


def test_orders_of_a_quaternion() -> None:
    turns = Rotation.random(20, random_state=1)
    for name, shift in (("xyzw", 0), ("wxyz", 1)):
        rotation = CONVENTIONS[name](np.roll(turns.as_quat(), shift, axis=1).T)
        np.testing.assert_allclose(np.moveaxis(rotation, -1, 0), turns.as_matrix(), atol=1e-12)


DISTINCT = ("rotvec", "fixed-xyz", "moving-xyz", "kuka-abc", "zyz")


@pytest.mark.parametrize("truth", DISTINCT)
def test_the_data_show_their_convention_in_unknown_frames(truth: str) -> None:
    rng = np.random.default_rng(2)
    angles = rng.uniform(-1.5, 1.5, (3, 40))
    base, tool = Rotation.random(2, random_state=3).as_matrix()
    known = np.einsum("ij,jkn,kl->iln", base, CONVENTIONS[truth](angles), tool)
    noise = Rotation.from_rotvec(1e-3 * rng.normal(size=(40, 3))).as_matrix()
    trial = try_conventions(angles, np.einsum("ijn,njk->ikn", known, noise), DISTINCT)
    assert min(trial, key=trial.get) == truth
    assert [name for name in trial if not is_ruled_out(name, trial)] == [truth]


def test_small_turns_show_nothing() -> None:
    angles = np.random.default_rng(4).normal(0, 1e-3, (3, 30))
    assert try_conventions(angles, CONVENTIONS["rotvec"](angles), DISTINCT) is None


def rows(n: int = 20) -> list[str]:
    """Poses whose attained angles about fixed axes differ a little from the commanded quaternion."""
    euler = np.random.default_rng(5).uniform(-60, 60, (n, 3))
    quaternions = Rotation.from_euler("xyz", euler, degrees=True).as_quat()
    return [
        ",".join(map(repr, (*[0.1 * i, 0.2, 0.3], *angles, *[0.1 * i, 0.2, 0.3], q[3], q[0], q[1], q[2])))
        for i, (angles, q) in enumerate(zip(euler.tolist(), quaternions.tolist(), strict=True))
    ]


COMMANDED = "cmd_x,cmd_y,cmd_z,cmd_qw,cmd_qx,cmd_qy,cmd_qz"


def test_documented_names_that_the_data_contradict_are_a_question(read: Reader) -> None:
    text = "\n".join([f"x,y,z,rx_deg,ry_deg,rz_deg,{COMMANDED}", *rows()])
    (problem,) = problem_texts(read, text)
    assert problem.startswith("1, rx_deg, ry_deg, rz_deg: these are documented as a rotation vector, which they do not")
    assert "fixed-xyz by " in problem
    names = "rotvec (Universal Robots), fixed-xyz (trackers, FANUC, Yaskawa), moving-xyz (Stäubli)"
    assert problem.endswith(f"give `angles`: {names}")


def test_ambiguous_names_are_taken_as_the_data_show_or_asked_for(read: Reader) -> None:
    body = rows()
    data = read("\n".join([f"X [m],Y [m],Z [m],Rx [deg],Ry [deg],Rz [deg],{COMMANDED}", *body]))
    np.testing.assert_allclose(data.rotation, data.commanded_rotation, atol=1e-12)
    assert any("taken as fixed-xyz" in warning for warning in data.warnings)
    alone = [",".join([*row.split(",")[:9], "1"]) for row in body]
    (problem,) = problem_texts(
        read, "\n".join(["X [m],Y [m],Z [m],Rx [deg],Ry [deg],Rz [deg],cmd_x,cmd_y,cmd_z,pose", *alone])
    )
    assert "these may be angles of several conventions; give `angles`: rotvec (Universal Robots), fixed-xyz" in problem


def test_every_pair_of_conventions_is_told_apart() -> None:
    angles = np.random.default_rng(6).uniform(-1.5, 1.5, (3, 60))
    for truth, other in itertools.permutations(DISTINCT, 2):
        trial = try_conventions(angles, CONVENTIONS[truth](angles), (truth, other))
        assert is_ruled_out(other, trial)
