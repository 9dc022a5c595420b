"""Comparison of the prediction with measured poses of one robot: tests and estimated variance components."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from robacc.errors import InputError, Problem, UsageError
from robacc.fitting import registration
from robacc.fitting.registration import Alignment
from robacc.geometry import rms_length
from robacc.measurements import Measurements
from robacc.modelling.model import predict
from robacc.modelling.observation import residuals
from robacc.prediction.components import VarianceComponents, variance_components
from robacc.prediction.consistency import Consistency, consistency
from robacc.prediction.parameters import ToleranceParameter
from robacc.prediction.sufficient_statistics import SufficientStatistics, reduce_residuals
from robacc.robots.description import Robot

_MIN_REGISTERED_POSES = 3
"""With fewer poses, base and tool absorb everything that was measured."""
_HINT_FACTOR = 20.0
"""Errors larger than the prediction by this factor come from frames or units, not from tolerances."""

Noise = tuple[float | None, float | None]


@dataclass(frozen=True, slots=True)
class MeasuredComparison:
    """Result of :func:`compare_with_measured`."""

    n_poses: int
    source: str
    position_rms: float
    """RMS of the measured errors after registration, m."""
    orientation_rms: float | None
    """rad; None if no orientation was measured."""
    alignment: Alignment | None
    statistics: SufficientStatistics
    consistency: Consistency
    components: VarianceComponents | None
    hint: str | None
    """Likely cause of errors that are too large for tolerances."""
    one_draw: str
    """Effect of the single robot on the tests, and how they account for it."""


def compare_with_measured(
    robot: Robot,
    data: Measurements,
    parameters: Sequence[ToleranceParameter],
    *,
    align: Sequence[str] = (),
    noise: Noise = (None, None),
    confidence: float = 0.95,
    seed: int = 0,
) -> MeasuredComparison:
    """Test the measured errors against the prediction, and estimate the tolerances from them.

    Args:
        robot: Nominal robot; its effects are part of the command.
        data: Measured poses with joint variables.
        parameters: Parameters with predicted errors.
        align: ``base_frame``, ``tool_frame`` or both are fitted to the poses first.
        noise: See :func:`robacc.prediction.sufficient_statistics.reduce_residuals`.
        confidence: Confidence of the components' intervals.
        seed: Seed of the likelihood ratio's null distribution.

    Raises:
        InputError: There are no poses or no joints, or the noise cannot be estimated.
        UsageError: The noise is not positive, the confidence is out of range, or a frame cannot be fitted.
    """
    _check_arguments(data, noise, confidence)
    alignment = registration.align(robot, data, align) if align else None
    registered_robot = robot if alignment is None else alignment.robot
    if alignment is not None and data.n < _MIN_REGISTERED_POSES:
        fix = "measure more poses, or leave out `align`"
        text = f"fitting frames to {data.n} poses leaves no errors to compare"
        raise InputError(Problem(text, data.source, fix=fix))
    statistics = reduce_residuals(registered_robot, data, parameters, noise=noise, aligned=tuple(align))
    errors = residuals(data, predict(registered_robot, data))
    tests = consistency(statistics, seed=seed)
    return MeasuredComparison(
        data.n,
        data.source or "the data",
        rms_length(errors[:3]),
        None if data.rotation is None else rms_length(errors[3:]),
        alignment,
        statistics,
        tests,
        variance_components(statistics, parameters, confidence),
        _hint(tests, alignment),
        _one_draw(statistics),
    )


def _hint(tests: Consistency, alignment: Alignment | None) -> str | None:
    if tests.scale is None or tests.scale.factor < _HINT_FACTOR:
        return None
    if alignment is None:
        return 'errors this large come from frames that do not agree; try `align="base_frame,tool_frame"`'
    return "errors this large come from units, joint signs or the order of the joints, not from tolerances"


def _check_arguments(data: Measurements, noise: Noise, confidence: float) -> None:
    if data.n == 0:
        raise InputError(Problem("has no poses to compare with the prediction", data.source))
    if data.q is None:
        fix = "add q1, q2, …"
        raise InputError(Problem("has no joint columns: the comparison needs the joint values", data.source, fix=fix))
    if any(value is not None and not (math.isfinite(value) and value > 0.0) for value in noise):
        raise UsageError("`noise` is a standard deviation above 0")
    if not 0.5 <= confidence < 1.0:
        raise UsageError(f"the confidence must be at least 0.5 and less than 1, not {confidence:g}")


def _one_draw(statistics: SufficientStatistics) -> str:
    n_directions = statistics.y.size
    text = (
        f"all {statistics.n_poses} poses are of one robot and share the same parameter errors, so they are not "
        f"{statistics.n_poses} independent tests of the tolerances. The tests use the covariance of all poses, "
        f"J V Jᵀ + noise. Of {statistics.n_values} measured numbers, {n_directions} depend on the parameters"
    )
    if n_directions:
        # The standard deviation of a variance from n Gaussian numbers is sqrt(2/n), of its root half that.
        relative_std = 100.0 / math.sqrt(2.0 * n_directions)
        text += f": the size of the tolerances is known to about {relative_std:.0f} %"
        text += (
            "; more robots improve it, more poses do not" if statistics.noise_dof else "; more poses would improve it"
        )
    if statistics.n_aligned:
        text += f". Fitting the frames used {statistics.n_aligned} degrees of freedom, which are not counted"
    return text
