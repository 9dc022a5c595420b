"""Hypotheses on mistakes in the data, screened with base and target registered, and the choice of the simplest."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from robacc.diagnostics.changes import JointChange, MeasuredPoses, reversed_signs
from robacc.geometry import Array, Poses
from robacc.measurements import Measurements
from robacc.modelling.model import predict
from robacc.robots.description import Frame, Robot

# A mistake in the data or the robot file, as it is reported.


@dataclass(frozen=True, slots=True)
class Mistake:
    """Mistake, or several together, in the data or the robot file, and the error with and without it."""

    name: str
    fix: str
    before: float
    """Median position error of the registered nominal model, m."""
    after: float
    """The same with the mistake corrected, m."""
    orientation_before: float | None = None
    """Median orientation error of the registered nominal model, rad."""
    orientation_after: float | None = None
    alternatives: tuple[str, ...] = ()
    """Other mistakes that explain these poses as well."""
    unseen: tuple[str, ...] = ()
    """Joints whose sign these poses do not show."""

    @property
    def text(self) -> str:
        """Return the message."""
        errors = f"the median error is {self.before * 1e3:.3g} mm, and {self.after * 1e3:.3g} mm after this correction"
        if self.orientation_before is not None and self.orientation_after is not None:
            before, after = math.degrees(self.orientation_before), math.degrees(self.orientation_after)
            if self.after > self.before / 2:
                errors = f"the median orientation error is {before:.3g} degrees, and {after:.2g} after this correction"
        text = f"{self.name}: with base and tool registered, {errors}; {self.fix}"
        if self.alternatives:
            text += f". Not distinguishable on these poses: {'; or '.join(self.alternatives)}"
        if self.unseen:
            text += f". These poses do not show the sign of {', '.join(self.unseen)}"
        return text


# Registration of the base and of each target for many hypotheses at once, in closed form.
#
# With F the arm's own pose (base to last link), R the rotation from the measuring frame to the base and g the target
# on the last link, a measured position p obeys R p = p_F + R_F g + u. For a given R the best g and u are linear in R,
# so that the squared error is a quadratic form in the nine elements of R, whatever the number of poses. Its minimum
# without the constraint, made orthogonal, is the start of a few Gauss-Newton steps on the rotation. Orientations obey
# R_B R_F R_G = measured; R_B and R_G come from the leading singular vectors of the mean of R_F ⊗ measured.
#
# Hypotheses are the leading axis H of every array; a stack of H matrices has the shape ``(H, m, m)``.

_PASSES = 3
"""Fits of a registration that outliers do not disturb."""
_STEPS = 5
"""Gauss-Newton steps of the rotation."""
_LONGEST_STEP = 0.5
"""rad; longest step of the rotation."""
_CAUCHY = 3.0
"""Median errors at which a row has half its weight."""
_RIDGE = 1e-9
"""Share of the largest diagonal element by which normal matrices are regularised: directions that are not identifiable
(the height of a SCARA's target) stay where they are."""
_GENERATORS = np.array(
    [
        [[0, 0, 0], [0, 0, -1], [0, 1, 0]],
        [[0, 0, 1], [0, 0, 0], [-1, 0, 0]],
        [[0, -1, 0], [1, 0, 0], [0, 0, 0]],
    ],
    dtype=float,
)


@dataclass(frozen=True, slots=True)
class BatchFit:
    """Registration of positions or of orientations for each of H hypotheses."""

    errors: Array
    """``(H, N)`` length (m) or angle (rad) of the remaining error."""
    rotation: Array
    """``(H, 3, 3)`` rotation from the measuring frame to the base."""

    @property
    def median(self) -> Array:
        """Return the median error ``(H,)``, m or rad."""
        return np.asarray(np.median(self.errors, axis=1))


def register_positions(
    rotation: Array,
    translation: Array,
    measured: Array,
    target: NDArray[np.int64],
    n_targets: int,
    *,
    turn: Array | None = None,
    passes: int = _PASSES,
) -> BatchFit:
    """Register base and targets to measured positions.

    Args:
        rotation: ``(H, N, 3, 3)`` orientation of the last link in the base.
        translation: ``(H, N, 3)`` its position, m.
        measured: ``(H or 1, N, 3)`` measured positions, m.
        target: ``(N,)`` number of each row's target.
        n_targets: Number of targets.
        turn: ``(H, 3, 3)`` known rotation from the measuring frame to the base; None to fit it.
        passes: Fits, each with the rows weighted by their errors in the one before.
    """
    measured = measured - measured.mean(axis=1, keepdims=True)
    translation = translation - translation.mean(axis=1, keepdims=True)
    mask = np.zeros((n_targets, target.size))
    mask[target, np.arange(target.size)] = 1.0
    weight = np.ones(translation.shape[:2])
    for _ in range(passes):
        form = _QuadraticForm(rotation, translation, measured, mask, weight)
        fitted = form.best_rotation() if turn is None else turn
        errors = form.errors(fitted)
        typical = np.maximum(np.median(errors, axis=1, keepdims=True), 1e-12)
        weight = 1.0 / (1.0 + np.square(errors / (_CAUCHY * typical)))
    return BatchFit(errors, fitted)


def register_orientations(rotation: Array, measured: Array) -> BatchFit:
    """Register base and target to measured orientations.

    Args:
        rotation: ``(H, N, 3, 3)`` orientation of the last link in the base.
        measured: ``(H or 1, N, 3, 3)`` measured orientations.
    """
    h, n = rotation.shape[:2]
    measured = np.broadcast_to(measured, rotation.shape)
    weight = np.ones((h, n))
    for _ in range(_PASSES):
        # (i, j), (l, k) of R_F and the measured orientation; see robacc.fitting.closed_form.
        first = (rotation * weight[..., None, None]).reshape(h, n, 9)
        mixed = (np.swapaxes(first, 1, 2) @ measured.reshape(h, n, 9)).reshape(h, 3, 3, 3, 3)
        left, _, right = np.linalg.svd(mixed.transpose(0, 2, 4, 3, 1).reshape(h, 9, 9))
        tool, base = left[:, :, 0].reshape(h, 3, 3), right[:, 0, :].reshape(h, 3, 3)
        sign = np.where(np.linalg.det(tool) < 0, -1.0, 1.0)[:, None, None]
        tool, base = nearest_rotation(sign * tool), nearest_rotation(sign * base)
        predicted = base[:, None] @ rotation @ tool[:, None]
        trace = np.einsum("hnij,hnij->hn", predicted, measured)
        errors = np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0))
        typical = np.maximum(np.median(errors, axis=1, keepdims=True), 1e-12)
        weight = 1.0 / (1.0 + np.square(errors / (_CAUCHY * typical)))
    return BatchFit(errors, np.swapaxes(base, 1, 2))


