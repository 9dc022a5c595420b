"""The call behind ``robacc simulate``."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from hashlib import sha256
from typing import Any, ClassVar, Literal

from robacc.api.inputs import StrPath, checked, needed_robot_of, record_of, some_poses
from robacc.api.result import Made, Result, one_of, parts, within
from robacc.documents.envelope import InputFile
from robacc.errors import MissingColumnError, UsageError
from robacc.measurements import Measurements
from robacc.poses.csv_file import pose_pieces, read_poses
from robacc.quantities import size
from robacc.robots.description import Robot
from robacc.simulation.simulate import Plan, Simulation
from robacc.simulation.simulate import simulate as simulated

_FIRST_ROW = 4
"""Two comments and the header stand above the rows of a file with outliers."""


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Simulated(Result, Simulation):
    """Measured poses that were made up, with what they were made from."""

    command: ClassVar[str] = "simulate"
    robot: Robot
    plan: Plan
    made: Made

    @property
    def warnings(self) -> tuple[str, ...]:
        """None: nothing was measured."""
        return ()

    @property
    def outlier_lines(self) -> list[int]:
        """Lines of :meth:`csv` that were made wrong."""
        return [int(row) + _FIRST_ROW for row in self.outliers]

    def csv(self) -> str:
        """The file that the command writes."""
        return "".join(self.csv_pieces())

    def csv_pieces(self) -> Iterator[str]:
        """The same in pieces, for many poses."""
        source = self.made.inputs[0].name
        made = f"with seed {self.plan.seed}, {_noise_told(self.plan)}"
        head = [f"Simulated by robacc simulate from {source} {made}; nothing was measured."]
        wrong = self.outlier_lines
        head += [f"Outliers on lines {', '.join(map(str, wrong))}"] if wrong else []
        yield "".join(f"# {line}\n" for line in head)
        yield from pose_pieces(self.data)

    def write(self, path: StrPath) -> None:
        """Write :meth:`csv` to a file, whole or not at all.

        Raises:
            InputError: The file cannot be written.
        """
        from robacc.io.files import write_pieces

        write_pieces(path, self.csv_pieces())

    def payload(self) -> dict[str, Any]:
        """The result's own keys: what is in the file, not the poses themselves."""
        return {
            "n_poses": self.data.n,
            "effects": [str(effect.get("effect")) for effect in self.robot.effects],
            "outlier_lines": self.outlier_lines,
            "file_sha256": sha256(self.csv().encode()).hexdigest(),
        }


