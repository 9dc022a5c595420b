"""``robacc show effects``: the catalogue of effects."""

from __future__ import annotations

from typing import Annotated

from robacc.api.parameters import BaseLink, Help, IgnoreLimits, OptionalRobot, Ordered, TipLink
from robacc.cli.options import PlainOutlets


def effects(
    effect: Annotated[str | None, Help("Effect to describe in detail.", "[EFFECT]")] = None,
    *,
    robot: OptionalRobot = None,
    poses: Annotated[
        str | None,
        Help(
            "CSV of poses; the list says which effects they can identify. Needs `robot`.",
            "FILE",
            holds="measured poses",
        ),
    ] = None,
    ordered: Ordered = False,
    ignore_limits: IgnoreLimits = False,
    base_link: BaseLink = None,
    tip_link: TipLink = None,
    outlets: PlainOutlets,
) -> None:
    """List the effects; with a name, show its equation, unit, usual size, required data and similar effects.

    Example: robacc show effects backlash --robot robot.yaml
    """
    from robacc import effects as registry
    from robacc.api.inputs import load_optional_robot, load_poses
    from robacc.cli.output import emit
    from robacc.documents import envelope as results
    from robacc.documents.descriptions import EFFECTS
    from robacc.effects.request import catalogue
    from robacc.errors import UsageError
    from robacc.render.text import say_warnings
    from robacc.render.views.elements import draw
    from robacc.render.views.robot import effects_view

    if robot is None and (poses or ordered or ignore_limits or base_link or tip_link):
        raise UsageError("--poses, --ordered, --ignore-limits, --base-link and --tip-link need --robot")
    if effect is not None:
        registry.effect_class(effect)
    arm, inputs = load_optional_robot(robot, base_link, tip_link, poses)
    data = None
    if poses is not None:
        data, record = load_poses(poses, arm, ordered=ordered, ignore_limits=ignore_limits)
        inputs = (*inputs, record)
        say_warnings(data.warnings)
    entries = catalogue(effect, arm, data)
    options = {"effect": effect, "robot": robot, "poses": poses, "ordered": ordered, "ignore_limits": ignore_limits}
    options |= {"base_link": base_link, "tip_link": tip_link}
    emit(
        outlets.form,
        outlets.output,
        table=lambda stream: draw(effects_view(entries, effect is not None), stream),
        document=lambda: results.envelope(
            "effects", EFFECTS.write({"effects": entries}), options=options, inputs=inputs, seed=None
        ),
    )
