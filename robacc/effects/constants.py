"""Constants of the model written into the robot's own numbers: frames, and lengths and angles of the links."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from robacc.chain import BASE, TOOL
from robacc.effects.base import Effect
from robacc.effects.specification import every_column
from robacc.geometry import Poses, rotation_about, rpy_from_rotation
from robacc.robots.arm import TURN_OF_ANGLE, Arm
from robacc.robots.description import Frame, Robot

_COORDINATES = ("x", "y", "z", *TURN_OF_ANGLE)
_FRAME_MOTIONS = ("x", "y", "z", *TURN_OF_ANGLE.values())


def absorbed(robot: Robot, effects: Sequence[Effect], values: Mapping[str, float]) -> Robot:
    """Return the robot with fitted values of constant effects written into its own numbers.

    A value of the chain's motion adds to the joint's parameter of that name; those of a frame move and turn it.
    """
    arm = Arm.of(robot)
    joints, targets = list(robot.joints), dict(robot.targets)
    moved: dict[tuple[int, str], dict[str, float]] = {}
    terms = {term.name: term for effect in effects for term in effect.terms(arm, every_column(arm))}
    for name, term in terms.items():
        motion = arm.chain.motions[term.parts[0].motion]
        if motion.owner < 0 or motion.label in _FRAME_MOTIONS:
            frame = motion.owner, name.removesuffix(f".{term.label}").partition(".")[2]
            moved.setdefault(frame, {})[term.label] = values.get(name, 0.0)
        else:
            parameters = joints[motion.owner].parameters
            changed = parameters.get(motion.label, 0.0) + values.get(name, 0.0)
            joints[motion.owner] = dataclasses.replace(
                joints[motion.owner], parameters={**parameters, motion.label: changed}
            )
    for (owner, name), changes in moved.items():
        if owner == BASE:
            robot = dataclasses.replace(robot, base=_moved_frame(robot.base, changes))
        elif owner == TOOL and targets:
            targets[name] = _moved_frame(targets[name], changes)
        elif owner == TOOL:
            robot = dataclasses.replace(robot, tool=_moved_frame(robot.tool, changes))
        else:
            parameters = joints[owner].parameters
            x, y, z, roll, pitch, yaw = (parameters[label] for label in _COORDINATES)
            frame_of_joint = _moved_frame(Frame((x, y, z), (roll, pitch, yaw)), changes)
            coordinates = dict(zip(_COORDINATES, (*frame_of_joint.xyz, *frame_of_joint.rpy), strict=True))
            joints[owner] = dataclasses.replace(joints[owner], parameters={**parameters, **coordinates})
    return dataclasses.replace(robot, joints=tuple(joints), targets=targets)


def _moved_frame(frame: Frame, changes: Mapping[str, float]) -> Frame:
    """Return the frame with coordinates changed: the product of the chain's motions; unturned, its angles stay."""
    x, y, z = (value + changes.get(label, 0.0) for value, label in zip(frame.xyz, "xyz", strict=True))
    turns = [changes.get(label, 0.0) for label in TURN_OF_ANGLE]
    if not any(turns):
        return Frame((x, y, z), frame.rpy)
    rotation = Poses.from_xyz_rpy(np.zeros(3), np.array(frame.rpy)).rotation
    for axis, turn in enumerate(turns):
        rotation = rotation @ rotation_about(axis, turn)
    roll, pitch, yaw = (float(angle) for angle in rpy_from_rotation(rotation))
    return Frame((x, y, z), (roll, pitch, yaw))
