"""Unit of an uncertainty that an export writes without one, beside positions with one."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import robacc
from robacc.errors import InputError

HEAD = "J1 (deg),X ({unit}),Y ({unit}),Z ({unit}),{sigma}\n"


def poses(tmp_path: Path, unit: str, sigma: str, value: str, position: tuple[str, str, str]) -> Path:
    path = tmp_path / "export.csv"
    rows = "".join(f"{10 * i},{','.join(position)},{value},{value},{value}\n" for i in range(4))
    path.write_text(HEAD.format(unit=unit, sigma=sigma) + rows)
    return path


@pytest.mark.parametrize(
    ("unit", "position", "value", "sigma"),
    [("mm", ("500", "20", "900"), "0.03", 3e-5), ("in", ("20", "1", "40"), "0.001", 2.54e-5)],
)
def test_it_is_that_of_the_position(
    tmp_path: Path, unit: str, position: tuple[str, str, str], value: str, sigma: float
) -> None:
    data = robacc.read_poses(poses(tmp_path, unit, "std x,std y,std z", value, position))
    np.testing.assert_allclose(data.sigma_position, sigma, rtol=1e-12)
    text = f"std x, std y, std z taken as {unit}, the unit of X ({unit}); `units` states another"
    assert any(text in warning for warning in data.warnings)


def test_an_expanded_uncertainty_is_divided_by_its_coverage_factor(tmp_path: Path) -> None:
    path = poses(tmp_path, "mm", "Ux,Uy,Uz", "0.03", ("500", "20", "900"))
    data = robacc.read_poses(path, coverage=2)
    np.testing.assert_allclose(data.sigma_position, 1.5e-5, rtol=1e-12)


def test_a_size_that_no_instrument_has_in_this_unit_is_a_question(tmp_path: Path) -> None:
    path = poses(tmp_path, "mm", "Ux,Uy,Uz", "30", ("500", "20", "900"))
    message = r"export\.csv:1, Ux, Uy, Uz: these columns state no unit, and 30 mm is not a usual measuring uncertainty"
    with pytest.raises(InputError, match=message):
        robacc.read_poses(path, coverage=2)
    data = robacc.read_poses(path, coverage=2, units="um,deg")
    np.testing.assert_allclose(data.sigma_position, 1.5e-5, rtol=1e-12)


def test_a_file_with_documented_names_says_which_name_an_uncertainty_has(tmp_path: Path) -> None:
    path = tmp_path / "poses.csv"
    path.write_text("q1,x,y,z,Ux (um),Uy,T air\n0.1,0.5,0.02,0.9,30,30,21\n")
    warnings = "\n".join(robacc.read_poses(path).warnings)
    assert "unknown column 'Ux (um)' is ignored; the nearest known name is 'sigma_x_um'" in warnings
    assert "unknown column 'Uy' is ignored; the nearest known name is 'sigma_y'" in warnings
    assert "unknown column 'T air' is ignored; the nearest known name is 'temperature_c'" in warnings
