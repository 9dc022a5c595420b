"""Arms in plain NumPy: forward kinematics, derivatives, robot files.

Nothing of robacc is imported: what the studies compare it with shares no line with it. Conventions are those of the
robot file: standard Denavit-Hartenberg, A = Rz(theta) Tz(d) Tx(a) Rx(alpha) Ry(beta), SI units. A coefficient has the
name that robacc's results give it. The nominal base is the identity; its coefficients are x, y, z and Rz(yaw)
Ry(pitch) Rx(roll). All coefficients are differences from the nominal model.

`python arm.py` compares the derivatives with complex steps.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

GRAVITY = np.array([0.0, 0.0, -9.81])
_PI = math.pi


@dataclass(frozen=True)
class Arm:
    """One arm: ``table`` rows (theta, d, a, alpha), ``span`` the joint ranges that poses are drawn from."""

    name: str
    joints: tuple[str, ...]
    table: np.ndarray
    span: np.ndarray
    parallel: tuple[int, ...] = ()
    prismatic: tuple[int, ...] = ()
    masses: tuple[float, ...] = ()
    coms: tuple[tuple[float, float, float], ...] = ()

    @property
    def n(self) -> int:
        """Number of joints."""
        return len(self.joints)


def _names(prefix: str, n: int) -> tuple[str, ...]:
    return tuple(f"{prefix}{i + 1}" for i in range(n))


# Corke and Armstrong-Helouvry 1994, the consensus; link 1 has no published mass.
PUMA560 = Arm(
    "puma560",
    _names("j", 6),
    np.array(
        [
            [0, 0, 0, _PI / 2],
            [0, 0, 0.4318, 0],
            [0, 0.15005, 0.0203, -_PI / 2],
            [0, 0.4318, 0, _PI / 2],
            [0, 0, 0, -_PI / 2],
            [0, 0, 0, 0],
        ]
    ),
    np.array([[-2.6, 2.6], [-0.7, 2.4], [-2.4, 0.7], [-1.8, 2.8], [-1.6, 1.6], [-3.0, 3.0]]),
    parallel=(1,),
    masses=(0.0, 17.4, 4.8, 0.82, 0.34, 0.09),
    coms=((0, 0, 0), (-0.3638, 0.006, 0.2275), (-0.0203, -0.0141, 0.07), (0, 0.019, 0), (0, 0, 0), (0, 0, 0.032)),
)
# Universal Robots' support article on DH parameters and masses of the UR10 (CB series).
UR10 = Arm(
    "ur10",
    _names("j", 6),
    np.array(
        [
            [0, 0.1273, 0, _PI / 2],
            [0, 0, -0.612, 0],
            [0, 0, -0.5723, 0],
            [0, 0.163941, 0, _PI / 2],
            [0, 0.1157, 0, -_PI / 2],
            [0, 0.0922, 0, 0],
        ]
    ),
    np.array([[-3.0, 3.0], [-2.8, -0.3], [-2.4, 2.4], [-3.0, 3.0], [-2.8, 2.8], [-3.0, 3.0]]),
    parallel=(1, 2),
    masses=(7.1, 12.7, 4.27, 2.0, 2.0, 0.365),
    coms=((0.021, 0, 0.027), (0.38, 0, 0.158), (0.24, 0, 0.068), (0, 0.007, 0.018), (0, 0.007, 0.018), (0, 0, -0.026)),
)
# ABB's product specification; Nubiola and Bonev 2013. Masses are not published.
IRB1600 = Arm(
    "irb1600",
    _names("j", 6),
    np.array(
        [
            [0, 0.4865, 0.15, -_PI / 2],
            [-_PI / 2, 0, 0.7, 0],
            [0, 0, 0, -_PI / 2],
            [0, 0.6, 0, _PI / 2],
            [0, 0, 0, -_PI / 2],
            [_PI, 0.065, 0, 0],
        ]
    ),
    np.array([[-2.8, 2.8], [-1.0, 1.8], [-2.6, 0.8], [-3.0, 3.0], [-1.8, 1.8], [-3.0, 3.0]]),
    parallel=(1,),
)
# After PAL Robotics' URDF of TIAGo, rounded to a DH table: a lift, then seven turning joints.
TIAGO = Arm(
    "tiago",
    ("lift", *_names("arm", 7)),
    np.array(
        [
            [0, 0.79, 0.155, 0],
            [-_PI / 2, -0.18, 0.125, -_PI / 2],
            [_PI / 2, 0.0165, 0, _PI / 2],
            [_PI / 2, 0.3115, 0.02, -_PI / 2],
            [0, 0.027, -0.02, _PI / 2],
            [0, 0.312, 0, -_PI / 2],
            [0, 0, 0, _PI / 2],
            [0, 0.046, 0, 0],
        ]
    ),
    np.array(
        [
            [0.0, 0.35],
            [0.1, 2.65],
            [-1.45, 1.0],
            [-3.4, 1.45],
            [-0.3, 2.25],
            [-2.0, 2.0],
            [-1.35, 1.35],
            [-2.0, 2.0],
        ]
    ),
    parallel=(0,),
    prismatic=(0,),
)
ARMS = {arm.name: arm for arm in (PUMA560, UR10, IRB1600, TIAGO)}
SIX_JOINTS = ("puma560", "ur10", "irb1600")
TARGETS = np.array([[0.06, 0.03, 0.12], [-0.04, 0.07, 0.12], [-0.05, -0.07, 0.16], [0.07, -0.06, 0.18], [0, 0.1, 0.2]])
"""Places of the targets in the last link's frame, m; the first is the tool where there is only one."""


