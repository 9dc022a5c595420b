"""A robot as tables in mm and degrees, the arms of the package, and the catalogue of effects."""

from __future__ import annotations

import textwrap
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, TextIO

from robacc.effects.catalogue import CatalogueEntry
from robacc.render.text.console import PLAIN_WIDTH, width_of, write_lines
from robacc.render.text.layout import BLANK, IN_DEGREES, IN_MM, TextLine, heading, items, table_unit, wrapped
from robacc.robots.description import DH_PARAMETERS, LENGTH_PARAMETERS, ORIGIN_PARAMETERS, Campaign, Frame, Joint, Robot
from robacc.robots.library import LibraryArm, Reach, Summary

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.table import Table


_CHAINS = {
    "standard": "standard DH: Rz(theta) Tz(d) Tx(a) Rx(alpha)",
    "modified": "modified DH (Craig): Rx(alpha) Tx(a) Rz(theta) Tz(d)",
    "urdf": "URDF: T(x, y, z) Rz(yaw) Ry(pitch) Rx(roll), then the axis",
}


_GAP = 3
"""Blanks between columns, and a reserve."""
_MOST = 40
"""Coefficients of effects that are listed."""


def render_robot(summary: Summary) -> RenderableType:
    """Return the report of ``robacc show`` for a rich console."""
    from rich.console import Group
    from rich.text import Text

    robot = summary.robot
    parts: list[RenderableType] = [Text(robot.name, style="bold"), Text(_chain_line(robot)), Text("")]
    parts.extend(_geometry_tables(robot))
    parts.append(_drive_table(robot))
    if robot.has_masses or any(joint.mass is not None for joint in robot.joints):
        parts.append(_mass_table(robot))
    parts.extend(Text(line) for line in _robot_facts(summary))
    return Group(*parts)


def _chain_line(robot: Robot) -> str:
    ends = f", {robot.base_link} to {robot.tip_link}" if robot.base_link and robot.tip_link else ""
    count = len(robot.variables)
    return f"{_CHAINS[robot.convention]}; {count} joint{'s' * (count != 1)}{ends}"


def _table(title: str, columns: Iterable[str]) -> Table:
    from rich import box
    from rich.table import Table

    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, pad_edge=False)
    for column in columns:
        is_text = column in ("joint", "type", "follows", "axis")
        # Names are never cut: readers look for them and options take them.
        table.add_column(column, justify="left" if is_text else "right", no_wrap=column == "joint", overflow="fold")
    return table


def _geometry_tables(robot: Robot) -> list[Table]:
    """Return the geometry as one table, or as one of lengths and one of angles if a line would not fit."""
    names = DH_PARAMETERS if robot.convention != "urdf" else ORIGIN_PARAMETERS
    # Empty columns are omitted: beta of most DH tables, offsets of most URDFs.
    shown = [name for name in names if name not in ("beta", "offset") or any(_value(j, name) for j in robot.joints)]
    is_urdf = robot.convention == "urdf"
    units = ["" if name == "offset" else " mm" if name in LENGTH_PARAMETERS else "°" for name in shown]
    headings = [f"{name}{unit}" for name, unit in zip(shown, units, strict=True)]
    columns = [["joint", *(joint.name for joint in robot.joints)]]
    columns += [
        [heading, *(_parameter(joint, name) for joint in robot.joints)]
        for heading, name in zip(headings, shown, strict=True)
    ]
    if is_urdf:
        columns.append(["axis", *("fixed" if j.type == "fixed" else _axis(j.axis) for j in robot.joints)])
    if sum(max(map(len, column)) + _GAP for column in columns) <= PLAIN_WIDTH:
        return [_filled("Geometry", columns)]
    lengths = {heading for heading, name in zip(headings, shown, strict=True) if name in LENGTH_PARAMETERS}
    return [
        _filled("Geometry: lengths", [column for column in columns if column[0] in {"joint", *lengths}]),
        _filled("Geometry: angles", [column for column in columns if column[0] not in lengths]),
    ]


def _filled(title: str, columns: Sequence[Sequence[str]]) -> Table:
    """Return the table of columns that begin with their headings."""
    table = _table(title, [column[0] for column in columns])
    for row in zip(*(column[1:] for column in columns), strict=True):
        table.add_row(*row)
    return table


def _axis(axis: Sequence[float]) -> str:
    """Return ``z`` or ``-y`` for an axis of the frame, else its components."""
    for name, place in zip("xyz", range(3), strict=True):
        if abs(axis[place]) == 1.0:
            return name if axis[place] > 0 else f"-{name}"
    return _numbers(axis, 1.0)


