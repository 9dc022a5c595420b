"""Nonlinear least squares over poses: Gauss-Newton with exact Jacobians, re-linearised to convergence.

Rows are whitened by the measuring uncertainty and, where the model misses more than that, by a misfit estimated
separately for position and orientation, so lengths and angles are never mixed unweighted. Memory does not grow with the
number of poses beyond the data and what is predicted for them.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.errors import EquilibriumError, InputError
from robacc.fitting import outliers
from robacc.fitting.closed_form import register_frames
from robacc.fitting.fit_result import Fit, Identifiability, Options, identify_terms
from robacc.fitting.normal_equations import NormalEquations, PoseEquations, PredictedPoses, solved
from robacc.fitting.outliers import outlier_pattern, row_weights
from robacc.fitting.priors import Priors, broad_stds
from robacc.fitting.visits import random_rows, visit_numbers
from robacc.fitting.whitening import Whitening, whitening, whitening_of_noise
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.robots.arm import Arm

# Gauss-Newton with exact Jacobians, re-linearised to convergence: the sum of whitened squares and of Gaussian priors.
#
# Residual and Jacobian of a step are one evaluation; the last step needs the residual alone. A step that would raise
# the cost is halved until it does not.

_STEPS = 40
_DAMPINGS = (1e-12, 1e-10, 1e-8, 1e-6, 1e-4, 1e-2)
"""Damping of the scaled normal matrix, whose diagonal is one."""
_FIRST_HALVINGS = 2
_HALVINGS = 12
_FAST = 0.1
"""Steps that shrink by at least this factor are trusted to shrink on."""
_PARALLEL = 0.95
"""Cosine from which two steps are parallel."""
_QUICK, _ENDLESS = 0.05, 0.97
"""Limits of the ratio of successive steps between which the series is summed: smaller ratios converge by themselves,
larger ones need not converge."""
_EXACT = 1e-15
"""m or rad: rounding of a predicted position (at some metres) or orientation."""
_EPSILON = float(np.finfo(float).eps)
"""Rounding of a term of the cost, as a share; of a sum, it grows as the root of the number of terms."""
_SHORT = 0.03
"""Length of a step, over the residual's, below which a fit that cannot be improved counts as converged."""


@dataclass(frozen=True, slots=True)
class Minimum:
    """Minimum at which Gauss-Newton ended."""

    predicted: PredictedPoses
    normal: NormalEquations
    """The last linearisation; the minimum follows from it by one step, which is taken."""
    steps: int
    converged: bool
    """False if the steps ended before they were short."""


@dataclass(frozen=True, slots=True)
class _Move:
    predicted: PredictedPoses
    normal: NormalEquations | None
    cost: float
    step_share: float
    """Share of the proposed step."""