def orientation_errors(rotation: Array, measured: Array, base: Array) -> Array:
    """Return the median orientation error ``(H,)``, rad, with the target registered and the base's rotation known.

    Args:
        rotation: ``(H, N, 3, 3)`` orientation of the last link in the base.
        measured: ``(H or 1, N, 3, 3)`` measured orientations.
        base: ``(H, 3, 3)`` rotation from the measuring frame to the base.
    """
    turned = base[:, None] @ measured
    tool = nearest_rotation(np.einsum("hnji,hnjk->hik", rotation, turned))
    trace = np.einsum("hnij,hnij->hn", rotation @ tool[:, None], turned)
    return np.asarray(np.median(np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0)), axis=1))


def nearest_rotation(matrix: Array) -> Array:
    """Return the rotations nearest to a stack of 3 x 3 matrices (polar factor; Kabsch 1976)."""
    u, _, vt = np.linalg.svd(matrix)
    u[..., :, 2] *= np.sign(np.linalg.det(u @ vt))[..., None]
    result: Array = u @ vt
    return result


class _QuadraticForm:
    """Squared position error as a function of the nine elements of R, row by row: ``r A r - 2 b r + c``."""

    def __init__(self, rotation: Array, translation: Array, measured: Array, mask: Array, weight: Array) -> None:
        """Eliminate shift and targets; ``mask`` ``(T, N)`` assigns rows to targets."""
        h, n = weight.shape
        targets = mask.shape[0]
        self._arm = (rotation, translation, np.broadcast_to(measured, translation.shape), mask)
        size = 3 + 3 * targets
        total = weight.sum(axis=1)
        weights = mask[:, None, :] * weight[None]  # (T, H, N)
        point = self._arm[2]
        # Sums of weight x R_F, weight x R_F[c, a] p[b], weight x R_F^T p_F, by target.
        turned = np.einsum("thn,hnca->thca", weights, rotation, optimize=True)
        by_row = rotation.reshape(h, n, 9)
        mixed = np.stack([np.swapaxes(by_row * w[..., None], 1, 2) @ point for w in weights])  # (T, H, 9, 3)
        mixed = mixed.reshape(targets, h, 3, 3, 3)  # (T, H, c, a, b)
        own = np.einsum("hnca,hnc->hna", rotation, translation)
        normal = np.zeros((h, size, size))
        columns = np.zeros((h, size, 9))
        rhs = np.zeros((h, size))
        normal[:, :3, :3] = total[:, None, None] * np.eye(3)
        sums = np.einsum("hn,hnb->hb", weight, point)
        for c in range(3):
            columns[:, c, 3 * c : 3 * c + 3] = sums
        rhs[:, :3] = np.einsum("hn,hnc->hc", weight, translation)
        for k in range(targets):
            at = slice(3 + 3 * k, 6 + 3 * k)
            normal[:, :3, at] = turned[k]
            normal[:, at, :3] = np.swapaxes(turned[k], 1, 2)
            normal[:, at, at] = weights[k].sum(axis=1)[:, None, None] * np.eye(3)
            columns[:, at] = np.swapaxes(mixed[k], 1, 2).reshape(h, 3, 9)
            rhs[:, at] = np.einsum("hn,hna->ha", weights[k], own)
        normal += _RIDGE * total[:, None, None] * np.eye(size)
        self._solved = np.linalg.solve(normal, np.concatenate([columns, rhs[..., None]], axis=2))
        weighted = point * weight[..., None]
        second = np.swapaxes(weighted, 1, 2) @ point
        self._a = np.zeros((h, 9, 9))
        for c in range(3):
            self._a[:, 3 * c : 3 * c + 3, 3 * c : 3 * c + 3] = second
        self._covariance = (np.swapaxes(translation, 1, 2) @ weighted).reshape(h, 9)
        across = np.swapaxes(columns, 1, 2)
        self._a -= across @ self._solved[..., :9]
        self._b = self._covariance - (across @ self._solved[..., 9:])[..., 0]

    def best_rotation(self) -> Array:
        """Return the rotation ``(H, 3, 3)`` of least squared error that two starts lead to."""
        scale = np.trace(self._a, axis1=1, axis2=2)[:, None, None] / 9.0 + 1e-30
        free = np.linalg.solve(self._a + 1e-8 * scale * np.eye(9), self._b[..., None])[..., 0]
        starts = (free, self._covariance)
        best, least = None, None
        for start in starts:
            turn, cost = self._refined(nearest_rotation(start.reshape(-1, 3, 3)))
            if best is None or least is None:
                best, least = turn, cost
            else:
                better = cost < least
                best = np.where(better[:, None, None], turn, best)
                least = np.where(better, cost, least)
        assert best is not None
        return best

    def _refined(self, turn: Array) -> tuple[Array, Array]:
        """Return the rotation after Gauss-Newton steps, and its cost."""
        best, least = turn, self._cost(turn)
        for _ in range(_STEPS):
            tangent = np.einsum("kij,hjl->hilk", _GENERATORS, turn).reshape(-1, 9, 3)
            gradient = np.einsum("hmn,hn->hm", self._a, turn.reshape(-1, 9)) - self._b
            transposed = np.swapaxes(tangent, 1, 2)
            normal = transposed @ self._a @ tangent
            size = np.trace(normal, axis1=1, axis2=2)[:, None, None] + 1e-30
            step = -np.linalg.solve(normal + 1e-9 * size * np.eye(3), transposed @ gradient[..., None])[..., 0]
            length = np.linalg.norm(step, axis=1, keepdims=True)
            step *= np.minimum(1.0, _LONGEST_STEP / np.maximum(length, 1e-30))
            turn = nearest_rotation(turn + np.einsum("hk,kij,hjl->hil", step, _GENERATORS, turn))
            cost = self._cost(turn)
            better = cost < least
            best, least = np.where(better[:, None, None], turn, best), np.where(better, cost, least)
        return best, least

    def _cost(self, turn: Array) -> Array:
        r = turn.reshape(-1, 9)
        return np.asarray(np.einsum("hm,hmn,hn->h", r, self._a, r) - 2.0 * np.sum(r * self._b, axis=1))

    def errors(self, turn: Array) -> Array:
        """Return the length of each row's error ``(H, N)`` with the best shift and targets for these rotations."""
        rotation, translation, point, mask = self._arm
        solved = (self._solved[..., :9] @ turn.reshape(-1, 9, 1) - self._solved[..., 9:])[..., 0]
        offset = solved[:, 3:].reshape(solved.shape[0], -1, 3)[:, np.argmax(mask, axis=0)]  # (H, N, 3)
        predicted = translation + solved[:, None, :3] + np.einsum("hnca,hna->hnc", rotation, offset)
        return np.asarray(np.linalg.norm(point @ np.swapaxes(turn, 1, 2) - predicted, axis=2))


