"""Warnings that every fit can give."""

from __future__ import annotations

import numpy as np

from robacc.fitting.noise import LackOfFit
from robacc.fitting.registration import ALIGNABLE
from robacc.fitting.solver import Fit
from robacc.measurements import Measurements

_NAMED = 10
"""Rows left out that are named; the rest are counted."""
_FAR = 0.05
"""A residual of more than this fraction of the poses' own spread is no arm's: frames that were not fitted are."""
_GROSS = 0.01
"""The same where frames were fitted, which leave nothing of such a mistake to be explained by them."""
_TOLD_APART = 1e3
"""Condition number of the scaled columns beyond which a warning says that poses are too few or too much alike."""
_SURE = 0.999
"""Probability of a larger residual, beyond which the stated uncertainty is taken to be too large …"""
_SMALL = 0.7
"""… where the residual is also less than this part of it, which is more than rounding a sigma explains."""


def outliers_warning(found: Fit, data: Measurements) -> tuple[str, ...]:
    """Which rows took no part in the fit, where there are such."""
    if not found.outliers.size:
        return ()
    lines = ", ".join(str(data.line(int(i))) for i in found.outliers[:_NAMED])
    return (f"left out as no part of the rest: {found.outliers.size} row(s), on {data.counted}(s) {lines}",)


def no_held_out_warning(data: Measurements) -> str:
    """That there were too few poses to hold any out."""
    poses = "1 pose is" if data.n == 1 else f"{data.n} poses are"
    return f"{poses} too few to hold any out: every figure is of poses that were fitted"


def frames_warning(declared: Fit, data: Measurements) -> tuple[str, ...]:
    """That what is left of a fit is too much for an arm, and what it comes from."""
    names = {effect.name for effect in declared.model.free}
    absent = [name for name in ALIGNABLE if name not in names]
    position = data.position[:, declared.kept]
    spread = float(np.sum(np.var(position, axis=1)))
    left = float(np.mean(np.sum(np.square(declared.residual[:3, declared.kept]), axis=0)))
    if left <= (_FAR if absent else _GROSS) ** 2 * spread:
        return ()
    cause, advice = "units, joint signs, exchanged columns or an instrument that was moved", ""
    if absent:
        cause, advice = "frames that do not agree", f"; declare {','.join(absent)}"
    return (f"errors this large come from {cause} rather than from the arm{advice}",)


def condition_warning(found: Fit) -> tuple[str, ...]:
    """That the poses tell some coefficients apart badly."""
    condition = found.identifiability.condition
    if condition <= _TOLD_APART:
        return ()
    return (
        f"condition number {condition:.3g}: the poses are too few or too much alike to tell some coefficients apart "
        "well",
    )


def sigma_warning(noise: LackOfFit) -> tuple[str, ...]:
    """That the file's uncertainty cannot be, where the residual is far below it."""
    if noise.noise.source != "file" or noise.p_value is None or noise.p_value <= _SURE or noise.ratio >= _SMALL:
        return ()
    return (
        f"the residual is only {noise.ratio:.2g} times the measuring uncertainty of the file's sigma columns, so they "
        "are too large (another unit, or k = 2), and so are the standard errors that rest on them",
    )


def weak_parameters_warning(found: Fit) -> tuple[str, ...]:
    """Which constants of the arm were held near the robot file's values, and by how much."""
    if not found.held:
        return ()
    names = sorted(found.held)
    listed = ", ".join(names[:_NAMED]) + (f" and {len(names) - _NAMED} more" if len(names) > _NAMED else "")
    return (
        f"these poses hardly show {listed}: held near the robot file's value by a prior of 3 mm or 3 mrad; poses of "
        "more orientations would show them",
    )
