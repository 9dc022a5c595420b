"""Step changes as a search builds them: every part that can move, and the poses where its step may lie."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from robacc.effects.base import Effect
from robacc.effects.step import Step, sequence_of, unit_torques
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.robots.arm import Arm

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
    loaded = () if data.payload is not None or not arm.chain.bodies else _loaded_joints(arm, data)
    forms += [Step(loaded, "payload")] if loaded else []
    for form in forms:
        yield form.starting(float(sequence_of(data).min()), data)


def _loaded_joints(arm: Arm, data: Measurements) -> tuple[str, ...]:
    """Return the joints that a load at the flange turns most."""
    torque = np.sqrt(np.mean(np.square(unit_torques(arm, data)), axis=1))
    return tuple(joint for joint, size in zip(arm.names, torque, strict=True) if size > _LEAST_TORQUE * torque.max())


def at_place(form: Effect, place: float, data: Measurements) -> Effect:
    """Return the step of the same form at a place of the sequence."""
    assert isinstance(form, Step)
    return form.starting(place, data)


def possible_places(form: Effect, between: Array) -> Array:
    """Return the places, of ``between`` poses, where a search lets a step of a form lie.

    A changed load lies after a quarter of the visits: nearer to the first pose, it would stand for a load that is there
    all the time.
    """
    is_load = isinstance(form, Step) and form.part == "payload"
    return between[between.size // 4 :] if is_load else between


def is_step(effect: Effect) -> bool:
    """Return whether an effect is a step, whose place a search finds."""
    return isinstance(effect, Step)


def place_of(effect: Effect) -> float:
    """Return the place of a step in the sequence, s or line."""
    assert isinstance(effect, Step)
    return float(effect.from_line or 0) if effect.from_time is None else effect.from_time


def same_form(first: Effect, second: Effect) -> bool:
    """Return whether two steps differ in their place at most."""
    if not isinstance(first, Step) or not isinstance(second, Step):
        return False
    plain = [dataclasses.replace(step, from_line=None, from_time=None, file=None) for step in (first, second)]
    return plain[0] == plain[1]


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
    assert isinstance(effect, Step)
    sequence = sequence_of(data)
    after = np.flatnonzero(sequence >= place)
    line = data.place(int(after[np.argmin(sequence[after])])) if after.size else "the end"
    return line if effect.from_time is None else f"{place:.6g} s ({line})"