# Screening of hypotheses on data mistakes: base and target registered for many hypotheses at once, on a few rows.

_ROWS = 60
"""Rows that the screening uses at most."""
_ROUGH_ROWS = 30
"""The same of the rough fits."""
_BATCH = 400
"""Hypotheses per batch, which bounds the memory."""
_MOST_ANGLE = 0.5
"""rad; orientation error beyond which a hypothesis is as bad as any."""


@dataclass(frozen=True, slots=True)
class Sample:
    """Rows of the measured poses that the screening uses."""

    data: Measurements
    target: NDArray[np.int64]
    """``(N,)`` number of each row's target."""
    n_targets: int

    @classmethod
    def of(cls, robot: Robot, data: Measurements, most: int = _ROWS) -> Sample:
        """Return up to ``most`` rows, spread evenly over the data."""
        rows = np.unique(np.linspace(0, data.n - 1, min(data.n, most)).astype(int))
        sample = data.subset(rows)
        target, n_targets = target_numbers(robot, sample)
        return cls(sample, target, n_targets)


def target_numbers(robot: Robot, data: Measurements) -> tuple[NDArray[np.int64], int]:
    """Return the number of each row's target, and of targets that occur."""
    if data.target is None or not robot.targets:
        return np.zeros(data.n, dtype=np.int64), 1
    _, number = np.unique(data.target, return_inverse=True)
    return number.astype(np.int64).ravel(), int(number.max()) + 1


