"""Registration of base and targets in closed form, from any start, for one robot or for many hypotheses at once.

With F the arm's own pose (to the last link, known effects included), R the rotation from the measuring frame to the
base and g the target on the last link, a measured position p obeys R p = p_F + R_F g + u. For a given R the best g and
u are linear in R, so that the squared error is a quadratic form in the nine elements of R, whatever the number of
poses. Its minimum without the constraint, made orthogonal, is the start of a few Gauss-Newton steps on the rotation.

Orientations obey R_B R_F R_G = R_measured. The null vector of the linear equations R_F R_G - R_B^T R_measured = 0
consists of both rotations: columns of R_G among themselves and of R_B among themselves are orthonormal, so that it
follows from the leading singular vectors of the mean of R_F x R_measured (robot-world and hand-eye calibration by
Kronecker products, A. Li, L. Wang, D. Wu 2010).

Hypotheses are the leading axis H of every array; a stack of H matrices has the shape ``(H, m, m)``.
"""

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from robacc.errors import InputError
from robacc.fitting.levels import HALF_DIGITS
from robacc.geometry import Array, NDArray, Poses, nearest_rotation, skew
from robacc.measurements import IMAGES, Measurements, different
from robacc.modelling.model import predict
from robacc.robots.description import Fixture, Frame, Robot, Vector

PASSES = 3
"""Fits of a registration, each with the rows weighted by their errors in the one before."""
_TRIM = 6.0
"""Median errors beyond which a pose is left out of a trimmed registration, as a beam break is."""
_LEAST_WEIGHT = 1e-12
_STEPS = 5
"""Gauss-Newton steps of the rotation, which converge quadratically."""
_RELUCTANCE = 1e-3
"""Scale of a target's columns: the solution of least norm moves the base rather than a target."""
_GENERATORS = np.moveaxis(skew(np.eye(3)), 2, 0)


@dataclass(frozen=True, slots=True)
class Registration:
    """Registration of positions for each of H hypotheses."""

    rotation: Array
    """``(H, 3, 3)`` rotation R from the measuring frame to the base."""
    shift: Array
    """``(H, 3)`` u, m."""
    targets: Array
    """``(H, T, 3)`` change of each target on the last link, m."""
    vectors: Array
    """``(H, N, 3)`` the remaining errors, measured minus predicted, in the base, m."""

    @property
    def median(self) -> Array:
        """Return the median length ``(H,)`` of the remaining error, m."""
        return np.asarray(np.median(np.linalg.norm(self.vectors, axis=2), axis=1))


def arm_poses(robot: Robot, data: Measurements, q: Array) -> tuple[Array, Array]:
    """Return the last link's rotations ``(H, N, 3, 3)`` and positions ``(H, N, 3)`` at joints ``(H, J, N)``."""
    h, joints, n = q.shape
    rows = data.subset(np.tile(np.arange(n), h))
    rows = dataclasses.replace(rows, q=q.transpose(1, 0, 2).reshape(joints, h * n))
    poses = predict(dataclasses.replace(robot, tool=Frame(), targets={}), rows)
    return np.moveaxis(poses.rotation, 2, 0).reshape(h, n, 3, 3), poses.translation.T.reshape(h, n, 3)


def rows_by_target(robot: Robot, data: Measurements) -> Array:
    """Return ``(T, N)``, 1 where a row is of a target of the robot, else 0."""
    return (
        np.ones((1, data.n))
        if data.target is None or not robot.targets
        else np.asarray(np.array(list(robot.targets))[:, None] == data.target, dtype=np.float64)
    )


