"""The call behind ``robacc predict``."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from robacc.accuracy.grade_scale import default_scale
from robacc.api.fitted_to import met_again
from robacc.api.inputs import STDIN, StrPath, needed_robot_of, path_of, poses_of, scale_of
from robacc.api.result import Made, Result, names, parts, within
from robacc.documents.envelope import InputFile
from robacc.errors import UsageError
from robacc.geometry import Array
from robacc.measurements import Measurements
from robacc.prediction import DEFAULT_SAMPLES
from robacc.prediction.allocation import Allocation
from robacc.prediction.allocation import allocate as allocated
from robacc.prediction.comparison import MeasuredComparison, Noise, compare_with_measured
from robacc.prediction.configurations import Configurations, configurations_of, sampled_configurations
from robacc.prediction.parameters import NORMAL, uncertain_parameters
from robacc.prediction.predicting import Prediction, predict_accuracy, step_limits
from robacc.quantities import size
from robacc.robots.description import Robot

if TYPE_CHECKING:
    from robacc.prediction.parameters import Tolerances


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Predicted(Result, Prediction):
    """The accuracy to be expected, with what it was computed from."""

    command: ClassVar[str] = "predict"
    robot: Robot
    """As its file describes it."""
    allocation: Allocation | None
    """Tolerances that would reach the grade that was asked for."""
    comparison: MeasuredComparison | None
    """What measured poses say of the prediction."""
    planned: Measurements | None
    """The poses predicted at, where they were given."""
    measured: Measurements | None
    """The measured poses that the prediction is held against."""
    made: Made

    @property
    def warnings(self) -> tuple[str, ...]:
        """What looks wrong."""
        found = [warning for data in (self.planned, self.measured) if data is not None for warning in data.warnings]
        hint = None if self.comparison is None else self.comparison.hint
        found.extend(met_again(self.robot, [one for one in self.made.inputs if one.kind == "against"]))
        return tuple(found) if hint is None else (*found, hint)

    def payload(self) -> dict[str, Any]:
        """The result's own keys; arrays stay arrays."""
        from robacc.documents.predict import payload, pose_payload

        return {**payload(self, self.allocation, self.comparison), **pose_payload(self, self.robot)}

    def per_pose_csv(self) -> str:
        """A row a pose: where, its joint variables, and what is predicted there (m, rad, tool frame)."""
        from robacc.documents.predict import per_pose_csv

        return per_pose_csv(self, self.robot.variable_names)


def predict(
    robot: StrPath | Robot,
    *,
    poses: StrPath | Measurements | Array | None = None,
    samples: int | None = None,
    target: str | None = None,
    tolerances: StrPath | None = None,
    scale: StrPath | None = None,
    allocate: str | None = None,
    against: StrPath | Measurements | None = None,
    align: str | Sequence[str] = (),
    noise: str | Noise | None = None,
    confidence: float = 0.95,
    ordered: bool = False,
    base_link: str | None = None,
    tip_link: str | None = None,
    seed: int = 0,
) -> Predicted:
    """Covariances, error budget and grade to be expected from parameter tolerances.

    At ``poses``, else at those of ``against``, else at configurations spread over the joint ranges.

    Args:
        robot: Robot file (YAML), URDF, or a robot that was read before.
        poses: CSV of poses whose joints to predict at, poses read before, or joint variables ``(J, N)``, rad or m.
        samples: Configurations over the joint ranges; None is 1000.
        target: Of several targets, the one that samples are of.
        tolerances: Tolerances (YAML) that go before the robot's.
        scale: Grade scale (YAML); None is the package's own.
        allocate: Find tolerances that would reach this grade.
        against: Measured poses to hold the prediction against.
        align: ``base_frame``, ``tool_frame`` or both are fitted to ``against`` first.
        noise: Measuring noise along and about an axis, one standard deviation: ``"0.02mm,0.01deg"``, or ``(m, rad)``.
        confidence: Of every interval.
        ordered: The rows of the files are in the order measured.
        base_link: URDF: the link that the chain starts at.
        tip_link: URDF: the link that it ends at.
        seed: Of everything drawn at random.

    Returns:
        The predicted covariances (m, rad), the budget and the grade; what was allocated and compared.

    Raises:
        InputError: A file or array cannot be used; with every problem found.
        UsageError: The call does not fit the robot, or itself.

    Example:
        >>> import robacc
        >>> found = robacc.predict("configs/robots/puma560.yaml", samples=200)
        >>> print(f"{found.position.rms * 1e3:.2f} mm rms; most of it by {found.budget[0].name}")
        0.37 mm rms; most of it by j1.d
    """
    within("seed", seed, 0)
    _check(poses, samples, against, align, noise, target)
    sigma = _noise(noise)
    arm, arm_record = needed_robot_of(robot, base_link, tip_link)
    given, tolerance_record = _tolerances(tolerances, arm)
    grades, scale_record = scale_of(scale)
    grades = grades or default_scale()
    if allocate is not None:
        step_limits(grades, allocate)  # before anything is read or computed in vain
    parameters = uncertain_parameters(arm, given)
    planned, planned_record = _poses(poses, arm, ordered, "poses")
    measured, measured_record = _poses(against, arm, ordered, "against")
    where = _configurations(arm, planned or measured, samples, seed, target)
    found = predict_accuracy(arm, parameters, where, grades, NORMAL if given is None else given.meaning)
    needed = None if allocate is None else allocated(arm, found, allocate)
    what = names(align)
    compared = None
    if measured is not None:
        compared = compare_with_measured(
            arm, measured, parameters, what=what, noise=sigma, confidence=confidence, seed=seed
        )
    options = {
        "samples": where.n if planned is None and measured is None else None,
        "target": target,
        "allocate": allocate,
        "align": list(what),
        "noise": list(noise) if isinstance(noise, tuple) else noise,
        "confidence": confidence,
        "ordered": ordered,
        "base_link": base_link,
        "tip_link": tip_link,
    }
    inputs = (arm_record, *tolerance_record, *scale_record, *planned_record, *measured_record)
    return Predicted(
        **parts(found),
        robot=arm,
        allocation=needed,
        comparison=compared,
        planned=planned,
        measured=measured,
        made=Made(options, inputs, seed),
    )


