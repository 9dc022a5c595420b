"""Effects as texts and entries: requests such as ``gear_ratio[all]``, the baseline, the catalogue, and robot files.

Of effects with values: entries of a robot file, validity ranges, and constants written into the robot's numbers.
"""

import dataclasses
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from robacc.effects.base import RADIUS, Effect, Part, Term, effect_class, load_plug_ins
from robacc.effects.drivers import (
    Validity,
    clip_drivers,
    driver_values,
    is_number,
    nearest_image,
    range_excess,
    read_validity,
)
from robacc.errors import Problem, UsageError, given, listing, refuse
from robacc.geometry import Array, Poses, rotation_about
from robacc.measurements import IMAGES, Measurements, different
from robacc.robots.arm import BASE, TOOL, TURN_OF_ANGLE, TURNS, Arm
from robacc.robots.description import Frame, Robot, effect_key

_MAX_NAMES = 12
"""Coefficients that a message lists."""


@dataclass(frozen=True)
class Known:
    """An effect with the values of its coefficients, by full name, SI."""

    effect: Effect
    values: Mapping[str, float]
    validity: Validity = field(default_factory=dict)
    """Range of each driver over the poses that the values were fitted to; empty if unknown."""


def known_effects(robot: Robot) -> tuple[Known, ...]:
    """Return the effects that a robot file lists, in SI.

    An entry is ``{effect: backlash, joints: [j2], values: {j2: 1e-4}, …settings}``; a value's key is its name without
    the effect's, or ``value`` for an effect of a single coefficient. Values are in the file's units: a leading rad or m
    of the coefficient's unit is the file's unit of angle or length; what it is divided by is SI.

    Raises:
        InputError: an entry cannot be read, or has a value of a coefficient that does not exist, which would otherwise
            silently do nothing; every problem at once.
    """
    if not robot.effects:
        return ()
    arm = Arm.of(robot)
    known: list[Known] = []
    problems: list[Problem] = []
    first: dict[tuple[Any, ...], str] = {}
    for i, entry in enumerate(robot.effects):
        key = effect_key(i)
        try:
            known.append(_read(arm, entry))
        except (ValueError, TypeError, UsageError) as error:
            problems.append(Problem(str(error), column=key))
            continue
        if (earlier := first.setdefault(known[-1].effect.key(), key)) != key:
            message = f"repeats {known[-1].effect} of {earlier}; their values would add up"
            problems.append(Problem(message, column=key, fix="give one entry with the sum of the values"))
    refuse((problems, problems))
    return tuple(known)


def coefficients(robot: Robot) -> tuple[tuple[str, float, str], ...]:
    """Return name, value and unit of each coefficient that a robot file's effects give a value for; SI.

    Raises:
        InputError: see :func:`known_effects`.
    """
    arm = Arm.of(robot)
    return tuple(
        (term.name, known.values[term.name], term.unit)
        for known in known_effects(robot)
        for term in known.effect.terms(arm, every_column(arm))
        if term.name in known.values
    )


def _read(arm: Arm, entry: Mapping[str, Any]) -> Known:
    is_entry = isinstance(entry, Mapping) and isinstance(entry.get("effect"), str)
    refuse((not is_entry, f"expected a mapping with the key effect, found {entry!r}"))
    cls = effect_class(entry["effect"])
    settings = {key: value for key, value in entry.items() if key not in ("effect", "joints", "values", "validity")}
    effect = cls.from_settings(_joints(cls, arm, entry.get("joints", [])), settings)
    effect = effect.from_units(arm, *arm.robot.effect_units)
    terms = {term.name: term for term in effect.terms(arm, every_column(arm))}
    entry_values: Any = entry.get("values")
    refuse(
        ("values" not in entry, f"{effect} has no values, so it would do nothing; write values: {{name: number}}"),
        (
            not isinstance(entry_values, Mapping),
            f"values must be a mapping of name to number, found {entry_values!r}",
        ),
    )
    values = {}
    for key, value in entry_values.items():
        name = cls.name if key == "value" else f"{cls.name}.{key}"
        if name not in terms:
            names = [_short_name(effect, term) for term in terms]
            raise ValueError(f"{effect} has no coefficient {key!r}; it has {listing(names, _MAX_NAMES)}")
        refuse((not is_number(value), f"values.{key} must be a finite number, found {value!r}"))
        values[name] = value * _unit_size(terms[name].unit, *arm.robot.effect_units)
        is_turn = terms[name].unit == "rad" and abs(values[name]) > 2 * math.pi
        refuse((is_turn, f"values.{key} is more than a turn; expected a small angle, found {value:g}"))
    if "validity" not in entry:
        return Known(effect, values, effect.validity(arm, Measurements(position=np.zeros((3, 0)))))
    ranges = read_validity(arm, effect.validity_drivers(arm), entry["validity"], *arm.robot.effect_units)
    return Known(effect, values, ranges)


