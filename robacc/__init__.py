"""robacc: accuracy of robot arms, the causes of their errors, and corrected models.

Every command of the command line is a function with the same options and the same results:

    >>> import robacc
    >>> result = robacc.estimate("sample_data/poses.csv", robot="sample_data/robot.yaml")
    >>> result.n_poses, result.grade.grade
    (60, 'F')

``document()``, ``to_json()`` and ``save()`` of a result give the JSON document that the command writes. Names are
loaded at their first use, so that ``import robacc`` is fast.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from robacc.api import HOMES as _HOMES
from robacc.version import __version__ as __version__

if TYPE_CHECKING:
    from robacc.api.check import Checked as Checked
    from robacc.api.check import check as check
    from robacc.api.compare import Compared as Compared
    from robacc.api.compare import ComparedTargets as ComparedTargets
    from robacc.api.compare import compare as compare
    from robacc.api.compare import compare_paired as compare_paired
    from robacc.api.correct import Corrected as Corrected
    from robacc.api.correct import correct as correct
    from robacc.api.estimate import Estimate as Estimate
    from robacc.api.estimate import estimate as estimate
    from robacc.api.export import Exported as Exported
    from robacc.api.export import export as export
    from robacc.api.export import import_ as import_
    from robacc.api.fitting import Calibrated as Calibrated
    from robacc.api.fitting import Traced as Traced
    from robacc.api.fitting import calibrate as calibrate
    from robacc.api.fitting import trace as trace
    from robacc.api.inputs import read_poses as read_poses
    from robacc.api.inputs import read_result as read_result
    from robacc.api.inputs import write_poses as write_poses
    from robacc.api.inputs import write_robot as write_robot
    from robacc.api.iso9283 import Iso9283 as Iso9283
    from robacc.api.iso9283 import Iso9283Poses as Iso9283Poses
    from robacc.api.iso9283 import iso9283 as iso9283
    from robacc.api.iso9283 import iso9283_poses as iso9283_poses
    from robacc.api.plan import Planned as Planned
    from robacc.api.plan import plan as plan
    from robacc.api.predict import Predicted as Predicted
    from robacc.api.predict import predict as predict
    from robacc.api.result import Result as Result
    from robacc.api.result import schema as schema
    from robacc.api.simulate import Simulated as Simulated
    from robacc.api.simulate import simulate as simulate
    from robacc.errors import InputError as InputError
    from robacc.errors import Problem as Problem
    from robacc.errors import RobaccError as RobaccError
    from robacc.errors import UsageError as UsageError
    from robacc.measurements import Measurements as Measurements
    from robacc.modelling.robot_file import read_robot as read_robot
    from robacc.poses.reading import PoseFile as PoseFile
    from robacc.robots.description import Robot as Robot

__all__ = ["__version__", *_HOMES]


if not TYPE_CHECKING:  # a type checker would accept every misspelled name

    def __getattr__(name: str) -> object:
        """Load a name at its first use."""
        if name not in _HOMES:
            raise AttributeError(f"module 'robacc' has no attribute {name!r}")
        from importlib import import_module

        value = getattr(import_module(f"robacc.{_HOMES[name]}"), name)
        globals()[name] = value
        return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
