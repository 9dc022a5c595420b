"""Verdict of a trace, the assumption that it rests on, and the share of the error that the findings explain."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from robacc.accuracy.stages import Stage
from robacc.fitting.fit_repeatability import Repeatability
from robacc.fitting.noise import LackOfFit
from robacc.tracing.findings import Finding
from robacc.tracing.remaining_error import Unexplained

Verdict = Literal["clean", "explained", "partly_explained", "unexplained"]


def verdict_of(findings: Sequence[Finding], unexplained: Unexplained) -> Verdict:
    """Return the verdict on the findings and the error that remains after them."""
    if not findings:
        return "unexplained" if unexplained.structured else "clean"
    named = any(finding.effect != "joint_correction" for finding in findings)
    plausible = all(finding.implausible is None for finding in findings)
    return "explained" if named and plausible and not unexplained.structured else "partly_explained"


def assumption_of(verdict: Verdict, noise: LackOfFit) -> str | None:
    """Return what the verdict presumes of a noise that only the residual gives; None if it is known or not used."""
    if noise.p_value is not None or verdict not in ("clean", "explained"):
        return None
    return (
        f"{verdict} if the measurement noise is {1e3 * noise.noise.position:.2g} mm along each axis (standard "
        "deviation); sigma columns or repeated poses would test this"
    )


def explained_share(before: Stage, after: Stage, noise: LackOfFit, repeatability: Repeatability | None) -> float | None:
    """Return the share of the explainable held-out variance of the baseline that the findings explain, 0 to 1."""
    if before.held_out is None or after.held_out is None:
        return None
    floor = 3.0 * noise.noise.position**2 + (0.0 if repeatability is None else repeatability.position**2)
    total = before.held_out.position.rms**2 - floor
    if total <= 0.0:
        return None
    share = (before.held_out.position.rms**2 - after.held_out.position.rms**2) / total
    return float(min(max(share, 0.0), 1.0))
