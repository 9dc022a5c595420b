"""Calls of ``robacc simulate``, ``robacc export`` and ``robacc init --from``: what a model gives."""

from __future__ import annotations

import inspect
import math
import os
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Annotated, Any, Literal

from robacc.api.inputs import Inputs
from robacc.api.parameters import (
    BaseLink,
    Campaign,
    Help,
    IgnoreLimits,
    PosesSource,
    RobotArgument,
    Seed,
    StrictRange,
    StrPath,
    TipLink,
    call,
    masses,
    numbers,
    temperatures,
)
from robacc.api.result import CsvResult, Result, fields_of
from robacc.diagnostics.robot_poses import joints_of
from robacc.errors import InputError, MissingColumnError, Note, Problem, UsageError, refuse
from robacc.exporters import GROUP, RemainingError, Written, check_parameters, remaining_error, restricted
from robacc.io.files import read_text, write_file
from robacc.modelling.validity import resolve_campaign
from robacc.plug_ins import plug_in, plug_in_names, plug_ins
from robacc.poses.csv_file import pose_pieces
from robacc.prediction.model_uncertainty import model_fit
from robacc.quantities import size
from robacc.robots.description import Frame, Robot
from robacc.simulation.simulate import Plan, Simulation, simulate as simulate_poses


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Simulated(CsvResult, Simulation, command="simulate"):
    """Simulated poses, with the robot and the plan."""

    robot: Robot
    plan: Plan

    @property
    def outlier_lines(self) -> list[int]:
        """Lines of :meth:`csv` with outliers."""
        # Line of the first row in a file with outliers, below two comments and the header.
        return [int(row) + 4 for row in self.outliers]

    def csv_pieces(self) -> Iterator[str]:
        """Yield the text of :meth:`csv` in pieces."""
        plan, rotation_noise = self.plan, self.plan.noise_orientation if self.plan.orientation else 0.0
        sizes = ((plan.noise_position, "mm"), (rotation_noise, "mrad"))
        noise = " and ".join(f"{size * 1e3:.6g} {unit}" for size, unit in sizes if size > 0)
        settings = f"seed {plan.seed}, {f'noise {noise}' if noise else 'no noise'}"
        yield f"# Simulated by robacc simulate from {self.named('robot')} with {settings}; nothing was measured.\n"
        if lines := self.outlier_lines:
            yield f"# Outliers on lines {', '.join(map(str, lines))}\n"
        yield from pose_pieces(self.data)