def register_frames(robot: Robot, data: Measurements, base: bool, tool: bool) -> Robot:
    """Return the robot with its base, its tool (or each target's), or both, registered.

    Orientations decide the base if they were measured, unless the last link turns about one axis only, as of a SCARA:
    these do not distinguish a turn of the base about it from a turn of the target.

    Raises:
        InputError: too few poses for it.
    """
    if not (base or tool):
        return robot
    if data.fixture is not None:
        return _with_placed_fixtures(robot, data, tool) if base else robot
    needed = 1 if data.rotation is not None else 3
    if data.n < needed or data.q is None:
        raise InputError(
            f"{data.n} pose{'s' * (data.n != 1)}: registration of base_frame or tool_frame needs at least {needed}"
        )
    frames = robot.targets or {"": robot.tool}
    by_target = rows_by_target(robot, data)
    index = by_target.argmax(axis=0)
    tools = Poses.from_xyz_rpy(*(np.array([getattr(f, name) for f in frames.values()]).T for name in ("xyz", "rpy")))
    rotation, translation = arm_poses(robot, data, data.q[None])
    nominal = translation + np.einsum("nij,jn->ni", rotation[0], tools.translation[:, index])
    measured = None if data.rotation is None else np.moveaxis(data.rotation, 2, 0)[None]
    turn, moved = np.eye(3)[None], np.zeros((len(frames), 3))
    if base:
        known = None
        if measured is not None and tool:
            turned, _, is_unique = register_orientations(rotation, measured, passes=1)
            known = turned if is_unique[0] else None
            # Two poses leave a turn of base and target together unknown: the target stays.
            tool = known is not None or different(data.groups()) >= 3
        if measured is not None and not tool:
            target = rotation @ np.moveaxis(tools.rotation, 2, 0)[index]
            known = nearest_rotation(np.einsum("hnij,hnkj->hik", target, measured))
        rows = by_target if tool else by_target[:0]
        registered = register_positions(rotation, nominal, data.position.T[None], rows, turn=known, trimmed=True)
        turn, moved = registered.rotation, registered.targets[0]
        robot = dataclasses.replace(
            robot, base=Frame.of(Poses(turn[0].T, turn[0].T @ registered.shift[0]) @ robot.base.pose)
        )
    if not tool:
        return robot
    placed = {}
    for number, (name, frame) in enumerate(frames.items()):
        rows, turned = index == number, tools.rotation[..., number]
        if rows.any() and not base:
            errors = data.position.T[rows] - nominal[0, rows]
            moved[number] = np.median(np.einsum("nji,nj->ni", rotation[0, rows], errors), axis=0)
        if rows.any() and measured is not None:
            turned = nearest_rotation(np.einsum("nji,jk,nkl->il", rotation[0, rows], turn[0], measured[0, rows]))
        placed[name] = Frame.of(Poses(turned, np.array(frame.xyz) + moved[number]))
    return dataclasses.replace(robot, targets=placed) if robot.targets else dataclasses.replace(robot, tool=placed[""])


def gravity_turned(before: Robot, after: Robot) -> Vector:
    """Return the gravity of a robot, m/s^2, turned as another place of its base turns the arm."""
    old, new = (robot.base.pose.rotation for robot in (before, after))
    x, y, z = (new @ old.T @ np.array(before.gravity)).tolist()
    return (x, y, z)


def _with_placed_fixtures(robot: Robot, data: Measurements, tool: bool) -> Robot:
    """Return the robot with the place of its base, seen from each socket, plane, anchor and camera, by the nominal arm.

    Images place the tool too. Gravity stays along the base then: a camera does not show what is level.
    """
    bare = dataclasses.replace(data, kind=None, fixture=None, reference=None)
    position = predict(dataclasses.replace(robot, base=Frame()), bare).translation
    assert data.fixture is not None
    assert data.kind is not None
    fixtures, before = dict(robot.fixtures), robot
    for name in (name for name, fixture in robot.fixtures.items() if fixture.kind in IMAGES):
        poses = data.subset((data.fixture == name) & np.isin(data.kind, IMAGES)).each_photo()
        if poses is not None:
            robot, tool = register_frames(robot, poses, base=True, tool=tool), False
        fixtures[name] = fixtures[name]._replace(base=robot.base)
    fixtures |= {
        name: _placed(fixture.kind, position[:, rows], data.position[2, rows])
        for name, fixture in fixtures.items()
        if name and fixture.kind not in IMAGES and (rows := data.fixture == name).any()
    }
    if data.is_placed_by_images:
        robot = dataclasses.replace(robot, gravity=gravity_turned(before, robot))
    elif (rows := data.kind == "position").sum() >= 3:
        robot = register_frames(robot, bare.subset(rows), base=True, tool=False)
    return dataclasses.replace(robot, fixtures=fixtures)


