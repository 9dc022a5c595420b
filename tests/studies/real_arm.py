"""Random real arms in plain NumPy: chains of any form, every effect of the catalogue, equilibrium under gravity.

Nothing of robacc is imported. `arm.py` holds what fits need of four fixed arms; this module holds what a real arm does:
chains of 5 to 7 axes with slides, in both Denavit-Hartenberg conventions and as URDF. Effects are written from the
equations of the catalogue (`robacc effects`). Torques are forces times levers at the true pose; compliances are in
equilibrium by fixed-point iteration.

Matrices are (N, 4, 4), joints (N, J), SI units.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from arm import GRAVITY, move, turn

KINDS = ("standard", "modified", "urdf")
_H = math.pi / 2
_Draw = Callable[["RealArm", np.random.Generator], dict[str, object]]
_SWEEPS = 12
"""Iterations of the equilibrium: each leaves a thousandth of the deflection before it."""


@dataclass(frozen=True)
class RealJoint:
    """A joint: ``row`` is (theta, d, a, alpha) of a table, or (x, y, z, roll, pitch, yaw) of a URDF's origin."""

    name: str
    slides: bool
    row: np.ndarray
    limits: tuple[float, float]
    mass: float
    com: np.ndarray
    parallel: bool
    """The next axis of a standard table, the axis before it of a modified one, is parallel to this axis."""


@dataclass(frozen=True)
class RealArm:
    """Nominal arm; ``form`` is one of KINDS."""

    name: str
    form: str
    joints: tuple[RealJoint, ...]
    tool: np.ndarray
    """(3,) target in the last frame, m."""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the joints."""
        return tuple(joint.name for joint in self.joints)

    @property
    def limits(self) -> np.ndarray:
        """(J, 2)"""
        return np.array([joint.limits for joint in self.joints])


@dataclass(frozen=True)
class Pose:
    """Circumstances of N poses beside the joints; what no effect needs may stay zero."""

    direction: np.ndarray
    speed: np.ndarray
    time: np.ndarray
    temperature: np.ndarray
    payload: np.ndarray


@dataclass(frozen=True)
class Truth:
    """Differences of the real arm from the nominal one; ``effects`` maps a kind to its numbers."""

    base: np.ndarray
    """(6,) x, y, z and Rz(yaw) Ry(pitch) Rx(roll) of the base in the measuring frame."""
    tool: np.ndarray
    """(3,)"""
    rows: np.ndarray
    """(J, 6) differences of the rows; a table's fifth is the turn about y, its sixth is not used."""
    effects: Mapping[str, Mapping[str, object]] = field(default_factory=dict)


# -- drawing


_TEMPLATES: dict[str, tuple[tuple[int, float, float], ...]] = {
    # slides, d or a of the link as a share of the reach with its sign for a, alpha; read as a standard table
    "elbow6": ((0, 0.3, -_H), (0, -0.4, 0.0), (0, -0.05, -_H), (0, 0.4, _H), (0, 0.0, -_H), (0, 0.08, 0.0)),
    "cobot6": ((0, 0.1, _H), (0, -0.5, 0.0), (0, -0.45, 0.0), (0, 0.12, _H), (0, 0.1, -_H), (0, 0.09, 0.0)),
    "elbow5": ((0, 0.3, -_H), (0, -0.4, 0.0), (0, -0.3, 0.0), (0, 0.0, -_H), (0, 0.1, 0.0)),
    "shoulder7": (
        (0, 0.3, -_H),
        (0, 0.0, _H),
        (0, 0.4, _H),
        (0, 0.0, -_H),
        (0, 0.4, -_H),
        (0, -0.07, _H),
        (0, 0.1, 0.0),
    ),
    "lift7": (
        (1, -0.1, 0.0),
        (0, 0.2, -_H),
        (0, -0.4, 0.0),
        (0, -0.05, -_H),
        (0, 0.4, _H),
        (0, 0.0, -_H),
        (0, 0.1, 0.0),
    ),
    "stanford6": ((0, 0.3, -_H), (0, 0.2, _H), (1, 0.3, 0.0), (0, 0.1, -_H), (0, 0.0, _H), (0, 0.1, 0.0)),
    "rail6": ((1, 0.2, _H), (0, -0.3, -_H), (0, -0.35, 0.0), (0, -0.3, -_H), (0, 0.1, _H), (0, 0.1, 0.0)),
    "gantry5": ((1, 0.1, -_H), (1, 0.1, -_H), (0, 0.2, _H), (0, 0.2, -_H), (0, 0.1, 0.0)),
}
TEMPLATES = tuple(_TEMPLATES)


