"""``robacc export``: a robot model in the format of a controller, a driver or a simulator."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal

from robacc.api.parameters import Help
from robacc.cli.options import Call
from robacc.plug_ins import plug_in_names

_FORMATS = ("urdf", "mdh", "json", "ur-calibration", "ur-kinematics", "xarm", "joint-offsets", "table")
"""Formats of the written model; table and json belong to ``--urdf`` too."""
if TYPE_CHECKING:
    ExportFormat = str
else:
    ExportFormat = Literal[(*_FORMATS, *plug_in_names("robacc.exporters"))]


def export(
    call: Call,
    *,
    format: Annotated[
        ExportFormat | None,
        Help(
            "Format of the file; default: ur-calibration for an arm of Universal Robots. With `urdf`: form of the "
            "summary, table or json."
        ),
    ] = None,
    output: Annotated[
        str | None, Help("File to write; - is standard output.", "FILE", names=("output", "o"), holds="output")
    ] = None,
    urdf: Annotated[
        str | None,
        Help(
            "URDF to write from the numbers as they are, without a fit; - is standard output.", "FILE", holds="output"
        ),
    ] = None,
    document: Annotated[
        str | None, Help("JSON result to write, with the remaining error.", "FILE", holds="output")
    ] = None,
) -> None:
    """Write a robot model for a controller, a driver or a simulator, with the error that remains there.

    Example: robacc export robot.yaml --format mdh --output modified.yaml
    """
    import sys

    from robacc.errors import UsageError
    from robacc.io.files import write_text
    from robacc.render.text import say_warnings
    from robacc.render.views.elements import draw
    from robacc.render.views.expected import export_view

    given = call.keywords
    if urdf is not None:
        if output is not None or document or any(given[name] for name in ("nominal", "arm", "template")):
            raise UsageError("--urdf names the file to write; the other options belong to --format and --output")
        if format not in (None, "table", "json"):
            raise UsageError(f"--urdf writes a URDF, --format {format} another file; use --output with --format")
        _write_urdf(given["model"], urdf, format == "json", given["base_link"], given["tip_link"])
        return
    if format == "table":
        raise UsageError("--format table belongs to --urdf")
    if output is None:
        raise UsageError("name the file to write with --output; - is standard output")
    result = call(format=format)
    say_warnings(result.warnings)
    write_text(output, result.text)
    if document is not None:
        write_text(document, result.to_json())
    draw(export_view(result.payload()), sys.stderr if output == "-" else sys.stdout)


def _write_urdf(model: str, urdf: str, is_json: bool, base_link: str | None, tip_link: str | None) -> None:
    """Write a URDF of the model as it stands, with a warning for every part that a URDF cannot represent."""
    from robacc.api.inputs import load_robot
    from robacc.cli.output import write
    from robacc.documents.descriptions import urdf_payload
    from robacc.documents.envelope import envelope
    from robacc.errors import UsageError
    from robacc.fitting.parameters import absorb_constants
    from robacc.io.files import sha256_of
    from robacc.io.json_text import json_pieces
    from robacc.render.text import say_warnings
    from robacc.robots.urdf_writer import robot_to_urdf

    if is_json and urdf == "-":
        raise UsageError("--format json and --urdf - both write to standard output; name a file for --urdf")
    robot, record = load_robot(model, base_link, tip_link)
    text, losses = robot_to_urdf(absorb_constants(robot))
    write(urdf, (text,))
    say_warnings(f"a URDF cannot represent {loss}" for loss in losses)
    if is_json:
        options, keys = {"base_link": base_link, "tip_link": tip_link}, urdf_payload(sha256_of(urdf), losses)
        write("-", json_pieces(envelope("export", keys, options=options, inputs=(record,), seed=None)))
