"""Check a URDF, which is in m and rad, for sizes that only make sense in mm or degrees."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from xml.etree.ElementTree import Element

from robacc.robots.description import LENGTH_PARAMETERS, Joint
from robacc.robots.urdf_xml import UrdfDocument
from robacc.robots.yaml_units import MAX_LENGTH, TRAVEL_IN_MM, TURN, limits_likely_degrees

_LENGTH_FIX = "a URDF's lengths are in m"
_ANGLE_FIX = "a URDF's angles are in rad"


def check_sizes(document: UrdfDocument, elements: Mapping[str, Element], joints: Sequence[Joint]) -> None:
    """Report lengths and angles that are too large for an arm.

    Args:
        document: The URDF, which collects the problems.
        elements: Each joint's element, by its name.
        joints: Joints of the chain.
    """
    for joint in joints:
        element = elements[joint.name]
        for name, value in joint.parameters.items():
            if name in LENGTH_PARAMETERS and abs(value) > MAX_LENGTH:
                document.report(element, joint.name, f"{name} of {value:g} m is too long for an arm", _LENGTH_FIX)
            elif name not in LENGTH_PARAMETERS and abs(value) > TURN:
                document.report(element, joint.name, f"{name} of {value:g} rad is more than a turn", _ANGLE_FIX)
        if joint.com is not None and max(map(abs, joint.com)) > MAX_LENGTH:
            message = f"the centre of mass of its link is {max(map(abs, joint.com)):g} m away, too far for an arm"
            document.report(element, joint.name, message, _LENGTH_FIX)
        if joint.type == "prismatic" and joint.limits is not None:
            longest = max(map(abs, joint.limits))
            if TRAVEL_IN_MM[0] < longest < TRAVEL_IN_MM[1]:
                document.report(element, joint.name, f"a travel of {longest:g} m is too long for an arm", _LENGTH_FIX)
    if limits_likely_degrees(joints):
        document.report(None, "", "the limits of every joint are more than two turns", _ANGLE_FIX)
