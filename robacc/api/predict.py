"""Call of the command ``robacc predict``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, ClassVar

import numpy as np

from robacc.accuracy.grade import default_scale
from robacc.api.inputs import (
    STDIN,
    fitted_pose_warnings,
    load_grade_scale,
    load_poses,
    load_robot,
    load_text,
    optional,
    path_of,
)
from robacc.api.parameters import (
    BaseLink,
    Campaign,
    Confidence,
    Help,
    IgnoreLimits,
    Ordered,
    PosesSource,
    RobotArgument,
    Samples,
    Scale,
    Seed,
    StrictRange,
    StrPath,
    TipLink,
    call,
)
from robacc.api.result import Provenance, Result, effect_names, fields_of, options_of, use_model
from robacc.documents.envelope import csv_text
from robacc.documents.expected import prediction_charts, prediction_csv, prediction_document
from robacc.errors import UsageError
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.prediction import DEFAULT_SAMPLES
from robacc.prediction.comparison import MeasuredComparison, Noise, compare_with_measured
from robacc.prediction.model_fit import model_fit
from robacc.prediction.model_uncertainty import Coverage, calibrated_accuracy, coverage
from robacc.prediction.predicting import (
    NORMAL,
    Allocation,
    Prediction,
    configurations_of,
    parse_tolerances,
    predict_accuracy,
    sampled_configurations,
    step_limits,
    uncertain_parameters,
    warranty_map,
)
from robacc.prediction.predicting import allocate as allocate_tolerances
from robacc.quantities import optional_size, size
from robacc.robots.arm import build_chain
from robacc.robots.description import Robot


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Predicted(Result, Prediction):
    """Predicted accuracy, with the inputs."""

    command: ClassVar[str] = "predict"
    robot: Robot
    """Robot as its file describes it."""
    allocation: Allocation | None
    """Tolerances that would reach the requested grade."""
    comparison: MeasuredComparison | None
    """Comparison of the prediction with measured poses."""
    coverage: tuple[Coverage, ...]
    """Measured poses within the bounds of a model file; empty for predictions from tolerances."""
    planned: Measurements | None
    """Poses given for the prediction."""
    measured: Measurements | None
    """Measured poses that the prediction is compared with."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings of the poses read, of poses that the robot was fitted to, and of the comparison."""
        fit, against = model_fit(self.robot), [file for file in self.made.inputs if file.kind == "against"]
        hint = None if self.comparison is None else self.comparison.hint
        return (
            *(warning for data in (self.planned, self.measured) if data is not None for warning in data.warnings),
            *fitted_pose_warnings(self.robot, against),
            *(() if self.made.use is None else self.made.use.warnings),
            *(() if fit is None else fit.warnings),
            *(() if hint is None else (hint,)),
        )

    def payload(self) -> dict[str, Any]:
        """Return the result's own keys; arrays stay arrays."""
        own = prediction_document(self, self.allocation, self.comparison, self.coverage)
        return {**own, **prediction_charts(self, self.robot)}

    def per_pose_csv(self) -> str:
        """Return a CSV with one row a configuration: joint variables and the prediction (m, rad, tool frame)."""
        return prediction_csv(self, self.robot.variable_names)

    def map_csv(self, voxel: str | float = "100mm") -> str:
        """Return a CSV with a row for each voxel of the workspace: its errors, and the grade that it holds.

        Args:
            voxel: Edge of a voxel, m or text such as ``"100mm"``.

        Raises:
            UsageError: The edge is no length above zero.
        """
        edge = size(voxel, "length", "`voxel`")
        if edge <= 0:
            raise UsageError("`voxel`: expected a length above zero")
        poses = build_chain(self.robot).poses(self.configurations.scalars, self.configurations.n)
        voxels = warranty_map(self, poses.translation, edge)
        columns = dict(zip(("x_m", "y_m", "z_m"), voxels.centre, strict=True)) | {"configurations": voxels.count}
        for unit, rms, bound in zip(("m", "rad"), voxels.rms, voxels.bound, strict=True):
            columns |= {f"rms_{unit}": rms, f"bound95_{unit}": bound}
        return csv_text({**columns, "grade": voxels.grades})


