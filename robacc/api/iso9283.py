"""Call of the command ``robacc iso9283``."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from robacc.api.inputs import (
    STDIN,
    PosesSource,
    StrPath,
    fitted_pose_warnings,
    load_optional_robot,
    load_poses,
    path_of,
)
from robacc.api.result import (
    CampaignUse,
    Provenance,
    Result,
    check_range,
    effect_names,
    fields_of,
    options_of,
    use_model,
)
from robacc.errors import UsageError
from robacc.iso_9283.evaluation import iso9283 as evaluate_criteria
from robacc.iso_9283.records import Iso9283Result
from robacc.robots.description import Robot
from robacc.threads import single_threaded


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Iso9283(Result, Iso9283Result):
    """Pose criteria of ISO 9283, with the inputs."""

    command: ClassVar[str] = "iso9283"
    made: Provenance

    @classmethod
    def of(cls, body: Iso9283Result, made: Provenance) -> Iso9283:
        """Return ``body`` with its inputs."""
        return cls(**fields_of(body), made=made)

    def payload(self) -> dict[str, Any]:
        """Return the result's own keys; arrays stay arrays."""
        from robacc.documents.iso9283 import ISO9283

        return ISO9283.write(self)


@single_threaded
def iso9283(
    *poses: PosesSource,
    robot: StrPath | Robot | None = None,
    align: str | Sequence[str] = (),
    rated_load: float | None = None,
    drift_windows: int | None = None,
    confidence: float = 0.95,
    ordered: bool = False,
    ignore_limits: bool = False,
    campaign: CampaignUse = "auto",
    strict_range: bool = False,
    base_link: str | None = None,
    tip_link: str | None = None,
    seed: int = 0,
) -> Iso9283:
    """Compute the pose criteria of ISO 9283 from cycles of commanded poses, and check the standard's conditions.

    With ``robot``, the commanded pose is the robot's pose at the commanded joints; without, the commanded pose of the
    file or the arrays. If neither is known, the result has repeatability but no accuracy.

    Args:
        poses: CSV of measured poses (``-`` is standard input), or poses read before; one file or object for each robot.
        robot: Robot file (YAML), URDF, or a robot read before.
        align: Frames that are fitted to the poses of each file first: ``base_frame``, ``tool_frame`` or both; of the
            robot, or without ``robot`` of the commanded poses.
        rated_load: Rated load, kg, which the payload of the poses is compared with.
        drift_windows: Number of windows of the run for drift; None for windows of ten visits.
        confidence: Confidence level of every interval.
        ordered: The rows of the files are in the order measured; directions and speeds are derived from it.
        ignore_limits: Joint values outside the limits are a warning; by default they are an error where they exceed a
            limit by more than 0.05 degree or 0.5 mm.
        campaign: Use of the facts of the campaign that a model was fitted in, such as a drift: ``keep``, ``drop``, or
            ``auto`` for its own poses and for measured poses that agree better with them.
        strict_range: Refuse poses outside the validity range of the model.
        base_link: First link of the chain in a URDF.
        tip_link: Last link of the chain in a URDF.
        seed: Seed of the bootstrap.

    Returns:
        Every criterion (m, rad) with its interval, or the reason for its absence, and the conditions of the protocol.

    Raises:
        InputError: A file or array cannot be used; with every problem.
        UsageError: The arguments contradict each other or do not fit the data.

    Example:
        >>> import robacc
        >>> result = robacc.iso9283("sample_data/iso9283/poses.csv", robot="sample_data/iso9283/robot.yaml")
        >>> print(f"RP {result.characteristic('RP').position.value * 1e6:.0f} um")
        RP 74 um
    """
    arguments = locals()
    check_range("seed", seed, 0)
    if [path_of(source) for source in poses].count(STDIN) > 1:
        raise UsageError("standard input can be read only once, but - is given more than once")
    arm, arm_record = load_optional_robot(robot, base_link, tip_link, next(iter(poses), None))
    loaded = [load_poses(source, arm, ordered=ordered, ignore_limits=ignore_limits) for source in poses]
    records = [record for _, record in loaded]
    uses = [use_model(arm, data, (r,), campaign=campaign, strict_range=strict_range) for data, r in loaded]
    use = uses[0] if uses else use_model(arm, None, campaign=campaign)
    arm = use.robot
    aligned = effect_names(align)
    body = evaluate_criteria(
        [data for data, _ in loaded],
        arm,
        align=aligned,
        confidence=confidence,
        seed=seed,
        windows=drift_windows,
        rated_load=rated_load,
    )
    use_warnings = [warning for item in uses for warning in item.warnings]
    body = dataclasses.replace(body, warnings=(*body.warnings, *fitted_pose_warnings(arm, records), *use_warnings))
    options = options_of(iso9283, arguments, align=list(aligned))
    return Iso9283.of(body, Provenance(options, (*records, *arm_record), seed, use))
