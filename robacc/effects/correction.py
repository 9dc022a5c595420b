"""Empirical correction of joints: a polynomial of one or two drivers, or a smooth function of all joints."""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from robacc.effects.base import (
    About,
    Effect,
    Over,
    Part,
    Term,
    Traits,
    as_plain,
    commanded,
    driven_by,
    register,
    scaled,
    setting,
)
from robacc.effects.drivers import Validity
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.robots.arm import BASE, Arm

ABOUT = About(
    summary="empirical correction of one joint as a smooth function of a driver, or of joints or the position as one "
    "of the pose",
    equation="theta_j + sum c_k T_k(x), T_k Chebyshev polynomials of the driver scaled to its range; or theta_j + "
    "sum c_jk phi_k(q), phi a basis of a Gaussian process over the joints; or the same of the position",
    unit="rad (m for a prismatic joint)",
    usual_size="1e-5 to 1e-3 rad",
    usual_range=(1e-05, 0.001),
    needs="the driver's column, for example time_s",
    confused_with="every effect of the same joints; a trace adds it where no cause describes an error",
    source="M. C. Kennedy, A. O'Hagan, Bayesian calibration of computer models, J. R. Stat. Soc. B 63 (2001) 425; "
    "prior width by marginal likelihood (REML)",
    example="{effect: joint_correction, joints: [j3], drivers: [j2], range: [[-1, 1]], degree: 3, "
    "values: {j3.j2.T2: 1e-4}}",
)
_OF_JOINT = {"own": "{joint}", "torque": "torque_{joint}", "direction": "direction_{joint}"}
"""Drivers that are another for each joint, as settings and as :mod:`robacc.effects.drivers` name them."""
_MOST_TERMS = 480
"""Largest number of coefficients: as many as six profiles of a joint have together."""
_LEFT = 0.01
"""Share of the variance of a pose's error and noise that the centres may leave out: a std changes by 0.5 %."""
_JITTER = 1e-9
"""Added to the kernel of the centres, so that its factor exists where two of them nearly coincide."""


