"""Call of the command ``robacc simulate``."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from hashlib import sha256
from typing import Any, ClassVar, Literal

from robacc.api.inputs import PosesSource, StrPath, checked_poses, load_robot, pose_path, record_of, require_poses
from robacc.api.result import CampaignUse, Provenance, Result, check_choice, check_range, fields_of, use_model
from robacc.diagnostics.robot_poses import joints_of
from robacc.documents.envelope import InputFile
from robacc.errors import MissingColumnError, UsageError
from robacc.measurements import Measurements
from robacc.poses.csv_file import pose_pieces, read_poses
from robacc.quantities import size
from robacc.robots.description import Robot
from robacc.simulation.simulate import Plan, Simulation
from robacc.simulation.simulate import simulate as simulate_poses
from robacc.threads import single_threaded

_FIRST_ROW = 4
"""Line of the first row in a file with outliers, below two comments and the header."""


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Simulated(Result, Simulation):
    """Simulated poses, with the robot and the plan."""

    command: ClassVar[str] = "simulate"
    robot: Robot
    plan: Plan
    made: Provenance

    @classmethod
    def of(cls, body: Simulation, robot: Robot, plan: Plan, made: Provenance) -> Simulated:
        """Return ``body`` with its inputs."""
        return cls(**fields_of(body), robot=robot, plan=plan, made=made)

    @property
    def warnings(self) -> tuple[str, ...]:
        """How poses to visit were read, poses outside the model's validity range, and campaign effects left out."""
        return (*self.data.warnings, *(() if self.made.use is None else self.made.use.warnings))

    @property
    def outlier_lines(self) -> list[int]:
        """Lines of :meth:`csv` with outliers."""
        return [int(row) + _FIRST_ROW for row in self.outliers]

    def csv(self) -> str:
        """Return the file that the command writes."""
        return "".join(self.csv_pieces())

    def csv_pieces(self) -> Iterator[str]:
        """Yield the text of :meth:`csv` in pieces."""
        source = self.made.inputs[0].name
        settings = f"seed {self.plan.seed}, {_noise_text(self.plan)}"
        head = [f"Simulated by robacc simulate from {source} with {settings}; nothing was measured."]
        lines = self.outlier_lines
        head += [f"Outliers on lines {', '.join(map(str, lines))}"] if lines else []
        yield "".join(f"# {line}\n" for line in head)
        yield from pose_pieces(self.data)

    def write(self, path: StrPath) -> None:
        """Write :meth:`csv` to a file; a failure leaves no partial file.

        Raises:
            InputError: The file cannot be written.
        """
        from robacc.io.files import write_pieces

        write_pieces(path, self.csv_pieces())

    def payload(self) -> dict[str, Any]:
        """Return the result's own keys: a summary of the file, without the poses."""
        return {
            "n_poses": self.data.n,
            "effects": [str(effect.get("effect")) for effect in self.robot.effects],
            "outlier_lines": self.outlier_lines,
            "file_sha256": sha256(self.csv().encode()).hexdigest(),
        }


