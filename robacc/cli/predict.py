"""``robacc predict``: tolerances in, the accuracy to be expected out; and held against measured poses."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated, Any, TextIO

import typer

from robacc.cli.options import (
    BaseLinkOption,
    ConfidenceOption,
    Format,
    FormatOption,
    GateOption,
    JunitOption,
    OrderedOption,
    OutputOption,
    ReportOption,
    SeedOption,
    TipLinkOption,
    split_list,
)
from robacc.results import InputFile

if TYPE_CHECKING:
    from robacc.grading import Scale
    from robacc.measurements import Measurements
    from robacc.prediction.configurations import Configurations
    from robacc.prediction.parameters import Tolerances
    from robacc.robots.description import Robot

DEFAULT_SAMPLES = 1000


def predict(
    robot: Annotated[str, typer.Argument(metavar="ROBOT", help="Robot file (YAML) or URDF.")],
    poses: Annotated[
        str | None, typer.Option("--poses", metavar="FILE", help="CSV of poses whose joints to predict at.")
    ] = None,
    samples: Annotated[
        int | None,
        typer.Option(
            "--samples", metavar="N", help=f"Configurations over the joint ranges; default {DEFAULT_SAMPLES}."
        ),
    ] = None,
    target: Annotated[
        str | None, typer.Option("--target", metavar="NAME", help="Of several targets, the one that samples are of.")
    ] = None,
    tolerances: Annotated[
        str | None, typer.Option("--tolerances", metavar="FILE", help="Tolerances (YAML) that go before the robot's.")
    ] = None,
    scale: Annotated[
        str | None, typer.Option("--scale", metavar="FILE", help="Grade scale (YAML); default is the package's own.")
    ] = None,
    allocate: Annotated[
        str | None, typer.Option("--allocate", metavar="GRADE", help="Find tolerances that would reach this grade.")
    ] = None,
    against: Annotated[
        str | None,
        typer.Option("--against", metavar="FILE", help="CSV of measured poses to hold the prediction against."),
    ] = None,
    align: Annotated[
        str | None,
        typer.Option("--align", metavar="EFFECT,…", help="Fit base_frame, tool_frame or both to --against first."),
    ] = None,
    noise: Annotated[
        str | None,
        typer.Option("--noise", metavar="P[,R]", help="Measuring noise along an axis: 0.02mm,0.01deg; bare m, rad."),
    ] = None,
    confidence: ConfidenceOption = 0.95,
    per_pose: Annotated[
        str | None, typer.Option("--per-pose", metavar="FILE", help="Write each pose's prediction there, as CSV.")
    ] = None,
    ordered: OrderedOption = False,
    base_link: BaseLinkOption = None,
    tip_link: TipLinkOption = None,
    seed: SeedOption = 0,
    gate: GateOption = None,
    junit: JunitOption = None,
    report: ReportOption = None,
    form: FormatOption = Format.table,
    output: OutputOption = "-",
) -> None:
    """Covariances, error budget and grade to be expected from parameter tolerances.

    At the poses of --poses, else at those of --against, else at configurations spread over the joint ranges.
    """
    from robacc.cli.output import Outlets, deliver
    from robacc.grading import default_scale, load_scale
    from robacc.io.files import read_text
    from robacc.io.robot_file import read_robot
    from robacc.prediction.allocation import allocate as allocated
    from robacc.prediction.comparison import compare_with_measured
    from robacc.prediction.parameters import NORMAL, uncertain_parameters
    from robacc.prediction.predicting import predict_accuracy, step_limits

    _check_options(poses, samples, against, align, noise, target)
    sigma = _noise(noise)
    arm = read_robot(robot, base_link=base_link, tip_link=tip_link)
    given = None if tolerances is None else _tolerances(tolerances, arm)
    grades: Scale = default_scale() if scale is None else load_scale(read_text(scale), scale)
    if allocate is not None:
        step_limits(grades, allocate)
    parameters = uncertain_parameters(arm, given)
    planned = None if poses is None else _read(poses, arm, ordered)
    measured = None if against is None else _read(against, arm, ordered)
    where = _configurations(arm, planned or measured, samples, seed, target)
    found = predict_accuracy(arm, parameters, where, grades, NORMAL if given is None else given.meaning)
    needed = None if allocate is None else allocated(arm, found, allocate)
    compared = None
    if measured is not None:
        compared = compare_with_measured(
            arm,
            measured,
            parameters,
            what=split_list(align),
            noise=sigma,
            confidence=confidence,
            seed=seed,
        )
    options: dict[str, Any] = {
        "samples": where.n if planned is None and measured is None else None,
        "target": target,
        "allocate": allocate,
        "align": list(split_list(align)),
        "noise": noise,
        "confidence": confidence,
        "ordered": ordered,
        "base_link": base_link,
        "tip_link": tip_link,
    }

    def keys() -> dict[str, Any]:
        from robacc.io.predict_json import payload, pose_payload

        return {**payload(found, needed, compared), **pose_payload(found, arm)}

    def table(stream: TextIO) -> None:
        from robacc.report.predict import draw_prediction

        draw_prediction(arm, found, needed, compared, stream)

    if per_pose is not None:
        from robacc.io.files import write_text
        from robacc.io.predict_json import per_pose_csv

        write_text(per_pose, per_pose_csv(found, arm.variable_names))
    read = ((planned, poses, "poses"), (measured, against, "against"))
    warnings = [warning for data in (planned, measured) if data is not None for warning in data.warnings]
    deliver(
        Outlets(form, output, gate, junit, report),
        "predict",
        payload=keys,
        table=table,
        options=options,
        inputs=_records(((robot, "robot"), (tolerances, "tolerances"), (scale, "scale")), read),
        seed=seed,
        warnings=warnings if compared is None or compared.hint is None else [*warnings, compared.hint],
    )


def _check_options(
    poses: str | None,
    samples: int | None,
    against: str | None,
    align: str | None,
    noise: str | None,
    target: str | None,
) -> None:
    from robacc.errors import UsageError

    if poses is not None and samples is not None:
        raise UsageError("--poses and --samples both say where to predict; give one of them")
    if against is not None and samples is not None:
        raise UsageError("--against predicts at the measured poses; leave out --samples")
    if against is None:
        for name, value in (("--align", align), ("--noise", noise)):
            if value is not None:
                raise UsageError(f"{name} is about measured poses, so it needs --against")
    if target is not None and (poses is not None or against is not None):
        raise UsageError("--target is of sampled configurations; the poses of a file name theirs in a column target")
    if poses == "-" and against == "-":
        raise UsageError("standard input can be read once: --poses or --against, not both")


def _records(
    files: Sequence[tuple[str | None, str]], read: Sequence[tuple[Measurements | None, str | None, str]]
) -> list[InputFile]:
    """The record of every file that was given."""
    from robacc.io.files import sha256_of

    records = [InputFile.at(path, sha256_of(path), kind) for path, kind in files if path is not None]
    for data, path, kind in read:
        if data is not None and path is not None:
            records.append(InputFile.at(path, data.sha256 or "", kind))
    return records


def _tolerances(path: str, arm: Robot) -> Tolerances:
    from robacc.io.files import read_text
    from robacc.prediction.tolerance_file import parse_tolerances

    return parse_tolerances(read_text(path), path, arm)


def _read(path: str, arm: Robot, ordered: bool) -> Measurements:
    from robacc.io.robot_poses import read_robot_poses

    return read_robot_poses(path, arm, ordered=ordered)


def _configurations(
    arm: Robot, data: Measurements | None, samples: int | None, seed: int, target: str | None
) -> Configurations:
    from robacc.prediction.configurations import configurations_of, sampled_configurations

    if data is not None:
        return configurations_of(arm, data)
    return sampled_configurations(arm, DEFAULT_SAMPLES if samples is None else samples, seed, target)


def _noise(text: str | None) -> tuple[float | None, float | None]:
    """Position (m) and orientation (rad) of ``--noise``.

    Raises:
        UsageError: it is not one or two sizes above zero.
    """
    from robacc.cli.quantities import quantity
    from robacc.errors import UsageError

    if text is None:
        return None, None
    parts = text.split(",")
    if len(parts) > 2:
        raise UsageError(f"--noise: expected a length and perhaps an angle, as in 0.02mm,0.01deg, found {text!r}")
    return quantity(parts[0], "length", "--noise"), quantity(parts[1], "angle", "--noise") if parts[1:] else None
