"""What two fits to the same poses say of before and after, fitted and held out."""

from __future__ import annotations

import dataclasses

import numpy as np

from robacc.accuracy.metrics import pose_metrics
from robacc.accuracy.stages import BeforeAfter, Residuals, Stage, paired_gain
from robacc.fitting.solver import Fit
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.modelling.model import predict
from robacc.modelling.observation import residuals
from robacc.robots.description import Robot


def before_and_after(
    robot: Robot,
    data: Measurements,
    before: Fit,
    after: Fit,
    held: tuple[Array, Array] | None,
    holdout: Measurements | None = None,
) -> BeforeAfter:
    """The stages of ``robot`` as delivered, of a fit before and of one after, on the rows that took part in the latter.

    ``held`` are residuals before and after by models that had no part of the poses: of the poses of ``data`` in turn,
    or of those of ``holdout``; None where none was held out.
    """
    nominal = residuals(data, predict(robot, data))
    inside = [pose_metrics(one[:, after.kept]) for one in (nominal, before.residual, after.residual)]
    fitted = Residuals(nominal, before.residual, after.residual)
    if held is None:
        delivered, registered, mended = (Stage(one, None) for one in inside)
        return BeforeAfter(delivered, registered, mended, None, fitted, None)
    if holdout is None:
        fitted = dataclasses.replace(fitted, held_before=held[0], held_after=held[1])
        apart, judged, groups = None, after.kept, data.groups()
    else:
        nominal = residuals(holdout, predict(robot, holdout))
        apart, judged, groups = Residuals(nominal, *held), np.ones(holdout.n, dtype=bool), holdout.groups()
    outside = [pose_metrics(one[:, judged]) for one in (nominal, *held)]
    delivered, registered, mended = (Stage(*both) for both in zip(inside, outside, strict=True))
    gain = paired_gain(held[0][:, judged], held[1][:, judged], groups[judged])
    return BeforeAfter(delivered, registered, mended, gain, fitted, apart)
