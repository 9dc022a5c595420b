"""The constants of the links: d, a, alpha and Hayati's beta, or a URDF's joint origins."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from robacc.effects.base import About, Effect, Part, Term, register
from robacc.effects.joint_offset import with_parameters
from robacc.measurements import Measurements
from robacc.robots.arm import Arm
from robacc.robots.description import Joint, Robot

_DH = ("d", "a", "alpha", "beta")
_ORIGIN = ("x", "y", "z", "roll", "pitch", "yaw")


def geometry_labels(arm: Arm, joint: Joint) -> tuple[str, ...]:
    """Names of a joint's constants: its table row without the joint variable, or its URDF origin.

    A prismatic joint keeps theta as a constant, and its d is the joint's zero.
    """
    if arm.robot.convention == "urdf":
        return _ORIGIN
    return _DH if joint.type == "revolute" else ("theta", *(label for label in _DH if label != "d"))


@register
@dataclass(frozen=True)
class LinkGeometry(Effect):
    """Every constant length and angle of the links."""

    name = "link_geometry"
    is_constant = True
    about = About(
        summary="link lengths, offsets and twists differ from the table",
        equation="d_j, a_j, alpha_j + c, and beta_j (Hayati's turn about y) + c; a URDF's joint origin + c",
        unit="m, rad",
        usual_size="1e-4 to 1e-3 m, 1e-4 to 1e-3 rad",
        needs="nothing",
        confused_with="joint_offset, base_frame and tool_frame at the ends of the chain",
        source="Wu and Lee 1984, eq. (6), M2, M3, M4; Hayati 1983 for beta",
    )

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """The constants of each joint's row; what the poses cannot tell apart is found by the fit."""
        terms = []
        for joint in self.joints:
            for label in geometry_labels(arm, arm.joint(joint)):
                motion = arm.motion(joint, label)
                unit = arm.chain.motions[motion].unit
                terms.append(Term(f"{self.name}.{joint}.{label}", unit, 1e-3, (Part(motion),)))
        return tuple(terms)

    def apply(self, arm: Arm, values: Mapping[str, float]) -> Robot:
        """The robot with its table changed."""
        changes = {}
        for joint in self.joints:
            for label in geometry_labels(arm, arm.joint(joint)):
                changes[arm.owners[arm.number(joint)], label] = values.get(f"{self.name}.{joint}.{label}", 0.0)
        return with_parameters(arm, changes)
