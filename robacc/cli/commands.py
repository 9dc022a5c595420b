"""The commands: for each what it adds to its call, and how the result is shown.

A function has the name of its call in :mod:`robacc.api`, and its docstring is the text of ``--help``. The parameter
``call`` gets the call with the arguments of its options, ``outlets`` the options of :class:`Outlets`.
"""

import os
import sys
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import PurePath
from typing import Annotated, Literal

import typer

from robacc.api.parameters import BaseLink, Help, IgnoreLimits, OptionalRobot, Ordered, TipLink
from robacc.cli.output import (
    Call,
    CsvFormat,
    CsvOutput,
    Outlets,
    Output,
    PlainFormat,
    Report,
    SummaryFormat,
    WriteModel,
    deliver,
    emit,
    progress_bar,
    write,
    write_extra,
)
from robacc.errors import Note, Problem, UsageError, refuse
from robacc.plug_ins import plug_in
from robacc.render.text import draw, say_warnings, warnings_below

# Measured poses.

PoseFiles = Annotated[
    list[str],
    Help(
        "Measured poses: CSV, export, workbook, Parquet, ROS bag, folder of photos or Parquet; - reads standard input.",
        "POSES [POSES …]",
        holds="measured poses",
    ),
]


def estimate(
    call: Call,
    poses: PoseFiles,
    *,
    per_pose: Annotated[str | None, Help("CSV to write with the error of each pose.", "FILE", holds="output")] = None,
    full: Annotated[bool, Help("Table with covariances, principal axes, tests, worst poses and limitations.")] = False,
    outlets: Outlets,
) -> None:
    """Compute the Cartesian error of measured poses, its covariances and the accuracy grade.

    With --robot, the commanded pose is the robot's pose at the commanded joints; without, it is read from the cmd_
    columns. Several files, such as DIR/*.csv, are estimated one by one and shown in one table; an error in one file
    does not stop the others. With --output DIR/ each result becomes a file in that folder.

    Example: robacc estimate poses.csv --robot robot.yaml --align base_frame,tool_frame
    """
    _measured("estimate", call, poses, per_pose, outlets, full)


def trace(
    call: Call,
    poses: PoseFiles,
    *,
    write_model: WriteModel = None,
    full: Annotated[bool, Help("Table with candidates, tests, coefficients, errors and detection limits.")] = False,
    outlets: Outlets,
) -> None:
    """Find the effects that explain the residual, and report the error before and after on held-out poses.

    Several files are traced one by one and shown in one table, as estimate does.

    Example: robacc trace poses.csv --robot robot.yaml --write-model better.yaml
    """
    _measured("trace", call, poses, write_model, outlets, full)


def calibrate(
    call: Call,
    poses: PoseFiles,
    *,
    write_model: WriteModel = None,
    full: Annotated[bool, Help("Table with coefficients, errors before and after, and quality of the fit.")] = False,
    outlets: Outlets,
) -> None:
    """Fit named effects to measured poses, and report fitted and held-out errors before and after.

    An effect with joints in brackets is fitted to these joints. Without brackets it is fitted to the joints where the
    data show it. Several files are calibrated one by one and shown in one table, as estimate does.

    Example: robacc calibrate poses.csv --robot robot.yaml --fit base_frame,tool_frame --write-model better.yaml
    """
    _measured("calibrate", call, poses, write_model, outlets, full)


def _measured(command: str, call: Call, poses: Sequence[str], extra: str | None, outlets: Outlets, full: bool) -> None:
    """Run a call on a file of poses with a progress bar and deliver its result, or run it on each of several files.

    ``extra`` is the file for the error of each pose, or for the model of a fit.
    """
    if len(poses) > 1:
        from robacc.cli.many import process_each

        return process_each(command, poses, call.keywords, outlets, extra, full)
    with progress_bar() as progress:
        if command != "estimate":
            progress("starting", 0, 0)
        result = call(poses[0], progress=progress)
    from robacc.poses.reading import READING, PoseFile

    path = PoseFile(poses[0], **{name: value for name, value in call.keywords.items() if name in READING})
    view, status = write_extra(command, result, extra, full, path, call.keywords["robot"])
    deliver(outlets, result, view)
    if status and extra is not None and result.suspicions:
        say_warnings((f"{extra} must not be used until the suspected data mistake is resolved",))
    if status:
        raise typer.Exit(status)


