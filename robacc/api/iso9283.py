"""The call behind ``robacc iso9283``."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from robacc.api.fitted_to import met_again
from robacc.api.inputs import STDIN, StrPath, path_of, poses_of, robot_of
from robacc.api.result import Made, Result, names, parts, within
from robacc.errors import UsageError
from robacc.iso_9283.evaluation import iso9283 as evaluated
from robacc.iso_9283.records import Iso9283Result
from robacc.measurements import Measurements
from robacc.robots.description import Robot


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Iso9283(Result, Iso9283Result):
    """The pose criteria of ISO 9283, with what they were computed from."""

    command: ClassVar[str] = "iso9283"
    made: Made

    def payload(self) -> dict[str, Any]:
        """The result's own keys; arrays stay arrays."""
        from robacc.documents.iso9283 import payload

        return payload(self)


def iso9283(
    *poses: StrPath | Measurements,
    robot: StrPath | Robot | None = None,
    align: str | Sequence[str] = (),
    rated_load: float | None = None,
    drift_windows: int | None = None,
    confidence: float = 0.95,
    ordered: bool = False,
    base_link: str | None = None,
    tip_link: str | None = None,
    seed: int = 0,
) -> Iso9283:
    """The pose criteria of ISO 9283 that cycles of commanded poses can support, and which of its conditions they meet.

    The commanded pose is the robot's own at the commanded joints where ``robot`` is given, else the poses' own; with
    neither there is repeatability, and no accuracy.

    Args:
        poses: CSV of measured poses (``-`` is standard input), or poses read before; several are several robots.
        robot: Robot file (YAML), URDF, or a robot that was read before.
        align: ``base_frame``, ``tool_frame`` or both are fitted to each file's poses first.
        rated_load: kg; what the poses' payload is held against.
        drift_windows: Parts of the run that are compared; None is of ten visits.
        confidence: Of every interval.
        ordered: The rows of the files are in the order measured.
        base_link: URDF: the link that the chain starts at.
        tip_link: URDF: the link that it ends at.
        seed: Of the bootstrap.

    Returns:
        Every criterion (m, rad) with its interval or the reason why there is none, and the protocol's conditions.

    Raises:
        InputError: A file or array cannot be used; with every problem found.
        UsageError: The call does not fit the data, or itself.

    Example:
        >>> import robacc
        >>> found = robacc.iso9283("sample_data/iso9283/poses.csv", robot="sample_data/iso9283/robot.yaml")
        >>> print(f"RP {found.characteristic('RP').position.value * 1e6:.0f} um")
        RP 74 um
    """
    within("seed", seed, 0)
    if [path_of(one) for one in poses].count(STDIN) > 1:
        raise UsageError("standard input can be read once: - is given more than once")
    arm, arm_record = robot_of(robot, base_link, tip_link)
    read = [poses_of(one, arm, ordered=ordered) for one in poses]
    what = names(align)
    found = evaluated(
        [data for data, _ in read],
        arm,
        what=what,
        confidence=confidence,
        seed=seed,
        windows=drift_windows,
        rated_load=rated_load,
    )
    seen = met_again(arm, [record for _, record in read])
    found = dataclasses.replace(found, warnings=(*found.warnings, *seen))
    options = {
        "align": list(what),
        "rated_load": rated_load,
        "drift_windows": drift_windows,
        "confidence": confidence,
        "ordered": ordered,
        "base_link": base_link,
        "tip_link": tip_link,
    }
    made = Made(options, (*(record for _, record in read), *arm_record), seed)
    return Iso9283(**parts(found), made=made)
