"""``robacc simulate``: a CSV of measured poses of a robot that has the effects its file lists."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

import typer

from robacc.cli.options import BaseLinkOption, OutputOption, PlainFormat, PlainFormatOption, SeedOption, TipLinkOption


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
    """A CSV of simulated poses, exact and nonlinear, with the effects that the robot file lists.

    Example: robacc simulate robot.yaml --poses 60 --seed 1 --noise 0.03mm --output simulated.csv
    """
    import sys

    from robacc.api.simulate import simulate as simulated
    from robacc.errors import UsageError

    if form is PlainFormat.json and output == "-":
        raise UsageError("--format json tells of the file that --output names; name one")
    found = simulated(
        robot,
        poses=poses,
        at=at,
        seed=seed,
        cycles=cycles,
        sampling=sampling.value,
        noise=noise,
        noise_orientation=noise_orientation,
        sigma=sigma,
        outliers=outliers,
        outlier_size=outlier_size,
        position_only=position_only,
        commanded=commanded,
        motion=motion,
        time_step=time_step,
        temperature=_temperature(temperature),
        payload=_payloads(payload),
        base_link=base_link,
        tip_link=tip_link,
    )
    if output == "-":
        sys.stdout.writelines(found.csv_pieces())
        sys.stdout.flush()
        return
    found.write(output)
    if form is PlainFormat.json:
        from robacc.cli.output import emit

        emit(form, "-", table=lambda stream: None, document=found.document)


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

    return () if text is None else numbers(text, ",", "--payload")
