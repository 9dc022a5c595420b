"""A step change between two poses: of the base, the target, a joint's zero, or the load at the flange."""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import PurePath
from typing import Any, Literal, cast

import numpy as np
from numpy.typing import NDArray

from robacc.chain import BASE, TOOL
from robacc.effects.base import (
    About,
    Effect,
    Need,
    Over,
    Term,
    Traits,
    commanded,
    compliance_unit,
    register,
    setting,
    varies,
)
from robacc.effects.frames import frame_terms
from robacc.geometry import Array
from robacc.gravity import gravity_torques, payload
from robacc.measurements import Measurements
from robacc.robots.arm import Arm


@register
@dataclass(frozen=True)
class Step(Effect):
    """Coordinates of the base, the target, or one joint, or the load at the flange, that change at one time or line.

    A load that nobody logged turns each of its joints by the compliance times the mass times the torque of 1 kg.

    Poses without a time, without lines, or of another file than ``file`` come after the step: the arm is as it is now.
    """

    part: Literal["base", "target", "joint", "payload"] = setting("base", written=lambda step: step.part != "joint")
    from_line: int | None = setting(None)
    """Line (or row) of the first pose after the step, as messages count it."""
    from_time: float | None = setting(None, key="from_time_s")
    """s, the time of the step; it is used in place of the line where poses have a time."""
    file: str | None = setting(None)
    """Name of the file that the line belongs to; None for any."""
    target: str | None = setting(None)
    """Name of the only target that moved; None for all."""
    turning: bool = setting(False)
    """True if the base, or the target, turns too."""
    span: float = field(default=0.0, compare=False)
    """Length of the run, s or lines; 0 if unknown."""

    name = "step"
    traits = Traits(
        joints_optional=True,
        needs=(
            Need(
                "the poses have neither a time_s that varies nor lines",
                lambda arm, data: varies(data.time) or data.rows is not None,
            ),
        ),
        is_searched=True,
        drivers=(),
        extrapolates="a change stays after its step",
        is_event=True,
    )
    about = About(
        summary="a step change between two poses: the base moved, the target was bumped, a joint's zero jumped, or the "
        "load changed",
        equation="base or tool x, y, z (and its rotations), or theta_j, + c from one pose on, 0 before it; part: "
        "payload: theta_j + c_j times the torque of 1 kg at the flange from one pose on",
        unit="rad (m for a prismatic joint), m for the base and the target; part: payload: rad/(N m) kg",
        usual_size="5e-5 to 5e-3 rad, 5e-5 to 5e-3 m; a motor turn over the gear ratio where an encoder lost a turn",
        usual_range=(5e-5, 5e-3),
        needs="time_s, or rows in the order of measurement",
        confused_with="frame_drift where it is gradual; joint errors where all poses after the step differ from those "
        "before it in a joint; payload_compliance where a load changes that was not logged",
        source="G. Lorden, Annals of Mathematical Statistics 42 (1971) 1897: likelihood ratio over all change points",
        example="{effect: step, part: target, from_time_s: 1800, values: {x: 2e-4, y: -1e-4, z: 5e-5}}",
    )

    @classmethod
    def usual(cls, arm: Arm, data: Measurements, joints: tuple[str, ...]) -> Effect:
        """Return a step in the middle of the run: of the base, or of the zero of ``joints``."""
        return cls(joints, "joint" if joints else "base").starting(float(np.median(sequence_of(data))), data)

    def chart(self) -> Over:
        """Return the time, or the line."""
        return Over("line" if self.from_time is None else "time_s", is_only=False)

    def starting(self, at: float, data: Measurements) -> Step:
        """Return the same step at a time (s) or line of ``data``."""
        timed = varies(data.time)
        return Step(
            self.joints,
            self.part,
            None if timed else math.ceil(at),
            at if timed else None,
            None if timed or data.source is None else PurePath(data.source).name,
            self.target,
            self.turning,
            float(np.ptp(sequence_of(data))),
        )

    def after(self, data: Measurements) -> Array:
        """Return ``(N,)`` 1 for poses after the step, 0 for poses before it."""
        now = np.ones(data.n)
        if self.from_time is not None:
            return now if data.time is None else (data.time >= self.from_time).astype(float)
        elsewhere = self.file is not None and data.source is not None and PurePath(data.source).name != self.file
        if self.from_line is None or data.rows is None or elsewhere:
            return now
        return (data.rows >= self.from_line).astype(float)

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return one term per joint, or three or six of the base or the target."""
        after = self.after(data)
        if self.part == "payload":
            after = after * unit_torques(arm, data)
            return tuple(
                self.joint_term(
                    arm, joint, after[arm.number(joint)], typical=5e-5, unit=f"{compliance_unit(arm, joint)} kg"
                )
                for joint in self.joints
            )
        if self.part == "joint":
            return tuple(self.joint_term(arm, joint, after) for joint in self.joints)
        owner = BASE if self.part == "base" else TOOL
        if self.target is not None:
            after = after * (data.target == self.target if data.target is not None else 1.0)
        return frame_terms(arm, owner, self.name, after, turning=self.turning)

    @classmethod
    def from_settings(cls, joints: tuple[str, ...], settings: Mapping[str, Any]) -> Effect:
        """Return the step; without ``part``, it is one of the joints if there are any, else of the base."""
        return super().from_settings(joints, {"part": "joint" if joints else "base", **settings})

    def conflict(self, given: Collection[str]) -> str | None:
        """Return the reason if the part does not go with the joints, the place, the target, or a turn."""
        if (self.part in ("joint", "payload")) != bool(self.joints):
            return (
                "expected part: base or part: target without joints, part: payload with joints, or joints without part"
            )
        if (self.from_line is None) == (self.from_time is None):
            return "expected from_line or from_time_s, the place of the step"
        if (self.target is not None and self.part != "target") or (self.turning and self.joints):
            return "target belongs to part: target, turning to the base or the target"
        return None

    def statement(
        self, arm: Arm, values: Mapping[str, float], between: tuple[str, str, str] | None = None
    ) -> str | None:
        """Return what moved, from where on and by how much, and what to do."""
        shift = math.hypot(*(values.get(f"{self.name}.{label}", 0.0) for label in "xyz")) * 1e3
        turn = math.hypot(*(values.get(f"{self.name}.{label}", 0.0) for label in ("roll", "pitch", "yaw"))) * 1e3
        size = f"{shift:.3g} mm" + (f" and {turn:.3g} mrad" if self.turning else "")
        place = f"line {self.from_line}" if self.from_time is None else f"{self.from_time:.6g} s"
        start = f"from {between[0] if between else place} on"
        if between is not None and between[1] != between[2]:
            start += f" (95 % between {between[1]} and {between[2]})"
        jumps = ", ".join(
            f"{joint} jumps by {1e3 * values.get(f'{self.name}.{joint}', 0.0):.3g} "
            f"{'mrad' if arm.is_revolute(joint) else 'mm'}"
            for joint in self.joints
        )
        what, check = {
            "base": (
                f"base is displaced by {size}",
                "check the mounting of the base and the instrument's tripod, and measure these poses again",
            ),
            "target": (
                f"target {f'{self.target} ' * (self.target is not None)}is displaced by {size}",
                "check its seat, and measure the earlier poses again",
            ),
            "payload": (
                f"arm carries another load, which deflects {', '.join(self.joints)}",
                "write payload_kg for each row (a part, another tool, a hose), and trace again",
            ),
            "joint": (
                f"zero of {jumps}",
                "look for a collision, a lost encoder count or a new mastering; master the joint and measure again",
            ),
        }[self.part]
        return f"{start}, the {what}: {check}"

    def __str__(self) -> str:
        """Return ``step[j2]`` or ``step[base]``."""
        joints = "" if self.part == "payload" else ",".join(self.joints)
        return f"{self.name}[{joints or self.target or self.part}]"


def unit_torques(arm: Arm, data: Measurements) -> Array:
    """Return ``(J, N)`` torque of gravity (N m) or force (N) on each joint by a payload of 1 kg."""
    return gravity_torques(arm, commanded(data, Step.name), payload(arm, np.ones(data.n)))


def sequence_of(data: Measurements) -> Array:
    """Return ``(N,)`` the quantity that orders the poses: the time if it varies, else the line in the file."""
    if data.time is not None and varies(data.time):
        return data.time
    return np.arange(data.n, dtype=float) if data.rows is None else data.rows.astype(float)


# Steps as a search builds them: every part that can move, and the poses where its step may lie.

CHANGE_POINT = Step.name
"""Name of the effect that a search over the poses finds."""
FEWEST = 5
"""Visits on each side of a step that a search demands: fewer deviating visits are outliers."""
_LEAST_TORQUE = 0.1
"""Least torque of a load on a joint that a search for a changed load includes, over the largest on any joint."""


def step_forms(arm: Arm, data: Measurements) -> Iterator[Effect]:
    """Yield every form of a step, before all poses: the base, turning or not, the target or targets, each joint."""
    if Step.missing(arm, data) is not None:
        return
    turns = data.rotation is not None
    forms = [Step((), "base"), Step((), "base", turning=True), Step((), "target", turning=turns)]
    if data.target is not None:
        names = np.unique(data.target)
        forms += [Step((), "target", target=str(name), turning=turns) for name in names if names.size > 1]
    forms += [Step((joint,), "joint") for joint in arm.names]
    # A load that changes is in the column of a payload that is logged. Without masses, the weight that the arm always
    # carries has no effect of one coefficient, and a step of the load near the first pose would stand for it.
    if data.payload is None and arm.chain.bodies:
        torque = np.sqrt(np.mean(np.square(unit_torques(arm, data)), axis=1))
        loaded = torque > _LEAST_TORQUE * torque.max()
        forms += [Step(tuple(itertools.compress(arm.names, loaded)), "payload")] if loaded.any() else []
    for form in forms:
        yield form.starting(float(sequence_of(data).min()), data)


def at_place(form: Effect, place: float, data: Measurements) -> Effect:
    """Return the step of the same form at a place of the sequence."""
    return cast(Step, form).starting(place, data)


def possible_places(form: Effect, between: Array) -> Array:
    """Return the places, of ``between`` poses, where a search lets a step of a form lie.

    A changed load lies after a quarter of the visits: nearer to the first pose, it would stand for a load that is there
    all the time.
    """
    return between[between.size // 4 :] if cast(Step, form).part == "payload" else between


def is_step(effect: Effect) -> bool:
    """Return whether an effect is a step, whose place a search finds."""
    return isinstance(effect, Step)


def place_of(effect: Effect) -> float:
    """Return the place of a step in the sequence, s or line."""
    step = cast(Step, effect)
    return float(step.from_line or 0) if step.from_time is None else step.from_time


def same_form(first: Effect, second: Effect) -> bool:
    """Return whether two steps differ in their place at most."""
    steps = (cast(Step, effect) for effect in (first, second))
    one, other = (dataclasses.replace(step, from_line=None, from_time=None, file=None) for step in steps)
    return one == other


def places(data: Measurements, visits: NDArray[np.int64]) -> tuple[NDArray[np.int64], Array]:
    """Return ``(N,)`` each pose's number in the sequence, and ``(P,)`` the place before each number but the first.

    A time lies half-way between two poses; a line is that of the first pose after it. Rows of a visit, numbered
    ``(N,)``, have the same number.
    """
    sequence = sequence_of(data)
    start = np.full(int(visits.max(initial=0)) + 1, np.inf)
    np.minimum.at(start, visits, sequence)
    values, number = np.unique(start[visits], return_inverse=True)
    before = 0.5 * (values[1:] + values[:-1]) if sequence is data.time else values[1:]
    return number.astype(np.int64), before


def place_text(place: float, effect: Effect, data: Measurements) -> str:
    """Return a place of a step as text: the first pose after it, with its time where the step has one."""
    sequence = sequence_of(data)
    after = np.flatnonzero(sequence >= place)
    line = data.place(int(after[np.argmin(sequence[after])])) if after.size else "the end"
    return line if cast(Step, effect).from_time is None else f"{place:.6g} s ({line})"
