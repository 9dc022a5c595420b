"""What of a model holds for other poses: facts of its measuring campaign, and validity ranges of its effects.

Facts of a campaign are effects of time and of the instrument, and the registered frames. They are no property of the
robot. On the poses of the campaign they are part of the fitted prediction; other poses do not inherit them.
"""

import dataclasses
from collections.abc import Collection, Mapping, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np

from robacc.effects.drivers import MARGIN, driver_unit, driver_values, range_excess
from robacc.effects.specification import Known, known_effects
from robacc.errors import LISTED, Problem, UsageError, refuse
from robacc.geometry import Array, nearest_rotation, rms_length
from robacc.measurements import Measurements, even_rows
from robacc.modelling.model import Model, predict
from robacc.robots.arm import Arm
from robacc.robots.description import Campaign, Robot


def resolve_campaign(
    robot: Robot, data: Measurements | None, digests: Collection[str], use: Literal["auto", "keep", "drop"]
) -> tuple[Robot, tuple[str, ...]]:
    """Return the robot with the effects of its campaign if they apply, and a sentence about what was decided.

    ``drop`` also restores the frames before the campaign. ``auto`` keeps the frames, and keeps the effects if a digest
    is that of the campaign's poses, or if measured ``data`` agree better with them than without, base registered. Where
    they do not, a step stays unless the data contradict it: other poses are measured after the campaign more often than
    before its step, and their clock may start anew.
    """
    campaign = robot.campaign
    if campaign is None or use == "drop" or not campaign.effects:
        return robot if campaign is None or use != "drop" else _before(robot, campaign), ()
    with_effects = dataclasses.replace(
        robot,
        effects=(*robot.effects, *campaign.effects),
        campaign=campaign._replace(effects=(), kept=True),
    )
    names = ", ".join(str(effect.get("effect")) for effect in campaign.effects)
    if use == "keep" or set(digests) & set(campaign.poses):
        return with_effects, ()
    start = f"the model's campaign effects ({names}) were fitted to other poses"
    if data is None or data.q is None:
        return robot, (f"{start} and are left out; `campaign` keep applies them",)
    # A step without the settings that say when it happened.
    steps = [
        {key: value for key, value in effect.items() if key not in ("from_line", "from_time_s", "file")}
        | {"from_line": 1}
        for effect in campaign.effects
        if effect.get("effect") == "step"
    ]
    # The robot as the steps left it, without other effects of the campaign.
    stepped = dataclasses.replace(robot, effects=(*robot.effects, *steps))
    try:
        errors = [
            _registered_rms(predict(arm, data).translation, data.position)
            for arm in (robot, with_effects, *([stepped] if steps else []))
        ]
    except UsageError as error:
        return robot, (f"{start} and are left out: {error}",)
    # Equal but for rounding: a step of the base moves all poses.
    if steps and errors[2] <= (1.0 + 1e-6) * min(errors[:2]):
        return stepped, (
            f"{start}; these poses are taken as measured after the step, whatever their time; `campaign` keep applies "
            "the effects by time",
        )
    change = f"(base registered) from {errors[0] * 1e3:.3g} to {errors[1] * 1e3:.3g} mm"
    if errors[1] < errors[0]:
        return with_effects, (
            f"{start}; they are applied because they change the position error {change}; `campaign` drop leaves them "
            "out",
        )
    return robot, (f"{start} and are left out: they would change the position error {change}",)


def standing_campaign(robot: Robot, use: Literal["auto", "keep", "drop"]) -> tuple[Robot, tuple[str, ...]]:
    """Return the robot as it stands after its campaign, for commands to it, and a sentence on unused effects.

    ``auto`` applies effects that stay after the campaign (a step); ``keep`` all of them; ``drop`` none, and restores
    the frames before the campaign.

    Raises:
        UsageError: ``use`` is none of the three.
    """
    refuse((use not in ("auto", "keep", "drop"), f"`campaign`: expected auto, keep or drop, found {use!r}"))
    campaign = robot.campaign
    if campaign is None or use == "drop":
        return robot if campaign is None else _before(robot, campaign), ()
    known = known_effects(dataclasses.replace(robot, effects=campaign.effects))
    applied, names = [], []
    for entry, item in zip(campaign.effects, known, strict=True):
        if use == "keep" or item.effect.traits.extrapolates is not None:
            applied.append(entry)
        elif not item.effect.traits.is_of_measurement:
            names.append(str(item.effect))
    robot = dataclasses.replace(robot, effects=(*robot.effects, *applied))
    note = f"effects of the model's campaign are left out: {', '.join(names)}; `campaign` keep applies them"
    return robot, (note,) if names else ()


def with_campaign(robot: Robot, before: Robot, digests: Sequence[str]) -> Robot:
    """Return a fitted robot with the facts of its campaign in the campaign's part.

    Effects of time or of the instrument that the robot's own list did not have before the fit are facts of the
    campaign, and so are frames that the fit moved.

    Args:
        robot: The fitted robot.
        before: The robot before the fit.
        digests: SHA-256 of the pose files of the campaign.
    """
    earlier = before.campaign if before.campaign is not None else Campaign(())
    own_effects = {known.effect.key() for known in known_effects(before)} if not earlier.kept else set()
    effects: list[Mapping[str, Any]] = []
    facts: list[Mapping[str, Any]] = []
    arm = Arm.of(robot)
    for entry, known in zip(robot.effects, known_effects(robot), strict=True):
        effect, traits = known.effect, known.effect.traits
        # Of the time of a campaign, or of its instrument.
        of_campaign = traits.is_of_measurement or traits.is_event or "time_s" in effect.validity_drivers(arm)
        (facts if of_campaign and effect.key() not in own_effects else effects).append(entry)
    return dataclasses.replace(
        robot,
        effects=tuple(effects),
        campaign=Campaign(
            poses=tuple(dict.fromkeys((*(earlier.poses if earlier.kept else ()), *digests))),
            base=earlier.base or (before.base if robot.base != before.base else None),
            tool=earlier.tool or (before.tool if robot.tool != before.tool else None),
            targets=earlier.targets or (before.targets if robot.targets != before.targets else {}),
            effects=tuple(facts),
        ),
    )


