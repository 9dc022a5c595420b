"""The constants of the links: d, a, alpha and Hayati's beta, or a URDF's joint origins."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from robacc.effects.base import LEAST_OF_CONSTANT, About, Effect, Part, Term, Traits, register, setting
from robacc.effects.base_frame import FRAME_LABELS
from robacc.measurements import Measurements
from robacc.robots.arm import Arm
from robacc.robots.description import Joint

_DH = ("d", "a", "alpha", "beta")
_ORIGIN = ("x", "y", "z", "roll", "pitch", "yaw")


def geometry_labels(arm: Arm, joint: Joint) -> tuple[str, ...]:
    """Return the names of a joint's constants: its table row without the joint variable, or its URDF origin.

    A prismatic joint keeps theta as a constant, and its d is the joint's zero.
    """
    if arm.robot.convention == "urdf":
        return _ORIGIN
    return _DH if joint.type == "revolute" else ("theta", *(label for label in _DH if label != "d"))


@register
@dataclass(frozen=True)
class LinkGeometry(Effect):
    """Constant lengths and angles of the links: all of them, or those of ``labels``."""

    labels: tuple[str, ...] = setting((), choices=("theta", *_DH, *_ORIGIN))

    name = "link_geometry"
    traits = Traits(is_constant=True, shared_by=())
    about = About(
        summary="link lengths, offsets and twists differ from the table",
        equation="d_j, a_j, alpha_j + c, and beta_j (Hayati's rotation about y) + c; a URDF's joint origin "
        "x, y, z + c, then rotated about its own x, y, z by roll, pitch, yaw",
        unit="m, rad",
        usual_size="1e-4 to 1e-3 m, 1e-4 to 1e-3 rad",
        usual_range=(0.0001, 0.001),
        needs="nothing",
        confused_with="joint_offset, base_frame and tool_frame at the ends of the chain",
        source="Wu and Lee 1984, eq. (6), M2, M3, M4; Hayati 1983 for beta",
        example="{effect: link_geometry, joints: [j2], labels: [a, alpha], values: {j2.a: 2e-4, j2.alpha: 3e-4}}",
    )

    @classmethod
    def candidates(cls, arm: Arm, data: Measurements) -> Iterator[Effect]:
        """Yield one constant at a time, and a joint's whole row."""
        for joint in arm.names:
            yield from (cls((joint,), (label,)) for label in geometry_labels(arm, arm.joint(joint)))
            yield cls((joint,))

    def terms(self, arm: Arm, data: Measurements) -> tuple[Term, ...]:
        """Return the constants of each joint's row; the fit finds those that are not identifiable."""
        terms = []
        is_urdf = arm.robot.convention == "urdf"
        for joint in self.joints:
            for label in geometry_labels(arm, arm.joint(joint)):
                if self.labels and label not in self.labels:
                    continue
                motion = arm.motion(joint, FRAME_LABELS[label] if is_urdf else label)
                unit = arm.chain.motions[motion].unit
                name = f"{self.name}.{joint}.{label}"
                terms.append(Term(name, unit, 1e-3, (Part(motion),), least_part=LEAST_OF_CONSTANT))
        # Hayati's rotations last: a rotation is identifiable only if the table's own numbers cannot describe it.
        return tuple(sorted(terms, key=lambda term: term.label == "beta"))