def iso9283(
    call: Call,
    *,
    full: Annotated[bool, Help("Table with criteria by pose, conditions, methods and limitations.")] = False,
    outlets: Outlets,
) -> None:
    """Compute the pose criteria of ISO 9283 from cycles of commanded poses.

    The result also lists which conditions of the standard the measurement meets.

    With --robot, the commanded pose is the robot's pose at the commanded joints; without, it is read from the cmd_
    columns. If neither is known, a column pose says which visits are of one pose, and the result has repeatability
    but no accuracy.

    Example: robacc iso9283 cycles.csv --robot robot.yaml
    """
    from robacc.render.views.accuracy import iso9283_view

    result, robot = call(), call.keywords["robot"]
    deliver(outlets, result, lambda: iso9283_view(result.payload(), robot, "full" if full else "short"))


# Models.


def predict(
    call: Call,
    *,
    per_pose: Annotated[
        str | None, Help("CSV to write with the prediction at each pose.", "FILE", holds="output")
    ] = None,
    warranty_map: Annotated[
        str | None, Help("CSV to write with the errors and the grade by voxel.", "FILE", holds="output")
    ] = None,
    voxel: Annotated[str, Help("Edge of a voxel of `warranty_map`, such as 50mm.", "SIZE")] = "100mm",
    outlets: Outlets,
) -> None:
    """Predict covariances, error budget and grade from parameter tolerances or the fit of a model file.

    The prediction is for the joints of --poses, else of --against, else for configurations over the joint ranges. With
    a model that --write-model wrote, it is for the calibrated arm; with --tolerances, it is for arms made with these
    tolerances.

    Example: robacc predict robot.yaml --tolerances tolerances.yaml --allocate C
    """
    from robacc.render.views.expected import prediction_view

    result = call()
    write(warranty_map, lambda: result.map_csv(voxel))
    write(per_pose, result.per_pose_csv)
    source = "" if result.comparison is None else result.measured.source or "the data"
    deliver(outlets, result, lambda: prediction_view(result.payload(), source, "full"))


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
    from robacc.poses.reading import AS_NAMED, reading_of
    from robacc.programs.program import LISTINGS, is_program
    from robacc.render.views.expected import correction_text

    given, output = call.keywords, outlets.output
    targets, names = given["targets"], (given["targets"], given["model"])
    outlets = outlets._replace(format=format, output="-")
    is_plain = outlets == Outlets(format="table")
    if is_program(targets) and not targets.lower().endswith(LISTINGS):
        refuse(
            (
                output == "-" or not is_plain or per_target or given["frame"] == "base",
                "a program needs --output, and takes no --format, --gate, --report, --per-target and --frame",
            ),
            (
                reading_of(targets) != AS_NAMED,
                "a program states its own units and angles; leave out --angles, --units, --columns, --skip-gaps and "
                "--sheet",
            ),
        )
        # The program's own frames and the model's arm hold.
        options = {name: given[name] for name in given if name not in ("targets", "frame", "base_link", "tip_link")}
        program = correct_program(targets, frames=frames or [], **options)
        with warnings_below(program.warnings):
            write(output, program.data)
            parts = [part.payload() for part in program.corrections]
            draw(correction_text(parts, len(program.program.targets), names, output))
        return
    needs = "--format json, --gate, --junit and --report need --output, the CSV that they describe"
    refuse(
        (frames, "--frames belongs to a robot program"),
        (output == "-" and not is_plain, needs),
        (output.lower().endswith(LISTINGS), f"a file such as {output} is not written; name a CSV with --output"),
    )
    result = call()
    write(per_target, result.per_target_csv)
    with warnings_below(result.warnings if output == "-" else ()):
        write(output, result.csv_pieces)
    if output != "-":
        deliver(outlets, result, lambda: correction_text([result.payload()], result.n_targets, names, output))