def _joints(cls: type[Effect], arm: Arm, joints: Any) -> tuple[str, ...]:
    """Return the entry's joints, checked."""
    if not cls.traits.per_joint:
        refuse((joints, f"{cls.name} acts on no joint in particular; leave joints out"))
        return ()
    are_names = isinstance(joints, list | tuple) and all(joint in arm.names for joint in joints)
    refuse((not are_names, f"joints must be a list of {', '.join(arm.names)}; found {joints!r}"))
    possible = cls.possible_joints(arm)
    if not joints and cls.traits.joints_optional:
        return ()
    some = f"some of {', '.join(possible)}; found {list(joints)!r}"
    refuse((not joints or len(set(joints)) < len(joints), f"{cls.name} needs joints, each once: {some}"))
    return cls.checked_joints(arm, joints)


def every_column(arm: Arm) -> Measurements:
    """Return two poses with every column, each varying: an effect that is still missing lacks a part of the robot.

    Names and units of coefficients do not depend on the poses, so these poses give them too.
    """
    varying = np.array([0.0, 1.0])
    joints = np.tile(varying, (len(arm.names), 1))
    return Measurements(
        position=np.zeros((3, 2)),
        q=joints,
        target=np.repeat(list(arm.robot.targets)[:1], 2) if arm.robot.targets else None,
        time=varying,
        temperature=varying,
        payload=varying,
        direction=2 * joints - 1,
        speed=joints,
        read_back=joints + 1e-3 * varying,
    )


def _unit_size(unit: str, length: float, angle: float) -> float:
    """Return the size of a value of an SI unit in a file with units of ``length`` m and ``angle`` rad."""
    return {"rad": angle, "m": length}.get(unit.split("/")[0].split()[0], 1.0)


def _short_name(effect: Effect, name: str) -> str:
    """Return the key of a coefficient in a robot file's ``values``: its name without the effect's."""
    return "value" if name == effect.name else name.removeprefix(f"{effect.name}.")


def entry_of(effect: Effect, values: Mapping[str, float], validity: Validity | None = None) -> dict[str, Any]:
    """Return the entry of a robot file for an effect with values, and the ranges of its drivers if they are known."""
    joints = {"joints": list(effect.joints)} if effect.joints else {}
    short = {_short_name(effect, name): value for name, value in values.items()}
    ranges = {"validity": {name: list(pair) for name, pair in validity.items()}} if validity else {}
    return {"effect": effect.name, **joints, **effect.settings(), "values": short, **ranges}


# Entries of a robot file's effects in other units of length and angle.


def with_effect_units(robot: Robot, length: float = 1.0, angle: float = 1.0) -> Robot:
    """Return the robot with the entries of its effects in units of ``length`` m and ``angle`` rad.

    Raises:
        InputError: Its effects cannot be read.
    """
    campaign = robot.campaign
    if robot.effect_units == (length, angle):
        return robot

    def converted(effects: Sequence[Mapping[str, Any]]) -> tuple[Mapping[str, Any], ...]:
        stated = known_effects(dataclasses.replace(robot, effects=tuple(effects)))
        return tuple(_entry(Arm.of(robot), entry, length, angle) for entry in stated)

    if campaign is not None:
        campaign = campaign._replace(effects=converted(campaign.effects))
    return dataclasses.replace(robot, effects=converted(robot.effects), effect_units=(length, angle), campaign=campaign)


def _entry(arm: Arm, stated: Known, length: float, angle: float) -> dict[str, Any]:
    """Return the entry of an effect, whose values are in SI, in units of ``length`` m and ``angle`` rad."""
    units = {term.name: term.unit for term in stated.effect.terms(arm, every_column(arm))}
    units |= {name: arm.unit(name) for name in arm.names}
    sizes = {name: _unit_size(unit, length, angle) for name, unit in units.items()}
    values = {name: value / sizes[name] for name, value in stated.values.items()}
    validity = {
        name: (low / sizes.get(name, 1.0), high / sizes.get(name, 1.0)) for name, (low, high) in stated.validity.items()
    }
    return entry_of(stated.effect.from_units(arm, 1 / length, 1 / angle), values, validity)