def arm_poses(robot: Robot, data: Measurements, q: Array) -> tuple[Array, Array]:
    """Return the last link's rotations ``(H, N, 3, 3)`` and positions ``(H, N, 3)`` at joints ``(H, J, N)``."""
    h, joints, n = q.shape
    bare = dataclasses.replace(robot, tool=Frame(), targets={})
    rows = data.subset(np.tile(np.arange(n), h))
    rows = dataclasses.replace(rows, q=q.transpose(1, 0, 2).reshape(joints, h * n))
    poses: Poses = predict(bare, rows)
    rotation = np.moveaxis(poses.rotation, 2, 0).reshape(h, n, 3, 3)
    return rotation, poses.translation.T.reshape(h, n, 3)


@dataclass(frozen=True, slots=True)
class Screen:
    """Registered misfit of H hypotheses."""

    position: Array
    """``(H,)`` median position error with base and target registered to the positions, m."""
    position_rotation: Array
    """``(H, 3, 3)`` rotation from the measuring frame to the base, of the positions."""
    orientation: Array | None
    """``(H,)`` median orientation error with base and target registered, rad."""
    orientation_rotation: Array | None
    """``(H, 3, 3)`` the same of the orientations."""
    joint_position: Array
    """``(H,)`` median position error with a base that the orientations have in common, m; else :attr:`position`."""
    spread: float
    """Standard deviation of the measured positions, m."""

    @property
    def total(self) -> Array:
        """Return the misfit ``(H,)``: position error over the spread, plus orientation error in rad."""
        if self.orientation is None:
            return self.position / self.spread
        return np.asarray(self.joint_position / self.spread + self.orientation)

    @property
    def rank(self) -> Array:
        """Return ``(H,)`` what orders hypotheses: tolerant of orientations that are wrong in themselves."""
        if self.orientation is None:
            return self.position / self.spread
        return np.asarray(self.position / self.spread + 0.3 * np.minimum(self.orientation, _MOST_ANGLE))

    def rotations(self, i: int) -> tuple[Array, Array] | None:
        """Return the base's rotations of positions and of orientations of hypothesis ``i``; None without the latter."""
        if self.orientation_rotation is None:
            return None
        return self.position_rotation[i], self.orientation_rotation[i]


