"""Parser of requested effects: ``base_frame,joint_offset[j2,j3],gear_ratio[all]``."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from robacc.effects.base import REGISTRY, Effect, effect_class
from robacc.errors import UsageError
from robacc.measurements import Measurements
from robacc.robots.arm import Arm

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
        match = _ITEM.match(text, position)
        if match is None:
            raise UsageError(f"cannot read {text[position:]!r}; write effects like base_frame,joint_offset[j2,j3]")
        name, inside = match.groups()
        effect_class(name)
        joints = None
        if inside is not None:
            joints = tuple(part.strip() for part in inside.split(",") if part.strip())
            if not joints:
                raise UsageError(f"{name}[] names no joint; leave the brackets out, or write {name}[all]")
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
        cls = effect_class(request.name)
        why = cls.missing(arm, data)
        if why is not None:
            raise UsageError(f"{request.name} cannot be fitted: {why}")
        joints = request.joints
        if joints == ("all",):
            joints = cls.possible_joints(arm)
        if joints is not None and not cls.per_joint:
            raise UsageError(f"{request.name} acts on no joint in particular; write it without brackets")
        for joint in joints or ():
            arm.number(joint)
            if joint not in cls.possible_joints(arm):
                possible = ", ".join(cls.possible_joints(arm))
                raise UsageError(f"{request.name} cannot act on {joint}; it can on {possible}")
        effects.append(cls.default(arm, data, joints))
    return tuple(effects)
