"""Small robot files that several test modules read, and change."""

from importlib import metadata
from pathlib import Path

import pytest

MINIMAL = """robacc: 1
name: arm
convention: standard
units: {length: m, angle: rad}
joints:
  - name: one
    type: revolute
    theta: 0.1
    d: 0.5
    a: 0.2
    alpha: -1.5
    limits: [-1, 2]
    mass: 2
    com: [0, 0, 0.1]
  - {type: prismatic, theta: 0.2, d: 0.1, a: 0, alpha: 0}
"""

URDF_LIKE = """robacc: 1
name: arm
convention: urdf
units: {length: mm, angle: deg}
base_link: foot
tip_link: hand
joints:
  - {name: stand, type: fixed, origin: {xyz: [0, 0, 100]}, link: foot2, mass: 1}
  - {name: turn, type: continuous, origin: {rpy: [0, 90, 0]}, axis: [0, 0, 2], offset: 10, tolerance: {offset: 1, x: 1}}
  - {name: slide, type: prismatic, axis: [1, 0, 0], offset: 5, limits: [0, 100], tolerance: {offset: 1}}
  - {name: copy, type: prismatic, axis: [1, 0, 0], mimic: {joint: turn, multiplier: 2, offset: 3}}
"""


def edit(text: str, old: str, new: str) -> str:
    assert text.count(old) == 1, f"{old!r} is there {text.count(old)} times"
    return text.replace(old, new)


def example_robots() -> Path:
    """Folder of the URDFs of the package example-robot-data; skips the test where that is not installed."""
    try:
        listed = metadata.files("example-robot-data") or []
    except metadata.PackageNotFoundError:
        pytest.skip("example-robot-data is not installed")
    return Path(next(file for file in listed if file.name == "panda.urdf").locate()).parents[2]