_POINTS = 32
"""Places at which the level is sampled."""


def held_at_ends(effect: Effect, arm: Arm, data: Measurements, validity: Validity) -> Measurements:
    """Return the poses with the drivers that ``effect`` does not extrapolate held at the ends of their ranges."""
    return clip_drivers(arm, data, *effect.limits(arm, validity))


def faded(effect: Effect, arm: Arm, data: Measurements, validity: Validity) -> tuple[Term, ...]:
    """Return the terms of an effect, less and less of them the farther a fading joint is beyond its range.

    What remains is the effect's level at that end of the range, its mean there over 4 fading lengths, for a profile one
    period of its finest order: beyond the range, slow waves of a profile are still as they were, and fine ones are
    unknown. On parts of a real arm's poses, half and twice as many lengths predict as well.
    """
    effect = effect.within(validity)
    terms = effect.terms(arm, data)
    for joint, (low, high) in effect.limits(arm, validity, fading=True)[0].items():
        values = driver_values(arm, data, joint)
        _, period, length = effect.beyond(arm, joint, (low, high))
        if values is None or length is None or not np.any(excess := range_excess(values, low, high, period)):
            continue
        share = np.exp(-0.5 * np.square(excess / length))
        # Across the gap of a joint that turns on, the level passes from one end to the other.
        of_other = excess / (math.inf if period is None else max(period - (high - low), 1e-12))
        of_low = np.where(nearest_image(values, low, high, period) < low, 1.0 - of_other, of_other)
        near_ends = effect.terms(arm, _near_ends(arm, joint, data, low, high, 4.0 * length))
        terms = tuple(
            term._replace(
                parts=tuple(
                    _left(part, near, share, of_low) if part.motion == arm.axis_motion(joint) else part
                    for part, near in zip(term.parts, near_end.parts, strict=True)
                ),
            )
            for term, near_end in zip(terms, near_ends, strict=True)
        )
    return terms


def _left(part: Part, near: Part, share: Array, of_low: Array) -> Part:
    """Return a part of which a ``share`` ``(N,)`` is left beyond the range; the rest is its level there.

    Args:
        part: The part at the poses.
        near: The same part near both ends of the range.
        share: Share of the effect that is left; 1 within the range.
        of_low: Share of the lower end in the level; the rest is that of the upper end.
    """
    at_low, at_high = np.broadcast_to(near.factor, (2 * _POINTS,)).reshape(2, _POINTS).mean(axis=1)
    level = of_low * at_low + (1.0 - of_low) * at_high
    return part._replace(factor=share * part.factor + (1.0 - share) * level)


def _near_ends(arm: Arm, joint: str, data: Measurements, low: float, high: float, depth: float) -> Measurements:
    """Return the first pose with a joint at :data:`_POINTS` places near the lower end of its range, then the upper."""
    inside = min(depth, 0.5 * (high - low)) * (np.arange(_POINTS) + 0.5) / _POINTS
    rows = data.subset(np.zeros(2 * _POINTS, dtype=np.int64))
    assert rows.q is not None
    q = rows.q.copy()
    q[arm.number(joint)] = np.concatenate((low + inside, high - inside))
    return dataclasses.replace(rows, q=q)


_COORDINATES = ("x", "y", "z", *TURN_OF_ANGLE)


