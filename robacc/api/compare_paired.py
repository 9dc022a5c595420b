"""Call of ``robacc compare --paired``."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from robacc.api.inputs import PosesSource, StrPath, load_poses, load_robot
from robacc.api.result import Provenance, Result, fields_of, options_of
from robacc.comparison.paired_targets import NoiseTreatment, PairedTargets, Promise, PromisedNoise, paired_targets
from robacc.errors import InputError, Problem, UsageError
from robacc.fitting.apply_fit import absorb_constants
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.modelling.model import Model, predict
from robacc.prediction.beyond_ranges import excess_share
from robacc.prediction.calibrated import completed
from robacc.prediction.model_fit import ModelFit, model_fit
from robacc.prediction.model_uncertainty import fitted_jacobian, model_uncertainty
from robacc.quantities import size
from robacc.robots.description import Robot
from robacc.threads import single_threaded

_FEWEST = 3
"""Smallest number of shared targets."""


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class ComparedTargets(Result, PairedTargets):
    """The same targets before and after a correction, with the inputs."""

    command: ClassVar[str] = "compare-paired"
    doubts: tuple[str, ...]
    made: Provenance

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings of the poses read, and a correction that is not loaded."""
        if self.loaded.verdict == "not loaded":
            return (*self.doubts, "no sign that the correction was loaded: the targets are where they were before")
        return self.doubts

    def payload(self) -> dict[str, Any]:
        """Return the result's own keys; arrays stay arrays."""
        from robacc.documents.compare_paired import payload

        return payload(self)


@single_threaded
def compare_paired(
    before: PosesSource,
    after: PosesSource,
    *,
    model: StrPath | Robot | None = None,
    nominal: StrPath | Robot | None = None,
    noise: str | float | None = None,
) -> ComparedTargets:
    """Compare the same targets, measured before and after a correction.

    Rows belong together by their ``pose``, or by their order where both files have no such column. Wanted poses are the
    ``cmd_`` columns of ``after``, as ``correct`` writes them, else of ``before``, else the poses of the nominal robot
    at the joints of ``before``.

    Args:
        before: Poses measured without the correction.
        after: Poses measured with the correction.
        model: Model of the correction, to test whether the remaining error agrees with its prediction.
        nominal: Robot file that the controller computes with; only for files without ``cmd_`` columns.
        noise: Standard deviation of the measurement noise along each axis, m or text; None for that of ``after``, else
            of the model's fit. Where the unexplained error of the model contains the noise of its own measurements, it
            is only the lower bound of that error, with a warning.

    Returns:
        The gain with its interval, the remaining error, whether the correction was loaded, and whether the remaining
            error agrees with the model.

    Raises:
        InputError: A file cannot be used, or the files share fewer than three targets.
        UsageError: The arguments contradict each other.

    Example:
        >>> import dataclasses, robacc
        >>> robot, model = "sample_data/trace/robot.yaml", "sample_data/trace/truth.yaml"
        >>> targets = robacc.simulate(robot, poses=20, seed=1).data
        >>> planned = robacc.correct(targets, model=model, nominal=robot).targets
        >>> old = dataclasses.replace(targets, commanded_position=planned.wanted.poses.translation)
        >>> new = dataclasses.replace(old, q=planned.q)
        >>> before = robacc.simulate(model, at=old, noise="0.02mm", seed=2).data
        >>> after = robacc.simulate(model, at=new, noise="0.02mm", seed=3).data
        >>> result = robacc.compare_paired(before, after)
        >>> result.loaded.verdict, result.rms_after < 0.1 * result.rms_before
        ('loaded', True)
    """
    arguments = locals()
    arm, arm_records = (None, ()) if model is None else _with_records(load_robot(model))
    controller, nominal_records = (None, ()) if nominal is None else _with_records(load_robot(nominal))
    first, first_record = load_poses(before, controller or arm, kind="before")
    second, second_record = load_poses(after, controller or arm, kind="after")
    names, first_rows, second_rows = _shared(first, second)
    wanted = _wanted(first, second, first_rows, second_rows, controller)
    doubts = [*first.warnings, *second.warnings]
    if first.commanded_position is None and second.commanded_position is None:
        doubts.append(
            "neither file has wanted poses (cmd_ columns), so those of the nominal robot at the joints of `before` "
            "count; errors of base and tool frames are part of the figures"
        )
    promise = None
    if arm is not None:
        promise = _promise(arm, first, second, first_rows, second_rows, noise)
        doubts += _noise_doubts(promise.noise)
        fit = model_fit(arm)
        doubts += () if fit is None else fit.warnings
    body = paired_targets(
        names, _means(first.position, first_rows), _means(second.position, second_rows), wanted, promise
    )
    options = options_of(compare_paired, arguments, model=None, nominal=None)
    options = {"noise": options["noise"]}
    records = (first_record, second_record, *arm_records, *nominal_records)
    return ComparedTargets(
        **fields_of(body),
        doubts=tuple(doubts),
        made=Provenance(options, records, None),
    )


def _with_records(loaded: tuple[Robot, Any]) -> tuple[Robot, tuple[Any, ...]]:
    return loaded[0], (loaded[1],)


Rows = list[NDArray[np.int64]]


