"""Links and joints of a URDF, with the format's defaults."""

from __future__ import annotations

from dataclasses import dataclass
from xml.etree.ElementTree import Element

from robacc.robots.description import ZERO, Mimic, Vector


@dataclass(frozen=True, slots=True)
class UrdfJoint:
    """A joint of the file."""

    name: str
    type: str
    parent: str
    """Name of its parent link."""
    child: str
    axis: Vector
    limits: tuple[float | None, float | None] | None
    """Lower and upper limit; None without the element."""
    mimic: Mimic | None


@dataclass(frozen=True, slots=True)
class UrdfLink:
    """A link of the file."""

    name: str
    mass: float | None
    com: Vector


def joint_of(element: Element) -> UrdfJoint:
    """Return the joint of an element whose names and numbers were checked."""
    axis, limit, mimic = element.find("axis"), element.find("limit"), element.find("mimic")
    return UrdfJoint(
        element.get("name", ""),
        element.get("type", ""),
        _link_name(element, "parent"),
        _link_name(element, "child"),
        _vector(axis, "1 0 0"),
        None if limit is None else (_number(limit, "lower"), _number(limit, "upper")),
        None if mimic is None else _mimic(mimic),
    )


def link_of(element: Element) -> UrdfLink:
    """Return the link of an element whose names and numbers were checked."""
    inertial = element.find("inertial")
    mass = None if inertial is None else inertial.find("mass")
    origin = None if inertial is None else inertial.find("origin")
    return UrdfLink(
        element.get("name", ""),
        None if mass is None else _number(mass, "value") or 0.0,
        ZERO if origin is None else _vector(origin, "0 0 0"),
    )


def _link_name(element: Element, role: str) -> str:
    part = element.find(role)
    return "" if part is None else part.get("link", "")


def _vector(element: Element | None, default: str) -> Vector:
    text = default if element is None else element.get("xyz", default)
    x, y, z = (float(part) for part in text.split())
    return (x, y, z)


def _number(element: Element, attribute: str) -> float | None:
    text = element.get(attribute)
    return None if text is None else float(text)


def _mimic(element: Element) -> Mimic:
    multiplier, offset = _number(element, "multiplier"), _number(element, "offset")
    return Mimic(element.get("joint", ""), 1.0 if multiplier is None else multiplier, offset or 0.0)
