"""robacc: accuracy of robot arms, the causes of their errors, and corrected models.

Every command of the command line is a function with the same options and the same results:

    >>> import robacc
    >>> result = robacc.estimate("sample_data/poses.csv", robot="sample_data/robot.yaml")
    >>> result.n_poses, result.grade.grade
    (60, 'F')

``document()``, ``to_json()`` and ``save()`` of a result give the JSON document that the command writes. Names are
loaded at their first use, so that ``import robacc`` is fast.
"""

from typing import TYPE_CHECKING

from robacc.api import HOMES as _HOMES
from robacc.version import __version__ as __version__

if TYPE_CHECKING:
    from robacc.api.accuracy import (
        Estimate as Estimate,
        Iso9283 as Iso9283,
        Iso9283Poses as Iso9283Poses,
        estimate as estimate,
        iso9283 as iso9283,
        iso9283_poses as iso9283_poses,
    )
    from robacc.api.correct import Corrected as Corrected, correct as correct
    from robacc.api.expected import Planned as Planned, Predicted as Predicted, plan as plan, predict as predict
    from robacc.api.fitting import Calibrated as Calibrated, Traced as Traced, calibrate as calibrate, trace as trace
    from robacc.api.inputs import read_poses as read_poses, write_poses as write_poses, write_robot as write_robot
    from robacc.api.models import (
        Exported as Exported,
        Simulated as Simulated,
        export as export,
        import_ as import_,
        simulate as simulate,
    )
    from robacc.api.result import Result as Result, schema as schema
    from robacc.api.stored import (
        Checked as Checked,
        Compared as Compared,
        ComparedTargets as ComparedTargets,
        Fleet as Fleet,
        Health as Health,
        HistoryAdded as HistoryAdded,
        HistoryChanges as HistoryChanges,
        HistoryShown as HistoryShown,
        HistoryTrend as HistoryTrend,
        check as check,
        compare as compare,
        compare_paired as compare_paired,
        fleet as fleet,
        health as health,
        history_add as history_add,
        history_changes as history_changes,
        history_show as history_show,
        history_trend as history_trend,
    )
    from robacc.documents.envelope import read_result as read_result
    from robacc.errors import (
        InputError as InputError,
        Problem as Problem,
        RobaccError as RobaccError,
        UsageError as UsageError,
    )
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