def minimise(
    equations: PoseEquations,
    begin: PredictedPoses,
    normal: NormalEquations | None,
    white: Whitening,
    precision: Array,
    tolerance: float,
) -> Minimum:
    """Go from ``begin``, whose linearisation is ``normal`` if it is known already, to the minimum.

    ``white`` whitens residuals, ``precision`` ``(P,)`` is of priors about zero. The last step is one that changes the
    whitened prediction by less than ``tolerance`` of the residual, or whose successors are expected to.
    """
    columns = equations.columns
    prior = precision[columns]
    predicted = begin
    if normal is None:
        predicted, normal = equations.linearise(begin.theta, white)
    cost = float(normal.cost + prior @ np.square(normal.theta))
    rounding = _EXACT * float(white.weight.max(initial=0.0))
    previous_step: Array | None = None
    previous_length: float | None = None
    count = 0
    converged = columns.size == 0
    while columns.size and count < _STEPS:
        count += 1
        step = _step(normal, prior)
        length = _length(step, normal.gram)
        settled_length = max(tolerance * (1.0 + float(np.sqrt(cost))), rounding * float(np.sqrt(columns.size)))
        is_last = length <= settled_length or _expected_length(length, previous_length) <= settled_length
        step, previous_step = _extrapolated(step, previous_step, normal.gram)
        # Near the minimum, rounding decides which of two costs is lower; a full step is then still taken.
        limit = cost + 4.0 * rounding * float(np.sqrt(cost)) + rounding**2 * white.weight.size
        limit += cost * _EPSILON * float(np.sqrt(white.weight.size))
        move = _line_search(
            equations, predicted, step, limit, white, prior, derivative=not is_last, halvings=_FIRST_HALVINGS
        )
        if move is None:
            # Along a weakly identifiable direction a step is as long as its uncertainty and leaves the linear range.
            # Halving it would hold up all other directions; damping holds up only this one.
            move = _damped(equations, predicted, normal, limit, white, prior)
            previous_step = None
        if move is None:
            move = _line_search(equations, predicted, step, limit, white, prior, derivative=not is_last)
        if move is None:
            converged = length <= _SHORT * (1.0 + float(np.sqrt(cost)))
            break
        predicted, cost = move.predicted, min(move.cost, cost)
        previous_length = length if move.step_share == 1.0 and previous_step is not None else None
        if move.normal is None:
            converged = True
            break
        normal = move.normal
    return Minimum(predicted, normal, count, converged)


def _step(normal: NormalEquations, prior: Array, damping: float = 0.0) -> Array:
    with np.errstate(divide="ignore"):
        scale = 1.0 / np.sqrt(np.diag(normal.gram) + prior)
    scale[~np.isfinite(scale)] = 0.0  # without any information: it stays
    matrix = (normal.gram + np.diag(prior)) * scale[:, None] * scale + damping * np.eye(scale.size)
    step: Array = scale * solved(matrix, scale * (normal.gradient - prior * normal.theta))
    return step


def _length(step: Array, gram: Array) -> float:
    return float(np.sqrt(max(float(step @ gram @ step), 0.0)))


def _expected_length(length: float, previous_length: float | None) -> float:
    """Return the expected length of all further steps after one of ``length`` and one of ``previous_length``.

    Gauss-Newton converges at a constant rate in the end and faster before, so the series of steps is at most geometric.
    """
    if previous_length is None or previous_length <= 0 or length > _FAST * previous_length:
        return np.inf
    rate = length / previous_length
    return length * rate / (1.0 - rate)


def _line_search(
    equations: PoseEquations,
    present: PredictedPoses,
    step: Array,
    limit: float,
    white: Whitening,
    prior: Array,
    *,
    derivative: bool,
    halvings: int = _HALVINGS,
) -> _Move | None:
    """Return the step, halved until the cost is within ``limit``; None if it never is."""
    columns = equations.columns
    for halving in range(halvings):
        step_share = 0.5**halving
        theta = present.theta.copy()
        theta[columns] += step * step_share
        normal: NormalEquations | None = None
        try:
            if derivative:
                predicted, normal = equations.linearise(theta, white)
                residual_cost = normal.cost
            else:
                predicted = equations.predict(theta)
                residual_cost = white.cost(predicted.residual)
        except EquilibriumError:
            continue
        cost = float(residual_cost + prior @ np.square(theta[columns]))
        if cost <= limit:
            return _Move(predicted, normal, cost, step_share)
    return None


def _damped(
    equations: PoseEquations,
    present: PredictedPoses,
    normal: NormalEquations,
    limit: float,
    white: Whitening,
    prior: Array,
) -> _Move | None:
    """Return the least damped Levenberg-Marquardt step that lowers the cost; None if none does."""
    for damping in _DAMPINGS:
        step = _step(normal, prior, damping)
        if (
            move := _line_search(equations, present, step, limit, white, prior, derivative=True, halvings=1)
        ) is not None:
            return move
    return None


