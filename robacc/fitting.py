"""Nonlinear least squares over poses: Gauss-Newton with exact Jacobians, re-linearised to convergence.

Normal equations are summed over blocks of poses, so memory does not grow with their number beyond the data. Rows are
whitened by the measuring uncertainty and, where the model misses more than that, by a misfit estimated separately for
position and orientation, so lengths and angles are never mixed unweighted. Terms of a group share a Gaussian prior
whose width is the one of largest marginal likelihood (MacKay 1992; REML).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from robacc.chain import BLOCK
from robacc.closed_form import register
from robacc.effects.base import Term
from robacc.errors import EquilibriumError, InputError
from robacc.geometry import Array, Poses
from robacc.identifiability import Dropped, Identifiability, identify
from robacc.measurements import Measurements
from robacc.model import BoundModel, Model
from robacc.observation import Noise, observed_jacobian, residuals, weights

_STEPS = 40
_HALVINGS = 12
_REWEIGHTINGS = 6
_PRIOR_ROUNDS = 60
_ROUNDING = 1e-9
"""m or rad: below any instrument, above rounding; of data without noise no row is an outlier within it."""


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
    """``(M, N)``"""
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

    Base and tool, where free, are first registered in closed form, from any start.

    Raises:
        InputError: fewer components measured than coefficients to find.
        UsageError: the data lack what an effect needs.
    """
    names = {effect.name for effect in model.free}
    if names & {"base_frame", "tool_frame"} and options.start is None:
        robot = register(model.arm.robot, data, "base_frame" in names, "tool_frame" in names)
        model = Model(type(model.arm).of(robot), model.known, model.free)
    solver = _Solver(model, data, options)
    kept = np.ones(data.n, dtype=bool)
    solver.solve(kept)
    if options.robust and data.n >= 8:
        for _ in range(_REWEIGHTINGS):
            trimmed = solver.plausible(kept)
            if np.array_equal(trimmed, kept):
                break
            kept = trimmed
            solver.solve(kept)
    return solver.result(kept)


