"""The prediction held against measured poses of one robot: tests, and the variance components that the poses show."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from robacc.errors import InputError, Problem, UsageError
from robacc.fitting.registration import Alignment, align
from robacc.measurements import Measurements
from robacc.modelling.model import predict
from robacc.modelling.observation import residuals
from robacc.prediction.components import Components, variance_components
from robacc.prediction.consistency import Consistency, consistency
from robacc.prediction.parameters import ToleranceParameter
from robacc.prediction.sufficient_statistics import Evidence, gather_evidence
from robacc.robots.description import Robot

_FEWEST_ALIGNED = 3
"""With fewer poses, base and tool absorb all that was measured."""
_FAR = 20.0
"""Errors of more times the predicted size are no tolerances', they are frames' or units'."""

Noise = tuple[float | None, float | None]


@dataclass(frozen=True, slots=True)
class MeasuredComparison:
    """What :func:`compare_with_measured` found."""

    n_poses: int
    source: str
    position_rms: float
    """Of the measured errors, as aligned, m."""
    orientation_rms: float | None
    """rad; None where no orientation was measured."""
    alignment: Alignment | None
    evidence: Evidence
    consistency: Consistency
    components: Components | None
    hint: str | None
    """What errors too large for any tolerance suggest."""
    one_draw: str
    """What it does to the tests that the poses are of one robot, and how that is accounted for."""


def compare_with_measured(
    robot: Robot,
    data: Measurements,
    parameters: Sequence[ToleranceParameter],
    *,
    what: Sequence[str] = (),
    noise: Noise = (None, None),
    confidence: float = 0.95,
    seed: int = 0,
) -> MeasuredComparison:
    """Is the error of these poses what the tolerances predict, and what tolerances do the poses show?

    Args:
        robot: Nominal; its effects are part of what it commands.
        data: Measured poses with joint variables.
        parameters: Whose errors are predicted.
        what: Of ``base_frame`` and ``tool_frame``, what is fitted to the poses first.
        noise: See :func:`robacc.prediction.sufficient_statistics.gather_evidence`.
        confidence: Of the components' intervals.
        seed: Of the likelihood ratio's null distribution.

    Raises:
        InputError: no poses or no joints, or the noise cannot be estimated.
        UsageError: noise that is not positive, a confidence out of range, something that cannot be aligned.
    """
    _check(data, noise, confidence)
    alignment = align(robot, data, what) if what else None
    aligned = robot if alignment is None else alignment.robot
    if alignment is not None and data.n < _FEWEST_ALIGNED:
        fix = "measure more poses, or align nothing"
        text = f"an alignment of {data.n} poses leaves nothing to compare"
        raise InputError(Problem(text, data.source, fix=fix))
    evidence = gather_evidence(aligned, data, parameters, noise=noise, aligned=tuple(what))
    errors = residuals(data, predict(aligned, data))
    tests = consistency(evidence, seed=seed)
    return MeasuredComparison(
        data.n,
        data.source or "the data",
        _rms(errors[:3]),
        None if data.rotation is None else _rms(errors[3:]),
        alignment,
        evidence,
        tests,
        variance_components(evidence, parameters, confidence),
        _hint(tests, alignment),
        _one_draw(evidence),
    )


def _hint(tests: Consistency, alignment: Alignment | None) -> str | None:
    if tests.scale is None or tests.scale.factor < _FAR:
        return None
    if alignment is None:
        return "errors this large come from frames that do not agree; try --align base_frame,tool_frame"
    return "errors this large come from units, joint signs or the order of the joints rather than from tolerances"


def _check(data: Measurements, noise: Noise, confidence: float) -> None:
    if data.n == 0:
        raise InputError(Problem("has no poses to compare the prediction with", data.source))
    if data.q is None:
        fix = "add q1, q2, …"
        raise InputError(Problem("has no joint columns for the robot to be commanded by", data.source, fix=fix))
    if any(value is not None and not (math.isfinite(value) and value > 0.0) for value in noise):
        raise UsageError("the measuring noise is a standard deviation above zero")
    if not 0.5 <= confidence < 1.0:
        raise UsageError(f"the confidence is a probability of at least 0.5 and below 1, not {confidence:g}")


def _rms(errors: np.typing.NDArray[np.float64]) -> float:
    return math.sqrt(float(np.mean(np.sum(np.square(errors), axis=0))))


def _one_draw(evidence: Evidence) -> str:
    directions = evidence.y.size
    text = (
        f"all {evidence.n_poses} poses are of one robot and share one draw of its parameters, so they are not "
        f"{evidence.n_poses} independent tests of the tolerances; the covariance of all poses together, "
        f"J V Jᵀ + noise, was used. Of {evidence.n_components} measured numbers {directions} speak of the parameters"
    )
    if directions:
        # The standard deviation of a variance from n Gaussian numbers is sqrt(2/n), of its root half that.
        known = 100.0 / math.sqrt(2.0 * directions)
        text += f": the size of the tolerances is known to some {known:.0f} %"
        text += ", and more poses do not help, more robots do" if evidence.rest_dof else "; more poses would show more"
    if evidence.n_aligned:
        text += f". The alignment used {evidence.n_aligned} degrees of freedom, which no longer count"
    return text
