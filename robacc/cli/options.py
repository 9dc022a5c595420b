"""Options that commands add to those of their calls: forms and files of results."""

from __future__ import annotations

import os
from functools import partial
from typing import Annotated, Any, Literal, NamedTuple

from robacc.api.parameters import Help
from robacc.errors import UsageError

Call = partial[Any]
"""Call of a command with the arguments of its options."""
Format = Literal["table", "json", "markdown", "github"]
PlainFormat = Literal["table", "json"]
_FORM = "Form of the output: github writes annotations of a run, markdown a job summary."

Output = Annotated[str, Help("File to write; - is standard output.", "FILE", names=("output", "o"), holds="output")]
SummaryFormat = Annotated[Format, Help(_FORM)]
"""Form of the summary of a command whose ``--output`` is a file of targets."""
WriteModel = Annotated[str | None, Help("Robot file to write, with the fitted model.", "FILE", holds="output")]
Report = Annotated[str | None, Help("HTML page to write, with charts and tables.", "FILE", holds="output")]


class Outlets(NamedTuple):
    """Forms and files of a result."""

    gate: Annotated[str | None, Help("Gate file (YAML) with criteria; exit 4: fail, 5: inconclusive.", "FILE")] = None
    junit: Annotated[str | None, Help("JUnit XML to write, with the outcome of the gate.", "FILE", holds="output")] = (
        None
    )
    report: Report = None
    format: Annotated[Format | None, Help(f"{_FORM} Default: by the ending of `output`, .json or .md, else table.")] = (
        None
    )
    output: Output = "-"

    @property
    def form(self) -> Format:
        """Form of the result: that of ``--format``, else JSON or Markdown if the output's name ends so."""
        ending = os.path.splitext(self.output)[1].lower()
        return self.format or ("json" if ending == ".json" else "markdown" if ending == ".md" else "table")


class PlainOutlets(NamedTuple):
    """Form and file of output that no gate applies to."""

    format: Annotated[
        PlainFormat | None, Help("Form of the output; default: json if `output` ends in .json, else table.")
    ] = None
    output: Output = "-"

    @property
    def form(self) -> PlainFormat:
        """Form of the output: that of ``--format``, else JSON if the output's name ends so."""
        return self.format or ("json" if self.output.lower().endswith(".json") else "table")


class CsvOutlets(NamedTuple):
    """File of a command that writes a CSV, and form of the summary on standard output."""

    format: Annotated[PlainFormat, Help("Form of the output.")] = "table"
    output: Annotated[
        str | None,
        Help(
            "CSV to write; - is standard output, without the summary.",
            "FILE",
            names=("output", "o"),
            holds="output",
        ),
    ] = None

    def check(self) -> None:
        """Refuse a JSON document where the CSV would go to standard output too.

        Raises:
            UsageError: The format is JSON and the CSV has no file.
        """
        if self.format == "json" and self.output == "-":
            raise UsageError("--format json needs --output, the CSV that it describes")
