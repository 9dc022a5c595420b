"""What was recorded and what was not: joints read back, rounded joints, a memory of play, loads that nobody logged."""

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from robacc.effects.base import FOLLOWED_SHARE, effect_class
from robacc.fitting.levels import ALIKE, DECISIVE, DEPENDENT, ENOUGH, FEW, MANY, SAMPLE, SETTLED, STEPS
from robacc.fitting.normal_equations import solved
from robacc.fitting.visits import random_rows
from robacc.geometry import Array, NDArray, rms_length
from robacc.gravity import gravity_torques, payload, weight_torques
from robacc.measurements import Measurements, even_rows
from robacc.modelling.model import Model, joint_columns
from robacc.robots.description import Robot
from robacc.statistics.intervals import normal_cdf

if TYPE_CHECKING:
    from robacc.fitting.fit_result import Fit

# Choice between joints read back and commanded joints: which of them the measured positions follow.

READ_BACK = "read_back"
"""Effect whose coefficient is the share."""


def read_back_warning(final: "Fit", data: Measurements) -> tuple[str, ...]:
    """Return which joints the measured positions follow, if the file has both; empty if the model has `read_back`."""
    model, cls = final.model, effect_class(READ_BACK)
    if cls.missing(model.arm, data) is not None or any(effect.name == READ_BACK for effect in model.free):
        return ()
    from robacc.fitting.solver import fit  # Not for an estimate, which needs the rounding alone.

    assert data.read_back is not None
    assert data.q is not None
    shift = np.einsum("mjn,jn->mn", joint_columns(model, data)[:3], data.read_back - data.q)
    fitted = fit(model.with_free(cls.default(model.arm, data)), data)
    number = fitted.names.index(READ_BACK)
    share, std = float(fitted.theta[number]), float(np.sqrt(fitted.covariance[number, number]))
    start = (
        f"the joints read back differ from the commanded joints by {1e3 * rms_length(shift):.3g} mm rms at the target"
    )
    # Beyond this standard error of the share, the poses do not decide.
    if not np.isfinite(std) or std > 0.25:
        return (f"{start}; the poses do not decide which of them the arm stood at; the commanded joints are used",)
    follow = f"{start}; the measured positions follow a share of {share:.2f} ± {std:.2f} of this difference"
    # Beyond three standard errors, and a tenth for what the model lacks, a share is impossible.
    if abs(share - 0.5) > 0.6 + 3.0 * std:
        return (
            f"{follow}, but only 0 to 1 is possible: the model lacks an effect that resembles it; the commanded joints "
            "are used",
        )
    cause = (
        "the arm was measured before it had settled, or its controller leaves a constant error; give the joints read "
        "back as q1 … qN"
        if share >= FOLLOWED_SHARE
        else "the joints were read before the arm had settled"
    )
    return (
        f"{follow} (0: the arm stood at the commanded joints, 1: at those read back); the commanded joints are used; "
        f"{cause}",
    )


# Joint variables that were recorded with few digits: rounding as scatter of the joints.
#
# A variable rounded to a step s has an error of variance s^2 / 12 (B. Widrow, I. Kollár, Quantization Noise, 2008). A
# command in whole steps has none, so the step alone decides nothing: the residual must scatter as rounding would make
# it. With C_i the Jacobian of the joint variables at row i, the Gaussian log-likelihoods of the covariances v I and v
# I + C_i diag(s^2 / 12) C_i^T, each at its best v, are compared.

_UNITS = {"revolute": (("degrees", math.pi / 180), ("rad", 1.0)), "prismatic": (("mm", 1e-3), ("m", 1.0))}
_SHARES = np.geomspace(1e-3, 1.2, 24)
"""Noise that is tried, over the root mean square of the residual. A residual smaller than the least of them over the
size of the rounding cannot show it; exact data make the covariances singular."""


