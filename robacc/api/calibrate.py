"""The call behind ``robacc calibrate``."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from robacc.api.fitted_to import fitted_to, met_again
from robacc.api.fitting import Fitted, Given, given, listed
from robacc.api.inputs import StrPath, path_of
from robacc.api.result import Made, parts, within
from robacc.calibration import Calibration, tolerance_priors
from robacc.calibration import calibrate as fit_effects
from robacc.effects.request import parse_requests
from robacc.errors import UsageError
from robacc.fitting.solver import Options
from robacc.measurements import Measurements
from robacc.robots.description import Robot


@dataclass(frozen=True, kw_only=True, repr=False)
class Calibrated(Fitted, Calibration):
    """A calibrated robot and how well it predicts, with what it was computed from."""

    command: ClassVar[str] = "calibrate"
    given: Given
    made: Made

    def payload(self) -> dict[str, Any]:
        """The result's own keys; arrays stay arrays."""
        from robacc.documents.fit import calibration_payload

        return calibration_payload(self, self.given.data, self.given.robot, self.given.apart, self.made.seed or 0)


def calibrate(
    poses: StrPath | Measurements,
    *,
    robot: StrPath | Robot,
    fit: str | Sequence[str],
    prior: bool = False,
    shrink: bool = True,
    robust: bool = True,
    holdout: StrPath | Measurements | None = None,
    folds: int = 5,
    ordered: bool = False,
    base_link: str | None = None,
    tip_link: str | None = None,
    seed: int = 0,
    progress: Callable[[str, int, int], None] | None = None,
) -> Calibrated:
    """Fit the named effects to measured poses and say how much better the robot is predicted, fitted and held out.

    An effect of joints named without brackets is fitted on the joints where the data show it; with brackets, exactly
    there.

    Args:
        poses: CSV of measured poses (``-`` is standard input), or poses that were read before or made of arrays.
        robot: Robot file (YAML) or URDF that commanded them, or a robot that was read before.
        fit: Effects to fit, as in ``("base_frame", "joint_offset[j2,j3]", "gear_ratio[all]")``.
        prior: Use the robot file's tolerances as priors of its geometry.
        shrink: Draw ``joint_offset`` and ``link_geometry``, asked for without brackets, to the robot file's values
            where most of them do not differ.
        robust: Leave out rows that are no part of the rest, naming them.
        holdout: Poses of their own to judge on, instead of folds.
        folds: Of cross-fitting: poses held out in turn.
        ordered: The rows of the files are in the order measured.
        base_link: URDF: the link that the chain starts at.
        tip_link: URDF: the link that it ends at.
        seed: Of everything drawn at random.
        progress: Called with what is being done, how much of it is done, and of how much.

    Returns:
        The calibrated robot, the coefficients with their uncertainty, and the error before and after.

    Raises:
        InputError: A file or array cannot be used, or the data hold a mistake, or are too few.
        UsageError: An effect cannot be fitted to this robot and these data, or the call does not fit itself.

    Example:
        >>> import robacc
        >>> found = robacc.calibrate(
        ...     "sample_data/poses.csv", robot="sample_data/robot.yaml", fit=("base_frame", "tool_frame")
        ... )
        >>> print(f"{found.nominal.fitted.position.rms * 1e3:.2f} to {found.after.fitted.position.rms * 1e3:.2f} mm")
        1.80 to 0.47 mm
        >>> print(found.model_yaml().splitlines()[1])
        robacc: 1
    """
    within("folds", folds, 2, 50)
    within("seed", seed, 0)
    asked = given(poses, robot, holdout, ordered, base_link, tip_link)
    requests = parse_requests(listed(fit))
    if not requests:
        raise UsageError("`fit` names no effect; try base_frame,tool_frame,joint_offset,link_geometry")
    priors = tolerance_priors(asked.robot) if prior else {}
    if prior and not priors:
        raise UsageError(f"`prior` needs tolerances, but {path_of(robot) or asked.robot.name} has none on any joint")
    found = fit_effects(
        asked.robot,
        asked.data,
        requests,
        options=Options(robust=robust),
        priors=priors,
        shrink=shrink,
        n_folds=folds,
        seed=seed,
        holdout=asked.apart,
        progress=progress or (lambda what, done, of: None),
    )
    options = {
        "poses": asked.names["poses"],
        "robot": asked.names["robot"],
        "fit": listed(fit),
        "prior": prior,
        "shrink": shrink,
        "robust": robust,
        "folds": folds,
        "holdout": asked.names["holdout"],
        "ordered": ordered,
        "base_link": base_link,
        "tip_link": tip_link,
    }
    warnings = (*found.warnings, *met_again(asked.robot, asked.inputs))
    found = dataclasses.replace(found, robot=fitted_to(found.robot, asked.inputs), warnings=warnings)
    return Calibrated(**parts(found), given=asked, made=Made(options, asked.inputs, seed))
