"""Nonlinear least squares over poses: Gauss-Newton with exact Jacobians, re-linearised to convergence.

Rows are whitened by the measuring uncertainty and, where the model misses more than that, by a misfit estimated
separately for position and orientation, so lengths and angles are never mixed unweighted. Memory does not grow with the
number of poses beyond the data and what is predicted for them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from robacc.effects.base import Term
from robacc.errors import InputError
from robacc.fitting import misfit as misfits
from robacc.fitting.closed_form import register_frames
from robacc.fitting.gauss_newton import minimise, posterior
from robacc.fitting.identifiability import Dropped, Identifiability, identify
from robacc.fitting.normal_equations import NormalEquations, PoseEquations
from robacc.fitting.shrinkage import Priors
from robacc.fitting.visits import visit_numbers
from robacc.fitting.weak_parameters import WEAK, prior_std, std_at_nominal
from robacc.fitting.whitening import Scatter, Whitening, whitening
from robacc.geometry import Array, Poses
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.modelling.observation import Noise
from robacc.robots.arm import Arm

_REWEIGHTINGS = 6
"""Times at most that weights and prior widths, and the rows left out, are found anew."""
_FEWEST_TO_TRIM = 8
"""Poses below which none is left out: of so few a median does not tell which is the odd one."""


@dataclass(frozen=True, slots=True)
class Options:
    """How to fit."""

    robust: bool = True
    """Leave out rows that are no part of the rest."""
    priors: Array | None = None
    """``(P,)`` prior standard deviation of each coefficient about zero; inf or NaN for none."""
    misfit: tuple[float, float] | None = None
    """Misfit of position (m) and orientation (rad), where known; else estimated."""
    tolerance: float = 1e-8
    """A step that changes the whitened prediction by less than this share of the residual is the last."""
    start: Array | None = None
    """``(P,)`` coefficients to start from; base and tool are then not registered in closed form first."""
    kept: NDArray[np.bool_] | None = None
    """``(N,)`` rows to start from; all of them where None."""
    widths: Mapping[str, float] = field(default_factory=dict)
    """Prior widths to start from, by group; the usual size of a group's terms where it has none here."""
    held: Mapping[str, float] = field(default_factory=dict)
    """Prior standard deviations (m or rad), by coefficient, of constants that the poses are known to show hardly."""
    scatter: Scatter | None = None
    """Scatter of the joints, which rows of one visit share; none where None."""
    settled: float = 1e-3
    """Misfits that change by less than this share (prior widths by ten times it) are settled."""


@dataclass(frozen=True)
class Fit:
    """A fitted model."""

    model: Model
    """With base and tool registered: coefficients are about its robot."""
    names: tuple[str, ...]
    terms: tuple[Term, ...]
    owners: tuple[int, ...]
    """For each coefficient the number of its effect among the model's free ones."""
    theta: Array
    """``(P,)``; zero where not identifiable."""
    covariance: Array
    """``(P, P)``; rows of coefficients not identified are NaN."""
    identifiability: Identifiability
    noise: Noise
    misfit: tuple[float, float]
    kept: NDArray[np.bool_]
    """``(N,)`` rows that took part."""
    poses: Poses
    """Predicted for all rows."""
    residual: Array
    """``(M, N)`` of all rows."""
    weight: Array
    """``(M, N)`` reciprocal standard deviation of each component, correlations aside."""
    whitening: Whitening
    """Map that gives the residuals of all rows unit covariance."""
    scatter: Scatter | None
    chi_square: float
    """Sum of whitened squares over rows that took part."""
    degrees_of_freedom: float
    """Components that took part less effective coefficients."""
    steps: int
    gram: Array
    """``(K, K)`` whitened normal matrix of the kept coefficients, without priors."""
    moment: Array
    """``(K,)`` right side of the normal equations: ``(gram + precision) theta = moment`` at the solution."""
    precision: Array
    """``(K,)`` prior precision."""
    widths: dict[str, float] = field(default_factory=dict)
    """Prior width of each group, in units of its terms' weights."""
    held: dict[str, float] = field(default_factory=dict)
    """Constants of the arm that the poses hardly show, by coefficient: standard deviation (m or rad) of the prior that
    holds each near the robot file's value."""

    @property
    def dropped(self) -> tuple[Dropped, ...]:
        """Coefficients without a number."""
        return self.identifiability.dropped

    def without(self, effects: Collection[int]) -> Array:
        """``(P,)`` coefficients that least squares gives where those of some free effects are zero, to first order."""
        columns = self.identifiability.kept
        rest = np.array([self.owners[i] not in effects for i in columns], dtype=bool)
        theta = np.zeros_like(self.theta)
        matrix = (self.gram + np.diag(self.precision))[np.ix_(rest, rest)]
        scale = 1.0 / np.sqrt(np.diag(matrix))
        theta[columns[rest]] = scale * np.linalg.solve(matrix * scale[:, None] * scale, scale * self.moment[rest])
        return theta

    @property
    def outliers(self) -> NDArray[np.int64]:
        """Rows left out."""
        return np.flatnonzero(~self.kept)