class Rounding(NamedTuple):
    """Steps of the recorded joint variables, which the residual shows."""

    step: str
    """Largest step, with its unit."""
    std: Array
    """``(J,)`` standard deviation of each joint, rad or m."""
    position: float
    """RMS displacement of the target that the rounding causes, m."""

    @property
    def size(self) -> str:
        """Return the step and its size at the target."""
        return (
            f"the joint variables are rounded to {self.step}, which moves the target by "
            f"{1e3 * self.position:.2g} mm rms"
        )

    @property
    def warning(self) -> str:
        """Return the warning of a fit: the step, its size at the target, and what to do."""
        return f"{self.size}; it counts as scatter of the joints; record more digits"


def joint_step(values: Array, kind: str) -> tuple[float, str] | None:
    """Return the coarsest step of values ``(N,)``, rad or m, and its text; None without one, or with few values."""
    if np.count_nonzero(np.diff(np.sort(values))) + 1 < ENOUGH:
        return None
    # Up to four decimals of degrees, mm, rad or m.
    steps = [(size / 10**digits, digits, unit) for unit, size in _UNITS[kind] for digits in range(5)]
    for step, digits, unit in sorted(steps, reverse=True):
        multiples = values / step
        # Less is the rounding of a file that has the variables in another unit.
        if np.all(np.abs(multiples - np.round(multiples)) <= 1e-4):
            return step, f"{10.0**-digits:g} {unit}"
    return None


def evident_rounding(fit: "Fit", data: Measurements) -> Rounding | None:
    """Return the rounding of the joint variables; None if there is none, or if the residual does not show it."""
    return _evident_rounding(fit.model, data.subset(fit.inliers), fit.residual[:3, fit.inliers])


def rounding_in_errors(robot: Robot, data: Measurements, errors: Array) -> tuple[str, ...]:
    """Return the warning of numbers with few digits that position errors show; empty without one.

    Errors no larger than the rounding of joints and positions, or than any arm's, are those of a controller's own
    positions, which it computes from the joints.

    Args:
        robot: The robot of the commanded poses, registered.
        data: The measured poses.
        errors: ``(3, N)`` attained minus commanded positions in the measuring frame, m.
    """
    rounding = _evident_rounding(Model.of(robot), data, errors)
    steps = [joint_step(row, "prismatic") or (0.0, "") for row in data.position]
    parts = [] if rounding is None else [rounding.position]
    rounded = ALIKE * math.hypot(*parts, *(step / math.sqrt(12.0) for step, _ in steps))
    # No arm and no instrument is as exact as 1e-5 m, but the positions of a controller with many digits are.
    is_small = rms_length(errors) <= max(rounded, 1e-5)
    computed = "the positions look computed from the joints, not measured: give those of an instrument"
    if rounding is not None:
        text = f"{rounding.size}{', as much as the errors' * is_small}; record more digits"
        return (f"{text}{f', or {computed}' * is_small}",)
    size = f"{1e3 * rms_length(errors):.2g} mm rms"
    return (f"the errors ({size}) are the rounding of numbers: {computed}",) if is_small else ()


def _evident_rounding(model: Model, data: Measurements, residual: Array) -> Rounding | None:
    if data.q is None:
        return None
    rows = random_rows(data, MANY)
    q, data, residual = data.q[:, rows], data.subset(rows), residual[:, rows]
    kinds = ["revolute" if model.arm.is_revolute(name) else "prismatic" for name in model.arm.names]
    steps = [joint_step(row, kind) or (0.0, "") for kind, row in zip(kinds, q, strict=True)]
    std = np.array([step for step, _ in steps]) / math.sqrt(12.0)
    columns = joint_columns(model, data)[:3] * std[:, None]
    covariance = np.einsum("ajn,bjn->nab", columns, columns)
    position = float(np.sqrt(np.mean(np.trace(covariance, axis1=1, axis2=2))))
    if position == 0.0 or rms_length(residual) <= _SHARES[0] * position:
        return None
    gain = _likelihood(residual, covariance) - _likelihood(residual, np.zeros_like(covariance))
    return None if gain < DECISIVE else Rounding(max(steps)[1], std, position)


