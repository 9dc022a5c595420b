"""Call of ``robacc compare --paired``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from robacc.api.inputs import PosesSource, StrPath, load_poses, load_robot
from robacc.api.result import Provenance, Result, fields_of, options_of
from robacc.comparison.paired_targets import PairedTargets, paired_targets
from robacc.comparison.promise import noise_doubts, promise_of
from robacc.comparison.shared_targets import shared_targets
from robacc.prediction.model_fit import model_fit
from robacc.robots.description import Robot
from robacc.threads import single_threaded


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class ComparedTargets(Result, PairedTargets):
    """The same targets before and after a correction, with the inputs."""

    command: ClassVar[str] = "compare-paired"
    doubts: tuple[str, ...]
    made: Provenance

    @property
    def warnings(self) -> tuple[str, ...]:
        """Warnings of the poses read, and a correction that is not loaded."""
        if self.loaded.verdict == "not loaded":
            return (*self.doubts, "no sign that the correction was loaded: the targets are where they were before")
        return self.doubts

    def payload(self) -> dict[str, Any]:
        """Return the result's own keys; arrays stay arrays."""
        from robacc.documents.compare_paired import payload

        return payload(self)


@single_threaded
def compare_paired(
    before: PosesSource,
    after: PosesSource,
    *,
    model: StrPath | Robot | None = None,
    nominal: StrPath | Robot | None = None,
    noise: str | float | None = None,
) -> ComparedTargets:
    """Compare the same targets, measured before and after a correction.

    Rows belong together by their ``pose``, or by their order where both files have no such column. Wanted poses are the
    ``cmd_`` columns of ``after``, as ``correct`` writes them, else of ``before``, else the poses of the nominal robot
    at the joints of ``before``.

    Args:
        before: Poses measured without the correction.
        after: Poses measured with the correction.
        model: Model of the correction, to test whether the remaining error agrees with its prediction.
        nominal: Robot file that the controller computes with; only for files without ``cmd_`` columns.
        noise: Standard deviation of the measurement noise along each axis, m or text; None for that of ``after``, else
            of the model's fit. Where the unexplained error of the model contains the noise of its own measurements, it
            is only the lower bound of that error, with a warning.

    Returns:
        The gain with its interval, the remaining error, whether the correction was loaded, and whether the remaining
            error agrees with the model.

    Raises:
        InputError: A file cannot be used, or the files share fewer than three targets.
        UsageError: The arguments contradict each other.

    Example:
        >>> import dataclasses, robacc
        >>> robot, model = "sample_data/trace/robot.yaml", "sample_data/trace/truth.yaml"
        >>> targets = robacc.simulate(robot, poses=20, seed=1).data
        >>> planned = robacc.correct(targets, model=model, nominal=robot).targets
        >>> old = dataclasses.replace(targets, commanded_position=planned.wanted.poses.translation)
        >>> new = dataclasses.replace(old, q=planned.q)
        >>> before = robacc.simulate(model, at=old, noise="0.02mm", seed=2).data
        >>> after = robacc.simulate(model, at=new, noise="0.02mm", seed=3).data
        >>> result = robacc.compare_paired(before, after)
        >>> result.loaded.verdict, result.metrics_after.rms < 0.1 * result.metrics_before.rms
        ('loaded', True)
    """
    arguments = locals()
    arm, arm_records = (None, ()) if model is None else _with_records(load_robot(model))
    controller, nominal_records = (None, ()) if nominal is None else _with_records(load_robot(nominal))
    first, first_record = load_poses(before, controller or arm, kind="before")
    second, second_record = load_poses(after, controller or arm, kind="after")
    targets = shared_targets(first, second)
    wanted = targets.wanted(controller)
    doubts = [*first.warnings, *second.warnings]
    if first.commanded_position is None and second.commanded_position is None:
        doubts.append(
            "neither file has wanted poses (cmd_ columns), so those of the nominal robot at the joints of `before` "
            "count; errors of base and tool frames are part of the figures"
        )
    promise = None
    if arm is not None:
        promise = promise_of(arm, targets, noise)
        doubts += noise_doubts(promise.noise)
        fit = model_fit(arm)
        doubts += () if fit is None else fit.warnings
    measured_before, measured_after = (file.means(file.data.position) for file in (targets.before, targets.after))
    body = paired_targets(targets.names, measured_before, measured_after, wanted, promise)
    options = options_of(compare_paired, arguments, model=None, nominal=None)
    options = {"noise": options["noise"]}
    records = (first_record, second_record, *arm_records, *nominal_records)
    return ComparedTargets(
        **fields_of(body),
        doubts=tuple(doubts),
        made=Provenance(options, records, None),
    )


def _with_records(loaded: tuple[Robot, Any]) -> tuple[Robot, tuple[Any, ...]]:
    return loaded[0], (loaded[1],)
