"""A robot as tables in mm and degrees, the arms of the package, and the catalogue of effects."""

from collections import Counter
from collections.abc import Sequence

from robacc.errors import listing
from robacc.render.text import (
    IN_DEGREES,
    IN_MM,
    PLAIN_WIDTH,
    Document,
    Grid,
    Listing,
    Section,
    Text,
    fixed,
    grid,
    unit_of,
)
from robacc.robots.description import DH_PARAMETERS, LENGTH_PARAMETERS, ORIGIN_PARAMETERS, Campaign, Frame, Joint, Robot

_CHAINS = {
    "standard": "standard DH: Rz(theta) Tz(d) Tx(a) Rx(alpha)",
    "modified": "modified DH (Craig): Rx(alpha) Tx(a) Rz(theta) Tz(d)",
    "urdf": "URDF: T(x, y, z) Rz(yaw) Ry(pitch) Rx(roll), then the axis",
}


def robot_view(robot: Robot, document: Document) -> list[Section]:
    """Return the report of ``robacc show``."""
    count = len(robot.variables)
    ends = f", {robot.base_link} to {robot.tip_link}" if robot.base_link and robot.tip_link else ""
    follows = "follows" if any(joint.mimic or joint.coupling for joint in robot.joints) else None
    drives = [
        (
            joint.name,
            joint.type,
            *(["-", "-"] if joint.limits is None else [_number(value * factor) for value in joint.limits]),
            unit,
            f"{joint.sign:+d}",
            "-" if joint.gear_ratio is None else _number(joint.gear_ratio),
            _drive_rule(joint),
        )
        for joint in robot.joints
        if joint.type != "fixed"
        for factor, unit in [unit_of("m" if joint.type == "prismatic" else "rad")]
    ]
    links = [(joint.name, joint) for joint in robot.joints] + [
        (f"{branch.joint.name} (on {branch.parent or 'the base'}{rule})", branch.joint)
        for branch in robot.branches
        for rule in [f", follows {_drive_rule(branch.joint)}" if branch.joint.mimic else ""]
    ]
    has_masses = robot.has_masses or any(joint.mass is not None for joint in robot.joints)
    masses = [
        (name, "-", "", "", "")
        if joint.mass is None
        else (name, _number(joint.mass), *(_number(value * IN_MM) for value in joint.com or (0, 0, 0)))
        for name, joint in links
        if has_masses
    ]
    return [
        Section(robot.name, [Text(f"{_CHAINS[robot.convention]}; {count} joint{'s' * (count != 1)}{ends}")]),
        *_geometry(robot),
        _table("Drives", ("joint", "type", "lower", "upper", "unit", "sign", "gear", follows), drives),
        _table("Links", ("joint", "mass kg", "com x mm", "y mm", "z mm"), masses),
        Section("", [Text(f"{label:<8} {text}") for label, text in _facts(robot, document) if text]),
    ]


def _table(title: str, header: Sequence[str | None], rows: Sequence[Sequence[str]]) -> Section:
    left = tuple(place for place, head in enumerate(header) if head in ("joint", "type", "follows", "axis"))
    return Section(title, [grid(header, rows, left=left, is_ruled=True)])


def _geometry(robot: Robot) -> list[Section]:
    """Return the geometry as one table, or as one of lengths and one of angles if a line would not fit."""
    is_urdf = robot.convention == "urdf"
    # Empty columns are omitted: beta of most DH tables, offsets of most URDFs.
    columns = {
        f"{name}{'' if name == 'offset' else ' mm' if name in LENGTH_PARAMETERS else '°'}": [
            _parameter(joint, name) for joint in robot.joints
        ]
        for name in (ORIGIN_PARAMETERS if is_urdf else DH_PARAMETERS)
        if name not in ("beta", "offset") or any(joint.parameters.get(name) for joint in robot.joints)
    }
    if is_urdf:
        columns["axis"] = ["fixed" if joint.type == "fixed" else _axis(joint.axis) for joint in robot.joints]
    names = {"joint": [joint.name for joint in robot.joints]}
    lengths = {head: cells for head, cells in columns.items() if head.removesuffix(" mm") in LENGTH_PARAMETERS}
    angles = {head: cells for head, cells in columns.items() if head not in lengths}
    is_wide = sum(3 + max(map(len, [head, *cells])) for head, cells in (names | columns).items()) > PLAIN_WIDTH
    parts = {": lengths": lengths, ": angles": angles} if is_wide else {"": columns}
    return [
        _table(f"Geometry{part}", [*own], [*zip(*own.values(), strict=True)])
        for part, cells in parts.items()
        for own in [names | cells]
    ]


def _axis(axis: Sequence[float]) -> str:
    """Return ``z`` or ``-y`` for an axis of the frame, else its components."""
    return next(
        (f"{'-' * (value < 0)}{name}" for name, value in zip("xyz", axis, strict=True) if abs(value) == 1.0),
        _numbers(axis, 1.0),
    )


def _drive_rule(joint: Joint) -> str:
    """Return what a joint follows, such as ``2 x j1`` or ``j3 + j2``; empty for an independent joint."""
    if joint.mimic is not None:
        return f"{_number(joint.mimic.multiplier)} x {joint.mimic.master}"
    others = (
        f" {'-' if ratio < 0 else '+'} {'' if abs(ratio) == 1 else f'{_number(abs(ratio))} '}{name}"
        for name, ratio in joint.coupling.items()
    )
    own = "" if joint.is_passive or not joint.coupling else joint.name
    return f"{own}{''.join(others)}".strip().removeprefix("+ ")