def screen(robot: Robot, sample: Sample, q: Sequence[Array], position: Array, rotation: Array | None) -> Screen:
    """Return the misfit of each set of joint variables against measured poses.

    Args:
        robot: Robot, whose base and targets are registered.
        sample: Rows.
        q: Joint variables ``(J, N)`` of each hypothesis.
        position: ``(3, N)`` measured positions, m.
        rotation: ``(3, 3, N)`` measured orientations, or None.
    """
    parts = [
        _screened(robot, sample, np.stack(q[i : i + _BATCH]), position, rotation) for i in range(0, len(q), _BATCH)
    ]
    if len(parts) == 1:
        return parts[0]

    def joined(name: str) -> Array | None:
        values = [getattr(part, name) for part in parts]
        return None if values[0] is None else np.concatenate(values)

    changes = {field.name: joined(field.name) for field in dataclasses.fields(Screen) if field.name != "spread"}
    return dataclasses.replace(parts[0], **changes)  # type: ignore[arg-type]


def most_likely(robot: Robot, sample: Sample, q: Sequence[Array], position: Array, count: int) -> NDArray[np.int64]:
    """Return the indices of the ``count`` hypotheses that fit the positions of some rows best, by a rough fit."""
    rows = np.linspace(0, sample.data.n - 1, min(sample.data.n, _ROUGH_ROWS)).astype(int)
    data, point = sample.data.subset(rows), position.T[None, rows]
    medians = []
    for i in range(0, len(q), _BATCH):
        poses = arm_poses(robot, data, np.stack(q[i : i + _BATCH])[..., rows])
        medians.append(register_positions(*poses, point, sample.target[rows], sample.n_targets, passes=1).median)
    return np.argsort(np.concatenate(medians), kind="stable")[:count]


def _screened(robot: Robot, sample: Sample, q: Array, position: Array, rotation: Array | None) -> Screen:
    arm_rotation, arm_position = arm_poses(robot, sample.data, q)
    point = position.T[None]
    targets = (sample.target, sample.n_targets)
    free: BatchFit = register_positions(arm_rotation, arm_position, point, *targets)
    spread = max(float(np.sqrt(np.var(position, axis=1).sum())), 1e-12)
    if rotation is None:
        return Screen(free.median, free.rotation, None, None, free.median, spread)
    measured = np.moveaxis(rotation, 2, 0)[None]
    turned: BatchFit = register_orientations(arm_rotation, measured)
    common = register_positions(arm_rotation, arm_position, point, *targets, turn=turned.rotation).median
    # Orientations that hardly vary do not show the base, which the positions then show.
    other = orientation_errors(arm_rotation, measured, free.rotation)
    by_positions = free.median / spread + other < common / spread + turned.median
    return Screen(
        free.median,
        free.rotation,
        np.where(by_positions, other, turned.median),
        turned.rotation,
        np.where(by_positions, free.median, common),
        spread,
    )


# Hypothesis on mistakes in the data, and the choice of the simplest that explains them.