def _likelihood(residual: Array, covariance: Array) -> float:
    """Return the largest log-likelihood of ``(3, N)`` for covariances ``(N, 3, 3)`` plus white noise, in m and m²."""
    noise = np.square(_SHARES) * np.mean(np.square(residual))
    values, vectors = np.linalg.eigh(covariance)
    along = np.square(np.einsum("nij,in->nj", vectors, residual))
    total = np.maximum(values, 0.0) + noise[:, None, None]
    return float(np.max(-0.5 * np.sum(along / total + np.log(total), axis=(1, 2))))


# Memory of a joint's play: errors that depend on how its torque changed since the previous visit.
#
# Play without memory has two values, given by the approach. Where friction and springs act together (hysteresis), the
# joint also remembers the load of the previous visit: the error follows the sign of the change of gravity's torque.
# That sign depends on the present pose too, so its least-squares fit by polynomials of the ranks of torque and joint
# is subtracted. The difference is independent of the residual of a complete model. The sum of their products, over
# the root of the sum of the squared products, is then a standard Gaussian to good accuracy (a self-normalised sum; V.
# H. de la Peña, T. L. Lai, Q.-M. Shao, Self-Normalized Processes, 2009).
#
# Source of the mechanism: M. Ruderman, F. Hoffmann, T. Bertram, "Modeling and identification of elastic robot joints
# with hysteresis and backlash", IEEE Trans. Industrial Electronics 56 (2009) 3840-3847.

_FEWEST_ROWS = 30
"""Rows, or visits, from which sums over them are close to Gaussian."""


def memory_of_play(fit: "Fit", data: Measurements, joints: Sequence[str]) -> dict[str, float]:
    """Return, for each joint with play, the p-value of a memory in the residual.

    Outliers count with a bounded size, since a memory may be what makes them. The result is empty without masses,
    without joint variables, or with fewer than 30 visits that follow another visit.
    """
    if not joints or data.q is None or not fit.model.arm.chain.bodies:
        return {}
    # In order of time; in order of the file without times.
    order = np.arange(data.n) if data.time is None or data.ordered else np.argsort(data.time, kind="stable")
    # For each row the last earlier one with other joints; -1 for the first and its repeats.
    q = data.q[:, order]
    changed = np.zeros(q.shape[1], dtype=bool)
    changed[1:] = np.any(q[:, 1:] != q[:, :-1], axis=0)
    before = np.asarray(np.maximum.accumulate(np.where(changed, np.arange(q.shape[1]), 0)) - 1, dtype=np.int64)
    follows = before >= 0
    if np.count_nonzero(follows) < _FEWEST_ROWS:
        return {}
    present, previous = order[follows], order[before[follows]]
    torque = weight_torques(fit.model.arm, data)
    columns = joint_columns(fit.model, data.subset(present))[:3]
    result = {}
    for joint in joints:
        number = fit.model.arm.number(joint)
        unit = columns[:, number] / np.maximum(np.linalg.norm(columns[:, number], axis=0), 1e-12)
        error = np.einsum("mn,mn->n", unit, fit.residual[:3, present])
        # An accident of the instrument counts as seven times the median.
        limit = 7.0 * float(np.median(np.abs(error)))
        change = np.sign(torque[number, present] - torque[number, previous])
        matrix = np.concatenate((_polynomials(torque[number, present]), _polynomials(data.q[number, present])), axis=1)
        if data.direction is not None:
            matrix = np.concatenate((matrix, data.direction[number, present, None]), axis=1)
        change -= matrix @ np.linalg.lstsq(matrix, change, rcond=None)[0]
        products = change * np.clip(error, -limit, limit)
        size = max(float(np.linalg.norm(products)), 1e-300)
        result[joint] = 2.0 * normal_cdf(-abs(float(products.sum())) / size)
    return result


def _polynomials(values: Array) -> Array:
    """Return ``(N, 5)`` Chebyshev polynomials up to degree 4 of the ranks of ``(N,)``."""
    ranks = np.argsort(np.argsort(values, kind="stable"), kind="stable")
    scaled = 2.0 * ranks / max(values.size - 1, 1) - 1.0
    return np.asarray(np.polynomial.chebyshev.chebvander(scaled, 4), dtype=np.float64)


