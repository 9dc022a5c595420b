"""Call of the command ``robacc plan``."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePath
from typing import Any, ClassVar

from robacc.api.inputs import PosesSource, StrPath
from robacc.api.model_use import use_model
from robacc.api.plan_inputs import (
    check_plan_arguments,
    checked_payloads,
    load_already,
    load_candidates,
    load_collisions,
    load_demands,
    load_planned_poses,
    robot_to_plan_for,
    sight_of,
)
from robacc.api.result import Provenance, Result, fields_of, options_of
from robacc.errors import UsageError
from robacc.measurements import Measurements
from robacc.planning.branches_at_rest import at_rest_warning
from robacc.planning.campaign import CampaignPlan, CampaignSettings, Purpose
from robacc.planning.constraints import Constraints, length, parse_box, parse_half_space
from robacc.planning.design import Criterion
from robacc.planning.planner import plan_campaign
from robacc.quantities import optional_size, size
from robacc.robots.description import Robot
from robacc.threads import single_threaded


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Planned(Result, CampaignPlan):
    """Planned poses and the expected result, with the inputs."""

    command: ClassVar[str] = "plan"
    made: Provenance

    @classmethod
    def of(cls, body: CampaignPlan, made: Provenance) -> Planned:
        """Return ``body`` with its inputs."""
        return cls(**fields_of(body), made=made)

    def csv(self) -> str:
        """Return the file of the visits that the command writes: pose, cycle, joints, direction and speed."""
        from robacc.poses.csv_text import format_poses
        from robacc.render.text.plan import plan_comments

        head = "".join(f"# {line}\n" for line in plan_comments(self))
        return head + format_poses(self.visits(), attained=False)

    def validation_csv(self) -> str:
        """Return the file of the validation poses.

        Raises:
            UsageError: The plan has none.
        """
        from robacc.poses.csv_text import format_poses
        from robacc.render.text.plan import validation_comments

        poses = self.validation_poses()
        return "".join(f"# {line}\n" for line in validation_comments(self)) + format_poses(poses, attained=False)

    def write(self, path: StrPath) -> None:
        """Write :meth:`csv` to a file; a failure leaves no partial file.

        Raises:
            InputError: The file cannot be written.
        """
        from robacc.io.files import write_text

        write_text(path, self.csv())

    def programs(self, path: StrPath) -> dict[str, str]:
        """Return the visits as robot programs in the language of the suffix of ``path``: text by file name.

        ``.src`` is KRL, ``.mod`` RAPID, ``.ls`` FANUC TP, ``.script`` URScript. A program stops at each pose. With
        several payloads there is a program for each, ``plan_5kg.src`` for ``plan.src``, in the order to run.

        Raises:
            UsageError: The suffix is of no language, or the robot has too many joints for it.
        """
        if self.payload_kg is None or len(self.payload_blocks) == 1:
            return {os.fspath(path): self.program(path)}
        file = PurePath(path)
        return {
            str(file.with_name(f"{file.stem}_{block.payload:g}kg{file.suffix}")): self.program(path, block.payload)
            for block in self.payload_blocks
        }

    def program(self, path: StrPath, payload: float | None = None) -> str:
        """Return the visits as a robot program; with ``payload``, those with this payload (kg).

        Raises:
            UsageError: The suffix is of no language, the robot has too many joints for it, or no visit has the payload.
        """
        from robacc.programs.fresh import SUFFIX, joint_target, write_program

        suffix = PurePath(path).suffix.lower()
        dialects = {value: key for key, value in SUFFIX.items()}
        if suffix not in dialects:
            raise UsageError(f"`program`: expected a file name that ends in {', '.join(dialects)}, found {path!r}")
        visits = self.visits()
        assert visits.pose is not None
        targets = [joint_target(str(name), q.tolist()) for name, q in zip(visits.pose, self.q.T, strict=True)]
        name = PurePath(path).stem
        if payload is not None:
            masses = () if self.payload_kg is None else self.payload_kg.tolist()
            targets = [target for target, mass in zip(targets, masses, strict=False) if mass == payload]
            name = f"{name}_{payload:g}kg"
            if not targets:
                raise UsageError(f"`payload`: no visit has a payload of {payload:g} kg")
        linear = [i for i, joint in enumerate(self.robot.variables) if joint.type == "prismatic"]
        return write_program(dialects[suffix], targets, name=name, linear=linear)

    def payload(self) -> dict[str, Any]:
        """Return the result's own keys; arrays stay arrays."""
        from robacc.documents.plan import payload

        return payload(self, self.csv())