def _placed(kind: str, position: Array, value: Array) -> Fixture:
    """Return a fixture where positions ``(3, n)`` in the base and readings ``(n,)`` place it, seen from its frame."""
    centre = position.mean(axis=1)
    rotation, origin, radius = np.eye(3), centre, 0.0
    if kind in ("plane", "line"):
        principal = np.linalg.svd((position - centre[:, None]).T, full_matrices=True)[2]
        rotation = principal[[1, 2, 0]] if kind == "line" else principal
        up = float(rotation[2] @ position @ (value - value.mean())) or float(rotation[2, 2])
        rotation[2] *= np.copysign(1.0, up)
        rotation[0] = np.cross(rotation[1], rotation[2])
        origin = centre - rotation[2] * value.mean()
    elif kind in ("distance", "sphere"):
        # |p|^2 - v^2 = 2 p'a + c is linear in the centre a and c = r^2 - |a|^2; r is 0 of an anchor, v next to 0 on a
        # sphere.
        known = np.square(value) if kind == "distance" else 0.0
        matrix = np.column_stack((2.0 * position.T, np.ones(value.size)))
        *origin, constant = np.linalg.lstsq(matrix, np.sum(np.square(position), axis=0) - known, rcond=None)[0]
        radius = math.sqrt(max(constant + np.dot(origin, origin), 0.0)) if kind == "sphere" else 0.0
    return Fixture(kind, Frame.of(Poses(rotation, -rotation @ origin)), radius)


def register_positions(
    rotation: Array,
    translation: Array,
    measured: Array,
    by_target: Array,
    *,
    by_socket: Array | None = None,
    turn: Array | None = None,
    passes: int = PASSES,
    trimmed: bool = False,
) -> Registration:
    """Register base and targets to measured positions.

    Args:
        rotation: ``(H, N, 3, 3)`` orientation of the last link in the base.
        translation: ``(H, N, 3)`` its position, or that of the targets where they are known roughly, m.
        measured: ``(H or 1, N, 3)`` measured positions, m.
        by_target: ``(T, N)`` as :func:`rows_by_target` returns it; without rows only the base is registered.
        by_socket: ``(S, N)`` 1 where a row is in a socket, else 0; each socket has a place of its own. None: all are
            in one frame.
        turn: ``(H, 3, 3)`` known rotation from the measuring frame to the base; None to fit it.
        passes: Fits.
        trimmed: Least squares of all rows but those far off, in two passes; else each row counts by its error.
    """
    h, n = translation.shape[:2]
    # Columns of shift and targets, to eliminate, and of the nine elements of R and the arm.
    shift, places = np.broadcast_to(np.eye(3), (h, n, 3, 3)), np.ones((1, n)) if by_socket is None else by_socket
    parts = [*((shift, rows) for rows in places), *((_RELUCTANCE * rotation, rows) for rows in by_target)]
    offsets = np.concatenate([part * rows[:, None, None] for part, rows in parts], axis=3)
    means = measured.mean(axis=1, keepdims=True), translation.mean(axis=1, keepdims=True)
    columns = np.zeros((h, n, 3, 10))
    for axis in range(3):
        columns[:, :, axis, 3 * axis : 3 * axis + 3] = measured - means[0]
    columns[..., 9] = translation - means[1]
    weight = np.ones((h, n))
    for _ in range(2 if trimmed else passes):
        root = np.repeat(np.sqrt(weight), 3, axis=1)[..., None]
        free, wanted = offsets.reshape(h, 3 * n, -1) * root, columns.reshape(h, 3 * n, 10) * root
        # rad: where the last link's turns spread by less, a target's place along an axis stays where it is.
        inverse = np.linalg.pinv(free.swapaxes(1, 2) @ free, rcond=(1e-2 * _RELUCTANCE) ** 2, hermitian=True)
        solved = inverse @ (free.swapaxes(1, 2) @ wanted)
        rest = wanted - free @ solved
        start = (wanted.swapaxes(1, 2) @ wanted)[:, :9, 9]
        fitted = _best_rotation(rest.swapaxes(1, 2) @ rest, start) if turn is None else turn
        vectors = ((rest @ _with_arm(fitted)) / root).reshape(h, n, 3)
        errors = np.linalg.norm(vectors, axis=2)
        limit = _TRIM * np.median(errors, axis=1, keepdims=True)
        weight = np.where(errors <= limit, 1.0, _LEAST_WEIGHT) if trimmed else _weights(errors)
    moved = (solved @ _with_arm(fitted))[..., 0]
    centre = moved[:, :3] + (fitted @ means[0].swapaxes(1, 2))[..., 0] - means[1][:, 0]
    return Registration(fitted, centre, _RELUCTANCE * moved[:, 3 * len(places) :].reshape(h, -1, 3), vectors)


