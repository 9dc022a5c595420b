"""Options that several commands share, declared once so that they are spelled and explained alike."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

import typer


class Format(StrEnum):
    """How a result is written."""

    table = "table"
    json = "json"
    markdown = "markdown"
    github = "github"


class PlainFormat(StrEnum):
    """How something is written that is no result to judge."""

    table = "table"
    json = "json"


PosesArgument = Annotated[
    str, typer.Argument(metavar="POSES", help="CSV or Parquet of measured poses; - reads standard input.")
]
RobotOption = Annotated[
    str | None, typer.Option("--robot", metavar="FILE", help="Robot file (YAML) or URDF that commands the poses.")
]
BaseLinkOption = Annotated[
    str | None, typer.Option("--base-link", metavar="NAME", help="URDF: the link that the chain starts at.")
]
TipLinkOption = Annotated[
    str | None, typer.Option("--tip-link", metavar="NAME", help="URDF: the link that the chain ends at.")
]
OrderedOption = Annotated[
    bool,
    typer.Option("--ordered", help="Rows are in the order measured; directions and speeds are derived from it."),
]
FormatOption = Annotated[
    Format,
    typer.Option("--format", help="A table to read, JSON for programs, a job's summary, or annotations of a run."),
]
PlainFormatOption = Annotated[PlainFormat, typer.Option("--format", help="A table to read, or JSON for programs.")]
OutputOption = Annotated[
    str, typer.Option("--output", "-o", metavar="FILE", help="Write there, whole or not at all; - is standard output.")
]
GateOption = Annotated[
    str | None,
    typer.Option("--gate", metavar="FILE", help="Judge the result by this gate file (YAML); exit 4 fail, 5 undecided."),
]
JunitOption = Annotated[
    str | None, typer.Option("--junit", metavar="FILE", help="Write the gate's outcome there, as JUnit XML.")
]
ReportOption = Annotated[
    str | None, typer.Option("--report", metavar="FILE", help="Write the result there, as one HTML page.")
]
ScaleOption = Annotated[
    str | None, typer.Option("--scale", metavar="FILE", help="Grade scale (YAML); default is the package's own.")
]
SeedOption = Annotated[
    int, typer.Option("--seed", metavar="N", min=0, help="Seed of everything drawn at random, bootstrap included.")
]
ConfidenceOption = Annotated[
    float, typer.Option("--confidence", metavar="P", help="Confidence of every interval, between 0.5 and 1.")
]
OUTPUTS = frozenset({"output", "per_pose", "write_model", "junit", "report", "urdf"})
"""Parameters of commands that name a file to write."""