def random_arm(template: str, form: str, rng: np.random.Generator) -> RealArm:
    """Draw an arm of a template: lengths within 30 %, half of the twists between axes off by some 2 degrees."""
    reach = rng.uniform(0.7, 2.0)
    shapes = _TEMPLATES[template]
    rows = np.array([_row(shape, reach, i + 1 < len(shapes), rng) for i, shape in enumerate(shapes)])
    parallel = [i + 1 < len(shapes) and abs(alpha) < 1e-9 for i, (_, _, alpha) in enumerate(shapes)]
    if form != "standard":
        # A modified row has length and twist of the link in front of its axis.
        rows[:, 2:] = np.vstack((np.zeros(2), rows[:-1, 2:]))
        parallel = [False, *parallel[:-1]]
    joints = []
    for i, (shape, row) in enumerate(zip(shapes, rows, strict=True)):
        slides = bool(shape[0])
        limits = (0.0, 0.4 * reach) if slides else (-rng.uniform(1.6, 2.9), rng.uniform(1.6, 2.9))
        mass = 60.0 * reach * 0.55**i * rng.uniform(0.7, 1.3)
        com = 0.15 * reach * rng.uniform(-1, 1, 3) * 0.8**i
        joints.append(RealJoint(f"j{i + 1}", slides, _origin(row) if form == "urdf" else row, limits, mass, com,
                                parallel[i]))  # fmt: skip
    tool = np.array([0.08, -0.05, 0.12]) * reach * rng.uniform(0.6, 1.4, 3)
    return RealArm(f"{template}-{form}", form, tuple(joints), tool)


def _row(shape: tuple[int, float, float], reach: float, inner: bool, rng: np.random.Generator) -> np.ndarray:
    """Numbers (theta, d, a, alpha) of a standard row."""
    slides, size, alpha = shape
    length = size * reach * rng.uniform(0.7, 1.3)
    d, a = (length, 0.0) if size > 0 else (0.02 * reach * rng.standard_normal() * (size < 0), -length)
    theta = 0.0 if slides else float(rng.choice([0.0, _H, -_H]))
    twist = math.radians(2.0) * rng.standard_normal() * rng.integers(2) * (inner and abs(alpha) > 0)
    return np.array([theta, d, a, alpha + twist])


def _origin(row: np.ndarray) -> np.ndarray:
    """Origin x, y, z, roll, pitch, yaw of the row Rx(alpha) Tx(a) Rz(theta) Tz(d) of a modified table."""
    theta, d, a, alpha = row
    frame = turn(0, alpha) @ move(a, 0.0, 0.0) @ turn(2, theta) @ move(0.0, 0.0, d)
    roll = math.atan2(frame[2, 1], frame[2, 2])
    pitch = math.atan2(-frame[2, 0], math.hypot(frame[2, 1], frame[2, 2]))
    return np.array([*frame[:3, 3], roll, pitch, math.atan2(frame[1, 0], frame[0, 0])])


def random_truth(arm: RealArm, kinds: Sequence[str], rng: np.random.Generator) -> Truth:
    """Draw a real arm: base and target some millimetres off, geometry as usual, and effects of the given kinds.

    Where the instrument's scale is wrong the lengths are right: both together cannot be told from each other.
    """
    n = len(arm.joints)
    base = np.concatenate([rng.normal(0, 3e-3, 3), rng.normal(0, 3e-3, 3)])
    rows = np.zeros((n, 6))
    sizes = [0, 3e-4, 3e-4, 3e-4, 0, 0] if arm.form != "urdf" else [3e-4] * 6
    if "instrument_scale" not in kinds:
        rows = rng.normal(size=(n, 6)) * sizes
    for i, joint in enumerate(arm.joints):
        if arm.form != "urdf":
            rows[i, 1 if joint.slides else 0] = 5e-4 * rng.standard_normal()
            if joint.parallel and "instrument_scale" not in kinds:
                rows[i, 4] = 3e-4 * rng.standard_normal()
        elif "instrument_scale" in kinds:
            rows[i, 2 if joint.slides else 5] = 5e-4 * rng.standard_normal()
    effects = {kind: DRAWN[kind](arm, rng) for kind in kinds}
    return Truth(base, rng.normal(0, 2e-3, 3), rows, effects)


