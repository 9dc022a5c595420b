"""Catalogue of effects for a robot and its poses, requests such as ``base_frame,gear_ratio[all]``, and the baseline."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

from robacc.effects.base import REGISTRY, Effect, effect_class, load_plug_ins
from robacc.effects.specification import every_column
from robacc.errors import given, refuse
from robacc.measurements import Measurements
from robacc.robots.arm import Arm
from robacc.robots.description import Robot

_ITEM = re.compile(r"\s*([^,\[\]]+?)\s*(?:\[([^\[\]]*)\])?\s*(?:,|$)")


@dataclass(frozen=True, slots=True)
class Request:
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
    requests, position = [], 0
    while position < len(text):
        unread = f"cannot read {text[position:]!r}; write effects like base_frame,joint_offset[j2,j3]"
        name, inside = (match := given(_ITEM.match(text, position), unread)).groups()
        effect_class(name)
        joints = None
        if inside is not None:
            joints = tuple(part.strip() for part in inside.split(",") if part.strip())
            refuse((not joints, f"{name}[] names no joint; leave the brackets out, or write {name}[all]"))
        requests.append(Request(name, joints))
        position = match.end()
    unique = {(request.name, request.joints): request for request in requests}
    return tuple(sorted(unique.values(), key=lambda request: list(REGISTRY).index(request.name)))


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
            (why is not None, f"{request.name} cannot be fitted: {why}"),
            (
                joints is not None and not cls.traits.per_joint,
                f"{request.name} acts on no joint in particular; write it without brackets",
            ),
        )
        joints = cls.possible_joints(arm) if joints == ("all",) else joints
        for joint in joints or ():
            arm.number(joint)
            cls.check_joint(arm, joint)
        effects.append(cls.default(arm, data, joints))
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


@dataclass(frozen=True, slots=True)
class Baseline:
    """Declared effects of a trace."""

    names: tuple[str, ...]
    """Requests, such as ``joint_offset`` or ``joint_offset[j2]``."""
    by_default: bool
    """The call declared nothing; robacc chose the effects."""
    left_out: tuple[tuple[str, str], ...] = ()
    """Effects that the default has and these poses do not support, with the reason."""


def default_baseline(arm: Arm, data: Measurements, n_places: int) -> Baseline:
    """Return the effects of every arm that poses in ``n_places`` different places support."""
    reasons: dict[str, str | None] = {}
    per_pose = 3 if data.rotation is None else 6
    revolute = sum(map(arm.is_revolute, arm.names))
    # Identifiable coefficients of the baseline up to each effect.
    zeros, links = 6 + len(arm.names), 4 * revolute + 2 * (len(arm.names) - revolute)
    for name, coefficients in zip((*FRAMES, *CONSTANTS), (0, 0, zeros, links), strict=True):
        why = effect_class(name).missing(arm, data)
        if coefficients:
            coefficients += per_pose * max(len(arm.robot.targets), 1)
            least = math.ceil(_COORDINATES_PER_COEFFICIENT * coefficients)
            if why is None and n_places * per_pose < least:
                why = (
                    f"poses in {n_places} places give {n_places * per_pose} coordinates, but the {coefficients} "
                    f"coefficients of the baseline with it need {least}"
                )
        reasons[name] = why
    names = tuple(name for name, why in reasons.items() if why is None)
    return Baseline(names, True, tuple((name, why) for name, why in reasons.items() if why is not None))


@dataclass(frozen=True, slots=True)
class CatalogueEntry:
    """One effect of the catalogue."""

    effect: type[Effect]
    for_robot: bool
    """True if it was compared with a robot, which the following are of."""
    why: str | None = None
    """Reason if it is not available; None if it is."""
    joints: tuple[str, ...] = ()
    """Joints that it can act on."""
    coefficients: tuple[tuple[str, str], ...] = ()
    """Name and unit of each coefficient of the effect in its default form."""


def catalogue(
    name: str | None = None, robot: Robot | None = None, data: Measurements | None = None
) -> tuple[CatalogueEntry, ...]:
    """Return every effect, or the effect called ``name``, with its availability for ``robot`` and its poses if given.

    Raises:
        UsageError: there is no such effect.
    """
    load_plug_ins()
    classes = tuple(REGISTRY.values()) if name is None else (effect_class(name),)
    if robot is None:
        return tuple(CatalogueEntry(cls, False) for cls in classes)
    arm = Arm.of(robot)
    # Without poses, every column is assumed to be present.
    poses = every_column(arm) if data is None else data
    entries = []
    for cls in classes:
        joints, why = cls.possible_joints(arm), cls.missing(arm, poses)
        if why is None and cls.traits.per_joint and not joints:
            why = "no joint that it can act on"
        terms = cls.default(arm, poses).terms(arm, poses) if why is None else ()
        names = tuple((term.name, term.unit) for term in terms)
        entries.append(CatalogueEntry(cls, True, why, () if why else joints, names))
    return tuple(entries)