def _extrapolated(step: Array, previous_step: Array | None, gram: Array) -> tuple[Array, Array | None]:
    """Sum the series of parallel steps along a weak direction with curvature, which shrink by a constant ratio.

    Aitken's delta-squared in the metric of the data; the line search still judges the result.
    """
    if previous_step is None:
        return step, step
    previous_square, product = float(previous_step @ gram @ previous_step), float(step @ gram @ previous_step)
    length = float(step @ gram @ step)
    if previous_square <= 0 or length <= 0:
        return step, step
    ratio = product / previous_square
    if abs(product) < _PARALLEL * np.sqrt(previous_square * length) or not _QUICK < abs(ratio) < _ENDLESS:
        return step, step
    return step / (1 - ratio), None


_DEFAULTS = Options()
_REWEIGHTINGS = 6
"""Most rounds of updates of the weights, the groups' priors and the inliers."""
_GROSS = 5.0
"""Multiple of an outlier's limit up to which rows that share a circumstance stay in the fit."""
_MANY = 20_000
"""Rows from which a fit starts at that of a random part of them, so that few passes over all rows remain …"""
_FIRST = 5_000
"""… of so many rows."""
_LEAST_POSES_TO_TRIM = 8
"""Poses that the search for outliers needs at least: with fewer, a median does not single one out."""


def fit(model: Model, data: Measurements, options: Options = _DEFAULTS) -> Fit:
    """Fit every free effect of ``model`` to ``data``.

    Free base and tool frames are first registered in closed form, from any start. Constants of the arm have a broad
    prior about nominal, unless ``options`` has one for them: noise cannot move weakly identifiable constants by
    centimetres.

    Raises:
        InputError: fewer measured components than coefficients.
        UsageError: the data lack what an effect needs.
    """
    if options.start is None and options.inliers is None and data.n > _MANY:
        first = fit(model, data.subset(random_rows(data, _FIRST)), options)
        model = first.model
        options = dataclasses.replace(options, start=first.theta, group_stds=first.group_stds)
    names = {effect.name for effect in model.free}
    if any(effect.traits.is_frame for effect in model.free) and options.start is None:
        robot = register_frames(model.arm.robot, data, "base_frame" in names, "tool_frame" in names)
        model = dataclasses.replace(model, arm=Arm.of(robot))
    solver = _Solver(model, data, options)
    is_trimmed = options.robust and data.n >= _LEAST_POSES_TO_TRIM
    if is_trimmed and options.start is None and solver.priors.is_broad.any():
        solver.trim()  # Gross rows would pull constants far from nominal, where the broad prior is weak.
    linear = solver.solve()
    for _ in range(_REWEIGHTINGS):
        if not (is_trimmed and solver.trim()):
            break
        linear = solver.solve()
    return solver.result(linear)


