"""Frames that the controller knows and the program only names."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from robacc.errors import InputError
from robacc.programs.program import ProgramFrame, read_program
from robacc.robots.description import Frame

SAMPLES = Path(__file__).parent / "samples"
FRAMES = """
units: {length: mm, angle: deg}
tools:
  3: {xyz: [0, 0, 120], rpy: [0, 90, 0]}
  default: {xyz: [0, 0, 50]}
bases: {1: {xyz: [1000, 0, 0]}}
"""


def test_frames_are_taken_by_number_and_default_for_those_without_a_name(tmp_path: Path) -> None:
    path = tmp_path / "frames.yaml"
    path.write_text(FRAMES, encoding="utf-8")
    target = read_program(SAMPLES / "pick.ls", [path]).targets[0]
    np.testing.assert_allclose((target.tool.frame.xyz, target.tool.frame.rpy), ((0, 0, 0.12), (0, np.pi / 2, 0)))
    np.testing.assert_allclose(target.base.frame.xyz, (1, 0, 0))
    targets = read_program(SAMPLES / "lines.script", [path]).targets
    assert {target.tool for target in targets} == {ProgramFrame("default", Frame((0.0, 0.0, 0.05)))}


def test_problems_have_line_and_key(tmp_path: Path) -> None:
    path = tmp_path / "frames.yaml"
    path.write_text("units: {length: mm, angle: deg}\ntools:\n  3: {xyz: [0, 0]}\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"frames.yaml:3, tools.3.xyz: expected a list of 3 numbers"):
        read_program(SAMPLES / "pick.ls", [path])
