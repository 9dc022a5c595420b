"""Model and nominal robot of a correction, in common frames."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Literal

import numpy as np

from robacc.effects.base import Effect
from robacc.errors import InputError, Problem
from robacc.fitting.apply_fit import absorb_constants
from robacc.geometry import Array, Poses, rms_length
from robacc.modelling.model import Model
from robacc.robots.arm import Arm
from robacc.robots.description import Frame, Robot

FrameName = Literal["measuring", "base"]


@dataclass(frozen=True, slots=True)
class RobotPair:
    """Real arm as the model describes it, and the arm that the controller computes with, in the same frames."""

    model: Model
    """Effects of the arm; those of the measurement are left out."""
    nominal: Arm
    frame: FrameName
    left_out: tuple[Effect, ...]
    """Effects of the measurement in the model file, which no command can correct."""

    @property
    def base(self) -> Poses:
        """Pose of the robot's base in the measuring frame, one pose."""
        return frame_pose(self.model.arm.robot.base)

    def to_measuring(self, poses: Poses) -> Poses:
        """Return Cartesian targets in the measuring frame."""
        return poses if self.frame == "measuring" else self.base @ poses

    def from_measuring(self, poses: Poses) -> Poses:
        """Return poses of the measuring frame in the frame of the Cartesian targets."""
        return poses if self.frame == "measuring" else self.base.inverse() @ poses


def robot_pair(model: Robot, nominal: Robot, frame: FrameName) -> RobotPair:
    """Return model and nominal robot in common frames.

    The nominal robot stands where the model stands, because a controller knows no measuring frame. With ``frame``
    ``measuring``, both carry the model's tool, the measured target; with ``base``, both carry the nominal tool, with
    which the controller works.

    Raises:
        InputError: The two robots have different joints, or their effects cannot be read.
    """
    model = absorb_constants(model)
    nominal = dataclasses.replace(nominal, effects=(), effect_units=(1.0, 1.0))
    check_same_joints(model, nominal)
    if frame == "base":
        com = Arm.of(model).payload_com
        model = dataclasses.replace(model, tool=nominal.tool, targets=nominal.targets, payload_com=com)
    nominal = dataclasses.replace(nominal, base=model.base, tool=model.tool, targets=model.targets)
    full = Model.of(model)
    known = tuple(entry for entry in full.known if not entry.effect.is_of_measurement)
    left_out = tuple(entry.effect for entry in full.known if entry.effect.is_of_measurement)
    return RobotPair(dataclasses.replace(full, known=known), Arm.of(nominal), frame, left_out)


def nominal_of(model: Robot) -> Robot:
    """Return the robot that a model was fitted from: its numbers without the fitted constants, and no effects."""
    return dataclasses.replace(absorb_constants(model), effects=())


def check_same_joints(model: Robot, nominal: Robot) -> None:
    """Raise InputError unless both robots have the same joint variables."""
    pairs = [[(joint.name, joint.type) for joint in robot.variables] for robot in (model, nominal)]
    if [kind for _, kind in pairs[0]] != [kind for _, kind in pairs[1]]:
        texts = [", ".join(f"{name} ({kind})" for name, kind in pair) for pair in pairs]
        message = f"the model has the joints {texts[0]}, the nominal robot has {texts[1]}"
        raise InputError(Problem(message, nominal.name, fix="give the robot file that the model was fitted from"))


def frame_pose(frame: Frame) -> Poses:
    """Return the pose ``(1)`` of a frame."""
    return Poses.from_xyz_rpy(np.array(frame.xyz)[:, None], np.array(frame.rpy)[:, None])


def arm_length(arm: Arm, q: Array) -> float:
    """Return the size of the arm, m: RMS distance of its target from its base at joints ``q`` ``(J, N)``."""
    poses = arm.chain.forward(q)
    base = np.array(arm.robot.base.xyz)[:, None]
    return max(rms_length(poses.translation - base), 1e-3)
