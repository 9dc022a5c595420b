"""Call of the command ``robacc iso9283``."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

from robacc.api.inputs import (
    STDIN,
    fitted_pose_warnings,
    load_optional_robot,
    load_poses,
    path_of,
)
from robacc.api.parameters import (
    BaseLink,
    Campaign,
    Confidence,
    Help,
    IgnoreLimits,
    OptionalRobot,
    Ordered,
    Seed,
    StrictRange,
    TipLink,
    call,
)
from robacc.api.result import Provenance, Result, effect_names, fields_of, options_of, use_model
from robacc.errors import UsageError
from robacc.iso_9283.evaluation import iso9283 as evaluate_criteria
from robacc.iso_9283.visits import Iso9283Result

if TYPE_CHECKING:
    from robacc.api.parameters import PosesSource


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Iso9283(Result, Iso9283Result):
    """Pose criteria of ISO 9283, with the inputs."""

    command: ClassVar[str] = "iso9283"
    made: Provenance

    def payload(self) -> dict[str, Any]:
        """Return the result's own keys; arrays stay arrays."""
        from robacc.documents.accuracy import ISO9283

        return ISO9283.write(self)


@call
def iso9283(
    *poses: Annotated[
        PosesSource,
        Help(
            "Measured poses: CSV, export, workbook, Parquet or ROS bag, one per robot; - reads standard input.",
            "POSES [POSES …]",
            "Or poses read before.",
            holds="measured poses",
        ),
    ],
    robot: OptionalRobot = None,
    align: Annotated[
        str | Sequence[str],
        Help(
            "Frames to fit to the poses of each file first: base_frame, tool_frame, both, or none.",
            "FRAME,…",
            "They are frames of `robot`, or without `robot` of the commanded poses.",
        ),
    ] = (),
    rated_load: Annotated[float | None, Help("Rated load of the robot, compared with payload_kg.", "KG")] = None,
    drift_windows: Annotated[
        int | None, Help("Number of windows of the run for drift; default: windows of ten visits.", "N")
    ] = None,
    confidence: Confidence = 0.95,
    ordered: Ordered = False,
    ignore_limits: IgnoreLimits = False,
    campaign: Campaign = "auto",
    strict_range: StrictRange = False,
    base_link: BaseLink = None,
    tip_link: TipLink = None,
    seed: Seed = 0,
) -> Iso9283:
    """Compute the pose criteria of ISO 9283 from cycles of commanded poses, and check the standard's conditions.

    With ``robot``, the commanded pose is the robot's pose at the commanded joints; without, the commanded pose of the
    file or the arrays. If neither is known, the result has repeatability but no accuracy.

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
    return Iso9283(**fields_of(body), made=Provenance(options, (*records, *arm_record), seed, use))
