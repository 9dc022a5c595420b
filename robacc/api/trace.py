"""Call of the command ``robacc trace``."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, TextIO

import numpy as np

from robacc.api.fitting import FitInputs, FitResult, joined, load_fit_inputs, with_inputs
from robacc.api.inputs import PosesSource, StrPath
from robacc.api.result import CampaignUse, Provenance, check_range, options_of
from robacc.effects.request import Baseline, build, default_baseline, parse_requests
from robacc.fitting.visits import places
from robacc.measurements import Measurements
from robacc.modelling.model import Model
from robacc.robots.arm import Arm
from robacc.robots.description import Robot
from robacc.threads import single_threaded
from robacc.tracing.trace import Trace
from robacc.tracing.trace import trace as trace_effects


@dataclass(frozen=True, kw_only=True, repr=False)
class Traced(FitResult, Trace):
    """Result of a trace, with its inputs."""

    command: ClassVar[str] = "trace"
    fit_inputs: FitInputs
    baseline: Baseline
    """The declared effects, and whether the call declared them."""
    made: Provenance

    def payload(self) -> dict[str, Any]:
        """Return the result's own keys; arrays stay arrays."""
        from robacc.documents.fit import trace_payload

        inputs = self.fit_inputs
        return trace_payload(self, inputs.data, inputs.robot, inputs.holdout, self.made.seed or 0, self.baseline)

    def draw(self, stream: TextIO) -> None:
        """Write how good, why, and what now."""
        from robacc.render.views.elements import draw
        from robacc.render.views.fit import short_trace_view

        draw(short_trace_view(self.payload(), self.named("poses"), self.named("robot")), stream)


@single_threaded
def trace(
    poses: PosesSource,
    *,
    robot: StrPath | Robot,
    declared: str | Sequence[str] | None = None,
    folds: int | None = None,
    holdout: PosesSource | None = None,
    empirical: bool = True,
    ordered: bool = False,
    ignore_limits: bool = False,
    campaign: CampaignUse = "auto",
    strict_range: bool = False,
    base_link: str | None = None,
    tip_link: str | None = None,
    seed: int = 0,
    progress: Callable[[str, int, int], None] | None = None,
) -> Traced:
    """Find the effects that explain the residual, and compute the error before and after on held-out poses.

    Args:
        poses: CSV of measured poses (``-`` is standard input), or poses read before or made of arrays.
        robot: Robot file (YAML) or URDF that commanded the poses, or a robot read before.
        declared: Effects known to be present, such as ``("base_frame", "tool_frame")``: part of the baseline. None for
            the effects of every arm that the poses support: base_frame, tool_frame, joint_offset, link_geometry.
            ``"none"`` or ``()`` for nothing.
        folds: Number of parts of the poses that are held out in turn; by default each pose in turn, with its repeats
            and the poses close to it.
        holdout: Separate validation poses, in place of held-out poses of the file.
        empirical: Allow empirical corrections after the named effects.
        ordered: The rows of the files are in the order measured; directions and speeds are derived from it.
        ignore_limits: Joint values outside the limits are a warning; by default they are an error where they exceed a
            limit by more than 0.05 degree or 0.5 mm.
        campaign: Use of the facts of the campaign that a model was fitted in, such as a drift: ``keep``, ``drop``, or
            ``auto`` for its own poses and for measured poses that agree better with them.
        strict_range: Refuse poses outside the validity range of the model.
        base_link: First link of the chain in a URDF.
        tip_link: Last link of the chain in a URDF.
        seed: Seed of the random numbers.
        progress: Called with a label of the work, the number of steps done, and the number of all steps.

    Returns:
        The verdict, the findings with their alternatives and coefficients, the error before and after, and the robot
        with the identified effects.

    Raises:
        InputError: A file or array cannot be used, the data hold a mistake, or the poses are too few.
        UsageError: The data lack what a declared effect needs, or the arguments contradict each other.

    Example:
        >>> import robacc
        >>> result = robacc.trace(
        ...     "sample_data/trace/poses.csv",
        ...     robot="sample_data/trace/robot.yaml",
        ...     declared="base_frame,tool_frame,joint_offset,link_geometry",
        ... )
        >>> result.verdict, [(finding.effect, finding.joints) for finding in result.findings]
        ('explained', [('joint_compliance', ('j2',)), ('backlash', ('j3',))])
    """
    arguments = locals()
    if folds is not None:
        check_range("folds", folds, 2, 50)
    check_range("seed", seed, 0)
    inputs = load_fit_inputs(poses, robot, holdout, ordered, ignore_limits, base_link, tip_link, campaign, strict_range)
    arm = Arm.of(inputs.robot)
    baseline = _baseline(declared, arm, inputs.data)
    inputs.require_targets(baseline.names)
    effects = build(parse_requests(",".join(baseline.names)), arm, inputs.data)
    body = trace_effects(
        Model.of(inputs.robot, effects),
        inputs.data,
        n_folds=folds,
        seed=seed,
        holdout=inputs.holdout,
        empirical=empirical,
        progress=progress or (lambda label, done, total: None),
    )
    options = options_of(
        trace, arguments, **inputs.names, declared=",".join(baseline.names) if declared is None else joined(declared)
    )
    made = Provenance(options, inputs.files, seed, inputs.use)
    return Traced(**with_inputs(body, inputs), baseline=baseline, made=made)


def _baseline(declared: str | Sequence[str] | None, arm: Arm, data: Measurements) -> Baseline:
    """Return the declared effects, or those of every arm if ``declared`` is None."""
    if declared is None:
        return default_baseline(arm, data, int(np.unique(places(data)).size))
    text = joined(declared).strip()
    requests = parse_requests("" if text == "none" else text)
    return Baseline(tuple(map(str, requests)), by_default=False)
