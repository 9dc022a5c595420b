"""Call of the command ``robacc trace``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

from robacc.api.fitting import FitInputs, FitResult, joined, load_fit_inputs, requested, with_inputs
from robacc.api.parameters import (
    BaseLink,
    Campaign,
    Folds,
    Help,
    Holdout,
    IgnoreLimits,
    NeededRobot,
    Ordered,
    Poses,
    Progress,
    Seed,
    StrictRange,
    TipLink,
    call,
)
from robacc.api.result import Provenance, options_of
from robacc.effects.base import load_plug_ins
from robacc.effects.request import Baseline, build, parse_requests
from robacc.modelling.model import Model
from robacc.robots.arm import Arm
from robacc.tracing.trace import Trace
from robacc.tracing.trace import trace as trace_effects


@dataclass(frozen=True, kw_only=True, repr=False)
class Traced(FitResult, Trace):
    """Result of a trace, with its inputs."""

    command: ClassVar[str] = "trace"
    fit_inputs: FitInputs
    baseline: Baseline
    made: Provenance

    def payload(self) -> dict[str, Any]:
        """Return the result's own keys; arrays stay arrays."""
        from robacc.documents.fit import TRACE, fit_document

        inputs = self.fit_inputs
        return fit_document(TRACE, self, inputs.data, inputs.robot, inputs.holdout, self.made.seed or 0, self.baseline)


@call
def trace(
    poses: Poses,
    *,
    robot: NeededRobot,
    declared: Annotated[
        str | Sequence[str] | None,
        Help(
            "Effects that the baseline has; none for no effect. Default: base_frame, tool_frame, joint_offset and "
            "link_geometry, as far as the poses support them.",
            "EFFECT,…",
        ),
    ] = None,
    folds: Folds = None,
    holdout: Holdout = None,
    empirical: Annotated[
        bool,
        Help(
            "Allow empirical corrections after the named effects, or named effects only.",
            names=("empirical/named-only",),
        ),
    ] = True,
    ordered: Ordered = False,
    ignore_limits: IgnoreLimits = False,
    campaign: Campaign = "auto",
    strict_range: StrictRange = False,
    base_link: BaseLink = None,
    tip_link: TipLink = None,
    seed: Seed = 0,
    progress: Progress = None,
) -> Traced:
    """Find the effects that explain the residual, and compute the error before and after on held-out poses.

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
    load_plug_ins()
    inputs = load_fit_inputs(poses, robot, holdout, ordered, ignore_limits, base_link, tip_link, campaign, strict_range)
    arm = Arm.of(inputs.robot)
    baseline = requested(declared, arm, inputs.data)
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
