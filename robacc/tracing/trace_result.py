"""Record of the result of `robacc trace`."""

from __future__ import annotations

from dataclasses import dataclass

from robacc.fitting.fit_result import Fit
from robacc.fitting.undeclared_load import UndeclaredLoad
from robacc.tracing.advice import Advice
from robacc.tracing.detection import DetectionLimit
from robacc.tracing.findings import Finding
from robacc.tracing.judging import Judged
from robacc.tracing.remaining_error import Unexplained
from robacc.tracing.search import SearchStep
from robacc.tracing.verdict import Verdict


@dataclass(frozen=True)
class Trace(Judged):
    """Result of `robacc trace`; without findings there is no gain."""

    verdict: Verdict
    assumption: str | None
    """What the verdict presumes where the noise is known from the residual alone."""
    declared: Fit
    findings: tuple[Finding, ...]
    undeclared_load: UndeclaredLoad | None
    """Whether the torques point to a load on one link; None unless masses are uncertain."""
    unexplained: Unexplained
    explained_share: float | None
    """Share of the baseline's held-out variance above noise and repeatability that the findings explain."""
    steps: tuple[SearchStep, ...]
    settled: bool
    """Whether the search ended because no move gained."""
    missing: dict[str, str]
    detection: tuple[DetectionLimit, ...]
    """Detection limits of these poses, given the findings."""
    next_poses: tuple[Advice, ...]
    """Poses that distinguish a finding from its nearest rival."""
