"""Poses outside the validity ranges of a model's effects."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from robacc.effects.drivers import MARGIN, driver_unit, driver_values, range_excess
from robacc.effects.specification import Known, known_effects
from robacc.errors import InputError, Problem
from robacc.measurements import Measurements, even_rows
from robacc.modelling.model import Model
from robacc.robots.arm import Arm
from robacc.robots.description import Robot

_ROUNDING = 1e-9
"""Excess (SI) that rounding explains."""
_SIZED = 200
"""Poses that the size of an effect is known from."""
_LISTED = 6
"""Drivers that a message lists; the others are counted."""


@dataclass(frozen=True, slots=True)
class OutsideRange:
    """Poses outside one validity range of one effect."""

    effect: str
    driver: str
    """Joint, or ``time_s``, ``temperature_c``, ``payload_kg``, ``speed_JOINT``, ``torque_JOINT``."""
    unit: str
    low: float
    high: float
    n_poses: int
    excess: float
    """Largest distance of a pose from the range."""
    first_row: int
    """Index of the first such pose."""
    is_held: bool
    """True if the effect keeps its value at the end of the range, False if it extrapolates."""


@dataclass(frozen=True, slots=True)
class OutsideValidity:
    """Poses outside the validity ranges of a model."""

    n_poses: int
    """Poses outside at least one range."""
    n: int
    """All poses."""
    ranges: tuple[OutsideRange, ...]
    """Ranges that some pose exceeds, by number of poses."""
    std_max: float
    """Largest standard deviation (m) of the position that held effects and profiles add outside their ranges."""

    def warnings(self) -> tuple[str, ...]:
        """Return one sentence with the drivers and how far the poses exceed their ranges; empty if all are inside."""
        if not self.n_poses:
            return ()
        listed = "; ".join(_sentence(item) for item in self.ranges[:_LISTED])
        more = f"; and {len(self.ranges) - _LISTED} more" if len(self.ranges) > _LISTED else ""
        verb = "pose is" if self.n == 1 else f"of {self.n} poses are"
        added = f", which adds up to {self.std_max * 1e3:.2g} mm to its standard deviation" if self.std_max > 0 else ""
        return (f"{self.n_poses} {verb} outside the validity range of the model{added}: {listed}{more}",)

    def refuse(self, data: Measurements) -> None:
        """Raise an error if a pose is outside.

        Raises:
            InputError: With the first pose and the ranges.
        """
        if self.n_poses:
            first = min(item.first_row for item in self.ranges)
            raise InputError(
                Problem(
                    self.warnings()[0],
                    data.source,
                    data.line(first),
                    fix="leave these poses out, fit the model to poses that include them, or drop `strict_range`",
                )
            )


def outside_validity(robot: Robot | None, data: Measurements) -> OutsideValidity | None:
    """Return the poses outside the validity ranges of a robot file's effects; None if no effect has a range."""
    if robot is None or not robot.effects or data.q is None:
        return None
    arm = Arm.of(robot)
    known = [item for item in known_effects(robot) if item.validity and any(item.values.values())]
    if not known:
        return None
    outside, position_var, items = np.zeros(data.n, dtype=bool), np.zeros(data.n), list[OutsideRange]()
    for effect in known:
        share = np.zeros(data.n)
        for driver, (low, high) in effect.validity.items():
            values = driver_values(arm, data, driver)
            if values is None:
                continue
            is_held, period, fading = effect.effect.beyond(arm, driver, (low, high))
            excess = range_excess(values, low, high, period)
            is_outside = excess > MARGIN * (high - low) + _ROUNDING
            if not is_outside.any():
                continue
            outside |= is_outside
            if is_held or fading is not None:
                share = np.maximum(share, is_outside * excess / max(high - low, _ROUNDING))
            items.append(
                OutsideRange(
                    effect=str(effect.effect),
                    driver=driver,
                    unit=driver_unit(arm, driver),
                    low=low,
                    high=high,
                    n_poses=int(np.count_nonzero(is_outside)),
                    excess=float(excess.max()),
                    first_row=int(np.argmax(is_outside)),
                    is_held=is_held,
                )
            )
        if share.any():
            # The effect is unknown there: its own size is reached at a tenth of the range, and grows in proportion from
            # a whole range on.
            growth = np.maximum(np.minimum(10.0 * share, 1.0), share)
            position_var += growth**2 * _mean_square_size(arm, effect, data)
    ranked = tuple(sorted(items, key=lambda item: (-item.n_poses, item.effect, item.driver)))
    std_max = float(np.sqrt(position_var.max(initial=0.0)))
    return OutsideValidity(int(np.count_nonzero(outside)), data.n, ranked, std_max)


def _mean_square_size(arm: Arm, known: Known, data: Measurements) -> float:
    """Return the mean square (m^2) of the displacement that an effect makes at these poses.

    It is held at its range, but does not fade: what it may be there is as large as it is within its range.
    """
    fading, _ = known.effect.limits(arm, known.validity, fading=True)
    validity = {driver: limits for driver, limits in known.validity.items() if driver not in fading}
    poses = data.subset(even_rows(data.n, _SIZED))
    models = Model(arm, (dataclasses.replace(known, validity=validity),)), Model(arm)
    with_effect, without = (model.bind(poses).poses(np.zeros(0)).translation for model in models)
    return float(np.mean(np.sum(np.square(with_effect - without), axis=0)))


def _sentence(item: OutsideRange) -> str:
    poses = "1 pose" if item.n_poses == 1 else f"{item.n_poses} poses"
    rule = "held at the end" if item.is_held else "extrapolated"
    return (
        f"{item.effect} {rule} by {item.driver}, {poses} up to {item.excess:.3g} {item.unit} beyond "
        f"[{item.low:.4g}, {item.high:.4g}]"
    )