@register
@dataclass(frozen=True)
class JointCorrection(Effect):
    """Joint variable plus a polynomial, in Chebyshev form, of one driver or of two together.

    A driver is a joint's name, ``torque`` (of the arm's own weight about the joint's axis), ``payload_kg``,
    ``temperature_c``, ``time_s``, or ``direction`` (of approach; it only multiplies another driver). The terms share a
    Gaussian prior whose standard deviation is estimated. Outside its validity range, a driver stays at the end of it.
    """

    drivers: tuple[str, ...] = setting((), written=True)
    ranges: tuple[tuple[float, float], ...] = setting((), key="range", written=True)
    degree: int = setting(8, written=True, least=1, most=40)

    name = "joint_correction"
    traits = Traits(is_empirical=True)
    about = ABOUT

    @classmethod
    def usual(cls, arm: Arm, data: Measurements, joints: tuple[str, ...]) -> Effect:
        """Return a correction of each joint by its own variable."""
        q = commanded(data, cls.name)[[arm.number(joint) for joint in joints]]
        return cls(joints, ("own",), ((float(q.min()), float(q.max())),), 8)

    def chart(self) -> Over:
        """Return the first of the correction's drivers."""
        return Over(_OF_JOINT.get(self.drivers[0], self.drivers[0]), len(self.drivers) == 1)

    def depends_on(self, arm: Arm) -> tuple[str, ...]:
        """Return the joints, torques and circumstances that drive it."""
        return tuple(_OF_JOINT.get(driver, driver) for driver in self.drivers if driver != "direction")

    def validity(self, arm: Arm, data: Measurements) -> Validity:
        """Return the ranges that its polynomials are scaled to, whatever the poses."""
        return {
            _OF_JOINT.get(driver, driver).replace("{joint}", joint): ends
            for driver, ends in zip(self.drivers, self.ranges, strict=True)
            for joint in self.joints
            if driver != "direction"
        }

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return a term for each polynomial; the constant belongs to joint_offset."""
        drivers = "_".join(self.drivers)
        return tuple(
            self.joint_term(
                arm, joint, column, f"{drivers}.{label}", group=f"{self.name}.{joint}.{drivers}", weight=1.0 / degree
            )
            for joint in self.joints
            for label, degree, column in self._basis(arm, data, joint)
        )

    def _basis(self, arm: Arm, data: Measurements, joint: str) -> Iterator[tuple[str, int, Array]]:
        """Yield label, degree and values ``(N,)`` of each polynomial."""
        columns = []
        for driver, (low, high) in zip(self.drivers, self.ranges, strict=True):
            value = driven_by(arm, data, _OF_JOINT.get(driver, driver).replace("{joint}", joint), self.name)
            if driver == "direction":
                columns.append([np.ones_like(value), value])
                continue
            scaled = np.clip((2 * value - low - high) / ((high - low) or 1.0), -1.0, 1.0)
            columns.append([np.cos(k * np.arccos(scaled)) for k in range(self.degree + 1)])
        if len(columns) == 1:
            yield from ((f"T{k}", k, column) for k, column in enumerate(columns[0]) if k)
            return
        first, second = columns
        for i, a in enumerate(first):
            for j, b in enumerate(second):
                if 0 < i + j <= self.degree + 1 and (j if self.drivers[1] == "direction" else True):
                    yield f"T{i}T{j}", i + j, a * b

    def from_units(self, arm: Arm, length: float, angle: float) -> Effect:
        """Return the correction in SI; ranges of joints are in the file's unit of length or angle."""
        sizes = []
        for driver in self.drivers:
            units = {arm.unit(joint) for joint in (self.joints if driver == "own" else (driver,)) if joint in arm.names}
            sizes.append(1.0 if not units else angle if units == {"rad"} else length)
        return dataclasses.replace(self, ranges=tuple(map(scaled, self.ranges, sizes)))

    @classmethod
    def from_settings(cls, joints: tuple[str, ...], settings: Mapping[str, Any]) -> Effect:
        """Return the correction, or with ``centres`` the one that is a function of all joints."""
        of_pose = "centres" in settings
        return PoseCorrection.from_settings(joints, settings) if of_pose else super().from_settings(joints, settings)

    def conflict(self, given: Collection[str]) -> str | None:
        """Return the reason if there are not one or two drivers, each with a range."""
        if len(self.drivers) not in (1, 2):
            return f"drivers must be a list of one or two names, found {list(self.drivers)!r}"
        if len(self.ranges) != len(self.drivers):
            return f"range must be a list of [low, high], one for each driver, found {as_plain(self.ranges)!r}"
        return None