def simulate(
    robot: StrPath | Robot,
    *,
    poses: int | None = None,
    at: StrPath | Measurements | None = None,
    seed: int = 0,
    cycles: int = 1,
    sampling: Literal["even", "random"] = "even",
    noise: float | str = 0.0,
    noise_orientation: float | str = 0.0,
    sigma: bool = False,
    outliers: int = 0,
    outlier_size: float | str = 0.01,
    position_only: bool = False,
    commanded: bool = False,
    motion: bool = True,
    time_step: float | None = None,
    temperature: float | tuple[float, float] | None = None,
    payload: Sequence[float] = (),
    base_link: str | None = None,
    tip_link: str | None = None,
) -> Simulated:
    """Measured poses made up, exact and nonlinear, of a robot with the effects that its file lists.

    Args:
        robot: Robot file (YAML), URDF, or a robot that was read before.
        poses: Commanded poses, sampled; either these or ``at``.
        at: Commanded poses of a CSV instead, or poses read before, in the order visited.
        seed: Of everything drawn at random.
        cycles: Visits of every commanded pose.
        sampling: Joint variables of low discrepancy, or uniform at random.
        noise: Standard deviation along each axis, m, or text with its unit such as ``"0.02mm"``.
        noise_orientation: The same about each axis, rad, or text such as ``"0.005deg"``.
        sigma: Whether the noise is among the columns.
        outliers: Rows made wrong.
        outlier_size: How far an outlier is off, m or text.
        position_only: Whether orientation is not measured.
        commanded: Whether the commanded poses, of the robot without its effects, are among the columns.
        motion: Whether direction and speed of approach, from the poses' order, are among the columns.
        time_step: Seconds between poses.
        temperature: Degrees Celsius: constant, or a warm-up from one to another.
        payload: kg; one of these at random at each pose.
        base_link: URDF: the link that the chain starts at.
        tip_link: URDF: the link that it ends at.

    Returns:
        ``data``, which every call takes as poses, and :meth:`Simulated.csv`, which the command writes.

    Raises:
        InputError: A file cannot be used, a slide has no limits, or the robot's effects cannot be read.
        UsageError: The plan lacks what an effect depends on, or the call does not fit itself.

    Example:
        >>> import robacc
        >>> found = robacc.simulate("sample_data/robot.yaml", poses=20, noise="0.02mm", seed=1)
        >>> found.data.position.shape
        (3, 20)
        >>> robacc.estimate(found.data, robot="sample_data/robot.yaml").n_poses
        20
    """
    if (poses is None) == (at is None):
        raise UsageError("give either `poses`, the number of poses to sample, or `at`, the poses to visit")
    plan = Plan(
        poses=poses or 0,
        seed=seed,
        cycles=cycles,
        sampling=sampling,
        noise_position=size(noise, "length", "`noise`"),
        noise_orientation=size(noise_orientation, "angle", "`noise_orientation`"),
        sigma=sigma,
        outliers=outliers,
        outlier_size=size(outlier_size, "length", "`outlier_size`"),
        orientation=not position_only,
        commanded=commanded,
        motion=motion,
        time_step=time_step,
        temperature=_ends(temperature),
        payloads=tuple(map(float, payload)),
    )
    _check(plan, poses)
    arm, arm_record = needed_robot_of(robot, base_link, tip_link)
    planned, records = _planned(at, arm)
    try:
        found = simulated(arm, plan, planned)
    except MissingColumnError as error:
        message = f"{error}; `time_step`, `temperature` and `payload` add such columns"
        raise MissingColumnError(message) from error
    made = Made(dataclasses.asdict(plan), (arm_record, *records), seed)
    return Simulated(**parts(found), robot=arm, plan=plan, made=made)


def _check(plan: Plan, poses: int | None) -> None:
    within("poses", 1 if poses is None else poses, 1, 1_000_000)
    within("seed", plan.seed, 0)
    within("cycles", plan.cycles, 1, 100_000)
    within("outliers", plan.outliers, 0)
    one_of("sampling", plan.sampling, ("even", "random"))
    within("time_step", plan.time_step or 0.0, 0.0)
    for weight in plan.payloads:
        if not 0 <= weight < math.inf:
            raise UsageError(f"`payload`: expected masses of at least 0 kg, found {weight:g}")
    if not all(map(math.isfinite, plan.temperature or ())):
        raise UsageError("`temperature`: expected finite numbers")
    if plan.sigma and (plan.noise_position == 0 or (plan.orientation and plan.noise_orientation == 0)):
        raise UsageError("`sigma` needs `noise` above zero, and `noise_orientation` unless `position_only`")


def _noise_told(plan: Plan) -> str:
    """The noise along, and where there is some about, each axis, in words."""
    sizes = [(plan.noise_position, "mm"), (plan.noise_orientation if plan.orientation else 0.0, "mrad")]
    told = [f"{size * 1e3:.6g} {unit}" for size, unit in sizes if size > 0]
    return f"noise {' and '.join(told)}" if told else "no noise"


def _ends(temperature: float | tuple[float, float] | None) -> tuple[float, float] | None:
    if temperature is None:
        return None
    start, end = temperature if isinstance(temperature, tuple) else (temperature, temperature)
    return float(start), float(end)


def _planned(at: StrPath | Measurements | None, arm: Robot) -> tuple[Measurements | None, tuple[InputFile, ...]]:
    if at is None:
        return None, ()
    if isinstance(at, Measurements):
        data = checked(at, arm)
    else:
        # Not by read_robot_poses: a plan names no target, each is visited at every pose.
        data = read_poses(
            at,
            joint_names=arm.variable_names,
            joint_types=[joint.type for joint in arm.variables],
            limits=[joint.limits for joint in arm.variables],
            attained=False,
        )
    return some_poses(data), (record_of(data, "poses"),)