_SAME = 1.5
"""Ratio of errors up to which two hypotheses are not distinguishable."""
_MOST_ALTERNATIVES = 3
_MORE_MISTAKES = 2
"""Mistakes that an alternative has at most beyond those of the simplest hypothesis."""


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """Mistakes that are undone together, and the registered error that remains."""

    robot: Robot
    other_convention: bool
    measured: MeasuredPoses
    changes: tuple[JointChange, ...]
    total: float
    """Position error over the spread of the positions, plus orientation error in rad."""
    rank: float
    """The same, tolerant of orientations that are wrong in themselves."""
    position: float
    """Median position error, m."""
    orientation: float | None
    """Median orientation error, rad."""

    @property
    def complexity(self) -> int:
        """Return the number of mistakes."""
        joints = sum(change.complexity for change in self.changes)
        return joints + self.measured.complexity + self.other_convention

    @property
    def signs(self) -> frozenset[str]:
        """Return the joints whose sign is reversed."""
        signs: frozenset[str] = frozenset()
        for change in self.changes:
            signs ^= change.signs
        return signs

    @property
    def _merged(self) -> list[JointChange]:
        """Return the changes with all signs as one."""
        names = self.robot.variable_names
        reversed_joints = [i for i, name in enumerate(names) if name in self.signs]
        signs = [reversed_signs(names, reversed_joints)] if reversed_joints else []
        return [*signs, *(change for change in self.changes if not change.signs)]

    @property
    def only_signs(self) -> bool:
        """Return whether all mistakes are signs of joints."""
        return not self.measured.texts and not self.other_convention and all(item.signs for item in self.changes)

    @property
    def texts(self) -> tuple[str, ...]:
        """Return what is wrong, by mistake."""
        table = (f"the table seems to be of the {self.robot.convention} Denavit-Hartenberg convention",)
        return (
            *self.measured.texts,
            *(table if self.other_convention else ()),
            *(change.text for change in self._merged),
        )

    @property
    def fixes(self) -> tuple[str, ...]:
        """Return how to correct it, by mistake."""
        table = (f"set convention: {self.robot.convention}",)
        return (
            *self.measured.fixes,
            *(table if self.other_convention else ()),
            *(change.fix for change in self._merged),
        )


def hypothesis(
    robot: Robot,
    measured: MeasuredPoses,
    changes: tuple[JointChange, ...],
    result: Screen,
    i: int,
    other_convention: bool,
) -> Hypothesis:
    """Return hypothesis ``i`` of a screening."""
    return Hypothesis(
        robot,
        other_convention,
        measured,
        changes,
        float(result.total[i]),
        float(result.rank[i]),
        float(result.joint_position[i]),
        None if result.orientation is None else float(result.orientation[i]),
    )


def simplest(pool: Sequence[Hypothesis], null: Hypothesis, improvement: float) -> Mistake | None:
    """Return the simplest of the hypotheses that explain the error; None if none does.

    Args:
        pool: Hypotheses.
        null: The data as they are.
        improvement: Factor by which a correction has to reduce the error.
    """
    least = min(item.total for item in pool)
    if least * improvement >= null.total:
        return None
    limit = min(_SAME * least, null.total / improvement)
    equal = sorted(
        (item for item in pool if item.total <= limit and item.texts), key=lambda item: (item.complexity, item.total)
    )
    best = equal[0]
    alternatives: list[str] = []
    unseen: set[str] = set()
    for item in equal[1:]:
        if item.only_signs and best.only_signs and item.signs > best.signs:
            unseen |= item.signs - best.signs
        elif item.complexity <= best.complexity + _MORE_MISTAKES and not set(best.texts) <= set(item.texts):
            alternatives.append(" and ".join(item.texts))
    return Mistake(
        "; ".join(best.texts),
        "; ".join(dict.fromkeys(best.fixes)),
        null.position,
        best.position,
        null.orientation,
        best.orientation,
        tuple(dict.fromkeys(alternatives))[:_MOST_ALTERNATIVES],
        tuple(sorted(unseen)),
    )
