"""``robacc effects``: the catalogue of effects."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

from robacc.api.parameters import BaseLink, Help, IgnoreLimits, Ordered, TipLink
from robacc.cli.options import PlainOutlets, RobotFile

if TYPE_CHECKING:
    from robacc.measurements import Measurements
    from robacc.robots.description import Robot


def effects(
    effect: Annotated[str | None, Help("Effect to describe in detail.", "[EFFECT]")] = None,
    *,
    robot: RobotFile = None,
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

    Example: robacc effects backlash --robot robot.yaml
    """
    from robacc import effects as registry
    from robacc.cli.output import emit
    from robacc.documents import envelope as results
    from robacc.documents.descriptions import EFFECTS
    from robacc.effects.catalogue import catalogue
    from robacc.errors import UsageError
    from robacc.io.files import sha256_of
    from robacc.modelling.robot_file import robot_path
    from robacc.render.views.elements import draw
    from robacc.render.views.robot import effects_view

    if robot is None and (poses or ordered or ignore_limits or base_link or tip_link):
        raise UsageError("--poses, --ordered, --ignore-limits, --base-link and --tip-link need --robot")
    if effect is not None:
        registry.effect_class(effect)
    arm, data = _load(robot, poses, base_link, tip_link, ordered, ignore_limits)
    entries = catalogue(effect, arm, data)
    inputs = []
    if robot is not None:
        inputs.append(results.InputFile.at(robot, sha256_of(robot_path(robot)), "robot"))
    if data is not None:
        inputs.append(results.InputFile.at(poses or "-", data.sha256 or "", "poses"))
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


def _load(
    robot: str | None,
    poses: str | None,
    base_link: str | None,
    tip_link: str | None,
    ordered: bool,
    ignore_limits: bool,
) -> tuple[Robot | None, Measurements | None]:
    from robacc.api.inputs import load_robot
    from robacc.diagnostics.robot_poses import read_robot_poses
    from robacc.render.text.console import say_warnings

    if robot is None:
        return None, None
    arm, _ = load_robot(robot, base_link, tip_link, poses)
    if poses is None:
        return arm, None
    data = read_robot_poses(poses, arm, ordered=ordered, ignore_limits=ignore_limits)
    say_warnings(data.warnings)
    return arm, data
