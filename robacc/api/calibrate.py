"""Call of the command ``robacc calibrate``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

from robacc.api.fitting import FitInputs, FitResult, joined, load_fit_inputs, requested, with_inputs
from robacc.api.inputs import path_of
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
from robacc.calibration.calibrating import Calibration
from robacc.calibration.calibrating import calibrate as fit_effects
from robacc.effects.request import Baseline, parse_requests
from robacc.errors import UsageError
from robacc.fitting.fit_result import Options
from robacc.fitting.priors import tolerance_priors
from robacc.robots.arm import Arm


@dataclass(frozen=True, kw_only=True, repr=False)
class Calibrated(FitResult, Calibration):
    """Calibrated robot and its errors, with the inputs."""

    command: ClassVar[str] = "calibrate"
    fit_inputs: FitInputs
    baseline: Baseline
    made: Provenance

    def payload(self) -> dict[str, Any]:
        """Return the result's own keys; arrays stay arrays."""
        from robacc.documents.fit import CALIBRATE, fit_document

        inputs = self.fit_inputs
        return fit_document(
            CALIBRATE, self, inputs.data, inputs.robot, inputs.holdout, self.made.seed or 0, self.baseline
        )


@call
def calibrate(
    poses: Poses,
    *,
    robot: NeededRobot,
    fit: Annotated[
        str | Sequence[str] | None,
        Help(
            "Effects to fit, such as base_frame,joint_offset[j2,j3]; robacc show effects lists them. Default: "
            "base_frame, tool_frame, joint_offset and link_geometry, as far as the poses support them.",
            "EFFECT,…",
        ),
    ] = None,
    prior: Annotated[
        bool,
        Help("Use the tolerances of the robot file as priors of its geometry.", names=("prior/no-prior",)),
    ] = False,
    shrink: Annotated[
        bool,
        Help(
            "Shrink joint_offset and link_geometry, if named without brackets, to nominal values where the data show "
            "no difference.",
            names=("shrink/no-shrink",),
        ),
    ] = True,
    robust: Annotated[
        bool, Help("Leave out outliers and list them, or fit all rows.", names=("robust/all-rows",))
    ] = True,
    folds: Folds = None,
    holdout: Holdout = None,
    ordered: Ordered = False,
    ignore_limits: IgnoreLimits = False,
    campaign: Campaign = "auto",
    strict_range: StrictRange = False,
    base_link: BaseLink = None,
    tip_link: TipLink = None,
    seed: Seed = 0,
    progress: Progress = None,
) -> Calibrated:
    """Fit named effects to measured poses and compute the error before and after, on fitted and on held-out poses.

    An effect with joints in brackets is fitted to these joints. Without brackets it is fitted to the joints where the
    data show it.

    Returns:
        The calibrated robot, the coefficients with their uncertainty, and the error before and after.

    Raises:
        InputError: A file or array cannot be used, the data hold a mistake, or the poses are too few.
        UsageError: An effect cannot be fitted to this robot and these data, or the arguments contradict each other.

    Example:
        >>> import robacc
        >>> result = robacc.calibrate(
        ...     "sample_data/poses.csv", robot="sample_data/robot.yaml", fit=("base_frame", "tool_frame")
        ... )
        >>> before, after = result.nominal_unregistered.fitted.position, result.after.fitted.position
        >>> print(f"{before.rms * 1e3:.2f} to {after.rms * 1e3:.2f} mm")
        1.80 to 0.47 mm
        >>> print(result.model_yaml().splitlines()[0].partition(" robacc ")[0])
        # written by
    """
    arguments = locals()
    inputs = load_fit_inputs(poses, robot, holdout, ordered, ignore_limits, base_link, tip_link, campaign, strict_range)
    baseline = requested(fit, Arm.of(inputs.robot), inputs.data)
    requests = parse_requests(",".join(baseline.names))
    if not requests:
        raise UsageError("`fit` names no effect; try base_frame,tool_frame,joint_offset,link_geometry")
    inputs.require_targets([request.name for request in requests])
    priors = tolerance_priors(inputs.robot) if prior else {}
    if prior and not priors:
        raise UsageError(f"`prior` needs tolerances, but {path_of(robot) or inputs.robot.name} has none on any joint")
    calibration = fit_effects(
        inputs.robot,
        inputs.data,
        requests,
        options=Options(robust=robust),
        priors=priors,
        shrink=shrink,
        n_folds=folds,
        seed=seed,
        holdout=inputs.holdout,
        progress=progress or (lambda label, done, total: None),
    )
    options = options_of(
        calibrate, arguments, **inputs.names, fit=",".join(baseline.names) if fit is None else joined(fit)
    )
    made = Provenance(options, inputs.files, seed, inputs.use)
    return Calibrated(**with_inputs(calibration, inputs), baseline=baseline, made=made)
