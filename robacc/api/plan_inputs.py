"""Inputs of the call ``robacc.plan``: files, places in text, and the limits of gates and grades."""

from __future__ import annotations

import dataclasses
import math
import os
from collections.abc import Mapping, Sequence
from typing import Any, cast

from robacc.api.inputs import (
    PosesSource,
    StrPath,
    load_grade_scale,
    load_poses,
    load_robot,
    pose_path,
    record_of,
    require_poses,
)
from robacc.api.result import check_choice, check_range
from robacc.diagnostics.robot_poses import joints_of
from robacc.documents.envelope import InputFile
from robacc.errors import UsageError
from robacc.measurements import Measurements
from robacc.planning.acceptance import AcceptanceStatistic, Demand
from robacc.planning.branches_at_rest import check_at_rest
from robacc.planning.campaign import PURPOSES, CampaignSettings
from robacc.planning.collisions import LinkCollisions, link_collisions
from robacc.planning.constraints import Sight, parse_distance, parse_vector
from robacc.planning.design import CRITERIA
from robacc.planning.link_shapes import read_link_shapes
from robacc.quantities import size
from robacc.robots.description import Robot

_MOST_PAYLOADS = 5
_STATISTICS = ("rms", "mean_error", "p95", "max")


def robot_to_plan_for(
    robot: StrPath | Robot, model: StrPath | Robot | None, base_link: str | None, tip_link: str | None
) -> tuple[Robot, tuple[InputFile, ...]]:
    """Return the robot to plan for: the model where there is one, after a check that it is the same arm."""
    nominal, record = load_robot(robot, base_link, tip_link)
    if model is None:
        return nominal, (record,)
    calibrated, model_record = load_robot(model)
    if calibrated.variable_names != nominal.variable_names:
        raise UsageError(
            f"`model` has the joints {', '.join(calibrated.variable_names)}, but the robot has "
            f"{', '.join(nominal.variable_names)}; give the model of this robot"
        )
    return calibrated, (record, dataclasses.replace(model_record, kind="model"))


def load_candidates(
    source: PosesSource | int | None, arm: Robot
) -> tuple[Measurements | None, int, tuple[InputFile, ...]]:
    """Return given candidates, or the number of samples."""
    default = CampaignSettings.__dataclass_fields__["n_candidates"].default
    if source is None:
        return None, cast(int, default), ()
    if isinstance(source, int):
        check_range("candidates", source, 10, 100_000)
        return None, source, ()
    data, records = load_planned_poses(source, arm, "candidates")
    return data, cast(int, default), records


def load_planned_poses(
    source: PosesSource | None, arm: Robot, kind: str
) -> tuple[Measurements | None, tuple[InputFile, ...]]:
    """Return poses that need not be measured; limits are a matter of the filters."""
    if source is None:
        return None, ()
    if isinstance(source, Measurements):
        check_at_rest(arm, source)
        return require_poses(source), (record_of(source, kind),)
    from robacc.poses.csv_file import read_poses

    path = pose_path(source)
    data = read_poses(path, robot=dataclasses.replace(joints_of(arm), limits=None), attained=False)
    check_at_rest(arm, data)
    return require_poses(data), (InputFile.at(path, data.sha256 or "", kind),)


def load_already(
    source: PosesSource | None, arm: Robot, ordered: bool
) -> tuple[Measurements | None, tuple[InputFile, ...]]:
    """Return poses measured already, and their record."""
    if source is None:
        return None, ()
    data, record = load_poses(source, arm, ordered=ordered, kind="already", attained=False)
    return data, (record,)


def load_collisions(robot: StrPath | Robot, base_link: str | None, tip_link: str | None) -> LinkCollisions:
    """Return the test for collisions of the links' shapes in a URDF.

    Raises:
        InputError: A mesh is missing or cannot be read.
        UsageError: The robot is not a URDF, has no collision geometry, or the extra ``collision`` is not installed.
    """
    arm, _ = load_robot(robot, base_link, tip_link)
    if isinstance(robot, Robot) or arm.convention != "urdf":
        raise UsageError("`collisions` needs the shapes of the links: give the URDF of the robot, and a fit as `model`")
    return link_collisions(arm, read_link_shapes(os.fspath(robot), arm))


