"""One typed call for each command, with the same options and the same results.

:mod:`robacc` exports all of them. The command line parses its arguments, makes these calls, and renders their results.
"""

from __future__ import annotations

HOMES = {
    "Calibrated": "api.fitting",
    "Checked": "api.stored",
    "Compared": "api.stored",
    "ComparedTargets": "api.stored",
    "Corrected": "api.correct",
    "Estimate": "api.accuracy",
    "Exported": "api.models",
    "InputError": "errors",
    "Iso9283": "api.accuracy",
    "Iso9283Poses": "api.accuracy",
    "Measurements": "measurements",
    "Planned": "api.expected",
    "PoseFile": "poses.reading",
    "Predicted": "api.expected",
    "Problem": "errors",
    "Result": "api.result",
    "RobaccError": "errors",
    "Robot": "robots.description",
    "Simulated": "api.models",
    "Traced": "api.fitting",
    "UsageError": "errors",
    "calibrate": "api.fitting",
    "check": "api.stored",
    "compare": "api.stored",
    "compare_paired": "api.stored",
    "correct": "api.correct",
    "estimate": "api.accuracy",
    "export": "api.models",
    "import_": "api.models",
    "iso9283": "api.accuracy",
    "iso9283_poses": "api.accuracy",
    "plan": "api.expected",
    "predict": "api.expected",
    "read_poses": "api.inputs",
    "read_result": "api.inputs",
    "read_robot": "modelling.robot_file",
    "schema": "api.result",
    "simulate": "api.models",
    "trace": "api.fitting",
    "write_poses": "api.inputs",
    "write_robot": "api.inputs",
}
"""Module of each name that :mod:`robacc` exports; a test compares them with its imports, which type checkers read."""