@single_threaded
def plan(
    robot: StrPath | Robot,
    *,
    purpose: Purpose = "calibrate",
    poses: int | None = None,
    criterion: Criterion = "I",
    fit: str | Sequence[str] = "",
    candidates: PosesSource | int | None = None,
    task: PosesSource | None = None,
    region: str | None = None,
    inside: str | None = None,
    outside: Sequence[str] = (),
    half_space: Sequence[str] = (),
    min_height: float | str | None = None,
    margin: float = 0.02,
    max_condition: float | None = None,
    collisions: bool = False,
    instrument: str | Sequence[float] | None = None,
    reflector: str | Sequence[float] | None = None,
    cone: float | str = "30deg",
    distance: str | Sequence[float] | None = None,
    noise: float | str | None = None,
    noise_orientation: float | str | None = None,
    repeatability: float | str | None = None,
    unexplained: float | str = "0",
    model: StrPath | Robot | None = None,
    already: PosesSource | None = None,
    target_error: float | str | None = None,
    payload: Sequence[float] = (),
    check_every: int = 10,
    repeats: int | None = None,
    validation: int = 0,
    gate: StrPath | None = None,
    grade: str | None = None,
    scale: StrPath | None = None,
    expected: float | str | None = None,
    ordered: bool = False,
    seed: int = 0,
    base_link: str | None = None,
    tip_link: str | None = None,
) -> Planned:
    """Plan a measurement: the poses worth measuring, their order, and the expected result.

    Boxes, half-spaces and places are in the robot's base frame; numbers without a unit are in m.

    Args:
        robot: Robot file (YAML), URDF, or a robot read before.
        purpose: ``calibrate``, ``trace``, ``acceptance`` or ``health``.
        poses: Number of different poses; for ``acceptance`` with a gate or a grade, the number that decides it.
        criterion: ``I`` for the mean and ``G`` for the worst predicted error over the task, ``D`` or ``A`` for the
            coefficients.
        fit: Effects that are free in the fit; by default those usual for the purpose.
        candidates: CSV of poses to choose from, or the number of samples within the joint limits.
        task: CSV of poses where the accuracy matters.
        region: Box where the accuracy matters, such as ``"x=0.4:0.9,z=0:0.6"``.
        inside: Box that the target stays in.
        outside: Boxes that every moving point of the arm stays out of.
        half_space: Sides to stay on, such as ``"y>=-0.4"``.
        min_height: Least height of every moving point of the arm above the base.
        margin: Share of each joint's range to keep from its limits.
        max_condition: Largest condition number of the joints' Jacobian.
        collisions: Use the collision shapes of the URDF: exclude poses at which links touch each other, and give
            the arm its thickness in ``outside``, ``half_space`` and ``min_height``. Needs the extra ``collision``.
        instrument: Position of the instrument.
        reflector: Direction in the target's frame that the reflector faces; None if it is turned by hand.
        cone: Half angle that the reflector accepts.
        distance: Nearest and farthest distance of the instrument, such as ``"0.5:15"``.
        noise: Standard deviation of the instrument along each axis; by default typical.
        noise_orientation: Standard deviation about each axis; None where orientation is not measured.
        repeatability: Standard deviation of the arm's own scatter along each axis; by default typical.
        unexplained: Standard deviation along each axis of the model's error that stays the same at one pose.
        model: Calibrated robot file to start from, in place of ``robot``'s numbers.
        already: CSV of poses measured already; the plan adds to them.
        target_error: Predicted error that is good enough.
        payload: Payloads, kg, each mounted once; the plan chooses which poses have which.
        check_every: Visits from one drift check to the next; 0 for none.
        repeats: Number of poses visited a second time; by default a tenth.
        validation: Number of validation poses, apart from the calibration poses.
        gate: Gate file that an acceptance measurement is to decide.
        grade: Grade that an acceptance measurement is to confirm.
        scale: Grade scale in place of the built-in scale.
        expected: Expected true value of the gate's or grade's statistic.
        ordered: The rows of ``already`` are in the order measured.
        seed: Seed of the random numbers.
        base_link: First link of the chain in a URDF.
        tip_link: Last link of the chain in a URDF.

    Returns:
        The visits in order, with predicted standard errors, accuracy and detection limits.

    Raises:
        InputError: A file cannot be used, or a prismatic joint has no limits.
        UsageError: No pose meets the constraints, or the arguments contradict each other.

    Example:
        >>> import robacc
        >>> result = robacc.plan("sample_data/robot.yaml", poses=12, candidates=500)
        >>> sorted(result.route.roles).count("pose")
        11
        >>> result.accuracy.planned.rms < result.accuracy.planned.random_rms
        True
    """
    arguments = locals()
    check_plan_arguments(arguments)
    arm, records = robot_to_plan_for(robot, model, base_link, tip_link)
    # A drift and other facts of the model's own campaign do not come again.
    use = use_model(arm, None, campaign="drop")
    arm = use.robot or arm
    loaded_candidates, n_candidates, candidate_records = load_candidates(candidates, arm)
    loaded_task, task_records = load_planned_poses(task, arm, "task")
    measured, measured_records = load_already(already, arm, ordered)
    demands, demand_records = load_demands(gate, grade, scale)
    if demands and purpose != "acceptance":
        raise UsageError("`gate` and `grade` set the number of acceptance poses; give purpose acceptance")
    settings = CampaignSettings(
        purpose=purpose,
        poses=poses,
        criterion=criterion,
        fit=fit if isinstance(fit, str) else ",".join(fit),
        constraints=Constraints(
            margin=margin,
            inside=None if inside is None else parse_box(inside, "inside"),
            outside=tuple(parse_box(text, "outside") for text in outside),
            half_spaces=tuple(parse_half_space(text, "half_space") for text in half_space),
            min_height=None if min_height is None else length(min_height, "min_height"),
            sight=sight_of(instrument, reflector, cone, distance),
            max_condition=max_condition,
            collisions=load_collisions(robot, base_link, tip_link) if collisions else None,
        ),
        region=None if region is None else parse_box(region, "region"),
        noise=optional_size(noise, "length", "`noise`"),
        noise_orientation=optional_size(noise_orientation, "angle", "`noise_orientation`") or None,
        repeatability=optional_size(repeatability, "length", "`repeatability`"),
        unexplained=size(unexplained, "length", "`unexplained`"),
        check_every=check_every,
        repeats=repeats,
        validation=validation,
        target=optional_size(target_error, "length", "`target_error`"),
        demands=demands,
        expected=optional_size(expected, "length", "`expected`"),
        n_candidates=n_candidates,
        payloads=checked_payloads(payload),
        seed=seed,
    )
    body = plan_campaign(arm, settings, candidates=loaded_candidates, task=loaded_task, already=measured)
    body = dataclasses.replace(body, warnings=(*body.warnings, *at_rest_warning(arm), *use.warnings))
    inputs = (*records, *candidate_records, *task_records, *measured_records, *demand_records)
    return Planned.of(body, Provenance(_recorded(options_of(plan, arguments)), inputs, seed))


def _recorded(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options for the record of the call: files by their names, and no objects."""
    files = {"model", "candidates", "task", "already", "gate", "scale"}
    return {
        name: os.path.basename(os.fspath(value)) if name in files and isinstance(value, str | os.PathLike) else value
        for name, value in options.items()
        if not isinstance(value, Measurements | Robot)
    }
