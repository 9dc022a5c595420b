"""Check of the joints' scatter: weights by scatter and equal weights must give the same coefficients but for chance.

Where the residual holds an error that the model lacks, the scatter is estimated to be as large as that error, and the
weights follow it: the fit then gives up the poses and directions in which the arm misses most. With scatter alone, the
two fits differ by theta_plain - theta_weighted, of covariance V_plain - V_weighted (J. A. Hausman, "Specification tests
in econometrics", Econometrica 46 (1978) 1251-1271); a larger difference contradicts it. The plain fit is then the one
to use, with the covariance of its coefficients under correlated errors,

    V_plain = G^-1 X^T R X G^-1,   G = X^T X (+ prior),

R the covariance of rows that share the error of a visit or a pose, as in :mod:`robacc.fitting.whitening`.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from robacc.chain import BLOCK
from robacc.fitting.coefficient_covariance import sandwich, with_covariance
from robacc.fitting.fit_repeatability import known_variance
from robacc.fitting.fit_result import Fit
from robacc.fitting.normal_equations import joint_columns
from robacc.fitting.places import places
from robacc.fitting.repeatability import Components
from robacc.fitting.visits import visit_numbers
from robacc.fitting.whitening import whole_groups
from robacc.geometry import Array
from robacc.measurements import Measurements

NO_SCATTER = (
    "the remaining error is systematic, not scatter of the joints: the model lacks an effect; a trace searches for it"
)
"""Warning where the scatter is contradicted."""
MOST_DIFFERENT = 2.5
"""Largest square of the difference of the two fits' predictions, over its expected value, that scatter explains.

With scatter alone, 32 simulated sets gave 0.5 to 1.7; with the errors of effects that the model lacks, 2 to 12. Either
way the fit with equal weights holds, so that little is lost where the bound errs.
"""


def contradicts_scatter(plain: Fit, weighted: Fit, components: Components, data: Measurements) -> bool:
    """Return whether a fit with equal weights differs more from the one weighted by scatter than scatter explains."""
    return difference_ratio(plain, weighted, components, data) > MOST_DIFFERENT


def difference_ratio(plain: Fit, weighted: Fit, components: Components, data: Measurements) -> float:
    """Return the squared difference of the predictions of two fits, over its expected value under the scatter."""
    rows = np.flatnonzero(plain.inliers & weighted.inliers)
    difference = plain.weight[:, rows] * (plain.residual[:, rows] - weighted.residual[:, rows])
    gram, meat = _gram_and_meat(plain, components, data, rows)
    columns = plain.identifiability.columns
    v_plain = sandwich(gram, meat, plain.precision)
    v_weighted = np.zeros_like(gram)
    if weighted.names == plain.names:
        v_weighted = np.nan_to_num(weighted.covariance[np.ix_(columns, columns)])
    expected = float(np.sum(gram * (v_plain - v_weighted)))
    # The weighted fit is the better one, so the traces differ; for equal weights both are zero.
    expected = max(expected, 0.05 * float(np.sum(gram * v_plain)))
    return float(np.sum(np.square(difference))) / expected if expected > 0.0 else 0.0


def with_scatter_covariance(plain: Fit, components: Components, data: Measurements) -> Fit:
    """Return a fit with equal weights, with the covariance of its coefficients under the scatter."""
    if not plain.identifiability.columns.size:
        return plain
    gram, meat = _gram_and_meat(plain, components, data, np.flatnonzero(plain.inliers))
    return with_covariance(plain, sandwich(gram, meat, plain.precision))


def _gram_and_meat(
    plain: Fit, components: Components, data: Measurements, rows: NDArray[np.int64]
) -> tuple[Array, Array]:
    """Return ``(K, K)`` X^T X and X^T R X of the rows, scaled by the plain fit's weights; by blocks of whole places."""
    part = data.subset(rows)
    place, visit = places(part), visit_numbers(part)
    gram = meat = np.zeros((plain.identifiability.columns.size,) * 2)
    for block in whole_groups(place, BLOCK):
        more = _of_block(
            plain, components, part.subset(block), plain.weight[:, rows[block]], place[block], visit[block]
        )
        gram, meat = gram + more[0], meat + more[1]
    return gram, meat


def _of_block(
    plain: Fit,
    components: Components,
    part: Measurements,
    weight: Array,
    place: NDArray[np.int64],
    visit: NDArray[np.int64],
) -> tuple[Array, Array]:
    """Return ``(K, K)`` X^T X and X^T R X of a block of rows with their weights."""
    count = plain.residual.shape[0]
    _, jacobian = plain.model.bind(part).linearise(plain.theta, plain.identifiability.columns, count)
    design = jacobian * weight[:, None, :]
    joints = joint_columns(plain.model, part)[:count] * weight[:, None, :]
    unstated_var = np.square(np.repeat(components.noise, 3))[:count, None]
    noise_var = np.square(weight) * (known_variance(part, count) + unstated_var)
    gram = np.einsum("mkn,mln->kl", design, design, optimize=True)
    meat = np.einsum("mkn,mn,mln->kl", design, noise_var, design, optimize=True)
    shared = np.einsum("mkn,mjn->kjn", design, joints, optimize=True)
    scatter = components.scatter
    for numbers, stds in ((visit, scatter.visit_std), (place, scatter.pose_std)):
        order = np.argsort(numbers, kind="stable")
        first = np.flatnonzero(np.diff(numbers[order], prepend=-1))
        sums = np.add.reduceat(shared[:, :, order], first, axis=2) * stds[:, None]
        meat += np.einsum("kjv,ljv->kl", sums, sums, optimize=True)
    return gram, meat
