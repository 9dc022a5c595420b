"""The call behind ``robacc trace``."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from robacc.api.fitted_to import fitted_to, met_again
from robacc.api.fitting import Fitted, Given, given, listed
from robacc.api.inputs import StrPath
from robacc.api.result import Made, parts, within
from robacc.effects.request import build, parse_requests
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.robots.arm import Arm
from robacc.robots.description import Robot
from robacc.tracing.trace import Trace
from robacc.tracing.trace import trace as close_the_loop


@dataclass(frozen=True, kw_only=True, repr=False)
class Traced(Fitted, Trace):
    """What the loop found, with what it was computed from."""

    command: ClassVar[str] = "trace"
    given: Given
    made: Made

    def payload(self) -> dict[str, Any]:
        """The result's own keys; arrays stay arrays."""
        from robacc.documents.fit import trace_payload

        return trace_payload(self, self.given.data, self.given.robot, self.given.apart, self.made.seed or 0)


def trace(
    poses: StrPath | Measurements,
    *,
    robot: StrPath | Robot,
    declared: str | Sequence[str] = (),
    holdout: StrPath | Measurements | None = None,
    folds: int = 5,
    empirical: bool = True,
    ordered: bool = False,
    base_link: str | None = None,
    tip_link: str | None = None,
    seed: int = 0,
    progress: Callable[[str, int, int], None] | None = None,
) -> Traced:
    """Close the loop: residual, cause, correction, and the error before and after on poses that had no part in it.

    Args:
        poses: CSV of measured poses (``-`` is standard input), or poses that were read before or made of arrays.
        robot: Robot file (YAML) or URDF that commanded them, or a robot that was read before.
        declared: Effects known to be there, as in ``("base_frame", "tool_frame")``: fitted before and after.
        holdout: Poses of their own to judge on, instead of folds.
        folds: Of cross-fitting: poses held out in turn.
        empirical: Whether corrections without a name may compete at the end.
        ordered: The rows of the files are in the order measured.
        base_link: URDF: the link that the chain starts at.
        tip_link: URDF: the link that it ends at.
        seed: Of everything drawn at random.
        progress: Called with what is being done, how much of it is done, and of how much.

    Returns:
        The verdict, the findings with their rivals and coefficients, the error before and after, and the robot with
        the findings written into it.

    Raises:
        InputError: A file or array cannot be used, or the data hold a mistake, or are too few.
        UsageError: The data lack what a declared effect needs, or the call does not fit itself.

    Example:
        >>> import robacc
        >>> found = robacc.trace(
        ...     "sample_data/trace/poses.csv",
        ...     robot="sample_data/trace/robot.yaml",
        ...     declared="base_frame,tool_frame,joint_offset,link_geometry",
        ...     folds=2,
        ... )
        >>> found.verdict, [(one.effect, one.joints) for one in found.findings]
        ('explained', [('joint_compliance', ('j2',)), ('backlash', ('j3',))])
    """
    within("folds", folds, 2, 50)
    within("seed", seed, 0)
    asked = given(poses, robot, holdout, ordered, base_link, tip_link)
    effects = build(parse_requests(listed(declared)), Arm.of(asked.robot), asked.data)
    found = close_the_loop(
        Model.of(asked.robot, effects),
        asked.data,
        n_folds=folds,
        seed=seed,
        holdout=asked.apart,
        empirical=empirical,
        progress=progress or (lambda what, done, of: None),
    )
    options = {
        "poses": asked.names["poses"],
        "robot": asked.names["robot"],
        "declared": listed(declared),
        "folds": folds,
        "holdout": asked.names["holdout"],
        "empirical": empirical,
        "ordered": ordered,
        "base_link": base_link,
        "tip_link": tip_link,
    }
    warnings = (*found.warnings, *met_again(asked.robot, asked.inputs))
    found = dataclasses.replace(found, robot=fitted_to(found.robot, asked.inputs), warnings=warnings)
    return Traced(**parts(found), given=asked, made=Made(options, asked.inputs, seed))