@call
def simulate(
    robot: RobotArgument,
    *,
    poses: Annotated[
        int | None,
        Help("Number of commanded poses to sample.", "N", "Give either this or `at`.", least=1, most=1_000_000),
    ] = None,
    at: Annotated[
        PosesSource | None,
        Help("CSV of commanded poses, in the order visited.", "FILE", "Or poses read before.", holds="planned poses"),
    ] = None,
    ignore_limits: IgnoreLimits = False,
    seed: Seed = 0,
    cycles: Annotated[int, Help("Number of visits to every commanded pose.", "N", least=1, most=100_000)] = 1,
    sampling: Annotated[
        Literal["even", "random"],
        Help("Low-discrepancy sequence, or uniform distribution of the joint variables."),
    ] = "even",
    noise: Annotated[
        float | str,
        Help(
            "Standard deviation of the measurement noise along each axis, such as 0.02mm.", "SIZE", "A number is in m."
        ),
    ] = "0",
    noise_orientation: Annotated[
        float | str,
        Help("Standard deviation about each axis, such as 0.005deg.", "SIZE", "A number is in rad."),
    ] = "0",
    sigma: Annotated[bool, Help("Write the noise as columns sigma_x, sigma_y, sigma_z, sigma_r.")] = False,
    outliers: Annotated[int, Help("Number of outliers.", "K", least=0)] = 0,
    outlier_size: Annotated[
        float | str, Help("Position error of an outlier, such as 5mm.", "SIZE", "A number is in m.")
    ] = "10mm",
    position_only: Annotated[
        bool,
        Help("Measure position only, or position and orientation.", names=("position-only/orientation",)),
    ] = False,
    commanded: Annotated[bool, Help("Write cmd_ columns with the poses of the robot without its effects.")] = False,
    motion: Annotated[
        bool,
        Help("Write direction and speed of approach, from the order of the poses.", names=("motion/no-motion",)),
    ] = True,
    time_step: Annotated[float | None, Help("Seconds between poses, written as time_s.", "S", least=0.0)] = None,
    temperature: Annotated[
        float | tuple[float, float] | None,
        Help("Constant temperature, or a warm-up such as 22:28.", "C[:C]", "In degrees Celsius.", read=temperatures),
    ] = None,
    payload: Annotated[
        Sequence[float],
        Help("Payloads; each pose has one of them, chosen at random.", "KG,…", "In kg.", read=numbers),
    ] = (),
    campaign: Campaign = "auto",
    strict_range: StrictRange = False,
    base_link: BaseLink = None,
    tip_link: TipLink = None,
) -> Simulated:
    """Simulate measured poses of a robot with the effects that its file lists, by the exact nonlinear model.

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
    inputs, either = Inputs(locals()), "give either `poses`, the number of poses to sample, or `at`, the poses to visit"
    refuse(((poses is None) == (at is None), either))
    ends = temperature if isinstance(temperature, tuple | None) else (temperature, temperature)
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
        temperature=None if ends is None else (float(ends[0]), float(ends[1])),
        payloads=masses("payload", payload),
    )
    has_no_noise = plan.noise_position == 0 or (plan.orientation and plan.noise_orientation == 0)
    refuse(
        (not all(map(math.isfinite, plan.temperature or ())), "`temperature`: expected finite numbers"),
        (sigma and has_no_noise, "`sigma` needs `noise` above zero, and `noise_orientation` unless `position_only`"),
    )
    described = inputs.robot(robot, at)
    arm, _ = resolve_campaign(described, None, (), campaign)
    planned = None if at is None else inputs.poses(at, arm, attained=False, visited_by=joints_of(arm))
    try:
        body = simulate_poses(arm, plan, planned)
    except MissingColumnError as error:
        raise MissingColumnError(f"{error}; `time_step`, `temperature` and `payload` add such columns") from error
    inputs.campaign(described, body.data, measured=False, digests=())
    options = {**asdict(plan), "campaign": campaign, "strict_range": strict_range}
    # How poses to visit were read, poses outside the model's validity range, and campaign effects left out.
    warnings = (*body.data.warnings, *inputs.warnings)
    made = inputs.made()._replace(options=options)
    return Simulated(**fields_of(body), robot=arm, plan=plan, warnings=warnings, made=made)


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Exported(Result, command="export"):
    """Model in the format of a controller, with the error that remains there."""

    format: str
    text: str
    controller: Robot
    """Arm that the text describes, with the model's base and tool."""
    tool: Frame
    """Measured target in the last frame of the format, to be set as the tool."""
    not_carried: tuple[str, ...]
    """What the format leaves out."""
    refitted: tuple[str, ...]
    """Effects that the format lacks and that its numbers take up as far as they can."""
    remaining: RemainingError
    arm: str | None = None
    """Arm of Universal Robots that the numbers refer to."""

    def write(self, path: StrPath) -> None:
        """Write the model to a file; a failure leaves no partial file.

        Raises:
            InputError: The file cannot be written.
        """
        write_file(path, self.text)


