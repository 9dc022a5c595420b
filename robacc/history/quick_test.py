"""Quick test of an arm: a few poses against the model of its last full fit show whether one of its coefficients moved.

The poses cannot show all coefficients anew. But their error is known as far as nothing changed: the model's own
covariance, the scatter of the joints, what the fit left unexplained, and the noise. Base and target may be set up anew
and are free. Each coefficient in turn is put to the test with the weights of that error, and the most significant one
is taken, as long as one is improbable without a change.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from robacc.errors import Problem, refuse
from robacc.fitting.parameters import apply_fit
from robacc.fitting.solver import fit
from robacc.geometry import Array
from robacc.history.changes import POWER, RIVAL, SETUP, ArmChange, Limit
from robacc.measurements import Measurements
from robacc.modelling.model import Model, residuals
from robacc.prediction.model_uncertainty import ModelFit, blocks_with_frames, fitted_jacobian
from robacc.robots.description import Robot
from robacc.statistics.distributions import f_sf, normal_quantile, student_quantile
from robacc.tracing.calibrating import default_frames

_HIDDEN = 1e-6
"""Share of a coefficient's information, frames fixed, below which free frames hide it."""
_MOST_POSES = 1000
"""The errors of all poses are correlated: one matrix of all of them is made."""
_FINEST = 1e-9
"""m or rad: no instrument measures finer, and exact data have no noise."""


class QuickTest(NamedTuple):
    """Outcome of a quick test."""

    changes: tuple[ArmChange, ...]
    detection_limits: tuple[Limit, ...]
    """Change of each coefficient that such poses show with a probability of 95 %."""
    hidden: tuple[str, ...]
    """Coefficients that the poses cannot distinguish from the set-up."""
    rms: float
    """Rms position error of the model with base and target registered, m."""


def quick_test(
    robot: Robot, record: ModelFit, data: Measurements, level: float, factor: float, dates: tuple[float, float]
) -> QuickTest:
    """Return which coefficients of the model ``robot`` moved since its fit.

    Args:
        robot: Model that a fit wrote.
        record: Record of that fit.
        data: Poses measured now.
        level: Probability of a false alarm.
        factor: How much more the variance of a coefficient is from test to test than within one.
        dates: Of the last test before, and of this one, s since 1970.

    Raises:
        InputError: Fewer measured components than the frames have parameters, or more than :data:`_MOST_POSES` poses.
    """
    many = Problem(f"a quick test takes at most {_MOST_POSES} poses, found {data.n}", data.source, fix="use calibrate")
    refuse((data.n > _MOST_POSES, many))
    frames = default_frames(robot, data)
    robot = apply_fit(fit(Model.of(robot, frames), data))
    model = Model.of(robot, record.effects)
    poses, jacobian, covariance = fitted_jacobian(model, record, data)
    error = residuals(data, poses)
    rows, n = error.shape
    free, common, single = [], [], np.zeros((n, rows, n, rows))
    for block, own, correlated, independent in blocks_with_frames(robot, record, data, data, Model.of(robot, frames)):
        free.append(own[:rows])
        common.append(correlated[:rows])
        for i, variance in zip(range(n)[block], independent[:rows, :rows].T, strict=True):
            single[i, :, i, :] = variance + np.square(_FINEST) * np.eye(rows)

    def flat(columns: Array) -> Array:
        """Return columns ``(M, K, N)`` with the components of each pose together ``(N M, K)``."""
        return columns.transpose(2, 0, 1).reshape(n * rows, -1)

    shared = flat(np.concatenate(common, axis=2))
    shared[:, : len(covariance)] *= math.sqrt(max(1.0, factor))
    whitener = np.linalg.cholesky(single.reshape(n * rows, n * rows) + shared @ shared.T)
    setup, moved, rest = (
        np.linalg.solve(whitener, flat(columns))
        for columns in (np.concatenate(free, axis=2), jacobian[:rows], error[:, None, :])
    )
    setup = setup[:, np.linalg.norm(setup, axis=0) > 0.0]  # without orientations, a target has no turn
    few = Problem(f"{n} poses say nothing beyond where base and target are; measure more", data.source)
    refuse((n * rows < setup.shape[1] + 2, few))
    terms = {term.name: term for term in model.bind(data).terms}
    names = [name for name in dict.fromkeys(record.coefficients) if name in terms]
    columns = {name: moved[:, i] for i, name in enumerate(names) if not name.startswith(SETUP)}
    found: list[str] = []
    rivals: dict[str, tuple[str, ...]] = {}
    while True:
        chosen = np.column_stack([setup, *(columns[name] for name in found)])
        basis, triangle = np.linalg.qr(chosen)
        left = rest[:, 0] - basis @ (basis.T @ rest[:, 0])
        dof = left.size - chosen.shape[1] - 1
        free_of = {name: column - basis @ (basis.T @ column) for name, column in columns.items()}
        sizes = {name: float(column @ column) for name, column in free_of.items()}
        known = [name for name in columns if sizes[name] > _HIDDEN * float(columns[name] @ columns[name])]
        gains = {name: float(free_of[name] @ left) ** 2 / sizes[name] for name in known}
        if not known or dof < 1:
            break
        best = max(known, key=lambda name: gains[name])
        variance = max(1.0, (float(left @ left) - gains[best]) / dof)
        if len(known) * f_sf(gains[best] / variance, 1.0, dof) >= level:
            break
        found.append(best)
        least = gains[best] - 2.0 * RIVAL * variance
        rivals[best] = tuple(name for name in known if name != best and gains[name] > least)
    variance = max(1.0, float(left @ left) / (dof + 1))
    critical = student_quantile(1.0 - 0.5 * level / max(len(known), 1), max(dof, 1))
    values = np.linalg.solve(triangle, basis.T @ rest[:, 0])
    stds = np.sqrt(variance * np.sum(np.square(np.linalg.inv(triangle)), axis=1))
    half = student_quantile(0.975, dof + 1) * stds
    changes = tuple(
        ArmChange(
            key=name,
            kind="step",
            at=dates[1],
            earliest=dates[0],
            latest=dates[1],
            size=float(values[i]),
            low=float(values[i] - half[i]),
            high=float(values[i] + half[i]),
            unit=terms[name].unit,
            p_value=min(1.0, len(columns) * f_sf(float(values[i] / stds[i]) ** 2, 1.0, dof + 1)),
            confirmed=False,
            alternatives=rivals[name],
        )
        for i, name in enumerate(found, setup.shape[1])
    )
    least = (critical + normal_quantile(POWER)) * math.sqrt(variance)
    limits = tuple(Limit(name, least / math.sqrt(sizes[name]), terms[name].unit) for name in known)
    hidden = tuple(name for name in terms if name not in (*known, *found) and not name.startswith(SETUP))
    return QuickTest(changes, limits, hidden, float(np.sqrt(np.mean(np.sum(np.square(error[:3]), axis=0)))))