def _drive_table(robot: Robot) -> Table:
    follows = any(joint.mimic or joint.coupling for joint in robot.joints)
    table = _table(
        "Drives", ["joint", "type", "lower", "upper", "unit", "sign", "gear", *(["follows"] if follows else [])]
    )
    for joint in robot.joints:
        if joint.type == "fixed":
            continue
        factor, unit = table_unit("m" if joint.type == "prismatic" else "rad")
        limits = ["-", "-"] if joint.limits is None else [_number(value * factor) for value in joint.limits]
        gear = "-" if joint.gear_ratio is None else _number(joint.gear_ratio)
        rule = [_drive_rule(joint)] if follows else []
        table.add_row(joint.name, joint.type, *limits, unit, f"{joint.sign:+d}", gear, *rule)
    return table


def _drive_rule(joint: Joint) -> str:
    """Return what a joint follows, such as ``2 x j1`` or ``j3 + j2``; empty for an independent joint."""
    if joint.mimic is not None:
        return f"{_number(joint.mimic.multiplier)} x {joint.mimic.master}"
    text = "" if joint.is_passive or not joint.coupling else joint.name
    for name, ratio in joint.coupling.items():
        factor = "" if abs(ratio) == 1 else f"{_number(abs(ratio))} "
        text += f" {'-' if ratio < 0 else '+'} {factor}{name}"
    return text.strip().removeprefix("+ ")


def _mass_table(robot: Robot) -> Table:
    table = _table("Links", ["joint", "mass kg", "com x mm", "y mm", "z mm"])
    for joint in robot.joints:
        if joint.mass is None:
            table.add_row(joint.name, "-", "", "", "")
        else:
            table.add_row(
                joint.name, _number(joint.mass), *(_number(value * IN_MM) for value in joint.com or (0, 0, 0))
            )
    for branch in robot.branches:
        x, y, z = branch.joint.com or (0, 0, 0)
        rule = f", follows {_drive_rule(branch.joint)}" if branch.joint.mimic else ""
        place = f"{branch.joint.name} (on {branch.parent or 'the base'}{rule})"
        table.add_row(place, _number(branch.joint.mass or 0.0), *(_number(value * IN_MM) for value in (x, y, z)))
    return table


def _robot_facts(summary: Summary) -> list[str]:
    robot = summary.robot
    lines = [f"base     {_frame(robot.base)}"]
    if robot.targets:
        lines += [f"target   {name}: {_frame(frame)}" for name, frame in robot.targets.items()]
    else:
        lines.append(f"tool     {_frame(robot.tool)}")
    if robot.payload_com is not None:
        lines.append(f"payload  at ({_numbers(robot.payload_com, IN_MM)}) mm in the last link's frame")
    lines.append(f"gravity  ({_numbers(robot.gravity, 1.0)}) m/s^2")
    lines += [f"reach    {_reach(name, reach, len(summary.reach) > 1)}" for name, reach in summary.reach.items()]
    mass = "unknown" if summary.moved_mass is None else f"{_number(summary.moved_mass)} kg in total"
    lines.append(f"masses   {mass}")
    counts = Counter(str(effect.get("effect", effect.get("name", "?"))) for effect in robot.effects)
    effects = ", ".join(f"{name} ({count} entries)" if count > 1 else name for name, count in counts.items())
    lines.append(f"effects  {effects or 'none'}")
    listed = summary.coefficients if len(summary.coefficients) <= _MOST + 1 else summary.coefficients[:_MOST]
    lines += [f"         {name} = {value:.6g}{f' {unit}' * bool(unit)}" for name, value, unit in listed]
    if len(listed) < len(summary.coefficients):
        lines.append(f"         … and {len(summary.coefficients) - len(listed)} more coefficients, in the robot file")
    for effect in (*robot.effects, *(robot.campaign.effects if robot.campaign else ())):
        ranges = ", ".join(f"{driver} {low:.4g} to {high:.4g}" for driver, (low, high) in _validity(effect).items())
        lines += [f"valid    {effect.get('effect')}: {ranges}"] if ranges else []
    if robot.campaign is not None:
        lines += [f"campaign {line}" for line in _campaign(robot.campaign)]
    lines += [f"fitted   to the poses of SHA-256 {digest[:16]}…" for digest in robot.fitted_to]
    return lines


def _validity(effect: Mapping[str, Any]) -> Mapping[str, Sequence[float]]:
    validity: Mapping[str, Sequence[float]] = effect.get("validity", {})
    return validity


def _campaign(campaign: Campaign) -> list[str]:
    frames = [name for name, frame in (("base", campaign.base), ("tool", campaign.tool)) if frame is not None]
    frames += [f"target {name}" for name in campaign.targets]
    effects = ", ".join(str(effect.get("effect")) for effect in campaign.effects)
    lines = [f"registered in it: {', '.join(frames)}"] if frames else []
    return [*lines, f"effects {effects}, for its own poses only"] if effects else lines


def _reach(name: str, reach: Reach, with_name: bool) -> str:
    prefix = f"{name}: " if with_name else ""
    if reach.sampled is None or reach.bound is None:
        return f"{prefix}unknown: a prismatic joint has no limits"
    return (
        f"{prefix}{reach.sampled * IN_MM:.0f} mm from the base origin within the limits; sum of lengths "
        f"{reach.bound * IN_MM:.0f} mm"
    )


