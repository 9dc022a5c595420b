"""``robacc correct``: commands that make the real arm reach its targets, from a model of the arm."""

from __future__ import annotations

import sys
from typing import Annotated

from robacc.api.parameters import Help
from robacc.cli.options import Call, Outlets, SummaryFormat

_OF_CSV = ("frame", "base_link", "tip_link")
"""Parameters that a program has no use for: its own frames and the model's arm hold."""


def correct(
    call: Call,
    *,
    per_target: Annotated[
        str | None, Help("CSV of commands, corrections and expected errors.", "FILE", holds="output")
    ] = None,
    frames: Annotated[
        list[str] | None, Help("Tools and bases that a program only names; may be repeated.", "FILE")
    ] = None,
    format: SummaryFormat = "table",
    outlets: Outlets,
) -> None:
    """Compute the commands that make the real arm reach its targets, from a model of the arm.

    A robot program (KUKA .src, .dat, ABB .mod, FANUC .ls, URScript .script, Staubli .dtx) becomes the same program with
    other numbers in its targets, in the frames of the program. The CSV has the joints to command, and the wanted poses
    as cmd_ columns. With --output, the corrections and the expected errors are written to standard output. A target
    that cannot be corrected keeps its nominal command.

    Example: robacc correct targets.csv --model model.yaml --nominal robot.yaml --output corrected.csv
    """
    from robacc.api.correct import correct_program
    from robacc.cli.output import deliver, write
    from robacc.errors import UsageError
    from robacc.io.files import write_bytes, write_text
    from robacc.poses.reading import AS_NAMED, reading_of
    from robacc.programs.reading import is_program
    from robacc.render.text import warnings_below
    from robacc.render.views.elements import draw
    from robacc.render.views.expected import correction_text

    output, given = outlets.output, call.keywords
    targets = given["targets"]
    names = targets, given["model"]
    outlets = outlets._replace(format=format, output="-")
    is_plain = outlets == Outlets(format="table")
    if is_program(targets):
        if output == "-" or not is_plain or per_target or given["frame"] == "base":
            raise UsageError(
                "a program needs --output, and takes no --format, --gate, --report, --per-target and --frame"
            )
        if reading_of(targets) != AS_NAMED:
            raise UsageError(
                "a program states its own units and angles; leave out --angles, --units, --columns, --skip-gaps and "
                "--sheet"
            )
        options = {name: value for name, value in given.items() if name not in ("targets", *_OF_CSV)}
        corrected = correct_program(targets, frames=frames or [], **options)
        with warnings_below(corrected.warnings):
            write_bytes(output, corrected.data)
            draw(
                correction_text(
                    [part.payload() for part in corrected.corrections], len(corrected.program.targets), names, output
                ),
                sys.stdout,
            )
            sys.stdout.flush()
        return
    if frames:
        raise UsageError("--frames belongs to a robot program")
    if output == "-" and not is_plain:
        raise UsageError("--format json, --gate, --junit and --report need --output, the CSV that they describe")
    result = call()
    if per_target is not None:
        write_text(per_target, result.per_target_csv())
    if output == "-":
        with warnings_below(result.warnings):
            write("-", result.csv_pieces())
        return
    result.write(output)
    deliver(
        outlets,
        result,
        lambda stream: draw(correction_text([result.payload()], result.n_targets, names, output), stream),
    )
