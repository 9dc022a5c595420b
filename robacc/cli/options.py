"""Options that several commands share, declared once so that every command spells and explains them the same."""

from __future__ import annotations

import math
import os
from enum import StrEnum
from typing import Annotated

import typer

_FORMS = {".json": "json", ".md": "markdown"}
"""Form of a result by the ending of its file, where ``--format`` is not given."""
_DEFAULT = "json or markdown if --output ends in .json or .md, else table"
_FORM_HELP = "Form of the output: github writes annotations of a run, markdown a job summary."


class Format(StrEnum):
    """Form of a result."""

    table = "table"
    json = "json"
    markdown = "markdown"
    github = "github"


class PlainFormat(StrEnum):
    """Form of output that no gate applies to."""

    table = "table"
    json = "json"


def form_of_output(context: typer.Context, form: Format | PlainFormat) -> Format | PlainFormat:
    """Return the form of a result: that of ``--format``, else JSON or Markdown if the output's name ends so."""
    source = context.get_parameter_source("form")
    if source is None or source.name != "DEFAULT":
        return form
    ending = os.path.splitext(str(context.params.get("output")))[1].lower()
    return next((member for member in type(form) if _FORMS.get(ending) == member.value), form)


class CampaignUseName(StrEnum):
    """Use of the facts of the campaign that a model was fitted in."""

    auto = "auto"
    keep = "keep"
    drop = "drop"


PosesArgument = Annotated[
    str,
    typer.Argument(
        metavar="POSES", help="Measured poses: CSV, export, workbook, Parquet or ROS bag; - reads standard input."
    ),
]
RobotOption = Annotated[
    str | None,
    typer.Option(
        "--robot", metavar="FILE", help="Robot file (YAML), URDF, or name of an arm that robacc robots lists."
    ),
]
BaseLinkOption = Annotated[
    str | None, typer.Option("--base-link", metavar="NAME", help="First link of the chain in a URDF.")
]
TipLinkOption = Annotated[
    str | None,
    typer.Option("--tip-link", metavar="NAME", help="Last link of the chain in a URDF; default: by the joint columns."),
]
AlignOption = Annotated[
    str | None,
    typer.Option(
        "--align",
        metavar="FRAME,…",
        help="Frames to fit to the poses of each file first: base_frame, tool_frame, both, or none.",
    ),
]
OrderedOption = Annotated[
    bool,
    typer.Option(
        "--ordered",
        help="Rows are in the order of measurement; directions and speeds of the joints are derived from it.",
    ),
]
IgnoreLimitsOption = Annotated[
    bool,
    typer.Option(
        "--ignore-limits",
        help="Only warn of joint values outside the limits; by default, more than 0.05 deg or 0.5 mm is an error.",
    ),
]
CampaignOption = Annotated[
    CampaignUseName,
    typer.Option(
        "--campaign",
        help="Apply drift and other effects of the campaign in which a model was measured; auto: if they fit.",
    ),
]
StrictRangeOption = Annotated[
    bool, typer.Option("--strict-range", help="Refuse poses outside the validity range of the model (exit 3).")
]
FormatOption = Annotated[
    Format, typer.Option("--format", help=_FORM_HELP, callback=form_of_output, show_default=_DEFAULT)
]
PlainFormatOption = Annotated[
    PlainFormat,
    typer.Option(
        "--format",
        help="Form of the output.",
        callback=form_of_output,
        show_default="json if --output ends in .json, else table",
    ),
]
SummaryFormatOption = Annotated[Format, typer.Option("--format", help=_FORM_HELP)]
"""For commands whose ``--output`` is a file of targets: the form of the summary on standard output."""
PlainSummaryFormatOption = Annotated[PlainFormat, typer.Option("--format", help="Form of the output.")]
"""For commands whose ``--output`` is a CSV: the form of the summary on standard output."""
OutputOption = Annotated[
    str, typer.Option("--output", "-o", metavar="FILE", help="File to write; - is standard output.")
]
GateOption = Annotated[
    str | None,
    typer.Option("--gate", metavar="FILE", help="Gate file (YAML) with criteria; exit 4: fail, 5: inconclusive."),
]
JunitOption = Annotated[
    str | None, typer.Option("--junit", metavar="FILE", help="JUnit XML to write, with the outcome of the gate.")
]
ReportOption = Annotated[
    str | None, typer.Option("--report", metavar="FILE", help="HTML page to write, with charts and tables.")
]
ScaleOption = Annotated[
    str | None, typer.Option("--scale", metavar="FILE", help="Grade scale (YAML) in place of the built-in scale.")
]
SeedOption = Annotated[
    int, typer.Option("--seed", metavar="N", min=0, help="Seed of the random numbers, bootstrap included.")
]
ConfidenceOption = Annotated[
    float, typer.Option("--confidence", metavar="P", help="Confidence level of every interval, between 0.5 and 1.")
]
NeededRobotOption = Annotated[
    str,
    typer.Option(
        "--robot", metavar="FILE", help="Robot file (YAML), URDF, or name of an arm that robacc robots lists."
    ),
]
WriteModelOption = Annotated[
    str | None, typer.Option("--write-model", metavar="FILE", help="Robot file to write, with the fitted model.")
]
HoldoutOption = Annotated[
    str | None,
    typer.Option("--holdout", metavar="FILE", help="CSV of validation poses, in place of held-out poses of POSES."),
]
FoldsOption = Annotated[
    int | None,
    typer.Option(
        "--folds",
        metavar="K",
        min=2,
        max=50,
        help="Parts of the poses that are held out in turn; default: each pose in turn, with those close to it.",
    ),
]
OUTPUTS = frozenset(
    {
        *("output", "per_pose", "per_target", "write_model", "junit", "report", "urdf", "document"),
        *("validation_output", "program", "warranty_map"),
    }
)
"""Parameters of commands that name files to write."""


# Lists of numbers as the text of an option.


def numbers_of(text: str, separator: str, option: str) -> tuple[float, ...]:
    """Return the finite numbers of a list.

    Raises:
        UsageError: a part of the list is not a finite number.
    """
    from robacc.errors import UsageError

    try:
        values = tuple(float(part) for part in text.split(separator))
    except ValueError:
        values = (math.nan,)
    if not all(map(math.isfinite, values)):
        raise UsageError(f"{option}: expected numbers separated by {separator!r}, found {text!r}")
    return values
