"""Use of a model on poses: the campaign's effects that apply to them, and the poses outside its validity ranges."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

from robacc.documents.envelope import InputFile
from robacc.errors import UsageError
from robacc.measurements import Measurements
from robacc.modelling.campaign import resolve_campaign
from robacc.modelling.validity import OutsideValidity, outside_validity
from robacc.robots.description import Robot

CampaignUse = Literal["auto", "keep", "drop"]


@dataclass(frozen=True, slots=True)
class ModelUse:
    """A robot as it applies to some poses."""

    robot: Robot | None
    """The robot, with the effects of its campaign if they apply."""
    outside: OutsideValidity | None
    """Poses outside the validity ranges; None if the model has none."""
    warnings: tuple[str, ...]

    def document(self) -> dict[str, Any]:
        """Return the key ``outside_validity`` of a result; nothing without a robot."""
        from robacc.documents.validity import outside_document

        return {} if self.robot is None else {"outside_validity": outside_document(self.outside)}


def use_model(
    robot: Robot | None,
    data: Measurements | None,
    records: Sequence[InputFile] = (),
    *,
    campaign: CampaignUse = "auto",
    strict_range: bool = False,
    measured: bool = True,
) -> ModelUse:
    """Return the robot with what applies to ``data``.

    Args:
        robot: Robot as read; None gives an empty result.
        data: The poses; None if there are none, as for configurations over the joint ranges.
        records: Records of the files of the poses, with their digests.
        campaign: ``keep`` or ``drop`` the facts of the campaign that the model was fitted in; ``auto`` keeps its
            effects for its own poses, and for measured poses that agree better with them than without.
        strict_range: Refuse poses outside the validity ranges.
        measured: The positions of ``data`` were measured.

    Raises:
        InputError: ``strict_range``, and a pose is outside.
        UsageError: ``campaign`` is none of the three.
    """
    if campaign not in ("auto", "keep", "drop"):
        raise UsageError(f"`campaign`: expected auto, keep or drop, found {campaign!r}")
    if robot is None:
        return ModelUse(None, None, ())
    digests = [record.sha256 for record in records]
    robot, notes = resolve_campaign(robot, data if measured else None, digests, campaign)
    outside = None if data is None else outside_validity(robot, data)
    if outside is not None and data is not None:
        if strict_range:
            outside.refuse(data)
        notes = (*notes, *outside.warnings())
    return ModelUse(robot, outside, notes)