@dataclass(frozen=True)
class Setup:
    """An arm with its targets: which coefficients there are and where each sits in the vector of them."""

    arm: Arm
    n_targets: int = 1

    @property
    def targets(self) -> tuple[str, ...]:
        """Names of the targets."""
        return _names("smr", self.n_targets)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of all coefficients: base, targets, then each joint's theta, d, a, alpha, beta."""
        base = [f"base_frame.{label}" for label in ("x", "y", "z", "roll", "pitch", "yaw")]
        prefixes = ["tool_frame"] if self.n_targets == 1 else [f"tool_frame.{target}" for target in self.targets]
        tool = [f"{prefix}.{label}" for prefix in prefixes for label in "xyz"]
        joints = []
        for i, joint in enumerate(self.arm.joints):
            zero = "d" if i in self.arm.prismatic else "theta"
            for label in ("theta", "d", "a", "alpha", "beta"):
                joints.append(f"joint_offset.{joint}" if label == zero else f"link_geometry.{joint}.{label}")
        return tuple(base + tool + joints)

    def index(self, name: str) -> int:
        """Place of a coefficient."""
        return self.names.index(name)

    def declared(self, effects: Sequence[str]) -> np.ndarray:
        """Mask of the coefficients that the named effects free; beta only where neighbouring axes are parallel."""
        mask = np.array([name.split(".")[0] in effects for name in self.names])
        for i, joint in enumerate(self.arm.joints):
            if i not in self.arm.parallel:
                mask[self.index(f"link_geometry.{joint}.beta")] = False
        return mask

    def placed(self, rng: np.random.Generator, of_target: float = 6e-3) -> np.ndarray:
        """Coefficients of a nominal arm whose base is some 10 mm and 5 mrad off, and its target ``of_target``."""
        values = np.zeros(len(self.names))
        values[:3], values[3:6], values[6:9] = (
            rng.normal(0, 6e-3, 3),
            rng.normal(0, 3e-3, 3),
            rng.normal(0, of_target, 3),
        )
        return values

    def erring(self, rng: np.random.Generator, size: float, of_target: float = 6e-3) -> np.ndarray:
        """As :meth:`placed`, with zeros and links off by ``size`` rad and m."""
        values, wrong = self.placed(rng, of_target), self.declared(["joint_offset", "link_geometry"])
        values[wrong] = rng.normal(0, size, int(wrong.sum()))
        return values

    def positions(self, values: np.ndarray, q: np.ndarray, target: np.ndarray) -> np.ndarray:
        """Where target number ``target`` (N,) is at joints ``q`` (N, n): (N, 3), m, in the measuring frame."""
        once, place = np.unique(q, axis=0, return_inverse=True)
        frame = self.frames(values, once)[-1][place.ravel()]
        return frame[:, :3, 3] + np.einsum("nij,nj->ni", frame[:, :3, :3], self._tools(values)[target])

    def _tools(self, values: np.ndarray) -> np.ndarray:
        return TARGETS[: self.n_targets] + values[6 : 6 + 3 * self.n_targets].reshape(-1, 3)

    def frames(self, values: np.ndarray, q: np.ndarray) -> list[np.ndarray]:
        """Frame of the base and of each link, (N, 4, 4) each."""
        x, y, z, roll, pitch, yaw = values[:6]
        base = move(x, y, z) @ turn(2, yaw) @ turn(1, pitch) @ turn(0, roll)
        frames = [np.broadcast_to(base, (len(q), 4, 4))]
        changes, nothing = self._changes(values), np.zeros(len(q))
        for i in range(self.arm.n):
            theta, d, a, alpha = self.arm.table[i] + changes[i, :4]
            moving = q[:, i]
            theta, d = (theta, d + moving) if i in self.arm.prismatic else (theta + moving, d)
            fixed = move(a, 0.0, 0.0) @ turn(0, alpha) @ turn(1, changes[i, 4])
            frames.append(frames[-1] @ turn(2, theta + nothing) @ move(0.0, 0.0, d + nothing) @ fixed)
        return frames

    def _changes(self, values: np.ndarray) -> np.ndarray:
        return values[6 + 3 * self.n_targets :].reshape(-1, 5)

    def jacobian(self, values: np.ndarray, q: np.ndarray, target: np.ndarray, mask: np.ndarray) -> np.ndarray:
        """Derivatives of the positions to the coefficients of ``mask``: (3 N, P), rows x, y, z of each row in turn.

        A turn about axis u through o moves a point p by u x (p - o), a shift along u by u.
        """
        once, place = np.unique(q, axis=0, return_inverse=True)
        frames = [frame[place.ravel()] for frame in self.frames(values, once)]
        last, n = frames[-1], self.n_targets
        point = last[:, :3, 3] + np.einsum("nij,nj->ni", last[:, :3, :3], self._tools(values)[target])
        ends = (len(q), 3)
        roll, pitch, yaw = turn(2, values[5]) @ turn(1, values[4]), turn(2, values[5]), np.eye(4)
        columns = [np.broadcast_to(axis, ends) for axis in np.eye(3)]
        arm = point - frames[0][:, :3, 3]
        columns += [np.cross(axis, arm) for axis in (roll[:3, 0], pitch[:3, 1], yaw[:3, 2])]
        columns += [last[:, :3, k] * (target == t)[:, None] for t in range(n) for k in range(3)]
        for i, change in enumerate(self._changes(values)):
            before, after = frames[i], frames[i + 1]
            z, y, arm = before[:, :3, 2], after[:, :3, 1], point - after[:, :3, 3]
            x = after[:, :3, 0] * np.cos(change[4]) + after[:, :3, 2] * np.sin(change[4])
            columns += [np.cross(z, point - before[:, :3, 3]), z, x, np.cross(x, arm), np.cross(y, arm)]
        return np.array([columns[k] for k in np.flatnonzero(mask)]).reshape(-1, 3 * len(q)).T

    def joint_jacobian(self, values: np.ndarray, q: np.ndarray, target: np.ndarray) -> np.ndarray:
        """Derivatives of the positions to each joint's variable: (3 N, n)."""
        return self.jacobian(values, q, target, np.array([name.startswith("joint_offset") for name in self.names]))

    def write(self, path: Path, masses: bool = True) -> None:
        """Write the nominal robot file."""
        lines = ["robacc: 1", f"name: {self.arm.name}", "convention: standard", "units: {length: m, angle: rad}"]
        if self.n_targets == 1:
            lines.append(f"tool: {{xyz: {TARGETS[0].tolist()}, rpy: [0, 0, 0]}}")
        else:
            lines.append("targets:")
            lines += [f"  {name}: {{xyz: {TARGETS[i].tolist()}}}" for i, name in enumerate(self.targets)]
        lines.append("joints:")
        for i, joint in enumerate(self.arm.joints):
            theta, d, a, alpha = (float(x) for x in self.arm.table[i])
            kind = "prismatic" if i in self.arm.prismatic else "revolute"
            low, high = (float(x) for x in self.arm.span[i] + [-0.5, 0.5])
            lines.append(
                f"  - {{name: {joint}, type: {kind}, theta: {theta!r}, d: {d!r}, a: {a!r}, alpha: {alpha!r}, "
                f"limits: [{low!r}, {high!r}]"
                + (f", mass: {self.arm.masses[i]}, com: {list(self.arm.coms[i])}" if self._weighs(i, masses) else "")
                + "}"
            )
        path.write_text("\n".join(lines) + "\n")

    def _weighs(self, i: int, masses: bool) -> bool:
        return masses and bool(self.arm.masses) and self.arm.masses[i] > 0


