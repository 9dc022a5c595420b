"""Nonlinear least squares over poses: Gauss-Newton with exact Jacobians, re-linearised to convergence.

Rows are whitened by the measuring uncertainty and, where the model misses more than that, by a misfit estimated
separately for position and orientation, so lengths and angles are never mixed unweighted. Memory does not grow with the
number of poses beyond the data and what is predicted for them.
"""

import dataclasses
import math
from collections.abc import Mapping, Sequence

import numpy as np

from robacc.effects.base import SCALE_OF_INSTRUMENT, Effect, Term
from robacc.effects.specification import absorbed
from robacc.errors import EquilibriumError, InputError, refuse
from robacc.fitting.closed_form import register_frames
from robacc.fitting.fit_result import Dropped, Fit, Identifiability, Options, identify_terms
from robacc.fitting.levels import (
    ENOUGH,
    EPSILON,
    FEW,
    HALF_DIGITS,
    LARGEST,
    MANY,
    NEGLIGIBLE,
    ROUNDS,
    SETTLED,
    STEPS,
)
from robacc.fitting.normal_equations import (
    NormalEquations,
    PoseEquations,
    Whitening,
    most_likely,
    posterior,
    whitening,
)
from robacc.fitting.outliers import inlier_mask, misfits, noise_of, outlier_pattern, row_weights
from robacc.fitting.parameters import apply_fit
from robacc.fitting.visits import random_rows, visit_numbers
from robacc.geometry import Array, NDArray
from robacc.measurements import Measurements
from robacc.modelling.model import Model, joint_columns
from robacc.robots.arm import Arm
from robacc.robots.description import Robot

# Priors of a fit: the broad one of the arm's constants, given ones, and those of groups.
#
# Poses may be few, or all have one orientation. Without a prior, noise then moves a constant by centimetres along a
# direction that has no effect on these poses but does on others. Each constant of the arm therefore has a Cauchy prior
# about nominal, which near nominal is a Gaussian one with the standard deviation b of a badly made arm. Its tails are
# heavy: an arm may differ from its file by any amount that the data show. At a constant c it pulls as a Gaussian prior
# of precision 1 / (b^2 + c^2 / 2) does (iterative reweighting; Holland and Welsch 1977). Given priors are Gaussian.
#
# Terms of a group share a standard deviation, that of the largest marginal likelihood for the present linearisation
# (MacKay 1992; REML), by damped scoring.

BADLY_MADE = 3.0
"""Standard deviation of the broad prior near nominal, over the usual size of a constant: 3 mm or 3 mrad."""


def tolerance_priors(robot: Robot) -> dict[str, float]:
    """Return the robot file's tolerances as prior standard deviations, by coefficient name."""
    return {
        f"joint_offset.{joint.name}"
        if label == joint.offset_parameter
        else f"link_geometry.{joint.name}.{label}": deviation
        for joint in robot.joints
        for label, deviation in joint.tolerance.items()
    }


def broad_stds(model: Model, terms: Sequence[Term], owners: Sequence[int]) -> Array:
    """Return ``(P,)`` standard deviations of the constants' broad prior near nominal, m or rad; inf for all others.

    A constant whose tolerance in the robot file is larger than that of a badly made arm has its tolerance.
    """
    is_constant = [effect.traits.is_constant and not effect.traits.is_frame for effect in model.free]
    stated = tolerance_priors(model.arm.robot)
    return np.array(
        [
            max(BADLY_MADE * term.typical, stated.get(term.name, 0.0)) if is_constant[owner] else np.inf
            for term, owner in zip(terms, owners, strict=True)
        ]
    )


def broad_precision(std: Array, theta: Array) -> Array:
    """Return the precision ``(P,)`` with which the broad prior pulls coefficients ``theta``; 0 where ``std`` is inf."""
    return np.asarray(1.0 / (np.square(std) + 0.5 * np.square(theta)))