def register_orientations(
    rotation: Array, measured: Array, passes: int = PASSES
) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return the rotations ``(H, 3, 3)`` from the measuring frame to the base, median errors, and if it is unique.

    Errors ``(H,)`` are in rad; it is not unique ``(H,)`` if the last link turns about one axis only.

    Args:
        rotation: ``(H, N, 3, 3)`` orientation of the last link in the base.
        measured: ``(H, N, 3, 3)`` measured orientations.
        passes: Fits.
    """
    h, n = rotation.shape[:2]
    weight = np.ones((h, n))
    for _ in range(passes):
        share = weight / weight.sum(axis=1, keepdims=True)
        # Elements (i, j), (l, k) of R_F and the measured orientation.
        weighted = np.swapaxes((rotation * share[..., None, None]).reshape(h, n, 9), 1, 2)
        mixed = (weighted @ measured.reshape(h, n, 9)).reshape(h, 3, 3, 3, 3)
        left, values, right = np.linalg.svd(mixed.transpose(0, 2, 4, 3, 1).reshape(h, 9, 9))
        tool, base = left[:, :, 0].reshape(h, 3, 3), right[:, 0, :].reshape(h, 3, 3)
        sign = np.sign(np.linalg.det(tool))[:, None, None]
        tool, base = nearest_rotation(sign * tool), nearest_rotation(sign * base)
        errors = _angles(base[:, None] @ rotation @ tool[:, None], measured)
        weight = _weights(errors)
    # Axes are parallel within about a degree where the second smallest eigenvalue over the largest is less.
    is_unique = 1.0 - values[:, 1] >= 1e-4 * (1.0 + values[:, 0])
    return np.swapaxes(base, 1, 2), np.asarray(np.median(errors, axis=1)), is_unique


def orientation_errors(rotation: Array, measured: Array, base: Array) -> Array:
    """Return the median orientation error ``(H,)``, rad, with the target registered and the base's rotation known.

    Args:
        rotation: ``(H, N, 3, 3)`` orientation of the last link in the base.
        measured: ``(H, N, 3, 3)`` measured orientations.
        base: ``(H, 3, 3)`` rotation from the measuring frame to the base.
    """
    turned = base[:, None] @ measured
    tool = nearest_rotation(np.einsum("hnji,hnjk->hik", rotation, turned))
    return np.asarray(np.median(_angles(rotation @ tool[:, None], turned), axis=1))


def _best_rotation(form: Array, start: Array) -> Array:
    """Return the rotation ``(H, 3, 3)`` of least cost; ``form`` ``(H, 10, 10)`` is of the elements of R and -1.

    Gauss-Newton starts from the minimum without the constraint and from ``start`` ``(H, 9)``.
    """
    h = len(form)
    a, b = form[:, :9, :9], form[:, :9, 9:]
    free = np.linalg.solve(_regular(a), b)[..., 0]
    turns = nearest_rotation(np.stack([free, start]).reshape(2, h, 3, 3))
    for _ in range(_STEPS):
        tangent = np.einsum("kij,shjl->shilk", _GENERATORS, turns).reshape(2, h, 9, 3)
        across = np.swapaxes(tangent, 2, 3)
        gradient = across @ (a @ turns.reshape(2, h, 9, 1) - b)
        step = -np.linalg.solve(_regular(across @ a @ tangent), gradient)[..., 0]
        turns = nearest_rotation(turns + np.einsum("shk,kij,shjl->shil", step, _GENERATORS, turns))
    vector = _with_arm(turns)
    cost = (np.swapaxes(vector, 2, 3) @ form @ vector)[..., 0, 0]
    return np.asarray(turns[np.argmin(cost, axis=0), np.arange(h)])


def _with_arm(turn: Array) -> Array:
    """Return the coefficients ``(..., 10, 1)`` of the columns of positions: the elements of R, and -1 of the arm."""
    flat = turn.reshape(*turn.shape[:-2], 9)
    return np.concatenate([flat, np.full((*flat.shape[:-1], 1), -1.0)], axis=-1)[..., None]


def _regular(normal: Array) -> Array:
    """Return normal matrices ``(..., m, m)`` that can be inverted."""
    size = np.trace(normal, axis1=-2, axis2=-1)[..., None, None] + 1e-30
    return np.asarray(normal + HALF_DIGITS * size * np.eye(normal.shape[-1]))


def _weights(errors: Array) -> Array:
    """Return the weights ``(H, N)`` of rows with these errors."""
    typical = np.maximum(np.median(errors, axis=1, keepdims=True), 1e-12)
    # A row has half its weight at three median errors.
    return np.asarray(1.0 / (1.0 + np.square(errors / (3.0 * typical))))


def _angles(predicted: Array, measured: Array) -> Array:
    """Return the angles ``(H, N)`` between orientations ``(H, N, 3, 3)``, rad."""
    trace = np.einsum("hnij,hnij->hn", predicted, measured)
    return np.asarray(np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0)))