def write_poses(
    path: Path, q: np.ndarray, xyz: np.ndarray, columns: Mapping[str, Sequence[object]] | None = None
) -> None:
    """Write a file of measured poses; further columns by name."""
    more = columns or {}
    header = [*(f"q{i + 1}" for i in range(q.shape[1])), "x", "y", "z", *more]
    lines = [",".join(header)]
    for k in range(len(q)):
        numbers = [f"{x:.15g}" for x in (*q[k], *xyz[k])]
        lines.append(",".join([*numbers, *(str(values[k]) for values in more.values())]))
    path.write_text("\n".join(lines) + "\n")


def turn(axis: int, angle: complex | float | np.ndarray) -> np.ndarray:
    """Rotations (..., 4, 4) about a coordinate axis."""
    angle = np.asarray(angle)
    out = np.zeros((*angle.shape, 4, 4), np.result_type(angle, float))
    i, k = (axis + 1) % 3, (axis + 2) % 3
    out[..., axis, axis] = out[..., 3, 3] = 1.0
    out[..., i, i] = out[..., k, k] = np.cos(angle)
    out[..., k, i] = np.sin(angle)
    out[..., i, k] = -out[..., k, i]
    return out


def move(x: float | np.ndarray, y: float | np.ndarray, z: float | np.ndarray) -> np.ndarray:
    """Translations (..., 4, 4)."""
    place = np.stack(np.broadcast_arrays(x, y, z), axis=-1)
    out = np.zeros((*place.shape[:-1], 4, 4), np.result_type(place, float))
    out[..., range(4), range(4)] = 1.0
    out[..., :3, 3] = place
    return out


def check() -> None:
    """Compare the derivatives with complex steps."""
    rng = np.random.default_rng(0)
    for arm in ARMS.values():
        setup = Setup(arm, 3)
        values = rng.normal(0, 0.05, len(setup.names))
        q, target = rng.uniform(*arm.span.T, (20, arm.n)), rng.integers(3, size=20)
        mask = np.ones(len(values), bool)
        steps = [setup.positions(values + 1e-30j * row, q, target).imag.ravel() * 1e30 for row in np.eye(len(values))]
        worst = np.abs(np.array(steps).T - setup.jacobian(values, q, target, mask)).max()
        print(f"{arm.name}: derivatives agree to {worst:.1e}")


if __name__ == "__main__":
    check()
