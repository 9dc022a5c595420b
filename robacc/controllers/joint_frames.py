"""Arm as frames on its joint axes, whatever the convention of its description."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from robacc.chain import BASE
from robacc.errors import UsageError
from robacc.geometry import Poses, exp_so3, rpy_from_rotation
from robacc.robots.arm import Arm
from robacc.robots.description import Frame, Joint, Robot


@dataclass(frozen=True, slots=True)
class JointFrames:
    """Joint frames of an arm with all joint variables at zero, in the robot's base frame.

    The tool pose is ``M_1(q_1) M_2(q_2) … F`` with ``M_i`` the motion by q_i along or about the z axis of frame i.
    """

    joints: tuple[Joint, ...]
    frames: tuple[Poses, ...]
    """Frame of each joint variable; z is its axis, in the positive direction."""
    flange: Poses
    """Last link's frame, which the tool is attached to."""

    def steps(self) -> list[Poses]:
        """Return each frame in the one before it, the first in the base frame, the flange last."""
        chain = [Poses.identity(), *self.frames, self.flange]
        return [before.inverse() @ after for before, after in itertools.pairwise(chain)]


def joint_frames(robot: Robot) -> JointFrames:
    """Return the joint frames of an arm, without the effects of its file.

    Raises:
        UsageError: A joint follows others, which controllers' parameters cannot describe.
    """
    arm = Arm.of(robot)
    chain = arm.chain
    simple = {(k, i) for i, k in enumerate(chain.joint_axis)}
    coupled = [drive for drive in chain.drives if (drive.motion, drive.joint) not in simple]
    if coupled:
        names = sorted({robot.joints[chain.motions[drive.motion].owner].name for drive in coupled})
        raise UsageError(f"{', '.join(names)} follows other joints; the format has no joint that does")
    counts = []
    for k in chain.joint_axis:
        count = k + 1
        # A DH row's d lies on the axis too: the frame behind it is the one that drawings show.
        while count < len(chain.motions) and chain.motions[count].axis == 2 and chain.motions[count].label == "d":
            count += 1
        counts.append(count)
    first = next((k for k, motion in enumerate(chain.motions) if motion.owner != BASE), 0)
    wanted = sorted({first, *counts, arm.flange})
    scalars = chain.scalars(np.zeros((chain.n_joints, 1)))
    stored = chain.sweep(scalars, 1, (), wanted).frames
    at = {count: Poses(p.rotation[..., 0], p.translation[..., 0]) for count, p in zip(wanted, stored, strict=True)}
    base = at[first].inverse()
    turned = Poses(exp_so3(np.array([np.pi, 0.0, 0.0])), np.zeros(3))
    frames = []
    for joint, count in zip(robot.variables, counts, strict=True):
        frame = base @ at[count]
        frames.append(frame @ turned if joint.sign < 0 else frame)
    return JointFrames(robot.variables, tuple(frames), base @ at[arm.flange])


def robot_of(frames: JointFrames, like: Robot) -> Robot:
    """Return a robot in the URDF convention with these joint frames; name, base, tool and gravity as in ``like``."""
    joints = []
    for joint, step in zip(frames.joints, frames.steps()[:-1], strict=True):
        frame = frame_of_poses(step)
        values = dict(zip(("x", "y", "z"), frame.xyz, strict=True))
        values |= dict(zip(("roll", "pitch", "yaw"), frame.rpy, strict=True))
        joints.append(Joint(joint.name, joint.type, {**values, "offset": 0.0}, limits=joint.limits))
    last = frame_of_poses(frames.steps()[-1] @ pose_of(like.tool))
    return Robot(like.name, "urdf", tuple(joints), base=like.base, tool=last, gravity=like.gravity)


def pose_of(frame: Frame) -> Poses:
    """Return a frame as a transform."""
    return Poses.from_xyz_rpy(np.array(frame.xyz), np.array(frame.rpy))


def frame_of_poses(pose: Poses) -> Frame:
    """Return a transform as a frame."""
    x, y, z = (float(value) + 0.0 for value in pose.translation)
    roll, pitch, yaw = (float(value) + 0.0 for value in rpy_from_rotation(pose.rotation))
    return Frame((x, y, z), (roll, pitch, yaw))
