"""Scatter of the joints beside a calibration, and fits that do not converge."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from arms import arm

import robacc
from robacc.calibration.calibrating import calibrate
from robacc.effects.request import build, parse_requests
from robacc.errors import InputError
from robacc.fitting import gauss_newton
from robacc.fitting.fit_repeatability import repeatability_of
from robacc.fitting.fit_result import Options
from robacc.fitting.repeatability import Components
from robacc.fitting.scatter_check import NO_SCATTER
from robacc.fitting.solver import fit
from robacc.fitting.whitening import Scatter
from robacc.measurements import Measurements
from robacc.modelling.model import Model, predict
from robacc.robots.description import Frame, Robot

NOISE = 1e-5
SCATTER = 1e-4


def three_targets() -> Robot:
    robot = dataclasses.replace(arm("irb1600").robot, effects=())
    targets = {
        "a": Frame((0.1, 0.0, 0.1), (0.0, 0.0, 0.0)),
        "b": Frame((-0.05, 0.09, 0.12), (0.0, 0.0, 0.0)),
        "c": Frame((-0.05, -0.09, 0.08), (0.0, 0.0, 0.0)),
    }
    return dataclasses.replace(robot, targets=targets)


def scattered(robot: Robot, n: int, seed: int, visits: int = 1) -> Measurements:
    """Return three targets at ``n`` arrivals, ``visits`` at each pose, whose joints scatter by :data:`SCATTER`."""
    rng = np.random.default_rng(seed)
    limits = np.array([joint.limits for joint in robot.variables])
    q = rng.uniform(0.6 * limits[:, :1], 0.6 * limits[:, 1:], size=(len(limits), n // visits)).repeat(visits, axis=1)
    attained = q + SCATTER * rng.standard_normal(q.shape)
    names = list(robot.targets)
    rows = np.repeat(np.arange(n), 3)
    base = Measurements(
        position=np.zeros((3, 3 * n)),
        q=attained[:, rows],
        target=np.array(names * n),
        pose=(rows // visits).astype(str),
        visit=rows,
    )
    position = predict(robot, base).translation + NOISE * rng.standard_normal((3, 3 * n))
    return dataclasses.replace(base, q=q[:, rows], position=position)


@pytest.mark.slow
def test_calibrate_separates_scatter_from_noise_and_covers_the_truth() -> None:
    robot = three_targets()
    hits, shares = [], []
    for seed in range(6):
        result = calibrate(robot, scattered(robot, 60, seed), parse_requests("joint_offset[j2,j3,j4,j5]"))
        assert result.repeatability is not None
        assert result.noise.noise.position == pytest.approx(NOISE, rel=0.15)
        stds = [std for _, std in result.repeatability.joints if std is not None]
        assert stds
        shares.extend(stds)
        hits.extend(abs(p.value) <= 1.96 * p.std for p in result.parameters if p.std is not None)
    # 60 arrivals show a joint's scatter to 9 %: the mean over joints and seeds to 2 %.
    assert np.mean(shares) == pytest.approx(SCATTER, rel=0.1)
    # 24 intervals of 95 %: fewer than 20 hold the truth once in 100 such studies.
    assert sum(hits) >= 20


@pytest.mark.parametrize(
    ("sigma", "visits", "source"),
    [(None, 1, "residual"), (NOISE, 1, "file"), (NOISE / 3, 1, "file and misfit"), (None, 2, "repeats")],
)
def test_noise_beside_scatter_has_the_source_that_tells_it(sigma: float | None, visits: int, source: str) -> None:
    """The table said that a file with sigma columns had none, and its result was no valid document."""
    robot = three_targets()
    data = scattered(robot, 60, 1, visits)
    if sigma is not None:
        data = dataclasses.replace(data, sigma_position=np.full((3, data.n), sigma))
    result = robacc.calibrate(data, robot=robot, fit="joint_offset[j2,j3,j4,j5]", folds=2)
    assert result.repeatability is not None
    assert result.noise.noise.source == source
    noise = robacc.schema("calibrate")["$defs"]["noise"]
    assert source in noise["properties"]["source"]["enum"]


def test_a_joint_that_hardly_moves_the_target_gets_no_scatter() -> None:
    """The last joint of an arm, 4 mm from the target, was said to scatter by 33 degrees."""
    robot = three_targets()
    data = scattered(robot, 60, 1)
    model = Model.of(robot)
    fitted = fit(
        Model(model.arm, model.known, build(parse_requests("joint_offset[j2,j3]"), model.arm, data)), data, Options()
    )
    stds = np.array([1e-4, 1e-4, 1e-4, 2e-4, 0.02, 0.58])
    components = Components(Scatter(stds, np.zeros(6)), (NOISE, NOISE), 50.0, 0.1 * stds)
    joints = dict(repeatability_of(fitted, components, data).joints)
    assert joints == pytest.approx({"j1": 1e-4, "j2": 1e-4, "j3": 1e-4, "j4": 2e-4, "j5": 0.02} | {"j6": None})


def test_a_fit_that_does_not_converge_says_so_and_writes_no_model(
    monkeypatch: pytest.MonkeyPatch, tmp_path: object
) -> None:
    monkeypatch.setattr(gauss_newton, "_STEPS", 1)
    result = robacc.calibrate(
        "sample_data/poses.csv", robot="sample_data/robot.yaml", fit="joint_offset,link_geometry", folds=2
    )
    assert not result.converged
    assert any("did not converge" in warning for warning in result.warnings)
    assert result.document()["converged"] is False
    with pytest.raises(InputError, match="did not converge"):
        result.write_model(f"{tmp_path}/model.yaml")


@pytest.mark.parametrize("has_sag", [False, True])
def test_an_error_that_the_model_lacks_is_no_scatter(has_sag: bool) -> None:
    """With scatter alone, its weights are used; beside a sag that is not fitted, the fit is that of equal weights."""
    robot = three_targets()
    data = scattered(robot, 60, 3)
    if has_sag:
        # The sag of the arm from joint 2 on, on a shelf that carries it at both ends of its way.
        assert data.q is not None
        sagging = data.q.copy()
        sagging[1] += 6e-4 * np.cos(2 * data.q[1])
        sag = predict(robot, dataclasses.replace(data, q=sagging)).translation - predict(robot, data).translation
        data = dataclasses.replace(data, position=data.position + sag)
    result = calibrate(robot, data, parse_requests("base_frame,joint_offset,link_geometry"), shrink=False, n_folds=0)
    plain = fit(result.fit.model, data, Options())
    rms = [float(np.sqrt(np.mean(np.sum(np.square(f.residual[:3]), axis=0)))) for f in (result.fit, plain)]
    assert (NO_SCATTER in result.warnings) is has_sag
    assert (result.repeatability is None) is has_sag
    assert (rms[0] == pytest.approx(rms[1], rel=1e-3)) is has_sag
    errors = [p.std for p in result.parameters]
    plain_errors = np.sqrt(np.diag(plain.covariance))
    if has_sag:
        # Rows of an arrival share the error, so three targets tell less than three arrivals.
        shares = [error / other for error, other in zip(errors, plain_errors, strict=True) if error is not None]
        assert np.median(shares) > 1.2