def _joint(arm: RealArm, rng: np.random.Generator, turning: bool = True, inner: bool = False) -> int:
    places = [i for i, joint in enumerate(arm.joints) if not (turning and joint.slides)]
    return int(rng.choice(places[:-1] if inner and len(places) > 1 else places))


def _weights(arm: RealArm, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Torques of the links' weight at the commanded poses, as :func:`_forces` returns them."""
    still = Truth(np.zeros(6), np.zeros(3), np.zeros((len(arm.joints), 6)))
    return _forces(arm, _frames(arm, still, q, _Motion.none(q)), None)


def _at_random(arm: RealArm, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Torques of the links' weight at random poses."""
    return _weights(arm, rng.uniform(*arm.limits.T, (50, len(arm.joints))))


def torques(arm: RealArm, q: np.ndarray) -> np.ndarray:
    """Torques (N, J) of the links' weight about the joints at the commanded poses."""
    return _weights(arm, q)[0]


def _loaded(arm: RealArm, rng: np.random.Generator) -> dict[str, object]:
    """A turning joint that carries weight: one of the two whose torque varies most; `peak` is its largest torque."""
    torque = _at_random(arm, rng)[0]
    torque[:, [joint.slides for joint in arm.joints]] = 0.0
    spread = np.std(torque, axis=0)
    first, second = np.argsort(spread)[[-1, -2]]
    j = int(second if spread[second] > 0.1 * spread[first] and rng.integers(2) else first)
    return {"joint": j, "peak": float(np.abs(torque[:, j]).max())}


def _sign(rng: np.random.Generator, low: float, high: float) -> float:
    return float(rng.uniform(low, high) * rng.choice((-1, 1)))


def _at(low: float, high: float) -> _Draw:
    """An effect on one turning joint, of a size between two limits and either sign."""
    return lambda arm, rng: {"joint": _joint(arm, rng), "size": _sign(rng, low, high)}


def _by_torque(low: float, high: float) -> _Draw:
    """An effect on a joint that carries weight, of ``low`` to ``high`` rad at its largest torque."""

    def draw(arm: RealArm, rng: np.random.Generator) -> dict[str, object]:
        loaded = _loaded(arm, rng)
        return {**loaded, "size": rng.uniform(low, high) / float(loaded["peak"])}  # type: ignore[arg-type]

    return draw


def _coupling(arm: RealArm, rng: np.random.Generator) -> dict[str, object]:
    driver = int(rng.integers(len(arm.joints) - 1))
    size = _sign(rng, 2e-4, 1e-3)
    return {"joint": driver + 1, "driver": driver, "size": size * (0.1 if arm.joints[driver + 1].slides else 1.0)}


def _hardening(arm: RealArm, rng: np.random.Generator) -> dict[str, object]:
    return {**_loaded(arm, rng), "size": -rng.uniform(5e-5, 3e-4)}


def _lateral(arm: RealArm, rng: np.random.Generator) -> dict[str, object]:
    j = _joint(arm, rng, inner=True)
    peak = float(np.abs(_at_random(arm, rng)[1][:, j]).max())
    return {"joint": j, "size": rng.uniform(5e-5, 3e-4) / peak}


def _pedestal(arm: RealArm, rng: np.random.Generator) -> dict[str, object]:
    return {"size": rng.uniform(5e-5, 3e-4) / float(np.abs(_at_random(arm, rng)[2]).max())}


def _values(size: float, count: int, on_joint: bool = True) -> _Draw:
    """An effect of several coefficients of a usual size."""

    def draw(arm: RealArm, rng: np.random.Generator) -> dict[str, object]:
        place = {"joint": _joint(arm, rng, inner=True)} if on_joint else {}
        return {**place, "size": rng.normal(0, size, count)}

    return draw


DRAWN: dict[str, _Draw] = {
    "gear_ratio": _at(1e-4, 5e-4),
    "joint_coupling": _coupling,
    "transmission_error": _values(2e-4, 4),
    "backlash": _at(5e-5, 3e-4),
    "friction_windup": _by_torque(5e-5, 2e-4),
    "approach_lag": _at(5e-5, 4e-4),
    "joint_compliance": _by_torque(1e-4, 8e-4),
    "joint_hardening": _hardening,
    "lateral_compliance": _lateral,
    "payload_compliance": _by_torque(1e-4, 6e-4),
    "base_compliance": _pedestal,
    "axis_wobble": _values(1.5e-4, 8),
    "thermal_expansion": lambda arm, rng: {"size": rng.uniform(1e-5, 2.4e-5)},
    "frame_drift": _values(2e-4, 3, on_joint=False),
    "step": _values(4e-4, 3, on_joint=False),
    "instrument_scale": lambda arm, rng: {"size": _sign(rng, 3e-5, 2e-4)},
    "joint_correction": _values(2e-4, 2),
}
EFFECTS = tuple(DRAWN)


def request(kind: str, truth: Truth, arm: RealArm) -> str:
    """Effect as ``--fit`` names it."""
    place = truth.effects[kind].get("joint")
    return kind if place is None else f"{kind}[{arm.names[int(place)]}]"  # type: ignore[call-overload]


# -- motion


@dataclass
class _Motion:
    """Changes of the chain at N poses: of joints (N, J), tilts in front of the axes and of the rows (N, J, 2), base."""

    joints: np.ndarray
    tilts: np.ndarray
    row_tilts: np.ndarray
    base: np.ndarray
    """(N, 3) translation in the measuring frame."""
    base_tilt: np.ndarray
    """(N, 2) turns about the base's x and y."""
    growth: np.ndarray
    """(N,)"""

    @classmethod
    def none(cls, q: np.ndarray) -> _Motion:
        n, j = q.shape
        return cls(*(np.zeros(shape) for shape in ((n, j), (n, j, 2), (n, j, 2), (n, 3), (n, 2), (n,))))


def positions(arm: RealArm, truth: Truth, q: np.ndarray, pose: Pose) -> tuple[np.ndarray, np.ndarray]:
    """Positions (N, 3) and orientations (N, 3, 3) of the target in the measuring frame, without what drifts there."""
    last = _equilibrium(arm, truth, q, pose)[-1][1]
    tool = np.tile(arm.tool + truth.tool, (len(q), 1))
    if arm.form == "urdf":  # the mount of the target is a link of the file, so it grows with the others
        tool = tool + arm.tool * _growth(truth, pose)[:, None]
    return last[:, :3, 3] + np.einsum("nij,nj->ni", last[:, :3, :3], tool), last[:, :3, :3]


def _growth(truth: Truth, pose: Pose) -> np.ndarray:
    return _numbers(truth, "thermal_expansion") * (pose.temperature - 20.0)


def measured(arm: RealArm, truth: Truth, q: np.ndarray, pose: Pose) -> tuple[np.ndarray, np.ndarray]:
    """As :func:`positions`, with the drift and the scale of the instrument and the base before its step."""
    place, turned = positions(arm, truth, q, pose)
    if "frame_drift" in truth.effects:
        middle, half = 0.5 * (pose.time.min() + pose.time.max()), 0.5 * np.ptp(pose.time)
        place = place + ((pose.time - middle) / half)[:, None] * _numbers(truth, "frame_drift")
    if "step" in truth.effects:
        place = place - (pose.time < np.median(pose.time))[:, None] * _numbers(truth, "step")
    return place * (1.0 + float(_numbers(truth, "instrument_scale"))), turned


def nominal(arm: RealArm, base: np.ndarray, tool: np.ndarray, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions and orientations by the nominal rows, with a base and a target."""
    still = Truth(base, tool - arm.tool, np.zeros((len(arm.joints), 6)))
    last = _frames(arm, still, q, _Motion.none(q))[-1][1]
    return last[:, :3, 3] + last[:, :3, :3] @ tool, last[:, :3, :3]


def _numbers(truth: Truth, kind: str) -> np.ndarray:
    return np.asarray(truth.effects.get(kind, {"size": 0.0})["size"], float)


def _equilibrium(arm: RealArm, truth: Truth, q: np.ndarray, pose: Pose) -> list[tuple[np.ndarray, np.ndarray]]:
    rigid = _rigid(arm, truth, q, pose)
    frames = _frames(arm, truth, q, rigid)
    commanded = _forces(arm, _frames(arm, truth, q, _Motion.none(q)), None)[0]
    for kind, power in (("friction_windup", 1), ("joint_hardening", 3)):
        if kind in truth.effects:
            j = int(truth.effects[kind]["joint"])  # type: ignore[call-overload]
            torque = commanded[:, j]
            regressor = (
                np.abs(torque) * pose.direction[:, j]
                if power == 1
                else (torque / float(truth.effects[kind]["peak"])) ** 3
            )
            rigid.joints[:, j] += float(_numbers(truth, kind)) * regressor
    if not set(truth.effects) & {"joint_compliance", "lateral_compliance", "payload_compliance", "base_compliance"}:
        return _frames(arm, truth, q, rigid)
    for _ in range(_SWEEPS):
        own, tilting, base = _forces(arm, frames, None)
        loaded = _forces(arm, frames, (pose.payload, arm.tool + truth.tool))[0]
        moved = _Motion(rigid.joints.copy(), rigid.tilts.copy(), rigid.row_tilts, rigid.base, rigid.base_tilt.copy(),
                        rigid.growth)  # fmt: skip
        for kind, torque in (("joint_compliance", own), ("payload_compliance", loaded)):
            if kind in truth.effects:
                j = int(truth.effects[kind]["joint"])  # type: ignore[call-overload]
                moved.joints[:, j] += float(_numbers(truth, kind)) * torque[:, j]
        if "lateral_compliance" in truth.effects:
            j = int(truth.effects["lateral_compliance"]["joint"])  # type: ignore[call-overload]
            moved.tilts[:, j] += float(_numbers(truth, "lateral_compliance")) * tilting[:, j]
        moved.base_tilt += float(_numbers(truth, "base_compliance")) * base
        frames = _frames(arm, truth, q, moved)
    return frames


def _rigid(arm: RealArm, truth: Truth, q: np.ndarray, pose: Pose) -> _Motion:
    """Changes that no equilibrium decides."""
    motion = _Motion.none(q)
    for kind, effect in truth.effects.items():
        if "joint" not in effect:
            continue
        j, size = int(effect["joint"]), _numbers(truth, kind)  # type: ignore[call-overload]
        own = q[:, j]
        if kind == "gear_ratio":
            motion.joints[:, j] += size * own
        elif kind == "joint_coupling":
            motion.joints[:, j] += size * q[:, int(effect["driver"])]  # type: ignore[call-overload]
        elif kind == "transmission_error":
            waves = np.array([np.cos(own), np.sin(own), np.cos(2 * own), np.sin(2 * own)])
            motion.joints[:, j] += size @ waves
        elif kind == "backlash":
            motion.joints[:, j] += size * pose.direction[:, j]
        elif kind == "approach_lag":
            motion.joints[:, j] += size * pose.speed[:, j]
        elif kind == "axis_wobble":
            waves = np.array([np.cos(own), np.sin(own), np.cos(2 * own), np.sin(2 * own)])
            tilts = motion.tilts if arm.form == "urdf" else motion.row_tilts
            tilts[:, j] += np.stack((size[:4] @ waves, size[4:] @ waves), axis=1)
        elif kind == "joint_correction":
            low, high = arm.joints[j].limits
            x = (2 * own - low - high) / (high - low)
            motion.joints[:, j] += size @ np.array([2 * x**2 - 1, 4 * x**3 - 3 * x])
    motion.growth += _growth(truth, pose)
    return motion


def _frames(arm: RealArm, truth: Truth, q: np.ndarray, motion: _Motion) -> list[tuple[np.ndarray, np.ndarray]]:
    """Frame in front of each joint's motion and frame behind its link; the base stands first, twice."""
    n = len(q)
    x, y, z, roll, pitch, yaw = truth.base
    base = move(x, y, z) @ turn(2, yaw) @ turn(1, pitch) @ turn(0, roll)
    frame = move(*motion.base.T) @ base @ turn(0, motion.base_tilt[:, 0]) @ turn(1, motion.base_tilt[:, 1])
    frames = [(frame, frame)]
    grown = 1.0 + motion.growth
    for i, joint in enumerate(arm.joints):
        moved = q[:, i] + motion.joints[:, i]
        own, travel = (0.0, moved) if joint.slides else (moved, 0.0)
        alpha_tilt, beta_tilt = motion.row_tilts[:, i].T
        flex = turn(0, motion.tilts[:, i, 0]) @ turn(1, motion.tilts[:, i, 1])
        change = truth.rows[i]
        if arm.form == "urdf":
            px, py, pz, *angles = joint.row
            origin = move(*(grown * value for value in (px, py, pz))) @ _angles(angles)
            origin = origin @ move(*(grown * value for value in change[:3])) @ _angles(change[3:])
            front = frame @ origin @ flex
            frame = front @ turn(2, own + np.zeros(n)) @ move(0.0, 0.0, travel * grown)
        else:
            theta, d, a, alpha = joint.row + change[:4]
            beta = change[4]
            screw = turn(2, theta + own + np.zeros(n)) @ move(0.0, 0.0, (d + travel) * grown)
            if arm.form == "standard":
                front = frame @ flex
                frame = front @ screw @ move(a * grown, 0.0, 0.0) @ turn(0, alpha + alpha_tilt)
                frame = frame @ turn(1, beta + beta_tilt)
            else:
                front = frame @ turn(0, alpha + alpha_tilt) @ move(a * grown, 0.0, 0.0) @ turn(1, beta + beta_tilt)
                front = front @ flex
                frame = front @ screw
        frames.append((front, frame))
    return frames


def _forces(
    arm: RealArm, frames: Sequence[tuple[np.ndarray, np.ndarray]], payload: tuple[np.ndarray, np.ndarray] | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gravity along the joints (N, J), about the two axes across each (N, J, 2), about x and y of the base (N, 2).

    Loads are the links, or one payload (masses (N,), its place in the last frame).
    """
    n, j = len(frames[0][0]), len(arm.joints)
    along, across, base = np.zeros((n, j)), np.zeros((n, j, 2)), np.zeros((n, 2))
    if payload is None:
        loads = [(k, np.full(n, joint.mass), joint.com) for k, joint in enumerate(arm.joints)]
    else:
        loads = [(j - 1, payload[0], payload[1])]
    for k, mass, com in loads:
        link = frames[k + 1][1]
        place, weight = link[:, :3, 3] + link[:, :3, :3] @ com, mass[:, None] * GRAVITY
        for i in range(k + 1):
            front = frames[i + 1][0]
            moment = np.cross(place - front[:, :3, 3], weight)
            z = front[:, :3, 2]
            along[:, i] += np.sum(z * (weight if arm.joints[i].slides else moment), axis=1)
            across[:, i] += np.stack([np.sum(front[:, :3, axis] * moment, axis=1) for axis in (0, 1)], axis=1)
        foot = frames[0][0]
        moment = np.cross(place - foot[:, :3, 3], weight)
        base += np.stack([np.sum(foot[:, :3, axis] * moment, axis=1) for axis in (0, 1)], axis=1)
    return along, across, base


def _angles(angles: Sequence[float]) -> np.ndarray:
    return turn(2, angles[2]) @ turn(1, angles[1]) @ turn(0, angles[0])


# -- files


def write_robot(arm: RealArm, folder: Path) -> Path:
    """Write the nominal robot as YAML or as URDF, and return its path."""
    if arm.form == "urdf":
        path = folder / "robot.urdf"
        path.write_text(_urdf(arm))
        return path
    path = folder / "robot.yaml"
    lines = ["robacc: 1", f"name: {arm.name}", f"convention: {arm.form}", "units: {length: m, angle: rad}"]
    lines += [f"tool: {{xyz: {arm.tool.tolist()}, rpy: [0, 0, 0]}}", "joints:"]
    for joint in arm.joints:
        theta, d, a, alpha = (float(x) for x in joint.row)
        low, high = joint.limits
        lines.append(
            f"  - {{name: {joint.name}, type: {'prismatic' if joint.slides else 'revolute'}, theta: {theta!r}, "
            f"d: {d!r}, a: {a!r}, alpha: {alpha!r}, limits: [{low!r}, {high!r}], mass: {joint.mass!r}, "
            f"com: {joint.com.tolist()}}}"
        )
    path.write_text("\n".join(lines) + "\n")
    return path


def _urdf(arm: RealArm) -> str:
    parts = [f'<robot name="{arm.name}">', '<link name="base"/>']
    before = "base"
    for joint in arm.joints:
        link = f"link_{joint.name}"
        xyz, rpy = (" ".join(repr(float(x)) for x in joint.row[part]) for part in (slice(0, 3), slice(3, 6)))
        com = " ".join(repr(float(x)) for x in joint.com)
        parts += [
            f'<link name="{link}"><inertial><origin xyz="{com}"/><mass value="{joint.mass!r}"/>'
            '<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>',
            f'<joint name="{joint.name}" type="{"prismatic" if joint.slides else "revolute"}">'
            f'<parent link="{before}"/><child link="{link}"/><origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="0 0 1"/>'
            f'<limit lower="{joint.limits[0]!r}" upper="{joint.limits[1]!r}" effort="1" velocity="1"/></joint>',
        ]
        before = link
    tool = " ".join(repr(float(x)) for x in arm.tool)
    parts += [
        '<link name="target"/>',
        f'<joint name="mount" type="fixed"><parent link="{before}"/><child link="target"/>',
        f'<origin xyz="{tool}"/></joint>',
        "</robot>",
    ]
    return "\n".join(parts) + "\n"
