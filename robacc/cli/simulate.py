"""``robacc simulate``: a CSV of measured poses of a robot that has the effects its file lists."""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING, Annotated

import typer

from robacc.cli.options import BaseLinkOption, OutputOption, PlainFormat, PlainFormatOption, SeedOption, TipLinkOption

if TYPE_CHECKING:
    from robacc.measurements import Measurements
    from robacc.robots.description import Robot
    from robacc.simulation import Plan, Simulation


class Sampling(StrEnum):
    """How joint variables are chosen within their limits."""

    even = "even"
    random = "random"


def simulate(
    robot: Annotated[str, typer.Argument(metavar="ROBOT", help="Robot file (YAML) or URDF.")],
    poses: Annotated[
        int | None, typer.Option("--poses", metavar="N", min=1, max=1_000_000, help="Commanded poses, sampled.")
    ] = None,
    at: Annotated[
        str | None, typer.Option("--at", metavar="FILE", help="Commanded poses of a CSV instead, in the order visited.")
    ] = None,
    seed: SeedOption = 0,
    cycles: Annotated[int, typer.Option("--cycles", min=1, max=100_000, help="Visits of every commanded pose.")] = 1,
    sampling: Annotated[
        Sampling, typer.Option("--sampling", help="Joint variables of low discrepancy, or uniform at random.")
    ] = Sampling.even,
    noise: Annotated[
        str, typer.Option("--noise", metavar="SIZE", help="Standard deviation along each axis, such as 0.02mm.")
    ] = "0",
    noise_orientation: Annotated[
        str, typer.Option("--noise-orientation", metavar="SIZE", help="The same about each axis, such as 0.005deg.")
    ] = "0",
    sigma: Annotated[
        bool, typer.Option("--sigma", help="Write the noise as sigma_x, sigma_y, sigma_z, sigma_r.")
    ] = False,
    outliers: Annotated[int, typer.Option("--outliers", metavar="K", min=0, help="Rows made wrong.")] = 0,
    outlier_size: Annotated[
        str, typer.Option("--outlier-size", metavar="SIZE", help="How far an outlier is off, such as 5mm.")
    ] = "10mm",
    position_only: Annotated[
        bool, typer.Option("--position-only/--orientation", help="Whether orientation is not measured.")
    ] = False,
    commanded: Annotated[
        bool, typer.Option("--commanded", help="Write cmd_ columns: the robot without its effects.")
    ] = False,
    motion: Annotated[
        bool, typer.Option("--motion/--no-motion", help="Write direction and speed of approach, from the poses' order.")
    ] = True,
    time_step: Annotated[
        float | None, typer.Option("--time-step", metavar="S", min=0.0, help="Seconds between poses; writes time_s.")
    ] = None,
    temperature: Annotated[
        str | None,
        typer.Option("--temperature", metavar="C[:C]", help="Constant, or a warm-up from one to another, as 22:28."),
    ] = None,
    payload: Annotated[
        str | None, typer.Option("--payload", metavar="KG,…", help="Payloads, one of them at random at each pose.")
    ] = None,
    base_link: BaseLinkOption = None,
    tip_link: TipLinkOption = None,
    form: PlainFormatOption = PlainFormat.table,
    output: OutputOption = "-",
) -> None:
    """A CSV of simulated poses, exact and nonlinear, with the effects that the robot file lists."""
    from robacc.cli.quantities import quantity
    from robacc.errors import UsageError
    from robacc.io.robot_file import read_robot
    from robacc.simulation import Plan, simulate

    if form is PlainFormat.json and output == "-":
        raise UsageError("--format json tells of the file that --output names; name one")
    if (poses is None) == (at is None):
        raise UsageError("give either --poses, how many to sample, or --at, a CSV of poses to visit")
    plan = Plan(
        poses=poses or 0,
        seed=seed,
        cycles=cycles,
        sampling=sampling.value,
        noise_position=quantity(noise, "length", "--noise"),
        noise_orientation=quantity(noise_orientation, "angle", "--noise-orientation"),
        sigma=sigma,
        outliers=outliers,
        outlier_size=quantity(outlier_size, "length", "--outlier-size"),
        orientation=not position_only,
        commanded=commanded,
        motion=motion,
        time_step=time_step,
        temperature=_temperature(temperature),
        payloads=_payloads(payload),
    )
    if sigma and (plan.noise_position == 0 or (plan.orientation and plan.noise_orientation == 0)):
        raise UsageError("--sigma needs a noise above zero: --noise, and --noise-orientation unless --position-only")
    arm = read_robot(robot, base_link=base_link, tip_link=tip_link)
    try:
        planned = None if at is None else _planned(arm, at)
        done = simulate(arm, plan, planned)
    except UsageError as error:
        tip = "; --time-step, --temperature and --payload give circumstances" if "column" in str(error) else ""
        raise type(error)(f"{error}{tip}") from error
    _write(done, plan, arm, robot, planned, form, output)


def _planned(arm: Robot, path: str) -> Measurements:
    from robacc.io.poses_csv import read_poses

    return read_poses(
        path,
        joint_names=arm.variable_names,
        joint_types=[joint.type for joint in arm.variables],
        limits=[joint.limits for joint in arm.variables],
        attained=False,
    )


def _temperature(text: str | None) -> tuple[float, float] | None:
    from robacc.cli.quantities import numbers
    from robacc.errors import UsageError

    if text is None:
        return None
    ends = numbers(text, ":", "--temperature")
    if len(ends) > 2:
        raise UsageError(f"--temperature: expected one number or two as 22:28, found {text!r}")
    return ends[0], ends[-1]


def _payloads(text: str | None) -> tuple[float, ...]:
    from robacc.cli.quantities import numbers
    from robacc.errors import UsageError

    if text is None:
        return ()
    weights = numbers(text, ",", "--payload")
    if min(weights) < 0:
        raise UsageError(f"--payload: a payload is not negative, found {text!r}")
    return weights


def _write(
    done: Simulation, plan: Plan, arm: Robot, robot: str, at: Measurements | None, form: PlainFormat, output: str
) -> None:
    """The CSV to ``output``; with JSON its record to standard output."""
    import dataclasses
    import sys

    from robacc import results
    from robacc.cli.output import emit
    from robacc.io.files import sha256_of, write_text
    from robacc.io.poses_csv import format_poses

    record = results.InputFile.at(robot, sha256_of(robot), "robot")
    inputs = (record,) if at is None else (record, results.InputFile.at(at.source or "", at.sha256 or "", "poses"))
    # Two comments and the header stand above the rows of a file with outliers.
    wrong = [int(row) + 4 for row in done.outliers]
    head = [f"Simulated by robacc simulate from {record.name} with seed {plan.seed}; nothing was measured."]
    head += [f"Outliers on lines {', '.join(map(str, wrong))}"] if wrong else []
    text = "".join(f"# {line}\n" for line in head) + format_poses(done.data)
    if output == "-":
        sys.stdout.write(text)
        sys.stdout.flush()
        return
    write_text(output, text)
    if form is PlainFormat.json:
        names = [str(effect.get("effect")) for effect in arm.effects]
        payload = {"n_poses": done.data.n, "effects": names, "outlier_lines": wrong, "file_sha256": sha256_of(output)}
        emit(
            form,
            "-",
            table=lambda stream: None,
            document=lambda: results.envelope(
                "simulate", payload, options=dataclasses.asdict(plan), inputs=inputs, seed=plan.seed
            ),
        )
