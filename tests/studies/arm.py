"""Real arms in plain NumPy: chains of any form, every effect of the catalogue, equilibrium under gravity.

Nothing of robacc is imported: what the studies compare it with shares no line with it. Arms are random (chains of 5 to
7 axes with slides, in both Denavit-Hartenberg conventions and as URDF) or one of ARMS, standard tables. Effects are
written from the equations of the catalogue (`robacc effects`). Torques are forces times levers at the true pose;
compliances are in equilibrium by fixed-point iteration. :class:`Setup` has the coefficients of a table under the names
that robacc's results give them, as differences from the nominal model, and the derivatives by them.

Matrices are (N, 4, 4), joints (N, J), SI units. `python arm.py` compares the derivatives with complex steps.
"""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
from homogeneous import frame, shift, turn

GRAVITY = np.array([0.0, 0.0, -9.81])
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
    """(J, 6) differences of the rows; a table's fifth is the turn about y, its sixth is not used or not there."""
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
    place = turn(0, alpha) @ shift(a) @ turn(2, theta) @ shift(0.0, 0.0, d)
    roll = math.atan2(place[2, 1], place[2, 2])
    pitch = math.atan2(-place[2, 0], math.hypot(place[2, 1], place[2, 2]))
    return np.array([*place[:3, 3], roll, pitch, math.atan2(place[1, 0], place[0, 0])])


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