class _Solver:
    """State of one fit: equations bound once; coefficients, weights and priors are improved in place."""

    def __init__(self, model: Model, data: Measurements, options: Options) -> None:
        self.model, self.data, self.options = model, data, options
        self.equations = PoseEquations(model, data)
        terms = self.equations.terms
        self.inliers = np.ones(data.n, dtype=bool) if options.inliers is None else options.inliers.copy()
        self.priors = self._priors()
        self.steps = 0
        self.converged = True
        # The first misfit, if not given, is that of the start.
        start = np.zeros(len(terms)) if options.start is None else options.start.copy()
        self.predicted = self.equations.predict(start, ahead=not start.any())
        self.misfit = options.misfit or outliers.estimate(data, self.predicted.residual, self.inliers, (0.0, 0.0))
        self.joint_columns = self.equations.joint_columns(model) if self._has_scatter else None
        self.row = row_weights(data, self.misfit)
        self.latest: Whitening | None = None
        self.normal: NormalEquations | None = None
        """Linearisation at the present coefficients, weights and inliers; None if any has changed."""
        self.identifiability = self._identify()

    @property
    def _has_scatter(self) -> bool:
        return self.options.scatter is not None and bool(self.options.scatter.any())

    def whitening(self, inliers: NDArray[np.bool_] | None = None) -> Whitening:
        """Return the whitening of the inliers, or of all rows if ``inliers`` is None; the latest is kept."""
        weight = self.row if inliers is None or inliers.all() else self.row * inliers
        if self.latest is None or not (self.latest.weight is weight or np.array_equal(self.latest.weight, weight)):
            noise, scatter = self.data.correlated_noise, self.options.scatter
            if self.joint_columns is not None and scatter is not None:
                self.latest = whitening(weight, self.joint_columns, scatter, visit_numbers(self.data), noise)
            else:
                self.latest = Whitening(weight) if noise is None else whitening_of_noise(weight, noise)
        return self.latest

    def _identify(self) -> Identifiability:
        """Find the identifiable coefficients; coefficients with a group prior always are.

        The decision is made at the nominal robot, not at a start: if axes are parallel, columns that depend on each
        other exactly look independent at fitted values, and fitting both again gives links of any length.
        """
        if self.options.identified is not None:
            self.equations.columns = self.options.identified.columns
            return self.options.identified
        terms = self.equations.terms
        nominal = np.zeros(len(terms))
        free = [i for i, term in enumerate(terms) if term.group is None]
        at_nominal = np.array_equal(self.predicted.theta, nominal)
        if not at_nominal:
            self.equations.columns = np.array(free, dtype=np.int64)
        independent = np.searchsorted(self.equations.columns, free)
        triangle, normal = self.equations.factorise(nominal, self.whitening(), independent)
        identified = identify_terms(triangle, [terms[i] for i in free], self.data.n)
        measured = self.equations.rows * self.data.n
        if identified.columns.size >= measured and terms:
            raise InputError(
                f"{measured} numbers measured ({self.data.n} pose{'s' * (self.data.n != 1)}), too few for "
                f"{identified.columns.size} coefficients; measure more poses or fit fewer effects"
            )
        shrunk = [i for i, term in enumerate(terms) if term.group is not None]
        columns = np.array(sorted([free[i] for i in identified.columns] + shrunk), dtype=np.int64)
        self.equations.columns = columns
        if at_nominal and self.inliers.all():
            self.normal = normal.subset(columns)
        return dataclasses.replace(identified, columns=columns)

    def _priors(self) -> Priors:
        """Return the priors, broad ones as without constants, those of groups as at the start."""
        given, terms = np.full(len(self.equations.terms), np.inf), self.equations.terms
        if self.options.priors is not None:
            given = np.where(self.options.priors > 0, self.options.priors, np.inf)
        broad = broad_stds(self.model.free, terms, self.equations.owners)
        return Priors(terms, given, broad, self.options.group_stds)

    def solve(self) -> NormalEquations:
        """Alternate Gauss-Newton with updates of the weights and the groups' priors until neither changes."""
        if self.options.start is None:
            # The residual of an arm far from nominal is not noise: with weights of its size, priors outweigh the data.
            self._update_misfit(self._minimise())
        self.priors.follow(self.predicted.theta)
        for _ in range(_REWEIGHTINGS):
            linear = self._minimise()
            changed = self.priors.follow(self.predicted.theta)
            columns = self.equations.columns
            if self.priors.groups:
                components = float(np.count_nonzero(self.inliers) * self.equations.rows)
                known = self.options.misfit is not None
                settled = 10 * self.options.settled
                changed = self.priors.update(linear, columns, components, known, settled) or changed
            changed = self._update_misfit(linear) or changed
            if not changed:
                return linear
        return self._minimise()

    def _minimise(self) -> NormalEquations:
        precision, tolerance = self.priors.precision, self.options.tolerance
        white = self.whitening(self.inliers)
        minimum = minimise(self.equations, self.predicted, self.normal, white, precision, tolerance)
        self.predicted = minimum.predicted
        self.steps += minimum.steps
        self.converged = minimum.converged
        linear, columns = minimum.normal, self.equations.columns
        theta = self.predicted.theta[columns]
        self.normal = linear.moved_to(theta, white.cost(self.predicted.residual))
        return linear

    def _update_misfit(self, linear: NormalEquations) -> bool:
        """Estimate the misfit again; return whether it changed significantly."""
        if self.options.misfit is not None:
            return False
        previous = self.misfit
        used = self._effective(linear)
        self.misfit = outliers.estimate(self.data, self.predicted.residual, self.inliers, used)
        self.row = row_weights(self.data, self.misfit)
        self.normal = None
        return any(abs(a - b) > self.options.settled * b for a, b in zip(self.misfit, previous, strict=True))

    def _effective(self, linear: NormalEquations) -> tuple[float, float]:
        """Return the effective coefficients that position and orientation determine: the sums of their leverages.

        With N_p and N_o the normal matrices of position and orientation and P the precision of the priors, these are
        the traces of (N_p + N_o + P)^-1 N_p and of (N_p + N_o + P)^-1 N_o.
        """
        columns = self.equations.columns
        effective = self.priors.effective(linear, columns)
        if self.equations.rows == 3 or not columns.size:
            return effective, 0.0
        position = float(np.sum(linear.posterior(self.priors.precision[columns]) * linear.of_position))
        return position, effective - position

    def trim(self) -> bool:
        """Find the inliers again; return whether they changed."""
        weight, count = self.whitening().row_weight, self.equations.columns.size
        inliers = outliers.inlier_mask(self.predicted.residual, weight, self.inliers, count)
        if outlier_pattern(self.data, ~inliers, self.model.arm.names) is not None:
            # Rows that share a circumstance show what the model lacks; only gross ones would spoil the fit.
            inliers = outliers.inlier_mask(self.predicted.residual, weight, self.inliers, count, _GROSS)
        changed = not np.array_equal(inliers, self.inliers)
        self.inliers = inliers
        if changed:
            self.normal = None
            # Outliers may have taken a group's standard deviation to zero, which the fixed point does not leave.
            self.priors = self._priors()
        return changed

    def result(self, linear: NormalEquations) -> Fit:
        """Return the fit; ``linear`` is the last linearisation."""
        equations, predicted = self.equations, self.predicted
        columns, prior = equations.columns, self.priors.precision[equations.columns]
        white = self.whitening()
        chi_square = self.whitening(self.inliers).cost(predicted.residual)
        components = float(np.count_nonzero(self.inliers) * equations.rows)
        dof = components - self.priors.effective(linear, columns)
        count = len(equations.terms)
        covariance = np.full((count, count), np.nan)
        if columns.size:
            covariance[np.ix_(columns, columns)] = linear.posterior(prior) * self._inflation(chi_square, dof)
        return Fit(
            model=self.model,
            names=tuple(term.name for term in equations.terms),
            terms=equations.terms,
            owners=equations.owners,
            theta=predicted.theta,
            covariance=covariance,
            identifiability=self.identifiability,
            noise=outliers.noise_of(self.data, self.misfit, self.options.misfit is not None and not self._has_scatter),
            misfit=self.misfit,
            inliers=self.inliers,
            data=self.data,
            residual=predicted.residual,
            weight=white.row_weight,
            whitening=white,
            scatter=self.options.scatter,
            chi_square=chi_square,
            degrees_of_freedom=dof,
            steps=self.steps,
            converged=self.converged,
            gram=linear.gram,
            rhs=linear.rhs,
            precision=prior,
            log_prior=self.priors.log_density(predicted.theta),
            group_stds=self.priors.group_stds,
            validity=tuple(effect.validity(self.model.arm, self.data) for effect in self.model.free),
        )

    def _inflation(self, chi_square: float, dof: float) -> float:
        """Return the factor that scales the covariance to the observed noise, if it exceeds the stated one."""
        if self.options.misfit is not None or dof <= 0:
            return 1.0
        return 1.0 if self.data.sigma_position is not None and self.misfit[0] == 0.0 else chi_square / dof
