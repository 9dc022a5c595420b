"""Predicted positions of a fit to a nominal arm, and whether their 95 % intervals hold the truth."""

import numpy as np
from numpy.typing import NDArray

from robacc.fitting.fit_result import Fit
from robacc.measurements import Measurements
from robacc.modelling.model import predict
from robacc.robots.arm import Arm


def hold_the_truth(result: Fit, data: Measurements, real: Arm) -> NDArray[np.bool_]:
    """Return ``(3, N)`` which coordinates of the ``real`` arm's target lie within 1.96 standard errors of the fit's."""
    columns = result.identifiability.columns
    poses, jacobian = result.model.bind(data).linearise(result.theta, columns)
    covariance = result.covariance[np.ix_(columns, columns)]
    std = np.sqrt(np.einsum("mkn,kl,mln->mn", jacobian[:3], covariance, jacobian[:3]))
    error = poses.translation - predict(real.robot, data).translation
    return np.asarray(np.abs(error) < 1.96 * std)
