"""Call of the command ``robacc calibrate``."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from robacc.api.fitting import FitInputs, FitResult, joined, load_fit_inputs, with_inputs
from robacc.api.inputs import PosesSource, StrPath, path_of
from robacc.api.result import CampaignUse, Provenance, check_range, options_of
from robacc.calibration.calibrating import Calibration
from robacc.calibration.calibrating import calibrate as fit_effects
from robacc.effects.request import parse_requests
from robacc.errors import UsageError
from robacc.fitting.fit_result import Options
from robacc.fitting.priors import tolerance_priors
from robacc.robots.description import Robot
from robacc.threads import single_threaded


@dataclass(frozen=True, kw_only=True, repr=False)
class Calibrated(FitResult, Calibration):
    """Calibrated robot and its errors, with the inputs."""

    command: ClassVar[str] = "calibrate"
    fit_inputs: FitInputs
    made: Provenance

    def payload(self) -> dict[str, Any]:
        """Return the result's own keys; arrays stay arrays."""
        from robacc.documents.fit import calibration_payload

        inputs = self.fit_inputs
        return calibration_payload(self, inputs.data, inputs.robot, inputs.holdout, self.made.seed or 0)


@single_threaded
def calibrate(
    poses: PosesSource,
    *,
    robot: StrPath | Robot,
    fit: str | Sequence[str],
    prior: bool = False,
    shrink: bool = True,
    robust: bool = True,
    folds: int | None = None,
    holdout: PosesSource | None = None,
    ordered: bool = False,
    ignore_limits: bool = False,
    campaign: CampaignUse = "auto",
    strict_range: bool = False,
    base_link: str | None = None,
    tip_link: str | None = None,
    seed: int = 0,
    progress: Callable[[str, int, int], None] | None = None,
) -> Calibrated:
    """Fit named effects to measured poses and compute the error before and after, on fitted and on held-out poses.

    An effect with joints in brackets is fitted to these joints. Without brackets it is fitted to the joints where the
    data show it.

    Args:
        poses: CSV of measured poses (``-`` is standard input), or poses read before or made of arrays.
        robot: Robot file (YAML) or URDF that commanded the poses, or a robot read before.
        fit: Effects to fit, such as ``("base_frame", "joint_offset[j2,j3]", "gear_ratio[all]")``.
        prior: Use the tolerances of the robot file as priors of its geometry.
        shrink: Shrink ``joint_offset`` and ``link_geometry``, if named without brackets, to the nominal values where
            the data show no difference.
        robust: Leave out outliers and list them; else all rows are fitted.
        folds: Number of parts of the poses that are held out in turn; by default each pose in turn, with its repeats
            and the poses close to it.
        holdout: Separate validation poses, in place of held-out poses of the file.
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
    if folds is not None:
        check_range("folds", folds, 2, 50)
    check_range("seed", seed, 0)
    inputs = load_fit_inputs(poses, robot, holdout, ordered, ignore_limits, base_link, tip_link, campaign, strict_range)
    requests = parse_requests(joined(fit))
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
    options = options_of(calibrate, arguments, **inputs.names, fit=joined(fit))
    made = Provenance(options, inputs.files, seed, inputs.use)
    return Calibrated(**with_inputs(calibration, inputs), made=made)