def fit(model: Model, data: Measurements, options: Options = Options()) -> Fit:
    """Fit every free effect of ``model`` to ``data``.

    Base and tool, where free, are first registered in closed form, from any start. Constants of the arm that the poses
    hardly show would drift by centimetres for what noise makes of it; they are held by a prior as wide as a badly made
    arm is off. All others are as free as they were: an arm may be another than its file says.

    Raises:
        InputError: fewer components measured than coefficients to find.
        UsageError: the data lack what an effect needs.
    """
    names = {effect.name for effect in model.free}
    if any(effect.is_frame for effect in model.free) and options.start is None:
        robot = register_frames(model.arm.robot, data, "base_frame" in names, "tool_frame" in names)
        model = dataclasses.replace(model, arm=Arm.of(robot))
    solver = _Solver(model, data, options)
    solver.solve_held()
    if options.robust and data.n >= _FEWEST_TO_TRIM:
        for _ in range(_REWEIGHTINGS):
            if not solver.trim():
                break
            solver.solve_held()
    return solver.result()


class _Solver:
    """State of one fit: equations bound once, coefficients, weights and priors improved in place."""

    def __init__(self, model: Model, data: Measurements, options: Options) -> None:
        self.model, self.data, self.options = model, data, options
        self.equations = PoseEquations(model, data)
        terms = self.equations.terms
        self.kept = np.ones(data.n, dtype=bool) if options.kept is None else options.kept.copy()
        self.held = {term.name: options.held[term.name] for term in terms if term.name in options.held}
        self.priors = self._priors()
        self.steps = 0
        # Without a known noise, from what the start misses; orientation against position as they stand.
        start = np.zeros(len(terms)) if options.start is None else options.start.copy()
        self.outcome = self.equations.outcome(start, ahead=not start.any())
        self.misfit = options.misfit or misfits.estimate(data, self.outcome.residual, self.kept, 0.0)
        self.columns = self.equations.joint_columns(model) if self._has_scatter else None
        self.weight = misfits.row_weights(data, self.misfit)
        self.linear: NormalEquations
        """The last linearisation, once solved."""
        self.normal: NormalEquations | None = None
        """The linearisation where the coefficients stand, while weights and rows are those it was made with."""
        self.identifiability = self._identify()

    @property
    def _has_scatter(self) -> bool:
        return self.options.scatter is not None and not self.options.scatter.is_none

    def _white(self, inliers: NDArray[np.bool_] | None = None) -> Whitening:
        """Map of the rows that take part, or of all of them where ``inliers`` is None."""
        weight = self.weight if inliers is None else self.weight * inliers
        if self.columns is None or self.options.scatter is None:
            return Whitening(weight)
        visits, poses = visit_numbers(self.data), self.data.groups()
        return whitening(weight, self.columns, self.options.scatter, visits, poses)

    def _identify(self) -> Identifiability:
        """Find what the poses can tell apart; shrunk coefficients are told apart by their priors.

        At the nominal robot and not at a start: where axes are parallel, columns that depend on each other exactly
        look apart by what was fitted, and fitting both again gives links of any length.
        """
        terms = self.equations.terms
        nominal = np.zeros(len(terms))
        triangle, normal = self.equations.factorise(nominal, self._white())
        free = [i for i, term in enumerate(terms) if term.group is None]
        names, units = [terms[i].name for i in free], [terms[i].unit for i in free]
        found = identify(triangle[:, free], names, self.data.n, units)
        measured = self.equations.rows * self.data.n
        if found.kept.size >= measured and terms:
            raise InputError(
                f"{measured} numbers measured ({self.data.n} pose{'s' * (self.data.n != 1)}), too few for "
                f"{found.kept.size} coefficients; measure more poses or fit fewer effects"
            )
        shrunk = [i for i, term in enumerate(terms) if term.group is not None]
        kept = np.array(sorted([free[i] for i in found.kept] + shrunk), dtype=np.int64)
        self.equations.columns = kept
        if np.array_equal(self.outcome.theta, nominal):
            self.normal = normal.of(kept)
        return dataclasses.replace(found, kept=kept)

    def _priors(self) -> Priors:
        priors = Priors(self.equations.terms, self.options.priors, self.options.widths)
        for i, term in enumerate(self.equations.terms):
            if term.name in self.held:
                priors.precision[i] = max(priors.precision[i], self.held[term.name] ** -2)
        return priors

    def solve_held(self) -> None:
        """Solve, with a prior on every constant of the arm that the poses hardly show.

        From a start that is near, such constants are held from the first step; else once everything else was found,
        since the noise that a start far off seems to have would hold them all.
        """
        if self.held:
            self._hold(std_at_nominal(self.equations, self._white(self.kept), self.priors.precision))
        self.solve()
        spread = np.sqrt(np.diag(posterior(self.linear.gram, self.priors.precision[self.equations.columns])))
        widths = prior_std(self.equations, self.model)
        drifted = np.abs(self.outcome.theta[self.equations.columns]) > widths
        if not (drifted.any() or np.any(spread > WEAK * widths)):
            return
        if self._hold(std_at_nominal(self.equations, self._white(self.kept), self.priors.precision)):
            if drifted.any():
                # What went with it is as far off.
                self.outcome, self.normal = self.equations.outcome(np.zeros(len(self.equations.terms))), None
            self.solve()

    def _hold(self, spread: Array) -> bool:
        """Put a prior on constants whose standard errors are large; whether more of them have one now."""
        before, widths = len(self.held), prior_std(self.equations, self.model)
        for place in np.flatnonzero(spread > WEAK * widths):
            column, width = self.equations.columns[place], float(widths[place])
            self.held[self.equations.terms[column].name] = width
            self.priors.precision[column] = max(self.priors.precision[column], width**-2)
        return len(self.held) > before

    def solve(self) -> None:
        """Gauss-Newton to convergence, then weights and prior widths again, until nothing changes."""
        for _ in range(_REWEIGHTINGS):
            linear = self._minimise()
            changed = False
            columns = self.equations.columns
            if self.priors.groups:
                components = float(np.count_nonzero(self.kept) * self.equations.rows)
                known, settled = self.options.misfit is not None, 10 * self.options.settled
                changed = self.priors.widen(linear, columns, components, known, settled)
            changed = self._weigh(self.priors.effective(linear.gram, columns)) or changed
            if not changed:
                break
        else:
            self._minimise()

    def _minimise(self) -> NormalEquations:
        precision, tolerance = self.priors.precision, self.options.tolerance
        found = minimise(self.equations, self.outcome, self.normal, self._white(self.kept), precision, tolerance)
        self.outcome, self.linear = found.outcome, found.normal
        self.steps += found.steps
        self.normal = None
        return self.linear

    def _weigh(self, effective: float) -> bool:
        """Estimate the misfit again; whether it changed enough to matter."""
        if self.options.misfit is not None:
            return False
        before = self.misfit
        self.misfit = misfits.estimate(self.data, self.outcome.residual, self.kept, effective)
        self.weight = misfits.row_weights(self.data, self.misfit)
        return any(abs(a - b) > self.options.settled * b for a, b in zip(self.misfit, before, strict=True))

    def trim(self) -> bool:
        """Leave out rows that are no part of the rest; whether they are others than before."""
        weight, count = self._white().row_weight, self.equations.columns.size
        kept = misfits.inlier_mask(self.outcome.residual, weight, self.kept, count)
        changed = not np.array_equal(kept, self.kept)
        self.kept = kept
        if changed:
            # Widths that such rows were part of may have gone to zero, from where no fixed point leads back.
            self.priors = self._priors()
        return changed

    def result(self) -> Fit:
        """Everything that was found."""
        equations, outcome, linear = self.equations, self.outcome, self.linear
        columns, prior = equations.columns, self.priors.precision[equations.columns]
        white = self._white()
        chi_square = float(np.square(self._white(self.kept).apply(outcome.residual)).sum())
        components = float(np.count_nonzero(self.kept) * equations.rows)
        freedom = components - self.priors.effective(linear.gram, columns)
        count = len(equations.terms)
        covariance = np.full((count, count), np.nan)
        if columns.size:
            inverse = posterior(linear.gram, prior) * self._inflation(chi_square, freedom)
            covariance[np.ix_(columns, columns)] = inverse
        return Fit(
            model=self.model,
            names=tuple(term.name for term in equations.terms),
            terms=equations.terms,
            owners=equations.owners,
            theta=outcome.theta,
            covariance=covariance,
            identifiability=self.identifiability,
            noise=misfits.noise_of(self.data, self.misfit, self.options.misfit is not None and not self._has_scatter),
            misfit=self.misfit,
            kept=self.kept,
            poses=outcome.joined(),
            residual=outcome.residual,
            weight=white.row_weight,
            whitening=white,
            scatter=self.options.scatter,
            chi_square=chi_square,
            degrees_of_freedom=freedom,
            steps=self.steps,
            gram=linear.gram,
            moment=linear.moment,
            precision=prior,
            widths=dict(self.priors.widths),
            held=dict(self.held),
        )

    def _inflation(self, chi_square: float, freedom: float) -> float:
        """What brings the covariance to the noise seen, where the file's does not explain it all."""
        if self.options.misfit is not None or freedom <= 0:
            return 1.0
        return 1.0 if self.data.sigma_position is not None and self.misfit[0] == 0.0 else chi_square / freedom
