"""Noise of a position whose coordinates are correlated: read, weighted, whitened; arms simulated independently."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from arms import model_of
from independent_arm import LIMITS, robot, target
from refusals import problems_of
from sample_files import saved

import robacc
from robacc.error_model.covariance import CovarianceParameters, Linearised, Rows, covariance, likelihood_derivatives
from robacc.fitting.solver import fit
from robacc.fitting.visits import row_ranks
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.poses.csv_file import format_poses

ZEROS = np.array([0.0, 6e-3, -5e-3, 4e-3, 5e-3, 0.0])
"""rad"""
TRACKER = np.array([6.0, -2.0, 1.0])
"""Place of the tracker, m."""
ALONG, ACROSS = 1e-5, 2e-4
"""Standard deviations along its line of sight and across it, m."""
LOW, HIGH = 0.6 * np.array(LIMITS).T


def measured(seed: int, n: int = 60) -> Measurements:
    """Positions that a tracker measures, with their covariances."""
    generator = np.random.default_rng(seed)
    q = generator.uniform(LOW, HIGH, (n, 6))
    position = np.array([target(angles + ZEROS) for angles in q])
    sight = (position - TRACKER) / np.linalg.norm(position - TRACKER, axis=1)[:, None]
    along = np.einsum("ni,nj->nij", sight, sight)
    noise = ALONG**2 * along + ACROSS**2 * (np.eye(3) - along)
    errors = np.einsum("nij,nj->ni", np.linalg.cholesky(noise), generator.standard_normal((n, 3)))
    return Measurements((position + errors).T, q=q.T, noise_covariance=np.moveaxis(noise, 0, -1))


def zeros_of(data: Measurements) -> np.ndarray:
    """Errors ``(4,)`` of the zeros of joints 2 to 5, and their standard errors."""
    result = fit(model_of(robot(), "base_frame,tool_frame,joint_offset", data), data)
    zeros = [result.names.index(f"joint_offset.j{number}") for number in (2, 3, 4, 5)]
    return np.array((result.theta[zeros] - ZEROS[1:5], np.sqrt(np.diag(result.covariance)[zeros])))


def test_intervals_cover_and_correlation_is_used() -> None:
    """40 arms, 160 zeros: 95 % intervals of a right method cover 92 to 98 % within one standard error of the share."""
    correlated, diagonal = [], []
    for seed in range(40):
        data = measured(seed)
        correlated.append(zeros_of(data))
        if seed < 8:
            stds = np.sqrt(np.einsum("iin->in", data.noise_covariance))
            diagonal.append(zeros_of(dataclasses.replace(data, noise_covariance=None, sigma_position=stds)))
    errors, stds = np.array(correlated).swapaxes(0, 1)
    assert 0.92 - 0.017 < np.mean(np.abs(errors) < 1.96 * stds) < 0.98 + 0.017
    # The line of sight is measured twenty times as well as what is across it.
    assert np.sqrt(np.mean(np.square(errors))) < 0.4 * np.sqrt(np.mean(np.square(np.array(diagonal)[:, 0])))


JOINTS = ",".join(f"q{i}" for i in range(1, 7))


def written(path: Path, header: str, data: Measurements, *columns: np.ndarray) -> str:
    """A file of joints, rad, positions, mm, and further columns."""
    rows = np.vstack((data.q, 1e3 * data.position, *columns)).T.tolist()
    text = "\n".join(",".join(map(repr, row)) for row in rows)
    return saved(path, f"{JOINTS},x_mm,y_mm,z_mm,{header}\n{text}\n")


def test_a_file_states_covariances_by_correlations(tmp_path: Path) -> None:
    data = measured(1, 12)
    stds = np.sqrt(np.einsum("iin->in", data.noise_covariance))
    correlation = (data.noise_covariance / (stds[:, None] * stds))[[0, 0, 1], [1, 2, 2]]
    header = "sigma_x_um,sigma_y_um,sigma_z_um,corr_xy,corr_xz,corr_yz"
    read = robacc.read_poses(written(tmp_path / "poses.csv", header, data, 1e6 * stds, correlation))
    np.testing.assert_allclose(read.noise_covariance, data.noise_covariance, rtol=1e-9, atol=1e-20)
    again = robacc.read_poses(saved(tmp_path / "again.csv", format_poses(read)))
    np.testing.assert_allclose(again.noise_covariance, read.noise_covariance, rtol=1e-12)
    np.testing.assert_allclose(again.sigma_position, read.sigma_position, rtol=1e-15)


def test_a_file_states_uncertainties_of_range_and_across_it(tmp_path: Path) -> None:
    data = measured(1, 12)
    polar = 1e6 * np.repeat([[ALONG], [ACROSS]], data.n, axis=1)
    names = "sigma_range_um,sigma_across_um"
    place = np.repeat(TRACKER[:, None], data.n, axis=1)
    header = f"{names},instrument_x,instrument_y,instrument_z"
    read = robacc.read_poses(written(tmp_path / "poses.csv", header, data, polar, place))
    # The noise of a position turns its line of sight by ACROSS / 6 m.
    np.testing.assert_allclose(read.noise_covariance, data.noise_covariance, atol=2e-4 * ACROSS**2)
    moved = dataclasses.replace(data, position=data.position - TRACKER[:, None])
    alone = robacc.read_poses(written(tmp_path / "own_frame.csv", names, moved, polar))
    np.testing.assert_allclose(alone.noise_covariance, read.noise_covariance, rtol=1e-9, atol=1e-18)


@pytest.mark.parametrize(
    ("names", "values", "message"),
    [
        (
            "sigma_x,sigma_y,sigma_z,corr_xy,corr_xz,corr_yz",
            "1e-4,1e-4,1e-4,1,0,0",
            "found 1, 0, 0, which no noise has",
        ),
        ("sigma_x,sigma_y,sigma_z,corr_xy,corr_xz,corr_yz", "1e-4,1e-4,1e-4,.9,.9,-.9", "matrix is positive definite"),
        ("corr_xy,corr_xz,corr_yz", "0,0,0", "columns sigma_x, sigma_y, sigma_z are missing"),
        ("sigma_x,sigma_y,sigma_z,corr_xy", "1e-4,1e-4,1e-4,0", "columns corr_xz, corr_yz are missing"),
        ("sigma_range", "1e-4", "column sigma_across is missing"),
        ("sigma_range,sigma_across", "0,1e-4", "expected a standard deviation above 0"),
        ("instrument_x,instrument_y,instrument_z", "1,2,3", "columns sigma_range, sigma_across are missing"),
        ("sigma_range,sigma_across,sigma_x,sigma_y,sigma_z", "1e-5,1e-4,1e-4,1e-4,1e-4", "is given more than once"),
    ],
)
def test_statements_that_make_no_covariance_are_refused(names: str, values: str, message: str, tmp_path: Path) -> None:
    row = f"0.1,0.2,0.3,0.4,0.5,0.6,600,100,700,{values}"
    text = f"{JOINTS},x_mm,y_mm,z_mm,{names}\n{row}\n{row.replace('0.1', '0.2', 1)}\n"
    problems = problems_of(robacc.estimate, saved(tmp_path / "poses.csv", text), robot=robot())
    assert message in problems[0]


def test_arrays_that_are_no_covariances_are_refused() -> None:
    data = measured(1, 12)
    lopsided, negative = data.noise_covariance.copy(), -data.noise_covariance
    lopsided[0, 1] += 1e-9
    for wrong in (lopsided, negative):
        problems = problems_of(robacc.estimate, dataclasses.replace(data, noise_covariance=wrong), robot=robot())
        assert "noise_covariance: expected symmetric, positive definite matrices" in problems[0]


def test_the_likelihood_has_the_covariance_of_each_row_and_its_derivatives() -> None:
    data = measured(2, 20)
    data = dataclasses.replace(data, sigma_position=np.sqrt(np.einsum("iin->in", data.noise_covariance)))
    bound = Model.of(robot()).bind(data)
    linear = Linearised.at(bound, np.zeros(0), np.ones(0), Rows.of(bound.arm, data, row_ranks(data)), data)
    noise = CovarianceParameters(np.log([1e-4]), np.where(np.arange(20) == 3, 5.0, 1.0))
    dense = covariance(noise, linear).reshape(3, 20, 3, 20)
    for row in range(20):
        expected = data.noise_covariance[..., row] + 1e-8 * np.eye(3)
        np.fill_diagonal(expected, np.diag(expected) * (25.0 if row == 3 else 1.0))
        np.testing.assert_allclose(dense[:, row, :, row], expected, rtol=1e-12)
        np.testing.assert_array_equal(np.delete(dense[:, row], row, axis=2), 0.0)
    step = 1e-5
    low, high = (likelihood_derivatives(dataclasses.replace(noise, log_std=noise.log_std + by), linear)[0]
                 for by in (-step, step))  # fmt: skip
    gradient = likelihood_derivatives(noise, linear)[1]
    assert gradient[0] == pytest.approx((high - low) / (2 * step), rel=1e-5)


def test_an_outlier_along_the_line_of_sight_is_one(tmp_path: Path) -> None:
    """0.4 mm is 40 standard deviations along it, but two of each coordinate's own."""
    data = measured(3)
    position = data.position.copy()
    sight = position[:, 7] - TRACKER
    position[:, 7] += 4e-4 * sight / np.linalg.norm(sight)
    result = robacc.calibrate(
        dataclasses.replace(data, position=position), robot=robot(), fit="base_frame,tool_frame,joint_offset"
    )
    assert np.flatnonzero(~result.fit.inliers).tolist() == [7]