def sight_of(
    instrument: str | Sequence[float] | None,
    reflector: str | Sequence[float] | None,
    cone: float | str,
    distance: str | Sequence[float] | None,
) -> Sight | None:
    """Return the line of sight of the instrument; None without an instrument.

    Raises:
        UsageError: The texts are no places or angles, or `instrument` is missing.
    """
    if instrument is None:
        if reflector is not None or distance is not None:
            raise UsageError("`reflector` and `distance` need `instrument`, the position of the instrument")
        return None
    near_far = (0.0, math.inf) if distance is None else parse_distance(distance, "distance")
    axis = None if reflector is None else parse_vector(reflector, "reflector")
    if axis is not None and not any(axis):
        raise UsageError("`reflector`: the direction has no length")
    return Sight(parse_vector(instrument, "instrument"), axis, size(cone, "angle", "`cone`"), near_far)


def load_demands(
    gate: StrPath | None, grade: str | None, scale: StrPath | None
) -> tuple[tuple[Demand, ...], tuple[InputFile, ...]]:
    """Return the limits on the position that the measurement is to decide."""
    demands: list[Demand] = []
    records: tuple[InputFile, ...] = ()
    if gate is not None:
        from robacc.documents.gate_files import read_gate

        loaded = read_gate(os.fspath(gate))
        records = loaded.records
        for criterion in loaded.gate.criteria:
            quantity, _, statistic = criterion.key.partition(".")
            if quantity == "position" and statistic in _STATISTICS and criterion.limit is not None:
                confidence = criterion.confidence
                name = cast(AcceptanceStatistic, statistic)
                demands.append(Demand(criterion.name, name, criterion.limit, "m", confidence, criterion.share))
        if not demands:
            raise UsageError(f"{os.fspath(gate)} has no limit of position.rms, mean_error, p95 or max to plan for")
    if grade is not None:
        from robacc.accuracy.grade_scale import default_scale

        custom, scale_records = load_grade_scale(scale)
        steps = custom or default_scale()
        limits = {step.grade: step.position for step in steps.steps}
        if grade not in limits:
            raise UsageError(f"`grade`: the scale {steps.name} has the grades {', '.join(limits)}, not {grade!r}")
        demands.append(Demand(f"grade {grade}", steps.statistic, limits[grade], "m", steps.confidence))
        records = (*records, *scale_records)
    return tuple(demands), records


def checked_payloads(payloads: Sequence[float]) -> tuple[float, ...]:
    """Return payloads, kg, in ascending order.

    Raises:
        UsageError: There are too many, two are equal, or a mass is negative or not finite.
    """
    masses = sorted(map(float, payloads))
    for mass in masses:
        if not 0 <= mass < math.inf:
            raise UsageError(f"`payload`: expected masses of at least 0 kg, found {mass:g}")
    if len(set(masses)) < len(masses) or len(masses) > _MOST_PAYLOADS:
        listed = ", ".join(f"{mass:g}" for mass in masses)
        raise UsageError(f"`payload`: expected at most {_MOST_PAYLOADS} different masses, found {listed}")
    return tuple(masses)


def check_plan_arguments(arguments: Mapping[str, Any]) -> None:
    """Check the words and numbers of a call of :func:`~robacc.api.plan.plan`.

    Raises:
        UsageError: A word is unknown, or a number is outside its range.
    """
    check_choice("purpose", arguments["purpose"], PURPOSES)
    check_choice("criterion", arguments["criterion"], CRITERIA)
    for name, low, high in (
        ("poses", 1, 2000),
        ("margin", 0.0, 0.45),
        ("check_every", 0, 10_000),
        ("repeats", 0, 2000),
        ("validation", 0, 2000),
        ("seed", 0, math.inf),
        ("max_condition", 1.0, math.inf),
    ):
        if arguments[name] is not None:
            check_range(name, arguments[name], low, high)