def _before(robot: Robot, campaign: Campaign) -> Robot:
    """Return the robot without the facts of its campaign."""
    return dataclasses.replace(
        robot,
        base=campaign.base or robot.base,
        tool=campaign.tool or robot.tool,
        targets=campaign.targets or robot.targets,
        campaign=None,
    )


def _registered_rms(predicted: Array, measured: Array) -> float:
    """Return the rms distance (m) of measured from predicted positions ``(3, N)`` after the best rigid motion."""
    a = predicted - predicted.mean(axis=1, keepdims=True)
    b = measured - measured.mean(axis=1, keepdims=True)
    return rms_length(b - nearest_rotation(b @ a.T) @ a)


# Poses outside the validity ranges of the effects.

_ROUNDING = 1e-9
"""Excess (SI) that rounding explains."""


class OutsideValidity(NamedTuple):
    """Poses outside the validity ranges of a model."""

    n_poses: int
    """Poses outside at least one range."""
    n: int
    """All poses."""
    ranges: tuple[Mapping[str, Any], ...]
    """Ranges that some pose exceeds, by number of poses, with the keys of the result."""
    std_max: float
    """Largest standard deviation (m) of the position that held effects and profiles add outside their ranges."""
    first_row: int = 0
    """Index of the first pose outside."""

    def warnings(self) -> tuple[str, ...]:
        """Return one sentence with the drivers and how far the poses exceed their ranges; empty if all are inside."""
        listed = "; ".join(_sentence(item) for item in self.ranges[:LISTED])
        more = f"; and {len(self.ranges) - LISTED} more" if len(self.ranges) > LISTED else ""
        verb = "pose is" if self.n == 1 else f"of {self.n} poses are"
        added = f", which adds up to {self.std_max * 1e3:.2g} mm to its standard deviation" if self.std_max > 0 else ""
        text = f"{self.n_poses} {verb} outside the validity range of the model{added}: {listed}{more}"
        return (text,) if self.n_poses else ()

    def refuse(self, data: Measurements) -> None:
        """Raise an error if a pose is outside.

        Raises:
            InputError: With the first pose and the ranges.
        """
        fix = "leave these poses out, fit the model to poses that include them, or drop `strict_range`"
        refuse(*((True, Problem(text, data.source, data.line(self.first_row), fix=fix)) for text in self.warnings()))


def outside_validity(robot: Robot | None, data: Measurements) -> OutsideValidity | None:
    """Return the poses outside the validity ranges of a robot file's effects; None if no effect has a range."""
    known = () if robot is None or data.q is None else known_effects(robot)
    known = tuple(item for item in known if item.validity and any(item.values.values()))
    if robot is None or not known:
        return None
    arm = Arm.of(robot)
    outside, position_var, items = np.zeros(data.n, dtype=bool), np.zeros(data.n), list[dict[str, Any]]()
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
                {
                    "effect": str(effect.effect),
                    "driver": driver,
                    "unit": driver_unit(arm, driver),
                    "low": low,
                    "high": high,
                    "n_poses": int(np.count_nonzero(is_outside)),
                    "largest_excess": float(excess.max()),
                    "rule": "held" if is_held else "extrapolated",
                }
            )
        if share.any():
            # The effect is unknown there: its own size is reached at a tenth of the range, and grows in proportion from
            # a whole range on.
            growth = np.maximum(np.minimum(10.0 * share, 1.0), share)
            position_var += growth**2 * _mean_square_size(arm, effect, data)
    ranked = tuple(sorted(items, key=lambda item: (-item["n_poses"], item["effect"], item["driver"])))
    std_max = float(np.sqrt(position_var.max(initial=0.0)))
    return OutsideValidity(int(np.count_nonzero(outside)), data.n, ranked, std_max, int(np.argmax(outside)))


def _mean_square_size(arm: Arm, known: Known, data: Measurements) -> float:
    """Return the mean square (m^2) of the displacement that an effect makes at these poses.

    It is held at its range, but does not fade: what it may be there is as large as it is within its range.
    """
    fading, _ = known.effect.limits(arm, known.validity, fading=True)
    validity = {driver: limits for driver, limits in known.validity.items() if driver not in fading}
    poses = data.subset(even_rows(data.n, 200))
    models = Model(arm, (dataclasses.replace(known, validity=validity),)), Model(arm)
    with_effect, without = (model.bind(poses).poses(np.zeros(0)).translation for model in models)
    return float(np.mean(np.sum(np.square(with_effect - without), axis=0)))


def _sentence(item: Mapping[str, Any]) -> str:
    poses = "1 pose" if item["n_poses"] == 1 else f"{item['n_poses']} poses"
    rule = "held at the end" if item["rule"] == "held" else "extrapolated"
    most = f"up to {item['largest_excess']:.3g} {item['unit']} beyond [{item['low']:.4g}, {item['high']:.4g}]"
    return f"{item['effect']} {rule} by {item['driver']}, {poses} {most}"