@single_threaded
def simulate(
    robot: StrPath | Robot,
    *,
    poses: int | None = None,
    at: PosesSource | None = None,
    ignore_limits: bool = False,
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
    campaign: CampaignUse = "auto",
    strict_range: bool = False,
    base_link: str | None = None,
    tip_link: str | None = None,
) -> Simulated:
    """Simulate measured poses of a robot with the effects that its file lists, by the exact nonlinear model.

    Args:
        robot: Robot file (YAML), URDF, or a robot read before.
        poses: Number of commanded poses to sample; give either this or ``at``.
        at: CSV of commanded poses, or poses read before, in the order visited.
        ignore_limits: Joint values of ``at`` outside the limits are a warning; by default they are an error where they
            exceed a limit by more than 0.05 degree or 0.5 mm.
        seed: Seed of the random numbers.
        cycles: Number of visits to every commanded pose.
        sampling: ``even`` for a low-discrepancy sequence of joint variables, ``random`` for a uniform distribution.
        noise: Standard deviation of the measurement noise along each axis, m, or text such as ``"0.02mm"``.
        noise_orientation: Standard deviation about each axis, rad, or text such as ``"0.005deg"``.
        sigma: Add columns with the standard deviations of the noise.
        outliers: Number of outliers.
        outlier_size: Position error of an outlier, m or text.
        position_only: Measure no orientation.
        commanded: Add columns with the commanded poses, those of the robot without its effects.
        motion: Add columns with direction and speed of approach, from the order of the poses.
        time_step: Seconds between poses.
        temperature: Degrees Celsius: constant, or start and end of a warm-up.
        payload: Payloads, kg; each pose has one of them, chosen at random.
        campaign: Use of the facts of the campaign that a model was fitted in, such as a drift: ``keep``, ``drop``, or
            ``auto`` for its own poses and for measured poses that agree better with them.
        strict_range: Refuse poses outside the validity range of the model.
        base_link: First link of the chain in a URDF.
        tip_link: Last link of the chain in a URDF.

    Returns:
        ``data``, which every call accepts as poses, and :meth:`Simulated.csv`, the file that the command writes.

    Raises:
        InputError: A file cannot be used, a prismatic joint has no limits, or the robot's effects cannot be read.
        UsageError: The plan lacks a column that an effect depends on, or the arguments contradict each other.

    Example:
        >>> import robacc
        >>> result = robacc.simulate("sample_data/robot.yaml", poses=20, noise="0.02mm", seed=1)
        >>> result.data.position.shape
        (3, 20)
        >>> robacc.estimate(result.data, robot="sample_data/robot.yaml").n_poses
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
        temperature=_temperature_range(temperature),
        payloads=tuple(map(float, payload)),
    )
    _check(plan, poses)
    arm, arm_record = load_robot(robot, base_link, tip_link, at)
    described = arm
    arm = use_model(arm, None, campaign=campaign).robot or arm
    planned, records = _planned(at, arm, ignore_limits)
    try:
        body = simulate_poses(arm, plan, planned)
    except MissingColumnError as error:
        message = f"{error}; `time_step`, `temperature` and `payload` add such columns"
        raise MissingColumnError(message) from error
    use = use_model(described, body.data, campaign=campaign, strict_range=strict_range, measured=False)
    options = {**dataclasses.asdict(plan), "campaign": campaign, "strict_range": strict_range}
    return Simulated.of(body, arm, plan, Provenance(options, (arm_record, *records), seed, use))


def _check(plan: Plan, poses: int | None) -> None:
    check_range("poses", 1 if poses is None else poses, 1, 1_000_000)
    check_range("seed", plan.seed, 0)
    check_range("cycles", plan.cycles, 1, 100_000)
    check_range("outliers", plan.outliers, 0)
    check_choice("sampling", plan.sampling, ("even", "random"))
    check_range("time_step", plan.time_step or 0.0, 0.0)
    for mass in plan.payloads:
        if not 0 <= mass < math.inf:
            raise UsageError(f"`payload`: expected masses of at least 0 kg, found {mass:g}")
    if not all(map(math.isfinite, plan.temperature or ())):
        raise UsageError("`temperature`: expected finite numbers")
    if plan.sigma and (plan.noise_position == 0 or (plan.orientation and plan.noise_orientation == 0)):
        raise UsageError("`sigma` needs `noise` above zero, and `noise_orientation` unless `position_only`")


def _noise_text(plan: Plan) -> str:
    """Return the standard deviations of the noise along and about each axis as text."""
    sizes = [(plan.noise_position, "mm"), (plan.noise_orientation if plan.orientation else 0.0, "mrad")]
    texts = [f"{size * 1e3:.6g} {unit}" for size, unit in sizes if size > 0]
    return f"noise {' and '.join(texts)}" if texts else "no noise"


def _temperature_range(temperature: float | tuple[float, float] | None) -> tuple[float, float] | None:
    if temperature is None:
        return None
    start, end = temperature if isinstance(temperature, tuple) else (temperature, temperature)
    return float(start), float(end)


def _planned(
    at: PosesSource | None, arm: Robot, ignore_limits: bool
) -> tuple[Measurements | None, tuple[InputFile, ...]]:
    if at is None:
        return None, ()
    if isinstance(at, Measurements):
        data = checked_poses(at, arm)
        return require_poses(data), (record_of(data, "poses"),)
    # Not read_robot_poses: poses to visit name no target; the robot visits every target at each pose.
    path = pose_path(at)
    data = read_poses(path, robot=joints_of(arm), ignore_limits=ignore_limits, attained=False)
    return require_poses(data), (InputFile.at(path, data.sha256 or "", "poses"),)