def _shared(first: Measurements, second: Measurements) -> tuple[tuple[str, ...], Rows, Rows]:
    """Return the names of shared targets and their rows in each file.

    Raises:
        InputError: The files share fewer than three targets.
    """
    if (first.pose is None) != (second.pose is None):
        raise InputError(Problem("one file has a column pose, the other has none", fix="add it to both files"))
    if first.pose is None or second.pose is None:
        if first.n != second.n:
            message = f"{first.n} and {second.n} rows without a column pose cannot be paired"
            raise InputError(Problem(message, second.source, fix="add a column pose to both files"))
        rows = [np.array([i]) for i in range(first.n)]
        names, first_rows, second_rows = tuple(str(i + 1) for i in range(first.n)), rows, rows
    else:
        rows_of = [_rows_of_targets(data) for data in (first, second)]
        common = [key for key in rows_of[0] if key in rows_of[1]]
        first_rows, second_rows = ([np.array(file[key]) for key in common] for file in rows_of)
        names = tuple(" ".join(key) for key in common)
    if len(names) < _FEWEST:
        fix = "give the files of the same targets before and after the correction"
        raise InputError(Problem(f"the files share {len(names)} targets, {_FEWEST} are needed", second.source, fix=fix))
    return names, first_rows, second_rows


def _rows_of_targets(data: Measurements) -> dict[tuple[str, ...], list[int]]:
    """Return the rows of each target by its name: its pose, and the measured target if the file has that column."""
    assert data.pose is not None
    columns = (data.pose,) if data.target is None else (data.pose, data.target)
    rows: dict[tuple[str, ...], list[int]] = {}
    for i, key in enumerate(zip(*(map(str, column) for column in columns), strict=True)):
        rows.setdefault(key, []).append(i)
    return rows


def _means(values: Array, rows: Rows) -> Array:
    """Return the means ``(K, T)`` of the columns of ``(K, N)`` over the rows of each target."""
    return np.stack([values[:, index].mean(axis=1) for index in rows], axis=1)


def _wanted(
    first: Measurements, second: Measurements, first_rows: Rows, second_rows: Rows, nominal: Robot | None
) -> Array:
    """Return the wanted positions ``(3, T)``.

    Raises:
        UsageError: Neither file has wanted poses, and there is no nominal robot.
    """
    if second.commanded_position is not None:
        return _means(second.commanded_position, second_rows)
    if first.commanded_position is not None:
        return _means(first.commanded_position, first_rows)
    if nominal is None or first.q is None:
        raise UsageError("the files have no wanted poses: add cmd_x, cmd_y, cmd_z, or give `nominal` and joints")
    return _means(predict(dataclasses.replace(nominal, effects=()), first).translation, first_rows)


def _promise(
    arm: Robot,
    first: Measurements,
    second: Measurements,
    first_rows: Rows,
    second_rows: Rows,
    noise: str | float | None,
) -> Promise:
    """Return what the model predicts at the commands of both files.

    Raises:
        UsageError: The files have no joints.
        InputError: The model has no record of its fit.
    """
    fit = model_fit(arm)
    if fit is None:
        fix = "give a file that `write_model` of a trace or a calibration wrote"
        raise InputError(Problem("the model has no record of its fit", arm.name, column="fit", fix=fix))
    if first.q is None or second.q is None:
        raise UsageError("`model` needs the joints q1, q2, … that were commanded, in both files")
    arm = absorb_constants(arm)
    full = [completed(arm, fit, None, data, 0) for data in (first, second)]
    predicted = Model.of(arm).bind(full[0]).poses(np.zeros(0)).translation
    poses, jacobian, covariance = fitted_jacobian(
        Model.of(arm, fit.effects), fit, full[1], excess_share(arm, fit, full[1])
    )
    alone = dataclasses.replace(fit, covariance=0.0 * fit.covariance)
    separate = model_uncertainty(arm, alone, full[1], measured=True).position
    noise_used = _noise_used(second, fit, noise)
    firsts = np.array([index[0] for index in second_rows])
    return Promise(
        _means(predicted, first_rows),
        _means(poses.translation, second_rows),
        jacobian[:3, :, firsts],
        covariance,
        _with_noise(separate[:, :, firsts], noise_used, np.array([index.size for index in second_rows])),
        noise_used,
    )


def _noise_used(data: Measurements, fit: ModelFit, noise: str | float | None) -> PromisedNoise:
    """Return the measurement noise along an axis: as given, from the file, else from the fit."""
    treatment: NoiseTreatment = "added" if fit.noise_is_separate else "contained"
    if noise is not None:
        return PromisedNoise(size(noise, "length", "`noise`"), "given", treatment)
    if data.sigma_position is not None:
        return PromisedNoise(float(np.sqrt(np.mean(np.square(data.sigma_position)))), "file", treatment)
    return PromisedNoise(fit.noise[0] if fit.noise_is_separate else 0.0, "model", treatment)


def _with_noise(covariance: Array, noise: PromisedNoise, counts: NDArray[np.int64]) -> Array:
    """Return covariances ``(3, 3, T)`` with the noise of means of ``counts`` measurements.

    Where they contain the noise of other measurements, their principal variances are at least this noise.

    Raises:
        UsageError: Neither the noise nor the model leaves a single measurement any error.
    """
    variance = (noise.position**2 / counts)[:, None]
    values, vectors = np.linalg.eigh(np.moveaxis(covariance, 2, 0))
    values = np.maximum(values, 0.0) + variance if noise.treatment == "added" else np.maximum(values, variance)
    if not np.all(values > 0.0):
        raise UsageError("the model has no unexplained error: `noise` must be more than 0")
    total: Array = np.einsum("nik,nk,njk->ijn", vectors, values, vectors)
    return total


def _noise_doubts(noise: PromisedNoise) -> list[str]:
    """Return a warning where noise is stated that the model's unexplained error may contain."""
    if noise.treatment == "added" or noise.source == "model":
        return []
    stated = "`noise`" if noise.source == "given" else "the noise of `after`"
    return [
        f"the model's unexplained error contains the noise of its own measurements, so {stated} of "
        f"{1e3 * noise.position:.3g} mm is not added; the error counts as this noise at least; to separate the two, "
        "fit the model to poses with columns sigma_x, sigma_y, sigma_z or with several rows in a visit"
    ]