class _Solver:
    """State of one fit: blocks bound once, coefficients and weights improved in place."""

    def __init__(self, model: Model, data: Measurements, options: Options) -> None:
        self.model, self.data, self.options = model, data, options
        slices = [slice(start, min(start + BLOCK, data.n)) for start in range(0, data.n, BLOCK)]
        whole = len(slices) == 1
        self.slices = slices
        self.parts = [data if whole else data.subset(np.arange(s.start, s.stop)) for s in slices]
        self.bound: list[BoundModel] = [model.bind(part) for part in self.parts]
        self.terms = self.bound[0].terms if self.bound else ()
        self.names = tuple(term.name for term in self.terms)
        self.theta = np.zeros(len(self.terms)) if options.start is None else options.start.copy()
        self.rows = 3 if data.rotation is None else 6
        self.misfit = options.misfit or (0.0, 0.0)
        self.groups = _groups(self.terms)
        self.precision = _fixed_precision(self.terms, options.priors)
        self.widths: dict[str, float] = {}
        self.steps = 0
        self.gram, self.gradient = np.zeros((0, 0)), np.zeros(0)
        self._start_weights()
        self.identifiability = self._identify()

    # -- weights

    def _start_weights(self) -> None:
        """Without a known noise, start from what the start misses; orientation against position as they stand."""
        self.residual = self._residuals(self.theta)
        if self.options.misfit is None:
            self.misfit = _misfit(self.data, self.residual, np.ones(self.data.n, dtype=bool), 0.0, 0.0)
        self.weight = weights(self.data, *_positive(self.misfit))

    def _update_weights(self, kept: NDArray[np.bool_], effective: float) -> bool:
        """Estimate the misfit again; whether it changed enough to matter."""
        if self.options.misfit is not None:
            return False
        before = self.misfit
        share = effective * (0.5 if self.rows == 6 else 1.0)
        self.misfit = _misfit(self.data, self.residual, kept, share, share)
        self.weight = weights(self.data, *_positive(self.misfit))
        return any(abs(a - b) > self.options.settled * b for a, b in zip(self.misfit, before, strict=True))

    # -- linear algebra over blocks

    def _residuals(self, theta: Array) -> Array:
        parts = [residuals(part, bound.poses(theta)) for part, bound in zip(self.parts, self.bound, strict=True)]
        return parts[0] if len(parts) == 1 else np.concatenate(parts, axis=1)

    def _whitened(self, theta: Array, index: int) -> tuple[Array, Array]:
        poses, jacobian = self.bound[index].linearise(theta)
        residual = residuals(self.parts[index], poses)
        weight = self.weight[:, self.slices[index]]
        return residual * weight, observed_jacobian(jacobian, residual) * weight[:, None, :]

    def _identify(self) -> Identifiability:
        triangle = np.zeros((0, len(self.terms)))
        if not self.terms:
            return identify(triangle, (), self.data.n)
        for index in range(len(self.slices)):
            _, jacobian = self._whitened(self.theta, index)
            rows = np.moveaxis(jacobian, 1, 2).reshape(-1, len(self.terms))
            triangle = np.asarray(np.linalg.qr(np.concatenate((triangle, rows)), mode="r"))
        free = [i for i, term in enumerate(self.terms) if term.group is None]
        found = identify(triangle[:, free], [self.names[i] for i in free], self.data.n)
        shrunk = [i for i, term in enumerate(self.terms) if term.group is not None]
        kept = np.array(sorted([free[i] for i in found.kept] + shrunk), dtype=np.int64)
        measured = self.rows * self.data.n
        if len(found.kept) >= measured:
            raise InputError(
                f"{self.data.n} pose(s) give {measured} numbers, too few for {len(found.kept)} coefficients; "
                "measure more poses or fit fewer effects"
            )
        return dataclasses.replace(found, kept=kept)

    def _normal(self, theta: Array, kept: NDArray[np.bool_]) -> tuple[Array, Array]:
        columns = self.identifiability.kept
        gram = np.zeros((columns.size, columns.size))
        gradient = np.zeros(columns.size)
        everything = columns.size == len(self.terms)
        for index, part in enumerate(self.slices):
            residual, jacobian = self._whitened(theta, index)
            mask = kept[part]
            if not everything:
                jacobian = jacobian[:, columns]
            if not mask.all():
                residual, jacobian = residual[:, mask], jacobian[:, :, mask]
            for row in range(self.rows):
                gram += jacobian[row] @ jacobian[row].T
                gradient += jacobian[row] @ residual[row]
        return gram, gradient

    def _cost(self, residual: Array, theta: Array, kept: NDArray[np.bool_]) -> float:
        squares = np.square(residual * self.weight)[:, kept].sum()
        return float(squares + self.precision @ np.square(theta))

    # -- the loop

    def solve(self, kept: NDArray[np.bool_]) -> None:
        """Gauss-Newton to convergence, then weights and prior widths again, until nothing changes."""
        for _ in range(_REWEIGHTINGS):
            self._gauss_newton(kept)
            changed = self._fit_widths(kept) if self.groups else False
            changed = self._update_weights(kept, self.effective) or changed
            if not changed:
                break
        else:
            self._gauss_newton(kept)

    def _gauss_newton(self, kept: NDArray[np.bool_]) -> None:
        columns = self.identifiability.kept
        cost: float = self._cost(self.residual, self.theta, kept)
        previous: Array | None = None
        for _ in range(_STEPS):
            gram, gradient = self._normal(self.theta, kept)
            self.gram, self.gradient = gram, gradient
            if columns.size == 0:
                break
            precision = self.precision[columns]
            scale = 1.0 / np.sqrt(np.diag(gram) + precision)
            matrix = (gram + np.diag(precision)) * scale[:, None] * scale
            step = scale * np.linalg.solve(matrix, scale * (gradient - precision * self.theta[columns]))
            self.steps += 1
            length = float(np.sqrt(max(float(step @ gram @ step), 0.0)))
            step, previous = _extrapolated(step, previous, gram)
            cost, moved = self._line_search(step, cost, kept)
            if not moved or length <= self.options.tolerance * (1.0 + float(np.sqrt(cost))):
                break
        self._effective()

    def _line_search(self, step: Array, cost: float, kept: NDArray[np.bool_]) -> tuple[float, bool]:
        columns = self.identifiability.kept
        for halving in range(_HALVINGS):
            theta = self.theta.copy()
            theta[columns] += step * 0.5**halving
            try:
                residual = self._residuals(theta)
            except EquilibriumError:
                continue
            new = self._cost(residual, theta, kept)
            # At the minimum rounding decides which of two equal costs is the lower; a full step is then still taken.
            if new <= cost * (1 + 1e-12) + 1e-300:
                self.theta, self.residual = theta, residual
                return (new if new < cost else cost), True
        return cost, False

    def _effective(self) -> None:
        """Number of coefficients the data decided: all of them without priors, fewer with."""
        columns = self.identifiability.kept
        precision = self.precision[columns]
        if columns.size == 0 or not precision.any():
            self.effective = float(columns.size)
            return
        self.effective = float(columns.size - precision @ np.diag(self._posterior()))

    def _posterior(self) -> Array:
        precision = self.precision[self.identifiability.kept]
        scale = 1.0 / np.sqrt(np.diag(self.gram) + precision)
        scale[~np.isfinite(scale)] = 0.0
        matrix = (self.gram + np.diag(precision)) * scale[:, None] * scale
        inverse: Array = scale[:, None] * np.linalg.inv(matrix) * scale
        return inverse

    def _fit_widths(self, kept: NDArray[np.bool_]) -> bool:
        """Prior widths of largest marginal likelihood for the present linearisation (MacKay's fixed point)."""
        columns = self.identifiability.kept
        place = {int(column): i for i, column in enumerate(columns)}
        target = self.gradient + self.gram @ self.theta[columns]
        before = dict(self.widths)
        components = float(np.count_nonzero(kept) * self.rows)
        present = self.theta[columns]
        total = float(np.square(self.residual * self.weight)[:, kept].sum())
        total += float(2 * self.gradient @ present + present @ self.gram @ present)
        noise = 1.0
        for _ in range(_PRIOR_ROUNDS):
            previous = dict(self.widths)
            for name, members in self.groups.items():
                width = self.widths.setdefault(name, self.terms[members[0]].typical)
                for i in members:
                    self.precision[i] = noise / (width * self.terms[i].weight) ** 2
            posterior = self._posterior()
            theta = posterior @ target
            precision = self.precision[columns]
            for name, members in self.groups.items():
                at = [place[i] for i in members]
                sizes = np.array([self.terms[i].weight for i in members])
                decided = len(members) - float(precision[at] @ np.diag(posterior)[at])
                energy = float(np.sum(np.square(theta[at] / sizes)))
                self.widths[name] = float(np.sqrt(max(energy / max(decided, 1e-3), 1e-18)))
            if self.options.misfit is None:
                decided = columns.size - float(precision @ np.diag(posterior))
                left = total - float(2 * theta @ target - theta @ self.gram @ theta)
                noise = float(max(left / max(components - decided, 1.0), 1e-12))
            if all(abs(self.widths[k] - previous.get(k, 0.0)) <= 1e-3 * self.widths[k] for k in self.widths):
                break
        for name, members in self.groups.items():
            for i in members:
                self.precision[i] = noise / (self.widths[name] * self.terms[i].weight) ** 2
        return any(
            abs(self.widths[k] - before.get(k, 0.0)) > 10 * self.options.settled * self.widths[k] for k in self.widths
        )

    # -- outliers and result

    def plausible(self, kept: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Rows whose residual belongs to the rest: a robust scale from the median, a limit far beyond any tail."""
        square = np.square(self.residual * self.weight)
        distance = square.mean(axis=0)
        scale = float(np.median(distance)) / _MEDIAN[self.rows]
        if scale <= 0:
            return kept
        limit = _limit(self.rows, self.data.n)
        trimmed = (distance <= limit * scale) | (np.abs(self.residual).max(axis=0) <= _ROUNDING)
        return (
            trimmed if trimmed.sum() >= max(0.8 * self.data.n, len(self.identifiability.kept) / self.rows + 1) else kept
        )

    def result(self, kept: NDArray[np.bool_]) -> Fit:
        """Everything that was found."""
        columns = self.identifiability.kept
        covariance = np.full((len(self.terms), len(self.terms)), np.nan)
        chi_square = float(np.square(self.residual * self.weight)[:, kept].sum())
        freedom = float(np.count_nonzero(kept) * self.rows) - self.effective
        if columns.size:
            inflation = chi_square / freedom if self.options.misfit is None and freedom > 0 else 1.0
            if self.data.sigma_position is not None and self.misfit[0] == 0.0:
                inflation = 1.0
            covariance[np.ix_(columns, columns)] = self._posterior() * inflation
        parts = [bound.poses(self.theta) for bound in self.bound]
        poses = Poses(
            np.concatenate([part.rotation for part in parts], axis=2),
            np.concatenate([part.translation for part in parts], axis=1),
        )
        return Fit(
            self.model,
            self.names,
            self.terms,
            self.bound[0].owners,
            self.theta,
            covariance,
            self.identifiability,
            _noise(self.data, self.misfit, self.options.misfit is not None),
            self.misfit,
            kept,
            poses,
            self.residual,
            self.weight,
            chi_square,
            freedom,
            self.steps,
            self.gram,
            self.gradient + self.gram @ self.theta[columns],
            self.precision[columns],
            dict(self.widths),
        )


_MEDIAN = {3: 2.3660 / 3, 6: 5.3481 / 6}
"""Median of a chi-square variable over its degrees of freedom, 3 and 6."""


def _limit(rows: int, n: int) -> float:
    """A row's mean whitened square beyond which it is no part of the rest.

    Wilson and Hilferty's quantile of the chi-square distribution at a tail of 1e-7 / N, that is some six standard
    deviations: a structured residual that a model lacks is bounded and stays within it, a beam break does not.
    """
    tail = 5.2 + 0.2 * np.log10(max(n, 10))
    spread = 2.0 / (9.0 * rows)
    return float((1 - spread + tail * np.sqrt(spread)) ** 3)


def _extrapolated(step: Array, previous: Array | None, gram: Array) -> tuple[Array, Array | None]:
    """Along a weak direction with curvature steps shrink by a constant ratio rho and stay parallel: sum the series.

    Aitken's delta-squared in the metric of the data; the line search still judges the result.
    """
    if previous is None:
        return step, step
    energy, shared = float(previous @ gram @ previous), float(step @ gram @ previous)
    length = float(step @ gram @ step)
    if energy <= 0 or length <= 0:
        return step, step
    ratio = shared / energy
    if abs(shared) < 0.95 * np.sqrt(energy * length) or not 0.05 < abs(ratio) < 0.97:
        return step, step
    return step / (1 - ratio), None


def _groups(terms: Sequence[Term]) -> dict[str, list[int]]:
    groups: dict[str, list[int]] = {}
    for i, term in enumerate(terms):
        if term.group is not None:
            groups.setdefault(term.group, []).append(i)
    return groups


def _fixed_precision(terms: Sequence[Term], priors: Array | None) -> Array:
    # A group starts at its terms' usual size; its width is then estimated.
    precision = np.array([1.0 / (term.typical * term.weight) ** 2 if term.group else 0.0 for term in terms])
    if priors is not None:
        known = np.isfinite(priors) & (priors > 0)
        precision[known] = 1.0 / np.square(priors[known])
    return precision


def _misfit(
    data: Measurements, residual: Array, kept: NDArray[np.bool_], position_share: float, orientation_share: float
) -> tuple[float, float]:
    """Misfit of position and orientation that brings the mean whitened square to what the degrees of freedom say."""
    position = _one_misfit(residual[:3, kept], _known(data.sigma_position, kept), position_share)
    if residual.shape[0] == 3:
        return position, 0.0
    return position, _one_misfit(residual[3:, kept], _known(data.sigma_rotation, kept), orientation_share)


def _known(column: Array | None, kept: NDArray[np.bool_]) -> Array | float:
    return 0.0 if column is None else np.square(column[..., kept])


def _one_misfit(residual: Array, known: Array | float, used: float) -> float:
    """The misfit t with sum r^2 / (s^2 + t^2) = degrees of freedom; 0 where the known noise s explains it all."""
    freedom = max(residual.size - used, 0.05 * residual.size)
    square = np.square(residual)
    if isinstance(known, float):
        return float(np.sqrt(square.sum() / freedom))
    if float((square / known).sum()) <= freedom:
        return 0.0
    low, high = 0.0, float(square.sum() / freedom)
    for _ in range(60):
        middle = 0.5 * (low + high)
        if float((square / (known + middle)).sum()) > freedom:
            low = middle
        else:
            high = middle
    return float(np.sqrt(high))


def _positive(misfit: tuple[float, float]) -> tuple[float, float]:
    """A floor below any instrument's reach, so that data without any noise can be weighed at all.

    Position with noise beside orientation without any is weighed within what the normal equations can hold.
    """
    return max(misfit[0], _ROUNDING), max(misfit[1], _ROUNDING)


def _noise(data: Measurements, misfit: tuple[float, float], given: bool) -> Noise:
    position = 0.0 if data.sigma_position is None else float(np.mean(np.square(data.sigma_position)))
    orientation = 0.0 if data.sigma_rotation is None else float(np.mean(np.square(data.sigma_rotation)))
    turned = None if data.rotation is None else float(np.sqrt(orientation + misfit[1] ** 2))
    if given:
        source = "given"
    elif data.sigma_position is None:
        source = "residual"
    else:
        source = "file" if misfit[0] == 0.0 else "file and misfit"
    return Noise(float(np.sqrt(position + misfit[0] ** 2)), turned, source)  # type: ignore[arg-type]