def _check(
    poses: StrPath | Measurements | Array | None,
    samples: int | None,
    against: StrPath | Measurements | None,
    align: str | Sequence[str],
    noise: str | Noise | None,
    target: str | None,
) -> None:
    if poses is not None and samples is not None:
        raise UsageError("`poses` and `samples` both say where to predict; give only one of them")
    if against is not None and samples is not None:
        raise UsageError("`against` predicts at the measured poses; leave out `samples`")
    if against is None:
        for name, value in (("align", align or None), ("noise", noise)):
            if value is not None:
                raise UsageError(f"`{name}` applies to measured poses, so it needs `against`")
    if target is not None and (poses is not None or against is not None):
        raise UsageError("`target` applies to sampled configurations; poses name their targets in a column target")
    if path_of(poses) == path_of(against) == STDIN:
        raise UsageError("standard input can be read only once: give - to `poses` or to `against`")


def _noise(noise: str | Noise | None) -> Noise:
    """Position (m) and orientation (rad) of ``noise``.

    Raises:
        UsageError: it is not one or two sizes above zero.
    """
    if noise is None:
        return None, None
    sizes = noise.split(",") if isinstance(noise, str) else noise
    if len(sizes) > 2:
        raise UsageError(f"`noise`: expected a length and perhaps an angle, as in 0.02mm,0.01deg, found {noise!r}")
    position, rotation = (*sizes, None)[:2]
    return (
        None if position is None else size(position, "length", "`noise`"),
        None if rotation is None else size(rotation, "angle", "`noise`"),
    )


def _tolerances(path: StrPath | None, arm: Robot) -> tuple[Tolerances | None, tuple[InputFile, ...]]:
    if path is None:
        return None, ()
    from robacc.io.files import read_text, sha256_of
    from robacc.prediction.tolerance_file import parse_tolerances

    name = os.fspath(path)
    return parse_tolerances(read_text(name), name, arm), (InputFile.at(name, sha256_of(name), "tolerances"),)


def _poses(
    source: StrPath | Measurements | Array | None, arm: Robot, ordered: bool, kind: str
) -> tuple[Measurements | None, tuple[InputFile, ...]]:
    if source is None:
        return None, ()
    if isinstance(source, np.ndarray):
        source = Measurements(position=np.zeros((3, source.shape[-1])), q=source.copy())
    # Where to predict needs joints alone; what it is held against was measured.
    data, record = poses_of(source, arm, ordered=ordered, kind=kind, attained=kind == "against")
    return data, (record,)


def _configurations(
    arm: Robot, data: Measurements | None, samples: int | None, seed: int, target: str | None
) -> Configurations:
    if data is not None:
        return configurations_of(arm, data)
    return sampled_configurations(arm, DEFAULT_SAMPLES if samples is None else samples, seed, target)