def _value(joint: Joint, name: str) -> float:
    return joint.parameters.get(name, 0.0)


def _parameter(joint: Joint, name: str) -> str:
    """Return a parameter's value, for the joint variable's offset as ``q + offset``."""
    is_length = name in LENGTH_PARAMETERS or (name == "offset" and joint.type == "prismatic")
    value = _number(_value(joint, name) * (IN_MM if is_length else IN_DEGREES))
    if joint.type == "fixed" or name != joint.offset_parameter or name == "offset":
        return value
    variable = "q" if joint.sign > 0 else "-q"
    return variable if value == "0" else f"{variable} {'-' if value.startswith('-') else '+'} {value.lstrip('-')}"


def _frame(frame: Frame) -> str:
    return f"({_numbers(frame.xyz, IN_MM)}) mm, rpy ({_numbers(frame.rpy, IN_DEGREES)})°"


def _numbers(values: Sequence[float], factor: float) -> str:
    return ", ".join(_number(value * factor) for value in values)


def _number(value: float) -> str:
    """Return up to four decimals (0.1 µm, 0.0001°) without trailing zeros."""
    text = f"{value:.4f}".rstrip("0").rstrip(".")
    return "0" if text in ("-0", "") else text


# The arms that come with the package, as a table.

_USE = (
    "`robot` takes a name of this list; each is the nominal model of a data sheet, without the tool: robacc init NAME "
    "writes a copy to which you add the tool or several targets"
)


def draw_robots(arms: Sequence[LibraryArm], stream: TextIO) -> None:
    """Write a line per arm to ``stream``."""
    rows = [("name", "maker", "model", "axes", "reach mm")]
    rows += [(arm.key, arm.maker, arm.model, str(arm.axes), f"{arm.reach * IN_MM:.0f}") for arm in arms]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    texts = [
        "  ".join(
            f"{cell:>{width}}" if place > 2 else f"{cell:<{width}}"
            for place, (cell, width) in enumerate(zip(row, widths, strict=True))
        )
        for row in rows
    ]
    lines = [TextLine(text, "dim" if number == 0 else "") for number, text in enumerate(texts)]
    write_lines([*lines, BLANK, *items([_USE], width_of(stream))], stream)


# The catalogue of effects as text to read.

_COEFFICIENTS_SHOWN = 12
_LABEL = 16
"""Columns that the labels take."""


def draw_effects(entries: Sequence[CatalogueEntry], in_detail: bool, stream: TextIO) -> None:
    """Write the catalogue to ``stream`` as a list, or ``in_detail`` the facts of its only entry."""
    lines = _details(entries[0], width_of(stream)) if in_detail else _overview(entries, width_of(stream))
    write_lines(lines, stream)


def _overview(entries: Sequence[CatalogueEntry], width: int) -> Iterator[TextLine]:
    """Return a line or two for each effect, with the reason why it is not applicable."""
    label = max(len(entry.effect.name) for entry in entries) + 2
    for entry in entries:
        text = entry.effect.about.summary
        if entry.why is not None:
            text += f" (not applicable: {entry.why})"
        first = f"{entry.effect.name:<{label}}"
        lines = textwrap.wrap(text, width, initial_indent=first, subsequent_indent=" " * label)
        yield from (TextLine(line) for line in lines)
    yield BLANK
    text = "robacc effects NAME shows an effect's equation, unit, usual size, required data and similar effects"
    yield from (TextLine(line.text, "dim") for line in wrapped(text, width))


def _details(entry: CatalogueEntry, width: int) -> Iterator[TextLine]:
    """Return the facts of an effect."""
    yield heading(entry.effect.name)
    yield from (
        TextLine(text)
        for text in textwrap.wrap(entry.effect.about.summary, width, initial_indent="  ", subsequent_indent="  ")
    )
    for label, value in _effect_facts(entry):
        indent = " " * (_LABEL + 2)
        first = f"  {label:<{_LABEL}}"
        lines = textwrap.wrap(value, width, initial_indent=first, subsequent_indent=indent, break_on_hyphens=False)
        yield from (TextLine(text) for text in lines)


def _effect_facts(entry: CatalogueEntry) -> Iterator[tuple[str, str]]:
    about = entry.effect.about
    yield "equation", about.equation
    yield "unit", about.unit
    yield "usual size", about.usual_size
    yield "needs", about.needs
    yield "confused with", about.confused_with
    yield "source", about.source
    yield "in a file", about.example
    if not entry.for_robot:
        return
    if entry.why is not None:
        yield "this robot", f"not applicable: {entry.why}"
        return
    joints = f" to {', '.join(entry.joints)}" if entry.joints else ""
    yield "this robot", f"applicable{joints}"
    names = [f"{name} ({unit})" for name, unit in entry.coefficients]
    more = f" and {len(names) - _COEFFICIENTS_SHOWN} more" if len(names) > _COEFFICIENTS_SHOWN else ""
    yield "coefficients", ", ".join(names[:_COEFFICIENTS_SHOWN]) + more
