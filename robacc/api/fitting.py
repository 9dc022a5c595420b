"""What the calls behind ``robacc calibrate`` and ``robacc trace`` share: what they read, and the model they make."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import PurePath

import numpy as np

from robacc.api.inputs import STDIN, StrPath, needed_robot_of, path_of, poses_of
from robacc.api.result import Result
from robacc.documents.envelope import InputFile
from robacc.errors import InputError, Problem, UsageError
from robacc.measurements import Measurements
from robacc.robots.description import Robot
from robacc.version import __version__


@dataclass(frozen=True, slots=True)
class Given:
    """What a fit is given."""

    robot: Robot
    data: Measurements
    apart: Measurements | None
    """Poses held out, where they are others."""
    names: dict[str, str | None]
    """What poses, robot and holdout are called in the result's options; None where they are no file."""
    inputs: tuple[InputFile, ...]


class Fitted(Result):
    """A result that has a robot better than the one delivered."""

    __slots__ = ()
    robot: Robot
    given: Given

    def model_yaml(self) -> str:
        """The robot file that predicts what was fitted; its first line says where it is from."""
        from robacc.robots.yaml_writer import robot_to_yaml

        source = self.given.names["poses"]
        origin = "arrays" if source is None else PurePath(source).name
        return robot_to_yaml(
            self.robot, (f"written by robacc {__version__} {self.command} from {origin}",), rounded=True
        )

    def write_model(self, path: StrPath) -> None:
        """Write :meth:`model_yaml` to a file, whole or not at all; every call and command takes it as a robot.

        Raises:
            InputError: The file cannot be written.
        """
        from robacc.io.files import write_text

        write_text(path, self.model_yaml())


def given(
    poses: StrPath | Measurements,
    robot: StrPath | Robot,
    holdout: StrPath | Measurements | None,
    ordered: bool,
    base_link: str | None,
    tip_link: str | None,
) -> Given:
    """The robot, the poses measured on it, those held out, and the record of the files.

    Raises:
        InputError: A file or array cannot be used.
        UsageError: The poses have no joint columns, or a link is named that there is not.
    """
    arm, arm_record = needed_robot_of(robot, base_link, tip_link)

    def read(source: StrPath | Measurements, kind: str) -> tuple[Measurements, InputFile]:
        data, record = poses_of(source, arm, ordered=ordered, kind=kind)
        if data.q is None:
            name = path_of(source) or data.source or "the poses"
            raise UsageError(f"{name} has no joint columns q1 … q{len(arm.variables)}, which a fit needs")
        return data, record

    data, record = read(poses, "poses")
    apart = None if holdout is None else read(holdout, "holdout")
    names = {"poses": _name(poses), "robot": _name(robot), "holdout": _name(holdout)}
    if apart is None:
        return Given(arm, data, None, names, (record, arm_record))
    _refuse_shared(data, apart[0], names["holdout"])
    return Given(arm, data, apart[0], names, (record, arm_record, apart[1]))


def _refuse_shared(data: Measurements, apart: Measurements, name: str | None) -> None:
    """Raise InputError where poses held out are also among those fitted: figures of them would flatter."""
    fitted = {one: i for i, one in enumerate(_rows(data))}
    shared = [(i, fitted[one]) for i, one in enumerate(_rows(apart)) if one in fitted]
    if not shared:
        return
    count = f"{len(shared)} of {apart.n} poses held out {'is' if len(shared) == 1 else 'are'}"
    here, there = shared[0]
    raise InputError(
        Problem(
            f"{count} among the fitted poses too, the first is {data.place(there)} of {data.source or 'the poses'}",
            name,
            apart.line(here),
            fix="poses held out must have had no part in the fit: leave them out of one of the two",
        )
    )


def _rows(data: Measurements) -> Iterator[bytes]:
    """What was commanded and measured of each pose, which noise makes different where a pose was measured again."""
    circumstances = (data.time, data.temperature, data.payload)
    rotation = None if data.rotation is None else data.rotation.reshape(9, data.n)
    known = [one for one in (data.q, data.position, rotation, *circumstances) if one is not None]
    return (row.tobytes() for row in np.vstack(known).T)


def _name(source: StrPath | Measurements | Robot | None) -> str | None:
    if isinstance(source, Measurements):
        return STDIN if source.source == "<stdin>" else source.source
    return path_of(source)


def listed(effects: str | Sequence[str]) -> str:
    """Effects as the command line has them."""
    return effects if isinstance(effects, str) else ",".join(effects)