def absorbed(robot: Robot, effects: Sequence[Effect], values: Mapping[str, float]) -> Robot:
    """Return the robot with fitted values of constant effects written into its own numbers.

    A value of the chain's motion adds to the joint's parameter of that name; those of a frame move and turn it.
    """
    arm = Arm.of(robot)
    joints, targets, fixtures = list(robot.joints), dict(robot.targets), dict(robot.fixtures)
    moved: dict[tuple[int, str], dict[str, float]] = {}
    for term in (term for effect in effects for term in effect.terms(arm, every_column(arm))):
        number, name = term.parts[0].motion, term.name.removesuffix(f".{term.label}").partition(".")[2]
        motion = arm.chain.motions[number]
        owner, label = (BASE, term.label) if number == RADIUS else (motion.owner, motion.label)
        moved.setdefault((owner, name), {})[label] = values.get(term.name, 0.0)
    for (owner, name), changes in moved.items():
        if owner == BASE and name:
            base, radius = _moved_frame(fixtures[name].base, changes), changes.get("radius", 0.0)
            fixtures[name] = fixtures[name]._replace(base=base, radius=fixtures[name].radius + radius)
            if len(fixtures) == 1 and fixtures[name].kind in IMAGES:
                # The board, or the camera beside the arm, is the measuring frame of a model fitted to photos.
                robot = dataclasses.replace(robot, base=fixtures[name].base)
        elif owner == BASE:
            robot = dataclasses.replace(robot, base=_moved_frame(robot.base, changes))
        elif owner == TOOL and targets:
            targets[name] = _moved_frame(targets[name], changes)
        elif owner == TOOL:
            robot = dataclasses.replace(robot, tool=_moved_frame(robot.tool, changes))
        else:
            parameters = dict(joints[owner].parameters)
            if not changes.keys().isdisjoint(("x", "y", "z", *TURNS)):
                x, y, z, roll, pitch, yaw = (parameters[label] for label in _COORDINATES)
                frame = _moved_frame(Frame((x, y, z), (roll, pitch, yaw)), changes)
                parameters |= zip(_COORDINATES, (*frame.xyz, *frame.rpy), strict=True)
            else:
                parameters |= {label: parameters.get(label, 0.0) + change for label, change in changes.items()}
            joints[owner] = dataclasses.replace(joints[owner], parameters=parameters)
    return dataclasses.replace(robot, joints=tuple(joints), targets=targets, fixtures=fixtures)


def _moved_frame(frame: Frame, changes: Mapping[str, float]) -> Frame:
    """Return the frame with its motions changed: the product of the chain's motions; unturned, its angles stay."""
    x, y, z = (value + changes.get(label, 0.0) for value, label in zip(frame.xyz, "xyz", strict=True))
    turns = [changes.get(label, 0.0) for label in TURNS]
    if not any(turns):
        return Frame((x, y, z), frame.rpy)
    rotation = frame.pose.rotation
    for axis, turn in enumerate(turns):
        rotation = rotation @ rotation_about(axis, turn)
    return Frame.of(Poses(rotation, np.array((x, y, z))))


# Requests, the baseline where none are declared, and the catalogue.


_ITEM = r"\s*([^,\[\]]+?)\s*(?:\[([^\[\]]*)\])?\s*(?:,|$)"


class Request(NamedTuple):
    """One requested effect, and the joints it may act on."""

    name: str
    joints: tuple[str, ...] | None
    """None for the default; ``("all",)`` for every joint it can act on."""

    def __str__(self) -> str:
        """Return the request as it is written."""
        return self.name if self.joints is None else f"{self.name}[{','.join(self.joints)}]"


def parse_requests(text: str) -> tuple[Request, ...]:
    """Parse names separated by commas, each with optional joints in brackets.

    Raises:
        UsageError: the text is not that, or a name is not in the catalogue.
    """
    from robacc.effects import REGISTRY

    requests = []
    while text:
        unreadable = f"cannot read {text!r}; write effects like base_frame,joint_offset[j2,j3]"
        match = given(re.match(_ITEM, text), unreadable)
        name, inside = match.groups()
        effect_class(name)
        joints = None if inside is None else tuple(part.strip() for part in inside.split(",") if part.strip())
        refuse((joints == (), f"{name}[] names no joint; leave the brackets out, or write {name}[all]"))
        requests.append(Request(name, joints))
        text = text[match.end() :]
    return tuple(sorted(dict.fromkeys(requests), key=lambda request: list(REGISTRY).index(request.name)))


def build(requests: Sequence[Request], arm: Arm, data: Measurements) -> tuple[Effect, ...]:
    """Return the effects, each in its default form.

    Raises:
        UsageError: a joint does not exist, the effect cannot act on it, or the data lack what it needs.
    """
    effects = []
    for request in requests:
        cls, joints = effect_class(request.name), request.joints
        why = cls.missing(arm, data)
        refuse(
            (why, f"{request.name} cannot be fitted: {why}"),
            (
                joints is not None and not cls.traits.per_joint,
                f"{request.name} acts on no joint in particular; write it without brackets",
            ),
        )
        joints = cls.possible_joints(arm) if joints == ("all",) else joints
        for joint in joints or ():
            arm.number(joint)
        effects.append(cls.default(arm, data, None if joints is None else cls.checked_joints(arm, joints)))
    return tuple(effects)