# Loads at the flange that differ from row to row and that nobody logged.
#
# A load of m_k kg on row k moves the tool by m_k sum_j c_j u_jk, with u_jk the displacement by the torque of 1 kg on
# joint j and c_j the compliance of the joint. Both factors are unknown, so they are fitted in turn (alternating least
# squares), with every coefficient of the model and a constant load. Loads come in a few sizes: the fitted loads
# are then grouped, and each group has a common load.
#
# The groups count as loads if they explain the error far better than chance, than a continuum of loads divided into as
# many groups, and than constant shifts of the same joints, which clearance or a jump of a zero would need.
#
# Source of alternating least squares for a product of two unknown vectors: H. Wold, "Estimation of principal components
# and related models by iterative least squares", in: Multivariate Analysis (1966), 391-420.

_CLEARLY = 2.0
"""Factor by which loads leave a smaller sum of squares than shifts of the same joints, and up to which groups may leave
a larger one than a load of its own for each row, but for its freedom. Groups lower it by the square of that: chance
gives 1.5 at most, one coordinate of three a row."""


class RowLoads(NamedTuple):
    """Groups of rows that carry different loads."""

    rows: tuple[NDArray[np.int64], ...]
    """Numbers of the rows of each group, lightest load first."""
    loads: tuple[float, ...]
    """Load of each group above that of the first, over that of the last."""

    @property
    def text(self) -> str:
        """Return the groups and what to do."""
        sizes = " : ".join(str(rows.size) for rows in self.rows)
        shares = " : ".join(f"{load:.2g}" for load in self.loads)
        return (
            f"a load at the flange that differs from row to row explains the errors: {len(self.rows)} groups of "
            f"{sizes} rows, whose loads above the lightest are in the ratio {shares}; the payload was not logged: if "
            "it changed, write payload_kg for each row, or the load's name in payload_group, and trace again; if it "
            "did not change, the cause is outside the catalogue"
        )


def unlogged_loads(fit: "Fit", data: Measurements) -> RowLoads | None:
    """Return the groups of rows with different loads that explain the remaining error; None if there are none."""
    if data.payload is not None or data.q is None or data.n < _FEWEST_ROWS:
        return None
    rows = even_rows(data.n, SAMPLE)
    part = data.subset(rows)
    torque = gravity_torques(fit.model.arm, part.q, payload(fit.model.arm, np.ones(part.n)))  # type: ignore[arg-type]
    size = np.linalg.norm(torque, axis=1)
    if size.max() == 0.0:
        return None
    # Joints that 1 kg hardly loads do not show it.
    loaded = np.flatnonzero(size > 0.1 * size.max())
    shifts = joint_columns(fit.model, part)[:3, loaded]
    jacobian = fit.model.bind(part).linearise(fit.theta)[1][:3]
    by_load, by_shift = (
        _grouped(fit.residual[:3, rows], np.concatenate((jacobian, moved), axis=1), moved)
        for moved in (shifts * torque[loaded], shifts)
    )
    if by_load is None or (by_shift is not None and by_shift[2] < _CLEARLY * by_load[2]):
        return None
    labels, levels, _ = by_load
    order = np.argsort(levels)
    shares = (levels[order] - levels.min()) / np.ptp(levels)
    return RowLoads(tuple(rows[labels == label] for label in order), tuple(shares.tolist()))