@call
def export(
    model: Annotated[
        StrPath | Robot, Help("Robot file (YAML), URDF, or name of an arm.", "MODEL", "Or a robot read before.")
    ],
    *,
    format: Annotated[
        str | None,
        Help(
            "Format of the text.",
            python="None is ur-calibration for an arm that it fits.",
            group="robacc.exporters",
        ),
    ] = None,
    nominal: Annotated[
        StrPath | Robot | None,
        Help("joint-offsets, lerobot: the model that the controller computes with.", "ROBOT"),
    ] = None,
    arm: Annotated[str | None, Help("ur-calibration: the arm, such as ur10e.", "NAME")] = None,
    template: Annotated[
        StrPath | None, Help("ur-…, lerobot: the arm's own file, whose other lines are kept.", "FILE")
    ] = None,
    base_link: BaseLink = None,
    tip_link: TipLink = None,
) -> Exported:
    """Write a model in the format of a controller, a driver or a simulator, as text.

    What the format cannot hold is left out, and what it can hold is fitted again to the model.

    Returns:
        The text, and the error that remains with it.

    Raises:
        InputError: A file cannot be used.
        UsageError: The format cannot hold this arm, there is none, or the arguments contradict each other.

    Example:
        >>> import robacc
        >>> result = robacc.export("sample_data/robot.yaml", format="mdh")
        >>> result.text.splitlines()[0], result.remaining.position_max < 1e-9
        ('robacc: 1', True)
    """
    inputs = Inputs(locals())
    robot = inputs.robot(model)
    given: dict[str, Any] = {"nominal": nominal, "template": template, "arm": arm}
    given = {name: value for name, value in given.items() if value is not None}
    form = format or "ur-calibration"
    check_parameters(form, given)
    before = None if nominal is None else inputs.robot(nominal, kind="nominal")
    if before is not None:
        differ = before.variable_names != robot.variable_names
        refuse((differ, "the model and the nominal model have different joints"))
        given["nominal"] = before
    if template is not None:
        given["template"] = inputs.text(template, "template", lambda text, _: text)
    try:
        start, complete, refitted, excluded = restricted(robot, before)
        made = Written(*plug_in(GROUP, form)(start, **given))
    except UsageError as error:
        if format is not None or arm is not None:
            raise
        names = ", ".join(sorted(plug_in_names(GROUP)))
        raise UsageError(f"name the format of the file with `format`: {names}") from error
    controller = made.controller or start
    remaining = remaining_error(complete, controller)
    # Remaining error (m, rad) below which nothing is left out.
    is_exact = before is not None and max(remaining.position_max, remaining.orientation_max) < 1e-9
    losses = (loss for loss in made.losses if not loss.startswith("effect "))
    not_carried = () if is_exact else (*(f"effect {name}" for name in (*refitted, *excluded)), *losses)
    default = Note(f"format {form}, which the controller of a {made.arm} reads; `format` names another")
    fit = model_fit(robot)
    return Exported(
        format=form,
        text=made.text,
        controller=controller,
        tool=made.tool or controller.tool,
        not_carried=not_carried,
        refitted=refitted,
        remaining=remaining,
        arm=made.arm,
        warnings=(*(() if format else (default,)), *(() if fit is None else fit.warnings)),
        made=inputs.made("model", "nominal", "template", format=form),
    )


@call
def import_(
    file: Annotated[
        StrPath,
        Help("calibration.conf of Universal Robots, ROS kinematics, DH table (CSV), or JSON export.", "FILE"),
    ],
    *,
    arm: Annotated[str | None, Help("Arm that a calibration.conf belongs to, such as ur10e.", "NAME")] = None,
) -> Robot:
    """Read a robot from the kinematics file of a controller or of its ROS driver.

    Returns:
        The robot; :func:`robacc.write_robot` writes it as a robot file.

    Raises:
        InputError: The file cannot be read, or is none of these formats.
        UsageError: The arm is unknown.

    Example:
        >>> import pathlib, tempfile
        >>> import robacc
        >>> path = pathlib.Path(tempfile.mkdtemp()) / "model.json"
        >>> robacc.export("sample_data/robot.yaml", format="json").write(path)
        >>> robacc.import_(path).variable_names == robacc.read_robot("sample_data/robot.yaml").variable_names
        True
    """
    path = os.fspath(file)
    text, name = read_text(path), "<stdin>" if path == "-" else path
    for read in plug_ins("robacc.importers"):
        takes_arm = "arm" in inspect.signature(read).parameters
        robot: Robot | None = read(text, name, arm=arm) if takes_arm else read(text, name)
        if robot is not None:
            refuse(
                (
                    arm is not None and not takes_arm,
                    f"only a calibration.conf needs the name of its arm; {name} has all lengths",
                )
            )
            return robot
    fix = "give a calibration.conf of Universal Robots, a ROS kinematics file, a CSV with theta, d, a, alpha, or JSON"
    raise InputError(Problem("is no kinematics file", name, fix=fix))