class Priors:
    """Precision of every coefficient's prior; broad priors and the groups' deviations are improved in place."""

    def __init__(self, terms: Sequence[Term], given: Array, broad: Array, start: Mapping[str, float]) -> None:
        """Start from standard deviations ``(P,)`` of ``given`` and ``broad`` priors, inf for none; a given one counts.

        A group starts at its standard deviation in ``start``, or at its terms' usual size.
        """
        self._broad = np.where(np.isfinite(given), np.inf, broad)
        self.is_broad = np.isfinite(self._broad)
        """``(P,)`` mask of the coefficients with a broad prior."""
        usual = {term.group: term.typical for term in reversed(terms) if term.group is not None}
        self.group_stds = {name: start.get(name, usual[name]) for name in reversed(usual)}
        """Standard deviation of each group, in units of its terms' weights."""
        self._member = np.array([[term.group == name for term in terms] for name in self.group_stds], dtype=np.float64)
        self._weights, typical = np.array([(term.weight, term.typical) for term in terms]).reshape(-1, 2).T
        self._largest = LARGEST * np.array([np.max(typical * member) for member in self._member])
        sizes = [
            start.get(term.group, term.typical) * term.weight if term.group else std
            for term, std in zip(terms, given.tolist(), strict=True)
        ]
        self.precision: Array = 1.0 / np.square(np.array(sizes, dtype=np.float64))

    def follow(self, theta: Array) -> bool:
        """Let broad priors pull as they do at ``theta`` ``(P,)``; return False, without a change, if they nearly do."""
        precision = np.where(self.is_broad, broad_precision(self._broad, theta), self.precision)
        if np.all(np.abs(self.precision - precision) <= NEGLIGIBLE * precision):
            return False
        self.precision = precision
        return True

    def update(
        self, normal: NormalEquations, columns: NDArray[np.int64], components: float, noise_known: bool
    ) -> tuple[bool, float]:
        """Maximise the marginal likelihood of the groups' deviations; return whether they changed, and the noise.

        The noise is its variance over the present one, estimated with them unless it is known. With Q = I - J C J' over
        the noise, C the posterior covariance, and w the part of the residual that a group or the noise accounts for,
        the information of two is twice w'Q w: the average of the observed and the expected one, with which scoring
        needs a few steps (Gilmour, Thompson and Cullis 1995). ``components`` counts the residuals of the inliers.
        """
        member, precision = self._member[:, columns], self.precision[columns]
        grouped = member.any(axis=0)
        scales, other = member / np.square(self._weights[columns]), np.where(grouped, 0.0, precision)

        def likelihood(log_stds: Array, least: float) -> tuple[float, Array, Array]:
            noise = math.exp(2.0 * log_stds[-1])
            prior = noise * (other + np.exp(-2.0 * log_stds[:-1]) @ scales)
            inverse = posterior(normal.gram, prior)
            theta = inverse @ normal.rhs
            step, pull = theta - normal.theta, prior * theta
            squares = normal.cost - step @ (2.0 * normal.gradient - normal.gram @ step)
            cost = (components - np.count_nonzero(~grouped)) * 2.0 * log_stds[-1] + (squares + theta @ pull) / noise
            found = 0.5 * float(np.log(prior[grouped]).sum() + np.linalg.slogdet(inverse)[1] - cost)
            determined = 1.0 - prior * np.diag(inverse)
            gradient = np.append(
                member @ (theta * pull / noise - determined), squares / noise - components + determined.sum()
            )
            # Products of the parts, those of the groups and the noise, with the columns and with each other.
            of_groups = member * theta
            along = np.vstack((of_groups @ normal.gram, pull))
            products = np.vstack((of_groups @ along.T, np.append(of_groups @ pull, squares)))
            return found, gradient, 2.0 * (products - along @ inverse @ along.T) / noise

        spread = 0.0 if noise_known else -math.log(HALF_DIGITS)
        low, high = np.log(NEGLIGIBLE * SETTLED * self._largest), np.log(self._largest)
        start = np.clip(np.log([*self.group_stds.values()]), low, high)
        bounds = np.array([[*low, -spread], [*high, spread]])
        found, _ = most_likely(likelihood, np.append(start, 0.0), bounds)
        self.group_stds = dict(zip(self.group_stds, np.exp(found[:-1]).tolist(), strict=True))
        self.precision[columns] = other + np.exp(-2.0 * found[:-1]) @ scales
        return not np.array_equal(found[:-1], start), math.exp(2.0 * found[-1])


