"""Choice between joints read back and commanded joints: which of them the measured positions follow."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np

from robacc.effects.base import effect_class
from robacc.effects.read_back import FOLLOWED_SHARE
from robacc.fitting.fit_result import Fit
from robacc.fitting.normal_equations import joint_columns
from robacc.fitting.solver import fit
from robacc.geometry import rms_length
from robacc.measurements import Measurements

READ_BACK = "read_back"
"""Effect whose coefficient is the share."""
_SURE, _IMPLAUSIBLE = 3.0, 0.1
"""Standard errors, and share, by which a share must lie outside 0 to 1 to be impossible."""
_UNDECIDED = 0.25
"""Standard error of the share above which the poses do not decide."""


def read_back_warning(final: Fit, data: Measurements) -> Iterator[str]:
    """Yield which joints the measured positions follow, if the file has both; nothing if the model has `read_back`."""
    model = final.model
    cls = effect_class(READ_BACK)
    if cls.missing(model.arm, data) is not None or any(effect.name == READ_BACK for effect in model.free):
        return
    assert data.read_back is not None
    assert data.q is not None
    difference = data.read_back - data.q
    shift = np.einsum("mjn,jn->mn", joint_columns(model, data)[:3], difference)
    size = rms_length(shift)
    effect = cls.default(model.arm, data)
    fitted = fit(dataclasses.replace(model, free=(*model.free, effect)), data)
    number = fitted.names.index(READ_BACK)
    share, std = float(fitted.theta[number]), float(np.sqrt(fitted.covariance[number, number]))
    start = f"the joints read back differ from the commanded joints by {1e3 * size:.3g} mm rms at the target"
    if not np.isfinite(std) or std > _UNDECIDED:
        yield f"{start}; the poses do not decide which of them the arm stood at; the commanded joints are used"
        return
    margin = _SURE * std + _IMPLAUSIBLE
    if not -margin <= share <= 1.0 + margin:
        yield (
            f"{start}; the measured positions follow a share of {share:.2f} ± {std:.2f} of this difference, but only "
            "0 to 1 is possible: the model lacks an effect that resembles it; the commanded joints are used"
        )
        return
    cause = "the joints were read before the arm had settled"
    if share >= FOLLOWED_SHARE:
        cause = (
            "the arm was measured before it had settled, or its controller leaves a constant error; give the "
            "joints read back as q1 … qN"
        )
    yield (
        f"{start}; the measured positions follow a share of {share:.2f} ± {std:.2f} of this difference (0: the arm "
        f"stood at the commanded joints, 1: at those read back); the commanded joints are used; {cause}"
    )
