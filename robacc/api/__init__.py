"""One typed call for each command, with the same options and the same results.

:mod:`robacc` exports all of them. The command line parses its arguments, makes these calls, and renders their results.
"""

from __future__ import annotations

HOMES = {
    "Calibrated": "api.fitting",
    "Checked": "api.check",
    "Compared": "api.compare",
    "ComparedTargets": "api.compare",
    "Corrected": "api.correct",
    "Estimate": "api.estimate",
    "Exported": "api.export",
    "InputError": "errors",
    "Iso9283": "api.iso9283",
    "Iso9283Poses": "api.iso9283",
    "Measurements": "measurements",
    "Planned": "api.plan",
    "PoseFile": "poses.reading",
    "Predicted": "api.predict",
    "Problem": "errors",
    "Result": "api.result",
    "RobaccError": "errors",
    "Robot": "robots.description",
    "Simulated": "api.simulate",
    "Traced": "api.fitting",
    "UsageError": "errors",
    "calibrate": "api.fitting",
    "check": "api.check",
    "compare": "api.compare",
    "compare_paired": "api.compare",
    "correct": "api.correct",
    "estimate": "api.estimate",
    "export": "api.export",
    "import_": "api.export",
    "iso9283": "api.iso9283",
    "iso9283_poses": "api.iso9283",
    "plan": "api.plan",
    "predict": "api.predict",
    "read_poses": "api.inputs",
    "read_result": "api.inputs",
    "read_robot": "modelling.robot_file",
    "schema": "api.result",
    "simulate": "api.simulate",
    "trace": "api.fitting",
    "write_poses": "api.inputs",
    "write_robot": "api.inputs",
}
"""Module of each name that :mod:`robacc` exports; a test compares them with its imports, which type checkers read."""
