"""``robacc simulate``: simulated measurements of a robot with the effects of its file."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

import typer

from robacc.cli.options import (
    BaseLinkOption,
    CampaignOption,
    CampaignUseName,
    IgnoreLimitsOption,
    OutputOption,
    PlainFormat,
    PlainSummaryFormatOption,
    SeedOption,
    StrictRangeOption,
    TipLinkOption,
    numbers_of,
)


class Sampling(StrEnum):
    """Distribution of the joint variables within their limits."""

    even = "even"
    random = "random"


def simulate(
    robot: Annotated[str, typer.Argument(metavar="ROBOT", help="Robot file (YAML), URDF, or name of an arm.")],
    poses: Annotated[
        int | None,
        typer.Option("--poses", metavar="N", min=1, max=1_000_000, help="Number of commanded poses to sample."),
    ] = None,
    at: Annotated[
        str | None, typer.Option("--at", metavar="FILE", help="CSV of commanded poses, in the order visited.")
    ] = None,
    ignore_limits: IgnoreLimitsOption = False,
    seed: SeedOption = 0,
    cycles: Annotated[
        int, typer.Option("--cycles", metavar="N", min=1, max=100_000, help="Number of visits to every commanded pose.")
    ] = 1,
    sampling: Annotated[
        Sampling,
        typer.Option("--sampling", help="Low-discrepancy sequence, or uniform distribution of the joint variables."),
    ] = Sampling.even,
    noise: Annotated[
        str,
        typer.Option(
            "--noise",
            metavar="SIZE",
            help="Standard deviation of the measurement noise along each axis, such as 0.02mm.",
        ),
    ] = "0",
    noise_orientation: Annotated[
        str,
        typer.Option(
            "--noise-orientation", metavar="SIZE", help="Standard deviation about each axis, such as 0.005deg."
        ),
    ] = "0",
    sigma: Annotated[
        bool, typer.Option("--sigma", help="Write the noise as columns sigma_x, sigma_y, sigma_z, sigma_r.")
    ] = False,
    outliers: Annotated[int, typer.Option("--outliers", metavar="K", min=0, help="Number of outliers.")] = 0,
    outlier_size: Annotated[
        str, typer.Option("--outlier-size", metavar="SIZE", help="Position error of an outlier, such as 5mm.")
    ] = "10mm",
    position_only: Annotated[
        bool, typer.Option("--position-only/--orientation", help="Measure position only, or position and orientation.")
    ] = False,
    commanded: Annotated[
        bool, typer.Option("--commanded", help="Write cmd_ columns with the poses of the robot without its effects.")
    ] = False,
    motion: Annotated[
        bool,
        typer.Option(
            "--motion/--no-motion", help="Write direction and speed of approach, from the order of the poses."
        ),
    ] = True,
    time_step: Annotated[
        float | None,
        typer.Option("--time-step", metavar="S", min=0.0, help="Seconds between poses, written as time_s."),
    ] = None,
    temperature: Annotated[
        str | None,
        typer.Option("--temperature", metavar="C[:C]", help="Constant temperature, or a warm-up such as 22:28."),
    ] = None,
    payload: Annotated[
        str | None,
        typer.Option("--payload", metavar="KG,…", help="Payloads; each pose has one of them, chosen at random."),
    ] = None,
    campaign: CampaignOption = CampaignUseName.auto,
    strict_range: StrictRangeOption = False,
    base_link: BaseLinkOption = None,
    tip_link: TipLinkOption = None,
    form: PlainSummaryFormatOption = PlainFormat.table,
    output: OutputOption = "-",
) -> None:
    """Simulate measured poses of a robot with the effects of its file, and write them as a CSV.

    The simulation uses the exact nonlinear model.

    Example: robacc simulate robot.yaml --poses 60 --seed 1 --noise 0.03mm --output simulated.csv
    """
    import sys

    from robacc.api.simulate import simulate as run_simulate
    from robacc.cli.call_checks import refuse_json_beside_csv
    from robacc.cli.output import emit
    from robacc.render.text.console import say_warnings

    refuse_json_beside_csv(form, output)
    result = run_simulate(
        robot,
        poses=poses,
        at=at,
        ignore_limits=ignore_limits,
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
        campaign=campaign.value,
        strict_range=strict_range,
        base_link=base_link,
        tip_link=tip_link,
    )
    say_warnings(result.data.warnings)
    if output == "-":
        sys.stdout.writelines(result.csv_pieces())
        sys.stdout.flush()
        return
    result.write(output)
    if form is PlainFormat.json:
        emit(form, "-", table=lambda stream: None, document=result.document)


def _temperature(text: str | None) -> tuple[float, float] | None:
    from robacc.errors import UsageError

    if text is None:
        return None
    ends = numbers_of(text, ":", "--temperature")
    if len(ends) > 2:
        raise UsageError(f"--temperature: expected a number, or two such as 22:28, found {text!r}")
    return ends[0], ends[-1]


def _payloads(text: str | None) -> tuple[float, ...]:

    return () if text is None else numbers_of(text, ",", "--payload")