def _facts(robot: Robot, document: Document) -> list[tuple[str, str]]:
    """Return labels and texts; an empty text is left out."""
    campaign, com, coefficients = robot.campaign, robot.payload_com, document["robot"]["coefficients"]
    several, mass = len(document["reach"]) > 1, document["moved_mass_kg"]
    counts = Counter(str(effect.get("effect", effect.get("name", "?"))) for effect in robot.effects)
    listed = coefficients if len(coefficients) <= 41 else coefficients[:40]
    others = len(coefficients) - len(listed)
    own = campaign or Campaign(())
    frames = [name for name, frame in (("base", own.base), ("tool", own.tool)) if frame is not None]
    frames += [f"target {name}" for name in own.targets]
    names = ", ".join(str(effect.get("effect")) for effect in own.effects)
    return [
        ("base", _frame(robot.base)),
        *(("target", f"{name}: {_frame(frame)}") for name, frame in robot.targets.items()),
        ("tool", "" if robot.targets else _frame(robot.tool)),
        ("payload", "" if com is None else f"at ({_numbers(com, IN_MM)}) mm in the last link's frame"),
        ("gravity", f"({_numbers(robot.gravity, 1.0)}) m/s^2"),
        *(("reach", f"{f'{name}: ' * several}{_reach(reach)}") for name, reach in document["reach"].items()),
        ("masses", "unknown" if mass is None else f"{_number(mass)} kg in total"),
        ("effects", ", ".join(f"{name} ({n} entries)" if n > 1 else name for name, n in counts.items()) or "none"),
        *(("", f"{each['name']} = {each['value']:.6g} {each['unit']}".rstrip()) for each in listed),
        ("", f"… and {others} more coefficients, in the robot file" * (others > 0)),
        *(
            ("valid", f"{effect.get('effect')}: {', '.join(ranges)}" * bool(ranges))
            for effect in (*robot.effects, *own.effects)
            for ends in [effect.get("validity", {}).items()]
            for ranges in [[f"{driver} {low:.4g} to {high:.4g}" for driver, (low, high) in ends]]
        ),
        ("campaign", f"registered in it: {', '.join(frames)}" * bool(frames)),
        ("campaign", f"effects {names}, for its own poses only" * bool(names)),
        *(("fitted", f"to the poses of SHA-256 {digest[:16]}…") for digest in robot.fitted_to),
    ]


def _reach(reach: Document) -> str:
    sampled, bound = reach["sampled_m"], reach["bound_m"]
    return (
        "unknown: a prismatic joint has no limits"
        if sampled is None or bound is None
        else f"{sampled * IN_MM:.0f} mm from the base origin within the limits; sum of lengths {bound * IN_MM:.0f} mm"
    )


def _parameter(joint: Joint, name: str) -> str:
    """Return a parameter's value, for the joint variable's offset as ``q + offset``."""
    value = _number(
        joint.parameters.get(name, 0.0)
        * (IN_MM if (name in LENGTH_PARAMETERS or (name == "offset" and joint.type == "prismatic")) else IN_DEGREES)
    )
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
    return fixed(value, 4).rstrip("0").rstrip(".")


# The arms that come with the package, as a table.


def robots_view(arms: Sequence[Document]) -> list[Section]:
    """Return a line per arm, and how to use them."""
    rows = [
        (arm["name"], arm["maker"], arm["model"], str(arm["n_axes"]), f"{arm['reach_m'] * IN_MM:.0f}") for arm in arms
    ]
    use = (
        "`robot` takes a name of this list; each is the nominal model of a data sheet, without the tool: robacc init "
        "NAME writes a copy to which you add the tool or several targets"
    )
    return [
        Section("", [Grid(("name", "maker", "model", "axes", "reach mm"), rows, left=(0, 1, 2))]),
        Section("", [Listing([use])]),
    ]


# The catalogue of effects as text to read.


def effects_view(entries: Sequence[Document], in_detail: bool) -> list[Section]:
    """Return the catalogue as a list, or ``in_detail`` the facts of its only entry."""
    if not in_detail:
        rows = [
            (entry["name"], entry["summary"] + (f" (not applicable: {entry['why']})" if entry.get("why") else ""))
            for entry in entries
        ]
        hint = (
            "robacc show effects NAME shows an effect's equation, unit, usual size, required data and similar effects"
        )
        return [Section("", [Grid(("", ""), rows, is_text=True)]), Section("", [Text(hint, is_note=True)])]
    (entry,) = entries
    names = [f"{term['name']} ({term['unit']})" for term in entry.get("coefficients", ())]
    applicable = f"applicable{' to ' * bool(entry.get('joints'))}{', '.join(entry.get('joints', ()))}"
    is_known, is_applicable = "offered" in entry, entry.get("offered", False)
    facts = [
        ("equation", entry["equation"]),
        ("unit", entry["unit"]),
        ("usual size", entry["usual_size"]),
        ("needs", entry["needs"]),
        ("confused with", entry["confused_with"]),
        ("source", entry["source"]),
        ("in a file", entry["example"]),
        ("this robot", (applicable if is_applicable else f"not applicable: {entry.get('why')}") * is_known),
        ("coefficients", listing(names, 12) * is_applicable),
    ]
    table = Grid(("", ""), [(f"  {label:<14}", text) for label, text in facts if text], is_text=True)
    return [Section(entry["name"], [Text(f"  {entry['summary']}"), table])]