@call
def predict(
    robot: RobotArgument,
    *,
    poses: Annotated[
        PosesSource | Array | None,
        Help(
            "CSV of poses; the prediction is for their joints.",
            "FILE",
            "Or poses read before, or joint variables ``(J, N)``, rad or m.",
            holds="measured poses",
        ),
    ] = None,
    samples: Samples = None,
    target: Annotated[
        str | None, Help("Target of the sampled configurations, for a robot with several.", "NAME")
    ] = None,
    tolerances: Annotated[
        StrPath | None, Help("Tolerance file (YAML); overrides the tolerances of the robot file.", "FILE")
    ] = None,
    scale: Scale = None,
    allocate: Annotated[str | None, Help("Grade to find tolerances for.", "GRADE")] = None,
    against: Annotated[
        PosesSource | None,
        Help("CSV of measured poses to compare the prediction with.", "FILE", holds="measured poses"),
    ] = None,
    align: Annotated[
        str | Sequence[str],
        Help("Frames to fit to the poses of `against` first: base_frame, tool_frame or both.", "FRAME,…"),
    ] = (),
    noise: Annotated[
        str | Noise | None,
        Help(
            "Standard deviation of the measurement noise along and about an axis, such as 0.02mm,0.01deg.",
            "P[,R]",
            "Or ``(m, rad)``.",
        ),
    ] = None,
    confidence: Confidence = 0.95,
    ordered: Ordered = False,
    ignore_limits: IgnoreLimits = False,
    campaign: Campaign = "auto",
    strict_range: StrictRange = False,
    base_link: BaseLink = None,
    tip_link: TipLink = None,
    seed: Seed = 0,
) -> Predicted:
    """Covariances, error budget and grade predicted from parameter tolerances, or from the fit of a model file.

    The prediction is for the joints of ``poses``, else of ``against``, else for configurations over the joint ranges.
    For a model file that ``write_model`` wrote, it is that of the calibrated arm: uncertainty of the coefficients,
    repeatability and unexplained error. With ``tolerances``, it is that of arms made with these tolerances.

    Returns:
        The predicted covariances (m, rad), the budget and the grade, with the allocation and the comparison.

    Raises:
        InputError: A file or array cannot be used; with every problem.
        UsageError: The arguments contradict each other or do not fit the robot.

    Example:
        >>> import robacc
        >>> result = robacc.predict("configs/robots/puma560.yaml", samples=200)
        >>> print(f"{result.position.rms * 1e3:.2f} mm rms; largest contribution: {result.budget[0].name}")
        0.37 mm rms; largest contribution: j1.d
    """
    arguments = locals()
    if poses is not None and samples is not None:
        raise UsageError("`poses` and `samples` both say where to predict; give only one of them")
    if against is not None and samples is not None:
        raise UsageError("`against` predicts at the measured poses; leave out `samples`")
    for name, value in (("align", align or None), ("noise", noise)):
        if value is not None and against is None:
            raise UsageError(f"`{name}` applies to measured poses, so it needs `against`")
    if target is not None and (poses is not None or against is not None):
        raise UsageError("`target` applies to sampled configurations; poses name their targets in a column target")
    if path_of(poses) == path_of(against) == STDIN:
        raise UsageError("standard input can be read only once: give - to `poses` or to `against`")
    noise_std = _noise(noise)
    if isinstance(poses, np.ndarray):
        poses = Measurements(position=np.zeros((3, poses.shape[-1])), q=poses.copy())
    arm, arm_record = load_robot(robot, base_link, tip_link, poses if against is None else against)
    read_tolerances, tolerance_record = optional(
        load_text, tolerances, "tolerances", lambda text, name: parse_tolerances(text, name, arm)
    )
    grades, scale_record = load_grade_scale(scale)
    grades = grades or default_scale()
    if allocate is not None:
        step_limits(grades, allocate)  # raises for an unknown grade before poses are read
    # A tolerance file describes arms that are made, the record of a fit this calibrated arm.
    fit = model_fit(arm) if tolerances is None and allocate is None else None
    toleranced, meaning = read_tolerances or (arm, NORMAL)
    parameters = uncertain_parameters(toleranced) if fit is None else ()
    reading = {"ordered": ordered, "ignore_limits": ignore_limits}
    # A prediction needs joints only; poses to compare with are measured.
    planned, planned_record = optional(load_poses, poses, arm, attained=False, **reading)
    measured, measured_record = optional(load_poses, against, arm, kind="against", **reading)
    used, used_record = (planned, planned_record) if measured is None else (measured, measured_record)
    is_measured = measured is not None
    use = use_model(arm, used, used_record, campaign=campaign, strict_range=strict_range, measured=is_measured)
    arm = use.robot or arm
    predicted = planned or measured
    if predicted is not None:
        configurations = configurations_of(arm, predicted)
    else:
        configurations = sampled_configurations(arm, DEFAULT_SAMPLES if samples is None else samples, seed, target)
    if fit is None:
        prediction = predict_accuracy(arm, parameters, configurations, grades, meaning)
    else:
        prediction = calibrated_accuracy(arm, fit, configurations, predicted, grades, seed)
    aligned = effect_names(align)
    comparison: MeasuredComparison | None = None
    covered: tuple[Coverage, ...] = ()
    if fit is not None and measured is not None:
        covered = coverage(arm, fit, measured, seed, aligned, noise_std)
    elif measured is not None:
        comparison = compare_with_measured(
            arm, measured, parameters, align=aligned, noise=noise_std, confidence=confidence, seed=seed
        )
    options = options_of(
        predict,
        arguments,
        samples=configurations.n if predicted is None else None,
        align=list(aligned),
        noise=list(noise) if isinstance(noise, tuple) else noise,
    )
    inputs = (arm_record, *tolerance_record, *scale_record, *planned_record, *measured_record)
    return Predicted(
        **fields_of(prediction),
        robot=arm,
        allocation=None if allocate is None else allocate_tolerances(arm, prediction, allocate),
        comparison=comparison,
        coverage=covered,
        planned=planned,
        measured=measured,
        made=Provenance(options, inputs, seed, use),
    )


def _noise(noise: str | Noise | None) -> Noise:
    """Return the standard deviations of position (m) and orientation (rad).

    Raises:
        UsageError: ``noise`` is not one or two sizes of at least zero.
    """
    sizes = noise.split(",") if isinstance(noise, str) else noise or ()
    if len(sizes) > 2:
        raise UsageError(f"`noise`: expected a length and perhaps an angle, as in 0.02mm,0.01deg, found {noise!r}")
    position, rotation = (*sizes, None, None)[:2]
    return optional_size(position, "length", "`noise`"), optional_size(rotation, "angle", "`noise`")
