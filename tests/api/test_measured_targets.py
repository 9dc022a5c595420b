"""Targets that the poses name and the robot file does not have: a fit of the tool finds their places."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from independent_arm import TOOL, robot, run, target

import robacc
from robacc.errors import InputError

NOISE = 2e-5
PLACES = {"N1": TOOL, "N2": TOOL + np.array([0.2, 0.1, 0.0]), "N3": TOOL + np.array([-0.1, 0.2, 0.05])}
FRAMES = "base_frame,tool_frame"


@pytest.fixture(scope="module")
def table() -> list[list[str]]:
    """Forty poses, each a row of six joints and three targets."""
    poses, rng = run(40, seed=3), np.random.default_rng(3)
    rows = []
    for q in poses.q.T:
        points = [target(q, place) + rng.normal(scale=NOISE, size=3) for place in PLACES.values()]
        rows.append([*map(repr, q.tolist()), *(repr(value) for point in points for value in point.tolist())])
    return rows


def in_columns(table: list[list[str]], path: Path) -> Path:
    names = [f"q{j}" for j in range(1, 7)] + [f"{axis}{number}" for number in (1, 2, 3) for axis in "xyz"]
    path.write_text("\n".join(",".join(row) for row in [names, *table]))
    return path


def in_rows(table: list[list[str]], path: Path) -> Path:
    lines = ["visit,target," + ",".join(f"q{j}" for j in range(1, 7)) + ",x,y,z"]
    for visit, row in enumerate(table):
        for number, name in enumerate(PLACES):
            first = 6 + 3 * number
            lines.append(",".join([str(visit), name, *row[:6], *row[first : first + 3]]))
    path.write_text("\n".join(lines))
    return path


@pytest.mark.parametrize("layout", [in_rows, in_columns])
def test_places_are_found_from_the_tool(
    layout: Callable[[list[list[str]], Path], Path], table: list[list[str]], tmp_path: Path
) -> None:
    poses = robacc.PoseFile(layout(table, tmp_path / "poses.csv"), units="m,rad")
    result = robacc.calibrate(poses, robot=robot(), fit=FRAMES, folds=2)
    assert any("are not in the robot file: each starts at its tool" in text for text in result.warnings)
    assert len(result.robot.targets) == 3
    for place, frame in zip(PLACES.values(), result.robot.targets.values(), strict=True):
        # Standard errors are some 4 um: 2e-5 over the root of 40, and the base's part.
        np.testing.assert_allclose(frame.xyz, place, atol=3e-5)
    model = tmp_path / "model.yaml"
    result.write_model(model)
    assert set(robacc.read_robot(model).targets) == set(result.robot.targets)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda path: robacc.calibrate(path, robot=robot(), fit="base_frame", folds=2), "fit tool_frame, which finds"),
        (lambda path: robacc.trace(path, robot=robot(), declared="base_frame", folds=2), "found several targets"),
        (lambda path: robacc.estimate(path, robot=robot()), "found several targets"),
        (lambda path: robacc.estimate(path, robot=robot(), align="base_frame"), "found several targets"),
    ],
)
def test_without_a_fit_of_the_tool_the_places_are_unknown(
    call: Callable[[Path], object], message: str, table: list[list[str]], tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=message):
        call(in_rows(table, tmp_path / "poses.csv"))


def test_an_estimate_that_fits_the_tool_finds_the_places(table: list[list[str]], tmp_path: Path) -> None:
    result = robacc.estimate(in_rows(table, tmp_path / "poses.csv"), robot=robot(), align=FRAMES)
    # The arm has no error but the noise: sqrt(3) times 20 um, less what 15 fitted coefficients of 360 take up.
    assert result.position.rms == pytest.approx(np.sqrt(3.0) * NOISE, rel=0.1)
    assert any("are not in the robot file: each starts at its tool" in text for text in result.warnings)


def test_one_name_is_the_tool(table: list[list[str]], tmp_path: Path) -> None:
    path = in_rows(table, tmp_path / "poses.csv")
    lines = path.read_text().splitlines()
    path.write_text("\n".join([lines[0], *(line for line in lines if ",N1," in line)]))
    result = robacc.calibrate(path, robot=robot(), fit=FRAMES, folds=2)
    assert result.robot.targets == {}
    np.testing.assert_allclose(result.robot.tool.xyz, TOOL, atol=3e-5)