def _grouped(residual: Array, common: Array, moved: Array) -> tuple[NDArray[np.int64], Array, float] | None:
    """Return the fewest groups of rows whose products with ``moved`` ``(3, J, N)`` explain the residual ``(3, N)``.

    ``common`` ``(3, P, N)`` are columns with one coefficient for all rows.
    """
    n, flat = residual.shape[1], residual.ravel()
    columns = _flat(common / np.maximum(np.linalg.norm(common, axis=(0, 2), keepdims=True), 1e-300))
    lengths, vectors = np.linalg.eigh(columns.T @ columns)
    seen = lengths > DEPENDENT**2 * lengths.max()
    basis = columns @ (vectors[:, seen] / np.sqrt(lengths[seen]))
    squares = float(np.sum(np.square(flat - basis @ (basis.T @ flat))))
    amounts, free = _amounts(residual, basis, moved)
    # Groups of loads may explain no more than a load of its own for each row.
    for count in range(2, 5) if squares > _CLEARLY**2 * free else ():
        limits = np.quantile(amounts, np.arange(1, count) / count)
        labels, levels, last = np.searchsorted(limits, amounts), np.arange(count, dtype=float), math.inf
        for _ in range(STEPS):
            error, mixture, remaining = _fit(residual, basis, moved * levels[labels])
            direction = mixture @ moved
            products, weights = np.sum(direction * error, axis=0), np.sum(np.square(direction), axis=0)
            levels = np.bincount(labels, products, count) / np.maximum(np.bincount(labels, weights, count), 1e-300)
            # The square of what a level leaves of a row, less that of the row.
            before = labels
            labels = np.argmin(weights[:, None] * np.square(levels) - 2.0 * products[:, None] * levels, axis=1)
            if np.array_equal(labels, before) and last - remaining <= SETTLED * last:
                break
            last = remaining
        gain = squares / max(remaining, 1e-300)
        cost = n * np.log(count) + 0.5 * np.log(3 * n) * (count + moved.shape[1])
        # Each row's own amount takes one of its three coordinates. Equal groups of evenly spread amounts gain count^2.
        is_tight = remaining < _CLEARLY * 1.5 * free or gain > 2.0 * count**2
        is_large = np.bincount(labels, minlength=count).min() >= max(FEW * n, 3)
        if is_large and gain > _CLEARLY**2 and is_tight and 1.5 * n * np.log(gain) > cost:
            return labels, levels, remaining
    return None


def _flat(columns: Array) -> Array:
    """Return columns ``(3, P, N)`` as a matrix ``(3 N, P)``."""
    return np.moveaxis(columns, 1, 2).reshape(-1, columns.shape[1])


def _fit(residual: Array, basis: Array, moved: Array) -> tuple[Array, Array, float]:
    """Fit ``moved`` ``(3, J, N)`` and the orthonormal ``basis`` ``(3 N, R)`` to the residual by least squares.

    Returns:
        The residual ``(3, N)`` without the part of the basis, the coefficients of ``moved``, and the sum of squares
        that remains.
    """
    columns = _flat(moved)
    coefficients = np.linalg.lstsq(columns - basis @ (basis.T @ columns), residual.ravel(), rcond=DEPENDENT)[0]
    rest = residual.ravel() - columns @ coefficients
    shared = basis @ (basis.T @ rest)
    return residual - shared.reshape(residual.shape), np.asarray(coefficients), float(np.sum(np.square(rest - shared)))


def _amounts(residual: Array, basis: Array, moved: Array) -> tuple[Array, float]:
    """Return each row's own amount ``(N,)`` of the same mixture of ``moved``, and the sum of squares."""
    mixture, squares = 1.0 / np.sqrt(np.mean(np.sum(np.square(moved), axis=0), axis=1)), math.inf
    for _ in range(STEPS):
        before = squares
        direction = mixture @ moved
        precision = np.maximum(np.sum(np.square(direction), axis=0), 1e-300)
        unit = direction / np.sqrt(precision)
        # What no row's own amount can explain decides the common coefficients.
        along = np.sum(unit[:, :, None] * basis.reshape(3, -1, basis.shape[1]), axis=0)
        across = residual - unit * np.sum(unit * residual, axis=0)
        gram = np.eye(basis.shape[1]) - along.T @ along
        shared = basis @ solved(gram, basis.T @ across.ravel(), DEPENDENT**2)
        amounts = np.sum(direction * (residual - shared.reshape(residual.shape)), axis=0) / precision
        amounts = amounts - np.average(amounts, weights=precision)
        _, mixture, squares = _fit(residual, basis, moved * amounts)
        mixture = mixture / max(float(np.abs(mixture).max()), 1e-300)
        if before - squares <= SETTLED * before < math.inf:
            break
    return amounts, squares