def _at_random(arm: RealArm, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Torques of the links' weight at random commanded poses, as :func:`_forces` returns them."""
    q = rng.uniform(*arm.limits.T, (50, len(arm.joints)))
    return _forces(arm, _frames(arm, _still(arm), q, _Motion.none(q)), None)


def _still(arm: RealArm) -> Truth:
    return Truth(np.zeros(6), np.zeros(3), np.zeros((len(arm.joints), 6)))


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
    base_tilt: np.ndarray
    """(N, 2) turns about the base's x and y."""
    growth: np.ndarray
    """(N,)"""

    @classmethod
    def none(cls, q: np.ndarray) -> _Motion:
        n, j = q.shape
        return cls(*(np.zeros(shape) for shape in ((n, j), (n, j, 2), (n, j, 2), (n, 2), (n,))))


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
    placed = Truth(base, tool - arm.tool, _still(arm).rows)
    last = _frames(arm, placed, q, _Motion.none(q))[-1][1]
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
        moved = _Motion(rigid.joints.copy(), rigid.tilts.copy(), rigid.row_tilts, rigid.base_tilt.copy(), rigid.growth)
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
    place = frame(truth.base[:3], truth.base[3:]) @ turn(0, motion.base_tilt[:, 0]) @ turn(1, motion.base_tilt[:, 1])
    frames = [(place, place)]
    grown = 1.0 + motion.growth
    for i, joint in enumerate(arm.joints):
        moved = q[:, i] + motion.joints[:, i]
        own, travel = (0.0, moved) if joint.slides else (moved, 0.0)
        alpha_tilt, beta_tilt = motion.row_tilts[:, i].T
        flex = turn(0, motion.tilts[:, i, 0]) @ turn(1, motion.tilts[:, i, 1])
        change = truth.rows[i]
        if arm.form == "urdf":
            origin = frame([grown * value for value in joint.row[:3]], joint.row[3:])
            front = place @ origin @ frame([grown * value for value in change[:3]], change[3:]) @ flex
            place = front @ turn(2, own + np.zeros(n)) @ shift(0.0, 0.0, travel * grown)
        else:
            theta, d, a, alpha = joint.row + change[:4]
            beta = change[4]
            screw = turn(2, theta + own + np.zeros(n)) @ shift(0.0, 0.0, (d + travel) * grown)
            row = (turn(0, alpha + alpha_tilt), shift(a * grown), turn(1, beta + beta_tilt))
            if arm.form == "standard":
                front = place @ flex
                place = front @ screw @ row[1] @ row[0] @ row[2]
            else:
                front = place @ row[0] @ row[1] @ row[2] @ flex
                place = front @ screw
        frames.append((front, place))
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


# -- files


def write_robot(arm: RealArm, path: Path, masses: bool = True) -> None:
    """Write the nominal robot as YAML, or as URDF where that is its form."""
    if arm.form == "urdf":
        path.write_text(_urdf(arm))
        return
    lines = ["robacc: 1", f"name: {arm.name}", f"convention: {arm.form}", "units: {length: m, angle: rad}"]
    lines += [f"tool: {{xyz: {arm.tool.tolist()}, rpy: [0, 0, 0]}}", "joints:"]
    for joint in arm.joints:
        theta, d, a, alpha = (float(x) for x in joint.row)
        low, high = joint.limits
        weight = f", mass: {joint.mass!r}, com: {joint.com.tolist()}" if masses and joint.mass > 0 else ""
        lines.append(
            f"  - {{name: {joint.name}, type: {'prismatic' if joint.slides else 'revolute'}, theta: {theta!r}, "
            f"d: {d!r}, a: {a!r}, alpha: {alpha!r}, limits: [{low!r}, {high!r}]{weight}}}"
        )
    path.write_text("\n".join(lines) + "\n")


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


def write_csv(path: Path, columns: Mapping[str, Sequence[object] | np.ndarray]) -> None:
    """Write columns by their names."""
    rows = zip(*(np.asarray(values).tolist() for values in columns.values()), strict=True)
    path.write_text("\n".join([",".join(columns), *(",".join(map(str, row)) for row in rows)]) + "\n")


def read_csv(path: Path) -> dict[str, list[str]]:
    """Read columns of text; lines that begin with # are skipped."""
    lines = [line for line in path.read_text().splitlines() if not line.startswith("#")]
    header, *rows = csv.reader(lines)
    return dict(zip(header, map(list, zip(*rows, strict=True)), strict=True))


def write_poses(
    path: Path, q: np.ndarray, xyz: np.ndarray, columns: Mapping[str, Sequence[object] | np.ndarray] | None = None
) -> None:
    """Write a file of measured poses; further columns by name."""
    joints = {f"q{i + 1}": row for i, row in enumerate(q.T)}
    write_csv(path, joints | dict(zip("xyz", xyz.T, strict=True)) | dict(columns or {}))


# -- arms of which tables are published, and what a fit changes in them


def _listed(
    name: str,
    names: Sequence[str],
    rows: Sequence[Sequence[float]],
    span: Sequence[Sequence[float]],
    parallel: Sequence[int],
    weights: Sequence[tuple[float, tuple[float, float, float]]] = (),
    slides: Sequence[int] = (),
) -> RealArm:
    """Arm of rows (theta, d, a, alpha) with poses drawn from ``span``; ``weights`` are masses and their centres."""
    parts = zip(names, rows, span, weights or [(0.0, (0.0, 0.0, 0.0))] * len(rows), strict=True)
    joints = [
        RealJoint(joint, i in slides, np.array(row, float), (low - 0.5, high + 0.5), mass, np.array(com), i in parallel)
        for i, (joint, row, (low, high), (mass, com)) in enumerate(parts)
    ]
    return RealArm(name, "standard", tuple(joints), np.array([0.06, 0.03, 0.12]))


SIX = ("j1", "j2", "j3", "j4", "j5", "j6")
_ALL = (
    # Corke and Armstrong-Helouvry 1994, the consensus; link 1 has no published mass.
    _listed(
        "puma560",
        SIX,
        ((0, 0, 0, _H), (0, 0, 0.4318, 0), (0, 0.15005, 0.0203, -_H), (0, 0.4318, 0, _H), (0, 0, 0, -_H), (0, 0, 0, 0)),
        ((-2.6, 2.6), (-0.7, 2.4), (-2.4, 0.7), (-1.8, 2.8), (-1.6, 1.6), (-3, 3)),
        (1,),
        (
            (0.0, (0, 0, 0)),
            (17.4, (-0.3638, 0.006, 0.2275)),
            (4.8, (-0.0203, -0.0141, 0.07)),
            (0.82, (0, 0.019, 0)),
            (0.34, (0, 0, 0)),
            (0.09, (0, 0, 0.032)),
        ),
    ),
    # Universal Robots' support article on DH parameters and masses of the UR10 (CB series).
    _listed(
        "ur10",
        SIX,
        (
            (0, 0.1273, 0, _H),
            (0, 0, -0.612, 0),
            (0, 0, -0.5723, 0),
            (0, 0.163941, 0, _H),
            (0, 0.1157, 0, -_H),
            (0, 0.0922, 0, 0),
        ),
        ((-3, 3), (-2.8, -0.3), (-2.4, 2.4), (-3, 3), (-2.8, 2.8), (-3, 3)),
        (1, 2),
        (
            (7.1, (0.021, 0, 0.027)),
            (12.7, (0.38, 0, 0.158)),
            (4.27, (0.24, 0, 0.068)),
            (2.0, (0, 0.007, 0.018)),
            (2.0, (0, 0.007, 0.018)),
            (0.365, (0, 0, -0.026)),
        ),
    ),
    # ABB's product specification; Nubiola and Bonev 2013. Masses are not published.
    _listed(
        "irb1600",
        SIX,
        (
            (0, 0.4865, 0.15, -_H),
            (-_H, 0, 0.7, 0),
            (0, 0, 0, -_H),
            (0, 0.6, 0, _H),
            (0, 0, 0, -_H),
            (2 * _H, 0.065, 0, 0),
        ),
        ((-2.8, 2.8), (-1, 1.8), (-2.6, 0.8), (-3, 3), (-1.8, 1.8), (-3, 3)),
        (1,),
    ),
    # After PAL Robotics' URDF of TIAGo, rounded to a DH table: a lift, then seven turning joints.
    _listed(
        "tiago",
        ("lift", *(f"arm{i}" for i in range(1, 8))),
        (
            (0, 0.79, 0.155, 0),
            (-_H, -0.18, 0.125, -_H),
            (_H, 0.0165, 0, _H),
            (_H, 0.3115, 0.02, -_H),
            (0, 0.027, -0.02, _H),
            (0, 0.312, 0, -_H),
            (0, 0, 0, _H),
            (0, 0.046, 0, 0),
        ),
        ((0, 0.35), (0.1, 2.65), (-1.45, 1), (-3.4, 1.45), (-0.3, 2.25), (-2, 2), (-1.35, 1.35), (-2, 2)),
        (0,),
        slides=(0,),
    ),
)
ARMS = {arm.name: arm for arm in _ALL}
SIX_JOINTS = ("puma560", "ur10", "irb1600")


@dataclass(frozen=True)
class Setup:
    """Coefficients of a standard table, and where each sits in the vector of them."""

    arm: RealArm

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.arm.joints)

    @property
    def span(self) -> np.ndarray:
        """(J, 2) ranges that poses are drawn from."""
        return self.arm.limits + np.array([0.5, -0.5])

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of all coefficients: base, target, then each joint's theta, d, a, alpha, beta."""
        names = [f"base_frame.{label}" for label in ("x", "y", "z", "roll", "pitch", "yaw")]
        names += [f"tool_frame.{label}" for label in "xyz"]
        for joint in self.arm.joints:
            zero = "d" if joint.slides else "theta"
            for label in ("theta", "d", "a", "alpha", "beta"):
                names.append(f"joint_offset.{joint.name}" if label == zero else f"link_geometry.{joint.name}.{label}")
        return tuple(names)

    def index(self, name: str) -> int:
        """Place of a coefficient."""
        return self.names.index(name)

    def declared(self, effects: Sequence[str]) -> np.ndarray:
        """Mask of the coefficients that the named effects free; beta only where neighbouring axes are parallel."""
        mask = np.array([name.split(".")[0] in effects for name in self.names])
        mask[9:].reshape(-1, 5)[:, 4] &= [joint.parallel for joint in self.arm.joints]
        return mask

    def erring(self, rng: np.random.Generator, size: float, of_target: float = 6e-3) -> np.ndarray:
        """Coefficients of an arm: base some 10 mm and 5 mrad off, target ``of_target`` m, others ``size`` rad and m."""
        values, wrong = np.zeros(len(self.names)), self.declared(["joint_offset", "link_geometry"])
        scales = np.repeat([6e-3, 3e-3, of_target], 3)
        values[:9] = scales * rng.standard_normal(9)
        values[wrong] = rng.normal(0, size, int(wrong.sum()))
        return values

    def positions(self, values: np.ndarray, q: np.ndarray) -> np.ndarray:
        """Where the target is at joints ``q`` (N, J): (N, 3), m, in the measuring frame."""
        once, place = np.unique(q, axis=0, return_inverse=True)
        last = self.frames(values, once)[-1]
        return (last[:, :3, 3] + last[:, :3, :3] @ (self.arm.tool + values[6:9]))[place.ravel()]

    def frames(self, values: np.ndarray, q: np.ndarray) -> list[np.ndarray]:
        """Frame of the base and of each link, (N, 4, 4) each."""
        truth = Truth(values[:6], values[6:9], values[9:].reshape(-1, 5))
        return [behind for _, behind in _frames(self.arm, truth, q, _Motion.none(q))]

    def jacobian(self, values: np.ndarray, q: np.ndarray, mask: np.ndarray) -> np.ndarray:
        """Derivatives of the positions to the coefficients of ``mask``: (3 N, P), rows x, y, z of each row in turn.

        A turn about axis u through o moves a point p by u x (p - o), a shift along u by u.
        """
        frames = self.frames(values, q)
        last = frames[-1]
        point = last[:, :3, 3] + last[:, :3, :3] @ (self.arm.tool + values[6:9])
        ends = (len(q), 3)
        roll, pitch, yaw = turn(2, values[5]) @ turn(1, values[4]), turn(2, values[5]), np.eye(4)
        columns = [np.broadcast_to(axis, ends) for axis in np.eye(3)]
        lever = point - frames[0][:, :3, 3]
        columns += [np.cross(axis, lever) for axis in (roll[:3, 0], pitch[:3, 1], yaw[:3, 2])]
        columns += [last[:, :3, k] for k in range(3)]
        for before, after, change in zip(frames, frames[1:], values[9:].reshape(-1, 5), strict=False):
            z, y, lever = before[:, :3, 2], after[:, :3, 1], point - after[:, :3, 3]
            x = after[:, :3, 0] * np.cos(change[4]) + after[:, :3, 2] * np.sin(change[4])
            columns += [np.cross(z, point - before[:, :3, 3]), z, x, np.cross(x, lever), np.cross(y, lever)]
        return np.array([columns[k] for k in np.flatnonzero(mask)]).reshape(-1, 3 * len(q)).T

    def joint_jacobian(self, values: np.ndarray, q: np.ndarray) -> np.ndarray:
        """Derivatives of the positions to each joint's variable: (N, 3, J)."""
        zeros = np.array([name.startswith("joint_offset") for name in self.names])
        return self.jacobian(values, q, zeros).reshape(len(q), 3, -1)


def check() -> None:
    """Compare the derivatives with complex steps."""
    rng = np.random.default_rng(0)
    for setup in map(Setup, _ALL):
        values, q = rng.normal(0, 0.05, len(setup.names)), rng.uniform(*setup.span.T, (20, setup.n))
        steps = [setup.positions(values + 1e-30j * row, q).imag.ravel() * 1e30 for row in np.eye(len(values))]
        worst = np.abs(np.array(steps).T - setup.jacobian(values, q, np.ones(len(values), bool))).max()
        print(f"{setup.arm.name}: derivatives agree to {worst:.1e}")


if __name__ == "__main__":
    check()
