"""Tool and base lead from a target to the flange and back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from robacc.programs.program import read_program
from robacc.programs.targets import flange_targets, joint_targets, values_at

SAMPLES = Path(__file__).parent / "samples"


def matrix(xyz: tuple[float, ...], rotation: Rotation) -> np.ndarray:
    result = np.eye(4)
    result[:3, :3] = rotation.as_matrix()
    result[:3, 3] = xyz
    return result


def test_the_flange_is_where_tool_and_base_say() -> None:
    program = read_program(SAMPLES / "weld.dat", [SAMPLES / "config.dat"])
    numbers, flange, _ = flange_targets(program)
    assert numbers == (0, 1, 2, 3)
    # The numbers of $config.dat and of XP2, by hand.
    base = matrix((1.2, -0.4, 0.35), Rotation.from_euler("ZYX", (90, 0, 0), degrees=True))
    tool = matrix((0.0875, 0, 0.41225), Rotation.from_euler("ZYX", (0, -45, 0), degrees=True))
    angles = (177.082932, 4.31955290, -0.298484027)
    target = matrix((1.58776917, -0.890400757, 0.439605072), Rotation.from_euler("ZYX", angles, degrees=True))
    expected = base @ target @ np.linalg.inv(tool)
    np.testing.assert_allclose(flange.matrices()[1], expected, atol=1e-12)


def test_the_way_back_gives_the_values() -> None:
    for name, frames in (("weld.dat", ["config.dat"]), ("glue.mod", []), ("pick.script", [])):
        program = read_program(SAMPLES / name, [SAMPLES / frame for frame in frames])
        numbers, flange, _ = flange_targets(program)
        assert numbers
        for i, values in zip(numbers, values_at(program, numbers, flange), strict=True):
            before = np.array(program.targets[i].values)
            after = np.array(values)
            after[3:] *= np.sign(np.dot(after[3:], before[3:]))
            np.testing.assert_allclose(after, before, atol=1e-12)


def test_unknown_frames_are_named() -> None:
    numbers, flange, unknown = flange_targets(read_program(SAMPLES / "pick.ls"))
    assert numbers == ()
    assert flange.translation.shape == (3, 0)
    assert unknown[0] == (0, "the tool 3 is in none of the files read")
    assert flange_targets(read_program(SAMPLES / "changed.script"))[2] == (
        (0, "the program names no tool, or several, for this target"),
    )


def test_joint_targets_are_columns() -> None:
    numbers, q = joint_targets(read_program(SAMPLES / "lines.script"))
    assert numbers == (0, 1, 2)
    np.testing.assert_allclose(q[0], (0, 0.1, 0.2))
    assert q.shape == (6, 3)