@dataclass(frozen=True)
class PoseCorrection(Effect):
    """Joint variables, or the position, plus a Gaussian process over all joints, in the basis of some centres.

    It is the form of `joint_correction` with the settings ``lengths`` and ``centres``.
    The kernel of two poses is exp(-sum (2 sin(d_k / 2))^2 / (2 l_k^2)), d_k the difference of joint k (a slide has d_k
    itself) and l_k its length. With L L' the kernel of the centres, the basis is L^-1 k(centres, q) (subset of
    regressors: Rasmussen and Williams 2006, section 8.3.1), whose coefficients have one common variance. Far from the
    centres the correction fades to zero.
    """

    lengths: tuple[float, ...] = setting((), written=True, above=0.0)
    centres: tuple[tuple[float, ...], ...] = setting((), written=True)
    moves: Literal["joints", "position"] = setting("joints")
    """Whether each joint has a process, or the target's position one along each axis of the measuring frame."""

    name = "joint_correction"
    traits = Traits(extrapolates="it fades to zero away from the poses that it was fitted to", is_empirical=True)
    about = ABOUT

    @classmethod
    def over(
        cls,
        arm: Arm,
        data: Measurements,
        joints: Sequence[str],
        lengths: Sequence[float],
        moves: Literal["joints", "position"] = "joints",
        noise: float = 0.0,
    ) -> PoseCorrection:
        """Return the correction with centres among these poses, by pivots of their kernel's Cholesky factor.

        ``noise`` is the variance of the noise over that of the process.
        """
        effect = cls(tuple(joints), tuple(map(float, lengths)), moves=moves)
        most = _MOST_TERMS // len(effect.carriers(arm))
        q = commanded(data, cls.name)[[arm.number(joint) for joint in joints]]
        left, factor, chosen = np.ones(data.n), np.zeros((0, data.n)), list[int]()
        # The first centre is the pose nearest to their mean, whatever the order of the rows.
        score = -np.sum(np.square((q - q.mean(axis=1, keepdims=True)) / np.array(lengths)[:, None]), axis=0)
        while data.n and len(chosen) < most and left.max() > _LEFT * (1.0 + noise):
            pivot = int(np.argmax(score))
            row = effect._kernel(arm, q[:, [pivot]], q)[0] - factor[:, pivot] @ factor
            factor = np.vstack((factor, row / np.sqrt(left[pivot])))
            left = left - np.square(factor[-1])
            chosen.append(pivot)
            score = left
        return dataclasses.replace(effect, centres=tuple(tuple(pose) for pose in q[:, chosen].T.tolist()))

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return a term for each joint and centre."""
        q = commanded(data, self.name)[[arm.number(joint) for joint in self.joints]]
        centres = np.array(self.centres).reshape(-1, len(self.joints)).T
        kernel = self._kernel(arm, centres, centres) + _JITTER * np.eye(len(self.centres))
        basis = np.linalg.solve(np.linalg.cholesky(kernel), self._kernel(arm, centres, q))
        return tuple(
            Term(f"{self.name}.{label}.c{k}", unit, 1e-4, (Part(motion, row),), group=self.name)
            for label, unit, motion in self.carriers(arm)
            for k, row in enumerate(basis, 1)
        )

    def carriers(self, arm: Arm) -> list[tuple[str, str, int]]:
        """Return label, unit and motion of what the processes move: the joints, or the base along its axes."""
        if self.moves == "position":
            return [(axis, "m", arm.chain.index(BASE, axis)) for axis in "xyz"]
        return [(joint, arm.unit(joint), arm.axis_motion(joint)) for joint in self.joints]

    def _kernel(self, arm: Arm, first: Array, second: Array) -> Array:
        """Return ``(A, B)`` the kernel of poses ``(J, A)`` and ``(J, B)``."""
        distance = np.zeros((first.shape[1], second.shape[1]))
        for joint, length, a, b in zip(self.joints, self.lengths, first, second, strict=True):
            apart = a[:, None] - b
            distance += np.square((2.0 * np.sin(0.5 * apart) if arm.is_revolute(joint) else apart) / length)
        return np.asarray(np.exp(-0.5 * distance))

    def from_units(self, arm: Arm, length: float, angle: float) -> Effect:
        """Return the correction in SI; lengths and centres are in the file's unit of length or angle."""
        sizes = [angle if arm.is_revolute(joint) else length for joint in self.joints]
        return dataclasses.replace(
            self,
            lengths=tuple(map(scaled, self.lengths, sizes)),
            centres=tuple(tuple(map(scaled, centre, sizes)) for centre in self.centres),
        )

    def conflict(self, given: Collection[str]) -> str | None:
        """Return the reason if lengths or centres have not a number for each joint."""
        if len(self.lengths) != len(self.joints):
            return f"lengths must be a positive number for each joint, found {list(self.lengths)!r}"
        if any(len(centre) != len(self.joints) for centre in self.centres):
            return f"centres must be lists of a number for each joint, found {as_plain(self.centres)!r}"
        return None

    @property
    def term_of_covariance(self) -> str | None:
        """Return the process over all joints."""
        return "smooth" if self.moves == "joints" else "field"
