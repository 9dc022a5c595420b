"""Record of the result of `robacc trace`."""

from __future__ import annotations

from dataclasses import dataclass

from robacc.accuracy.stages import Gain, Residuals, Stage
from robacc.error_model.structure import Repeatability
from robacc.fitting.deflection_model import DeflectionChoice
from robacc.fitting.fit_result import Fit
from robacc.fitting.noise import LackOfFit
from robacc.fitting.parameters import FittedParameter, ParameterCovariance
from robacc.fitting.undeclared_load import UndeclaredLoad
from robacc.robots.description import Robot
from robacc.tracing.advice import Advice
from robacc.tracing.detection import DetectionLimit
from robacc.tracing.findings import Finding
from robacc.tracing.remaining_error import Unexplained
from robacc.tracing.search import SearchStep
from robacc.tracing.verdict import Verdict


@dataclass(frozen=True)
class Trace:
    """Result of `robacc trace`."""

    robot: Robot
    """Robot file with the findings written into it."""
    verdict: Verdict
    assumption: str | None
    """What the verdict presumes where the noise is known from the residual alone."""
    declared: Fit
    final: Fit
    noise: LackOfFit
    nominal_unregistered: Stage
    """The nominal model as it stands in the robot file."""
    nominal: Stage
    """The nominal model, registered: base and tool frames fitted as far as the poses allow."""
    before: Stage
    after: Stage
    gain: Gain | None
    parameters: tuple[FittedParameter, ...]
    """Coefficients of the final fit; standard errors include the uncertainty of the masses."""
    covariance: ParameterCovariance
    findings: tuple[Finding, ...]
    deflection: DeflectionChoice | None
    """Pose at which the torques of elastic effects are taken; None if no such effect is fitted or no choice was
    made."""
    undeclared_load: UndeclaredLoad | None
    """Whether the torques point to a load on one link; None unless masses are uncertain."""
    unexplained: Unexplained
    repeatability: Repeatability | None
    """Scatter of the joints; None if it is not significant given the noise."""
    explained_share: float | None
    """Share of the baseline's held-out variance above noise and repeatability that the findings explain."""
    steps: tuple[SearchStep, ...]
    settled: bool
    """Whether the search ended because no move gained."""
    missing: dict[str, str]
    detection: tuple[DetectionLimit, ...]
    """Detection limits of these poses, given the findings."""
    n_folds: int
    next_poses: tuple[Advice, ...]
    """Poses that distinguish a finding from its nearest rival."""
    warnings: tuple[str, ...]
    residuals: Residuals
    """Residuals of every pose, outliers included."""
    holdout: Residuals | None
    """Residuals of the poses of ``holdout``, if given."""
