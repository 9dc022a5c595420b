"""``robacc check``: a stored result held against a gate."""

from __future__ import annotations

from typing import Annotated

import typer

from robacc.cli.options import Format, FormatOption, JunitOption, OutputOption, ReportOption


def check(
    result: Annotated[
        str, typer.Argument(metavar="RESULT", help="Result of any command as JSON; - reads standard input.")
    ],
    gate: Annotated[str, typer.Option("--gate", metavar="FILE", help="Gate file (YAML): what the result must meet.")],
    junit: JunitOption = None,
    report: ReportOption = None,
    form: FormatOption = Format.table,
    output: OutputOption = "-",
) -> None:
    """Hold a stored result against a gate: exit 0 where it passes, 4 where it fails, 5 where it is undecided.

    Example: robacc estimate poses.csv --format json -o result.json; robacc check result.json --gate assembly.yaml
    """
    from robacc.cli.output import Outlets, conclude, judged
    from robacc.cli.pages import understood
    from robacc.io.gate_files import read_gate
    from robacc.io.gate_json import gate_document
    from robacc.io.read_result import read_result
    from robacc.results import envelope

    loaded = read_gate(gate)
    stored = read_result(result)
    with understood(stored.name, stored.command):
        found = judged(loaded, stored.document)
    document = envelope(
        "check",
        {
            "result": {key: stored.document.get(key) for key in ("schema", "robacc", "command", "inputs")},
            "gate": gate_document(found),
        },
        options={},
        inputs=(stored.record, *loaded.records),
        seed=None,
    )
    conclude(Outlets(form, output, gate, junit, report), "check", document, None, found)
