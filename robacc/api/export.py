"""Calls of ``robacc export`` and ``robacc init --from``: a robot for a controller, and from one."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Annotated, ClassVar, Literal, get_args

from robacc.api.inputs import load_robot, load_text, optional
from robacc.api.parameters import BaseLink, Help, StrPath, TipLink, call
from robacc.api.result import Provenance, Result, fields_of
from robacc.controllers import ExportedModel, export_model, known_ur_arm, parse_controller_file
from robacc.documents.descriptions import EXPORT
from robacc.errors import Note, UsageError
from robacc.io.files import read_text, write_text
from robacc.prediction.model_fit import model_fit
from robacc.robots.description import Robot

ExportFormatName = Literal["urdf", "mdh", "json", "ur-calibration", "ur-kinematics", "xarm", "joint-offsets"]


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class Exported(Result, ExportedModel):
    """Model in the format of a controller, with the error that remains there."""

    command: ClassVar[str] = "export"
    keys = EXPORT
    format: str
    warnings: tuple[str, ...] = ()
    """Doubts about the model; :attr:`not_carried` lists what the format leaves out."""

    def write(self, path: StrPath) -> None:
        """Write the model to a file; a failure leaves no partial file.

        Raises:
            InputError: The file cannot be written.
        """
        write_text(path, self.text)


@call
def export(
    model: Annotated[
        StrPath | Robot, Help("Robot file (YAML), URDF, or name of an arm.", "MODEL", "Or a robot read before.")
    ],
    *,
    format: Annotated[
        ExportFormatName | str | None,
        Help(
            "Format of the text.",
            python="None is ur-calibration for an arm that it fits.",
            group="robacc.exporters",
        ),
    ] = None,
    nominal: Annotated[
        StrPath | Robot | None,
        Help("joint-offsets: the model that the controller computes with.", "ROBOT"),
    ] = None,
    arm: Annotated[str | None, Help("ur-calibration: the arm, such as ur10e.", "NAME")] = None,
    template: Annotated[StrPath | None, Help("ur-…: the arm's own file, whose other lines are kept.", "FILE")] = None,
    base_link: BaseLink = None,
    tip_link: TipLink = None,
) -> Exported:
    """Write a model in the format of a controller, a driver or a simulator, as text.

    What the format cannot hold is left out, and what it can hold is fitted again to the model.

    Returns:
        The text, and the error that remains with it.

    Raises:
        InputError: A file cannot be used.
        UsageError: The format cannot hold this arm, there is none, or the arguments contradict each other.

    Example:
        >>> import robacc
        >>> result = robacc.export("sample_data/robot.yaml", format="mdh")
        >>> result.text.splitlines()[0], result.remaining.position_max < 1e-9
        ('robacc: 1', True)
    """
    robot, record = load_robot(model, base_link, tip_link)
    notes: tuple[str, ...] = ()
    if format is None:
        format, name = "ur-calibration", arm or known_ur_arm(robot)
        if name is None:
            raise UsageError(f"name the format of the file with `format`: {', '.join(get_args(ExportFormatName))}")
        notes = (Note(f"format {format}, which the controller of a {name} reads; `format` names another"),)
    for parameter, value, formats in (
        ("nominal", nominal, ("joint-offsets",)),
        ("template", template, ("ur-calibration", "ur-kinematics")),
        ("arm", arm, ("ur-calibration",)),
    ):
        if value is not None and format not in formats:
            raise UsageError(f"`{parameter}` belongs to `format` {' and '.join(formats)}")
    controller, nominal_records = optional(load_robot, nominal, kind="nominal")
    text, template_records = optional(load_text, template, "template", lambda text, _: text)
    body = export_model(robot, format, nominal=controller, arm=arm, template=text)
    options = {"format": format, "arm": arm, "base_link": base_link, "tip_link": tip_link}
    fit = model_fit(robot)
    warnings = notes if fit is None else (*notes, *fit.warnings)
    made = Provenance(options, (record, *nominal_records, *template_records), None)
    return Exported(**fields_of(body), format=format, made=made, warnings=warnings)


@call
def import_(
    file: Annotated[
        StrPath,
        Help("calibration.conf of Universal Robots, a ROS kinematics file, or a JSON export.", "FILE"),
    ],
    *,
    arm: Annotated[str | None, Help("Arm that a calibration.conf belongs to, such as ur10e.", "NAME")] = None,
) -> Robot:
    """Read a robot from the kinematics file of a controller or of its ROS driver.

    Returns:
        The robot; :func:`robacc.write_robot` writes it as a robot file.

    Raises:
        InputError: The file cannot be read, or is none of these formats.
        UsageError: The arm is unknown.

    Example:
        >>> import pathlib, tempfile
        >>> import robacc
        >>> path = pathlib.Path(tempfile.mkdtemp()) / "model.json"
        >>> robacc.export("sample_data/robot.yaml", format="json").write(path)
        >>> robacc.import_(path).variable_names == robacc.read_robot("sample_data/robot.yaml").variable_names
        True
    """
    path = os.fspath(file)
    return parse_controller_file(read_text(path), "<stdin>" if path == "-" else path, arm)
