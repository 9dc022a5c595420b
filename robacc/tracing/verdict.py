"""Verdict of a trace, the assumption that it rests on, and the share of the error that the findings explain."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Literal

from robacc.accuracy.stages import Stage
from robacc.effects.base import effect_class
from robacc.error_model.structure import Repeatability
from robacc.fitting.noise import LackOfFit
from robacc.tracing.findings import Finding
from robacc.tracing.remaining_error import Unexplained

Verdict = Literal["clean", "explained", "partly_explained", "unexplained"]
_HIDDEN = 0.1
"""Ratio of noise to repeatability, of one residual, below which the noise is not resolved."""


def verdict_of(findings: Sequence[Finding], unexplained: Unexplained) -> Verdict:
    """Return the verdict on the findings and the error that remains after them."""
    if not findings:
        return "unexplained" if unexplained.structured else "clean"
    named = any(not effect_class(finding.effect).is_empirical for finding in findings)
    plausible = all(finding.implausible is None for finding in findings)
    return "explained" if named and plausible and not unexplained.structured else "partly_explained"


def is_hidden_noise(noise: LackOfFit, repeatability: Repeatability | None) -> bool:
    """Return whether only the residual separates noise from repeatability, and leaves almost nothing for the noise."""
    if noise.p_value is not None or repeatability is None or repeatability.source != "residual":
        return False
    return math.sqrt(3) * noise.noise.position < _HIDDEN * repeatability.position


def assumption_of(verdict: Verdict, noise: LackOfFit, repeatability: Repeatability | None) -> str | None:
    """Return what the verdict presumes of noise and repeatability that only the residual gives.

    None if they are known or not used.
    """
    if noise.p_value is not None or verdict not in ("clean", "explained"):
        return None
    presumed, test = [], "repeated poses"
    if repeatability is not None and repeatability.source == "residual":
        presumed.append(f"the arm's own repeatability is {1e3 * repeatability.position:.2g} mm rms at the target")
    if noise.noise.source not in ("file", "repeats") and not is_hidden_noise(noise, repeatability):
        axes = noise.noise.along_axes
        size = f"{1e3 * noise.noise.position:.2g} mm along each axis (standard deviation)"
        if axes is not None:
            size = f"{', '.join(f'{1e3 * std:.2g}' for std in axes)} mm along x, y, z (standard deviation)"
        presumed.append(f"the measurement noise is {size}")
        test = "sigma columns or repeated poses"
    return f"{verdict} if {' and '.join(presumed)}; {test} would test this" if presumed else None


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