# Gauss-Newton with exact Jacobians: the sum of whitened squares and of Gaussian priors.
#
# Residual and Jacobian of a step are one evaluation; the last step needs the residual alone. A step that would raise
# the cost is halved until it does not. Along a weakly identifiable direction a step is as long as its uncertainty and
# leaves the linear range. Halving it would hold up all other directions; damping holds up only this one. Steps that
# shrink by a factor of ten are trusted to shrink on.

_TRIALS = (
    *((0.5**halving, 0.0) for halving in range(2)),
    *((1.0, 10.0**power) for power in range(-12, 0, 2)),
    *((0.5**halving, 0.0) for halving in range(2, 12)),
)
"""Share of the step, and damping of the scaled normal matrix, whose diagonal is one; the first that serves is taken."""

_DEFAULTS = Options()
_GROSS = 5.0
"""Multiple of an outlier's limit up to which rows that share a circumstance stay in the fit."""


def fit(model: Model, data: Measurements, options: Options = _DEFAULTS) -> Fit:
    """Fit every free effect of ``model`` to ``data``.

    Free base and tool frames are first registered in closed form, from any start. Constants of the arm have a broad
    prior about nominal, unless ``options`` has one for them: noise cannot move weakly identifiable constants by
    centimetres.

    Raises:
        InputError: fewer measured components than coefficients.
        UsageError: the data lack what an effect needs.
    """
    if options.start is None and options.inliers is None and data.n > MANY:
        first = fit(model, data.subset(random_rows(data, MANY // 4)), options)
        model = first.model
        options = dataclasses.replace(options, start=first.theta, group_stds=first.group_stds)
    names = {effect.name for effect in model.free}
    if any(effect.traits.is_frame for effect in model.free) and options.start is None:
        robot = register_frames(model.arm.robot, data, "base_frame" in names, "tool_frame" in names)
        model = dataclasses.replace(model, arm=Arm.of(robot))
        if data.fixture is not None and options.inliers is None:
            model, inliers = _placed(model, data)
            options = dataclasses.replace(options, inliers=inliers) if options.robust else options
    solver = _Solver(model, data, options)
    is_trimmed = options.robust and data.n >= ENOUGH
    if is_trimmed:
        solver.trim()  # Gross rows would pull constants far from nominal, where the broad prior is weak.
    linear = solver.solve()
    for _ in range(ROUNDS):
        if not (is_trimmed and solver.trim()):
            break
        linear = solver.solve()
    return solver.result(linear)


def _placed(model: Model, data: Measurements) -> tuple[Model, NDArray[np.bool_]]:
    """Return the model with its frames at the best four fifths of the rows of each socket, plane, anchor or camera.

    A row of another socket displaces the place of its own one, so that the median of all rows does not show it, and
    would take the constants of the arm far away. Least trimmed squares find it, by concentration steps (Rousseeuw and
    Van Driessen, "Computing LTS regression for large data sets", 2006). The mask ``(N,)`` of inliers comes too.

    A gauge moves by less than the nominal arm and its tool are off, so that heights above a plane do not show its side.
    Frames, and then all coefficients, are fitted without the readings first. By this arm, the heights grow with them.
    """
    readings = data.position[2] * (data.kind == "plane")
    touching = dataclasses.replace(data, position=data.position - readings * np.eye(3)[:, 2:])
    frames = tuple(effect for effect in model.free if effect.traits.is_frame)
    alone, inliers = dataclasses.replace(model, free=frames), np.ones(data.n, dtype=bool)
    assert data.fixture is not None
    of_fixture = [np.flatnonzero(data.fixture == name) for name in np.unique(data.fixture)]
    for _ in range(ROUNDS):
        placed, before = fit(alone, touching, Options(robust=False, inliers=inliers)), inliers
        error, inliers = np.square(placed.residual * placed.weight).sum(axis=0), np.zeros(data.n, dtype=bool)
        for rows in of_fixture:
            inliers[rows[np.argsort(error[rows])[: -(-4 * rows.size // 5)]]] = True
        if np.array_equal(inliers, before):
            break
    robot = absorbed(placed.model.arm.robot, frames, dict(zip(placed.names, placed.theta.tolist(), strict=True)))
    white, every = placed.residual * placed.weight, np.ones_like(inliers)
    inliers = inlier_mask(placed.residual, white, every, len(placed.names), shown=data.shown)
    if readings.any():
        near = fit(model, touching, Options(robust=False, inliers=inliers))
        robot = dataclasses.replace(robot, fixtures=register_frames(apply_fit(near), data, True, False).fixtures)
    return dataclasses.replace(model, arm=Arm.of(robot)), inliers


class _Solver:
    """State of one fit: equations bound once; coefficients, weights and priors are improved in place."""

    def __init__(self, model: Model, data: Measurements, options: Options) -> None:
        self.model, self.data, self.options = model, data, options
        self.equations = PoseEquations(model, data)
        self.inliers = np.ones(data.n, dtype=bool) if options.inliers is None else options.inliers.copy()
        self.priors = self._priors()
        self.steps, self.converged = 0, True
        self.theta = np.zeros(len(self.equations.terms)) if options.start is None else options.start.copy()
        # The first misfit, if not given, is that of the start.
        self.residual = self.equations.residual(self.theta)
        self.misfit = options.misfit or misfits(data, self.residual, self.inliers, (0.0, 0.0))
        self.row = row_weights(data, self.misfit)
        self.scatter, self.visits = np.zeros(0), np.arange(data.n)
        self.joints = np.zeros((self.equations.components, 0, data.n))
        if options.scatter is not None and options.scatter.any():
            self.scatter, self.visits = options.scatter, visit_numbers(data)
            self.joints = joint_columns(model, data)[: len(self.joints)]
        self.latest = Whitening(np.empty(0))
        self.normal: NormalEquations | None = None
        """Linearisation at the present coefficients, weights and inliers; None if any has changed."""
        self.identifiability = self._identify()

    def whitening(self, inliers: NDArray[np.bool_]) -> Whitening:
        """Return the whitening of the inliers; the latest is kept."""
        weight = self.row if inliers.all() else self.row * inliers
        if not (self.latest.weight is weight or np.array_equal(self.latest.weight, weight)):
            noise = self.data.correlated_noise
            self.latest = whitening(weight, self.joints, self.scatter, self.visits, noise)
        return self.latest

    @property
    def _noise_is_known(self) -> bool:
        """Return whether no misfit is estimated, or the stated uncertainty explains all that the model misses."""
        return self.options.misfit is not None or (self.data.sigma_position is not None and self.misfit[0] == 0.0)

    def _row_weight(self) -> Array:
        """Return ``(M, N)`` reciprocal standard deviations of each row, noise and scatter together."""
        if not self.scatter.size:
            return self.row
        variance = np.sum(np.square(self.joints * self.scatter[:, None]), axis=1)
        return np.asarray(self.row / np.sqrt(1.0 + np.square(self.row) * variance))

    def _identify(self) -> Identifiability:
        """Find the identifiable coefficients; coefficients with a group prior always are.

        The decision is made at the nominal robot, not at a start: if axes are parallel, columns that depend on each
        other exactly look independent at fitted values, and fitting both again gives links of any length.
        """
        equations, given = self.equations, self.options.identified
        if given is not None:
            equations.columns = given.columns
            return given
        is_free = np.array([term.group is None for term in equations.terms], dtype=bool)
        at_nominal = not self.theta.any()
        if not at_nominal:
            equations.columns = np.flatnonzero(is_free)
        _, normal = equations.linearise(np.zeros(is_free.size), self.whitening(self.inliers))
        free = [term for term in equations.terms if term.group is None]
        root = normal.subset(np.flatnonzero(is_free[equations.columns])).root()
        unmeasured = self._unmeasured(free)
        root[:, list(unmeasured)] = 0.0
        identified = identify_terms(root, free, self.data.n)
        partners = {free[i].name: (partner,) for i, partner in unmeasured.items()}
        dropped = tuple(Dropped(each.name, partners.get(each.name, each.partners)) for each in identified.dropped)
        measured = self.data.count(np.ones_like(self.inliers))
        refuse(
            (
                identified.columns.size >= measured and equations.terms,
                f"{measured} numbers measured ({self.data.n} pose{'s' * (self.data.n != 1)}), too few for "
                f"{identified.columns.size} coefficients; measure more poses or fit fewer effects",
            ),
            error=InputError,
        )
        known = np.flatnonzero(is_free)[identified.columns]
        equations.columns = np.sort(np.concatenate((known, np.flatnonzero(~is_free))))
        if at_nominal:
            self.normal = normal.subset(equations.columns)
        lacking = np.setdiff1d(np.arange(self.theta.size), equations.columns)
        if self.theta[lacking].any():  # Coefficients of a start that the poses do not identify are nominal.
            self.theta[lacking] = 0.0
            self.residual = equations.residual(self.theta)
        return dataclasses.replace(identified, columns=equations.columns, dropped=dropped)

    def _unmeasured(self, free: Sequence[Term]) -> dict[int, str]:
        """Return the numbers of terms that rows without positions do not measure, and what cannot be told from them.

        Sockets, planes and anchors are wherever the first joint turns them. If the rows measure no length, an arm that
        is smaller as a whole reaches the same sockets and planes in the same joints, and one of no size fits them best:
        the longest link keeps its length. At a nominal model that misses, both would look measured.
        """
        if self.data.kind is None or (self.data.kind == "position").any():
            return {}
        arm, nominal = self.model.arm, self.equations.nominal
        motions = {i: term.parts[0].motion for i, term in enumerate(free) if len(term.parts) == 1}
        first = arm.axis_motion(arm.names[0])
        unmeasured = {i: "a turn of all that was measured" for i, motion in motions.items() if motion == first}
        lengths = [
            (float(np.max(np.abs(nominal[motion]))), i)
            for i, motion in motions.items()
            if free[i].unit == "m" and motion >= 0 and arm.chain.motions[motion].owner >= 0
        ]
        if not self.data.has_length:
            scales = [i for i, motion in motions.items() if motion == SCALE_OF_INSTRUMENT]
            longest = [max(lengths)[1]] if lengths else []
            unmeasured |= dict.fromkeys(scales + longest, "the scale of all lengths, none of which was measured,")
        return unmeasured

    def _priors(self) -> Priors:
        """Return the priors, broad ones as without constants, those of groups as at the start."""
        terms, priors = self.equations.terms, self.options.priors
        given = np.full(len(terms), np.inf) if priors is None else np.where(priors > 0, priors, np.inf)
        broad = broad_stds(self.model, terms, self.equations.owners)
        return Priors(terms, given, broad, self.options.group_stds)

    def solve(self) -> NormalEquations:
        """Alternate Gauss-Newton with updates of the weights and the groups' priors until neither changes."""
        if self.options.start is None:
            # The residual of an arm far from nominal is not noise: with weights of its size, priors outweigh the data.
            self._update_misfit(self._minimise())
        self.priors.follow(self.theta)
        for _ in range(ROUNDS):
            changed = bool(self.priors.group_stds) and self._update_groups()
            linear = self._minimise()
            changed |= self.priors.follow(self.theta)
            changed |= self._update_misfit(linear)
            if not changed:
                return linear
        return self._minimise()

    def _update_groups(self) -> bool:
        """Estimate the groups' deviations, and the noise at them; return whether they changed.

        Beside scatter, whose rows share it, the noise is the misfit, which the residual alone gives.
        """
        linear = self._linearised(self.whitening(self.inliers))
        components, is_known = float(self.data.count(self.inliers)), self._noise_is_known or self.scatter.size > 0
        changed, noise = self.priors.update(linear, self.equations.columns, components, is_known)
        self.row, self.normal = self.row / noise**0.5, linear.scaled(np.full(2, 1.0 / noise))
        return changed

    def _linearised(self, white: Whitening) -> NormalEquations:
        """Return the linearisation at the present coefficients, weights and inliers."""
        if self.normal is None:
            self.residual, self.normal = self.equations.linearise(self.theta, white)
        return self.normal

    def _minimise(self) -> NormalEquations:
        """Go to the minimum with the present weights and priors; return the last linearisation.

        The last step is one that changes the whitened prediction by less than the tolerance, or whose successors are
        expected to.
        """
        white, columns = self.whitening(self.inliers), self.equations.columns
        prior = self.priors.precision[columns]
        normal, previous = self._linearised(white), 0.0
        cost = normal.cost + float(prior @ np.square(normal.theta))
        rounding = 4.0 * EPSILON * float(white.weight.max(initial=0.0))
        self.converged = columns.size == 0
        for _ in range(STEPS if columns.size else 0):
            self.steps += 1
            step = normal.step(prior)
            length = float(np.sqrt(max(float(step @ normal.gram @ step), 0.0)))
            # Gauss-Newton converges at a constant rate in the end and faster before: a geometric series at most.
            rate = length / previous if previous > 0.0 else np.inf
            remaining = length * rate / (1.0 - rate) if rate <= NEGLIGIBLE else np.inf
            limit = max(HALF_DIGITS * (1.0 + cost**0.5), rounding * columns.size**0.5)
            is_last = min(length, remaining) <= limit
            # Near the minimum, rounding decides which of two costs is lower; a full step is then still taken.
            most = cost + 4.0 * rounding * cost**0.5 + rounding**2 * white.weight.size
            most += cost * EPSILON * white.weight.size**0.5
            for share, damping in _TRIALS:
                theta, ahead = self.theta.copy(), None
                theta[columns] += normal.step(prior, damping) if damping else share * step
                try:
                    if is_last and not damping:
                        residual = self.equations.residual(theta)
                        squares = float(white.costs(residual).sum())
                    else:
                        residual, ahead = self.equations.linearise(theta, white)
                        squares = ahead.cost
                except EquilibriumError:
                    continue
                if (tried := squares + float(prior @ np.square(theta[columns]))) <= most:
                    break
            else:
                self.converged = length <= FEW * (1.0 + cost**0.5)
                break
            self.theta, self.residual, cost = theta, residual, min(tried, cost)
            if ahead is None:
                self.converged = True
                break
            normal, previous = ahead, length if share == 1.0 and not damping else 0.0
        self.normal = normal.at(self.theta[columns], white.costs(self.residual))
        return normal

    def _update_misfit(self, linear: NormalEquations) -> bool:
        """Estimate the misfit again; return whether it changed significantly."""
        if self.options.misfit is not None:
            return False
        previous = self.misfit
        # Coefficients that position and orientation determine: with N_p and N_o their normal matrices and P the
        # precision of the priors, the traces of (N_p + N_o + P)^-1 N_p and of (N_p + N_o + P)^-1 N_o.
        inverse, used = self._inverse(linear)
        position = float(np.sum(inverse * linear.grams[0])) if self.equations.components == 6 else used
        self.misfit = misfits(self.data, self.residual, self.inliers, (position, used - position))
        before, self.row = self.row, row_weights(self.data, self.misfit)
        is_common = self.data.position_variance is None and self.data.sigma_rotation is None and not self.latest.blocks
        if self.normal is not None:
            # One misfit of all rows scales all their squares.
            ratios = np.square(self.row[[0, -1], 0] / before[[0, -1], 0])
            self.normal = self.normal.scaled(ratios) if is_common else None
        return any(abs(a - b) > SETTLED * b for a, b in zip(self.misfit, previous, strict=True))

    def _inverse(self, linear: NormalEquations) -> tuple[Array, float]:
        """Return the inverse ``(K, K)`` of the normal matrix, and how many coefficients the data determine."""
        prior = self.priors.precision[self.equations.columns]
        inverse = posterior(linear.gram, prior)
        return inverse, float(prior.size - prior @ np.diag(inverse))

    def trim(self) -> bool:
        """Find the inliers again; return whether they changed."""
        white, count = self.residual * self._row_weight(), self.equations.columns.size
        if self.data.states_covariance and not self.scatter.size:
            white = self.whitening(np.ones_like(self.inliers)).apply(self.residual)
        inliers = inlier_mask(self.residual, white, self.inliers, count, shown=self.data.shown)
        if outlier_pattern(self.data, ~inliers, self.model.arm.names) is not None:
            # Rows that share a circumstance show what the model lacks; only gross ones would spoil the fit.
            inliers = inlier_mask(self.residual, white, self.inliers, count, _GROSS, self.data.shown)
        changed = not np.array_equal(inliers, self.inliers)
        self.inliers = inliers
        if changed:
            self.normal = None
        return changed

    def result(self, linear: NormalEquations) -> Fit:
        """Return the fit; ``linear`` is the last linearisation."""
        equations, columns, count = self.equations, self.equations.columns, len(self.equations.terms)
        inverse, used = self._inverse(linear)
        chi_square = float(self.whitening(self.inliers).costs(self.residual).sum())
        dof = float(self.data.count(self.inliers)) - used
        if dof > 0 and not self._noise_is_known:
            inverse = inverse * (chi_square / dof)  # The observed noise exceeds the stated one.
        covariance = np.full((count, count), np.nan)
        covariance[np.ix_(columns, columns)] = inverse
        is_given = self.options.misfit is not None and not self.scatter.size
        return Fit(
            model=self.model,
            names=tuple(term.name for term in equations.terms),
            terms=equations.terms,
            owners=equations.owners,
            theta=self.theta,
            covariance=covariance,
            identifiability=self.identifiability,
            noise=noise_of(self.data, self.misfit, is_given),
            misfit=self.misfit,
            inliers=self.inliers,
            data=self.data,
            residual=self.residual,
            weight=self._row_weight(),
            whitening=self.whitening(np.ones_like(self.inliers)),
            scatter=self.options.scatter,
            chi_square=chi_square,
            degrees_of_freedom=dof,
            steps=self.steps,
            converged=self.converged,
            gram=linear.gram,
            rhs=linear.rhs,
            precision=self.priors.precision[columns],
            group_stds=self.priors.group_stds,
            validity=tuple(effect.validity(self.model.arm, self.data) for effect in self.model.free),
        )


def by_effect(
    effects: Sequence[Effect], owners: Sequence[int], names: Sequence[str], theta: Array
) -> dict[tuple[object, str], float]:
    """Return coefficients ``(P,)`` by the key of their effect and their name; ``owners`` are its numbers."""
    keys = [effect.key() for effect in effects]
    return {(keys[owner], name): value for owner, name, value in zip(owners, names, theta.tolist(), strict=True)}


def refit(
    like: Fit,
    free: Sequence[Effect],
    data: Measurements,
    options: Options,
    found: dict[tuple[object, str], float] | None = None,
) -> Fit:
    """Fit a model with the effects ``free``, starting at a similar fit and with that fit's registered base and tool.

    Coefficients that the similar fit lacks start at those of ``found`` (see :func:`by_effect`), or at zero. The first
    step is always taken, so the poses of ``data`` decide.
    """
    model = dataclasses.replace(like.model, free=tuple(free))
    previous = (found or {}) | by_effect(like.model.free, like.owners, like.names, like.theta)
    # A term's name does not depend on the poses, so the first row is enough to list them.
    first_row = data.subset(np.arange(1))
    start = [
        previous.get((key, term.name), 0.0)
        for effect, key in ((effect, effect.key()) for effect in free)
        for term in effect.terms(model.arm, first_row)
    ]
    # Outliers are known from the similar fit; on the same rows they start left out. What was found may explain them, as
    # a backlash explains its smaller side.
    inliers = like.inliers if options.robust and like.inliers.size == data.n and not found else None
    return fit(
        model,
        data,
        dataclasses.replace(options, start=np.array(start), inliers=inliers, group_stds=like.group_stds),
    )