def simulate(call: Call, *, format: CsvFormat = "table", output: Output = "-") -> None:
    """Simulate measured poses of a robot with the effects of its file, and write them as a CSV.

    The simulation uses the exact nonlinear model.

    Example: robacc simulate robot.yaml --poses 60 --seed 1 --noise 0.03mm --output simulated.csv
    """
    refuse(_csv_form(format, output))
    result = call()
    say_warnings(result.data.warnings)
    write(output, result.csv_pieces)
    write("-" if format == "json" else None, result.to_json)


def export(
    call: Call,
    *,
    format: Annotated[
        Literal["table", "json"] | None,
        Help(
            "Format of the file; default: ur-calibration for an arm of Universal Robots. With `urdf`: form of the "
            "summary, table or json.",
            group="robacc.exporters",
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
    from robacc.render.views.expected import export_view

    if urdf is not None:
        others = (output, document, *(call.keywords[name] for name in ("nominal", "arm", "template")))
        refuse(
            (any(others), "--urdf names the file to write; the other options belong to --format and --output"),
            (
                format not in (None, "table", "json"),
                f"--urdf writes a URDF, --format {format} another file; use --output with --format",
            ),
            (
                format == "json" and urdf == "-",
                "--format json and --urdf - both write to standard output; name a file for --urdf",
            ),
        )
        return _write_urdf(call, urdf, format == "json")
    refuse(
        (format == "table", "--format table belongs to --urdf"),
        (output is None, "name the file to write with --output; - is standard output"),
    )
    result = call(format=format)
    say_warnings(result.warnings)
    write(output, result.text)
    write(document, result.to_json)
    draw(export_view(result.payload()), sys.stderr if output == "-" else sys.stdout)


def _write_urdf(call: Call, urdf: str, is_json: bool) -> None:
    """Write a URDF of the model as it stands, with a warning for every part that a URDF cannot represent."""
    from robacc.api.inputs import Inputs
    from robacc.fitting.parameters import absorb_constants
    from robacc.io.files import sha256_of
    from robacc.io.json_text import json_pieces

    inputs = Inputs({name: call.keywords[name] for name in ("base_link", "tip_link")})
    text, losses = plug_in("robacc.exporters", "urdf")(absorb_constants(inputs.robot(call.keywords["model"])))
    write(urdf, text)
    say_warnings(f"a URDF cannot represent {loss}" for loss in losses)
    if is_json:
        # The keys of a URDF whose numbers are not fitted again.
        keys = {"format": "urdf", **dict.fromkeys(("file_sha256", "urdf_sha256"), sha256_of(urdf))}
        write("-", json_pieces(inputs.made().document("export", {**keys, "not_carried": [*losses]})))


# Plans.


def plan(
    call: Call,
    *,
    format: CsvFormat = "table",
    output: CsvOutput = None,
    validation_output: Annotated[str | None, Help("File for the validation poses.", "FILE", holds="output")] = None,
    program: Annotated[
        str | None, Help("File for a robot program: .src, .mod, .ls or .script.", "FILE", holds="output")
    ] = None,
    full: Annotated[
        bool, Help("Summary with all predicted errors, standard errors, detection limits and similar effects.")
    ] = False,
    report: Report = None,
) -> None:
    """Plan a measurement: choose the poses worth measuring, order them, and predict the result.

    The CSV of --output lists the visits in order. --for iso9283 plans the cube of ISO 9283 and its five poses, with
    options of its own: robacc plan --for iso9283 --help.

    Example: robacc plan robot.yaml --for calibrate --poses 30 --output plan.csv
    """
    from robacc.render.views.expected import plan_view

    are_together = (validation_output is None) == (call.keywords["validation"] == 0)
    refuse(_csv_form(format, output), (not are_together, "--validation N and --validation-output FILE belong together"))
    result = call()
    with warnings_below(result.warnings):
        programs = {} if program is None else result.programs(program)
        write(validation_output, result.validation_csv)
        for path, text in programs.items():
            write(path, text)
        if report is not None:
            result.report(report)
        write(output, result.csv_pieces)
        robot = str(call.keywords["model"] or call.keywords["robot"])
        if output != "-":
            view = partial(plan_view, form="full" if full else "short", robot=robot, output=output)
            emit(format, "-", lambda: view(result.document()), result.document)


def iso9283_poses(call: Call, *, format: CsvFormat = "table", output: CsvOutput = None) -> None:
    """Plan the cube of ISO 9283 and its five poses for an arm.

    The CSV of --output has pose, cycle, joints and commanded pose. Add the measured x, y, z and orientation, and
    robacc iso9283 reads it.

    Example: robacc plan robot.yaml --for iso9283 --payload 6 --output plan.csv
    """
    refuse(_csv_form(format, output))
    result = call()
    write(output, result.csv_pieces)
    if output != "-":
        emit(format, "-", result.view, result.document)


def _csv_form(format: str, output: str | None) -> tuple[bool, str]:
    """Return whether a JSON document would go to standard output beside the CSV, and what is said of it."""
    return format == "json" and output == "-", "--format json needs --output, the CSV that it describes"


# Stored results.


def check(
    call: Call, *, gate: Annotated[str, Help("Gate file (YAML) with the criteria.", "FILE")], outlets: Outlets
) -> None:
    """Check a stored result against a gate; exit 0: pass, 4: fail, 5: inconclusive.

    Example: robacc check result.json --gate gate.yaml
    """
    deliver(outlets, call(gate=gate), tuple)


def compare(
    call: Call,
    *,
    paired: Annotated[bool, Help("Compare two CSVs of the same targets, before and after a correction.")] = False,
    model: Annotated[str | None, Help("With `paired`: model of the correction.", "FILE")] = None,
    nominal: Annotated[str | None, Help("With `paired`: nominal robot, for CSVs without cmd_ columns.", "FILE")] = None,
    noise: Annotated[str | None, Help("With `paired`: measurement noise along each axis.", "SIZE")] = None,
    outlets: Outlets,
) -> None:
    """Compare stored results or files of poses: significant differences, ranking and confirmed grades.

    Differences are paired if the results have the same poses. Files of poses are estimated first, as robacc estimate
    does with --robot and --align. A prediction is not ranked with measured arms.

    --paired compares two CSVs of the same targets, measured before and after a correction: the gain, what remains, and
    whether the correction was loaded.

    Example: robacc compare arm1.json arm2.json --grade D
    """
    from robacc.api.stored import compare_paired
    from robacc.render.views.compare import comparison_view, paired_view

    targets = {"model": model, "nominal": nominal, "noise": noise}
    stored = {name: call.keywords.get(name) for name in ("baseline", "by", "grade", "scale", "robot", "align")}
    stored |= {"gate": outlets.gate, "report": outlets.report}
    why = "compares stored results; leave it out with --paired" if paired else "needs --paired"
    refuse(*((value is not None, f"--{name} {why}") for name, value in (stored if paired else targets).items()))
    if not paired:
        result = call()
        return deliver(outlets, result, lambda: comparison_view(result.payload(), "full"))
    refuse((len(call.args) != 2, f"--paired compares two CSVs, before and after a correction, found {len(call.args)}"))
    changes = compare_paired(*call.args, model=model, nominal=nominal, noise=noise)
    deliver(outlets, changes, lambda: paired_view(changes.payload(), call.args))


_PICTURES = (".svg", ".png", ".pdf")


def report(
    results: Annotated[list[str], Help("Results of any command as JSON; - reads standard input.", "RESULT [RESULT …]")],
    *,
    identity: Annotated[
        list[str] | None,
        Help(
            "What was tested, as a YAML file or as serial_number=12345, customer=…; may be repeated. It replaces what "
            "the robot file states under identity.",
            "FILE|KEY=TEXT",
        ),
    ] = None,
    chart: Annotated[
        str | None,
        Help(
            "Kind of the chart to write in place of the page; default for `output` .svg, .png, .pdf: the main chart, "
            "and a note of others.",
            "KIND",
            names=("chart", "kind"),
        ),
    ] = None,
    number: Annotated[int, Help("Number of the chart among several of its kind.", "N", least=1)] = 1,
    output: Annotated[
        str | None,
        Help(
            "File to write; - is standard output; default: RESULT.html, or report.html for several results.",
            "FILE",
            names=("output", "o"),
            holds="output",
        ),
    ] = None,
) -> None:
    """Write stored results as an HTML page with charts and tables, or one chart as SVG, PNG or PDF.

    The page is a single file that needs no network, to read, print on A4 and sign. A chart is the one on the page.
    Needs an extra: pip install '.[report]' in a checkout, or pip install 'robacc[report] @ git+URL' with the
    repository's URL.

    Example: robacc report result.json --identity cell7.yaml --output report.html
    """
    from robacc.documents.envelope import read_identity, read_result, understood
    from robacc.render.page import page_of, result_of
    from robacc.render.plots.canvas import need

    if chart is not None or PurePath(output or "").suffix.lower() in _PICTURES:
        return _write_chart(results, chart or "", number, output or "")
    need("matplotlib", "plotly", "jinja2")
    read = [read_result(path) for path in results]
    identities = read_identity(identity or ())
    sections = []
    for place, result in enumerate(read, 1):
        with understood(result.name, result.command):
            sections.append(result_of(result.document, place))
    names = [result.record.name for result in read]
    # A number after each repeated name.
    names = [
        name if names.count(name) == 1 else f"{name} ({names[: i + 1].count(name)})" for i, name in enumerate(names)
    ]
    page = page_of(sections, names, identities)
    if output is None:
        is_named = len(results) == 1 and results[0] != "-"
        output = f"{results[0].removesuffix('.json')}.html" if is_named else "report.html"
        print(f"wrote {output}")
    write(output, page)


def _write_chart(results: list[str], kind: str, number: int, output: str) -> None:
    """Write a chart of the one result; without a kind the main chart, and a note of others."""
    from robacc.documents.envelope import read_result, understood
    from robacc.render.plots.canvas import as_file, need
    from robacc.render.plots.results import chart_of, charts_of, kinds_of

    form = PurePath(output).suffix.lower()
    refuse(
        (form not in _PICTURES, f"--output {output}: expected a name that ends in .svg, .png or .pdf"),
        (len(results) > 1, f"a chart is of one result, found {len(results)}"),
    )
    need("matplotlib")
    stored = read_result(results[0])
    with understood(stored.name, stored.command):
        chart = chart_of(stored.document, kind, number)
        image = as_file(chart, form.removeprefix("."))
    write(output, image)
    if not kind:
        others = ", ".join(kinds_of(charts_of(stored.document))[1:]) or "none"
        say_warnings([Note(f"drew the main chart, {chart.kind}; other charts by `chart`: {others}")])


# Results over time.


def history() -> None:
    """Keep results in a database, and say what changed, when and by how much: add, show, trend, changes.

    robacc history add RESULT … --db FILE adds results, show lists them, trend KEY shows one figure or coefficient over
    time, changes says what changed; each has a --help of its own.

    Example: robacc history add result.json --db arm.db
    """
    raise UsageError("say what to do: robacc history add, show, trend or changes; each explains itself with --help")


def history_add(call: Call, *, format: PlainFormat = None, output: Output = "-") -> None:
    """Add results to a database, which is made if there is none; a result that it has already changes nothing.

    Example: robacc history add result.json --db arm.db --at 2026-05-31
    """
    result = call()
    emit(format, output, result.view, result.document)


def history_show(
    call: Call,
    *,
    table: Annotated[
        str | None, Help("CSV or Parquet to write with every figure and coefficient.", "FILE", holds="output")
    ] = None,
    format: PlainFormat = None,
    output: Output = "-",
) -> None:
    """Show the results of a database by arm and date.

    Example: robacc history show --db arm.db --table arm.csv
    """
    result = call()
    if table is not None:
        result.table(table)
    emit(format, output, result.view, result.document)


def history_trend(call: Call, *, format: PlainFormat = None, output: Output = "-") -> None:
    """Show one figure or coefficient over time, with its slope.

    Example: robacc history trend joint_offset.j3 --db arm.db
    """
    result = call()
    emit(format, output, result.view, result.document)


def fleet(
    call: Call,
    results: Annotated[
        list[str] | None, Help("Results of calibrate or trace, one an arm; or --db.", "[RESULT …]")
    ] = None,
    *,
    write_tolerances: Annotated[
        str | None, Help("Tolerance file to write, for predict --tolerances.", "FILE", holds="output")
    ] = None,
    write_robot: Annotated[
        str | None,
        Help("Robot file to write: `robot` with the fleet's means and tolerances.", "FILE", holds="output"),
    ] = None,
    outlets: Outlets,
) -> None:
    """Compute the tolerances of a model of arm from the fits of many, and name the arms unlike the others.

    The tolerances are mean and standard deviation of each coefficient over the arms, as built: predict takes them, and
    calibrate --prior takes the robot file of --write-robot, with which the next arm needs fewer poses.

    Example: robacc fleet fit1.json fit2.json --write-tolerances as_built.yaml
    """
    with progress_bar() as progress:
        result = call(*(results or ()), progress=progress)
    write(write_tolerances, result.tolerances_yaml)
    write(write_robot, result.robot_yaml)
    deliver(outlets, result)


def health(call: Call, *, outlets: Outlets) -> None:
    """Say from a few poses whether a coefficient of an arm moved since its last full test.

    Example: robacc health poses.csv --robot calibrated.yaml --db arm.db
    """
    deliver(outlets, call())


def history_changes(call: Call, *, outlets: Outlets) -> None:
    """Say what changed between the tests of an arm, when, by how much, and whether by a step, a ramp or temperature.

    Example: robacc history changes --db arm.db
    """
    deliver(outlets, call())


# What robacc knows.


def show(
    robot: Annotated[str, Help("Robot file (YAML), URDF, or name of an arm.", "ROBOT")],
    *,
    format: PlainFormat = None,
    output: Output = "-",
    base_link: BaseLink = None,
    tip_link: TipLink = None,
) -> None:
    """Show a robot file or URDF; or the arms, effects and result schemas that robacc knows.

    In place of a file, robots lists the arms that come with the package, effects the effects or what their names ask
    for, schema NAME the keys of a command's result; robacc show effects --help has their options.

    Example: robacc show robot.yaml
    """
    arguments = locals()
    from robacc.api.inputs import Inputs
    from robacc.documents.descriptions import SHOW
    from robacc.render.views.robot import robot_view
    from robacc.robots.arm import summarise

    inputs = Inputs(arguments)
    arm = inputs.robot(robot)
    document = SHOW.write(arm, **summarise(arm))
    emit(
        format,
        output,
        lambda: robot_view(arm, document),
        lambda: inputs.made("format", "output").document("show", document),
    )


def robots(
    name: Annotated[str | None, Help("Part of a maker's or an arm's name; default: every arm.", "[TEXT]")] = None,
    *,
    format: PlainFormat = None,
    output: Output = "-",
) -> None:
    """List the arms that come with the package; every command takes one as --robot NAME.

    Each is the nominal model of a data sheet: register it to your measurements, and check its limits and tool.

    Example: robacc show robots ur
    """
    from robacc.documents.descriptions import ROBOTS
    from robacc.documents.envelope import Provenance
    from robacc.modelling.robot_file import library, similar_arms
    from robacc.render.views.robot import robots_view

    wanted = (name or "").lower()
    arms = [
        {key: value for key, value in arm.items() if key != "path"}
        for arm in library()
        if wanted in f"{arm['name']} {arm['maker']} {arm['model']}".lower()
    ]
    near = "" if arms else ", ".join(similar_arms(wanted))
    fix = f"did you mean {near}?" if near else "robacc show robots lists all of them"
    refuse((not arms, Problem(f"no arm of the package has {name!r} in its name", fix=fix)))
    emit(
        format,
        output,
        lambda: robots_view(arms),
        lambda: Provenance({"name": name}, ()).document("robots", ROBOTS.write({"robots": arms})),
    )


def effects(
    effect: Annotated[str | None, Help("Effect to describe in detail.", "[EFFECT]")] = None,
    *,
    format: PlainFormat = None,
    output: Output = "-",
    robot: OptionalRobot = None,
    poses: Annotated[
        str | None,
        Help(
            "CSV of poses; the list says which effects they can identify. Needs `robot`.",
            "FILE",
            holds="measured poses",
        ),
    ] = None,
    ordered: Ordered = False,
    ignore_limits: IgnoreLimits = False,
    base_link: BaseLink = None,
    tip_link: TipLink = None,
) -> None:
    """List the effects; with a name, show its equation, unit, usual size, required data and similar effects.

    Example: robacc show effects backlash --robot robot.yaml
    """
    arguments = locals()
    from robacc.api.inputs import Inputs
    from robacc.documents.descriptions import EFFECTS
    from robacc.effects import effect_class
    from robacc.effects.specification import catalogue
    from robacc.render.views.robot import effects_view

    inputs = Inputs(arguments)
    of_robot = poses or ordered or ignore_limits or base_link or tip_link
    refuse((robot is None and of_robot, "--poses, --ordered, --ignore-limits, --base-link and --tip-link need --robot"))
    if effect is not None:
        effect_class(effect)
    arm = inputs.optional_robot(poses)
    data = None if poses is None else inputs.poses(poses, arm)
    say_warnings(() if data is None else data.warnings)
    entries = catalogue(effect, arm, data)
    made = inputs.made("format", "output", robot=robot, poses=poses)
    emit(
        format,
        output,
        lambda: effects_view(entries, effect is not None),
        lambda: made.document("effects", EFFECTS.write({"effects": entries})),
    )


def schema(
    name: Annotated[str | None, Help("Name of a command; without it, the names are listed.", "[NAME]")] = None,
    *,
    output: Output = "-",
) -> None:
    """Print the JSON Schema of a command's result: keys, units and required keys.

    Example: robacc show schema estimate -o estimate.schema.json
    """
    from robacc.api import result
    from robacc.io.json_text import json_text

    names = (f"{command}\n" for command in result.schema_names())
    write(output, names if name is None else json_text(result.schema(name)))


# Files to start from.

_TABLES = frozenset(
    {".csv", ".txt", ".tsv", ".dat", ".asc", ".log", ".json", ".jsonl", ".xlsx", ".xls", ".ods", ".parquet"}
)
"""Ends of names of exports."""


def init(
    source: Annotated[
        str | None,
        Help("URDF, name of an arm, or export of poses; without it, give --joints.", "[FILE]"),
    ] = None,
    *,
    joints: Annotated[int | None, Help("Number of joints of the example arm, without a URDF.", "N")] = None,
    robot: Annotated[str, Help("Robot file to write.", "FILE")] = "robot.yaml",
    poses: Annotated[str, Help("CSV to write.", "FILE")] = "poses.csv",
    columns: Annotated[str, Help("Column map to write for an export of poses.", "FILE")] = "columns.yaml",
    board: Annotated[str | None, Help("Squares of a board to print for photos, such as 7x5.", "NxM")] = None,
    folder: Annotated[str, Help("Folder of the files; created if it does not exist.", "DIR")] = ".",
    force: Annotated[bool, Help("Overwrite existing files.")] = False,
    base_link: BaseLink = None,
    tip_link: TipLink = None,
) -> None:
    """Write files to start from: a robot file and a CSV of poses, the map of an export, or a board to print.

    The files for an arm or a number of joints are valid. The rows of the CSV are simulated; replace them with your
    measurements.

    For an export of an instrument or robot (CSV, text, workbook), init writes a column map instead: the meaning of each
    column. Correct it, and give it to other commands with --columns.

    --board 7x5 writes a board to print in true size (board.pdf) with its file, and a file of the camera; see
    robacc estimate --board and --camera.

    --from FILE writes a robot file from the kinematics of a controller, with options of its own: robacc init --from
    --help.

    Example: robacc init --joints 6 --folder my-arm
    """
    from robacc.io.files import read_text
    from robacc.modelling.robot_file import read_robot, robot_path
    from robacc.robots.yaml_robot import parse_robot
    from robacc.simulation.simulate import poses_template, robot_template, urdf_template

    if board is not None:
        return _write_board(board, folder, force)
    refuse(((source is None) == (joints is None), "give either a file or --joints, the number of joints"))
    files = [os.path.normpath(os.path.join(folder, name)) for name in (robot, poses, columns)]
    if source is not None and PurePath(source).suffix.lower() in _TABLES:
        return _write_columns(source, files[2], folder, force)
    _check_free(files[:2], source, force)
    names = PurePath(files[0]).name, PurePath(files[1]).name
    if source is None:
        refuse((base_link or tip_link, "--base-link and --tip-link choose a chain of a URDF, so they need a URDF"))
        text = robot_template(joints or 0, *names)
    else:
        model, path = read_robot(source, base_link=base_link, tip_link=tip_link), robot_path(source)
        is_robot_file = path == source and model.convention != "urdf"
        refuse((is_robot_file, f"{source} is a robot file already; robacc init needs a URDF"))
        text = urdf_template(model, PurePath(source).name, *names) if path == source else read_text(path)
    arm = parse_robot(text, files[0])
    table, rows = poses_template(arm, *names)
    _write_files(folder, {files[0]: text, files[1]: table})
    count = len(arm.variables)
    print(
        f"wrote {files[0]} ({count} joint{'s' * (count > 1)}) and {files[1]} ({rows} simulated rows)",
        "next:",
        *([f"  enter the dimensions of your arm in {files[0]}"] if source is None else []),
        f"  robacc show {files[0]}",
        f"  replace the rows of {files[1]} with your measurements",
        f"  robacc estimate {files[1]} --robot {files[0]} --align base_frame,tool_frame",
        sep="\n",
    )


def _write_board(squares: str, folder: str, force: bool) -> None:
    """Write a board to print, its file and one of the camera, and print the next steps."""
    files = {name: os.path.normpath(os.path.join(folder, name)) for name in ("board.pdf", "board.yaml", "camera.yaml")}
    _check_free([*files.values()], None, force)
    made = plug_in("robacc.boards", "photos")(squares)
    _write_files(folder, {files[name]: content for name, content in made.items()})
    print(
        f"wrote {', '.join(files.values())}",
        "next:",
        f"  print {files['board.pdf']} in true size, measure its ruler, and glue it onto something flat",
        f"  state in {files['camera.yaml']} where the camera sits",
        "  take 30 photos or more, and write the joints of each to joints.csv (pose,q1_deg,q2_deg,…; pose: its name)",
        f"  robacc estimate PHOTOS --joints joints.csv --board {files['board.yaml']} --camera {files['camera.yaml']} "
        "--robot ROBOT",
        sep="\n",
    )


def _write_columns(export: str, path: str, folder: str, force: bool) -> None:
    """Write the column map of an export and print the next steps."""
    from robacc.poses.csv_file import propose_columns

    text, steps = propose_columns(export, path)
    exists = f"{path} exists already; overwrite with --force, or name another file with --columns"
    refuse((os.path.exists(path) and not force, exists))
    _write_files(folder, {path: text})
    print(*steps, sep="\n")


def _write_files(folder: str, files: Mapping[str, str | bytes]) -> None:
    """Write files by their paths into a folder, which is made."""
    from robacc.io.files import make_folder

    make_folder(folder)
    for path, content in files.items():
        write(path, content)


def _check_free(files: list[str], urdf: str | None, force: bool) -> None:
    """Raise UsageError for files that are one, would overwrite the URDF, or exist."""
    places, existing = [*map(os.path.realpath, files)], [path for path in files if os.path.exists(path)]
    names = f"{' and '.join(existing)} {'exists' if len(existing) == 1 else 'exist'}"
    refuse(
        (places[0] == places[1], f"--robot and --poses both name {files[0]}; name two files"),
        *(
            (
                urdf is not None and place == os.path.realpath(urdf),
                f"{path} is the URDF and would be overwritten; name another file",
            )
            for path, place in zip(files, places, strict=True)
        ),
        (existing and not force, f"{names} already; overwrite with --force, or name another --folder"),
    )


def import_(
    call: Call,
    *,
    output: Annotated[
        str, Help("Robot file to write; - is standard output.", "FILE", names=("output", "o"), holds="output")
    ],
) -> None:
    """Write a robot file from the kinematics of a controller or of its ROS driver.

    Example: robacc init --from calibration.conf --arm ur10e --output ur10e.yaml
    """
    from robacc.robots.yaml_robot import robot_to_yaml
    from robacc.version import __version__

    write(output, robot_to_yaml(call(), [f"Written by robacc {__version__} import."]))