# Effects of the baseline where none are declared: those by which every arm deviates, as far as the poses support them.
#
# A complete model of the constants has 4 coefficients for each revolute joint, 2 for each prismatic joint, and 6 for
# the target, of which 3 for a target measured by position only (L. J. Everett, M. Driels, B. W. Mooring, "Kinematic
# modelling for robot calibration", ICRA 1987).

FRAMES = ("base_frame", "tool_frame")
CONSTANTS = ("joint_offset", "link_geometry")
"""Effects of every arm other than its frames, in the order in which the poses have to support them."""
_COORDINATES_PER_COEFFICIENT = 1.5
"""Fewest measured coordinates of poses in different places for each coefficient: 1.2 where a fifth is held out.

Coefficients that the poses show weakly are shrunk to the nominal model, so they do less harm than geometry that the
baseline lacks. On 37 simulated arms with 8 to 30 poses, 1.5 to 3 coordinates for each coefficient, the error of other
poses was 0.01 to 1.3 times (median 0.4) that without geometry.
"""


class Baseline(NamedTuple):
    """Declared effects of a trace."""

    names: tuple[str, ...]
    """Requests, such as ``joint_offset`` or ``joint_offset[j2]``."""
    by_default: bool
    """The call declared nothing; robacc chose the effects."""
    left_out: tuple[tuple[str, str], ...] = ()
    """Effects that the default has and these poses do not support, with the reason."""


def default_baseline(arm: Arm, data: Measurements, n_places: int) -> Baseline:
    """Return the effects of every arm that poses in ``n_places`` different places support."""
    per_pose = 3 if data.rotation is None else 6
    # A second target adds the two turns across the line to it, a third the turn about that line, a fourth nothing.
    seen = different(data.points(data.groups())) / different(data.groups())
    coordinates = math.floor(n_places * min(per_pose + 2 * (seen - 1), 6))
    revolute = sum(map(arm.is_revolute, arm.names))
    # Identifiable coefficients of the baseline up to each effect, without those of the targets.
    zeros, links = 6 + len(arm.names), 4 * revolute + 2 * (len(arm.names) - revolute)
    reasons = {name: effect_class(name).missing(arm, data) for name in (*FRAMES, *CONSTANTS)}
    for name, own in zip(CONSTANTS, (zeros, links), strict=True):
        coefficients = own + per_pose * max(len(arm.robot.targets), 1)
        least = math.ceil(_COORDINATES_PER_COEFFICIENT * coefficients)
        few = (
            f"poses in {n_places} places give {coordinates} coordinates, but the {coefficients} "
            f"coefficients of the baseline with it need {least}"
        )
        reasons[name] = reasons[name] or (few if coordinates < least else None)
    names = tuple(name for name, why in reasons.items() if why is None)
    return Baseline(names, True, tuple((name, why) for name, why in reasons.items() if why is not None))


def catalogue(
    name: str | None = None, robot: Robot | None = None, data: Measurements | None = None
) -> list[dict[str, Any]]:
    """Return every effect, or the effect called ``name``, with the keys of the result.

    With a ``robot``, and its poses if given, it says what of the effect is available for it.

    Raises:
        UsageError: there is no such effect.
    """
    from robacc.effects import REGISTRY

    load_plug_ins()
    arm = None if robot is None else Arm.of(robot)
    entries = []
    for cls in REGISTRY.values() if name is None else (effect_class(name),):
        own = {"per_joint": cls.traits.per_joint, "is_constant": cls.traits.is_constant}
        entries.append({"name": cls.name, **cls.about._asdict(), **own})
        if arm is not None:
            # Without poses, every column is assumed to be present.
            poses = every_column(arm) if data is None else data
            joints, why = cls.possible_joints(arm), cls.missing(arm, poses)
            if why is None and cls.traits.per_joint and not joints:
                why = "no joint that it can act on"
            terms = cls.default(arm, poses).terms(arm, poses) if why is None else ()
            names = [{"name": term.name, "unit": term.unit} for term in terms]
            available = {"offered": why is None, "why": why, "joints": () if why else joints, "coefficients": names}
            entries[-1] |= available
    return entries
