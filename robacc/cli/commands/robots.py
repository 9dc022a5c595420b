"""``robacc show robots``: the arms that come with the package."""

from __future__ import annotations

from typing import Annotated

from robacc.api.parameters import Help
from robacc.cli.options import PlainOutlets


def robots(
    name: Annotated[str | None, Help("Part of a maker's or an arm's name; default: every arm.", "[TEXT]")] = None,
    *,
    outlets: PlainOutlets,
) -> None:
    """List the arms that come with the package; every command takes one as --robot NAME.

    Each is the nominal model of a data sheet: register it to your measurements, and check its limits and tool.

    Example: robacc show robots ur
    """
    from robacc.cli.output import emit
    from robacc.documents import envelope as results
    from robacc.documents.descriptions import ROBOTS
    from robacc.errors import InputError, Problem
    from robacc.render.views.elements import draw
    from robacc.render.views.robot import robots_view
    from robacc.robots.library import library, similar_arms

    wanted = (name or "").lower()
    arms = [arm for arm in library() if wanted in f"{arm.key} {arm.maker} {arm.model}".lower()]
    if not arms:
        near = ", ".join(similar_arms(wanted))
        raise InputError(
            Problem(
                f"no arm of the package has {name!r} in its name",
                fix=f"did you mean {near}?" if near else "robacc show robots lists all of them",
            )
        )
    emit(
        outlets.form,
        outlets.output,
        table=lambda stream: draw(robots_view(arms), stream),
        document=lambda: results.envelope(
            "robots", ROBOTS.write({"robots": arms}), options={"name": name}, inputs=(), seed=None
        ),
    )
